"""What a page shows: a trace with its player, a running session, or a bone that rests."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Replica, VoxelBone
from burrlab.session.session import Session
from burrlab.session.trace import Trace
from burrlab.view.approach import Approach, trace_approach
from burrlab.view.page_anatomy import PageEvent, StructureDistances, trace_events
from burrlab.view.page_live import LiveSource
from burrlab.view.page_parcels import ParcelHistory
from burrlab.view.player import Burrs, History, TracePlayer

if TYPE_CHECKING:
    from burrlab.effects import Effects

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
    from burrlab.effects import Companion, Effects

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
