"""Colours of slices to labels, and what becomes of colours that are in no table."""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Tissues

Colours = tuple[int, int, int]


class Palette:
    """A table of colours that keeps count of those which are not in it.

    Parameters
    ----------
    rows : iterable of (int, str, (r, g, b))
        Label, name and colour.
    unknown : "refuse", "nearest" or int
        See `read_stack`.

    Raises
    ------
    ValueError
        If a colour occurs twice or is none, or `unknown` is neither of its words nor a label.
    """

    def __init__(self, rows: Iterable[tuple[int, str, Any]], unknown: str | int = "refuse") -> None:
        self.names: dict[int, str] = {}
        self.colours: dict[int, Colours] = {}
        seen: dict[Colours, str] = {}
        for label, name, given in rows:
            colour = _colour(name, given)
            if label == 0:  # transparent and black, whatever the table says
                self.names[0] = name
                continue
            if colour in seen:
                raise ValueError(
                    f"palette: colours must differ, {seen[colour]!r} and {name!r} are both {colour}"
                )
            if colour == (0, 0, 0):
                raise ValueError(f"palette: black is label 0 (nothing), got it for {name!r}")
            seen[colour] = name
            self.names[label], self.colours[label] = name, colour
        if not self.colours:
            raise ValueError("palette must have a colour")
        self.unknown = _checked_unknown(unknown, {0, *self.colours})
        self.dtype = (
            np.uint8 if max(self.colours) < 256 else np.uint16 if max(self.colours) < 65536 else np.int32
        )
        # A place for each colour there is: 0 for black, 1, 2, ... for the table's, the last for all others.
        if len(self.colours) > 65533:
            raise ValueError(f"palette must have at most 65533 colours, got {len(self.colours)}")
        self._strange_place = len(self.colours) + 1
        self._places = np.full(1 << 24, self._strange_place, np.uint16)
        self._places[[0, *(_code(np.array(colour)) for colour in self.colours.values())]] = np.arange(
            self._strange_place
        )
        self._labels = np.array([0, *self.colours, 0], self.dtype)
        self._strange: Counter[int] = Counter()
        self._example = ""

    @classmethod
    def of(cls, palette: Tissues | Mapping[str, Colours] | None, unknown: str | int) -> Palette:
        """The palette of a table of tissues, or of names and colours, or of volumetric_drilling."""
        if isinstance(palette, Tissues):
            return cls(((t.label, t.name, t.colour) for t in palette), unknown)
        if palette is None:
            from burrlab.anatomy.known_tissues import VOLUMETRIC_DRILLING  # anatomy builds on volumes

            palette = VOLUMETRIC_DRILLING
        return cls(((i, name, colour) for i, (name, colour) in enumerate(palette.items(), start=1)), unknown)

    def labels(self, image: NDArray[np.uint8], path: Path) -> NDArray[Any]:
        """Labels of a slice of RGBA pixels; ValueError for a colour that is not in the table, where it is to be refused."""
        codes = _code(image[..., :3].astype(np.uint32))
        codes[image[..., 3] == 0] = 0
        places = self._places.take(codes)
        found: NDArray[Any] = self._labels.take(places)
        strange = places == self._strange_place
        if strange.any():
            found[strange] = self._of_strange(image, codes, strange, path)
        return found

    def notes(self, name: str) -> list[str]:
        """What was done with colours that are in no table; ValueError with count and example where they are refused."""
        if not self._strange:
            return []
        pixels, kinds = sum(self._strange.values()), len(self._strange)
        many = f"{pixels} pixel{'s' if pixels > 1 else ''} of {kinds} colour{'s' if kinds > 1 else ''} that are in no table"
        if self.unknown == "refuse":
            raise ValueError(
                f"{name}: {many}: {self._example}; blends of structures that overlap, or of scaling? "
                "unknown='nearest' (--unknown nearest) takes the nearest colour, unknown=LABEL that label"
            )
        taken = "the nearest colour" if self.unknown == "nearest" else f"label {self.unknown}"
        return [f"{many} were taken as {taken}: {self._example}"]

    def _of_strange(
        self, image: NDArray[np.uint8], codes: NDArray[np.uint32], strange: NDArray[np.bool_], path: Path
    ) -> NDArray[Any]:
        kinds, inverse, counts = np.unique(codes[strange], return_inverse=True, return_counts=True)
        if not self._example:
            row, column = (int(i) for i in np.argwhere(strange)[0])
            colour = tuple(int(c) for c in image[row, column, :3])
            self._example = f"{colour} in {path.name}, row {row}, column {column}"
        for code, count in zip(kinds.tolist(), counts.tolist(), strict=True):
            self._strange[code] += count
        if self.unknown != "nearest":
            return np.full(inverse.shape, 0 if self.unknown == "refuse" else self.unknown)
        known = np.array(list(self.colours.values()))
        own = np.stack([kinds >> 16, (kinds >> 8) & 255, kinds & 255], axis=-1).astype(np.int64)
        nearest = np.argmin(((own[:, None, :] - known[None]) ** 2).sum(axis=-1), axis=1)
        return np.asarray(np.array(list(self.colours))[nearest][inverse])


def _code(colour: NDArray[Any]) -> Any:
    return (colour[..., 0] << 16) | (colour[..., 1] << 8) | colour[..., 2]


def _colour(name: str, given: Any) -> Colours:
    try:
        red, green, blue = (operator.index(part) for part in given)
    except (TypeError, ValueError):
        red = -1
    if red < 0 or not all(0 <= part <= 255 for part in (red, green, blue)):
        raise ValueError(
            f"palette: a colour must be three whole numbers from 0 to 255, got {given!r} for {name!r}"
        )
    return red, green, blue


def _checked_unknown(unknown: str | int, labels: set[int]) -> str | int:
    if unknown in ("refuse", "nearest") or (not isinstance(unknown, (str, bool)) and unknown in labels):
        return unknown
    raise ValueError(
        f"unknown must be 'refuse', 'nearest' or a label of the palette ({', '.join(map(str, sorted(labels)))}), got {unknown!r}"
    )
