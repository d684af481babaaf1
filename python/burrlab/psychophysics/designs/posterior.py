"""What the answers of a two-interval task say about threshold, slope and lapse rate: a posterior on a grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import entr
from scipy.stats import chi2

from burrlab.psychophysics.designs.design_checks import checked_answers
from burrlab.psychophysics.rules import Floats

_THRESHOLDS, _LEVELS = 61, 41  # of the grids, evenly spaced in the logarithm of the difference
_SLOPES = np.geomspace(0.7, 4.0, 9)
_LAPSES = 0.01 + 0.02 * np.arange(5)  # the middles of cells from 0 to 0.1; 0 would make one slip impossible
_LAPSE_PRIOR = (1.0 - _LAPSES) ** 9  # beta(1, 10)
_DIGITS = 10  # of an information [nat] that decide: the last ones differ from machine to machine


def proportion_correct(
    difference: ArrayLike, threshold: ArrayLike, slope: ArrayLike, lapse: ArrayLike
) -> Floats:
    """Of two intervals, 1/2 + (1/2 - lapse/2) (1 - 2^-((difference/threshold)^slope)): 75 % at threshold without lapses.

    A lapse answers at random. A Weibull function of slope 1.25 is within 0.012 of an observer with Gaussian noise,
    Phi(d'/sqrt 2) with d' proportional to the difference.
    """
    ratio = np.asarray(difference, dtype=np.float64) / np.asarray(threshold, dtype=np.float64)
    seen = -np.expm1(-math.log(2.0) * ratio ** np.asarray(slope, dtype=np.float64))
    return np.asarray(0.5 + 0.5 * (1.0 - np.asarray(lapse, dtype=np.float64)) * seen)


@dataclass(frozen=True)
class _Tables:
    """What all posteriors between two differences share."""

    thresholds: Floats
    differences: Floats
    grid: tuple[Floats, Floats, Floats]  # threshold, slope, lapse of each point
    correct: Floats  # proportion, by difference and point
    entropy: Floats  # of an answer [nat]


@lru_cache(maxsize=4)
def _tables(smallest: float, largest: float) -> _Tables:
    thresholds = np.geomspace(smallest, largest, _THRESHOLDS)
    differences = np.geomspace(smallest, largest, _LEVELS)
    t, s, q = (axis.ravel() for axis in np.meshgrid(thresholds, _SLOPES, _LAPSES, indexing="ij"))
    correct = np.stack([proportion_correct(x, t, s, q) for x in differences])
    return _Tables(thresholds, differences, (t, s, q), correct, entr(correct) + entr(1.0 - correct))


class ThresholdPosterior:
    """Posterior of one subject over threshold, slope and lapse rate.

    The prior is even in the logarithms of threshold (between the two differences) and slope (0.7 to 4), and beta(1, 10)
    of the lapse rate (0 to 0.1).

    Parameters
    ----------
    smallest, largest : float
        Differences |ln level| between which thresholds and levels are.
    """

    def __init__(self, smallest: float, largest: float) -> None:
        self._tables = tables = _tables(smallest, largest)
        self.thresholds, self.differences = tables.thresholds, tables.differences
        self._log = np.tile(np.log(_LAPSE_PRIOR), _THRESHOLDS * _SLOPES.size)

    def weights(self) -> Floats:
        """Of the grid, with the sum 1."""
        weights = np.exp(self._log - self._log.max())
        return np.asarray(weights / weights.sum())

    def update(self, difference: float, correct: bool) -> None:
        self.update_counts(difference, int(correct), 1)

    def update_counts(self, difference: float, correct: int, trials: int) -> None:
        p = proportion_correct(difference, *self._tables.grid)
        self._log += correct * np.log(p) + (trials - correct) * np.log1p(-p)

    def most_informative(self) -> float:
        """The difference whose answer leaves the least expected entropy of the posterior.

        That is where the answer and the parameters share most information: the entropy of the expected answer less the
        expected entropy of the answer. Of equal ones the smallest.
        """
        weights = self.weights()
        p = self._tables.correct @ weights
        information = entr(p) + entr(1.0 - p) - self._tables.entropy @ weights
        return float(self.differences[int(np.argmax(np.round(information, _DIGITS)))])

    def summary(self, level: float = 0.95) -> dict[str, Any]:
        """Threshold (geometric mean) and interval of equal tails, means of slope and lapse rate, density at the ends over
        the largest."""
        weights = self.weights().reshape(_THRESHOLDS, _SLOPES.size, _LAPSES.size)
        marginal = weights.sum(axis=(1, 2))
        logs = np.log(self.thresholds)
        # A grid point stands for the cell around it; those at the ends have half a one.
        edges = np.concatenate([logs[:1], 0.5 * (logs[1:] + logs[:-1]), logs[-1:]])
        width = np.diff(edges) / (logs[1] - logs[0])
        mass = marginal * width / (marginal * width).sum()
        below = np.concatenate([[0.0], np.cumsum(mass)])
        tails = 0.5 - 0.5 * level, 0.5 + 0.5 * level
        return {
            "threshold": math.exp(float(mass @ (0.5 * (edges[1:] + edges[:-1])))),
            "interval": tuple(float(np.exp(np.interp(tail, below, edges))) for tail in tails),
            "slope": math.exp(float(weights.sum(axis=(0, 2)) @ np.log(_SLOPES))),
            "lapse": float(weights.sum(axis=(0, 1)) @ _LAPSES),
            "at_ends": (float(marginal[0] / marginal.max()), float(marginal[-1] / marginal.max())),
        }


@dataclass(frozen=True)
class PosteriorThreshold:
    """A threshold with its credible interval.

    Attributes
    ----------
    level : float
        Ratio to the reference's parameter, where 75 % would be correct without lapses (d' = 0.954).
    interval : (float, float)
        Of the level, with equal tails, the end nearer to 1 first.
    credible : float
        Probability that it holds.
    difference : float
        |ln level|
    slope, lapse : float
        Posterior means of the Weibull function's exponent (geometric) and of the rate of answers at random.
    trials : int
    open_below, open_above : bool
        Whether the posterior has not fallen at an end of the levels, so that the threshold may lie outside.
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

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "interval": list(self.interval)}

    def __str__(self) -> str:
        near, far = self.interval
        ends = "".join(
            f"; it may lie {where} the levels"
            for where, is_open in (("nearer to 1 than", self.open_below), ("beyond", self.open_above))
            if is_open
        )
        return (
            f"75 % correct at a ratio of {self.level:.3g}, with {100 * self.credible:g} % between {near:.3g} and {far:.3g} "
            f"({self.trials} trials){ends}"
        )


def posterior_threshold(
    smallest: float,
    largest: float,
    levels: Sequence[float],
    correct: Sequence[bool],
    *,
    level: float = 0.95,
) -> PosteriorThreshold:
    """From levels on one side of 1 and their answers.

    Raises
    ------
    ValueError
        If `levels` and `correct` differ in number, a level is no ratio above 0 other than 1, they are on both sides of 1,
        or `level` is not between 0 and 1.
    """
    ratios, right = checked_answers(levels, correct)
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must be between 0 and 1, got {level}")
    if len({ratio > 1.0 for ratio in ratios}) > 1:
        raise ValueError("levels must be on one side of 1, got some below and some above")
    side = -1.0 if ratios and ratios[0] < 1.0 else 1.0
    posterior = ThresholdPosterior(smallest, largest)
    for ratio, answer in zip(ratios, right, strict=True):
        posterior.update(abs(math.log(ratio)), answer)
    return threshold_of(posterior, side, len(ratios), level)


def threshold_of(posterior: ThresholdPosterior, side: float, trials: int, level: float) -> PosteriorThreshold:
    """A posterior's, as a ratio above (side 1) or below 1 (side -1)."""
    found = posterior.summary(level)
    near, far = found["interval"]
    # Where a likelihood interval would go on beyond the grid
    low, high = (density > math.exp(-0.5 * float(chi2.ppf(level, 1))) for density in found["at_ends"])
    return PosteriorThreshold(
        level=math.exp(side * found["threshold"]), interval=(math.exp(side * near), math.exp(side * far)),
        credible=level, difference=found["threshold"], slope=found["slope"], lapse=found["lapse"],
        trials=trials, open_below=bool(low), open_above=bool(high),
    )  # fmt: skip
