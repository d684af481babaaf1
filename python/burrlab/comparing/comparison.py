"""Whether data sets are of one material: ratios of their constants, a joint test, equivalent velocities."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from scipy import special

from burrlab.common.check import check_same_length, refuse, scalar, shown
from burrlab.common.figures import REFERENCE, SERIES, Axes, axes_or_new, drawing, styled
from burrlab.common.provenance import provenance
from burrlab.common.records import Codec, InJson
from burrlab.common.table import ReportInHtml, Tabulated, by_value, holm, probability_text
from burrlab.comparing.paired import ERROR, LinearDifference, Paired
from burrlab.fitting.calibration import Threshold, covariance_of
from burrlab.fitting.diagnostics import HypothesisTest, concluded
from burrlab.fitting.linear import OFFSETS, check_names
from burrlab.fitting.observations import Floats
from burrlab.fitting.profile import ALPHA, C_E, ENDLESS, ConfidenceInterval, Domain, close_walk
from burrlab.fitting.record import FitRecord
from burrlab.fitting.report import columns, in_blocks
from burrlab.fitting.verdict import span
from burrlab.theory.continuum import WINDOW_STOP

LEVEL = 0.95  # of the intervals of ratios, all pairs together
_FORCES = 15  # at which velocities are compared
_OPEN = 1e3  # logarithm that stands for an open end; beyond `ENDLESS` all are
#: Distances from a best value in standard errors, at which its ends are known
_T = np.concatenate([np.arange(0, 1.6, 0.2), np.arange(1.6, 4, 0.1), np.geomspace(4, 40, 16)])
_ANGLE = np.linspace(0, np.pi / 2, 33)


@dataclass(frozen=True)
class ComparedSet:
    """One of the fits that were compared."""

    name: str
    n_points: int
    c_e: float  #: [N/mm^2]
    alpha: float  #: [1/ms]
    residual_kind: str
    status: str  #: of the fit
    groups: tuple[str, ...] = ()  #: days, specimens ... of several levels that the fit knows


@dataclass(frozen=True)
class Ratio:
    """A quantity of the second set over that of the first, and its interval; None is an open end."""

    value: float
    interval: ConfidenceInterval

    @property
    def verdict(self) -> str:
        """``"other than 1"``, ``"undetermined"`` where an end is open, or ``"not told apart"``."""
        if 1.0 not in self.interval:
            return "other than 1"
        return "not told apart" if self.interval.closed else "undetermined"


@by_value
@dataclass(frozen=True)
class VelocityRatio:
    """Predicted velocity of the second set over that of the first, over the forces that both share."""

    radius: Floats  #: R [mm], shape (m,) as the next four
    force: Floats  #: F [N]
    ratio: Floats
    lower: Floats  #: of the 90 % interval at each force
    upper: Floats
    p_value: float | None  #: largest of all forces that the ratio lies outside the margin
    middle: tuple[float, float]  #: R [mm] and the geometric mean of the shared forces [N]
    at_middle: Ratio  #: the ratio there, its interval at the level of the other ratios

    def __post_init__(self) -> None:
        columns = ("radius", "force", "ratio", "lower", "upper")
        check_same_length(**{name: getattr(self, name) for name in columns})


@dataclass(frozen=True)
class ComparedPair:
    """Two sets: the second over the first."""

    names: tuple[str, str]
    ratios: Mapping[str, Ratio]  #: of ``c_e``, ``alpha``, ``combination``
    joint: HypothesisTest  #: whether one c_e and alpha give both
    p_differ: float  #: its p-value, corrected for the number of pairs
    velocity: VelocityRatio | None  #: None where the sets share no force at one radius
    p_equivalent: float  #: of a velocity ratio outside the margin, corrected; 1 without a margin
    pairing: str = ""  #: the group whose levels both sets have, so that its effects cancel
    apart: str = ""  #: groups that both sets have, with no label in common
    obstacle: str = ""  #: Why no test can tell the sets apart from their days or specimens, in a sentence.

    @property
    def differ(self) -> bool:
        """Whether the sets are of different materials, at 5 % for all pairs together."""
        return self.p_differ < ERROR and not self.obstacle

    @property
    def equivalent(self) -> bool:
        """Whether the velocities agree within the margin, at 5 % for all pairs together."""
        return self.p_equivalent < ERROR and not self.obstacle


@dataclass(frozen=True, repr=False)
class Comparison(ReportInHtml, InJson, Tabulated):
    """Data sets compared two by two. Made by `burrlab.compare`."""

    sets: tuple[ComparedSet, ...]
    exponent: float  #: p of the combination alpha/c_e^p, common to all sets
    on_ridge: bool  #: whether p is the ridge's, because c_e of a set or a ratio of c_e is open
    margin: float | None
    pairs: tuple[ComparedPair, ...]
    provenance: Mapping[str, Any]

    def __post_init__(self) -> None:
        n = math.comb(len(self.sets), 2)
        refuse(
            len(self.pairs) != n,
            f"pairs must be {n}, of {len(self.sets)} sets two by two: got {len(self.pairs)}",
        )

    @property
    def verdict(self) -> str:
        """A sentence a pair, each on a line: whether its sets differ, and whether they are equivalent."""
        lines = []
        for pair in self.pairs:
            if pair.obstacle:
                lines.append(pair.obstacle)
                continue
            units = f", each with {pair.apart}s of its own," if pair.apart else ""
            units = f", paired by {pair.pairing}," if pair.pairing else units
            runs = "" if all(s.groups for s in self.sets if s.name in pair.names) else "these runs of "
            sentence = runs + " and ".join(pair.names) + units
            sentence += " differ" if pair.differ else " can be of one material"
            if pair.velocity is not None:
                at = pair.velocity.at_middle
                sentence += (
                    f" ({pair.names[1]} over {pair.names[0]}: velocity {at.value:.3g}, {span(at.interval)}, at "
                    f"{pair.velocity.middle[1]:.3g} N)"
                )
            if self.margin is not None:
                shown_to = "" if pair.equivalent else "not shown to be "
                sentence += f", and are {shown_to}equivalent within {100 * self.margin:g} % of velocity"
            lines.append(f"{sentence[0].upper() if runs else sentence[0]}{sentence[1:]}.")
        return "\n".join(lines)

    def __repr__(self) -> str:
        names = ", ".join(data_set.name for data_set in self.sets)
        differ = sum(pair.differ for pair in self.pairs)
        return f"Comparison({names}: {differ} of {len(self.pairs)} pairs differ)"

    def report(self) -> str:
        """Verdict, tables and sentences as text."""
        notes = []
        sets = [
            ["", "points", "c_e [N/mm^2]", "alpha [1/ms]", "residuals", "status"],
            *(
                [s.name, str(s.n_points), f"{s.c_e:.4g}", f"{s.alpha:.4g}", s.residual_kind, s.status]
                for s in self.sets
            ),
        ]
        ratios = [["", "ratio of", "value", "95 %", "verdict"]]
        for pair in self.pairs:
            pair_text = f"{pair.names[1]} over {pair.names[0]}"
            ratios += [
                [
                    pair_text,
                    quantity,
                    "-" if ratio.verdict == "undetermined" else f"{ratio.value:.4g}",
                    span(ratio.interval),
                    ratio.verdict,
                ]
                for quantity, ratio in self._named_ratios(pair).items()
            ]
            corrected = (
                f" Corrected for {len(self.pairs)} pairs, where they {'differ' if pair.differ else 'can be of one material'}: "
                f"{probability_text(pair.p_differ)}."
                if len(self.pairs) > 1
                else ""
            )
            notes += [
                f"{pair_text}: {pair.joint.sentence}{corrected}",
                f"{pair_text}: {self._velocity(pair)}",
            ]
        why = (
            "the ridge's, because c_e of a set or a ratio of c_e is open"
            if self.on_ridge
            else "which makes the squared standard errors of all sets together smallest"
        )
        notes += [
            "Whether two sets differ is the joint test's to say: each interval holds by itself.",
            f"The combination's exponent, {self.exponent:.3g}, is common to all sets: {why}.",
        ]
        if any(row[-1] == "undetermined" for row in ratios):
            notes.append("Undetermined is not equal: an open end shows that the data set no limit there.")
        if len(self.pairs) > 1:
            notes.append(f"Corrected for {len(self.pairs)} pairs: intervals by Bonferroni, p-values by Holm.")
        if doubtful := [data_set.name for data_set in self.sets if data_set.status not in ("ok", "ridge")]:
            notes.append(f"The fit itself is in doubt for {', '.join(doubtful)}: see its status.")
        return in_blocks(
            {
                "Verdict": self.verdict.split("\n"),
                "Sets": columns(sets),
                "Ratios": columns(ratios),
                "Notes": [f"- {note}" for note in notes],
            }
        )

    def _named_ratios(self, pair: ComparedPair) -> dict[str, Ratio]:
        """The ratios of a pair, the combination and the velocity by what they are of."""
        names = {"combination": f"alpha/c_e^{self.exponent:.3g}"}
        ratios = {names.get(key, key): ratio for key, ratio in pair.ratios.items()}
        if pair.velocity is not None:
            ratios[f"velocity at {pair.velocity.middle[1]:.3g} N"] = pair.velocity.at_middle
        return ratios

    def _velocity(self, pair: ComparedPair) -> str:
        v = pair.velocity
        if v is None:
            return "The two share no force at one radius: velocities are not compared."
        seen = (
            f"velocities from {v.force.min():.3g} to {v.force.max():.3g} N have ratios within "
            f"{v.lower.min():.3g} to {v.upper.max():.3g} (90 % at each force)"
        )
        if self.margin is None:
            return f"{seen}; without a margin nothing is called equivalent."
        outcome = "equivalent" if pair.equivalent else "not shown to be equivalent"
        return f"{seen}: {outcome} within {100 * self.margin:g} %, {probability_text(pair.p_equivalent)}."

    def _table(self) -> dict[str, list[Any]]:
        rows = [
            (
                " over ".join(pair.names[::-1]),
                name,
                x.value,
                x.interval.lower,
                x.interval.upper,
                pair.p_differ,
            )
            for pair in self.pairs
            for name, x in self._named_ratios(pair).items()
        ]
        names = ("sets", "ratio of", "value", "lower_95", "upper_95", "p_differ")
        return {name: list(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}

    @drawing
    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Velocity ratios over the shared forces with their 90 % bands, and the margin as dashed lines.

        `style` are properties of the lines of ratios, `label` and `color` among them. ValueError if no two
        sets share a force at one radius.
        """
        drawn_pairs = [(pair.names, pair.velocity) for pair in self.pairs if pair.velocity is not None]
        refuse(not drawn_pairs, "no two sets share a force at one radius: there is no velocity ratio to draw")
        ax = axes_or_new(ax)
        for k, (names, v) in enumerate(drawn_pairs):
            for R in np.unique(v.radius):
                F, ratio, low, high = np.array([v.force, v.ratio, v.lower, v.upper])[:, v.radius == R]
                label = f"{names[1]} over {names[0]}, R = {R:g} mm"
                look = styled(style, **SERIES[k % len(SERIES)] | {"markersize": 3, "label": label})
                ax.fill_between(
                    F,
                    low,
                    high,
                    color=look["color"],
                    alpha=0.2,
                    linewidth=0,
                    label="90 % band" if k == 0 and v.radius.min() == R else None,
                )
                ax.plot(F, ratio, **look)
        ax.axhline(1, color=REFERENCE, linewidth=0.8)
        if self.margin is not None:
            dashed: Any = {"color": REFERENCE, "linewidth": 0.9, "linestyle": "--"}
            ax.axhline(1 + self.margin, label=f"margin, {100 * self.margin:g} %", **dashed)
            ax.axhline(1 / (1 + self.margin), **dashed)
        ax.set(xlabel="force [N]", ylabel="ratio of velocities [1]", yscale="log")
        return ax


Comparison._codec = Codec(
    keys={
        ComparedPair: {name: name for name in ComparedPair.__dataclass_fields__}
        | {"differ": lambda pair: pair.differ, "equivalent": lambda pair: pair.equivalent},
        Ratio: {"value": "value", "interval": "interval", "verdict": lambda ratio: ratio.verdict},
    }
)


def compare(
    *fits: FitRecord,
    margin: float | None = None,
    names: Sequence[str] | None = None,
    shared: Sequence[str] = (),
) -> Comparison:
    r"""Whether the data of two or more fits are of one material.

    Parameters
    ----------
    *fits : Fit
        Mean-field fits under one law, one a data set, without given bounds. They may differ in kind
        of residuals, scatter, forces and burr.
    margin : float, optional
        Relative difference of velocity, set before the data are seen, within which two sets count as
        equivalent: 0.2 allows ratios from 1/1.2 to 1.2. Without it nothing is called equivalent.
    names : sequence of str, optional
        Names of the sets; A, B, C, ... by default.
    shared : sequence of str
        Uncertain offsets that the sets have in common, such as ``("force",)`` for one load cell: they cancel.

    Raises
    ------
    TypeError
        If a set is no fit.
    ValueError
        If there are fewer than two fits, one is of another kind than above or gave nothing, the margin is not
        above 0 and at most 1, the names are not one a fit and distinct, or a shared offset is not uncertain in
        each fit, with one value.

    Notes
    -----
    Each set keeps its own scatter, as in Welch's test. Along a quantity g the profile of each set becomes a
    squared t by the limits of its fit. The statistic of a difference d is the lowest sum of both,

    .. math::

       T(d) = \min_g \left[t_A^2(g) + t_B^2(g + d)\right]

    the square of Welch's t for a linear model. It is judged by F(1, nu), nu by Welch and Satterthwaite from
    the half widths at t = 1. The joint test is the same for both parameters, F(2, nu).

    Where the fits know groups (days, specimens), these are the units: the limits have the degrees of freedom that
    the groups leave. Labels that both sets have are pairs, the best design: the effects of two or more common days
    or specimens, and shared offsets, are one for both sets, and the differences of log c_e and log alpha are those
    of one mixed model, in which the difference may vary from pair to pair: with the same runs in each it is the paired
    t test. The joint test is of how much the rows' squares rise where both sets have one c_e and alpha; where a set
    leaves c_e open, or has it from a second minimum, both have one c_e, and the test is of alpha. With a second minimum
    the ratios of c_e and alpha are of the sets apart, and made to hold 1 where the test does. A set of one day or
    specimen, where the other has others, allows no decision; nor do the same rows twice.

    Velocities are equivalent if at each of 15 shared forces the 90 % interval lies inside the margin: two
    one-sided tests at 5 %, which need no correction for the number of forces (intersection-union).

    References
    ----------
    Welch, Biometrika 34 (1947). Berger and Hsu, Bioequivalence trials, intersection-union tests ...,
    Statistical Science 11 (1996). Holm, Scand. J. Statistics 6 (1979).

    Examples
    --------
    >>> import burrlab
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> forces = [0.3, 0.6, 1.2, 2.4]
    >>> first, second = (burrlab.fit(burrlab.synthetic_curve(burr, bone, forces, repeats=3, seed=i)) for i in (1, 2))
    >>> print(compare(first, second, margin=0.2).verdict)
    These runs of A and B can be of one material (B over A: velocity 0.985, 0.904 to 1.08, at 0.849 N), and are equivalent within 20 % of velocity.
    """
    named = _checked_names(fits, margin, names)
    _check_shared(fits, shared)
    sides = [_Side(fit) for fit in fits]
    places = list(combinations(range(len(fits)), 2))
    level = 1 - (1 - LEVEL) / len(places)
    of_c_e = [_ratio(_LogRatio(sides[i].ends_of_c_e, sides[k].ends_of_c_e), level) for i, k in places]
    on_ridge = not all(ratio.interval.closed for ratio in of_c_e)
    on_ridge |= any(fit.intervals["c_e"]["95"].upper is None for fit in fits)
    exponent = fits[0].law.ridge_exponent
    if not on_ridge:  # the p of the smallest summed variance of log alpha - p log c_e
        variance = np.sum([side.variance for side in sides], axis=0)
        exponent = float(np.clip(variance[0, 1] / variance[0, 0], 0.0, 3 * exponent))
    linear = [Paired.of(fits[i], fits[k], shared) for i, k in places]
    joint = [
        pair.joint if pair else _joint(sides[i], sides[k])
        for pair, (i, k) in zip(linear, places, strict=True)
    ]
    velocities = [
        _velocities(sides[i], sides[k], margin, level, pair)
        for pair, (i, k) in zip(linear, places, strict=True)
    ]
    p_differ = holm([test.p_value for test in joint])
    # a pair without shared forces or margin counts as not equivalent
    p_equivalent = holm(
        [1.0 if test is None or test.p_value is None else test.p_value for test in velocities]
    )
    return Comparison(
        sets=tuple(
            ComparedSet(
                name,
                fit.n_points,
                fit.c_e,
                fit.alpha,
                fit.residual_kind,
                fit.status,
                tuple(group.name for group in fit.observations.groups if len(group.levels) > 1),
            )
            for name, fit in zip(named, fits, strict=True)
        ),
        exponent=exponent,
        on_ridge=on_ridge,
        margin=margin,
        pairs=tuple(
            ComparedPair(
                names=(named[i], named[k]),
                ratios=_ratios(sides[i], sides[k], of_c_e[n], linear[n], exponent, level),
                joint=joint[n],
                p_differ=p_differ[n],
                velocity=velocities[n],
                p_equivalent=p_equivalent[n],
                pairing=getattr(linear[n], "group", ""),
                apart="s and ".join(_apart(fits[i], fits[k])),
                obstacle=_obstacle((fits[i], fits[k]), (named[i], named[k])),
            )
            for n, (i, k) in enumerate(places)
        ),
        provenance=provenance(shape=fits[0].shape.name, **fits[0].law.exponents, margin=margin),
    )


def _apart(a: FitRecord, b: FitRecord) -> list[str]:
    """Groups of several labels that both fits have, with none in common."""
    first, second = a.observations.labels, b.observations.labels
    return [
        x
        for x in first
        if x in second and min(len(first[x]), len(second[x])) > 1 and not first[x] & second[x]
    ]


def _obstacle(fits: tuple[FitRecord, FitRecord], names: tuple[str, str]) -> str:
    """A sentence where both sets are the same rows, or one has one level of a group, the other other ones or none."""
    first, second = (fit.observations.labels for fit in fits)
    for group in sorted(first.keys() ^ second.keys()):
        of, other = names if group in first else names[::-1]
        if first and second and any(x.group == group for x in fits[group not in first].effects):
            return (
                f"Whether {names[0]} and {names[1]} differ cannot be told: the runs of {of} have a {group}, those of "
                f"{other} have none; label both, or leave it out of both by groups."
            )
    for group in first.keys() & second.keys():
        if first[group] != second[group] and min(len(first[group]), len(second[group])) == 1:
            return (
                f"Whether {names[0]} and {names[1]} differ cannot be told: all runs of {names[len(first[group]) > 1]} are of "
                f"one {group}, and no test can tell the sets from the {group}s."
            )
    a, b = (fit.observations for fit in fits)
    if all(np.array_equal(getattr(a, x), getattr(b, x)) for x in ("force", "velocity", "pressed")):
        return f"Whether {names[0]} and {names[1]} differ cannot be told: they hold the same rows. Was one file given twice?"
    return ""


def _checked_names(fits: Sequence[FitRecord], margin: float | None, names: Sequence[str] | None) -> list[str]:
    """A name for each fit; errors of `compare`."""
    for fit in fits:
        refuse(
            not isinstance(fit, FitRecord),
            f"compare takes fits, such as fit(curve, burr): got {shown(fit)}",
            TypeError,
        )
    refuse(len(fits) < 2, f"compare needs two fits or more: got {len(fits)}")
    refuse(
        len({fit.law for fit in fits}) > 1 or {fit.engine for fit in fits} != {"mean-field"},
        "all fits must be mean-field ones of one law",
    )
    refuse(
        any(fit.given_bounds for fit in fits), "compare needs fits without bounds, for these cut intervals"
    )
    refuse(
        any(x.group == "data set" and x.deviation is None for fit in fits for x in fit.effects),
        "compare needs fits of one c_e and alpha each: fit the data sets apart",
    )
    refuse(
        margin is not None and not 0 < scalar(margin, "margin") <= 1,
        f"margin must be above 0 and at most 1, where 0.2 is 20 %: got {margin!r}",
    )
    named = [chr(65 + k) for k in range(len(fits))] if names is None else list(names)
    refuse(
        isinstance(names, str)
        or not all(isinstance(name, str) for name in named)
        or not len(set(named)) == len(named) == len(fits),
        f"names must be {len(fits)} different texts: got {names!r}",
    )
    return named


def _check_shared(fits: Sequence[FitRecord], shared: Sequence[str]) -> None:
    """Refuse offsets that a fit does not have, or has more than one of, or of another size."""
    check_names("shared", shared, "force")
    for name in shared:
        for fit in fits:
            has = [x for x in fit.effects if x.quantity == name and name in OFFSETS and len(x.levels) == 1]
            refuse(not has, f"shared offsets must be uncertain in each fit, with one value: got {name!r}")
            refuse(
                has[0].deviation != next(x.deviation for x in fits[0].effects if x.quantity == name),
                f"a shared {name} is one, so all fits must have it with one standard deviation",
            )


@dataclass(frozen=True, eq=False)
class _Ends:
    """Lowest and highest logarithm of a quantity at each distance `_T`, and the freedom of its scatter."""

    low: Floats
    high: Floats
    nu: float
    scatter2: float  # variance of a row

    @property
    def variance(self) -> float:
        """Of the logarithm, from the half width at t = 1."""
        return float(np.interp(1.0, _T, self.high - self.low) / 2) ** 2


class _Side:
    """The likelihood of one set along any quantity."""

    def __init__(self, fit: FitRecord) -> None:
        evidence = fit._evidence()
        self.fit, self.likelihood, self.calibration = fit, fit.likelihood, evidence.calibration
        self.wider = (1 + self.calibration.monte_carlo) * self.calibration.inflation
        self.domain = Domain.of(self.likelihood)
        reach = [float(self._rise(self.calibration.threshold(C_E), t)) for t in (1.0, 2.0, 4.0)]
        self.walk = close_walk(self.likelihood, self.domain, fit.c_e, reach)
        self.x = np.log(self.walk.c_e)
        self.best = int(np.argmin(self.walk.minus2))
        self.base = float(self.walk.minus2[self.best])
        #: c_e [N/mm^2] at and above which every force of the rows has a window, or less where the data allow it
        near = float(self.walk.c_e[self.walk.minus2 <= self.base + reach[-1]].min())
        self.lowest = max(self.domain.low, min(near, fit.observations.c_e_floor))
        self.joint = self.calibration.threshold(None)
        self.variance = covariance_of(evidence.information) * (self.joint.inflation * self.wider)
        self.scatter2 = max(evidence.scatters[0].value, 1e-12) ** 2
        self._bands: dict[Threshold, tuple[Floats, Floats]] = {}

    def _rise(self, threshold: Threshold, t: Any) -> Any:
        """Rise of -2 log L at a distance of t standard errors."""
        return self.wider * threshold.rise(np.square(t))

    def bands(self, threshold: Threshold) -> tuple[Floats, Floats]:
        """Lowest and highest log alpha at each distance and c_e; NaN outside."""
        if threshold not in self._bands:
            bands = np.array([self.walk.band(self.base + rise) for rise in self._rise(threshold, _T)])
            bands[0] = np.nan
            bands[0, :, self.best] = self.walk.alpha[self.best]
            with np.errstate(divide="ignore"):
                low, high = np.log(bands).swapaxes(0, 1)
            self._bands[threshold] = low, high
        return self._bands[threshold]

    def ends(self, h: Floats, direction: Floats) -> _Ends:
        """Of log alpha + h(c_e); `direction` is its gradient over (log c_e, log alpha)."""
        threshold = self.calibration.threshold(direction)
        low, high = self.bands(threshold)
        lower, upper = np.nanmin(low + h, axis=1), np.nanmax(high + h, axis=1)
        far = np.isfinite(low[:, -1]) & (not self.domain.high_hard)
        g = np.log(self.walk.alpha[-2:]) + h[-2:]
        slope = float((g[1] - g[0]) / (self.x[-1] - self.x[-2]))  # on the ridge, where c_e has no end
        lower[(far & (slope < -1e-3)) | (lower < -ENDLESS)] = -_OPEN
        upper[(far & (slope > 1e-3)) | (upper > ENDLESS)] = _OPEN
        return _Ends(lower, upper, threshold.nu, self.scatter2)

    @cached_property
    def ends_of_c_e(self) -> _Ends:
        threshold, i = self.calibration.threshold(C_E), self.best
        rise = np.minimum(self.walk.minus2, 1e12) - self.base
        right = np.minimum.accumulate(rise[::-1])[::-1][i:]
        left = np.minimum.accumulate(rise)[: i + 1][::-1]
        thresholds = self._rise(threshold, _T)
        low, high = (
            np.interp(thresholds, left, self.x[: i + 1][::-1]),
            np.interp(thresholds, right, self.x[i:]),
        )
        if not self.domain.high_hard:
            high[thresholds >= right[-1]] = _OPEN
        return _Ends(low, high, threshold.nu, self.scatter2)

    def distance(self, c_e: Floats) -> Any:
        """Function of log alpha: the joint statistic, squared, at each c_e; and the best log alpha."""
        slices = self.likelihood.at(c_e)

        def at(g: Floats) -> Floats:
            return np.asarray(self.joint.statistic((slices.minus2(np.exp(g)) - self.base) / self.wider))

        return at, np.log(slices.best_alpha)


def _freedom(*sides: tuple[Any, float, float]) -> float:
    """Degrees of freedom of a difference, by Welch and Satterthwaite; of covariance, variance of a row and nu of each.

    Few rows that happen to scatter little would weigh little in it: it is at most that of one scatter for both (ours).
    """
    nus, freedoms = [], np.array([nu for _, _, nu in sides])
    for scatters in (np.ones(2), np.array([scatter2 for _, scatter2, _ in sides])):
        parts = [np.asarray(V) / scatter2 for (V, _, _), scatter2 in zip(sides, scatters, strict=True)]
        share = np.array([np.trace(np.linalg.solve(sum(parts), part)) / len(part) for part in parts])
        nus.append(1 / max(float(np.sum(share**2 / freedoms)), 1e-12))
    return min(nus)


class _LogRatio:
    """The difference of a quantity between two independent sets, second less first."""

    def __init__(self, a: _Ends, b: _Ends) -> None:
        self.value = float(b.low[0] - a.low[0])
        self.nu = _freedom(*(([[side.variance]], side.scatter2, side.nu) for side in (a, b)))
        across, along = _T[:, None] * np.cos(_ANGLE), _T[:, None] * np.sin(_ANGLE)
        self.high = np.max(np.interp(along, _T, b.high) - np.interp(across, _T, a.low), axis=1)
        self.low = np.min(np.interp(along, _T, b.low) - np.interp(across, _T, a.high), axis=1)

    def ends(self, level: float) -> tuple[float, float]:
        """Logarithms of the interval's ends; infinite where open."""
        t = float(-special.stdtrit(self.nu, (1 - level) / 2))
        low, high = float(np.interp(t, _T, self.low)), float(np.interp(t, _T, self.high))
        above = min(int(np.searchsorted(_T, t)), len(_T) - 1)  # an end is open from the distance before
        low = low if self.low[above] > -ENDLESS else -np.inf
        return low, high if self.high[above] < ENDLESS else np.inf

    def outside(self, bound: float) -> float:
        """p-value of a difference of `bound` or more in size."""
        signed = [
            np.interp(bound, outer, _T) if value < bound else -np.interp(-bound, -inner, _T)
            for value, outer, inner in (
                (self.value, self.high, self.low),
                (-self.value, -self.low, -self.high),
            )
        ]
        return float(special.stdtr(self.nu, -min(signed)))


def _ratio(difference: _LogRatio | LinearDifference, level: float) -> Ratio:
    """The ratio that a difference of logarithms is; an end beyond all numbers is open."""
    lower, upper = (float(np.exp(end)) if abs(end) < ENDLESS else None for end in difference.ends(level))
    return Ratio(
        float(np.exp(np.clip(difference.value, -ENDLESS, ENDLESS))), ConfidenceInterval(lower, upper)
    )


def _ratios(
    a: _Side, b: _Side, of_c_e: Ratio, pair: Paired | None, exponent: float, level: float
) -> dict[str, Ratio]:
    """Ratios of c_e, which is known as of two sets apart, alpha and the combination."""
    directions = {"alpha": ALPHA, "combination": np.array([-exponent, 1.0])}
    if pair is not None and not pair.one_c_e:
        return {name: _ratio(pair.along(d), level) for name, d in ({"c_e": C_E} | directions).items()}
    ratios = {"c_e": of_c_e} | {
        name: _ratio(_LogRatio(*(side.ends(d[0] * side.x, d) for side in (a, b))), level)
        for name, d in directions.items()
    }
    if pair is not None:
        ratios["combination"] = _ratio(pair.along(directions["combination"]), level)
    if pair is not None and pair.allows_one_c_e:
        for name in ("c_e", "alpha"):  # the sets apart may exclude what the joint test allows
            lower, upper = ratios[name].interval.lower, ratios[name].interval.upper
            interval = ConfidenceInterval(lower and min(lower, 1.0), upper and max(upper, 1.0))
            ratios[name] = replace(ratios[name], interval=interval)
    return ratios


def _joint(a: _Side, b: _Side) -> HypothesisTest:
    """Whether both sets have one c_e and alpha, each with its own scatter."""
    low, high = max(a.domain.low, b.domain.low), min(a.domain.high, b.domain.high)
    if low >= high:
        return HypothesisTest("one material", np.inf, (), 0.0, (
            "The two differ: the data contradict one another: windows of one need more c_e than overloaded runs of "
            "the other allow."
        ))  # fmt: skip
    c_e = np.unique(np.concatenate([a.walk.c_e, b.walk.c_e])[::6])
    c_e = np.unique([low, *c_e[(c_e >= low) & (c_e <= high)], a.fit.c_e, b.fit.c_e, high])
    c_e = c_e[(c_e >= low) & (c_e <= high)]
    golden = (5**0.5 - 1) / 2
    for _ in range(4):
        (of_a, best_a), (of_b, best_b) = a.distance(c_e), b.distance(c_e)
        begin, end = np.minimum(best_a, best_b), np.maximum(best_a, best_b)
        for _ in range(18):
            left, right = end - golden * (end - begin), begin + golden * (end - begin)
            lower = of_a(left) + of_b(left) < of_a(right) + of_b(right)
            begin, end = np.where(lower, begin, left), np.where(lower, right, end)
        total = of_a(begin) + of_b(begin)
        total[~np.isfinite(total)] = np.inf
        i = int(np.argmin(total))
        c_e = np.geomspace(c_e[max(i - 1, 0)], c_e[min(i + 1, len(c_e) - 1)], 25)
    nu = _freedom(*((side.variance, side.scatter2, side.joint.nu) for side in (a, b)))
    freedom: tuple[float, ...] = (2.0, nu) if nu < 1e9 else (2.0,)
    return concluded(
        "one material", float(total.min()) / len(freedom), freedom, "The two {so} (one c_e and alpha): {outcome}.",
        "can be of one material", "differ",
    )  # fmt: skip


def _velocities(
    a: _Side, b: _Side, margin: float | None, level: float, pair: Paired | None
) -> VelocityRatio | None:
    """The velocities that both fits predict over the forces that both sets share, in the default window."""
    rows, middles, law = [], [], a.fit.law
    of_a, of_b = a.fit.observations, b.fit.observations
    for R in np.intersect1d(of_a.radius, of_b.radius).tolist():
        used = [o.force[o.radius == R] for o in (of_a, of_b)]
        # with a window at every c_e
        largest = WINDOW_STOP**law.force_exponent * R**2 * min(a.lowest, b.lowest)
        low, high = max(forces.min() for forces in used), min([largest, *(forces.max() for forces in used)])
        if low > high:
            continue
        force = np.unique(np.geomspace(low, high, _FORCES))
        force[-1] = min(force[-1], high)
        unit = [np.log(law.velocity(force, s.walk.c_e[:, None], 1.0, R)) for s in (a, b)]
        for k, F in enumerate(force.tolist()):
            slopes = [float(np.gradient(h[:, k], s.x)[s.best]) for s, h in zip((a, b), unit, strict=True)]
            ends = (
                side.ends(h[:, k], np.array([slope, 1.0]))
                for side, h, slope in zip((a, b), unit, slopes, strict=True)
            )
            difference: _LogRatio | LinearDifference = (
                pair.along(np.array([float(np.mean(slopes)), 1.0])) if pair else _LogRatio(*ends)
            )
            p = 1.0 if margin is None else difference.outside(float(np.log1p(margin)))
            if k == len(force) // 2:
                middles.append(((R, F), _ratio(difference, level)))
            rows.append((R, F, difference.value, *difference.ends(1 - 2 * ERROR), p))
    if not rows:
        return None
    table = np.array(rows).T
    p_value = None if margin is None else float(table[5].max())
    ratio, lower, upper = np.exp(table[2:5])
    return VelocityRatio(table[0], table[1], ratio, lower, upper, p_value, *middles[0])
