"""Where things are in the phantom: surfaces, plates, tubes and their sizes, for a right ear.

The frame has its origin at the spine of Henle, on the bone's surface; x is depth (towards the middle of the head), y points
back, z up [mm].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from burrlab.anatomy.air_cells import uniform
from burrlab.anatomy.implicit import Floats, Grid, Tube

#: Thickness of the dura [mm], assumed.
DURA = 1.0
#: Radius of the bony ear canal [mm], assumed; of the sigmoid sinus [mm], assumed.
CANAL, SINUS = 4.2, 4.5


@dataclass(frozen=True, eq=False)
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
    genu: int  # of the nerve's points
    fossa: float  # of the plane x + 0.8 y that the posterior fossa begins at

    @classmethod
    def of(cls, seed: int) -> Structures:
        """Places and sizes jittered by the seed, so that no two ears are alike."""
        draw = iter((2.0 * uniform(seed, 2, 64) - 1.0).tolist())

        def jitter(width: float) -> float:
            return float(round(width * next(draw), 6))

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
        nerve_points = nerve_points + inner
        nerve = Tube.along(nerve_points, [0.55, 0.5, 0.7, 0.75, 0.8, 0.85, 0.95, 1.0, 1.0, 1.0])
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
            genu=int(np.argmin(np.linalg.norm(nerve.points - nerve_points[6], axis=1))), fossa=28.7 + jitter(0.5),
        )  # fmt: skip

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """All that is too thin for the lattice: nerve, labyrinth, ossicles."""
        return (self.nerve, *self.canals, *self.ossicles)

    @property
    def landmarks(self) -> dict[str, Floats]:
        """Points by name [mm]."""
        y, z = self.antrum[0][1] + 2.0, self.antrum[0][2] - 5.0
        surface = surface_depth(Grid(np.zeros(1), np.array([y]), np.array([z])))
        return {
            "spine of Henle": np.zeros(3), "entry": np.array([float(surface.ravel()[0]), y, z]),
            "antrum": self.antrum[0], "second genu": self.nerve.points[self.genu],
            "stylomastoid foramen": self.nerve.points[-1],
            "lateral canal": self.canals[0].points[:-1].mean(axis=0),
            "sigmoid sinus": self.sinus.points[np.argmin(np.abs(self.sinus.points[:, 2]))],
            "mastoid tip": self.tip.points[1] - [0.0, 0.0, self.tip.radius[1]],
            "tegmen": np.array([12.0, 6.0, self.tegmen[0]]),
        }  # fmt: skip


def surface_depth(grid: Grid) -> Floats:
    """x of the bone's lateral surface: a shallow bowl, 0 at the spine of Henle [mm]."""
    _, y, z = grid.open()
    return np.asarray(0.004 * (y - 8.0) ** 2 + 0.003 * (z + 6.0) ** 2 - 0.364)


def _labyrinth(shift: Floats) -> tuple[tuple[Tube, ...], tuple[Floats, Floats]]:
    # Radii of curvature: Spoor and Zonneveld, Yearb. Phys. Anthropol. 1998 (human means 3.2, 3.1 and 2.3 mm).
    lateral = Tube.ring(shift + [20.2, 1.2, 1.5], [-0.3, 0.3, 1.0], 2.3, 0.6)
    anterior = Tube.ring(shift + [21.0, 1.0, 4.2], [1.0, -1.0, 0.0], 3.2, 0.55)
    posterior = Tube.ring(shift + [20.6, 6.0, 0.4], [1.0, 1.0, 0.0], 3.1, 0.55)
    centre = shift + [22.2, -0.5, -0.4]
    common = Tube(shift + [[22.9, 3.4, 2.3], [22.4, 1.2, 0.0]], np.full(2, 0.7))
    low = Tube(shift + [[21.4, 5.2, -2.5], [22.2, 1.0, -1.4]], np.full(2, 0.6))
    # 2.5 turns, 9.2 mm across and 5.1 mm high, that narrow and rise towards the front and side.
    axis = np.array([-0.55, -0.8, -0.25])
    axis /= np.linalg.norm(axis)
    one = np.cross(axis, [0.0, 0.0, 1.0])
    one /= np.linalg.norm(one)
    two = np.cross(axis, one)
    t = np.linspace(0.0, 1.0, 61)[:, None]
    angle = 2 * np.pi * 2.5 * t + 0.4
    radius = 3.9 * (1.0 - 0.75 * t)
    spiral = (
        shift + [23.6, -5.0, -2.2] + radius * (np.cos(angle) * one + np.sin(angle) * two) + 3.4 * t * axis
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
