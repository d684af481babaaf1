"""Penetration velocity does not depend on voxel grid or step: voxel descents against the mean field.

The burr's radius is 3 mm. Seeds are fixed, so results repeat. Means over 8 seeds scatter by 0.3 % at 0.4 mm
and below 0.1 % at 0.2 mm, far inside every bound.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from burrlab import (
    Burr,
    Descent,
    DescentSettings,
    ForceController,
    LabelVolume,
    Material,
    Specimen,
    VoxelBone,
    descend,
    materials,
    penetration_velocity,
    surface_along,
)
from burrlab.anatomy import labelled_bone, temporal_bone
from burrlab.bone.tissues import LABEL_SCATTER, default_tissues
from burrlab.theory.closed_forms import contact_stiffness
from burrlab.theory.continuum import MasterCurve

BURR = Burr(3.0)
FORCES = (0.3, 0.5, 1.0, 2.0)  # [N]
VOXELS = (0.4, 0.2, 0.1)  # [mm]
STEPS = (0.25, 0.5, 1.0, 2.0)  # [ms]
ALPHA = {"constant": 0.01, "parabolic": 0.087, "quartic": 0.5}  # of a law at 1 N, for velocities alike [1/ms]


@dataclass(frozen=True)
class Case:
    """Exact-force descents that differ only by seed."""

    material: str
    force: float
    voxel: float
    dt: float = 1.0
    shape: str = "parabolic"
    scheme: str = "layer"
    seeds: int = 8  # a seed also draws the place of the burr within a voxel
    law: tuple[float, float] | None = None  # exponents of force and rate; u = 0.12 at 1 N


def material_of(case: Case) -> Material:
    if case.law is not None:
        q, m = case.law
        c_e, alpha = 1.0 / (BURR.radius**2 * 0.12**q), ALPHA[case.shape]
        return Material("law", c_e=c_e, alpha=alpha, shape=case.shape, force_exponent=q, rate_exponent=m)
    known = materials[case.material]
    return Material(known.name, c_e=known.c_e, alpha=known.alpha, shape=case.shape)


@cache
def velocities(case: Case) -> tuple[float, ...]:
    """Penetration velocities of all seeds [mm/s]."""
    options = {
        "voxel": case.voxel,
        "settings": DescentSettings(dt=case.dt, scheme=case.scheme),
        "ideal": True,
    }

    def velocity(seed: int) -> float:
        run = descend(BURR, material_of(case), case.force, seed=seed, **options)
        assert run.penetration_velocity is not None, run
        return run.penetration_velocity

    with ThreadPoolExecutor(2) as pool:
        return tuple(pool.map(velocity, range(case.seeds)))


def deviation(case: Case) -> float:
    """Mean velocity divided by that of the mean field, minus 1."""
    material, force = material_of(case), case.force
    if case.law is None:
        return float(np.mean(velocities(case)) / penetration_velocity(BURR, material, force) - 1)
    phi = (force / (material.c_e * BURR.radius**2)) ** (1.5 / material.force_exponent)
    alpha = material.alpha * force**material.rate_exponent
    ratio = MasterCurve(material.shape).velocity_ratio(phi)
    return float(np.mean(velocities(case)) / (1e3 * alpha * BURR.radius * ratio) - 1)


def slow(*values: object) -> Any:
    return pytest.param(*values, marks=pytest.mark.slow)


# --- With the force held exactly ---------------------------------------------------------------------------

QUICK = [
    *(
        (Case("bone", force, voxel), 0.03)
        for force, voxel in ((0.5, 0.4), (1.0, 0.4), (1.0, 0.2), (2.0, 0.2))
    ),
    (Case("bone", 2.0, 0.4), 0.05),  # the coarsest grid at the highest force
    (Case("pvc", 0.2, 0.2), 0.03),
    (Case("pettigrew", 0.7, 0.2), 0.03),
    (Case("bone", 1.0, 0.2, shape="linear"), 0.04),
    (Case("bone", 2.0, 0.2, shape="quartic"), 0.04),
    *((Case("bone", 0.5, 0.2, dt, "constant"), bound) for dt, bound in ((1.0, 0.06), (0.25, 0.02))),
]
ALL = [
    *((Case("bone", force, voxel), 0.03) for force in FORCES for voxel in VOXELS if (force, voxel) != (2.0, 0.4)),
    *((Case(name, force, voxel), 0.03) for name, force in (("pvc", 0.2), ("pettigrew", 0.7)) for voxel in VOXELS),
    *((Case("bone", 1.0, voxel, shape=shape), 0.04) for shape in ("linear", "quartic") for voxel in VOXELS),
    *((Case("bone", 0.5, voxel, dt, "constant"), bound) for dt, bound in ((1.0, 0.06), (0.25, 0.02)) for voxel in VOXELS),
]  # fmt: skip


@pytest.mark.parametrize(
    ("case", "bound"), [*QUICK, *(slow(*one) for one in ALL if one not in QUICK)], ids=str
)
def test_agrees_with_the_mean_field(case: Case, bound: float) -> None:
    assert abs(deviation(case)) < bound


GRIDS = [  # force [N], voxel [mm], dt [ms], seeds
    *((1.4, voxel, dt, seeds) for voxel, seeds in ((0.3, 8), (0.2, 4), (0.1, 2)) for dt in STEPS),
    *((0.7, voxel, 1.0, seeds) for voxel, seeds in ((0.3, 8), (0.2, 4), (0.1, 2))),
]


@pytest.mark.parametrize("grids", [[(1.4, 0.2, 1.0, 2)], slow(GRIDS)], ids=["quick", "all"])
@pytest.mark.parametrize("m", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("q", [1.0, 1.5, 2.0])
def test_every_law_agrees_with_the_mean_field(
    q: float, m: float, grids: list[tuple[float, float, float, int]]
) -> None:
    """At R/voxel 10, 15 and 30; prints the lowest and highest deviation over the shapes k = 0, 1, 2."""
    for force, voxel, dt, seeds in grids:
        cases = [Case("law", force, voxel, dt, shape, seeds=seeds, law=(q, m)) for shape in ALPHA]
        low, *_, high = sorted(100 * deviation(case) for case in cases)
        print(f"q {q:g}, m {m:g}: {force} N, {voxel} mm, {dt} ms: {low:+.1f} to {high:+.1f} %")
        assert -3.0 < low <= high < 3.0


@pytest.mark.slow
def test_deviation_shrinks_with_the_voxel() -> None:
    """Measured largest deviations over the four forces: 2.6 %, 1.4 %, 0.7 %."""
    coarse, middle, fine = (
        max(abs(deviation(Case("bone", force, voxel))) for force in FORCES) for voxel in VOXELS
    )
    assert coarse > middle > fine


def test_cell_scheme_depends_on_the_grid() -> None:
    """With voxels that erode as a whole (`cell`) a burr at 1 N is over 30 % too slow at 0.4 mm, less on a finer grid."""
    coarse, fine = (deviation(Case("bone", 1.0, voxel, scheme="cell", seeds=2)) for voxel in (0.4, 0.2))
    assert coarse < -0.3
    assert coarse < fine < -0.05


@pytest.mark.parametrize(
    ("force", "voxel", "steps", "seeds"),
    [
        (2.0, 0.2, STEPS, 8),
        *(slow(force, 0.2, STEPS, 8) for force in FORCES[:-1]),
        *(slow(force, 0.1, (0.5, 2.0), 3) for force in FORCES[:2]),  # shorter steps take minutes
        *(slow(force, 0.1, STEPS, 3) for force in FORCES[2:]),
    ],
)
def test_step_independence(force: float, voxel: float, steps: tuple[float, ...], seeds: int) -> None:
    means = [np.mean(velocities(Case("bone", force, voxel, dt, seeds=seeds))) for dt in steps]
    assert max(means) / min(means) - 1 < 0.02


# --- With controller and rig -------------------------------------------------------------------------------


@cache
def rig_run(material: str, force: float, voxel: float, seed: int) -> tuple[Descent, Descent]:
    """One descent through controller and rig, and one with the force held exactly."""
    chosen = materials[material]
    run = descend(BURR, chosen, force, voxel=voxel, seed=seed)
    return run, descend(BURR, chosen, force, voxel=voxel, seed=seed, ideal=True)


BONE_FORCES, PVC_FORCES = (0.5, 0.75, 1.0, 1.25, 1.5), (0.1, 0.15, 0.2)
RUNS = [*(("bone", force) for force in BONE_FORCES), *(("pvc", force) for force in PVC_FORCES)]


@pytest.mark.parametrize(
    ("material", "force", "voxel", "seeds"),
    [("bone", 1.0, 0.2, 2), *(slow(*run, voxel, seeds) for run in RUNS for voxel, seeds in ((0.2, 8), (0.1, 2)))],
)  # fmt: skip
def test_controller(material: str, force: float, voxel: float, seeds: int) -> None:
    """Means are within 5 % of the mean field; where runs settle before R/6, within 3 % of exact force."""
    with ThreadPoolExecutor(2) as pool:
        pairs = list(pool.map(lambda seed: rig_run(material, force, voxel, seed), range(seeds)))
    for run, exact in pairs:
        assert exact.duration > 0.29
        assert run.status == "ok", run
    to_mean_field = [
        run.penetration_velocity / penetration_velocity(BURR, materials[material], force, *run.window) - 1
        for run, _ in pairs
    ]
    to_exact = [
        run.penetration_velocity / exact.penetration_velocity - 1
        for run, exact in pairs
        if run.window[0] <= BURR.radius / 6
    ]
    assert abs(np.mean(to_mean_field)) < 0.05
    if to_exact:
        assert abs(np.mean(to_exact)) < 0.03


def test_fixed_gains_settle_in_pvc_where_the_default_does_not() -> None:
    """The rule and the numbers of docs/descent.md, at 0.3 N."""
    pvc, force = materials["pvc"], 0.3
    kp = 200 / contact_stiffness(pvc.c_e, BURR.radius, force, 0.75)
    run = descend(BURR, pvc, force, seed=1, controller=ForceController(kp, kp / 0.03))
    assert (rig_run("pvc", force, 0.1, 1)[0].status, run.status) == ("never-settled", "ok")
    assert run.penetration_velocity == pytest.approx(
        penetration_velocity(BURR, pvc, force, *run.window), rel=0.04
    )


FAST = [("bone", 2.25), ("bone", 2.5), ("bone", 3.0), ("pvc", 0.45), ("pvc", 0.6)]


@pytest.mark.parametrize(
    ("material", "force", "voxel", "seeds"),
    [("bone", 2.5, 0.4, 1), *(slow(*run, voxel, 4) for run in FAST for voxel in (0.4, 0.2))],
)
def test_too_fast_for_the_controller(material: str, force: float, voxel: float, seeds: int) -> None:
    for seed in range(seeds):
        run, _ = rig_run(material, force, voxel, seed)
        assert (run.status, run.penetration_velocity) == ("never-settled", None), run


@pytest.mark.slow
@pytest.mark.parametrize(("material", "force"), [("bone", 1.0), ("pvc", 0.15)])
def test_settles_before_a_sixth_of_the_radius(material: str, force: float) -> None:
    """These runs have the default window, so their velocities compare with those at exact force."""
    run, _ = rig_run(material, force, 0.1, 0)
    assert run.window is not None
    assert run.window[0] == pytest.approx(BURR.radius / 6)


# --- On the voxels of labels alone, velocities at one place scatter as docs/beyond_the_paper.md says -----------


def scatter(bone: VoxelBone, entry: np.ndarray, axis: np.ndarray, radius: float) -> float:
    """Standard deviation over mean [%] of the velocities at 12 places within 0.6 mm, force held exactly."""
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(12)
    places = 0.6 * np.sqrt((np.arange(12) + 0.5) / 12) * np.array([np.cos(turn), np.sin(turn)])
    found = []
    for seed, place in enumerate(places.T @ np.linalg.svd(axis[None])[2][1:]):
        surface = surface_along(bone, entry + place - 4.5 * axis, axis)
        assert surface is not None
        there, force = Specimen(bone, surface, axis), radius**2 / 9
        run = descend(Burr(radius), materials["bone"], force, seed=seed, ideal=True, specimen=there)
        found.append(run.penetration_velocity)
    return float(100 * np.std(found, ddof=1) / np.mean(found))


def bone_of(solid: np.ndarray, voxel: float, origin: np.ndarray, width: float) -> VoxelBone:
    labels = LabelVolume(solid.astype(np.uint8), voxel, origin, np.eye(3), "made", {1: "bone"})
    return labelled_bone(None, labels, default_tissues(labels), smooth=width * voxel or None).bone


def on_planes(ratio: float, rough: float, width: float) -> list[float]:
    """R = 3 mm on surfaces tilted against the voxels; `rough` and the smoothing's `width` are in voxels."""
    voxel, found = 3.0 / ratio, []
    at = (np.arange(-round(6 / voxel), round(6 / voxel)) + 0.5) * voxel
    noise = gaussian_filter(np.random.default_rng(1).normal(size=(len(at),) * 3), 1.0)
    noise *= rough * voxel / noise.std()
    for tilt in np.radians((3, 5, 10, 17, 25, 35)):
        axis = np.array([np.sin(tilt) * np.cos(0.3), np.sin(tilt) * np.sin(0.3), -np.cos(tilt)])
        depth = at[:, None, None] * axis[2] + at[:, None] * axis[1] + at * axis[0]
        found.append(scatter(bone_of(depth + noise > 0, voxel, at[[0, 0, 0]], width), np.zeros(3), axis, 3.0))
    return found


def on_phantom(ratio: float, width: float) -> list[float]:
    """Six places of the phantom: voxels of 0.1 mm that are at least half full count as bone."""
    phantom = temporal_bone(0.1, seed=1, size=(12, 18, 18), corner=(-4, -1, -9.5))
    bone = bone_of(phantom.bone.density >= 128, 0.1, np.array(phantom.bone.origin), width)
    places = np.array([(0, 0), (4, 0), (-4, 0), (0, 4), (0, -4), (3, 3)])
    places = phantom.entry + places @ np.linalg.svd(phantom.axis[None])[2][1:]
    return [scatter(bone, place, phantom.axis, 0.1 * ratio) for place in places]


@pytest.mark.slow
@pytest.mark.parametrize("width", [0, 2])
@pytest.mark.parametrize("ratio", LABEL_SCATTER)
def test_scatter_at_one_place(ratio: int, width: int) -> None:
    groups = on_planes(ratio, 0, width), on_planes(ratio, 0.5, width), on_phantom(ratio, width)
    found = [float(np.sqrt(np.mean(np.square(group)))) for group in groups]
    print(ratio, width, np.round(found, 1))
    assert (round(min(found)), round(max(found))) == LABEL_SCATTER[ratio][width > 0]
