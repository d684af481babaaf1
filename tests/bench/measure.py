"""Times of scenes: the core on every CPU path over all ticks, the plain loop at samples of the run."""

import os
from typing import Any

import numpy as np
from native import Burring, Core, Levels, Native
from scenes import Scene, volume
from times import Numbers, Times, in_turns, quartiles

from reference import tick as reference

WARM_UP = 0.1  # first part of a run, not counted


def core_ticks(core: Core, scene: Scene, centers: Numbers) -> Times:
    return core.run_fresh(centers) if scene.fresh else core.run(centers, batch=scene.batch)


def plain_ticks(native: Native, scene: Scene, q: Levels, p: Levels, first: int, centers: Numbers) -> Times:
    """Times of the plain loop; erodes `q`."""
    times = []
    for tick, center in enumerate(centers, first):
        if scene.fresh:
            q[...] = p
        times.append(native.plain_run(q, p, scene.burring, tick, center[None])[0])
    return Times.join(times)


def compare(native: Native, scene: Scene, main: Core, p: Levels, tick: int) -> dict[str, Times]:
    """Times of the same ticks by all implementations; RuntimeError if the final levels differ."""
    centers = scene.path[tick : tick + scene.burst]
    many = np.repeat(centers, scene.batch, axis=0)  # only scenes in air, which stay the same, have a batch
    times, levels = {}, {}
    for path in native.cpu_paths:
        core = main.clone(path)
        times[path], levels[path] = core_ticks(core, scene, many), core.density()
    levels["plain"] = main.density()
    times["plain"] = plain_ticks(native, scene, levels["plain"], p, tick, centers)
    for name in levels:
        if not np.array_equal(levels[name], levels[native.cpu_paths[0]]):
            raise RuntimeError(f"{scene.name}: {name} left other levels than the core")
    return times


def measure(native: Native, scene: Scene, reference: str, *, weighed: bool) -> dict[str, Any]:
    """Times of one scene, for results.json; with the bytes that a tick moves, if `weighed`."""
    p = scene.levels()
    cores = {path: Core.of(native, p, scene.burring, path) for path in native.cpu_paths}
    main = cores[native.cpu_paths[-1]]
    first, last = int(WARM_UP * len(scene.path)) // scene.batch * scene.batch, len(scene.path) - scene.burst
    samples = np.unique(np.linspace(first, last, scene.samples).astype(int) // scene.batch * scene.batch)
    runs: dict[str, list[Times]] = {path: [] for path in cores}
    bursts: dict[str, list[Times]] = {}
    touched: list[int] = []
    done = 0
    for sample in [*samples.tolist(), len(scene.path)]:
        for path, core in cores.items():
            runs[path].append(core_ticks(core, scene, scene.path[done:sample]))
        done = sample
        if sample == len(scene.path):
            break
        for name, times in compare(native, scene, main, p, sample).items():
            bursts.setdefault(name, []).append(times[scene.burst // 2 :])  # caches and branches settle first
        if weighed:
            present = p if scene.fresh else main.density()
            touched.append(touched_bytes(present, p, scene.burring, scene.path[sample]))
    if len({core.digest for core in cores.values()}) != 1:
        raise RuntimeError(f"{scene.name}: the CPU paths left different bones")
    whole = {path: Times.join(parts)[first // scene.batch :] for path, parts in runs.items()}
    found = summary(scene, whole, {name: Times.join(parts) for name, parts in bursts.items()}, reference)
    return found | ({"bytes_touched": float(np.mean(touched))} if touched else {})


def summary(scene: Scene, runs: dict[str, Times], bursts: dict[str, Times], reference: str) -> dict[str, Any]:
    """Medians of the run, of the plain loop over the samples; tick-by-tick ratios with quartiles."""
    rows = {
        name: {
            "median_us": 1e6 * runs.get(name, bursts[name]).median,
            "plain_over_this": quartiles(bursts["plain"].over(bursts[name])),
            f"this_over_{reference}": quartiles(bursts[name].over(bursts[reference])),
        }
        for name in (*runs, "plain")
    }
    burring = scene.burring
    return {
        "about": scene.about, "radius_mm": burring.radius, "voxel_mm": burring.spacing,
        "radius_over_voxel": scene.resolution, "volume_zyx": list(scene.shape), "path_ticks": len(scene.path),
        "implementations": rows,
    }  # fmt: skip


def touched_bytes(q: Levels, p: Levels, b: Burring, center: Numbers) -> int:
    """Bytes that a tick moves: q of every voxel with mass is read and written, p is read if not deep."""
    at = reference.geometry(center, b.radius, q.shape, (b.spacing,) * 3, b.origin)
    held = reference.mass(q, p, at.coverage, b.scheme) > 0
    return int(2 * held.sum() + (held & ~at.deep).sum())


def volume_scaling(native: Native, path: str, quick: bool) -> dict[str, Any]:
    """The same slide in volumes of growing size, in turns: the core on one CPU path, and the plain loop."""
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    sides = [side for side in ((64, 128) if quick else (256, 512, 1024)) if 6 * side**3 <= free]
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
        rows[str(side)] = {
            "core_median_us": 1e6 * times["core", side].median,
            "core_over_smallest": quartiles(times["core", side].over(times["core", sides[0]])),
            "plain_median_us": 1e6 * times["plain", side].median,
            "hierarchy_over_voxels": cores[side].hierarchy_bytes / side**3,
        }
    return {"cpu_path": path, "radius_over_voxel": scene.resolution, "sides": rows}
