"""Reads and writes volume files: the registry of formats, values, and segments of 3D Slicer."""

import contextlib
import gzip
import itertools
import locale
import math
import os
import re
import struct
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from burrlab.bone.dicom import dicom_files, holds_dicom, is_dicom, read_dicom
from burrlab.bone.header import (
    LPS_ASSUMED,
    Header,
    Storage,
    itk_image,
    medical,
    meta_header,
    nifti_header,
    nrrd_header,
    numbers_in,
    plain_name,
    settled_spacing,
    three_sizes,
)
from burrlab.bone.image import SLAB, Colour, LabelVolume, Volume, checked_direction
from burrlab.common.check import amend_error, check_memory, first_bytes, refuse, shown
from burrlab.common.files import new_file, write_synced
from burrlab.common.progress import doing

#: What reads the header of a file, and where its values lie, from its name.
HeaderReader = Callable[[str], tuple[Header, Storage]]
#: Kinds of volume files, and the endings of the files that can be read.
FORMATS: dict[HeaderReader, tuple[str, ...]] = {
    nrrd_header: (".nrrd", ".nhdr"),
    meta_header: (".mha", ".mhd"),
    nifti_header: (".nii", ".nii.gz", ".hdr", ".img"),
}
#: Endings of the files that SimpleITK writes.
ENDINGS = (".nrrd", ".nii", ".nii.gz", ".mha")


def header_reader(name: str) -> HeaderReader | None:
    """What reads the header of files with this ending; None if nothing does."""
    return next((read for read, endings in FORMATS.items() if name.lower().endswith(endings)), None)


def keeps_labels(name: str) -> bool:
    """Whether the format of a file's ending has fields for names and colours of labels."""
    return header_reader(name) is nrrd_header


#: A file, a folder of DICOM slices, or the files of the slices.
VolumePath = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


def read_volume(
    path: VolumePath, *, spacing: float | ArrayLike | None = None, series: str | None = None
) -> Volume:
    """Reads a grey volume: NRRD, NIfTI, MetaImage or a DICOM series.

    Parameters
    ----------
    path : path, or sequence of paths
        A file, a folder with a DICOM series, or the files of a series in any order.
    spacing : float or (x, y, z), optional
        Voxel spacing if the file has none [mm].
    series : str, optional
        SeriesInstanceUID, if a folder holds more than one.

    Returns
    -------
    Volume
        In patient coordinates, LPS [mm]. Its `notes` say if the orientation was assumed.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ImportError
        Without SimpleITK (extra `medical`), for DICOM.
    ValueError
        If the file is damaged or cut short, needs more memory than the machine has, or is not a
        three-dimensional volume of one finite value a voxel; if its spacing is missing and not given, or
        differs from the given one; if its direction matrix is not orthonormal; or if slices are missing,
        doubled, uneven, sheared, different or of several series.

    Examples
    --------
    >>> import burrlab, numpy as np, tempfile
    >>> ct = burrlab.Volume(np.zeros((4, 5, 6)), np.array([0.3, 0.3, 0.5]), np.zeros(3), np.eye(3), "a phantom")
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = folder.name + "/ct.nrrd"
    >>> burrlab.write_volume(path, ct)
    >>> read_volume(path).shape
    (4, 5, 6)
    >>> folder.cleanup()
    """
    name, header, values = _read(path, spacing, series)
    return Volume(
        values, settled_spacing(header, spacing, name), header.origin, header.direction, name, header.notes, header.files
    )  # fmt: skip


def read_labels(
    path: VolumePath, *, spacing: float | ArrayLike | None = None, series: str | None = None
) -> LabelVolume:
    """Reads a label volume, with the formats and parameters of `read_volume`.

    Returns
    -------
    LabelVolume
        With the names and colours in the header of a segmentation by 3D Slicer (.seg.nrrd).

    Raises
    ------
    FileNotFoundError, ImportError
        As `read_volume`.
    ValueError
        As `read_volume`; or if a value is not a whole number, segments overlap or share a label, or a field of a
        segment cannot be read.

    Examples
    --------
    >>> import burrlab, numpy as np, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = folder.name + "/labels.nrrd"
    >>> labels = burrlab.LabelVolume(np.zeros((4, 5, 6), np.uint8), np.full(3, 0.3), np.zeros(3), np.eye(3), "a cube")
    >>> burrlab.write_volume(path, labels)
    >>> read_labels(path).spacing.tolist()
    [0.3, 0.3, 0.3]
    >>> folder.cleanup()
    """
    name, header, values = _read(path, spacing, series, most=2**31)
    notes = header.notes
    with amend_error(f"{name}: "):
        segments = segments_of(header.fields, layers=header.layers)
        if header.layers > 1:
            values, names, colours, more = merged(values, segments)
            notes += more
        else:
            parts = [part for _, part in sorted(_parts(header.fields).items())]
            names = {s.label: s.name for s, part in zip(segments, parts, strict=True) if part.get("Name")}
            colours = {s.label: s.colour for s in segments if s.colour}
    return LabelVolume(
        values, settled_spacing(header, spacing, name), header.origin, header.direction, name, names, colours, notes,
        header.files,
    )  # fmt: skip


@doing("reading a volume")
def _read(
    path: VolumePath, spacing: float | ArrayLike | None, series: str | None, most: int = 1
) -> tuple[str, Header, NDArray[Any]]:
    """Name, header and values of a volume of at most `most` layers."""
    single = isinstance(path, str | os.PathLike)
    refuse(
        not isinstance(path, str | os.PathLike | Iterable),
        f"path must be a path or a list of paths, got {shown(path)}",
        TypeError,
    )
    names = [os.fspath(part) for part in ([path] if isinstance(path, str | os.PathLike) else path)]
    refuse(not names, "path must name a file, got an empty list")
    name = names[0]
    if single and Path(name).is_dir():
        files, others = dicom_files(name, below=not holds_dicom(name))
        return name, *read_dicom(files, name, series, others)
    for part in names:
        refuse(not Path(part).is_file(), f"{part}: no such file", FileNotFoundError)
    if not single:
        name = f"{len(names)} files in {os.path.commonpath([os.path.dirname(part) or '.' for part in names]) or '.'}"
    if not single or is_dicom(name):
        return name, *read_dicom(names, name, series)
    refuse(series is not None, f"series goes with DICOM, got {name}")
    return name, *_read_file(name, spacing, most)


def _read_file(name: str, spacing: float | ArrayLike | None, most: int) -> tuple[Header, NDArray[Any]]:
    """Header and values of a file that is no DICOM."""
    read_header = header_reader(name)
    if read_header is None:
        raise ValueError(
            f"{name}: cannot be read as a volume: it must be a folder of DICOM slices or end in one of "
            f"{', '.join(ending for endings in FORMATS.values() for ending in endings)}"
        )
    header, layout = read_header(name)
    if any(header.fields.get(key, "").startswith(LPS_ASSUMED) for key in (_ASSUMED, _NIFTI_NOTES)):
        note = f"{name} was written from a file that says no orientation: {LPS_ASSUMED}"
        header = replace(header, notes=(*header.notes, note))
    checked_direction(header.direction, name)
    settled_spacing(header, spacing, name)
    if header.layers > most:
        three_sizes([header.layers, *header.shape[::-1]], name)
    shape = (*header.shape, header.layers) if header.layers > 1 else header.shape
    return header, _read_values(layout, shape, name)


def _read_values(at: Storage, shape: tuple[int, ...], name: str) -> NDArray[Any]:
    """Values in the byte order of this machine; ValueError if they are cut short."""
    size = math.prod(shape) * at.kind.itemsize
    part, left = divmod(size, len(at.files))
    refuse(left, f"{name}: the values must be in files of one size, got {len(at.files)} for {size} bytes")
    if len(at.files) == 1:
        data = _bytes(at, at.files[0], size, name)
    else:
        check_memory(2 * size, f"{name}: the volume")
        data = np.concatenate([_bytes(at, path, part, name) for path in at.files])
    refuse(len(data) < size, f"{name}: the file is cut short: {len(data)} bytes of values, of {size}")
    stored = np.require(data[:size].view(at.kind).reshape(shape), at.kind.newbyteorder("="), "A")
    if (at.slope, at.inter) == (1.0, 0.0):
        return stored
    values = np.empty(shape, np.result_type(stored.dtype, np.float32))
    with np.errstate(over="ignore", invalid="ignore"):  # `Volume` refuses what is not finite with its place
        for k, plane in enumerate(stored):  # plane by plane: no copies of a large volume
            values[k] = plane * np.float64(at.slope) + np.float64(at.inter)
    return values


def _bytes(at: Storage, path: Path, size: int, name: str) -> NDArray[np.uint8]:
    """Bytes of one file of values; fewer than `size` if the file is cut short."""
    refuse(not path.is_file(), f"{name}: the file of its values, {path.name}, is not there")
    with path.open("rb") as file:
        file.seek(at.start)
        for _ in range(min(at.lines, path.stat().st_size)):
            while (part := file.readline(1 << 20)) and not part.endswith(b"\n"):
                pass
        begin = file.tell()
        left = os.fstat(file.fileno()).st_size - begin
        if at.encoding == "gzip":
            data, _ = first_bytes(file, at.skip + size, True, name)
            used = file.tell() - begin
            refuse(
                at.packed_size
                and not (re.fullmatch(r"\d{1,18}", at.packed_size) and used <= int(at.packed_size) <= left),
                f"{name}: CompressedDataSize of the MetaImage header must be {used}, got {at.packed_size}",
            )
            return data[at.skip :]
        file.seek(max(left - size, 0) if at.skip < 0 else min(at.skip, max(left, 0)), os.SEEK_CUR)
        if at.encoding == "raw":
            return first_bytes(file, size, False, name)[0]
        text = file.read(64 * size // at.kind.itemsize)
    before = f"{name}: the values are cut short, or not the numbers of the header ("
    with amend_error(before, ")", (ValueError, DeprecationWarning)), warnings.catch_warnings():
        warnings.simplefilter("error")
        if at.encoding == "hex":
            return np.frombuffer(bytes.fromhex(text.decode("latin-1")), np.uint8)
        wide = np.dtype(np.int64) if at.kind.kind in "iu" and at.kind.itemsize < 8 else at.kind
        stored = np.fromstring(text.replace(b",", b" "), wide, sep=" ")
        count, numbers = size // at.kind.itemsize, stored.astype(at.kind)
        refuse(len(stored) > count, f"{len(stored)} numbers stand for {count}")
        refuse(at.kind.kind in "iu" and (numbers != stored).any(), f"one is beyond {at.kind}")
        return numbers.view(np.uint8)


@doing("writing a volume")
def write_volume(
    path: str | os.PathLike[str], volume: Volume | LabelVolume, *, compress: bool = True
) -> None:
    """Writes a volume or labels with their geometry.

    A file of the same name is replaced when the new one is complete and on disk.

    Parameters
    ----------
    path : path
        Its ending sets the format: .nrrd, .nii, .nii.gz or .mha.
    volume : Volume or LabelVolume
    compress : bool
        Whether the values of .nrrd and .mha are compressed; for NIfTI the ending decides.

    Raises
    ------
    ValueError
        If the ending is not one of these, or the format cannot hold the values.
    ImportError
        Without SimpleITK (extra `medical`).
    OSError
        If the file cannot be written.

    Notes
    -----
    NIfTI keeps geometry in float32: spacing, origin and direction are restored to 1e-7 of their size. Names
    and colours of labels go into NRRD only, in the fields of a segmentation of 3D Slicer, without label 0.

    Examples
    --------
    >>> import burrlab, numpy as np, tempfile
    >>> ct = burrlab.Volume(np.zeros((4, 5, 6)), np.array([0.3, 0.3, 0.5]), np.zeros(3), np.eye(3), "a phantom")
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = folder.name + "/ct.nrrd"
    >>> write_volume(path, ct)
    >>> burrlab.read_volume(path).spacing.round(3).tolist()
    [0.3, 0.3, 0.5]
    >>> folder.cleanup()
    """
    target = Path(path)
    fields: Mapping[str, str] = {}
    if keeps_labels(target.name) and isinstance(volume, LabelVolume):
        fields = segment_fields(volume.labels, volume.names, volume.colours)
    with new_volume(target, volume, fields, compress=compress):
        pass


#: Places in a written file for "LPS assumed": a field of NRRD and MetaImage, the description of NIfTI.
_ASSUMED, _NIFTI_NOTES = "burrlab_orientation", "ITK_FileNotes"


def ending_of(target: Path, endings: str) -> str:
    """Ending of a path, one of `ENDINGS`; ValueError, which names the endings `endings`, for another."""
    ending = next((e for e in ENDINGS if target.name.lower().endswith(e)), "")
    refuse(not ending, f"path must end in {endings}, got {target}")
    return ending


@contextlib.contextmanager
def new_volume(
    target: Path,
    volume: Volume | LabelVolume,
    fields: Mapping[str, str],
    *,
    compress: bool = True,
    planes: Callable[[slice], NDArray[Any]] | None = None,
) -> Iterator[Path]:
    """A new file, complete and on disk, that replaces the target at the end; errors as `write_volume`.

    `planes` returns the values of some planes, where they are not the volume's.
    """
    ending = ending_of(target, f"one of {', '.join(ENDINGS)}")
    if any(LPS_ASSUMED in note for note in volume.notes):  # the new file says so too
        key = _NIFTI_NOTES if ending.startswith(".nii") else _ASSUMED
        known = fields.get(key, "").removeprefix(LPS_ASSUMED).strip()
        fields = {**fields, key: f"{LPS_ASSUMED} {known}".strip()[:79]}
    plain_name(str(target))
    values = volume.voxels
    kind, find = values.dtype.newbyteorder("="), planes or values.__getitem__
    packed = ending == ".nii.gz" or (compress and ending != ".nii")
    with new_file(target, ending) as part:
        write_synced(part, bytes(1 << 16))  # ITK does not say that the disk is full
        try:
            head = _head(part, volume, fields, kind, packed)
        except (RuntimeError, TypeError, KeyError, ValueError, struct.error) as error:
            raise ValueError(f"{target}: values of {kind} cannot be written as {ending}") from error
        slabs = (np.ascontiguousarray(find(slice(k, k + SLAB)), kind) for k in range(0, len(values), SLAB))
        contents: Iterator[Any] = slabs
        if packed:
            middle = np.ascontiguousarray(find(slice(len(values) // 2, len(values) // 2 + 1)), kind)
            contents, head = _packed(head, slabs, middle, ending)
        with part.open("wb") as file:
            begin = file.write(head)
            file.writelines(contents)
            size_line = b"CompressedDataSize = %018d" % (file.tell() - begin)
            file.seek(0)
            file.write(re.sub(rb"(?m)^CompressedDataSize = \d+$", size_line, head, count=1))
        yield part


def _head(
    part: Path, volume: Volume | LabelVolume, fields: Mapping[str, str], kind: np.dtype[Any], packed: bool
) -> bytes:
    """What stands before the values: as ITK writes it for few voxels, with the volume's sizes."""
    image = itk_image(np.zeros((2, 2, 2), kind), volume, volume.origin, fields)
    before = locale.setlocale(locale.LC_NUMERIC)
    locale.setlocale(locale.LC_NUMERIC, "C")  # NRRD headers are written by the system's printf
    try:
        medical("SimpleITK", "writing volumes").WriteImage(image, str(part), useCompression=packed)
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)
    content, sizes = part.read_bytes(), volume.shape[::-1]
    if part.name.endswith((".nii", ".nii.gz")):
        head = (gzip.decompress(content) if packed else content)[: -8 * kind.itemsize]
        return head[:42] + struct.pack("=3h", *sizes) + head[48:]
    mark = b"ElementDataFile = LOCAL\n" if part.suffix == ".mha" else b"\n\n"
    head = content[: content.index(mark) + len(mark)]
    head = re.sub(rb"(?m)^CompressedDataSize = \d+$", b"CompressedDataSize = %018d" % 0, head)
    return re.sub(rb"(?m)^(sizes:|DimSize =) \d+ \d+ \d+$", rb"\1 %d %d %d" % sizes, head, count=1)


def _packed(
    head: bytes, slabs: Iterator[NDArray[Any]], sample: NDArray[Any], ending: str
) -> tuple[Iterator[Any], bytes]:
    """Packed slabs, and what stands before them. Runs alone take half the time, and make noise no larger."""

    def pack(pieces: Iterable[Any], strategy: int) -> Iterator[bytes]:
        packer = zlib.compressobj(1, wbits=15 if ending == ".mha" else 31, memLevel=9, strategy=strategy)
        yield from map(packer.compress, pieces)
        yield packer.flush()

    runs, matches = (sum(map(len, pack([sample], way))) for way in (zlib.Z_RLE, zlib.Z_DEFAULT_STRATEGY))
    way = zlib.Z_RLE if runs < 2 * matches else zlib.Z_DEFAULT_STRATEGY
    inside, before = (head, b"") if ending == ".nii.gz" else (b"", head)
    return pack(itertools.chain([inside], slabs), way), before


@dataclass(frozen=True)
class Segment:
    """One structure of a segmentation.

    Attributes
    ----------
    name : str
    label : int
        Value of its voxels in its layer.
    layer : int
    colour : (r, g, b) or None
        From 0 to 255.
    """

    name: str
    label: int
    layer: int
    colour: Colour | None


def segments_of(fields: Mapping[str, str], *, layers: int = 1) -> list[Segment]:
    """Segments that the fields of a header describe; an empty list if there are none.

    Parameters
    ----------
    fields : mapping of str to str
        For example Segment0_Name, Segment0_LabelValue, Segment0_Layer, Segment0_Color (three, from 0 to 1).
    layers : int
        Volumes in the file. Older files have no LabelValue and Layer: the label is 1, with a layer a segment.

    Raises
    ------
    ValueError
        If the format does not allow a field's value, or two segments share a label in one layer.

    Notes
    -----
    Source of the format: 3D Slicer's developer guide, "Segmentation labelmap file format (.seg.nrrd)".
    """
    segments = [
        Segment(
            parts.get("Name", parts.get("ID", f"segment {i}")),
            _whole(f"Segment{i}_LabelValue", parts.get("LabelValue", "1"), 2**31 - 1),
            _whole(f"Segment{i}_Layer", parts.get("Layer", str(i) if layers > 1 else "0"), layers - 1),
            _colour(f"Segment{i}_Color", parts.get("Color")),
        )
        for i, parts in sorted(_parts(fields).items())
    ]
    places: dict[tuple[int, int], Segment] = {}
    for segment in segments:
        other = places.setdefault((segment.layer, segment.label), segment)
        refuse(
            other is not segment and (layers > 1 or other.name != segment.name),
            f"segments must differ in label or layer, {other.name!r} and {segment.name!r} do not",
        )
    return segments


def _parts(fields: Mapping[str, str]) -> dict[int, dict[str, str]]:
    """Fields of each segment by its number."""
    segments: dict[int, dict[str, str]] = {}
    for key, value in fields.items():
        if match := re.fullmatch(r"Segment(\d+)_(Name|ID|LabelValue|Layer|Color)", key, flags=re.ASCII):
            segments.setdefault(int(match[1]), {})[match[2]] = value
    return segments


def segment_fields(
    labels: NDArray[Any], names: Mapping[int, str], colours: Mapping[int, Colour]
) -> dict[str, str]:
    """Fields that `segments_of` reads, for labels (z, y, x) of one layer. Label 0 is no segment."""
    described = sorted({*names, *colours} - {0})
    if not described:
        return {}
    boxes = scipy.ndimage.find_objects(labels, max((n for n in described if n < 1 << 16), default=1))
    fields = {
        "Segmentation_ContainedRepresentationNames": "Binary labelmap|",
        "Segmentation_SourceRepresentation": "Binary labelmap", "Segmentation_ReferenceImageExtentOffset": "0 0 0",
    }  # fmt: skip
    for i, label in enumerate(described):
        far = scipy.ndimage.find_objects((labels == label).view(np.uint8)) if label >= 1 << 16 else []
        box = next(iter(far or boxes[label - 1 : label]), None) or (slice(0, 0),) * 3
        fields |= {
            f"Segment{i}_ID": f"Segment_{label}", f"Segment{i}_LabelValue": str(label), f"Segment{i}_Layer": "0",
            f"Segment{i}_Extent": " ".join(f"{along.start} {along.stop - 1}" for along in box[::-1]),
        }  # fmt: skip
        if label in names:
            fields[f"Segment{i}_Name"] = names[label]
        if label in colours:
            fields[f"Segment{i}_Color"] = " ".join(f"{channel / 255:.6g}" for channel in colours[label])
    return fields


def merged(
    values: NDArray[Any], segments: list[Segment]
) -> tuple[NDArray[Any], dict[int, str], dict[int, Colour], tuple[str, ...]]:
    """Labels (z, y, x), names, colours and notes of segments in layers.

    Parameters
    ----------
    values : ndarray, shape (z, y, x, layers)
    segments : list of Segment

    Raises
    ------
    ValueError
        If segments overlap: a voxel has only one label.
    """
    notes: tuple[str, ...] = ()
    numbers = [segment.label for segment in segments]
    if len(set(numbers)) < len(numbers):
        numbers = list(range(1, len(segments) + 1))
        notes = (
            f"labels are renumbered, 1 to {len(numbers)} in the order of the segments: layers repeat them",
        )
    labels = np.zeros(values.shape[:3], np.uint8 if max(numbers, default=0) < 256 else np.int32)
    for label, segment in zip(numbers, segments, strict=True):
        here = values[..., segment.layer] == segment.label
        twice = here & (labels != 0)
        if twice.any():
            first = tuple(int(i) for i in np.argwhere(twice)[0])
            other = segments[numbers.index(int(labels[first]))]
            raise ValueError(
                f"segments must not overlap, {other.name!r} and {segment.name!r} share voxels, "
                f"{np.count_nonzero(twice)} in all, the first at (z, y, x) = "
                f"{first}: export the segmentation as a label map"
            )
        labels[here] = label
    pairs = list(zip(numbers, segments, strict=True))
    colours = {label: segment.colour for label, segment in pairs if segment.colour is not None}
    return labels, {label: segment.name for label, segment in pairs}, colours, notes


def _whole(key: str, text: str, most: int) -> int:
    text = text.strip()
    refuse(
        not (text.isascii() and text.isdecimal() and int(text) <= most),
        f"{key} must be a whole number from 0 to {most}, got {text!r}",
    )
    return int(text)


def _colour(key: str, text: str | None) -> Colour | None:
    if text is None:
        return None
    rule = f"{key} must be three numbers from 0 to 1, got {text!r}"
    channels = numbers_in(text, rule)
    refuse(len(channels) != 3 or not np.all((channels >= 0) & (channels <= 1)), rule)
    red, green, blue = (round(255 * float(channel)) for channel in channels)
    return red, green, blue
