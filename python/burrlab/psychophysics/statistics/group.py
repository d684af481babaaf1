"""Scores of a group: the subject is the unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.rules import Floats
from burrlab.psychophysics.statistics.group_d_prime import check_level
from burrlab.psychophysics.statistics.subject_tests import (
    SubjectTest,
    label_test,
    sign_flip_test,
    t_test,
    welch_test,
)


@dataclass(frozen=True)
class GroupScore:
    """Mean score of a group, and whether it is above chance.

    Attributes
    ----------
    n : int
        Subjects.
    trials : int or None
        A subject's, where all have as many; then scores are counts, else proportions of correct answers.
    mean, chance : float
    sem : float or None
        Standard error of the mean over subjects; None of one subject.
    interval : tuple of float, or None
        (low, high) of the mean, by t, cut at the ends of the scale.
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
        error = "" if self.sem is None else f" +- {self.sem:.{1 if self.trials else 3}f}"
        mean = f"{self.mean:.1f}" if self.trials else f"{self.mean:.3f}"
        of = f" of {self.trials}" if self.trials else " correct"
        return f"{mean}{error}{of}, {self.n} subject{'s' if self.n > 1 else ''}; " + "; ".join(
            map(str, self.tests)
        )

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class ScoreDifference:
    """Two conditions or two groups.

    Attributes
    ----------
    difference : float
        Mean of the first less that of the second, in proportions of correct answers.
    interval : tuple of float, or None
        By t; None where there is no scatter.
    level : float
    paired : bool
    n : tuple of int
        Subjects of each.
    tests : tuple of SubjectTest
        Two-sided.
    """

    difference: float
    interval: tuple[float, float] | None
    level: float
    paired: bool
    n: tuple[int, int]
    tests: tuple[SubjectTest, ...]

    def __str__(self) -> str:
        kind = f"{self.n[0]} subjects in both" if self.paired else f"{self.n[0]} and {self.n[1]} subjects"
        ends = "" if self.interval is None else f" ({self.interval[0]:+.3f} to {self.interval[1]:+.3f})"
        return f"difference {self.difference:+.3f}{ends}, {kind}; " + "; ".join(map(str, self.tests))

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def group_score(counts: Sequence[Counts], level: float = 0.95) -> GroupScore:
    """Mean score with its standard error over subjects, and tests against chance.

    Parameters
    ----------
    counts : sequence of Counts
        One a subject, of one task.
    level : float, optional
        Of the interval.

    Raises
    ------
    ValueError
        If there is no subject, the tasks differ, or the level is not in [0.5, 1).

    Notes
    -----
    Chance is half of the trials, which for a subject who gives one answer all the time needs both kinds of trial to be equally frequent.
    The sign-flip test needs no distribution: without an ability scores are symmetric about chance. It is exact for any number of trials and any
    criteria. Neither says that every subject is above chance: one may be.

    Examples
    --------
    >>> print(group_score([Counts("same-different", h, 6, 1, 6) for h in (3, 4, 4, 5, 6)]))
    9.4 +- 0.5 of 12, 5 subjects; t test: t(4) = 6.67, p = 0.0013; sign-flip test: p = 0.031
    """
    check_level(level)
    if not counts:
        raise ValueError("counts must hold a subject, got none")
    tasks = sorted({c.task for c in counts})
    if len(tasks) > 1:
        raise ValueError(f"counts must be of one task, got {' and '.join(tasks)}")
    sizes = {c.trials for c in counts}
    trials = sizes.pop() if len(sizes) == 1 else None
    scale = 1.0 if trials is None else float(trials)
    scores = proportions(counts) * scale
    above, mean = _above_chance(counts), float(np.mean(scores))
    sem = float(np.std(scores, ddof=1)) / math.sqrt(len(counts)) if len(counts) > 1 else None
    interval = None
    if sem is not None:
        wide = float(student.ppf(0.5 + 0.5 * level, len(counts) - 1)) * sem
        interval = (max(0.0, mean - wide), min(scale, mean + wide))
    tests = (t_test(above if trials else scores - 0.5), sign_flip_test(above))
    return GroupScore(len(counts), trials, mean, sem, 0.5 * scale, interval, level, tests)


def compare_conditions(
    first: Sequence[Counts], second: Sequence[Counts], *, level: float = 0.95
) -> ScoreDifference:
    """The same subjects in two conditions, in the same order: tests on each one's difference.

    Raises
    ------
    ValueError
        If the numbers of subjects differ, there is none, or the level is not in [0.5, 1).

    Examples
    --------
    >>> probing = [Counts("same-different", h, 6, 2, 6) for h in (3, 4, 4, 5)]
    >>> drilling = [Counts("same-different", h, 6, 1, 6) for h in (5, 5, 6, 6)]
    >>> print(compare_conditions(drilling, probing))
    difference +0.208 (+0.132 to +0.285), 4 subjects in both; paired t test: t(3) = 8.66, p = 0.0032; sign-flip test: p = 0.12
    """
    check_level(level)
    if len(first) != len(second):
        raise ValueError(f"both conditions must have the same subjects, got {len(first)} and {len(second)}")
    values = proportions(first) - proportions(second)
    paired = t_test(values, side="two-sided", name="paired t test")
    tests = (paired, sign_flip_test(values, side="two-sided"))
    return _difference(float(np.mean(values)), paired, level, True, (len(first), len(second)), tests)


def compare_groups(
    first: Sequence[Counts], second: Sequence[Counts], *, level: float = 0.95
) -> ScoreDifference:
    """Two groups of different subjects: Welch's t test and an exact permutation of who is in which.

    Raises
    ------
    ValueError
        If a group is empty, or the level is not in [0.5, 1).
    """
    check_level(level)
    x, y = proportions(first), proportions(second)
    welch = welch_test(x, y)
    tests = (welch, label_test(x, y))
    mean = float(np.mean(x) - np.mean(y))
    return _difference(mean, welch, level, False, (len(x), len(y)), tests)


def proportions(counts: Sequence[Counts]) -> Floats:
    """Of correct answers, a subject."""
    if not counts:
        raise ValueError("counts must hold a subject, got none")
    return np.array([c.score / c.trials for c in counts])


def _above_chance(counts: Sequence[Counts]) -> Floats:
    return np.array([c.score - 0.5 * c.trials for c in counts])


def _difference(
    mean: float,
    test: SubjectTest,
    level: float,
    paired: bool,
    n: tuple[int, int],
    tests: tuple[SubjectTest, ...],
) -> ScoreDifference:
    interval = None
    if test.statistic and test.freedom:
        wide = abs(mean / test.statistic) * float(student.ppf(0.5 + 0.5 * level, test.freedom))
        interval = (mean - wide, mean + wide)
    return ScoreDifference(mean, interval, level, paired, n, tests)
