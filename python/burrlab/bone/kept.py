"""Half-drilled volumes: files that other programs read, each beside a file with the bone's exact state."""

import contextlib
import glob
import hashlib
import io
import json
import math
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.bone.dicom import (
    IN_FOLDER,
    KINDS,
    check_slices,
    dataset,
    dicom_files,
    holds_dicom,
    is_packed,
    short_of,
    slice_name,
    text_of,
    uid_of,
    write_slices,
)
from burrlab.bone.formats import (
    ENDINGS,
    ending_of,
    header_reader,
    keeps_labels,
    new_volume,
    read_labels,
    read_volume,
    segment_fields,
)
from burrlab.bone.header import medical
from burrlab.bone.image import (
    SLAB,
    LabelVolume,
    OccupancyMap,
    Volume,
    check_same_geometry,
    grid_of_bone,
    same_geometry,
)
from burrlab.bone.slices import ROWS_ALONG_X, SliceFiles, is_stack, pixels, read_stack, stack_slices
from burrlab.bone.snapshot import FORMAT, FORMAT_VERSION, check_tick, load_bone, open_hdf5, save_bone
from burrlab.common.check import amend_error, refuse
from burrlab.common.files import attributes, check_folder, hash_of, locked, new_folder, write_synced
from burrlab.common.progress import doing
from burrlab.common.records import UNREADABLE

KIND = "burrlab drilled volume"
_LONGEST = 255 - len(".0123456789abcdef.bone.h5.part")


def content_digest(target: Path) -> str:
    """SHA-256 of a file, or of the names and contents of a folder's slices."""
    if target.is_file():
        return hash_of(target)
    slices = (
        [Path(name) for name in dicom_files(target)[0]]
        if holds_dicom(target)
        else sorted(part for part in target.iterdir() if part.suffix.lower() == ".png")
    )
    contents = (path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest() for path in slices)
    return hashlib.sha256(b"".join(contents)).hexdigest()


def sidecar(target: Path, digest: str) -> Path:
    """Path of the exact state of a volume with this content."""
    if target.is_dir():
        return target / IN_FOLDER
    return target.with_name(f"{target.name}.{digest[:16]}.bone.h5")


def followed(target: Path) -> Path:
    """The file that a link leads to: the file is replaced, the link is not."""
    return target.resolve() if target.is_symlink() else target


def sidecars(target: Path) -> list[Path]:
    """Exact states beside a file, of its present or older contents; for a link, also beside its target."""
    return [
        path
        for place in dict.fromkeys((target, followed(target)))
        for path in sorted(place.parent.resolve().glob(f"{glob.escape(place.name)}.{'?' * 16}.bone.h5"))
    ]


def own_sidecar(target: Path) -> tuple[Path, dict[str, Any]]:
    """Path and description of the exact state of a volume's present content; errors as `load_drilled`."""
    digest = content_digest(target)
    states = [sidecar(place, digest) for place in (target, followed(target))]
    beside = next(filter(Path.is_file, states), states[-1])
    if not beside.is_file():
        problem = "there is none: was the volume moved, or is it not one that was saved half-drilled?"
        if others := ", ".join(other.name for other in sidecars(target)):
            problem = f"there is {others}, of another content of it"
        raise ValueError(f"{target}: the exact state, {beside.name}, must lie beside it, and {problem}")
    description = _description(beside)
    refuse(
        description.get("sha256") != digest,
        f"{target}: {beside.name} belongs to another content of it: one of them was changed",
    )
    return beside, description


def is_drilled(target: Path) -> bool:
    """Whether a file or folder is an unchanged half-drilled volume, as `save_drilled` wrote it."""
    try:
        own_sidecar(target)
    except (ValueError, OSError):
        return False
    return True


def _description(path: Path) -> dict[str, Any]:
    description: Any = None
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file, contextlib.suppress(*UNREADABLE):
        description = json.loads(attributes(file)["source"])
    refuse(
        not isinstance(description, dict) or description.get("kind") != KIND,
        f"{path} is a bone, but not one of a drilled volume",
    )
    return dict(description)


class Changes(NamedTuple):
    """Voxels that change, their new values, and for grey volumes the grey value of empty."""

    where: NDArray[np.bool_]
    values: NDArray[np.float64]
    empty: float | None = None


def grey_of_levels(mapping: OccupancyMap) -> NDArray[np.float64]:
    """Grey value of each level 0 to 255 by the map; for level 0, the highest grey value that is empty.

    Raises
    ------
    ValueError
        If the occupancy falls with the grey value anywhere, or no grey value is empty.
    """
    greys, occupancies = np.array(mapping.greys), np.array(mapping.occupancies)
    refuse(
        np.any(np.diff(occupancies) < 0) or occupancies[0] > 0 or occupancies[-1] == 0,
        "map must rise from 0 with the grey value, so that removed bone has a grey value, got "
        f"{mapping.text}",
    )
    levels = np.arange(256) / 255.0
    last = np.clip(np.searchsorted(occupancies, levels), int(np.argmax(occupancies > 0)), len(greys) - 1)
    low, high = occupancies[last - 1], occupancies[last]
    by_level = greys[last - 1] + np.minimum((levels - low) / (high - low), 1.0) * (
        greys[last] - greys[last - 1]
    )
    by_level[0] = greys[np.flatnonzero(occupancies == 0)[-1]]
    return np.asarray(by_level)


def changes(
    bone: VoxelBone, like: Volume | LabelVolume, mapping: OccupancyMap | None, planes: slice = slice(None)
) -> Changes:
    """New values of the voxels that lost bone, in some planes.

    A grey voxel gets the grey value of its rest; a label becomes 0 if less than half of the bone is left.
    """
    first, last, _ = planes.indices(bone.shape[0])
    box = (first, 0, 0), (last - first, *bone.shape[1:])
    density, pristine = bone.read(*box), bone.read(*box, pristine=True)
    if isinstance(like, LabelVolume):
        lost = density < pristine - pristine // 2
        return Changes(lost, np.zeros(np.count_nonzero(lost)))
    assert mapping is not None
    lost = density < pristine
    was, greys = like.values[planes][lost].astype(np.float64), grey_of_levels(mapping)
    return Changes(lost, np.minimum(greys[density[lost]], was), float(greys[0]))


def coded(
    greys: NDArray[np.float64],
    name: str,
    empty: float | None,
    kind: np.dtype[Any],
    slope: float = 1.0,
    inter: float = 0.0,
    bits: int | None = None,
) -> NDArray[Any]:
    """Stored numbers of grey values, which are slope * stored + inter.

    Whole numbers are rounded to nearest; values up to `empty` are rounded down. ValueError if a value, or
    `empty` (0 for labels), is out of range for this type with `bits` used bits.
    """
    greys = np.append(greys, empty or 0.0)
    codes, real, whole = (greys - inter) / slope, kind.kind == "f", 8 * kind.itemsize
    if not real:  # what is empty is rounded down: rounded up, it might not be empty
        down = np.floor(codes + 1e-9) if slope > 0 else np.ceil(codes - 1e-9)
        codes = np.where(greys <= (-np.inf if empty is None else empty), down, np.rint(codes))
    used, limits = bits or whole, np.finfo(kind) if real else np.iinfo(kind)
    least, most = (end if real else int(end) >> (whole - used) for end in (limits.min, limits.max))
    beyond = (codes < least) | (codes > most)
    if beyond.any():
        grey = "labels must have a 0" if empty is None else "map must have a grey value of empty"
        held = f"{kind.newbyteorder('=')}"
        if (slope, inter, used) != (1, 0, whole):
            low, high = sorted(slope * float(end) + inter for end in (least, most))
            held += f", {low:g} to {high:g}"
        raise ValueError(
            f"{grey} that {name} can hold, for removed bone: it holds {held}, got {greys[beyond][0]:g}"
        )
    return codes[:-1].astype(kind)


def changed_values(like: Volume | LabelVolume, changed: Changes, planes: slice = slice(None)) -> NDArray[Any]:
    """Values of the voxels after the changes, in their own type."""
    new = like.voxels[planes].copy()
    new[changed.where] = coded(changed.values, like.path, changed.empty, new.dtype)
    return new


def kept_fields(target: Path, like: Volume | LabelVolume) -> dict[str, str]:
    """Fields beyond the geometry in the original's file, if the new file has the same format."""
    fields, whole = dict[str, str](), False
    read_header = header_reader(like.path)
    if read_header is not None and read_header is header_reader(target.name):
        with contextlib.suppress(ValueError, OSError):  # the file may have changed or gone
            header, _ = read_header(like.path)
            fields = {key: text for key, text in header.fields.items() if text}
            whole = header.shape == like.shape and header.layers <= 1
    if keeps_labels(target.name) and isinstance(like, LabelVolume) and not whole:  # extents and layers differ
        fields = {key: text for key, text in fields.items() if not key.startswith("Segment")}
        fields |= segment_fields(like.labels, like.names, like.colours)
    return fields


#: Elements that are wrong after drilling: date and time of the instance, least and highest pixel of image and
#: series, icon, signatures, and offsets of packed pixels.
_STALE = (
    0x00080012, 0x00080013, 0x00280106, 0x00280107, 0x00280108, 0x00280109, 0x00880200, 0x4FFE0001, 0xFFFAFFFA, 0x7FE00001,
    0x7FE00002,
)  # fmt: skip
#: Transfer syntax of unpacked pixels for (implicit types, little-endian bytes).
_NOT_PACKED = {
    (True, True): "1.2.840.10008.1.2", (False, True): "1.2.840.10008.1.2.1", (False, False): "1.2.840.10008.1.2.2",
}  # fmt: skip
_DERIVATION = "burrlab: half-drilled; what was removed has the grey value of empty"


def is_whole(like: Volume | LabelVolume) -> bool:
    """Whether a volume equals its DICOM slices: not cropped, resampled or changed."""
    read = read_volume if isinstance(like, Volume) else read_labels
    try:
        whole = read(like.files, spacing=like.spacing)
    except ValueError:  # another spacing than the files'
        return False
    return same_geometry(whole, like) and np.array_equal(whole.voxels, like.voxels)


def check_series(like: Volume | LabelVolume, empty: float | None) -> None:
    """ValueError if the slices cannot be written again, or cannot hold the grey value of empty."""
    if not is_whole(like):
        with amend_error(after="; the ending of another format, as .nrrd, saves it as that"):
            check_slices(_grey(like, empty))
        return
    for _ in _derived(like, Changes(np.zeros(like.shape, bool), np.empty(0), empty)):
        pass


def _derived(like: Volume | LabelVolume, changed: Changes) -> Iterator[tuple[str, bytes]]:
    """Name and content of each slice, as a derived image of a new series (PS3.3, C.7.6.1 and C.12.1)."""
    import pydicom

    ends = np.concatenate([[0], np.cumsum(np.count_nonzero(changed.where, axis=(1, 2)))])
    series = hashlib.sha256(np.packbits(changed.where).tobytes() + changed.values.tobytes())
    for k, (name, plane) in enumerate(zip(like.files, like.voxels, strict=True)):
        attributes = dataset(name)
        source = text_of(attributes, "SOPInstanceUID")
        if k == 0:
            series.update(text_of(attributes, "SeriesInstanceUID").encode() + source.encode())
        stored, coding = _stored(attributes, plane, name)
        stored[changed.where[k]] = coded(changed.values[ends[k] : ends[k + 1]], name, changed.empty, *coding)
        content, identifier = stored.tobytes(), uid_of(series.digest() + source.encode() + b"%d" % k)
        kind = "OW" if is_packed(attributes) else attributes.get_item("PixelData").VR
        written = io.BytesIO()
        try:
            with pydicom.config.disable_value_validation(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                attributes.file_meta.TransferSyntaxUID = _NOT_PACKED[attributes.original_encoding]
                reference = pydicom.Dataset()
                reference.ReferencedSOPClassUID = text_of(attributes, "SOPClassUID")
                reference.ReferencedSOPInstanceUID = source
                attributes.ImageType = [
                    "DERIVED",
                    "SECONDARY",
                    *text_of(attributes, "ImageType").split("\\")[2:],
                ]
                attributes.SOPInstanceUID = attributes.file_meta.MediaStorageSOPInstanceUID = identifier
                attributes.SeriesInstanceUID = uid_of(series.digest())
                attributes.DerivationDescription, attributes.SourceImageSequence = _DERIVATION, [reference]
                attributes["PixelData"] = pydicom.DataElement(
                    "PixelData", kind or "OW", content + b"\0" * (len(content) % 2)
                )
                for tag in _STALE:
                    attributes.pop(tag, None)
                attributes.save_as(written, enforce_file_format=not attributes.preamble)
        except Exception:
            raise ValueError(
                f"{name}: the DICOM file cannot be taken apart, so its header cannot be kept"
            ) from None
        yield slice_name(k), written.getvalue()


def _stored(
    attributes: Any, plane: NDArray[Any], name: str
) -> tuple[NDArray[Any], tuple[np.dtype[Any], float, float, int]]:
    """Stored numbers of a slice, and their type, slope, intercept and bits for `coded`."""
    whole, used = (short_of(attributes, key) for key in ("BitsAllocated", "BitsStored"))
    refuse(
        whole not in (8, 16, 32) or not 0 < used <= whole,
        f"{name}: the DICOM file must store whole numbers of 8, 16 or 32 bits to keep its header, got "
        f"{whole} bits allocated, {used} stored",
    )
    order = "<" if attributes.original_encoding[1] else ">"
    refuse(
        whole == 8 and order == ">",
        f"{name}: 8 bits a pixel in big-endian words cannot be kept: convert the series first",
    )
    kind = np.dtype(f"{order}{'i' if short_of(attributes, 'PixelRepresentation') == 1 else 'u'}{whole // 8}")
    # `read_dicom` has read the slice: its scale is of finite numbers, and its pixels are whole.
    scale = [
        float(text_of(attributes, f"Rescale{key}") or usual)
        for key, usual in (("Slope", 1.0), ("Intercept", 0.0))
    ]
    for slope, inter in (scale, (1.0, 0.0)):  # the reader ignores the scale of some kinds of images
        if is_packed(attributes):
            stored = np.rint((plane.astype(np.float64) - inter) / slope).astype(kind)
        else:
            content = attributes.get_item("PixelData").value
            stored = np.frombuffer(content, kind, plane.size).reshape(plane.shape).copy()
        spare = whole - used  # the unused upper bits may hold anything
        again = ((stored << spare) >> spare) * slope + inter
        if np.allclose(again, plane, rtol=1e-6, atol=1e-3 * abs(slope)):
            return stored, (kind, slope, inter, used)
    raise ValueError(
        f"{name}: the pixels of the DICOM file are not the values that were read of it, so its header cannot "
        "be kept"
    )


def _grey(like: Volume | LabelVolume, empty: float | None, changed: Changes | None = None) -> Volume:
    """The volume in the smallest type of `write_dicom` that holds the original's values and that of empty.

    Grey values that resampling made fractional are rounded if the original's are whole.
    """
    voxels = like.voxels
    if isinstance(like, Volume) and voxels.dtype.kind == "f":
        original = read_volume(list(like.files))
        if original.values.dtype.kind in "iu" and not np.allclose(original.spacing, like.spacing, rtol=1e-6):
            voxels = np.rint(voxels).astype(np.int64)
            like = replace(like, values=voxels)
    least, most = min(float(voxels.min()), math.floor(empty or 0.0)), float(voxels.max())
    fits = [
        kind for kind in map(np.dtype, KINDS) if np.iinfo(kind).min <= least and most <= np.iinfo(kind).max
    ]
    kind = fits[0] if fits and voxels.dtype.kind in "iu" else voxels.dtype
    voxels = voxels if changed is None else changed_values(like, changed)
    return Volume(voxels.astype(kind), like.spacing, like.origin, like.direction, like.path)


def _drawn(slices: SliceFiles, like: Volume | LabelVolume, changed: Changes) -> Iterator[tuple[str, bytes]]:
    """Name and content of each slice after the changes, with the original's size and kind.

    Changed voxels of coloured slices are transparent, or black where the kind has no transparency.
    """
    from PIL import Image

    new = changed_values(like, changed) if isinstance(like, Volume) else None
    turn = (1, 0) if ROWS_ALONG_X in like.notes else (0, 1)
    for k, path in enumerate(slices.paths):
        image, written = pixels(path).copy(), io.BytesIO()
        if new is None:
            image[changed.where[k].transpose(turn)] = 0
            image[image[..., 3] == 0] = 0  # RGB has no transparency: black says that they are empty
        else:
            channels = image[..., None] if image.ndim == 2 else image
            channels[..., :3] = new[k].transpose(turn)[..., None]
        picture = Image.fromarray(image[..., :3] if slices.kind == "RGB" else image)
        picture.save(written, format="PNG", compress_level=3)
        yield path.name, written.getvalue()
    if Path(like.path).is_file():  # the YAML file of the original, with the slices beside it
        import yaml

        content = yaml.safe_load(Path(like.path).read_text(encoding="utf-8"))
        (named,) = (name for name in content if str(name).startswith("VOLUME "))  # as in read_description
        content[named]["images"]["path"] = "./"
        yield Path(like.path).name, yaml.safe_dump(content, sort_keys=False, allow_unicode=True).encode()


def check_drilled(
    target: Path, like: Volume | LabelVolume, mapping: OccupancyMap | None = None
) -> SliceFiles | None:
    """Slices to be written, if `save_drilled` will write a stack; raises its errors that need no bone."""
    target = followed(target)
    check_folder(target)
    refuse(
        Path(like.path).exists()
        and target.exists()
        and target.samefile(like.path)
        and not is_drilled(target),
        f"path must be another file than the original {like.path}",
    )
    refuse(
        isinstance(like, LabelVolume) and mapping is not None,
        f"mapping must be given for grey values only, and {like.path} holds labels",
    )
    refuse(
        isinstance(like, Volume) and mapping is None,
        f"mapping must be given: that with which the bone was made of {like.path}",
    )
    empty = None if mapping is None else float(grey_of_levels(mapping)[0])
    if empty is not None:
        coded(np.empty(0), like.path, empty, like.voxels.dtype)
    series = is_series(target, like)
    slices = None if series or target.name.lower().endswith(ENDINGS) else stack_slices(like.path)
    if not series and slices is None:
        ending_of(target, f"{', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}")
        refuse(
            (size := len(os.fsencode(target.name))) > _LONGEST,
            f"path must have a name of at most {_LONGEST} bytes, for the exact state to be named after it, "
            f"got {size}",
        )
        medical("SimpleITK", "writing volumes")
        refuse(
            target.exists() and not is_drilled(target),
            f"path must be a new file or one of save_drilled, {target} is neither",
            FileExistsError,
        )
        return None
    refuse(
        series and target.suffix.lower() in (".dcm", ".dicom", ".ima"),
        f"path must be a new folder for a DICOM series, and not one file, got {target}",
    )
    refuse(target.exists(), f"path must be a new folder, {target} is there", FileExistsError)
    if slices is None:
        check_series(like, empty)
        return None
    sides = (slices.columns, slices.rows) if ROWS_ALONG_X in like.notes else (slices.rows, slices.columns)
    refuse(
        (shape := (len(slices.paths), *sides)) != like.shape,
        f"{like.path}: a stack must be whole to be saved as one, {shape} voxels, got {like.shape}",
    )
    return slices


def is_series(target: Path, like: Volume | LabelVolume) -> bool:
    """Whether the volume is saved as a folder of DICOM slices."""
    return bool(like.files) and not target.name.lower().endswith(ENDINGS)


def check_original(bone: VoxelBone, like: Volume | LabelVolume) -> None:
    """ValueError if `like` is itself half-drilled and has less than the bone."""
    try:
        beside, _ = own_sidecar(Path(like.path))
    except (ValueError, OSError):
        return
    before, _ = load_bone(beside)
    if before.shape == bone.shape and (more := int(np.count_nonzero(bone.density > before.density))):
        raise ValueError(
            f"like must be the original: {like.path} is half-drilled, and {more} voxels of it have less than "
            "the bone"
        )


@dataclass(frozen=True, eq=False)
class DrilledVolume:
    """A half-drilled bone in its saved state.

    Attributes
    ----------
    bone : VoxelBone
        Present and pristine levels, and tissues, with the digest of the bone that was saved.
    tick : int
        Ticks executed on the bone so far.
    mapping : OccupancyMap or None
        Map of grey values; None for labels.
    source : str
        Volume that the bone was made from.
    path : str
        The half-drilled volume itself.
    transpose : bool
        How slices are read; see `read_stack`.
    """

    bone: VoxelBone
    tick: int
    mapping: OccupancyMap | None
    source: str
    path: str
    transpose: bool = False

    def volume(self) -> Volume | LabelVolume:
        """The volume as other programs read it, on the bone's voxels: `like` of the next `save_drilled`."""
        if is_stack(self.path):
            return read_stack(
                self.path, spacing=self.bone.spacing, palette=None if self.mapping else self.bone.tissues, unknown="nearest",
                transpose=self.transpose,
            )  # fmt: skip
        read = read_labels if self.mapping is None else read_volume
        return read(self.path, spacing=self.bone.spacing)


@doing("writing a half-drilled volume")
def save_drilled(
    path: str | os.PathLike[str],
    bone: VoxelBone,
    like: Volume | LabelVolume,
    *,
    mapping: OccupancyMap | None = None,
    tick: int = 0,
) -> None:
    """Writes a volume without the removed bone, and beside it a file with the bone's exact state.

    Parameters
    ----------
    path : path-like
        Ends in .nrrd (.seg.nrrd), .nii, .nii.gz or .mha; the original's ending keeps its fields. For a stack
        of PNG slices or a DICOM series, a new folder.
    bone : VoxelBone
        On the voxels of `like`.
    like : Volume or LabelVolume
        Volume that the bone was made from: grey values, or labels alone.
    mapping : OccupancyMap, optional
        Map that made the bone from grey values; occupancy must not fall with them.
    tick : int
        Ticks executed on the bone so far.

    Raises
    ------
    ValueError
        If bone and volume have different voxels; if the map is missing, is given for labels, falls, or has a
        grey value of empty that the file cannot store; if the path is the original's, has another ending or
        too long a name; if the tick is out of range; if the data set of a slice cannot be kept; or if `like`
        is itself half-drilled and has less bone than `bone`.
    ImportError
        Without SimpleITK; for a DICOM series also without pydicom (extra `medical`).
    FileExistsError
        If the name is taken by another file.
    FileNotFoundError
        If the folder of the path, or the original stack or series, is missing.
    OSError
        If the files cannot be written.

    Notes
    -----
    Voxels that lost nothing keep their value to the bit, except in a resampled DICOM series, whose slices
    hold whole numbers. Other voxels get the grey value of their rest by the map, and never a higher one than
    before; an empty voxel gets the grey value of empty. With labels alone, a voxel with less than half of its
    bone gets label 0.

    The file is written as by `write_volume`, with the original's fields beyond its geometry: keys and values
    of NRRD, the description of NIfTI, further fields of MetaImage. DICOM slices are derived images of a new
    series in the same study: UIDs, image type and derivation are new, all else that still holds is copied.

    Beside `NAME` lies the bone, `NAME.<digest>.bone.h5` (in a folder, `bone.h5`), as `save_bone` writes it.
    The bone is written first, under the digest of its volume: after an interruption the old pair or the new
    one is whole.

    Examples
    --------
    >>> import burrlab, numpy as np, tempfile
    >>> from burrlab.volume import OccupancyMap, Volume, load_drilled
    >>> folder, mapping = tempfile.TemporaryDirectory(), OccupancyMap.two_point(0, 1000)
    >>> path = folder.name + "/drilled.nrrd"
    >>> ct = Volume(np.full((20, 20, 20), 1000, np.int16), np.full(3, 0.2), np.zeros(3), np.eye(3), "a cube")
    >>> bone = ct.to_bone(mapping)
    >>> save_drilled(path, bone, ct, mapping=mapping)
    >>> load_drilled(path).bone.digest() == bone.digest()
    True
    >>> folder.cleanup()
    """
    target = followed(Path(path))
    check_tick(tick)
    slices = check_drilled(target, like, mapping)
    check_same_geometry(grid_of_bone(bone, like), like)
    check_original(bone, like)
    description = {
        "kind": KIND,
        "source": like.path,
        "map": None if mapping is None else mapping.text,
        "transpose": ROWS_ALONG_X in like.notes,
    }

    def beside(where: Path, digest: str) -> None:
        save_bone(where, bone, tick, source=json.dumps({**description, "sha256": digest}))

    if slices is not None or is_series(target, like):
        changed = changes(bone, like, mapping)
        with new_folder(target) as part:
            if slices is None and not is_whole(like):
                write_slices(part, _grey(like, changed.empty, changed))
            else:
                written_slices = _derived(like, changed) if slices is None else _drawn(slices, like, changed)
                for name, content in written_slices:
                    write_synced(part / name, content)
            beside(part / IN_FOLDER, content_digest(part))
        return
    original = like

    def planes(part: slice) -> NDArray[Any]:  # no copy of a large volume
        return changed_values(original, changes(bone, original, mapping, part), part)

    if isinstance(like, LabelVolume):  # the table fills in names and colours that the file lacks
        names, colours = ({t.label: getattr(t, of) for t in bone.tissues or ()} for of in ("name", "colour"))
        new = np.empty_like(like.labels)
        for k in range(0, len(new), SLAB):
            new[k : k + SLAB] = planes(slice(k, k + SLAB))
        like = replace(like, labels=new, names=names | like.names, colours=colours | like.colours)
    with locked(target.parent):  # another process may write the same pair
        with new_volume(target, like, kept_fields(target, like), planes=planes) as part:
            digest = content_digest(part)
            state = sidecar(target, digest)
            before = [other for other in sidecars(target) if other.name != state.name]
            beside(state, digest)
        for other in before:  # the file is replaced: the new pair counts
            other.unlink(missing_ok=True)


@doing("reading a half-drilled volume")
def load_drilled(path: str | os.PathLike[str]) -> DrilledVolume:
    """The bone of a volume that `save_drilled` wrote, in its exact state.

    Raises
    ------
    FileNotFoundError
        If there is no such file or folder.
    ValueError
        If the file of the exact state is missing, or belongs to another content of the volume.

    Examples
    --------
    >>> from burrlab.volume import load_drilled
    >>> drilled = load_drilled("drilled.nrrd")  # doctest: +SKIP
    >>> drilled.bone.removed  # doctest: +SKIP
    """
    target = Path(path)
    refuse(not target.exists(), f"{target}: no such file or folder", FileNotFoundError)
    beside, description = own_sidecar(target)
    bone, tick = load_bone(beside)
    mapping = None if description.get("map") is None else OccupancyMap.parse(str(description["map"]))
    return DrilledVolume(
        bone, tick, mapping, str(description.get("source", "")), os.fspath(path), bool(description.get("transpose"))
    )  # fmt: skip
