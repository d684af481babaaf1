"""Cost of the surface: update of the changed blocks of a scene, against a rebuild, in one run; needs viz3d.

Run: python tests/bench/view.py; with --live 10, pictures a second beside a session of 10 s at 1 kHz instead."""

import time

import numpy as np
from options import options
from times import timed

import burrlab
from burrlab.view import LiveView, Scene

SIDE, VOXEL, RADIUS, SPEED, IMMERSION = 512, 0.1, 5.0, 20.0, 0.7
TICKS = 50  # at 1 kHz: a frame of 20 Hz


def changed_bricks(bone: burrlab.VoxelBone, low: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Bricks that lost bone in a box, which begins at a brick."""
    differs = bone.read(low, before.shape) != before
    n = [side // 8 for side in before.shape]
    return np.argwhere(differs.reshape(n[0], 8, n[1], 8, n[2], 8).any(axis=(1, 3, 5))) + np.asarray(low) // 8


def drawn_pictures(seconds: float, side: int, size: tuple[int, int]) -> None:
    """Pictures a second of a block of side^3 voxels that a burr of 3 mm cuts, as drawn, off-screen."""
    half = side * VOXEL / 2
    bone = burrlab.VoxelBone.block((2 * half,) * 3, VOXEL, origin=(-half, -half, -2 * half))
    times = np.arange(0.0, seconds + 30.0, 0.005)
    x, y = (half - 4) * np.sin(2 * np.pi * times / 0.9), (half - 5) * np.sin(2 * np.pi * times / 17)
    device = burrlab.ScriptedDevice(times, np.stack([x, y, 2.8 - 0.06 * times], axis=1))
    with burrlab.Session(
        bone, (burrlab.Burr(3.0), burrlab.materials["bone"]), device, seed=1, duration=seconds + 30.0
    ) as session:
        view = LiveView(session, off_screen=True, size=size)
        for _ in range(2):  # the first pictures load everything
            view.step()
            view.scene.picture()
        begin, busy = time.monotonic(), time.process_time()
        drawn = 0
        while time.monotonic() < begin + seconds:
            time.sleep(max(begin + drawn / 20.0 - time.monotonic(), 0.0))
            view.step()
            view.scene.picture()
            drawn += 1
        wall, busy = time.monotonic() - begin, time.process_time() - busy
        triangles = sum(len(block.triangles) for block in view.scene.surface.blocks.values())
        renderer = view.scene.plotter.render_window.ReportCapabilities()
        view.close()
        report = session.report()
    print(*(line for line in renderer.splitlines() if "renderer string" in line))
    print(
        f"{side}^3 voxels, {triangles} triangles, {size[0]} x {size[1]}: {drawn / wall:.2f} pictures a second, {busy / drawn:.3f} s "
        f"of CPU a picture with the session's; {report.ticks} ticks, {report.late} late"
    )


def timed_updates(frames: int, rebuilds: int) -> None:
    """Wall-clock time of a frame's update and of a rebuild, medians."""
    half = SIDE * VOXEL / 2
    bone = burrlab.VoxelBone.block(
        (2 * half,) * 3, VOXEL, origin=(VOXEL / 2 - half, VOXEL / 2 - half, VOXEL / 2 - 2 * half)
    )
    contact = burrlab.BurrContact(bone, burrlab.Burr(RADIUS), burrlab.materials["bone"], 1)
    scene = Scene(bone, [RADIUS], off_screen=True)
    scene.render()
    updates, whole = [], []
    low = np.array([SIDE - 64, SIDE // 2 - 80, 0])
    for frame in range(frames):
        x = -15 + SPEED * 1e-3 * TICKS * (frame + np.arange(TICKS) / TICKS)
        path = np.stack([x, 0.033 + 0 * x, RADIUS - IMMERSION + 0 * x], axis=1)
        before = bone.read(low, (64, 160, SIDE))
        contact.run(path, 1.0)
        updates.append(1e3 * timed(scene.update, bone, changed_bricks(bone, low, before)))
        if frame % max(frames // rebuilds, 1) == 0:
            whole.append(1e3 * timed(scene.update, bone))
    update, rebuild = np.median(updates), np.median(whole)
    print(f"update of a frame {update:.1f} ms, rebuild {rebuild:.0f} ms, {rebuild / update:.0f} times")


def main() -> None:
    chosen = options(
        __doc__, frames=24, rebuilds=5, live={"type": float, "metavar": "SECONDS"},
        side={"type": int, "default": 256, "help": "of the live block [voxels]"},
        size={"default": "1024x768", "help": "of the live pictures [pixels]"},
    )  # fmt: skip
    if chosen.live:
        width, height = map(int, chosen.size.split("x"))
        drawn_pictures(chosen.live, chosen.side, (width, height))
    else:
        timed_updates(chosen.frames, chosen.rebuilds)


if __name__ == "__main__":
    main()
