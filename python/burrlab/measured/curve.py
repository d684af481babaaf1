"""Rows of measurements: velocity over constant force, and force over depth of a stopped burr."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import burrlab.common.table as table
from burrlab.common.check import refuse
from burrlab.common.figures import Axes, axes_or_new, drawing, next_look, plot_points
from burrlab.common.table import Column, Floats, Path, Problem, Table, TableData
from burrlab.measured.layout import TableLayout

TOO_SLOW = "too-slow"  # status of a run whose velocity lies below what could be measured


def _row_rule(row: Mapping[str, Any]) -> Problem:
    start, end = row.get("window_start", math.nan), row.get("window_end", math.nan)
    if math.isnan(start) != math.isnan(end):
        missing = "window_start" if math.isnan(start) else "window_end"
        return missing, "a window needs both its ends or neither"
    if start >= end:
        return "window_start", f"must be below the window's end of {end!r} mm: got {start!r}"
    if row.get("status") == TOO_SLOW and math.isnan(row.get("limit", math.nan)):
        return "limit", f"a run that was {TOO_SLOW} needs the smallest velocity that could be measured"
    return None


_STATUSES = ("ok", "overloaded", "too-slow")  # those with a meaning, also in capitals


@dataclass(frozen=True, init=False, eq=False, repr=False)
class VelocityCurve(TableData):
    """Penetration velocity against constant force, one row a run.

    Repeats are separate rows and are not averaged. A row without a velocity (no window, or a run that did not
    settle) keeps its force; `status` says why. Arrays are read-only copies. NaN means "no number" everywhere:
    in lists, in frames, and in files, where an empty field means the same. A masked number is refused.

    Parameters
    ----------
    force : array_like, shape (n,)
        Constant contact force F [N], > 0.
    velocity : array_like, shape (n,)
        Penetration velocity v [mm/s], > 0; NaN for a run without one.
    sigma : array_like, shape (n,), optional
        Standard uncertainty of `velocity` [mm/s], > 0; NaN where unknown.
    window_start, window_end : array_like, shape (n,), optional
        Immersions [mm] between which `velocity` was taken; both or neither. NaN in a row means the default
        window max(R/6, static immersion) .. R/3.
    status : sequence of str, optional
        How each run ended; ``"ok"`` or ``""`` for a run with a velocity. ``"overloaded"``: static contact alone passed
        the window's end. ``"too-slow"``: the velocity lies below `limit`.
    limit : array_like, shape (n,), optional
        Smallest velocity that could be measured [mm/s], > 0, of runs that were too slow; NaN in other rows.
    source : str
        Source of the numbers, one line.
    provenance : mapping
        Versions, parameters and seed.
    radius : float, optional
        Burr radius R [mm], if known.
    groups : mapping of str to sequence, optional
        ``{"day": labels}``: what else the rows belong to (day, operator, session, drill), a label a row, text or
        number. One label is for all rows.
    specimen : sequence, optional
        The specimen of each row, a label as in `groups`, which keeps it under "specimen".

    Raises
    ------
    ValueError
        If there is no row, lengths differ, a row has no label, or a number breaks its rule; the message names
        row and column.

    Notes
    -----
    The velocity falls by a factor of 3.6 between the immersions R/6 and R/3, so a velocity means nothing
    without its window. A fit compares each row over its own window.

    Examples
    --------
    >>> curve = VelocityCurve([0.5, 1.0, 4.0], [0.0785, 0.498, float("nan")],
    ...                       status=["ok", "ok", "overloaded"], source="three runs")
    >>> curve
    VelocityCurve(3 rows, 2 with a velocity, 0.5..4 N, 'three runs')
    >>> len(curve), curve.ok
    (3, array([ True,  True, False]))
    """

    _TABLE = Table(
        (
            Column("force", "N", check=table.positive, due="a force"),
            Column("velocity", "mm/s", check=table.positive),
            Column("sigma", "mm/s", check=table.positive, optional=True),
            Column("window_start", "mm", check=table.not_negative, optional=True),
            Column("window_end", "mm", check=table.positive, optional=True),
            Column("status", type=str, optional=True),
            Column("limit", "mm/s", check=table.positive, optional=True),
        ),
        pairs=(("window_start", "window_end"),),
        rule=_row_rule,
    )
    _WHAT = "a velocity curve"

    force: Floats
    velocity: Floats
    sigma: Floats | None = None
    window_start: Floats | None = None
    window_end: Floats | None = None
    status: tuple[str, ...] | None = None
    limit: Floats | None = None
    source: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    radius: float | None = None
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __init__(
        self,
        force: ArrayLike,
        velocity: ArrayLike,
        sigma: ArrayLike | None = None,
        window_start: ArrayLike | None = None,
        window_end: ArrayLike | None = None,
        status: tuple[str, ...] | list[str] | None = None,
        source: str = "",
        provenance: Mapping[str, Any] | None = None,
        radius: float | None = None,
        groups: Mapping[str, Any] | None = None,
        specimen: Any = None,
        limit: ArrayLike | None = None,
    ) -> None:
        refuse(isinstance(status, str), f"status must be a list of texts, one a force, got {status!r}")
        names = [str(text) for text in status or ()]
        # without a limit "too slow" is a word as any other
        signs = str.maketrans({} if limit is None else {" ": "-", "_": "-"})
        names = [x if (x := text.lower().translate(signs)) in _STATUSES else text for text in names]
        self._keep({
            "force": force, "velocity": velocity, "sigma": sigma, "window_start": window_start,
            "window_end": window_end, "status": None if status is None else tuple(names),
            "limit": limit,
        }, source, provenance, groups, specimen, radius=radius)  # fmt: skip
        refuse(
            (self.window_start is None) != (self.window_end is None),
            "window_start and window_end go together: one of them is missing",
        )
        self._check_rows()
        refuse(
            any(len(text.splitlines()) > 1 or text != text.strip() for text in self.status or ()),
            "a status is one line of text without blanks around it",
        )

    @classmethod
    def from_csv(
        cls, file: Path | IO[str] | IO[bytes], *, columns: Mapping[str, str | list[str]] | None = None,
        unit: str | Mapping[str, str] | None = None, sep: str | None = None, decimal: str | None = None,
        encoding: str | None = None, groups: Mapping[str, str] | None = None, specimen: str | None = None,
    ) -> "VelocityCurve":  # fmt: skip
        """Read a curve from a CSV file.

        Columns, in any order: ``force_N, velocity_mm_s[, sigma_mm_s][, window_start_mm, window_end_mm]
        [, status][, limit_mm_s]``. An empty velocity (or ``nan``) is a run without one; an empty window is the default window.
        Lines that begin with ``#`` are comments; ``# source:``, ``# radius_mm:`` and ``# provenance:`` above
        the column names are kept. Other columns become the texts in `others`.

        With any of the options below, the file may be of another program: lines above the headings, empty
        fields at the end of lines, repeated headings and a line of units are passed over.
        ``provenance["read"]`` says in one line what was read, converted and passed over.

        Parameters
        ----------
        file : path or open file
        columns : mapping of str to str, or to list of str, optional
            Name of a parameter of `VelocityCurve` -> its heading in the file; the others have the headings
            above. A list is of repeats side by side: each row becomes one for each of them that has a number.
        unit : str or mapping of str to str, optional
            Name -> unit of its numbers in the file; or the unit of all columns that can have it. Default:
            N, mm/s and mm. Known are mN, cN, daN, kN, gf, kgf, kp, lbf; um/s, cm/s, m/s, mm/min, um/min,
            in/s; um, cm, m, in.
        sep : str, optional
            Separator; default: the one that separates the headings.
        decimal : {".", ","}, optional
            Default: a point. With commas between the fields, a row that is longer than the headings is refused
            if its commas may stand in decimals, unless a point is given here or the file has one.
        encoding : str, optional
            Such as "cp1252", "latin-1" or "utf-16"; default: UTF-8.
        groups, specimen : mapping of str to str, and str, optional
            Headings of the columns of labels: ``groups={"day": "Messtag"}, specimen="Probe"``. A file that
            `to_csv` wrote names its own (``# groups:``).

        Returns
        -------
        VelocityCurve

        Raises
        ------
        ValueError
            If the file is not such a table, or a heading tells another unit; the message has every fault
            (of more than ten, the first ten and their number) with line and column.
        OSError
            If the file cannot be read.

        Examples
        --------
        >>> import io
        >>> VelocityCurve.from_csv(io.StringIO("velocity_mm_s,force_N\\n0.498,1\\n,4\\n")).velocity
        array([0.498,   nan])
        >>> text = "Kraft [N];v (um/s);Datum\\n0,5;78,5;3. Mai\\n1;498;3. Mai\\n"
        >>> columns = {"force": "Kraft [N]", "velocity": "v (um/s)"}
        >>> curve = VelocityCurve.from_csv(io.StringIO(text), columns=columns, unit="um/s", decimal=",")
        >>> curve.velocity, curve.others
        (array([0.0785, 0.498 ]), {'Datum': ('3. Mai', '3. Mai')})
        """
        layout = TableLayout(cls._TABLE, columns, unit, sep, decimal, encoding, groups, specimen)
        return layout.file(file).data(cls)

    @classmethod
    def from_dataframe(
        cls,
        frame: Any,
        *,
        force: str = "force_N",
        velocity: str | list[str] = "velocity_mm_s",
        sigma: str | list[str] | None = None,
        unit: str | Mapping[str, str] | None = None,
        radius: float | None = None,
        source: str = "",
        groups: Mapping[str, str] | None = None,
        specimen: str | None = None,
    ) -> "VelocityCurve":
        """Take a curve from a pandas DataFrame.

        Parameters
        ----------
        frame : pandas.DataFrame, or mapping of columns
        force, velocity, sigma : str, or list of str
            Names of the columns, lists for repeats side by side; window and status have those of `from_csv`,
            other ones become `others`.
        unit : str or mapping of str to str, optional
            As in `from_csv`.
        radius : float, optional
            Burr radius R [mm].
        source : str
            Source of the numbers, one line.
        groups, specimen : mapping of str to str, and str, optional
            Names of the columns of labels, as in `from_csv`.

        Returns
        -------
        VelocityCurve

        Raises
        ------
        ValueError
            As in `from_csv`; rows count from 1.

        Examples
        --------
        >>> frame = {"F": [0.5, 1.0], "v": [78.5, 498.0]}
        >>> VelocityCurve.from_dataframe(frame, force="F", velocity="v", unit="um/s").velocity
        array([0.0785, 0.498 ])
        """
        named = {"force": force, "velocity": velocity} | ({} if sigma is None else {"sigma": sigma})
        columns = {
            name: heading if isinstance(heading, list) else str(heading) for name, heading in named.items()
        }
        layout = TableLayout(cls._TABLE, columns, unit, groups=groups, specimen=specimen)
        return layout.frame(frame).data(cls, radius=radius, source=source)

    def split(self, name: str) -> "dict[str, VelocityCurve]":
        """A curve for each label of a group, such as "drill", which the curves no longer carry.

        Raises
        ------
        ValueError
            If the rows have no such group.
        """
        refuse(
            name not in self.groups,
            f"the rows have no {name}{', only ' * bool(self.groups)}{', '.join(self.groups)}: name its column by "
            f"groups={{{name!r}: heading}} of from_csv, or --groups {name}=HEADING",
        )
        curves = {}
        for label in dict.fromkeys(self.groups[name]):
            rows = [row for row, other in enumerate(self.groups[name]) if other == label]
            curves[label] = VelocityCurve(
                **{key: [x[row] for row in rows] for key, x in self._columns().items()},
                radius=self.radius, provenance=self.provenance,
                groups={key: [x[row] for row in rows] for key, x in self.groups.items() if key != name},
                source=f"{self.source}, {name} {label}".removeprefix(", "),
            )  # fmt: skip
        return curves

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Usable rows: with a velocity, and with a status of "ok", "" or none. Shape (n,)."""
        return np.isfinite(self.velocity) & np.array(
            [text in ("", "ok") for text in self.status or len(self) * ("",)], dtype=np.bool_
        )

    @drawing
    def plot(self, ax: "Axes | None" = None, *, log: bool = False, **style: Any) -> "Axes":
        """Draw the velocities as squares over the force, with error bars if sigma is known.

        A run that was too slow is a hollow triangle at its limit.

        `style`: `label`, `color` and other properties of the points.

        Parameters
        ----------
        log : bool
            Make both axes logarithmic; the thin-layer law is then a line of slope 8/3 (parabolic f).
        """
        ax = axes_or_new(ax)
        ok = self.ok
        sigma = None if self.sigma is None else self.sigma[ok]
        style = next_look(ax, style, color="black", marker="s")
        plot_points(ax, self.force[ok], self.velocity[ok], sigma, style, table.data_label(self.source))
        slow = np.array([text == TOO_SLOW for text in self.status or ()], dtype=np.bool_)
        if self.limit is not None and slow.any():
            ax.plot(self.force[slow], self.limit[slow], "v", color=style["color"], mfc="none", ms=4, mew=0.8,
                    label="below the limit")  # fmt: skip
        if log:
            ax.set(xscale="log", yscale="log")
        ax.set(xlabel="force [N]", ylabel="penetration velocity [mm/s]")
        return ax

    def __repr__(self) -> str:
        forces = f"{self.force.min():g}..{self.force.max():g} N"
        return f"VelocityCurve({len(self)} rows, {self.ok.sum()} with a velocity, {forces}{self._origin()})"


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Indentation(TableData):
    r"""Force against depth of a stopped burr in intact bone, one row a reading.

    .. math::

       F = c_e R^2 (h/R)^{3/2} \qquad \text{(Eqs. 2 and 3)}

    Nothing erodes, so the rows determine c_e alone. Under a flat surface the penetration depth h of Eq. 2 is
    the depth of the burr's tip. Arrays are read-only copies.

    Parameters
    ----------
    force : array_like, shape (n,)
        Axial force F [N], > 0.
    depth : array_like, shape (n,)
        Penetration depth h [mm], > 0 and below 2R.
    radius : float
        Burr radius R [mm].
    sigma : array_like, shape (n,), optional
        Standard uncertainty of `force` [N], > 0; NaN where unknown.
    source : str
        Source of the numbers, one line.
    provenance : mapping
        Versions, parameters and seed.
    groups, specimen : optional
        Labels of the rows, as in `VelocityCurve`.

    Raises
    ------
    ValueError
        If there is no row, lengths differ, a row has no label, or a number breaks its rule; the message names
        row and column.

    References
    ----------
    Agus et al., Physics-based burr haptic simulation: tuning and evaluation, HAPTICS 2004.

    Examples
    --------
    >>> Indentation([0.36, 1.02], [0.05, 0.1], 5.0, source="two readings")
    Indentation(2 rows, R = 5 mm, 0.36..1.02 N at 0.05..0.1 mm, 'two readings')
    """

    _TABLE = Table(
        (
            Column("force", "N", check=table.positive, due="a force"),
            Column("depth", "mm", check=table.positive, due="a depth"),
            Column("sigma", "N", check=table.positive, optional=True),
        )
    )
    _WHAT = "an indentation"

    force: Floats
    depth: Floats
    radius: float
    sigma: Floats | None = None
    source: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __init__(
        self,
        force: ArrayLike,
        depth: ArrayLike,
        radius: float,
        sigma: ArrayLike | None = None,
        source: str = "",
        provenance: Mapping[str, Any] | None = None,
        groups: Mapping[str, Any] | None = None,
        specimen: Any = None,
    ) -> None:
        self._keep(
            {"force": force, "depth": depth, "sigma": sigma}, source, provenance, groups, specimen, radius=radius
        )  # fmt: skip
        self._check_rows()
        for i, h in enumerate(self.depth.tolist(), start=1):
            refuse(
                not h < 2 * self.radius,
                f"row {i}, depth: must be below 2R = {2 * self.radius:g} mm: got {h!r}",
            )

    @classmethod
    def from_csv(
        cls, file: Path | IO[str] | IO[bytes], *, radius: float | None = None,
        columns: Mapping[str, str | list[str]] | None = None,
        unit: str | Mapping[str, str] | None = None, sep: str | None = None, decimal: str | None = None,
        encoding: str | None = None, groups: Mapping[str, str] | None = None, specimen: str | None = None,
    ) -> "Indentation":  # fmt: skip
        """Read an indentation from a CSV file.

        Columns, in any order: ``force_N, depth_mm[, sigma_N]``. Lines that begin with ``#`` are comments;
        ``# source:``, ``# radius_mm:`` and ``# provenance:`` above the column names are kept.

        Parameters
        ----------
        file : path or open file
        radius : float, optional
            Burr radius [mm], for a file without it.
        columns, unit, sep, decimal, encoding, groups, specimen : optional
            The layout of another program's file, and its labels, as in `VelocityCurve.from_csv`.

        Returns
        -------
        Indentation

        Raises
        ------
        ValueError
            If the file is not such a table, or its radius is unknown or differs from the given one; the
            message names the file, and line and column if there is one.
        OSError
            If the file cannot be read.

        Examples
        --------
        >>> import io
        >>> Indentation.from_csv(io.StringIO("depth_mm,force_N\\n0.05,0.36\\n"), radius=5).force
        array([0.36])
        """
        layout = TableLayout(cls._TABLE, columns, unit, sep, decimal, encoding, groups, specimen)
        return layout.file(file).data(cls, cls._NUMBERS, radius=radius)

    @drawing
    def plot(self, ax: "Axes | None" = None, *, log: bool = False, **style: Any) -> "Axes":
        """Draw the forces as squares over the depth, with error bars if sigma is known.

        `style`: `label`, `color` and other properties of the points.

        Parameters
        ----------
        log : bool
            Make both axes logarithmic; Eq. 3 is then a line of slope 3/2.
        """
        ax = axes_or_new(ax)
        style = next_look(ax, style, color="black", marker="s")
        plot_points(ax, self.depth, self.force, self.sigma, style, table.data_label(self.source))
        if log:
            ax.set(xscale="log", yscale="log")
        ax.set(xlabel="depth [mm]", ylabel="force [N]")
        return ax

    def __repr__(self) -> str:
        force, depth = (f"{a.min():.3g}..{a.max():.3g}" for a in (self.force, self.depth))
        return (
            f"Indentation({len(self)} rows, R = {self.radius:g} mm, {force} N at {depth} mm{self._origin()})"
        )
