"""Measurements made once: volume size, a whole descent, a call from Python, memory bandwidth, a sweep."""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from measure import measure
from native import Core, Native
from scenes import air, descent, volume
from times import in_turns, quartiles

import burrlab

SWEEP_FORCES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  # [N]
FORCE = 1.0  # set-point of the descent [N]


def volume_scaling(native: Native, path: str, quick: bool) -> dict[str, Any]:
    """The same slide in volumes of growing size, in turns: the core on one CPU path, and the plain loop."""
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    wanted = (64, 128) if quick else (256, 512, 1024)
    sides = [side for side in wanted if 6 * side**3 <= free]
    runs: dict[tuple[str, int], Any] = {}
    cores, present = {}, {}
    for side in sides:
        scene = volume(side, quick=quick)
        p = scene.levels()
        cores[side], present[side] = core, q = Core.of(native, p, scene.burring, path), p.copy()
        runs["core", side] = scene.path, lambda _, centers, core=core: core.run(centers)
        runs["plain", side] = (
            scene.path,
            lambda begin, centers, q=q, p=p, b=scene.burring: native.plain_run(q, p, b, begin, centers)[0],
        )
    times = in_turns(runs)
    rows = {}
    for side in sides:
        if not np.array_equal(cores[side].density(), present[side]):
            raise RuntimeError(f"volume {side}: the plain loop left other levels than the core")
        core = times["core", side]
        rows[str(side)] = {
            "voxels": side**3,
            "core_median_us": 1e6 * core.median,
            "core_percentile_95_us": 1e6 * core.percentile_95,
            "core_over_smallest": quartiles(core.over(times["core", sides[0]])),
            "plain_median_us": 1e6 * times["plain", side].median,
            "hierarchy_bytes": cores[side].hierarchy_bytes,
            "hierarchy_over_voxels": cores[side].hierarchy_bytes / side**3,
        }
    return {"cpu_path": path, "radius_over_voxel": scene.resolution, "sides": rows,
            "left_out_for_memory": [side for side in wanted if side not in sides]}  # fmt: skip


def descent_scene(
    native: Native, resolution: float, reference: str, quick: bool
) -> tuple[str, dict[str, Any]]:
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
    return scene.name, measure(native, replace(scene, path=start + first[:, None] * axis), reference) | {
        "force_N": FORCE,
        "total_s": totals,
        "total_us_per_tick": {path: 1e6 * seconds / len(first) for path, seconds in totals.items()},
    }


def python_step(native: Native, quick: bool) -> dict[str, float]:
    """Cost of a call of `step` from Python over the tick itself, in air far from bone."""
    scene = air(5.0, 0.1, near=False, quick=quick)
    b, center = scene.burring, tuple(scene.path[0].tolist())
    path = burrlab._core.cpu_path()
    core = Core.of(native, scene.levels(), b, path)
    bone = burrlab.VoxelBone(scene.levels(), b.spacing)
    contact = burrlab.BurrContact(bone, burrlab.Burr(b.radius), burrlab.materials["bone"], seed=b.seed)
    step, array, calls = contact.step, np.array(center), 1000
    times = []
    for _ in range(10 if quick else 50):
        row = []
        for place in (center, array):
            start = time.perf_counter()
            for _ in range(calls):
                step(place, 1.0)
            row.append((time.perf_counter() - start) / calls)
        times.append([*row, core.run(np.tile(array, (calls, 1)), batch=calls).seconds[0]])
    by_tuple, by_array, tick = (1e6 * np.median(times, axis=0)).tolist()
    return {
        "python_step_us": by_tuple,
        "python_step_array_us": by_array,
        "native_step_us": tick,
        "overhead_us": by_tuple - tick,
        "overhead_array_us": by_array - tick,
    }


def bandwidth(native: Native, quick: bool) -> dict[str, float]:
    """Memory bandwidth of one core; `large_bytes` should exceed the caches."""
    large = 2**25 if quick else 2**29
    return {
        "large_bytes": large,
        "read_GB_per_s": native.bandwidth(large, copy=False),
        "copy_GB_per_s": native.bandwidth(large, copy=True),
        "small_bytes": 2**20,
        "small_copy_GB_per_s": native.bandwidth(2**20, copy=True, repeats=100),
    }


def sweep(quick: bool) -> dict[str, Any]:
    """Seconds of a sweep of voxel descents on all cores, and with one worker."""
    forces, repeats, voxel = ((2.0, 3.0), 1, 0.2) if quick else (SWEEP_FORCES, 4, 0.1)

    def run(executor: ThreadPoolExecutor | None) -> tuple[float, burrlab.VelocityCurve]:
        tool, start = (burrlab.Burr(3.0), burrlab.materials["bone"]), time.perf_counter()
        curve = burrlab.force_sweep(*tool, forces, repeats=repeats, voxel=voxel, seed=1, executor=executor)
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
