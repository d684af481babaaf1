"""Grey values on a grid, and the bone that a map of occupancy makes of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.specimen import Specimen, Vector, surface_along, unit_vector
from burrlab.volume.geometry import Array, OnGrid, checked_direction, checked_point, checked_spacing, slices
from burrlab.volume.occupancy_map import OccupancyMap, occupancy_map
from burrlab.volume.resample import resample_linear


@dataclass(frozen=True, eq=False)
class Volume(OnGrid):
    """Grey values on a grid, placed in the volume's own coordinates.

    Parameters
    ----------
    values : ndarray, shape (nz, ny, nx)
        Grey values, finite. Kept as a read-only view.
    spacing : (x, y, z)
        Along the voxel axes [mm].
    origin : (x, y, z)
        Centre of voxel (0, 0, 0) in the volume's own coordinates, of patients LPS [mm].
    direction : array_like, shape (3, 3)
        Columns are the voxel axes in the volume's own coordinates; orthonormal, left-handed allowed. Off by up to 1e-4, as
        headers round it, it is replaced by the nearest that is.
    path : str
        Where it comes from.
    notes : tuple of str
        What was assumed or done on the way, in sentences.
    files : tuple of str
        Of a DICOM series, in the order of the slices that were read.

    Raises
    ------
    ValueError
        If the values are no numbers in three dimensions or not finite, a spacing is not positive, or the direction not orthonormal.
    """

    values: NDArray[Any]
    spacing: Array
    origin: Array
    direction: Array
    path: str
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        values = np.asarray(self.values).view()
        if values.ndim != 3 or values.size == 0 or values.dtype.kind not in "iuf":
            raise ValueError(
                f"values must be numbers in three dimensions, got shape {values.shape} of {values.dtype}"
            )
        check_finite(values, self.path)
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "spacing", checked_spacing(self.spacing))
        object.__setattr__(self, "origin", checked_point(self.origin, f"{self.path}: origin"))
        object.__setattr__(self, "direction", checked_direction(self.direction, self.path))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along (z, y, x)."""
        z, y, x = self.values.shape
        return z, y, x

    def crop(self, low: Vector, high: Vector) -> Volume:
        """The voxels whose centres lie in a box.

        Parameters
        ----------
        low, high : (x, y, z)
            Two opposite corners in the volume's own coordinates [mm]. The box is along their axes; in a turned volume the
            smallest box of voxels that holds it is kept.

        Raises
        ------
        ValueError
            If no voxel lies in the box.
        """
        return self.crop_voxels(*self.box(low, high))

    def crop_voxels(self, start: tuple[int, int, int], stop: tuple[int, int, int]) -> Volume:
        """The voxels from `start` up to but without `stop`, indices (z, y, x); ValueError unless they lie in the volume."""
        kept = self.values[slices(self.shape, start, stop)]
        origin = self.origin + self.patient_point(np.array(start[::-1]) * self.spacing)
        note = f"cropped to voxels {tuple(start)} to {tuple(stop)} (z, y, x) of {self.shape}"
        return replace(self, values=kept, origin=origin, notes=(*self.notes, note))

    def resample(self, spacing: float | ArrayLike) -> Volume:
        """The grey values on voxels of another spacing, over the same field of view; float32.

        Trilinear between voxel centres; along an axis whose voxels become larger, the mean over each of them. The grid begins
        at the same corner, and its last voxel may reach beyond the old ones; there the outermost value holds.

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
        This interpolates the grey values. For bone, `to_bone` with a spacing interpolates the occupancy instead.
        """
        new = checked_spacing(spacing)
        if np.allclose(new, self.spacing, rtol=1e-9, atol=0):
            return self
        values = resample_linear(self.values, self.spacing, new)
        note = f"grey values resampled from {_text(self.spacing)} mm"
        return replace(
            self, values=values, spacing=new, origin=self._origin_at(new), notes=(*self.notes, note)
        )

    def to_bone(
        self,
        mapping: OccupancyMap | float,
        solid: float | None = None,
        *,
        spacing: float | ArrayLike | None = None,
    ) -> VoxelBone:
        """Bone of the occupancy that a map gives to the grey values.

        Parameters
        ----------
        mapping : OccupancyMap or float
            Or the grey value of empty, with `solid`: a two-point map.
        solid : float, optional
            Grey value of solid bone.
        spacing : float or (x, y, z), optional
            Of the bone [mm]; default the volume's own. The map acts first, then the occupancy is interpolated as `resample` does
            it, and rounded to levels once: so the amount of bone stays what the map says. Beyond the volume there is none: a last
            voxel that reaches out is filled by its part within.

        Raises
        ------
        ValueError
            If `empty` is not below `solid`, the spacing is not positive, or it makes too many voxels.
        TypeError
            If the map is neither.

        Examples
        --------
        >>> volume = Volume(np.full((4, 4, 4), 180), (0.4, 0.4, 0.4), (0, 0, 0), np.eye(3), "solid")
        >>> volume.to_bone(90, 180, spacing=0.1).shape
        (16, 16, 16)
        """
        chosen = occupancy_map(mapping, solid)
        new = self.spacing if spacing is None else checked_spacing(spacing)
        if np.allclose(new, self.spacing, rtol=1e-9, atol=0):
            return VoxelBone(
                chosen.levels(self.values), spacing=self.spacing, origin=self.bone_point(self.origin)
            )
        levels = resample_linear(
            chosen.occupancy(self.values), self.spacing, new, empty_outside=True, kind=np.uint8, store=_levels
        )
        return VoxelBone(levels, spacing=new, origin=self.bone_point(self._origin_at(new)))

    def specimen(
        self,
        mapping: OccupancyMap | float,
        solid: float | None = None,
        *,
        entry: Vector,
        axis: Vector,
        spacing: float | ArrayLike | None = None,
    ) -> Specimen:
        """The bone with an axis; immersion counts from the axis' first crossing of occupancy 128.

        Parameters
        ----------
        mapping, solid, spacing
            As for `to_bone`.
        entry : (x, y, z)
            Where the axis begins, in the volume's own coordinates [mm].
        axis : (x, y, z)
            Direction into the bone, in the volume's own coordinates.

        Raises
        ------
        ValueError
            If the axis meets no bone, the entry lies inside bone or farther away than the volume is wide, or else as `to_bone`.
        TypeError
            If the map is none.
        """
        chosen = occupancy_map(mapping, solid)
        bone = self.to_bone(chosen, spacing=spacing)
        made = {
            "path": self.path,
            "map": chosen.text,
            "volume_spacing_mm": self.spacing.tolist(),
            "voxel_mm": list(bone.spacing),
            "origin_mm": self.origin.tolist(),
            "direction": self.direction.tolist(),
            "notes": list(self.notes),
        }
        of = f"{self.path}, whose grey values are {self.values.min():g} to {self.values.max():g}"
        return specimen_in(self, bone, entry, axis, made, f"map {chosen.text}", of=of)

    def _origin_at(self, spacing: Array) -> Array:
        """Centre of the first voxel of another grid from the same corner."""
        return np.asarray(self.origin + self.patient_point((spacing - self.spacing) / 2))

    def __repr__(self) -> str:
        sizes = " x ".join(str(n) for n in self.shape[::-1])
        return f"Volume({sizes} voxels of {_text(self.spacing)} mm, {self.values.dtype}, {self.path})"


def specimen_in(
    grid: OnGrid,
    bone: VoxelBone,
    entry: Vector,
    axis: Vector,
    made: dict[str, Any],
    how: str,
    *,
    of: str = "",
) -> Specimen:
    """A bone on the voxel axes of a volume, with an axis in the volume's own coordinates; errors as `Volume.specimen`."""
    direction = np.asarray(grid.direction.T @ unit_vector(axis))
    at = checked_point(entry, "entry")
    start = grid.bone_point(at)
    low, high = grid.corners().min(axis=0), grid.corners().max(axis=0)
    beyond = math.hypot(*np.maximum(0, np.maximum(low - at, at - high)))
    # What begins so far away was hardly meant, though its axis may meet bone.
    if beyond > math.hypot(*(high - low)):
        raise ValueError(
            f"entry: {tuple(map(float, entry))} lies {beyond:.0f} mm outside {grid.path}, more than it is wide; "
            + _place(grid, at)
        )
    surface = surface_along(bone, start, direction)
    if surface is None:
        raise ValueError(
            f"entry: the axis from {tuple(map(float, entry))} meets no occupancy of 128 in {of or grid.path}; "
            + _place(grid, at)
        )
    if np.array_equal(surface, start):
        raise ValueError(f"entry: {tuple(map(float, entry))} lies inside bone; begin outside it")
    where = f"{grid.path}, {how}, entry {tuple(map(float, entry))}, axis {tuple(map(float, axis))}"
    return Specimen(bone, surface, direction, where, made)


def _place(grid: OnGrid, entry: NDArray[Any]) -> str:
    """Where a volume lies, for one who gave a point elsewhere."""
    low, high = grid.corners().min(axis=0), grid.corners().max(axis=0)
    said = f"the volume lies from {_point(low)} to {_point(high)} mm, x to the left, y to the back (LPS)"
    mirrored = entry * (-1, -1, 1)
    if np.all((low <= mirrored) & (mirrored <= high)) and not np.all((low <= entry) & (entry <= high)):
        said += f"; {_point(mirrored)} lies in it: RAS, as 3D Slicer shows, has x and y of the other sign"
    return said


def _point(point: NDArray[Any]) -> str:
    return "(" + ", ".join(f"{x:g}" for x in np.round(point, 2) + 0.0) + ")"


def check_finite(values: NDArray[Any], path: str) -> None:
    """Raises ValueError for NaN or infinity, with their count and the first index."""
    if values.dtype.kind != "f":
        return
    bad = ~np.isfinite(values)
    if not (count := int(np.count_nonzero(bad))):
        return
    first = tuple(int(i) for i in np.unravel_index(int(np.argmax(bad)), values.shape))
    raise ValueError(
        f"{path}: the volume holds values that are not finite: {count} of {values.size}, the first at (z, y, x) = {first}"
    )


def _text(spacing: Array) -> str:
    return " x ".join(f"{s:g}" for s in spacing)


def _levels(occupancy: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.rint(255.0 * occupancy.astype(np.float64)).astype(np.uint8)
