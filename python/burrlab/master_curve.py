"""The master curve that all descents at constant force lie on: the surrogate of the fit.

Everything depends on phi = F/(c_e R^2) and on the erosion shape f: v = alpha R Psi(phi, window; f).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PPoly

from burrlab import _core
from burrlab._core import Burr, Material, Shape
from burrlab.mean_field import PER_SECOND, Floats, check_window, positive

_Knot: TypeAlias = tuple[float, Floats, Floats]  # phi, time [1/alpha], immersion [R]
_LOWEST = 0.02  # phi/stop^1.5 of the lowest knot that is a descent; below, the thin-layer law
_KNOTS = 24  # descents shared by all windows, evenly in log phi
_GAP = 1e-4  # of the spline's range: from its last knot to the phi at which the window ends


class MasterCurve:
    """Psi(phi) = v/(alpha R): penetration velocity against phi = F/(c_e R^2) for one erosion shape.

    For a window, log Psi over log phi is a cubic spline on either side of the kink at phi = start^1.5, above
    which the window begins at static contact; a knot lies on it. At phi = stop^1.5 the window has shrunk to
    nothing. Below 0.02 stop^1.5 the thin-layer law goes on, times a correction that fits the lowest knot.
    `start` and `stop` are in units of R: by default max(1/6, phi^(2/3)) .. 1/3.

    Parameters
    ----------
    shape : Shape or str
        Erosion shape function f, or its name.

    Notes
    -----
    Within 0.2 % of single descents at any phi. Most knots are descents whose H(t) serve every window; they
    are made once a shape and process, the splines once a window (tens of milliseconds; tenths of a second
    where k is not whole).

    Examples
    --------
    >>> from burrlab.master_curve import MasterCurve
    >>> curve = MasterCurve("parabolic")
    >>> ["%.3e" % ratio for ratio in curve.velocity_ratio([0.025, 0.05, 0.1, 0.2])]
    ['2.744e-04', '1.740e-03', '9.975e-03', 'nan']
    >>> curve.local_slope([1e-4, 0.06, 0.07]).round(2)
    array([2.67, 2.72, 2.44])
    """

    def __init__(self, shape: Shape | str) -> None:
        self.shape = Shape(shape) if isinstance(shape, str) else shape
        self._name = self.shape.name

    def velocity_ratio(
        self, phi: ArrayLike, start: float | None = None, stop: float | None = None
    ) -> np.float64 | Floats:
        """Psi = v/(alpha R) at phi = F/(c_e R^2).

        Parameters
        ----------
        phi : array_like
            Above 0.
        start, stop : float, optional
            Window [R], 0 <= start < stop <= 1.

        Returns
        -------
        ndarray of the shape of phi
            NaN where phi >= stop^1.5: static contact alone reaches the window's end.

        Raises
        ------
        ValueError
            If a phi is not positive or the window is not in order.
        """
        spline = _window_spline(self._name, start, stop)
        phi = positive("phi", phi)
        ratio = np.exp(spline.log_ratio(np.log(np.minimum(phi, spline.end))))
        return np.where(phi < spline.end, ratio, np.nan)[()]

    def local_slope(
        self, phi: ArrayLike, start: float | None = None, stop: float | None = None
    ) -> np.float64 | Floats:
        """d log Psi/d log phi, the local exponent of v ~ F^n; to the right of the kink where phi is on it.

        Parameters, values without a window and errors are those of `velocity_ratio`.
        """
        spline = _window_spline(self._name, start, stop)
        phi = positive("phi", phi)
        return np.where(phi < spline.end, spline.slope(np.log(np.minimum(phi, spline.end))), np.nan)[()]

    def __repr__(self) -> str:
        return f"MasterCurve({self._name!r})"


def penetration_velocity(
    burr: Burr,
    material: Material,
    force: ArrayLike,
    start_mm: float | None = None,
    stop_mm: float | None = None,
) -> np.float64 | Floats:
    """Penetration velocity v = alpha R Psi(F/(c_e R^2)), from the master curve of the material's shape.

    Parameters
    ----------
    burr : Burr
    material : Material
    force : array_like
        F [N], above 0.
    start_mm, stop_mm : float, optional
        Window [mm]; max(R/6, static immersion) .. R/3 by default. It never starts before static contact.

    Returns
    -------
    ndarray of the shape of force
        [mm/s]; NaN where static contact is beyond the window.

    Raises
    ------
    ValueError
        If a force is not positive and finite, or the window is not in order and within R.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.master_curve import penetration_velocity
    >>> bone = burrlab.Material("bone", c_e=2.145, alpha=0.087)
    >>> penetration_velocity(burrlab.Burr(3.0), bone, [0.3, 0.5, 1.0, 2.0]).round(4)
    array([0.0203, 0.0787, 0.4994, 2.8161])
    """
    R = burr.radius
    phi = positive("force", force) / (material.c_e * R**2)
    window = [None if end is None else end / R for end in (start_mm, stop_mm)]
    return PER_SECOND * material.alpha * R * MasterCurve(material.shape).velocity_ratio(phi, *window)


@dataclass(frozen=True)
class _WindowSpline:
    """log Psi over log phi for one window, linear below the first break; `end` is its phi = stop^1.5."""

    end: float
    log_ratio: PPoly
    slope: PPoly


@lru_cache(maxsize=64)
def _knots(shape: str, reach: float) -> list[_Knot]:
    """The descents to an immersion `reach`, by rising phi."""
    grid = reach**1.5 * np.geomspace(_LOWEST, 1, _KNOTS, endpoint=False)
    return [_knot(shape, phi, reach) for phi in grid.tolist()]


def _knot(shape: str, phi: float, stop: float) -> _Knot:
    return (phi, *_core.mean_field_descent(Shape(shape), phi, stop))


@lru_cache(maxsize=4096)
def _window_spline(shape: str, start: float | None, stop: float | None) -> _WindowSpline:
    start, stop = check_window(start, stop)
    kink, end = start**1.5, stop**1.5
    low = _LOWEST * end
    if kink <= 1.01 * low:
        poly = _branch(shape, low, end, start, stop)
    else:
        left, right = _branch(shape, low, kink, start, stop), _branch(shape, kink, end, start, stop)
        poly = PPoly(np.hstack([left.c, right.c]), np.concatenate([left.x, right.x[1:]]))
    # a straight line to the left of all: PPoly extrapolates its first piece
    value, slope = float(poly(poly.x[0])), float(poly(poly.x[0], 1))
    first = np.array([[0.0], [0.0], [slope], [value - slope]])
    poly = PPoly(np.hstack([first, poly.c]), np.concatenate([[poly.x[0] - 1], poly.x]))
    return _WindowSpline(end, poly, poly.derivative())


def _branch(shape: str, low: float, high: float, start: float, stop: float) -> PPoly:
    """The spline from phi = low to high; left of the kink the thin-layer law continues it to smaller phi.

    Shared descents serve where they can; close to `high`, where the window begins in the first transient and
    log Psi bends on a scale 1/k, and at both ends, it has its own.
    """
    reach = min(1.0, 1.5 ** np.ceil(np.log(3 * stop) / np.log(1.5) - 1e-9) / 3)
    top = high - _GAP * (high - low) if high == stop**1.5 else high
    bend = high * (1 - 0.25 * np.geomspace(1, 1 / 64, 7 + round(Shape(shape).order)))
    knots = [_knot(shape, phi, stop) for phi in [low, *bend[bend > low].tolist(), top]]
    knots += [knot for knot in _knots(shape, reach) if low * 1.03 < knot[0] < high * 0.73]
    knots.sort(key=lambda knot: knot[0])
    x = np.log([phi for phi, _, _ in knots])
    y = np.log([_core.window_velocity(t, H, max(start, H[0]), min(stop, H[-1])) for _, t, H in knots])
    if high <= start**1.5:
        smaller = low * np.geomspace(1e-3, 1, 24, endpoint=False)
        y = np.append(y[0] + _log_thin_ratio(shape, smaller, low, y[0], start, stop), y)
        x = np.append(np.log(smaller), x)
    return CubicSpline(x, y)


def _log_thin_ratio(shape: str, phi: Floats, low: float, y: float, start: float, stop: float) -> Floats:
    """log Psi(phi) - log Psi(low) for phi < low, where Psi(low) = exp(y).

    The thin-layer law, whose slope in a fixed window goes with a power of Eq. 2's mass, times a correction
    linear in the thickness of the layer, ~ phi^(4/3), that fits Psi(low).
    """
    f = Shape(shape)
    H = np.linspace(start, stop, 1000)
    slowness = 1 / np.asarray(_core.thin_layer_velocity(f, low, H))
    time = np.append(0, np.cumsum((slowness[1:] + slowness[:-1]) / 2 * np.diff(H)))
    excess = np.exp(y) / _core.window_velocity(time, H, start, stop) - 1
    u, u_low = phi ** (2 / 3), low ** (2 / 3)
    mass = u**2 * (1 - u / 3) / (u_low**2 * (1 - u_low / 3))
    log_ratio: Floats = (f.order + 1) * np.log(mass) + np.log((1 + excess * (u / u_low) ** 2) / (1 + excess))
    return log_ratio
