"""DICOM series: read if their slices make one regular grid, and written as CT slices from grey volumes.

Slices are sorted by position. pydicom reads the headers, SimpleITK (GDCM) the pixels. Tags follow DICOM
PS3.3; UIDs have the form 2.25.<UUID> of PS3.5, annex B.2.
"""

import contextlib
import ctypes
import errno
import functools
import hashlib
import io
import math
import os
import re
import threading
import uuid
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.bone.header import Header, itk_image, medical, plain_name
from burrlab.bone.image import Array, Volume, checked_direction, point_text
from burrlab.common.check import DEFLATE, check_memory, refuse
from burrlab.common.files import check_folder, new_folder
from burrlab.common.progress import doing
from burrlab.common.records import in_one_line

#: Relative difference allowed between the distances of slices: headers are rounded.
EVEN = 1e-2
#: Sideways shift allowed from the first slice to any other [pixels]; more is a gantry tilt.
STRAIGHT = 0.1
#: How far an orientation rounded to four digits may be from orthonormal: 4 sqrt(3) of half a digit, rounded up.
_FOUR_DIGITS = 4e-4
# Bits of a pixel in a JPEG frame header (SOF), and the transfer syntaxes of JPEG.
_PRECISION = re.compile(rb"\xff[\xc0-\xc3\xc5-\xc7\xc9-\xcb\xcd-\xcf]\0[\x0b\x0e\x11\x14](.)", re.DOTALL)
_JPEG = ("1.2.840.10008.1.2.4.5", "1.2.840.10008.1.2.4.70")
#: Name of the file that keeps the exact state of a half-drilled volume in a folder of slices.
IN_FOLDER = "bone.h5"
#: Types of values that can be written.
KINDS = ("uint8", "int16", "uint16")
_CT_IMAGE = "1.2.840.10008.5.1.4.1.1.2"
_DEFLATED = b"1.2.840.10008.1.2.1.99"  # its transfer syntax
#: Size to which any file may unpack [bytes] (ours): equal pixels compress to almost nothing.
_SMALL = 1 << 26
# Columns and rows in the headers of JPEG 2000 (marker SIZ) and JPEG-LS (SOF), with one value a pixel.
_CODED = re.compile(rb"\xff\x4f\xff\x51.{4}(.{4})(.{4})|\xff\xf7\0\x0b[\x02-\x10](..)(..)\x01", re.DOTALL)
_OPEN = 0xFFFFFFFF  # the length of compressed pixels
#: Items of sequences in a slice (ours): GDCM goes down into nested ones until its stack is full.
_MOST_ITEMS = 5000
_ONE_LISTENS = threading.Lock()


class _Slice:
    """Header of one file; spacing is NaN where the header has none."""

    def __init__(self, name: str) -> None:
        attributes = dataset(plain_name(name))

        def numbers(keyword: str, count: int) -> tuple[float, ...]:
            try:
                values = tuple(float(part) for part in text_of(attributes, keyword).split("\\"))
            except ValueError:
                values = ()
            return values if len(values) == count and np.all(np.isfinite(values)) else (np.nan,) * count

        def whole(keyword: str) -> int | None:
            text = text_of(attributes, keyword)
            return int(text) if re.fullmatch(r"[+-]?[0-9]{1,12}", text) else None

        rows, columns, self.bits, values = (
            short_of(attributes, keyword)
            for keyword in ("Rows", "Columns", "BitsAllocated", "SamplesPerPixel")
        )
        refuse(
            min(rows, columns, self.bits) < 1,
            f"{name}: cannot be read as a DICOM image: it is cut short, damaged, or holds no image",
        )
        refuse(
            (whole("NumberOfFrames") or 1) > 1,
            f"{name}: DICOM files of several frames are not read: convert it to NRRD or NIfTI",
        )
        for keyword in ("RescaleSlope", "RescaleIntercept"):
            (factor,) = numbers(keyword, 1)
            refuse(
                text_of(attributes, keyword)
                and (np.isnan(factor) or (keyword == "RescaleSlope" and factor == 0)),
                f"{name}: {keyword} must be a number, of a slope not 0, got {text_of(attributes, keyword)}",
            )
        stored, highest = (short_of(attributes, keyword) for keyword in ("BitsStored", "HighBit"))
        refuse(
            "ModalityLUTSequence" in attributes or stored > self.bits or highest not in (-1, stored - 1),
            f"{name}: grey values by a table (Modality LUT), of more bits than are allocated, or not in the lowest bits, "
            "are not read",
        )
        shades = text_of(attributes, "PhotometricInterpretation")
        refuse(
            abs(values) != 1 or shades not in ("MONOCHROME2", ""),
            f"{name}: a volume needs three dimensions and one value a voxel, got a {shades} image of "
            f"{abs(values)} values",
        )
        self.name, self.file = name, Path(name).name
        self.series, self.size = text_of(attributes, "SeriesInstanceUID"), (columns, rows)
        self.byte_count = columns * rows * self.bits // 8  # of the pixels
        # between columns, between rows: the header has them the other way round
        self.spacing = tuple(s if s > 0 else np.nan for s in numbers("PixelSpacing", 2)[::-1])
        self.position = np.array(numbers("ImagePositionPatient", 3))
        self.turn = numbers("ImageOrientationPatient", 6)  # along a row, then along a column
        refuse(
            np.any(np.isnan(self.position)) or np.any(np.isnan(self.turn)),
            f"{name}: the DICOM header does not say the slice's position and orientation",
        )
        self.number, self.images = whole("InstanceNumber"), whole("ImagesInAcquisition")
        self.scan = {
            key: text_of(attributes, key) for key in ("PatientID", "FrameOfReferenceUID", "ConvolutionKernel")
        }


def read_dicom(
    names: Sequence[str], where: str, series: str | None, others: Sequence[str] = ()
) -> tuple[Header, NDArray[Any]]:
    """Header and values (z, y, x) of the files of one series; ValueError if they make no volume.

    `others` are the other files of the folder; a note names them.
    """
    for library in ("SimpleITK", "pydicom"):
        medical(library, "reading DICOM")
    # others of the folder, such as a report or a capture, need not be readable
    chosen = [name for name in names if series in (None, series_of(name))] or names
    slices = _of_series([_Slice(name) for name in chosen], where, series)
    _check_alike(slices, where)
    turn = np.reshape(slices[0].turn, (2, 3))
    direction = checked_direction(np.column_stack([*turn, np.cross(*turn)]), where, _FOUR_DIGITS)
    slices.sort(key=lambda s: float(s.position @ direction[:, 2]))
    apart = _distance(slices, np.array([s.position @ direction[:, 2] for s in slices]), where)
    _check_straight(slices, direction, where)
    check_memory(2 * len(slices) * slices[0].byte_count, f"{where}: the volume")
    values = np.stack([_values(s) for s in slices])
    return Header(
        values.shape, np.array([*slices[0].spacing, apart]), slices[0].position, direction, _notes(slices, others),
        files=tuple(s.name for s in slices),
    ), values  # fmt: skip


def _notes(slices: list[_Slice], others: Sequence[str]) -> tuple[str, ...]:
    """Notes on slices that may be missing, or of several scans, at regular positions, and on files left out."""
    numbers = {s.number for s in slices if s.number is not None}
    low, high = min(numbers, default=0), max(numbers, default=0)
    absent = high - low + 1 - len(numbers)
    stated_count = max(s.images or 0 for s in slices)
    mixed = [key for key in slices[0].scan if len({s.scan[key] for s in slices}) > 1]
    first = ", ".join(others[:3]) + (", ..." if len(others) > 3 else "")
    notes = {
        f"the slices are numbered {low} to {high}, of which {absent} are absent: slices may be missing": (
            len(numbers) == len(slices) and absent > 0
        ),
        f"the DICOM headers count {stated_count} images in the acquisition, {len(slices)} are there: slices may be "
        "missing": stated_count > len(slices),
        f"the slices differ in {', '.join(mixed)}: they may be of several scans": bool(mixed),
        f"{len(others)} file{'s' * (len(others) > 1)} of the folder left out, as no DICOM: {first}": bool(
            others
        ),
    }
    return tuple(note for note, due in notes.items() if due)


def dicom_files(folder: str | os.PathLike[str], *, below: bool = False) -> tuple[list[str], list[str]]:
    """DICOM files of a folder, or with `below` of its subfolders too, sorted by name; names of the other files.

    A DICOM file has DICM at byte 128, or ends in .dcm or .dicom. The index (DICOMDIR) is in neither list.
    """
    paths = {
        path for path in (Path(folder).rglob("*") if below else Path(folder).iterdir())
        if path.is_file() and path.name.upper() != "DICOMDIR" and not path.name.startswith("._")
    }  # fmt: skip
    slices = {path for path in paths if is_dicom(str(path)) or path.suffix.lower() in (".dcm", ".dicom")}
    refuse(not slices, f"{os.fspath(folder)}: the folder holds no DICOM files")
    others = (path.name for path in sorted(paths - slices) if not path.name.startswith("."))
    return list(map(str, sorted(slices))), [name for name in others if name != IN_FOLDER]


def holds_dicom(folder: str | os.PathLike[str]) -> bool:
    """Whether a folder itself holds DICOM files."""
    try:
        return bool(dicom_files(folder)[0])
    except ValueError:
        return False


def is_dicom(name: str) -> bool:
    """Whether a file has DICM at byte 128."""
    with open(name, "rb") as file:
        return file.read(132)[128:] == b"DICM"


def dataset(name: str) -> Any:
    """A slice as pydicom reads it, with its elements as stored; ValueError if it has no pixels."""
    import pydicom

    check_memory(2.0 * os.path.getsize(name), f"{name}: the file")
    content = Path(name).read_bytes()
    if _DEFLATED in content[:1024]:  # pydicom and GDCM inflate all of the data
        stream = zlib.decompressobj(-zlib.MAX_WBITS)
        with contextlib.suppress(zlib.error):  # the data follow the file meta information
            stream.decompress(content[144 + int.from_bytes(content[140:144], "little") :], _SMALL)
        refuse(stream.unconsumed_tail, f"{name}: the deflated data must be of at most {_SMALL} bytes")
    items = content.count(b"\xfe\xff\x00\xe0") + content.count(b"\xff\xfe\xe0\x00")
    refuse(
        items > _MOST_ITEMS,
        f"{name}: a slice must have at most {_MOST_ITEMS} items of sequences, got {items}",
    )
    with contextlib.suppress(Exception), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        attributes: Any = pydicom.dcmread(io.BytesIO(content), force=True)
        raw = [element for element in map(attributes.get_item, attributes.keys()) if element.is_raw]
        # GDCM allocates the length that an element states.
        if all(element.length in (_OPEN, len(element.value or b"")) for element in raw) and isinstance(
            attributes.get_item("PixelData").value, bytes
        ):
            return attributes
    raise ValueError(f"{name}: cannot be read as a DICOM image: it is cut short, damaged, or holds no image")


def series_of(name: str) -> str | None:
    """The series of a file, whatever else it holds; None if it does not say."""
    import pydicom

    with contextlib.suppress(Exception), warnings.catch_warnings(), open(plain_name(name), "rb") as file:
        warnings.simplefilter("ignore")
        if _DEFLATED not in file.read(1024):
            return text_of(
                pydicom.dcmread(
                    name, stop_before_pixels=True, specific_tags=["SeriesInstanceUID"], force=True
                ),
                "SeriesInstanceUID",
            )
    return None


def text_of(attributes: Any, keyword: str) -> str:
    """Text of an element as stored; empty if there is no such element."""
    value = attributes.get_item(keyword).value if keyword in attributes else b""
    return in_one_line(value.decode("latin-1").strip(" \0")) if isinstance(value, bytes) else ""


def short_of(attributes: Any, keyword: str) -> int:
    """The single whole number of an element (US); -1 if there is no such element."""
    value = attributes.get_item(keyword).value if keyword in attributes else b""
    order: Any = "little" if attributes.original_encoding[1] else "big"
    return int.from_bytes(value, order) if isinstance(value, bytes) and len(value) == 2 else -1


def is_packed(attributes: Any) -> bool:
    """Whether the pixels are compressed."""
    return bool(attributes.get_item("PixelData").length == _OPEN)


def _of_series(slices: list[_Slice], where: str, series: str | None) -> list[_Slice]:
    counts = Counter(s.series for s in slices)
    choices = ", ".join(f"{uid} ({count} files)" for uid, count in sorted(counts.items()))
    refuse(
        series is None and len(counts) > 1,
        f"{where}: series must say which of {len(counts)} DICOM series: {choices}",
    )
    refuse(
        series is not None and series not in counts, f"{where}: series must be one of {choices}, got {series}"
    )
    return [s for s in slices if series in (None, s.series)]


def _check_alike(slices: list[_Slice], where: str) -> None:
    first = slices[0]
    for other in slices[1:]:
        for what, a, b in (
            ("sizes", first.size, other.size),
            ("pixel spacings", first.spacing, other.spacing),
            ("orientations", first.turn, other.turn),
        ):
            refuse(
                not np.allclose(a, b, rtol=1e-5, atol=1e-4 if what == "orientations" else 0, equal_nan=True),
                f"{where}: the slices have different {what}: {point_text(a)} in {first.file}, "
                f"{point_text(b)} in {other.file}",
            )


def _distance(slices: list[_Slice], along: Array, where: str) -> float:
    """Distance between neighbouring slices, which must be even [mm]; NaN for a single slice."""
    steps = np.diff(along)
    if len(steps) == 0:
        return np.nan
    usual = float(np.sort(steps)[(len(steps) - 1) // 2])
    twins = steps < 0.01 * max(usual, 1e-3)
    k = int(np.argmax(twins))
    refuse(
        twins[k],
        f"{where}: two slices lie at the same position, {along[k]:g} mm along the normal: {slices[k].file} and "
        f"{slices[k + 1].file}",
    )

    def gap(k: int, others: float) -> str:
        return (
            f"{steps[k]:g} mm between slices {k} and {k + 1} ({slices[k].file} at {along[k]:g} mm, "
            f"{slices[k + 1].file} at {along[k + 1]:g} mm), where others are {others:g} mm apart"
        )

    least = float(steps.min())
    times = np.rint(steps / least)
    if times.max() > 1 and np.all(np.abs(steps - times * least) <= 2 * EVEN * least * times):
        lost, first = int((times - 1).sum()), int(np.flatnonzero(times > 1)[0])
        raise ValueError(
            f"{where}: {lost} slice{'s are' if lost > 1 else ' is'} missing: {gap(first, least)}"
        )
    odd = np.abs(steps - usual) > EVEN * usual
    refuse(odd.any(), f"{where}: the slices are not evenly spaced: {gap(int(np.argmax(odd)), usual)}")
    return float((along[-1] - along[0]) / len(steps))


def _check_straight(slices: list[_Slice], direction: Array, where: str) -> None:
    ways = np.array([s.position - slices[0].position for s in slices])
    along = ways @ direction[:, 2]
    shifts = np.linalg.norm(ways - along[:, None] * direction[:, 2], axis=1)
    k = int(np.argmax(shifts))
    pixel = float(np.nanmin(slices[0].spacing)) if np.any(np.isfinite(slices[0].spacing)) else 1.0
    tilt = math.degrees(math.atan2(shifts[k], abs(along[k])))
    refuse(
        shifts[k] > STRAIGHT * pixel,
        f"{where}: the slices are sheared, by a gantry tilt of {tilt:.3g} degrees: {shifts[k]:.3g} mm sideways from "
        f"{slices[0].file} to {slices[k].file}; sheared volumes are not supported",
    )


def _check_whole(part: _Slice) -> None:
    """ValueError if the pixel data are shorter than rows times columns: GDCM would fill in the rest."""
    attributes, wanted = dataset(part.name), part.byte_count
    content = attributes.get_item("PixelData").value
    refuse(  # before a decoder allocates memory
        wanted > max(DEFLATE * len(content), _SMALL),
        f"{part.name}: the pixel data is cut short: {len(content)} bytes cannot hold {wanted}",
    )
    if str(attributes.file_meta.get("TransferSyntaxUID", "")).startswith(_JPEG):
        most = max((bits[0] for bits in _PRECISION.findall(content)), default=0)
        refuse(
            most > part.bits,  # a decoder would write beyond its memory
            f"{part.name}: the compressed pixels must have at most {part.bits} bits, got {most}",
        )
    for sizes in _CODED.findall(content):  # a decoder allocates these sizes
        coded = math.prod(int.from_bytes(size) for size in sizes if size)
        refuse(
            coded > max(part.size[0] * part.size[1], _SMALL // 4),
            f"{part.name}: the compressed pixels must be of the header's size, got {coded} of them",
        )
    refuse(
        not is_packed(attributes) and len(content) < wanted,
        f"{part.name}: the pixel data is cut short: {len(content)} bytes of {wanted}",
    )


def _values(part: _Slice) -> NDArray[Any]:
    sitk = medical("SimpleITK", "reading DICOM")
    _check_whole(part)
    try:
        with _listening(part.name):
            values = np.asarray(sitk.GetArrayFromImage(sitk.ReadImage(part.name, imageIO="GDCMImageIO")))
    except RuntimeError:
        values = np.empty(0)
    refuse(
        values.size != math.prod(part.size), f"{part.name}: the pixel data of the slice cannot be read whole"
    )
    return values.reshape(part.size[::-1])


@contextlib.contextmanager
def _listening(name: str) -> Iterator[None]:
    """ValueError with the text that codecs print on C's `stderr`: many report damage nowhere else.

    File descriptor 2 stays in place: nothing that other threads write is lost.
    """
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "gnu_get_libc_version"):  # other C libraries make `stderr` a constant
        yield
        return
    stderr, (memory, text, size) = ctypes.c_void_p.in_dll(libc, "stderr"), _memory()
    with _ONE_LISTENS:
        libc.rewind(memory)
        before, stderr.value = stderr.value, memory.value
        try:
            yield
        finally:
            stderr.value = before
            libc.fflush(memory)
            message = ctypes.string_at(text, size.value) if size.value else b""
    first = "".join(message.decode("utf-8", "replace").splitlines()[:1])
    refuse(message, f"{name}: the pixel data of the slice is damaged ({first[:200]})")


@functools.cache
def _memory() -> tuple[ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]:
    """A C stream in memory that is never closed, its text, and the text's size."""
    text, size = ctypes.c_void_p(), ctypes.c_size_t()
    opened = ctypes.CDLL(None).open_memstream
    opened.restype = ctypes.c_void_p
    return ctypes.c_void_p(opened(ctypes.byref(text), ctypes.byref(size))), text, size


@doing("writing slices")
def write_dicom(folder: str | os.PathLike[str], volume: Volume) -> None:
    """Writes a series of CT slices into a new folder, which appears when it is complete.

    Parameters
    ----------
    folder : path-like
        A new folder. Its files are slice0001.dcm and so on, along the third voxel axis.
    volume : Volume
        Of uint8, int16 or uint16; right-handed.

    Raises
    ------
    ValueError
        If the values are of another type, or the direction is left-handed.
    FileExistsError
        If the name is taken.
    FileNotFoundError
        If the parent folder does not exist.
    ImportError
        Without SimpleITK (extra `medical`).
    OSError
        If a file cannot be written.

    Notes
    -----
    Patient and study are empty; the image type is DERIVED. The same volume gets the same UIDs. Numbers have
    up to 16 characters, so the geometry is restored to 1e-11 mm.

    Examples
    --------
    >>> import burrlab, numpy as np, tempfile
    >>> from burrlab.volume import Volume, write_dicom
    >>> folder = tempfile.TemporaryDirectory()
    >>> ct = Volume(np.full((20, 20, 20), 1000, np.int16), np.full(3, 0.2), np.zeros(3), np.eye(3), "a cube")
    >>> write_dicom(folder.name + "/ct", ct)
    >>> bool((burrlab.read_volume(folder.name + "/ct").values == ct.values).all())
    True
    >>> folder.cleanup()
    """
    target = Path(folder)
    check_slices(volume)
    refuse(target.exists(), f"folder must be new, {target} is there", FileExistsError)
    check_folder(target)
    plain_name(str(target))
    with new_folder(target) as part:
        write_slices(part, volume)


def check_slices(volume: Volume) -> None:
    """ValueError if a volume cannot be written as DICOM; ImportError without SimpleITK."""
    refuse(
        volume.values.dtype.name not in KINDS,
        f"values must be one of {', '.join(KINDS)} to be written as DICOM, got {volume.values.dtype}",
    )
    refuse(
        np.linalg.det(volume.direction) < 0,
        "direction must be right-handed to be written as DICOM, got a left-handed one",
    )
    medical("SimpleITK", "writing volumes")


def write_slices(folder: Path, volume: Volume) -> None:
    """Writes the slices into an existing folder; OSError if they cannot be written."""
    content = hashlib.sha256(np.ascontiguousarray(volume.values).tobytes())
    for place in (volume.spacing, volume.origin, volume.direction):
        content.update(place.tobytes())
    shared = {
        "0008|0008": "DERIVED\\SECONDARY",
        "0008|0016": _CT_IMAGE,
        "0008|0060": "CT",
        "0018|0050": f"{volume.spacing[2]:.10g}",
        "0020|000d": uid_of(content.digest() + b"study"),
        "0020|000e": uid_of(content.digest() + b"series"),
        "0020|0052": uid_of(content.digest() + b"frame"),
    }
    writer = medical("SimpleITK", "writing volumes").ImageFileWriter()
    writer.SetImageIO("GDCMImageIO")
    writer.KeepOriginalImageUIDOn()
    try:
        for k, pixels in enumerate(volume.values):
            tags = {**shared, "0008|0018": uid_of(content.digest() + b"%d" % k), "0020|0013": str(k + 1)}
            origin = volume.origin + volume.patient_point((0, 0, k * volume.spacing[2]))
            writer.SetFileName(str(folder / slice_name(k)))
            writer.Execute(itk_image(np.ascontiguousarray(pixels[None]), volume, origin, tags))
    except RuntimeError as error:
        raise OSError(
            errno.EIO, "the slices cannot be written (is the disk full?)", os.fspath(folder)
        ) from error


def slice_name(k: int) -> str:
    """File name of slice k, counted from 0."""
    return f"slice{k + 1:04d}.dcm"


def uid_of(content: bytes) -> str:
    """UID made of the hash of the content."""
    return f"2.25.{uuid.UUID(bytes=hashlib.sha256(content).digest()[:16]).int}"
