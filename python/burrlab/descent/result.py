"""The result of a descent: series, window, velocity and status, its JSON and its figure."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from burrlab._core import Burr, Material
from burrlab.bone.header import assumed, told_notes
from burrlab.bone.specimen import CUT
from burrlab.bone.tissues import label_scatter
from burrlab.common.check import content_of, refuse
from burrlab.common.figures import FORCE, POSITION, REFERENCE, VELOCITY, Axes, Panels, drawing, panels, styled
from burrlab.common.files import write_text
from burrlab.common.records import AsDict, Codec, parsed
from burrlab.common.table import Tabular, by_value, html_pairs
from burrlab.theory.closed_forms import (
    FEWEST_TICKS,
    Array,
    layer_thickness,
    penetration_velocity_between,
    samples_between,
    settled_immersion,
    static_immersion,
)
from burrlab.theory.tool import law_of


@by_value
@dataclass(frozen=True)
class Series:
    """The record of a descent, one row per sample."""

    time: Array  #: [s]
    immersion: Array  #: [mm], as read
    force: Array  #: axial [N], as measured
    command: Array  #: velocity commanded [mm/s], NaN in the exact mode
    exact: bool
    noise: float = 0.0  #: of the load cell [N]
    ambiguous: int = 0  #: ticks whose contact had no direction
    faint: int = 0  #: ticks with over 5 % of the contact in voxels with pristine level below 32


@dataclass(frozen=True)
class Descent(AsDict, Tabular):
    """A burr's descent at constant force. Made by `descend`; `to_dict` has all but the series, and NaN as it is.

    Attributes
    ----------
    status : str
        ``ok``, ``overloaded``, ``out-of-range``, ``never-touched``, ``never-settled``, ``window-too-short``,
        ``stalled`` or ``interrupted``; any but ``ok`` has a `reason` and no `penetration_velocity`.
    penetration_velocity : float or None
        Least-squares slope of immersion over time in `window` [mm/s].
    window : (float, float) or None
        Immersions [mm] between which it was measured. Velocity falls with depth, so it needs its window.
    velocity_fall : float or None
        Velocity in the first third of the window over that in the last.
    layer_resolution : float or None
        Thickness of the cutting layer over the voxel spacing, delta_0/s.
    warnings : tuple of str
        Coarse voxels, faint bone, contact without a direction, labels alone.
    phases : dict of str to (float, float)
        Begin and end [s] of approach, impact, settling, steady; phases that did not occur are missing.
    time, immersion, force, command : ndarray, shape (n,)
        [s], [mm], [N], [mm/s]
    """

    burr: Burr
    material: Material | None
    setpoint: float
    stop: float
    status: str
    reason: str
    penetration_velocity: float | None
    window: tuple[float, float] | None
    velocity_fall: float | None
    layer_resolution: float | None
    phases: dict[str, tuple[float, float]]
    warnings: tuple[str, ...]
    series: Series = field(repr=False)
    provenance: dict[str, Any] = field(repr=False)

    @property
    def time(self) -> Array:
        return self.series.time

    @property
    def immersion(self) -> Array:
        return self.series.immersion

    @property
    def force(self) -> Array:
        return self.series.force

    @property
    def command(self) -> Array:
        return self.series.command

    @property
    def velocity(self) -> Array:
        """Slope of immersion over the 51 samples around each [mm/s]; fewer in a shorter record."""
        n = len(self.time)
        if n < 3:
            return np.full(n, np.nan)
        span = min(51, n if n % 2 else n - 1)
        return np.asarray(
            scipy.signal.savgol_filter(
                self.immersion, span, 1, deriv=1, delta=float(self.time[1] - self.time[0])
            )
        )

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.time[-1]) if len(self.time) else 0.0

    def velocity_over(self, start: float, end: float) -> float | None:
        """Penetration velocity between two immersions [mm] of the record [mm/s]; None without two samples."""
        return penetration_velocity_between(self.time, self.immersion, start, end)

    def save(self, path: str | Path) -> None:
        """Writes result and series as JSON, without loss."""
        record = self._codec.plain(self.series)
        columns = {name: record.pop(name) for name in ("time", "immersion", "force", "command")}
        write_text(path, json.dumps({**self.to_dict(), "series": columns, "record": record}))

    @staticmethod
    def load(path: str | Path) -> "Descent":
        """The result in a file of `save`; ValueError for another file."""
        return parsed(str(path), content_of(path), "the JSON of a descent", Descent._of, finite=False)

    @staticmethod
    def _of(data: dict[str, Any]) -> "Descent":
        data["series"] |= data.pop("record")
        made = Descent._codec.made(Descent, data)
        series = made.series
        shapes = {values.shape for values in (series.time, series.immersion, series.force, series.command)}
        refuse(len(shapes) > 1 or series.time.ndim != 1, "its series differ in length")
        return made

    def _table(self) -> dict[str, Array]:
        units = {"time": "s", "immersion": "mm", "force": "N", "velocity": "mm_s", "command": "mm_s"}
        return {f"{name}_{unit}": getattr(self, name) for name, unit in units.items()}

    @drawing
    def plot(self, ax: Panels = None, **style: Any) -> "list[Axes]":
        """The three Axes of force, position and velocity over time, as in the paper's Fig. 4.

        `style`: `label`, `color` and other properties of the three lines.
        """
        top, middle, bottom = panels(ax, (3, 1), (6.4, 6.4), sharex=True)
        name = "unknown material" if self.material is None else self.material.name
        top.plot(self.time, self.force, **styled(style, color=FORCE, linewidth=0.8))
        top.axhline(self.setpoint, color=REFERENCE, linewidth=0.8, linestyle="--")
        top.annotate(f"set-point {self.setpoint:g} N", (0.99, self.setpoint), xycoords=("axes fraction", "data"),
                     xytext=(0, 3), textcoords="offset points", ha="right", color=REFERENCE, fontsize=8)  # fmt: skip
        highest = 1.35 * max(self.setpoint, self.force.max(initial=0.0) / 1.2)
        top.set(ylabel="force [N]", ylim=(min(0.0, float(self.force.min(initial=0.0))), highest))
        middle.plot(self.time, self.immersion, **styled(style, color=POSITION, linewidth=1.2))
        middle.axhline(0, color=REFERENCE, linewidth=0.8, linestyle=":")
        middle.set_ylabel("immersion [mm]")
        middle.yaxis.set_inverted(True)
        light: dict[str, float] = (
            {"linewidth": 1.2} if self.series.exact else {"linewidth": 0.7, "alpha": 0.6}
        )
        look = styled(style, color=VELOCITY, label="slope over 51 samples", **light)
        bottom.plot(self.time, self.velocity, **look)
        bottom.set(xlabel="time [s]", ylabel="velocity [mm/s]")
        rows = slice(None) if self.window is None else samples_between(self.immersion, *self.window)
        if len(self.time):
            highest = float(self.velocity[rows].max(initial=0.0))
            bottom.set_ylim(0, 1.2 * max(highest, 1e-6) if self.series.exact else None)
        if self.window is not None and self.penetration_velocity is not None:
            t = self.time[rows]
            if not self.series.exact and len(t) > 2 * 51:
                # The rig reads positions in steps; a slope over more samples smooths their ripple.
                span = max(51, len(t) // 8) | 1
                slope = scipy.signal.savgol_filter(
                    self.immersion[rows], span, 2, deriv=1, delta=float(t[1] - t[0])
                )
                bottom.plot(t, slope, color=look["color"], linewidth=1.6, label=f"over {span} samples")
            for axes in (top, middle, bottom):
                axes.axvspan(t[0], t[-1], color="0.93", zorder=0)
            line = self.immersion[rows].mean() + self.penetration_velocity * (t - t.mean())
            middle.plot(t, line, color=REFERENCE, linewidth=1.0, linestyle="--")
            middle.annotate(f"{self.penetration_velocity:.3g} mm/s", (t.mean(), line.mean()), xytext=(8, 8),
                            textcoords="offset points", color=REFERENCE, fontsize=8)  # fmt: skip
        for phase, (begin, end) in self.phases.items():
            if end - begin > 0.04 * max(self.duration, 1e-9):
                # the velocity falls in a window, too
                label = "window" if phase == "steady" and self.window is not None else phase
                top.text(0.5 * (begin + end), 0.97, label, transform=top.get_xaxis_transform(),
                         ha="center", va="top", fontsize=8)  # fmt: skip
            top.axvline(begin, color="0.75", linewidth=0.6)
        notes = "".join(f"; {text.split(':')[0]}" for text in self.warnings)
        notes += f"; {note}" if (note := assumed(told_notes(self.provenance.get("volume")))) else ""
        kind = "force held exactly" if self.series.exact else "controller and rig"
        top.set_title(f"{name}, R = {self.burr.radius:g} mm, {kind}{notes}")
        return [top, middle, bottom]

    def _repr_html_(self) -> str:
        return html_pairs({key: value for key, value in self.to_dict().items() if key != "provenance"})

    def __repr__(self) -> str:
        name = "unknown material" if self.material is None else self.material.name
        head = f"Descent({name}, {self.setpoint:g} N, R = {self.burr.radius:g} mm: {self.status}"
        notes = "".join(f"; {text}" for text in self.warnings)
        if self.penetration_velocity is None or self.window is None:
            return f"{head}, {self.reason}{notes})"
        return (
            f"{head}, {self.penetration_velocity:.4g} mm/s between {self.window[0]:.3f} and "
            f"{self.window[1]:.3f} mm, "
            f"{self.velocity_fall or float('nan'):.2f} times faster in its first third than in its "
            f"last{notes})"
        )


Descent._codec = Codec(
    "kept",
    keys={
        Material: {
            "parts": lambda material: (
                {name: getattr(material, name) for name in ("name", "c_e", "alpha", "shape", "source")}
                | law_of(material)
            )
        },
        Descent: {
            "status": "status",
            "reason": "reason",
            "penetration_velocity_mm_s": "penetration_velocity",
            "window_mm": "window",
            "velocity_fall": "velocity_fall",
            "force_N": "setpoint",
            "radius_mm": "burr",
            "duration_s": lambda run: run.duration,
            "stop_mm": "stop",
            "layer_resolution": "layer_resolution",
            "warnings": "warnings",
            "phases_s": "phases",
            "material": "material",
            "seed": lambda run: run.provenance.get("seed"),
            "version": lambda run: run.provenance["burrlab"],
            "provenance": "provenance",
        },
    },
)


def evaluate(
    burr: Burr,
    material: Material | None,
    setpoint: float,
    stop: float,
    series: Series,
    ending: str,
    provenance: dict[str, Any],
    *,
    cut: int = 0,
) -> Descent:
    """Window, velocity and status of a recorded descent; `cut` by `Border.count_cut`."""
    h, force = series.immersion, series.force
    if series.exact:
        settled = float(h[0]) if len(h) else None
    else:
        pressed = force >= 0.1 * setpoint
        begun = int(np.argmax(pressed)) if np.any(pressed) else len(h)
        settled = settled_immersion(
            h[begun:], force[begun:], setpoint, span=_samples_of_settling(series, setpoint)
        )
    status, reason = _status(burr, material, setpoint, stop, series, ending, settled)
    window, velocity, fall, resolution = None, None, None, None
    if status == "ok":
        assert settled is not None
        start, third = float(max(burr.radius / 6, settled)), (stop - max(burr.radius / 6, settled)) / 3
        window = (start, float(stop))
        velocity, early, late = (
            penetration_velocity_between(series.time, h, *between)
            for between in (window, (start, start + third), (stop - third, stop))
        )
        fall = early / late if early and late else None
        if velocity and material is not None and velocity > 0 and "spacing_mm" in provenance:
            thickness = layer_thickness(burr, material, velocity, setpoint)
            resolution = None if thickness is None else thickness / max(provenance["spacing_mm"])
    return Descent(
        burr, material, float(setpoint), float(stop), status, reason, velocity, window, fall, resolution,
        _phases(series, setpoint, settled), _warnings(burr, series, provenance, cut), series, provenance,
    )  # fmt: skip


def _samples_of_settling(series: Series, setpoint: float) -> int:
    """Samples over which the mean of the force must lie at the set-point; more where the cell is noisy."""
    return 101 if series.noise > 0.1 * setpoint else 51


def _status(
    burr: Burr, material: Material | None, setpoint: float, stop: float, series: Series, ending: str, settled: float | None
) -> tuple[str, str]:  # fmt: skip
    """The status of a run that ended so, and its reason, which is empty for "ok"."""
    h = series.immersion
    static = 0.0 if material is None else static_immersion(burr, material, setpoint)
    if ending == "interrupted":
        return ending, f"interrupted at an immersion of {h[-1] if len(h) else 0.0:.3f} mm"
    if ending == "overloaded" or (static >= stop and ending != "never-touched"):
        bound = ""
        if material is not None and static >= stop:
            most = material.c_e * burr.radius**2 * (stop / burr.radius) ** material.force_exponent
            bound = f"; static contact carries at most {most:.4g} N there"
        return "overloaded", (
            f"the set-point of {setpoint:g} N is not reached by static contact above the stop at {stop:.3f} mm{bound}"
        )
    if ending == "stalled":
        deepest, time = (f"{h[-1]:.3f}", series.time[-1]) if len(h) else ("no", 0.0)
        return ending, f"at {deepest} mm of {stop:.3f} mm after {time:.4g} s, when the run was given up"
    if ending == "out-of-range":
        return (
            ending,
            f"at {h[-1]:.3f} mm the force reached {series.force[-1]:.4g} N, the end of the rig's range",
        )
    if ending == "never-touched":
        return ending, "the burr met no bone on its way"
    if settled is None:
        return "never-settled", (
            f"up to the stop the mean of {_samples_of_settling(series, setpoint)} samples of the force was off "
            f"{setpoint:g} N by over 5 %"
        )
    start = max(burr.radius / 6, settled)
    ticks = len(h[samples_between(h, start, stop)])
    if start >= stop or (series.exact and ticks < FEWEST_TICKS):
        return "window-too-short", (
            f"{max(ticks, 0)} ticks between {start:.3f} mm and the stop; {FEWEST_TICKS} are needed"
        )
    if not series.exact and stop - start < burr.radius / 15:
        return "window-too-short", (
            f"settled at {start:.3f} mm, less than R/15 = {burr.radius / 15:.3f} mm before the stop"
        )
    return "ok", ""


def _warnings(burr: Burr, series: Series, provenance: dict[str, Any], cut: int) -> tuple[str, ...]:
    warnings = []
    if "spacing_mm" in provenance and burr.radius / max(provenance["spacing_mm"]) < 7.5:
        warnings.append(
            f"coarse: the radius is {burr.radius / max(provenance['spacing_mm']):.3g} voxels, below 7.5"
        )
    alone = (provenance.get("volume") or {}).get("labels_alone")
    if alone is not None:
        width, ratio = (length / alone["voxel_mm"] for length in (alone["smooth_mm"] or 0.0, burr.radius))
        smooth = width >= 1.95  # two voxels, as they are rounded by hand
        spread = f"{label_scatter(ratio, smooth)} (here {ratio:.3g}), as measured on made-up surfaces"
        spread += " without smoothing" if width and not smooth else ""
        how = f", smoothed by {width:.3g} voxels" if width else ""
        warnings.append(f"labels alone{how}: velocities at one place scatter by {spread}")
    for name, text in (
        ("faint", "over 5 % of the contact in voxels of pristine level below 32"),
        ("ambiguous", "no direction of contact"),
    ):
        if ticks := getattr(series, name):
            warnings.append(f"{name}: {text} in {ticks} of {len(series.time)} ticks")
    if cut:
        warnings.append(f"{CUT} ({cut} of {len(series.time)} ticks)")
    return tuple(warnings)


def _phases(series: Series, setpoint: float, settled: float | None) -> dict[str, tuple[float, float]]:
    time, force = series.time, series.force
    if len(time) == 0:
        return {}
    if series.exact:
        return {"steady": (float(time[0]), float(time[-1]))}
    end = float(time[-1])

    def first(condition: Any) -> float:
        return float(time[np.argmax(condition)]) if np.any(condition) else end

    contact = first(force >= 0.1 * setpoint)
    reached = first(force >= 0.95 * setpoint)
    steady = end if settled is None else first((series.immersion >= settled) & (time >= reached))
    edges = {
        "approach": (0.0, contact),
        "impact": (contact, reached),
        "settling": (reached, steady),
        "steady": (steady, end),
    }
    return {name: edge for name, edge in edges.items() if edge[1] > edge[0]}
