"""Results as plain objects for JSON and back without loss, by the types their fields are declared with."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

_UNIONS = (typing.Union, types.UnionType)
_SPELT = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


def plain(value: Any) -> Any:
    """Dataclasses as dicts of their fields, tuples and arrays as lists; JSON has no infinity: it is spelt "inf".

    Examples
    --------
    >>> plain({"interval": (0.5, float("inf"))})
    {'interval': [0.5, 'inf']}
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value


def restored(kind: type[T], values: Mapping[str, Any]) -> T:
    """The dataclass that `plain` took apart.

    Raises
    ------
    ValueError
        If a field is missing.
    """
    hints = typing.get_type_hints(kind)
    names = [f.name for f in dataclasses.fields(kind) if f.init]  # type: ignore[arg-type]
    missing = [name for name in names if name not in values]
    if missing:
        raise ValueError(f"{kind.__name__} needs {', '.join(missing)}, which the record does not have")
    return kind(**{name: _value(hints[name], values[name]) for name in names})


def _value(hint: Any, value: Any) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if value is None:
        return None
    if origin in _UNIONS:
        return _value(_of_union(arguments, value), value)
    if origin is tuple:
        kinds = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else arguments
        return tuple(_value(kind, part) for kind, part in zip(kinds, value, strict=True))
    if origin is list:
        return [_value(arguments[0], part) for part in value]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {name: _value(arguments[1], part) for name, part in value.items()}
    if hint is float:
        return _SPELT[value] if isinstance(value, str) else float(value)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return restored(hint, value)
    return value


def _of_union(kinds: tuple[Any, ...], value: Any) -> Any:
    """Which of several types a plain value was."""
    some = [kind for kind in kinds if kind is not type(None)]
    if len(some) == 1:
        return some[0]
    if isinstance(value, Mapping):
        for kind in some:
            if dataclasses.is_dataclass(kind) and {f.name for f in dataclasses.fields(kind) if f.init} == set(
                value
            ):
                return kind
    fitting = [kind for kind in some if isinstance(kind, type) and isinstance(value, kind)]
    return fitting[0] if fitting else float if float in some and value in tuple(_SPELT) else Any
