"""The independent check of a minimum by nlopt, and what a fit keeps of every search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import nlopt
import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]

_RESULTS = {
    getattr(nlopt, name): name for name in ("SUCCESS", "XTOL_REACHED", "ROUNDOFF_LIMITED", "MAXEVAL_REACHED")
}
_STEP = 0.02  # first step, in logarithms: the search stays at the minimum that it checks
_CLOSE = 1e-7  # the search ends where its steps fall below this, in logarithms
_LONGEST = 1000  # evaluations


@dataclass(frozen=True)
class Start:
    """One search: where it began, where it ended, and how.

    `objective` is the sum of squared residuals at the end; `result` is nlopt's return code by name, SUCCESS
    for the walk. A good code says that the search stopped as planned, not that the fit is good.
    """

    origin: str
    start: tuple[float, float]  # c_e [N/mm^2], alpha [1/ms]
    end: tuple[float, float]
    objective: float
    result: str
    evaluations: int


@dataclass(frozen=True)
class Box:
    """Bounds of the two parameters: (c_e [N/mm^2], alpha [1/ms])."""

    lower: tuple[float, float]
    upper: tuple[float, float]


def minimise(
    objective: Callable[[float, float], float], box: Box, start: tuple[float, float], *, origin: str
) -> Start:
    """nlopt's BOBYQA over (log c_e, log alpha), from a point of the walk.

    Parameters
    ----------
    objective : callable
        Of c_e [N/mm^2] and alpha [1/ms]; what is not finite counts as worse than every finite value so far.
    box : Box
        Bounds.
    start : (float, float)
        c_e [N/mm^2] and alpha [1/ms] to begin at.
    origin : str
        Name of the search in the result.

    Returns
    -------
    Start
        With the best point evaluated, wherever the algorithm ended.

    Raises
    ------
    Exception
        Whatever the objective raises.
    """
    low, high = np.log(box.lower), np.log(box.upper)
    best, worst, evaluations = (np.inf, start), 1.0, 0

    def value(logarithms: Floats, _: Floats) -> float:
        nonlocal best, worst, evaluations
        c_e, alpha = np.exp(np.clip(logarithms, low, high)).tolist()  # BOBYQA can leave the box by rounding
        found, evaluations = float(objective(c_e, alpha)), evaluations + 1
        if not np.isfinite(found):  # nlopt "succeeds" on NaN
            return 10.0 * worst
        worst = max(worst, found)
        best = min(best, (found, (c_e, alpha)))  # nlopt can lose it
        return found

    optimiser = nlopt.opt(nlopt.LN_BOBYQA, 2)
    optimiser.set_lower_bounds(low)
    optimiser.set_upper_bounds(high)
    optimiser.set_initial_step(
        np.minimum(_STEP, 0.25 * (high - low))
    )  # BOBYQA refuses more than half the box
    optimiser.set_xtol_abs(_CLOSE)
    optimiser.set_maxeval(_LONGEST)
    optimiser.set_min_objective(value)
    try:
        optimiser.optimize(np.clip(np.log(start), low, high))
        result = _RESULTS.get(optimiser.last_optimize_result(), "FAILURE")
    except nlopt.RoundoffLimited:
        result = "ROUNDOFF_LIMITED"
    return Start(origin, start, best[1], best[0], result, evaluations)
