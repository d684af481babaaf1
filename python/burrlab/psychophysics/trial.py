"""The parts of trials and designs: stimuli, intervals, orders, answers and questions."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal, TypeAlias

from burrlab._core import Material
from burrlab.bone.materials import constants_of
from burrlab.psychophysics.rules import TaskName, one_of

Mode: TypeAlias = Literal["probing", "drilling"]
Phase: TypeAlias = Literal["practice", "main", "catch"]

MODES: tuple[Mode, ...] = ("probing", "drilling")


@dataclass(frozen=True)
class Stimulus:
    """The material that an interval presents.

    Attributes
    ----------
    name : str
        As in the answer file.
    material : Material or None
        Material to render; None for a real specimen, outside the program.
    """

    name: str
    material: Material | None = None


@dataclass(frozen=True)
class Boundary:
    """Where another material begins, parallel to the surface.

    Attributes
    ----------
    depth : float
        Below the surface [mm]. A voxel belongs to the side of its centre.
    below : Material
        Of the shape and exponents of the material above.
    """

    depth: float
    below: Material


@dataclass(frozen=True)
class Interval:
    """One presentation of a stimulus.

    Attributes
    ----------
    stimulus : Stimulus
        With a boundary, the material above it.
    seed : int
        Seed of the erosion; each interval has its own.
    duration : float or None
        [s]; None if the subject ends the interval.
    boundary : Boundary or None
    """

    stimulus: Stimulus
    seed: int
    duration: float | None
    boundary: Boundary | None = None


@dataclass(frozen=True)
class Trial:
    """One question.

    Attributes
    ----------
    number : int
        In its phase, from 1.
    phase : {"practice", "main", "catch"}
        A catch trial stands among the main ones, is easy, and tells of lapses alone.
    block : int
        From 1; practice is block 0.
    trial_type : str
        Same-different: AA, AB, BA, BB. ABX: AB, BA, the order of the alternatives after the reference. Two
        intervals: RC, CR, the order of reference (R) and comparison (C), which has any boundary.
    intervals : tuple of Interval
        In the order of presentation.
    correct : str
        The correct answer.
    level : float or None
        The comparison's parameter over the reference's (constant stimuli and staircases).
    """

    number: int
    phase: Phase
    block: int
    trial_type: str
    intervals: tuple[Interval, ...]
    correct: str
    level: float | None = None


def key_of(name: str) -> str:
    """The key of a design's parameter in files; times and depths carry their unit."""
    return name + {"interval": "_s", "reference_interval": "_s", "boundary": "_mm"}.get(name, "")


def _plain(value: Any) -> Any:
    if not isinstance(value, Stimulus):
        return list(value) if isinstance(value, tuple) else value
    if (material := value.material) is None:
        return {"name": value.name, "real": True}
    return {
        "name": value.name,
        "material": material.name,
        **constants_of(material),
    }


class TaskDesign(ABC):
    """A task that one subject does in trials.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    mode : {"probing", "drilling"}
        Whether the burr is off or on.
    question : str
        Asked after the last interval.
    answers : tuple of str
        The possible responses, in the order of their keys.
    practice : int
        Trials before those that count.
    blocks : int
    """

    task: TaskName
    mode: Mode
    question: str
    answers: tuple[str, ...]
    practice: int
    blocks: int
    _kind: ClassVar[str]  # the design's name in files
    _derived: ClassVar[tuple[str, ...]] = ()  # properties that files hold besides the fields
    #: Later parameters with their defaults, which files leave out, so that orders are what they were.
    _since: ClassVar[Mapping[str, Any]] = {"catch": 0, "boundary": None, "foil": "either"}

    @abstractmethod
    def order(self, *, seed: int, subject: str) -> "Order":
        """The trials of one subject, which depend only on the design, the seed and the subject's name."""

    @abstractmethod
    def power(self, subjects: int = 1) -> str:
        """A few lines on what the design can show, before anybody takes part."""

    def to_dict(self) -> dict[str, Any]:
        """The whole design, for JSON and `design_of_dict`."""
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]  # all designs are dataclasses
        return {
            "design": self._kind,
            **{
                key_of(name): _plain(getattr(self, name))
                for name in (*names, *self._derived)
                if name not in self._since or getattr(self, name) != self._since[name]
            },
        }


class Order(ABC):
    """The trials of one subject, in order; those of a staircase depend on the answers.

    Attributes
    ----------
    answered : list of (Trial, str)
        Answered trials with their responses, in order.
    lost : set of int
        Places in `answered` of those that do not count.
    """

    def __init__(self, answers: tuple[str, ...]) -> None:
        self.answered: list[tuple[Trial, str]] = []
        self.lost: set[int] = set()
        self._answers = answers

    @property
    @abstractmethod
    def total(self) -> int:
        """Trials in all, practice included; for a staircase, the maximum."""

    @abstractmethod
    def next(self) -> Trial | None:
        """The next trial, which stays the same until it is answered; None at the end."""

    def answer(self, response: str, *, lost: bool = False) -> None:
        """Records the response to the next trial; one that is `lost` moves no staircase.

        Raises
        ------
        ValueError
            If the response is not one of the design's answers, or no trial is left.
        """
        if (trial := self.next()) is None:
            raise ValueError(f"there is no trial left to answer, got {response!r}")
        one_of("response", response, self._answers)
        self.lost |= {len(self.answered)} if lost else set()
        self.answered.append((trial, response))

    def counted(self) -> list[tuple[Trial, str]]:
        """Answered trials of the main phase that count."""
        return [x for i, x in enumerate(self.answered) if x[0].phase == "main" and i not in self.lost]
