"""The likelihood of c_e and alpha by scipy's densities, profiles by search, intervals by root finding."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats
from scipy.optimize import brentq, minimize_scalar

from burrlab import Burr, DepthTrace, Indentation, Material, VelocityCurve, penetration_velocity

MODEL_ERROR = 2e-3  # of the master curve, added in quadrature to every residual of unknown scatter [1]
SEGMENTS = 5  # of a trace
FAR = 1e6  # an end beyond this many times the c_e where the ridge begins is open


class Oracle:
    """-2 log L of data sets, row by row.

    Parameters
    ----------
    data : sequence of VelocityCurve, Indentation, DepthTrace
        Each with its radius.
    kind : str
        "relative", "absolute" or "sigma".
    shape : str
        Erosion shape.
    bounds : (float, float), optional
        Bounds of c_e [N/mm^2] given by the user; an interval is open there.
    """

    def __init__(
        self,
        data: Sequence[VelocityCurve | Indentation | DepthTrace],
        kind: str = "relative",
        shape: str = "parabolic",
        bounds: tuple[float, float] | None = None,
    ) -> None:
        self.kind, self.shape = kind, shape
        self.velocities: list[tuple[float, float, float | None, float | None, float, float]] = []
        self.runs: list[list[int]] = []  # places of a run's segments in `velocities`
        self.record: list[float] = []  # RMS error of log velocity by a run's record, with the model's
        self.presses: list[tuple[float, float, float, float]] = []
        self.low, self.high, self.entry = 0.0, math.inf, 0.0
        for one in data:
            self._take(one)
        self.low_open, self.high_open = False, math.isinf(self.high)
        if bounds is not None:
            self.low_open, self.high_open = bounds[0] > self.low, bounds[1] < self.high
            self.low, self.high = max(self.low, bounds[0]), min(self.high, bounds[1])
        elif self.high_open:
            self.high = FAR * self.entry

    def _take(self, one: VelocityCurve | Indentation | DepthTrace) -> None:
        R = float(one.radius)
        if isinstance(one, Indentation):
            sigma = np.full(len(one), np.nan) if one.sigma is None else one.sigma
            self.presses += [
                (float(F), float(h), R, float(s)) for F, h, s in zip(one.force, one.depth, sigma, strict=True)
            ]
            return
        rows: list[tuple[float, float, float | None, float | None, float]] = []
        if isinstance(one, DepthTrace):
            parts = one.segments(SEGMENTS)
            begin = len(self.velocities)
            self.runs.append(list(range(begin, begin + SEGMENTS)))
            self.record.append(math.sqrt(sum(s**2 for s in parts.log_sigma) / SEGMENTS + MODEL_ERROR**2))
            rows = [
                (one.force, float(v), float(a), float(b), math.nan)
                for v, a, b in zip(parts.velocity, parts.start_mm, parts.end_mm, strict=True)
            ]
        else:
            for i in range(len(one)):
                window = (None, None)
                if one.window_start is not None and not math.isnan(one.window_start[i]):
                    window = (float(one.window_start[i]), float(one.window_end[i]))
                if one.status is not None and one.status[i] == "overloaded":  # no window: c_e is small
                    self.high = min(self.high, _static(float(one.force[i]), window[1], R))
                elif one.ok[i]:
                    sigma = math.nan if one.sigma is None else float(one.sigma[i])
                    rows.append((float(one.force[i]), float(one.velocity[i]), *window, sigma))
        for F, v, start, end, sigma in rows:
            self.velocities.append((F, v, start, end, R, sigma))
            self.low = max(self.low, _static(F, end, R))
            self.entry = max(self.entry, _static(F, R / 6 if start is None else start, R))

    def unit(self, c_e: float) -> np.ndarray:
        """Velocity [mm/s] of every row at alpha = 1 /ms."""
        material = Material("m", c_e=c_e, alpha=1.0, shape=self.shape)
        return np.array(
            [
                float(penetration_velocity(Burr(R), material, F, start, end))
                for F, _, start, end, R, _ in self.velocities
            ]
        )

    def relative(self) -> list[float]:
        """Scatter of each run's segments over the geometric mean of all runs."""
        mean = math.exp(sum(math.log(one) for one in self.record) / len(self.record))
        return [one / mean for one in self.record]

    def residuals(self, c_e: float, alpha: float, unit: np.ndarray | None = None) -> list[tuple]:
        """Residuals, number of free ones, whether sigma is known, and model error, for each scatter."""
        model = alpha * (self.unit(c_e) if unit is None else unit)
        v = np.array([row[1] for row in self.velocities])
        groups: list[tuple] = []
        if self.kind == "relative":
            r = np.log(v) - np.log(model)
            within_run = {row for run in self.runs for row in run}
            ends = [r[i] for i in range(len(r)) if i not in within_run]
            ends += [float(np.mean(r[run])) for run in self.runs]
            groups.append((np.array(ends), len(ends), False, MODEL_ERROR))
            if self.runs:
                parts = zip(self.runs, self.relative(), strict=True)
                inner = np.concatenate([(r[run] - np.mean(r[run])) / part for run, part in parts])
                groups.append((inner, len(inner) - len(self.runs), False, MODEL_ERROR))
        elif self.kind == "absolute":
            groups.append((v - model, len(v), False, MODEL_ERROR * math.sqrt(np.mean(v**2))))
        else:
            sigma = np.array([row[5] for row in self.velocities])
            groups.append(((v - model) / sigma, len(v), True, 0.0))
        if self.presses:
            F, h, R, sigma = np.array(self.presses).T
            model = c_e * R**2 * (h / R) ** 1.5
            known = self.kind == "sigma" and bool(np.isfinite(sigma).all())
            r = (F - model) / sigma if known else np.log(F / model)
            groups.append((r, len(F), known, MODEL_ERROR))
        return groups

    def minus2(self, c_e: float, alpha: float, unit: np.ndarray | None = None) -> float:
        """-2 log L at the best scatters, without a constant."""
        total = 0.0
        for r, n, known, error in self.residuals(c_e, alpha, unit):
            S = float(np.sum(r**2))
            total += S if known else n * math.log(S / n + error**2)
        return total

    def log_likelihood(self, c_e: float, alpha: float) -> float:
        """Log density of velocities [mm/s] and forces [N] at the best scatters, with all constants."""
        v, model = np.array([row[1] for row in self.velocities]), alpha * self.unit(c_e)
        groups = self.residuals(c_e, alpha)
        scatter = [1.0 if known else math.sqrt(np.sum(r**2) / n) for r, n, known, _ in groups]
        total = 0.0
        if self.kind == "relative":
            rows = [i for i in range(len(v)) if not any(i in run for run in self.runs)]
            total += float(stats.lognorm.logpdf(v[rows], scatter[0], scale=model[rows]).sum())
            # K segments: their mean scatters by scatter[0], the rest by scatter[1] times the run's part
            for run, part in zip(self.runs, self.relative() if self.runs else [], strict=True):
                K = len(run)
                mean = np.full((K, K), 1 / K)
                covariance = (scatter[1] * part) ** 2 * (np.eye(K) - mean) + K * scatter[0] ** 2 * mean
                r = np.log(v[run] / model[run])
                total += float(stats.multivariate_normal.logpdf(r, np.zeros(K), covariance))
                total -= float(np.log(v[run]).sum())
        elif self.kind == "absolute":
            total += float(stats.norm.logpdf(v, model, scatter[0]).sum())
        else:
            total += float(stats.norm.logpdf(v, model, [row[5] for row in self.velocities]).sum())
        if self.presses:
            F, h, R, sigma = np.array(self.presses).T
            model = c_e * R**2 * (h / R) ** 1.5
            if groups[-1][2]:
                total += float(stats.norm.logpdf(F, model, sigma).sum())
            else:
                total += float(stats.lognorm.logpdf(F, scatter[-1], scale=model).sum())
        return total

    def best_alpha(self, c_e: float) -> tuple[float, float]:
        """alpha [1/ms] of the lowest -2 log L at one c_e, and that -2 log L."""
        unit = self.unit(c_e)
        first = np.exp(np.mean(np.log([row[1] for row in self.velocities]) - np.log(unit)))
        found = minimize_scalar(
            lambda x: self.minus2(c_e, math.exp(x), unit),
            bounds=(math.log(first) - 2, math.log(first) + 2),
            method="bounded",
            options={"xatol": 1e-10},
        )
        return math.exp(found.x), float(found.fun)

    def profile(self, log_c_e: float) -> float:
        return self.best_alpha(math.exp(log_c_e))[1]

    def minimum(self, points: int = 60) -> tuple[float, float, float]:
        """c_e, alpha and -2 log L of the lowest point: of a dense grid, then between its neighbours."""
        low = math.log(self.low * (1 + 1e-4))
        grid = np.linspace(low, math.log(min(self.high, 30 * self.entry)), points)
        heights = [self.profile(x) for x in grid]
        i = int(np.argmin(heights))
        found = minimize_scalar(
            self.profile,
            bounds=(grid[max(i - 1, 0)], grid[min(i + 1, points - 1)]),
            method="bounded",
            options={"xatol": 1e-9},
        )
        x = found.x if found.fun < heights[i] else grid[i]
        alpha, height = self.best_alpha(math.exp(x))
        return math.exp(x), alpha, height

    def interval_of_c_e(self, limit: float, best: float, base: float) -> tuple[float | None, float | None]:
        """Crossings of the profile with base + limit on both sides of the best c_e; None is open."""
        return (
            self._end(best, self.low * (1 + 1e-4), limit, base, self.low_open),
            self._end(best, self.high, limit, base, self.high_open),
        )

    def _end(self, best: float, bound: float, limit: float, base: float, is_open: bool) -> float | None:
        def above(x: float) -> float:
            return self.profile(x) - base - limit

        grid = np.linspace(math.log(best), math.log(bound), 80)
        inside = [above(x) <= 0 for x in grid]
        if inside[-1]:
            return None if is_open else bound
        last = int(np.flatnonzero(inside)[-1])  # the outermost crossing
        return math.exp(brentq(above, grid[last], grid[last + 1], xtol=1e-10))

    def interval_of_alpha(self, limit: float, best: tuple[float, float], base: float) -> tuple[float, float]:
        """Crossings of the profile over alpha with base + limit; c_e must have two ends."""
        a, b = self.interval_of_c_e(1.5 * limit, best[0], base)
        grid = np.linspace(math.log(a or self.low), math.log(b or self.high), 200)
        units = [self.unit(math.exp(x)) for x in grid]

        def profile(log_alpha: float) -> float:
            alpha = math.exp(log_alpha)
            heights = [self.minus2(math.exp(x), alpha, u) for x, u in zip(grid, units, strict=True)]
            i = int(np.argmin(heights))
            found = minimize_scalar(
                lambda x: self.minus2(math.exp(x), alpha),
                bounds=(grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]),
                method="bounded",
                options={"xatol": 1e-8},
            )
            return min(heights[i], float(found.fun))

        return tuple(_crossing(profile, math.log(best[1]), side, base + limit) for side in (-1, 1))

    def information(self, c_e: float, alpha: float, step: float = 1e-3) -> np.ndarray:
        """Information of each scatter in (log c_e, log alpha), shape (groups, 2, 2).

        Second differences of half the sum of squares of the residuals' changes, over the squared scatter.
        """
        here = self.residuals(c_e, alpha)

        def half(a: float, b: float) -> np.ndarray:
            moved = self.residuals(c_e * math.exp(a), alpha * math.exp(b))
            return np.array([np.sum((m[0] - h[0]) ** 2) / 2 for m, h in zip(moved, here, strict=True)])

        h = step
        one = (half(h, 0) + half(-h, 0)) / h**2
        two = (half(0, h) + half(0, -h)) / h**2
        cross = (half(h, h) - half(h, -h) - half(-h, h) + half(-h, -h)) / (4 * h**2)
        square = np.array([1.0 if known else np.sum(r**2) / n + e**2 for r, n, known, e in here])
        return np.array([[one, cross], [cross, two]]).transpose(2, 0, 1) / square[:, None, None]

    def limit(self, level: float, best: tuple[float, float], direction: Sequence[float] | None) -> float:
        """Rise of -2 log L: n log(1 + q F/(n - 2)) or chi-square for one scatter.

        With several scatters: Satterthwaite's rule along `direction`, a gradient over (log c_e, log alpha).
        For both parameters (None): chi-square's limit times the mean rise over 2, S_min/S is
        Beta((n - p)/2, p/2).
        """
        q = 2 if direction is None else 1
        groups, shares = self.residuals(*best), self.information(*best)
        if len(groups) == 1:
            _, n, known, _ = groups[0]
            if known:
                return float(stats.chi2.ppf(level, q))
            return n * math.log(1 + q * float(stats.f.ppf(level, q, n - 2)) / (n - 2))
        inverse = np.linalg.inv(shares.sum(axis=0))
        taken = np.array([np.trace(inverse @ share) for share in shares])
        if direction is None:
            mean = 0.0
            for (_, n, known, _), p in zip(groups, taken, strict=True):
                ratio = stats.beta((n - p) / 2, p / 2)
                mean += p if known else -n * float(ratio.expect(np.log))
            return float(mean / 2 * stats.chi2.ppf(level, 2))
        d = inverse @ np.array(direction)
        weight = np.array([d @ share @ d for share in shares]) / float(np.array(direction) @ d)
        unknown = [k for k, group in enumerate(groups) if not group[2]]
        free = {k: max(groups[k][1] - taken[k], 0.5) for k in unknown}
        wider = sum(weight[k] * (groups[k][1] / free[k] if k in free else 1) for k in range(len(groups)))
        spread = sum(weight[k] ** 2 / free[k] for k in unknown)
        if spread < 1e-9:
            return float(wider * stats.chi2.ppf(level, q))
        nu = 1 / spread
        return float(wider * nu * math.log(1 + q * stats.f.ppf(level, q, nu) / nu))


def _static(force: float, depth: float | None, R: float) -> float:
    """c_e [N/mm^2] at which a burr at rest sinks to a depth [mm], R/3 by default."""
    relative = 1 / 3 if depth is None else depth / R
    return force / (R**2 * relative**1.5)


def _crossing(profile: Callable[[float], float], best: float, side: int, target: float) -> float:
    step = 1e-3
    while profile(best + side * step) < target:
        step *= 1.7
    return math.exp(
        brentq(lambda x: profile(x) - target, best + side * step / 1.7, best + side * step, xtol=1e-7)
    )
