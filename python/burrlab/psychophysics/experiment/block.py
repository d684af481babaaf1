"""The bone that an interval begins with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from burrlab._core import Burr, VoxelBone
from burrlab.volume.made import block_recipe

_LEAST_VOXELS = 4.0  # of a burr's radius, as the tick has it


@dataclass(frozen=True)
class Block:
    """A block of solid bone, its top at z = 0, in the middle of x and y.

    Parameters
    ----------
    size : (float, float, float)
        Along x, y, z [mm]; whole numbers of voxels. The default holds 20 s of drilling in the softest of the paper's
        materials with the `drilling_hand` (docs/simulated_subject.md).
    voxel : float
        Edge of a voxel [mm].

    Raises
    ------
    ValueError
        If a length is not positive, or the size is not a whole number of voxels.

    Examples
    --------
    >>> bone = Block((20, 20, 10), 0.2).fresh()
    >>> bone.shape, bone.origin
    ((50, 100, 100), (-9.9, -9.9, -9.9))
    """

    size: tuple[float, float, float] = (30.0, 30.0, 20.0)
    voxel: float = 0.1

    def __post_init__(self) -> None:
        size = tuple(float(length) for length in self.size)
        if len(size) != 3:
            raise ValueError(f"size must have three lengths, got {len(size)}")
        for name, length in (("voxel", self.voxel), *(("size", length) for length in size)):
            if not (math.isfinite(length) and length > 0):
                raise ValueError(f"{name} must be positive and finite, got {length!r}")
        for length in size:
            if abs(length / self.voxel - round(length / self.voxel)) > 1e-6:
                raise ValueError(
                    f"size must be a whole number of voxels of {self.voxel:g} mm, got {length:g}"
                )
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "voxel", float(self.voxel))

    @property
    def origin(self) -> tuple[float, float, float]:
        """Centre of voxel (0, 0, 0) [mm]."""
        x, y, z = self.size
        half = 0.5 * self.voxel
        return round(half - 0.5 * x, 9), round(half - 0.5 * y, 9), round(half - z, 9)

    def fresh(self) -> VoxelBone:
        """Untouched."""
        return VoxelBone.block(self.size, self.voxel, origin=self.origin)

    def recipe(self) -> dict[str, Any]:
        """How others make the same bone, for a session's trace."""
        return block_recipe(self.size, self.voxel, origin=self.origin)

    def plain(self) -> dict[str, Any]:
        """For a protocol."""
        return {"size_mm": list(self.size), "voxel_mm": self.voxel}

    def check_burr(self, burr: Burr) -> None:
        """Raises ValueError if the burr is too small for the voxels or too large for the block."""
        if burr.radius < _LEAST_VOXELS * self.voxel:
            raise ValueError(
                f"radius of the burr must be at least {_LEAST_VOXELS:g} voxels of {self.voxel:g} mm, got {burr.radius:g}"
            )
        if 2.0 * burr.radius >= min(self.size[:2]):
            raise ValueError(
                f"diameter of the burr must be less than the block's sides, {min(self.size[:2]):g} mm, got {2 * burr.radius:g}"
            )
