"""The JSON beside a file of answers: what a run is, before its first trial."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from burrlab._core import __version__
from burrlab.bounds import shown
from burrlab.csv_text import plain
from burrlab.provenance import provenance
from burrlab.psychophysics.designs.design_record import design_of_dict
from burrlab.psychophysics.experiment.answer_row import ANSWERS, INTERVALS, TYPES, columns_of
from burrlab.psychophysics.rules import TASKS, TaskName

_FORMAT = 1
_KEY = "BurrlabRun"
#: Of the tables of a protocol, those whose change makes another run; of [experiment], these keys.
_TABLES = ("burr", "bone")
_EXPERIMENT = ("seed", "feedback", "pause_s", "break_s")

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


@dataclass(frozen=True)
class SideCar:
    """What is known of a run before its first trial.

    Attributes
    ----------
    subject : str
        BIDS label, without "sub-".
    name : str
        Of the task in the protocol, a BIDS label.
    task : {"same-different", "abx", "2ifc"}
    question : str
        Put to the subject.
    design : mapping
        As its `to_dict` has it.
    protocol : mapping
        The whole protocol, as JSON.
    seed : int
        Of the protocol.
    device : str
        As given to `burrlab session --device`.
    trials : int
        In all, practice included; of a staircase, at most.
    simulated : mapping or None
        What simulates the subject; None for a person.
    started : str
        Wall clock (ISO 8601, UTC) to which onsets count.
    provenance : mapping
    """

    subject: str
    name: str
    task: TaskName
    question: str
    design: Mapping[str, Any]
    protocol: Mapping[str, Any]
    seed: int
    device: str
    trials: int
    simulated: Mapping[str, Any] | None = None
    started: str = field(default_factory=lambda: datetime.now(UTC).isoformat())
    provenance: Mapping[str, Any] = field(default_factory=lambda: plain(provenance()))

    def __post_init__(self) -> None:
        for name in ("design", "protocol", "provenance"):
            object.__setattr__(self, name, plain(getattr(self, name)))
        if self.simulated is not None:
            object.__setattr__(self, "simulated", plain(self.simulated))

    @property
    def answers(self) -> tuple[str, str]:
        """In the order of their keys."""
        return ANSWERS[self.task]

    @property
    def digest(self) -> str:
        """sha256 of the protocol."""
        return digest(self.protocol)

    def differences(self, other: SideCar) -> tuple[str, ...]:
        """What another run of this subject and task would change: sentences, empty where nothing matters.

        Neither the list of subjects, folder, traces, the settings of the analysis and other tasks, nor the address of a
        device count.
        """
        mine, others = (
            {"subject": one.subject, "simulated subject": one.simulated, **one._shared()}
            for one in (self, other)
        )
        return _changes("", mine, others)

    def differences_across_subjects(self, other: SideCar) -> tuple[str, ...]:
        """The same for another subject's run of this task, which may differ in who the subject is."""
        return _changes("", self._shared(), other._shared())

    def _shared(self) -> dict[str, Any]:
        experiment = self.protocol.get("experiment", {})
        return {
            "task": self.name,
            "experiment": {key: experiment.get(key) for key in _EXPERIMENT} | {"seed": self.seed},
            "device": self.device.partition(":")[0],
            # Over the network it is whether a hand feels anything; which port is nobody's business.
            "force is published": experiment.get("publish") is not None,
            **{key: self.protocol.get(key) for key in _TABLES},
            f"tasks.{self.name}": self.design,
        }

    def to_dict(self) -> dict[str, Any]:
        """As the file has it, with the columns described."""
        return {
            "TaskName": self.name,
            "TaskDescription": _DESCRIBED[self.task],
            "Instructions": self.question,
            "StimulusPresentation": {
                "OperatingSystem": f"{platform.system()} {platform.release()}",
                "SoftwareName": "burrlab",
                "SoftwareVersion": __version__,
            },
            _KEY: _FORMAT,
            "Subject": self.subject,
            "Task": self.task,
            "Answers": list(self.answers),
            "Simulated": self.simulated is not None,
            "SimulatedSubject": self.simulated,
            "Started": self.started,
            "Seed": self.seed,
            "Device": self.device,
            "Trials": self.trials,
            "Design": self.design,
            "Protocol": self.protocol,
            "ProtocolDigest": self.digest,
            "Provenance": self.provenance,
            **descriptions(self.task),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> SideCar:
        """What `to_dict` described.

        Raises
        ------
        ValueError
            If a key is missing or not what it must be.
        """
        if values.get(_KEY) != _FORMAT:
            raise ValueError(f"{_KEY} must be {_FORMAT}, got {shown(values.get(_KEY))}")
        text = {
            key: _typed(values, key, str)
            for key in ("Subject", "TaskName", "Instructions", "Started", "Device")
        }
        task = _typed(values, "Task", str)
        if task not in TASKS:
            raise ValueError(f"Task must be one of {', '.join(TASKS)}, got {task!r}")
        simulated = _typed(values, "SimulatedSubject", dict) if _typed(values, "Simulated", bool) else None
        try:
            if datetime.fromisoformat(text["Started"]).tzinfo is None:
                raise ValueError
        except ValueError:
            raise ValueError(f"Started must be a time with its zone, got {text['Started']!r}") from None
        car = cls(
            text["Subject"], text["TaskName"], task, text["Instructions"], _typed(values, "Design", dict),
            _typed(values, "Protocol", dict), _typed(values, "Seed", int), text["Device"], _typed(values, "Trials", int),
            simulated, text["Started"], _typed(values, "Provenance", dict),
        )  # fmt: skip
        if values.get("ProtocolDigest") != car.digest:
            raise ValueError(
                "ProtocolDigest does not belong to the Protocol beside it: one of them was changed"
            )
        car._check_against_protocol()
        return car

    def _check_against_protocol(self) -> None:
        """ValueError if what is told of the Protocol once more, for readers, is told otherwise: the digest is of it alone."""
        experiment, tasks = (self.protocol.get(key, {}) for key in ("experiment", "tasks"))
        if not (isinstance(experiment, dict) and isinstance(tasks, dict)):
            raise ValueError("Protocol must have tables of the experiment and its tasks")
        for key, found, due in (
            ("Design", self.design, tasks.get(self.name)),
            ("Seed", self.seed, experiment.get("seed")),
        ):
            if found != due:
                raise ValueError(f"{key} is not that of the Protocol beside it: one of them was changed")
        made = design_of_dict(self.design)
        due = made.order(seed=self.seed, subject=f"{self.subject} {self.name}").total
        if (self.task, self.trials) != (made.task, due):
            raise ValueError(
                f"Task and Trials must be {made.task!r} and {due}, those of the Design, got {self.task!r} and {self.trials}"
            )


def side_car_path(path: str | os.PathLike[str]) -> Path:
    """Of the JSON beside a TSV."""
    return Path(path).with_suffix(".json")


def read_side_car(path: str | os.PathLike[str]) -> SideCar | None:
    """The side-car beside a file of answers; None where there is none, or another program's.

    Raises
    ------
    ValueError
        If it is no JSON, or one of this program with a key that is missing or not what it must be.
    """
    file = side_car_path(path)
    if not file.exists():
        return None
    try:
        values = json.loads(file.read_bytes())
    except (ValueError, RecursionError):
        raise ValueError(f"{file}: this is not JSON in UTF-8") from None
    if not isinstance(values, dict) or _KEY not in values:
        return None
    try:
        return SideCar.from_dict(values)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def digest(protocol: Mapping[str, Any]) -> str:
    """sha256 of a protocol's JSON, keys in order."""
    text = json.dumps(plain(protocol), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def descriptions(task: TaskName) -> dict[str, Any]:
    """Of the columns, as BIDS has them: unit or levels."""
    what = {
        "onset": ("Start of the first interval, from the start of the run", "s"),
        "duration": ("From the onset to the end of the last interval", "s"),
        "response_time": ("From the question to the key", "s"),
        "trial": ("Number of the trial in its phase, from 1", None),
        "repeats": ("How often the trial was broken off and begun anew, as the loop had stalled", None),
        "block": ("Number of the block, from 1; practice is block 0", None),
        "level": ("The comparison's parameter over the reference's", "1"),
    }
    described: dict[str, Any] = {
        name: {"Description": text, **({"Units": unit} if unit else {})}
        for name, (text, unit) in what.items()
    }
    described["trial_type"] = {
        "Description": _TYPES[task],
        "Levels": {one: f"correct answer: {due}" if due else one for one, due in TYPES[task].items()},
    }
    described["response"] = {
        "Description": "The subject's answer",
        "Levels": {answer: f"key {key}" for key, answer in enumerate(ANSWERS[task], start=1)},
    }
    described["correct"] = {
        "Description": "Whether the response was correct",
        "Levels": {"1": "correct", "0": "wrong"},
    }
    described["phase"] = {
        "Description": "Part of the run",
        "Levels": {"practice": "not analysed", "main": "analysed"},
    }
    for place in range(1, INTERVALS[task] + 1):
        described[f"stimulus_{place}"] = {"Description": f"Material of interval {place}"}
        described[f"seed_{place}"] = {"Description": f"Seed of the erosion in interval {place}, 64 bits"}
        described[f"ended_{place}"] = {"Description": f"How interval {place} ended", "Levels": _ENDED}
    return {column: described[column] for column in columns_of(task)}


def _typed(values: Mapping[str, Any], key: str, kind: type) -> Any:
    if key not in values:
        raise ValueError(f"{key} is missing")
    if type(values[key]) is not kind:
        raise ValueError(f"{key} must be {_KINDS[kind]}, got {shown(values[key])}")
    return values[key]


def _changes(where: str, was: Any, now: Any) -> tuple[str, ...]:
    if isinstance(was, dict) and isinstance(now, dict):
        keys = [*was, *(key for key in now if key not in was)]
        return tuple(
            change
            for key in keys
            for change in _changes(f"{where}.{key}" if where else key, was.get(key), now.get(key))
        )
    return (
        () if was == now and type(was) is type(now) else (f"{where} was {shown(was)}, is now {shown(now)}",)
    )
