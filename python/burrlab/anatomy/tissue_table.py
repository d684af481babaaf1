"""Tables of tissues for the labels of a segmentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Material, Tissue, Tissues
from burrlab.anatomy.known_tissues import KNOWN, UNLABELLED, Colour, known_tissue
from burrlab.materials import materials

if TYPE_CHECKING:
    from burrlab.volume import LabelVolume

#: Most tissues that a bone holds.
MOST = 64


def default_tissues(
    labels: LabelVolume | Mapping[int, str] | Sequence[str], *, material: Material = materials["bone"]
) -> Tissues:
    """A table for named labels: colour, critical and bleeding by what the structure is, c_e and alpha the bone's.

    Parameters
    ----------
    labels : LabelVolume, mapping of int to str, or sequence of str
        Labels with their names; a sequence gives the labels 0, 1, 2, ... A label volume's own colours are kept.
        Names are those of common segmentations, in any spelling: Facial_Nerve, "right facial nerve".
    material : Material
        The bone: its c_e, alpha and f.

    Returns
    -------
    Tissues
        In the order of the labels. Label 0 without a name is "unlabelled".

    Raises
    ------
    ValueError
        If a name is not known, a label of the volume has no name, or there are more than 64.

    Notes
    -----
    No tissue but bone has a published pair of c_e and alpha: all others get the bone's, and are `assumed`.

    Examples
    --------
    >>> table = default_tissues(["air", "Bone", "Facial_Nerve"])
    >>> [(t.name, t.critical, t.assumed) for t in table]
    [('air', False, True), ('bone', False, False), ('facial nerve', True, True)]
    """
    names, counts, colours = _named(labels)
    check_count(names)
    unknown = [label for label, name in names.items() if known_tissue(name) is None]
    if unknown:
        told = ", ".join(_told(label, names, counts) for label in unknown)
        known = ", ".join(tissue.name for tissue in KNOWN)
        raise ValueError(
            f"the default table does not know {told}; it knows {known}, and their usual synonyms: "
            "give a table of your own (read_tissues, `burrlab tissues FILE --template table.csv`)"
        )
    rows = []
    taken: set[str] = set()
    for label, given in sorted(names.items()):
        tissue = known_tissue(given)
        assert tissue is not None
        name = given if tissue.name in taken else tissue.name  # a second side keeps the name of the file
        taken.add(name)
        rows.append(
            Tissue(name, label=label, c_e=material.c_e, alpha=material.alpha,
                   colour=colours.get(label, tissue.colour), critical=tissue.critical, bleeds=tissue.bleeds,
                   assumed=not tissue.bone)
        )  # fmt: skip
    return Tissues(rows, material)


def unlabelled(material: Material) -> Tissue:
    """The tissue of label 0 where nothing else is said of it: bone's values, assumed."""
    known = known_tissue(UNLABELLED)
    assert known is not None
    return Tissue(UNLABELLED, label=0, c_e=material.c_e, alpha=material.alpha, colour=known.colour)


def label_counts(values: NDArray[Any], path: str = "") -> dict[int, int]:
    """Voxels of each label that is present; a sentence on what is wrong names the path.

    Raises
    ------
    ValueError
        If a label is negative or no whole number.
    """
    said = f"{path}: " if path else ""
    if not np.issubdtype(values.dtype, np.integer):
        whole = np.rint(values)
        if not np.array_equal(whole, values):  # NaN too
            raise ValueError(
                f"{said}labels must be whole numbers: this is a grey volume, or was interpolated"
            )
        values = whole.astype(np.int64)
    found, counts = _unique(values)
    if found.size and found[0] < 0:
        raise ValueError(
            f"{said}labels must be zero or positive, got {int(found[0])}: is this a grey volume?"
        )
    return {int(label): int(count) for label, count in zip(found, counts, strict=True)}


def _unique(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    if values.dtype.itemsize > 2 or values.dtype.kind != "u":
        return np.unique(values, return_counts=True)
    counts = np.zeros(1 << (8 * values.dtype.itemsize), np.int64)
    for plane in values.reshape(len(values), -1):  # bincount works in int64: plane by plane
        counts += np.bincount(plane, minlength=counts.size)
    found = np.flatnonzero(counts)
    return found, counts[found]


def _named(
    labels: LabelVolume | Mapping[int, str] | Sequence[str],
) -> tuple[dict[int, str], dict[int, int] | None, dict[int, Colour]]:
    """Names by label, voxels by label where there is a volume, and its colours."""
    if isinstance(labels, str):
        raise ValueError(f"labels must be a label volume, or names, got the text {labels!r}")
    if isinstance(labels, Mapping):
        return {int(label): str(name) for label, name in labels.items()}, None, {}
    if isinstance(labels, Sequence):
        return {label: str(name) for label, name in enumerate(labels)}, None, {}
    counts = label_counts(labels.labels, labels.path)
    check_count(counts, f"{labels.path}: ")
    names = {label: labels.names.get(label, UNLABELLED if label == 0 else "") for label in counts}
    nameless = [label for label, name in names.items() if not name]
    if nameless:
        told = ", ".join(f"{label} ({counts[label]} voxels)" for label in nameless)
        raise ValueError(
            f"{labels.path}: the labels {told} have no names in the file: give a table of tissues that says what they are "
            "(read_tissues, `burrlab tissues FILE --template table.csv`)"
        )
    for label, name in labels.names.items():  # what is named but empty here may be there in another crop
        if label not in names and known_tissue(name) is not None and len(names) < MOST:
            names[label] = name
    return names, counts, {label: colour for label, colour in labels.colours.items() if label != 0}


def check_count(labels: Mapping[int, object], said: str = "") -> None:
    """ValueError for more labels than a bone has tissues: grey values, or instances."""
    if len(labels) > MOST:
        first = ", ".join(str(label) for label in sorted(labels)[:5])
        raise ValueError(
            f"{said}a bone has at most {MOST} tissues, and there are {len(labels)} labels ({first}, ...): "
            "is this a grey volume, or does it hold instances? Merge labels first"
        )


def _told(label: int, names: Mapping[int, str], counts: Mapping[int, int] | None) -> str:
    count = "" if counts is None else f", {counts.get(label, 0)} voxels"
    return f"label {label} ({names[label]!r}{count})"
