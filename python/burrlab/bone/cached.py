"""Bones of large volumes are kept for the next start; docs/volumes.md says where."""

import contextlib
import functools
import glob
import hashlib
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

import burrlab._core as _core
from burrlab._core import VoxelBone, pack_bone, unpack_bone
from burrlab.bone.dicom import holds_dicom, is_dicom
from burrlab.bone.formats import format_of
from burrlab.bone.image import OnGrid, Volume
from burrlab.bone.slices import is_stack, read_description
from burrlab.bone.snapshot import tissues_from_json, tissues_to_json
from burrlab.common.cache import Entry, Kept

#: Voxels from which a volume is worth keeping, and one with smoothed labels (ours): smaller ones are made in
#: tenths of a second.
WORTH, WORTH_SMOOTHED = 1 << 24, 1 << 22


def entry_of(settings: object, volumes: Iterable[str]) -> Entry:
    """The place of what follows from settings, burrlab's own code and the files of volumes."""
    files: list[str] = []
    with contextlib.suppress(ValueError, OSError, ImportError):  # who reads them says what is wrong
        files = [file for path in volumes for file in _files(path)]
    return Entry([*_code(), settings], files)


def keep_bone(
    entry: Entry, bone: VoxelBone, grid: OnGrid, notes: Sequence[str], *, smoothed: bool = False
) -> None:
    """Keeps a bone that is worth it, with the geometry of its volume; none was removed from it."""
    if math.prod(bone.shape) < (WORTH_SMOOTHED if smoothed else WORTH):
        return
    table = None if bone.tissues is None else tissues_to_json(bone.tissues)
    bone_header = {"shape": bone.shape, "spacing": bone.spacing, "origin": bone.origin, "tissues": table}
    lies = {name: getattr(grid, name).tolist() for name in ("spacing", "origin", "direction")}
    header = {"bone": bone_header, "shape": grid.shape, "path": grid.path, "notes": list(notes), **lies}
    entry.keep(header, pack_bone(bone))


def kept_bone(cached: Kept) -> VoxelBone:
    """A new bone as it was kept."""
    header, packed = cached.told["bone"], [np.frombuffer(part, np.uint8) for part in cached.parts]
    table = None if header["tissues"] is None else tissues_from_json(header["tissues"])
    return unpack_bone(header["shape"], header["spacing"], header["origin"], packed[0], table, packed[1])


def kept_grid(cached: Kept) -> OnGrid:
    """The geometry of the volume; its voxels, all 0, are not those of the volume."""
    header, none = cached.told, np.broadcast_to(np.uint8(0), cached.told["shape"])
    notes = tuple(header["notes"])
    return Volume(none, header["spacing"], header["origin"], header["direction"], header["path"], notes)


def _files(path: str) -> list[str]:
    """All files that a volume is read from."""
    if is_stack(path):
        if Path(path).suffix.lower() in (".yaml", ".yml"):
            return [path, *_slices(read_description(path, unit=1.0).folder)]
        return _slices(Path(path)) if Path(path).is_dir() else sorted(glob.glob(path))
    if Path(path).is_dir():  # of DICOM slices; notes name the other files
        parts = Path(path).iterdir() if holds_dicom(path) else Path(path).rglob("*")
        return sorted(str(part) for part in parts if part.is_file())
    file_format = format_of(path)
    if file_format is None or is_dicom(path):
        return [path]
    pair = [path[:-4] + ".hdr"] if path.lower().endswith(".img") else []
    return [path, *pair, *map(str, file_format.read(path)[1].files)]


def _slices(folder: Path) -> list[str]:
    return sorted(str(part) for part in folder.iterdir() if part.suffix.lower() == ".png")


@functools.cache
def _code() -> tuple[str, str]:
    """Version of burrlab, and a digest of the code that reads volumes and makes bones."""
    digest = hashlib.sha256()
    for path in [*sorted(Path(__file__).parent.glob("*.py")), Path(_core.__file__)]:
        with contextlib.suppress(OSError):
            digest.update(path.read_bytes())
    return _core.__version__, digest.hexdigest()
