"""What a page says of critical structures: how near the burrs are, and what happened.

Dust, blood and water of a recorded session at its moments, made once from its beginning to its end.

A running session, or a replica of one, for a page.

What a page shows: a trace with its player, a running session, or a bone that rests.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Replica, VoxelBone, restore_bricks
from burrlab.anatomy.events import KINDS, Watched
from burrlab.anatomy.watch import Watch
from burrlab.effects.companion import Companion
from burrlab.effects.effects import Effects, effects_of
from burrlab.session.player import Burrs, History, TracePlayer
from burrlab.session.session import Session
from burrlab.session.trace import Trace
from burrlab.view.camera import Approach, trace_approach
from burrlab.view.live import _radii, _taker
from burrlab.view.surface import brick_numbers

_KINDS = {  # what is said of an event, and its colour
    "approach": ("approach to", "#ffb454"),
    "touch": ("touch of", "#ff7b72"),
    "injury": ("injury of", "#ff7b72"),
    "away": ("away from", "#7a8791"),
}


@dataclass(frozen=True)
class PageEvent:
    """Something that happened: when [s], in words, and the colour of its mark."""

    time: float
    text: str
    colour: str


class StructureDistances:
    """Distance of the nearest burr's surface to each critical structure of a bone; its fields are made in the background.

    Parameters
    ----------
    bone : VoxelBone
        One without critical tissues gives no rows.
    settings : mapping, optional
        Of the watch that looked at it; default: one of all critical tissues.
    """

    def __init__(self, bone: VoxelBone, settings: Mapping[str, Any] | None = None) -> None:
        tissues = bone.tissues
        self._watch: Any = None
        self._settings = settings
        self._bone: VoxelBone | None = None
        if tissues is not None and (settings or any(tissue.critical for tissue in tissues)):
            self._bone = bone.copy()  # the other goes on changing
        self._thread = threading.Thread(target=self._make, name="burrlab distances", daemon=True)

    def open(self) -> None:
        """Starts the work."""
        if self._bone is not None:
            self._thread.start()

    def close(self) -> None:
        """Waits for its end."""
        if self._thread.ident is not None:
            self._thread.join()

    @property
    def ready(self) -> bool:
        """All is there that will be."""
        return self._bone is None

    def rows(self, burrs: Burrs) -> list[dict[str, Any]]:
        """name, colour, value [mm] and near (below the approach's limit), a structure each; empty until it is ready."""
        watch = self._watch
        known = np.isfinite(burrs.centers).all(axis=1)
        if watch is None or not known.any():
            return []
        rows = []
        for name, colour, limit in zip(watch.structures, watch.colours, watch.limits, strict=True):
            nearest = min(
                float(watch.distance(center, name, radius=float(radius)))
                for center, radius in zip(burrs.centers[known], burrs.radii[known], strict=True)
            )
            rows.append({
                "name": name, "colour": "rgb({}, {}, {})".format(*colour), "near": nearest <= limit.approach,
                "value": f"{nearest:.2f}" if np.isfinite(nearest) else "far",
            })  # fmt: skip
        return rows

    def _make(self) -> None:
        assert self._bone is not None
        try:
            self._watch = (
                Watch.of_settings(self._bone, self._settings) if self._settings else Watch(self._bone)
            )
        except ValueError:  # no voxel of a critical tissue
            pass
        finally:
            self._bone = None


def page_event(time: float, row: np.void, structures: Sequence[str]) -> PageEvent:
    """Of a row of a trace's or a watch's events."""
    kind, distance = KINDS[int(row["kind"])], float(row["distance_mm"])
    what, colour = _KINDS[kind]
    text = f"{what} {structures[int(row['structure'])]}"
    told = kind in ("approach", "away") and np.isfinite(distance)
    return PageEvent(time, f"{text}, {distance:.2f} mm" if told else text, colour)


def trace_events(player: TracePlayer) -> list[PageEvent]:
    """Those that a trace holds."""
    trace, events = player.trace, player.events
    if not len(events):
        return []
    names = [row["name"] for row in trace.watch["structures"]]
    at = [min(max(int(event["tick"]) - trace.first_tick, 0), player.ticks - 1) for event in events]
    return [
        page_event(float(player.history.time[i]), event, names) for i, event in zip(at, events, strict=True)
    ]


#: What is drawn of a parcel, as finely as it is seen: within 0.03 mm, and shares of 255.
_DTYPE = np.dtype([("position", "f2", 3), ("radius", "f2"), ("dust", "u1"), ("blood", "u1"), ("water", "u1")])
_SUBSTANCES = ("dust", "blood", "water")
_RATE = 20.0  # frames of a second of the trace that are made [Hz]


class ParcelHistory:
    """Frames of a trace's parcels, in bounded memory: where they take more, every second one is given up.

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
        self._frames: list[NDArray[np.void]] = []  # at the ends of `_every` frames of effects, each
        self._every, self._made = 1, 0

    @property
    def made(self) -> float:
        """Part of the trace, 0 to 1."""
        frames = self._duration * _RATE
        return min(1.0, self._made / frames) if frames else 1.0

    @property
    def bytes(self) -> int:
        """That the kept frames take."""
        with self._lock:
            return sum(frame.nbytes for frame in self._frames)

    def make(self, cancel: threading.Event | None = None) -> bool:
        """All of it; may run in a thread. Returns whether it came to the end."""
        player = TracePlayer(self._trace, every=self._duration + 1.0)  # goes forward only
        size = 0
        for _ in effects_of(player, self._effects, rate=_RATE):
            if cancel is not None and cancel.is_set():
                return False
            self._made += 1
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
        """Of the newest kept frame that is not after this time; None where there is none yet."""
        with self._lock:
            i = int(seconds * _RATE / self._every + 1e-6)
            if not 0 < i <= len(self._frames):
                return None
            return self._frames[i - 1]


def _drawn(parcels: NDArray[np.void]) -> NDArray[np.void]:
    frame = np.empty(len(parcels), _DTYPE)
    frame["position"], frame["radius"] = parcels["position"], parcels["radius"]
    whole = np.maximum(sum(parcels[name] for name in _SUBSTANCES), 1)
    for name in _SUBSTANCES:
        frame[name] = np.rint(255.0 * parcels[name] / whole)
    return frame


_SHOWN = 30.0  # in the charts [s]


class LiveSource:
    """What runs or has ended: a bone of one's own that takes over the bricks that changed.

    Parameters
    ----------
    source : Session or Replica
        A replica must have been started, and nothing else may take what changed of it.
    effects : optional
        Whatever has `parcels`, as `burrlab.effects.Companion`.
    """

    kind = "live"
    prepared = 1.0

    def __init__(self, source: Session | Replica, effects: Any = None) -> None:
        self._source, self._effects = source, effects
        self.has_effects = effects is not None
        self.title = "session" if isinstance(source, Session) else "replica"
        self.radii = tuple(_radii(source))
        self._take = _taker(source)
        self.bone, _ = source.snapshot()  # after the view was made: nothing is missed
        about = source.provenance if isinstance(source, Session) else json.loads(source.hello)
        self._period = 1.0 / float(about["rate_Hz"])  # [s]
        watch = about.get("watch")
        self._structures = [str(row["name"]) for row in watch["structures"]] if watch else []
        self._distances = StructureDistances(self.bone, watch)
        self.events: list[PageEvent] = []
        self._newest: Any = None
        self._past: deque[tuple[float, NDArray[np.float64], NDArray[np.float64]]] = deque()

    @property
    def time(self) -> float:
        return 0.0 if self._newest is None else float(self._newest["time"])

    @property
    def span(self) -> tuple[float, float]:
        return max(0.0, self.time - _SHOWN), max(self.time, _SHOWN)

    @property
    def burrs(self) -> Burrs:
        n, radii = len(self.radii), np.array(self.radii)
        if self._newest is None:
            none = np.zeros(n, bool)
            return Burrs(np.full((n, 3), np.nan), radii, none, none)
        burr = self._newest["burr"][:n]
        return Burrs(burr["center"].copy(), radii, burr["on"] > 0, burr["touching"] > 0)

    @property
    def force(self) -> NDArray[np.float64]:
        return self._of("force", (len(self.radii), 3))

    @property
    def depth(self) -> NDArray[np.float64]:
        return self._of("penetration", (len(self.radii),))

    @property
    def history(self) -> History:
        past, n = list(self._past), len(self.radii)
        return History(
            np.array([time for time, _, _ in past]),
            np.array([force for _, force, _ in past]).reshape(-1, n),
            np.array([depth for _, _, depth in past]).reshape(-1, n),
        )

    @property
    def state(self) -> str:
        source = self._source
        if isinstance(source, Session):
            return "running" if source.running else source.reason or "not started"
        return str(source.status["reason"] or "ended") if source.wait(0.0) else "following"

    @property
    def parcels(self) -> NDArray[np.void] | None:
        return None if self._effects is None else self._effects.parcels

    def approach(self) -> None:
        return None

    def go(self, seconds: float) -> NDArray[np.uint32]:
        update = self._take()
        if update["newest"] is not None:
            self._newest = update["newest"]
            if not self._past or self.time > self._past[-1][0]:
                self._past.append((self.time, np.linalg.norm(self.force, axis=1), self.depth))
            while self._past[0][0] < self.time - _SHOWN:
                self._past.popleft()
            self._hear(update["tick"])
        if not len(update["bricks"]):
            return np.empty(0, np.uint32)
        bricks = brick_numbers(update["bricks"], self.bone)
        restore_bricks(self.bone, bricks, update["density"].reshape(-1, 512))
        return bricks

    def distances(self) -> list[dict[str, Any]]:
        return self._distances.rows(self.burrs)

    def open(self) -> None:
        self._distances.open()

    def close(self) -> None:
        self._distances.close()

    def _hear(self, tick: int) -> None:
        """Events that are new; when they were follows from the newest tick's time."""
        if not self._structures:
            return
        source = self._source
        asked = source.follower if isinstance(source, Session) else source
        rows = Watched.of(asked.watched(len(self.events)), np.zeros(0, np.int64)).events
        for row in rows:
            at = max(self.time - (tick - int(row["tick"])) * self._period, 0.0)
            self.events.append(page_event(at, row, self._structures))

    def _of(self, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        if self._newest is None:
            return np.zeros(shape)
        values: NDArray[np.float64] = self._newest["burr"][name][: shape[0]].copy()
        return values


#: What a page can show.
Shown: TypeAlias = Trace | TracePlayer | Session | Replica | VoxelBone


class PageSource(Protocol):
    """The bone at a moment, and how to get to another one."""

    @property
    def kind(self) -> str:
        """replay, live or still."""
        ...

    @property
    def title(self) -> str: ...
    @property
    def bone(self) -> VoxelBone: ...
    @property
    def radii(self) -> tuple[float, ...]:
        """Of the burrs [mm]."""
        ...

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment of the charts [s]."""
        ...

    @property
    def time(self) -> float: ...
    @property
    def burrs(self) -> Burrs: ...
    @property
    def force(self) -> NDArray[np.float64]: ...
    @property
    def depth(self) -> NDArray[np.float64]: ...
    @property
    def history(self) -> History: ...
    @property
    def prepared(self) -> float: ...
    @property
    def events(self) -> Sequence[PageEvent]: ...
    @property
    def parcels(self) -> NDArray[np.void] | None:
        """Dust, blood and water at the moment; None where there are no effects."""
        ...

    @property
    def has_effects(self) -> bool: ...
    @property
    def state(self) -> str:
        """A word or sentence on the source itself."""
        ...

    def approach(self) -> Approach | None:
        """Into the bone; None if that is not known."""
        ...

    def go(self, seconds: float) -> NDArray[np.uint32]:
        """To that moment, or to the newest one of what runs; numbers of the bricks that changed."""
        ...

    def distances(self) -> list[dict[str, Any]]:
        """Rows for the page: name, colour, value [mm], whether it is near."""
        ...

    def open(self) -> None: ...
    def close(self) -> None: ...


class ReplaySource:
    """A trace, prepared in the background while it can already be looked at."""

    kind = "replay"

    def __init__(self, player: TracePlayer, effects: Effects | None = None) -> None:
        self.player, self.bone = player, player.bone
        self.title = player.trace.path.name
        self.radii = tuple(burr.radius for burr, _ in player.trace.tools)
        self.events = trace_events(player)
        self._distances = StructureDistances(player.bone, player.trace.watch)
        self._past = None if effects is None else ParcelHistory(player.trace, effects)
        self.has_effects = effects is not None
        self._cancel = threading.Event()
        self._thread = threading.Thread(target=self._prepare, name="burrlab page", daemon=True)
        self.state = f"{player.duration:.1f} s, {player.ticks} ticks, seed {player.trace.seed}"

    span = property(lambda self: (0.0, self.player.duration))
    time = property(lambda self: self.player.time)
    burrs = property(lambda self: self.player.burrs)
    force = property(lambda self: self.player.force)
    depth = property(lambda self: self.player.depth)
    history = property(lambda self: self.player.history)

    @property
    def prepared(self) -> float:
        bone = self.player.prepared
        return bone if self._past is None else 0.5 * (bone + self._past.made)

    @property
    def parcels(self) -> NDArray[np.void] | None:
        return None if self._past is None else self._past.at(self.time)

    def approach(self) -> Approach | None:
        return trace_approach(self.player)

    def go(self, seconds: float) -> NDArray[np.uint32]:
        return self.player.seek(min(max(seconds, 0.0), self.player.duration))

    def distances(self) -> list[dict[str, Any]]:
        return self._distances.rows(self.burrs)

    def open(self) -> None:
        self._thread.start()
        self._distances.open()

    def close(self) -> None:
        self._cancel.set()
        self._distances.close()
        if self._thread.ident is not None:
            self._thread.join()

    def _prepare(self) -> None:
        if self.player.prepare(cancel=self._cancel) and self._past is not None:
            self._past.make(self._cancel)


class StillSource:
    """A bone, and nothing that happens to it."""

    kind = "still"
    title = "bone"
    radii: tuple[float, ...] = ()
    span = (0.0, 0.0)
    time = 0.0
    prepared = 1.0
    events: Sequence[PageEvent] = ()
    parcels = None
    has_effects = False

    def __init__(self, bone: VoxelBone) -> None:
        self.bone = bone
        self.burrs = Burrs(np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool), np.zeros(0, bool))
        self.force, self.depth = np.zeros((0, 3)), np.zeros(0)
        self.history = History(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))
        self.state = f"{bone.mass:.0f} mm³ of bone"

    def approach(self) -> None:
        return None

    def go(self, seconds: float) -> NDArray[np.uint32]:
        return np.empty(0, np.uint32)

    def distances(self) -> list[dict[str, Any]]:
        return []

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass


def page_source(source: Shown, effects: Any = None) -> PageSource:
    """The source of a page. TypeError if it is none, or its effects are not of its kind."""
    if isinstance(source, Trace | TracePlayer):
        if not isinstance(effects, Effects | None):
            raise TypeError(f"effects of a trace must be Effects, got {effects!r}")
        return ReplaySource(TracePlayer(source) if isinstance(source, Trace) else source, effects)
    if isinstance(source, Session | Replica):
        if not isinstance(effects, Companion | None):
            raise TypeError(f"effects of a session must be a Companion, got {effects!r}")
        return LiveSource(source, effects)
    if isinstance(source, VoxelBone):
        if effects is not None:
            raise TypeError(f"effects go with a trace or a session, got {effects!r} with a bone")
        return StillSource(source)
    raise TypeError(f"source must be a Trace, TracePlayer, Session, Replica or VoxelBone, got {source!r}")
