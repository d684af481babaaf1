"""What the types of trials say beside d': do the materials differ in noise, does the order matter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import hypergeom

from burrlab.common.check import refuse
from burrlab.psychophysics.rules import Counts

_SAME_DIFFERENT = (
    ("AA", "BB", "answered different", "one material is felt with more noise than the other"),
    (
        "AB",
        "BA",
        "answered different",
        "the order of the two materials matters: memory, or a time-order error",
    ),
)
_TIES = 1e-7  # relative, of probabilities that are equal but for rounding


@dataclass(frozen=True)
class PairCheck:
    """Two types of trials compared by Fisher's exact test, subject by subject.

    Attributes
    ----------
    types : (str, str)
    counted : str
        What is counted of them.
    counts : ((int, int), (int, int))
        How often, and in how many trials, of either type; summed over subjects.
    p_value : float
        Two-sided, given each subject's total.
    smallest : float
        The smallest p value that these totals allow.
    meaning : str
        Of a difference.
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
            return text + "alike in every subject as far as can be"
        if self.smallest > 0.05:
            return text + f"so few trials cannot show a difference (p is at least {self.smallest:.2g})"
        return text + (self.meaning if self.p_value <= 0.05 else "no difference shown")


def pair_checks(counts: Counts | Sequence[Counts]) -> list[PairCheck]:
    """The checks that a task's types of trials allow.

    Same-different: AA against BB and AB against BA. ABX and two intervals: correct answers where the first and where the
    second is correct, which differ by a bias to a position.

    Parameters
    ----------
    counts : Counts or sequence of Counts
        Of one subject or several, in one task. Subjects may differ: each one's total is taken as given. A type of pair that
        is not in `by_type` had no trial (a run that was not finished).

    Raises
    ------
    ValueError
        If there are no counts, they are of several tasks, or those of same-different lack `by_type`.

    Examples
    --------
    >>> types = {"AA": (0, 12), "BB": (7, 12), "AB": (9, 12), "BA": (8, 12)}
    >>> for check in pair_checks(Counts("same-different", 17, 24, 7, 24, by_type=types)):
    ...     print(check)
    AA against BB: answered different 0 of 12 and 7 of 12, p = 0.00458; one material is felt with more noise than the other
    AB against BA: answered different 9 of 12 and 8 of 12, p = 1; no difference shown
    """
    subjects = [counts] if isinstance(counts, Counts) else list(counts)
    refuse(not subjects, "counts must be of a subject at least, got none")
    tasks = {subject.task for subject in subjects}
    refuse(len(tasks) > 1, f"counts must be of one task, got {', '.join(sorted(tasks))}")
    if subjects[0].task != "same-different":
        rows = [((s.hits, s.signals), (s.noises - s.false_alarms, s.noises)) for s in subjects]
        return [_check(("first", "second"), "correct", rows, "answers lean to one position")]
    refuse(
        not all(subject.by_type for subject in subjects),
        "counts must have the types of pairs, by_type, got none",
    )
    none = (0, 0)
    return [
        _check(
            (one, two),
            counted,
            [(s.by_type.get(one, none), s.by_type.get(two, none)) for s in subjects],
            meaning,
        )
        for one, two, counted, meaning in _SAME_DIFFERENT
    ]


def _check(
    types: tuple[str, str],
    counted: str,
    rows: list[tuple[tuple[int, int], tuple[int, int]]],
    meaning: str,
) -> PairCheck:
    # The number of the first type, given each subject's total, is a sum of hypergeometric ones.
    probabilities, least = np.ones(1), 0
    for (n, trials), (m, others) in rows:
        if trials + others == 0:
            continue
        low, high = max(0, n + m - others), min(trials, n + m)
        own = hypergeom.pmf(np.arange(low, high + 1), trials + others, n + m, trials)
        probabilities, least = np.convolve(probabilities, own), least + low
    table = np.array(rows).sum(axis=0)
    observed = probabilities[table[0, 0] - least]
    p = probabilities[probabilities <= observed * (1.0 + _TIES)].sum()
    smallest = probabilities[probabilities <= probabilities.min() * (1.0 + _TIES)].sum()
    (n, trials), (m, others) = table.tolist()
    return PairCheck(
        types, counted, ((n, trials), (m, others)), min(float(p), 1.0), min(float(smallest), 1.0), meaning
    )
