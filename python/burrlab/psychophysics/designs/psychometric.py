"""Psychometric function of a two-interval task, through psignifit (extra `psychometric`)."""

from __future__ import annotations

import math
import operator
import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from burrlab.provenance import provenance
from burrlab.psychophysics.designs.comparison import UNITS
from burrlab.psychophysics.designs.design_checks import checked_level, one_of
from burrlab.psychophysics.designs.psychometric_fit import PsychometricFit
from burrlab.psychophysics.rules import Floats

_GUESS, _PROPORTION = 0.5, 0.75
_MANY_LEVELS, _FEW_TRIALS = (
    25,
    5,
)  # psignifit's own marks of an adaptive procedure, whose levels span no range
#: ln(-ln 0.05) - ln(-ln 0.95): psignifit's width of a Weibull function, in the logarithm, times its exponent.
_WIDTH_TIMES_SLOPE = math.log(-math.log(0.05)) - math.log(-math.log(0.95))
_BOUND = re.compile(r"boundWarning.*<(\w+)>.* at the (lower|upper) bound", re.DOTALL)


def psychometric_function(
    levels: Sequence[float],
    correct: Sequence[int],
    trials: Sequence[int],
    *,
    parameter: str | None = None,
    reference: float | None = None,
    level: float = 0.95,
) -> PsychometricFit:
    """Proportion correct of two intervals as a function of the difference between comparison and reference.

        P = 1/2 + (1 - lapse)/2 (1 - 2^-((|ln level|/|ln threshold|)^slope))

    It is 1/2 where there is no difference. Levels below and above 1 are pooled where their |ln level| is the same: the two
    intervals are rendered alike, so that a ratio and its inverse differ in order only. Threshold, slope, lapse rate and
    overdispersion are psignifit's modes of the posterior, with its default priors, on ln |ln level|.

    Parameters
    ----------
    levels : sequence of float
        Ratios to the reference's parameter, above 0, not 1; at least two different |ln level|.
    correct, trials : sequences of int
        Correct answers and trials at each.
    parameter : {"c_e", "alpha"}, optional
        For labels and units.
    reference : float, optional
        The reference's value of it [N/mm^2 or 1/ms].
    level : float
        Probability of the intervals.

    Raises
    ------
    ImportError
        Without psignifit (extra `psychometric`).
    ValueError
        If the sequences differ in length, a level is no ratio or 1, fewer than two differ, a number is out of range, the
        parameter is unknown, or the reference not above 0.
    TypeError
        If a number of answers is not whole.

    Notes
    -----
    Five levels, 0.35 to 2.6 times the threshold of 0.2 of a Gaussian observer with 2 % lapses: of 120 fits each the 95 % intervals
    held it in 117 (20 trials a level; in 52 of them the prior set an end) and 115 (60 trials, 10); |ln threshold| was 2 % too large
    and 1 % too small, with a standard deviation of 25 and 15 % (tests/python/psychophysics_tables.py, psychometric).

    References
    ----------
    H. H. Schütt, S. Harmeling, J. H. Macke, F. A. Wichmann, Painfree and accurate Bayesian estimation of psychometric
    functions for (potentially) overdispersed data, Vision Research 122 (2016) 105-123.
    """
    if not len(levels) == len(correct) == len(trials):
        raise ValueError(
            f"levels, correct and trials must be equally many, got {len(levels)}, {len(correct)} and {len(trials)}"
        )
    ratios = [checked_level("levels", ratio) for ratio in levels]
    pooled = _pooled(ratios, correct, trials)
    if parameter is not None:
        one_of("parameter", parameter, tuple(UNITS))
    if reference is not None and not (math.isfinite(reference) and reference > 0.0):
        raise ValueError(f"reference must be above 0, got {reference}")
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must be between 0 and 1, got {level}")

    data = np.array([(math.log(math.log(ratio)), *n) for ratio, n in pooled.items()])
    found, at_bounds = _fit(data, level)
    threshold, width, lapse = (
        (found.parameter_estimate[name], *found.confidence_intervals[name][str(level)])
        for name in ("threshold", "width", "lambda")
    )
    sides = {ratio > 1.0 for ratio in ratios}
    for end, beyond in (("lower", threshold[1] < data[0, 0]), ("upper", threshold[2] > data[-1, 0])):
        if beyond and ("threshold", end) not in at_bounds:
            at_bounds.append(("threshold", end))
    return PsychometricFit(
        *_ends([math.exp(math.exp(value)) for value in threshold]),
        *_ends([_WIDTH_TIMES_SLOPE / width[i] for i in (0, 2, 1)]),
        *_ends([2.0 * value for value in lapse]),  # psignifit's lambda counts wrong answers only
        overdispersion=float(found.parameter_estimate["eta"]),
        level=level,
        guess_rate=_GUESS,
        proportion=_PROPORTION,
        ratios=tuple(pooled),
        correct=tuple(right for right, _ in pooled.values()),
        trials=tuple(number for _, number in pooled.values()),
        side="both" if len(sides) == 2 else "above" if sides == {True} else "below",
        parameter=parameter,
        reference=None if reference is None else float(reference),
        at_bounds=tuple(at_bounds),
        provenance=provenance(psignifit=_version()),
    )


def _pooled(
    ratios: Sequence[float], correct: Sequence[int], trials: Sequence[int]
) -> dict[float, tuple[int, int]]:
    """Correct answers and trials at each ratio above 1, a ratio and its inverse as one."""
    counts: dict[float, tuple[int, int]] = {}
    for ratio, right, number in zip(ratios, correct, trials, strict=True):
        right, number = operator.index(right), operator.index(number)
        if not 0 <= right <= number or number == 0:
            raise ValueError(f"correct must be from 0 to trials, at least 1, got {right} of {number}")
        above = max(ratio, 1.0 / ratio)
        same = next((known for known in counts if math.isclose(known, above)), above)  # up to rounding
        before = counts.get(same, (0, 0))
        counts[same] = (before[0] + right, before[1] + number)
    if len(counts) < 2:
        raise ValueError(f"levels must hold at least two different differences from 1, got {len(counts)}")
    return dict(sorted(counts.items()))


def _ends(values: Sequence[float]) -> tuple[float, tuple[float, float]]:
    estimate, low, high = (float(value) for value in values)
    return estimate, (low, high)


def _fit(data: Floats, level: float) -> tuple[Any, list[tuple[str, str]]]:
    """psignifit's result for rows of ln difference, correct and trials; ends at which its prior decides."""
    try:
        from psignifit import psignifit
    except ImportError as error:
        raise ImportError(
            "a psychometric function needs psignifit (GPL): pip install 'burrlab[psychometric]'"
        ) from error
    adaptive = len(data) >= _MANY_LEVELS or data[:, 2].max() <= _FEW_TRIALS
    options: dict[str, Any] = {"stimulus_range": (data[0, 0], data[-1, 0])} if adaptive else {}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        # Levels that a staircase chose are many: that is no mistake.
        warnings.filterwarnings("ignore", r"All blocks in data have only 1 trial", UserWarning)
        found = psignifit(
            data, experiment_type="2AFC", sigmoid="weibull", confP=(level, 0.9, 0.68),
            pool_max_blocks=len(data), **options,
        )  # fmt: skip
    at_bounds = []
    for warning in caught:
        if (match := _BOUND.search(str(warning.message))) is not None:
            at_bounds.append((match[1], match[2]))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return found, at_bounds


def _version() -> str:
    from importlib.metadata import version

    return version("psignifit")
