"""What a trial is made of.

What every design of an experiment has: trials in an order, answers, a question.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from burrlab._core import Material
from burrlab.psychophysics.rules import TaskName

Mode: TypeAlias = Literal["probing", "drilling"]
Phase: TypeAlias = Literal["practice", "main"]

MODES: tuple[Mode, ...] = ("probing", "drilling")


@dataclass(frozen=True)
class Stimulus:
    """What an interval presents.

    Attributes
    ----------
    name : str
        As the answers' file has it.
    material : Material or None
        To be rendered; None for a real specimen, outside the program.
    """

    name: str
    material: Material | None = None


@dataclass(frozen=True)
class Interval:
    """A stimulus for a time.

    Attributes
    ----------
    stimulus : Stimulus
    seed : int
        Of the erosion; each interval has its own.
    duration : float or None
        [s]; None: until the subject ends it.
    """

    stimulus: Stimulus
    seed: int
    duration: float | None


@dataclass(frozen=True)
class Trial:
    """One question.

    Attributes
    ----------
    number : int
        In its phase, from 1.
    phase : {"practice", "main"}
    block : int
        From 1; practice is block 0.
    trial_type : str
        Same-different: AA, AB, BA, BB; ABX: AB, BA, the order of the two alternatives after the reference; two
        intervals: the order of reference (R) and comparison (C), RC or CR.
    intervals : tuple of Interval
        In the order of presentation.
    correct : str
        The correct answer.
    level : float or None
        Of the comparison's parameter, as its ratio to the reference's (constant stimuli and staircases).
    """

    number: int
    phase: Phase
    block: int
    trial_type: str
    intervals: tuple[Interval, ...]
    correct: str
    level: float | None = None


class Design(ABC):
    """A task for one subject, in trials.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    mode : {"probing", "drilling"}
        With the burr off, or on.
    question : str
        Put to the subject after the last interval.
    answers : tuple of str
        The set that a response is from, in the order of their keys 1, 2.
    """

    task: TaskName
    mode: Mode
    question: str
    answers: tuple[str, ...]

    @abstractmethod
    def order(self, *, seed: int, subject: str) -> Order:
        """The trials of one subject, a function of the design, the seed and the subject's name alone."""

    @abstractmethod
    def power(self, subjects: int = 1) -> str:
        """What the design can show, in a few lines, before anybody has taken part."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """For JSON; the whole design."""


class Order(ABC):
    """The trials of one subject, one after the other; a staircase's depend on the answers.

    Attributes
    ----------
    answered : list of (Trial, str)
        With the responses, in order.
    """

    answered: list[tuple[Trial, str]]

    @property
    @abstractmethod
    def total(self) -> int:
        """Trials in all, practice included; of a staircase, at most."""

    @abstractmethod
    def next(self) -> Trial | None:
        """The next trial, the same until it is answered; None at the end."""

    @abstractmethod
    def answer(self, response: str) -> None:
        """Of the next trial.

        Raises
        ------
        ValueError
            If the response is not one of the design's answers, or there is no trial left.
        """
