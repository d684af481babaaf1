"""Labels on a grid: which structure each voxel belongs to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab.arguments import require_type
from burrlab.specimen import Vector
from burrlab.volume.geometry import (
    Array,
    OnGrid,
    box_text,
    checked_direction,
    checked_point,
    checked_spacing,
    slices,
)
from burrlab.volume.resample import resample_nearest
from burrlab.volume.volume import check_finite


@dataclass(frozen=True, eq=False)
class LabelVolume(OnGrid):
    """Whole numbers on a grid, one a voxel, placed as a `Volume` is.

    Parameters
    ----------
    labels : ndarray, shape (nz, ny, nx)
        Whole numbers; floats that are whole become integers. Kept as a read-only view.
    spacing, origin, direction, path, notes, files
        As for `Volume`.
    names : mapping of int to str
        Of labels, as far as the file gives them.
    colours : mapping of int to (r, g, b)
        0 to 255, as far as the file gives them.
    unknown_colours : tuple of mapping
        Of coloured slices the colours that are in no table, most pixels first, ready for JSON: colour, pixels, the first one's slice, row
        and column, the nearest structure, and how far that is in colour (root of the sum of squares).

    Raises
    ------
    ValueError
        If the labels are not whole numbers in three dimensions; else as `Volume`.
    """

    labels: NDArray[Any]
    spacing: Array
    origin: Array
    direction: Array
    path: str
    names: dict[int, str] = field(default_factory=dict)
    colours: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    unknown_colours: tuple[Mapping[str, Any], ...] = ()

    def __post_init__(self) -> None:
        labels = whole_labels(np.asarray(self.labels), self.path).view()
        labels.flags.writeable = False
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "spacing", checked_spacing(self.spacing))
        object.__setattr__(self, "origin", checked_point(self.origin, f"{self.path}: origin"))
        object.__setattr__(self, "direction", checked_direction(self.direction, self.path))
        for name in self.names.values():
            require_type("a name", name, str, "'facial nerve'")
        object.__setattr__(self, "names", {int(label): name for label, name in self.names.items()})
        object.__setattr__(self, "colours", _colours(self.colours))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along (z, y, x)."""
        z, y, x = self.labels.shape
        return z, y, x

    def crop(self, low: Vector, high: Vector) -> LabelVolume:
        """The voxels whose centres lie in a box, as `Volume.crop`."""
        return self.crop_voxels(*self.box(low, high))

    def crop_voxels(self, start: tuple[int, int, int], stop: tuple[int, int, int]) -> LabelVolume:
        """The voxels from `start` up to but without `stop`, indices (z, y, x); ValueError unless they lie in the volume."""
        kept = self.labels[slices(self.shape, start, stop)]
        origin = self.origin + self.patient_point(np.array(start[::-1]) * self.spacing)
        return replace(self, labels=kept, origin=origin)

    def resample(self, spacing: float | ArrayLike) -> LabelVolume:
        """The labels on voxels of another spacing, each that of the old voxel in which its centre lies.

        Field of view and grid are those of `Volume.resample`. Where voxels become larger, what is thinner than they are can go.

        Parameters
        ----------
        spacing : float or (x, y, z)
            [mm]

        Raises
        ------
        ValueError
            If the spacing is not positive, or makes too many voxels.
        """
        new = checked_spacing(spacing)
        if np.allclose(new, self.spacing, rtol=1e-9, atol=0):
            return self
        origin = self.origin + self.patient_point((new - self.spacing) / 2)
        return replace(
            self, labels=resample_nearest(self.labels, self.spacing, new), spacing=new, origin=origin
        )

    def on(self, volume: OnGrid) -> LabelVolume:
        """The labels on the voxels of a volume: of the voxel in which the centre of each lies, 0 where there is none.

        Segmentations may be finer than their volume, or turned. Structures thinner than a voxel of the volume can go. Where the
        labels cover a part of the volume, the notes say how much.

        Raises
        ------
        ValueError
            If no voxel of the volume has its centre in the labels.
        """
        turn = self.direction.T @ volume.direction
        start = self.bone_point(volume.origin - self.origin)
        steps = turn * volume.spacing  # columns: of one voxel of the volume, along the axes here [mm]
        z, y, x = (np.arange(n) for n in volume.shape)
        sizes = self.shape[::-1]
        found, covered = np.zeros(volume.shape, self.labels.dtype), 0
        for k in z:  # plane by plane: no large arrays of places
            inside = np.ones((len(y), len(x)), bool)
            places = []
            for axis in range(3):
                along = start[axis] + steps[axis, 0] * x + (steps[axis, 1] * y)[:, None] + steps[axis, 2] * k
                place = np.ceil(along / self.spacing[axis] - 0.5 - 1e-9).astype(np.int64)
                inside &= (place >= 0) & (place < sizes[axis])
                places.append(np.clip(place, 0, sizes[axis] - 1))
            found[k] = np.where(inside, self.labels[places[2], places[1], places[0]], 0)
            covered += int(np.count_nonzero(inside))
        if not covered:
            raise ValueError(
                f"labels must overlap the volume: those of {self.path} lie {box_text(self)}, and {volume.path} {box_text(volume)}"
            )
        note = f"labels are the nearest of {self.path} on the voxels of {volume.path}"
        if covered < found.size:
            note += f", of which they cover {_percent(covered / found.size)}"
        return replace(
            self, labels=found, spacing=volume.spacing, origin=volume.origin, direction=volume.direction,
            notes=(*self.notes, note), files=(),
        )  # fmt: skip

    def __repr__(self) -> str:
        sizes = " x ".join(str(n) for n in self.shape[::-1])
        apart = " x ".join(f"{s:g}" for s in self.spacing)
        return f"LabelVolume({sizes} voxels of {apart} mm, {self.labels.dtype}, {self.path})"


def whole_labels(labels: NDArray[Any], path: str) -> NDArray[Any]:
    """Integers of labels, (z, y, x); ValueError where one is not whole."""
    if labels.ndim != 3 or labels.size == 0 or labels.dtype.kind not in "iufb":
        raise ValueError(
            f"{path}: labels must be whole numbers in three dimensions, got shape {labels.shape} of {labels.dtype}"
        )
    if labels.dtype.kind == "b":
        return labels.astype(np.uint8)
    if labels.dtype.kind != "f":
        return labels
    check_finite(labels, path)
    with np.errstate(invalid="ignore"):  # what is too large becomes the least number
        found = labels.astype(np.int32)
    wrong = (found != labels) | (found == -(2**31))
    if wrong.any():
        first = tuple(int(i) for i in np.unravel_index(int(np.argmax(wrong)), labels.shape))
        raise ValueError(
            f"{path}: labels must be whole numbers below 2^31, got {labels[first]:.10g} at (z, y, x) = {first}"
        )
    return found


def _percent(part: float) -> str:
    """Never 0 or 100 where it is neither."""
    return "less than 1 %" if part < 0.01 else f"{min(100 * part, 99.9):.3g} %"


def _colours(colours: Mapping[int, Any]) -> dict[int, tuple[int, int, int]]:
    found = {}
    for label, colour in colours.items():
        r, g, b = (int(channel) for channel in colour)
        if not all(0 <= channel <= 255 for channel in (r, g, b)):
            raise ValueError(f"colours must be of channels 0 to 255, got {colour} for label {label}")
        found[int(label)] = (r, g, b)
    return found
