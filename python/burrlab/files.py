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


def lock(file: int, taken: str, *, wait: bool = False) -> None:
    """Takes the lock of an open file or folder; it ends when that is closed, and with the process, however that ends.

    Raises
    ------
    BlockingIOError
        If another has it, unless told to wait; `taken` says so.
    """
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        raise BlockingIOError(taken) from None


@contextlib.contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """A folder to be filled, which gets its name at the end, and is gone after an error; OSError where it cannot be made."""
    part = target.with_name(f".{target.name}.part")
    part.mkdir(exist_ok=True)
    descriptor = os.open(part, os.O_RDONLY)
    try:
        taken = f"{target} is being written by another process"
        lock(descriptor, taken)
        if not _is_at(descriptor, part):  # it got its name meanwhile
            raise BlockingIOError(taken)
        try:
            for left in part.iterdir():  # by a process that was killed
                left.unlink()
            yield part
            os.rename(part, target)
        except BaseException:
            shutil.rmtree(part, ignore_errors=True)
            raise
    finally:
        os.close(descriptor)


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def write_synced(path: Path, content: bytes) -> None:
    """Writes a file and waits until it is on disk."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
