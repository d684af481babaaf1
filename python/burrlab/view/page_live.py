"""A running session, or a replica of one, for a page."""

from __future__ import annotations

import json
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Replica, restore_bricks
from burrlab.session.session import Session
from burrlab.session.watch_rows import Watched
from burrlab.view.live import _radii, _taker
from burrlab.view.page_anatomy import PageEvent, StructureDistances, page_event
from burrlab.view.player import Burrs, History
from burrlab.view.surface import brick_numbers

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
