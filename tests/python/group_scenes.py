"""Simulated groups, and how often a true d' is rejected."""

import numpy as np
from scipy.optimize import brentq
from scipy.stats import binom

from burrlab.psychophysics.group import conditional_hits, excess_hits, group_tails
from burrlab.psychophysics.rules import Counts, rule_of

SAME_D_PRIME = {
    "alike": lambda rng, size: np.full(size, 0.3),
    "liberal": lambda rng, size: np.full(size, 0.7),
    "biased": lambda rng, size: np.full(size, 0.02),
    "each his own": lambda rng, size: rng.uniform(0.02, 0.8, size),
}
"""False-alarm rates of subjects."""

SEVERAL_D_PRIMES = {
    "spread": lambda rng, size: np.maximum(0.0, rng.normal(1.5, 0.75, size)),
    "two kinds": lambda rng, size: rng.choice([0.75, 2.25], size),
    "half can tell": lambda rng, size: rng.choice([0.0, 3.0], size),
}
FEW_CAN_TELL = {
    "a tenth": lambda rng, size: np.where(rng.random(size) < 0.1, 4.5, 1.0),
    "a fifth": lambda rng, size: np.where(rng.random(size) < 0.2, 3.0, 0.0),
}


def same(hits: int, false_alarms: int, half: int = 6) -> Counts:
    """Same-different counts."""
    return Counts("same-different", hits, half, false_alarms, half)


def most_errors(rate: float, experiments: int) -> int:
    """The number of errors that a test of this rate exceeds in one study of a million."""
    return int(binom.isf(1e-6, experiments, rate))


def answers_of(task, rule, d_prime, false_alarm, half, rng):
    """(hits, answers) of subjects with these d' and false-alarm rates."""
    decision = rule_of(task, rule)
    hit, alarm = decision.rates(d_prime, decision.criterion_of(d_prime, false_alarm))
    hits = rng.binomial(half, hit)
    return hits, hits + rng.binomial(half, alarm)


def rejections(task, rule, d_prime, false_alarms, *, subjects, trials, experiments, error=0.05, seed=1):
    """How often experiments reject a true d' as too high, and as too low."""
    rng, half = np.random.default_rng(seed), trials // 2
    rates = false_alarms(rng, (experiments, subjects))
    hits, answers = answers_of(task, rule, np.full(rates.shape, d_prime), rates, half, rng)
    few, many = group_tails(hits, answers, [conditional_hits(task, rule, d_prime, half, half)] * subjects)
    return int(np.sum(few <= error)), int(np.sum(many <= error))


def rejections_of_several(task, rule, d_primes, *, subjects, trials, experiments, error=0.05, seed=1):
    """As `rejections`, if d' differs. The group's d' has no mean excess in a very large group."""
    rng, half = np.random.default_rng(seed), trials // 2

    def draw(size):
        return answers_of(task, rule, d_primes(rng, size), rng.uniform(0.1, 0.6, size), half, rng)

    hits, answers = draw((400_000, 1))
    group = brentq(
        lambda d: np.mean(excess_hits(hits, answers, [conditional_hits(task, rule, d, half, half)])[0]),
        0.01,
        15,
    )
    hits, answers = draw((experiments, subjects))
    few, many = group_tails(hits, answers, [conditional_hits(task, rule, group, half, half)] * subjects)
    return int(np.sum(few <= error)), int(np.sum(many <= error))
