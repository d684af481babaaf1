"""From answers to what they say."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from burrlab.csv_text import plain
from burrlab.provenance import provenance
from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.experiment.answer_reading import read_folder
from burrlab.psychophysics.experiment.answers import Answers
from burrlab.psychophysics.experiment.experiment_folder import ExperimentFolder
from burrlab.psychophysics.experiment.protocol import Protocol
from burrlab.psychophysics.experiment.protocol_tables import AnalysisSettings
from burrlab.psychophysics.experiment.tsv_text import NOTHING
from burrlab.psychophysics.report.analysis_result import Analysis
from burrlab.psychophysics.report.scored_task import ScoredTask
from burrlab.psychophysics.report.task_data import (
    CountsBySubject,
    CountsByTask,
    Progress,
    TaskData,
    of_answers,
    of_counts,
    with_selection,
)
from burrlab.psychophysics.report.threshold_task import ThresholdTask
from burrlab.psychophysics.rules import rule_of


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
    """Analyse an experiment, task by task, subject by subject and with the subject as the unit.

    Parameters
    ----------
    data : Protocol, path, answers, or mapping
        A protocol or its TOML file; a folder of answers; what `read_answers` gave; or counts of one's own,
        subject -> Counts or task -> subject -> Counts.
    rules : sequence of str, optional
        Decision rules that d' is given under; by default those of the protocol, or both.
    delta : float, optional
        d' below which two stimuli count as not told apart, set before the answers were seen: asks for an equivalence
        test. By default the protocol's.
    level : float, optional
        Of all intervals; by default the protocol's, or 0.95.
    subjects : sequence of str, optional
        Only these. That is a selection, and the result says so.
    selected_from : int, optional
        Number of subjects that those analysed were selected from.
    selected_by : str
        What they were selected by, such as "score of task 1".
    incomplete : bool
        Whether runs that did not come to their end are taken in; else they are listed.
    simulated : bool
        Of counts of one's own: whether the subjects were simulated. Files say it themselves.
    progress : callable, optional
        Called with the names of task and subject, as the analysis comes to each: a subject takes up to a second, or two with
        a psychometric function.

    Returns
    -------
    Analysis

    Raises
    ------
    ValueError
        If a file is not right (see `Protocol.read` and `read_answers`), there is no subject, a subject or rule is
        unknown, the level not in [0.5, 1), delta not above 0, or there are more subjects than they were selected from.
    TypeError
        If the data are none of these, a subject has neither Counts nor Answers, or subjects are one text.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> from burrlab.psychophysics.counts import Counts
    >>> one, two = Counts("abx", 5, 5, 1, 5), Counts("abx", 4, 5, 0, 5)
    >>> analyse({"01": one, "02": two})
    Analysis(abx (n = 2))
    """
    if isinstance(data, (str, os.PathLike)) and (Path(data).suffix == ".toml" or Path(data).is_file()):
        data = Protocol.read(data)
    settings, notes = AnalysisSettings(), []
    if isinstance(data, Protocol):
        settings = data.analysis
        name, tasks = data.name, _of_folder(data.folder)
        tasks.sort(key=lambda task: (*data.tasks, task.name).index(task.name))
        notes += _missing(data, tasks)
    elif isinstance(data, (str, os.PathLike)):
        name, tasks = Path(data).resolve().name, _of_folder(data)
    elif isinstance(data, Mapping):
        name, tasks = "", of_counts(data, simulated=simulated)
    elif isinstance(data, Counts) or not isinstance(data, Iterable):
        raise TypeError(
            f"data must be a protocol, a path, answers, or counts by subject, got {type(data).__name__}"
        )
    else:
        name, tasks = "", of_answers(data)
    if not tasks:
        raise ValueError("data must hold answers, got none")
    settings = _settled(settings, rules, delta, level)
    if any(one.answers for task in tasks for one in task.subjects):
        notes.append("Practice trials are left out.")
    runs = [(f"{one.subject} of {task.name}", one.answers) for task in tasks for one in task.subjects]
    repeats = [(sum(row.repeats or 0 for row in found.rows), run) for run, found in runs if found]
    if told := ", ".join(f"{count} of {run}" for count, run in repeats if count):
        notes.append(f"Trials that were repeated, as the loop had stalled: {told}.")
    if settings.delta is not None:
        notes.append(_origin_of_delta(settings.delta, data, tasks))
    chosen = [_selected(task, subjects, selected_from, selected_by) for task in tasks]
    made = provenance(
        rules=list(settings.rules), delta=settings.delta, level=settings.level,
        subjects=None if subjects is None else list(subjects), incomplete=incomplete,
    )  # fmt: skip
    results = tuple(_result(task, settings, incomplete, progress) for task in chosen)
    return Analysis(name, results, tuple(notes), plain(made))


def _of_folder(folder: str | os.PathLike[str]) -> list[TaskData]:
    entries = ExperimentFolder(folder, "").participants()
    by = {subject: entry.get("selected_by", NOTHING) for subject, entry in entries.items()}
    texts = {subject: text for subject, text in by.items() if text != NOTHING}
    return with_selection(of_answers(read_folder(folder)), texts)


def _missing(protocol: Protocol, tasks: Sequence[TaskData]) -> list[str]:
    """Who has not begun what, and what is there of others."""
    there = {task.name: {one.subject for one in task.subjects} for task in tasks}
    notes = []
    for name in protocol.tasks:
        absent = [subject for subject in protocol.subjects if subject not in there.get(name, ())]
        if absent:
            notes.append(f"No run of {name} yet: {', '.join(absent)}.")
    for task in tasks:
        others = [one.subject for one in task.subjects if one.subject not in protocol.subjects]
        if task.name not in protocol.tasks:
            notes.append(f"Task {task.name} is in the folder and not in the protocol.")
        elif others:
            notes.append(f"In the folder and not in the protocol, of {task.name}: {', '.join(others)}.")
    return notes


def _origin_of_delta(delta: float, data: object, tasks: Sequence[TaskData]) -> str:
    """Whether it was set before the runs began: each run's side-car has the protocol of that day."""
    counts = "it counts only if it was set before the answers were seen"
    if not isinstance(data, Protocol) or delta != data.analysis.delta:
        return f"Delta = {delta:g}, given to the analysis: {counts}."
    before: dict[str, list[str]] = {}
    for task in tasks:
        for one in task.subjects:
            car = None if one.answers is None else one.answers.side_car
            was = None if car is None else car.protocol.get("analysis", {}).get("delta")
            if was != delta:
                runs = before.setdefault("none" if was is None else f"{was:g}", [])
                runs.append(f"{one.subject} of {task.name}")
    if not before:
        return f"Delta = {delta:g}, as the protocol has it."
    changed = "; ".join(f"{was} when {', '.join(runs)} began" for was, runs in before.items())
    return f"Delta = {delta:g}, as the protocol has it now, and it was {changed}: {counts}."


def _settled(
    settings: AnalysisSettings, rules: Sequence[str] | None, delta: float | None, level: float | None
) -> AnalysisSettings:
    """Those of the protocol, with what was given in their place."""
    if rules is not None:
        if not rules:
            raise ValueError("rules must hold one at least, got none")
        named = tuple(rule_of("same-different", rule).name for rule in dict.fromkeys(rules))
        settings = replace(settings, rules=named)
    if delta is not None:
        if not 0.0 < delta < math.inf:
            raise ValueError(f"delta must be a d' above 0, got {delta!r}")
        settings = replace(settings, delta=float(delta))
    if level is not None:
        if not 0.5 <= level < 1.0:
            raise ValueError(f"level must be in [0.5, 1), got {level!r}")
        settings = replace(settings, level=float(level))
    return settings


def _selected(
    task: TaskData, subjects: Sequence[str] | None, selected_from: int | None, selected_by: str
) -> TaskData:
    known = [one.subject for one in task.subjects]
    if isinstance(subjects, str):
        raise TypeError(f"subjects must be a list of labels, such as [{subjects!r}], got {subjects!r}")
    unknown = [name for name in subjects or () if name not in known]
    if unknown or subjects == []:
        raise ValueError(f"subjects must be of {', '.join(known)}, got {', '.join(unknown) or 'none'}")
    chosen = task.select(subjects, selected_from or 0, selected_by)
    if selected_from is not None and selected_from < len(chosen.subjects):
        raise ValueError(
            f"selected_from must be at least the {len(chosen.subjects)} subjects of task {task.name}, got {selected_from}"
        )
    return chosen


def _result(
    task: TaskData, settings: AnalysisSettings, incomplete: bool, progress: Progress | None
) -> ScoredTask | ThresholdTask:
    if any(one.levels for one in task.subjects):
        return ThresholdTask.of_data(task, level=settings.level, incomplete=incomplete, progress=progress)
    return ScoredTask.of_data(
        task, rules=settings.rules, delta=settings.delta, level=settings.level, incomplete=incomplete,
        progress=progress,
    )  # fmt: skip
