"""Files and folders that are made anew: where, and that a folder appears when it is whole."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path


def check_folder(target: Path) -> None:
    """FileNotFoundError or PermissionError where nothing can be made beside a path, before there is anything to lose."""
    folder = target.resolve().parent
    if not folder.is_dir():
        raise FileNotFoundError(f"folder must exist, got {folder}")
    if not os.access(folder, os.W_OK):
        raise PermissionError(f"folder must be writable, got {folder}")


@contextlib.contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """A folder to be filled, which gets its name at the end, and is gone after an error; OSError where it cannot be made."""
    part = target.with_name(f".{target.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    try:
        yield part
        os.rename(part, target)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def write_synced(path: Path, content: bytes) -> None:
    """Writes a file and waits until it is on disk."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
