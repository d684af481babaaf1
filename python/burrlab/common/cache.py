"""Keeps what takes long to make of files, in a folder that may be emptied at any time."""

import contextlib
import functools
import hashlib
import itertools
import json
import mmap
import os
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

from burrlab.common.check import refuse
from burrlab.common.files import hash_of, new_part
from burrlab.common.progress import LOG
from burrlab.common.records import UNREADABLE

FOLDER = "BURRLAB_CACHE"  # environment variable: the folder; empty: nothing is kept
MOST = 4 << 30  # of all that is kept [bytes]; what was not used for longest goes first (ours)
_SETTLED = 2.0  # after a file's last change [s]: another one shows in its times on any file system (ours)
_CHECK = 9  # bytes of the checksum of all that follows: eight digits and the end of a line


class CachedParts(NamedTuple):
    """A result from the cache: what JSON holds, and arrays of bytes."""

    header: dict[str, Any]
    parts: list[memoryview]


class Entry:
    """The place of a result that follows from settings and files.

    Parameters
    ----------
    settings : object
        All that the result depends on besides the contents of the files, ready for JSON.
    files : sequence of str
    """

    def __init__(self, settings: object, files: Sequence[str]) -> None:
        text = json.dumps(settings, sort_keys=True).encode("utf-8", "surrogateescape")
        self._name = f"{hashlib.sha256(text).hexdigest()[:32]}.kept"
        self._names, self._files = tuple(files), dict[str, tuple[int, ...]]()

    @property
    def _path(self) -> Path | None:
        folder = _folder() if self._names else None
        return None if folder is None or not _is_private(folder) else folder / self._name

    def look(self, before: "Entry | None" = None) -> Self:
        """Looks at the files, once, to be called before they are read; or as another entry found them before."""
        known = {} if before is None else before.look()._files
        self._files = {name: known.get(name) or self._files.get(name) or _state(name) for name in self._names}
        return self

    def find(self) -> CachedParts | None:
        """What was kept, mapped into memory; None unless it is whole and the files hold what they held."""
        try:
            if (path := self.look()._path) is None:
                return None
            with path.open("rb") as file:
                refuse(not _is_own(os.fstat(file.fileno())), "the file is another user's")
                mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            whole = memoryview(mapped)
            refuse(int(bytes(whole[:_CHECK]), 16) != zlib.crc32(whole[_CHECK:]), "the file is damaged")
            end = mapped.find(b"\n", _CHECK)
            header, files, sizes = json.loads(bytes(whole[_CHECK:end]))
            same = list(files) == list(self._files) and all(map(self._same, files, files.values()))
            refuse(not same, "the files have changed")
            with contextlib.suppress(OSError):
                os.utime(path)  # it was used
            ends = itertools.accumulate(sizes, initial=end + 1)
            return CachedParts(header, [whole[first:last] for first, last in itertools.pairwise(ends)])
        except (OSError, *UNREADABLE):
            return None

    def keep(self, header: dict[str, Any], parts: Sequence[Any] = ()) -> None:
        """Keeps a result, with arrays of bytes; nothing if a file may have changed meanwhile, or without room."""
        with contextlib.suppress(OSError):
            if (path := self._path) is None:
                return
            files = {name: [*state, hash_of(name)] for name, state in self._files.items()}
            latest = time.time_ns() - 1e9 * _SETTLED
            if not all(
                state and state == _state(name) and state[-1] < latest for name, state in self._files.items()
            ):
                return
            head = json.dumps([header, files, [len(part) for part in parts]]).encode() + b"\n"
            check = 0
            for content in (head, *parts):
                check = zlib.crc32(content, check)
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with new_part(path) as part:
                part.chmod(0o600)
                with part.open("wb") as file:
                    file.writelines((b"%08x\n" % check, head, *parts))
                part.replace(path)
            _make_room(path.parent)

    def _same(self, name: str, known: Sequence[Any]) -> bool:
        return (os.name == "posix" and list(self._files[name]) == known[:-1]) or hash_of(name) == known[-1]


def _folder() -> Path | None:
    chosen = os.environ.get(FOLDER)
    if chosen is not None:
        return Path(chosen) if chosen else None
    with contextlib.suppress(RuntimeError):  # no home
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "burrlab"
    return None


def _is_own(state: os.stat_result) -> bool:
    return os.name != "posix" or state.st_uid == os.geteuid()


def _is_private(folder: Path) -> bool:
    """Whether a folder is still to be made, or is open to this user alone; otherwise the log says so, once."""
    with contextlib.suppress(FileNotFoundError):
        state = folder.stat()
        if not _is_own(state) or (os.name == "posix" and state.st_mode & 0o077):
            _say_open(folder)
            return False
    return True


@functools.cache
def _say_open(folder: Path) -> None:
    LOG.warning("nothing is kept: %s must be your own folder, closed to others (chmod 700)", folder)


def _state(name: str) -> tuple[int, ...]:
    """What differs after a file was written to, even if its size and time were set back; empty without a file.

    Outside POSIX the last number is the time at which the file was made.
    """
    with contextlib.suppress(OSError):
        status = os.stat(name)
        return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
    return ()


def _make_room(folder: Path) -> None:
    """Removes what was not used for longest, also what a killed process left half-written."""
    files = [(path, path.stat()) for path in folder.glob("*.kept*")]
    left = sum(state.st_size for _, state in files)
    for path, state in sorted(files, key=lambda file: file[1].st_mtime):
        if left > MOST:
            path.unlink(missing_ok=True)
            left -= state.st_size
