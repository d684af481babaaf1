"""How far -2 log L may rise inside a level: the scatter of rows, and what few rows or groups leave unknown of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import scipy
from scipy import special

from burrlab.common.table import by_value
from burrlab.fitting.observations import Floats

_KNOWN = 1e9  # degrees of freedom of what is known
_DIRECTIONS, _NODES = 12, 400  # over c_e and alpha, and of Student's t, where the joint limit is sought


@dataclass(frozen=True)
class RowScatter:
    """Rows that share one scatter."""

    name: str  #: "velocity", "segments" or "force"
    n: int
    known: bool  #: sigma was given
    parameters: float  #: how many of the two parameters these rows determine; the scatters' sum is 2
    value: float  #: standard deviation about the fit [1], or [mm/s] for absolute residuals; 1 if known


@dataclass(frozen=True)
class Threshold:
    """How a rise of -2 log L along one quantity is judged: rise = inflation nu log(1 + F/nu).

    F has 1 and nu degrees of freedom. With known sigma nu is infinite, and F is a chi-square. Where `profiled` is
    False the likelihood is at fixed variances, and rise = inflation F.
    """

    inflation: float
    nu: float
    profiled: bool = True

    def rise(self, F: Any) -> Any:
        """The rise of an F, number or array."""
        curved = self.profiled and not np.isinf(self.nu)
        return self.inflation * (self.nu * np.log1p(F / self.nu) if curved else F)

    def statistic(self, rise: Any) -> Any:
        """F of a rise, number or array, or chi-square where sigma is known; 0 for a fall."""
        rise = np.maximum(rise, 0.0) / self.inflation
        curved = self.profiled and not np.isinf(self.nu)
        return self.nu * np.expm1(np.minimum(rise / self.nu, 700.0)) if curved else rise

    def probability(self, rise: float) -> float:
        """p-value of a rise."""
        F = float(self.statistic(rise))
        return float(special.chdtrc(1, F) if np.isinf(self.nu) else special.fdtrc(1, self.nu, F))

    def limit(self, level: float) -> float:
        """Largest rise inside `level`, 0.95 for 95 %."""
        # from special, because the checks of stats.f take a hundred times as long
        F = special.chdtri(1, 1 - level) if np.isinf(self.nu) else special.fdtri(1, self.nu, level)
        return float(self.rise(F))


def covariance_of(information: Floats) -> Floats:
    """Its inverse; on a ridge, where it is singular, that of one with a little more on the diagonal."""
    return np.asarray(
        np.linalg.inv(information + 1e-10 * np.trace(information) * np.eye(len(information))), np.float64
    )


@dataclass(frozen=True, eq=False)
class Calibration:
    """How far -2 log L may rise above its minimum, from the F distribution.

    For one estimated scatter and a model that is linear near the fit, S/S_min - 1 of q parameters is
    q/nu F(q, nu) with nu = n - 2. So the limit is n log(1 + q F/nu): wider than chi-square in small samples.
    Where sigma is known, the limit is chi-square's. Several scatters count by their share of the information
    in the direction asked for, nu by the rule of Welch and Satterthwaite. For both parameters (q = 2) the
    limit of one scatter is chi-square's times n/nu, the ratio of their means. Several scatters add their
    means: n (psi(n/2) - psi((n - p)/2)) for rows that determine p of the parameters (Bartlett's correction).

    References
    ----------
    Seber and Wild, Nonlinear Regression, Wiley 1989, section 5.3 (regions by the sum of squares).
    Bartlett, Properties of sufficiency and statistical tests, Proc. R. Soc. A 160 (1937).
    Satterthwaite, An approximate distribution of estimates of variance components, Biometrics 2 (1946).
    """

    scatters: tuple[RowScatter, ...]
    total: Floats  # information, shape (2, 2)
    shares: Floats  # by scatter
    monte_carlo: float = 0.0  # variance of the fit by the stochastic engine, over that by the data
    inflation: float = 1.0  # chi-square over degrees of freedom, where the data contradict their sigma

    def limit(self, level: float, direction: Floats | None = None) -> float:
        """Largest rise of -2 log L inside `level`.

        Parameters
        ----------
        level : float
            0.95 for 95 %.
        direction : ndarray, shape (2,), optional
            Gradient of one quantity over (log c_e, log alpha); None is for both parameters jointly.
        """
        return self.limits({"": level}, direction)[""]

    def limits(self, levels: Mapping[str, float], direction: Floats | None = None) -> dict[str, float]:
        """The limit of each level; see `limit`."""
        wider = (1 + self.monte_carlo) * self.inflation
        if direction is None:
            joint = self._joint_inflation()
            return {name: float(-2 * np.log1p(-level) * joint * wider) for name, level in levels.items()}
        threshold = self.threshold(direction)
        return {name: threshold.limit(level) * wider for name, level in levels.items()}

    def probability(self, rise: float, direction: Floats | None = None) -> float:
        """p-value of a rise of -2 log L: the inverse of `limit`."""
        rise /= (1 + self.monte_carlo) * self.inflation
        if direction is None:
            return float(np.exp(-rise / 2 / self._joint_inflation()))
        return self.threshold(direction).probability(rise)

    def threshold(self, direction: Floats | None) -> Threshold:
        """The threshold of one quantity, or the parameters' mean."""
        freedom = np.array([np.inf if s.known else max(s.n - s.parameters, 0.5) for s in self.scatters])
        weights = self._weights(direction)
        rows = np.array([s.n for s in self.scatters])
        inflation = float(np.sum(weights * np.where(np.isinf(freedom), 1.0, rows / freedom)))
        nu = 1 / max(float(np.sum(weights**2 / freedom)), 1e-12)
        return Threshold(inflation, nu if nu < 1e9 else np.inf)

    def variance(self, direction: Floats) -> tuple[float, float]:
        """Squared standard error along a gradient over (log c_e, log alpha), and its degrees of freedom."""
        threshold = self.threshold(direction)
        wider = (1 + self.monte_carlo) * self.inflation * threshold.inflation
        return wider * float(direction @ covariance_of(self.total) @ direction), threshold.nu

    @property
    def joint_freedom(self) -> tuple[float, ...]:
        """Of the test of both parameters: two, and a denominator where one scatter is estimated."""
        first, *others = self.scatters
        return (2.0,) if others or first.known else (2.0, float(first.n - 2))

    def _joint_inflation(self) -> float:
        """Mean rise of both parameters over chi-square's 2: n/(n - 2) for one scatter, as in the F limit."""
        means = [
            s.parameters
            if s.known
            else s.n * float(np.diff(special.digamma([max(s.n - s.parameters, 0.5) / 2, s.n / 2]))[0])
            for s in self.scatters
        ]
        return sum(means) / 2

    def _weights(self, direction: Floats | None) -> Floats:
        if len(self.scatters) == 1:
            return np.ones(1)
        inverse = covariance_of(self.total)
        if direction is None:
            return np.array([np.trace(inverse @ share) / 2 for share in self.shares])
        column = inverse @ direction
        weights = np.array([column @ share @ column for share in self.shares])
        return np.asarray(weights / weights.sum())


@by_value
@dataclass(frozen=True)
class MixedCalibration:
    """Covariance of (log c_e, log alpha), and the limits that follow from few groups."""

    covariance: Floats  #: Phi, shape (2, 2), at the estimated variances
    adjusted: Floats  #: shape (2, 2), larger by what the estimate of the variances adds
    changes: Floats  #: derivative of Phi by each variance, shape (m, 2, 2)
    of_variances: Floats  #: covariance of the estimated variances, shape (m, m)
    monte_carlo: float = 0.0  #: as in `Calibration`
    inflation: float = 1.0
    #: those estimated, shape (m,), beside one effect; None beside others, and in files that know Satterthwaite's nu alone
    variances: Floats | None = None

    def __post_init__(self) -> None:  # of no variances, JSON keeps no shape
        object.__setattr__(self, "changes", np.reshape(self.changes, (-1, *self.covariance.shape)))
        object.__setattr__(self, "of_variances", np.reshape(self.of_variances, 2 * (len(self.changes),)))

    @property
    def exponent(self) -> float:
        """p of the smallest standard error of log alpha - p log c_e."""
        return float(self.covariance[0, 1] / self.covariance[0, 0])

    def freedom(self, direction: Floats, weights: Floats | float = 0.0, added: float = 0.0) -> float:
        """Degrees of freedom of the standard error along a gradient over (log c_e, log alpha); 1 or more.

        To its variance that of something new may be `added`, a sum of the estimated variances with `weights`.
        Satterthwaite's, which are too many where few groups happen to differ little; so, beside one effect, those at
        which the squared limit is the sum of the parts' own (Banerjee, Ann. Inst. Stat. Math. 12, 1961).
        """
        change = np.einsum("i,kij,j->k", direction, self.changes, direction) + weights
        variance = float(direction @ self.covariance @ direction) + added
        if self.variances is not None:
            L = np.linalg.cholesky(self.of_variances)
            sizes = np.linalg.solve(L, self.variances)
            parts = (L.T @ change) * sizes / variance
            if (parts >= -1e-9).all():
                limits = special.fdtri(1, np.maximum(2 * sizes**2, 1.0), 0.95)
                return _freedom_at(1, float(parts @ limits + (1 - parts.sum()) * special.chdtri(1, 0.05)))
        spread = max(float(change @ self.of_variances @ change), 1e-300)
        return float(np.clip(2 * variance**2 / spread, 1.0, _KNOWN))

    @property
    def bias(self) -> float:
        """By how much `adjusted` is larger, the mean of both parameters; 1 at least."""
        return max(float(np.trace(np.linalg.solve(self.covariance, self.adjusted))) / 2, 1.0)

    @property
    def freedoms(self) -> tuple[float, float]:
        """Of the direction that knows least, and of that across."""
        root = np.linalg.inv(np.linalg.cholesky(self.covariance))
        each = [
            self.freedom(np.array([np.cos(x), np.sin(x)]) @ root)
            for x in np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
        ]
        least = int(np.argmin(each))
        return each[least], each[least - _DIRECTIONS // 2]

    @property
    def freedom_of_sum(self) -> float:
        """nu at which F with 2 and nu has the 95 % limit of two squares of t, see `freedoms`."""
        least, across = self.freedoms
        squares = special.stdtrit(least, (np.arange(_NODES) + 0.5) / _NODES) ** 2

        def beyond(limit: float) -> float:
            """Probability that the sum lies beyond a limit, over 5 %."""
            return float(np.mean(special.fdtrc(1, across, np.maximum(limit - squares, 0.0)))) - 0.05

        return _freedom_at(2, float(scipy.optimize.brentq(beyond, 1.0, 1e6)) / 2)

    def probability_of_sum(self, squares: float) -> float:
        """p-value of two squares of t, see `freedoms`; F with 2 and `freedom_of_sum` has it at 5 % alone."""
        least, across = self.freedoms
        below = float(special.fdtr(1, across, squares))  # probability that the second alone is
        others = special.fdtri(1, across, below * (np.arange(_NODES) + 0.5) / _NODES)
        return 1 - below + below * float(np.mean(special.fdtrc(1, least, squares - others)))

    def variance(self, direction: Floats) -> tuple[float, float]:
        """See `Calibration.variance`."""
        wider = (1 + self.monte_carlo) * self.inflation
        variances = [float(direction @ Phi @ direction) for Phi in (self.adjusted, self.covariance)]
        return wider * max(variances), self.freedom(direction)

    def limit(self, level: float, direction: Floats | None = None) -> float:
        """Largest rise of -2 log L inside `level`; see `Calibration.limit`."""
        return self.limits({"": level}, direction)[""]

    def limits(self, levels: Mapping[str, float], direction: Floats | None = None) -> dict[str, float]:
        """The limit of each level."""
        number, freedom, wider = self._test(direction)
        return {name: float(wider * number * special.fdtri(number, freedom, p)) for name, p in levels.items()}

    def probability(self, rise: float, direction: Floats | None = None) -> float:
        """p-value of a rise of -2 log L: the inverse of `limit`."""
        number, freedom, wider = self._test(direction)
        return float(special.fdtrc(number, freedom, max(rise, 0.0) / (number * wider)))

    def threshold(self, direction: Floats | None) -> Threshold:
        """See `Calibration.threshold`."""
        _, freedom, wider = self._test(direction)
        return Threshold(wider / (1 + self.monte_carlo) / self.inflation, freedom, profiled=False)

    @property
    def joint_freedom(self) -> tuple[float, ...]:
        """See `Calibration.joint_freedom`."""
        return (2.0, float(self._test(None)[1]))

    def _test(self, direction: Floats | None) -> tuple[int, float, float]:
        """How many quantities F is of, its degrees of freedom, and the factor of its limits."""
        wider = (1 + self.monte_carlo) * self.inflation
        if direction is not None:
            bias = float(direction @ self.adjusted @ direction) / float(
                direction @ self.covariance @ direction
            )
            return 1, self.freedom(direction), wider * max(bias, 1.0)
        freedom, scale = self._joint
        return 2, freedom, wider * scale

    @cached_property
    def _joint(self) -> tuple[float, float]:
        """Degrees of freedom of the joint F, and the factor of its limits."""
        root, bias = np.linalg.inv(np.linalg.cholesky(self.covariance)), self.bias
        if not len(self.changes):  # sigma and the sizes of all effects are given
            return _KNOWN, bias
        # Kenward and Roger's section 2.3, for two quantities
        change = root @ self.changes @ root.T
        trace, of_pairs = np.einsum("kii->k", change), np.einsum("kij,lji->kl", change, change)
        A1, A2 = float(trace @ self.of_variances @ trace), float(np.sum(self.of_variances * of_pairs))
        B, g = (A1 + 6 * A2) / 4, (3 * A1 - 6 * A2) / (4 * A2)
        c1, c2, c3 = np.array([g, 2 - g, 4 - g]) / (6 + 2 * (1 - g))
        mean = 1 / max(1 - A2 / 2, 1e-9)
        variance = (1 + c1 * B) / ((1 - c2 * B) ** 2 * (1 - c3 * B))
        ratio = variance / (2 * mean**2)
        # their expansion fails where one direction has few degrees of freedom: there rises of two directions add up
        apart = (
            min(self.freedom(column) for column in np.linalg.eigh(self.adjusted)[1].T)
            if self.variances is None
            else self.freedom_of_sum
        )
        if A2 >= 2 or c3 * B >= 1 or ratio <= 0.5:
            return apart, bias
        freedom = 4 + 4 / (2 * ratio - 1)
        smaller = mean * (freedom - 2) / freedom
        larger = smaller * special.fdtri(2, freedom, 0.95) < special.fdtri(2, apart, 0.95)
        return (apart, bias) if larger and self.variances is not None else (freedom, bias * smaller)


def _freedom_at(number: int, limit: float) -> float:
    """nu at which F with a number and nu degrees of freedom has a 95 % limit; 1e9 at most."""

    def above(log_nu: float) -> float:
        return float(special.fdtri(number, np.exp(log_nu), 0.95)) - limit

    few, many = np.log(0.5), np.log(1e9)
    return float(np.exp(many if above(many) >= 0 else scipy.optimize.brentq(above, few, many)))


AnyCalibration: TypeAlias = Calibration | MixedCalibration
