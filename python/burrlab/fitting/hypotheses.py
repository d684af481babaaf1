"""Tests of a fit's assumptions, and of given values."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy

from burrlab.fitting.likelihood import MODEL_ERROR, Likelihood
from burrlab.fitting.observations import Calibration, Floats, Rows

Point: TypeAlias = tuple[float, float]
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


def p_text(p: float) -> str:
    """A p-value as it is printed."""
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"


def judged(statistic: float, *freedom: float) -> tuple[float, str]:
    """p-value of an F, or of a chi-square where `freedom` is one number; and the outcome in words."""
    p = float((scipy.stats.f if len(freedom) > 1 else scipy.stats.chi2).sf(statistic, *freedom))
    freedom_text = ", ".join(
        f"{number_of:.3g}" if isinstance(number_of, float) else f"{number_of}" for number_of in freedom
    )
    number = (
        f"F({freedom_text}) = {statistic:.3g}"
        if len(freedom) > 1
        else f"chi-square {statistic:.3g} of {freedom_text}"
    )
    return p, f"{number}, {p_text(p)}"


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
    name = "lack of fit"
    r = likelihood.own_rows(*point)[1]
    S = float(np.sum(r**2))
    if likelihood.known:
        nu = likelihood.n - 2
        p, outcome = judged(S, nu)
        sentence = f"The scatter {'agrees with' if p >= 0.05 else 'contradicts'} the given sigma: {outcome}."
        if 1 - p < POOR:
            factor = float(f"{np.sqrt(nu / max(S, 1e-300)):.2g}")
            sentence = (
                f"The given sigma looks about {factor:g} times too large, and the intervals are too wide by it: "
                f"chi-square {S:.3g} of {nu}, {p_text(1 - p)} for one so small."
            )
        return HypothesisTest(name, S, (nu,), p, sentence)
    o = likelihood.observations
    columns = np.stack([o.force, o.radius, o.window_start, o.window_end], axis=1)[o.run < 0]
    groups = np.unique(np.nan_to_num(columns, nan=-1.0), axis=0, return_inverse=True)[1].ravel()
    F, freedom = _against_repeats(r, groups, 2)
    if not freedom:
        return None
    p, outcome = judged(F, *freedom)
    agree = "the model fits within the scatter of the repeats" if p >= 0.05 else "the model misses the means"
    return HypothesisTest(name, F, freedom, p, f"Lack of fit: {agree}, {outcome}.")


def _against_repeats(r: Floats, groups: Rows, parameters: int) -> tuple[float, tuple[int, ...]]:
    """F of the scatter about a fit against that about each group's mean, and its freedom; () without repeats."""
    count = np.bincount(groups)
    pure = float(np.sum((r - (np.bincount(groups, r) / count)[groups]) ** 2))
    above, below = len(count) - parameters, len(groups) - len(count)
    if above < 1 or below < 1 or pure == 0:
        return np.nan, ()
    return (max(float(np.sum(r**2)) - pure, 0.0) / above) / (pure / below), (above, below)


def indentation_tests(likelihood: Likelihood) -> list[HypothesisTest]:
    """Whether the pressed rows follow Eq. 3, about the c_e that fits them best.

    Their chi-square where their sigma is known, else the F test of `lack_of_fit` where depths repeat; and the
    slope of ln F on ln h by an F test, from four rows on.
    """
    o, n = likelihood.observations, len(likelihood.observations.pressed)
    if n < 2:
        return []
    x, log = np.log(o.pressed_unit), np.log(o.pressed / o.pressed_unit)
    constant, y = np.ones(n), log
    if likelihood.pressed_known:
        constant, y = o.pressed_unit / o.pressed_sigma, o.pressed / o.pressed_sigma
    r, bend = (
        column - constant * (constant @ column) / (constant @ constant) for column in (y, constant * x)
    )
    S, tests, depths = float(r @ r), [], np.unique(x, return_inverse=True)[1]
    F, freedom = _against_repeats(r, depths, 1)
    if likelihood.pressed_known:
        p, outcome = judged(S, n - 1)
        agree = "agrees with" if p >= 0.05 else "contradicts"
        text = f"The indentation {agree} Eq. 3 and its sigma: {outcome}."
        tests.append(HypothesisTest("indentation, sigma", S, (n - 1,), p, text))
    elif freedom:
        p, outcome = judged(F, *freedom)
        agree = "fits the indentation within the scatter of its repeats" if p >= 0.05 else "misses its means"
        tests.append(HypothesisTest("indentation, repeats", F, freedom, p, f"Eq. 3 {agree}, {outcome}."))
    if n > 3 and depths.any():
        above = float(bend @ r) ** 2 / float(bend @ bend)
        F = above / max((S - above) / (n - 2), 1e-300)
        p, outcome = judged(F, 1, n - 2)
        power = 1.5 * (1 + float(np.cov(x, log)[0, 1] / np.var(x, ddof=1)))
        text = (
            f"The force of the indentation goes with depth^{power:.3g}, by Eq. 3 with depth^1.5: {outcome}."
        )
        tests.append(HypothesisTest("indentation, power", F, (1, n - 2), p, text))
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
    freedom: tuple[int, ...]
    table = likelihood.within_residuals(unit).reshape(runs, -1)
    segments = table.shape[1]
    precision = 1 / likelihood.run_scatter
    pattern = precision @ table / np.sum(precision**2)
    expected = np.log(unit[o.run == 0])
    measured = float(np.exp(pattern[0] + expected[0] - pattern[-1] - expected[-1]))
    ratios = f"first over last segment {measured:.3g}, {np.exp(expected[0] - expected[-1]):.3g} by the model"
    if runs > 1:
        freedom = segments - 1, (runs - 1) * (segments - 1)
        above, below = freedom
        spread = float(np.sum((table - precision[:, None] * pattern) ** 2)) / below
        weight = float(np.sum(precision**2))
        F = float(weight * np.sum(pattern**2) / above) / (spread + weight * MODEL_ERROR**2)
    else:
        freedom = (segments - 1,)
        weights = 1 / (o.log_sigma[o.run == 0] ** 2 + MODEL_ERROR**2)
        r = np.log(o.velocity[o.run == 0]) - expected
        F = float(np.sum(weights * (r - np.sum(weights * r) / np.sum(weights)) ** 2))
    p, outcome = judged(F, *freedom)
    agree = "agrees with" if p >= 0.05 else "contradicts"
    sentence = f"The fall of velocity with depth {agree} the model ({ratios}): {outcome}."
    return HypothesisTest("fall with depth", F, tuple(map(float, freedom)), p, sentence)


def given_values(
    likelihood: Likelihood, calibration: Calibration, base: float, c_e: float, alpha: float
) -> HypothesisTest:
    """Whether (c_e, alpha) lies in the joint region."""
    at = likelihood.at(c_e)
    rise = float(at.minus2(alpha)[0]) - base
    name = f"c_e = {c_e:g} N/mm^2, alpha = {alpha:g} /ms"
    scatter = calibration.scatters[0]
    freedom: tuple[float, ...] = (2.0,)  # two parameters; a denominator where one scatter is estimated
    if len(calibration.scatters) == 1 and not scatter.known:
        freedom = (2.0, float(scatter.n - 2))
    o, p = likelihood.observations, 0.0
    if np.isnan(rise):
        force = o.force[np.argmax(o.c_e_bounds())]
        rise, ending = np.inf, f"is excluded: at {force:.4g} N there would have been no window."
    elif c_e > o.ceiling:
        rise, ending = np.inf, "is excluded: the overloaded run would have had a window."
    else:
        p = calibration.probability(max(rise, 0.0))
        where = "inside" if p >= 0.05 else "outside"
        ending = f"lies {where} the joint 95 % region: -2 log L rises by {rise:.3g}, {p_text(p)}."
    return HypothesisTest(name, rise, freedom, p, f"({c_e:g} N/mm^2, {alpha:g} /ms) {ending}")
