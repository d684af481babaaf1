"""Tables of other programs: spreadsheets and loggers, with their own headings, units, separators and decimals."""

import csv
import io
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import IO, Any, TypeVar

import numpy as np

from burrlab.common.check import amend_error, refuse, shown
from burrlab.common.table import (
    ERROR_VALUE,
    Column,
    Path,
    Table,
    TableData,
    comment_in,
    label_in_file,
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
    base: {unit: Fraction(factor) for unit, _, factor in (text.partition(" ") for text in listing.split(", "))}
    for base, listing in {
        "N": "N 1, mN 1/1000, cN 1/100, daN 10, kN 1000, gf 0.00980665, kgf 9.80665, kp 9.80665, lbf 4.4482216152605",
        "mm/s": "mm/s 1, um/s 1/1000, cm/s 10, m/s 1000, mm/min 1/60, um/min 1/60000, in/s 25.4",
        "mm": "mm 1, um 1/1000, cm 10, m 1000, in 25.4",
        "s": "s 1, ms 1/1000, us 1/1000000, min 60",
    }.items()
}  # fmt: skip
_KNOWN = sorted((unit for factors in UNITS.values() for unit in factors), key=len, reverse=True)
#: Two fields, parted by a tab, that may be one number with a decimal comma; and a field that is a number.
_PAIR = re.compile(r"(?<![^\t])[+-]?\d+\t\d+(?:[eE][+-]?\d+)?(?![^\t])")
_NUMBER = re.compile(r"(?<![^\t])[+-]?\d[\d.,]*(?:[eE][+-]?\d+)?(?![^\t])")
_MEANT = {"g": "gf", "kg": "kgf", "lb": "lbf", "lbs": "lbf"}
_TAIL = re.compile(rf"(?:^|[\s_,/=])({'|'.join(unit.replace('/', '[/_]') for unit in (*_KNOWN, *_MEANT))})$")
#: Units amid a heading, such as "v_um_s.1"; not um, in and min between blanks, which are words.
_AMID = re.compile(
    rf"(?:^|[\s_,/=.:|-])({'|'.join(unit.replace('/', '[/_.]') for unit in (*_KNOWN, *_MEANT) if len(unit) > 1 and unit not in ('um', 'in', 'min'))})"
    r"(?=$|[\s_,/=.:|-])|[_.|](um)(?=[_.|])"
)
_WORDS = {
    r"newtons?": "N", r"gramm?s?": "gf", r"kilogramm?s?": "kgf", r"pounds?": "lbf", r"millimet(er|re)s?": "mm",
    r"microns?|micromet(er|re)s?": "um", r"centimet(er|re)s?": "cm", r"inch(es)?": "in",
    r"millisec(ond)?s?|millisekunden?": "ms", r"sec(ond)?s?|sekunden?": "s", r"minute[ns]?": "min",
}  # fmt: skip

DataSet = TypeVar("DataSet", bound=TableData)


def _group_headings(groups: Mapping[str, str] | None, specimen: str | None) -> dict[str, str]:
    refuse(
        not isinstance(groups, Mapping | None) or not isinstance(specimen, str | None),
        f"groups must map names to headings, such as {{'day': 'Messtag'}}, and specimen must be one: got "
        f"{shown(groups)} and {shown(specimen)}",
        TypeError,
    )
    refuse(
        specimen is not None and "specimen" in (groups or {}),
        "specimen must be given once: got it in groups too",
    )
    return dict(groups or {}) | ({} if specimen is None else {"specimen": specimen})


class TableLayout:
    """How a table of another program is laid out, which `VelocityCurve.from_csv` tells, and what one such held."""

    of_frame = False  # rather of a file

    def __init__(
        self, table: Table, columns: Mapping[str, Any] | None, unit: str | Mapping[str, str] | None,
        sep: str | None = None, decimal: str | None = None, encoding: str | None = None,
        groups: Mapping[str, str] | None = None, specimen: str | None = None,
    ) -> None:  # fmt: skip
        self.table, self.decimal, self.encoding = table, decimal or ".", encoding
        #: Whether the file is one of our own; whether its commas are known to stand between fields alone.
        self.is_native, self.is_clear = not any((columns, unit, sep, decimal, encoding)), decimal == "."
        for option, text in {"sep": sep, "decimal": decimal, "encoding": encoding}.items():
            refuse(not isinstance(text, str | None), f"{option} must be a text: got {shown(text)}")
        self.thousands = "." if self.decimal == "," else ","
        self.sep = {"tab": "\t", "\\t": "\t", None: ""}.get(sep, sep or "")
        refuse(self.decimal not in _MARKS, f"decimal must be a point or a comma: got {shown(decimal)}")
        refuse(
            len(self.sep) > 1 or self.sep in ('"', "\r", "\n"),
            f"sep must be one character, or tab: got {shown(sep)}",
        )
        columns, unit = columns or {}, unit or {}
        _check_mapping("columns", columns, table.named, (str, list))
        self.units = {name: column.unit for name, column in table.named.items() if column.unit}
        self.common_unit: dict[str, str] = {}  #: A unit for all, by the columns that can have it.
        if isinstance(unit, str):
            self.common_unit = self._columns_of_unit(_letters(unit))
            self.units |= self.common_unit
            unit = {}
        _check_mapping("unit", unit, self.units, str)
        unit = {name: _letters(text) for name, text in unit.items()}
        for name, text in unit.items():
            factors = UNITS[table.named[name].unit]
            refuse(
                text not in factors, f"unit of {name} must be one of {', '.join(factors)}: got {shown(text)}"
            )
        self.units |= unit
        self.named_units = set(unit)  #: Columns whose unit was given by name.
        self.headings = {
            name: np.ravel(columns.get(name) or column.heading).astype(str).tolist()
            for name, column in table.named.items()
        }
        required = [name for name, column in table.named.items() if name in columns or not column.optional]
        headings = [heading for name in required for heading in self.headings[name]]
        self.required = {_key(heading): heading for heading in headings}
        self.hint = _give("columns", dict.fromkeys(required, "its heading"))
        refuse(len(self.required) < len(headings), f"columns must differ: got {', '.join(headings)}")
        self.name, self.note = "", ""  #: Of the file; what was read from where, converted and passed over.
        self.comments: dict[str, str] = {}
        self.columns: dict[str, Any] = {}  #: By our names.
        self.others: dict[str, list[str]] = {}  #: By their headings.
        self.groups: dict[str, list[str]] = {}  #: Labels of the rows, by the group's name.
        self.group_headings = _group_headings(groups, specimen)
        self.skipped: Counter[str] = Counter()
        self.missing_units: dict[str, str] = {}  #: Units to be given.

    def _columns_of_unit(self, unit: str) -> dict[str, str]:
        """The columns that can have a unit for all, each with this unit."""
        takers = {name: unit for name, base in self.units.items() if unit in UNITS[base]}
        units = dict.fromkeys(known for base in self.units.values() for known in UNITS[base])
        refuse(not takers, f"unit must be one of {', '.join(units)}: got {shown(unit)}")
        return takers

    def file(self, file: Path | IO[str] | IO[bytes]) -> "TableLayout":
        """Reads a file, one of our own if nothing is said of a layout; ValueError with all its faults."""
        if self.is_native:
            try:
                self.name, self.comments, self.columns = self.table.read(file, self.others)
            except ValueError as error:
                foreign = re.search("text file in UTF-8|unknown column|separator must be", str(error))
                raise ValueError(f"{error}{_FOREIGN if foreign else ''}") from None
            self.take_groups()
            self.note = _apart(self.others) if self.others else ""
            return self
        refuse(
            self.encoding and isinstance(file, io.TextIOBase),
            "encoding must be left out for a file that is open as text",
        )
        self.name, content = text_of(
            file, self.encoding or "utf-8-sig", f"; if Windows wrote it, {_give('encoding', 'cp1252')}"
        )
        lines = list(io.StringIO(content.removeprefix("\ufeff"), newline=None))
        head, start, sep, headings = self.headings_of(lines)
        for line in lines[:head]:
            key, colon, text = (comment_in(line.strip(), sep) or "").partition(":")
            if colon:
                self.comments[key.strip()] = text.strip()
        self.is_clear |= sep != ","
        self.skipped["lines above the headings"] = sum(bool(line.strip(f"\n{sep} ")) for line in lines[:head])
        self.read(self.name, "line", headings, _records(lines, start, sep), f"{self.name}, line {head + 1}")
        return self.noted(f"; separated by {_SEPARATORS[sep]}" if not self.sep else "")

    def frame(self, frame: Any) -> "TableLayout":
        """Takes a DataFrame, or a mapping of columns; ValueError with all its faults."""
        kind, self.of_frame = type(frame).__name__, True
        if not isinstance(frame, Mapping) and not hasattr(frame, "itertuples"):
            raise TypeError(
                f"frame must be a DataFrame or a mapping (a file is for from_csv), got {shown(frame)}"
            )
        levels = getattr(getattr(frame, "columns", None), "nlevels", 1)
        refuse(levels > 1, f"{kind}: columns must have one level of names, got a MultiIndex of {levels}")
        headings = [" ".join(str(heading).split()) for heading in frame]
        if missing := [text for key, text in self.required.items() if key not in map(_key, headings)]:
            raise ValueError(f"{kind}: no column is {', '.join(missing)}; there are {listed(headings)}")
        if hasattr(frame, "itertuples"):
            rows = frame.itertuples(index=False, name=None)
        else:
            sizes = {np.shape(column)[:1] for column in frame.values()}
            refuse(len(sizes) > 1 or () in sizes, f"{kind}: columns must be lists of one length")
            rows = zip(*frame.values(), strict=True)
        self.read(kind, "row", headings, enumerate((list(map(_cell, row)) for row in rows), start=1), kind)
        return self.noted("")

    def data(self, kind: type[DataSet], needed: Collection[str] = (), **numbers: Any) -> DataSet:
        """The data set, with source, provenance (the note as "read") and the other columns as `others`.

        Numbers for all rows come from the file's comments or `numbers`, which must agree; those `needed` from one.
        """
        source = origin(self.name, self.comments)
        if self.note:
            source["provenance"] = source.get("provenance", {}) | {"read": self.note}
        for name, unit in kind._NUMBERS.items():
            key, number = f"{name}_{unit}", numbers.get(name)
            noted = number_in_comments(self.name, self.comments, key)
            refuse(
                name in needed and noted is None and number is None,
                f"{self.name}: the {name} is unknown: add the comment '# {key}: ...' or give {name}=",
            )
            refuse(
                None not in (noted, number) and noted != number,
                f"{self.name}: {name} must be the {noted!r} of the comment '# {key}:' in the file: "
                f"got {shown(number)}",
            )
            numbers[name] = number if noted is None else noted
        with amend_error(f"{self.name}: " if self.name else ""):
            data_set = kind(**self.columns, **{"groups": self.groups} | source | numbers)
        object.__setattr__(data_set, "others", {name: tuple(texts) for name, texts in self.others.items()})
        return data_set

    def headings_of(self, lines: list[str]) -> tuple[int, int, str, list[str]]:
        """Index of the line of headings, index of the line below them, the separator, and the headings."""
        add = "; add a line of headings to a file without one"
        numbers = ", ".join(text for text in self.required.values() if re.fullmatch(r"[\d.,eE+-]*\d", text))
        refuse(numbers, f"{self.name}: columns must be headings, not numbers ({numbers}){add}")
        best: tuple[int, bool, int, int, list[str]] = (0, False, 0, 0, [])
        for place, line in enumerate(lines[:_SEARCHED]):
            bare = line.lstrip("#% ") if line[0] in "#%" else line
            for sep in self.sep or (*_SEPARATORS, " "):
                height, fields = _record([bare, *lines[place + 1 : place + _TALLEST]], sep)
                keys = set(map(_key, fields))
                if self.required.keys() <= keys and sep in (self.sep or _SEPARATORS):
                    return place, place + height, sep, fields
                words = sum(bool(re.search(r"[^\W\d]", text)) for text in fields) * (bare is line)
                best = max(
                    best, (len(self.required.keys() & keys), sep != " " and words > 1, words, -place, fields)
                )
        matches, marked, words, place, fields = best
        nearest = f"; line {1 - place} has {listed(filter(None, fields))}" if matches or words > 1 else add
        if not marked and words > 1:
            nearest += " between blanks, for which give sep=' ' (--sep ' ')"
        raise ValueError(
            f"{self.name}: no line of headings has {', '.join(self.required.values())}{nearest}: {self.hint}"
        )

    def read(
        self, name: str, kind: str, headings: list[str], records: Iterable[tuple[int, list[str]]], head: str
    ) -> None:
        """Fills `columns` and `others` from the fields below the headings; ValueError with all faults.

        Parameters
        ----------
        name : str
            Of the file or frame, for messages; `head` says also where its headings are.
        kind : {"line", "row"}
            What `records` count.
        headings : list of str
        records : iterable of (number, fields)
        """
        # The indices of each column in the file: one, or one for each repeat side by side.
        keys, faults = list(map(_key, headings)), list[str]()
        places = {
            column: [keys.index(_key(text)) for text in texts]
            for column, texts in self.headings.items()
            if _key(texts[0]) in keys
        }
        optional = {column.name for column in self.table.columns if column.optional}
        repeats = max(len(indices) for column, indices in places.items() if column not in optional)
        labels = {column: ", ".join(headings[i] for i in indices) for column, indices in places.items()}
        faults += (f"{head}: {fault}" for fault in self.faults_of_headings(headings, places, repeats))
        used = {i for indices in places.values() for i in indices}
        other = {  # labels of the other columns; the number tells those of one heading apart
            i: heading if heading and keys.count(keys[i]) == 1 else f"{heading} (column {i + 1})".strip()
            for i, heading in enumerate(headings)
            if i not in used
        }
        self.others |= {label: [] for label in other.values()}
        # From here on a column reads numbers in the file's unit, and its faults name the file's heading.
        columns = (
            replace(column, type=partial(self.number_in_our_unit, column), label=labels.get(column.name, ""))
            for column in self.table.named.values()
        )
        self.table = replace(self.table, columns=tuple(columns))
        faults += (f"{head}: {fault}" for fault in self.table.unpaired(labels.values()))
        # The rows: units and comments are passed over, then repeats are split, then the table checks them.
        rows = self.rows_of_numbers(name, kind, keys, places, records, faults)
        rows = self.without_doubtful(rows, kind, keys, places, faults)
        repeated = {column for column, indices in places.items() if len(indices) > 1} - optional
        self.columns = self.table.checked(self.single_rows(rows, places, repeats, repeated, other), faults)
        refuse(not self.columns and not faults, f"{name}: there is no row below the headings")
        refuse_all(name, faults, self.hint_of(faults, places.keys()))
        self.others = {label: texts for label, texts in self.others.items() if label[0] != "(" or any(texts)}

    def hint_of(self, faults: Iterable[str], columns: Collection[str]) -> str:
        """What to give so that a table with these faults can be read."""
        changed = {
            column: unit
            for column, unit in self.units.items()
            if column in columns and unit != self.table.named[column].unit
        }
        hint = f": {_give('unit', changed | self.missing_units)}" if self.missing_units else ""
        if any(f"has a {_MARKS[self.thousands]}" in fault for fault in faults):
            way = "make them numbers first" if self.of_frame else _give("decimal", self.thousands)
            hint += f"; if decimals have a {_MARKS[self.thousands]}, {way}"
        return hint

    def faults_of_headings(
        self, headings: list[str], places: Mapping[str, list[int]], repeats: int
    ) -> Iterator[str]:
        """What is wrong with the columns at these places, each of which may be repeated so often."""
        keys = list(map(_key, headings))
        if self.common_unit and not self.common_unit.keys() & places.keys():
            used = ", ".join(headings[i] for indices in places.values() for i in indices)
            yield f"unit must be one that a column can have ({used}): got {next(iter(self.common_unit.values()))!r}"
        for column, indices in places.items():
            if len(indices) != repeats and (len(indices) > 1 or self.table.named[column].optional):
                yield f"columns of {column} must be {repeats} or none: got {', '.join(headings[i] for i in indices)}"
            for i in indices:
                if keys.count(keys[i]) > 1:
                    yield f"column {headings[i]} is there twice"
                if column in self.units and (fault := self.wrong_unit(column, headings[i])):
                    yield f"column {headings[i]} {fault}"

    def rows_of_numbers(
        self, name: str, kind: str, keys: list[str], places: Mapping[str, list[int]],
        records: Iterable[tuple[int, list[str]]], faults: list[str],
    ) -> Iterator[tuple[str, list[str]]]:  # fmt: skip
        """Where each row of numbers stands, and its fields; comments, repeated headings and units are passed over."""
        used = [(column, i) for column, indices in places.items() for i in indices]
        last_used, labelled = max(i for _, i in used), list(map(_key, self.group_headings.values()))
        may_be_units = kind == "line"
        for number, fields in records:
            where = f"{name}, {kind} {number}"
            if not any(fields):
                continue
            if fields[0][:1] in ("#", "%") and not (ERROR_VALUE.match(fields[0]) and any(fields[1:])):
                self.skipped["comments"] += 1
                if keys[0] in labelled and len(fields) == len(keys):
                    faults.append(
                        f"{where}: a comment, or a row of {fields[0]!r}? Labels must not begin with # or %"
                    )
            elif list(map(_key, fields)) == keys[: len(fields)]:
                self.skipped["repeated headings"] += 1
                may_be_units = True
            elif len(fields) <= last_used or any(fields[len(keys) :]):
                joined = not self.is_clear and self.fits_joined(fields, keys)
                hint = ": a number with a decimal comma must stand in quotation marks" if joined else ""
                faults.append(f"{where}: {len(keys)} fields are due, found {len(fields)}{hint}")
            elif not (
                may_be_units and self.units_in(where, [(column, fields[i]) for column, i in used], faults)
            ):
                may_be_units = False
                yield where, fields

    def without_doubtful(
        self, rows: Iterable[tuple[str, list[str]]], kind: str, keys: list[str],
        places: Mapping[str, list[int]], faults: list[str],
    ) -> Iterator[tuple[str, list[str]]]:  # fmt: skip
        """The rows; if commas may stand in decimals, as no number with a point shows, that is their one fault."""
        used = [i for indices in places.values() for i in indices]
        doubtful, is_clear, n_before = "", kind == "row" or self.is_clear, len(faults)
        for where, fields in rows:
            is_clear = is_clear or (self.decimal == "." and any("." in fields[i] for i in used))
            if not (doubtful or is_clear) and self.fits_joined(fields, keys):
                doubtful = f"{where}: {shown(','.join(fields))}"
            yield where, fields
        if doubtful and not is_clear:
            faults[n_before:] = [
                f"{doubtful} may have commas in its decimals: put such numbers in quotation marks, or take the "
                "comma off the end of each line; if commas only separate, give decimal='.' (--decimal .)"
            ]

    def fits_joined(self, fields: list[str], keys: list[str]) -> bool:
        """Whether a row has more fields than headings, and fits if some of its commas stand in decimals."""
        last_field = max((i for i, text in enumerate(fields, 1) if text), default=0)
        last_heading = max((i for i, key in enumerate(keys, 1) if key), default=0)
        excess = max(len(fields) - len(keys), last_field - last_heading)
        pairs, numbers = (len(pattern.findall("\t".join(fields))) for pattern in (_PAIR, _NUMBER))
        return 0 < excess <= min(pairs, numbers - len(self.required))

    def single_rows(
        self, rows: Iterable[tuple[str, list[str]]], places: Mapping[str, list[int]], repeats: int,
        repeated: Collection[str], rest: Mapping[int, str],
    ) -> Iterator[tuple[str, dict[str, str]]]:  # fmt: skip
        """Where a row stands and its fields by column: of a row of k repeats k times, without empty ones."""
        for where, fields in rows:
            for repeat in range(repeats):
                texts = {column: fields[at[repeat % len(at)]] for column, at in places.items()}
                if not all(texts[column] for column in repeated):
                    self.skipped["empty fields"] += 1
                    continue
                for i, label in rest.items():
                    self.others[label].append(fields[i] if i < len(fields) else "")
                yield where, texts

    def take_groups(self) -> None:
        """Moves the columns of labels from `others` to `groups`; ValueError if a column or a label is missing."""
        named = re.split(r"[,;\t] *", self.comments.get("groups", ""))
        headings = {_key(heading): heading for heading in self.others}
        for name, text in (
            {name: name for name in named if name in self.others} | self.group_headings
        ).items():
            refuse(
                _key(str(text)) not in headings,
                f"{self.name}: no column of labels is {text}, among {listed(headings.values())}",
            )
            heading = headings[_key(text)]
            refuse(heading not in self.others, f"{self.name}: {heading} may be one group: got it twice")
            self.groups[name] = labels = list(map(label_in_file, self.others.pop(heading)))
            empty = [str(row) for row, label in enumerate(labels, start=1) if not label]
            refuse(
                empty,
                f"{self.name}, column {heading}: every row needs a label, got none in row {listed(empty)}",
            )

    def noted(self, ending: str) -> "TableLayout":
        """With the note of what was read, `ending`, and what was passed over and kept apart."""
        self.take_groups()
        parts = [f"{name} from {heading}" for name, heading in self.group_headings.items()]
        parts += [
            f"{name} from {self.table.named[name].heading}{f' in {self.units[name]}' if name in self.units else ''}"
            for name in self.columns
        ]
        passed = ", ".join(f"{what} ({n})" for what, n in self.skipped.items() if n)
        ending += f"; passed over: {passed}" if passed else ""
        self.note = ", ".join(parts) + ending + (f"; {_apart(self.others)}" if self.others else "")
        return self

    def wrong_unit(self, name: str, heading: str) -> str:
        """What is wrong with the unit that a heading of this column tells, "" for nothing."""
        unit, in_brackets = _unit_in(heading)
        column, expected = self.table.named[name], self.units[name]
        known = UNITS[column.unit]
        told = in_brackets or unit in known or _MEANT.get(unit) in known or len(unit) > 1
        if unit in ("", expected) or not told:
            return ""
        if name in self.named_units and not (in_brackets and unit in _KNOWN) and heading != column.heading:
            return ""
        if unit in known:
            self.missing_units[name] = unit
            return f"tells {unit}, but would be read in {expected}"
        if unit not in _KNOWN:
            self.missing_units[name] = _MEANT.get(unit, "its unit")
        return f"tells {listed([unit])}, which is no unit of {name} ({', '.join(known)})"

    def units_in(self, where: str, cells: Iterable[tuple[str, str]], faults: list[str]) -> bool:
        """Whether a row holds units and no numbers; `faults` gets those that contradict the ones given."""
        units = [(name, text) for name, text in cells if name in self.units and text]
        if not units or any(re.match(r"[\s+.,-]*\d", text) for _, text in units):
            return False
        for name, text in units:
            if fault := self.wrong_unit(name, text if re.match(r"\W", text) else f"[{text}]"):
                faults.append(f"{where}, column {self.table.named[name].heading}: {fault}")
        self.skipped["lines of units"] += 1
        return True

    def number_in_our_unit(self, column: Column, text: str) -> Any:
        """What a field of a column holds, in our unit."""
        if not column.unit:
            return column.type(text)
        plain = self.number(text)
        try:
            number = column.type(plain)
        except ValueError as error:
            raise ValueError(str(error).replace(shown(plain), shown(text))) from None
        factor = UNITS[column.unit][self.units[column.name]]
        return number * factor.numerator / factor.denominator

    def number(self, text: str) -> str:
        """A number's text with a point and without marks between thousands; ValueError if it may be two."""
        whole, point, part = text.partition(self.decimal)
        if re.search(r"[^\W\deE_]", text):  # such as a date, where a point says nothing of decimals
            return text
        for mark in {*_BLANKS, self.thousands}.intersection(whole):
            has = f"{shown(text)} has a {_MARKS.get(mark)}"
            grouped = re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}(\{mark}\d{{3}})+", whole)
            joined, other = whole.replace(mark, ""), whole.replace(mark, ".")
            if mark == self.thousands:
                refuse(not grouped, f"{has}, decimals a {_MARKS[self.decimal]}")
                refuse(not point and whole.count(mark) == 1, f"{has}: it may be {joined} or {other}")
            if grouped:
                self.skipped["marks between thousands"] += 1
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


def _cell(field: object) -> str:
    text = str(int(field) if isinstance(field, float) and field.is_integer() else field)
    return "" if text in ("nan", "None", "<NA>", "NaT") else text


def _key(heading: str) -> str:
    """A heading for comparison: blanks are one, both micro signs the same."""
    return " ".join(heading.replace("\u00b5", "\u03bc").split())


def _unit_in(heading: str) -> tuple[str, bool]:
    """The unit that a heading tells, "" for none, and whether it stands in brackets."""
    heading = unicodedata.normalize("NFKC", heading).replace("\u2212", "-")
    for bracket in reversed(re.findall(r"[\[({<【]([^\[({<【]+)[\])}>】]", heading)):
        if (unit := re.sub(r"\s", "", _letters(bracket))) in _KNOWN:
            return unit, True
    if bracket := re.search(r"[\[({<]([^\[({<]+)[\])}>]\W*$", heading):
        return re.sub(r"\s", "", _letters(bracket[1])), True
    letters = _letters(heading.strip("_.|:- "))
    told = _TAIL.search(letters) or _AMID.search(letters)
    return (re.sub("[_.]", "/", told[1] or told[2]), False) if told else ("", False)


def _letters(text: str) -> str:
    """A unit in our letters: u for a micro sign, /s for s^-1, small ones for capitals (MN, MS are mega)."""
    text = re.sub("[\u00b5\u03bc]", "u", text.strip())
    for word, unit in _WORDS.items():
        text = re.sub(rf"(?i)(?<![^\W_])({word})(?![^\W_])", unit, text)
    text = re.sub(r"(?i)(?<=[a-z])[\s_]+(per|pro|par)[\s_]+|\s*/\s*", "/", text)
    text = re.sub(r"[\s_]*[\u00b7\u22c5*.]?\s*(s|min)(\u207b\u00b9|\^?\{?-1\}?)$", r"/\1", text)
    return text if text in ("MN", "MS") else {unit.upper(): unit for unit in _KNOWN}.get(text, text)


def _give(option: str, choice: Mapping[str, str] | str) -> str:
    """What to write in Python and on the command line."""
    text = choice if isinstance(choice, str) else ",".join(f"{key}={text}" for key, text in choice.items())
    return f"give {option}={choice!r} (--{option} {text})"


def _check_mapping(option: str, mapping: Any, names: Collection[str], kinds: Any) -> None:
    """ValueError unless an option maps some of these names to texts."""
    refuse(
        not isinstance(mapping, Mapping) or not all(isinstance(text, kinds) for text in mapping.values()),
        f"{option} must map names to texts, such as {{'force': ...}}: got {shown(mapping)}",
    )
    for name in mapping:
        refuse(name not in names, f"{option} must be of {', '.join(names)}: got {shown(name)}")
