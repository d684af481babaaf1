"""What the result of a scored task and that of one with thresholds have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from burrlab.psychophysics.report.task_data import design_text


class OneSubject(Protocol):
    """One subject's result, whatever the task."""

    @property
    def subject(self) -> str: ...
    @property
    def simulated(self) -> bool: ...


Subject = TypeVar("Subject", bound=OneSubject)


@dataclass(frozen=True)
class TaskResult(Generic[Subject]):
    """A task, who did it, and what its title must tell; the kinds of tasks add what was found.

    Attributes
    ----------
    name : str
    design : mapping
        As `Design.to_dict` has it; empty where the counts came alone.
    level : float
        Of all intervals.
    subjects : tuple
    left_out : tuple of str
        Subjects whose run is incomplete, with how far they came.
    of : int
        Subjects that those here were selected from; 0 without selection, or where it is not known.
    chosen : int
        Subjects that were selected: more than those here while some are still to come; 0 as above.
    selected_by : str
    """

    name: str
    design: Mapping[str, Any]
    level: float
    subjects: tuple[Subject, ...]
    left_out: tuple[str, ...]
    of: int
    chosen: int
    selected_by: str

    @property
    def chance(self) -> float:
        """Proportion correct of a subject who guesses; all tasks have two answers."""
        return 0.5

    @property
    def simulated(self) -> bool:
        """Whether any subject was."""
        return any(one.simulated for one in self.subjects)

    @property
    def selected(self) -> bool:
        """Whether the subjects are some of those who took part."""
        return bool(self.of or self.selected_by)

    @property
    def title(self) -> str:
        """Of figures: name, what was compared, and what must not be overlooked of the subjects."""
        about = design_text(self.design)
        text = f"{self.name}: {about}" if about else self.name
        said = ["simulated subjects"] if self.simulated else []
        if self.selected:
            said.append(self.selected_text if self.of else "selected subjects")
        return f"{text} ({'; '.join(said)})" if said else text

    @property
    def selected_text(self) -> str:
        """How many, of how many that were selected, of how many."""
        n = len(self.subjects)
        return (
            f"{n} selected of {self.of}"
            if n == self.chosen
            else f"{n} of {self.chosen} selected of {self.of}"
        )

    def subject(self, name: str) -> Subject:
        """One subject's result.

        Raises
        ------
        ValueError
            If there is none of that name.
        """
        for one in self.subjects:
            if one.subject == name:
                return one
        raise ValueError(
            f"subject must be one of {', '.join(one.subject for one in self.subjects)}, got {name!r}"
        )
