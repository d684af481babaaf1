"""One sentence for a call of the core whose arguments do not fit: which parameter, the rule, the value received."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

import burrlab._core as _core
from burrlab.common.check import nearest, shown

#: What in pybind11's message becomes a name of `_KINDS`, one after the other; what the user gave goes away.
_SHORT = (
    (r"\nInvoked with(.|\n)*", ""),
    (r"typing\.SupportsFloat \| typing\.SupportsIndex", "number"),
    (r"typing\.SupportsInt \| typing\.SupportsIndex", "whole"),
    (r"burrlab\._core\.|collections\.abc\.|typing\.|typing_extensions\.|numpy\.", ""),
    (r'Annotated\[(ArrayLike, float64, "\[3, 1\]"|Sequence\[number\], "FixedSize\(3\)")\]', "point"),
    (r'Annotated\[Sequence\[whole\], "FixedSize\(3\)"\]', "voxel"),
    (r'Annotated\[(ArrayLike, \w+|Sequence\[point\], "FixedSize\(3\)")\]', "array"),
    (r"<[^<>\n]*>|burrlab::\w+", "..."),
)
# "1. Burr(radius: ...)" of a constructor, "1. (self: ..., dt: ...) -> ..." of others
_SIGNATURE = re.compile(r"^ +\d+\. (?:\w+\((.*)\)|\((.*?)\) -> .*)$", re.MULTILINE)
_EXAMPLES = {
    "Burr": "Burr(3.0)",
    "Material": "materials['bone']",
    "VoxelBone": "VoxelBone.block((10, 10, 5), 0.1)",
    "Shape": "Shape('parabolic')",
    "Tissues": "read_tissues('table.csv')",
}


def _number(value: Any, *ways: str) -> bool:
    return any(hasattr(value, way) for way in ("__index__", *ways)) and not isinstance(value, bool | np.bool_)


def _array(value: Any, kinds: str = "iufb", shape: tuple[int, ...] | None = None) -> bool:
    try:
        found = np.asarray(value)
    except ValueError:
        return False
    return found.dtype.kind in kinds and shape in (None, found.shape)


#: What a parameter must be, and whether a value is that, as far as its type tells.
_KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "number": ("a number", lambda value: _number(value, "__float__")),
    "whole": ("a whole number", _number),
    "point": ("three numbers (x, y, z)", lambda value: _array(value, shape=(3,))),
    "voxel": ("three whole numbers", lambda value: _array(value, "iub", (3,))),
    "array": ("an array of numbers", _array),
    "str": ("text", lambda value: isinstance(value, str)),
    "bool": ("True or False", lambda value: isinstance(value, bool)),
    "bytes": ("bytes", lambda value: isinstance(value, bytes)),
    "None": ("None", lambda value: value is None),
    "ndarray": ("a NumPy array", lambda value: isinstance(value, np.ndarray)),
    "tuple[number, number]": ("a pair of numbers", lambda value: _array(value, shape=(2,))),
}


class _Parameter(NamedTuple):
    name: str
    kind: str
    required: bool
    by_name: bool


def sentence(record: object, given: Sequence[Any], named: Mapping[str, Any], message: str) -> str:
    """What to say instead of pybind11's `message` about a call of the function with this record."""
    what, parameters, docs = _called(record, message)
    made = parameters and parameters[0].name == "self"
    values = list(given[1:] if made or "constructor" in message else given)
    parameters = parameters[1:] if made else parameters
    placed = [one.name for one in parameters if not one.by_name]
    by_name = [one.name for one in parameters if one.by_name]
    names = [one.name for one in parameters]
    for key in named:
        if key not in names:
            takes = f"it takes {_listed(names)}" if names else "it takes none"
            return f"{what} has no parameter {key!r}: {takes}{nearest(key, names)}"
    if len(values) > len(placed):
        rest = f"; give {_listed(by_name)} by name" if by_name else ""
        count = f"{len(placed)} value{'s'[: len(placed) > 1]} by place ({_listed(placed)})"
        takes = count if placed else "no value by place"
        return f"{what} takes {takes}, got {len(values)}: {', '.join(map(shown, values))}{rest}"
    bound = dict(zip(placed, values, strict=False))
    for key in named:
        if key in bound:
            return f"{key} of {what} must be given once, got {shown(bound[key])} and {shown(named[key])}"
    bound |= named
    for one in parameters:
        if one.name in bound and not _fits(value := bound[one.name], one.kind):
            told = f"the text {shown(value)}" if isinstance(value, str) else shown(value)
            return f"{one.name} of {what} must be {_rule(one.kind)}{_unit(one.name, docs)}, got {told}"
    missing = [f"{p.name}{_unit(p.name, docs)}" for p in parameters if p.required and p.name not in bound]
    if missing:
        return f"{what} needs {_listed(missing)}"
    for one in parameters:  # the right type, but out of the range of the core's integers
        value = bound.get(one.name)
        if "whole" in one.kind and isinstance(value, int | np.integer) and not 0 <= value < 2**31:
            limit = "a whole number from 0" if value < 0 else "a smaller whole number"
            return f"{one.name} of {what} must be {limit}, got {shown(value)}"
    return (
        f"{what} cannot take these values of {_listed(list(bound))}: {', '.join(map(shown, bound.values()))}"
    )


def _called(record: object, message: str) -> tuple[str, list[_Parameter], str]:
    """The function's name as users write it, its parameters, and the docstring that describes them."""
    for pattern, short in _SHORT:
        message = re.sub(pattern, short, message)
    first, *others = (_parameters(one or other) for one, other in _SIGNATURE.findall(message))
    for one in others:
        if [p.name for p in one] == [p.name for p in first]:  # an overload by type
            first = [p._replace(kind=f"{p.kind} | {q.kind}") for p, q in zip(first, one, strict=True)]
    owners: list[Any] = [_core, *(kind for kind in vars(_core).values() if isinstance(kind, type))]
    owner, name, found = next(
        (kind, name, found)
        for kind in owners
        for name, found in vars(kind).items()
        if getattr(getattr(found, "fset", getattr(found, "__func__", found)), "__self__", None) is record
    )
    if isinstance(found, property):  # the setter's own names are arg0, arg1
        return owner.__name__, [first[0]._replace(name="self"), first[1]._replace(name=name)], ""
    if name == "__init__":
        return f"{owner.__name__}()", first, owner.__doc__ or ""
    place = "" if owner is _core else f"{owner.__name__}."
    return f"{place}{name}()", first, getattr(found, "__func__", found).__doc__ or ""


def _parameters(signature: str) -> list[_Parameter]:
    parsed = ast.parse(f"def f({signature}): ...").body[0].args  # type: ignore[attr-defined]
    by_place = [*parsed.posonlyargs, *parsed.args]
    defaults = [*(len(by_place) - len(parsed.defaults)) * [None], *parsed.defaults, *parsed.kw_defaults]
    return [
        _Parameter(one.arg, ast.unparse(one.annotation), default is None, place >= len(by_place))
        for place, (one, default) in enumerate(zip(by_place + parsed.kwonlyargs, defaults, strict=True))
    ]


def _fits(value: Any, kind: str) -> bool:
    """Whether a value is of this kind, as far as its type tells; True where that is not known."""
    if " | " in kind:
        return any(_fits(value, one) for one in kind.split(" | "))
    if each := re.fullmatch(r"Sequence\[(.*)\]", kind):
        return isinstance(value, Sequence | np.ndarray) and all(_fits(one, each[1]) for one in value)
    if kind in _KINDS:
        return _KINDS[kind][1](value)
    return isinstance(value, getattr(_core, kind, object))


def _rule(kind: str) -> str:
    """What a parameter of this kind must be."""
    if " | " in kind:
        rule = " or ".join(map(_rule, kind.split(" | ")))
        return rule.replace("a number or three numbers", "a number or three of them")
    if each := re.fullmatch(r"Sequence\[(.*)\]", kind):
        return f"a list, each {_rule(each[1])}"
    if kind in _KINDS:
        return _KINDS[kind][0]
    example = f", such as {_EXAMPLES[kind]}" if kind in _EXAMPLES else ""
    return f"{'an' if kind[0] in 'AEIOU' else 'a'} {kind}{example}"


def _unit(name: str, docs: str) -> str:
    """The unit in brackets that a numpydoc docstring gives for a parameter; empty without one."""
    found = re.search(rf"^(?:\w+, )*{name}(?:, \w+)* : .*\n((?:    .*\n)+)", docs, re.MULTILINE)
    unit = re.search(r" ?(\[[^\]]+\])", found[1]) if found else None
    return f" {unit[1]}" if unit else ""


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]])) if names else ""
