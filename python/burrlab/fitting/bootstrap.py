"""The bootstrap: fits to data sets like the one measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from burrlab._core import Shape
from burrlab.common.check import refuse, seed_or_new, whole
from burrlab.common.progress import Progress, counter
from burrlab.common.study import StorePath, run_items
from burrlab.common.table import by_value
from burrlab.fitting.group_effects import MixedEvidence
from burrlab.fitting.likelihood import Beliefs, Likelihood, LikelihoodKind, MeanFieldModel
from burrlab.fitting.linear import OFFSETS
from burrlab.fitting.mixed import MixedLikelihood, fitted_again
from burrlab.fitting.observations import Box, Floats, Group, Observations, ResidualKind, Rows
from burrlab.fitting.profile import (
    BEYOND,
    LEVELS,
    ByLevel,
    ByName,
    ConfidenceInterval,
    Domain,
    lowest,
    minima,
)
from burrlab.fitting.record import FitRecord
from burrlab.fitting.slices import FREEDOM
from burrlab.fitting.verdict import span
from burrlab.fitting.voxel import VoxelTable, model_of

KINDS = ("parametric", "residual", "groups")
FEWEST_GROUPS = 6  # levels of a group that are drawn whole: with fewer, too many sets are alike


@dataclass(frozen=True)
class BootstrapItem:
    """One replicate: small, picklable and self-contained."""

    observations: Observations
    shape: Shape
    residual_kind: ResidualKind
    table: VoxelTable | None
    box: Box
    given_bounds: tuple[str, ...]
    c_e: float
    alpha: float
    scatters: tuple[tuple[str, float, float], ...]  # name, value, inflation of the residuals
    kind: str
    seed: int
    replicate: int


@lru_cache(maxsize=4)
def _fitted(
    o: Observations,
    kind: ResidualKind,
    shape: str,
    table: VoxelTable | None,
    box: Box,
    bounded_names: tuple[str, ...],
) -> tuple[Likelihood, Domain]:
    """The likelihood and domain of all replicates; made anew for each they took a fifth of its time."""
    fitted = Likelihood(o, kind, model_of(o, Shape(shape), table))
    return fitted, Domain.of(fitted, box, bounded_names)


def replicate(item: BootstrapItem) -> tuple[float, float]:
    """c_e [N/mm^2] and alpha [1/ms] fitted to data made from the fit and its scatter."""
    o = item.observations
    fitted, domain = _fitted(o, item.residual_kind, item.shape.name, item.table, item.box, item.given_bounds)
    unit = fitted.model.unit(item.c_e)
    random = np.random.default_rng([item.seed, item.replicate])
    scatter = {name: (value, inflation) for name, value, inflation in item.scatters}

    def drawn(name: str, residuals: Floats) -> Floats:
        value, inflation = scatter[name]
        if item.kind == "parametric":
            n, student = len(residuals), item.residual_kind == "student"
            return value * (random.standard_t(FREEDOM, n) if student else random.standard_normal(n))
        centred = residuals - residuals.mean()
        if name == "segments":  # each run's mean is subtracted twice: here and in _of_rows
            centred = centred * np.sqrt(len(residuals) / fitted.n_within)
        return inflation * random.choice(centred, len(residuals))

    ends = drawn("velocity", fitted.velocity_residuals(unit, item.alpha))
    v = item.alpha * unit
    if fitted.log:
        within = drawn("segments", fitted.within_residuals(unit)) if fitted.n_within else np.empty(0)
        v = v * np.exp(_of_rows(o, ends, within, fitted.run_scatter))
    else:
        v = v + ends * (o.sigma if fitted.known else 1.0)
    pressed = item.c_e * o.pressed_unit
    if len(pressed):
        r = drawn("force", o.pressed_residuals(item.c_e, fitted.pressed_known))
        pressed = pressed + r * o.pressed_sigma if fitted.pressed_known else pressed * np.exp(r)
    return lowest(fitted.of_rows(replace(o, velocity=v, pressed=pressed), fitted.model), domain).point


def _of_rows(o: Observations, ends: Floats, within: Floats, scatter: Floats) -> Floats:
    """Deviation of each row's log velocity; of a segment its run's, plus its own, which has mean 0 over the run.

    `ends` are the deviations of curves' rows, then of runs. `within` is in units of `scatter`, the relative scatter
    of each run.
    """
    single = o.run < 0
    log, begin, n = np.zeros(len(single)), 0, int(single.sum())
    log[single] = ends[:n]
    for i, mean in enumerate(ends[n:]):
        rows = np.flatnonzero(o.run == i)
        deviations = within[begin : begin + len(rows)]
        log[rows] = mean + scatter[i] * (deviations - deviations.mean())
        begin += len(rows)
    return log


@dataclass(frozen=True)
class MixedItem:
    """One replicate of a fit with groups or offsets."""

    observations: Observations
    shape: Shape
    residual_kind: LikelihoodKind
    beliefs: Beliefs
    evidence: MixedEvidence
    c_e: float
    alpha: float
    group: str  # whose levels are drawn; empty draws effects
    seed: int
    replicate: int


def mixed_replicate(item: MixedItem) -> tuple[float, float]:
    """c_e [N/mm^2] and alpha [1/ms] fitted to a set with other effects, offsets and scatter, or with other levels."""
    point, random = (item.c_e, item.alpha), np.random.default_rng([item.seed, item.replicate])
    o = item.observations
    plain = Likelihood(o, item.residual_kind, MeanFieldModel(o, item.shape), item.beliefs)
    fitted = item.evidence.likelihood(plain, point)
    told = {x.quantity: x.values for x in item.evidence.effects if x.deviation is None}
    redrawn = _redrawn_levels(item, random) if item.group else redrawn_effects(o, fitted, point, told, random)
    beliefs = tuple(
        (name, getattr(item, name) * float(np.exp(deviation * random.standard_normal())), deviation)
        for name, _, deviation in item.beliefs
    )
    rows = Likelihood(redrawn, item.residual_kind, MeanFieldModel(redrawn, item.shape), beliefs)
    components = [component.of_rows(redrawn) for component in fitted.components]
    again, domain, end = fitted_again(rows, components, point)
    places = minima(again, domain)
    return places[0].point if places else end


def redrawn_effects(
    o: Observations, fitted: MixedLikelihood, point: tuple[float, float], told: Mapping[str, Sequence[float]],
    random: np.random.Generator,
) -> Observations:  # fmt: skip
    """The same runs with other effects, offsets and scatter; runs without a window then are left out.

    Parameters
    ----------
    o : Observations
        The rows, as they were measured.
    fitted : MixedLikelihood
        Of these rows: its components, and its variances.
    point : (c_e, alpha)
        The truth [N/mm^2], [1/ms].
    told : mapping
        Values of what the data shall tell, by quantity; these are not drawn.
    """
    true = o
    log_c_e, log_alpha, log_pressed = np.zeros(len(o.force)), np.zeros(len(o.force)), np.zeros(len(o.pressed))
    for x, variance in zip(fitted.components, fitted.equations.effect2.tolist(), strict=True):
        drawn = told[x.quantity] if x.sought else variance**0.5 * random.standard_normal(len(x.group.levels))
        u = np.append(drawn, 0.0)  # a level of -1 has no effect
        if x.quantity in OFFSETS:
            true = true.moved(x.quantity, u[x.group.velocity], u[x.group.pressed])
        elif x.quantity == "c_e":
            log_c_e, log_pressed = log_c_e + u[x.group.velocity], log_pressed + u[x.group.pressed]
        else:
            log_alpha = log_alpha + (
                u[0] * o.order(x.restarts) if x.quantity == "order" else u[x.group.velocity]
            )
    values, places = np.unique(log_c_e, return_inverse=True)
    unit = MeanFieldModel(true, fitted.model.shape).unit(point[0] * np.exp(values))[
        places, np.arange(len(o.force))
    ]
    scatter = dict(
        zip([rows.name for rows in fitted.linear.rows], np.sqrt(fitted.equations.scatter2), strict=True)
    )
    ends = scatter["velocity"] * random.standard_normal(fitted.n)
    n_segments = fitted.n_within + len(set(o.run[o.run >= 0]))
    within = scatter["segments"] * random.standard_normal(n_segments) if n_segments else np.empty(0)
    log = _of_rows(o, ends, within, fitted.run_scatter)
    log *= o.sigma / o.velocity if fitted.known else 1.0
    velocity = point[1] * unit * np.exp(log_alpha + log)
    pressed = point[0] * true.pressed_unit * np.exp(log_pressed)
    if len(pressed):
        z = scatter["force"] * random.standard_normal(len(pressed))
        pressed = pressed + z * o.pressed_sigma if fitted.pressed_known else pressed * np.exp(z)
    keep = np.isfinite(velocity)
    return replace(o, velocity=np.where(keep, velocity, 1.0), pressed=pressed).kept(keep)


def _redrawn_levels(item: MixedItem, random: np.random.Generator) -> Observations:
    """The rows of as many levels of a group, drawn with replacement; each draw is a level of its own."""
    o = item.observations
    group = o.by_name[item.group]
    draws = random.integers(0, len(group.levels), len(group.levels))

    def taken(places: Rows) -> tuple[Rows, Rows]:
        rows = [np.flatnonzero(places == level) for level in draws]
        return np.concatenate(rows), np.repeat(np.arange(len(draws)), [len(part) for part in rows])

    (velocity, copy), (pressed, copy_pressed) = taken(group.velocity), taken(group.pressed)
    groups = []
    for other in o.groups:
        # where each level lies in one of the group's, it comes with it
        nested = len(other.pairs(group)) == len(other.levels)
        keys = np.concatenate([other.velocity[velocity], other.pressed[pressed]])
        keys = keys + nested * len(other.levels) * np.concatenate([copy, copy_pressed])
        labels, place = np.unique(keys, return_inverse=True)
        groups.append(
            Group(other.name, tuple(map(str, labels)), place[: len(velocity)], place[len(velocity) :])
        )
    runs = o.run[velocity]
    number = np.unique(runs + (1 + runs.max(initial=0)) * copy, return_inverse=True)[1]
    number = np.unique(np.where(runs < 0, -1, number), return_inverse=True)[1] - bool((runs < 0).any())
    return o.taken(velocity, pressed, run=number, groups=tuple(groups))


@by_value
@dataclass(frozen=True, repr=False)
class Bootstrap:
    """Fits to replicates of the data.

    Attributes
    ----------
    c_e, alpha : ndarray, shape (n,)
        Fitted values [N/mm^2], [1/ms], by replicate; infinite where the fit lies on the ridge, which gives
        no upper limit.
    combination : ndarray, shape (n,)
        alpha/c_e^exponent, with the exponent of the fit's best-determined combination.
    exponent : float
    kind : str
        ``"parametric"``, ``"residual"`` or ``"groups"``.
    seed : int
        Replicate k depends on (seed, k) and the data alone.
    """

    c_e: Floats
    alpha: Floats
    combination: Floats
    exponent: float
    kind: str
    seed: int

    @property
    def intervals(self) -> Mapping[str, Mapping[str, ConfidenceInterval]]:
        """``c_e``, ``alpha``, ``combination`` -> level -> percentile interval; None is open."""
        intervals = ByName()
        for name in ("c_e", "alpha", "combination"):
            values, intervals[name] = np.sort(getattr(self, name)), ByLevel()
            for level, p in LEVELS.items():
                places = np.round(np.array([0.5 - p / 2, 0.5 + p / 2]) * (len(values) - 1)).astype(int)
                intervals[name][level] = ConfidenceInterval(
                    *(float(end) if np.isfinite(end) else None for end in values[places])
                )
        return intervals

    @property
    def on_ridge(self) -> float:
        """Fraction of the replicates whose fit lies on the ridge."""
        return float(np.mean(np.isinf(self.c_e)))

    def __repr__(self) -> str:
        ends = ", ".join(
            f"{name} {span(levels['95']).replace(' to ', '..')}"
            for name, levels in self.intervals.items()
            if name != "combination"
        )
        return (
            f"Bootstrap({self.kind}, {len(self.c_e)} replicates, seed {self.seed}: 95 % percentiles {ends}; "
            f"{100 * self.on_ridge:.3g} % on the ridge)"
        )


def run_fits(
    function: Callable[[Any], Any],
    items: Sequence[Any],
    executor: Executor | None,
    store: StorePath | None,
    progress: Progress | None,
) -> Floats:
    """The results of a function of every item, a row each."""
    # a fit holds the interpreter: more threads than one only wait
    with nullcontext(executor) if executor is not None else ThreadPoolExecutor(1) as workers:
        return np.array(
            run_items(function, items, executor=workers, store=store, progress=counter(progress, "fits"))
        )


def bootstrap(
    fit: FitRecord,
    n: int = 1000,
    *,
    kind: str = "parametric",
    seed: int | None = None,
    executor: Executor | None = None,
    store: StorePath | None = None,
    progress: Progress | None = None,
) -> Bootstrap:
    """Fits to n data sets made from a fit.

    Parameters
    ----------
    fit : FitRecord
    n : int
        Number of replicates.
    kind : {"parametric", "residual", "groups"}
        Draws the scatter from normal distributions, and with it the effects of days and specimens and given offsets;
        or with replacement from the fit's residuals, centred and enlarged by sqrt(n/(n - p)), p the number of
        parameters fitted; or whole specimens (or days) with replacement, of which six are needed.
    seed : int, optional
        None draws one, which the result records.
    executor : concurrent.futures.Executor, optional
        One thread by default, because a fit holds the GIL; a process pool is faster.
    store : Store or path, optional
        Keeps every replicate, so that an interrupted study resumes.
    progress : callable or True, optional
        Called with the fraction done, 0 to 1; True shows a bar on standard error.

    Returns
    -------
    Bootstrap

    Raises
    ------
    ValueError
        If n is below 2, the kind is unknown, a store is given without a seed, or the fit failed.
    StudyInterrupted
        If the executor dies.

    Notes
    -----
    Forces, windows and censored runs stay as they are. The intervals are percentiles. Along a ridge, where
    the c_e of a replicate is arbitrary, prefer the intervals of the profile likelihood.

    References
    ----------
    Davison and Hinkley, Bootstrap Methods and their Application, Cambridge 1997, section 6.3.
    """
    refuse(whole("n", n, 2**31, "2^31") < 2, f"n must be at least 2: got {n!r}")
    refuse(kind not in KINDS, f"kind must be one of {', '.join(KINDS)}: got {kind!r}")
    refuse(
        seed is None and store is not None, "a store needs a seed, for it finds results by it: got seed None"
    )
    evidence = fit._evidence()
    sizes = {x.group: len(x.levels) for x in fit.effects if x.interval is not None}
    group = max(sizes, key=lambda name: sizes[name], default="") if kind == "groups" else ""
    refuse(
        kind == "groups" and sizes.get(group, 0) < FEWEST_GROUPS,
        f"kind 'groups' needs a fit with {FEWEST_GROUPS} days or specimens or more: got {sizes.get(group, 0)}",
    )
    mixed = evidence.mixed
    refuse(
        mixed is not None and (kind == "residual" or fit.table is not None),
        "with groups, offsets or known values a bootstrap is 'parametric' or of 'groups', and of the mean field",
    )
    exponent = evidence.profile.identified.exponent
    seed = seed_or_new(seed)
    o = fit.observations
    if mixed is not None:
        plain = fit._plain
        ends = run_fits(mixed_replicate, [
            MixedItem(o, fit.shape, plain.kind, plain.beliefs, mixed, fit.c_e, fit.alpha, group, seed, k)
            for k in range(n)
        ], executor, store, progress)  # fmt: skip
    else:
        box = Box(*zip(fit.bounds["c_e"], fit.bounds["alpha"], strict=True))
        scatters = tuple(
            (s.name, s.value, float(np.sqrt(s.n / max(s.n - s.parameters, 0.5)))) for s in evidence.scatters
        )
        ends = run_fits(replicate, [
            BootstrapItem(
                o, fit.shape, fit.residual_kind, fit.table, box, fit.given_bounds, fit.c_e, fit.alpha, scatters,
                kind, seed, k,
            )
            for k in range(n)
        ], executor, store, progress)  # fmt: skip

    # an indentation determines c_e on the ridge too, and an overloaded run ends the ridge
    endless = not len(o.pressed) and np.isinf(o.ceiling)
    # data that close c_e's interval tell c_e beyond the ridge's beginning, where v is a power law but for some per cent
    entry = float(o.ridge_entries().max()) * (BEYOND if evidence.ridge.excluded else 1.0)
    on_ridge = ends[:, 0] > (entry if endless else np.inf)
    c_e, alpha = (np.where(on_ridge, np.inf, column) for column in ends.T)
    return Bootstrap(c_e, alpha, ends[:, 1] / ends[:, 0] ** exponent, exponent, kind, seed)
