"""Cost of the surface: update of the changed blocks of a scene, against a rebuild, in one run; needs viz3d.

Run: python tests/bench/view.py; with --live 10, pictures a second beside a session of 10 s at 1 kHz instead."""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

import burrlab
from burrlab.view.live import LiveView
from burrlab.view.scene import Scene
from burrlab.view.surface import Surface

SIDE, VOXEL, RADIUS, SPEED, IMMERSION = 512, 0.1, 5.0, 20.0, 0.7
TICKS = 50  # at 1 kHz: a frame of 20 Hz


def changed_bricks(bone: burrlab.VoxelBone, low: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Bricks that lost bone in a box, which begins at a brick."""
    differs = bone.read(low, before.shape) != before
    n = [side // 8 for side in before.shape]
    return np.argwhere(differs.reshape(n[0], 8, n[1], 8, n[2], 8).any(axis=(1, 3, 5))) + np.asarray(low) // 8


def summary(values: list[float]) -> dict[str, float]:
    """Median and quartiles [ms]."""
    low, median, high, largest = np.percentile(np.array(values) * 1e3, [25, 50, 75, 100]).tolist()
    return {"median_ms": median, "q1_ms": low, "q3_ms": high, "largest_ms": largest}


def flying_edges(bone: burrlab.VoxelBone, start: np.ndarray, shape: tuple[int, int, int]) -> None:
    """VTK's work for a box, from levels to triangles with normals."""
    levels = bone.read(start, shape)
    image = vtkImageData()
    image.SetDimensions(shape[2], shape[1], shape[0])
    image.GetPointData().SetScalars(numpy_to_vtk(levels.ravel()))
    edges = vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, 127.5)
    edges.Update()


def drawn_pictures(seconds: float, side: int, size: tuple[int, int]) -> dict[str, Any]:
    """Pictures a second of a block of side^3 voxels that a burr of 3 mm cuts, as drawn, off-screen."""
    half = side * VOXEL / 2
    bone = burrlab.VoxelBone.block((2 * half,) * 3, VOXEL, origin=(-half, -half, -2 * half))
    times = np.arange(0.0, seconds + 30.0, 0.005)
    x, y = (half - 4) * np.sin(2 * np.pi * times / 0.9), (half - 5) * np.sin(2 * np.pi * times / 17)
    device = burrlab.ScriptedDevice(times, np.stack([x, y, 2.8 - 0.06 * times], axis=1))
    tool = burrlab.Burr(3.0), burrlab.materials["bone"]
    with burrlab.Session(bone, tool, device, seed=1, duration=seconds + 30.0) as session:
        view = LiveView(session, off_screen=True, size=size)
        for _ in range(2):  # the first pictures load everything
            view.step()
            view.scene.picture()
        begin, busy = time.monotonic(), time.process_time()
        drawn = sum(1 for _ in view.frames(seconds, fps=20.0))
        wall, busy = time.monotonic() - begin, time.process_time() - busy
        triangles = sum(len(block.triangles) for block in view.scene.surface.blocks.values())
        renderer = view.scene.plotter.render_window.ReportCapabilities()
        view.close()
        counts = {name: getattr(session.report(), name) for name in ("ticks", "late")}
    drawer = next(line for line in renderer.splitlines() if "renderer string" in line).split(":")[1].strip()
    return {
        "pictures": drawn, "pictures_a_second": drawn / wall, "cpu_ms_a_picture_session_included": 1e3 * busy / drawn,
        "voxels": side, "size": size, "triangles": triangles, "renderer": drawer, **counts,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--rebuilds", type=int, default=5)
    parser.add_argument("--draw", action="store_true", help="draw each frame too, and say what it costs")
    parser.add_argument("--live", type=float, metavar="SECONDS")
    parser.add_argument("--side", type=int, default=256, help="of the live block [voxels]")
    parser.add_argument("--size", default="1024x768", help="of the live pictures [pixels]")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    if options.live:
        width, height = map(int, options.size.split("x"))
        print(json.dumps(drawn_pictures(options.live, options.side, (width, height)), indent=2))
        return
    half = SIDE * VOXEL / 2
    bone = burrlab.VoxelBone.block(
        (2 * half,) * 3, VOXEL, origin=(VOXEL / 2 - half, VOXEL / 2 - half, VOXEL / 2 - 2 * half)
    )
    contact = burrlab.BurrContact(bone, burrlab.Burr(RADIUS), burrlab.materials["bone"], 1)
    scene = Scene(bone, [RADIUS], off_screen=True)
    scene.render()
    extraction = Surface(bone)
    counts, times = [], defaultdict(list)

    def timed(name: str, work: Callable[..., Any], *given: object) -> Any:
        """The result of `work`, timed by wall clock and by the thread's CPU clock, without other load."""
        begin, busy = time.perf_counter(), time.thread_time()
        found = work(*given)
        times[name].append(time.perf_counter() - begin)
        times[f"{name}_cpu"].append(time.thread_time() - busy)
        return found

    every = max(options.frames // options.rebuilds, 1)
    low = np.array([SIDE - 64, SIDE // 2 - 80, 0])
    for frame in range(options.frames):
        x = -15 + SPEED * 1e-3 * TICKS * (frame + np.arange(TICKS) / TICKS)
        path = np.stack([x, 0.033 + 0 * x, RADIUS - IMMERSION + 0 * x], axis=1)
        before = bone.read(low, (64, 160, SIDE))
        contact.run(path, 1.0)
        bricks = changed_bricks(bone, low, before)
        timed("scene_update", scene.update, bone, bricks)
        blocks = timed("extraction_of_the_blocks", extraction.update, bone, bricks)
        if options.draw:  # in software without a graphics card
            timed("drawing", scene.render)
        changed = [extraction.blocks[b] for b in blocks if b in extraction.blocks]
        counts.append((len(bricks), len(blocks), sum(len(block.triangles) for block in changed)))
        starts = [np.maximum(np.array(block) * 32 - 1, 0) for block in blocks]
        boxes = [(start, tuple(np.minimum(34, SIDE - start).tolist())) for start in starts]
        timed("flying_edges_of_the_blocks", lambda given: [flying_edges(bone, *box) for box in given], boxes)
        if frame % every == every - 1:
            timed("scene_rebuild", scene.update, bone)
            timed("extraction_of_all", extraction.update, bone)
            if options.draw:
                scene.render()
    result = dict(zip(("bricks", "blocks", "triangles"), np.median(counts, axis=0).tolist(), strict=True))
    result["all_triangles"] = sum(len(block.triangles) for block in extraction.blocks.values())
    for clock in ("", "_cpu"):
        update, rebuild = times[f"scene_update{clock}"], times[f"scene_rebuild{clock}"]
        result |= {f"scene_update{clock}": summary(update), f"scene_rebuild{clock}": summary(rebuild)}
        result[f"ratio{clock}"] = float(np.median(rebuild) / np.median(update))
    for name in ("extraction_of_the_blocks", "extraction_of_all", "flying_edges_of_the_blocks", "drawing"):
        if name in times:
            result[name] = summary(times[name])
    text = json.dumps(result, indent=2)
    print(text)
    if options.json:
        Path(options.json).write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
