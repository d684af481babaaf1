"""The answers of one subject in one task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from burrlab.dataset import DataSet, html_table
from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.experiment.answer_row import (
    ANSWERS,
    COUNTED,
    Row,
    columns_of,
)
from burrlab.psychophysics.experiment.side_car import SideCar
from burrlab.psychophysics.rules import TaskName


@dataclass(frozen=True, eq=False, repr=False)
class Answers(DataSet):
    """The answers of one subject in one task.

    Attributes
    ----------
    subject : str
        BIDS label, without "sub-".
    name : str
        Of the task in the protocol, a BIDS label.
    task : {"same-different", "abx", "2ifc"}
    rows : tuple of Row
        One an answer, practice included, in order.
    side_car : SideCar or None
        None for a file of another program.
    notes : tuple of str
        What the reader should know, such as a last line that was broken off.
    source : str
        The file.
    """

    subject: str
    name: str
    task: TaskName
    rows: tuple[Row, ...]
    side_car: SideCar | None = None
    notes: tuple[str, ...] = ()
    source: str = ""

    @property
    def main(self) -> tuple[Row, ...]:
        """The rows of the main phase."""
        return tuple(row for row in self.rows if row.phase == "main")

    @property
    def simulated(self) -> bool:
        """Whether the subject was; False where the file does not say."""
        return self.side_car is not None and self.side_car.simulated is not None

    @property
    def trials(self) -> int | None:
        """Of the whole run, practice included, of a staircase at most; None where the file does not say."""
        return None if self.side_car is None else self.side_car.trials

    def counts(self) -> Counts:
        """Hits and false alarms of the main phase, with those of each trial type.

        Raises
        ------
        ValueError
            If there is no answer of the main phase.
        """
        rows, answers, counted = self.main, ANSWERS[self.task], COUNTED[self.task]
        if not rows:
            raise ValueError(f"{self}: there is no answer of the main phase to count")
        given = np.array([row.response == counted for row in rows])
        signal = np.array([row.correct_answer(answers) == counted for row in rows])
        kinds = np.array([row.trial_type for row in rows])
        return Counts(
            self.task,
            hits=int((given & signal).sum()),
            signals=int(signal.sum()),
            false_alarms=int((given & ~signal).sum()),
            noises=int((~signal).sum()),
            by_type={
                str(kind): (int(given[kinds == kind].sum()), int((kinds == kind).sum()))
                for kind in np.unique(kinds)
            },
        )

    def _table(self) -> Mapping[str, Sequence[Any]]:
        rows = [row.fields() for row in self.rows]
        columns = [column for column in columns_of(self.task) if not rows or column in rows[0]]
        return {column: [row[column] for row in rows] for column in columns}

    def __repr__(self) -> str:
        kind = "a simulated subject" if self.simulated else "subject"
        practice = len(self.rows) - len(self.main)
        text = f"Answers({kind} {self.subject}, task {self.name} ({self.task}), {len(self.main)} answers"
        text += f" and {practice} in practice" if practice else ""
        return text + "".join(f"; {note}" for note in self.notes) + ")"

    def _repr_html_(self) -> str:
        table = {
            name: ["" if value is None else value for value in values]
            for name, values in self._table().items()
        }
        return html_table(repr(self), table)
