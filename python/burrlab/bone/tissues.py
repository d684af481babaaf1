"""Tissues: known structures, tables of tissues and their CSV files, and bone made from labels."""

import io
import json
import math
import os
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

import burrlab.common.table as table
from burrlab._core import Material, Tissue, Tissues, VoxelBone
from burrlab.bone.image import (
    SAME,
    SLAB,
    Colour,
    LabelVolume,
    OccupancyMap,
    OnGrid,
    Volume,
    check_same_geometry,
    empty_bone,
    slabs,
)
from burrlab.bone.materials import material_of, materials
from burrlab.bone.snapshot import tissues_to_json
from burrlab.common.check import amend_error, refuse, require_type, shown
from burrlab.common.files import write_text
from burrlab.common.progress import doing
from burrlab.common.records import UNREADABLE, in_one_line
from burrlab.common.table import Column, Table
from burrlab.theory.tool import law_of

#: Name of the tissue of voxels without a structure in the segmentation.
UNLABELLED = "unlabelled"


@dataclass(frozen=True)
class KnownTissue:
    """A structure, its names in segmentations, and its entries in the default table.

    Attributes
    ----------
    name : str
    synonyms : tuple of str
        In the form of `plain_name`.
    colour : (red, green, blue)
    critical, bleeds : bool
        See `Tissue`.
    bone : bool
        Whether it is bone, which has a published pair of c_e and alpha; density tells its kinds apart.
    """

    name: str
    synonyms: tuple[str, ...]
    colour: Colour
    critical: bool = True
    bleeds: bool = False
    bone: bool = False


# Structures of volumetric_drilling have the colours of its PNG stacks. Other colours, and the choice of what
# is critical and what bleeds, are ours.
KNOWN = (
    KnownTissue("air", ("void", "empty", "lumen"), (0, 0, 0), critical=False),
    KnownTissue(UNLABELLED, ("background", "clear label", "other"), (128, 128, 128), critical=False),
    KnownTissue("bone", ("temporal bone", "skull"), (255, 249, 219), critical=False, bone=True),
    KnownTissue("cortex", ("cortical bone", "compact bone"), (240, 230, 200), critical=False, bone=True),
    KnownTissue(
        "mastoid",
        ("mastoid bone", "trabecular bone", "cancellous bone", "spongy bone"),
        (235, 205, 165),
        critical=False,
        bone=True,
    ),
    KnownTissue("soft tissue", ("skin", "muscle", "mucosa"), (225, 150, 130), critical=False, bleeds=True),
    KnownTissue("malleus", (), (233, 0, 255)),
    KnownTissue("incus", (), (0, 255, 149)),
    KnownTissue("stapes", (), (63, 0, 255)),
    KnownTissue("ossicles", ("ossicular chain", "auditory ossicles"), (200, 120, 255)),
    KnownTissue(
        "labyrinth", ("bony labyrinth", "vestibule cochlea", "inner ear", "otic capsule"), (91, 123, 91)
    ),
    KnownTissue("cochlea", (), (120, 160, 90)),
    KnownTissue("semicircular canals", ("semicircular canal", "scc"), (60, 110, 60)),
    KnownTissue(
        "internal auditory canal",
        ("iac", "internal acoustic meatus", "internal acoustic canal", "internal auditory meatus"),
        (244, 142, 52),
        critical=False,
    ),
    KnownTissue("vestibulocochlear nerve", ("cn viii",), (230, 120, 40)),
    KnownTissue("vestibular nerve", (), (200, 130, 70)),
    KnownTissue("superior vestibular nerve", (), (255, 191, 135)),
    KnownTissue("inferior vestibular nerve", (), (121, 70, 24)),
    KnownTissue("cochlear nerve", (), (219, 244, 52)),
    KnownTissue("facial nerve", ("facial", "cn vii", "fallopian canal", "facial canal"), (244, 214, 49)),
    KnownTissue("chorda tympani", ("chorda",), (151, 131, 29)),
    KnownTissue(
        "internal carotid artery", ("ica", "carotid", "carotid artery"), (216, 100, 79), bleeds=True
    ),
    KnownTissue("sinus and dura", (), (110, 184, 209), bleeds=True),
    KnownTissue("sigmoid sinus", ("sinus", "transverse sinus"), (70, 90, 200), bleeds=True),
    KnownTissue("jugular bulb", ("jugular", "jugular vein", "internal jugular vein"), (50, 60, 160), bleeds=True),
    KnownTissue("dura", ("dura mater",), (120, 200, 220), bleeds=True),
    KnownTissue("brain", ("temporal lobe", "cerebellum"), (245, 190, 190), bleeds=True),
    KnownTissue("vestibular aqueduct", (), (91, 98, 123)),
    KnownTissue(
        "temporomandibular joint", ("tmj", "mandible", "mandibular condyle", "condyle"), (100, 0, 0),
        critical=False,
    ),
    KnownTissue(
        "external auditory canal",
        ("eac", "ear canal", "external acoustic meatus", "external auditory meatus", "external ear canal"),
        (255, 225, 214),
        critical=False,
    ),
    KnownTissue("tympanic membrane", ("eardrum",), (250, 170, 160)),
)  # fmt: skip

_UNSAID = frozenset({"and", "the", "of", "left", "right", "l", "r", "lt", "rt"})


def plain_name(name: str) -> str:
    """Name of a structure in lower case, without signs, sides and small words: Sinus_+_Dura is sinus dura."""
    return " ".join(word for word in re.findall(r"[a-z0-9]+", name.lower()) if word not in _UNSAID)


_BY_NAME = {plain_name(text): known for known in KNOWN for text in (known.name, *known.synonyms)}


def known_tissue(name: str) -> KnownTissue | None:
    """Entry of a structure in the default table; None for an unknown name."""
    return _BY_NAME.get(plain_name(name))


#: Known tissues that are empty in a bone from labels alone.
EMPTY = ("air", "external auditory canal")

#: Colours of volumetric_drilling's PNG stacks, by its names and in its order: our labels 1 to 16. Source: the
#: script for distance grids in LCSR-SICKKIDS/volumetric_drilling.
VOLUMETRIC_DRILLING: dict[str, Colour] = {
    name: _BY_NAME[plain_name(name)].colour
    for name in (
        "Bone", "Malleus", "Incus", "Stapes", "Bony_Labyrinth", "IAC", "Superior_Vestibular_Nerve",
        "Inferior_Vestibular_Nerve", "Cochlear_Nerve", "Facial_Nerve", "Chorda_Tympani", "ICA", "Sinus_+_Dura",
        "Vestibular_Aqueduct", "TMJ", "EAC",
    )
}  # fmt: skip


#: Most tissues in a bone.
MOST = 64


def default_tissues(
    labels: LabelVolume | Mapping[int, str] | Sequence[str], *, material: Material = materials["bone"]
) -> Tissues:
    """Table for named labels: colour, critical and bleeds by the structure, c_e and alpha of the bone.

    Parameters
    ----------
    labels : LabelVolume, mapping of int to str, or sequence of str
        Labels with their names; a sequence gives the labels 0, 1, 2, ... A label volume keeps its own
        colours. Names are those of common segmentations in any spelling: Facial_Nerve, "right facial nerve".
    material : Material
        c_e, alpha and f of the bone.

    Returns
    -------
    Tissues
        In the order of the labels. Label 0 without a name is "unlabelled".

    Raises
    ------
    ValueError
        If a name is not known, a label of the volume has no name, or there are more than 64 labels.

    Notes
    -----
    Only bone has a published pair of c_e and alpha. All other tissues get the bone's, and are `assumed`.

    Examples
    --------
    >>> table = default_tissues(["air", "Bone", "Facial_Nerve"])
    >>> [(t.name, t.critical, t.assumed) for t in table]
    [('air', False, True), ('bone', False, False), ('facial nerve', True, True)]
    """
    names, counts, colours = _named(labels)
    check_count(names)
    unknown = ", ".join(
        f"label {label} ({name!r}{'' if counts is None else f', {counts.get(label, 0)} voxels'})"
        for label, name in names.items()
        if known_tissue(name) is None
    )
    refuse(
        unknown,
        f"the default table does not know {unknown}; it knows {', '.join(tissue.name for tissue in KNOWN)}, and their "
        "usual synonyms: give a table of your own (read_tissues, `burrlab tissues FILE --template table.csv`)",
    )
    rows: list[Tissue] = []
    for label, file_name in sorted(names.items()):
        tissue = _BY_NAME[plain_name(file_name)]
        # The second side keeps its name in the file.
        name = file_name if tissue.name in (row.name for row in rows) else tissue.name
        rows.append(
            Tissue(name, label=label, c_e=material.c_e, alpha=material.alpha,
                   colour=colours.get(label, tissue.colour), critical=tissue.critical, bleeds=tissue.bleeds,
                   assumed=not tissue.bone)
        )  # fmt: skip
    return Tissues(rows, material)


def label_counts(values: NDArray[Any], path: str) -> dict[int, int]:
    """Number of voxels of each label, whole numbers; ValueError, which names the path, if one is negative.

    Examples
    --------
    >>> import numpy as np
    >>> label_counts(np.array([0, 0, 3]), "labels.nrrd")
    {0: 2, 3: 1}
    """
    least = int(values.min())
    refuse(least < 0, f"{path}: labels must be zero or positive, got {least}: is this a grey volume?")
    every, large = np.zeros(1 << 16, np.int64), Counter[int]()
    for plane in values.reshape(len(values), -1):  # bincount works in int64: plane by plane
        if plane.max() < every.size:
            counts = np.bincount(plane.astype(np.int64))
            every[: counts.size] += counts
        else:
            kinds, counts = np.unique(plane, return_counts=True)
            large.update(dict(zip(kinds.tolist(), counts.tolist(), strict=True)))
    large.update({label: int(every[label]) for label in np.flatnonzero(every).tolist()})
    return dict(sorted(large.items()))


def _named(
    labels: LabelVolume | Mapping[int, str] | Sequence[str],
) -> tuple[dict[int, str], dict[int, int] | None, dict[int, Colour]]:
    """Names by label; for a label volume also numbers of voxels by label, and its colours."""
    if isinstance(labels, Mapping):
        return {int(label): str(name) for label, name in labels.items()}, None, {}
    if isinstance(labels, Sequence):
        refuse(isinstance(labels, str), f"labels must be a label volume, or names, got the text {labels!r}")
        return {label: str(name) for label, name in enumerate(labels)}, None, {}
    counts = label_counts(labels.labels, labels.path)
    check_count(counts, f"{labels.path}: ")
    names = {label: labels.names.get(label, UNLABELLED if label == 0 else "") for label in counts}
    nameless = ", ".join(f"{label} ({counts[label]} voxels)" for label, name in names.items() if not name)
    refuse(
        nameless,
        f"{labels.path}: the labels {nameless} have no names in the file: give a table of tissues that says what they "
        "are (read_tissues, `burrlab tissues FILE --template table.csv`)",
    )
    for label, name in labels.names.items():  # named structures that are absent here may be in another crop
        if label not in names and known_tissue(name) is not None and len(names) < MOST:
            names[label] = name
    return names, counts, {label: colour for label, colour in labels.colours.items() if label != 0}


def check_count(labels: Mapping[int, object], prefix: str = "") -> None:
    """ValueError for more labels than a bone can have tissues, for example grey values or instances."""
    refuse(
        len(labels) > MOST,
        f"{prefix}a bone has at most {MOST} tissues, and there are {len(labels)} labels "
        f"({', '.join(map(str, sorted(labels)[:5]))}, ...): is this a grey volume, or does it hold instances? Merge "
        "labels first",
    )


GREY = (128, 128, 128)  # colour of a structure without one
_WAITS = " (name?)"  # mark after a name that the default table does not know
_WORDS = {"": None, "yes": True, "no": False, "true": True, "false": False, "1": True, "0": False}


def _label(text: str) -> int:
    refuse(
        not (text.isascii() and text.isdecimal() and len(text) < 20 and int(text) < 2**31),
        f"must be a whole number from 0, got {shown(text)}",
    )
    return int(text)


def _colour(text: str) -> Colour | None:
    refuse(text and re.fullmatch(r"#[0-9a-fA-F]{6}", text) is None, f"must be #rrggbb, got {shown(text)}")
    red_green_blue = bytes.fromhex(text[1:])
    return (red_green_blue[0], red_green_blue[1], red_green_blue[2]) if text else None


def _number(text: str, rule: str, least: float, most: float) -> float | None:
    # NaN counts as a number beyond the limits here, not as an empty field.
    value = table.number("" if text.lower().strip("+-") == "nan" else text)
    refuse(
        text and not (math.isfinite(value) and least <= value <= most), f"must be {rule}, got {shown(text)}"
    )
    return value if text else None


def _flag(text: str) -> bool | None:
    refuse(text.lower() not in _WORDS, f"must be yes or no, got {shown(text)}")
    return _WORDS[text.lower()]


TABLE = Table(
    (
        Column("label", type=_label),
        Column("name", type=str),
        Column("colour", type=_colour, optional=True),
        Column(
            "c_e",
            "N_per_mm2",
            partial(_number, rule="from 1/4096 to 1000", least=1 / 4096, most=1000.0),
            optional=True,
        ),
        Column(
            "alpha",
            "per_ms",
            partial(_number, rule="zero or positive", least=0.0, most=math.inf),
            optional=True,
        ),
        *(Column(flag, type=_flag, optional=True) for flag in ("critical", "bleeds", "assumed")),
    )
)


def read_tissues(path: str | os.PathLike[str], *, material: Material | None = None) -> Tissues:
    """Reads a table of tissues: CSV text with the columns of `write_tissues`.

    Parameters
    ----------
    path : path-like
        Columns `label` and `name` are required. An empty `colour`, `critical` or `bleeds` is taken from the
        default table by the name (else grey, no, no). An empty `c_e_N_per_mm2` or `alpha_per_ms` is the
        material's; the tissue then counts as assumed, except bone with both values empty.
    material : Material, optional
        The bone. Default: the one that `write_tissues` put into the file's comments, else
        `materials["bone"]`.

    Returns
    -------
    Tissues

    Raises
    ------
    ValueError
        If the file is no such table, a template with rows that need a name (the message names line and
        column), or of another law of force and rate than the material.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = folder.name + "/tissues.csv"
    >>> write_tissues(path, default_tissues({1: "bone", 2: "facial nerve"}))
    >>> [(tissue.label, tissue.name, tissue.critical) for tissue in read_tissues(path)]
    [(1, 'bone', False), (2, 'facial nerve', True)]
    >>> folder.cleanup()
    """
    name, text = table.text_of(path)
    own = _material(name, text)
    material = material or own or materials["bone"]
    refuse(
        own is not None and law_of(own) != law_of(material),
        f"{name}: its constants are of the law of {own!r}, not of {material!r}",
    )
    waiting: list[str] = []
    faults: list[str] = []
    rows: list[Tissue] = []
    lines: dict[str, str] = {}
    for where, texts in TABLE.rows(name, text, faults):
        if not {"label", "name"} <= texts.keys():
            break  # the headings are at fault
        tissue_name, line = texts["name"], where.removeprefix(f"{name}, ")
        flags = texts.get("critical") or texts.get("bleeds")
        # A template calls a structure without a name "structure 3", or marks its name in the file.
        if tissue_name in ("", "" if flags else f"structure {texts['label']}") or tissue_name.endswith(
            _WAITS
        ):
            waiting.append(f"{line} ({tissue_name!r})" if tissue_name else line)
            continue
        for column in ("label", "name"):
            if (before := lines.setdefault(f"{column} {texts[column]}", line)) != line:
                faults.append(f"{where}, column {column}: {shown(texts[column])} is in {before} already")
        row = TABLE.values(where, texts, faults)
        if not faults:
            rows.append(_tissue(where, row, material))
    table.refuse_all(name, faults)
    refuse(
        waiting,
        f"{name}, {', '.join(waiting)}, column name: every row needs a name, that of its structure",
    )
    with amend_error(f"{name}: "):
        return Tissues(rows, material)


def write_tissues(path: str | os.PathLike[str], tissues: Tissues) -> None:
    """Writes a table as CSV text that `read_tissues` reads without loss.

    Parameters
    ----------
    path : path-like
    tissues : Tissues
        Assumed values that equal the material's stay empty in the file.

    Raises
    ------
    ValueError
        If a name has a line break, or space around it.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import burrlab, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> from burrlab.anatomy import default_tissues
    >>> table = default_tissues({1: "bone", 2: "facial nerve"})
    >>> write_tissues(folder.name + "/table.csv", table)
    >>> read_tissues(folder.name + "/table.csv") == table
    True
    >>> folder.cleanup()
    """
    write_text(path, tissues_text(tissues))


def tissues_text(tissues: Tissues, unnamed: Collection[int] = ()) -> str:
    """Text of a table for `write_tissues`; ValueError if a name has a line break or space around it.

    Labels in `unnamed` still need a name: a grey colour and the flags that follow from a name stay empty.
    `read_tissues` refuses the names that stand in for theirs, "structure 3" and names with a mark.
    """
    rows = []
    for t in tissues:
        refuse(
            len(t.name.splitlines()) != 1 or t.name != t.name.strip(),
            f"name of a tissue must be one line without space around it, got {t.name!r}",
        )
        values = [
            "" if t.assumed and of_tissue == bone else repr(of_tissue)
            for of_tissue, bone in ((t.c_e, tissues.material.c_e), (t.alpha, tissues.material.alpha))
        ]
        flags = ["yes" if flag else "no" for flag in (t.critical, t.bleeds, t.assumed)]
        colour = "#{:02x}{:02x}{:02x}".format(*t.colour)
        if t.label in unnamed:
            colour, flags = ("" if t.colour == GREY else colour), ["", "", ""]
        mark = _WAITS if t.label in unnamed and t.name != f"structure {t.label}" else ""
        rows.append([t.label, t.name + mark, colour, *values, *flags])
    stream = io.StringIO()
    material = json.dumps(json.loads(tissues_to_json(tissues))["material"])
    columns = {column.heading: [row[i] for row in rows] for i, column in enumerate(TABLE.columns)}
    table.write(stream, {"material": material}, columns)
    return stream.getvalue()


def _material(name: str, text: str) -> Material | None:
    for line in text.splitlines():
        if line.startswith("# material:"):
            try:
                constants = json.loads(line.partition(":")[2])
                return material_of(constants, constants["name"], constants["source"])
            except UNREADABLE as error:
                raise ValueError(
                    f"{name}: the material in the comments is none: {in_one_line(error)}"
                ) from None
    return None


def _tissue(where: str, row: dict[str, Any], material: Material) -> Tissue:
    known = known_tissue(row["name"])
    stated = {key: value for key, value in row.items() if value is not None}
    constants = {"c_e", "alpha"} & stated.keys()
    # Bone with both values empty has the material's pair, which is published.
    lacking = len(constants) < 2 and not (known is not None and known.bone and not constants)
    refuse(
        lacking and stated.get("assumed") is False,
        f"{where}, column assumed: must be yes where c_e or alpha is empty, got 'no'",
    )
    usual: dict[str, Any] = {"c_e": material.c_e, "alpha": material.alpha, "assumed": lacking, "colour": GREY}
    if known is not None:
        usual |= {"colour": known.colour, "critical": known.critical, "bleeds": known.bleeds}
    return Tissue(**{"critical": False, "bleeds": False, **usual, **stated})


#: Level from which a voxel counts as bone in notes: half.
_HALF = 128

#: Scatter of the velocity in bone from labels alone, by R/voxel: standard deviation over 12 places within 0.6
#: mm [%]. Least and most of three kinds of surfaces, for labels without smoothing and for labels smoothed by
#: two voxels or more. docs/beyond_the_paper.md describes the measurement.
LABEL_SCATTER = {10: ((11, 17), (3, 6)), 20: ((6, 15), (3, 5)), 30: ((3, 10), (2, 4))}


def label_scatter(ratio: float, smooth: bool = False) -> str:
    """`LABEL_SCATTER` in words, interpolated between its rows; outside them, of the nearest row."""
    ratio = float(np.clip(ratio, min(LABEL_SCATTER), max(LABEL_SCATTER)))
    columns = zip(*(row[smooth] for row in LABEL_SCATTER.values()), strict=True)
    least, most = (np.interp(ratio, list(LABEL_SCATTER), column) for column in columns)
    return f"{least:.0f} to {most:.0f} % at R/voxel = {ratio:.3g}"


@dataclass(frozen=True, eq=False)
class LabelledBone:
    """A bone with tissues, and notes on assumptions in making it.

    Attributes
    ----------
    bone : VoxelBone
    notes : tuple of str
    """

    bone: VoxelBone
    notes: tuple[str, ...] = ()


@doing("making bone of labels")
def labelled_bone(
    source: Volume | None,
    labels: LabelVolume,
    tissues: Tissues,
    *,
    mapping: OccupancyMap | None = None,
    fill: Mapping[str, float] | None = None,
    spacing: float | ArrayLike | None = None,
    empty: Collection[str] = EMPTY,
    smooth: float | None = None,
) -> LabelledBone:
    """Bone with occupancy from grey values and tissues from labels.

    Parameters
    ----------
    source : Volume or None
        Grey values, with `mapping`; or None: label 0 and the structures in `empty` are empty, all else is solid.
    labels : LabelVolume
        On the voxels of the volume, or on a box of them; outside the box, labels are 0.
    tissues : Tissues
        Tissues of the labels. Without a row for label 0 it is "unlabelled", with the bone's values.
    mapping : OccupancyMap, optional
        Map of the grey values.
    fill : mapping of str to float, optional
        Least occupancy of a tissue's voxels, 0 to 1. A map for bone makes nerves and vessels empty, and empty
        voxels cannot be injured.
    spacing : float or (x, y, z), optional
        Spacing of the bone [mm]; default that of the volume. Occupancy is interpolated, labels are nearest.
    empty : collection of str
        Structures without bone if labels are alone, by their names in the default table: air and the ear
        canal. `fill` makes one solid.
    smooth : float, optional
        For labels alone: standard deviation of a Gaussian over the solid voxels [mm], 1 to 10 times the
        finest voxel side. The volume hardly changes; the notes say by how much. Critical structures stay
        full, and empty voxels nearest to one stay empty. Another empty voxel that gets bone also gets the
        label of the nearest solid voxel. docs/tissues.md recommends a width, docs/beyond_the_paper.md
        describes the effects.

    Returns
    -------
    LabelledBone
        In the bone frame of the volume.

    Raises
    ------
    ValueError
        If the labels are on other voxels, a label or a filled tissue is not in the table, the map is missing
        or given without grey values, or `smooth` is given with a source or out of range.
    TypeError
        If `source` is of another type.

    Examples
    --------
    >>> from burrlab.anatomy import default_tissues
    >>> labels = LabelVolume(np.array([[[0, 1, 2]]]), 0.2, (0, 0, 0), np.eye(3), "example", {1: "bone", 2: "nerve"})
    >>> made = labelled_bone(None, labels, default_tissues({1: "bone", 2: "facial nerve"}))
    >>> made.bone.density.tolist(), [t.name for t in made.bone.tissues]
    ([[[0, 255, 255]]], ['bone', 'facial nerve', 'unlabelled'])
    """
    notes = list(labels.notes)
    if source is not None:
        require_type("source", source, Volume, "read_volume('ct.nrrd')")
        refuse(smooth is not None, f"smooth goes with labels alone, got {smooth!r} beside a source")
        notes[:0] = source.notes
        labels = placed_on(labels, source)
    counts = label_counts(labels.labels, labels.path)
    tissues = _with_background(tissues, counts, labels.path)
    if spacing is not None:
        labels = labels.resample(spacing)
        counts = label_counts(labels.labels, labels.path)
    numbers = _numbers(labels.labels, tissues)
    least, filled = _filled(tissues, fill or {})
    both = np.zeros(2 * len(tissues), np.int64)  # voxels of each tissue, those below `_HALF` apart
    levels: NDArray[np.uint8] | None = None
    if source is not None:
        if mapping is None:
            raise ValueError(f"mapping must be given for the grey values of {source.path}")
        bone = source.to_bone(mapping, spacing=spacing)
    else:
        refuse(mapping is not None, "mapping must be given with grey values only")
        bone = empty_bone(labels.shape, labels.spacing, labels.bone_point(labels.origin))
        full_levels = np.array([
            0 if t.label == 0 or ((known := known_tissue(t.name)) and known.name in empty) else 255 for t in tissues
        ], np.uint8)  # fmt: skip
        smoothing_note = f"; velocities at one place scatter: {', '.join(map(label_scatter, (10, 20, 30)))} (smooth=, --smooth)"
        if smooth is not None:
            levels, numbers, smoothing_note = _smoothed(
                full_levels, numbers, tissues, labels.spacing[::-1], smooth
            )
        notes.append(
            f"occupancy from labels alone: empty where there is {', '.join(empty)} or label 0, else solid{smoothing_note}"
        )
        if levels is None:  # what a voxel holds follows from its label
            full_levels = np.maximum(full_levels, least)
            both[2 * np.arange(full_levels.size) + (full_levels >= _HALF)] = [
                counts.get(tissue.label, 0) for tissue in tissues
            ]
    for k in range(0, len(numbers), SLAB):  # slab by slab: no copies of a large volume
        plane = numbers[k : k + SLAB]
        if source is None and levels is None:
            bone.write(full_levels.take(plane), (k, 0, 0))
            continue
        part = bone.read((k, 0, 0), plane.shape) if levels is None else levels[k : k + SLAB]
        if fill or levels is not None:
            part = np.maximum(part, least[plane])
            bone.write(part, (k, 0, 0))
        both += np.bincount((2 * plane + (part >= _HALF)).ravel(), minlength=both.size)
    bone.set_tissues(tissues, numbers)
    notes += [
        *filled, *_notes_on_tissues(both, tissues, math.prod(labels.spacing)),
        *_notes_on_pieces(numbers, tissues, labels.spacing[::-1]),
    ]  # fmt: skip
    return LabelledBone(bone, tuple(notes))


def placed_on(labels: LabelVolume, volume: OnGrid) -> LabelVolume:
    """The labels on all voxels of a volume; if they cover a box of it, 0 outside the box.

    Raises
    ------
    ValueError
        If the labels are not on voxels of the volume; the message has both geometries.
    """
    offset = (volume.direction.T @ (labels.origin - volume.origin)) / volume.spacing
    start = np.rint(offset).astype(int)
    stop = start + labels.shape[::-1]
    alike = (
        np.allclose(labels.spacing, volume.spacing, rtol=1e-3)
        and np.allclose(labels.direction, volume.direction, atol=1e-3)
        and np.abs(offset - start).max() <= SAME
    )
    whole = labels.labels
    if not alike or np.any(start < 0) or np.any(stop > volume.shape[::-1]) or labels.shape == volume.shape:
        with amend_error(after="; labels.on(volume) (--onto) takes the nearest label"):
            check_same_geometry(volume, labels)
    else:
        whole = np.zeros(volume.shape, labels.labels.dtype)
        (x, y, z), (u, v, w) = start, stop
        whole[z:w, y:v, x:u] = labels.labels
    return replace(
        labels, labels=whole, spacing=volume.spacing, origin=volume.origin, direction=volume.direction
    )


def _with_background(tissues: Tissues, counts: dict[int, int], path: str) -> Tissues:
    """The table, with a row for label 0 if the labels need one; ValueError if it lacks another label."""
    known = {tissue.label for tissue in tissues}
    strange = [f"{label} ({counts[label]} voxels)" for label in counts if label not in known | {0}]
    refuse(
        strange,
        f"{path}: labels that are not in the table: {', '.join(strange[:10])}"
        f"{f' and {len(strange) - 10} more' if len(strange) > 10 else ''}; the table has "
        f"{', '.join(f'{tissue.label} {tissue.name}' for tissue in tissues)}",
    )
    if 0 in known or 0 not in counts:
        return tissues
    refuse(
        len(tissues) == MOST,
        f"the table must have a row for label 0 ({counts[0]} voxels), or one row less than {MOST}",
    )
    refuse(
        UNLABELLED in (tissue.name for tissue in tissues),
        f"the table must have {UNLABELLED!r} for label 0 only ({counts[0]} voxels)",
    )
    bone, colour = tissues.material, _BY_NAME[UNLABELLED].colour
    background = Tissue(UNLABELLED, label=0, c_e=bone.c_e, alpha=bone.alpha, colour=colour)
    return Tissues([*tissues, background], bone)


def _numbers(labels: NDArray[Any], tissues: Tissues) -> NDArray[np.uint8]:
    table_labels = np.array([tissue.label for tissue in tissues])
    if labels.dtype == np.uint8 and np.array_equal(table_labels, np.arange(table_labels.size)):
        return labels
    order = np.argsort(table_labels).astype(np.uint8)
    direct = np.zeros(1 << 16, np.uint8)
    direct[table_labels[table_labels < direct.size]] = np.flatnonzero(table_labels < direct.size)
    small = labels.dtype.itemsize <= 2 or labels.max() < direct.size
    numbers = np.empty(labels.shape, np.uint8)
    for k, plane in enumerate(labels):  # plane by plane: no large arrays of indices
        numbers[k] = direct[plane] if small else order[np.searchsorted(table_labels, plane, sorter=order)]
    return numbers


def _smoothed(
    full_levels: NDArray[np.uint8],
    numbers: NDArray[np.uint8],
    tissues: Tissues,
    apart: NDArray[Any],
    width: float,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], str]:
    """Smoothed levels, tissue numbers, and a text on how volumes change; `apart` along (z, y, x) [mm]."""
    refuse(
        not 0.999 <= width / apart.min() <= 10.001,
        f"smooth must be 1 to 10 times the finest side of a voxel, {apart.min():g} to {10 * apart.min():g} "
        f"mm, got {width!r}",
    )
    weights = [_gaussian(width / side) for side in apart]
    solid = (full_levels > 0).astype(np.uint8)
    sums = np.empty(numbers.shape, np.uint16)  # of the first axis: whole numbers up to 2^8
    for rows in slabs(sums.shape, 0):
        scipy.ndimage.correlate1d(solid.take(numbers[rows]), weights[0], 0, output=sums[rows], mode="reflect")
    owner, mark = np.empty_like(numbers), solid * np.arange(1, full_levels.size + 1).astype(np.uint8)
    for k in range(0, len(owner), SLAB):
        owner[k : k + SLAB] = mark.take(numbers[k : k + SLAB])
    for _ in range(max(map(len, weights)) // 2):
        _grow(owner)
    held = np.array([True, *(tissue.critical for tissue in tissues)])
    levels, before, after = np.empty_like(numbers), np.zeros(len(tissues)), np.zeros(len(tissues))
    for k in range(len(owner)):  # plane by plane: no large arrays of float64
        part, label, full = sums[k].astype(np.float32), numbers[k], full_levels.take(numbers[k])
        for axis in range(2):  # whole numbers up to 2^24: exact on every machine
            part = scipy.ndimage.correlate1d(part, weights[1 + axis], axis, mode="reflect")
        plane = np.floor((255.0 * part + (1 << 23)) / (1 << 24)).astype(np.uint8)
        levels[k] = plane = np.where(held.take(owner[k]), full, plane)
        owner[k] = nearest = np.where(plane > 0, owner[k] - np.uint8(1), label)
        before += np.bincount(label.ravel(), full.ravel(), len(tissues))
        after += np.bincount(nearest.ravel(), plane.ravel(), len(tissues))
    change = 100 * (after - before) / np.maximum(before, 255)
    most = int(np.argmax(np.abs(change)))
    return levels, owner, (
        f", smoothed by {width:g} mm: the volume changes by {100 * (after.sum() / max(before.sum(), 1.0) - 1):.2g} "
        f"%, that of {tissues[most].name} most, by {change[most]:.2g} %"
    )  # fmt: skip


def _grow(owner: NDArray[np.uint8]) -> None:
    """Gives each voxel of 0 the largest number of its 26 neighbours, in place."""
    before = owner[:1].copy()
    for k in range(0, len(owner), SLAB):
        slab, near = owner[k : k + SLAB], np.concatenate([before, owner[k : k + SLAB + 1]])
        before = slab[-1:].copy()
        for axis in range(3):  # `maximum_filter1d` takes 20 times as long
            low, high = (np.moveaxis(near, axis, 0)[cut] for cut in (slice(-1), slice(1, None)))
            wide = near.copy()
            up, down = (np.moveaxis(wide, axis, 0)[cut] for cut in (slice(-1), slice(1, None)))
            np.maximum(up, high, out=up)
            np.maximum(down, low, out=down)
            near = wide
        np.copyto(slab, near[1 : 1 + len(slab)], where=slab == 0)


def _gaussian(deviation: float) -> NDArray[np.float64]:
    """Weights of a Gaussian as whole numbers with the sum 256; its standard deviation is in voxels."""
    edges = np.arange(-np.ceil(4 * deviation), np.ceil(4 * deviation) + 2) - 0.5
    return np.asarray(np.trim_zeros(np.diff(np.rint(256 * scipy.special.ndtr(edges / deviation)))))


def _filled(tissues: Tissues, fill: Mapping[str, float]) -> tuple[NDArray[np.uint8], list[str]]:
    """Least level of each tissue, and notes."""
    least = np.zeros(len(tissues), np.uint8)
    names = [tissue.name for tissue in tissues]
    for name, occupancy in fill.items():
        refuse(name not in names, f"fill must be of tissues of the table ({', '.join(names)}), got {name!r}")
        refuse(
            not 0.0 <= occupancy <= 1.0,
            f"fill of {name!r} must be an occupancy from 0 to 1, got {occupancy!r}",
        )
        least[names.index(name)] = round(255 * occupancy)
    return least, [f"{name}: occupancy at least {occupancy:g}, as asked" for name, occupancy in fill.items()]


#: Volume of a nerve 2 mm thick and 32 mm long [mm^3], how often it makes a note, and what pieces of a structure
#: are far [mm] (ours).
_NERVE, _MANY, _FAR = 100.0, 3, 5.0


def _notes_on_pieces(numbers: NDArray[np.uint8], tissues: Tissues, apart: NDArray[Any]) -> list[str]:
    """Notes on critical structures in far pieces: with empty cells between them, of 5 mm or 8 voxels."""
    sides, steps = np.maximum(_FAR, 8 * apart), np.maximum(0.25 / apart, 1).astype(int)
    z, y, x = (
        (np.arange(0, count, step) * gap // side).astype(int)
        for count, step, gap, side in zip(numbers.shape, steps, apart, sides, strict=True)
    )
    held = np.zeros((len(tissues), z[-1] + 1, y[-1] + 1, x[-1] + 1), bool)
    for k, plane in zip(z, numbers[:: steps[0], :: steps[1], :: steps[2]], strict=True):
        held[plane, k, y[:, None], x] = True
    return [
        f"{tissue.name}: in {count} pieces, over {sides.min():g} mm apart"
        for tissue, where in zip(tissues, held, strict=True)
        if tissue.critical and (count := scipy.ndimage.label(where, np.ones((3, 3, 3)))[1]) > 1
    ]


def _notes_on_tissues(both: NDArray[np.int64], tissues: Tissues, volume: float) -> Iterator[str]:
    """Notes on bone without a label, critical structures without bone, and large nerves; `volume` of a voxel."""
    held = both[1::2]
    voxels = both[::2] + held
    for number, tissue in enumerate(tissues):
        if tissue.label == 0 and tissue.name == UNLABELLED and held[number]:
            yield f"{held[number]} voxels of label 0 hold bone: {UNLABELLED}, with the bone's c_e and alpha"
        if tissue.critical and voxels[number] and 2 * held[number] < voxels[number]:
            yield (
                f"{tissue.name}: {100.0 * held[number] / voxels[number]:.0f} % of its voxels are half full or more; "
                "what is empty cannot be injured (fill=, --fill)"
            )
        name = known.name if (known := known_tissue(tissue.name)) else plain_name(tissue.name)
        times = voxels[number] * volume / _NERVE
        if times > _MANY and ("nerve" in name or name == "chorda tympani"):
            yield (
                f"{tissue.name}: {times * _NERVE:.0f} mm^3, {times:.0f} times a nerve of 2 x 32 mm; is another "
                "structure in it?"
            )
