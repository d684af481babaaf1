"""Headers of MetaImage files (.mha, .mhd). Fields after the MetaIO documentation, itk.org/Wiki/ITK/MetaIO."""

from __future__ import annotations

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
)

_END = "ElementDataFile"  # the last field: then come the values


def read_meta_header(name: str) -> Header:
    """Place of the voxels; ValueError with one sentence where the header cannot be read."""
    fields, _ = meta_fields(name)
    sizes = _sizes(fields, name)
    if len(sizes) < 3:
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got {len(sizes)} dimensions"
        )
    if fields.get("NDims") != str(len(sizes)) or len(sizes) > 10:  # the format's limit
        raise ValueError(
            f"{name}: NDims of the MetaImage header must be the {len(sizes)} numbers of DimSize, at most 10, got "
            f"{shown(fields.get('NDims'))}"
        )
    if fields.get("ElementNumberOfChannels", "1") != "1":
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got {fields['ElementNumberOfChannels'][:100]} values"
        )
    shape, n = three_sizes(sizes, name), len(sizes)
    unit = fields.get("DistanceUnits", "mm").lower()
    scale = MILLIMETRES.get("mm" if unit == "?" else unit)
    if scale is None:
        raise ValueError(f"{name}: DistanceUnits must be one of {', '.join(MILLIMETRES)}, got {unit[:100]}")
    notes = []
    spacing = scale * _numbers(fields, ("ElementSpacing", "ElementSize"), name, [np.nan] * n)[:3]
    check_not_negative(spacing, f"{name}: ElementSpacing of the MetaImage header")
    if len(spacing) != 3:
        raise ValueError(f"{name}: ElementSpacing must hold {n} numbers, got {len(spacing)}")
    matrix = _numbers(fields, ("TransformMatrix", "Rotation", "Orientation"), name, [])
    if len(matrix) == 0:
        if fields.get("AnatomicalOrientation") != "RAI":  # in the words of MetaImage, from there: LPS
            notes.append(f"the MetaImage header says no orientation: {LPS_ASSUMED}, voxel axes along L, P, S")
        matrix = np.eye(n).ravel()
    if len(matrix) != n * n:
        raise ValueError(f"{name}: TransformMatrix must hold {n * n} numbers, got {len(matrix)}")
    direction = matrix.reshape(n, n)[:3, :3].T  # its rows are the voxel axes
    origin = _numbers(fields, ("Offset", "Position", "Origin"), name, [])
    if len(origin) == 0:
        notes.append("the MetaImage header has no origin: (0, 0, 0) is assumed")
        origin = np.zeros(n)
    return Header(shape, spacing, scale * origin[:3], direction, tuple(notes))


def meta_fields(name: str) -> tuple[dict[str, str], int]:
    """Of the header, and the place in the file where that ends; the names of a list of files follow the word LIST."""
    fields: dict[str, str] = {}
    with open(name, "rb") as file:
        while (raw := file.readline(1 << 16)) and len(fields) < 10_000:
            key, sign, value = header_text(raw, "latin-1").partition("=")
            if not sign:
                break
            fields[key.strip()] = value.strip()
            if key.strip() == _END:
                told = raw.partition(b"=")[2]  # in the letters of the file system
                told += file.read(1 << 24) if told.split()[:1] == [b"LIST"] else b""
                fields[_END] = "\n".join(map(header_text, told.splitlines())).strip()
                return fields, file.tell()
    raise ValueError(f"{name}: cannot be read as a volume: no MetaImage header")


def _sizes(fields: dict[str, str], name: str) -> list[int]:
    found = _numbers(fields, ("DimSize",), name)
    if not np.all(np.isfinite(found) & (found == np.rint(found))):
        raise ValueError(f"{name}: DimSize must hold whole numbers, got {fields['DimSize'][:100]}")
    return [int(n) for n in found]


def _numbers(
    fields: dict[str, str], keys: tuple[str, ...], name: str, default: list[float] | None = None
) -> Array:
    """Of the first of these fields that is there."""
    for key in keys:
        if key in fields:
            try:
                return np.array([float(number) for number in fields[key].split()])
            except ValueError:
                raise ValueError(
                    f"{name}: cannot be read as a volume: {key} of the MetaImage header is '{fields[key][:100]}'"
                ) from None
    if default is None:
        raise ValueError(f"{name}: cannot be read as a volume: the MetaImage header has no {keys[0]}")
    return np.array(default)
