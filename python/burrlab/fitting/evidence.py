"""What the data say about c_e and alpha, put together once for the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from burrlab._core import Shape
from burrlab.dataset import by_value
from burrlab.fitting.calibration import Calibration, Scatter
from burrlab.fitting.hypotheses import fall_with_depth, lack_of_fit
from burrlab.fitting.intervals import Profile
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.observations import Floats
from burrlab.fitting.profile import Domain, profile
from burrlab.fitting.search import Box
from burrlab.fitting.verdict import Ridge, ridge_of, sentence
from burrlab.fitting.voxel import VoxelTable, monte_carlo_share

_BETTER = 1e-5  # of -2 log L: by more than this the walk along c_e must beat a search to be followed


@by_value
@dataclass(frozen=True)
class Evidence:
    """What the likelihood says.

    Attributes
    ----------
    log_likelihood : float
        At the fit, all constants in; of the velocities in mm/s and forces in N.
    information : ndarray, shape (2, 2)
        Fisher information in (log c_e, log alpha).
    scatters : tuple of Scatter
        Estimated or given.
    shares : ndarray, shape (len(scatters), 2, 2)
        What each of them adds to the information.
    monte_carlo : float
        SE_mc^2/SE_stat^2 of a stochastic engine; 0 for mean-field. The limits are 1 + this wider.
    profile : Profile
    ridge : Ridge
    verdict : str
        In plain words, at 95 %.
    better : (float, float) or None
        A better point than the fit, (c_e, alpha), where the walk along c_e met one.
    """

    log_likelihood: float
    information: Floats
    scatters: tuple[Scatter, ...]
    shares: Floats
    monte_carlo: float
    profile: Profile
    ridge: Ridge
    verdict: str
    better: tuple[float, float] | None = None

    @property
    def calibration(self) -> Calibration:
        """The limits that the intervals and tests use."""
        return Calibration(self.scatters, self.information, self.shares, self.monte_carlo)


def weigh(
    likelihood: Likelihood,
    shape: Shape,
    box: Box,
    given: Mapping[str, object] | None,
    best: tuple[float, float],
    table: VoxelTable | None,
) -> Evidence:
    """The evidence at a fit.

    Parameters
    ----------
    likelihood : Likelihood
    shape : Shape
    box : Box
        Of the search.
    given : mapping or None
        Parameters whose bounds the user gave.
    best : (float, float)
        c_e [N/mm^2], alpha [1/ms].
    table : VoxelTable or None
        Of the voxel engine.
    """
    o = likelihood.observations
    exponent = 4 * (shape.order + 1) / 3
    domain = Domain.of(likelihood, box, given or {})
    total, scatters, shares = likelihood.information(*best)
    found = profile(likelihood, Calibration(scatters, total, shares), domain, best, exponent)
    monte_carlo = 0.0
    if table is not None:
        is_open = found.intervals["c_e"]["95"].upper is None
        monte_carlo = monte_carlo_share(likelihood, shape, table, best, is_open)
        found = profile(likelihood, Calibration(scatters, total, shares, monte_carlo), domain, best, exponent)
    lowest = int(np.argmin(found.c_e_rise))
    there = float(likelihood.at(best[0]).minus2(best[1])[0])
    better = None
    if found.base < there - _BETTER:
        better = (float(found.c_e[lowest]), float(found.best_alpha[lowest]))
    intervals = found.intervals
    forces = (float(o.force.min()), float(o.force.max()))
    said = sentence(len(o), forces, intervals["c_e"]["95"], intervals["alpha"]["95"], found.identified)
    return Evidence(
        likelihood.log_likelihood(*best),
        total,
        scatters,
        shares,
        monte_carlo,
        found,
        ridge_of(likelihood, exponent, best, found),
        said,
        better,
    )


def describe(likelihood: Likelihood, best: tuple[float, float], usable: bool) -> dict[str, Any]:
    """Predictions, residuals and tests at the fit, as fields of a `Fit`; NaN and None if it is not usable."""
    o = likelihood.observations
    c_e, alpha = best if usable else (np.nan, np.nan)
    unit = likelihood.model.unit(c_e) if usable else np.full(len(o.force), np.nan)
    predicted, residuals = [], []
    with np.errstate(invalid="ignore"):
        for kind, rows in o.rows:
            if kind == "velocity":
                v, model = o.velocity[rows], alpha * unit[rows]
                known, sigma = likelihood.known, o.sigma[rows]
            else:
                v, model = o.pressed[rows], c_e * o.pressed_unit[rows]
                known, sigma = likelihood.pressed_known, o.pressed_sigma[rows]
            predicted.append(model)
            if known:
                residuals.append((v - model) / sigma)
            elif kind == "velocity" and likelihood.kind == "absolute":
                residuals.append(v - model)
            else:
                residuals.append(np.log(v / model))
    chi2 = None
    if o.has_sigma and usable:
        chi2 = float(np.sum(((o.velocity - alpha * unit) / o.sigma) ** 2) / (len(o.force) - 2))
    return {
        "predicted": np.concatenate(predicted),
        "residuals": np.concatenate(residuals),
        "residual_norm": float(np.sqrt(np.mean(np.concatenate(residuals) ** 2))),
        "chi2_reduced": chi2,
        "n_points": len(o),
        "n_skipped": o.n_skipped,
        "n_censored": o.n_censored,
        "lack_of_fit": lack_of_fit(likelihood, best) if usable else None,
        "fall": fall_with_depth(likelihood, unit) if usable else None,
    }
