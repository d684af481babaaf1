"""The bootstrap: fits to data sets like the one measured."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from burrlab._core import Shape
from burrlab.common.check import refuse, seed_or_new, whole
from burrlab.common.progress import Progress, counter
from burrlab.common.study import StorePath, run_items
from burrlab.common.table import by_value
from burrlab.fitting.likelihood import FREEDOM, Likelihood
from burrlab.fitting.observations import Box, Floats, Observations, ResidualKind
from burrlab.fitting.profile import LEVELS, ByLevel, ByName, Domain, Interval, lowest
from burrlab.fitting.record import FitRecord
from burrlab.fitting.verdict import span
from burrlab.fitting.voxel import VoxelTable, model_of

KINDS = ("parametric", "residual")


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
    """The likelihood and domain of all replicates."""
    fitted = Likelihood(o, kind, model_of(o, Shape(shape), table))
    return fitted, Domain.of(fitted, box, dict.fromkeys(bounded_names))


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
        if name == "segments":  # each run's mean is subtracted twice: here and in _runs
            centred = centred * np.sqrt(len(residuals) / fitted.n_within)
        return inflation * random.choice(centred, len(residuals))

    ends = drawn("velocity", fitted.velocity_residuals(unit, item.alpha))
    v = item.alpha * unit
    if fitted.log:
        single = o.run < 0
        log = np.zeros(len(v))
        log[single] = ends[: int(single.sum())]
        if fitted.n_within:
            within = drawn("segments", fitted.within_residuals(unit))
            log += _runs(o, ends[int(single.sum()) :], within, fitted.run_scatter)
        v = v * np.exp(log)
    else:
        v = v + ends * (o.sigma if fitted.known else 1.0)
    pressed = item.c_e * o.pressed_unit
    if len(pressed):
        r = drawn("force", fitted.pressed_residuals(item.c_e))
        pressed = pressed + r * o.pressed_sigma if fitted.pressed_known else pressed * np.exp(r)
    drawn_again = Likelihood(o.with_outcomes(v, pressed), item.residual_kind, fitted.model)
    return lowest(drawn_again, domain).point


def _runs(o: Observations, means: Floats, within: Floats, scatter: Floats) -> Floats:
    """Deviation of each segment's log velocity: its run's, plus its own, which has mean 0 over the run.

    `within` is in units of `scatter`, the relative scatter of each run.
    """
    log = np.zeros(len(o.force))
    begin = 0
    for i, mean in enumerate(means):
        rows = np.flatnonzero(o.run == i)
        deviations = within[begin : begin + len(rows)]
        log[rows] = mean + scatter[i] * (deviations - deviations.mean())
        begin += len(rows)
    return log


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
        ``"parametric"`` or ``"residual"``.
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
    def intervals(self) -> Mapping[str, Mapping[str, Interval]]:
        """``c_e``, ``alpha``, ``combination`` -> level -> percentile interval; None is open."""
        intervals = ByName()
        for name in ("c_e", "alpha", "combination"):
            values, intervals[name] = np.sort(getattr(self, name)), ByLevel()
            for level, p in LEVELS.items():
                places = np.round(np.array([0.5 - p / 2, 0.5 + p / 2]) * (len(values) - 1)).astype(int)
                ends = (float(end) if np.isfinite(end) else None for end in values[places])
                intervals[name][level] = Interval(*ends)
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
    kind : {"parametric", "residual"}
        Draws the scatter from normal distributions, or with replacement from the fit's residuals, centred
        and enlarged by sqrt(n/(n - p)), p the number of parameters fitted.
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
    refuse(
        evidence.mixed is not None,
        "a bootstrap draws runs, not groups or offsets: it needs a fit without, such as fit(data, groups=())",
    )
    identified = evidence.profile.identified
    seed = seed_or_new(seed)
    low, high = zip(*(fit.bounds[name] for name in ("c_e", "alpha")), strict=True)
    scatters = tuple(
        (s.name, s.value, float(np.sqrt(s.n / max(s.n - s.parameters, 0.5)))) for s in evidence.scatters
    )
    items = [
        BootstrapItem(
            fit.observations,
            fit.shape,
            fit.residual_kind,
            fit.table,
            Box((low[0], low[1]), (high[0], high[1])),
            fit.given_bounds,
            fit.c_e,
            fit.alpha,
            scatters,
            kind,
            seed,
            k,
        )
        for k in range(n)
    ]
    report_progress = counter(progress, "fits")
    # a fit holds the interpreter: more threads than one only wait
    with nullcontext(executor) if executor is not None else ThreadPoolExecutor(1) as workers:
        replicates = run_items(replicate, items, executor=workers, store=store, progress=report_progress)
    ends = np.array(replicates)
    combination = ends[:, 1] / ends[:, 0] ** identified.exponent
    # an indentation determines c_e on the ridge too, and an overloaded run ends the ridge
    o = fit.observations
    endless = not len(o.pressed) and np.isinf(o.ceiling)
    on_ridge = ends[:, 0] > (float(o.ridge_entries().max()) if endless else np.inf)
    c_e, alpha = (np.where(on_ridge, np.inf, column) for column in ends.T)
    return Bootstrap(c_e, alpha, combination, identified.exponent, kind, seed)
