"""One sentence for a call of the core whose arguments do not fit: which parameter, the rule, the value received."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

import burrlab._core as _core
from burrlab.common.check import nearest, shown

# "1. burrlab._core.Burr(radius: ...)" of a constructor, "1. (self: ..., dt: ...) -> ..." of others
_SIGNATURE = re.compile(r"^ +\d+\. (?:\((.*?)\) -> .*|[\w.]+\((.*)\))$", re.MULTILINE)
_NUMBER, _WHOLE = "typing.SupportsFloat | typing.SupportsIndex", "typing.SupportsInt | typing.SupportsIndex"
_THREE = re.compile(
    r'typing.Annotated\[(?:numpy.typing.ArrayLike, numpy.float64, "\[3, 1\]"|.*"FixedSize\(3\)")\]'
)
_EXAMPLES = {
    "Burr": "Burr(3.0)",
    "Material": "materials['bone']",
    "VoxelBone": "VoxelBone.block((10, 10, 5), 0.1)",
    "Shape": "Shape('parabolic')",
    "Tissues": "read_tissues('table.csv')",
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
    placed = [one for one in parameters if not one.by_name]
    by_name = [one.name for one in parameters if one.by_name]
    names = [one.name for one in parameters]
    for key in named:
        if key not in names:
            takes = f"it takes {_listed(names)}" if names else "it takes none"
            return f"{what} has no parameter {key!r}: {takes}{nearest(key, names)}"
    if len(values) > len(placed):
        rest = f"; give {_listed(by_name)} by name" if by_name else ""
        takes = (
            f"{len(placed)} value{'s'[: len(placed) > 1]} by place ({_listed([p.name for p in placed])})"
            if placed
            else "no value by place"
        )
        return f"{what} takes {takes}, got {len(values)}: {', '.join(map(shown, values))}{rest}"
    bound = dict(zip((one.name for one in placed), values, strict=False))
    for key in named:
        if key in bound:
            return f"{key} of {what} must be given once, got {shown(bound[key])} and {shown(named[key])}"
    bound |= named
    for one in parameters:
        if one.name in bound and not _fits(bound[one.name], one.kind):
            rule = _rule(one.kind) + _unit(one.name, docs)
            return f"{one.name} of {what} must be {rule}, got {_told(bound[one.name])}"
    missing = [f"{p.name}{_unit(p.name, docs)}" for p in parameters if p.required and p.name not in bound]
    if missing:
        return f"{what} needs {_listed(missing)}"
    for one in parameters:  # the right type, but out of the range of the core's integers
        value = bound.get(one.name)
        if _WHOLE in one.kind and isinstance(value, int | np.integer) and not 0 <= value < 2**31:
            limit = "a whole number from 0" if value < 0 else "a smaller whole number"
            return f"{one.name} of {what} must be {limit}, got {shown(value)}"
    return (
        f"{what} cannot take these values of {_listed(list(bound))}: {', '.join(map(shown, bound.values()))}"
    )


def _called(record: object, message: str) -> tuple[str, list[_Parameter], str]:
    """The function's name as users write it, its parameters, and the docstring that describes them."""
    owner, name, found = _place(record)
    parameters: list[_Parameter] = []
    for first, second in _SIGNATURE.findall(message):
        one = _parameters(first or second)
        if not parameters:
            parameters = one
        elif [p.name for p in one] == [p.name for p in parameters]:  # an overload by type
            parameters = [
                p._replace(kind=f"{p.kind} | {q.kind}") for p, q in zip(parameters, one, strict=True)
            ]
    if isinstance(found, property):  # the setter's own names are arg0, arg1
        parameters = [p._replace(name=name if p.name.startswith("arg") else p.name) for p in parameters]
        return owner, [parameters[0]._replace(name="self"), *parameters[1:]], ""
    if name == "__init__":
        return f"{owner}()", parameters, getattr(_core, owner).__doc__ or ""
    return (
        f"{owner}.{name}()" if owner else f"{name}()",
        parameters,
        getattr(found, "__func__", found).__doc__ or "",
    )


def _place(record: object) -> tuple[str, str, Any]:
    """Class or "", name and object of the function whose `__self__` is this record."""
    owners: list[Any] = [_core, *(kind for kind in vars(_core).values() if isinstance(kind, type))]
    for owner in owners:
        for name, found in vars(owner).items():
            function = found.fset if isinstance(found, property) else getattr(found, "__func__", found)
            if getattr(function, "__self__", None) is record:
                return "" if owner is _core else owner.__name__, name, found
    return "", "the core", None


def _parameters(signature: str) -> list[_Parameter]:
    by_name, found = False, []
    for part in _split(signature, ","):
        name, _, rest = part.strip().partition(": ")
        by_name |= name == "*"
        if rest:
            kind, *default = _split(rest, "=")
            found.append(_Parameter(name, kind.strip(), not default, by_name))
    return found


def _split(text: str, mark: str) -> list[str]:
    """The parts between marks that stand in no brackets and no quotes."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote or letter in "'\"":
            quote = "" if letter == quote else quote or letter
        else:
            depth += (letter in "[(<") - (letter in "])>")
        if letter == mark and not depth and not quote:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _fits(value: Any, kind: str) -> bool:
    """Whether a value is of this kind, as far as its type tells; True where that is not known."""
    if _THREE.fullmatch(kind):
        return _array(value, (3,))
    if kind in (_NUMBER, _WHOLE):
        whole = hasattr(value, "__index__")
        return (whole or (kind == _NUMBER and hasattr(value, "__float__"))) and not isinstance(
            value, bool | np.bool
        )
    if _NUMBER in kind or _WHOLE in kind or " | " in kind:
        simple = kind.replace(_NUMBER, "number").replace(_WHOLE, "whole")
        if "[" not in simple or "Annotated" in simple:
            back = {"number": _NUMBER, "whole": _WHOLE}
            parts = [one.strip() for one in _split(simple, "|")]
            return len(parts) < 2 or any(_fits(value, back.get(one, one)) for one in parts)
    if kind.startswith("burrlab._core."):
        return isinstance(value, getattr(_core, kind.removeprefix("burrlab._core."), object))
    if kind.startswith("collections.abc.Sequence[burrlab"):
        each = kind[len("collections.abc.Sequence[") : -1]
        return isinstance(value, Sequence) and all(_fits(one, each) for one in value)
    if "ArrayLike" in kind:
        return _array(value, None)
    return isinstance(value, _PLAIN[kind]) if kind in _PLAIN else True


_PLAIN: dict[str, Any] = {
    "str": str,
    "bool": bool,
    "bytes": bytes,
    "None": type(None),
    "numpy.ndarray": np.ndarray,
}


def _array(value: Any, shape: tuple[int, ...] | None) -> bool:
    try:
        found = np.asarray(value)
    except ValueError:
        return False
    return found.dtype.kind in "iufb" and (shape is None or found.shape == shape)


def _rule(kind: str) -> str:
    """What a parameter of this kind must be."""
    if _THREE.fullmatch(kind):
        return "three numbers (x, y, z)" if "float64" in kind else "three whole numbers"
    simple = kind.replace(_NUMBER, "a number").replace(_WHOLE, "a whole number")
    words = {"str": "text", "bool": "True or False", "None": "None", "numpy.ndarray": "a NumPy array"}
    said = []
    for one in (part.strip() for part in _split(simple, "|")):
        name = one.removeprefix("burrlab._core.")
        if name != one:
            example = f", such as {_EXAMPLES[name]}" if name in _EXAMPLES else ""
            said.append(f"{'an' if name[0] in 'AEIOU' else 'a'} {name}{example}")
        elif _THREE.fullmatch(one):
            said.append("three of them (x, y, z)" if said else "three numbers (x, y, z)")
        elif "ArrayLike" in one:
            said.append("an array of numbers")
        elif one.startswith("collections.abc.Sequence"):
            said.append(f"a list, each {_rule(one[one.index('[') + 1 : -1])}")
        elif one.startswith("tuple"):
            said.append("a pair of numbers" if one.count(",") == 1 else "a tuple of numbers")
        else:
            said.append(words.get(one, one.rsplit(".", 1)[-1]))
    return " or ".join(said)


def _unit(name: str, docs: str) -> str:
    """The unit in brackets that a numpydoc docstring gives for a parameter; empty without one."""
    found = re.search(rf"^(?:\w+, )*{name}(?:, \w+)* : .*\n((?:    .*\n)+)", docs, re.MULTILINE)
    unit = re.search(r" ?(\[[^\]]+\])", found[1]) if found else None
    return f" {unit[1]}" if unit else ""


def _told(value: object) -> str:
    return f"the text {shown(value)}" if isinstance(value, str) else shown(value)


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]])) if names else ""
