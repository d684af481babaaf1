"""The window of a descent and the penetration velocity in it (definitions: docs/descent.md)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

Array = NDArray[np.float64]

#: Half width of the band around the set-point that counts as settled, relative (ours).
SETTLED_BAND = 0.05
#: Fewest ticks in a window whose force is held exactly (ours).
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
        [mm]; None if the centred mean of the force leaves the set-point by 5 % up to the end.
    """
    if len(force) < span:
        return None
    half = span // 2
    mean = uniform_filter1d(force, span)[half : len(force) - half]
    outside = np.flatnonzero(np.abs(mean - setpoint) > SETTLED_BAND * setpoint)
    first = int(outside[-1]) + 1 if outside.size else 0
    return float(immersion[first + half]) if first < len(mean) else None


def samples_between(immersion: Array, start: float, end: float) -> slice:
    """Samples from the first at `start` [mm] to the last before `end` [mm] is passed."""
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
        [mm/s]; None with fewer than two samples there.
    """
    rows = samples_between(immersion, start, end)
    t, h = time[rows], immersion[rows]
    if len(t) < 2:
        return None
    t = t - t.mean()
    return float(t @ (h - h.mean()) / (t @ t))
