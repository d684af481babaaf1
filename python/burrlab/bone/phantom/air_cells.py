"""Air cells: a honeycomb with cell sizes from a given distribution."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from burrlab.bone.phantom.structures import FAR, Floats, Grid, Singles, uniform
from burrlab.common.check import refuse

#: Edge of the blocks that share a list of nearby cells [mm].
BLOCK = 2.0
#: Lattice steps for setting the cells' volumes, coarse and fine [median diameters], and rounds on each.
STEPS = ((0.4, 25), (0.2, 20))


@dataclass(frozen=True)
class AirCells:
    """Sizes of the air cells of a mastoid.

    Parameters
    ----------
    median_diameter : float
        Median diameter of the sphere with a cell's volume, to the middle of its walls [mm].
    geometric_deviation : float
        Geometric standard deviation of this diameter, which is log-normal: 1 is one size; with 1.4 two thirds
        lie within a factor of 1.4.
    wall : float
        Thickness of the walls between cells [mm].

    Raises
    ------
    ValueError
        If the median diameter is not between 0.8 and 8 mm, the deviation not between 1 and 2, or the wall not
        between 0.05 mm and half the median diameter.

    Notes
    -----
    Surface over volume of the air in eight mastoids is 22 /cm (micro-CT, Hear. Res., October 2016;
    docs/beyond_the_paper.md), as for spheres of 2.7 mm. A median of 2 mm with a deviation of 1.4 gives the
    same ratio of moments, 2 exp(2.5 ln(1.4)^2) mm. The deviation, the log-normal form and the wall are assumed.
    """

    median_diameter: float = 2.0
    geometric_deviation: float = 1.4
    wall: float = 0.3

    def __post_init__(self) -> None:
        refuse(
            not 0.8 <= self.median_diameter <= 8,
            f"median_diameter must be 0.8 to 8 mm, got {self.median_diameter}",
        )
        refuse(
            not 1 <= self.geometric_deviation <= 2,
            f"geometric_deviation must be 1 to 2, got {self.geometric_deviation}",
        )
        refuse(
            not 0.05 <= self.wall <= self.median_diameter / 2,
            f"wall must be between 0.05 mm and half the median diameter, {self.median_diameter / 2:g} mm, "
            f"got {self.wall}",
        )

    def draw(self, volume: float, seed: int) -> Floats:
        """Diameters [mm] of cells that fill a volume [mm^3], largest first; draw k depends on seed and k."""
        sigma = math.log(self.geometric_deviation)
        most = int(2 * volume / (math.pi / 6 * self.median_diameter**3 * math.exp(4.5 * sigma**2))) + 100
        # Rounded: the last bit of exp differs between processors.
        diameter = np.round(
            self.median_diameter * np.exp(sigma * scipy.special.ndtri(uniform(seed, 0, most))), 6
        )
        count = int(np.searchsorted(np.cumsum(math.pi / 6 * diameter**3), volume))
        return np.sort(diameter[: max(1, count)])[::-1]


@dataclass(frozen=True, eq=False, repr=False)
class Honeycomb:
    """Cells of a power diagram: a point belongs to the site with the least |x - site|^2 - weight.

    Attributes
    ----------
    sites : ndarray, shape (n, 3)
        (x, y, z) [mm]
    weights : ndarray, shape (n,)
        [mm^2]
    drawn : ndarray, shape (n,)
        Drawn diameter of the sphere with the cell's volume [mm].
    realised : ndarray, shape (n,)
        Realised diameter of this sphere [mm], by counting lattice points.
    vanished : int
        Drawn cells without volume: too small between their neighbours.
    """

    sites: Floats = field(repr=False)
    weights: Floats = field(repr=False)
    drawn: Floats = field(repr=False)
    realised: Floats = field(repr=False)
    vanished: int

    def __repr__(self) -> str:
        (median, deviation), (drawn, drawn_deviation) = self.moments, _moments(self.drawn)
        return (
            f"Honeycomb of {len(self.sites)} cells: diameter {median:.3f} mm x/ {deviation:.3f} "
            f"(drawn {drawn:.3f} mm x/ {drawn_deviation:.3f}; {self.vanished} vanished)"
        )

    @property
    def moments(self) -> tuple[float, float]:
        """Geometric mean [mm] and geometric standard deviation of the realised diameters."""
        return _moments(self.realised)

    def wall_distance(self, grid: Grid, inside: NDArray[np.bool_], reach: float) -> Singles:
        """Distance from the middle of the nearest wall [mm] where `inside`; exact below `reach`."""
        out = np.full(grid.shape, np.float32(FAR))
        for z, y, x in itertools.product(*map(_block_edges, (grid.z, grid.y, grid.x))):
            met = inside[z, y, x]
            if met.any():
                part = Grid(grid.x[x], grid.y[y], grid.z[z])
                out[z, y, x][met] = self._block(part.points()[met.ravel()], reach)
        return out

    def _block(self, points: Floats, reach: float) -> Singles:
        low, high = points.min(axis=0), points.max(axis=0)
        near = self._near((low + high) / 2, float(np.linalg.norm(high - low)) / 2, reach)
        sites, weights = self.sites[near], self.weights[near]
        power = -np.broadcast_to(weights, (len(points), len(near)))
        for axis in range(3):
            power = power + (points[:, axis, None] - sites[None, :, axis]) ** 2
        owner = np.argmin(power, axis=1)
        apart = np.sqrt(((sites[:, None, :] - sites[None, :, :]) ** 2).sum(axis=2))
        np.fill_diagonal(apart, 1.0)
        gap = (power - power[np.arange(len(points)), owner][:, None]) / (2.0 * apart[owner])
        gap[np.arange(len(points)), owner] = np.inf
        return np.asarray(gap.min(axis=1, initial=FAR), dtype=np.float32)

    def _near(self, centre: Floats, half: float, reach: float) -> NDArray[np.int64]:
        """Sites whose cells, or walls within `reach`, can meet the ball around a centre."""
        power = ((centre - self.sites) ** 2).sum(axis=1) - self.weights
        owner = int(np.argmin(power))
        excess = power - power[owner]
        apart = np.sqrt(((self.sites - self.sites[owner]) ** 2).sum(axis=1))
        # The difference of two powers is linear, with twice the distance of the sites as its slope.
        owners = excess <= 2 * half * apart
        widest = float(apart[owners].max())
        return np.flatnonzero(excess <= 2 * half * apart + 2 * reach * (apart + widest))

    def owners(self, points: Floats) -> NDArray[np.int64]:
        """Cell of each point."""
        return _owners(self.sites, self.weights, points)


def _moments(diameter: Floats) -> tuple[float, float]:
    log = np.log(diameter)
    return float(np.exp(log.mean())), float(np.exp(log.std()))


def _block_edges(places: Floats) -> list[slice]:
    begin = [0, *(np.flatnonzero(np.diff(np.floor(places / BLOCK))) + 1).tolist(), len(places)]
    return [slice(a, b) for a, b in itertools.pairwise(begin)]


def _owners(sites: Floats, weights: Floats, points: Floats) -> NDArray[np.int64]:
    # A power distance is a Euclidean one to sites lifted into a fourth dimension.
    lifted = np.column_stack([sites, np.sqrt(weights.max() - weights)])
    return np.asarray(
        scipy.spatial.cKDTree(lifted).query(np.column_stack([points, np.zeros(len(points))]))[1]
    )


def honeycomb(cells: AirCells, lattice: Callable[[float], Floats], seed: int) -> Honeycomb:
    """Cells of drawn sizes that fill a region.

    Parameters
    ----------
    cells : AirCells
    lattice : callable
        Returns the points of a cubic lattice of the given step [mm] in the region, shape (n, 3).
    seed : int

    Returns
    -------
    Honeycomb

    Notes
    -----
    Volumes are drawn first. Then the weight of a cell that is too small is raised, and of one that is too
    large lowered; each site moves to the middle of its cell, which makes cells round. Weights exist for any
    volumes by optimal transport (Aurenhammer, Hoffmann, Aronov, Algorithmica 1998); the steps are ours.
    """
    step = STEPS[0][0] * cells.median_diameter
    points = lattice(step)
    drawn = cells.draw(len(points) * step**3, seed)
    sites, weights = _scatter(points, drawn, seed), (drawn / 2) ** 2
    for part, rounds in STEPS:
        step = part * cells.median_diameter
        points = lattice(step)
        wanted = drawn**3 / (drawn**3).sum() * len(points)
        for k in range(rounds):
            owners = _owners(sites, weights, points)
            count = np.bincount(owners, minlength=len(sites))
            # A weight's change moves a wall by the change over twice the distance to the neighbour.
            change = (wanted - count) * step**3 / (math.pi * drawn / 2)
            weights = weights + 0.8 * np.clip(change, -0.3 * drawn**2, 0.3 * drawn**2)
            lost = np.flatnonzero(count == 0)
            # A new site owns its point if its power is below the least one there.
            power = ((sites[lost, None] - sites) ** 2).sum(axis=2) - weights
            weights[lost] = (drawn[lost] / 4) ** 2 - power.min(axis=1)
            if k < 2 * rounds // 3:  # later the sites stay, and the volumes settle
                full = count > 0
                totals = [np.bincount(owners, weights=along, minlength=len(sites)) for along in points.T]
                sites[full] += 0.7 * (np.transpose(totals)[full] / count[full, None] - sites[full])
    sites, weights = np.round(sites, 6), np.round(weights, 6)
    count = np.bincount(_owners(sites, weights, points), minlength=len(sites))
    # A site without a lattice point may own a sliver between the points: such sites are removed.
    populated = count > 0
    realised = np.cbrt(6 / math.pi * count[populated] * step**3)
    return Honeycomb(
        sites[populated], weights[populated], drawn[populated], realised, int(np.count_nonzero(~populated))
    )


def _scatter(points: Floats, diameter: Floats, seed: int) -> Floats:
    """One site per cell, largest cell first: of 20 drawn places the farthest from all other cells."""
    draws = uniform(seed, 1, 20 * len(diameter)).reshape(-1, 20)
    sites = np.empty((len(diameter), 3))
    for k, row in enumerate(draws):
        places = points[(row * len(points)).astype(np.int64)]
        gap = np.linalg.norm(places[:, None, :] - sites[None, :k, :], axis=2) - diameter[:k] / 2
        sites[k] = places[
            int(np.argmax(gap.min(axis=1, initial=np.inf)))
        ]  # the first place for the first cell
    return sites
