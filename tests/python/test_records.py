"""Results as plain objects, and back."""

import json
import math
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from burrlab._core import Burr, Material, Shape
from burrlab.common.records import Codec
from burrlab.psychophysics.rules import Counts

SPELT = Codec("spelt")


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
    return SPELT.made(type(thing), json.loads(json.dumps(SPELT.plain(thing), allow_nan=False)))


@pytest.mark.parametrize(
    ("value", "text"), [(None, "inf"), (0.1, "two"), (math.inf, 0.5), (-math.inf, "two"), (3.0, 0.5)]
)
def test_round_trip(value: float | None, text: str | float) -> None:
    inner = Inner("inf", (0.1 + 0.2, math.inf))
    for parts in ((inner, (inner, Other(3)), {"a": -math.inf}), (None, (), {})):
        thing = Outer(*parts, value, text, [1, 2])
        assert through_json(thing) == thing


def test_floats_and_numpy() -> None:
    back: Any = through_json(Inner("x", (math.nan, 1)))
    assert math.isnan(back.interval[0])
    assert [type(end) for end in back.interval] == [float, float]
    assert SPELT.plain({"a": np.arange(2), "b": np.float64(np.inf)}) == {"a": [0, 1], "b": "inf"}
    counts = Counts("abx", 3, 5, 1, 5, {"AB": (3, 5), "BA": (1, 5)})
    assert through_json(counts) == counts


class Point(NamedTuple):
    x: float
    y: float


@dataclass(frozen=True)
class Everything:
    burr: Burr
    material: Material | None
    shape: Shape
    number: float
    count: int
    flag: bool
    kind: Literal["a", "b"]
    folder: str
    point: Point
    pairs: tuple[tuple[float, float], ...]
    values: NDArray[np.float64]
    one: Inner | Other
    farthest: float
    about: dict[str, Any]


CODEC = Codec(
    keys={Everything: {name: name for name in Everything.__annotations__ if name != "number"}
          | {"number_mm": "number", "twice": lambda thing: 2 * thing.number},
          Material: {"parts": lambda m: {x: getattr(m, x) for x in ("name", "c_e", "alpha", "shape", "source")}}},
    null={(Everything, "farthest"): math.inf}, kinds={"inner": Inner, "other": Other},
)  # fmt: skip
WHOLE = Everything(
    Burr(2.5), Material("bone", c_e=1.5, alpha=0.02, shape="power(2)", source="here"), Shape("linear"), math.nan, 3, True, "b", "x", Point(1.0, math.nan),
    ((1.0, 2.0),), np.array([[1.0, math.nan]]), Other(4), math.inf, {"path": Path("/a"), "size": (np.int64(2), np.inf)},
)  # fmt: skip


def test_all_kinds_return() -> None:
    taken = json.loads(json.dumps(CODEC.plain(WHOLE), allow_nan=False))
    assert taken["twice"] is taken["number_mm"] is None
    assert taken["one"] == {"kind": "other", "number": 4}
    assert taken["about"] == {"path": "/a", "size": [2, None]}
    back = CODEC.made(Everything, taken)
    np.testing.assert_array_equal(back.values, WHOLE.values)
    assert math.isnan(back.number)
    assert isinstance(back.point, Point)
    assert math.isnan(back.point.y)
    same = {"values": None, "number": 0.0, "point": Point(1.0, 0.0), "about": None}
    assert replace(back, **same) == replace(WHOLE, **same)
    assert CODEC.made(Everything, taken | {"material": None}).material is None


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("number_mm", "3", "number must be float, got '3'"),
        ("number_mm", True, "number must be float, got True"),
        ("number_mm", math.inf, "number must be finite, got inf"),
        ("count", 2.9, "count must be int, got 2.9"),
        ("count", True, "count must be int, got True"),
        ("flag", "no", "flag must be bool, got 'no'"),
        ("flag", 1, "flag must be bool, got 1"),
        ("folder", None, "folder must be str, got None"),
        ("kind", "c", "kind must be one of a, b, got 'c'"),
        ("burr", -1, "burr: "),
        ("material", {"name": "x"}, "material must be what makes a Material"),
        ("shape", 3, "shape must be what makes a Shape, got 3"),
        ("pairs", [[1, 2], [1, "a"]], "pairs[1][1] must be float, got 'a'"),
        ("pairs", [[1, 2, 3]], "pairs[0] must have 2 values, got 3"),
        ("pairs", "ab", "pairs must be list, got 'ab'"),
        ("values", [1, [2]], "values must be of numbers, got list"),
        ("values", ["1"], "values must be of numbers, got str"),
        ("one", {"kind": "third"}, "one: kind must be one of inner, other, got 'third'"),
        ("one", {"kind": "inner", "name": "x"}, "one: Inner needs interval, which the record does not have"),
        ("about", [1], "about must be dict, got [1]"),
        ("more", 1, "must not have the key 'more'"),
    ],
)
def test_what_is_refused(key: str, value: object, told: str) -> None:
    with pytest.raises(ValueError, match=re.escape(told)):
        CODEC.made(Everything, CODEC.plain(WHOLE) | {key: value})


def test_cattrs_is_imported_where_it_is_used() -> None:
    made = "import sys, burrlab; burrlab.Fit, burrlab.Descent; assert 'cattrs' not in sys.modules"
    subprocess.run([sys.executable, "-c", made], check=True)
