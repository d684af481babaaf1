"""d' and scores of groups, with the subject as the unit, and the tests behind them; groups in publications.

Bias is removed by conditioning hits on the number of answers. If a subject says "different" K times, K shows
the bias, and the number of correct answers among the K shows d'. Given K, the hits of any observer follow
Fisher's noncentral hypergeometric distribution with the odds ratio H (1 - F) / (F (1 - H)).
"""

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaln, ndtr, stdtr

from burrlab.common.check import refuse
from burrlab.common.table import probability_text
from burrlab.psychophysics.rules import (
    RULES,
    Counts,
    Floats,
    Rule,
    RuleName,
    TaskName,
    check_level,
    halving,
    rule_of,
)

Integers: TypeAlias = NDArray[np.int64]

_CORRECTIONS = 2  # to the odds ratio; a third changes less than a hundredth of a standard deviation
_HALVINGS = 60
_WIDEST = 700.0  # log odds ratio whose exp is finite
_LARGEST = 20.0  # d' whose error rates are below double precision: 1e-23 and less, by every rule


@dataclass(frozen=True, eq=False)
class ConditionalHits:
    """Distributions of an observer's hits, for each number K of answers from 0 to signals + noises.

    Attributes
    ----------
    probability : ndarray, shape (signals + noises + 1, signals + 1)
        Probability of 0, 1, ... signals hits, one row for each K.
    mean : ndarray, shape (signals + noises + 1,)
        Expected hits.
    variance : ndarray, shape (signals + noises + 1,)
        Variance of hits.
    informative : ndarray of bool, shape (signals + noises + 1,)
        Whether more than one number of hits is possible.
    """

    probability: Floats
    mean: Floats
    variance: Floats
    informative: NDArray[np.bool_]


@lru_cache(maxsize=256)
def conditional_hits(task: str, rule: str, d_prime: float, signals: int, noises: int) -> ConditionalHits:
    """The distribution of hits at d' for every number of answers.

    Parameters
    ----------
    task, rule : str
        As for `rule_of`.
    d_prime : float
        >= 0, may be infinite: then only errors that K forces occur.
    signals, noises : int
        Trials of each kind.

    Raises
    ------
    ValueError
        If the task or the rule is unknown, or d' is negative or NaN.

    Notes
    -----
    The odds ratio depends weakly on the criterion. It is taken at the criterion that gives K answers on
    average. It is then corrected so that the expected hits, averaged over the K of this criterion, equal the
    model's. Without the correction the mean is off by up to 0.1 standard deviations of a subject, which adds
    up in a group; with it, by less than 0.05.

    Examples
    --------
    >>> guessing = conditional_hits("same-different", "differencing", 0.0, 6, 6)
    >>> print(guessing.mean[:5])
    [0.  0.5 1.  1.5 2. ]
    """
    decision = rule_of(task, rule)
    refuse(not d_prime >= 0.0, f"d_prime must be at least 0, got {d_prime}")
    answers, hits = np.arange(signals + noises + 1), np.arange(signals + 1)
    least, most = np.maximum(0, answers - noises), np.minimum(signals, answers)
    inside = (hits >= least[:, None]) & (hits <= most[:, None])
    if d_prime > _LARGEST:
        probability = (hits == most[:, None]).astype(np.float64)
    else:
        log_ways = np.where(
            inside,
            log_choose(signals, hits) + log_choose(noises, np.where(inside, answers[:, None] - hits, 0)),
            -np.inf,
        )
        probability = _distribution(decision, d_prime, signals, noises, log_ways)
    mean, informative = probability @ hits, most > least
    variance = np.maximum(0.0, probability @ hits**2 - mean**2)
    for array in (probability, mean, variance, informative):
        array.flags.writeable = False
    return ConditionalHits(probability, mean, variance, informative)


def _distribution(rule: Rule, d_prime: float, signals: int, noises: int, log_ways: Floats) -> Floats:
    hits = np.arange(signals + 1)
    hit, false_alarm = _rates_of_number(rule, d_prime, signals, noises)
    # With no answers, or only these answers, one number of hits is possible.
    log_odds = np.zeros(signals + noises + 1)
    log_odds[1:-1] = np.log(hit) - np.log1p(-hit) - np.log(false_alarm) + np.log1p(-false_alarm)
    of_signals, of_noises = (
        np.fft.rfft(scipy.stats.binom.pmf(np.arange(n + 1), n, rate[:, None]), len(log_odds))
        for n, rate in ((signals, hit), (noises, false_alarm))
    )
    # Probability of each number of answers, one row for each pair of rates
    number = np.fft.irfft(of_signals * of_noises, len(log_odds))
    probability = _tilted(log_ways, log_odds)
    for _ in range(_CORRECTIONS):
        mean = probability @ hits
        variance = np.maximum((probability @ hits**2 - mean**2)[1:-1], 1e-3)
        log_odds[1:-1] += np.clip((signals * hit - number @ mean) / variance, -0.5, 0.5)
        probability = _tilted(log_ways, np.clip(log_odds, -_WIDEST, _WIDEST))
    return probability


def _rates_of_number(rule: Rule, d_prime: float, signals: int, noises: int) -> tuple[Floats, Floats]:
    """Hit and false-alarm rates at the criteria that give 1, 2, ..., trials - 1 answers on average."""
    wanted = np.arange(1.0, signals + noises)

    def rates(z: Floats) -> tuple[Floats, Floats]:
        return rule.rates(d_prime, rule.criterion_of(d_prime, ndtr(z)))

    def few(z: Floats) -> NDArray[np.bool_]:
        hit, false_alarm = rates(z)
        return signals * hit + noises * false_alarm <= wanted

    # z(false alarm) over the range of a double
    z = halving(few, np.full(len(wanted), -38.0), np.full(len(wanted), 8.2), _HALVINGS)[0]
    hit, false_alarm = (np.clip(rate, 1e-300, 1.0 - 1e-16) for rate in rates(z))
    return hit, false_alarm


def _tilted(log_ways: Floats, log_odds: Floats) -> Floats:
    weight = log_ways + log_odds[:, None] * np.arange(log_ways.shape[1])
    weight = np.exp(weight - np.max(weight, axis=1, keepdims=True))
    return np.asarray(weight / np.sum(weight, axis=1, keepdims=True))


def log_choose(n: int, k: NDArray[Any]) -> Floats:
    """The logarithm of the number of ways to choose k of n."""
    return np.asarray(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))


_CHUNK = 2_000_000  # elements of a spectrum at a time
_WIDE = 9.0  # variance of a sum of hits above which the normal approximation is good
_CLOSE = 3.0
_LEAST = 1e-300  # least magnitude of a spectrum and least probability, in place of 0


def group_tails(
    hits: Integers, answers: Integers, subjects: Sequence[ConditionalHits]
) -> tuple[Floats, Floats]:
    """p values of so few hits and of so many hits, if the group's d' were that of `subjects`.

    Parameters
    ----------
    hits, answers : ndarray of int, shape (experiments, subjects)
        Hits, and hits plus false alarms. `answers` may have one row for all experiments.
    subjects : sequence of ConditionalHits
        One per subject, all with the same d'.

    Returns
    -------
    few, many : ndarray, shape (experiments,)
        One-sided; each is the largest p value of three tests, or 1 if no subject gave both answers.

    Notes
    -----
    The first is a t test of observed minus expected hits. Its unit is the subject, so it holds if d' differs
    between subjects. The second corrects t for skewness, as when few subjects can tell among many who
    cannot. Neither allows for equal scores that arise by chance. The third, the exact test of the sum of
    hits, does; it takes all subjects as alike.

    References
    ----------
    Hall, J. R. Stat. Soc. B 54, 221 (1992): t corrected by a monotone cubic.
    """
    exact, by_t = _exact_tails(np.sum(hits, axis=1), answers, subjects), _t_tails(hits, answers, subjects)
    return np.maximum(exact[0], by_t[0]), np.maximum(exact[1], by_t[1])


def rejected_as_few(
    hits: Integers, answers: Integers, subjects: Sequence[ConditionalHits], error: float
) -> NDArray[np.bool_]:
    """Whether `few` of `group_tails` is at most `error`.

    The exact test is made only where the normal approximation, corrected for continuity, is poor or gives a p
    value within a factor of 3 of the error rate.
    """
    out = np.asarray(_t_tails(hits, answers, subjects)[0] <= error)
    mean, variance = (
        sum(getattr(subject, name)[answered] for subject, answered in zip(subjects, answers.T, strict=True))
        for name in ("mean", "variance")
    )
    normal = ndtr((np.sum(hits, axis=1) + 0.5 - mean) / np.sqrt(np.maximum(variance, 1e-12)))
    sure = (variance > _WIDE) & ((normal < error / _CLOSE) | (normal > error * _CLOSE))
    out &= ~sure | (normal <= error)
    close = np.nonzero(out & ~sure)[0]
    if len(close):
        close_answers = answers[close] if len(answers) > 1 else answers
        out[close] = _exact_tails(np.sum(hits[close], axis=1), close_answers, subjects)[0] <= error
    return out


def excess_hits(
    hits: Integers, answers: Integers, subjects: Sequence[ConditionalHits]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Observed minus expected hits, and whether each subject is informative."""
    mean, informative = (
        np.stack(
            [getattr(s, name)[answered] for s, answered in zip(subjects, answers.T, strict=True)], axis=1
        )
        for name in ("mean", "informative")
    )
    excess = np.where(informative, hits - mean, 0.0)
    return excess, np.broadcast_to(informative, excess.shape)


def _t_tails(hits: Integers, answers: Integers, subjects: Sequence[ConditionalHits]) -> tuple[Floats, Floats]:
    excess, informative = excess_hits(hits, answers, subjects)
    n = np.sum(informative, axis=1)
    mean = np.sum(excess, axis=1) / np.maximum(n, 1)
    apart = np.where(informative, excess - mean[:, None], 0.0)
    square = np.sum(apart**2, axis=1)
    freedom = np.maximum(n - 1, 1)
    error = np.sqrt(square / freedom / np.maximum(n, 1))
    # values that are equal but for rounding have no scatter
    error = np.where(error > 1e-12 * np.maximum(np.abs(mean), 1.0), error, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(mean == 0.0, 0.0, mean / error)
        skewness = np.where(
            error > 0.0, np.sum(apart**3, axis=1) / square**1.5, 0.0
        )  # divided by the root of n
        corrected = t + skewness * t**2 / 3.0 + skewness**2 * t**3 / 27.0 + skewness / 6.0
    both = np.where(np.isfinite(t), corrected, t), t
    # One subject gives no scatter: the exact test alone decides.
    few, many = (
        np.where(n < 2, 0.0, np.maximum(*(stdtr(freedom, sign * value) for value in both)))
        for sign in (1.0, -1.0)
    )
    return np.where(n, few, 1.0), np.where(n, many, 1.0)


def _exact_tails(
    total: Integers, answers: Integers, subjects: Sequence[ConditionalHits]
) -> tuple[Floats, Floats]:
    length = sum(subject.probability.shape[1] - 1 for subject in subjects) + 1
    alike: dict[int, list[int]] = {}
    for i, subject in enumerate(subjects):
        alike.setdefault(id(subject), []).append(i)
    groups = [_logarithms(subjects[who[0]], answers[:, who], length) for who in alike.values()]
    few, many = np.empty(len(total)), np.empty(len(total))
    step = max(1, _CHUNK // length)
    for start in range(0, len(total), step):
        part = slice(start, start + step)
        rows = part if len(answers) > 1 else slice(0, 1)
        # The spectrum of the sum of hits is the product of the subjects' spectra.
        spectrum = np.exp(sum(times[rows] @ logarithm for times, logarithm in groups))
        probability = np.fft.irfft(spectrum, length, axis=1)
        row = np.arange(len(total[part])) if len(answers) > 1 else 0
        few[part] = np.cumsum(probability, axis=1)[row, total[part]]
        many[part] = 1.0 - few[part] + probability[row, total[part]]
    return np.clip(few, 0.0, 1.0), np.clip(many, 0.0, 1.0)


def _logarithms(
    subject: ConditionalHits, answers: Integers, length: int
) -> tuple[Floats, NDArray[np.complex128]]:
    """How often each number of answers occurs among equal subjects, and the logarithm of its spectrum."""
    numbers = np.unique(answers)
    times = np.stack([np.sum(answers == number, axis=1) for number in numbers], axis=1)
    spectrum = np.fft.rfft(subject.probability[numbers], length, axis=1)
    return times.astype(np.float64), np.log(np.where(np.abs(spectrum) > _LEAST, spectrum, _LEAST))


@dataclass(frozen=True)
class SubjectTest:
    """The outcome of a test.

    Attributes
    ----------
    name : str
    statistic : float or None
        t; None for an exact test, one subject, or no scatter.
    freedom : float or None
        Degrees of freedom of t.
    p_value : float or None
        None if the data allow no such test.
    side : {"greater"}
        One-sided, above 0. Files of earlier versions may have "two-sided".
    """

    name: str
    statistic: float | None
    freedom: float | None
    p_value: float | None
    side: Literal["greater", "two-sided"] = "greater"

    def __str__(self) -> str:
        if self.p_value is None:
            return f"{self.name}: not possible (one value, or no scatter)"
        return (
            f"{self.name}: "
            + ("" if self.statistic is None else f"t({self.freedom:.4g}) = {self.statistic:.2f}, ")
            + probability_text(self.p_value)
        )


def t_test(values: ArrayLike) -> SubjectTest:
    """The one-sided t test of a mean above 0."""
    x = np.asarray(values, dtype=np.float64)
    error = float(np.std(x, ddof=1)) / math.sqrt(len(x)) if len(x) > 1 else 0.0
    if not error > 0.0:  # one value, or no scatter
        return SubjectTest("t test", None, None, None)
    t, freedom = float(np.mean(x)) / error, len(x) - 1.0
    return SubjectTest("t test", t, freedom, float(scipy.stats.t.sf(t, freedom)))


def sign_flip_test(values: ArrayLike) -> SubjectTest:
    """Exact one-sided test of symmetry about 0: the share of all 2^n choices of signs whose sum is as large.

    Equal sums are counted together, so whole or half values of any number of subjects are possible.
    """
    x = np.asarray(values, dtype=np.float64)
    sums, chances = np.zeros(1), np.ones(1)
    for value in np.abs(x):
        sums, place = np.unique(np.round([sums - value, sums + value], 9), return_inverse=True)
        chances = np.bincount(place.ravel(), np.tile(0.5 * chances, 2)).astype(np.float64)
    seen, slack = float(np.sum(x)), 1e-7 * max(1.0, float(np.sum(np.abs(x))))
    return SubjectTest("sign-flip test", None, None, min(1.0, float(np.sum(chances[sums >= seen - slack]))))


# Points of the search for an end of an interval; larger d' do not differ in double precision.
GRID = (*np.arange(0.0, 4.0, 0.1), *np.arange(4.0, 10.0, 0.25), *np.arange(10.0, 21.0), math.inf)


@dataclass(frozen=True)
class GroupDPrime:
    """A group's d' by one rule. Made by `group_d_prime`.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    rule : {"independent-observations", "differencing"}
    estimate : float
        The d' at which observers with the same numbers of answers have the same mean score. 0 at chance or
        below, inf if all errors were forced by the numbers of answers, nan without an informative subject.
    interval : tuple of float
        (low, high) in [0, inf); high is inf if the interval is open above.
    level : float
    subjects, informative : int
        All subjects, and those who gave both answers: the others do not inform about d'.
    p_value : float
        One-sided p value of so high a score at d' = 0.
    """

    task: TaskName
    rule: RuleName
    estimate: float
    interval: tuple[float, float]
    level: float
    subjects: int
    informative: int
    p_value: float

    def __str__(self) -> str:
        if not self.informative:
            return f"group d' ({self.rule}): unknown, no subject gave both answers"
        low, high = self.interval
        end = "open" if math.isinf(high) else f"{high:.2f}"
        return (
            f"group d' ({self.rule}): {self.estimate:.2f}, {100 * self.level:.4g} % interval {low:.2f} to {end}, "
            f"{self.informative} of {self.subjects} subjects informative{'; scores are below chance: were answers swapped?' * (high == 0.0)}"
        )


@dataclass(frozen=True, eq=False)
class GroupAnswers:
    """Hits and answers of a group, in one experiment or in many simulated ones, and its tests at any d'.

    Attributes
    ----------
    decision : Rule
    sizes : sequence of (int, int)
        Signals and noises of each subject.
    hits, answers : ndarray of int, shape (experiments, subjects)
        `answers` may have one row for all experiments.
    """

    decision: Rule
    sizes: Sequence[tuple[int, int]]
    hits: Integers
    answers: Integers

    @classmethod
    def of(cls, counts: Sequence[Counts], rule: str) -> "GroupAnswers":
        """The one experiment of these subjects."""
        return cls(
            rule_of(task_of_all(counts), rule),
            [(c.signals, c.noises) for c in counts],
            np.array([[c.hits for c in counts]]),
            np.array([[c.hits + c.false_alarms for c in counts]]),
        )

    def at(self, d_prime: float) -> list[ConditionalHits]:
        """The distribution of each subject's hits at this d'."""
        task, rule = self.decision.task, self.decision.name
        return [conditional_hits(task, rule, float(d_prime), *size) for size in self.sizes]

    @property
    def informative(self) -> int:
        return int(np.sum(excess_hits(self.hits, self.answers, self.at(0.0))[1]))

    def excess(self, d_prime: float) -> float:
        """Observed minus expected hits of the whole group."""
        return float(np.sum(excess_hits(self.hits, self.answers, self.at(d_prime))[0]))

    def tails(self, d_prime: float) -> tuple[float, float]:
        """p values of so few and of so many hits at this d'."""
        few, many = group_tails(self.hits, self.answers, self.at(d_prime))
        return float(few[0]), float(many[0])

    def share_below(self, d_prime: float, error: float) -> float:
        """Share of experiments that reject this d' as too high."""
        return float(np.mean(rejected_as_few(self.hits, self.answers, self.at(d_prime), error)))

    def estimate(self) -> float:
        if not self.informative:
            return math.nan
        if self.excess(0.0) <= 1e-9:
            return 0.0
        if self.excess(math.inf) >= -1e-9:
            return math.inf
        return float(scipy.optimize.brentq(self.excess, 0.0, 20.0, xtol=1e-10))

    def upper(self, error: float) -> float:
        """The upper bound of d': all larger d' are rejected at this one-sided error rate."""
        return _last(lambda d: self.tails(d)[0] > error, GRID[::-1], otherwise=0.0)

    def lower(self, error: float) -> float:
        """The lower bound of d': all smaller d' are rejected."""
        return _last(lambda d: self.tails(d)[1] > error, GRID, otherwise=math.inf)


def group_d_prime(counts: Sequence[Counts], *, rule: str, level: float = 0.95) -> GroupDPrime:
    """A group's d' with its interval.

    The excess of a subject at a d' is the number of hits minus the mean of an observer with this d' and as
    many answers. The estimate is the d' with a mean excess of 0. The interval holds every d' that
    `group_tails` does not reject on either side; a rejection needs all three: t over subjects, t corrected
    for skewness, and the exact distribution of the sum.

    Parameters
    ----------
    counts : sequence of Counts
        One per subject, of one task.
    rule : {"independent-observations", "differencing"}
    level : float, optional
        Level of the interval, in [0.5, 1).

    Raises
    ------
    ValueError
        If there is no subject, the tasks differ, the rule is unknown, or the level is not in [0.5, 1).

    Notes
    -----
    Criteria may differ freely: given the number of answers, hits hardly depend on the criterion. Under
    independent observations in same-different, bias is approximated: with 48 trials the lower end for biased
    subjects is too high in up to 16 %, at a nominal 5. If d' differs between subjects, the group's d' is that
    of the mean excess, so about that of the mean score. If few people can tell and most cannot, a small group
    may include none who can; its upper end is then too low more often than stated (docs/psychophysics.md
    gives figures). Subjects with more trials have more weight.

    Examples
    --------
    >>> subject = Counts("same-different", hits=5, signals=6, false_alarms=1, noises=6)
    >>> other = Counts("same-different", hits=4, signals=6, false_alarms=2, noises=6)
    >>> print(group_d_prime([subject, other] * 6, rule="differencing"))
    group d' (differencing): 2.42, 95 % interval 1.82 to 3.01, 12 of 12 subjects informative
    """
    check_level(level)
    group = GroupAnswers.of(counts, rule)
    error = 0.5 * (1.0 - level)
    return GroupDPrime(
        task=group.decision.task,
        rule=group.decision.name,
        estimate=group.estimate(),
        interval=(group.lower(error), group.upper(error)),
        level=level,
        subjects=len(counts),
        informative=group.informative,
        p_value=group.tails(0.0)[1],
    )


def _last(holds: Callable[[float], bool], grid: Sequence[float], *, otherwise: float) -> float:
    """The point along the grid where `holds` begins, by halving between grid points."""
    place = next((i for i, point in enumerate(grid) if holds(point)), None)
    if place is None:
        return otherwise
    inside, outside = grid[place], grid[place - 1] if place else math.inf
    apart = abs(inside - outside)
    return float(
        halving(holds, inside, outside, math.ceil(math.log2(apart / 1e-6)) if apart < math.inf else 0)[0]
    )


@dataclass(frozen=True)
class GroupScore:
    """Mean score of a group, and tests of whether it is above chance. Made by `group_score`.

    Attributes
    ----------
    n : int
        Subjects.
    trials : int or None
        Trials per subject if all have the same number; scores are then counts, else proportions correct.
    mean, chance : float
    sem : float or None
        Standard error of the mean over subjects; None for one subject.
    interval : tuple of float, or None
        t interval (low, high) of the mean, cut at the ends of the scale; None for one subject, or equal scores.
    level : float
    tests : tuple of SubjectTest
        One-sided, above chance: t, and exact sign-flip.
    """

    n: int
    trials: int | None
    mean: float
    sem: float | None
    chance: float
    interval: tuple[float, float] | None
    level: float
    tests: tuple[SubjectTest, ...]

    def __str__(self) -> str:
        digits, of = (1, f" of {self.trials}") if self.trials else (3, " correct")
        return (
            f"{self.mean:.{digits}f}{'' if self.sem is None else f' +- {self.sem:.{digits}f}'}{of}, {self.n} subject{'s' if self.n > 1 else ''}; "
            + "; ".join(map(str, self.tests))
        )


def group_score(counts: Sequence[Counts], level: float = 0.95) -> GroupScore:
    """Mean score with its standard error over subjects, and tests against chance.

    Parameters
    ----------
    counts : sequence of Counts
        One per subject, of one task.
    level : float, optional
        Level of the interval.

    Raises
    ------
    ValueError
        If there is no subject, the tasks differ, or the level is not in [0.5, 1).

    Notes
    -----
    Chance is half of the trials. For a subject who always gives one answer, this needs both kinds of trial to
    be equally frequent. The sign-flip test assumes no distribution: scores without ability are symmetric
    about chance. It is exact for any number of trials and any criteria. Neither test shows that every subject
    is above chance: one may be enough.

    Examples
    --------
    >>> print(group_score([Counts("same-different", h, 6, 1, 6) for h in (3, 4, 4, 5, 6)]))
    9.4 +- 0.5 of 12, 5 subjects; t test: t(4) = 6.67, p = 0.0013; sign-flip test: p = 0.031
    """
    check_level(level)
    task_of_all(counts)
    sizes = {c.trials for c in counts}
    trials = sizes.pop() if len(sizes) == 1 else None
    scale = 1.0 if trials is None else float(trials)
    scores = np.array([c.score / c.trials for c in counts]) * scale
    above, mean = np.array([c.score - 0.5 * c.trials for c in counts]), float(np.mean(scores))
    sem = float(np.std(scores, ddof=1)) / math.sqrt(len(counts)) if len(counts) > 1 else None
    interval = _mean_interval(mean, sem, len(counts), scale, level) if sem else None
    tests = (t_test(above if trials else scores - 0.5), sign_flip_test(above))
    return GroupScore(len(counts), trials, mean, sem, 0.5 * scale, interval, level, tests)


def _mean_interval(mean: float, sem: float, n: int, most: float, level: float) -> tuple[float, float]:
    """The t interval of a mean score over n subjects, cut at the ends of the scale."""
    wide = float(scipy.stats.t.ppf(0.5 + 0.5 * level, n - 1)) * sem
    return max(0.0, mean - wide), min(most, mean + wide)


def task_of_all(counts: Sequence[Counts]) -> TaskName:
    """The one task of all subjects."""
    refuse(not counts, "counts must hold a subject, got none")
    tasks = sorted({c.task for c in counts})
    refuse(len(tasks) > 1, f"counts must be of one task, got {' and '.join(tasks)}")
    return tasks[0]


@dataclass(frozen=True)
class PublishedScore:
    """Re-analysis of a published mean score. Pairs are (low, high). Made by `group_score_from`.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    mean, sem : float
        As printed.
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
    chance = 0.5 * trials
    t = (mean - chance) / sem
    corners = [
        (mean + a * rounding - chance) / (sem + b * rounding) for a in (-1.0, 1.0) for b in (-1.0, 1.0)
    ]
    interval = _mean_interval(mean, sem, n, float(trials), level)
    p = mean / trials
    noise, spread = trials * p * (1.0 - p), sem * math.sqrt(n)
    between = max(0.0, spread**2 - noise) / (trials * (trials - 1))
    # The variance by chance is largest at the mean nearest to the middle, and smallest at one of the ends.
    ends = mean - rounding, mean + rounding
    noises = [max(0.0, x * (1.0 - x / trials)) for x in (*ends, min(max(chance, ends[0]), ends[1]))]
    return PublishedScore(
        task=task,
        mean=mean,
        sem=sem,
        n=n,
        trials=trials,
        t=t,
        p_value=float(scipy.stats.t.sf(t, n - 1)),
        t_range=(min(corners), max(corners)),
        interval=interval,
        level=level,
        d_prime={
            rule: (
                unbiased_d_prime(task, rule, float(mean) / trials),
                unbiased_d_prime(task, rule, interval[0] / trials),
                unbiased_d_prime(task, rule, interval[1] / trials),
            )
            for rule in RULES
        },
        spread=spread,
        binomial_spread=math.sqrt(noise),
        spread_p_value=_spread_p(spread, noise, n),
        spread_p_range=(
            _spread_p((sem + rounding) * math.sqrt(n), min(noises), n),
            _spread_p((sem - rounding) * math.sqrt(n), max(noises), n),
        ),
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
        return float(min(1.0, self.distribution[max(0, int(np.ceil(mean * self.kept - 1e-9))) :].sum()))

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
