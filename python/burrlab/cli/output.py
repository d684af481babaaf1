"""What a command writes: results, figures, a line on a terminal; and how its work is ended."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from burrlab.cli.options import Options
from burrlab.files import NO_ROOM, kept_elsewhere

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FIGURES = ("plot", "region", "profile", "pictures")
_KEPT = ("out", "save")  # may take the place of what was read: they look after it themselves
_FILES = ("json", *_FIGURES, "out", "record", "save", "template", "tsv", "png", "video")


def save_figure(axes: Axes, path: str) -> None:
    """Writes the figure of some axes."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    _write(path, f"figure{Path(path).suffix}", lambda place: figure.savefig(place, dpi=200), "the figure")


class NotKept(OSError):
    """The work is done, and what it was to keep is not whole where it was asked for."""


def not_kept(path: str, name: str, error: Exception, write: Callable[[str], object], what: str) -> NotKept:
    """After an error of writing: keeps it elsewhere, if that can be, and says so."""
    number, why = (error.errno, error.strerror) if isinstance(error, OSError) else (None, None)
    place = kept_elsewhere(path, name, write)
    return NotKept(number, f"{why or error}{f'; {what} is kept as {place}' if place else ''}", path)


def _write(path: str, name: str, write: Callable[[str], object], what: str) -> None:
    try:
        write(path)
    except OSError as error:
        if error.errno in NO_ROOM and os.path.isfile(path) and not os.path.islink(path):
            os.unlink(path)  # torn
        raise not_kept(path, name, error, write, what) from error


def check_outputs(options: Options) -> None:
    """ValueError before any work if a result could not be written."""
    taken: dict[Path, str] = {}
    for name in _FILES:
        path = getattr(options, name, None)
        if path is None or (path == "-" and name not in _FIGURES):  # standard output, which takes text
            continue
        folder = Path(path).resolve().parent
        if (
            not folder.is_dir()
            or not os.access(folder, os.W_OK)
            or (
                Path(path).is_dir() and name != "save"  # slices are saved as a folder
            )
        ):
            raise ValueError(f"--{name}: {path} cannot be written")
        if name == "record" and Path(path).exists():  # a trace is never replaced
            raise ValueError(f"--record must be a new file, {path} exists")
        if (other := taken.setdefault(Path(path).resolve(), name)) != name:
            raise ValueError(f"--{name} must be another file than --{other}, got {path}")
        if name not in _KEPT and Path(path).resolve() in _read_files(options):
            raise ValueError(f"--{name}: {path} is read, and would be lost")
        if name in _FIGURES:
            from matplotlib.figure import Figure

            kinds = Figure().canvas.get_supported_filetypes()
            if Path(path).suffix[1:].lower() not in kinds:
                raise ValueError(f"--{name}: {path} must end in one of {', '.join(sorted(kinds))}")


def _read_files(options: Options) -> set[Path]:
    """What the other options name, if there is such a file."""
    # an experiment looks after its own files
    named = [value for name, value in vars(options).items() if name not in (*_FILES, "config")]
    texts = [text for value in named for text in (value if isinstance(value, list) else [value])]
    return {Path(text).resolve() for text in texts if isinstance(text, str) and os.path.isfile(text)}


def deliver(options: Options, result: dict[str, Any], text: str) -> None:
    """A result as JSON, where that is asked for, and as text, which is there where the file cannot be written."""
    if options.json == "-":
        print(json.dumps(result, allow_nan=False))
        return
    print(text)
    if options.json is not None:
        text = json.dumps(result, allow_nan=False, indent=1) + "\n"
        _write(options.json, "result.json", lambda place: Path(place).write_text(text), "the result")


def sentence(error: Exception) -> str:
    """What an error says, in one line."""
    if isinstance(error, OSError) and error.strerror is not None:  # without the number of the error
        return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def say(text: str) -> None:
    """A message to standard error."""
    show_line("")
    print(f"burrlab: {text}", file=sys.stderr, flush=True)


def show_line(line: str) -> None:
    """A line that the next one replaces, on a terminal."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """SIGTERM and a closed terminal end what runs as Ctrl-C does: the force zero, the trace whole."""
    names = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        names = []  # only the main thread may
    before = {name: signal.signal(name, signal.default_int_handler) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
