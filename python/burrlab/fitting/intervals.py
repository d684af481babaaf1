"""Intervals, regions and profiles of a likelihood, as a fit keeps them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from burrlab.common.check import nearest, refuse
from burrlab.common.table import by_value
from burrlab.fitting.observations import Floats

LEVELS: Mapping[str, float] = {"68": 0.68, "95": 0.95, "99.7": 0.997}


def level_name(level: str | float) -> str:
    """ "95" of 95 or "95"; ValueError for a level that a fit does not keep."""
    name = f"{level:g}" if isinstance(level, int | float) else level
    refuse(name not in LEVELS, f"level must be one of {', '.join(LEVELS)}: got {level!r}")
    return name


@dataclass(frozen=True)
class Interval:
    """A range at one level; None is an open end, where the data give no limit."""

    lower: float | None
    upper: float | None

    @property
    def closed(self) -> bool:
        return self.lower is not None and self.upper is not None

    def __contains__(self, value: float) -> bool:
        return (self.lower is None or value >= self.lower) and (self.upper is None or value <= self.upper)

    def ratio(self) -> float:
        """Upper over lower end; infinite where one is open."""
        return self.upper / self.lower if self.upper is not None and self.lower else np.inf


class ByLevel(dict[str, Interval]):
    """Intervals by level: ["95"] and [95] are one."""

    def __getitem__(self, level: str | float) -> Interval:
        return super().__getitem__(level_name(level))


class ByName(dict[str, ByLevel]):
    """Intervals by the name of a quantity, and by level."""

    def __missing__(self, name: object) -> ByLevel:
        raise ValueError(f"intervals are of {', '.join(self)}: got {name!r}{nearest(name, self)}")


def plain_ends(intervals: Mapping[str, Mapping[str, Interval]]) -> dict[str, dict[str, list[float | None]]]:
    """Intervals by name and level as [lower, upper], ready for JSON."""
    return {
        name: {level: [ends.lower, ends.upper] for level, ends in levels.items()}
        for name, levels in intervals.items()
    }


@by_value
@dataclass(frozen=True)
class Region:
    """The joint region of a level: at each c_e [N/mm^2] the alphas [1/ms] inside it, shape (m,)."""

    c_e: Floats
    lower: Floats
    upper: Floats
    open_above: bool  #: the region has no upper end in c_e

    def __contains__(self, point: tuple[float, float]) -> bool:
        c_e, alpha = point
        if not len(self.c_e) or not self.c_e[0] <= c_e <= self.c_e[-1]:
            return False
        x = np.log(self.c_e)
        with np.errstate(divide="ignore"):
            low, high = (np.interp(np.log(c_e), x, np.log(edge)) for edge in (self.lower, self.upper))
        return bool(low <= np.log(alpha) <= high)


@dataclass(frozen=True)
class Combination:
    """alpha/c_e^exponent, the combination that the data determine best.

    The exponent makes the 95 % profile interval shortest; at a bound that a window sets several do, and it is
    their middle. Where c_e is open above, it is the ridge's, 4 (k + 1)/3, the only one with a closed
    interval.
    """

    exponent: float
    value: float  #: [1/ms (mm^2/N)^exponent]
    intervals: Mapping[str, Interval]

    def __post_init__(self) -> None:
        object.__setattr__(self, "intervals", ByLevel(self.intervals))

    @property
    def interval(self) -> Interval:
        """At 95 %."""
        return self.intervals["95"]


@by_value
@dataclass(frozen=True)
class Profile:
    """Intervals and regions of a likelihood, and the curves they come from.

    Attributes
    ----------
    c_e, c_e_rise : ndarray, shape (m,)
        c_e [N/mm^2] and the rise of -2 log L over its minimum at the best alpha.
    best_alpha : ndarray, shape (m,)
        alpha [1/ms] at each c_e.
    alpha, alpha_rise : ndarray, shape (k,)
        alpha [1/ms] and the rise at the best c_e.
    limits : mapping
        Level -> rise that bounds c_e's interval; see `Calibration`.
    intervals : mapping
        ``c_e``, ``alpha`` -> level ``68``, ``95``, ``99.7`` -> Interval.
    identified : Combination
    regions : mapping
        Level -> Region.
    at_infinity : float
        Rise of -2 log L at the far end of the ridge, c_e without limit; NaN where c_e has a hard upper end.
    base : float
        The minimum of -2 log L, without constants.
    """

    c_e: Floats
    c_e_rise: Floats
    best_alpha: Floats
    alpha: Floats
    alpha_rise: Floats
    limits: Mapping[str, float]
    intervals: Mapping[str, Mapping[str, Interval]]
    identified: Combination
    regions: Mapping[str, Region]
    at_infinity: float
    base: float = 0.0

    def __post_init__(self) -> None:
        by_level = ByName({name: ByLevel(levels) for name, levels in self.intervals.items()})
        object.__setattr__(self, "intervals", by_level)
