"""Specimens: a bone with a point on its surface and a direction."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Burr, VoxelBone
from burrlab.common.check import check_memory, real, refuse, scalar
from burrlab.common.study import stored_as
from burrlab.common.table import by_value
from burrlab.theory.tool import require_tool

#: Largest block that `half_space` makes [voxels] (ours); making it takes some gigabytes.
MOST_VOXELS = 2e8

Vector = Sequence[float] | NDArray[np.float64]


def unit_vector(axis: ArrayLike) -> NDArray[np.float64]:
    """`axis` with length 1; ValueError unless it has three finite values, not all 0."""
    vector = real(axis, "axis")
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(vector)
    refuse(
        vector.shape != (3,) or not 0.0 < length < np.inf,
        f"axis must be three finite numbers, not all zero, got {axis!r}",
    )
    return np.asarray(vector / length)


@stored_as("burrlab.specimen.Specimen")
@by_value
@dataclass(frozen=True)
class Specimen:
    """A bone with the axis of a descent.

    Parameters
    ----------
    bone : VoxelBone
        A descent works on a copy.
    surface : ndarray, shape (3,)
        Point on the axis where immersion is 0, (x, y, z) [mm].
    axis : ndarray, shape (3,)
        Unit vector into the bone.
    source : str
        Name of the specimen, for the provenance of results.
    made : mapping
        How it was made, ready for JSON, for the provenance.
    """

    bone: VoxelBone
    surface: NDArray[np.float64]
    axis: NDArray[np.float64]
    source: str = ""
    made: Mapping[str, Any] = field(default_factory=dict)

    def center(self, immersion: float, burr: Burr) -> NDArray[np.float64]:
        """Burr centre (x, y, z) [mm] when its tip is `immersion` [mm] below the surface."""
        return np.asarray(self.surface + (immersion - burr.radius) * self.axis)


def checked_spacing(spacing: ArrayLike, what: str = "spacing") -> NDArray[np.float64]:
    """Spacing (x, y, z) from one number or three [mm]; ValueError unless they are from 1e-6 to 1e6."""
    lengths = real(spacing, what)
    refuse(
        lengths.shape not in ((), (3,)) or not np.all((lengths >= 1e-6) & (lengths <= 1e6)),
        f"{what} must be a number or three from 1e-6 to 1e6 [mm], got {spacing!r}",
    )
    return np.broadcast_to(lengths, (3,)).copy()


def block_below_plane(
    burr: Burr,
    voxel: float | Vector,
    fill: Callable[..., NDArray[np.uint8]],
    source: str,
    *,
    depth: float | None,
    axis: Vector,
    offset: Vector,
) -> Specimen:
    """Specimen of `half_space`, with the same further parameters and errors.

    `fill` returns the levels (z, y, x) from the coordinates x, y and z of the voxel centres [mm], the part of each
    voxel that lies below the plane, 0..1, and the spacing.
    """
    require_tool(burr)
    spacing = checked_spacing(voxel, "voxel")
    depth = burr.radius / 3 if depth is None else scalar(depth, "depth")
    refuse(not (np.isfinite(depth) and depth > 0), f"depth must be positive and finite, got {depth!r}")
    normal = unit_vector(axis)
    s = spacing.max()
    reach, bottom = burr.radius + s, depth + 3 * s
    width = (
        np.sqrt(max(2 * reach * (depth + s) - (depth + s) ** 2, 0.0)) if depth + s < reach else reach
    ) + 2 * s
    shift = real(offset, "offset")
    shift = shift - (shift @ normal) * normal
    across = width * np.sqrt(np.maximum(1 - normal**2, 0.0)) + np.abs(shift)
    low = np.floor((np.minimum(0, bottom * normal) - across) / spacing + 1e-6)
    high = np.ceil((np.maximum(0, bottom * normal) + across) / spacing - 1e-6)
    count = float(np.prod(high - low))
    refuse(
        spacing.max() > burr.radius,
        f"voxel must be at most R = {burr.radius:g} mm, got {spacing.max():g} mm",
    )
    refuse(
        count > MOST_VOXELS,
        f"voxel must be coarser: a block for R = {burr.radius:g} mm at {spacing.min():g} mm has {count:.3g} "
        f"voxels, above {MOST_VOXELS:.3g}",
    )
    check_memory(26.0 * count, f"a bone of {count:.3g} voxels")  # measured peak while it is made
    centers = tuple((np.arange(low[i], high[i]) + 0.5) * spacing[i] for i in range(3))
    x, y, z = (normal[i] * centers[i] for i in range(3))
    below = (z[:, None, None] + y[None, :, None] + x[None, None, :]) / np.sqrt(
        np.sum((spacing * normal) ** 2)
    )
    levels = fill(centers, np.clip(below + 0.5, 0, 1), spacing)
    bone = VoxelBone(levels, spacing=spacing, origin=[float(c[0]) for c in centers])
    return Specimen(bone, np.asarray(shift), normal, source)


def half_space(
    burr: Burr,
    voxel: float | Vector,
    *,
    depth: float | None = None,
    axis: Vector = (0.0, 0.0, -1.0),
    offset: Vector = (0.0, 0.0, 0.0),
) -> Specimen:
    """Solid bone below a plane through the origin, as large as a descent to `depth` needs.

    Parameters
    ----------
    burr : Burr
    voxel : float or (x, y, z)
        Spacing [mm].
    depth : float, optional
        Deepest immersion of the burr's tip [mm]; default R/3.
    axis : (x, y, z)
        Direction of the descent, perpendicular to the surface. Along a voxel axis the surface is a face of
        the grid. Otherwise a voxel that the surface cuts is filled by its fraction below it.
    offset : (x, y, z)
        Point where the burr enters, from the origin [mm]; the part along the axis is ignored. A fraction of a
        voxel moves the burr within the grid.

    Raises
    ------
    ValueError
        If the spacing or depth is not positive, the block is too large, or the axis is no direction.

    Examples
    --------
    >>> import burrlab
    >>> specimen = half_space(burrlab.Burr(3.0), 0.2)
    >>> float(specimen.bone.density.max()), [float(c) for c in specimen.center(0.0, burrlab.Burr(3.0))]
    (255.0, [0.0, 0.0, 3.0])
    """
    return block_below_plane(
        burr, voxel, lambda centers, fraction, spacing: np.rint(255 * fraction).astype(np.uint8),
        "half-space of solid bone", depth=depth, axis=axis, offset=offset,
    )  # fmt: skip


class Border:
    """The border of a volume, and where bone runs into it: pristine level 128 in the two outermost voxels."""

    def __init__(self, bone: VoxelBone) -> None:
        spacing, counts = np.array(bone.spacing), np.array(bone.shape[::-1])
        self._low = np.array(bone.origin) - 0.5 * spacing
        self._high, self._entered = self._low + counts * spacing, np.zeros(6, bool)
        # Of the bone in each face, along the other two axes [mm].
        self._points: list[NDArray[np.float64]] = []
        for face in range(6):
            axis = 2 - face % 3
            size = np.where(np.arange(3) == axis, np.minimum(bone.shape, 2), bone.shape)
            start = (np.array(bone.shape) - size) * (face > 2)
            levels = bone.read(start.tolist(), size.tolist(), pristine=True).max(axis=axis)
            solid = np.argwhere(levels >= 128)[:, ::-1]
            self._points.append(np.delete(self._low, face % 3) + (solid + 0.5) * np.delete(spacing, face % 3))

    def count_cut(self, centers: NDArray[np.float64], radius: float) -> int:
        """Number of spheres that leave the volume through bone, of those that follow the ones before.

        A face counts only if the centre came from the volume's inside: nothing is missing beyond the face
        through which a burr comes in.
        """
        beyond = np.hstack([self._low - centers, centers - self._high])
        last = np.maximum.accumulate(np.where((beyond > 0).any(axis=1), np.arange(len(beyond)), -1))
        entered = np.where(last[:, None] < 0, self._entered, beyond[last] > 0)
        self._entered = entered[-1] if len(entered) else self._entered
        cut = np.zeros(len(beyond), bool)
        for face, points in enumerate(self._points):
            near = np.flatnonzero((beyond[:, face] > -radius) & ~entered[:, face] & ~cut)
            if len(near) and len(points):
                width = np.sqrt(radius**2 - beyond[near, face] ** 2)
                across = np.delete(centers[near], face % 3, axis=1)
                cut[near] = scipy.spatial.cKDTree(points).query(across)[0] < width
        return int(np.count_nonzero(cut))


#: What `Border.count_cut` counts.
CUT = "border: the burr reached out of the volume through bone, and sinks faster without the bone beyond"


def surface_along(
    bone: VoxelBone, entry: Vector, axis: Vector, *, level: float = 128.0
) -> NDArray[np.float64] | None:
    """First point along a ray where the occupancy, trilinear between voxel centres, reaches `level`.

    Parameters
    ----------
    bone : VoxelBone
    entry : (x, y, z)
        Start of the ray [mm]; it may lie outside the volume.
    axis : (x, y, z)
        Direction of the ray.

    Returns
    -------
    ndarray, shape (3,), or None
        [mm]; None if the ray meets no bone; the entry itself if it lies inside bone.

    Examples
    --------
    >>> import burrlab
    >>> block = burrlab.VoxelBone.block((4, 4, 4), 0.1)
    >>> surface_along(block, (2.0, 2.0, 9.0), (0.0, 0.0, -1.0)).round(2).tolist()
    [2.0, 2.0, 3.95]
    """
    direction, start = unit_vector(axis), real(entry, "entry")
    refuse(
        start.shape != (3,) or not np.all(np.isfinite(start)),
        f"entry must be three finite numbers, got {entry!r}",
    )
    spacing, origin = np.asarray(bone.spacing), np.asarray(bone.origin)
    extent = np.asarray(bone.shape[::-1]) * spacing
    length = float(np.linalg.norm(extent) + np.linalg.norm(start - (origin + extent / 2)))
    along = np.arange(0.0, length, 0.1 * spacing.min())
    points = (start + along[:, None] * direction - origin) / spacing
    inside = np.all((points > -1) & (points < bone.shape[::-1]), axis=1)
    if not inside.any():
        return None
    first, last = points[inside].min(axis=0), points[inside].max(axis=0)  # box of the ray
    low = np.maximum(np.floor(first) - 1, 0).astype(int)
    high = np.minimum(np.ceil(last) + 2, bone.shape[::-1]).astype(int)
    occupancy = scipy.ndimage.map_coordinates(
        bone.read(low[::-1].tolist(), (high - low)[::-1].tolist()), (points - low)[:, ::-1].T, output=float, order=1,
        mode="grid-constant", cval=0.0,
    )  # fmt: skip
    solid = np.flatnonzero(occupancy >= scalar(level, "level"))
    if solid.size == 0:
        return None
    i = int(solid[0])
    if i == 0:
        return start
    rest = (level - occupancy[i - 1]) / (occupancy[i] - occupancy[i - 1])
    return np.asarray(start + (along[i - 1] + rest * (along[i] - along[i - 1])) * direction)
