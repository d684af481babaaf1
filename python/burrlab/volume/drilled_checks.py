"""What is looked at before a half-drilled volume is saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from burrlab._core import VoxelBone
from burrlab.files import check_folder
from burrlab.session.snapshot import load_bone
from burrlab.volume.coding import Coding
from burrlab.volume.drilled_dicom import check_series
from burrlab.volume.drilled_pair import check_name, followed, is_drilled, own_sidecar, sidecars
from burrlab.volume.drilled_stack import check_whole_stack, stack_slices
from burrlab.volume.drilled_values import check_header, file_ending, grey_of_levels
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.png_files import Slices
from burrlab.volume.stored import ENDINGS
from burrlab.volume.volume import Volume


def check_drilled(
    target: Path, like: Volume | LabelVolume, mapping: OccupancyMap | None = None
) -> Slices | None:
    """The errors of `save_drilled` that can be told before there is a bone; the slices of a stack that is saved as one."""
    target = followed(target)
    check_folder(target)
    if Path(like.path).exists() and target.exists() and target.samefile(like.path) and not is_drilled(target):
        raise ValueError(f"path must be another file than the original {like.path}")
    empty = None
    if isinstance(like, LabelVolume):
        if mapping is not None:
            raise ValueError(f"mapping must be given for grey values only, and {like.path} holds labels")
    elif mapping is None:
        raise ValueError(f"mapping must be given: that with which the bone was made of {like.path}")
    else:
        empty = float(grey_of_levels(mapping)[0])
        Coding(like.values.dtype).check(empty, like.path)
    if is_series(target, like):
        if target.suffix.lower() in (".dcm", ".dicom", ".ima"):
            raise ValueError(f"path must be a new folder for a DICOM series, and not one file, got {target}")
        _check_new_folder(target)
        check_series(like, empty)
        return None
    slices = None if target.name.lower().endswith(ENDINGS) else stack_slices(like.path)
    if slices is None:
        file_ending(target)
        check_name(target)
        if target.exists() and not is_drilled(target):
            raise FileExistsError(f"path must be a new file or one of save_drilled, {target} is neither")
        check_header(target, like, mapping)
        return None
    check_whole_stack(slices, like)
    _check_new_folder(target)
    return slices


def _check_new_folder(target: Path) -> None:
    if target.exists():
        raise FileExistsError(f"path must be a new folder, {target} is there")


def is_series(target: Path, like: Volume | LabelVolume) -> bool:
    """Whether it is to be a folder of DICOM slices."""
    return bool(like.files) and not target.name.lower().endswith(ENDINGS)


def check_place(bone: VoxelBone, like: Volume | LabelVolume) -> None:
    """ValueError unless a bone is on the voxels of a volume."""
    where = like.bone_point(like.origin)
    small = 1e-2 * like.spacing
    if (
        bone.shape != like.shape
        or np.any(np.abs(np.array(bone.spacing) - like.spacing) > 1e-3 * like.spacing)
        or np.any(np.abs(np.array(bone.origin) - where) > small)
    ):
        raise ValueError(
            f"bone must be on the voxels of {like.path}: it has shape {bone.shape}, spacing {_three(bone.spacing)} and origin "
            f"{_three(bone.origin)} mm, and the volume {like.shape}, {_three(like.spacing)} and {_three(where)} mm"
        )


def check_original(bone: VoxelBone, like: Volume | LabelVolume) -> None:
    """A half-drilled volume will do for the original while nothing grew on it since."""
    source = Path(like.path)
    if not source.exists() or not sidecars(source):
        return
    try:
        beside, _ = own_sidecar(source)
    except ValueError:
        return
    before, _ = load_bone(beside)
    if before.shape == bone.shape and (more := int(np.count_nonzero(bone.density > before.density))):
        raise ValueError(
            f"like must be the original: {like.path} is half-drilled, and {more} voxels of it have less than the bone"
        )


def _three(values: Any) -> str:
    return "(" + ", ".join(f"{float(v):.6g}" for v in values) + ")"
