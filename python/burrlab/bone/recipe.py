"""Recipes of a bone from a block, a volume, labels or a half-drilled file, in memory and as JSON."""

import contextlib
import math
import os
import re
import reprlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, Self, cast

import numpy as np
import scipy
from numpy.typing import ArrayLike

import burrlab._core as _core
from burrlab._core import Burr, Material, Tissues, VoxelBone, pack_bone, unpack_bone
from burrlab.bone.dicom import holds_dicom, is_dicom
from burrlab.bone.formats import header_reader, read_labels, read_volume
from burrlab.bone.header import assumed, told_notes
from burrlab.bone.image import (
    LabelVolume,
    OccupancyMap,
    OnGrid,
    Volume,
    checked_point,
    grey_specimen,
    specimen_in,
)
from burrlab.bone.kept import DrilledVolume, load_drilled
from burrlab.bone.slices import RANKING, is_stack, read_stack, rows_along_x, stack_files, stack_of
from burrlab.bone.snapshot import bone_source, holds_bone, load_bone, tissues_from_json, tissues_to_json
from burrlab.bone.specimen import MOST_VOXELS, Specimen, Vector, checked_spacing
from burrlab.bone.tissues import EMPTY, LabelledBone, default_tissues, labelled_bone, placed_on
from burrlab.common.cache import CachedParts, Entry
from burrlab.common.check import nearest, refuse, require_type, scalar, shown
from burrlab.common.files import hash_of
from burrlab.common.progress import doing
from burrlab.common.records import UNREADABLE, in_one_line
from burrlab.theory.tool import law_of

_LEAST_VOXELS, _ENOUGH_VOXELS = 4.0, 7.5  # voxels per radius of a burr, as in the tick

_EMPTY_BEFORE = ("air",)  # empty structures of a recipe without this key
Triple = tuple[float, float, float]
Box = tuple[Triple, Triple]


def _triple(value: Any) -> Triple:
    x, y, z = (float(part) for part in value)
    return x, y, z


def _listed(value: Any) -> Any:
    return [_listed(part) for part in value] if isinstance(value, (tuple, list, np.ndarray)) else value


def _key(
    key: str,
    read: Callable[[Any], Any] = lambda value: value,
    write: Callable[[Any], Any] = _listed,
    *,
    omitted: object = None,
    before: object = MISSING,
) -> dict[str, Any]:
    """Metadata of a field for JSON: key, reader, writer, omitted value, and the meaning of a missing key."""
    return {"key": key, "read": read, "write": write, "omitted": omitted, "before": before}


class BoneRecipe(ABC):
    """How a bone is made. Results and traces keep it as JSON; replicas follow it."""

    _KIND: ClassVar[str]

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Self:
        """Recipe from the result of `plain`, also through JSON; KeyError, TypeError or ValueError otherwise.

        Without the key `transpose`, as in recipes of earlier versions, slices are not transposed.
        """
        arguments = {}
        known = [each.metadata["key"] for each in fields(cast(Any, cls))]
        for key in plain:  # of notes a session's source has a list
            refuse(
                key not in ("kind", "notes", *known),
                f"recipe must not have the key {shown(key)}{nearest(key, known)}",
            )
        for each in fields(cast(Any, cls)):
            metadata = each.metadata
            value = plain.get(metadata["key"])
            # null counts as a missing key if the field may be None; otherwise the reader refuses it.
            if value is not None or (
                metadata["key"] in plain and None not in (each.default, metadata["before"])
            ):
                arguments[each.name] = metadata["read"](value)
            elif metadata["before"] is not MISSING:
                arguments[each.name] = metadata["before"]
        return cls(**arguments)

    def plain(self) -> dict[str, Any]:
        """The recipe ready for JSON, without fields that are not given."""
        plain: dict[str, Any] = {"kind": self._KIND}
        for each in fields(cast(Any, self)):
            value = getattr(self, each.name)
            if value is not None and value != each.metadata["omitted"]:
                plain[each.metadata["key"]] = each.metadata["write"](value)
        return plain

    def at(self, path: str | os.PathLike[str]) -> Self:
        """The same recipe with another path of its volume, if it has one."""
        parts = {name: part.at(path) for name, part in vars(self).items() if isinstance(part, BoneRecipe)}
        return cast(Self, replace(cast(Any, self), **parts))

    @abstractmethod
    def bone(self) -> VoxelBone:
        """The bone."""


class _FileRecipe(BoneRecipe):
    """A recipe whose bone comes from files, from one at its `path` if it has no other name."""

    def plain(self) -> dict[str, Any]:
        """The recipe ready for JSON, without fields that are not given."""
        plain = super().plain()
        if not (plain.get("transpose", True) or is_stack(plain.get("path") or plain["labels"])):
            del plain["transpose"]
        return plain

    def at(self, path: str | os.PathLike[str]) -> Self:
        """The same recipe with another path of its main file."""
        return cast(Self, replace(cast(Any, self), path=os.fspath(path)))

    @abstractmethod
    def grid(self) -> OnGrid:
        """Geometry of the volume, for points in its own coordinates; the voxels may be missing."""

    @abstractmethod
    def _voxel(self) -> ArrayLike:
        """Spacing of the bone (x, y, z) [mm]."""

    def check_burr(self, burr: Burr) -> None:
        """ValueError, with a sufficient spacing, if the burr is too small for the bone's voxels."""
        widest = float(np.max(self._voxel()))
        if burr.radius < _LEAST_VOXELS * widest:
            # R/7.5, rounded down to two digits.
            digits = 1 - int(np.floor(np.log10(burr.radius / _ENOUGH_VOXELS)))
            enough = f"{np.floor(burr.radius / _ENOUGH_VOXELS * 10**digits + 1e-9) / 10**digits:g}"
            raise ValueError(
                f"radius of the burr must be at least {_LEAST_VOXELS:g} voxels of {widest:g} mm, got "
                f"{burr.radius:g} mm; --voxel {enough} (voxel={enough}) makes finer ones"
            )


#: Voxels from which a volume is worth keeping, and one with smoothed labels (ours): smaller ones are made in
#: tenths of a second.
WORTH, WORTH_SMOOTHED = 1 << 24, 1 << 22


def _entry_of(settings: object, volumes: Iterable[str]) -> Entry:
    """The place of what follows from settings, burrlab's own code and the files of volumes."""
    files: list[str] = []
    with contextlib.suppress(ValueError, OSError, ImportError):  # who reads them says what is wrong
        files = [file for path in volumes for file in _volume_files(path)]
    return Entry([*_code(), settings], files)


def _volume_files(path: str) -> list[str]:
    """All files that a volume is read from."""
    if is_stack(path):
        return stack_files(path)
    if Path(path).is_dir():  # of DICOM slices; notes name the other files
        pattern = "*" if holds_dicom(path) else "**/*"
        return sorted(str(part) for part in Path(path).glob(pattern) if part.is_file())
    read_header = header_reader(path)
    if read_header is None or is_dicom(path):
        return [path]
    pair = [path[:-4] + ".hdr"] if path.lower().endswith(".img") else []
    return [path, *pair, *map(str, read_header(path)[1].files)]


@cache
def _code() -> list[str]:
    """Version of burrlab, and digests of the code that reads volumes and makes bones."""
    code = [_core.__version__]
    for path in [*sorted(Path(__file__).parent.glob("*.py")), Path(_core.__file__)]:
        with contextlib.suppress(OSError):  # as of an editor's lock, a link to nowhere
            code.append(hash_of(path))
    return code


class _CachedRecipe(_FileRecipe):
    """A recipe whose bone is kept for the next start if it is large; docs/volumes.md says where."""

    @abstractmethod
    def _on(self) -> Volume | LabelVolume:
        """The volume itself."""

    def like(self) -> Volume | LabelVolume:
        """The grey volume, or labels alone, on the voxels of the bone, for `save_drilled`."""
        return self._on().resample(self._voxel())

    @property
    @abstractmethod
    def _entry(self) -> Entry:
        """Where the bone is kept."""

    @cached_property
    def _kept(self) -> CachedParts | None:
        return self._entry.find()

    def _kept_bone(self) -> VoxelBone | None:
        """A new bone as it was kept; None if there is none."""
        if self._kept is None:
            return None
        # The entry's checksum is right, and the same code wrote it: it holds what `_keep` puts there.
        header, packed = self._kept.header["bone"], [np.frombuffer(p, np.uint8) for p in self._kept.parts]
        table = tissues_from_json(header["tissues"]) if header["tissues"] else None
        return unpack_bone(header["shape"], header["spacing"], header["origin"], packed[0], table, packed[1])

    def grid(self) -> OnGrid:
        """Geometry of the volume; beside a kept bone its voxels are 0."""
        if self._kept is None:
            return self._on()
        header = self._kept.header
        zeros, notes = np.broadcast_to(np.uint8(0), header["shape"]), tuple(header["notes"])
        return Volume(zeros, header["spacing"], header["origin"], header["direction"], header["path"], notes)

    def _keep(self, bone: VoxelBone, notes: Sequence[str], least: int) -> None:
        """Keeps a new bone of at least so many voxels, with the geometry of its volume."""
        if math.prod(bone.shape) < least:
            return
        grid, table = self._on(), None if bone.tissues is None else tissues_to_json(bone.tissues)
        self._entry.keep({
            "bone": {"shape": bone.shape, "spacing": bone.spacing, "origin": bone.origin, "tissues": table},
            "shape": grid.shape, "path": grid.path, "notes": list(notes), "spacing": grid.spacing.tolist(),
            "origin": grid.origin.tolist(), "direction": grid.direction.tolist(),
        }, pack_bone(bone))  # fmt: skip


def whole_number(number: Any, most: int) -> int:
    refuse(not 0 <= int(number) <= most or int(number) != number, number)
    return int(number)


def _texts(values: Any) -> tuple[str, ...]:
    return tuple(map(str, values))


def _mapping_of(points: Any) -> OccupancyMap:
    points = list(points)
    if points and not isinstance(points[0], Sequence):
        return OccupancyMap.two_point(*map(float, points))
    return OccupancyMap(tuple(g for g, _ in points), tuple(o for _, o in points))


def _points_of(mapping: OccupancyMap) -> list[Any]:
    pairs = [list(pair) for pair in zip(mapping.greys, mapping.occupancies, strict=True)]
    return list(mapping.greys) if mapping.occupancies == (0.0, 1.0) else pairs


@dataclass(frozen=True)
class VolumeRecipe(_CachedRecipe):
    """A grey volume from a file, the part of it that is kept, and how it becomes bone.

    Parameters
    ----------
    path : path
        A file, a folder of DICOM slices, or a stack of grey PNG slices; made absolute.
    mapping : OccupancyMap
    spacing : float or (x, y, z), optional
        Voxel spacing if the file has none [mm].
    series : str, optional
        SeriesInstanceUID, if a folder holds more than one.
    crop : (low, high), optional
        Two opposite corners (x, y, z) in the volume's own coordinates [mm]; see `Volume.crop`.
    voxel : float or (x, y, z), optional
        Spacing of the bone [mm]; default the volume's own. See `Volume.to_bone`.
    transpose : bool, optional
        How slices are read; see `read_stack`. A default is replaced by its value, so that results hold it.

    Raises
    ------
    ValueError
        If a spacing is not positive, or a corner is no point.

    Examples
    --------
    >>> recipe = VolumeRecipe("ct.nrrd", OccupancyMap.two_point(90, 180), voxel=0.1)
    >>> VolumeRecipe.of(recipe.plain()) == recipe
    True
    """

    _KIND = "volume"

    path: str = field(metadata=_key("path", os.fspath))
    mapping: OccupancyMap = field(metadata=_key("map", _mapping_of, _points_of))
    spacing: Triple | None = field(default=None, metadata=_key("spacing_mm"))
    series: str | None = field(default=None, metadata=_key("series", str))
    crop: Box | None = field(default=None, metadata=_key("crop_mm"))
    voxel: Triple | None = field(default=None, metadata=_key("voxel_mm"))
    transpose: bool | None = field(default=None, metadata=_key("transpose", bool, before=False))

    def __post_init__(self) -> None:
        path = absolute(self.path)
        spacings = {
            name: _triple(checked_spacing(lengths, name))
            for name, lengths in (("spacing", self.spacing), ("voxel", self.voxel))
            if lengths is not None
        }
        self.__dict__.update(path=path, transpose=rows_along_x(path, self.transpose), **spacings)
        if self.crop is not None:
            low, high = (_triple(checked_point(corner, "crop")) for corner in self.crop)
            object.__setattr__(self, "crop", (low, high))

    def volume(self) -> Volume:
        """The cropped volume; it is read once.

        Raises
        ------
        FileNotFoundError, ImportError
            As `read_volume`.
        ValueError
            As `read_volume`, `read_stack` and `Volume.crop`; or if a stack holds labels.
        """
        return self._volume

    @cached_property
    def _volume(self) -> Volume:
        return self._whole if self.crop is None else self._whole.crop(*self.crop)

    @cached_property
    def _whole(self) -> Volume:
        self._entry.look()
        if not is_stack(self.path):
            refuse(self.transpose, f"transpose (--transpose) goes with PNG slices, got {self.path}")
            return read_volume(self.path, spacing=self.spacing, series=self.series)
        volume = read_stack(self.path, spacing=self.spacing, transpose=bool(self.transpose))
        if not isinstance(volume, Volume):
            raise ValueError(f"{self.path}: the slices are coloured labels, and a map is of grey values")
        return volume

    def notes(self) -> tuple[str, ...]:
        """Notes on assumptions and steps in reading the volume; errors as `volume`."""
        return self.grid().notes

    def bone(self) -> VoxelBone:
        """The bone; errors as `volume` and `Volume.to_bone`."""
        if (bone := self._kept_bone()) is None:
            bone = self.volume().to_bone(self.mapping, spacing=self.voxel)
            self._keep(bone, self.volume().notes, WORTH)
        return bone

    def specimen(self, *, entry: Vector, axis: Vector) -> Specimen:
        """The bone with an axis; parameters and errors as `Volume.specimen`."""
        specimen = grey_specimen(
            self.grid(), self.bone(), self.mapping, entry, axis, lambda: self.volume().values
        )
        return replace(specimen, made={**specimen.made, "recipe": self.plain()})

    _on = volume

    @cached_property
    def _entry(self) -> Entry:
        return _entry_of(self.plain(), [self.path])

    def _voxel(self) -> ArrayLike:
        return self.grid().spacing if self.voxel is None else self.voxel


def altered(recipe: VolumeRecipe, **changes: Any) -> VolumeRecipe:
    """The recipe with another crop or voxel; its volume is not read again."""
    changed = replace(recipe, **changes)
    if "_whole" in recipe.__dict__:
        changed.__dict__["_whole"] = recipe._whole
    changed._entry.look(recipe._entry)
    return changed


def absolute(path: str | os.PathLike[str]) -> str:
    """The absolute path, with ".." behind a link resolved; ValueError if it holds control characters."""
    refuse(
        re.search(r"[\0-\x1f\x7f]", os.fspath(path)),
        f"path must hold no control characters, got {os.fspath(path)!r}",
    )
    return os.path.realpath(path) if ".." in Path(path).parts else os.path.abspath(path)


@doing("cutting a block")
def cut_block(
    recipe: VolumeRecipe, size: Sequence[float], voxel: float, *, entry: Vector, axis: Vector
) -> VoxelBone:
    """Block of bone below a plane, in a frame of its own.

    The plane is perpendicular to the axis, at the point where the axis first reaches level 128. This point
    becomes (0, 0, 0) and the axis becomes -z; x is perpendicular to the axis and to the voxel axis that is
    furthest from it. Levels are trilinear between those of the recipe's bone, and 0 beyond the volume. Bone
    above the plane is cut off.

    Parameters
    ----------
    recipe : VolumeRecipe
        Its `voxel` should be no coarser than the block's.
    size : (x, y, z)
        Sides of the block [mm]; the middle of its top is (0, 0, 0).
    voxel : float
        Spacing of the block [mm].
    entry, axis : (x, y, z)
        In the volume's own coordinates; see `Volume.specimen`.

    Raises
    ------
    ValueError
        If a length is not positive, or the block has too many voxels; and as `VolumeRecipe.specimen`.

    Examples
    --------
    >>> import burrlab, numpy as np, tempfile
    >>> from burrlab.volume import OccupancyMap, Volume, VolumeRecipe, cut_block
    >>> folder = tempfile.TemporaryDirectory()
    >>> ct = Volume(np.full((20, 20, 20), 1000, np.int16), np.full(3, 0.2), np.zeros(3), np.eye(3), "a cube")
    >>> burrlab.write_volume(folder.name + "/ct.nrrd", ct)
    >>> recipe = VolumeRecipe(folder.name + "/ct.nrrd", OccupancyMap.two_point(0, 1000))
    >>> cut_block(recipe, (2, 2, 1), 0.1, entry=(1.9, 1.9, 3.9), axis=(0, 0, -1)).shape
    (10, 20, 20)
    >>> folder.cleanup()
    """
    sides, apart = checked_spacing(size, "size"), float(checked_spacing(voxel, "voxel")[0])
    counts = np.maximum(np.round(sides / apart), 1)
    refuse(
        not (voxels := math.prod(counts.tolist())) <= MOST_VOXELS,
        f"voxel must be coarser: the block has {voxels:.3g} voxels, and {MOST_VOXELS:.3g} are the most",
    )
    specimen = recipe.specimen(entry=entry, axis=axis)
    across = np.cross(specimen.axis, np.eye(3)[np.argmin(np.abs(specimen.axis))])
    across /= np.linalg.norm(across)
    # The block's axes in the bone frame.
    turn = np.column_stack([across, np.cross(-specimen.axis, across), -specimen.axis])
    x, y, z = (int(n) for n in counts)
    first = np.array([0.5 * (1 - x) * apart, 0.5 * (1 - y) * apart, (0.5 - z) * apart])
    levels, out = specimen.bone.density, np.empty((z, y, x), np.uint8)
    scale, origin = np.array(specimen.bone.spacing), np.array(specimen.bone.origin)
    plane = np.stack(np.meshgrid(np.arange(x), np.arange(y), indexing="xy"), -1) * apart
    for k in range(z):
        points = np.concatenate([plane, np.full((y, x, 1), k * apart)], axis=-1) + first
        places = (specimen.surface + points @ turn.T - origin) / scale
        out[k] = np.rint(
            scipy.ndimage.map_coordinates(
                levels, np.moveaxis(places[..., ::-1], -1, 0), output=float, order=1, mode="grid-constant"
            )
        )
    return VoxelBone(out, spacing=apart, origin=first)


@dataclass(frozen=True)
class LabelledRecipe(_CachedRecipe):
    """Labels from a file, their table of tissues, and the grey volume that they belong to, if any.

    Parameters
    ----------
    labels : path
        A file, or a stack of coloured PNG slices; made absolute.
    tissues : Tissues
    grey : VolumeRecipe, optional
        Grey volume. Without one, labelled voxels are solid; see `labelled_bone`.
    fill : mapping of str to float
        See `labelled_bone`.
    spacing : (x, y, z), optional
        Spacing of the labels if their file has none [mm].
    unknown : str or int
        Treatment of colours that are in no table; see `read_stack`.
    unit : float, optional
        Unit of the dimensions in a YAML file [mm].
    crop, voxel : optional
        As in `VolumeRecipe`, for labels alone: a grey volume has its own.
    onto : bool
        Whether the labels are brought on the voxels of the grey volume; see `LabelVolume.on`.
    empty : tuple of str
        See `labelled_bone`. Recipes of earlier versions, without this key, have air alone.
    transpose : bool, optional
        How slices are read; see `read_stack`. A default is replaced by its value, so that results hold it.
    ranking : sequence of str, optional
        Ranking of structures that overlap in slices; see `read_stack`. Recipes of earlier versions have none.
    smooth : float, optional
        For labels alone [mm]; see `labelled_bone`.

    Raises
    ------
    ValueError
        If `transpose` must be given, as in `read_stack`; if a crop, a spacing of the bone or `smooth` is
        given with a grey volume, or `onto` without one.
    """

    _KIND = "labelled volume"

    labels: str = field(metadata=_key("labels", os.fspath))
    tissues: Tissues = field(metadata=_key("tissues", tissues_from_json, tissues_to_json))
    grey: VolumeRecipe | None = field(
        default=None, metadata=_key("grey", VolumeRecipe.of, VolumeRecipe.plain)
    )
    fill: Mapping[str, float] = field(default_factory=dict, metadata=_key(
        "fill", lambda fill: {str(name): float(part) for name, part in dict(fill).items()}, dict, omitted={},
    ))  # fmt: skip
    spacing: Triple | None = field(default=None, metadata=_key("labels_spacing_mm", _triple))
    unknown: str | int = field(default="refuse", metadata=_key(
        "unknown", lambda choice: choice if isinstance(choice, int) else str(choice), omitted="refuse",
    ))  # fmt: skip
    unit: float | None = field(default=None, metadata=_key("unit_mm", float))
    crop: Box | None = field(
        default=None, metadata=_key("crop_mm", lambda box: (_triple(box[0]), _triple(box[1])))
    )
    voxel: Triple | None = field(default=None, metadata=_key("voxel_mm", _triple))
    onto: bool = field(default=False, metadata=_key("onto", bool, omitted=False))
    empty: tuple[str, ...] = field(
        default=EMPTY, metadata=_key("empty", _texts, omitted=_EMPTY_BEFORE, before=_EMPTY_BEFORE)
    )
    transpose: bool | None = field(default=None, metadata=_key("transpose", bool, before=False))
    ranking: tuple[str, ...] | None = field(default=RANKING, metadata=_key("ranking", _texts, before=None))
    smooth: float | None = field(default=None, metadata=_key("smooth_mm", float))

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", absolute(self.labels))
        colours = [tissue.colour for tissue in self.tissues] if is_stack(self.labels) else []
        object.__setattr__(self, "transpose", rows_along_x(self.labels, self.transpose, colours))
        refuse(
            self.grey is not None and (self.crop is not None or self.voxel is not None),
            "crop and voxel must be those of the grey volume",
        )
        refuse(self.onto and self.grey is None, "onto goes with a grey volume")
        refuse(self.smooth is not None and self.grey is not None, "smooth goes with labels alone")
        if self.ranking is not None and Path(self.labels).is_file() and not is_stack(self.labels):
            object.__setattr__(self, "ranking", None)  # a file's labels do not overlap

    def at(self, path: str | os.PathLike[str]) -> Self:
        """The same recipe with another path of its volume, or of labels alone.

        Labels beside that volume are taken if they have the name of the recipe's.
        """
        if self.grey is None:
            return replace(self, labels=os.fspath(path))
        beside = Path(path).parent / Path(self.labels).name
        return replace(self, grey=self.grey.at(path), labels=str(beside) if beside.exists() else self.labels)

    def bone(self) -> VoxelBone:
        """A copy of the bone; errors as `read_labels`, `read_stack` and `labelled_bone`."""
        return self._kept_bone() or self._made.bone.copy()

    def notes(self) -> tuple[str, ...]:
        """Notes on assumptions in making the bone; errors as `bone`."""
        return self._made.notes if self._kept is None else self.grid().notes

    @property
    def mapping(self) -> OccupancyMap | None:
        """Map of the grey values; None for labels alone."""
        return None if self.grey is None else self.grey.mapping

    def specimen(self, *, entry: Vector, axis: Vector) -> Specimen:
        """The bone with an axis; parameters and errors as `Volume.specimen`."""
        grid = self.grid()
        provenance = {"path": grid.path, "recipe": self.plain(), "notes": list(self.notes())}
        if self.grey is None:
            provenance["labels_alone"] = {
                "voxel_mm": float(max(*grid.spacing, *(self.voxel or ()))), "smooth_mm": self.smooth,
            }  # fmt: skip
        return specimen_in(grid, self.bone(), entry, axis, provenance, f"labels of {self.labels}")

    def _voxel(self) -> ArrayLike:
        spacing = self.voxel if self.grey is None else self.grey.voxel
        return self.grid().spacing if spacing is None else spacing

    def _on(self) -> Volume | LabelVolume:
        return self._labels if self.grey is None else self.grey.volume()

    @cached_property
    def _entry(self) -> Entry:
        if self.grey is None:
            return _entry_of(self.plain(), [self.labels])
        return _entry_of(self.plain(), [self.labels, self.grey.path]).look(self.grey._entry)

    @cached_property
    def _made(self) -> LabelledBone:
        labels, volume, voxel = self._labels, None, self.voxel
        if self.grey is not None:
            volume, voxel = self.grey.volume(), self.grey.voxel
            if self.onto:
                labels = labels.on(volume)
            elif self.grey.crop is not None:  # the labels belong to the whole volume
                labels = placed_on(labels, self.grey._whole).crop(*self.grey.crop)
        labelled = labelled_bone(
            volume, labels, self.tissues, mapping=self.mapping, fill=self.fill, spacing=voxel, empty=self.empty,
            smooth=self.smooth,
        )  # fmt: skip
        self._keep(labelled.bone, labelled.notes, WORTH if self.smooth is None else WORTH_SMOOTHED)
        return labelled

    @property
    def _labels(self) -> LabelVolume:
        return self._read if self.crop is None else self._read.crop(*self.crop)

    @cached_property
    def _read(self) -> LabelVolume:
        self._entry.look()
        return labels_of(
            self.labels, spacing=self.spacing, unknown=self.unknown, unit=self.unit, palette=self.tissues,
            transpose=self.transpose, ranking=self.ranking,
        )  # fmt: skip


def usual_recipe(path: str, material: Material, stack: Mapping[str, Any], **settings: Any) -> LabelledRecipe:
    """Recipe of labels with their default table; they are read once.

    `stack` has the options of `labels_of`, `settings` the other fields of the recipe. Errors as `labels_of` and
    `default_tissues`.
    """
    entry = _entry_of([
        "tissues", absolute(path), material.name, material.c_e, material.alpha, material.source, material.shape.name,
        *law_of(material).items(), dict(stack),
    ], [absolute(path)])  # fmt: skip
    if (cached := entry.find()) is not None:
        return LabelledRecipe(path, tissues_from_json(cached.header["tissues"]), **stack, **settings)
    labels = labels_of(path, usual=True, **stack)
    tissues = default_tissues(labels, material=material)
    if labels.labels.size >= WORTH_SMOOTHED:
        entry.keep({"tissues": tissues_to_json(tissues)})
    recipe = LabelledRecipe(path, tissues, **stack, **settings)
    recipe.__dict__["_read"] = labels
    recipe._entry.look(entry)
    return recipe


def labels_of(
    path: str | os.PathLike[str],
    *,
    spacing: tuple[float, float, float] | None = None,
    unknown: str | int = "refuse",
    unit: float | None = None,
    palette: Tissues | None = None,
    transpose: bool | None = None,
    ranking: Sequence[str] | None = RANKING,
    usual: bool = False,
) -> LabelVolume:
    """Labels of a file or of coloured slices, by the colours of a table; `usual` as in `stack_of`.

    Errors as `read_labels` and `read_stack`.
    """
    if not is_stack(os.fspath(path)):
        options = {"unknown": unknown != "refuse", "transpose": transpose, "unit": unit is not None}
        for name, chosen in options.items():
            refuse(chosen, f"{name} (--{name}) goes with labels in PNG slices, got {os.fspath(path)}")
        return read_labels(path, spacing=spacing)
    labels = stack_of(path, spacing, palette, unknown, unit, transpose, ranking, usual=usual)
    if not isinstance(labels, LabelVolume):
        raise ValueError(f"{os.fspath(path)}: the slices are grey, and labels are coloured ones")
    return labels


@dataclass(frozen=True)
class DrilledRecipe(_FileRecipe):
    """A half-drilled volume of `save_drilled`, or a bone of `save_bone`, with which a session continues.

    Parameters
    ----------
    path : path
        Path of the volume, or of a bone (.h5) whose own coordinates are the bone frame; made absolute.
    digest : str, optional
        Digest of the bone; a bone with another digest is refused.

    Raises
    ------
    ValueError
        When the bone is made: as `load_drilled` and `load_bone`, or if the file holds another bone.
    OSError
        If the file cannot be read.
    """

    _KIND = "drilled volume"

    path: str
    digest: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", absolute(self.path))

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> "DrilledRecipe":
        """Recipe from the result of `plain`, also through JSON; KeyError or TypeError otherwise."""
        return cls(os.fspath(plain["path"]), str(plain["digest"]))

    def plain(self) -> dict[str, Any]:
        """The recipe ready for JSON, with the digest: after further drilling the file holds another bone."""
        transpose = {"transpose": self._drilled.transpose} if is_stack(self.path) else {}
        return {"kind": self._KIND, "path": self.path, "digest": self._drilled.bone.digest(), **transpose}

    @cached_property
    def _drilled(self) -> DrilledVolume:
        """Content of the file; it is read once."""
        drilled = (
            DrilledVolume(*load_bone(self.path), None, self.path, self.path)
            if holds_bone(self.path)
            else load_drilled(self.path)
        )
        if self.digest not in (None, drilled.bone.digest()):
            raise ValueError(
                f"{self.path}: the bone has digest {drilled.bone.digest()} by now, and {self.digest} is "
                "asked for"
            )
        return drilled

    @property
    def tick(self) -> int:
        """Ticks executed on the bone so far."""
        return self._drilled.tick

    @property
    def mapping(self) -> OccupancyMap | None:
        """Map of the volume's grey values."""
        return self._drilled.mapping

    def bone(self) -> VoxelBone:
        """A copy of the bone."""
        return self._drilled.bone.copy()

    def notes(self) -> tuple[str, ...]:
        """Notes on earlier ticks, and on assumptions in reading the volume."""
        notes = told_notes(bone_source(self.path)) if holds_bone(self.path) else self.like().notes
        return (
            f"{self.path} has been burred for {self.tick} ticks before",
            *(note for note in notes if assumed([note])),
        )

    def like(self) -> Volume | LabelVolume:
        """The volume on the voxels of the bone, for `save_drilled`; ValueError for a bone without one."""
        refuse(holds_bone(self.path), f"{self.path} is a bone alone, without a volume: save it as .h5 again")
        return self._volume

    grid = like

    @cached_property
    def _volume(self) -> Volume | LabelVolume:
        return self._drilled.volume()

    def specimen(self, *, entry: Vector, axis: Vector) -> Specimen:
        """The bone with an axis; parameters and errors as `Volume.specimen`."""
        bone = self.bone()
        provenance = {"path": self.path, "recipe": self.plain(), "notes": list(self.notes())}
        grid: Volume | LabelVolume = (
            Volume(bone.density, np.array(bone.spacing), np.array(bone.origin), np.eye(3), self.path)
            if holds_bone(self.path)
            else self.like()
        )
        return specimen_in(grid, bone, entry, axis, provenance, f"after {self.tick} ticks")

    def _voxel(self) -> ArrayLike:
        return self._drilled.bone.spacing


@dataclass(frozen=True)
class BlockRecipe(BoneRecipe):
    """The block of `VoxelBone.block`; see `block_recipe`."""

    _KIND = "block"

    size: Sequence[float] = field(metadata=_key("size_mm", _triple))
    voxel: float = field(metadata=_key("voxel_mm", float))
    origin: Sequence[float] = field(metadata=_key("origin_mm", _triple))
    level: int = field(metadata=_key("level", partial(whole_number, most=255)))

    def bone(self) -> VoxelBone:
        """The bone; ValueError if a length is not positive or the block is too large."""
        apart = self.voxel
        if apart > 0 and not (voxels := math.prod(max(s / apart, 1.0) for s in self.size)) <= MOST_VOXELS:
            raise ValueError(f"recipe must have at most {MOST_VOXELS:.3g} voxels, got {voxels:.3g}")
        return VoxelBone.block(self.size, apart, origin=self.origin, level=self.level)


@dataclass(frozen=True)
class VolumeBlockRecipe(BoneRecipe):
    """A block cut from a volume; see `cut_block`."""

    _KIND = "volume block"

    volume: VolumeRecipe = field(metadata=_key("volume", VolumeRecipe.of, VolumeRecipe.plain))
    size: Triple = field(metadata=_key("size_mm", _triple))
    voxel: float = field(metadata=_key("voxel_mm", float))
    entry: Triple = field(metadata=_key("entry_mm", _triple))
    axis: Triple = field(metadata=_key("axis", _triple))

    def bone(self) -> VoxelBone:
        """The bone; errors as `cut_block`."""
        return cut_block(self.volume, self.size, self.voxel, entry=self.entry, axis=self.axis)


@dataclass(frozen=True)
class LayeredRecipe(BoneRecipe):
    """A bone whose voxels are of two tissues: with their centres above and below a height z [mm]."""

    _KIND = "layers"

    whole: BoneRecipe = field(
        metadata=_key("bone", lambda plain: _RECIPES[plain["kind"]].of(plain), lambda recipe: recipe.plain())
    )
    height: float = field(metadata=_key("boundary_mm", float))
    tissues: Tissues = field(metadata=_key("tissues", tissues_from_json, tissues_to_json))

    def bone(self) -> VoxelBone:
        """The bone; errors as those of the whole."""
        return self.of_whole(self.whole.bone())

    def of_whole(self, bone: VoxelBone) -> VoxelBone:
        """The same bone, which becomes one of two tissues."""
        below = bone.origin[2] + bone.spacing[2] * np.arange(bone.shape[0]) < self.height
        bone.set_tissues(self.tissues, np.broadcast_to(below[:, None, None], bone.shape).astype(np.uint8))
        return bone


_RECIPES: dict[str, type[BoneRecipe]] = {
    kind._KIND: kind
    for kind in (BlockRecipe, VolumeRecipe, VolumeBlockRecipe, LabelledRecipe, DrilledRecipe, LayeredRecipe)
}

#: A recipe as JSON.
Recipe = dict[str, Any]


def block_recipe(
    size: Sequence[float], voxel: float, *, origin: Sequence[float] = (0.0, 0.0, 0.0), level: int = 255
) -> Recipe:
    """Recipe of `VoxelBone.block`.

    Parameters
    ----------
    size : (x, y, z)
        [mm]
    voxel : float
        [mm]
    origin : (x, y, z)
        Centre of the first voxel [mm].
    level : int
        From 0 to 255.

    Examples
    --------
    >>> recipe = block_recipe((2, 2, 1), 0.1)
    >>> make_bone(recipe).shape
    (10, 20, 20)
    """
    sides, corner = ([scalar(x, n) for x in xs] for n, xs in (("size", size), ("origin", origin)))
    return BlockRecipe(sides, scalar(voxel, "voxel"), corner, int(level)).plain()


def volume_recipe(
    path: str | os.PathLike[str],
    mapping: OccupancyMap,
    *,
    spacing: float | Sequence[float] | None = None,
    series: str | None = None,
    crop: tuple[Sequence[float], Sequence[float]] | None = None,
    voxel: float | Sequence[float] | None = None,
    transpose: bool | None = None,
) -> Recipe:
    """Recipe of `read_volume(path).to_bone(mapping)`, with a crop and another spacing if given.

    Parameters
    ----------
    path : path
        Made absolute, for replicas elsewhere.
    mapping : OccupancyMap
    spacing, series, crop, voxel, transpose
        As for `burrlab.volume.VolumeRecipe`.

    Raises
    ------
    ValueError
        If a parameter is wrong. The file is not opened.
    TypeError
        If the map is none.
    """
    require_type("map", mapping, OccupancyMap, "OccupancyMap.two_point(90, 180)")
    settings: Any = (spacing, series, crop, voxel, transpose)
    return VolumeRecipe(os.fspath(path), mapping, *settings).plain()


def make_bone(recipe: Mapping[str, Any], *, volume: str | os.PathLike[str] | None = None) -> VoxelBone:
    """The bone of a recipe.

    Parameters
    ----------
    recipe : mapping
        From `block_recipe`, `volume_recipe`, an experiment's `VolumeBlock`, `LabelledRecipe.plain` or
        `DrilledRecipe.plain`; it may come from another machine.
    volume : path, optional
        Path of the volume, if it differs from the recipe's.

    Raises
    ------
    ValueError
        If the recipe cannot be read, its block is too large, or the volume cannot be read.
    FileNotFoundError
        If there is no such volume.
    """
    try:
        built = _RECIPES[recipe["kind"]].of(recipe)
    except UNREADABLE as error:
        raise ValueError(
            f"recipe must be that of block_recipe or volume_recipe, got {reprlib.repr(recipe)} ({in_one_line(error)})"
        ) from None
    return (built if volume is None else built.at(volume)).bone()
