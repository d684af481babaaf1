"""A design from what its `to_dict` wrote beside the answers."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from burrlab._core import Material
from burrlab.common.check import shown
from burrlab.psychophysics.designs import ABX, SameDifferent
from burrlab.psychophysics.staircase import AdaptiveStaircase, ConstantStimuli, Staircase
from burrlab.psychophysics.trial import Design, Stimulus

_KINDS: Mapping[str, type[Design]] = {
    "same-different": SameDifferent,
    "abx": ABX,
    "constant-stimuli": ConstantStimuli,
    "staircase": Staircase,
    "adaptive": AdaptiveStaircase,
}


def design_of_dict(values: Mapping[str, Any]) -> Design:
    """The design that `Design.to_dict` described.

    Raises
    ------
    ValueError
        If the design is unknown, or what it needs is missing or wrong.

    Examples
    --------
    >>> from burrlab import materials
    >>> design = SameDifferent(*(Stimulus(name, materials[name]) for name in ("bone", "pvc")))
    >>> design_of_dict(design.to_dict()).to_dict() == design.to_dict()
    True
    """
    kind = values.get("design")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError(f"design must be one of {', '.join(_KINDS)}, got {shown(kind)}")
    made = _KINDS[kind]
    given: dict[str, Any] = {}
    for name, parameter in inspect.signature(made).parameters.items():
        key = f"{name}_s" if f"{name}_s" in values else name
        if key in values:
            value = values[key]
            given[name] = _stimulus(value) if isinstance(value, Mapping) else value
        elif parameter.default is inspect.Parameter.empty:
            raise ValueError(f"design {kind} needs {name}, which is missing")
    return made(**given)


def _stimulus(values: Mapping[str, Any]) -> Stimulus:
    if values.get("real"):
        return Stimulus(values["name"])
    return Stimulus(
        values["name"],
        Material(
            values["material"],
            c_e=values["c_e_N_per_mm2"],
            alpha=values["alpha_per_ms"],
            shape=values["shape"],
        ),
    )
