"""Shapes as signed distances: tubes along curves, ellipsoids, and fields on a fixed lattice."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

#: Step of the lattice for smooth fields [mm]; its nodes are multiples of the step in any volume.
LATTICE = 0.5
#: Largest distance; larger ones count as this one [mm].
FAR = 15.0


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

    def nodes(places: Floats) -> Floats:
        first, last = np.floor(places[0] / LATTICE), np.floor(places[-1] / LATTICE) + 1
        return LATTICE * np.arange(first, last + 1)

    return Grid(nodes(grid.x), nodes(grid.y), nodes(grid.z))


def interpolate(field: Singles, lattice: Grid, grid: Grid) -> Singles:
    """Trilinear interpolation of a field on the lattice to the points of a grid."""
    for axis, (nodes, places) in enumerate([(lattice.z, grid.z), (lattice.y, grid.y), (lattice.x, grid.x)]):
        low = np.floor(places / LATTICE)
        first = (low - np.rint(nodes[0] / LATTICE)).astype(np.int64)
        part = (places / LATTICE - low).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        below = np.take(field, first, axis=axis)
        field = below + part * (np.take(field, first + 1, axis=axis) - below)
    return field


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
