"""Coverage: how often the intervals of a fit hold the truth, by synthetic data sets of one experiment."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from burrlab._core import Material, Shape
from burrlab.arguments import require_type
from burrlab.fitting.calibration import Calibration
from burrlab.fitting.coverage_result import QUANTITIES, Coverage
from burrlab.fitting.experiment import Experiment
from burrlab.fitting.intervals import LEVELS, Interval
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.mean_field import MeanFieldModel
from burrlab.fitting.observations import Floats, Observations, bounds_of
from burrlab.fitting.profile import Domain, best_point, profile
from burrlab.fitting.verdict import separately_identified
from burrlab.provenance import provenance
from burrlab.store import StorePath
from burrlab.study import run_items

_CHUNK = 25  # data sets a submission: one takes milliseconds


@dataclass(frozen=True)
class CoverageItem:
    """One data set: small, picklable, and a function of itself alone."""

    experiment: Experiment
    c_e: float
    alpha: float
    shape: str
    scatter: float
    static_scatter: float
    seed: int
    replicate: int


@lru_cache(maxsize=8)
def _template(experiment: Experiment, shape: str) -> tuple[Observations, MeanFieldModel]:
    o = experiment.observations()
    return o, MeanFieldModel(o, Shape(shape))


def replicate(item: CoverageItem) -> Floats:
    """What the fit to one synthetic data set says about the truth.

    Returns
    -------
    ndarray, shape (25,)
        Interval ends by quantity, level and side, 0 and infinite where open; exponent of the combination; rises
        of -2 log L at the true c_e and at the true (c_e, alpha); the joint region's limits by level; 1 if
        separately identified.
    """
    o, model = _template(item.experiment, item.shape)
    z = np.random.default_rng([item.seed, item.replicate]).standard_normal(len(o))
    n = len(o.force)
    velocity = item.alpha * model.unit(item.c_e) * np.exp(item.scatter * z[:n])
    pressed = item.c_e * o.pressed_unit * np.exp(item.static_scatter * z[n:])
    drawn = o.with_outcomes(velocity, pressed)
    likelihood = Likelihood(drawn, "relative", model)
    domain = Domain.of(likelihood, bounds_of(drawn, None), {})
    best = best_point(likelihood, domain)
    total, scatters, shares = likelihood.information(*best)
    calibration = Calibration(scatters, total, shares)
    found = profile(likelihood, calibration, domain, best, 4 * (Shape(item.shape).order + 1) / 3)
    tables = (found.intervals["c_e"], found.intervals["alpha"], found.identified.intervals)
    ends = [_ends(table[level]) for table in tables for level in LEVELS]
    at = likelihood.at(item.c_e)
    rises = [float(at.profile[0]) - found.base, float(at.minus2(item.alpha)[0]) - found.base]
    limits = [calibration.limit(level) for level in LEVELS.values()]
    apart = float(separately_identified(found.intervals["c_e"]["95"]))
    return np.concatenate([np.ravel(ends), [found.identified.exponent], rises, limits, [apart]])


def _ends(interval: Interval) -> tuple[float, float]:
    lower, upper = interval.lower, interval.upper
    return 0.0 if lower is None else lower, np.inf if upper is None else upper


def coverage_study(
    experiment: Experiment,
    material: Material,
    *,
    n: int = 2000,
    scatter: float = 0.08,
    static_scatter: float = 0.1,
    seed: int | None = None,
    executor: Executor | None = None,
    store: StorePath | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Coverage:
    """Fits to synthetic data sets of an experiment, and how often their intervals hold the truth.

        v = alpha R Psi(F/(c_e R^2)) exp(scatter z),   F_static = c_e R^2 (h/R)^(3/2) exp(static_scatter z)

    Parameters
    ----------
    experiment : Experiment
        Radii, forces, depths and repeats.
    material : Material
        The truth: c_e [N/mm^2], alpha [1/ms] and erosion shape. The fits know the shape.
    n : int
        Data sets.
    scatter, static_scatter : float
        Standard deviation of ln v and of ln F; 0.08 is 8 %.
    seed : int, optional
        None draws one, which the result records. Data set k depends on (seed, k) alone.
    executor : concurrent.futures.Executor, optional
        Threads over the cores by default; a process pool is faster, for a fit holds the interpreter.
    store : Store or path, optional
        Keeps every data set's outcome, so that an interrupted study goes on where it stopped.
    progress : callable, optional
        Called with (data sets done, n).

    Returns
    -------
    Coverage

    Raises
    ------
    TypeError
        If the experiment or material is something else.
    ValueError
        If n is below 1, a scatter is not positive and finite, a force leaves no window in the material, or the
        experiment has fewer than three distinct forces.
    StudyInterrupted
        If the executor dies.

    Notes
    -----
    The intervals are those of `burrlab.fit`, whose search is replaced by the walk along c_e: some milliseconds
    a data set.

    Examples
    --------
    >>> import burrlab
    >>> wide = burrlab.Experiment([(3.0, [0.3, 0.6, 1.2, 2.4], 3)])
    >>> study = burrlab.coverage_study(wide, burrlab.materials["bone"], n=20, seed=1)
    >>> len(study), study.open_above("c_e").k
    (20, 0)
    """
    require_type("experiment", experiment, Experiment, "Experiment([(3.0, [0.5, 1.0, 2.0], 3)])")
    require_type("material", material, Material, 'burrlab.materials["bone"]')
    if n < 1:
        raise ValueError(f"n must be at least 1: got {n!r}")
    for name, value in (("scatter", scatter), ("static_scatter", static_scatter)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name} must be positive and finite: got {value!r}")
    seed = secrets.randbits(32) if seed is None else int(seed)
    o, model = _template(experiment, material.shape.name)
    lost = ~np.isfinite(model.unit(material.c_e))
    if lost.any():
        raise ValueError(
            f"every force must leave a window, below 0.1925 c_e R^2 = "
            f"{(material.c_e * o.radius[lost] ** 2 / 27**0.5)[0]:.3g} N: got {o.force[lost][0]:g} N"
        )
    items = [
        CoverageItem(
            experiment,
            material.c_e,
            material.alpha,
            material.shape.name,
            float(scatter),
            float(static_scatter),
            seed,
            k,
        )
        for k in range(n)
    ]
    outcomes = run_items(replicate, items, executor=executor, store=store, progress=progress, chunk=_CHUNK)
    columns = np.array(outcomes)
    ends = columns[:, :18].reshape(n, len(QUANTITIES), len(LEVELS), 2)
    return Coverage(
        experiment=experiment,
        material=material,
        scatter=float(scatter),
        static_scatter=float(static_scatter),
        seed=seed,
        lower=ends[..., 0],
        upper=ends[..., 1],
        exponent=columns[:, 18],
        rise=columns[:, 19:21],
        joint_limit=columns[:, 21:24],
        apart=columns[:, 24] == 1,
        provenance=provenance(
            experiment=repr(experiment),
            material=material.name,
            c_e=material.c_e,
            alpha=material.alpha,
            shape=material.shape.name,
            scatter=float(scatter),
            static_scatter=float(static_scatter),
            n=n,
            seed=seed,
        ),
    )
