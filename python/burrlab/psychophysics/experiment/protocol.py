"""An experiment as its TOML file has it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from burrlab._core import Burr
from burrlab.csv_text import plain
from burrlab.psychophysics.design import Design, Order
from burrlab.psychophysics.designs.orders import counterbalanced
from burrlab.psychophysics.experiment.answer_file import AnswerFile
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.experiment.experiment_folder import ExperimentFolder
from burrlab.psychophysics.experiment.protocol_tables import (
    AnalysisSettings,
    analysis_of,
    burr_and_bone_of,
    designs_of,
    device_of,
    network_of,
    seconds_of,
    selected_from_of,
    selection_of,
    subjects_of,
    without_folder,
)
from burrlab.psychophysics.experiment.side_car import SideCar, digest
from burrlab.psychophysics.experiment.toml_table import read_toml

__all__ = ["AnalysisSettings", "Protocol"]


@dataclass(frozen=True)
class Protocol:
    """An experiment: subjects, tasks, what is burred with what, and where its files go.

    Attributes
    ----------
    path : Path
        Of the TOML file.
    name : str
    seed : int
        Of all orders and intervals.
    subjects : tuple of str
        BIDS labels.
    tasks : mapping of str to Design
        In the order of the file.
    burr : Burr
    bone : Block
        Fresh for each interval.
    device : str
        As for `burrlab session --device`; a script's file is relative to the TOML file.
    lost_after : float
        A position over the network that old is a lost device [ms].
    publish : int or None
        Port on which each interval is published over OpenIGTLink.
    folder : Path
        Of the data.
    trace : bool
        Whether the trace of each interval is kept.
    feedback : bool
        Whether the subject is told in practice if the answer was right.
    pause : float
        After an interval [s].
    rest : float
        Between blocks and between tasks, at least [s].
    selected_by : str or None
        How the subjects were chosen by the outcome of an earlier experiment; None if they were not.
    selected_from : int or None
        How many they were chosen from; None if they were not, or it is not known.
    analysis : AnalysisSettings
    """

    path: Path
    name: str
    seed: int
    subjects: tuple[str, ...]
    tasks: Mapping[str, Design]
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

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Protocol:
        """A protocol from TOML. docs/experiment.md has the keys.

        Parameters
        ----------
        path : path

        Returns
        -------
        Protocol

        Raises
        ------
        ValueError
            If the file is no TOML in UTF-8, a key is unknown, missing, of another type or out of range, a material is unknown,
            a name is there twice, or subject and task names are not of letters and digits: with file, table and key.
        OSError
            If the file cannot be read.
        """
        path = Path(path)
        file = read_toml(os.fspath(path), path.read_bytes())
        experiment = file.table("experiment")
        name = experiment.text("name")
        seed = experiment.whole("seed")
        subjects = subjects_of(experiment)
        folder = path.parent / experiment.text("folder", "data")
        device = device_of(experiment, path.parent)
        lost_after, publish = network_of(experiment)
        trace, feedback = experiment.flag("trace", False), experiment.flag("feedback", False)
        pause, rest = (
            seconds_of(experiment, key, value) for key, value in (("pause_s", 1.0), ("break_s", 60.0))
        )
        selected_by = selection_of(experiment)
        selected_from = selected_from_of(experiment, len(subjects))
        experiment.done()
        burr, bone = burr_and_bone_of(file, path.parent)
        tasks = designs_of(file)
        analysis = analysis_of(file.table("analysis", needed=False))
        file.done()
        return cls(
            path, name, seed, subjects, tasks, burr, bone, device, lost_after, publish, folder, trace, feedback, pause,
            rest, selected_by, selected_from, analysis,
        )  # fmt: skip

    def tasks_of(self, subject: str) -> tuple[str, ...]:
        """The order in which a subject has the tasks, counterbalanced over the subjects as the file lists them.

        Raises
        ------
        ValueError
            If the protocol has no such subject.
        """
        return tuple(counterbalanced(tuple(self.tasks), self.subjects.index(self._checked(subject))))

    def order(self, subject: str, task: str) -> Order:
        """The trials of a subject in a task, at their beginning.

        Raises
        ------
        ValueError
            If the protocol has no such subject or task.
        """
        # Two tasks of one design have orders of their own.
        return self._design(task).order(seed=self.seed, subject=f"{self._checked(subject)} {task}")

    @property
    def data(self) -> ExperimentFolder:
        """Where the files go."""
        return ExperimentFolder(self.folder, self.name)

    def side_car(
        self,
        subject: str,
        task: str,
        *,
        device: str | None = None,
        simulated: Mapping[str, Any] | None = None,
    ) -> SideCar:
        """What is known of a run before its first trial.

        Parameters
        ----------
        subject, task : str
        device : str, optional
            By default the protocol's.
        simulated : mapping, optional
            What simulates the subject.

        Raises
        ------
        ValueError
            If the protocol has no such subject or task.
        """
        design, order = self._design(task), self.order(subject, task)
        return SideCar(
            subject, task, design.task, design.question, design.to_dict(), self.to_dict(), self.seed,
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
            If the run was begun before.
        ValueError
            If the protocol has no such subject or task, or simulated subjects would be among others.
        OSError
            If a file cannot be written.
        """
        car = self.side_car(subject, task, device=device, simulated=simulated)
        self.data.add(subject, simulated=simulated is not None, selected_by=self.selected_by)
        return AnswerFile.create(self.data.answers(subject, task), car), self.order(subject, task)

    def resume(
        self,
        subject: str,
        task: str,
        *,
        device: str | None = None,
        simulated: Mapping[str, Any] | None = None,
    ) -> tuple[AnswerFile, Order]:
        """The file of answers of a run that was ended early, and its trials, fed with the answers that are there.

        Raises
        ------
        FileNotFoundError
            If the run was not begun.
        BlockingIOError
            If another process has it open.
        ValueError
            If the protocol has no such subject or task, was changed since the run began, or the file is not right.
        OSError
            If the file cannot be written.
        """
        order = self.order(subject, task)
        car = self.side_car(subject, task, device=device, simulated=simulated)
        return AnswerFile.open(self.data.answers(subject, task), order, car), order

    def to_dict(self) -> dict[str, Any]:
        """The whole protocol, as JSON; where it lies on the disk is not in it."""
        return plain(
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
                    "pause_s": self.pause,
                    "break_s": self.rest,
                    "selected_by": self.selected_by,
                    "selected_from": self.selected_from,
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
        """sha256 of `to_dict`."""
        return digest(self.to_dict())

    def __repr__(self) -> str:
        tasks = ", ".join(self.tasks)
        return f"Protocol({self.name!r}, {len(self.subjects)} subjects, tasks {tasks}, digest {self.digest[:12]})"

    def _checked(self, subject: str) -> str:
        if subject not in self.subjects:
            raise ValueError(
                f"{self.path}: there is no subject {subject!r}; there are {', '.join(self.subjects)}"
            )
        return subject

    def _design(self, task: str) -> Design:
        if task not in self.tasks:
            raise ValueError(f"{self.path}: there is no task {task!r}; there are {', '.join(self.tasks)}")
        return self.tasks[task]
