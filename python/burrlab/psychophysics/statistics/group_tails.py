"""Is a group below or above a given d'? Tests that must agree: subjects as units, and chance within subjects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtr

from burrlab.psychophysics.rules import Floats
from burrlab.psychophysics.statistics.conditional_hits import ConditionalHits, Integers

_CHUNK = 2_000_000  # elements of a spectrum at a time
_WIDE = 9.0  # variance of a sum of hits from which the normal approximation is near
_CLOSE = 3.0
_LEAST = 1e-300  # of a spectrum, in place of 0


def group_tails(
    hits: Integers, answers: Integers, subjects: Sequence[ConditionalHits]
) -> tuple[Floats, Floats]:
    """p values of so few hits, and of so many, if the group's d' were that of `subjects`.

    Parameters
    ----------
    hits, answers : ndarray of int, shape (experiments, subjects)
        Hits, and hits and false alarms together. `answers` may have one row for all experiments.
    subjects : sequence of ConditionalHits
        One a subject, all of one d'.

    Returns
    -------
    few, many : ndarray, shape (experiments,)
        One-sided; each the largest p value of three tests. 1 where no subject has given both answers.

    Notes
    -----
    The t test of the hits less the expected ones takes the subject as the unit: it holds when d' differs between subjects. So does the
    second, with t corrected for the subjects' skewness: a few who can tell among many who cannot. Neither sees that equal scores without scatter
    may be chance. The exact test of the sum of hits does; it takes all subjects as alike.

    References
    ----------
    Hall, J. R. Stat. Soc. B 54, 221 (1992): t corrected by a monotone cubic.
    """
    total = np.sum(hits, axis=1)
    few, many = _exact_tails(total, answers, subjects)
    by_units = _t_tails(hits, answers, subjects)
    return np.maximum(few, by_units[0]), np.maximum(many, by_units[1])


def rejected_as_few(
    hits: Integers, answers: Integers, subjects: Sequence[ConditionalHits], error: float
) -> NDArray[np.bool_]:
    """Whether `few` of `group_tails` is at most `error`, without its value: the exact test is made only where it is close.

    Close is where the normal approximation, with its continuity, gives a p value within a factor of 3 of the error rate.
    """
    out = np.asarray(_t_tails(hits, answers, subjects)[0] <= error)
    mean, variance = np.zeros(answers.shape[0]), np.zeros(answers.shape[0])
    for i, subject in enumerate(subjects):
        mean += subject.mean[answers[:, i]]
        variance += subject.variance[answers[:, i]]
    spread = np.sqrt(np.maximum(variance, 1e-12))
    normal = ndtr((np.sum(hits, axis=1) + 0.5 - mean) / spread)
    sure = (variance > _WIDE) & ((normal < error / _CLOSE) | (normal > error * _CLOSE))
    out &= ~sure | (normal <= error)
    close = np.nonzero(out & ~sure)[0]
    if len(close):
        own = answers[close] if len(answers) > 1 else answers
        out[close] = _exact_tails(np.sum(hits[close], axis=1), own, subjects)[0] <= error
    return out


def excess_hits(
    hits: Integers, answers: Integers, subjects: Sequence[ConditionalHits]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Hits less the expected ones, and which subjects' are informative."""
    shape = np.broadcast_shapes(hits.shape, answers.shape)
    excess, informative = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
    for i, subject in enumerate(subjects):
        excess[:, i] = hits[:, i] - subject.mean[answers[:, i]]
        informative[:, i] = subject.informative[answers[:, i]]
    return np.where(informative, excess, 0.0), informative


def _t_tails(hits: Integers, answers: Integers, subjects: Sequence[ConditionalHits]) -> tuple[Floats, Floats]:
    excess, informative = excess_hits(hits, answers, subjects)
    n = np.sum(informative, axis=1)
    mean = np.sum(excess, axis=1) / np.maximum(n, 1)
    square = np.sum(np.where(informative, excess - mean[:, None], 0.0) ** 2, axis=1)
    freedom = np.maximum(n - 1, 1)
    error = np.sqrt(square / freedom / np.maximum(n, 1))
    # equal to rounding: without scatter
    error = np.where(error > 1e-12 * np.maximum(np.abs(mean), 1.0), error, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(mean == 0.0, 0.0, mean / error)
        cube = np.sum(np.where(informative, excess - mean[:, None], 0.0) ** 3, axis=1)
        skewness = np.where(error > 0.0, cube / square**1.5, 0.0)  # over the root of n
        corrected = t + skewness * t**2 / 3.0 + skewness**2 * t**3 / 27.0 + skewness / 6.0
    both = np.where(np.isfinite(t), corrected, t), t
    # One subject has no scatter of subjects: the exact test alone decides.
    few, many = (
        np.where(n < 2, 0.0, np.maximum(*(stdtr(freedom, sign * value) for value in both)))
        for sign in (1.0, -1.0)
    )
    nobody = n == 0
    return np.where(nobody, 1.0, few), np.where(nobody, 1.0, many)


def _exact_tails(
    total: Integers, answers: Integers, subjects: Sequence[ConditionalHits]
) -> tuple[Floats, Floats]:
    length = sum(s.signals for s in subjects) + 1
    alike: dict[int, list[int]] = {}
    for i, subject in enumerate(subjects):
        alike.setdefault(id(subject), []).append(i)
    groups = [_logarithms(subjects[who[0]], answers[:, who], length) for who in alike.values()]
    few, many = np.empty(len(total)), np.empty(len(total))
    step = max(1, _CHUNK // length)
    for start in range(0, len(total), step):
        rows = slice(start, start + step) if len(answers) > 1 else slice(0, 1)
        # Of a sum of hits the spectrum is the product of the subjects'.
        spectrum = np.exp(sum(times[rows] @ logarithm for times, logarithm in groups))
        probability = np.fft.irfft(spectrum, length, axis=1)
        cumulated = np.cumsum(probability, axis=1)
        sums = total[start : start + step]
        row = np.arange(len(sums)) if len(answers) > 1 else np.zeros(len(sums), dtype=np.int64)
        few[start : start + step] = cumulated[row, sums]
        many[start : start + step] = 1.0 - cumulated[row, sums] + probability[row, sums]
    return np.clip(few, 0.0, 1.0), np.clip(many, 0.0, 1.0)


def _logarithms(
    subject: ConditionalHits, answers: Integers, length: int
) -> tuple[Floats, NDArray[np.complex128]]:
    """How often each number of answers occurs among subjects alike, and the logarithm of its spectrum."""
    numbers = np.unique(answers)
    times = np.stack([np.sum(answers == number, axis=1) for number in numbers], axis=1)
    spectrum = np.fft.rfft(subject.probability[numbers], length, axis=1)
    spectrum = np.where(np.abs(spectrum) > _LEAST, spectrum, _LEAST)
    return times.astype(np.float64), np.log(spectrum)
