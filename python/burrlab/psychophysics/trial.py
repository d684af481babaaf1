"""What a trial is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from burrlab._core import Material

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
