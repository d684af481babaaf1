"""What a design can show, before anybody has taken part."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from burrlab.psychophysics.rules import RULES, RuleName, TaskName, rule_of
from burrlab.psychophysics.statistics.equivalence import (
    decision_text,
    equivalence_power,
)
from burrlab.psychophysics.statistics.observer import Observer, critical_score

_D_PRIMES = (0.5, 1.0, 1.5, 2.0, 3.0)


@dataclass(frozen=True)
class PowerRow:
    """One d' by one rule.

    Attributes
    ----------
    rule : {"independent-observations", "differencing"}
    d_prime : float
    score, score_sd : float
        Expected of one subject, of all trials.
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
    """Equivalence by one rule, if d' is 0.

    Attributes
    ----------
    rule : {"independent-observations", "differencing"}
    delta, power : float
    decidable_delta : float
        The smallest Delta of 80 % power; inf where none has.
    """

    rule: RuleName
    delta: float
    power: float
    decidable_delta: float


@dataclass(frozen=True)
class DesignPower:
    """What a design can show. Prints as a small table.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    trials, subjects : int
        Trials of each subject.
    level : float
        Error rate of the tests, one-sided.
    lapse : float
        Share of answers at random.
    critical_score : int or None
        From which a subject is above chance; None where no score is.
    error_rate : float
        Of that test.
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
        lines = [
            f"{self.task}, {self.trials} trials, {people}; unbiased, {100 * self.lapse:g} % lapses; tests at {100 * self.level:g} %, one-sided"
        ]
        if self.critical_score is None:
            lines.append("no score of one subject is above chance: too few trials")
        else:
            lines.append(
                f"a subject is above chance from {self.critical_score} of {self.trials} (by guessing {100 * self.error_rate:.1f} %)"
            )
        rules = list(dict.fromkeys(row.rule for row in self.rows))
        if rules:
            columns = "score subject" + (" group" if self.subjects > 1 else "")
            lines.append(" " * 8 + "".join(f"{rule:>26}" for rule in rules))
            lines.append("d'      " + f"{columns:>26}" * len(rules))
        for d in dict.fromkeys(row.d_prime for row in self.rows):
            cells = [self._cell(row) for row in self.rows if row.d_prime == d]
            lines.append(f"{d:<8g}" + "".join(f"{cell:>26}" for cell in cells))
        lines.extend(
            decision_text(
                f"equivalence ({row.rule}): {people} x {self.trials} trials",
                row.delta,
                row.power,
                row.decidable_delta,
            )
            for row in self.equivalence
        )
        return "\n".join(lines)

    @staticmethod
    def _cell(row: PowerRow) -> str:
        group = "" if row.group is None else f" {100 * row.group:>3.0f} %"
        return f"{row.score:>5.1f}   {100 * row.subject:>3.0f} %{group}"

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null for inf."""
        out = asdict(self)
        for row in out["equivalence"]:
            if math.isinf(row["decidable_delta"]):
                row["decidable_delta"] = None
        return out


def design_power(
    task: str,
    *,
    trials: int,
    subjects: int = 1,
    rules: Sequence[str] = RULES,
    d_primes: Sequence[float] = _D_PRIMES,
    level: float = 0.05,
    lapse: float = 0.02,
    delta: float | None = None,
) -> DesignPower:
    """Expected scores and power of a design.

    Parameters
    ----------
    task : {"same-different", "abx", "2ifc"}
    trials, subjects : int
        Trials of each subject, even: half of each kind.
    rules : sequence of str, optional
        Both by default.
    d_primes : sequence of float, optional
    level : float, optional
        Error rate of the tests, one-sided.
    lapse : float, optional
        Share of answers at random.
    delta : float, optional
        For the power of `equivalence` at d' = 0.

    Raises
    ------
    ValueError
        If the task or a rule is unknown, there is no rule, trials are not even and at least 2, there is no subject, a d' is negative, level is not in
        (0, 0.5], lapse not in [0, 1), or delta not above 0.

    Notes
    -----
    A subject's power is exact. A group's is simulated with 4000 experiments and a fixed seed: its standard error is below 0.008. Subjects
    are alike and unbiased; bias and differences between subjects cost power.

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
    check_design(trials, subjects, level, lapse)
    decisions = [rule_of(task, rule) for rule in rules]
    if not decisions:
        raise ValueError("rules must hold a rule, got none")
    for d in d_primes:
        check_d_prime("d_primes", d)
    critical, error_rate = critical_score(trials, level)
    rows = []
    for decision in decisions:
        for d in d_primes:
            observer = Observer(decision, d, trials, lapse)
            k = np.arange(trials + 1)
            mean = float(observer.scores @ k)
            sd = math.sqrt(max(0.0, float(observer.scores @ k**2) - mean**2))
            group = observer.group(subjects, level) if subjects > 1 else None
            subject = observer.from_score(critical)
            rows.append(PowerRow(decision.name, float(d), mean, sd, subject, group))
    tested = []
    if delta is not None:
        check_delta(delta)
        for decision in decisions:
            hits, answers = Observer(decision, 0.0, trials, lapse).answers(subjects)
            sizes = [(trials // 2, trials // 2)] * subjects
            power, least = equivalence_power(decision, hits, answers, sizes, delta=delta, error=level)
            tested.append(EquivalenceRow(decision.name, float(delta), power, least))
    return DesignPower(
        task=decisions[0].task,
        trials=trials,
        subjects=subjects,
        level=level,
        lapse=lapse,
        critical_score=critical,
        error_rate=error_rate,
        rows=tuple(rows),
        equivalence=tuple(tested),
    )


def check_design(trials: int, subjects: int, level: float, lapse: float) -> None:
    if trials < 2 or trials % 2:
        raise ValueError(f"trials must be even and at least 2, got {trials}")
    if subjects < 1:
        raise ValueError(f"subjects must be at least 1, got {subjects}")
    if not 0.0 < level <= 0.5:
        raise ValueError(f"level must be in (0, 0.5], got {level}")
    if not 0.0 <= lapse < 1.0:
        raise ValueError(f"lapse must be in [0, 1), got {lapse}")


def check_d_prime(name: str, value: float) -> None:
    if not 0.0 <= value < math.inf:
        raise ValueError(f"{name} must be at least 0 and finite, got {value}")


def check_delta(value: float) -> None:
    if not 0.0 < value < math.inf:
        raise ValueError(f"delta must be a number above 0, got {value}")
