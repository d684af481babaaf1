"""A procedural temporal bone from a seed, at any resolution; it needs no patient's data."""

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Material, Tissues, VoxelBone
from burrlab.bone.image import LabelVolume
from burrlab.bone.materials import materials
from burrlab.bone.phantom.air_cells import AirCells, Honeycomb, honeycomb
from burrlab.bone.phantom.structures import (
    CELLS_BOX,
    DURA,
    Fields,
    Floats,
    Grid,
    Singles,
    Structures,
    distance_to,
    ellipsoid,
    lattice_around,
    share,
)
from burrlab.bone.tissues import default_tissues
from burrlab.common.check import check_memory, real, refuse, require_type
from burrlab.common.progress import Progress, reporter
from burrlab.common.table import by_value

#: Occupancy of nerve, sinus, dura and labyrinth (ours, assumed): softer than bone, but above level 128.
SOFT = 0.6

_NAMES = ("air", "cortex", "mastoid", "facial nerve", "sigmoid sinus", "dura", "labyrinth", "ossicles")
_AIR, _CORTEX, _MASTOID, _NERVE, _SINUS, _DURA, _LABYRINTH, _OSSICLES = range(8)


def phantom_tissues(material: Material = materials["bone"]) -> Tissues:
    """Tissues of a phantom, by `default_tissues`: values of `material`, assumed for all but bone.

    Examples
    --------
    >>> [tissue.name for tissue in phantom_tissues() if tissue.critical]
    ['facial nerve', 'sigmoid sinus', 'dura', 'labyrinth', 'ossicles']
    """
    return default_tissues(_NAMES, material=material)


def paint(
    at: Structures, fields: Fields, cells: Honeycomb, grid: Grid, wall: float, width: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]:
    """Levels, tissue numbers and target of a slab in the frame of a right ear."""
    full = np.float32(1.0)
    numbers = np.full(grid.shape, _CORTEX, dtype=np.uint8)
    part = fields.on("pneumatised", grid)
    rooms = fields.on("rooms", grid)
    inside = (part < np.float32(width)) & (rooms > np.float32(-width))
    numbers[part < 0] = _MASTOID
    from_wall = cells.wall_distance(grid, inside, reach=wall / 2 + width)
    walls = share(from_wall - np.float32(wall / 2), width) - share(from_wall + np.float32(wall / 2), width)
    held = full - share(part, width) * (full - walls)
    held *= full - share(rooms, width)
    cranium = fields.on("cranium", grid)
    beyond, sheet = share(cranium, width), share(cranium + np.float32(DURA), width)
    held *= full - beyond
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
    """Fills a part of each voxel with a tissue.

    A voxel gets the tissue's number if the tissue has half of the voxel, or most of its content.
    """
    before = held * (np.float32(1.0) - part) if replace else held
    added = np.float32(level) * part
    numbers[(part >= np.float32(0.5)) | (added > before)] = number
    return np.asarray(before + added)


#: Lengths of the default box along x, y, z [mm].
SIZE = (34.0, 46.0, 47.0)
#: Corner of the default box of a right ear, least x, y, z [mm].
CORNER = (-2.0, -14.0, -29.0)
#: Most voxels of a phantom (ours); making it takes some gigabytes.
MOST_VOXELS = 4e8
#: Voxels filled at a time; this limits the memory.
AT_A_TIME = 1_000_000


@by_value
@dataclass(frozen=True)
class Phantom:
    """A temporal bone, the places of its structures, and the planned cavity. Made by `temporal_bone`.

    Attributes
    ----------
    bone : VoxelBone
        With tissues. In the bone frame x points to the left of the head, y back and z up (LPS); the origin is
        the spine of Henle. Depth grows with x in a right ear, and against x in a left ear.
    target : ndarray of bool, shape (z, y, x)
        The cavity of a planned simple mastoidectomy.
    landmarks : mapping of str to ndarray, shape (3,)
        Points (x, y, z) [mm].
    entry : ndarray, shape (3,)
        Middle of the planned cavity's opening, on the surface [mm].
    axis : ndarray, shape (3,)
        Unit vector from the entry to the antrum.
    cells : Honeycomb
        Air cells, in the frame of a right ear.
    seed, side
        As given to `temporal_bone`.
    """

    bone: VoxelBone
    target: NDArray[np.bool_] = field(repr=False)
    landmarks: Mapping[str, Floats] = field(repr=False)
    entry: Floats
    axis: Floats
    cells: Honeycomb = field(repr=False)
    seed: int
    side: Literal["right", "left"]

    @property
    def labels(self) -> NDArray[np.uint8]:
        """A copy of the tissue number of each voxel, shape (z, y, x)."""
        return cast(NDArray[np.uint8], self.bone.tissue_numbers)

    @property
    def target_labels(self) -> LabelVolume:
        """Planned cavity as labels, 1 inside, for `write_volume` and `burrlab metrics --target`."""
        origin, spacing = np.array(self.bone.origin), np.array(self.bone.spacing)
        return LabelVolume(
            self.target.astype(np.uint8), spacing, origin, np.eye(3), "planned cavity", {1: "planned cavity"}
        )


def temporal_bone(
    voxel: float | Sequence[float],
    *,
    seed: int,
    size: Sequence[float] = SIZE,
    corner: Sequence[float] | None = None,
    side: Literal["right", "left"] = "right",
    material: Material = materials["bone"],
    air_cells: AirCells = AirCells(),  # noqa: B008
    progress: Progress | None = None,
) -> Phantom:
    """A temporal bone with its air cells, nerve, sinus, dura and labyrinth.

    Parameters
    ----------
    voxel : float or (x, y, z)
        Spacing [mm].
    seed : int
        Another seed is another ear: other cells, and structures shifted by some tenths of a mm to 2 mm.
    size : (x, y, z)
        Sides of the box [mm]; the default holds the mastoid, the middle and the inner ear.
    corner : (x, y, z), optional
        Least coordinates of the box, for a part of the whole [mm].
    side : {"right", "left"}
        A left ear is the mirror image of the right one.
    material : Material
        Material of all tissues.
    air_cells : AirCells
    progress : callable or True, optional
        Called with the fraction done, 0 to 1; True shows a bar.

    Returns
    -------
    Phantom

    Raises
    ------
    ValueError
        If voxel is not 0.02 to 1 mm, size is not positive, the box holds no or too many voxels, the side is
        neither right nor left, or the seed is not in 0..2^64 - 1.

    Notes
    -----
    All values depend on seed and position alone: voxels of any size show the same ear, and a smaller box is a
    part of a larger one, to the bit if both corners are whole voxels from the origin.
    docs/beyond_the_paper.md has numbers and sources.

    Examples
    --------
    >>> from burrlab.anatomy import temporal_bone
    >>> phantom = temporal_bone(0.4, seed=1, size=(8, 8, 8), corner=(0, 4, 0))
    >>> phantom.bone.shape
    (20, 20, 20)
    """
    require_type("material", material, Material, "burrlab.materials['bone']")
    report = reporter(progress, "phantom")
    spacing, grid = _checked_grid(voxel, size, corner, side)
    seed = operator.index(seed)
    refuse(not 0 <= seed < 2**64, f"seed must be a whole number from 0 and below 2^64, got {seed}")
    at = Structures(seed)
    cells = _cells(seed, air_cells.median_diameter, air_cells.geometric_deviation)
    way = -1 if side == "left" else 1  # of x in the frame of a right ear
    painted = Grid(way * grid.x[::way], grid.y, grid.z)
    fields = Fields(at, lattice_around(painted))
    width = float(np.sqrt(np.mean(spacing**2)))  # along a normal, root mean square over directions
    levels, numbers = np.empty((2, *grid.shape), dtype=np.uint8)
    target = np.empty(grid.shape, dtype=np.bool_)
    layers = max(1, AT_A_TIME // (grid.shape[1] * grid.shape[2]))
    for begin in range(0, grid.shape[0], layers):
        rows = slice(begin, begin + layers)
        slab = paint(at, fields, cells, Grid(painted.x, painted.y, painted.z[rows]), air_cells.wall, width)
        levels[rows], numbers[rows], target[rows] = (part[:, :, ::way] for part in slab)
        report(min(1.0, (begin + layers) / grid.shape[0]))
    bone = VoxelBone(levels, spacing=spacing, origin=[float(c[0]) for c in (grid.x, grid.y, grid.z)])
    bone.set_tissues(phantom_tissues(material), numbers)
    landmarks = {name: np.round(point * [way, 1, 1], 6) for name, point in at.landmarks.items()}
    entry = landmarks["entry"]
    axis = (landmarks["antrum"] - entry) / np.linalg.norm(landmarks["antrum"] - entry)
    return Phantom(bone, target, landmarks, entry, axis, cells, seed, side)


def _checked_grid(
    voxel: float | Sequence[float], size: Sequence[float], corner: Sequence[float] | None, side: str
) -> tuple[Floats, Grid]:
    edges = real(voxel, "voxel")
    refuse(
        edges.shape not in ((), (3,)) or not np.all((edges >= 0.02) & (edges <= 1.0)),
        f"voxel must be 0.02 to 1 mm, a number or three, got {voxel!r}",
    )
    spacing = np.broadcast_to(edges, (3,)).copy()
    lengths = real(size, "size")
    refuse(
        lengths.shape != (3,) or not np.all((lengths > 0) & np.isfinite(lengths)),
        f"size must be three positive numbers, got {size!r}",
    )
    refuse(side not in ("right", "left"), f"side must be 'right' or 'left', got {side!r}")
    if corner is None:
        low = np.array(CORNER)
        if side == "left":
            low[0] = -(low[0] + lengths[0])
    else:
        low = real(corner, "corner")
        refuse(
            low.shape != (3,) or not np.all(np.abs(low) < 1000),
            f"corner must be three numbers within 1000 mm, got {corner!r}",
        )
    first = np.rint(low / spacing).astype(np.int64)
    count = np.rint(lengths / spacing).astype(np.int64)
    refuse(
        not 1 <= (voxels := count.prod(dtype=float)) <= MOST_VOXELS or count.min() < 1,
        f"size and voxel must give 1 to {MOST_VOXELS:g} voxels, got {tuple(count.tolist())} along x, y, z",
    )
    check_memory(6.0 * voxels, f"a bone of {voxels:.3g} voxels")  # measured peak while it is made
    x, y, z = ((f + np.arange(n) + 0.5) * s for f, n, s in zip(first, count, spacing, strict=True))
    return spacing, Grid(x, y, z)


@lru_cache(maxsize=4)
def _cells(seed: int, median_diameter: float, geometric_deviation: float) -> Honeycomb:
    low, high = (np.array(corner) for corner in CELLS_BOX)
    fields = Fields(Structures(seed), lattice_around(Grid(*np.transpose([low, high]))))

    def lattice(step: float) -> Floats:
        fine = Grid(*(np.arange(a + step / 2, b, step) for a, b in zip(low, high, strict=True)))
        inside = (fields.on("pneumatised", fine) < 0) & (fields.on("rooms", fine) > 0)
        return fine.points()[inside.ravel()]

    return honeycomb(AirCells(median_diameter, geometric_deviation, wall=0.05), lattice, seed)
