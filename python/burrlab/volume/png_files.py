"""The PNG slices of a volume: which files, in which order, and that they belong together."""

from __future__ import annotations

import glob
import os
import re
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.bounds import check_packed

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_KINDS = {
    0: "grey",
    2: "RGB",
    3: "palette",
    4: "grey with alpha",
    6: "RGBA",
}  # PNG specification, 11.2.2 IHDR
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
#: No slice of a clinical or micro-CT volume is larger; a file that says so is damaged (ours).
MOST_PIXELS = 16384


@dataclass(frozen=True)
class Slices:
    """Files of equal size and kind, in the order of their numbers.

    Attributes
    ----------
    paths : list of Path
    columns, rows : int
        Pixels.
    bits : int
        A channel.
    kind : str
        grey, RGB, palette or RGBA.
    """

    paths: list[Path]
    columns: int
    rows: int
    bits: int
    kind: str


def find_slices(place: str | os.PathLike[str], *, prefix: str | None = None) -> Slices:
    """The slices in a folder, or those that a pattern names.

    Parameters
    ----------
    place : path-like
        A folder, or a pattern with *, ? or [...].
    prefix : str, optional
        What comes before the number in the names of the files.

    Raises
    ------
    FileNotFoundError
        If there is no such folder.
    ValueError
        If there is no slice, one is missing, there twice, not a PNG file, or of another size or kind than the first.
    """
    text = os.fspath(place)
    if Path(text).is_dir():
        found = [path for path in Path(text).iterdir() if path.suffix.lower() == ".png"]
    elif any(sign in text for sign in "*?["):
        found = [Path(name) for name in glob.glob(text)]
    else:
        raise FileNotFoundError(
            f"{text}: no such folder; a stack of slices is a folder, a pattern or its YAML file"
        )
    found = [path for path in found if path.is_file() and not path.name.startswith(".")]
    if prefix is not None:
        found = [path for path in found if path.name.startswith(prefix)]
    if not found:
        named = "" if prefix is None else f" that begin with {prefix!r}"
        raise ValueError(f"{text}: there are no PNG slices{named}")
    first = 0 if prefix is not None else 1  # a description counts from 0
    paths = _in_order(text, found, latest=first if Path(text).is_dir() else None)
    return _alike(paths)


def pixels(path: Path) -> NDArray[Any]:
    """The pixels of a slice, (row, column) or (row, column, channel); ValueError where the file is damaged."""
    from PIL import Image

    try:
        with warnings.catch_warnings(), Image.open(path) as image:
            warnings.simplefilter("error")
            if image.mode in ("P", "RGB"):  # either may make one colour transparent
                return np.asarray(image.convert("RGBA"))
            if image.mode.startswith("I"):
                return np.asarray(image).astype(np.uint16)
            return np.asarray(image.convert("L") if image.mode == "1" else image)
    except MemoryError:
        raise ValueError(
            f"{path}: the PNG file is damaged, or the machine has too little memory for it"
        ) from None
    except Exception as error:  # Pillow raises whatever a damaged chunk leads to
        raise ValueError(f"{path}: the PNG file is damaged or cut short ({error})") from None


def _in_order(place: str, found: list[Path], *, latest: int | None) -> list[Path]:
    """By the number at the end of the name: slice10 comes after slice9; `latest` is the last number at which a stack may begin."""
    numbered: dict[int, Path] = {}
    prefixes: dict[str, Path] = {}
    for path in sorted(found):
        match = re.fullmatch(r"(.*?)(\d+)", path.stem, flags=re.ASCII)
        if match is None:
            raise ValueError(f"{path}: the name of a slice must end in its number, as slice0012.png")
        prefixes.setdefault(match[1], path)
        if len(prefixes) > 1:
            one, other = (p.name for p in prefixes.values())
            raise ValueError(
                f"{place}: slices of more than one volume ({one}, {other}): name one by a pattern, as 'folder/name*.png'"
            )
        number = int(match[2])
        if number in numbered:
            raise ValueError(f"{place}: slice {number} is there twice ({numbered[number].name}, {path.name})")
        numbered[number] = path
    order = sorted(numbered)
    missing = sorted(set(range(order[0], order[-1] + 1)) - set(order)) if order[-1] - order[0] < 10**6 else []
    if missing or order[-1] - order[0] >= 10**6:
        told = ", ".join(map(str, missing[:5])) + (", ..." if len(missing) > 5 else "")
        which = f"{len(missing)} are missing ({told})" if missing else "many are missing (numbers far apart)"
        if len(missing) == 1:
            which = f"slice {missing[0]} is missing"
        raise ValueError(f"{place}: of the slices {order[0]} to {order[-1]}, {which}")
    if latest is not None and order[0] > latest:
        before = "slice 0 is missing" if order[0] == 1 else f"slices 0 to {order[0] - 1} are missing"
        raise ValueError(
            f"{place}: {before}, the first is {numbered[order[0]].name}; a part of a stack is named "
            "by a pattern"
        )
    return [numbered[number] for number in order]


def _alike(paths: list[Path]) -> Slices:
    first = _header(paths[0])
    for path in paths[1:]:
        found = _header(path)
        if found[:2] != first[:2]:
            raise ValueError(
                f"{path}: slices must be of one size, this one has {found[0]} x {found[1]} pixels, and {paths[0].name} has "
                f"{first[0]} x {first[1]}"
            )
        if found[2:] != first[2:]:
            raise ValueError(
                f"{path}: slices must be of one kind, this one is {found[3]} of {found[2]} bits, and {paths[0].name} is {first[3]} "
                f"of {first[2]} bits"
            )
    columns, rows, bits, kind = first
    if kind == "grey with alpha":
        raise ValueError(f"{paths[0]}: grey slices must not be transparent (kind: grey with alpha)")
    if kind != "grey" and bits == 16:
        raise ValueError(f"{paths[0]}: colours of labels must have 8 bits a channel, got 16")
    return Slices(paths, columns, rows, bits, kind)


def _header(path: Path) -> tuple[int, int, int, str]:
    """Columns, rows, bits and kind, from the first chunk."""
    with path.open("rb") as file:
        head = file.read(33)
    if head[:8] != _SIGNATURE or len(head) < 33 or head[12:16] != b"IHDR":
        raise ValueError(f"{path}: this is no PNG file")
    columns, rows, bits, kind = struct.unpack(">IIBB", head[16:26])
    if kind not in _KINDS or not (0 < columns <= MOST_PIXELS and 0 < rows <= MOST_PIXELS):
        raise ValueError(
            f"{path}: the PNG file is damaged (its header says {columns} x {rows} pixels, kind {kind})"
        )
    size = rows * (1 + columns * bits * _CHANNELS[kind] // 8)
    check_packed(size, path.stat().st_size, str(path))
    return columns, rows, bits, _KINDS[kind]
