"""Figures fit for a paper; every function returns Axes and never shows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from scipy.signal import savgol_filter

from burrlab.volume.header import assumed, told_notes
from burrlab.window import samples_between

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from burrlab.descent_result import Descent

#: One colour a quantity throughout the package (Okabe and Ito's palette, distinguishable without colour vision).
FORCE, POSITION, VELOCITY, REFERENCE = "#0072B2", "#009E73", "#D55E00", "#555555"


def new_figure(width: float = 6.4, height: float = 4.4) -> Figure:
    """A figure of its own [inch], outside pyplot, so that many threads and notebooks may draw."""
    return Figure(figsize=(width, height), layout="constrained")


def axes_or_new(axes: Axes | None) -> Axes:
    """The given axes, or those of a new pyplot figure of the usual size."""
    if axes is not None:
        return axes
    from matplotlib import pyplot

    made: Axes = pyplot.subplots(figsize=(4.8, 3.6), layout="constrained")[1]
    return made


def tidy(axes: Axes) -> Axes:
    """Quiet grid, no upper and right frame."""
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def plot_descent(run: Descent, figure: Figure | None = None) -> list[Axes]:
    """Force, immersion and velocity over time with the window shaded (the paper's Fig. 4)."""
    figure = new_figure(6.4, 6.4) if figure is None else figure
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    name = "unknown material" if run.material is None else run.material.name
    top.plot(run.time, run.force, color=FORCE, linewidth=0.8)
    top.axhline(run.setpoint, color=REFERENCE, linewidth=0.8, linestyle="--")
    top.annotate(f"set-point {run.setpoint:g} N", (0.99, run.setpoint), xycoords=("axes fraction", "data"),
                 xytext=(0, 3), textcoords="offset points", ha="right", color=REFERENCE, fontsize=8)  # fmt: skip
    top.set_ylabel("force [N]")
    top.set_ylim(
        bottom=min(0.0, float(run.force.min(initial=0.0))),
        top=1.35 * max(run.setpoint, run.force.max(initial=0.0) / 1.2),
    )
    middle.plot(run.time, run.immersion, color=POSITION, linewidth=1.2)
    middle.axhline(0, color=REFERENCE, linewidth=0.8, linestyle=":")
    middle.set_ylabel("immersion [mm]")
    middle.invert_yaxis()
    light: dict[str, float] = {"linewidth": 1.2} if run.series.exact else {"linewidth": 0.7, "alpha": 0.6}
    bottom.plot(run.time, run.velocity, color=VELOCITY, label="slope over 51 samples", **light)
    bottom.set_ylabel("velocity [mm/s]")
    bottom.set_xlabel("time [s]")
    if len(run.time):
        shown = samples_between(run.immersion, *run.window) if run.window is not None else slice(None)
        steady = run.velocity[shown]
        bottom.set_ylim(0, 1.2 * max(float(steady.max(initial=0.0)), 1e-6) if run.series.exact else None)
    if run.window is not None and run.penetration_velocity is not None:
        rows = samples_between(run.immersion, *run.window)
        t = run.time[rows]
        if not run.series.exact and len(t) > 2 * 51:
            # The rig reads positions in steps: a longer slope shows the velocity under their ripple.
            span = max(51, len(t) // 8) | 1
            slope = savgol_filter(run.immersion[rows], span, 2, deriv=1, delta=float(t[1] - t[0]))
            bottom.plot(t, slope, color=VELOCITY, linewidth=1.6, label=f"over {span} samples")
            bottom.legend(fontsize=8, frameon=False)
        for axes in (top, middle, bottom):
            axes.axvspan(t[0], t[-1], color="0.93", zorder=0)
        line = run.immersion[rows].mean() + run.penetration_velocity * (t - t.mean())
        middle.plot(t, line, color=REFERENCE, linewidth=1.0, linestyle="--")
        middle.annotate(f"{run.penetration_velocity:.3g} mm/s", (t.mean(), line.mean()), xytext=(8, 8),
                        textcoords="offset points", color=REFERENCE, fontsize=9)  # fmt: skip
    for phase, (begin, end) in run.phases.items():
        if end - begin > 0.04 * max(run.duration, 1e-9):
            top.annotate(
                phase,
                ((begin + end) / 2, 0.97),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="top",
                fontsize=8,
            )
        top.axvline(begin, color="0.75", linewidth=0.6)
    said = "".join(f"; {text.split(':')[0]}" for text in run.warnings)
    said += f"; {note}" if (note := assumed(told_notes(run.provenance.get("volume")))) else ""
    kind = "force held exactly" if run.series.exact else "controller and rig"
    top.set_title(f"{name}, R = {run.burr.radius:g} mm, {kind}{said}", fontsize=10)
    return [tidy(axes) for axes in (top, middle, bottom)]
