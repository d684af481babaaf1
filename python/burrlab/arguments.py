"""Checks of what the public functions are given."""

from __future__ import annotations

import operator
import reprlib

import numpy as np
from numpy.typing import NDArray


def require_type(name: str, value: object, kind: type, example: str) -> None:
    """TypeError in one sentence unless `value` is a `kind`."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be a {kind.__name__}, such as {example}, got {value!r}")


def real(value: object, name: str) -> NDArray[np.float64]:
    """A copy in float64; ValueError in one sentence for what is not real: complex numbers, flags, bytes, 10**400."""
    try:
        found = np.asarray(value)
        if found.dtype.kind in "iufUO":
            return np.array(found, np.float64)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(f"{name} must be of real numbers that a float holds, got {reprlib.repr(value)}")


def whole(name: str, value: object, end: int, end_text: str) -> int:
    """ValueError in one sentence unless it is a whole number from 0 and below `end`; True and False are none."""
    try:
        number = -1 if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = -1
    if not 0 <= number < end:
        raise ValueError(f"{name} must be a whole number from 0 and below {end_text}, got {value!r}")
    return number
