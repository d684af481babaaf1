"""The time of a run, to which onsets count."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable


class Clock(ABC):
    """Seconds since the start of a run, across resumptions."""

    @abstractmethod
    def now(self) -> float:
        """[s]"""

    @abstractmethod
    def rendered(self, seconds: float) -> None:
        """An interval has been rendered that lasted so long [s]."""


class WallClock(Clock):
    """Time as it passes.

    Parameters
    ----------
    elapsed : callable
        Since the start of the run [s], such as `AnswerFile.elapsed`.
    """

    def __init__(self, elapsed: Callable[[], float]) -> None:
        self._elapsed = elapsed

    def now(self) -> float:
        return self._elapsed()

    def rendered(self, seconds: float) -> None:
        """It has passed already."""


class VirtualClock(Clock):
    """Only intervals take time.

    Parameters
    ----------
    start : float
        [s]
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def now(self) -> float:
        return self._now

    def rendered(self, seconds: float) -> None:
        self._now += seconds
