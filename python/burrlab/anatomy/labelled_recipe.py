"""How a bone with tissues is made of files. What results and traces keep, and replicas follow."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from burrlab._core import Burr, Tissues, VoxelBone
from burrlab.anatomy.known_tissues import EMPTY
from burrlab.anatomy.labelled_bone import LabelledBone, labelled_bone, placed_on
from burrlab.session.snapshot import tissues_from_json, tissues_to_json
from burrlab.specimen import Specimen, Vector
from burrlab.volume import LabelVolume, OccupancyMap, Volume, read_labels
from burrlab.volume.palette import RANKING
from burrlab.volume.recipe import VolumeRecipe, absolute, check_radius
from burrlab.volume.stack import is_stack, read_stack, rows_along_x
from burrlab.volume.volume import specimen_in

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
            VolumeRecipe.of(plain["grey"]) if "grey" in plain else None, fill, _three(plain.get("labels_spacing_mm")),
            unknown if isinstance(unknown, int) else str(unknown), None if unit is None else float(unit),
            None if crop is None else (_numbers(crop[0]), _numbers(crop[1])), _three(plain.get("voxel_mm")),
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


def _three(value: Any) -> tuple[float, float, float] | None:
    return None if value is None else _numbers(value)
