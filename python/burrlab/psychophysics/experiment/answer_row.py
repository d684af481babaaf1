"""One answer as a row of a file, and the rules that rows obey."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from burrlab.psychophysics.experiment import tsv_text
from burrlab.psychophysics.experiment.interval import ENDINGS
from burrlab.psychophysics.rules import TaskName
from burrlab.psychophysics.trial import Phase, Trial

#: Answers in the order of their keys 1, 2.
ANSWERS: Mapping[TaskName, tuple[str, str]] = {
    "same-different": ("same", "different"),
    "abx": ("first", "second"),
    "2ifc": ("first", "second"),
}
#: The answer that hits and false alarms are of, see `Rule`.
COUNTED: Mapping[TaskName, str] = {"same-different": "different", "abx": "first", "2ifc": "first"}
INTERVALS: Mapping[TaskName, int] = {"same-different": 2, "abx": 3, "2ifc": 2}
#: Types of trials and, where the type alone decides, the correct answer.
TYPES: Mapping[TaskName, Mapping[str, str | None]] = {
    "same-different": {"AA": "same", "AB": "different", "BA": "different", "BB": "same"},
    "abx": {"AB": "first", "BA": "second"},
    "2ifc": {"RC": None, "CR": None},
}
PHASES: tuple[Phase, ...] = ("practice", "main")

REQUIRED = ("onset", "duration", "trial_type", "response", "correct", "response_time", "trial")


@dataclass(frozen=True)
class Answer:
    """What a subject answered, and when.

    Attributes
    ----------
    trial : Trial
    onset : float
        Of the first interval, from the start of the run [s].
    duration : float
        From there to the end of the last interval [s].
    response : str
        One of the design's answers.
    response_time : float or None
        From the question [s]; None for a simulated subject.
    endings : tuple of str
        Of each interval: "time", "break-through", "wall", "subject" or "device".
    repeats : int
        How often the trial was broken off before, as the loop had stalled.

    Notes
    -----
    Times are kept to the microsecond.
    """

    trial: Trial
    onset: float
    duration: float
    response: str
    response_time: float | None
    endings: tuple[str, ...]
    repeats: int = 0

    def __post_init__(self) -> None:
        for name in ("onset", "duration", "response_time"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, round(float(value), 6))
        object.__setattr__(self, "endings", tuple(self.endings))

    @property
    def correct(self) -> bool:
        return self.response == self.trial.correct


@dataclass(frozen=True)
class Row:
    """One answer, as a file has it; None where it has n/a or no such column.

    Attributes
    ----------
    onset : float
        Of the first interval, from the start of the run [s].
    duration : float or None
        From there to the end of the last interval [s].
    trial_type, response : str
    correct : bool
    response_time : float or None
        From the question [s].
    trial : int
        In its phase, from 1.
    phase : {"practice", "main"}
    block : int
        From 1; practice is block 0.
    level : float or None
        Of the comparison, as its ratio to the reference's.
    stimuli : tuple of str
        One an interval; empty where the file has none.
    seeds : tuple of int or None
    endings : tuple of str or None
    repeats : int or None
        How often the trial was broken off before, as the loop had stalled.
    """

    onset: float
    duration: float | None
    trial_type: str
    response: str
    correct: bool
    response_time: float | None
    trial: int
    phase: Phase = "main"
    block: int = 1
    level: float | None = None
    stimuli: tuple[str | None, ...] = ()
    seeds: tuple[int | None, ...] = ()
    endings: tuple[str | None, ...] = ()
    repeats: int | None = None

    @classmethod
    def of(cls, answer: Answer) -> Row:
        """The row of an answer."""
        trial = answer.trial
        return cls(
            answer.onset, answer.duration, trial.trial_type, answer.response, answer.correct, answer.response_time,
            trial.number, trial.phase, trial.block, trial.level,
            tuple(interval.stimulus.name for interval in trial.intervals),
            tuple(interval.seed for interval in trial.intervals),
            answer.endings, answer.repeats,
        )  # fmt: skip

    def fields(self) -> dict[str, Any]:
        """Values by column."""
        named = {
            "onset": self.onset, "duration": self.duration, "trial_type": self.trial_type, "response": self.response,
            "correct": int(self.correct), "response_time": self.response_time, "trial": self.trial,
            "phase": self.phase, "block": self.block, "level": self.level,
        }  # fmt: skip
        for name, values in (("stimulus", self.stimuli), ("seed", self.seeds), ("ended", self.endings)):
            named |= {f"{name}_{place}": value for place, value in enumerate(values, start=1)}
        return {**named, "repeats": self.repeats}

    def correct_answer(self, answers: Sequence[str]) -> str:
        """The answer that was correct, of the two."""
        return self.response if self.correct else next(one for one in answers if one != self.response)


def columns_of(task: TaskName) -> tuple[str, ...]:
    """All columns of a file, in order."""
    places = range(1, INTERVALS[task] + 1)
    numbered = [f"{name}_{place}" for name in ("stimulus", "seed", "ended") for place in places]
    return (*REQUIRED, "phase", "block", "level", *numbered, "repeats")


def as_text(row: Row, task: TaskName, columns: Sequence[str] = ()) -> bytes:
    """The line of a row in a file with these columns, by default all."""
    fields = row.fields()
    values = [fields.get(column) for column in columns or columns_of(task)]
    return tsv_text.line([tsv_text.NOTHING if value is None else _text(value) for value in values])


class RowReader:
    """Rows of one file, one after the other, each checked by itself and against those before.

    Parameters
    ----------
    task : {"same-different", "abx", "2ifc"}
    answers : (str, str)
        What the file calls the task's answers, in the order of their keys.
    """

    def __init__(self, task: TaskName, answers: Sequence[str] | None = None) -> None:
        self.task = task
        self._answers = dict(zip(answers or ANSWERS[task], ANSWERS[task], strict=True))
        self._before: list[tuple[int, Row]] = []

    def add(self, line: int, row: Row) -> None:
        """A row that those to come are checked against."""
        self._before.append((line, row))

    def parse(self, fields: Mapping[str, str]) -> Row:
        """The row of a line's fields, which follows those that were added.

        Raises
        ------
        ValueError
            If a field is not what it must be, or contradicts another or a row before: with the column.
        """
        places = range(1, INTERVALS[self.task] + 1)

        def all_of(name: str, convert: Callable[[str], Any]) -> tuple[Any, ...]:
            if not any(f"{name}_{place}" in fields for place in places):
                return ()
            return tuple(_field(fields, f"{name}_{place}", convert, None) for place in places)

        row = Row(
            onset=_field(fields, "onset", _filled(tsv_text.number)),
            duration=_field(fields, "duration", _duration),
            trial_type=_field(fields, "trial_type", _one_of(tuple(TYPES[self.task]))),
            response=self._answers[_field(fields, "response", _one_of(tuple(self._answers)))],
            correct=_field(fields, "correct", _one_of(("0", "1"))) == "1",
            response_time=_field(fields, "response_time", _duration),
            trial=_field(fields, "trial", _filled(tsv_text.whole)),
            phase=_field(fields, "phase", _one_of(PHASES), "main"),
            block=_field(fields, "block", _filled(tsv_text.whole), 1),
            level=_field(fields, "level", _level, None),
            stimuli=all_of("stimulus", lambda text: None if text == tsv_text.NOTHING else text),
            seeds=all_of("seed", lambda text: tsv_text.whole(text, below=2**64)),
            endings=all_of(
                "ended", lambda text: None if text == tsv_text.NOTHING else _one_of(ENDINGS)(text)
            ),
            repeats=_field(fields, "repeats", lambda text: tsv_text.whole(text, below=10), None),
        )
        for line, one in self._before:
            if (one.phase, one.trial) == (row.phase, row.trial):
                raise ValueError(
                    f"column trial: {row.phase} trial {row.trial} is answered in line {line} already"
                )
        _check_place(row, self._before[-1][1] if self._before else None)
        self._check_correct(row)
        return row

    def _check_correct(self, row: Row) -> None:
        due = TYPES[self.task][row.trial_type]
        answer = row.correct_answer(ANSWERS[self.task])
        if due is not None and answer != due:
            raise ValueError(
                f"column correct: after {row.trial_type} the correct answer is {due!r}, and the response "
                f"{row.response!r} is called {'correct' if row.correct else 'wrong'}"
            )
        if due is not None:
            return
        for line, one in self._before:
            other = _side(one, one.correct_answer(ANSWERS[self.task]))
            if None not in (other, side := _side(row, answer)) and other != side:
                raise ValueError(
                    f"column correct: the response {row.response!r} is called {'correct' if row.correct else 'wrong'} "
                    f"after {row.trial_type}, which contradicts line {line}"
                )


def _side(row: Row, answer: str) -> bool | None:
    """Whether more of the parameter is more of what is asked; a comparison that equals the reference does not tell."""
    if row.level is None or row.level == 1.0:
        return None
    comparison = (answer == "first") == (row.trial_type == "CR")
    return comparison == (row.level > 1.0)


def _check_place(row: Row, before: Row | None) -> None:
    """That trials follow one another."""
    if row.trial < 1:
        raise ValueError(f"column trial: must be at least 1, got {row.trial}")
    if row.phase == "main" and row.block < 1:
        raise ValueError(f"column block: must be at least 1 after practice, got {row.block}")
    last = before.trial if before is not None and before.phase == row.phase else 0
    if before is not None and before.phase == "main" and row.phase == "practice":
        raise ValueError("column phase: practice comes before the main phase")
    if row.trial != last + 1:
        raise ValueError(f"column trial: {row.phase} trial {last + 1} is due, got {row.trial}")
    if before is not None and row.onset < before.onset:
        raise ValueError(
            f"column onset: must not be before the last trial's {before.onset!r}, got {row.onset!r}"
        )
    if before is not None and last and row.block < before.block:
        raise ValueError(f"column block: must not be before the last trial's {before.block}, got {row.block}")


_ABSENT = object()


def _field(
    fields: Mapping[str, str], column: str, convert: Callable[[str], Any], default: Any = _ABSENT
) -> Any:
    if column not in fields and default is not _ABSENT:
        return default
    try:
        return convert(fields[column])
    except ValueError as error:
        raise ValueError(f"column {column}: {error}") from None


def _filled(convert: Callable[[str], Any]) -> Callable[[str], Any]:
    def filled(text: str) -> Any:
        if (value := convert(text)) is None:
            raise ValueError(f"every row needs a number, got {text!r}")
        return value

    return filled


def _one_of(choices: Sequence[str]) -> Callable[[str], str]:
    def chosen(text: str) -> str:
        if text not in choices:
            raise ValueError(f"must be one of {', '.join(choices)}, got {text!r}")
        return text

    return chosen


def _duration(text: str) -> float | None:
    value = tsv_text.number(text)
    if value is not None and value < 0:
        raise ValueError(f"must be at least 0 [s], got {text!r}")
    return value


def _level(text: str) -> float | None:
    value = tsv_text.number(text)
    if value is not None and value <= 0:
        raise ValueError(f"must be a ratio above 0, got {text!r}")
    return value


def _text(value: str | int | float) -> str:
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"a number must be finite, got {value!r}")
        return repr(value)
    return str(value)
