"""The mean-field engine of a fit: the scaling law."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from burrlab._core import Shape
from burrlab.fitting.observations import Floats, Observations, Rows
from burrlab.master_curve import MasterCurve


class Model(Protocol):
    """What predicts the velocity rows of an `Observations`; the velocity is proportional to alpha."""

    def unit(self, c_e: ArrayLike) -> Floats:
        """Velocity [mm/s] at alpha = 1 /ms, shape of c_e and (n,); NaN where c_e leaves no window."""


class MeanFieldModel:
    """Predictions by the scaling law v = alpha R Psi(phi, window; f) (model, section 5).

    Rows are grouped by window, and each distinct F/R^2 is looked up once.
    """

    def __init__(self, observations: Observations, shape: Shape) -> None:
        self._radius = observations.radius
        self._curve = MasterCurve(shape)
        self._groups: list[tuple[float | None, float | None, Floats, Rows, Rows]] = []
        pressure = observations.force / observations.radius**2
        for (start, end), rows in observations.by_window().items():
            distinct, inverse = np.unique(pressure[rows], return_inverse=True)
            self._groups.append((start, end, distinct, rows, inverse))

    def unit(self, c_e: ArrayLike) -> Floats:
        """See `Model`."""
        stiffness = np.asarray(c_e, dtype=np.float64)[..., None]
        ratio = np.empty((*stiffness.shape[:-1], len(self._radius)))
        for start, end, pressure, rows, inverse in self._groups:
            distinct = np.asarray(self._curve.velocity_ratio(pressure / stiffness, start, end))
            ratio[..., rows] = distinct[..., inverse]
        return 1e3 * self._radius * ratio  # 1/ms is 1000/s

    def predict(self, c_e: float, alpha: float) -> Floats:
        """Velocity [mm/s] of every velocity row at c_e [N/mm^2], alpha [1/ms]."""
        return alpha * self.unit(c_e)
