"""Bones, tools and cuts for tests of the secondary effects."""

import numpy as np
from session_scenes import session_of

import burrlab
from burrlab.effects.effects import Effects

SOLID = burrlab.materials["bone"]
TOOL = burrlab.Burr(2.0), SOLID


def bone_with_tissues() -> burrlab.VoxelBone:
    """12 x 12 x 4 mm at 0.2 mm, top at z = 0; bone at x > 0 bleeds."""
    bone = burrlab.VoxelBone.block((12, 12, 4), 0.2, origin=(-5.9, -5.9, -3.9))
    rows = [
        burrlab.Tissue(name, label=label, c_e=SOLID.c_e, alpha=SOLID.alpha, bleeds=bleeds)
        for label, (name, bleeds) in enumerate((("bone", False), ("sinus", True)))
    ]
    numbers = np.zeros(bone.shape, np.uint8)
    numbers[:, :, 30:] = 1
    bone.set_tissues(burrlab.Tissues(rows, SOLID), numbers)
    return bone


def script(seconds: float) -> burrlab.ScriptedDevice:
    """Strokes along x that sink."""
    times = np.arange(0.0, seconds + 0.1, 0.005)
    x = 3.0 * np.sin(2 * np.pi * times / 0.7)
    return burrlab.ScriptedDevice(times, np.stack([x, 0 * x, 1.8 - 0.3 * times], axis=1))


def session(seconds: float = 1.0, **options) -> burrlab.Session:
    settings = {"seed": 1, "duration": seconds, "wall_clock": False, **options}
    return session_of(bone_with_tissues(), TOOL, script(seconds), **settings)


def levels_removed(bone: burrlab.VoxelBone) -> int:
    return int(bone.pristine.astype(np.int64).sum() - bone.density.astype(np.int64).sum())


def buried_parcels(effects: Effects, bone: burrlab.VoxelBone) -> int:
    """Parcels in solid voxels; those that lie on a voxel's face are not."""
    solid = np.pad(bone.density >= effects.parameters.solid_level, 1)
    places = (effects.parcels["position"] - bone.origin) / bone.spacing + 1.5
    last = np.array(solid.shape[::-1]) - 1
    sides = [np.clip(places + shift, 0, last).astype(int).T[::-1] for shift in (-1e-9, 1e-9)]
    return int(np.logical_and(*(solid[tuple(voxel)] for voxel in sides)).sum())
