"""How far -2 log L may rise: limits of intervals and regions, and p-values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special, stats

from burrlab.fitting.observations import Floats


@dataclass(frozen=True)
class Scatter:
    """Rows that share one scatter."""

    name: str  #: "velocity", "segments" or "force"
    n: int
    known: bool  #: sigma was given
    parameters: float  #: how many of the two parameters these rows determine, in sum 2
    value: float  #: standard deviation about the fit, 1, or [mm/s] for absolute residuals; of 1 if known


@dataclass(frozen=True, eq=False)
class Calibration:
    """How far -2 log L may rise above its minimum, from the F distribution.

    For one estimated scatter and a model that is linear near the fit, S/S_min - 1 of q parameters is
    q/nu F(q, nu), nu = n - 2, so the limit is n log(1 + q F/nu): wider than chi-square in small samples, and
    chi-square where sigma is known. Several scatters count by their share of the information in the direction
    asked for, nu by the rule of Welch and Satterthwaite. For both parameters (q = 2) the limit of one scatter is
    chi-square's times n/nu, its mean over chi-square's; several add their means,
    n (psi(n/2) - psi((n - p)/2)) where the rows determine p of the parameters (Bartlett's correction).

    References
    ----------
    Seber and Wild, Nonlinear Regression, Wiley 1989, section 5.3 (regions by the sum of squares).
    Bartlett, Properties of sufficiency and statistical tests, Proc. R. Soc. A 160 (1937).
    Satterthwaite, An approximate distribution of estimates of variance components, Biometrics 2 (1946).
    """

    scatters: tuple[Scatter, ...]
    total: Floats  # information, shape (2, 2)
    shares: Floats  # by scatter
    monte_carlo: float = 0.0  # variance of the stochastic engine's log c_e over that of the data

    def limit(self, level: float, direction: Floats | None = None) -> float:
        """Largest rise of -2 log L inside `level`.

        Parameters
        ----------
        level : float
            0.95 for 95 %.
        direction : ndarray, shape (2,), optional
            Gradient of one quantity over (log c_e, log alpha); None: both parameters jointly.
        """
        if direction is None:
            return float(-2 * np.log1p(-level) * self._joint_inflation() * (1 + self.monte_carlo))
        weights = self._weights(direction)
        freedom = np.array([np.inf if s.known else max(s.n - s.parameters, 0.5) for s in self.scatters])
        inflation = sum(
            w * (1.0 if s.known else s.n / f) for w, s, f in zip(weights, self.scatters, freedom, strict=True)
        )
        nu = 1 / max(float(np.sum(weights**2 / freedom)), 1e-12)
        # special's, for the checks of stats.f take a hundred times as long
        F = float(special.fdtri(1, nu, level) if nu < 1e9 else special.chdtri(1, 1 - level))
        rise = nu * np.log1p(F / nu) if nu < 1e9 else F
        return float(inflation * rise * (1 + self.monte_carlo))

    def _joint_inflation(self) -> float:
        """Mean rise of both parameters over chi-square's 2: n/(n - 2) for one scatter, exactly the F limit."""
        mean = 0.0
        for s in self.scatters:
            freedom = max(s.n - s.parameters, 0.5)
            mean += (
                s.parameters if s.known else s.n * float(np.diff(special.digamma([freedom / 2, s.n / 2]))[0])
            )
        return mean / 2

    def probability(self, rise: float, q: int = 2) -> float:
        """p-value of a rise of -2 log L, q parameters: the inverse of `limit`."""
        if len(self.scatters) == 1 and not self.scatters[0].known:
            n = self.scatters[0].n
            F = np.expm1(rise / (1 + self.monte_carlo) / n) * (n - 2) / q
            return float(stats.f.sf(F, q, n - 2))
        if all(s.known for s in self.scatters):
            return float(stats.chi2.sf(rise / (1 + self.monte_carlo), q))
        direction = None if q == 2 else np.array([1.0, 0.0])
        low, high = 0.0, 1.0
        for _ in range(60):  # the limit rises with the level
            middle = (low + high) / 2
            low, high = (middle, high) if self.limit(middle, direction) < rise else (low, middle)
        return 1 - low

    def of_another_point(self, rise: float) -> tuple[float, float]:
        """F and its denominator for a rise of -2 log L by one c_e and alpha more than two parameters.

        Twice the parameters are taken from the rows of every scatter; without estimated ones the denominator is
        infinite, and twice F a chi-square of 2.
        """
        freedom = np.array([np.inf if s.known else max(s.n - 2 * s.parameters, 0.5) for s in self.scatters])
        weights = self._weights(None)
        inflation = sum(
            w * (1.0 if s.known else s.n / f) for w, s, f in zip(weights, self.scatters, freedom, strict=True)
        )
        nu = 1 / max(float(np.sum(weights**2 / freedom)), 1e-12)
        scaled = rise / float(inflation)
        return (float(np.expm1(scaled / nu) * nu / 2), nu) if nu < 1e9 else (scaled / 2, np.inf)

    def _weights(self, direction: Floats | None) -> Floats:
        if len(self.scatters) == 1:
            return np.ones(1)
        inverse = np.linalg.inv(self.total + 1e-10 * np.trace(self.total) * np.eye(2))
        if direction is None:
            return np.array([np.trace(inverse @ share) / 2 for share in self.shares])
        column = inverse @ direction
        weights = np.array([column @ share @ column for share in self.shares])
        return np.asarray(weights / weights.sum())
