"""The run of one subject through the tasks: intervals, question, answer on disk, next trial.

The subject's seat shows texts and asks questions, the experimenter reads lines beside it.
"""

import contextlib
import itertools
import math
import os
import re
import select
import shutil
import sys
import textwrap
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, TextIO

import burrlab
from burrlab._core import Burr, Device, HandDevice, ReplayDevice, ScriptedDevice
from burrlab.common.check import amend_error, refuse
from burrlab.psychophysics.answers import AnswerFile
from burrlab.psychophysics.designs import Draws, Interval, Mode, Order, Stimulus, TaskDesign, Trial
from burrlab.psychophysics.interval import Block, Rendered, render, wait_until_lifted
from burrlab.psychophysics.observer import drilling_hand, probing_hand
from burrlab.psychophysics.protocol import Protocol
from burrlab.psychophysics.rules import KEYS
from burrlab.psychophysics.side_car import TOO_FAST, AnswerRow
from burrlab.session.exchange import open_device, parse_device


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

_SIGNAL_WAIT = 0.25  # the longest wait before signals are checked [s]
_CLOSED = "the subject's terminal was closed"
_MOMENT = 1.5  # how long a sentence stays [s]
# Keys such as Home, Delete or F5 send digits and letters after an escape. These are not answers.
_ESCAPED = re.compile(rb"\x1b(?:[\[O][0-9;?]*[ -/]*[@-~]|.)?", re.DOTALL)
# An unfinished sequence: a slow line sends it in parts. A person who presses Escape and then a digit takes
# longer.
_BEGUN = re.compile(rb"\x1b(?:[\[O][0-9;?]*[ -/]*)?\Z")
_PART = 0.1  # the longest wait for the next part [s]


class TerminalSeat(Seat):
    """The seat of a person at a terminal: a context that restores the terminal's settings when it is left.

    Keys are read one by one, without echo. Ctrl-C still interrupts.

    Parameters
    ----------
    keyboard : text stream, optional
        A terminal; by default standard input.
    screen : text stream, optional
        By default standard output, which must be a terminal.

    Raises
    ------
    ValueError
        If standard input or output is not a terminal, or the system has no terminals.
    """

    def __init__(self, keyboard: TextIO | None = None, screen: TextIO | None = None) -> None:
        try:
            import termios
        except ImportError:
            raise ValueError("answers are read from a terminal, which this system does not have") from None
        keyboard = sys.stdin if keyboard is None else keyboard
        try:
            self._file = keyboard.fileno()
            self._before = termios.tcgetattr(self._file)
        except (OSError, ValueError, AttributeError, termios.error):
            raise ValueError("answers are read from a terminal: standard input is a pipe or a file") from None
        self._termios = termios
        self._screen = sys.stdout if screen is None else screen
        refuse(
            screen is None and not self._screen.isatty(),
            "the subject needs a screen: standard output is a pipe or a file",
        )
        self._plain = os.environ.get("TERM", "") in ("", "dumb")
        self._progress = ""

    def __enter__(self) -> "TerminalSeat":
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
        with contextlib.suppress(OSError):
            if typed := os.read(self._file, 1024):
                return typed
        raise KeyboardInterrupt(_CLOSED)

    def pressed(self, keys: str, seconds: float | None = None) -> str | None:
        """The first of these keys that is pressed; None if none is pressed within the time [s].

        Raises
        ------
        KeyboardInterrupt
            If the terminal was closed.
        """
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            left = _SIGNAL_WAIT if end is None else max(0.0, min(_SIGNAL_WAIT, end - time.monotonic()))
            if select.select([self._file], [], [], left)[0]:
                typed = self._read()
                while _BEGUN.search(typed) and select.select([self._file], [], [], _PART)[0]:
                    typed += self._read()
                for key in _ESCAPED.sub(b"", _BEGUN.sub(b"", typed)).decode(errors="ignore"):
                    if key in keys:
                        return key
            if end is not None and time.monotonic() >= end:
                return None

    def progress(self, text: str) -> None:
        self._progress = text

    def ready(self, text: str) -> None:
        self._wait_for_space(f"{text}\n\nPress the space bar to go on.")

    def begins(self, text: str) -> None:
        self.flush()
        self.show(text, beep=True)

    def ends(self, text: str, pause: float) -> None:
        self.show(text, beep=True)
        time.sleep(pause)

    def done(self) -> bool:
        return self.pressed(SPACE, 0.0) is not None

    def ask(
        self, design: TaskDesign, trial: Trial, rendered: Sequence[Rendered | None]
    ) -> tuple[str, float | None]:
        keys = dict(zip(self.keys, design.answers, strict=True))
        choices = "\n".join(f"{key}   {answer}" for key, answer in keys.items())
        self.flush()
        self.show(f"{design.question}\n\n{choices}")
        shown_at = time.monotonic()
        key = self.pressed(self.keys)
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
        self.flush()  # forget keys pressed before the text is shown
        self.show(text, beep=beep)
        self.pressed(SPACE)

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
    refuse(
        path.is_char_device()
        and any(
            path.resolve() == Path("/dev/tty")  # another name of the program's terminal
            or os.path.samestat(os.fstat(stream.fileno()), path.stat())
            for stream in (sys.__stdin__, sys.__stdout__)
            if stream is not None and stream.isatty()
        ),
        f"the experimenter's view must not be the subject's terminal, {path}",
    )
    flags = os.O_WRONLY | os.O_APPEND | os.O_NONBLOCK | getattr(os, "O_NOCTTY", 0)
    try:
        return os.open(path, flags if path.is_fifo() or path.is_char_device() else flags | os.O_CREAT, 0o666)
    except OSError:
        refuse(path.is_fifo(), f"the experimenter's view is a fifo that nobody reads: {path}")
        raise


MANY_LATE = 0.01  # share of an interval's ticks above which the experimenter is told
_LOOK = 0.01  # time between two looks at the keys while a real specimen is felt [s]
_SIMULATED = (HandDevice, ScriptedDevice, ReplayDevice)
_STALLED = "the loop stalled"  # start of a session's reason after a stall
_REPEATS = 1  # most repeats of a trial
_SILENT = "no tick yet"  # start of a session's message that its device gives no position

_NAMES = {
    "same-different": ("First interval", "Second interval"),
    "2ifc": ("First interval", "Second interval"),
    "abx": ("Reference", "First after the reference", "Second after the reference"),
}
_DO = {
    "probing": "Press the burr on the material. It does not turn.",
    "drilling": "Drill into the material.",
}


class DeviceLost(RuntimeError):
    """The device was lost during an interval. The trial was not asked; resuming the run repeats it."""


class LoopStalled(DeviceLost):
    """The loop stalled in a trial that was already repeated because of a stall."""


@dataclass(frozen=True)
class _Felt:
    """An interval that was felt; `rendered` is None for a real specimen. Times are those of the run [s]."""

    rendered: Rendered | None
    ended: str
    began: float
    over: float


class Runner:
    """Takes one subject through the remaining trials of one task.

    Parameters
    ----------
    protocol : Protocol
    task : str
    order : Order
        Holds the earlier answers.
    file : AnswerFile
        Puts an answer on disk before `append` returns; its times go on.
    seat : Seat
        The subject's seat.
    experimenter : Experimenter
    device : callable
        Called with a mode before an interval; returns a new device, or the same one if it serves several
        sessions.
    live : bool
        Whether the device is in a hand; intervals then wait until the burr is lifted.
    render : callable, optional
        Replaces `burrlab.psychophysics.render`.

    Notes
    -----
    An answer goes to the file first, then to the order; the next trial follows. So a run that is killed at any
    moment loses only its current, unanswered trial.
    """

    def __init__(
        self,
        protocol: Protocol,
        task: str,
        order: Order,
        file: AnswerFile,
        seat: Seat,
        experimenter: Experimenter,
        device: Callable[[Mode], Device],
        *,
        live: bool = False,
        render: Callable[..., Rendered] = render,
    ) -> None:
        self.task, self.seat, self.experimenter = task, seat, experimenter
        self._protocol, self._design, self._order, self._file = protocol, protocol.tasks[task], order, file
        self._device = device
        seat.keys = protocol.keys
        self._time = file.end  # on a virtual clock only intervals take time [s]
        self._live, self._renderer = live, render
        self._heard: set[str] = set()  # messages of sessions that were already passed on
        self._silent = False
        self._before = len(order.answered)
        self.repeated = 0  # trials repeated because the loop stalled
        self._together = [self]

    def run(self, *others: "Runner") -> int:
        """Asks all remaining trials of the order, and returns how many were answered.

        Those of other runners of the subject are asked among them, block by block in random order, which depends on
        the seed and the number of answers.

        Raises
        ------
        DeviceLost
            If the device was lost during an interval, or the loop stalled twice in one trial (`LoopStalled`).
        KeyboardInterrupt
            If the subject or the experimenter ended the run.
        """
        runners = [self, *others]
        for runner in runners:
            runner._together = runners
        if (first := self._order.next()) is not None:
            self._welcome(first)
        while trials := [
            (runner, trial) for runner in runners if (trial := runner._order.next()) is not None
        ]:
            block = min(trial.block for _, trial in trials)  # practice is block 0
            # each as likely as it has trials left, so that all orders are equally likely
            turns = [
                pair
                for pair in sorted(trials, key=lambda pair: pair[0].task)
                for _ in range(pair[0].answered, pair[0]._order.total)
                if pair[1].block == block
            ]
            state = {
                "asked": len(self._answered),
                "files": sorted(each._file.path.name for each in runners),
            }
            runner, trial = turns[Draws(self._protocol.seed, "interleaved", state).below(len(turns))]
            runner._ask(trial)
        return sum(runner.answered - runner._before for runner in runners)

    @property
    def finished(self) -> bool:
        """Whether all trials of the task are answered."""
        return self._order.next() is None

    @property
    def answered(self) -> int:
        """Number of answered trials of the task."""
        return len(self._order.answered)

    @property
    def _answered(self) -> list[Trial]:
        """Trials that were answered, of all runners together."""
        return [trial for runner in self._together for trial, _ in runner._order.answered]

    def _ask(self, trial: Trial) -> None:
        self._rest_before(trial)
        self._announce(trial)
        felt, repeats = self._feel(trial)
        rendered = [interval.rendered for interval in felt]
        response, response_time = self.seat.ask(self._design, trial, rendered)
        row = AnswerRow.of(
            trial, onset=felt[0].began, duration=felt[-1].over - felt[0].began, response=response,
            response_time=response_time, endings=[interval.ended for interval in felt], repeats=repeats, felt=rendered,
        )  # fmt: skip
        self._file.append(row)
        self._order.answer(response, lost=row.lost)
        self._after(row)

    def _feel(self, trial: Trial, repeats: int = 0) -> tuple[list[_Felt], int]:
        """The trial's intervals, all repeated if the loop stalled in one, and the number of repeats."""
        try:
            return [self._interval(trial, number + 1) for number in range(len(trial.intervals))], repeats
        except LoopStalled:
            if repeats == _REPEATS:
                raise
        self.repeated += 1
        self.experimenter.say(f"trial {trial.number} is repeated from its first interval")
        self.seat.ready("Please lift the burr. This one is repeated, from its beginning.")
        return self._feel(trial, repeats + 1)

    def _welcome(self, first: Trial) -> None:
        answers = zip(self._protocol.keys, self._design.answers, strict=True)
        keys = " or ".join(f"{key} for {answer}" for key, answer in answers)
        # Lengths of intervals are the same in all trials.
        long = ["as long as you like" if i.duration is None else f"{i.duration:g} s" for i in first.intervals]
        count = {2: "two", 3: "three"}[len(long)]
        lengths = (
            f"Each lasts {long[0]}; a beep tells its start and its end."
            if len(set(long)) == 1
            else f"They last {', '.join(long[:-1])} and {long[-1]}; a beep tells start and end."
        )
        self.seat.progress("")
        self.seat.ready(
            f"{'You go on where you stopped. ' * bool(self._answered)}Each trial has {count} intervals. {lengths} Then you are asked: {self._design.question}\n\nAnswer with the keys: {keys}. "
            "If you are not sure, choose what seems more likely."
        )

    def _rest_before(self, trial: Trial) -> None:
        """Gives a break at the end of a block, but not at the start of a sitting."""
        last = max((answered.block for answered in self._answered), default=trial.block)
        if last == trial.block:
            return
        self.seat.progress("")
        if last == 0:  # practice
            self.seat.ready("That was practice. Now it counts.")
        elif any(runner.answered > runner._before for runner in self._together):
            self.experimenter.say(f"break of {self._protocol.rest:g} s before block {trial.block}")
            self.seat.rest("Take a break.", self._protocol.rest)

    def _announce(self, trial: Trial) -> None:
        practice = trial.phase == "practice"
        number = 1 + sum((answered.phase == "practice") == practice for answered in self._answered)
        lengths = [(runner._design.practice, runner._order.total) for runner in self._together]
        total = sum(practised if practice else all_of_it - practised for practised, all_of_it in lengths)
        place = "practice" if practice else f"block {trial.block}"
        self.seat.progress(f"Trial {number} of {total}, {place}")
        level = "" if trial.level is None else f", level {trial.level:g}"
        stimuli = ", ".join(f"{i.stimulus.name} ({_constants(i)})" for i in trial.intervals)
        self.experimenter.say(
            f"trial {trial.number} ({place}{', catch' * (trial.phase == 'catch')}), {trial.trial_type}{level}: {stimuli}; "
            f"right is {trial.correct}"
        )

    def _interval(self, trial: Trial, number: int) -> _Felt:
        interval, name = trial.intervals[number - 1], _NAMES[self._design.task][number - 1]
        real = interval.stimulus.material is None
        self.seat.ready(
            f"Next: {name.lower()}.\n\n"
            + ("Take the real specimen." if real else "Lift the burr clear of the material.")
        )
        if self._live and not real:
            self._lift(trial)
        to_end = "\n\nPress the space bar when you have felt enough." if interval.duration is None else ""
        self.seat.begins(f"{name}.\n\n{_DO[self._design.mode]}{to_end}")
        began, rendered = self._now(), None
        if real and not self.seat.simulated:
            ended = self._real(interval)
        else:
            rendered = self._render(trial, number)
            self._time += rendered.duration
            ended = rendered.ended
        felt = _Felt(rendered, ended, began, self._now())
        self.seat.ends(f"Stop: end of the {name.lower()}.\n\nLift the burr.", self._protocol.pause)
        if ended in ("break-through", "wall"):
            self.experimenter.say(
                f"{name.lower()} of trial {trial.number} ended by {ended} after {felt.over - began:.2f} s"
            )
        return felt

    def _now(self) -> float:
        return self._file.elapsed() if self.seat.wall_clock else self._time

    def _real(self, interval: Interval) -> str:
        end = math.inf if interval.duration is None else time.monotonic() + interval.duration
        while not self.seat.done():
            if time.monotonic() >= end:
                return "time"
            time.sleep(_LOOK)
        return "subject"

    def _render(self, trial: Trial, number: int) -> Rendered:
        """An interval on fresh bone and a new device; DeviceLost if the device fails before its end."""
        interval = self.seat.stand_in(trial.intervals[number - 1])
        self._silent = False
        rendered = self._renderer(
            interval,
            self._device(self._design.mode),
            burr=self._protocol.burr,
            bone=self._protocol.bone,
            mode=self._design.mode,
            wall_clock=self.seat.wall_clock,
            limits=None if self._protocol.limits == "none" else self._protocol.limits,
            record=self._trace(trial, number) if self._protocol.trace else None,
            publish=None if self.seat.simulated else self._protocol.publish,
            on_message=self._hear,
            stop=lambda: self._silent or (interval.duration is None and self.seat.done()),
        )
        if rendered.failed or self._silent:
            raise self._lost(trial, "during an interval", rendered.reason)
        self._tell_of(rendered, number, trial)
        return rendered

    def _trace(self, trial: Trial, number: int) -> Path:
        """The path of a new trace; a repeated interval gets another name than its first attempt."""
        car = self._file.side_car
        first = self._protocol.data.trace(car.subject, car.name, trial.phase, trial.number, number)
        first.parent.mkdir(parents=True, exist_ok=True)
        again = (
            first.with_name(first.name.replace("_trace", f"_attempt-{attempt}_trace"))
            for attempt in itertools.count(2)
        )
        return next(path for path in itertools.chain([first], again) if not path.exists())

    def _tell_of(self, rendered: Rendered, number: int, trial: Trial) -> None:
        """Tells the experimenter of a first tick in contact and of many late ticks."""
        ticks, which = rendered.ticks, f"interval {number} of trial {trial.number}"
        if self._live and len(ticks) and ticks["touching"][0]:
            self.experimenter.say(f"{which} began in contact, at {math.hypot(*ticks['force'][0]):.2f} N")
        late = int((ticks["periods"] > 1).sum())
        if late > MANY_LATE * len(ticks):
            self.experimenter.say(f"{which} had {late} late ticks of {len(ticks)}")

    def _lift(self, trial: Trial) -> None:
        """Waits until the burr is off the material; DeviceLost if the device fails before."""

        def ask() -> None:
            self.seat.show("Lift the burr clear of the material.\n\nThe interval begins by itself then.")
            self.experimenter.say(f"trial {trial.number} waits until the burr is lifted")

        self._silent = False
        device = self._device(self._design.mode)
        if isinstance(device, _SIMULATED):
            return  # it begins each interval anew, at its start position
        lifted, reason = wait_until_lifted(
            device, self._protocol.burr, on_wait=ask, stop=lambda: self._silent, on_message=self._hear
        )
        if not lifted:
            raise self._lost(trial, "before an interval", reason)

    def _lost(self, trial: Trial, when: str, reason: str) -> DeviceLost:
        if reason.startswith(_STALLED) and not self._silent:
            self.experimenter.say(f"trial {trial.number} was broken off {when}: {reason}")
            return LoopStalled(f"{reason}, {when} of trial {trial.number}")
        reason = "it gives no position" if self._silent else reason
        self.experimenter.say(f"trial {trial.number} was not asked: device lost: {reason}")
        return DeviceLost(f"the device was lost {when}: {reason}")

    def _hear(self, text: str) -> None:
        """Passes each message of a session on to the experimenter, once."""
        self._silent = self._silent or text.startswith(_SILENT)
        if text not in self._heard:
            self._heard.add(text)
            self.experimenter.say(text)

    def _after(self, row: AnswerRow) -> None:
        main = [response == trial.correct for trial, response in self._order.counted()]
        fast = row.response_time is not None and row.response_time < TOO_FAST
        duration = "" if row.response_time is None else f" in {row.response_time:.2f} s"
        self.experimenter.say(
            f"trial {row.trial} ended by {', '.join(map(str, row.endings))}; answered {row.response}{duration}"
            f"{', too fast to have judged' * fast}, {'right' if row.correct else 'wrong'}; {sum(main)} of {len(main)} "
            f"right{'; it does not count, as the burr did not come to the boundary' * row.lost}"
        )
        if self._protocol.feedback and row.phase == "practice":
            self.seat.tell("Not deep enough." if row.lost else "Right." if row.correct else "Not right.")


def _constants(interval: Interval) -> str:
    """What an interval renders, for the experimenter."""
    if (material := interval.stimulus.material) is None:
        return "real"
    text, boundary = f"c_e {material.c_e:g} N/mm^2, alpha {material.alpha:g} /ms", interval.boundary
    if boundary is not None:
        text += f"; c_e {boundary.below.c_e:g}, alpha {boundary.below.alpha:g} below {boundary.depth:g} mm"
    return text


_NO_FORCE = "[experiment] publish says no port: no force goes back over the network but to a Stylus of PLUS"


class Sitting:
    """The remaining trials of one subject.

    Parameters
    ----------
    protocol : Protocol
    subject : str
    tasks : sequence of str, optional
        By default all, in the subject's own order.
    device : str, Device or callable, optional
        hand, scripted:FILE, igtl:HOST:PORT, touch[:NAME], omega[:N], haply[:HOST:PORT] or
        vrpn:NAME@[tcp://]HOST[:PORT], by default the protocol's. Or your own device that serves one interval after the other, such as a `MailboxDevice`
        (examples/experiment_driver.py). Or a function that returns a device for a mode ("probing" or
        "drilling"), called twice per interval: for the wait until the burr is lifted, and for the interval.
        The side-car calls the last two "driver".
    simulated : mapping, optional
        Description of a simulated subject, for the side-car.
    once : bool
        Whether each material is rendered only once per task, whatever the seeds; a faster simulation.
    view : path, optional
        Also shows the experimenter's lines (`Experimenter`).
    again : str
        Command that resumes the run, told to the experimenter.

    Raises
    ------
    ValueError
        If the protocol has no such subject or task, or the device's text is wrong.
    OSError
        If the device's script cannot be read.
    """

    def __init__(
        self,
        protocol: Protocol,
        subject: str,
        *,
        tasks: Sequence[str] | None = None,
        device: str | Device | Callable[[Mode], Device] | None = None,
        simulated: Mapping[str, Any] | None = None,
        once: bool = False,
        view: str | Path | None = None,
        again: str = "",
    ) -> None:
        self.protocol, self.subject = protocol, subject
        asked = protocol.tasks_of(subject) if tasks is None else tuple(tasks)
        for task in asked:
            protocol.order(subject, task)
        # interleaved references are asked together
        planned = dict.fromkeys(
            task for one in asked for unit in protocol.units if one in unit for task in unit
        )
        # Added subjects or tasks change a subject's order, so tasks that were begun come first.
        self.tasks = tuple(sorted(planned, key=lambda task: not self._file(task).exists()))
        self._text = "driver"  # a side-car's name of a device from the caller
        if isinstance(device, Device) or callable(device):
            self._device: Callable[[Mode], Device] = device if callable(device) else lambda mode: device
        else:
            self._text = device or protocol.device
            self._device = device_maker(self._text, protocol)
        self._live = self._text.partition(":")[0] not in ("hand", "scripted")
        self._simulated, self._once, self._view, self._again = simulated, once, view, again
        self._tried = False

    @property
    def begun(self) -> tuple[str, ...]:
        """Tasks that have a file of answers."""
        return tuple(task for task in self.tasks if self._file(task).exists())

    def run(self, seat: Callable[[str], Seat]) -> int:
        """Begins or resumes all tasks of the subject, and returns the number of answers given.

        Parameters
        ----------
        seat : callable
            Returns the seat for a task.

        Raises
        ------
        DeviceLost, KeyboardInterrupt
            As for `Runner.run`; all answers are on disk.
        BlockingIOError, FileNotFoundError, ValueError, OSError
            As for `Protocol.begin` and `Protocol.resume`.
        """
        answer_count, units = 0, self.protocol.units
        for unit in dict.fromkeys(next(unit for unit in units if task in unit) for task in self.tasks):
            answer_count += self._run_tasks(unit, seat, rest=answer_count > 0)
        return answer_count

    def _run_tasks(self, tasks: Sequence[str], seat: Callable[[str], Seat], *, rest: bool) -> int:
        """Runs one task, or several together."""
        with contextlib.ExitStack() as stack:
            entered = [self._enter(stack, task, seat(task)) for task in tasks]
            runners = [runner for runner in entered if not runner.finished]
            if not runners:
                return 0
            first, *others = *runners, *(runner for runner in entered if runner.finished)
            if not (self._tried or first.seat.simulated):
                self._tried = True
                first.experimenter.say(try_loop(self.protocol.burr, self.protocol.bone))
            if rest:
                first.seat.progress("")
                first.seat.rest("That was one task. Take a break.", self.protocol.rest)
            try:
                answer_count = first.run(*others)
            except BaseException as error:
                for runner in runners:
                    runner.experimenter.say(
                        f"ended early, {type(error).__name__}: {runner.answered} trials are answered"
                        + (f"; {self._again} goes on" if self._again else "")
                    )
                raise
            finally:
                for runner in runners:
                    if runner.repeated:
                        runner.experimenter.say(f"trials repeated as the loop had stalled: {runner.repeated}")
            for runner in runners:
                runner.experimenter.say(f"task {runner.task} is over, {runner.answered} trials were answered")
            return answer_count

    def _enter(self, stack: contextlib.ExitStack, task: str, seat: Seat) -> Runner:
        """The runner of a task, whose file and log the stack closes."""
        enter = self.protocol.resume if self._file(task).exists() else self.protocol.begin
        file, order = enter(self.subject, task, device=self._text, simulated=self._simulated)
        stack.enter_context(file)
        experimenter = stack.enter_context(
            Experimenter(self.protocol.data.log(self.subject, task), self._view)
        )
        runner = Runner(
            self.protocol, task, order, file, seat, experimenter, self._device, live=self._live,
            render=_rendered_once(order, seat.stand_in) if self._once else render,
        )  # fmt: skip
        if runner.finished:
            return runner
        done = f", {len(order.answered)} trials were answered before" if order.answered else ""
        experimenter.say(
            f"{datetime.now():%Y-%m-%d}: {'simulated ' * seat.simulated}subject {self.subject}, task {task}, "
            f"at most {order.total} trials{done}"
        )
        forceless = self._text.startswith(("igtl:", "vrpn:")) and self.protocol.publish is None
        for note in (_NO_FORCE,) * forceless + file.notes:
            experimenter.say(note)
        return runner

    def _file(self, task: str) -> Path:
        return self.protocol.data.answers(self.subject, task)


def try_loop(burr: Burr, bone: Block) -> str:
    """A sentence on late ticks while a simulated hand drills for a second on this machine."""
    interval = Interval(Stimulus("trial run", burrlab.materials["bone"]), 0, 1.0)
    felt = render(interval, drilling_hand(burr), burr=burr, bone=bone, mode="drilling")
    late = int((felt.ticks["periods"] > 1).sum())
    text = f"before the first trial {late} of {len(felt.ticks)} ticks were late{', and the loop stalled' * felt.failed}"
    if felt.failed or late > MANY_LATE * len(felt.ticks):
        return f"THE MACHINE HAS TOO MUCH TO DO: {text}; at most {100 * MANY_LATE:g} % should be"
    return text


def device_maker(text: str, protocol: Protocol) -> Callable[[Mode], Device]:
    """A function that makes a device for a mode.

    Raises
    ------
    ValueError
        If the text or the script is wrong, or the device cannot be opened.
    OSError
        If the script cannot be read.
    """
    with amend_error("device "):
        device = parse_device(text)
    if device.kind == "hand":
        return lambda mode: (probing_hand if mode == "probing" else drilling_hand)(protocol.burr)
    if device.kind in ("igtl", "vrpn"):  # each interval has its own connection
        return lambda mode: open_device(device, protocol.lost_after)
    opened = (
        burrlab.read_script(device.file)
        if device.kind == "scripted"
        else open_device(device, protocol.lost_after)
    )
    return lambda mode: opened


def _rendered_once(order: Order, stand_in: Callable[[Interval], Interval]) -> Callable[..., Rendered]:
    """A `render` that renders each material once and then returns the same result again.

    After a resumption it takes the seed of the interval that was first in the whole run.
    """
    rendered: dict[Interval, Rendered] = {}

    def once(interval: Interval, device: Device, **options: Any) -> Rendered:
        key = replace(interval, seed=0)
        if key not in rendered:
            before = (stand_in(x) for trial, _ in order.answered for x in trial.intervals)
            first = next((x for x in before if replace(x, seed=0) == key), interval)
            rendered[key] = render(first, device, **options)
        return rendered[key]

    return once
