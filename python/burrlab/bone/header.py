"""Reads the headers of volume files: geometry of the voxels, storage of the values, assumptions.

NRRD follows teem.sourceforge.net/nrrd/format.html, MetaImage itk.org/Wiki/ITK/MetaIO, NIfTI nifti1.h and
nifti2.h.
"""

import gzip
import json
import math
import re
import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab.bone.image import Array, LabelVolume, Volume, point_text
from burrlab.bone.specimen import checked_spacing
from burrlab.common.check import amend_error, extra, refuse, shown

Choice = TypeVar("Choice")
#: Spacing, origin, direction, and notes on what is assumed.
Place = tuple[Array, Array, Array, tuple[str, ...]]

#: Words in every note on an orientation that a file does not say, and in pictures of its bone.
LPS_ASSUMED = "LPS assumed"
#: Words in the note on left-handed voxel axes, and in pictures, which are drawn along these axes.
MIRRORED = "mirror image"
#: Length of the units that headers name [mm].
MILLIMETRES = {"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1e3, "meter": 1e3, "metre": 1e3,
               "um": 1e-3, "µm": 1e-3, "micron": 1e-3, "micrometer": 1e-3, "nm": 1e-6}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Header:
    """Number, size and place of a volume's voxels, as its file states them.

    Parameters
    ----------
    shape : tuple of int
        Voxels (z, y, x).
    spacing : ndarray, shape (3,)
        (x, y, z) [mm]; NaN where the file has none.
    origin : ndarray, shape (3,)
        LPS [mm].
    direction : ndarray, shape (3, 3)
        Columns are the voxel axes, LPS.
    notes : tuple of str
        Assumptions about what the file does not say.
    fields : mapping of str to str
        Further fields of the file, as text that can be written again.
    layers : int
        Volumes in a segmentation of 3D Slicer: the first axis of its values.
    files : tuple of str
        Files of a DICOM series, in the order of the slices.
    """

    shape: tuple[int, int, int]
    spacing: Array
    origin: Array
    direction: Array
    notes: tuple[str, ...] = ()
    fields: Mapping[str, str] = field(default_factory=dict)
    layers: int = 1
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        note = f"voxel axes are left-handed: the bone frame, in which pictures are drawn, is a {MIRRORED}"
        with np.errstate(all="ignore"):  # `checked_direction` refuses values that are not finite
            if np.linalg.det(self.direction) < 0 and note not in self.notes:
                object.__setattr__(self, "notes", (*self.notes, note))


@dataclass(frozen=True)
class Storage:
    """Storage of a file's values; a grey value is slope * stored + inter."""

    kind: np.dtype[Any]  # with byte order
    encoding: str  # raw, gzip (or zlib), text, hex
    files: list[Path]
    start: int = 0  # first byte of the encoded data
    lines: int = 0  # lines before the values
    skip: int = 0  # unpacked bytes before the values; -1: the values are the last bytes
    packed_size: str = ""  # number of packed bytes, if the header has it
    slope: float = 1.0
    inter: float = 0.0


def assumed(notes: Iterable[str]) -> str:
    """Words of the notes that a picture of the bone repeats: `LPS_ASSUMED` and `MIRRORED`."""
    text = "\n".join(notes)
    return ", ".join(words for words in (LPS_ASSUMED, MIRRORED) if words in text)


def told_notes(source: Any) -> tuple[str, ...]:
    """Notes in a bone's source, a mapping or its JSON text; empty for any other source."""
    try:
        return tuple(map(str, (json.loads(source) if isinstance(source, str) else source)["notes"]))
    except (ValueError, KeyError, TypeError, RecursionError):
        return ()


def plain_name(name: str) -> str:
    """The name; ValueError if it is not UTF-8, which would make SimpleITK end the process."""
    try:
        name.encode()
    except UnicodeEncodeError:
        raise ValueError(f"path must be UTF-8, got {name!r}") from None
    return name


def medical(module: str, what: str, usual_name: str = "") -> Any:
    """A library of the extra `medical`; ImportError if it is not installed."""
    return extra(module, what, "medical", usual_name)


def itk_image(
    values: NDArray[Any], volume: Volume | LabelVolume, origin: Array, texts: Mapping[str, str]
) -> Any:
    """Values as an image of SimpleITK, with the spacing and direction of a volume, and texts of a header."""
    image = medical("SimpleITK", "writing volumes").GetImageFromArray(values)
    image.SetSpacing(volume.spacing.tolist())
    image.SetOrigin(origin.tolist())
    image.SetDirection(volume.direction.ravel().tolist())
    for key, text in texts.items():
        image.SetMetaData(key, text)
    return image


def settled_spacing(header: Header, spacing: float | ArrayLike | None, name: str) -> Array:
    """Spacing of the file, or the given one if it has none; ValueError if both lack it or they differ."""
    missing = ~(np.isfinite(header.spacing) & (header.spacing > 0))
    if spacing is None:
        axes = ", ".join(axis for axis, lost in zip("xyz", missing, strict=True) if lost)
        refuse(
            axes,
            f"{name}: the file does not say the voxel spacing along {axes}; it must be given: "
            "spacing=(x, y, z) [mm]",
        )
        return header.spacing
    wanted = checked_spacing(spacing)
    refuse(
        not np.allclose(header.spacing[~missing], wanted[~missing], rtol=1e-4, atol=0),
        f"{name}: spacing must be that of the file, {point_text(header.spacing)} mm, where the file has one, got "
        f"{spacing!r}",
    )
    return np.where(missing, wanted, header.spacing)


def three_sizes(sizes: list[int], name: str) -> tuple[int, int, int]:
    """Sizes (z, y, x) from x, y, z and further sizes of 1; ValueError for anything else."""
    used_sizes = sizes[:3] + [n for n in sizes[3:] if n != 1]
    refuse(
        len(used_sizes) != 3 or any(not 1 <= n < 2**31 for n in sizes),
        f"{name}: a volume needs three dimensions and one value a voxel, got sizes "
        f"{' x '.join(map(shown, sizes[:16]))}",
    )
    x, y, z = used_sizes
    return z, y, x


def _chosen(choices: Mapping[str, Choice], word: str, rule: str) -> Choice:
    """What a word of a header stands for; ValueError with the rule and the word if it stands for nothing."""
    refuse(word not in choices, f"{rule}, got {shown(word)}")
    return choices[word]


def numbers_in(text: str, sentence: str, separator: str | None = None) -> Array:
    """The numbers in a field of a header; ValueError with the sentence if it holds anything else."""
    try:
        return np.array([float(number) for number in text.split(separator)])
    except ValueError:
        raise ValueError(sentence) from None


def _unit_columns(vectors: Array) -> tuple[Array, Array]:
    """Lengths of the columns, and the columns scaled to length 1; NaN for a column of length 0."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        lengths = np.sqrt((vectors**2).sum(axis=0))
        return lengths, vectors / lengths


def _check_not_negative(numbers: Array, quantity: str) -> None:
    """ValueError for a spacing below 0: some readers would mirror the volume, others would drop the sign."""
    refuse(
        np.any(numbers < 0),
        f"{quantity} must be positive, got {' '.join(f'{n:g}' for n in numbers)}: is the volume mirrored?",
    )


def _text(content: bytes) -> str:
    """Text of a header's line without its end; messages quote it, so control characters are replaced."""
    return re.sub(r"[\0-\x08\x0a-\x1f\x7f]", "\ufffd", content.rstrip(b"\r\n").decode("utf-8", "replace"))


def _count(text: str, what: str, name: str) -> int:
    refuse(
        not re.fullmatch(r"-1|\d{1,18}", text),
        f"{name}: {what} must be a number of bytes or lines, or -1, got {shown(text)}",
    )
    return int(text)


def _value_files(statement: str, name: str) -> list[Path]:
    """Files that a header names: one, a list, or a pattern with its first number, last number and step."""
    first, *names = statement.splitlines() or [""]
    words = first.split()
    if words[:1] == ["LIST"]:
        names = [line.strip() for line in names if line.strip()]
    elif len(words) >= 4 and re.fullmatch(r"[^%]*%0?\d?d[^%]*", words[0]):
        low, high, step = (_count(word, "pattern of the data file", name) for word in words[1:4])
        names = [words[0] % n for n in range(low, high + (1 if step > 0 else -1), step or 1)[: 1 << 16]]
    else:
        names = [first]
    return [Path(name).parent / part for part in names or [""]]


# ---- NRRD ----

_TO_LPS = {
    "left-posterior-superior": (1.0, 1.0), "lps": (1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0), "ras": (-1.0, -1.0),
    "left-anterior-superior": (1.0, -1.0), "las": (1.0, -1.0),
}  # fmt: skip
_SYNONYMS = {"datafile": "data file", "byteskip": "byte skip", "lineskip": "line skip"}
#: Kinds of an axis along which the values of one voxel lie.
_VALUES = re.compile("^list$|color|vector|point|gradient|normal|complex|quaternion|matrix|hsv|xyz")
_NRRD_KINDS = {word: kind for kind, words in {
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
}.items() for word in words}  # fmt: skip
_NRRD_ENCODINGS = {
    "raw": "raw", "gzip": "gzip", "gz": "gzip", "text": "text", "txt": "text", "ascii": "text", "hex": "hex",
}  # fmt: skip


def nrrd_header(name: str) -> tuple[Header, Storage]:
    """Header and layout of an NRRD file; ValueError if the header cannot be read."""
    fields, keys, end = _nrrd_fields(plain_name(name))
    try:
        sizes = [int(n) for n in fields["sizes"].split()]
        dimension = int(fields["dimension"])
    except (KeyError, ValueError):
        raise ValueError(f"{name}: cannot be read as a volume: the NRRD header has no sizes") from None
    kinds = fields.get("kinds", "").lower().split() or ["?"] * len(sizes)
    vectors = [
        () if part == "none" else tuple(_vector(part, name))
        for part in re.findall(r"\([^()]*\)|none", fields.get("space directions", ""))
    ]
    refuse(
        {len(sizes), len(kinds), len(vectors or sizes)} != {dimension}
        or dimension > 16,  # the format's limit
        f"{name}: cannot be read as a volume: the NRRD header contradicts its dimension {shown(dimension)}",
    )
    spatial = _spatial_axes(sizes, kinds, vectors)
    layers = sizes[0] if dimension == 4 and kinds[0] == "list" and 0 not in spatial else 1
    refuse(
        len(spatial) != 3 or any(n > layers for i, n in enumerate(sizes) if i not in spatial),
        f"{name}: a volume needs three dimensions and one value a voxel, got sizes "
        f"{' x '.join(map(shown, sizes))}",
    )
    shape = three_sizes([sizes[i] for i in spatial], name)
    place = _nrrd_place(fields, [vectors[i] for i in spatial] if vectors else [], spatial, name)
    custom_keys = {key: text for key, text in keys.items() if not key.startswith("NRRD_")}  # ITK obeys these
    return Header(shape, *place, custom_keys, layers), _nrrd_layout(fields, end, name)


def _spatial_axes(sizes: list[int], kinds: list[str], vectors: list[Any]) -> list[int]:
    """Axes that have a direction, or are not of values; of more than three the last ones of one sample go."""
    spatial = [i for i, kind in enumerate(kinds) if (vectors[i] if vectors else not _VALUES.search(kind))]
    while len(spatial) > 3 and 1 in (rest := [sizes[i] for i in spatial]):
        del spatial[len(rest) - 1 - rest[::-1].index(1)]
    return spatial


def _nrrd_place(fields: dict[str, str], vectors: list[Any], spatial: list[int], name: str) -> Place:
    turn, notes = np.ones(3), list[str]()
    if vectors or "space origin" in fields:
        space = fields.get("space", "").lower().removesuffix("-time").rstrip("t")
        if vectors and space not in _TO_LPS:
            notes.append(f"space '{space}' of the NRRD header is no anatomical one: {LPS_ASSUMED}")
        turn = np.array([*_TO_LPS.get(space, (1.0, 1.0)), 1.0]) * _unit(fields.get("space units"), name)
    if vectors:
        refuse(
            any(len(vector) != 3 for vector in vectors),
            f"{name}: space directions of the NRRD header must be three vectors of three",
        )
        spacing, direction = _unit_columns(turn[:, None] * np.array(vectors, dtype=float).T)
    else:
        spacing, direction = _nrrd_spacings(fields, spatial, name), np.eye(3)
        notes.append(f"the NRRD header says no orientation: {LPS_ASSUMED}, voxel axes along L, P, S")
    if (origin_text := fields.get("space origin")) is None:
        notes.append("the NRRD header has no origin: (0, 0, 0) is assumed")
        return spacing, np.zeros(3), direction, tuple(notes)
    origin = _vector(origin_text, name)
    refuse(
        origin.shape != (3,) or not np.all(np.isfinite(origin)),
        f"{name}: space origin of the NRRD header must be three finite numbers, got {shown(origin_text)}",
    )
    return spacing, turn * origin, direction, tuple(notes)


def _nrrd_fields(name: str) -> tuple[dict[str, str], dict[str, str], int]:
    """Fields, keys, and the byte where the values begin, 0 if they are elsewhere.

    The field of a list of data files holds the word LIST and the names.
    """
    fields: dict[str, str] = {}
    keys: dict[str, str] = {}
    with open(name, "rb") as file:
        refuse(
            not file.readline(64).startswith(b"NRRD"), f"{name}: cannot be read as a volume: no NRRD header"
        )
        while raw := file.readline(1 << 20):
            line = _text(raw)
            if not line:
                return fields, keys, file.tell()
            if line.startswith("#"):
                continue
            key, sign, value = map(str.strip, line.partition(":=" if ":=" in line else ":"))
            if sign == ":=":
                keys[key] = re.sub(r"\\([n\\])", lambda m: "\n" if m[1] == "n" else "\\", value).strip()
            else:
                key = _SYNONYMS.get(key.lower(), key.lower())
                if key == "data file" and value.startswith("LIST"):
                    value += "\n" + file.read(1 << 24).decode("utf-8", "replace")
                refuse(key in fields, f"{name}: {shown(key)} must be once in the NRRD header, got it twice")
                fields[key] = value
            refuse(
                len(fields) + len(keys) > 100_000 or file.tell() > 1 << 26,
                f"{name}: cannot be read as a volume: the NRRD header has no end",
            )
    return fields, keys, 0


def _vector(text: str, name: str) -> Array:
    return numbers_in(
        text.strip("() "),
        f"{name}: cannot be read as a volume: {shown(text)} in the NRRD header is no vector",
        ",",
    )


def _unit(text: str | None, name: str) -> float:
    """Length of the unit of space [mm], the same along all axes; 1 if unnamed, as is usual in medicine."""
    units = set(re.findall(r'"([^"]*)"', text or "")) - {"", "???"} or {"mm"}
    refuse(
        len(units) > 1 or (unit := units.pop().lower()) not in MILLIMETRES,
        f"{name}: units of space in the NRRD header must be one of {', '.join(MILLIMETRES)}, got "
        f"{shown(text)}",
    )
    return MILLIMETRES[unit]


def _nrrd_spacings(fields: dict[str, str], spatial: list[int], name: str) -> Array:
    if (text := fields.get("spacings")) is None:
        return np.full(3, np.nan)
    sentence = f"{name}: cannot be read as a volume: spacings of the NRRD header are {shown(text)}"
    every = numbers_in(text, sentence)
    refuse(len(every) <= max(spatial), sentence)
    spacings = every[spatial]
    _check_not_negative(spacings, f"{name}: spacings of the NRRD header")
    units = re.findall(r'"([^"]*)"', fields.get("units", ""))
    wanted = " ".join(f'"{units[i]}"' for i in spatial) if len(units) > max(spatial) else None
    return _unit(wanted, name) * np.where(spacings > 0, spacings, np.nan)


def _nrrd_layout(fields: dict[str, str], end: int, name: str) -> Storage:
    def chosen(choices: Mapping[str, Choice], field: str, rule: str) -> Choice:
        return _chosen(
            choices, fields.get(field, "").lower(), f"{name}: {field} of the NRRD file must be {rule}"
        )

    encoding = chosen(_NRRD_ENCODINGS, "encoding", "raw, gzip, text or hex")
    kind = np.dtype(chosen(_NRRD_KINDS, "type", "one of whole or real numbers"))
    if encoding != "text" and kind.itemsize > 1:
        kind = kind.newbyteorder(chosen({"little": "<", "big": ">"}, "endian", "little or big"))
    lines, skip = (_count(fields.get(f"{what} skip", "0"), f"{what} skip", name) for what in ("line", "byte"))
    refuse(
        skip < 0 and encoding != "raw",
        f"{name}: byte skip of -1 goes with raw values, got encoding {encoding}",
    )
    if (apart := fields.get("data file")) is not None:
        return Storage(kind, encoding, _value_files(apart, name), 0, lines, skip)
    refuse(not end, f"{name}: the values must follow the NRRD header in the same file")
    return Storage(kind, encoding, [Path(name)], end, lines, skip)


# ---- MetaImage ----

_LAST = "ElementDataFile"  # the last field; the values follow
_META_KINDS = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2", "MET_INT": "i4", "MET_UINT": "u4",
    "MET_LONG": "i4", "MET_ULONG": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}  # fmt: skip
#: Fields on geometry and storage, and fields that a writer sets itself: not among the further fields.
_META_OWN = re.compile(
    "Object|NDims|DimSize|Offset$|Position|Origin|TransformMatrix|TransformType|Rotation|Orientation|CenterOfRotation|Anatomical"
    "|DistanceUnits|Binary|Compress|HeaderSize|Element|Color|Name$|ID$|ParentID|Modality|SequenceID|AcquisitionDate|Comment|Segment"
)


def meta_header(name: str) -> tuple[Header, Storage]:
    """Header and layout of a MetaImage file; ValueError if the header cannot be read."""
    fields, end = _meta_fields(plain_name(name))

    def numbers(default: list[float], *keys: str) -> Array:
        """Numbers of the first of these fields that the header has."""
        for key in keys:
            if key in fields:
                where = f"{name}: cannot be read as a volume: {key} of the MetaImage header is"
                return numbers_in(fields[key], f"{where} {shown(fields[key])}")
        return np.array(default)

    refuse(
        "DimSize" not in fields, f"{name}: cannot be read as a volume: the MetaImage header has no DimSize"
    )
    sizes, needs = (
        numbers([], "DimSize"),
        f"{name}: a volume needs three dimensions and one value a voxel, got",
    )
    refuse(
        not np.all(np.isfinite(sizes) & (sizes == np.rint(sizes))),
        f"{name}: DimSize must hold whole numbers, got {fields['DimSize'][:100]}",
    )
    refuse((n := len(sizes)) < 3, f"{needs} {n} dimensions")
    refuse(
        fields.get("NDims") != str(n) or n > 10,  # the format's limit
        f"{name}: NDims of the MetaImage header must be the {n} numbers of DimSize, at most 10, got "
        f"{shown(fields.get('NDims'))}",
    )
    refuse(
        (channels := fields.get("ElementNumberOfChannels", "1")) != "1", f"{needs} {channels[:100]} values"
    )
    shape, notes = three_sizes([int(size) for size in sizes], name), []
    scale = _chosen(
        {**MILLIMETRES, "?": 1.0},
        fields.get("DistanceUnits", "mm").lower(),
        f"{name}: DistanceUnits must be one of {', '.join(MILLIMETRES)}",
    )
    spacing = scale * numbers([np.nan] * n, "ElementSpacing", "ElementSize")[:3]
    _check_not_negative(spacing, f"{name}: ElementSpacing of the MetaImage header")
    matrix = numbers([], "TransformMatrix", "Rotation", "Orientation")
    if len(matrix) == 0:
        if fields.get("AnatomicalOrientation") != "RAI":  # MetaImage names where axes begin: RAI is LPS
            notes.append(f"the MetaImage header says no orientation: {LPS_ASSUMED}, voxel axes along L, P, S")
        matrix = np.eye(n).ravel()
    for key, quantities, count in (("ElementSpacing", spacing, 3), ("TransformMatrix", matrix, n * n)):
        refuse(len(quantities) != count, f"{name}: {key} must hold {count} numbers, got {len(quantities)}")
    origins = ("Offset", "Position", "Origin")
    origin = numbers([], *origins)
    refuse(
        len({tuple(numbers([], key)) for key in origins if key in fields}) > 1,
        f"{name}: {', '.join(key for key in origins if key in fields)} of the MetaImage header must agree",
    )
    if len(origin) == 0:
        notes.append("the MetaImage header has no origin: (0, 0, 0) is assumed")
        origin = np.zeros(n)
    direction = matrix.reshape(n, n)[:3, :3].T  # its rows are the voxel axes
    custom_fields = {
        key: text for key, text in fields.items() if not _META_OWN.match(key) and len(key + text) < 4000
    }
    header = Header(shape, spacing, scale * origin[:3], direction, tuple(notes), custom_fields)
    return header, _meta_layout(fields, end, name)


def _meta_fields(name: str) -> tuple[dict[str, str], int]:
    """Fields of the header, and the byte after its end.

    The field of a list of data files holds the word LIST and the names.
    """
    fields: dict[str, str] = {}
    with open(name, "rb") as file:
        while (raw := file.readline(1 << 16)) and len(fields) < 10_000:
            key, sign, value = _text(raw).partition("=")
            if not sign:
                break
            fields[key.strip()] = value.strip()
            if key.strip() == _LAST:
                names = raw.partition(b"=")[2]  # bytes: a list of names follows
                names += file.read(1 << 24) if names.split()[:1] == [b"LIST"] else b""
                fields[_LAST] = "\n".join(map(_text, names.splitlines())).strip()
                return fields, file.tell()
    raise ValueError(f"{name}: cannot be read as a volume: no MetaImage header")


def _meta_layout(fields: dict[str, str], end: int, name: str) -> Storage:
    rule = f"{name}: ElementType of the MetaImage header must be one of {', '.join(_META_KINDS)}"
    kind = np.dtype(_chosen(_META_KINDS, fields.get("ElementType", ""), rule))
    switches = {"ElementByteOrderMSB": "False", "BinaryData": "True", "CompressedData": "False", **fields}
    binary, packed, big_endian = (
        switches.get(key, switches["ElementByteOrderMSB"])[:1].lower() in ("t", "1")
        for key in ("BinaryData", "CompressedData", "BinaryDataByteOrderMSB")
    )
    local, size = fields[_LAST].upper() == "LOCAL", fields.get("CompressedDataSize", "none")
    before = _count(fields.get("HeaderSize", "") or "0", "HeaderSize", name)
    refuse(before < 0 and (packed or not binary), f"{name}: HeaderSize of -1 goes with raw values")
    return Storage(
        kind.newbyteorder(">" if big_endian else "<") if binary else kind,
        "text" if not binary else "gzip" if packed else "raw",
        [Path(name)] if local else _value_files(fields[_LAST], name),
        before if before > 0 else end if local else 0,
        skip=min(before, 0),
        packed_size=size if local or size != "none" else "",  # values in a file of their own need no size
    )


# ---- NIfTI ----

_NIFTI_KINDS = {
    2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8",
}  # fmt: skip
_NIFTI_UNITS = {1: 1e3, 2: 1.0, 3: 1e-3}  # xyzt_units: metres, millimetres, micrometres
_NIFTI_TO_LPS = np.diag([-1.0, -1.0, 1.0])  # NIfTI's x and y point right and forward
#: Relative difference allowed between spacing by sform and by pixdim.
_AGREE = 1e-3
#: Type and byte of each field, in version 1 and in version 2.
_NIFTI_FIELDS = {
    "dim": (("8h", 40), ("8q", 16)), "datatype": (("h", 70), ("h", 12)), "pixdim": (("8f", 76), ("8d", 104)),
    "offset": (("f", 108), ("q", 168)), "scale": (("2f", 112), ("2d", 176)), "units": (("B", 123), ("i", 500)),
    "descrip": (("80s", 148), ("80s", 240)), "aux_file": (("24s", 228), ("24s", 320)), "codes": (("2h", 252), ("2i", 344)),
    "quatern": (("3f", 256), ("3d", 352)), "qoffset": (("3f", 268), ("3d", 376)), "srow": (("12f", 280), ("12d", 400)),
}  # fmt: skip
_KEPT_NIFTI = {"ITK_FileNotes": "descrip", "aux_file": "aux_file"}  # SimpleITK's keys and NIfTI's fields


def nifti_header(name: str) -> tuple[Header, Storage]:
    """Header and layout of a NIfTI file; ValueError if the header cannot be read."""
    pair = name[:-4] if name.lower().endswith((".img", ".hdr")) else None
    at, order, apart = _nifti_fields(name if pair is None else pair + ".hdr", name)
    count = at["dim"][0]
    refuse(not 1 <= count <= 7, f"{name}: dim of the NIfTI header must begin with 1 to 7, got {count}")
    shape = three_sizes(list(at["dim"][1 : count + 1]), name)
    kind = _NIFTI_KINDS.get(at["datatype"][0], "")
    refuse(
        not kind,
        f"{name}: a volume needs three dimensions and one value a voxel, got NIfTI datatype {at['datatype'][0]}",
    )
    slope, inter = at["scale"]
    if not math.isfinite(slope) or slope == 0:
        slope, inter = 1.0, 0.0
    refuse(not math.isfinite(inter), f"{name}: scl_inter of the NIfTI header must be finite, got {inter}")
    place = pair + ".img" if pair is not None and apart else name
    layout = Storage(
        np.dtype(order + kind), "gzip" if _is_packed(place) else "raw", [Path(place)], skip=at["offset"], slope=slope,
        inter=inter,
    )  # fmt: skip
    texts = {  # ITK refuses to write a text that does not end in a zero byte
        key: at[field][0][:-1].partition(b"\0")[0].decode("utf-8", "ignore")
        for key, field in _KEPT_NIFTI.items()
    }
    return Header(shape, *_nifti_place(at, shape, name), texts), layout


def _is_packed(path: str) -> bool:
    with open(path, "rb") as file:
        return file.read(2) == b"\x1f\x8b"


def _nifti_fields(path: str, name: str) -> tuple[dict[str, Any], str, bool]:
    """Fields of version 1 or 2, byte order, and whether the values are in a file of their own."""
    damaged = f"{name}: the compressed data is cut short or damaged ("
    with (
        amend_error(damaged, ")", (EOFError, gzip.BadGzipFile, zlib.error)),
        gzip.open(path) if _is_packed(path) else open(path, "rb") as file,
    ):
        content = file.read(540)
    refuse(len(content) < 348, f"{name}: the file is too short for a NIfTI header")
    for order in "<>":
        (size,) = struct.unpack(order + "i", content[:4])
        version = {348: 1, 540: 2}.get(size, 0)
        magic = content[344:347] if version == 1 else content[4:7]
        if not version or magic not in (b"n+%d" % version, b"ni%d" % version) or len(content) < size:
            continue
        at: dict[str, Any] = {
            key: struct.unpack_from(order + places[version - 1][0], content, places[version - 1][1])
            for key, places in _NIFTI_FIELDS.items()
        }
        apart, offset = magic[:2] == b"ni", at["offset"][0]
        if version == 1:
            offset = int(offset) if math.isfinite(offset) and offset >= 0 else 0
        refuse(
            offset < (0 if apart else size),
            f"{name}: the values must begin behind the NIfTI header of {size} bytes, got vox_offset {offset}",
        )
        return {**at, "offset": offset}, order, apart
    raise ValueError(f"{name}: cannot be read as a volume: no NIfTI header")


def _nifti_place(at: dict[str, Any], shape: tuple[int, int, int], name: str) -> Place:
    unit, notes = at["units"][0] & 7, []
    if unit not in _NIFTI_UNITS:
        notes.append("the NIfTI header names no unit of length: millimetres are assumed")
    scale = _NIFTI_UNITS.get(unit, 1.0)
    pixdim = np.array(at["pixdim"][1:4], dtype=float)
    spacing = np.where(np.isfinite(pixdim) & (pixdim > 0), scale * pixdim, np.nan)
    q_code, s_code = at["codes"]
    q_origin = origin = scale * np.array(at["qoffset"], dtype=float)
    q = direction = _from_quaternion(at, name) if q_code > 0 else np.eye(3)
    if s_code > 0:
        s = np.array(at["srow"], dtype=float).reshape(3, 4)
        refuse(
            not np.all(np.isfinite(s)),
            f"{name}: the sform of the NIfTI header holds values that are not finite",
        )
        lengths, direction = _unit_columns(s[:, :3])
        lengths, origin = scale * lengths, scale * s[:, 3]
        refuse(
            np.any(np.abs(lengths - spacing) > _AGREE * lengths) or not np.all(lengths > 0),
            f"{name}: spacing by sform, {point_text(lengths)} mm, and by pixdim, {point_text(spacing)} mm, must agree",
        )
        spacing = lengths
        ends = (np.array(shape[::-1]) - 1) * spacing * list(np.ndindex(2, 2, 2))
        apart = [
            np.linalg.norm((q_origin + q @ end) - (origin + direction @ end)) for end in ends if q_code > 0
        ]
        refuse(
            (most := max(apart, default=0.0)) > 0.1 * spacing.min(),
            f"{name}: qform and sform of the NIfTI header place the volume differently, by up to {most:.3g} mm; set "
            "the code of the one that is wrong to 0",
        )
    elif q_code <= 0:
        notes.append(
            f"the NIfTI header says no orientation (qform and sform code 0): {LPS_ASSUMED}, voxel axes along "
            "L, P, S, from (0, 0, 0)"
        )
        return spacing, np.zeros(3), np.eye(3), tuple(notes)
    refuse(not np.all(np.isfinite(origin)), f"{name}: the origin in the NIfTI header is not finite")
    return spacing, _NIFTI_TO_LPS @ origin, _NIFTI_TO_LPS @ direction, tuple(notes)


def _from_quaternion(at: dict[str, Any], name: str) -> Array:
    b, c, d = at["quatern"]
    square = b * b + c * c + d * d
    refuse(
        not square <= 1.0 + 1e-5,
        f"{name}: the quaternion of the NIfTI header is not of length 1, got {at['quatern']}",
    )
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
    return np.asarray(turn * (1.0, 1.0, -1.0 if at["pixdim"][0] < 0 else 1.0))
