"""Headers of MetaImage files (.mha, .mhd). Fields after the MetaIO documentation, itk.org/Wiki/ITK/MetaIO."""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from burrlab.volume.geometry import Array
from burrlab.volume.header import LPS_ASSUMED, MILLIMETRES, Header, check_not_negative, three_sizes

_END = "ElementDataFile"  # the last field: then come the values
_BYTES = {"MET_CHAR": 1, "MET_UCHAR": 1, "MET_SHORT": 2, "MET_USHORT": 2, "MET_INT": 4, "MET_UINT": 4,
          "MET_LONG_LONG": 8, "MET_ULONG_LONG": 8, "MET_FLOAT": 4, "MET_DOUBLE": 8}  # fmt: skip


def read_meta_header(name: str) -> Header:
    """Place of the voxels; ValueError with one sentence where the header cannot be read."""
    fields, _ = _fields(name)
    sizes = _sizes(fields, name)
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


def check_meta_values(name: str) -> None:
    """ValueError where the values are cut short or damaged: for that SimpleITK names another cause, and prints."""
    fields, start = _fields(name)
    size, file_name = _BYTES.get(fields.get("ElementType", "")), fields[_END]
    if size is None or file_name.startswith("LIST") or "%" in file_name or "HeaderSize" in fields:
        return
    if fields.get("BinaryData", "True").lower() != "true":
        return
    local = file_name.upper() == "LOCAL"
    path = Path(name) if local else Path(name).parent / file_name
    if not path.is_file():
        raise ValueError(f"{name}: the file of its values, {file_name}, is not there")
    with path.open("rb") as file:
        file.seek(start if local else 0)
        packed = fields.get("CompressedData", "False").lower() == "true"
        left = path.stat().st_size - file.tell()
        have, used = _unpacked(file, name) if packed else (left, left)
    told = fields.get("CompressedDataSize", "none")  # of a file of their own, its size serves
    if packed and (local or told != "none") and not (told.isdecimal() and used <= int(told) <= left):
        raise ValueError(f"{name}: CompressedDataSize of the MetaImage header must be {used}, got {told}")
    wanted = size * math.prod(_sizes(fields, name))
    if have < wanted:
        raise ValueError(f"{name}: the file is cut short: {have} bytes of values, of {wanted}")


def _unpacked(file: BinaryIO, name: str) -> tuple[int, int]:
    """Bytes that a zlib or gzip stream makes, its checksum looked at, and its own."""
    stream, have, used = zlib.decompressobj(32 + zlib.MAX_WBITS), 0, 0
    try:
        while not stream.eof and (chunk := file.read(1 << 22)):
            have += len(stream.decompress(chunk))
            used += len(chunk) - len(stream.unused_data)
    except zlib.error as error:
        raise ValueError(f"{name}: the compressed data is cut short or damaged ({error})") from error
    if not stream.eof:
        raise ValueError(f"{name}: the compressed data is cut short or damaged (it has no end)")
    return have, used


def _fields(name: str) -> tuple[dict[str, str], int]:
    """Of the header, and the place in the file where that ends."""
    fields: dict[str, str] = {}
    with open(name, "rb") as file:
        while raw := file.readline(1 << 16):
            key, sign, value = raw.decode("latin-1").partition("=")
            if not sign:
                break
            fields[key.strip()] = value.strip()
            if key.strip() == _END:
                return fields, file.tell()
    raise ValueError(f"{name}: cannot be read as a volume: no MetaImage header")


def _sizes(fields: dict[str, str], name: str) -> list[int]:
    found = _numbers(fields, ("DimSize",), name)
    if not np.all(np.isfinite(found) & (found == np.rint(found))):
        raise ValueError(f"{name}: DimSize must hold whole numbers, got {fields['DimSize']}")
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
                    f"{name}: cannot be read as a volume: {key} of the MetaImage header is '{fields[key]}'"
                ) from None
    if default is None:
        raise ValueError(f"{name}: cannot be read as a volume: the MetaImage header has no {keys[0]}")
    return np.array(default)
