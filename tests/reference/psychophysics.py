"""The statistics of docs/psychophysics.md from their definitions: integration and lists of all outcomes.

Nothing here uses the package. Decisions are integrated over the observations, standard normal about the
stimuli's means -d'/2 (A) and +d'/2 (B). "First" and "second" are the places of the alternatives.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np
from scipy import stats
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

Rates = tuple[float, float]

FAR = 9.0  # end of all integrals [standard deviations of an observation]


def Phi(x: float) -> float:
    return 0.5 * math.erfc(-x / math.sqrt(2))


def phi(x: float) -> float:
    return math.exp(-0.5 * x * x) / math.sqrt(2 * math.pi)


def integral(
    function: Callable[[float], float], low: float, high: float, corner: float | None = None
) -> float:
    points = None if corner is None or not low < corner < high else [corner]
    return float(quad(function, low, high, points=points, epsabs=1e-12, epsrel=1e-12, limit=400)[0])


# Observers: (rate of "different" or "first" where this is correct, the same rate where it is wrong).


def same_different_differencing(d: float, k: float) -> Rates:
    """Says "different" where the two observations are more than k apart."""

    def different(one: float, two: float) -> float:
        return integral(lambda x: phi(x - one) * (Phi(x - k - two) + Phi(-x - k + two)), one - FAR, one + FAR)

    return different(-d / 2, d / 2), different(d / 2, d / 2)


def same_different_independent(d: float, middle: float = 0.0) -> Rates:
    """Says "different" where the observations lie on two sides of the middle; the best without bias at 0."""
    a, b = Phi(middle + d / 2), Phi(middle - d / 2)  # probabilities that A and B are taken for A
    different = a * (1 - b) + b * (1 - a)
    return different, 0.5 * (2 * a * (1 - a) + 2 * b * (1 - b))


def same_different_likelihood(d: float, bias: float) -> Rates:
    """Says "different" where its likelihood over that of "same" is above exp(bias): the best at any bias.

    For observations x and y the ratio is cosh(d'(x - y)/2)/cosh(d'(x + y)/2).
    """
    if d == 0.0:
        return (1.0, 1.0) if bias < 0.0 else (0.0, 0.0)

    def different(one: float, two: float) -> float:
        # sum and difference of the observations are independent, each with a variance of 2
        def given_sum(s: float) -> float:
            wanted = math.exp(bias) * math.cosh(d * s / 2)
            reach = 2 / d * math.acosh(wanted) if wanted > 1.0 else 0.0
            apart = (one - two) / math.sqrt(2)
            return Phi(-reach / math.sqrt(2) + apart) + Phi(-reach / math.sqrt(2) - apart)

        mean = (one + two) / math.sqrt(2)
        return integral(lambda u: phi(u - mean) * given_sum(math.sqrt(2) * u), mean - FAR, mean + FAR)

    return different(-d / 2, d / 2), different(d / 2, d / 2)


def abx_differencing(d: float, bias: float = 0.0) -> Rates:
    """Says "first" where it is closer to the reference than the second, or farther by at most `bias`."""

    def first(reference: float, one: float, two: float) -> float:
        def given(r: float) -> float:
            def closer(u: float) -> float:
                density = phi(r + u - one) + phi(r - u - one)
                beyond = max(u - bias, 0.0)
                return density * (Phi(r - beyond - two) + Phi(two - r - beyond))

            return integral(closer, 0.0, FAR + abs(r - one), bias)

        return integral(lambda r: phi(r - reference) * given(r), reference - FAR, reference + FAR)

    return first(d / 2, d / 2, -d / 2), first(d / 2, -d / 2, d / 2)


def abx_independent(d: float) -> Rates:
    """Takes the reference as A or B by the middle, then the alternative that is more of it; best unbiased."""
    category, larger = Phi(d / 2), Phi(d / math.sqrt(2))
    right = category * larger + (1 - category) * (1 - larger)
    return right, 1 - right


def two_intervals(d: float, bias: float = 0.0) -> Rates:
    """Says "first" where its observation is the larger, or smaller by at most `bias`."""
    return (
        integral(lambda x: phi(x - d) * Phi(x + bias), d - FAR, d + FAR),
        integral(lambda x: phi(x) * Phi(x + bias - d), -FAR, FAR),
    )


# One subject's d'. `rates(d, criterion)` is an observer; `criteria` is a grid of its criterion.


def log_likelihood(rates: Rates, hits: int, signals: int, alarms: int, noises: int) -> float:
    return float(stats.binom.logpmf(hits, signals, rates[0]) + stats.binom.logpmf(alarms, noises, rates[1]))


def best_at(
    rates: Callable[[float, float], Rates], d: float, counts: Sequence[int], criteria: Sequence[float]
) -> float:
    """Log-likelihood at the best criterion: on the grid, then between its neighbours."""
    values = [log_likelihood(rates(d, c), *counts) for c in criteria]
    best = int(np.argmax(values))
    ends = criteria[max(best - 1, 0)], criteria[min(best + 1, len(criteria) - 1)]
    found = minimize_scalar(
        lambda c: -log_likelihood(rates(d, c), *counts),
        bounds=ends,
        method="bounded",
        options={"xatol": 1e-9},
    )
    return max(values[best], -float(found.fun))


def greatest(counts: Sequence[int]) -> float:
    """Log-likelihood at the estimate: two rates, or one where hits are no more frequent than false alarms."""
    hits, signals, alarms, noises = counts
    common = (hits + alarms) / (signals + noises)
    above = hits * noises > alarms * signals
    return log_likelihood((hits / signals, alarms / noises) if above else (common, common), *counts)


def outcomes(signals: int, noises: int) -> Iterator[tuple[int, int, int, int]]:
    for hits, alarms in product(range(signals + 1), range(noises + 1)):
        yield hits, signals, alarms, noises


def exact_p_values(
    rates: Callable[[float, float], Rates], d: float, signals: int, noises: int, criteria: Sequence[float]
) -> dict[tuple[int, int], float]:
    """(hits, false alarms) -> probability of a deviance at least as large, at the grid's worst criterion."""
    deviance = {
        (one[0], one[2]): 0.0
        if one[0] + one[2] in (0, signals + noises)
        else 2 * (greatest(one) - best_at(rates, d, one, criteria))
        for one in outcomes(signals, noises)
    }
    p = dict.fromkeys(deviance, 0.0)
    for c in criteria:
        hit, alarm = rates(d, c)
        chance = {
            x: stats.binom.pmf(x[0], signals, hit) * stats.binom.pmf(x[1], noises, alarm) for x in deviance
        }
        for x in p:
            p[x] = max(p[x], sum(chance[y] for y in deviance if deviance[y] >= deviance[x] - 1e-7))
    return p


# Groups.


def holm_rejected(p_values: Sequence[float], level: float) -> list[bool]:
    """Steps down: the smallest p against level/m, the next against level/(m - 1), until one is kept."""
    order = sorted(range(len(p_values)), key=lambda i: p_values[i])
    out = [False] * len(p_values)
    for place, i in enumerate(order):
        if p_values[i] * (len(p_values) - place) > level:
            break
        out[i] = True
    return out
