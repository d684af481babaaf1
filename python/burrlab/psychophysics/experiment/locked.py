"""Files that one process at a time writes, to the disk."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from burrlab import files


def lock(file: int, path: Path, *, wait: bool = False) -> None:
    """The lock of a run's open file; BlockingIOError if another process has it, unless told to wait."""
    files.lock(file, f"{path}: another process has this run open", wait=wait)


@contextmanager
def locked(file: int, path: Path, *, wait: bool = False) -> Iterator[None]:
    """Within, the lock of an open file is held; then the file is closed."""
    try:
        lock(file, path, wait=wait)
        yield
    finally:
        os.close(file)


def synced_write(file: int, path: Path, text: bytes) -> None:
    """All of the text behind what is there, on the disk, or none of it.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    before = os.fstat(file).st_size
    try:
        if (written := os.write(file, text)) < len(text):
            raise OSError(f"{path} took {written} of {len(text)} bytes: is the disk full?")
        os.fsync(file)
    except OSError as error:
        os.ftruncate(file, before)
        if error.filename is None and error.errno is not None:  # a disk that is full does not say where
            raise OSError(error.errno, error.strerror, os.fspath(path)) from None
        raise


def sync_folder(folder: Path) -> None:
    """So that the names of new files outlive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
