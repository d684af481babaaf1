"""A burr on a bone from Python: errors, runs, a thin plate, places far away, and Ctrl-C."""

import _thread
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from session_scenes import refused

from burrlab import Burr, BurrContact, Material, VoxelBone, materials

FLAGS = ("touching", "ambiguous", "coarse", "faint")
COLUMNS = ("force", "normal", "m1", "penetration", "m0", "removed", "tick", "c_e", *FLAGS)
ABOVE = (0.0, 0.0, 1.3)  # 0.2 mm into the surface at z = 0 with R = 1.5 mm


def block() -> VoxelBone:
    """A block of 4 x 4 x 2 mm below the plane z = 0, centred on the z axis."""
    return VoxelBone.block((4, 4, 2), 0.1, origin=(-1.95, -1.95, -1.95))


def contact_on(bone: VoxelBone, radius: float = 1.5, **options: Any) -> BurrContact:
    return BurrContact(bone, Burr(radius), materials["bone"], **({"seed": 3} | options))


def wandering_path(n: int) -> NDArray[np.float64]:
    """A path into, along, out of and beside the bone."""
    t = np.linspace(0, 1, n)
    return np.column_stack([np.sin(7 * t), 0.5 * np.cos(11 * t), 1.3 - 0.6 * np.sin(9 * t)])


def test_attributes() -> None:
    bone, burr = block(), Burr(1.5)
    contact = BurrContact(bone, burr, materials["pvc"], 2**64 - 1, 2**31 - 1, scheme="cell")
    assert contact.bone is bone
    assert (contact.burr, contact.material) == (burr, materials["pvc"])
    assert (contact.seed, contact.index, contact.scheme, contact.tick) == (2**64 - 1, 2**31 - 1, "cell", 0)
    assert contact_on(bone).scheme == "layer"


HOLD = {
    "force": 1.0,
    "start": (0, 0, 1.6),
    "axis": (0, 0, -1),
    "from_": 0.0,
    "travel": 1.0,
    "dt": 1.0,
    "ticks": 10,
}
POINTS = r"path must have shape \(n, 3\), points \(x, y, z\) \[mm\], got "


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda _: contact_on(None), "bone must be a VoxelBone, got None"),
        (lambda c: contact_on(c.bone, 0.0), "radius must be positive and finite, got 0"),
        (lambda c: contact_on(c.bone, scheme="both"), "scheme must be layer or cell, got 'both'"),
        (lambda c: contact_on(c.bone, index=2**31), r"index must be below 2\^31, got 2147483648"),
        (lambda _: contact_on(VoxelBone.block((4, 4, 2), 0.4)),
         "radius must be at least 4 voxels, got 3.75; a spacing of 0.2 mm or finer would do"),
        (lambda _: contact_on(VoxelBone.block((4, 4, 2), (0.1, 0.1, 0.5))),
         "radius must be at least 4 voxels, got 3;"),
        (lambda c: c.step((0, 0, np.nan), 1.0), "center must be finite, got nan"),
        (lambda c: c.step((np.inf, 0, 0), 1.0), "center must be finite, got inf"),
        (lambda c: c.step((np.inf, 0, 0), 1.0, burr_on=False), "center must be finite, got inf"),
        (lambda c: c.step(ABOVE, -1.0), "dt must be positive and finite, got -1"),
        (lambda c: c.step(ABOVE, 0.0), "dt must be positive and finite, got 0"),
        (lambda c: c.step(ABOVE, 0.0, burr_on=False), "dt must be positive and finite, got 0"),
        (lambda c: c.step(ABOVE, np.nan), "dt must be positive and finite, got nan"),
        (lambda c: BurrContact(c.bone, c.burr, Material("x", c_e=1, alpha=1e300), seed=1).step(ABOVE, 1e10),
         "alpha dt must be at most 1000, got inf"),
        (lambda c: c.probe((np.nan, 0, 0)), "center must be finite, got nan"),
        (lambda c: c.erode(ABOVE, np.inf), "dt must be positive and finite, got inf"),
        (lambda c: c.erode((2.0, 2.0, -np.inf), 1.0), "center must be finite, got -inf"),
        (lambda c: c.erode(ABOVE, 1001.0 / c.material.alpha), "alpha dt must be at most 1000, got 1001"),
        (lambda c: c.run(np.zeros(3), 1.0), POINTS + r"\(3,\)"),
        (lambda c: c.run(np.zeros((4, 2)), 1.0), POINTS + r"\(4, 2\)"),
        (lambda c: c.run(np.zeros((2, 2, 3)), 1.0), POINTS + r"\(2, 2, 3\)"),
        (lambda c: c.run([ABOVE, (0, np.nan, 0)], 1.0), "every point of path must be finite, got nan"),
        (lambda c: c.run([ABOVE], 0.0), "dt must be positive and finite, got 0"),
        (lambda c: c.hold(**HOLD | {"force": 0.0}), "force must be positive and finite, got 0"),
        (lambda c: c.hold(**HOLD | {"dt": -1.0}), "dt must be positive and finite, got -1"),
        (lambda c: c.hold(**HOLD | {"axis": (0, 0, -2)}), "length of axis must be 1, got 2"),
        (lambda c: c.hold(**HOLD | {"start": (0, 0, np.nan)}), "center must be finite, got nan"),
        (lambda c: c.hold(**HOLD | {"from_": np.nan}), "from must be finite, got nan"),
        (lambda c: c.hold(**HOLD | {"travel": np.inf}), "travel must be finite, got inf"),
    ],
)  # fmt: skip
def test_a_refused_call_changes_nothing(call: Callable[[BurrContact], object], text: str) -> None:
    bone = block()
    contact, digest = contact_on(bone), bone.digest()
    refused((lambda: call(contact), text))
    assert (contact.tick, bone.digest()) == (0, digest)


@pytest.mark.parametrize("scheme", ["layer", "cell"])
@pytest.mark.parametrize("burr_on", [True, False])
def test_a_run_equals_single_steps(scheme: str, burr_on: bool) -> None:
    """Runs in parts, one of them empty, are equal too."""
    path = wandering_path(300)
    whole, parted, stepped = (contact_on(block(), scheme=scheme) for _ in range(3))
    series = whole.run(path, 0.5, burr_on=burr_on)
    parts = [parted.run(part, 0.5, burr_on=burr_on) for part in np.split(path, [0, 7, 8, 120])]
    steps = [stepped.step(center, 0.5, burr_on=burr_on) for center in path]
    assert len(series) == len(steps) == whole.tick == parted.tick == stepped.tick
    for name in COLUMNS:
        column = getattr(series, name)
        np.testing.assert_array_equal(column, [getattr(step, name) for step in steps], err_msg=name)
        np.testing.assert_array_equal(column, np.concatenate([getattr(part, name) for part in parts]))
    assert (series[0].m0, series[-1].m0) == (steps[0].m0, steps[-1].m0)
    refused((lambda: series[300], "tick 300 of 300", IndexError))
    assert whole.bone.digest() == parted.bone.digest() == stepped.bone.digest()
    assert (whole.bone.removed > 0) == burr_on
    assert whole.bone.removed == pytest.approx(series.removed.sum(), rel=1e-9)
    assert not np.all(series.touching)  # the path leaves the bone


@pytest.mark.parametrize("rate_exponent", [0.0, 0.5])
def test_a_held_descent_erodes_as_steps_do(rate_exponent: float) -> None:
    material = Material("any", c_e=2.0, alpha=0.1, force_exponent=2.0, rate_exponent=rate_exponent)
    held, stepped = (BurrContact(block(), Burr(1.5), material, seed=3) for _ in range(2))
    descent = held.hold(0.8, (0, 0, 1.6), (0, 0, -1), from_=0.0, travel=1.5, dt=1.0, ticks=50)
    run = stepped.run([(0.0, 0.0, 1.6 - s) for s in descent.position], 1.0)
    np.testing.assert_array_equal(run.removed, descent.removed)
    np.testing.assert_array_equal(run.force[:, 2], descent.force)


def test_arrays_of_a_contact_are_copies() -> None:
    contact = contact_on(block())
    felt = contact.step(ABOVE, 1.0)
    felt.force[:] = 7.0
    assert felt.force[2] != 7.0
    series = contact.run([ABOVE], 1.0)
    series.force[:] = 7.0
    assert series.force[0, 2] != 7.0
    assert repr(felt).startswith("Contact(tick=0, force=(")


def test_ambiguous_in_a_plate() -> None:
    """A burr breaks through a plate: the force fades to nothing midway and never flips at full strength."""
    heights = np.linspace(1.7, -1.7, 341)
    series = contact_on(VoxelBone.block((6, 6, 0.6), 0.1, origin=(-2.95, -2.95, -0.25))).run(
        np.column_stack([np.zeros_like(heights), np.zeros_like(heights), heights]), 1.0, burr_on=False
    )
    assert "ambiguous" in repr(series[170])
    assert np.linalg.norm(series[170].force) < 1e-6
    force = series.force[:, 2]
    assert force.max() > 0.5
    np.testing.assert_allclose(force, -force[::-1], atol=1e-6)
    assert np.abs(np.diff(force)).max() < 0.2 * force.max()
    np.testing.assert_array_equal(
        series.ambiguous, series.touching & (np.linalg.norm(series.m1, axis=1) < 0.15 * series.m0)
    )
    assert np.all(np.linalg.norm(series.normal, axis=1)[series.ambiguous] < 1.0)


@pytest.mark.parametrize("scheme", ["layer", "cell"])
@pytest.mark.parametrize("center", [(0, 0, 1e3), (-1e9, 0, 0), (0, 1e300, -1e300)], ids=str)
def test_far_away(center: tuple[float, float, float], scheme: str) -> None:
    """There is no contact or force, and `tick` still goes up."""
    contact = contact_on(block(), scheme=scheme)
    felt = contact.step(center, 1.0)
    assert [getattr(felt, name) for name in FLAGS] == [False] * 4
    assert (felt.force.tolist(), contact.tick) == ([0.0, 0.0, 0.0], 1)
    assert (felt.m0, felt.penetration, felt.removed, contact.bone.removed) == (0.0, 0.0, 0.0, 0.0)


def test_ctrl_c_stops_a_run() -> None:
    """The ticks done are kept, and `tick` counts them. The core lets another thread run meanwhile."""
    bone = block()
    contact = contact_on(bone)
    path = np.tile(wandering_path(1000), (400, 1))

    def interrupt() -> None:
        while contact.tick == 0:
            time.sleep(0.001)
        _thread.interrupt_main()

    thread = threading.Thread(target=interrupt)
    thread.start()
    refused((lambda: contact.run(path, 0.01), None, KeyboardInterrupt))
    thread.join()
    assert 0 < contact.tick < len(path)
    again = block()
    contact_on(again).run(path[: contact.tick], 0.01)
    assert again.digest() == bone.digest()
