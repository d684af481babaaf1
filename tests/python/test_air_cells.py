"""Air cells: given sizes, walls as in a slow calculation, closed cells."""

import math
from functools import lru_cache, partial

import numpy as np
import pytest
from scipy import ndimage, stats

from burrlab.bone.phantom.air_cells import AirCells, Honeycomb, honeycomb
from burrlab.bone.phantom.phantom import temporal_bone
from burrlab.bone.phantom.structures import Grid

FALSE_ALARM = 1e-6


def lattice(side: float, step: float) -> np.ndarray:
    """Points of a cubic lattice in a box of that side [mm], a multiple of the steps used here."""
    places = (np.arange(round(side / step)) + 0.5) * step
    return Grid(places, places, places).points()


@lru_cache(maxsize=4)
def filled(cells: AirCells, seed: int) -> tuple[Honeycomb, np.ndarray]:
    """A honeycomb in a box, and its diameters counted on another lattice."""
    box = partial(lattice, 8 * cells.median_diameter)
    found, step = honeycomb(cells, box, seed), 8 * cells.median_diameter / 55
    return found, np.cbrt(
        6 / math.pi * np.bincount(found.owners(box(step)), minlength=len(found.sites)) * step**3
    )


@pytest.mark.parametrize(
    ("cells", "seed"),
    [
        (AirCells(2.0, 1.4), 5),
        (AirCells(3.0, 1.2, 0.4), 6),
        pytest.param(AirCells(2.5, 1.55), 7, marks=pytest.mark.slow),
    ],
)
def test_sizes_follow_the_distribution_asked_for(cells, seed):
    """Drawn sizes alone would pass; counted ones also have the errors of the weights."""
    found, diameter = filled(cells, seed)
    normal = np.log(diameter / cells.median_diameter) / math.log(cells.geometric_deviation)
    assert stats.kstest(normal, "norm").pvalue > FALSE_ALARM
    assert found.realised.min() > 0
    assert found.vanished <= 0.005 * len(found.sites)
    off = np.log(diameter / found.drawn)
    assert np.quantile(np.abs(off), 0.95) < 0.15
    assert abs(off.mean()) < 0.02
    # Mean and deviation of n logarithms within 4.9 standard errors: one false alarm in a million each.
    sigma, n = math.log(cells.geometric_deviation), len(diameter)
    median, deviation = found.moments
    assert abs(math.log(median / cells.median_diameter)) < 4.9 * sigma / math.sqrt(n)
    assert abs(math.log(deviation) / sigma - 1) < 4.9 / math.sqrt(2 * n) + 0.05


def test_walls_are_where_all_pairs_say():
    """The distance is that to the nearest plane of equal power between the owner and any other cell."""
    found, _ = filled(AirCells(3.0, 1.2, 0.4), 6)
    side = np.linspace(5.0, 9.0, 16)
    grid = Grid(side, side + 2.0, side - 1.0)
    reach = 0.5
    got = found.wall_distance(grid, np.ones(grid.shape, bool), reach).ravel()
    points = grid.points()
    power = ((points[:, None] - found.sites) ** 2).sum(axis=2) - found.weights
    own = np.argmin(power, axis=1)
    apart = np.linalg.norm(found.sites[own][:, None] - found.sites, axis=2)
    apart[np.arange(len(points)), own] = np.inf
    gap = power - power[np.arange(len(points)), own][:, None]
    expected = np.where(np.isinf(apart), np.inf, gap / (2 * apart)).min(axis=1)
    near = expected < reach
    assert 0.2 < near.mean() < 0.9
    np.testing.assert_allclose(got[near], expected[near], atol=1e-5)
    assert np.all(got[~near] >= reach - 1e-5)


def test_cells_are_closed():
    """In voxels half as thick as the walls, the air of two cells never touches."""
    phantom = temporal_bone(0.15, seed=3, size=(6, 6, 6), corner=(3, 10, -8))
    air, parts = ndimage.label(phantom.bone.density < 128)
    x, y, z = (
        o + s * np.arange(n)
        for o, s, n in zip(phantom.bone.origin, phantom.bone.spacing, phantom.bone.shape[::-1], strict=True)
    )
    own = phantom.cells.owners(Grid(x, y, z).points()).reshape(air.shape)
    assert parts > 10
    for part in range(1, parts + 1):
        assert len(np.unique(own[air == part])) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.5,), "median_diameter must be 0.8 to 8 mm, got 0.5"),
        ((2.0, 2.5), "geometric_deviation must be 1 to 2, got 2.5"),
        ((2.0, 1.4, 1.5), "wall must be between 0.05 mm and half the median diameter, 1 mm, got 1.5"),
        ((float("nan"),), "median_diameter must be 0.8 to 8 mm, got nan"),
    ],
)
def test_bad_cells_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        AirCells(*arguments)
