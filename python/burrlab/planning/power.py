"""How many specimens and runs a comparison of two drills needs, and the sheet of its runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from burrlab.common.check import real, refuse, require_type, scalar, seed_or_new, shown, whole
from burrlab.common.figures import REFERENCE, SERIES, Axes, axes_or_new, drawing, styled
from burrlab.common.progress import Progress, counter
from burrlab.common.provenance import provenance
from burrlab.common.records import Codec, InJson
from burrlab.common.table import by_value, label_in_file
from burrlab.comparing.paired import ERROR, difference_of, joint_model
from burrlab.fitting.calibration import MixedCalibration
from burrlab.fitting.group_effects import deviation_text
from burrlab.fitting.likelihood import Likelihood, MeanFieldModel
from burrlab.fitting.linear import LinearModel, MixedEquations, components_of
from burrlab.fitting.observations import Floats, Observations
from burrlab.fitting.report import columns
from burrlab.fitting.result import Fit
from burrlab.measured.curve import VelocityCurve

_NODES, _DRAWS = 12, 500  # over the estimated variance of the difference, and of estimated differences
_WIDEST = 3.0  # deviation of a logarithm: a factor of 20
WAYS = ("paired", "apart")  #: whether both drills work in the same specimens


@by_value
@dataclass(frozen=True, repr=False)
class ComparisonPower(InJson):
    """How often a comparison finds a difference of alpha. Made by `burrlab.compare_power`.

    Attributes
    ----------
    ratio : float
        alpha of the second drill over that of the first.
    specimens, runs : tuple of int
        Specimens (or days), and runs of each drill in each of them.
    power : ndarray, shape (2, len(specimens), len(runs))
        Probability that `burrlab.compare` says "differ": with both drills in the same specimens, and in others.
    aim : float
        Power that is wanted.
    unit : str
        Group that the specimens stand for, such as "specimen" or "day".
    between : dict
        Standard deviations between them: of ln ``c_e``, of ln ``alpha``, and of the ``difference`` of ln alpha
        between the drills.
    within : float
        Standard deviation of ln v between runs.
    forces : ndarray
        F of the runs [N]; runs go through them in turn.
    provenance : dict
    up_to : dict
        Upper 95 % ends of those deviations that come from the fit; None is open.
    """

    ratio: float
    specimens: tuple[int, ...]
    runs: tuple[int, ...]
    power: Floats
    aim: float
    unit: str
    between: Mapping[str, float]
    within: float
    forces: Floats
    provenance: Mapping[str, Any] = field(default_factory=dict)
    up_to: Mapping[str, float | None] = field(default_factory=dict)

    def smallest(self, way: str = "paired") -> tuple[int, int] | None:
        """Specimens and runs of the smallest comparison that reaches the aim, by its runs in all; None if none does."""
        refuse(way not in WAYS, f"way must be one of {', '.join(WAYS)}: got {way!r}")
        table = self.power[WAYS.index(way)]
        sizes = [
            (n * m, n, m)
            for i, n in enumerate(self.specimens)
            for k, m in enumerate(self.runs)
            if table[i, k] >= self.aim
        ]
        return min(sizes)[1:] if sizes else None

    @property
    def verdict(self) -> str:
        """The smallest comparisons, in plain words."""
        aim = f"alpha that differs by {100 * abs(self.ratio - 1):.3g} % is seen in {100 * self.aim:.3g} %"
        texts = []
        for way, how in zip(WAYS, (f"the same {self.unit}s", f"{self.unit}s of their own"), strict=True):
            size = self.smallest(way)
            with_it = f"with {size[0]} {self.unit}s and {size[1]} runs of each drill in each" if size else (
                f"by none of these (at best {100 * self.power[WAYS.index(way)].max():.3g} %)"
            )  # fmt: skip
            texts.append(f"With both drills in {how}, {aim} {with_it}.")
        if self.unit == "specimen":
            texts.append(
                "The first is for both drills on the same day or two. From three common days on, a comparison allows for a "
                "difference that varies from day to day, and sees less. If the drills have different days, it allows for "
                "the days, and sees less, too. The second takes each specimen on a day of its own, if the fit knows how "
                "days differ."
            )
        texts += [
            f"By the fit, all its groups together, {self.unit}s of their own differ in {name} by "
            f"{deviation_text(self.between[name])}, but by up to {'any amount' if end is None else deviation_text(end)} is "
            "possible; with it they see less."
            for name, end in self.up_to.items()
        ]
        return "\n".join(texts)

    def __repr__(self) -> str:
        shown = np.unique(np.linspace(0, len(self.runs) - 1, 8).round().astype(int))
        lines = []
        for way, table in zip(WAYS, self.power, strict=True):
            head = [f"{way}, runs:", *(str(self.runs[k]) for k in shown)]
            rows = [
                [f"{n} {self.unit}s", *(f"{100 * row[k]:.0f} %" for k in shown)]
                for n, row in zip(self.specimens, table, strict=True)
            ]
            lines += columns([head, *rows])
        return "\n".join([self.verdict, *lines])

    @drawing
    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Power over specimens, a line for each of at most four numbers of runs; dashed with other specimens."""
        ax = axes_or_new(ax)
        shown = np.unique(np.linspace(0, len(self.runs) - 1, 4).round().astype(int))
        for look, k in zip(SERIES, shown, strict=False):
            for way, table in zip(WAYS, self.power, strict=True):
                label = f"{self.runs[k]} runs of each drill" if way == "paired" else None
                dress = styled(style, **look | {"label": label, "markersize": 4})
                ax.plot(
                    self.specimens, table[:, k], **dress | {"linestyle": "-" if way == "paired" else "--"}
                )
        ax.plot([], [], "-", color=REFERENCE, label=f"both drills in the same {self.unit}s")
        ax.plot([], [], "--", color=REFERENCE, label=f"{self.unit}s of their own")
        ax.axhline(self.aim, color=REFERENCE, linewidth=0.8, linestyle=":")
        ax.set(
            xlabel=f"{self.unit}s of each drill [1]", ylim=(0, 1.02), xticks=self.specimens,
            ylabel=f"power to see {100 * abs(self.ratio - 1):.3g} % of α [1]",
        )  # fmt: skip
        ax.legend()
        return ax


ComparisonPower._codec = Codec(
    keys={
        ComparisonPower: {name: name for name in ComparisonPower.__dataclass_fields__}
        | {"smallest": lambda study: study.smallest(), "verdict": lambda study: study.verdict}
    }
)


def compare_power(
    fit: Fit,
    ratio: float = 0.9,
    *,
    specimens: int | Sequence[int] = range(3, 13),
    runs: int | Sequence[int] = range(6, 25),
    between: Mapping[str, float] | None = None,
    within: float | None = None,
    forces: ArrayLike | None = None,
    aim: float = 0.8,
    progress: Progress | None = None,
) -> ComparisonPower:
    """How many specimens and runs until a difference of two drills in alpha is seen.

    Parameters
    ----------
    fit : Fit
        The fit to a first series, which gives c_e, alpha, burr, shape, scatter and, where it knows specimens, days or
        both, their standard deviations.
    ratio : float
        alpha of the second drill over that of the first: 0.9 is 10 % less.
    specimens, runs : int or sequence of int
        Specimens (or days) of each drill, 2 or more; and runs of each drill in each of them, 3 or more.
    between : dict, optional
        Standard deviations between specimens: of ln ``"c_e"`` and ln ``"alpha"``, and of the ``"difference"`` of ln
        alpha between the drills. Those of the fit by default, of all its groups together; 0 for the difference,
        which a fit cannot tell.
    within : float, optional
        Standard deviation of ln v between runs: 0.08 is 8 %. That of the fit by default, which one of absolute
        residuals has not.
    forces : array_like, optional
        F of the runs [N], three or more; those of the fit by default.
    aim : float
        Power that is wanted.
    progress : callable or True, optional
        Called with the fraction done, 0 to 1; True shows a bar on standard error.

    Returns
    -------
    ComparisonPower

    Raises
    ------
    TypeError
        If fit is no `Fit`.
    ValueError
        If the fit failed or has several radii, a number is out of range, a force leaves no window, or neither the fit
        nor `between` says how much specimens differ.

    Notes
    -----
    The test is that of `burrlab.compare`: one c_e and alpha in both sets, with rows that are linear about the fit. Of
    pairs it is averaged over the estimated variance of the difference, which decides the limit; of specimens that
    each drill has for itself its statistic is a noncentral F with the limits and degrees of freedom that the fits to
    both would have at the true variances. Both drills go through the same forces in each specimen (docs/inference.md has
    powers of simulated comparisons beside these).

    If the fit knows days and specimens, each specimen is taken to have a day of its own, so that the variances of
    both add up in ln alpha. In the same specimens both drills have that day, and it cancels. If each drill has a
    day of its own there, the days are part of the difference: give this root 2 times their deviation. Where all
    runs are of one day, give the specimens' deviation alone. Days that several specimens of one drill share, and
    the other drill has not, tell less than any of these. Two specimens of their own do not tell how c_e differs:
    if it does, they find a difference as often as the test errs.

    Examples
    --------
    >>> import burrlab
    >>> bone = burrlab.materials["bone"]
    >>> fit = burrlab.fit(burrlab.synthetic_curve(burrlab.Burr(3.0), bone, [0.3, 0.6, 1.2, 2.2], repeats=2, seed=1))
    >>> study = burrlab.compare_power(fit, 0.9, specimens=[3, 6], runs=[8, 16], between={"alpha": 0.1}, within=0.05)
    >>> study.smallest()
    (3, 8)
    """
    require_type("fit", fit, Fit, "burrlab.fit(curve)")
    fit._evidence()
    R = fit.radius
    if R is None:
        raise ValueError("the fit must be of one radius: it has several")
    refuse(
        not 0.1 <= scalar(ratio, "ratio") <= 10 or ratio == 1,
        f"ratio must lie between 0.1 and 10 and be other than 1, 0.9 for 10 % less: got {ratio!r}",
    )
    refuse(not 0 < scalar(aim, "aim") < 1, f"aim must be above 0 and below 1: got {aim!r}")
    sizes = [tuple(whole(f"{name} of a comparison", n, 1000, "1000") for n in np.atleast_1d(numbers).tolist())
             for name, numbers in (("specimens", specimens), ("runs", runs))]  # fmt: skip
    for name, numbers, least in (("specimens", sizes[0], 2), ("runs", sizes[1], 3)):
        refuse(not numbers or min(numbers) < least, f"{name} must be {least} or more each: got {numbers}")
    unit, deviations, up_to = _between(fit, between)
    scatter = _scatter(fit) if within is None else scalar(within, "within")
    refuse(not 0 < scatter < np.inf, f"within must be positive and finite: got {scatter!r}")
    force = np.unique(fit.observations.force if forces is None else real(forces, "forces"))
    lost = ~np.isfinite(np.atleast_1d(fit.velocity(force)))
    refuse(
        lost.any() or len(force) < 3,
        f"forces must be three or more that leave a window: got {force.tolist()}",
    )
    report_progress, total = counter(progress, "comparisons"), 2 * len(sizes[0]) * len(sizes[1])
    power = np.zeros((2, len(sizes[0]), len(sizes[1])))
    for number, place in enumerate(np.ndindex(power.shape), start=1):
        way, n, m = WAYS[place[0]], sizes[0][place[1]], sizes[1][place[2]]
        power[place] = _power(fit, ratio, way, n, _in_turn(force, m), unit, deviations, scatter)
        report_progress(number, total)
    return ComparisonPower(
        float(ratio), sizes[0], sizes[1], power, float(aim), unit, deviations, float(scatter), force,
        provenance(fit=repr(fit), radius_mm=R, shape=fit.shape.name, **fit.law.exponents), up_to,
    )  # fmt: skip


def _scatter(fit: Fit) -> float:
    """Standard deviation of ln v between runs about a fit."""
    kind, scatter = fit.residual_kind, fit._evidence().scatters[0].value
    refuse(kind == "absolute", "within must be given: a fit of absolute residuals has no scatter of ln v")
    if kind == "sigma":
        o = fit.observations
        return float(np.sqrt(np.nanmean(np.square(o.sigma / o.velocity))))
    return scatter * np.sqrt(2.0) if kind == "student" else scatter  # t with 4 degrees of freedom


def _between(
    fit: Fit, between: Mapping[str, float] | None
) -> tuple[str, dict[str, float], dict[str, float | None]]:
    """The unit of a comparison, the standard deviations between its levels, and how large the fit's may be."""
    names, estimated = ("c_e", "alpha", "difference"), [x for x in fit.effects if x.interval is not None]
    unit = next(
        (x.group for x in estimated if x.quantity == "c_e"), estimated[-1].group if estimated else "specimen"
    )
    refuse(
        not isinstance(between, Mapping | None),
        f"between must be a dict such as {{'alpha': 0.1}}, got {shown(between)}",
        TypeError,
    )
    chosen = between or {}
    refuse(
        not estimated and "alpha" not in chosen,
        "between must hold alpha, such as {'alpha': 0.1} (--between alpha=0.1): the fit knows no specimens or days",
    )
    refuse(
        unit != "specimen" and chosen.get("c_e"),
        f"between may hold c_e of specimens, which the fit does not know: its groups are {unit}s",
    )
    # a specimen on a day of its own differs by what both do
    by_name = {name: [x for x in estimated if x.quantity == name] for name in names}
    deviations: dict[str, float] = {
        name: sum(float(x.deviation or 0.0) ** 2 for x in effects) ** 0.5 for name, effects in by_name.items()
    }
    for name, value in chosen.items():
        refuse(name not in names, f"between may hold {', '.join(names)}: got {name!r}")
        refuse(
            not 0 <= scalar(value, f"between of {name}") <= _WIDEST,
            f"between of {name} must lie between 0 and {_WIDEST:g}, 0.1 for 10 %: got {value!r}",
        )
        deviations[name] = float(value)
    ends = {
        name: [x.interval.upper for x in effects if x.interval]
        for name, effects in by_name.items()
        if effects and name not in chosen
    }
    up_to = {
        name: None if None in upper else math.hypot(*filter(None, upper)) for name, upper in ends.items()
    }
    return unit, deviations, up_to


def _in_turn(force: Floats, n: int) -> Floats:
    """n forces: all of them in turn, or some that are spread over them."""
    return np.resize(force[np.linspace(0, len(force) - 1, min(n, len(force))).round().astype(int)], n)


def _power(
    fit: Fit,
    ratio: float,
    way: str,
    n: int,
    force: Floats,
    unit: str,
    between: Mapping[str, float],
    within: float,
) -> float:
    """Probability that a comparison of given size finds the difference."""
    if way == "apart" and n < 3 and between["c_e"]:  # two specimens do not tell how c_e differs
        return ERROR
    labels = np.repeat(np.arange(n), len(force)).astype(str)
    curve = VelocityCurve(
        np.tile(force, n), np.ones(n * len(force)), radius=fit.radius, groups={unit: labels}
    )
    o, point, change = (
        Observations.of([curve], None, None, fit.law),
        (fit.c_e, fit.alpha),
        np.log([1.0, ratio]),
    )
    likelihood = Likelihood(o, "relative", MeanFieldModel(o, fit.shape))
    if way == "apart":  # each set has the limits of its own fit
        effects = components_of(o)
        effect2 = np.array([between[x.quantity] ** 2 for x in effects])
        model = LinearModel(likelihood, effects, point, np.zeros(n * len(effects)))
        side = MixedEquations(model, np.array([within**2]), effect2).uncertainty()
        limits = side.threshold(None)
        shift = float(change @ np.linalg.solve(2 * limits.inflation * side.covariance, change))
        freedom = min(2 * limits.nu, 1e6)
        return 1 - float(special.ncfdtr(2.0, freedom, shift, float(special.fdtri(2, freedom, 1 - ERROR))))
    pairs = joint_model([likelihood, likelihood], [point, (fit.c_e, fit.alpha * ratio)], ())

    def calibration(difference2: float) -> MixedCalibration:
        """At a variance of the drills' difference."""
        effect2 = [difference2 / 2 if x.varies else between[x.quantity] ** 2 for x in pairs.components]
        return difference_of(MixedEquations(pairs, np.full(2, within**2), np.array(effect2)))

    of_mean = 2 * within**2 / len(force)  # variance of a pair's mean difference
    true = calibration(between["difference"] ** 2)
    estimates = (
        np.random.default_rng(0).standard_normal((_DRAWS, 2)) @ np.linalg.cholesky(true.covariance).T + change
    )
    # the variance of the difference is estimated from n - 1 degrees of freedom, and may be below 0
    quantiles = special.fdtri(n - 1, 2 * n * (len(force) - 1), (np.arange(_NODES) + 0.5) / _NODES)
    total = 0.0
    for variance in (of_mean + between["difference"] ** 2) * quantiles - of_mean:
        seen = calibration(float(variance))
        rise = np.einsum("ki,ij,kj->k", estimates, np.linalg.inv(seen.covariance), estimates) / seen.bias
        total += float(np.mean(rise / 2 > special.fdtri(2, 1 if n == 2 else seen.freedom_of_sum, 1 - ERROR)))
    return total / _NODES


def run_sheet(
    forces: ArrayLike,
    *,
    specimens: int | Sequence[str],
    runs: int,
    drills: Sequence[str] = ("A", "B"),
    days: int = 2,
    radius: float | None = None,
    seed: int | None = None,
) -> VelocityCurve:
    """The runs of a comparison in the order to make them: a curve without velocities, to write and to fill in.

    Parameters
    ----------
    forces : array_like
        F [N]; runs go through them in turn.
    specimens : int or sequence of str
        How many, or their labels. Every drill works in each of them.
    runs : int
        Runs of each drill in each specimen.
    drills : sequence of str
    days : int
        The runs of each drill in each specimen are dealt over these. With three days or more a comparison also asks how
        the drills' difference varies from day to day, and sees less than `compare_power` says.
    radius : float, optional
        Burr radius [mm].
    seed : int, optional
        Of the order; None draws one, which the provenance records.

    Returns
    -------
    VelocityCurve
        With the groups "day", "specimen" and "drill". On each day specimens are in random order; in each of them the
        drills and forces are. `VelocityCurve.split("drill")` gives the curves to compare.

    Raises
    ------
    ValueError
        If a number is out of range, or labels are not distinct.

    Examples
    --------
    >>> import burrlab
    >>> sheet = burrlab.run_sheet([0.5, 1.0, 2.0], specimens=3, runs=6, seed=1)
    >>> len(sheet), sheet.groups["drill"][:4]
    (36, ('B', 'A', 'B', 'A'))
    """
    force = np.atleast_1d(real(forces, "forces"))
    refuse(
        force.ndim > 1 or not (force > 0).all() or not force.size,
        f"forces must be positive, one or more: got {shown(forces)}",
    )
    if not np.iterable(specimens):
        specimens = [f"specimen {k + 1}" for k in range(whole("specimens", specimens, 10000, "10000"))]
    refuse(not np.iterable(drills), f"drills must be a sequence of names, got {shown(drills)}", TypeError)
    labels, drills = ([label_in_file(name) for name in names] for names in (specimens, drills))
    for name, names in (("specimens", labels), ("drills", drills)):
        refuse(
            not names or "" in names or len(set(names)) < len(names),
            f"{name} must be one or more, with different labels: got {names}",
        )
    counts = {name: whole(name, n, 10000, "10000") for name, n in (("runs", runs), ("days", days))}
    refuse(
        not 1 <= days <= runs,
        f"runs must be as many as days or more, and days 1 or more: got {runs} and {days}",
    )
    seed = seed_or_new(seed)
    random, rows = np.random.default_rng(seed), []
    each, turn = _in_turn(force, counts["runs"]), np.arange(runs)
    # so that each day has as many, and a force that comes again does so on another day
    dealt = (turn + turn // np.lcm(min(len(force), counts["runs"]), days)) % days
    for day in range(days):
        for k in random.permutation(len(labels)).tolist():
            block = [(drill, F) for F in each[dealt == (day + k) % days].tolist() for drill in drills]
            rows += [
                (f"day {day + 1}", labels[k], *block[i]) for i in random.permutation(len(block)).tolist()
            ]
    day_names, specimen_names, drill_names, F = zip(*rows, strict=True)
    groups = {"specimen": specimen_names, "drill": drill_names}
    return VelocityCurve(
        F, np.full(len(F), np.nan), radius=radius, source="run sheet", provenance=provenance(seed=seed),
        groups={"day": day_names} | groups if days > 1 else groups,
    )  # fmt: skip
