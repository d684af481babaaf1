"""Headers of MetaImage files (.mha, .mhd). Fields after the MetaIO documentation, itk.org/Wiki/ITK/MetaIO."""

from __future__ import annotations

import numpy as np

from burrlab.volume.geometry import Array
from burrlab.volume.header import MILLIMETRES, Header, three_sizes

_END = "ElementDataFile"  # the last field: then come the values


def read_meta_header(name: str) -> Header:
    """Place of the voxels; ValueError with one sentence where the header cannot be read."""
    fields = _fields(name)
    sizes = [int(n) for n in _numbers(fields, ("DimSize",), name)]
    if len(sizes) < 3:
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got {len(sizes)} dimensions"
        )
    if fields.get("ElementNumberOfChannels", "1") != "1":
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got {fields['ElementNumberOfChannels']} values"
        )
    shape, n = three_sizes(sizes, name), len(sizes)
    unit = fields.get("DistanceUnits", "mm").lower()
    scale = MILLIMETRES.get("mm" if unit == "?" else unit)
    if scale is None:
        raise ValueError(f"{name}: DistanceUnits must be one of {', '.join(MILLIMETRES)}, got {unit}")
    notes = []
    spacing = scale * np.abs(_numbers(fields, ("ElementSpacing", "ElementSize"), name, [np.nan] * n))[:3]
    matrix = _numbers(fields, ("TransformMatrix", "Rotation", "Orientation"), name, [])
    if len(matrix) == 0:
        notes.append("the MetaImage header says no orientation: voxel axes are taken as L, P, S")
        matrix = np.eye(n).ravel()
    if len(matrix) != n * n:
        raise ValueError(f"{name}: TransformMatrix must hold {n * n} numbers, got {len(matrix)}")
    direction = matrix.reshape(n, n)[:3, :3].T  # its rows are the voxel axes
    origin = _numbers(fields, ("Offset", "Position", "Origin"), name, [])
    if len(origin) == 0:
        notes.append("the MetaImage header has no origin: (0, 0, 0) is assumed")
        origin = np.zeros(n)
    return Header(shape, spacing, scale * origin[:3], direction, tuple(notes))


def _fields(name: str) -> dict[str, str]:
    fields: dict[str, str] = {}
    with open(name, "rb") as file:
        while raw := file.readline(1 << 16):
            key, sign, value = raw.decode("latin-1").partition("=")
            if not sign:
                break
            fields[key.strip()] = value.strip()
            if key.strip() == _END:
                return fields
    raise ValueError(f"{name}: cannot be read as a volume: no MetaImage header")


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
                    f"{name}: cannot be read as a volume: {key} of the MetaImage header is '{fields[key]}'"
                ) from None
    if default is None:
        raise ValueError(f"{name}: cannot be read as a volume: the MetaImage header has no {keys[0]}")
    return np.array(default)
