"""The voxel engine of a fit: descents into a voxel bone at the curve's forces."""

from __future__ import annotations

import os
import threading
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Material, Shape
from burrlab.descent import descend
from burrlab.descent_result import FEWEST_TICKS, Descent
from burrlab.fitting.problem import WINDOW_END, WINDOW_START, Observations
from burrlab.sweep import item_seed
from burrlab.window import samples_between

Floats: TypeAlias = NDArray[np.float64]
Window: TypeAlias = tuple[float | None, float | None]  # in radii; None is the default end

_LONGEST = 3600.0  # a descent that takes longer than this is stalled [s of simulated time]


@dataclass(frozen=True)
class VoxelDescent:
    """One descent and the windows to read from it: small, picklable, a function of itself alone."""

    burr: Burr
    material: Material
    force: float  # [N]
    windows: tuple[Window, ...]
    voxel: float  # [mm]
    dt: float  # [ms]
    seed: int

    def velocities(self, cancel: threading.Event | None = None) -> list[float]:
        """Penetration velocity [mm/s] over each window; NaN where there is no number."""
        R = self.burr.radius
        windows = [
            (R * (WINDOW_START if start is None else start), R * (WINDOW_END if end is None else end))
            for start, end in self.windows
        ]
        run = descend(
            self.burr,
            self.material,
            self.force,
            voxel=self.voxel,
            dt=self.dt,
            seed=self.seed,
            ideal=True,
            stop=max(end for _, end in windows),
            max_duration=_LONGEST,
            cancel=cancel,
        )
        if run.status not in ("ok", "window-too-short"):
            return [np.nan] * len(windows)
        return [_velocity(run, start, end) for start, end in windows]


def _velocity(run: Descent, start: float, end: float) -> float:
    start = max(start, float(run.immersion[0]))  # a window never starts before static contact
    rows = samples_between(run.immersion, start, end)
    velocity = run.velocity_over(start, end) if rows.stop - rows.start >= FEWEST_TICKS else None
    return np.nan if velocity is None or velocity <= 0 else velocity


class VoxelModel:
    """Predictions by descents with the force held exactly, one for each distinct force of the curve.

    Every call uses the same seeds, so the erosion draws the same random numbers, and predictions at
    neighbouring parameters differ by little more than the parameters make them.
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
        self._burr, self._n = Burr(observations.radius), len(observations)
        self._rows: dict[float, dict[Window, NDArray[np.intp]]] = {}
        for window, rows in observations.by_window().items():
            for force in np.unique(observations.force[rows]).tolist():
                self._rows.setdefault(force, {})[window] = rows[observations.force[rows] == force]
        self._known: dict[tuple[float, float], Floats] = {}

    def predict(self, c_e: float, alpha: float) -> Floats:
        """Velocity [mm/s] of every row at c_e [N/mm^2], alpha [1/ms]; NaN where a descent gave no number."""
        if (c_e, alpha) not in self._known:
            material = Material("trial", c_e=c_e, alpha=alpha, shape=self._shape)
            descents = []
            for force, windows in sorted(self._rows.items()):  # small forces first: they sink for long
                seed = item_seed(self._seed, force, 0)
                descents.append(
                    VoxelDescent(self._burr, material, force, tuple(windows), self._voxel, self._dt, seed)
                )
            velocity = np.empty(self._n)
            for descent, found in zip(descents, self._run(descents), strict=True):
                for rows, value in zip(self._rows[descent.force].values(), found, strict=True):
                    velocity[rows] = value
            self._known[c_e, alpha] = velocity
        return self._known[c_e, alpha]

    def _run(self, descents: list[VoxelDescent]) -> list[list[float]]:
        if self._executor is not None:
            return list(self._executor.map(VoxelDescent.velocities, descents))
        cancel = threading.Event()
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            try:
                return list(threads.map(lambda descent: descent.velocities(cancel), descents))
            except BaseException:  # Ctrl-C: end the descents that run, or the pool waits for them
                cancel.set()
                threads.shutdown(wait=True, cancel_futures=True)
                raise
