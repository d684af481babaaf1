"""A haptic session: devices, loop, follower, trace and publisher start and end together."""

import atexit
import contextlib
import json
import math
import os
import signal
import threading
import weakref
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from burrlab._core import (
    Burr,
    Device,
    Follower,
    HapticLoop,
    Material,
    RecordReader,
    ScriptedDevice,
    TickExecutor,
    VoxelBone,
)
from burrlab.anatomy.report import AnatomyReport
from burrlab.anatomy.watch import Watch
from burrlab.bone.header import told_notes
from burrlab.bone.specimen import CUT, Border
from burrlab.common.check import refuse, scalar, seed_or_new
from burrlab.common.provenance import provenance
from burrlab.session.anatomy import SessionAnatomy
from burrlab.session.devices import DeviceFrame, describe_miss
from burrlab.session.haply import HaplyDevice, HeldDevice, end_exchanges
from burrlab.session.network import open_publisher
from burrlab.session.recorder import DEFAULT_DURATION, TraceWriter
from burrlab.session.report import SessionReport
from burrlab.session.settings import Clock, ForceLimits, Publish, Safety, StartingBone
from burrlab.session.trace import TraceHeader

Tool = tuple[Burr, Material]
Standing = Device | tuple[Device, DeviceFrame]
_COARSE = 7.5  # voxels a radius; with fewer a message says so
_LOOK = 0.05  # [s] between two rounds of the housekeeping thread
_PATIENCE = 2.0  # [s], before devices without a position are reported


class Session:
    """One or two burrs, driven by devices through a bone in real time.

    Parameters
    ----------
    bone : VoxelBone or StartingBone
        It is copied; `snapshot` returns its present state. A StartingBone has ticks behind it, or a recipe.
    tools : (Burr, Material) or list of them
        One a burr, at most two; they act in this order within a tick.
    devices : Device or (Device, DeviceFrame), or a list of them
        One a burr: `HandDevice`, `ScriptedDevice`, `ReplayDevice`, `MailboxDevice`, `IgtlDevice`,
        `VrpnDevice`, `TouchDevice`, `OmegaDevice`, `HaplyDevice`. A device serves one session at a time.
        Without a frame, its positions are the bone's.
    seed : int, optional
        Default: a random one; the attribute `seed` holds it.
    duration : float, optional
        The session ends after duration times rate ticks [s]. Without a duration it ends when it is stopped or
        a device ends.
    record : path, optional
        A new file for the complete trace (docs/trace.md).
    watch : Watch, optional
        Watch of critical structures of this bone. Its events are told, and kept in the trace
        (docs/anatomy.md).
    on_message : callable, optional
        Called from another thread with each message, which someone should read at once; `messages` holds all.
        It may stop the session, but not wait for its end.
    clock : Clock
        Rate, wall clock, real-time priority.
    safety : Safety
        Limits of the force, the spring between device and burr, and what stops the session.
    publish : int or Publish, optional
        A port on this machine, or all of where and how the session is published.

    Raises
    ------
    ValueError
        If there is not one device a burr, the duration is not positive, or the watch is of another bone, a
        model is unknown, or a rule to stop is not of a watched structure.
    TypeError
        If a tool is not (Burr, Material), or a device is no Device.
    FileExistsError
        If the trace exists.
    OSError
        If the trace cannot be written, or the port is taken.

    Examples
    --------
    >>> import burrlab
    >>> bone = burrlab.VoxelBone.block((20, 20, 5), 0.2, origin=(-9.9, -9.9, -4.9))
    >>> hand = burrlab.HandDevice((0, 0, 3.5))
    >>> tool = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> clock = burrlab.Clock(wall_clock=False)
    >>> with burrlab.Session(bone, tool, hand, seed=1, duration=0.5, clock=clock) as session:
    ...     ended = session.wait()
    >>> ended, session.ticks, session.reason
    (True, 500, 'all ticks were executed')
    """

    def __init__(
        self,
        bone: VoxelBone | StartingBone,
        tools: Tool | Sequence[Tool],
        devices: Standing | Sequence[Standing],
        *,
        seed: int | None = None,
        duration: float | None = None,
        record: str | os.PathLike[str] | None = None,
        watch: Watch | None = None,
        on_message: Callable[[str], object] | None = None,
        clock: Clock = Clock(),
        safety: Safety = Safety(),
        publish: int | Publish | None = None,
    ) -> None:
        self.tools: list[Tool] = _listed(
            tools, _is_tool, "tools must be (Burr, Material) or a list of such pairs"
        )
        self.devices, self._stands, stands = _placed(devices)
        self.seed = seed_or_new(seed)
        begin = bone if isinstance(bone, StartingBone) else StartingBone(bone)
        start, period = begin.bone.copy(), 1e3 / clock.rate
        duration = None if duration is None else scalar(duration, "duration")
        refuse(
            duration is not None and not 0 < duration < 1e9,
            f"duration must be positive and below 1e9 s, got {duration!r}",
        )
        self._limits = ForceLimits(safety, self.devices, len(self.tools), clock.rate)
        self._check_settings(clock, safety, watch)
        self._stop_within = safety.stop_within
        voxels = [burr.radius / max(start.spacing) for burr, _ in self.tools]
        self._coarse = [
            f"coarse: the radius of burr {i} is {x:.3g} voxels, below {_COARSE}" for i, x in enumerate(voxels) if x < _COARSE
        ]  # fmt: skip
        self._executor = TickExecutor(
            start, self.tools, self.seed, period=period, scheme=begin.scheme, tick=begin.tick
        )
        self._loop = self._make_loop(clock, safety, duration, stands)
        ticks_a_digest = max(1, round(clock.digest_every * clock.rate))
        self._follower = Follower(self._loop, digest_every=ticks_a_digest)
        self._anatomy = SessionAnatomy(start, self._follower, self.tools, watch, period)
        self._rules = [*self._limits.sentences, *safety.rules()]
        self.provenance = self._describe(begin, clock, safety, watch, stands)
        self.messages: list[str] = []
        self._on_message = on_message
        if publish is not None and not isinstance(publish, Publish):
            publish = Publish(port=publish)
        self._publisher = (
            None if publish is None else open_publisher(self._follower, self.provenance, publish)
        )
        self._writer = None
        if record is not None:
            room = DEFAULT_DURATION if duration is None else duration + 1.0
            try:
                self._writer = self._open_trace(record, room, ticks_a_digest * period / 1e3)
            except BaseException:
                if self._publisher is not None:
                    self._publisher.stop()  # an exception that is kept would hold the port
                raise
        self._digests = 0
        self._warned: set[int] = set()
        self._borders = {burr: Border(begin.bone) for burr in range(len(self.tools))}
        self._finishing = threading.Lock()
        self._saying = threading.local()
        self._process = os.getpid()
        self._done = threading.Event()
        self._housekeeper: threading.Thread | None = None  # made at the start, as it keeps the session alive

    def _check_settings(self, clock: Clock, safety: Safety, watch: Watch | None) -> None:
        """ValueError or TypeError for settings that do not go together."""
        if watch is not None and not hasattr(watch, "settings"):
            raise TypeError(f"watch must be a Watch, got {type(watch).__name__}")
        safety.check_structures(watch, clock.wall_clock)
        clutches = [frame.clutch for frame in self._stands if frame.clutch is not None]
        refuse(
            safety.stop_button in clutches,
            f"stop_button must be another button than the clutch, got {safety.stop_button}",
        )
        refuse(
            not clock.wall_clock and any(isinstance(device, HeldDevice) for device in self.devices),
            f"wall_clock must be True for a device that a hand holds, got {clock.wall_clock!r}",
        )

    def _make_loop(
        self, clock: Clock, safety: Safety, duration: float | None, frames: Sequence[DeviceFrame]
    ) -> HapticLoop:
        unknown = math.nan
        return HapticLoop(
            self._executor, self.devices, wall_clock=clock.wall_clock, realtime=clock.realtime,
            cpu=-1 if clock.cpu is None else clock.cpu, ticks=0 if duration is None else max(1, round(duration * clock.rate)),
            force_limit=safety.force_limit, slew_limit=safety.slew_limit, coupling=safety.coupling,
            guards=self._limits.guards,
            models=[(x.damping or unknown, x.encoder_step or unknown, x.friction or unknown) for x in self._limits.models],
            stop_force=safety.stop_at_force or math.inf, stop_buttons=0 if safety.stop_button is None else 1 << safety.stop_button,
            frames=[(x.scale, x.rotation, x.offset, -1 if x.clutch is None else x.clutch) for x in frames],
        )  # fmt: skip

    def _describe(
        self,
        begin: StartingBone,
        clock: Clock,
        safety: Safety,
        watch: Watch | None,
        frames: Sequence[DeviceFrame],
    ) -> dict[str, Any]:
        """The provenance; rules that do not hold are left out."""
        rules = {
            "watch": None if watch is None else watch.settings, **self._limits.provenance, "stop_at_force_N": safety.stop_at_force,
            "stop_within_mm": safety.stop_within or None, "stop_button": safety.stop_button,
            "frames": [asdict(frame) for frame in frames] or None,
        }  # fmt: skip
        return provenance(
            seed=self.seed, rate_Hz=clock.rate, scheme=begin.scheme, first_tick=begin.tick, digest=self._executor.bone.digest(), source=begin.source,
            tools=[{"radius_mm": b.radius, "c_e_N_per_mm2": m.c_e, "alpha_per_ms": m.alpha, "shape": m.shape.name,
                    "material": m.name} for b, m in self.tools],
            devices=[device.name for device in self.devices],
            force_limit_N=safety.force_limit, slew_limit_N_per_ms=safety.slew_limit, coupling_N_per_mm=safety.coupling,
            wall_clock=clock.wall_clock, **{name: rule for name, rule in rules.items() if rule is not None},
        )  # fmt: skip

    def _open_trace(
        self, record: str | os.PathLike[str], duration: float, digest_every: float
    ) -> TraceWriter:
        about = self.provenance
        header = TraceHeader(
            self.tools, self.seed, 1e3 / about["rate_Hz"], about["scheme"], about["first_tick"], about["devices"],
            json.dumps(about["source"]), about, about.get("watch"),
        )  # fmt: skip
        return TraceWriter(
            record, RecordReader(self._loop), self._executor.bone, header, duration=duration,
            digest_every=digest_every, on_end=_weakly(self._say),
        )  # fmt: skip

    def start(self) -> "Session":
        """Starts all threads. ValueError the second time, or if a device serves another session."""
        refuse(
            self._loop.started or self._done.is_set(),
            "session must be started once: it has been started or stopped",
        )
        _to_stop.add(self)  # a session that is never stopped would outlive the interpreter
        # Registered last, it runs first: later handlers remove what writing a trace needs.
        atexit.unregister(_stop_all)
        atexit.register(_stop_all)
        for device in self.devices:
            if isinstance(device, HaplyDevice):
                device.note = ""  # of an earlier session
        try:
            _guard_signals(self)
            self._loop.start()
            self._follower.start()
            if self._writer is not None:
                self._writer.start()
            self._housekeeper = threading.Thread(target=self._keep_house, name="burrlab session", daemon=True)
            self._housekeeper.start()
            lacking = [x for x in self._loop.realtime_notes if "not granted" in x or "not available" in x]
            for text in (*self._rules, *lacking, *self._coarse):
                self._say(text)
        except BaseException as error:  # Ctrl-C too: else the loop would run on
            self.stop(f"stopped by {type(error).__name__}")
            raise
        return self

    def wait(self, seconds: float | None = None) -> bool:
        """Waits at most `seconds` [s] for the session's end and its whole trace; returns whether they came.

        Can be interrupted. ValueError without `seconds` if the session was not started; it ends, and leaves no trace.
        """
        if seconds is None and not (self._loop.started or self._done.is_set()):
            self.stop("never started")
            if self._writer is not None and self._writer.complete:  # else the file in its place is another's
                self._writer.path.unlink()
            raise ValueError(
                "session must be started before `wait`: write `with Session(...) as session:`, or `start()`"
            )
        left = float("inf") if seconds is None else scalar(seconds, "seconds")
        while not self._done.is_set() and left > 0:
            self._done.wait(min(left, 0.1))
            left -= 0.1
        return self._done.is_set()

    def stop(self, reason: str = "stopped") -> None:
        """Ends the session and waits until all ticks are followed, recorded and published.

        Further calls do nothing. Called by `on_message`, it does not wait. In a fork it does nothing.
        """
        if self._process != os.getpid():  # a fork has no threads to wait for
            return
        self._loop.stop(reason)
        if getattr(self._saying, "now", False):  # this may be the thread to wait for
            return
        if self._housekeeper is not None and self._housekeeper.ident is not None:
            self._housekeeper.join()
        else:
            self._finish(reason)
        _guard_signals()

    def __enter__(self) -> "Session":
        return self.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self.stop("stopped" if kind is None else f"stopped by {kind.__name__}")

    @property
    def running(self) -> bool:
        return self._loop.running

    @property
    def reason(self) -> str:
        """Why the session ended; empty while it runs."""
        return self._loop.reason

    @property
    def failed(self) -> bool:
        """Whether the session ended on a lost device, a stall or a value that is not finite."""
        return self._loop.failed

    @property
    def ticks(self) -> int:
        """Ticks executed in this session."""
        return self._loop.counts.ticks

    @property
    def port(self) -> int | None:
        """The port that the session is published on; None if it is not."""
        return (self._publisher.port or None) if self._publisher else None

    @property
    def vrpn_port(self) -> int | None:
        """The port for VRPN's clients; None if there is none."""
        return (self._publisher.vrpn_port or None) if self._publisher else None

    @property
    def loop(self) -> HapticLoop:
        """The loop, with its counts and histograms."""
        return self._loop

    @property
    def follower(self) -> Follower:
        """The follower: newest record, changed bricks, snapshots and stiffness."""
        return self._follower

    @property
    def digests(self) -> list[tuple[int, str]]:
        """[(ticks executed, digest)]"""
        return self._follower.digests

    def snapshot(self) -> tuple[VoxelBone, int]:
        """(copy of the bone, ticks it has seen), for `save_bone`."""
        return self._follower.snapshot()

    def report(self) -> SessionReport:
        """The report of the session so far."""
        return SessionReport.of(
            self._loop, self._follower, self._publisher, self._writer, self.messages, self._anatomy.report(),
            told_notes(self.provenance["source"]), self._limits.models,
        )  # fmt: skip

    def anatomy(self) -> AnatomyReport:
        """The report so far on watched structures and removed tissues.

        Raises
        ------
        ValueError
            If the bone has no tissues.
        """
        if (report := self._anatomy.report()) is None:
            raise ValueError("bone of the session must have tissues, got one of a single material")
        return report

    def __repr__(self) -> str:
        state = "running" if self.running else self.reason or "not started"
        counts = self._loop.counts
        return f"Session({state}, {counts.ticks} ticks, {counts.late} late, {counts.dropped} periods dropped)"

    def _say(self, text: str) -> None:
        self.messages.append(text)
        if self._on_message is None:
            return
        self._saying.now = True
        try:
            self._on_message(text)
        except BaseException as error:  # on_message must not end the session, not even by sys.exit
            if not isinstance(error, Exception) and threading.current_thread() is threading.main_thread():
                raise  # Ctrl-C
            self.messages.append(f"on_message failed: {error!r}")
        finally:
            self._saying.now = False

    def _keep_house(self) -> None:
        """Serves the parts while the loop runs, then ends them."""
        waited, next_look, well = 0.0, 0.0, True
        reader = RecordReader(self._loop)  # the loop runs, so it does not wait for this reader
        look = _LOOK / 10 if self._stop_within else _LOOK
        while not self._loop.wait(look):
            try:
                self._stop_if_near()
                waited += look
                if waited < next_look + _LOOK:
                    continue
                self._hand_digests()
                self._tell_of_anatomy()
                self._warn_of_border(reader)
                if self._loop.counts.ticks == 0 and next_look < _PATIENCE <= next_look + _LOOK:
                    why = "".join(
                        f"; {text}" for device in self.devices if (text := getattr(device, "fault", ""))
                    )
                    self._say(f"no tick yet: the devices have not given a first position{why}")
                notes = {getattr(device, "note", "") for device in self.devices} - {"", *self.messages}
                for note in notes:
                    self._say(note)
                next_look += _LOOK
                for burr in range(len(self.tools)):
                    self._warn_of_stiffness(burr)
            except Exception as error:  # the end of the session needs this thread
                if self._stop_within:
                    self._loop.stop(f"the distance to stop within is unknown: {error!r}")
                if well:
                    self._say(f"the session goes on without warnings: {error!r}")
                well = False
        with contextlib.suppress(Exception):
            self._warn_of_border(reader)
        self._finish(self._loop.reason)

    def _finish(self, reason: str) -> None:
        """Ends the parts after the loop, once; `wait` returns whatever happens here."""
        with self._finishing, contextlib.ExitStack() as last:
            if self._done.is_set():
                return
            last.callback(self._done.set)
            if self._publisher is not None:
                last.callback(self._publisher.stop)
            self._loop.stop()  # the loop has ended; this releases its devices
            self._follower.stop()  # even if nothing was started, this tells those who wait
            if self._loop.started:
                reason = self._loop.reason
                self._hand_digests()
                self._tell_of_anatomy(last=True)
            if self._loop.failed:
                self._say(reason)
            if self._writer is not None:
                self._writer.stop(reason)
                if self._writer.warning:
                    self._say(self._writer.warning)
            if self._publisher is not None and self._loop.started:
                self._publisher.finish(reason, failed=self._loop.failed)
            if self._loop.started:
                self._tell_of_misses()  # last, as it can fail: it needs memory

    def _stop_if_near(self) -> None:
        for name, limit in self._stop_within.items():
            closest = self._anatomy.closest(name)
            if closest.min() <= limit:
                burr = int(closest.argmin())
                self._loop.stop(f"burr {burr} came within {limit:g} mm of {name}: {closest[burr]:.2f} mm")

    def _warn_of_stiffness(self, burr: int) -> None:
        at = self._follower.stability(burr)
        if not at["warning"] or burr in self._warned:
            return
        self._warned.add(burr)
        self._say(
            f"burr {burr}: contact stiffness {at['stiffness_N_per_mm']:.2g} N/mm, at its stiffest "
            f"{at['ratio']:.2f} of the device's limit; below "
            f"{at['force_at_limit_N']:.2g} N here a hand may tremble"
        )

    def _warn_of_border(self, reader: RecordReader) -> None:
        while self._borders and len(records := reader.take()[0]):
            for burr, border in list(self._borders.items()):
                centers = records["burr"]["center"][:, burr]
                if border.count_cut(centers, self.tools[burr][0].radius):
                    self._say(f"burr {burr}: {CUT}")
                    del self._borders[burr]

    def _hand_digests(self) -> None:
        if self._writer is None:
            return
        for tick, digest in self._follower.digests_since(self._digests):
            self._writer.add_digest(tick, digest)
            self._digests += 1

    def _tell_of_anatomy(self, *, last: bool = False) -> None:
        events, sentences = self._anatomy.news()
        if self._writer is not None and self._anatomy.watch is not None:
            if len(events):
                self._writer.add_events(events)
            if last:
                self._writer.set_watched(self._anatomy.watched())
        for sentence in sentences:
            self._say(sentence)

    def _tell_of_misses(self) -> None:
        """Says by how much a script passed the bone, where its burr never felt a force."""
        counts = self._loop.counts
        end = (counts.ticks + counts.missed) / self.provenance["rate_Hz"]
        for burr, (device, frame) in enumerate(zip(self.devices, self._stands, strict=True)):
            felt = self._loop.energy(burr) != (0.0, 0.0) or self._follower.stability(burr)["force_N"] > 0
            if isinstance(device, ScriptedDevice) and counts.ticks and not felt:
                time, *axes = device.path.T
                times = np.append(time[time < end], min(end, time[-1]))
                path = np.column_stack([np.interp(times, time, axis) for axis in axes])
                if miss := describe_miss(self.snapshot()[0], path, frame, self.tools[burr][0].radius):
                    self._say(f"burr {burr} never met the bone: {miss}")


_to_stop: weakref.WeakSet[Session] = weakref.WeakSet()


def _stop_all() -> None:
    for session in list(_to_stop):
        session.stop("the program ended")


_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def _guard_signals(starting: Session | None = None) -> None:
    """While a session has a device that a hand holds, a signal that ends the program sets its force to zero
    first. Signals that the program itself handles, and other threads than the main one, are left alone."""
    if threading.current_thread() is not threading.main_thread():
        return
    running = [session for session in _to_stop if session is starting or session.running]
    held = any(isinstance(device, HeldDevice) for session in running for device in session.devices)
    before, after = (signal.SIG_DFL, _end_by_signal) if held else (_end_by_signal, signal.SIG_DFL)
    for number in _SIGNALS:
        if signal.getsignal(number) is before:
            signal.signal(number, after)


def _end_by_signal(number: int, _: object) -> None:
    running = [one for one in _to_stop if one.running and one._process == os.getpid()]
    for session in running:
        session._loop.stop(f"stopped by {signal.Signals(number).name}")
    end_exchanges()
    signal.signal(number, signal.SIG_DFL)  # no earlier: a second signal would leave the force on
    for session in running:
        if session._housekeeper is not None:
            session._housekeeper.join(_PATIENCE)  # for the trace
    signal.raise_signal(number)


def _weakly(method: Callable[[str], None]) -> Callable[[str], None]:
    """A function that calls a method without keeping its object alive."""
    weak = weakref.WeakMethod(method)

    def call(text: str) -> None:
        if (alive := weak()) is not None:
            alive(text)

    return call


def _listed(objects: Any, is_one: Callable[[object], bool], rule: str) -> list[Any]:
    """One item or several as a list; TypeError with the rule if one is of another kind."""
    listed = [objects] if is_one(objects) else objects
    if not isinstance(listed, Sequence) or not all(map(is_one, listed)):
        raise TypeError(f"{rule}, got {objects!r}")
    return list(listed)


def _is_tool(tool: object) -> bool:
    return isinstance(tool, tuple) and [type(part) for part in tool] == [Burr, Material]


def _placed(devices: Any) -> tuple[list[Device], list[DeviceFrame], list[DeviceFrame]]:
    """The devices, where each stands, and the same list for the loop, which is empty if no frame was given."""

    def is_one(device: object) -> bool:
        if isinstance(device, tuple) and len(device) == 2:
            return isinstance(device[0], Device) and isinstance(device[1], DeviceFrame)
        return isinstance(device, Device)

    pairs = _listed(
        devices, is_one, "devices must be a Device or a list of them, each alone or with its DeviceFrame"
    )
    alone = [pair[0] if isinstance(pair, tuple) else pair for pair in pairs]
    frames = [pair[1] if isinstance(pair, tuple) else DeviceFrame() for pair in pairs]
    return alone, frames, frames if any(isinstance(pair, tuple) for pair in pairs) else []
