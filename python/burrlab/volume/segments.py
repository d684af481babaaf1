"""The segments of a segmentation of 3D Slicer (.seg.nrrd): names, colours, and layers made one volume."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

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
