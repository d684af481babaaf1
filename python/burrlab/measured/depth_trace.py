"""Depth-time records of descents at constant force, and the penetration velocities of their segments."""

import itertools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import IO, Any, ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

import burrlab.common.table as table
from burrlab.common.check import refuse
from burrlab.common.figures import POSITION, VELOCITY, Axes, axes_or_new, drawing, styled
from burrlab.common.table import Column, Floats, Path, Table, TableData
from burrlab.measured.layout import TableLayout
from burrlab.theory.closed_forms import FEWEST_TICKS, penetration_velocity_between, samples_between
from burrlab.theory.continuum import WINDOW_START, WINDOW_STOP


def _labels_in(layout: TableLayout) -> dict[str, str]:
    """Labels of a run in the comments of its file."""
    try:
        return {
            str(name): table.label_in_file(label)
            for name, label in json.loads(layout.comments.get("groups", "{}")).items()
        }
    except (ValueError, AttributeError, RecursionError):
        raise ValueError(
            f'{layout.name}: groups in the comments must be JSON, such as {{"day": "3 May"}}: got '
            f"{layout.comments['groups']!r}"
        ) from None


#: Allowed shortfall before the window's end, and allowed retreat within the window [parts of it] (ours).
_SHORTFALL, _RETREAT = 0.05, 0.25


@dataclass(frozen=True, init=False, eq=False, repr=False)
class DepthTrace(TableData):
    """Immersion over time of one run at constant force, evenly sampled, from contact to stop.

    The record shows how the velocity falls with depth at one force; a penetration velocity is only its mean.
    The record ends with the run, at the stop. Arrays are read-only copies.

    Parameters
    ----------
    time : array_like, shape (n,)
        [s], increasing.
    immersion : array_like, shape (n,)
        Depth H of the burr's tip below the untouched surface [mm], as read.
    force : float
        Set-point F [N], > 0.
    radius : float
        Burr radius R [mm], > 0.
    start_mm, end_mm : float, optional
        Immersions [mm] between which the force was held; default max(R/6, first immersion) and
        min(R/3, deepest immersion).
    source : str
        Source of the record, one line.
    provenance : mapping
        Versions, parameters and seed.
    groups, specimen : optional
        Labels of the run, as in `VelocityCurve`: ``groups={"day": "3 May"}, specimen="A"``.

    Raises
    ------
    ValueError
        If lengths differ, a number breaks its rule, or the record does not rise through its window with at
        least ten samples.

    Examples
    --------
    >>> import burrlab
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> trace = burrlab.synthetic_trace(burr, bone, 1.0, seed=1)
    >>> trace.segments(3).velocity.round(2)
    array([0.89, 0.53, 0.36])
    """

    _TABLE = Table(
        (
            Column("time", "s", check=table.finite, due="a time"),
            Column("immersion", "mm", check=table.finite, due="an immersion"),
        )
    )
    _WHAT = "a depth trace"
    _NUMBERS: ClassVar[Mapping[str, str]] = {"force": "N", "radius": "mm"}
    _LABELLED = "run"

    time: Floats
    immersion: Floats
    force: float
    radius: float
    start_mm: float
    end_mm: float
    source: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

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
        groups: Mapping[str, Any] | None = None,
        specimen: Any = None,
    ) -> None:
        self._keep({
            "time": time, "immersion": immersion,
        }, source, provenance, groups, specimen, force=force, radius=radius)  # fmt: skip
        self._check_record()
        first, deepest = float(self.immersion[0]), float(self.immersion.max())
        vars(self).update(
            start_mm=max(WINDOW_START * self.radius, first) if start_mm is None else float(start_mm),
            end_mm=min(WINDOW_STOP * self.radius, deepest) if end_mm is None else float(end_mm),
        )
        self._check_window()

    def _check_record(self) -> None:
        refuse(
            len(self) < FEWEST_TICKS, f"a depth trace needs at least {FEWEST_TICKS} samples: got {len(self)}"
        )
        if not (np.isfinite(self.time).all() and np.isfinite(self.immersion).all()):
            self._check_rows()
        late = np.flatnonzero(np.diff(self.time) <= 0)
        if late.size:
            before, time = self.time[late[0] : late[0] + 2].tolist()
            raise ValueError(
                f"row {late[0] + 2}, time: must be above the {before!r} s of the row before: got {time!r}"
            )

    def _check_window(self) -> None:
        start, end = self.start_mm, self.end_mm
        refuse(
            not 0 < start < end <= self.radius,
            f"the window must have 0 < start_mm < end_mm <= R: got {start!r} and {end!r}",
        )
        deepest = float(self.immersion.max())
        refuse(
            deepest < end - _SHORTFALL * (end - start),
            f"end_mm must not lie beyond the deepest immersion of {deepest:.6g} mm: got {end!r}",
        )
        entry = int(np.argmax(self.immersion >= start))
        inside = self.immersion[entry:]
        fall = np.maximum.accumulate(inside) - inside
        refuse(
            fall.max() > _RETREAT * (end - start),
            f"immersion must rise from start_mm on: at {self.time[entry + int(fall.argmax())]:.6g} s it lies "
            f"{fall.max():.4g} mm above what it had reached",
        )
        samples = len(self.time[samples_between(self.immersion, start, end)])
        refuse(
            samples < FEWEST_TICKS,
            f"a depth trace needs at least {FEWEST_TICKS} samples in its window, {start:.6g} to "
            f"{end:.6g} mm: got {samples}",
        )

    @classmethod
    def from_csv(
        cls, file: Path | IO[str] | IO[bytes], *, force: float | None = None, radius: float | None = None,
        columns: Mapping[str, str | list[str]] | None = None,
        unit: str | Mapping[str, str] | None = None, sep: str | None = None, decimal: str | None = None,
        encoding: str | None = None, groups: Mapping[str, str] | None = None, specimen: str | None = None,
    ) -> "DepthTrace":  # fmt: skip
        """Read a record from a CSV file.

        Columns, in any order: ``time_s, immersion_mm``. Lines that begin with ``#`` are comments;
        ``# force_N:``, ``# radius_mm:``, ``# window_mm:`` (start and end), ``# groups:`` (labels of the run, as
        JSON), ``# source:`` and ``# provenance:`` above the column names are kept.

        Parameters
        ----------
        file : path or open file
        force, radius : float, optional
            Set-point [N] and burr radius [mm], for a file without them.
        columns, unit, sep, decimal, encoding : optional
            The layout of another program's file, as in `VelocityCurve.from_csv`; times may also be in ms,
            us or min.
        groups, specimen : optional
            Labels of the run, for a file without them.

        Returns
        -------
        DepthTrace

        Raises
        ------
        ValueError
            If the file is not such a table, or its force or radius is unknown or differs from the given one;
            the message names the file, and line and column if there is one.
        OSError
            If the file cannot be read.

        Examples
        --------
        >>> import io
        >>> rows = "".join(f"{i / 10},{0.5 + i / 20}\\n" for i in range(11))
        >>> DepthTrace.from_csv(io.StringIO("time_s,immersion_mm\\n" + rows), force=1, radius=3)
        DepthTrace(11 samples, 1 N, R = 3 mm, 0.5..1 mm, 'CSV text')
        """
        layout = TableLayout(cls._TABLE, columns, unit, sep, decimal, encoding).file(file)
        start, end = None, None
        if (window := layout.comments.get("window_mm")) is not None:
            try:
                start, end = map(float, window.split())
            except ValueError:
                raise ValueError(
                    f"{layout.name}: window_mm in the comments must be two numbers, start and end: got {window!r}"
                ) from None
        return layout.data(
            cls, cls._NUMBERS, force=force, radius=radius, start_mm=start, end_mm=end, specimen=specimen,
            groups=_labels_in(layout) | dict(groups or {}),
        )  # fmt: skip

    @property
    def _n_labels(self) -> int:
        return 1

    def _comments(self) -> dict[str, Any]:
        groups = {name: label for name, (label,) in self.groups.items()}
        noted = {"groups": json.dumps(groups, ensure_ascii=False)} if groups else {}
        return super()._comments() | noted | {"window_mm": f"{self.start_mm!r} {self.end_mm!r}"}

    def segments(self, n: int = 5) -> "TraceSegments":
        """Penetration velocities in n segments of equal depth between start_mm and end_mm.

        The model's value for a segment is `penetration_velocity(burr, material, force, start_mm, end_mm)`.

        Parameters
        ----------
        n : int
            Number of segments.

        Returns
        -------
        TraceSegments
            Depths, velocities and standard errors of ln(velocity).

        Raises
        ------
        ValueError
            If n is below 1, or leaves a segment with fewer than six samples or one that does not rise.

        Notes
        -----
        Slopes are least-squares slopes of the monotone record (`burrlab.measured.depth_trace.rising`), which
        equals the record if that has neither noise nor steps. A burr that stops at the first reading of
        end_mm was half a step less deep: with steps of 10 um and R = 3 mm the last of five segments is 0.6 %
        too fast. The standard error is `burrlab.measured.depth_trace.slope_error` over the velocity.
        """
        refuse(n < 1, f"n must be at least 1: got {n!r}")
        edges = np.linspace(self.start_mm, self.end_mm, n + 1)
        level = rising(self.immersion)
        rows = []
        for start, end in itertools.pairwise(edges.tolist()):
            inside = samples_between(level, start, end)
            time = self.time[inside]
            refuse(
                len(time) < FEWEST_SAMPLES,
                f"{n} segments need at least {FEWEST_SAMPLES} samples each: the trace at {self.force:g} N has {len(time)} "
                f"between {start:.4g} and {end:.4g} mm",
            )
            velocity = penetration_velocity_between(self.time, level, start, end)
            if not velocity:
                raise ValueError(
                    "n must leave segments in which the immersion rises, it stands still between "
                    f"{start:.4g} and {end:.4g} mm: got {n!r}"
                )
            rows.append((velocity, slope_error(time, self.immersion[inside]) / velocity, len(time)))
        velocities, errors, counts = map(np.array, zip(*rows, strict=True))
        return TraceSegments(edges[:-1].copy(), edges[1:].copy(), velocities, errors, counts)

    @drawing
    def plot(self, ax: "Axes | None" = None, *, n: int = 5, **style: Any) -> "Axes":
        """Draw immersion, downwards, over time, with the slopes of n segments; every second one is shaded.

        `style`: `label`, `color` and other properties of the line.

        Parameters
        ----------
        n : int
            Number of segments.
        """
        ax = axes_or_new(ax)
        segments = self.segments(n)
        ax.plot(
            self.time,
            self.immersion,
            **styled(style, color=POSITION, linewidth=1.2, label=table.data_label(self.source)),
        )
        level = rising(self.immersion)
        for i, (start, end) in enumerate(zip(segments.start_mm, segments.end_mm, strict=True)):
            rows = samples_between(level, start, end)
            t = self.time[rows]
            if i % 2 == 0:
                ax.axvspan(t[0], t[-1], color="0.93", zorder=0)
            line = level[rows].mean() + segments.velocity[i] * (t - t.mean())
            ax.plot(t, line, color=VELOCITY, linewidth=1.4, label=None if i else f"slopes of {n} segments")
        ax.set(xlabel="time [s]", ylabel="immersion [mm]")
        if not ax.yaxis_inverted():
            ax.invert_yaxis()
        return ax

    def __repr__(self) -> str:
        set_up = f"{self.force:g} N, R = {self.radius:g} mm, {self.start_mm:g}..{self.end_mm:g} mm"
        return f"DepthTrace({len(self)} samples, {set_up}{self._origin()})"

    def _repr_html_(self) -> str:
        return table.html_table(repr(self), {
            "force_N": [self.force], "radius_mm": [self.radius], "window_start_mm": [self.start_mm],
            "window_end_mm": [self.end_mm], "duration_s": [float(self.time[-1] - self.time[0])],
            "samples": [len(self)],
            "samples in window": [len(self.time[samples_between(self.immersion, self.start_mm, self.end_mm)])],
        })  # fmt: skip


#: Fewest samples in a segment: three for the quadratic and three for its residuals (ours).
FEWEST_SAMPLES = 6
#: The largest correlation of neighbouring residuals is 1 - 3/n, a memory of a third of the segment (ours).
_LONGEST_MEMORY = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class TraceSegments:
    """Result of `DepthTrace.segments`, one row a segment; arrays are read-only.

    Attributes
    ----------
    start_mm, end_mm : ndarray, shape (n,)
        Immersions between which the velocity was taken [mm].
    velocity : ndarray, shape (n,)
        Least-squares slope of immersion over time [mm/s].
    log_sigma : ndarray, shape (n,)
        Standard error of ln(velocity) from the residuals of the record alone, without scatter between runs.
    samples : ndarray of int, shape (n,)
        Samples in each segment.
    """

    start_mm: Floats
    end_mm: Floats
    velocity: Floats
    log_sigma: Floats
    samples: NDArray[np.int64]

    def __post_init__(self) -> None:
        for values in vars(self).values():
            values.flags.writeable = False

    def __len__(self) -> int:
        return len(self.velocity)

    def __repr__(self) -> str:
        return (
            f"TraceSegments({len(self)} between {self.start_mm[0]:.3f} and {self.end_mm[-1]:.3f} mm: "
            f"{', '.join(f'{v:.3g}' for v in self.velocity)} mm/s)"
        )


def rising(immersion: Floats) -> Floats:
    """The record made monotone: readings in rising order, with steps of the encoder joined by straight lines.

    As many samples lie before a depth as have a smaller reading. A record without noise and steps stays
    unchanged except at its ends. Noise would bring the first sample at a depth early, by several standard
    deviations in a slow descent. Steps would move the ends of a segment by up to half a step: 1 % to 3 % of
    the velocity in a segment of 0.1 mm with a burr of 3 mm. Both average out here. The record's ends cut off
    the first and the last step. These are left out: the record continues there as its point reflection.
    """
    readings, counts = np.unique(immersion, return_counts=True)
    middle = np.cumsum(counts) - (counts + 1) / 2
    whole = (readings > immersion[0]) & (readings < immersion[-1])
    if np.count_nonzero(whole) > 2:
        # Both arrays continue at each end as their point reflection about it.
        readings, middle = (
            np.concatenate([2 * x[0] - x[:0:-1], x, 2 * x[-1] - x[-2::-1]])
            for x in (readings[whole], middle[whole])
        )
    return np.interp(np.arange(len(immersion)), middle, readings)


def slope_error(time: Floats, immersion: Floats) -> float:
    """Standard error of the least-squares slope of immersion over time [mm/s].

    Residuals about a quadratic are modelled as a first-order autoregression, which gives the variance of the
    slope:

        var(b) = s^2 sum_ij w_i rho^|i-j| w_j,    w_i = (t_i - t_mean)/sum (t - t_mean)^2

    Notes
    -----
    rho is the residuals' lag-one correlation plus its bias, (3 + 5 rho)/n for residuals about a quadratic
    [1]_, not below 0. s^2 is corrected for the correlated noise that the quadratic absorbs. Without both, the
    error is a quarter too small at rho = 0.9 and 200 samples. 1.96 errors cover the slope in 95 % of the
    cases for white noise, in 94 % at rho = 0.9 and 1000 samples, in 91 % at rho = 0.9 and 200.

    Residuals of readings in steps without noise cancel in each period, which a first-order model ignores:
    with ten steps of 10 um a segment it gives 2 %, but the velocity is known to 0.3 % if a step holds ten
    samples. With noise of a fifth of a step the error is up to 40 % too large.

    References
    ----------
    .. [1] F. H. C. Marriott, J. A. Pope, Bias in the estimation of autocorrelations, Biometrika 41, 1954. The
       bias is (1 + 3 rho)/n about a mean. We extend the series to a quadratic, and check it by simulation.
    """
    n = len(time)
    centred = time - time.mean()
    basis = np.linalg.qr(np.vander(centred / np.abs(centred).max(), 3))[0]
    residual = immersion - basis @ (basis.T @ immersion)
    square = float(residual @ residual)
    if square == 0:
        return 0.0
    lag_one = float(residual[1:] @ residual[:-1]) / square
    rho = min(max(lag_one + (3 + 5 * lag_one) / n, 0.0), 1 - _LONGEST_MEMORY / n)
    variance = square / (n - sum(_form(column, rho) for column in basis.T))
    return math.sqrt(variance * _form(centred, rho)) / float(centred @ centred)


def _form(x: Floats, rho: float) -> float:
    """sum_ij x_i rho^|i-j| x_j"""
    return float(2 * (x @ scipy.signal.lfilter([1.0], [1.0, -rho], x)) - x @ x)
