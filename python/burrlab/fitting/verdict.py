"""What a fit may claim: the ridge of c_e and alpha, the agreement of the starts, and the status."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from burrlab._core import Shape
from burrlab.fitting.problem import MeanFieldModel, Observations, ResidualKind
from burrlab.fitting.search import Box, Start

_RIDGE_PHI = 0.7  # the ridge is tried where the largest phi is 0.7 of the one where it ends
_RIDGE_F = 4.0  # it is excluded where it raises the sum of squares by over 4 residual variances (about 95 %)
_AT_BOUND = 1e-3  # ends closer to a bound than this, relatively, are at it
_ONE_PLACE = 1.05  # equally good ends that differ by more than 5 % disagree; a kink alone makes 1 %
_EQUAL = 1e-3  # ends are equally good where their RMS residuals differ by less than this, relatively


@dataclass(frozen=True)
class Ridge:
    """Where the data cannot tell c_e from alpha, and what they tell instead.

    Along the ridge every window starts above its static contact, and predictions depend on
    alpha/c_e^exponent alone (model, section 5 iii).
    """

    max_phi: float  #: largest F/(c_e R^2) of the fitted rows, at the fitted c_e
    on_ridge: bool  #: the fitted point lies on the ridge: all phi < 0.068 in the default window
    excluded: bool  #: the bounds, or the data, exclude every point on the ridge, see `ridge_of`
    exponent: float  #: 4 (k + 1)/3 for f with a zero of order k: 8/3 for parabolic
    value: float  #: alpha/c_e^exponent on the ridge [1/ms (mm^2/N)^exponent]
    residual: float  #: RMS residual on the ridge, in the unit of the fit's


def ridge_of(
    observations: Observations,
    residuals: ResidualKind,
    model: MeanFieldModel,
    shape: Shape,
    box: Box,
    best: tuple[float, float],
) -> Ridge:
    """Compare the best point with the ridge.

    A fitted point off the ridge may be there by scatter alone. So one point on the ridge, with its best
    alpha, stands for all of it: it is excluded where the sum of squares rises by more than four residual
    variances, S/(n - 2) or 1 with sigma. This is a guard, not an interval.
    """
    exponent = 4 * (shape.order + 1) / 3
    entry = float(observations.ridge_entries().max())
    c_e, alpha = best
    on_ridge = c_e > entry
    at = c_e if on_ridge else entry / _RIDGE_PHI
    max_phi = float(observations.phi(c_e).max())
    if not np.isfinite(at):  # a window from immersion 0 begins at static contact whatever c_e: no ridge
        return Ridge(max_phi, False, True, exponent, alpha / c_e**exponent, np.inf)
    unit = model.unit(at)
    alpha_there = observations.best_alpha(residuals, unit)
    value = alpha_there / at**exponent
    here = np.sum(observations.residuals(residuals, model.predict(c_e, alpha)) ** 2)
    there = np.sum(observations.residuals(residuals, alpha_there * unit) ** 2)
    variance = 1.0 if residuals == "sigma" else here / (len(observations) - 2)
    lowest = max(entry, box.lower[0], (box.lower[1] / value) ** (1 / exponent))
    highest = min(box.upper[0], (box.upper[1] / value) ** (1 / exponent))
    excluded = not on_ridge and bool(lowest >= highest or there - here > _RIDGE_F * variance)
    return Ridge(max_phi, on_ridge, excluded, exponent, value, float(np.sqrt(there / len(observations))))


def verdict(
    observations: Observations, box: Box, ends: Sequence[Start], best: Start, ridge: Ridge, settled: bool
) -> tuple[str, str]:
    """Status and reason of a fit, the gravest first."""
    if not np.isfinite(best.objective):
        return "not-converged", "No parameters tried gave every row a velocity: see the forces and the tick."
    at = bound_reached(observations, box, best.end)
    if not settled and not at:
        return "not-converged", f"The best search stopped short of a minimum (nlopt: {best.result})."
    if ridge.on_ridge or not ridge.excluded:
        combination = f"alpha/c_e^{ridge.exponent:.4g}"
        return "ridge", f"These data determine {combination}, but not c_e and alpha apart. {at}".strip()
    if at:
        return "at-bound", at
    c_e, alpha = agreement(ends, best, len(observations))[1:]
    if max(c_e, alpha) > _ONE_PLACE:
        return "disagreement", (
            f"Searches ended equally well at different places: c_e differs by a factor {c_e:.3g}, "
            f"alpha by {alpha:.3g}."
        )
    agree = ", its best ends agree," if len(ends) > 1 else ""
    return "ok", f"The search converged{agree} and c_e and alpha are determined apart."


def bound_reached(observations: Observations, box: Box, end: tuple[float, float]) -> str:
    """A sentence on the bound that an end lies at; empty where it lies at none."""
    for name, unit, value, low, high in zip(
        ("c_e", "alpha"), ("N/mm^2", "1/ms"), end, box.lower, box.upper, strict=True
    ):
        side = "lower" if value < low * (1 + _AT_BOUND) else "upper" if value > high * (1 - _AT_BOUND) else ""
        if side:
            hard = observations.c_e_bounds()
            row = int(np.argmax(hard))
            why = ""
            if name == "c_e" and side == "lower" and low <= hard[row] * (1 + _AT_BOUND):
                why = f", below which the run at {observations.force[row]:g} N would have had no window"
            return f"{name} ended at its {side} bound of {low if side == 'lower' else high:.4g} {unit}{why}."
    return ""


def agreement(ends: Sequence[Start], best: Start, n: int) -> tuple[list[Start], float, float]:
    """Local ends as good as the best, and largest over smallest of their c_e and of their alpha."""
    limit = np.sqrt(best.objective / n) * (1 + _EQUAL) + 1e-6
    equal = [end for end in ends if end.origin != "global" and np.sqrt(end.objective / n) <= limit]
    if not equal:
        return [], 1.0, 1.0
    c_e, alpha = (max(values) / min(values) for values in zip(*(end.end for end in equal), strict=True))
    return equal, c_e, alpha
