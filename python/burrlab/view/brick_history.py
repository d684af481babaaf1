"""Levels of a bone's bricks at key ticks, so that any of these states can be had again."""

from __future__ import annotations

import bisect
import threading

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone, read_bricks


class BrickHistory:
    """States of a bone, each kept as the bricks that changed since the one before.

    Where they take more room than `memory` every second one is given up, as often as needed: what is left goes back to
    the beginning all the same, in wider steps. Safe to use from several threads.

    Parameters
    ----------
    initial : VoxelBone
        The bone at tick 0; kept, not copied, and never changed.
    memory : int
        For levels [bytes].
    """

    def __init__(self, initial: VoxelBone, memory: int) -> None:
        self._initial, self._memory = initial, memory
        self._ticks = [0]
        self._bricks: list[NDArray[np.uint32]] = [np.empty(0, np.uint32)]
        self._levels: list[NDArray[np.uint8]] = [np.empty((0, 512), np.uint8)]
        self._bytes = self.thinned = 0
        self.lock = threading.RLock()  # for several calls on one set of states
        self._bits = np.zeros(int(np.prod([-(-n // 8) for n in initial.shape])), bool)

    def __len__(self) -> int:
        """Number of states, the initial one included."""
        return len(self._ticks)

    @property
    def bytes(self) -> int:
        """That the kept levels take."""
        return self._bytes

    @property
    def last(self) -> int:
        """Tick of the newest state."""
        return self._ticks[-1]

    def at_or_before(self, tick: int) -> int:
        """Tick of the newest state that is not after a tick."""
        with self.lock:
            return self._ticks[bisect.bisect_right(self._ticks, tick) - 1]

    def after(self, tick: int) -> int | None:
        """Tick of the first state after a tick; None if there is none."""
        with self.lock:
            i = bisect.bisect_right(self._ticks, tick)
            return self._ticks[i] if i < len(self._ticks) else None

    def add(self, tick: int, bricks: NDArray[np.uint32], bone: VoxelBone) -> None:
        """Keeps the state at a tick. `bricks` are all that changed since the newest one; another's state is no news."""
        with self.lock:
            if tick <= self.last:
                return
            self._append(tick, bricks, read_bricks(bone, bricks))
            while self._bytes > self._memory and len(self._ticks) > 2:
                self._thin()

    def changed_between(self, one: int, other: int) -> NDArray[np.uint32]:
        """Bricks that may differ between the bone at two ticks, in order; up to the newest state."""
        low, high = min(one, other), max(one, other)
        with self.lock:
            first = bisect.bisect_right(self._ticks, low)
            last = bisect.bisect_left(self._ticks, high) + 1
            return _union(self._bricks[first:last])

    def levels(self, bricks: NDArray[np.uint32], tick: int) -> NDArray[np.uint8]:
        """Levels of bricks in the state at a tick, shape (n, 512)."""
        levels = np.empty((len(bricks), 512), np.uint8)
        with self.lock:
            wanted, left = self._bits, len(bricks)
            wanted[bricks] = True
            i = bisect.bisect_right(self._ticks, tick) - 1
            while left and i > 0:  # newest first: the first that holds a brick is right
                kept = self._bricks[i]
                rows = np.flatnonzero(wanted[kept])
                if len(rows):
                    levels[np.searchsorted(bricks, kept[rows])] = self._levels[i][rows]
                    wanted[kept[rows]] = False
                    left -= len(rows)
                i -= 1
            rest = wanted[bricks]
            wanted[bricks] = False
        levels[rest] = read_bricks(self._initial, bricks[rest])
        return levels

    def _append(self, tick: int, bricks: NDArray[np.uint32], levels: NDArray[np.uint8]) -> None:
        self._ticks.append(tick)
        self._bricks.append(bricks)
        self._levels.append(levels)
        self._bytes += levels.nbytes

    def _thin(self) -> None:
        """Gives up every second state; never the newest, to which the changes since then refer."""
        ticks, bricks, levels = self._ticks, self._bricks, self._levels
        self._ticks, self._bricks, self._levels, self._bytes = ticks[:1], bricks[:1], levels[:1], 0
        self.thinned += 1
        for i in range(1 + len(ticks) % 2, len(ticks), 2):
            if i == 1:
                self._append(ticks[1], bricks[1], levels[1])
                continue
            only = ~np.isin(bricks[i - 1], bricks[i])
            both = np.concatenate([bricks[i - 1][only], bricks[i]])
            order = np.argsort(both)
            merged = np.concatenate([levels[i - 1][only], levels[i]])[order]
            self._append(ticks[i], both[order], merged)


def _union(parts: list[NDArray[np.uint32]]) -> NDArray[np.uint32]:
    """Sorted, each once."""
    return np.unique(np.concatenate([*parts, np.empty(0, np.uint32)]))
