"""HDF5 files: new ones, where a full disk is an OSError and no more; and what hangs libhdf5 in damaged ones."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from burrlab.files import check_folder

if TYPE_CHECKING:
    import h5py

_PATIENCE = 30.0  # with libhdf5 in a file without checksums, on a busy machine [s]


@contextlib.contextmanager
def new_hdf5(path: str | os.PathLike[str], **options: Any) -> Iterator[h5py.File]:
    """A new file, or an older one emptied, on disk at the end; OSError where it cannot be written.

    Notes
    -----
    libhdf5 writes much of a file when it is closed, and where that fails, leaves its memory in disorder: processes crash at
    once or at their end. So it is told of no error, and the first is raised when it has done.

    The format of HDF5 1.10 has checksums on all that describes the data but texts of no fixed length: `put_attributes`.
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


def put_attributes(item: h5py.Group | h5py.Dataset, values: Mapping[str, Any]) -> None:
    """Attributes, texts with a fixed length: the heap of the others has no checksum, and zeros in it hang libhdf5 for ever."""
    import h5py

    for name, value in values.items():
        if isinstance(value, str):
            content = value.encode("utf-8", "surrogateescape")
            item.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))
        else:
            item.attrs[name] = value


def attributes(item: h5py.Group | h5py.Dataset) -> dict[str, Any]:
    """All of them, texts of a fixed length or not as str."""
    for name in item.attrs:
        check_heap(item, item.attrs.get_id(name).dtype)
    return {
        name: value.decode("utf-8", "surrogateescape") if isinstance(value, bytes) else value
        for name, value in item.attrs.items()
    }


def check_heap(item: h5py.Group | h5py.Dataset, dtype: Any) -> None:
    """ValueError where a value of no fixed length hangs or crashes libhdf5, in a file whose other parts have checksums."""
    if dtype.hasobject and item.file.id.get_create_plist().get_version()[0] > 2:
        check_walk(item.file.filename)


def check_walk(path: str | os.PathLike[str]) -> None:
    """ValueError where libhdf5 hangs or crashes in a file, as it does in damaged ones without checksums."""
    command = [sys.executable, "-P", str(Path(__file__).with_name("hdf5_walk.py")), os.fspath(path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    with contextlib.suppress(subprocess.TimeoutExpired):
        if not subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            timeout=_PATIENCE, check=False,
        ).returncode:  # fmt: skip
            return
    raise ValueError(f"{path} is damaged: the HDF5 library hangs or crashes reading it")


class _Disk(io.FileIO):
    """A new file that cannot fail to be written; `failure` is the first error that it was not told."""

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
