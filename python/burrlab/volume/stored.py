"""The values of a volume file as it stores them, and the file again with others: its header stays as it is."""

from __future__ import annotations

import gzip
import math
import os
import re
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.bounds import check_memory, first_bytes, shown
from burrlab.volume import nifti
from burrlab.volume.coding import Coding
from burrlab.volume.header import Header, three_sizes
from burrlab.volume.meta_image import meta_fields, read_meta_header
from burrlab.volume.nrrd import nrrd_fields, read_nrrd_header

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
    "MET_LONG": "i4", "MET_ULONG": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
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
    if name.lower().endswith((".nii", ".nii.gz")):
        return _nifti(name)
    at, read_header = _kept_layout(name)
    meta, packed = name.lower().endswith(".mha"), at.encoding == "gzip"
    shape = read_header(name).shape  # axes of 1 that are none may come first
    with open(name, "rb") as file:
        head = file.read(at.start)
        data, rest = first_bytes(file, math.prod(shape) * at.kind.itemsize, packed, name)
        rest = rest if packed else file.read()

    def pack(values: bytes) -> bytes:
        if not packed:
            return head + values + rest
        if not meta:
            return head + gzip.compress(values + rest, 1, mtime=0)
        new = zlib.compress(values + rest, 1)
        size = rb"\g<1>" + str(len(new)).encode()  # the one field that says something of the packed values
        return re.sub(rb"^(CompressedDataSize[ \t]*=[ \t]*)\d+", size, head, flags=re.MULTILINE) + new

    return Stored(_whole(data, at.kind, shape, name), Coding(at.kind), pack)


def check_stored(path: str | os.PathLike[str]) -> Coding:
    """How the values are stored; the errors of `read_stored` that the header alone tells."""
    name = os.fspath(path)
    if name.lower().endswith((".nii", ".nii.gz")):
        return _nifti_layout(name)[1]
    return Coding(_kept_layout(name)[0].kind)


def read_values(name: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """The values of a NRRD or MetaImage file, numbers of this machine; ValueError with one sentence where they are not whole."""
    at = (_meta_layout if name.lower().endswith((".mha", ".mhd")) else _nrrd_layout)(name)
    size = math.prod(shape) * at.kind.itemsize
    part, left = divmod(size, len(at.files))
    if left:
        raise ValueError(
            f"{name}: the values must be in files of one size, got {len(at.files)} for {size} bytes"
        )
    if len(at.files) == 1:
        data = _bytes(at, at.files[0], size, name)
    else:
        check_memory(2 * size, f"{name}: the volume")
        data = np.concatenate([_bytes(at, path, part, name) for path in at.files])
    values = _whole(data, at.kind, shape, name)
    return values.astype(values.dtype.newbyteorder("="), copy=False)


@dataclass(frozen=True)
class _Layout:
    """Where and how the values are stored; `skip` bytes before them, or -1: they are the last ones."""

    kind: np.dtype[Any]  # with byte order
    encoding: str  # raw, gzip (or zlib), text, hex
    files: list[Path]
    start: int  # of what is encoded [bytes]
    lines: int = 0
    skip: int = 0
    told: str = ""  # how many packed bytes there are, where that is told


def _kept_layout(name: str) -> tuple[_Layout, Callable[[str], Header]]:
    """Of a file whose header can be kept, and what reads that."""
    meta = name.lower().endswith(".mha")
    at = (_meta_layout if meta else _nrrd_layout)(name)
    if at.files != [Path(name)] or at.lines or at.skip:
        raise ValueError(
            f"{name}: the values must follow the {'MetaImage' if meta else 'NRRD'} header in the same file"
        )
    if at.encoding not in ("raw", "gzip"):
        raise ValueError(
            f"{name}: the MetaImage file must hold binary numbers right after its header to keep that"
            if meta
            else f"{name}: encoding of the NRRD file must be raw or gzip to keep its header, got {at.encoding!r}"
        )
    return at, read_meta_header if meta else read_nrrd_header


def _nrrd_layout(name: str) -> _Layout:
    fields, _, end = nrrd_fields(name)
    encoding = fields.get("encoding", "").lower()
    encoding = {"gz": "gzip", "txt": "text", "ascii": "text"}.get(encoding, encoding)
    if encoding not in ("raw", "gzip", "text", "hex"):
        raise ValueError(
            f"{name}: encoding of the NRRD file must be raw, gzip, text or hex, got {shown(encoding)}"
        )
    told = fields.get("type", "").lower()
    kind = next((np.dtype(k) for k, words in _NRRD_KINDS.items() if told in words), None)
    if kind is None:
        raise ValueError(
            f"{name}: type of the NRRD file must be one of whole or real numbers, got {shown(told)}"
        )
    if encoding != "text" and kind.itemsize > 1:
        if (order := fields.get("endian", "").lower()) not in ("little", "big"):
            raise ValueError(f"{name}: endian of the NRRD file must be little or big, got {shown(order)}")
        kind = kind.newbyteorder("<" if order == "little" else ">")
    lines, skip = (_count(fields.get(f"{what} skip", "0"), f"{what} skip", name) for what in ("line", "byte"))
    if skip < 0 and encoding != "raw":
        raise ValueError(f"{name}: byte skip of -1 goes with raw values, got encoding {encoding}")
    apart = fields.get("data file")
    if apart is None and not end:
        raise ValueError(f"{name}: the values must follow the NRRD header in the same file")
    files = [Path(name)] if apart is None else _value_files(apart, name)
    return _Layout(kind, encoding, files, end if apart is None else 0, lines, skip)


def _meta_layout(name: str) -> _Layout:
    fields, end = meta_fields(name)
    kind = _META_KINDS.get(fields.get("ElementType", ""))
    if kind is None:
        raise ValueError(
            f"{name}: ElementType of the MetaImage header must be one of {', '.join(_META_KINDS)}, got "
            f"{shown(fields.get('ElementType'))}"
        )

    def true(*keys: str, default: str = "False") -> bool:
        told = next((fields[key] for key in keys if key in fields), default)
        return told[:1].lower() in ("t", "1")

    binary, packed = true("BinaryData", default="True"), true("CompressedData")
    big = true("BinaryDataByteOrderMSB", "ElementByteOrderMSB")
    local, told = fields["ElementDataFile"].upper() == "LOCAL", fields.get("CompressedDataSize", "none")
    before = _count(fields.get("HeaderSize", "") or "0", "HeaderSize", name)
    if before < 0 and (packed or not binary):
        raise ValueError(f"{name}: HeaderSize of -1 goes with raw values")
    return _Layout(
        np.dtype(kind).newbyteorder(">" if big else "<") if binary else np.dtype(kind),
        "text" if not binary else "gzip" if packed else "raw",
        [Path(name)] if local else _value_files(fields["ElementDataFile"], name),
        before if before > 0 else end if local else 0,
        skip=min(before, 0),
        told=told if local or told != "none" else "",  # of a file of their own, its size serves
    )


def _count(text: str, what: str, name: str) -> int:
    if not re.fullmatch(r"-1|\d{1,18}", text):
        raise ValueError(f"{name}: {what} must be a number of bytes or lines, or -1, got {shown(text)}")
    return int(text)


def _value_files(told: str, name: str) -> list[Path]:
    """The files that a header names: one, a list, or a pattern with the first, last and step of its numbers."""
    first, *names = told.splitlines() or [""]
    words = first.split()
    if words[:1] == ["LIST"]:
        names = [line.strip() for line in names if line.strip()]
    elif len(words) >= 4 and re.fullmatch(r"[^%]*%0?\d?d[^%]*", words[0]):
        low, high, step = (_count(word, "pattern of the data file", name) for word in words[1:4])
        numbers = range(low, high + (1 if step > 0 else -1), step or 1)
        names = [words[0] % n for n in numbers[: 1 << 16]]
    else:
        names = [first]
    return [Path(name).parent / part for part in names or [""]]


def _bytes(at: _Layout, path: Path, size: int, name: str) -> NDArray[np.uint8]:
    """Of one file of values, fewer where it is cut short."""
    if not path.is_file():
        raise ValueError(f"{name}: the file of its values, {path.name}, is not there")
    with path.open("rb") as file:
        file.seek(at.start)
        for _ in range(at.lines):
            if not file.readline(1 << 20):
                break
        begin = file.tell()
        left = os.fstat(file.fileno()).st_size - begin
        if at.encoding == "gzip":
            data, _ = first_bytes(file, at.skip + size, True, name)
            used = file.tell() - begin
            if at.told and not (re.fullmatch(r"\d{1,18}", at.told) and used <= int(at.told) <= left):
                raise ValueError(
                    f"{name}: CompressedDataSize of the MetaImage header must be {used}, got {at.told}"
                )
            return data[at.skip :]
        file.seek(max(left - size, 0) if at.skip < 0 else min(at.skip, max(left, 0)), os.SEEK_CUR)
        if at.encoding == "raw":
            return first_bytes(file, size, False, name)[0]
        text = file.read(64 * size // at.kind.itemsize)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if at.encoding == "hex":
                return np.frombuffer(bytes.fromhex(text.decode("latin-1")), np.uint8)
            numbers = np.fromstring(text.replace(b",", b" "), at.kind, size // at.kind.itemsize, sep=" ")
            return numbers.view(np.uint8)
    except (ValueError, DeprecationWarning) as error:
        raise ValueError(f"{name}: the values are cut short, or no numbers ({error})") from None


def _whole(data: NDArray[np.uint8], kind: np.dtype[Any], shape: tuple[int, ...], name: str) -> NDArray[Any]:
    size = math.prod(shape) * kind.itemsize
    if len(data) < size:
        raise ValueError(f"{name}: the file is cut short: {len(data)} bytes of values, of {size}")
    return np.require(data[:size].view(kind).reshape(shape), requirements="A")


def _nifti(name: str) -> Stored:
    fields, coding, shape, packed = _nifti_layout(name)
    size = math.prod(shape) * coding.kind.itemsize
    with open(name, "rb") as file:
        whole, rest = first_bytes(file, fields.offset + size, packed, name)
        rest = rest if packed else file.read()
    head, data = whole[: fields.offset].tobytes(), whole[fields.offset :]
    if len(data) < size:
        raise ValueError(f"{name}: the file is cut short: {len(data)} bytes of values of {size}")

    def pack(values: bytes) -> bytes:
        return gzip.compress(head + values + rest, 1, mtime=0) if packed else head + values + rest

    return Stored(_whole(data, coding.kind, shape, name), coding, pack)


def _nifti_layout(name: str) -> tuple[nifti.Fields, Coding, tuple[int, int, int], bool]:
    """The header, coding and shape of the values, and whether the file is packed."""
    fields, packed = nifti.file_fields(name, name)
    if fields.apart or (kind := nifti.stored_kind(fields)) is None:
        raise ValueError(
            f"{name}: the values must follow the NIfTI header in the same file, one number a voxel"
        )
    slope, inter = fields.slope, fields.inter
    if not (math.isfinite(slope) and math.isfinite(inter)) or slope == 0:
        slope, inter = 1.0, 0.0
    shape = three_sizes(list(fields.dim[1 : fields.dim[0] + 1]), name)
    return fields, Coding(np.dtype(fields.order + kind), slope, inter), shape, packed
