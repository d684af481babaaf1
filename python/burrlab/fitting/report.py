"""A fit as text and HTML."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple
from html import escape
from typing import Any

import numpy as np

import burrlab.fitting.verdict as verdict
from burrlab.common.table import html_pairs, html_rows
from burrlab.fitting.calibration import RowScatter
from burrlab.fitting.diagnostics import FEWEST, indentation_tests, order_tests, restarting
from burrlab.fitting.group_effects import of_groups_alone
from burrlab.fitting.linear import OFFSETS
from burrlab.fitting.mixed import against_indentation
from burrlab.fitting.record import Evidence, FitRecord
from burrlab.fitting.repairs import repair_sentence, sensitivity_sentence
from burrlab.measured.curve import VelocityCurve

_RESIDUALS = {
    "relative": "log-normal, r = ln(v/v_predicted)",
    "absolute": "normal, r = v - v_predicted [mm/s]",
    "sigma": "normal of given sigma, r = (v - v_predicted)/sigma",
    "student": "Student's t with 4 degrees of freedom, r = ln(v/v_predicted)",
}
_UNITS = {"c_e": "N/mm^2", "alpha": "1/ms"}
_HEADS = ["", "value", "68 %", "95 %", "99.7 %", "start", "search bounds"]


def text(fit: FitRecord, verbose: bool) -> str:
    """The fit as aligned text blocks; `verbose` adds the table of searches."""
    return in_blocks(
        {
            "Fit Statistics": _aligned(statistics(fit)),
            "Variables": columns([_HEADS, *variable_rows(fit)]),
            "Identification": _aligned(identification(fit)),
            "Starts": starts(fit) if verbose else [],
            "Notes": [f"- {note}" for note in notes(fit)],
        }
    )


def in_blocks(blocks: Mapping[str, Sequence[str]]) -> str:
    """Lines under their titles, without empty blocks."""
    return "\n".join("\n    ".join([f"[[{title}]]", *lines]) for title, lines in blocks.items() if lines)


def html(fit: FitRecord) -> str:
    """The fit as HTML for a notebook."""
    parts = [
        f"<p><b>{escape(repr(fit))}</b></p>",
        f"<p>{escape(fit.verdict)}</p>",
        html_rows([_HEADS, *variable_rows(fit)]),
        html_pairs(identification(fit)),
        html_pairs(statistics(fit)),
    ]
    table = escape("\n".join(starts(fit)))
    return f"{''.join(parts)}{html_list(notes(fit))}<details><summary>starts</summary><pre>{table}</pre></details>"


def html_list(texts: Sequence[str]) -> str:
    """Texts as a list of HTML."""
    return f"<ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>"


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of cells as lines of text, the columns aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def statistics(fit: FitRecord) -> dict[str, str]:
    o = fit.observations
    lacking = "the data have no sigma" if np.isnan(o.sigma).all() else "some rows have no sigma"
    chi2 = f"unknown, {lacking}" if fit.chi2_reduced is None else f"{fit.chi2_reduced:.4g}"
    radius = ", ".join(f"{R:g}" for R in sorted(set(o.radius.tolist())))
    distinct = len(np.unique(np.stack([o.force, o.radius]), axis=1).T)
    points = f"{fit.n_points}, velocities at {distinct} forces"
    if len(o.pressed):
        points += f", {len(o.pressed)} pairs of an indentation"
    rows = {
        "data": "; ".join(data_set.source or "unnamed" for data_set in fit.data),
        "engine": f"{fit.engine}, {'shape ' if fit.law.is_paper else 'law '}{fit.law}, burr radius {radius} mm",
        "likelihood": _RESIDUALS[fit.residual_kind],
        "data points": f"{points}; rows skipped: {fit.n_skipped}, of these censored: {fit.n_censored}",
        "variables": f"{fit.n_parameters}, scatters included",
        "RMS residual": rms(fit, fit.residual_norm),
        "reduced chi-square": chi2,
    }
    if fit.evidence is not None:
        rows["scatter"] = "; ".join(scatter(fit, s) for s in fit.evidence.scatters)
        rows["log-likelihood"] = f"{fit.log_likelihood:.6g}"
        rows["AIC, BIC"] = f"{fit.aic:.6g}, {fit.bic:.6g}"
    # fits of earlier versions have several starts
    method = "CRS2 and BOBYQA" if "starts" in fit.provenance else "walk along c_e, checked by BOBYQA"
    return rows | {
        "function evals": f"{fit.evaluations} in {fit.seconds:.2g} s; seed {fit.seed}",
        "method": f"{method} (nlopt); intervals by profile likelihood, limits by F",
        "status": fit.status,
    }


def scatter(fit: FitRecord, part: RowScatter) -> str:
    """A scatter in words."""
    if part.known:
        return f"{part.name} as given"
    unit = " mm/s" if part.name == "velocity" and fit.residual_kind == "absolute" else " %"
    value = part.value if unit == " mm/s" else 100 * part.value
    return f"{part.name} {value:.3g}{unit} estimated from {part.n} rows"


def variable_rows(fit: FitRecord) -> list[list[str]]:
    """Name, value, the three intervals, start and bounds of each variable."""
    begin = dict(zip(_UNITS, fit.best.start, strict=True))
    good = None if fit.evidence is None else fit.evidence.goodness
    remark = ", one of many" if fit._on_ridge else ", contradicted" if good is not None and good.poor else ""
    return [
        [
            name,
            f"{getattr(fit, name):.5g} {unit}{remark}",
            *(verdict.span(interval) for interval in fit.intervals[name].values()),
            f"{begin[name]:.4g}",
            f"{low:.4g} .. {high:.4g}",
        ]
        for name, unit in _UNITS.items()
        for low, high in [fit.bounds[name]]
    ]


def parameter_columns(fit: FitRecord) -> dict[str, list[Any]]:
    """What was estimated, with its 95 % interval: constants, combination, deviations between groups, offsets, scatters."""
    p = f"{fit.identified.exponent:.4g}" if fit.identified else ""
    rows: list[tuple[str, str, float, float | None, float | None]] = [
        (name, _UNITS[name], getattr(fit, name), *astuple(fit.intervals[name]["95"])) for name in _UNITS
    ]
    if fit.identified is not None:
        unit = f"(1/ms)/(N/mm^2)^{p}"
        rows.append((f"alpha/c_e^{p}", unit, fit.identified.value, *astuple(fit.identified.interval)))
    for name, (value, deviation) in fit.provenance.get("known", {}).items():
        low, high = (value * np.exp(1.96 * deviation * side) for side in (-1, 1))
        rows.append((f"{name} as given", _UNITS[name], value, low, high))
    for x in fit.effects:
        if x.interval is not None and x.deviation is not None:
            rows.append((f"sd of ln {x.quantity} between {x.group}s", "1", x.deviation, *astuple(x.interval)))
        for k, label in enumerate(x.levels if x.interval is None else ()):
            of = (
                f"ln {x.quantity}, data set {label} over the first"
                if x.quantity in ("c_e", "alpha")
                else f"offset of {x.quantity}".replace("offset of order", "drift of ln v")
                + (f", {x.group} {label}" if len(x.levels) > 1 else "")
            )
            rows.append((of, OFFSETS.get(x.quantity, "1"), x.values[k], *x.level(k).ends))
    of_velocity = "mm/s" if fit.residual_kind == "absolute" else "1"
    rows += [
        (f"scatter of {s.name}", of_velocity if s.name == "velocity" else "1", s.value, np.nan, np.nan)
        for s in (fit.evidence.scatters if fit.evidence else ())
        if not s.known
    ]
    return {
        name: list(column)
        for name, column in zip(
            ("quantity", "unit", "value", "lower_95", "upper_95"), zip(*rows, strict=True), strict=True
        )
    }


def identification(fit: FitRecord) -> dict[str, str]:
    """What the data determine, and how well."""
    identified = fit.identified
    if identified is None:
        return {}
    p = f"{identified.exponent:.4g}"
    separate = fit._obstacle or "c_e's 95 % interval closed and within a factor of 2"
    return {
        "determined best": f"alpha/c_e^{p} = {identified.value:.4g} (1/ms)/(N/mm^2)^{p}",
        "its intervals": ", ".join(
            f"{level} %: {verdict.span(interval)}" for level, interval in identified.intervals.items()
        ),
        "correlation": f"{fit.correlation:.5f} (of log c_e and log alpha)",
        "condition": f"{fit.condition:.3g} (of the Fisher information)",
        "separately identified": f"{'no' if fit._obstacle else 'yes'} ({separate})",
    }


def starts(fit: FitRecord) -> list[str]:
    """A table of every search: begin, end and result."""
    return [
        f"{'search':<18}{'c_e from':>10}{'to':>10}{'alpha from':>12}{'to':>10}{'RMS':>11}{'evals':>7}  result",
        *(
            f"{s.origin:<18}{s.start[0]:>10.4g}{s.end[0]:>10.4g}{s.start[1]:>12.4g}{s.end[1]:>10.4g}"
            f"{np.sqrt(s.objective / fit.n_points):>11.5g}{s.evaluations:>7}  {s.result}"
            for s in fit.starts
        ),
    ]


def notes(fit: FitRecord) -> list[str]:
    """Plain sentences on what the numbers mean."""
    lines = [] if fit.status == "implausible" or fit.reason in fit.verdict else [fit.reason]
    if fit.evidence is not None:
        lines += _judgements(fit, fit.evidence)
    if fit.residual_kind != "sigma" and any(
        isinstance(s, VelocityCurve) and s.sigma is not None for s in fit.data
    ):
        lines.append("The data's sigma is not used; residuals 'sigma' use it.")
    if len(fit.starts) > 1:
        lines.append(agreement(fit))
    if fit.table is not None and fit.evidence is not None:
        lines.append(
            f"The voxel engine is stochastic: its descents scatter by {100 * fit.table.noise:.2g} % and lie "
            f"within {100 * fit.table.error:.2g} % (RMS) of the table; the Monte Carlo error of the fit widens "
            f"the limits by {100 * fit.evidence.monte_carlo:.2g} %."
        )
    lines.append(f"alpha holds for f = {fit.law} and for one drill, burr type and speed.")
    return lines


def _judgements(fit: FitRecord, evidence: Evidence) -> list[str]:
    """What the evidence says: verdict, ridge, tests, rows, order, and what would move the fit."""
    good = evidence.goodness
    presses = indentation_tests(fit.likelihood) + against_indentation(fit.likelihood, (fit.c_e, fit.alpha))
    tests = (fit.lack_of_fit or (good and good.test), fit.fall, *presses)
    lines = [fit.verdict, ridge(evidence.ridge, fit)]
    lines += [test.sentence for test in tests if test is not None and test.sentence not in fit.verdict]
    lines += [row.sentence for row in evidence.rows]
    ordered = order_tests(fit.likelihood, (fit.c_e, fit.alpha)) if of_groups_alone(fit.effects) else []
    if ordered and ordered[0].name != "drift":
        within = f" of each {group}" if (group := restarting(fit.observations)) else ""
        lines.append(
            f"The rows{within} are in the order of their forces: nothing tells a drift{' or days' * (not within)} from the force."
        )
    lines += repair_sentence(fit.repairs) if fit.n_points >= FEWEST else []
    lines += sensitivity_sentence(fit.sensitivity, evidence.profile.identified.exponent)
    if good is not None and fit.n_points < FEWEST:
        lines.append(f"With fewer than {FEWEST} rows none is named as standing out.")
    return lines


def ridge(r: verdict.Ridge, fit: FitRecord) -> str:
    """What the forces can determine, in a sentence."""
    combination = f"alpha/c_e^{r.exponent:.4g} = {r.value:.4g} (1/ms)/(N/mm^2)^{r.exponent:.4g}"
    largest = f"The largest phi = F/(c_e R^2) is {r.max_phi:.3g}"
    if r.on_ridge:
        alone = (
            "only that is determined, c_e and alpha may be moved together along it"
            if not r.excluded
            else "what tells c_e from alpha is how the exponent departs from that, or the other data"
        )
        return f"{largest}, every window begins above static contact, and velocities go with {combination}: {alone}."
    if not r.excluded:
        return (
            f"{largest} at the fitted c_e, but larger c_e with {combination} are not excluded at 95 % "
            f"(RMS residual {rms(fit, r.residual)}): c_e alone is not determined."
        )
    reach = (
        "" if fit._obstacle else ": the data reach off the ridge, where c_e is determined apart from alpha"
    )
    return f"{largest}{reach}; on the ridge the RMS residual would be {rms(fit, r.residual)}."


def agreement(fit: FitRecord) -> str:
    """Whether the searches ended in one place, in a sentence."""
    searches = [s for s in fit.starts if s.origin != "global"]
    equal, c_e, alpha = verdict.agreement(fit.starts, fit.best, fit.n_points)
    local = "local searches" if len(searches) < len(fit.starts) else "searches"
    line = f"{len(equal)} of {len(searches)} {local} ended equally well"
    if len(equal) > 1:
        c_e, alpha = (max(100 * (ratio - 1), 1e-3) for ratio in (c_e, alpha))  # below, rounding decides
        line += f", within {c_e:.2g} % in c_e and {alpha:.2g} % in alpha"
    others = [s for s in searches if s not in equal]
    if not others:
        return line + "."
    next_best = min(others, key=lambda s: s.objective)
    return (
        f"{line}; the others ended worse, the best of them at c_e = {next_best.end[0]:.4g} N/mm^2, "
        f"alpha = {next_best.end[1]:.4g} /ms with an RMS residual of "
        f"{rms(fit, float(np.sqrt(next_best.objective / fit.n_points)))}."
    )


def rms(fit: FitRecord, value: float) -> str:
    if fit.residual_kind in ("relative", "student"):
        return f"{100 * value:.3g} %"
    return f"{value:.4g} mm/s" if fit.residual_kind == "absolute" else f"{value:.4g} sigma"


def _aligned(pairs: dict[str, str]) -> list[str]:
    width = max(map(len, pairs), default=0)
    return [f"{name:<{width}} = {value}" for name, value in pairs.items()]
