"""A subject's tasks in a row, each with its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import burrlab
from burrlab._core import Burr, Device
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.experiment.clock import Clock, VirtualClock, WallClock
from burrlab.psychophysics.experiment.experimenter import Experimenter
from burrlab.psychophysics.experiment.interval import Rendered, render
from burrlab.psychophysics.experiment.protocol import Protocol
from burrlab.psychophysics.experiment.runner import MANY_LATE, Rig, Runner
from burrlab.psychophysics.experiment.seat import Seat
from burrlab.psychophysics.simulation.hands import drilling_hand, probing_hand
from burrlab.psychophysics.trial import Interval, Mode, Stimulus, Trial
from burrlab.session.device_text import parse_device

_DRIVER = "driver"  # what a side-car says of a device of one's own
_NO_FORCE = "no force goes back over the network: [experiment] publish says no port"


class Sitting:
    """One subject, from the first trial that is left to the last.

    Parameters
    ----------
    protocol : Protocol
    subject : str
    tasks : sequence of str, optional
        By default all, in the subject's own order.
    device : str, Device or callable, optional
        hand, scripted:FILE or igtl:HOST:PORT, by default the protocol's; or a device of one's own that serves
        one interval after the other, such as a `MailboxDevice` (examples/experiment_driver.py), or what gives one for an
        interval of a mode ("probing" or "drilling"), asked twice: until the burr is lifted, and to be felt. Both are
        "driver" in the side-car.
    simulated : mapping, optional
        What simulates the subject, for the side-car.
    once : bool
        Each material is rendered once a task, whatever the seeds: for a simulated subject in a hurry.
    view : path, optional
        Where the experimenter's lines are shown too (`Experimenter`).
    again : str
        How the run goes on when it was ended early, for the experimenter.

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
        due = protocol.tasks_of(subject) if tasks is None else tuple(tasks)
        for task in due:
            protocol.order(subject, task)
        # Subjects or tasks that were added move a subject's order: what was begun is gone on with first.
        self.tasks = tuple(sorted(due, key=lambda task: not self._file(task).exists()))
        self._text = _DRIVER
        if isinstance(device, Device):
            self._device = _always(device)
        elif callable(device):
            self._device = device
        else:
            self._text = device or protocol.device
            self._device = device_maker(self._text, protocol)
        self._live = self._text.partition(":")[0] in (_DRIVER, "igtl")
        self._simulated, self._once, self._view, self._again = simulated, once, view, again
        self._tried = False

    @property
    def begun(self) -> tuple[str, ...]:
        """Tasks that have a file of answers."""
        return tuple(task for task in self.tasks if self._file(task).exists())

    def run(self, seat: Callable[[str], Seat]) -> int:
        """Through all tasks: those that were begun go on, the others begin. How many answers were given now.

        Parameters
        ----------
        seat : callable
            Gives the seat for a task.

        Raises
        ------
        DeviceLost, KeyboardInterrupt
            As `Runner.run`; what was answered is on disk.
        BlockingIOError, FileNotFoundError, ValueError, OSError
            As `Protocol.begin` and `Protocol.resume`.
        """
        given = 0
        for task in self.tasks:
            given += self._run_task(task, seat(task), rest=given > 0)
        return given

    def _run_task(self, task: str, seat: Seat, *, rest: bool) -> int:
        enter = self.protocol.resume if self._file(task).exists() else self.protocol.begin
        file, order = enter(self.subject, task, device=self._text, simulated=self._simulated)
        with file, Experimenter(self.protocol.data.log(self.subject, task), self._view) as experimenter:
            if order.next() is None:
                return 0
            kind = "simulated subject" if seat.simulated else "subject"
            done = f", {len(order.answered)} trials were answered before" if order.answered else ""
            experimenter.say(
                f"{datetime.now():%Y-%m-%d}: {kind} {self.subject}, task {task}, at most {order.total} trials{done}"
            )
            if self._text.startswith("igtl:") and self.protocol.publish is None:
                experimenter.say(_NO_FORCE)
            for note in file.notes:
                experimenter.say(note)
            if not (self._tried or seat.simulated):
                self._tried = True
                experimenter.say(try_loop(self.protocol.burr, self.protocol.bone))
            if rest:
                seat.progress("")
                seat.rest("That was one task. Take a break.", self.protocol.rest)
            clock: Clock = VirtualClock(file.end) if seat.simulated else WallClock(file.elapsed)
            runner = Runner(
                self.protocol.tasks[task],
                order,
                file.append,
                seat,
                experimenter,
                self._rig(task),
                clock=clock,
            )
            try:
                given = runner.run()
            except BaseException as error:
                on = f"; {self._again} goes on" if self._again else ""
                experimenter.say(
                    f"ended early, {type(error).__name__}: {len(order.answered)} trials are answered{on}"
                )
                raise
            finally:
                if runner.repeated:
                    experimenter.say(f"trials repeated as the loop had stalled: {runner.repeated}")
            experimenter.say(f"task {task} is over, {len(order.answered)} trials were answered")
            return given

    def _rig(self, task: str) -> Rig:
        protocol = self.protocol
        return Rig(
            protocol.burr, protocol.bone, self._device, pause=protocol.pause, rest=protocol.rest,
            feedback=protocol.feedback, live=self._live, publish=None if self._simulated else protocol.publish,
            trace=(lambda trial, number: self._trace(task, trial, number)) if protocol.trace else None,
            render=_rendered_once() if self._once else render,
        )  # fmt: skip

    def _trace(self, task: str, trial: Trial, number: int) -> Path:
        """A new file: an interval that was broken off has left one, and is felt again."""
        first = self.protocol.data.trace(self.subject, task, trial.phase, trial.number, number)
        first.parent.mkdir(parents=True, exist_ok=True)
        path, attempt = first, 1
        while path.exists():
            attempt += 1
            path = first.with_name(first.name.replace("_trace", f"_attempt-{attempt}_trace"))
        return path

    def _file(self, task: str) -> Path:
        return self.protocol.data.answers(self.subject, task)


def try_loop(burr: Burr, bone: Block) -> str:
    """How a loop runs on this machine now, by a simulated hand that drills for a second: a sentence."""
    interval = Interval(Stimulus("trial run", burrlab.materials["bone"]), 0, 1.0)
    felt = render(interval, drilling_hand(burr), burr=burr, bone=bone, mode="drilling")
    late = int((felt.ticks["periods"] > 1).sum())
    text = f"before the first trial {late} of {len(felt.ticks)} ticks were late{', and the loop stalled' * felt.failed}"
    if felt.failed or late > MANY_LATE * len(felt.ticks):
        return f"THE MACHINE HAS TOO MUCH TO DO: {text}; at most {100 * MANY_LATE:g} % should be"
    return text


def device_maker(text: str, protocol: Protocol) -> Callable[[Mode], Device]:
    """What makes a device for an interval of a mode.

    Raises
    ------
    ValueError
        If the text is wrong, or the script is.
    OSError
        If the script cannot be read.
    """
    try:
        device = parse_device(text)
    except ValueError as error:
        raise ValueError(f"device {error}") from None
    if device.kind == "hand":
        return lambda mode: (probing_hand if mode == "probing" else drilling_hand)(protocol.burr)
    if device.kind == "scripted":
        script = burrlab.read_script(device.file)
        return lambda mode: script
    return lambda mode: burrlab.IgtlDevice(device.host, device.port, lost_after=protocol.lost_after)


def _always(device: Device) -> Callable[[Mode], Device]:
    return lambda mode: device


def _rendered_once() -> Callable[..., Rendered]:
    """`render` that remembers what became of a material."""
    kept: dict[tuple[Any, ...], Rendered] = {}

    def once(interval: Interval, device: Device, **options: Any) -> Rendered:
        key = (interval.stimulus, interval.duration)
        if key not in kept:
            kept[key] = render(interval, device, **options)
        return kept[key]

    return once
