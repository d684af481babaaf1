"""One row a subject and task, for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from burrlab.psychophysics.report.report_table import tsv_text
from burrlab.psychophysics.report.subject_result import SubjectResult
from burrlab.psychophysics.report.threshold_task import SubjectThreshold

if TYPE_CHECKING:
    from burrlab.psychophysics.report.analysis_result import Analysis


def text(analysis: Analysis) -> str:
    """See `Analysis.to_tsv`."""
    rows = [
        {"task": task.name, "design": task.design.get("design", task.task), **_fields(one)}
        for task in analysis.tasks
        for one in task.subjects
    ]
    rows.sort(key=lambda row: "threshold" in row)  # columns of scores first; the order within is kept
    columns = list(dict.fromkeys(column for row in rows for column in row))
    lines = [columns, *([tsv_text(row.get(column)) for column in columns] for row in rows)]
    return "".join("\t".join(line) + "\n" for line in lines)


def _fields(one: SubjectResult | SubjectThreshold) -> dict[str, Any]:
    found: dict[str, Any] = {
        "subject": one.subject,
        "simulated": "yes" if one.simulated else "no",
        "trials": one.trials,
        "planned": one.planned,
    }
    if isinstance(one, SubjectThreshold):
        low, high = one.interval or (None, None)
        return found | {"threshold": one.threshold, "threshold_low": low, "threshold_high": high}
    c = one.counts
    found |= {
        "score": c.score, "hits": c.hits, "signals": c.signals, "false_alarms": c.false_alarms, "noises": c.noises,
        "proportion_low": one.score_interval[0], "proportion_high": one.score_interval[1],
        "p_value": one.p_value, "p_holm": one.holm,
    }  # fmt: skip
    for d in one.d_prime:
        name = f"d_prime_{d.rule.replace('-', '_')}"
        found |= {
            name: d.estimate, f"{name}_low": d.interval[0], f"{name}_high": d.interval[1],
            f"{name}_standard_error": d.standard_error, f"{name}_criterion": d.criterion, f"{name}_corrected": d.corrected,
        }  # fmt: skip
    return found
