"""Cost of a tick against R/voxel and against the volume: bench/tick.png."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator
from report import EXPONENT_FROM, Results, exponent, growth

from burrlab.common.figures import REFERENCE, new_figure, tidy

#: Colour, marker and label of each implementation (Okabe and Ito's palette).
STYLES = {
    "plain": ("#555555", "o", "C++, plain loop"),
    "scalar": ("#CC79A7", "P", "burrlab, scalar"),
    "portable": ("#56B4E9", "s", "burrlab, SSE2"),
    "avx2": ("#0072B2", "^", "burrlab, AVX2"),
    "avx512": ("#009E73", "x", "burrlab, AVX-512"),
}


def plain_number(value: float, _: object = None) -> str:
    return f"{value:g}" if value < 1e5 else f"$10^{{{np.log10(value):.0f}}}$"


def draw_line(axes: Axes, name: str, x: object, y: object, more: str = "") -> str:
    """Draws in the style of an implementation; returns its colour."""
    colour, marker, label = STYLES[name]
    axes.plot(x, y, color=colour, marker=marker, markersize=5, linewidth=1.2, label=label + more)
    return colour


def finish(axes: Axes, ticks: list[float], labels: list[str], along: str, title: str) -> None:
    """Logarithmic scales, with ticks along x at the measurements."""
    axes.set(xscale="log", yscale="log", xlabel=along)
    axes.set_xticks(ticks, labels)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(plain_number))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_title(title, fontsize=10)
    tidy(axes)


def draw_growth(axes: Axes, curves: dict[str, tuple[list[float], list[float]]]) -> None:
    """One line per implementation, with the exponent fitted from R/voxel = 25 on."""
    for name in (name for name in STYLES if name in curves):
        slope = exponent(*curves[name])
        draw_line(axes, name, *curves[name], f": {slope:.2f}" if np.isfinite(slope) else "")
    ticks = sorted({r for x, _ in curves.values() for r in x})
    finish(
        axes, ticks, [f"{r:g}" for r in ticks], "burr radius / voxel size [1]",
        "sunk to R/3, sliding through solid bone at 20 mm/s",
    )  # fmt: skip
    axes.set_ylabel("time of a tick, median [µs]")
    axes.legend(
        title=f"exponent fitted from {EXPONENT_FROM:g} on", title_fontsize=8, fontsize=8, frameon=False
    )


def draw_volume(axes: Axes, volume: dict[str, Any]) -> None:
    """Time of the same slide in growing volumes."""
    rows = volume["sides"]
    voxels = [int(side) ** 3 for side in rows]
    for name, column in (("plain", "plain_median_us"), (volume["cpu_path"], "core_median_us")):
        y = [row[column] for row in rows.values()]
        axes.annotate(STYLES[name][2], (voxels[0], y[0]), xytext=(0, 7), textcoords="offset points", fontsize=8,
                      color=draw_line(axes, name, voxels, y))  # fmt: skip
    title = f"the same slide in a larger volume, R/voxel = {volume['radius_over_voxel']:g}"
    finish(axes, voxels, [f"{side}³" for side in rows], "volume [voxels]", title)
    axes.set_xlim(voxels[0] / 2, 2 * voxels[-1])


def draw(results: Results, about: str, out: Path) -> None:
    """Both panels side by side with one scale of time."""
    figure = new_figure(9.6, 4.6)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.35, 1.0))
    draw_growth(left, growth(results, "slide"))
    draw_volume(right, results["volume"])
    figure.supxlabel(about, fontsize=8, color=REFERENCE)
    figure.savefig(out, dpi=200)
