"""What a page shows: a trace with its player, a running session, or a bone that rests."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone, restore_bricks
from burrlab.session.session import Session
from burrlab.session.trace import Trace
from burrlab.view.page_anatomy import StructureDistances, event_texts
from burrlab.view.player import Burrs, History, TracePlayer

_SHOWN_LIVE = 30.0  # of a running session in the charts [s]


class PageSource(Protocol):
    """The bone at a moment, and how to get to another one."""

    title: str
    kind: str  # "replay", "live" or "still"
    bone: VoxelBone
    tools: tuple[tuple[Any, Any], ...]

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
    def events(self) -> Sequence[tuple[float, str]]:
        """Time [s] and what happened then."""
        ...

    @property
    def state(self) -> str:
        """A word or sentence on the source itself."""
        ...

    def approach(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Where the bone was first met [mm], and the direction into it; None if that is not known."""
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

    def __init__(self, player: TracePlayer) -> None:
        self.player, self.bone = player, player.bone
        self.title = player.trace.path.name
        self.tools = player.trace.tools
        self._distances = StructureDistances(player.bone)
        self._cancel = threading.Event()
        self._thread = threading.Thread(target=self._prepare, name="burrlab page", daemon=True)
        self.state = f"{player.duration:.1f} s, {player.ticks} ticks, seed {player.trace.seed}"

    span = property(lambda self: (0.0, self.player.duration))
    time = property(lambda self: self.player.time)
    burrs = property(lambda self: self.player.burrs)
    force = property(lambda self: self.player.force)
    depth = property(lambda self: self.player.depth)
    history = property(lambda self: self.player.history)
    prepared = property(lambda self: self.player.prepared)
    events = property(lambda self: event_texts(self.player))

    def approach(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        burr = self.player.trace.ticks["burr"][:, 0]
        met = burr["touching"] > 0
        out = burr["force_N"][met].sum(axis=0)
        if not np.linalg.norm(out) > 0:
            return None
        return burr["center_mm"][met][0], -out / np.linalg.norm(out)

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
        self.player.prepare(cancel=self._cancel)


class LiveSource:
    """A session that runs or has ended: a bone of one's own that takes over the bricks that changed."""

    kind = "live"
    prepared = 1.0
    events: Sequence[tuple[float, str]] = ()

    def __init__(self, session: Session) -> None:
        self.session = session
        self.title = "session"
        self.tools = tuple(session.tools)
        self._view = session.follower.view()
        self.bone, _ = session.snapshot()
        self._distances = StructureDistances(self.bone)
        self._counts = tuple(-(-n // 8) for n in self.bone.shape)
        self._newest: Any = None
        self._past: deque[tuple[float, NDArray[np.float64], NDArray[np.float64]]] = deque()

    @property
    def time(self) -> float:
        return 0.0 if self._newest is None else float(self._newest["time"])

    @property
    def span(self) -> tuple[float, float]:
        return max(0.0, self.time - _SHOWN_LIVE), max(self.time, _SHOWN_LIVE)

    @property
    def burrs(self) -> Burrs:
        n, radii = len(self.tools), np.array([burr.radius for burr, _ in self.tools])
        if self._newest is None:
            none = np.zeros(n, bool)
            return Burrs(np.full((n, 3), np.nan), radii, none, none)
        burr = self._newest["burr"][:n]
        return Burrs(burr["center"].copy(), radii, burr["on"] > 0, burr["touching"] > 0)

    @property
    def force(self) -> NDArray[np.float64]:
        return self._of("force", (len(self.tools), 3))

    @property
    def depth(self) -> NDArray[np.float64]:
        return self._of("penetration", (len(self.tools),))

    @property
    def history(self) -> History:
        past = list(self._past)
        n = len(self.tools)
        return History(
            np.array([time for time, _, _ in past]),
            np.array([force for _, force, _ in past]).reshape(-1, n),
            np.array([depth for _, _, depth in past]).reshape(-1, n),
        )

    @property
    def state(self) -> str:
        return "running" if self.session.running else self.session.reason or "not started"

    def approach(self) -> None:
        return None

    def go(self, seconds: float) -> NDArray[np.uint32]:
        update = self.session.follower.take(self._view)
        if update["newest"] is not None:
            self._newest = update["newest"]
            if not self._past or self.time > self._past[-1][0]:
                self._past.append((self.time, np.linalg.norm(self.force, axis=1), self.depth))
            while self._past[0][0] < self.time - _SHOWN_LIVE:
                self._past.popleft()
        places = update["bricks"]
        if not len(places):
            return np.empty(0, np.uint32)
        bricks = np.ravel_multi_index(tuple(places.T), self._counts).astype(np.uint32)
        restore_bricks(self.bone, bricks, update["density"].reshape(-1, 512))
        return bricks

    def distances(self) -> list[dict[str, Any]]:
        return self._distances.rows(self.burrs)

    def open(self) -> None:
        self._distances.open()

    def close(self) -> None:
        self._distances.close()

    def _of(self, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        if self._newest is None:
            return np.zeros(shape)
        values: NDArray[np.float64] = self._newest["burr"][name][: shape[0]].copy()
        return values


class StillSource:
    """A bone, and nothing that happens to it."""

    kind = "still"
    title = "bone"
    tools = ()
    span = (0.0, 0.0)
    time = 0.0
    prepared = 1.0
    events: Sequence[tuple[float, str]] = ()

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


def page_source(source: Trace | TracePlayer | Session | VoxelBone) -> PageSource:
    """The source of a page. TypeError if it is none."""
    if isinstance(source, Trace):
        return ReplaySource(TracePlayer(source))
    if isinstance(source, TracePlayer):
        return ReplaySource(source)
    if isinstance(source, Session):
        return LiveSource(source)
    if isinstance(source, VoxelBone):
        return StillSource(source)
    raise TypeError(f"source must be a Trace, TracePlayer, Session or VoxelBone, got {source!r}")
