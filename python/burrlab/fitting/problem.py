"""What a fit compares: the rows of a curve that hold a number, and a model's prediction for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Shape
from burrlab.curve import VelocityCurve
from burrlab.fitting.search import Box
from burrlab.master_curve import MasterCurve

Floats: TypeAlias = NDArray[np.float64]
ResidualKind: TypeAlias = Literal["relative", "absolute", "sigma"]
Predict: TypeAlias = Callable[[float, float], Floats]
Bounds: TypeAlias = dict[str, tuple[float, float]]

WINDOW_START, WINDOW_END = 1 / 6, 1 / 3  # of the default window, in radii (model, section 4)
C_E_RANGE = 100.0  # upper bound of c_e over its lower one, see `bounds_of`
ALPHA_BOUNDS = (1e-5, 10.0)  # [1/ms], see `bounds_of`
_MARGIN = 1e-4  # the hard bound of c_e is open: at it the window has no length


@dataclass(frozen=True)
class Observations:
    """The rows that a fit uses, in the curve's order; NaN as window is the default one."""

    force: Floats  # [N]
    velocity: Floats  # [mm/s]
    sigma: Floats | None  # [mm/s]
    window_start: Floats  # [mm]
    window_end: Floats  # [mm]
    radius: float  # [mm]
    n_skipped: int

    @classmethod
    def of(cls, curve: VelocityCurve, burr: Burr) -> Observations:
        """The usable rows of a curve.

        Raises
        ------
        ValueError
            If the curve is of another burr, or its usable rows hold fewer than three distinct forces.
        """
        if curve.radius is not None and curve.radius != burr.radius:
            raise ValueError(
                f"the curve was taken with a burr of radius {curve.radius:g} mm, "
                f"the fit is for {burr.radius:g} mm"
            )
        ok = curve.ok
        distinct = len(np.unique(curve.force[ok]))
        if distinct < 3:
            raise ValueError(
                f"a fit needs velocities at three or more distinct forces: got {distinct} in {int(ok.sum())} "
                f"usable of {len(curve)} rows"
            )
        default = np.full(len(curve), np.nan)
        start = default if curve.window_start is None else curve.window_start
        end = default if curve.window_end is None else curve.window_end
        sigma = None if curve.sigma is None else curve.sigma[ok]
        skipped = int(len(curve) - ok.sum())
        return cls(curve.force[ok], curve.velocity[ok], sigma, start[ok], end[ok], burr.radius, skipped)

    def __len__(self) -> int:
        return len(self.force)

    @property
    def has_sigma(self) -> bool:
        return self.sigma is not None and bool(np.isfinite(self.sigma).all())

    def by_window(self) -> dict[tuple[float | None, float | None], NDArray[np.intp]]:
        """Row numbers by window in radii; (None, None) is the default window."""
        windows: dict[tuple[float | None, float | None], list[int]] = {}
        for row, (start, end) in enumerate(zip(self.window_start, self.window_end, strict=True)):
            default = bool(np.isnan(start))
            key = (None, None) if default else (float(start / self.radius), float(end / self.radius))
            windows.setdefault(key, []).append(row)
        return {key: np.array(rows, dtype=np.intp) for key, rows in windows.items()}

    def phi(self, c_e: float) -> Floats:
        """F/(c_e R^2) of every row."""
        return self.force / (c_e * self.radius**2)

    def c_e_bounds(self) -> Floats:
        """Lower bound of c_e [N/mm^2] that each row's window implies.

        Static contact alone sinks the burr to H = R phi^(2/3); a window that ends at H_end exists only below
        that: c_e > F/(R^2 (H_end/R)^(3/2)), 0.1925 R^2 for the default end R/3 (model, section 5 iv).
        """
        end = np.where(np.isnan(self.window_end), WINDOW_END * self.radius, self.window_end)
        return self.force / (self.radius**2 * (end / self.radius) ** 1.5)

    def ridge_entries(self) -> Floats:
        """c_e [N/mm^2] above which each row's window starts above its static contact: phi < 0.068 by default.

        There v is a power law of phi and only alpha/c_e^p is determined (model, section 5 iii).
        """
        start = np.where(np.isnan(self.window_start), WINDOW_START * self.radius, self.window_start)
        with np.errstate(divide="ignore"):
            return self.force / (self.radius**2 * (start / self.radius) ** 1.5)

    def residuals(self, kind: ResidualKind, predicted: Floats) -> Floats:
        """Residuals of every row; NaN where there is no prediction. See `burrlab.fit.fit`."""
        if kind == "relative":
            with np.errstate(invalid="ignore", divide="ignore"):
                return np.asarray(np.log(self.velocity / predicted))
        if kind == "absolute":
            return self.velocity - predicted
        assert self.sigma is not None
        return (self.velocity - predicted) / self.sigma

    def best_alpha(self, kind: ResidualKind, unit: Floats) -> float:
        """The alpha that fits best where predictions are alpha times `unit`: a linear problem."""
        if kind == "relative":
            return float(np.exp(np.mean(np.log(self.velocity / unit))))
        weight = np.ones(len(self)) if kind == "absolute" or self.sigma is None else self.sigma**-2
        return float(np.sum(weight * self.velocity * unit) / np.sum(weight * unit**2))


def bounds_of(observations: Observations, given: Bounds | None) -> Box:
    """The box of the search.

    c_e begins at the hard bound of `Observations.c_e_bounds` and ends at 100 times it: there the largest phi
    is 0.0019 and even alpha = 10 /ms cuts slower than 10 um/s at R = 3 mm, so data that reach
    further are on the ridge, and it goes on unchanged. alpha runs from 1e-5 /ms (a time constant of 100 s:
    nothing erodes in an experiment) to 10 /ms (solid bone is gone in a tenth of a tick, no layer is left).

    Raises
    ------
    ValueError
        If a bound names no parameter, or leaves no room.
    """
    hard = float(observations.c_e_bounds().max()) * (1 + _MARGIN)
    box = {"c_e": (hard, C_E_RANGE * hard), "alpha": ALPHA_BOUNDS}
    for name, pair in (given or {}).items():
        if name not in box:
            raise ValueError(f"bounds are for 'c_e' and 'alpha': got {name!r}")
        low, high = (float(end) for end in pair)
        if not 0 < low < high < np.inf:
            raise ValueError(f"bounds of {name} must be two finite numbers 0 < low < high: got {pair!r}")
        if name == "c_e" and high <= hard:
            raise ValueError(
                f"bounds of c_e end at {high:g} N/mm^2, but the window at {observations.force.max():g} N "
                f"needs c_e > {hard:g} N/mm^2"
            )
        box[name] = (max(low, hard), high) if name == "c_e" else (low, high)
    return Box((box["c_e"][0], box["alpha"][0]), (box["c_e"][1], box["alpha"][1]))


class MeanFieldModel:
    """Predictions by the scaling law v = alpha R Psi(phi, window; f) (model, section 5).

    Rows are grouped by window, and each distinct force is looked up once.
    """

    def __init__(self, observations: Observations, shape: Shape) -> None:
        self._radius, self._n = observations.radius, len(observations)
        self._curve = MasterCurve(shape)
        self._groups: list[tuple[float | None, float | None, Floats, NDArray[np.intp], NDArray[np.intp]]] = []
        for (start, end), rows in observations.by_window().items():
            force, inverse = np.unique(observations.force[rows], return_inverse=True)
            self._groups.append((start, end, force / self._radius**2, rows, inverse))

    def unit(self, c_e: float) -> Floats:
        """Velocity [mm/s] at alpha = 1 /ms, every row; NaN where c_e leaves no window."""
        ratio = np.empty(self._n)
        for start, end, pressure, rows, inverse in self._groups:
            ratio[rows] = np.asarray(self._curve.velocity_ratio(pressure / c_e, start, end))[inverse]
        return 1e3 * self._radius * ratio  # 1/ms is 1000/s

    def predict(self, c_e: float, alpha: float) -> Floats:
        """Velocity [mm/s] of every row at c_e [N/mm^2], alpha [1/ms]."""
        return alpha * self.unit(c_e)
