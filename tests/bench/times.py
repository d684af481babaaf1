"""Times of ticks and their statistics."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

Name = TypeVar("Name")

FEWEST = 5  # undisturbed ticks for a median
CHUNK = 25  # ticks of one run before the turn of the next


@dataclass(frozen=True)
class Times:
    """Wall-clock times of ticks.

    If another process takes the core during a tick, the time includes that process. This is likelier for
    longer ticks, so it would distort ratios: such ticks count only where hardly any others are left.

    Parameters
    ----------
    seconds : ndarray
    interrupted : ndarray of bool
        Whether another process took the core meanwhile.
    """

    seconds: Numbers
    interrupted: NDArray[np.bool_]

    @classmethod
    def empty(cls, count: int) -> Times:
        return cls(np.full(count, np.nan), np.zeros(count, dtype=bool))

    @classmethod
    def join(cls, parts: Sequence[Times]) -> Times:
        return cls(np.concatenate([t.seconds for t in parts]), np.concatenate([t.interrupted for t in parts]))

    def __getitem__(self, which: slice) -> Times:
        return Times(self.seconds[which], self.interrupted[which])

    @property
    def median(self) -> float:
        """Median of the ticks that count [s]."""
        return float(np.median(undisturbed(self.seconds, self.interrupted)))

    def over(self, other: Times) -> Numbers:
        """Tick-by-tick ratios."""
        return undisturbed(self.seconds / other.seconds, self.interrupted | other.interrupted)


def timed(work: Callable[..., object], *arguments: Any, **options: Any) -> float:
    """Wall time of a call [s]."""
    start = time.perf_counter()
    work(*arguments, **options)
    return time.perf_counter() - start


@contextmanager
def on_one_core() -> Iterator[None]:
    """Keeps this process on one core, if the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    yield
    os.sched_setaffinity(0, before)


def undisturbed(values: Numbers, interrupted: NDArray[np.bool_]) -> Numbers:
    """Values without the interrupted ones, unless too few are left."""
    quiet = values[~interrupted]
    return quiet if len(quiet) >= min(FEWEST, len(values)) else values


def quartiles(values: Numbers) -> dict[str, float]:
    """Median, quartiles and number."""
    low, median, high = np.percentile(values, [25, 50, 75]).tolist()
    return {"median": median, "quartile_1": low, "quartile_3": high, "ticks": len(values)}


def in_turns(
    runs: dict[Name, tuple[Numbers, Callable[[int, Numbers], Times]]],
) -> dict[Name, Times]:
    """Times of runs over paths of one length, CHUNK ticks of each in turn, without the first tenth.

    Each run is called with the number of its first tick and the centres of the burr.
    """
    found: dict[Name, list[Times]] = {name: [] for name in runs}
    ticks = max(len(path) for path, _ in runs.values())
    for begin in range(0, ticks, CHUNK):
        for name, (path, run) in runs.items():
            found[name].append(run(begin, path[begin : begin + CHUNK]))
    return {name: Times.join(parts)[ticks // 10 :] for name, parts in found.items()}
