"""NIfTI-1 and NIfTI-2 files, read by their own headers.

Layout after nifti1.h and nifti2.h of the NIfTI Data Format Working Group.
"""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from burrlab.bounds import first_bytes
from burrlab.volume.geometry import Array
from burrlab.volume.header import Header, three_sizes, unit_columns

_KINDS = {
    2: "u1",
    4: "i2",
    8: "i4",
    16: "f4",
    64: "f8",
    256: "i1",
    512: "u2",
    768: "u4",
    1024: "i8",
    1280: "u8",
}
_UNITS = {1: 1e3, 2: 1.0, 3: 1e-3}  # xyzt_units: metres, millimetres, micrometres
_TO_LPS = np.diag([-1.0, -1.0, 1.0])  # NIfTI's x and y point right and forward
#: sform and qform, and their lengths and pixdim, may differ by this part of a voxel or of a spacing.
_AGREE = 1e-3


@dataclass(frozen=True)
class Fields:
    """Of either version of the header."""

    order: str
    dim: tuple[int, ...]
    datatype: int
    bits: int
    pixdim: tuple[float, ...]
    offset: int
    slope: float
    inter: float
    units: int
    qform_code: int
    sform_code: int
    quatern: tuple[float, ...]
    qoffset: tuple[float, ...]
    srow: tuple[float, ...]
    apart: bool  # values in a file of their own


def read_nifti(name: str) -> tuple[Header, NDArray[Any]]:
    """Header and values (z, y, x); ValueError with one sentence for anything that cannot be read whole."""
    stem = name[:-4] if name.lower().endswith((".img", ".hdr")) else None
    fields, _ = file_fields(name if stem is None else stem + ".hdr", name)
    shape = three_sizes(list(fields.dim[1 : fields.dim[0] + 1]), name)
    kind = _KINDS.get(fields.datatype)
    if kind is None:
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got NIfTI datatype {fields.datatype}"
        )
    wanted = fields.offset + math.prod(shape) * np.dtype(kind).itemsize
    with open(stem + ".img" if stem is not None and fields.apart else name, "rb") as file:
        content, _ = first_bytes(file, wanted, _is_packed(file), name)
    if len(content) < wanted:
        raise ValueError(f"{name}: the file is cut short: {len(content)} bytes of {wanted}")
    stored = content[fields.offset :].view(fields.order + kind).reshape(shape)
    return _header(fields, shape, name), _scaled(stored, fields)


def file_fields(path: str, name: str) -> tuple[Fields, bool]:
    """The header of a file, and whether that is packed."""
    with open(path, "rb") as file:
        packed = _is_packed(file)
        try:
            head = (gzip.GzipFile(fileobj=file) if packed else file).read(540)
        except (EOFError, OSError, zlib.error) as error:
            raise ValueError(f"{name}: the compressed data is cut short or damaged ({error})") from error
    return header_fields(head, name), packed


def _is_packed(file: BinaryIO) -> bool:
    found = file.read(2) == b"\x1f\x8b"
    file.seek(0)
    return found


def header_fields(content: bytes, name: str) -> Fields:
    """Of an unpacked file; ValueError where it holds no NIfTI header."""
    if len(content) < 348:
        raise ValueError(f"{name}: the file is too short for a NIfTI header")
    for order in "<>":
        (size,) = struct.unpack(order + "i", content[:4])
        if size == 348 and content[344:347] in (b"n+1", b"ni1"):
            return _checked_offset(_version_1(content, order), size, name)
        if size == 540 and content[4:7] in (b"n+2", b"ni2") and len(content) >= 540:
            return _checked_offset(_version_2(content, order), size, name)
    raise ValueError(f"{name}: cannot be read as a volume: no NIfTI header")


def _checked_offset(fields: Fields, size: int, name: str) -> Fields:
    if fields.offset < (0 if fields.apart else size):
        raise ValueError(
            f"{name}: the values must begin behind the NIfTI header of {size} bytes, got vox_offset {fields.offset}"
        )
    return fields


def stored_kind(fields: Fields) -> str | None:
    """NumPy's name of the numbers of a file, without byte order; None where they are others."""
    return _KINDS.get(fields.datatype)


def _version_1(content: bytes, order: str) -> Fields:
    def at(place: int, kind: str) -> Any:
        return struct.unpack_from(order + kind, content, place)

    apart = content[344:347] == b"ni1"
    values: list[Any] = [
        order, at(40, "8h"), *at(70, "2h"), at(76, "8f"), 0 if apart else _whole(*at(108, "f")), *at(112, "2f"),
        content[123] & 7, *at(252, "2h"), at(256, "3f"), at(268, "3f"), at(280, "12f"), apart,
    ]  # fmt: skip
    return Fields(*values)


def _version_2(content: bytes, order: str) -> Fields:
    def at(place: int, kind: str) -> Any:
        return struct.unpack_from(order + kind, content, place)

    (units,) = at(500, "i")
    values: list[Any] = [
        order, at(16, "8q"), *at(12, "2h"), at(104, "8d"), *at(168, "q"), *at(176, "2d"), units & 7,
        *at(344, "2i"), at(352, "3d"), at(376, "3d"), at(400, "12d"), content[4:7] == b"ni2",
    ]  # fmt: skip
    return Fields(*values)


def _whole(value: float) -> int:
    return int(value) if math.isfinite(value) and value >= 0 else 0


def _scaled(stored: NDArray[Any], fields: Fields) -> NDArray[Any]:
    """slope * stored + inter, unless the slope is 0 or there is nothing to do."""
    slope, inter = fields.slope, fields.inter
    native = np.require(stored, stored.dtype.newbyteorder("="), "A")
    if not (math.isfinite(slope) and math.isfinite(inter)) or slope == 0 or (slope, inter) == (1.0, 0.0):
        return native
    single = native.dtype.itemsize <= 2 or native.dtype == np.float32
    values = np.empty(native.shape, np.float32 if single else np.float64)
    with np.errstate(over="ignore"):  # what is infinite is refused with its place
        for k, plane in enumerate(native):  # a plane at a time: no copies of the large volume
            values[k] = plane * np.float64(slope) + np.float64(inter)
    return values


def _header(fields: Fields, shape: tuple[int, int, int], name: str) -> Header:
    notes = []
    if fields.units not in _UNITS:
        notes.append("the NIfTI header names no unit of length: millimetres are assumed")
    scale = _UNITS.get(fields.units, 1.0)
    pixdim = np.array(fields.pixdim[1:4], dtype=float)
    spacing = np.where(np.isfinite(pixdim) & (pixdim > 0), scale * pixdim, np.nan)
    q = s = None
    if fields.qform_code > 0:
        q = _from_quaternion(fields.quatern, -1.0 if fields.pixdim[0] < 0 else 1.0, name)
    if fields.sform_code > 0:
        s = np.array(fields.srow, dtype=float).reshape(3, 4)
        if not np.all(np.isfinite(s)):
            raise ValueError(f"{name}: the sform of the NIfTI header holds values that are not finite")
    if s is not None:
        lengths, direction = unit_columns(s[:, :3])
        lengths, origin = scale * lengths, scale * s[:, 3]
        off = np.abs(lengths - spacing) > _AGREE * lengths
        if np.any(off) or not np.all(lengths > 0):
            raise ValueError(
                f"{name}: spacing by sform, {_text(lengths)} mm, and by pixdim, {_text(spacing)} mm, must agree"
            )
        if q is not None:
            _check_agree(q, scale * np.array(fields.qoffset), direction, origin, lengths, shape, name)
        spacing = lengths
    elif q is not None:
        direction, origin = q, scale * np.array(fields.qoffset, dtype=float)
    else:
        notes.append(
            "the NIfTI header says no orientation (qform and sform code 0): voxel axes are taken as L, P, S, from (0, 0, 0)"
        )
        return Header(shape, spacing, np.zeros(3), np.eye(3), tuple(notes))
    if not np.all(np.isfinite(origin)):
        raise ValueError(f"{name}: the origin in the NIfTI header is not finite")
    return Header(shape, spacing, _TO_LPS @ origin, _TO_LPS @ direction, tuple(notes))


def _from_quaternion(quatern: tuple[float, ...], handed: float, name: str) -> Array:
    b, c, d = (float(part) for part in quatern)
    square = b * b + c * c + d * d
    if not square <= 1.0 + 1e-5:
        raise ValueError(f"{name}: the quaternion of the NIfTI header is not of length 1, got {quatern}")
    if square > 1.0:
        b, c, d = (part / math.sqrt(square) for part in (b, c, d))
    a = math.sqrt(max(1.0 - square, 0.0))
    turn = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    return np.asarray(turn * (1.0, 1.0, handed))


def _check_agree(
    q: Array,
    q_origin: Array,
    s: Array,
    s_origin: Array,
    spacing: Array,
    shape: tuple[int, int, int],
    name: str,
) -> None:
    """ValueError where qform and sform put a corner of the volume a tenth of a voxel apart."""
    far = (np.array(shape[::-1]) - 1) * spacing
    off = max(
        float(np.linalg.norm((q_origin + q @ (far * bits)) - (s_origin + s @ (far * bits))))
        for bits in np.ndindex(2, 2, 2)
    )
    if off > 0.1 * spacing.min():
        raise ValueError(
            f"{name}: qform and sform of the NIfTI header place the volume differently, by up to {off:.3g} mm; set the code of "
            "the one that is wrong to 0"
        )


def _text(values: Array) -> str:
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"
