"""TSV text as BIDS has it: tabs, column names in the first line, n/a where there is nothing."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from burrlab import csv_text

NOTHING = "n/a"


@dataclass(frozen=True)
class TextTable:
    """The fields of a file, as text.

    Attributes
    ----------
    name : str
        Of the file.
    columns : tuple of str
    rows : tuple of (int, mapping)
        Number of the line, from 1, and its fields by column.
    """

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[int, Mapping[str, str]], ...]


def split_torn(content: bytes) -> tuple[bytes, bytes]:
    """The whole lines, and what stands behind the last of them: where writing was broken off."""
    end = content.rfind(b"\n") + 1
    return content[:end], content[end:]


def parse(name: str, content: bytes) -> TextTable:
    """The table in a file's bytes.

    Raises
    ------
    ValueError
        If it is not text in UTF-8, holds no column names, has a column twice or without a name, or a row has another
        number of fields than there are columns: with the file, and the line where there is one.
    """
    lines = [line.removesuffix("\r") for line in csv_text.decoded(name, content).split("\n")]
    numbered = [(number, line) for number, line in enumerate(lines, start=1) if line.strip()]
    if not numbered:
        raise ValueError(f"{name}: the file is empty")
    (number, head), *body = numbered
    if "\t" not in head and "," in head:
        raise ValueError(f"{name}, line {number}: the separator must be a tab, not a comma")
    columns = _fields(name, number, head)
    for column in columns:
        if not column:
            raise ValueError(f"{name}, line {number}: a column has no name")
        if columns.count(column) > 1:
            raise ValueError(f"{name}, line {number}: column {column} is there twice")
    rows = []
    for number, line in body:
        fields = _fields(name, number, line)
        if len(fields) != len(columns):
            raise ValueError(f"{name}, line {number}: {len(columns)} fields are due, found {len(fields)}")
        rows.append((number, dict(zip(columns, fields, strict=True))))
    return TextTable(name, tuple(columns), tuple(rows))


def line(fields: Sequence[str]) -> bytes:
    """A line of the file.

    Raises
    ------
    ValueError
        If a field is empty or holds a tab, a line break or a quotation mark.
    """
    for field in fields:
        if not field or any(mark in field for mark in '\t\r\n"'):
            raise ValueError(
                f"a field must be a text without tabs, line breaks and quotation marks, got {field!r}"
            )
    return ("\t".join(fields) + "\n").encode()


def number(text: str) -> float | None:
    """A finite number, or None for n/a.

    Raises
    ------
    ValueError
        If the text is neither.
    """
    if text == NOTHING:
        return None
    try:
        value = float(text.replace("_", " "))  # Python's 1_000 is no number to a spreadsheet
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"must be a finite number with a point, or {NOTHING}, got {text!r}")
    return value


def whole(text: str, *, below: int = 2**63) -> int | None:
    """A whole number from 0, or None for n/a.

    Raises
    ------
    ValueError
        If the text is neither.
    """
    if text == NOTHING:
        return None
    if not (text.isascii() and text.isdecimal() and len(text) < 21 and int(text) < below):
        raise ValueError(f"must be a whole number from 0, or {NOTHING}, got {text!r}")
    return int(text)


def _fields(name: str, line: int, text: str) -> list[str]:
    try:
        return [field.strip(" ") for field in next(csv.reader([text], delimiter="\t", strict=True))]
    except csv.Error as error:
        raise ValueError(f"{name}, line {line}: not a line of fields between tabs ({error})") from None
