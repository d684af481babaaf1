"""Options of the commands that take a volume: file, map, box, voxels."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from burrlab._core import Burr, Material
from burrlab.anatomy.labelled_recipe import LabelledRecipe, labels_of
from burrlab.anatomy.tissue_csv import read_tissues
from burrlab.anatomy.tissue_table import default_tissues
from burrlab.cli.options import positive, refuse_options, require_options
from burrlab.specimen import Specimen
from burrlab.volume.drilled_recipe import DrilledRecipe
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.recipe import VolumeRecipe
from burrlab.volume.stack import is_stack

Recipe = VolumeRecipe | LabelledRecipe

#: Options whose values may begin with a minus.
SIGNED = ("--entry", "--axis", "--map", "--crop")
#: Options that say where a descent begins.
PLACE = ("entry", "axis")
#: Options that labels alone look at.
OF_LABELS = ("tissues", "unit", "fill", "onto", "unknown", "smooth")

Numbers = tuple[float, float, float]


def add_volume_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--volume` and what goes with it, but for --voxel, which a block has too."""
    volume = parser.add_argument_group(
        "a grey volume instead of a block (NRRD, NIfTI, MetaImage, a folder of DICOM or PNG slices; extra medical)"
    )
    volume.add_argument(
        "--volume", metavar="FILE", help="the grey volume, a file or folder; --voxel resamples it"
    )
    volume.add_argument(
        "--map", type=grey_map, metavar="LO:HI",
        help="grey values of empty and solid; or a table GREY:OCCUPANCY,GREY:OCCUPANCY,..., 0 to 1",
    )  # fmt: skip
    volume.add_argument(
        "--entry",
        type=vector,
        metavar="X,Y,Z",
        help="where the axis begins, volume's own coordinates, LPS [mm]",
    )
    volume.add_argument(
        "--axis", type=vector, metavar="X,Y,Z", help="direction of the descent (a block too; default 0,0,-1)"
    )
    volume.add_argument(
        "--spacing",
        type=spacing,
        metavar="X,Y,Z",
        help="of the volume's voxels, where its file has none, and of labels in slices [mm]",
    )
    volume.add_argument("--series", metavar="UID", help="SeriesInstanceUID in a folder with several")
    volume.add_argument(
        "--crop",
        type=box,
        metavar="X,Y,Z:X,Y,Z",
        help="two corners of the part that is kept, volume's own coordinates [mm]",
    )


def add_label_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--labels` and what goes with it."""
    labels = parser.add_argument_group(
        "labels of tissues: with --volume on its voxels, or alone, then what is labelled is solid"
    )
    labels.add_argument(
        "--labels",
        metavar="FILE",
        help="NRRD (.seg.nrrd), NIfTI, MetaImage; coloured PNG slices or their YAML file",
    )
    labels.add_argument(
        "--tissues",
        metavar="FILE.csv",
        help="what the labels are (`burrlab tissues`); default by their names",
    )
    labels.add_argument(
        "--fill", type=filling, action="append", default=[], metavar="TISSUE:OCCUPANCY",
        help="the least occupancy of a tissue, 0 to 1, where the map takes it as empty; as often as needed",
    )  # fmt: skip
    labels.add_argument(
        "--onto",
        action="store_true",
        help="labels on other voxels than the volume: bring the nearest on its own",
    )
    labels.add_argument(
        "--smooth", type=positive, metavar="MM",
        help="of labels alone: standard deviation of a Gaussian over the border of solid and empty [mm]",
    )  # fmt: skip
    add_stack_options(labels)


def add_stack_options(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Adds what coloured slices need."""
    parser.add_argument(
        "--unknown",
        type=label_or_word,
        metavar="LABEL|nearest[:NAME,NAME]",
        help="what colours in no table are, default refused: this label, or the nearest; critical structures only by name",
    )
    parser.add_argument(
        "--transpose", action=argparse.BooleanOptionalAction,
        help="the number of a pixel's row in PNG slices, grey ones too, counts along x, and not along y; default yes with a YAML file",
    )  # fmt: skip
    parser.add_argument(
        "--unit", type=positive, metavar="MM", help="of the dimensions in a YAML file [mm], default a metre"
    )


def unknown_colours(options: argparse.Namespace) -> str | int:
    """What --unknown says; they are refused without it."""
    return "refuse" if options.unknown is None else options.unknown


def transposed(options: argparse.Namespace, *paths: str | None) -> bool | None:
    """What --transpose says; ValueError where none of the files is a stack."""
    if not any(path is not None and is_stack(path) for path in paths):
        refuse_options(options, ("transpose",), "and --no-transpose go with PNG slices")
    asked: bool | None = options.transpose
    return asked


def chosen_recipe(options: argparse.Namespace, material: Material, burr: Burr | None = None) -> Recipe | None:
    """Of the options; None without --volume and --labels.

    ValueError for options that do not fit, or a burr too small for the voxels.
    """
    transpose = transposed(options, options.volume, options.labels)
    if options.labels is None:
        refuse_options(options, OF_LABELS, "goes with --labels")
        return _grey_recipe(options, burr)
    grey = None
    if options.volume is not None:
        grey = _grey_recipe(options, burr)
        refuse_options(options, ("smooth",), "goes without --volume")
    else:
        refuse_options(options, ("map", "series", "onto"), "goes with --volume")
    own = options.spacing if grey is None or _sizeless(options.labels) else None
    stack: dict[str, Any] = {
        "unknown": unknown_colours(options),
        "unit": options.unit,
        "transpose": transpose if is_stack(options.labels) else None,
    }
    if options.tissues is None:
        tissues = default_tissues(labels_of(options.labels, spacing=own, **stack), material=material)
    else:
        tissues = read_tissues(options.tissues, material=material)
    alone = {} if grey is not None else {"crop": options.crop, "voxel": _same(options.voxel)}
    recipe = LabelledRecipe(
        options.labels, tissues, grey, dict(options.fill), own, **stack, **alone, onto=options.onto,
        smooth=options.smooth,
    )  # fmt: skip
    if burr is not None:
        recipe.check_burr(burr)
    return recipe


def _sizeless(labels: str) -> bool:
    """Whether they are slices without a description, for which --spacing is the one source."""
    return is_stack(labels) and Path(labels).suffix.lower() not in (".yaml", ".yml")


def _grey_recipe(options: argparse.Namespace, burr: Burr | None) -> VolumeRecipe | None:
    if options.volume is None:
        refuse_options(options, ("map", "entry", "spacing", "series", "crop"), "goes with --volume")
        return None
    if options.map is None:
        raise ValueError("--volume needs --map")
    recipe = VolumeRecipe(
        options.volume, options.map, options.spacing, options.series, options.crop, options.voxel,
        options.transpose if is_stack(options.volume) else None,
    )  # fmt: skip
    if burr is not None:
        recipe.check_burr(burr)
    return recipe


def chosen_specimen(options: argparse.Namespace, burr: Burr, material: Material) -> Specimen | None:
    """Of a volume or labels, with --entry and --axis; None without them."""
    given = "volume" if options.volume is not None else "labels"
    if getattr(options, given) is not None:
        require_options(options, (("map",) if given == "volume" else ()) + PLACE, f"--{given}")
    recipe = chosen_recipe(options, material, burr)
    if recipe is None:
        return None
    specimen = recipe.specimen(entry=options.entry, axis=options.axis)
    say_notes(recipe)
    return specimen


def say_notes(recipe: Recipe | DrilledRecipe) -> None:
    """Prints to standard error what was assumed on the way to the bone."""
    for note in recipe.notes():
        print(f"burrlab: {note}", file=sys.stderr)


def grey_map(text: str) -> OccupancyMap:
    """LO:HI or a table."""
    try:
        return OccupancyMap.parse(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def filling(text: str) -> tuple[str, float]:
    """TISSUE:OCCUPANCY."""
    name, _, part = text.rpartition(":")
    try:
        occupancy = float(part)
    except ValueError:
        occupancy = math.nan
    if not name or not 0.0 <= occupancy <= 1.0:
        raise argparse.ArgumentTypeError(f"must be TISSUE:OCCUPANCY, 0 to 1, got '{text}'")
    return name, occupancy


def label_or_word(text: str) -> str | int:
    """A label, or "nearest", with names of structures."""
    if text in ("nearest", "refuse") or text.startswith("nearest:"):
        return text
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"must be nearest or a label, got '{text}'")
    return int(text)


def vector(text: str) -> Numbers:
    """X,Y,Z."""
    return _three(text, "X,Y,Z", text)


def spacing(text: str) -> Numbers:
    """X,Y,Z, or one number for all."""
    found = _three(text if "," in text else f"{text},{text},{text}", "positive X,Y,Z", text)
    if min(found) <= 0:
        raise argparse.ArgumentTypeError(f"must be positive X,Y,Z, got '{text}'")
    return found


def box(text: str) -> tuple[Numbers, Numbers]:
    """X,Y,Z:X,Y,Z."""
    low, _, high = text.partition(":")
    return _three(low, "X,Y,Z:X,Y,Z", text), _three(high, "X,Y,Z:X,Y,Z", text)


def _same(value: float | None) -> Numbers | None:
    return None if value is None else (value, value, value)


def _three(text: str, form: str, whole: str) -> Numbers:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be {form}, got '{whole}'") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise argparse.ArgumentTypeError(f"must be {form} of finite numbers, got '{whole}'")
    return x, y, z
