"""d' of one subject with exact and likelihood intervals, and tests of the score and of types of trials."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri, xlogy

from burrlab.common.check import refuse
from burrlab.common.table import probability_text
from burrlab.psychophysics.group import log_choose, task_of_all
from burrlab.psychophysics.rules import (
    BELOW_CHANCE,
    Counts,
    Floats,
    Rule,
    RuleName,
    TaskName,
    check_level,
    halving,
    one_of,
    rule_of,
)

CorrectionName: TypeAlias = Literal["none", "log-linear"]

LARGEST = 40.0  # d' at which answers are certain in double precision by every rule
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_SECTIONS = 32  # leave 2e-7 of the range of criteria, 1e-11 of the likelihood at its flat top
_HALVINGS = 40  # of the range up to LARGEST: 4e-11


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Possible outcomes of an experiment, as arrays of one shape.

    Attributes
    ----------
    hits, signals, false_alarms, noises : ndarray of float
        As in `Counts`.
    """

    hits: Floats
    signals: Floats
    false_alarms: Floats
    noises: Floats

    @classmethod
    def of(cls, counts: Counts) -> "Outcomes":
        """The observed outcome, as arrays without dimension."""
        numbers = (counts.hits, counts.signals, counts.false_alarms, counts.noises)
        return cls(*(np.asarray(number, dtype=np.float64) for number in numbers))

    @classmethod
    def all(cls, signals: int, noises: int) -> "Outcomes":
        """All (signals + 1)(noises + 1) possible outcomes; false alarms vary fastest."""
        hits, alarms = np.meshgrid(np.arange(signals + 1.0), np.arange(noises + 1.0), indexing="ij")
        full = np.ones(hits.size)
        return cls(hits.ravel(), signals * full, alarms.ravel(), noises * full)

    @property
    def rates(self) -> tuple[Floats, Floats]:
        """Hit rate and false-alarm rate; 1/2 without such trials."""
        with np.errstate(invalid="ignore"):
            return (
                np.where(self.signals > 0, self.hits / self.signals, 0.5),
                np.where(self.noises > 0, self.false_alarms / self.noises, 0.5),
            )

    @property
    def undetermined(self) -> NDArray[np.bool_]:
        """Whether all d' are equally likely: always the same answer, or no trial of one kind."""
        positive, trials = self.hits + self.false_alarms, self.signals + self.noises
        return np.asarray((positive == 0) | (positive == trials) | (self.signals == 0) | (self.noises == 0))

    def estimate(self, rule: Rule) -> tuple[Floats, Floats]:
        """The maximum-likelihood estimates of d', in [0, inf], and of the criterion.

        If H <= F, d' is 0 and the criterion is that of the pooled rate. If d' is undetermined, the smallest
        value, 0, is taken.
        """
        h, f = self.rates
        pooled = (self.hits + self.false_alarms) / (self.signals + self.noises)
        d, criterion = rule.invert(h, f)
        zero = (h <= f) | self.undetermined
        return np.where(zero, 0.0, d), np.where(zero, rule.criterion_of(0.0, pooled), criterion)

    def log_likelihood(self, hit: Floats, miss: Floats, alarm: Floats, rejection: Floats) -> Floats:
        """The log-likelihood from the logarithms of the four rates, without binomial coefficients."""
        terms = (
            (self.hits, hit), (self.signals - self.hits, miss),
            (self.false_alarms, alarm), (self.noises - self.false_alarms, rejection),
        )  # fmt: skip
        # The rate of an answer that was never given may be 0.
        return np.asarray(sum(n * np.where(n > 0, log_rate, 0.0) for n, log_rate in terms))

    def greatest(self) -> Floats:
        """The log-likelihood at the estimate."""
        h, f = self.rates
        positive, trials = self.hits + self.false_alarms, self.signals + self.noises
        apart = (
            xlogy(self.hits, h) + xlogy(self.signals - self.hits, 1.0 - h)
            + xlogy(self.false_alarms, f) + xlogy(self.noises - self.false_alarms, 1.0 - f)
        )  # fmt: skip
        pooled = xlogy(positive, positive / trials) + xlogy(trials - positive, 1.0 - positive / trials)
        return np.asarray(np.where((h > f) | self.undetermined, apart, pooled))

    def deviance(self, rule: Rule, d_prime: ArrayLike) -> Floats:
        """-2 log of the likelihood at d', with the best criterion, over the greatest; 0 at the estimate.

        A golden section finds the criterion, in which the log-likelihood is concave.
        """
        d = np.asarray(d_prime, dtype=np.float64)
        low, high = np.broadcast_arrays(*rule.criterion_range(d, *self.rates))
        inner_low, inner_high = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        at_one, at_two = (self.log_likelihood(*rule.log_rates(d, x)) for x in (inner_low, inner_high))
        best = np.maximum(at_one, at_two)
        for _ in range(_SECTIONS):
            left = at_one > at_two
            low, high = np.where(left, low, inner_low), np.where(left, inner_high, high)
            new = np.where(left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
            at_new = self.log_likelihood(*rule.log_rates(d, new))
            inner_low, inner_high = np.where(left, new, inner_high), np.where(left, inner_low, new)
            at_one, at_two = np.where(left, at_new, at_two), np.where(left, at_one, at_new)
            best = np.maximum(best, at_new)
        return np.asarray(np.where(self.undetermined, 0.0, np.maximum(2.0 * (self.greatest() - best), 0.0)))

    def standard_error(self, rule: Rule) -> Floats:
        """Standard error of d' from the information at the estimate; nan if d' or a rate is at a bound."""
        h, f = self.rates
        d, criterion = self.estimate(rule)
        inner = (h > f) & (h < 1.0) & (f > 0.0) & ~self.undetermined
        hit_d, hit_c, alarm_d, alarm_c = rule.slopes(np.where(inner, d, 1.0), np.where(inner, criterion, 1.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            variance = (
                alarm_c**2 * h * (1.0 - h) / self.signals + hit_c**2 * f * (1.0 - f) / self.noises
            ) / (hit_d * alarm_c - hit_c * alarm_d) ** 2
        return np.where(inner, np.sqrt(variance), np.nan)

    def corrected(self) -> tuple[Floats, Floats]:
        """Hit rate and false-alarm rate with half an answer more in each cell, for perfect scores and empty cells."""
        return (self.hits + 0.5) / (self.signals + 1.0), (self.false_alarms + 0.5) / (self.noises + 1.0)

    def profile_interval(self, rule: Rule, level: float) -> tuple[Floats, Floats]:
        """The d' in [0, inf) whose deviance is at most the chi-square quantile with one degree of freedom.

        The lower end is 0 if the interval contains 0; the upper end is inf if open.
        """
        limit = float(chdtri(1.0, 1.0 - level))
        middle = np.minimum(self.estimate(rule)[0], LARGEST)

        def beyond(d: Floats) -> NDArray[np.bool_]:
            return np.asarray(self.deviance(rule, d) > limit)

        def end(outside: float, otherwise: float) -> Floats:
            bound = 0.5 * sum(halving(lambda d: ~beyond(d), middle, outside, _HALVINGS))
            return np.where(beyond(np.full_like(middle, outside)), bound, otherwise)

        return end(0.0, 0.0), end(LARGEST, np.inf)


_CRITERIA = 241  # number of criteria for a p value; 2401 raise it by less than 0.002
_RAREST = 1e-6  # rate at which the range of criteria ends
_TIE = 1e-7  # deviances closer than this are equal
_SCANNED = 33  # points of the first scan of d', up to deviances that every test rejects
_MOST = 4_000_000  # most outcomes; a test then takes seconds, and some fifty are made
_TEST_HALVINGS = 16  # between two points of the scan: 1e-5 of d'


def binomial(trials: int, log_rate: Floats, log_other: Floats) -> Floats:
    """Probabilities of 0 to `trials` answers, one row for each rate."""
    k = np.arange(trials + 1.0)
    # at most one of a rate's logarithms is -inf; 0 times it must be 0
    log_rate, log_other = (np.maximum(x, -1e300)[..., None] for x in (log_rate, log_other))
    return np.asarray(np.exp(log_choose(trials, k) + k * log_rate + (trials - k) * log_other))


def exact_p_value(counts: Counts, rule: Rule, d_prime: float) -> float:
    """The p value of d' for the observed outcome: the largest over all criteria."""
    deviance = (
        Outcomes.all(counts.signals, counts.noises).deviance(rule, d_prime).reshape(counts.signals + 1, -1)
    )
    beyond = deviance >= deviance[counts.hits, counts.false_alarms] - _TIE
    of_hits, of_alarms = _probabilities(rule, counts.signals, counts.noises, d_prime)
    return min(float(np.max(np.sum((of_hits @ beyond) * of_alarms, axis=1))), 1.0)


def exact_interval(counts: Counts, rule: Rule, level: float) -> tuple[float, float]:
    """The smallest and largest d' in [0, inf) that the exact test does not reject; inf if open above."""
    outcomes = (counts.signals + 1) * (counts.noises + 1)
    refuse(
        outcomes > _MOST,
        f"counts must have at most {_MOST} possible outcomes for method 'exact', got {outcomes}: take "
        "'profile'",
    )
    observed, error = Outcomes.of(counts), 1.0 - level
    if bool(observed.undetermined):
        return 0.0, math.inf
    is_open = exact_p_value(counts, rule, LARGEST) > error
    # A deviance this large has a p value below the error rate: each outcome has a probability below
    # exp(-deviance/2).
    grid = np.linspace(0.0, LARGEST, 401)
    near = grid[np.asarray(observed.deviance(rule, grid)) <= 2.0 * math.log(outcomes / error)]
    first, last = max(float(near[0]) - 0.1, 0.0), float(near[-1]) + 0.1
    if is_open:
        last = min(last, float(observed.profile_interval(rule, level)[0]) + 1.0)
    estimate = float(observed.estimate(rule)[0])
    scanned = np.unique(np.append(np.linspace(first, last, _SCANNED), min(estimate, last)))

    def keeps(d: Floats) -> bool:
        return exact_p_value(counts, rule, float(d)) > error

    accepted = np.flatnonzero([keeps(d) for d in scanned])

    def end(last: int, beyond: int) -> float:
        return float(halving(keeps, scanned[last], scanned[beyond], _TEST_HALVINGS)[1])

    low = 0.0 if scanned[accepted[0]] == 0.0 else end(accepted[0], accepted[0] - 1)
    return low, math.inf if is_open else end(accepted[-1], accepted[-1] + 1)


def _probabilities(rule: Rule, signals: int, noises: int, d_prime: float) -> tuple[Floats, Floats]:
    """Probabilities of the numbers of hits and of false alarms, one row for each criterion."""
    criteria = np.linspace(*rule.criterion_range(d_prime, _RAREST, 1.0 - _RAREST), _CRITERIA)
    hit, miss, alarm, rejection = rule.log_rates(d_prime, criteria)
    return binomial(signals, hit, miss), binomial(noises, alarm, rejection)


MethodName: TypeAlias = Literal["exact", "profile"]


_CRITERION_TEXTS = {
    ("same-different", "differencing"): "k [sd]: observations further apart than k are different",
    ("same-different", "independent-observations"): "c [z]: 0 is unbiased, above 0 favours same",
    ("abx", "differencing"): "c [z]: 0 is unbiased, above 0 favours second",
    ("abx", "independent-observations"): "c [z]: 0 is unbiased, above 0 favours second",
    ("2ifc", "differencing"): "c [z]: 0 is unbiased, above 0 favours second",
    ("2ifc", "independent-observations"): "c [z]: 0 is unbiased, above 0 favours second",
}


@dataclass(frozen=True)
class DPrime:
    """d' of one subject under one rule. Made by `d_prime`.

    Attributes
    ----------
    task, rule : str
        As for `rule_of`.
    estimate : float
        Maximum-likelihood estimate in [0, inf]: 0 if the hit rate is not above the false-alarm rate, inf if
        the likelihood rises without limit.
    interval : (float, float)
        Ends in [0, inf]; inf is an open end.
    level : float
        Level of the interval.
    method : {"exact", "profile"}
        Method of the interval.
    standard_error : float or None
        From the information at the estimate; None unless the interval excludes 0 and the estimate is finite.
    criterion : float
        Criterion at the estimate; infinite if a rate is 0 or 1, nan for a perfect score.
    criterion_meaning : str
        Name, unit and direction of the criterion.
    corrected : float
        d' of the rates after `correction`; with "none", the estimate. The interval is not corrected.
    correction : {"none", "log-linear"}
    undetermined : bool
        Whether all d' fit equally well (always the same answer, or no trial of one kind): estimate 0,
        interval [0, inf).
    counts : Counts
    """

    task: TaskName
    rule: RuleName
    estimate: float
    interval: tuple[float, float]
    level: float
    method: MethodName
    standard_error: float | None
    criterion: float
    criterion_meaning: str
    corrected: float
    correction: CorrectionName
    undetermined: bool
    counts: Counts

    def __str__(self) -> str:
        low, high = self.interval
        above = "open)" if math.isinf(high) else f"{high:.2f}]"
        name, meaning = self.criterion_meaning.split(" ", 1)
        return "\n".join(filter(None, (
            f"d' {self.estimate:.2f}, {100 * self.level:g} % [{low:.2f}, {above} ({self.rule}, {self.method})",
            "the answers say nothing of d': one answer was always given, or one kind of trial is missing"
            * self.undetermined,
            "" if self.standard_error is None else f"standard error {self.standard_error:.2f}",
            "" if self.correction == "none" else f"corrected d' {self.corrected:.2f} ({self.correction})",
            f"criterion {name} {self.criterion:.2f} {meaning}",
        )))  # fmt: skip


_INTERVALS: Mapping[str, Callable[[Counts, Rule, float], tuple[Any, Any]]] = {
    "exact": exact_interval,
    "profile": lambda counts, rule, level: Outcomes.of(counts).profile_interval(rule, level),
}  # fmt: skip


def d_prime(
    counts: Counts,
    *,
    rule: str,
    level: float = 0.95,
    method: str = "exact",
    correction: str = "none",
) -> DPrime:
    """Estimate d' with an interval on [0, inf).

    The model is hits ~ Binomial(signals, H(d', c)), false alarms ~ Binomial(noises, F(d', c)), with a free
    criterion c.

    Parameters
    ----------
    counts : Counts
    rule : {"independent-observations", "differencing"}
    level : float, default 0.95
        Level of the interval, in (0, 1).
    method : {"exact", "profile"}, default "exact"
        "exact": d' that the likelihood-ratio test does not reject, by its exact distribution at the worst
        criterion; the coverage is at least the level. "profile": the same with chi-square's distribution;
        fast, but too short if nearly all answers are correct.
    correction : {"none", "log-linear"}, default "none"
        Correction of `corrected` only. "log-linear": half an answer more in each cell (Hautus 1995).

    Returns
    -------
    DPrime

    Raises
    ------
    ValueError
        If the rule, method or correction is unknown, the level is not in [0.5, 1), or "exact" is given for more than
        4 million possible outcomes (2000 trials of each kind).

    Notes
    -----
    In same-different and ABX d' has no sign: 0 is a boundary, where the information is 0, and intervals such
    as estimate +- 1.96 standard errors fail (see `docs/psychophysics.md`). "exact" includes 0 unless an exact
    one-sided test at 1 - level rejects it; "profile" unless one at about half of that does.

    References
    ----------
    M. J. Hautus, Behavior Research Methods, Instruments, and Computers 27, 46-51, 1995.

    Examples
    --------
    >>> counts = Counts("same-different", hits=5, signals=6, false_alarms=2, noises=6)
    >>> print(d_prime(counts, rule="differencing"))
    d' 2.73, 95 % [0.00, 4.61] (differencing, exact)
    criterion k 1.37 [sd]: observations further apart than k are different
    """
    law = rule_of(counts.task, rule)
    check_level(level)
    by: MethodName = one_of("method", method, get_args(MethodName))
    correcting: CorrectionName = one_of("correction", correction, get_args(CorrectionName))
    outcome = Outcomes.of(counts)
    estimate, criterion = (float(x) for x in outcome.estimate(law))
    low, high = (float(end) for end in _INTERVALS[method](counts, law, level))
    error = float(outcome.standard_error(law))
    return DPrime(
        task=counts.task,
        rule=law.name,
        estimate=estimate,
        interval=(low, high),
        level=level,
        method=by,
        standard_error=error if low > 0.0 and math.isfinite(error) else None,
        criterion=criterion,
        criterion_meaning=_CRITERION_TEXTS[counts.task, law.name],
        corrected=estimate if correction == "none" else float(law.invert(*outcome.corrected())[0]),
        correction=correcting,
        undetermined=bool(outcome.undetermined),
        counts=counts,
    )


def score_interval(counts: Counts, level: float = 0.95) -> tuple[float, float]:
    """Clopper and Pearson's exact interval of the proportion of correct answers.

    Raises
    ------
    ValueError
        If the level is not in [0.5, 1).

    Examples
    --------
    >>> low, high = score_interval(Counts("abx", hits=5, signals=5, false_alarms=1, noises=5))
    >>> print(f"{low:.3f} {high:.3f}")
    0.555 0.997
    """
    check_level(level)
    interval = scipy.stats.binomtest(counts.score, counts.trials).proportion_ci(level, method="exact")
    return float(interval.low), float(interval.high)


def binomial_test(counts: Counts) -> float:
    """The exact one-sided p value: the probability of this score or more by chance, 1/2 per trial.

    It is valid with any bias if both kinds of trial are equally frequent. Otherwise an observer who always
    gives the more frequent answer is above 1/2.

    Examples
    --------
    >>> print(f"{binomial_test(Counts('abx', hits=5, signals=5, false_alarms=1, noises=5)):.4f}")
    0.0107
    """
    return float(scipy.stats.binomtest(counts.score, counts.trials, 0.5, alternative="greater").pvalue)


def below_chance(score: int, trials: int) -> str:
    """What so low a score suggests; empty if chance explains it."""
    p = scipy.stats.binomtest(score, trials, alternative="less").pvalue
    return f"scores are below chance ({probability_text(p)}): were answers swapped?" * bool(p < BELOW_CHANCE)


_SAME_DIFFERENT = (
    ("AA", "BB", "answered different", "one material is felt with more noise than the other"),
    (
        "AB",
        "BA",
        "answered different",
        "the order of the two materials matters: memory, or a time-order error",
    ),
)
_TIES = 1e-7  # relative difference of probabilities that are equal but for rounding


@dataclass(frozen=True)
class PairCheck:
    """Comparison of two types of trials by Fisher's exact test, with each subject's total given. Made by `pair_checks`.

    Attributes
    ----------
    types : (str, str)
    counted : str
        The answer that is counted.
    counts : ((int, int), (int, int))
        (times, trials) of either type, summed over subjects.
    p_value : float
        Two-sided.
    smallest : float
        The smallest p value that these totals allow.
    meaning : str
        Meaning of a difference.
    """

    types: tuple[str, str]
    counted: str
    counts: tuple[tuple[int, int], tuple[int, int]]
    p_value: float
    smallest: float
    meaning: str

    def __str__(self) -> str:
        (n, trials), (m, others) = self.counts
        text = f"{self.types[0]} against {self.types[1]}: {self.counted} {n} of {trials} and {m} of {others}, p = {self.p_value:.3g}; "
        if self.smallest >= 1.0:
            return text + "with these answers no other split is possible"
        if self.smallest > 0.05:
            return text + f"so few trials cannot show a difference (p is at least {self.smallest:.2g})"
        return text + (self.meaning if self.p_value <= 0.05 else "no difference shown")


def pair_checks(counts: Counts | Sequence[Counts]) -> list[PairCheck]:
    """Comparisons of a task's types of trials.

    In same-different they are AA against BB and AB against BA. In ABX and two intervals they compare correct
    answers where the first and where the second is correct, which differ with a bias to a position.

    Parameters
    ----------
    counts : Counts or sequence of Counts
        Of one or several subjects in one task. Subjects may differ, because each total is taken as given. A
        type missing in `by_type` had no trial (an unfinished run).

    Raises
    ------
    ValueError
        If there are no counts, they are of several tasks, or counts of same-different lack `by_type`.

    Examples
    --------
    >>> types = {"AA": (0, 12), "BB": (7, 12), "AB": (9, 12), "BA": (8, 12)}
    >>> for check in pair_checks(Counts("same-different", 17, 24, 7, 24, by_type=types)):
    ...     print(check)
    AA against BB: answered different 0 of 12 and 7 of 12, p = 0.00458; one material is felt with more noise than the other
    AB against BA: answered different 9 of 12 and 8 of 12, p = 1; no difference shown
    """
    subjects = [counts] if isinstance(counts, Counts) else list(counts)
    if task_of_all(subjects) != "same-different":
        rows = [((s.hits, s.signals), (s.noises - s.false_alarms, s.noises)) for s in subjects]
        return [_check(("first", "second"), "correct", rows, "answers lean to one position")]
    refuse(
        not all(subject.by_type for subject in subjects),
        "counts must have the types of pairs, by_type, got none",
    )
    return [
        _check(
            (first, two),
            counted,
            [(s.by_type.get(first, (0, 0)), s.by_type.get(two, (0, 0))) for s in subjects],
            meaning,
        )
        for first, two, counted, meaning in _SAME_DIFFERENT
    ]


def _check(
    types: tuple[str, str],
    counted: str,
    rows: list[tuple[tuple[int, int], tuple[int, int]]],
    meaning: str,
) -> PairCheck:
    # Given each subject's total, the number of the first type is a sum of hypergeometric numbers.
    probabilities, least = np.ones(1), 0
    for (n, trials), (m, others) in rows:
        if trials + others:
            low, high = max(0, n + m - others), min(trials, n + m)
            row_probabilities = scipy.stats.hypergeom.pmf(
                np.arange(low, high + 1), trials + others, n + m, trials
            )
            probabilities, least = np.convolve(probabilities, row_probabilities), least + low
    table = np.array(rows).sum(axis=0)
    p, smallest = (
        min(float(probabilities[probabilities <= most * (1.0 + _TIES)].sum()), 1.0)
        for most in (probabilities[table[0, 0] - least], probabilities.min())
    )
    (n, trials), (m, others) = table.tolist()
    return PairCheck(types, counted, ((n, trials), (m, others)), p, smallest, meaning)
