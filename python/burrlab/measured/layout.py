"""Tables of other programs: spreadsheets and loggers, with their own headings, units, separators and decimals."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import IO, Any, TypeVar

import numpy as np

from burrlab.common.check import refuse, shown
from burrlab.common.table import (
    Column,
    Path,
    Table,
    TableData,
    listed,
    number_in_comments,
    origin,
    refuse_all,
    text_of,
)

_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars"}
_SEARCHED = 1000  # lines in which the headings may stand
_TALLEST = 20  # lines of a row with line breaks in quotation marks
_MARKS = {",": "comma", ".": "point"}
_BLANKS = " \u00a0\u2009\u202f'\u2019"  # between thousands

_FOREIGN = "; for a file of another program, give columns, unit, sep, decimal or encoding"

#: What one of a unit is, in the unit of the table's column. A kilogram weighs 9.80665 N (standard gravity).
UNITS: Mapping[str, Mapping[str, Fraction]] = {
    own: {unit: Fraction(value) for unit, _, value in (text.partition(" ") for text in of.split(", "))}
    for own, of in {
        "N": "N 1, mN 1/1000, cN 1/100, daN 10, kN 1000, gf 0.00980665, kgf 9.80665, kp 9.80665, lbf 4.4482216152605",
        "mm/s": "mm/s 1, um/s 1/1000, cm/s 10, m/s 1000, mm/min 1/60, um/min 1/60000, in/s 25.4",
        "mm": "mm 1, um 1/1000, cm 10, m 1000, in 25.4",
        "s": "s 1, ms 1/1000, us 1/1000000, min 60",
    }.items()
}  # fmt: skip
_KNOWN = sorted((unit for of in UNITS.values() for unit in of), key=len, reverse=True)
_TAIL = re.compile(rf"(?:^|[\s_,/])({'|'.join(unit.replace('/', '[/_]') for unit in _KNOWN)})$")
_MEANT = {"g": "gf", "kg": "kgf", "lb": "lbf", "lbs": "lbf"}

Made = TypeVar("Made", bound=TableData)


class Layout:
    """How a table of another program is laid out, which `VelocityCurve.from_csv` tells, and what one such held."""

    def __init__(
        self, table: Table, columns: Mapping[str, Any] | None, unit: str | Mapping[str, str] | None,
        sep: str | None = None, decimal: str | None = None, encoding: str | None = None,
    ) -> None:  # fmt: skip
        self.table, self.decimal, self.encoding = table, decimal or ".", encoding
        self.own = not any((columns, unit, sep, decimal, encoding))
        for what, text in {"sep": sep, "decimal": decimal, "encoding": encoding}.items():
            refuse(not isinstance(text, str | None), f"{what} must be a text: got {shown(text)}")
        self.group = "." if self.decimal == "," else ","
        self.sep = {"tab": "\t", "\\t": "\t", None: ""}.get(sep, sep or "")
        refuse(self.decimal not in _MARKS, f"decimal must be a point or a comma: got {shown(decimal)}")
        long = len(self.sep) > 1 or self.sep in ('"', "\r", "\n")
        refuse(long, f"sep must be one character, or tab: got {shown(sep)}")
        columns, unit = columns or {}, _letters(unit) if isinstance(unit, str) else unit or {}
        for what, named in {"columns": columns, "unit": {} if isinstance(unit, str) else unit}.items():
            kinds = (str, list) if what == "columns" else str
            texts = isinstance(named, Mapping) and all(isinstance(one, kinds) for one in named.values())
            refuse(not texts, f"{what} must map names to texts, such as {{'force': ...}}: got {shown(named)}")
        self.units = {name: column.unit for name, column in table.named.items() if column.unit}
        self.takers: dict[str, str] = {}  #: Columns that a unit for all can be of.
        if isinstance(unit, str):
            self.takers = {name: unit for name, own in self.units.items() if unit in UNITS[own]}
            fine = dict.fromkeys(one for own in self.units.values() for one in UNITS[own])
            refuse(not self.takers, f"unit must be one of {', '.join(fine)}: got {shown(unit)}")
            self.units |= self.takers
            unit = {}
        for what, given, names in (("columns", columns, table.named), ("unit", unit, self.units)):
            for ours in given:
                refuse(ours not in names, f"{what} must be of {', '.join(names)}: got {shown(ours)}")
        unit = {ours: _letters(one) for ours, one in unit.items()}
        for ours, one in unit.items():
            known = UNITS[table.named[ours].unit]
            refuse(one not in known, f"unit of {ours} must be one of {', '.join(known)}: got {shown(one)}")
        self.units |= unit
        self.said = set(unit)  #: Columns whose unit was given by name.
        self.asked = {
            ours: np.ravel(columns.get(ours) or column.heading).astype(str).tolist()
            for ours, column in table.named.items()
        }
        due = [ours for ours, column in table.named.items() if ours in columns or not column.optional]
        headings = [told for ours in due for told in self.asked[ours]]
        self.due = {_key(told): told for told in headings}
        self.hint = _give("columns", dict.fromkeys(due, "its heading"))
        refuse(len(self.due) < len(headings), f"columns must differ: got {', '.join(headings)}")
        self.name, self.note = "", ""  #: Of the file; what was read from where, converted and passed over.
        self.comments: dict[str, str] = {}
        self.columns: dict[str, Any] = {}  #: By our names.
        self.others: dict[str, list[str]] = {}  #: By their headings.
        self.passed: Counter[str] = Counter()
        self.wrong: dict[str, str] = {}  #: Units to be given.

    def file(self, file: Path | IO[str] | IO[bytes]) -> Layout:
        """Reads a file, one of our own if nothing is said of a layout; ValueError with all its faults."""
        if self.own:
            try:
                self.name, self.comments, self.columns = self.table.read(file, self.others)
            except ValueError as error:
                foreign = re.search("text file in UTF-8|unknown column|separator must be", str(error))
                raise ValueError(f"{error}{_FOREIGN if foreign else ''}") from None
            self.note = _apart(self.others) if self.others else ""
            return self
        decoded = isinstance(file, io.TextIOBase)
        refuse(decoded and self.encoding, "encoding must be left out for a file that is open as text")
        windows = f"; if Windows wrote it, {_give('encoding', 'cp1252')}"
        self.name, text = text_of(file, self.encoding or "utf-8-sig", windows)
        lines = list(io.StringIO(text.removeprefix("\ufeff"), newline=None))
        head, start, sep, headings = self.headings_of(lines)
        for line in lines[:head]:
            key, colon, value = line[1:].partition(":")
            if line.startswith("#") and colon:
                self.comments[key.strip()] = value.strip()
        above = sum(bool(line.strip(f"\n{sep} ")) for line in lines[:head])
        self.passed["lines above the headings"] = above
        self.read(self.name, "line", headings, _records(lines, start, sep), f"{self.name}, line {head + 1}")
        return self.noted(f"; separated by {_SEPARATORS[sep]}" if not self.sep else "")

    def frame(self, frame: Any) -> Layout:
        """Takes a DataFrame, or a mapping of columns; ValueError with all its faults."""
        kind = type(frame).__name__
        if not isinstance(frame, Mapping) and not hasattr(frame, "itertuples"):
            raise TypeError(
                f"frame must be a DataFrame or a mapping (a file is for from_csv), got {shown(frame)}"
            )
        levels = getattr(getattr(frame, "columns", None), "nlevels", 1)
        refuse(levels > 1, f"{kind}: columns must have one level of names, got a MultiIndex of {levels}")
        headings = [" ".join(str(heading).split()) for heading in frame]
        if missing := [told for key, told in self.due.items() if key not in map(_key, headings)]:
            raise ValueError(f"{kind}: no column is {', '.join(missing)}; there are {listed(headings)}")
        if hasattr(frame, "itertuples"):
            rows = frame.itertuples(index=False, name=None)
        else:
            sizes = {np.shape(values)[:1] for values in frame.values()}
            refuse(len(sizes) > 1 or () in sizes, f"{kind}: columns must be lists of one length")
            rows = zip(*frame.values(), strict=True)
        texts = enumerate(([_cell(value) for value in row] for row in rows), start=1)
        self.read(kind, "row", headings, texts, kind)
        return self.noted("")

    def data(self, kind: type[Made], needed: Collection[str] = (), **given: Any) -> Made:
        """The data set, with source, provenance (the note as "read") and the other columns as `others`.

        Numbers for all rows come from the file's comments or `given`, which must agree; those `needed` from one.
        """
        kept = origin(self.name, self.comments)
        if self.note:
            kept["provenance"] = kept.get("provenance", {}) | {"read": self.note}
        for name, unit in kind._NUMBERS.items():
            key, asked = f"{name}_{unit}", given.get(name)
            noted = number_in_comments(self.name, self.comments, key)
            if name in needed and noted is None and asked is None:
                add = f"add the comment '# {key}: ...' or give {name}="
                raise ValueError(f"{self.name}: the {name} is unknown: {add}")
            if None not in (noted, asked) and noted != asked:
                rule = f"{name} must be the {noted!r} of the comment '# {key}:' in the file"
                raise ValueError(f"{self.name}: {rule}: got {shown(asked)}")
            given[name] = asked if noted is None else noted
        try:
            made = kind(**self.columns, **kept | given)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}" if self.name else str(error)) from None
        object.__setattr__(made, "others", {name: tuple(texts) for name, texts in self.others.items()})
        return made

    def headings_of(self, lines: list[str]) -> tuple[int, int, str, list[str]]:
        """Index of the line of headings, index of the line below them, the separator, and the headings."""
        add = "; add a line of headings to a file without one"
        numbers = ", ".join(told for told in self.due.values() if re.fullmatch(r"[\d.,eE+-]*\d", told))
        refuse(numbers, f"{self.name}: columns must be headings, not numbers ({numbers}){add}")
        best: tuple[int, bool, int, int, list[str]] = (0, False, 0, 0, [])
        for place, line in enumerate(lines[:_SEARCHED]):
            bare = line.lstrip("#% ") if line[0] in "#%" else line
            for sep in self.sep or (*_SEPARATORS, " "):
                height, fields = _record([bare, *lines[place + 1 : place + _TALLEST]], sep)
                keys = set(map(_key, fields))
                if self.due.keys() <= keys and sep in (self.sep or _SEPARATORS):
                    return place, place + height, sep, fields
                words = sum(bool(re.search(r"[^\W\d]", text)) for text in fields) * (bare is line)
                best = max(
                    best, (len(self.due.keys() & keys), sep != " " and words > 1, words, -place, fields)
                )
        matches, marked, words, place, fields = best
        there = f"; line {1 - place} has {listed(filter(None, fields))}" if matches or words > 1 else add
        there += " between blanks, for which give sep=' ' (--sep ' ')" if not marked and words > 1 else ""
        due = ", ".join(self.due.values())
        raise ValueError(f"{self.name}: no line of headings has {due}{there}: {self.hint}")

    def read(
        self, name: str, kind: str, headings: list[str], records: Iterable[tuple[int, list[str]]], head: str
    ) -> None:
        """Fills `columns` and `others` from the records; ValueError with all faults."""
        keys, faults = list(map(_key, headings)), list[str]()
        there = {ours: told for ours, told in self.asked.items() if _key(told[0]) in keys}
        places = {ours: [keys.index(_key(one)) for one in told] for ours, told in there.items()}
        taken = [i for its in places.values() for i in its]
        optional = {one.name for one in self.table.columns if one.optional}
        sides = max(len(its) for ours, its in places.items() if ours not in optional)
        if self.takers and not self.takers.keys() & places.keys():
            unit, read = next(iter(self.takers.values())), ", ".join(headings[i] for i in taken)
            faults.append(f"{head}: unit must be one that a column can have ({read}): got {unit!r}")
        told = {ours: ", ".join(headings[i] for i in its) for ours, its in places.items()}
        for ours, its in places.items():
            if len(its) != sides and (len(its) > 1 or ours in optional):
                faults.append(f"{head}: columns of {ours} must be {sides} or none: got {told[ours]}")
            for i in its:
                if keys.count(keys[i]) > 1:
                    faults.append(f"{head}: column {headings[i]} is there twice")
                if ours in self.units and (said := self.wrong_unit(ours, headings[i])):
                    faults.append(f"{head}: column {headings[i]} {said}")
        columns = (
            replace(one, type=partial(self.value, one), told=told.get(name, ""))
            for name, one in self.table.named.items()
        )
        self.table = replace(self.table, columns=tuple(columns))
        faults += (f"{head}: {said}" for said in self.table.unpaired(told.values()))
        rest = {i: one for i, one in enumerate(headings) if i not in taken}
        for i, one in rest.items():
            if not one or keys.count(keys[i]) > 1:
                rest[i] = f"{one} (column {i + 1})".strip()
        self.others |= {label: [] for label in rest.values()}

        def rows() -> Iterator[tuple[str, dict[str, str]]]:
            first = kind == "line"
            for number, fields in records:
                where = f"{name}, {kind} {number}"
                if not any(fields):
                    continue
                if fields[0][:1] in ("#", "%"):
                    self.passed["comments"] += 1
                elif list(map(_key, fields)) == keys[: len(fields)]:
                    self.passed["repeated headings"] += 1
                    first = True
                elif len(fields) <= max(taken) or any(fields[len(headings) :]):
                    faults.append(f"{where}: {len(headings)} fields are due, found {len(fields)}")
                else:
                    cells = [(ours, fields[i]) for ours, its in places.items() for i in its]
                    if first and self.units_in(where, cells, faults):
                        continue
                    first = False
                    for side in range(sides):
                        texts = {ours: fields[its[side % len(its)]] for ours, its in places.items()}
                        if not all(texts[ours] for ours in texts.keys() - optional if len(places[ours]) > 1):
                            self.passed["empty fields"] += 1
                            continue
                        for i, label in rest.items():
                            self.others[label].append(fields[i] if i < len(fields) else "")
                        yield where, texts

        self.columns = self.table.checked(rows(), faults)
        refuse(not self.columns and not faults, f"{name}: there is no row below the headings")
        own = {ours: column.unit for ours, column in self.table.named.items()}
        changed = {ours: unit for ours, unit in self.units.items() if ours in places and unit != own[ours]}
        hint = f": {_give('unit', changed | self.wrong)}" if self.wrong else ""
        if any(f"has a {_MARKS[self.group]}" in fault for fault in faults):
            hint += f"; if decimals have a {_MARKS[self.group]}, {_give('decimal', self.group)}"
        refuse_all(name, faults, hint)
        self.others = {label: texts for label, texts in self.others.items() if label[0] != "(" or any(texts)}

    def noted(self, told: str) -> Layout:
        """With the note of what was read, told, passed over and kept apart."""
        parts = []
        for ours in self.columns:
            unit = f" in {self.units[ours]}" if ours in self.units else ""
            parts.append(f"{ours} from {self.table.named[ours].heading}{unit}")
        passed = ", ".join(f"{what} ({n})" for what, n in self.passed.items() if n)
        told += f"; passed over: {passed}" if passed else ""
        self.note = ", ".join(parts) + told + (f"; {_apart(self.others)}" if self.others else "")
        return self

    def wrong_unit(self, ours: str, heading: str) -> str:
        """What is wrong with the unit that a heading tells, "" for nothing."""
        told, sure = _told(heading)
        own, due = self.table.named[ours], self.units[ours]
        known = UNITS[own.unit]
        if told in ("", due) or not (sure or told in known or len(told) > 1):
            return ""
        if ours in self.said and not (sure and told in _KNOWN) and heading != own.heading:
            return ""
        if told in known:
            self.wrong[ours] = told
            return f"tells {told}, but would be read in {due}"
        if told not in _KNOWN:
            self.wrong[ours] = _MEANT.get(told, "its unit")
        return f"tells {listed([told])}, which is no unit of {ours} ({', '.join(known)})"

    def units_in(self, where: str, cells: Iterable[tuple[str, str]], faults: list[str]) -> bool:
        """Whether a row holds units and no numbers; `faults` gets those that contradict the ones given."""
        told = [(ours, text) for ours, text in cells if ours in self.units and text]
        if not told or any(re.match(r"[\s+.,-]*\d", text) for _, text in told):
            return False
        for ours, text in told:
            if said := self.wrong_unit(ours, text if re.match(r"\W", text) else f"[{text}]"):
                faults.append(f"{where}, column {self.table.named[ours].heading}: {said}")
        self.passed["lines of units"] += 1
        return True

    def value(self, column: Column, text: str) -> Any:
        """The value of a field, in our unit."""
        if not column.unit:
            return column.type(text)
        plain = self.number(text)
        try:
            value = column.type(plain)
        except ValueError as error:
            raise ValueError(str(error).replace(shown(plain), shown(text))) from None
        factor = UNITS[column.unit][self.units[column.name]]
        return value * factor.numerator / factor.denominator

    def number(self, text: str) -> str:
        """A number's text with a point and without marks between thousands; ValueError if it may be two."""
        whole, point, part = text.partition(self.decimal)
        if re.search(r"[^\W\deE_]", text):  # such as a date, where a point says nothing of decimals
            return text
        for mark in {*_BLANKS, self.group}.intersection(whole):
            has = f"{shown(text)} has a {_MARKS.get(mark)}"
            grouped = re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}(\{mark}\d{{3}})+", whole)
            joined, other = whole.replace(mark, ""), whole.replace(mark, ".")
            if mark == self.group:
                refuse(not grouped, f"{has}, decimals a {_MARKS[self.decimal]}")
                refuse(not point and whole.count(mark) == 1, f"{has}: it may be {joined} or {other}")
            if grouped:
                self.passed["marks between thousands"] += 1
                whole = joined
        return f"{whole}.{part}" if point else whole


def _apart(others: Mapping[str, object]) -> str:
    return f"other columns, kept apart: {listed(others)}"


def _record(lines: list[str], sep: str) -> tuple[int, list[str]]:
    """How many lines the first row takes, and its fields; a stray quotation mark is a character."""
    if sep == " ":
        lines = [line.strip(" ") for line in lines]
    reader = csv.reader(lines, delimiter=sep, skipinitialspace=sep != "\t", strict=True)
    try:
        fields, height = next(reader, []), max(reader.line_num, 1)
    except csv.Error:
        fields, height = lines[0].split(sep), 1
    return height, [" ".join(text.split()) for text in fields]


def _records(lines: list[str], start: int, sep: str) -> Iterator[tuple[int, list[str]]]:
    """Number from 1 and fields of each row."""
    while start < len(lines):
        height, fields = _record(lines[start : start + _TALLEST], sep)
        yield start + 1, fields
        start += height


def _cell(value: object) -> str:
    text = str(value)
    return "" if text in ("nan", "None", "<NA>", "NaT") else text


def _key(heading: str) -> str:
    """A heading for comparison: blanks are one, both micro signs the same."""
    return " ".join(heading.replace("\u00b5", "\u03bc").split())


def _told(heading: str) -> tuple[str, bool]:
    """The unit that a heading tells, "" for none, and whether it stands in brackets."""
    if found := re.search(r"[\[({<]([^\[({<]+)[\])}>]\W*$", heading):
        return re.sub(r"\s", "", _letters(found[1])), True
    found = _TAIL.search(_letters(heading))
    return (found[1].replace("_", "/"), False) if found else ("", False)


def _letters(text: str) -> str:
    """A unit in our letters: u for a micro sign, /s for s^-1, small ones for capitals (MN, MS are mega)."""
    text = re.sub(r"(?i)\bmicrons?\b", "um", re.sub("[\u00b5\u03bc]", "u", text.strip()))
    text = re.sub(r"(?i)\bsec\b", "s", text)
    text = re.sub(r"\s*[\u00b7\u22c5*.]?\s*(s|min)(\u207b\u00b9|\^?\{?-1\}?)$", r"/\1", text)
    return text if text in ("MN", "MS") else {unit.upper(): unit for unit in _KNOWN}.get(text, text)


def _give(option: str, value: Mapping[str, str] | str) -> str:
    """What to write in Python and on the command line."""
    text = value if isinstance(value, str) else ",".join(f"{key}={one}" for key, one in value.items())
    return f"give {option}={value!r} (--{option} {text})"
