"""One descent of the voxel engine of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from burrlab._core import Burr, Material
from burrlab.bone_field import BoneField
from burrlab.descent import descend
from burrlab.descent_result import Descent
from burrlab.fitting.observations import WINDOW_END, WINDOW_START
from burrlab.specimen import Specimen
from burrlab.window import FEWEST_TICKS, samples_between

Window: TypeAlias = tuple[float | None, float | None]  # in radii; None is the default end

_LONGEST = 3600.0  # a descent that takes longer than this is stalled [s of simulated time]


@dataclass(frozen=True)
class VoxelSettings:
    """What is simulated."""

    voxel: float  # [mm]
    dt: float  # [ms]
    rig: bool
    specimen: Specimen | BoneField | None
    replicates: int

    def described(self) -> dict[str, Any]:
        """For the provenance."""
        specimen = self.specimen
        name = "solid bone" if specimen is None else repr(specimen)
        volume: dict[str, Any] = {}
        if isinstance(specimen, Specimen):
            name = f"{specimen.source}, digest {specimen.bone.digest()}"
            volume = {"volume": dict(specimen.made)} if specimen.made else {}
        return {
            "voxel_mm": self.voxel,
            "dt_ms": self.dt,
            "rig": self.rig,
            "specimen": name,
            "replicates": self.replicates,
            **volume,
        }


@dataclass(frozen=True)
class VoxelDescent:
    """One descent and the windows to read from it: small, picklable, a function of itself alone."""

    burr: Burr
    material: Material
    force: float  # [N]
    windows: tuple[Window, ...]
    settings: VoxelSettings
    seed: int

    def velocities(self) -> list[float]:
        """Penetration velocity [mm/s] over each window; NaN without a number, infinite without a window."""
        R, given = self.burr.radius, self.settings
        windows = [
            (R * (WINDOW_START if start is None else start), R * (WINDOW_END if end is None else end))
            for start, end in self.windows
        ]
        stop = max(end for _, end in windows)
        specimen = given.specimen
        if isinstance(specimen, BoneField):
            specimen = specimen.specimen(self.burr, given.voxel, depth=stop, seed=self.seed)
        run = descend(
            self.burr,
            self.material,
            self.force,
            voxel=given.voxel,
            dt=given.dt,
            seed=self.seed,
            ideal=not given.rig,
            specimen=specimen,
            stop=stop,
            max_duration=_LONGEST,
        )
        if run.status == "overloaded":
            return [np.inf] * len(windows)
        if run.status not in ("ok", "window-too-short", "never-settled"):
            return [np.nan] * len(windows)
        numbers = []
        for window, (start, end) in zip(self.windows, windows, strict=True):
            own = window == (None, None) and given.rig
            numbers.append((run.penetration_velocity or np.nan) if own else _velocity(run, start, end))
        return numbers


def sink(descent: VoxelDescent) -> list[float]:
    """The item function of a study: `VoxelDescent.velocities`."""
    return descent.velocities()


def _velocity(run: Descent, start: float, end: float) -> float:
    start = max(start, float(run.immersion[0]))  # a window never starts before static contact
    rows = samples_between(run.immersion, start, end)
    velocity = run.velocity_over(start, end) if rows.stop - rows.start >= FEWEST_TICKS else None
    return np.nan if velocity is None or velocity <= 0 else velocity
