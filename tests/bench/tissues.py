"""Cost of a tick in bone with tissues over that of the same tick without, in turns, with distance queries."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from measure import core_ticks
from native import Core, Levels, Native
from scenes import Scene, buried, slide
from times import in_turns, quartiles

COUNT = 16  # tissues
WATCHED = COUNT  # all of them, more than any patient has


def numbers_of(layout: str, shape: tuple[int, int, int]) -> Levels:
    """Tissue numbers: one throughout, one per brick, or one per voxel."""
    random = np.random.default_rng(1)
    if layout == "one":
        return np.zeros(shape, dtype=np.uint8)
    if layout == "bricks":
        bricks = random.integers(0, COUNT, tuple(-(-n // 8) for n in shape), dtype=np.uint8)
        return np.kron(bricks, np.ones((8, 8, 8), np.uint8))[: shape[0], : shape[1], : shape[2]].copy()
    return random.integers(0, COUNT, shape, dtype=np.uint8)


LAYOUTS = {
    "no tissues": None, "one": (1, 0), "bricks": (COUNT, 0), "random": (COUNT, 0),
    "bricks watched": (COUNT, WATCHED), "random watched": (COUNT, WATCHED),
}  # fmt: skip


def scene_cost(native: Native, scene: Scene, path: str) -> dict[str, Any]:
    """Medians [us] by layout, and tick-by-tick ratios to one tissue; RuntimeError if levels differ."""
    cores = {name: Core.of(native, scene.levels(), scene.burring, path) for name in LAYOUTS}
    for name, given in LAYOUTS.items():
        if given is not None:
            numbers = numbers_of(name.removesuffix(" watched"), scene.shape)
            cores[name].set_tissues(numbers, given[0], watched=given[1])
    times = in_turns(
        {
            name: (scene.path, lambda _, centers, core=core: core_ticks(core, scene, centers))
            for name, core in cores.items()
        }
    )
    for name, core in cores.items():
        if not np.array_equal(core.density(), cores["one"].density()):
            raise RuntimeError(f"{scene.name}, {name}: equal tissues left other levels than one")
    whole_bricks = 512 * float(np.prod([-(-n // 8) for n in scene.shape]))  # their voxels
    return {
        name: {
            "median_us": 1e6 * times[name].median,
            "over_one": quartiles(times[name].over(times["one"])),
            "hierarchy_over_voxels": core.hierarchy_bytes / whole_bricks,
        }
        for name, core in cores.items()
    }


def tissue_cost(native: Native, quick: bool) -> dict[str, Any]:
    """Costs of slides and of a buried burr, by CPU path; beside small burrs the distance queries matter."""
    radius, spacing = (2.5, 0.2) if quick else (5.0, 0.1)
    ticks = 100 if quick else 600
    scenes = [slide(radius, spacing, ticks=ticks, quick=quick), buried(radius, spacing, quick=quick)]
    if not quick:
        scenes += [slide(2.5, 0.2, ticks=ticks), slide(1.0, 0.1, ticks=ticks)]
    return {
        scene.name: {path: scene_cost(native, scene, path) for path in native.cpu_paths if path != "scalar"}
        for scene in scenes
    }


def lines(cost: dict[str, Any]) -> Iterator[str]:
    """Lines for the summary."""
    yield f"Tissues: a tick with {COUNT} over one with one, tick by tick [quartiles]; watched: with {WATCHED} distances"
    for scene, paths in cost.items():
        for path, layouts in paths.items():
            for layout, row in layouts.items():
                yield (
                    f"  {scene:<12} {path:<9} {layout:<15} {row['median_us']:>8.4g} us  "
                    "{median:.2f} [{quartile_1:.2f}, {quartile_3:.2f}]".format(**row["over_one"])
                )
