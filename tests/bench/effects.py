"""Cost of the secondary effects beside a session: frames against their budget, ticks with and without.

    python tests/bench/effects.py [--seconds 60] [--parcels 20000] [--rounds 2] [--json FILE]

A burr of 3 mm strokes at 1 kHz through a block with two tissues, one of which bleeds. Beside it run effects
at 20 Hz with water, a sucker and a camera; twice a second the parcels are copied. Parcels reach the given
number in the first 5 s, then the measurement begins. Each round also runs the same session without effects
over the same ticks, before or after by turns, so that the ratio of the ticks is of one machine in one run.
"""

import argparse
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import burrlab
from burrlab._core import Camera, EffectParameters, Nozzle, Sucker
from burrlab.effects.companion import Companion

WARM = 5.0  # time for parcels to reach their number [s]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--parcels", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    results = []
    for number in range(options.rounds):
        results.append(run(options.seconds, options.parcels, alone_first=number % 2 == 0))
        print(f"round {number + 1} of {options.rounds}, on {os.cpu_count()} CPUs\n{results[-1]['text']}\n")
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


def block() -> burrlab.VoxelBone:
    """A block of 24 x 24 x 10 mm at 0.1 mm, top at z = 0; the half with x > 0 bleeds."""
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
    """A session whose script strokes along x, in rows along y, and sinks by 60 um/s."""
    times = np.arange(0.0, WARM + seconds + 0.2, 0.005)
    depth = 0.2 + 0.06 * times
    positions = np.stack(
        [7.0 * np.sin(2 * np.pi * times / 0.9), 6.0 * np.sin(2 * np.pi * times / 17), 3.0 - depth], axis=1
    )
    device = burrlab.ScriptedDevice(times, positions)
    return burrlab.Session(
        block(), (burrlab.Burr(3.0), burrlab.materials["bone"]), device, seed=1, duration=WARM + seconds
    )


def companion_of(made: burrlab.Session, parcels: int) -> Companion:
    """Effects that soon hold at least `parcels`; a merge at the limit leaves 95 %, and some parcels go."""
    return Companion(
        made,
        seed=1,
        parameters=EffectParameters(
            most_parcels=parcels * 20 // 19 + 1000, dust_parcel=0.0003, water_parcel=0.1, wetting_distance=0.1
        ),
        nozzle=Nozzle((5, 0, 8), (-0.5, 0, -0.9), rate=150),
        sucker=Sucker((8, 4, 0.5), rate=60),
        camera=Camera((0, -40, 60), (0, 0, 0)),
    )


def ticks_us(loop: Any, before: dict[str, NDArray[np.uint64]] | None = None) -> dict[str, Any]:
    """Counts of tick times; since `before`: median and p99, upper ends of bins 1/32 of their value wide."""
    counts = {"cpu": loop.tick_time.counts, "wall": loop.wall_time.counts}
    if before is None:
        return counts
    out = {}
    for name in counts:
        sums = np.cumsum(counts[name] - before[name])
        for label, part in (("p50", 0.5), ("p99", 0.99)):
            at = np.searchsorted(sums, part * sums[-1]) + 1
            out[f"{name}_{label}"] = float(loop.tick_time.edges[at])
    return out


def run_alone(seconds: float) -> dict[str, float]:
    with session(seconds) as made:
        made.wait(WARM)
        before = ticks_us(made.loop)
        made.wait()
        return ticks_us(made.loop, before)


def run_beside(seconds: float, parcels: int) -> dict[str, Any]:
    made = session(seconds)
    companion = companion_of(made, parcels)
    with companion, made:
        made.wait(WARM)
        before, begin = ticks_us(made.loop), companion.report()
        present = [len(companion.parcels)]
        while not made.wait(0.5):
            present.append(len(companion.parcels))
        quantiles = ticks_us(made.loop, before)
        companion.wait(10)
    newest, end = companion.newest(), companion.report()
    dust, removed = newest["balance"]["dust"], round(made.snapshot()[0].removed / companion.quantum)
    return {
        "ticks_us": quantiles,
        "frames": end.frames - begin.frames,
        "over_budget": end.over_budget - begin.over_budget,
        "least_parcels": min(present),
        "report": end.to_dict(),
        "report_text": str(end),
        "balance": {name: account.volumes() for name, account in newest["balance"].items()},
        "exact": all(balance.exact for balance in newest["balance"].values()) and dust.made == removed,
        "failed": made.failed or bool(companion.error),
    }


def run(seconds: float, parcels: int, *, alone_first: bool = True) -> dict[str, Any]:
    """Results of the same session without and with effects."""
    alone = run_alone(seconds) if alone_first else None
    result = run_beside(seconds, parcels)
    alone = alone or run_alone(seconds)
    beside, frames = result["ticks_us"], result["frames"]
    within = frames - result["over_budget"]
    lines = [
        f"{within} of {frames} frames within 20 ms ({100 * within / frames:.2f} %), at least "
        f"{result['least_parcels']} parcels in them",
        f"with the first {WARM:g} s: {result['report_text']}",
        *(
            f"tick, {clock}: median {alone[name + '_p50']:.1f} us alone, {beside[name + '_p50']:.1f} us "
            f"beside ({beside[name + '_p50'] / alone[name + '_p50']:.2f} times), p99 "
            f"{alone[name + '_p99']:.1f} and {beside[name + '_p99']:.1f} us"
            for name, clock in (("cpu", "CPU time"), ("wall", "wall clock"))
        ),
        *(
            f"{name}: " + ", ".join(f"{part} {volume:.3f}" for part, volume in volumes.items()) + " mm^3"
            for name, volumes in result["balance"].items()
        ),
        f"made = present + sucked + drained in quanta, and dust made = bone removed: {result['exact']}",
    ]
    ratio = beside["cpu_p50"] / alone["cpu_p50"]
    return {**result, "alone_us": alone, "median_ratio": ratio, "text": "\n".join(lines)}


if __name__ == "__main__":
    main()
