"""What one subject's answers in one task say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.statistics.d_prime import DPrime
from burrlab.psychophysics.statistics.pair_checks import PairCheck


@dataclass(frozen=True)
class SubjectResult:
    """One subject in one task; attributes in the order of the report.

    Attributes
    ----------
    subject : str
    counts : Counts
        Of the main trials.
    planned : int or None
        Main trials of the design; None where it is not known.
    simulated : bool
    score_interval : tuple of float
        Of the proportion correct, exact.
    p_value : float
        Exact binomial test of the score against chance, one-sided.
    holm : float
        The same with Holm's correction for all subjects of the task.
    d_prime : tuple of DPrime
        One a rule.
    checks : tuple of PairCheck
        Of the types of trials against one another, where the types were counted.
    """

    subject: str
    counts: Counts
    planned: int | None
    simulated: bool
    score_interval: tuple[float, float]
    p_value: float
    holm: float
    d_prime: tuple[DPrime, ...]
    checks: tuple[PairCheck, ...]

    @property
    def trials(self) -> int:
        """Answered in the main phase."""
        return self.counts.trials

    @property
    def complete(self) -> bool:
        """Whether all planned trials were answered."""
        return self.planned is None or self.trials >= self.planned

    def of_rule(self, rule: str) -> DPrime:
        """d' under a rule.

        Raises
        ------
        ValueError
            If the analysis does not have it.
        """
        for one in self.d_prime:
            if one.rule == rule:
                return one
        raise ValueError(f"rule must be one of {', '.join(one.rule for one in self.d_prime)}, got {rule!r}")

    def span(self, rule: str) -> tuple[float, float, float]:
        """Lower end, estimate and upper end of d'."""
        found = self.of_rule(rule)
        return found.interval[0], found.estimate, found.interval[1]


def holm(p_values: Sequence[float]) -> list[float]:
    """p values times the number of tests that are left, from the smallest up, never falling (Holm 1979).

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    stepped = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(stepped, 1.0)
    return [float(value) for value in corrected]
