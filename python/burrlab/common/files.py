"""Writes, locks and syncs files; handles HDF5 so that a full disk or damage does not crash the process.

As a script, this module makes libhdf5 read a file: a damaged file hangs or crashes that process alone.
"""

import contextlib
import errno
import hashlib
import io
import itertools
import os
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    import h5py


#: Error numbers of a write: the disk is full, a quota or limit is reached, or the disk fails.
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def check_folder(target: Path) -> None:
    """FileNotFoundError or PermissionError if no file can be made beside a path."""
    folder = target.resolve().parent
    if not folder.is_dir():
        raise FileNotFoundError(f"folder must exist, got {folder}")
    if not os.access(folder, os.W_OK):
        raise PermissionError(f"folder must be writable, got {folder}")


def kept_elsewhere(path: str, name: str, write: Callable[[str], object]) -> str | None:
    """Path to which `write` wrote: beside `path`, or among temporary files; None if both fail."""
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


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Waits until no other process holds the lock of a folder, then holds it; without it where there are no locks."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            lock(descriptor, "", wait=True)
        yield
    finally:
        os.close(descriptor)


def lock(file: int, message: str, *, wait: bool = False) -> None:
    """Takes the lock of an open file or folder, until it is closed or the process ends.

    BlockingIOError with the text `message`, if another process has the lock and `wait` is False.
    """
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        raise BlockingIOError(message) from None


@contextlib.contextmanager
def new_part(target: Path, ending: str = "") -> Iterator[Path]:
    """A new, empty file beside a path. The caller moves it to the path when complete; else it is removed.

    A killed process leaves it behind. OSError if it cannot be made.
    """
    check_folder(target)
    part = target.with_name(f".{target.name[:40]}.{os.getpid()}-{secrets.token_hex(4)}.part{ending}")
    try:
        os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), 0o666))
    except OSError as error:
        raise OSError(error.errno, error.strerror, os.fspath(target)) from None
    try:
        yield part
    finally:
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str], ending: str = "") -> Iterator[Path]:
    """A file to write in the place of a path: on disk, it replaces the older one at the end, unless there is an error.

    A link stays, and the file that it leads to is replaced. A device or a pipe is itself written to.
    """
    target = Path(path).resolve() if os.path.islink(path) else Path(path)
    if target.exists() and not target.is_file():
        yield Path(path)
        return
    with new_part(target, ending) as part:
        try:
            yield part
            sync(part)
            if target.exists():
                shutil.copymode(target, part)
            part.replace(target)
        except OSError as error:
            if error.errno is None or error.filename not in (None, os.fspath(part)):
                raise
            raise OSError(error.errno, error.strerror, os.fspath(path)) from None


def write_text(file: str | os.PathLike[str] | IO[str], text: str) -> None:
    """Writes a text in UTF-8 into an open file, or a `new_file`; into the file itself in a folder closed to us."""
    if not isinstance(file, (str, os.PathLike)):
        file.write(text)
        return
    closed = os.path.isfile(file) and not os.access(os.path.dirname(os.path.realpath(file)), os.W_OK)
    with contextlib.nullcontext(Path(file)) if closed else new_file(file) as part:
        part.write_text(text, encoding="utf-8", newline="")


@contextlib.contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """A folder to fill: named `target` at the end, removed after an error. A killed process leaves it behind.

    OSError if it cannot be made, or another process has made `target` meanwhile.
    """
    part = target.with_name(f".{target.name[:40]}.{os.getpid()}-{secrets.token_hex(4)}.part")
    part.mkdir()
    try:
        yield part
        if target.exists():
            raise FileExistsError(f"folder must be new, {target} is there")
        os.rename(part, target)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def hash_of(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's content, in hexadecimal digits."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_synced(path: Path, content: bytes) -> None:
    """Writes a file and waits until it is on disk."""
    path.write_bytes(content)
    sync(path)


_PATIENCE = 30.0  # longest wait for libhdf5 in a file without checksums, on a busy machine [s]


@contextlib.contextmanager
def new_hdf5(path: str | os.PathLike[str], **options: Any) -> "Iterator[h5py.File]":
    """A new file, or an older one emptied; on disk at the end. OSError if it cannot be written.

    Notes
    -----
    libhdf5 writes much of a file when the file is closed. If this fails, its memory is corrupt and the
    process crashes at once or at its end. So errors are hidden from libhdf5, and the first one is raised when
    the file is closed.

    The format of HDF5 1.10 has checksums on all metadata except texts of variable length; see
    `put_attributes`.
    """
    import h5py

    check_folder(Path(path))
    with _Disk(path) as disk:
        try:
            with h5py.File(disk, "w", libver=("v110", "v110"), **options) as file:
                yield file
        except (OSError, RuntimeError):
            if disk.failure is None:
                raise
        if disk.failure is not None:
            raise OSError(disk.failure.errno, disk.failure.strerror, os.fspath(path)) from None
        os.fsync(disk.fileno())


def put_attributes(item: "h5py.Group | h5py.Dataset", values: Mapping[str, Any]) -> None:
    """Writes attributes, with texts of fixed length.

    The heap of texts of variable length has no checksum, and zeros in it hang libhdf5.
    """
    import h5py

    for name, value in values.items():
        if isinstance(value, str):
            content = value.encode("utf-8", "surrogateescape")
            item.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))
        else:
            item.attrs[name] = value


def attributes(item: "h5py.Group | h5py.Dataset") -> dict[str, Any]:
    """All attributes, with texts as str."""
    for name in item.attrs:
        check_heap(item, item.attrs.get_id(name).dtype)
    return {
        name: value.decode("utf-8", "surrogateescape") if isinstance(value, bytes) else value
        for name, value in item.attrs.items()
    }


def check_heap(item: "h5py.Group | h5py.Dataset", dtype: Any) -> None:
    """ValueError if a value of variable length, which has no checksum, hangs or crashes libhdf5."""
    if dtype.hasobject and item.file.id.get_create_plist().get_version()[0] > 2:
        check_walk(item.file.filename)


def check_walk(path: str | os.PathLike[str]) -> None:
    """ValueError if libhdf5 hangs or crashes in a file, as in damaged files without checksums."""
    command = [sys.executable, "-P", __file__, os.fspath(path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    with contextlib.suppress(subprocess.TimeoutExpired):
        if not subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            timeout=_PATIENCE, check=False,
        ).returncode:  # fmt: skip
            return
    raise ValueError(f"{path} is damaged: the HDF5 library hangs or crashes reading it")


def link_elsewhere(file: "h5py.File") -> str | None:
    """Name of a link that is not hard: it could lead to another file, and a pipe hangs beyond Ctrl-C. None if all are.

    ValueError if groups are nested deeply: libhdf5's own visit goes down until its stack is full.
    """
    import h5py

    groups, seen = [(file["/"], 0)], set()
    while groups:
        group, depth = groups.pop()
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                return f"{group.name}/{name}".lstrip("/")
            if group.get(name, getclass=True) is not h5py.Group:
                continue
            inner = group[name]
            if (address := h5py.h5o.get_info(inner.id).addr) in seen:
                continue
            if depth > 20:
                raise ValueError("its groups are nested too deeply")
            seen.add(address)
            groups.append((inner, depth + 1))
    return None


class _Disk(io.FileIO):
    """A new file whose writes never fail for libhdf5; `failure` is the first hidden error."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        super().__init__(path, "w+")
        self.failure: OSError | None = None

    def write(self, content: Any, /) -> int:
        left = memoryview(content).cast("B")
        size, begin = len(left), self.tell()
        try:
            while self.failure is None and len(left):
                left = left[super().write(left) :]
        except OSError as error:
            self.failure = error
        if self.failure is not None:
            self.seek(begin + size)
        return size

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return self.tell() if size is None else size


_MEMORY, _TIME = 4 << 30, 2  # limits of the process: memory [bytes] and processor time [s]


def walk(item: Any, depth: int = 0) -> None:
    """Reads attributes, members, the place of each chunk, and values of small datasets."""
    dict(item.attrs.items())
    if hasattr(item, "keys"):
        for name in ["none", *itertools.islice(item, 1000 if depth < 4 else 0)]:
            if name in item:
                walk(item[name], depth + 1)
    elif item.chunks:
        item.id.chunk_iter(lambda chunk: None)
    elif item.shape is not None:
        item[:1] if item.shape else item[()]


if __name__ == "__main__":
    import h5py

    with contextlib.suppress(ImportError):
        import resource

        for what, most in ((resource.RLIMIT_AS, _MEMORY), (resource.RLIMIT_CPU, _TIME)):
            hard = resource.getrlimit(what)[1]
            least = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(what, (least, least))
    with contextlib.suppress(Exception), h5py.File(sys.argv[1], "r") as file:  # the reader reports errors
        if link_elsewhere(file) is None:
            walk(file)


def synced_write(file: int, path: Path, text: bytes) -> None:
    """Appends all of the text to a file, on disk; or, with an OSError, nothing."""
    before = os.fstat(file).st_size
    try:
        if (written := os.write(file, text)) < len(text):
            raise OSError(f"{path} took {written} of {len(text)} bytes: is the disk full?")
        os.fsync(file)
    except OSError as error:
        os.ftruncate(file, before)
        if error.filename is None and error.errno is not None:  # such an error names no file
            raise OSError(error.errno, error.strerror, os.fspath(path)) from None
        raise


def sync(path: Path) -> None:
    """Puts a file, or the names in a folder, on disk: they survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
