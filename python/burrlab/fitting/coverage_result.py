"""The table of a coverage study: how often intervals held the truth, closed and open ones apart."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from burrlab._core import Material
from burrlab.fitting.experiment import Experiment
from burrlab.fitting.intervals import LEVELS
from burrlab.fitting.observations import Floats

QUANTITIES = ("c_e", "alpha", "identified")
AMONG = ("all", "closed", "open")


@dataclass(frozen=True)
class Share:
    """k of n, with the 95 % interval of Clopper and Pearson."""

    k: int
    n: int

    @property
    def value(self) -> float:
        """k/n, NaN of none."""
        return self.k / self.n if self.n else np.nan

    @property
    def interval(self) -> tuple[float, float]:
        """In which the probability lies at 95 %."""
        if not self.n:
            return 0.0, 1.0
        found = stats.binomtest(self.k, self.n).proportion_ci(0.95, method="exact")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        if not self.n:
            return "none"
        low, high = self.interval
        return f"{100 * self.value:.1f} % ({100 * low:.1f}..{100 * high:.1f}) of {self.n}"


@dataclass(frozen=True, eq=False, repr=False)
class Coverage:
    """How often the intervals held the truth.

    Attributes
    ----------
    experiment : Experiment
    material : Material
        The truth.
    scatter, static_scatter : float
        Standard deviation of ln v and of ln F of the static readings.
    seed : int
        Data set k depends on (seed, k) alone.
    lower, upper : ndarray, shape (n, 3, 3)
        Interval ends by data set, quantity (c_e [N/mm^2], alpha [1/ms], alpha/c_e^exponent) and level (68, 95,
        99.7 %); 0 and infinite where open.
    exponent : ndarray, shape (n,)
        Of the combination, which every data set chooses for itself.
    rise : ndarray, shape (n, 2)
        Of -2 log L over its minimum at the true c_e, and at the true c_e and alpha.
    joint_limit : ndarray, shape (n, 3)
        Limit of that second rise, by level.
    apart : ndarray of bool, shape (n,)
        Whether c_e and alpha are separately identified.
    provenance : dict
    """

    experiment: Experiment
    material: Material
    scatter: float
    static_scatter: float
    seed: int
    lower: Floats
    upper: Floats
    exponent: Floats
    rise: Floats
    joint_limit: Floats
    apart: NDArray[np.bool_]
    provenance: dict[str, Any]

    def __len__(self) -> int:
        return len(self.exponent)

    def holds(self, quantity: str = "c_e", level: str = "95") -> NDArray[np.bool_]:
        """Whether the interval of each data set holds the truth; of ``"joint"``, whether the region does.

        Parameters
        ----------
        quantity : {"c_e", "alpha", "identified", "joint"}
        level : {"68", "95", "99.7"}

        Raises
        ------
        ValueError
            If the quantity or level is another.
        """
        if quantity == "joint":
            return np.asarray(self.rise[:, 1] <= self.joint_limit[:, _place("level", level, tuple(LEVELS))])
        lower, upper = self._interval(quantity, level)
        c_e, alpha = self.material.c_e, self.material.alpha
        combination = alpha / c_e**self.exponent
        truths = {
            "c_e": np.full(len(self), c_e),
            "alpha": np.full(len(self), alpha),
            "identified": combination,
        }
        truth = truths[quantity]
        return np.asarray((lower <= truth) & (truth <= upper))

    def closed(self, quantity: str = "c_e", level: str = "95") -> NDArray[np.bool_]:
        """Whether the interval of each data set has two ends; parameters and errors as of `holds`, but joint."""
        lower, upper = self._interval(quantity, level)
        return np.asarray((lower > 0) & (upper < np.inf))

    def coverage(self, quantity: str = "c_e", level: str = "95", *, among: str = "all") -> Share:
        """Share of the data sets whose interval holds the truth.

        Parameters
        ----------
        quantity, level : str
            As of `holds`.
        among : {"all", "closed", "open"}
            Those whose interval of the quantity is so. To select by the outcome is no fair test: where the truth is
            on the ridge, the interval is closed in the sets whose scatter happened to exclude the truth.

        Raises
        ------
        ValueError
            If an argument is another.
        """
        _place("among", among, AMONG)
        holds = self.holds(quantity, level)
        if among != "all":
            holds = holds[self.closed(quantity, level) == (among == "closed")]
        return Share(int(holds.sum()), len(holds))

    def open_above(self, quantity: str = "c_e", level: str = "95") -> Share:
        """Share of the data sets that set no upper end."""
        above = self._interval(quantity, level)[1] == np.inf
        return Share(int(above.sum()), len(above))

    def ratio(self, quantity: str = "c_e", level: str = "95") -> float:
        """Median of upper over lower end of the closed intervals; NaN of none."""
        lower, upper = (ends[self.closed(quantity, level)] for ends in self._interval(quantity, level))
        return float(np.median(upper / lower)) if len(lower) else np.nan

    @property
    def separately_identified(self) -> Share:
        """Share of the data sets that determine c_e and alpha apart, as `Fit.separately_identified`."""
        return Share(int(self.apart.sum()), len(self))

    def _interval(self, quantity: str, level: str) -> tuple[Floats, Floats]:
        where = (..., _place("quantity", quantity, QUANTITIES), _place("level", level, tuple(LEVELS)))
        return self.lower[where], self.upper[where]

    def rows(self, level: str = "95") -> list[list[str]]:
        """The table as text, headed: coverage, shares open above, and widths, by quantity."""
        table = [["", *AMONG, "open above", "upper/lower"]]
        for name in QUANTITIES:
            shares = [str(self.coverage(name, level, among=among)) for among in AMONG]
            table.append(
                [
                    name,
                    *shares,
                    f"{100 * self.open_above(name, level).value:.1f} %",
                    f"{self.ratio(name, level):.3g}",
                ]
            )
        table.append(["joint", str(self.coverage("joint", level)), "", "", "", ""])
        return table

    def __repr__(self) -> str:
        table = self.rows()
        widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
        lines = [
            "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table
        ]
        return "\n".join([self._head(), *lines, f"separately identified: {self.separately_identified}"])

    def _repr_html_(self) -> str:
        rows = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self.rows()]
        table = "".join(f"<tr>{row}</tr>" for row in rows)
        apart = f"separately identified: {self.separately_identified}"
        return f"<p><b>{escape(self._head())}</b></p><table>{table}</table><p>{escape(apart)}</p>"

    def _head(self) -> str:
        return (
            f"Coverage of 95 % intervals, {len(self)} data sets, {self.material.name}, scatter "
            f"{100 * self.scatter:g} %, seed {self.seed}: {self.experiment!r}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Shares as [k, n], by quantity, level and selection, as plain objects, ready for JSON."""
        levels: dict[str, Any] = {}
        for level in LEVELS:
            levels[level] = {}
            for name in QUANTITIES:
                shares = {among: self.coverage(name, level, among=among) for among in AMONG}
                shares["open above"] = self.open_above(name, level)
                ratio = self.ratio(name, level)
                levels[level][name] = {key: [share.k, share.n] for key, share in shares.items()}
                levels[level][name]["median ratio"] = None if np.isnan(ratio) else ratio
            joint = self.coverage("joint", level)
            levels[level]["joint"] = {"all": [joint.k, joint.n]}
        return {
            "n": len(self),
            "coverage": levels,
            "separately_identified": [self.separately_identified.k, len(self)],
            "provenance": self.provenance,
        }


def _place(name: str, value: str, allowed: tuple[str, ...]) -> int:
    if value not in allowed:
        raise ValueError(f"{name} must be one of {', '.join(allowed)}: got {value!r}")
    return allowed.index(value)
