"""Answers of a task, subject by subject, as an analysis takes them in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from burrlab.psychophysics.counts import Counts


@dataclass(frozen=True)
class SubjectData:
    """Main trials of one subject.

    Attributes
    ----------
    subject : str
    counts : Counts
    planned : int or None
        Main trials of the design; None where it is not known, or the answers end it.
    simulated : bool
    levels : tuple of (float, int, int)
        Level, correct answers, trials: of the tasks that vary a parameter.
    """

    subject: str
    counts: Counts
    planned: int | None = None
    simulated: bool = False
    levels: tuple[tuple[float, int, int], ...] = ()

    @property
    def complete(self) -> bool:
        """Whether all planned trials were answered."""
        return self.planned is None or self.counts.trials >= self.planned


@dataclass(frozen=True)
class TaskData:
    """A task and those who did it.

    Attributes
    ----------
    name : str
    subjects : sequence of SubjectData
    design : mapping
        As `Design.to_dict` has it; empty where the counts came alone.
    of : int
        Subjects that those here were selected from; as many as there are without selection.
    selected_by : str
        What they were selected by; "" without selection.
    """

    name: str
    subjects: Sequence[SubjectData]
    design: Mapping[str, Any] = field(default_factory=dict)
    of: int = 0
    selected_by: str = ""
