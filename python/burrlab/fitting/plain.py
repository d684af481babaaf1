"""A fit as plain objects, and back without loss."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from burrlab._core import Shape
from burrlab.curve import VelocityCurve
from burrlab.fitting.search import Start
from burrlab.fitting.verdict import Ridge

if TYPE_CHECKING:
    from burrlab.fitting.result import Fit

_RENAMED = {"radius": "radius_mm", "residual_norm": "residual"}
_CURVE_NUMBERS = ("force", "velocity", "sigma", "window_start", "window_end")


def to_dict(fit: Fit) -> dict[str, Any]:
    """See `Fit.to_dict`."""
    values = {_RENAMED.get(f.name, f.name): _plain(getattr(fit, f.name)) for f in fields(fit)}
    return values | {"version": fit.provenance.get("burrlab")}


def from_dict(plain: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a Fit. See `Fit.from_dict`."""
    values = {name: plain[_RENAMED.get(name, name)] for name in _fields()}
    curve = dict(values["curve"])
    for name in _CURVE_NUMBERS:
        curve[name] = None if curve[name] is None else _numbers(curve[name])
    return values | {
        "shape": Shape(values["shape"]),
        "residual_norm": _number(values["residual_norm"]),
        "residuals": np.array(_numbers(values["residuals"])),
        "predicted": np.array(_numbers(values["predicted"])),
        "bounds": {name: tuple(pair) for name, pair in values["bounds"].items()},
        "starts": tuple(_start(**start) for start in values["starts"]),
        "record": tuple(tuple(_numbers(point)) for point in values["record"]),
        "ridge": Ridge(**values["ridge"] | {"residual": _number(values["ridge"]["residual"], math.inf)}),
        "curve": VelocityCurve(**curve),
    }


def _fields() -> list[str]:
    from burrlab.fitting.result import Fit

    return [f.name for f in fields(Fit)]


def _start(**values: Any) -> Start:
    ends = {name: tuple(values[name]) for name in ("start", "end")}
    return Start(**values | ends | {"objective": _number(values["objective"], math.inf)})


def _plain(value: Any) -> Any:
    if isinstance(value, Shape):
        return value.name
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): _plain(part) for name, part in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _number(value: float | None, missing: float = math.nan) -> float:
    return missing if value is None else float(value)


def _numbers(values: list[float | None]) -> list[float]:
    return [_number(value) for value in values]
