"""The scenes of the benchmark: solid bone below a surface, air above, a burr and its path in the volume."""

from dataclasses import dataclass, field

import numpy as np
from native import Burring, Levels, Numbers

SPEED = 20.0  # of a slide [mm/s]
SLIDE_TICKS = 3000
#: R/voxel of the scenes that show how the cost grows; R = 5 mm.
RESOLUTIONS = (12.5, 25.0, 50.0, 100.0)
LARGE_RADIUS = 5.0  # [mm]
OFF_GRID = np.array([0.137, 0.291, 0.0])  # place within a voxel [voxel], so that no symmetry helps


@dataclass(frozen=True)
class Effort:
    """How often each implementation is timed.

    Parameters
    ----------
    samples : int
        States of a run at which all implementations are compared side by side.
    burst : int
        Ticks at each.
    warm : int
        First ticks of these, not counted: caches and branch prediction settle.
    """

    samples: int = 20
    burst: int = 8
    warm: int = 4


@dataclass(frozen=True)
class Scene:
    """A bone, a burr and its path.

    Parameters
    ----------
    name : str
    about : str
    burring : Burring
    shape : (nz, ny, nx)
    surface : int
        Layers along z that hold bone.
    path : ndarray, shape (n, 3)
        Burr centres (x, y, z) [mm].
    varied : bool
        Whether levels are drawn from 64..255 instead of solid bone.
    fresh : bool
        Whether every tick begins with the bone as loaded.
    batch : int
        Ticks per reading of the clock.
    effort : Effort
    """

    name: str
    about: str
    burring: Burring
    shape: tuple[int, int, int]
    surface: int
    path: Numbers
    varied: bool = False
    fresh: bool = False
    batch: int = 1
    effort: Effort = field(default_factory=Effort)

    def levels(self) -> Levels:
        """Pristine levels."""
        p = np.zeros(self.shape, dtype=np.uint8)
        p[: self.surface] = 255
        if self.varied:
            p[: self.surface] = np.random.default_rng(1).integers(
                64, 256, p[: self.surface].shape, dtype=np.uint8
            )
        return p

    @property
    def resolution(self) -> float:
        """R/voxel."""
        return self.burring.radius / self.burring.spacing


def effort_at(resolution: float, quick: bool) -> Effort:
    """Fewer comparisons where a tick takes long."""
    if quick:
        return Effort(samples=2, burst=3, warm=1)
    return Effort() if resolution <= 50 else Effort(samples=6, burst=5, warm=2)


def voxels(length: float, spacing: float) -> int:
    """Voxels along a length [mm]."""
    return int(np.ceil(length / spacing - 1e-6))


def surface_at(layers: int, spacing: float) -> float:
    """Height of the surface of `layers` of bone [mm]."""
    return (layers - 0.5) * spacing


def along_x(
    burring: Burring, travel: Numbers, height: float, begin: float = 0.0, y: float | None = None
) -> Numbers:
    """Centres on a line, two voxels from the volume's edges or from `begin`, or at `y` [mm]."""
    x, other = burring.radius + 2 * burring.spacing + begin + OFF_GRID[:2] * burring.spacing
    return np.stack(
        [x + travel, np.full_like(travel, other if y is None else y), np.full_like(travel, height)], axis=1
    )


def slide(
    radius: float,
    spacing: float,
    *,
    scheme: str = "layer",
    varied: bool = False,
    ticks: int = SLIDE_TICKS,
    quick: bool = False,
) -> Scene:
    """Scene of a burr sunk to R/3 that cuts fresh bone at 20 mm/s."""
    burring, resolution = Burring(spacing, radius, scheme), radius / spacing
    layers, side = voxels(radius / 3, spacing) + 4, voxels(2 * radius, spacing) + 6
    travel = SPEED * 1e-3 * burring.dt * np.arange(ticks)
    path = along_x(burring, travel, surface_at(layers, spacing) + 2 * radius / 3)
    shape = (layers + voxels(5 * radius / 3, spacing) + 3, side, side + voxels(float(travel[-1]), spacing))
    name = f"slide {resolution:g}" + (f" R {radius:g}" if radius != LARGE_RADIUS else "")
    name += ("" if scheme == "layer" else f" {scheme}") + (" varied" if varied else "")
    about = "sunk to R/3, 20 mm/s through fresh bone, cutting" + (
        ", levels 64..255 at random" if varied else ""
    )
    return Scene(name, about, burring, shape, layers, path, varied, effort=effort_at(resolution, quick))


def buried(radius: float, spacing: float, *, quick: bool = False) -> Scene:
    """Scene of a sphere wholly in solid bone, fresh at every tick, at places within a voxel of each other."""
    resolution = radius / spacing
    ticks = 20 if quick else int(np.clip(4e7 / resolution**3, 40, 400))
    side = voxels(2 * radius, spacing) + 6
    shift = np.random.default_rng(1).uniform(-0.5, 0.5, (ticks, 3))
    path = (0.5 * (side - 1) + shift) * spacing
    return Scene(f"buried {resolution:g}",
        "wholly in solid bone, fresh at every tick", Burring(spacing, radius),
                 (side, side, side), side, path, fresh=True,
                 effort=effort_at(resolution, quick))  # fmt: skip


def air(radius: float, spacing: float, *, near: bool, quick: bool = False) -> Scene:
    """Scene of a burr without contact: a radius above the bone, or just above its surface."""
    ticks, resolution, burring = 1000 if quick else 4000, radius / spacing, Burring(spacing, radius)
    layers, across = voxels(radius, spacing), voxels(3.2 * radius, spacing)
    travel = SPEED * 1e-3 * np.arange(ticks) % (across * spacing - 2 * (radius + 3 * spacing))
    height, room = (radius + 0.01 * spacing, 2) if near else (2 * radius, 3)
    path = along_x(burring, travel, surface_at(layers, spacing) + height)
    shape = (layers + voxels(room * radius, spacing) + 4, voxels(2 * radius, spacing) + 6, across)
    kind, where = ("near", "just above the surface") if near else ("far", "a radius above the surface")
    return Scene(f"air {kind} {resolution:g}", f"{where}, no contact", burring, shape, layers, path, batch=20,
                 effort=effort_at(resolution, quick))  # fmt: skip


def descent(resolution: float, *, quick: bool = False) -> tuple[Scene, Numbers, Numbers]:
    """Begin of a descent at held force: a scene without a path, start (x, y, z) [mm] and axis."""
    radius, spacing = 3.0, 3.0 / resolution
    burring = Burring(spacing, radius)
    layers = voxels(radius / 3, spacing) + 6
    side = voxels(2 * radius, spacing) + 6
    start = (0.5 * (side - 1) + OFF_GRID) * spacing
    start[2] = surface_at(layers, spacing) + radius
    scene = Scene(f"descent {resolution:g}", "1 N held exactly, R = 3 mm, to R/3", burring,
                  (layers + voxels(2 * radius, spacing) + 6, side, side), layers, np.empty((0, 3)),
                  effort=effort_at(resolution, quick))  # fmt: skip
    return scene, start, np.array([0.0, 0.0, -1.0])


def volume(side: int, *, quick: bool = False) -> Scene:
    """Scene of a slide in a cube of `side` voxels of 0.1 mm, always at the same place within the bricks."""
    radius, spacing, small, ticks = (2.5, 0.2, 64, 200) if quick else (LARGE_RADIUS, 0.1, 256, 600)
    burring, layers = Burring(spacing, radius), side - voxels(5 * radius / 3, spacing) - 8
    offset = (side - small) // 2 // 64 * 64  # whole blocks of bricks
    travel, height = (
        SPEED * 1e-3 * burring.dt * np.arange(ticks),
        surface_at(layers, spacing) + 2 * radius / 3,
    )
    path = along_x(burring, travel, height, offset * spacing, (offset + 0.5 * small + OFF_GRID[1]) * spacing)
    return Scene(f"volume {side}", f"slide in {side}^3 voxels", burring, (side, side, side), layers, path)


def growing(quick: bool) -> list[Scene]:
    """All scenes timed alike: those that grow with R/voxel, and the named targets."""
    resolutions = (12.5, 25.0) if quick else RESOLUTIONS
    ticks = 200 if quick else SLIDE_TICKS
    scenes = []
    for resolution in resolutions:
        spacing = LARGE_RADIUS / resolution
        scenes += [
            slide(LARGE_RADIUS, spacing, ticks=ticks, quick=quick),
            buried(LARGE_RADIUS, spacing, quick=quick),
            air(LARGE_RADIUS, spacing, near=True, quick=quick),
            air(LARGE_RADIUS, spacing, near=False, quick=quick),
        ]
    fine = LARGE_RADIUS / (resolutions[-1] if quick else 50.0)
    scenes.append(slide(2.5, 0.2, ticks=ticks, quick=quick))
    scenes.append(slide(LARGE_RADIUS, fine, scheme="cell", ticks=ticks, quick=quick))
    scenes.append(slide(LARGE_RADIUS, fine, varied=True, ticks=ticks, quick=quick))
    return scenes
