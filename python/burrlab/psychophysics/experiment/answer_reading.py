"""Reading answers: one file, a folder, or what a resumed run goes on from."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from burrlab.psychophysics.design import Order
from burrlab.psychophysics.experiment import tsv_text
from burrlab.psychophysics.experiment.answer_row import (
    REQUIRED,
    Row,
    RowReader,
    columns_of,
)
from burrlab.psychophysics.experiment.answers import Answers
from burrlab.psychophysics.experiment.side_car import SideCar, read_side_car, side_car_path
from burrlab.psychophysics.rules import TASKS, TaskName
from burrlab.psychophysics.trial import Trial

_LABELS = re.compile(r"sub-([A-Za-z0-9]+)_(?:.*_)?task-([A-Za-z0-9]+)(?:_.*)?\.tsv")
_PARTICIPANT = "participant_id"


def read_answers(
    path: str | os.PathLike[str],
    *,
    task: str | None = None,
    answers: Sequence[str] | None = None,
    subject: str | None = None,
    name: str | None = None,
) -> Answers:
    """The answers in a TSV, of this program or another.

    Parameters
    ----------
    path : path
        Columns onset, duration [s], trial_type, response, correct (1 or 0), response_time [s] and trial; the others that
        this program writes may be missing. n/a where there is nothing.
    task : {"same-different", "abx", "2ifc"}, optional
        What the task is; by default as the side-car has it.
    answers : (str, str), optional
        What the file calls the answers, in the order "same", "different" or "first", "second"; by default these.
    subject, name : str, optional
        Labels of subject and task; by default as the side-car or the file's name, sub-LABEL_task-LABEL_..., has them.

    Returns
    -------
    Answers
        A last line without its end, from a run that was killed, is left out; the notes say so.

    Raises
    ------
    ValueError
        If the file is not text in UTF-8, is empty, lacks a column or has one that is unknown; a field is not what it
        must be; a trial is there twice, missing or out of order; a correct flag contradicts trial type and
        response; two subjects are in it; or what it must say is said neither there nor here: with the line where there is one.
    OSError
        If the file cannot be read.
    """
    file, content = os.fspath(path), Path(path).read_bytes()
    car = read_side_car(path)
    given = {"subject": subject, "name": name, "task": task}
    labels = _labels(file, car, given)
    if labels["task"] not in TASKS:
        raise ValueError(f"task must be one of {', '.join(TASKS)}, got {labels['task']!r}")
    if answers is not None and not (
        isinstance(answers, (list, tuple))
        and len(answers) == len(set(answers)) == 2
        and all(isinstance(one, str) for one in answers)
    ):
        raise ValueError(f"answers must be two that differ, in the order of their keys, got {answers!r}")
    if car is None:
        # Another program's last line may lack its end and be whole.
        rows, torn = read_rows(file, content, labels["task"], answers), b""
    else:
        rows, content, torn = read_own_rows(file, content, car.task)
        _check_stimuli(file, rows, car)
    notes = (f"the last line of {file} was broken off and is left out",) if torn else ()
    labels["subject"] = _one_subject(file, content, labels["subject"])
    return Answers(**labels, rows=tuple(row for _, row in rows), side_car=car, notes=notes, source=file)


def read_rows(
    file: str, content: bytes, task: TaskName, answers: Sequence[str] | None = None
) -> list[tuple[int, Row]]:
    """The checked rows of a file with their lines. See `read_answers`."""
    table = tsv_text.parse(file, content)
    known = (*columns_of(task), _PARTICIPANT)
    for column in table.columns:
        if column not in known:
            raise ValueError(f"{file}, line 1: unknown column {column!r}; known are {', '.join(known)}")
    for column in REQUIRED:
        if column not in table.columns:
            raise ValueError(f"{file}, line 1: column {column} is missing")
    reader, rows = RowReader(task, answers), []
    for number, fields in table.rows:
        try:
            row = reader.parse(fields)
        except ValueError as error:
            raise ValueError(f"{file}, line {number}, {error}") from None
        reader.add(number, row)
        rows.append((number, row))
    return rows


def read_own_rows(file: str, content: bytes, task: TaskName) -> tuple[list[tuple[int, Row]], bytes, bytes]:
    """The rows of a file of this program, the bytes that they stand in, and what was broken off behind them.

    A last line that lacks nothing but its end is whole: no ending of an interval begins another, and repeats, the last column, have one digit.
    """
    lines, torn = tsv_text.split_torn(content)
    rows = read_rows(file, lines, task)
    if torn:
        try:
            return read_rows(file, content + b"\n", task), content + b"\n", b""
        except ValueError:
            pass
    return rows, lines, torn


def _check_stimuli(file: str, rows: Sequence[tuple[int, Row]], car: SideCar) -> None:
    """That a trial's type says what its intervals were, where the type alone decides: each is written down twice."""
    names = {
        key: str(value["name"])
        for key, value in car.design.items()
        if isinstance(value, Mapping) and "name" in value
    }
    for line, row in rows:
        if car.task == "same-different":
            due = [names[letter.lower()] for letter in row.trial_type]
        elif car.task == "abx":
            due = [names["reference"], *(names[{"A": "match", "B": "foil"}[one]] for one in row.trial_type)]
        else:
            continue
        for place, (found, name) in enumerate(zip(row.stimuli, due, strict=False), start=1):
            if found is not None and found != name:
                raise ValueError(
                    f"{file}, line {line}, column stimulus_{place}: {row.trial_type} has {name!r} there, got {found!r}"
                )


def read_folder(folder: str | os.PathLike[str]) -> tuple[Answers, ...]:
    """All answers of an experiment: sub-*/beh/*_events.tsv, by task and subject.

    Parameters
    ----------
    folder : path
        Of the data.

    Returns
    -------
    tuple of Answers

    Raises
    ------
    ValueError
        If there is no file, one is not right (see `read_answers`), a subject has two for one task, or simulated
        subjects are among others, or a task was not the same for all.
    OSError
        If a file cannot be read.
    """
    found: dict[tuple[str, str], Answers] = {}
    for path in sorted(Path(folder).glob("sub-*/beh/*_events.tsv")):
        one = read_answers(path)
        if (label := path.parents[1].name) != f"sub-{one.subject}":
            raise ValueError(f"{path}: the answers are of subject {one.subject}, the folder is {label}")
        if (key := (one.name, one.subject)) in found:
            raise ValueError(
                f"{path}: subject {one.subject} has another file for task {one.name}, {found[key].source}"
            )
        _check_alike(one, next((other for other in found.values() if other.name == one.name), None))
        found[key] = one
    if not found:
        raise ValueError(f"{os.fspath(folder)}: there is no file of answers, sub-*/beh/*_events.tsv")
    for kind in (False, True):
        if not any(one.simulated == kind for one in found.values()):
            break
    else:
        simulated = next(one.source for one in found.values() if one.simulated)
        raise ValueError(f"{os.fspath(folder)}: a simulated subject is among others: {simulated}")
    return tuple(found[key] for key in sorted(found))


def _check_alike(one: Answers, other: Answers | None) -> None:
    """That two subjects had the same task."""
    if other is None or one.side_car is None or other.side_car is None:
        return
    if changes := other.side_car.differences_across_subjects(one.side_car):
        raise ValueError(f"{one.source}: the task was another one in {other.source}: {'; '.join(changes)}")


def replay(file: str, rows: Sequence[tuple[int, Row]], order: Order) -> None:
    """Feeds the responses of a file to an order, each checked against the trial that the order gives.

    Parameters
    ----------
    file : str
        Its name, for the sentence.
    rows : sequence of (int, Row)
        With their lines.
    order : Order
        At its beginning.

    Raises
    ------
    ValueError
        If a row is not the answer to the order's trial: with the line.
    """
    for line, row in rows:
        trial = order.next()
        if trial is None:
            raise ValueError(f"{file}, line {line}: the run has no trial left that this could answer")
        for column, found, due in _compared(row, trial):
            if found != due:
                raise ValueError(
                    f"{file}, line {line}, column {column}: {found!r} where {row.phase} trial {row.trial} has {due!r}: made "
                    "with another seed or protocol"
                )
        order.answer(row.response)


def _compared(row: Row, trial: Trial) -> Iterator[tuple[str, object, object]]:
    seeds = tuple(interval.seed for interval in trial.intervals)
    stimuli = tuple(interval.stimulus.name for interval in trial.intervals)
    yield "phase", row.phase, trial.phase
    yield "trial", row.trial, trial.number
    yield "block", row.block, trial.block
    yield "trial_type", row.trial_type, trial.trial_type
    yield "level", row.level, trial.level
    yield "correct", row.correct, row.response == trial.correct
    for name, found, due in (("stimulus", row.stimuli, stimuli), ("seed", row.seeds, seeds)):
        for place, expected in enumerate(due, start=1):
            yield f"{name}_{place}", found[place - 1] if len(found) == len(due) else None, expected


def _labels(file: str, car: SideCar | None, given: Mapping[str, str | None]) -> dict[str, Any]:
    """Subject, name and task: given, or of the side-car, or, of another program's file, of its name."""
    match = _LABELS.fullmatch(os.path.basename(file))
    named: dict[str, str | None] = dict(
        zip(("subject", "name"), match.groups() if match else (None, None), strict=True)
    )
    labels: dict[str, Any] = {}
    for key, value in given.items():
        known = named.get(key) if car is None else getattr(car, key)
        if value is not None and known is not None and value != known:
            raise ValueError(f"{file}: {key} must be {known!r}, as the file says, got {value!r}")
        labels[key] = known if value is None else value
    if car is not None:
        for key, value in named.items():
            if value is not None and value != labels[key]:
                raise ValueError(
                    f"{file}: {key} is {value!r} in the file's name and {labels[key]!r} in {side_car_path(file).name}"
                )
    if labels["task"] is None:
        raise ValueError(f"{file}: what the task is is unknown: give task=, one of {', '.join(TASKS)}")
    labels["name"] = labels["name"] or labels["task"]
    return labels


def _one_subject(file: str, content: bytes, subject: str | None) -> str:
    """The subject, where a column says it too."""
    for line, fields in tsv_text.parse(file, content).rows:
        found = fields.get(_PARTICIPANT, "").removeprefix("sub-")
        if found and subject is not None and found != subject:
            raise ValueError(
                f"{file}, line {line}, column {_PARTICIPANT}: {found!r} in a file of subject {subject!r}"
            )
        subject = subject or found or None
    if subject is None:
        raise ValueError(
            f"{file}: the subject is unknown: name the file sub-LABEL_task-LABEL_events.tsv or give subject="
        )
    return subject
