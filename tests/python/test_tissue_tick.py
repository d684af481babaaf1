"""The tick in a bone with tissues equals the slow reference; split tissues and CPU paths change nothing."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from session_scenes import ended, refused, session_of
from test_tick_reference import scenes
from tick_scenes import (
    ALL_SHAPES,
    SCHEMES,
    SKEW,
    Scene,
    assert_same_sums,
    check_scene,
    make_pair,
    numbers_of,
    on_every_path,
    scene_of,
    table_of_tissues,
    tissues_of,
)

from burrlab import (
    Burr,
    BurrContact,
    HandDevice,
    Material,
    Tissue,
    Tissues,
    VoxelBone,
    _core,
    erode,
    load_trace,
    materials,
    replay,
)
from reference.tick import ReferenceTissues

PATHS = tuple(_core.cpu_paths())
BONE, PVC = materials["bone"], materials["pvc"]

pytestmark = pytest.mark.usefixtures("keep_cpu_path")


# --- Against the reference ----------------------------------------------------------------------------------


@pytest.mark.parametrize("spacing", [(0.2, 0.2, 0.2), SKEW], ids=["equal", "skew"])
@pytest.mark.parametrize(
    ("kind", "count"), [("one", 2), ("bricks", 5), ("halves", 7), ("random", 16), ("random", 64)]
)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_kinds_of_bricks(scheme: str, kind: str, count: int, spacing: tuple[float, float, float]) -> None:
    """Bricks hold one tissue, two or many; the volume ends within a brick."""
    for fill in ("solid", "random"):
        scene = scene_of(scheme, "parabolic", spacing=spacing, fill=fill)
        assert check_scene(scene, tissues_of(kind, scene.size, count)) > 0.0


@pytest.mark.parametrize("shape", ALL_SHAPES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_shapes(scheme: str, shape: str) -> None:
    for spacing in ((0.2, 0.2, 0.2), SKEW):
        scene = scene_of(scheme, shape, spacing=spacing, fill="random", seed=2**64 - 1)
        assert check_scene(scene, tissues_of("random", scene.size, 16)) > 0.0


@pytest.mark.parametrize("rates", [(0.087,), (0.0, 0.0625), (0.3, 0.087), (2.0, 0.0), (40.0, 0.1)], ids=str)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_rates(scheme: str, rates: tuple[float, ...]) -> None:
    """Rates with and without doublings, and of zero; faint levels are counted too. Tissues may be alike."""
    for kind, stiffnesses in (("random", 5), ("random", 1), ("random", 2), ("bricks", 5)):
        scene = scene_of(scheme, "parabolic", fill="faint", size=(17, 25, 31))
        assert check_scene(scene, tissues_of(kind, scene.size, 5, rates, stiffnesses)) > 0.0


@settings(max_examples=80, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(scenes(), st.sampled_from(["one", "bricks", "halves", "random"]), st.integers(1, 64))
def test_any_scene_equals_reference(scene: Scene, kind: str, count: int) -> None:
    removed = check_scene(scene, tissues_of(kind, scene.size, count, (scene.alpha, 0.0, scene.alpha / 7)))
    event(f"erodes: {removed > 0.0}")


@pytest.mark.parametrize("kind", ["halves", "random"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_probe_then_erode_is_a_step(scheme: str, kind: str) -> None:
    """The sphere covers whole bricks, which are weighed by tissue if they hold few."""
    scene = scene_of(scheme, "parabolic", size=(48, 48, 48), ratio=18.0, fill="random")
    tissues = tissues_of(kind, scene.size, 16, (0.087, 0.3))
    cores, reference = on_every_path(scene, tissues)
    for center in scene.centers()[:2]:
        expected: Any = reference.step(center, scene.dt)
        for core in cores:
            got = core.probe(center)
            assert got.c_e == expected["c_e"]
            assert got.force.tolist() == pytest.approx(expected["force"].tolist(), rel=1e-12)
            core.erode(center, scene.dt)
            np.testing.assert_array_equal(core.bone.density, reference.q)
            assert_same_sums(core.bone, tissues.number)


# --- What must not matter -----------------------------------------------------------------------------------


def felt(scene: Scene, tissues: ReferenceTissues | None, c_e: float = 2.145) -> tuple[bytes, list[Any]]:
    """Last levels, and forces, removed volumes and c_e; without tissues in a plain bone of `c_e`."""
    core, _ = make_pair(scene, tissues)
    if tissues is None:
        material = Material("any", c_e=c_e, alpha=scene.alpha, shape=scene.shape)
        core = BurrContact(core.bone, core.burr, material, scene.seed, scene.index, scheme=scene.scheme)
        core.tick = scene.tick
    run = core.run(np.array(scene.centers()), scene.dt)
    return core.bone.density.tobytes(), [
        run.force.tolist(),
        run.removed.tolist(),
        run.c_e[run.touching].tolist(),
    ]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_one_tissue_is_a_plain_bone(cpu_path: str, scheme: str) -> None:
    """Both are equal to the last bit, also where the sum of K M is beyond 2^53."""
    for k in (1, 8786, 4_095_999, 4_096_000):
        scene = scene_of(scheme, "parabolic", size=(66, 66, 66), ratio=28.0, fill="solid")
        scene = replace(scene, steps=scene.steps[:2])
        one = ReferenceTissues(np.zeros(scene.size, np.uint8), [k / 4096], [scene.alpha])
        assert felt(scene, one) == felt(scene, None, k / 4096)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_splitting_a_tissue_changes_nothing(cpu_path: str, scheme: str) -> None:
    """16 or 40 tissues with equal values, at random by voxel, act as one."""
    scene = scene_of(scheme, "quartic", fill="random", spacing=SKEW, alpha=0.2)
    whole = felt(scene, ReferenceTissues(np.zeros(scene.size, np.uint8), [2.0], [0.2]))
    for count in (16, 40):
        numbers = numbers_of("random", scene.size, count)
        assert felt(scene, ReferenceTissues(numbers, [2.0] * count, [0.2] * count)) == whole


def mixed_bone(size: tuple[int, int, int]) -> tuple[VoxelBone, ReferenceTissues]:
    """A block below z = 0 of sixteen tissues at random."""
    x, y, z = size
    bone = VoxelBone.block(size, 0.2, origin=(0.1 - x / 2, 0.1 - y / 2, 0.1 - z))
    tissues = tissues_of("random", bone.shape, 16, (0.087, 0.3))
    tissues = replace(tissues, c_e=[0.5 + 0.25 * i for i in range(16)])
    bone.set_tissues(table_of_tissues(tissues, BONE), tissues.number)
    return bone, tissues


def test_a_held_force_in_a_mixed_bone_is_the_same_on_every_path() -> None:
    found = set()
    for path in PATHS:
        _core.use_cpu_path(path)
        bone, _ = mixed_bone((8, 8, 3))
        held = BurrContact(bone, Burr(2.0), BONE, seed=4).hold(
            1.0, (0, 0, 2.2), (0, 0, -1), from_=0.0, travel=0.9, dt=1.0, ticks=200
        )
        assert np.abs(held.force - 1.0).max() < 1e-3
        found.add((bone.digest(), tuple(held.position)))
    assert len(found) == 1


def test_a_session_in_tissues_replays_on_every_path(tmp_path: Path) -> None:
    """Forces, digests and the removed volume of each tissue are equal."""
    bone, tissues = mixed_bone((12, 12, 4))
    tool, options = (Burr(2.0), BONE), {"seed": 1, "duration": 2.0, "wall_clock": False}
    session = ended(session_of(bone, tool, HandDevice(), record=tmp_path / "session.h5", **options))
    carved, tick = session.snapshot()
    assert tick == 2000
    removed = [carved.removed_of(i) for i in range(16)]
    assert min(removed) > 0.0
    trace = load_trace(tmp_path / "session.h5")
    for path in PATHS:
        _core.use_cpu_path(path)
        again = replay(trace)
        assert (again.equal, again.bone.digest(), [again.bone.removed_of(i) for i in range(16)]) == (
            True, carved.digest(), removed,
        )  # fmt: skip
        assert_same_sums(again.bone, tissues.number)


# --- What is refused ----------------------------------------------------------------------------------------


def two_tissues() -> VoxelBone:
    bone = VoxelBone.block((4, 4, 4), 0.2)
    tissues = tissues_of("halves", bone.shape, 2, (0.087, 0.0))
    bone.set_tissues(table_of_tissues(tissues, BONE), tissues.number)
    return bone


def enamel(radius: float, dt: float = 1.0) -> BurrContact:
    bone = VoxelBone.block((1, 1, 1), 0.01)
    rows = [Tissue("enamel", label=1, c_e=1000.0, alpha=0.1)]
    bone.set_tissues(Tissues(rows, BONE), np.zeros(bone.shape, np.uint8))
    contact = BurrContact(bone, Burr(radius), BONE, seed=1)
    return contact if dt == 1.0 else contact.step((0, 0, 0), dt)


GROWING = Material("bone", c_e=2.145, alpha=0.087, force_exponent=2.0, rate_exponent=1.0)
OTHER_MATERIAL = (
    r"material must be that of the bone's tissues, 'bone' \(c_e 2.145, alpha 0.087, parabolic\), got 'pvc'"
)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: BurrContact(two_tissues(), Burr(1.5), PVC, seed=1), OTHER_MATERIAL),
        (lambda: BurrContact(two_tissues(), Burr(1.5), GROWING, seed=1), r"got 'bone' \(.*, force_exponent 2, rate_exponent 1\)"),
        (lambda: erode(two_tissues(), Burr(1.5), (2, 2, 2), PVC, dt=1.0, seed=1, tick=0), OTHER_MATERIAL),
        (lambda: enamel(2.05), "radius over the voxel must be small enough for c_e of the tissues"),
        (lambda: enamel(1.0, 2e5), "alpha dt of 'enamel' must be at most 1000, got 20000"),
    ],
)  # fmt: skip
def test_refused(make: Callable[[], object], text: str) -> None:
    refused((make, text))
    assert enamel(1.99).bone.removed == 0.0  # a burr close to the limit is accepted


def test_tissues_may_come_after_the_burr() -> None:
    """The next tick uses them, or refuses another material; without contact c_e is the material's."""
    bone, plain = two_tissues(), VoxelBone.block((4, 4, 4), 0.2)
    burr, center = Burr(1.5), (2, 2, 4.5)
    late = BurrContact(plain, burr, BONE, seed=1)
    other = BurrContact(plain, burr, PVC, seed=1)
    plain.set_tissues(bone.tissues, bone.tissue_numbers)
    got = BurrContact(bone, burr, BONE, seed=1).run(np.array([[2.0, 2.0, 9.0], center]), 1.0)
    assert late.step((2, 2, 9), 1.0).c_e == got.c_e[0] == 2.145
    assert late.step(center, 1.0).c_e == got.c_e[1] == got[1].c_e != 2.145
    assert plain.digest() == bone.digest()
    refused((lambda: other.step(center, 1.0), "material must be that of the bone's tissues"))
    assert other.probe(center).c_e == late.probe(center).c_e
