"""The two files of a half-drilled volume: the volume itself, and beside it the exact state of its bone."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from burrlab.json_text import UNREADABLE
from burrlab.session.new_hdf5 import attributes
from burrlab.session.snapshot import FORMAT, FORMAT_VERSION, open_hdf5
from burrlab.volume.dicom import IN_FOLDER, dicom_files, holds_dicom

KIND = "burrlab drilled volume"
_LONGEST = 255 - len(".0123456789abcdef.bone.h5.part")


def content_digest(target: Path) -> str:
    """SHA-256 of a file, or of the names and contents of a folder's slices."""
    if target.is_file():
        return hashlib.sha256(target.read_bytes()).hexdigest()
    digest = hashlib.sha256()
    if holds_dicom(target):
        slices = [Path(name) for name in dicom_files(target)[0]]
    else:
        slices = sorted(part for part in target.iterdir() if part.suffix.lower() == ".png")
    for path in slices:
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def sidecar(target: Path, digest: str) -> Path:
    """Where the exact state of a volume of this content lies."""
    if target.is_dir():
        return target / IN_FOLDER
    return target.with_name(f"{target.name}.{digest[:16]}.bone.h5")


def check_name(target: Path) -> None:
    """ValueError where a file's name leaves no room for that of the exact state beside it."""
    if (size := len(os.fsencode(target.name))) > _LONGEST:
        raise ValueError(
            f"path must have a name of at most {_LONGEST} bytes, for the exact state to be named after it, got {size}"
        )


def followed(target: Path) -> Path:
    """Where a link leads: its file is replaced, and not the link."""
    return target.resolve() if target.is_symlink() else target


def sidecars(target: Path) -> list[Path]:
    """Those that are there, of whatever content of the volume; of a link, beside it and where it leads."""
    if target.is_dir():
        return [target / IN_FOLDER] if (target / IN_FOLDER).is_file() else []
    return [beside for place in dict.fromkeys((target, followed(target))) for beside in _named(place)]


def _named(target: Path) -> list[Path]:
    head, tail = f"{target.name}.", ".bone.h5"
    folder = target.parent.resolve()
    if not folder.is_dir():
        return []
    return sorted(
        path
        for path in folder.iterdir()
        if path.name.startswith(head)
        and path.name.endswith(tail)
        and len(path.name) == len(head) + 16 + len(tail)
    )


def own_sidecar(target: Path) -> tuple[Path, dict[str, Any]]:
    """The exact state that belongs to what a volume holds now, and what it says of itself; errors as `load_drilled`."""
    digest = content_digest(target)
    beside = sidecar(target, digest)
    if not beside.is_file() and (there := sidecar(followed(target), digest)).is_file():
        beside = there
    if not beside.is_file():
        others = ", ".join(other.name for other in sidecars(target))
        found = (
            f"there is {others}, of another content of it"
            if others
            else "there is none: was the volume moved, or is it not one that was saved half-drilled?"
        )
        raise ValueError(f"{target}: the exact state, {beside.name}, must lie beside it, and {found}")
    told = _told(beside)
    if told.get("sha256") != digest:
        raise ValueError(f"{target}: {beside.name} belongs to another content of it: one of them was changed")
    return beside, told


def is_drilled(target: Path) -> bool:
    """Whether a file or folder is a half-drilled volume as it was saved, and not another one under its name."""
    if not sidecars(target):
        return False
    try:
        own_sidecar(target)
    except (ValueError, OSError):
        return False
    return True


def replace_whole(target: Path, content: bytes) -> None:
    """Writes a file that appears, or replaces an older one, when it is whole and on disk."""
    part = target.with_name(f".{target.name}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def _told(path: Path) -> dict[str, Any]:
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file:
        try:
            told = json.loads(attributes(file)["source"])
        except UNREADABLE:
            told = None
    if not isinstance(told, dict) or told.get("kind") != KIND:
        raise ValueError(f"{path} is a bone, but not one of a drilled volume")
    return told
