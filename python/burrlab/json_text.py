"""JSON text from elsewhere: whatever is wrong with it, one sentence."""

from __future__ import annotations

import json
import math
import re
import reprlib
import textwrap
from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

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
