"""A haptic session: devices, loop, follower, trace and publisher start and end together."""

import atexit
import contextlib
import functools
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
    DeviceModel,
    Follower,
    HapticLoop,
    IgtlDevice,
    LoopFrame,
    Material,
    RecordReader,
    ScriptedDevice,
    TickExecutor,
    VoxelBone,
    VrpnDevice,
)
from burrlab.anatomy.report import AnatomyReport
from burrlab.anatomy.watch import Watch
from burrlab.bone.header import told_notes
from burrlab.bone.materials import constants_of
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

Tool = tuple[Burr, Material]
PlacedDevice = Device | tuple[Device, DeviceFrame]
_COARSE = 7.5  # voxels a radius; with fewer a message says so
_ROUND = 0.05  # [s] between two rounds of the housekeeping thread
_PATIENCE = 2.0  # [s], before devices without a position are reported


class Session:
    """One or two burrs, driven by devices through a bone in real time.

    Parameters
    ----------
    bone : VoxelBone or StartingBone
        It is copied; `snapshot` returns its present state. A StartingBone has ticks behind it, or a recipe.
    tools : (Burr, Material) or list of them
        One per burr, at most two; they act in this order within a tick.
    devices : Device or (Device, DeviceFrame), or a list of them
        One per burr: `HandDevice`, `ScriptedDevice`, `ReplayDevice`, `MailboxDevice`, `IgtlDevice`,
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

    Attributes
    ----------
    loop : HapticLoop
        With its counts and histograms.
    follower : Follower
        Newest record, changed bricks, snapshots and stiffness.
    messages : list of str
        All so far.
    provenance : dict
        Versions, machine and all parameters.

    Raises
    ------
    ValueError
        If there is not one device per burr, the duration is not positive, or the watch is of another bone, a
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
        devices: PlacedDevice | Sequence[PlacedDevice],
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
        # The tools, devices and bone, and checks that they go together.
        self.tools: list[Tool] = _listed(
            tools, _is_tool, "tools must be (Burr, Material) or a list of such pairs"
        )
        placed = _listed(
            devices,
            _is_device,
            "devices must be a Device or a list of them, each alone or with its DeviceFrame",
        )
        framed = [device if isinstance(device, tuple) else (device, DeviceFrame()) for device in placed]
        self.devices: list[Device] = [device for device, _ in framed]
        self._frames: list[DeviceFrame] = [frame for _, frame in framed]
        loop_frames = self._frames if any(isinstance(device, tuple) for device in placed) else []
        self.seed = seed_or_new(seed)
        start = bone if isinstance(bone, StartingBone) else StartingBone(bone)
        self._limits = ForceLimits(safety, self.devices, len(self.tools), clock.rate)
        self._check_settings(clock, safety, watch)
        ticks, room = _ticks_and_room(duration, clock.rate)

        # The loop executes ticks on its own copy of the bone; the follower repeats them on another.
        period = 1e3 / clock.rate  # [ms]
        self._executor = TickExecutor(
            start.bone.copy(), self.tools, self.seed, period=period, scheme=start.scheme, tick=start.tick
        )
        self.loop = self._make_loop(clock, safety, ticks, loop_frames)
        ticks_per_digest = max(1, round(clock.digest_every * clock.rate))
        self.follower = Follower(self.loop, digest_every=ticks_per_digest)
        self._anatomy = SessionAnatomy(self._executor.bone, self.follower, self.tools, watch, period)
        self.provenance = self._describe(start, clock, safety, watch, loop_frames)

        # Where the session is told: on the network, in the trace, in messages.
        if publish is not None and not isinstance(publish, Publish):
            publish = Publish(port=publish)
        self._publisher = None if publish is None else open_publisher(self.follower, self.provenance, publish)
        self._writer = None
        if record is not None:
            try:
                self._writer = TraceWriter(
                    record, RecordReader(self.loop), self._executor.bone, self.tools, self.provenance, duration=room,
                    digest_every=ticks_per_digest * period / 1e3, on_end=functools.partial(_say_weakly, weakref.ref(self)),
                )  # fmt: skip
            except BaseException:
                if self._publisher is not None:
                    self._publisher.stop()  # a caller that keeps the exception would keep the port open
                raise
        self.messages: list[str] = []
        self._on_message = on_message

        # What the housekeeping thread looks for, and what it has told already.
        self._stop_within = safety.stop_within
        voxels = [burr.radius / max(start.bone.spacing) for burr, _ in self.tools]
        self._first_messages = [
            *self._limits.sentences, *safety.rules(),
            *(f"coarse: the radius of burr {i} is {x:.3g} voxels, below {_COARSE}" for i, x in enumerate(voxels) if x < _COARSE),
        ]  # fmt: skip
        self._borders = {burr: Border(start.bone) for burr in range(len(self.tools))}
        self._warned_of_stiffness: set[int] = set()
        self._digests_written = 0
        self._housekeeper: threading.Thread | None = None  # made by `start`: a thread keeps the session alive
        self._finish_lock, self._done = threading.Lock(), threading.Event()
        self._calling = threading.local()  # `now`: this thread is within `on_message`
        self._process = os.getpid()

    def _check_settings(self, clock: Clock, safety: Safety, watch: Watch | None) -> None:
        """ValueError or TypeError for settings that do not go together."""
        refuse(
            watch is not None and not hasattr(watch, "settings"),
            f"watch must be a Watch, got {type(watch).__name__}",
            TypeError,
        )
        safety.check_structures(watch, clock.wall_clock)
        refuse(
            safety.stop_button is not None
            and any(frame.clutch == safety.stop_button for frame in self._frames),
            f"stop_button must be another button than the clutch, got {safety.stop_button}",
        )
        refuse(
            not clock.wall_clock
            and any(isinstance(device, HeldDevice | IgtlDevice | VrpnDevice) for device in self.devices),
            f"wall_clock must be True for a device that a hand holds, got {clock.wall_clock!r}",
        )

    def _make_loop(
        self, clock: Clock, safety: Safety, ticks: int, frames: Sequence[DeviceFrame]
    ) -> HapticLoop:
        return HapticLoop(
            self._executor, self.devices, wall_clock=clock.wall_clock, realtime=clock.realtime,
            cpu=-1 if clock.cpu is None else clock.cpu, ticks=ticks,
            force_limit=safety.force_limit, slew_limit=safety.slew_limit, coupling=safety.coupling,
            guards=self._limits.guards,
            models=[
                DeviceModel(**{name: getattr(x, name) or np.nan for name in ("damping", "encoder_step", "friction")})
                for x in self._limits.models
            ],
            stop_force=safety.stop_at_force or np.inf,
            stop_buttons=0 if safety.stop_button is None else 1 << safety.stop_button,
            frames=[
                LoopFrame(scale=x.scale, rotation=x.rotation, offset=x.offset, clutch=-1 if x.clutch is None else x.clutch)
                for x in frames
            ],
        )  # fmt: skip

    def _describe(
        self,
        start: StartingBone,
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
            seed=self.seed, rate_Hz=clock.rate, scheme=start.scheme, first_tick=start.tick, digest=self._executor.bone.digest(), source=start.source,
            tools=[{"radius_mm": b.radius, **constants_of(m), "material": m.name} for b, m in self.tools],
            devices=[device.name for device in self.devices],
            force_limit_N=safety.force_limit, slew_limit_N_per_ms=safety.slew_limit, coupling_N_per_mm=safety.coupling,
            wall_clock=clock.wall_clock, **{name: rule for name, rule in rules.items() if rule is not None},
        )  # fmt: skip

    def start(self) -> "Session":
        """Starts all threads. ValueError the second time, or if a device serves another session."""
        refuse(
            self.loop.started or self._done.is_set(),
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
            self.loop.start()
            self.follower.start()
            if self._writer is not None:
                self._writer.start()
            self._housekeeper = threading.Thread(target=self._keep_house, name="burrlab session", daemon=True)
            self._housekeeper.start()
            rights = [
                note for note in self.loop.realtime_notes if "not granted" in note or "not available" in note
            ]
            for text in (*self._first_messages, *rights):
                self._say(text)
        except BaseException as error:  # Ctrl-C too: else the loop would run on
            self.stop(f"stopped by {type(error).__name__}")
            raise
        return self

    def wait(self, seconds: float | None = None) -> bool:
        """Waits at most `seconds` [s] for the session's end and its whole trace; returns whether they came.

        Can be interrupted. ValueError without `seconds` if the session was not started; it ends, and leaves no trace.
        """
        if seconds is None and not (self.loop.started or self._done.is_set()):
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
        self.loop.stop(reason)
        if getattr(self._calling, "now", False):  # this may be the thread to wait for
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
        return self.loop.running

    @property
    def reason(self) -> str:
        """Why the session ended; empty while it runs."""
        return self.loop.reason

    @property
    def failed(self) -> bool:
        """Whether the session ended on a lost device, a stall or a value that is not finite."""
        return self.loop.failed

    @property
    def ticks(self) -> int:
        """Ticks executed in this session."""
        return self.loop.counts.ticks

    @property
    def port(self) -> int | None:
        """The port that the session is published on; None if it is not."""
        return (self._publisher.port or None) if self._publisher else None

    @property
    def vrpn_port(self) -> int | None:
        """The port for VRPN's clients; None if there is none."""
        return (self._publisher.vrpn_port or None) if self._publisher else None

    @property
    def digests(self) -> list[tuple[int, str]]:
        """[(ticks executed, digest)]"""
        return self.follower.digests

    def snapshot(self) -> tuple[VoxelBone, int]:
        """(copy of the bone, ticks it has seen), for `save_bone`."""
        return self.follower.snapshot()

    def report(self) -> SessionReport:
        """The report of the session so far."""
        return SessionReport.of(
            self.loop, self.follower, self._publisher, self._writer, self.messages, self._anatomy.report(),
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
        counts = self.loop.counts
        return f"Session({state}, {counts.ticks} ticks, {counts.late} late, {counts.dropped} periods dropped)"

    def _say(self, text: str) -> None:
        self.messages.append(text)
        if self._on_message is None:
            return
        self._calling.now = True
        try:
            self._on_message(text)
        except BaseException as error:  # on_message must not end the session, not even by sys.exit
            if not isinstance(error, Exception) and threading.current_thread() is threading.main_thread():
                raise  # Ctrl-C
            self.messages.append(f"on_message failed: {error!r}")
        finally:
            self._calling.now = False

    def _keep_house(self) -> None:
        """Looks after the session while the loop runs, then ends it."""
        reader = RecordReader(self.loop)  # the loop runs, so it does not wait for this reader
        looks_a_round = (
            10 if self._stop_within else 1
        )  # a distance that stops the session is looked at more often
        looks, well = 0, True
        while not self.loop.wait(_ROUND / looks_a_round):
            looks += 1
            try:
                self._stop_if_near()
                if looks % looks_a_round == 0:
                    self._serve(reader, looks // looks_a_round)
            except Exception as error:  # the end of the session needs this thread
                if self._stop_within:
                    self.loop.stop(f"the distance to stop within is unknown: {error!r}")
                if well:
                    self._say(f"the session goes on without warnings: {error!r}")
                well = False
        with contextlib.suppress(Exception):
            self._warn_of_border(reader)
        self._finish(self.loop.reason)

    def _serve(self, reader: RecordReader, rounds: int) -> None:
        """One round of the housekeeping: writes what is due, tells what is new, warns."""
        self._pass_on()
        self._warn_of_border(reader)
        if self.loop.counts.ticks == 0 and rounds == round(_PATIENCE / _ROUND):
            faults = [fault for device in self.devices if (fault := getattr(device, "fault", ""))]
            self._say("; ".join(["no tick yet: the devices have not given a first position", *faults]))
        for note in {getattr(device, "note", "") for device in self.devices} - {"", *self.messages}:
            self._say(note)
        self._warn_of_stiffness()

    def _finish(self, reason: str) -> None:
        """Ends the parts after the loop, once; `wait` returns whatever happens here."""
        with self._finish_lock, contextlib.ExitStack() as afterwards:
            if self._done.is_set():
                return
            afterwards.callback(self._done.set)
            if self._publisher is not None:
                afterwards.callback(self._publisher.stop)
            self.loop.stop()  # the loop has ended; this releases its devices
            self.follower.stop()  # even if nothing was started, this tells those who wait
            if self.loop.started:
                reason = self.loop.reason
                self._pass_on(last=True)
            if self.loop.failed:
                self._say(reason)
            if self._writer is not None:
                self._writer.stop(reason)
                if self._writer.warning:
                    self._say(self._writer.warning)
            if self._publisher is not None and self.loop.started:
                self._publisher.finish(reason, failed=self.loop.failed)
            if self.loop.started:
                self._tell_of_misses()  # last, as it can fail: it needs memory

    def _stop_if_near(self) -> None:
        for name, limit in self._stop_within.items():
            closest = self._anatomy.closest(name)
            if closest.min() <= limit:
                burr = int(closest.argmin())
                self.loop.stop(f"burr {burr} came within {limit:g} mm of {name}: {closest[burr]:.2f} mm")

    def _warn_of_stiffness(self) -> None:
        for burr in range(len(self.tools)):
            at = self.follower.stability(burr)
            if at["warning"] and burr not in self._warned_of_stiffness:
                self._warned_of_stiffness.add(burr)
                self._say(
                    f"burr {burr}: contact stiffness {at['stiffness_N_per_mm']:.2g} N/mm, at its stiffest "
                    f"{at['ratio']:.2f} of the device's limit; {at['exceeded']} "
                    f"{at['force_at_limit_N']:.2g} N here a hand may tremble"
                )

    def _warn_of_border(self, reader: RecordReader) -> None:
        while self._borders and len(records := reader.take()[0]):
            for burr, border in list(self._borders.items()):
                if border.count_cut(records["burr"]["center"][:, burr], self.tools[burr][0].radius):
                    self._say(f"burr {burr}: {CUT}")
                    del self._borders[burr]

    def _pass_on(self, *, last: bool = False) -> None:
        """New digests and events go into the trace, and sentences to whoever reads them."""
        if self._writer is not None:
            for tick, digest in self.follower.digests_since(self._digests_written):
                self._writer.add_digest(tick, digest)
                self._digests_written += 1
        events, sentences = self._anatomy.news()
        if self._writer is not None and self._anatomy.watch is not None:
            self._writer.add_events(events)
            if last:
                self._writer.set_watched(self._anatomy.watched())
        for sentence in sentences:
            self._say(sentence)

    def _tell_of_misses(self) -> None:
        """Says by how much a script passed the bone, where its burr never felt a force."""
        counts = self.loop.counts
        end = (counts.ticks + counts.missed) / self.provenance["rate_Hz"]
        for burr, (device, frame) in enumerate(zip(self.devices, self._frames, strict=True)):
            felt = self.loop.energy(burr) != (0.0, 0.0) or self.follower.stability(burr)["force_N"] > 0
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
    held = any(
        isinstance(device, HeldDevice)
        for session in _to_stop
        if session is starting or session.running
        for device in session.devices
    )
    before, after = (signal.SIG_DFL, _end_by_signal) if held else (_end_by_signal, signal.SIG_DFL)
    for number in _SIGNALS:
        if signal.getsignal(number) is before:
            signal.signal(number, after)


def _end_by_signal(number: int, _: object) -> None:
    running = [session for session in _to_stop if session.running and session._process == os.getpid()]
    for session in running:
        session.loop.stop(f"stopped by {signal.Signals(number).name}")
    end_exchanges()
    signal.signal(number, signal.SIG_DFL)  # no earlier: a second signal would leave the force on
    for session in running:
        if session._housekeeper is not None:
            session._housekeeper.join(_PATIENCE)  # for the trace
    signal.raise_signal(number)


def _say_weakly(session: weakref.ref[Session], text: str) -> None:
    """`Session._say` for a thread that must not keep the session alive."""
    if (alive := session()) is not None:
        alive._say(text)


def _ticks_and_room(duration: float | None, rate: float) -> tuple[int, float]:
    """Ticks after which a session of a duration [s] ends, 0 for never; time that its trace has room for [s]."""
    if duration is None:
        return 0, DEFAULT_DURATION
    seconds = scalar(duration, "duration")
    refuse(not 0 < seconds < 1e9, f"duration must be positive and below 1e9 s, got {seconds!r}")
    return max(1, round(seconds * rate)), seconds + 1.0


def _listed(objects: Any, is_right: Callable[[object], bool], rule: str) -> list[Any]:
    """An object or several as a list; TypeError with the rule if one is of another kind."""
    listed = [objects] if is_right(objects) else objects
    refuse(
        not isinstance(listed, Sequence) or not all(map(is_right, listed)),
        f"{rule}, got {objects!r}",
        TypeError,
    )
    return list(listed)


def _is_tool(tool: object) -> bool:
    return isinstance(tool, tuple) and [type(part) for part in tool] == [Burr, Material]


def _is_device(device: object) -> bool:
    pair = device if isinstance(device, tuple) and len(device) == 2 else (device, DeviceFrame())
    return isinstance(pair[0], Device) and isinstance(pair[1], DeviceFrame)
