"""What every design of an experiment has: trials in an order, answers, a question."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from burrlab.psychophysics.rules import TaskName
from burrlab.psychophysics.trial import Mode, Trial


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
