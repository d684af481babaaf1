"""JSON text from elsewhere: whatever is wrong with it, one sentence.

Results as plain objects for JSON and back without loss, by the types their fields are declared with.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
import reprlib
import textwrap
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

Made = TypeVar("Made")

#: What text leads to that is nested too deeply, too large, or of another kind than it should be.
UNREADABLE = (
    LookupError,
    TypeError,
    ValueError,
    ArithmeticError,
    AttributeError,
    RecursionError,
    SyntaxError,
)
_KINDS: dict[str, tuple[type, ...]] = {
    "float": (float, int, type(None)), "int": (int,), "str": (str,), "ResidualKind": (str,), "bool": (bool,), "None": (type(None),)
}  # fmt: skip  # None: what is not finite, in a fit's JSON


def parsed(
    name: str, text: str | bytes, what: str, make: Callable[[Any], Made], *, finite: bool = True
) -> Made:
    """What `make` makes of the values in JSON; ValueError that names the file where there is no such thing in it."""
    hooks: dict[str, Any] = (
        {"parse_int": _whole, "parse_float": _real, "parse_constant": _real} if finite else {}
    )
    try:
        return make(json.loads(text, **hooks))
    except UNREADABLE as error:
        said = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{name}: this is not {what} ({in_one_line(said)})") from None


def in_one_line(error: object, most: int = 200) -> str:
    """What was raised by something from elsewhere, as another sentence may quote it."""
    return re.sub(r"[\0-\x1f\x7f\ud800-\udfff]", "\ufffd", textwrap.shorten(str(error), most))


def check_texts(value: object) -> None:
    """ValueError where a text in a JSON value has control characters or half a character, as no name has."""
    if re.search(r"[\ud800-\udfff]|(?<!\\)(?:\\\\)*\\[bfnrtu]", json.dumps(value, ensure_ascii=False)):
        raise ValueError("a text has control characters")


def record(kind: Callable[..., Made], **values: Any) -> Made:
    """A dataclass of values from JSON; TypeError or OverflowError where a number, text or flag is none that its field holds."""
    for field in fields(kind):  # type: ignore[arg-type]
        named = [_KINDS.get(part) for part in str(field.type).split(" | ")]
        value = values.get(field.name)
        if field.name in values and not any(kinds is None or type(value) in kinds for kinds in named):
            raise TypeError(f"{field.name} must be {field.type}, got {reprlib.repr(value)}")
        float(value) if type(value) is int else None
    return kind(**values)


def _whole(text: str) -> int:
    number = int(text)
    float(number)
    return number


def _real(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text} is not finite")
    return number


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
