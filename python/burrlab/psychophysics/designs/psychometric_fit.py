"""A fitted psychometric function: numbers, words, figure."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import beta

from burrlab.figures import POSITION, REFERENCE, VELOCITY, axes_or_new, tidy
from burrlab.psychophysics.designs.comparison import UNITS
from burrlab.psychophysics.designs.posterior import proportion_correct
from burrlab.psychophysics.rules import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_BARS = 12  # levels that are drawn with an interval each


@dataclass(frozen=True)
class PsychometricFit:
    """A Weibull function of the difference |ln level| with guess rate 0.5.

    Attributes
    ----------
    threshold : float
        Just-noticeable difference as a ratio above 1: 75 % would be correct there without lapses (d' = 0.954 of two
        intervals).
    interval : (float, float)
        Of it, credible, with equal tails.
    slope : float
        Exponent of the Weibull function; about 1.25 for an observer with Gaussian noise on the logarithm.
    slope_interval : (float, float)
    lapse : float
        Rate of answers at random; half of them are wrong.
    lapse_interval : (float, float)
    overdispersion : float
        psignifit's eta: 0 where the answers vary as a binomial does, towards 1 where they vary more.
    level : float
        Probability of the intervals.
    guess_rate, proportion : float
        0.5 and 0.75
    ratios, correct, trials : tuple
        The data; ratios above 1, below and above pooled.
    side : {"above", "below", "both"}
        Where the levels were.
    parameter : {"c_e", "alpha"} or None
    reference : float or None
        The parameter of the reference [N/mm^2 or 1/ms].
    at_bounds : tuple of (str, str)
        Parameter ("threshold", "width") and end ("lower", "upper") of its interval that the prior sets and not the data:
        psignifit's threshold may lie half the range beyond the levels, no more.
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
        """The just-noticeable change of the parameter and its interval [N/mm^2 or 1/ms]; None without a reference.

        An increase, or a decrease where all levels were below 1.
        """
        if self.reference is None:
            return None
        below, reference = self.side == "below", self.reference
        value, low, high = (
            reference * (1.0 - 1.0 / ratio if below else ratio - 1.0)
            for ratio in (self.threshold, *self.interval)
        )
        return value, low, high

    def proportion_at(self, levels: ArrayLike) -> Floats:
        """Of correct answers, with lapses, at ratios above or below 1."""
        differences = np.abs(np.log(np.asarray(levels, dtype=np.float64)))
        return proportion_correct(differences, math.log(self.threshold), self.slope, self.lapse)

    def __str__(self) -> str:
        low, high = self.interval
        lines = [
            f"75 % correct (guess rate 0.5, without lapses) at a ratio of {self.threshold:.3g}, "
            f"{100 * self.level:g} % {low:.3g} to {high:.3g}"
        ]
        least, most = min(self.ratios), max(self.ratios)
        if not least <= self.threshold <= most:
            lines.append(f"extrapolated: the levels go from {least:.3g} to {most:.3g}")
        if (change := self.just_noticeable()) is not None and self.parameter is not None:
            what = "decrease" if self.side == "below" else "increase"
            lines.append(
                f"just-noticeable {what} of {self.parameter} {change[0]:.3g} {UNITS[self.parameter]}, "
                f"{change[1]:.3g} to {change[2]:.3g}"
            )
        lines.append(
            f"slope {self.slope:.2f}, {self.slope_interval[0]:.2f} to {self.slope_interval[1]:.2f}; lapse rate "
            f"{100 * self.lapse:.1f} %, {100 * self.lapse_interval[0]:.1f} to {100 * self.lapse_interval[1]:.1f} %; "
            f"{sum(self.trials)} trials"
        )
        for name, end in self.at_bounds:
            lines.append(f"the {end} end of the {name} is set by the prior, not by the data")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Proportion correct over the ratio, with exact binomial intervals, the curve, and the threshold's interval."""
        ax = axes_or_new(ax)
        x = np.log(self.ratios)
        correct, trials = np.asarray(self.correct), np.asarray(self.trials)
        share, tail = correct / trials, 0.5 - 0.5 * self.level
        reach = max(1.4 * x.max(), 1.05 * math.log(self.interval[1]))
        span = np.geomspace(0.7 * x.min(), reach, 200)
        ax.plot(span, self.proportion_at(np.exp(span)), color=POSITION, linewidth=1.4)
        # Clopper and Pearson's; beta's parameters must stay above 0 where no or all answers were correct.
        low = np.where(correct == 0, 0.0, beta.ppf(tail, np.maximum(correct, 0.5), trials - correct + 1))
        wrong = np.maximum(trials - correct, 0.5)
        high = np.where(correct == trials, 1.0, beta.ppf(1 - tail, correct + 1, wrong))
        bars = x.size <= _MOST_BARS
        if bars:
            ax.vlines(x, low, high, color=REFERENCE, linewidth=0.9)
        sizes = 18.0 * np.sqrt(trials / trials.max())
        ax.scatter(x, share, s=sizes, color=REFERENCE, zorder=3)
        ends = np.log(self.interval)
        ax.plot(
            ends,
            [self.proportion] * 2,
            "|-",
            color=VELOCITY,
            linewidth=2.0,
            markersize=7,
            solid_capstyle="butt",
        )
        ax.plot(math.log(self.threshold), self.proportion, "o", color=VELOCITY, zorder=4)
        name = {"both": "ratio or its inverse"}.get(self.side, "ratio")
        ax.axhline(self.guess_rate, color=REFERENCE, linewidth=0.8, linestyle=":")
        ax.set_xscale("log")
        ax.set_xlim(min(span[0], 0.95 * ends[0]), reach)
        # In the upper left, where a curve that rises is not; beside the point the text would leave the frame.
        ax.text(
            0.02, 0.98, f"threshold {self._shown(math.log(self.threshold)):.3g}, {100 * self.level:g} % interval",
            transform=ax.transAxes, color=VELOCITY, fontsize=8, va="top",
        )  # fmt: skip
        ax.text(0.98, self.guess_rate, "chance", transform=ax.get_yaxis_transform(), color=REFERENCE, fontsize=8,
                ha="right", va="bottom")  # fmt: skip
        ticks = x if x.size <= 8 else np.geomspace(x.min(), x.max(), 6)
        ax.set_xticks(ticks, [f"{self._shown(tick):.3g}" for tick in ticks])
        ax.minorticks_off()
        what = "parameter" if self.parameter is None else self.parameter
        over = ""
        if self.reference is not None and self.parameter is not None:
            over = f"'s {self.reference:g} {UNITS[self.parameter]}"
        ax.set_xlabel(f"{what}, {name} to the reference{over} [1]")
        ax.set_ylabel("proportion correct [1]")
        ax.set_ylim(min(0.4, float((low if bars else share).min())) - 0.03, 1.03)
        return tidy(ax)

    def _shown(self, difference: float) -> float:
        return math.exp(-difference if self.side == "below" else difference)
