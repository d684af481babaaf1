"""The fit of c_e and alpha to velocities, traces and indentations."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any, Literal, get_args

import nlopt
import numpy as np

from burrlab._core import Burr, Shape
from burrlab.bone.specimen import Specimen
from burrlab.bone.uneven import BoneField
from burrlab.common.check import require_type
from burrlab.common.provenance import provenance
from burrlab.common.study import StorePath
from burrlab.fitting.likelihood import Likelihood, MeanFieldModel
from burrlab.fitting.observations import Bounds, Data, Floats, Observations, ResidualKind, bounds_of
from burrlab.fitting.record import describe, weigh
from burrlab.fitting.result import Fit
from burrlab.fitting.search import Box, Objective, Start, is_minimum, minimise, search
from burrlab.fitting.verdict import status_of
from burrlab.fitting.voxel import VoxelEngine, VoxelModel, VoxelSettings
from burrlab.measured.curve import VelocityCurve
from burrlab.measured.depth_trace import DepthTrace
from burrlab.measured.indentation import Indentation

__all__ = ["Fit", "fit"]

Engine = Literal["mean-field", "voxel"]
Progress = Callable[[int, int], object]


def fit(
    data: Data | Sequence[Data],
    burr: Burr | None = None,
    *,
    shape: Shape | str = "parabolic",
    engine: Engine = "mean-field",
    residuals: ResidualKind = "relative",
    starts: int = 8,
    seed: int | None = 0,
    bounds: Bounds | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    store: StorePath | None = None,
    voxel: float = 0.1,
    dt: float = 1.0,
    rig: bool = False,
    specimen: Specimen | BoneField | None = None,
    replicates: int = 4,
) -> Fit:
    """Fit the elastic constant c_e and the erosion rate alpha, and say what the data determine.

    The likelihood is maximised over log c_e and log alpha, the scatter estimated with them, for

    * ``"relative"``  log-normal velocities, r = ln(v/v_predicted),
    * ``"absolute"``  normal velocities of one scatter, r = v - v_predicted [mm/s], the paper's least squares,
    * ``"sigma"``     normal velocities of given sigma, r = (v - v_predicted)/sigma.

    Parameters
    ----------
    data : VelocityCurve, Indentation, DepthTrace or a sequence of them
        Rows of a curve without a velocity are skipped and counted; those of status ``"overloaded"`` are
        censored: they bound c_e from above. Repeats are rows of their own. Rows with windows of their own are
        compared over these, a trace in five parts of equal depth. Velocities of all curves, and of the runs of
        all traces, share one scatter; indentations have another.
    burr : Burr, optional
        The burr of the data sets that do not say their radius.
    shape : Shape or str
        Erosion shape function f; alpha is a number for one f.
    engine : {"mean-field", "voxel"}
        What predicts the velocity: the scaling law of the axisymmetric mean-field descent, or descents into
        voxels. The voxel engine begins at the mean-field fit.
    residuals : {"relative", "absolute", "sigma"}
        See above.
    starts : int
        Number of local searches besides the one from the global stage's best point.
    seed : int or None
        Of the starts and of the voxel engine's erosion; None draws one, which the result records.
    bounds : dict, optional
        ``{"c_e": (low, high), "alpha": (low, high)}`` [N/mm^2], [1/ms]. By default c_e runs from its hard
        bound to 100 times that, alpha from 1e-5 to 10, or as far as the data reach, in the search, and both
        without end in the intervals.
        An interval that reaches a bound given here is open there.
    progress : callable, optional
        Voxel engine: called with (descents done, descents in all).
    executor : concurrent.futures.Executor, optional
        Voxel engine: runs the descents; threads over the cores by default.
    store : Store or path, optional
        Voxel engine: keeps every descent, so that an interrupted fit goes on where it stopped.
    voxel : float
        Voxel engine: voxel size [mm].
    dt : float
        Voxel engine: tick [ms].
    rig : bool
        Voxel engine: descents through controller and virtual rig; else the force is held exactly.
    specimen : Specimen or BoneField, optional
        Voxel engine: what is burred; of a BoneField every replicate has its own realisation. Default: solid
        bone.
    replicates : int
        Voxel engine: descents at each force and point, at least 2; their differences give its Monte Carlo error.

    Returns
    -------
    Fit

    Raises
    ------
    TypeError
        If data or burr is something else.
    ValueError
        If the data have fewer than three distinct forces among their usable rows, are of another radius, or
        contradict one another; lack the sigma that ``"sigma"`` needs; or an argument is out of range.
    StudyInterrupted
        If the executor dies.

    Notes
    -----
    `relative` is the default because the scatter of such measurements grows with the velocity, which spans
    decades. `absolute`, the paper's, lets the fastest points decide.

    The hard bound of c_e: a window at force F shows that static contact lies above the window's end, so
    c_e > F/(0.1925 R^2) for the default end R/3; and an overloaded run shows the contrary. Both belong to the
    likelihood, which is zero beyond.

    While every window begins above static contact (phi = F/(c_e R^2) < 0.068), predictions depend on
    alpha/c_e^(8/3) alone: a ridge. `status` is ``"ridge"`` where the 95 % interval of c_e is open above.

    Intervals and regions are profile likelihoods with limits from the F distribution
    (`burrlab.fitting.observations.Calibration`). The voxel engine predicts v = alpha times a function of c_e that is
    tabulated by descents near the best alpha, with common random numbers at all points; the Monte Carlo
    error of the fit widens the limits by 1 + SE_mc^2/SE_stat^2, as Ionides et al. do.

    Global stage: CRS2 of nlopt; local: BOBYQA. nlopt's return code tells nothing about the fit, so the best
    end is compared with its neighbours, the ends with one another, and with the walk along c_e that the
    intervals come from.

    References
    ----------
    Agus et al., Physics-based burr haptic simulation: tuning and evaluation, HAPTICS 2004, section 4.
    Ionides, Breto, Park, Smith, King, Monte Carlo profile confidence intervals for dynamic systems,
    J. R. Soc. Interface 14 (2017) 20170126.
    Kaelo and Ali, Some variants of the controlled random search algorithm, JOTA 130 (2006).
    Powell, The BOBYQA algorithm for bound constrained optimization without derivatives, Cambridge 2009.

    Examples
    --------
    >>> import burrlab
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> curve = burrlab.synthetic_curve(burr, bone, [0.3, 0.6, 1.2, 2.4], scatter=0.05, seed=1)
    >>> result = burrlab.fit(curve, burr)
    >>> result.status, result.separately_identified
    ('ok', True)
    >>> few = burrlab.synthetic_curve(burr, bone, [0.3, 0.4, 0.5, 0.6], scatter=0.05, seed=1)
    >>> print(burrlab.fit(few).intervals["c_e"]["95"].upper)  # no upper end
    None
    """
    begin = time.perf_counter()
    sets = _sets(data)
    if burr is not None:
        require_type("burr", burr, Burr, "Burr(3.0)")
    shape = shape if isinstance(shape, Shape) else Shape(shape)
    _check(engine, residuals, starts, replicates)
    if not (seed is None or (isinstance(seed, (int, np.integer)) and seed >= 0)):
        raise ValueError(f"seed must be a whole number from 0, or None: got {seed!r}")
    if seed is None and store is not None:
        raise ValueError("a store needs a seed, for it finds results by it: got seed None")
    if not isinstance(specimen, (Specimen, BoneField, type(None))):
        raise TypeError(f"specimen must be a Specimen or a BoneField, got {specimen!r}")
    if not isinstance(bounds, (dict, type(None))):
        raise TypeError(f"bounds must be a dict such as {{'c_e': (1, 3)}}, got {bounds!r}")
    observations = Observations.of(sets, burr)
    if residuals == "sigma" and not observations.has_sigma:
        raise ValueError("residuals 'sigma' need a sigma in every row that has a velocity")
    seed = secrets.randbits(32) if seed is None else int(seed)
    box = bounds_of(observations, bounds)

    likelihood = Likelihood(observations, residuals, MeanFieldModel(observations, shape))
    if "alpha" not in (bounds or {}):
        box = _with_best_alphas(box, likelihood)
    ends = search(_objective(likelihood), box, _ridge_alpha(likelihood), starts=starts, seed=seed)
    settings: dict[str, Any] = {}
    table, made = None, None
    record: tuple[tuple[float, float], ...] = ()
    if engine == "voxel":
        given = VoxelSettings(voxel, dt, rig, specimen, replicates)
        settings = given.described()
        voxels = VoxelEngine(
            observations, shape, given, seed=seed, executor=executor, store=store, progress=progress
        )
        made = voxels.tabulate(likelihood, box, _best(ends).end)
        ends = (Start("from mean-field", _best(ends).end, _best(ends).end, np.inf, "FAILURE", 0),)
        if not isinstance(made, str):
            table, record = made
            likelihood = Likelihood(observations, residuals, VoxelModel(observations, shape, table))
            ends = (_local(likelihood, box, ends[0].end, "from mean-field"),)

    best = _best(ends)
    evidence = weigh(likelihood, shape, box, bounds, best.end, table) if np.isfinite(best.objective) else None
    if (
        evidence is not None and evidence.better is not None
    ):  # the walk along c_e found what the searches missed
        ends = (*ends, _local(likelihood, box, evidence.better, "walk along c_e"))
        best = _best(ends)
        evidence = weigh(likelihood, shape, box, bounds, best.end, table)
    if evidence is None:
        status, reason = "not-converged", str(made)
    else:
        exponent = evidence.ridge.exponent
        directions = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, exponent]])
        settled = best.converged and is_minimum(_objective(likelihood), box, best, directions)
        status, reason = status_of(observations, box, ends, best, evidence.ridge, settled)
    return Fit(
        c_e=best.end[0],
        alpha=best.end[1],
        shape=shape,
        radius=_radius(observations),
        residual_kind=residuals,
        status=status,
        reason=reason,
        starts=ends,
        bounds={"c_e": (box.lower[0], box.upper[0]), "alpha": (box.lower[1], box.upper[1])},
        given_bounds=tuple(bounds or ()),
        evidence=evidence,
        **describe(likelihood, best.end, evidence is not None),
        engine=engine,
        table=table,
        seed=seed,
        evaluations=sum(end.evaluations for end in ends),
        seconds=time.perf_counter() - begin,
        record=record,
        data=sets,
        provenance=provenance(
            shape=shape.name,
            radius_mm=sorted(set(observations.radius.tolist())),
            engine=engine,
            residuals=residuals,
            starts=starts,
            seed=seed,
            nlopt=nlopt.__version__,
            **settings,
        ),
    )


def _sets(data: Data | Sequence[Data]) -> tuple[Data, ...]:
    sets = tuple(data) if isinstance(data, (list, tuple)) else (data,)
    for one in sets:
        if not isinstance(one, (VelocityCurve, Indentation, DepthTrace)):
            raise TypeError(
                "data must be a VelocityCurve, Indentation or DepthTrace or several of them, such as "
                f"VelocityCurve.from_csv('data.csv'), got {one!r}"
            )
    if not sets:
        raise ValueError("data must hold at least one data set: got none")
    return sets


def _with_best_alphas(box: Box, likelihood: Likelihood) -> Box:
    """The box, its alphas widened to those that fit best over its first decade of c_e, if they are beyond."""
    best = likelihood.at(np.geomspace(box.lower[0], min(10 * box.lower[0], box.upper[0]), 20)).best_alpha
    low, high = float(best.min()) / 3, 3 * float(best.max())
    return Box((box.lower[0], min(box.lower[1], low)), (box.upper[0], max(box.upper[1], high)))


def _radius(observations: Observations) -> float | None:
    radii = set(observations.radius.tolist())
    return radii.pop() if len(radii) == 1 else None


def _check(engine: str, residuals: str, starts: int, replicates: int) -> None:
    for name, value, allowed in (("engine", engine, Engine), ("residuals", residuals, ResidualKind)):
        if value not in get_args(allowed):
            raise ValueError(f"{name} must be one of {', '.join(get_args(allowed))}: got {value!r}")
    for name, number in (("starts", starts), ("replicates", replicates)):
        if not isinstance(number, (int, np.integer)):
            raise TypeError(f"{name} must be a whole number, got {number!r}")
    if starts < 0:
        raise ValueError(f"starts must not be negative: got {starts!r}")
    if replicates < 2:
        raise ValueError(f"replicates must be at least 2, to show their scatter: got {replicates!r}")


def _objective(likelihood: Likelihood) -> Objective:
    """What the searches minimise over (log c_e, log alpha); NaN where a row has no prediction."""

    def objective(logarithms: Floats) -> float:
        return likelihood.objective(*np.exp(logarithms).tolist())

    return objective


def _ridge_alpha(likelihood: Likelihood) -> Callable[[float], float]:
    return lambda c_e: float(likelihood.at(c_e).best_alpha[0])


def _local(likelihood: Likelihood, box: Box, start: tuple[float, float], origin: str) -> Start:
    return minimise(_objective(likelihood), box, np.log(start), origin=origin)


def _best(ends: Sequence[Start]) -> Start:
    return min(ends, key=lambda end: end.objective)
