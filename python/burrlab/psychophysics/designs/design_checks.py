"""Checks of what designs are given, and how they are written down."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any

from burrlab.arguments import require_type
from burrlab.psychophysics.trial import Stimulus


def whole(name: str, value: int, *, at_least: int, multiple: int = 1, why: str = "") -> int:
    """An int, or one sentence."""
    number = operator.index(value)
    if number < at_least:
        raise ValueError(f"{name} must be at least {at_least}, got {number}")
    if number % multiple:
        raise ValueError(f"{name} must be a multiple of {multiple}{why}, got {number}")
    return number


def balanced_trials(trials: int, blocks: int, practice: int, *, multiple: int, types: str) -> None:
    """One sentence unless the types of trials can be equally often, in blocks of one size."""
    whole("trials", trials, at_least=multiple, multiple=multiple, why=f" ({types} equally often)")
    whole("blocks", blocks, at_least=1)
    whole("trials", trials, at_least=multiple, multiple=blocks, why=", the number of blocks")
    whole("practice", practice, at_least=0)


def seconds(name: str, value: float) -> float:
    """A time [s] above 0, or one sentence."""
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be a time above 0 [s], got {value}")
    return float(value)


def one_of(name: str, value: str, choices: Sequence[str]) -> None:
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}")


def rendered(name: str, stimulus: Stimulus) -> None:
    """One sentence unless the stimulus has a material."""
    require_type(name, stimulus, Stimulus, "Stimulus('bone', materials['bone'])")
    if stimulus.material is None:
        raise ValueError(
            f"{name} must have a material to be rendered, got the real specimen {stimulus.name!r}"
        )


def stimulus_dict(stimulus: Stimulus) -> dict[str, Any]:
    """For JSON; units in the names."""
    material = stimulus.material
    if material is None:
        return {"name": stimulus.name, "real": True}
    return {
        "name": stimulus.name,
        "material": material.name,
        "c_e_N_per_mm2": material.c_e,
        "alpha_per_ms": material.alpha,
        "shape": material.shape.name,
    }


def checked_answers(levels: Sequence[float], correct: Sequence[bool]) -> tuple[list[float], list[bool]]:
    """Levels and answers of trials, one each.

    Raises
    ------
    ValueError
        If there are not as many of one as of the other, or a level is no ratio above 0 other than 1.
    """
    if len(levels) != len(correct):
        raise ValueError(f"levels and correct must be equally many, got {len(levels)} and {len(correct)}")
    return [checked_level("level", level) for level in levels], [bool(right) for right in correct]


def checked_level(name: str, level: float) -> float:
    """A ratio above 0 that is not 1, or one sentence."""
    value = float(level)
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be a ratio above 0, got {value}")
    if value == 1.0:
        raise ValueError(f"{name} must differ from 1, got 1: two alike intervals have no correct answer")
    return value
