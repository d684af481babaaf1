"""Figures of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from burrlab.curve import VelocityCurve
from burrlab.figures import FORCE, POSITION, REFERENCE, VELOCITY, axes_or_new, tidy
from burrlab.fitting.intervals import LEVELS
from burrlab.fitting.observations import Floats
from burrlab.fitting.profile import ALPHA, C_E
from burrlab.master_curve import MasterCurve

if TYPE_CHECKING:
    from burrlab.fitting.result import Fit

_SHADES = {"99.7": "#d4e6f4", "95": "#8dbfe2", "68": "#3c8cc4"}
LINES = (FORCE, VELOCITY, POSITION, "black")  # of several radii
_UNITS = {"c_e": "$c_e$ [N/mm²]", "alpha": "$\\alpha$ [1/ms]"}
_BAND = 60  # lines whose envelope is the band


def plot_fit(fit: Fit, ax: Axes | None, alpha_lines: float | None, log: bool) -> Axes:
    """See `Fit.plot`."""
    ax = axes_or_new(ax)
    o = fit.observations
    for one in fit.data:
        if isinstance(one, VelocityCurve):
            one.plot(ax, log=log)
    single = o.run < 0
    if not single.all():
        ax.plot(o.force[~single], o.velocity[~single], "D", color="black", mfc="none", ms=3.5, mew=0.7,
                label="segments of traces")  # fmt: skip
    label: str | None = f"fit: $c_e$ = {fit.c_e:#.3g} N/mm², $\\alpha$ = {fit.alpha:#.3g} /ms"
    default = np.isnan(o.window_start)
    for i, R in enumerate(sorted(set(o.radius[default].tolist()))):
        used = o.force[default & (o.radius == R)]
        low = 0.85 * used.min() if log else 0.3 * used.min()
        high = min(1.04 * used.max(), 0.999 * fit.c_e * R**2 / 27**0.5)
        force = np.geomspace(low, high, 300)
        lower, upper = band(fit, force, R)
        ax.fill_between(force, lower, upper, color=_SHADES["99.7"], label=label and "95 % band", zorder=1)
        several = fit.radius is None
        colour = LINES[i % len(LINES)] if several else "black"
        shown_as = f"fit, R = {R:g} mm" if several else label
        ax.plot(force, fit.velocity(force, radius=R), color=colour, linewidth=1.2, label=shown_as)
        label = None
        if alpha_lines is not None:
            for sign, name in ((-1, f"$\\alpha$ ± {alpha_lines:g} /ms"), (1, None)):
                line = fit.velocity(force, radius=R) * (1 + sign * alpha_lines / fit.alpha)
                ax.plot(force, line, "--", color="0.4", linewidth=0.9, label=name)
    if fit.engine == "voxel" or not default.all():
        name = "voxel descents" if fit.engine == "voxel" else "fit, over each row's window"
        rows = np.concatenate([np.full(len(rows), kind == "velocity") for kind, rows in o.rows])
        ax.plot(o.force, fit.predicted[rows], "o", color=VELOCITY, markersize=3, label=name, zorder=4)
    ax.set(xlabel="force [N]", ylabel="penetration velocity [mm/s]")
    if log:
        ax.autoscale()  # an axis that began at zero has no logarithm
        _plain_ticks(ax)
    else:
        ax.set(xlim=(0, 1.06 * o.force.max()), ylim=(0, None))
    handles, labels = ax.get_legend_handles_labels()
    shown = dict(zip(labels, handles, strict=True))
    ax.legend(list(shown.values()), list(shown), frameon=False, fontsize="small")
    return tidy(ax)


def band(fit: Fit, force: Floats, radius: float) -> tuple[Floats, Floats]:
    """Lowest and highest mean-field velocity [mm/s] at each force over the parameters of the 95 % limit."""
    if fit.evidence is None:
        return np.full(len(force), np.nan), np.full(len(force), np.nan)
    region = fit.evidence.profile.regions["95"]
    picked = np.unique(np.linspace(0, len(region.c_e) - 1, _BAND).round().astype(int))
    curve = MasterCurve(fit.shape)
    unit = 1e3 * radius * curve.velocity_ratio(force / (region.c_e[picked, None] * radius**2))
    with np.errstate(invalid="ignore"):
        low = np.nanmin(np.where(np.isnan(unit), np.inf, unit * region.lower[picked, None]), axis=0)
        high = np.nanmax(np.where(np.isnan(unit), -np.inf, unit * region.upper[picked, None]), axis=0)
    return low, high


def plot_profile(fit: Fit, name: str, ax: Axes | None) -> Axes:
    """See `Fit.plot_profile`."""
    ax = axes_or_new(ax)
    assert fit.evidence is not None
    profile = fit.evidence.profile
    x, rise = (profile.c_e, profile.c_e_rise) if name == "c_e" else (profile.alpha, profile.alpha_rise)
    direction = {"c_e": C_E, "alpha": ALPHA}[name]
    limits = {level: fit.evidence.calibration.limit(p, direction) for level, p in LEVELS.items()}
    top = 1.6 * limits["99.7"]
    near = np.flatnonzero((rise < top) & (x < 12 * getattr(fit, name)))
    shown = slice(max(near[0] - 1, 0), near[-1] + 2)
    ax.plot(x[shown], rise[shown], color=FORCE, linewidth=1.4)
    for level, limit in limits.items():
        ax.axhline(limit, color=REFERENCE, linewidth=0.8, linestyle="--")
        ax.annotate(f"{level} %", (0.995, limit), xycoords=("axes fraction", "data"), xytext=(0, 2),
                    textcoords="offset points", ha="right", fontsize=8, color=REFERENCE,
                    bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none"})  # fmt: skip
    ax.axvline(getattr(fit, name), color="black", linewidth=0.8)
    interval = profile.intervals[name]["95"]
    for end in (interval.lower, interval.upper):
        if end is not None and end < 12 * getattr(fit, name):
            ax.axvline(end, color=FORCE, linewidth=0.8, linestyle=":")
    if interval.upper is None:
        ax.annotate("open above", (0.99, 0.04), xycoords="axes fraction", ha="right", fontsize=8, color=FORCE)
    ax.set(xscale="log", xlabel=_UNITS[name], ylabel="rise of $-2 \\log L$", ylim=(0, top))
    ax.set_xlim(0.97 * x[near[0]], 1.03 * x[near[-1]])
    _plain_ticks(ax)
    return tidy(ax)


def plot_region(
    fit: Fit, ax: Axes | None, points: Mapping[str, tuple[float, float]] | None, combination: bool
) -> Axes:
    """See `Fit.plot_region`."""
    ax = axes_or_new(ax)
    assert fit.evidence is not None
    widest = 12 * fit.c_e
    p = fit.evidence.profile.identified.exponent if combination else 0.0
    for level in reversed(list(LEVELS)):
        region = fit.evidence.profile.regions[level]
        near = region.c_e <= widest
        suffix = ", open above" if region.open_above else ""
        c_e = region.c_e[near]
        ax.fill_between(c_e, region.lower[near] / c_e**p, region.upper[near] / c_e**p, color=_SHADES[level],
                        linewidth=0.6, edgecolor=FORCE, label=f"{level} %{suffix}")  # fmt: skip
    ax.plot(fit.c_e, fit.alpha / fit.c_e**p, "+", color="black", ms=8, mew=1.4, label="fit")
    for marker, (name, (c_e_there, alpha)) in zip("osD^v*", (points or {}).items(), strict=False):
        ax.plot(
            c_e_there, alpha / c_e_there**p, marker, color=VELOCITY, mfc="white", mew=1.2, ms=5.5, label=name
        )
    power = f"$\\alpha/c_e^{{{p:.3g}}}$ [(1/ms) (mm²/N)$^{{{p:.3g}}}$]"
    ax.set(xscale="log", yscale="log", xlabel=_UNITS["c_e"], ylabel=power if combination else _UNITS["alpha"])
    low, high = ax.get_ylim()
    ax.set_ylim(low * (low / high) ** 0.3, high)  # room for the legend
    _plain_ticks(ax)
    ax.legend(loc="lower right", ncols=2, frameon=False, fontsize="small")
    return tidy(ax)


def _plain_ticks(ax: Axes) -> None:
    """Numbers instead of powers on logarithmic axes, more of them where less than a decade is shown."""
    for axis, scale, (low, high) in (
        (ax.xaxis, ax.get_xscale(), ax.get_xlim()),
        (ax.yaxis, ax.get_yscale(), ax.get_ylim()),
    ):
        if scale == "log":
            decades = np.log10(high / low)
            subs = (1, 2, 5) if decades > 0.7 else (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
            axis.set_major_locator(LogLocator(subs=subs if decades < 3 else (1,)))
            axis.set_major_formatter(FormatStrFormatter("%g"))
            axis.set_minor_formatter(NullFormatter())
