"""Rows of answers and their rules, and the side-car: JSON beside the file that describes the run."""

import contextlib
import hashlib
import json
import math
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeAlias

import burrlab.common.table as table
from burrlab._core import __version__
from burrlab.common.check import amend_error, content_of, refuse, shown
from burrlab.common.provenance import provenance
from burrlab.psychophysics.designs import Phase, Trial
from burrlab.psychophysics.interval import ENDINGS, Rendered
from burrlab.psychophysics.rules import ANSWERS, INTERVALS, KEYS, TASKS, TaskName
from burrlab.psychophysics.staircase import design_of_dict

#: Types of trials and the correct answer, if the type alone decides it.
TYPES: Mapping[TaskName, Mapping[str, str | None]] = {
    "same-different": {"AA": "same", "AB": "different", "BA": "different", "BB": "same"},
    "abx": {"AB": "first", "BA": "second"},
    "2ifc": {"RC": None, "CR": None},
}

#: Below this time from question to key a subject cannot have judged [s] (ours).
TOO_FAST = 0.2
REQUIRED = ("onset", "duration", "trial_type", "response", "correct", "response_time", "trial")
#: Columns of each interval, and the fields that hold them.
_NUMBERED = {
    "stimulus": "stimuli", "seed": "seeds", "ended": "endings", "clipped": "clipped", "force": "forces",
}  # fmt: skip
#: Columns that only some files have, or that earlier versions did not write.
_OPTIONAL = ("boundary", "reached", "clipped", "force", "repeats")


@dataclass(frozen=True)
class AnswerRow:
    """A subject's answer, as in a file; None stands for n/a or a missing column.

    Attributes
    ----------
    onset : float
        Start of the first interval, from the start of the run [s].
    duration : float or None
        From the onset to the end of the last interval [s].
    trial_type, response : str
    correct : bool
    response_time : float or None
        From the question to the answer [s].
    trial : int
        In its phase, from 1.
    phase : {"practice", "main", "catch"}
    block : int
        From 1; practice is block 0.
    level : float or None
        The comparison's parameter over the reference's.
    stimuli : tuple of str
        One per interval; empty if the file has none.
    seeds : tuple of int or None
    endings : tuple of str or None
    repeats : int or None
        How often the trial was repeated because the loop stalled.
    clipped : tuple of float or None
        Share of the ticks in contact whose force the limits shortened [1]; in files of a device with limits.
    boundary : float or None
        Depth of the comparison's boundary [mm], in tasks with one.
    reached : bool or None
        Whether the burr came to the boundary.
    forces : tuple of float or None
        Mean of the model's force over the time of contact [N].
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
    clipped: tuple[float | None, ...] = ()
    boundary: float | None = None
    reached: bool | None = None
    forces: tuple[float | None, ...] = ()

    @classmethod
    def of(
        cls, trial: Trial, *, onset: float, duration: float, response: str, response_time: float | None,
        endings: Sequence[str], repeats: int = 0, felt: Sequence[Rendered | None] = (),
    ) -> "AnswerRow":  # fmt: skip
        """The answer to a trial; times [s] are kept to the microsecond, forces to 0.1 mN.

        `felt` holds what was rendered, None for a real specimen.
        """
        boundary = next((x.boundary.depth for x in trial.intervals if x.boundary is not None), None)
        return cls(
            round(float(onset), 6), round(float(duration), 6), trial.trial_type, response, response == trial.correct,
            None if response_time is None else round(float(response_time), 6),
            trial.number, trial.phase, trial.block, trial.level,
            tuple(interval.stimulus.name for interval in trial.intervals),
            tuple(interval.seed for interval in trial.intervals),
            tuple(endings), repeats, tuple(None if x is None else x.clipped for x in felt),
            boundary, None if boundary is None else all(x is None or x.reached for x in felt),
            tuple(None if x is None else round(x.pressed, 4) for x in felt),
        )  # fmt: skip

    @property
    def lost(self) -> bool:
        """Whether the trial does not count, as the burr did not come to the boundary."""
        return self.reached is False

    def fields(self) -> dict[str, Any]:
        """Values by column."""
        named = {
            **vars(self), "correct": int(self.correct), "reached": None if self.reached is None else int(self.reached)
        }  # fmt: skip
        for column, name in _NUMBERED.items():
            named |= {f"{column}_{place}": value for place, value in enumerate(named.pop(name), start=1)}
        return named

    def correct_answer(self, answers: Sequence[str]) -> str:
        """The correct one of the two answers."""
        return (
            self.response if self.correct else next(answer for answer in answers if answer != self.response)
        )


def columns_of(task: TaskName, *, without: Sequence[str] = ()) -> tuple[str, ...]:
    """All columns of a file, in order, without some that are optional."""
    columns = (
        *REQUIRED, "phase", "block", "level", "boundary", "reached",
        *(f"{column}_{place}" for column in _NUMBERED for place in range(1, INTERVALS[task] + 1)), "repeats",
    )  # fmt: skip
    return tuple(column for column in columns if _unnumbered(column) not in without)


def _unnumbered(column: str) -> str:
    return column.rstrip("_123")


def is_optional(column: str) -> bool:
    """Whether a file may lack a column that is written now."""
    return _unnumbered(column) in _OPTIONAL


def as_text(row: AnswerRow, columns: Sequence[str]) -> bytes:
    """The line of a row in a file with these columns."""
    values = [*map(row.fields().get, columns)]
    endless = [value for value in values if isinstance(value, float) and not math.isfinite(value)]
    refuse(endless, f"a number must be finite, got {', '.join(map(repr, endless))}")
    return table.line([table.tsv_text(value) for value in values])


class RowReader:
    """A reader of one file's rows, which checks each by itself and against earlier rows.

    Parameters
    ----------
    task : {"same-different", "abx", "2ifc"}
    answers : (str, str)
        The file's words for the task's answers, in the order of their keys.
    """

    def __init__(self, task: TaskName, answers: Sequence[str] | None = None) -> None:
        self.task = task
        self._before: dict[tuple[str, int], tuple[int, AnswerRow]] = {}
        self._readings: Mapping[str, Reading] = {
            **_READINGS,
            "trial_type": _one_of({trial_type: trial_type for trial_type in TYPES[task]}),
            "response": _one_of(dict(zip(answers or ANSWERS[task], ANSWERS[task], strict=True))),
        }

    @property
    def rows(self) -> list[tuple[int, AnswerRow]]:
        """Line numbers and rows that were added."""
        return list(self._before.values())

    def add(self, line: int, row: AnswerRow) -> None:
        """Adds a row, against which later rows are checked."""
        self._before[row.phase, row.trial] = line, row

    def parse(self, fields: Mapping[str, str]) -> AnswerRow:
        """The row of a line's fields, checked as the next row.

        Raises
        ------
        ValueError
            If a field is invalid, or contradicts another field or row; the message names the column.
        """
        fields_read: dict[str, Any] = {}
        for column in filter(fields.__contains__, columns_of(self.task)):
            convert, rule, holds = self._readings[_unnumbered(column)]
            with amend_error(f"column {column}: "):
                fields_read[column] = convert(fields[column])
                refuse(not holds(fields_read[column]), f"{rule}, got {fields[column]!r}")
        for column, name in _NUMBERED.items():
            columns = [f"{column}_{place}" for place in range(1, INTERVALS[self.task] + 1)]
            if fields_read.keys() & columns:
                fields_read[name] = tuple(fields_read.pop(column_name, None) for column_name in columns)
        row = AnswerRow(**fields_read)
        line = self._before.get((row.phase, row.trial), (None,))[0]
        refuse(line, f"column trial: {row.phase} trial {row.trial} is answered in line {line} already")
        _, before = next(reversed(self._before.values()), (0, replace(row, trial=0)))
        _check_place(row, before, 1 + sum(phase == row.phase for phase, _ in self._before))
        self._check_correct(row)
        return row

    def _check_correct(self, row: AnswerRow) -> None:
        expected, answer = TYPES[self.task][row.trial_type], row.correct_answer(ANSWERS[self.task])
        claim = f"the response {row.response!r} is called {'correct' if row.correct else 'wrong'}"
        refuse(
            expected not in (None, answer),
            f"column correct: after {row.trial_type} the correct answer is {expected!r}, and {claim}",
        )
        if expected is None and (side := _side(row, answer)) is not None:
            for line, earlier in self._before.values():
                refuse(
                    _side(earlier, earlier.correct_answer(ANSWERS[self.task])) is (not side),
                    f"column correct: {claim} after {row.trial_type}, which contradicts line {line}",
                )


def _side(row: AnswerRow, answer: str) -> bool | None:
    """Whether the interval with more of the parameter is correct; None if the two intervals are equal."""
    comparison = (answer == "first") == (row.trial_type == "CR")
    more = row.boundary is not None or (row.level or 1.0) > 1.0
    return None if row.level in (None, 1.0) else comparison == more


def _check_place(row: AnswerRow, before: AnswerRow, expected: int) -> None:
    """Raises ValueError unless the row's trial is the expected one and follows the one before, or trial 0."""
    refuse(row.trial < 1, f"column trial: must be at least 1, got {row.trial}")
    counts, counted = row.phase != "practice", before.trial and before.phase != "practice"
    refuse(counts and row.block < 1, f"column block: must be at least 1 after practice, got {row.block}")
    refuse(counted and not counts, "column phase: practice comes before the main phase")
    same = (before.phase != "practice") == counts
    refuse(row.trial != expected, f"column trial: {row.phase} trial {expected} is due, got {row.trial}")
    for name, wrong in (("onset", row.onset < before.onset), ("block", same and row.block < before.block)):
        was, now = getattr(before, name), getattr(row, name)
        refuse(wrong, f"column {name}: must not be before the last trial's {was!r}, got {now!r}")


#: Conversion of a field's text to a value, the rule that the value obeys, and whether it does.
Reading: TypeAlias = tuple[Callable[[str], Any], str, Callable[[Any], bool]]


def _one_of(texts: Mapping[str, Any]) -> Reading:
    """The reading of a field that holds one of a few texts, which stand for these values."""
    rule = f"must be one of {', '.join(text for text in texts if text != table.NOTHING)}"
    return lambda text: texts.get(text, texts), rule, lambda meaning: meaning is not texts


def _number_or_none(rule: str, holds: Callable[[float], bool]) -> Reading:
    return table.number_or_none, rule, lambda number: number is None or holds(number)


_SECONDS = _number_or_none("must be at least 0 [s]", lambda number: number >= 0)
_WHOLE: Reading = (table.whole, "every row needs a number", lambda number: number is not None)
#: Readings of the columns that are the same in every task.
_READINGS: Mapping[str, Reading] = {
    "onset": (table.number_or_none, "every row needs a number", lambda number: number is not None),
    "duration": _SECONDS,
    "correct": _one_of({"0": False, "1": True}),
    "response_time": _SECONDS,
    "trial": _WHOLE,
    "phase": _one_of({phase: phase for phase in ("practice", "main", "catch")}),
    "block": _WHOLE,
    "level": _number_or_none("must be a ratio above 0", lambda number: number > 0),
    "stimulus": (lambda text: None if text == table.NOTHING else text, "", lambda number: True),
    "seed": (lambda text: table.whole(text, below=2**64), "", lambda number: True),
    "ended": _one_of({table.NOTHING: None, **{ending: ending for ending in ENDINGS}}),
    "clipped": _number_or_none("must be 0 to 1", lambda number: 0 <= number <= 1),
    "boundary": _number_or_none("must be above 0 [mm]", lambda number: number > 0),
    "reached": _one_of({table.NOTHING: None, "0": False, "1": True}),
    "force": _number_or_none("must be at least 0 [N]", lambda number: number >= 0),
    "repeats": (lambda text: table.whole(text, below=10), "", lambda number: True),
}


_FORMAT = 1
_KEY = "BurrlabRun"

_KINDS: Mapping[type, str] = {str: "a text", int: "a whole number", bool: "true or false", dict: "an object"}

_ENDED = {
    "time": "after its time",
    "break-through": "the burr came out below the bone",
    "wall": "the burr reached the side of the bone",
    "subject": "by the subject",
    "device": "the device was lost",
}
_DESCRIBED: Mapping[TaskName, str] = {
    "same-different": "Two intervals of virtual bone burring: was the material the same?",
    "abx": "A reference and two intervals of virtual bone burring: which of the two is as the reference?",
    "2ifc": "Two intervals of virtual bone burring: which has more of what is asked?",
}
_TYPES: Mapping[TaskName, str] = {
    "same-different": "The materials A and B of the two intervals, in order",
    "abx": "The alternatives A and B in the order in which they follow the reference",
    "2ifc": "Reference (R) and comparison (C) in order",
}
#: Descriptions of the columns; {} is the number of an interval.
_COLUMNS = {
    "onset": "Start of the first interval, from the start of the run",
    "duration": "From the onset to the end of the last interval",
    "response": "The subject's answer",
    "correct": "Whether the response was correct",
    "response_time": "From the question to the key",
    "trial": "Number of the trial in its phase, from 1",
    "phase": "Part of the run",
    "block": "Number of the block, from 1; practice is block 0",
    "level": "The comparison's parameter over the reference's",
    "stimulus": "Material of interval {}",
    "seed": "Seed of the erosion in interval {}, 64 bits",
    "ended": "How interval {} ended",
    "clipped": "Share of the ticks in contact of interval {} whose force the limits of device and session shortened",
    "boundary": "Depth below the surface at which the comparison's material begins",
    "reached": "Whether the burr's tip came to the boundary; otherwise the trial does not count",
    "force": "Mean of the model's force over the time of contact of interval {}",
    "repeats": "How often the trial was broken off and begun anew, as the loop had stalled",
}
_UNITS = {
    "onset": "s", "duration": "s", "response_time": "s", "level": "1", "clipped": "1", "boundary": "mm", "force": "N",
}  # fmt: skip
#: Keys of the file, fields and types.
_FIELDS: Mapping[str, tuple[str, type]] = {
    "Subject": ("subject", str), "TaskName": ("name", str), "Started": ("started", str),
    "Device": ("device", str), "Task": ("task", str), "Design": ("design", dict), "Protocol": ("protocol", dict),
    "Trials": ("trials", int), "Provenance": ("provenance", dict),
}  # fmt: skip


@dataclass(frozen=True)
class SideCar:
    """Description of a run, as known before its first trial.

    Attributes
    ----------
    subject : str
        BIDS label, without "sub-".
    name : str
        BIDS label of the task in the protocol.
    task : {"same-different", "abx", "2ifc"}
    design : mapping
        The design's `to_dict`.
    protocol : mapping
        The whole protocol, as JSON.
    device : str
        As for `burrlab session --device`.
    trials : int
        Trials in all, practice included; for a staircase, the maximum.
    simulated : mapping or None
        Description of a simulated subject; None for a person.
    started : str
        Start of the run by wall clock (ISO 8601, UTC); onsets count from it.
    provenance : mapping
    """

    subject: str
    name: str
    task: TaskName
    design: Mapping[str, Any]
    protocol: Mapping[str, Any]
    device: str
    trials: int
    simulated: Mapping[str, Any] | None = None
    started: str = field(default_factory=lambda: datetime.now(UTC).isoformat())
    provenance: Mapping[str, Any] = field(default_factory=lambda: table.json_mapping(provenance()))

    def __post_init__(self) -> None:
        names = ("design", "protocol", "provenance") + ("simulated",) * (self.simulated is not None)
        vars(self).update({name: table.json_mapping(getattr(self, name)) for name in names})

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a new file; with those of clipping where the device may have limits of its own."""
        own = ("touch", "omega", "haply", "driver")
        limited = self.device.partition(":")[0] in own or "limits" in self.protocol.get("experiment", {})
        plain = self.design.get("boundary_mm") is None
        return columns_of(self.task, without=("clipped",) * (not limited) + ("boundary", "reached") * plain)

    def differences(self, other: "SideCar", *, across_subjects: bool = False) -> tuple[str, ...]:
        """Relevant changes in another run of this task, in sentences; empty if none.

        The list of subjects, folder, traces, analysis settings, other tasks and a device's address do not
        count, nor, across subjects, the subject.
        """
        self_fields, others = (
            ({} if across_subjects else {"subject": car.subject, "simulated subject": car.simulated})
            | car._shared()
            for car in (self, other)
        )
        return _changes("", self_fields, others)

    def _shared(self) -> dict[str, Any]:
        """What must not change during a run, of the protocol and of the run."""
        experiment = self.protocol.get("experiment", {})
        return {
            "task": self.name,
            "experiment": {
                key: experiment.get(key) for key in ("seed", "feedback", "pause_s", "break_s", "limits")
            }
            | {"keys": experiment.get("keys", KEYS)},
            "device": self.device.partition(":")[0],
            # Decides whether a hand on the network feels a force; the port number does not matter.
            "force is published": experiment.get("publish") is not None,
            **{key: self.protocol.get(key) for key in ("burr", "bone")},
            f"tasks.{self.name}": self.design,
        }

    def to_dict(self) -> dict[str, Any]:
        """The JSON of the file, with descriptions of the columns."""
        return {
            "TaskDescription": _DESCRIBED[self.task],
            "StimulusPresentation": {
                "OperatingSystem": f"{platform.system()} {platform.release()}",
                "SoftwareName": "burrlab",
                "SoftwareVersion": __version__,
            },
            _KEY: _FORMAT,
            **{key: getattr(self, name) for key, (name, _) in _FIELDS.items()},
            "Instructions": design_of_dict(self.design).question,
            "Seed": self.protocol["experiment"]["seed"],
            "Answers": list(ANSWERS[self.task]),
            "Simulated": self.simulated is not None,
            "SimulatedSubject": self.simulated,
            "ProtocolDigest": digest(self.protocol),
            **descriptions(self.columns, self.task, self.protocol.get("experiment", {}).get("keys", KEYS)),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "SideCar":
        """The side-car that `to_dict` described.

        Raises
        ------
        ValueError
            If a key is missing or invalid.
        """
        refuse(values.get(_KEY) != _FORMAT, f"{_KEY} must be {_FORMAT}, got {shown(values.get(_KEY))}")
        options = {name: _typed(values, key, kind) for key, (name, kind) in _FIELDS.items()}
        refuse(
            options["task"] not in TASKS, f"Task must be one of {', '.join(TASKS)}, got {options['task']!r}"
        )
        simulated = _typed(values, "SimulatedSubject", dict) if _typed(values, "Simulated", bool) else None
        zone, started = None, options["started"]
        with contextlib.suppress(ValueError):
            zone = datetime.fromisoformat(started).tzinfo
        refuse(zone is None, f"Started must be a time with its zone, got {started!r}")
        car = cls(**options, simulated=simulated)
        refuse(
            values.get("ProtocolDigest") != digest(car.protocol),
            "ProtocolDigest does not belong to the Protocol beside it: one of them was changed",
        )
        car._check_against_protocol(_typed(values, "Seed", int))
        return car

    def _check_against_protocol(self, seed: int) -> None:
        """Raises ValueError if design, seed, task or trials contradict the Protocol beside them."""
        experiment, tasks = (self.protocol.get(key, {}) for key in ("experiment", "tasks"))
        refuse(
            not (isinstance(experiment, dict) and isinstance(tasks, dict)),
            "Protocol must have tables of the experiment and its tasks",
        )
        changed = "{} is not that of the Protocol beside it: one of them was changed"
        refuse(self.design != tasks.get(self.name), changed.format("Design"))
        refuse(seed != experiment.get("seed"), changed.format("Seed"))
        design = design_of_dict(self.design)
        expected = design.order(seed=seed, subject=f"{self.subject} {self.name}").total
        refuse(
            (self.task, self.trials) != (design.task, expected),
            f"Task and Trials must be {design.task!r} and {expected}, those of the Design, got {self.task!r} and "
            f"{self.trials}",
        )


def side_car_path(path: str | os.PathLike[str]) -> Path:
    """The path of the JSON beside a TSV."""
    return Path(path).with_suffix(".json")


def read_side_car(path: str | os.PathLike[str]) -> SideCar | None:
    """The side-car beside a file of answers; None if there is none, or another program's.

    Raises
    ------
    ValueError
        If the file is not JSON, or is a side-car of this program with a missing or invalid key.
    """
    file = side_car_path(path)
    if not file.exists():
        return None
    content = content_of(file)
    try:
        values = json.loads(content)
    except (ValueError, RecursionError):
        raise ValueError(f"{file}: this is not JSON in UTF-8") from None
    with amend_error(f"{file}: "):
        return SideCar.from_dict(values) if isinstance(values, dict) and _KEY in values else None


def digest(protocol: Mapping[str, Any]) -> str:
    """SHA-256 of a protocol's JSON with sorted keys."""
    text = json.dumps(table.json_mapping(protocol), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def descriptions(columns: Sequence[str], task: TaskName, keys: str = KEYS) -> dict[str, Any]:
    """BIDS descriptions of a file's columns, with units or levels."""
    levels = {
        "trial_type": {
            trial_type: f"correct answer: {correct}" if correct else trial_type
            for trial_type, correct in TYPES[task].items()
        },
        "response": {answer: f"key {key}" for key, answer in zip(keys, ANSWERS[task], strict=True)},
        "correct": {"1": "correct", "0": "wrong"},
        "reached": {"1": "reached", "0": "lost"},
        "phase": {"practice": "not analysed", "main": "analysed", "catch": "easy, for the lapse rate"},
        "ended": _ENDED,
    }
    return {
        column: {
            "Description": _TYPES[task] if name == "trial_type" else _COLUMNS[name].format(column[-1]),
            **({"Units": _UNITS[name]} if name in _UNITS else {}),
            **({"Levels": levels[name]} if name in levels else {}),
        }
        for column, name in zip(columns, map(_unnumbered, columns), strict=True)
    }


def _typed(values: Mapping[str, Any], key: str, kind: type) -> Any:
    refuse(key not in values, f"{key} is missing")
    refuse(type(values[key]) is not kind, f"{key} must be {_KINDS[kind]}, got {shown(values[key])}")
    return values[key]


def _changes(where: str, was: Any, now: Any) -> tuple[str, ...]:
    if isinstance(was, dict) and isinstance(now, dict):
        return tuple(
            change
            for key in {**was, **now}
            for change in _changes(f"{where}.{key}" if where else key, was.get(key), now.get(key))
        )
    alike = was == now and type(was) is type(now)
    return () if alike else (f"{where} was {shown(was)}, is now {shown(now)}",)
