"""Figures for papers: size, colours and style."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


#: Colour of each quantity throughout the package (Okabe and Ito's palette, for colour-blind readers too).
FORCE, POSITION, VELOCITY, REFERENCE = "#0072B2", "#009E73", "#D55E00", "#555555"


def new_figure(width: float = 6.4, height: float = 4.4) -> Figure:
    """A new figure [inch] outside pyplot: threads and notebooks may draw at the same time."""
    return Figure(figsize=(width, height), layout="constrained")


def axes_or_new(axes: Axes | None) -> Axes:
    """The given axes, or axes of a new pyplot figure of the usual size."""
    if axes is not None:
        return axes
    from matplotlib import pyplot

    made: Axes = pyplot.subplots(figsize=(4.8, 3.6), layout="constrained")[1]
    return made


def tidy(axes: Axes) -> Axes:
    """Gives axes a light grid, without upper and right frame."""
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return axes
