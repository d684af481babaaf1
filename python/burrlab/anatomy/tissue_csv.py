"""Tables of tissues as CSV text."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections.abc import Collection, Iterator

from burrlab import csv_text
from burrlab._core import Material, Tissue, Tissues
from burrlab.anatomy.known_tissues import known_tissue
from burrlab.bounds import shown
from burrlab.json_text import UNREADABLE, in_one_line
from burrlab.materials import materials
from burrlab.session.snapshot import tissues_from_json, tissues_to_json

COLUMNS = ("label", "name", "colour", "c_e_N_per_mm2", "alpha_per_ms", "critical", "bleeds", "assumed")
GREY = (128, 128, 128)  # of a structure without a colour
_WAITS = " (name?)"  # after a name of the file that the default table does not know
_NEEDED = ("label", "name")
_WORDS = {"yes": True, "no": False, "true": True, "false": False, "1": True, "0": False}


def read_tissues(path: str | os.PathLike[str], *, material: Material | None = None) -> Tissues:
    """Reads a table of tissues: CSV text with the columns of `write_tissues`.

    Parameters
    ----------
    path : path-like
        Columns `label` and `name` must be there. An empty `colour`, `critical` or `bleeds` is what the default table
        says of a structure of that name (else grey, no, no). An empty `c_e_N_per_mm2` or `alpha_per_ms` is the
        material's, and the tissue then counts as assumed, but for bone with both of the material's.
    material : Material, optional
        The bone. Default: the one in the file's comments, as `write_tissues` puts it there, else `materials["bone"]`.

    Returns
    -------
    Tissues

    Raises
    ------
    ValueError
        If the file is no such table, or a template in which rows wait for a name; the sentence names line and column.
    OSError
        If it cannot be read.
    """
    name = os.fspath(path)
    with open(path, "rb") as stream:
        text = csv_text.decoded(name, stream.read())
    if material is None:
        material = _material(name, text)
    lines = ((n, line.strip()) for n, line in enumerate(io.StringIO(text, newline=None), start=1))
    table = ((n, _fields(name, n, line)) for n, line in lines if line and not line.startswith("#"))
    try:
        number, columns = next(table)
    except StopIteration:
        raise ValueError(f"{name}: the file is empty, or holds nothing but comments") from None
    _check_columns(f"{name}, line {number}", columns)
    waiting: list[str] = []
    rows = list(_rows(name, columns, table, material, waiting))
    if waiting:
        told = ", ".join(waiting)
        raise ValueError(f"{name}, {told}, column name: every row needs a name, that of its structure")
    if not rows:
        raise ValueError(f"{name}: there is no row below the column names")
    try:
        return Tissues(rows, material)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def write_tissues(path: str | os.PathLike[str], tissues: Tissues) -> None:
    """Writes a table as CSV text, which `read_tissues` gives back without loss.

    Parameters
    ----------
    path : path-like
    tissues : Tissues
        Values that are assumed and the material's stay empty in the file.

    Raises
    ------
    ValueError
        If a name has a line break, or space around it.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import burrlab, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> from burrlab.anatomy import default_tissues
    >>> table = default_tissues({1: "bone", 2: "facial nerve"})
    >>> write_tissues(folder.name + "/table.csv", table)
    >>> read_tissues(folder.name + "/table.csv") == table
    True
    >>> folder.cleanup()
    """
    text = tissues_text(tissues)
    with open(path, "w", encoding="utf-8", newline="") as stream:
        stream.write(text)


def tissues_text(tissues: Tissues, unnamed: Collection[int] = ()) -> str:
    """The table as `write_tissues` writes it; ValueError where a name has a line break or space around it.

    Of `unnamed` labels, colours that are grey and all that follows from a name stay empty, as their names are still to be given:
    "structure 3", and what the file says with a mark behind it, are refused by `read_tissues`.
    """
    for tissue in tissues:
        if len(tissue.name.splitlines()) != 1 or tissue.name != tissue.name.strip():
            raise ValueError(
                f"name of a tissue must be one line without space around it, got {tissue.name!r}"
            )
    stream = io.StringIO()
    material = json.loads(tissues_to_json(tissues))["material"]
    stream.write(f"# material: {json.dumps(material)}\n")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for t in tissues:
        values = [
            "" if t.assumed and own == bone else repr(own)
            for own, bone in ((t.c_e, tissues.material.c_e), (t.alpha, tissues.material.alpha))
        ]
        flags = ["yes" if flag else "no" for flag in (t.critical, t.bleeds, t.assumed)]
        colour = "#{:02x}{:02x}{:02x}".format(*t.colour)
        if t.label in unnamed:
            colour, flags = ("" if t.colour == GREY else colour), ["", "", ""]
        mark = _WAITS if t.label in unnamed and t.name != f"structure {t.label}" else ""
        writer.writerow([t.label, t.name + mark, colour, *values, *flags])
    return stream.getvalue()


def _material(name: str, text: str) -> Material:
    for line in text.splitlines():
        if line.startswith("# material:"):
            given = line.partition(":")[2].strip()
            row = '[{"name": "x", "label": 0, "c_e_N_per_mm2": 1, "alpha_per_ms": 0, "colour": [0, 0, 0], '
            row += '"critical": false, "bleeds": false, "assumed": true}]'
            try:
                return tissues_from_json(f'{{"material": {given}, "tissues": {row}}}').material
            except UNREADABLE as error:
                told = in_one_line(error)
                raise ValueError(f"{name}: the material in the comments is none: {told}") from None
    return materials["bone"]


def _fields(name: str, number: int, line: str) -> list[str]:
    try:
        return [text.strip() for text in next(csv.reader([line], strict=True, skipinitialspace=True))]
    except csv.Error as error:
        raise ValueError(f"{name}, line {number}: not a line of comma-separated fields ({error})") from None


def _check_columns(where: str, columns: list[str]) -> None:
    for column in columns:
        if column not in COLUMNS:
            raise ValueError(f"{where}: unknown column {shown(column)}; known are {', '.join(COLUMNS)}")
        if columns.count(column) > 1:
            raise ValueError(f"{where}: column {column} is there twice")
    for column in _NEEDED:
        if column not in columns:
            raise ValueError(f"{where}: column {column} is missing")


def _rows(
    file: str, columns: list[str], table: Iterator[tuple[int, list[str]]], material: Material, wait: list[str]
) -> Iterator[Tissue]:
    """The rows that have a name; where the others are, in `wait`."""
    lines: dict[str, int] = {}
    for number, texts in table:
        where = f"{file}, line {number}"
        if len(texts) != len(columns):
            raise ValueError(
                f"{where}: {len(columns)} fields are due ({', '.join(columns)}), found {len(texts)}"
            )
        row = dict(zip(columns, texts, strict=True))
        flags = row.get("critical") or row.get("bleeds")
        if row["name"] in ("", "" if flags else f"structure {row['label']}") or row["name"].endswith(_WAITS):
            wait.append(f"line {number}" + (f" ({row['name']!r})" if row["name"] else ""))
            continue
        for column in _NEEDED:
            key = f"{column} {row[column]}"
            if key in lines:
                raise ValueError(
                    f"{where}, column {column}: {shown(row[column])} is in line {lines[key]} already"
                )
            lines[key] = number
        yield _tissue(where, row, material)


def _tissue(where: str, row: dict[str, str], material: Material) -> Tissue:
    label, name = row["label"], row["name"]
    if not (label.isascii() and label.isdecimal() and len(label) < 20 and int(label) < 2**31):
        raise ValueError(f"{where}, column label: must be a whole number from 0, got {shown(label)}")
    known = known_tissue(name)
    c_e = _number(where, "c_e_N_per_mm2", row, "from 1/4096 to 1000", 1 / 4096, 1000.0)
    alpha = _number(where, "alpha_per_ms", row, "zero or positive", 0.0, math.inf)
    is_bone = known is not None and known.bone and c_e is None and alpha is None
    lacking = (c_e is None or alpha is None) and not is_bone
    assumed = _flag(where, "assumed", row, lacking)
    if lacking and not assumed:
        raise ValueError(f"{where}, column assumed: must be yes where c_e or alpha is empty, got 'no'")
    return Tissue(
        name, label=int(label), c_e=material.c_e if c_e is None else c_e,
        alpha=material.alpha if alpha is None else alpha,
        colour=_colour(where, row.get("colour", ""), known.colour if known else GREY),
        critical=_flag(where, "critical", row, known is not None and known.critical),
        bleeds=_flag(where, "bleeds", row, known is not None and known.bleeds), assumed=assumed,
    )  # fmt: skip


def _number(
    where: str, column: str, row: dict[str, str], rule: str, least: float, most: float
) -> float | None:
    text = row.get(column, "")
    if not text:
        return None
    try:
        value = float(text.replace("_", " "))  # Python's 1_000 is no number to a spreadsheet
    except ValueError:
        raise ValueError(f"{where}, column {column}: {shown(text)} is not a number") from None
    if not (math.isfinite(value) and least <= value <= most):
        raise ValueError(f"{where}, column {column}: must be {rule}, got {shown(text)}")
    return value


def _flag(where: str, column: str, row: dict[str, str], default: bool) -> bool:
    text = row.get(column, "")
    if not text:
        return default
    if text.lower() not in _WORDS:
        raise ValueError(f"{where}, column {column}: must be yes or no, got {shown(text)}")
    return _WORDS[text.lower()]


def _colour(where: str, text: str, default: tuple[int, int, int]) -> tuple[int, int, int]:
    if not text:
        return default
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text) is None:
        raise ValueError(f"{where}, column colour: must be #rrggbb, got {shown(text)}")
    red, green, blue = (int(text[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue
