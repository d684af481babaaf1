"""How a burr was handled in a session: time, motion, force, bone removed."""

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from burrlab.anatomy.report import AnatomyReport
from burrlab.bone.specimen import CUT, Border
from burrlab.common.check import check_memory, refuse
from burrlab.common.figures import FORCE, POSITION, REFERENCE, VELOCITY, Axes, Panels, drawing, panels, styled
from burrlab.common.records import Codec
from burrlab.common.table import dataframe, html_table
from burrlab.session.trace import Recording, Trace, check_trace

if TYPE_CHECKING:
    import pandas


Array = NDArray[np.float64]

CUTOFF = 10.0  # [Hz] of the low pass on positions; a hand moves a burr more slowly
HYSTERESIS = 1.0  # [mm], least length of a stroke
THRESHOLD = 2.0  # [N]
_FEWEST = 64  # samples that the analysis of a motion needs

#: Attribute, key with unit, label.
_TABLE = [
    ("duration", "duration_s", "session [s]"), ("contact", "contact_s", "burr on bone [s]"),
    ("cutting", "cutting_s", "removing bone [s]"), ("removed", "removed_mm3", "removed [mm^3]"),
    ("removal_rate", "removal_rate_mm3_s", "removed in a second of cutting [mm^3/s]"),
    ("path", "path_mm", "path length [mm]"), ("mean_speed", "mean_speed_mm_s", "mean speed [mm/s]"),
    ("peak_speed", "peak_speed_mm_s", "peak speed [mm/s]"), ("strokes", "strokes", "strokes, one way"),
    ("stroke_rate", "stroke_rate_per_s", "strokes a second [1/s]"),
    ("mean_force", "mean_force_N", "mean force in contact [N]"),
    ("rms_force", "rms_force_N", "RMS force in contact [N]"), ("peak_force", "peak_force_N", "peak force [N]"),
    ("over_threshold", "over_threshold_s", "force over threshold [s]"),
    ("rms_jerk", "rms_jerk_mm_s3", "RMS jerk [mm/s^3]"), ("normalised_jerk", "normalised_jerk", "normalised jerk"),
]  # fmt: skip


@dataclass(frozen=True, repr=False, eq=False)
class SessionMetrics:
    """Measures of one burr in one session; NaN where the session is too short. Made by `session_metrics`.

    Attributes
    ----------
    duration, contact, cutting : float
        Time of the session, with bone inside the sphere, and of the ticks that removed bone [s].
    removed : float
        Volume of solid bone [mm^3].
    removal_rate : float
        Volume removed in a second of cutting [mm^3/s].
    path : float
        Length of the smoothed path of the burr's centre [mm].
    mean_speed, peak_speed : float
        [mm/s]
    strokes : int
        Strokes in one direction: there and back are two.
    stroke_rate : float
        Strokes a second from first to last contact [1/s].
    mean_force, rms_force : float
        Mean and RMS of the force sent, over the time in contact [N].
    peak_force : float
        [N]
    threshold : float
        [N]
    over_threshold : float
        Time with more force than `threshold` [s].
    rms_jerk : float
        RMS jerk of the smoothed path [mm/s^3].
    normalised_jerk : float
        sqrt(1/2 int j^2 dt T^5/L^2), T the duration and L the path length.
    burr : int
    series : dict
        For the figure. One value a tick: `time` [s], `force` [N] and, summed up, `removed` [mm^3]. Smoothed
        motion: `motion_time` [s] and `speed` [mm/s].
    anatomy : AnatomyReport or None
        Recorded report of all burrs near watched structures; None if there is none.
    structures : dict or None
        Of a `DrillingRecording`: volume of the voxels removed from each structure [mm^3].
    notes : tuple of str
        Says so if the burr reached out of the volume through bone.
    """

    duration: float
    contact: float
    cutting: float
    removed: float
    removal_rate: float
    path: float
    mean_speed: float
    peak_speed: float
    strokes: int
    stroke_rate: float
    mean_force: float
    rms_force: float
    peak_force: float
    threshold: float
    over_threshold: float
    rms_jerk: float
    normalised_jerk: float
    burr: int
    series: dict[str, Array] = field(repr=False)
    anatomy: AnatomyReport | None = None
    structures: dict[str, float] | None = None
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """A dict for JSON, units in the names; None where there is no number."""
        anatomy = {} if self.anatomy is None else {"anatomy": self.anatomy.to_dict()}
        structures = {} if self.structures is None else {"removed_mm3_by_structure": self.structures}
        notes = {"notes": list(self.notes)} if self.notes else {}
        return {**_CODEC.plain(self), **anatomy, **structures, **notes}

    def to_dataframe(self) -> "pandas.DataFrame":
        """One row as a pandas DataFrame, units in the names of the columns; ImportError without pandas."""
        return dataframe({key: [getattr(self, name)] for key, name in _KEYS.items()})

    def _rows(self) -> list[tuple[str, float]]:
        return [
            *((text, getattr(self, name)) for name, _, text in _TABLE),
            *((f"removed of {name} [mm^3]", volume) for name, volume in (self.structures or {}).items()),
        ]

    def __repr__(self) -> str:
        return "\n".join([
            f"SessionMetrics of burr {self.burr}, threshold {self.threshold:g} N",
            *(f"{text:<42} {value:>12.5g}" for text, value in self._rows()),
            *([] if self.anatomy is None else [str(self.anatomy)]),
            *self.notes,
        ])  # fmt: skip

    def _repr_html_(self) -> str:
        figures, values = zip(*self._rows(), strict=True)
        title = f"Burr {self.burr}, threshold {self.threshold:g} N"
        table = html_table(title, {"figure": figures, "value": values})
        return table if self.anatomy is None else table + self.anatomy._repr_html_()

    @drawing
    def plot(self, ax: Panels = None, **style: Any) -> list[Axes]:
        """Charts of force, speed and removed volume over time, and below them the anatomy report's plot.

        `ax` is a figure, or an array of the Axes: three, with watched structures five. `style`: label, color
        and other properties of the lines.
        """
        near = self.anatomy is not None and bool(self.anatomy.structures)
        top, middle, bottom, *lower = panels(ax, (5 if near else 3, 1), (6.4, 11.2 if near else 6.4))
        all_axes = [top, middle, bottom]
        s, unlabelled = self.series, {"label": None} | style
        top.plot(s["time"], s["force"], **styled(unlabelled, color=FORCE, linewidth=0.6))
        if self.peak_force > 0.5 * self.threshold:
            top.axhline(self.threshold, color=REFERENCE, linewidth=0.8, linestyle="--", label="threshold")
            top.legend()
        middle.plot(s["motion_time"], s["speed"], **styled(style, color=VELOCITY, linewidth=0.8))
        bottom.plot(s["time"], s["removed"], **styled(style, color=POSITION, linewidth=1.2))
        bottom.set_xlabel("time [s]")
        for axes, label in zip(all_axes, ("force [N]", "speed [mm/s]", "removed [mm$^3$]"), strict=True):
            axes.set(ylabel=label, ylim=(0, None))
        return all_axes + (self.anatomy.plot(lower) if near and self.anatomy is not None else [])


_KEYS = {key: name for name, key, _ in _TABLE} | {"threshold_N": "threshold", "burr": "burr"}
_CODEC = Codec(keys={SessionMetrics: _KEYS})


def session_metrics(
    trace: Trace | Recording,
    *,
    burr: int = 0,
    threshold: float = THRESHOLD,
    hysteresis: float = HYSTERESIS,
) -> SessionMetrics:
    """The metrics of one burr in a session.

    Parameters
    ----------
    trace : Trace or DrillingRecording
    burr : int
        Index of the burr.
    threshold : float
        Force threshold [N]; the default is ours.
    hysteresis : float
        Least length of a stroke [mm]; the default is ours.

    Returns
    -------
    SessionMetrics

    Raises
    ------
    ValueError
        If there is no such burr, or threshold or hysteresis is not positive.
    TypeError
        If `trace` is not a trace.

    Notes
    -----
    Time is the sum of the periods that the ticks stand for. Positions are the burr's centres, at 1 kHz at
    most. A Butterworth low pass of second order at 10 Hz, run forwards and backwards, smooths them without
    delay. A stroke is a run between two reversals of the smoothed motion along its main axis. This axis is
    the first principal component of the positions in contact, or of all if there is no contact. A reversal
    counts once the burr has come back by the hysteresis: tremor and pauses make none. Normalised jerk is
    that of Teulings et al. 1997 (Exp. Brain Res. 114). It grows with the number of strokes, so it compares
    only sessions of like length and task.

    A `DrillingRecording` counts whole voxels as removed. It does not say when the burr met bone: contact is
    where the force is not 0. What follows from nothing recorded is NaN, such as the time of cutting.

    Examples
    --------
    >>> import burrlab, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> file = folder.name + "/session.h5"
    >>> bone = burrlab.VoxelBone.block((20, 20, 5), 0.2, origin=(-9.9, -9.9, -4.9))
    >>> tool, clock = (burrlab.Burr(3.0), burrlab.materials["bone"]), burrlab.Clock(wall_clock=False)
    >>> hand = burrlab.HandDevice((0, 0, 3.0))
    >>> with burrlab.Session(bone, tool, hand, seed=1, duration=0.5, clock=clock, record=file) as session:
    ...     ended = session.wait()
    >>> metrics = session_metrics(burrlab.load_trace(file))
    >>> round(metrics.removed, 2), round(metrics.peak_force, 2)
    (1.02, 0.75)
    >>> folder.cleanup()
    """
    if not isinstance(trace, Recording):
        check_trace(trace)
    for name, value in (("threshold", threshold), ("hysteresis", hysteresis)):
        refuse(not (math.isfinite(value) and value > 0), f"{name} must be positive, got {value}")
    time, step, period, duration, center, force, touching, cuts, volume, structures, absent = trace.handling(
        burr
    )
    contact, cutting = float(step[touching].sum()), float(step[cuts].sum())
    removed = float(volume[-1]) if len(volume) else 0.0
    motion_time, center = _uniform(time, center, period)
    speed, jerk, path = _motion(center, motion_time)
    strokes, stroking = _strokes(center, motion_time, time, touching, hysteresis)
    squared = float((jerk**2).mean()) if len(jerk) else math.nan
    cut = 0
    if isinstance(trace, Trace):
        cut = Border(trace._bone).count_cut(trace.array("center_mm", burr), trace.tools[burr][0].radius)
    metrics = SessionMetrics(
        duration=duration, contact=contact, cutting=cutting, removed=removed,
        removal_rate=removed / cutting if cutting else 0.0, path=path,
        mean_speed=float(speed.mean()) if len(speed) else math.nan,
        peak_speed=float(speed.max()) if len(speed) else math.nan,
        strokes=strokes, stroke_rate=strokes / stroking if stroking else math.nan,
        mean_force=_mean(force, step, touching), rms_force=math.sqrt(_mean(force**2, step, touching)),
        peak_force=float(force.max(initial=0.0)), threshold=threshold,
        over_threshold=float(step[force > threshold].sum()), rms_jerk=math.sqrt(squared),
        normalised_jerk=math.sqrt(0.5 * squared * duration**6) / path if path > 0 else math.nan, burr=burr,
        series={"time": time, "force": force, "removed": volume, "motion_time": motion_time, "speed": speed},
        anatomy=AnatomyReport.recorded(trace) if isinstance(trace, Trace) else None, structures=structures,
        notes=(f"{CUT} ({cut} of {len(time)} ticks)",) if cut else (),
    )  # fmt: skip
    unknown: dict[str, Any] = dict.fromkeys(absent, math.nan)
    return replace(metrics, **unknown)


def _mean(values: Array, step: Array, where: NDArray[np.bool_]) -> float:
    return float(np.average(values[where], weights=step[where])) if where.any() else 0.0


def _uniform(time: Array, center: Array, period: float) -> tuple[Array, Array]:
    """Smoothed positions, every 1 ms, or every period if that is longer; empty if too short."""
    grid = max(period, 1.0) / 1000.0
    count = int((time[-1] - time[0]) / grid + 1e-6) + 1 if len(time) else 0
    if count < _FEWEST:
        return np.zeros(0), np.zeros((0, 3))
    # a position, its smoothed copies, speed and jerk; a late time stamp makes many
    check_memory(400.0 * count, f"a motion of {time[-1] - time[0]:.3g} s")
    at = time[0] + grid * np.arange(count)
    raw = np.column_stack([np.interp(at, time, axis) for axis in center.T])
    cutoff = min(CUTOFF, 0.4 / grid)  # below half the sampling rate
    low_pass = scipy.signal.butter(2, cutoff, fs=1.0 / grid, output="sos")
    return at, scipy.signal.sosfiltfilt(
        low_pass, raw, axis=0, padlen=min(count - 1, round(3.0 / (cutoff * grid)))
    )


def _motion(center: Array, time: Array) -> tuple[Array, Array, float]:
    """Speed [mm/s] and jerk [mm/s^3] of smoothed positions, and the length of their path [mm]."""
    if not len(time):
        return np.zeros(0), np.zeros(0), math.nan
    grid = time[1] - time[0]
    velocity = np.gradient(center, grid, axis=0)
    jerk = np.gradient(np.gradient(velocity, grid, axis=0), grid, axis=0)
    path = float(np.linalg.norm(np.diff(center, axis=0), axis=1).sum())
    return np.linalg.norm(velocity, axis=1), np.linalg.norm(jerk, axis=1), path


def _strokes(
    center: Array, grid: Array, time: Array, touching: NDArray[np.bool_], hysteresis: float
) -> tuple[int, float]:
    """(strokes from first to last contact, or in all if there is no contact; the time between [s])"""
    if not len(grid):
        return 0, 0.0
    met = np.interp(grid, time, touching.astype(float)) > 0.5
    rows = np.flatnonzero(met) if met.any() else np.arange(len(grid))
    span = slice(rows[0], rows[-1] + 1)
    about = center[rows] - center[rows].mean(axis=0)
    axis = np.linalg.eigh(about.T @ about)[1][:, -1]
    along = (center[span] - center[span].mean(axis=0)) @ axis
    return _runs(along, hysteresis), float(grid[rows[-1]] - grid[rows[0]])


def _runs(along: Array, hysteresis: float) -> int:
    runs, direction = 0, 0
    low = high = float(along[0])
    for x in along.tolist():
        low, high = min(low, x), max(high, x)
        if direction <= 0 and x - low >= hysteresis:
            runs, direction, high = runs + 1, 1, x
        elif direction >= 0 and high - x >= hysteresis:
            runs, direction, low = runs + 1, -1, x
    return runs
