"""Closed forms of the descent at constant force, and its penetration velocity (docs/descent.md)."""

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from burrlab._core import Burr, Material, shape_kappa


def static_immersion(burr: Burr, material: Material, force: float) -> float:
    """Depth of the tip where intact bone alone carries the force, R phi^(1/q); q = 3/2 in Eq. 3 [mm].

    Examples
    --------
    >>> import burrlab
    >>> round(static_immersion(burrlab.Burr(3.0), burrlab.materials["bone"], 1.0), 4)
    0.4169
    """
    return float(burr.radius * (force / (material.c_e * burr.radius**2)) ** (1 / material.force_exponent))


def contact_stiffness(
    c_e: float, radius: float, force: float, immersion: float, force_exponent: float = 1.5
) -> float:
    """Stiffness k = dF/dH at force F in a hole of depth H [N/mm].

    k = q c_e u^(q - 1) (2 R H - H^2) / (R (2u - u^2)), u = (F/(c_e R^2))^(1/q). For q below 2 k grows as F falls in
    a hole.

    Parameters
    ----------
    c_e : float
        [N/mm^2]
    radius, immersion : float
        R, H [mm]; an H below the static immersion is raised to it.
    force : float
        F [N]
    force_exponent : float
        q; 3/2 in Eq. 3.
    """
    u = min((force / (c_e * radius**2)) ** (1 / force_exponent), 1.0)
    depth = min(max(immersion, u * radius), radius)
    area = 2 * radius * depth - depth**2  # contact area projected on the axis, over pi
    steepness = math.sqrt(u) if force_exponent == 1.5 else u ** (force_exponent - 1)
    return float(force_exponent * c_e * steepness * area / (radius * (2 * u - u * u)))


def layer_thickness(burr: Burr, material: Material, velocity: float, force: float = 1.0) -> float | None:
    """Thickness of the cut layer, delta_0 = sqrt(2 pi R v/(kappa alpha))/2 [mm].

    kappa = -f'(1): 2 for the parabolic, 1 for the linear shape. None if the zero of f is not simple, or alpha
    is 0.

    Parameters
    ----------
    velocity : float
        v [mm/s]
    force : float
        F [N], where the rate grows with it: alpha is the rate at 1 N.
    """
    if material.shape.order != 1.0 or material.alpha == 0.0:
        return None
    kappa, alpha = shape_kappa(material.shape), material.alpha * force**material.rate_exponent
    return float(0.5 * np.sqrt(2 * np.pi * burr.radius * velocity / (kappa * 1e3 * alpha)))


Array = NDArray[np.float64]

#: Relative half width of the band around the set-point that counts as settled (ours).
SETTLED_BAND = 0.05
#: Fewest ticks in a window with exactly held force (ours).
FEWEST_TICKS = 10


def settled_immersion(immersion: Array, force: Array, setpoint: float, *, span: int = 51) -> float | None:
    """Immersion from which the force stays settled until the end of the record.

    Parameters
    ----------
    immersion, force : ndarray, shape (n,)
        [mm], [N]
    setpoint : float
        [N]
    span : int
        Length of the centred mean [samples], odd.

    Returns
    -------
    float or None
        [mm]; None if the record is shorter than `span`, or its mean force ends more than 5 % off.
    """
    if len(force) < span:
        return None
    half = span // 2
    mean = scipy.ndimage.uniform_filter1d(force, span)[half : len(force) - half]
    outside = np.flatnonzero(np.abs(mean - setpoint) > SETTLED_BAND * setpoint)
    first = int(outside[-1]) + 1 if outside.size else 0
    return float(immersion[first + half]) if first < len(mean) else None


def samples_between(immersion: Array, start: float, end: float) -> slice:
    """Samples from the first at or beyond `start` [mm] to the last before one beyond `end` [mm]."""
    first = int(np.argmax(immersion >= start)) if np.any(immersion >= start) else len(immersion)
    beyond = np.flatnonzero(immersion[first:] > end)
    return slice(first, first + int(beyond[0]) if beyond.size else len(immersion))


def penetration_velocity_between(time: Array, immersion: Array, start: float, end: float) -> float | None:
    """Least-squares slope of immersion over time between two immersions [mm/s].

    Parameters
    ----------
    time, immersion : ndarray, shape (n,)
        [s], [mm]
    start, end : float
        [mm]

    Returns
    -------
    float or None
        [mm/s]; None with fewer than two samples between them.
    """
    rows = samples_between(immersion, start, end)
    t, h = time[rows], immersion[rows]
    if len(t) < 2:
        return None
    t = t - t.mean()
    return float(t @ (h - h.mean()) / (t @ t))
