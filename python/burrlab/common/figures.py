"""Figures for papers: size, colours, style, and what all `plot` methods share."""

import inspect
import itertools
import re
import textwrap
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar, cast

import numpy as np

from burrlab.common.check import refuse

# matplotlib takes a quarter of a second to import, and a fit draws nothing
if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.legend import Legend
    from matplotlib.transforms import Bbox
else:
    Axes = Axis = Figure = SubFigure = Legend = Bbox = Any

#: Where a picture of several panels goes: a figure, or as many Axes.
Panels: TypeAlias = Figure | SubFigure | Iterable[Axes] | None

P = ParamSpec("P")
Drawn = TypeVar("Drawn", bound=Axes | list[Axes])

#: Colour of each quantity throughout the package (Okabe and Ito's palette, for colour-blind readers too).
FORCE, POSITION, VELOCITY, REFERENCE = "#0072B2", "#009E73", "#D55E00", "#555555"
#: Looks of several curves in one figure. Lightness L* of the first four is 0, 71, 36 and 54, so grey keeps them apart.
SERIES = tuple(
    {"color": color, "marker": marker, "linestyle": line}
    for color, marker, line in (
        ("#000000", "s", "-"), ("#E69F00", "o", "--"), ("#0050A0", "^", "-."), ("#D55E00", "D", (0, (1, 1))),
        ("#56B4E9", "v", (0, (6, 1))), ("#009E73", "P", (0, (4, 1, 1, 1, 1, 1))), ("#CC79A7", "X", (0, (2, 2))),
    )
)  # fmt: skip
#: Widths of a column and of a page of a journal [inch].
WIDTHS = {"single": 3.5, "double": 7.0}
_SHARED = """`ax` is where to draw, a new figure by default; a second plot there widens the limits and adds to the legend.
`label` is said in the legend, `color` and other properties of matplotlib (`style`) change the main artists.
It returns the Axes, a list of them if it draws several."""
_PLACES = ("upper left", "upper right", "lower right", "lower left", "center left", "center right",
           "upper center", "lower center")  # fmt: skip


def paper(width: str = "single") -> AbstractContextManager[None]:
    """The style of a paper's figures, as a context: 3.5 or 7 inch wide, 8 pt, fonts embedded in PDF and PS.

    Parameters
    ----------
    width : {"single", "double"}
        A column or a page. Every `plot` without `ax` makes a figure of this width; save it in the context, too.

    Raises
    ------
    ValueError
        If the width is unknown.
    """
    from matplotlib import rc_context

    refuse(width not in WIDTHS, f"width must be one of {', '.join(WIDTHS)}: got {width!r}")
    across = WIDTHS[width]
    return rc_context({
        "figure.figsize": (across, min(0.75 * across, 3.5)), "figure.constrained_layout.use": True, "savefig.dpi": 300,
        "font.size": 8, "axes.titlesize": 8, "axes.labelsize": 8, "xtick.labelsize": 8, "ytick.labelsize": 8,
        "legend.fontsize": 8, "figure.titlesize": 8, "axes.linewidth": 0.6, "lines.markersize": 4, "pdf.fonttype": 42, "ps.fonttype": 42,
    })  # fmt: skip


def new_figure(width: float = 6.4, height: float = 4.4) -> Figure:
    """A new figure [inch] outside pyplot: threads and notebooks may draw at the same time.

    A width of `figure.figsize` that differs from matplotlib's own, as `paper` sets it, goes before.
    """
    from matplotlib.figure import Figure

    return Figure(figsize=_size(width, height), layout="constrained")


def _size(width: float, height: float) -> tuple[float, float]:
    from matplotlib import rcParams, rcParamsDefault

    chosen = rcParams["figure.figsize"]
    usual = list(chosen) == list(rcParamsDefault["figure.figsize"])
    return (width, height) if usual else (chosen[0], height * min(max(chosen[0] / width, 0.7), 1.0))


def axes_or_new(axes: Axes | None) -> Axes:
    """The given axes, or axes of a new pyplot figure of the usual size."""
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(figsize=_size(4.8, 3.6), layout="constrained")[1]
    return axes


def panels(ax: Panels, count: tuple[int, int], size: tuple[float, float], **how: Any) -> list[Axes]:
    """The given Axes, or rows x columns of a figure: a new one of a size [inch] by default.

    A figure that holds as many Axes already is drawn on again.
    """
    from matplotlib.figure import Figure, SubFigure

    if ax is None and count == (1, 2) and _size(*size)[0] < 4.5:  # a column of a paper: one below the other
        count, size = (2, 1), (4.5, 5.0)
    needed, figure = count[0] * count[1], new_figure(*size) if ax is None else ax
    if isinstance(figure, Figure | SubFigure):
        figure = figure.axes if len(figure.axes) == needed else figure.subplots(*count, squeeze=False, **how)
    axes = list(np.asarray(list(figure), dtype=object).ravel())
    refuse(len(axes) != needed, f"ax must hold {needed} Axes, got {len(axes)}")
    return axes


def styled(style: dict[str, Any], **usual: Any) -> dict[str, Any]:
    """A plot's usual look with what its caller asks for; None keeps the usual."""
    from matplotlib import cbook, lines

    chosen = cbook.normalize_kwargs(style, lines.Line2D)
    usual = cbook.normalize_kwargs(usual, lines.Line2D)
    return usual | {name: value for name, value in chosen.items() if value is not None}


def next_look(ax: Axes, style: dict[str, Any], **usual: Any) -> dict[str, Any]:
    """`styled`; with a label, or on Axes that hold lines, it starts from the look of SERIES least used there."""
    from matplotlib.colors import to_hex

    if style.get("label") or ax.lines:
        used = [to_hex(line.get_color()) for line in ax.lines]
        look = min(SERIES, key=lambda look: used.count(to_hex(str(look["color"]))))
        usual |= {name: look[name] for name in look.keys() & usual.keys()}
    return styled(style, **usual)


def plot_points(ax: Axes, x: Any, y: Any, sigma: Any, style: dict[str, Any], label: str | None) -> None:
    """Draws measured points as squares, with error bars of y if sigma is known."""
    from matplotlib import rcParams

    look = styled(
        style, color="black", marker="s", linestyle="", markerfacecolor="white", markersize=0.75 * rcParams["lines.markersize"],
        markeredgewidth=0.9, zorder=3, label=label,
    )  # fmt: skip
    if sigma is not None:
        ax.errorbar(x, y, sigma, fmt="none", ecolor=look["color"], elinewidth=0.8, zorder=look["zorder"])
    ax.plot(x, y, **look)


def tidy(axes: Axes) -> Axes:
    """Gives axes a light grid, without upper and right frame."""
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _plain_ticks(axis: Axis) -> None:
    """Numbers instead of powers on a logarithmic axis, at equal steps where less than a decade is shown."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullFormatter

    if axis.get_scale() != "log" or not isinstance(axis.get_major_locator(), LogLocator | MaxNLocator):
        return
    low, high = sorted(axis.get_view_interval())
    decades = np.log10(high / low)
    few = MaxNLocator(5, steps=[1, 2, 2.5, 5, 10], min_n_ticks=3)
    axis.set_major_locator(few if decades < 0.7 else LogLocator(subs=(1, 2, 5) if decades < 3 else (1,)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_formatter(NullFormatter())


def drawing(draw: Callable[P, Drawn]) -> Callable[P, Drawn]:
    """Makes a method that draws on `ax` kind to what others drew there.

    It widens limits and never narrows them, adds to the legend, puts the legend where it covers nothing, and
    breaks titles that are too wide. Its docstring says so.
    """
    signature = inspect.signature(draw)
    summary, _, more = inspect.cleandoc(draw.__doc__ or "").partition("\n\n")

    @wraps(draw)
    def draw_and_finish(*args: P.args, **kwargs: P.kwargs) -> Drawn:
        arguments = signature.bind(*args, **kwargs).arguments
        ax, log = arguments.get("ax"), arguments.get("log", False)
        refuse(not isinstance(log, bool | np.bool_), f"log must be True or False, got {log!r}")
        limits = _freed_limits(ax)
        drawn = draw(*args, **kwargs)
        for axes in drawn if isinstance(drawn, list) else [drawn]:
            for name, interval in zip("xy", limits.get(axes, ()), strict=False):
                _widen(axes, name, interval)
            if not axes.images:
                tidy(axes)
            _plain_ticks(axes.xaxis)
            _plain_ticks(axes.yaxis)
            _fit_title(axes)
            labels = len(axes.get_legend_handles_labels()[1])
            if axes.get_legend() or labels > 1 or (labels and kwargs.get("label")):
                _legend(axes, may_grow=ax is None)
        return drawn

    draw_and_finish.__doc__ = f"{summary}\n\n{_SHARED}\n\n{more}"
    return draw_and_finish


def _freed_limits(ax: Any) -> dict[Axes, tuple[tuple[float, float], tuple[float, float]]]:
    """Limits in x and y of the Axes in the argument `ax` of a plot: of a figure, one, several or none.

    Only of those that were drawn on or set; a new plot may now move them.
    """
    listed = getattr(ax, "axes", ax)
    all_axes = [] if listed is None else list(np.ravel(np.asarray(listed, dtype=object)))
    if wrong := [axes for axes in all_axes if not hasattr(axes, "get_xlim")]:
        raise TypeError(
            f"ax must be Axes of matplotlib, got {wrong[0]!r}; to save: plot().figure.savefig(file)"
        )
    limits = {
        axes: (axes.get_xlim(), axes.get_ylim())
        for axes in all_axes
        if axes.has_data() or not (axes.get_autoscalex_on() and axes.get_autoscaley_on())
    }
    for axes in limits:
        axes.autoscale(axes.has_data() or None)  # None leaves it as it is
    return limits


def _widen(axes: Axes, name: str, limits: tuple[float, float]) -> None:
    axis: Axis = getattr(axes, f"{name}axis")
    if axis.get_scale() == "log" and min(limits) <= 0:
        axes.autoscale(axis=name)  # type: ignore[arg-type]  # linear before: zero has no place any more
    low, high = getattr(axes, f"get_{name}lim")()
    ends = [end for end in (*limits, low, high) if end > 0 or axis.get_scale() != "log"]
    wide = (min(ends), max(ends))
    if wide != (min(low, high), max(low, high)):
        axes.set(**{f"{name}lim": wide[::-1] if axis.get_inverted() else wide})


def _fit_title(axes: Axes) -> None:
    """The title in the style's size, in lines no wider than the axes."""
    from matplotlib import rcParams

    size = rcParams["font.size"]
    title = re.sub(r"(?<=\d) (?=\S)", "\u00a0", axes.get_title())  # a number stays with its unit
    fit = int(144 * axes.bbox.width / axes.figure.dpi / size)
    lines = "\n".join(textwrap.fill(line, fit) for line in title.split("\n"))
    axes.title.set(text=lines.replace("\u00a0", " "), fontsize=size)


def _legend(axes: Axes, may_grow: bool) -> None:
    """One legend of all that has a label: inside the axes where it covers nothing, else below them.

    More than four labels always stand below. They are read row by row, shadings last. Labels wider than the axes
    are broken. A figure that may grow becomes higher where the legend leaves little of the axes.
    """
    from matplotlib.collections import PolyCollection

    handles: dict[str, Any] = {}
    labelled: Any = zip(*axes.get_legend_handles_labels(), strict=True)
    for handle, label in sorted(labelled, key=lambda pair: isinstance(pair[0], PolyCollection)):
        handles.setdefault(label, handle)
    look: dict[str, Any] = {"fontsize": 8, "title_fontsize": 8, "columnspacing": 1.2, "handletextpad": 0.5}
    if (before := axes.get_legend()) is not None:
        look["title"] = before.get_title().get_text() or None
        labels = {" ".join(label.split()) for label in handles}
        for text, handle in zip(before.get_texts(), before.legend_handles, strict=True):
            if " ".join(text.get_text().split()) not in labels:  # it may be broken into lines
                handles[text.get_text()] = handle
        before.remove()
    figure: Figure = cast(Any, axes.get_figure(root=True))
    figure.draw_without_rendering()  # the layout settles at the second drawing
    if len(handles) < 5 and _legend_inside(figure, axes, handles, look):
        return
    legend = _legend_below(figure, axes, handles, look)
    if may_grow and len(figure.axes) == 1:
        across, high = figure.get_size_inches()
        least = max(axes.yaxis.label.get_window_extent().height, 0.5 * high * figure.dpi)
        left = axes.bbox.height - legend.get_window_extent().height
        figure.set_size_inches(across, high + max(least - left, 0.0) / figure.dpi)


def _put_legend(axes: Axes, handles: dict[str, Any], columns: int, **look: Any) -> Legend:
    """A legend in columns that is read row by row."""
    order = [label for k in range(columns) for label in list(handles)[k::columns]]
    return axes.legend([handles[label] for label in order], order, ncols=columns, **look)


def _legend_inside(figure: Figure, axes: Axes, handles: dict[str, Any], look: dict[str, Any]) -> bool:
    """Puts a legend inside the axes where it covers nothing but grid and shading; False if there is no place."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import to_rgb

    canvas = figure.canvas
    agg: Any = FigureCanvasAgg(figure)
    agg.draw()
    figure.set_canvas(canvas)
    pixels = np.asarray(agg.buffer_rgba())[::-1, :, :3] / 255
    inked = np.abs(pixels - to_rgb(axes.get_facecolor())).max(axis=2) > 0.12
    for columns, place in itertools.product((1, 2), _PLACES):
        legend = _put_legend(axes, handles, columns, loc=place, framealpha=1.0, **look)
        box = legend.get_window_extent().padded(3)
        rows, across = slice(int(box.y0), int(box.y1) + 1), slice(int(box.x0), int(box.x1) + 1)
        if np.all(box.size < axes.bbox.size) and not inked[rows, across].any():
            return True
        legend.remove()
    return False


def _legend_below(figure: Figure, axes: Axes, handles: dict[str, Any], look: dict[str, Any]) -> Legend:
    """Puts a legend below the axes, in as many columns as have room; labels wider than the axes are broken."""
    from matplotlib.transforms import ScaledTranslation

    figure.draw_without_rendering()
    if figure.get_layout_engine() is None:
        figure.set_layout_engine("constrained")  # else the legend would lie beyond the edge
    room, below = (cast(Bbox, part.get_tightbbox()) for part in (axes, axes.xaxis))
    aside = 0.5 * (room.x0 + room.x1 - axes.bbox.x0 - axes.bbox.x1) / figure.dpi
    shift = ScaledTranslation(aside, (below.y0 - axes.bbox.y0 - 4) / figure.dpi, figure.dpi_scale_trans)
    look = look | {
        "loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "bbox_transform": axes.transAxes + shift,
        "frameon": False, "borderaxespad": 0.0,
    }  # fmt: skip
    for columns in range(len(handles), 0, -1):
        legend = _put_legend(axes, handles, columns, **look)
        width = legend.get_window_extent().width
        if width <= room.width:
            return legend
        legend.remove()
    fit = int(max(map(len, handles)) * (room.width / width - 0.1))  # a tenth is for the handles
    fill = textwrap.TextWrapper(max(fit, 10)).fill
    return _put_legend(axes, {
        label if "\n" in label else fill(label.replace(" = ", "\u00a0=\u00a0")).replace("\u00a0", " "): handle
        for label, handle in handles.items()
    }, 1, **look)  # fmt: skip
