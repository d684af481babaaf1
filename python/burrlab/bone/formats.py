"""Grey values as a file's numbers.

The segments of a segmentation of 3D Slicer (.seg.nrrd): names, colours, and layers made one volume.

Reading volumes and labels: NRRD, NIfTI, MetaImage, and DICOM series (those by SimpleITK, extra `medical`).

Writing volumes and labels: NRRD, NIfTI, MetaImage.

The values of a volume file as it stores them, and the file again with others: its header stays as it is.
"""

from __future__ import annotations

import gzip
import math
import os
import re
import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

import burrlab.bone.header as nifti
from burrlab.bone.dicom import dicom_files, is_dicom, read_dicom
from burrlab.bone.header import (
    Header,
    meta_fields,
    nrrd_fields,
    plain_name,
    read_meta_header,
    read_nifti,
    read_nrrd_header,
    segment_layers,
    settled_spacing,
    three_sizes,
)
from burrlab.bone.image import LabelVolume, Volume, checked_direction
from burrlab.common.check import check_memory, first_bytes, shown
from burrlab.common.files import check_folder, new_part


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


Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Segment:
    """One structure.

    Attributes
    ----------
    name : str
    label : int
        Its value in its layer.
    layer : int
    colour : (r, g, b) or None
        0 to 255.
    """

    name: str
    label: int
    layer: int
    colour: Colour | None


def segments_of(fields: Mapping[str, str], *, layers: int = 1) -> list[Segment]:
    """The segments that the fields of a header describe; none in a header of another kind.

    Parameters
    ----------
    fields : mapping of str to str
        As Segment0_Name, Segment0_LabelValue, Segment0_Layer, Segment0_Color (0 to 1, three numbers).
    layers : int
        Volumes in the file. Files of older versions have no LabelValue and Layer: 1, and one layer a segment.

    Raises
    ------
    ValueError
        If a field is none of what the format says, or two segments share a label.

    Notes
    -----
    The format is that of 3D Slicer's developer guide, "Segmentation labelmap file format (.seg.nrrd)".
    """
    found: dict[int, dict[str, str]] = {}
    for key, value in fields.items():
        match = re.fullmatch(r"Segment(\d+)_(Name|ID|LabelValue|Layer|Color)", key, flags=re.ASCII)
        if match:
            found.setdefault(int(match[1]), {})[match[2]] = value
    segments = []
    for i, parts in sorted(found.items()):
        name = parts.get("Name", parts.get("ID", f"segment {i}"))
        label = _whole(f"Segment{i}_LabelValue", parts.get("LabelValue", "1"), 2**31 - 1)
        layer = _whole(f"Segment{i}_Layer", parts.get("Layer", str(i) if layers > 1 else "0"), layers - 1)
        segments.append(Segment(name, label, layer, _colour(f"Segment{i}_Color", parts.get("Color"))))
    places: dict[tuple[int, int], str] = {}
    for segment in segments:
        place = (segment.layer, segment.label)
        if place in places:
            raise ValueError(
                f"segments must differ in label or layer, {places[place]!r} and {segment.name!r} do not"
            )
        places[place] = segment.name
    return segments


def segment_fields(
    labels: NDArray[Any], names: Mapping[int, str], colours: Mapping[int, Colour]
) -> dict[str, str]:
    """The fields that `segments_of` reads, of one layer (z, y, x); none of label 0, which is no segment."""
    described = sorted({*names, *colours} - {0})
    if not described:
        return {}
    boxes = ndimage.find_objects(labels, max((n for n in described if n < 1 << 16), default=1))
    fields = {
        "Segmentation_ContainedRepresentationNames": "Binary labelmap|",
        "Segmentation_SourceRepresentation": "Binary labelmap", "Segmentation_ReferenceImageExtentOffset": "0 0 0",
    }  # fmt: skip
    for i, label in enumerate(described):
        far = ndimage.find_objects((labels == label).view(np.uint8)) if label >= 1 << 16 else []
        box = next(iter(far or boxes[label - 1 : label]), None)
        ends = [(0, -1)] * 3 if box is None else [(along.start, along.stop - 1) for along in box[::-1]]
        fields |= {
            f"Segment{i}_ID": f"Segment_{label}", f"Segment{i}_LabelValue": str(label), f"Segment{i}_Layer": "0",
            f"Segment{i}_Extent": " ".join(f"{low} {high}" for low, high in ends),
        }  # fmt: skip
        if label in names:
            fields[f"Segment{i}_Name"] = names[label]
        if label in colours:
            fields[f"Segment{i}_Color"] = " ".join(f"{channel / 255:.6g}" for channel in colours[label])
    return fields


def merged(
    values: NDArray[Any], segments: list[Segment]
) -> tuple[NDArray[Any], dict[int, str], dict[int, Colour], tuple[str, ...]]:
    """Labels (z, y, x) of segments in one or several layers, names, colours and notes.

    Parameters
    ----------
    values : ndarray, shape (z, y, x) or (z, y, x, layers)
    segments : list of Segment

    Raises
    ------
    ValueError
        If segments overlap: a voxel has one label.
    """
    notes: tuple[str, ...] = ()
    own = [segment.label for segment in segments]
    if values.ndim == 3:
        labels = values
    else:
        if len(set(own)) < len(own):
            own = list(range(1, len(segments) + 1))
            notes = (
                f"labels are renumbered, 1 to {len(own)} in the order of the segments: layers repeat them",
            )
        labels = np.zeros(values.shape[:3], np.uint8 if max(own, default=0) < 256 else np.int32)
        for label, segment in zip(own, segments, strict=True):
            here = values[..., segment.layer] == segment.label
            twice = here & (labels != 0)
            if twice.any():
                first = tuple(int(i) for i in np.argwhere(twice)[0])
                other = segments[own.index(int(labels[first]))].name
                raise ValueError(
                    f"segments must not overlap, {other!r} and {segment.name!r} share voxels, {np.count_nonzero(twice)} in all, the "
                    f"first at (z, y, x) = {first}: export the segmentation as a label map"
                )
            labels[here] = label
    names = {label: segment.name for label, segment in zip(own, segments, strict=True)}
    colours = {
        label: segment.colour
        for label, segment in zip(own, segments, strict=True)
        if segment.colour is not None
    }
    return labels, names, colours, notes


def _whole(key: str, text: str, most: int) -> int:
    text = text.strip()
    if not (text.isascii() and text.isdecimal() and int(text) <= most):
        raise ValueError(f"{key} must be a whole number from 0 to {most}, got {text!r}")
    return int(text)


def _colour(key: str, text: str | None) -> Colour | None:
    if text is None:
        return None
    try:
        red, green, blue = (float(part) for part in text.split())
    except ValueError:
        red = green = blue = -1.0
    if not all(0.0 <= part <= 1.0 for part in (red, green, blue)):
        raise ValueError(f"{key} must be three numbers from 0 to 1, got {text!r}")
    return round(255 * red), round(255 * green), round(255 * blue)


#: A file, a folder of DICOM slices, or the slices.
VolumePath = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_NIFTI = (".nii", ".nii.gz", ".hdr", ".img")
_HEADERS = {
    ".nrrd": read_nrrd_header,
    ".nhdr": read_nrrd_header,
    ".mha": read_meta_header,
    ".mhd": read_meta_header,
}


def read_volume(
    path: VolumePath, *, spacing: float | ArrayLike | None = None, series: str | None = None
) -> Volume:
    """Reads a grey volume: NRRD, NIfTI, MetaImage, a DICOM series.

    Parameters
    ----------
    path : path, or sequence of paths
        A file; a folder with a DICOM series; or the files of one, in any order.
    spacing : float or (x, y, z), optional
        Voxel spacing where the file has none [mm].
    series : str, optional
        SeriesInstanceUID, where a folder holds more than one.

    Returns
    -------
    Volume
        In patient coordinates, LPS [mm]. Its `notes` say what was assumed: an orientation that the file does not have.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ImportError
        Without SimpleITK (extra `medical`), for DICOM.
    ValueError
        If the file cannot be read whole, says more than it holds or the machine has memory for, is not a three-dimensional volume of one finite value a voxel, does not say its spacing
        and none is given, or says another; if its direction matrix is not orthonormal; or if slices are missing, doubled,
        uneven, sheared or not alike, or of several series.
    """
    name, header, values = _read(path, spacing, series)
    return Volume(
        values, settled_spacing(header, spacing, name), header.origin, header.direction, name, header.notes, header.files
    )  # fmt: skip


def read_labels(
    path: VolumePath, *, spacing: float | ArrayLike | None = None, series: str | None = None
) -> LabelVolume:
    """Reads a label volume: the formats, parameters and errors of `read_volume`.

    Returns
    -------
    LabelVolume
        With the names and colours that the header of a segmentation by 3D Slicer (.seg.nrrd) has.

    Raises
    ------
    FileNotFoundError, ImportError
        As `read_volume`.
    ValueError
        As `read_volume`; or if a value is not whole, or segments overlap.
    """
    if isinstance(path, str | os.PathLike) and os.fspath(path).lower().endswith((".nrrd", ".nhdr")):
        _check_there(os.fspath(path))
        layers, fields = segment_layers(os.fspath(path))
        if layers > 1:
            return _layered(os.fspath(path), layers, fields, spacing)
    name, header, values = _read(path, spacing, series)
    return LabelVolume(
        values, settled_spacing(header, spacing, name), header.origin, header.direction, name, header.names,
        header.colours, header.notes, header.files,
    )  # fmt: skip


def _layered(
    name: str, layers: int, fields: dict[str, str], spacing: float | ArrayLike | None
) -> LabelVolume:
    """A segmentation whose segments lie in several layers."""
    header = read_nrrd_header(name, layers=True)
    checked_direction(header.direction, name)
    try:
        values = read_values(name, (*header.shape, layers))
        labels, names, colours, notes = merged(values, segments_of(fields, layers=layers))
    except ValueError as error:
        raise error if str(error).startswith(name) else ValueError(f"{name}: {error}") from None
    return LabelVolume(
        labels, settled_spacing(header, spacing, name), header.origin, header.direction, name, names, colours,
        (*header.notes, *notes),
    )  # fmt: skip


def _read(
    path: VolumePath, spacing: float | ArrayLike | None, series: str | None
) -> tuple[str, Header, NDArray[Any]]:
    if not isinstance(path, str | os.PathLike):
        names = [os.fspath(part) for part in path]
        if not names:
            raise ValueError("path must name a file, got an empty list")
        for name in names:
            _check_there(name)
        _check_simpleitk()
        where = (
            f"{len(names)} files in {os.path.commonpath([os.path.dirname(n) or '.' for n in names]) or '.'}"
        )
        return where, *read_dicom(names, where, series)
    name = os.fspath(path)
    if Path(name).is_dir():
        _check_simpleitk()
        files, others = dicom_files(name)
        return name, *read_dicom(files, name, series, others)
    _check_there(name)
    if is_dicom(name):
        _check_simpleitk()
        return name, *read_dicom([name], name, series)
    if series is not None:
        raise ValueError(f"series goes with DICOM, got {name}")
    if name.lower().endswith(_NIFTI):
        return name, *read_nifti(name)
    read_header = _HEADERS.get(Path(name).suffix.lower())
    if read_header is None:
        raise ValueError(
            f"{name}: cannot be read as a volume: it must be a folder of DICOM slices or end in one of "
            f"{', '.join([*_HEADERS, *_NIFTI])}"
        )
    header = read_header(plain_name(name))
    checked_direction(header.direction, name)
    settled_spacing(header, spacing, name)
    return name, header, read_values(name, header.shape)


def _check_there(name: str) -> None:
    if not Path(name).is_file():
        raise FileNotFoundError(f"{name}: no such file")


def _check_simpleitk() -> None:
    try:
        import SimpleITK  # noqa: F401
    except ImportError as error:
        raise ImportError("reading DICOM needs SimpleITK: pip install 'burrlab[medical]'") from error


_ENDINGS = (".nrrd", ".nii", ".nii.gz", ".mha")


def write_volume(
    path: str | os.PathLike[str], volume: Volume | LabelVolume, *, compress: bool = True
) -> None:
    """Writes a volume or labels with their geometry; a file of that name is replaced once the new one is whole.

    Parameters
    ----------
    path : path
        Its ending says the format: .nrrd, .nii, .nii.gz, .mha.
    volume : Volume or LabelVolume
    compress : bool
        The values of .nrrd and .mha; the endings of NIfTI say it themselves.

    Raises
    ------
    ValueError
        If the ending is another, or the format cannot hold the values.
    ImportError
        Without SimpleITK (extra `medical`).
    OSError
        If the file cannot be written.

    Notes
    -----
    NIfTI keeps geometry in float32, so spacing, origin and direction come back to 1e-7 of their size. Names and colours of
    labels are written to NRRD, in the fields of a segmentation of 3D Slicer; NIfTI and MetaImage have no place for them, and label
    0 is none of its segments.
    """
    target = Path(path)
    ending = next(
        (e for e in sorted(_ENDINGS, key=len, reverse=True) if target.name.lower().endswith(e)), None
    )
    if ending is None:
        raise ValueError(f"path must end in one of {', '.join(_ENDINGS)}, got {os.fspath(path)}")
    try:
        import SimpleITK as sitk
    except ImportError as error:
        raise ImportError("writing volumes needs SimpleITK: pip install 'burrlab[medical]'") from error
    plain_name(str(target))
    check_folder(target)
    values = volume.values if isinstance(volume, Volume) else volume.labels
    try:
        image = sitk.GetImageFromArray(np.ascontiguousarray(values))
        image.SetSpacing(volume.spacing.tolist())
        image.SetOrigin(volume.origin.tolist())
        image.SetDirection(volume.direction.ravel().tolist())
        if ending == ".nrrd" and isinstance(volume, LabelVolume):
            for key, text in segment_fields(volume.labels, volume.names, volume.colours).items():
                image.SetMetaData(key, text)
        with new_part(target, ending) as part:
            sitk.WriteImage(image, str(part), useCompression=compress and not ending.startswith(".nii"))
            with part.open("rb") as written:
                os.fsync(written.fileno())
            part.replace(target)
    except (RuntimeError, TypeError, KeyError) as error:
        raise ValueError(
            f"{os.fspath(path)}: values of {values.dtype} cannot be written as {ending}"
        ) from error


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

    return Stored(_whole_array(data, at.kind, shape, name), Coding(at.kind), pack)


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
    values = _whole_array(data, at.kind, shape, name)
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


def _whole_array(
    data: NDArray[np.uint8], kind: np.dtype[Any], shape: tuple[int, ...], name: str
) -> NDArray[Any]:
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

    return Stored(_whole_array(data, coding.kind, shape, name), coding, pack)


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
