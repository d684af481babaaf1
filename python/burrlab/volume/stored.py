"""The values of a volume file as it stores them, and the file again with others: its header stays as it is."""

from __future__ import annotations

import gzip
import math
import os
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.volume import nifti
from burrlab.volume.coding import Coding
from burrlab.volume.header import three_sizes
from burrlab.volume.nrrd import read_nrrd_header

ENDINGS = (".nrrd", ".nii", ".nii.gz", ".mha")

_NRRD_KINDS = {
    "i1": ("signed char", "int8", "int8_t"),
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "i8": ("longlong", "long long", "long long int", "signed long long", "signed long long int", "int64", "int64_t"),
    "u8": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"),
    "f4": ("float",),
    "f8": ("double",),
}  # fmt: skip
_META_KINDS = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2", "MET_INT": "i4", "MET_UINT": "u4",
    "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4", "MET_DOUBLE": "f8",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Stored:
    """A volume file, taken apart.

    Attributes
    ----------
    values : ndarray, shape (nz, ny, nx)
        As they are stored, of the type and byte order of the file.
    coding : Coding
        What grey values they are.
    """

    values: NDArray[Any]
    coding: Coding
    _pack: Callable[[bytes], bytes]

    def content(self, values: NDArray[Any]) -> bytes:
        """The whole file with other values of the same type; header, encoding and what follows the values stay."""
        assert values.shape == self.values.shape
        return self._pack(np.ascontiguousarray(values, self.values.dtype).tobytes())


def can_keep_header(path: str | os.PathLike[str]) -> bool:
    """Whether this is a file of a format whose header can be kept as it is."""
    name = os.fspath(path)
    return name.lower().endswith(ENDINGS) and Path(name).is_file()


def read_stored(path: str | os.PathLike[str]) -> Stored:
    """Takes a volume file apart: NRRD, NIfTI or MetaImage with header and values in one file.

    Raises
    ------
    ValueError
        If its header says an encoding that is not known here, or values in another file.
    """
    name = os.fspath(path)
    content = Path(name).read_bytes()
    if name.lower().endswith(".nrrd"):
        return _nrrd(name, content)
    if name.lower().endswith(".mha"):
        return _meta(name, content)
    return _nifti(name, content)


def check_stored(path: str | os.PathLike[str]) -> Coding:
    """How the values are stored; the errors of `read_stored` that the header alone tells."""
    name = os.fspath(path)
    with open(name, "rb") as file:
        if name.lower().endswith((".nrrd", ".mha")):
            meta, lines = name.lower().endswith(".mha"), []
            for line in file:
                lines.append(line)
                if line.startswith(b"ElementDataFile") if meta else not line.strip():
                    break
            _, _, kind, _ = (_meta_layout if meta else _nrrd_layout)(name, b"".join(lines))
            return Coding(np.dtype(kind))
        packed = file.read(2) == b"\x1f\x8b"
    with gzip.open(name) if packed else open(name, "rb") as file:
        return _nifti_layout(name, file.read(540))[1]


def _nrrd(name: str, content: bytes) -> Stored:
    end, encoding, kind, shape = _nrrd_layout(name, content)
    head, data = content[:end], content[end:]
    coding = Coding(np.dtype(kind))
    if encoding == "raw":
        return _assembled(name, data, coding, shape, lambda values, rest: head + values + rest)
    unpacked = _unpacked(name, lambda: gzip.decompress(data))
    return _assembled(
        name,
        unpacked,
        coding,
        shape,
        lambda values, rest: head + gzip.compress(values + rest, 1, mtime=0),
    )


def _nrrd_layout(name: str, content: bytes) -> tuple[int, str, str, tuple[int, int, int]]:
    """Bytes of the header, encoding, type with byte order, and shape of the values."""
    end = re.search(rb"\r?\n\r?\n", content)
    if end is None:
        raise ValueError(f"{name}: the values must follow the NRRD header in the same file")
    fields = {}
    for line in content[: end.end()].decode("utf-8", "replace").splitlines():
        if not line.startswith("#") and ":=" not in line:
            key, _, value = line.partition(":")
            fields[key.strip().lower()] = value.strip()
    skips = {fields.get(key, "0") for key in ("byte skip", "byteskip", "line skip", "lineskip")}
    if "data file" in fields or "datafile" in fields or skips != {"0"}:
        raise ValueError(f"{name}: the values must follow the NRRD header in the same file")
    encoding = fields.get("encoding", "").lower()
    if encoding not in ("raw", "gzip", "gz"):
        raise ValueError(
            f"{name}: encoding of the NRRD file must be raw or gzip to keep its header, got {encoding!r}"
        )
    kind = next((k for k, words in _NRRD_KINDS.items() if fields.get("type", "").lower() in words), None)
    if kind is None:
        raise ValueError(
            f"{name}: type of the NRRD file must be one of whole or real numbers, got {fields.get('type')!r}"
        )
    order = ">" if fields.get("endian", "little").lower() == "big" else "<"
    shape = read_nrrd_header(name).shape  # axes of 1 that are none may come first
    return end.end(), encoding, order + kind, shape


def _nifti(name: str, content: bytes) -> Stored:
    packed = content[:2] == b"\x1f\x8b"
    whole = _unpacked(name, lambda: gzip.decompress(content)) if packed else content
    fields, coding, shape = _nifti_layout(name, whole)
    head, data = whole[: fields.offset], whole[fields.offset :]

    def pack(values: bytes, rest: bytes) -> bytes:
        return gzip.compress(head + values + rest, 1, mtime=0) if packed else head + values + rest

    return _assembled(name, data, coding, shape, pack)


def _nifti_layout(name: str, content: bytes) -> tuple[nifti.Fields, Coding, tuple[int, int, int]]:
    """The header, and coding and shape of the values."""
    fields = nifti.header_fields(content, name)
    if fields.apart or (kind := nifti.stored_kind(fields)) is None:
        raise ValueError(
            f"{name}: the values must follow the NIfTI header in the same file, one number a voxel"
        )
    slope, inter = fields.slope, fields.inter
    if not (math.isfinite(slope) and math.isfinite(inter)) or slope == 0:
        slope, inter = 1.0, 0.0
    shape = three_sizes(list(fields.dim[1 : fields.dim[0] + 1]), name)
    return fields, Coding(np.dtype(fields.order + kind), slope, inter), shape


def _meta(name: str, content: bytes) -> Stored:
    end, packed, kind, shape = _meta_layout(name, content)
    head, data, coding = content[:end], content[end:], Coding(np.dtype(kind))
    if not packed:
        return _assembled(name, data, coding, shape, lambda values, rest: head + values + rest)

    def pack(values: bytes, rest: bytes) -> bytes:
        packed = zlib.compress(values + rest, 1)
        size = rb"\g<1>" + str(len(packed)).encode()  # the one field that says something of the packed values
        return re.sub(rb"^(CompressedDataSize[ \t]*=[ \t]*)\d+", size, head, flags=re.MULTILINE) + packed

    return _assembled(name, _unpacked(name, lambda: zlib.decompress(data)), coding, shape, pack)


def _meta_layout(name: str, content: bytes) -> tuple[int, bool, str, tuple[int, int, int]]:
    """Bytes of the header, whether the values are packed, their type with byte order, and shape."""
    end = re.search(rb"^ElementDataFile[ \t]*=[ \t]*([^\r\n]*)\r?\n", content, flags=re.MULTILINE)
    if end is None or end[1].strip() != b"LOCAL":
        raise ValueError(f"{name}: the values must follow the MetaImage header in the same file")
    fields = {}
    for line in content[: end.end()].decode("latin-1").splitlines():
        key, _, value = line.partition("=")
        fields[key.strip()] = value.strip()
    kind = _META_KINDS.get(fields.get("ElementType", ""))
    binary = fields.get("BinaryData", "True").lower() == "true"
    if kind is None or not binary or fields.get("HeaderSize", "0") not in ("0", ""):
        raise ValueError(
            f"{name}: the MetaImage file must hold binary numbers right after its header to keep that"
        )
    msb = fields.get("BinaryDataByteOrderMSB", fields.get("ElementByteOrderMSB", "False")).lower() == "true"
    shape = three_sizes([int(n) for n in fields["DimSize"].split()], name)
    return (
        end.end(),
        fields.get("CompressedData", "False").lower() == "true",
        (">" if msb else "<") + kind,
        shape,
    )


def _assembled(
    name: str,
    data: bytes,
    coding: Coding,
    shape: tuple[int, int, int],
    pack: Callable[[bytes, bytes], bytes],
) -> Stored:
    size = math.prod(shape) * coding.kind.itemsize
    if len(data) < size:
        raise ValueError(f"{name}: the file is cut short: {len(data)} bytes of values of {size}")
    rest = data[size:]
    values = np.frombuffer(data, coding.kind, math.prod(shape)).reshape(shape)
    return Stored(values, coding, lambda new: pack(new, rest))


def _unpacked(name: str, unpack: Callable[[], bytes]) -> bytes:
    try:
        return unpack()
    except (EOFError, OSError, zlib.error) as error:
        raise ValueError(f"{name}: the compressed data is cut short or damaged ({error})") from None
