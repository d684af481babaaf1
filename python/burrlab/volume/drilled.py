"""Half-drilled volumes: saved in the format of the original, for other programs, and reloaded exactly."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, replace
from pathlib import Path

from burrlab._core import VoxelBone
from burrlab.session.snapshot import check_tick, load_bone, save_bone
from burrlab.volume.dicom import IN_FOLDER
from burrlab.volume.drilled_checks import check_drilled, check_original, check_place, is_series
from burrlab.volume.drilled_dicom import write_series
from burrlab.volume.drilled_pair import (
    KIND,
    followed,
    own_sidecar,
    replace_whole,
    sidecar,
    sidecars,
)
from burrlab.volume.drilled_stack import write_stack
from burrlab.volume.drilled_values import changed_file, changes
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.read import read_labels, read_volume
from burrlab.volume.stack import ROWS_ALONG_X, is_stack, read_stack
from burrlab.volume.volume import Volume


@dataclass(frozen=True, eq=False)
class DrilledVolume:
    """A half-drilled bone, as it was saved.

    Attributes
    ----------
    bone : VoxelBone
        Present and pristine levels, and tissues: its digest is that of the bone that was saved.
    tick : int
        Ticks executed on it so far.
    mapping : OccupancyMap or None
        Of grey values; None where the volume is of labels.
    source : str
        The volume that the bone was made of.
    path : str
        Of the half-drilled volume itself.
    transpose : bool
        Of slices; see `read_stack`.
    """

    bone: VoxelBone
    tick: int
    mapping: OccupancyMap | None
    source: str
    path: str
    transpose: bool = False

    def volume(self) -> Volume | LabelVolume:
        """The half-drilled volume as other programs see it, on the voxels of the bone: `like` of the next `save_drilled`."""
        if is_stack(self.path):
            return read_stack(
                self.path, spacing=self.bone.spacing, palette=None if self.mapping else self.bone.tissues, unknown="nearest",
                transpose=self.transpose,
            )  # fmt: skip
        read = read_labels if self.mapping is None else read_volume
        return read(self.path, spacing=self.bone.spacing)


def save_drilled(
    path: str | os.PathLike[str],
    bone: VoxelBone,
    like: Volume | LabelVolume,
    *,
    mapping: OccupancyMap | None = None,
    tick: int = 0,
) -> None:
    """Writes a bone as a volume in which what was removed is gone, and beside it what brings back its exact state.

    Parameters
    ----------
    path : path-like
        With the ending of the original, for its header to be kept: .nrrd (.seg.nrrd), .nii, .nii.gz, .mha. For a stack of PNG
        slices or a DICOM series, a new folder.
    bone : VoxelBone
        On the voxels of `like`.
    like : Volume or LabelVolume
        What the bone was made of: grey values, or labels alone.
    mapping : OccupancyMap, optional
        With which it was made of the grey values; occupancy must not fall with them.
    tick : int
        Ticks executed on the bone so far.

    Raises
    ------
    ValueError
        If bone and volume are on different voxels, the map is missing, given for labels, cannot be turned round or has a grey
        value of empty that the file cannot store, the path is the original's, its ending is none of these, its name is too long, the header
        cannot be kept (values as text, or in another place than right behind it), the tick out of range, or `like` is itself
        half-drilled and has less than the bone.
    FileExistsError
        If there is something else under that name.
    FileNotFoundError
        If its folder, or the original stack or series, is not there.
    OSError
        If the files cannot be written.

    Notes
    -----
    Voxels of which nothing was removed keep their value to the bit, but for a resampled DICOM series: its slices hold whole numbers.
    The others get the grey value that the map gives for what is left of them, and never a higher one than they had; nothing left is the grey value of empty. Of labels alone, a voxel of
    which less than half is left gets label 0. The header is that of the original file, byte by byte, where `like` is that file's
    whole volume; a cropped or resampled one, and a segmentation in several layers, gets a new header, of NRRD with the names and
    colours of its labels. Slices of a DICOM series are
    derived images of a new series, of the same study: UIDs, image type and derivation are theirs, all else is that of the slice that
    they were made of.

    Beside `NAME` lies `NAME.<digest>.bone.h5` (in a stack's folder, `bone.h5`), a bone as `save_bone` writes it. It is written
    first, and bears the digest of the volume it belongs to: whoever is killed in between leaves the old pair or the new one.
    """
    target = followed(Path(path))
    check_tick(tick)
    slices = check_drilled(target, like, mapping)
    check_place(bone, like)
    check_original(bone, like)
    changed = changes(bone, like, mapping)
    told = {
        "kind": KIND,
        "source": like.path,
        "map": None if mapping is None else mapping.text,
        "transpose": ROWS_ALONG_X in like.notes,
    }

    def beside(where: Path, digest: str) -> None:
        save_bone(where, bone, tick, source=json.dumps({**told, "sha256": digest}))

    def in_folder(folder: Path, digest: str) -> None:
        beside(folder / IN_FOLDER, digest)

    if slices is not None:
        write_stack(target, slices, like, changed, in_folder)
        return
    if is_series(target, like):
        write_series(target, like, changed, in_folder)
        return
    if isinstance(like, LabelVolume):  # what the table says where the file said nothing, for a new header
        names, colours = ({t.label: getattr(t, of) for t in bone.tissues or ()} for of in ("name", "colour"))
        like = replace(like, names=names | like.names, colours=colours | like.colours)
    content = changed_file(target, like, changed)
    digest = hashlib.sha256(content).hexdigest()
    own = sidecar(target, digest)
    before = [other for other in sidecars(target) if other.name != own.name]
    beside(own, digest)
    replace_whole(target, content)  # from here on the new pair counts
    for other in before:
        other.unlink(missing_ok=True)


def load_drilled(path: str | os.PathLike[str]) -> DrilledVolume:
    """The bone of a volume that `save_drilled` wrote, in its exact state.

    Raises
    ------
    FileNotFoundError
        If there is no such file or folder.
    ValueError
        If the file that holds the exact state is missing, or belongs to another content of the volume: one of them was changed.
    """
    target = Path(path)
    if not target.exists():
        raise FileNotFoundError(f"{target}: no such file or folder")
    beside, told = own_sidecar(target)
    bone, tick = load_bone(beside)
    mapping = None if told.get("map") is None else OccupancyMap.parse(str(told["map"]))
    return DrilledVolume(
        bone, tick, mapping, str(told.get("source", "")), os.fspath(path), bool(told.get("transpose"))
    )
