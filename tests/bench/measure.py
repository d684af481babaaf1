"""Scenes timed: the core on every CPU path over all ticks, the baselines beside it at samples of the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numba_tick
import numpy as np
import numpy_tick
from native import ERODE, FUSED, PROBE, SPLIT, Burring, Core, Levels, Native
from scenes import Scene
from times import Numbers, Times, quartiles

WARM_UP = 0.1  # part of a run that is not counted
BASELINES = ("plain", "numba", "numpy")
Burst = Callable[[Numbers], tuple[Times, Levels]]  # times of the ticks, and the levels after the last


@dataclass
class Measured:
    """Times of a scene.

    Parameters
    ----------
    scene : Scene
    runs : dict
        Over the whole run, by CPU path.
    bursts : dict
        At the samples, by implementation; tick by tick side by side.
    extra : dict
        Figures of this scene alone.
    """

    scene: Scene
    runs: dict[str, Times] = field(default_factory=dict)
    bursts: dict[str, Times] = field(default_factory=dict)
    extra: dict[str, Any] = field(default_factory=dict)

    def ratio(self, slow: str, fast: str) -> Numbers:
        """Of the times of ticks measured side by side."""
        if slow not in self.bursts or fast not in self.bursts:
            return np.empty(0)
        return self.bursts[slow].over(self.bursts[fast])

    def times(self, name: str) -> Times:
        """All that was measured of one implementation."""
        return self.runs[name] if name in self.runs else self.bursts[name]

    @property
    def implementations(self) -> list[str]:
        """CPU paths, baselines, then the passes of a split tick."""
        names = dict.fromkeys((*self.runs, *BASELINES, *self.bursts))
        return [name for name in names if name in self.bursts and self.bursts[name].made.any()]

    def summary(self, reference: str) -> dict[str, Any]:
        """Medians, 95th percentiles and ratios with quartiles, for results.json."""
        rows: dict[str, Any] = {}
        for name in self.implementations:
            times = self.times(name)
            rows[name] = {
                "median_us": 1e6 * times.median,
                "percentile_95_us": 1e6 * times.percentile_95,
                "ticks": int(times.made.sum()) * (self.scene.batch if name in self.runs else 1),
                "share_interrupted": times.share_interrupted,
                "plain_over_this": quartiles(self.ratio("plain", name)) if name in self.runs else None,
                f"this_over_{reference}": quartiles(self.ratio(name, reference)),
            }
        s, b = self.scene, self.scene.burring
        return {
            "about": s.about, "radius_mm": b.radius, "voxel_mm": b.spacing, "radius_over_voxel": s.resolution,
            "scheme": b.scheme, "volume_zyx": list(s.shape), "path_ticks": len(s.path),
            "implementations": rows, **self.extra,
        }  # fmt: skip


# --- One burst of each implementation, from the same state ------------------------------------------------


def core_burst(core: Core, scene: Scene, how: int = FUSED) -> Burst:
    def burst(centers: Numbers) -> tuple[Times, Levels]:
        if scene.fresh:
            return run_fresh(core, centers, how), core.density()
        many = np.repeat(
            centers, scene.batch, axis=0
        )  # a batch of more than one is for air, which nothing changes
        return core.run(many, how=how, batch=scene.batch), core.density()

    return burst


def run_fresh(core: Core, centers: Numbers, how: int = FUSED) -> Times:
    """Ticks that each meet the bone as loaded."""
    times = []
    for center in centers:
        core.reset()
        times.append(core.run(center[None], how=how))
    return Times.join(times)


def dense_burst(
    step: Callable[[Levels, int, Numbers], Times], q: Levels, p: Levels, tick: int, fresh: bool
) -> Burst:
    def burst(centers: Numbers) -> tuple[Times, Levels]:
        times = []
        for i, center in enumerate(centers):
            if fresh:
                q[...] = p
            times.append(step(q, tick + i, center))
        return Times.join(times), q

    return burst


def baseline_bursts(
    native: Native, scene: Scene, q: Levels, p: Levels, tick: int, names: Sequence[str]
) -> dict[str, Burst]:
    b, table = scene.burring, native.depth_table

    def plain(levels: Levels, tick: int, center: Numbers) -> Times:
        return native.plain_run(levels, p, b, tick, center[None])[0]

    def by(step: Callable[..., object]) -> Callable[[Levels, int, Numbers], Times]:
        def timed(levels: Levels, tick: int, center: Numbers) -> Times:
            at = tuple(center.tolist())
            before, start = native.interruptions(), time.perf_counter()
            step(levels, p, b.spacing, b.origin, b.radius, b.scheme == "layer", b.alpha * b.dt, b.seed, 0, tick,
                 table, at)  # fmt: skip
            seconds = time.perf_counter() - start
            return Times(np.array([seconds]), np.array([native.interruptions() != before]))

        return timed

    steps = {"plain": plain, "numba": by(numba_tick.step), "numpy": by(numpy_tick.step)}
    return {name: dense_burst(steps[name], q.copy(), p, tick, scene.fresh) for name in names}


def compare(native: Native, scene: Scene, main: Core, p: Levels, centers: Numbers, baselines: Sequence[str],
            passes: str | None) -> dict[str, Numbers]:  # fmt: skip
    """Times of the same ticks by everyone; RuntimeError if the levels differ in the end."""
    bursts = {path: core_burst(main.clone(path), scene) for path in native.cpu_paths}
    if passes is not None:
        bursts[f"{passes} split"] = core_burst(main.clone(passes), scene, SPLIT)
    bursts |= baseline_bursts(native, scene, main.density(), p, main.tick, baselines)
    times: dict[str, Times] = {}
    levels: Levels | None = None
    for name, burst in bursts.items():
        times[name], own = burst(centers)
        if levels is None:
            levels = own
        elif not np.array_equal(own, levels):
            raise RuntimeError(f"{scene.name}: {name} left other levels than the core")
    if (
        passes is not None
    ):  # halves of the split tick; the levels are the same as long as nothing but one half runs
        for name, how in (("probe", PROBE), ("erode", ERODE)):
            times[f"{passes} {name}"] = core_burst(main.clone(passes), scene, how)(centers)[0]
    return times


# --- A scene ----------------------------------------------------------------------------------------------


def measure(native: Native, scene: Scene, *, passes: str | None = None) -> Measured:
    """Times one scene; `passes` names a CPU path whose split tick is timed too."""
    p, effort = scene.levels(), scene.effort
    cores = {path: Core.of(native, p, scene.burring, path) for path in native.cpu_paths}
    first = int(WARM_UP * len(scene.path)) // scene.batch * scene.batch
    last = len(scene.path) - effort.burst
    samples = np.unique(np.linspace(first, last, effort.samples).astype(int) // scene.batch * scene.batch)
    for_numpy = set(samples[np.linspace(0, len(samples) - 1, effort.numpy_samples).astype(int)].tolist())
    runs: dict[str, list[Times]] = {path: [] for path in cores}
    bursts: dict[str, list[Times]] = {}
    touched: list[int] = []
    done = 0
    for sample in [*samples.tolist(), len(scene.path)]:
        for path, core in cores.items():
            runs[path].append(run_segment(core, scene, done, sample))
        done = sample
        if sample == len(scene.path):
            break
        main = cores[native.cpu_paths[-1]]
        centers = scene.path[sample : sample + effort.burst]
        names = [name for name in BASELINES if name != "numpy" or sample in for_numpy]
        times = compare(native, scene, main, p, centers, names, passes)
        for name in dict.fromkeys((*times, "numpy")):
            bursts.setdefault(name, []).append(times.get(name, Times.empty(effort.burst))[effort.warm :])
        if passes is not None:
            q = p if scene.fresh else main.density()
            touched.append(touched_bytes(q, p, scene.burring, centers[0], native))
    if len({core.digest for core in cores.values()}) != 1:
        raise RuntimeError(f"{scene.name}: the CPU paths left different bones")
    found = Measured(scene)
    found.runs = {path: Times.join(parts)[first // scene.batch :] for path, parts in runs.items()}
    found.bursts = {name: Times.join(parts) for name, parts in bursts.items()}
    if touched:
        found.extra["bytes_touched"] = float(np.mean(touched))
    return found


def run_segment(core: Core, scene: Scene, begin: int, end: int) -> Times:
    centers = scene.path[begin:end]
    return run_fresh(core, centers) if scene.fresh else core.run(centers, batch=scene.batch)


def touched_bytes(q: Levels, p: Levels, burring: Burring, center: Numbers, native: Native) -> int:
    """Bytes that a tick has to move: q of every voxel with mass read and written, p read but where it is deep."""
    b = burring
    _, (z, y, x), r2 = numpy_tick.select(q, b.spacing, b.origin, b.radius, tuple(center.tolist()))
    level = q[z, y, x].astype(np.int64)
    mass, _ = numpy_tick.mass_and_shape(
        level, p[z, y, x], r2, b.radius, b.spacing, b.scheme == "layer", native.depth_table
    )
    deep = r2 <= (b.radius - 3.5 * b.spacing) ** 2
    held = mass > 0
    return int(2 * held.sum() + (held & ~deep).sum())
