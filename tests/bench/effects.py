"""What the secondary effects cost beside a running session: frames against their budget, ticks with and without.

    python tests/bench/effects.py [--seconds 60] [--parcels 20000] [--json FILE]

A burr of 3 mm strokes through a block with two tissues, one of which bleeds, at 1 kHz; beside it run effects at 20 Hz
with water and a sucker. Parcels fill up to the number given in the first seconds, and stay there. The same session
runs without effects before, so that the ratio of their ticks is of one machine in one run.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

import burrlab
from burrlab.effects import Camera, Companion, EffectParameters, Nozzle, Sucker


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--parcels", type=int, default=20_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    result = run(options.seconds, options.parcels)
    print(result["text"])
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def block() -> burrlab.VoxelBone:
    """24 x 24 x 10 mm at 0.1 mm, top at z = 0; the half with x > 0 bleeds."""
    bone = burrlab.VoxelBone.block((24, 24, 10), 0.1, origin=(-11.95, -11.95, -9.95))
    solid = burrlab.materials["bone"]
    rows = [
        burrlab.Tissue(name, label=label, c_e=solid.c_e, alpha=solid.alpha, bleeds=bleeds)
        for label, (name, bleeds) in enumerate((("bone", False), ("marrow", True)))
    ]
    numbers = np.zeros(bone.shape, np.uint8)
    numbers[:, :, bone.shape[2] // 2 :] = 1
    bone.set_tissues(burrlab.Tissues(rows, solid), numbers)
    return bone


def session(seconds: float) -> burrlab.Session:
    """A script that strokes along x, in rows along y, and sinks by 60 um/s."""
    times = np.arange(0.0, seconds + 0.2, 0.005)
    depth = 0.2 + 0.06 * times
    positions = np.stack(
        [7.0 * np.sin(2 * np.pi * times / 0.9), 6.0 * np.sin(2 * np.pi * times / 17), 3.0 - depth], axis=1
    )
    device = burrlab.ScriptedDevice(times, positions)
    return burrlab.Session(
        block(), (burrlab.Burr(3.0), burrlab.materials["bone"]), device, seed=1, duration=seconds
    )


def companion_of(made: burrlab.Session, parcels: int) -> Companion:
    """As many parcels as asked for, soon: small ones, that do not wet one another away."""
    return Companion(
        made,
        seed=1,
        parameters=EffectParameters(
            most_parcels=parcels, dust_parcel=0.0003, water_parcel=0.1, wetting_distance=0.1
        ),
        nozzle=Nozzle((5, 0, 8), (-0.5, 0, -0.9), rate=150),
        sucker=Sucker((9, 9, 2), rate=60),
        camera=Camera((0, -40, 60), (0, 0, 0)),
    )


def run(seconds: float, parcels: int) -> dict[str, Any]:
    """Two sessions, without and with effects."""
    with session(seconds) as alone:
        alone.wait()
    before = ticks_of(alone)
    with session(seconds) as beside:
        companion = companion_of(beside, parcels).start()
        try:
            beside.wait()
            companion.wait(10)
        finally:
            companion.stop()
    newest, report, after = companion.newest(), companion.report(), ticks_of(beside)
    dust = newest["balance"]["dust"]
    removed = round(beside.snapshot()[0].removed / companion.quantum)
    exact = all(balance.exact for balance in newest["balance"].values()) and dust.made == removed
    frames = f"{report.frames - report.over_budget} of {report.frames} frames within {1e3 * (report.budget or 0):g} ms"
    lines = [
        str(report),
        f"{frames} (on {os.cpu_count()} CPUs)",
        f"tick, CPU time: median {before[0]:.1f} us alone, {after[0]:.1f} us beside ({after[0] / before[0]:.2f} times), "
        f"p99 {before[1]:.1f} and {after[1]:.1f} us",
        *(f"{name}: {balance}" for name, balance in newest["balance"].items()),
        f"made = present + sucked + drained, and dust made = bone removed: {exact}",
    ]
    return {
        "text": "\n".join(lines), "exact": exact, "report": report.to_dict(), "alone_us": before, "beside_us": after,
        "median_ratio": after[0] / before[0], "failed": beside.failed or bool(companion.error), "removed": removed,
    }  # fmt: skip


def ticks_of(made: burrlab.Session) -> tuple[float, float]:
    """Median and p99 of the tick [us]."""
    times = made.loop.tick_time
    return times.quantile(0.5), times.quantile(0.99)


if __name__ == "__main__":
    main()
