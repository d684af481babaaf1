"""The result of a comparison of erosion shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from burrlab._core import Shape
from burrlab.fitting import shape_report
from burrlab.fitting.result import Fit
from burrlab.fitting.shape_family import PowerProfile, Threshold

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Part:
    """Residuals of a third of the forces."""

    name: str  #: "low", "middle" or "high"
    forces: tuple[float, float]  #: lowest and highest [N]
    mean: float  #: mean residual, measured less predicted, in the unit of the residuals
    error: float  #: its standard error, from the scatter about the best shape, or the given sigma

    @property
    def clear(self) -> bool:
        """Whether the mean lies more than two standard errors from 0."""
        return abs(self.mean) > 2 * self.error


@dataclass(frozen=True)
class Pair:
    """Two shapes, judged against one another at 95 %."""

    LEVEL: ClassVar[float] = 0.95

    better: str
    worse: str
    rise: float  #: of -2 log L from the better to the worse
    limit: float  #: above which they are told apart
    p_value: float

    @property
    def told_apart(self) -> bool:
        return self.rise > self.limit


@dataclass(frozen=True, eq=False)
class ShapeRow:
    """One shape's fit, and how it stands among the others.

    Attributes
    ----------
    shape : Shape
    fit : Fit
        Its `c_e`, `alpha`, `log_likelihood`, `aic`, `bic`, `residual_norm` and `lack_of_fit` are the row's.
    delta_aic : float
        AIC over that of the best shape.
    rise : float or None
        Of -2 log L over the family's minimum, negative where the shape fits better; None without the family.
    p_value : float or None
        Of the shape against the family.
    rejected : bool or None
        At the comparison's level.
    pattern : tuple of Part
        Mean residuals of the low, middle and high third of the forces.
    alpha_ratio : float or None
        alpha over that of parabolic; None where c_e is open above.
    combination_ratio : float or None
        alpha/c_e^(8/3) over that of parabolic, for shapes with a simple zero: alpha's ratio at equal c_e.
    """

    shape: Shape
    fit: Fit = field(repr=False)
    delta_aic: float
    rise: float | None
    p_value: float | None
    rejected: bool | None
    pattern: tuple[Part, ...]
    alpha_ratio: float | None
    combination_ratio: float | None


@dataclass(frozen=True, eq=False, repr=False)
class ShapeComparison:
    """Fits under several erosion shapes, side by side. Made by `burrlab.compare_shapes`.

    Attributes
    ----------
    rows : tuple of ShapeRow
        One a shape, as asked for.
    power : PowerProfile or None
        The family (1 - x^2)^k with k free; None without it, or where the rows leave no freedom for it.
    threshold : Threshold or None
        How rises of -2 log L are judged.
    pairs : tuple of Pair
        Every two shapes.
    level : float
        At which shapes are rejected.
    residual_kind : str
        ``"relative"``, ``"absolute"`` or ``"sigma"``.
    provenance : dict
        Package version, parameters and platform.
    """

    rows: tuple[ShapeRow, ...]
    power: PowerProfile | None
    threshold: Threshold | None
    pairs: tuple[Pair, ...]
    level: float
    residual_kind: str
    provenance: Mapping[str, Any]

    def __getitem__(self, shape: str) -> ShapeRow:
        for row in self.rows:
            if row.shape == Shape(shape):
                return row
        raise KeyError(shape)

    @property
    def best(self) -> ShapeRow:
        """The row of the smallest AIC."""
        return min(self.rows, key=lambda row: row.delta_aic)

    @property
    def rejected(self) -> tuple[str, ...]:
        """Shapes that the data reject at the comparison's level."""
        return tuple(row.shape.name for row in self.rows if row.rejected)

    @property
    def kept(self) -> tuple[str, ...]:
        """Shapes that are not rejected; without the family, those not told apart from the best."""
        behind = {pair.worse for pair in self.pairs if pair.told_apart and pair.better == self._lowest}
        return tuple(
            row.shape.name
            for row in self.rows
            if not (row.shape.name in behind if row.rejected is None else row.rejected)
        )

    @property
    def _lowest(self) -> str | None:
        """The shape that no other is better than in the pairs."""
        return next(iter({pair.better for pair in self.pairs} - {pair.worse for pair in self.pairs}), None)

    @property
    def indistinguishable(self) -> tuple[Pair, ...]:
        """Pairs of the kept shapes that the data cannot tell apart."""
        kept = set(self.kept)
        return tuple(pair for pair in self.pairs if not pair.told_apart and {pair.better, pair.worse} <= kept)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is rejected, what cannot be told apart, and what that means for alpha."""
        return tuple(shape_report.sentences(self))

    def report(self) -> str:
        """Table and sentences as text."""
        return shape_report.text(self)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Residuals against force: the best shape's as points, every shape's predictions as a line over its.

        As 100 ln of the velocity over the best shape's prediction, which is in % where it is small. The axis
        is linear where the points lie, shaded, and logarithmic beyond, where shapes that miss them go.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw; a new figure by default.

        Returns
        -------
        matplotlib Axes
        """
        from burrlab.fitting.shape_plots import plot_residuals

        return plot_residuals(self, ax)

    def plot_power(self, ax: Axes | None = None) -> Axes:
        """Rise of -2 log L over k of the family, with the limits of the three levels and marks at k = 0, 1, 2.

        The axis of the rise is linear up to the largest limit, and logarithmic above.

        Parameters
        ----------
        ax : matplotlib Axes, optional

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ValueError
            If the comparison was made without the family.
        """
        from burrlab.fitting.shape_plots import plot_power

        if self.power is None:
            raise ValueError(
                "the profile over k needs the family, free=True, and more than three rows: got none"
            )
        return plot_power(self, ax)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the data as plain Python objects, ready for JSON; what is not finite is None."""
        return shape_report.to_dict(self)

    def __repr__(self) -> str:
        return "\n".join(shape_report.table(self))

    def _repr_html_(self) -> str:
        return shape_report.html(self)
