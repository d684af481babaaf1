"""Static indentation: force against depth of a stopped burr in intact bone."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any

from numpy.typing import ArrayLike

import burrlab.common.table as table
from burrlab.common.check import refuse
from burrlab.common.figures import axes_or_new, drawing, next_look, plot_points
from burrlab.common.table import Column, Floats, Path, Table, TableData
from burrlab.measured.layout import TableLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Indentation(TableData):
    """Force against depth of a stopped burr in intact bone, one row a reading.

        F = c_e R^2 (h/R)^(3/2)    (Eqs. 2 and 3)

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

    Raises
    ------
    ValueError
        If there is no row, lengths differ, or a number breaks its rule; the message names row and column.

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

    def __init__(
        self,
        force: ArrayLike,
        depth: ArrayLike,
        radius: float,
        sigma: ArrayLike | None = None,
        source: str = "",
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        columns = {"force": force, "depth": depth, "sigma": sigma}
        self._keep(columns, source, provenance, radius=radius)
        self._check_rows()
        for i, h in enumerate(self.depth.tolist()):
            refuse(
                not h < 2 * self.radius,
                f"row {i}, depth: must be below 2R = {2 * self.radius:g} mm: got {h!r}",
            )

    @classmethod
    def from_csv(
        cls, file: Path | IO[str] | IO[bytes], *, radius: float | None = None,
        columns: Mapping[str, str | list[str]] | None = None,
        unit: str | Mapping[str, str] | None = None, sep: str | None = None, decimal: str | None = None,
        encoding: str | None = None,
    ) -> "Indentation":  # fmt: skip
        """Read an indentation from a CSV file.

        Columns, in any order: ``force_N, depth_mm[, sigma_N]``. Lines that begin with ``#`` are comments;
        ``# source:``, ``# radius_mm:`` and ``# provenance:`` above the column names are kept.

        Parameters
        ----------
        file : path or open file
        radius : float, optional
            Burr radius [mm], for a file without it.
        columns, unit, sep, decimal, encoding : optional
            The layout of another program's file, as in `VelocityCurve.from_csv`.

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
        found = TableLayout(cls._TABLE, columns, unit, sep, decimal, encoding).file(file)
        return found.data(cls, cls._NUMBERS, radius=radius)

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
        spans = [f"{a.min():.3g}..{a.max():.3g}" for a in (self.force, self.depth)]
        values = f"{spans[0]} N at {spans[1]} mm{self._origin()}"
        return f"Indentation({len(self)} rows, R = {self.radius:g} mm, {values})"
