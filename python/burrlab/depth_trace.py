"""Depth-time records of descents at constant force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from burrlab import csv_text, dataset, depth_trace_csv
from burrlab.arguments import real
from burrlab.csv_text import Path
from burrlab.dataset import Floats
from burrlab.mean_field import WINDOW_START, WINDOW_STOP
from burrlab.trace_segments import TraceSegments, cut, rising
from burrlab.window import FEWEST_TICKS, samples_between

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Parts of the window by which the record may fall short of its end, and fall back once in it (ours).
_SHORTFALL, _RETREAT = 0.05, 0.25


@dataclass(frozen=True, init=False, eq=False, repr=False)
class DepthTrace(dataset.DataSet):
    """Immersion over time of one run at constant force, evenly sampled, from contact to stop.

    Where a single penetration velocity says how fast the burr sank on average, the record also says how the
    velocity fell on the way, at one and the same force. It ends with the run: what a rig does after the stop
    is not part of it. Every array is copied and read-only.

    Parameters
    ----------
    time : array_like, shape (n,)
        [s], rising from row to row.
    immersion : array_like, shape (n,)
        Depth H of the burr's tip below the untouched surface [mm], as read.
    force : float
        Set-point F [N], > 0.
    radius : float
        Burr radius R [mm], > 0.
    start_mm, end_mm : float, optional
        Immersions [mm] between which the force was held: by default max(R/6, first immersion) and
        min(R/3, deepest immersion).
    source : str
        Where the record comes from, one line.
    provenance : mapping
        What made it: versions, parameters, seed.

    Raises
    ------
    ValueError
        If lengths differ, a number breaks its rule, or the record does not rise through its window with ten
        samples in it.

    Examples
    --------
    >>> import burrlab
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> trace = burrlab.synthetic_trace(burr, bone, 1.0, seed=1)
    >>> trace.segments(3).velocity.round(2)
    array([0.89, 0.53, 0.36])
    """

    time: Floats
    immersion: Floats
    force: float
    radius: float
    start_mm: float
    end_mm: float
    source: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __init__(
        self,
        time: ArrayLike,
        immersion: ArrayLike,
        force: float,
        radius: float,
        start_mm: float | None = None,
        end_mm: float | None = None,
        source: str = "",
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        for name, values in zip(depth_trace_csv.COLUMNS, (time, immersion), strict=True):
            object.__setattr__(self, name, dataset.frozen(name, values))
        object.__setattr__(self, "force", float(real(force, "force")))
        object.__setattr__(self, "radius", float(real(radius, "radius")))
        self._check_record()
        if start_mm is None:
            start_mm = max(WINDOW_START * self.radius, float(self.immersion[0]))
        if end_mm is None:
            end_mm = min(WINDOW_STOP * self.radius, float(self.immersion.max()))
        object.__setattr__(self, "start_mm", float(start_mm))
        object.__setattr__(self, "end_mm", float(end_mm))
        object.__setattr__(self, "source", " ".join(str(source).split()))
        object.__setattr__(self, "provenance", csv_text.plain(provenance or {}))
        self._check_window()

    def _check_record(self) -> None:
        for name, unit in (("force", "N"), ("radius", "mm")):
            problem = csv_text.positive_problem(getattr(self, name), unit)
            if problem:
                raise ValueError(f"{name} {problem}")
        if len(self.time) != len(self.immersion):
            raise ValueError(
                f"immersion must have {len(self.time)} values, one a time: got {len(self.immersion)}"
            )
        if len(self.time) < FEWEST_TICKS:
            raise ValueError(f"a depth trace needs at least {FEWEST_TICKS} samples: got {len(self.time)}")
        bad = np.flatnonzero(~(np.isfinite(self.time) & np.isfinite(self.immersion)))
        if bad.size:
            row = {"time": float(self.time[bad[0]]), "immersion": float(self.immersion[bad[0]])}
            found = depth_trace_csv.problem_in_row(row)
            assert found is not None
            raise ValueError(f"row {bad[0]}, {found[0]}: {found[1]}")
        late = np.flatnonzero(np.diff(self.time) <= 0)
        if late.size:
            before, time = self.time[late[0] : late[0] + 2].tolist()
            raise ValueError(
                f"row {late[0] + 1}, time: must be above the {before!r} s of the row before: got {time!r}"
            )

    def _check_window(self) -> None:
        start, end = self.start_mm, self.end_mm
        if not 0 < start < end <= self.radius:
            raise ValueError(f"the window must have 0 < start_mm < end_mm <= R: got {start!r} and {end!r}")
        deepest = float(self.immersion.max())
        if deepest < end - _SHORTFALL * (end - start):
            raise ValueError(
                f"end_mm must not lie beyond the deepest immersion of {deepest:.6g} mm: got {end!r}"
            )
        entry = int(np.argmax(self.immersion >= start))
        inside = self.immersion[entry:]
        fall = np.maximum.accumulate(inside) - inside
        if fall.max() > _RETREAT * (end - start):
            raise ValueError(
                f"immersion must rise from start_mm on: at {self.time[entry + int(fall.argmax())]:.6g} s it lies "
                f"{fall.max():.4g} mm above what it had reached"
            )
        samples = len(self.time[samples_between(self.immersion, start, end)])
        if samples < FEWEST_TICKS:
            raise ValueError(
                f"a depth trace needs at least {FEWEST_TICKS} samples in its window, {start:.6g} to {end:.6g} mm: "
                f"got {samples}"
            )

    @classmethod
    def from_descent(cls, run: Any) -> DepthTrace:
        """The record of a descent: its set-point, radius and, where it has one, its window.

        Parameters
        ----------
        run : Descent

        Returns
        -------
        DepthTrace

        Raises
        ------
        ValueError
            If the descent did not rise through a window.

        Examples
        --------
        >>> import burrlab
        >>> run = burrlab.descend(burrlab.Burr(3.0), burrlab.materials["bone"], 1.0, voxel=0.4, ideal=True, seed=1)
        >>> DepthTrace.from_descent(run)
        DepthTrace(1022 samples, 1 N, R = 3 mm, 0.5..1 mm, 'descent, bone')
        """
        start, end = (None, None) if run.window is None else run.window
        name = "unknown material" if run.material is None else run.material.name
        return cls(
            run.time, run.immersion, run.setpoint, run.burr.radius, start, end,
            source=f"descent, {name}", provenance=run.provenance,
        )  # fmt: skip

    @classmethod
    def from_csv(
        cls, file: Path | IO[str] | IO[bytes], *, force: float | None = None, radius: float | None = None
    ) -> DepthTrace:
        """Read a record from a CSV file.

        Columns, in any order: ``time_s, immersion_mm``. Lines that begin with ``#`` are comments;
        ``# force_N:``, ``# radius_mm:``, ``# window_mm:`` with the window's two ends, ``# source:`` and
        ``# provenance:`` above the column names are kept.

        Parameters
        ----------
        file : path or open file
        force, radius : float, optional
            Set-point [N] and burr radius [mm], for a file that does not say them.

        Returns
        -------
        DepthTrace

        Raises
        ------
        ValueError
            If the file is not such a table, or its force or radius is unknown or not the one given; one
            sentence with the file, and the line and column where there is one.
        OSError
            If the file cannot be read.

        Examples
        --------
        >>> import io
        >>> rows = "".join(f"{i / 10},{0.5 + i / 20}\\n" for i in range(11))
        >>> DepthTrace.from_csv(io.StringIO("time_s,immersion_mm\\n" + rows), force=1, radius=3)
        DepthTrace(11 samples, 1 N, R = 3 mm, 0.5..1 mm, 'CSV text')
        """
        name, arguments = depth_trace_csv.read(file, force, radius)
        try:
            return cls(**arguments)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None

    def to_csv(self, file: Path | IO[str]) -> None:
        """Write a CSV file that `from_csv` reads back without loss.

        Parameters
        ----------
        file : path or open text file
        """
        depth_trace_csv.write(self, file)

    def segments(self, n: int = 5) -> TraceSegments:
        """Penetration velocities between start_mm and end_mm, in n segments of equal depth.

        The model's value for a segment is `penetration_velocity(burr, material, force, start_mm, end_mm)`.

        Parameters
        ----------
        n : int
            How many.

        Returns
        -------
        TraceSegments
            Depths, velocities and the standard errors of ln(velocity).

        Raises
        ------
        ValueError
            If n is below 1, or leaves a segment with fewer than six samples or one that does not rise.

        Notes
        -----
        Slopes are those of every penetration velocity here, of the record made monotone (see
        `burrlab.trace_segments.rising`), which is the record itself where it has neither noise nor steps. A
        burr stopped at the first reading of end_mm has been half a step less deep: with steps of 10 um and
        R = 3 mm the last of five segments is 0.6 % too fast. The standard error is that of
        `burrlab.trace_segments.slope_error`, over the velocity.
        """
        return cut(self, n)

    def plot(self, ax: Axes | None = None, *, n: int = 5) -> Axes:
        """Draw immersion, downwards, over time, and the slopes of n segments, each second one shaded.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw; a new figure by default.
        n : int
            Segments.

        Returns
        -------
        matplotlib Axes
        """
        from burrlab.figures import POSITION, VELOCITY, axes_or_new, tidy

        ax = axes_or_new(ax)
        segments = self.segments(n)
        ax.plot(
            self.time, self.immersion, color=POSITION, linewidth=1.2, label=dataset.data_label(self.source)
        )
        level = rising(self.immersion)
        for i, (start, end) in enumerate(zip(segments.start_mm, segments.end_mm, strict=True)):
            rows = samples_between(level, start, end)
            t = self.time[rows]
            if i % 2 == 0:
                ax.axvspan(t[0], t[-1], color="0.93", zorder=0)
            line = level[rows].mean() + segments.velocity[i] * (t - t.mean())
            ax.plot(t, line, color=VELOCITY, linewidth=1.4)
        ax.set(xlabel="time [s]", ylabel="immersion [mm]")
        if not ax.yaxis_inverted():
            ax.invert_yaxis()
        return tidy(ax)

    def _table(self) -> Mapping[str, Sequence[Any]]:
        return depth_trace_csv.table(self)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        source = f", {self.source!r}" if self.source else ""
        window = f"{self.start_mm:g}..{self.end_mm:g} mm"
        return f"DepthTrace({len(self)} samples, {self.force:g} N, R = {self.radius:g} mm, {window}{source})"

    def _repr_html_(self) -> str:
        rows = samples_between(self.immersion, self.start_mm, self.end_mm)
        summary = {
            "force_N": self.force,
            "radius_mm": self.radius,
            "window_start_mm": self.start_mm,
            "window_end_mm": self.end_mm,
            "duration_s": float(self.time[-1] - self.time[0]),
            "samples": len(self),
            "samples in window": len(self.time[rows]),
        }
        return dataset.html_table(repr(self), {name: [value] for name, value in summary.items()})
