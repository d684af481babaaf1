"""The bone that the options of a command describe: its volume, its labels, and where a descent begins."""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from burrlab._core import Burr, Material, VoxelBone
from burrlab.bone.image import resampled_shape
from burrlab.bone.materials import materials
from burrlab.bone.recipe import DrilledRecipe, LabelledRecipe, VolumeRecipe, altered, usual_recipe
from burrlab.bone.slices import is_stack
from burrlab.bone.specimen import Specimen
from burrlab.bone.tissues import read_tissues
from burrlab.cli.options import Options, refuse_options, require_options, say
from burrlab.common.check import refuse
from burrlab.descent.descent import reach

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
