"""Is a group below or above a given d'? Two tests that must agree: subjects as units, and chance within subjects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from burrlab.psychophysics.conditional_hits import ConditionalHits
from burrlab.psychophysics.rules import Floats

Integers = NDArray[np.int64]

_CHUNK = 4_000_000  # elements of a spectrum at a time


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
        One-sided; each the larger of the p values of two tests. 1 where no subject has given both answers.

    Notes
    -----
    The t test of the hits less the expected ones takes the subject as the unit: it holds when d' differs between subjects. It
    does not see that equal scores without scatter may be chance. The exact test of the sum of hits does; it takes all subjects as alike.
    """
    total = np.sum(hits, axis=1)
    few, many = _exact_tails(total, answers, subjects)
    by_units = _t_tails(hits, answers, subjects)
    return np.maximum(few, by_units[0]), np.maximum(many, by_units[1])


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
    # One subject has no scatter of subjects: the exact test alone decides.
    few, many = (np.where(n < 2, 0.0, stdtr(freedom, side)) for side in (t, -t))
    nobody = n == 0
    return np.where(nobody, 1.0, few), np.where(nobody, 1.0, many)


def _exact_tails(
    total: Integers, answers: Integers, subjects: Sequence[ConditionalHits]
) -> tuple[Floats, Floats]:
    length = sum(s.signals for s in subjects) + 1
    numbers, row_of = np.unique(answers, return_inverse=True)
    place = row_of.reshape(answers.shape)
    # A number beyond a subject's own trials is another subject's: any row serves.
    spectra = {
        id(s): np.fft.rfft(s.probability[np.minimum(numbers, s.signals + s.noises)], length, axis=1)
        for s in subjects
    }
    few, many = np.empty(len(total)), np.empty(len(total))
    step = max(1, _CHUNK // length)
    for start in range(0, len(total), step):
        rows = slice(start, start + step)
        own = place[rows] if len(place) > 1 else place
        product = np.ones((len(own), length // 2 + 1), dtype=np.complex128)
        for i, subject in enumerate(subjects):
            product *= spectra[id(subject)][own[:, i]]
        probability = np.fft.irfft(product, length, axis=1)
        cumulated = np.cumsum(probability, axis=1)
        sums = total[rows]
        row = np.arange(len(sums)) if len(own) > 1 else np.zeros(len(sums), dtype=np.int64)
        few[rows] = cumulated[row, sums]
        many[rows] = 1.0 - few[rows] + probability[row, sums]
    return np.clip(few, 0.0, 1.0), np.clip(many, 0.0, 1.0)
