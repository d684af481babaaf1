"""Curves for the page's charts: points of an SVG polyline, few whatever the number of ticks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 1000.0, 100.0  # of the charts' coordinates
_COLUMNS = 500


def top(values: NDArray[np.float64]) -> float:
    """End of an axis from 0 that holds the values: 1, 2 or 5 times a power of ten."""
    largest = float(values.max(initial=0.0))
    if largest <= 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(largest))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if largest <= step * power * (1 + 1e-9))


def polyline(
    time: NDArray[np.float64], values: NDArray[np.float64], span: tuple[float, float], most: float
) -> str:
    """Points "x,y x,y ..." in a chart of 1000 x 100, y downwards.

    Of many ticks each column keeps its least and largest value, so that no peak is lost.

    Parameters
    ----------
    time, values : ndarray, shape (n,)
        Times in order.
    span : (first, last)
        Of the time axis.
    most : float
        End of the value axis, which begins at 0.
    """
    inside = (time >= span[0]) & (time <= span[1])
    time, values = time[inside], values[inside]
    width = span[1] - span[0]
    if not len(time) or width <= 0:
        return ""
    if len(time) > 2 * _COLUMNS:
        column = np.minimum((_COLUMNS * (time - span[0]) / width).astype(np.int64), _COLUMNS - 1)
        starts = np.flatnonzero(np.diff(column, prepend=-1))
        low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
        time, values = np.repeat(time[starts], 2), np.stack([low, high], axis=1).ravel()
    x = WIDTH * (time - span[0]) / width
    y = HEIGHT * (1.0 - np.clip(values / most, 0.0, 1.0))
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
