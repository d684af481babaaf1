"""Values on a grid of another spacing: linear between voxel centres, averaged where voxels become larger; labels nearest."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.bounds import check_memory
from burrlab.specimen import MOST_VOXELS

Array = NDArray[np.float64]
_WHOLE = 1e-3  # of a voxel: by how much a field of view may miss a whole number of voxels, spacing in float32


def resampled_shape(
    shape: tuple[int, int, int], old: Array, new: Array, work: float = 0.0
) -> tuple[int, int, int]:
    """Voxels (z, y, x) of spacing `new` (x, y, z) that cover the field of view; ValueError where they are too many.

    `work` bytes a voxel of the old ones are needed besides.
    """
    with np.errstate(over="ignore"):
        sides = np.array(shape, dtype=float) * old[::-1] / new[::-1]
        counts = np.maximum(np.ceil(sides - _WHOLE), 1.0)
        voxels = float(np.prod(counts))
    if not voxels <= MOST_VOXELS:
        raise ValueError(
            f"spacing must be coarser or the volume cropped: {new.min():g} mm makes {voxels:.3g} voxels, and "
            f"{MOST_VOXELS:.3g} are the most"
        )
    check_memory(5.0 * voxels + work * math.prod(shape), f"resampling to {voxels:.3g} voxels")
    z, y, x = (int(n) for n in counts)
    return z, y, x


def resample_linear(
    values: NDArray[Any],
    old: Array,
    new: Array,
    *,
    empty_outside: bool = False,
    kind: Any = np.float32,
    store: Callable[[NDArray[np.float32]], NDArray[Any]] = lambda plane: plane,
) -> NDArray[Any]:
    """Values (z, y, x) at the centres of voxels of spacing `new` (x, y, z) from the same corner.

    Along an axis whose voxels become smaller: linear between the two nearest centres, constant beyond the outermost ones.
    Along one whose voxels become larger: the mean over the new voxel, old voxels taken as uniform, its part within the volume.

    Parameters
    ----------
    values : ndarray, shape (z, y, x)
    old, new : ndarray, shape (3,)
        Spacing (x, y, z) [mm].
    empty_outside : bool
        A last voxel that reaches beyond the volume gets the part of its value by which it lies within; else the whole.
    kind : dtype
        Of the result.
    store : callable
        What is done with each plane of float32 before it is stored as `kind`.
    """
    shape = resampled_shape(_three(values), old, new, 28.0 if np.any(new > old) else 8.0)  # as measured
    work = values.astype(np.float32)
    for axis in range(3):
        ratio = float(new[2 - axis] / old[2 - axis])
        if ratio > 1.0 + 1e-9:
            work = _averaged(work, axis, shape[axis], ratio)
    (z0, z1, zw), (y0, y1, yw), (x0, x1, xw) = (
        _neighbours(work.shape[axis], shape[axis], min(float(new[2 - axis] / old[2 - axis]), 1.0))
        for axis in range(3)
    )
    within = [
        _within(values.shape[axis] * old[2 - axis], shape[axis], new[2 - axis])
        if empty_outside
        else np.float32(1)
        for axis in range(3)
    ]
    found = np.empty(shape, dtype=kind)
    for k in range(shape[0]):  # a plane at a time: no copies of the large volume
        plane = work[z0[k]] + zw[k] * (work[z1[k]] - work[z0[k]])
        plane = plane[y0] + yw[:, None] * (plane[y1] - plane[y0])
        plane = plane[:, x0] + xw * (plane[:, x1] - plane[:, x0])
        plane[-1] *= within[1]
        plane[:, -1] *= within[2]
        found[k] = store(plane if k < shape[0] - 1 else plane * within[0])
    return found


def resample_nearest(labels: NDArray[Any], old: Array, new: Array) -> NDArray[Any]:
    """Labels (z, y, x) of the old voxel in which the new one's centre lies, the lower of two at a face."""
    shape = resampled_shape(_three(labels), old, new)
    places = []
    for axis in range(3):
        center = (np.arange(shape[axis]) + 0.5) * (new[2 - axis] / old[2 - axis])
        places.append(np.clip(np.ceil(center - 1e-9) - 1, 0, labels.shape[axis] - 1).astype(int))
    return np.asarray(labels[np.ix_(*places)])


def _within(extent: float, count: int, spacing: float) -> np.float32:
    """Part of the last voxel that lies in the volume; 1 where it ends with it but for rounding."""
    part = extent / spacing - (count - 1)
    return np.float32(min(part, 1.0) if part < 1.0 - _WHOLE else 1.0)


def _three(values: NDArray[Any]) -> tuple[int, int, int]:
    z, y, x = values.shape
    return z, y, x


def _averaged(values: NDArray[np.float32], axis: int, count: int, ratio: float) -> NDArray[np.float32]:
    old = values.shape[axis]
    edges = np.minimum(np.arange(count + 1) * ratio, old)
    moved = np.moveaxis(values, axis, 0)
    total = np.zeros((old + 1, *moved.shape[1:]))
    np.cumsum(moved, axis=0, out=total[1:], dtype=np.float64)
    whole = np.minimum(edges.astype(int), old - 1)
    part = (edges - whole).reshape(-1, 1, 1)
    at_edge = total[whole] + part * (total[whole + 1] - total[whole])
    means = np.diff(at_edge, axis=0) / np.diff(edges).reshape(-1, 1, 1)
    return np.asarray(np.moveaxis(means, 0, axis), dtype=np.float32)


def _neighbours(
    old: int, count: int, ratio: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Of each new centre the two old ones around it, and how far it is from the first, 0..1."""
    place = np.clip((np.arange(count) + 0.5) * ratio - 0.5, 0, old - 1)
    first = np.minimum(np.floor(place).astype(np.intp), max(old - 2, 0))
    return first, np.minimum(first + 1, old - 1), (place - first).astype(np.float32)
