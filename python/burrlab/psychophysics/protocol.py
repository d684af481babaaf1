"""An experiment's protocol, read from TOML. Every error names file, table and key in one sentence."""

import inspect
import math
import os
import sys
import tomllib
import types
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, Union, get_args, get_origin, get_type_hints

from burrlab._core import Burr, Material
from burrlab.bone.image import OccupancyMap, checked_point
from burrlab.bone.materials import materials as paper
from burrlab.bone.recipe import VolumeRecipe
from burrlab.bone.specimen import MOST_VOXELS, unit_vector
from burrlab.common.check import amend_error, content_of, refuse, shown
from burrlab.common.records import in_one_line
from burrlab.common.table import decoded, json_mapping
from burrlab.psychophysics.answers import AnswerFile, ExperimentFolder
from burrlab.psychophysics.designs import (
    ComparisonDesign,
    Order,
    Stimulus,
    TaskDesign,
    counterbalanced,
    key_of,
    rendered,
)
from burrlab.psychophysics.interval import Block, VolumeBlock, tissues_of
from burrlab.psychophysics.rules import KEYS, RULES, RuleName
from burrlab.psychophysics.side_car import SideCar, digest, read_side_car
from burrlab.psychophysics.staircase import DESIGNS
from burrlab.session.devices import device_limits
from burrlab.session.exchange import parse_device
from burrlab.theory.tool import PAPER_LAW

_REQUIRED = object()
#: A rule in words, and a function that tells whether a value obeys it.
Rule: TypeAlias = tuple[str, Callable[[Any], bool]]

#: Largest count, such as trials: no person answers more, and all orders are made beforehand.
_MOST = 10_000
_MOST_SUBJECTS = 9999
_LONGEST = 86400.0  # longest time, a day [s]

_TEXT: Rule = ("a text", lambda value: isinstance(value, str) and value != "")
_FLAG: Rule = ("true or false", lambda value: type(value) is bool)
_LIST: Rule = ("a list of numbers", lambda value: isinstance(value, list))
# TOML's whole numbers have no limit
_NUMBER: Rule = (
    "a finite number",
    lambda value: type(value) in (int, float) and abs(value) <= sys.float_info.max,
)
_AT_MOST_A_DAY: Rule = (f"at most {_LONGEST:g} [s]", lambda value: value <= _LONGEST)
_WAIT: tuple[Rule, ...] = (("at least 0", lambda value: value >= 0), _AT_MOST_A_DAY)
_KEYS: Rule = (
    'two signs that differ, none a space, such as "fj"',
    lambda value: (
        isinstance(value, str)
        and len(set(value)) == len(value) == 2
        and value.isprintable()
        and " " not in value
    ),
)


def _whole(most: int = 2**63 - 1) -> Rule:
    return f"a whole number from 0 to {most}", lambda value: type(value) is int and 0 <= value <= most


def _choice(names: Sequence[str]) -> Rule:
    return f"one of {', '.join(names)}", lambda value: value in names


class TomlTable:
    """A table of the file; its errors name file, table and key.

    Parameters
    ----------
    file : str
    name : str
        Name of the table; empty for the whole file.
    values : mapping
    """

    def __init__(self, file: str, name: str, values: Mapping[str, Any]) -> None:
        self.file, self.name, self._values = file, name, values
        self._known: dict[str, None] = {}

    def get(self, key: str, kind: Rule, *more: Rule, default: Any = _REQUIRED) -> Any:
        """The value of a key, which must obey the rules; numbers become floats; lists must hold numbers."""
        value = self.value(key, default)
        for rule, holds in (kind, *more) if key in self else ():
            self.refuse(not holds(value), f"{key} must be {rule}, got {shown(value)}")
            value = float(value) if kind is _NUMBER else value
        if kind is _LIST and key in self:
            return [TomlTable(self.file, self.name, {key: part}).get(key, _NUMBER) for part in value]
        return value

    def table(self, key: str, *, needed: bool = True) -> "TomlTable":
        """A table inside this one."""
        name = f"{self.name}.{key}" if self.name else key
        value = self.value(key, _REQUIRED if needed else {}, what=f"the table [{name}]")
        self.refuse(not isinstance(value, dict), f"{key} must be a table, [{name}], got {shown(value)}")
        return TomlTable(self.file, name, value)

    def tables(self) -> "Mapping[str, TomlTable]":
        """All tables inside this one, by key."""
        return {key: self.table(key) for key in self._values}

    def value(self, key: str, default: Any = _REQUIRED, *, what: str | None = None) -> Any:
        """The value of a key, as in the file."""
        self._known[key] = None
        self.refuse(key not in self and default is _REQUIRED, f"{what or key} is missing")
        return self._values.get(key, default)

    def done(self) -> None:
        """Raises ValueError if the table has a key that was never asked for."""
        for key in self._values:
            self.refuse(
                key not in self._known, f"unknown key {shown(key)}; known are {', '.join(self._known)}"
            )

    def error(self, sentence: object) -> ValueError:
        """A ValueError with the table's place before the sentence."""
        return ValueError(
            f"{self.file}, [{self.name}]: {sentence}" if self.name else f"{self.file}: {sentence}"
        )

    def refuse(self, broken: object, sentence: str) -> None:
        """Raises the `error` of a sentence if the rule is broken."""
        if broken:
            raise self.error(sentence)

    def errors(self) -> AbstractContextManager[None]:
        """A context whose errors get the place of this table."""
        return amend_error(str(self.error("")), kinds=(ValueError, TypeError, OSError))

    def __contains__(self, key: str) -> bool:
        return key in self._values


def designs_of_table(table: TomlTable, stimuli: Mapping[str, Stimulus]) -> list[TaskDesign]:
    """The design of a table, or one for each of its `references`.

    The keys are the parameters of the design's class; times end in _s. `references` are factors of a
    comparison's reference, along `direction` in (ln c_e, ln alpha), which is the parameter's by default. Beside
    them a whole number may be a list, one a reference.

    Raises
    ------
    ValueError
        If a key is unknown, missing or of another type, a material is unknown, or the design refuses a value.
    """
    kind = DESIGNS[table.get("design", _TEXT, _choice(tuple(DESIGNS)))]
    hints, options = get_type_hints(kind), {}
    for name, parameter in inspect.signature(kind).parameters.items():
        default = _REQUIRED if parameter.default is inspect.Parameter.empty else None
        listed = hints[name] is int and "references" in table and isinstance(table.value(name, None), list)
        options[name] = _read(table, key_of(name), list if listed else hints[name], stimuli, default)
    factors, direction, together = (
        table.get(key, kind_of_key, default=None) if issubclass(kind, ComparisonDesign) else None
        for key, kind_of_key in (("references", _LIST), ("direction", _LIST), ("interleave", _FLAG))
    )
    table.done()
    for name, lonely in (("direction", direction is not None), ("interleave", together)):
        table.refuse(lonely and factors is None, f"{name} goes with references")
    try:
        given = {name: value for name, value in options.items() if key_of(name) in table}
        if factors is None or not issubclass(kind, ComparisonDesign):
            return [kind(**given)]
        apart = [name for name, value in given.items() if hints[name] is int and isinstance(value, list)]
        return list(_at_references(kind, given, apart, factors, direction))
    except (ValueError, TypeError) as error:
        name, space, rest = str(error).partition(" ")
        raise table.error(f"{key_of(name)}{space}{rest}") from None


def _at_references(
    kind: type[ComparisonDesign], options: Mapping[str, Any], apart: Collection[str], factors: Sequence[float],
    direction: Sequence[float] | None,
) -> Iterator[TaskDesign]:  # fmt: skip
    """A design for each factor of the reference; the options `apart` are lists, one number for each."""
    refuse(not factors, "references must be two or more different factors, got none")
    for place in range(len(factors)):
        for name in apart:
            numbers = options[name]
            refuse(
                len(numbers) != len(factors)
                or not (numbers[place].is_integer() and 0 <= numbers[place] <= _MOST),
                f"{name} must be a whole number from 0 to {_MOST}, or one for each of references, got {numbers}",
            )
        design = kind(**{**options, **{name: int(options[name][place]) for name in apart}})
        yield list(design.around(factors, direction))[place]


def stimuli_of(table: TomlTable) -> dict[str, Stimulus]:
    """Stimuli by name: the paper's materials and those of the table [materials].

    Raises
    ------
    ValueError
        If a name is the paper's or has characters other than letters, digits, _ and -, a key is unknown,
        missing or of another type, or the values do not make a material.
    """
    stimuli = {name: Stimulus(name, material) for name, material in paper.items()}
    for name, stimulus in table.tables().items():
        table.refuse(name in paper, f"{name!r} is a material of the paper: choose another name")
        table.refuse(
            not (name.isascii() and name.replace("_", "").replace("-", "").isalnum()),
            f"a material's name must be of letters, digits, _ and -, got {name!r}",
        )
        material = None
        if not stimulus.get("real", _FLAG, default=False):
            at_most: Rule = "at most 1000 [N/mm^2]", lambda value: value <= 1000  # more is in Pa
            kinds = dict.fromkeys(("c_e", "alpha", *PAPER_LAW), _NUMBER) | {"shape": _TEXT, "source": _TEXT}
            options = {
                key: stimulus.get(
                    key,
                    kind,
                    *[at_most] * (key == "c_e"),
                    default=_REQUIRED if key in ("c_e", "alpha") else None,
                )
                for key, kind in kinds.items()
            }
            with stimulus.errors():
                material = Material(name, **{key: x for key, x in options.items() if x is not None})
        stimuli[name] = Stimulus(name, material)
        stimulus.done()
    return stimuli


def _read(table: TomlTable, key: str, kind: Any, stimuli: Mapping[str, Stimulus], default: Any) -> Any:
    """A value of the type of the design's parameter."""
    if get_origin(kind) in (Union, types.UnionType):
        kind = next(alternative for alternative in get_args(kind) if alternative is not type(None))
    if kind is Stimulus:
        name = table.get(key, _TEXT, default=default)
        table.refuse(
            name is not None and name not in stimuli,
            f"{key} must be a material, one of {', '.join(stimuli)}, got {name!r}",
        )
        return stimuli.get(name)
    if kind is float:
        return table.get(key, _NUMBER, *[_AT_MOST_A_DAY] * key.endswith("_s"), default=default)
    if get_origin(kind) is Literal:
        return table.get(key, _TEXT, _choice(get_args(kind)), default=default)
    return table.get(key, _whole(_MOST) if kind is int else _LIST, default=default)


@dataclass(frozen=True)
class AnalysisSettings:
    """Settings of the analysis, made before the first subject.

    Attributes
    ----------
    rules : tuple of str
        Decision rules for d'.
    delta : float or None
        d' below which two materials count as alike in the equivalence test; None for no test.
    level : float
        Level of the intervals.
    """

    rules: tuple[RuleName, ...] = RULES
    delta: float | None = None
    level: float = 0.95


def subjects_of(table: TomlTable) -> tuple[str, ...]:
    """Labels of the subjects of [experiment]."""
    value = table.get(
        "subjects",
        (
            "a number or a list of names",
            lambda listing: (
                type(listing) is int
                or (
                    isinstance(listing, list)
                    and listing != []
                    and all(isinstance(subject, str) for subject in listing)
                )
            ),
        ),
        (
            f"1 to {_MOST_SUBJECTS}, or a list of names",
            lambda listing: type(listing) is not int or 1 <= listing <= _MOST_SUBJECTS,
        ),
    )
    if type(value) is int:
        return tuple(f"{number:0{max(2, len(str(value)))}}" for number in range(1, value + 1))
    _check_labels(table, "a subject", value)
    return tuple(value)


def _check_labels(table: TomlTable, what: str, labels: list[str]) -> None:
    """Raises ValueError unless the labels can be part of file names on any file system."""
    seen: dict[str, str] = {}
    for label in labels:
        table.refuse(
            not (label.isascii() and label.isalnum()),
            f"{what}'s name must be of letters and digits, as BIDS labels are, got {shown(label)}",
        )
        if (other := seen.get(label.lower())) is not None:
            raise table.error(f"{what}'s name must be there once, got {shown(other)} and {label!r}")
        seen[label.lower()] = label


def device_of(table: TomlTable, folder: Path) -> str:
    """The device of [experiment]; the path of a script is relative to the folder."""
    text = table.get("device", _TEXT, default="hand")
    with table.errors(), amend_error("device "):
        device = parse_device(text)
    return f"scripted:{folder / device.file}" if device.kind == "scripted" else str(text)


def without_folder(device: str) -> str:
    """The text of a device without the folder of its script, so that machines agree."""
    kind, _, file = device.partition(":")
    return f"scripted:{Path(file).name}" if kind == "scripted" else device


def burr_and_bone_of(file: TomlTable, folder: Path) -> tuple[Burr, Block]:
    """The burr and bone of [burr] and [bone], which must fit; a volume's path is relative to the folder."""
    table = file.table("burr")
    radius = table.get("radius_mm", _NUMBER)
    table.done()
    with table.errors():
        burr = Burr(radius)
    table = file.table("bone")
    size, voxel = table.get("size_mm", _LIST), table.get("voxel_mm", _NUMBER)
    volume = _volume_of(table, folder)
    table.done()
    # Divided side by side: cubes of very small or large lengths underflow or overflow.
    if voxel > 0 and (voxels := math.prod(side / voxel for side in size)) > MOST_VOXELS:
        raise table.error(f"the block has {voxels:.3g} voxels, and {MOST_VOXELS:.3g} are the most")
    with table.errors():
        bone = Block(tuple(size), voxel) if volume is None else VolumeBlock(tuple(size), voxel, **volume)
        bone.check_burr(burr)
        bone.fresh() if volume else None  # an unreadable volume fails here, not in the first trial
    return burr, bone


def _volume_of(table: TomlTable, folder: Path) -> dict[str, Any] | None:
    """Arguments that make a `VolumeBlock` of [bone]; None if it names no volume."""
    path, options = table.get("volume", _TEXT, default=None), {}
    for key, kind in (
        ("map", _TEXT), ("entry_mm", _LIST), ("axis", _LIST), ("spacing_mm", _LIST), ("series", _TEXT),
        ("crop_mm", ("two corners, [[x, y, z], [x, y, z]]", lambda x: isinstance(x, list) and len(x) == 2)),
        ("volume_voxel_mm", _NUMBER), ("transpose", _FLAG),
    ):  # fmt: skip
        options[key] = table.get(key, kind, default=None)
        table.refuse(path is None and key in table, f"{key} goes with volume")
        needed = path is not None and key in ("map", "entry_mm", "axis")
        table.refuse(needed and key not in table, f"{key} is missing: volume needs it")
    if path is None:
        return None
    text, entry, axis, *others = options.values()
    with table.errors():
        return {
            "volume": VolumeRecipe(str(folder / path), OccupancyMap.parse(text), *others),
            "entry": tuple(checked_point(entry, "entry_mm").tolist()),
            "axis": tuple(unit_vector(axis).tolist()),
        }


def designs_of(file: TomlTable) -> tuple[Mapping[str, TaskDesign], tuple[tuple[str, ...], ...]]:
    """The designs of [tasks] by name, in the order of the file, with the stimuli of [materials]; those interleaved."""
    stimuli = stimuli_of(file.table("materials", needed=False))
    table = file.table("tasks")
    tables = table.tables()
    table.refuse(not tables, "there must be at least one task, [tasks.NAME]")
    _check_labels(table, "a task", list(tables))
    tasks: dict[str, TaskDesign] = {}
    interleaved = []
    for table_name, task_table in tables.items():
        designs = designs_of_table(task_table, stimuli)
        if task_table.get("interleave", _FLAG, default=False):
            interleaved.append(tuple(f"{table_name}{number}" for number in range(1, len(designs) + 1)))
        for number, design in enumerate(designs, 1):
            name = f"{table_name}{number}" if "references" in task_table else table_name
            task_table.refuse(name in tasks, f"its reference {number} is task {name}, which is there already")
            for other, known in tasks.items():
                task_table.refuse(
                    known.to_dict() == design.to_dict(),
                    f"this is task {other} again, trial by trial: give one of them more trials or blocks",
                )
            tasks[name] = design
    return types.MappingProxyType(tasks), tuple(interleaved)


def analysis_of(table: TomlTable) -> AnalysisSettings:
    """The settings of [analysis]."""
    some_rules: Rule = (
        f"a list of {', '.join(RULES)}, each once at most",
        lambda names: (
            isinstance(names, list)
            and names != []
            and all(rule in RULES for rule in names)
            and len({*names}) == len(names)
        ),
    )
    settings = AnalysisSettings(
        tuple(table.get("rules", some_rules, default=RULES)),
        table.get("delta", _NUMBER, ("a d' above 0", lambda value: value > 0), default=None),
        table.get("level", _NUMBER, ("from 0.5 to below 1", lambda value: 0.5 <= value < 1), default=0.95),
    )
    table.done()
    return settings


@dataclass(frozen=True)
class Protocol:
    """An experiment: subjects, tasks, burr, bone and folder.

    Attributes
    ----------
    path : Path
        Path of the TOML file.
    name : str
    seed : int
        Seed of all orders and intervals.
    subjects : tuple of str
        BIDS labels.
    tasks : mapping of str to TaskDesign
        In the order of the file.
    burr : Burr
    bone : Block
        Fresh for each interval.
    device : str
        As for `burrlab session --device`; a script's file is relative to the TOML file.
    lost_after : float
        Age of a network position at which the device counts as lost [ms].
    publish : int or None
        Port on which each interval is published over OpenIGTLink.
    folder : Path
        Folder of the data.
    trace : bool
        Whether the trace of each interval is kept.
    feedback : bool
        Whether practice tells the subject if an answer was right.
    pause : float
        Pause after an interval [s].
    rest : float
        Least rest between blocks and between tasks [s].
    selected_by : str or None
        How an earlier experiment selected the subjects; None if it did not.
    selected_from : int or None
        Number of subjects they were selected from; None without selection, or if unknown.
    analysis : AnalysisSettings
    keys : str
        Keys of the two answers, in their order.
    limits : str
        Model whose limits hold, as for `burrlab.Session`; "device", what the device's driver names, or "none".
    interleaved : tuple of tuples of str
        Tasks whose trials are asked among one another.
    """

    path: Path
    name: str
    seed: int
    subjects: tuple[str, ...]
    tasks: Mapping[str, TaskDesign]
    burr: Burr
    bone: Block
    device: str
    lost_after: float
    publish: int | None
    folder: Path
    trace: bool
    feedback: bool
    pause: float
    rest: float
    selected_by: str | None
    selected_from: int | None
    analysis: AnalysisSettings
    keys: str = KEYS
    limits: str = "device"
    interleaved: tuple[tuple[str, ...], ...] = ()

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "Protocol":
        """A protocol from TOML; docs/experiment_files.md explains the keys.

        Parameters
        ----------
        path : path

        Returns
        -------
        Protocol

        Raises
        ------
        ValueError
            If the file is not TOML in UTF-8, a key is unknown, missing, of another type or out of range, a
            material is unknown, a name is duplicate, or a subject's or task's name is not of letters and
            digits. The message names file, table and key.
        OSError
            If the file cannot be read.
        """
        path = Path(path)
        file_name = os.fspath(path)
        text = decoded(file_name, content_of(path))
        try:
            file = TomlTable(file_name, "", tomllib.loads(text))
        except ValueError as error:  # TOMLDecodeError, or a number of thousands of digits
            raise ValueError(f"{file_name}: this is not TOML: {error}") from None
        except RecursionError:
            raise ValueError(f"{file_name}: lists or tables are nested too deeply") from None
        experiment = file.table("experiment")
        get = experiment.get
        name, seed, subjects = get("name", _TEXT), get("seed", _whole()), subjects_of(experiment)
        burr, bone = burr_and_bone_of(file, path.parent)
        for key in ("materials", "tasks", "analysis"):
            file.value(key, None)
        file.done()
        tasks, interleaved = designs_of(file)
        protocol = cls(
            path=path,
            name=name,
            seed=seed,
            subjects=subjects,
            tasks=tasks,
            interleaved=interleaved,
            burr=burr,
            bone=bone,
            folder=path.parent / get("folder", _TEXT, default="data"),
            device=device_of(experiment, path.parent),
            lost_after=get("lost_after_ms", _NUMBER, ("positive", lambda value: value > 0), default=100.0),
            limits=get("limits", _choice(("device", "none", *device_limits)), default="device"),
            publish=get(
                "publish",
                ("a port, 1 to 65535", lambda value: type(value) is int and 0 < value < 65536),
                default=None,
            ),
            trace=get("trace", _FLAG, default=False),
            feedback=get("feedback", _FLAG, default=False),
            keys=get("keys", _KEYS, default=KEYS),
            pause=get("pause_s", _NUMBER, *_WAIT, default=1.0),
            rest=get("break_s", _NUMBER, *_WAIT, default=60.0),
            selected_by=get(
                "selected_by",
                _TEXT,
                # so that it fits in a field between tabs
                (
                    "without tabs, line breaks and quotation marks",
                    lambda value: not any(mark in value for mark in '\t\r\n"'),
                ),
                default=None,
            ),
            selected_from=get(
                "selected_from",
                _whole(),
                (f"more than the {len(subjects)} subjects", lambda value: value > len(subjects)),
                default=None,
            ),
            analysis=analysis_of(file.table("analysis", needed=False)),
        )
        experiment.done()
        comparisons = {task: x for task, x in tasks.items() if isinstance(x, ComparisonDesign)}
        for task, design in comparisons.items():
            file.refuse(
                design.boundary is not None and design.boundary[1] >= bone.size[2],
                f"boundary_mm of task {task} must lie in the bone, {bone.size[2]:g} mm deep",
            )
            for level in design.extremes():  # a level that no bone has would end the run in its trial
                with file.errors(), amend_error(f"level {level:g} of task {task} cannot be rendered: "):
                    below = rendered("the comparison", design.comparison(level))
                    if design.boundary is not None:
                        tissues_of(rendered("the reference", design.reference), below)
        return protocol

    def tasks_of(self, subject: str) -> tuple[str, ...]:
        """A subject's order of tasks, counterbalanced over the file's list of subjects.

        Raises
        ------
        ValueError
            If the protocol has no such subject.
        """
        place = self.subjects.index(self._known("subject", subject, self.subjects))
        return tuple(task for unit in counterbalanced(self.units, place) for task in unit)

    @property
    def units(self) -> list[tuple[str, ...]]:
        """Tasks that are done together; most are alone."""
        unit_of = {task: unit for unit in self.interleaved for task in unit}
        return list(dict.fromkeys(unit_of.get(task, (task,)) for task in self.tasks))

    def order(self, subject: str, task: str) -> Order:
        """The trials of a subject in a task, at their beginning.

        Raises
        ------
        ValueError
            If the protocol has no such subject or task.
        """
        # The task's name gives two tasks of one design different orders.
        return self.tasks[self._known("task", task, self.tasks)].order(
            seed=self.seed, subject=f"{self._known('subject', subject, self.subjects)} {task}"
        )

    def minutes(self, task: str) -> float:
        """Most minutes that a task takes a subject: intervals, pauses and breaks, without the time of answers.

        An interval that the subject ends counts only by its pause. Tasks that are interleaved share their breaks.
        """
        (unit,) = [unit for unit in self.units if task in unit]
        order, blocks = self.order(self.subjects[0], task), self.tasks[task].blocks
        trial = order.next()
        assert trial is not None
        intervals = sum((interval.duration or 0.0) + self.pause for interval in trial.intervals)
        return (order.total * intervals + (blocks - 1) * self.rest / len(unit)) / 60.0

    @property
    def data(self) -> ExperimentFolder:
        """The folder of the files."""
        return ExperimentFolder(self.folder, self.name)

    def side_car(
        self,
        subject: str,
        task: str,
        *,
        device: str | None = None,
        simulated: Mapping[str, Any] | None = None,
    ) -> SideCar:
        """The side-car of a run, as known before its first trial.

        Parameters
        ----------
        subject, task : str
        device : str, optional
            By default the protocol's.
        simulated : mapping, optional
            Description of a simulated subject.

        Raises
        ------
        ValueError
            If the protocol has no such subject or task.
        """
        order, design = self.order(subject, task), self.tasks[task]
        return SideCar(
            subject, task, design.task, design.to_dict(), self.to_dict(),
            without_folder(device or self.device), order.total, simulated,
        )  # fmt: skip

    def begin(
        self,
        subject: str,
        task: str,
        *,
        device: str | None = None,
        simulated: Mapping[str, Any] | None = None,
    ) -> tuple[AnswerFile, Order]:
        """A new file of answers for a run, and its trials; the subject is entered in participants.tsv.

        Raises
        ------
        FileExistsError
            If the run was already begun.
        ValueError
            If the protocol has no such subject or task, or is another one for the task than other subjects had, or
            simulated subjects would be mixed with people.
        OSError
            If a file cannot be written.
        """
        car = self.side_car(subject, task, device=device, simulated=simulated)
        other, notes = None, list[str]()
        for path in sorted(self.folder.glob(f"sub-*/beh/sub-*_task-{task}_events.json")):
            try:
                if (other := read_side_car(path)) is not None:
                    break
                notes.append(f"another subject's side-car was passed over: {path} is none of burrlab's")
            except (ValueError, OSError) as error:  # it stops the analysis, not this subject
                notes.append(f"another subject's side-car was passed over: {error}")
        changes = "; ".join(() if other is None else other.differences(car, across_subjects=True))
        refuse(changes, f"{self.path}: others had another task {task}: {in_one_line(changes, 2000)}")
        self.data.add(subject, simulated=simulated is not None, selected_by=self.selected_by)
        file = AnswerFile.create(self.data.answers(subject, task), car)
        file.notes = tuple(notes)
        return file, self.order(subject, task)

    def resume(
        self,
        subject: str,
        task: str,
        *,
        device: str | None = None,
        simulated: Mapping[str, Any] | None = None,
    ) -> tuple[AnswerFile, Order]:
        """The file of answers of a run that ended early, and its trials, fed with these answers.

        Raises
        ------
        FileNotFoundError
            If the run was not begun.
        BlockingIOError
            If another process has the file open.
        ValueError
            If the protocol lacks the subject or task or has changed since the run began, or the file is
            invalid.
        OSError
            If the file cannot be written.
        """
        order = self.order(subject, task)
        car = self.side_car(subject, task, device=device, simulated=simulated)
        return AnswerFile.open(self.data.answers(subject, task), order, car), order

    def to_dict(self) -> dict[str, Any]:
        """The whole protocol for JSON, without its place on the disk."""
        return json_mapping(
            {
                "experiment": {
                    "name": self.name,
                    "seed": self.seed,
                    "subjects": list(self.subjects),
                    "device": without_folder(self.device),
                    "lost_after_ms": self.lost_after,
                    "publish": self.publish,
                    "trace": self.trace,
                    "feedback": self.feedback,
                    "keys": self.keys,
                    "pause_s": self.pause,
                    "break_s": self.rest,
                    "selected_by": self.selected_by,
                    "selected_from": self.selected_from,
                    **({} if self.limits == "device" else {"limits": self.limits}),
                    **({"interleaved": self.interleaved} if self.interleaved else {}),
                },
                "burr": {"radius_mm": self.burr.radius},
                "bone": self.bone.plain(),
                "tasks": {name: design.to_dict() for name, design in self.tasks.items()},
                "analysis": {
                    "rules": list(self.analysis.rules),
                    "delta": self.analysis.delta,
                    "level": self.analysis.level,
                },
            }
        )

    @property
    def digest(self) -> str:
        """SHA-256 of `to_dict`."""
        return digest(self.to_dict())

    def __repr__(self) -> str:
        return (
            f"Protocol({self.name!r}, {len(self.subjects)} subjects, tasks {', '.join(self.tasks)}, "
            f"digest {self.digest[:12]})"
        )

    def _known(self, what: str, name: str, names: Collection[str]) -> str:
        refuse(name not in names, f"{self.path}: there is no {what} {name!r}; there are {', '.join(names)}")
        return name


_TEMPLATE = """\
# An experiment of burrlab: `burrlab experiment run FILE --subject 01`. All keys: docs/experiment_files.md.
# Examples that are switched off begin with # and no space after it.

[experiment]
name = "Bone and PVC, probed and drilled"
seed = 1                    # of all orders and intervals
subjects = 12               # a number (01, 02, ...) or a list of names of letters and digits
folder = "data"             # for the answers, beside this file
device = "hand"             # hand (simulated), igtl:HOST:PORT, touch[:NAME], omega[:N], haply[:HOST:PORT], vrpn:NAME@HOST, scripted:FILE
#lost_after_ms = 100.0      # a position over the network that old is a lost device
#publish = 18945            # port at which igtl's peer takes the force; without it there is none
trace = false               # true keeps a complete trace of every interval
feedback = false            # true tells the subject in practice whether the answer was right
keys = "12"                 # of the two answers, in their order
pause_s = 1.0               # after an interval
break_s = 60.0              # at least, between blocks
#selected_by = "score in an earlier experiment"   # if the subjects were: the report warns of it
#selected_from = 20         # of how many

[burr]
radius_mm = 3.0

[bone]                      # a block with its top at z = 0, fresh for each interval
size_mm = [30.0, 30.0, 20.0]
voxel_mm = 0.1

# Known are bone, pettigrew, pvc and expert, the paper's. Others, by name:
#[materials.soft]
#c_e = 1.9                  # [N/mm^2]
#alpha = 0.087              # [1/ms], for the shape
#shape = "parabolic"
#force_exponent = 1.5       # q of the force c_e R^2 (h/R)^q
#rate_exponent = 0.0        # m of the rate alpha (F/1 N)^m

# A real specimen, outside the program:
#[materials.specimen]
#real = true

# Each subject has all tasks, in counterbalanced order. This is the paper's Task 1.
[tasks.probing]
design = "same-different"   # AA, AB, BA, BB equally often
a = "bone"
b = "pvc"
mode = "probing"            # the burr does not turn
trials = 12                 # a multiple of 4
interval_s = 20.0
practice = 0                # trials before, which do not count
blocks = 1                  # with breaks between them

[tasks.drilling]
design = "same-different"
a = "bone"
b = "pvc"
mode = "drilling"
trials = 12
interval_s = 20.0

# The paper's Task 3: the real specimen as long as the subject likes, then two simulated ones. Which felt like it?
#[tasks.match]
#design = "abx"
#reference = "specimen"
#match = "pettigrew"        # the correct answer; without it the reference itself
#foil = "pvc"
#trials = 10
#interval_s = 10.0          # reference_interval_s = 10.0 would end the reference too

# How much stiffer must it be? Ratios of c_e to the reference's, each equally often.
#[tasks.levels]
#design = "constant-stimuli"
#reference = "bone"
#parameter = "c_e"
#levels = [1.05, 1.1, 1.2, 1.4, 1.8]
#repeats = 20
#interval_s = 5.0

# The same by a staircase, two correct answers down and one wrong up: 70.7 % correct.
#[tasks.staircase]
#design = "staircase"
#reference = "bone"
#parameter = "c_e"
#start = 2.0
#down = 2
#interval_s = 5.0

# The width of alpha by a Bayesian staircase; with the burr off alpha alone changes nothing.
#[tasks.adaptive]
#design = "adaptive"
#reference = "bone"
#parameter = "alpha"
#mode = "drilling"
#trials = 60
#interval_s = 5.0

[analysis]                  # settled before the first subject; it goes into every file
rules = ["independent-observations", "differencing"]
level = 0.95
#delta = 1.5                # d' below which the two count as alike: an equivalence test
"""


def template() -> str:
    """TOML of the paper's Task 1, with a commented-out example of every other design.

    Examples
    --------
    >>> print(template().splitlines()[3])
    [experiment]
    """
    return _TEMPLATE
