"""Tissues of the phantom, and which of them fills how much of each voxel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Material, Tissues
from burrlab.anatomy.air_cells import Honeycomb
from burrlab.anatomy.fields import Fields
from burrlab.anatomy.implicit import Grid, Singles, distance_to, ellipsoid, share
from burrlab.anatomy.structures import DURA, Structures
from burrlab.anatomy.tissue_table import default_tissues
from burrlab.materials import materials

#: Occupancy of nerve, sinus, dura and labyrinth: softer than bone, and yet seen at level 128 (ours, assumed).
SOFT = 0.6

_NAMES = ("air", "cortex", "mastoid", "facial nerve", "sigmoid sinus", "dura", "labyrinth", "ossicles")
_AIR, _CORTEX, _MASTOID, _NERVE, _SINUS, _DURA, _LABYRINTH, _OSSICLES = range(8)


def phantom_tissues(material: Material = materials["bone"]) -> Tissues:
    """The tissues of a phantom, as `default_tissues` has them: the values of `material`, assumed for all but bone."""
    return default_tissues(_NAMES, material=material)


def paint(
    at: Structures, fields: Fields, cells: Honeycomb, grid: Grid, wall: float, width: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]:
    """Levels, tissue numbers and target of a slab, in the frame of a right ear."""
    one = np.float32(1.0)
    numbers = np.full(grid.shape, _CORTEX, dtype=np.uint8)
    part = fields.on("pneumatised", grid)
    rooms = fields.on("rooms", grid)
    inside = (part < np.float32(width)) & (rooms > np.float32(-width))
    numbers[part < 0] = _MASTOID
    from_wall = cells.wall_distance(grid, inside, reach=wall / 2 + width)
    walls = share(from_wall - np.float32(wall / 2), width) - share(from_wall + np.float32(wall / 2), width)
    held = one - share(part, width) * (one - walls)
    held *= one - share(rooms, width)
    cranium = fields.on("cranium", grid)
    beyond, sheet = share(cranium, width), share(cranium + np.float32(DURA), width)
    held *= one - beyond
    held = _lay(held, beyond - sheet, _DURA, numbers)
    held *= share(fields.on("outside", grid), width)
    held = _lay(held, share(fields.on("sinus", grid), width), _SINUS, numbers, replace=True)
    for tubes, number, level in (
        (at.canals, _LABYRINTH, SOFT),
        (at.ossicles, _OSSICLES, 1.0),
        ((at.nerve,), _NERVE, SOFT),
    ):
        distance = distance_to(tubes, grid, 2 * width).astype(np.float32)
        if number == _LABYRINTH:
            distance = np.minimum(distance, ellipsoid(grid, *at.vestibule).astype(np.float32))
        held = _lay(held, share(distance, width), number, numbers, level, replace=True)
    levels = np.rint(np.float32(255) * held).astype(np.uint8)
    numbers[levels == 0] = _AIR
    return levels, numbers, fields.on("plan", grid) < 0


def _lay(
    held: Singles,
    part: Singles,
    number: int,
    numbers: NDArray[np.uint8],
    level: float = SOFT,
    *,
    replace: bool = False,
) -> Singles:
    """Puts a tissue into its part of each voxel, which is numbered after it if it has half of it or all that is in it."""
    before = held * (np.float32(1.0) - part) if replace else held
    added = np.float32(level) * part
    numbers[(part >= np.float32(0.5)) | (added > before)] = number
    return np.asarray(before + added)
