"""A mastoidectomy without a patient: a procedural temporal bone, a scripted burr and the bone it removes.

    python examples/phantom.py [OUTPUT_FOLDER] [VOXEL]

Writes phantom.png, slices before and after with the planned cavity, and target.png, volumes against the plan
by tissue, and ear.h5, the trace. VOXEL [mm] is 0.4 unless given.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure, SubFigure

import burrlab
from burrlab.anatomy.mastoidectomy import mastoidectomy_path
from burrlab.anatomy.target import compare_with_target
from burrlab.bone.phantom.phantom import Phantom, temporal_bone
from burrlab.view.pictures import PLANES, plot_slices


def main(folder: Path, voxel: float) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    phantom = temporal_bone(voxel, seed=1)
    print(phantom.cells)
    figure = Figure(figsize=(9.6, 8.4), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.1)
    above, below = figure.subfigures(2, 1)
    draw(above, phantom, phantom.bone, "before")

    burr = burrlab.Burr(3.0)
    path = mastoidectomy_path(phantom, burr, layer=1.0, step=2.0, speed=40.0)
    print(f"path: {path.layers} layers, {path.duration:.0f} s of drilling")

    # Periods run as fast as they can: the result is the same on every machine.
    tool = burr, burrlab.materials["bone"]
    trace = folder / "ear.h5"
    trace.unlink(missing_ok=True)
    with burrlab.Session(
        phantom.bone, tool, path.device(), seed=1, clock=burrlab.Clock(wall_clock=False), record=trace
    ) as session:
        session.wait()
        bone, ticks = session.snapshot()
    print(f"session: {ticks} ticks, {bone.removed:.0f} mm^3 removed\n")

    comparison = compare_with_target(bone, phantom.target)
    print(comparison)
    comparison.plot().figure.savefig(folder / "target.png", dpi=150)
    draw(below, phantom, bone, f"after {path.duration:.0f} s")
    figure.savefig(folder / "phantom.png", dpi=150)
    print(f"\nwritten to {folder}/: phantom.png target.png ear.h5 ({time.perf_counter() - begin:.0f} s)")


def draw(place: SubFigure, phantom: Phantom, bone: burrlab.VoxelBone, when: str) -> None:
    """Slices through the antrum, with the planned cavity outlined."""
    at = phantom.landmarks["antrum"]
    index = np.rint((at - bone.origin) / bone.spacing).astype(int)
    slices = plot_slices(bone, at, note=f"{when}; orange: planned cavity", ax=place)
    for ax, (across, _, _) in zip(slices, PLANES.values(), strict=True):
        plan = phantom.target.take(index[across], axis=2 - across)
        ax.contour(plan, levels=[0.5], colors="#D55E00", linewidths=1, extent=ax.images[0].get_extent())


if __name__ == "__main__":
    folder, voxel = [*sys.argv[1:], *("phantom", "0.4")[len(sys.argv) - 1 :]]
    main(Path(folder), float(voxel))
