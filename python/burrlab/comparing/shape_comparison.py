"""The result of a comparison of erosion shapes: its report, figures and JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes

from burrlab._core import Shape, shape_kappa
from burrlab.common.check import refuse
from burrlab.common.figures import (
    FORCE,
    POSITION,
    REFERENCE,
    VELOCITY,
    axes_or_new,
    drawing,
    plot_points,
    styled,
)
from burrlab.common.records import Codec
from burrlab.fitting.calibration import Threshold
from burrlab.fitting.diagnostics import p_text
from burrlab.fitting.observations import Floats
from burrlab.fitting.profile import Interval, plain_ends
from burrlab.fitting.report import columns, html_table, in_blocks
from burrlab.fitting.result import Fit

NODES = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  #: k of the master curves that others are interpolated from


@dataclass(frozen=True)
class ForceThird:
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
class PowerProfile:
    """The best member of the family power(k), and how well k is known.

    Attributes
    ----------
    k : float
        Best exponent, from 0 to 3.
    c_e, alpha : float
        Best c_e [N/mm^2] and alpha [1/ms] at this k.
    intervals : mapping
        Level ``68``, ``95``, ``99.7`` -> Interval of k; None is open: at k = 0, where the family begins, or
        at k = 3, where the search ends.
    limits : mapping
        Level -> rise of -2 log L that bounds the interval.
    grid, rise : ndarray, shape (m,)
        k, and the rise of -2 log L there at the best c_e and alpha.
    """

    k: float
    c_e: float
    alpha: float
    intervals: Mapping[str, Interval]
    limits: Mapping[str, float]
    grid: Floats
    rise: Floats


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
        Rise of -2 log L over the family's minimum, negative where the shape fits better; None without it.
    p_value : float or None
        p-value of the shape against the family.
    rejected : bool or None
        Whether the shape is rejected at the comparison's level.
    pattern : tuple of ForceThird
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
    pattern: tuple[ForceThird, ...]
    alpha_ratio: float | None
    combination_ratio: float | None


@dataclass(frozen=True, eq=False, repr=False)
class ShapeComparison:
    """Fits under several erosion shapes, side by side. Made by `burrlab.compare_shapes`.

    Attributes
    ----------
    rows : tuple of ShapeRow
        One per shape, in the order given.
    power : PowerProfile or None
        The family (1 - x^2)^k with k free; None without it, or where the rows leave no freedom for it.
    threshold : Threshold or None
        How rises of -2 log L are judged.
    pairs : tuple of Pair
        Every two shapes.
    level : float
        Level at which shapes are rejected.
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

    def __getitem__(self, shape: Shape | str) -> ShapeRow:
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
        """The shape that no other beats in the pairs."""
        return next(iter({pair.better for pair in self.pairs} - {pair.worse for pair in self.pairs}), None)

    @property
    def indistinguishable(self) -> tuple[Pair, ...]:
        """Pairs of the kept shapes that the data cannot tell apart."""
        kept_shapes = set(self.kept)
        return tuple(
            pair for pair in self.pairs if not pair.told_apart and {pair.better, pair.worse} <= kept_shapes
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences on rejected shapes, shapes that cannot be told apart, and alpha."""
        lines = [_rejection(self)]
        if self.power is not None:
            lines.append(_free(self.power))
        lines += [_pair(self, pair) for pair in self.indistinguishable]
        reference = next((row for row in self.rows if row.shape == Shape("parabolic")), None)
        if reference is not None and reference.shape.name in self.kept:
            lines += [_alpha(reference, row) for row in self.rows if row.shape.name in self.kept]
        for row in self.rows:
            patterns = [_words(self, part) for part in row.pattern if part.clear]
            if len(patterns) > 1 or (patterns and row.rejected):
                lines.append(f"Under {row.shape.label}, velocities are {_listed(patterns)}.")
        lack = self.best.fit.lack_of_fit
        if lack is not None and lack.p_value < 0.05:
            lines.append(f"The best shape, {self.best.shape.label}, does not fit either: {lack.sentence}")
        lines.append("An alpha holds for the f that it was fitted with: quote both, and simulate with both.")
        return tuple(lines)

    def report(self) -> str:
        """Table and sentences as text."""
        notes = [f"- {sentence}" for sentence in self.sentences]
        return in_blocks({"Erosion shapes": columns(cells(self)), "Notes": notes})

    @drawing
    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Velocities over the best shape's predictions, against force: data as points, shapes as lines.

        The axis shows 100 ln of the ratio, which is in % where it is small. It is linear, and shaded, where
        the points lie, and logarithmic beyond.

        `style` is that of the points.
        """
        ax = axes_or_new(ax)
        best = self.best
        o = best.fit.observations
        measured = 100 * np.log(o.velocity / _predicted(best.fit))
        half = max(1.25 * float(np.abs(measured).max()), _LEAST)
        farthest = half
        for i, row in enumerate(self.rows):
            force, ratio = _line(row.fit, best.fit)
            label = f"{row.shape.label}, rejected" if row.rejected else row.shape.label
            ax.plot(force, 100 * np.log(ratio), _STYLES[i % len(_STYLES)], color=_LINES[i % len(_LINES)],
                    linewidth=1.4, label=label, zorder=3)  # fmt: skip
            farthest = max(farthest, 100 * float(np.abs(np.log(ratio)).max()))
        plot_points(
            ax,
            o.force,
            measured,
            None,
            {"ms": 3.5, "zorder": 4} | style,
            f"data ({best.shape.label} fits best)",
        )
        ax.set(xscale="log", xlabel="force [N]", ylabel=f"100 ln($v/v_\\mathrm{{{best.shape.label}}}$)")
        step = float(next((s for s in _TICKS if half / s < 3), _TICKS[-1]))
        inner = np.arange(0, half, step)
        outer = np.array(
            [s for s in (*_TICKS, 1000, 3000) if 1.5 * half < s <= farthest and str(s)[0] in "13"]
        )
        if farthest > half:
            ax.set_yscale("symlog", linthresh=half, linscale=2.0)
            ax.axhspan(-half, half, color="0.96", zorder=0)
        ticks = np.concatenate([inner, outer])
        _set_ticks(ax, [*-ticks[1:], *ticks])
        ax.set(ylim=(-1.1 * farthest, 1.1 * farthest), xlim=(0.93 * o.force.min(), 1.07 * o.force.max()))
        return ax

    @drawing
    def plot_power(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Rise of -2 log L over k of the family, with the limits of three levels and marks at k = 0, 1, 2.

        The axis of the rise is linear up to the largest limit, and logarithmic above.

        Raises
        ------
        ValueError
            If the comparison was made without the family.
        """
        refuse(
            self.power is None,
            "the profile over k needs the family, free=True, and more than three rows: got none",
        )
        ax = axes_or_new(ax)
        power = self.power
        assert power is not None
        largest = max(power.limits.values())
        ax.set_yscale("symlog", linthresh=largest, linscale=2.0)
        ax.plot(power.grid, power.rise, **styled(style, color=FORCE, linewidth=1.4))
        for level, limit in power.limits.items():
            ax.axhline(limit, color=REFERENCE, linewidth=0.8, linestyle="--")
            ax.annotate(f"{level} %", (0.995, limit), xycoords=("axes fraction", "data"), xytext=(0, 2),
                        textcoords="offset points", ha="right", fontsize=8, color=REFERENCE)  # fmt: skip
        for k, name in ((0, "constant"), (1, "parabolic"), (2, "quartic")):
            rise = float(np.interp(k, power.grid, power.rise))
            ax.plot(k, rise, "o", color=VELOCITY, markersize=5, zorder=4, clip_on=False)
            ax.annotate(
                name,
                (k, rise),
                xytext=(8, -11 if rise > largest and k > power.k else 4),
                textcoords="offset points",
                fontsize=8,
                color=VELOCITY,
            )
        top = max(10 * largest, 2.0 * float(power.rise.max()))
        ax.set(
            xlabel="$k$ of $f = (1 - x^2)^k$",
            ylabel="rise of $-2 \\log L$",
            xlim=(NODES[0] - 0.08, NODES[-1]),
        )
        ax.set_ylim(0, top)
        step = 2 if largest < 12 else 5
        powers = 10.0 ** np.arange(1, np.floor(np.log10(top)) + 1)
        _set_ticks(ax, [*np.arange(0, largest, step), *powers[powers > 1.3 * largest]])
        interval = power.intervals["95"]
        ends = [f"{NODES[0]:g}" if interval.lower is None else f"{interval.lower:.3f}"]
        ends.append("open" if interval.upper is None else f"{interval.upper:.3f}")
        ax.set_title(f"$k$ = {power.k:.3f}, 95 %: {ends[0]} .. {ends[1]}")
        return ax

    def to_dict(self) -> dict[str, Any]:
        """All but the data as plain Python objects, ready for JSON; infinities and NaN are None."""
        rows = [
            {
                "shape": row.shape.name,
                "c_e": row.fit.c_e,
                "alpha": row.fit.alpha,
                "intervals": plain_ends(row.fit.intervals),
                "status": row.fit.status,
                "log_likelihood": row.fit.log_likelihood,
                "aic": row.fit.aic,
                "bic": row.fit.bic,
                "delta_aic": row.delta_aic,
                "residual": row.fit.residual_norm,
                "lack_of_fit_p": None if row.fit.lack_of_fit is None else row.fit.lack_of_fit.p_value,
                "rise": row.rise,
                "p_value": row.p_value,
                "rejected": row.rejected,
                "pattern": [asdict(part) | {"in_words": _words(self, part)} for part in row.pattern],
                "alpha_ratio": row.alpha_ratio,
                "combination_ratio": row.combination_ratio,
            }
            for row in self.rows
        ]
        comparison: dict[str, Any] = Codec().plain(
            {
                "rows": rows,
                "power": self.power,
                "pairs": [asdict(pair) | {"told_apart": pair.told_apart} for pair in self.pairs],
                "level": self.level,
                "residuals": self.residual_kind,
                "rejected": self.rejected,
                "sentences": self.sentences,
                "provenance": self.provenance,
            }
        )
        return comparison

    def __repr__(self) -> str:
        return "\n".join(columns(cells(self)))

    def _repr_html_(self) -> str:
        items = "".join(f"<li>{escape(sentence)}</li>" for sentence in self.sentences)
        return f"{html_table(cells(self))}<ul>{items}</ul>"


_HEAD = (
    "f",
    "c_e [N/mm^2]",
    "alpha [1/ms]",
    "log L",
    "AIC",
    "BIC",
    "delta AIC",
    "RMS",
    "lack of fit",
    "against power(k)",
    "mean residual low / middle / high",
)
_FAR = 1.5  # velocities that are off by a larger factor are printed as multiples


def cells(comparison: ShapeComparison) -> list[list[str]]:
    """The table, header first."""
    rows = [list(_HEAD)]
    for row in comparison.rows:
        fit = row.fit
        lack = "-" if fit.lack_of_fit is None else p_text(fit.lack_of_fit.p_value)
        against = "-" if row.p_value is None else p_text(row.p_value)
        rows.append(
            [
                row.shape.label,
                *(f"{number:.4g}{' (open)' if _is_open(row) else ''}" for number in (fit.c_e, fit.alpha)),
                f"{fit.log_likelihood:.4g}",
                f"{fit.aic:.4g}",
                f"{fit.bic:.4g}",
                f"{row.delta_aic:.3g}",
                _amount(comparison, fit.residual_norm, sign=False),
                lack,
                f"{against}{', rejected' if row.rejected else ''}",
                _pattern(comparison, row.pattern),
            ]
        )
    return rows


def _is_open(row: ShapeRow) -> bool:
    return row.fit.intervals["c_e"]["95"].upper is None


def _rejection(comparison: ShapeComparison) -> str:
    if comparison.power is None or comparison.threshold is None:
        return "No shape was tested: that needs the family power(k), free=True, and more than three rows."
    nu = comparison.threshold.nu
    test = "chi-square of 1" if nu == float("inf") else f"F(1, {nu:.4g})"
    rejections = []
    for name, rows in (
        ("rejected", [row for row in comparison.rows if row.rejected]),
        ("not rejected", [row for row in comparison.rows if not row.rejected]),
    ):
        if rows:
            each = [f"{row.shape.label} ({p_text(row.p_value or 0.0)})" for row in rows]
            rejections.append(f"{_listed(each)} {'is' if len(rows) == 1 else 'are'} {name}")
    return f"Against f = (1 - x^2)^k with k free, at {100 * comparison.level:g} % ({test}): {'; '.join(rejections)}."


def _free(power: PowerProfile) -> str:
    ends = []
    for level, interval in power.intervals.items():
        lower = (
            f"{NODES[0]:g} (open: the family begins there)"
            if interval.lower is None
            else f"{interval.lower:.4g}"
        )
        upper = (
            f"{NODES[-1]:g} (open: the search ends there)"
            if interval.upper is None
            else f"{interval.upper:.4g}"
        )
        ends.append(f"{lower} .. {upper} at {level} %")
    return f"With k free, k = {power.k:.4g}: {', '.join(ends)}."


def _pair(comparison: ShapeComparison, pair: Pair) -> str:
    order = Shape(pair.better).order
    same = order > 0 and order == Shape(pair.worse).order
    zero = "both have a simple zero at the burr's surface and " if same and order == 1 else ""
    delta = comparison[pair.worse].delta_aic - comparison[pair.better].delta_aic
    return (
        f"{Shape(pair.better)} and {Shape(pair.worse)} {zero}cannot be told apart: delta AIC {delta:.2g}, "
        f"-2 log L differs by {pair.rise:.2g}, below {pair.limit:.2g}, the 95 % limit of one parameter."
    )


def _alpha(reference: ShapeRow, row: ShapeRow) -> str:
    name = row.shape.label
    if row.alpha_ratio is None:
        names = _listed([r.shape.label for r in (row, reference) if _is_open(r)])
        line = f"{name} has no alpha of its own to compare with parabolic's: c_e is open above under {names}."
    elif row is reference:
        return f"Under parabolic alpha is {row.fit.alpha:.4g} /ms and c_e {row.fit.c_e:.4g} N/mm^2."
    else:
        line = (
            f"Under {name} alpha is {row.alpha_ratio:.3g} times that under parabolic, and c_e "
            f"{row.fit.c_e / reference.fit.c_e:.3g} times."
        )
    if row is reference:
        return f"Under parabolic c_e is open above, and alpha with it: {row.fit.verdict}"
    if row.combination_ratio is None:
        return line
    slope = shape_kappa(reference.shape) / shape_kappa(row.shape)
    return (
        f"{line} What a simple zero determines at small forces is kappa alpha/c_e^(8/3), kappa = -f'(1): it "
        f"is {row.combination_ratio / slope:.3g} times parabolic's, so that at equal c_e alpha would be "
        f"{row.combination_ratio:.3g} times; {slope:.3g} by the thin-layer law."
    )


def _words(comparison: ShapeComparison, part: ForceThird) -> str:
    low, high = part.forces
    where = f"at {low:.3g} N" if low == high else f"at {low:.3g}..{high:.3g} N"
    if not part.clear:
        return f"as predicted {where}"
    if comparison.residual_kind == "relative":
        ratio = float(np.exp(part.mean))
        if not 1 / _FAR < ratio < _FAR:
            return f"{ratio:.2g} times the prediction {where}"
        amount = f"{100 * abs(ratio - 1):.2g} %"
    else:
        amount = _amount(comparison, abs(part.mean), sign=False)
    return f"{amount} {'above' if part.mean > 0 else 'below'} the prediction {where}"


def _pattern(comparison: ShapeComparison, parts: Sequence[ForceThird]) -> str:
    means = " / ".join(_amount(comparison, part.mean, unit=False) for part in parts)
    error = _amount(comparison, max((part.error for part in parts), default=0.0), sign=False)
    return f"{means} (± {error})"


def _amount(comparison: ShapeComparison, value: float, *, sign: bool = True, unit: bool = True) -> str:
    """A residual with its unit; log residuals in %, as 100 ln."""
    scale, name = {"relative": (100.0, " %"), "absolute": (1.0, " mm/s"), "sigma": (1.0, " sigma")}[
        comparison.residual_kind
    ]
    return f"{scale * value:{'+' if sign else ''}.3g}{name if unit else ''}"


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""


_LINES = (FORCE, VELOCITY, POSITION, "#CC79A7", "#E69F00", "#56B4E9")
_STYLES = ("-", "--", "-.", ":")
_LEAST = 5.0  # half of the linear part of the axis is at least this, in 100 ln
_TICKS = (1, 2, 5, 10, 20, 30, 50, 100, 300)


def _set_ticks(ax: Axes, places: Sequence[float]) -> None:
    """Ticks of the vertical axis, in plain numbers, and no others."""
    ax.set_yticks(places, [f"{place:g}" for place in places])
    ax.set_yticks([], minor=True)


def _predicted(fit: Fit) -> Floats:
    return np.asarray(fit.alpha * fit.likelihood.model.unit(fit.c_e))


def _line(fit: Fit, best: Fit) -> tuple[Floats, Floats]:
    """Force [N] and velocity over the best's; smooth if all rows have one radius and the default window."""
    o = best.observations
    if np.isnan(o.window_start).all() and fit.radius is not None:
        force = np.geomspace(o.force.min(), o.force.max(), 200)
        return force, np.asarray(fit.velocity(force)) / np.asarray(best.velocity(force))
    force, inverse = np.unique(o.force, return_inverse=True)
    log = np.log(_predicted(fit) / _predicted(best))
    return force, np.exp(np.bincount(inverse, log) / np.bincount(inverse))
