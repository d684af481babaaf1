"""Options of the commands that take a volume: file, map, box, voxels."""

from __future__ import annotations

import argparse
import math

from burrlab._core import Burr
from burrlab.specimen import Specimen
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.recipe import VolumeRecipe

#: Options whose values may begin with a minus.
SIGNED = ("--entry", "--axis", "--map", "--crop")

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
        "--entry", type=vector, metavar="X,Y,Z", help="where the axis begins, volume's own coordinates [mm]"
    )
    volume.add_argument(
        "--axis", type=vector, metavar="X,Y,Z", help="direction of the descent (a block too; default 0,0,-1)"
    )
    volume.add_argument(
        "--spacing",
        type=spacing,
        metavar="X,Y,Z",
        help="of the volume's voxels, where its file has none [mm]",
    )
    volume.add_argument("--series", metavar="UID", help="SeriesInstanceUID in a folder with several")
    volume.add_argument(
        "--crop",
        type=box,
        metavar="X,Y,Z:X,Y,Z",
        help="two corners of the part that is kept, volume's own coordinates [mm]",
    )


def chosen_recipe(options: argparse.Namespace, burr: Burr | None = None) -> VolumeRecipe | None:
    """Of the options; None without --volume. ValueError for options that do not fit, or a burr too small for the voxels."""
    if options.volume is None:
        for name in ("map", "entry", "spacing", "series", "crop"):
            if getattr(options, name) is not None:
                raise ValueError(f"--{name} goes with --volume")
        return None
    if options.map is None:
        raise ValueError("--volume needs --map")
    recipe = VolumeRecipe(
        options.volume, options.map, options.spacing, options.series, options.crop, options.voxel
    )
    if burr is not None:
        recipe.check_burr(burr)
    return recipe


def chosen_specimen(options: argparse.Namespace, burr: Burr) -> Specimen | None:
    """Of a volume, with its --entry and --axis; None without --volume."""
    if options.volume is not None:
        for name in ("map", "entry", "axis"):
            if getattr(options, name) is None:
                raise ValueError(f"--volume needs --{name}")
    recipe = chosen_recipe(options, burr)
    return None if recipe is None else recipe.specimen(entry=options.entry, axis=options.axis)


def grey_map(text: str) -> OccupancyMap:
    """LO:HI or a table."""
    try:
        return OccupancyMap.parse(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


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


def _three(text: str, form: str, whole: str) -> Numbers:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be {form}, got '{whole}'") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise argparse.ArgumentTypeError(f"must be {form} of finite numbers, got '{whole}'")
    return x, y, z
