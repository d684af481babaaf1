"""Sources of scenes and pages: a trace, a running session or its replica, or a bone, each at one moment."""

import contextlib
import json
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Replica, VoxelBone, restore_bricks
from burrlab.anatomy.events import KINDS, Watched
from burrlab.anatomy.watch import Watch
from burrlab.bone.header import assumed, told_notes
from burrlab.common.check import refuse
from burrlab.common.progress import Progress, reporter
from burrlab.effects.companion import Companion
from burrlab.effects.effects import Effects, effects_of
from burrlab.session.player import Burrs, History, Player, RecordingPlayer, TracePlayer, unknown_burrs
from burrlab.session.session import Session
from burrlab.session.trace import Trace
from burrlab.view.camera import Approach, trace_approach
from burrlab.view.scene import Scene
from burrlab.view.surface import brick_numbers

_KINDS = {  # text and colour of an event
    "approach": ("approach to", "#ffb454"),
    "touch": ("touch of", "#ff7b72"),
    "injury": ("injury of", "#ff7b72"),
    "away": ("away from", "#7a8791"),
}


#: Drawn fields of a parcel, as precise as the eye can see: within 0.03 mm, and shares of 255.
_DTYPE = np.dtype([("position", "f2", 3), ("radius", "f2"), ("dust", "u1"), ("blood", "u1"), ("water", "u1")])
_SUBSTANCES = ("dust", "blood", "water")
_RATE = 20.0  # frames made for a second of the trace [Hz]


class ParcelHistory:
    """Frames of a trace's parcels in bounded memory: if they take more, every second frame is dropped.

    Parameters
    ----------
    trace : Trace
    effects : Effects
        Made with the trace's initial bone, and without a frame yet; best without a budget.
    memory : float
        For frames [MB].
    """

    def __init__(self, trace: Trace, effects: Effects, *, memory: float = 192.0) -> None:
        self._trace, self._effects, self._memory = trace, effects, memory * 1e6
        self._duration = float(trace.duration)
        self._lock = threading.Lock()
        self._frames: list[NDArray[np.void]] = []  # one after each `_every` frames of effects
        self._every, self._made = 1, 0

    @property
    def made(self) -> float:
        """Part of the trace whose frames are made, 0 to 1."""
        frames = self._duration * _RATE
        return min(1.0, self._made / frames) if frames else 1.0

    def make(self, cancel: threading.Event | None = None, *, progress: Progress | None = None) -> bool:
        """Makes all frames; may run in a thread. Returns whether it came to the end. `progress` is called
        with the fraction done, 0 to 1; True shows a bar."""
        report_progress = reporter(progress, "effects")
        player = TracePlayer(self._trace, every=self._duration + 1.0)  # goes forward only
        size = 0
        for _ in effects_of(player, self._effects, rate=_RATE):
            if cancel is not None and cancel.is_set():
                return False
            self._made += 1
            report_progress(self.made)
            if self._made % self._every:
                continue
            frame = _drawn(self._effects.parcels)
            with self._lock:
                self._frames.append(frame)
                size += frame.nbytes
                while size > self._memory and len(self._frames) > 1:
                    self._frames, self._every = self._frames[1::2], 2 * self._every
                    size = sum(kept.nbytes for kept in self._frames)
        self._made = max(self._made, round(self._duration * _RATE))
        return True

    def at(self, seconds: float) -> NDArray[np.void] | None:
        """The newest kept frame at or before a time [s]; None if there is none yet."""
        with self._lock:
            i = int(seconds * _RATE / self._every + 1e-6)
            return self._frames[i - 1] if 0 < i <= len(self._frames) else None


def _drawn(parcels: NDArray[np.void]) -> NDArray[np.void]:
    frame = np.empty(len(parcels), _DTYPE)
    frame["position"], frame["radius"] = parcels["position"], parcels["radius"]
    whole = np.maximum(sum(parcels[name] for name in _SUBSTANCES), 1)
    for name in _SUBSTANCES:
        frame[name] = np.rint(255.0 * parcels[name] / whole)
    return frame


#: What a page can show.
Shown: TypeAlias = Trace | Player | Session | Replica | VoxelBone
_SHOWN = 30.0  # time of a session in the charts [s]
_CURVE_POINTS = 600  # of a scene's curves


class PageSource:
    """A bone at a moment, and the way to other moments. This class itself is a bone that does not change.

    Attributes
    ----------
    kind : str
        replay, live or still.
    title, state, note : str
        Name; state in words; assumptions about the bone.
    radii : tuple of float
        Burr radii [mm].
    span : (float, float)
        First and last moment of the charts [s].
    time : float
        The moment [s].
    burrs, force, depth
        At the moment, as of a `TracePlayer`.
    history : History
        Time, force and depth, until the moment or longer.
    has_effects : bool
        Whether there is dust, blood and water.
    approach : Approach or None
        The approach to the bone, if it is known.
    """

    kind = "still"

    def __init__(self, bone: VoxelBone, radii: Sequence[float] = (), watch: Any = None) -> None:
        self.bone, self.radii, self.title, self.note = bone, tuple(radii), "bone", ""
        self.state = f"{bone.mass:.0f} mm³ of bone"
        self.time, self.span = 0.0, (0.0, 0.0)
        self.burrs, n = unknown_burrs(self.radii), len(self.radii)
        self.force, self.depth = np.zeros((n, 3)), np.zeros(n)
        self.history = History(np.zeros(0), np.zeros((0, n)), np.zeros((0, n)))
        self.events: list[dict[str, Any]] = []
        self._structures = [str(row["name"]) for row in watch["structures"]] if watch else []
        self.has_effects = False
        self.approach: Approach | None = None
        self._watch: Watch | None = None  # it is made in the background
        self._settings = watch
        self._background: list[threading.Thread] = []

    @property
    def prepared(self) -> float:
        """Part of the work in the background that is done, 0 to 1."""
        return 1.0

    @property
    def parcels(self) -> NDArray[np.void] | None:
        """Dust, blood and water at the moment; None if there are no effects."""
        return None

    @property
    def first_center(self) -> NDArray[np.float64] | None:
        """Centre of the first burr [mm]; None until it is known."""
        centers = self.burrs.centers
        return centers[0] if len(centers) and bool(np.isfinite(centers[0]).all()) else None

    def go(self, seconds: float) -> NDArray[np.uint32]:
        """Goes to a moment [s], or to the newest one of a session; returns numbers of the changed bricks."""
        return np.empty(0, np.uint32)

    def distances(self) -> list[dict[str, Any]]:
        """A row for each critical structure, or each of the watch: name, colour, distance of the nearest burr's
        surface as value [mm], near (within the approach limit). Empty until the distance fields are made."""
        watch, burrs = self._watch, self.burrs
        known = np.isfinite(np.column_stack([burrs.centers, burrs.radii])).all(axis=1)
        if watch is None or not known.any():
            return []
        spheres = list(zip(burrs.centers[known], burrs.radii[known].tolist(), strict=True))
        nearest = [
            min(float(watch.distance(center, name, radius=radius)) for center, radius in spheres)
            for name in watch.structures
        ]
        return [
            {
                "name": name, "colour": "rgb({}, {}, {})".format(*colour), "near": distance <= limit.approach,
                "value": f"{distance:.2f}" if np.isfinite(distance) else "far",
            }
            for name, colour, limit, distance in zip(
                watch.structures, watch.colours, watch.limits, nearest, strict=True
            )
        ]  # fmt: skip

    def _make_watch(self, bone: VoxelBone) -> None:
        with contextlib.suppress(ValueError):  # no voxel of a critical tissue
            self._watch = Watch.of_settings(bone, self._settings) if self._settings else Watch(bone)

    def _add_events(self, times: Iterable[float], rows: Iterable[np.void]) -> None:
        """Adds a row for each event of a trace or a watch, at its time [s]."""
        for time, event in zip(times, rows, strict=True):
            kind, distance = KINDS[int(event["kind"])], float(event["distance_mm"])
            what, colour = _KINDS[kind]
            text = f"{what} {self._structures[int(event['structure'])]}"
            if kind in ("approach", "away") and np.isfinite(distance):
                text += f", {distance:.2f} mm"
            self.events.append({"time_s": time, "clock": f"{time:.2f} s", "text": text, "colour": colour})

    def open(self) -> None:
        """Begins the work in the background. The bone must not change until this returns."""
        tissues = self.bone.tissues
        if self.radii and tissues is not None and (self._settings or any(t.critical for t in tissues)):
            bone = self.bone.copy()  # the original goes on changing
            self._background.append(
                threading.Thread(target=self._make_watch, args=(bone,), name="burrlab distances", daemon=True)
            )
        for thread in self._background:
            thread.start()

    def close(self) -> None:
        """Ends the work in the background."""
        for thread in self._background:
            if thread.ident is not None:
                thread.join()

    def show_in(
        self,
        scene: Scene,
        bricks: NDArray[np.uint32],
        *,
        parcels: bool = True,
        slices: bool = False,
        curves: bool = False,
    ) -> int:
        """Shows the moment in a scene, where `bricks` changed; returns the number of blocks made anew."""
        blocks = scene.update(self.bone, bricks) if len(bricks) else 0
        scene.radii, on = tuple(self.burrs.radii.tolist()), self.burrs.on
        scene.move_burrs(self.burrs.centers, None if on is None else on.tolist())
        scene.set_parcels(self.parcels if parcels else None)
        if slices and self.first_center is not None:
            scene.set_slices(self.first_center)
        if curves and self.radii:
            history = self.history
            first = int(np.searchsorted(history.time, self.time - 10.0))
            end = int(np.searchsorted(history.time, self.time, side="right"))
            rows = slice(first, end, max((end - first) // _CURVE_POINTS, 1))
            scene.set_curves(history.time[rows], history.force[rows, 0], history.depth[rows, 0])
        return blocks


class ReplaySource(PageSource):
    """A trace, which can be looked at while it is prepared in the background; or a recording of others."""

    kind = "replay"

    def __init__(self, player: Player, effects: Effects | None = None) -> None:
        super().__init__(
            player.bone,
            player.burrs.radii.tolist(),
            None if isinstance(player, RecordingPlayer) else player.trace.watch,
        )
        self.player, self.span, self.history = player, (0.0, player.duration), player.history
        self.past: ParcelHistory | None = None
        if isinstance(player, RecordingPlayer):
            refuse(
                effects is not None,
                f"effects go with a trace or a session, got {effects!r} with a recording",
                TypeError,
            )
            self.title = player.recording.path.name
            self.state = f"{player.duration:.1f} s, {len(player.history.time)} poses; {player.note}"
        else:
            trace = player.trace
            self.title, self.note = trace.path.name, assumed(trace.notes)
            self.state = f"{player.duration:.1f} s, {player.ticks} ticks, seed {trace.seed}"
            ticks = np.array([event["tick"] for event in player.events], np.int64) - trace.first_tick
            self._add_events(player.history.time[np.clip(ticks, 0, player.ticks - 1)].tolist(), player.events)
            self.past = None if effects is None else ParcelHistory(trace, effects)
            self._background.append(
                threading.Thread(target=self._prepare, args=(player,), name="burrlab page", daemon=True)
            )
        self.has_effects, self.approach = effects is not None, trace_approach(player)
        self._cancel = threading.Event()
        self._take_over()

    @property
    def prepared(self) -> float:
        bone = self.player.prepared
        return bone if self.past is None else 0.5 * (bone + self.past.made)

    @property
    def parcels(self) -> NDArray[np.void] | None:
        return None if self.past is None else self.past.at(self.time)

    def go(self, seconds: float, *, progress: Progress | None = None) -> NDArray[np.uint32]:
        bricks = self.player.seek(seconds, progress=progress)
        self._take_over()
        return bricks

    def _take_over(self) -> None:
        player = self.player
        self.time, self.burrs, self.force, self.depth = player.time, player.burrs, player.force, player.depth

    def close(self) -> None:
        self._cancel.set()
        super().close()

    def _prepare(self, player: TracePlayer) -> None:
        if player.prepare(cancel=self._cancel) and self.past is not None:
            self.past.make(self._cancel)


class LiveSource(PageSource):
    """A running or ended session, or its replica: a copy of the bone takes over the changed bricks.

    Parameters and errors are those of `LiveView`; `tick` is the number of ticks shown.
    """

    kind = "live"

    def __init__(self, source: Session | Replica, effects: Companion | None = None) -> None:
        if isinstance(source, Session):
            view, about = source.follower.view(), source.provenance
            self._take: Callable[[], Any] = lambda: source.follower.take(view)
        elif isinstance(source, Replica):
            self._take, about = source.take, json.loads(source.hello)
        else:
            raise TypeError(f"source must be a Session or a Replica, got {type(source).__name__}")
        bone, self.tick = source.snapshot()  # after the view is made: nothing is missed
        super().__init__(bone, [float(tool["radius_mm"]) for tool in about["tools"]], about.get("watch"))
        self._source, self._effects, self.has_effects = source, effects, effects is not None
        self.title = "session" if isinstance(source, Session) else "replica"
        self.note = assumed(told_notes(about.get("source")))
        self._period = 1.0 / float(about["rate_Hz"])  # [s]
        self.span = 0.0, _SHOWN
        self._tell_state()

    @property
    def parcels(self) -> NDArray[np.void] | None:
        return None if self._effects is None else self._effects.parcels

    def go(self, seconds: float) -> NDArray[np.uint32]:
        update = self._take()
        self.tick, newest = update["tick"], update["newest"]
        if newest is not None:
            burr, before = newest["burr"][: len(self.radii)], self.time
            self.time = float(newest["time"])
            self.span = max(0.0, self.time - _SHOWN), max(self.time, _SHOWN)
            self.burrs = Burrs(burr["center"].copy(), self.burrs.radii, burr["on"] > 0, burr["touching"] > 0)
            self.force, self.depth = burr["force"].copy(), burr["penetration"].copy()
            past = self.history
            if not len(past.time) or self.time > before:
                recent = past.time >= self.time - _SHOWN
                self.history = History(
                    np.append(past.time[recent], self.time),
                    np.vstack([past.force[recent], np.linalg.norm(self.force, axis=1)]),
                    np.vstack([past.depth[recent], self.depth]),
                )
            self._hear()
        self._tell_state()
        bricks = brick_numbers(update["bricks"], self.bone)
        restore_bricks(self.bone, bricks, update["density"].reshape(-1, 512))
        return bricks

    def _tell_state(self) -> None:
        source = self._source
        if isinstance(source, Session):
            self.state = "running" if source.running else source.reason or "not started"
        else:
            self.state = str(source.status["reason"] or "ended") if source.wait(0.0) else "following"

    def _hear(self) -> None:
        """Takes over new events; their times follow from the newest tick's."""
        if self._structures:
            follower = self._source.follower if isinstance(self._source, Session) else self._source
            rows = Watched.of(follower.watched(len(self.events)), np.zeros(0, np.int64)).events
            times = [max(self.time - (self.tick - int(row["tick"])) * self._period, 0.0) for row in rows]
            self._add_events(times, rows)


def page_source(source: Shown, effects: Any = None) -> PageSource:
    """The page source of an object. TypeError if it cannot be shown, or the effects do not go with it."""
    if isinstance(source, Trace | TracePlayer | RecordingPlayer):
        refuse(
            not isinstance(effects, Effects | None),
            f"effects of a trace must be Effects, got {effects!r}",
            TypeError,
        )
        return ReplaySource(TracePlayer(source) if isinstance(source, Trace) else source, effects)
    if isinstance(source, Session | Replica):
        refuse(
            not isinstance(effects, Companion | None),
            f"effects of a session must be a Companion, got {effects!r}",
            TypeError,
        )
        return LiveSource(source, effects)
    if isinstance(source, VoxelBone):
        refuse(
            effects is not None,
            f"effects go with a trace or a session, got {effects!r} with a bone",
            TypeError,
        )
        return PageSource(source)
    raise TypeError(
        f"source must be a Trace, TracePlayer, RecordingPlayer, Session, Replica or VoxelBone, got {source!r}"
    )
