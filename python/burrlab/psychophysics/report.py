"""An analysis in words and tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

from burrlab.psychophysics.scored_task import ScoredTask
from burrlab.psychophysics.subject_result import SubjectResult
from burrlab.psychophysics.task_data import design_text

if TYPE_CHECKING:
    from burrlab.psychophysics.analysis import Analysis

#: A column: what it belongs to, its name, its cells.
Column = tuple[str, str, list[str]]


def text(analysis: Analysis) -> str:
    """See `Analysis.report`."""
    lines = [_head(analysis), *analysis.notes]
    for task in analysis.tasks:
        lines += ["", *task_lines(task)]
    return "\n".join(lines)


def html(analysis: Analysis) -> str:
    """The report for notebooks."""
    said = "".join(f"<p>{escape(line)}</p>" for line in analysis.notes)
    return f"<h3>{escape(_head(analysis))}</h3>{said}" + "".join(map(task_html, analysis.tasks))


def _head(analysis: Analysis) -> str:
    kind = "SIMULATED SUBJECTS" if analysis.simulated else ""
    name = f"Experiment {analysis.name}" if analysis.name else "Analysis"
    return f"{name}, {kind}" if kind else name


def task_lines(task: ScoredTask) -> list[str]:
    """The report of a task."""
    lines = [heading(task), *(f"  ! {text}" for text in warnings(task))]
    if task.subjects:
        lines += ["", *table_lines(columns(task)), "", *group_lines(task), *check_lines(task)]
    return lines


def heading(task: ScoredTask) -> str:
    """Name, kind, what is compared, trials, chance."""
    about = design_text(task.design)
    trials = f"{task.trials} trials" if task.trials else "trials differ between subjects"
    parts = [f"{task.name}: {task.task}", *([about] if about else []), trials, f"chance {task.chance:g}"]
    return ", ".join(parts)


def warnings(task: ScoredTask) -> list[str]:
    """What a reader must know before the numbers."""
    found = []
    if task.simulated:
        found.append("SIMULATED SUBJECTS: nobody felt anything")
    if task.selected:
        found += selection_lines(task)
    if task.left_out:
        found.append(f"left out, as their runs are incomplete: {', '.join(task.left_out)}")
    partly = [
        f"{one.subject} ({one.counts.trials} of {one.planned} trials)"
        for one in task.subjects
        if not one.complete
    ]
    if partly:
        found.append(f"incomplete, and taken in on request: {', '.join(partly)}")
    if not task.subjects:
        found.append("no complete run")
    return found


def selection_lines(task: ScoredTask) -> list[str]:
    """What selection does to what is below."""
    n, by = len(task.subjects), f" by {task.selected_by}" if task.selected_by else ""
    first = (
        f"SELECTED SUBJECTS: {n} of {task.of}{by}"
        if task.of
        else f"SELECTED SUBJECTS{by}, of how many is not known"
    )
    lines = [
        f"{first}; what holds for them need not hold for others, and p values and intervals below do not allow for it"
    ]
    effect = task.selection
    if effect is not None:
        p = (
            ""
            if task.score is None
            else f"; a mean of {task.score.mean:.2f} or more has p = {p_text(effect.p_value(task.score.mean))}"
        )
        lines.append(
            f"if by this very score: the best {n} of {task.of} chance performers have {effect.expected:.2f} of "
            f"{effect.trials} on average, {effect.excess:.2f} above chance{p}"
        )
    return lines


def columns(task: ScoredTask) -> list[Column]:
    """The table of the subjects."""
    ones = task.subjects
    answer = {"same-different": '"different"'}.get(task.task, '"first"')
    found: list[Column] = [
        ("", "subject", [one.subject for one in ones]),
        ("", "score", [f"{one.counts.score}/{one.counts.trials}" for one in ones]),
        ("exact binomial", "p", [p_text(one.p_value) for one in ones]),
        ("exact binomial", "Holm", [p_text(one.holm) for one in ones]),
        (answer, "hits", [f"{one.counts.hits}/{one.counts.signals}" for one in ones]),
        (answer, "f.a.", [f"{one.counts.false_alarms}/{one.counts.noises}" for one in ones]),
    ]
    for rule in task.rules:
        found += _rule_columns(ones, rule, task.level)
    return found


def _rule_columns(ones: Sequence[SubjectResult], rule: str, level: float) -> list[Column]:
    d = [one.of_rule(rule) for one in ones]
    group = f"d', {rule}"
    return [
        (group, "d'", [number(one.estimate) for one in d]),
        (group, f"{100 * level:g} %", [interval_text(one.interval) for one in d]),
        (group, "s.e.", ["" if one.standard_error is None else number(one.standard_error) for one in d]),
        (group, "criterion", [number(one.criterion) for one in d]),
        (group, "corrected", [number(one.corrected) for one in d]),
    ]


def group_lines(task: ScoredTask) -> list[str]:
    """Of the group, the subject as the unit."""
    if task.score is None:
        lines = ["one subject: nothing is said of a group"]
    else:
        lines = str(task.score).splitlines()
    for group in task.group_d_prime:
        lines += str(group).splitlines()
    for test in task.equivalence:
        lines += str(test).splitlines()
    return lines


def check_lines(task: ScoredTask) -> list[str]:
    """The pair checks: of each, the subject with the smallest p."""
    return []


def table_lines(found: Sequence[Column]) -> list[str]:
    """Columns aligned under their heads; a head over those that belong together."""
    widths = [max(len(head), *map(len, cells), 1) for _, head, cells in found]
    rows = list(zip(*(cells for *_, cells in found), strict=True))
    above, column = "", 0
    while column < len(found):
        group, last = found[column][0], column
        while last + 1 < len(found) and group and found[last + 1][0] == group:
            last += 1
        room = sum(widths[column : last + 1]) + 2 * (last - column)
        if len(group) > room:
            widths[last] += len(group) - room
            room = len(group)
        above += group.center(room, "-" if group else " ") + "  "
        column = last + 1
    lines = [above.rstrip()] if above.strip() else []
    for row in ([head for _, head, _ in found], *rows):
        lines.append("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return lines


def table_html(found: Sequence[Column]) -> str:
    """The same for notebooks."""
    heads = "".join(f"<th>{escape(f'{group}: {head}' if group else head)}</th>" for group, head, _ in found)
    rows = zip(*(cells for *_, cells in found), strict=True)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"


def task_html(task: ScoredTask) -> str:
    """The report of a task for notebooks."""
    warned = "".join(f"<p><b>{escape(text)}</b></p>" for text in warnings(task))
    if not task.subjects:
        return f"<h4>{escape(heading(task))}</h4>{warned}"
    said = _paragraphs([*group_lines(task), *check_lines(task)])
    return f"<h4>{escape(heading(task))}</h4>{warned}{table_html(columns(task))}{said}"


def _paragraphs(lines: Iterable[str]) -> str:
    return "<pre>" + escape("\n".join(lines)) + "</pre>"


def number(value: float) -> str:
    """Two decimals; inf and nothing as words."""
    return "" if math.isnan(value) else "inf" if math.isinf(value) and value > 0 else f"{value:.2f}"


def interval_text(ends: tuple[float, float]) -> str:
    """Closed, or open above."""
    low, high = ends
    return f"[{low:.2f}, inf)" if math.isinf(high) else f"[{low:.2f}, {high:.2f}]"


def p_text(p: float) -> str:
    """Two digits; small ones in powers of ten."""
    return f"{p:.2g}" if p >= 1e-4 else f"{p:.0e}"
