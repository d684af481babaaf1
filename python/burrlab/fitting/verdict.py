"""The status of a fit, and what the data determine in plain words."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.observations import Box, Observations
from burrlab.fitting.profile import FLAT, ONE_PLACE, Combination, ConfidenceInterval, Profile

_RIDGE_PHI = 0.7  # at the point taken on the ridge, largest phi over the phi where the ridge ends
_AT_BOUND = 1e-3  # relative distance below which an end is at a bound
_EQUAL = 1e-3  # relative difference of RMS residuals below which ends are equally good
#: c_e and alpha are separately identified where c_e's closed 95 % interval spans less than this (ours).
SEPARATE = 2.0
# why no narrow interval tells c_e from alpha, by status
_UNFIT = {
    "poor-fit": "the data contradict the model",
    "implausible": "the data are implausible",
    "at-bound": "the fit ended at a bound",
}


@dataclass(frozen=True)
class Start:
    """One search: where it began, where it ended, and how.

    `objective` is the sum of squared residuals at the end; `result` is nlopt's return code by name, SUCCESS
    for the walk. A good code says that the search stopped as planned, not that the fit is good.
    """

    origin: str
    start: tuple[float, float]  # c_e [N/mm^2], alpha [1/ms]
    end: tuple[float, float]
    objective: float
    result: str
    evaluations: int


@dataclass(frozen=True)
class Ridge:
    """The ridge along which the data cannot tell c_e from alpha, and what they determine there.

    Along the ridge every window starts deeper than static contact, and predictions depend on
    alpha/c_e^exponent alone (docs/model.md, section 5 iii).
    """

    max_phi: float  #: largest F/(c_e R^2) of the fitted rows, at the fitted c_e
    on_ridge: bool  #: at the fit the velocities lie on the ridge: all phi < 0.068 in the default window
    excluded: bool  #: c_e's 95 % interval has an upper end, or the bounds end before the ridge begins
    exponent: float  #: p = 2 (k + 1)/q of the law: 8/3 for the paper's
    value: float  #: alpha/c_e^exponent on the ridge [1/ms (mm^2/N)^exponent]
    residual: float  #: RMS residual of the velocities on the ridge, in the unit of the fit's


def ridge_of(likelihood: Likelihood, exponent: float, best: tuple[float, float], profile: Profile) -> Ridge:
    """The ridge beside the best point; the profile says whether the ridge is excluded."""
    o = likelihood.observations
    entry = float(o.ridge_entries().max())
    c_e, alpha = best
    max_phi = float((o.force / (c_e * o.radius**2)).max())
    if not np.isfinite(entry):  # a window from immersion 0 begins at static contact whatever c_e: no ridge
        return Ridge(max_phi, False, True, exponent, alpha / c_e**exponent, np.inf)
    on_ridge = c_e > entry
    at = c_e if on_ridge else entry / _RIDGE_PHI
    alpha_there = float(likelihood.at(at).best_alpha[0])
    own_alpha = np.broadcast_to(likelihood.own_alpha, len(o.force))[likelihood.first_rows]
    r = likelihood.velocity_residuals(likelihood.model.unit(at), alpha_there) - own_alpha
    return Ridge(
        max_phi,
        on_ridge,
        # bounds that end below the ridge exclude it too
        profile.intervals["c_e"]["95"].upper is not None or bool(profile.c_e[-1] <= entry),
        exponent,
        alpha_there / at**exponent,
        float(np.sqrt(np.mean(r**2))),
    )


def status_of(
    n: int,
    at: str,
    ends: Sequence[Start],
    best: Start,
    ridge: Ridge,
    missed: float,
    doubt: tuple[str, str] | None,
) -> tuple[str, str]:
    """Status and reason of a fit to `n` rows, the gravest first.

    `at` is the sentence of `bound_reached`, `missed` by how much nlopt ended below the walk, `doubt` status and
    reason by the diagnostics.
    """
    if missed > FLAT:
        return (
            "not-converged",
            f"nlopt's BOBYQA ended where -2 log L is {missed:.3g} below the walk's lowest.",
        )
    if doubt is not None:
        return doubt[0], f"{doubt[1]} {at}".strip()
    if not ridge.excluded:
        return "ridge", (
            f"These data determine alpha/c_e^{ridge.exponent:.4g}, but not c_e and alpha apart. {at}".strip()
        )
    if at:
        return "at-bound", at
    c_e, alpha = agreement(ends, best, n)[1:]
    if max(c_e, alpha) > ONE_PLACE:
        return "disagreement", (
            f"Searches ended equally well at different places: c_e differs by a factor {c_e:.3g}, "
            f"alpha by {alpha:.3g}."
        )
    return "ok", "The search converged, its best ends agree, and c_e's 95 % interval has two ends."


def bound_reached(observations: Observations, box: Box, end: tuple[float, float]) -> str:
    """A sentence on the bound that an end lies at; empty where it lies at none."""
    for name, unit, value, low, high in zip(
        ("c_e", "alpha"), ("N/mm^2", "1/ms"), end, box.lower, box.upper, strict=True
    ):
        side = "lower" if value < low * (1 + _AT_BOUND) else "upper" if value > high * (1 - _AT_BOUND) else ""
        if side:
            why = ""
            if name == "c_e" and side == "lower" and low <= observations.c_e_floor * (1 + _AT_BOUND):
                why = f", below which the run at {observations.bounding_force:g} N would have had no window"
            if name == "c_e" and side == "upper" and high >= observations.ceiling * (1 - _AT_BOUND):
                why = ", above which an overloaded run would have had a window"
            return f"{name} ended at its {side} bound of {low if side == 'lower' else high:.4g} {unit}{why}."
    return ""


def agreement(ends: Sequence[Start], best: Start, n: int) -> tuple[list[Start], float, float]:
    """Ends as good as the best, and largest over smallest of their c_e and of their alpha."""
    # fits of earlier versions have a global search, which ends anywhere
    equal = [end for end in ends if end.origin != "global" and equally_good(end.objective, best, n)]
    c_e, alpha = (
        max(values) / min(values) for values in zip(*(end.end for end in [*equal, best]), strict=True)
    )
    return equal, c_e, alpha


def equally_good(objective: float, best: Start, n: int) -> bool:
    """Whether the RMS residual of an objective is that of the best search, within 0.1 %."""
    return bool(np.sqrt(objective / n) <= np.sqrt(best.objective / n) * (1 + _EQUAL) + 1e-6)


def obstacle(c_e: ConfidenceInterval, alpha: ConfidenceInterval, windows: float, status: str = "") -> str:
    """Why c_e and alpha are not separately identified; empty where they are.

    They are where both 95 % intervals are closed, c_e's spans less than a factor of 2 and begins above the bound that
    the `windows` set [N/mm^2], and the status is none of those below.
    """
    if c_e.closed and not alpha.closed:  # few specimens tell alpha's level badly
        return "alpha's 95 % interval is open"
    if not (c_e.closed and c_e.ratio() < SEPARATE):
        return f"c_e's 95 % interval not closed and within a factor of {SEPARATE:g}"
    begins = "c_e's 95 % interval begins at the bound that a window sets" if at_windows(c_e, windows) else ""
    return _UNFIT.get(status, begins)


def at_windows(c_e: ConfidenceInterval, windows: float) -> bool:
    """Whether an interval of c_e begins at the bound that the windows set [N/mm^2]."""
    return c_e.lower is not None and c_e.lower <= windows * (1 + _AT_BOUND)


def sentence(
    o: Observations, c_e: ConfidenceInterval, alpha: ConfidenceInterval, identified: Combination, status: str
) -> str:
    """The verdict in plain words, at 95 %."""
    rows = f"these {len(o)} points ({o.recorded_force.min():.3g} to {o.recorded_force.max():.3g} N)"
    why = obstacle(c_e, alpha, o.c_e_floor, status)
    if why in _UNFIT.values():
        return f"c_e and alpha are not separately identified: {why}."
    if not why:
        return (
            f"c_e and alpha are separately identified: {rows} determine c_e within {span(c_e)} N/mm^2 and "
            f"alpha within {span(alpha)} /ms (95 %)."
        )
    known = accuracy(identified)
    contrast = "but c_e only" if known.startswith("to") else "and c_e"
    return (
        f"c_e and alpha are not separately identified: {rows} determine alpha/c_e^{identified.exponent:.3g} "
        f"{known}, {contrast} {within(c_e)} (95 %)"
        f"{', where a window sets the lower end' if at_windows(c_e, o.c_e_floor) else ''}."
    )


def span(interval: ConfidenceInterval) -> str:
    """An interval in words; an open end is called open."""
    return " to ".join("open" if end is None else f"{end:.3g}" for end in (interval.lower, interval.upper))


def within(c_e: ConfidenceInterval) -> str:
    if c_e.closed:
        return f"within {span(c_e)} N/mm^2"
    if c_e.lower is not None:
        return f"from {c_e.lower:.3g} N/mm^2 up, with no upper end"
    return f"up to {c_e.upper:.3g} N/mm^2, with no lower end" if c_e.upper is not None else "not at all"


def accuracy(identified: Combination) -> str:
    """How well the combination is known: half the relative width of its 95 % interval."""
    interval = identified.interval
    if interval.ratio() == np.inf:
        return "with an open end"
    assert interval.lower is not None
    assert interval.upper is not None
    if interval.ratio() > SEPARATE:
        return f"only within a factor of {interval.ratio():.2g}"
    return f"to {50 * (interval.upper - interval.lower) / identified.value:.2g} %"
