"""What a file says about where its voxels lie, and what must be asked for.

Headers of NRRD files. Fields after the format definition, teem.sourceforge.net/nrrd/format.html.

Headers of MetaImage files (.mha, .mhd). Fields after the MetaIO documentation, itk.org/Wiki/ITK/MetaIO.

NIfTI-1 and NIfTI-2 files, read by their own headers.

Layout after nifti1.h and nifti2.h of the NIfTI Data Format Working Group.
"""

from __future__ import annotations

import gzip
import json
import math
import re
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab.bone.image import Array, checked_spacing
from burrlab.common.check import first_bytes, shown

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


_TO_LPS = {
    "left-posterior-superior": (1.0, 1.0), "lps": (1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0), "ras": (-1.0, -1.0),
    "left-anterior-superior": (1.0, -1.0), "las": (1.0, -1.0),
}  # fmt: skip
_SYNONYMS = {"datafile": "data file", "byteskip": "byte skip", "lineskip": "line skip"}
# Kinds of an axis whose samples are values of one voxel.
_VALUES = ("color", "vector", "point", "gradient", "normal", "complex", "quaternion", "matrix", "hsv", "xyz")


def segment_layers(name: str) -> tuple[int, dict[str, str]]:
    """How many layers a segmentation of 3D Slicer has in its file, 1 if none, and the fields that describe its segments."""
    fields, keys, _ = nrrd_fields(name)
    kinds, sizes = fields.get("kinds", "").lower().split(), fields.get("sizes", "").split()
    layered = len(sizes) == 4 and kinds[:1] == ["list"] and re.fullmatch(r"\d{1,9}", sizes[0])
    return (int(sizes[0]) if layered else 1), keys


def read_nrrd_header(name: str, *, layers: bool = False) -> Header:
    """Place of the voxels, of each layer if asked; ValueError with one sentence where the header cannot be read."""
    fields, keys, _ = nrrd_fields(name)
    try:
        sizes = [int(n) for n in fields["sizes"].split()]
        dimension = int(fields["dimension"])
    except (KeyError, ValueError):
        raise ValueError(f"{name}: cannot be read as a volume: the NRRD header has no sizes") from None
    kinds = [kind.lower() for kind in fields.get("kinds", "").split()] or ["?"] * len(sizes)
    vectors = _vectors(fields, name)
    counts = {len(sizes), len(kinds), len(vectors or sizes)}
    if counts != {dimension} or dimension > 16:  # the format's limit
        raise ValueError(
            f"{name}: cannot be read as a volume: the NRRD header contradicts its dimension {shown(dimension)}"
        )
    spatial = [i for i in range(dimension) if (vectors[i] if vectors else not _holds_values(kinds[i]))]
    while len(spatial) > 3 and 1 in (rest := [sizes[i] for i in spatial]):
        del spatial[len(rest) - 1 - rest[::-1].index(1)]
    if len(spatial) != 3 or any(
        n > 1 for i, n in enumerate(sizes) if i not in spatial and not (layers and i == 0)
    ):
        raise ValueError(
            f"{name}: a volume needs three dimensions and one value a voxel, got sizes {' x '.join(map(shown, sizes))}"
        )
    shape = three_sizes([sizes[i] for i in spatial], name)
    names, colours = _segments(keys)
    notes: list[str] = []
    if vectors:
        if any(len(vectors[i]) != 3 for i in spatial):
            raise ValueError(f"{name}: space directions of the NRRD header must be three vectors of three")
        table = np.array([vectors[i] for i in spatial], dtype=float).T
        table = _to_lps(fields, name, notes)[:, None] * _unit(fields.get("space units"), name, notes) * table
        spacing, direction = unit_columns(table)
        origin = _origin(fields, name, notes)
        return Header(shape, spacing, origin, direction, tuple(notes), names, colours)
    spacing = _spacings(fields, spatial, name, notes)
    notes.append(f"the NRRD header says no orientation: {LPS_ASSUMED}, voxel axes along L, P, S")
    return Header(shape, spacing, _origin(fields, name, notes), np.eye(3), tuple(notes), names, colours)


def nrrd_fields(name: str) -> tuple[dict[str, str], dict[str, str], int]:
    """Fields, keys, and where the values begin, 0 if nowhere; the names of a list of files follow the word LIST."""
    fields: dict[str, str] = {}
    keys: dict[str, str] = {}
    with open(name, "rb") as file:
        if not file.readline(64).startswith(b"NRRD"):
            raise ValueError(f"{name}: cannot be read as a volume: no NRRD header")
        while raw := file.readline(1 << 20):
            line = header_text(raw)
            if not line:
                return fields, keys, file.tell()
            if line.startswith("#"):
                continue
            if ":=" in line:
                key, _, value = line.partition(":=")
                value = re.sub(r"\\([n\\])", lambda m: "\n" if m[1] == "n" else "\\", value)
                keys[key.strip()] = value.strip()
            else:
                field, _, value = line.partition(":")
                field, value = field.strip().lower(), value.strip()
                field = _SYNONYMS.get(field, field)
                if field == "data file" and value.startswith("LIST"):
                    value += "\n" + file.read(1 << 24).decode("utf-8", "replace")
                if field in fields:
                    raise ValueError(f"{name}: {shown(field)} must be once in the NRRD header, got it twice")
                fields[field] = value
            if len(fields) + len(keys) > 100_000 or file.tell() > 1 << 26:
                raise ValueError(f"{name}: cannot be read as a volume: the NRRD header has no end")
    return fields, keys, 0


def _vectors(fields: dict[str, str], name: str) -> list[tuple[float, ...]]:
    """Of `space directions`, one an axis, () for "none"."""
    text = fields.get("space directions")
    if text is None:
        return []
    found: list[tuple[float, ...]] = []
    for part in re.findall(r"\([^()]*\)|none", text):
        found.append(() if part == "none" else _numbers(part, name))
    return found


def _numbers(text: str, name: str) -> tuple[float, ...]:
    try:
        return tuple(float(number) for number in text.strip("() ").split(","))
    except ValueError:
        raise ValueError(
            f"{name}: cannot be read as a volume: {shown(text)} in the NRRD header is no vector"
        ) from None


def _holds_values(kind: str) -> bool:
    return kind == "list" or any(word in kind for word in _VALUES)


def _to_lps(fields: dict[str, str], name: str, notes: list[str]) -> Array:
    space = fields.get("space", "").lower().removesuffix("-time").rstrip("t")
    signs = _TO_LPS.get(space)
    if signs is None:
        if not any(LPS_ASSUMED in note for note in notes):
            notes.append(f"space '{space}' of the NRRD header is no anatomical one: {LPS_ASSUMED}")
        signs = (1.0, 1.0)
    return np.array([*signs, 1.0])


def _unit(text: str | None, name: str, notes: list[str]) -> float:
    """Millimetres of the units of space, which must be alike; none named: mm, by the format's use in medicine."""
    units = set(re.findall(r'"([^"]*)"', text or "")) - {"", "???"}
    if not units:
        return 1.0
    if len(units) > 1 or (unit := units.pop().lower()) not in MILLIMETRES:
        raise ValueError(
            f"{name}: units of space in the NRRD header must be one of {', '.join(MILLIMETRES)}, got {shown(text)}"
        )
    return MILLIMETRES[unit]


def _origin(fields: dict[str, str], name: str, notes: list[str]) -> Array:
    text = fields.get("space origin")
    if text is None:
        notes.append("the NRRD header has no origin: (0, 0, 0) is assumed")
        return np.zeros(3)
    origin = np.array(_numbers(text, name))
    if origin.shape != (3,) or not np.all(np.isfinite(origin)):
        raise ValueError(
            f"{name}: space origin of the NRRD header must be three finite numbers, got {shown(text)}"
        )
    return np.asarray(_to_lps(fields, name, notes) * _unit(fields.get("space units"), name, notes) * origin)


def _spacings(fields: dict[str, str], spatial: list[int], name: str, notes: list[str]) -> Array:
    text = fields.get("spacings")
    if text is None:
        return np.full(3, np.nan)
    try:
        every = [float(number) for number in text.split()]
        found = np.array([every[i] for i in spatial])
    except (ValueError, IndexError):
        raise ValueError(
            f"{name}: cannot be read as a volume: spacings of the NRRD header are '{text}'"
        ) from None
    check_not_negative(found, f"{name}: spacings of the NRRD header")
    units = re.findall(r'"([^"]*)"', fields.get("units", ""))
    wanted = " ".join(f'"{units[i]}"' for i in spatial) if len(units) > max(spatial) else None
    return np.asarray(_unit(wanted, name, notes) * np.where(found > 0, found, np.nan))


def _segments(keys: dict[str, str]) -> tuple[dict[int, str], dict[int, tuple[int, int, int]]]:
    """Names and colours by label, where 3D Slicer wrote them (Segment0_LabelValue, _Name, _Color)."""
    names: dict[int, str] = {}
    colours: dict[int, tuple[int, int, int]] = {}
    for key, value in keys.items():
        found = re.fullmatch(r"(Segment\d+)_LabelValue", key)
        if found is None or not re.fullmatch(r"\d{1,18}", value):
            continue
        label, segment = int(value), found[1]
        if name := keys.get(f"{segment}_Name"):
            names[label] = name
        try:
            r, g, b = (round(255 * float(part)) for part in keys[f"{segment}_Color"].split())
        except (KeyError, ValueError, OverflowError):
            continue
        if all(0 <= channel <= 255 for channel in (r, g, b)):
            colours[label] = (r, g, b)
    return names, colours


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
    spacing = scale * _field_numbers(fields, ("ElementSpacing", "ElementSize"), name, [np.nan] * n)[:3]
    check_not_negative(spacing, f"{name}: ElementSpacing of the MetaImage header")
    if len(spacing) != 3:
        raise ValueError(f"{name}: ElementSpacing must hold {n} numbers, got {len(spacing)}")
    matrix = _field_numbers(fields, ("TransformMatrix", "Rotation", "Orientation"), name, [])
    if len(matrix) == 0:
        if fields.get("AnatomicalOrientation") != "RAI":  # in the words of MetaImage, from there: LPS
            notes.append(f"the MetaImage header says no orientation: {LPS_ASSUMED}, voxel axes along L, P, S")
        matrix = np.eye(n).ravel()
    if len(matrix) != n * n:
        raise ValueError(f"{name}: TransformMatrix must hold {n * n} numbers, got {len(matrix)}")
    direction = matrix.reshape(n, n)[:3, :3].T  # its rows are the voxel axes
    origin = _field_numbers(fields, ("Offset", "Position", "Origin"), name, [])
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
    found = _field_numbers(fields, ("DimSize",), name)
    if not np.all(np.isfinite(found) & (found == np.rint(found))):
        raise ValueError(f"{name}: DimSize must hold whole numbers, got {fields['DimSize'][:100]}")
    return [int(n) for n in found]


def _field_numbers(
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
_NIFTI_TO_LPS = np.diag([-1.0, -1.0, 1.0])  # NIfTI's x and y point right and forward
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
            f"the NIfTI header says no orientation (qform and sform code 0): {LPS_ASSUMED}, voxel axes along L, P, S, from (0, 0, 0)"
        )
        return Header(shape, spacing, np.zeros(3), np.eye(3), tuple(notes))
    if not np.all(np.isfinite(origin)):
        raise ValueError(f"{name}: the origin in the NIfTI header is not finite")
    return Header(shape, spacing, _NIFTI_TO_LPS @ origin, _NIFTI_TO_LPS @ direction, tuple(notes))


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
