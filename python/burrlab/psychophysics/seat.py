"""The subject's seat, which shows texts and asks questions; its terminal; and the experimenter's view."""

import contextlib
import os
import re
import select
import shutil
import stat
import sys
import textwrap
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TextIO

from burrlab.common.check import refuse
from burrlab.psychophysics.designs import Interval, TaskDesign, Trial
from burrlab.psychophysics.interval import Rendered
from burrlab.psychophysics.rules import KEYS


class Seat(ABC):
    """Base class of the subject's display and keys. A seat learns no material, no pair type and no score.

    Attributes
    ----------
    wall_clock : bool
        Whether intervals run in real time; otherwise they run as fast as possible.
    simulated : bool
        Whether the subject is simulated.
    keys : str
        Keys of the answers, in their order; a run sets those of its protocol.
    """

    wall_clock: bool = True
    simulated: bool = False
    keys: str = KEYS

    def stand_in(self, interval: Interval) -> Interval:
        """The interval to render; a simulated subject's seat replaces a real specimen."""
        return interval

    def progress(self, text: str) -> None:
        """Sets the line that stays on the screen."""

    def ready(self, text: str) -> None:
        """Shows the text until the subject wants to go on."""

    def show(self, text: str) -> None:
        """Shows the text until something else is shown."""

    def begins(self, text: str) -> None:
        """Shows the text as an interval begins."""

    def ends(self, text: str, pause: float) -> None:
        """Shows the text as the interval ends, and waits for the pause [s]."""

    def done(self) -> bool:
        """Whether the subject has ended the interval."""
        return False

    @abstractmethod
    def ask(
        self, design: TaskDesign, trial: Trial, rendered: Sequence[Rendered | None]
    ) -> tuple[str, float | None]:
        """(one of the design's answers, response time from the question [s] or None without a key)."""

    def tell(self, text: str) -> None:
        """Shows a sentence for a moment."""

    def rest(self, text: str, seconds: float) -> None:
        """Rests for at least this time [s], and until the subject wants to go on."""

    def close(self, text: str) -> None:
        """Shows the last text."""


SPACE = " "

_LOOK = 0.25  # the longest wait before signals are checked [s]
_CLOSED = "the subject's terminal was closed"
_MOMENT = 1.5  # how long a sentence stays [s]
# Keys such as Home, Delete or F5 send digits and letters after an escape. These are not answers.
_ESCAPED = re.compile(rb"\x1b(?:[\[O][0-9;?]*[ -/]*[@-~]|.)?", re.DOTALL)
# An unfinished sequence: a slow line sends it in parts. A person who presses Escape and then a digit takes
# longer.
_BEGUN = re.compile(rb"\x1b(?:[\[O][0-9;?]*[ -/]*)?\Z")
_PART = 0.1  # the longest wait for the next part [s]


class Keyboard:
    """A context that reads keys of a terminal one by one, without echo. Ctrl-C still interrupts.

    Parameters
    ----------
    stream : text stream, optional
        A terminal; by default standard input.

    Raises
    ------
    ValueError
        If the stream is not a terminal, or the system has no terminals.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        try:
            import termios
        except ImportError:
            raise ValueError("answers are read from a terminal, which this system does not have") from None
        stream = sys.stdin if stream is None else stream
        try:
            self._file = stream.fileno()
            self._before = termios.tcgetattr(self._file)
        except (OSError, ValueError, AttributeError, termios.error):
            raise ValueError("answers are read from a terminal: standard input is a pipe or a file") from None
        self._termios = termios

    def __enter__(self) -> "Keyboard":
        keys = self._termios
        mode = keys.tcgetattr(self._file)
        mode[3] &= ~(keys.ICANON | keys.ECHO)
        mode[6][keys.VMIN], mode[6][keys.VTIME] = 1, 0
        # Keys that stop or dump the program are off: a slip would leave an interval running.
        for name in ("VSUSP", "VQUIT", "VSTOP"):
            mode[6][getattr(keys, name)] = b"\0"
        keys.tcsetattr(self._file, keys.TCSADRAIN, mode)
        return self

    def __exit__(self, *error: object) -> None:
        # Without draining: a terminal that nobody reads must not hold up the program. A closed one has no
        # settings.
        with contextlib.suppress(self._termios.error):
            self._termios.tcsetattr(self._file, self._termios.TCSANOW, self._before)

    def flush(self) -> None:
        """Forgets the keys pressed so far.

        Raises
        ------
        KeyboardInterrupt
            If the terminal was closed.
        """
        try:
            self._termios.tcflush(self._file, self._termios.TCIFLUSH)
        except self._termios.error:
            raise KeyboardInterrupt(_CLOSED) from None

    def _read(self) -> bytes:
        try:
            typed = os.read(self._file, 1024)
        except OSError:
            typed = b""
        refuse(not typed, _CLOSED, KeyboardInterrupt)
        return typed

    def pressed(self, keys: str, seconds: float | None = None) -> str | None:
        """The first of these keys that is pressed; None if none is pressed within the time [s].

        Raises
        ------
        KeyboardInterrupt
            If the terminal was closed.
        """
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            left = _LOOK if end is None else max(0.0, min(_LOOK, end - time.monotonic()))
            if select.select([self._file], [], [], left)[0]:
                typed = self._read()
                while _BEGUN.search(typed) and select.select([self._file], [], [], _PART)[0]:
                    typed += self._read()
                for key in _ESCAPED.sub(b"", _BEGUN.sub(b"", typed)).decode(errors="ignore"):
                    if key in keys:
                        return key
            if end is not None and time.monotonic() >= end:
                return None


class TerminalSeat(Seat):
    """The seat of a person at a terminal: a context that restores the terminal's settings when it is left.

    Parameters
    ----------
    keyboard : Keyboard, optional
        By default, of standard input.
    screen : text stream, optional
        By default standard output, which must be a terminal.

    Raises
    ------
    ValueError
        If standard input or output is not a terminal.
    """

    def __init__(self, keyboard: Keyboard | None = None, screen: TextIO | None = None) -> None:
        self._keyboard = Keyboard() if keyboard is None else keyboard
        self._screen = sys.stdout if screen is None else screen
        refuse(
            screen is None and not self._screen.isatty(),
            "the subject needs a screen: standard output is a pipe or a file",
        )
        self._plain = os.environ.get("TERM", "") in ("", "dumb")
        self._progress = ""

    def __enter__(self) -> "TerminalSeat":
        self._keyboard.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._keyboard.__exit__(*error)

    def progress(self, text: str) -> None:
        self._progress = text

    def ready(self, text: str) -> None:
        self._wait_for_space(f"{text}\n\nPress the space bar to go on.")

    def begins(self, text: str) -> None:
        self._keyboard.flush()
        self.show(text, beep=True)

    def ends(self, text: str, pause: float) -> None:
        self.show(text, beep=True)
        time.sleep(pause)

    def done(self) -> bool:
        return self._keyboard.pressed(SPACE, 0.0) is not None

    def ask(
        self, design: TaskDesign, trial: Trial, rendered: Sequence[Rendered | None]
    ) -> tuple[str, float | None]:
        keys = dict(zip(self.keys, design.answers, strict=True))
        choices = "\n".join(f"{key}   {answer}" for key, answer in keys.items())
        self._keyboard.flush()
        self.show(f"{design.question}\n\n{choices}")
        shown_at = time.monotonic()
        key = self._keyboard.pressed(self.keys)
        assert key is not None  # the wait has no time limit
        return keys[key], time.monotonic() - shown_at

    def tell(self, text: str) -> None:
        self.show(text)
        time.sleep(_MOMENT)

    def rest(self, text: str, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            minutes, rest = divmod(int(left) + 1, 60)
            self.show(f"{text}\n\nIt goes on in {minutes}:{rest:02d} min.")
            time.sleep(min(1.0, left))
        self._wait_for_space(f"{text}\n\nPress the space bar when you are ready.", beep=seconds > 0)

    def close(self, text: str) -> None:
        self._progress = ""
        self.show(text)

    def _wait_for_space(self, text: str, *, beep: bool = False) -> None:
        self._keyboard.flush()  # forget keys pressed before the text is shown
        self.show(text, beep=beep)
        self._keyboard.pressed(SPACE)

    def show(self, text: str, *, beep: bool = False) -> None:
        """Fills the screen: the progress line above, the text bold in the middle."""
        width, height = shutil.get_terminal_size()
        room = max(20, min(60, width - 4))
        lines = [part for line in text.split("\n") for part in textwrap.wrap(line, room) or [""]]
        page = "\n".join(["", self._progress, *lines, ""])
        if not self._plain:
            left = " " * max(0, (width - max(map(len, lines))) // 2)
            above = "\n" * max(1, (height - len(lines)) // 2 - 2)
            body = "\n".join(f"{left}\x1b[1m{line}\x1b[0m" for line in lines)
            page = f"\x1b[2J\x1b[H{self._progress}\n{above}{body}\n"
        try:
            self._screen.write(page + ("\a" if beep else ""))
            self._screen.flush()
        except OSError:
            raise KeyboardInterrupt("the subject's screen was closed") from None


class Experimenter(contextlib.AbstractContextManager["Experimenter"]):
    """Lines for the experimenter, kept in a log and shown in an optional view.

    Parameters
    ----------
    log : path
        Lines are appended; its folder is made.
    view : path, optional
        A file, a fifo with a reader, or another terminal. If its reader stops, lines are lost and the run
        goes on.

    Raises
    ------
    ValueError
        If the view is the subject's own terminal, or a fifo without a reader.
    OSError
        If log or view cannot be written.
    """

    def __init__(self, log: str | os.PathLike[str], view: str | os.PathLike[str] | None = None) -> None:
        self._view = None if view is None else _open_view(Path(view))
        Path(log).parent.mkdir(parents=True, exist_ok=True)
        self._log = open(log, "a", encoding="utf-8", buffering=1)  # noqa: SIM115, closed by __exit__

    def say(self, text: str) -> None:
        """Writes a line with the time of day."""
        line = f"{datetime.now():%H:%M:%S} {' '.join(text.split())}\n"
        self._log.write(line)
        if self._view is not None:
            with contextlib.suppress(OSError):
                os.write(self._view, line.encode())

    def __exit__(self, *error: object) -> None:
        self._log.close()
        if self._view is not None:
            os.close(self._view)


def _open_view(path: Path) -> int:
    """The descriptor of a view; neither opening nor writing blocks."""
    kind = path.stat().st_mode if path.exists() else 0
    any_of_them = path.resolve() == Path("/dev/tty")  # another name of the program's terminal
    refuse(
        stat.S_ISCHR(kind)
        and any(
            any_of_them or os.path.samestat(os.fstat(stream.fileno()), path.stat())
            for stream in (sys.__stdin__, sys.__stdout__)
            if stream is not None and stream.isatty()
        ),
        f"the experimenter's view must not be the subject's terminal, {path}",
    )
    flags = os.O_WRONLY | os.O_APPEND | os.O_NONBLOCK | getattr(os, "O_NOCTTY", 0)
    try:
        return os.open(
            path, flags if stat.S_ISFIFO(kind) or stat.S_ISCHR(kind) else flags | os.O_CREAT, 0o666
        )
    except OSError:
        refuse(stat.S_ISFIFO(kind), f"the experimenter's view is a fifo that nobody reads: {path}")
        raise
