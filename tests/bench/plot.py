"""Cost of a tick against R/voxel and against the volume: bench/tick.png."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator
from measure import Measured
from report import EXPONENT_FROM, exponent, growth

from burrlab.common.figures import REFERENCE, new_figure, tidy

#: Colour and marker of each implementation (Okabe and Ito's palette).
STYLES = {
    "numpy": ("#999999", "v"),
    "numba": ("#E69F00", "D"),
    "plain": ("#555555", "o"),
    "scalar": ("#CC79A7", "P"),
    "portable": ("#56B4E9", "s"),
    "avx2": ("#0072B2", "^"),
    "avx512": ("#009E73", "x"),
}
LABELS = {
    "numpy": "NumPy",
    "numba": "Numba",
    "plain": "C++, plain loop",
    "scalar": "burrlab, scalar",
    "portable": "burrlab, SSE2",
    "avx2": "burrlab, AVX2",
    "avx512": "burrlab, AVX-512",
}


def plain_number(value: float, _: object = None) -> str:
    return f"{value:g}" if value < 1e5 else f"$10^{{{np.log10(value):.0f}}}$"


def draw_growth(axes: Axes, found: list[Measured]) -> None:
    """One line an implementation, with the exponent fitted from R/voxel = 25 on."""
    curves = growth(found, "slide")
    ticks = sorted({r for x, _ in curves.values() for r in x})
    for name in (name for name in STYLES if name in curves):
        x, y = curves[name]
        colour, marker = STYLES[name]
        slope = exponent(x, y)
        label = LABELS[name] + (f": {slope:.2f}" if np.isfinite(slope) else "")
        axes.plot(x, y, color=colour, marker=marker, markersize=5, linewidth=1.2, label=label)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda r, _: f"{r:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(plain_number))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("burr radius / voxel size [1]")
    axes.set_ylabel("time of a tick, median [µs]")
    axes.set_title("sunk to R/3, sliding through solid bone at 20 mm/s", fontsize=10)
    axes.legend(
        title=f"exponent fitted from {EXPONENT_FROM:g} on", title_fontsize=8, fontsize=8, frameon=False
    )
    tidy(axes)


def draw_volume(axes: Axes, volume: dict[str, Any]) -> None:
    """Time of the same slide in growing volumes."""
    rows = volume["sides"]
    side = np.array([int(s) for s in rows])
    for name, column in (("plain", "plain_median_us"), (volume["cpu_path"], "core_median_us")):
        colour, marker = STYLES[name]
        y = [row[column] for row in rows.values()]
        axes.plot(side**3, y, color=colour, marker=marker, markersize=5, linewidth=1.2)
        axes.annotate(LABELS[name], (side[0] ** 3, y[0]), xytext=(0, 7), textcoords="offset points", fontsize=8,
                      color=colour)  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(FixedLocator((side**3).tolist()))
    axes.set_xticklabels([f"{s}³" for s in side])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(plain_number))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(side[0] ** 3 / 2, 2 * side[-1] ** 3)
    axes.set_xlabel("volume [voxels]")
    axes.set_title(
        f"the same slide in a larger volume, R/voxel = {volume['radius_over_voxel']:g}", fontsize=10
    )
    tidy(axes)


def draw(found: list[Measured], volume: dict[str, Any], about: str, out: Path) -> None:
    """Both panels side by side with one scale of time."""
    figure = new_figure(9.6, 4.6)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.35, 1.0))
    draw_growth(left, found)
    draw_volume(right, volume)
    figure.supxlabel(about, fontsize=8, color=REFERENCE)
    figure.savefig(out, dpi=200)
