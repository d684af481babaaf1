"""Profile likelihoods: best point, intervals of c_e, alpha and their best combination, and the joint region.

The best alpha has a closed form at each c_e, so one walk along c_e gives everything. The best point is the
lowest of the walk. The interval of a quantity at a level is its range over the points whose -2 log L has
risen by less than the level's limit.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from burrlab.common.check import check_same_length, nearest, refuse
from burrlab.common.study import stored_as
from burrlab.common.table import by_value
from burrlab.fitting.calibration import AnyCalibration, MixedCalibration
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.observations import Box, Floats, bounds_of
from burrlab.fitting.slices import AlphaSlices

LEVELS: Mapping[str, float] = {"68": 0.68, "95": 0.95, "99.7": 0.997}


def level_name(level: str | float) -> str:
    """ "95" of 95 or "95"; ValueError for a level that a fit does not keep."""
    name = f"{level:g}" if isinstance(level, int | float) else level
    refuse(name not in LEVELS, f"level must be one of {', '.join(LEVELS)}: got {level!r}")
    return name


@stored_as("burrlab.fitting.profile.Interval")
@dataclass(frozen=True)
class ConfidenceInterval:
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


class ByLevel(dict[str, ConfidenceInterval]):
    """Intervals by level: ["95"] and [95] are one."""

    def __getitem__(self, level: str | float) -> ConfidenceInterval:
        return super().__getitem__(level_name(level))


class ByName(dict[str, ByLevel]):
    """Intervals by the name of a quantity, and by level."""

    def __missing__(self, name: object) -> ByLevel:
        raise ValueError(f"intervals are of {', '.join(self)}: got {name!r}{nearest(name, self)}")


def plain_ends(
    intervals: Mapping[str, Mapping[str, ConfidenceInterval]],
) -> dict[str, dict[str, list[float | None]]]:
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

    def __post_init__(self) -> None:
        check_same_length(c_e=self.c_e, lower=self.lower, upper=self.upper)

    def __contains__(self, point: tuple[float, float]) -> bool:
        c_e, alpha = point
        if not len(self.c_e) or not self.c_e[0] <= c_e <= self.c_e[-1]:
            return False
        with np.errstate(divide="ignore"):
            low, high = (
                np.interp(np.log(c_e), np.log(self.c_e), np.log(edge)) for edge in (self.lower, self.upper)
            )
        return bool(low <= np.log(alpha) <= high)


@dataclass(frozen=True)
class Combination:
    """alpha/c_e^exponent, the combination that the data determine best.

    The exponent makes the 95 % profile interval shortest; at a bound that a window sets several do, and it is
    their middle. In a fit with groups or offsets it makes the standard error smallest. Where c_e is open above, it is the ridge's, 4 (k + 1)/3, the only one with a closed
    interval.
    """

    exponent: float
    value: float  #: [1/ms (mm^2/N)^exponent]
    intervals: Mapping[str, ConfidenceInterval]

    def __post_init__(self) -> None:
        object.__setattr__(self, "intervals", ByLevel(self.intervals))

    @property
    def interval(self) -> ConfidenceInterval:
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
        ``c_e``, ``alpha`` -> level ``68``, ``95``, ``99.7`` -> ConfidenceInterval.
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
    intervals: Mapping[str, Mapping[str, ConfidenceInterval]]
    identified: Combination
    regions: Mapping[str, Region]
    at_infinity: float
    base: float = 0.0

    def __post_init__(self) -> None:
        check_same_length(c_e=self.c_e, c_e_rise=self.c_e_rise, best_alpha=self.best_alpha)
        check_same_length(alpha=self.alpha, alpha_rise=self.alpha_rise)
        object.__setattr__(
            self, "intervals", ByName({name: ByLevel(levels) for name, levels in self.intervals.items()})
        )


C_E, ALPHA = np.array([1.0, 0.0]), np.array([0.0, 1.0])  # directions in (log c_e, log alpha)

_POINTS, _SUBPOINTS = 240, 12
_KINKS = 1000  # of more kinks 240 part the first walk, and all those beside its minima the last one
_CLOSER = 4
BEYOND = 30.0  # the walk is dense to this many times the c_e at which the ridge begins
_FAR = (1e2, 1e3, 1e4, 1e6)  # further points, times the same c_e: there v is a power law of c_e
ENDLESS = 400.0  # an end is open where the |log| of alpha or the combination is larger
_APART = 1e-9  # points of the walk closer than this in log c_e are one
_PARABOLIC = 5e-3 / 24  # in log c_e: over this a smooth profile is a parabola
_EDGE = 1e-7  # in log c_e: accuracy of a minimum where windows or the range of alpha end
_LOWEST = 5  # minima of an uneven likelihood that are followed
_AS_GOOD = 0.003  # of -2 log L per point: higher minima are not followed
ONE_PLACE = 1.05  # points more than 5 % apart in c_e or alpha are two places; a kink alone makes 1 %
FLAT = 1e-5  # of -2 log L: points that differ by less are equally good
_SHOWN = 160  # points of a curve that the result keeps
_LONGEST_EXPONENT = 3.0  # exponents of the combination are sought up to 3 times the ridge's
_LEVEL = 1e-9  # slope of the width over p below which the width is flat: the square root of rounding


@dataclass(frozen=True)
class Domain:
    """The range of the walk; an end that is not hard is a given bound or stands for infinity."""

    low: float
    high: float
    low_hard: bool
    high_hard: bool
    kinks: tuple[float, ...]  # c_e above which a row's window begins deeper than static contact, sorted
    alpha: tuple[float, float]
    points: int = _POINTS  # of the first walk, without the far ones

    @classmethod
    def of(cls, likelihood: Likelihood, box: Box | None = None, bounds: Collection[str] = ()) -> "Domain":
        """The whole range of c_e and alpha, or the box's where the names of `bounds`, given by the user, hold them."""
        o = likelihood.observations
        box = box or bounds_of(o, None)
        kinks = tuple(np.unique(likelihood.kinks).tolist())
        low, high = box.lower[0], box.upper[0]
        low_hard, high_hard = True, bool(np.isfinite(o.ceiling))
        if "c_e" in bounds:
            low_hard = low <= o.c_e_floor * (1 + 2e-4)
            high_hard = high >= o.ceiling * (1 - 2e-4)
        else:
            high = (
                o.ceiling * (1 - 1e-4)
                if high_hard
                else _FAR[-1] * (kinks[-1] if np.isfinite(kinks[-1]) else low)
            )
        return cls(
            low,
            high,
            low_hard,
            high_hard,
            kinks,
            (box.lower[1], box.upper[1]) if "alpha" in bounds else (0.0, np.inf),
            likelihood.n_points,
        )

    @property
    def entry(self) -> float:
        """c_e at which the ridge begins; infinite where there is none."""
        return self.kinks[-1]

    def within(self, box: Box) -> "Domain":
        """The part inside a box, with closer points, for the search of the optimum."""
        return replace(
            self,
            low=max(self.low, box.lower[0]),
            high=min(self.high, box.upper[0]),
            alpha=(box.lower[1], box.upper[1]),
            points=_CLOSER * self.points,
        )

    @cached_property
    def grid(self) -> Floats:
        """First points: even in log c_e, and the far ones."""
        begin = self.entry if np.isfinite(self.entry) else self.low
        top = min(self.high, BEYOND * begin)
        far = [begin * factor for factor in _FAR if top < begin * factor < self.high]
        even = np.geomspace(self.low, max(top, self.low * 1.0001), self.points)
        return np.unique(np.concatenate([even, far, [self.high]]))


class Walk:
    """Points along c_e, with alpha kept inside the domain; `known` is a walk that has some of them."""

    def __init__(
        self, likelihood: Likelihood, domain: Domain, c_e: Floats, known: "Walk | None" = None
    ) -> None:
        self.slices: AlphaSlices = likelihood.at(c_e) if known is None else known._with(likelihood, c_e)
        self.c_e = c_e
        self.low, self.high = domain.alpha
        self.alpha = np.clip(self.slices.best_alpha, max(self.low, 1e-300), self.high)
        clipped = self.low > 0 or np.isfinite(self.high)
        minus2 = self.slices.minus2(self.alpha) if clipped else self.slices.profile
        self.minus2 = np.where(np.isfinite(minus2), minus2, np.inf)
        self._bands: dict[float, tuple[Floats, Floats]] = {}

    def _with(self, likelihood: Likelihood, c_e: Floats) -> AlphaSlices:
        """The slices at each c_e, which rises; the likelihood is asked for those that the walk lacks."""
        place = np.searchsorted(self.c_e, c_e)
        new = self.c_e[np.minimum(place, len(self.c_e) - 1)] != c_e
        place[new] = len(self.c_e) + np.arange(np.count_nonzero(new))
        # with the last point: NumPy sums over one point in another order than over several
        others = [likelihood.at(np.append(c_e[new], c_e[-1]))] if new.any() else []
        return self.slices.joined(others, place)

    def band(self, target: float) -> tuple[Floats, Floats]:
        """Lowest and highest alpha below a target; NaN where none."""
        if target not in self._bands:
            lower, upper = self.slices.alpha_below(target)
            lower, upper = np.maximum(lower, self.low), np.minimum(upper, self.high)
            inside = (self.minus2 <= target) & (lower <= upper)
            self._bands[target] = np.where(inside, lower, np.nan), np.where(inside, upper, np.nan)
        return self._bands[target]


@dataclass(frozen=True)
class Ranges:
    """Intervals by quantity and level, and what they come from; see `Profile`."""

    walk: Walk
    base: float
    limits: Mapping[str, float]
    joint: Mapping[str, float]  #: level -> rise that bounds the joint region
    intervals: Mapping[str, Mapping[str, ConfidenceInterval]]
    identified: Combination


def ranges(
    likelihood: Likelihood,
    calibration: AnyCalibration,
    domain: Domain,
    best: tuple[float, float],
    ridge: float,
) -> Ranges:
    """Intervals, from a walk along c_e that is closer where a level is crossed; see `profile`."""
    limits, joint, of_alpha = (calibration.limits(LEVELS, direction) for direction in (C_E, None, ALPHA))
    walk = close_walk(likelihood, domain, best[0], [*limits.values(), *joint.values(), *of_alpha.values()])
    base = float(walk.minus2.min())
    last = float(walk.minus2[-1]) - base
    open_above = {name: last <= limit and not domain.high_hard for name, limit in limits.items()}
    intervals = {
        "c_e": {name: _range_of_c_e(walk, domain, base + limit) for name, limit in limits.items()},
        "alpha": {name: _range_of_alpha(walk, domain, base + limit) for name, limit in of_alpha.items()},
    }
    exponent = ridge
    if not open_above["95"] and isinstance(calibration, MixedCalibration):
        exponent = float(np.clip(calibration.exponent, 0.0, _LONGEST_EXPONENT * ridge))
    elif not open_above["95"]:
        exponent = _exponent(walk, base + of_alpha["95"], ridge)
    of_combination = {
        name: _range_of_combination(walk, exponent, base + limit, open_above[name] and exponent != ridge)
        for name, limit in calibration.limits(LEVELS, np.array([-exponent, 1.0])).items()
    }
    combination = Combination(exponent, best[1] / best[0] ** exponent, of_combination)
    return Ranges(walk, base, limits, joint, intervals, combination)


def c_e_interval(
    likelihood: Likelihood, domain: Domain, best: tuple[float, float], ridge: float = 0.0
) -> ConfidenceInterval:
    """The 95 % interval of c_e alone, for a fit at a point; see `profile`."""
    return ranges(likelihood, likelihood.calibration(*best), domain, best, ridge).intervals["c_e"]["95"]


def profile(
    likelihood: Likelihood,
    calibration: AnyCalibration,
    domain: Domain,
    best: tuple[float, float],
    ridge: float,
) -> Profile:
    """Intervals, regions and curves.

    Parameters
    ----------
    likelihood, calibration, domain
    best : (float, float)
        The fit's c_e [N/mm^2] and alpha [1/ms].
    ridge : float
        Exponent of the ridge, 4 (k + 1)/3 for an f with a zero of order k.
    """
    evidence = ranges(likelihood, calibration, domain, best, ridge)
    walk, base, joint = evidence.walk, evidence.base, evidence.joint
    rise = walk.minus2 - base
    low, high = walk.band(base + max(joint.values()))
    alpha = walk.alpha[int(np.argmin(walk.minus2))]  # along a ridge alpha has no end; the curve is cut
    begin, end = max(float(np.nanmin(low)), alpha / BEYOND), min(float(np.nanmax(high)), alpha * BEYOND)
    alphas = np.geomspace(begin, end, 120)
    x = np.log(walk.c_e)
    table = np.array([_lowest(x, row)[1] for row in walk.slices.minus2_table(alphas)]) - base
    drawn = _thin(walk.c_e, rise <= 2 * max(joint.values()), int(np.argmin(rise)))
    return Profile(
        c_e=walk.c_e[drawn],
        c_e_rise=rise[drawn],
        best_alpha=walk.alpha[drawn],
        alpha=alphas,
        alpha_rise=np.maximum(table, 0.0),
        limits=evidence.limits,
        intervals=evidence.intervals,
        identified=evidence.identified,
        regions={name: _region(walk, domain, base + limit) for name, limit in joint.items()},
        at_infinity=np.nan if domain.high_hard else float(rise[-1]),
        base=base,
    )


@dataclass(frozen=True)
class Minimum:
    """A minimum of the walk: c_e [N/mm^2], alpha [1/ms] and -2 log L without constants."""

    c_e: float
    alpha: float
    minus2: float
    evaluations: int  #: c_e tried to find all minima

    @property
    def point(self) -> tuple[float, float]:
        return self.c_e, self.alpha


def minima(likelihood: Likelihood, domain: Domain) -> list[Minimum]:
    """Minima of the walk in a domain, the lowest first; none where there is no window.

    A rise of more than `FLAT` separates two minima. Between the kinks of the domain the profile is smooth,
    and each such part is searched by itself.
    """
    every = np.array([kink for kink in domain.kinks if domain.low < kink < domain.high])
    few = len(every) <= _KINKS
    kinks = every if few else every[np.linspace(0, len(every) - 1, _POINTS).round().astype(int)]
    c_e = np.unique(np.append(domain.grid, kinks))
    walk = Walk(likelihood, domain, c_e)
    limit = walk.minus2.min() + _AS_GOOD * (1 + len(likelihood.observations))
    places = []
    for begin, end in pairwise([0, *np.searchsorted(c_e, kinks).tolist(), len(c_e) - 1]):
        for i in _valleys(walk.minus2[begin : end + 1]):
            lowest, sides = walk.minus2[begin + i], [max(begin, begin + i - 1), min(end, begin + i + 1)]
            # the profile may be lower between the points
            if np.isfinite(lowest) and lowest - 2 * (walk.minus2[sides].max() - lowest) <= limit:
                places.append((float(lowest), sides))
    if not places:
        return []
    places = sorted(places)[:_LOWEST] if likelihood.uneven else places
    lowest_points = _followed(
        likelihood,
        domain,
        c_e[[sides for _, sides in places]],
        kinks,
        len(c_e),
        step=_PARABOLIC if few else 0.0,
    )
    edges = np.array([domain.low, *every, domain.high])
    for k, rough in enumerate([] if few else lowest_points):
        i = int(np.searchsorted(edges, rough.c_e))
        beside = np.lib.stride_tricks.sliding_window_view(edges[max(i - 2, 0) : i + 2], 2)
        lowest_points[k] = min(
            _followed(likelihood, domain, beside, every, rough.evaluations, cells=4, step=_PARABOLIC / 8),
            key=lambda minimum: minimum.minus2,
            default=rough,
        )
    return sorted(lowest_points, key=lambda minimum: minimum.minus2)


def _followed(
    likelihood: Likelihood,
    domain: Domain,
    stretches: Floats,
    kinks: Floats,
    tried: int,
    *,
    cells: int = 2 * _SUBPOINTS,
    step: float,
) -> list[Minimum]:
    """The lowest point of each stretch, shape (m, 2), where it is a minimum.

    It is sought in ever narrower cells, and by a parabola where these are a `step` of log c_e wide.
    """
    (low, high), part = stretches.T, np.linspace(0, 1, cells + 1)
    each = np.arange(len(low))
    while True:
        width = np.log(high / low)
        c_e = low[:, None] * np.exp(width[:, None] * part)
        c_e[:, -1] = high
        walk = Walk(likelihood, domain, c_e.ravel())
        y = walk.minus2.reshape(c_e.shape)
        i, tried = y.argmin(axis=1), tried + c_e.size
        smooth = np.isfinite(y).all() and (walk.alpha == walk.slices.best_alpha).all()
        if width.max() < max(cells * step if smooth else 0.0, _EDGE):
            break
        low, high = c_e[each, np.maximum(i - 1, 0)], c_e[each, np.minimum(i + 1, part.size - 1)]
    middle = np.clip(i, 1, part.size - 2)  # of a parabola through three points
    with np.errstate(invalid="ignore", divide="ignore"):
        left, right = y[each, middle - 1] - y[each, middle], y[each, middle + 1] - y[each, middle]
        vertex = middle + (left - right) / (left + right) / 2
    vertex = np.clip(vertex, np.maximum(i - 1, 0), np.minimum(i + 1, part.size - 1))
    lowest = c_e[each, i]
    at_vertex = np.where(
        np.isfinite(vertex) & (left + right > 0), low * np.exp(width * vertex / (part.size - 1)), lowest
    )
    walk = Walk(likelihood, domain, np.append(lowest, at_vertex))
    of_two = np.where(walk.minus2[len(low) :] < walk.minus2[: len(low)], each + len(low), each)
    columns = (column[of_two].tolist() for column in (walk.c_e, walk.alpha, walk.minus2))
    lowest_points = [Minimum(c, a, m, tried + 2 * len(low)) for c, a, m in zip(*columns, strict=True)]
    ends = [minimum.c_e for minimum in lowest_points]
    # a stretch that is lowest at a kink has a minimum there only if the one beyond has too
    return [
        minimum
        for k, minimum in enumerate(lowest_points)
        if minimum.c_e not in kinks or minimum.c_e in ends[:k]
    ]


def at_ridge(likelihood: Likelihood, domain: Domain, lowest: Minimum) -> Minimum:
    """The fit: the lowest point, or on a flat ridge the smallest c_e of the flat stretch.

    The stretch reaches to the end of the domain, and its -2 log L stays within `FLAT` of the lowest. A
    stretch of less than 5 % of c_e does not count.
    """
    begin = max(domain.entry, domain.low)
    if begin >= domain.high:
        return lowest
    c_e = np.append(np.geomspace(begin, domain.high, likelihood.n_points), max(begin, lowest.c_e))
    walk = Walk(likelihood, domain, np.unique(c_e))
    free = (walk.alpha == walk.slices.best_alpha) | (
        walk.c_e == lowest.c_e
    )  # else alpha is at one of its ends
    c_e, equal = walk.c_e[free], walk.minus2[free] <= lowest.minus2 + FLAT
    first = len(c_e) - int(np.argmin(np.append(equal[::-1], False)))
    if first == len(c_e) or c_e[-1] < ONE_PLACE * c_e[first]:
        return lowest
    begin = float(c_e[first])
    if first > 0:

        def height(c_e: float) -> float:
            return float(Walk(likelihood, domain, np.array([c_e])).minus2[0]) - lowest.minus2 - FLAT

        begin = scipy.optimize.brentq(height, float(c_e[first - 1]), begin, rtol=1e-9)
    ridge_walk = Walk(likelihood, domain, np.array([begin]))
    return replace(lowest, c_e=begin, alpha=float(ridge_walk.alpha[0]), minus2=float(ridge_walk.minus2[0]))


def lowest(likelihood: Likelihood, domain: Domain) -> Minimum:
    """The lowest minimum of the walk in a domain."""
    return minima(likelihood, domain)[0]


def _valleys(y: Floats) -> list[int]:
    """Places of the minima; a rise of more than `FLAT` separates two."""
    valleys, low = [], 0  # low: place of the lowest since the last peak
    high = -1  # place of the highest since the last minimum
    for i, value in enumerate(y.tolist()):
        if low < high:
            if value > y[high]:
                high = i
            elif value < y[high] - FLAT:
                low = i
        elif value < y[low]:
            low = i
        elif value > y[low] + FLAT:
            valleys.append(low)
            high = i
    return valleys if low < high else [*valleys, low]


def close_walk(likelihood: Likelihood, domain: Domain, best: float, limits: list[float]) -> Walk:
    """A walk that is closer at its lowest point, wherever its rise crosses a limit, and within each limit."""
    walk, n_across = Walk(likelihood, domain, domain.grid), likelihood.n_points // 4
    part, rises = np.arange(1, _SUBPOINTS + 1) / (_SUBPOINTS + 1), np.unique(limits)[:, None]
    end = min(domain.high, BEYOND * (domain.entry if np.isfinite(domain.entry) else domain.low))
    for _ in range(3):
        c_e, i = walk.c_e, int(np.argmin(walk.minus2))
        inside = walk.minus2 - walk.minus2[i] <= rises
        near = (inside[:, 1:] != inside[:, :-1]).any(axis=0)
        near[max(i - 1, 0) : i + 1] = True
        left = np.flatnonzero(near)
        finer = np.exp(np.log(c_e[left, None]) + np.log(c_e[left + 1] / c_e[left])[:, None] * part)
        first, last = inside.argmax(axis=1), len(c_e) - 1 - inside[:, ::-1].argmax(axis=1)
        low, high = np.minimum(c_e[first], end), np.minimum(c_e[last], end)
        across = np.geomspace(low[high > low], high[high > low], n_across)
        c_e = np.sort(
            np.concatenate([c_e, finer.ravel(), across.ravel(), np.clip([best], domain.low, domain.high)])
        )
        walk = Walk(likelihood, domain, c_e[np.append(np.diff(np.log(c_e)) > _APART, True)], walk)
    return walk


def _range_of_c_e(walk: Walk, domain: Domain, target: float) -> ConfidenceInterval:
    inside = np.flatnonzero(walk.minus2 <= target)
    first, last = int(inside[0]), int(inside[-1])
    return ConfidenceInterval(
        None if first == 0 and not domain.low_hard else float(walk.c_e[first]),
        None if last == len(walk.c_e) - 1 and not domain.high_hard else float(walk.c_e[last]),
    )


def _range_of_alpha(walk: Walk, domain: Domain, target: float) -> ConfidenceInterval:
    low, high = walk.band(target)
    c_e = _range_of_c_e(walk, domain, target)
    # alpha rises with c_e along the likelihood: it is open where c_e is
    lowest, highest = float(np.nanmin(low)), float(np.nanmax(high))
    with np.errstate(divide="ignore"):
        endless = -np.inf < np.log(lowest) < -ENDLESS, np.log(highest) > ENDLESS
    return ConfidenceInterval(
        None if c_e.lower is None or endless[0] or 0 < domain.alpha[0] >= lowest else lowest,
        None if c_e.upper is None or endless[1] or highest >= domain.alpha[1] else highest,
    )


def _band(walk: Walk, target: float) -> tuple[Floats, Floats, Floats]:
    """Logarithms of c_e inside, and of the lowest and highest alpha there."""
    low, high = walk.band(target)
    inside = np.isfinite(low)
    with np.errstate(divide="ignore"):
        return np.log(walk.c_e[inside]), np.log(low[inside]), np.log(high[inside])


def _exponent(walk: Walk, target: float, ridge: float) -> float:
    """The exponent p of the shortest interval of log alpha - p log c_e, where the slope of its width is 0.

    The width is convex in p, and its slope is the distance of the log c_e where the two ends lie. At a hard
    end of c_e the width can be flat over a range of p: then its middle.
    """
    x, low, high = _band(walk, target)
    longest = _LONGEST_EXPONENT * ridge
    if not np.isfinite(low).all():  # alpha reaches 0: no width to minimise
        return ridge

    def place(y: Floats) -> float:
        i = int(np.argmin(y))
        near = slice(max(i - 1, 0), i + 2)
        return _lowest(x[near], y[near])[0]

    def slope(p: float, beside: float) -> float:
        return place(low - p * x) - place(p * x - high) + beside

    def root(begin: float, beside: float) -> float:
        if slope(begin, beside) >= 0:
            return begin
        if slope(longest, beside) <= 0:
            return longest
        return float(scipy.optimize.brentq(slope, begin, longest, (beside,), xtol=1e-12))

    first = root(0.0, _LEVEL)
    return (first + root(first + 100 * _LEVEL, -_LEVEL)) / 2


def _range_of_combination(walk: Walk, exponent: float, target: float, unbounded: bool) -> ConfidenceInterval:
    x, low, high = _band(walk, target)
    lower, upper = np.min(low - exponent * x), np.max(high - exponent * x)
    if unbounded:  # along the ridge the combination goes to 0 or infinity with c_e
        rising = (low - exponent * x)[-1] > (low - exponent * x)[0]
        return (
            ConfidenceInterval(float(np.exp(lower)), None)
            if rising
            else ConfidenceInterval(None, float(np.exp(upper)))
        )
    return ConfidenceInterval(
        None if -np.inf < lower < -ENDLESS else float(np.exp(lower)),
        None if upper > ENDLESS else float(np.exp(upper)),
    )


def _lowest(x: Floats, y: Floats) -> tuple[float, float]:
    """Place and height of the lowest over rising x, by a parabola through the lowest point and its two next."""
    y = np.where(np.isfinite(y), y, np.inf)
    i = int(np.argmin(y))
    if not 0 < i < len(y) - 1 or not np.isfinite(y[[i - 1, i + 1]]).all():
        return float(x[i]), float(y[i])
    left, right = x[i] - x[i - 1], x[i + 1] - x[i]
    below, above = (y[i - 1] - y[i]) / left, (y[i + 1] - y[i]) / right  # slopes away from the point
    if below + above <= 0:
        return float(x[i]), float(y[i])
    curvature, slope = (below + above) / (left + right), (above * left - below * right) / (left + right)
    return float(x[i] - slope / (2 * curvature)), float(y[i] - slope**2 / (4 * curvature))


def _region(walk: Walk, domain: Domain, target: float) -> Region:
    low, high = walk.band(target)
    inside = np.isfinite(low)
    drawn = _thin(walk.c_e, inside, int(np.argmin(walk.minus2)))
    return Region(
        walk.c_e[drawn], low[drawn], high[drawn], open_above=bool(inside[-1]) and not domain.high_hard
    )


def _thin(c_e: Floats, inside: NDArray[np.bool_], best: int) -> NDArray[np.intp]:
    """About 160 of the points inside, with the first, last and best, and all far above the best.

    Half are even by index, so that ends stay sharp; half in log c_e, so that no gap is left.
    """
    rows = np.union1d(np.flatnonzero(inside), [best])
    near, far = rows[c_e[rows] <= BEYOND * c_e[best]], rows[c_e[rows] > BEYOND * c_e[best]]
    by_number = np.linspace(0, len(near) - 1, _SHOWN // 2).round().astype(int)
    even = np.searchsorted(c_e[near], np.geomspace(c_e[near[0]], c_e[near[-1]], _SHOWN // 2)[1:-1])
    return np.unique(np.concatenate([near[np.union1d(by_number, even)], far, [best]]))
