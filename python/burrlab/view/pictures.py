"""Pictures of a bone by matplotlib alone: slices through three planes, depth map of a crater."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.figures import axes_or_new
from burrlab.view.slice_image import PLANES, REMOVED, SliceImage, slice_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NAMES = "xyz"
_BURR = "#33BBEE"


def plot_slices(
    bone: VoxelBone,
    point: ArrayLike,
    *,
    radii: Sequence[float] = (),
    centers: ArrayLike = (),
    figure: Figure | None = None,
) -> list[Axes]:
    """Slices through a point along the three planes of the voxels, with the tissues' colours.

    Parameters
    ----------
    bone : VoxelBone
    point : (x, y, z)
        In the bone frame [mm].
    radii : sequence of float
        Of burrs, drawn as the circles that they cut out of each plane [mm].
    centers : array_like, shape (burrs, 3), optional
        Their centres [mm]; default: the first at `point`.
    figure : Figure, optional

    Returns
    -------
    list of Axes
        Of the planes xy, xz and yz; axes in mm.

    Raises
    ------
    ValueError
        If the point is not three finite numbers, or there is not a centre for every radius.
    """
    places = _centers(point, radii, centers)
    images = [slice_image(bone, point, plane) for plane in PLANES]
    if figure is None:
        figure = Figure(figsize=(9.6, 3.9), layout="constrained")
    made: list[Axes] = list(
        figure.subplots(1, 3, width_ratios=[image.extent[1] - image.extent[0] for image in images])
    )
    for axes, image in zip(made, images, strict=True):
        _draw_slice(axes, image, np.asarray(point, float), radii, places)
    handles = _tissue_handles(bone, images)
    if handles:
        figure.legend(
            handles=handles, loc="outside lower center", ncols=min(len(handles), 7), frameon=False, fontsize=8
        )
    return made


def _centers(point: ArrayLike, radii: Sequence[float], centers: ArrayLike) -> NDArray[np.float64]:
    places = np.asarray(centers, float).reshape(-1, 3)
    if len(places) == 0 and len(radii) == 1:
        places = np.asarray(point, float).reshape(1, 3)
    if len(places) != len(radii):
        raise ValueError(f"centers must be one for each of {len(radii)} radii, got {len(places)}")
    return places


def _draw_slice(
    axes: Axes,
    image: SliceImage,
    point: NDArray[np.float64],
    radii: Sequence[float],
    centers: NDArray[np.float64],
) -> None:
    across, right, up = PLANES[image.plane]
    axes.imshow(image.pixels, origin="lower", extent=image.extent, interpolation="nearest")
    for center, radius in zip(centers, radii, strict=True):
        cut = image.burr_radius(center, radius)
        if cut > 0:
            axes.add_patch(
                Circle((center[right], center[up]), cut, fill=False, edgecolor=_BURR, linewidth=1.4)
            )
    axes.axvline(point[right], color="white", linewidth=0.5, alpha=0.55)
    axes.axhline(point[up], color="white", linewidth=0.5, alpha=0.55)
    axes.set_xlim(image.extent[:2])
    axes.set_ylim(image.extent[2:])
    axes.set_xlabel(f"{_NAMES[right]} [mm]")
    axes.set_ylabel(f"{_NAMES[up]} [mm]")
    axes.set_title(f"{_NAMES[across]} = {image.position:.2f} mm", fontsize=10)


def _tissue_handles(bone: VoxelBone, images: Sequence[SliceImage]) -> list[Patch]:
    """Colour and name of what one of the slices shows."""
    removed = [Patch(facecolor=_fractions(REMOVED), label="removed")] if bone.removed > 0 else []
    if bone.tissues is None:
        return removed
    shown = sorted({
        int(number)
        for image in images
        if image.tissues is not None
        for number in np.unique(image.tissues[image.levels > 0])
    })  # fmt: skip
    table = list(bone.tissues)
    return [
        Patch(facecolor=_fractions(table[i].colour), edgecolor="0.3", linewidth=0.5, label=table[i].name)
        for i in shown
    ] + removed


def _fractions(colour: Sequence[int]) -> tuple[float, float, float]:
    red, green, blue = colour
    return red / 255, green / 255, blue / 255


def depth_map(bone: VoxelBone, *, axis: str = "-z") -> NDArray[np.float64]:
    """Thickness of bone that was removed along an axis, at each place across it.

    The sum over a column of voxels of (pristine minus present level)/255 times the spacing.

    Parameters
    ----------
    bone : VoxelBone
    axis : str
        Direction in which one looks: "x", "-x", "y", "-y", "z" or "-z".

    Returns
    -------
    ndarray
        [mm]; rows and columns as in the slices across that axis: (y, x), (z, x) or (z, y). The sign of the axis
        does not change it.

    Raises
    ------
    ValueError
        If the axis is another.
    """
    across = _axis(axis)
    nz, ny, nx = bone.shape
    removed = np.zeros([n for a, n in enumerate((nz, ny, nx)) if a != 2 - across])
    for z in range(0, nz, 32):  # slabs, so that a large volume is never copied whole
        start, size = (z, 0, 0), (min(32, nz - z), ny, nx)
        lost = (bone.read(start, size, pristine=True) - bone.read(start, size)).sum(
            axis=2 - across, dtype=np.int64
        )
        if across == 2:
            removed += lost
        else:
            removed[z : z + size[0]] = lost
    return removed * (bone.spacing[across] / 255.0)


def _axis(axis: str) -> int:
    if axis not in ("x", "-x", "y", "-y", "z", "-z"):
        raise ValueError(f"axis must be one of x, -x, y, -y, z, -z, got '{axis}'")
    return _NAMES.index(axis[-1])


def plot_depth_map(
    bone: VoxelBone, *, axis: str = "-z", ax: Axes | None = None, contours: int = 6, crop: bool = True
) -> Axes:
    """The crater as a map: how much was removed along an axis, with contours.

    Parameters
    ----------
    bone : VoxelBone
    axis : str
        Direction in which one looks.
    ax : Axes, optional
    contours : int
        About so many lines of equal depth, at round values; 0: none.
    crop : bool
        Show only where something was removed, with a margin; else all.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If the axis is another, or contours are negative.
    """
    if contours < 0:
        raise ValueError(f"contours must be zero or positive, got {contours}")
    across = _axis(axis)
    depth = depth_map(bone, axis=axis)
    _, right, up = next(axes for axes in PLANES.values() if axes[0] == across)
    places = [bone.origin[a] + bone.spacing[a] * np.arange(bone.shape[2 - a]) for a in (right, up)]
    half = [bone.spacing[a] / 2 for a in (right, up)]
    axes = axes_or_new(ax)
    image = axes.imshow(
        depth, origin="lower", cmap="cividis", vmin=0, interpolation="nearest",
        extent=(places[0][0] - half[0], places[0][-1] + half[0], places[1][0] - half[1], places[1][-1] + half[1]),
    )  # fmt: skip
    deepest = float(depth.max())
    if contours and deepest > 0 and min(depth.shape) > 1:
        round_values = np.asarray(MaxNLocator(contours + 1).tick_values(0, deepest), float)
        levels = [float(value) for value in round_values if 0 < value < deepest]
        shades = ["white" if value < 0.6 * deepest else "0.15" for value in levels]
        lines = axes.contour(*places, depth, levels=levels, colors=shades, linewidths=0.6)
        axes.clabel(lines, fmt="%g", fontsize=7)
    if crop and deepest > 0:
        for limits, along, step in ((axes.set_xlim, 0, half[0]), (axes.set_ylim, 1, half[1])):
            kept = places[along][np.flatnonzero(depth.max(axis=along) > 0.01 * deepest)]
            margin = 0.12 * (kept[-1] - kept[0]) + 2 * step
            limits(
                max(kept[0] - margin, places[along][0] - step),
                min(kept[-1] + margin, places[along][-1] + step),
            )
    figure = axes.get_figure(root=True)
    assert figure is not None
    figure.colorbar(image, ax=axes, label=f"bone removed along {_NAMES[across]} [mm]")
    if axis in ("z", "-x", "y"):  # seen from behind, so that left is left for whoever looks
        axes.invert_xaxis()
    axes.set_xlabel(f"{_NAMES[right]} [mm]")
    axes.set_ylabel(f"{_NAMES[up]} [mm]")
    axes.set_title(f"{bone.removed:.1f} mm$^3$ removed, {deepest:.2f} mm at most", fontsize=10)
    return axes
