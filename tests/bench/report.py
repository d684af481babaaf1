"""The table of a run, and its lines."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import tissues

Results = dict[str, Any]  # as in results.json

EXPONENT_FROM = 25.0  # R/voxel


def growth(results: Results, kind: str) -> dict[str, tuple[list[float], list[float]]]:
    """R/voxel and median time [us] of every implementation over the scenes of a kind with R = 5 mm."""
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for scene, row in results["scenes"].items():
        if scene == f"{kind} {row['radius_over_voxel']:g}":
            for name, times in row["implementations"].items():
                x, y = curves.setdefault(name, ([], []))
                x.append(row["radius_over_voxel"])
                y.append(times["median_us"])
    return curves


def exponent(x: list[float], y: list[float], start: float = EXPONENT_FROM) -> float:
    """Slope of log y over log x from `start` on; NaN with fewer than two points."""
    kept = np.log([(a, b) for a, b in zip(x, y, strict=True) if a >= start])
    return float(np.polyfit(*kept.T, 1)[0]) if len(kept) > 1 else float("nan")


def limits(scenes: Results, bandwidth: float, path: str) -> list[Results]:
    """Time to move the bytes of a tick at the memory's bandwidth [GB/s], beside the measured time."""
    rows = []
    for name, one in scenes.items():
        if "bytes_touched" in one:
            limit, median = 1e-3 * one["bytes_touched"] / bandwidth, one["implementations"][path]["median_us"]
            rows.append({"scene": name, "bytes_touched": one["bytes_touched"], "limit_us": limit,
                         "measured_us": median, "measured_over_limit": median / limit, "cpu_path": path})  # fmt: skip
    return rows


def spread(ratio: dict[str, float]) -> str:
    """Median and quartiles, in three digits without exponents."""
    parts = (ratio[name] for name in ("median", "quartile_1", "quartile_3"))
    return "{} [{}, {}]".format(*(f"{part:,.0f}" if part >= 100 else f"{part:.3g}" for part in parts))


def table(results: Results) -> Iterator[str]:
    """Lines for every scene and implementation: times, and ratios with quartiles."""
    reference = results["reference_path"]
    yield f"{'scene':<19} {'implementation':<14} {'median':>10}   {'plain / this':<24} this / {reference}"
    yield f"{'':<34} {'[us]':>10}   {'[quartiles]':<24} [quartiles]"
    for scene, row in results["scenes"].items():
        for name, times in row["implementations"].items():
            yield (
                f"{scene:<19} {name:<14} {times['median_us']:>10.4g}   {spread(times['plain_over_this']):<24} "
                f"{spread(times[f'this_over_{reference}'])}"
            )


def summary(results: Results) -> Iterator[str]:
    """Lines on growth and single measurements."""
    slopes = {name: exponent(x, y) for name, (x, y) in growth(results, "slide").items()}
    if np.isfinite(list(slopes.values())).all():
        yield f"\nCost of a slide ~ (R/voxel)^exponent, fitted from {EXPONENT_FROM:g} on:"
        yield "  " + ", ".join(f"{name} {slope:.2f}" for name, slope in slopes.items())
    yield f"Volume (slide, {results['volume']['cpu_path']}):"
    for side, row in results["volume"]["sides"].items():
        yield (
            f"  {side:>5}^3 {row['core_median_us']:.4g} us, {row['core_over_smallest']['median']:.3f} of the "
            f"smallest; plain {row['plain_median_us']:.4g} us; hierarchy {row['hierarchy_over_voxels']:.4f} byte/voxel"
        )
    yield from tissues.lines(results["tissues"])
    for row in results["limits"]:
        yield (
            f"{row['scene']}: {1e-6 * row['bytes_touched']:.3g} MB a tick, {row['limit_us']:.3g} us at the "
            f"bandwidth; measured {row['measured_us']:.4g} us ({row['cpu_path']}), {row['measured_over_limit']:.2g} times: "
            "arithmetic bounds it (docs/hierarchy.md)"
        )
