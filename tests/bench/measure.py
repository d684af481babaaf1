"""Times of scenes: the core on every CPU path over all ticks, the baselines at samples of the run."""

import time
from typing import Any

import numba_tick
import numpy as np
from native import ERODE, FUSED, PROBE, SPLIT, Burring, Core, Levels, Native
from scenes import Scene
from times import Numbers, Times, quartiles

from reference import tick as reference

WARM_UP = 0.1  # first part of a run, not counted
BASELINES = ("plain", "numba")
HALVES = {"split": SPLIT, "probe": PROBE, "erode": ERODE}


def core_ticks(core: Core, scene: Scene, centers: Numbers, how: int = FUSED) -> Times:
    return core.run_fresh(centers, how) if scene.fresh else core.run(centers, how=how, batch=scene.batch)


def baseline_ticks(
    native: Native, scene: Scene, name: str, q: Levels, p: Levels, first: int, centers: Numbers
) -> Times:
    """Times of the plain loop or Numba; erodes `q`."""
    times = []
    for tick, center in enumerate(centers, first):
        if scene.fresh:
            q[...] = p
        if name == "plain":
            times.append(native.plain_run(q, p, scene.burring, tick, center[None])[0])
            continue
        arguments = scene.burring.arguments(tick, native.depth_table, center)
        before, start = native.library.bench_interruptions(), time.perf_counter()
        numba_tick.step(q, p, *arguments)
        seconds = time.perf_counter() - start
        interrupted = native.library.bench_interruptions() != before
        times.append(Times(np.array([seconds]), np.array([interrupted])))
    return Times.join(times)


def compare(
    native: Native, scene: Scene, main: Core, p: Levels, tick: int, passes: str | None
) -> dict[str, Times]:
    """Times of the same ticks by all implementations; RuntimeError if the final levels differ."""
    centers = scene.path[tick : tick + scene.effort.burst]
    many = np.repeat(centers, scene.batch, axis=0)  # only scenes in air, which stay the same, have a batch
    ways = {path: (path, FUSED) for path in native.cpu_paths}
    if passes is not None:
        ways |= {f"{passes} {name}": (passes, how) for name, how in HALVES.items()}
    times, levels = {}, {}
    for name, (path, how) in ways.items():
        core = main.clone(path)
        times[name] = core_ticks(core, scene, many, how)
        if how in (FUSED, SPLIT):  # a half leaves other levels
            levels[name] = core.density()
    for name in BASELINES:
        levels[name] = main.density()
        times[name] = baseline_ticks(native, scene, name, levels[name], p, tick, centers)
    for name, own in levels.items():
        if not np.array_equal(own, levels[native.cpu_paths[0]]):
            raise RuntimeError(f"{scene.name}: {name} left other levels than the core")
    return times


def measure(native: Native, scene: Scene, reference: str, *, passes: str | None = None) -> dict[str, Any]:
    """Times of one scene, for results.json; `passes` names a CPU path whose split tick is timed too."""
    p, effort = scene.levels(), scene.effort
    cores = {path: Core.of(native, p, scene.burring, path) for path in native.cpu_paths}
    main = cores[native.cpu_paths[-1]]
    first, last = int(WARM_UP * len(scene.path)) // scene.batch * scene.batch, len(scene.path) - effort.burst
    samples = np.unique(np.linspace(first, last, effort.samples).astype(int) // scene.batch * scene.batch)
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
        for name, times in compare(native, scene, main, p, sample, passes).items():
            bursts.setdefault(name, []).append(times[effort.warm :])
        if passes is not None:
            q = p if scene.fresh else main.density()
            touched.append(touched_bytes(q, p, scene.burring, scene.path[sample]))
    if len({core.digest for core in cores.values()}) != 1:
        raise RuntimeError(f"{scene.name}: the CPU paths left different bones")
    whole = {path: Times.join(parts)[first // scene.batch :] for path, parts in runs.items()}
    found = summary(scene, whole, {name: Times.join(parts) for name, parts in bursts.items()}, reference)
    return found | ({"bytes_touched": float(np.mean(touched))} if touched else {})


def summary(scene: Scene, runs: dict[str, Times], bursts: dict[str, Times], reference: str) -> dict[str, Any]:
    """Medians and 95th percentiles of the run, or of the samples; tick-by-tick ratios with quartiles.

    CPU paths come first, then baselines, then the passes of a split tick.
    """
    rows: dict[str, Any] = {}
    for name in dict.fromkeys((*runs, *BASELINES, *bursts)):
        if not bursts[name].made.any():
            continue
        times = runs.get(name, bursts[name])
        rows[name] = {
            "median_us": 1e6 * times.median,
            "percentile_95_us": 1e6 * times.percentile_95,
            "ticks": int(times.made.sum()) * (scene.batch if name in runs else 1),
            "share_interrupted": times.share_interrupted,
            "plain_over_this": quartiles(bursts["plain"].over(bursts[name])) if name in runs else None,
            f"this_over_{reference}": quartiles(bursts[name].over(bursts[reference])),
        }
    s, b = scene, scene.burring
    return {
        "about": s.about, "radius_mm": b.radius, "voxel_mm": b.spacing, "radius_over_voxel": s.resolution,
        "scheme": b.scheme, "volume_zyx": list(s.shape), "path_ticks": len(s.path), "implementations": rows,
    }  # fmt: skip


def touched_bytes(q: Levels, p: Levels, b: Burring, center: Numbers) -> int:
    """Bytes that a tick moves: q of every voxel with mass is read and written, p is read if not deep."""
    at = reference.geometry(center, b.radius, q.shape, (b.spacing,) * 3, b.origin)
    held = reference.mass(q, p, at.coverage, b.scheme) > 0
    return int(2 * held.sum() + (held & ~at.deep).sum())
