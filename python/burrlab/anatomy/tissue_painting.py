"""Tissues of the phantom, and which of them fills how much of each voxel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Material, Tissue, Tissues
from burrlab.anatomy.air_cells import Honeycomb
from burrlab.anatomy.fields import Fields
from burrlab.anatomy.implicit import Grid, Singles, distance_to, ellipsoid, share
from burrlab.anatomy.structures import DURA, Structures
from burrlab.materials import materials

#: Occupancy of nerve, sinus, dura and labyrinth: softer than bone, and yet seen at level 128 (ours, assumed).
SOFT = 0.6

_ROWS: tuple[tuple[str, tuple[int, int, int], bool, bool], ...] = (
    ("air", (20, 20, 30), False, False),
    ("cortex", (235, 225, 200), False, False),
    ("mastoid", (220, 200, 165), False, False),
    ("facial nerve", (250, 220, 50), True, False),
    ("sigmoid sinus", (60, 80, 190), True, True),
    ("dura", (200, 120, 130), True, True),
    ("labyrinth", (60, 180, 200), True, False),
    ("ossicles", (250, 250, 245), True, False),
)
_AIR, _CORTEX, _MASTOID, _NERVE, _SINUS, _DURA, _LABYRINTH, _OSSICLES = range(8)


def phantom_tissues(material: Material = materials["bone"]) -> Tissues:
    """The tissues of a phantom; all have the values of `material`, and all but its bone are assumed."""
    bony = {"cortex", "mastoid"}
    rows = [
        Tissue(
            name, label=number, c_e=material.c_e, alpha=material.alpha, colour=colour, critical=critical,
            bleeds=bleeds, assumed=name not in bony,
        )
        for number, (name, colour, critical, bleeds) in enumerate(_ROWS)
    ]  # fmt: skip
    return Tissues(rows, material)


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
