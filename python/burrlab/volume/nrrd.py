"""Headers of NRRD files. Fields after the format definition, teem.sourceforge.net/nrrd/format.html."""

from __future__ import annotations

import re

import numpy as np

from burrlab.bounds import shown
from burrlab.volume.geometry import Array
from burrlab.volume.header import (
    LPS_ASSUMED,
    MILLIMETRES,
    Header,
    check_not_negative,
    header_text,
    three_sizes,
    unit_columns,
)

_TO_LPS = {
    "left-posterior-superior": (1.0, 1.0), "lps": (1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0), "ras": (-1.0, -1.0),
    "left-anterior-superior": (1.0, -1.0), "las": (1.0, -1.0),
}  # fmt: skip
_SYNONYMS = {"datafile": "data file", "byteskip": "byte skip", "lineskip": "line skip"}
# Kinds of an axis whose samples are values of one voxel.
_VALUES = ("color", "vector", "point", "gradient", "normal", "complex", "quaternion", "matrix", "hsv", "xyz")


def segment_layers(name: str) -> tuple[int, dict[str, str]]:
    """How many layers a segmentation of 3D Slicer has in its file, 1 if none, and the fields that describe its segments."""
    fields, keys, _ = nrrd_fields(name)
    kinds, sizes = fields.get("kinds", "").lower().split(), fields.get("sizes", "").split()
    layered = len(sizes) == 4 and kinds[:1] == ["list"] and re.fullmatch(r"\d{1,9}", sizes[0])
    return (int(sizes[0]) if layered else 1), keys


def read_nrrd_header(name: str, *, layers: bool = False) -> Header:
    """Place of the voxels, of each layer if asked; ValueError with one sentence where the header cannot be read."""
    fields, keys, _ = nrrd_fields(name)
    try:
        sizes = [int(n) for n in fields["sizes"].split()]
        dimension = int(fields["dimension"])
    except (KeyError, ValueError):
        raise ValueError(f"{name}: cannot be read as a volume: the NRRD header has no sizes") from None
    kinds = [kind.lower() for kind in fields.get("kinds", "").split()] or ["?"] * len(sizes)
    vectors = _vectors(fields, name)
    counts = {len(sizes), len(kinds), len(vectors or sizes)}
    if counts != {dimension} or dimension > 16:  # the format's limit
        raise ValueError(
            f"{name}: cannot be read as a volume: the NRRD header contradicts its dimension {shown(dimension)}"
        )
    spatial = [i for i in range(dimension) if (vectors[i] if vectors else not _holds_values(kinds[i]))]
    while len(spatial) > 3 and 1 in (rest := [sizes[i] for i in spatial]):
        del spatial[len(rest) - 1 - rest[::-1].index(1)]
    if len(spatial) != 3 or any(
        n > 1 for i, n in enumerate(sizes) if i not in spatial and not (layers and i == 0)
    ):
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got sizes {' x '.join(map(shown, sizes))}"
        )
    shape = three_sizes([sizes[i] for i in spatial], name)
    names, colours = _segments(keys)
    notes: list[str] = []
    if vectors:
        if any(len(vectors[i]) != 3 for i in spatial):
            raise ValueError(f"{name}: space directions of the NRRD header must be three vectors of three")
        table = np.array([vectors[i] for i in spatial], dtype=float).T
        table = _to_lps(fields, name, notes)[:, None] * _unit(fields.get("space units"), name, notes) * table
        spacing, direction = unit_columns(table)
        origin = _origin(fields, name, notes)
        return Header(shape, spacing, origin, direction, tuple(notes), names, colours)
    spacing = _spacings(fields, spatial, name, notes)
    notes.append(f"the NRRD header says no orientation: {LPS_ASSUMED}, voxel axes along L, P, S")
    return Header(shape, spacing, _origin(fields, name, notes), np.eye(3), tuple(notes), names, colours)


def nrrd_fields(name: str) -> tuple[dict[str, str], dict[str, str], int]:
    """Fields, keys, and where the values begin, 0 if nowhere; the names of a list of files follow the word LIST."""
    fields: dict[str, str] = {}
    keys: dict[str, str] = {}
    with open(name, "rb") as file:
        if not file.readline(64).startswith(b"NRRD"):
            raise ValueError(f"{name}: cannot be read as a volume: no NRRD header")
        while raw := file.readline(1 << 20):
            line = header_text(raw)
            if not line:
                return fields, keys, file.tell()
            if line.startswith("#"):
                continue
            if ":=" in line:
                key, _, value = line.partition(":=")
                value = re.sub(r"\\([n\\])", lambda m: "\n" if m[1] == "n" else "\\", value)
                keys[key.strip()] = value.strip()
            else:
                field, _, value = line.partition(":")
                field, value = field.strip().lower(), value.strip()
                field = _SYNONYMS.get(field, field)
                if field == "data file" and value.startswith("LIST"):
                    value += "\n" + file.read(1 << 24).decode("utf-8", "replace")
                if field in fields:
                    raise ValueError(f"{name}: {shown(field)} must be once in the NRRD header, got it twice")
                fields[field] = value
            if len(fields) + len(keys) > 100_000 or file.tell() > 1 << 26:
                raise ValueError(f"{name}: cannot be read as a volume: the NRRD header has no end")
    return fields, keys, 0


def _vectors(fields: dict[str, str], name: str) -> list[tuple[float, ...]]:
    """Of `space directions`, one an axis, () for "none"."""
    text = fields.get("space directions")
    if text is None:
        return []
    found: list[tuple[float, ...]] = []
    for part in re.findall(r"\([^()]*\)|none", text):
        found.append(() if part == "none" else _numbers(part, name))
    return found


def _numbers(text: str, name: str) -> tuple[float, ...]:
    try:
        return tuple(float(number) for number in text.strip("() ").split(","))
    except ValueError:
        raise ValueError(
            f"{name}: cannot be read as a volume: {shown(text)} in the NRRD header is no vector"
        ) from None


def _holds_values(kind: str) -> bool:
    return kind == "list" or any(word in kind for word in _VALUES)


def _to_lps(fields: dict[str, str], name: str, notes: list[str]) -> Array:
    space = fields.get("space", "").lower().removesuffix("-time").rstrip("t")
    signs = _TO_LPS.get(space)
    if signs is None:
        if not any(LPS_ASSUMED in note for note in notes):
            notes.append(f"space '{space}' of the NRRD header is no anatomical one: {LPS_ASSUMED}")
        signs = (1.0, 1.0)
    return np.array([*signs, 1.0])


def _unit(text: str | None, name: str, notes: list[str]) -> float:
    """Millimetres of the units of space, which must be alike; none named: mm, by the format's use in medicine."""
    units = set(re.findall(r'"([^"]*)"', text or "")) - {"", "???"}
    if not units:
        return 1.0
    if len(units) > 1 or (unit := units.pop().lower()) not in MILLIMETRES:
        raise ValueError(
            f"{name}: units of space in the NRRD header must be one of {', '.join(MILLIMETRES)}, got {shown(text)}"
        )
    return MILLIMETRES[unit]


def _origin(fields: dict[str, str], name: str, notes: list[str]) -> Array:
    text = fields.get("space origin")
    if text is None:
        notes.append("the NRRD header has no origin: (0, 0, 0) is assumed")
        return np.zeros(3)
    origin = np.array(_numbers(text, name))
    if origin.shape != (3,) or not np.all(np.isfinite(origin)):
        raise ValueError(
            f"{name}: space origin of the NRRD header must be three finite numbers, got {shown(text)}"
        )
    return np.asarray(_to_lps(fields, name, notes) * _unit(fields.get("space units"), name, notes) * origin)


def _spacings(fields: dict[str, str], spatial: list[int], name: str, notes: list[str]) -> Array:
    text = fields.get("spacings")
    if text is None:
        return np.full(3, np.nan)
    try:
        every = [float(number) for number in text.split()]
        found = np.array([every[i] for i in spatial])
    except (ValueError, IndexError):
        raise ValueError(
            f"{name}: cannot be read as a volume: spacings of the NRRD header are '{text}'"
        ) from None
    check_not_negative(found, f"{name}: spacings of the NRRD header")
    units = re.findall(r'"([^"]*)"', fields.get("units", ""))
    wanted = " ".join(f'"{units[i]}"' for i in spatial) if len(units) > max(spatial) else None
    return np.asarray(_unit(wanted, name, notes) * np.where(found > 0, found, np.nan))


def _segments(keys: dict[str, str]) -> tuple[dict[int, str], dict[int, tuple[int, int, int]]]:
    """Names and colours by label, where 3D Slicer wrote them (Segment0_LabelValue, _Name, _Color)."""
    names: dict[int, str] = {}
    colours: dict[int, tuple[int, int, int]] = {}
    for key, value in keys.items():
        found = re.fullmatch(r"(Segment\d+)_LabelValue", key)
        if found is None or not re.fullmatch(r"\d{1,18}", value):
            continue
        label, segment = int(value), found[1]
        if name := keys.get(f"{segment}_Name"):
            names[label] = name
        try:
            r, g, b = (round(255 * float(part)) for part in keys[f"{segment}_Color"].split())
        except (KeyError, ValueError, OverflowError):
            continue
        if all(0 <= channel <= 255 for channel in (r, g, b)):
            colours[label] = (r, g, b)
    return names, colours
