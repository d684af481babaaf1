"""The scenes of the benchmark: solid bone below a surface, air above, a burr and its path in the volume."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from native import Burring, Levels, Numbers

SPEED = 20.0  # of a slide [mm/s]
SLIDE_TICKS = 3000
#: R/voxel of the scenes that show how the cost grows; R = 5 mm.
RESOLUTIONS = (12.5, 25.0, 50.0, 100.0)
LARGE_RADIUS = 5.0  # [mm]
OFF_GRID = np.array([0.137, 0.291, 0.0])  # place within a voxel [voxel], so that no symmetry helps


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
    fresh : bool
        Whether every tick begins with the bone as loaded.
    batch : int
        Ticks per reading of the clock.
    samples, burst : int
        States of a run at which all implementations are compared side by side, and ticks at each.
    """

    name: str
    about: str
    burring: Burring
    shape: tuple[int, int, int]
    surface: int
    path: Numbers
    fresh: bool = False
    batch: int = 1
    samples: int = 20
    burst: int = 8

    def levels(self) -> Levels:
        """Pristine levels."""
        p = np.zeros(self.shape, dtype=np.uint8)
        p[: self.surface] = 255
        return p

    @property
    def resolution(self) -> float:
        """R/voxel."""
        return self.burring.radius / self.burring.spacing


def effort(resolution: float, quick: bool) -> dict[str, int]:
    """Samples and ticks at each: fewer where a tick takes long."""
    if quick:
        return {"samples": 2, "burst": 3}
    return {} if resolution <= 50 else {"samples": 6, "burst": 5}


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
    ticks: int = SLIDE_TICKS,
    quick: bool = False,
) -> Scene:
    """Scene of a burr sunk to R/3 that cuts fresh bone at 20 mm/s."""
    burring, resolution = Burring(spacing, radius), radius / spacing
    layers, side = voxels(radius / 3, spacing) + 4, voxels(2 * radius, spacing) + 6
    travel = SPEED * 1e-3 * burring.dt * np.arange(ticks)
    path = along_x(burring, travel, surface_at(layers, spacing) + 2 * radius / 3)
    shape = (layers + voxels(5 * radius / 3, spacing) + 3, side, side + voxels(float(travel[-1]), spacing))
    name = f"slide {resolution:g}" + (f" R {radius:g}" if radius != LARGE_RADIUS else "")
    return Scene(name, "sunk to R/3, 20 mm/s through fresh bone, cutting", burring, shape, layers, path,
                 **effort(resolution, quick))  # fmt: skip


def buried(radius: float, spacing: float, *, quick: bool = False) -> Scene:
    """Scene of a sphere wholly in solid bone, fresh at every tick, at places within a voxel of each other."""
    resolution = radius / spacing
    ticks = 20 if quick else int(np.clip(4e7 / resolution**3, 40, 400))
    side = voxels(2 * radius, spacing) + 6
    path = (0.5 * (side - 1) + np.random.default_rng(1).uniform(-0.5, 0.5, (ticks, 3))) * spacing
    return Scene(f"buried {resolution:g}",
        "wholly in solid bone, fresh at every tick", Burring(spacing, radius),
                 (side, side, side), side, path, fresh=True,
                 **effort(resolution, quick))  # fmt: skip


def air(radius: float, spacing: float, *, quick: bool = False) -> Scene:
    """Scene of a burr a radius above the bone."""
    ticks, resolution, burring = 1000 if quick else 4000, radius / spacing, Burring(spacing, radius)
    layers, across = voxels(radius, spacing), voxels(3.2 * radius, spacing)
    travel = SPEED * 1e-3 * np.arange(ticks) % (across * spacing - 2 * (radius + 3 * spacing))
    path = along_x(burring, travel, surface_at(layers, spacing) + 2 * radius)
    shape = (layers + voxels(3 * radius, spacing) + 4, voxels(2 * radius, spacing) + 6, across)
    return Scene(f"air {resolution:g}", "a radius above the surface, no contact", burring, shape, layers, path,
                 batch=20, **effort(resolution, quick))  # fmt: skip


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
    """All scenes timed alike: those that grow with R/voxel, and a smaller burr on coarser voxels."""
    slides = partial(slide, ticks=200 if quick else SLIDE_TICKS)
    spacings = [LARGE_RADIUS / resolution for resolution in ((12.5, 25.0) if quick else RESOLUTIONS)]
    scenes = [make(LARGE_RADIUS, s, quick=quick) for s in spacings for make in (slides, buried, air)]
    return [*scenes, slides(2.5, 0.2, quick=quick)]
