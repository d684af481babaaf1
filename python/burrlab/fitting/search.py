"""The search for the best point by nlopt: a global stage, then local ones from several starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import nlopt
import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Objective: TypeAlias = Callable[[Floats], float]

CONVERGED = ("SUCCESS", "STOPVAL_REACHED", "FTOL_REACHED", "XTOL_REACHED", "ROUNDOFF_LIMITED")
_RESULTS = {getattr(nlopt, name): name for name in (*CONVERGED, "MAXEVAL_REACHED", "MAXTIME_REACHED")}


@dataclass(frozen=True)
class Start:
    """One search: where it began, where it ended, and how.

    `objective` is the sum of squared residuals at the end; `result` is nlopt's return code by name. A good
    code says that the search stopped as planned, not that the fit is good.
    """

    origin: str
    start: tuple[float, float]  # c_e [N/mm^2], alpha [1/ms]
    end: tuple[float, float]
    objective: float
    result: str
    evaluations: int

    @property
    def converged(self) -> bool:
        return self.result in CONVERGED


@dataclass(frozen=True)
class Box:
    """Bounds of the two parameters: (c_e [N/mm^2], alpha [1/ms])."""

    lower: tuple[float, float]
    upper: tuple[float, float]

    def clip(self, point: Floats) -> Floats:
        """A point in logarithms, moved into the box: BOBYQA can leave it by rounding."""
        return np.clip(point, np.log(self.lower), np.log(self.upper))


class _Recorder:
    """The objective as nlopt sees it: finite, counted, with its best point kept and its exceptions held.

    nlopt can lose the best point, "succeeds" on NaN, and turns a Python exception into SystemError in some
    algorithms. So an exception stops the search by force_stop, and the caller raises it again.
    """

    def __init__(self, objective: Objective, box: Box, optimiser: nlopt.opt) -> None:
        self.objective, self.box, self.optimiser = objective, box, optimiser
        self.best: tuple[float, Floats] | None = None
        self.worst = 1.0
        self.evaluations = 0
        self.failure: BaseException | None = None

    def __call__(self, point: Floats, gradient: Floats) -> float:
        if self.failure is not None:  # an algorithm may finish its round before it stops
            return self.worst
        inside = self.box.clip(point)
        try:
            value = float(self.objective(inside))
        except BaseException as error:  # Ctrl-C too
            self.failure = error
            self.optimiser.force_stop()
            return self.worst
        self.evaluations += 1
        if not np.isfinite(value):
            return 10.0 * self.worst
        self.worst = max(self.worst, value)
        if self.best is None or value < self.best[0]:
            self.best = (value, inside)
        return value


def minimise(
    objective: Objective,
    box: Box,
    start: Floats,
    *,
    origin: str,
    algorithm: int = nlopt.LN_BOBYQA,
    step: float = 0.3,
    xtol: float = 1e-7,
    maxeval: int = 1000,
) -> Start:
    """One run of nlopt over (log c_e, log alpha).

    Parameters
    ----------
    objective : callable
        Takes the logarithms of c_e [N/mm^2] and alpha [1/ms]; a value that is not finite counts as worse than
        every finite one so far.
    box : Box
        Bounds.
    start : array, shape (2,)
        Where to begin, in logarithms.
    origin : str
        Name of the start in the result.
    algorithm : int
        One of nlopt's.
    step : float
        First step, in logarithms; at most a quarter of the box, for BOBYQA refuses more than a half.
    xtol : float
        Stop where steps fall below this, in logarithms.
    maxeval : int
        Stop after so many evaluations.

    Returns
    -------
    Start
        With the best point evaluated, wherever the algorithm ended.

    Raises
    ------
    Exception
        Whatever the objective raises.
    """
    optimiser = nlopt.opt(algorithm, 2)
    optimiser.set_lower_bounds(np.log(box.lower))
    optimiser.set_upper_bounds(np.log(box.upper))
    optimiser.set_initial_step(np.minimum(step, 0.25 * np.log(np.divide(box.upper, box.lower))))
    optimiser.set_xtol_abs(xtol)
    optimiser.set_maxeval(maxeval)
    recorder = _Recorder(objective, box, optimiser)
    optimiser.set_min_objective(recorder)
    begin = box.clip(start)
    try:
        optimiser.optimize(begin)
        result = _RESULTS.get(optimiser.last_optimize_result(), "FAILURE")
    except nlopt.RoundoffLimited:
        result = "ROUNDOFF_LIMITED"
    except nlopt.ForcedStop:
        result = "FORCED_STOP"
    except (RuntimeError, SystemError):  # with a failure at hand this is nlopt's echo of it
        if recorder.failure is None:
            raise
    if recorder.failure is not None:
        raise recorder.failure
    value, end = recorder.best if recorder.best is not None else (float("inf"), begin)
    return Start(origin, _point(begin), _point(end), value, result, recorder.evaluations)


def search(
    objective: Objective, box: Box, ridge: Callable[[float], float], *, starts: int, seed: int
) -> tuple[Start, ...]:
    """Global stage (CRS2), then BOBYQA from its best point and from seeded starts.

    Parameters
    ----------
    objective : callable
        As in `minimise`.
    box : Box
        Bounds.
    ridge : callable
        The best alpha [1/ms] for a given c_e [N/mm^2]. Starts lie on this line, where it is in the box: one
        c_e in each of `starts` equal parts of its logarithmic range, at random within the part. From
        elsewhere a local search spends its steps on the way to the line.
    starts : int
        Number of seeded starts.
    seed : int
        Of nlopt's global stage and of the starts.

    Returns
    -------
    tuple of Start
        All ends, the global stage first.
    """
    nlopt.srand(seed % 2**32)
    middle = (np.log(box.lower) + np.log(box.upper)) / 2
    crs2 = nlopt.GN_CRS2_LM
    found = [minimise(objective, box, middle, origin="global", algorithm=crs2, xtol=1e-3, maxeval=400)]
    found.append(minimise(objective, box, np.log(found[0].end), origin="local from global"))
    low, high = _log_c_e_range(box, ridge)
    within = np.random.default_rng(seed).random(starts)
    for i in range(starts):
        log_c_e = low + (high - low) * (i + within[i]) / starts
        begin = np.array([log_c_e, np.log(ridge(float(np.exp(log_c_e))))])
        found.append(minimise(objective, box, begin, origin=f"start {i + 1}"))
    return tuple(found)


def _log_c_e_range(box: Box, ridge: Callable[[float], float]) -> tuple[float, float]:
    """Where the ridge runs inside the bounds of alpha; all of the box where it never does."""
    log_c_e = np.linspace(np.log(box.lower[0]), np.log(box.upper[0]), 64)
    alpha = np.array([ridge(float(c_e)) for c_e in np.exp(log_c_e)])
    inside = log_c_e[(alpha > box.lower[1]) & (alpha < box.upper[1])]
    ends = inside if len(inside) > 1 else log_c_e
    return float(ends[0]), float(ends[-1])


def is_minimum(objective: Objective, box: Box, end: Start, directions: Floats, *, step: float = 1e-3) -> bool:
    """Whether no neighbour of an end is clearly better; nlopt's return code cannot say so."""
    centre = np.log(end.end)
    neighbours = [box.clip(centre + sign * step * d) for d in directions for sign in (1.0, -1.0)]
    best = min((value for value in map(objective, neighbours) if not np.isnan(value)), default=np.inf)
    return best >= end.objective * (1 - 1e-6) - 1e-15


def _point(logarithms: Floats) -> tuple[float, float]:
    c_e, alpha = np.exp(logarithms)
    return float(c_e), float(alpha)
