"""Cost of the surface: blocks that changed as a scene takes them over, against a rebuild, in one run. Needs the extra viz3d.

Run: python tests/bench/view.py"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np

import burrlab
from burrlab.view.scene import Scene
from burrlab.view.surface import Surface

SIDE, VOXEL, RADIUS, SPEED, IMMERSION = 512, 0.1, 5.0, 20.0, 0.7
TICKS = 50  # at 1 kHz: a frame of 20 Hz


def changed_bricks(bone: burrlab.VoxelBone, low: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Bricks of a box, which begins at a brick, that lost something."""
    differs = bone.read(low, before.shape) != before
    n = [side // 8 for side in before.shape]
    return np.argwhere(differs.reshape(n[0], 8, n[1], 8, n[2], 8).any(axis=(1, 3, 5))) + np.asarray(low) // 8


def summary(values: list[float]) -> dict[str, float]:
    """Median and quartiles [ms]."""
    low, median, high = np.percentile(np.array(values) * 1e3, [25, 50, 75])
    return {
        "median_ms": float(median),
        "q1_ms": float(low),
        "q3_ms": float(high),
        "largest_ms": 1e3 * max(values),
    }


def flying_edges(bone: burrlab.VoxelBone, start: np.ndarray, shape: tuple[int, int, int]) -> float:
    """Seconds that VTK takes for a box, from levels to triangles with normals."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    begin = time.perf_counter()
    levels = bone.read(start, shape)
    image = vtkImageData()
    image.SetDimensions(shape[2], shape[1], shape[0])
    image.GetPointData().SetScalars(numpy_to_vtk(levels.ravel()))
    edges = vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, 127.5)
    edges.Update()
    return time.perf_counter() - begin


def rendering(scene: Any) -> float:
    """Seconds to draw once; by software where there is no graphics card."""
    begin = time.perf_counter()
    scene.render()
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--rebuilds", type=int, default=5)
    parser.add_argument("--draw", action="store_true", help="draw each frame too, and say what it costs")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    half = SIDE * VOXEL / 2
    bone = burrlab.VoxelBone.block(
        (2 * half,) * 3, VOXEL, origin=(VOXEL / 2 - half, VOXEL / 2 - half, VOXEL / 2 - 2 * half)
    )
    contact = burrlab.BurrContact(bone, burrlab.Burr(RADIUS), burrlab.materials["bone"], 1)
    scene = Scene(bone, [RADIUS], off_screen=True)
    scene.render()
    extraction = Surface(bone)
    update, rebuild, extract, extract_all, vtk, drawn, counts = [], [], [], [], [], [], []
    update_cpu, rebuild_cpu = [], []  # what a machine busy with others would not change
    every = max(options.frames // options.rebuilds, 1)
    low = np.array([SIDE - 64, SIDE // 2 - 80, 0])
    for frame in range(options.frames):
        x = -15 + SPEED * 1e-3 * TICKS * (frame + np.arange(TICKS) / TICKS)
        path = np.stack([x, 0.033 + 0 * x, RADIUS - IMMERSION + 0 * x], axis=1)
        before = bone.read(low, (64, 160, SIDE))
        contact.run(path, 1.0)
        bricks = changed_bricks(bone, low, before)
        begin, busy = time.perf_counter(), time.thread_time()
        scene.update(bone, bricks)
        update.append(time.perf_counter() - begin)
        update_cpu.append(time.thread_time() - busy)
        begin = time.perf_counter()
        blocks = extraction.update(bone, bricks)
        extract.append(time.perf_counter() - begin)
        if options.draw:
            drawn.append(rendering(scene))
        changed = [extraction.blocks[b] for b in blocks if b in extraction.blocks]
        counts.append((len(bricks), len(blocks), sum(len(block.triangles) for block in changed)))
        vtk.append(0.0)
        for block in blocks:
            start = np.maximum(np.array(block) * 32 - 1, 0)
            vtk[-1] += flying_edges(bone, start, tuple(np.minimum(34, SIDE - start).tolist()))
        if frame % every == every - 1:
            begin, busy = time.perf_counter(), time.thread_time()
            scene.update(bone)
            rebuild.append(time.perf_counter() - begin)
            rebuild_cpu.append(time.thread_time() - busy)
            begin = time.perf_counter()
            extraction.update(bone)
            extract_all.append(time.perf_counter() - begin)
            if options.draw:
                scene.render()
    triangles = sum(len(block.triangles) for block in extraction.blocks.values())
    middle = np.median(np.array(counts), axis=0)
    result = {
        "bricks": middle[0], "blocks": middle[1], "triangles": middle[2], "all_triangles": triangles,
        "scene_update": summary(update), "scene_rebuild": summary(rebuild),
        "ratio": float(np.median(rebuild) / np.median(update)),
        "scene_update_cpu": summary(update_cpu), "scene_rebuild_cpu": summary(rebuild_cpu),
        "ratio_cpu": float(np.median(rebuild_cpu) / np.median(update_cpu)),
        "extraction_of_the_blocks": summary(extract), "extraction_of_all": summary(extract_all),
        "flying_edges_of_the_blocks": summary(vtk),
    }  # fmt: skip
    if drawn:
        result["drawing"] = summary(drawn)
    text = json.dumps(result, indent=2)
    print(text)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            file.write(text + "\n")


if __name__ == "__main__":
    main()
