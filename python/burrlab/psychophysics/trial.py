"""What trials and designs are made of: stimuli, intervals, an order, answers and a question."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal, TypeAlias

from burrlab._core import Material
from burrlab.psychophysics.rules import TaskName, one_of

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
        Same-different: AA, AB, BA, BB; ABX: AB, BA, the order of the two alternatives after the reference;
        two intervals: the order of reference (R) and comparison (C), RC or CR.
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


def key_of(name: str) -> str:
    """The key of a design's parameter in files; a time says its unit."""
    return f"{name}_s" if name in ("interval", "reference_interval") else name


def _plain(value: Any) -> Any:
    if not isinstance(value, Stimulus):
        return list(value) if isinstance(value, tuple) else value
    if (material := value.material) is None:
        return {"name": value.name, "real": True}
    return {
        "name": value.name, "material": material.name, "c_e_N_per_mm2": material.c_e,
        "alpha_per_ms": material.alpha, "shape": material.shape.name,
    }  # fmt: skip


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
        The possible responses, in the order of their keys 1, 2.
    """

    task: TaskName
    mode: Mode
    question: str
    answers: tuple[str, ...]
    _kind: ClassVar[str]  # in files
    _derived: ClassVar[tuple[str, ...]] = ()  # properties that files have beside the fields

    @abstractmethod
    def order(self, *, seed: int, subject: str) -> Order:
        """The trials of one subject, a function of the design, the seed and the subject's name alone."""

    @abstractmethod
    def power(self, subjects: int = 1) -> str:
        """What the design can show, in a few lines, before anybody has taken part."""

    def to_dict(self) -> dict[str, Any]:
        """For JSON, and `design_of_dict`; the whole design."""
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]  # all designs are dataclasses
        return {
            "design": self._kind,
            **{key_of(name): _plain(getattr(self, name)) for name in (*names, *self._derived)},
        }


class Order(ABC):
    """The trials of one subject, one after the other; a staircase's depend on the answers.

    Attributes
    ----------
    answered : list of (Trial, str)
        With the responses, in order.
    """

    answered: list[tuple[Trial, str]]
    _answers: tuple[str, ...]

    @property
    @abstractmethod
    def total(self) -> int:
        """Trials in all, practice included; of a staircase, at most."""

    @abstractmethod
    def next(self) -> Trial | None:
        """The next trial, the same until it is answered; None at the end."""

    def answer(self, response: str) -> None:
        """Of the next trial.

        Raises
        ------
        ValueError
            If the response is not one of the design's answers, or there is no trial left.
        """
        if (trial := self.next()) is None:
            raise ValueError(f"there is no trial left to answer, got {response!r}")
        one_of("response", response, self._answers)
        self.answered.append((trial, response))
