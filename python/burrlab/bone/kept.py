"""The two files of a half-drilled volume: the volume itself, and beside it the exact state of its bone.

What a half-drilled volume's voxels hold, and the bytes of its file.

Half-drilled volumes as DICOM series: derived images, each under the header of the slice that it was made of.

Tags after DICOM PS3.3: General Image (C.7.6.1), Image Pixel (C.7.6.3), SOP Common (C.12.1).

Half-drilled volumes as stacks of PNG slices.

What is looked at before a half-drilled volume is saved.

Half-drilled volumes: saved in the format of the original, for other programs, and reloaded exactly.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.bone.dicom import (
    IN_FOLDER,
    KINDS,
    PIXELS,
    Elements,
    check_slices,
    dicom_files,
    elements_of,
    encoded,
    holds_dicom,
    padded,
    slice_name,
    uid_of,
    write_slices,
)
from burrlab.bone.formats import (
    ENDINGS,
    Coding,
    can_keep_header,
    check_stored,
    read_labels,
    read_stored,
    read_volume,
    write_volume,
)
from burrlab.bone.header import segment_layers
from burrlab.bone.image import LabelVolume, OccupancyMap, Volume, same_geometry
from burrlab.bone.slices import (
    ROWS_ALONG_X,
    Slices,
    find_slices,
    is_stack,
    pixels,
    read_description,
    read_stack,
)
from burrlab.bone.snapshot import FORMAT, FORMAT_VERSION, check_tick, load_bone, open_hdf5, save_bone
from burrlab.common.files import attributes, check_folder, new_folder, new_part, write_synced
from burrlab.common.records import UNREADABLE

if TYPE_CHECKING:
    from PIL import Image


KIND = "burrlab drilled volume"
_LONGEST = 255 - len(".0123456789abcdef.bone.h5.part")


def content_digest(target: Path) -> str:
    """SHA-256 of a file, or of the names and contents of a folder's slices."""
    if target.is_file():
        return hashlib.sha256(target.read_bytes()).hexdigest()
    digest = hashlib.sha256()
    if holds_dicom(target):
        slices = [Path(name) for name in dicom_files(target)[0]]
    else:
        slices = sorted(part for part in target.iterdir() if part.suffix.lower() == ".png")
    for path in slices:
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def sidecar(target: Path, digest: str) -> Path:
    """Where the exact state of a volume of this content lies."""
    if target.is_dir():
        return target / IN_FOLDER
    return target.with_name(f"{target.name}.{digest[:16]}.bone.h5")


def check_name(target: Path) -> None:
    """ValueError where a file's name leaves no room for that of the exact state beside it."""
    if (size := len(os.fsencode(target.name))) > _LONGEST:
        raise ValueError(
            f"path must have a name of at most {_LONGEST} bytes, for the exact state to be named after it, got {size}"
        )


def followed(target: Path) -> Path:
    """Where a link leads: its file is replaced, and not the link."""
    return target.resolve() if target.is_symlink() else target


def sidecars(target: Path) -> list[Path]:
    """Those that are there, of whatever content of the volume; of a link, beside it and where it leads."""
    if target.is_dir():
        return [target / IN_FOLDER] if (target / IN_FOLDER).is_file() else []
    return [beside for place in dict.fromkeys((target, followed(target))) for beside in _named(place)]


def _named(target: Path) -> list[Path]:
    head, tail = f"{target.name}.", ".bone.h5"
    folder = target.parent.resolve()
    if not folder.is_dir():
        return []
    return sorted(
        path
        for path in folder.iterdir()
        if path.name.startswith(head)
        and path.name.endswith(tail)
        and len(path.name) == len(head) + 16 + len(tail)
    )


def own_sidecar(target: Path) -> tuple[Path, dict[str, Any]]:
    """The exact state that belongs to what a volume holds now, and what it says of itself; errors as `load_drilled`."""
    digest = content_digest(target)
    beside = sidecar(target, digest)
    if not beside.is_file() and (there := sidecar(followed(target), digest)).is_file():
        beside = there
    if not beside.is_file():
        others = ", ".join(other.name for other in sidecars(target))
        found = (
            f"there is {others}, of another content of it"
            if others
            else "there is none: was the volume moved, or is it not one that was saved half-drilled?"
        )
        raise ValueError(f"{target}: the exact state, {beside.name}, must lie beside it, and {found}")
    told = _told(beside)
    if told.get("sha256") != digest:
        raise ValueError(f"{target}: {beside.name} belongs to another content of it: one of them was changed")
    return beside, told


def is_drilled(target: Path) -> bool:
    """Whether a file or folder is a half-drilled volume as it was saved, and not another one under its name."""
    if not sidecars(target):
        return False
    try:
        own_sidecar(target)
    except (ValueError, OSError):
        return False
    return True


def replace_whole(target: Path, content: bytes) -> None:
    """Writes a file that appears, or replaces an older one, when it is whole and on disk."""
    with new_part(target) as part:
        write_synced(part, content)
        part.replace(target)


def _told(path: Path) -> dict[str, Any]:
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file:
        try:
            told = json.loads(attributes(file)["source"])
        except UNREADABLE:
            told = None
    if not isinstance(told, dict) or told.get("kind") != KIND:
        raise ValueError(f"{path} is a bone, but not one of a drilled volume")
    return told


class Changes(NamedTuple):
    """Which voxels get another value, these values, and of grey ones that of empty."""

    where: NDArray[np.bool_]
    values: NDArray[np.float64]
    empty: float | None = None


def grey_of_levels(mapping: OccupancyMap) -> NDArray[np.float64]:
    """Grey value of each level 0 to 255, by the map turned round; of empty, the highest that is empty.

    Raises
    ------
    ValueError
        If occupancy falls somewhere with the grey value, or no grey value is empty.
    """
    greys, occupancies = np.array(mapping.greys), np.array(mapping.occupancies)
    if np.any(np.diff(occupancies) < 0) or occupancies[0] > 0 or occupancies[-1] == 0:
        raise ValueError(
            f"map must rise from 0 with the grey value, for what was removed to have one, got {mapping.text}"
        )
    levels = np.arange(256) / 255.0
    last = np.clip(np.searchsorted(occupancies, levels), int(np.argmax(occupancies > 0)), len(greys) - 1)
    low, high = occupancies[last - 1], occupancies[last]
    found = greys[last - 1] + np.minimum((levels - low) / (high - low), 1.0) * (greys[last] - greys[last - 1])
    found[0] = greys[np.flatnonzero(occupancies == 0)[-1]]
    return np.asarray(found)


def changes(bone: VoxelBone, like: Volume | LabelVolume, mapping: OccupancyMap | None) -> Changes:
    """Grey values of what lost something, by the map turned round; label 0 where less than half is left."""
    density, pristine = bone.density, bone.pristine
    lost = density < pristine
    if isinstance(like, LabelVolume):
        lost[lost] = 2 * density[lost].astype(np.int64) < pristine[lost]
        return Changes(lost, np.zeros(np.count_nonzero(lost)))
    assert mapping is not None
    was, greys = like.values[lost].astype(np.float64), grey_of_levels(mapping)
    return Changes(lost, np.minimum(greys[density[lost]], was), float(greys[0]))


def file_ending(target: Path) -> str:
    """The ending that says the format; ValueError for none of them."""
    ending = next((e for e in ENDINGS if target.name.lower().endswith(e)), None)
    if ending is None:
        raise ValueError(f"path must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}, got {target}")
    return ending


def check_header(target: Path, like: Volume | LabelVolume, mapping: OccupancyMap | None) -> None:
    """ValueError where the header of the original should be kept under other values, and cannot be, or does not hold empty."""
    if _keeps_ending(target, like):
        try:
            coding = check_stored(like.path)
            coding.check(None if mapping is None else float(grey_of_levels(mapping)[0]), like.path)
        except ValueError:
            if is_whole(like):
                raise


def changed_file(target: Path, like: Volume | LabelVolume, changed: Changes) -> bytes:
    """The bytes of the volume's file with other values, under the header of the original where that can be kept."""
    ending = file_ending(target)
    if _keeps_ending(target, like) and is_whole(like):
        stored = read_stored(like.path)
        new = stored.values.copy()
        new[changed.where] = stored.coding.stored(changed.values, like.path, changed.empty)
        return stored.content(new)
    part = target.with_name(f".{target.name}.values{ending}")
    try:
        write_volume(part, with_changes(like, changed))
        return part.read_bytes()
    finally:
        part.unlink(missing_ok=True)


def changed_values(like: Volume | LabelVolume, changed: Changes) -> NDArray[Any]:
    """The voxels' values, of their type, after the changes."""
    new = _voxels(like).copy()
    new[changed.where] = Coding(new.dtype).stored(changed.values, like.path, changed.empty)
    return new


def with_changes(like: Volume | LabelVolume, changed: Changes) -> Volume | LabelVolume:
    """The volume with these values."""
    new = changed_values(like, changed)
    return replace(like, labels=new) if isinstance(like, LabelVolume) else replace(like, values=new)


def _keeps_ending(target: Path, like: Volume | LabelVolume) -> bool:
    return can_keep_header(like.path) and like.path.lower().endswith(file_ending(target))


def is_whole(like: Volume | LabelVolume) -> bool:
    """Whether the volume is what its file holds, in one layer, not cropped, resampled or changed."""
    if like.path.lower().endswith(".nrrd") and segment_layers(like.path)[0] > 1:
        return False
    read = read_volume if isinstance(like, Volume) else read_labels
    try:
        whole = read(like.files or like.path, spacing=like.spacing)
    except ValueError:  # another spacing than the file's
        return False
    return same_geometry(whole, like) and np.array_equal(_voxels(whole), _voxels(like))


def _voxels(like: Volume | LabelVolume) -> NDArray[Any]:
    return like.labels if isinstance(like, LabelVolume) else like.values


_TYPE, _CLASS, _INSTANCE, _SERIES = 0x00080008, 0x00080016, 0x00080018, 0x0020000E
_SAID, _SOURCES = 0x00082111, 0x00082112  # DerivationDescription, SourceImageSequence
_ITEM = 0xFFFEE000
#: What no longer holds: when the instance was made, least and highest pixel of image and series, icon, signatures; where packed
#: pixels begin and end.
_STALE = (
    0x00080012, 0x00080013, 0x00280106, 0x00280107, 0x00280108, 0x00280109, 0x00880200, 0x4FFE0001, 0xFFFAFFFA, 0x7FE00001,
    0x7FE00002,
)  # fmt: skip
_DERIVATION = "burrlab: half-drilled; what was removed has the grey value of empty"


def check_series(like: Volume | LabelVolume, empty: float | None) -> None:
    """ValueError where the slices cannot be written again, or do not hold the grey value of empty."""
    if not is_whole(like):
        try:
            check_slices(_grey(like, empty))
        except ValueError as error:
            raise ValueError(f"{error}; the ending of another format, as .nrrd, saves it as that") from None
        return
    for name, _, _, coding in _slices(like):
        coding.check(empty, name)


def write_series(
    target: Path,
    like: Volume | LabelVolume,
    changed: Changes,
    beside: Callable[[Path, str], None],
) -> None:
    """Writes a folder of slices, which appears when it is whole.

    Parameters
    ----------
    target : Path
        A folder that is not yet there.
    like : Volume or LabelVolume
        Read of DICOM slices. Their headers are kept where it is whole; else `write_dicom` makes new ones.
    changed : Changes
    beside : callable
        Called with the folder before it appears and the digest of its slices.
    """
    with new_folder(target) as part:
        if is_whole(like):
            _write_again(part, like, changed)
        else:
            write_slices(part, _grey(like, changed.empty, changed))
        beside(part, content_digest(part))


def _write_again(folder: Path, like: Volume | LabelVolume, changed: Changes) -> None:
    counts = np.count_nonzero(changed.where, axis=(1, 2))
    ends = np.concatenate([[0], np.cumsum(counts)])
    series = hashlib.sha256(np.packbits(changed.where).tobytes() + changed.values.tobytes())
    for k, (name, elements, stored, coding) in enumerate(_slices(like)):
        if k == 0:
            series.update(elements.text(_SERIES).encode() + elements.text(_INSTANCE).encode())
        values = changed.values[ends[k] : ends[k + 1]]
        stored[changed.where[k]] = coding.stored(values, name, changed.empty)
        source = elements.text(_INSTANCE)
        own = uid_of(series.digest() + source.encode() + b"%d" % k)
        content = elements.changed(
            {
                **dict.fromkeys(_STALE),
                _TYPE: (b"CS", padded("\\".join(["DERIVED", "SECONDARY", *elements.text(_TYPE).split("\\")[2:]]))),
                _INSTANCE: (b"UI", padded(own, b"\0")),
                _SERIES: (b"UI", padded(uid_of(series.digest()), b"\0")),
                _SAID: (b"ST", padded(_DERIVATION)),
                _SOURCES: (b"SQ", _reference(elements)),
                PIXELS: _pixels(elements, stored),
            },
            own,
        )  # fmt: skip
        write_synced(folder / slice_name(k), content)


def _reference(elements: Elements) -> bytes:
    """The one item of a sequence that names the instance that this one is derived from."""
    syntax = elements.unpacked
    pairs = ((0x00081150, elements.text(_CLASS)), (0x00081155, elements.text(_INSTANCE)))
    item = b"".join(encoded(tag, b"UI", padded(uid, b"\0"), syntax) for tag, uid in pairs)
    return encoded(_ITEM, b"", item, syntax)


def _pixels(elements: Elements, stored: NDArray[Any]) -> tuple[bytes, bytes]:
    content = stored.tobytes()
    kind = b"OW" if elements.packed else elements.data[PIXELS].kind
    return kind, content + b"\0" * (len(content) % 2)


def _slices(
    like: Volume | LabelVolume,
) -> Iterator[tuple[str, Elements, NDArray[Any], Coding]]:
    """Of each slice its file, the elements, the numbers that it stores, and how these are grey values."""
    for name, plane in zip(like.files, _values(like), strict=True):
        elements = elements_of(Path(name).read_bytes(), name)
        yield name, elements, *_stored(elements, plane, name)


def _stored(elements: Elements, plane: NDArray[Any], name: str) -> tuple[NDArray[Any], Coding]:
    whole, used, top = (elements.short(tag) for tag in (0x00280100, 0x00280101, 0x00280102))
    if whole not in (8, 16, 32) or not 0 < used <= whole or top != used - 1:
        raise ValueError(
            f"{name}: the DICOM file must store whole numbers of 8, 16 or 32 bits to keep its header, got {whole} bits allocated, "
            f"{used} stored, the highest at {top}"
        )
    if whole == 8 and elements.order == ">":
        raise ValueError(
            f"{name}: 8 bits a pixel in big-endian words cannot be kept: convert the series first"
        )
    kind = np.dtype(f"{elements.order}{'i' if elements.short(0x00280103) == 1 else 'u'}{whole // 8}")
    scale = elements.number(0x00281053, 1.0), elements.number(0x00281052, 0.0)
    for slope, inter in (scale, (1.0, 0.0)):  # the reader leaves the scale of some kinds of images alone
        if slope == 0 or not (math.isfinite(slope) and math.isfinite(inter)):
            continue
        if elements.packed:
            stored = np.rint((plane.astype(np.float64) - inter) / slope).astype(kind)
        else:
            content = elements.data[PIXELS].value if PIXELS in elements.data else b""
            if len(content) < plane.size * kind.itemsize:
                break
            stored = np.frombuffer(content, kind, plane.size).reshape(plane.shape).copy()
        spare = whole - used  # bits above those that are used may hold anything
        found = ((stored << spare) >> spare) * slope + inter
        if np.allclose(found, plane, rtol=1e-6, atol=1e-3 * abs(slope)):
            return stored, Coding(kind, slope, inter, used)
    raise ValueError(
        f"{name}: the pixels of the DICOM file are not the values that were read of it, so its header cannot be kept"
    )


def _values(like: Volume | LabelVolume) -> NDArray[Any]:
    return like.labels if isinstance(like, LabelVolume) else like.values


def _grey(like: Volume | LabelVolume, empty: float | None, changed: Changes | None = None) -> Volume:
    """As `write_dicom` takes it: of the least type that holds the original and empty, whatever type the reader gave them.

    Whole grey values that became fractions on other voxels are rounded.
    """
    own = _values(like)
    if isinstance(like, Volume) and own.dtype.kind == "f":
        original = read_volume(list(like.files))
        if original.values.dtype.kind in "iu" and not np.allclose(original.spacing, like.spacing, rtol=1e-6):
            own = np.rint(own).astype(np.int64)
            like = replace(like, values=own)
    least, most = min(float(own.min()), math.floor(empty or 0.0)), float(own.max())
    fits = [
        kind for kind in map(np.dtype, KINDS) if np.iinfo(kind).min <= least and most <= np.iinfo(kind).max
    ]
    kind = fits[0] if fits and own.dtype.kind in "iu" else own.dtype
    new = own if changed is None else changed_values(like, changed)
    return Volume(new.astype(kind), like.spacing, like.origin, like.direction, like.path)


def stack_slices(path: str) -> Slices | None:
    """The slices that a volume was read of; None where it was not one of PNG slices."""
    if Path(path).suffix.lower() in (".yaml", ".yml") and Path(path).is_file():
        described = read_description(path, unit=1.0)
        return find_slices(described.folder, prefix=described.prefix)
    if any(sign in path for sign in "*?[") or (Path(path).is_dir() and is_stack(path)):
        return find_slices(path)
    return None


def check_whole_stack(slices: Slices, like: Volume | LabelVolume) -> None:
    """ValueError unless a volume has the voxels of the stack."""
    turned = ROWS_ALONG_X in like.notes
    sides = (slices.columns, slices.rows) if turned else (slices.rows, slices.columns)
    if (len(slices.paths), *sides) != like.shape:
        raise ValueError(
            f"{like.path}: a stack must be whole to be saved as one, {(len(slices.paths), *sides)} voxels, got {like.shape}"
        )


def write_stack(
    target: Path,
    slices: Slices,
    like: Volume | LabelVolume,
    changed: Changes,
    beside: Callable[[Path, str], None],
) -> None:
    """Writes a folder of slices of the same names, sizes and kind, which appears when it is whole.

    Parameters
    ----------
    target : Path
        A folder that is not yet there.
    slices : Slices
        Of the original.
    like : Volume or LabelVolume
        Read of them.
    changed : Changes
        Of coloured slices they become transparent (black, without transparency).
    beside : callable
        Called with the folder before it appears and the digest of its slices.
    """
    new = changed_values(like, changed) if isinstance(like, Volume) else None
    with new_folder(target) as part:
        for k, path in enumerate(slices.paths):
            here, plane = changed.where[k], None if new is None else new[k]
            if ROWS_ALONG_X in like.notes:
                here, plane = here.T, None if plane is None else plane.T
            _write_slice(path, part / path.name, slices, here, plane)
        if Path(like.path).is_file():
            _write_description(Path(like.path), part)
        beside(part, content_digest(part))


def _write_slice(
    path: Path, copy: Path, slices: Slices, where: NDArray[np.bool_], plane: NDArray[Any] | None
) -> None:
    with copy.open("wb") as file:
        if not where.any() and slices.kind != "palette" and slices.bits >= 8:  # others change their kind
            file.write(path.read_bytes())
        else:
            _draw(path, slices.kind, where, plane).save(file, format="PNG", compress_level=3)
        file.flush()
        os.fsync(file.fileno())


def _draw(path: Path, kind: str, where: NDArray[np.bool_], plane: NDArray[Any] | None) -> Image.Image:
    from PIL import Image

    image = pixels(path).copy()
    if plane is None:
        image[where] = 0
        image[image[..., 3] == 0] = 0  # without transparency nothing else says that they are empty
    elif image.ndim == 2:
        image[...] = plane
    else:
        image[..., :3] = plane[..., None]
    return Image.fromarray(image[..., :3] if kind == "RGB" else image)


def _write_description(path: Path, folder: Path) -> None:
    """The YAML file of the original, with the slices beside it; comments go where its style is not that of the simulator's."""
    import yaml

    text, copy = path.read_text(encoding="utf-8"), folder / path.name
    block = re.search(r"^(\s*)images:[^\n]*\n(?:\1\s+[^\n]*\n?|\s*\n)*", text, flags=re.MULTILINE)
    if block is not None:
        own = re.sub(r"^(\s*path:)[^\n]*", r"\g<1> ./", block[0], count=1, flags=re.MULTILINE)
        copy.write_text(text[: block.start()] + own + text[block.end() :], encoding="utf-8")
        if read_description(copy, unit=1.0).folder.resolve() == folder.resolve():
            return
    content = yaml.safe_load(text)
    (named,) = (name for name in content if str(name).startswith("VOLUME "))  # as read_description has it
    content[named]["images"]["path"] = "./"
    copy.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), encoding="utf-8")


def check_drilled(
    target: Path, like: Volume | LabelVolume, mapping: OccupancyMap | None = None
) -> Slices | None:
    """The errors of `save_drilled` that can be told before there is a bone; the slices of a stack that is saved as one."""
    target = followed(target)
    check_folder(target)
    if Path(like.path).exists() and target.exists() and target.samefile(like.path) and not is_drilled(target):
        raise ValueError(f"path must be another file than the original {like.path}")
    empty = None
    if isinstance(like, LabelVolume):
        if mapping is not None:
            raise ValueError(f"mapping must be given for grey values only, and {like.path} holds labels")
    elif mapping is None:
        raise ValueError(f"mapping must be given: that with which the bone was made of {like.path}")
    else:
        empty = float(grey_of_levels(mapping)[0])
        Coding(like.values.dtype).check(empty, like.path)
    if is_series(target, like):
        if target.suffix.lower() in (".dcm", ".dicom", ".ima"):
            raise ValueError(f"path must be a new folder for a DICOM series, and not one file, got {target}")
        _check_new_folder(target)
        check_series(like, empty)
        return None
    slices = None if target.name.lower().endswith(ENDINGS) else stack_slices(like.path)
    if slices is None:
        file_ending(target)
        check_name(target)
        if target.exists() and not is_drilled(target):
            raise FileExistsError(f"path must be a new file or one of save_drilled, {target} is neither")
        check_header(target, like, mapping)
        return None
    check_whole_stack(slices, like)
    _check_new_folder(target)
    return slices


def _check_new_folder(target: Path) -> None:
    if target.exists():
        raise FileExistsError(f"path must be a new folder, {target} is there")


def is_series(target: Path, like: Volume | LabelVolume) -> bool:
    """Whether it is to be a folder of DICOM slices."""
    return bool(like.files) and not target.name.lower().endswith(ENDINGS)


def check_place(bone: VoxelBone, like: Volume | LabelVolume) -> None:
    """ValueError unless a bone is on the voxels of a volume."""
    where = like.bone_point(like.origin)
    small = 1e-2 * like.spacing
    if (
        bone.shape != like.shape
        or np.any(np.abs(np.array(bone.spacing) - like.spacing) > 1e-3 * like.spacing)
        or np.any(np.abs(np.array(bone.origin) - where) > small)
    ):
        raise ValueError(
            f"bone must be on the voxels of {like.path}: it has shape {bone.shape}, spacing {_three(bone.spacing)} and origin "
            f"{_three(bone.origin)} mm, and the volume {like.shape}, {_three(like.spacing)} and {_three(where)} mm"
        )


def check_original(bone: VoxelBone, like: Volume | LabelVolume) -> None:
    """A half-drilled volume will do for the original while nothing grew on it since."""
    source = Path(like.path)
    if not source.exists() or not sidecars(source):
        return
    try:
        beside, _ = own_sidecar(source)
    except ValueError:
        return
    before, _ = load_bone(beside)
    if before.shape == bone.shape and (more := int(np.count_nonzero(bone.density > before.density))):
        raise ValueError(
            f"like must be the original: {like.path} is half-drilled, and {more} voxels of it have less than the bone"
        )


def _three(values: Any) -> str:
    return "(" + ", ".join(f"{float(v):.6g}" for v in values) + ")"


@dataclass(frozen=True, eq=False)
class DrilledVolume:
    """A half-drilled bone, as it was saved.

    Attributes
    ----------
    bone : VoxelBone
        Present and pristine levels, and tissues: its digest is that of the bone that was saved.
    tick : int
        Ticks executed on it so far.
    mapping : OccupancyMap or None
        Of grey values; None where the volume is of labels.
    source : str
        The volume that the bone was made of.
    path : str
        Of the half-drilled volume itself.
    transpose : bool
        Of slices; see `read_stack`.
    """

    bone: VoxelBone
    tick: int
    mapping: OccupancyMap | None
    source: str
    path: str
    transpose: bool = False

    def volume(self) -> Volume | LabelVolume:
        """The half-drilled volume as other programs see it, on the voxels of the bone: `like` of the next `save_drilled`."""
        if is_stack(self.path):
            return read_stack(
                self.path, spacing=self.bone.spacing, palette=None if self.mapping else self.bone.tissues, unknown="nearest",
                transpose=self.transpose,
            )  # fmt: skip
        read = read_labels if self.mapping is None else read_volume
        return read(self.path, spacing=self.bone.spacing)


def save_drilled(
    path: str | os.PathLike[str],
    bone: VoxelBone,
    like: Volume | LabelVolume,
    *,
    mapping: OccupancyMap | None = None,
    tick: int = 0,
) -> None:
    """Writes a bone as a volume in which what was removed is gone, and beside it what brings back its exact state.

    Parameters
    ----------
    path : path-like
        With the ending of the original, for its header to be kept: .nrrd (.seg.nrrd), .nii, .nii.gz, .mha. For a stack of PNG
        slices or a DICOM series, a new folder.
    bone : VoxelBone
        On the voxels of `like`.
    like : Volume or LabelVolume
        What the bone was made of: grey values, or labels alone.
    mapping : OccupancyMap, optional
        With which it was made of the grey values; occupancy must not fall with them.
    tick : int
        Ticks executed on the bone so far.

    Raises
    ------
    ValueError
        If bone and volume are on different voxels, the map is missing, given for labels, cannot be turned round or has a grey
        value of empty that the file cannot store, the path is the original's, its ending is none of these, its name is too long, the header
        cannot be kept (values as text, or in another place than right behind it), the tick out of range, or `like` is itself
        half-drilled and has less than the bone.
    FileExistsError
        If there is something else under that name.
    FileNotFoundError
        If its folder, or the original stack or series, is not there.
    OSError
        If the files cannot be written.

    Notes
    -----
    Voxels of which nothing was removed keep their value to the bit, but for a resampled DICOM series: its slices hold whole numbers.
    The others get the grey value that the map gives for what is left of them, and never a higher one than they had; nothing left is the grey value of empty. Of labels alone, a voxel of
    which less than half is left gets label 0. The header is that of the original file, byte by byte, where `like` is that file's
    whole volume; a cropped or resampled one, and a segmentation in several layers, gets a new header, of NRRD with the names and
    colours of its labels. Slices of a DICOM series are
    derived images of a new series, of the same study: UIDs, image type and derivation are theirs, all else is that of the slice that
    they were made of.

    Beside `NAME` lies `NAME.<digest>.bone.h5` (in a stack's folder, `bone.h5`), a bone as `save_bone` writes it. It is written
    first, and bears the digest of the volume it belongs to: whoever is killed in between leaves the old pair or the new one.
    """
    target = followed(Path(path))
    check_tick(tick)
    slices = check_drilled(target, like, mapping)
    check_place(bone, like)
    check_original(bone, like)
    changed = changes(bone, like, mapping)
    told = {
        "kind": KIND,
        "source": like.path,
        "map": None if mapping is None else mapping.text,
        "transpose": ROWS_ALONG_X in like.notes,
    }

    def beside(where: Path, digest: str) -> None:
        save_bone(where, bone, tick, source=json.dumps({**told, "sha256": digest}))

    def in_folder(folder: Path, digest: str) -> None:
        beside(folder / IN_FOLDER, digest)

    if slices is not None:
        write_stack(target, slices, like, changed, in_folder)
        return
    if is_series(target, like):
        write_series(target, like, changed, in_folder)
        return
    if isinstance(like, LabelVolume):  # what the table says where the file said nothing, for a new header
        names, colours = ({t.label: getattr(t, of) for t in bone.tissues or ()} for of in ("name", "colour"))
        like = replace(like, names=names | like.names, colours=colours | like.colours)
    content = changed_file(target, like, changed)
    digest = hashlib.sha256(content).hexdigest()
    own = sidecar(target, digest)
    before = [other for other in sidecars(target) if other.name != own.name]
    beside(own, digest)
    replace_whole(target, content)  # from here on the new pair counts
    for other in before:
        other.unlink(missing_ok=True)


def load_drilled(path: str | os.PathLike[str]) -> DrilledVolume:
    """The bone of a volume that `save_drilled` wrote, in its exact state.

    Raises
    ------
    FileNotFoundError
        If there is no such file or folder.
    ValueError
        If the file that holds the exact state is missing, or belongs to another content of the volume: one of them was changed.
    """
    target = Path(path)
    if not target.exists():
        raise FileNotFoundError(f"{target}: no such file or folder")
    beside, told = own_sidecar(target)
    bone, tick = load_bone(beside)
    mapping = None if told.get("map") is None else OccupancyMap.parse(str(told["map"]))
    return DrilledVolume(
        bone, tick, mapping, str(told.get("source", "")), os.fspath(path), bool(told.get("transpose"))
    )
