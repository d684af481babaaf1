"""The voxel engine of a fit: descents into a voxel bone at the curve's forces."""

from __future__ import annotations

from concurrent.futures import Executor
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Material, Shape
from burrlab.fit_problem import Observations
from burrlab.sweep import force_sweep

Floats: TypeAlias = NDArray[np.float64]


class VoxelModel:
    """Predictions by descents with the force held exactly, one for each distinct force.

    Every call uses the same seed, so the erosion draws the same random numbers and predictions
    at neighbouring parameters differ by little more than the parameters make them.
    """

    def __init__(
        self,
        observations: Observations,
        shape: Shape,
        *,
        voxel: float,
        dt: float,
        seed: int,
        executor: Executor | None,
    ) -> None:
        self._shape, self._voxel, self._dt, self._seed, self._executor = shape, voxel, dt, seed, executor
        self._burr = Burr(observations.radius)
        self._force, self._rows = np.unique(observations.force, return_inverse=True)
        self._known: dict[tuple[float, float], Floats] = {}
        if not np.isnan(observations.window_start).all():
            raise ValueError("the voxel engine compares over the default window: leave the rows' windows empty")

    def predict(self, c_e: float, alpha: float) -> Floats:
        """Velocity [mm/s] of every row at c_e [N/mm^2], alpha [1/ms]; NaN where a descent gave no number."""
        if (c_e, alpha) not in self._known:
            material = Material("trial", c_e=c_e, alpha=alpha, shape=self._shape)
            curve = force_sweep(
                self._burr,
                material,
                self._force,
                voxel=self._voxel,
                dt=self._dt,
                seed=self._seed,
                executor=self._executor,
                progress=False,
            )
            self._known[c_e, alpha] = curve.velocity[self._rows]
        return self._known[c_e, alpha]
