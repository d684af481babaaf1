"""The d' of a group, subjects as units, each with a criterion of his own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.rules import RuleName, TaskName, rule_of
from burrlab.psychophysics.statistics.conditional_hits import ConditionalHits, conditional_hits
from burrlab.psychophysics.statistics.group_tails import excess_hits, group_tails

# Where an end of an interval is looked for: beyond, a double sees no difference.
GRID = (*np.arange(0.0, 4.0, 0.1), *np.arange(4.0, 10.0, 0.25), *np.arange(10.0, 21.0), math.inf)


@dataclass(frozen=True)
class GroupDPrime:
    """A group's d' by one rule.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    rule : {"independent-observations", "differencing"}
    estimate : float
        The d' at which the subjects' scores are, on average, those of observers who answer as often; 0 at chance or below,
        inf where nobody made an error that his number of answers did not force, nan without an informative subject.
    interval : tuple of float
        (low, high) in [0, inf); high is inf where the interval is open above.
    level : float
    subjects, informative : int
        All, and those who gave both answers: the others say nothing of d'.
    p_value : float
        One-sided, of so high a score at d' = 0.
    """

    task: TaskName
    rule: RuleName
    estimate: float
    interval: tuple[float, float]
    level: float
    subjects: int
    informative: int
    p_value: float

    @property
    def open_above(self) -> bool:
        return math.isinf(self.interval[1])

    def __str__(self) -> str:
        low, high = self.interval
        if not self.informative:
            return f"group d' ({self.rule}): unknown, no subject gave both answers"
        end = "open" if self.open_above else f"{high:.2f}"
        count = f"{self.informative} of {self.subjects} subjects informative"
        return f"group d' ({self.rule}): {self.estimate:.2f}, {100 * self.level:.4g} % interval {low:.2f} to {end}, {count}"

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null for inf and nan."""
        out = asdict(self)
        out["estimate"] = self.estimate if math.isfinite(self.estimate) else None
        out["interval"] = [end if math.isfinite(end) else None for end in self.interval]
        return out | {"open_above": self.open_above}


class Group:
    """The subjects' hits and answers, and their tests at any d'."""

    def __init__(self, counts: Sequence[Counts], rule: str) -> None:
        if not counts:
            raise ValueError("counts must hold a subject, got none")
        tasks = sorted({c.task for c in counts})
        if len(tasks) > 1:
            raise ValueError(f"counts must be of one task, got {' and '.join(tasks)}")
        self.decision = rule_of(tasks[0], rule)
        self.sizes = [(c.signals, c.noises) for c in counts]
        self.hits = np.array([[c.hits for c in counts]])
        self.answers = np.array([[c.hits + c.false_alarms for c in counts]])

    def at(self, d_prime: float) -> list[ConditionalHits]:
        """A subject's hits if his d' were this."""
        task, rule = self.decision.task, self.decision.name
        return [conditional_hits(task, rule, float(d_prime), *size) for size in self.sizes]

    @property
    def informative(self) -> int:
        return int(np.sum(excess_hits(self.hits, self.answers, self.at(0.0))[1]))

    def excess(self, d_prime: float) -> float:
        """Hits of the whole group less the expected ones."""
        return float(np.sum(excess_hits(self.hits, self.answers, self.at(d_prime))[0]))

    def few(self, d_prime: float) -> float:
        """p value of so few hits at this d'."""
        return float(group_tails(self.hits, self.answers, self.at(d_prime))[0][0])

    def many(self, d_prime: float) -> float:
        """p value of so many hits at this d'."""
        return float(group_tails(self.hits, self.answers, self.at(d_prime))[1][0])

    def estimate(self) -> float:
        if not self.informative:
            return math.nan
        if self.excess(0.0) <= 1e-9:
            return 0.0
        if self.excess(math.inf) >= -1e-9:
            return math.inf
        return float(brentq(self.excess, 0.0, 20.0, xtol=1e-10))

    def upper(self, error: float) -> float:
        """The least d' above which all are rejected, each with this one-sided error rate."""
        return _last(lambda d: self.few(d) > error, GRID[::-1], otherwise=0.0)

    def lower(self, error: float) -> float:
        """The largest d' below which all are rejected."""
        return _last(lambda d: self.many(d) > error, GRID, otherwise=math.inf)


def group_d_prime(counts: Sequence[Counts], *, rule: str, level: float = 0.95) -> GroupDPrime:
    """A group's d' with its interval.

    A subject's excess at a d' is his hits less those that an observer of this d' would have on average who gives the answer as
    often as he did. The estimate is the d' of no mean excess; the interval holds every d' whose excess is not rejected on either
    side by `group_tails`: t over subjects, with and without skewness, and the exact distribution of the sum must all reject.

    Parameters
    ----------
    counts : sequence of Counts
        One a subject, of one task.
    rule : {"independent-observations", "differencing"}
    level : float, optional
        Of the interval, 0.5 to 1 exclusive.

    Raises
    ------
    ValueError
        If there is no subject, the tasks differ, the rule is unknown, or the level is not in [0.5, 1).

    Notes
    -----
    Criteria may differ as they like: given how often a subject gives the answer, his hits hardly depend on it. By independent observations in
    same-different a bias is approximated: with 48 trials the lower end of biased subjects is too high in up to 16 %, at a nominal 5. Where d' differs
    between subjects, the group's is that of the mean excess, so about that of the mean score. Where few subjects can tell among many who
    cannot, so small a group may hold none of them: the upper end is then too low more often than stated (docs/psychophysics.md has figures).
    Of subjects with several numbers of trials, those with more count for more.

    Examples
    --------
    >>> subject = Counts("same-different", hits=5, signals=6, false_alarms=1, noises=6)
    >>> other = Counts("same-different", hits=4, signals=6, false_alarms=2, noises=6)
    >>> print(group_d_prime([subject, other] * 6, rule="differencing"))
    group d' (differencing): 2.42, 95 % interval 1.82 to 3.01, 12 of 12 subjects informative
    """
    check_level(level)
    group = Group(counts, rule)
    error = 0.5 * (1.0 - level)
    return GroupDPrime(
        task=group.decision.task,
        rule=group.decision.name,
        estimate=group.estimate(),
        interval=(group.lower(error), group.upper(error)),
        level=level,
        subjects=len(counts),
        informative=group.informative,
        p_value=group.many(0.0),
    )


def check_level(level: float) -> None:
    if not 0.5 <= level < 1.0:
        raise ValueError(f"level must be in [0.5, 1), got {level}")


def _last(holds: Callable[[float], bool], grid: Sequence[float], *, otherwise: float) -> float:
    """Where `holds` begins along the grid, by halving between its points."""
    before = None
    for point in grid:
        if holds(point):
            if before is None or math.isinf(before):
                return float(point)
            inside, outside = point, before
            while abs(inside - outside) > 1e-6:
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if holds(middle) else (inside, middle)
            return float(inside)
        before = point
    return otherwise
