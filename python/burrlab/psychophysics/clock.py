"""The time of a run."""

from __future__ import annotations

import time


class Clock:
    """Seconds since a run began, which never go back and go on where the run was resumed.

    Parameters
    ----------
    began : float
        When the run was begun: seconds since 1970, as `time.time` has them.

    Notes
    -----
    The time of day is read once: a clock that is set while somebody takes part moves no onset.
    """

    def __init__(self, began: float) -> None:
        self._offset = time.time() - began - time.monotonic()

    def now(self) -> float:
        """[s]"""
        return self._offset + time.monotonic()

    def advance(self, seconds: float) -> None:
        """Tells that so much time of an interval has passed; on this clock it has."""


class VirtualClock(Clock):
    """A clock that only intervals move.

    Parameters
    ----------
    start : float
        [s]
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def now(self) -> float:
        return self._now

    def advance(self, seconds: float) -> None:
        self._now += seconds
