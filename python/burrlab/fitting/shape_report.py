"""A comparison of erosion shapes as text, HTML and plain objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from burrlab._core import Shape
from burrlab.fitting.hypotheses import p_text
from burrlab.fitting.plain import _plain
from burrlab.fitting.shape_family import NODES, PowerProfile

if TYPE_CHECKING:
    from burrlab.fitting.shape_comparison import Pair, Part, ShapeComparison, ShapeRow

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
_NEAR = 1e-5  # of x, over which the slope of f at x = 1 is taken
_FAR = 1.5  # further off than by this factor velocities are told as multiples


def kappa(shape: Shape) -> float:
    """-f'(1): 2 for parabolic, 1 for linear, 0 for a zero of higher order."""
    return (float(shape(1 - 2 * _NEAR)) - float(shape(1.0))) / (2 * _NEAR)


def cells(comparison: ShapeComparison) -> list[list[str]]:
    """The table, its head first."""
    rows = [list(_HEAD)]
    for row in comparison.rows:
        one = row.fit
        lack = "-" if one.lack_of_fit is None else p_text(one.lack_of_fit.p_value)
        against = "-" if row.p_value is None else p_text(row.p_value)
        if row.rejected:
            against += ", rejected"
        numbers = [f"{one.c_e:.4g}", f"{one.alpha:.4g}"]
        rows.append(
            [
                row.shape.name,
                *(f"{number} (open)" if _is_open(row) else number for number in numbers),
                f"{one.log_likelihood:.4g}",
                f"{one.aic:.4g}",
                f"{one.bic:.4g}",
                f"{row.delta_aic:.3g}",
                _amount(comparison, one.residual_norm, sign=False),
                lack,
                against,
                _pattern(comparison, row.pattern),
            ]
        )
    return rows


def _is_open(row: ShapeRow) -> bool:
    return row.fit.intervals["c_e"]["95"].upper is None


def table(comparison: ShapeComparison) -> list[str]:
    """The table as aligned lines."""
    rows = cells(comparison)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def text(comparison: ShapeComparison) -> str:
    """Table and sentences."""
    lines = ["[[Erosion shapes]]", *(f"    {line}" for line in table(comparison)), "[[Notes]]"]
    return "\n".join([*lines, *(f"    - {sentence}" for sentence in sentences(comparison))])


def html(comparison: ShapeComparison) -> str:
    """Table and sentences for a notebook."""
    head, *rows = cells(comparison)
    lines = ["".join(f"<th>{escape(cell)}</th>" for cell in head)]
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    items = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences(comparison))
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table><ul>{items}</ul>"


def to_dict(comparison: ShapeComparison) -> dict[str, Any]:
    """See `ShapeComparison.to_dict`."""
    rows = [
        {
            "shape": row.shape.name,
            "c_e": row.fit.c_e,
            "alpha": row.fit.alpha,
            "intervals": {
                name: {level: [ends.lower, ends.upper] for level, ends in levels.items()}
                for name, levels in row.fit.intervals.items()
            },
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
            "pattern": [asdict(part) | {"in_words": _words(comparison, part)} for part in row.pattern],
            "alpha_ratio": row.alpha_ratio,
            "combination_ratio": row.combination_ratio,
        }
        for row in comparison.rows
    ]
    made: dict[str, Any] = _plain(
        {
            "rows": rows,
            "power": comparison.power,
            "pairs": [asdict(pair) | {"told_apart": pair.told_apart} for pair in comparison.pairs],
            "level": comparison.level,
            "residuals": comparison.residual_kind,
            "rejected": comparison.rejected,
            "sentences": sentences(comparison),
            "provenance": comparison.provenance,
        }
    )
    return made


def sentences(comparison: ShapeComparison) -> list[str]:
    """See `ShapeComparison.sentences`."""
    lines = [_rejection(comparison)]
    if comparison.power is not None:
        lines.append(_free(comparison.power))
    lines += [_pair(comparison, pair) for pair in comparison.indistinguishable]
    reference = next((row for row in comparison.rows if row.shape == Shape("parabolic")), None)
    if reference is not None and reference.shape.name in comparison.kept:
        lines += [_alpha(reference, row) for row in comparison.rows if row.shape.name in comparison.kept]
    lines += [
        f"Under {row.shape.name}, velocities are {words}."
        for row in comparison.rows
        if (words := _misfit(comparison, row))
    ]
    lack = comparison.best.fit.lack_of_fit
    if lack is not None and lack.p_value < 0.05:
        lines.append(f"The best shape, {comparison.best.shape.name}, does not fit either: {lack.sentence}")
    lines.append("An alpha holds for the f that it was fitted with: quote both, and simulate with both.")
    return lines


def _rejection(comparison: ShapeComparison) -> str:
    percent = f"{100 * comparison.level:g} %"
    if comparison.power is None or comparison.threshold is None:
        return "No shape was tested: that needs the family power(k), free=True, and more than three rows."
    nu = comparison.threshold.nu
    test = "chi-square of 1" if nu == float("inf") else f"F(1, {nu:.4g})"
    said = []
    for name, rows in (
        ("rejected", [row for row in comparison.rows if row.rejected]),
        ("not rejected", [row for row in comparison.rows if not row.rejected]),
    ):
        if rows:
            each = [f"{row.shape.name} ({p_text(row.p_value or 0.0)})" for row in rows]
            said.append(f"{_listed(each)} {'is' if len(rows) == 1 else 'are'} {name}")
    return f"Against f = (1 - x^2)^k with k free, at {percent} ({test}): {'; '.join(said)}."


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
        f"{pair.better} and {pair.worse} {zero}cannot be told apart: delta AIC {delta:.2g}, "
        f"-2 log L differs by {pair.rise:.2g}, below {pair.limit:.2g}, the 95 % limit of one parameter."
    )


def _alpha(reference: ShapeRow, row: ShapeRow) -> str:
    name = row.shape.name
    if row.alpha_ratio is None:
        names = _listed([r.shape.name for r in (row, reference) if _is_open(r)])
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
    slope = kappa(reference.shape) / kappa(row.shape)
    return (
        f"{line} What a simple zero determines at small forces is kappa alpha/c_e^(8/3), kappa = -f'(1): it is "
        f"{row.combination_ratio / slope:.3g} times parabolic's, so that at equal c_e alpha would be "
        f"{row.combination_ratio:.3g} times; {slope:.3g} by the thin-layer law."
    )


def _misfit(comparison: ShapeComparison, row: ShapeRow) -> str:
    said = [_words(comparison, part) for part in row.pattern if part.clear]
    return _listed(said) if len(said) > 1 or row.rejected else ""


def _words(comparison: ShapeComparison, part: Part) -> str:
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


def _pattern(comparison: ShapeComparison, parts: Sequence[Part]) -> str:
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
