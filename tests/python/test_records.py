"""Results as plain objects and back."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from burrlab.common.records import plain, restored
from burrlab.psychophysics.rules import Counts


@dataclass(frozen=True)
class Inner:
    name: str
    interval: tuple[float, float]


@dataclass(frozen=True)
class Other:
    number: int


@dataclass(frozen=True)
class Outer:
    inner: Inner | None
    many: tuple[Inner | Other, ...]
    by_name: Mapping[str, float]
    value: float | None
    text: str | float
    listed: list[int]


def through_json(thing: object) -> object:
    return restored(type(thing), json.loads(json.dumps(plain(thing), allow_nan=False)))


@pytest.mark.parametrize("value", [None, 0.1, math.inf, -math.inf, 3.0])
@pytest.mark.parametrize("text", ["inf", "two", 0.5])
def test_round_trip(value: float | None, text: str | float) -> None:
    inner = Inner("inf", (0.1 + 0.2, math.inf))
    thing = Outer(inner, (inner, Other(3)), {"a": -math.inf}, value, text, [1, 2])
    assert through_json(thing) == thing
    assert through_json(Outer(None, (), {}, value, text, [])) == Outer(None, (), {}, value, text, [])


def test_nan_returns() -> None:
    back = through_json(Inner("x", (math.nan, 1.0)))
    assert isinstance(back, Inner)
    assert math.isnan(back.interval[0])


def test_a_float_stays_a_float() -> None:
    back = through_json(Inner("x", (1, 2)))
    assert isinstance(back, Inner)
    assert [type(end) for end in back.interval] == [float, float]


def test_numpy_becomes_plain() -> None:
    assert plain({"a": np.arange(2), "b": np.float64(np.inf)}) == {"a": [0, 1], "b": "inf"}


def test_counts() -> None:
    counts = Counts("abx", 3, 5, 1, 5, {"AB": (3, 5), "BA": (1, 5)})
    assert through_json(counts) == counts


def test_missing_field() -> None:
    with pytest.raises(ValueError, match="Inner needs interval, which the record does not have"):
        restored(Inner, {"name": "x"})
