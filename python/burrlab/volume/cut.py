"""A block cut out of a volume along an axis: as flat on top as a prepared specimen, the volume's bone within."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import map_coordinates

from burrlab._core import VoxelBone
from burrlab.specimen import MOST_VOXELS, Vector
from burrlab.volume.geometry import checked_spacing
from burrlab.volume.recipe import VolumeRecipe


def cut_block(
    recipe: VolumeRecipe, size: Sequence[float], voxel: float, *, entry: Vector, axis: Vector
) -> VoxelBone:
    """The bone below the plane across an axis at its first crossing of occupancy 128, in a frame of its own.

    The crossing becomes (0, 0, 0), the axis -z; x lies across it and across the voxel axis that is furthest from it. Levels are
    trilinear between those of the recipe's bone; beyond the volume there are none. What stands above the plane is cut off.

    Parameters
    ----------
    recipe : VolumeRecipe
        Its `voxel` should be no coarser than the block's.
    size : (x, y, z)
        Of the block [mm]; its top is at z = 0, in the middle of x and y.
    voxel : float
        Its spacing [mm].
    entry, axis : (x, y, z)
        In the volume's own coordinates; see `Volume.specimen`.

    Raises
    ------
    ValueError
        If a length is not positive, the block has too many voxels, or as `VolumeRecipe.specimen`.
    """
    sides, apart = checked_spacing(size, "size"), float(checked_spacing(voxel, "voxel")[0])
    counts = np.maximum(np.round(sides / apart), 1)
    if not (voxels := math.prod(counts.tolist())) <= MOST_VOXELS:
        raise ValueError(
            f"voxel must be coarser: the block has {voxels:.3g} voxels, and {MOST_VOXELS:.3g} are the most"
        )
    found = recipe.specimen(entry=entry, axis=axis)
    across = np.cross(found.axis, np.eye(3)[np.argmin(np.abs(found.axis))])
    across /= np.linalg.norm(across)
    turn = np.column_stack(
        [across, np.cross(-found.axis, across), -found.axis]
    )  # the block's axes in the bone frame
    x, y, z = (int(n) for n in counts)
    first = np.array([0.5 * (1 - x) * apart, 0.5 * (1 - y) * apart, (0.5 - z) * apart])
    levels, out = found.bone.density, np.empty((z, y, x), np.uint8)
    scale, origin = np.array(found.bone.spacing), np.array(found.bone.origin)
    plane = np.stack(np.meshgrid(np.arange(x), np.arange(y), indexing="xy"), -1) * apart
    for k in range(z):
        points = np.concatenate([plane, np.full((y, x, 1), k * apart)], axis=-1) + first
        places = (found.surface + points @ turn.T - origin) / scale
        out[k] = np.rint(
            map_coordinates(
                levels, np.moveaxis(places[..., ::-1], -1, 0), output=float, order=1, mode="grid-constant"
            )
        )
    return VoxelBone(out, spacing=apart, origin=first)
