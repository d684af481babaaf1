"""Re-analysis of published mean scores, the effect of selection, and two one-sided tests of signed values."""

import math
import operator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias, cast

import numpy as np
import scipy

from burrlab.common.check import refuse
from burrlab.psychophysics.group import check_level, probability_text
from burrlab.psychophysics.rules import RULES, Floats, TaskName, halving, rule_of

Three: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class PublishedScore:
    """Re-analysis of a published mean score. Pairs are (low, high). Made by `group_score_from`.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    mean, sem, rounding : float
        As printed, and half a unit of the last digit.
    n, trials : int
        Subjects, and trials per subject.
    t, p_value : float
        One-sided, above chance, over subjects.
    t_range : tuple of float
        Range of t over all means and standard errors that round to the printed ones.
    interval : tuple of float
        Interval of the mean score.
    level : float
    d_prime : dict of str to (float, float, float)
        By rule: (estimate, low, high), from the mean and the interval's ends, IF all subjects are alike and
        unbiased.
    spread, binomial_spread : float
        Standard deviation of scores over subjects, and of one subject's score by chance at this mean.
    spread_p_value : float
        p value of this spread if all subjects are alike.
    spread_p_range : tuple of float
        Its range, as for `t_range`.
    guessers : float
        Share of subjects at chance that gives this mean and spread, if all others are alike.
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
    d_prime: dict[str, Three]
    spread: float
    binomial_spread: float
    spread_p_value: float
    spread_p_range: tuple[float, float]
    guessers: float

    def __str__(self) -> str:
        (low, high), (least, most) = self.interval, self.spread_p_range
        differ = (
            "subjects differ, in d' or in bias" if most < 0.05 else
            "whether subjects differ depends on the rounding" if least < 0.05 else
            "subjects may be alike"
        )  # fmt: skip
        return "\n".join([
            f"{self.mean:g} +- {self.sem:g} of {self.trials}, {self.n} subjects ({self.task})",
            f"above chance: t({self.n - 1}) = {self.t:.1f} ({self.t_range[0]:.1f} to {self.t_range[1]:.1f} "
            f"by rounding), {probability_text(self.p_value)}",
            f"mean score, {100 * self.level:.4g} %: {low:.2f} to {high:.2f}",
            *(
                f"d' if all are alike and unbiased ({rule}): {estimate:.2f} ({bottom:.2f} to {top:.2f})"
                for rule, (estimate, bottom, top) in self.d_prime.items()
            ),
            f"spread {self.spread:.2f}, by chance alone {self.binomial_spread:.2f}: "
            f"{probability_text(self.spread_p_value)} ({least:.2g} to {most:.2g} by rounding); {differ}",
            f"Not shown: how many subjects can tell. {100 * self.guessers:.0f} % guessing, the rest alike, "
            "fits mean and spread. Not shown either: bias, and so d' of each.",
        ])  # fmt: skip


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
    """Re-analysis of a printed mean score, standard error and number of subjects.

    Parameters
    ----------
    mean, sem : float
        Mean number of correct answers over subjects, and its standard error.
    n, trials : int
        Subjects, and trials per subject.
    task : {"same-different", "abx", "2ifc"}
    level : float, optional
    rounding : float, optional
        Half a unit of the last printed digit.

    Raises
    ------
    ValueError
        If the mean is not between 0 and the trials, sem is not above the rounding, there are fewer than 2
        subjects or trials, the task is unknown, rounding is negative, or the level is not in [0.5, 1).

    Notes
    -----
    Scores of a subject have variance T p (1 - p) by chance if every trial has the same p. Trials of unequal
    difficulty have less, so the test of the spread is conservative. A larger spread shows that p differs
    between subjects, which different criteria cause even at one d'. If a share w of the subjects guess and
    the others have one p, the variance v of p over subjects gives w = v/(v + (p - 1/2)^2).

    Examples
    --------
    >>> paper = group_score_from(mean=9.3, sem=0.4, n=20, trials=12)
    >>> print(f"t = {paper.t:.2f}, spread {paper.spread:.2f} against {paper.binomial_spread:.2f}")
    t = 8.25, spread 1.79 against 1.45
    """
    check_level(level)
    refuse(n < 2 or trials < 2, f"n and trials must be at least 2, got {n} and {trials}")
    refuse(not 0.0 < mean < trials, f"mean must be between 0 and {trials}, got {mean}")
    refuse(
        not 0.0 <= rounding < sem < math.inf,
        f"sem must be above rounding, which is at least 0, got {sem} and {rounding}",
    )
    chance, freedom = 0.5 * trials, n - 1
    t = (mean - chance) / sem
    corners = [
        (mean + a * rounding - chance) / (sem + b * rounding) for a in (-1.0, 1.0) for b in (-1.0, 1.0)
    ]
    wide = float(scipy.stats.t.ppf(0.5 + 0.5 * level, freedom)) * sem
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
        p_value=float(scipy.stats.t.sf(t, freedom)),
        t_range=(min(corners), max(corners)),
        interval=interval,
        level=level,
        d_prime={
            rule: cast(
                Three, tuple(unbiased_d_prime(task, rule, float(x) / trials) for x in (mean, *interval))
            )
            for rule in RULES
        },
        spread=spread,
        binomial_spread=math.sqrt(noise),
        spread_p_value=_spread_p(spread, noise, n),
        spread_p_range=_spread_p_range(mean, sem, rounding, n, trials),
        guessers=between / (between + (p - 0.5) ** 2) if between > 0.0 else 0.0,
    )


def unbiased_d_prime(task: str, rule: str, proportion: float) -> float:
    """The d' of an unbiased observer with this proportion correct: 0 at 1/2 or below, inf at 1."""
    decision = rule_of(task, rule)
    if not 0.5 < proportion < 1.0:
        return 0.0 if proportion <= 0.5 else math.inf
    return float(halving(lambda d: decision.proportion_correct(d) <= proportion, 0.0, 75.0, 80)[0])


def _spread_p(spread: float, noise: float, n: int) -> float:
    # There is no noise only at a mean of 0 or of all trials.
    return 0.0 if noise == 0.0 else float(scipy.stats.chi2.sf((n - 1) * spread**2 / noise, n - 1))


def _spread_p_range(mean: float, sem: float, rounding: float, n: int, trials: int) -> tuple[float, float]:
    # The variance by chance is largest at the mean nearest to the middle, and smallest at one of the ends.
    ends = mean - rounding, mean + rounding
    noises = [max(0.0, x * (1.0 - x / trials)) for x in (*ends, min(max(0.5 * trials, ends[0]), ends[1]))]
    return (
        _spread_p((sem + rounding) * math.sqrt(n), min(noises), n),
        _spread_p((sem - rounding) * math.sqrt(n), max(noises), n),
    )


_LEAST = 1e-300  # least probability, in place of 0


@dataclass(frozen=True)
class SelectionEffect:
    """Mean score of the best `kept` of `of` subjects who all answer at random.

    Parameters
    ----------
    kept, of : int
        Number of subjects selected, and from how many.
    trials : int
        Trials per subject.
    chance : float
        Probability of a correct answer in a trial.

    Raises
    ------
    ValueError
        If `kept` is below 1 or above `of`, there is no trial, or `chance` is not in (0, 1).
    TypeError
        If `kept`, `of` or `trials` is not whole.

    Notes
    -----
    The result is exact. If M_t of the subjects have t or more correct answers, the best `kept` have the sum
    of min(kept, M_t) over t >= 1, and M_t is binomial.

    Examples
    --------
    >>> effect = SelectionEffect(kept=12, of=20, trials=12)
    >>> print(f"{effect.expected:.2f} of 12, {effect.excess:.2f} above chance")
    7.06 of 12, 1.06 above chance
    """

    kept: int
    of: int
    trials: int
    chance: float = 0.5

    def __post_init__(self) -> None:
        vars(self).update({name: operator.index(getattr(self, name)) for name in ("kept", "of", "trials")})
        refuse(not 1 <= self.kept <= self.of, f"kept must be in 1..of, 1..{self.of}, got {self.kept}")
        refuse(self.trials < 1, f"trials must be at least 1, got {self.trials}")
        refuse(not 0.0 < self.chance < 1.0, f"chance must be in (0, 1), got {self.chance!r}")

    @property
    def expected(self) -> float:
        """Expected mean score of the selected subjects."""
        reaching = scipy.stats.binom.sf(np.arange(self.trials), self.trials, self.chance)
        m = np.arange(self.of + 1)
        share = scipy.stats.binom.pmf(m, self.of, reaching[:, None])
        return float((share * np.minimum(m, self.kept)).sum() / self.kept)

    @property
    def excess(self) -> float:
        """`expected` minus the score of chance: the effect of selection alone."""
        return self.expected - self.chance * self.trials

    def p_value(self, mean: float) -> float:
        """Probability that guessing subjects, so selected, have at least this mean score."""
        # A mean from a division is off by rounding.
        least = max(0, int(np.ceil(mean * self.kept - 1e-9)))
        return float(min(1.0, self.distribution[least:].sum()))

    @cached_property
    def distribution(self) -> Floats:
        """Probability of each sum of the selected subjects' scores, 0 to kept x trials."""
        p = scipy.stats.binom.pmf(np.arange(self.trials + 1), self.trials, self.chance)
        m = np.arange(self.of + 1)
        # Joint probability of M_t (rows) and the sum of min(kept, M_t) over scores from t up (columns)
        shares = np.zeros((len(m), self.kept * self.trials + 1))
        shares[0, 0] = 1.0
        for t in range(self.trials, 0, -1):
            at_t = p[t] / max(p[: t + 1].sum(), _LEAST)  # P(score t), given a score of at most t
            shares = scipy.stats.binom.pmf(m[:, None] - m, self.of - m, at_t) @ shares
            shares = np.stack([np.roll(row, min(self.kept, n)) for n, row in enumerate(shares)])
        return np.asarray(shares.sum(axis=0))
