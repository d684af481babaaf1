"""How well a design finds the threshold of a stated observer, by simulation."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.special import ndtr, ndtri

from burrlab.psychophysics.designs.posterior import ThresholdPosterior
from burrlab.psychophysics.rules import rule_of

if TYPE_CHECKING:
    from burrlab.psychophysics.designs.adaptive import AdaptiveStaircase
    from burrlab.psychophysics.designs.constant_stimuli import ConstantStimuli
    from burrlab.psychophysics.designs.staircase import Staircase

#: Answers of an observer: whether right, at a difference |ln level|.
Answers: TypeAlias = Callable[[float], bool]

LAPSE = 0.02
_RUNS = 200
_D_PRIME = float(rule_of("2ifc", "independent-observations").invert(0.75, 0.25)[0])  # 0.954 at threshold


def gaussian_correct(difference: float, threshold: float, lapse: float = LAPSE) -> float:
    """Proportion correct of Gaussian noise on the logarithm, Phi(d'/sqrt 2) with d' = 0.954 at threshold; lapses guess.

    Examples
    --------
    >>> round(gaussian_correct(0.1, 0.1, lapse=0.0), 12)
    0.75
    """
    seen = ndtr(_D_PRIME * difference / threshold / math.sqrt(2.0))
    return float((1.0 - lapse) * seen + 0.5 * lapse)


def gaussian_difference(proportion: float, threshold: float, lapse: float = LAPSE) -> float:
    """Where `gaussian_correct` has a proportion."""
    d_prime = math.sqrt(2.0) * float(ndtri((proportion - 0.5 * lapse) / (1.0 - lapse)))
    return threshold * d_prime / _D_PRIME


def constant_stimuli_precision(design: ConstantStimuli, subjects: int) -> str:
    differences = [abs(math.log(level)) for level in design.levels]
    threshold = math.sqrt(min(differences) * max(differences))

    def estimate(answers: Answers) -> tuple[float | None, int]:
        posterior = ThresholdPosterior(0.5 * min(differences), 2.0 * max(differences))
        for difference in differences:
            right = sum(answers(difference) for _ in range(design.repeats))
            posterior.update_counts(difference, right, design.repeats)
        return posterior.summary()["threshold"], design.trials

    return _text(estimate, threshold, "the middle of the levels", subjects)


def staircase_precision(design: Staircase, subjects: int) -> str:
    start = abs(math.log(design.start))

    def estimate(answers: Answers) -> tuple[float | None, int]:
        track = design.track()
        while (level := track.level()) is not None:
            track.update(answers(abs(math.log(level))))
        found = track.threshold()
        return found.difference, found.trials

    return _text(estimate, start / 4.0, "a quarter of the start's distance from 1", subjects, design.target)


def adaptive_precision(design: AdaptiveStaircase, subjects: int) -> str:
    near, far = (abs(math.log(level)) for level in design.levels)

    def estimate(answers: Answers) -> tuple[float | None, int]:
        track = design.track()
        while (level := track.level()) is not None:
            track.update(answers(abs(math.log(level))))
        return track.posterior.summary()["threshold"], design.trials

    return _text(estimate, math.sqrt(near * far), "the middle of the levels", subjects)


def _text(
    estimate: Callable[[Answers], tuple[float | None, int]],
    threshold: float,
    where: str,
    subjects: int,
    target: float | None = None,
) -> str:
    draws = np.random.default_rng(0)
    runs = [
        estimate(lambda difference: draws.random() < gaussian_correct(difference, threshold))
        for _ in range(_RUNS)
    ]
    sought = threshold if target is None else gaussian_difference(target, threshold)
    logs = [math.log(found / sought) for found, _ in runs if found is not None]
    trials = np.mean([number for _, number in runs])
    lines = [
        f"{_RUNS} simulated runs ({trials:.0f} trials on average) of an observer with Gaussian noise, {100 * LAPSE:g} % lapses "
        f"and 75 % correct at a ratio of {math.exp(threshold):.3g} ({where}):"
    ]
    if len(logs) < _RUNS:
        lines.append(f"{_RUNS - len(logs)} of them end without a threshold")
    if len(logs) > 1:
        spread, bias = float(np.std(logs, ddof=1)), float(np.mean(logs))
        lines.append(
            f"the threshold's distance from 1 [ln] is found to a factor of {math.exp(spread):.2f} (standard deviation), "
            f"{100 * abs(math.expm1(bias)):.0f} % too {'large' if bias > 0 else 'small'} in the mean"
        )
        if subjects > 1:
            lines.append(
                f"that of {subjects} such subjects together to {math.exp(spread / math.sqrt(subjects)):.2f}, and worse where they differ"
            )
    return "\n".join(lines)
