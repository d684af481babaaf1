"""Intervals of d' from an exact test, over everything that could have come out."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaln
from scipy.stats import binomtest

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.rules import Floats, Rule
from burrlab.psychophysics.statistics.likelihood import LARGEST, Outcomes

_CRITERIA = 241  # at which the p value is calculated; 2401 raise it by less than 0.002
_RAREST = 1e-6  # rate at which the range of criteria ends
_TIE = 1e-7  # deviances closer than this are one
_SCANNED = 33  # d' of a first look, between 0 and a deviance that no test keeps
_MOST = 4_000_000  # outcomes; a test takes seconds there, and some fifty are made
_HALVINGS = 16  # of what lies between two of them: 1e-5 of d'


def binomial(trials: int, log_rate: Floats, log_other: Floats) -> Floats:
    """Probabilities of 0 to `trials` answers in rows, one for each rate."""
    k = np.arange(trials + 1.0)
    ways = gammaln(trials + 1.0) - gammaln(k + 1.0) - gammaln(trials - k + 1.0)
    # at most one of a rate's logarithms is -inf, and times 0 it is 0
    log_rate, log_other = (np.maximum(x, -1e300)[..., None] for x in (log_rate, log_other))
    return np.asarray(np.exp(ways + k * log_rate + (trials - k) * log_other))


def exact_p_values(rule: Rule, signals: int, noises: int, d_prime: float) -> Floats:
    """Of d', for every outcome, in the order of `Outcomes.all`.

    p(x) = max over the criterion of P(deviance(X) >= deviance(x) | d', criterion), X all outcomes.

    The likelihood-ratio test with its own distribution in place of chi-square's, at the worst criterion: an interval of
    the d' with p > 1 - level holds the truth at least as often as it says, whatever the criterion.
    """
    deviance = Outcomes.all(signals, noises).deviance(rule, d_prime)
    of_hits, of_alarms = _probabilities(rule, signals, noises, d_prime)
    # from the least likely outcome to the likeliest
    order = np.argsort(-deviance)
    p = (of_hits[:, :, None] * of_alarms[:, None, :]).reshape(len(of_hits), -1)[:, order]
    beyond = np.cumsum(p, axis=1).max(axis=0)
    last = np.searchsorted(-deviance[order], _TIE - deviance, side="right") - 1
    return np.asarray(np.minimum(beyond[last], 1.0))


def exact_p_value(counts: Counts, rule: Rule, d_prime: float) -> float:
    """Of d', for the outcome that was observed: one of `exact_p_values`."""
    shape = counts.signals + 1, counts.noises + 1
    deviance = Outcomes.all(counts.signals, counts.noises).deviance(rule, d_prime).reshape(shape)
    beyond = deviance >= deviance[counts.hits, counts.false_alarms] - _TIE
    of_hits, of_alarms = _probabilities(rule, counts.signals, counts.noises, d_prime)
    return min(float(np.max(np.sum((of_hits @ beyond) * of_alarms, axis=1))), 1.0)


def exact_interval(counts: Counts, rule: Rule, level: float) -> tuple[float, float]:
    """From the smallest to the largest d' in [0, inf) that the exact test keeps; inf where it has no upper end."""
    outcomes = (counts.signals + 1) * (counts.noises + 1)
    if outcomes > _MOST:
        raise ValueError(
            f"counts must have at most {_MOST} possible outcomes for method 'exact', got {outcomes}: take 'profile'"
        )
    observed, error = Outcomes.of(counts), 1.0 - level
    if bool(observed.undetermined):
        return 0.0, math.inf
    is_open = exact_p_value(counts, rule, LARGEST) > error
    # A deviance this large has a p value below any error rate: the chance of each of the outcomes is below exp(-deviance/2).
    far = 2.0 * math.log((counts.signals + 1) * (counts.noises + 1) / error)
    grid = np.linspace(0.0, LARGEST, 401)
    near = grid[np.asarray(observed.deviance(rule, grid)) <= far]
    first, last = max(float(near[0]) - 0.1, 0.0), float(near[-1]) + 0.1
    if is_open:
        last = min(last, float(observed.profile_interval(rule, level)[0]) + 1.0)
    scanned = np.linspace(first, last, _SCANNED)
    estimate = float(observed.estimate(rule)[0])
    scanned = np.unique(np.append(scanned, min(estimate, last)))
    kept = np.flatnonzero([exact_p_value(counts, rule, d) > error for d in scanned])
    low = (
        0.0 if scanned[kept[0]] == 0.0 else _end(counts, rule, error, scanned[kept[0] - 1], scanned[kept[0]])
    )
    if is_open:
        return low, math.inf
    return low, _end(counts, rule, error, scanned[kept[-1] + 1], scanned[kept[-1]])


def proportion_interval(counts: Counts, rule: Rule, level: float) -> tuple[float, float]:
    """Clopper and Pearson's interval of the proportion correct, carried to d' of an observer without bias."""
    test = binomtest(counts.score, counts.trials).proportion_ci(level, method="exact")
    low, high = rule.invert([test.low, test.high], [1.0 - test.low, 1.0 - test.high])[0]
    return float(low), float(high)


def _probabilities(rule: Rule, signals: int, noises: int, d_prime: float) -> tuple[Floats, Floats]:
    """Of the numbers of hits and of false alarms, in rows, one for each criterion."""
    criteria = np.linspace(*rule.criterion_range(d_prime, _RAREST, 1.0 - _RAREST), _CRITERIA)
    hit, miss, alarm, rejection = rule.log_rates(d_prime, criteria)
    return binomial(signals, hit, miss), binomial(noises, alarm, rejection)


def _end(counts: Counts, rule: Rule, error: float, outside: float, inside: float) -> float:
    for _ in range(_HALVINGS):
        middle = 0.5 * (outside + inside)
        if exact_p_value(counts, rule, middle) > error:
            inside = middle
        else:
            outside = middle
    return float(outside)
