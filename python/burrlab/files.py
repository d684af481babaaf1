"""Files and folders that are made anew: where, and that a folder appears when it is whole."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

#: What a write says where the disk is full, a quota or limit is met, or the disk fails.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def check_folder(target: Path) -> None:
    """FileNotFoundError or PermissionError where nothing can be made beside a path, before there is anything to lose."""
    folder = target.resolve().parent
    if not folder.is_dir():
        raise FileNotFoundError(f"folder must exist, got {folder}")
    if not os.access(folder, os.W_OK):
        raise PermissionError(f"folder must be writable, got {folder}")


def kept_elsewhere(path: str, name: str, write: Callable[[str], object]) -> str | None:
    """Where else something could be written: beside its path, or under a name among temporary files; None: nowhere."""
    beside, folder = f"{path}{Path(name).suffix}", ""
    if not os.path.lexists(beside) and (
        os.path.isfile(path) or not os.path.exists(path)
    ):  # not beside a device
        try:
            write(beside)
            return beside
        except OSError:
            Path(beside).unlink(missing_ok=True)
    try:
        folder = tempfile.mkdtemp(prefix="burrlab-")
        write(place := os.path.join(folder, name))
        return place
    except OSError:
        shutil.rmtree(folder, ignore_errors=True)
        return None


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
def new_part(target: Path, ending: str = "") -> Iterator[Path]:
    """A new, empty file beside a path, of a name that nobody else has, to be moved there once it is whole; else it is gone.

    A kill leaves it behind, and it stands in nobody's way. OSError where it cannot be made.
    """
    check_folder(target)
    part = target.with_name(f".{target.name[:40]}.{os.getpid()}-{secrets.token_hex(4)}.part{ending}")
    try:
        os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINK, 0o666))
    except OSError as error:
        raise OSError(error.errno, error.strerror, os.fspath(target)) from None
    try:
        yield part
    finally:
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """A folder to be filled, which gets its name at the end, and is gone after an error; OSError where it cannot be made."""
    part = target.with_name(f".{target.name}.part")
    part.mkdir(exist_ok=True)
    descriptor = os.open(part, os.O_RDONLY | _NO_LINK)
    try:
        if os.fstat(descriptor).st_uid != os.geteuid():  # who could put links into it meanwhile
            raise PermissionError(f"{part} is another user's")
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
