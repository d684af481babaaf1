"""The fit of c_e and alpha to a velocity-force curve."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any, Literal, get_args

import nlopt
import numpy as np

from burrlab._core import Burr, Shape
from burrlab.arguments import require_type
from burrlab.curve import VelocityCurve
from burrlab.fitting.problem import (
    Bounds,
    MeanFieldModel,
    Observations,
    Predict,
    ResidualKind,
    bounds_of,
)
from burrlab.fitting.result import Fit
from burrlab.fitting.search import Box, Floats, Objective, Start, is_minimum, minimise, search
from burrlab.fitting.verdict import ridge_of, verdict
from burrlab.fitting.voxel import VoxelModel
from burrlab.provenance import provenance

__all__ = ["Fit", "fit"]

Engine = Literal["mean-field", "voxel"]
Progress = Callable[[int, int], object]
Record = list[tuple[float, float, float]]

_VOXEL_STEP, _VOXEL_XTOL, _VOXEL_MAXEVAL = 0.1, 2e-3, 30  # first step and stop, in logarithms


def fit(
    curve: VelocityCurve,
    burr: Burr,
    *,
    shape: Shape | str = "parabolic",
    engine: Engine = "mean-field",
    residuals: ResidualKind = "relative",
    starts: int = 8,
    seed: int | None = 0,
    bounds: Bounds | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    voxel: float = 0.1,
    dt: float = 1.0,
) -> Fit:
    """Fit the elastic constant c_e and the erosion rate alpha to a velocity-force curve.

    The sum of squared residuals is minimised over log c_e and log alpha, with

    * ``"relative"``  r = ln(v/v_predicted),
    * ``"absolute"``  r = v - v_predicted [mm/s], the paper's,
    * ``"sigma"``     r = (v - v_predicted)/sigma.

    Parameters
    ----------
    curve : VelocityCurve
        Rows without a velocity are skipped and counted. Repeats count as they are. Rows with windows of their
        own are compared over these.
    burr : Burr
        The burr that the curve was taken with.
    shape : Shape or str
        Erosion shape function f; alpha is a number for one f.
    engine : {"mean-field", "voxel"}
        What predicts the velocity: the scaling law of the axisymmetric mean-field descent, or descents into a
        voxel bone with the force held exactly. The voxel engine begins at the mean-field fit.
    residuals : {"relative", "absolute", "sigma"}
        See above.
    starts : int
        Number of local searches besides the one from the global stage's best point.
    seed : int or None
        Of the starts and of the voxel engine's erosion; None draws one, which the result records.
    bounds : dict, optional
        ``{"c_e": (low, high), "alpha": (low, high)}`` [N/mm^2], [1/ms]. By default c_e runs from its hard
        bound to 100 times that, alpha from 1e-5 to 10.
    progress : callable, optional
        Voxel engine: called with (evaluations done, most that will be done).
    executor : concurrent.futures.Executor, optional
        Voxel engine: runs the descents; threads over the cores by default.
    voxel : float
        Voxel engine: voxel size [mm].
    dt : float
        Voxel engine: tick [ms].

    Returns
    -------
    Fit

    Raises
    ------
    TypeError
        If curve or burr is something else.
    ValueError
        If the curve has fewer than three distinct forces among its usable rows, is of another radius, lacks
        the sigma that ``"sigma"`` needs, or an argument is out of range.

    Notes
    -----
    `relative` is the default because the scatter of such measurements grows with the velocity, which spans
    decades: a log-normal scatter makes these residuals alike, and to first order they equal
    (v - v_predicted)/v_predicted. `absolute`, the paper's, lets the fastest points decide.

    The hard bound of c_e: a window at force F shows that static contact lies above the window's end, so
    c_e > F/(0.1925 R^2) for the default end R/3.

    While every window begins above static contact (phi = F/(c_e R^2) < 0.068), predictions depend on
    alpha/c_e^(8/3) alone: a ridge. `status` is then ``"ridge"``, as it is where the best point lies elsewhere
    but a point on the ridge raises the sum of squares by less than four times the residual variance.

    Global stage: CRS2 of nlopt; local: BOBYQA. nlopt's return code tells nothing about the fit, so the best
    end is compared with its neighbours, and the ends with one another.

    References
    ----------
    Agus et al., Physics-based burr haptic simulation: tuning and evaluation, HAPTICS 2004, section 4.
    Kaelo and Ali, Some variants of the controlled random search algorithm, JOTA 130 (2006).
    Powell, The BOBYQA algorithm for bound constrained optimization without derivatives, Cambridge 2009.

    Examples
    --------
    >>> import burrlab
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> curve = burrlab.synthetic_curve(burr, bone, [0.3, 0.6, 1.2, 2.4], repeats=1, scatter=0.0, seed=1)
    >>> result = burrlab.fit(curve, burr)
    >>> result.status, round(result.c_e, 2), round(result.alpha, 4)
    ('ok', 2.15, 0.087)
    """
    begin = time.perf_counter()
    require_type("curve", curve, VelocityCurve, "VelocityCurve.from_csv('data.csv')")
    require_type("burr", burr, Burr, "Burr(3.0)")
    shape = shape if isinstance(shape, Shape) else Shape(shape)
    observations = Observations.of(curve, burr)
    _check(observations, engine, residuals, starts)
    seed = secrets.randbits(32) if seed is None else int(seed)
    box = bounds_of(observations, bounds)

    mean_field = MeanFieldModel(observations, shape)
    objective = _objective(observations, residuals, mean_field.predict)

    def on_ridge(c_e: float) -> float:
        return observations.best_alpha(residuals, mean_field.unit(c_e))

    ends = search(objective, box, on_ridge, starts=starts, seed=seed)
    predict: Predict = mean_field.predict
    settings: dict[str, Any] = {}
    record: Record = []
    if engine == "voxel":
        settings = {"voxel_mm": voxel, "dt_ms": dt}
        predict = VoxelModel(observations, shape, voxel=voxel, dt=dt, seed=seed, executor=executor).predict
        objective = _recorded(_objective(observations, residuals, predict), record, progress)
        ends = (_voxel_search(objective, box, _best(ends)),)

    best = _best(ends)
    predicted = predict(*best.end)
    ridge = ridge_of(observations, residuals, mean_field, shape, box, best.end)
    directions = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, ridge.exponent]])
    settled = best.converged and (engine == "voxel" or is_minimum(objective, box, best, directions))
    status, reason = verdict(observations, box, ends, best, ridge, settled)
    final = observations.residuals(residuals, predicted)
    return Fit(
        c_e=best.end[0],
        alpha=best.end[1],
        shape=shape,
        radius=burr.radius,
        residual_kind=residuals,
        residual_norm=float(np.sqrt(np.mean(final**2))),
        residuals=final,
        predicted=predicted,
        chi2_reduced=_chi2_reduced(observations, predicted),
        n_points=len(observations),
        n_skipped=observations.n_skipped,
        status=status,
        reason=reason,
        starts=ends,
        bounds={"c_e": (box.lower[0], box.upper[0]), "alpha": (box.lower[1], box.upper[1])},
        ridge=ridge,
        engine=engine,
        seed=seed,
        evaluations=sum(end.evaluations for end in ends),
        seconds=time.perf_counter() - begin,
        record=tuple(record),
        curve=curve,
        provenance=provenance(
            shape=shape.name,
            radius_mm=burr.radius,
            engine=engine,
            residuals=residuals,
            starts=starts,
            seed=seed,
            nlopt=nlopt.__version__,
            **settings,
        ),
    )


def _check(observations: Observations, engine: str, residuals: str, starts: int) -> None:
    for name, value, allowed in (("engine", engine, Engine), ("residuals", residuals, ResidualKind)):
        if value not in get_args(allowed):
            raise ValueError(f"{name} must be one of {', '.join(get_args(allowed))}: got {value!r}")
    if starts < 0:
        raise ValueError(f"starts must not be negative: got {starts!r}")
    if residuals == "sigma" and not observations.has_sigma:
        raise ValueError("residuals 'sigma' need a sigma in every row that has a velocity")


def _objective(observations: Observations, residuals: ResidualKind, predict: Predict) -> Objective:
    """Sum of squared residuals over (log c_e, log alpha); NaN where a row has no prediction."""

    def objective(logarithms: Floats) -> float:
        c_e, alpha = np.exp(logarithms).tolist()
        return float(np.sum(observations.residuals(residuals, predict(c_e, alpha)) ** 2))

    return objective


def _recorded(objective: Objective, record: Record, progress: Progress | None) -> Objective:
    """The objective, every evaluation kept and told to `progress`."""

    def recorded(logarithms: Floats) -> float:
        value = objective(logarithms)
        c_e, alpha = np.exp(logarithms).tolist()
        record.append((c_e, alpha, value))
        if progress is not None:
            progress(len(record), _VOXEL_MAXEVAL)
        return value

    return recorded


def _voxel_search(objective: Objective, box: Box, mean_field: Start) -> Start:
    return minimise(
        objective,
        box,
        np.log(mean_field.end),
        origin="from mean-field",
        step=_VOXEL_STEP,
        xtol=_VOXEL_XTOL,
        maxeval=_VOXEL_MAXEVAL,
    )


def _best(ends: tuple[Start, ...]) -> Start:
    return min(ends, key=lambda end: end.objective)


def _chi2_reduced(observations: Observations, predicted: Floats) -> float | None:
    if not observations.has_sigma:
        return None
    chi = observations.residuals("sigma", predicted)
    return float(np.sum(chi**2) / (len(observations) - 2))
