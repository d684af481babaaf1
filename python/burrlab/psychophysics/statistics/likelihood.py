"""The likelihood of d' with the criterion left free, for one subject or for all that could have come out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri, xlogy

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.rules import Floats, Rule

CorrectionName: TypeAlias = Literal["none", "log-linear", "half"]

LARGEST = 40.0  # d' at which both answers of every rule are certain to a double
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_SECTIONS = 32  # leave 2e-7 of the range of criteria, 1e-11 of the likelihood at its flat top
_HALVINGS = 40  # of LARGEST: 4e-11


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Numbers of answers, as arrays of one shape.

    Attributes
    ----------
    hits, signals, false_alarms, noises : ndarray of float
        As in `Counts`.
    """

    hits: Floats
    signals: Floats
    false_alarms: Floats
    noises: Floats

    @classmethod
    def of(cls, counts: Counts) -> Outcomes:
        """The one outcome that was observed; arrays of no dimension."""
        values = (counts.hits, counts.signals, counts.false_alarms, counts.noises)
        return cls(*(np.asarray(value, dtype=np.float64) for value in values))

    @classmethod
    def all(cls, signals: int, noises: int) -> Outcomes:
        """Everything that can come out, in (signals + 1)(noises + 1) elements; false alarms vary fastest."""
        hits, alarms = np.meshgrid(np.arange(signals + 1.0), np.arange(noises + 1.0), indexing="ij")
        full = np.ones(hits.size)
        return cls(hits.ravel(), signals * full, alarms.ravel(), noises * full)

    @property
    def rates(self) -> tuple[Floats, Floats]:
        """Hit rate and false-alarm rate; of trials that were not, a half."""
        with np.errstate(invalid="ignore"):
            return (
                np.where(self.signals > 0, self.hits / self.signals, 0.5),
                np.where(self.noises > 0, self.false_alarms / self.noises, 0.5),
            )

    @property
    def undetermined(self) -> NDArray[np.bool_]:
        """Where any d' is as likely as any other: one answer always, or no trial of one kind."""
        given, trials = self.hits + self.false_alarms, self.signals + self.noises
        return np.asarray((given == 0) | (given == trials) | (self.signals == 0) | (self.noises == 0))

    def estimate(self, rule: Rule) -> tuple[Floats, Floats]:
        """Of greatest likelihood: d' in [0, inf], and the criterion.

        Where H <= F, d' is 0 and the criterion that of the pooled rate. Where undetermined, d' is 0 too, the smallest
        of all that are likeliest.
        """
        h, f = self.rates
        pooled = (self.hits + self.false_alarms) / (self.signals + self.noises)
        d, criterion = rule.invert(h, f)
        zero = (h <= f) | self.undetermined
        return np.where(zero, 0.0, d), np.where(zero, rule.criterion_of(0.0, pooled), criterion)

    def log_likelihood(self, hit: Floats, miss: Floats, alarm: Floats, rejection: Floats) -> Floats:
        """Of the logarithms of the four rates; the number of orders of the trials left out."""
        total = np.zeros(np.broadcast_shapes(self.hits.shape, hit.shape))
        for times, log_rate in (
            (self.hits, hit),
            (self.signals - self.hits, miss),
            (self.false_alarms, alarm),
            (self.noises - self.false_alarms, rejection),
        ):
            total = total + np.where(times > 0, times * np.where(times > 0, log_rate, 0.0), 0.0)
        return np.asarray(total)

    def greatest(self) -> Floats:
        """The log-likelihood at the estimate."""
        h, f = self.rates
        given, trials = self.hits + self.false_alarms, self.signals + self.noises
        apart = xlogy(self.hits, h) + xlogy(self.signals - self.hits, 1.0 - h)
        apart = apart + xlogy(self.false_alarms, f) + xlogy(self.noises - self.false_alarms, 1.0 - f)
        pooled = xlogy(given, given / trials) + xlogy(trials - given, 1.0 - given / trials)
        return np.asarray(np.where((h > f) | self.undetermined, apart, pooled))

    def deviance(self, rule: Rule, d_prime: ArrayLike) -> Floats:
        """-2 log of the likelihood at d', with the best criterion there, over the greatest: 0 at the estimate.

        The likelihood is concave in the criterion, which a golden section finds.
        """
        d = np.asarray(d_prime, dtype=np.float64)
        low, high = np.broadcast_arrays(*rule.criterion_range(d, *self.rates))
        one, two = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        at_one = self.log_likelihood(*rule.log_rates(d, one))
        at_two = self.log_likelihood(*rule.log_rates(d, two))
        best = np.maximum(at_one, at_two)
        for _ in range(_SECTIONS):
            left = at_one > at_two
            low, high = np.where(left, low, one), np.where(left, two, high)
            new = np.where(left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
            at_new = self.log_likelihood(*rule.log_rates(d, new))
            one, two = np.where(left, new, two), np.where(left, one, new)
            at_one, at_two = np.where(left, at_new, at_two), np.where(left, at_one, at_new)
            best = np.maximum(best, at_new)
        return np.asarray(np.where(self.undetermined, 0.0, np.maximum(2.0 * (self.greatest() - best), 0.0)))

    def standard_error(self, rule: Rule) -> Floats:
        """Of d', from the information at the estimate; nan where the estimate is 0, inf or at a rate of 0 or 1."""
        h, f = self.rates
        d, criterion = self.estimate(rule)
        inner = (h > f) & (h < 1.0) & (f > 0.0) & ~self.undetermined
        hit_d, hit_c, alarm_d, alarm_c = rule.slopes(np.where(inner, d, 1.0), np.where(inner, criterion, 1.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            variance = (
                alarm_c**2 * h * (1.0 - h) / self.signals + hit_c**2 * f * (1.0 - f) / self.noises
            ) / (hit_d * alarm_c - hit_c * alarm_d) ** 2
        return np.where(inner, np.sqrt(variance), np.nan)

    def corrected(self, correction: CorrectionName) -> tuple[Floats, Floats]:
        """Hit rate and false-alarm rate after a correction of perfect scores and empty cells."""
        if correction == "log-linear":
            return (self.hits + 0.5) / (self.signals + 1.0), (self.false_alarms + 0.5) / (self.noises + 1.0)
        if correction == "half":
            half = [np.where(n > 0, 0.5 / np.maximum(n, 1.0), 0.5) for n in (self.signals, self.noises)]
            h, f = (np.clip(rate, x, 1.0 - x) for rate, x in zip(self.rates, half, strict=True))
            return h, f
        return self.rates

    def profile_interval(self, rule: Rule, level: float) -> tuple[Floats, Floats]:
        """The d' in [0, inf) whose deviance is at most the chi-square quantile of one degree of freedom.

        Where 0 is in it, so at the lower end; where it has no upper end, inf.
        """
        limit = float(chdtri(1.0, 1.0 - level))
        middle = np.minimum(self.estimate(rule)[0], LARGEST)
        none, most = np.zeros_like(middle), np.full_like(middle, LARGEST)

        def beyond(d: Floats) -> NDArray[np.bool_]:
            return np.asarray(self.deviance(rule, d) > limit)

        low = np.where(beyond(none), halving(beyond, none, middle), 0.0)
        high = np.where(beyond(most), halving(beyond, most, middle), np.inf)
        return low, high


def halving(beyond: Callable[[Floats], NDArray[np.bool_]], outside: Floats, inside: Floats) -> Floats:
    """Where a limit lies between two arrays of d', one on either side of it."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (outside + inside)
        is_outside = beyond(middle)
        outside, inside = np.where(is_outside, middle, outside), np.where(is_outside, inside, middle)
    return np.asarray(0.5 * (outside + inside))
