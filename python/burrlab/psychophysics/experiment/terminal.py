"""The subject's screen and keys in a terminal."""

from __future__ import annotations

import contextlib
import os
import re
import select
import shutil
import sys
import textwrap
import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

from burrlab.psychophysics.design import Design
from burrlab.psychophysics.experiment.seat import Seat
from burrlab.psychophysics.trial import Trial

if TYPE_CHECKING:
    from burrlab.psychophysics.experiment.interval import Rendered

SPACE = " "

_LOOK = 0.25  # the longest wait without a look for a signal [s]
_CLOSED = "the subject's terminal was closed"
_MOMENT = 1.5  # that a sentence stays [s]
# Keys such as Home, Delete or F5 send digits after an escape: they are no answers.
_ESCAPED = re.compile(rb"\x1b(?:[\[O][0-9;?]*[ -/]*[@-~]|.)?", re.DOTALL)
# The same, not yet at its end: a slow line hands it over in parts. Who presses Escape and then a digit is slower.
_BEGUN = re.compile(rb"\x1b(?:[\[O][0-9;?]*[ -/]*)?\Z")
_PART = 0.1  # the longest wait for the next part [s]


class Keyboard:
    """Keys of a terminal, one by one and without an echo, while it is entered; Ctrl-C stays an interrupt.

    Parameters
    ----------
    stream : text stream, optional
        A terminal; by default standard input.

    Raises
    ------
    ValueError
        If the stream is no terminal, or the system has none.
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

    def __enter__(self) -> Keyboard:
        keys = self._termios
        mode = keys.tcgetattr(self._file)
        mode[3] &= ~(keys.ICANON | keys.ECHO)
        mode[6][keys.VMIN], mode[6][keys.VTIME] = 1, 0
        # A subject who stops or dumps the program by a slip would leave an interval behind that nobody ends.
        for name in ("VSUSP", "VQUIT", "VSTOP"):
            mode[6][getattr(keys, name)] = b"\0"
        keys.tcsetattr(self._file, keys.TCSADRAIN, mode)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # Not drained: a terminal that is not read any more must not keep the program. One that is gone has no settings.
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
        if not typed:
            raise KeyboardInterrupt(_CLOSED)
        return typed

    def pressed(self, keys: str, seconds: float | None = None) -> str | None:
        """The first of these keys that is pressed, at most after so long [s]; None if there is none.

        Raises
        ------
        KeyboardInterrupt
            If the terminal was closed: nobody is there any more.
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
    """A person at a terminal. To be entered: its settings are restored when it is left, whatever happens.

    Parameters
    ----------
    keyboard : Keyboard, optional
        By default of standard input.
    screen : text stream, optional
        By default standard output, which must be a terminal.

    Raises
    ------
    ValueError
        If standard input or output is no terminal.
    """

    def __init__(self, keyboard: Keyboard | None = None, screen: TextIO | None = None) -> None:
        self._keyboard = Keyboard() if keyboard is None else keyboard
        self._screen = sys.stdout if screen is None else screen
        if screen is None and not self._screen.isatty():
            raise ValueError("the subject needs a screen: standard output is a pipe or a file")
        self._plain = os.environ.get("TERM", "") in ("", "dumb")
        self._progress = ""

    def __enter__(self) -> TerminalSeat:
        self._keyboard.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._keyboard.__exit__(kind, error, trace)

    def progress(self, text: str) -> None:
        self._progress = text

    def ready(self, text: str) -> None:
        self._wait_for_space(f"{text}\n\nPress the space bar to go on.")

    def show(self, text: str) -> None:
        self._page(text)

    def begins(self, text: str) -> None:
        self._keyboard.flush()
        self._page(text, beep=True)

    def ends(self, text: str, pause: float) -> None:
        self._page(text, beep=True)
        time.sleep(pause)

    def done(self) -> bool:
        return self._keyboard.pressed(SPACE, 0.0) is not None

    def ask(
        self, design: Design, trial: Trial, rendered: Sequence[Rendered | None]
    ) -> tuple[str, float | None]:
        keys = {str(number): answer for number, answer in enumerate(design.answers, start=1)}
        choices = "\n".join(f"{key}   {answer}" for key, answer in keys.items())
        self._keyboard.flush()
        self._page(f"{design.question}\n\n{choices}")
        shown = time.monotonic()
        key = self._keyboard.pressed("".join(keys))
        assert key is not None  # it waits without an end
        return keys[key], time.monotonic() - shown

    def tell(self, text: str) -> None:
        self._page(text)
        time.sleep(_MOMENT)

    def rest(self, text: str, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            minutes, rest = divmod(int(left) + 1, 60)
            self._page(f"{text}\n\nIt goes on in {minutes}:{rest:02d} min.")
            time.sleep(min(1.0, left))
        self._wait_for_space(f"{text}\n\nPress the space bar when you are ready.", beep=seconds > 0)

    def close(self, text: str) -> None:
        self._progress = ""
        self._page(text)

    def _wait_for_space(self, text: str, *, beep: bool = False) -> None:
        self._keyboard.flush()  # what was pressed before the text could be read
        self._page(text, beep=beep)
        self._keyboard.pressed(SPACE)

    def _page(self, text: str, *, beep: bool = False) -> None:
        """The whole screen: the progress line, and the text in the middle, bold."""
        width, height = shutil.get_terminal_size()
        room = max(20, min(60, width - 4))
        lines = [part for line in text.split("\n") for part in textwrap.wrap(line, room) or [""]]
        if self._plain:
            page = "\n".join(["", self._progress, *lines, ""])
        else:
            left = " " * max(0, (width - max(len(line) for line in lines)) // 2)
            above = "\n" * max(1, (height - len(lines)) // 2 - 2)
            body = "\n".join(f"{left}\x1b[1m{line}\x1b[0m" for line in lines)
            page = f"\x1b[2J\x1b[H{self._progress}\n{above}{body}\n"
        try:
            self._screen.write(page + ("\a" if beep else ""))
            self._screen.flush()
        except OSError:
            raise KeyboardInterrupt("the subject's screen was closed") from None
