"""The results of an experiment, to be read, kept and drawn."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from burrlab.bounds import shown
from burrlab.json_text import UNREADABLE, in_one_line
from burrlab.psychophysics.experiment.records import plain, restored
from burrlab.psychophysics.report import report, subject_table
from burrlab.psychophysics.report.scored_task import ScoredTask
from burrlab.psychophysics.report.threshold_task import ThresholdTask

_KIND = "burrlab analysis"
FORMAT = 1


@dataclass(frozen=True, repr=False, eq=False)
class Analysis:
    """The results of an experiment, made by `analyse`.

    Attributes
    ----------
    name : str
        Of the experiment.
    tasks : tuple of ScoredTask and ThresholdTask
    notes : tuple of str
        What is said above the tasks.
    provenance : mapping
        Versions and settings.
    """

    name: str
    tasks: tuple[ScoredTask | ThresholdTask, ...]
    notes: tuple[str, ...]
    provenance: Mapping[str, Any]

    def __getitem__(self, name: str) -> ScoredTask | ThresholdTask:
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

    def report(self, *, width: int | None = None) -> str:
        """All of it as text.

        Parameters
        ----------
        width : int, optional
            Of the screen, in characters: wider tables are parted between their groups of columns, sentences between words. By
            default lines are as long as they are.
        """
        return report.text(self, width)

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
            raise ValueError(f"{_KIND!r} must be {FORMAT}, got {shown(values.get(_KIND))}")
        made = restored(cls, values)
        if not (isinstance(made.tasks, tuple) and all(not isinstance(task, Mapping) for task in made.tasks)):
            raise ValueError("tasks must be a list of tasks with all that they hold")
        return made

    def to_json(self, file: str | os.PathLike[str] | IO[str]) -> None:
        """Write to a file that `from_json` reads back without loss."""
        _write(file, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")

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
        named = isinstance(file, (str, os.PathLike))
        name = os.fspath(file) if isinstance(file, (str, os.PathLike)) else str(getattr(file, "name", "JSON"))
        try:
            values = json.loads(Path(name).read_bytes() if named else file.read())  # type: ignore[union-attr]
        except (ValueError, RecursionError):
            raise ValueError(f"{name}: this is not JSON in UTF-8") from None
        if not isinstance(values, dict):
            raise ValueError(f"{name}: an analysis must be a JSON object, got {type(values).__name__}")
        try:
            return cls.from_dict(values)
        except UNREADABLE as error:
            told = in_one_line(error)
            raise ValueError(f"{name}: this is no analysis that was written here: {told}") from None

    def to_tsv(self, file: str | os.PathLike[str] | IO[str]) -> None:
        """One row a subject and task, tab-separated; n/a for nothing, inf for an open end."""
        _write(file, subject_table.text(self))

    def __eq__(self, other: object) -> bool:
        # A criterion may be NaN, which as a number differs from itself.
        return isinstance(other, Analysis) and self.to_dict() == other.to_dict()

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        kind = "simulated subjects, " if self.simulated else ""
        tasks = ", ".join(f"{task.name} (n = {len(task.subjects)})" for task in self.tasks)
        return f"Analysis({self.name!r}, {kind}{tasks})" if self.name else f"Analysis({kind}{tasks})"

    def _repr_html_(self) -> str:
        return report.html(self)


def _write(file: str | os.PathLike[str] | IO[str], text: str) -> None:
    if isinstance(file, (str, os.PathLike)):
        Path(file).write_text(text, encoding="utf-8")
    else:
        file.write(text)
