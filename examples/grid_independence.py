"""The penetration velocity does not depend on the voxel size: both schemes against the mean field.

    python examples/grid_independence.py [OUT.png] [--fast]

Descents with the force held exactly, in bone, burr of 3 mm. A marker is the mean over places of the burr
within the voxel grid, its bar one standard deviation.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from tqdm import tqdm

import burrlab
from burrlab.common.figures import REFERENCE, new_figure, paper, tidy
from burrlab.theory.continuum import penetration_velocity

BURR = burrlab.Burr(3.0)
BONE = burrlab.materials["bone"]
VOXELS = (0.4, 0.3, 0.2, 0.15, 0.1, 0.075)  # [mm]
FORCES = {0.5: ("#0072B2", "o"), 1.0: ("#009E73", "s"), 2.0: ("#D55E00", "^")}  # [N]
PLACES = 8
LONGEST = 150.0  # simulated time [s] after which a run is abandoned

Key = tuple[str, float, float]


def velocity(scheme: str, force: float, voxel: float, seed: int, longest: float) -> float:
    """Penetration velocity [mm/s]; NaN if the run does not reach its stop within `longest` [s]."""
    run = burrlab.descend(
        BURR,
        BONE,
        force,
        voxel=voxel,
        seed=seed,
        settings=burrlab.DescentSettings(scheme=scheme, max_duration=longest),
        ideal=True,
    )
    return np.nan if run.penetration_velocity is None else run.penetration_velocity


def measure(fast: bool) -> dict[Key, np.ndarray]:
    """Velocities [mm/s] at all places, for every scheme, force and voxel size."""
    voxels = (0.4, 0.2) if fast else VOXELS
    forces = (1.0, 2.0) if fast else FORCES
    places = 2 if fast else PLACES
    jobs = [(scheme, force, voxel) for scheme in ("layer", "cell") for force in forces for voxel in voxels]
    tasks = [(*job, seed, 30.0 if fast else LONGEST) for job in jobs for seed in range(places)]
    with ThreadPoolExecutor() as pool:
        done = list(tqdm(pool.map(lambda task: velocity(*task), tasks), total=len(tasks), desc="descents"))
    return {job: np.array(done[places * i : places * (i + 1)]) for i, job in enumerate(jobs)}


def draw(axes: Axes, found: dict[Key, np.ndarray], scheme: str) -> None:
    """Velocity over that of the mean field against voxel size."""
    axes.axhspan(0.97, 1.03, color="0.92", zorder=0)
    axes.axhline(1.0, color=REFERENCE, linewidth=1.2, label="mean field, ±3 %")
    for force, (colour, marker) in FORCES.items():
        keys = [key for key in found if key[:2] == (scheme, force) and np.isfinite(found[key]).all()]
        if not keys:
            continue
        expected = float(penetration_velocity(BURR, BONE, force))
        mean = [found[key].mean() / expected for key in keys]
        spread = [found[key].std(ddof=1) / expected for key in keys]
        axes.errorbar(
            [key[2] for key in keys], mean, spread, color=colour, marker=marker, markersize=5, linewidth=0.9,
            capsize=2.5, label=f"{force:g} N, {expected:.3g} mm/s",
        )  # fmt: skip
    given_up = sorted(key[1:] for key in found if key[0] == scheme and not np.isfinite(found[key]).all())
    if given_up:
        lines = [f"{force:g} N, {voxel:g} mm" for force, voxel in given_up]
        note = f"not at R/3 within {LONGEST:g} s:\n" + "\n".join(lines)
        axes.annotate(note, (0.03, 0.03), xycoords="axes fraction", color=REFERENCE)
    axes.set_xscale("log")
    axes.minorticks_off()
    axes.set_xticks(VOXELS, [f"{voxel:g}" for voxel in VOXELS])
    axes.set_xlabel("voxel size [mm]")
    top = axes.secondary_xaxis("top", functions=(lambda s: s, lambda s: s))
    top.minorticks_off()
    top.set_xticks(VOXELS, [f"{BURR.radius / voxel:.3g}" for voxel in VOXELS])
    top.set_xlabel("burr radius / voxel size")
    tidy(axes)


@paper("double")
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path("docs/grid_independence.png"))
    parser.add_argument("--fast", action="store_true", help="few voxel sizes, forces and places")
    options = parser.parse_args()
    found = measure(options.fast)
    for (scheme, force, voxel), velocities in found.items():
        if not np.isfinite(velocities).all():
            print(f"{scheme:5s} {force:3g} N {voxel:5g} mm: not at its stop when the time was over")
            continue
        ratio = velocities / float(penetration_velocity(BURR, BONE, force))
        print(
            f"{scheme:5s} {force:3g} N {voxel:5g} mm: {velocities.mean():.4f} mm/s, "
            f"{ratio.mean():.3f} +- {ratio.std(ddof=1):.3f} of the mean field"
        )
    figure = new_figure(8.0, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    draw(left, found, "layer")
    draw(right, found, "cell")
    left.set(ylabel="penetration velocity / mean field [1]", ylim=(0, 1.15))
    left.set_title("layer resolved inside the voxel (default)")
    right.set_title("whole voxels, by fractions (cell)")
    left.legend(loc="lower left", frameon=False, title="bone, R = 3 mm, dt = 1 ms")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=200)


if __name__ == "__main__":
    main()
