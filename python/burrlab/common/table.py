"""Tables: CSV files with units in the column names, TSV files, data sets, text and HTML of reports."""

import contextlib
import csv
import html
import io
import itertools
import json
import math
import os
import re
import textwrap
import unicodedata
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from burrlab.common.check import check_same_length, content_of, extra, real, refuse, scalar, shown
from burrlab.common.files import write_text

if TYPE_CHECKING:
    import pandas


Path: TypeAlias = str | os.PathLike[str]
Problem: TypeAlias = tuple[str, str] | None  # (name of a column, message)


def number(text: str) -> float:
    """Number in a field of a CSV file, NaN for "nan" or an empty field; ValueError for any other text."""
    if not text:
        return math.nan
    try:
        return _float(text)
    except ValueError:
        none = ": leave the field empty where there is none" * bool(re.fullmatch("(?i)n/?a|-+|[#<>].*", text))
        raise ValueError(f"{shown(text)} is not a number{none}") from None


def _float(text: str) -> float:
    return float(text.replace("_", " "))  # 1_000 is no number in a spreadsheet


def finite(value: float, unit: str, rule: str = "", fine: bool = True) -> str | None:
    """Message for a number that is not finite or breaks a further rule, else None."""
    if math.isfinite(value) and fine:
        return None
    return f"must be a finite number{rule}{unit and f', in {unit}'}: got {shown(value)}"


def positive(value: float, unit: str) -> str | None:
    """Message for a number that is not finite or not above 0, else None."""
    return finite(value, unit, " above 0", value > 0)


def not_negative(value: float, unit: str) -> str | None:
    """Message for a number that is not finite or below 0, else None."""
    return finite(value, unit, " at least 0", value >= 0)


@dataclass(frozen=True)
class Column:
    """A column of a CSV file."""

    name: str  #: Of the field of a data set that holds the column.
    unit: str = ""  #: In the heading, beside the name.
    #: Field's text -> value; its ValueError tells a text without a value.
    type: Callable[[str], Any] = number
    #: Message for a value that breaks a rule.
    check: Callable[[Any, str], str | None] = lambda value, unit: None
    optional: bool = False
    due: str = ""  #: Content that an empty field lacks; "" if fields may be empty, and numbers NaN.
    label: str = ""  #: Another heading than the one of name and unit.

    @property
    def heading(self) -> str:
        """The column's name in the file."""
        return self.label or (f"{self.name}_{self.unit.replace('/', '_')}" if self.unit else self.name)


@dataclass(frozen=True)
class Table:
    """Columns of one kind of CSV file, and rules between columns."""

    columns: tuple[Column, ...]
    pairs: tuple[tuple[str, str], ...] = ()  #: Names of columns that need each other.
    #: The rule between columns that a row breaks.
    rule: Callable[[Mapping[str, Any]], Problem] = lambda row: None

    @cached_property
    def named(self) -> dict[str, Column]:
        """The columns by their names."""
        return {column.name: column for column in self.columns}

    def broken(self, name: str, value: Any) -> str | None:
        """Message for a value that breaks its column's rule, else None."""
        column = self.named[name]
        empty = not column.due and isinstance(value, float) and math.isnan(value)
        return None if empty else column.check(value, column.unit)

    def problem(self, row: Mapping[str, Any]) -> Problem:
        """(name of a column, message) of the first rule that the values of a row break, else None."""
        wrong = ((name, problem) for name, value in row.items() if (problem := self.broken(name, value)))
        return next(wrong, self.rule(row))

    def read(
        self, file: Path | IO[str] | IO[bytes], others: dict[str, list[str]] | None = None
    ) -> tuple[str, dict[str, str], dict[str, Any]]:
        """The file's name, the `# key: value` comments above its table, and its columns by their names.

        `others` gets the columns that are unknown, by their headings; without it they are refused. ValueError
        with all faults of the file.
        """
        name, text = text_of(file)
        comments: dict[str, str] = {}
        faults: list[str] = []
        columns = self.checked(self.rows(name, text, faults, comments, others), faults)
        refuse_all(name, faults)
        return name, comments, columns

    def checked(
        self, rows: Iterable[tuple[str, Mapping[str, str]]], faults: list[str]
    ) -> dict[str, list[Any]]:
        """Values by column name of the rows without faults; `faults` gets those of the others."""
        columns: dict[str, list[Any]] = {}
        for where, texts in rows:
            before = len(faults)
            row = self.values(where, texts, faults)
            wrong = [(name, self.broken(name, value)) for name, value in row.items()]
            if len(faults) == before and not any(problem for _, problem in wrong):
                wrong.append(self.rule(row) or ("", None))
            faults += [
                f"{where}, column {self.named[name].heading}: {problem}" for name, problem in wrong if problem
            ]
            for name, value in row.items():
                columns.setdefault(name, []).append(value)
        for name, values in columns.items():
            numbers = [value for value in values if isinstance(value, float) and not math.isnan(value)]
            if len(numbers) > 1 and max(numbers) < 0 and self.broken(name, max(numbers)):
                faults.insert(0, f"column {self.named[name].heading}: all are below 0: turn their sign")
        return columns

    def rows(
        self, name: str, text: str, faults: list[str], comments: dict[str, str] | None = None,
        others: dict[str, list[str]] | None = None,
    ) -> Iterator[tuple[str, dict[str, str]]]:  # fmt: skip
        """Place ("file, line 3") and texts by column name of each row; fills `faults`, `comments`, `others`."""
        lines = _lines(text, {} if comments is None else comments)
        line, header = next(lines, (0, ""))
        refuse(not line, f"{name}: the file is empty, or holds nothing but comments")
        columns = self._columns(f"{name}, line {line}", header.rstrip(", "), faults, others)
        empty = header[len(header.rstrip(", ")) :].count(",")  # columns that a spreadsheet added
        due = f"{len(columns)} fields are due ({listed(heading for heading, _ in columns)})"
        where = ""
        for line, content in lines:
            where = f"{name}, line {line}"
            try:
                texts = _fields(where, content)
                is_due = len(columns) <= len(texts) <= len(columns) + empty and not any(texts[len(columns) :])
                refuse(not is_due, f"{where}: {due}, found {len(texts)}")
            except ValueError as error:
                faults.append(str(error))
                continue
            row = list(zip(columns, texts, strict=False))
            if others:
                for (heading, _), cell in row:
                    others.get(heading, []).append(cell)
            yield where, {column.name: cell for (_, column), cell in row if column is not None}
        refuse(not where and not faults, f"{name}: there is no row below the column names")

    def values(self, where: str, texts: Mapping[str, str], faults: list[str]) -> dict[str, Any]:
        """Values of a row by column name; `faults` gets the texts without a value, with place and column."""
        values = {}
        for name, text in texts.items():
            column = self.named[name]
            try:
                refuse(column.due and not text, f"every row needs {column.due}")
                values[name] = column.type(text)
            except ValueError as error:
                faults.append(f"{where}, column {column.heading}: {error}")
        return values

    def unpaired(self, headings: Collection[str]) -> Iterator[str]:
        """What is wrong with headings of which one of a pair is missing."""
        for pair in self.pairs:
            first, second = (self.named[name].heading for name in pair)
            if (first in headings) != (second in headings):
                present, absent = (first, second) if first in headings else (second, first)
                yield f"column {present} needs column {absent} beside it"

    def _columns(
        self, where: str, header: str, faults: list[str], others: dict[str, list[str]] | None
    ) -> list[tuple[str, Column | None]]:
        """The headings in the file with their columns, None for those kept apart."""
        for separator, word in ((";", "semicolons"), ("\t", "tabs")):
            refuse(
                separator in header and "," not in header,
                f"{where}: the separator must be a comma, not {word}; decimals have a point",
            )
        known = {column.heading: column for column in self.columns}
        headings = _fields(where, header)
        missing = [c.heading for c in self.columns if not c.optional and c.heading not in headings]
        rest = [heading for heading in headings if heading not in known]
        if unknown := ", ".join(
            shown(heading) for heading in rest if others is None or missing or not heading
        ):
            faults.append(f"{where}: unknown column {unknown}; known are {', '.join(known)}")
        twice = dict.fromkeys(repeated for repeated in headings if repeated and headings.count(repeated) > 1)
        faults += (f"{where}: column {heading} is there twice" for heading in twice)
        if others is not None:
            others |= {heading: [] for heading in rest}
        faults += (f"{where}: column {heading} is missing" for heading in missing)
        faults += (f"{where}: {problem}" for problem in self.unpaired(headings))
        return [(heading, known.get(heading)) for heading in headings]


_MOST_FAULTS = 10  # faults that a message tells


def listed(names: Iterable[str]) -> str:
    """Names from a file for a message, which stays short."""
    text = ", ".join(names)
    return text if len(text) <= 200 else f"{text[:200]}..."


def refuse_all(name: str, faults: Sequence[str], hint: str = "") -> None:
    """ValueError with all faults of a file, each only once, and a hint, if there is any."""
    if not faults:
        return
    faults = list(dict.fromkeys(faults))
    first_faults = [
        fault.removeprefix(f"{name}, ").removeprefix(f"{name}: ") for fault in faults[:_MOST_FAULTS]
    ]
    more = f"; and {len(faults) - _MOST_FAULTS} more" if len(faults) > _MOST_FAULTS else ""
    several = f"{name}: {len(faults)} faults: {'; '.join(first_faults)}{more}"
    raise ValueError((faults[0] if len(faults) == 1 else several) + hint)


_LONGEST_LINE = 1 << 20  # characters; a longer line is no row of a table, and takes long to read


def decoded(name: str, content: bytes, encoding: str = "utf-8-sig", hint: str = "") -> str:
    """Text of a file's content; ValueError, with a hint, if it is no text in UTF-8 or another encoding."""
    try:
        text = content.decode(encoding)
    except LookupError:
        raise ValueError(f"encoding must be one such as cp1252 or utf-16, got {shown(encoding)}") from None
    except UnicodeError:
        kind = "UTF-8" if encoding == "utf-8-sig" else encoding
        raise ValueError(f"{name}: this is not a text file in {kind}{hint}") from None
    refuse("\0" in text, f"{name}: this is not a text file, it holds zero bytes")
    longest = max(map(len, text.splitlines()), default=0)
    refuse(
        longest > _LONGEST_LINE,
        f"{name}: a line must have at most {_LONGEST_LINE} characters, got one of {longest}",
    )
    # Messages quote the text: it must hold no control characters.
    if control := re.search(r"[\1-\x08\x0b-\x0c\x0e-\x1f\x7f]", text):
        raise ValueError(f"{name}: this is not a text file, it holds the control character {control[0]!r}")
    return text


def write(file: Path | IO[str], comments: Mapping[str, object], columns: Mapping[str, Sequence[Any]]) -> None:
    """Writes comment lines, column names and rows; NaN becomes an empty field."""
    writable = isinstance(file, (str, os.PathLike)) or hasattr(file, "write")
    refuse(not writable, f"file must be a path or an open text file, got {shown(file)}", TypeError)
    text = io.StringIO()
    text.writelines(f"# {key}: {value}\n" for key, value in comments.items())
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(
        ["" if isinstance(v, float) and math.isnan(v) else v for v in row]
        for row in zip(*columns.values(), strict=True)
    )
    write_text(file, text.getvalue())


def origin(file: str, comments: Mapping[str, str]) -> dict[str, Any]:
    """Source (default: the file's name), and provenance if the comments hold one."""
    known: dict[str, Any] = {"source": comments.get("source", os.path.basename(file))}
    if "provenance" in comments:
        try:
            noted = json.loads(comments["provenance"])
        except (ValueError, RecursionError):
            noted = None
        known["provenance"] = noted if isinstance(noted, dict) else {"note": comments["provenance"]}
    return known


def number_in_comments(file: str, comments: Mapping[str, str], key: str) -> float | None:
    """A number above 0 from the comments; None if there is none."""
    if key not in comments:
        return None
    try:
        value = _float(comments[key])
    except ValueError:
        value = math.nan
    refuse(
        not 0 < value < math.inf,
        f"{file}: {key} in the comments must be a finite number above 0: got {shown(comments[key])}",
    )
    return value


def json_mapping(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping after writing and reading JSON: NumPy numbers and arrays, and tuples, become plain."""
    if not isinstance(provenance, Mapping):
        raise TypeError(
            f"provenance must be a mapping, such as {{'operator': 'AB'}}, got {shown(provenance)}"
        )
    text = json.dumps(dict(provenance), default=lambda v: v.tolist() if hasattr(v, "tolist") else str(v))
    return dict(json.loads(text))


def text_of(file: Path | IO[str] | IO[bytes], encoding: str = "utf-8-sig", hint: str = "") -> tuple[str, str]:
    """Name of a file and its text in UTF-8, UTF-16 with its mark, or another encoding; else ValueError."""
    if isinstance(file, (str, os.PathLike)):
        name, content = os.fspath(file), content_of(file)
    elif not hasattr(file, "read"):
        frame = "; a DataFrame is for from_dataframe" if hasattr(file, "columns") else ""
        raise TypeError(f"file must be a path or an open file, got {shown(file)}{frame}")
    else:
        name, raw = str(getattr(file, "name", "CSV text")), file.read()
        content, encoding = (raw.encode(), "utf-8-sig") if isinstance(raw, str) else (raw, encoding)
    if encoding == "utf-8-sig" and content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    refuse(
        content.startswith((b"PK\3\4", b"\xd0\xcf\x11\xe0")),
        f"{name}: this is a workbook, such as .xlsx or .ods: save it as CSV",
    )
    return name, decoded(name, content, encoding, hint)


#: What a spreadsheet writes for no value, such as #N/A, #NV or #DIV/0!: it begins a row, and no comment.
ERROR_VALUE = re.compile(r"#(N/?[ADV]|[¡¿]?[A-ZÀ-Ý/0]+[!?])(?=[,;\t|]|$)")


def comment_in(line: str, sep: str) -> str | None:
    """The text of a comment, also of one that a spreadsheet took for a row and saved; None for another line."""
    if not line.startswith(("#", '"#')) or ERROR_VALUE.match(line):
        return None
    if line.startswith('"') or line.endswith(sep):
        with contextlib.suppress(csv.Error):
            line = ",".join(next(csv.reader([line], delimiter=sep))).rstrip(", ")
    return line.lstrip('"')[1:]


def _lines(text: str, comments: dict[str, str]) -> Iterator[tuple[int, str]]:
    """Lines of the table with their numbers from 1; `comments` gets the `# key: value` lines above."""
    in_head = True
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        line = line.strip()
        if (comment := comment_in(line, ",")) is not None:
            key, colon, value = comment.partition(":")
            if in_head and colon:
                comments[key.strip()] = value.strip()
        elif line:
            in_head = False
            yield number, line


def _fields(where: str, line: str, *, tabs: bool = False) -> list[str]:
    dialect: dict[str, Any] = {"delimiter": "\t"} if tabs else {"skipinitialspace": True}
    try:
        return [
            text.strip(" " if tabs else None) for text in next(csv.reader([line], strict=True, **dialect))
        ]
    except csv.Error as error:
        kind = "fields between tabs" if tabs else "comma-separated fields"
        raise ValueError(f"{where}: not a line of {kind} ({error})") from None


NOTHING = "n/a"


class TextTable(NamedTuple):
    """The fields of a file as text."""

    columns: tuple[str, ...]
    rows: tuple[tuple[int, Mapping[str, str]], ...]  #: Number of each line from 1, and its fields by column.


def split_torn(content: bytes) -> tuple[bytes, bytes]:
    """Complete lines, and the rest: a line whose writing was interrupted."""
    end = content.rfind(b"\n") + 1
    return content[:end], content[end:]


def parse(name: str, content: bytes) -> TextTable:
    """The table in a file's bytes; ValueError, with the file and the line, if it is none."""
    numbered = [
        (place, line.removesuffix("\r"))
        for place, line in enumerate(decoded(name, content).split("\n"), start=1)
        if line.strip()
    ]
    refuse(not numbered, f"{name}: the file is empty")
    refuse("\r" in numbered[0][1], f"{name}: lines must end in a line feed, got carriage returns alone")
    (place, head), *body = numbered
    refuse(
        "\t" not in head and "," in head, f"{name}, line {place}: the separator must be a tab, not a comma"
    )
    columns = _fields(f"{name}, line {place}", head, tabs=True)
    for column in columns:
        refuse(not column, f"{name}, line {place}: a column has no name")
        refuse(columns.count(column) > 1, f"{name}, line {place}: column {column} is there twice")
    rows = []
    for place, line in body:
        texts = _fields(f"{name}, line {place}", line, tabs=True)
        refuse(
            len(texts) != len(columns),
            f"{name}, line {place}: {len(columns)} fields are due, found {len(texts)}",
        )
        rows.append((place, dict(zip(columns, texts, strict=True))))
    return TextTable(tuple(columns), tuple(rows))


def line(fields: Sequence[str]) -> bytes:
    """A line of a TSV file; ValueError if a field is empty or holds a tab, a line break or a quotation mark."""
    for text in fields:
        refuse(
            not text or any(mark in text for mark in '\t\r\n"'),
            f"a field must be a text without tabs, line breaks and quotation marks, got {text!r}",
        )
    return ("\t".join(fields) + "\n").encode()


def number_or_none(text: str) -> float | None:
    """A finite number, or None for n/a; ValueError for any other text."""
    if text == NOTHING:
        return None
    try:
        value = _float(text)
    except ValueError:
        value = math.nan
    refuse(not math.isfinite(value), f"must be a finite number with a point, or {NOTHING}, got {text!r}")
    return value


def whole(text: str, *, below: int = 2**63) -> int | None:
    """A whole number from 0, or None for n/a; ValueError for any other text."""
    if text == NOTHING:
        return None
    refuse(
        not (text.isascii() and text.isdecimal() and len(text) < 21 and int(text) < below),
        f"must be a whole number from 0, or {NOTHING}, got {text!r}",
    )
    return int(text)


Floats: TypeAlias = NDArray[np.float64]
Made = TypeVar("Made")


def by_value(kind: type[Made]) -> type[Made]:
    """Decorator for a dataclass with arrays: objects are equal if all their fields are."""

    def equal(first: Any, second: Any) -> Any:
        if type(second) is not type(first):
            return NotImplemented
        return all(_same(getattr(first, f.name), getattr(second, f.name)) for f in fields(first) if f.compare)

    kind.__eq__ = equal  # type: ignore[method-assign]
    kind.__hash__ = None  # type: ignore[assignment]
    return kind


class Tabular(ABC):
    """Base of what converts to a DataFrame."""

    @abstractmethod
    def _table(self) -> Mapping[str, Any]:
        """Columns by their names, with units."""

    def to_dataframe(self) -> "pandas.DataFrame":
        """The data as a pandas DataFrame, units in the names of the columns.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return dataframe(self._table())


@by_value
class TableData(Tabular):
    """A data set with the columns of a `Table`, numbers that hold for all rows, source and provenance."""

    _TABLE: ClassVar[Table]
    _WHAT: ClassVar[str]  #: Name of the data set in a message.
    _LABELLED: ClassVar[str] = "row"  #: What a label is of.
    _NUMBERS: ClassVar[Mapping[str, str]] = {
        "radius": "mm"
    }  #: Numbers above 0 for all rows, with their units.
    source: str
    provenance: Mapping[str, Any]
    groups: Mapping[str, tuple[str, ...]]  #: Labels of the rows, by what they tell apart.
    #: Other columns of the file that it came from, texts by headings. They are neither compared nor written.
    others: Mapping[str, Sequence[str]] = MappingProxyType({})

    def _origin(self) -> str:
        """Source, and how it was read from a file of another program, for `__repr__`."""
        read = f"; {self.provenance['read']}" if "read" in self.provenance else ""
        return (f", {self.source!r}" if self.source else "") + read

    def _keep(
        self,
        columns: Mapping[str, Any],
        source: str,
        provenance: Mapping[str, Any] | None,
        groups: Mapping[str, Any] | None,
        specimen: Any,
        **numbers: float | None,
    ) -> None:
        """Sets the fields: columns of numbers as read-only copies, source, provenance, labels, numbers for all rows."""
        for name, values in columns.items():
            column = self._TABLE.named[name]
            if column.type is number and not (values is None and column.optional):
                raw, values = values, real(values, name)
                if not values.ndim:
                    raise ValueError(f"{name} must be a list of numbers, got {shown(raw)}")
                refuse(values.ndim != 1, f"{name} must have one dimension: got shape {values.shape}")
                values.flags.writeable = False
            vars(self)[name] = values
        for name, value in numbers.items():
            checked = None if value is None else scalar(value, name)
            vars(self)[name] = checked
            if checked is not None and (problem := positive(checked, self._NUMBERS[name])):
                raise ValueError(f"{name} {problem}")
        line = " ".join(str(source or "").split()).rstrip(", ")
        vars(self).update(source=line, provenance=json_mapping(provenance or {}))
        check_same_length(**self._columns())
        vars(self)["groups"] = self._labels(groups, specimen)

    def _labels(self, groups: Mapping[str, Any] | None, specimen: Any) -> dict[str, tuple[str, ...]]:
        """Labels of the rows as texts, by name; ValueError for a row without one."""
        if groups is not None and not isinstance(groups, Mapping):
            raise TypeError(f"groups must be a mapping, such as {{'day': labels}}, got {shown(groups)}")
        columns = dict(groups or {}) | ({} if specimen is None else {"specimen": specimen})
        labels = {}
        for name, column in columns.items():
            refuse(
                not re.fullmatch(r"\w+( \w+)*", str(name)),
                f"the name of a group must be of letters, digits and single blanks: got {name!r}",
            )
            refuse(
                str(name)
                in {text for column in self._TABLE.columns for text in (column.name, column.heading)},
                f"the name of a group must not be that of a column: got {name!r}",
            )
            texts = [
                label_text(label) for label in (column if np.ndim(column) else [column] * self._n_labels)
            ]
            refuse(
                len(texts) != self._n_labels,
                f"{name} must have {self._n_labels} labels, one a {self._LABELLED}: got {len(texts)}",
            )
            if "" in texts:
                raise ValueError(f"row {texts.index('') + 1}, {name}: every row needs a label")
            labels[str(name)] = tuple(texts)
        return labels

    @property
    def _n_labels(self) -> int:
        return len(self)

    def _columns(self) -> dict[str, Any]:
        """Columns that are not None, by their names."""
        return {name: getattr(self, name) for name in self._TABLE.named if getattr(self, name) is not None}

    def _check_rows(self) -> None:
        """ValueError unless there is a row and every row obeys the table's rules."""
        refuse(not len(self), f"{self._WHAT} needs at least one row")
        columns = self._columns()
        for i, row in enumerate(
            zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True), start=1
        ):
            if problem := self._TABLE.problem(dict(zip(columns, row, strict=True))):
                raise ValueError(f"row {i}, {problem[0]}: {problem[1]}")

    def _table(self) -> dict[str, list[Any]]:
        groups = self.groups if self._n_labels == len(self) else {}
        return {
            self._TABLE.named[name].heading: np.asarray(x).tolist() for name, x in self._columns().items()
        } | {name: list(labels) for name, labels in groups.items()}

    def _comments(self) -> dict[str, Any]:
        """What stands above the table in a file."""
        numbers = {f"{name}_{unit}": getattr(self, name) for name, unit in self._NUMBERS.items()}
        known = {"source": self.source} | {key: x for key, x in numbers.items() if x is not None}
        known |= {"groups": ", ".join(self.groups)} if self.groups else {}
        return known | ({"provenance": json.dumps(self.provenance)} if self.provenance else {})

    def to_csv(self, file: Path | IO[str]) -> None:
        """Write a CSV file that `from_csv` reads back without loss.

        Parameters
        ----------
        file : path or open text file

        Examples
        --------
        >>> import burrlab, sys
        >>> burrlab.VelocityCurve([0.5, 4], [0.0785, float("nan")], source="two runs").to_csv(sys.stdout)
        # source: two runs
        force_N,velocity_mm_s
        0.5,0.0785
        4.0,
        """
        write(file, self._comments(), self._table())

    def __len__(self) -> int:
        return len(getattr(self, self._TABLE.columns[0].name))

    def _repr_html_(self) -> str:
        return html_table(repr(self), self._table())


def label_text(label: object) -> str:
    """A label as text, "" for none; the numbers 2.0 and 2 are one."""
    if isinstance(label, float | np.floating):
        return "" if math.isnan(label) else f"{label:.15g}"
    return "" if label is None or str(label) in ("nan", "NaT", "<NA>") else " ".join(str(label).split())


def label_in_file(label: object) -> str:
    """The same of a label in a table: one umlaut may be of two signs, and a spreadsheet writes 2 as 2.0 or 2,00."""
    return re.sub(r"^(\d+)[.,]0+$", r"\1", unicodedata.normalize("NFC", label_text(label)))


def dataframe(columns: Mapping[str, Any]) -> "pandas.DataFrame":
    """The columns as a pandas DataFrame; ImportError without pandas."""
    frame: pandas.DataFrame = extra("pandas", "to_dataframe", "pandas").DataFrame(dict(columns))
    return frame


class Tabulated(Tabular):
    """A result that is a table for a paper too.

    Its rows are the estimates and the ends of their 95 % intervals; an open end is None, and NaN stands where there
    is no interval.
    """

    def to_latex(self) -> str:
        """The table of `to_dataframe` in LaTeX, with the rules of the package booktabs; an open end is called open."""

        def cell(value: object) -> str:
            text = "open" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
            text = "" if text == "nan" else text
            return re.sub(r"[%&_#$^{}\\~<>]", lambda sign: _LATEX.get(sign[0], f"\\{sign[0]}"), text)

        columns = self._table()
        kinds = [
            "r" if all(isinstance(x, float | None) for x in column) else "l" for column in columns.values()
        ]
        lines = [
            " & ".join(map(cell, row)) + r" \\" for row in (columns, *zip(*columns.values(), strict=True))
        ]
        begin, end = rf"\begin{{tabular}}{{{''.join(kinds)}}}", r"\end{tabular}"
        return "\n".join([begin, r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule", end])


# Signs that LaTeX needs another name for than the sign after a backslash.
_LATEX = {
    "^": r"\^{}",
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
}


def html_table(title: str, columns: Mapping[str, Sequence[Any]]) -> str:
    """HTML of a title and a table, for notebooks."""

    def cell(value: object) -> str:
        return str(value) if not isinstance(value, float) else "" if math.isnan(value) else f"{value:.5g}"

    rows = (list(map(cell, row)) for row in zip(*columns.values(), strict=True))
    return f"<p>{html.escape(title)}</p>{html_rows([list(columns), *rows])}"


def html_rows(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells, the heads first, as a table of HTML."""
    heads = "".join(f"<th>{html.escape(cell)}</th>" for cell in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[1:]
    )
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"


def html_pairs(pairs: Mapping[str, object]) -> str:
    """Names with their values, a row each, as a table of HTML."""
    rows = (f"<th>{html.escape(name)}</th><td>{html.escape(str(x))}</td>" for name, x in pairs.items())
    return f"<table>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


class ReportInHtml:
    """Base of results that a notebook shows as the text of their `report`, or of `str`."""

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(getattr(self, 'report', self.__str__)())}</pre>"


def data_label(source: str) -> str:
    """Name of data in a legend, with "synthetic" or "simulated" if the source begins so."""
    return next((f"{kind} data" for kind in ("synthetic", "simulated") if source.startswith(kind)), "data")


def _same(a: object, b: object) -> bool:
    """Whether two values of a field are equal; NaN equals NaN."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    if type(a) is type(b) and callable(digest := getattr(a, "digest", None)):  # a bone's
        return bool(digest() == b.digest())  # type: ignore[attr-defined]
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple) and type(a) is type(b):
        return len(a) == len(b) and all(map(_same, a, b))
    return a is b if a is None or b is None else bool(a == b)


#: Group, name and cells of a report's column.
ReportColumn: TypeAlias = tuple[str, str, list[str]]


def tables_lines(columns: Sequence[ReportColumn], width: int | None = None) -> list[str]:
    """Lines of one table, or of several that fit the width.

    Each table begins with the first column; groups stay together.
    """
    if width is None:
        return table_lines(columns)
    first = columns[0]
    parts: list[list[ReportColumn]] = [[first]]
    for places in _groups(columns[1:]):
        group = [columns[1 + place] for place in places]
        if len(parts[-1]) > 1 and max(map(len, table_lines([*parts[-1], *group]))) > width:
            parts.append([first])
        parts[-1] += group
    return [line for part in parts for line in ("", *table_lines(part))][1:]


def wrapped_lines(lines: Sequence[str], width: int | None) -> list[str]:
    """Lines wrapped between words to the width; continuation lines are indented."""
    if width is None:
        return list(lines)
    wrapped: list[str] = []
    for line in lines:
        inner = " " * (len(line) - len(line.lstrip()) + 4)
        wrapped += textwrap.wrap(
            line, max(width, 40), subsequent_indent=inner, break_long_words=False, break_on_hyphens=False
        ) or [""]
    return wrapped


def table_lines(columns: Sequence[ReportColumn]) -> list[str]:
    """Lines of a table: columns under their heads, with a common head over each group."""
    widths = [max(len(head), *map(len, cells), 1) for _, head, cells in columns]
    above = ""
    for first, *others in _groups(columns):
        group, beside = columns[first][0], sum(widths[place] + 2 for place in others)
        widths[first] = max(widths[first], len(group) - beside)
        above += group.center(widths[first] + beside, "-" if group else " ") + "  "
    rows = [[head for _, head, _ in columns], *map(list, zip(*(cells for *_, cells in columns), strict=True))]
    lines = [
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return [above.rstrip(), *lines] if above.strip() else lines


def _groups(columns: Sequence[ReportColumn]) -> list[list[int]]:
    """Places of the columns of each group; a column without one stands alone."""
    by_group = itertools.groupby(range(len(columns)), key=lambda place: columns[place][0] or place)
    return [list(places) for _, places in by_group]


def two_decimals(value: float) -> str:
    """A number with two decimals, without negative zero; infinity as inf, NaN as an empty text."""
    return "" if math.isnan(value) else f"{round(value, 2) + 0.0:.2f}"


def interval_text(ends: tuple[float, float]) -> str:
    """An interval as text; [low, inf) if its upper end is infinite."""
    low, high = ends
    return f"[{low:.2f}, inf)" if math.isinf(high) else f"[{low:.2f}, {high:.2f}]"


def p_text(p: float) -> str:
    """A p value with two digits."""
    return f"{p:.2g}" if p >= 1e-4 else f"{p:.0e}"


def probability_text(p: float) -> str:
    """A p value in a sentence."""
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"


def holm(p_values: Sequence[float]) -> list[float]:
    """p values corrected for their number by Holm's step-down rule.

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    corrected, least = list(p_values), 0.0
    for done, (p, k) in enumerate(sorted((p, k) for k, p in enumerate(p_values))):
        corrected[k] = least = max(least, min(1.0, (len(corrected) - done) * p))
    return corrected


def tsv_text(value: float | int | str | None) -> str:
    """Text of a TSV field: n/a for None and NaN, floats to the last bit."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NOTHING
    return repr(value) if isinstance(value, float) else str(value)
