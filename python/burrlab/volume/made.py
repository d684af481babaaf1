"""Bones made of recipes, which may come from another machine."""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Mapping, Sequence
from typing import Any

from burrlab._core import VoxelBone
from burrlab.anatomy.labelled_recipe import LabelledRecipe
from burrlab.arguments import real
from burrlab.json_text import UNREADABLE as _UNREADABLE
from burrlab.specimen import MOST_VOXELS
from burrlab.volume.cut import cut_block
from burrlab.volume.drilled_recipe import DrilledRecipe
from burrlab.volume.occupancy_map import OccupancyMap, occupancy_map
from burrlab.volume.recipe import VolumeRecipe

#: How a bone is made; JSON.
Recipe = dict[str, Any]


def block_recipe(
    size: Sequence[float], voxel: float, *, origin: Sequence[float] = (0.0, 0.0, 0.0), level: int = 255
) -> Recipe:
    """The recipe of `VoxelBone.block`.

    Parameters
    ----------
    size : (x, y, z)
        [mm]
    voxel : float
        [mm]
    origin : (x, y, z)
        Centre of the first voxel [mm].
    level : int
        0 to 255.

    Examples
    --------
    >>> recipe = block_recipe((2, 2, 1), 0.1)
    >>> make_bone(recipe).shape
    (10, 20, 20)
    """
    return {"kind": "block", "size_mm": [float(real(s, "size")) for s in size], "voxel_mm": float(real(voxel, "voxel")),
            "origin_mm": [float(real(o, "origin")) for o in origin], "level": int(level)}  # fmt: skip


def volume_recipe(
    path: str | os.PathLike[str],
    mapping: OccupancyMap | float,
    solid: float | None = None,
    *,
    spacing: float | Sequence[float] | None = None,
    series: str | None = None,
    crop: tuple[Sequence[float], Sequence[float]] | None = None,
    voxel: float | Sequence[float] | None = None,
    transpose: bool | None = None,
) -> Recipe:
    """The recipe of `read_volume(path).to_bone(mapping, solid)`, cropped and resampled as asked.

    Parameters
    ----------
    path : path
        Made absolute, for replicas run elsewhere.
    mapping, solid
        As for `Volume.to_bone`.
    spacing, series, crop, voxel, transpose
        As for `burrlab.volume.VolumeRecipe`.

    Raises
    ------
    ValueError
        If a parameter is wrong; the file is not looked at.
    TypeError
        If the map is none.
    """
    chosen: Any = (spacing, series, crop, voxel, transpose)
    return VolumeRecipe(os.fspath(path), occupancy_map(mapping, solid), *chosen).plain()


def make_bone(recipe: Mapping[str, Any], *, volume: str | os.PathLike[str] | None = None) -> VoxelBone:
    """The bone of a recipe.

    Parameters
    ----------
    recipe : mapping
        Of `block_recipe`, `volume_recipe`, an experiment's `VolumeBlock`, `LabelledRecipe.plain` or `DrilledRecipe.plain`;
        it may come from another machine.
    volume : path, optional
        Where the volume lies here, if elsewhere.

    Raises
    ------
    ValueError
        If the recipe cannot be read, names a block too large to make, or the volume cannot be read.
    FileNotFoundError
        If there is no such volume.
    """
    try:
        if recipe["kind"] == "block":
            size, origin = _three(recipe["size_mm"]), _three(recipe["origin_mm"])
            voxel, level = float(recipe["voxel_mm"]), whole_number(recipe["level"], 255)
        elif recipe["kind"] == "volume":
            made = VolumeRecipe.of(recipe)
        elif recipe["kind"] == "volume block":
            made, voxel = VolumeRecipe.of(recipe["volume"]), float(recipe["voxel_mm"])
            size, entry, axis = (_three(recipe[key]) for key in ("size_mm", "entry_mm", "axis"))
        elif recipe["kind"] == "labelled volume":
            labelled = LabelledRecipe.of(recipe)
        elif recipe["kind"] == "drilled volume":
            drilled = DrilledRecipe.of(recipe)
        else:
            raise KeyError("kind")
    except _UNREADABLE:
        raise ValueError(
            f"recipe must be that of block_recipe or volume_recipe, got {reprlib.repr(recipe)}"
        ) from None
    if recipe["kind"] == "drilled volume":
        return (drilled if volume is None else drilled.at(volume)).bone()
    if recipe["kind"] == "labelled volume":
        return (labelled if volume is None else labelled.at(volume)).bone()
    if recipe["kind"] == "volume":
        return (made if volume is None else made.at(volume)).bone()
    if recipe["kind"] == "volume block":
        here = made if volume is None else made.at(volume)
        return cut_block(here, size, voxel, entry=entry, axis=axis)
    if voxel > 0 and not (voxels := math.prod(max(s / voxel, 1.0) for s in size)) <= MOST_VOXELS:
        raise ValueError(f"recipe must have at most {MOST_VOXELS:.3g} voxels, got {voxels:.3g}")
    return VoxelBone.block(size, voxel, origin=origin, level=level)


def whole_number(number: Any, most: int) -> int:
    if not 0 <= int(number) <= most or int(number) != number:
        raise ValueError(number)
    return int(number)


def _three(numbers: Sequence[Any]) -> list[float]:
    x, y, z = map(float, numbers)
    return [x, y, z]
