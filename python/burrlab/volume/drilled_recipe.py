"""A bone that was kept in a file, taken up again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from burrlab._core import Burr, VoxelBone
from burrlab.session.snapshot import bone_source, load_bone
from burrlab.specimen import Specimen, Vector
from burrlab.volume.drilled import DrilledVolume, load_drilled
from burrlab.volume.header import assumed, told_notes
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.recipe import absolute, check_radius
from burrlab.volume.stack import is_stack
from burrlab.volume.volume import Volume, specimen_in


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
