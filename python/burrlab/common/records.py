"""Reads JSON text with one-sentence errors; converts results to plain objects for JSON, and back."""

import functools
import json
import math
import os
import re
import reprlib
import textwrap
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import (
    IO,
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    Self,
    TypeAlias,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
)

import numpy as np

from burrlab.common.check import content_of, refuse, shown
from burrlab.common.files import write_text

if TYPE_CHECKING:
    from cattrs import Converter

Made = TypeVar("Made")

#: Errors in reading text that is nested too deeply, too large, or not of the expected kind.
UNREADABLE = (
    LookupError,
    TypeError,
    ValueError,
    ArithmeticError,
    AttributeError,
    RecursionError,
    SyntaxError,
)


def parsed(
    name: str, text: str | bytes, what: str, make: Callable[[Any], Made], *, finite: bool = True
) -> Made:
    """Result of `make` on the values in JSON text; ValueError that names the file if this fails."""
    hooks: dict[str, Any] = (
        {"parse_int": _whole, "parse_float": _real, "parse_constant": _real} if finite else {}
    )
    try:
        return make(json.loads(text, **hooks))
    except UNREADABLE as error:
        problem = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{name}: this is not {what} ({in_one_line(problem)})") from None


def in_one_line(error: object, most: int = 200) -> str:
    """An error as text on one short line, to be quoted in a message."""
    return re.sub(r"[\0-\x1f\x7f\ud800-\udfff]", "\ufffd", textwrap.shorten(str(error), most))


def check_texts(value: object) -> None:
    """ValueError if a text in a JSON value holds control characters or a lone surrogate."""
    refuse(
        re.search(r"[\x7f\ud800-\udfff]|(?<!\\)(?:\\\\)*\\[bfnrtu]", json.dumps(value, ensure_ascii=False)),
        "a text has control characters",
    )


def _whole(text: str) -> int:
    number = int(text)
    float(number)
    return number


def _real(text: str) -> float:
    number = float(text)
    refuse(not math.isfinite(number), f"{text} is not finite")
    return number


#: Key in JSON -> name of its field, or the function that derives its value.
Keys: TypeAlias = Mapping[str, str | Callable[[Any], Any]]
_SPELT = ("inf", "-inf", "nan")


class Codec:
    """Converts dataclasses to plain objects for JSON, and back, by the types of their fields.

    Arrays, tuples and NamedTuples become lists, mappings dicts, paths texts, and an object of the core what
    the core makes it of again: its state, or its parts by name. Reading is strict: a text is no number, 2.9 is not read as 2,
    unknown keys are errors.

    Parameters
    ----------
    not_finite : str
        Treatment of infinity and NaN, which JSON lacks. ``"null"`` writes null and reads it as NaN.
        ``"spelt"`` writes "inf", "-inf" and "nan", and ignores unknown keys. ``"kept"`` leaves them to
        `json.dumps` and reads them in arrays only.
    keys : mapping
        Class -> key in JSON -> name of its field, or a function of the object for a derived value, which is
        written and ignored in reading. Other classes are written with their fields, or by their state: a class of the
        core with the one key ``"parts"`` as what this function gives.
    null : mapping
        (class, field) -> number that null stands for, if not NaN.
    kinds : mapping
        Text under the key ``"kind"`` -> class, for fields that hold one of several classes.
    """

    def __init__(
        self,
        not_finite: str = "null",
        *,
        keys: Mapping[type, Keys] | None = None,
        null: Mapping[tuple[type, str], float] | None = None,
        kinds: Mapping[str, type] | None = None,
    ) -> None:
        self._not_finite, self._keys, self._null, self._kinds = (
            not_finite,
            keys or {},
            null or {},
            kinds or {},
        )

    def plain(self, value: Any) -> Any:
        """The value in types of JSON."""
        return self._converter.unstructure(value)

    def made(self, kind: type[Made], value: Any) -> Made:
        """The object from the result of `plain`; ValueError with the place of the first fault."""
        import cattrs

        try:
            return self._converter.structure(value, kind)
        except cattrs.BaseValidationError as error:
            raise ValueError(_sentence(error)) from None

    @functools.cached_property
    def _converter(self) -> "Converter":
        import cattrs

        hooks = cattrs.Converter()
        hooks.register_unstructure_hook(float, self._written)
        hooks.register_unstructure_hook(Path, str)
        for holds, write in (
            (is_of_core, self._state),
            (_is(np.ndarray, np.generic), lambda value: self.plain(value.tolist())),
            (_is(Mapping), lambda value: {str(name): self.plain(part) for name, part in value.items()}),
            (_is(tuple, list), lambda value: [self.plain(part) for part in value]),
        ):
            hooks.register_unstructure_hook_func(holds, write)
        hooks.register_unstructure_hook_factory(is_dataclass, self._taken_apart)
        for kind in (int, str, bool):
            hooks.register_structure_hook(kind, functools.partial(_of_type, (kind,)))
        hooks.register_structure_hook(float, self._number)
        hooks.register_structure_hook_func(is_of_core, _of_state)
        hooks.register_structure_hook_func(_is(np.ndarray), self._array)
        hooks.register_structure_hook_func(lambda kind: get_origin(kind) is Literal, _one_of)  # type: ignore[comparison-overlap]
        for holds, make in (
            (_is(Mapping), _mapping),
            (_is_list, _sequence),
            (is_dataclass, self._put_together),
        ):
            hooks.register_structure_hook_factory(holds, make)
        hooks.register_structure_hook_func(_is_choice, self._chosen)
        return hooks

    def _known(self, kind: type) -> Keys:
        """Entry of a class, or of its first base class with one, in `keys`."""
        return next((self._keys[base] for base in kind.__mro__ if base in self._keys), {})

    def _written(self, value: float) -> Any:
        if math.isfinite(value) or self._not_finite == "kept":
            return value
        return None if self._not_finite == "null" else str(float(value))

    def _state(self, value: Any) -> Any:
        """What the core makes the object of again."""
        parts = self._known(type(value)).get("parts")
        return self.plain(parts(value) if callable(parts) else value.__getstate__())

    def _number(self, value: Any, _: Any = None, *, null: float = math.nan) -> float:
        if value is None and self._not_finite == "null":
            return null
        if self._not_finite == "spelt" and value in _SPELT:
            return float(value)
        number = float(_of_type((float, int), value, float))
        refuse(not math.isfinite(number), f"must be finite, got {value}")
        return number

    def _array(self, value: Any, _: Any) -> Any:
        numbers = np.array(_of_type((list,), value, list), dtype=object)
        wrong = set(map(type, numbers.flat)) - {float, int, type(None)}
        refuse(wrong, f"must be of numbers, got {' and '.join(sorted(kind.__name__ for kind in wrong))}")
        return numbers.astype(np.float64)

    def _taken_apart(self, kind: type) -> Callable[[Any], Any]:
        """Function that writes a dataclass."""
        keys = self._known(kind) or {field.name: field.name for field in fields(kind) if field.init}
        tag = {tagged: {"kind": name} for name, tagged in self._kinds.items()}.get(kind, {})
        return lambda value: {
            **tag,
            **{
                key: self.plain(getattr(value, source) if isinstance(source, str) else source(value))
                for key, source in keys.items()
            },
        }

    def _put_together(self, kind: type, converter: "Converter") -> Callable[[Any, Any], Any]:
        """Function that reads a dataclass."""
        from cattrs.gen import make_dict_structure_fn, override

        keys = {field.name: field.name for field in fields(kind) if field.init}
        known = self._known(kind)
        keys |= {source: key for key, source in known.items() if isinstance(source, str)}
        derived = {key for key, source in known.items() if not isinstance(source, str)}
        needed = [keys[f.name] for f in fields(kind) if f.init and f.default is f.default_factory is MISSING]
        overrides: dict[str, Any] = {name: override(rename=key) for name, key in keys.items()}
        for (owner, name), meaning in self._null.items():
            if owner is kind:
                number = functools.partial(self._number, null=meaning)
                overrides[name] = override(rename=keys[name], struct_hook=number)
        structure: Any = make_dict_structure_fn(
            kind, converter, _cattrs_forbid_extra_keys=self._not_finite != "spelt", **overrides
        )

        def read(value: Any, _: Any) -> Any:
            missing = [key for key in needed if key not in _of_type((dict,), value, dict)]
            refuse(missing, f"{kind.__name__} needs {', '.join(missing)}, which the record does not have")
            return structure({key: part for key, part in value.items() if key not in derived}, kind)

        return read

    def _chosen(self, value: Any, union: Any) -> Any:
        """Value of a field that may hold several types."""
        some = [kind for kind in get_args(union) if kind is not type(None)]
        if value is None and len(some) < len(get_args(union)):
            return None
        if isinstance(value, dict) and self._kinds:
            name, rest = str(value.get("kind")), {key: part for key, part in value.items() if key != "kind"}
            refuse(
                name not in self._kinds,
                f"kind must be one of {', '.join(self._kinds)}, got {reprlib.repr(name)}",
            )
            return self._converter.structure(rest, self._kinds[name])
        keys = set(value) if isinstance(value, dict) else None
        fitting: list[Any] = [
            kind for kind in some if is_dataclass(kind) and {f.name for f in fields(kind) if f.init} == keys
        ]
        fitting += [kind for kind in some if isinstance(kind, type) and isinstance(value, kind)]
        kind = fitting[0] if fitting else float if float in some and value in _SPELT else some[0]
        return self._converter.structure(value, kind)


class AsDict:
    """Base of results that can be put into JSON; where they have no number, that is None, or NaN if they say so."""

    _codec: ClassVar[Codec]

    def to_dict(self) -> dict[str, Any]:
        """The result as plain Python objects, ready for JSON, with units in the names."""
        return cast("dict[str, Any]", self._codec.plain(self))


class InJson(AsDict):
    """Base of results that a JSON file keeps without loss; infinities and NaN are None in `to_dict`."""

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """The object that `to_dict` described."""
        return cls._codec.made(cls, values)

    def to_json(self, file: str | os.PathLike[str] | IO[str]) -> None:
        """Write JSON, with all data, that `from_json` reads back without loss."""
        write_text(file, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")

    @classmethod
    def from_json(cls, file: str | os.PathLike[str] | IO[Any]) -> Self:
        """Read what `to_json` wrote.

        Raises
        ------
        ValueError
            If the file is something else.
        """
        text = isinstance(file, str) and file.lstrip().startswith(("{", "["))
        refuse(text, f"file must be a name or an open file, as io.StringIO(text), got the text {shown(file)}")

        def made(values: Mapping[str, Any]) -> Any:
            result = cls.from_dict(values)
            look = getattr(result, "_check_whole", getattr(result, "report", result.__repr__))
            look()  # finds what is missing
            return result

        if isinstance(file, (str, os.PathLike)):
            name, content = os.fspath(file), content_of(file)
        else:
            name, content = getattr(file, "name", "JSON text"), file.read()
        return cast("Self", parsed(name, content, f"the JSON of a {cls.__name__.lower()}", made))


def is_of_core(kind: Any) -> bool:
    """Whether a class is the C++ core's. Its objects are told apart by the state that `pickle` keeps."""
    return getattr(kind, "__module__", "") == "burrlab._core"


def _of_state(state: Any, kind: Any) -> Any:
    try:
        return kind(**state) if isinstance(state, dict) else kind(state)
    except TypeError:
        raise TypeError(f"must be what makes a {kind.__name__}, got {reprlib.repr(state)}") from None


def _is(*kinds: type) -> Callable[[Any], bool]:
    """A test of whether a field's declared type is one of `kinds`."""

    def asked(declared: Any) -> bool:
        origin = get_origin(declared) or declared
        return isinstance(origin, type) and issubclass(origin, kinds)

    return asked


def _is_list(declared: Any) -> bool:
    return (get_origin(declared) or declared) in (list, tuple)


def _is_choice(declared: Any) -> bool:
    some = {*get_args(declared)} - {type(None)}
    return get_origin(declared) in (Union, types.UnionType) and len(some) > 1


def _of_type(kinds: tuple[type, ...], value: Any, kind: type) -> Any:
    if type(value) not in kinds:
        raise TypeError(f"must be {kind.__name__}, got {reprlib.repr(value)}")
    return value


def _one_of(value: Any, declared: Any) -> Any:
    some = get_args(declared)
    refuse(value not in some, f"must be one of {', '.join(some)}, got {reprlib.repr(value)}")
    return value


def _mapping(declared: Any, converter: "Converter") -> Callable[[Any, Any], Any]:
    from cattrs.gen import mapping_structure_factory

    key, part = get_args(declared) or (Any, Any)
    structure: Any = mapping_structure_factory(dict[key, part], converter)  # type: ignore[valid-type]
    return lambda value, _: structure(_of_type((dict,), value, dict), dict)


def _sequence(declared: Any, converter: "Converter") -> Callable[[Any, Any], Any]:
    from cattrs.cols import list_structure_factory

    kinds = get_args(declared) or (Any, ...)
    make = get_origin(declared) or declared
    alike = make is list or kinds[-1] is Ellipsis or len(set(kinds)) == 1
    listed = list_structure_factory(list[kinds[0]], converter)  # type: ignore[valid-type]

    def read(value: Any, _: Any) -> Any:
        _of_type((list, tuple), value, list)
        length = len(kinds) if make is tuple and kinds[-1] is not Ellipsis else len(value)
        refuse(len(value) != length, f"must have {length} values, got {len(value)}")
        if alike:
            return make(listed(value, list))
        return tuple(converter.structure(part, kind) for kind, part in zip(kinds, value, strict=True))

    return read


def _sentence(error: Exception) -> str:
    """The first fault that the converter found, with its place."""
    from cattrs import ForbiddenExtraKeysError, transform_error

    def said(fault: BaseException, _: object) -> str:
        if isinstance(fault, ForbiddenExtraKeysError):
            return f"must not have the key {reprlib.repr(min(fault.extra_fields))}"
        return in_one_line(fault) if str(fault) else type(fault).__name__

    text, _, place = transform_error(error, "", said)[0].rpartition(" @ ")
    place = place.lstrip(".")
    return f"{place}{' ' if text.startswith('must') else ': '}{text}" if place else text
