"""The descent experiment: modes, windows, statuses, rigs."""

import dataclasses
import importlib
import inspect
import itertools
import pkgutil
import re
import sys
import threading
from unittest.mock import Mock

import numpy as np
import pytest
from session_scenes import refused

import burrlab
from burrlab.descent.descent import _first_contact
from burrlab.theory.closed_forms import (
    contact_stiffness,
    layer_thickness,
    penetration_velocity_between,
    samples_between,
    settled_immersion,
    static_immersion,
)

BURR, BONE, PVC = burrlab.Burr(3.0), burrlab.materials["bone"], burrlab.materials["pvc"]
ARRAYS = re.compile(r"ndarray|NDArray|Array\b|Floats|^Any$")


def virtual(material=BONE, voxel=0.4, *, seed=5, **options):
    """A virtual rig over a half-space."""
    specimen = burrlab.half_space(BURR, voxel, depth=2.0)
    return burrlab.VirtualRig(
        burrlab.BurrContact(specimen.bone, BURR, material, seed=seed), specimen, **options
    )


@pytest.fixture(scope="module")
def known():
    """A descent with controller and rig."""
    return burrlab.descend(BURR, BONE, 0.8, voxel=0.2, seed=5)


def test_exact_mode_holds_the_force_and_begins_at_static_contact():
    run = burrlab.descend(BURR, BONE, 1.0, voxel=0.2, seed=3, ideal=True)
    assert run.status == "ok"
    np.testing.assert_allclose(run.force, 1.0, rtol=1e-4)
    assert run.immersion[0] == pytest.approx(static_immersion(BURR, BONE, 1.0), rel=0.01)
    assert np.all(np.diff(run.immersion) > -1e-4)
    assert run.window == (0.5, 1.0)
    assert run.velocity_fall > 1.5, "velocity falls although the force is constant"
    assert run.layer_resolution == pytest.approx(layer_thickness(BURR, BONE, run.penetration_velocity) / 0.2)
    deeper = burrlab.descend(BURR, BONE, 2.5, voxel=0.2, seed=3, ideal=True)
    assert deeper.window[0] == pytest.approx(static_immersion(BURR, BONE, 2.5), rel=0.01)
    assert deeper.window[0] > BURR.radius / 6


def test_same_seed_same_run_and_seed_is_recorded():
    given = {"voxel": 0.4, "ideal": True}
    first = burrlab.descend(BURR, BONE, 1.0, **given)
    seed = first.provenance["seed"]
    again, other = (burrlab.descend(BURR, BONE, 1.0, seed=one, **given) for one in (seed, seed ^ 1))
    assert np.array_equal(first.immersion, again.immersion)
    assert first.provenance["digest"] == again.provenance["digest"] != other.provenance["digest"]


SOFT, HARD, BUTTER = (
    burrlab.Material(name, c_e=c_e, alpha=alpha)
    for name, c_e, alpha in (("soft", 0.5, 2.0), ("hard", 2.0, 0.0), ("butter", 2.0, 50.0))
)
EMPTY = burrlab.Specimen(
    burrlab.VoxelBone(np.zeros((20, 40, 40), np.uint8), spacing=0.2),
    np.full(3, 4.0),
    np.array([0.0, 0.0, -1.0]),
)
CANCEL = threading.Event()
CANCEL.set()


@pytest.mark.parametrize(
    ("material", "force", "options", "status", "reason"),
    [
        (PVC, 1.0, {"ideal": True}, "overloaded", "not reached by static contact"),
        (PVC, 1.0, {"ideal": False}, "overloaded", "not reached by static contact"),
        (PVC, 0.6, {"voxel": 0.2}, "never-settled", "over 5 %"),
        (SOFT, 0.8, {"voxel": 0.2, "ideal": True}, "window-too-short", "10 are needed"),
        (
            BONE,
            0.5,
            {"voxel": 0.2, "settings": burrlab.DescentSettings(stop=0.6)},
            "window-too-short",
            "R/15",
        ),
        (
            HARD,
            1.0,
            {"ideal": True, "settings": burrlab.DescentSettings(max_duration=0.2)},
            "stalled",
            "when the run was given up",
        ),
        # A run without time for contact is not overloaded; a run that cut bone has touched it.
        (
            BONE,
            1.0,
            {"settings": burrlab.DescentSettings(max_duration=0.1)},
            "stalled",
            "when the run was given up",
        ),
        (BUTTER, 1.0, {}, "never-settled", "over 5 %"),
        (BONE, 1.0, {"specimen": EMPTY, "ideal": True}, "never-touched", "no bone"),
        (BONE, 1.0, {"specimen": EMPTY}, "never-touched", "no bone"),
        # An interrupted run keeps its record.
        (BONE, 0.3, {"ideal": True, "cancel": CANCEL}, "interrupted", "at an immersion of 0."),
        (BONE, 0.3, {"cancel": CANCEL}, "interrupted", "at an immersion of"),
        (
            BONE,
            0.3,
            {"ideal": True, "progress": Mock(side_effect=KeyboardInterrupt)},
            "interrupted",
            "at an immersion of 0.",
        ),
    ],
)
def test_a_run_without_a_velocity_says_why(material, force, options, status, reason):
    run = burrlab.descend(BURR, material, force, **{"voxel": 0.4, "seed": 1, **options})
    assert (run.status, run.penetration_velocity, run.window) == (status, None, None)
    assert reason in run.reason
    assert reason != "10 are needed" or len(run.time) < 10
    assert status != "interrupted" or len(run.time) > 0


def test_progress_rises_to_the_stop():
    seen: list[float] = []
    burrlab.descend(BURR, BONE, 0.5, voxel=0.4, seed=1, ideal=True, progress=seen.append)
    assert len(seen) > 3
    assert seen == sorted(seen)
    assert seen[-1] > 0.9


def test_every_imperfection_can_be_switched_off():
    rig = virtual(lag=0, encoder_step=0, noise=0, force_filter=0)
    rig.command(2.0)
    reading = rig.read()
    assert (reading.position, reading.force) == (pytest.approx(-0.2 + 0.002, abs=1e-12), 0.0)
    rig.command(99.0)
    assert rig.read().position == pytest.approx(-0.198 + 0.01, abs=1e-12), "the velocity limit holds"


def test_own_controller_and_rig():
    pid = burrlab.ForceController(kp=5.0, ki=100.0, output_limits=(-10, 10))
    run = burrlab.descend(BURR, BONE, 0.8, rig=virtual(voxel=0.2), controller=pid)
    assert run.status == "ok"
    pid.reset()  # the gains of the caller's controller are left alone
    assert pid.update(0.01, 0.0, 1.0) == pytest.approx(5.0 * 0.01 + 100.0 * 0.01 * 1e-3)
    assert run.penetration_velocity == pytest.approx(0.275, rel=0.08)


class Laboratory:
    """A rig with unknown material and surface, like a real one; `fault` can spoil its readings."""

    def __init__(self, inner, fault=lambda reading: reading, force_limit=10.0):
        self.inner, self.period, self.force_limit, self.surface = inner, inner.period, force_limit, None
        self.fault, self.last = fault, None

    def read(self):
        position, force = self.inner.read()
        return self.fault(burrlab.RigReading(position + 37.0, force))

    def command(self, velocity):
        self.last = velocity
        self.inner.command(velocity)


def test_unknown_rig_finds_surface_and_stiffness_from_first_contact(known):
    rig = Laboratory(virtual(voxel=0.2))
    assert isinstance(rig, burrlab.Rig)
    run = burrlab.descend(BURR, None, 0.8, rig=rig)
    assert run.status == "ok"
    assert run.immersion[0] == pytest.approx(-0.2, abs=0.06), "zero of the immersion"
    assert run.penetration_velocity == pytest.approx(known.penetration_velocity, rel=0.1)
    # In a very stiff material the force rises within one step of 50 um: the surface is right to a step.
    rig = virtual(burrlab.Material("stiff", c_e=400.0, alpha=0.5), 0.1, encoder_step=0.05)
    run = burrlab.descend(
        BURR, None, 1.0, rig=Laboratory(rig), settings=burrlab.DescentSettings(max_duration=1.0)
    )
    assert run.immersion[0] == pytest.approx(-0.2, abs=0.06)


@pytest.mark.parametrize(("q", "alpha"), [(1.0, 0.1), (2.0, 0.03)])
def test_a_rig_meets_a_bone_of_another_law(q, alpha):
    """Gains, surface and velocity follow the law; on flat bone k = q c_e R u^(q-1)."""
    material = burrlab.Material("law", c_e=2.0, alpha=alpha, force_exponent=q, rate_exponent=0.5)
    rig = Laboratory(virtual(material, 0.2))
    assert contact_stiffness(2.0, 3.0, 0.8, 0.0, q) == pytest.approx(q * 6.0 * (0.8 / 18.0) ** (1 - 1 / q))
    run = burrlab.descend(BURR, material, 0.8, rig=rig)
    held = burrlab.descend(BURR, material, 0.8, voxel=0.2, seed=5, ideal=True)
    assert run.status == "ok"
    assert run.immersion[0] == pytest.approx(-0.2, abs=0.06)
    assert run.penetration_velocity == pytest.approx(held.penetration_velocity, rel=0.1)
    rows = [
        (h, material.c_e * BURR.radius**2 * max(h / BURR.radius, 0.0) ** q, 1.0)
        for h in np.arange(-0.2, 0.2, 0.01)
    ]
    assert _first_contact(rows, 0.01, BURR.radius, q) == pytest.approx((2.0, 0.0), rel=1e-6, abs=1e-9)


def test_series_frame_save_and_load(known, tmp_path, monkeypatch):
    pandas = pytest.importorskip("pandas")
    frame = known.to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == ["time_s", "immersion_mm", "force_N", "velocity_mm_s", "command_mm_s"]
    known.save(tmp_path / "run.json")
    back = burrlab.Descent.load(tmp_path / "run.json")
    assert (back.to_dict(), back) == (known.to_dict(), known)
    assert "force_exponent" not in known.to_dict()["material"]
    law = burrlab.Material("wax", c_e=2.0, alpha=0.1, force_exponent=2.0, rate_exponent=0.5)
    dataclasses.replace(known, material=law).save(tmp_path / "law.json")
    assert burrlab.Descent.load(tmp_path / "law.json").material == law
    (tmp_path / "law.json").write_text(
        (tmp_path / "law.json").read_text().replace('exponent": 2.0', 'exponent": 0.5')
    )
    rule = r"law.json: .*force_exponent must be 1 to 8, got 0.5"
    refused((lambda: burrlab.Descent.load(tmp_path / "law.json"), rule))
    assert back != burrlab.descend(BURR, BONE, 1.0, voxel=0.4, seed=2)
    monkeypatch.setitem(sys.modules, "pandas", None)
    refused((known.to_dataframe, "needs pandas", ImportError))


def test_results_with_arrays_are_compared():
    """Comparison gives True or False, never NumPy's error about an ambiguous truth value."""
    found = 0
    for module in {part.name for part in pkgutil.walk_packages(burrlab.__path__, "burrlab.")}:
        kinds = [] if module.endswith("__main__") else vars(importlib.import_module(module)).values()
        kinds = [kind for kind in kinds if isinstance(kind, type) and kind.__module__ == module]
        for kind in filter(dataclasses.is_dataclass, kinds):
            columns = {f.name: bool(ARRAYS.search(str(f.type))) for f in dataclasses.fields(kind)}
            if kind.__name__.startswith("_") or inspect.isabstract(kind) or not any(columns.values()):
                continue
            one, other = object.__new__(kind), object.__new__(kind)
            for made, (name, is_array) in itertools.product((one, other), columns.items()):
                object.__setattr__(made, name, np.array([1.0, np.nan]) if is_array else 1)
            assert (one == other) in (True, False), kind
            found += 1
    assert found > 40


def test_coarse_and_faint_are_said():
    assert any(
        "coarse" in text
        for text in burrlab.descend(burrlab.Burr(2.0), BONE, 0.5, voxel=0.4, seed=1, ideal=True).warnings
    )
    thin = burrlab.VoxelBone.block((6, 6, 2), 0.2, origin=(-3, -3, -1.9), level=20)
    faint = burrlab.descend(
        burrlab.Burr(2.0), BONE, 0.02, seed=1, ideal=True,
        specimen=burrlab.Specimen(thin, np.zeros(3), np.array([0.0, 0.0, -1.0])),
    )  # fmt: skip
    assert any("faint" in text for text in faint.warnings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force": 0.0}, "force must be positive and finite, got 0"),
        ({"force": float("nan")}, "force must be positive and finite, got nan"),
        ({"force": 25.0}, "force must be within the rig's range of 20 N, got 25 N"),
        ({"dt": -1.0}, "dt must be positive and finite, got -1"),
        ({"stop": 0.0}, "stop must be positive and finite, got 0"),
        ({"max_duration": 0.0}, "max_duration must be positive"),
        ({"max_duration": 1e306}, "max_duration must be below 2\\^63 ticks of 1 ms, got 1e\\+306 s"),
        ({"seed": -1}, "seed must be a whole number from 0 and below 2\\^64, got -1"),
        ({"voxel": -0.1}, "voxel must be a number or three from 1e-6 to 1e6"),
        ({"voxel": 1.0}, "radius must be at least 4 voxels, got 3; a spacing of 0.4 mm or finer would do"),
        ({"voxel": 4.0}, "voxel must be at most R = 3 mm, got 4 mm"),
        ({"voxel": 0.001}, r"voxel must be coarser: a block for R = 3 mm at 0\.001 mm has"),
        ({"scheme": "cube"}, "scheme must be layer or cell, got 'cube'"),
        ({"material": None}, "material must be given unless a rig of your own is"),
    ],
)  # fmt: skip
def test_bad_input(change, message):
    arguments = {"material": BONE, "force": 1.0, "voxel": 0.4, "seed": 1} | change
    material, force = arguments.pop("material"), arguments.pop("force")
    settings = {
        name: arguments.pop(name) for name in ("dt", "stop", "max_duration", "scheme") if name in arguments
    }
    refused(
        (lambda: burrlab.descend(BURR, material, force, settings=burrlab.DescentSettings(**settings), **arguments),
         message),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"noise": -1.0}, "noise must be zero or positive"), ({"period": 0.0}, "period must be positive"),
        ({"clearance": float("nan")}, "clearance must be finite"),
    ],
)  # fmt: skip
def test_bad_rig(change, message):
    refused((lambda: virtual(**change), message))


def test_stiffness_is_the_slope_of_the_force():
    """k = dF/dH in a carved hole, compared with a difference of the voxel force."""
    cut = burrlab.half_space(BURR, 0.1)
    contact = burrlab.BurrContact(cut.bone, BURR, BONE, seed=1)
    held = contact.hold(1.0, cut.center(0.0, BURR), cut.axis, from_=-0.2, travel=0.9, dt=1.0, ticks=10**6)
    depth, step = float(held.position[-1]), 1e-3
    above, below = (
        -float(contact.probe(cut.center(depth + d, BURR)).force @ cut.axis) for d in (-step, step)
    )
    assert (below - above) / (2 * step) == pytest.approx(
        contact_stiffness(BONE.c_e, BURR.radius, (above + below) / 2, depth), rel=0.1
    )


def test_window_functions():
    time = np.arange(100) * 0.01
    h = 0.5 * time
    assert penetration_velocity_between(time, h, 0.1, 0.4) == pytest.approx(0.5)
    assert penetration_velocity_between(time, h, 0.6, 0.9) is None
    assert samples_between(h, 0.1, 0.2) == slice(20, 41)
    force = np.where(np.arange(100) < 30, 2.0, 1.0)
    assert settled_immersion(h, force, 1.0, span=11) == pytest.approx(h[35])
    assert settled_immersion(h, 2 * force, 1.0, span=11) is None
    assert settled_immersion(h[:5], force[:5], 1.0, span=11) is None


@pytest.mark.parametrize(
    ("fault", "outcome"),
    [
        (lambda r: r._replace(force=-r.force), "force must be positive where bone pushes"),
        (lambda r: r._replace(force=float("nan")), "reading must be finite"),
        (lambda r: r._replace(position=float("nan")), "reading must be finite"),
        (lambda r: r._replace(position=1.0), "position must change before its force rises"),
        (lambda r: r._replace(force=0.0), "never-touched"),
        (lambda r: r._replace(force=5.0), "out-of-range"),
    ],
)
def test_a_faulty_rig_is_stopped(fault, outcome):
    rig = Laboratory(virtual(), fault, 5.0)
    if " " in outcome:
        refused((lambda: burrlab.descend(BURR, None, 0.8, rig=rig), outcome))
    else:
        assert burrlab.descend(BURR, None, 0.8, rig=rig).status == outcome
    assert rig.last == 0.0
    assert abs(rig.inner.immersion) < 21


def test_the_seed_of_a_rig_is_the_one_that_acted():
    assert burrlab.descend(BURR, BONE, 1.5, rig=virtual(seed=77)).provenance["seed"] == 77
    assert burrlab.descend(BURR, None, 1.5, rig=Laboratory(virtual(seed=77))).provenance["seed"] is None


def test_a_plot_ends_above_the_velocity_in_the_window():
    """Before the window an exact run is faster by orders of magnitude."""
    run = burrlab.descend(BURR, BONE, 0.5, voxel=0.4, ideal=True, seed=1)
    inside = samples_between(run.immersion, *run.window)
    assert run.plot()[-1].get_ylim() == pytest.approx((0, 1.2 * run.velocity[inside].max()))
