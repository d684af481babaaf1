"""A small labelled bone, grey and in labels, as files of several kinds."""

from pathlib import Path

import numpy as np
from drilled_scenes import stack
from test_segments import FIELDS, seg_nrrd

from burrlab import LabelVolume, OccupancyMap, Volume, VoxelBone, write_volume
from burrlab.bone.tissues import VOLUMETRIC_DRILLING, default_tissues, labelled_bone, write_tissues

MAP = OccupancyMap.two_point(0, 1000)
SPACING = (0.25, 0.25, 0.25)
TURNED = np.array([[0.0, 1, 0], [0, 0, -1], [1, 0, 0]])
TABLE = default_tissues({1: "bone", 4: "facial nerve"})


def anatomy_bone(*given, **options) -> VoxelBone:
    """The bone of `labelled_bone`, without its notes."""
    return labelled_bone(*given, **options).bone


def labels() -> np.ndarray:
    found = np.ones((28, 32, 36), np.uint8)
    found[:, 12:20] = 4
    found[22:] = 0
    return found


def greys() -> np.ndarray:
    noise = np.random.default_rng(3).integers(0, 400, labels().shape)
    return np.where(labels() > 0, 800 + noise, -1000).astype(np.int16)


def volume(direction: np.ndarray = TURNED) -> Volume:
    return Volume(greys(), SPACING, (5.0, -6.0, 7.0), direction, "made")


def label_file(path: Path, like: Volume) -> Path:
    write_volume(path, LabelVolume(labels(), like.spacing, like.origin, like.direction, "made"))
    return path


def coloured(folder: Path) -> Path:
    """Slices and their YAML file, with rows numbered along x, as the simulator's converter writes them."""
    colour = {
        0: (0, 0, 0, 0),
        1: (*VOLUMETRIC_DRILLING["Bone"], 255),
        4: (*VOLUMETRIC_DRILLING["Facial_Nerve"], 255),
    }
    planes = np.array([colour.get(i, (0, 0, 0, 0)) for i in range(5)], np.uint8)[labels()]
    stack(folder, planes.swapaxes(1, 2), name="plane00{:03d}.png")
    text = "VOLUME v:\n  dimensions: {x: 0.009, y: 0.008, z: 0.007}\n  images: {path: slices, prefix: plane00, format: png}\n"
    (folder.parent / "v.yaml").write_text(text)
    return folder.parent / "v.yaml"


def write_files(folder: Path) -> None:
    """Writes ct.nrrd, labels.nii.gz, a.seg.nrrd, slices with v.yaml, and the table t.csv."""
    write_volume(folder / "ct.nrrd", volume())
    label_file(folder / "labels.nii.gz", volume())
    seg_nrrd(folder / "a.seg.nrrd", labels(), FIELDS)
    coloured(folder / "slices")
    write_tissues(folder / "t.csv", TABLE)
