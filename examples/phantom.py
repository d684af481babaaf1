"""A mastoidectomy without a patient: a procedural temporal bone, a scripted burr and the bone it removes.

    python examples/phantom.py [OUTPUT_FOLDER]

Writes phantom.png, slices before and after with the planned cavity, and target.png, volumes against the plan
by tissue.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import burrlab
from burrlab.anatomy.mastoidectomy import mastoidectomy_path
from burrlab.anatomy.target import compare_with_target
from burrlab.bone.phantom.phantom import Phantom, temporal_bone

PLAN = "#D55E00"


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    phantom = temporal_bone(0.4, seed=1)
    print(phantom.cells)

    burr = burrlab.Burr(3.0)
    path = mastoidectomy_path(phantom, burr, layer=1.0, step=2.0, speed=40.0)
    print(f"path: {path.layers} layers, {path.duration:.0f} s of drilling")

    # Periods run as fast as they can: the result is the same on every machine.
    tool = burr, burrlab.materials["bone"]
    with burrlab.Session(phantom.bone, tool, path.device(), seed=1, wall_clock=False) as session:
        session.wait()
        bone, ticks = session.snapshot()
    print(f"session: {ticks} ticks, {bone.removed:.0f} mm^3 removed\n")

    comparison = compare_with_target(bone, phantom.target)
    print(comparison)
    comparison.plot().figure.savefig(folder / "target.png", dpi=150)
    slices(phantom, bone).savefig(folder / "phantom.png", dpi=150)
    print(f"\nwritten to {folder}/: phantom.png target.png ({time.perf_counter() - begin:.0f} s)")


def slices(phantom: Phantom, bone: burrlab.VoxelBone) -> Figure:
    """Three planes through the antrum, before and after, with the planned cavity outlined."""
    figure = Figure(figsize=(9.6, 7.2), layout="constrained")
    rows = figure.subplots(2, 3)
    at = np.rint((phantom.landmarks["antrum"] - bone.origin) / bone.spacing).astype(int)
    colours = np.array([tissue.colour for tissue in bone.tissues]) / 255
    ends = [
        (o - s / 2, o + s * (n - 0.5))
        for o, s, n in zip(bone.origin, bone.spacing, bone.shape[::-1], strict=True)
    ]
    seen: set[int] = set()
    for axes, levels, when in zip(rows, (bone.pristine, bone.density), ("before", "after"), strict=True):
        for ax, axis, name in zip(axes, (2, 1, 0), ("axial", "coronal", "sagittal"), strict=True):
            plane = [slice(None)] * 3
            plane[2 - axis] = at[axis]
            shown = levels[tuple(plane)]
            seen.update(phantom.labels[tuple(plane)][shown > 0].tolist())
            across, up = (i for i in range(3) if i != axis)
            extent = (*ends[across], *ends[up])
            ax.imshow(
                # half full is drawn as full, so that soft tissue keeps its colour
                colours[phantom.labels[tuple(plane)]] * np.minimum(shown / 127.5, 1.0)[..., None],
                extent=extent,
                origin="lower",
            )
            ax.contour(phantom.target[tuple(plane)], levels=[0.5], colors=PLAN, linewidths=1, extent=extent)
            ax.set(xlabel=f"{'xyz'[across]} [mm]", ylabel=f"{'xyz'[up]} [mm]", title=f"{name}, {when}")
    present = sorted(seen)
    patches = [Patch(facecolor=colours[number], label=bone.tissues[number].name) for number in present]
    plan = Line2D([], [], color=PLAN, label="planned cavity")
    figure.legend(handles=[plan, *patches], loc="outside lower center", ncols=5, fontsize="small")
    return figure


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "phantom"))
