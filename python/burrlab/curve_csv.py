"""Velocity-force curves as CSV text, and the rules that their numbers obey."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from burrlab.curve import VelocityCurve

COLUMNS = {
    "force": "force_N",
    "velocity": "velocity_mm_s",
    "sigma": "sigma_mm_s",
    "window_start": "window_start_mm",
    "window_end": "window_end_mm",
    "status": "status",
}
REQUIRED = ("force", "velocity")
_ATTRIBUTE = {column: name for name, column in COLUMNS.items()}
_UNITS = {"force": "N", "velocity": "mm/s", "sigma": "mm/s", "window_start": "mm", "window_end": "mm"}


def problem_in_row(row: Mapping[str, float]) -> tuple[str, str] | None:
    """The first rule that a row of numbers breaks, as (name, sentence); None where it breaks none.

    NaN stands for "no number", which only the force must not be.
    """
    for name, value in row.items():
        if math.isnan(value) and name != "force":
            continue
        smallest = "at least 0" if name == "window_start" else "above 0"
        if not math.isfinite(value) or value < 0 or (value == 0 and name != "window_start"):
            return name, f"must be a finite number {smallest}, in {_UNITS[name]}: got {value!r}"
    start, end = row.get("window_start", math.nan), row.get("window_end", math.nan)
    if math.isnan(start) != math.isnan(end):
        missing = "window_start" if math.isnan(start) else "window_end"
        return missing, "a window needs both its ends or neither"
    if start >= end:
        return "window_start", f"must be below the window's end of {end!r} mm: got {start!r}"
    return None


def read(file: str | os.PathLike[str] | IO[str] | IO[bytes]) -> dict[str, Any]:
    """The arguments of a VelocityCurve, from CSV text. See `VelocityCurve.from_csv`."""
    name, text = _text(file)
    comments: dict[str, str] = {}
    lines = _lines(text, comments)
    number, header = next(lines, (0, ""))
    if not number:
        raise ValueError(f"{name}: the file is empty, or holds nothing but comments")
    names = _columns(name, number, header)
    columns: dict[str, list[Any]] = {attribute: [] for attribute in names}
    for number, line in lines:
        for attribute, value in _row(name, number, line, names).items():
            columns[attribute].append(value)
    if not columns["force"]:
        raise ValueError(f"{name}: there is no row below the column names")
    return columns | _kept(name, comments)


def write(curve: VelocityCurve, file: str | os.PathLike[str] | IO[str]) -> None:
    """Write a curve as CSV text. See `VelocityCurve.to_csv`."""
    if isinstance(file, (str, os.PathLike)):
        with open(file, "w", encoding="utf-8", newline="") as stream:
            write(curve, stream)
        return
    file.write(f"# source: {curve.source}\n")
    if curve.radius is not None:
        file.write(f"# radius_mm: {curve.radius!r}\n")
    if curve.provenance:
        file.write(f"# provenance: {json.dumps(curve.provenance)}\n")
    columns = table(curve)
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow(["" if isinstance(v, float) and math.isnan(v) else v for v in row])


def plain(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping as JSON would give it back: NumPy's numbers and arrays, and tuples, as plain ones."""

    def without_numpy(value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else str(value)

    result: dict[str, Any] = json.loads(json.dumps(dict(provenance), default=without_numpy))
    return result


def table(curve: VelocityCurve) -> dict[str, list[float] | list[str]]:
    """The curve's columns by their names in the CSV file, those that it has."""
    columns: dict[str, list[float] | list[str]] = {}
    for name, column in COLUMNS.items():
        values = getattr(curve, name)
        if values is not None:
            columns[column] = list(values) if name == "status" else values.tolist()
    return columns


def _text(file: str | os.PathLike[str] | IO[str] | IO[bytes]) -> tuple[str, str]:
    if isinstance(file, (str, os.PathLike)):
        with open(file, "rb") as stream:
            name, content = os.fspath(file), stream.read()
    else:
        name, raw = str(getattr(file, "name", "CSV text")), file.read()
        content = raw.encode() if isinstance(raw, str) else raw
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{name}: this is not a text file in UTF-8") from None
    if "\0" in text:
        raise ValueError(f"{name}: this is not a text file, it holds zero bytes")
    return name, text


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


def _columns(file: str, number: int, header: str) -> list[str]:
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in header and "," not in header:
            raise ValueError(
                f"{file}, line {number}: the separator must be a comma, not {word}; decimals have a point"
            )
    columns = _fields(file, number, header)
    for column in columns:
        if column not in _ATTRIBUTE:
            known = ", ".join(COLUMNS.values())
            raise ValueError(f"{file}, line {number}: unknown column {column!r}; known are {known}")
        if columns.count(column) > 1:
            raise ValueError(f"{file}, line {number}: column {column} is there twice")
    names = [_ATTRIBUTE[column] for column in columns]
    for name in REQUIRED:
        if name not in names:
            raise ValueError(f"{file}, line {number}: column {COLUMNS[name]} is missing")
    for one, other in (("window_start", "window_end"), ("window_end", "window_start")):
        if one in names and other not in names:
            raise ValueError(
                f"{file}, line {number}: column {COLUMNS[one]} needs column {COLUMNS[other]} beside it"
            )
    return names


def _row(file: str, number: int, line: str, names: Sequence[str]) -> dict[str, Any]:
    texts = _fields(file, number, line)
    if len(texts) != len(names):
        raise ValueError(
            f"{file}, line {number}: {len(names)} fields are due ({', '.join(COLUMNS[n] for n in names)}), "
            f"found {len(texts)}"
        )
    values: dict[str, Any] = {}
    for name, text in zip(names, texts, strict=True):
        values[name] = text if name == "status" else _number(file, number, name, text)
    problem = problem_in_row({name: value for name, value in values.items() if name != "status"})
    if problem:
        raise ValueError(f"{file}, line {number}, column {COLUMNS[problem[0]]}: {problem[1]}")
    return values


def _number(file: str, number: int, name: str, text: str) -> float:
    where = f"{file}, line {number}, column {COLUMNS[name]}"
    if not text:
        if name == "force":
            raise ValueError(f"{where}: every row needs a force")
        return math.nan
    try:
        value = float(text.replace("_", " "))  # Python's 1_000 is no number to a spreadsheet
    except ValueError:
        raise ValueError(f"{where}: {text!r} is not a number") from None
    if math.isnan(value):  # an empty field is the one way to say "no number"
        raise ValueError(f"{where}: must be a finite number, or empty where there is none: got {text!r}")
    return value


def _fields(file: str, number: int, line: str) -> list[str]:
    try:
        return [text.strip() for text in next(csv.reader([line], strict=True, skipinitialspace=True))]
    except csv.Error as error:
        raise ValueError(f"{file}, line {number}: not a line of comma-separated fields ({error})") from None


def _kept(file: str, comments: Mapping[str, str]) -> dict[str, Any]:
    """What the comment lines above the table say of it."""
    kept: dict[str, Any] = {"source": comments.get("source", os.path.basename(file))}
    if "radius_mm" in comments:
        try:
            kept["radius"] = float(comments["radius_mm"])
        except ValueError:
            kept["radius"] = math.nan
        if not 0 < kept["radius"] < math.inf:
            raise ValueError(
                f"{file}: radius_mm in the comments must be a finite number above 0: "
                f"got {comments['radius_mm']!r}"
            )
    if "provenance" in comments:
        kept["provenance"] = _provenance(comments["provenance"])
    return kept


def _provenance(text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except ValueError:
        value = None
    return value if isinstance(value, dict) else {"note": text}
