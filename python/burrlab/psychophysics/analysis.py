"""From answers to what they say."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from burrlab.csv_text import plain as plain_json
from burrlab.provenance import provenance
from burrlab.psychophysics import report
from burrlab.psychophysics.answers import Answers, read_folder
from burrlab.psychophysics.records import plain, restored
from burrlab.psychophysics.rules import RULES, RuleName, rule_of
from burrlab.psychophysics.scored_task import ScoredTask
from burrlab.psychophysics.task_data import CountsBySubject, CountsByTask, TaskData, of_answers, of_counts

_KIND = "burrlab analysis"
FORMAT = 1


@dataclass(frozen=True, repr=False)
class Analysis:
    """The results of an experiment, made by `analyse`.

    Attributes
    ----------
    name : str
        Of the experiment.
    tasks : tuple of ScoredTask
    notes : tuple of str
        What is said above the tasks.
    provenance : mapping
        Versions and settings.
    """

    name: str
    tasks: tuple[ScoredTask, ...]
    notes: tuple[str, ...]
    provenance: Mapping[str, Any]

    def __getitem__(self, name: str) -> ScoredTask:
        """A task by its name.

        Raises
        ------
        KeyError
            If there is none.
        """
        for task in self.tasks:
            if task.name == name:
                return task
        raise KeyError(f"task must be one of {', '.join(task.name for task in self.tasks)}, got {name!r}")

    @property
    def simulated(self) -> bool:
        """Whether any subject was."""
        return any(task.simulated for task in self.tasks)

    def report(self) -> str:
        """All of it as text."""
        return report.text(self)

    def to_dict(self) -> dict[str, Any]:
        """For JSON and `from_dict`; infinite numbers, as the end of an open interval, are spelt "inf"."""
        return {_KIND: FORMAT, **plain(self)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """What `to_dict` gave.

        Raises
        ------
        ValueError
            If it is something else.
        """
        if values.get(_KIND) != FORMAT:
            raise ValueError(f"{_KIND!r} must be {FORMAT}, got {values.get(_KIND)!r}")
        return restored(cls, values)

    def to_json(self, file: str | os.PathLike[str] | IO[str]) -> None:
        """Write to a file that `from_json` reads back without loss."""
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        if isinstance(file, (str, os.PathLike)):
            Path(file).write_text(text, encoding="utf-8")
        else:
            file.write(text)

    @classmethod
    def from_json(cls, file: str | os.PathLike[str] | IO[str]) -> Self:
        """Read what `to_json` wrote.

        Raises
        ------
        ValueError
            If the file is something else.
        OSError
            If it cannot be read.
        """
        text = Path(file).read_text(encoding="utf-8") if isinstance(file, (str, os.PathLike)) else file.read()
        values = json.loads(text)
        if not isinstance(values, dict):
            raise ValueError(f"an analysis must be a JSON object, got {type(values).__name__}")
        return cls.from_dict(values)

    def to_tsv(self, file: str | os.PathLike[str] | IO[str]) -> None:
        """One row a subject and task, tab-separated; n/a for nothing, inf for an open end."""
        text = "".join("\t".join(row) + "\n" for row in report.subject_rows(self))
        if isinstance(file, (str, os.PathLike)):
            Path(file).write_text(text, encoding="utf-8")
        else:
            file.write(text)

    def __repr__(self) -> str:
        kind = "simulated subjects, " if self.simulated else ""
        tasks = ", ".join(f"{task.name} (n = {len(task.subjects)})" for task in self.tasks)
        return f"Analysis({self.name!r}, {kind}{tasks})" if self.name else f"Analysis({kind}{tasks})"

    def _repr_html_(self) -> str:
        return report.html(self)


def analyse(
    data: CountsBySubject | CountsByTask | Iterable[Answers] | str | os.PathLike[str],
    *,
    rules: Sequence[str] | None = None,
    delta: float | None = None,
    level: float | None = None,
    subjects: Sequence[str] | None = None,
    selected_from: int | None = None,
    selected_by: str = "",
    incomplete: bool = False,
    simulated: bool = False,
) -> Analysis:
    """Analyse an experiment, task by task, subject by subject and with the subject as the unit.

    Parameters
    ----------
    data : folder, answers, or mapping
        A folder of answers; what `read_answers` gave; or counts of one's own, subject -> Counts or task -> subject -> Counts.
    rules : sequence of str, optional
        Decision rules that d' is given under; by default both.
    delta : float, optional
        d' below which two stimuli count as not told apart, set before the answers were seen: asks for an equivalence test.
    level : float, optional
        Of all intervals; 0.95 by default.
    subjects : sequence of str, optional
        Only these. What was left out is said: a selection.
    selected_from : int, optional
        Number of subjects that those in `data` were selected from.
    selected_by : str
        What subjects were selected by, such as "score of task 1".
    incomplete : bool
        Whether runs that did not come to their end are taken in; else they are listed.
    simulated : bool
        Of counts of one's own: whether the subjects were simulated. Files say it themselves.

    Returns
    -------
    Analysis

    Raises
    ------
    ValueError
        If a file is not right (see `read_answers`), there is no subject, a subject, rule or level is unknown or out of
        range, or fewer than those there were selected from.
    TypeError
        If a subject has neither Counts nor Answers.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> from burrlab.psychophysics.counts import Counts
    >>> counts = {"01": Counts("abx", hits=5, signals=5, false_alarms=1, noises=5), "02": Counts("abx", hits=4, signals=5, false_alarms=0, noises=5)}
    >>> analyse(counts)
    Analysis(abx (n = 2))
    """
    if isinstance(data, (str, os.PathLike)):
        name, tasks = Path(data).name, of_answers(read_folder(data))
    elif isinstance(data, Mapping):
        name, tasks = "", of_counts(data, simulated=simulated)
    else:
        name, tasks = "", of_answers(data)
    return _analysis(
        name, tasks, rules=rules or RULES, delta=delta, level=0.95 if level is None else level, subjects=subjects,
        selected_from=selected_from, selected_by=selected_by, incomplete=incomplete, before="",
    )  # fmt: skip


def _analysis(
    name: str, tasks: Sequence[TaskData], *, rules: Sequence[str], delta: float | None, level: float,
    subjects: Sequence[str] | None, selected_from: int | None, selected_by: str, incomplete: bool, before: str,
) -> Analysis:  # fmt: skip
    if not tasks:
        raise ValueError("data must hold answers, got none")
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must be above 0 and below 1, got {level}")
    named: list[RuleName] = [rule_of(tasks[0].task, rule).name for rule in dict.fromkeys(rules)]
    tasks = [_selected(task, subjects, selected_from, selected_by) for task in tasks]
    settings = {
        "rules": named, "delta": delta, "level": level, "incomplete": incomplete,
        "subjects": None if subjects is None else list(subjects),
    }  # fmt: skip
    results = tuple(
        ScoredTask.of_data(task, rules=named, delta=delta, level=level, incomplete=incomplete)
        for task in tasks
    )
    notes = [
        "Practice trials are left out." if any(one.answers for task in tasks for one in task.subjects) else ""
    ]
    if delta is not None:
        notes.append(before or f"Delta = {delta:g} counts only if it was set before the answers were seen.")
    return Analysis(name, results, tuple(note for note in notes if note), plain_json(provenance(**settings)))


def _selected(
    task: TaskData, subjects: Sequence[str] | None, selected_from: int | None, selected_by: str
) -> TaskData:
    if subjects is not None:
        known = [one.subject for one in task.subjects]
        unknown = [name for name in subjects if name not in known]
        if unknown:
            raise ValueError(f"subjects must be of {', '.join(known)}, got {', '.join(unknown)}")
    if selected_from is not None and selected_from < len(task.subjects):
        raise ValueError(
            f"selected_from must be at least the {len(task.subjects)} subjects of task {task.name}, got {selected_from}"
        )
    return task.select(subjects, selected_from or 0, selected_by)
