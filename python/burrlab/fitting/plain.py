"""A fit as plain objects, and back without loss."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from burrlab._core import Shape
from burrlab.curve import VelocityCurve
from burrlab.depth_trace import DepthTrace
from burrlab.fitting.calibration import Scatter
from burrlab.fitting.evidence import Evidence
from burrlab.fitting.hypotheses import HypothesisTest
from burrlab.fitting.intervals import LEVELS, Combination, Interval, Profile, Region
from burrlab.fitting.observations import Data
from burrlab.fitting.search import Start
from burrlab.fitting.verdict import Ridge
from burrlab.fitting.voxel import VoxelTable
from burrlab.indentation import Indentation
from burrlab.json_text import record

if TYPE_CHECKING:
    from burrlab.fitting.record import FitRecord

_RENAMED = {"radius": "radius_mm", "residual_norm": "residual"}
_KINDS: dict[str, type[Data]] = {
    "velocity": VelocityCurve,
    "indentation": Indentation,
    "trace": DepthTrace,
}


def to_dict(fit: FitRecord) -> dict[str, Any]:
    """See `Fit.to_dict`."""
    values = {_RENAMED.get(f.name, f.name): _plain(getattr(fit, f.name)) for f in fields(fit)}
    values["data"] = [
        {"kind": next(kind for kind, made in _KINDS.items() if isinstance(one, made))} | _plain(one)
        for one in fit.data
    ]
    identified = fit.identified
    said = {
        "intervals": {
            name: {level: _ends(levels[level]) for level in LEVELS} for name, levels in fit.intervals.items()
        },
        "identified": None
        if identified is None
        else {
            "exponent": identified.exponent,
            "value": identified.value,
            "interval": _ends(identified.interval),
        },
        "separately_identified": fit.separately_identified,
        "verdict": fit.verdict,
        "version": fit.provenance.get("burrlab"),
    }
    return values | said


def from_dict(plain: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a Fit. See `Fit.from_dict`."""
    values = {name: plain[_RENAMED.get(name, name)] for name in _fields()}
    return values | {
        "shape": Shape(values["shape"]),
        "residual_norm": _number(values["residual_norm"]),
        "residuals": _array(values["residuals"]),
        "predicted": _array(values["predicted"]),
        "bounds": {name: tuple(map(float, values["bounds"][name])) for name in ("c_e", "alpha")},
        "given_bounds": tuple(values["given_bounds"]),
        "starts": tuple(_start(**start) for start in values["starts"]),
        "evidence": _optional(values["evidence"], _evidence),
        "lack_of_fit": _optional(values["lack_of_fit"], _test),
        "fall": _optional(values["fall"], _test),
        "table": _optional(values["table"], _table),
        "record": tuple(tuple(point) for point in values["record"]),
        "data": tuple(_data(**one) for one in values["data"]),
        "provenance": dict(values["provenance"]),
    }


def _fields() -> list[str]:
    from burrlab.fitting.record import FitRecord

    return [f.name for f in fields(FitRecord)]


def _optional(value: Any, made: Callable[..., Any]) -> Any:
    return None if value is None else made(**value)


def _start(**values: Any) -> Start:
    ends = {name: tuple(values[name]) for name in ("start", "end")}
    return record(Start, **values | ends | {"objective": _number(values["objective"], math.inf)})


def _test(**values: Any) -> HypothesisTest:
    return record(HypothesisTest, **values | {"freedom": tuple(values["freedom"])})


def _table(**values: Any) -> VoxelTable:
    return record(VoxelTable, **values | {"coefficients": _array(values["coefficients"])})


def _evidence(**values: Any) -> Evidence:
    ridge = values["ridge"]
    better = values["better"]
    return record(
        Evidence,
        **values
        | {
            "information": _array(values["information"]),
            "scatters": tuple(record(Scatter, **one) for one in values["scatters"]),
            "shares": _array(values["shares"]),
            "profile": _profile(**values["profile"]),
            "ridge": record(Ridge, **ridge | {"residual": _number(ridge["residual"], math.inf)}),
            "better": None if better is None else tuple(better),
        },
    )


def _profile(**values: Any) -> Profile:
    arrays = ("c_e", "c_e_rise", "best_alpha", "alpha", "alpha_rise")
    identified = values["identified"]
    return record(
        Profile,
        **values
        | {name: _array(values[name]) for name in arrays}
        | {
            "intervals": {name: _levels(levels) for name, levels in values["intervals"].items()},
            "identified": record(Combination, **identified | {"intervals": _levels(identified["intervals"])}),
            "regions": {level: _region(**region) for level, region in values["regions"].items()},
            "at_infinity": _number(values["at_infinity"]),
        },
    )


def _levels(levels: Mapping[str, Any]) -> dict[str, Interval]:
    return {level: record(Interval, **interval) for level, interval in levels.items()}


def _region(**values: Any) -> Region:
    arrays = {name: _array(values[name]) for name in ("c_e", "lower", "upper")}
    return record(Region, **values | arrays)


def _data(kind: str, **values: Any) -> Data:
    return _KINDS[kind](**{name: _floats(value) for name, value in values.items()})


def _floats(value: Any) -> Any:
    """A list of numbers with None for NaN, as an array; anything else as it is."""
    if isinstance(value, list) and all(part is None or isinstance(part, float) for part in value):
        return _array(value)
    return value


def _ends(interval: Interval) -> list[float | None]:
    return [interval.lower, interval.upper]


def _plain(value: Any) -> Any:
    if isinstance(value, Shape):
        return value.name
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value) if f.init}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): _plain(part) for name, part in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _number(value: float | None, missing: float = math.nan) -> float:
    return missing if value is None else float(value)


def _array(values: Any) -> Any:
    """Nested lists with None for NaN, as an array."""
    return np.array(values, dtype=np.float64)
