"""-2 log L over alpha at each of several c_e, and where it stays below a target: parabolas, and where it is none."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from burrlab.fitting.observations import Floats, Rows

_LARGEST = 500.0  # largest |log alpha|: limits beyond are cut to it, so that they stay finite


@dataclass(frozen=True, eq=False)
class AlphaSlices:
    """-2 log L over alpha at each of several c_e: a parabola in g for each; arrays of shape (len(c_e),)."""

    c_e: Floats  #: [N/mm^2]
    A: Floats  #: lowest sum of squares of the velocities, over alpha
    B: Floats  #: half the second derivative of that sum by g
    m: Floats  #: g of the lowest: log alpha, or alpha where `log` is False
    other: Floats  #: -2 log L of segments and forces, for any alpha
    n: int  #: velocities
    known: bool  #: their sigma is given
    floor: float  #: added to their squared scatter: the model's own error, squared
    log: bool

    def joined(self, others: "list[AlphaSlices]", places: Rows) -> "AlphaSlices":
        """The slices at some places of these and then of others."""
        columns: dict[str, Any] = {
            name: np.concatenate([column.T, *(getattr(other, name).T for other in others)], axis=-1)[
                ..., places
            ].T
            for name, column in vars(self).items()
            if isinstance(column, np.ndarray)
        }
        return replace(self, **columns)

    @property
    def best_alpha(self) -> Floats:
        """alpha [1/ms] of the lowest -2 log L."""
        return np.exp(self.m) if self.log else np.maximum(self.m, 1e-300)

    @property
    def profile(self) -> Floats:
        """-2 log L at the best alpha; NaN where c_e leaves no window."""
        return self._minus2(self.A)

    def minus2(self, alpha: ArrayLike) -> Floats:
        """-2 log L at alpha [1/ms], one for each c_e."""
        g = np.log(alpha) if self.log else np.asarray(alpha, dtype=np.float64)
        return self._minus2(self.A + self.B * (g - self.m) ** 2)

    def minus2_table(self, alpha: Floats) -> Floats:
        """-2 log L, a row for each alpha and a column for each c_e, or infinity far from a row's lowest."""
        return self.minus2(alpha[:, None])

    def alpha_below(self, target: float) -> tuple[Floats, Floats]:
        """The alphas [1/ms] between which -2 log L is below a target; NaN where there are none."""
        rest = target - self.other
        with np.errstate(invalid="ignore", over="ignore"):
            S = rest if self.known else self.n * (np.exp(rest / self.n) - self.floor)
            half = np.sqrt((S - self.A) / self.B)
            if self.log:
                low, high = (np.clip(self.m + sign * half, -_LARGEST, _LARGEST) for sign in (-1, 1))
                return np.exp(low), np.exp(high)
            return np.maximum(self.m - half, 0.0), np.minimum(self.m + half, np.exp(_LARGEST))

    def _minus2(self, S: Floats) -> Floats:
        return self.other + (S if self.known else self.n * np.log(S / self.n + self.floor))


@dataclass(frozen=True, eq=False)
class CurvedSlices(AlphaSlices, ABC):
    """-2 log L over alpha where it is no parabola; a subclass says how high it is."""

    g: Floats  # log alpha of the lowest
    height: Floats  # -2 log L there

    @abstractmethod
    def _over(self, g: Floats, points: Rows | slice = slice(None)) -> tuple[Floats, Floats]:
        """-2 log L at log alpha = g and its slope; the last axis of g is that of c_e, or of some of its points."""

    @abstractmethod
    def _beyond(self, target: float, points: Rows) -> Floats:
        """How far from m the target is reached at the latest."""

    @property
    def best_alpha(self) -> Floats:
        """See `AlphaSlices`."""
        return np.exp(self.g)

    @property
    def profile(self) -> Floats:
        """See `AlphaSlices`."""
        return self.height

    def minus2(self, alpha: ArrayLike) -> Floats:
        """See `AlphaSlices`."""
        return self._over(np.broadcast_to(np.log(alpha), np.broadcast_shapes(np.shape(alpha), self.g.shape)))[
            0
        ]

    def alpha_below(self, target: float) -> tuple[Floats, Floats]:
        """See `AlphaSlices`; by Newton's method from beyond the end, halving where it leaves the bracket."""
        ends, points = np.full((2, len(self.g)), np.nan), np.flatnonzero(self.height <= target)
        middle, reach = self.m[points], self._beyond(target, points)
        if middle.ndim == 1:
            middle, reach = middle[:, None], reach[:, None]
        for side, end in zip((-1, 1), ends, strict=True):
            near, far = self.g[points], side * np.max(side * middle + reach, axis=1)
            g = far
            for _ in range(_ROUNDS):
                height, slope = self._over(g, points)
                near, far = np.where(height <= target, g, near), np.where(height > target, g, far)
                with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                    step = g - (height - target) / slope
                    last, within = g, (step - near) * (far - step) >= 0
                g = np.where(within, step, (near + far) / 2)
                if np.abs(g - last).max(initial=0.0) < _CLOSE:
                    break
            end[points] = np.exp(np.clip(g, -_LARGEST, _LARGEST))
        return ends[0], ends[1]


@dataclass(frozen=True, eq=False)
class TobitSlices(CurvedSlices):
    """-2 log L of log-normal velocities and of others that lie below limits, with the best scatter at each alpha.

    Over 1/s and g/s it is convex, s the scatter and g = log alpha.

    References
    ----------
    Olsen, Note on the uniqueness of the maximum likelihood estimator for the Tobit model, Econometrica 46 (1978).
    """

    limits: Floats  # log of the limits less log of the model's velocity at alpha = 1, shape (m, k)

    @classmethod
    def of(
        cls, c_e: Floats, A: Floats, mean: Floats, other: Floats, n: int, floor: float, limits: Floats
    ) -> "TobitSlices":
        """By Newton's method in 1/s and g/s."""
        S = A + n * floor
        steep, level = np.sqrt(n / S), np.sqrt(n / S) * mean
        for _ in range(_ROUNDS):
            hazard, bend = _hazard(steep[:, None] * limits - level[:, None])
            off = n * (steep * mean - level)
            slopes = (
                -n / steep + S * steep + mean * off - np.sum(hazard * limits, axis=1),
                np.sum(hazard, axis=1) - off,
            )
            a = n / steep**2 + S + n * mean**2 + np.sum(bend * limits**2, axis=1)
            b, c = -n * mean - np.sum(bend * limits, axis=1), n + np.sum(bend, axis=1)
            step = (c * slopes[0] - b * slopes[1]) / (a * c - b**2)
            last, steep = steep, np.maximum(steep - step, steep / 4)
            level = level - (slopes[1] + b * (steep - last)) / c
            if not np.any(np.abs(steep - last) > 1e-12 * last):
                break
        g = level / steep
        slices = cls(c_e, A, np.full(len(c_e), float(n)), mean, other, n, False, floor, True, g, g, limits)
        return replace(slices, height=slices._over(g)[0])

    def _beyond(self, target: float, points: Rows) -> Floats:
        """See `CurvedSlices`: without the limits."""
        S = self.n * (np.exp((target - self.other[points]) / self.n) - self.floor)
        return np.asarray(np.sqrt((S - self.A[points]) / self.n))

    def _over(self, g: Floats, points: Rows | slice = slice(None)) -> tuple[Floats, Floats]:
        """See `CurvedSlices`."""
        off = g - self.m[points]
        S, d = self.A[points] + self.n * (self.floor + off**2), self.limits[points] - g[..., None]
        steep = np.sqrt(self.n / S)
        for _ in range(_ROUNDS):
            hazard, bend = _hazard(steep[..., None] * d)
            slope = -self.n / steep + S * steep - np.sum(hazard * d, axis=-1)
            stiff = self.n / steep**2 + S + np.sum(bend * d**2, axis=-1)
            last, steep = steep, np.maximum(steep - slope / stiff, steep / 4)
            if not np.any(np.abs(steep - last) > _ENOUGH * last):
                break
        below = np.sum(scipy.special.log_ndtr(steep[..., None] * d), axis=-1)
        height = self.other[points] - 2 * self.n * np.log(steep) + S * steep**2 - self.n - 2 * below
        rise = 2 * steep**2 * self.n * off + 2 * steep * np.sum(hazard, axis=-1)
        return np.asarray(np.where(np.isfinite(height), height, np.inf)), rise


def _hazard(z: Floats) -> tuple[Floats, Floats]:
    """Slope of log Phi(z), and less its curvature."""
    hazard = np.exp(-0.5 * (z**2 + np.log(2 * np.pi)) - scipy.special.log_ndtr(z))
    return hazard, hazard * (z + hazard)


FREEDOM = 4.0  #: degrees of freedom of the robust likelihood (ours)
FLATTER = (FREEDOM + 1) / (FREEDOM + 3)  # its information, over that of a normal distribution of equal scale
_ROUNDS = 30  # of Newton's method or reweighting, at most; 6 are usual
_CLOSE = 1e-8  # a step of log alpha that ends Newton's method
_ENOUGH = 1e-6  # a relative step of Newton's method after which the error is below 1e-11


def _at_scale(r: Floats, scale2: Floats, floor: float) -> tuple[Floats, Floats, Floats]:
    """-2 log L of Student's t for residuals about 0, over the last axis, its slope, and a better squared scale.

    The value is at the better scale, by the parabola of Newton's method; the slope is by a shift of log alpha.
    """
    whole = FREEDOM * scale2[..., None] + r**2
    weighted = r / whole
    part = weighted * r  # q/(nu + q), q = r^2/s^2, whose mean is 1/(nu + 1) at the best scale
    slope, total = -2 * (FREEDOM + 1) * np.sum(weighted, axis=-1), np.sum(part, axis=-1)
    n, excess = r.shape[-1], (FREEDOM + 1) * total - r.shape[-1]
    curvature = (FREEDOM + 1) * (total - np.sum(np.square(part, out=part), axis=-1))
    better = np.maximum(scale2 * np.exp(np.clip(excess / np.maximum(curvature, 1e-9), -1, 1)), floor)
    step = np.log(better / scale2)
    tails = np.sum(np.log(whole, out=whole), axis=-1) - n * np.log(FREEDOM * scale2)
    minus2 = n * np.log(scale2) + (FREEDOM + 1) * tails - step * (excess - curvature * step / 2)
    return minus2, slope, better


def best_scale(r: Floats, floor: float, begin: Floats | None = None) -> tuple[Floats, Floats]:
    """-2 log L of Student's t for residuals about 0, over the last axis, and the best squared scale."""
    scale2 = np.maximum(1.5 * np.median(r**2, axis=-1) if begin is None else begin, floor)
    for _ in range(_ROUNDS):
        last = scale2
        minus2, _, scale2 = _at_scale(r, last, floor)
        if not np.any(np.abs(scale2 - last) > _ENOUGH * last):
            break
    return minus2, scale2


@dataclass(frozen=True, eq=False)
class StudentSlices(AlphaSlices):
    """-2 log L of Student's t over alpha at each of several c_e, with the best scale at each alpha.

    References
    ----------
    Lange, Little and Taylor, Robust statistical modeling using the t distribution, J. Am. Stat. Assoc. 84
    (1989), section 3.
    Kent, Tyler and Vardi, A curious likelihood identity for the multivariate t-distribution, Commun. Stat.
    Simul. Comput. 23 (1994).
    """

    r: Floats  # log v less log of the model's velocity at alpha = 1, shape (m, n)
    height: Floats  # -2 log L at m

    @classmethod
    def of(cls, c_e: Floats, r: Floats, floor: float) -> "StudentSlices":
        """By Newton's method in m and log scale, begun at the median; by reweighting where a step is long."""
        m, n = np.median(r, axis=-1), r.shape[-1]
        d = r - m[:, None]
        scale2 = np.maximum(2 * np.median(d**2, axis=-1), floor)
        for _ in range(_ROUNDS):
            weighted = d / (FREEDOM * scale2[:, None] + d**2)
            part = weighted * d  # as in `_at_scale`
            first, total = np.sum(weighted, axis=-1), np.sum(part, axis=-1)
            mixed = first - np.sum(np.multiply(weighted, part, out=weighted), axis=-1)
            squares = np.sum(np.square(part, out=part), axis=-1)
            weight = (n - total) / (FREEDOM * scale2)
            # second derivatives by m and log scale2, over 2 (nu + 1)
            of_m, of_scale = (n - 3 * total + 2 * squares) / (FREEDOM * scale2), (total - squares) / 2
            lack = total / 2 - n / (2 * (FREEDOM + 1))
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                determinant = of_m * of_scale - mixed**2
                shift = (of_scale * first - mixed * lack) / determinant
                scaled = scale2 * np.exp((of_m * lack - mixed * first) / determinant)
                short = (of_m > 0) & (determinant > 0) & (shift**2 < scale2 / 4) & (scaled > floor)
                short &= np.abs(scaled - scale2) < scale2 / 2
            shift, last = np.where(short, shift, first / weight), scale2
            scale2 = np.where(short, scaled, np.maximum(total / weight - shift**2, floor))
            m += shift
            d -= shift[:, None]
            if not np.any(np.abs(shift) + np.abs(scale2 - last) / np.sqrt(last) > 1e-12 * np.sqrt(last)):
                break
        B, other = np.full(len(c_e), float(n)), np.zeros(len(c_e))
        return cls(c_e, scale2 * B, B, m, other, n, False, floor, True, r, _at_scale(d, scale2, floor)[0])

    @property
    def profile(self) -> Floats:
        """See `AlphaSlices`."""
        return self.height

    def minus2(self, alpha: ArrayLike) -> Floats:
        """See `AlphaSlices`."""
        return self._over(np.arange(len(self.m)), np.broadcast_to(np.log(alpha), self.m.shape))

    def minus2_table(self, alpha: Floats) -> Floats:
        """See `AlphaSlices`; each row is followed downhill from the lowest of an approximation."""
        off = np.log(alpha)[:, None] - self.m
        near = (self.height + self.n * np.log1p(FLATTER * off**2 * self.B / self.A)).argmin(axis=1)
        table, moved = np.full(off.shape, np.inf), np.arange(len(alpha))
        while len(moved):
            points = np.clip(near[moved, None] + np.arange(-2, 3), 0, len(self.m) - 1)
            rows = np.repeat(moved, points.shape[1])
            table[rows, points.ravel()] = self._over(points.ravel(), np.log(alpha)[rows])
            last, near = near, table.argmin(axis=1)
            moved = np.flatnonzero(near != last)
        return table

    def alpha_below(self, target: float) -> tuple[Floats, Floats]:
        """See `AlphaSlices`; by Newton's method for the end and its scale, halving where it leaves the bracket."""
        ends, inside = np.full((2, len(self.m)), np.nan), np.flatnonzero(self.height <= target)
        r, m, spread = self.r.T[:, inside].T, self.m[inside], self.A[inside] / self.B[inside]
        begin = np.sqrt(spread * np.expm1((target - self.height[inside]) / self.n) / FLATTER)
        for side, end in zip((-1, 1), ends, strict=True):
            near, far, half, scale2 = np.zeros(len(m)), np.full(len(m), np.inf), begin, spread + begin**2
            for _ in range(_ROUNDS):
                rough = scale2
                value, slope, scale2 = _at_scale(r - (m + side * half)[:, None], rough, self.floor)
                sure = np.abs(scale2 - rough) <= 1e-3 * rough
                near = np.where(sure & (value <= target), half, near)
                far = np.where(sure & (value > target), half, far)
                with np.errstate(divide="ignore", invalid="ignore"):
                    step = half + (target - value) / (side * slope)
                    middle = np.where(np.isinf(far), 2 * near, (near + far) / 2)
                last = half
                half = np.minimum(np.where((step >= near) & (step <= far), step, middle), _LARGEST)
                if not np.any(np.abs(half - last) > _ENOUGH * last):
                    break
            end[inside] = np.exp(np.clip(m + side * half, -_LARGEST, _LARGEST))
        return ends[0], ends[1]

    def _over(self, points: Rows, g: Floats) -> Floats:
        """-2 log L at log alpha = g at some points, with the best scale."""
        return best_scale(
            self.r.T[:, points].T - g[:, None],
            self.floor,
            (self.A / self.B)[points] + (g - self.m[points]) ** 2,
        )[0]


@dataclass(frozen=True, eq=False)
class MixtureSlices(CurvedSlices):
    """-2 log of a sum of likelihoods over alpha at each c_e; A, B and m have shape (len(c_e), parts)."""

    @classmethod
    def of(cls, c_e: Floats, A: Floats, B: Floats, m: Floats, n: int) -> "MixtureSlices":
        """The lowest by Newton's method, or by the parts' mean where a step goes up."""
        g = np.take_along_axis(m, A.argmin(axis=1)[:, None], axis=1)[:, 0]
        slices = cls(c_e, A, B, m, np.zeros(len(c_e)), n, True, 0.0, True, g, g)
        for _ in range(_ROUNDS):
            slope, bend, stiff = slices._slope(g)
            step = slope / np.maximum(np.where(bend > 0.2 * stiff, bend, stiff), 1e-300)
            g = g - step
            if np.abs(step).max(initial=0.0) < _CLOSE:
                break
        return replace(slices, g=g, height=slices._over(g)[0])

    def _over(self, g: Floats, points: Rows | slice = slice(None)) -> tuple[Floats, Floats]:
        """See `CurvedSlices`."""
        off = g[..., None] - self.m[points]
        stiff = self.B[points] * off
        q = self.A[points] + stiff * off
        low = q.min(axis=-1)
        with np.errstate(invalid="ignore"):
            share = np.exp(-0.5 * (q - low[..., None]))
            total = share.sum(axis=-1)
            slope = 2 * np.einsum("...k,...k->...", share, stiff) / total
        return np.where(np.isfinite(low), low - 2 * np.log(total), np.inf), slope

    def _beyond(self, target: float, points: Rows) -> Floats:
        """See `CurvedSlices`: where no part is below."""
        return np.asarray(
            np.sqrt(np.maximum(target + 2 * np.log(self.A.shape[1]) - self.A[points], 0.0) / self.B[points])
        )

    def _slope(self, g: Floats) -> tuple[Floats, Floats, Floats]:
        """Half the slope of -2 log L by log alpha, half its curvature, and that without the parts' differences."""
        A, B, off = self.A, self.B, g[:, None] - self.m
        q = A + B * off**2
        share = np.exp(
            -0.5 * (np.where(np.isfinite(q), q, 1e300) - np.minimum(q.min(axis=1), 1e299)[:, None])
        )
        share /= np.maximum(share.sum(axis=1), 1e-300)[:, None]
        slope, stiff = np.sum(share * B * off, axis=1), np.sum(share * B, axis=1)
        return slope, stiff - np.sum(share * (B * off - slope[:, None]) ** 2, axis=1), stiff
