"""What a file says about where its voxels lie, and what must be asked for."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from burrlab.bounds import shown
from burrlab.volume.geometry import Array, checked_spacing

#: In every note on an orientation that a file does not say, and in pictures of its bone.
LPS_ASSUMED = "LPS assumed"
#: In the note on voxel axes that are left-handed, and in pictures, which are drawn along them.
MIRRORED = "mirror image"
#: Millimetres of the units that headers name.
MILLIMETRES = {"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1e3, "meter": 1e3, "metre": 1e3,
               "um": 1e-3, "µm": 1e-3, "micron": 1e-3, "micrometer": 1e-3, "nm": 1e-6}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Header:
    """Sizes and place of a volume's voxels as its file has them.

    Parameters
    ----------
    shape : tuple of int
        Voxels (z, y, x).
    spacing : ndarray, shape (3,)
        (x, y, z) [mm]; NaN where the file does not say it.
    origin : ndarray, shape (3,)
        LPS [mm].
    direction : ndarray, shape (3, 3)
        Columns are the voxel axes, LPS.
    notes : tuple of str
        What is assumed where the file is silent.
    names, colours : dict
        Of labels.
    files : tuple of str
        Of a DICOM series, in the order of its slices.
    """

    shape: tuple[int, int, int]
    spacing: Array
    origin: Array
    direction: Array
    notes: tuple[str, ...] = ()
    names: dict[int, str] = field(default_factory=dict)
    colours: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        with np.errstate(all="ignore"):  # what is not finite is refused later, with a sentence
            mirrored = np.linalg.det(self.direction) < 0
        if mirrored:
            said = f"voxel axes are left-handed: the bone frame, in which pictures are drawn, is a {MIRRORED}"
            object.__setattr__(self, "notes", (*self.notes, said))


def assumed(notes: Iterable[str]) -> str:
    """What a picture of the bone says of its axes: `LPS_ASSUMED` and `MIRRORED`, where one of the notes does."""
    said = "\n".join(notes)
    return ", ".join(words for words in (LPS_ASSUMED, MIRRORED) if words in said)


def told_notes(source: Any) -> tuple[str, ...]:
    """The notes in a bone's source as sessions and traces keep it, a mapping or its JSON; none in any other."""
    try:
        return tuple(map(str, (json.loads(source) if isinstance(source, str) else source)["notes"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return ()


def check_not_negative(numbers: Array, said: str) -> None:
    """ValueError for a spacing below 0: some readers mirror the volume then, others drop the sign."""
    if np.any(numbers < 0):
        raise ValueError(
            f"{said} must be positive, got {' '.join(f'{n:g}' for n in numbers)}: is the volume mirrored?"
        )


def header_text(content: bytes, encoding: str = "utf-8") -> str:
    """Of a header's line, without its end and the control characters that no refusal may quote."""
    return re.sub(r"[\0-\x08\x0a-\x1f\x7f]", "\ufffd", content.rstrip(b"\r\n").decode(encoding, "replace"))


def plain_name(name: str) -> str:
    """A name as SimpleITK takes it, which ends the process for others; ValueError where it is not UTF-8."""
    try:
        name.encode()
    except UnicodeEncodeError:
        raise ValueError(f"path must be UTF-8, got {name!r}") from None
    return name


def settled_spacing(header: Header, given: float | ArrayLike | None, name: str) -> Array:
    """The spacing of the file, or the one given where it has none; ValueError if neither says it, or they differ."""
    missing = ~(np.isfinite(header.spacing) & (header.spacing > 0))
    if given is None:
        if missing.any():
            axes = ", ".join(axis for axis, lost in zip("xyz", missing, strict=True) if lost)
            raise ValueError(
                f"{name}: the file does not say the voxel spacing along {axes}; it must be given: spacing=(x, y, z) [mm]"
            )
        return header.spacing
    asked = checked_spacing(given)
    if not np.allclose(header.spacing[~missing], asked[~missing], rtol=1e-4, atol=0):
        own = ", ".join(f"{s:g}" for s in header.spacing)
        raise ValueError(
            f"{name}: spacing must be that of the file, ({own}) mm, where the file has one, got {given!r}"
        )
    return np.where(missing, asked, header.spacing)


def unit_columns(vectors: Array) -> tuple[Array, Array]:
    """Lengths of the columns and the columns of length 1; NaN where one has none."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        lengths = np.sqrt((vectors**2).sum(axis=0))
        return lengths, vectors / lengths


def three_sizes(sizes: list[int], name: str) -> tuple[int, int, int]:
    """(z, y, x) of sizes x, y, z and further ones of 1; ValueError for anything else."""
    kept = sizes[:3] + [n for n in sizes[3:] if n != 1]
    if len(kept) != 3 or any(not 1 <= n < 2**31 for n in sizes):
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got sizes {' x '.join(map(shown, sizes[:16]))}"
        )
    x, y, z = kept
    return z, y, x
