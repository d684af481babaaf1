"""Grey values as a file's numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Coding:
    """How a file stores grey values.

    Attributes
    ----------
    kind : dtype
        Of the stored numbers, with their byte order.
    slope, inter : float
        A grey value is slope * stored + inter.
    bits : int, optional
        Of whole numbers, where fewer are used than the type has.
    """

    kind: np.dtype[Any]
    slope: float = 1.0
    inter: float = 0.0
    bits: int | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """The least and the highest number that can be stored."""
        if self.kind.kind == "f":
            return float(np.finfo(self.kind).min), float(np.finfo(self.kind).max)
        spare = 8 * self.kind.itemsize - (self.bits or 8 * self.kind.itemsize)
        found = np.iinfo(self.kind)
        return float(int(found.min) >> spare), float(int(found.max) >> spare)

    def stored(self, greys: NDArray[np.float64], name: str, empty: float | None = None) -> NDArray[Any]:
        """Grey values as the file stores them, to the nearest where it holds whole numbers; `empty` and what is below it, down.

        Raises
        ------
        ValueError
            If one is beyond what can be stored.
        """
        found = np.asarray((greys - self.inter) / self.slope)
        if self.kind.kind != "f":
            nearest = np.rint(found)
            if empty is not None:  # rounded up, it would not be empty
                down = np.floor(found + 1e-9) if self.slope > 0 else np.ceil(found - 1e-9)
                nearest = np.where(greys <= empty, down, nearest)
            found = nearest
        least, most = self.limits
        beyond = (found < least) | (found > most)
        if beyond.any():
            grey = "map must have a grey value of empty" if empty is not None else "labels must have a 0"
            raise ValueError(
                f"{grey} that {name} can hold, for what was removed to have one: it holds {self._text()}, got "
                f"{greys[beyond].flat[0]:g}"
            )
        return found.astype(self.kind)

    def check(self, empty: float | None, name: str) -> None:
        """The error of `stored` for the grey value of empty, or without one for label 0."""
        self.stored(np.array([empty or 0.0]), name, empty)

    def _text(self) -> str:
        ends = sorted(self.slope * end + self.inter for end in self.limits)
        own = (self.slope, self.inter, self.bits or 8 * self.kind.itemsize) == (1, 0, 8 * self.kind.itemsize)
        return f"{self.kind.newbyteorder('=')}" + ("" if own else f", {ends[0]:g} to {ends[1]:g}")
