"""Grey values to occupancy: between two grey values, or by a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.arguments import real


@dataclass(frozen=True)
class OccupancyMap:
    """Occupancy as a piecewise linear function of the grey value, constant below its first point and above its last.

    Parameters
    ----------
    greys : tuple of float
        Grey values, strictly increasing; two or more.
    occupancies : tuple of float
        Of each, 0 (empty) to 1 (solid bone); they may rise and fall.

    Raises
    ------
    ValueError
        If there are fewer than two points or as many greys as occupancies are missing, a grey value is not finite or not above
        the one before it, or an occupancy is not within 0 to 1.

    Examples
    --------
    >>> OccupancyMap.two_point(90, 180).levels(np.array([0, 90, 135, 180, 255]))
    array([  0,   0, 128, 255, 255], dtype=uint8)
    """

    greys: tuple[float, ...]
    occupancies: tuple[float, ...]

    def __post_init__(self) -> None:
        greys = tuple(float(real(g, "greys")) for g in self.greys)
        occupancies = tuple(float(real(o, "occupancies")) for o in self.occupancies)
        if len(greys) != len(occupancies) or len(greys) < 2:
            raise ValueError(
                f"map must have two points or more, a grey value and an occupancy each, got {len(greys)} and {len(occupancies)}"
            )
        if not all(map(math.isfinite, greys)) or any(b <= a for a, b in pairwise(greys)):
            raise ValueError(f"map must have finite, increasing grey values, got {greys}")
        if not all(0.0 <= o <= 1.0 for o in occupancies):
            raise ValueError(f"map must have occupancies within 0 to 1, got {occupancies}")
        object.__setattr__(self, "greys", greys)
        object.__setattr__(self, "occupancies", occupancies)

    @classmethod
    def two_point(cls, empty: float, solid: float) -> OccupancyMap:
        """0 at the grey value `empty` and below, 1 at `solid` and above; ValueError unless `empty` is below `solid`."""
        empty, solid = float(real(empty, "map")), float(real(solid, "map"))
        if not (math.isfinite(empty) and math.isfinite(solid) and empty < solid):
            raise ValueError(f"map must be LO:HI with LO below HI, got {empty:g}:{solid:g}")
        return cls((empty, solid), (0.0, 1.0))

    @classmethod
    def table(cls, greys: Sequence[float], occupancies: Sequence[float]) -> OccupancyMap:
        """By a table of grey values and the occupancy of each; errors as of the class."""
        return cls(tuple(greys), tuple(occupancies))

    @classmethod
    def parse(cls, text: str) -> OccupancyMap:
        """Of ``LO:HI``, or of ``GREY:OCCUPANCY,GREY:OCCUPANCY,...``; ValueError where it is neither.

        Examples
        --------
        >>> OccupancyMap.parse("0:0,300:0.5,1200:1").text
        '0:0,300:0.5,1200:1'
        """
        try:
            pairs = [tuple(float(number) for number in part.split(":")) for part in text.split(",")]
        except ValueError:
            pairs = []
        if not pairs or any(len(pair) != 2 for pair in pairs):
            raise ValueError(f"must be LO:HI or GREY:OCCUPANCY,GREY:OCCUPANCY,..., got '{text}'")
        if len(pairs) == 1:
            low, high = pairs[0]
            if not low < high:
                raise ValueError(f"must be LO:HI with LO below HI, got '{text}'")
            return cls.two_point(low, high)
        return cls.table([pair[0] for pair in pairs], [pair[1] for pair in pairs])

    @property
    def text(self) -> str:
        """As `parse` reads it."""
        if self.occupancies == (0.0, 1.0):
            return f"{_text(self.greys[0])}:{_text(self.greys[1])}"
        return ",".join(f"{_text(g)}:{_text(o)}" for g, o in zip(self.greys, self.occupancies, strict=True))

    def occupancy(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Occupancy of grey values, 0 to 1.

        Raises
        ------
        ValueError
            If a value is not finite.
        """
        return np.asarray(self._each(values, np.float32, lambda part: part.astype(np.float32)))

    def levels(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """Occupancy of grey values in levels, 0 to 255, rounded to nearest; ValueError if a value is not finite."""
        return np.asarray(self._each(values, np.uint8, lambda part: np.rint(255.0 * part).astype(np.uint8)))

    def _each(self, values: NDArray[Any], kind: Any, store: Any) -> NDArray[Any]:
        values = np.asarray(values)
        if values.dtype.kind in "iu" and values.dtype.itemsize <= 2:  # a table of all values is faster
            least = int(np.iinfo(values.dtype).min)
            whole = np.arange(least, int(np.iinfo(values.dtype).max) + 1, dtype=np.float64)
            entries = store(self._linear(whole))
            return np.asarray(entries[values.astype(np.int32) - least])
        found = np.empty(values.shape, dtype=kind)
        flat, out = values.reshape(-1), found.reshape(-1)
        for first in range(0, flat.size, 1 << 22):  # bounds what double precision takes
            part = flat[first : first + (1 << 22)].astype(np.float64)
            if not np.all(np.isfinite(part)):
                raise ValueError("values must be finite, got some that are not")
            out[first : first + part.size] = store(self._linear(part))
        return found

    def _linear(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        # Not np.interp: written out, in the same order everywhere, so that two machines make the same bone.
        greys, occupancies = np.array(self.greys), np.array(self.occupancies)
        place = np.clip(np.searchsorted(greys, values, side="right") - 1, 0, len(greys) - 2)
        low, high = greys[place], greys[place + 1]
        part = np.clip((values - low) / (high - low), 0.0, 1.0)
        return np.asarray(occupancies[place] + part * (occupancies[place + 1] - occupancies[place]))


def _text(number: float) -> str:
    """The shortest that reads back the same."""
    return repr(number).removesuffix(".0")


def occupancy_map(mapping: OccupancyMap | float, solid: float | None = None) -> OccupancyMap:
    """The map itself, or of two grey values; TypeError where it is neither."""
    if isinstance(mapping, OccupancyMap) and solid is None:
        return mapping
    if isinstance(mapping, OccupancyMap) or solid is None:
        raise TypeError(f"map must be an OccupancyMap or two grey values, got {mapping!r} and {solid!r}")
    return OccupancyMap.two_point(mapping, solid)
