"""Observers as an experiment's power takes them: unbiased, with lapses."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import stdtr
from scipy.stats import binom

from burrlab.psychophysics.rules import Floats, Rule
from burrlab.psychophysics.statistics.conditional_hits import Integers

EXPERIMENTS = 4000  # simulated for a power: standard error 0.006 at 0.8
SEED = 6


class Observer:
    """Unbiased, of one d', with lapses: the distribution of scores, and answers drawn."""

    def __init__(self, decision: Rule, d_prime: float, trials: int, lapse: float) -> None:
        hit, false_alarm = (float(r) for r in decision.rates(d_prime))
        self.hit = (1.0 - lapse) * hit + 0.5 * lapse
        self.false_alarm = (1.0 - lapse) * false_alarm + 0.5 * lapse
        self.half = trials // 2
        k = np.arange(self.half + 1)
        of_signals = binom.pmf(k, self.half, self.hit)
        of_noises = binom.pmf(k, self.half, 1.0 - self.false_alarm)
        self.scores: Floats = np.convolve(of_signals, of_noises)

    def from_score(self, score: int | None) -> float:
        """Probability of this score or a higher one."""
        return 0.0 if score is None else float(min(1.0, np.sum(self.scores[score:])))

    def group(self, subjects: int, level: float) -> float:
        """Power of the one-sided t test on the scores of so many subjects; 0 for one."""
        if subjects < 2:
            return 0.0
        rng = np.random.default_rng(SEED)
        table = np.cumsum(self.scores)
        drawn = np.searchsorted(table / table[-1], rng.random((EXPERIMENTS, subjects)), side="right")
        above = drawn - self.half
        mean, error = np.mean(above, axis=1), np.std(above, axis=1, ddof=1) / math.sqrt(subjects)
        with np.errstate(divide="ignore", invalid="ignore"):
            p = stdtr(subjects - 1, -mean / error)
        # Equal scores leave no t; the sign-flip test has its least p.
        flat = np.where(mean > 0.0, 0.5**subjects, 1.0)
        return float(np.mean(np.where(error > 0.0, p, flat) <= level))

    def answers(self, subjects: int) -> tuple[Integers, Integers]:
        """Hits, and all answers, shape (experiments, subjects)."""
        rng = np.random.default_rng(SEED)
        size = (EXPERIMENTS, subjects)
        hits = rng.binomial(self.half, self.hit, size)
        return hits, hits + rng.binomial(self.half, self.false_alarm, size)


def critical_score(trials: int, level: float) -> tuple[int | None, float]:
    """The lowest score that guessing reaches in at most `level` of experiments, and in how many it does."""
    reached = binom.sf(np.arange(-1, trials), trials, 0.5)  # P(score >= k)
    # equal to rounding counts as equal
    enough = np.nonzero(reached <= level * (1.0 + 1e-12))[0]
    return (int(enough[0]), float(reached[enough[0]])) if len(enough) else (None, 0.0)
