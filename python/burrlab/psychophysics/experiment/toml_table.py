"""Tables of a TOML file, read key by key, each mistake in one sentence."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from burrlab import csv_text
from burrlab.bounds import shown

_REQUIRED = object()


class Table:
    """One table; what is wrong with it is said with file, table and key.

    Parameters
    ----------
    file : str
    name : str
        Of the table; empty for the whole file.
    values : mapping
    """

    def __init__(self, file: str, name: str, values: Mapping[str, Any]) -> None:
        self.file, self.name, self._values = file, name, values
        self._known: list[str] = []

    @property
    def where(self) -> str:
        return f"{self.file}, [{self.name}]" if self.name else self.file

    def text(self, key: str, default: Any = _REQUIRED, *, choices: Sequence[str] = ()) -> Any:
        """A text that is not empty, of the choices where there are any."""
        value = self.value(key, default)
        if key in self and not (isinstance(value, str) and value):
            raise self.error(f"{key} must be a text, got {shown(value)}")
        if key in self and choices and value not in choices:
            raise self.error(f"{key} must be one of {', '.join(choices)}, got {shown(value)}")
        return value

    def number(self, key: str, default: Any = _REQUIRED) -> Any:
        """A finite number."""
        value = self.value(key, default)
        return self._number(key, value) if key in self else value

    def numbers(self, key: str, default: Any = _REQUIRED) -> Any:
        """A list of finite numbers."""
        value = self.value(key, default)
        if key not in self:
            return value
        if not isinstance(value, list):
            raise self.error(f"{key} must be a list of numbers, got {shown(value)}")
        return [self._number(key, one) for one in value]

    def whole(self, key: str, default: Any = _REQUIRED, *, most: int = 2**63 - 1) -> Any:
        """A whole number from 0."""
        value = self.value(key, default)
        if key in self and not (type(value) is int and 0 <= value <= most):
            raise self.error(f"{key} must be a whole number from 0 to {most}, got {shown(value)}")
        return value

    def flag(self, key: str, default: Any = _REQUIRED) -> Any:
        """true or false."""
        value = self.value(key, default)
        if key in self and type(value) is not bool:
            raise self.error(f"{key} must be true or false, got {shown(value)}")
        return value

    def table(self, key: str, *, needed: bool = True) -> Table:
        """A table in this one."""
        name = f"{self.name}.{key}" if self.name else key
        value = self.value(key, _REQUIRED if needed else {}, what=f"the table [{name}]")
        if not isinstance(value, dict):
            raise self.error(f"{key} must be a table, [{name}], got {shown(value)}")
        return Table(self.file, name, value)

    def tables(self) -> Mapping[str, Table]:
        """All that is in this one."""
        return {key: self.table(key) for key in self._values}

    def value(self, key: str, default: Any = _REQUIRED, *, what: str | None = None) -> Any:
        """As the file has it."""
        self._known.append(key)
        if key not in self and default is _REQUIRED:
            raise self.error(f"{what or key} is missing")
        return self._values.get(key, default)

    def done(self) -> None:
        """Raises ValueError where a key was not asked for."""
        for key in self._values:
            if key not in self._known:
                raise self.error(f"unknown key {shown(key)}; known are {', '.join(self._known)}")

    def error(self, sentence: object) -> ValueError:
        """With the place before the sentence."""
        return ValueError(f"{self.where}: {sentence}")

    @contextmanager
    def errors(self) -> Iterator[None]:
        """What is raised within is said to be of this table."""
        try:
            yield
        except (ValueError, TypeError) as error:
            raise self.error(error) from None

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def _number(self, key: str, value: Any) -> float:
        try:
            number = float(value) if type(value) in (int, float) else math.nan
        except OverflowError:  # TOML's whole numbers have no end
            number = math.inf
        if not math.isfinite(number):
            raise self.error(f"{key} must be a finite number, got {shown(value)}")
        return number


def read_toml(name: str, content: bytes) -> Table:
    """The whole of a TOML file.

    Raises
    ------
    ValueError
        If it is no TOML in UTF-8: with the line; a table or key that is there twice is none.
    """
    text = csv_text.decoded(name, content)
    try:
        return Table(name, "", tomllib.loads(text))
    except ValueError as error:  # TOMLDecodeError is one, and so is a number of thousands of digits
        raise ValueError(f"{name}: this is not TOML: {error}") from None
    except RecursionError:
        raise ValueError(f"{name}: lists or tables are nested too deeply") from None
