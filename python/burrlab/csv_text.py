"""CSV text with units in the column names: what the files of all data sets have in common."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO, Any, TypeAlias

from burrlab.bounds import shown

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


def plain(provenance: Mapping[str, Any]) -> dict[str, Any]:
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
