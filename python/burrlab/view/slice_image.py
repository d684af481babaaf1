"""A slice through a bone as a picture: tissues' colours by how much bone there is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab import _core
from burrlab._core import VoxelBone
from burrlab.view.surface import BONE, tissue_palette

#: Plane -> (axis across it, axis to the right, axis upwards) of (x, y, z).
PLANES = {"xy": (2, 0, 1), "xz": (1, 0, 2), "yz": (0, 1, 2)}
#: Where bone was and is no more.
REMOVED = (92, 44, 40)
_EMPTY = (16, 18, 24)


@dataclass(frozen=True, eq=False, repr=False)
class SliceImage:
    """One plane of voxels.

    Attributes
    ----------
    plane : str
        "xy", "xz" or "yz": axes to the right and upwards.
    pixels : ndarray, shape (rows, columns, 3), uint8
        Row 0 is at the bottom.
    levels : ndarray, shape (rows, columns), uint8
    tissues : ndarray, shape (rows, columns), uint8, or None
        Numbers; None without tissues.
    extent : tuple
        Left, right, bottom, top: outer faces of the voxels [mm].
    position : float
        Of the plane's voxel centres along the axis across it [mm].
    """

    plane: str
    pixels: NDArray[np.uint8]
    levels: NDArray[np.uint8]
    tissues: NDArray[np.uint8] | None
    extent: tuple[float, float, float, float]
    position: float

    def burr_radius(self, center: ArrayLike, radius: float) -> float:
        """Radius of the circle that a sphere cuts out of the plane [mm]; 0 if it does not meet it."""
        away = float(np.asarray(center, float)[PLANES[self.plane][0]]) - self.position
        return float(np.sqrt(max(radius**2 - away**2, 0.0)))


def slice_image(bone: VoxelBone, point: ArrayLike, plane: str) -> SliceImage:
    """The plane of voxels nearest to a point.

    Parameters
    ----------
    bone : VoxelBone
    point : (x, y, z)
        In the bone frame [mm]; beyond the volume its outermost plane is taken.
    plane : str
        "xy", "xz" or "yz".

    Returns
    -------
    SliceImage

    Raises
    ------
    ValueError
        If the plane is another, or the point is not three finite numbers.
    """
    if plane not in PLANES:
        raise ValueError(f"plane must be one of {', '.join(PLANES)}, got '{plane}'")
    at = np.asarray(point, float)
    if at.shape != (3,) or not np.isfinite(at).all():
        raise ValueError(f"point must be three finite numbers (x, y, z) [mm], got {point!r}")
    across, right, up = PLANES[plane]
    shape, spacing, origin = bone.shape[::-1], bone.spacing, bone.origin
    index = int(np.clip(np.rint((at[across] - origin[across]) / spacing[across]), 0, shape[across] - 1))
    start, size = [0, 0, 0], list(bone.shape)
    start[2 - across], size[2 - across] = index, 1
    levels, pristine, numbers = (
        None if box is None else box.squeeze(axis=2 - across)
        for box in (
            bone.read(start, size), bone.read(start, size, pristine=True), _core.tissue_box(bone, start, size)
        )
    )  # fmt: skip
    assert levels is not None
    assert pristine is not None
    # (z, y, x) without the axis across is (upwards, to the right) for all three planes
    palette = tissue_palette(bone)
    colour = np.asarray(BONE) if numbers is None else palette[numbers].astype(float)
    # half full is drawn as full, as the surface is: soft tissue keeps its colour
    now, lost = (np.minimum(part[..., None] / 127.5, 1.0) for part in (levels, pristine - levels))
    pixels = now * colour + (1 - now) * (lost * np.asarray(REMOVED) + (1 - lost) * np.asarray(_EMPTY))
    low = [origin[a] - spacing[a] / 2 for a in (right, up)]
    high = [origin[a] + spacing[a] * (shape[a] - 0.5) for a in (right, up)]
    return SliceImage(
        plane, np.rint(pixels).astype(np.uint8), levels, numbers, (low[0], high[0], low[1], high[1]),
        origin[across] + index * spacing[across],
    )  # fmt: skip
