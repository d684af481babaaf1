"""The phantom's large surfaces as fields on a lattice: bone, skull, rooms, air cells and the planned cavity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from burrlab.anatomy.implicit import (
    Floats,
    Grid,
    Singles,
    distance_to,
    ellipsoid,
    interpolate,
    smooth_max,
    smooth_min,
)
from burrlab.anatomy.structures import Structures, surface_depth

#: Thickness of the compact bone over the air cells [mm], assumed.
CORTEX = 2.0
#: Plates over dura and sinus, and bone around ear canal, nerve and labyrinth that hold no cells [mm], assumed.
PLATE, AROUND_CANAL, AROUND_NERVE, AROUND_LABYRINTH = 0.8, 1.5, 1.0, 1.5
#: Margins of the planned cavity from dura, sinus, nerve and labyrinth, and the wall left to the ear canal [mm]; ours.
MARGINS = {"dura": 1.0, "sigmoid sinus": 1.0, "facial nerve": 1.5, "labyrinth": 2.0, "ear canal": 2.0}
#: How far the planned cavity reaches out of the bone [mm], so that it holds the voxels that the surface cuts.
ABOVE = 1.0
#: Radii of the planned cavity at the surface and at the antrum [mm]; ours.
OPENING, BOTTOM = 15.0, 7.5
#: Box that holds the air cells whatever the seed: least and largest (x, y, z) [mm].
CELLS_BOX = ((-1.0, -9.0, -29.0), (19.0, 28.0, 13.0))


@dataclass(frozen=True)
class Fields:
    """Signed distances on the lattice, negative inside [mm].

    Attributes
    ----------
    outside
        From the outer surface of the bone.
    cranium
        From the inside of the skull.
    rooms
        From antrum, aditus, middle ear and ear canal.
    sinus
        From the sigmoid sinus.
    pneumatised
        From the part that holds air cells; the rooms may cut into it.
    plan
        From the cavity of a simple mastoidectomy.
    """

    lattice: Grid
    outside: Singles
    cranium: Singles
    rooms: Singles
    sinus: Singles
    pneumatised: Singles
    plan: Singles

    @classmethod
    def of(cls, at: Structures, lattice: Grid) -> Fields:
        outside, cranium = _outside(at, lattice), _cranium(at, lattice)
        canal = distance_to([at.ear_canal], lattice, 4.0)
        near = {
            "sigmoid sinus": distance_to([at.sinus], lattice, 4.0),
            "facial nerve": distance_to([at.nerve], lattice, 4.0),
            "labyrinth": np.minimum(distance_to(at.canals, lattice, 4.0), ellipsoid(lattice, *at.vestibule)),
            "dura": cranium,
            "ear canal": canal,
        }
        bone = {"sigmoid sinus": PLATE, "facial nerve": AROUND_NERVE, "labyrinth": AROUND_LABYRINTH,
                "dura": PLATE, "ear canal": AROUND_CANAL}  # fmt: skip
        cells = np.maximum(_mastoid(lattice, outside), _within(near, bone))
        plan = np.maximum(_funnel(at, lattice), np.maximum(_within(near, MARGINS), outside - ABOVE))
        parts = (outside, cranium, _rooms(at, lattice, canal), near["sigmoid sinus"], cells, plan)
        return cls(lattice, *(part.astype(np.float32) for part in parts))

    def on(self, name: str, grid: Grid) -> Singles:
        """One of them at the points of a grid."""
        return interpolate(getattr(self, name), self.lattice, grid)


def _within(distance: dict[str, Floats], margin: dict[str, float]) -> Floats:
    """Negative where all margins are kept."""
    return np.asarray(np.maximum.reduce([margin[name] - distance[name] for name in margin]))


def _outside(at: Structures, grid: Grid) -> Floats:
    x, y, z = grid.open()
    below = -12.5 - 0.15 * np.clip(y, 0.0, 20.0) - z  # the skull base beside the mastoid process
    base = smooth_min(np.broadcast_to(below, grid.shape), distance_to([at.tip], grid, 10.0), 3.0)
    return smooth_max(np.broadcast_to(surface_depth(grid) - x, grid.shape), base, 2.0)


def _cranium(at: Structures, grid: Grid) -> Floats:
    x, y, z = grid.open()
    squama = np.broadcast_to(surface_depth(grid) + 4.0 - x, grid.shape)
    floor = at.tegmen[0] + at.tegmen[1] * (x - 12.0) + at.tegmen[2] * (y - 6.0)
    middle = smooth_max(np.broadcast_to(floor - z, grid.shape), squama, 4.0)
    plane = np.broadcast_to((at.fossa - x - 0.8 * y) / np.sqrt(1.64), grid.shape)
    return smooth_min(middle, smooth_max(plane, squama + 2.0, 4.0), 2.0)


def _rooms(at: Structures, grid: Grid, canal: Floats) -> Floats:
    rooms = smooth_min(ellipsoid(grid, *at.antrum), distance_to([at.aditus], grid, 4.0), 1.0)
    return np.asarray(np.minimum(smooth_min(rooms, ellipsoid(grid, *at.tympanum), 1.0), canal))


def _mastoid(grid: Grid, outside: Floats) -> Floats:
    """Where cells may be: below the cortex, behind and above the ear canal, lateral to the inner ear."""
    _, y, z = grid.open()
    front = np.broadcast_to(np.minimum(2.0, -2.9 - 0.82 * z) - y, grid.shape)
    body = ellipsoid(grid, [5.0, 8.0, -4.0], [13.0, 20.0, 26.0])
    return smooth_max(smooth_max(outside + CORTEX, front, 2.0), body, 3.0)


def _funnel(at: Structures, grid: Grid) -> Floats:
    """A cone that narrows from the opening to the antrum, and ends at its far wall."""
    a, b = at.landmarks["entry"] - [2.0, 0.0, 0.0], at.antrum[0]
    span = b - a
    x, y, z = grid.open()
    t = ((x - a[0]) * span[0] + (y - a[1]) * span[1] + (z - a[2]) * span[2]) / float(span @ span)
    t = np.clip(t, 0.0, 1.0)
    dx, dy, dz = x - a[0] - t * span[0], y - a[1] - t * span[1], z - a[2] - t * span[2]
    across = np.sqrt(dx * dx + dy * dy + dz * dz) - (OPENING + t * (BOTTOM - OPENING))
    return smooth_max(across, np.broadcast_to(x - (b[0] + at.antrum[1][0]), grid.shape), 2.0)
