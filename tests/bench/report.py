"""Figures against targets, and the table."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import tissues
from measure import Measured

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
LARGEST_HIERARCHY = 0.04  # bytes a voxel
LARGEST_HIERARCHY_WITH_TISSUES = 0.06
#: Largest median cost of a tick with 16 tissues over one with one, distance queries included.
TISSUE_TARGETS = {"bricks": 1.5, "random": 2.0}
LONGEST_OVERHEAD = 2.0  # of a call from Python [us]
LONGEST_SWEEP = 30.0  # [s]
EXPONENT_FROM = 25.0  # R/voxel


@dataclass(frozen=True)
class Target:
    """A figure with its bound."""

    name: str
    measured: float
    bound: float
    at_least: bool
    unit: str

    @property
    def met(self) -> bool:
        return self.measured >= self.bound if self.at_least else self.measured <= self.bound


def growth(found: list[Measured], kind: str) -> dict[str, tuple[list[float], list[float]]]:
    """R/voxel and median time [us] of every implementation over the scenes of a kind with R = 5 mm."""
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for one in found:
        if one.scene.name != f"{kind} {one.scene.resolution:g}":
            continue
        for name in (*one.runs, "plain", "numba", "numpy"):
            x, y = curves.setdefault(name, ([], []))
            x.append(one.scene.resolution)
            y.append(1e6 * one.times(name).median)
    return curves


def exponent(x: list[float], y: list[float], start: float = EXPONENT_FROM) -> float:
    """Slope of log y over log x from `start` on; NaN with fewer than two points."""
    kept = [(a, b) for a, b in zip(x, y, strict=True) if a >= start]
    if len(kept) < 2:
        return float("nan")
    return float(np.polyfit(np.log([a for a, _ in kept]), np.log([b for _, b in kept]), 1)[0])


def targets(found: list[Measured], once: dict[str, Any]) -> list[Target]:
    """All targets that this run has figures for."""
    scenes = {one.scene.name: one for one in found}
    rows = []
    for (slow, fast), bounds in RATIO_TARGETS.items():
        for scene, bound in bounds.items():
            ratio = scenes[scene].ratio(slow, fast) if scene in scenes else np.empty(0)
            if len(ratio):
                rows.append(Target(f"{scene}: {slow} / {fast}", float(np.median(ratio)), bound, True, "1"))
    for scene, bound in TIME_TARGETS.items():
        if scene in scenes and "avx2" in scenes[scene].runs:
            median = 1e6 * scenes[scene].times("avx2").median
            rows.append(Target(f"{scene}: tick on avx2", median, bound, False, "us"))
    for kind, bound in AIR_TARGETS.items():
        x, y = growth(found, kind).get("avx2", ([], []))
        rows += [
            Target(f"{kind} {r:g}: tick on avx2", t, bound, False, "us") for r, t in zip(x, y, strict=True)
        ]
    slope = exponent(*growth(found, "slide").get("avx2", ([], [])))
    if np.isfinite(slope):
        rows.append(
            Target("slide: exponent of the tick on avx2 in R/voxel", slope, LARGEST_EXPONENT, False, "1")
        )
    volumes = once["volume"]["sides"]
    if "1024" in volumes:
        ratio = volumes["1024"]["core_over_smallest"]["median"]
        rows.append(Target("volume 1024^3 / 256^3: time of a tick", ratio, LARGEST_VOLUME_RATIO, False, "1"))
    hierarchy = max(row["hierarchy_over_voxels"] for row in volumes.values())
    rows.append(
        Target("memory of the hierarchy over voxels", hierarchy, LARGEST_HIERARCHY, False, "byte/voxel")
    )
    ratios = tissues.largest_ratios(once["tissues"])
    rows += [
        Target(f"16 tissues over one, {layout}, with distances", ratios[layout], bound, False, "1")
        for layout, bound in TISSUE_TARGETS.items()
    ]
    with_tissues = tissues.largest_hierarchy(once["tissues"])
    rows.append(
        Target("memory of the hierarchy with tissues over voxels", with_tissues, LARGEST_HIERARCHY_WITH_TISSUES, False,
               "byte/voxel")
    )  # fmt: skip
    overhead = once["python_step"]["overhead_us"]
    rows.append(Target("step called from Python, over the tick", overhead, LONGEST_OVERHEAD, False, "us"))
    if len(once["sweep"]["forces_N"]) == 6:
        rows.append(
            Target("sweep of 6 forces x 4, 0.1 mm", once["sweep"]["seconds"], LONGEST_SWEEP, False, "s")
        )
    return rows


def target_rows(rows: list[Target]) -> list[dict[str, Any]]:
    return [{**asdict(row), "met": row.met} for row in rows]


def limits(found: list[Measured], bandwidth: dict[str, float], path: str) -> list[dict[str, Any]]:
    """Time to move the bytes of a tick at the memory's bandwidth, beside the time measured."""
    rate = 1e9 * max(bandwidth["read_GB_per_s"], bandwidth["copy_GB_per_s"])
    rows = []
    for one in found:
        if "bytes_touched" in one.extra:
            limit, median = one.extra["bytes_touched"] / rate, one.times(path).median
            rows.append({"scene": one.scene.name, "bytes_touched": one.extra["bytes_touched"],
                         "limit_us": 1e6 * limit, "measured_us": 1e6 * median, "measured_over_limit": median / limit,
                         "cpu_path": path})  # fmt: skip
    return rows


def number(value: float) -> str:
    """Three digits, no exponent."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def spread(values: np.ndarray) -> str:
    if len(values) == 0:
        return ""
    low, median, high = np.percentile(values, [25, 50, 75])
    return f"{number(median)} [{number(low)}, {number(high)}]"


def table(found: list[Measured], reference: str) -> str:
    """Every scene and implementation, times beside ratios with their quartiles."""
    last = f"this / {reference}"
    lines = [
        f"{'scene':<19} {'implementation':<14} {'median':>10} {'95 %':>10}   {'plain / this':<24} {last}"
    ]
    lines.append(f"{'':<34} {'[us]':>10} {'[us]':>10}   {'[quartiles]':<24} [quartiles]")
    for one in found:
        for i, name in enumerate(one.implementations):
            times = one.times(name)
            against_plain = spread(one.ratio("plain", name)) if name in one.runs else ""
            against_core = spread(one.ratio(name, reference)) if name != reference else "1"
            share = (
                f"  {100 * times.share_interrupted:.0f} % interrupted"
                if times.share_interrupted > 0.05
                else ""
            )
            lines.append(
                f"{one.scene.name if i == 0 else '':<19} {name:<14} {1e6 * times.median:>10.4g} "
                f"{1e6 * times.percentile_95:>10.4g}   {against_plain:<24} {against_core}{share}"
            )
    return "\n".join(lines)


def summary(found: list[Measured], once: dict[str, Any], rows: list[Target], reference: str) -> str:
    """What is measured once, growth and targets, in lines."""
    slopes = {name: exponent(x, y) for name, (x, y) in growth(found, "slide").items()}
    lines = [""]
    if np.isfinite(list(slopes.values())).all():
        lines.append(f"Cost of a slide ~ (R/voxel)^exponent, fitted from {EXPONENT_FROM:g} on:")
        lines.append("  " + ", ".join(f"{name} {slope:.2f}" for name, slope in slopes.items()))
    lines.append(f"Volume (slide, {once['volume']['cpu_path']}):")
    for side, row in once["volume"]["sides"].items():
        lines.append(
            f"  {side:>5}^3 {row['core_median_us']:.4g} us, {row['core_over_smallest']['median']:.3f} of the smallest; "
            f"plain {row['plain_median_us']:.4g} us; hierarchy {row['hierarchy_over_voxels']:.4f} byte/voxel"
        )
    lines += tissues.lines(once["tissues"])
    for row in once["limits"]:
        lines.append(
            f"{row['scene']}: {1e-6 * row['bytes_touched']:.3g} MB a tick, {row['limit_us']:.3g} us at the bandwidth; "
            f"measured {row['measured_us']:.4g} us ({row['cpu_path']}), {row['measured_over_limit']:.2g} times"
        )
    for one in found:
        if "total_s" in one.extra:
            for path, seconds in one.extra["total_s"].items():
                each = one.extra["total_us_per_tick"][path]
                lines.append(
                    f"{one.scene.name}, {path}: {seconds:.3g} s in all, {each:.4g} us a tick with the search for the force"
                )
    call = once["python_step"]
    lines.append(
        f"step from Python: {call['python_step_us']:.3g} us, of which the tick {call['native_step_us']:.3g} us"
    )
    sweep = once["sweep"]
    lines.append(
        f"sweep of {len(sweep['forces_N'])} forces x {sweep['repeats']}, {sweep['voxel_mm']:g} mm, {sweep['workers']} cores: "
        f"{sweep['seconds']:.3g} s; with one worker {sweep['seconds_one_worker']:.3g} s"
    )
    lines += ["", "Targets:"]
    for row in rows:
        sign = ">=" if row.at_least else "<="
        verdict = "met" if row.met else "NOT MET"
        lines.append(f"  {row.name:<50} {row.measured:>9.4g} {sign} {row.bound:<6g} {row.unit:<11} {verdict}")
    return "\n".join(lines)
