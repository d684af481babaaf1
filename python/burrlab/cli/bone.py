"""The bone of a session from the command line: which it is, and where it is kept at the end."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from burrlab._core import Burr, Material, VoxelBone
from burrlab.cli.options import refuse_options, require_options
from burrlab.cli.output import not_kept
from burrlab.cli.volume import OF_LABELS, PLACE, Recipe, chosen_recipe, say_notes
from burrlab.materials import materials
from burrlab.session.network import block_recipe, make_bone
from burrlab.session.snapshot import check_bone_file, save_bone
from burrlab.specimen import MOST_VOXELS
from burrlab.volume.drilled import save_drilled
from burrlab.volume.drilled_checks import check_drilled
from burrlab.volume.drilled_recipe import DrilledRecipe
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.volume import Volume

_BLOCK = (30.0, 30.0, 10.0)  # of the block that a session burrs unless a volume is given, top at z = 0 [mm]
_GAP = 0.5  # between the burr of a simulated hand and the bone at the start [mm]
_OTHERS = ("volume", "labels", "map", "spacing", "series", "crop", "voxel", "transpose", *OF_LABELS)


def add_bone_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--bone` and `--save`."""
    kept = parser.add_argument_group("a bone that is kept, half-drilled")
    kept.add_argument(
        "--save", metavar="FILE",
        help="keep the bone at the end: in the volume's format and with its header (.nrrd, .nii, .nii.gz, .mha; a new folder for PNG "
        "slices or DICOM), with the exact state beside it; or .h5, the exact state alone",
    )  # fmt: skip
    kept.add_argument("--bone", metavar="FILE", help="go on with a bone that --save has kept")


@dataclass(frozen=True)
class Start:
    """What a session begins with.

    Attributes
    ----------
    bone : VoxelBone
    tick : int
        Ticks executed on it before.
    material : Material
    source : dict
        Its recipe.
    place : mapping
        Where a simulated hand begins.
    like : Volume, LabelVolume or None
        In whose format it is saved.
    mapping : OccupancyMap or None
        Of its grey values.
    """

    bone: VoxelBone
    tick: int
    material: Material
    source: dict[str, Any]
    place: Mapping[str, Any]
    like: Volume | LabelVolume | None = None
    mapping: OccupancyMap | None = None

    def save(self, path: str, bone: VoxelBone, tick: int) -> None:
        """Keeps the bone at the end of the session; errors as `rescued`."""
        with rescued(path, bone, tick):
            if self.like is None:
                save_bone(path, bone, tick, source=json.dumps(self.source))
            else:
                save_drilled(path, bone, self.like, mapping=self.mapping, tick=tick)


@contextlib.contextmanager
def rescued(path: str, bone: VoxelBone, tick: int) -> Iterator[None]:
    """Where a bone cannot be kept as asked, as on a full disk, keeps its exact state elsewhere; the NotKept says where."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise not_kept(
            path, "bone.h5", error, lambda place: save_bone(place, bone, tick), "the bone's exact state"
        ) from error


def chosen_start(options: argparse.Namespace, burr: Burr, material: Material) -> Start:
    """Of the options; ValueError where they do not fit, or the bone could not be saved as asked."""
    recipe = _recipe(options, material)
    if recipe is None:
        if options.axis is not None:
            raise ValueError("--axis goes with --volume, --labels or --bone")
        source = _block(options.voxel or 0.1)
        like, mapping = _kept_as(options.save, None)
        place: Mapping[str, Any] = {"start": (0.0, 0.0, burr.radius + _GAP)}
        return Start(make_bone(source), 0, material, source, place, like, mapping)
    _check_place(options)
    recipe.check_burr(burr)
    like, mapping = _kept_as(options.save, recipe)
    bone, place = _placed(options, recipe, burr)
    say_notes(recipe)
    source = {**recipe.plain(), "notes": list(recipe.notes())}
    tick = 0
    if isinstance(recipe, DrilledRecipe):
        tick = recipe.tick
        if bone.tissues is not None and material == materials["bone"]:  # the default: the bone knows its own
            material = bone.tissues.material
    return Start(bone, tick, material, source, place, like, mapping)


def _recipe(options: argparse.Namespace, material: Material) -> Recipe | DrilledRecipe | None:
    if options.bone is None:
        if options.volume is not None and options.map is None and "hand" in options.device:
            require_options(options, ("map", *PLACE), "--device hand with --volume")
        return chosen_recipe(options, material)
    refuse_options(options, _OTHERS, "goes without --bone, which has its own")
    return DrilledRecipe(options.bone)


def _check_place(options: argparse.Namespace) -> None:
    if "hand" not in options.device:
        refuse_options(options, PLACE, "goes with --device hand: other devices say where the burr is")
        return
    given = next(kind for kind in ("bone", "volume", "labels") if getattr(options, kind) is not None)
    require_options(options, PLACE, f"--device hand with --{given}")


def _block(voxel: float) -> dict[str, Any]:
    if (voxels := math.prod(_BLOCK) / voxel**3) > MOST_VOXELS:
        raise ValueError(f"--voxel makes a block of {voxels:.3g} voxels, and {MOST_VOXELS:.3g} are the most")
    return block_recipe(
        _BLOCK, voxel, origin=[0.5 * voxel - side / 2 for side in _BLOCK[:2]] + [0.5 * voxel - _BLOCK[2]]
    )


def _placed(
    options: argparse.Namespace, recipe: Recipe | DrilledRecipe, burr: Burr
) -> tuple[VoxelBone, Mapping[str, Any]]:
    """The bone, and where a simulated hand begins."""
    if "hand" not in options.device:
        return recipe.bone(), {}
    specimen = recipe.specimen(entry=options.entry, axis=options.axis)
    across = np.cross(specimen.axis, np.eye(3)[np.argmin(np.abs(specimen.axis))])
    start = specimen.surface - (burr.radius + _GAP) * specimen.axis
    return specimen.bone, {
        "start": start, "into": specimen.axis, "along": across / np.linalg.norm(across),
    }  # fmt: skip


def _kept_as(
    path: str | None, recipe: Recipe | DrilledRecipe | None
) -> tuple[Volume | LabelVolume | None, OccupancyMap | None]:
    """In which volume's format the bone is saved, and its map; errors as `save_drilled`, before any work."""
    if path is None:
        return None, None
    if Path(path).suffix.lower() == ".h5":
        check_bone_file(path)
        return None, None
    if recipe is None:
        raise ValueError(f"--save: a block has no volume: the file must end in .h5, got {path}")
    try:
        like = recipe.like()
        check_drilled(Path(path), like, recipe.mapping)
    except (ValueError, OSError) as error:
        raise ValueError(f"--save: {error}") from None
    return like, recipe.mapping
