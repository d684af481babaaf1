"""Figures of a comparison of erosion shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullLocator

from burrlab.figures import FORCE, POSITION, REFERENCE, VELOCITY, axes_or_new, tidy
from burrlab.fitting.observations import Floats
from burrlab.fitting.plots import _plain_ticks
from burrlab.fitting.result import Fit
from burrlab.fitting.shape_family import NODES

if TYPE_CHECKING:
    from burrlab.fitting.shape_comparison import ShapeComparison

_LINES = (FORCE, VELOCITY, POSITION, "#CC79A7", "#E69F00", "#56B4E9")
_STYLES = ("-", "--", "-.", ":")
_LEAST = 5.0  # half of the linear part of the axis is at least this, in 100 ln
_TICKS = (1, 2, 5, 10, 20, 30, 50, 100, 300)


def plot_residuals(comparison: ShapeComparison, ax: Axes | None) -> Axes:
    """See `ShapeComparison.plot`."""
    ax = axes_or_new(ax)
    best = comparison.best
    o = best.fit.observations
    measured = 100 * np.log(o.velocity / _predicted(best.fit))
    half = max(1.25 * float(np.abs(measured).max()), _LEAST)
    farthest = half
    for i, row in enumerate(comparison.rows):
        force, ratio = _line(row.fit, best.fit)
        label = f"{row.shape.name}, rejected" if row.rejected else row.shape.name
        ax.plot(force, 100 * np.log(ratio), _STYLES[i % len(_STYLES)], color=_LINES[i % len(_LINES)],
                linewidth=1.4, label=label, zorder=3)  # fmt: skip
        farthest = max(farthest, 100 * float(np.abs(np.log(ratio)).max()))
    ax.plot(o.force, measured, "s", color="black", markersize=3.5, mfc="none", mew=0.8,
            label=f"data ({best.shape.name} fits best)", zorder=4)  # fmt: skip
    ax.set(xscale="log", xlabel="force [N]", ylabel=f"100 ln($v/v_\\mathrm{{{best.shape.name}}}$)")
    _plain_ticks(ax)
    step = float(next((s for s in _TICKS if half / s < 3), _TICKS[-1]))
    inner = np.arange(0, half, step)
    outer = np.array([s for s in (*_TICKS, 1000, 3000) if 1.5 * half < s <= farthest and str(s)[0] in "13"])
    if farthest > half:
        ax.set_yscale("symlog", linthresh=half, linscale=2.0)
        ax.axhspan(-half, half, color="0.96", zorder=0)
    ticks = np.concatenate([inner, outer])
    ax.yaxis.set_major_locator(FixedLocator([*-ticks[1:], *ticks]))
    ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set(ylim=(-1.1 * farthest, 1.1 * farthest), xlim=(0.93 * o.force.min(), 1.07 * o.force.max()))
    ax.legend(frameon=False, fontsize="small", ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return tidy(ax)


def _predicted(one: Fit) -> Floats:
    return np.asarray(one.alpha * one.likelihood.model.unit(one.c_e))


def _line(one: Fit, best: Fit) -> tuple[Floats, Floats]:
    """Force [N] and velocity over the best's: smooth where all rows have one radius and the default window."""
    o = best.observations
    if np.isnan(o.window_start).all() and one.radius is not None:
        force = np.geomspace(o.force.min(), o.force.max(), 200)
        return force, np.asarray(one.velocity(force)) / np.asarray(best.velocity(force))
    force, inverse = np.unique(o.force, return_inverse=True)
    log = np.log(_predicted(one) / _predicted(best))
    return force, np.exp(np.bincount(inverse, log) / np.bincount(inverse))


def plot_power(comparison: ShapeComparison, ax: Axes | None) -> Axes:
    """See `ShapeComparison.plot_power`."""
    ax = axes_or_new(ax)
    power = comparison.power
    assert power is not None
    largest = max(power.limits.values())
    ax.set_yscale("symlog", linthresh=largest, linscale=2.0)
    ax.plot(power.grid, power.rise, color=FORCE, linewidth=1.4)
    for level, limit in power.limits.items():
        ax.axhline(limit, color=REFERENCE, linewidth=0.8, linestyle="--")
        ax.annotate(f"{level} %", (0.995, limit), xycoords=("axes fraction", "data"), xytext=(0, 2),
                    textcoords="offset points", ha="right", fontsize=8, color=REFERENCE)  # fmt: skip
    for k, name in ((0, "constant"), (1, "parabolic"), (2, "quartic")):
        rise = float(np.interp(k, power.grid, power.rise))
        ax.plot(k, rise, "o", color=VELOCITY, markersize=5, zorder=4, clip_on=False)
        ax.annotate(
            name,
            (k, rise),
            xytext=(8, -11 if rise > largest and k > power.k else 4),
            textcoords="offset points",
            fontsize=8,
            color=VELOCITY,
        )
    top = max(10 * largest, 2.0 * float(power.rise.max()))
    ax.set(
        xlabel="$k$ of $f = (1 - x^2)^k$", ylabel="rise of $-2 \\log L$", xlim=(NODES[0] - 0.08, NODES[-1])
    )
    ax.set_ylim(0, top)
    step = 2 if largest < 12 else 5
    powers = 10.0 ** np.arange(1, np.floor(np.log10(top)) + 1)
    ax.yaxis.set_major_locator(FixedLocator([*np.arange(0, largest, step), *powers[powers > 1.3 * largest]]))
    ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.yaxis.set_minor_locator(NullLocator())
    interval = power.intervals["95"]
    ends = [f"{NODES[0]:g}" if interval.lower is None else f"{interval.lower:.3f}"]
    ends.append("open" if interval.upper is None else f"{interval.upper:.3f}")
    ax.set_title(f"$k$ = {power.k:.3f}, 95 %: {ends[0]} .. {ends[1]}", fontsize=10)
    return tidy(ax)
