"""A block cut out of a volume, as the bone that an interval begins with."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass, field
from typing import Any

from burrlab._core import VoxelBone
from burrlab.psychophysics.experiment.block import Block
from burrlab.volume.cut import cut_block
from burrlab.volume.recipe import VolumeRecipe


@dataclass(frozen=True)
class VolumeBlock(Block):
    """A block cut out of a volume along an axis; its top is flat at z = 0, the entry in the middle of x and y.

    Parameters
    ----------
    size, voxel
        As for `Block`.
    volume : VolumeRecipe
    entry, axis : (float, float, float)
        In the volume's own coordinates; see `burrlab.volume.cut_block`.

    Raises
    ------
    ValueError
        As `Block`. What is wrong with the volume shows when it is cut.
    """

    volume: VolumeRecipe = field(kw_only=True)
    entry: tuple[float, float, float] = field(kw_only=True)
    axis: tuple[float, float, float] = field(kw_only=True)

    def fresh(self) -> VoxelBone:
        """Untouched; cut once. Errors as of `burrlab.volume.cut_block`, and OSError."""
        return _cut(self).copy()

    def recipe(self) -> dict[str, Any]:
        """How others make the same bone, for a session's trace."""
        return {
            "notes": list(self.volume.notes()), "kind": "volume block", "volume": self.volume.plain(), "size_mm": list(self.size), "voxel_mm": self.voxel,
            "entry_mm": list(self.entry), "axis": list(self.axis),
        }  # fmt: skip

    def plain(self) -> dict[str, Any]:
        """For a protocol: where the volume lies is not in it, the bone's digest is."""
        # without what earlier versions did not write, so that a protocol keeps its digest
        volume = {name: value for name, value in self.volume.plain().items() if value is not False}
        volume["path"], made = os.path.basename(self.volume.path), self.recipe()
        del made["notes"]
        return {**made, "volume": volume, "digest": _cut(self).digest()}


@functools.lru_cache(maxsize=2)
def _cut(block: VolumeBlock) -> VoxelBone:
    return cut_block(block.volume, block.size, block.voxel, entry=block.entry, axis=block.axis)
