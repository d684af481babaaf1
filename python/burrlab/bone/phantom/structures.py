"""Geometry of the phantom, a right ear: shapes as signed distances, structures made of them, fields on a lattice.

The origin is the spine of Henle, on the bone's surface. x is depth (towards the middle of the head), y points
back, z up [mm].
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from burrlab.bone.uneven import unit_draws

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

#: Step of the lattice for smooth fields [mm]; its nodes are multiples of the step in any volume.
LATTICE = 0.5
#: Largest distance; larger ones count as this one [mm].
FAR = 15.0
#: Second key word of the draws: no other use of the same seed shares them.
STREAM = 0xA14CE115


@dataclass(frozen=True, eq=False)
class Grid:
    """Coordinates x, y, z [mm] of the points of a grid; its fields have the shape (z, y, x)."""

    x: Floats
    y: Floats
    z: Floats

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.z), len(self.y), len(self.x)

    def points(self) -> Floats:
        """All points, shape (n, 3)."""
        z, y, x = np.meshgrid(self.z, self.y, self.x, indexing="ij")
        return np.column_stack([x.ravel(), y.ravel(), z.ravel()])

    def open(self) -> tuple[Floats, Floats, Floats]:
        """x, y and z in shapes that broadcast to the grid's shape."""
        return self.x[None, None, :], self.y[None, :, None], self.z[:, None, None]


def lattice_around(grid: Grid) -> Grid:
    """Lattice nodes that interpolation at the points of a grid needs."""
    ends = (np.floor(places[[0, -1]] / LATTICE) for places in (grid.x, grid.y, grid.z))
    return Grid(*(LATTICE * np.arange(first, last + 2) for first, last in ends))


@dataclass(frozen=True, eq=False)
class Tube:
    """Tube around a polyline; points (n, 3) and radius (n,) [mm], linear between the points."""

    points: Floats
    radius: Floats

    @classmethod
    def along(cls, points: ArrayLike, radius: ArrayLike, *, step: float = 1.0) -> "Tube":
        """Tube along a smooth curve through the points, in pieces of about `step` [mm]."""
        corners = np.asarray(points, dtype=float)
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
        fine = np.linspace(0.0, at[-1], max(2, round(at[-1] / step) + 1))
        curve = np.column_stack(
            [scipy.interpolate.PchipInterpolator(at, corners[:, axis])(fine) for axis in range(3)]
        )
        return cls(curve, np.interp(fine, at, np.broadcast_to(np.asarray(radius, dtype=float), at.shape)))

    @classmethod
    def ring(cls, centre: ArrayLike, normal: ArrayLike, radius: float, thickness: float) -> "Tube":
        """Torus: `radius` is that of its circle, `thickness` that of the tube [mm]."""
        _, u, v = frame_along(normal)
        angle = np.linspace(0.0, 2 * np.pi, 33)[:, None]
        circle = np.asarray(centre, dtype=float) + radius * (np.cos(angle) * u + np.sin(angle) * v)
        return cls(circle, np.full(len(circle), thickness))


def frame_along(direction: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """The direction with length 1, and two directions of length 1 across it and each other."""
    n = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    u = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.8 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    return n, u, np.cross(n, u)


def tapered(grid: Grid, ends: tuple[Floats, Floats], radii: tuple[float, float]) -> Floats:
    """Signed distance from a piece of a tube, whose radius is linear between its ends [mm]."""
    a, b = ends
    along = b - a
    square = float(along @ along)
    x, y, z = Grid(grid.x - a[0], grid.y - a[1], grid.z - a[2]).open()
    t = np.clip((x * along[0] + y * along[1] + z * along[2]) / square, 0.0, 1.0) if square else 0.0
    dx, dy, dz = x - t * along[0], y - t * along[1], z - t * along[2]
    return np.asarray(np.sqrt(dx * dx + dy * dy + dz * dz) - (radii[0] + t * (radii[1] - radii[0])))


def distance_to(tubes: Sequence[Tube], grid: Grid, reach: float) -> Floats:
    """Signed distance from tubes [mm]; FAR where it is above `reach`."""
    out = np.full(grid.shape, FAR)
    for tube in tubes:
        for (a, b), radii in zip(pairwise(tube.points), pairwise(tube.radius.tolist()), strict=True):
            pad = max(radii) + reach
            box = np.transpose([np.minimum(a, b) - pad, np.maximum(a, b) + pad])
            i, j, k = (
                slice(*np.searchsorted(places, sides))
                for places, sides in zip((grid.x, grid.y, grid.z), box, strict=True)
            )
            near = Grid(grid.x[i], grid.y[j], grid.z[k])
            if 0 not in near.shape:
                distance, part = tapered(near, (a, b), radii), out[k, j, i]
                np.minimum(part, distance, out=part, where=distance < reach)
    return out


def ellipsoid(grid: Grid, centre: ArrayLike, half_axes: ArrayLike) -> Floats:
    """Signed distance from an ellipsoid [mm], to first order at its surface."""
    c, h = np.asarray(centre, dtype=float), np.asarray(half_axes, dtype=float)
    x, y, z = grid.open()
    u, v, w = (x - c[0]) / h[0], (y - c[1]) / h[1], (z - c[2]) / h[2]
    k = np.sqrt(u * u + v * v + w * w)
    slope = np.sqrt((u / h[0]) ** 2 + (v / h[1]) ** 2 + (w / h[2]) ** 2)
    return np.asarray(k * (k - 1.0) / np.maximum(slope, 1e-9))


def smooth_min(a: Floats, b: Floats, width: float) -> Floats:
    """The smaller of two distances, rounded over a width where they meet [mm]."""
    h = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.asarray(np.minimum(a, b) - h * h * (width / 4.0))


def smooth_max(a: Floats, b: Floats, width: float) -> Floats:
    """The larger of two distances, rounded over a width where they meet [mm]."""
    return -smooth_min(-a, -b, width)


def share(distance: Singles, width: float) -> Singles:
    """Part of a voxel inside a surface, 0..1, from its centre's signed distance and its width [mm]."""
    part = np.float32(0.5) - distance * np.float32(1.0 / width)
    return np.asarray(np.clip(part, np.float32(0.0), np.float32(1.0)))


def uniform(seed: int, purpose: int, count: int) -> Floats:
    """Draws in (0, 1) that depend on seed and purpose alone."""
    return unit_draws(seed, STREAM, [0, 0, 0, purpose], count)


#: Thickness of the dura [mm], assumed.
DURA = 1.0
#: Radius of the bony ear canal and of the sigmoid sinus [mm], assumed.
CANAL, SINUS = 4.2, 4.5

#: Ends and their radii [mm]: handle and head of the malleus, incus and its long process, stapes; assumed.
OSSICLES = (
    ((14.6, -4.2, -4.0), (15.4, -4.6, 1.2), (0.4, 0.7)),
    ((15.4, -4.6, 1.2), (15.7, -3.9, 2.0), (1.2, 1.2)),
    ((15.7, -3.0, 2.0), (15.6, -1.0, 1.9), (1.2, 0.5)),
    ((15.7, -2.9, 1.6), (16.6, -3.2, -2.0), (0.7, 0.4)),
    ((16.6, -3.2, -2.0), (19.0, -2.6, -1.6), (0.4, 0.6)),
)
#: Centre, normal, radius and thickness of the lateral, anterior and posterior canals [mm]. Radii of
#: curvature: Spoor and Zonneveld, Yearb. Phys. Anthropol. 1998 (human means 3.2, 3.1 and 2.3 mm).
CANALS = (
    ((20.2, 1.2, 1.5), (-0.3, 0.3, 1.0), 2.3, 0.6),
    ((21.0, 1.0, 4.2), (1.0, -1.0, 0.0), 3.2, 0.55),
    ((20.6, 6.0, 0.4), (1.0, 1.0, 0.0), 3.1, 0.55),
)


class Structures:
    """The anatomy of one seed, which varies places and sizes."""

    def __init__(self, seed: int) -> None:
        draw = iter((2.0 * uniform(seed, 2, 64) - 1.0).tolist())

        def jitter(width: float) -> float:
            return float(round(width * next(draw), 6))

        def shift(width: float) -> Floats:
            return np.array([jitter(width) for _ in range(3)])

        inner = shift(0.4)  # moves labyrinth, nerve and middle ear
        nerve_points = np.array(
            [
                [33.0, -2.5, 1.5],
                [26.0, -6.0, 3.0],
                [22.5, -8.0, 4.2],
                [19.5, -5.5, 2.8],
                [17.9, -2.5, 0.9],
                [16.6, 1.0, -1.0],
                [15.6, 3.2, -2.4],
                [15.1, 4.0, -4.2],
                [14.6, 4.3, -8.0],
                [14.0, 4.2, -15.5],
            ]
        )
        nerve_points[-3:] += np.array([jitter(0.3), jitter(0.6), 0.0])
        self.nerve = Tube.along(nerve_points + inner, [0.55, 0.5, 0.7, 0.75, 0.8, 0.85, 0.95, 1.0, 1.0, 1.0])
        sinus_points = np.array(
            [
                [9.5, 46.0, 9.0],
                [9.0, 34.0, 8.5],
                [9.3, 26.0, 6.0],
                [10.6, 20.0, 0.0],
                [12.7, 16.5, -7.0],
                [16.5, 14.0, -13.5],
                [21.0, 10.0, -17.0],
                [26.0, 5.0, -18.0],
            ]
        )
        self.sinus = Tube.along(
            sinus_points + [jitter(0.7), 1.0 + jitter(1.5), 0.0], SINUS + jitter(0.4), step=2.0
        )
        # canals of the labyrinth, cochlea and connections; centre and half axes
        self.canals, self.vestibule = _labyrinth(inner)
        self.antrum = (
            np.array([12.0, 6.0, 4.6]) + 0.5 * inner + np.array([0.0, jitter(0.6), 0.0]),
            np.array([3.5, 7.0, 4.5]) * (1 + jitter(0.08)),
        )
        self.tympanum = (np.array([15.8, -4.0, -2.0]) + inner, np.array([2.1, 4.2, 6.2]))
        self.ossicles = tuple(Tube(inner + [a, b], np.array(radii)) for a, b, radii in OSSICLES)
        self.aditus = Tube(
            np.array([self.antrum[0] + [0.5, -4.5, -0.2], self.tympanum[0] + [0.0, 1.5, 5.0]]),
            np.array([2.0, 1.7]),
        )
        self.ear_canal = Tube(
            np.array([[-6.0, -3.3, -3.6], [14.2, -4.3, -3.6] + inner * [0.0, 1.0, 1.0]]), np.full(2, CANAL)
        )
        self.tip = Tube(
            np.array([[9.5, 9.0, -9.0], [8.0, 9.0 + jitter(1.0), -22.0 + jitter(1.0)]]), np.array([9.5, 6.0])
        )
        # height at (12, 6), slopes along x and y
        self.tegmen = np.array([11.3 + jitter(0.7), -0.06 + jitter(0.03), 0.03 + jitter(0.04)])
        # index in the nerve's points
        self.genu = int(np.argmin(np.linalg.norm(self.nerve.points - (nerve_points[6] + inner), axis=1)))
        self.fossa = 28.7 + jitter(0.5)  # x + 0.8 y on the plane where the posterior fossa begins

    @property
    def landmarks(self) -> dict[str, Floats]:
        """Points by name [mm]."""
        y, z = self.antrum[0][1] + 2.0, self.antrum[0][2] - 5.0
        surface = surface_depth(Grid(np.zeros(1), np.array([y]), np.array([z]))).item()
        return {
            "spine of Henle": np.zeros(3), "entry": np.array([surface, y, z]),
            "antrum": self.antrum[0], "second genu": self.nerve.points[self.genu],
            "stylomastoid foramen": self.nerve.points[-1],
            "lateral canal": self.canals[0].points[:-1].mean(axis=0),
            "sigmoid sinus": self.sinus.points[np.argmin(np.abs(self.sinus.points[:, 2]))],
            "mastoid tip": self.tip.points[1] - [0.0, 0.0, self.tip.radius[1]],
            "tegmen": np.array([12.0, 6.0, self.tegmen[0]]),
        }  # fmt: skip


def surface_depth(grid: Grid) -> Floats:
    """x of the bone's lateral surface: a shallow bowl, 0 at the spine of Henle [mm]."""
    _, y, z = grid.open()
    return np.asarray(0.004 * (y - 8.0) ** 2 + 0.003 * (z + 6.0) ** 2 - 0.364)


def _labyrinth(shift: Floats) -> tuple[tuple[Tube, ...], tuple[Floats, Floats]]:
    rings = [Tube.ring(shift + place, normal, radius, thick) for place, normal, radius, thick in CANALS]
    centre = shift + [22.2, -0.5, -0.4]
    common = Tube(shift + [[22.9, 3.4, 2.3], [22.4, 1.2, 0.0]], np.full(2, 0.7))
    low = Tube(shift + [[21.4, 5.2, -2.5], [22.2, 1.0, -1.4]], np.full(2, 0.6))
    # 2.5 turns, 9.2 mm across and 5.1 mm high; they narrow and rise towards the front and side.
    axis, u, v = frame_along([-0.55, -0.8, -0.25])
    t = np.linspace(0.0, 1.0, 61)[:, None]
    angle = 2 * np.pi * 2.5 * t + 0.4
    radius = 3.9 * (1.0 - 0.75 * t)
    spiral = shift + [23.6, -5.0, -2.2] + radius * (np.cos(angle) * u + np.sin(angle) * v) + 3.4 * t * axis
    cochlea = Tube(np.round(spiral, 6), np.linspace(1.05, 0.6, 61))
    start = Tube(np.array([cochlea.points[0], centre]), np.full(2, 1.0))
    return (*rings, common, low, cochlea, start), (centre, np.array([1.9, 2.6, 2.4]))


#: Thickness of the compact bone over the air cells [mm], assumed.
CORTEX = 2.0
#: Thickness of bone without cells over or around structures [mm], assumed.
PLATES = {"dura": 0.8, "sigmoid sinus": 0.8, "facial nerve": 1.0, "labyrinth": 1.5, "ear canal": 1.5}
#: Margins of the planned cavity from dura, sinus, nerve and labyrinth, and wall to the ear canal [mm]; ours.
MARGINS = {"dura": 1.0, "sigmoid sinus": 1.0, "facial nerve": 1.5, "labyrinth": 2.0, "ear canal": 2.0}
#: Reach of the planned cavity out of the bone [mm]: it includes voxels that the surface cuts.
ABOVE = 1.0
#: Radii of the planned cavity at the surface and at the antrum [mm]; ours.
OPENING, BOTTOM = 15.0, 7.5
#: Box that holds the air cells of any seed: least and largest (x, y, z) [mm].
CELLS_BOX = ((-1.0, -9.0, -29.0), (19.0, 28.0, 13.0))


class Fields:
    """Signed distances on the lattice by name, negative inside [mm].

    Names
    -----
    outside
        From the outer surface of the bone.
    cranium
        From the inside of the skull.
    rooms
        From antrum, aditus, middle ear and ear canal.
    sinus
        From the sigmoid sinus.
    pneumatised
        From the part that holds air cells; the rooms may cut into it.
    plan
        From the cavity of a simple mastoidectomy.
    """

    def __init__(self, at: Structures, lattice: Grid) -> None:
        self.lattice = lattice
        outside, cranium = _outside(at, lattice), _cranium(at, lattice)
        near = {
            "sigmoid sinus": distance_to([at.sinus], lattice, 4.0),
            "facial nerve": distance_to([at.nerve], lattice, 4.0),
            "labyrinth": np.minimum(distance_to(at.canals, lattice, 4.0), ellipsoid(lattice, *at.vestibule)),
            "dura": cranium,
            "ear canal": distance_to([at.ear_canal], lattice, 4.0),
        }
        rooms = smooth_min(ellipsoid(lattice, *at.antrum), distance_to([at.aditus], lattice, 4.0), 1.0)
        rooms = smooth_min(rooms, ellipsoid(lattice, *at.tympanum), 1.0)
        distances = {
            "outside": outside, "cranium": cranium, "rooms": np.minimum(rooms, near["ear canal"]), "sinus": near["sigmoid sinus"],
            "pneumatised": np.maximum(_mastoid(lattice, outside), _within(near, PLATES)),
            "plan": np.maximum(_funnel(at, lattice), np.maximum(_within(near, MARGINS), outside - ABOVE)),
        }  # fmt: skip
        self.distances = {name: part.astype(np.float32) for name, part in distances.items()}

    def on(self, name: str, grid: Grid) -> Singles:
        """The named field at the points of a grid, by trilinear interpolation."""
        lattice, field = self.lattice, self.distances[name]
        for axis, (nodes, places) in enumerate(
            [(lattice.z, grid.z), (lattice.y, grid.y), (lattice.x, grid.x)]
        ):
            low = np.floor(places / LATTICE)
            first = (low - np.rint(nodes[0] / LATTICE)).astype(np.int64)
            part = (
                (places / LATTICE - low)
                .astype(np.float32)
                .reshape([-1 if k == axis else 1 for k in range(3)])
            )
            below = np.take(field, first, axis=axis)
            field = below + part * (np.take(field, first + 1, axis=axis) - below)
        return np.asarray(field)


def _within(distance: dict[str, Floats], margin: dict[str, float]) -> Floats:
    """Field that is negative where all margins are kept."""
    return np.asarray(np.maximum.reduce([margin[name] - distance[name] for name in margin]))


def _outside(at: Structures, grid: Grid) -> Floats:
    x, y, z = grid.open()
    below = -12.5 - 0.15 * np.clip(y, 0.0, 20.0) - z  # the skull base beside the mastoid process
    base = smooth_min(below, distance_to([at.tip], grid, 10.0), 3.0)
    return smooth_max(surface_depth(grid) - x, base, 2.0)


def _cranium(at: Structures, grid: Grid) -> Floats:
    x, y, z = grid.open()
    squama = surface_depth(grid) + 4.0 - x
    floor = at.tegmen[0] + at.tegmen[1] * (x - 12.0) + at.tegmen[2] * (y - 6.0)
    posterior = smooth_max((at.fossa - x - 0.8 * y) / np.sqrt(1.64), squama + 2.0, 4.0)
    return smooth_min(smooth_max(floor - z, squama, 4.0), posterior, 2.0)


def _mastoid(grid: Grid, outside: Floats) -> Floats:
    """Region for cells: below the cortex, behind and above the ear canal, lateral to the inner ear."""
    _, y, z = grid.open()
    front = np.minimum(2.0, -2.9 - 0.82 * z) - y
    body = ellipsoid(grid, [5.0, 8.0, -4.0], [13.0, 20.0, 26.0])
    return smooth_max(smooth_max(outside + CORTEX, front, 2.0), body, 3.0)


def _funnel(at: Structures, grid: Grid) -> Floats:
    """Cone that narrows from the opening to the antrum and ends at the antrum's far wall."""
    a, b = at.landmarks["entry"] - [2.0, 0.0, 0.0], at.antrum[0]
    x, _, _ = grid.open()
    return smooth_max(tapered(grid, (a, b), (OPENING, BOTTOM)), x - (b[0] + at.antrum[1][0]), 2.0)
