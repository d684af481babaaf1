"""Half-drilled volumes as DICOM series: derived images, each under the header of the slice that it was made of.

Tags after DICOM PS3.3: General Image (C.7.6.1), Image Pixel (C.7.6.3), SOP Common (C.12.1).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.files import new_folder, write_synced
from burrlab.volume.coding import Coding
from burrlab.volume.dicom_elements import PIXELS, Elements, elements_of, encoded, padded
from burrlab.volume.drilled_pair import content_digest
from burrlab.volume.drilled_values import Changes, changed_values, is_whole
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.read import read_volume
from burrlab.volume.volume import Volume
from burrlab.volume.write_dicom import KINDS, check_slices, slice_name, uid_of, write_slices

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
