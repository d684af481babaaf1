"""Where the voxels of a volume lie: spacing, origin, direction; boxes; whether two volumes share a grid."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab.arguments import real
from burrlab.specimen import Vector

#: How far a direction matrix may be from orthonormal, largest entry of |D^T D - 1|: headers hold float32 or a few decimals.
ORTHONORMAL = 1e-4
#: Of an exactly given matrix: below it nothing is done, so that matrices of 0 and 1 keep their bits.
_EXACT = 1e-14
#: Two grids are the same if no corner is further from its counterpart than this part of a voxel.
SAME = 1e-2

Array = NDArray[np.float64]


def checked_spacing(spacing: float | ArrayLike, what: str = "spacing") -> Array:
    """(x, y, z) of a number or of three [mm]; ValueError unless positive and finite."""
    found = real(spacing, what)
    if found.shape not in ((), (3,)) or not np.all(np.isfinite(found) & (found > 0)):
        raise ValueError(f"{what} must be a positive number or three [mm], got {spacing!r}")
    return np.broadcast_to(found, (3,)).copy()


def checked_point(point: ArrayLike, what: str) -> Array:
    """(x, y, z); ValueError unless three finite numbers."""
    found = real(point, what)
    if found.shape != (3,) or not np.all(np.isfinite(found)):
        raise ValueError(f"{what} must be three finite numbers [mm], got {point!r}")
    return found


def checked_direction(direction: ArrayLike, what: str = "direction") -> Array:
    """The nearest orthonormal matrix, left-handed ones too; ValueError where that is further than `ORTHONORMAL`."""
    found = real(direction, what)
    if found.shape != (3, 3) or not np.all(np.isfinite(found)):
        raise ValueError(
            f"{what}: the direction matrix must be of 3 x 3 finite numbers, got {np.asarray(direction).tolist()}"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(found.T @ found - np.eye(3)).max())
    if not off <= ORTHONORMAL:
        raise ValueError(
            f"{what}: the direction matrix is not orthonormal (off by {off:.2g}, at most {ORTHONORMAL:g}): "
            "sheared volumes are not supported"
        )
    if off > _EXACT:
        left, _, right = np.linalg.svd(found)
        found = left @ right
    return found


class OnGrid(ABC):
    """What grey and label volumes share: a grid of voxels, placed in the volume's own coordinates."""

    spacing: Array
    origin: Array
    direction: Array
    path: str

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int, int]:
        """Voxels along (z, y, x)."""

    @property
    def extent(self) -> Array:
        """Sides of the field of view, (x, y, z) along the voxel axes [mm]."""
        return np.asarray(self.spacing * self.shape[::-1])

    def bone_point(self, point: Vector) -> Array:
        """A point of the volume's own coordinates in the bone frame (voxel axes) [mm]."""
        return np.asarray(self.direction.T @ real(point, "point"))

    def patient_point(self, point: Vector) -> Array:
        """A point of the bone frame in the volume's own coordinates [mm]."""
        return np.asarray(self.direction @ real(point, "point"))

    def box(self, low: Vector, high: Vector) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
        """First voxel of a box and the one past its last, (z, y, x).

        Parameters
        ----------
        low, high : (x, y, z)
            Two opposite corners of a box along the axes of the volume's own coordinates [mm].

        Raises
        ------
        ValueError
            If no voxel's centre lies in the box.
        """
        corners = np.array([checked_point(low, "low"), checked_point(high, "high")])
        every = np.array([[corners[(i >> k) & 1, k] for k in range(3)] for i in range(8)])
        places = ((every - self.origin) @ self.direction) / self.spacing
        first = np.clip(np.ceil(places.min(axis=0) - 1e-6), 0, self.shape[::-1]).astype(int)
        last = np.clip(np.floor(places.max(axis=0) + 1e-6) + 1, 0, self.shape[::-1]).astype(int)
        if np.any(first >= last):
            raise ValueError(
                f"box from {_point(corners[0])} to {_point(corners[1])} mm holds no voxel of {self.path}, "
                f"which lies {box_text(self)}"
            )
        x, y, z = (int(n) for n in first)
        u, v, w = (int(n) for n in last)
        return (z, y, x), (w, v, u)

    def corners(self) -> Array:
        """Centres of the eight corner voxels in the volume's own coordinates, shape (8, 3) [mm]."""
        ends = np.array(self.shape[::-1]) - 1
        bits = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)])
        return np.asarray(self.origin + (bits * ends * self.spacing) @ self.direction.T)


def box_text(grid: OnGrid) -> str:
    """Between which corners the centres of a volume's voxels lie, in its own coordinates."""
    corners = grid.corners()
    return f"between {_point(corners.min(axis=0))} and {_point(corners.max(axis=0))} mm"


def slices(shape: Sequence[int], start: Sequence[int], stop: Sequence[int]) -> tuple[slice, slice, slice]:
    """Of a box of voxels (z, y, x); ValueError unless it lies in the volume and holds a voxel."""
    box = [(int(a), int(b)) for a, b in zip(start, stop, strict=True)]
    if len(box) != 3 or not all(0 <= a < b <= n for (a, b), n in zip(box, shape, strict=True)):
        raise ValueError(
            f"start and stop must be a box of voxels (z, y, x) in {tuple(shape)}, got {tuple(start)} to {tuple(stop)}"
        )
    z, y, x = (slice(a, b) for a, b in box)
    return z, y, x


def same_geometry(first: OnGrid, second: OnGrid) -> bool:
    """Whether two volumes have the same voxels: as many, and no corner off by more than `SAME` of a voxel."""
    return _difference(first, second) is None


def check_same_geometry(first: OnGrid, second: OnGrid) -> None:
    """Raises ValueError with what differs unless two volumes have the same voxels."""
    what = _difference(first, second)
    if what is not None:
        raise ValueError(f"{first.path} and {second.path} must have the same geometry: {what}")


def _difference(first: OnGrid, second: OnGrid) -> str | None:
    if first.shape != second.shape:
        return f"{_sizes(first)} voxels against {_sizes(second)}"
    if np.any(np.abs(first.spacing - second.spacing) > 1e-3 * np.minimum(first.spacing, second.spacing)):
        return f"spacing {_point(first.spacing)} against {_point(second.spacing)} mm"
    off = float(np.linalg.norm(first.corners() - second.corners(), axis=1).max())
    if off <= SAME * min(first.spacing.min(), second.spacing.min()):
        return None
    if np.abs(first.direction - second.direction).max() > 1e-3:
        turn = [_point(column) for column in (*first.direction.T, *second.direction.T)]
        return f"directions {', '.join(turn[:3])} against {', '.join(turn[3:])}"
    if np.linalg.norm(first.origin - second.origin) > 0.5 * off:
        return f"origin {_point(first.origin)} against {_point(second.origin)} mm"
    return f"a corner is off by {off:.3g} mm"


def _sizes(volume: OnGrid) -> str:
    return " x ".join(str(n) for n in volume.shape[::-1])


def _point(values: Array) -> str:
    return "(" + ", ".join(f"{v:.6g}" for v in values) + ")"
