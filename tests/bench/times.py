"""Times of ticks, and what is said of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

Name = TypeVar("Name")

FEWEST = 5  # undisturbed ticks for a median
CHUNK = 25  # ticks of one before the next one's turn


@dataclass(frozen=True)
class Times:
    """Wall-clock times of ticks.

    A tick in which another process takes the core measures that process. The longer the tick, the likelier this
    is, so that on a busy machine it would distort ratios: such ticks count only where hardly any other is left.

    Parameters
    ----------
    seconds : ndarray
        NaN where a tick was not made.
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
    def made(self) -> NDArray[np.bool_]:
        return np.isfinite(self.seconds)

    @property
    def median(self) -> float:
        """Of the ticks that count [s]."""
        return float(np.median(undisturbed(self.seconds[self.made], self.interrupted[self.made])))

    @property
    def percentile_95(self) -> float:
        """Of all ticks, interrupted ones too [s]."""
        return float(np.percentile(self.seconds[self.made], 95))

    @property
    def share_interrupted(self) -> float:
        return float(np.mean(self.interrupted[self.made]))

    def over(self, other: Times) -> Numbers:
        """Ratios, tick by tick, of the ticks that both made."""
        both = self.made & other.made
        ratio = self.seconds[both] / other.seconds[both]
        return undisturbed(ratio, (self.interrupted | other.interrupted)[both])


def undisturbed(values: Numbers, interrupted: NDArray[np.bool_]) -> Numbers:
    """Without the interrupted ones, unless too few are left."""
    quiet = values[~interrupted]
    return quiet if len(quiet) >= min(FEWEST, len(values)) else values


def quartiles(values: Numbers) -> dict[str, float] | None:
    """Median, quartiles and number; None without values."""
    if len(values) == 0:
        return None
    low, median, high = np.percentile(values, [25, 50, 75]).tolist()
    return {"median": median, "quartile_1": low, "quartile_3": high, "ticks": len(values)}


def in_turns(
    runs: dict[Name, tuple[Numbers, Callable[[int, Numbers], Times]]],
) -> dict[Name, Times]:
    """Paths of one length, CHUNK ticks of one before the next one's turn; the first tenth is not counted.

    Each is called with the number of its first tick, and the centres of the burr.
    """
    found: dict[Name, list[Times]] = {name: [] for name in runs}
    ticks = max(len(path) for path, _ in runs.values())
    for begin in range(0, ticks, CHUNK):
        for name, (path, run) in runs.items():
            found[name].append(run(begin, path[begin : begin + CHUNK]))
    return {name: Times.join(parts)[ticks // 10 :] for name, parts in found.items()}
