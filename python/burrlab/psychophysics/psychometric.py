"""Threshold, slope and lapse rate of a two-interval task, by a posterior on a grid or by psignifit."""

import math
import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy.special import entr

from burrlab.common.check import extra, refuse
from burrlab.common.figures import POSITION, REFERENCE, VELOCITY, Axes, axes_or_new, drawing, styled
from burrlab.common.provenance import provenance
from burrlab.common.table import probability_text
from burrlab.psychophysics.designs import UNITS, checked_level
from burrlab.psychophysics.rules import BELOW_CHANCE, Floats, check_level, one_of
from burrlab.psychophysics.sensitivity import below_chance

_THRESHOLDS, _LEVELS = 61, 41  # sizes of the grids, even in the logarithm of the difference
_SLOPES = np.geomspace(0.7, 4.0, 9)
_LAPSES = 0.01 + 0.02 * np.arange(5)  # middles of cells from 0 to 0.1; 0 would exclude any slip
_DIGITS = 10  # digits of an information [nat]; further ones differ between machines


def proportion_correct(
    difference: ArrayLike, threshold: ArrayLike, slope: ArrayLike, lapse: ArrayLike
) -> Floats:
    """1/2 + (1/2 - lapse/2) (1 - 2^-((difference/threshold)^slope)), for two intervals.

    It is 75 % at threshold without lapses. A lapse is a random answer. A Weibull function of slope 1.25 is
    within 0.012 of an observer with Gaussian noise, Phi(d'/sqrt 2) with d' proportional to the difference.
    """
    x, x0, s, random = (np.asarray(part, dtype=np.float64) for part in (difference, threshold, slope, lapse))
    return np.asarray(0.5 - 0.5 * (1.0 - random) * np.expm1(-math.log(2.0) * (x / x0) ** s))


@lru_cache(maxsize=4)
def _tables(smallest: float, largest: float) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Tables that all posteriors between two differences share.

    Thresholds; differences; threshold, slope and lapse rate of each grid point; proportion correct and
    entropy of an answer [nat], by difference and point.
    """
    thresholds = np.geomspace(smallest, largest, _THRESHOLDS)
    differences = np.geomspace(smallest, largest, _LEVELS)
    grid = np.stack(np.meshgrid(thresholds, _SLOPES, _LAPSES, indexing="ij")).reshape(3, -1)
    correct = proportion_correct(differences[:, None], *grid)
    return thresholds, differences, grid, correct, entr(correct) + entr(1.0 - correct)


def check_correct(correct: int, trials: int) -> None:
    """ValueError unless these are numbers of correct answers and of trials."""
    refuse(
        not 0 <= correct <= trials or trials == 0 or (int(correct), int(trials)) != (correct, trials),
        f"correct must be from 0 to trials, at least 1, got {correct} of {trials}",
    )


class ThresholdPosterior:
    """Posterior of one subject over threshold, slope and lapse rate.

    The prior is uniform in the logarithms of threshold (between the two differences) and slope (0.7 to 4),
    and beta(1, 10) in the lapse rate (0 to 0.1).

    Parameters
    ----------
    smallest, largest : float
        Range of the differences |ln level| of thresholds and levels.
    """

    def __init__(self, smallest: float, largest: float) -> None:
        self.thresholds, self.differences, self._grid, self._correct, self._entropy = _tables(
            smallest, largest
        )
        self._log = np.tile(np.log((1.0 - _LAPSES) ** 9), _THRESHOLDS * _SLOPES.size)  # beta(1, 10)

    def weights(self) -> Floats:
        """Posterior weights of the grid, which sum to 1."""
        weights = np.exp(self._log - self._log.max())
        return np.asarray(weights / weights.sum())

    def marginal(self) -> Floats:
        """Weights of the thresholds, whatever slope and lapse rate."""
        return np.asarray(self.weights().reshape(_THRESHOLDS, -1).sum(axis=1))

    def update(self, difference: float, correct: int, trials: int = 1) -> None:
        """Counts answers; ValueError unless `correct` is from 0 to `trials`, at least 1."""
        check_correct(correct, trials)
        p = proportion_correct(difference, *self._grid)
        self._log += correct * np.log(p) + (trials - correct) * np.log1p(-p)

    def most_informative(self) -> float:
        """The difference whose answer minimises the posterior's expected entropy; the smallest of equals.

        There the mutual information of answer and parameters is largest: the entropy of the expected answer
        minus the expected entropy of the answer.
        """
        weights = self.weights()
        p = self._correct @ weights
        information = entr(p) + entr(1.0 - p) - self._entropy @ weights
        return float(self.differences[int(np.argmax(np.round(information, _DIGITS)))])

    def threshold(self, side: float, trials: int, level: float = 0.95) -> "PosteriorThreshold":
        """The geometric mean and the interval of the threshold, as ratios above 1 (side 1) or below 1 (side -1)."""
        weights, marginal = self.weights().reshape(_THRESHOLDS, _SLOPES.size, _LAPSES.size), self.marginal()
        logs = np.log(self.thresholds)
        # A grid point stands for the cell around it; the end points have half a cell.
        edges = np.concatenate([logs[:1], 0.5 * (logs[1:] + logs[:-1]), logs[-1:]])
        width = np.diff(edges) / (logs[1] - logs[0])
        mass = marginal * width / (marginal * width).sum()
        below = np.concatenate([[0.0], np.cumsum(mass)])
        near, far = np.exp(np.interp((0.5 - 0.5 * level, 0.5 + 0.5 * level), below, edges)).tolist()
        difference = math.exp(float(mass @ (0.5 * (edges[1:] + edges[:-1]))))
        # True where a likelihood interval would extend beyond the grid
        low, high = marginal[[0, -1]] / marginal.max() > math.exp(-0.5 * scipy.stats.chi2.ppf(level, 1))
        return PosteriorThreshold(
            level=math.exp(side * difference), interval=(math.exp(side * near), math.exp(side * far)),
            credible=level, difference=difference,
            slope=math.exp(float(weights.sum(axis=(0, 2)) @ np.log(_SLOPES))),
            lapse=float(weights.sum(axis=(0, 1)) @ _LAPSES), trials=trials,
            open_below=bool(low), open_above=bool(high),
        )  # fmt: skip


@dataclass(frozen=True)
class PosteriorThreshold:
    """A threshold with its credible interval.

    Attributes
    ----------
    level : float
        Ratio to the reference's parameter at which 75 % would be correct without lapses (d' = 0.954).
    interval : (float, float)
        Equal-tailed interval of the level, the end nearer to 1 first.
    credible : float
        Probability of the interval.
    difference : float
        |ln level|
    slope, lapse : float
        Posterior means of the Weibull exponent (geometric) and of the rate of random answers.
    trials : int
    open_below, open_above : bool
        Whether the posterior is still high at this end of the levels, so the threshold may lie outside.
    """

    level: float
    interval: tuple[float, float]
    credible: float
    difference: float
    slope: float
    lapse: float
    trials: int
    open_below: bool
    open_above: bool

    def __str__(self) -> str:
        near, far = self.interval
        return (
            f"75 % correct at a ratio of {self.level:.3g}, with {100 * self.credible:g} % between {near:.3g} "
            f"and {far:.3g} ({self.trials} trials)"
            + "; it may lie nearer to 1 than the levels" * self.open_below
            + "; it may lie beyond the levels" * self.open_above
        )


#: Level, correct answers, trials.
Level: TypeAlias = tuple[float, int, int]


def summed(rows: Iterable[Level]) -> Iterable[Level]:
    """(level, correct answers, trials), summed by level, alike to nine digits."""
    sums: dict[str, Level] = {}
    for level, right, trials in rows:
        level, right_before, before = sums.get(text := f"{level:.9g}", (level, 0, 0))
        sums[text] = level, right_before + right, before + trials
    return sums.values()


_MOST_BARS = 12  # most levels that are drawn with intervals


@dataclass(frozen=True)
class PsychometricFit:
    """A Weibull function of how far ln level is from 0, with guess rate 0.5. Made by `psychometric_function`.

    Attributes
    ----------
    threshold : float
        Just-noticeable difference as a ratio above 1, at which 75 % would be correct without lapses
        (d' = 0.954 of two intervals).
    interval : (float, float)
        Credible, equal-tailed interval of the threshold.
    slope : float
        Exponent of the Weibull function; about 1.25 for an observer with Gaussian noise on the logarithm.
    slope_interval : (float, float)
    lapse : float
        Rate of random answers; half of them are wrong.
    lapse_interval : (float, float)
    overdispersion : float
        psignifit's eta: 0 for binomial variation, towards 1 for more.
    level : float
        Probability of the intervals.
    guess_rate, proportion : float
        0.5 and 0.75
    ratios, correct, trials : tuple
        The data, as ratios above 1; a ratio and its inverse are pooled.
    side : {"above", "below", "both"}
        Side of 1 on which the levels lie.
    parameter : {"c_e", "alpha"} or None
    reference : float or None
        The reference's parameter [N/mm^2 or 1/ms].
    at_bounds : tuple of (str, str)
        Parameter ("threshold", "width") and end ("lower", "upper") of intervals that the prior sets, not the
        data. psignifit's threshold may lie at most half the range beyond the levels.
    provenance : dict
        Versions.
    """

    threshold: float
    interval: tuple[float, float]
    slope: float
    slope_interval: tuple[float, float]
    lapse: float
    lapse_interval: tuple[float, float]
    overdispersion: float
    level: float
    guess_rate: float
    proportion: float
    ratios: tuple[float, ...]
    correct: tuple[int, ...]
    trials: tuple[int, ...]
    side: str
    parameter: str | None
    reference: float | None
    at_bounds: tuple[tuple[str, str], ...]
    provenance: dict[str, Any]

    def just_noticeable(self) -> tuple[float, float, float] | None:
        """The just-noticeable change of the parameter and its interval [N/mm^2 or 1/ms].

        The change is an increase, or a decrease if all levels lie below 1. None without a reference.
        """
        if (reference := self.reference) is None:
            return None
        change, low, high = (
            reference * (1.0 - 1.0 / ratio if self.side == "below" else ratio - 1.0)
            for ratio in (self.threshold, *self.interval)
        )
        return change, low, high

    def proportion_at(self, levels: ArrayLike) -> Floats:
        """Proportion correct, with lapses, at ratios above or below 1."""
        differences = np.abs(np.log(np.asarray(levels, dtype=np.float64)))
        return proportion_correct(differences, math.log(self.threshold), self.slope, self.lapse)

    def _fall(self) -> float:
        """One-sided p that scores fall with ln |ln ratio| (Cochran and Armitage's test of a trend)."""
        n, right = np.array(self.trials), np.array(self.correct)
        share, x = right.sum() / n.sum(), np.log(np.log(self.ratios))
        x = x - n @ x / n.sum()
        deviation = math.sqrt(share * (1.0 - share) * (n @ x**2))
        return float(scipy.stats.norm.cdf(right @ x / deviation)) if deviation else 0.5

    def __str__(self) -> str:
        low, high = self.interval
        least, most = min(self.ratios), max(self.ratios)
        fall = self._fall()
        falling = f"scores fall as the difference grows ({probability_text(fall)}): were levels swapped?"
        lines = [
            below_chance(sum(self.correct), sum(self.trials)),
            falling * bool(fall < BELOW_CHANCE),
            f"75 % correct (guess rate 0.5, without lapses) at a ratio of {self.threshold:.3g}, "
            f"{100 * self.level:g} % {low:.3g} to {high:.3g}",
            f"extrapolated: the levels go from {least:.3g} to {most:.3g}"
            * (not least <= self.threshold <= most),
        ]
        if (change := self.just_noticeable()) is not None and self.parameter is not None:
            what = "decrease" if self.side == "below" else "increase"
            lines.append(
                f"just-noticeable {what} of {self.parameter} {change[0]:.3g} {UNITS[self.parameter]}, "
                f"{change[1]:.3g} to {change[2]:.3g}"
            )
        lines += [
            f"slope {self.slope:.2f}, {self.slope_interval[0]:.2f} to {self.slope_interval[1]:.2f}; lapse "
            f"rate {100 * self.lapse:.1f} %, {100 * self.lapse_interval[0]:.1f} to "
            f"{100 * self.lapse_interval[1]:.1f} %; {sum(self.trials)} trials",
            *(
                f"the {end} end of the {name} is set by the prior, not by the data"
                for name, end in self.at_bounds
            ),
        ]
        return "\n".join(filter(None, lines))

    @drawing
    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Proportion correct over the ratio with exact binomial intervals, the curve, and the threshold.

        `style`: label, color and other properties of the curve.
        """
        ax = axes_or_new(ax)
        x = np.log(self.ratios)
        correct, trials = np.asarray(self.correct), np.asarray(self.trials)
        share, ends = correct / trials, np.log(self.interval)
        reach = max(1.4 * x.max(), 1.05 * ends[1])
        span = np.geomspace(0.7 * x.min(), reach, 200)
        ax.plot(span, self.proportion_at(np.exp(span)), **styled(style, color=POSITION, linewidth=1.4))
        tests = map(scipy.stats.binomtest, self.correct, self.trials)
        low, high = np.array([test.proportion_ci(self.level) for test in tests]).T  # Clopper and Pearson's
        bars = x.size <= _MOST_BARS
        if bars:
            ax.vlines(x, low, high, color=REFERENCE, linewidth=0.9)
        ax.scatter(x, share, s=18.0 * np.sqrt(trials / trials.max()), color=REFERENCE, zorder=3)
        ax.plot(ends, [self.proportion] * 2, "|-", color=VELOCITY, lw=2.0, ms=7, solid_capstyle="butt")
        ax.plot(math.log(self.threshold), self.proportion, "o", color=VELOCITY, zorder=4)
        ax.axhline(self.guess_rate, color=REFERENCE, linewidth=0.8, linestyle=":")
        ax.set_xscale("log")
        # in the lower right, which neither curve nor points reach; beside the point the text would leave the frame
        ax.text(
            0.98, 0.02,
            f"threshold {self._shown(math.log(self.threshold)):.3g}, {100 * self.level:g} % interval",
            transform=ax.transAxes, color=VELOCITY, fontsize=8, ha="right", va="bottom",
        )  # fmt: skip
        ax.text(0.98, self.guess_rate, "chance", transform=ax.get_yaxis_transform(), color=REFERENCE, fontsize=8,
                ha="right", va="bottom")  # fmt: skip
        ticks = x if x.size <= 8 else np.geomspace(x.min(), x.max(), 6)
        ax.set_xticks(ticks, [f"{self._shown(tick):.3g}" for tick in ticks])
        ax.minorticks_off()
        known = self.reference is not None and self.parameter is not None
        over = f"'s {self.reference:g} {UNITS[self.parameter or '']}" if known else ""
        name = "ratio or its inverse" if self.side == "both" else "ratio"
        ax.set(
            xlim=(min(span[0], 0.95 * ends[0]), reach),
            xlabel=f"{self.parameter or 'parameter'}, {name} to the reference{over} [1]",
            ylim=(min(0.4, float((low if bars else share).min())) - 0.03, 1.03),
            ylabel="proportion correct [1]",
        )
        return ax

    def _shown(self, difference: float) -> float:
        return math.exp(-difference if self.side == "below" else difference)


#: psignifit's own criteria of an adaptive procedure, whose levels do not span a range.
_MANY_LEVELS, _FEW_TRIALS = 25, 5
#: ln(-ln 0.05) - ln(-ln 0.95): the exponent of a Weibull function times psignifit's width in the logarithm.
_WIDTH_TIMES_SLOPE = math.log(-math.log(0.05)) - math.log(-math.log(0.95))
_BOUND = re.compile(r"boundWarning.*<(\w+)>.* at the (lower|upper) bound", re.DOTALL)


def psychometric_function(
    levels: Sequence[float],
    correct: Sequence[int],
    trials: Sequence[int],
    *,
    parameter: str | None = None,
    reference: float | None = None,
    level: float = 0.95,
) -> PsychometricFit:
    r"""Proportion correct of two intervals as a function of the difference between comparison and reference.

    .. math::

       P = \frac12 + \frac{1 - \text{lapse}}{2} \left(1 - 2^{-(\lvert\ln \text{level}\rvert/\lvert\ln \text{threshold}\rvert)^\text{slope}}\right)

    P is 1/2 without a difference. Levels with the same |ln level| are pooled: both intervals are rendered
    alike, so a ratio and its inverse differ only in order. Threshold, slope, lapse rate and overdispersion
    are modes of psignifit's posterior on ln |ln level|, with its default priors.

    Parameters
    ----------
    levels : sequence of float
        Ratios to the reference's parameter, above 0, not 1; at least two different |ln level|.
    correct, trials : sequences of int
        Correct answers and trials at each level.
    parameter : {"c_e", "alpha"}, optional
        For labels and units.
    reference : float, optional
        The reference's value of the parameter [N/mm^2 or 1/ms].
    level : float
        Probability of the intervals.

    Raises
    ------
    ImportError
        Without psignifit (extra `psychometric`).
    ValueError
        If the sequences differ in length, a level is not above 0 or is 1, fewer than two |ln level| differ, a
        number is out of range, the parameter is unknown, or the reference is not above 0.
    TypeError
        If a number of answers is not whole.

    Notes
    -----
    In 120 fits of a Gaussian observer with 2 % lapses and a threshold of 0.2, at five levels of 0.35 to 2.6
    times the threshold, the 95 % intervals held the threshold in 117 with 20 trials per level (the prior set
    an end in 52) and in 115 with 60 (in 10). |ln threshold| was 2 % too large and 1 % too small, with a
    standard deviation of 25 and 15 %.

    References
    ----------
    H. H. Schütt, S. Harmeling, J. H. Macke, F. A. Wichmann, Painfree and accurate Bayesian estimation of
    psychometric functions for (potentially) overdispersed data, Vision Research 122 (2016) 105-123.

    Examples
    --------
    >>> levels, correct, trials = [1.1, 1.2, 1.4, 1.8], [11, 13, 17, 20], [20, 20, 20, 20]
    >>> print(psychometric_function(levels, correct, trials))
    75 % correct (guess rate 0.5, without lapses) at a ratio of 1.29, 95 % 1.13 to 1.42
    slope 2.37, 1.03 to 4.74; lapse rate 0.0 %, 0.0 to 26.6 %; 80 trials
    """
    refuse(
        not len(levels) == len(correct) == len(trials),
        f"levels, correct and trials must be equally many, got {len(levels)}, {len(correct)} and "
        f"{len(trials)}",
    )
    ratios = [checked_level("levels", ratio) for ratio in levels]
    pooled = _pooled(ratios, correct, trials)
    if parameter is not None:
        one_of("parameter", parameter, tuple(UNITS))
    refuse(
        reference is not None and not (math.isfinite(reference) and reference > 0.0),
        f"reference must be above 0, got {reference}",
    )
    check_level(level)

    data = np.array([(math.log(math.log(ratio)), right, number) for ratio, right, number in pooled])
    psignifit_fit, at_bounds = _fit(data, level)
    threshold, width, lapse = (
        (psignifit_fit.parameter_estimate[name], *psignifit_fit.confidence_intervals[name][str(level)])
        for name in ("threshold", "width", "lambda")
    )
    sides = {ratio > 1.0 for ratio in ratios}
    beyond = {"lower": threshold[1] < data[0, 0], "upper": threshold[2] > data[-1, 0]}
    at_bounds += [("threshold", end) for end in beyond if beyond[end]]
    return PsychometricFit(
        *_ends([math.exp(math.exp(value)) for value in threshold]),
        *_ends([_WIDTH_TIMES_SLOPE / width[i] for i in (0, 2, 1)]),
        *_ends([2.0 * value for value in lapse]),  # psignifit's lambda counts wrong answers only
        overdispersion=float(psignifit_fit.parameter_estimate["eta"]),
        level=level,
        guess_rate=0.5,
        proportion=0.75,
        ratios=tuple(ratio for ratio, _, _ in pooled),
        correct=tuple(right for _, right, _ in pooled),
        trials=tuple(number for _, _, number in pooled),
        side="both" if len(sides) == 2 else "above" if sides == {True} else "below",
        parameter=parameter,
        reference=None if reference is None else float(reference),
        at_bounds=tuple(dict.fromkeys(at_bounds)),
        provenance=provenance(psignifit=version("psignifit")),
    )


def _pooled(ratios: Sequence[float], correct: Sequence[int], trials: Sequence[int]) -> list[Level]:
    """Ratios above 1, correct answers and trials, from the smallest; a ratio and its inverse are pooled."""
    rows = []
    for ratio, right, number in zip(ratios, correct, trials, strict=True):
        check_correct(right, number)
        rows.append((max(ratio, 1.0 / ratio), int(right), int(number)))
    pooled = sorted(summed(rows))
    refuse(len(pooled) < 2, f"levels must hold at least two different differences from 1, got {len(pooled)}")
    return pooled


def _ends(values: Sequence[float]) -> tuple[float, tuple[float, float]]:
    estimate, low, high = (float(value) for value in values)
    return estimate, (low, high)


def _fit(data: Floats, level: float) -> tuple[Any, list[tuple[str, str]]]:
    """psignifit's result for rows (ln difference, correct, trials), and the ends that its prior sets."""
    psignifit = extra("psignifit", "a psychometric function", "psychometric", "psignifit (GPL)").psignifit
    adaptive = len(data) >= _MANY_LEVELS or data[:, 2].max() <= _FEW_TRIALS
    options: dict[str, Any] = {"stimulus_range": (data[0, 0], data[-1, 0])} if adaptive else {}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        # Many levels with one trial each are normal for a staircase.
        warnings.filterwarnings("ignore", r"All blocks in data have only 1 trial", UserWarning)
        psignifit_fit = psignifit(
            data, experiment_type="2AFC", sigmoid="weibull", confP=(level, 0.9, 0.68),
            pool_max_blocks=len(data), **options,
        )  # fmt: skip
    matches = [_BOUND.search(str(warning.message)) for warning in caught]
    for warning in (warning_of for warning_of, match in zip(caught, matches, strict=True) if match is None):
        warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return psignifit_fit, [(match[1], match[2]) for match in matches if match is not None]
