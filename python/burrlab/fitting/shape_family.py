"""The family of erosion shapes f = (1 - x^2)^k with k free: its velocities, its best k, and k's profile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly
from scipy.optimize import brentq, minimize_scalar

from burrlab._core import Shape
from burrlab.fitting.intervals import LEVELS, Interval
from burrlab.fitting.likelihood import Likelihood, MeanFieldModel
from burrlab.fitting.observations import Calibration, Floats, Observations, ResidualKind, Scatter, Threshold
from burrlab.fitting.profile import Domain, Minimum, lowest
from burrlab.theory.continuum import MasterCurve, _window_spline, positive

NODES = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  #: k of the master curves that the others come from
_STEP = 1e-3  # of k and of log c_e, in derivatives of the residuals
_FINE, _COARSE = 24, 31  # points of a profile within the widest interval, and over all k


def member(k: float) -> Shape:
    """(1 - x^2)^k; k = 0 is `constant`."""
    return Shape("constant" if k == 0 else f"power({k:.17g})")


class FamilyCurve(MasterCurve):
    """The master curve of any k from 0 to 3, between those of `NODES`.

    log Psi at given phi is the polynomial in k through its values at the nodes, so it is exact there. In
    between it lies within 0.02 % of a master curve made for that k, a tenth of the latter's own error. As the
    master curves are piecewise cubic in log phi, so is this one, with the pieces of all of them.
    """

    def __init__(self, k: float) -> None:
        super().__init__(member(k))
        nodes = np.array(NODES)
        others = ~np.eye(len(nodes), dtype=bool)
        self._weights = np.array(
            [np.prod((k - nodes[o]) / (node - nodes[o])) for node, o in zip(nodes, others, strict=True)]
        )
        self._splines: dict[tuple[float | None, float | None], tuple[float, PPoly]] = {}

    def velocity_ratio(
        self, phi: ArrayLike, start: float | None = None, stop: float | None = None
    ) -> np.float64 | Floats:
        """See `MasterCurve.velocity_ratio`."""
        if (start, stop) not in self._splines:
            end, x, coefficients = _pieces(start, stop)
            poly = PPoly(np.tensordot(self._weights, coefficients, axes=1), x)
            self._splines[start, stop] = end, poly
        end, poly = self._splines[start, stop]
        phi = positive("phi", phi)
        ratio = np.exp(poly(np.log(np.minimum(phi, end))))
        return np.asarray(np.where(phi < end, ratio, np.nan))[()]


@lru_cache(maxsize=256)
def _pieces(start: float | None, stop: float | None) -> tuple[float, Floats, Floats]:
    """phi at the window's end, common breaks, and the cubics' coefficients of each node there."""
    splines = [_window_spline(member(k).name, start, stop) for k in NODES]
    x = np.unique(np.concatenate([spline.log_ratio.x for spline in splines]))
    left = x[:-1]
    factorial = np.array([6.0, 2.0, 1.0, 1.0])
    coefficients = [
        [spline.log_ratio(left, order) / f for order, f in zip((3, 2, 1, 0), factorial, strict=True)]
        for spline in splines
    ]
    return splines[0].end, x, np.array(coefficients)


class FamilyModel(MeanFieldModel):
    """Predictions of one k; see `MeanFieldModel`."""

    def __init__(self, observations: Observations, k: float) -> None:
        super().__init__(observations, member(k))
        self._curve = FamilyCurve(k)


class PowerFamily:
    """The likelihood of data over k, c_e and alpha at their best."""

    def __init__(self, observations: Observations, kind: ResidualKind, domain: Domain) -> None:
        self.observations, self.kind, self.domain = observations, kind, domain

    def likelihood(self, k: float) -> Likelihood:
        """That of c_e and alpha at one k."""
        return Likelihood(self.observations, self.kind, FamilyModel(self.observations, k))

    def lowest(self, k: float) -> Minimum:
        """The minimum of -2 log L at one k."""
        return lowest(self.likelihood(k), self.domain)

    def minimise(self) -> tuple[float, Minimum]:
        """Best k, and the minimum of -2 log L there."""
        heights = [self.lowest(k).minus2 for k in NODES]
        i = int(np.argmin(heights))
        ends = NODES[max(i - 1, 0)], NODES[min(i + 1, len(NODES) - 1)]
        found = minimize_scalar(
            lambda k: self.lowest(float(k)).minus2, bounds=ends, method="bounded", options={"xatol": 1e-4}
        )
        k = float(found.x) if found.fun < heights[i] else NODES[i]
        return k, self.lowest(k)

    def threshold(self, k: float, point: tuple[float, float]) -> Threshold | None:
        """For k at a point of three parameters; None where the data leave no freedom for it."""
        c_e, alpha = point
        low = self.domain.low
        middle = min(max(k, NODES[0] + _STEP), NODES[-1] - _STEP)
        steps = np.exp([-_STEP, _STEP]) * max(c_e, low * float(np.exp(_STEP)))
        likelihood = self.likelihood(k)
        here = likelihood.residuals(c_e, alpha)
        by_k = [self.likelihood(middle + sign * _STEP).residuals(c_e, alpha) for sign in (-1, 1)]
        by_c_e = [likelihood.residuals(float(step), alpha) for step in steps]
        by_alpha = [likelihood.residuals(c_e, alpha * float(np.exp(sign * _STEP))) for sign in (-1, 1)]
        shares = []
        for i, (_, known, r, _) in enumerate(here):
            J = np.stack(
                [(pair[1][i][2] - pair[0][i][2]) / (2 * _STEP) for pair in (by_c_e, by_alpha, by_k)], axis=1
            )
            shares.append(J.T @ J / (1.0 if known else max(float(np.mean(r**2)), 1e-12)))
        if not all(known for _, known, _, _ in here) and sum(len(r) for _, _, r, _ in here) <= 3:
            return None
        total = np.sum(shares, axis=0)
        inverse = np.linalg.inv(total + 1e-10 * np.trace(total) * np.eye(3))
        used = [3.0] if len(shares) == 1 else [float(np.trace(inverse @ share)) for share in shares]
        scatters = tuple(
            Scatter(name, len(r), known, p, 1.0) for (name, known, r, _), p in zip(here, used, strict=True)
        )
        return Calibration(scatters, total, np.array(shares)).threshold(np.array([0.0, 0.0, 1.0]))

    def profile(self, k: float, best: Minimum, threshold: Threshold) -> PowerProfile:
        """The rise of -2 log L over k and the intervals, from the best k."""
        limits = {name: threshold.limit(level) for name, level in LEVELS.items()}

        def rise(at: float) -> float:
            return self.lowest(at).minus2 - best.minus2

        def end(edge: float, limit: float) -> float | None:
            if edge == k:
                return None
            step = 0.02 if edge > k else -0.02
            inner, outer = k, k + step
            while (edge - outer) * step > 0 and rise(outer) <= limit:
                inner, step = outer, 2 * step
                outer += step
            outer = outer if (edge - outer) * step > 0 else edge
            if rise(outer) <= limit:
                return None
            return float(brentq(lambda x: rise(x) - limit, inner, outer, xtol=1e-4))

        intervals = {
            name: Interval(end(NODES[0], limit), end(NODES[-1], limit)) for name, limit in limits.items()
        }
        widest = intervals["99.7"]
        low = NODES[0] if widest.lower is None else widest.lower
        high = NODES[-1] if widest.upper is None else widest.upper
        margin = 0.3 * (high - low)
        fine = np.linspace(max(low - margin, NODES[0]), min(high + margin, NODES[-1]), _FINE)
        ks = np.unique(np.concatenate([fine, np.linspace(NODES[0], NODES[-1], _COARSE), [k]]))
        return PowerProfile(
            k=k,
            c_e=best.c_e,
            alpha=best.alpha,
            intervals=intervals,
            limits=limits,
            grid=ks,
            rise=np.maximum([rise(float(at)) for at in ks], 0.0),
        )


@dataclass(frozen=True, eq=False)
class PowerProfile:
    """The best member of the family power(k), and how well k is known.

    Attributes
    ----------
    k : float
        Best exponent, from 0 to 3.
    c_e, alpha : float
        [N/mm^2] and [1/ms] there.
    intervals : mapping
        Level ``68``, ``95``, ``99.7`` -> Interval of k; None is open: at k = 0, where the family begins, or at
        k = 3, where the search ends.
    limits : mapping
        Level -> rise of -2 log L that bounds the interval.
    grid, rise : ndarray, shape (m,)
        k, and the rise of -2 log L there, c_e and alpha at their best.
    """

    k: float
    c_e: float
    alpha: float
    intervals: Mapping[str, Interval]
    limits: Mapping[str, float]
    grid: Floats
    rise: Floats
