"""Half-drilled volumes: saved in the format of the original, for other programs, and reloaded exactly."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.session.snapshot import FORMAT, FORMAT_VERSION, check_tick, load_bone, open_hdf5, save_bone
from burrlab.volume.drilled_stack import stack_slices, write_stack
from burrlab.volume.geometry import same_geometry
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.read import read_volume
from burrlab.volume.stored import can_keep_header, read_stored
from burrlab.volume.volume import Volume
from burrlab.volume.write import write_volume

_KIND = "burrlab drilled volume"
_IN_FOLDER = "bone.h5"


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
        Of grey values; None where occupancy came from labels.
    source : str
        The volume that the bone was made of.
    """

    bone: VoxelBone
    tick: int
    mapping: OccupancyMap | None
    source: str


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
        With the ending of the original, for its header to be kept: .nrrd, .nii, .nii.gz, .mha. For a stack of PNG slices, a new
        folder. For DICOM, which is not written, the ending of another format.
    bone : VoxelBone
        On the voxels of `like`.
    like : Volume or LabelVolume
        What the bone was made of: grey values, or labels alone from coloured slices.
    mapping : OccupancyMap, optional
        With which it was made of the grey values; occupancy must not fall with them.
    tick : int
        Ticks executed on the bone so far.

    Raises
    ------
    ValueError
        If bone and volume are on different voxels, the map is missing or cannot be turned round, the path is the original's,
        its ending is none of these, the tick out of range, or `like` is itself half-drilled and has less than the bone.
    FileExistsError
        If there is something else under that name.
    FileNotFoundError
        If its folder, or the original stack, is not there.
    OSError
        If the files cannot be written.

    Notes
    -----
    Voxels of which nothing was removed keep their value to the bit. The others get the grey value that the map gives for what
    is left of them, and never a higher one than they had; nothing left is the grey value of empty. The header is that of the
    original file, byte by byte, where `like` is that file's whole volume; a cropped or resampled one gets a new header.

    Beside `NAME` lies `NAME.<digest>.bone.h5` (in a stack's folder, `bone.h5`), a bone as `save_bone` writes it. It is written
    first, and bears the digest of the volume it belongs to: whoever is killed in between leaves the old pair or the new one.
    """
    target = Path(path)
    check_tick(tick)
    if not target.resolve().parent.is_dir():
        raise FileNotFoundError(f"folder must exist, got {target.resolve().parent}")
    _check_place(bone, like)
    if Path(like.path).exists() and target.exists() and target.samefile(like.path) and not _sidecars(target):
        raise ValueError(f"path must be another file than the original {like.path}")
    _check_original(bone, like)
    told = {"kind": _KIND, "source": like.path, "map": None if mapping is None else mapping.text}
    slices = stack_slices(like)
    if slices is not None and not str(path).lower().endswith((".nrrd", ".nii", ".nii.gz", ".mha")):
        if target.exists():
            raise FileExistsError(f"path must be a new folder, {target} is there")
        greys = None if isinstance(like, LabelVolume) else _greys(bone, like, _needed(mapping, like))

        def beside(folder: Path, digest: str) -> None:
            save_bone(folder / _IN_FOLDER, bone, tick, source=json.dumps({**told, "sha256": digest}))

        write_stack(target, slices, like, bone, greys, beside)
        return
    if isinstance(like, LabelVolume):
        raise ValueError(
            f"like must be a grey volume, or labels of PNG slices, to be written as {target.name}"
        )
    if target.exists() and not _sidecars(target):
        raise FileExistsError(f"path must be a new file or one of save_drilled, {target} is neither")
    content = _content(target, _greys(bone, like, _needed(mapping, like)), like, bone)
    digest = hashlib.sha256(content).hexdigest()
    beside_it = _sidecar(target, digest)
    before = [other for other in _sidecars(target) if other != beside_it]
    save_bone(beside_it, bone, tick, source=json.dumps({**told, "sha256": digest}))
    _replace(target, content)  # from here on the new pair counts
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
    digest = _digest(target)
    beside = _sidecar(target, digest)
    if not beside.is_file():
        others = ", ".join(other.name for other in _sidecars(target))
        found = f"there is {others}, of another content of it" if others else "there is none"
        raise ValueError(f"{target}: the exact state, {beside.name}, must lie beside it, and {found}")
    bone, tick = load_bone(beside)
    told = _told(beside)
    if told.get("sha256") != digest:
        raise ValueError(f"{target}: {beside.name} belongs to another content of it: one of them was changed")
    mapping = None if told.get("map") is None else OccupancyMap.parse(str(told["map"]))
    return DrilledVolume(bone, tick, mapping, str(told.get("source", "")))


def _needed(mapping: OccupancyMap | None, like: Volume) -> OccupancyMap:
    if mapping is None:
        raise ValueError(f"mapping must be given: that with which the bone was made of {like.path}")
    return mapping


def _check_place(bone: VoxelBone, like: Volume | LabelVolume) -> None:
    where = like.bone_point(like.origin)
    small = 1e-2 * like.spacing
    if (
        bone.shape != like.shape
        or np.any(np.abs(np.array(bone.spacing) - like.spacing) > 1e-3 * like.spacing)
        or np.any(np.abs(np.array(bone.origin) - where) > small)
    ):
        raise ValueError(
            f"bone must be on the voxels of {like.path}: it has shape {bone.shape}, spacing {_three(bone.spacing)} and origin "
            f"{_three(bone.origin)} mm, and the volume {like.shape}, {_three(like.spacing)} and {_three(where)} mm"
        )


def _check_original(bone: VoxelBone, like: Volume | LabelVolume) -> None:
    """A half-drilled volume will do for the original while nothing grew on it since."""
    source = Path(like.path)
    if (
        not source.exists()
        or not _sidecars(source)
        or not (beside := _sidecar(source, _digest(source))).is_file()
    ):
        return
    before, _ = load_bone(beside)
    if before.shape == bone.shape and (more := int(np.count_nonzero(bone.density > before.density))):
        raise ValueError(
            f"like must be the original: {like.path} is half-drilled, and {more} voxels of it have less than the bone"
        )


def _three(values: Any) -> str:
    return "(" + ", ".join(f"{float(v):.6g}" for v in values) + ")"


def grey_of_levels(mapping: OccupancyMap) -> NDArray[np.float64]:
    """Grey value of each level 0 to 255, by the map turned round; of empty, the highest that is empty.

    Raises
    ------
    ValueError
        If occupancy falls somewhere with the grey value, or no grey value is empty.
    """
    greys, occupancies = np.array(mapping.greys), np.array(mapping.occupancies)
    if np.any(np.diff(occupancies) < 0) or occupancies[0] > 0 or occupancies[-1] == 0:
        raise ValueError(
            f"map must rise from 0 with the grey value, for what was removed to have one, got {mapping.text}"
        )
    levels = np.arange(256) / 255.0
    last = np.clip(np.searchsorted(occupancies, levels), int(np.argmax(occupancies > 0)), len(greys) - 1)
    low, high = occupancies[last - 1], occupancies[last]
    found = greys[last - 1] + np.minimum((levels - low) / (high - low), 1.0) * (greys[last] - greys[last - 1])
    found[0] = greys[np.flatnonzero(occupancies == 0)[-1]]
    return np.asarray(found)


def _greys(
    bone: VoxelBone, like: Volume, mapping: OccupancyMap
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which voxels lost something, and the grey values of these."""
    density, pristine = bone.density, bone.pristine
    lost = density < pristine
    was = like.values[lost].astype(np.float64)
    return lost, np.minimum(grey_of_levels(mapping)[density[lost]], was)


def _content(
    target: Path, greys: tuple[NDArray[np.bool_], NDArray[np.float64]], like: Volume, bone: VoxelBone
) -> bytes:
    """The bytes of the volume's file."""
    lost, values = greys
    ending = next((e for e in (".nii.gz", ".nrrd", ".nii", ".mha") if target.name.lower().endswith(e)), None)
    if ending is None:
        raise ValueError(f"path must end in .nrrd, .nii, .nii.gz or .mha, got {target}")
    if can_keep_header(like.path) and like.path.lower().endswith(ending):
        stored = read_stored(like.path)
        if stored.values.shape == like.shape and _is_whole(like):
            new = stored.values.copy()
            new[lost] = stored.stored(values)
            return stored.content(new)
    new = like.values.copy()
    new[lost] = values if new.dtype.kind == "f" else np.rint(values)
    part = target.with_name(f".{target.name}.values{ending}")
    try:
        write_volume(part, replace(like, values=new))
        return part.read_bytes()
    finally:
        part.unlink(missing_ok=True)


def _is_whole(like: Volume) -> bool:
    """Whether the volume is what its file holds, not cropped, resampled or changed."""
    whole = read_volume(like.path, spacing=like.spacing)
    return same_geometry(whole, like) and np.array_equal(whole.values, like.values)


def _replace(target: Path, content: bytes) -> None:
    part = target.with_name(f".{target.name}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def _digest(target: Path) -> str:
    """SHA-256 of a file, or of the names and contents of a folder's slices."""
    if target.is_file():
        return hashlib.sha256(target.read_bytes()).hexdigest()
    digest = hashlib.sha256()
    for path in sorted(target.glob("*.png")):
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _sidecar(target: Path, digest: str) -> Path:
    if target.is_dir():
        return target / _IN_FOLDER
    return target.with_name(f"{target.name}.{digest[:16]}.bone.h5")


def _sidecars(target: Path) -> list[Path]:
    """Those that are there, of whatever content of the volume."""
    if target.is_dir():
        return [target / _IN_FOLDER] if (target / _IN_FOLDER).is_file() else []
    head, tail = f"{target.name}.", ".bone.h5"
    folder = target.resolve().parent
    return sorted(
        path
        for path in folder.iterdir()
        if path.name.startswith(head)
        and path.name.endswith(tail)
        and len(path.name) == len(head) + 16 + len(tail)
    )


def _told(path: Path) -> dict[str, Any]:
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file:
        try:
            told = json.loads(file.attrs["source"])
        except (KeyError, ValueError):
            told = None
    if not isinstance(told, dict) or told.get("kind") != _KIND:
        raise ValueError(f"{path} is a bone, but not one of a drilled volume")
    return told
