"""What is measured once: volume size, a whole descent, a call from Python, memory bandwidth, a sweep."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from measure import Measured, measure
from native import Core, Native
from scenes import air, descent, volume
from times import Times, quartiles

import burrlab

SWEEP_FORCES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  # [N]
CHUNK = 25  # ticks of one volume before the next one's turn
FORCE = 1.0  # of the descent [N]


def volume_scaling(native: Native, path: str, quick: bool) -> dict[str, Any]:
    """The same slide in volumes of growing size, in turns; core on one CPU path, and the plain loop."""
    sides = (64, 128) if quick else (256, 512, 1024)
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    left_out = [side for side in sides if 6 * side**3 > free]
    sides = tuple(side for side in sides if side not in left_out)
    scenes = {side: volume(side, quick=quick) for side in sides}
    pristine = {side: scene.levels() for side, scene in scenes.items()}
    cores = {side: Core.of(native, pristine[side], scene.burring, path) for side, scene in scenes.items()}
    present = {side: p.copy() for side, p in pristine.items()}
    core_times: dict[int, list[Times]] = {side: [] for side in sides}
    plain_times: dict[int, list[Times]] = {side: [] for side in sides}
    ticks = len(scenes[sides[0]].path)
    for begin in range(0, ticks, CHUNK):
        for side, scene in scenes.items():
            centers = scene.path[begin : begin + CHUNK]
            core_times[side].append(cores[side].run(centers))
            plain_times[side].append(
                native.plain_run(present[side], pristine[side], scene.burring, begin, centers)[0]
            )
    for side in sides:
        if not np.array_equal(cores[side].density(), present[side]):
            raise RuntimeError(f"volume {side}: the plain loop left other levels than the core")
    first = ticks // 10
    rows = {}
    smallest = Times.join(core_times[sides[0]])[first:]
    for side in sides:
        core, plain = (Times.join(t[side])[first:] for t in (core_times, plain_times))
        rows[str(side)] = {
            "voxels": side**3,
            "core_median_us": 1e6 * core.median,
            "core_percentile_95_us": 1e6 * core.percentile_95,
            "core_over_smallest": quartiles(core.over(smallest)),
            "plain_median_us": 1e6 * plain.median,
            "hierarchy_bytes": cores[side].hierarchy_bytes,
            "hierarchy_over_voxels": cores[side].hierarchy_bytes / side**3,
        }
    return {"cpu_path": path, "radius_over_voxel": scenes[sides[0]].resolution, "sides": rows,
            "left_out_for_memory": left_out}  # fmt: skip


def descent_scene(native: Native, resolution: float, quick: bool) -> Measured:
    """A whole descent at held force on every CPU path; then its path replayed, baselines beside it."""
    scene, start, axis = descent(resolution, quick=quick)
    limit, travel = 200_000, scene.burring.radius / 3
    totals, positions = {}, {}
    p = scene.levels()
    for path in native.cpu_paths:
        core = Core.of(native, p, scene.burring, path)
        positions[path], totals[path] = core.hold(FORCE, start, axis, begin=0.0, travel=travel, ticks=limit)
    first = positions[native.cpu_paths[-1]]
    if not all(np.array_equal(first, own) for own in positions.values()):
        raise RuntimeError(f"{scene.name}: the CPU paths took different ways")
    found = measure(native, replace(scene, path=start + first[:, None] * axis))
    found.extra |= {
        "force_N": FORCE,
        "total_s": totals,
        "total_us_per_tick": {path: 1e6 * seconds / len(first) for path, seconds in totals.items()},
    }
    return found


def python_step(native: Native, quick: bool) -> dict[str, float]:
    """What a call of `step` from Python costs over the tick itself; air, far from bone."""
    scene = air(5.0, 0.1, near=False, quick=quick)
    b, center = scene.burring, tuple(scene.path[0].tolist())
    path = burrlab._core.cpu_path()
    core = Core.of(native, scene.levels(), b, path)
    bone = burrlab.VoxelBone(scene.levels(), b.spacing)
    contact = burrlab.BurrContact(bone, burrlab.Burr(b.radius), burrlab.materials["bone"], seed=b.seed)
    step, calls, python, native_ = contact.step, 1000, [], []
    array = np.array(center)
    by_array = []
    for _ in range(10 if quick else 50):
        start = time.perf_counter()
        for _ in range(calls):
            step(center, 1.0)
        python.append((time.perf_counter() - start) / calls)
        start = time.perf_counter()
        for _ in range(calls):
            step(array, 1.0)
        by_array.append((time.perf_counter() - start) / calls)
        native_.append(core.run(np.tile(array, (calls, 1)), batch=calls).seconds[0])
    tick = float(np.median(native_))
    return {
        "python_step_us": 1e6 * float(np.median(python)),
        "python_step_array_us": 1e6 * float(np.median(by_array)),
        "native_step_us": 1e6 * tick,
        "overhead_us": 1e6 * (float(np.median(python)) - tick),
        "overhead_array_us": 1e6 * (float(np.median(by_array)) - tick),
    }


def bandwidth(native: Native, quick: bool) -> dict[str, float]:
    """Of one core, memory beyond the caches as far as `large_bytes` leaves them."""
    large = 2**25 if quick else 2**29
    return {
        "large_bytes": large,
        "read_GB_per_s": 1e-9 * native.bandwidth(large, copy=False),
        "copy_GB_per_s": 1e-9 * native.bandwidth(large, copy=True),
        "small_bytes": 2**20,
        "small_copy_GB_per_s": 1e-9 * native.bandwidth(2**20, copy=True, repeats=100),
    }


def sweep(quick: bool) -> dict[str, Any]:
    """Seconds of a sweep of voxel descents on all cores of this machine, and with one worker."""
    forces, repeats, voxel = ((2.0, 3.0), 1, 0.2) if quick else (SWEEP_FORCES, 4, 0.1)

    def run(executor: ThreadPoolExecutor | None) -> tuple[float, burrlab.VelocityCurve]:
        start = time.perf_counter()
        curve = burrlab.force_sweep(
            burrlab.Burr(3.0),
            burrlab.materials["bone"],
            forces,
            repeats=repeats,
            voxel=voxel,
            seed=1,
            executor=executor,
        )
        return time.perf_counter() - start, curve

    with ThreadPoolExecutor(1) as one:
        alone, single = run(one)
    seconds, curve = run(None)
    if not np.array_equal(single.velocity, curve.velocity, equal_nan=True):
        raise RuntimeError("the sweep depends on the number of workers")
    return {
        "seconds": seconds,
        "seconds_one_worker": alone,
        "forces_N": list(forces),
        "repeats": repeats,
        "voxel_mm": voxel,
        "radius_mm": 3.0,
        "ticks": "force held exactly, dt 1 ms",
        "workers": os.cpu_count(),
        "status": sorted(set(curve.status)),
    }
