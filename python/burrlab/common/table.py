"""CSV text with units in the column names: what the files of all data sets have in common.

TSV text as BIDS has it: tabs, column names in the first line, n/a where there is nothing.

What data sets have in common: read-only columns, equality, tables for pandas and notebooks.

Tables of a report: aligned text, HTML, and numbers as they are printed.
"""

from __future__ import annotations

import csv
import html
import io
import json
import math
import os
import re
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from html import escape
from typing import IO, TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.common.check import real, shown

if TYPE_CHECKING:
    import pandas
    from matplotlib.axis import Axis


Path: TypeAlias = str | os.PathLike[str]
Problem: TypeAlias = tuple[str, str] | None  # (name, sentence)


@dataclass(frozen=True)
class Layout:
    """The columns of one kind of file and the rules of its rows.

    Attributes
    ----------
    columns : mapping
        Name of a field of the data set -> its column in the file; one called "status" holds text.
    filled : mapping
        The columns that must be there and whose fields must not be empty -> what they are called in a sentence.
    required : tuple of str
        Other columns that must be there.
    pairs : tuple of (str, str)
        Columns that need one another.
    problem : callable
        The first rule that a row of numbers breaks, as (name, sentence), or None.
    """

    columns: Mapping[str, str]
    filled: Mapping[str, str]
    problem: Callable[[Mapping[str, float]], Problem]
    required: tuple[str, ...] = ()
    pairs: tuple[tuple[str, str], ...] = ()
    names: Mapping[str, str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", {column: name for name, column in self.columns.items()})


def decoded(name: str, content: bytes) -> str:
    """The text of a file; ValueError where it is none in UTF-8."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{name}: this is not a text file in UTF-8") from None
    if "\0" in text:
        raise ValueError(f"{name}: this is not a text file, it holds zero bytes")
    if found := re.search(
        r"[\1-\x08\x0b-\x0c\x0e-\x1f\x7f]", text
    ):  # nor would they do in a sentence about it
        raise ValueError(f"{name}: this is not a text file, it holds the control character {found[0]!r}")
    return text


def positive_problem(value: float, unit: str, *, or_zero: bool = False) -> str | None:
    """The sentence on a number that is not finite or not above 0 (or, as asked, not at least 0)."""
    if math.isfinite(value) and (value > 0 or (or_zero and value == 0)):
        return None
    return f"must be a finite number {'at least 0' if or_zero else 'above 0'}, in {unit}: got {shown(value)}"


def read(file: Path | IO[str] | IO[bytes], layout: Layout) -> tuple[str, dict[str, str], dict[str, Any]]:
    """The file's name, the comments above its table, and its columns by the names of their fields."""
    name, text = _text(file)
    comments: dict[str, str] = {}
    lines = _lines(text, comments)
    number, header = next(lines, (0, ""))
    if not number:
        raise ValueError(f"{name}: the file is empty, or holds nothing but comments")
    names = _columns(name, number, header, layout)
    columns: dict[str, list[Any]] = {attribute: [] for attribute in names}
    for number, line in lines:
        for attribute, value in _row(name, number, line, names, layout).items():
            columns[attribute].append(value)
    if not columns[names[0]]:
        raise ValueError(f"{name}: there is no row below the column names")
    return name, comments, columns


def write(file: Path | IO[str], comments: Mapping[str, str], columns: Mapping[str, Sequence[Any]]) -> None:
    """Comment lines, column names and rows; NaN becomes an empty field."""
    if isinstance(file, (str, os.PathLike)):
        with open(file, "w", encoding="utf-8", newline="") as stream:
            write(stream, comments, columns)
        return
    for key, value in comments.items():
        file.write(f"# {key}: {value}\n")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow(["" if isinstance(v, float) and math.isnan(v) else v for v in row])


def origin(file: str, comments: Mapping[str, str]) -> dict[str, Any]:
    """Source, by default the file's name, and provenance, where the comments hold one."""
    kept: dict[str, Any] = {"source": comments.get("source", os.path.basename(file))}
    if "provenance" in comments:
        kept["provenance"] = _provenance(comments["provenance"])
    return kept


def origin_comments(source: str, provenance: Mapping[str, Any], **numbers: float | None) -> dict[str, str]:
    """The comments that `origin` and `number_in_comments` read."""
    comments = {"source": source}
    comments |= {key: repr(value) for key, value in numbers.items() if value is not None}
    if provenance:
        comments["provenance"] = json.dumps(provenance)
    return comments


def number_in_comments(file: str, comments: Mapping[str, str], key: str) -> float | None:
    """A number above 0 among the comments; None where there is none."""
    if key not in comments:
        return None
    try:
        value = float(comments[key])
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise ValueError(
            f"{file}: {key} in the comments must be a finite number above 0: got {shown(comments[key])}"
        )
    return value


def agreed_number(
    file: str, comments: Mapping[str, str], key: str, name: str, argument: float | None
) -> float:
    """What a data set cannot do without: from the comment `key` or the argument `name`, which must agree."""
    noted = number_in_comments(file, comments, key)
    if noted is None and argument is None:
        raise ValueError(f"{file}: the {name} is unknown: add the comment '# {key}: ...' or give {name}=")
    if noted is not None and argument is not None and noted != argument:
        raise ValueError(
            f"{file}: {name} must be the {noted!r} of the comment '# {key}:' in the file: got {shown(argument)}"
        )
    value = argument if noted is None else noted
    assert value is not None
    return float(value)


def json_mapping(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping as JSON would give it back: NumPy's numbers and arrays, and tuples, as plain ones."""

    def without_numpy(value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else str(value)

    result: dict[str, Any] = json.loads(json.dumps(dict(provenance), default=without_numpy))
    return result


def _text(file: Path | IO[str] | IO[bytes]) -> tuple[str, str]:
    if isinstance(file, (str, os.PathLike)):
        with open(file, "rb") as stream:
            name, content = os.fspath(file), stream.read()
    else:
        name, raw = str(getattr(file, "name", "CSV text")), file.read()
        content = raw.encode() if isinstance(raw, str) else raw
    return name, decoded(name, content)


def _lines(text: str, comments: dict[str, str]) -> Iterator[tuple[int, str]]:
    """Lines of the table with their numbers, from 1; `comments` gets the `# key: value` lines above."""
    in_head = True
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        line = line.strip()
        if line.startswith("#"):
            key, colon, value = line[1:].partition(":")
            if in_head and colon:
                comments[key.strip()] = value.strip()
        elif line:
            in_head = False
            yield number, line


def _columns(file: str, number: int, header: str, layout: Layout) -> list[str]:
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in header and "," not in header:
            raise ValueError(
                f"{file}, line {number}: the separator must be a comma, not {word}; decimals have a point"
            )
    columns = _fields(file, number, header)
    for column in columns:
        if column not in layout.names:
            known = ", ".join(layout.columns.values())
            raise ValueError(f"{file}, line {number}: unknown column {shown(column)}; known are {known}")
        if columns.count(column) > 1:
            raise ValueError(f"{file}, line {number}: column {column} is there twice")
    names = [layout.names[column] for column in columns]
    for name in (*layout.filled, *layout.required):
        if name not in names:
            raise ValueError(f"{file}, line {number}: column {layout.columns[name]} is missing")
    for pair in layout.pairs:
        for one, other in (pair, pair[::-1]):
            if one in names and other not in names:
                raise ValueError(
                    f"{file}, line {number}: column {layout.columns[one]} needs column "
                    f"{layout.columns[other]} beside it"
                )
    return names


def _row(file: str, number: int, line: str, names: Sequence[str], layout: Layout) -> dict[str, Any]:
    texts = _fields(file, number, line)
    if len(texts) != len(names):
        due = ", ".join(layout.columns[name] for name in names)
        raise ValueError(f"{file}, line {number}: {len(names)} fields are due ({due}), found {len(texts)}")
    values: dict[str, Any] = {}
    for name, text in zip(names, texts, strict=True):
        values[name] = text if name == "status" else _number(file, number, name, text, layout)
    problem = layout.problem({name: value for name, value in values.items() if name != "status"})
    if problem:
        raise ValueError(f"{file}, line {number}, column {layout.columns[problem[0]]}: {problem[1]}")
    return values


def _number(file: str, number: int, name: str, text: str, layout: Layout) -> float:
    where = f"{file}, line {number}, column {layout.columns[name]}"
    if not text:
        if name in layout.filled:
            raise ValueError(f"{where}: every row needs {layout.filled[name]}")
        return math.nan
    try:
        value = float(text.replace("_", " "))  # Python's 1_000 is no number to a spreadsheet
    except ValueError:
        raise ValueError(f"{where}: {shown(text)} is not a number") from None
    if math.isnan(value):  # an empty field is the one way to say "no number"
        raise ValueError(f"{where}: must be a finite number, or empty where there is none: got {shown(text)}")
    return value


def _fields(file: str, number: int, line: str) -> list[str]:
    try:
        return [text.strip() for text in next(csv.reader([line], strict=True, skipinitialspace=True))]
    except csv.Error as error:
        raise ValueError(f"{file}, line {number}: not a line of comma-separated fields ({error})") from None


def _provenance(text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = None
    return value if isinstance(value, dict) else {"note": text}


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
    lines = [line.removesuffix("\r") for line in decoded(name, content).split("\n")]
    numbered = [(number_or_none, line) for number_or_none, line in enumerate(lines, start=1) if line.strip()]
    if not numbered:
        raise ValueError(f"{name}: the file is empty")
    (number_or_none, head), *body = numbered
    if "\t" not in head and "," in head:
        raise ValueError(f"{name}, line {number_or_none}: the separator must be a tab, not a comma")
    columns = _tab_fields(name, number_or_none, head)
    for column in columns:
        if not column:
            raise ValueError(f"{name}, line {number_or_none}: a column has no name")
        if columns.count(column) > 1:
            raise ValueError(f"{name}, line {number_or_none}: column {column} is there twice")
    rows = []
    for number_or_none, line in body:
        fields = _tab_fields(name, number_or_none, line)
        if len(fields) != len(columns):
            raise ValueError(
                f"{name}, line {number_or_none}: {len(columns)} fields are due, found {len(fields)}"
            )
        rows.append((number_or_none, dict(zip(columns, fields, strict=True))))
    return TextTable(name, tuple(columns), tuple(rows))


def line(fields: Sequence[str]) -> bytes:
    """A line of the file.

    Raises
    ------
    ValueError
        If a field is empty or holds a tab, a line break or a quotation mark.
    """
    for text in fields:
        if not text or any(mark in text for mark in '\t\r\n"'):
            raise ValueError(
                f"a field must be a text without tabs, line breaks and quotation marks, got {text!r}"
            )
    return ("\t".join(fields) + "\n").encode()


def number_or_none(text: str) -> float | None:
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


def _tab_fields(name: str, line: int, text: str) -> list[str]:
    try:
        return [field.strip(" ") for field in next(csv.reader([text], delimiter="\t", strict=True))]
    except csv.Error as error:
        raise ValueError(f"{name}, line {line}: not a line of fields between tabs ({error})") from None


Floats: TypeAlias = NDArray[np.float64]
Made = TypeVar("Made")


class DataSet(ABC):
    """What every data set has: equality by its fields, and its table as a DataFrame."""

    @abstractmethod
    def _table(self) -> Mapping[str, Sequence[Any]]:
        """Columns by their names in the CSV file."""

    def to_frame(self) -> pandas.DataFrame:
        """The data as a pandas DataFrame with the columns of the CSV file.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return frame(self._table())

    def __eq__(self, other: object) -> bool:
        return equal(self, other) if type(other) is type(self) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # it holds arrays


def frozen(name: str, values: ArrayLike) -> Floats:
    """A read-only copy of a column; ValueError unless it has one dimension."""
    array = real(values, name)
    if array.ndim != 1:
        raise ValueError(f"{name} must have one dimension: got shape {array.shape}")
    array.flags.writeable = False
    return array


def by_value(kind: type[Made]) -> type[Made]:
    """Of a dataclass with arrays: its objects are equal where all fields are, as data sets."""
    kind.__eq__ = DataSet.__eq__  # type: ignore[method-assign, assignment]
    kind.__hash__ = None  # type: ignore[assignment]
    return kind


def equal(one: Any, other: Any) -> bool:
    """Whether all fields of two data sets of one class are the same; NaN is the same as NaN."""
    return all(_same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one) if f.compare)


def frame(columns: Mapping[str, Sequence[Any]], what: str = "to_frame") -> pandas.DataFrame:
    """The columns as a pandas DataFrame; ImportError with one sentence without pandas."""
    try:
        import pandas
    except ImportError:
        raise ImportError(f"{what} needs pandas: pip install 'burrlab[pandas]'") from None
    return pandas.DataFrame(dict(columns))


def html_table(title: str, columns: Mapping[str, Sequence[Any]]) -> str:
    """A title and a table for notebooks."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    rows = zip(*columns.values(), strict=True)
    body = "".join("<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row) + "</tr>" for row in rows)
    title = f"<p>{html.escape(title)}</p>"
    return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def data_label(source: str) -> str:
    """The name of data in a legend, which says where they were not measured."""
    return next((f"{kind} data" for kind in ("synthetic", "simulated") if source.startswith(kind)), "data")


def log_ticks(axis: Axis) -> None:
    """Plain numbers at 1, 2 and 5 of every decade of a logarithmic axis."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_formatter(NullFormatter())


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    if isinstance(a, VoxelBone) and isinstance(b, VoxelBone):
        return a.digest() == b.digest()
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple) and type(a) is type(b):
        return len(a) == len(b) and all(map(_same, a, b))
    return a is b if a is None or b is None else bool(a == b)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.5g}"
    return html.escape(str(value))


#: What a column belongs to, its name, its cells.
Column: TypeAlias = tuple[str, str, list[str]]


def tables_lines(columns: Sequence[Column], width: int | None = None) -> list[str]:
    """One table, or as many as a screen of this width needs: parted between groups of columns, each with the first column."""
    if width is None:
        return table_lines(columns)
    first = columns[0]
    parts: list[list[Column]] = [[first]]
    for start, end in _groups(columns[1:]):
        group = list(columns[1:][start : end + 1])
        if len(parts[-1]) > 1 and max(map(len, table_lines([*parts[-1], *group]))) > width:
            parts.append([first])
        parts[-1] += group
    lines: list[str] = []
    for part in parts:
        lines += ["", *table_lines(part)] if lines else table_lines(part)
    return lines


def wrapped_lines(lines: Sequence[str], width: int | None) -> list[str]:
    """Sentences parted between words, what follows further in."""
    if width is None:
        return list(lines)
    found: list[str] = []
    for line in lines:
        inner = " " * (len(line) - len(line.lstrip()) + 4)
        found += textwrap.wrap(
            line, max(width, 40), subsequent_indent=inner, break_long_words=False, break_on_hyphens=False
        ) or [""]
    return found


def table_lines(columns: Sequence[Column]) -> list[str]:
    """Columns aligned under their heads; a head over those that belong together."""
    widths = [max(len(head), *map(len, cells), 1) for _, head, cells in columns]
    above = ""
    for first, last in _groups(columns):
        group = columns[first][0]
        room = sum(widths[first : last + 1]) + 2 * (last - first)
        if len(group) > room:
            widths[first] += len(group) - room
            room = len(group)
        above += group.center(room, "-" if group else " ") + "  "
    rows = [[head for _, head, _ in columns], *map(list, zip(*(cells for *_, cells in columns), strict=True))]
    lines = [
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return [above.rstrip(), *lines] if above.strip() else lines


def _groups(columns: Sequence[Column]) -> list[tuple[int, int]]:
    """First and last column of those that belong together."""
    found: list[tuple[int, int]] = []
    for place, (group, *_) in enumerate(columns):
        if found and group and columns[found[-1][0]][0] == group:
            found[-1] = found[-1][0], place
        else:
            found.append((place, place))
    return found


def table_html(columns: Sequence[Column]) -> str:
    """The same for notebooks."""
    heads = "".join(f"<th>{escape(f'{group}: {head}' if group else head)}</th>" for group, head, _ in columns)
    rows = zip(*(cells for *_, cells in columns), strict=True)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"


def two_decimals(value: float) -> str:
    """Two decimals, no negative zero; inf as a word, NaN as nothing."""
    if math.isnan(value):
        return ""
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return f"{round(value, 2) + 0.0:.2f}"


def interval_text(ends: tuple[float, float]) -> str:
    """Closed, or open above."""
    low, high = ends
    return f"[{low:.2f}, inf)" if math.isinf(high) else f"[{low:.2f}, {high:.2f}]"


def p_text(p: float) -> str:
    """Two digits."""
    return f"{p:.2g}" if p >= 1e-4 else f"{p:.0e}"


def tsv_text(value: float | int | str | None) -> str:
    """A field: n/a for nothing, numbers to the last bit."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "n/a"
    return repr(value) if isinstance(value, float) else str(value)
