"""The fit of c_e and alpha to velocities, traces and indentations."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import nlopt
import numpy as np

from burrlab._core import Burr, Shape
from burrlab.common.check import nearest, real, refuse, require_type, seed_or_new, shown
from burrlab.common.progress import doing
from burrlab.common.provenance import provenance
from burrlab.fitting.diagnostics import (
    PLAUSIBLE,
    HypothesisTest,
    Point,
    against_order,
    belief_tests,
    doubts,
    fall_with_depth,
    goodness,
    influence,
    lack_of_fit,
    next_law,
    order_tests,
    plausibility,
)
from burrlab.fitting.group_effects import (
    MixedEvidence,
    effect_sentences,
    of_groups_alone,
    silent_groups,
    what_opens,
)
from burrlab.fitting.likelihood import Beliefs, Likelihood, LikelihoodKind, MeanFieldModel
from burrlab.fitting.linear import Component, Uncertain, check_names, check_offsets, components_of
from burrlab.fitting.mixed import MixedLikelihood, against_indentation, at_best_variances
from burrlab.fitting.observations import (
    Bounds,
    Box,
    Data,
    Floats,
    Observations,
    ResidualKind,
    bounds_of,
)
from burrlab.fitting.profile import FLAT, Domain, at_ridge, minima, profile
from burrlab.fitting.record import Evidence
from burrlab.fitting.result import Fit
from burrlab.fitting.verdict import (
    Start,
    at_windows,
    bound_reached,
    equally_good,
    ridge_of,
    sentence,
    status_of,
)
from burrlab.fitting.voxel import Descents, VoxelEngine, VoxelModel, VoxelTable, monte_carlo_share
from burrlab.measured.curve import Indentation, VelocityCurve
from burrlab.measured.depth_trace import DepthTrace
from burrlab.theory.continuum import Law

__all__ = ["Fit", "fit"]

Engine = Literal["mean-field", "voxel"]
_RESULTS = {
    getattr(nlopt, name): name for name in ("SUCCESS", "XTOL_REACHED", "ROUNDOFF_LIMITED", "MAXEVAL_REACHED")
}
_STEP = 0.02  # first step, in logarithms: the search stays at the minimum that it checks
_CLOSE = 1e-7  # the search ends where its steps fall below this, in logarithms
_LONGEST = 1000  # evaluations
_STEPS = 1e-2  # of -2 log L that is uneven: its shallow minima and steps are as one (ours)
_ANY: Bounds = {"c_e": (1e-9, 1e9), "alpha": (1e-12, 1e12)}  # [N/mm^2], [1/ms]
_TURNS = 4  # of search and variances, at most
_EXACT = 1e-3  # relative standard deviation of a value that is known without one; the model's own error is twice that


@doing("fit")
def fit(
    data: Data | Sequence[Data],
    burr: Burr | None = None,
    *,
    law: Law | Shape | str = "parabolic",
    engine: Engine | VoxelEngine = "mean-field",
    residuals: ResidualKind = "relative",
    groups: Sequence[str] | None = None,
    uncertain: Uncertain | None = None,
    estimate: Sequence[str] = (),
    share: Sequence[str] = ("c_e", "alpha"),
    known: Mapping[str, float | tuple[float, float]] | None = None,
    bounds: Bounds | None = None,
    plausible: Bounds | None = PLAUSIBLE,
) -> Fit:
    """Fit the elastic constant c_e and the erosion rate alpha, and say what the data determine.

    The likelihood is maximised over log c_e, log alpha and the scatter, for

    * ``"relative"``  log-normal velocities, r = ln(v/v_predicted),
    * ``"absolute"``  normal velocities of one scatter, r = v - v_predicted [mm/s], the paper's least squares,
    * ``"sigma"``     normal velocities of given sigma, r = (v - v_predicted)/sigma; with groups, offsets or known
      values log-normal ones of relative scatter sigma/v,
    * ``"student"``   Student's t with 4 degrees of freedom in log velocity, for curves with outliers.

    Parameters
    ----------
    data : VelocityCurve, Indentation, DepthTrace or a sequence of them
        Rows of a curve without a velocity are skipped and counted; those of status ``"overloaded"`` are
        censored: they bound c_e from above; of ``"too-slow"`` ones the velocity lies below `limit` (a Tobit
        term, for ``"relative"`` without groups). Each repeat is a row. A row with a window of its own is compared
        over that window, a trace in five parts of equal depth. Velocities of all curves, and of the runs of
        all traces, share one scatter; indentations have another.
    burr : Burr, optional
        The burr of data sets without a radius.
    law : Law, Shape or str
        Exponents of force and rate, and the erosion shape function f; a shape, or its name, is the paper's law with
        that f. c_e and alpha hold for this law alone.
    engine : {"mean-field", "voxel"} or VoxelEngine
        What predicts the velocity: the scaling law of the axisymmetric mean-field descent, or descents into
        voxels; ``"voxel"`` is `VoxelEngine` with its defaults. The voxel engine begins at the mean-field fit.
    residuals : {"relative", "absolute", "sigma", "student"}
        See above.
    groups : sequence of str, optional
        Names of the data's groups to use: ``("day", "specimen")``; by default all that the data carry, ``()`` for
        none. Runs of a group share an effect; c_e and alpha are then those of the population of groups.
    uncertain : dict, optional
        Standard deviations of offsets of what was measured, ``{"force": 0.02, "surface": 0.05, "radius": 0.03}``
        [N], [mm], [mm]: a load cell not quite zero, a surface not quite known, a burr that is worn. Each data set
        has an offset of its own; each day, with ``{"force": (0.02, "day")}``.
    estimate : sequence of str, optional
        Offsets that the data shall tell, one for all: ``"force"`` (a tare, or a friction that must be overcome),
        ``"radius"``; and ``"order"``, a drift of ln v from the first run to the last (wear), where alpha is that of
        the middle. ``"order:day"`` begins anew each day, as with a new burr, ``"order:data set"`` with each data
        set; its last run is that of the longest. Each has a normal prior, of standard deviation half the median
        force, R/10 or 1 in ln v (our choice): wider than data that tell them leave open.
    share : ("c_e", "alpha"), ("c_e",) or ("alpha",)
        What several data sets have in common. Without alpha, such as of two drills in one bone, each has an alpha of
        its own; without c_e, a c_e: `alpha` or `c_e` is then that of the first, and `effects` has ln of the others'
        over it.
    known : dict, optional
        ``{"c_e": (value, standard deviation)}`` from elsewhere [N/mm^2], or of ``"alpha"`` [1/ms]; a value alone is
        taken to 0.1 %.
    bounds : dict, optional
        ``{"c_e": (low, high), "alpha": (low, high)}`` [N/mm^2], [1/ms]. By default the search takes c_e from
        its hard bound to 100 times that, and alpha from 1e-5 to 10 or as far as the data reach; the intervals
        have no such ends. An interval that reaches a bound given here is open there.
    plausible : dict or None
        ``{"c_e": (low, high), "alpha": (low, high)}`` [N/mm^2], [1/ms]: what is known of such materials. By
        default, also for a missing name, the shipped materials' range widened by 1.5, for the paper's law alone;
        None asks nothing. It moves no estimate.

    Returns
    -------
    Fit

    Raises
    ------
    TypeError
        If data or burr has another type.
    ValueError
        If the usable rows have fewer than three distinct forces; the data have another radius than the burr,
        contradict one another, or lack the sigma that ``"sigma"`` needs; groups cannot be told apart, or go with
        other residuals than ``"relative"`` and ``"sigma"``; or an argument is out of range.
    StudyInterrupted
        If the executor dies.

    Notes
    -----
    `relative` is the default because the scatter of such measurements grows with the velocity, which spans
    decades. `absolute`, the paper's, lets the fastest points decide.

    The data give c_e hard bounds. A window at force F shows that its end is deeper than static contact, so
    c_e > F/(0.1925 R^2) for the default end R/3. An overloaded run shows the opposite. The likelihood is zero
    beyond either.

    While every window begins deeper than static contact (phi = F/(c_e R^2) < 0.068), predictions depend on
    alpha/c_e^(8/3) alone: a ridge. `status` is ``"ridge"`` where the 95 % interval of c_e is open above.

    Intervals and regions are profile likelihoods with limits from the F distribution
    (`burrlab.fitting.calibration.Calibration`). The voxel engine predicts v = alpha times a function of c_e
    that is tabulated by descents near the best alpha, with common random numbers at all points; the Monte
    Carlo error of the fit widens the limits by 1 + SE_mc^2/SE_stat^2, as Ionides et al. do.

    At each c_e the best alpha has a closed form. So a walk along c_e finds all minima, and the intervals are
    read from it too. The fit is the walk's lowest point within the bounds of the search. Where -2 log L stays
    within 1e-5 of its lowest from some c_e on the ridge to the end of the search, over 5 % of c_e or more,
    the fit is the smallest such c_e. nlopt's BOBYQA starts from this point and from every minimum of equal
    RMS residual (within 0.1 %). `status` is ``"not-converged"`` where it finds a point whose -2 log L is
    lower by more than 1e-5, ``"disagreement"`` where equally good ends differ by more than 5 %.

    A day (or operator, session, drill) shifts log alpha of its runs by a normal effect; a specimen shifts log
    alpha and, from three specimens on, log c_e. Their variances are estimated by REML with the model linear about
    the fit, and the limits of the intervals have the degrees of freedom that the groups leave in each direction. An
    offset has the model's own derivative by it, and a given standard deviation (docs/inference.md).

    References
    ----------
    Agus et al., Physics-based burr haptic simulation: tuning and evaluation, HAPTICS 2004, section 4.
    Ionides, Breto, Park, Smith, King, Monte Carlo profile confidence intervals for dynamic systems,
    J. R. Soc. Interface 14 (2017) 20170126.
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
    # parse
    sets, law, voxels = _sets(data), Law.of(law), _engine(engine)
    shape, plausible = law.shape, _range_of(law, plausible)
    _check(burr, residuals, voxels)
    _check_ranges("bounds", bounds)
    _check_ranges("plausible", plausible)
    check_offsets(uncertain, estimate)
    check_names("groups", groups or (), "day")
    apart = _apart(share, sets)
    observations, beliefs = Observations.of(sets, burr, groups, law), _beliefs(known)
    given_bounds, bounds = tuple(bounds or {}), _around(beliefs) | (bounds or {})
    components = components_of(observations, uncertain, (*estimate, *apart))
    mixed = bool(components or beliefs)
    kind = _likelihood_kind(observations, residuals, mixed, voxels, {*(uncertain or {}), *estimate})
    seed = 0 if voxels is None else seed_or_new(voxels.seed)  # the mean field draws nothing
    likelihood = Likelihood(observations, kind, MeanFieldModel(observations, shape), beliefs)
    box = _box(likelihood, bounds)
    # walk
    domain = Domain.of(likelihood, box, bounds)
    searches, missed = _searched(likelihood, domain, box)
    table, failure = None, ""
    record: tuple[Point, ...] = ()
    if voxels is not None:
        mean_field = searches[0].end
        descents = Descents(observations, shape, voxels, seed).tabulate(likelihood, box, mean_field)
        searches = (Start("from mean-field", mean_field, mean_field, np.inf, "FAILURE", 0),)
        if isinstance(descents, str):
            failure = descents
        else:
            table, record = descents
            likelihood = Likelihood(observations, kind, VoxelModel(observations, shape, table), beliefs)
            found, missed = _searched(likelihood, domain, box, ("from mean-field", mean_field))
            searches = found or searches
            failure = "" if found else "No c_e within its bounds gave every row a velocity."
    if mixed and not failure:
        likelihood, domain, box, searches, missed = _searched_mixed(
            likelihood, components, searches[0].end, box, bounds
        )
    best = min(searches, key=lambda start: start.objective) if missed > FLAT else searches[0]
    likelihood = likelihood.about(best.end)
    # intervals and verdict
    evidence, lack, status, reason = None, None, "not-converged", failure
    if not failure:
        lack = lack_of_fit(likelihood, best.end)
        hit = bound_reached(observations, box, best.end)
        evidence = _weighed(likelihood, domain, best.end, table, sets, bounds, plausible, hit, lack)
        status, reason = status_of(
            len(observations), hit, searches, best, evidence.ridge, missed, evidence.doubt
        )
    radii, name = sorted(set(observations.radius.tolist())), "mean-field" if voxels is None else "voxel"
    return Fit(
        c_e=best.end[0],
        alpha=best.end[1],
        shape=shape,
        **law.exponents,
        radius=radii[0] if len(radii) == 1 else None,
        residual_kind=residuals,
        status=status,
        reason=reason,
        starts=searches,
        bounds={"c_e": (box.lower[0], box.upper[0]), "alpha": (box.lower[1], box.upper[1])},
        given_bounds=given_bounds,
        evidence=evidence,
        lack_of_fit=lack,
        **_described(likelihood, best.end, evidence is not None),
        engine=name,
        table=table,
        seed=seed,
        evaluations=sum(start.evaluations for start in searches),
        seconds=time.perf_counter() - begin,
        record=record,
        data=sets,
        provenance=provenance(
            shape=shape.name,
            **law.exponents,
            radius_mm=radii,
            engine=name,
            residuals=residuals,
            seed=seed,
            nlopt=nlopt.__version__,
            **_groups_and_known(observations, beliefs),
            **({} if voxels is None else voxels._described()),
        ),
    )


def _range_of(law: Law, plausible: Bounds | None) -> Bounds | None:
    """The plausible range; the shipped one is for the paper's law, and of others only what no law allows is asked."""
    return _ANY if plausible is PLAUSIBLE and not law.is_paper else plausible


def _groups_and_known(observations: Observations, beliefs: Beliefs) -> dict[str, Any]:
    """Groups and known values, where there are any, as the provenance keeps them."""
    groups = [group.name for group in observations.groups]
    known = {name: (value, deviation) for name, value, deviation in beliefs}
    return ({"groups": groups} if groups else {}) | ({"known": known} if known else {})


def _apart(share: Sequence[str], sets: Sequence[Data]) -> tuple[str, ...]:
    """What data sets do not share: nothing, c_e or alpha."""
    refuse(
        not {*share} <= {"c_e", "alpha"} or not share,
        f"share must be ('c_e', 'alpha'), ('c_e',) or ('alpha',), and for none fit the sets apart: got {share!r}",
    )
    apart = tuple({"c_e", "alpha"} - {*share})
    of_own = [x for x in sets if not ("alpha" in apart and isinstance(x, Indentation))]
    refuse(
        apart and len(of_own) < 2,
        f"share={tuple(share)} is for two data sets or more that tell {' and '.join(apart)}: got {len(of_own)}",
    )
    refuse(
        "c_e" in apart
        and any(isinstance(x, VelocityCurve) and "overloaded" in (x.status or ()) for x in sets),
        "overloaded runs bound one c_e: leave them out where data sets have one each",
    )
    return apart


def _box(likelihood: Likelihood, bounds: Bounds) -> Box:
    """The bounds of the search; alpha's reach over the best alphas of the first decade of c_e."""
    box = bounds_of(likelihood.observations, bounds)
    if "alpha" in bounds:
        return box
    alphas = likelihood.at(np.geomspace(box.lower[0], min(10 * box.lower[0], box.upper[0]), 20)).best_alpha
    return Box(
        (box.lower[0], min(box.lower[1], float(alphas.min()) / 3)),
        (box.upper[0], max(box.upper[1], 3 * float(alphas.max()))),
    )


def _sets(data: Data | Sequence[Data]) -> tuple[Data, ...]:
    sets = tuple(data) if isinstance(data, (list, tuple)) else (data,)
    for data_set in sets:
        if not isinstance(data_set, (VelocityCurve, Indentation, DepthTrace)):
            way = f"from_csv({data_set if isinstance(data_set, str) else 'data.csv'!r})"
            raise TypeError(
                "data must be a VelocityCurve, Indentation or DepthTrace or several of them, such as "
                f"VelocityCurve.{'from_dataframe(frame)' if hasattr(data_set, 'keys') else way}, got {shown(data_set)}"
            )
    refuse(not sets, "data must hold at least one data set: got none")
    return sets


def _engine(engine: str | VoxelEngine) -> VoxelEngine | None:
    """The voxel engine, if one is asked for."""
    refuse(
        not isinstance(engine, VoxelEngine) and engine not in get_args(Engine),
        f"engine must be one of {', '.join(get_args(Engine))}: got {engine!r}",
    )
    if isinstance(engine, VoxelEngine):
        return engine
    return VoxelEngine() if engine == "voxel" else None


def _check(burr: object, residuals: str, voxels: VoxelEngine | None) -> None:
    if burr is not None:
        require_type("burr", burr, Burr, "Burr(3.0)")
    refuse(
        residuals not in get_args(ResidualKind),
        f"residuals must be one of {', '.join(get_args(ResidualKind))}: got {residuals!r}",
    )
    refuse(
        residuals == "student" and voxels is not None,
        "residuals 'student' are for the mean-field engine: got the voxel engine",
    )


def _around(beliefs: Beliefs) -> Bounds:
    """Bounds at eight standard deviations of what is known."""
    reach = {name: (value, float(np.exp(max(8 * deviation, 0.01)))) for name, value, deviation in beliefs}
    return {name: (value / factor, value * factor) for name, (value, factor) in reach.items()}


def _likelihood_kind(
    observations: Observations,
    residuals: ResidualKind,
    mixed: bool,
    voxels: VoxelEngine | None,
    offsets: set[str],
) -> LikelihoodKind:
    """What residuals are of; ValueError where the rows do not go with it, or rows and offsets not with the engine."""
    refuse(
        mixed and residuals not in ("relative", "sigma"),
        "residuals must be 'relative' or 'sigma' with groups, offsets or known values, or groups=() leave them out: got "
        f"{residuals!r}",
    )
    refuse(
        mixed and observations.slow.size,
        "runs that were too slow go without groups, offsets and known values: leave out these, by groups=(), or the runs",
    )
    refuse(
        residuals == "sigma" and not observations.has_sigma,
        "residuals 'sigma' need a sigma in every row that has a velocity",
    )
    if voxels is not None:
        refuse(observations.slow.size, "runs that were too slow need the mean-field engine")
        lengths = offsets & {"surface", "radius"}
        refuse(lengths, f"the voxel engine takes offsets of force alone: got {min(lengths, default='')}")
    return "log-sigma" if mixed and residuals == "sigma" else residuals


def _beliefs(known: Mapping[str, float | tuple[float, float]] | None) -> Beliefs:
    """Name, value and relative standard deviation of what is known; ValueError unless a dict of positive numbers."""
    refuse(
        not isinstance(known, (dict, type(None))),
        f"known must be a dict such as {{'c_e': (2.1, 0.1)}}, got {shown(known)}",
        TypeError,
    )
    beliefs = []
    for name, pair in (known or {}).items():
        refuse(
            name not in PLAUSIBLE,
            f"known may hold 'c_e' and 'alpha' alone: got {name!r}{nearest(name, PLAUSIBLE)}",
        )
        numbers = np.atleast_1d(real(pair, f"known {name}"))
        refuse(
            numbers.shape not in ((1,), (2,)) or not ((numbers > 0) & (numbers < np.inf)).all(),
            f"known {name} must be a value, or a value and its standard deviation, above 0: got {shown(pair)}",
        )
        deviation = numbers[1] / numbers[0] if len(numbers) == 2 else _EXACT
        beliefs.append((name, float(numbers[0]), float(deviation)))
    return tuple(beliefs)


def _check_ranges(name: str, ranges: Bounds | None) -> None:
    """Refuse `bounds` or `plausible` unless None or a dict of positive pairs for c_e and alpha."""
    refuse(
        not isinstance(ranges, (dict, type(None))),
        f"{name} must be a dict such as {{'c_e': (1, 3)}}, got {shown(ranges)}",
        TypeError,
    )
    for key, pair in (ranges or {}).items():
        refuse(
            key not in PLAUSIBLE,
            f"{name} may hold 'c_e' and 'alpha' alone: got {key!r}{nearest(key, PLAUSIBLE)}",
        )
        ends = real(pair, f"{name} of {key}")
        refuse(
            ends.shape != (2,) or not 0 < ends[0] < ends[1] < np.inf,
            f"{name} of {key} must be two finite numbers 0 < low < high: got {shown(pair)}",
        )


def _searched(
    likelihood: Likelihood, domain: Domain, box: Box, begin: tuple[str, Point] | None = None
) -> tuple[tuple[Start, ...], float]:
    """The walk's best point, and nlopt's ends from it and from equally good minima.

    The second value is by how much -2 log L at the best end lies below the walk's lowest.
    """
    within = domain.within(box)
    lowest_points = minima(likelihood, within)
    if not lowest_points:
        return (), 0.0
    best = at_ridge(likelihood, within, lowest_points[0])
    end = best.point
    origin, begun_at = begin or ("walk along c_e", end)
    walk = Start(origin, begun_at, end, likelihood.objective(*end), "SUCCESS", best.evaluations)
    ends = [walk]
    for point in (end, *(minimum.point for minimum in ([] if likelihood.uneven else lowest_points[1:]))):
        if equally_good(likelihood.objective(*point), walk, len(likelihood.observations)):
            ends.append(minimise(likelihood.objective, box, point, origin=f"BOBYQA {len(ends)}"))
    lowest = min(float(likelihood.at(minimum.end[0]).minus2(minimum.end[1])[0]) for minimum in ends)
    missed = lowest_points[0].minus2 - lowest
    return tuple(ends), 0.0 if likelihood.uneven and missed < _STEPS else missed


def _searched_mixed(
    plain: Likelihood, components: Sequence[Component], begin: Point, box: Box, bounds: Bounds
) -> tuple[MixedLikelihood, Domain, Box, tuple[Start, ...], float]:
    """The likelihood at the effects' best variances, the range and box of its walk, and what `_searched` finds.

    The variances are sought where rows are linear. Where the walk ends far from there, they are sought again from its
    end; if they are no better, rows of specimens become linear about that end.
    """
    ends = box.lower[0], box.upper[0]
    likelihood, at = at_best_variances(plain, components, begin, ends)
    for turn in range(_TURNS):
        box = _box(likelihood, bounds)  # offsets move the bounds that windows set
        domain, box = Domain.of(likelihood, box, bounds), likelihood.with_windows(box)
        searches, missed = _searched(likelihood, domain, box, ("at the effects' variances", at))
        if searches or not turn:
            found = likelihood, domain, box, searches, missed
        if not searches or likelihood.near(searches[0].end):
            break
        before, at = likelihood, searches[0].end
        other, there = at_best_variances(plain, components, at, ends)
        if turn < _TURNS - 1 and other.equations.criterion() < before.equations.criterion() - FLAT:
            likelihood, at = other, there
        elif (likelihood := before.centred(at)) is before:
            break
    else:
        found = likelihood, *found[1:]
    return found


def minimise(
    objective: Callable[[float, float], float], box: Box, start: tuple[float, float], *, origin: str
) -> Start:
    """nlopt's BOBYQA over (log c_e, log alpha), from a point of the walk.

    Parameters
    ----------
    objective : callable
        Function of c_e [N/mm^2] and alpha [1/ms]; a value that is not finite counts as worse than all others.
    box : Box
        Bounds.
    start : (float, float)
        c_e [N/mm^2] and alpha [1/ms] to begin at.
    origin : str
        Name of the search in the result.

    Returns
    -------
    Start
        The best point evaluated, wherever the algorithm ended.

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
        height, evaluations = float(objective(c_e, alpha)), evaluations + 1
        if not np.isfinite(height):  # nlopt "succeeds" on NaN
            return 10.0 * worst
        worst = max(worst, height)
        best = min(best, (height, (c_e, alpha)))  # nlopt can lose the best point
        return height

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


def _weighed(
    likelihood: Likelihood,
    domain: Domain,
    best: tuple[float, float],
    table: VoxelTable | None,
    data: Sequence[Data],
    bounds: Bounds,
    plausible: Bounds | None,
    hit: str,
    lack: HypothesisTest | None,
) -> Evidence:
    """The evidence at a fit.

    Parameters
    ----------
    likelihood : Likelihood
    domain : Domain
        Range of the intervals.
    best : (float, float)
        c_e [N/mm^2], alpha [1/ms].
    table : VoxelTable or None
        The voxel engine's table.
    data : sequence of data sets
    bounds : dict
        Given bounds.
    plausible : dict or None
        Plausible range of c_e and alpha.
    hit : str
        Sentence on the bound that the fit ended at, or empty.
    lack : HypothesisTest or None
        The test of lack of fit.
    """
    o = likelihood.observations
    exponent = likelihood.model.law.ridge_exponent
    total, scatters, shares = likelihood.information(*best)
    calibration = likelihood.calibration(*best)
    profiled = profile(likelihood, calibration, domain, best, exponent)
    if table is not None:
        c_e_open = profiled.intervals["c_e"]["95"].upper is None
        calibration = replace(calibration, monte_carlo=monte_carlo_share(likelihood, table, best, c_e_open))
        profiled = profile(likelihood, calibration, domain, best, exponent)
    known = belief_tests(likelihood)
    fits, unscaled = goodness(likelihood, best, lack, known + against_indentation(likelihood, best)), None
    if fits.inflation > 1:
        unscaled, calibration = profiled.intervals, replace(calibration, inflation=fits.inflation)
        profiled = profile(likelihood, calibration, domain, best, exponent)
    intervals, better = profiled.intervals, None
    if profiled.base < float(likelihood.at(best[0]).minus2(best[1])[0]) - FLAT:
        lowest = int(np.argmin(profiled.c_e_rise))
        better = (float(profiled.c_e[lowest]), float(profiled.best_alpha[lowest]))
    likely = None if plausible is None else plausibility(
        likelihood, calibration, profiled.base, best, plausible,
        not (fits.poor or at_windows(intervals["c_e"]["95"], o.c_e_floor)),
    )  # fmt: skip
    rows = influence(likelihood, best, data, bounds, every=False)
    mixed = MixedEvidence.of(likelihood, best) if isinstance(likelihood, MixedLikelihood) else None
    evidence = Evidence(
        likelihood.log_likelihood(*best),
        total,
        scatters,
        shares,
        calibration.monte_carlo,
        profiled,
        ridge_of(likelihood, exponent, best, profiled),
        "",
        better,
        fits,
        unscaled,
        likely,
        rows,
        mixed,
    )
    status = evidence.doubt[0] if evidence.doubt else "at-bound" if hit else ""
    effects = mixed.effects if mixed else ()
    texts = (
        fits.sentence,
        hit,
        *doubts(likely, o, rows),
        "Try residuals='student', which bear them."
        if rows and likelihood.kind == "relative" and mixed is None and not o.slow.size
        else "",
        *(
            test.sentence
            for test in against_order(order_tests(likelihood, best) if of_groups_alone(effects) else [])
        ),
        *silent_groups(o, effects),
        *(test.sentence for test in known if test.sentence not in fits.sentence),
        sentence(o, intervals["c_e"]["95"], intervals["alpha"]["95"], profiled.identified, status),
        what_opens(likelihood, domain, best, exponent) if intervals["c_e"]["95"].upper is None else "",
        *effect_sentences(likelihood, effects, calibration, profiled.identified),
        next_law(likelihood, fits.poor),
    )
    return replace(evidence, verdict=" ".join(text for text in texts if text))


def _described(likelihood: Likelihood, best: tuple[float, float], usable: bool) -> dict[str, Any]:
    """Predictions, residuals and tests at the fit, as fields of a `Fit`; NaN and None if the fit failed."""
    o = likelihood.observations
    c_e, alpha = best if usable else (np.nan, np.nan)
    unit = likelihood.model.unit(c_e) if usable else np.full(len(o.force), np.nan)
    predicted = {"velocity": alpha * unit * np.exp(likelihood.own_alpha), "pressed": c_e * o.pressed_unit}
    residuals = {name: np.log(getattr(o, name) / model) for name, model in predicted.items()}
    if likelihood.known or not likelihood.log:
        residuals["velocity"] = likelihood.velocity_residuals(unit * np.exp(likelihood.own_alpha), alpha)
    if likelihood.pressed_known:
        residuals["pressed"] = o.pressed_residuals(c_e, True)
    r = np.concatenate([residuals[kind][rows] for kind, rows in o.rows])
    chi2 = (
        float(np.sum(((o.velocity - predicted["velocity"]) / o.sigma) ** 2) / (len(o.force) - 2))
        if o.has_sigma and usable
        else None
    )
    return {
        "predicted": np.concatenate([predicted[kind][rows] for kind, rows in o.rows]),
        "residuals": r,
        "residual_norm": float(np.sqrt(np.mean(r**2))),
        "chi2_reduced": chi2,
        "n_points": len(o),
        "n_skipped": o.n_skipped,
        "n_censored": o.n_censored,
        "fall": fall_with_depth(likelihood, unit) if usable else None,
    }
