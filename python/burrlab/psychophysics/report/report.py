"""An analysis in words and tables."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, TypeAlias

from burrlab.psychophysics.report.report_table import (
    Column,
    interval_text,
    number,
    p_text,
    table_html,
    tables_lines,
    wrapped_lines,
)
from burrlab.psychophysics.report.scored_task import CORRECTION, ScoredTask
from burrlab.psychophysics.report.task_data import design_text
from burrlab.psychophysics.report.threshold_task import ThresholdTask
from burrlab.psychophysics.statistics.subject_tests import probability_text

if TYPE_CHECKING:
    from burrlab.psychophysics.report.analysis_result import Analysis

Task: TypeAlias = ScoredTask | ThresholdTask

_COUNTED = {"same-different": '"different"', "abx": '"first"', "2ifc": '"first"'}
_CORRECTIONS = {"log-linear": "half an answer more in each cell (log-linear)"}


def text(analysis: Analysis, width: int | None = None) -> str:
    """See `Analysis.report`."""
    lines = wrapped_lines([head(analysis), *analysis.notes], width)
    for task in analysis.tasks:
        lines += wrapped_lines(["", heading(task), *(f"  ! {line}" for line in warnings(task))], width)
        if task.subjects:
            lines += ["", *tables_lines(columns(task), width)]
            lines += wrapped_lines([*(f"  {line}" for line in legend(task)), "", *group_lines(task)], width)
    return "\n".join(lines)


def html(analysis: Analysis) -> str:
    """The same for notebooks."""
    parts = [f"<h3>{escape(head(analysis))}</h3>", *(f"<p>{escape(line)}</p>" for line in analysis.notes)]
    for task in analysis.tasks:
        parts += [
            f"<h4>{escape(heading(task))}</h4>",
            *(f"<p><b>{escape(line)}</b></p>" for line in warnings(task)),
        ]
        if task.subjects:
            parts.append(table_html(columns(task)))
            parts.append(f"<p><small>{escape(' '.join(legend(task)))}</small></p>")
            parts += [f"<p>{escape(line)}</p>" for line in group_lines(task)]
    return "".join(parts)


def head(analysis: Analysis) -> str:
    name = f"Experiment {analysis.name}" if analysis.name else "Analysis"
    return f"{name}, SIMULATED SUBJECTS" if analysis.simulated else name


def heading(task: Task) -> str:
    """Name, kind, what is compared, trials, chance."""
    kind = task.design.get("design", task.task)
    parts = [f"{task.name}: {kind}" if task.name != kind else str(kind)]
    parts += [about] if (about := design_text(task.design)) else []
    if isinstance(task, ThresholdTask):
        parts.append(f"chance {task.chance:g}")
        parts += [str(task.design["held"])] if "held" in task.design else []
    elif task.trials:
        parts.append(f"{task.trials} trials, chance {task.chance * task.trials:g}")
    elif task.subjects:
        parts.append(f"trials differ between subjects, chance {task.chance:g}")
    return ", ".join(parts)


def warnings(task: Task) -> list[str]:
    """What a reader must know before the numbers."""
    found = ["SIMULATED SUBJECTS: nobody felt anything"] if task.simulated else []
    if task.selected:
        found += _selection(task)
    if task.left_out:
        found.append(f"left out, as their runs are incomplete: {', '.join(task.left_out)}")
    partly = [one for one in task.subjects if not one.complete]
    if partly:
        said = [f"{one.subject} ({one.trials} of {one.planned} trials)" for one in partly]
        found.append(f"incomplete, and taken in on request: {', '.join(said)}")
    if not task.subjects:
        found.append("no complete run")
    return found


def _selection(task: Task) -> list[str]:
    """What selection does to what is below."""
    n, by = len(task.subjects), f" ({task.selected_by})" if task.selected_by else ""
    partly = n != task.chosen
    whom = f"{n} subjects, of how many is not known"
    if task.of:
        whom = f"{task.chosen} of {task.of} subjects{f', of whom {n} are here' if partly else ''}"
    lines = [f"SELECTED{by}: {whom}. Others may differ, and p values and intervals below do not allow for it"]
    effect = task.selection if isinstance(task, ScoredTask) else None
    if effect is not None and isinstance(task, ScoredTask) and task.score is not None:
        mean = task.score.mean
        # The probability is that of a mean of all who were selected.
        as_good = "" if partly else f", and {mean:.2f} or more with {probability_text(effect.p_value(mean))}"
        lines.append(
            f"if selected by this very score: the best {task.chosen} of {task.of} guessing have {effect.expected:.2f} of "
            f"{effect.trials} on average, {effect.excess:.2f} above chance{as_good}"
        )
    return lines


def columns(task: Task) -> list[Column]:
    """The table of the subjects."""
    if isinstance(task, ThresholdTask):
        return _threshold_columns(task)
    ones, counted = task.subjects, _COUNTED[task.task]
    found: list[Column] = [
        ("", "subject", [one.subject for one in ones]),
        ("", "score", [f"{one.counts.score}/{one.counts.trials}" for one in ones]),
        ("binomial", "p", [p_text(one.p_value) for one in ones]),
        ("binomial", "Holm", [p_text(one.holm) for one in ones]),
        (counted, "hits", [f"{one.counts.hits}/{one.counts.signals}" for one in ones]),
        (counted, "f.a.", [f"{one.counts.false_alarms}/{one.counts.noises}" for one in ones]),
    ]
    for rule in task.rules:
        d, group = [one.of_rule(rule) for one in ones], f"d', {rule}"
        found += [
            (group, "d'", [number(one.estimate) for one in d]),
            (group, f"{100 * task.level:g} %", ["unknown" if one.undetermined else interval_text(one.interval) for one in d]),
            (group, "s.e.", ["" if one.standard_error is None else number(one.standard_error) for one in d]),
            (group, "crit.", [number(one.criterion) for one in d]),
            (group, "corr.", [number(one.corrected) for one in d]),
        ]  # fmt: skip
    return found


def _threshold_columns(task: ThresholdTask) -> list[Column]:
    thresholds = ["" if one.threshold is None else f"{one.threshold:.3f}" for one in task.subjects]
    found: list[Column] = [
        ("", "subject", [one.subject for one in task.subjects]),
        ("", "trials", [str(one.trials) for one in task.subjects]),
        ("", "threshold", thresholds),
    ]
    intervals = [
        "" if one.interval is None else "{:.3f} to {:.3f}".format(*one.interval) for one in task.subjects
    ]
    return [*found, ("", f"{100 * task.level:g} %", intervals)] if any(intervals) else found


def legend(task: Task) -> list[str]:
    """What the columns are."""
    if isinstance(task, ThresholdTask):
        return ["threshold: ratio of the comparison's parameter to the reference's"]
    method = task.subjects[0].d_prime[0].method
    lines = [
        "p: exact binomial test of the score against chance, one-sided; Holm: the same, corrected for all subjects of the task",
        f"d': of greatest likelihood, with its {method} interval on [0, inf), open where the answers set no upper limit; "
        "s.e. only where 0 is excluded",
        f"corr.: d' after {_CORRECTIONS[CORRECTION]}, which is finite also after perfect answers",
    ]
    lines += [f"crit., {one.rule}: {one.criterion_meaning}" for one in task.subjects[0].d_prime]
    return lines


def group_lines(task: Task) -> list[str]:
    """Of the group, the subject as the unit."""
    if isinstance(task, ThresholdTask):
        return _threshold_lines(task)
    lines = []
    if task.score is not None:
        lines += str(task.score).splitlines()
        if task.score.interval is not None:
            low, high = task.score.interval
            lines.append(f"mean score, {100 * task.level:g} %: {low:.2f} to {high:.2f}")
    else:
        lines.append("One subject: nothing is said of a group.")
    for part in (*task.group_d_prime, *task.equivalence, *task.checks):
        lines += str(part).splitlines()
    for place in range(len(task.checks)):
        single = min(task.subjects, key=lambda one: one.checks[place].p_value if one.checks else math.inf)
        if single.checks and single.checks[place].p_value <= 0.05:
            lines.append(
                f"subject {single.subject}: {single.checks[place]} (smallest of {len(task.subjects)} subjects)"
            )
    return lines


def _threshold_lines(task: ThresholdTask) -> list[str]:
    lines = [f"{one.subject}: {line}" for one in task.subjects for line in one.said.splitlines()]
    if not any(one.threshold for one in task.subjects):
        for one in task.subjects:
            shares = ", ".join(f"{correct}/{trials} at {level:g}" for level, correct, trials in one.levels)
            lines.append(f"{one.subject}: {shares}")
    if (group := task.group_threshold) is not None:
        lines.append(
            f"group: {group[0]:.3f}, {100 * task.level:g} % {group[1]:.3f} to {group[2]:.3f} (geometric mean of |ln ratio|, by t, "
            f"the subject as the unit)"
        )
    return lines
