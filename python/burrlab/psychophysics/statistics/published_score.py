"""What a published mean +- standard error of scores shows, and what it does not."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from burrlab.psychophysics.rules import RULES, Floats, TaskName, rule_of
from burrlab.psychophysics.statistics.group_d_prime import check_level
from burrlab.psychophysics.statistics.subject_tests import probability_text


@dataclass(frozen=True)
class PublishedScore:
    """A mean score re-analysed. Pairs are (low, high).

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    mean, sem, rounding : float
        As printed, and half a unit of the last digit.
    n, trials : int
        Subjects, and trials of each.
    t, p_value : float
        One-sided, above chance, over subjects.
    t_range : tuple of float
        Over all means and standard errors that are printed so.
    interval : tuple of float
        Of the mean score.
    level : float
    d_prime : dict of str to (float, float, float)
        By rule: of the mean and of the interval's ends, (estimate, low, high), IF all subjects are alike and unbiased.
    spread, binomial_spread : float
        Standard deviation of scores over subjects, and of one subject's score by chance at this mean.
    spread_p_value : float
        Of so large a spread if all subjects are alike.
    spread_p_range : tuple of float
        Over all means and standard errors that are printed so.
    guessers : float
        The share of subjects at chance, all others being alike, that gives this mean and spread.
    """

    task: TaskName
    mean: float
    sem: float
    rounding: float
    n: int
    trials: int
    t: float
    p_value: float
    t_range: tuple[float, float]
    interval: tuple[float, float]
    level: float
    d_prime: dict[str, tuple[float, float, float]]
    spread: float
    binomial_spread: float
    spread_p_value: float
    spread_p_range: tuple[float, float]
    guessers: float

    def __str__(self) -> str:
        level = f"{100 * self.level:.4g} %"
        low, high = self.interval
        lines = [
            f"{self.mean:g} +- {self.sem:g} of {self.trials}, {self.n} subjects ({self.task})",
            f"above chance: t({self.n - 1}) = {self.t:.1f} ({self.t_range[0]:.1f} to {self.t_range[1]:.1f} by rounding), {probability_text(self.p_value)}",
            f"mean score, {level}: {low:.2f} to {high:.2f}",
        ]
        for rule, (estimate, bottom, top) in self.d_prime.items():
            lines.append(
                f"d' if all are alike and unbiased ({rule}): {estimate:.2f} ({bottom:.2f} to {top:.2f})"
            )
        lines.append(
            f"spread {self.spread:.2f}, by chance alone {self.binomial_spread:.2f}: {probability_text(self.spread_p_value)} "
            f"({self.spread_p_range[0]:.2g} to {self.spread_p_range[1]:.2g} by rounding); {self._heterogeneity()}"
        )
        lines.append(
            f"Not shown: how many subjects can tell. {100 * self.guessers:.0f} % guessing, the rest alike, fits mean and spread. "
            "Not shown either: bias, and so d' of each."
        )
        return "\n".join(lines)

    def _heterogeneity(self) -> str:
        low, high = self.spread_p_range
        if high < 0.05:
            return "subjects differ, in d' or in bias"
        return "whether subjects differ depends on the rounding" if low < 0.05 else "subjects may be alike"

    def to_dict(self) -> dict[str, Any]:
        out = asdict(self)
        out["d_prime"] = {
            rule: [d if math.isfinite(d) else None for d in values] for rule, values in self.d_prime.items()
        }
        return out


def group_score_from(
    *,
    mean: float,
    sem: float,
    n: int,
    trials: int,
    task: TaskName = "same-different",
    level: float = 0.95,
    rounding: float = 0.05,
) -> PublishedScore:
    """What can be said from a printed mean score, its standard error and the number of subjects alone.

    Parameters
    ----------
    mean, sem : float
        Of correct answers, over subjects.
    n, trials : int
        Subjects, and trials of each.
    task : {"same-different", "abx", "2ifc"}
    level : float, optional
    rounding : float, optional
        Half a unit of the last printed digit.

    Raises
    ------
    ValueError
        If the mean is not between 0 and the trials, sem is not above the rounding, there are less than 2 subjects or trials, the
        task is unknown, rounding is negative, or the level is not in [0.5, 1).

    Notes
    -----
    Chance within a subject has variance T p (1 - p) if every trial has the same p; trials of unequal difficulty have less, so the
    test of the spread is cautious. A spread that is larger is of subjects with different p: unlike criteria do that at one d' too. A part w of guessers among subjects of one p gives the spread's excess for
    w = v/(v + (p - 1/2)^2), v the variance of p over subjects.

    Examples
    --------
    >>> paper = group_score_from(mean=9.3, sem=0.4, n=20, trials=12)
    >>> print(f"t = {paper.t:.2f}, spread {paper.spread:.2f} against {paper.binomial_spread:.2f}")
    t = 8.25, spread 1.79 against 1.45
    """
    check_level(level)
    if n < 2 or trials < 2:
        raise ValueError(f"n and trials must be at least 2, got {n} and {trials}")
    if not 0.0 < mean < trials:
        raise ValueError(f"mean must be between 0 and {trials}, got {mean}")
    if not 0.0 <= rounding < sem < math.inf:
        raise ValueError(f"sem must be above rounding, which is at least 0, got {sem} and {rounding}")
    chance, freedom = 0.5 * trials, n - 1
    t = (mean - chance) / sem
    corners = [
        (mean + a * rounding - chance) / (sem + b * rounding) for a in (-1.0, 1.0) for b in (-1.0, 1.0)
    ]
    wide = float(student.ppf(0.5 + 0.5 * level, freedom)) * sem
    interval = (max(0.0, mean - wide), min(float(trials), mean + wide))
    p = mean / trials
    noise, spread = trials * p * (1.0 - p), sem * math.sqrt(n)
    between = max(0.0, spread**2 - noise) / (trials * (trials - 1))
    return PublishedScore(
        task=task,
        mean=mean,
        sem=sem,
        rounding=rounding,
        n=n,
        trials=trials,
        t=t,
        p_value=float(student.sf(t, freedom)),
        t_range=(min(corners), max(corners)),
        interval=interval,
        level=level,
        d_prime={rule: _of_scores(task, rule, np.array([mean, *interval]) / trials) for rule in RULES},
        spread=spread,
        binomial_spread=math.sqrt(noise),
        spread_p_value=_spread_p(spread, noise, n),
        spread_p_range=_spread_p_range(mean, sem, rounding, n, trials),
        guessers=between / (between + (p - 0.5) ** 2) if between > 0.0 else 0.0,
    )


def unbiased_d_prime(task: str, rule: str, proportion: float) -> float:
    """The d' of an unbiased observer with this proportion of correct answers: 0 at 1/2 or below, inf at 1."""
    decision = rule_of(task, rule)
    if proportion <= 0.5:
        return 0.0
    if proportion >= 1.0:
        return math.inf
    low, high = 0.0, 75.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        enough = float(decision.proportion_correct(middle)) > proportion
        low, high = (low, middle) if enough else (middle, high)
    return low


def _of_scores(task: str, rule: str, proportions: Floats) -> tuple[float, float, float]:
    estimate, low, high = (unbiased_d_prime(task, rule, float(p)) for p in proportions)
    return estimate, low, high


def _spread_p_range(mean: float, sem: float, rounding: float, n: int, trials: int) -> tuple[float, float]:
    # Chance's variance is largest at the mean nearest to the middle, and smallest at one of the ends.
    ends = mean - rounding, mean + rounding
    noises = [max(0.0, x * (1.0 - x / trials)) for x in (*ends, min(max(0.5 * trials, ends[0]), ends[1]))]
    return (
        _spread_p((sem + rounding) * math.sqrt(n), min(noises), n),
        _spread_p((sem - rounding) * math.sqrt(n), max(noises), n),
    )


def _spread_p(spread: float, noise: float, n: int) -> float:
    if noise == 0.0:  # only at a mean of all or nothing, where there is no chance
        return 0.0
    return float(chi2.sf((n - 1) * spread**2 / noise, n - 1))
