"""How a trace went into the bone, and the view along it: the first camera of pictures, windows, films and pages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.view.camera import Viewpoint, looking_at, surgeon_view
from burrlab.view.player import TracePlayer

_MEETING = (
    250.0  # when a burr has just met bone, and the force is along the normal: later it cuts sideways too [ms]
)


@dataclass(frozen=True, eq=False)
class Approach:
    """The middle of where bone was touched [mm], the direction in which it was met, and a width that holds it all [mm]."""

    entry: NDArray[np.float64]
    axis: NDArray[np.float64]
    width: float


def trace_approach(player: TracePlayer) -> Approach | None:
    """Of all burrs of a trace; None where none touched bone. The direction is that of the first forces on it."""
    burr = player.trace.ticks["burr"]
    touched = burr["touching"] > 0
    if not touched.any():
        return None
    centers, forces = burr["center_mm"][touched], burr["force_N"][touched]
    first = forces[: max(round(_MEETING / player.trace.period), 1)]
    push = -first.sum(axis=0)
    if np.linalg.norm(push) < 1e-6 * max(np.linalg.norm(first, axis=1).sum(), 1e-12):
        push = np.array([0.0, 0.0, -1.0])
    low, high = centers.min(axis=0), centers.max(axis=0)
    width = 1.6 * float(np.linalg.norm(high - low)) + 7 * float(player.burrs.radii.max())
    return Approach((low + high) / 2, push / np.linalg.norm(push), width)


def approach_view(bone: VoxelBone, approach: Approach | None, *, width: float | None = None) -> Viewpoint:
    """As a surgeon looks along it; without one, from above at the whole volume. `width`: that the view holds instead [mm]."""
    if approach is None:
        return surgeon_view(bone, width=width)
    return looking_at(approach.entry, approach.axis, approach.width if width is None else width)
