"""Forces along prescribed paths on a coarse `layer` grid against a fine `cell` grid.

The reference is `cell` on voxels four times finer, which resolve the layer in which the burr cuts.
On the coarse grid `layer` must add no jump and no wrong direction.

One limit is known and measured here. The rest of a cut voxel counts as lying outside the sphere, so the force
falls too early when the burr backs out of a cut, and rises as steeply when the burr returns.
"""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import burrlab

Floats = NDArray[np.float64]
BURR = burrlab.Burr(3.0)
BONE = burrlab.materials["bone"]
COARSE, FINE = 0.2, 0.05  # [mm]: R/s = 15 and 60
DT = 1.0  # [ms]
SEEDS = (1, 2)
MEANINGFUL = 0.1  # of the path's largest force; directions of smaller forces are not compared
ANGLE = 5.0  # [degrees], at the 99th percentile
JUMP_MARGIN = 1.1  # times the reference's largest change in one tick; both are maxima of a random series


def moves(*legs: tuple[tuple[float, float, float], float]) -> Floats:
    """Tip positions through points; each leg has a largest speed [mm/s] and starts and ends at rest."""
    start, points = np.array(legs[0][0]), []
    for goal, speed in legs[1:]:
        way = np.array(goal) - start
        ticks = max(2, int(np.ceil(np.linalg.norm(way) / speed * 1e3 / DT * np.pi / 2)))
        points.append(start + (0.5 - 0.5 * np.cos(np.pi * np.arange(ticks) / ticks))[:, None] * way)
        start = np.array(goal)
    return np.concatenate(points)


def slide() -> tuple[float, Floats]:
    """Into the surface, along it, out of the cut, down again near its end, and back a little deeper."""
    tips = moves(
        ((-1.2, 0, 0.1), 0), ((-1.2, 0, -0.4), 4), ((1.2, 0.03, -0.4), 10), ((1.2, 0.03, 0.3), 10),
        ((1.0, 0.03, 0.1), 10), ((0.9, 0.03, -0.5), 4), ((-1.2, 0, -0.5), 10), ((-1.2, 0, 0.2), 10),
    )  # fmt: skip
    return 1.6, tips + (0, 0, BURR.radius)


def second_hole() -> tuple[float, Floats]:
    """A hole, then another that cuts into its flank."""
    tips = moves(
        ((-0.6, 0, 0.1), 0), ((-0.6, 0, -0.7), 4), ((-0.6, 0, 0.2), 10), ((0.6, 0.2, 0.2), 10), ((0.6, 0.2, -0.7), 4),
        ((0.6, 0.2, 0.2), 10),
    )  # fmt: skip
    return 1.6, tips + (0, 0, BURR.radius)


def both_sides() -> tuple[float, Floats]:
    """A plate of 1.2 mm, cut 0.8 mm from above, then from below until it is through."""
    above = moves(((0, 0, 0.1), 0), ((0, 0, -0.8), 4), ((0, 0, 0.2), 10)) + (0, 0, BURR.radius)
    below = moves(((0.3, 0, -1.3), 0), ((0.3, 0, -0.4), 4), ((0.3, 0, -1.4), 10)) - (0, 0, BURR.radius)
    return 1.2, np.concatenate([above, below])


def break_through() -> tuple[float, Floats]:
    """Through a plate of 0.8 mm, four coarse voxels (with three, directions err by 5.3 to 6.7 degrees)."""
    return 0.8, moves(((0.05, 0.02, 0.1), 0), ((0.05, 0.02, -3.2), 4)) + (0, 0, BURR.radius)


PATHS = {path.__name__: path for path in (slide, second_hole, both_sides, break_through)}


@cache
def felt_along(name: str, scheme: str, voxel: float, seed: int) -> burrlab.ContactSeries:
    thickness, centers = PATHS[name]()
    half = np.abs(centers[:, :2]).max(axis=0) + BURR.radius + 2 * COARSE
    half = np.ceil(half / COARSE) * COARSE  # the blocks of both grids have the same faces
    origin = (-half[0] + voxel / 2, -half[1] + voxel / 2, -thickness + voxel / 2)
    bone = burrlab.VoxelBone.block((2 * half[0], 2 * half[1], thickness), voxel, origin=origin)
    return burrlab.BurrContact(bone, BURR, BONE, seed=seed, scheme=scheme).run(centers, DT)


def jumps(felt: burrlab.ContactSeries) -> Floats:
    """Change of the force in every tick [N]."""
    return np.asarray(np.linalg.norm(np.diff(felt.force, axis=0), axis=1))


def angles(felt: burrlab.ContactSeries, reference: burrlab.ContactSeries) -> Floats:
    """Angles between the two forces [degrees], where both are large enough and neither fades."""
    size, expected = (np.linalg.norm(f.force, axis=1) for f in (felt, reference))
    rows = (np.minimum(size, expected) > MEANINGFUL * expected.max()) & ~felt.ambiguous & ~reference.ambiguous
    cosine = np.sum(felt.force[rows] * reference.force[rows], axis=1) / (size[rows] * expected[rows])
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def largest_jumps(name: str) -> dict[str, tuple[float, float]]:
    """Largest jumps [N] of the coarse run and the reference, while the burr backs out and while not."""
    found: dict[str, list[tuple[float, float]]] = {"out": [], "in": []}
    motion = np.diff(PATHS[name]()[1], axis=0)
    for seed in SEEDS:
        coarse, reference = felt_along(name, "layer", COARSE, seed), felt_along(name, "cell", FINE, seed)
        out = np.sum(motion * reference.force[:-1], axis=1) > 0
        for key, rows in {"out": out, "in": ~out}.items():
            found[key].append((jumps(coarse)[rows].max(initial=0.0), jumps(reference)[rows].max(initial=0.0)))
    return {key: (max(c for c, _ in rows), max(r for _, r in rows)) for key, rows in found.items()}


@pytest.mark.parametrize("name", ["second_hole", "both_sides", "break_through"])
def test_no_jump_above_the_reference_while_cutting(name: str) -> None:
    coarse, reference = largest_jumps(name)["in"]
    assert coarse <= JUMP_MARGIN * reference


@pytest.mark.parametrize("name", ["slide", "second_hole", "both_sides"])
@pytest.mark.xfail(
    strict=True, reason="the force falls too early on retreat: 1.2 to 1.4 times as steeply at R/s = 15"
)
def test_no_jump_above_the_reference_on_the_whole_path(name: str) -> None:
    both = largest_jumps(name).values()
    assert max(coarse for coarse, _ in both) <= JUMP_MARGIN * max(reference for _, reference in both)


@pytest.mark.parametrize("name", ["slide", "second_hole", "both_sides"])
def test_retreat_and_return_are_too_steep_by_no_more_than_stated(name: str) -> None:
    """Changes per tick are up to 1.4 times the reference's; the force is off by up to 13 % of its peak."""
    for coarse, reference in largest_jumps(name).values():
        assert coarse <= 1.4 * reference
    for seed in SEEDS:
        coarse_run, fine_run = felt_along(name, "layer", COARSE, seed), felt_along(name, "cell", FINE, seed)
        off = np.linalg.norm(coarse_run.force - fine_run.force, axis=1).max()
        assert off <= 0.13 * np.linalg.norm(fine_run.force, axis=1).max()


@pytest.mark.parametrize("name", PATHS)
def test_direction_agrees_with_the_reference(name: str) -> None:
    found = np.concatenate(
        [
            angles(felt_along(name, "layer", COARSE, seed), felt_along(name, "cell", FINE, seed))
            for seed in SEEDS
        ]
    )
    assert len(found) > 100
    assert np.percentile(found, 99) <= ANGLE
