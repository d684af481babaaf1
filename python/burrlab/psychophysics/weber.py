"""Weber fractions: those that were published, and how they change along a range of references.

With a reference p0 and a threshold at p, the increment is D = |p - p0|, the Weber fraction W = D/p0, the
sensitivity 1/W. The slope of ln W on ln p0 is 0 by Weber's law.

A Weber fraction that was published is used here as the standard deviation of one interval's noise over its
mean. The sources give just noticeable differences, each at its own criterion. No abstract states the
criterion, so the noise could be half or twice the number.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes

from burrlab.common.check import refuse
from burrlab.common.figures import REFERENCE, VELOCITY, axes_or_new, drawing, styled
from burrlab.common.table import p_text
from burrlab.psychophysics.designs import UNITS
from burrlab.psychophysics.psychometric import ThresholdPosterior, threshold_of
from burrlab.psychophysics.rules import Floats

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
        Standard error of ln W.
    session : str
        Names the session among the subject's own; empty if they are not told apart.
    open : bool
        Whether the threshold may lie beyond the levels; such a fraction is left out of the function.
    """

    subject: str
    reference: float
    fraction: float
    error: float
    session: str = ""
    open: bool = False

    def __post_init__(self) -> None:
        for name in ("reference", "fraction", "error"):
            number = getattr(self, name)
            refuse(
                not (math.isfinite(number) and number > 0.0),
                f"{name} must be above 0 and finite, got {number}",
            )

    @classmethod
    def of_levels(
        cls, levels: Iterable[tuple[float, int, int]], *, subject: str, reference: float, session: str = ""
    ) -> "WeberFraction":
        """The fraction of a task's trials, whatever design chose the levels.

        Parameters
        ----------
        levels : iterable of (float, int, int)
            Ratio to the reference's parameter, all on one side of 1; correct answers; trials.
        subject, reference, session
            As above.

        Raises
        ------
        ValueError
            If there is no level, or levels lie on both sides of 1.
        """
        rows = [(math.log(ratio), correct, trials) for ratio, correct, trials in levels]
        sides = {math.copysign(1.0, difference) for difference, _, _ in rows}
        refuse(len(sides) != 1, f"levels must lie on one side of 1, got {len(rows)} on {len(sides)} sides")
        distances = [abs(difference) for difference, _, _ in rows]
        posterior = ThresholdPosterior(min(distances) / _BEYOND, max(distances) * _BEYOND)
        for difference, correct, trials in rows:
            posterior.update(abs(difference), correct, trials)
        threshold = threshold_of(posterior, sides.pop(), sum(trials for _, _, trials in rows), 0.95)
        near, fraction, far = (
            abs(x - 1.0) for x in (threshold.interval[0], threshold.level, threshold.interval[1])
        )
        return cls(
            subject, reference, fraction, math.log(far / near) / (2.0 * _Z), session,
            threshold.open_below or threshold.open_above,
        )  # fmt: skip


_Z = 1.959963984540054  # of a 95 % interval


@dataclass(frozen=True)
class GroupMean:
    """A mean over subjects, each known with an error of its own.

    The variance between subjects is Paule and Mandel's; the interval is by t with a degree of freedom less
    than subjects.

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
    """

    mean: float
    error: float
    interval: tuple[float, float]
    between: float
    subjects: int

    @classmethod
    def of(cls, estimates: Sequence[float], errors: Sequence[float], level: float) -> "GroupMean":
        x, within = np.asarray(estimates, dtype=np.float64), np.square(np.asarray(errors, dtype=np.float64))
        n = len(x)

        def mean_with(between: float) -> tuple[float, float, float]:
            weights = 1.0 / (within + between)
            mean = float(weights @ x / weights.sum())
            return mean, float(weights @ (x - mean) ** 2) - (n - 1), float(weights.sum() ** -0.5)

        variance, most = 0.0, n * float(np.ptp(x)) ** 2
        if n > 1 and mean_with(0.0)[1] > 0.0:
            variance = float(scipy.optimize.brentq(lambda v: mean_with(v)[1], 0.0, most))
        mean, _, error = mean_with(variance)
        wide = float(scipy.stats.t.ppf(0.5 + 0.5 * level, n - 1)) * error if n > 1 else math.inf
        return cls(mean, error, (mean - wide, mean + wide), math.sqrt(variance), n)

    def p_value(self) -> float:
        """Of the hypothesis that the mean is 0, two-sided; 1 for one subject."""
        return (
            2.0 * float(scipy.stats.t.sf(abs(self.mean) / self.error, self.subjects - 1))
            if self.subjects > 1
            else 1.0
        )

    def __str__(self) -> str:
        if self.subjects < 2:
            return f"{self.mean:.2f} +- {self.error:.2f} (one subject: nothing is said of others)"
        alone = ", no more than their errors do: a singular fit" * (self.between == 0.0)
        return (
            f"{self.mean:.2f}, {self.interval[0]:.2f} to {self.interval[1]:.2f} ({self.subjects} subjects, who differ by "
            f"{self.between:.2f}{alone})"
        )


@dataclass(frozen=True)
class SensitivityFunction:
    """Weber fractions of subjects along references: ln W = level + slope ln(p0/center).

    Each subject has a level and a slope of his own, by least squares with weights 1/error^2; sessions have
    effects that all subjects share. The scatter about these lines sets the scale of the errors. The group's
    values are means over the subjects.

    Attributes
    ----------
    parameter : {"c_e", "alpha"}
    name : str
        What was varied, and how, in words.
    fractions, left_out : tuple of WeberFraction
        Those used; those that are open, or of a subject with one reference only.
    center : float
        Geometric mean of the references used [N/mm^2 or 1/ms].
    lines : mapping of str to ndarray
        Each subject's level and slope at `center`, then their covariance: 3 rows of 2.
    slope, level, curvature : GroupMean
        Group's means: slope of ln W on ln p0, ln W at the center, and second derivative (None without three
        references a subject).
    scale : float
        Scatter about the lines over the errors; 1 without degrees of freedom.
    sessions : int
        Sessions with effects of their own; 1 if their effects cannot be told from the slopes.
    confidence : float
        Of all intervals.

    References
    ----------
    R. C. Paule, J. Mandel, Consensus values and weighting factors, J. Res. Natl. Bur. Stand. 87 (1982) 377-385.
    """

    parameter: str
    name: str
    fractions: tuple[WeberFraction, ...]
    left_out: tuple[WeberFraction, ...]
    center: float
    lines: Mapping[str, Floats]
    slope: GroupMean
    level: GroupMean
    curvature: GroupMean | None
    scale: float
    sessions: int
    confidence: float

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
            Of the intervals.

        Raises
        ------
        ValueError
            If no subject has two references.

        Examples
        --------
        >>> rows = [WeberFraction(who, p0, w * p0**-0.5, 0.1) for who, w in (("a", 0.2), ("b", 0.3)) for p0 in (1, 2, 4)]
        >>> f"{SensitivityFunction.of(rows).slope.mean:.2f}"
        '-0.50'
        """
        rows = list(fractions)
        used = usable(rows)
        refuse(not used, "fractions must hold a subject with two references or more, got none")
        center = math.exp(float(np.mean(np.log([row.reference for row in used]))))
        lines, scale, sessions = _regression(used, center, 1)
        levels, slopes = (
            GroupMean.of(
                [line[0, i] for line in lines.values()],
                [line[1 + i, i] ** 0.5 for line in lines.values()],
                level,
            )
            for i in (0, 1)
        )
        curved, curvature = usable(rows, 3), None
        if curved:
            parabolas = _regression(curved, center, 2)[0].values()
            bends = [2.0 * line[0, 2] for line in parabolas], [2.0 * line[3, 2] ** 0.5 for line in parabolas]
            curvature = GroupMean.of(*bends, level)
        return cls(
            parameter, name or parameter, tuple(used), tuple(row for row in rows if row not in used), center, lines,
            slopes, levels, curvature, scale, sessions, level,
        )  # fmt: skip

    def difference(self, other: "SensitivityFunction") -> GroupMean:
        """This slope less another's, over the subjects in both.

        Raises
        ------
        ValueError
            If no subject is in both.
        """
        both = [subject for subject in self.lines if subject in other.lines]
        refuse(not both, "other must hold a subject of this function, got none")
        pairs = [(self.lines[subject], other.lines[subject]) for subject in both]
        return GroupMean.of(
            [a[0, 1] - b[0, 1] for a, b in pairs],
            [(a[2, 1] + b[2, 1]) ** 0.5 for a, b in pairs],
            self.confidence,
        )

    def fraction_at(self, reference: float) -> tuple[float, float, float]:
        """The group's W at a reference p0, and its interval."""
        at = np.array([1.0, math.log(reference / self.center)])
        group = GroupMean.of(
            [float(line[0] @ at) for line in self.lines.values()],
            [math.sqrt(at @ line[1:] @ at) for line in self.lines.values()], self.confidence,
        )  # fmt: skip
        mean, low, high = (math.exp(min(x, 700.0)) for x in (group.mean, *group.interval))
        return mean, low, high

    def __str__(self) -> str:
        references = sorted({row.reference for row in self.fractions})
        unit, percent = UNITS[self.parameter], f"{100 * self.confidence:g} %"
        w = "{:.3f}, {:.3f} to {:.3f}".format(*self.fraction_at(self.center))
        lines = [
            f"{self.name}: {len(references)} references, {references[0]:.3g} to {references[-1]:.3g} {unit}; {percent} "
            "intervals by t, the subject as the unit",
            f"slope of ln W on ln {self.parameter}: {self.slope}; 0 is Weber's law, p = {p_text(self.slope.p_value())}",
            f"W at {self.center:.3g} {unit}: {w}",
        ]
        if self.curvature is not None:
            lines.append(
                f"curvature: {self.curvature}; 0 is a power law, p = {p_text(self.curvature.p_value())}"
            )
        if self.sessions < len({row.session for row in self.fractions}):
            lines.append("effects of the sessions cannot be told from the slopes and are left out")
        if self.left_out:
            rows = ", ".join(f"{row.subject} at {row.reference:.3g}" for row in self.left_out)
            lines.append(
                f"left out, as the threshold may lie beyond the levels or nothing is beside it: {rows}"
            )
        return "\n".join(lines)

    @drawing
    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Sensitivity 1/W over the reference, both logarithmic: subjects, group with its band.

        Through the middle go the four readings of the exponent that was published, whose definition is
        unknown: of 1/W or of the increment D, rising or falling. `style`: properties of the group's line.
        """
        ax = axes_or_new(ax)
        ax.set(xscale="log", yscale="log")
        for i, (subject, line) in enumerate(self.lines.items()):
            rows = sorted(
                (row for row in self.fractions if row.subject == subject), key=lambda row: row.reference
            )
            x, w = np.array([row.reference for row in rows]), np.array([row.fraction for row in rows])
            error = np.exp([row.error for row in rows])
            look: dict[str, Any] = {"color": REFERENCE, "alpha": 0.5, "linewidth": 0.8}
            ax.errorbar(
                x,
                1.0 / w,
                [(1.0 - 1.0 / error) / w, (error - 1.0) / w],
                fmt="o",
                ms=2.5,
                elinewidth=0.6,
                **look,
            )
            drawn = np.exp(-line[0, 0] - line[0, 1] * np.log(x[[0, -1]] / self.center))
            ax.plot(x[[0, -1]], drawn, **look, label="subjects" if i == 0 else None)
        references = [row.reference for row in self.fractions]
        span = np.geomspace(min(references), max(references), 200)
        w, low, high = np.array([self.fraction_at(float(p0)) for p0 in span]).T
        look = styled(style, color=VELOCITY, linewidth=1.8)
        ax.plot(span, 1.0 / w, **({"label": f"group, slope {-self.slope.mean:.2f}"} | look))
        if self.slope.subjects > 1:
            ax.fill_between(span, 1.0 / high, 1.0 / low, color=look["color"], alpha=0.2, linewidth=0)
        bottom, top = ax.get_ylim()
        exponent, middle = PUBLISHED_EXPONENTS[self.parameter], 1.0 / self.fraction_at(self.center)[0]
        for slope in (exponent, -exponent, 1.0 - exponent, 1.0 + exponent):
            reading = middle * (span / self.center) ** slope
            shown = (bottom <= reading) & (reading <= top)
            ax.plot(span[shown], reading[shown], ":", color="0.6", linewidth=0.9, zorder=0)
        ax.plot(
            [], [], ":", color="0.6", label=f"published exponent {exponent:g},\ndefinition unknown, no level"
        )
        unit = UNITS[self.parameter]
        ax.set(xlabel=f"{self.parameter} of the reference [{unit}]", ylim=(bottom, top),
               ylabel=f"sensitivity 1/W [1], {100 * self.confidence:g} % band", title=self.name)  # fmt: skip
        ax.legend(fontsize=7)
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
        Expected half width of the slope's 95 % interval.
    apart : float
        A difference between two slopes, both felt by all subjects.

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
    spread = float(np.sum((np.log(references) - np.mean(np.log(references))) ** 2))
    refuse(not spread > 0.0, f"references must differ, got {list(references)}")
    sd = math.hypot(between, error / math.sqrt(spread))
    n = np.arange(2, 10_001)
    t = scipy.stats.t.ppf(0.975, n - 1)
    power = scipy.stats.nct.sf(t, n - 1, apart / (math.sqrt(2.0) * sd) * np.sqrt(n))
    known, distinct = n[np.less_equal(t * sd / np.sqrt(n), half_width)], n[np.greater_equal(power, 0.8)]
    beyond = min(len(known), len(distinct)) == 0
    refuse(beyond, "half_width and apart must be within reach of 10 000 subjects")
    return int(known[0]), int(distinct[0])


def usable(fractions: Iterable[WeberFraction], references: int = 2) -> list[WeberFraction]:
    """The fractions that are not open, of subjects with so many references or more."""
    closed = [row for row in fractions if not row.open]
    known: dict[str, set[float]] = {}
    for row in closed:
        known.setdefault(row.subject, set()).add(row.reference)
    return [row for row in closed if len(known[row.subject]) >= references]


def _regression(
    rows: Sequence[WeberFraction], center: float, degree: int
) -> tuple[dict[str, Floats], float, int]:
    """Each subject's polynomial of ln W in ln(p0/center), its covariance below; scale of the errors; sessions."""
    subjects, sessions = (sorted({getattr(row, name) for row in rows}) for name in ("subject", "session"))
    design = np.zeros((len(rows), len(subjects), degree + 1))
    for line, row in zip(design, rows, strict=True):
        line[subjects.index(row.subject)] = math.log(row.reference / center) ** np.arange(degree + 1)
    own = design.reshape(len(rows), -1)
    shared = np.array([[float(row.session == session) for session in sessions[1:]] for row in rows])
    weights = 1.0 / np.array([row.error for row in rows])
    matrix = np.hstack([own, shared]) * weights[:, None]
    if (rank := int(np.linalg.matrix_rank(matrix))) < matrix.shape[1]:
        return _regression([replace(row, session="") for row in rows], center, degree)
    weighted = np.log([row.fraction for row in rows]) * weights
    coefficients = np.linalg.lstsq(matrix, weighted)[0]
    free, misfit = len(rows) - rank, matrix @ coefficients - weighted
    variance = max(float(misfit @ misfit) / free, _LEAST) if free else 1.0
    covariance = np.linalg.inv(matrix.T @ matrix) * variance
    size = degree + 1
    places = {subject: slice(i * size, (i + 1) * size) for i, subject in enumerate(subjects)}
    lines = {name: np.vstack([coefficients[at], covariance[at, at]]) for name, at in places.items()}
    return lines, math.sqrt(variance), len(sessions)
