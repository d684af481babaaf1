"""Pictures of a bone by matplotlib alone: slices through three planes, the depth map of a crater."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone, tissue_box
from burrlab.bone.image import checked_point
from burrlab.common.check import refuse
from burrlab.common.figures import Axes, Panels, axes_or_new, drawing, panels, styled
from burrlab.view.surface import BONE, tissue_palette

#: Plane -> (axis across it, axis to the right, axis upwards) of (x, y, z).
PLANES = {"xy": (2, 0, 1), "xz": (1, 0, 2), "yz": (0, 1, 2)}
#: Colour of removed bone.
REMOVED = (92, 44, 40)
_EMPTY = (16, 18, 24)
_HEX = "#{:02x}{:02x}{:02x}"


@dataclass(frozen=True, eq=False, repr=False)
class SliceImage:
    """One plane of voxels.

    Attributes
    ----------
    plane : str
        "xy", "xz" or "yz": axes to the right and upwards.
    pixels : ndarray, shape (rows, columns, 3), uint8
        Row 0 is at the bottom.
    levels : ndarray, shape (rows, columns), uint8
    tissues : ndarray, shape (rows, columns), uint8, or None
        Tissue numbers; None without tissues.
    extent : tuple
        Left, right, bottom, top: outer faces of the voxels [mm].
    position : float
        Place of the plane's voxel centres along the axis across it [mm].
    """

    plane: str
    pixels: NDArray[np.uint8]
    levels: NDArray[np.uint8]
    tissues: NDArray[np.uint8] | None
    extent: tuple[float, float, float, float]
    position: float

    def burr_radius(self, center: ArrayLike, radius: float) -> float:
        """Radius of the circle that a sphere cuts out of the plane [mm]; 0 if they do not meet."""
        away = float(np.asarray(center, float)[PLANES[self.plane][0]]) - self.position
        return float(np.sqrt(max(radius**2 - away**2, 0.0)))


def slice_image(bone: VoxelBone, point: ArrayLike, plane: str) -> SliceImage:
    """The plane of voxels nearest to a point.

    Parameters
    ----------
    bone : VoxelBone
    point : (x, y, z)
        In the bone frame [mm]; outside the volume its outermost plane is taken.
    plane : str
        "xy", "xz" or "yz".

    Returns
    -------
    SliceImage

    Raises
    ------
    ValueError
        If the plane is another, or the point is not three finite numbers.
    """
    refuse(plane not in PLANES, f"plane must be one of {', '.join(PLANES)}, got '{plane}'")
    at = checked_point(point, "point")
    across, right, up = PLANES[plane]
    shape, spacing, origin = bone.shape[::-1], bone.spacing, bone.origin
    index = int(np.clip(np.rint((at[across] - origin[across]) / spacing[across]), 0, shape[across] - 1))
    start, size = [0, 0, 0], list(bone.shape)
    start[2 - across], size[2 - across] = index, 1
    levels, pristine, numbers = (
        None if box is None else box.squeeze(axis=2 - across)
        for box in (
            bone.read(start, size), bone.read(start, size, pristine=True), tissue_box(bone, start, size)
        )
    )  # fmt: skip
    assert levels is not None
    assert pristine is not None
    # (z, y, x) without the axis across is (upwards, to the right) for all three planes
    colour = np.asarray(BONE) if numbers is None else tissue_palette(bone)[numbers].astype(float)
    # half full is drawn as full, like the surface, so that soft tissue keeps its colour
    now, lost = (np.minimum(part[..., None] / 127.5, 1.0) for part in (levels, pristine - levels))
    pixels = now * colour + (1 - now) * (lost * np.asarray(REMOVED) + (1 - lost) * np.asarray(_EMPTY))
    left, low = (origin[a] - spacing[a] / 2 for a in (right, up))
    most, high = (origin[a] + spacing[a] * (shape[a] - 0.5) for a in (right, up))
    return SliceImage(
        plane, np.rint(pixels).astype(np.uint8), levels, numbers, (left, most, low, high),
        origin[across] + index * spacing[across],
    )  # fmt: skip


_BURR = "#33BBEE"


@drawing
def plot_slices(
    bone: VoxelBone,
    point: ArrayLike,
    *,
    radii: Sequence[float] = (),
    centers: ArrayLike = (),
    note: str = "",
    ax: Panels = None,
    **style: Any,
) -> list[Axes]:
    """Slices through a point along the three planes of the voxels, with the tissues' colours.

    Parameters
    ----------
    bone : VoxelBone
    point : (x, y, z)
        In the bone frame [mm].
    radii : sequence of float
        Radii of burrs, drawn as the circles that they cut out of each plane [mm].
    centers : array_like, shape (burrs, 3), optional
        Burr centres [mm]; default: one burr at `point`.
    note : str
        A few words on the bone, above the slices, such as the time.
    ax : Figure or array of three Axes, optional
    **style
        `label`, `color` and other properties of the burrs' circles.

    Returns
    -------
    list of Axes
        Of the planes xy, xz and yz; axes in mm.

    Raises
    ------
    ValueError
        If the point is not three finite numbers, or there is not a centre for every radius.

    Examples
    --------
    >>> import burrlab
    >>> bone = burrlab.VoxelBone.block((2, 2, 2), 0.1)
    >>> len(plot_slices(bone, (1.0, 1.0, 1.0)))
    3
    """
    places = np.asarray(centers, float).reshape(-1, 3)
    if len(places) == 0 and len(radii) == 1:
        places = np.asarray(point, float).reshape(1, 3)
    refuse(
        len(places) != len(radii), f"centers must be one for each of {len(radii)} radii, got {len(places)}"
    )
    images = [slice_image(bone, point, plane) for plane in PLANES]
    all_axes = panels(
        ax, (1, 3), (9.6, 3.9), width_ratios=[image.extent[1] - image.extent[0] for image in images]
    )
    figure, look = all_axes[0].figure, styled(style, color=_BURR, label="burr", linewidth=1.4)
    if note:
        figure.suptitle(note, fontsize=8)
    for axes, image in zip(all_axes, images, strict=True):
        _draw_slice(axes, image, np.asarray(point, float), radii, places, look)
    handles: list[Artist] = [*_tissue_handles(bone, images)]
    if any(axes.patches for axes in all_axes):
        handles.append(Line2D([], [], **look | {"marker": "o", "fillstyle": "none", "linestyle": ""}))
    for columns in range(min(len(handles), 7), 0, -1):  # as many as fit
        legend = figure.legend(
            handles=handles, loc="outside lower center", ncols=columns, frameon=False, fontsize=8
        )
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            break
        legend.remove()
    return all_axes


def _draw_slice(
    axes: Axes,
    image: SliceImage,
    point: NDArray[np.float64],
    radii: Sequence[float],
    centers: NDArray[np.float64],
    look: dict[str, Any],
) -> None:
    across, right, up = PLANES[image.plane]
    axes.imshow(image.pixels, origin="lower", extent=image.extent, interpolation="nearest")
    for center, radius in zip(centers, radii, strict=True):
        if (cut := image.burr_radius(center, radius)) > 0:
            axes.add_patch(Circle((center[right], center[up]), cut, fill=False, **look | {"label": ""}))
    axes.axvline(point[right], color="white", linewidth=0.5, alpha=0.55)
    axes.axhline(point[up], color="white", linewidth=0.5, alpha=0.55)
    axes.set(
        xlim=image.extent[:2], ylim=image.extent[2:], xlabel=f"{'xyz'[right]} [mm]", ylabel=f"{'xyz'[up]} [mm]",
        title=f"{'xyz'[across]} = {image.position:.2f} mm",
    )  # fmt: skip


def _tissue_handles(bone: VoxelBone, images: Sequence[SliceImage]) -> list[Patch]:
    """Colour and name of everything that one of the slices shows."""
    seen = set().union(
        *(np.unique(image.tissues[image.levels > 0]) for image in images if image.tissues is not None)
    )
    handles = [
        Patch(facecolor=_HEX.format(*tissue.colour), label=tissue.name, edgecolor="0.3", linewidth=0.5)
        for number, tissue in enumerate(bone.tissues or ())
        if number in seen
    ]
    return handles + [Patch(facecolor=_HEX.format(*REMOVED), label="removed")] * bool(bone.removed)


def removed_thickness(bone: VoxelBone, *, axis: str = "-z") -> NDArray[np.float64]:
    """Thickness of removed bone along an axis, at each place across it.

    The sum of (pristine minus present level)/255 times the spacing over each column of voxels.

    Parameters
    ----------
    bone : VoxelBone
    axis : str
        Direction of view: "x", "-x", "y", "-y", "z" or "-z"; its sign changes nothing.

    Returns
    -------
    ndarray
        [mm]; rows and columns as in the slices across that axis: (y, x), (z, x) or (z, y).

    Raises
    ------
    ValueError
        If the axis is another.
    """
    across = _axis(axis)
    slabs = [(before - now).sum(axis=2 - across, dtype=np.int64) for now, before in _slabs(bone, across)]
    return np.concatenate(slabs, axis=0) * (bone.spacing[across] / 255.0)


def depth_map(bone: VoxelBone, *, axis: str = "-z", level: int = 128) -> NDArray[np.float64]:
    """Depth of a crater as seen along an axis: from the pristine surface to the present one.

    The surface is where the level first reaches `level`, linear between voxel centres. Where no surface is
    left, the far face of the volume takes its place.

    Parameters
    ----------
    bone : VoxelBone
    axis : str
        Direction of view: "x", "-x", "y", "-y", "z" or "-z".
    level : int
        Occupancy level at the surface, 1 to 255.

    Returns
    -------
    ndarray
        [mm], 0 where there was no bone; rows and columns as in the slices across that axis: (y, x), (z, x) or
        (z, y).

    Raises
    ------
    ValueError
        If the axis is another, or the level is not from 1 to 255.

    Examples
    --------
    >>> import burrlab
    >>> bone = burrlab.VoxelBone.block((2, 2, 2), 0.5)
    >>> left = bone.density.copy()
    >>> left[3] = 0
    >>> bone.restore(left)
    >>> float(depth_map(bone).max())
    0.5
    """
    refuse(not 1 <= level <= 255, f"level must be from 1 to 255, got {level}")
    across = _axis(axis)
    surfaces = (
        [_first(levels, 2 - across, axis[0] == "-", level) for levels in slab]
        for slab in _slabs(bone, across)
    )
    depths = [np.where(before < bone.shape[2 - across], now - before, 0.0) for now, before in surfaces]
    return np.concatenate(depths, axis=0) * bone.spacing[across]


def _slabs(bone: VoxelBone, across: int) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Present and pristine levels in slabs of whole columns, so that no large volume is copied at once."""
    along = 1 if across == 2 else 0  # the first of the two axes that are left
    for begin in range(0, bone.shape[along], 32):
        start, size = [0, 0, 0], list(bone.shape)
        start[along], size[along] = begin, min(32, bone.shape[along] - begin)
        yield bone.read(start, size), bone.read(start, size, pristine=True)


def _first(levels: NDArray[np.uint8], along: int, backwards: bool, level: int) -> NDArray[np.float64]:
    """The place where each column first reaches a level, in voxels from the outer face; its length where it
    never does."""
    inside = np.moveaxis(levels, along, -1)[..., :: -1 if backwards else 1]
    columns = np.pad(inside, ((0, 0), (0, 0), (1, 0)))  # beyond the volume there is nothing
    solid = columns >= level
    index = solid.argmax(axis=-1)[..., None]
    before, here = (np.take_along_axis(columns, at, -1)[..., 0].astype(float) for at in (index - 1, index))
    place = index[..., 0] - 1.5 + (level - 0.5 - before) / np.maximum(here - before, 1.0)
    return np.where(solid.any(axis=-1), np.maximum(place, 0.0), float(inside.shape[-1]))


def _axis(axis: str) -> int:
    refuse(
        axis not in ("x", "-x", "y", "-y", "z", "-z"),
        f"axis must be one of x, -x, y, -y, z, -z, got '{axis}'",
    )
    return "xyz".index(axis[-1])


@drawing
def plot_depth_map(
    bone: VoxelBone,
    *,
    axis: str = "-z",
    thickness: bool = False,
    ax: "Axes | None" = None,
    contours: int = 6,
    crop: bool = True,
    note: str = "",
    label: str | None = None,
    color: Any = "white",
    **style: Any,
) -> "Axes":
    """A map of the crater with contours: `depth_map`, or `removed_thickness`.

    Parameters
    ----------
    bone : VoxelBone
    axis : str
        Direction of view.
    thickness : bool
        Thickness of removed bone, air cells left out; else the depth seen.
    ax : Axes, optional
    contours : int
        Approximate number of lines of equal depth, at round values; 0: none.
    crop : bool
        Show only the part with removed bone, with a margin; else all.
    note : str
        A few words on the bone, in the title, such as the time.
    label : str, optional
        Of the colour bar.
    color : colour
        Of the contours.
    **style
        Properties of the image.

    Raises
    ------
    ValueError
        If the axis is another, or contours are negative.

    Examples
    --------
    >>> import burrlab
    >>> bone = burrlab.VoxelBone.block((2, 2, 2), 0.5)
    >>> left = bone.density.copy()
    >>> left[3, :2] = 0
    >>> bone.restore(left)
    >>> plot_depth_map(bone, crop=False).get_xlabel()
    'x [mm]'
    """
    refuse(contours < 0, f"contours must be zero or positive, got {contours}")
    across = _axis(axis)
    depth = removed_thickness(bone, axis=axis) if thickness else depth_map(bone, axis=axis)
    _, right, up = next(axes for axes in PLANES.values() if axes[0] == across)
    places = [bone.origin[a] + bone.spacing[a] * np.arange(bone.shape[2 - a]) for a in (right, up)]
    half = [bone.spacing[a] / 2 for a in (right, up)]
    axes = axes_or_new(ax)
    image = axes.imshow(
        depth, origin="lower", **{"cmap": "cividis", "vmin": 0, "interpolation": "nearest", **style},
        extent=(places[0][0] - half[0], places[0][-1] + half[0], places[1][0] - half[1], places[1][-1] + half[1]),
    )  # fmt: skip
    deepest, lines = float(depth.max()), None
    if contours and deepest > 0 and min(depth.shape) > 1:
        round_values = np.asarray(MaxNLocator(contours + 1).tick_values(0, deepest), float)
        levels = round_values[(round_values > 0) & (round_values < deepest)].tolist()
        lines = axes.contour(*places, depth, levels=levels, colors=color, linewidths=0.6)
    if crop and deepest > 0:
        for limits, along, step in ((axes.set_xlim, 0, half[0]), (axes.set_ylim, 1, half[1])):
            deep_places = places[along][np.flatnonzero(depth.max(axis=along) > 0.01 * deepest)]
            margin = 0.12 * (deep_places[-1] - deep_places[0]) + 2 * step
            limits(
                max(deep_places[0] - margin, places[along][0] - step),
                min(deep_places[-1] + margin, places[along][-1] + step),
            )
    bar = axes.figure.colorbar(
        image,
        cax=axes.inset_axes((1.04, 0.0, 0.05, 1.0)),  # as tall as the map
        label=label or f"{'bone removed' if thickness else 'depth'} along {'xyz'[across]} [mm]",
    )
    if lines is not None:
        bar.add_lines(lines)  # on the map their numbers would hide a small crater
    if axis in ("x", "-y", "z"):  # seen from behind: left is the viewer's left
        axes.invert_xaxis()
    axes.set(
        xlabel=f"{'xyz'[right]} [mm]",
        ylabel=f"{'xyz'[up]} [mm]",
        title=f"{bone.removed:.1f} mm$^3$ removed, {deepest:.2f} mm at most\n{note}".rstrip("\n"),
    )
    return axes
