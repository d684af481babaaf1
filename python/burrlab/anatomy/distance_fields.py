"""Fields of the distance to structures, made once: what a watch asks far from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, find_objects

from burrlab._core import StructureDistance, StructureSearch, VoxelBone

SPACING = 0.4  # of the nodes [mm]
MARGIN = 15.0  # about the structure [mm]


def structure_distances(
    bone: VoxelBone, tissues: Sequence[int], progress: Callable[[float], object] | None = None
) -> list[StructureDistance]:
    """The distance to each of some structures.

    Parameters
    ----------
    bone : VoxelBone
        With tissues.
    tissues : sequence of int
        Their numbers.
    progress : callable, optional
        Called with the part done, 0 to 1, after each.

    Raises
    ------
    ValueError
        If the bone has no tissues, a number is not of one, or no voxel carries it.

    Notes
    -----
    Nodes lie 0.4 mm apart and reach 15 mm beyond the box around the structure. A node near a voxel of it is marked; the
    Euclidean distance transform of the marks is wrong by at most half a diagonal of the nodes' cell and half a diagonal
    of a voxel. Nodes that may be nearer than 8 mm are then searched among the voxels, exactly.
    """
    searches = [StructureSearch(bone, tissue) for tissue in tissues]
    numbers = bone.tissue_numbers
    assert numbers is not None  # a search would have refused
    boxes = find_objects(numbers + np.uint8(1))
    distances = []
    for search, tissue in zip(searches, tissues, strict=True):
        distances.append(_field(search, bone, numbers[boxes[tissue]] == tissue, boxes[tissue]))
        if progress is not None:
            progress(len(distances) / len(tissues))
    return distances


def _field(
    search: StructureSearch, bone: VoxelBone, mask: NDArray[np.bool_], box: tuple[slice, ...]
) -> StructureDistance:
    low, high = np.asarray(search.low) - MARGIN, np.asarray(search.high) + MARGIN
    count = np.ceil((high - low) / SPACING).astype(int) + 1
    shape = tuple(int(n) for n in count[::-1])
    nodes = []  # by axis (z, y, x): the nodes that have voxels
    for axis in range(3):
        xyz = 2 - axis
        voxels = bone.origin[xyz] + np.arange(box[axis].start, box[axis].stop) * bone.spacing[xyz]
        nearest = np.rint((voxels - low[xyz]) / SPACING).astype(int)
        starts = np.flatnonzero(np.diff(nearest, prepend=-1))
        mask = np.logical_or.reduceat(mask, starts, axis=axis)
        nodes.append(nearest[starts])
    empty = np.ones(shape, bool)
    empty[np.ix_(*nodes)] = ~mask
    error = math.sqrt(3) / 2 * SPACING + float(np.linalg.norm(bone.spacing)) / 2 + 1e-4  # rounded to float32
    return StructureDistance(search, _estimate(empty), SPACING, low, error)


def _estimate(empty: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance of each node to the nearest that is not empty [mm], slice by slice: the memory of distances alone."""
    nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
    estimate = np.empty(empty.shape, np.float32)
    y, x = np.ogrid[: empty.shape[1], : empty.shape[2]]
    for z in range(len(estimate)):
        squared = (nearest[0, z] - z) ** 2 + (nearest[1, z] - y) ** 2 + (nearest[2, z] - x) ** 2
        np.sqrt(squared, out=estimate[z], casting="unsafe")
    estimate *= np.float32(SPACING)
    return estimate
