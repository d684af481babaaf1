"""What the experimenter sees of a run, and the subject does not."""

from __future__ import annotations

import contextlib
import os
import stat
import sys
from datetime import datetime
from pathlib import Path


class Experimenter:
    """Lines for the experimenter: kept in a log, and shown elsewhere too if asked for.

    Parameters
    ----------
    log : path
        Appended to; its folder is made.
    view : path, optional
        A file, a fifo that is being read, or another terminal. One that is not read any more loses lines, the run goes on.

    Raises
    ------
    ValueError
        If the view is the subject's own terminal, or a fifo that nobody reads.
    OSError
        If one of them cannot be written.
    """

    def __init__(self, log: str | os.PathLike[str], view: str | os.PathLike[str] | None = None) -> None:
        self._view = None if view is None else _open_view(Path(view))
        Path(log).parent.mkdir(parents=True, exist_ok=True)
        self._log = open(log, "a", encoding="utf-8")  # noqa: SIM115, closed by close

    def say(self, text: str) -> None:
        """A line, with the time of day."""
        line = f"{datetime.now():%H:%M:%S} {' '.join(text.split())}\n"
        self._log.write(line)
        self._log.flush()
        if self._view is not None:
            with contextlib.suppress(OSError):
                os.write(self._view, line.encode())

    def __enter__(self) -> Experimenter:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        self._log.close()
        if self._view is not None:
            os.close(self._view)
            self._view = None


def _open_view(path: Path) -> int:
    """Never blocks: neither here nor when nobody reads."""
    kind = path.stat().st_mode if path.exists() else 0
    if stat.S_ISCHR(kind) and _is_own_terminal(path):
        raise ValueError(f"the experimenter's view must not be the subject's terminal, {path}")
    flags = os.O_WRONLY | os.O_APPEND | os.O_NONBLOCK | getattr(os, "O_NOCTTY", 0)
    if not stat.S_ISFIFO(kind) and not stat.S_ISCHR(kind):
        flags |= os.O_CREAT
    try:
        return os.open(path, flags, 0o666)
    except OSError:
        if stat.S_ISFIFO(kind):
            raise ValueError(f"the experimenter's view is a fifo that nobody reads: {path}") from None
        raise


def _is_own_terminal(path: Path) -> bool:
    own = [stream for stream in (sys.__stdin__, sys.__stdout__) if stream is not None and stream.isatty()]
    if path.resolve() == Path("/dev/tty"):  # another name of the terminal that a program has
        return bool(own)
    return any(os.path.samestat(os.fstat(stream.fileno()), path.stat()) for stream in own)
