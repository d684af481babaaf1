"""Ranked candidates for the next measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from burrlab import dataset

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

_SHOWN = 8  # rows of the repr
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito's palette
_MARKERS = "osD^v<"


@dataclass(frozen=True)
class Candidate:
    """A measurement that could be made, and what is expected of it."""

    kind: str  #: "velocity" or "static"
    force: float | None  #: F of a velocity [N]
    depth: float | None  #: h of a static pair [mm]
    radius: float  #: R [mm]
    n: int  #: repeats
    area_ratio: (
        float  #: area of the joint 95 % region afterwards, over that now; geometric mean over the truths
    )
    probability: float  #: that c_e then is separately identified: a closed 95 % interval within a factor of 2
    c_e_ratio: float  #: upper over lower end of that interval, median over the truths; infinite: open
    overloaded: float  #: probability that static contact passes R/3: the run only bounds c_e from above


@dataclass(frozen=True, repr=False)
class Design:
    """Candidates for the next measurement, the one that shrinks the joint region most first.

    Made by `burrlab.design`.

    Attributes
    ----------
    rows : tuple of Candidate
        By rising area ratio; where these are equal in the order they were asked for.
    scatter : float
        Standard deviation of ln v of the new velocities.
    static_scatter : float or None
        Standard deviation of ln F of the new static pairs; None without such candidates.
    truths : int
        Parameters that the means and probabilities are taken over.
    c_e_end : float
        Upper end of what is counted [N/mm^2]: the area of an open region, and so its ratio, is the one up to here,
        and no truth lies beyond.
    open_above : bool
        Whether the joint 95 % region of the fit is open above, and so cut off at `c_e_end`.
    seed : int
        Of the truths.
    provenance : dict
        Package version, arguments and platform.
    """

    rows: tuple[Candidate, ...]
    scatter: float
    static_scatter: float | None
    truths: int
    c_e_end: float
    open_above: bool
    seed: int
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def best(self) -> Candidate:
        """The first row."""
        return self.rows[0]

    def __repr__(self) -> str:
        table = [list(_HEADS), *(_cells(one) for one in self.rows[:_SHOWN])]
        widths = [max(len(row[i]) for row in table) for i in range(len(_HEADS))]
        lines = ["  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in table]
        if len(self.rows) > _SHOWN:
            lines.append(f"and {len(self.rows) - _SHOWN} more")
        return "\n".join([self._title(), *lines])

    def _repr_html_(self) -> str:
        cells = zip(*(_cells(one) for one in self.rows), strict=True)
        return dataset.html_table(self._title(), dict(zip(_HEADS, cells, strict=True)))

    def _title(self) -> str:
        many = len(self.rows)
        cut = f", now open, counted up to c_e = {self.c_e_end:.4g} N/mm^2" if self.open_above else ""
        return (
            f"Design: {many} candidate{'s' if many > 1 else ''} of {_repeats(self.best.n)}; area of "
            f"the joint 95 % region{cut}, expected over {self.truths} truths"
        )

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain Python objects, ready for JSON; an open interval's ratio is None."""
        values = asdict(self)
        values["rows"] = [
            {name: None if value == np.inf else value for name, value in row.items()}
            for row in values["rows"]
        ]
        return values

    def to_frame(self) -> pandas.DataFrame:
        """The rows as a pandas DataFrame, units in the names of the columns.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        rows = [asdict(one) for one in self.rows]
        return dataset.frame({column: [row[name] for row in rows] for name, column in _COLUMNS.items()})

    def plot(self, ax: Axes | None = None) -> Axes:
        """Area ratio over force, a line each radius; static candidates as a dashed line.

        A dashed line because the depth of a static pair does not matter. Hollow marks: the run is more likely
        overloaded than not.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib Axes
        """
        from burrlab.figures import REFERENCE, axes_or_new, tidy

        ax = axes_or_new(ax)
        velocities = [one for one in self.rows if one.force is not None]
        for i, R in enumerate(sorted({one.radius for one in velocities})):
            line = sorted(
                (one.force, one.area_ratio, one.overloaded) for one in velocities if one.radius == R
            )
            force, ratio, overloaded = (np.array(column) for column in zip(*line, strict=True))
            colour, marker = _COLOURS[i % len(_COLOURS)], _MARKERS[i % len(_MARKERS)]
            ax.plot(force, ratio, color=colour, linewidth=1.2)
            likely = overloaded > 0.5
            label: str | None = f"velocity, $R$ = {R:g} mm"
            for rows, face in ((~likely, colour), (likely, "white")):
                if rows.any():
                    ax.plot(
                        force[rows], ratio[rows], marker, color=colour, mfc=face, mew=1.0, ms=4.5, label=label
                    )
                    label = None
        if any(one.overloaded > 0.5 for one in velocities):
            ax.plot(
                [], [], "o", color=REFERENCE, mfc="white", mew=1.0, ms=4.5, label="more likely overloaded"
            )
        static = [one for one in self.rows if one.force is None]
        if static:
            ax.axhline(
                static[0].area_ratio, color=REFERENCE, linewidth=1.2, linestyle="--", label="static pairs"
            )
        ax.axhline(1.0, color=REFERENCE, linewidth=0.8, linestyle=":")
        top = max(one.area_ratio for one in self.rows)
        ax.set(
            xlabel="force [N]", ylabel="area of the 95 % region, new / old", ylim=(0, 1.08 * max(top, 1.0))
        )
        if not velocities:
            ax.set_xticks([])
        ax.legend(frameon=False, fontsize="small", title=_repeats(self.best.n), title_fontsize="small")
        return tidy(ax)


_COLUMNS = {
    "kind": "kind",
    "force": "force_N",
    "depth": "depth_mm",
    "radius": "radius_mm",
    "n": "n",
    "area_ratio": "area_ratio",
    "probability": "probability",
    "c_e_ratio": "c_e_ratio",
    "overloaded": "overloaded",
}
_HEADS = (
    "kind",
    "force [N]",
    "depth [mm]",
    "R [mm]",
    "area ratio",
    "P(separate)",
    "c_e hi/lo",
    "P(overloaded)",
)


def _repeats(n: int) -> str:
    return f"{n} repeat{'s' if n > 1 else ''}"


def _cells(one: Candidate) -> list[str]:
    numbers = (one.force, one.depth, one.radius)
    return [
        one.kind,
        *("" if x is None else f"{x:g}" for x in numbers),
        f"{one.area_ratio:.2f}",
        f"{one.probability:.2f}",
        "open" if np.isinf(one.c_e_ratio) else f"{one.c_e_ratio:.3g}",
        f"{one.overloaded:.2f}",
    ]
