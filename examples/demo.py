"""The main job, end to end: a velocity-force curve, its fit, and voxel descents at the fitted values.

    python examples/demo.py [OUTPUT_FOLDER]

The data are synthetic: from the mean-field engine with bone's parameters and a scatter of 8 %.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import burrlab


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    burr = burrlab.Burr(3.0)
    truth = burrlab.materials["bone"]

    data = burrlab.synthetic_curve(burr, truth, np.linspace(0.4, 2.6, 10), repeats=3, scatter=0.08, seed=2004)
    data.to_csv(folder / "data.csv")
    print(f"data: {len(data)} points, {data.source}\n")

    fit = burrlab.fit(data, burr)
    fit.to_json(folder / "fit.json")
    print(fit.report(), "\n")

    off = [fit.c_e / truth.c_e - 1, fit.alpha / truth.alpha - 1]
    print(f"made with c_e {truth.c_e}, alpha {truth.alpha}: off by {off[0]:+.1%} and {off[1]:+.1%}\n")

    fitted = fit.material("fitted")
    descents = burrlab.force_sweep(
        burr, fitted, np.linspace(0.4, 2.4, 6), repeats=2, voxel=0.1, seed=1, progress=True
    )
    if "interrupted" in (descents.status or ()):
        sys.exit("interrupted")
    expected = fit.velocity(descents.force)
    print("voxel descents at the fitted values, force held exactly, 0.1 mm voxels:")
    for force, velocity, line in zip(descents.force, descents.velocity, expected, strict=True):
        print(f"  {force:.2f} N  {velocity:8.4f} mm/s   mean-field {line:8.4f}   ratio {velocity / line:.3f}")

    axes = fit.plot(log=True)
    descents.plot(axes, log=True, color="#D55E00", marker="o", label="voxel descents, 0.1 mm")
    axes.set_title("synthetic data, fit and voxel descents", fontsize=10)
    axes.figure.savefig(folder / "fit.png", dpi=200)

    region = fit.plot_region(points={"made with": (truth.c_e, truth.alpha)})
    region.set_title("what the data determine", fontsize=10)
    region.figure.savefig(folder / "region.png", dpi=200)

    run = burrlab.descend(burr, fitted, 1.0, voxel=0.1, seed=1)
    print(f"\n{run}")
    run.plot()[0].figure.savefig(folder / "descent.png", dpi=200)
    print(
        f"\nwritten to {folder}/: data.csv fit.json fit.png region.png descent.png "
        f"({time.perf_counter() - begin:.0f} s)"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "demo"))
