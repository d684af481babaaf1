"""How often the intervals of a fit hold the truth, from synthetic data sets of one experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import lru_cache
from html import escape
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from burrlab._core import Material, Shape
from burrlab.common.check import real, refuse, require_type, scalar, seed_or_new, shown, whole
from burrlab.common.progress import Progress
from burrlab.common.provenance import provenance
from burrlab.common.study import LATER, StorePath, stored_as
from burrlab.common.table import html_rows
from burrlab.fitting.bootstrap import redrawn_effects, run_fits
from burrlab.fitting.likelihood import Likelihood, MeanFieldModel
from burrlab.fitting.linear import check_offsets, components_of
from burrlab.fitting.mixed import MixedLikelihood, fitted_again
from burrlab.fitting.observations import Data, Floats, Observations
from burrlab.fitting.profile import LEVELS, Domain, lowest, ranges
from burrlab.fitting.report import columns
from burrlab.fitting.verdict import obstacle
from burrlab.measured.curve import Indentation, VelocityCurve
from burrlab.theory.continuum import PAPER_FORCE_EXPONENT, WINDOW_STOP, Law

Series: TypeAlias = tuple[float, tuple[float, ...], int]  # radius [mm], forces [N] or depths [mm], repeats


@stored_as("burrlab.fitting.experiment.Experiment")
@dataclass(frozen=True)
class ExperimentPlan:
    """The measurements of one data set, without outcomes; small and picklable.

    Parameters
    ----------
    velocities : sequence of (radius, forces, repeats)
        Velocity-force curves over the default window: burr radius [mm], forces [N], runs per force.
    static : sequence of (radius, depths, repeats)
        Static indentations: burr radius [mm], depths [mm], readings per depth.

    Raises
    ------
    ValueError
        If a radius, force or depth is not positive and finite, a series is empty, or repeats is below 1.

    Examples
    --------
    >>> ExperimentPlan([(2.0, [0.8, 1.0, 1.2], 3), (4.0, [0.8, 1.2], 3)], static=[(3.0, [0.1, 0.2], 1)])
    ExperimentPlan(R = 2 mm: 3 forces 0.8..1.2 N x 3; R = 4 mm: 2 forces 0.8..1.2 N x 3; static R = 3 mm: 2 depths 0.1..0.2 mm x 1)
    """

    velocities: tuple[Series, ...]
    static: tuple[Series, ...] = ()

    def __init__(
        self,
        velocities: Sequence[tuple[float, Sequence[float], int]],
        static: Sequence[tuple[float, Sequence[float], int]] = (),
    ) -> None:
        for name, what, table in (("velocities", "forces", velocities), ("static", "depths", static)):
            rows = isinstance(table, Sequence) and all(isinstance(r, Sequence) and len(r) == 3 for r in table)
            refuse(
                not rows, f"{name} must be a list of (radius, {what}, repeats), got {shown(table)}", TypeError
            )
            object.__setattr__(self, name, tuple(_series(name, what, *row) for row in table))

    def __repr__(self) -> str:
        parts = [f"R = {R:g} mm: {_range(F, 'force', 'N')} x {k}" for R, F, k in self.velocities]
        parts += [f"static R = {R:g} mm: {_range(h, 'depth', 'mm')} x {k}" for R, h, k in self.static]
        return f"ExperimentPlan({'; '.join(parts)})"

    def observations(self, levels: Mapping[str, int] | None = None, law: Law | None = None) -> Observations:
        """The rows of a fit, every outcome 1 [mm/s] or [N]; repeats are dealt over the levels of groups."""

        most = max(k for *_, k in (*self.velocities, *self.static))

        def groups(values: tuple[float, ...], k: int) -> dict[str, list[int]]:
            labels, every = {}, 1
            for name, number in (levels or {}).items():
                refuse(
                    number * every > most,
                    f"between of {name}: {number * every} runs at a force or depth would have each {name} once"
                    f"{' with each of the others' if every > 1 else ''}, the plan has at most {most}",
                )
                labels[name] = [repeat // every % number for _ in values for repeat in range(k)]
                every *= number
            return labels

        sets: list[Data] = [
            VelocityCurve(np.repeat(F, k), np.ones(len(F) * k), radius=R, groups=groups(F, k))
            for R, F, k in self.velocities
        ]
        sets += [
            Indentation(np.ones(len(h) * k), np.repeat(h, k), R, groups=groups(h, k))
            for R, h, k in self.static
        ]
        return Observations.of(sets, None, None, law)


def _series(name: str, what: str, radius: float, values: Sequence[float], repeats: int) -> Series:
    numbers = real(values, f"{what} in {name}")
    refuse(
        not 0 < scalar(radius, f"radius in {name}") < np.inf,
        f"radius in {name} must be positive and finite: got {radius!r}",
    )
    refuse(
        numbers.ndim != 1 or not numbers.size or not all(0 < number < np.inf for number in numbers),
        f"{what} in {name} must be positive and finite, at least one: got {values!r}",
    )
    repeats = whole(f"repeats in {name}", repeats, 2**31, "2^31")
    refuse(repeats < 1, f"repeats in {name} must be at least 1: got {repeats!r}")
    return float(radius), tuple(numbers.tolist()), repeats


def _range(values: tuple[float, ...], noun: str, unit: str) -> str:
    return f"{len(values)} {noun}{'s'[: len(values) > 1]} {min(values):g}..{max(values):g} {unit}"


QUANTITIES = ("c_e", "alpha", "identified")
AMONG = ("all", "closed", "open")


@dataclass(frozen=True)
class Share:
    """k of n, with the 95 % interval of Clopper and Pearson."""

    k: int
    n: int

    @property
    def value(self) -> float:
        """k/n; NaN where n is 0."""
        return self.k / self.n if self.n else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the probability."""
        if not self.n:
            return 0.0, 1.0
        interval = scipy.stats.binomtest(self.k, self.n).proportion_ci(0.95, method="exact")
        return float(interval.low), float(interval.high)

    def __str__(self) -> str:
        if not self.n:
            return "none"
        low, high = self.interval
        return f"{100 * self.value:.1f} % ({100 * low:.1f}..{100 * high:.1f}) of {self.n}"


@dataclass(frozen=True, eq=False, repr=False)
class Coverage:
    """How often the intervals held the truth.

    Attributes
    ----------
    experiment : ExperimentPlan
    material : Material
        True c_e, alpha and shape.
    scatter, static_scatter : float
        Standard deviation of ln v and of ln F of the static readings.
    seed : int
        Data set k depends on (seed, k) alone.
    lower, upper : ndarray, shape (n, 3, 3)
        Interval ends by data set, quantity (c_e [N/mm^2], alpha [1/ms], alpha/c_e^exponent) and level (68,
        95, 99.7 %); 0 and infinite where open.
    exponent : ndarray, shape (n,)
        Exponent of the combination, chosen for each data set.
    rise : ndarray, shape (n, 2)
        Rise of -2 log L over its minimum, at the true c_e and at the true c_e and alpha.
    joint_limit : ndarray, shape (n, 3)
        Limit of the second rise, by level.
    apart : ndarray of bool, shape (n,)
        Whether c_e and alpha are separately identified.
    provenance : dict
    """

    experiment: ExperimentPlan
    material: Material
    scatter: float
    static_scatter: float
    seed: int
    lower: Floats
    upper: Floats
    exponent: Floats
    rise: Floats
    joint_limit: Floats
    apart: NDArray[np.bool_]
    provenance: dict[str, Any]

    def __len__(self) -> int:
        return len(self.exponent)

    def holds(self, quantity: str = "c_e", level: str = "95") -> NDArray[np.bool_]:
        """Whether the interval of each data set holds the truth; for ``"joint"``, whether the region does.

        Parameters
        ----------
        quantity : {"c_e", "alpha", "identified", "joint"}
        level : {"68", "95", "99.7"}

        Raises
        ------
        ValueError
            If the quantity or level is unknown.
        """
        if quantity == "joint":
            return np.asarray(self.rise[:, 1] <= self.joint_limit[:, _place("level", level, tuple(LEVELS))])
        lower, upper = self._interval(quantity, level)
        c_e, alpha = self.material.c_e, self.material.alpha
        truth: Any = {"c_e": c_e, "alpha": alpha, "identified": alpha / c_e**self.exponent}[quantity]
        return np.asarray((lower <= truth) & (truth <= upper))

    def closed(self, quantity: str = "c_e", level: str = "95") -> NDArray[np.bool_]:
        """Whether the interval of each data set has two ends; arguments as for `holds`, without joint."""
        lower, upper = self._interval(quantity, level)
        return np.asarray((lower > 0) & (upper < np.inf))

    def coverage(self, quantity: str = "c_e", level: str = "95", *, among: str = "all") -> Share:
        """Share of the data sets whose interval holds the truth.

        Parameters
        ----------
        quantity, level : str
            As for `holds`.
        among : {"all", "closed", "open"}
            Data sets to count, by their interval. Selection by the outcome is no fair test: where the truth
            is on the ridge, the interval is closed in the sets whose scatter happened to exclude the truth.

        Raises
        ------
        ValueError
            If an argument is unknown.
        """
        _place("among", among, AMONG)
        holds = self.holds(quantity, level)
        if among != "all":
            holds = holds[self.closed(quantity, level) == (among == "closed")]
        return Share(int(holds.sum()), len(holds))

    def open_above(self, quantity: str = "c_e", level: str = "95") -> Share:
        """Share of the data sets whose interval has no upper end."""
        above = self._interval(quantity, level)[1] == np.inf
        return Share(int(above.sum()), len(above))

    def ratio(self, quantity: str = "c_e", level: str = "95") -> float:
        """Median ratio of upper to lower end of the closed intervals; NaN without any."""
        lower, upper = (ends[self.closed(quantity, level)] for ends in self._interval(quantity, level))
        return float(np.median(upper / lower)) if len(lower) else np.nan

    @property
    def separately_identified(self) -> Share:
        """Share of the data sets that determine c_e and alpha apart, as `Fit.separately_identified`.

        The 0.5 % that contradict the model by chance are not left out.
        """
        return Share(int(self.apart.sum()), len(self))

    def _interval(self, quantity: str, level: str) -> tuple[Floats, Floats]:
        where = (..., _place("quantity", quantity, QUANTITIES), _place("level", level, tuple(LEVELS)))
        return self.lower[where], self.upper[where]

    def rows(self, level: str = "95") -> list[list[str]]:
        """The table as text, header first."""
        return [
            ["", *AMONG, "open above", "upper/lower"],
            *(
                [
                    name,
                    *(str(self.coverage(name, level, among=among)) for among in AMONG),
                    f"{100 * self.open_above(name, level).value:.1f} %",
                    f"{self.ratio(name, level):.3g}",
                ]
                for name in QUANTITIES
            ),
            ["joint", str(self.coverage("joint", level)), "", "", "", ""],
        ]

    def __repr__(self) -> str:
        return "\n".join(
            [self._head(), *columns(self.rows()), f"separately identified: {self.separately_identified}"]
        )

    def _repr_html_(self) -> str:
        return (
            f"<p><b>{escape(self._head())}</b></p>{html_rows(self.rows())}"
            f"<p>separately identified: {escape(str(self.separately_identified))}</p>"
        )

    def _head(self) -> str:
        return (
            f"Coverage of 95 % intervals, {len(self)} data sets, {self.material.name}, scatter "
            f"{100 * self.scatter:g} %, seed {self.seed}: {self.experiment!r}"
        )


def _place(name: str, value: str, allowed: tuple[str, ...]) -> int:
    refuse(value not in allowed, f"{name} must be one of {', '.join(allowed)}: got {value!r}")
    return allowed.index(value)


@stored_as("burrlab.fitting.coverage.CoverageItem")
@dataclass(frozen=True)
class CoverageItem:
    """One data set: small, picklable and self-contained."""

    experiment: ExperimentPlan
    c_e: float
    alpha: float
    shape: str
    scatter: float
    static_scatter: float
    seed: int
    replicate: int
    exponents: tuple[float, float] = field(default=(PAPER_FORCE_EXPONENT, 0.0), metadata=LATER)

    @property
    def law(self) -> Law:
        """The law of the data and of their fit."""
        return Law(Shape(self.shape), *self.exponents)


@lru_cache(maxsize=8)
def _template(experiment: ExperimentPlan, law: Law, c_e: float) -> tuple[Likelihood, Domain, Floats]:
    """The likelihood of every data set, its outcomes 1; its domain, and the velocities at c_e and alpha = 1 /ms."""
    o = experiment.observations(law=law)
    likelihood = Likelihood(o, "relative", MeanFieldModel(o, law.shape))
    return likelihood, Domain.of(likelihood), likelihood.model.unit(c_e)


@stored_as("burrlab.fitting.coverage.replicate")
def replicate(item: CoverageItem) -> Floats:
    """Intervals of the fit to one synthetic data set, and the rises of -2 log L at the truth.

    Returns
    -------
    ndarray, shape (25,)
        Interval ends by quantity, level and side, 0 and infinite where open; exponent of the combination;
        rises of -2 log L at the true c_e and at the true (c_e, alpha); the joint region's limits by level; 1
        if separately identified.
    """
    template, domain, unit = _template(item.experiment, item.law, item.c_e)
    o = template.observations
    z = np.random.default_rng([item.seed, item.replicate]).standard_normal(len(o))
    n = len(o.force)
    rows = replace(
        o,
        velocity=item.alpha * unit * np.exp(item.scatter * z[:n]),
        pressed=item.c_e * o.pressed_unit * np.exp(item.static_scatter * z[n:]),
    )
    return _judged(template.of_rows(rows, template.model), domain, item)


@dataclass(frozen=True)
class MixedCoverageItem:
    """One data set with groups and offsets."""

    plain: CoverageItem
    between: tuple[tuple[str, int, float], ...]
    uncertain: tuple[tuple[str, float], ...]


def mixed_replicate(mixed: MixedCoverageItem) -> Floats:
    """As `replicate`; effects and offsets are drawn, and the fit is told of them."""
    item = mixed.plain
    o = mixed_rows(item.experiment, mixed.between, item.law)
    components = components_of(o, dict(mixed.uncertain))
    sizes = {name: size for name, _, size in mixed.between}
    effect2 = np.array(
        [(sizes[x.group.name] if x.deviation is None else x.deviation) ** 2 for x in components]
    )
    scatter2 = np.array([item.scatter**2, *([item.static_scatter**2] if len(o.pressed) else [])])

    plain = Likelihood(o, "relative", MeanFieldModel(o, item.law.shape))
    point, random = (item.c_e, item.alpha), np.random.default_rng([item.seed, item.replicate])
    true = MixedLikelihood(
        plain, components, point, np.zeros(sum(len(x.group.levels) for x in components)), scatter2, effect2
    )
    rows = redrawn_effects(o, true, point, {}, random)
    components = tuple(component.of_rows(rows) for component in components)
    fitted, domain, _ = fitted_again(plain.of_rows(rows), components, point)
    return _judged(fitted, domain, item)


@lru_cache(maxsize=8)
def mixed_rows(
    experiment: ExperimentPlan, between: tuple[tuple[str, int, float], ...], law: Law
) -> Observations:
    """The rows of an experiment, its repeats dealt over the levels of groups."""
    return experiment.observations({name: levels for name, levels, _ in between}, law)


def _judged(likelihood: Likelihood, domain: Domain, item: CoverageItem) -> Floats:
    """Intervals and rises of one data set, as `replicate` returns them."""
    best = lowest(likelihood, domain).point
    calibration, o = likelihood.calibration(*best), likelihood.observations
    evidence = ranges(likelihood, calibration, domain, best, item.law.ridge_exponent)
    tables = (evidence.intervals["c_e"], evidence.intervals["alpha"], evidence.identified.intervals)
    ends = [
        (0.0 if x.lower is None else x.lower, np.inf if x.upper is None else x.upper)
        for x in (table[level] for table in tables for level in LEVELS)
    ]
    at = likelihood.at(item.c_e)
    rises = [float(at.profile[0]) - evidence.base, float(at.minus2(item.alpha)[0]) - evidence.base]
    c_e, alpha = (evidence.intervals[name]["95"] for name in ("c_e", "alpha"))
    apart = not obstacle(c_e, alpha, o.c_e_floor)
    return np.concatenate(
        [np.ravel(ends), [evidence.identified.exponent], rises, [*evidence.joint.values()], [apart]]
    )


def coverage_study(
    experiment: ExperimentPlan,
    material: Material,
    *,
    n: int = 2000,
    scatter: float = 0.08,
    static_scatter: float = 0.1,
    between: Mapping[str, tuple[int, float]] | None = None,
    uncertain: Mapping[str, float] | None = None,
    seed: int | None = None,
    executor: Executor | None = None,
    store: StorePath | None = None,
    progress: Progress | None = None,
) -> Coverage:
    r"""Fits to synthetic data sets of an experiment, and how often their intervals hold the truth.

    .. math::

       v = \alpha R\, \Psi(F/(c_e R^2))\, e^{\text{scatter}\, z}, \qquad
       F_\text{static} = c_e R^2 (h/R)^{3/2}\, e^{\text{static scatter}\, z}

    Parameters
    ----------
    experiment : ExperimentPlan
        Radii, forces, depths and repeats.
    material : Material
        The truth: c_e [N/mm^2], alpha [1/ms] and erosion shape. The fits know the shape.
    n : int
        Number of data sets.
    scatter, static_scatter : float
        Standard deviation of ln v and of ln F; 0.08 is 8 %.
    between : dict, optional
        ``{"day": (3, 0.1)}``: how many days or specimens the repeats are dealt over, and the standard deviation
        between them, of ln alpha; of specimens, from three on, of ln c_e too. The fits estimate it.
    uncertain : dict, optional
        As in `burrlab.fit`: offsets are drawn with these standard deviations, and the fits are told of them.
    seed : int, optional
        None draws one, which the result records. Data set k depends on (seed, k) alone.
    executor : concurrent.futures.Executor, optional
        One thread by default, because a fit holds the GIL; a process pool is faster.
    store : Store or path, optional
        Keeps every data set's outcome, so that an interrupted study resumes.
    progress : callable or True, optional
        Called with the fraction done; True shows a bar.

    Returns
    -------
    Coverage

    Raises
    ------
    TypeError
        If the experiment or material has another type.
    ValueError
        If n is below 1, a scatter is not positive and finite, a force leaves no window in the material, or
        the experiment has fewer than three distinct forces.
    StudyInterrupted
        If the executor dies.

    Notes
    -----
    The intervals are those of `burrlab.fit`, from the walk along c_e alone, without its check by BOBYQA: a
    few milliseconds per data set.

    Examples
    --------
    >>> import burrlab
    >>> wide = burrlab.ExperimentPlan([(3.0, [0.3, 0.6, 1.2, 2.4], 3)])
    >>> study = burrlab.coverage_study(wide, burrlab.materials["bone"], n=20, seed=1)
    >>> len(study), study.open_above("c_e").k
    (20, 0)
    """
    require_type("experiment", experiment, ExperimentPlan, "ExperimentPlan([(3.0, [0.5, 1.0, 2.0], 3)])")
    require_type("material", material, Material, 'burrlab.materials["bone"]')
    refuse(whole("n", n, 2**31, "2^31") < 1, f"n must be at least 1: got {n!r}")
    for name, value in (("scatter", scatter), ("static_scatter", static_scatter)):
        refuse(not 0 < value < np.inf, f"{name} must be positive and finite: got {value!r}")
    check_offsets(uncertain, ())
    pairs = isinstance(between, Mapping) and all(
        isinstance(x, tuple) and len(x) == 2 for x in between.values()
    )
    refuse(
        between is not None and not pairs,
        f"between must be a dict such as {{'day': (3, 0.1)}}, got {shown(between)}", TypeError,
    )  # fmt: skip
    groups = tuple(
        (name, whole(f"{name} of between", k, 10000, "10000"), scalar(size, f"{name} of between"))
        for name, (k, size) in (between or {}).items()
    )
    refuse(
        any(k < 1 or not 0 <= size < np.inf for _, k, size in groups),
        f"between must be of 1 or more, 0 or more: got {between!r}",
    )
    seed = seed_or_new(seed)
    law = Law.of(material)
    template, _, unit = _template(experiment, law, material.c_e)
    o, lost = template.observations, ~np.isfinite(unit)
    first = int(np.argmax(lost))
    refuse(
        lost.any(),
        f"every force must leave a window, below {WINDOW_STOP**law.force_exponent:.4g} c_e R^2 = "
        f"{material.c_e * o.radius[first] ** 2 * WINDOW_STOP**law.force_exponent:.3g} N: got {o.force[first]:g} N",
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
            (law.force_exponent, law.rate_exponent),
        )
        for k in range(n)
    ]
    if groups or uncertain:
        offsets = tuple((uncertain or {}).items())
        components_of(mixed_rows(experiment, groups, law), dict(offsets))  # refuses what no window allows
        columns = run_fits(
            mixed_replicate,
            [MixedCoverageItem(item, groups, offsets) for item in items],
            executor,
            store,
            progress,
        )
    else:
        columns = run_fits(replicate, items, executor, store, progress)
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
            **law.exponents,
            scatter=float(scatter),
            static_scatter=float(static_scatter),
            n=n,
            seed=seed,
            **({"between": dict(between)} if between else {}),
            **({"uncertain": dict(uncertain)} if uncertain else {}),
        ),
    )
