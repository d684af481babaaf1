"""The voxels that a tick visits: a section through a burr that slides through bone, with the hierarchy.

    python examples/hierarchy.py [hierarchy.png]

Above: the occupancy, by which the tick skips empty space. Below: the bricks about the burr, and the rows
visited in them.
"""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from numpy.typing import NDArray

import burrlab

VOXEL, RADIUS = 0.1, 5.0  # [mm]
ROW, BRICK, BLOCK, SUPERBLOCK = 1, 8, 32, 128  # voxels along an edge
COVERED, VISITED, OCCUPIED = "#5aa5d6", "#f0a04b", "#f1dfae"


def slide() -> tuple[burrlab.VoxelBone, NDArray[np.float64]]:
    """A bone with a trench 20 mm long, and the burr's centre at its end (x, y, z) [mm]."""
    bone = burrlab.VoxelBone(np.zeros((192, 128, 512), dtype=np.uint8), VOXEL)
    bone.write(np.full((96, 128, 512), 255, dtype=np.uint8))
    burr = burrlab.Burr(RADIUS)
    contact = burrlab.BurrContact(bone, burr, burrlab.materials["bone"], seed=1)
    start = np.array([16.0, 6.37, 95.5 * VOXEL + 2 * RADIUS / 3])
    path = start + np.outer(np.arange(1000) * 0.02, [1.0, 0.0, 0.0])  # 20 mm/s
    contact.run(path, dt=1.0)
    return bone, path[-1]


def distances(first: NDArray[np.float64], size: int, center: NDArray[np.float64]) -> tuple[float, float]:
    """Least and largest distance [mm] from the centre to the voxels of a cube."""
    low, high = first * VOXEL - center, (first + size - 1) * VOXEL - center
    least = np.where(low > 0, low, np.where(high < 0, -high, 0.0))
    return float(np.linalg.norm(least)), float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))))


def outline(ax: Axes, x: float, z: float, width: float, height: float, **style: object) -> None:
    half = VOXEL / 2
    ax.add_patch(Rectangle((x * VOXEL - half, z * VOXEL - half), width * VOXEL, height * VOXEL, **style))


def occupancy(ax: Axes, q: NDArray[np.uint8]) -> None:
    """The blocks, and the blocks of blocks, that hold bone."""
    for size, style in ((BLOCK, {"ec": "0.45", "lw": 0.5}), (SUPERBLOCK, {"ec": "k", "lw": 1.6})):
        for z in range(0, q.shape[0], size):
            for x in range(0, q.shape[2], size):
                held = bool(q[z : z + size, :, x : x + size].any())
                fill = OCCUPIED if held and size == BLOCK else "none"
                outline(ax, x, z, size, size, fc=fill, zorder=1 if size == BLOCK else 4, **style)


def bricks(ax: Axes, q: NDArray[np.uint8], center: NDArray[np.float64]) -> None:
    """Bricks in the section: skipped, wholly covered, or visited in rows."""
    y = round(center[1] / VOXEL)
    for z in range(0, q.shape[0], BRICK):
        for x in range(0, q.shape[2], BRICK):
            y0 = y // BRICK * BRICK
            brick = q[z : z + BRICK, y0 : y0 + BRICK, x : x + BRICK]
            least, most = distances(np.array([x, y0, z], dtype=float), BRICK, center)
            outline(ax, x, z, BRICK, BRICK, fc="none", ec="0.6", lw=0.4, zorder=3)
            if least > RADIUS + VOXEL / 2 or not brick.any():
                continue
            if most <= RADIUS - VOXEL / 2:
                outline(ax, x, z, BRICK, BRICK, fc=COVERED, ec="0.3", lw=0.8, zorder=1)
                continue
            outline(ax, x, z, BRICK, BRICK, fc="none", ec="0.2", lw=0.9, zorder=4)
            for row in range(BRICK):
                nearest, _ = distances(np.array([x, y, z + row], dtype=float), 1, center)
                ends = [
                    distances(np.array([x + i, y, z + row], dtype=float), 1, center)[0] for i in range(BRICK)
                ]
                if q[z + row, y, x : x + BRICK].any() and min(nearest, *ends) <= RADIUS + VOXEL / 2:
                    outline(ax, x, z + row, BRICK, ROW, fc=VISITED, ec="white", lw=0.25, zorder=1)


def main(path: str) -> None:
    bone, center = slide()
    q = bone.density
    y = round(center[1] / VOXEL)
    figure, (wide, close) = plt.subplots(
        2, 1, figsize=(7, 7.4), layout="constrained", height_ratios=[1, 1.25]
    )
    extent = (-VOXEL / 2, (q.shape[2] - 0.5) * VOXEL, -VOXEL / 2, (q.shape[0] - 0.5) * VOXEL)
    bone_tint = ListedColormap(np.array([[0.25, 0.25, 0.25, 0.45 * i / 255] for i in range(256)]))
    for ax in (wide, close):
        ax.imshow(q[:, y, :], origin="lower", extent=extent, cmap=bone_tint, vmin=0, vmax=255, zorder=1.5)
        ax.add_patch(Circle((center[0], center[2]), RADIUS, fill=False, ec="crimson", lw=1.8, zorder=6))
        ax.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal")
    occupancy(wide, q)
    look = {"fontsize": 8, "framealpha": 1.0}
    title = "Occupancy: one bit a block of 32³ voxels, one a block of 128³"
    wide.set(xlim=extent[:2], ylim=extent[2:], title=title)
    wide.legend(
        handles=[
            Patch(fc=OCCUPIED, ec="0.45", label="block that holds bone: a bit for each of its 4³ bricks"),
            Patch(fc="none", ec="k", lw=1.6, label="block of 4³ blocks: a word above, a bit for each"),
            Line2D([], [], color="crimson", label="burr, R = 5 mm, moving right at 20 mm/s"),
        ],
        loc="upper left", **look,
    ).set_zorder(10)  # fmt: skip
    bricks(close, q, center)
    close.set(
        xlim=(center[0] - 6.4, center[0] + 6.4),
        ylim=(center[2] - 6.0, center[2] + 0.6),
        title="Bricks of 8³ voxels that the tick sees",
    )
    close.legend(
        handles=[
            Patch(fc=COVERED, ec="0.3", label="covered whole: moments from stored sums"),
            Patch(fc=VISITED, label="row of 8 voxels, visited"),
            Patch(fc="0.66", label="bone, darker where more is left"),
            Patch(fc="none", ec="0.6", label="brick not seen: empty, or outside"),
        ],
        loc="upper center", **look,
    ).set_zorder(10)  # fmt: skip
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "hierarchy.png")
