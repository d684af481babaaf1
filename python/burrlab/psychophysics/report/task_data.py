"""Answers of a task, subject by subject, as an analysis takes them in."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, cast

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.experiment.answers import Answers
from burrlab.psychophysics.rules import TaskName

#: Subject -> counts, or task -> subject -> counts.
CountsBySubject: TypeAlias = Mapping[str, Counts | Answers]
CountsByTask: TypeAlias = Mapping[str, CountsBySubject]

#: Told of task and subject as an analysis comes to them.
Progress: TypeAlias = Callable[[str, str], object]

_OF = re.compile(r"\bbest (\d+) of (\d+)\b", re.IGNORECASE)


@dataclass(frozen=True)
class SubjectData:
    """Main trials of one subject in one task.

    Attributes
    ----------
    subject : str
    counts : Counts or None
        None before the first answer.
    planned : int or None
        Main trials of the design; None where it is not known, or the answers decide.
    simulated : bool
    levels : tuple of (float, int, int)
        Level, correct answers, trials, by level: of tasks that vary a parameter.
    answers : Answers or None
        Where the counts are from.
    """

    subject: str
    counts: Counts | None
    planned: int | None = None
    simulated: bool = False
    levels: tuple[tuple[float, int, int], ...] = ()
    answers: Answers | None = field(default=None, compare=False)

    @property
    def trials(self) -> int:
        """Answered."""
        return 0 if self.counts is None else self.counts.trials

    @property
    def complete(self) -> bool:
        """Whether all planned trials were answered."""
        return self.trials > 0 and (self.planned is None or self.trials >= self.planned)


@dataclass(frozen=True)
class TaskData:
    """A task and those who did it.

    Attributes
    ----------
    name : str
    task : {"same-different", "abx", "2ifc"}
    subjects : tuple of SubjectData
    design : mapping
        As `Design.to_dict` has it; empty where the counts came alone.
    of : int
        Subjects that those here were selected from; 0 without selection.
    selected_by : str
        What they were selected by, if that is known.
    chosen : int
        Subjects that were selected, where more were than did the task so far; 0: those here.
    """

    name: str
    task: TaskName
    subjects: tuple[SubjectData, ...]
    design: Mapping[str, Any] = field(default_factory=dict)
    of: int = 0
    selected_by: str = ""
    chosen: int = 0

    def select(self, subjects: Sequence[str] | None, pool: int, by: str) -> TaskData:
        """Those of these subjects, by default all, who did the task; `pool` as `of`, where it is known."""
        kept = tuple(one for one in self.subjects if subjects is None or one.subject in subjects)
        several = len(kept) < len(self.subjects)
        of = pool or self.of or (len(self.subjects) if several else 0)
        # Some of those who were selected are no smaller selection of the same number.
        chosen = (self.chosen or len(self.subjects)) if self.of and not pool else 0
        return replace(
            self,
            subjects=kept,
            of=of if of > len(kept) else 0,
            selected_by=by or self.selected_by,
            chosen=chosen,
        )


def of_answers(found: Iterable[Answers]) -> list[TaskData]:
    """The tasks in files of answers, in the order in which they come.

    Raises
    ------
    ValueError
        If one task is of two kinds or designs, or a subject has it twice.
    TypeError
        If something else is among them.
    """
    tasks: dict[str, TaskData] = {}
    for one in found:
        if not isinstance(one, Answers):
            raise TypeError(
                f"data must hold Answers, or be a mapping of subjects to Counts, got {type(one).__name__}"
            )
        design = {} if one.side_car is None else dict(one.side_car.design)
        new = TaskData(one.name, one.task, (), design)
        task = tasks.setdefault(one.name, new)
        if (task.task, task.design) != (new.task, new.design):
            raise ValueError(
                f"task {one.name} of subject {one.subject} has another design than that of subject {task.subjects[0].subject}"
            )
        if any(other.subject == one.subject for other in task.subjects):
            raise ValueError(f"subject {one.subject} has task {one.name} twice")
        tasks[one.name] = replace(task, subjects=(*task.subjects, _subject(one)))
    return list(tasks.values())


def of_counts(data: CountsBySubject | CountsByTask, *, simulated: bool = False) -> list[TaskData]:
    """The tasks in a mapping, by name.

    Raises
    ------
    ValueError
        If the mapping is empty, one task is of two kinds, or a name does not belong to its answers.
    TypeError
        If a value is neither Counts nor Answers.
    """
    if not data:
        raise ValueError("data must hold a subject, got none")
    if all(isinstance(value, Mapping) for value in data.values()):
        tasks = cast(CountsByTask, data)
        return [_of_one(str(name), subjects, simulated) for name, subjects in tasks.items()]
    return [_of_one("", cast(CountsBySubject, data), simulated)]


def _of_one(name: str, subjects: CountsBySubject, simulated: bool) -> TaskData:
    if not subjects:
        raise ValueError(f"task {name} must hold a subject, got none")
    found, designs, kinds = [], [], set()
    for subject, value in subjects.items():
        if isinstance(value, Answers):
            found.append(replace(_subject(value), subject=str(subject)))
            designs.append({} if value.side_car is None else dict(value.side_car.design))
        elif isinstance(value, Counts):
            found.append(SubjectData(str(subject), value, simulated=simulated))
        else:
            raise TypeError(f"subject {subject} must have Counts or Answers, got {type(value).__name__}")
        kinds.add(value.task)
    if len(kinds) > 1:
        raise ValueError(f"task {name} must be of one kind, got {', '.join(sorted(kinds))}")
    if any(design != designs[0] for design in designs):
        raise ValueError(f"task {name} must have one design, got several")
    (task,) = kinds
    return TaskData(name or task, task, tuple(found), designs[0] if designs else {})


def _subject(one: Answers) -> SubjectData:
    design = {} if one.side_car is None else one.side_car.design
    planned = None if one.trials is None else one.trials - int(design.get("practice", 0))
    by_level: dict[float, tuple[int, int]] = {}
    for row in one.main:
        if row.level is not None:
            correct, trials = by_level.get(row.level, (0, 0))
            by_level[row.level] = (correct + row.correct, trials + 1)
    levels = tuple((level, *by_level[level]) for level in sorted(by_level))
    return SubjectData(one.subject, one.counts() if one.main else None, planned, one.simulated, levels, one)


def with_selection(tasks: Iterable[TaskData], selected_by: Mapping[str, str]) -> list[TaskData]:
    """The same, with what participants were selected by, subject -> text.

    The protocol in the side-cars says how many they were selected from (`selected_from`), or else a text such as "best 12
    of 20" does.
    """
    found = []
    for task in tasks:
        texts = dict.fromkeys(selected_by.get(one.subject, "") for one in task.subjects)
        text = "; ".join(text for text in texts if text)
        numbers = _OF.search(text)
        chosen, of = (int(numbers[1]), int(numbers[2])) if numbers else (0, 0)
        chosen, of = _settled_selection(task) or (chosen, of)
        n = len(task.subjects)
        found.append(
            replace(task, selected_by=text, of=of if of > n else 0, chosen=chosen if n <= chosen < of else 0)
        )
    return found


def _settled_selection(task: TaskData) -> tuple[int, int] | None:
    """How many the protocol's subjects are, and of how many they were selected; None if it does not say."""
    found = []
    for one in task.subjects:
        car = None if one.answers is None else one.answers.side_car
        settled = {} if car is None else car.protocol.get("experiment", {})
        if (of := settled.get("selected_from")) is not None:
            found.append((len(settled["subjects"]), of))
    # Subjects may have been added while the experiment ran.
    return max(found, default=None)


def design_text(design: Mapping[str, Any]) -> str:
    """What is compared with what, how: one line; "" of no design."""
    mode = f", {design['mode']}" if "mode" in design else ""

    def name(part: str) -> str:
        return str(design[part]["name"])

    kind = design.get("design")
    if kind == "same-different":
        return f"{name('a')} (A) against {name('b')} (B){mode}"
    if kind == "abx":
        match = "" if name("match") == name("reference") else f", match {name('match')}"
        return f"reference {name('reference')}{match}, foil {name('foil')}{mode}"
    if "parameter" in design and "reference" in design:
        return f"{design['parameter']} around {name('reference')}{mode}"
    return ""


def left_out_text(one: SubjectData) -> str:
    """A subject with how far the run came."""
    if one.trials == 0:
        return f"{one.subject} (none of the main trials)"
    return f"{one.subject} ({one.trials} of {one.planned} trials)"


def told(task: str, progress: Progress | None) -> Callable[[str], None]:
    """Tells of the subjects of a task, if anybody wants to know."""

    def tell(subject: str) -> None:
        if progress is not None:
            progress(task, subject)

    return tell
