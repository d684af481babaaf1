"""Cost of the secondary effects beside a session: frames against their budget, ticks with and without.

    python tests/bench/effects.py [--seconds 60] [--parcels 20000] [--rounds 2]

A burr of 3 mm strokes at 1 kHz through a block with two tissues, one of which bleeds. Beside it run effects
at 20 Hz with water, a sucker and a camera; twice a second the parcels are copied. Parcels reach the given
number in the first 5 s, then the measurement begins. Each round also runs the same session without effects
over the same ticks, before or after by turns, so that the ratio of the ticks is of one machine in one run.
"""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray
from options import options

import burrlab
from burrlab.effects import Camera, Companion, EffectParameters, Nozzle, Sucker

WARM = 5.0  # time for parcels to reach their number [s]


def main() -> None:
    chosen = options(__doc__, seconds=60.0, parcels=20_000, rounds=2)
    for number in range(chosen.rounds):
        text = run(chosen.seconds, chosen.parcels, alone_first=number % 2 == 0)
        print(f"round {number + 1} of {chosen.rounds}, on {os.cpu_count()} CPUs\n{text}\n")


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
    x, y = 7.0 * np.sin(2 * np.pi * times / 0.9), 6.0 * np.sin(2 * np.pi * times / 17)
    device = burrlab.ScriptedDevice(times, np.stack([x, y, 2.8 - 0.06 * times], axis=1))
    return burrlab.Session(
        block(), (burrlab.Burr(3.0), burrlab.materials["bone"]), device, seed=1, duration=WARM + seconds
    )


def tick_time(loop: Any, before: NDArray[np.uint64]) -> float:
    """Median CPU time of the ticks since the counts `before` [us], as the upper end of a bin 1/32 of it wide."""
    sums = np.cumsum(loop.tick_time.counts - before)
    return float(loop.tick_time.edges[np.searchsorted(sums, sums[-1] / 2) + 1])


def run_alone(seconds: float) -> float:
    with session(seconds) as made:
        made.wait(WARM)
        before = made.loop.tick_time.counts
        made.wait()
        return tick_time(made.loop, before)


def run_beside(seconds: float, parcels: int) -> tuple[float, str, str]:
    """Median tick [us], and lines on the frames and on the balances."""
    made = session(seconds)
    # Effects that soon hold at least `parcels`; a merge at the limit leaves 95 %, and some parcels go.
    companion = Companion(
        made,
        seed=1,
        parameters=EffectParameters(
            most_parcels=parcels * 20 // 19 + 1000, dust_parcel=0.0003, water_parcel=0.1, wetting_distance=0.1
        ),
        nozzle=Nozzle((5, 0, 8), (-0.5, 0, -0.9), rate=150),
        sucker=Sucker((8, 4, 0.5), rate=60),
        camera=Camera((0, -40, 60), (0, 0, 0)),
    )
    with companion, made:
        made.wait(WARM)
        before, begin = made.loop.tick_time.counts, companion.report()
        while not made.wait(0.5):
            companion.parcels  # noqa: B018  # copies them, as a view does
        median = tick_time(made.loop, before)
        companion.wait(10)
    balances, end = companion.newest()["balance"], companion.report()
    removed = round(made.snapshot()[0].removed / companion.quantum)
    exact = all(balance.exact for balance in balances.values()) and balances["dust"].made == removed
    frames, late = end.frames - begin.frames, end.over_budget - begin.over_budget
    return (
        median,
        f"{frames - late} of {frames} frames within 20 ms, with up to {end.parcels_most} parcels",
        f"made = present + sucked + drained in quanta, and dust made = bone removed: {exact}",
    )


def run(seconds: float, parcels: int, *, alone_first: bool) -> str:
    """Lines on the same session without and with effects."""
    alone = run_alone(seconds) if alone_first else None
    median, frames, balances = run_beside(seconds, parcels)
    alone = alone or run_alone(seconds)
    ticks = f"median tick {alone:.1f} us alone, {median:.1f} us beside, {median / alone:.2f} times"
    return f"{frames}\n{ticks}\n{balances}"


if __name__ == "__main__":
    main()
