"""Analysis of an experiment's answers, with reports, JSON and tables for other programs."""

import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, ClassVar, Self, TypeAlias, cast

import scipy

from burrlab.common.check import refuse, shown
from burrlab.common.files import write_text
from burrlab.common.provenance import provenance
from burrlab.common.records import Codec, InJson
from burrlab.common.table import (
    NOTHING,
    ReportColumn,
    ReportInHtml,
    interval_text,
    json_mapping,
    p_text,
    probability_text,
    tables_lines,
    tsv_text,
    two_decimals,
    wrapped_lines,
)
from burrlab.psychophysics.answers import Answers, ExperimentFolder, read_folder, reference_of
from burrlab.psychophysics.designs import PARAMETER_KEYS
from burrlab.psychophysics.protocol import AnalysisSettings, Protocol
from burrlab.psychophysics.rules import COUNTED, Counts, rule_of
from burrlab.psychophysics.sensitivity import DPrime, below_chance
from burrlab.psychophysics.side_car import TOO_FAST, AnswerRow
from burrlab.psychophysics.task_results import (
    CountsBySubject,
    CountsByTask,
    Progress,
    ScoredTask,
    SubjectData,
    SubjectResult,
    SubjectThreshold,
    TaskData,
    ThresholdTask,
    design_text,
)
from burrlab.psychophysics.weber import SensitivityFunction, WeberFraction, usable

Task: TypeAlias = ScoredTask | ThresholdTask


def heading(task: Task) -> str:
    """The heading of a task: name, kind, comparison, trials, chance."""
    kind = task.design.get("design", task.task)
    parts = [f"{task.name}: {kind}" if task.name != kind else str(kind), design_text(task.design)]
    if isinstance(task, ThresholdTask):
        parts += [f"chance {task.chance:g}", str(task.design.get("held", ""))]
    elif task.trials:
        parts.append(f"{task.trials} trials, chance {task.chance * task.trials:g}")
    elif task.subjects:
        parts.append(f"trials differ between subjects, chance {task.chance:g}")
    return ", ".join(filter(None, parts))


def warnings(task: Task) -> list[str]:
    """Warnings that stand above the numbers."""
    partly = ", ".join(
        f"{x.subject} ({x.trials} of {x.planned} trials)" for x in task.subjects if not x.complete
    )
    unequal = ", ".join(
        x.subject
        for x in task.subjects
        if isinstance(x, SubjectResult) and x.counts.signals != x.counts.noises
    )
    return list(filter(None, (
        "SIMULATED SUBJECTS: nobody felt anything" * task.simulated,
        *(_selection(task) if task.selected else ()),
        f"left out, as trials are missing: {', '.join(task.left_out)}" * bool(task.left_out),
        f"incomplete, and taken in on request: {partly}" * bool(partly),
        "no complete run" * (not task.subjects),
        f"the two kinds of trials are not equally many for {unequal}: a habit of answering alters the score"
        * bool(unequal),
    )))  # fmt: skip


def _selection(task: Task) -> list[str]:
    """Lines on what the selection of subjects does to the results."""
    n, by = len(task.subjects), f" ({task.selected_by})" if task.selected_by else ""
    here = "" if n == task.chosen else f", of whom {n} are here"
    whom = (
        f"{task.chosen} of {task.of} subjects{here}" if task.of else f"{n} subjects, of how many is not known"
    )
    lines = [f"SELECTED{by}: {whom}. Others may differ, and p values and intervals below do not allow for it"]
    if isinstance(task, ScoredTask) and task.score is not None and (effect := task.selection) is not None:
        mean = task.score.mean
        # The probability is for the mean of all selected subjects.
        as_good = "" if here else f", and {mean:.2f} or more with {probability_text(effect.p_value(mean))}"
        lines.append(
            f"if selected by this very score: the best {task.chosen} of {task.of} guessing have "
            f"{effect.expected:.2f} of {effect.trials} on average, {effect.excess:.2f} above chance{as_good}"
        )
    return lines


def columns(task: Task) -> list[ReportColumn]:
    """Columns of the table of subjects."""
    listing: list[ReportColumn] = [("", "subject", [subject.subject for subject in task.subjects])]
    percent = f"{100 * task.level:g} %"
    if isinstance(task, ThresholdTask):
        listing += [
            ("", name or percent, list(map(cell, task.subjects))) for name, cell in _THRESHOLD_CELLS.items()
        ]
        return listing if any(listing[-1][2]) else listing[:-1]
    listing += [
        (group.format(COUNTED[task.task]), name, list(map(cell, task.subjects)))
        for group, name, cell in _SCORE_CELLS
    ]
    listing += [
        (f"d', {rule}", name or percent, [cell(subject.of_rule(rule)) for subject in task.subjects])
        for rule in task.rules for name, cell in _D_PRIME_CELLS.items()
    ]  # fmt: skip
    return listing


#: Columns of thresholds. The column without a name is the interval, which is left out if nobody has one.
_THRESHOLD_CELLS: Mapping[str, Callable[[SubjectThreshold], str]] = {
    "trials": lambda subject: str(subject.trials),
    "threshold": lambda subject: "" if subject.threshold is None else f"{subject.threshold:.3f}",
    "": lambda subject: "" if subject.interval is None else "{:.3f} to {:.3f}".format(*subject.interval),
}
#: Columns of scores: group, name, cell. {} is the answer that is counted.
_SCORE_CELLS: tuple[tuple[str, str, Callable[[SubjectResult], str]], ...] = (
    ("", "score", lambda subject: f"{subject.counts.score}/{subject.counts.trials}"),
    ("binomial", "p", lambda subject: p_text(subject.p_value)),
    ("binomial", "Holm", lambda subject: p_text(subject.holm)),
    ('"{}"', "hits", lambda subject: f"{subject.counts.hits}/{subject.counts.signals}"),
    ('"{}"', "f.a.", lambda subject: f"{subject.counts.false_alarms}/{subject.counts.noises}"),
)
#: Columns of d' by one rule. The column without a name is the interval.
_D_PRIME_CELLS: Mapping[str, Callable[[DPrime], str]] = {
    "d'": lambda d: two_decimals(d.estimate),
    "": lambda d: "unknown" if d.undetermined else interval_text(d.interval),
    "s.e.": lambda d: "" if d.standard_error is None else two_decimals(d.standard_error),
    "crit.": lambda d: two_decimals(d.criterion),
    "corr.": lambda d: two_decimals(d.corrected),
}


def legend(task: Task) -> list[str]:
    """Explanations of the columns."""
    if isinstance(task, ThresholdTask):
        return ["threshold: ratio of the comparison's parameter to the reference's"]
    d_primes = task.subjects[0].d_prime
    return [
        "p: exact binomial test of the score against chance, one-sided; Holm: the same, corrected for all "
        "subjects of the task",
        f"d': of greatest likelihood, with its {d_primes[0].method} interval on [0, inf), open where the "
        "answers set no upper limit; s.e. only where 0 is excluded",
        "corr.: d' after half an answer more in each cell (log-linear), which is finite also after perfect answers",
        *(f"crit., {d.rule}: {d.criterion_meaning}" for d in d_primes),
    ]


def group_lines(task: Task) -> list[str]:
    """Results of the group, with the subject as the unit."""
    if isinstance(task, ThresholdTask):
        return _threshold_lines(task)
    lines = ["One subject: nothing is said of a group."] if task.score is None else [str(task.score)]
    if task.score is not None and task.score.interval is not None:
        lines.append(
            f"mean score, {100 * task.level:g} %: " + "{:.2f} to {:.2f}".format(*task.score.interval)
        )
    lines += [
        f"{x.subject}: {below}"
        for x in task.subjects
        if (below := below_chance(x.counts.score, x.counts.trials))
    ]
    lines += [
        line
        for part in (*task.group_d_prime, *task.equivalence, *task.checks)
        for line in str(part).splitlines()
    ]
    for place in range(len(task.checks)):
        checked = [(subject.subject, subject.checks[place]) for subject in task.subjects if subject.checks]
        name, check = min(checked, key=lambda pair: pair[1].p_value)
        if check.p_value <= 0.05:
            lines.append(f"subject {name}: {check} (smallest of {len(task.subjects)} subjects)")
    return lines


def _threshold_lines(task: ThresholdTask) -> list[str]:
    lines = [f"{subject.subject}: {line}" for subject in task.subjects for line in subject.said.splitlines()]
    for subject in task.subjects if not any(subject.threshold for subject in task.subjects) else ():
        shares = ", ".join(f"{correct}/{trials} at {level:g}" for level, correct, trials in subject.levels)
        lines.append(f"{subject.subject}: {shares}")
    for subject in task.subjects:
        if clipped := sum(trials for _, _, trials in subject.clipped):
            lines.append(
                f"{subject.subject}: limits shortened the force in {clipped} trials, which Weber fractions leave out"
            )
        if subject.catch is not None:
            easy, right, caught = subject.catch
            share = scipy.stats.binomtest(right, caught).proportion_ci(task.level)
            low, high = (min(2.0 * (1.0 - end), 1.0) for end in (share.high, share.low))
            lines.append(
                f"{subject.subject}: {right} of {caught} catch trials right, so lapses (random answers) in {100 * low:.0f} to "
                f"{100 * high:.0f} %, if a ratio of {easy:g} is felt"
                f"{', and more than the 10 % that thresholds at 75 % allow for' * (low > 0.1)}"
            )
    if (group := task.group_threshold) is not None:
        end = f"{group[2]:.3f}" if 0.0 < group[2] < math.inf else "no end, as the subjects differ much"
        lines.append(
            f"group: {group[0]:.3f}, {100 * task.level:g} % {group[1]:.3f} to {end} (geometric mean of |ln ratio|, by t, "
            "the subject as the unit)"
        )
        if without := sum(subject.threshold in (None, 1.0) for subject in task.subjects):
            lines.append(
                f"The group is without {without} of {len(task.subjects)} subjects, who have no threshold (who never errs has "
                "none): it may be too large or too small."
            )
        if any(subject.open for subject in task.subjects):
            lines.append(
                "Some of these thresholds may lie beyond the levels: then that of the group and its interval are wrong."
            )
    return lines


def _fields(subject: SubjectResult | SubjectThreshold) -> dict[str, Any]:
    fields: dict[str, Any] = {
        "subject": subject.subject, "simulated": "yes" if subject.simulated else "no", "trials": subject.trials,
        "planned": subject.planned,
    }  # fmt: skip
    if isinstance(subject, SubjectThreshold):
        low, high = subject.interval or (None, None)
        return fields | {"threshold": subject.threshold, "threshold_low": low, "threshold_high": high}
    fields |= {
        **{name: getattr(subject.counts, name) for name in ("score", "hits", "signals", "false_alarms", "noises")},
        "proportion_low": subject.score_interval[0], "proportion_high": subject.score_interval[1],
        "p_value": subject.p_value, "p_holm": subject.holm,
    }  # fmt: skip
    for d in subject.d_prime:
        name = f"d_prime_{d.rule.replace('-', '_')}"
        fields |= {
            name: d.estimate, f"{name}_low": d.interval[0], f"{name}_high": d.interval[1],
            **{f"{name}_{part}": getattr(d, part) for part in ("standard_error", "criterion", "corrected")},
        }  # fmt: skip
    return fields


def write_rows(file: str | os.PathLike[str] | IO[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes tab-separated rows under the names of all their columns: n/a for no value, inf for an open end."""
    names = list(dict.fromkeys(column for row in rows for column in row))
    lines = [names, *([tsv_text(row.get(column)) for column in names] for row in rows)]
    write_text(file, "".join("\t".join(line) + "\n" for line in lines))


_KIND = "burrlab analysis"
FORMAT = 1


@dataclass(frozen=True, repr=False, eq=False)
class Analysis(ReportInHtml, InJson):
    """The results of an experiment, made by `analyse`.

    Attributes
    ----------
    name : str
        Name of the experiment.
    tasks : tuple of ScoredTask and ThresholdTask
    notes : tuple of str
        Lines of the report above the tasks.
    provenance : mapping
        Versions and settings.
    """

    _codec: ClassVar[Codec] = Codec("spelt")

    name: str
    tasks: tuple[ScoredTask | ThresholdTask, ...]
    notes: tuple[str, ...]
    provenance: Mapping[str, Any]

    def __getitem__(self, name: str) -> ScoredTask | ThresholdTask:
        """A task by its name.

        Raises
        ------
        KeyError
            If no task has this name.
        """
        tasks = {task.name: task for task in self.tasks}
        refuse(name not in tasks, f"task must be one of {', '.join(tasks)}, got {name!r}", KeyError)
        return tasks[name]

    @property
    def simulated(self) -> bool:
        """Whether any subject is simulated."""
        return any(task.simulated for task in self.tasks)

    def sensitivity_functions(self) -> tuple[SensitivityFunction, ...]:
        """Weber fractions along the references of tasks that vary one parameter in one way; often none.

        Every threshold is fitted anew to all trials, at 75 % correct, whatever the design; without those that
        the device could not render (`clipped`), which a line of the report counts. Days on which a
        subject's runs began are sessions. Above and below the references there are functions of their own. So there
        are for tasks along different directions, or around materials of different c_e or alpha.
        """
        return tuple(
            SensitivityFunction.of(fractions, parameter, name=name, level=self.tasks[0].level)
            for (parameter, name), fractions in self._weber_fractions().items()
            if usable(fractions)
        )

    def _weber_fractions(self) -> dict[tuple[str, str], list[WeberFraction]]:
        """Fractions by parameter and by what was varied, in words."""
        rows: dict[tuple[str, str], list[WeberFraction]] = {}
        for task in self.tasks:
            if not isinstance(task, ThresholdTask) or (reference := reference_of(task.design)) is None:
                continue
            parameter, design = task.design["parameter"], task.design
            held = ", sinking speed held" * (design.get("hold") == "sinking speed")
            if "boundary_mm" in design:
                held += " below a boundary at {:g} to {:g} mm".format(*design["boundary_mm"])
                held += ", the foil in the middle" * (design.get("foil") == "middle")
            held += _apart(task, self.tasks)
            for subject in task.subjects:
                days = sorted({run.day for each in self.tasks if isinstance(each, ThresholdTask)
                               for run in each.subjects if run.subject == subject.subject})  # fmt: skip
                for side in ("above", "below"):
                    levels = [row for row in subject.rendered() if (row[0] > 1.0) == (side == "above")]
                    if levels:
                        name = f"{parameter} by {design['mode']}{held}, {side} the reference{', simulated subjects' * self.simulated}"
                        rows.setdefault((parameter, name), []).append(
                            WeberFraction.of_levels(
                                levels, subject=subject.subject, reference=reference, session=str(days.index(subject.day)),
                                force=subject.pressed,
                            )
                        )  # fmt: skip
        return rows

    def _sensitivity_lines(self) -> list[str]:
        """The functions and, for each two, whether their slopes differ; what has no function."""
        lines, functions = list[str](), self.sensitivity_functions()
        for i, function in enumerate(functions):
            lines += ["", *str(function).splitlines()]
            for other in functions[:i]:
                if function.lines.keys() & other.lines.keys():
                    lines.append(
                        f"its slope less that of {other.name}: {function.difference(other).against('')}"
                    )
        for (_, name), rows in self._weber_fractions().items():
            if len({row.reference for row in rows}) > 1 and not usable(rows):
                lines += ["", f"{name}: no function, as no subject has two thresholds within the levels"]
        return ["", "Sensitivity along the references", *lines] if lines else []

    def report(self, *, width: int | None = None) -> str:
        """The whole analysis as text.

        Parameters
        ----------
        width : int, optional
            Screen width in characters. Wider tables are split between groups of columns, and sentences
            between words. By default nothing is split.
        """
        name = f"Experiment {self.name}" if self.name else "Analysis"
        lines = wrapped_lines([name + ", SIMULATED SUBJECTS" * self.simulated, *self.notes], width)
        for task in self.tasks:
            lines += wrapped_lines(["", heading(task), *(f"  ! {line}" for line in warnings(task))], width)
            if task.subjects:
                sentences = [*(f"  {line}" for line in legend(task)), "", *group_lines(task)]
                lines += ["", *tables_lines(columns(task), width), *wrapped_lines(sentences, width)]
        lines += wrapped_lines(self._sensitivity_lines(), width)
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """A dict for JSON and `from_dict`. Infinite numbers, such as open ends, are spelt "inf"."""
        return {_KIND: FORMAT, **super().to_dict()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """The analysis that `to_dict` described.

        Raises
        ------
        ValueError
            If `values` is something else.
        """
        refuse(values.get(_KIND) != FORMAT, f"{_KIND!r} must be {FORMAT}, got {shown(values.get(_KIND))}")
        return super().from_dict(values)

    def to_tsv(self, file: str | os.PathLike[str] | IO[str]) -> None:
        """Writes tab-separated rows, one per subject and task: n/a for no value, inf for an open end."""
        write_rows(file, [
            {"task": task.name, "design": task.design.get("design", task.task), **_fields(subject)}
            for task in sorted(self.tasks, key=lambda task: isinstance(task, ThresholdTask))  # scores first
            for subject in task.subjects
        ])  # fmt: skip

    def __eq__(self, other: object) -> bool:
        # A criterion may be NaN, which differs from itself.
        return isinstance(other, Analysis) and self.to_dict() == other.to_dict()

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        kind = "simulated subjects, " * self.simulated
        tasks = ", ".join(f"{task.name} (n = {len(task.subjects)})" for task in self.tasks)
        return f"Analysis({self.name!r}, {kind}{tasks})" if self.name else f"Analysis({kind}{tasks})"


def _apart(task: ThresholdTask, tasks: Collection[Task]) -> str:
    """What tells a task's references from those of like tasks along another direction: the table's name."""
    held = {"c_e": "alpha", "alpha": "c_e"}[task.design["parameter"]]
    names, by_table = {other.name for other in tasks}, dict[str, list[str]]()
    for other in tasks:
        if isinstance(other, ThresholdTask) and _way(other.design) == _way(task.design):
            by_table.setdefault(_table_of(other.name, names), []).append(
                f"{other.design['reference'].get(PARAMETER_KEYS[held], 0.0):.9g}"
            )
    ways = [values for values in by_table.values() if len(values) > 1]  # a task alone is on all of them
    return f", {_table_of(task.name, names)}" * (len(ways) > 1 and len({x for way in ways for x in way}) > 1)


def _table_of(name: str, names: Collection[str]) -> str:
    """The table of a task, without its reference's number: of "way12" it is "way1", unless "way" has so many."""
    numbered = {
        int(name[place:]): name[:place]
        for place in range(1, len(name))
        if re.fullmatch("[1-9][0-9]*", name[place:], re.ASCII)
        and all(name[:place] + str(k) in names for k in range(1, int(name[place:])))
    }
    return numbered[max(numbered)] if numbered else name.rstrip("0123456789")


def _way(design: Mapping[str, Any]) -> tuple[Any, ...]:
    """How a design varies its parameter, whatever the reference."""
    return tuple(map(design.get, ("parameter", "mode", "hold", "boundary_mm", "foil")))


def analyse(
    data: Protocol | CountsBySubject | CountsByTask | Iterable[Answers] | str | os.PathLike[str],
    *,
    rules: Sequence[str] | None = None,
    delta: float | None = None,
    level: float | None = None,
    subjects: Sequence[str] | None = None,
    selected_from: int | None = None,
    selected_by: str = "",
    incomplete: bool = False,
    simulated: bool = False,
    progress: Progress | None = None,
) -> Analysis:
    """Analyse an experiment: each task, its subjects, and the group with the subject as the unit.

    Parameters
    ----------
    data : Protocol, path, answers, or mapping
        A protocol or its TOML file; a folder of answers; results of `read_answers`; or your own counts,
        subject -> Counts or task -> subject -> Counts.
    rules : sequence of str, optional
        Decision rules for d'; by default those of the protocol, or both.
    delta : float, optional
        d' below which two stimuli count as not told apart, for an equivalence test. It must be set before the
        answers are seen. By default the protocol's.
    level : float, optional
        Level of all intervals; by default the protocol's, or 0.95.
    subjects : sequence of str, optional
        Analyse only these subjects. The result says that they were selected.
    selected_from : int, optional
        Number of subjects from whom the analysed ones were selected.
    selected_by : str
        Criterion of the selection, such as "score of task 1".
    incomplete : bool
        Whether incomplete runs are included; otherwise they are only listed.
    simulated : bool
        Whether the subjects of your own counts are simulated. Files state this themselves.
    progress : callable, optional
        Called with the names of task and subject before each analysis, which takes up to a second, or two
        with a psychometric function.

    Returns
    -------
    Analysis

    Raises
    ------
    ValueError
        If a file is invalid (see `Protocol.read` and `read_answers`), there is no subject, a subject or rule
        is unknown, the level is not in [0.5, 1), delta is not above 0, or `selected_from` is too small.
    TypeError
        If `data` has another type, a subject has neither Counts nor Answers, or `subjects` is one string.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> from burrlab.psychophysics.rules import Counts
    >>> one, two = Counts("abx", 5, 5, 1, 5), Counts("abx", 4, 5, 0, 5)
    >>> analyse({"01": one, "02": two})
    Analysis(abx (n = 2))
    """
    if isinstance(data, (str, os.PathLike)) and (Path(data).suffix == ".toml" or Path(data).is_file()):
        data = Protocol.read(data)
    name, tasks = _experiment_of(data, simulated)
    refuse(not tasks, "data must hold answers, got none")
    settings, notes = AnalysisSettings(), list[str]()
    if isinstance(data, Protocol):
        settings, notes = data.analysis, list(_missing(data, tasks))
    refuse(rules is not None and not rules, "rules must hold one at least, got none")
    refuse(delta is not None and not 0.0 < delta < math.inf, f"delta must be a d' above 0, got {delta!r}")
    refuse(level is not None and not 0.5 <= level < 1.0, f"level must be in [0.5, 1), got {level!r}")
    given: dict[str, Any] = {
        "rules": rules and tuple(rule_of("same-different", rule).name for rule in dict.fromkeys(rules)),
        "delta": delta and float(delta),
        "level": level and float(level),
    }
    settings = replace(settings, **{name: value for name, value in given.items() if value is not None})
    notes += _notes_on_trials(tasks)
    if settings.delta is not None:
        notes.append(_origin_of_delta(settings.delta, data, tasks))
    options: dict[str, Any] = {
        "level": settings.level, "incomplete": incomplete, "progress": progress or (lambda task, subject: None),
    }  # fmt: skip
    results = tuple(
        ThresholdTask.of_data(task, **options)
        if any(subject.levels for subject in task.subjects)
        else ScoredTask.of_data(task, rules=settings.rules, delta=settings.delta, **options)
        for task in [task.select(subjects, selected_from, selected_by) for task in tasks]
    )
    return Analysis(name, results, tuple(notes), json_mapping(provenance(
        rules=list(settings.rules), delta=settings.delta, level=settings.level,
        subjects=None if subjects is None else list(subjects), incomplete=incomplete,
    )))  # fmt: skip


def _missing(protocol: Protocol, tasks: Sequence[TaskData]) -> list[str]:
    """Notes on tasks that subjects have not begun, and on answers that the protocol does not name."""
    present = {task.name: [subject_data.subject for subject_data in task.subjects] for task in tasks}
    notes = [
        f"No run of {name} yet: {', '.join(absent)}."
        for name in protocol.tasks
        if (absent := [subject for subject in protocol.subjects if subject not in present.get(name, ())])
    ]
    for name, subjects in present.items():
        if name not in protocol.tasks:
            notes.append(f"Task {name} is in the folder and not in the protocol.")
        elif others := [subject for subject in subjects if subject not in protocol.subjects]:
            notes.append(f"In the folder and not in the protocol, of {name}: {', '.join(others)}.")
    return notes


def _origin_of_delta(delta: float, data: object, tasks: Sequence[TaskData]) -> str:
    """A note on whether delta was set before the runs began, by the protocol in each run's side-car."""
    counts = "it counts only if it was set before the answers were seen"
    if not isinstance(data, Protocol) or delta != data.analysis.delta:
        return f"Delta = {delta:g}, given to the analysis: {counts}."
    before: dict[str, list[str]] = {}
    for task in tasks:
        for subject in task.subjects:
            if (was := subject.protocol.get("analysis", {}).get("delta")) != delta:
                before.setdefault("none" if was is None else f"{was:g}", []).append(
                    f"{subject.subject} of {task.name}"
                )
    if not before:
        return f"Delta = {delta:g}, as the protocol has it."
    changed = "; ".join(f"{was} when {', '.join(runs)} began" for was, runs in before.items())
    return f"Delta = {delta:g}, as the protocol has it now, and it was {changed}: {counts}."


def _experiment_of(data: Any, simulated: bool) -> tuple[str, list[TaskData]]:
    """The experiment's name, empty for answers or counts, and its tasks."""
    if not isinstance(data, (Protocol, str, os.PathLike)):
        refuse(
            isinstance(data, Counts) or not isinstance(data, Iterable),
            f"data must be a protocol, a path, answers, or counts by subject, got {type(data).__name__}",
            TypeError,
        )
        return "", _tasks_of(data, simulated=simulated)
    folder = data.folder if isinstance(data, Protocol) else Path(data)
    selected_by = {
        subject: row["selected_by"]
        for subject, row in ExperimentFolder(folder, "").participants().items()
        if row.get("selected_by", NOTHING) != NOTHING
    }
    tasks = [_with_selection(task, selected_by) for task in _tasks_of(read_folder(folder))]
    if isinstance(data, Protocol):
        return data.name, sorted(tasks, key=lambda task: (*data.tasks, task.name).index(task.name))
    return folder.resolve().name, tasks


def _tasks_of(
    runs: Iterable[Answers] | CountsBySubject | CountsByTask, *, simulated: bool = False
) -> list[TaskData]:
    """The tasks in answers, in order of appearance, or in a mapping, by name.

    Raises
    ------
    ValueError
        If there is no subject, a task has two kinds or designs, or a subject has it twice.
    TypeError
        If an item is neither Answers nor, in a mapping, Counts.
    """
    by_task: dict[str, dict[str, Counts | Answers]] = {}
    if isinstance(runs, Mapping):
        refuse(not runs, "data must hold a subject, got none")
        nested = all(isinstance(subjects, Mapping) for subjects in runs.values())
        by_task = cast(Any, runs if nested else {"": runs})
    for answers in () if isinstance(runs, Mapping) else runs:
        refuse(
            not isinstance(answers, Answers),
            f"data must hold Answers, or be a mapping of subjects to Counts, got {type(answers).__name__}",
            TypeError,
        )
        subjects = by_task.setdefault(answers.name, {})
        refuse(answers.subject in subjects, f"subject {answers.subject} has task {answers.name} twice")
        subjects[answers.subject] = answers
    return [_task(str(name), subjects, simulated) for name, subjects in by_task.items()]


def _task(name: str, subjects: CountsBySubject, simulated: bool) -> TaskData:
    refuse(not subjects, f"task {name} must hold a subject, got none")
    for subject, source in subjects.items():
        refuse(
            not isinstance(source, (Counts, Answers)),
            f"subject {subject} must have Counts or Answers, got {type(source).__name__}",
            TypeError,
        )
    task, *others = dict.fromkeys(source.task for source in subjects.values())
    refuse(others, f"task {name} must be of one kind, got {', '.join(sorted([task, *others]))}")
    designs = {x: source.design for x, source in subjects.items() if isinstance(source, Answers)}
    first = next(iter(designs), "")
    for subject, design in designs.items():
        refuse(
            design != designs[first],
            f"task {name} of subject {subject} has another design than that of subject {first}",
        )
    group = [
        replace(SubjectData.of(source), subject=str(subject))
        if isinstance(source, Answers)
        else SubjectData(str(subject), None, simulated, source)
        for subject, source in subjects.items()
    ]
    without = [x.subject for x in group if x.counts and not x.levels]
    refuse(
        without and any(x.levels for x in group),
        f"task {name} has levels, and answers of subject {', '.join(without)} have none",
    )
    return TaskData(name or task, task, tuple(group), designs.get(first, {}))


def _with_selection(task: TaskData, selected_by: Mapping[str, str]) -> TaskData:
    """The task with the selection of its subjects; `selected_by` maps subject to text.

    The number of subjects before selection is `selected_from` of the protocol in the side-cars, or else part
    of a text such as "best 12 of 20".
    """
    texts = dict.fromkeys(selected_by.get(subject.subject, "") for subject in task.subjects)
    text = "; ".join(filter(None, texts))
    numbers = re.search(r"\bbest (\d+) of (\d+)\b", text, re.IGNORECASE)
    settings = [subject.protocol.get("experiment", {}) for subject in task.subjects]
    selections = [(len(x["subjects"]), x["selected_from"]) for x in settings if x.get("selected_from")]
    # Subjects may be added while the experiment runs.
    chosen, of = max(selections, default=(int(numbers[1]), int(numbers[2])) if numbers else (0, 0))
    n = len(task.subjects)
    return replace(task, selected_by=text, of=of if of > n else 0, chosen=chosen if n <= chosen < of else 0)


def _notes_on_trials(tasks: Iterable[TaskData]) -> list[str]:
    """Sentences on practice, on repeated trials and on answers that came too fast."""
    runs = [
        (f"{subject.subject} of {task.name}", subject.answers.rows)
        for task in tasks for subject in task.subjects if subject.answers
    ]  # fmt: skip
    notes = ["Practice trials are left out."] if runs else []
    counted: Mapping[str, Callable[[AnswerRow], int]] = {
        "Trials that were repeated, as the loop had stalled": lambda row: row.repeats or 0,
        "Trials left out, as the burr did not come to the boundary": lambda row: row.lost,
        f"Answers within {TOO_FAST:g} s of the question, too fast to have judged": (
            lambda row: row.response_time is not None and row.response_time < TOO_FAST
        ),
    }
    for what, count in counted.items():
        numbers = [(sum(map(count, rows)), run) for run, rows in runs]
        if concerned := ", ".join(f"{number} of {run}" for number, run in numbers if number):
            notes.append(f"{what}: {concerned}.")
    return notes
