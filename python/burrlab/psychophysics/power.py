"""The power of a design, before anybody takes part, and the test that d' is below a predefined Delta.

Observers are unbiased, with lapses.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from burrlab.common.check import refuse
from burrlab.common.table import probability_text
from burrlab.psychophysics.group import GRID, GroupAnswers
from burrlab.psychophysics.rules import (
    BELOW_CHANCE,
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

EXPERIMENTS = 4000  # simulated for each power: standard error 0.006 at 0.8
SEED = 6


class Observer:
    """An unbiased observer with one d' and lapses, and the distribution of scores."""

    def __init__(self, decision: Rule, d_prime: float, trials: int, lapse: float) -> None:
        rates = decision.rates(d_prime)
        self.hit, self.false_alarm = ((1.0 - lapse) * float(rate) + 0.5 * lapse for rate in rates)
        self.half = trials // 2
        k = np.arange(self.half + 1)
        of_signals, of_noises = (
            scipy.stats.binom.pmf(k, self.half, p) for p in (self.hit, 1.0 - self.false_alarm)
        )
        self.scores: Floats = np.convolve(of_signals, of_noises)

    def group(self, subjects: int, level: float) -> float:
        """Power of the one-sided t test on the scores of this number of subjects, at least two."""
        table = np.cumsum(self.scores)
        drawn = np.random.default_rng(SEED).random((EXPERIMENTS, subjects))
        above = np.searchsorted(table / table[-1], drawn, side="right") - self.half
        mean, error = np.mean(above, axis=1), np.std(above, axis=1, ddof=1) / math.sqrt(subjects)
        with np.errstate(divide="ignore", invalid="ignore"):
            p = scipy.special.stdtr(subjects - 1, -mean / error)
        # Equal scores give no t; the sign-flip test then has its least p.
        return float(np.mean(np.where(error > 0.0, p, np.where(mean > 0.0, 0.5**subjects, 1.0)) <= level))


WANTED_POWER = 0.8

_DELTA_HALVINGS = 12  # of the range 0 to 20: steps of 0.005


@dataclass(frozen=True)
class Equivalence:
    """The outcome of a one-sided test of d' >= Delta. Made by `equivalence`.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    rule : {"independent-observations", "differencing"}
    delta, level : float
    subjects, informative : int
        All subjects, and those who gave both answers: the others do not inform about d'.
    trials : tuple of int
        Fewest and most trials of a subject.
    upper : float
        The group's one-sided upper bound of d' at this level; inf if there is none.
    p_value : float
        p value of so low a score at d' >= Delta.
    p_below_chance : float
        p value of so low a score at d' = 0; no d' explains a small one.
    equivalent : bool
        Whether d' >= Delta is rejected, by scores that are not below chance.
    power : float
        Probability of rejection at d' = 0, with these subjects, trials and numbers of answers.
    decidable_delta : float
        The smallest Delta with a power of 80 %; inf if none has it.
    """

    task: TaskName
    rule: RuleName
    delta: float
    level: float
    subjects: int
    informative: int
    trials: tuple[int, int]
    upper: float
    p_value: float
    p_below_chance: float
    equivalent: bool
    power: float
    decidable_delta: float

    @property
    def sentence(self) -> str:
        """The outcome in words."""
        if not self.informative:
            return (
                f"Not decided: no subject gave both answers, so nothing is known of d' ({self.rule}), "
                "though the score is at chance."
            )
        bound = "there is no upper bound" if math.isinf(self.upper) else f"upper bound {self.upper:.2f}"
        where = f"d' ({self.rule}), {bound} at {100 * self.level:.4g} %, {probability_text(self.p_value)}"
        silent, below = self.subjects - self.informative, probability_text(self.p_below_chance)
        if self.p_below_chance < BELOW_CHANCE:
            return (
                f"Not decided: scores are below chance ({below}), which no d' explains: were answers swapped?"
            )
        return "".join((
            f"Equivalent: below {self.delta:g} in {where}." if self.equivalent else
            f"Not shown to be equivalent: {self.delta:g} or more is possible in {where}. That does not show a "
            "difference.",
            f" {silent} of {self.subjects} subjects gave one answer only: nothing is known of theirs." * bool(silent),
        ))  # fmt: skip

    def __str__(self) -> str:
        few, most = self.trials
        size = f"{self.subjects} subject{'s' if self.subjects > 1 else ''} x {few if few == most else f'{few} to {most}'} trials"
        return f"{self.sentence}\n{decision_text(size, self.delta, self.power, self.decidable_delta)}"


def equivalence(counts: Sequence[Counts], *, rule: str, delta: float, level: float = 0.95) -> Equivalence:
    """One-sided test of whether a group's d' is below Delta.

    As in `group_d_prime`, a subject's hits are compared with those of an observer with d' = Delta and as many
    answers. A subject who always says "same" scores at chance with any d', and has no weight here.

    Parameters
    ----------
    counts : sequence of Counts
        One per subject, of one task; one subject is enough.
    rule : {"independent-observations", "differencing"}
    delta : float
        > 0; must be set before the first answer.
    level : float, optional
        1 - error rate.

    Raises
    ------
    ValueError
        If there is no subject, the tasks differ, the rule is unknown, Delta is not a number above 0, or the
        level is not in [0.5, 1).

    Notes
    -----
    With one subject the exact conditional test decides alone. The power is simulated with a fixed seed, from
    the subjects' own numbers of answers and hits by guessing (hypergeometric). Lapses look like a smaller d':
    equivalence is about answers, lapses included.

    References
    ----------
    Schuirmann, J. Pharmacokinet. Biopharm. 15, 657 (1987), for two one-sided tests; this is one of the two.

    Examples
    --------
    >>> guessing = [Counts("same-different", 2, 6, 2, 6), Counts("same-different", 1, 6, 2, 6), Counts("same-different", 3, 6, 2, 6)]
    >>> print(equivalence(guessing * 4, rule="independent-observations", delta=1.5).sentence)
    Equivalent: below 1.5 in d' (independent-observations), upper bound 1.02 at 95 %, p = 0.00024.
    """
    check_level(level)
    refuse(not 0.0 < delta < math.inf, f"delta must be a number above 0, got {delta}")
    group = GroupAnswers.of(counts, rule)
    error = 1.0 - level
    # The least favourable d' >= Delta: the p value falls with d', except for the scatter in t.
    p_value = max(group.tails(d)[0] for d in (delta, *(d for d in GRID if d > delta)))
    sizes = [c.trials for c in counts]
    # the power of subjects with d' = 0 and these numbers of answers
    rng = np.random.default_rng(SEED)
    hits = [
        rng.hypergeometric(signals, noises, int(answers), EXPERIMENTS) if signals * noises else
        np.full(EXPERIMENTS, answers * (signals > 0))
        for (signals, noises), answers in zip(group.sizes, group.answers[0], strict=True)
    ]  # fmt: skip
    power, decidable = equivalence_power(replace(group, hits=np.stack(hits, axis=1)), delta, error)
    return Equivalence(
        task=group.decision.task,
        rule=group.decision.name,
        delta=float(delta),
        level=level,
        subjects=len(counts),
        informative=group.informative,
        trials=(min(sizes), max(sizes)),
        upper=group.upper(error),
        p_value=p_value,
        p_below_chance=(below := group.tails(0.0)[0]),
        equivalent=p_value <= error and below >= BELOW_CHANCE,
        power=power,
        decidable_delta=decidable,
    )


def guessing(decision: Rule, subjects: int, trials: int, lapse: float) -> GroupAnswers:
    """Simulated experiments of unbiased subjects with d' = 0."""
    observer, rng = Observer(decision, 0.0, trials, lapse), np.random.default_rng(SEED)
    hits = rng.binomial(observer.half, observer.hit, (EXPERIMENTS, subjects))
    answers = hits + rng.binomial(observer.half, observer.false_alarm, hits.shape)
    return GroupAnswers(decision, [(observer.half, observer.half)] * subjects, hits, answers)


def equivalence_power(simulated: GroupAnswers, delta: float, error: float) -> tuple[float, float]:
    """Share of experiments that reject d' >= Delta, and the smallest Delta that 80 % of them reject."""

    def enough(d_prime: float) -> bool:
        return simulated.share_below(d_prime, error) >= WANTED_POWER

    least = halving(enough, 20.0, 0.0, _DELTA_HALVINGS)[0] if enough(math.inf) else math.inf
    return simulated.share_below(delta, error), float(least)


def decision_text(size: str, delta: float, power: float, decidable: float) -> str:
    """A sentence on what a design could decide."""
    smallest = "no Delta has 80 %" if math.isinf(decidable) else f"80 % begin at Delta = {decidable:.3g}"
    if power >= WANTED_POWER:
        return f"{size} would decide Delta = {delta:g} with a power of {100 * power:.0f} % if d' were 0; {smallest}."
    return f"{size} cannot be relied on to decide Delta = {delta:g}: the power is {100 * power:.0f} % if d' were 0; {smallest}."


@dataclass(frozen=True)
class PowerRow:
    """Power at one d' by one rule.

    Attributes
    ----------
    rule : {"independent-observations", "differencing"}
    d_prime : float
    score, score_sd : float
        Mean and standard deviation of one subject's score.
    subject : float
        Power of a subject's exact binomial test.
    group : float or None
        Power of the t test on the subjects' scores; None for one subject.
    """

    rule: RuleName
    d_prime: float
    score: float
    score_sd: float
    subject: float
    group: float | None


@dataclass(frozen=True)
class EquivalenceRow:
    """Power of equivalence by one rule, at d' = 0.

    Attributes
    ----------
    rule : {"independent-observations", "differencing"}
    delta, power : float
    decidable_delta : float
        The smallest Delta with 80 % power; inf if none has it.
    """

    rule: RuleName
    delta: float
    power: float
    decidable_delta: float


@dataclass(frozen=True)
class DesignPower:
    """The power of a design; prints as a small table. Made by `design_power`.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    trials, subjects : int
        Trials per subject, and subjects.
    level : float
        One-sided error rate of the tests.
    lapse : float
        Share of random answers.
    critical_score : int or None
        Lowest score above chance; None if no score is.
    error_rate : float
        Probability of that score or more by guessing.
    rows : tuple of PowerRow
    equivalence : tuple of EquivalenceRow
    """

    task: TaskName
    trials: int
    subjects: int
    level: float
    lapse: float
    critical_score: int | None
    error_rate: float
    rows: tuple[PowerRow, ...]
    equivalence: tuple[EquivalenceRow, ...]

    def __str__(self) -> str:
        people = f"{self.subjects} subject{'s' if self.subjects > 1 else ''}"
        above = (
            "no score of one subject is above chance: too few trials" if self.critical_score is None else
            f"a subject is above chance from {self.critical_score} of {self.trials} (by guessing "
            f"{100 * self.error_rate:.1f} %)"
        )  # fmt: skip
        lines = [
            f"{self.task}, {self.trials} trials, {people}; unbiased, {100 * self.lapse:g} % lapses; tests at "
            f"{100 * self.level:g} %, one-sided",
            above,
        ]
        if rules := list(dict.fromkeys(row.rule for row in self.rows)):
            columns = "score subject" + (" group" if self.subjects > 1 else "")
            lines += [
                "        " + "".join(f"{rule:>26}" for rule in rules),
                "d'      " + f"{columns:>26}" * len(rules),
            ]
        for d in dict.fromkeys(row.d_prime for row in self.rows):
            cells = [
                f"{row.score:>5.1f}   {100 * row.subject:>3.0f} %"
                + ("" if row.group is None else f" {100 * row.group:>3.0f} %")
                for row in self.rows
                if row.d_prime == d
            ]
            lines.append(f"{d:<8g}" + "".join(f"{cell:>26}" for cell in cells))
        for row in self.equivalence:
            size = f"equivalence ({row.rule}): {people} x {self.trials} trials"
            lines.append(decision_text(size, row.delta, row.power, row.decidable_delta))
        return "\n".join(lines)


def design_power(
    task: str,
    *,
    trials: int,
    subjects: int = 1,
    rules: Sequence[str] = RULES,
    d_primes: Sequence[float] = (0.5, 1.0, 1.5, 2.0, 3.0),
    level: float = 0.05,
    lapse: float = 0.02,
    delta: float | None = None,
) -> DesignPower:
    """Expected scores and power of a design.

    Parameters
    ----------
    task : {"same-different", "abx", "2ifc"}
    trials, subjects : int
        Trials per subject (even: half of each kind), and subjects.
    rules : sequence of str, optional
        Both by default.
    d_primes : sequence of float, optional
    level : float, optional
        One-sided error rate of the tests.
    lapse : float, optional
        Share of random answers.
    delta : float, optional
        Adds the power of `equivalence` at d' = 0.

    Raises
    ------
    ValueError
        If the task or a rule is unknown, there is no rule, trials are not even and at least 2, there is no
        subject, a d' is negative, level is not in (0, 0.5], lapse not in [0, 1), or delta not above 0.

    Notes
    -----
    A subject's power is exact. A group's is simulated with 4000 experiments and a fixed seed: its standard
    error is below 0.008. Subjects are alike and unbiased; bias and differences between subjects reduce power.

    Examples
    --------
    >>> print(design_power("same-different", trials=12, subjects=12, d_primes=(1, 2)))
    same-different, 12 trials, 12 subjects; unbiased, 2 % lapses; tests at 5 %, one-sided
    a subject is above chance from 10 of 12 (by guessing 1.9 %)
              independent-observations              differencing
    d'             score subject group       score subject group
    1                6.9     6 %  50 %         6.7     4 %  36 %
    2                8.7    33 % 100 %         8.1    20 %  99 %
    """
    refuse(trials < 2 or trials % 2, f"trials must be even and at least 2, got {trials}")
    refuse(subjects < 1, f"subjects must be at least 1, got {subjects}")
    refuse(not 0.0 < level <= 0.5, f"level must be in (0, 0.5], got {level}")
    refuse(not 0.0 <= lapse < 1.0, f"lapse must be in [0, 1), got {lapse}")
    decisions = [rule_of(task, rule) for rule in rules]
    refuse(not decisions, "rules must hold a rule, got none")
    for d in d_primes:
        refuse(not 0.0 <= d < math.inf, f"d_primes must be at least 0 and finite, got {d}")
    refuse(delta is not None and not 0.0 < delta < math.inf, f"delta must be a number above 0, got {delta}")
    by_guessing = scipy.stats.binom.sf(np.arange(-1, trials), trials, 0.5)  # P(score >= k)
    enough = np.flatnonzero(by_guessing <= level * (1.0 + 1e-12))  # equal but for rounding counts as equal
    critical, error_rate = (int(enough[0]), float(by_guessing[enough[0]])) if len(enough) else (None, 0.0)
    rows, k = [], np.arange(trials + 1)
    for decision, d in itertools.product(decisions, d_primes):
        observer = Observer(decision, d, trials, lapse)
        mean = float(observer.scores @ k)
        sd = math.sqrt(max(0.0, float(observer.scores @ k**2) - mean**2))
        reached = 0.0 if critical is None else float(min(1.0, np.sum(observer.scores[critical:])))
        group = observer.group(subjects, level) if subjects > 1 else None
        rows.append(PowerRow(decision.name, float(d), mean, sd, reached, group))
    return DesignPower(
        task=decisions[0].task,
        trials=trials,
        subjects=subjects,
        level=level,
        lapse=lapse,
        critical_score=critical,
        error_rate=error_rate,
        rows=tuple(rows),
        equivalence=()
        if delta is None
        else tuple(
            EquivalenceRow(
                decision.name,
                float(delta),
                *equivalence_power(guessing(decision, subjects, trials, lapse), delta, level),
            )
            for decision in decisions
        ),
    )
