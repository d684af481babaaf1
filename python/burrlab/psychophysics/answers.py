"""Files of answers, written so that each answer is on disk before the next trial, in a BIDS 1.10.0 folder."""

import contextlib
import itertools
import json
import os
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import burrlab.common.table as table
from burrlab._core import __version__
from burrlab.common.check import amend_error, content_of, refuse
from burrlab.common.files import lock, sync, synced_write, write_text
from burrlab.common.records import in_one_line
from burrlab.psychophysics.designs import PARAMETER_KEYS, Order
from burrlab.psychophysics.rules import ANSWERS, TASKS, Counts, TaskName, counts_of
from burrlab.psychophysics.side_car import (
    REQUIRED,
    AnswerRow,
    RowReader,
    SideCar,
    as_text,
    columns_of,
    is_optional,
    read_side_car,
    side_car_path,
)


@table.by_value
@dataclass(frozen=True, eq=False, repr=False)
class Answers(table.Tabular):
    """The answers of one subject in one task.

    Attributes
    ----------
    subject : str
        BIDS label, without "sub-".
    name : str
        BIDS label of the task in the protocol.
    task : {"same-different", "abx", "2ifc"}
    rows : tuple of AnswerRow
        One per answer, practice included, in order.
    side_car : SideCar or None
        None for a file of another program.
    notes : tuple of str
        Warnings, such as a broken-off last line.
    source : str
        Path of the file.
    """

    subject: str
    name: str
    task: TaskName
    rows: tuple[AnswerRow, ...]
    side_car: SideCar | None = None
    notes: tuple[str, ...] = ()
    source: str = ""

    @property
    def main(self) -> tuple[AnswerRow, ...]:
        """The rows of the main phase that count."""
        return tuple(row for row in self.rows if row.phase == "main" and not row.lost)

    @property
    def simulated(self) -> bool:
        """Whether the subject is a program; False if the file does not say."""
        return self.side_car is not None and self.side_car.simulated is not None

    @property
    def design(self) -> Mapping[str, Any]:
        """The design's `to_dict`; empty if the file does not say."""
        return {} if self.side_car is None else self.side_car.design

    @property
    def trials(self) -> int | None:
        """Trials of the run, practice included (a staircase's maximum); None if the file does not say."""
        return None if self.side_car is None else self.side_car.trials

    def counts(self) -> Counts:
        """Hits and false alarms of the main phase, in all and by trial type.

        Raises
        ------
        ValueError
            If the main phase has no answer.
        """
        refuse(not self.main, f"{self}: there is no answer of the main phase to count")
        return counts_of(
            self.task,
            [(row.trial_type, row.response, row.correct_answer(ANSWERS[self.task])) for row in self.main],
        )

    def _table(self) -> Mapping[str, Sequence[Any]]:
        """The rows as in the file, but columns with units end in them."""
        rows = [row.fields() for row in self.rows]
        columns = {name: [row.get(name) for row in rows] for name in columns_of(self.task)}
        return {
            _UNITS.get(name, name): x
            for name, x in columns.items()
            if not is_optional(name) or set(x) != {None}
        }

    def __repr__(self) -> str:
        practice = len(self.rows) - len(self.main)
        text = (
            f"Answers({'a simulated ' * self.simulated}subject {self.subject}, task {self.name} ({self.task}), "
            f"{len(self.main)} answers" + f" and {practice} in practice" * bool(practice)
        )
        return "; ".join([text, *self.notes]) + ")"

    def _repr_html_(self) -> str:
        return table.html_table(
            repr(self),
            {name: ["" if x is None else x for x in values] for name, values in self._table().items()},
        )


_PARTICIPANT = "participant_id"
#: Names of columns in tables for other programs.
_UNITS = {name: f"{name}_s" for name in ("onset", "duration", "response_time")} | {
    "boundary": "boundary_mm", **{f"force_{place}": f"force_{place}_N" for place in (1, 2, 3)},
}  # fmt: skip
#: Columns that the order of the trials decides, besides those of each interval.
_PLANNED = ("phase", "trial", "block", "trial_type", "level", "correct")


def read_answers(
    path: str | os.PathLike[str],
    *,
    task: str | None = None,
    answers: Sequence[str] | None = None,
    subject: str | None = None,
    name: str | None = None,
) -> Answers:
    """The answers in a TSV file of this or another program.

    Parameters
    ----------
    path : path
        The file has the columns onset, duration [s], trial_type, response, correct (1 or 0), response_time
        [s] and trial. Other columns of this program are optional. n/a means no value.
    task : {"same-different", "abx", "2ifc"}, optional
        By default the side-car's.
    answers : (str, str), optional
        The file's words for "same", "different" or "first", "second"; by default these words.
    subject, name : str, optional
        Labels of subject and task; by default those of the side-car or the file name,
        ``sub-LABEL_task-LABEL_...``.

    Returns
    -------
    Answers
        A last line that was broken off by a kill is left out, and the notes say so.

    Raises
    ------
    ValueError
        If the file is not text in UTF-8, is empty, lacks a column or has an unknown one; a field is invalid;
        a trial is duplicate, missing or out of order; `correct` contradicts trial type and response; the file
        holds two subjects; or subject or task is unknown. The message names the line, if any.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "sub-01_task-drilling_events.tsv")
    >>> names = "onset", "duration", "trial_type", "response", "correct", "response_time", "trial"
    >>> rows = [names, ("0", "41", "AA", "same", "1", "0.5", "1"), ("60", "41", "AB", "same", "0", "0.5", "2")]
    >>> _ = path.write_text("".join("\\t".join(row) + "\\n" for row in rows))
    >>> answers = read_answers(path, task="same-different")
    >>> answers.subject, [row.correct for row in answers.rows]
    ('01', [True, False])
    >>> folder.cleanup()
    """
    file, content = os.fspath(path), content_of(path)
    car = read_side_car(path)
    labels = _labels(file, car, {"subject": subject, "name": name, "task": task})
    refuse(labels["task"] not in TASKS, f"task must be one of {', '.join(TASKS)}, got {labels['task']!r}")
    refuse(
        answers is not None
        and not (
            isinstance(answers, (list, tuple))
            and len(answers) == len(set(answers)) == 2
            and all(isinstance(answer, str) for answer in answers)
        ),
        f"answers must be two that differ, in the order of their keys, got {answers!r}",
    )
    if car is None:
        # The last line of another program's file may be complete without a line end.
        reader, torn = read_rows(file, content, labels["task"], answers), b""
    else:
        reader, content, torn = read_own_rows(file, content, car.task)
        _check_stimuli(file, reader.rows, car)
        refuse(
            len(reader.rows) > car.trials,
            f"{file}: the run has at most {car.trials} trials, got {len(reader.rows)} answers",
        )
    notes = (f"the last line of {file} was broken off and is left out",) if torn else ()
    labels["subject"] = _one_subject(file, content, labels["subject"])
    return Answers(
        **labels, rows=tuple(row for _, row in reader.rows), side_car=car, notes=notes, source=file
    )


def read_rows(file: str, content: bytes, task: TaskName, answers: Sequence[str] | None = None) -> RowReader:
    """A reader that holds all rows of a file, checked. Errors are those of `read_answers`."""
    text_table = table.parse(file, content)
    known = (*columns_of(task), _PARTICIPANT)
    for column in text_table.columns:
        refuse(
            column not in known,
            f"{file}, line 1: unknown column {column!r}; known are {', '.join(known)}",
        )
    for column in REQUIRED:
        refuse(column not in text_table.columns, f"{file}, line 1: column {column} is missing")
    reader = RowReader(task, answers)
    for number, fields in text_table.rows:
        with amend_error(f"{file}, line {number}, "):
            reader.add(number, reader.parse(fields))
    return reader


def read_own_rows(file: str, content: bytes, task: TaskName) -> tuple[RowReader, bytes, bytes]:
    """(reader with all rows, their bytes, the broken-off bytes after them) of a file of this program.

    A last line that lacks only its line end is complete: no value of `ended` is the beginning of another, and
    `repeats`, the last column, has one digit.
    """
    lines, torn = table.split_torn(content)
    if torn:
        with contextlib.suppress(ValueError):
            return read_rows(file, content + b"\n", task), content + b"\n", b""
    return read_rows(file, lines, task), lines, torn


def _check_stimuli(file: str, rows: Sequence[tuple[int, AnswerRow]], car: SideCar) -> None:
    """Raises ValueError if a trial's type contradicts the stimuli in its row, or its level is not of the design."""
    places = {
        "same-different": {"A": "a", "B": "b"},
        "abx": {"": "reference", "A": "match", "B": "foil"},
        "2ifc": {"R": "reference"} if car.design.get("boundary_mm") is None else {},
    }[car.task]
    names = {letter: str(car.design[key]["name"]) for letter, key in places.items()}
    fixed = car.design["levels"] if car.design["design"] == "constant-stimuli" else ()
    levels = {f"{level:.9g}" for level in fixed}
    for line, row in rows:
        refuse(
            "parameter" in car.design
            and (row.level in (None, 1.0) or (levels and f"{row.level:.9g}" not in levels)),
            f"{file}, line {line}, column level: must be one of the design's, got {row.level}",
        )
        moved = {"C": f"{names['R']} {car.design['parameter']} x{row.level:.6g}"} if "R" in names else {}
        letters = ([""] if "" in names else []) + list(row.trial_type)
        expected = [(names | moved).get(letter) for letter in letters]
        for place, (stimulus, name) in enumerate(zip(row.stimuli, expected, strict=False), start=1):
            refuse(
                None not in (stimulus, name) and stimulus != name,
                f"{file}, line {line}, column stimulus_{place}: {row.trial_type} has {name!r} there, got "
                f"{stimulus!r}",
            )


def read_folder(folder: str | os.PathLike[str]) -> tuple[Answers, ...]:
    """All answers of an experiment, ``sub-*/beh/*_events.tsv``, sorted by task and subject.

    Parameters
    ----------
    folder : path
        Folder of the data.

    Returns
    -------
    tuple of Answers

    Raises
    ------
    ValueError
        If there is no file, a file is invalid (see `read_answers`), a subject has two files for one task,
        simulated subjects are mixed with people, or a task differs between subjects.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> from burrlab.psychophysics import d_prime, read_folder
    >>> for answers in read_folder("experiment"):  # doctest: +SKIP
    ...     print(answers.subject, answers.name, d_prime(answers.counts()))
    """
    runs: dict[tuple[str, str], Answers] = {}
    for path in sorted(Path(folder).glob("sub-*/beh/*_events.tsv")):
        if not side_car_path(path).exists() and len(content_of(path).splitlines()) < 2:
            continue  # killed while its files were made: nobody was asked
        answers, label = read_answers(path), path.parents[1].name
        refuse(
            label != f"sub-{answers.subject}",
            f"{path}: the answers are of subject {answers.subject}, the folder is {label}",
        )
        if other := runs.get((answers.name, answers.subject)):
            raise ValueError(
                f"{path}: subject {answers.subject} has another file for task {answers.name}, {other.source}"
            )
        other = next((other for other in runs.values() if other.name == answers.name), None)
        if other and other.side_car and answers.side_car:
            changes = "; ".join(other.side_car.differences(answers.side_car, across_subjects=True))
            refuse(changes, f"{answers.source}: the task was another one in {other.source}: {changes}")
        runs[answers.name, answers.subject] = answers
    where = os.fspath(folder)
    refuse(not runs, f"{where}: there is no file of answers, sub-*/beh/*_events.tsv")
    simulated = [answers.source for answers in runs.values() if answers.simulated]
    refuse(
        0 < len(simulated) < len(runs),
        f"{where}: a simulated subject is among others: {''.join(simulated[:1])}",
    )
    return tuple(runs[key] for key in sorted(runs))


def reference_of(design: Mapping[str, Any]) -> float | None:
    """The reference's parameter in a design's `to_dict` [N/mm^2 or 1/ms]; None if it varies none."""
    key = PARAMETER_KEYS.get(design.get("parameter", ""))
    return None if key is None else float(design["reference"][key])


def trial_rows(runs: Iterable[Answers]) -> list[dict[str, Any]]:
    """All trials of several runs, a row each, such as for a DataFrame of pandas.

    Parameters
    ----------
    runs : iterable of Answers
        Such as `read_folder(folder)`.

    Returns
    -------
    list of dict
        Subject, task, day (UTC), mode, parameter and reference [N/mm^2 or 1/ms] of the run, then the columns of
        the files; times end in _s, forces in _N.

    Examples
    --------
    >>> import pandas
    >>> from burrlab.psychophysics import read_folder, trial_rows
    >>> frame = pandas.DataFrame(trial_rows(read_folder("experiment")))  # doctest: +SKIP
    """
    return [
        {
            "subject": answers.subject, "task": answers.name,
            "day": None if answers.side_car is None else answers.side_car.started[:10],
            "mode": answers.design.get("mode"), "parameter": answers.design.get("parameter"),
            "reference": reference_of(answers.design),
            **{name: column[i] for name, column in columns.items()},
        }
        for answers in runs for columns in [answers._table()] for i in range(len(answers.rows))
    ]  # fmt: skip


def replay(file: str, rows: Sequence[tuple[int, AnswerRow]], order: Order) -> None:
    """Feeds the responses of a file to an order, and checks each row against the order's trial.

    Parameters
    ----------
    file : str
        File name, for the message.
    rows : sequence of (int, AnswerRow)
        Line numbers and rows.
    order : Order
        At its beginning.

    Raises
    ------
    ValueError
        If a row does not answer the order's trial; the message names the line.
    """
    for line, row in rows:
        trial = order.next()
        if trial is None:
            raise ValueError(f"{file}, line {line}: the run has no trial left that this could answer")
        planned = AnswerRow.of(
            trial, onset=0.0, duration=0.0, response=row.response, response_time=None, endings=()
        ).fields()
        recorded = row.fields()
        for column in (
            *_PLANNED,
            "boundary",
            *(name for name in planned if name.startswith(("stimulus", "seed"))),
        ):
            refuse(
                recorded.get(column) != planned[column],
                f"{file}, line {line}, column {column}: {recorded.get(column)!r} where {row.phase} trial "
                f"{row.trial} has {planned[column]!r}: made with another seed or protocol",
            )
        order.answer(row.response, lost=row.lost)


def _labels(file: str, car: SideCar | None, options: Mapping[str, str | None]) -> dict[str, Any]:
    """Subject, name and task by the options, or from the side-car, or from the name of another program's file."""
    match = re.fullmatch(
        r"sub-(?P<subject>[A-Za-z0-9]+)_(?:.*_)?task-(?P<name>[A-Za-z0-9]+)(?:_.*)?\.tsv",
        os.path.basename(file),
    )
    named = match.groupdict() if match else {}
    labels: dict[str, Any] = {}
    for key, value in options.items():
        known = named.get(key) if car is None else getattr(car, key)
        refuse(
            None not in (value, known) and value != known,
            f"{file}: {key} must be {known!r}, as the file says, got {value!r}",
        )
        labels[key] = known if value is None else value
    for key, value in named.items() if car is not None else ():
        refuse(
            value != labels[key],
            f"{file}: {key} is {value!r} in the file's name and {labels[key]!r} in "
            f"{side_car_path(file).name}",
        )
    refuse(
        labels["task"] is None,
        f"{file}: {side_car_path(file).name} is not beside it, which tells the task; or give task=, one of {', '.join(TASKS)}",
    )
    labels["name"] = labels["name"] or labels["task"]
    return labels


def _one_subject(file: str, content: bytes, subject: str | None) -> str:
    """The known subject, or the one in a column; ValueError if they differ or both are missing."""
    for line, fields in table.parse(file, content).rows:
        participant = fields.get(_PARTICIPANT, "").removeprefix("sub-")
        refuse(
            participant and subject is not None and participant != subject,
            f"{file}, line {line}, column {_PARTICIPANT}: {participant!r} in a file of subject {subject!r}",
        )
        subject = subject or participant or None
    if subject is None:
        raise ValueError(
            f"{file}: the subject is unknown: name the file sub-LABEL_task-LABEL_events.tsv or give subject="
        )
    return subject


class AnswerFile(contextlib.AbstractContextManager["AnswerFile"]):
    """A file for the answers of one run, made by `create` or `open`. Only one process can open it at a time.

    Attributes
    ----------
    path : Path
    side_car : SideCar
        As at the start of the run.
    notes : tuple of str
        Notes for the experimenter: whether a broken-off last line was cut, whether an earlier version, without
        force limits, began the run, and other subjects' side-cars that cannot be read.
    end : float
        Time of the end of the last answer, from the start of the run [s].
    """

    def __init__(
        self, path: Path, file: int, side_car: SideCar, end: float, reader: RowReader, columns: Sequence[str] = ()
    ) -> None:  # fmt: skip
        self.path, self.side_car, self.end = path, side_car, end
        self.notes: tuple[str, ...] = ()
        self._file: int | None = file
        self._reader, self._columns = reader, columns or side_car.columns
        # Onsets never go back, even if the wall clock was set back.
        since = datetime.now(UTC) - datetime.fromisoformat(side_car.started)
        self._zero = time.monotonic() - max(since.total_seconds(), end)

    @classmethod
    def create(cls, path: str | os.PathLike[str], side_car: SideCar) -> Self:
        """A new file with its side-car, ready for the first trial. Its folder is made.

        Parameters
        ----------
        path : path
            Ends in .tsv.
        side_car : SideCar

        Raises
        ------
        FileExistsError
            If the file or its side-car exists.
        ValueError
            If the path does not end in .tsv.
        OSError
            If the file cannot be written.
        """
        path = Path(path)
        refuse(path.suffix != ".tsv", f"path must end in .tsv, got {path}")
        path.parent.mkdir(parents=True, exist_ok=True)
        car = side_car_path(path)
        refuse(car.exists(), f"path must be a new file, {car} exists", FileExistsError)
        exists = FileExistsError(f"path must be a new file, {path} exists: resume the run")
        with _opened(path, os.O_CREAT | os.O_EXCL, exists) as file:
            return cls._begin(path, file, side_car)

    @classmethod
    def open(cls, path: str | os.PathLike[str], order: Order, side_car: SideCar) -> Self:
        """The file of a run that ended early, ready for its next trial.

        Parameters
        ----------
        path : path
        order : Order
            At its beginning. It is fed the answers in the file; its next trial is then the one to ask.
        side_car : SideCar
            Of the same run, by the present protocol.

        Returns
        -------
        AnswerFile
            A broken-off last line is cut, and the notes say so. A line that lacks only its line end gets one.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        BlockingIOError
            If another process has the file open.
        ValueError
            If the protocol or the columns have changed since the start, or a row is invalid (see
            `read_answers`) or does not answer the order's trial. The message names the change or the line.
        OSError
            If the file cannot be read or written.
        """
        path = Path(path)
        with _opened(path, 0, FileNotFoundError(f"{path}: there is no such run to resume")) as file:
            first = read_side_car(path)
            if first is None:  # killed while the files were made, or not a run of this program
                head, car = table.line(side_car.columns), side_car_path(path)
                refuse(
                    not head.startswith(content_of(path)) or car.exists(),
                    f"{path}: this is no run of this program, its side-car {car.name} is missing",
                )
                os.ftruncate(file, 0)
                return cls._begin(path, file, side_car)
            if changes := first.differences(side_car):
                raise ValueError(
                    f"{path}: the protocol was changed since the run began: {in_one_line('; '.join(changes), 2000)}"
                )
            file_bytes = content_of(path)
            reader, content, torn = read_own_rows(os.fspath(path), file_bytes, first.task)
            columns = _checked_columns(path, content, first)
            replay(os.fspath(path), reader.rows, order)
            end = max((_end(row) for _, row in reader.rows), default=0.0)
            result = cls(path, file, first, end, reader, columns)
            if len(content) > len(file_bytes):
                synced_write(file, path, content[len(file_bytes) :])
            if torn:
                os.ftruncate(file, len(content))
                os.fsync(file)
                result.notes = (
                    f"{path}: the last line was broken off after {len(torn)} bytes and is cut; its trial is "
                    "asked again",
                )
            if "clipped_1" in set(first.columns) - set(columns):
                result.notes += (
                    f"{path}: a version without force limits began this run; now those of a Touch, an Omega or a "
                    "Haply hold, and no column tells what they clip",
                )
        return result

    @classmethod
    def _begin(cls, path: Path, file: int, side_car: SideCar) -> Self:
        """Writes the column names, then the side-car: without a side-car, no trial was asked."""
        synced_write(file, path, table.line(side_car.columns))
        text = json.dumps(side_car.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
        write_text(side_car_path(path), text)
        sync(path.parent)
        return cls(path, file, side_car, 0.0, RowReader(side_car.task))

    def elapsed(self) -> float:
        """Time since the start of the run, across resumptions [s]; gives the onset of an answer."""
        return time.monotonic() - self._zero

    def append(self, answer: AnswerRow) -> None:
        """Writes an answer, which is on disk when the method returns.

        Parameters
        ----------
        answer : AnswerRow
            Answer to the trial after those in the file.

        Raises
        ------
        ValueError
            If the task has no such answer, another trial is due, or the file is closed.
        OSError
            If the answer cannot be written; the file is then unchanged.
        """
        if self._file is None:
            raise ValueError(f"{self.path} is closed")
        line = as_text(answer, self._columns)
        fields = line.decode().rstrip("\n").split("\t")
        with amend_error("answer: "):  # parsed as it will be read: no row is written that cannot be read back
            row = self._reader.parse(dict(zip(self._columns, fields, strict=True)))
        synced_write(self._file, self.path, line)
        self._reader.add(len(self._reader.rows) + 2, row)
        self.end = max(self.end, _end(row))

    def close(self) -> None:
        """Closes the file, which another process may then open."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return (
            f"AnswerFile({os.fspath(self.path)!r}, {len(self._reader.rows)} answers, "
            f"{'closed' if self._file is None else 'open'})"
        )


def _end(row: AnswerRow) -> float:
    """The end of an answer, from the start of the run [s]."""
    return row.onset + (row.duration or 0.0) + (row.response_time or 0.0)


def _checked_columns(path: Path, content: bytes, side_car: SideCar) -> tuple[str, ...]:
    """The file's columns; ValueError unless they are those that `append` writes, in the same order."""
    expected, columns = side_car.columns, table.parse(os.fspath(path), content).columns
    needed = {"boundary", "reached"}  # no version wrote such a task without
    # An earlier version wrote fewer.
    if columns != tuple(x for x in expected if x in columns or x in needed or not is_optional(x)):
        pairs = itertools.zip_longest(map(repr, expected), map(repr, columns), fillvalue="none")
        place, (was, now) = next(pair for pair in enumerate(pairs, start=1) if pair[1][0] != pair[1][1])
        raise ValueError(
            f"{path}, line 1: to go on, the columns must be as they were written: column {place} was {was}, "
            f"is now {now}"
        )
    return columns


@contextlib.contextmanager
def _opened(path: Path, more: int, otherwise: OSError) -> Iterator[int]:
    """A run's file, locked; closed after an error. Raises `otherwise` if opening fails with its type."""
    try:
        file = os.open(path, os.O_RDWR | os.O_APPEND | more, 0o666)
    except type(otherwise):
        raise otherwise from None
    try:
        lock(file, _IS_OPEN.format(path))
        yield file
    except BaseException:
        os.close(file)
        raise


_IS_OPEN = "{}: another process has this run open"

_COLUMNS = ("participant_id", "simulated", "selected_by")
_README = (
    "{name}\n\nAnswers of a psychophysical experiment with virtual bone burring, made by burrlab "
    f"{__version__}.\nOne file a subject and task: sub-LABEL/beh/sub-LABEL_task-LABEL_events.tsv, with what "
    "the run was in the\nJSON beside it.\n"
)
_PARTICIPANTS: Mapping[str, Any] = {
    "participant_id": {"Description": "Label of the subject"},
    "simulated": {
        "Description": "Whether the subject is a program",
        "Levels": {"yes": "a simulated subject", "no": "a person"},
    },
    "selected_by": {
        "Description": "How the subject was chosen by the outcome of an earlier experiment, if so"
    },
}


class ExperimentFolder:
    """The folder of an experiment. Missing files are made, and none is replaced.

    Parameters
    ----------
    path : path
    name : str
        Name of the experiment.
    """

    def __init__(self, path: str | os.PathLike[str], name: str) -> None:
        self.path, self.name = Path(path), name

    def answers(self, subject: str, task: str) -> Path:
        """The path of a subject's answers in a task; the side-car lies beside it."""
        return self.path / f"sub-{subject}" / "beh" / f"sub-{subject}_task-{task}_events.tsv"

    def log(self, subject: str, task: str) -> Path:
        """The path of the experimenter's log of a run."""
        return self._source(subject) / f"sub-{subject}_task-{task}_log.txt"

    def trace(self, subject: str, task: str, phase: str, trial: int, interval: int) -> Path:
        """The path of an interval's trace."""
        return (
            self._source(subject)
            / f"sub-{subject}_task-{task}_{phase}-{trial:03d}_interval-{interval}_trace.h5"
        )

    def _source(self, subject: str) -> Path:
        # BIDS has no form for these files; its validators ignore sourcedata.
        return self.path / "sourcedata" / f"sub-{subject}" / "beh"

    def prepare(self) -> None:
        """Makes the missing files that describe the folder.

        Raises
        ------
        OSError
            If they cannot be written.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        described = {
            "Name": self.name,
            "BIDSVersion": "1.10.0",
            "DatasetType": "raw",
            "GeneratedBy": [{"Name": "burrlab", "Version": __version__}],
        }
        for file, text in (
            ("dataset_description.json", json.dumps(described, indent=1, ensure_ascii=False) + "\n"),
            ("participants.json", json.dumps(_PARTICIPANTS, indent=1) + "\n"),
            ("README", _README.format(name=self.name)),
        ):
            if not (self.path / file).exists():
                write_text(self.path / file, text)

    def add(self, subject: str, *, simulated: bool, selected_by: str | None = None) -> None:
        """Enters a subject in participants.tsv, unless already there.

        Raises
        ------
        ValueError
            If simulated subjects would be mixed with people, or the file is invalid.
        OSError
            If the file cannot be written.
        """
        self.prepare()
        path, kind = self.path / "participants.tsv", "yes" if simulated else "no"
        row = dict(zip(_COLUMNS, (f"sub-{subject}", kind, selected_by or table.NOTHING), strict=True))
        with open(path, "a+b") as stream:
            file = stream.fileno()
            lock(file, _IS_OPEN.format(path), wait=True)
            columns = _mend(file, path, row)
            entered = self.participants()
            for other, entry in entered.items():
                refuse(
                    entry["simulated"] != kind,
                    f"{path}: simulated subjects and people do not go into one folder: sub-{other} has "
                    f"simulated {entry['simulated']}, sub-{subject} {kind}",
                )
            if subject not in entered:  # laboratories may add columns, such as age, or move ours
                synced_write(file, path, table.line([row.get(column, table.NOTHING) for column in columns]))

    def participants(self) -> dict[str, dict[str, str]]:
        """The fields of participants.tsv by subject's label; empty without the file.

        Raises
        ------
        ValueError
            If the file is invalid; the message names the line.
        """
        path, participants = self.path / "participants.tsv", dict[str, dict[str, str]]()
        if not path.exists():
            return participants
        text_table = table.parse(os.fspath(path), content_of(path))
        for column in _COLUMNS[:2]:
            refuse(column not in text_table.columns, f"{path}, line 1: column {column} is missing")
        for line, fields in text_table.rows:
            subject, kind = fields["participant_id"].removeprefix("sub-"), fields["simulated"]
            refuse(subject in participants, f"{path}, line {line}: subject {subject} is there twice")
            refuse(
                kind not in ("yes", "no"),
                f"{path}, line {line}, column simulated: must be yes or no, got {kind!r}",
            )
            participants[subject] = {**fields, "participant_id": subject}
        return participants


def _mend(file: int, path: Path, row: Mapping[str, str]) -> tuple[str, ...]:
    """The columns of participants.tsv; missing column names are written, and a broken-off last line is cut.

    A last line that lacks only its line end, as an editor may leave it, gets one.
    """
    content, torn = table.split_torn(content_of(path))
    heading = table.line(_COLUMNS)
    if not content and heading.startswith(torn):  # empty, or broken off in its first line
        os.ftruncate(file, 0)
        synced_write(file, path, heading)
        return _COLUMNS
    columns = table.parse(os.fspath(path), content or torn).columns
    if torn:
        *before, last = torn.decode(errors="replace").split("\t")
        whole = row.get(columns[-1], table.NOTHING)
        if not content or (
            len(before) == len(columns) - 1 and not (last != whole and whole.startswith(last))
        ):
            synced_write(file, path, b"\n")
        else:
            os.ftruncate(file, len(content))
    return columns
