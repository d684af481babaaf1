"""The likelihood of a fit on a grid over its joint region, and the region that new data would leave."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from burrlab.common.check import refuse
from burrlab.fitting.calibration import AnyCalibration, Calibration, RowScatter, covariance_of
from burrlab.fitting.group_effects import MixedEffect
from burrlab.fitting.likelihood import MODEL_ERROR
from burrlab.fitting.linear import OFFSETS, MixedEquations, RowProducts, slope_of
from burrlab.fitting.mixed import MixedLikelihood
from burrlab.fitting.observations import Box, Floats, Rows
from burrlab.fitting.profile import C_E, LEVELS, Domain, Walk
from burrlab.fitting.record import FitRecord

_STEP = 0.055  # between the alphas near the middle of a row, over the half width of the region
_COARSE, _ROWS, _ZOOMS = 400, 200, 3  # values of c_e: at first, after each zoom; number of zooms
_FAR_ROWS = 12  # further c_e, which only show whether c_e has an upper end
_BLOCK = 8  # truths at once, so that their tables stay in the cache
_EXCLUDED = 1e9  # rise of -2 log L at impossible points; finite, so that it can be interpolated


@dataclass(frozen=True, eq=False)
class NewData:
    """n repeated measurements of a logarithm, and their scatter."""

    n: int
    scatter: float
    own: bool = False  #: no other data share the scatter, which is estimated from the n alone
    #: variance of their mean, as they are of a new day or specimen, or share an offset that is not quite known
    between2: Floats | float = 0.0
    level: AnyCalibration | None = None  #: of the fit with them, where they are of a new day or specimen

    def rise(self, d: Floats) -> Floats:
        """The rise of -2 log L for a prediction that is off by d; overwrites d.

        With a scatter of their own, the mean sum of squares about a prediction is (n - 1) scatter^2 + n d^2,
        judged as by `Likelihood`.
        """
        d *= d
        wider = 1.0 + self.n * self.between2 / self.scatter**2
        d /= wider
        if self.own:
            d /= (self.n - 1) / self.n * self.scatter**2 + MODEL_ERROR**2
            np.log1p(d, out=d)
        d *= self.n if self.own else self.n / self.scatter**2
        if not isinstance(self.between2, float):
            d += np.log(wider)
        return d

    def calibration(self, old: AnyCalibration) -> AnyCalibration:
        """The calibration of the fit with these data: that of a new level, or of a scatter of their own, of c_e alone."""
        if not (self.own and isinstance(old, Calibration)):
            return self.level or old
        share = np.array([[self.n / (self.scatter**2 + MODEL_ERROR**2), 0.0], [0.0, 0.0]])
        total = old.total + share
        inverse = covariance_of(total)
        new = RowScatter("force", self.n, False, float(np.trace(inverse @ share)), self.scatter)
        scatters = tuple(
            replace(s, parameters=float(np.trace(inverse @ part)))
            for s, part in zip(old.scatters, old.shares, strict=True)
        )
        return replace(
            old, scatters=(*scatters, new), total=total, shares=np.concatenate([old.shares, share[None]])
        )


def _one_more_level(
    rows: RowProducts, slopes: Floats, n: int, weight: float, own_scatter: bool
) -> RowProducts:
    """The rows of a fit near its best point, and one more row of a new day and specimen.

    The new row tells no offset. It counts for the first scatter, or has one of its own.

    Parameters
    ----------
    rows : RowProducts
        Those of the fit.
    slopes : ndarray, shape (2,)
        Of the new row, over (log c_e, log alpha).
    n : int
        Rows that it is the mean of.
    weight : float
        Of the new row among those of its scatter.
    own_scatter : bool
        Whether no other rows share its scatter.
    """
    ends, common = [rows.blocks[k].stop for k in rows.estimated], np.zeros(len(rows.products[0]) - 3)
    level_slopes = [slopes[int(rows.components[k].quantity == "alpha")] for k in rows.estimated]
    row = np.insert(np.concatenate([common, slopes, [0.0]]), ends, level_slopes)
    products = [np.insert(np.insert(G, ends, 0.0, axis=0), ends, 0.0, axis=1) for G in rows.products]
    products += [np.zeros_like(products[0])] * own_scatter
    numbers = np.append(rows.n, np.zeros(int(own_scatter)))
    at = -1 if own_scatter else 0
    products[at] += weight * np.outer(row, row)
    numbers[at] += n
    components = [
        replace(x, group=replace(x.group, levels=(*x.group.levels, *[""] * (k in rows.estimated))))
        for k, x in enumerate(rows.components)
    ]
    return RowProducts(
        products, numbers, np.append(rows.known, np.zeros(int(own_scatter), np.bool_)), components
    )


def with_new_level(
    fit: FitRecord, slopes: Floats, n: int, scatter: float, own_scatter: bool = False
) -> AnyCalibration | None:
    """The limits of a fit with n rows more, of a new day and specimen, at its variances; None without any.

    They bring a degree of freedom: with few days it narrows the intervals more than what the rows say. With a scatter
    of their own they bring one of n - 1, too.
    """
    likelihood, old = fit.likelihood, fit._evidence().calibration
    if not isinstance(likelihood, MixedLikelihood) or not likelihood.linear.estimated:
        return None
    at = likelihood.equations
    scatter2 = np.append(at.scatter2, [scatter**2 + MODEL_ERROR**2] * own_scatter)
    weight = n * scatter2[-1 if own_scatter else 0] / scatter**2
    new = MixedEquations(
        _one_more_level(likelihood.linear, slopes, n, weight, own_scatter), scatter2, at.effect2
    ).uncertainty()
    return replace(new, monte_carlo=old.monte_carlo, inflation=old.inflation)


class SharedOffsets:
    """What a fit's data tell, at each point of a grid, of the offsets that new data would share.

    They share an offset of all data. One by day or data set is another in new data, as is the radius of another burr.

    Parameters
    ----------
    fit : FitRecord
    grid : RegionGrid
    """

    def __init__(self, fit: FitRecord, grid: "RegionGrid") -> None:
        self.shared: dict[str, MixedEffect] = {}
        #: of all, where they are others in new data: standard deviations [N], [mm]
        self.deviations: dict[str, float] = {}
        self.radii = fit.observations.radius
        columns, likelihood = [], fit.likelihood
        if not isinstance(likelihood, MixedLikelihood):
            return
        for x, component, block in zip(
            fit.effects, likelihood.components, likelihood.linear.blocks, strict=True
        ):
            if x.quantity in (*OFFSETS, "order"):
                self.deviations[x.quantity] = component.deviation or 0.0
                if len(x.levels) == 1:
                    self.shared[x.quantity] = x
                    columns.append(block.start)
        if columns:
            self.mean, self.covariance = likelihood.effects_given(
                np.exp(grid.log_c_e), grid.log_alpha, np.array(columns)
            )

    def known(self, radius: float) -> dict[str, float]:
        """The offsets at the fit that data of a burr share [N], [mm]: another burr has a radius of its own."""
        return {
            name: x.values[0] for name, x in self.shared.items() if name != "radius" or radius in self.radii
        }

    def outcome(
        self, radius: float, log_outcome: Callable[[Mapping[str, float]], Floats]
    ) -> tuple[Floats, Floats | float]:
        """An outcome's mean over the offsets and its variance by them, at each point of the grid.

        `log_outcome` gives its logarithm at given offsets, shape (m, a) or (m, 1). It is linear about the
        offsets of the fit.
        """
        known = self.known(radius)
        mean = middle = log_outcome(known)
        variance, slopes = np.zeros((1, 1)), []
        for name, deviation in self.deviations.items():
            shared = name in known
            step = self.shared[name].errors[0] if shared else deviation
            up, down = (log_outcome(known | {name: known.get(name, 0.0) + by}) for by in (step, -step))
            slope = slope_of(middle, up, down, step)
            variance = variance + (0.0 if shared else (deviation * slope) ** 2)
            if name in self.shared:
                slopes.append(slope * shared)
        for k, (slope, x) in enumerate(zip(slopes, self.shared.values(), strict=True)):
            mean = mean + slope * (self.mean[..., k] - x.values[0])
            for other, column in enumerate(slopes):
                variance = variance + slope * column * self.covariance[:, k, other, None]
        return mean, np.nan_to_num(variance) if self.deviations else 0.0


class NewRegion(NamedTuple):
    """The region after new data, for each of several truths, shape (t,)."""

    log_area: Floats  #: of the joint 95 % region, in (log c_e, log alpha)
    ratio: Floats  #: upper over lower end of c_e's 95 % interval; infinite where one is open


@dataclass(frozen=True, eq=False)
class RegionGrid:
    """-2 log L over (log c_e, log alpha), wherever a new region may lie.

    The alphas of a row are densest at the best alpha of its c_e.
    """

    log_c_e: Floats  # shape (m,)
    log_alpha: Floats  # shape (m, a)
    minus2: Floats  # shape (m, a), above its minimum
    width: Floats  # of each row in log c_e, shape (m,); 0 for the far ones
    calibration: AnyCalibration
    farthest: float  # rise up to which truths are drawn
    low_hard: bool
    high_hard: bool

    @classmethod
    def of(cls, fit: FitRecord, levels: Sequence[AnyCalibration | None] = ()) -> "RegionGrid":
        """The grid of a fit, up to the upper bound of its search where the region is open.

        It holds the regions with the limits of `levels`, too: those of the fit with new data.
        """
        calibration = fit._evidence().calibration
        refuse(
            any(x.quantity in ("c_e", "alpha") and x.interval is None for x in fit.effects),
            "a design needs a fit of one c_e and one alpha: whose would new data share?",
        )
        box = Box(*zip(fit.bounds["c_e"], fit.bounds["alpha"], strict=True))
        domain = Domain.of(fit.likelihood, box, fit.given_bounds)
        limit = max(each.limit(LEVELS["95"]) for each in (calibration, *levels) if each)
        farthest = calibration.limit(LEVELS["99.7"])
        # the truth stays possible, so no point of a region with these limits is higher than this
        reach = limit + farthest
        end = min(domain.high, box.upper[0])
        c_e = np.geomspace(domain.low, end, _COARSE)
        for _ in range(_ZOOMS):
            c_e = np.unique(np.append(c_e, np.clip(fit.c_e, c_e[0], c_e[-1])))
            height = Walk(fit.likelihood, domain, c_e).minus2
            inside = np.flatnonzero(height <= height.min() + reach)
            ends = c_e[[max(inside[0] - 1, 0), min(inside[-1] + 1, len(c_e) - 1)]]
            c_e = np.geomspace(ends[0], ends[1], _ROWS)
        if c_e[-1] == end and domain.high > end:
            c_e = np.append(c_e, np.geomspace(end, domain.high, _FAR_ROWS + 1)[1:])
        log_alpha, minus2 = _columns(fit, domain, c_e, limit, reach)
        minus2 = np.where(np.isfinite(minus2), minus2 - np.nanmin(minus2), _EXCLUDED)
        step = np.diff(np.log(c_e[:_ROWS]))
        width = np.zeros(len(c_e))
        width[: _ROWS - 1] += step / 2
        width[1:_ROWS] += step / 2
        return cls(
            np.log(c_e),
            log_alpha,
            minus2,
            width,
            calibration,
            farthest,
            domain.low_hard,
            domain.high_hard,
        )

    @cached_property
    def log_area(self) -> float:
        """Logarithm of the area of the joint 95 % region of the fit."""
        return float(np.log(self._area(self.minus2[None], _limits(self.calibration)[0])[0]))

    def truths(self, n: int, random: np.random.Generator) -> tuple[Rows, Rows]:
        """Rows and columns of n points, drawn within 99.7 % by exp(-rise/2), flat in (log c_e, log alpha).

        The draw is systematic, in the order of c_e: each point stands for the same weight.
        """
        weight = np.exp(-self.minus2 / 2) * np.gradient(self.log_alpha, axis=1) * self.width[:, None]
        weight[self.minus2 > self.farthest] = 0.0
        total = np.cumsum(weight)
        row, column = np.unravel_index(
            np.searchsorted(total, (np.arange(n) + random.random()) / n * total[-1]), weight.shape
        )
        return row, column

    def after(self, log_outcome: Floats, new: NewData, truth: tuple[Rows, Rows]) -> NewRegion:
        """The region with new data that come out as expected at each truth.

        Parameters
        ----------
        log_outcome : ndarray, shape (m, a) or (m, 1)
            Logarithm of the outcome that every point of the grid predicts; NaN where it has none.
        new : NewData
        truth : pair of ndarray, shape (t,)
            Rows and columns; every truth must have an outcome.
        """
        row, column = truth
        predicted = np.broadcast_to(log_outcome, self.minus2.shape)
        impossible = np.isnan(predicted)
        old = np.where(impossible, _EXCLUDED, self.minus2)
        y = np.where(impossible, 0.0, predicted)
        limits = _limits(new.calibration(self.calibration))
        regions = []
        for begin in range(0, len(row), _BLOCK):
            block = slice(begin, begin + _BLOCK)
            table = new.rise(y - predicted[row[block], column[block]][:, None, None])
            table += old
            regions.append(self._region(table, limits, self.high_hard))
        return NewRegion(*(np.concatenate(parts) for parts in zip(*regions, strict=True)))

    def below(self, ceiling: float) -> NewRegion:
        """The region after an overloaded run, which needs c_e [N/mm^2] below `ceiling`; shape (1,)."""
        return self._region(
            np.where(self.log_c_e[:, None] >= np.log(ceiling), _EXCLUDED, self.minus2)[None],
            _limits(self.calibration),
            self.high_hard or ceiling < np.inf,
        )

    def _region(self, table: Floats, limits: tuple[float, float], high_hard: bool) -> NewRegion:
        """Of tables of -2 log L, shape (t, m, a)."""
        profile = table.min(axis=2)
        base = profile.min(axis=1)
        table -= base[:, None, None]
        return NewRegion(
            np.log(self._area(table, limits[0])), self._ratio(profile - base[:, None], limits[1], high_hard)
        )

    def _area(self, rise: Floats, limit: float) -> Floats:
        """Area where the rise is below its limit, between the columns by linear interpolation."""
        left, right = rise[..., :-1], rise[..., 1:]
        low = np.minimum(left, right)
        part = np.clip((limit - low) / (np.abs(left - right) + 1e-12), 0.0, 1.0)
        return np.asarray(np.einsum("tma,ma->tm", part, np.diff(self.log_alpha, axis=1)) @ self.width)

    def _ratio(self, rise: Floats, limit: float, high_hard: bool) -> Floats:
        inside = rise <= limit
        every, last_row = np.arange(len(rise)), rise.shape[1] - 1
        first, last = inside.argmax(axis=1), last_row - inside[:, ::-1].argmax(axis=1)

        def crossing(at: Rows, beyond: Rows) -> Floats:
            part = (limit - rise[every, at]) / (rise[every, beyond] - rise[every, at] + 1e-12)
            x = self.log_c_e
            return np.asarray(x[at] + np.where(at == beyond, 0.0, part) * (x[beyond] - x[at]))

        upper = crossing(last, np.minimum(last + 1, last_row))
        lower = crossing(first, np.maximum(first - 1, 0))
        is_open = (last == last_row) & (not high_hard) | (first == 0) & (not self.low_hard)
        return np.where(is_open, np.inf, np.exp(upper - lower))


def _limits(calibration: AnyCalibration) -> tuple[float, float]:
    """Rises of -2 log L at 95 % that bound the joint region, and c_e's interval."""
    return calibration.limit(LEVELS["95"]), calibration.limit(LEVELS["95"], C_E)


def _columns(
    fit: FitRecord, domain: Domain, c_e: Floats, limit: float, reach: float
) -> tuple[Floats, Floats]:
    """Logarithms of the alphas at each c_e, and -2 log L there.

    The step grows with the distance from the best alpha. Few data points have heavy tails, and an even grid
    over these could have the region itself between two columns.
    """
    walk = Walk(fit.likelihood, domain, c_e)
    slices, base = walk.slices, float(walk.minus2.min())
    lowest = max(domain.alpha[0], fit.bounds["alpha"][0])
    best = np.log(np.clip(slices.best_alpha, lowest, domain.alpha[1]))

    def reached(rise: float) -> tuple[Floats, Floats]:
        ends = (np.clip(end, lowest, domain.alpha[1]) for end in slices.alpha_below(base + rise))
        low, high = (np.where(np.isfinite(end), np.log(end) - best, 0.0) for end in ends)
        return np.minimum(low, 0.0), np.maximum(high, 0.0)

    low, high = reached(limit)
    core = float(np.max(high - low)) / 2
    # a row out of reach keeps a width, so that its columns stay in order
    low, high = (end / core for end in reached(reach))
    ends = np.arcsinh(np.minimum(low, -1e-3)), np.arcsinh(np.maximum(high, 1e-3))
    t = np.linspace(*ends, 1 + int(np.ceil(np.max(ends[1] - ends[0]) / _STEP)), axis=1)
    log_alpha = best[:, None] + core * np.sinh(t)
    return log_alpha, np.stack([slices.minus2(column) for column in np.exp(log_alpha).T], axis=1)
