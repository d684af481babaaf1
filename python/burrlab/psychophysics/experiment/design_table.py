"""Designs from the tables of a protocol."""

from __future__ import annotations

import inspect
import types
from collections.abc import Mapping
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from burrlab._core import Material
from burrlab.materials import materials as paper
from burrlab.psychophysics.design import Design
from burrlab.psychophysics.designs.abx import ABX
from burrlab.psychophysics.designs.adaptive import AdaptiveStaircase
from burrlab.psychophysics.designs.constant_stimuli import ConstantStimuli
from burrlab.psychophysics.designs.same_different import SameDifferent
from burrlab.psychophysics.designs.staircase import Staircase
from burrlab.psychophysics.experiment.toml_table import Table
from burrlab.psychophysics.trial import Stimulus

DESIGNS: Mapping[str, type[Design]] = {
    "same-different": SameDifferent,
    "abx": ABX,
    "constant-stimuli": ConstantStimuli,
    "staircase": Staircase,
    "adaptive": AdaptiveStaircase,
}
#: Parameters in seconds, whose keys say so.
_SECONDS = ("interval", "reference_interval")

#: Of anything that is counted, such as trials: more than one person answers. All orders are made before the first trial.
_MOST = 10_000
_LONGEST = 86400.0  # [s], a day


def design_of(table: Table, stimuli: Mapping[str, Stimulus]) -> Design:
    """The design of a table: its keys are the parameters of the design's class, times with _s behind them.

    Raises
    ------
    ValueError
        If a key is unknown, missing or of another type, a material is unknown, or the design refuses a value.
    """
    kind = DESIGNS[table.text("design", choices=tuple(DESIGNS))]
    hints = get_type_hints(kind)
    given: dict[str, Any] = {}
    for name, parameter in inspect.signature(kind).parameters.items():
        key = key_of(name)
        needed = parameter.default is inspect.Parameter.empty
        value = _read(table, key, hints[name], stimuli, needed=needed)
        if key in table:
            given[name] = value
    table.done()
    try:
        return kind(**given)
    except (ValueError, TypeError) as error:
        name, space, rest = str(error).partition(" ")
        raise table.error(f"{key_of(name)}{space}{rest}") from None


def key_of(name: str) -> str:
    """The key of a design's parameter."""
    return f"{name}_s" if name in _SECONDS else name


def stimuli_of(table: Table) -> dict[str, Stimulus]:
    """The paper's materials by name, and those of the table [materials].

    Raises
    ------
    ValueError
        If a name is one of the paper's or has other characters than letters, digits, _ and -, a key is unknown, missing or
        of another type, or the values are no material.
    """
    stimuli = {name: Stimulus(name, material) for name, material in paper.items()}
    for name, one in table.tables().items():
        if name in paper:
            raise table.error(f"{name!r} is a material of the paper: choose another name")
        if not (name.isascii() and name.replace("_", "").replace("-", "").isalnum()):
            raise table.error(f"a material's name must be of letters, digits, _ and -, got {name!r}")
        stimuli[name] = Stimulus(name, None if one.flag("real", False) else _material(name, one))
        one.done()
    return stimuli


def _material(name: str, table: Table) -> Material:
    values: dict[str, Any] = {"c_e": table.number("c_e"), "alpha": table.number("alpha")}
    for key in ("shape", "source"):
        if (value := table.text(key, None)) is not None:
            values[key] = value
    with table.errors():
        return Material(name, **values)


def _read(table: Table, key: str, kind: Any, stimuli: Mapping[str, Stimulus], *, needed: bool) -> Any:
    """A value of the type that the design's parameter has."""
    default = () if needed else (None,)
    if get_origin(kind) in (Union, types.UnionType):
        kind = next(one for one in get_args(kind) if one is not type(None))
    if kind is Stimulus:
        name = table.text(key, *default)
        if name is not None and name not in stimuli:
            raise table.error(f"{key} must be a material, one of {', '.join(stimuli)}, got {name!r}")
        return stimuli.get(name)
    if get_origin(kind) is Literal:
        return table.text(key, *default, choices=get_args(kind))
    if kind is int:
        return table.whole(key, *default, most=_MOST)
    readers = {float: table.number, bool: table.flag, str: table.text}
    value = readers.get(kind, table.numbers)(key, *default)
    if key.endswith("_s") and key in table and value > _LONGEST:
        raise table.error(f"{key} must be at most {_LONGEST:g} [s], got {value!r}")
    return value
