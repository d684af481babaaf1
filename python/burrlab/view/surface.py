"""The bone's surface in blocks of 32^3 voxels, replaced where its bricks changed; closed meshes, their files and
their distance."""

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone, extract_surface
from burrlab.common.check import refuse, require_type
from burrlab.common.files import new_file
from burrlab.common.progress import doing
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
    wanted = [
        (int(z), int(y), int(x)) for z, y, x in (np.ndindex(block_counts(bone)) if blocks is None else blocks)
    ]
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
    return np.asarray(np.ravel_multi_index(tuple(brick_places(bricks, bone).T), counts), np.uint32)


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
    return sorted({
        block
        for z0, y0, x0, z1, y1, x1 in np.unique(np.hstack([low, high]), axis=0).tolist()
        for block in itertools.product(range(z0, z1 + 1), range(y0, y1 + 1), range(x0, x1 + 1))
    })  # fmt: skip


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
        wanted = list(np.ndindex(self.counts)) if bricks is None else blocks_of_bricks(bricks, bone)
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


Array = NDArray[np.float64]
#: Vertices (v, 3) [mm], and three of their numbers for each triangle (t, 3).
Mesh = tuple[Array, NDArray[np.int32]]


@doing("making a surface")
def closed_surface(bone: VoxelBone, *, left: bool = False, level: int | None = None) -> Mesh:
    """The surface of what was removed from a bone, or of what is left, closed also at the volume's border.

    Parameters
    ----------
    bone : VoxelBone
    left : bool
        What is left instead of what was removed.
    level : int, optional
        Levels that a voxel at the surface lost, or has left, 1 to 255. By default that at which the surface
        holds the volume of the voxels, which is the sum of these levels. If none does within 1 %, half of the
        most that a voxel lost, or has left.

    Returns
    -------
    vertices : ndarray, shape (v, 3)
        In the bone frame [mm].
    faces : ndarray, shape (t, 3), int32
        Triangles, counter-clockwise seen from outside. Each edge belongs to two of them, each vertex to one
        fan of them: the surface is a manifold without border, perhaps of several pieces.

    Raises
    ------
    ValueError
        If nothing was removed, or nothing is left, or the level is below 1 or above that of every voxel.

    Notes
    -----
    A burr leaves a layer of voxels that it removed in part. The surface at half a voxel (level 128, as the view
    shows it) can hold some per cent more or less than the layer and walls thinner than a voxel do; so the
    default is another level, mostly from 115 to 140. No level holds the volume of a few voxels, whose corners
    the mesher cuts off, nor that of soft tissue, whose voxels are full at a level below 255.

    Examples
    --------
    >>> import burrlab
    >>> bone = burrlab.VoxelBone.block((4, 4, 4), 0.1)
    >>> contact = burrlab.BurrContact(bone, burrlab.Burr(1), burrlab.materials["bone"], seed=1)
    >>> _ = contact.run([(2, 2, 4)] * 100, 1.0)
    >>> vertices, faces = closed_surface(bone)
    >>> abs(enclosed_volume(vertices, faces) / bone.removed - 1) < 0.01
    True
    """
    require_type("bone", bone, VoxelBone, "VoxelBone.block((10, 10, 5), 0.1)")
    levels, whole = (bone.density, bone.mass) if left else (bone.pristine - bone.density, bone.removed)
    most, wanted = int(levels.max()), level or 1
    refuse(
        most < wanted,
        f"bone has no voxel that {'has' if left else 'lost'} {wanted} of 255 levels"
        + ("" if left or level else "; left=True (--left) is the surface of what is left"),
    )
    field = VoxelBone(levels, bone.spacing)  # near the origin the core's float32 are fine enough
    surface, step, excess = Surface(field, level=level or 128), 64, dict[int, float]()
    while level is None and surface.level not in excess:
        inside = sum(enclosed_volume(block.points, block.triangles) for block in surface.blocks.values())
        excess[surface.level] = off = inside / whole - 1.0
        if abs(off) > 0.002:
            surface, step = Surface(field, level=surface.level + (step if off > 0 else -step)), step // 2
    if level is None:
        best, off = min(excess.items(), key=lambda pair: abs(pair[1]))
        level = best if abs(off) < 0.01 else (most + 1) // 2
    merged = (surface if surface.level == level else Surface(field, level=level)).merged()
    _, vertices, joined = np.unique(merged.numbers, return_index=True, return_inverse=True)
    return merged.points[vertices] + np.array(bone.origin), joined[merged.triangles].astype(np.int32)


def enclosed_volume(points: NDArray[np.floating], faces: NDArray[np.integer]) -> float:
    """Volume inside of a closed mesh near the origin, or of all blocks of a surface in sum [mm^3]."""
    return float(np.linalg.det(np.asarray(points, float)[faces]).sum()) / 6.0


def write_surface(path: str, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
    """Writes a mesh as binary STL or PLY, by the path's ending.

    ValueError if the vertices are so far away that STL's float32 cannot tell them apart; PLY has float64.
    """
    if path.lower().endswith(".stl"):
        single = vertices.astype(np.float32)
        keys = single.view(np.uint32) @ np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 1], np.uint64)
        refuse(
            len(np.unique(keys)) < len(keys) and len(np.unique(single, axis=0)) < len(single),
            f"STL cannot hold a surface so far from the origin, {np.abs(vertices).max():.6g} mm: its numbers "
            "have 7 digits; PLY can",
        )
        normals = np.cross(*np.moveaxis(np.diff(single[faces], axis=1), 1, 0))
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        rows = np.rec.fromarrays(
            [normals, single[faces], np.zeros(len(faces))], formats="(3,)<f4,(3,3)<f4,<u2"
        )
        head = b"burrlab, lengths in mm".ljust(80) + len(faces).to_bytes(4, "little")
    else:
        rows = np.rec.fromarrays([np.full(len(faces), 3), faces], formats="u1,(3,)<i4")
        head = (
            "ply\nformat binary_little_endian 1.0\ncomment burrlab, lengths in mm\n"
            f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
            f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        ).encode() + vertices.astype("<f8").tobytes()
    with new_file(path) as part:
        part.write_bytes(head + rows.tobytes())


@doing("comparing surfaces")
def surface_distance(a: VoxelBone | Mesh, b: VoxelBone | Mesh) -> tuple[float, float, float]:
    """Mean, 95th percentile and largest distance of two surfaces, such as a drilled and a simulated cavity.

    Parameters
    ----------
    a, b : VoxelBone or (vertices, faces)
        Of a bone, the surface of what was removed, `closed_surface(bone)`. Or triangles as `closed_surface`
        gives them, or of another program: vertices (v, 3) [mm], faces (t, 3). Both in one frame.

    Returns
    -------
    mean, percentile_95, largest : float
        [mm]

    Raises
    ------
    ValueError
        If nothing was removed from a bone, or triangles are damaged.

    Notes
    -----
    d(x, S) is the distance from a point to the nearest point of a surface's triangles, exact but for rounding.
    x are 20 000 points, spread evenly over the area of each surface.

    - mean: of d(x, B) over the area of A and d(x, A) over the area of B together, by area;
    - 95th percentile: the larger one of d(x, B) over the area of A and of d(x, A) over that of B;
    - largest: the larger one of the two ways (Hausdorff), also of the vertices.

    They are the average symmetric surface distance and the Hausdorff distances of reviews of such measures,
    over the area, as by Nikolov et al. A cavity counts with all of its surface, also where it opens.

    References
    ----------
    Nikolov et al., *Clinically applicable segmentation of head and neck anatomy for radiotherapy*, J Med
    Internet Res 23 (2021) e26151. Maier-Hein et al., *Metrics reloaded*, Nature Methods 21 (2024) 195-212.

    Examples
    --------
    Cavities of burrs of 1 and 1.2 mm, at the same place:

    >>> import burrlab
    >>> def drilled(radius):
    ...     bone = burrlab.VoxelBone.block((4, 4, 4), 0.1)
    ...     contact = burrlab.BurrContact(bone, burrlab.Burr(radius), burrlab.materials["bone"], seed=1)
    ...     contact.run([(2, 2, 4)] * 1000, 1.0)
    ...     return bone
    >>> mean, percentile_95, largest = surface_distance(drilled(1.0), drilled(1.2))
    >>> 0.1 < mean < percentile_95 <= largest < 0.3
    True
    """
    meshes = [_triangles(name, of) for name, of in (("a", a), ("b", b))]
    (there, far, area), (back, far_back, area_back) = (
        (*_distances(*mesh, _split(corners, 4.0 * np.sqrt(_areas(corners).mean()))), _areas(mesh[1]).sum())
        for mesh, (_, corners) in (meshes, meshes[::-1])
    )
    return (
        float((there.mean() * area + back.mean() * area_back) / (area + area_back)),
        float(max(np.percentile(distances, 95) for distances in (there, back))),
        max(far, far_back),
    )


def _triangles(name: str, of: VoxelBone | Mesh) -> tuple[Array, Array]:
    """Vertices of a surface, and the corners of its triangles, (t, 3, 3); ValueError if they are none."""
    vertices, faces = map(np.asarray, closed_surface(of) if isinstance(of, VoxelBone) else of)
    refuse(
        vertices.shape[1:] != (3,) or not np.isfinite(vertices).all() or faces.shape[1:] != (3,)
        or faces.dtype.kind not in "iu" or not faces.size or faces.min() < 0 or faces.max() >= len(vertices)
        or not _areas(vertices[faces].astype(float)).any(),
        f"{name} must be a bone, or finite vertices (v, 3) and three of their numbers for each triangle (t, 3), "
        f"got {vertices.shape} and {faces.shape}",
    )  # fmt: skip
    return vertices[np.unique(faces)], np.asarray(vertices[faces], float)


def _areas(corners: Array) -> Array:
    return np.asarray(np.linalg.norm(np.cross(*np.moveaxis(np.diff(corners, axis=1), 1, 0)), axis=1) / 2.0)


def _split(corners: Array, longest: float) -> Array:
    """The same surface, of triangles without longer sides [mm]: they are halved across these."""
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    if not (long := sides.max(axis=1) > longest).any():
        return corners
    turn = (sides[long].argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(corners[long], turn[:, :, None], axis=1), 1, 0)
    halves = np.stack([a, (a + b) / 2, c, (a + b) / 2, b, c], axis=1).reshape(-1, 3, 3)
    return np.concatenate([corners[~long], _split(halves, longest)])


def _distances(vertices: Array, corners: Array, others: Array) -> tuple[Array, float]:
    """Distances from even samples of a surface to other triangles; the largest, also from its vertices."""
    ends, samples = np.cumsum(_areas(corners)), 20_000
    chosen = np.searchsorted(ends[:-1], (np.arange(samples) + 0.5) / samples * ends[-1])
    # Points that fill a square evenly, by the powers -1 and -2 of the plastic number (Roberts, 2018). The two
    # numbers of each, sorted, divide 1 into the weights of three corners.
    weights = np.diff(
        np.sort(np.outer([0.7548776662466927, 0.5698402909980532], np.arange(samples)) % 1.0, axis=0),
        axis=0, prepend=0.0, append=1.0,
    )  # fmt: skip
    # The squares of the distances to a triangle and to its nearest corner differ by a third of its longest side's
    # square at most (Pythagoras; Jung): so a triangle whose corners are farther than that is no nearer. A corner
    # is in the tree once, not once for each of its triangles: from far inside, the search meets many of them.
    places, corner = np.unique(others.reshape(-1, 3), axis=0, return_inverse=True)
    tree, numbers = scipy.spatial.cKDTree(places), np.arange(corner.size)
    around = scipy.sparse.csr_array((np.ones(corner.size, bool), (corner.ravel(), numbers // 3)))
    fan = int(np.diff(around.indptr).max())  # most triangles at a corner
    most = ((np.roll(others, -1, axis=1) - others) ** 2).sum(axis=2).max() / 3.0

    def nearest(points: Array) -> Array:
        distances, left, count = np.full(len(points), np.inf), np.arange(len(points)), 4
        while len(left):
            count, again = min(count, tree.n), []
            parts = min(len(left), 1 + len(left) * count * fan // 2**19)
            for some in np.array_split(left, parts):
                away, near = map(np.asarray, tree.query(points[some], count))
                rows = around[near.ravel()]  # triangles of each corner
                first = rows.indptr[::count]  # of each point's
                of_pairs = _to_triangles(
                    np.repeat(points[some], np.diff(first), axis=0), others[rows.indices, None]
                )
                distances[some] = np.minimum.reduceat(of_pairs, first[:-1])
                again.append(some[(distances[some] ** 2 > away[:, -1] ** 2 - most) & (count < tree.n)])
            left, count = np.concatenate(again), 2 * count
        return distances

    distances = nearest(np.einsum("kn,nki->ni", weights, corners[chosen]))
    farther = np.asarray(tree.query(vertices)[0]) > distances.max()  # perhaps
    return distances, float(max(distances.max(), nearest(vertices[farther]).max(initial=0.0)))


def _to_triangles(points: Array, corners: Array) -> Array:
    """Distances from points (m, 3) to the nearest of their triangles (m, k, 3, 3), shape (m,)."""
    edges, away = np.roll(corners, -1, axis=2) - corners, points[:, None, None] - corners
    along = np.einsum("...i,...i", away, edges) / np.maximum(np.einsum("...i,...i", edges, edges), 1e-300)
    rest = away - np.clip(along, 0.0, 1.0)[..., None] * edges
    ab, ac, ap = edges[:, :, 0], -edges[:, :, 2], away[:, :, 0]
    normal = np.cross(ab, ac)
    b, c, square = (np.einsum("...i,...i", n, normal) for n in (np.cross(ap, ac), np.cross(ab, ap), normal))
    height = np.einsum("...i,...i", ap, normal) ** 2 / np.maximum(square, 1e-300)
    above = (b >= 0) & (c >= 0) & (b + c <= square) & (square > 0)
    squares = np.where(above, height, np.einsum("...i,...i", rest, rest).min(axis=-1))
    return np.asarray(np.sqrt(squares.min(axis=1)))
