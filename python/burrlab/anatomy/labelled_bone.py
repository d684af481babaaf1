"""Bone with tissues, of grey values and labels, or of labels alone."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d, maximum_filter
from scipy.special import ndtr

from burrlab._core import Tissues, VoxelBone
from burrlab.anatomy.known_tissues import EMPTY, UNLABELLED, known_tissue
from burrlab.anatomy.tissue_table import MOST, label_counts, unlabelled
from burrlab.volume import LabelVolume, OccupancyMap, Volume, check_same_geometry
from burrlab.volume.geometry import SAME, OnGrid

#: Occupancy from which a voxel counts as bone in notes: half.
_HALF = 128

#: Of bone of labels alone, by R/voxel: standard deviation of the velocity over 12 places within 0.6 mm [%], least and most of three
#: kinds of surfaces; as the labels are, and smoothed by two voxels or more. docs/tissues.md says how it was measured.
LABEL_SCATTER = {10: ((11, 17), (3, 6)), 20: ((6, 15), (3, 5)), 30: ((3, 10), (2, 4))}


def label_scatter(ratio: float, smooth: bool = False) -> str:
    """`LABEL_SCATTER` in words, linear between its rows; beyond them, the last one."""
    ratio = float(np.clip(ratio, min(LABEL_SCATTER), max(LABEL_SCATTER)))
    rows = [row[smooth] for row in LABEL_SCATTER.values()]
    least, most = (np.interp(ratio, list(LABEL_SCATTER), column) for column in zip(*rows, strict=True))
    return f"{least:.0f} to {most:.0f} % at R/voxel = {ratio:.3g}"


@dataclass(frozen=True, eq=False)
class LabelledBone:
    """A bone with tissues, and what was assumed on the way.

    Attributes
    ----------
    bone : VoxelBone
    notes : tuple of str
    """

    bone: VoxelBone
    notes: tuple[str, ...] = ()


def labelled_bone(
    source: Volume | NDArray[np.uint8] | None,
    labels: LabelVolume,
    tissues: Tissues,
    *,
    mapping: OccupancyMap | None = None,
    fill: Mapping[str, float] | None = None,
    spacing: float | ArrayLike | None = None,
    empty: Collection[str] = EMPTY,
    smooth: float | None = None,
) -> LabelledBone:
    """Bone whose occupancy is that of grey values and whose tissues are those of labels.

    Parameters
    ----------
    source : Volume, ndarray of uint8 or None
        Grey values, with `mapping`; or levels (z, y, x) on the grid of the labels; or None: label 0 and what is labelled as one
        of `empty` is empty, and all else is solid.
    labels : LabelVolume
        On the voxels of the volume, or on a box of them, as segmentations are often saved: 0 outside it.
    tissues : Tissues
        What the labels are. Without a row for label 0, that is "unlabelled", with the bone's values.
    mapping : OccupancyMap, optional
        Of the grey values.
    fill : mapping of str to float, optional
        By tissue, the least occupancy of its voxels, 0 to 1: nerves and vessels have grey values that a map for bone takes as
        empty, and what is empty cannot be injured.
    spacing : float or (x, y, z), optional
        Of the bone [mm]; default that of the volume. Occupancy is interpolated, labels are the nearest.
    empty : collection of str
        Structures that hold no bone where labels are alone, by the name that the default table gives them: air and the ear canal.
        `fill` makes one solid.
    smooth : float, optional
        Of labels alone: standard deviation of a Gaussian over what is solid [mm], 1 to 10 of the finest side of a voxel. The sum of
        levels stays; critical structures stay full, and what is empty and nearest to one stays empty; an empty voxel that gets a part
        gets the label of the nearest solid one too. docs/tissues.md says which width, and what it does.

    Returns
    -------
    LabelledBone
        In the bone frame of the volume.

    Raises
    ------
    ValueError
        If the labels are on other voxels, one of them is not in the table, the map is missing, given for nothing, a filled
        tissue is not in the table, or `smooth` is given with a source or out of its range.
    TypeError
        If `source` is none of these.

    Examples
    --------
    >>> from burrlab.anatomy import default_tissues
    >>> labels = LabelVolume(np.array([[[0, 1, 2]]]), 0.2, (0, 0, 0), np.eye(3), "example", {1: "bone", 2: "nerve"})
    >>> made = labelled_bone(None, labels, default_tissues({1: "bone", 2: "facial nerve"}))
    >>> made.bone.density.tolist(), [t.name for t in made.bone.tissues]
    ([[[0, 255, 255]]], ['bone', 'facial nerve', 'unlabelled'])
    """
    notes = list(labels.notes)
    _check_source(source, labels, mapping)
    if smooth is not None and source is not None:
        raise ValueError(f"smooth goes with labels alone, got {smooth!r} beside a source")
    if isinstance(source, Volume):
        notes[:0] = source.notes
        labels = placed_on(labels, source)
    counts = label_counts(labels.labels, labels.path)
    tissues = _with_background(tissues, counts, labels.path)
    if spacing is not None:
        if isinstance(source, np.ndarray):
            raise ValueError("spacing must not be given with levels, which have that of the labels")
        labels = labels.resample(spacing)
    numbers = _numbers(labels.labels, tissues)
    origin = labels.bone_point(labels.origin)
    if isinstance(source, Volume):
        assert mapping is not None
        grey = source.to_bone(mapping, spacing=spacing)
        levels, apart, origin = grey.density, np.array(grey.spacing), np.array(grey.origin)
    else:
        apart = labels.spacing
        levels = _of_labels(numbers, tissues, empty) if source is None else source
        if source is None:
            where = ", ".join(empty)
            said = f"; velocities at one place scatter: {', '.join(map(label_scatter, (10, 20, 30)))} (smooth=, --smooth)"
            if smooth is not None:
                levels, numbers, said = _smoothed(levels, numbers, tissues, apart[::-1], smooth)
            notes.append(
                f"occupancy from labels alone: empty where there is {where} or label 0, else solid{said}"
            )
    levels, filled = _filled(levels, numbers, tissues, fill or {})
    bone = VoxelBone(levels, spacing=apart, origin=origin)
    bone.set_tissues(tissues, numbers)
    return LabelledBone(bone, tuple(notes + filled + _said_of_tissues(levels, numbers, tissues)))


def placed_on(labels: LabelVolume, volume: OnGrid) -> LabelVolume:
    """The labels on all voxels of a volume, of which they may have a box; 0 outside it.

    Raises
    ------
    ValueError
        If they are not on voxels of the volume, with both geometries.
    """
    offset = (volume.direction.T @ (labels.origin - volume.origin)) / volume.spacing
    start = np.rint(offset).astype(int)
    stop = start + labels.shape[::-1]
    alike = (
        np.allclose(labels.spacing, volume.spacing, rtol=1e-3)
        and np.allclose(labels.direction, volume.direction, atol=1e-3)
        and np.abs(offset - start).max() <= SAME
    )
    if not alike or np.any(start < 0) or np.any(stop > volume.shape[::-1]) or labels.shape == volume.shape:
        try:
            check_same_geometry(volume, labels)
        except ValueError as error:
            raise ValueError(f"{error}; labels.on(volume) (--onto) takes the nearest label") from None
        return replace(labels, spacing=volume.spacing, origin=volume.origin, direction=volume.direction)
    whole = np.zeros(volume.shape, labels.labels.dtype)
    (x, y, z), (u, v, w) = start, stop
    whole[z:w, y:v, x:u] = labels.labels
    placed = replace(
        labels, labels=whole, spacing=volume.spacing, origin=volume.origin, direction=volume.direction
    )
    check_same_geometry(volume, placed)
    return placed


def _check_source(source: Any, labels: LabelVolume, mapping: OccupancyMap | None) -> None:
    if isinstance(source, Volume):
        if mapping is None:
            raise ValueError(f"mapping must be given for the grey values of {source.path}")
        return
    if mapping is not None:
        raise ValueError("mapping must be given with grey values only")
    if source is None:
        return
    if not (isinstance(source, np.ndarray) and source.dtype == np.uint8):
        raise TypeError(f"source must be a Volume, levels of uint8 or None, got {type(source).__name__}")
    if source.shape != labels.shape:
        raise ValueError(f"levels must have the shape of the labels {labels.shape}, got {source.shape}")


def _with_background(tissues: Tissues, counts: dict[int, int], path: str) -> Tissues:
    """The table, with a row for label 0 where that is there and not in it; ValueError for other labels."""
    known = {tissue.label for tissue in tissues}
    strange = [label for label in counts if label not in known and label != 0]
    if strange:
        told = ", ".join(f"{label} ({counts[label]} voxels)" for label in strange[:10])
        more = f" and {len(strange) - 10} more" if len(strange) > 10 else ""
        have = ", ".join(f"{tissue.label} {tissue.name}" for tissue in tissues)
        raise ValueError(f"{path}: labels that are not in the table: {told}{more}; the table has {have}")
    if 0 in known or 0 not in counts:
        return tissues
    if len(tissues) == MOST:
        raise ValueError(
            f"the table must have a row for label 0 ({counts[0]} voxels), or one row less than {MOST}"
        )
    names = {tissue.name for tissue in tissues}
    if UNLABELLED in names:
        raise ValueError(f"the table must have {UNLABELLED!r} for label 0 only ({counts[0]} voxels)")
    return Tissues([*tissues, unlabelled(tissues.material)], tissues.material)


def _numbers(labels: NDArray[Any], tissues: Tissues) -> NDArray[np.uint8]:
    own = np.array([tissue.label for tissue in tissues])
    order = np.argsort(own).astype(np.uint8)
    direct = np.zeros(1 << 16, np.uint8)
    direct[own[own < direct.size]] = np.flatnonzero(own < direct.size)
    small = labels.dtype.itemsize <= 2 or labels.max() < direct.size
    numbers = np.empty(labels.shape, np.uint8)
    for k, plane in enumerate(labels):  # plane by plane: no large arrays of places
        numbers[k] = direct[plane] if small else order[np.searchsorted(own, plane, sorter=order)]
    return numbers


def _of_labels(numbers: NDArray[np.uint8], tissues: Tissues, empty: Collection[str]) -> NDArray[np.uint8]:
    known = [(tissue.label, known_tissue(tissue.name)) for tissue in tissues]
    hollow = [label == 0 or (found is not None and found.name in empty) for label, found in known]
    return np.where(hollow, 0, 255).astype(np.uint8)[numbers]


def _smoothed(
    full: NDArray[np.uint8], numbers: NDArray[np.uint8], tissues: Tissues, apart: NDArray[Any], width: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], str]:
    """Levels and numbers with a smooth border of solid and empty, and what it does to volumes; `apart` along (z, y, x)."""
    if not 0.999 <= width / apart.min() <= 10.001:
        raise ValueError(
            f"smooth must be 1 to 10 times the finest side of a voxel, {apart.min():g} to {10 * apart.min():g} mm, got {width!r}"
        )
    weights = [_gaussian(width / side) for side in apart]
    part = (full > 0).astype(np.float32)
    for axis in range(3):  # whole numbers up to 2^24: exact, on every machine
        correlate1d(part, weights[axis], axis, output=part, mode="reflect")
    owner = np.where(full > 0, numbers + np.uint8(1), np.uint8(0))
    for _ in range(max(map(len, weights)) // 2):
        np.copyto(owner, maximum_filter(owner, 3), where=owner == 0)
    held = np.array([True, *(tissue.critical for tissue in tissues)])
    levels, found = np.empty_like(full), numbers.copy()
    before, after = np.zeros(len(tissues)), np.zeros(len(tissues))
    for k in range(len(full)):  # plane by plane: no large arrays of float64
        plane = np.floor((255.0 * part[k] + (1 << 23)) / (1 << 24)).astype(np.uint8)
        plane = np.where(held[owner[k]], full[k], plane)
        found[k] = np.where(plane > 0, owner[k] - np.uint8(1), numbers[k])
        levels[k] = plane
        before += np.bincount(numbers[k].ravel(), full[k].ravel(), len(tissues))
        after += np.bincount(found[k].ravel(), plane.ravel(), len(tissues))
    change = 100 * (after - before) / np.maximum(before, 255)
    most = int(np.argmax(np.abs(change)))
    whole = 100 * (after.sum() / max(before.sum(), 1.0) - 1)
    said = f", smoothed by {width:g} mm: the volume changes by {whole:.2g} %, that of {tissues[most].name} most, by {change[most]:.2g} %"
    return levels, found, said


def _gaussian(deviation: float) -> NDArray[np.float64]:
    """Whole weights with a sum of 256, the parts of a Gaussian of this standard deviation in each voxel."""
    edges = np.arange(-np.ceil(4 * deviation), np.ceil(4 * deviation) + 2) - 0.5
    return np.asarray(np.trim_zeros(np.diff(np.rint(256 * ndtr(edges / deviation)))))


def _filled(
    levels: NDArray[np.uint8], numbers: NDArray[np.uint8], tissues: Tissues, fill: Mapping[str, float]
) -> tuple[NDArray[np.uint8], list[str]]:
    least, notes = np.zeros(len(tissues), np.uint8), []
    names = [tissue.name for tissue in tissues]
    for name, occupancy in fill.items():
        if name not in names:
            raise ValueError(f"fill must be of tissues of the table ({', '.join(names)}), got {name!r}")
        if not 0.0 <= occupancy <= 1.0:
            raise ValueError(f"fill of {name!r} must be an occupancy from 0 to 1, got {occupancy!r}")
        least[names.index(name)] = round(255 * occupancy)
        notes.append(f"{name}: occupancy at least {occupancy:g}, as asked")
    return (np.maximum(levels, least[numbers]) if fill else levels), notes


def _said_of_tissues(levels: NDArray[np.uint8], numbers: NDArray[np.uint8], tissues: Tissues) -> list[str]:
    """Bone that no label names, and critical structures that hold none."""
    both = np.zeros(2 * len(tissues), np.int64)
    for plane, filled in zip(numbers, levels, strict=True):  # bincount works in int64: plane by plane
        both += np.bincount((2 * plane + (filled >= _HALF)).ravel(), minlength=both.size)
    held = both[1::2]
    voxels = both[::2] + held
    notes = []
    for number, tissue in enumerate(tissues):
        if tissue.label == 0 and tissue.name == UNLABELLED and held[number]:
            notes.append(
                f"{held[number]} voxels of label 0 hold bone: {UNLABELLED}, with the bone's c_e and alpha"
            )
        if tissue.critical and voxels[number] and 2 * held[number] < voxels[number]:
            part = 100.0 * held[number] / voxels[number]
            notes.append(
                f"{tissue.name}: {part:.0f} % of its voxels are half full or more; what is empty cannot be injured (fill=, --fill)"
            )
    return notes
