"""A block of bone with a nerve in it, for tests of watches."""

import numpy as np

from burrlab import Burr, ScriptedDevice, Tissue, Tissues, VoxelBone, materials

BONE = materials["bone"]
NAMES = ("bone", "nerve", "sinus", "unused")


def table():
    rows = [
        Tissue(name, label=i, c_e=BONE.c_e, alpha=BONE.alpha, critical=name != "bone")
        for i, name in enumerate(NAMES)
    ]
    return Tissues(rows, BONE)


def nerve_bone(voxel=0.2):
    """10 x 10 x 6 mm, top at z = 0: a nerve along y, 0.8 mm wide, from z = -2 to -1; a sinus below z = -5."""
    shape = tuple(round(side / voxel) for side in (6, 10, 10))
    z, _y, x = ((np.arange(n) + 0.5) * voxel for n in shape)
    numbers = np.zeros(shape, np.uint8)
    nerve = (np.abs(z - 4.5) < 0.5)[:, None, None] & (np.abs(x - 5) < 0.5)[None, None, :]
    numbers[np.broadcast_to(nerve, shape)] = 1
    numbers[z < 1] = 2
    bone = VoxelBone(np.full(shape, 255, np.uint8), voxel, (-5 + voxel / 2, -5 + voxel / 2, -6 + voxel / 2))
    bone.set_tissues(table(), numbers)
    return bone


def tool(radius=1.0):
    return Burr(radius), BONE


def straight(points, times, on=None):
    """A device that goes from point to point in straight lines."""
    return ScriptedDevice(np.asarray(times, float), np.asarray(points, float), on)
