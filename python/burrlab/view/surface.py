"""The bone's surface in blocks of 32^3 voxels, replaced where its bricks changed."""

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone, extract_surface
from burrlab.common.check import refuse
from burrlab.view.camera import Viewpoint

BLOCK = 32  # voxels along an edge
_MARGIN = 2  # voxels around a block that its vertices and normals depend on
_BRICK = 8
_AT_A_TIME = 256  # blocks: Ctrl-C does not wait for all

BlockPlace = tuple[int, int, int]  # (z, y, x)

#: Colour mixed into a freshly cut surface, and its share where all is gone.
_CUT, _CUT_SHARE = (255, 236, 214), 0.45
#: Colour of bone without tissues.
BONE = (227, 218, 201)


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceBlock:
    """Triangles of one block; neighbours repeat the vertices and normals of their common border, to the bit.

    Attributes
    ----------
    points : ndarray, shape (v, 3), float32
        In the bone frame [mm].
    normals : ndarray, shape (v, 3), float32
        Out of the bone, of length 1.
    triangles : ndarray, shape (t, 3), int32
        Vertices, counter-clockwise seen from outside.
    tissues : ndarray, shape (v,), uint8
        Number of the nearest solid voxel's tissue; 0 without tissues.
    lost : ndarray, shape (v,), uint8
        Most levels lost by one of the eight voxels around; above 0 on a cut surface.
    numbers : ndarray, shape (v,), int64
        Of the vertices in the volume: neighbours repeat them, too.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]
    tissues: NDArray[np.uint8]
    lost: NDArray[np.uint8]
    numbers: NDArray[np.int64]

    def __repr__(self) -> str:
        return f"SurfaceBlock({len(self.points)} vertices, {len(self.triangles)} triangles)"

    def colours(self, palette: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Red, green, blue of every vertex, (v, 3): the tissue's, lighter where it was cut."""
        share = (_CUT_SHARE / 255.0) * self.lost[:, None].astype(np.float32)
        return np.asarray(
            palette[self.tissues] * (1 - share) + np.asarray(_CUT, np.float32) * share, np.uint8
        )


def tissue_palette(bone: VoxelBone) -> NDArray[np.uint8]:
    """Red, green, blue by tissue number, (tissues, 3)."""
    return np.array([BONE] if bone.tissues is None else [tissue.colour for tissue in bone.tissues], np.uint8)


def block_counts(bone: VoxelBone) -> BlockPlace:
    """Number of blocks (z, y, x)."""
    nz, ny, nx = (-(-n // BLOCK) for n in bone.shape)
    return nz, ny, nx


def surface_blocks(
    bone: VoxelBone, blocks: Iterable[BlockPlace] | None = None, *, level: int = 128
) -> dict[BlockPlace, SurfaceBlock]:
    """The surface where the level passes from below `level` to at least `level`, by surface nets.

    A cell is a cube of eight voxel centres. Each part of the surface in it has a vertex in the middle of its
    crossings of the cell's edges. There is no bone outside the volume, so that the surface is closed.

    Parameters
    ----------
    bone : VoxelBone
        Not to be changed by another thread meanwhile.
    blocks : iterable of (z, y, x), optional
        Default: all.
    level : int
        Occupancy level at the surface, 1 to 255.

    Returns
    -------
    dict
        (z, y, x) -> SurfaceBlock; blocks without a surface are left out.

    Raises
    ------
    ValueError
        If there is no such block, or the level is not from 1 to 255.

    References
    ----------
    Gibson, *Constrained elastic surface nets*, MICCAI 1998; without the relaxation. Nielson, *Dual marching
    cubes*, IEEE Visualization 2004: the parts.

    Examples
    --------
    >>> import burrlab
    >>> surface_blocks(burrlab.VoxelBone.block((1, 1, 1), 0.1))
    {(0, 0, 0): SurfaceBlock(602 vertices, 1200 triangles)}
    """
    if blocks is None:
        nz, ny, nx = block_counts(bone)
        wanted = list(itertools.product(range(nz), range(ny), range(nx)))
    else:
        wanted = [(int(z), int(y), int(x)) for z, y, x in blocks]
    by_block = {}
    for k in range(0, len(wanted), _AT_A_TIME):
        some = wanted[k : k + _AT_A_TIME]
        extracted = extract_surface(bone, np.array(some, np.int64).reshape(-1, 3), level)
        by_block.update({block: SurfaceBlock(*arrays) for block, arrays in zip(some, extracted, strict=True)})
    return {block: surface for block, surface in by_block.items() if len(surface.points)}


def brick_places(bricks: ArrayLike, bone: VoxelBone) -> NDArray[np.int64]:
    """Places (z, y, x) of bricks, shape (n, 3), from their numbers, shape (n,); places stay as they are.

    Raises
    ------
    ValueError
        If bricks have another shape, or one is not in the bone.
    """
    places = np.asarray(bricks, np.int64)
    counts = np.array([-(-n // _BRICK) for n in bone.shape])
    if places.size == 0:
        return np.zeros((0, 3), np.int64)
    if places.ndim == 1:
        refuse(
            places.min() < 0 or places.max() >= counts.prod(),
            f"bricks must be from 0 to below {counts.prod()}, got {places.min()} to {places.max()}",
        )
        return np.stack(np.unravel_index(places, tuple(counts)), axis=1)
    refuse(
        places.ndim != 2 or places.shape[1] != 3,
        f"bricks must have the shape (n,) or (n, 3), got {places.shape}",
    )
    refuse(
        (places < 0).any() or (places >= counts).any(),
        f"bricks must lie within {tuple(counts.tolist())} (z, y, x)",
    )
    return places


def brick_numbers(bricks: ArrayLike, bone: VoxelBone) -> NDArray[np.uint32]:
    """The inverse of `brick_places`; numbers stay as they are. ValueError as in `brick_places`."""
    counts = tuple(-(-n // _BRICK) for n in bone.shape)
    z, y, x = brick_places(bricks, bone).T
    return np.asarray((z * counts[1] + y) * counts[2] + x, np.uint32)


def blocks_of_bricks(bricks: ArrayLike, bone: VoxelBone) -> list[BlockPlace]:
    """Sorted blocks whose surface depends on a voxel of these bricks.

    Parameters
    ----------
    bricks : array_like, shape (n,) or (n, 3)
        Bricks of 8^3 voxels, by number or place (z, y, x).
    bone : VoxelBone

    Raises
    ------
    ValueError
        If bricks have another shape, or one is not in the bone.
    """
    places = brick_places(bricks, bone)
    low = np.maximum((places * _BRICK - _MARGIN) // BLOCK, 0)
    high = np.minimum((places * _BRICK + _BRICK - 1 + _MARGIN) // BLOCK, np.array(block_counts(bone)) - 1)
    blocks: set[BlockPlace] = set()
    for z0, y0, x0, z1, y1, x1 in np.unique(np.hstack([low, high]), axis=0).tolist():
        blocks.update(itertools.product(range(z0, z1 + 1), range(y0, y1 + 1), range(x0, x1 + 1)))
    return sorted(blocks)


_FACING = 0.3  # cosine up to which a vertex faces the eye: its triangles turn less or more than itself


def blocks_in_sight(
    blocks: Mapping[BlockPlace, SurfaceBlock], viewpoint: Viewpoint, size: tuple[int, int], voxel: float
) -> set[BlockPlace]:
    """Blocks that a viewpoint sees or may see.

    The vertices that face the eye are put into a buffer of depths. Its pixels are a quarter wider than a voxel
    at the camera's focus, or the window's if those are wider. A block is seen if one of its vertices lies at
    most two voxels behind its pixel's depth, or outside the buffer. Hidden by mistake is only what shows
    through gaps narrower than such a pixel.

    Parameters
    ----------
    blocks : mapping
        (z, y, x) -> SurfaceBlock
    viewpoint : Viewpoint
    size : (width, height)
        Of the window [pixel].
    voxel : float
        Longest edge of a voxel [mm].
    """
    eye, focus = np.array(viewpoint.position), np.array(viewpoint.focus)
    ahead = (focus - eye) / viewpoint.distance
    right = np.cross(ahead, viewpoint.up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead), ahead], axis=1).astype(np.float32)
    scale = size[1] / 2 / np.tan(np.deg2rad(viewpoint.angle) / 2)  # [pixel] at a distance of 1
    pixel = max(1.25 * voxel * scale / viewpoint.distance, 1.0)
    width, height = (int(n / pixel) + 1 for n in size)
    depths = np.full(width * height, np.inf, np.float32)
    seen, inside = set(), {}
    for block, block_surface in blocks.items():
        away = block_surface.points - eye.astype(np.float32)
        facing = np.einsum("ij,ij->i", away, block_surface.normals)
        x, y, depth = (away @ axes)[facing < _FACING * viewpoint.distance].T
        if not len(depth):
            continue
        if depth.min() <= 0:
            seen.add(block)
            continue
        x, y = ((scale * x / depth + size[0] / 2) / pixel, (scale * y / depth + size[1] / 2) / pixel)
        within = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        if not within.all():
            seen.add(block)
        places = y[within].astype(np.int32) * width + x[within].astype(np.int32)
        inside[block] = places, depth[within]
        np.minimum.at(depths, *inside[block])
    depths += 2 * voxel
    return seen.union(block for block, (places, depth) in inside.items() if (depth <= depths[places]).any())


class Surface:
    """The surface blocks of a bone, kept up to date with it.

    Parameters
    ----------
    bone : VoxelBone
    level : int
        Occupancy level at the surface, 1 to 255.

    Raises
    ------
    ValueError
        If the level is not from 1 to 255.
    """

    def __init__(self, bone: VoxelBone, *, level: int = 128) -> None:
        self.level = level
        self.counts = block_counts(bone)
        self.blocks = surface_blocks(bone, level=level)

    def update(self, bone: VoxelBone, bricks: ArrayLike | None = None) -> list[BlockPlace]:
        """Renews the blocks that depend on changed bricks; None: all.

        Parameters
        ----------
        bone : VoxelBone
            Of the same shape.
        bricks : array_like, shape (n,) or (n, 3), optional
            Changed bricks, by number or place (z, y, x).

        Returns
        -------
        list of (z, y, x)
            Blocks renewed or gone.

        Raises
        ------
        ValueError
            If bone or bricks have another shape.
        """
        refuse(
            block_counts(bone) != self.counts, f"bone must have the shape of the surface, got {bone.shape}"
        )
        if bricks is None:
            before = set(self.blocks)
            self.blocks = surface_blocks(bone, level=self.level)
            return sorted(before | set(self.blocks))
        wanted = blocks_of_bricks(bricks, bone)
        extracted = surface_blocks(bone, wanted, level=self.level)
        gone = self.blocks.keys() & set(wanted) - extracted.keys()
        for block in gone:
            del self.blocks[block]
        self.blocks.update(extracted)
        return sorted(gone | extracted.keys())

    def merged(self) -> SurfaceBlock:
        """One mesh of all blocks; vertices on common borders stay doubled."""
        none = SurfaceBlock(
            np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32),
            np.zeros(0, np.uint8), np.zeros(0, np.uint8), np.zeros(0, np.int64),
        )  # fmt: skip
        blocks = [none, *self.blocks.values()]
        first = np.cumsum([0, *(len(block.points) for block in blocks[:-1])], dtype=np.int32)
        parts = {f.name: [getattr(block, f.name) for block in blocks] for f in fields(none)}
        parts["triangles"] = [part + n for part, n in zip(parts["triangles"], first, strict=True)]
        return SurfaceBlock(**{name: np.concatenate(part) for name, part in parts.items()})
