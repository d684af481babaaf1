"""How a bone is made of a volume: file, box, map, voxels. What results and traces keep, and replicas follow."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from burrlab._core import Burr, VoxelBone
from burrlab.specimen import Specimen, Vector
from burrlab.volume.geometry import Array, checked_point, checked_spacing
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.read import read_volume
from burrlab.volume.stack import is_stack, read_stack, rows_along_x
from burrlab.volume.volume import Volume

_LEAST_VOXELS, _ENOUGH_VOXELS = 4.0, 7.5  # of a burr's radius, as the tick has them


@dataclass(frozen=True)
class VolumeRecipe:
    """A grey volume from a file, what of it is kept, and how it becomes bone.

    Parameters
    ----------
    path : path
        A file, a folder of DICOM slices, or a stack of grey PNG slices; made absolute.
    mapping : OccupancyMap
    spacing : float or (x, y, z), optional
        Where the file has none [mm].
    series : str, optional
        SeriesInstanceUID, where a folder holds more than one.
    crop : (low, high), optional
        Two opposite corners (x, y, z) in the volume's own coordinates [mm]; see `Volume.crop`.
    voxel : float or (x, y, z), optional
        Spacing of the bone [mm]; default the volume's own. See `Volume.to_bone`.
    transpose : bool, optional
        Of slices; see `read_stack`. What it becomes is settled here, so that it stands in results.

    Raises
    ------
    ValueError
        If a spacing is not positive or a corner no point.

    Examples
    --------
    >>> recipe = VolumeRecipe("ct.nrrd", OccupancyMap.two_point(90, 180), voxel=0.1)
    >>> VolumeRecipe.of(recipe.plain()) == recipe
    True
    """

    path: str
    mapping: OccupancyMap
    spacing: tuple[float, float, float] | None = None
    series: str | None = None
    crop: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    voxel: tuple[float, float, float] | None = None
    transpose: bool | None = None
    _read: dict[str, Volume] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", absolute(self.path))
        object.__setattr__(self, "spacing", _spacing(self.spacing, "spacing"))
        object.__setattr__(self, "voxel", _spacing(self.voxel, "voxel"))
        object.__setattr__(self, "transpose", rows_along_x(self.path, self.transpose))
        if self.crop is not None:
            low, high = self.crop
            object.__setattr__(self, "crop", (_point(low), _point(high)))

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> VolumeRecipe:
        """Of what `plain` gave, through JSON too; KeyError, TypeError or ValueError where it is not that.

        Slices without a word on `transpose`, as versions before it wrote, are not transposed.
        """
        points, series, crop = list(plain["map"]), plain.get("series"), plain.get("crop_mm")
        if points and not isinstance(points[0], Sequence):
            mapping = OccupancyMap.two_point(*map(float, points))
        else:
            mapping = OccupancyMap(tuple(g for g, _ in points), tuple(o for _, o in points))
        if crop is not None:
            low, high = crop
            crop = (low, high)
        return cls(
            os.fspath(plain["path"]), mapping, plain.get("spacing_mm"), None if series is None else str(series), crop,
            plain.get("voxel_mm"), bool(plain.get("transpose", False)),
        )  # fmt: skip

    def plain(self) -> dict[str, Any]:
        """Ready for JSON; what is not given is left out."""
        mapping = self.mapping
        two = mapping.occupancies == (0.0, 1.0)
        pairs = [list(pair) for pair in zip(mapping.greys, mapping.occupancies, strict=True)]
        given = {
            "spacing_mm": None if self.spacing is None else list(self.spacing),
            "series": self.series,
            "crop_mm": None if self.crop is None else [list(corner) for corner in self.crop],
            "voxel_mm": None if self.voxel is None else list(self.voxel),
            "transpose": self.transpose if self.transpose or is_stack(self.path) else None,
        }
        return {
            "kind": "volume",
            "path": self.path,
            "map": list(mapping.greys) if two else pairs,
            **{name: value for name, value in given.items() if value is not None},
        }

    def at(self, path: str | os.PathLike[str]) -> VolumeRecipe:
        """The same of a volume that lies elsewhere."""
        return replace(self, path=os.fspath(path))

    def volume(self) -> Volume:
        """The volume, cropped; read once.

        Raises
        ------
        FileNotFoundError, ImportError
            As `read_volume`.
        ValueError
            As `read_volume`, `read_stack` and `Volume.crop`; or if a stack holds labels.
        """
        if "volume" not in self._read:
            volume = _grey(self.path, self.spacing, self.series, bool(self.transpose))
            self._read["volume"] = volume if self.crop is None else volume.crop(*self.crop)
        return self._read["volume"]

    def notes(self) -> tuple[str, ...]:
        """What was assumed or done on reading the volume; errors as `volume`."""
        return self.volume().notes

    def bone(self) -> VoxelBone:
        """The bone; errors as `volume` and `Volume.to_bone`."""
        return self.volume().to_bone(self.mapping, spacing=self.voxel)

    def like(self) -> Volume:
        """The volume on the voxels of the bone, for `save_drilled`."""
        return self.volume() if self.voxel is None else self.volume().resample(self.voxel)

    def specimen(self, *, entry: Vector, axis: Vector) -> Specimen:
        """The bone with an axis; parameters and errors as `Volume.specimen`."""
        found = self.volume().specimen(self.mapping, entry=entry, axis=axis, spacing=self.voxel)
        return replace(found, made={**found.made, "recipe": self.plain()})

    def check_burr(self, burr: Burr) -> None:
        """Raises ValueError if the burr is too small for the bone's voxels, with the spacing that would do."""
        check_radius(burr, self.volume().spacing if self.voxel is None else np.array(self.voxel))


def check_radius(burr: Burr, spacing: Array) -> None:
    """Raises ValueError if the burr is too small for voxels of a spacing (x, y, z) [mm]."""
    if burr.radius < _LEAST_VOXELS * spacing.max():
        raise ValueError(
            f"radius of the burr must be at least {_LEAST_VOXELS:g} voxels of {spacing.max():g} mm, got {burr.radius:g} mm; "
            f"--voxel {enough(burr)} (voxel={enough(burr)}) makes finer ones"
        )


def enough(burr: Burr) -> str:
    """The spacing that serves a burr, R/7.5 rounded down to two digits [mm]."""
    digits = 1 - int(np.floor(np.log10(burr.radius / _ENOUGH_VOXELS)))
    return f"{np.floor(burr.radius / _ENOUGH_VOXELS * 10**digits + 1e-9) / 10**digits:g}"


def _grey(
    path: str, spacing: tuple[float, float, float] | None, series: str | None, transpose: bool
) -> Volume:
    if not is_stack(path):
        if transpose:
            raise ValueError(f"transpose (--transpose) goes with PNG slices, got {path}")
        return read_volume(path, spacing=spacing, series=series)
    found = read_stack(path, spacing=spacing, transpose=transpose)
    if not isinstance(found, Volume):
        raise ValueError(f"{path}: the slices are coloured labels, and a map is of grey values")
    return found


def absolute(path: str | os.PathLike[str]) -> str:
    """The path from the root; ".." after a link goes where the system takes it. ValueError where no refusal may quote it."""
    if re.search(r"[\0-\x1f\x7f]", os.fspath(path)):
        raise ValueError(f"path must hold no control characters, got {os.fspath(path)!r}")
    return os.path.realpath(path) if ".." in Path(path).parts else os.path.abspath(path)


def _spacing(value: float | ArrayLike | None, what: str) -> tuple[float, float, float] | None:
    if value is None:
        return None
    x, y, z = (float(s) for s in checked_spacing(value, what))
    return x, y, z


def _point(value: ArrayLike) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in checked_point(value, "crop"))
    return x, y, z
