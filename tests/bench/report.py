"""Measured values against targets, and the table."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import tissues

Results = dict[str, Any]  # as in results.json

#: Least ratio of the time of a baseline to that of a CPU path (medians, side by side), by scene.
RATIO_TARGETS = {
    ("plain", "avx2"): {"slide 50": 25.0, "slide 12.5 R 2.5": 14.0, "buried 50": 20.0},
    ("plain", "avx512"): {"slide 50": 35.0, "slide 12.5 R 2.5": 17.0, "buried 50": 28.0},
    ("plain", "portable"): {"slide 50": 15.0, "slide 12.5 R 2.5": 8.0, "buried 50": 10.0},
    ("numba", "avx2"): {"slide 50": 30.0, "slide 12.5 R 2.5": 18.0, "buried 50": 22.0},
}
#: Longest median of a tick on AVX2 [us].
TIME_TARGETS = {"slide 50": 65.0, "slide 12.5 R 2.5": 3.0, "buried 50": 650.0}
#: Longest median of a tick in air on AVX2, at every R/voxel [us].
AIR_TARGETS = {"air far": 0.5, "air near": 6.0}
LARGEST_EXPONENT = 2.4  # of the cost of a slide against R/voxel, 25 to 100
LARGEST_VOLUME_RATIO = 1.1  # cost in the largest volume over that in the smallest
LARGEST_HIERARCHY = 0.04  # bytes per voxel
LARGEST_HIERARCHY_WITH_TISSUES = 0.06
#: Largest median cost of a tick with 16 tissues over one with one, distance queries included.
TISSUE_TARGETS = {"bricks": 1.5, "random": 2.0}
LONGEST_OVERHEAD = 2.0  # of a call from Python [us]
LONGEST_SWEEP = 30.0  # [s]
EXPONENT_FROM = 25.0  # R/voxel


def growth(results: Results, kind: str) -> dict[str, tuple[list[float], list[float]]]:
    """R/voxel and median time [us] of every implementation over the scenes of a kind with R = 5 mm."""
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for scene, row in results["scenes"].items():
        if scene == f"{kind} {row['radius_over_voxel']:g}":
            for name, one in row["implementations"].items():
                if " " not in name:  # no pass of a split tick
                    x, y = curves.setdefault(name, ([], []))
                    x.append(row["radius_over_voxel"])
                    y.append(one["median_us"])
    return curves


def exponent(x: list[float], y: list[float], start: float = EXPONENT_FROM) -> float:
    """Slope of log y over log x from `start` on; NaN with fewer than two points."""
    kept = np.log([(a, b) for a, b in zip(x, y, strict=True) if a >= start])
    return float(np.polyfit(*kept.T, 1)[0]) if len(kept) > 1 else float("nan")


def targets(results: Results) -> list[Results]:
    """All targets that this run has measured."""
    scenes = {name: one["implementations"] for name, one in results["scenes"].items()}
    rows: list[Results] = []

    def bound(name: str, measured: float, limit: float, unit: str = "1", at_least: bool = False) -> None:
        met = measured >= limit if at_least else measured <= limit
        row = {"name": name, "measured": measured, "bound": limit, "at_least": at_least, "unit": unit}
        rows.append({**row, "met": met})

    for (slow, fast), bounds in RATIO_TARGETS.items():
        name, ratio = (fast, "plain_over_this") if slow == "plain" else (slow, f"this_over_{fast}")
        for scene, limit in bounds.items():
            if found := scenes.get(scene, {}).get(name, {}).get(ratio):
                bound(f"{scene}: {slow} / {fast}", found["median"], limit, at_least=True)
    for scene, limit in TIME_TARGETS.items():
        if "avx2" in scenes.get(scene, {}):
            bound(f"{scene}: tick on avx2", scenes[scene]["avx2"]["median_us"], limit, "us")
    for kind, limit in AIR_TARGETS.items():
        for r, median in zip(*growth(results, kind).get("avx2", ((), ())), strict=True):
            bound(f"{kind} {r:g}: tick on avx2", median, limit, "us")
    slope = exponent(*growth(results, "slide").get("avx2", ([], [])))
    if np.isfinite(slope):
        bound("slide: exponent of the tick on avx2 in R/voxel", slope, LARGEST_EXPONENT)
    volumes = results["volume"]["sides"]
    if "1024" in volumes:
        ratio = volumes["1024"]["core_over_smallest"]["median"]
        bound("volume 1024^3 / 256^3: time of a tick", ratio, LARGEST_VOLUME_RATIO)
    hierarchy = max(row["hierarchy_over_voxels"] for row in volumes.values())
    bound("memory of the hierarchy over voxels", hierarchy, LARGEST_HIERARCHY, "byte/voxel")
    cost = list(tissues.rows_of(results["tissues"]))
    for layout, limit in TISSUE_TARGETS.items():
        medians = [row["over_one"]["median"] for *_, name, row in cost if name == f"{layout} watched"]
        bound(f"16 tissues over one, {layout}, with distances", max(medians), limit)
    hierarchy, limit = max(row["hierarchy_over_voxels"] for *_, row in cost), LARGEST_HIERARCHY_WITH_TISSUES
    bound("memory of the hierarchy with tissues over voxels", hierarchy, limit, "byte/voxel")
    overhead = results["python_step"]["overhead_us"]
    bound("step called from Python, over the tick", overhead, LONGEST_OVERHEAD, "us")
    if len(results["sweep"]["forces_N"]) == 6:
        bound("sweep of 6 forces x 4, 0.1 mm", results["sweep"]["seconds"], LONGEST_SWEEP, "s")
    return rows


def limits(scenes: Results, bandwidth: dict[str, float], path: str) -> list[Results]:
    """Time to move the bytes of a tick at the memory's bandwidth, beside the measured time."""
    rate = 1e9 * max(bandwidth["read_GB_per_s"], bandwidth["copy_GB_per_s"])
    rows = []
    for name, one in scenes.items():
        if "bytes_touched" in one:
            limit, median = 1e6 * one["bytes_touched"] / rate, one["implementations"][path]["median_us"]
            rows.append({"scene": name, "bytes_touched": one["bytes_touched"], "limit_us": limit,
                         "measured_us": median, "measured_over_limit": median / limit, "cpu_path": path})  # fmt: skip
    return rows


def spread(ratio: dict[str, float] | None) -> str:
    """Median and quartiles, in three digits without exponents."""
    if ratio is None:
        return ""
    names = ("median", "quartile_1", "quartile_3")
    texts = [f"{ratio[k]:,.0f}" if ratio[k] >= 100 else f"{ratio[k]:.3g}" for k in names]
    return "{} [{}, {}]".format(*texts)


def table(results: Results) -> Iterator[str]:
    """Lines for every scene and implementation: times, and ratios with quartiles."""
    reference = results["reference_path"]
    last = f"this / {reference}"
    yield f"{'scene':<19} {'implementation':<14} {'median':>10} {'95 %':>10}   {'plain / this':<24} {last}"
    yield f"{'':<34} {'[us]':>10} {'[us]':>10}   {'[quartiles]':<24} [quartiles]"
    for scene, row in results["scenes"].items():
        for name, one in row["implementations"].items():
            against_core = spread(one[f"this_over_{reference}"]) if name != reference else "1"
            share = 100 * one["share_interrupted"]
            yield (
                f"{scene:<19} {name:<14} {one['median_us']:>10.4g} {one['percentile_95_us']:>10.4g}   "
                f"{spread(one['plain_over_this']):<24} {against_core}"
                + (f"  {share:.0f} % interrupted" if share > 5 else "")
            )
            scene = ""


def summary(results: Results) -> Iterator[str]:
    """Lines on growth, single measurements and targets."""
    slopes = {name: exponent(x, y) for name, (x, y) in growth(results, "slide").items()}
    yield ""
    if np.isfinite(list(slopes.values())).all():
        yield f"Cost of a slide ~ (R/voxel)^exponent, fitted from {EXPONENT_FROM:g} on:"
        yield "  " + ", ".join(f"{name} {slope:.2f}" for name, slope in slopes.items())
    yield f"Volume (slide, {results['volume']['cpu_path']}):"
    for side, row in results["volume"]["sides"].items():
        yield (
            f"  {side:>5}^3 {row['core_median_us']:.4g} us, {row['core_over_smallest']['median']:.3f} of the "
            "smallest; plain "
            f"{row['plain_median_us']:.4g} us; hierarchy {row['hierarchy_over_voxels']:.4f} byte/voxel"
        )
    yield from tissues.lines(results["tissues"])
    for row in results["limits"]:
        yield (
            f"{row['scene']}: {1e-6 * row['bytes_touched']:.3g} MB a tick, {row['limit_us']:.3g} us at the "
            "bandwidth; measured "
            f"{row['measured_us']:.4g} us ({row['cpu_path']}), {row['measured_over_limit']:.2g} times"
        )
    for scene, row in results["scenes"].items():
        for path, seconds in row.get("total_s", {}).items():
            each = row["total_us_per_tick"][path]
            yield f"{scene}, {path}: {seconds:.3g} s in all, {each:.4g} us a tick with the search for the force"
    call, sweep = results["python_step"], results["sweep"]
    yield (
        f"step from Python: {call['python_step_us']:.3g} us, of which the tick "
        f"{call['native_step_us']:.3g} us"
    )
    yield (
        f"sweep of {len(sweep['forces_N'])} forces x {sweep['repeats']}, {sweep['voxel_mm']:g} mm, "
        f"{sweep['workers']} cores: "
        f"{sweep['seconds']:.3g} s; with one worker {sweep['seconds_one_worker']:.3g} s"
    )
    yield from ("", "Targets:")
    for row in results["targets"]:
        sign, verdict = ">=" if row["at_least"] else "<=", "met" if row["met"] else "NOT MET"
        yield f"  {row['name']:<50} {row['measured']:>9.4g} {sign} {row['bound']:<6g} {row['unit']:<11} {verdict}"
