"""Cost of a tick in a bone with tissues over that of the same tick without, in turns, distance queries included."""

from __future__ import annotations

from typing import Any

import numpy as np
from measure import run_fresh
from native import Core, Levels, Native
from scenes import Scene, buried, slide
from times import Times, quartiles

COUNT = 16  # tissues
WATCHED = COUNT  # of them: all, more than any patient has
CHUNK = 25  # ticks of one bone before the next one's turn


def numbers_of(layout: str, shape: tuple[int, int, int]) -> Levels:
    """One number throughout, one a brick, or one a voxel."""
    random = np.random.default_rng(1)
    if layout == "one":
        return np.zeros(shape, dtype=np.uint8)
    if layout == "bricks":
        bricks = random.integers(0, COUNT, tuple(-(-n // 8) for n in shape), dtype=np.uint8)
        whole = bricks.repeat(8, 0).repeat(8, 1).repeat(8, 2)
        return np.ascontiguousarray(whole[: shape[0], : shape[1], : shape[2]])
    return random.integers(0, COUNT, shape, dtype=np.uint8)


def scene_cost(native: Native, scene: Scene, path: str) -> dict[str, Any]:
    """Medians [us] by layout, and ratios to one tissue, tick by tick; RuntimeError where levels differ."""
    p = scene.levels()
    layouts = {
        "no tissues": None,
        "one": (1, 0),
        "bricks": (COUNT, 0),
        "random": (COUNT, 0),
        "bricks watched": (COUNT, WATCHED),
        "random watched": (COUNT, WATCHED),
    }
    cores = {name: Core.of(native, p, scene.burring, path) for name in layouts}
    for name, given in layouts.items():
        if given is not None:
            numbers = numbers_of(name.removesuffix(" watched"), scene.shape)
            cores[name].set_tissues(numbers, given[0], watched=given[1])
    found: dict[str, list[Times]] = {name: [] for name in layouts}
    for begin in range(0, len(scene.path), CHUNK):
        centers = scene.path[begin : begin + CHUNK]
        for name, core in cores.items():
            found[name].append(run_fresh(core, centers) if scene.fresh else core.run(centers))
    for name, core in cores.items():
        if not np.array_equal(core.density(), cores["one"].density()):
            raise RuntimeError(f"{scene.name}, {name}: equal tissues left other levels than one")
    first = len(scene.path) // 10
    times = {name: Times.join(parts)[first:] for name, parts in found.items()}
    bricks = float(np.prod([-(-n // 8) for n in scene.shape]))
    return {
        name: {
            "median_us": 1e6 * times[name].median,
            "over_one": quartiles(times[name].over(times["one"])),
            "hierarchy_over_voxels": cores[name].hierarchy_bytes / (512 * bricks),  # of whole bricks
        }
        for name in layouts
    }


def tissue_cost(native: Native, quick: bool) -> dict[str, Any]:
    """Of slides and of a buried burr, by CPU path: a large burr, and small ones, beside which a distance counts."""
    radius, spacing = (2.5, 0.2) if quick else (5.0, 0.1)
    ticks = 100 if quick else 600
    scenes = [slide(radius, spacing, ticks=ticks, quick=quick), buried(radius, spacing, quick=quick)]
    if not quick:
        scenes += [slide(2.5, 0.2, ticks=ticks), slide(1.0, 0.1, ticks=ticks)]
    return {
        scene.name: {path: scene_cost(native, scene, path) for path in native.cpu_paths if path != "scalar"}
        for scene in scenes
    }


def largest_ratios(cost: dict[str, Any]) -> dict[str, float]:
    """Median ratio to one tissue, with distance queries: the largest over scenes and CPU paths, by layout."""
    return {
        layout: max(
            by_layout[f"{layout} watched"]["over_one"]["median"]
            for paths in cost.values()
            for by_layout in paths.values()
        )
        for layout in ("bricks", "random")
    }


def largest_hierarchy(cost: dict[str, Any]) -> float:
    """[byte/voxel]"""
    return max(
        row["hierarchy_over_voxels"]
        for paths in cost.values()
        for by_layout in paths.values()
        for row in by_layout.values()
    )


def lines(cost: dict[str, Any]) -> list[str]:
    """For the summary."""
    rows = [
        f"Tissues: a tick with {COUNT} over one with one, tick by tick [quartiles]; watched: with {WATCHED} distances"
    ]
    for scene, paths in cost.items():
        for path, layouts in paths.items():
            for name, row in layouts.items():
                ratio = row["over_one"]
                spread = f"{ratio['median']:.2f} [{ratio['quartile_1']:.2f}, {ratio['quartile_3']:.2f}]"
                rows.append(f"  {scene:<12} {path:<9} {name:<15} {row['median_us']:>8.4g} us  {spread}")
    return rows
