"""Tests of a fit: whether the data contradict the model, which rows stand out, what units they suggest."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import special

from burrlab.bone.materials import materials
from burrlab.common.progress import doing
from burrlab.common.table import holm, probability_text
from burrlab.fitting.calibration import AnyCalibration
from burrlab.fitting.likelihood import MODEL_ERROR, Likelihood
from burrlab.fitting.observations import Bounds, Data, Floats, Observations, bounds_of
from burrlab.fitting.profile import ConfidenceInterval, Domain, Walk, c_e_interval, lowest
from burrlab.fitting.verdict import span
from burrlab.measured.curve import VelocityCurve
from burrlab.theory.continuum import PAPER_FORCE_EXPONENT

Point: TypeAlias = tuple[float, float]
ORDER = 0.01  # level of the tests of order and scatter together, by Holm (ours)
_COARSE = 0.03  # standard deviation of the rounding of the slowest velocity that is said (ours)
POOR = 0.005  # p below which the data contradict the model, or a given sigma is too large (ours)


@dataclass(frozen=True)
class HypothesisTest:
    """The outcome of a test.

    Attributes
    ----------
    name : str
    statistic : float
        F, or chi-square where the scatter is known; for given values the rise of -2 log L.
    freedom : tuple of float
        Degrees of freedom: (numerator, denominator), or one of a chi-square.
    p_value : float
        Probability of a statistic at least as large if the hypothesis holds.
    sentence : str
        The outcome in plain words.
    """

    name: str
    statistic: float
    freedom: tuple[int | float, ...]
    p_value: float
    sentence: str

    def __str__(self) -> str:
        return self.sentence


def concluded(
    name: str,
    statistic: float,
    freedom: tuple[int | float, ...],
    sentence: str,
    holds: str = "",
    fails: str = "",
    most: float = np.inf,
) -> HypothesisTest:
    """A test by F, or by chi-square where `freedom` is one number; more than `most` count as so many.

    In its sentence stand {outcome} and, for `holds` or where p < 5 % `fails`, {so}.
    """
    used = [min(nu, most) for nu in freedom]
    rise = max(statistic, 0.0)
    p = float(special.fdtrc(used[0], used[1], rise) if len(used) > 1 else special.chdtrc(used[0], rise))
    freedom_text = ", ".join(f"{nu:.3g}" if isinstance(nu, float) else f"{nu}" for nu in used)
    number = (
        f"F({freedom_text}) = {statistic:.3g}"
        if len(used) > 1
        else f"chi-square {statistic:.3g} of {freedom_text}"
    )
    outcome = f"{number}, {probability_text(p)}"
    return HypothesisTest(
        name, statistic, freedom, p, sentence.format(so=holds if p >= 0.05 else fails, outcome=outcome)
    )


def lack_of_fit(likelihood: Likelihood, point: Point) -> HypothesisTest | None:
    """Whether the scatter about the fit is larger than the repeats' own.

    With known sigma: the chi-square of the curves' velocities. Else an F test: the sum of squares about the
    fit, less that about the mean of each group of repeats (same force, radius and window), over the latter;
    None without repeats.

    Parameters
    ----------
    likelihood : Likelihood
    point : (c_e, alpha)
        The fit [N/mm^2], [1/ms].

    Notes
    -----
    The residuals are those about the best fit to the curves alone, because the test subtracts two degrees of
    freedom. About a fit that an indentation pulls away it would reject 11 % of true models at 5 %.

    References
    ----------
    Seber and Wild, Nonlinear Regression, Wiley 1989, section 2.1.3 (replicated data).
    """
    J, r = likelihood.about_curves(*point)
    if not len(r):
        return None
    S, parameters = float(np.sum(r**2)), 2 if J.shape[1] == 2 else orthonormal(J).shape[1]
    if likelihood.known:
        nu = likelihood.n - parameters
        if nu < 1:
            return None
        text = "The scatter {so} the given sigma: {outcome}."
        test = concluded("lack of fit", S, (nu,), text, "agrees with", "contradicts")
        if 1 - test.p_value < POOR:
            factor = float(f"{np.sqrt(nu / max(S, 1e-300)):.2g}")
            return replace(test, sentence=(
                f"The given sigma looks about {factor:g} times too large, and the intervals are too wide by it: "
                f"chi-square {S:.3g} of {nu}, {probability_text(1 - test.p_value)} for one so small."
            ))  # fmt: skip
        return test
    o = likelihood.observations
    apart = [o.sets] if J.shape[1] > 2 else []  # data sets may have effects of their own
    levels = [group.velocity for group in (*apart, *o.groups)]
    columns = np.stack([o.force, o.radius, o.window_start, o.window_end, *levels], axis=1)[o.run < 0]
    F, freedom = against_repeats(S, r, columns, parameters)
    return concluded(
        "lack of fit", F, freedom, "Lack of fit: the model {so}, {outcome}.",
        "fits within the scatter of the repeats", "misses the means",
    ) if freedom else None  # fmt: skip


def against_repeats(S: float, y: Floats, columns: Floats, parameters: int) -> tuple[float, tuple[int, ...]]:
    """F of a sum of squares about a fit against that of y about the means of repeats, and its freedom.

    Rows of equal `columns`, NaN too, are repeats; the freedom is () without any.
    """
    groups = np.unique(np.nan_to_num(columns, nan=-1.0), axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(groups)
    pure = float(np.sum((y - (np.bincount(groups, y) / count)[groups]) ** 2))
    above, below = len(count) - parameters, len(groups) - len(count)
    if above < 1 or below < 1 or pure == 0:
        return np.nan, ()
    return (max(S - pure, 0.0) / above) / (pure / below), (above, below)


def indentation_tests(likelihood: Likelihood) -> list[HypothesisTest]:
    """Whether the pressed rows follow Eq. 3, or another law of force, about the c_e that fits them best.

    Their chi-square where their sigma is known, else the F test of `lack_of_fit` where depths repeat; and the
    slope of ln F on ln h by an F test, from four rows on.
    """
    o, n = likelihood.observations, len(likelihood.observations.pressed)
    if n < 2:
        return []
    o = likelihood.corrected
    q = o.force_exponent
    law = "Eq. 3" if q == PAPER_FORCE_EXPONENT else f"F ~ h^{q:.4g}"
    with np.errstate(invalid="ignore"):  # of an offset larger than a force
        x, log = np.log(o.pressed_unit), np.log(o.pressed / o.pressed_unit)
    constant, y = (
        (o.pressed_unit / o.pressed_sigma, o.pressed / o.pressed_sigma)
        if likelihood.pressed_known
        else (np.ones(n), log)
    )
    r, bend = (
        column - constant * (constant @ column) / (constant @ constant) for column in (y, constant * x)
    )
    S, tests = float(r @ r), []
    F, freedom = against_repeats(float(np.sum(r**2)), r, x[:, None], 1)
    if likelihood.pressed_known:
        tests.append(concluded(
            "indentation, sigma", S, (n - 1,), f"The indentation {{so}} {law} and its sigma: {{outcome}}.",
            "agrees with", "contradicts",
        ))  # fmt: skip
    elif freedom:
        tests.append(concluded(
            "indentation, repeats", F, freedom, f"{law} {{so}}, {{outcome}}.",
            "fits the indentation within the scatter of its repeats", "misses its means",
        ))  # fmt: skip
    if n > 3 and np.ptp(x):
        above = float(bend @ r) ** 2 / float(bend @ bend)
        F = above / max((S - above) / (n - 2), 1e-300)
        power = q * (1 + float(np.cov(x, log)[0, 1] / np.var(x, ddof=1)))
        text = f"The force of the indentation goes with depth^{power:.3g}, by {law} with depth^{q:.4g}: {{outcome}}."
        tests.append(concluded("indentation, power", F, (1, n - 2), text))
    return tests


def fall_with_depth(likelihood: Likelihood, unit: Floats) -> HypothesisTest | None:
    """Whether the velocity falls with depth within the runs as the model says; None without traces.

    The segments' residuals about their run's mean, averaged over the runs, should be 0. With several runs
    they are compared with their scatter from run to run (F), and the scatter within its record weighs each
    run. One run is compared with the standard errors of its segments' velocities (chi-square). Both include
    the model's own error, 0.2 %, so that records without noise are not rejected.

    Parameters
    ----------
    likelihood : Likelihood
    unit : ndarray, shape (n,)
        The model's velocities at the fit, for any alpha.
    """
    o = likelihood.observations
    runs = int(o.run.max(initial=-1)) + 1
    if not runs:
        return None
    table = likelihood.within_residuals(unit).reshape(runs, -1)
    segments = table.shape[1]
    precision = 1 / likelihood.run_scatter
    pattern = precision @ table / np.sum(precision**2)
    expected = np.log(unit[o.run == 0])
    measured = float(np.exp(pattern[0] + expected[0] - pattern[-1] - expected[-1]))
    ratios = f"first over last segment {measured:.3g}, {np.exp(expected[0] - expected[-1]):.3g} by the model"
    if runs > 1:
        freedom: tuple[int, ...] = segments - 1, (runs - 1) * (segments - 1)
        above, below = freedom
        spread = float(np.sum((table - precision[:, None] * pattern) ** 2)) / below
        weight = float(np.sum(precision**2))
        F = float(weight * np.sum(pattern**2) / above) / (spread + weight * MODEL_ERROR**2)
    else:
        freedom = (segments - 1,)
        weights = 1 / (o.log_sigma[o.run == 0] ** 2 + MODEL_ERROR**2)
        r = np.log(o.velocity[o.run == 0]) - expected
        F = float(np.sum(weights * (r - np.sum(weights * r) / np.sum(weights)) ** 2))
    text = f"The fall of velocity with depth {{so}} the model ({ratios}): {{outcome}}."
    return replace(
        concluded("fall with depth", F, freedom, text, "agrees with", "contradicts"),
        freedom=tuple(map(float, freedom)),
    )


def given_values(
    likelihood: Likelihood, calibration: AnyCalibration, base: float, c_e: float, alpha: float
) -> HypothesisTest:
    """Whether (c_e, alpha) lies in the joint region."""
    rise = float(likelihood.at(c_e).minus2(alpha)[0]) - base
    o, p = likelihood.observations, 0.0
    if np.isnan(rise):
        rise, ending = np.inf, f"is excluded: at {o.bounding_force:.4g} N there would have been no window."
    elif c_e > o.ceiling:
        rise, ending = np.inf, "is excluded: the overloaded run would have had a window."
    else:
        p = calibration.probability(max(rise, 0.0))
        ending = (
            f"lies {'inside' if p >= 0.05 else 'outside'} the joint 95 % region: -2 log L rises by {rise:.3g}, "
            f"{probability_text(p)}."
        )
    return HypothesisTest(
        f"c_e = {c_e:g} N/mm^2, alpha = {alpha:g} /ms", rise, calibration.joint_freedom, p,
        f"({c_e:g} N/mm^2, {alpha:g} /ms) {ending}",
    )  # fmt: skip


# ---- what speaks against a fit ----

NO_MATTER = 3 * MODEL_ERROR  #: RMS relative deviation that the model's own error may explain
FEWEST = 8  #: rows; among fewer none is named
_WIDER = 1.5  # the plausible range reaches so far beyond the shipped materials (ours)
_FAR = 30.0  # beyond the plausible range by this factor a fit is implausible (ours)
_SUSPECT = 0.005  # p of the best plausible point below which a note is due (ours)
_LOOKS = 0.05  # p above which data look like those of a mistake
_POINTS = 200  # of c_e in the plausible range
_EACH, _FARTHEST = 1000, 2  # of more rows only the farthest are fitted without: at most three fits in all
_FORCES = 40  # of more, repeated ones too are smoothed, which is faster
_SCATTER = 0.5  # RMS of log velocity beyond which the model does not describe the data (ours)

#: c_e [N/mm^2] and alpha [1/ms] of the shipped materials, widened by a factor of 1.5 to either side.
PLAUSIBLE: Bounds = {
    name: (
        round(min(getattr(m, name) for m in materials.values()) / _WIDER, 6),
        round(max(getattr(m, name) for m in materials.values()) * _WIDER, 6),
    )
    for name in ("c_e", "alpha")
}

# What a file may hold instead of N and mm/s: the factor of its forces, and of its velocities.
_MISTAKES = {
    "velocities were um/s": (1.0, 1e3),
    "velocities were m/s": (1.0, 1e-3),
    "velocities were mm/min": (1.0, 60.0),
    "velocities were cm/s": (1.0, 0.1),
    "forces were mN": (1e3, 1.0),
    "forces were kN": (1e-3, 1.0),
    "forces were gram-force": (1e3 / 9.80665, 1.0),
    "forces were kilogram-force": (1 / 9.80665, 1.0),
    # default windows scale with R: v = alpha R g(F/(c_e R^2))
    "the radius were the diameter": (1 / 4, 1 / 2),
    "the radius were half the true one": (4.0, 2.0),
}


@dataclass(frozen=True)
class Goodness:
    """Whether data and model agree, by the test that the data allow.

    Attributes
    ----------
    test : HypothesisTest or None
        Chi-square with sigma, lack of fit with repeats, else curvature; None where there are too few rows.
        Where an indentation contradicts Eq. 3, or the velocities, more clearly, that test.
    poor : bool
        The data contradict the model: p < 0.005 over the number of tests, and the deviations exceed the
        model's own error.
    inflation : float
        Chi-square over degrees of freedom where the data contradict a given sigma, else 1. The limits of all
        intervals are wider by this factor, the intervals by its root.
    """

    test: HypothesisTest | None
    poor: bool
    inflation: float

    @property
    def sentence(self) -> str:
        """The contradiction in plain words, or that sigma looks too large; empty where neither is so."""
        if self.test is not None and len(self.test.freedom) == 1 and 1 - self.test.p_value < POOR:
            return self.test.sentence
        if not self.poor or self.test is None:
            return ""
        wider = (
            f" Intervals are {np.sqrt(self.inflation):.2g} times wider for it." if self.inflation > 1 else ""
        )
        model = "model or their sigma" if len(self.test.freedom) == 1 else "model"
        return f"The data contradict the {model}. {self.test.sentence}{wider}"


def goodness(
    likelihood: Likelihood, point: Point, lack: HypothesisTest | None, others: list[HypothesisTest]
) -> Goodness:
    """The goodness of a fit; `lack` is its test of lack of fit, None without sigma and repeats.

    The test of the velocities, those of an indentation, and `others`, of beliefs and of the two kinds against each
    other, share the 0.005 evenly.
    """
    test = curvature(likelihood, point) if lack is None else lack
    o, presses = likelihood.observations, indentation_tests(likelihood)
    limit = POOR / max(len(presses) + len(others) + (test is not None), 1)
    against = [test, *others] if test is not None and rms_off(likelihood, point) > NO_MATTER else [*others]
    if presses and np.std(np.log(o.pressed / o.pressed_unit)) > NO_MATTER:
        against += presses
    against = sorted((bad for bad in against if bad.p_value < limit), key=lambda bad: bad.p_value)
    ratios = (bad.statistic / bad.freedom[0] for bad in against if len(bad.freedom) == 1)
    return Goodness(against[0] if against else test, bool(against), max(ratios, default=1.0))


def belief_tests(likelihood: Likelihood) -> list[HypothesisTest]:
    """Whether the rows alone agree with each value that was given as known."""
    tests = []
    for (name, value, deviation), (rise, nu) in zip(
        likelihood.beliefs, likelihood.belief_rises(), strict=False
    ):
        text = f"{name} was given as {value:.4g}, to {100 * deviation:.2g} %: the data alone {{so}} it, {{outcome}}."
        tests.append(
            concluded(f"known {name}", rise, (1, nu), text, "do not contradict", "contradict", 999.0)
        )
    return tests


def rms_off(likelihood: Likelihood, point: Point) -> float:
    """RMS of the logarithm of velocity over prediction at a point, of each day and specimen by its own values."""
    return float(np.sqrt(np.mean(likelihood.off_curve(*point) ** 2)))


def curvature(likelihood: Likelihood, point: Point) -> HypothesisTest | None:
    """Whether the residuals bend over log force: F test of one more term, the square of log(F/R^2).

    None where fewer than two degrees of freedom are left, or the term is one of the model's own.
    """
    J, r = likelihood.about_curves(*point)
    o = likelihood.observations
    x = np.log(o.force / o.radius**2)[o.run < 0]
    if not len(x):
        return None
    basis = orthonormal(J)
    bend = (x - x.mean()) ** 2
    rest = bend - basis @ (basis.T @ bend)
    below = len(x) - basis.shape[1] - 1
    if below < 2 or rest @ rest < 1e-6 * (bend @ bend):
        return None
    above = float(rest @ r) ** 2 / float(rest @ rest)
    return concluded(
        "curvature",
        above / max((float(r @ r) - above) / below, 1e-300),
        (1, below),
        "The residuals {so} over the force: {outcome}.",
        "do not bend",
        "bend",
    )


def restarting(o: Observations) -> str:
    """The first group with three rows of the curves to a label, with each of which a drift may begin anew; or nothing."""
    n = np.count_nonzero(o.run < 0)
    return next((x.name for x in o.groups if 1 < len(x.levels) <= n / 3), "")


def order_tests(likelihood: Likelihood, point: Point) -> list[HypothesisTest]:
    """Whether the curves' residuals go with the order of the rows, or their scatter with the force.

    A smooth function of the force is removed first, or the mean at each force where most forces repeat: so a wrong
    law, on rows sorted by force, is no drift. Empty below 12 rows.

    * drift: F test of the row's number, within each day or specimen;
    * neighbours: correlation of rows beside each other, one-sided;
    * scatter: whether squared residuals go with log force. Both by the beta distribution of Durbin and Watson.

    The tests of order are absent where the order is that of the forces.

    References
    ----------
    Durbin and Watson, Testing for serial correlation in least squares regression II, Biometrika 38 (1951).
    """
    J, r = likelihood.about_curves(*point)
    o, n = likelihood.observations, len(r)
    if n < 12:
        return []
    x = np.log(o.force / o.radius**2)[o.run < 0]
    x = (x - x.mean()) / max(float(np.std(x)), 1e-12)
    levels = np.unique(x, return_inverse=True)[1]
    smooth = (
        (levels[:, None] == np.arange(levels.max() + 1)).astype(np.float64)
        if levels.max() + 1 <= min(n / 2, _FORCES)
        else np.stack([x**k for k in range(5)], axis=1)
    )
    basis = orthonormal(np.column_stack([J, smooth]))
    e, below = r - basis @ (basis.T @ r), n - basis.shape[1]
    if below < 6 or e @ e <= 1e-20 * max(float(r @ r), 1e-300):
        return []
    tests = []
    group = restarting(o)
    last, by = (f"of each {group} to the last of the longest", f":{group}") if group else ("to the last", "")
    number = o.order(group)[o.run < 0]
    drift = number - basis @ (basis.T @ number)
    if drift @ drift > 0.1 * (number @ number):
        slope = float(drift @ e) / float(drift @ drift)
        above = slope**2 * float(drift @ drift)
        F = (below - 1) * above / max(float(e @ e) - above, 1e-300)
        tests.append(concluded("drift", F, (1, below - 1), (
            f"From the first row {last} the residuals drift by {slope:.2g}: {{outcome}}; estimate=('order{by}',) takes it "
            "into account."
        )))  # fmt: skip
        correlation, p = _form(
            scipy.sparse.diags_array([0.5, 0.5], offsets=[-1, 1], shape=(n, n)), basis, e, -1.0, 1.0
        )
        tests.append(HypothesisTest("neighbours", correlation, (below,), 1 - p, (
            f"Rows beside each other are alike beyond their force, {probability_text(1 - p)}: if they are of days or specimens, "
            "label these (groups)."
        )))  # fmt: skip
    if levels.max() == 0:
        return tests
    change, p = _form(scipy.sparse.diags_array(x), basis, e, float(x.min()), float(x.max()))
    p = 2 * min(p, 1 - p)
    tests.append(HypothesisTest("scatter", change, (below,), p, (
        f"The scatter {'rises' if change > 0 else 'falls'} with the force, {probability_text(p)}."
    )))  # fmt: skip
    return tests


def _form(A: Any, basis: Floats, e: Floats, low: float, high: float) -> tuple[float, float]:
    """e'Ae/e'e of residuals beside a basis, and the probability of a smaller one by a beta distribution.

    A is symmetric and sparse, with eigenvalues from low to high; the moments are those of normal residuals.
    """
    AB, n = A @ basis, len(e) - basis.shape[1]
    inner = basis.T @ AB
    mean = float(A.trace() - np.trace(inner)) / n
    square = float(A.multiply(A).sum()) - 2 * float(np.sum(AB**2)) + float(np.sum(inner**2))
    variance = 2 * (square / n - mean**2) / (n + 2)
    share = (mean - low) / (high - low)
    both = share * (1 - share) * (high - low) ** 2 / variance - 1
    ratio = float(e @ (A @ e)) / float(e @ e)
    return ratio, float(
        special.betainc(share * both, (1 - share) * both, np.clip((ratio - low) / (high - low), 0.0, 1.0))
    )


def next_law(likelihood: Likelihood, poor: bool) -> str:
    """Where data contradict the paper's law: how the velocity goes with the force, and where to go on."""
    if not poor or not likelihood.model.law.is_paper:
        return ""
    o = likelihood.observations
    slope = np.polyfit(np.log(o.force / o.radius**2), np.log(o.velocity / o.radius), 1)[0]
    return f"The velocity goes with F^{slope:.2f}: compare_laws finds which law does so."


def against_order(tests: Sequence[HypothesisTest]) -> list[HypothesisTest]:
    """Those of the tests that fire, by Holm's rule: in 1.0 % of 4000 clean data sets."""
    ranked = sorted(tests, key=lambda test: test.p_value)
    return [test for test, p in zip(ranked, holm([x.p_value for x in ranked]), strict=True) if p < ORDER]


def orthonormal(J: Floats) -> Floats:
    """An orthonormal basis of the columns; on a ridge both are one."""
    U, s, _ = np.linalg.svd(J, full_matrices=False)
    return np.asarray(U[:, s > 1e-6 * s[0]])


@dataclass(frozen=True, repr=False)
class Row:
    """A row of the data, and the fit without it.

    Attributes
    ----------
    data_set, row : int
        Which data set, from 0, and which row of it, from 1 after the header.
    force : float
        [N]
    leverage : float
        Diagonal of the hat matrix, 0 to 1: how far the row determines its own prediction.
    studentised : float
        Residual over its standard error by the other rows, or over the given sigma.
    named : bool
        |studentised| is beyond the limit that some row reaches in 5 % of clean data sets.
    c_e, alpha : float
        The fit without the row [N/mm^2], [1/ms]; NaN where the other rows allow none, or are too many.
    interval : ConfidenceInterval
        95 % interval of c_e without the row.
    """

    data_set: int
    row: int
    force: float
    leverage: float
    studentised: float
    named: bool
    c_e: float
    alpha: float
    interval: ConfidenceInterval

    @property
    def sentence(self) -> str:
        """The row in plain words."""
        of = f" of data set {self.data_set + 1}" if self.data_set else ""
        without = (
            "there is no fit without it"
            if np.isnan(self.c_e)
            else f"without it c_e is {self.c_e:.3g} ({span(self.interval)}) N/mm^2"
        )
        return f"Row {self.row}{of}, {self.force:.3g} N, stands out: {self.studentised:.2g} sigma; {without}."

    def __repr__(self) -> str:
        return (
            f"Row({self.row}, {self.force:.3g} N, {self.studentised:.2g} sigma, "
            f"c_e {self.c_e:.3g}{', stands out' if self.named else ''})"
        )


@doing("fits without each row")
def influence(
    likelihood: Likelihood,
    point: Point,
    data: Sequence[Data],
    bounds: Bounds,
    *,
    every: bool = True,
    refitted: bool = True,
) -> tuple[Row, ...]:
    """The curves' rows in the order of the data, each with the fit without it.

    Parameters
    ----------
    likelihood : Likelihood
    point : (c_e, alpha)
        The fit [N/mm^2], [1/ms].
    data : sequence of data sets
        Of the fit.
    bounds : dict
        Given to the fit.
    every : bool
        False returns only the rows that stand out.
    refitted : bool
        False leaves out the fits without a row.

    Notes
    -----
    A row stands out where |externally studentised residual| is beyond Bonferroni's limit at 5 %: Student's t
    with n - p - 1 degrees of freedom, p the rank of the derivatives, or the normal distribution where sigma
    is known. The worst row is set aside and the others are judged without it, until none stands out or
    fewer than 8 are left. Of more than 1000 rows only the two that lie farthest off are fitted without.

    References
    ----------
    Cook and Weisberg, Residuals and Influence in Regression, Chapman and Hall 1982, section 2.2.
    """
    J, r = likelihood.about_curves(*point)
    if not len(r):
        return ()
    o, known, floor = likelihood.observations, likelihood.known, likelihood.floor
    rest = np.arange(len(r))
    leverage, residual, _ = _studentised(J, r, known, floor)
    named = np.zeros(len(r), dtype=bool)
    while len(rest) >= FEWEST:
        _, residual[rest], limit = _studentised(J[rest], r[rest], known, floor)
        worst = int(rest[np.argmax(np.abs(residual[rest]))])
        if abs(residual[worst]) <= limit:
            break
        named[worst] = True
        rest = rest[rest != worst]
    places = [
        (k, row + 1)
        for k, curve in enumerate(data)
        if isinstance(curve, VelocityCurve)
        for row in np.flatnonzero(curve.ok).tolist()
    ]
    least = np.sort(np.abs(residual))[-_FARTHEST] if len(r) > _EACH else 0.0
    return tuple(
        Row(data_set, row, float(o.recorded_force[at]), h, t, stands_out,
            *(_without(likelihood, at, bounds) if refitted and abs(t) >= least else _NO_FIT))
        for (data_set, row), at, h, t, stands_out in zip(
            places, *(x.tolist() for x in (np.flatnonzero(o.run < 0), leverage, residual, named)), strict=True
        )
        if every or stands_out
    )  # fmt: skip


def doubts(likely: "Plausibility | None", o: Observations, rows: Sequence[Row]) -> list[str]:
    """Sentences on doubtful data for the verdict; `rows` stand out, and the two farthest are named.

    Copies are blocks of 8 rows or more, over three forces or more, that come again right behind themselves, all
    columns equal. Repeats that rounding makes equal hardly ever form one, unless it is coarse.
    """
    coarse = coarse_rounding(o)
    columns = np.stack([o.force, o.velocity, o.sigma, o.window_start, o.window_end, o.radius], axis=1)
    same = np.unique(np.nan_to_num(columns, nan=-1.0), axis=0, return_inverse=True)[1].ravel()
    copied = np.zeros(len(same), dtype=bool)
    for lag in range(FEWEST, len(same) // 2 + 1):
        if not (same[lag::lag] == same[:-lag:lag]).any():  # `lag` rows in a row would hold one of these
            continue
        equal = np.concatenate([[False], same[lag:] == same[:-lag], [False]])
        for begin, end in np.flatnonzero(np.diff(equal)).reshape(-1, 2):
            if end - begin >= lag and len(np.unique(o.force[begin:end])) >= 3:
                copied[begin + lag : end + lag] = True
    far = [
        f"{row.row}{f' of data set {row.data_set + 1}' if row.data_set else ''} ({row.studentised:.2g} sigma)"
        for row in sorted(rows, key=lambda row: -abs(row.studentised))
    ]
    far[2:] = [f"{len(far) - 2} more"] if len(far) > 2 else []
    doubtful = {
        f"Suspect: {likely.sentence if likely else ''}.": likely is not None and likely.suspect,
        f"{copied.sum()} of {len(same)} rows are exact copies of others, which narrow the intervals "
        "but are no repeats.": copied.any() and not coarse,
        f"Rows that stand out: {', '.join(far)}.": far,
        "Intervals by traces are too narrow: those called 95 % hold c_e in 91 % of made-up sets (docs/inference.md).":
            (o.run >= 0).any() and not len(o.pressed),
    }  # fmt: skip
    return coarse + [text for text, applies in doubtful.items() if applies]


def coarse_rounding(o: Observations) -> list[str]:
    """A sentence if the velocities are rounded to decimals that matter for the slowest."""
    velocity = o.velocity[o.run < 0]
    steps = [10.0**-k for k in range(5) if np.allclose(velocity * 10**k, np.rint(velocity * 10**k), 1e-9, 0)]
    deviation = steps[0] / np.sqrt(12) / velocity.min() if steps and len(velocity) else 0.0
    return [
        f"The velocities are rounded to {steps[0]:g} mm/s, by {100 * deviation:.2g} % of the slowest (standard deviation). "
        "This alone can bend the curve: give more digits, or leave the slowest out."
    ] if deviation >= _COARSE else []  # fmt: skip


def rows_limit(likelihood: Likelihood, point: Point, rows: NDArray[np.bool_]) -> float | None:
    """The limit of |studentised residual| over some rows; None below 8 rows."""
    J, r = likelihood.about_curves(*point)
    return _studentised(J[rows], r[rows], likelihood.known, likelihood.floor)[2] if len(r) >= FEWEST else None


def _studentised(J: Floats, r: Floats, known: bool, floor: float) -> tuple[Floats, Floats, float]:
    """Leverages and externally studentised residuals of rows, and Bonferroni's limit at 5 %."""
    basis = orthonormal(J)
    n, p = basis.shape
    r = r - basis @ (basis.T @ r)
    leverage, below = np.sum(basis**2, axis=1), max(n - p - 1, 1)
    free = np.maximum(1 - leverage, 1e-9)
    variance = np.ones(n) if known else np.maximum((r @ r - r**2 / free) / below, 0.0) + floor
    limit = special.ndtri(0.025 / n) if known else special.stdtrit(below, 0.025 / n)
    return leverage, r / np.sqrt(variance * free), -float(limit)


_NO_FIT = np.nan, np.nan, ConfidenceInterval(None, None)


def _without(likelihood: Likelihood, row: int, bounds: Bounds) -> tuple[float, float, ConfidenceInterval]:
    """c_e, alpha and c_e's 95 % interval without a velocity row."""
    keep = np.arange(len(likelihood.observations.force)) != row
    try:
        o = likelihood.observations.kept(keep)
        rest = likelihood.of_rows(o, likelihood.model.kept(o, keep))
        domain = Domain.of(rest, bounds_of(o, bounds), bounds)
    except ValueError:  # too few forces are left
        return _NO_FIT
    best = lowest(rest, domain).point
    return *best, c_e_interval(rest, domain, best)


@dataclass(frozen=True)
class Plausibility:
    """Whether a plausible material could have given the data.

    Attributes
    ----------
    p_value : float
        Of the best point inside the plausible range, by the joint region.
    suspect : bool
        p is below 0.005, or the velocity rises less than the force does.
    implausible : bool
        p is below 0.005 even in the range widened 30-fold, the velocity falls with the force, or the data lie
        over 50 % (RMS) off the model.
    sentence : str
        What is suspect and what the data look like; empty where nothing is.
    """

    p_value: float
    suspect: bool
    implausible: bool
    sentence: str


def plausibility(
    likelihood: Likelihood,
    calibration: AnyCalibration,
    base: float,
    point: Point,
    plausible: Bounds,
    guess: bool,
) -> Plausibility:
    """Compare a fit with the plausible range of c_e [N/mm^2] and alpha [1/ms]; `guess` what may be mistaken.

    A factor on forces or velocities is absorbed by c_e or alpha exactly, so only such a range can show it.
    The alphas of the shipped materials hold for parabolic f; with another f only their c_e is asked.
    """
    o = likelihood.observations
    c_e, alpha = (plausible.get(name, PLAUSIBLE[name]) for name in ("c_e", "alpha"))
    if alpha == PLAUSIBLE["alpha"] and likelihood.model.shape.name != "parabolic":
        alpha = (0.0, np.inf)

    def p_of(force: float = 1.0, velocity: float = 1.0, wider: float = 1.0) -> float:
        """Of the best point in the range, for data whose forces and velocities carry these factors."""
        low = max(c_e[0] * force / wider, o.c_e_floor * (1 + 1e-4))
        high = min(c_e[1] * force * wider, o.ceiling * (1 - 1e-4))
        if low >= high:
            return 0.0
        walk = Walk(
            likelihood,
            Domain(
                low, high, True, True, (np.inf,), (alpha[0] * velocity / wider, alpha[1] * velocity * wider)
            ),
            np.geomspace(low, high, _POINTS),
        )
        return calibration.probability(max(float(walk.minus2.min()) - base, 0.0))

    within = (c_e[0] <= point[0] <= c_e[1]) * (alpha[0] <= point[1] <= alpha[1])
    inside, off = p_of(), rms_off(likelihood, point)
    if inside < _SUSPECT * within:  # precise data may lie between the points of the walk
        inside = 1.0
    x, y = np.log(o.force / o.radius**2), np.log(o.velocity / o.radius) - likelihood.own_alpha
    x, freedom = x - x.mean(), max(len(x) - 2, 1)
    slope = float(x @ y / (x @ x))
    error = np.std(y - slope * x) * np.sqrt(len(x) / (x @ x) / freedom)
    slope -= float(special.stdtrit(freedom, 0.025) * error)  # upper end of its 95 % interval
    wrong = {
        "the velocity falls with the force": slope < 0,
        "the velocity rises less than the force does, as if the two columns were swapped": 0 <= slope < 1,
        f"the data lie {100 * off:.3g} % (RMS) off the model": off > _SCATTER,
    }
    texts, outside = [text for text, holds in wrong.items() if holds], inside < _SUSPECT
    if outside and not texts:
        lie = f"the fitted c_e lies outside {c_e[0]:.2g} to {c_e[1]:.2g} N/mm^2"
        if alpha[0] > 0:
            lie = f"{lie.replace('lies', 'and alpha lie')} and {alpha[0]:.2g} to {alpha[1]:.2g} /ms"
        # windows in mm, and indentations (F = c_e R^(1/2) h^(3/2)), do not go with those of another radius
        scales = bool(np.isnan(o.window_start).all()) and not len(o.pressed)
        looks = [
            f"as if {what} (c_e would be {point[0] / force:.3g} N/mm^2, alpha {point[1] / velocity:.3g} /ms)"
            for what, (force, velocity) in _MISTAKES.items()
            if guess and p_of(force, velocity) > _LOOKS and (scales or "radius" not in what)
        ]
        texts = [lie, *([", or ".join(looks)] if looks else [])]
    implausible = slope < 0 or off > _SCATTER or (outside and p_of(wider=_FAR) < _SUSPECT)
    return Plausibility(inside, bool(texts), implausible, "; ".join(texts))
