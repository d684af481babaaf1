"""Weber fractions: those that were published, and how they change along a range of references.

With a reference p0 and a threshold at p, the increment is D = |p - p0|, the Weber fraction W = D/p0, the
sensitivity 1/W. The slope of ln W on ln p0 is 0 by Weber's law.

A Weber fraction that was published is used here as the standard deviation of one interval's noise over its
mean. The sources give just noticeable differences, each at its own criterion. No abstract states the
criterion, so the noise could be half or twice the number.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from burrlab.common.check import refuse
from burrlab.common.figures import REFERENCE, VELOCITY, Axes, axes_or_new, drawing, styled
from burrlab.common.table import Tabular, p_text
from burrlab.psychophysics.designs import PARAMETER_KEYS, UNITS, checked_level
from burrlab.psychophysics.psychometric import ThresholdPosterior
from burrlab.psychophysics.rules import Floats, check_level

#: Force. Pang, Tan, Durlach, *Manual discrimination of force using active finger motion*, Perception &
#: Psychophysics 49, 1991. Abstract read: roughly 7 % of the reference, 2.5 to 10 N, one-interval paradigm
#: with feedback, 5 subjects. The forces here, 0.3 to 1.5 N, lie below that range.
FORCE = 0.07

#: Force of one hand, matched by the other. *Force JND for right index finger using contra lateral force
#: matching paradigm*. Abstract read, authors unknown: approximately 10 %, 2 to 5 N, 6 subjects.
FORCE_CONTRALATERAL = 0.10

#: Compliance. Tan, Durlach, Beauregard, Srinivasan, *Manual discrimination of compliance using active pinch
#: grasp: the roles of force and work cues*, Perception & Psychophysics 57, 1995. Abstract read: 22 % where
#: neither work nor terminal force is a useful cue. Without work cues, terminal force explains the results.
COMPLIANCE_WITHOUT_WORK = 0.22

#: Young's modulus of rubber under the fingers. Bergmann Tiest, Kappers, *Cues for haptic perception of
#: compliance*, IEEE Transactions on Haptics 2, 2009. Abstract read: 15 % where the deformation of the surface
#: is felt.
COMPLIANCE_WITH_SURFACE = 0.15

#: Same source: thresholds "more than trebled" without the surface cue. The abstract gives no number, so this
#: value is 3 x 15 %, a lower limit. It is closest to probing, because a burr's handle shows no surface.
COMPLIANCE_WITHOUT_SURFACE = 0.45

#: Exponents "of around two and three" of the elastic constant and the erosion factor. Brelstaff, Agus et al.,
#: *Towards a psychophysical evaluation of a surgical simulator for bone-burring*, APGV 2005, 139-143. Abstract
#: read: it does not say of what they are exponents, nor their sign.
PUBLISHED_EXPONENTS = {"c_e": 2.0, "alpha": 3.0}

_LEAST = 1e-20  # least variance about the lines, so that exact ones have weights
_BEYOND = 4.0  # factor by which a threshold may lie beyond the levels
_NOTHING = 1e3  # error of ln W that says nothing
_STEPS = 100  # to the lines, at most
_STEP, _CLOSE = 2.0, 1e-9  # the longest, and one that ends them, of ln W


@dataclass(frozen=True)
class WeberFraction:
    """A subject's Weber fraction at one reference, at 75 % correct.

    Attributes
    ----------
    subject : str
    reference : float
        p0 [N/mm^2 or 1/ms].
    fraction : float
        W = |p - p0|/p0 [1].
    error : float
        Standard error of ln W; infinite if unknown, for open fractions only.
    session : str
        Names the session among the subject's own; empty if they are not told apart.
    open : bool
        Whether the threshold may lie beyond the levels.
    force : float or None
        Mean force that was pressed in these trials [N], if known.
    bound : (float, float) or None
        c and e of an open fraction: a threshold at W gives such answers in proportion to Phi((ln W - c)/e), where e < 0
        if it may lie nearer to 1 than the levels. None if it may lie at either end, or is not known; the function then
        leaves the fraction out.
    """

    subject: str
    reference: float
    fraction: float
    error: float
    session: str = ""
    open: bool = False
    force: float | None = None
    bound: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("reference", "fraction", "error"):
            number = getattr(self, name)
            refuse(
                not (number > 0.0 and (number < math.inf or (self.open and name == "error"))),
                f"{name} must be above 0 and finite, got {number}",
            )

    @classmethod
    def of_levels(
        cls, levels: Iterable[tuple[float, int, int]], *, subject: str, reference: float, session: str = "",
        force: float | None = None,
    ) -> "WeberFraction":  # fmt: skip
        """The fraction of a task's trials, whatever design chose the levels.

        Parameters
        ----------
        levels : iterable of (float, int, int)
            Ratio to the reference's parameter, all on one side of 1; correct answers; trials.
        subject, reference, session, force
            As above.

        Raises
        ------
        ValueError
            If there is no level, levels lie on both sides of 1, or numbers of answers are wrong.
        """
        rows = [
            (math.log(checked_level("levels", ratio)), correct, trials) for ratio, correct, trials in levels
        ]
        sides = {math.copysign(1.0, difference) for difference, _, _ in rows}
        refuse(len(sides) != 1, f"levels must lie on one side of 1, got {len(rows)} on {len(sides)} sides")
        distances, side = [abs(difference) for difference, _, _ in rows], sides.pop()
        posterior = ThresholdPosterior(min(distances) / _BEYOND, max(distances) * _BEYOND)
        for difference, correct, trials in rows:
            posterior.update(abs(difference), correct, trials)
        threshold, bound = posterior.threshold(side, sum(trials for _, _, trials in rows)), None
        near, fraction, far = (
            abs(x - 1.0) for x in (threshold.interval[0], threshold.level, threshold.interval[1])
        )
        # Towards an open end the posterior rises to its plateau.
        if threshold.open_above is not threshold.open_below:
            end = slice(None, None, 1 if threshold.open_above else -1)
            likely, at = posterior.marginal()[end], np.log(np.abs(np.expm1(side * posterior.thresholds)))[end]
            rise = slice(int(np.argmax(likely)) + 1)
            half, lower = np.interp([0.5, scipy.special.ndtr(-1.0)], likely[rise] / likely.max(), at[rise])
            bound = float(half), float(half - lower)
        return cls(
            subject, reference, fraction, math.log(far / near) / (2.0 * scipy.special.ndtri(0.975)), session,
            threshold.open_below or threshold.open_above, force, bound,
        )  # fmt: skip

    def about(self, ln_w: float) -> tuple[float, float]:
        """A value of ln W and its error that stand for an open fraction about a value (a step of Newton's)."""
        if self.bound is None:
            return ln_w, _NOTHING
        z = (ln_w - self.bound[0]) / self.bound[1]
        mills = math.exp(-0.5 * z**2 - float(scipy.special.log_ndtr(z))) / math.sqrt(2.0 * math.pi)
        error = min(abs(self.bound[1]) / math.sqrt(max(mills * (z + mills), _LEAST)), _NOTHING)
        return ln_w + mills * error**2 / self.bound[1], error


@dataclass(frozen=True)
class GroupMean:
    """A mean over subjects, each known with an error of its own; errors may be correlated.

    Weights are those of the variance between subjects by Paule and Mandel, the interval is Hartung and
    Knapp's: by t with a degree of freedom less than subjects. Where all subjects are known equally well and
    independently, this is the t interval of their plain mean. It is never shorter than the normal interval by
    the subjects' errors alone.

    Attributes
    ----------
    mean : float
    error : float
        Standard error.
    interval : (float, float)
        Infinite for one subject.
    between : float
        Standard deviation between subjects; 0 if they differ by no more than their errors.
    subjects : int

    References
    ----------
    R. C. Paule, J. Mandel, Consensus values and weighting factors, J. Res. Natl. Bur. Stand. 87 (1982) 377-385.
    J. Hartung, G. Knapp, On tests of the overall treatment effect in meta-analysis with normally distributed
    responses, Stat. Med. 20 (2001) 1771-1782.
    """

    mean: float
    error: float
    interval: tuple[float, float]
    between: float
    subjects: int

    @classmethod
    def of(cls, estimates: Sequence[float] | Floats, covariance: Floats, level: float) -> "GroupMean":
        """The mean of estimates whose errors have this covariance, shape (subjects, subjects)."""
        x, freedom = np.asarray(estimates, dtype=np.float64), len(estimates) - 1

        def mean_with(between: float) -> tuple[float, float, float]:
            weights = np.linalg.inv(covariance + between * np.eye(len(x)))
            mean = float(weights.sum(axis=0) @ x / weights.sum())
            return mean, float((x - mean) @ weights @ (x - mean)), float(weights.sum() ** -0.5)

        variance, most = 0.0, len(x) * float(np.ptp(x)) ** 2
        if freedom and mean_with(0.0)[1] > freedom:
            variance = float(scipy.optimize.brentq(lambda v: mean_with(v)[1] - freedom, 0.0, most))
        mean, misfit, error = mean_with(variance)
        wide = math.inf
        if freedom:
            t, normal = (float(scipy.stats.t.ppf(0.5 + 0.5 * level, x)) for x in (freedom, math.inf))
            error *= max(math.sqrt(misfit / freedom), normal / t)  # by 1 unless the variance is 0
            wide = t * error
        return cls(mean, error, (mean - wide, mean + wide), math.sqrt(variance), len(x))

    def p_value(self) -> float:
        """Of the hypothesis that the mean is 0, two-sided; 1 for one subject."""
        return (
            2.0 * float(scipy.stats.t.sf(abs(self.mean) / self.error, self.subjects - 1))
            if self.subjects > 1
            else 1.0
        )

    def against(self, zero: str) -> str:
        """The mean, what 0 would mean, and the `p_value`; of one subject there is none."""
        p = f", p = {p_text(self.p_value())}" if self.subjects > 1 else ""
        return f"{self}{zero and f'; 0 is {zero}'}{p}"

    def __str__(self) -> str:
        if self.subjects < 2:
            return f"{self.mean:.2f} +- {self.error:.2f} (one subject: nothing is said of others)"
        alone = ", no more than their errors do: a singular fit" * (self.between == 0.0)
        return (
            f"{self.mean:.2f}, {self.interval[0]:.2f} to {self.interval[1]:.2f} ({self.subjects} subjects, who differ by "
            f"{self.between:.2f}{alone})"
        )


@dataclass(frozen=True, eq=False)
class SensitivityFunction(Tabular):
    """Weber fractions of subjects along references: ln W = level + slope ln(p0/center).

    Each subject has a level and a slope of his own, by least squares with weights 1/error^2; sessions have
    effects that all subjects share. A fraction that is open counts by its `bound`: were it left out, the slope would
    be biased towards 0. The scatter about these lines, pooled, sets the scale of the errors, as weights do in lmer.
    The group's values are means over the subjects, whose errors the sessions correlate.

    Attributes
    ----------
    parameter : {"c_e", "alpha"}
    name : str
        What was varied, and how, in words.
    fractions, left_out : tuple of WeberFraction
        Those used; those of a subject without two references that are not open, and those open without a bound.
    center : float
        Geometric mean of the references used [N/mm^2 or 1/ms].
    lines : mapping of str to ndarray
        Each subject's level and slope at `center`.
    covariance : ndarray, shape (subjects, 2, subjects, 2)
        Of the errors of all levels and slopes.
    slope, level, curvature : GroupMean
        Group's means: slope of ln W on ln p0, ln W at the center, and second derivative (None without three
        references a subject).
    scale : float
        Scatter about the lines over the errors; 1 without degrees of freedom.
    freedom : int
        Degrees of freedom of the scatter.
    sessions : int
        Sessions with effects of their own; 1 if their effects cannot be told from the slopes.
    confidence : float
        Of all intervals.
    at_equal_force : GroupMean or None
        The group's slope with ln of the pressed force beside ln p0, which all subjects share. A secondary analysis:
        the force follows from the bone, so this corrects nothing. None if forces are unknown, or cannot be told
        from the references.
    """

    parameter: str
    name: str
    fractions: tuple[WeberFraction, ...]
    left_out: tuple[WeberFraction, ...]
    center: float
    lines: Mapping[str, Floats]
    covariance: Floats
    slope: GroupMean
    level: GroupMean
    curvature: GroupMean | None
    scale: float
    freedom: int
    sessions: int
    confidence: float
    at_equal_force: GroupMean | None = None

    @classmethod
    def of(
        cls,
        fractions: Iterable[WeberFraction],
        parameter: str = "c_e",
        *,
        name: str = "",
        level: float = 0.95,
    ) -> "SensitivityFunction":
        """The function of these fractions.

        Parameters
        ----------
        fractions : iterable of WeberFraction
        parameter : {"c_e", "alpha"}
        name : str
            In words, for the report; by default the parameter.
        level : float
            Of the intervals, in [0.5, 1).

        Raises
        ------
        ValueError
            If no subject has two references, or the parameter or the level is none of the above.

        Examples
        --------
        >>> rows = [WeberFraction(who, p0, w * p0**-0.5, 0.1) for who, w in (("a", 0.2), ("b", 0.3)) for p0 in (1, 2, 4)]
        >>> f"{SensitivityFunction.of(rows).slope.mean:.2f}"
        '-0.50'
        """
        check_level(level)
        refuse(parameter not in UNITS, f"parameter must be one of {', '.join(UNITS)}, got {parameter!r}")
        rows = list(fractions)
        used = usable(rows)
        refuse(
            not used, "fractions must hold a subject with two references or more that are not open, got none"
        )
        center = math.exp(float(np.mean(np.log([row.reference for row in used]))))
        lines, covariance, freedom, scale, sessions = _regression(used, center, 1)
        levels, slopes = (
            GroupMean.of([line[i] for line in lines.values()], covariance[:, i, :, i], level) for i in (0, 1)
        )
        curved, curvature, equal = usable(rows, 3), None, None
        if curved:
            parabolas, errors, *_ = _regression(curved, center, 2)
            curvature = GroupMean.of(
                [2.0 * line[2] for line in parabolas.values()], 4.0 * errors[:, 2, :, 2], level
            )
        if all(row.force for row in used):
            beside, errors, _, _, sessions_beside = _regression(used, center, 1, force=True)
            if sessions_beside >= sessions:
                equal = GroupMean.of([line[1] for line in beside.values()], errors[:, 1, :, 1], level)
        return cls(
            parameter, name or parameter, tuple(used), tuple(row for row in rows if row not in used), center, lines,
            covariance, slopes, levels, curvature, scale, freedom, sessions, level, equal,
        )  # fmt: skip

    def _table(self) -> Mapping[str, Sequence[Any]]:
        """A row a subject and reference: W with its interval; those left out last."""
        rows = [*self.fractions, *self.left_out]
        factor = [math.exp(self._normal * row.error) if row.error < math.inf else math.inf for row in rows]
        return {
            "subject": [row.subject for row in rows],
            PARAMETER_KEYS[self.parameter]: [row.reference for row in rows],
            "W": [row.fraction for row in rows],
            "W_low": [row.fraction / x for row, x in zip(rows, factor, strict=True)],
            "W_high": [row.fraction * x for row, x in zip(rows, factor, strict=True)],
            "session": [row.session for row in rows],
            "force_N": [row.force for row in rows],
            "left_out": [i >= len(self.fractions) for i in range(len(rows))],
        }

    @property
    def _normal(self) -> float:
        """Quantile of the normal distribution for the intervals."""
        return float(scipy.stats.norm.ppf(0.5 + 0.5 * self.confidence))

    def slope_of(self, subject: str) -> tuple[float, float, float]:
        """A subject's own slope, and its interval by t with `freedom` degrees, normal with none.

        Raises
        ------
        ValueError
            If the subject is not in the function.
        """
        refuse(subject not in self.lines, f"subject must be one of {', '.join(self.lines)}, got {subject!r}")
        place, slope = list(self.lines).index(subject), float(self.lines[subject][1])
        quantile = scipy.stats.t.ppf(0.5 + 0.5 * self.confidence, self.freedom or math.inf)
        wide = float(quantile * self.covariance[place, 1, place, 1] ** 0.5)
        return slope, slope - wide, slope + wide

    def difference(self, other: "SensitivityFunction") -> GroupMean:
        """This slope less another's, over the subjects in both.

        Raises
        ------
        ValueError
            If no subject is in both.
        """
        both = [subject for subject in self.lines if subject in other.lines]
        refuse(not both, "other must hold a subject of this function, got none")
        covariance: Floats = np.zeros((len(both), len(both)))
        for function in (self, other):
            places = [list(function.lines).index(subject) for subject in both]
            covariance += function.covariance[:, 1, :, 1][np.ix_(places, places)]
        slopes = [float(self.lines[subject][1] - other.lines[subject][1]) for subject in both]
        return GroupMean.of(slopes, covariance, self.confidence)

    def fraction_at(self, reference: float) -> tuple[float, float, float]:
        """The group's W at a reference p0, and its interval."""
        at = np.array([1.0, math.log(reference / self.center)])
        logarithms = [float(line @ at) for line in self.lines.values()]
        group = GroupMean.of(logarithms, np.einsum("iajb,a,b->ij", self.covariance, at, at), self.confidence)
        # at each reference the subjects weigh otherwise, so the line is that of the mean slope
        line, wide = self.level.mean + self.slope.mean * at[1], group.interval[1] - group.mean
        with np.errstate(over="ignore"):  # one subject, or few who differ much
            mean, low, high = np.exp([line, line - wide, line + wide]).tolist()
        return mean, low, high

    def __str__(self) -> str:
        references = sorted({row.reference for row in self.fractions})
        unit, percent = UNITS[self.parameter], f"{100 * self.confidence:g} %"
        w = ("{:.3f}, {:.3f} to {:.3f}" if self.slope.subjects > 1 else "{:.3f}").format(
            *self.fraction_at(self.center)
        )
        lines = [
            f"{self.name}: {len(references)} references, {references[0]:.3g} to {references[-1]:.3g} {unit}; {percent} "
            "intervals by t, the subject as the unit",
            f"slope of ln W on ln {self.parameter}: " + self.slope.against("Weber's law"),
            f"W at {self.center:.3g} {unit}: {w}",
            "slopes: " + ", ".join(
                "{} {:.2f} ({:.2f} to {:.2f})".format(subject, *self.slope_of(subject)) for subject in self.lines
            ),
            f"scatter about the lines: {self.scale:.2f} times the errors ({self.freedom} degrees of freedom)",
            "curvature: not known without three references of a subject" if self.curvature is None else
            f"curvature: {self.curvature.against('a power law')}",
        ]  # fmt: skip
        if (n := len({row.session for row in self.fractions})) > 1:
            lines.append(
                f"effects of the {n} sessions "
                + (
                    "cannot be told from the slopes and are left out"
                    if self.sessions < n
                    else "are taken out"
                )
            )
        if all(row.force for row in self.fractions):
            pressed = ", ".join(
                f"{np.mean([row.force for row in self.fractions if row.reference == p0]):.2g} N at {p0:.3g}"
                for p0 in references
            )
            beside = self.at_equal_force or "cannot be told from the references"
            lines.append(f"pressed: {pressed}; the slope at equal force, which corrects nothing: {beside}")
        everyone = [*self.fractions, *self.left_out]
        for rows, why in (
            ([row for row in self.fractions if row.open], "may lie beyond the levels, and count as such"),
            (
                self.left_out,
                "are left out, as their subjects have no other within the levels, or as they may lie beyond either end",
            ),
        ):
            if names := ", ".join(dict.fromkeys(f"{row.subject} at {row.reference:.3g}" for row in rows)):
                lines.append(f"{len(rows)} of {len(everyone)} {why}: {names}")
        if 2 * sum(row.open for row in everyone) >= len(everyone):
            lines.append("where half of them may lie beyond the levels, the slope is biased towards 0")
        return "\n".join(lines)

    @drawing
    def plot(self, ax: Axes | None = None, *, published: bool = True, **style: Any) -> Axes:
        """Sensitivity 1/W over the reference, both logarithmic: subjects with intervals, group with its band.

        A hollow triangle points to where the threshold of an open fraction may lie.

        `style`: properties of the group's line.

        Parameters
        ----------
        published : bool
            Whether the four readings of the exponent that was published, whose definition is unknown, go
            through the middle: of 1/W or of the increment D, rising or falling.
        """
        ax = axes_or_new(ax)
        ax.set(xscale="log", yscale="log")
        for i, (subject, line) in enumerate(self.lines.items()):
            rows = sorted(
                (row for row in self.fractions if row.subject == subject), key=lambda row: row.reference
            )
            drawn_at = np.array([rows[0].reference, rows[-1].reference])
            look: dict[str, Any] = {"color": REFERENCE, "alpha": 0.5, "linewidth": 0.8}
            for row in rows:
                if row.bound is not None:
                    mark = "v" if row.bound[1] > 0.0 else "^"
                    ax.plot(row.reference, math.exp(-row.bound[0]), mark, mfc="none", ms=4, **look)
            rows = [row for row in rows if not row.open]
            x, w, error = np.array([(row.reference, row.fraction, row.error) for row in rows]).T
            wide = np.exp(self._normal * error)
            ax.errorbar(
                x,
                1.0 / w,
                [(1.0 - 1.0 / wide) / w, (wide - 1.0) / w],
                fmt="o",
                ms=2.5,
                elinewidth=0.6,
                **look,
            )
            drawn = np.exp(-line[0] - line[1] * np.log(drawn_at / self.center))
            ax.plot(drawn_at, drawn, **look, label="subjects" if i == 0 else None)
        if any(row.open for row in self.fractions):
            ax.plot([], [], "v", mfc="none", ms=4, **look, label="may lie beyond the levels")
        references = [row.reference for row in self.fractions]
        span = np.geomspace(min(references), max(references), 200)
        w, low, high = np.array([self.fraction_at(float(p0)) for p0 in span]).T
        look = styled(style, color=VELOCITY, linewidth=1.8)
        ax.plot(span, 1.0 / w, **({"label": f"group, whose mean slope is {-self.slope.mean:.2f}"} | look))
        if self.slope.subjects > 1:
            ax.fill_between(span, 1.0 / high, 1.0 / low, color=look["color"], alpha=0.2, linewidth=0)
        bottom, top = ax.get_ylim()
        exponent, middle = PUBLISHED_EXPONENTS[self.parameter], 1.0 / self.fraction_at(self.center)[0]
        label = f"published exponent {exponent:g}, definition\nunknown: four readings through the middle"
        for slope in (exponent, -exponent, 1.0 - exponent, 1.0 + exponent) if published else ():
            reading = middle * (span / self.center) ** slope
            shown = (bottom <= reading) & (reading <= top)
            ax.plot(span[shown], reading[shown], ":", color="0.6", linewidth=0.9, zorder=0,
                    label=label if slope == exponent else None)  # fmt: skip
        ax.set(xlabel=f"{self.parameter} of the reference [{UNITS[self.parameter]}]", ylim=(bottom, top),
               ylabel=f"sensitivity 1/W [1], {100 * self.confidence:g} % intervals", title=self.name)  # fmt: skip
        return ax


def subjects_for_slope(
    error: float, references: Sequence[float], between: float, *, half_width: float = 0.3, apart: float = 1.0
) -> tuple[int, int]:
    """Fewest subjects of a planned experiment, by the formulas of the t distribution.

    Parameters
    ----------
    error : float
        Standard error of a subject's ln W at one reference: ln of the factor that a design's `power` tells.
    references : sequence of float
        Two or more.
    between : float
        Standard deviation of the subjects' slopes.
    half_width : float
        Half width of the slope's 95 % interval, in the root mean square over experiments.
    apart : float
        A difference between two slopes of all subjects, which are independent within a subject.

    Returns
    -------
    (int, int)
        Until the slope is known to `half_width`; until slopes `apart` are told apart with 80 % power at 5 %.

    Raises
    ------
    ValueError
        If the references are all alike, or 10 000 subjects are too few.

    Examples
    --------
    >>> subjects_for_slope(0.3, [0.25, 0.5, 1, 2, 4], 0.4)
    (11, 6)
    """
    refuse(
        len({*references}) < 2 or min(references) <= 0,
        f"references must be above 0 and differ, got {list(references)}",
    )
    spread = float(np.sum((np.log(references) - np.mean(np.log(references))) ** 2))
    sd = math.hypot(between, error / math.sqrt(spread))
    n = np.arange(2, 10_001)
    t = scipy.stats.t.ppf(0.975, n - 1)
    power = scipy.stats.nct.sf(t, n - 1, apart / (math.sqrt(2.0) * sd) * np.sqrt(n))
    known, distinct = n[np.less_equal(t * sd / np.sqrt(n), half_width)], n[np.greater_equal(power, 0.8)]
    refuse(not (len(known) and len(distinct)), "half_width and apart must be within reach of 10 000 subjects")
    return int(known[0]), int(distinct[0])


def usable(fractions: Iterable[WeberFraction], references: int = 2) -> list[WeberFraction]:
    """The fractions of subjects with so many references or more, alike to nine digits, that are not open."""
    rows = list(fractions)
    known = Counter(subject for subject, _ in {(x.subject, f"{x.reference:.9g}") for x in rows if not x.open})
    return [row for row in rows if known[row.subject] >= references and (row.bound or not row.open)]


def _regression(
    rows: Sequence[WeberFraction], center: float, degree: int, *, force: bool = False
) -> tuple[dict[str, Floats], Floats, int, float, int]:
    """Subjects' polynomials of ln W in ln(p0/center), covariance, degrees of freedom, scale of errors, sessions.

    With `force` its logarithm stands beside. If it cannot be told from the rest, there are 0 sessions.
    """
    subjects, sessions = (sorted({getattr(row, name) for row in rows}) for name in ("subject", "session"))
    design = np.zeros((len(rows), len(subjects), degree + 1))
    for line, row in zip(design, rows, strict=True):
        line[subjects.index(row.subject)] = math.log(row.reference / center) ** np.arange(degree + 1)
    own = design.reshape(len(rows), -1)
    shared = np.array([
        [float(row.session == session) for session in sessions[1:]] + [np.log(row.force or 1.0)] * force
        for row in rows
    ])  # fmt: skip
    closed, weights = (
        np.array([not row.open for row in rows]),
        np.array([0.0 if row.open else 1.0 / row.error for row in rows]),
    )

    def rank(*columns: Floats) -> int:
        return int(np.linalg.matrix_rank(np.hstack(columns) * weights[:, None]))

    slopes = np.arange(own.shape[1]) % (degree + 1) > 0
    if shared.shape[1] and rank(own, shared) < rank(own[:, ~slopes], shared) + slopes.sum():
        if len(sessions) == 1:
            return {}, np.zeros((0, 0, 0, 0)), 0, 1.0, 0
        return _regression([replace(row, session="") for row in rows], center, degree, force=force)
    # subjects of other sessions than the first may have levels that stand for one of theirs
    kept = [k for k in range(shared.shape[1]) if rank(own, shared[:, k:]) > rank(own, shared[:, k + 1 :])]
    coefficients, matrix, misfit = _solved(rows, np.hstack([own, shared[:, kept]]), weights)
    freedom = max(int(closed.sum()) - matrix.shape[1], 0)
    variance = max(float(misfit @ misfit) / freedom, _LEAST) if freedom else 1.0
    size, shape = own.shape[1], design.shape[1:]
    covariance = np.linalg.inv(matrix.T @ matrix)[:size, :size].reshape(*shape, *shape) * variance
    lines = dict(zip(subjects, coefficients[:size].reshape(shape), strict=True))
    return lines, covariance, freedom, math.sqrt(variance), len(sessions)


def _solved(rows: Sequence[WeberFraction], columns: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Coefficients, weighted columns, and weighted misfits of the rows that are not open."""
    values, last = np.log([row.fraction for row in rows]), None
    is_open = {i: row for i, row in enumerate(rows) if row.open}
    for _ in range(_STEPS):
        matrix, weighted = columns * weights[:, None], values * weights
        coefficients = np.asarray(np.linalg.lstsq(matrix, weighted, rcond=None)[0], np.float64)
        fitted = columns @ coefficients
        if not is_open or (last is not None and np.abs(fitted - last).max() < _CLOSE):
            break
        last = fitted if last is None else last + np.clip(fitted - last, -_STEP, _STEP)
        for i, row in is_open.items():
            values[i], error = row.about(float(last[i]))
            weights[i] = 1.0 / error
    return coefficients, matrix, np.delete(matrix @ coefficients - weighted, list(is_open))
