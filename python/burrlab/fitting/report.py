"""A fit as text and HTML."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from burrlab.fitting import verdict

if TYPE_CHECKING:
    from burrlab.fitting.result import Fit

_RESIDUALS = {
    "relative": "relative, ln(v/v_predicted)",
    "absolute": "absolute, v - v_predicted [mm/s]",
    "sigma": "by sigma, (v - v_predicted)/sigma",
}
_UNITS = {"c_e": "N/mm^2", "alpha": "1/ms"}


def text(fit: Fit) -> str:
    """The fit as aligned text blocks."""
    blocks = {
        "Fit Statistics": _aligned(statistics(fit)),
        "Variables": _aligned(variables(fit)),
        "Starts": starts(fit),
        "Notes": [f"- {note}" for note in notes(fit)],
    }
    return "\n".join("\n    ".join([f"[[{title}]]", *lines]) for title, lines in blocks.items())


def html(fit: Fit) -> str:
    """The fit as HTML for a notebook."""
    parts = [f"<p><b>{escape(repr(fit))}</b></p>"]
    for pairs in (variables(fit), statistics(fit)):
        rows = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in pairs.items())
        parts.append(f"<table>{''.join(rows)}</table>")
    parts.append("<ul>" + "".join(f"<li>{escape(note)}</li>" for note in notes(fit)) + "</ul>")
    table = escape("\n".join(starts(fit)))
    parts.append(f"<details><summary>starts</summary><pre>{table}</pre></details>")
    return "".join(parts)


def statistics(fit: Fit) -> dict[str, str]:
    chi2 = "unknown, the data have no sigma" if fit.chi2_reduced is None else f"{fit.chi2_reduced:.4g}"
    distinct = len(np.unique(fit.curve.force[fit.curve.ok]))
    return {
        "data": fit.curve.source or "unnamed",
        "engine": f"{fit.engine}, shape {fit.shape.name}, burr radius {fit.radius:g} mm",
        "residuals": _RESIDUALS[fit.residual_kind],
        "data points": f"{fit.n_points} at {distinct} forces; rows skipped: {fit.n_skipped}",
        "variables": "2",
        "RMS residual": rms(fit, fit.residual_norm),
        "reduced chi-square": chi2,
        "function evals": f"{fit.evaluations} in {fit.seconds:.2g} s; seed {fit.seed}",
        "status": fit.status,
    }


def variables(fit: Fit) -> dict[str, str]:
    begin = dict(zip(_UNITS, fit.best.start, strict=True))
    return {
        name: f"{value:<9.5g} {unit:<6}  (start {begin[name]:.4g}, bounds {low:.4g} .. {high:.4g})"
        for name, unit in _UNITS.items()
        for value, (low, high) in [(getattr(fit, name), fit.bounds[name])]
    }


def starts(fit: Fit) -> list[str]:
    """A table of every search: where it began, where it ended, how."""
    names = f"{'search':<18}{'c_e from':>10}{'to':>10}{'alpha from':>12}{'to':>10}"
    lines = [f"{names}{'RMS':>11}{'evals':>7}  result"]
    for s in fit.starts:
        norm = np.sqrt(s.objective / fit.n_points)
        lines.append(
            f"{s.origin:<18}{s.start[0]:>10.4g}{s.end[0]:>10.4g}{s.start[1]:>12.4g}{s.end[1]:>10.4g}{norm:>11.5g}"
            f"{s.evaluations:>7}  {s.result}"
        )
    return lines


def notes(fit: Fit) -> list[str]:
    """Plain sentences on what the numbers mean."""
    lines = [fit.reason, ridge(fit)]
    if len(fit.starts) > 1:
        lines.append(agreement(fit))
    if fit.engine == "voxel":
        lines.append(
            "The voxel engine is stochastic: all evaluations used the same seeds, another seed moves them."
        )
    lines.append("No intervals are given, and c_e and alpha are correlated: the digits are not a precision.")
    lines.append(f"alpha holds for f = {fit.shape.name} and for one drill, burr type and speed.")
    return lines


def ridge(fit: Fit) -> str:
    """What the forces can determine, in a sentence."""
    r = fit.ridge
    combination = f"alpha/c_e^{r.exponent:.4g} = {r.value:.4g} (1/ms)/(N/mm^2)^{r.exponent:.4g}"
    largest = f"The largest phi = F/(c_e R^2) is {r.max_phi:.3g}"
    if r.on_ridge:
        return (
            f"{largest}, and every window begins above static contact: only {combination} is determined, "
            "c_e and alpha may be moved together along it."
        )
    if not r.excluded:
        return (
            f"{largest} at the fitted c_e, but larger c_e with {combination} fit nearly as well "
            f"(RMS residual {rms(fit, r.residual)}): c_e alone is not determined."
        )
    return (
        f"{largest}: the data reach off the ridge, where c_e is determined apart from alpha; on the ridge "
        f"the RMS residual would be {rms(fit, r.residual)}."
    )


def agreement(fit: Fit) -> str:
    """Whether the local searches ended in one place, in a sentence."""
    n_local = sum(s.origin != "global" for s in fit.starts)
    equal, c_e, alpha = verdict.agreement(fit.starts, fit.best, fit.n_points)
    line = f"{len(equal)} of {n_local} local searches ended equally well"
    if len(equal) > 1:
        line += f", within {100 * (c_e - 1):.2g} % in c_e and {100 * (alpha - 1):.2g} % in alpha"
    others = [s for s in fit.starts if s.origin != "global" and s not in equal]
    if not others:
        return line + "."
    next_best = min(others, key=lambda s: s.objective)
    return (
        f"{line}; the others ended worse, the best of them at c_e = {next_best.end[0]:.4g} N/mm^2, "
        f"alpha = {next_best.end[1]:.4g} /ms with an RMS residual of "
        f"{rms(fit, float(np.sqrt(next_best.objective / fit.n_points)))}."
    )


def rms(fit: Fit, value: float) -> str:
    if fit.residual_kind == "relative":
        return f"{100 * value:.3g} %"
    return f"{value:.4g} mm/s" if fit.residual_kind == "absolute" else f"{value:.4g} sigma"


def _aligned(pairs: dict[str, str]) -> list[str]:
    width = max(map(len, pairs))
    return [f"{name:<{width}} = {value}" for name, value in pairs.items()]
