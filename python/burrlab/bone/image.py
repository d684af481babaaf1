"""Grey values and labels on a grid of voxels, and the bone that an occupancy map makes of grey values."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.bone.specimen import MOST_VOXELS, Specimen, Vector, checked_spacing, surface_along, unit_vector
from burrlab.common.check import check_memory, real, refuse, require_type, scalar
from burrlab.common.progress import doing
from burrlab.common.table import html_table

# What the table of an object shows: its attributes, and their units.
_OBJECTS = {
    "Burr": {"radius": "mm"},
    "Material": {
        "name": "",
        "c_e": "N/mm²",
        "alpha": "1/ms",
        "shape": "",
        "source": "",
        "force_exponent": "",
        "rate_exponent": "",
    },
    "VoxelBone": {"shape": "z, y, x", "spacing": "mm", "origin": "mm", "mass": "mm³", "removed": "mm³"},
    "Volume": {"values": "z, y, x", "spacing": "mm", "origin": "mm", "path": ""},
}


def object_html(instance: object) -> str:
    """HTML of a burr, material, bone or volume: a row an attribute."""
    rows = _OBJECTS[(kind := type(instance).__name__)]
    names = [f"{name} [{unit}]" if unit else name for name, unit in rows.items()]
    return html_table(kind, {"": names, kind: [_plain(getattr(instance, name)) for name in rows]})


def _plain(value: Any) -> str:
    value = f"{value.shape} {value.dtype}" if isinstance(value, np.ndarray) and value.ndim == 3 else value
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        return "(" + ", ".join(_plain(part) for part in value) + ")"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


#: Corners of a box: 0 or 1 for its two ends along (x, y, z).
_ENDS = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)])
#: Largest entry allowed in |D^T D - 1| of a direction matrix D: headers hold float32 or a few decimals.
ORTHONORMAL = 1e-4
#: A matrix that is off by less stays unchanged: matrices of 0 and 1 keep their bits.
_EXACT = 1e-14
#: Largest distance between corresponding corners of two grids that count as the same [voxels].
SAME = 1e-2

Array = NDArray[np.float64]
#: Red, green and blue, from 0 to 255.
Colour = tuple[int, int, int]


def checked_point(point: ArrayLike, what: str) -> Array:
    """Point (x, y, z); ValueError unless three finite numbers."""
    coordinates = real(point, what)
    refuse(
        coordinates.shape != (3,) or not np.all(np.isfinite(coordinates)),
        f"{what} must be three finite numbers [mm], got {point!r}",
    )
    return coordinates


def checked_direction(direction: ArrayLike, what: str = "direction", most: float = ORTHONORMAL) -> Array:
    """Nearest orthonormal matrix, of either hand; ValueError if it is off by more than `most`."""
    matrix = real(direction, what)
    refuse(
        matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)),
        f"{what}: the direction matrix must be of 3 x 3 finite numbers, got {np.asarray(direction).tolist()}",
    )
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    refuse(
        not off <= most,
        f"{what}: the direction matrix is not orthonormal (off by {off:.2g}, at most {most:g}): "
        "sheared volumes are not supported",
    )
    if off > _EXACT:
        left, _, right = np.linalg.svd(matrix)
        matrix = left @ right
    return matrix


class OnGrid(ABC):
    """Base of grey and label volumes: a grid of voxels, placed in the volume's own coordinates."""

    spacing: Array
    origin: Array
    direction: Array
    path: str
    notes: tuple[str, ...]
    _ARRAY: ClassVar[str]  #: Name of the field with the voxels, shape (z, y, x).

    @staticmethod
    @abstractmethod
    def _resampling(voxels: NDArray[Any], old: Array, new: Array, /) -> NDArray[Any]:
        """Voxels on a grid of another spacing."""

    @property
    def voxels(self) -> NDArray[Any]:
        """Grey values or labels, shape (z, y, x)."""
        return cast(NDArray[Any], getattr(self, self._ARRAY))

    def _moved(self, voxels: NDArray[Any], note: str, **grid: Array) -> Self:
        """The volume with other voxels and another grid; grey values get a note."""
        notes = {"notes": (*self.notes, note)} if self._ARRAY == "values" else {}
        return cast(Self, replace(cast(Any, self), **{self._ARRAY: voxels}, **notes, **grid))

    def _check(self, voxels: NDArray[Any]) -> None:
        """Keeps a read-only view of the voxels, and the geometry as arrays; ValueError if it is wrong."""
        self.__dict__.update({
            self._ARRAY: np.broadcast_to(voxels, voxels.shape), "spacing": checked_spacing(self.spacing),
            "origin": checked_point(self.origin, f"{self.path}: origin"),
            "direction": checked_direction(self.direction, self.path),
        })  # fmt: skip

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along (z, y, x)."""
        return self.voxels.shape

    @property
    def extent(self) -> Array:
        """Sides of the field of view, (x, y, z) along the voxel axes [mm]."""
        return np.asarray(self.spacing * self.shape[::-1])

    def bone_point(self, point: Vector) -> Array:
        """Converts a point from the volume's own coordinates to the bone frame (voxel axes) [mm]."""
        return np.asarray(self.direction.T @ real(point, "point"))

    def patient_point(self, point: Vector) -> Array:
        """Converts a point from the bone frame to the volume's own coordinates [mm]."""
        return np.asarray(self.direction @ real(point, "point"))

    def box(self, low: Vector, high: Vector) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
        """First voxel of a box, and the voxel after its last, (z, y, x).

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
        places = ((np.where(_ENDS, corners[1], corners[0]) - self.origin) @ self.direction) / self.spacing
        first = np.clip(np.ceil(places.min(axis=0) - 1e-6), 0, self.shape[::-1]).astype(int)
        last = np.clip(np.floor(places.max(axis=0) + 1e-6) + 1, 0, self.shape[::-1]).astype(int)
        refuse(
            np.any(first >= last),
            f"box from {point_text(corners[0])} to {point_text(corners[1])} mm holds no voxel of "
            f"{self.path}, which lies {box_text(self)}",
        )
        return tuple(first[::-1].tolist()), tuple(last[::-1].tolist())

    def corners(self) -> Array:
        """Centres of the eight corner voxels in the volume's own coordinates, shape (8, 3) [mm]."""
        return np.asarray(
            self.origin + (_ENDS * (np.array(self.shape[::-1]) - 1) * self.spacing) @ self.direction.T
        )

    def crop(self, low: Vector, high: Vector) -> Self:
        """The part of the volume whose voxel centres lie in a box.

        Parameters
        ----------
        low, high : (x, y, z)
            Two opposite corners of a box along the axes of the volume's own coordinates [mm]. Of a rotated
            volume, the smallest box of voxels that holds this box is kept.

        Raises
        ------
        ValueError
            If no voxel lies in the box.
        """
        return self.crop_voxels(*self.box(low, high))

    def crop_voxels(self, start: tuple[int, int, int], stop: tuple[int, int, int]) -> Self:
        """The part from voxel `start` to before `stop`, (z, y, x); ValueError unless both lie inside."""
        box = [(int(a), int(b)) for a, b in zip(start, stop, strict=True)]
        refuse(
            len(box) != 3 or not all(0 <= a < b <= n for (a, b), n in zip(box, self.shape, strict=True)),
            f"start and stop must be a box of voxels (z, y, x) in {self.shape}, got {tuple(start)} to "
            f"{tuple(stop)}",
        )
        return self._moved(
            self.voxels[tuple(slice(a, b) for a, b in box)],
            f"cropped to voxels {tuple(start)} to {tuple(stop)} (z, y, x) of {self.shape}",
            origin=self.origin + self.patient_point(np.array(start[::-1]) * self.spacing),
        )

    @doing("resampling a volume")
    def resample(self, spacing: float | ArrayLike) -> Self:
        """The volume with another voxel spacing, over the same field of view.

        The grid begins at the same corner; its last voxel may reach beyond the old voxels.

        Grey values become float32. Along an axis with smaller voxels they are interpolated linearly between
        voxel centres, and constant outside. Along an axis with larger voxels they are means over each voxel.

        A new voxel gets the label of the old voxel at its centre. Structures thinner than a larger voxel can
        vanish.

        Parameters
        ----------
        spacing : float or (x, y, z)
            [mm]

        Raises
        ------
        ValueError
            If the spacing is not positive, or makes too many voxels.

        Notes
        -----
        For bone, `Volume.to_bone` with a spacing interpolates the occupancy instead of grey values.
        """
        new = checked_spacing(spacing)
        if np.allclose(new, self.spacing, rtol=1e-9, atol=0):
            return self
        return self._moved(
            self._resampling(self.voxels, self.spacing, new),
            f"grey values resampled from {_times(self.spacing)} mm",
            spacing=new,
            origin=self._origin_at(new),
        )

    def _origin_at(self, spacing: Array) -> Array:
        """Centre of the first voxel of another grid that begins at the same corner."""
        return np.asarray(self.origin + self.patient_point((spacing - self.spacing) / 2))

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({_times(self.shape[::-1])} voxels of {_times(self.spacing)} mm, "
            f"{self.voxels.dtype}, {self.path})"
        )


def box_text(grid: OnGrid) -> str:
    """Bounds of a volume's voxel centres in its own coordinates, as text."""
    corners = grid.corners()
    return f"between {point_text(corners.min(axis=0))} and {point_text(corners.max(axis=0))} mm"


def same_geometry(first: OnGrid, second: OnGrid) -> bool:
    """Whether two volumes have as many voxels, and no corner is off by more than `SAME` of a voxel.

    Examples
    --------
    >>> import numpy as np
    >>> from burrlab.volume import Volume
    >>> coarse, fine = (Volume(np.zeros((4, 4, 4)), np.full(3, apart), np.zeros(3), np.eye(3), "a cube") for apart in (0.2, 0.1))
    >>> same_geometry(coarse, coarse), same_geometry(coarse, fine)
    (True, False)
    """
    return not _difference(first, second)


def check_same_geometry(first: OnGrid, second: OnGrid) -> None:
    """ValueError that names the difference, unless two volumes have the same geometry.

    Examples
    --------
    >>> import numpy as np
    >>> from burrlab.volume import Volume
    >>> ct = Volume(np.zeros((4, 4, 4)), np.full(3, 0.2), np.zeros(3), np.eye(3), "a cube")
    >>> check_same_geometry(ct, ct)
    """
    what = _difference(first, second)
    refuse(what, f"{first.path} and {second.path} must have the same geometry: {what}")


def _difference(first: OnGrid, second: OnGrid) -> str:
    """The first difference of two geometries; empty if there is none."""
    sides = np.minimum(first.spacing, second.spacing)
    off = float(np.linalg.norm(first.corners() - second.corners(), axis=1).max())
    turn = [point_text(column) for column in (*first.direction.T, *second.direction.T)]
    differences = {
        f"{_times(first.shape[::-1])} voxels against {_times(second.shape[::-1])}": first.shape
        != second.shape,
        f"spacing {point_text(first.spacing)} against {point_text(second.spacing)} mm": (
            np.any(np.abs(first.spacing - second.spacing) > 1e-3 * sides)
        ),
        "": off <= SAME * sides.min(),
        f"directions {', '.join(turn[:3])} against {', '.join(turn[3:])}": (
            np.abs(first.direction - second.direction).max() > 1e-3
        ),
        f"origin {point_text(first.origin)} against {point_text(second.origin)} mm": (
            np.linalg.norm(first.origin - second.origin) > 0.5 * off
        ),
        f"a corner is off by {off:.3g} mm": True,
    }
    return next(text for text, differs in differences.items() if differs)


def grid_of_bone(bone: VoxelBone, like: OnGrid) -> "LabelVolume":
    """The voxels of a bone, all with label 0, in the coordinates of a volume with the same axes."""
    return LabelVolume(
        np.broadcast_to(np.uint8(0), bone.shape),
        np.array(bone.spacing),
        like.patient_point(bone.origin),
        like.direction,
        "the bone",
    )


def _times(values: Iterable[float]) -> str:
    return " x ".join(f"{value:.6g}" for value in values)


def point_text(values: Iterable[float]) -> str:
    """Numbers in parentheses, with six digits."""
    return "(" + ", ".join(f"{v:.6g}" for v in values) + ")"


_WHOLE = 1e-3  # [voxels] tolerance for a whole number of voxels: spacing may be float32


def resampled_shape(
    shape: tuple[int, ...], old: Array, new: Array, work: float = 0.0
) -> tuple[int, int, int]:
    """Number of voxels (z, y, x) of spacing `new` (x, y, z) over the field of view; ValueError if too many.

    `work` is the memory needed besides, in bytes per old voxel.
    """
    with np.errstate(over="ignore"):
        counts = np.maximum(np.ceil(np.array(shape, dtype=float) * old[::-1] / new[::-1] - _WHOLE), 1.0)
        voxels = float(np.prod(counts))
    refuse(
        not voxels <= MOST_VOXELS,
        f"spacing must be coarser or the volume cropped: {new.min():g} mm makes {voxels:.3g} voxels, and "
        f"{MOST_VOXELS:.3g} are the most",
    )
    check_memory(5.0 * voxels + work * math.prod(shape), f"resampling to {voxels:.3g} voxels")
    return tuple(counts.astype(int).tolist())


def resample_linear(values: NDArray[Any], old: Array, new: Array, *, levels: bool = False) -> NDArray[Any]:
    """Values (z, y, x) at the centres of voxels of spacing `new` (x, y, z), from the same corner.

    Along an axis with smaller voxels, values are linear between the two nearest centres and constant
    outside. Along an axis with larger voxels, a value is the mean over the part of the new voxel within the
    volume; old voxels count as uniform.

    Parameters
    ----------
    values : ndarray, shape (z, y, x)
    old, new : ndarray, shape (3,)
        Spacing (x, y, z) [mm].
    levels : bool
        Whether the values are occupancies, and the result has levels of bone, rounded, instead of float32. Beyond the
        volume there is none: the value of a last voxel that reaches out is multiplied by its part within.
    """
    shape = resampled_shape(values.shape, old, new, 28.0 if np.any(new > old) else 8.0)  # as measured
    work = values.astype(np.float32, copy=False)
    for axis in range(3):
        ratio = float(new[2 - axis] / old[2 - axis])
        if ratio > 1.0 + 1e-9:
            work = _averaged(work, axis, shape[axis], ratio)
    (z0, z1, zw), (y0, y1, yw), (x0, x1, xw) = (
        _neighbours(work.shape[axis], shape[axis], min(float(new[2 - axis] / old[2 - axis]), 1.0))
        for axis in range(3)
    )
    # Part of the last voxel that lies in the volume; 1 if both end together but for rounding.
    last = np.array(values.shape) * old[::-1] / new[::-1] - (np.array(shape) - 1)
    within = np.where(levels & (last < 1.0 - _WHOLE), last, 1.0).astype(np.float32)
    resampled = np.empty(shape, np.uint8 if levels else np.float32)
    for k in range(shape[0]):  # plane by plane: no copies of a large volume
        plane = work[z0[k]] + zw[k] * (work[z1[k]] - work[z0[k]])
        plane = plane[y0] + yw[:, None] * (plane[y1] - plane[y0])
        plane = plane[:, x0] + xw * (plane[:, x1] - plane[:, x0])
        plane[-1] *= within[1]
        plane[:, -1] *= within[2]
        plane = plane if k < shape[0] - 1 else plane * within[0]
        resampled[k] = np.rint(255.0 * plane.astype(np.float64)) if levels else plane
    return resampled


def resample_nearest(labels: NDArray[Any], old: Array, new: Array) -> NDArray[Any]:
    """Labels (z, y, x) of the old voxels at the centres of the new ones; on a face, of the lower voxel."""
    shape = resampled_shape(labels.shape, old, new)
    places = (
        np.clip(np.ceil((np.arange(count) + 0.5) * ratio - 1e-9) - 1, 0, side - 1).astype(int)
        for side, count, ratio in zip(labels.shape, shape, (new / old)[::-1], strict=True)
    )
    return np.asarray(labels[np.ix_(*places)])


def _averaged(values: NDArray[np.float32], axis: int, count: int, ratio: float) -> NDArray[np.float32]:
    old = values.shape[axis]
    edges = np.minimum(np.arange(count + 1) * ratio, old)
    whole = np.minimum(edges.astype(int), old - 1)
    part = (edges - whole).reshape(-1, 1, 1)
    averages = np.empty([count if k == axis else side for k, side in enumerate(values.shape)], np.float32)
    for rows in slabs(values.shape, axis):
        moved = np.moveaxis(values[rows], axis, 0)
        total = np.zeros((old + 1, *moved.shape[1:]))
        np.cumsum(moved, axis=0, out=total[1:], dtype=np.float64)
        at_edge = total[whole] + part * (total[whole + 1] - total[whole])
        averages[rows] = np.moveaxis(np.diff(at_edge, axis=0) / np.diff(edges).reshape(-1, 1, 1), 0, axis)
    return averages


def _neighbours(
    old: int, count: int, ratio: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """The two old centres around each new centre, and its distance from the first of them, 0..1."""
    place = np.clip((np.arange(count) + 0.5) * ratio - 0.5, 0, old - 1)
    first = np.minimum(np.floor(place).astype(np.intp), max(old - 2, 0))
    return first, np.minimum(first + 1, old - 1), (place - first).astype(np.float32)


#: Planes of voxels that are filled at a time, one layer of bricks.
SLAB = 8


def slabs(shape: tuple[int, ...], axis: int) -> Iterator[tuple[slice, slice, slice]]:
    """Indices of slabs of `SLAB` planes that hold whole lines along an axis, for work line by line.

    The work needs little memory besides, and Ctrl-C does not wait for it.
    """
    across = 1 if axis == 0 else 0
    for k in range(0, shape[across], SLAB):
        yield np.s_[:, k : k + SLAB, :] if across else np.s_[k : k + SLAB, :, :]


def empty_bone(shape: tuple[int, ...], spacing: Array, origin: Array) -> VoxelBone:
    """Bone of level 0, to be written slab by slab: no dense copies."""
    check_memory(1.04 * math.prod(shape), f"a bone of {math.prod(shape):.3g} voxels")
    return VoxelBone.block(tuple(shape[::-1] * spacing), tuple(spacing), origin=tuple(origin), level=0)


@dataclass(frozen=True)
class OccupancyMap:
    """Occupancy as a piecewise linear function of the grey value, constant outside its points.

    Parameters
    ----------
    greys : tuple of float
        Two or more grey values, strictly increasing.
    occupancies : tuple of float
        Occupancy at each grey value, 0 (empty) to 1 (solid bone); may rise and fall.

    Raises
    ------
    ValueError
        If there are fewer than two points or the two lengths differ, a grey value is not finite or not above
        the one before it, or an occupancy is outside 0 to 1.

    Examples
    --------
    >>> OccupancyMap.two_point(90, 180).levels(np.array([0, 90, 135, 180, 255]))
    array([  0,   0, 128, 255, 255], dtype=uint8)
    """

    greys: tuple[float, ...]
    occupancies: tuple[float, ...]

    def __post_init__(self) -> None:
        greys = tuple(scalar(g, "greys") for g in self.greys)
        occupancies = tuple(scalar(o, "occupancies") for o in self.occupancies)
        refuse(
            len(greys) != len(occupancies) or len(greys) < 2,
            f"map must have two points or more, a grey value and an occupancy each, got {len(greys)} and "
            f"{len(occupancies)}",
        )
        refuse(
            not all(map(math.isfinite, greys)) or any(b <= a for a, b in pairwise(greys)),
            f"map must have finite, increasing grey values, got {greys}",
        )
        refuse(
            not all(0.0 <= o <= 1.0 for o in occupancies),
            f"map must have occupancies within 0 to 1, got {occupancies}",
        )
        self.__dict__.update(greys=greys, occupancies=occupancies)

    @classmethod
    def two_point(cls, empty: float, solid: float) -> "OccupancyMap":
        """Map from 0 at grey value `empty` to 1 at `solid`; ValueError unless `empty` is below `solid`."""
        empty, solid = scalar(empty, "map"), scalar(solid, "map")
        refuse(
            not (math.isfinite(empty) and math.isfinite(solid) and empty < solid),
            f"map must be LO:HI with LO below HI, got {empty:g}:{solid:g}",
        )
        return cls((empty, solid), (0.0, 1.0))

    @classmethod
    def table(cls, greys: Sequence[float], occupancies: Sequence[float]) -> "OccupancyMap":
        """Map from a table of grey values and their occupancies; errors as of the class."""
        return cls(tuple(greys), tuple(occupancies))

    @classmethod
    def parse(cls, text: str) -> "OccupancyMap":
        """Map from the text ``LO:HI`` or ``GREY:OCCUPANCY,GREY:OCCUPANCY,...``; ValueError for other texts.

        Examples
        --------
        >>> OccupancyMap.parse("0:0,300:0.5,1200:1").text
        '0:0,300:0.5,1200:1'
        """
        try:
            pairs = [tuple(float(number) for number in part.split(":")) for part in text.split(",")]
        except ValueError:
            pairs = []
        refuse(
            not pairs or any(len(pair) != 2 for pair in pairs),
            f"must be LO:HI or GREY:OCCUPANCY,GREY:OCCUPANCY,..., got '{text}'",
        )
        if len(pairs) == 1:
            low, high = pairs[0]
            refuse(not low < high, f"must be LO:HI with LO below HI, got '{text}'")
            return cls.two_point(low, high)
        return cls.table([pair[0] for pair in pairs], [pair[1] for pair in pairs])

    @property
    def text(self) -> str:
        """The map as text that `parse` reads."""
        table = zip(self.greys, self.occupancies, strict=True)
        pairs = [self.greys] if self.occupancies == (0.0, 1.0) else table
        # The shortest texts that read back as the same numbers.
        return ",".join(":".join(repr(number).removesuffix(".0") for number in pair) for pair in pairs)

    def occupancy(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Occupancy of grey values, 0 to 1.

        Raises
        ------
        ValueError
            If a value is not finite.
        """
        return np.asarray(self._each(values, np.float32, lambda part: part.astype(np.float32)))

    def levels(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Occupancy of grey values as levels, 0 to 255, rounded; ValueError if one is not finite."""
        return np.asarray(self._each(values, np.uint8, lambda part: np.rint(255.0 * part).astype(np.uint8)))

    def _each(self, values: NDArray[Any], kind: Any, store: Any) -> NDArray[Any]:
        values = np.asarray(values)
        mapped = np.empty(values.shape, kind)
        if values.dtype.kind in "iu" and values.dtype.itemsize <= 2:  # a look-up table is faster
            least = int(np.iinfo(values.dtype).min)
            table = store(self._linear(np.arange(least, np.iinfo(values.dtype).max + 1, dtype=np.float64)))
            for out, part in zip(mapped, values, strict=True) if values.ndim == 3 else [(mapped, values)]:
                out[...] = table[part.astype(np.int32) - least]
            return mapped
        flat, out = values.reshape(-1), mapped.reshape(-1)
        for first in range(0, flat.size, 1 << 22):  # in parts: limits the memory of float64
            part = flat[first : first + (1 << 22)].astype(np.float64)
            refuse(not np.all(np.isfinite(part)), "values must be finite, got some that are not")
            out[first : first + part.size] = store(self._linear(part))
        return mapped

    def _linear(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        # Written out instead of np.interp: the same operations in the same order make the same bone anywhere.
        greys, occupancies = np.array(self.greys), np.array(self.occupancies)
        place = np.clip(np.searchsorted(greys, values, side="right") - 1, 0, len(greys) - 2)
        low, high = greys[place], greys[place + 1]
        part = np.clip((values - low) / (high - low), 0.0, 1.0)
        return np.asarray(occupancies[place] + part * (occupancies[place + 1] - occupancies[place]))


@dataclass(frozen=True, eq=False, repr=False)
class Volume(OnGrid):
    """Grey values on a grid, placed in the volume's own coordinates.

    Parameters
    ----------
    values : ndarray, shape (nz, ny, nx)
        Grey values, finite. Kept as a read-only view.
    spacing : (x, y, z)
        Along the voxel axes [mm].
    origin : (x, y, z)
        Centre of voxel (0, 0, 0) in the volume's own coordinates [mm]; for patients these are LPS.
    direction : array_like, shape (3, 3)
        Columns are the voxel axes in the volume's own coordinates: orthonormal, right- or left-handed. A
        matrix that is off by up to 1e-4, from rounding in a header, is replaced by the nearest orthonormal.
    path : str
        Source of the volume.
    notes : tuple of str
        Assumptions and steps that led to the volume, in sentences.
    files : tuple of str
        Files of a DICOM series, in the order of the slices.

    Raises
    ------
    ValueError
        If the values are not finite numbers in three dimensions, a spacing is not positive, or the direction
        is not orthonormal.
    """

    _ARRAY = "values"
    _resampling = staticmethod(resample_linear)

    values: NDArray[Any]
    spacing: Array
    origin: Array
    direction: Array
    path: str
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        values = np.asarray(self.values)
        refuse(
            values.ndim != 3 or values.size == 0 or values.dtype.kind not in "iuf",
            f"values must be numbers in three dimensions, got shape {values.shape} of {values.dtype}",
        )
        check_finite(values, self.path)
        self._check(values)

    _repr_html_ = object_html

    @doing("making bone of grey values")
    def to_bone(self, mapping: OccupancyMap, *, spacing: float | ArrayLike | None = None) -> VoxelBone:
        """Bone whose occupancy follows from the grey values by a map.

        Parameters
        ----------
        mapping : OccupancyMap
        spacing : float or (x, y, z), optional
            Spacing of the bone [mm]; default the volume's own. The map acts first. The occupancy is then
            interpolated as by `resample`, and rounded to levels once, which keeps the amount of bone. Beyond
            the volume there is no bone: a last voxel that reaches out is filled by its part within.

        Raises
        ------
        ValueError
            If the spacing is not positive, or makes too many voxels.
        TypeError
            If the map is none.

        Examples
        --------
        >>> volume = Volume(np.full((4, 4, 4), 180), (0.4, 0.4, 0.4), (0, 0, 0), np.eye(3), "solid")
        >>> volume.to_bone(OccupancyMap.two_point(90, 180), spacing=0.1).shape
        (16, 16, 16)
        """
        require_type("map", mapping, OccupancyMap, "OccupancyMap.two_point(90, 180)")
        new = self.spacing if spacing is None else checked_spacing(spacing)
        if np.allclose(new, self.spacing, rtol=1e-9, atol=0):
            bone = empty_bone(self.shape, self.spacing, self.bone_point(self.origin))
            for k in range(0, len(self.values), SLAB):
                bone.write(mapping.levels(self.values[k : k + SLAB]), (k, 0, 0))
            return bone
        return VoxelBone(
            resample_linear(mapping.occupancy(self.values), self.spacing, new, levels=True),
            spacing=new,
            origin=self.bone_point(self._origin_at(new)),
        )

    def specimen(
        self, mapping: OccupancyMap, *, entry: Vector, axis: Vector, spacing: float | ArrayLike | None = None
    ) -> Specimen:
        """The bone with an axis. Immersion counts from the point where the axis first reaches level 128.

        Parameters
        ----------
        mapping, spacing
            As for `to_bone`.
        entry : (x, y, z)
            Start of the axis, in the volume's own coordinates [mm].
        axis : (x, y, z)
            Direction into the bone, in the volume's own coordinates.

        Raises
        ------
        ValueError
            If the axis meets no bone, or the entry lies inside bone or farther away than the volume is wide;
            and as `to_bone`.
        TypeError
            As `to_bone`.
        """
        return grey_specimen(
            self, self.to_bone(mapping, spacing=spacing), mapping, entry, axis, lambda: self.values
        )


def grey_specimen(
    grid: OnGrid,
    bone: VoxelBone,
    mapping: OccupancyMap,
    entry: Vector,
    axis: Vector,
    whole: Callable[[], NDArray[Any]],
) -> Specimen:
    """Specimen of a bone that a map made of a grey volume, whose voxels are looked at for a message alone.

    Errors as `Volume.specimen`.
    """
    return specimen_in(grid, bone, entry, axis, {
        "path": grid.path, "map": mapping.text, "volume_spacing_mm": grid.spacing.tolist(), "voxel_mm": list(bone.spacing),
        "origin_mm": grid.origin.tolist(), "direction": grid.direction.tolist(), "notes": list(grid.notes),
    }, f"map {mapping.text}", whole)  # fmt: skip


def specimen_in(
    grid: OnGrid,
    bone: VoxelBone,
    entry: Vector,
    axis: Vector,
    provenance: dict[str, Any],
    how: str,
    whole: Callable[[], NDArray[Any]] | None = None,
) -> Specimen:
    """Specimen of a bone on a volume's voxel axes, with an axis in the volume's own coordinates.

    `whole` returns the grey values, which only a message needs. Errors as `Volume.specimen`.
    """
    direction = np.asarray(grid.direction.T @ unit_vector(axis))
    at = checked_point(entry, "entry")
    start = grid.bone_point(at)
    low, high = grid.corners().min(axis=0), grid.corners().max(axis=0)
    beyond = math.hypot(*np.maximum(0, np.maximum(low - at, at - high)))
    # An entry so far away is hardly meant, even if its axis meets bone.
    refuse(
        beyond > math.hypot(*(high - low)),
        f"entry: {tuple(map(float, entry))} lies {beyond:.0f} mm outside {grid.path}, more than it is wide; "
        + _place(low, high, at),
    )
    surface = surface_along(bone, start, direction)
    if surface is None:
        greys = f", whose grey values are {whole().min():g} to {whole().max():g}" if whole else ""
        raise ValueError(
            f"entry: the axis from {tuple(map(float, entry))} meets no occupancy of 128 in {grid.path}{greys}; "
            + _place(low, high, at)
        )
    refuse(
        np.array_equal(surface, start),
        f"entry: {tuple(map(float, entry))} lies inside bone; begin outside it",
    )
    source = f"{grid.path}, {how}, entry {tuple(map(float, entry))}, axis {tuple(map(float, axis))}"
    return Specimen(bone, surface, direction, source, provenance)


def _place(low: Array, high: Array, entry: Array) -> str:
    """Sentence on where a volume lies, from its least to its largest corner, for a point outside it."""
    sentence = f"the volume lies from {point_text(np.round(low, 2) + 0.0)} to {point_text(np.round(high, 2) + 0.0)} mm, x to the left, y to the back (LPS)"
    mirrored = entry * (-1, -1, 1)
    if np.all((low <= mirrored) & (mirrored <= high)) and not np.all((low <= entry) & (entry <= high)):
        sentence += f"; {point_text(np.round(mirrored, 2) + 0.0)} lies in it: RAS, as 3D Slicer shows, has x and y of the other sign"
    return sentence


def check_finite(values: NDArray[Any], path: str) -> None:
    """ValueError for NaN or infinity, with their count and the first index."""
    if values.dtype.kind == "f" and (bad := ~np.isfinite(values)).any():
        raise ValueError(
            f"{path}: the volume holds values that are not finite: {np.count_nonzero(bad)} of {values.size}, "
            f"the first at (z, y, x) = {_first(bad)}"
        )


def _first(mask: NDArray[np.bool_]) -> tuple[int, ...]:
    """Index of the first voxel of a mask."""
    return tuple(int(i) for i in np.unravel_index(int(np.argmax(mask)), mask.shape))


@dataclass(frozen=True, eq=False, repr=False)
class LabelVolume(OnGrid):
    """Whole numbers on a grid, one a voxel, placed like a `Volume`.

    Parameters
    ----------
    labels : ndarray, shape (nz, ny, nx)
        Whole numbers; whole floats become integers. Kept as a read-only view.
    spacing, origin, direction, path, notes, files
        As for `Volume`.
    names : mapping of int to str
        Names of labels, as far as the file has them.
    colours : mapping of int to (r, g, b)
        Colours of labels, 0 to 255, as far as the file has them.
    unknown_colours : tuple of mapping
        Colours of slices that are in no table, most pixels first, ready for JSON: colour, number of pixels;
        slice, row and column of the first; nearest structure, and its distance in colour (root of the sum of
        squares).

    Raises
    ------
    ValueError
        If the labels are not whole numbers in three dimensions; and as `Volume`.
    """

    _ARRAY = "labels"
    _resampling = staticmethod(resample_nearest)

    labels: NDArray[Any]
    spacing: Array
    origin: Array
    direction: Array
    path: str
    names: dict[int, str] = field(default_factory=dict)
    colours: dict[int, Colour] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    unknown_colours: tuple[Mapping[str, Any], ...] = ()

    def __post_init__(self) -> None:
        self._check(whole_labels(np.asarray(self.labels), self.path))
        for name in self.names.values():
            require_type("a name", name, str, "'facial nerve'")
        colours = {int(label): (int(r), int(g), int(b)) for label, (r, g, b) in self.colours.items()}
        for label, colour in colours.items():
            refuse(
                not all(0 <= channel <= 255 for channel in colour),
                f"colours must be of channels 0 to 255, got {colour} for label {label}",
            )
        self.__dict__.update(names={int(label): name for label, name in self.names.items()}, colours=colours)

    @doing("bringing labels on the voxels of a volume")
    def on(self, volume: OnGrid) -> "LabelVolume":
        """The labels on the voxels of a volume: each voxel gets the label at its centre, 0 if there is none.

        The labels may be finer than the volume, or rotated. Structures thinner than a voxel of the volume can
        vanish. If the labels cover only a part of the volume, the notes say how much.

        Raises
        ------
        ValueError
            If no voxel of the volume has its centre in the labels.
        """
        start = self.bone_point(volume.origin - self.origin)
        # Columns: one voxel of the volume along the axes of the labels [mm].
        steps = (self.direction.T @ volume.direction) * volume.spacing
        z, y, x = (np.arange(n) for n in volume.shape)
        spacing, sizes = (np.reshape(along, (3, 1, 1)) for along in (self.spacing, self.shape[::-1]))
        resampled, covered = np.zeros(volume.shape, self.labels.dtype), 0
        # Along each axis of the labels, for a plane of voxels at a time: no large arrays of indices.
        across = start[:, None] + steps[:, 0, None] * x
        for k in z:
            along = across[:, None] + (steps[:, 1, None] * y)[:, :, None] + (steps[:, 2] * k)[:, None, None]
            places = np.ceil(along / spacing - 0.5 - 1e-9).astype(np.int64)
            inside = np.all((places >= 0) & (places < sizes), axis=0)
            resampled[k] = np.where(inside, self.labels[tuple(np.clip(places, 0, sizes - 1)[::-1])], 0)
            covered += int(np.count_nonzero(inside))
        refuse(
            not covered,
            f"labels must overlap the volume: those of {self.path} lie {box_text(self)}, and {volume.path} "
            f"{box_text(volume)}",
        )
        note = f"labels are the nearest of {self.path} on the voxels of {volume.path}"
        if covered < resampled.size:  # the part is never rounded to 0 or 100 %
            part = 100 * covered / resampled.size
            note += f", of which they cover {'less than 1' if part < 1 else f'{min(part, 99.9):.3g}'} %"
        return replace(
            self, labels=resampled, spacing=volume.spacing, origin=volume.origin, direction=volume.direction,
            notes=(*self.notes, note), files=(),
        )  # fmt: skip


def whole_labels(labels: NDArray[Any], path: str) -> NDArray[Any]:
    """Labels (z, y, x) as integers; ValueError if one is not a whole number."""
    refuse(
        labels.ndim != 3 or labels.size == 0 or labels.dtype.kind not in "iufb",
        f"{path}: labels must be whole numbers in three dimensions, got shape {labels.shape} of "
        f"{labels.dtype}",
    )
    if labels.dtype.kind != "f" and labels.max() < 2**31:
        return labels.astype(np.uint8) if labels.dtype.kind == "b" else labels
    check_finite(labels, path)
    with np.errstate(invalid="ignore"):  # numbers that are too large become -2^31
        whole = labels.astype(np.int32)
    wrong = (whole != labels) | (whole == -(2**31))
    first = _first(wrong)
    refuse(
        wrong[first],
        f"{path}: labels must be whole numbers below 2^31, got {labels[first]:.10g} at (z, y, x) = {first}",
    )
    return whole
