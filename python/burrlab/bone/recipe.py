"""How a bone is made of a volume: file, box, map, voxels. What results and traces keep, and replicas follow.

A block cut out of a volume along an axis: as flat on top as a prepared specimen, the volume's bone within.

How a bone with tissues is made of files. What results and traces keep, and replicas follow.

A bone that was kept in a file, taken up again.

Bones made of recipes, which may come from another machine.
"""

from __future__ import annotations

import math
import os
import re
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from burrlab._core import Burr, Tissues, VoxelBone
from burrlab.bone.formats import read_labels, read_volume
from burrlab.bone.header import assumed, told_notes
from burrlab.bone.image import (
    Array,
    LabelVolume,
    OccupancyMap,
    Volume,
    checked_point,
    checked_spacing,
    occupancy_map,
    specimen_in,
)
from burrlab.bone.kept import DrilledVolume, load_drilled
from burrlab.bone.slices import RANKING, is_stack, read_stack, rows_along_x
from burrlab.bone.snapshot import bone_source, load_bone, tissues_from_json, tissues_to_json
from burrlab.bone.specimen import MOST_VOXELS, Specimen, Vector
from burrlab.bone.tissues import EMPTY, LabelledBone, labelled_bone, placed_on
from burrlab.common.check import real
from burrlab.common.records import UNREADABLE as _UNREADABLE

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


def cut_block(
    recipe: VolumeRecipe, size: Sequence[float], voxel: float, *, entry: Vector, axis: Vector
) -> VoxelBone:
    """The bone below the plane across an axis at its first crossing of occupancy 128, in a frame of its own.

    The crossing becomes (0, 0, 0), the axis -z; x lies across it and across the voxel axis that is furthest from it. Levels are
    trilinear between those of the recipe's bone; beyond the volume there are none. What stands above the plane is cut off.

    Parameters
    ----------
    recipe : VolumeRecipe
        Its `voxel` should be no coarser than the block's.
    size : (x, y, z)
        Of the block [mm]; its top is at z = 0, in the middle of x and y.
    voxel : float
        Its spacing [mm].
    entry, axis : (x, y, z)
        In the volume's own coordinates; see `Volume.specimen`.

    Raises
    ------
    ValueError
        If a length is not positive, the block has too many voxels, or as `VolumeRecipe.specimen`.
    """
    sides, apart = checked_spacing(size, "size"), float(checked_spacing(voxel, "voxel")[0])
    counts = np.maximum(np.round(sides / apart), 1)
    if not (voxels := math.prod(counts.tolist())) <= MOST_VOXELS:
        raise ValueError(
            f"voxel must be coarser: the block has {voxels:.3g} voxels, and {MOST_VOXELS:.3g} are the most"
        )
    found = recipe.specimen(entry=entry, axis=axis)
    across = np.cross(found.axis, np.eye(3)[np.argmin(np.abs(found.axis))])
    across /= np.linalg.norm(across)
    turn = np.column_stack(
        [across, np.cross(-found.axis, across), -found.axis]
    )  # the block's axes in the bone frame
    x, y, z = (int(n) for n in counts)
    first = np.array([0.5 * (1 - x) * apart, 0.5 * (1 - y) * apart, (0.5 - z) * apart])
    levels, out = found.bone.density, np.empty((z, y, x), np.uint8)
    scale, origin = np.array(found.bone.spacing), np.array(found.bone.origin)
    plane = np.stack(np.meshgrid(np.arange(x), np.arange(y), indexing="xy"), -1) * apart
    for k in range(z):
        points = np.concatenate([plane, np.full((y, x, 1), k * apart)], axis=-1) + first
        places = (found.surface + points @ turn.T - origin) / scale
        out[k] = np.rint(
            map_coordinates(
                levels, np.moveaxis(places[..., ::-1], -1, 0), output=float, order=1, mode="grid-constant"
            )
        )
    return VoxelBone(out, spacing=apart, origin=first)


_EMPTY_BEFORE = ("air",)  # where a recipe does not say it
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class LabelledRecipe:
    """Labels from a file, their table, and the grey volume that they belong to, if any.

    Parameters
    ----------
    labels : path
        A file, or a stack of coloured PNG slices; made absolute.
    tissues : Tissues
    grey : VolumeRecipe, optional
        Without it what is labelled is solid; see `labelled_bone`.
    fill : mapping of str to float
        See `labelled_bone`.
    spacing : (x, y, z), optional
        Of the labels, where their file has none [mm].
    unknown : str or int
        Of colours that are in no table; see `read_stack`.
    unit : float, optional
        Of the dimensions in a YAML file [mm].
    crop, voxel : optional
        As of `VolumeRecipe`, of labels alone: a grey volume has its own.
    onto : bool
        Bring the labels on the voxels of the grey volume: see `LabelVolume.on`.
    empty : tuple of str
        See `labelled_bone`. A recipe of an earlier version, which does not say it, has air alone.
    transpose : bool, optional
        Of labels in slices; see `read_stack`. What it becomes is settled here, so that it stands in results.
    ranking : sequence of str, optional
        Of structures that overlap in slices; see `read_stack`. Recipes of earlier versions have none.
    smooth : float, optional
        Of labels alone [mm]; see `labelled_bone`.

    Raises
    ------
    ValueError
        If `transpose` must be told, as of `read_stack`; if a crop, a spacing of the bone or `smooth` is given beside a grey volume,
        or `onto` without one.
    """

    labels: str
    tissues: Tissues
    grey: VolumeRecipe | None = None
    fill: Mapping[str, float] = field(default_factory=dict)
    spacing: tuple[float, float, float] | None = None
    unknown: str | int = "refuse"
    unit: float | None = None
    crop: Box | None = None
    voxel: tuple[float, float, float] | None = None
    onto: bool = False
    empty: tuple[str, ...] = EMPTY
    transpose: bool | None = None
    ranking: tuple[str, ...] | None = RANKING
    smooth: float | None = None
    _made: dict[str, LabelledBone] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", absolute(self.labels))
        colours = [tissue.colour for tissue in self.tissues] if is_stack(self.labels) else []
        object.__setattr__(self, "transpose", rows_along_x(self.labels, self.transpose, colours))
        if self.grey is not None and (self.crop is not None or self.voxel is not None):
            raise ValueError("crop and voxel must be those of the grey volume")
        if self.onto and self.grey is None:
            raise ValueError("onto goes with a grey volume")
        if self.smooth is not None and self.grey is not None:
            raise ValueError("smooth goes with labels alone")
        if self.ranking is not None and Path(self.labels).is_file() and not is_stack(self.labels):
            object.__setattr__(self, "ranking", None)  # a file's labels do not overlap

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> LabelledRecipe:
        """Of what `plain` gave, through JSON too; KeyError, TypeError or ValueError where it is not that.

        Slices without a word on `transpose`, as versions before it wrote, are not transposed.
        """
        fill = {str(name): float(part) for name, part in dict(plain.get("fill", {})).items()}
        unknown = plain.get("unknown", "refuse")
        unit, crop, ranking = plain.get("unit_mm"), plain.get("crop_mm"), plain.get("ranking")
        return cls(
            os.fspath(plain["labels"]), tissues_from_json(plain["tissues"]),
            VolumeRecipe.of(plain["grey"]) if "grey" in plain else None, fill, _three_or_none(plain.get("labels_spacing_mm")),
            unknown if isinstance(unknown, int) else str(unknown), None if unit is None else float(unit),
            None if crop is None else (_numbers(crop[0]), _numbers(crop[1])), _three_or_none(plain.get("voxel_mm")),
            bool(plain.get("onto", False)), empty=tuple(map(str, plain.get("empty", _EMPTY_BEFORE))),
            transpose=bool(plain.get("transpose", False)), ranking=None if ranking is None else tuple(map(str, ranking)),
            smooth=None if plain.get("smooth_mm") is None else float(plain["smooth_mm"]),
        )  # fmt: skip

    def plain(self) -> dict[str, Any]:
        """Ready for JSON; what is not given is left out."""
        given = {
            "grey": None if self.grey is None else self.grey.plain(),
            "fill": dict(self.fill) or None,
            "labels_spacing_mm": None if self.spacing is None else list(self.spacing),
            "unknown": None if self.unknown == "refuse" else self.unknown,
            "unit_mm": self.unit,
            "crop_mm": None if self.crop is None else [list(corner) for corner in self.crop],
            "voxel_mm": None if self.voxel is None else list(self.voxel),
            "onto": self.onto or None,
            "empty": None if self.empty == _EMPTY_BEFORE else list(self.empty),
            "transpose": self.transpose if self.transpose or is_stack(self.labels) else None,
            "ranking": None if self.ranking is None else list(self.ranking),
            "smooth_mm": self.smooth,
        }
        return {
            "kind": "labelled volume",
            "labels": self.labels,
            "tissues": tissues_to_json(self.tissues),
            **{name: value for name, value in given.items() if value is not None},
        }

    def at(self, path: str | os.PathLike[str]) -> LabelledRecipe:
        """The same of a volume (labels, if they are alone) that lies elsewhere, with labels of the same name beside it."""
        if self.grey is None:
            return replace(self, labels=os.fspath(path))
        beside = Path(path).parent / Path(self.labels).name
        labels = str(beside) if beside.exists() else self.labels
        return replace(self, grey=self.grey.at(path), labels=labels)

    def made(self) -> LabelledBone:
        """The bone and its notes, made once.

        Raises
        ------
        FileNotFoundError, ImportError
            As `read_labels` and `read_stack`.
        ValueError
            As these and `labelled_bone`; or if a stack is grey.
        """
        if "bone" not in self._made:
            self._made["bone"] = self._make()
        return self._made["bone"]

    def bone(self) -> VoxelBone:
        """A copy of the bone; errors as `made`."""
        return self.made().bone.copy()

    def notes(self) -> tuple[str, ...]:
        """What was assumed on the way to the bone; errors as `made`."""
        return self.made().notes

    @property
    def mapping(self) -> OccupancyMap | None:
        """Of the grey values; None of labels alone."""
        return None if self.grey is None else self.grey.mapping

    def like(self) -> Volume | LabelVolume:
        """The grey volume on the voxels of the bone, or labels alone, for `save_drilled`."""
        if self.grey is not None:
            return self.grey.like()
        return self._labels() if self.voxel is None else self._labels().resample(self.voxel)

    def specimen(self, *, entry: Vector, axis: Vector) -> Specimen:
        """The bone with an axis; parameters and errors as `Volume.specimen`."""
        grid = self._labels() if self.grey is None else self.grey.volume()
        made = {"path": grid.path, "recipe": self.plain(), "notes": list(self.made().notes)}
        if self.grey is None:
            widest = float(max(*grid.spacing, *(self.voxel or ())))
            made["labels_alone"] = {"voxel_mm": widest, "smooth_mm": self.smooth}
        return specimen_in(grid, self.bone(), entry, axis, made, f"labels of {self.labels}")

    def check_burr(self, burr: Burr) -> None:
        """As `VolumeRecipe.check_burr`."""
        if self.grey is not None:
            self.grey.check_burr(burr)
        else:
            check_radius(burr, self._labels().spacing if self.voxel is None else np.array(self.voxel))

    def _make(self) -> LabelledBone:
        if self.grey is None:
            options: dict[str, Any] = {"fill": self.fill, "spacing": self.voxel, "smooth": self.smooth}
            return labelled_bone(None, self._labels(), self.tissues, empty=self.empty, **options)
        labels, volume = self._labels(), self.grey.volume()
        if self.onto:
            labels = labels.on(volume)
        elif self.grey.crop is not None:  # labels belong to the whole volume
            whole = replace(self.grey, crop=None).volume()
            labels = placed_on(labels, whole).crop(*self.grey.crop)
        return labelled_bone(
            volume, labels, self.tissues, mapping=self.grey.mapping, fill=self.fill, spacing=self.grey.voxel
        )

    def _labels(self) -> LabelVolume:
        labels = labels_of(
            self.labels, spacing=self.spacing, unknown=self.unknown, unit=self.unit, palette=self.tissues,
            transpose=self.transpose, ranking=self.ranking,
        )  # fmt: skip
        return labels if self.crop is None else labels.crop(*self.crop)


def labels_of(
    path: str | os.PathLike[str],
    *,
    spacing: tuple[float, float, float] | None = None,
    unknown: str | int = "refuse",
    unit: float | None = None,
    palette: Tissues | None = None,
    transpose: bool | None = None,
    ranking: Sequence[str] | None = RANKING,
) -> LabelVolume:
    """Labels of a file or of a stack of coloured slices, by the colours of a table; errors as of `read_labels` and `read_stack`."""
    if not is_stack(os.fspath(path)):
        if unknown != "refuse" or unit is not None or transpose:
            name = "unknown" if unknown != "refuse" else "transpose" if transpose else "unit"
            raise ValueError(f"{name} (--{name}) goes with labels in PNG slices, got {os.fspath(path)}")
        return read_labels(path, spacing=spacing)
    found = read_stack(
        path,
        spacing=spacing,
        palette=palette,
        unknown=unknown,
        unit=unit,
        transpose=transpose,
        ranking=ranking,
    )
    if not isinstance(found, LabelVolume):
        raise ValueError(f"{os.fspath(path)}: the slices are grey, and labels are coloured ones")
    return found


def _numbers(value: Any) -> tuple[float, float, float]:
    x, y, z = (float(part) for part in value)
    return x, y, z


def _three_or_none(value: Any) -> tuple[float, float, float] | None:
    return None if value is None else _numbers(value)


@dataclass(frozen=True)
class DrilledRecipe:
    """A half-drilled volume of `save_drilled`, or a bone of `save_bone`, as a session goes on with it.

    Parameters
    ----------
    path : path
        Of the volume, or of the bone (.h5), whose own coordinates are the bone frame; made absolute.
    digest : str, optional
        Of the bone: another content is refused.

    Raises
    ------
    ValueError
        When the bone is made: as `load_drilled` and `load_bone`, or if the file holds another bone by now.
    OSError
        If it cannot be read.
    """

    path: str
    digest: str | None = None
    _read: dict[str, DrilledVolume] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", absolute(self.path))

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> DrilledRecipe:
        """Of what `plain` gave, through JSON too; KeyError or TypeError where it is not that."""
        return cls(os.fspath(plain["path"]), str(plain["digest"]))

    def plain(self) -> dict[str, Any]:
        """Ready for JSON; with the digest, since a file that is drilled on holds another bone the next day."""
        told = {"transpose": self.drilled().transpose} if is_stack(self.path) else {}
        return {"kind": "drilled volume", "path": self.path, "digest": self.drilled().bone.digest(), **told}

    def at(self, path: str | os.PathLike[str]) -> DrilledRecipe:
        """The same of a file that lies elsewhere."""
        return replace(self, path=os.fspath(path))

    def drilled(self) -> DrilledVolume:
        """What the file holds; read once."""
        if "drilled" not in self._read:
            found = self._load()
            if self.digest not in (None, found.bone.digest()):
                raise ValueError(
                    f"{self.path}: the bone has digest {found.bone.digest()} by now, and {self.digest} is asked for"
                )
            self._read["drilled"] = found
        return self._read["drilled"]

    @property
    def tick(self) -> int:
        """Ticks executed on the bone so far."""
        return self.drilled().tick

    @property
    def mapping(self) -> OccupancyMap | None:
        """Of the volume's grey values."""
        return self.drilled().mapping

    def bone(self) -> VoxelBone:
        """A copy of the bone."""
        return self.drilled().bone.copy()

    def notes(self) -> tuple[str, ...]:
        """On what was saved, and what its volume does not say."""
        before = f"{self.path} has been burred for {self.tick} ticks before"
        notes = told_notes(bone_source(self.path)) if _holds_bone(self.path) else self.like().notes
        return (before, *(note for note in notes if assumed([note])))

    def like(self) -> Volume | LabelVolume:
        """The volume on the voxels of the bone, for `save_drilled`, read once; ValueError of a bone without one."""
        if _holds_bone(self.path):
            raise ValueError(f"{self.path} is a bone alone, without a volume: save it as .h5 again")
        return self._volume

    @cached_property
    def _volume(self) -> Volume | LabelVolume:
        return self.drilled().volume()

    def specimen(self, *, entry: Vector, axis: Vector) -> Specimen:
        """The bone with an axis; parameters and errors as `Volume.specimen`."""
        bone = self.bone()
        made = {"path": self.path, "recipe": self.plain(), "notes": list(self.notes())}
        if _holds_bone(self.path):
            place = np.array(bone.spacing), np.array(bone.origin), np.eye(3)
            return specimen_in(
                Volume(bone.density, *place, self.path), bone, entry, axis, made, f"after {self.tick} ticks"
            )
        grid = self.like()
        return specimen_in(grid, bone, entry, axis, made, f"after {self.tick} ticks")

    def check_burr(self, burr: Burr) -> None:
        """As `VolumeRecipe.check_burr`."""
        check_radius(burr, np.array(self.drilled().bone.spacing))

    def _load(self) -> DrilledVolume:
        if not _holds_bone(self.path):
            return load_drilled(self.path)
        bone, tick = load_bone(self.path)
        return DrilledVolume(bone, tick, None, self.path, self.path)


def _holds_bone(path: str) -> bool:
    return Path(path).suffix.lower() in (".h5", ".hdf5")


#: How a bone is made; JSON.
Recipe = dict[str, Any]


def block_recipe(
    size: Sequence[float], voxel: float, *, origin: Sequence[float] = (0.0, 0.0, 0.0), level: int = 255
) -> Recipe:
    """The recipe of `VoxelBone.block`.

    Parameters
    ----------
    size : (x, y, z)
        [mm]
    voxel : float
        [mm]
    origin : (x, y, z)
        Centre of the first voxel [mm].
    level : int
        0 to 255.

    Examples
    --------
    >>> recipe = block_recipe((2, 2, 1), 0.1)
    >>> make_bone(recipe).shape
    (10, 20, 20)
    """
    return {"kind": "block", "size_mm": [float(real(s, "size")) for s in size], "voxel_mm": float(real(voxel, "voxel")),
            "origin_mm": [float(real(o, "origin")) for o in origin], "level": int(level)}  # fmt: skip


def volume_recipe(
    path: str | os.PathLike[str],
    mapping: OccupancyMap | float,
    solid: float | None = None,
    *,
    spacing: float | Sequence[float] | None = None,
    series: str | None = None,
    crop: tuple[Sequence[float], Sequence[float]] | None = None,
    voxel: float | Sequence[float] | None = None,
    transpose: bool | None = None,
) -> Recipe:
    """The recipe of `read_volume(path).to_bone(mapping, solid)`, cropped and resampled as asked.

    Parameters
    ----------
    path : path
        Made absolute, for replicas run elsewhere.
    mapping, solid
        As for `Volume.to_bone`.
    spacing, series, crop, voxel, transpose
        As for `burrlab.volume.VolumeRecipe`.

    Raises
    ------
    ValueError
        If a parameter is wrong; the file is not looked at.
    TypeError
        If the map is none.
    """
    chosen: Any = (spacing, series, crop, voxel, transpose)
    return VolumeRecipe(os.fspath(path), occupancy_map(mapping, solid), *chosen).plain()


def make_bone(recipe: Mapping[str, Any], *, volume: str | os.PathLike[str] | None = None) -> VoxelBone:
    """The bone of a recipe.

    Parameters
    ----------
    recipe : mapping
        Of `block_recipe`, `volume_recipe`, an experiment's `VolumeBlock`, `LabelledRecipe.plain` or `DrilledRecipe.plain`;
        it may come from another machine.
    volume : path, optional
        Where the volume lies here, if elsewhere.

    Raises
    ------
    ValueError
        If the recipe cannot be read, names a block too large to make, or the volume cannot be read.
    FileNotFoundError
        If there is no such volume.
    """
    try:
        if recipe["kind"] == "block":
            size, origin = _three(recipe["size_mm"]), _three(recipe["origin_mm"])
            voxel, level = float(recipe["voxel_mm"]), whole_number(recipe["level"], 255)
        elif recipe["kind"] == "volume":
            made = VolumeRecipe.of(recipe)
        elif recipe["kind"] == "volume block":
            made, voxel = VolumeRecipe.of(recipe["volume"]), float(recipe["voxel_mm"])
            size, entry, axis = (_three(recipe[key]) for key in ("size_mm", "entry_mm", "axis"))
        elif recipe["kind"] == "labelled volume":
            labelled = LabelledRecipe.of(recipe)
        elif recipe["kind"] == "drilled volume":
            drilled = DrilledRecipe.of(recipe)
        else:
            raise KeyError("kind")
    except _UNREADABLE:
        raise ValueError(
            f"recipe must be that of block_recipe or volume_recipe, got {reprlib.repr(recipe)}"
        ) from None
    if recipe["kind"] == "drilled volume":
        return (drilled if volume is None else drilled.at(volume)).bone()
    if recipe["kind"] == "labelled volume":
        return (labelled if volume is None else labelled.at(volume)).bone()
    if recipe["kind"] == "volume":
        return (made if volume is None else made.at(volume)).bone()
    if recipe["kind"] == "volume block":
        here = made if volume is None else made.at(volume)
        return cut_block(here, size, voxel, entry=entry, axis=axis)
    if voxel > 0 and not (voxels := math.prod(max(s / voxel, 1.0) for s in size)) <= MOST_VOXELS:
        raise ValueError(f"recipe must have at most {MOST_VOXELS:.3g} voxels, got {voxels:.3g}")
    return VoxelBone.block(size, voxel, origin=origin, level=level)


def whole_number(number: Any, most: int) -> int:
    if not 0 <= int(number) <= most or int(number) != number:
        raise ValueError(number)
    return int(number)


def _three(numbers: Sequence[Any]) -> list[float]:
    x, y, z = map(float, numbers)
    return [x, y, z]
