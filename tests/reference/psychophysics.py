"""The statistics of docs/psychophysics.md from their definitions: integration over the observations.

Nothing here uses the package. Decisions are integrated over the observations, standard normal about the
stimuli's means -d'/2 (A) and +d'/2 (B). "First" and "second" are the places of the alternatives.
"""

import math
from collections.abc import Callable, Sequence

from scipy.integrate import quad

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
