"""Figures of an analysis: scores, intervals, d' by rule."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from burrlab.common.figures import FORCE, REFERENCE, VELOCITY, axes_or_new, styled
from burrlab.psychophysics.rules import Floats

STYLES = {"independent-observations": (FORCE, "o"), "differencing": (VELOCITY, "s")}
_LOWEST = 4.0  # the least end of a d' axis


def room_for(ax: Axes | None, rows: float) -> Axes:
    """The given axes, or axes of a new figure that is tall enough for the rows."""
    ax, new = axes_or_new(ax), ax is None
    if new and rows > 13 and isinstance(ax.figure, Figure):
        ax.figure.set_figheight(1.2 + 0.19 * rows)
    return ax


def draw(
    ax: Axes, spans: Sequence[tuple[float, float, float]], rows: Floats, end: float, style: dict[str, Any],
    colour: str, marker: str,
) -> None:  # fmt: skip
    """Draws intervals as lines, or arrows if open above; an infinite estimate is a hollow mark.

    A span is lower end, estimate, upper end; the last two may be infinite.
    """
    look = styled(style, color=colour, marker=marker, markersize=4.5, zorder=4)
    colour = look["color"]
    for (low, estimate, high), row in zip(spans, rows, strict=True):
        if math.isinf(high):
            ax.annotate("", (0.995 * end, row), (low, row), annotation_clip=False,
                        arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0})  # fmt: skip
            ax.plot([low, low], [row - 0.11, row + 0.11], color=colour, linewidth=1.2)
        else:
            ax.errorbar(0.5 * (low + high), row, xerr=0.5 * (high - low), fmt="none", ecolor=colour,
                        elinewidth=1.2, capsize=2.5)  # fmt: skip
        if math.isinf(estimate):
            ax.plot(0.96 * end, row, **(look | {"mfc": "white"}))
        else:
            ax.plot(estimate, row, **look, clip_on=False)
        look["label"] = None


def draw_d_prime(
    ax: Axes, by_rule: Mapping[Any, Sequence[Any]], rows: Floats, level: float, style: dict[str, Any],
    delta: float | None,
) -> None:  # fmt: skip
    """Draws d' by each rule side by side, with chance and any Delta; each d' has an estimate and an interval."""
    all_spans = [[(d.interval[0], d.estimate, d.interval[1]) for d in some] for some in by_rule.values()]
    spans = [span for some in all_spans for span in some]
    # beyond all finite values
    end = 1.15 * max(_LOWEST, *(value for span in spans for value in span if math.isfinite(value)), 0.0)
    for i, (rule, some) in enumerate(zip(by_rule, all_spans, strict=True)):
        shift = 0.36 * (i - 0.5 * (len(by_rule) - 1))
        colour, marker = STYLES[rule]
        draw(ax, some, rows + shift, end, {"label": None} | style, colour, marker)
        label = f"{style['label']}, {rule}" if style.get("label") else rule
        ax.plot([], [], **styled({**style, "label": label}, color=colour, marker=marker, markersize=4.5))
    ax.axvline(0, color=REFERENCE, linestyle="--", linewidth=1, label="chance, d' = 0")
    if delta is not None:
        ax.axvline(delta, color="black", linestyle=":", linewidth=1, label=f"Δ = {delta:g}")
    if any(math.isinf(estimate) for _, estimate, _ in spans):
        ax.plot([], [], "o", color=REFERENCE, mfc="white", markersize=5, label="estimate infinite")
    ax.set(xlim=(-0.03 * end, end), xlabel=f"d' [sd], {100 * level:g} % interval")


def of_subjects(ax: Axes, names: Sequence[str], rows: Floats, title: str) -> Axes:
    """The axes with one name per row."""
    ax.set_yticks(rows, names, fontsize=8)
    ax.set(ylim=(rows[-1] + 0.7, -0.7), ylabel="subject", title=title)
    ax.legend()
    return ax
