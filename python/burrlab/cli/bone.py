"""The bone that options describe, how a session begins on it and keeps it, and the labels of a file: burrlab tissues."""

import contextlib
import itertools
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import burrlab
from burrlab._core import Burr, Material, Tissue, Tissues, VoxelBone
from burrlab.bone.image import LabelVolume, OccupancyMap, OnGrid, Volume, resampled_shape
from burrlab.bone.kept import check_drilled, save_drilled
from burrlab.bone.materials import materials
from burrlab.bone.recipe import (
    DrilledRecipe,
    LabelledRecipe,
    VolumeRecipe,
    altered,
    block_recipe,
    labels_of,
    make_bone,
    usual_recipe,
)
from burrlab.bone.slices import is_stack
from burrlab.bone.snapshot import check_bone_file, holds_bone, save_bone
from burrlab.bone.specimen import MOST_VOXELS, Specimen
from burrlab.bone.tissues import (
    GREY,
    KNOWN,
    UNLABELLED,
    KnownTissue,
    check_count,
    known_tissue,
    label_counts,
    read_tissues,
    tissues_text,
)
from burrlab.cli.options import (
    Options,
    deliver,
    elsewhere_after,
    refuse_options,
    require_options,
    say,
)
from burrlab.common.check import amend_error, refuse
from burrlab.common.files import write_text
from burrlab.descent.descent import reach
from burrlab.theory.tool import law_of

Recipe: TypeAlias = VolumeRecipe | LabelledRecipe

#: Options that say where a descent begins.
PLACE = ("entry", "axis")
#: Options that apply to labels only.
OF_LABELS = ("tissues", "unit", "fill", "onto", "unknown", "smooth")


def unknown_colours(options: Options) -> str | int:
    """The value of --unknown; the default refuses unknown colours."""
    return "refuse" if options.unknown is None else options.unknown


def transposed(options: Options, *paths: str | None) -> bool | None:
    """The value of --transpose; ValueError where none of the files is a stack."""
    no_stack = not any(path is not None and is_stack(path) for path in paths)
    refuse_options(options, ("transpose",), "and --no-transpose go with PNG slices", no_stack)
    return None if options.transpose is None else bool(options.transpose)


def chosen_recipe(options: Options, material: Material) -> Recipe | None:
    """The recipe that the options describe; None without --volume and --labels.

    ValueError for options that contradict one another.
    """
    transpose = transposed(options, options.volume, options.labels)
    volume, labels = options.volume is not None, options.labels is not None
    for applies, names, why in (
        (not labels, OF_LABELS, "goes with --labels"),
        (volume, ("smooth",), "goes without --volume"),
        (not volume and labels, ("map", "series", "onto"), "goes with --volume"),
        (not volume and not labels, ("map", "entry", "spacing", "series", "crop"), "goes with --volume"),
    ):
        refuse_options(options, names, why, applies)
    refuse(volume and options.map is None, "--volume needs --map")
    grey = None if not volume else VolumeRecipe(
        options.volume, options.map, options.spacing, options.series, options.crop, options.voxel,
        transpose if is_stack(options.volume) else None,
    )  # fmt: skip
    return _labelled(options, material, grey, transpose) if labels else grey


def _labelled(
    options: Options, material: Material, grey: VolumeRecipe | None, transpose: bool | None
) -> LabelledRecipe:
    stack = is_stack(options.labels)
    # Only --spacing gives the size of slices without a description.
    sizeless = stack and Path(options.labels).suffix.lower() not in (".yaml", ".yml")
    settings: dict[str, Any] = {
        "grey": grey, "fill": dict(options.fill), "onto": options.onto, "smooth": options.smooth,
        **({} if grey is not None else {"crop": options.crop, "voxel": options.voxel and (options.voxel,) * 3}),
    }  # fmt: skip
    of_labels: dict[str, Any] = {
        "spacing": options.spacing if grey is None or sizeless else None, "unknown": unknown_colours(options),
        "unit": options.unit, "transpose": transpose if stack else None,
    }  # fmt: skip
    if options.tissues is None:
        return usual_recipe(options.labels, material, of_labels, **settings)
    chosen = None if material == materials["bone"] else material
    return LabelledRecipe(
        options.labels, read_tissues(options.tissues, material=chosen), **of_labels, **settings
    )


def material_on(bone: VoxelBone, material: Material) -> Material:
    """The material of a burr on a bone: where none was chosen, that of the bone's tissues."""
    return bone.tissues.material if bone.tissues is not None and material == materials["bone"] else material


def chosen_specimen(options: Options, burr: Burr, material: Material) -> Specimen | None:
    """The specimen of a volume or labels, with --entry and --axis; None without a volume or labels."""
    if options.volume is not None:
        require_options(options, ("map", *PLACE), "--volume")
    elif options.labels is not None:
        require_options(options, PLACE, "--labels")
    recipe = chosen_recipe(options, material)
    if recipe is None:
        return None
    recipe.check_burr(burr)
    recipe = _within_reach(recipe, options, burr)
    specimen = recipe.specimen(entry=options.entry, axis=options.axis)
    say_notes(recipe)
    return specimen


def _within_reach(recipe: Recipe, options: Options, burr: Burr) -> Recipe:
    """The recipe; cropped to what the descent can reach if the whole volume makes too many voxels."""
    grey = recipe.grey if isinstance(recipe, LabelledRecipe) else recipe
    if grey is None or grey.voxel is None or grey.crop is not None:
        return recipe
    volume, voxel = grey.grid(), np.array(grey.voxel)
    if np.allclose(voxel, volume.spacing, rtol=1e-9, atol=0):
        return recipe
    with contextlib.suppress(ValueError):
        resampled_shape(volume.shape, volume.spacing, voxel)
        return recipe
    whole = altered(grey, voxel=None).specimen(entry=options.entry, axis=options.axis)
    stop = burr.radius / 3 if options.stop is None else options.stop
    ends = [volume.patient_point(center) for center in reach(whole, burr, stop)]
    around = burr.radius + 2 * max(*volume.spacing, *voxel)
    low, high = np.round([np.min(ends, axis=0) - around, np.max(ends, axis=0) + around], 2).tolist()
    say(
        f"at {voxel.min():g} mm the whole volume has too many voxels, so it is cropped to what the descent can "
        f"reach (--crop={','.join(f'{x:g}' for x in low)}:{','.join(f'{x:g}' for x in high)})"
    )
    grey = altered(grey, crop=(low, high))
    return grey if isinstance(recipe, VolumeRecipe) else replace(recipe, grey=grey)


def say_notes(recipe: Recipe | DrilledRecipe) -> None:
    """Prints the assumptions about the bone to standard error."""
    for note in recipe.notes():
        say(note)


_BLOCK = (30.0, 30.0, 10.0)  # the block of a session without a volume, top at z = 0 [mm]
_GAP = 0.5  # between the burr of a simulated hand and the bone at the start [mm]
_OTHERS = ("volume", "labels", "map", "spacing", "series", "crop", "voxel", "transpose", *OF_LABELS)


@dataclass(frozen=True)
class BoneStart:
    """The bone at the start of a session, and how it is kept at the end.

    Attributes
    ----------
    bone : VoxelBone
    tick : int
        Ticks executed on the bone before.
    material : Material
    source : dict
        Recipe of the bone.
    place : mapping
        Where a simulated hand begins.
    like : Volume, LabelVolume or None
        Volume whose format is used to save the bone.
    mapping : OccupancyMap or None
        Map of its grey values.
    grid : OnGrid or None
        Geometry of the volume that the bone is made of.
    """

    bone: VoxelBone
    tick: int
    material: Material
    source: dict[str, Any]
    place: Mapping[str, Any]
    like: Volume | LabelVolume | None = None
    mapping: OccupancyMap | None = None
    grid: OnGrid | None = None

    def save(self, path: str, bone: VoxelBone, tick: int) -> None:
        """Saves the bone at the end of the session; errors as for `rescued`."""
        with rescued(path, bone, tick):
            if self.like is None:
                save_bone(path, bone, tick, source=json.dumps(self.source))
            else:
                save_drilled(path, bone, self.like, mapping=self.mapping, tick=tick)


def rescued(path: str, bone: VoxelBone, tick: int) -> contextlib.AbstractContextManager[None]:
    """Keeps a bone's exact state elsewhere if saving fails, as on a full disk; the NotKept says where."""
    return elsewhere_after(
        path, "bone.h5", lambda place: save_bone(place, bone, tick), "the bone's exact state", OSError, ValueError
    )  # fmt: skip


def chosen_start(options: Options, burr: Burr, material: Material) -> BoneStart:
    """The start that the options describe; ValueError if they do not fit or the bone could not be saved."""
    recipe = _recipe(options, material)
    if recipe is None:
        refuse(options.axis is not None, "--axis goes with --volume, --labels or --bone")
        source = _block(options.voxel or 0.1)
        _kept_as(options.save, None)
        return BoneStart(make_bone(source), 0, material, source, {"start": (0.0, 0.0, burr.radius + _GAP)})
    if "hand" in options.device:
        kind = next(kind for kind in ("bone", "volume", "labels") if getattr(options, kind) is not None)
        require_options(options, PLACE, f"--device hand with --{kind}")
    else:
        refuse_options(options, PLACE, "goes with --device hand: other devices say where the burr is")
    recipe.check_burr(burr)
    like = _kept_as(options.save, recipe)
    bone, place = _placed(options, recipe, burr)
    say_notes(recipe)
    tick = recipe.tick if isinstance(recipe, DrilledRecipe) else 0
    material = material_on(bone, material)
    source = {**recipe.plain(), "notes": list(recipe.notes())}
    grid = None if holds_bone(options.bone or "") else recipe.grid()
    return BoneStart(bone, tick, material, source, place, like, recipe.mapping, grid)


def _recipe(options: Options, material: Material) -> Recipe | DrilledRecipe | None:
    if options.bone is None:
        if options.volume is not None and options.map is None and "hand" in options.device:
            require_options(options, ("map", *PLACE), "--device hand with --volume")
        return chosen_recipe(options, material)
    refuse_options(options, _OTHERS, "goes without --bone, which has its own")
    return DrilledRecipe(options.bone)


def _block(voxel: float) -> dict[str, Any]:
    refuse(
        (voxels := math.prod(_BLOCK) / voxel**3) > MOST_VOXELS,
        f"--voxel makes a block of {voxels:.3g} voxels, and {MOST_VOXELS:.3g} are the most",
    )
    return block_recipe(
        _BLOCK, voxel, origin=[0.5 * voxel - side / 2 for side in _BLOCK[:2]] + [0.5 * voxel - _BLOCK[2]]
    )


def _placed(
    options: Options, recipe: Recipe | DrilledRecipe, burr: Burr
) -> tuple[VoxelBone, Mapping[str, Any]]:
    """The bone, and where a simulated hand begins."""
    if "hand" not in options.device:
        return recipe.bone(), {}
    specimen = recipe.specimen(entry=options.entry, axis=options.axis)
    into = specimen.axis
    return specimen.bone, {
        "start": specimen.surface - (burr.radius + _GAP) * into, "into": into,
        "along": _unit(np.cross(into, np.eye(3)[np.argmin(np.abs(into))])),
    }  # fmt: skip


def _kept_as(path: str | None, recipe: Recipe | DrilledRecipe | None) -> Volume | LabelVolume | None:
    """The volume whose format is used to save the bone; errors as for `save_drilled`."""
    if path is None:
        return None
    if holds_bone(path):
        check_bone_file(path)
        return None
    if recipe is None:
        raise ValueError(f"--save: a block has no volume: the file must end in .h5, got {path}")
    with amend_error("--save: ", kinds=(ValueError, OSError)):
        like = recipe.like()
        check_drilled(Path(path), like, recipe.mapping)
    return like


#: Structures that show the side of an ear.
_EAR = ("external auditory canal", "temporomandibular joint", "facial nerve")
#: Least cosine at which a direction counts as pointing to a side (ours).
_SURE = 0.3


def labels_table(labels: LabelVolume, tissues: Tissues | None = None) -> list[dict[str, Any]]:
    """A row for each label of a volume: voxels, volume [mm^3], name in the file, and tissue.

    Parameters
    ----------
    labels : LabelVolume
    tissues : Tissues, optional
        A table of the tissues; by default they follow from the names in the file. `tissue` is None for an
        unknown label.
    """
    counts = label_counts(labels.labels, labels.path)
    if tissues is None:
        known = {
            label: known_tissue(labels.names.get(label) or UNLABELLED * (label == 0)) for label in counts
        }
        tissue_names = {label: tissue.name for label, tissue in known.items() if tissue is not None}
    else:
        tissue_names = {0: UNLABELLED, **{tissue.label: tissue.name for tissue in tissues}}
    return [
        {
            "label": label, "voxels": count, "volume_mm3": count * float(labels.spacing.prod()),
            "name": labels.names.get(label, ""), "tissue": tissue_names.get(label),
        }
        for label, count in counts.items()
    ]  # fmt: skip


def ear_side(labels: LabelVolume, tissues: Tissues | None = None) -> dict[str, str] | None:
    """The directions of the ear canal, the jaw joint and the facial nerve's exit, and the side of the ear.

    Parameters
    ----------
    labels : LabelVolume
    tissues : Tissues, optional
        As for `labels_table`.

    Returns
    -------
    dict or None
        `lateral`, `anterior` and `inferior`, the nearest axes ("-x"), and `side`, "right" or "left"; empty
        where the three structures do not show a side. None where one of them is missing or occurs twice.

    Notes
    -----
    Lateral is the canal's long axis, away from the nerve, which passes its inner end. Anterior leads from the
    canal's middle to the joint's, across lateral. The nerve's exit is the tenth of its voxels that is
    farthest from its innermost tenth. Inferior is the side on which the exit lies of the plane through the
    canal's middle, lateral and anterior. So nothing depends on the names of axes: in the coordinates of the
    file, right-handed as LPS and RAS are, (lateral x anterior) . inferior is -1 in a right ear and +1 in a
    left one. A mirrored file shows the other ear.
    """
    known = [(row["label"], known_tissue(row["tissue"] or "")) for row in labels_table(labels, tissues)]
    clouds = []
    for name in _EAR:
        of_name = [label for label, tissue in known if tissue is not None and tissue.name == name]
        if len(of_name) != 1:
            return None
        voxels = np.argwhere(labels.labels == of_name[0])[:, ::-1]
        clouds.append((voxels * labels.spacing) @ labels.direction.T)
    canal, joint, nerve = clouds
    middle = canal.mean(axis=0)
    outwards, to_joint = _unit(middle - nerve.mean(axis=0)), _unit(joint.mean(axis=0) - middle)
    widths, axes = np.linalg.eigh((canal - middle).T @ (canal - middle))
    lateral = axes[:, 2] * np.sign(axes[:, 2] @ outwards)
    inner = _farthest(nerve, -(nerve @ lateral))
    leaving = _farthest(nerve, np.linalg.norm(nerve - inner, axis=1))
    anterior = _unit(to_joint - (to_joint @ lateral) * lateral)
    across, to_exit = np.cross(lateral, anterior), _unit(leaving - middle)
    sure = lateral @ outwards, lateral @ _unit(leaving - inner), anterior @ to_joint, abs(across @ to_exit)
    if min(sure) < _SURE or widths[1] > 0.64 * widths[2]:  # a canal as wide as long has no long axis
        return {}
    turn = np.stack([lateral, anterior, across * np.sign(across @ to_exit)])
    nearest = max(itertools.permutations(range(3)), key=lambda p: float(np.abs(turn[range(3), p]).sum()))
    signed = ["-+"[int(way[axis] > 0)] + "xyz"[axis] for way, axis in zip(turn, nearest, strict=True)]
    side = "left" if across @ to_exit > 0 else "right"
    return dict(zip(("lateral", "anterior", "inferior", "side"), (*signed, side), strict=True))


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-300))


def _farthest(points: NDArray[np.float64], far: NDArray[np.float64]) -> NDArray[np.float64]:
    """Middle of the farthest tenth of the points."""
    return np.asarray(points[far >= np.quantile(far, 0.9)].mean(axis=0))


def template(labels: LabelVolume) -> Tissues:
    """A table of a volume's labels with the default tissues of the same names; c_e and alpha are the bone's.

    ValueError if there are more labels than a bone can have tissues.
    """
    counts = label_counts(labels.labels, labels.path)
    check_count(counts, f"{labels.path}: ")
    bone = materials["bone"]
    rows: list[Tissue] = []
    for label in counts:
        name = labels.names.get(label, UNLABELLED if label == 0 else f"structure {label}").strip()
        known = known_tissue(name) or KnownTissue("", (), GREY, critical=False)
        if any(row.name == name for row in rows):
            name = f"{name} {label}"
        rows.append(
            Tissue(
                name, label=label, c_e=bone.c_e, alpha=bone.alpha,
                colour=labels.colours.get(label, known.colour), critical=known.critical, bleeds=known.bleeds,
                assumed=known.name != "bone",
            )
        )  # fmt: skip
    return Tissues(rows, bone)


def _tissue_rows(tissues: Tissues | None) -> list[dict[str, Any]]:
    """The tissues of a table, or those known by name."""
    if tissues is None:
        return [
            {"name": t.name, "colour": _hex(t.colour), "critical": t.critical, "bleeds": t.bleeds,
             "synonyms": list(t.synonyms)}
            for t in KNOWN
        ]  # fmt: skip
    return [
        {"label": t.label, "name": t.name, "colour": _hex(t.colour), "c_e_N_per_mm2": t.c_e,
         "alpha_per_ms": t.alpha, "critical": t.critical, "bleeds": t.bleeds, "assumed": t.assumed}
        for t in tissues
    ]  # fmt: skip


def _law_text(tissues: Tissues | None) -> list[str]:
    """A line on the law of a table, where it is not the paper's."""
    return [f"law: {burrlab.Law.of(tissues.material)}"] if tissues and law_of(tissues.material) else []


def do_tissues(options: Options) -> None:
    if options.file is None or options.file.lower().endswith(".csv"):
        refuse_options(
            options, ("tissues", "template", "spacing", "unit", "unknown", "transpose"), "goes with a file of labels"
        )  # fmt: skip
        tissues = None if options.file is None else read_tissues(options.file)
        rows = _tissue_rows(tissues)
        law = law_of(tissues.material) if tissues else {}
        return deliver(
            options,
            ({"file": options.file} if options.file else {}) | law | {"tissues": rows},
            "\n".join([_text(rows), *_law_text(tissues)]),
        )
    table = None if options.tissues is None else read_tissues(options.tissues)
    listed = options.unknown is None and is_stack(options.file)  # listed here, refused when a bone is made
    labels = labels_of(
        options.file, spacing=options.spacing, unknown=0 if listed else unknown_colours(options), palette=table,
        unit=options.unit, transpose=transposed(options, options.file),
    )  # fmt: skip
    label_rows = labels_table(labels, table)
    lines = [_text(label_rows), *_law_text(table)]
    if strange := [row for row in label_rows if row["tissue"] is None]:
        lines.append(
            f"{len(strange)} of {len(label_rows)} labels are no known tissue: they need a table (--template, "
            "--tissues)"
        )
    ear = ear_side(labels, table)
    if ear:
        lines.append(
            f"lateral is {ear['lateral']}, anterior {ear['anterior']}, inferior {ear['inferior']}: "
            f"a {ear['side']} ear, if the axes are LPS"
        )
    elif ear is not None:
        lines.append("canal, joint and nerve lie so that they do not tell a right ear from a left one")
    lines += [f"! {note}" for note in labels.notes]
    if listed and labels.unknown_colours:
        lines.append("colours in no table are refused where a bone is made: --unknown says what they are")
    if options.template is not None:
        lines.append(_write_template(options.template, labels))
    deliver(options, {
        "file": options.file, "labels": label_rows, "ear": ear or None, "notes": list(labels.notes),
        "unknown_colours": [dict(colour) for colour in labels.unknown_colours],
    }, "\n".join(lines))  # fmt: skip


def _write_template(file: str, labels: LabelVolume) -> str:
    """Writes a table to fill in for the labels; returns what to do with it."""
    refuse(os.path.exists(file), f"--template: {file} is there already", FileExistsError)
    rows = template(labels)
    unnamed = [t.label for t in rows if t.label != 0 and known_tissue(labels.names.get(t.label, "")) is None]
    write_text(file, tissues_text(rows, unnamed))
    return f"written {file}" + (f": name what its labels are, then --tissues {file}" if unnamed else "")


def _hex(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _text(rows: list[dict[str, Any]]) -> str:
    """A table of the rows with a header."""
    texts = [list(rows[0])] + [[_cell(value) for value in row.values()] for row in rows]
    widths = [max(len(line[i]) for line in texts) for i in range(len(texts[0]))]
    numeric = [not isinstance(value, (str, bool, list, type(None))) for value in rows[0].values()]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric, strict=True)
        ).rstrip()
        for line in texts
    )


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(value)
    if value is None or isinstance(value, bool):
        return {None: "?", True: "yes", False: "no"}[value]
    return f"{value:.5g}" if isinstance(value, float) else str(value)
