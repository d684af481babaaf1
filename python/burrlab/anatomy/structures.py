"""Where things are in the phantom: surfaces, plates, tubes and their sizes, for a right ear.

The frame has its origin at the spine of Henle, on the bone's surface; x is depth (towards the middle of the head), y points
back, z up [mm].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from burrlab.anatomy.air_cells import uniform
from burrlab.anatomy.implicit import (
    FAR,
    Floats,
    Grid,
    Tube,
    distance_to,
    ellipsoid,
    smooth_max,
    smooth_min,
)

#: Thickness of the compact bone over the air cells [mm], assumed.
CORTEX = 2.0
#: Plates over dura and sinus, and bone around nerve and labyrinth that holds no cells [mm], assumed.
PLATE, AROUND_NERVE, AROUND_LABYRINTH = 0.8, 1.0, 1.5
#: Wall of the ear canal that holds no cells [mm], assumed.
CANAL_WALL = 1.5
#: Thickness of the dura [mm], assumed.
DURA = 1.0
#: Radius of the bony ear canal [mm], assumed; of the sigmoid sinus [mm], assumed.
CANAL, SINUS = 4.2, 4.5
#: Depth behind which nothing is pneumatised [mm], assumed.
DEEPEST = 17.5
#: Box that holds the pneumatised part whatever the seed: least and largest (x, y, z) [mm].
CELLS_BOX = ((0.0, -8.0, -28.0), (18.0, 28.0, 13.0))


@dataclass(frozen=True)
class Structures:
    """The anatomy of one seed."""

    nerve: Tube
    sinus: Tube
    canals: tuple[Tube, ...]  # of the labyrinth, its cochlea and what joins them
    vestibule: tuple[Floats, Floats]  # centre and half axes
    ossicles: tuple[Tube, ...]
    antrum: tuple[Floats, Floats]
    aditus: Tube
    ear_canal: Tube
    tympanum: tuple[Floats, Floats]
    tip: Tube
    tegmen: Floats  # height at (12, 6), its slopes along x and y
    fossa: float  # of the plane x + 0.8 y that the posterior fossa begins at

    @classmethod
    def of(cls, seed: int) -> Structures:
        """Places and sizes jittered by the seed, so that no two ears are alike."""
        draw = iter((2.0 * uniform(seed, 2, 64) - 1.0).tolist())

        def jitter(width: float) -> float:
            return round(width * next(draw), 6)

        def shift(width: float) -> Floats:
            return np.array([jitter(width) for _ in range(3)])

        inner = shift(0.4)  # of the labyrinth, and with it nerve and middle ear
        nerve_points = np.array(
            [
                [33.0, -2.5, 1.5],
                [26.0, -6.0, 3.0],
                [22.5, -8.0, 4.2],
                [19.5, -5.5, 2.8],
                [17.9, -2.5, 0.9],
                [16.6, 1.0, -1.0],
                [15.6, 3.2, -2.4],
                [15.1, 4.0, -4.2],
                [14.6, 4.3, -8.0],
                [14.0, 4.2, -15.5],
            ]
        )
        nerve_points[-3:] += np.array([jitter(0.3), jitter(0.6), 0.0])
        nerve = Tube.along(nerve_points + inner, [0.55, 0.5, 0.7, 0.75, 0.8, 0.85, 0.95, 1.0, 1.0, 1.0])
        back = np.array([jitter(0.7), 1.0 + jitter(1.5), 0.0])
        sinus_points = np.array(
            [
                [9.5, 46.0, 9.0],
                [9.0, 34.0, 8.5],
                [9.3, 26.0, 6.0],
                [10.6, 20.0, 0.0],
                [12.7, 16.5, -7.0],
                [16.5, 14.0, -13.5],
                [21.0, 10.0, -17.0],
                [26.0, 5.0, -18.0],
            ]
        )
        sinus = Tube.along(sinus_points + back, SINUS + jitter(0.4), step=2.0)
        canals, vestibule = _labyrinth(inner)
        antrum = (
            np.array([12.0, 6.0, 4.6]) + 0.5 * inner + np.array([0.0, jitter(0.6), 0.0]),
            np.array([3.5, 7.0, 4.5]) * (1 + jitter(0.08)),
        )
        tympanum = (np.array([15.8, -4.0, -2.0]) + inner, np.array([2.1, 4.2, 6.2]))
        aditus = Tube(
            np.array([antrum[0] + [0.5, -4.5, -0.2], tympanum[0] + [0.0, 1.5, 5.0]]), np.array([2.0, 1.7])
        )
        ear_canal = Tube(
            np.array([[-6.0, -3.3, -3.6], [14.2, -4.3, -3.6] + inner * [0.0, 1.0, 1.0]]), np.full(2, CANAL)
        )
        tip = Tube(
            np.array([[9.5, 9.0, -9.0], [8.0, 9.0 + jitter(1.0), -22.0 + jitter(1.0)]]), np.array([9.5, 6.0])
        )
        return cls(
            nerve, sinus, canals, vestibule, _ossicles(inner), antrum, aditus, ear_canal, tympanum, tip,
            tegmen=np.array([11.3 + jitter(0.7), -0.06 + jitter(0.03), 0.03 + jitter(0.04)]),
            fossa=28.7 + jitter(0.5),
        )  # fmt: skip

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """All that is too thin for the lattice: nerve, labyrinth, ossicles."""
        return (self.nerve, *self.canals, *self.ossicles)

    def outside(self, grid: Grid) -> Floats:
        """Signed distance from the bone's outer surface, negative within [mm]."""
        lateral = surface_depth(grid) - grid.open()[0]
        _, y, z = grid.open()
        below = -12.5 - 0.15 * np.clip(y, 0.0, 20.0) - z  # the skull base beside the mastoid process
        base = smooth_min(np.broadcast_to(below, grid.shape), distance_to([self.tip], grid), 3.0)
        return smooth_max(np.broadcast_to(lateral, grid.shape), base, 2.0)

    def cranium(self, grid: Grid) -> Floats:
        """Signed distance from the inside of the skull, negative within [mm]."""
        x, y, z = grid.open()
        floor = self.tegmen[0] + self.tegmen[1] * (x - 12.0) + self.tegmen[2] * (y - 6.0)
        squama = surface_depth(grid) + 4.0 - x
        middle = smooth_max(np.broadcast_to(floor - z, grid.shape), np.broadcast_to(squama, grid.shape), 4.0)
        plane = (self.fossa - x - 0.8 * y) / np.sqrt(1.64)
        posterior = smooth_max(
            np.broadcast_to(plane, grid.shape), np.broadcast_to(squama + 2.0, grid.shape), 4.0
        )
        return smooth_min(middle, posterior, 2.0)

    def hollow(self, grid: Grid) -> Floats:
        """Signed distance from antrum, aditus, middle ear and ear canal, negative within [mm]."""
        rooms = smooth_min(ellipsoid(grid, *self.antrum), distance_to([self.aditus], grid), 1.0)
        rooms = smooth_min(rooms, ellipsoid(grid, *self.tympanum), 1.0)
        return np.asarray(np.minimum(rooms, self.canal(grid)))

    def canal(self, grid: Grid) -> Floats:
        """Signed distance from the ear canal [mm]."""
        return distance_to([self.ear_canal], grid)

    def labyrinth(self, grid: Grid) -> Floats:
        """Signed distance from canals, vestibule and cochlea [mm]."""
        return np.asarray(np.minimum(distance_to(self.canals, grid), ellipsoid(grid, *self.vestibule)))


def surface_depth(grid: Grid) -> Floats:
    """x of the bone's lateral surface: a shallow bowl, 0 at the spine of Henle [mm]."""
    _, y, z = grid.open()
    return np.asarray(0.004 * (y - 8.0) ** 2 + 0.003 * (z + 6.0) ** 2 - 0.364)


def pneumatised(
    at: Structures, outside: Floats, cranium: Floats, hollow: Floats, near: Floats, grid: Grid
) -> Floats:
    """Signed distance from the part that holds air cells [mm]; `near` is that to sinus, nerve and labyrinth."""
    x, y, _ = grid.open()
    limit = np.maximum(outside + CORTEX, PLATE - cranium)
    limit = np.maximum(limit, np.maximum(-hollow, CANAL_WALL - at.canal(grid)))
    return np.asarray(np.maximum(np.maximum(limit, -near), np.maximum(x - DEEPEST, -7.0 - y)))


def keep_away(at: Structures, grid: Grid, sinus: float, nerve: float, labyrinth: float) -> Floats:
    """Signed distance beyond the given margins of sinus, nerve and labyrinth [mm]."""
    out = distance_to([at.sinus], grid) - sinus
    out = np.minimum(out, distance_to([at.nerve], grid) - nerve)
    return np.asarray(np.minimum(np.minimum(out, at.labyrinth(grid) - labyrinth), FAR))


def _labyrinth(shift: Floats) -> tuple[tuple[Tube, ...], tuple[Floats, Floats]]:
    # Radii of curvature: Spoor and Zonneveld, Yearb. Phys. Anthropol. 1998 (human means 3.2, 3.1 and 2.3 mm).
    lateral = Tube.ring(shift + [19.8, 1.0, 1.2], [-0.3, 0.3, 1.0], 2.3, 0.6)
    anterior = Tube.ring(shift + [21.0, 1.0, 4.2], [1.0, -1.0, 0.0], 3.2, 0.55)
    posterior = Tube.ring(shift + [20.6, 6.0, 0.4], [1.0, 1.0, 0.0], 3.1, 0.55)
    centre = shift + [22.2, -0.5, -0.4]
    common = Tube(shift + [[22.9, 3.4, 2.3], [22.4, 1.2, 0.0]], np.full(2, 0.7))
    low = Tube(shift + [[21.4, 5.2, -2.5], [22.2, 1.0, -1.4]], np.full(2, 0.6))
    # 2.5 turns that narrow and rise towards the front and side; the basal turn's outer diameter is near 9 mm.
    axis = np.array([-0.55, -0.8, -0.25])
    axis /= np.linalg.norm(axis)
    one = np.cross(axis, [0.0, 0.0, 1.0])
    one /= np.linalg.norm(one)
    two = np.cross(axis, one)
    t = np.linspace(0.0, 1.0, 61)[:, None]
    angle = 2 * np.pi * 2.5 * t + 0.4
    radius = 3.4 * (1.0 - 0.75 * t)
    spiral = (
        shift
        + [23.6, -5.0, -2.2]
        + radius * (np.cos(angle) * one + np.sin(angle) * two)
        + 3.4 * t * axis
    )
    cochlea = Tube(np.round(spiral, 6), np.linspace(1.05, 0.6, 61))
    start = Tube(np.array([cochlea.points[0], centre]), np.full(2, 1.0))
    return (lateral, anterior, posterior, common, low, cochlea, start), (centre, np.array([1.9, 2.6, 2.4]))


def _ossicles(shift: Floats) -> tuple[Tube, ...]:
    handle = Tube(shift + [[14.6, -4.2, -4.0], [15.4, -4.6, 1.2]], np.array([0.4, 0.7]))
    head = Tube(shift + [[15.4, -4.6, 1.2], [15.7, -3.9, 2.0]], np.array([1.2, 1.2]))
    incus = Tube(shift + [[15.7, -3.0, 2.0], [15.6, -1.0, 1.9]], np.array([1.2, 0.5]))
    long_process = Tube(shift + [[15.7, -2.9, 1.6], [16.6, -3.2, -2.0]], np.array([0.7, 0.4]))
    stapes = Tube(shift + [[16.6, -3.2, -2.0], [19.0, -2.6, -1.6]], np.array([0.4, 0.6]))
    return handle, head, incus, long_process, stapes
