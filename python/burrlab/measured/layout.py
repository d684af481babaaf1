"""Tables of other programs: spreadsheets and loggers, with their own headings, units, separators and decimals."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import IO, Any

from burrlab.common.check import refuse, shown
from burrlab.common.table import Path, Table, bytes_of, decoded

_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars"}
_SHOWN = 10  # faults told one by one
_GRAVITY = 9.80665  # [N/kg]

#: What one of a unit is, in the unit of the table's column.
UNITS: Mapping[str, Mapping[str, float]] = {
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "cN": 1e-2, "gf": 1e-3 * _GRAVITY, "kgf": _GRAVITY, "lbf": 4.4482216152605},
    "mm/s": {"mm/s": 1.0, "um/s": 1e-3, "m/s": 1e3, "cm/s": 10.0, "mm/min": 1 / 60, "um/min": 1e-3 / 60, "in/s": 25.4},
    "mm": {"mm": 1.0, "um": 1e-3, "m": 1e3, "cm": 10.0, "in": 25.4},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
}  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """How a table of another program is laid out.

    Attributes
    ----------
    columns : mapping of str to str
        Our name of a column, such as ``"force"``, -> its heading in the file. Columns without an entry have
        our heading, such as ``force_N``.
    unit : mapping of str to str
        Our name -> unit of the numbers in the file; default: the unit of our heading.
    sep : str
        Separator; "" finds it.
    decimal : str
        "." or ",".
    encoding : str
        Such as ``"latin-1"``, ``"cp1252"`` or ``"utf-16"``.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: Mapping[str, str] = field(default_factory=dict)
    sep: str = ""
    decimal: str = "."
    encoding: str = "utf-8-sig"

    def read(
        self, table: Table, file: Path | IO[str] | IO[bytes]
    ) -> tuple[str, dict[str, str], dict[str, list[Any]], dict[str, list[str]]]:
        """The file's name, its comments, its columns by our names, and the other columns by their headings.

        Lines above the headings, empty lines, repeated headings and a line of units below them are passed
        over.

        Raises
        ------
        ValueError
            With every fault of the file, each with its line and column.
        OSError
            If the file cannot be read.
        """
        asked = self._asked(table)
        name, content = bytes_of(file)
        lines = decoded(name, content, self.encoding).splitlines()
        comments = {}
        for line in lines:
            key, colon, value = line[1:].partition(":")
            if line.startswith("#") and colon:
                comments[key.strip()] = value.strip()
        head, sep, headings = self._headings(name, lines, asked)
        places = {ours: headings.index(theirs) for ours, theirs in asked.items() if theirs in headings}
        self._check_units(name, head, table, places, headings)
        values: dict[str, list[Any]] = {ours: [] for ours in places}
        others: dict[str, list[str]] = {
            heading: [] for i, heading in enumerate(headings) if heading and i not in places.values()
        }
        faults: list[str] = []
        for number, fields in _rows(lines, head, sep, headings):
            if number == head + 1 and self._are_units(table, {o: fields[i] for o, i in places.items()}):
                continue
            row: dict[str, Any] = {}
            for ours, i in places.items():
                try:
                    row[ours] = self._value(table, ours, fields[i])
                except ValueError as error:
                    faults.append(f"line {number}, column {headings[i]}: {error}")
            if len(row) == len(places) and (broken := table.problem(row)):
                faults.append(f"line {number}, column {headings[places[broken[0]]]}: {broken[1]}")
            for ours, value in row.items():
                values[ours].append(value)
            for heading, kept in others.items():
                kept.append(fields[headings.index(heading)])
        if faults:
            more = f"; and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
            commas = "; are the decimals commas (decimal=',')?" if self._commas(faults) else ""
            many = f"{len(faults)} faults: " if len(faults) > 1 else ""
            raise ValueError(f"{name}: {many}{'; '.join(faults[:_SHOWN])}{more}{commas}")
        refuse(not any(values.values()), f"{name}: there is no row below the headings of line {head}")
        return name, comments, values, others

    def _asked(self, table: Table) -> dict[str, str]:
        """Headings in the file by our names."""
        known = table.named
        for what, given in (("columns", self.columns), ("unit", self.unit)):
            for ours in given:
                refuse(ours not in known, f"{what} must be given for {', '.join(known)}: got {shown(ours)}")
        for ours, unit in self.unit.items():
            of = UNITS.get(known[ours].unit, {})
            refuse(
                unit not in of, f"unit of {ours} must be one of {', '.join(of) or 'none'}: got {shown(unit)}"
            )
        refuse(
            self.decimal not in (".", ","), f"decimal must be a point or a comma: got {shown(self.decimal)}"
        )
        refuse(len(self.sep) > 1, f"sep must be one character: got {shown(self.sep)}")
        return {ours: self.columns.get(ours, column.heading) for ours, column in known.items()}

    def _headings(self, name: str, lines: list[str], asked: Mapping[str, str]) -> tuple[int, str, list[str]]:
        """Number of the line of headings from 1, the separator, and the headings."""
        needed = set(self.columns.values()) or {asked[ours] for ours in list(asked)[:2]}
        best: tuple[int, int, str, list[str]] = (1, 0, "", [])
        for number, line in enumerate(lines, start=1):
            if line.startswith("#"):
                continue
            for sep in self.sep or _SEPARATORS:
                fields = _split(line, sep)
                if needed <= set(fields):
                    for heading in needed:
                        refuse(
                            fields.count(heading) > 1,
                            f"{name}, line {number}: column {heading} is there twice",
                        )
                    return number, sep, fields
                words = sum(bool(text) and not _is_number(text, self.decimal) for text in fields)
                best = max(best, (words, -number, sep, fields))
        missing = ", ".join(sorted(needed - set(best[3])))
        if best[0] < 2:
            raise ValueError(f"{name}: no line has the headings {', '.join(sorted(needed))}")
        raise ValueError(
            f"{name}: no line has the headings {', '.join(sorted(needed))}; line {-best[1]} has "
            f"{', '.join(filter(None, best[3]))}, without {missing}: say which columns are meant, as in "
            f"columns={{'{next(iter(asked))}': {best[3][0]!r}}}"
        )

    def _check_units(
        self, name: str, line: int, table: Table, places: Mapping[str, int], headings: list[str]
    ) -> None:
        """Refuses a heading that tells another unit than the one that its numbers would be read in."""
        for ours, i in places.items():
            due = self.unit.get(ours, table.named[ours].unit)
            told = _unit_in(headings[i])
            if told and due and told in UNITS.get(table.named[ours].unit, {}) and told != due:
                raise ValueError(
                    f"{name}, line {line}: column {headings[i]} tells {told}, but would be read as {due}: give "
                    f"unit={{'{ours}': '{told}'}}"
                )

    def _are_units(self, table: Table, fields: Mapping[str, str]) -> bool:
        """Whether the line below the headings holds units; ValueError if they are other ones."""
        numbers = {ours: text for ours, text in fields.items() if table.named[ours].unit}
        if not numbers or any(_is_number(text, self.decimal) or not text for text in numbers.values()):
            return False
        for ours, text in numbers.items():
            due, told = self.unit.get(ours, table.named[ours].unit), _unit_in(text) or _plain(text)
            refuse(
                told != due,
                f"the line of units tells {shown(told)} for {ours}, which would be read as {due}: give "
                f"unit={{'{ours}': '{told}'}}",
            )
        return True

    def _value(self, table: Table, ours: str, text: str) -> Any:
        column = table.named[ours]
        if not column.unit:
            return column.type(text)
        text = re.sub(r"(?<=\d)[\s\u00a0\u202f'](?=\d{3}\b)", "", text)  # thousands
        if self.decimal == ",":
            refuse("." in text and "," in text, f"{shown(text)} has a point and a comma")
            refuse("." in text, f"{shown(text)} has a point, but the decimals are commas")
            text = text.replace(",", ".")
        refuse(column.due and not text, f"every row needs {column.due}")
        return column.type(text) * UNITS[column.unit][self.unit.get(ours, column.unit)]

    def _commas(self, faults: list[str]) -> bool:
        return self.decimal == "." and any(re.search(r"'-?\d+,\d+' is not a number", text) for text in faults)


def _rows(lines: list[str], head: int, sep: str, headings: list[str]) -> Iterator[tuple[int, list[str]]]:
    """Number and fields of each row below the headings; fields that are missing at the end are empty."""
    for number, line in enumerate(lines[head:], start=head + 1):
        fields = _split(line, sep)
        if line.startswith("#") or not any(fields) or fields == headings:
            continue
        yield number, fields[: len(headings)] + [""] * (len(headings) - len(fields))


def _split(line: str, sep: str) -> list[str]:
    return [text.strip() for text in next(csv.reader([line], delimiter=sep, skipinitialspace=True), [])]


def _is_number(text: str, decimal: str) -> bool:
    try:
        return math.isfinite(float(text.replace(decimal, ".")))
    except ValueError:
        return False


def _unit_in(text: str) -> str:
    """The unit in brackets at the end of a heading, "" for none."""
    found = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$", text)
    return _plain(found[1]) if found else ""


def _plain(unit: str) -> str:
    """A unit in our letters: um for either micro sign, no blanks."""
    return re.sub(r"[\u00b5\u03bc]", "u", unit.strip(" []()")).replace(" ", "").replace("^-1", "")
