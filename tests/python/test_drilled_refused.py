"""What cannot be saved half-drilled, and what is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drilled_scenes import MAP, SHAPE, greys, nifti, nrrd

from burrlab.bone.formats import read_volume
from burrlab.bone.image import OccupancyMap, Volume
from burrlab.bone.kept import save_drilled


def test_bad_saves_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    bone = volume.to_bone(MAP)
    before = (tmp_path / "a.nrrd").read_bytes()

    def refused(kind: type[Exception], match: str, path: str = "b.nrrd", **changes: Any) -> None:
        options = {"bone": bone, "like": volume, "mapping": MAP, **changes}
        with pytest.raises(kind, match=match):
            save_drilled(tmp_path / path, options.pop("bone"), options.pop("like"), **options)

    refused(ValueError, "mapping must be given: that with which the bone was made of", mapping=None)
    refused(ValueError, "tick must be a whole number", tick=-1)
    refused(ValueError, "path must be another file than the original", "a.nrrd")
    refused(ValueError, r"path must end in .nrrd, .nii, .nii.gz or .mha, got .*b.txt", "b.txt")
    refused(FileNotFoundError, "folder must exist", "none/b.nrrd")
    refused(ValueError, "name of at most 225 bytes, .*, got 226", "x" * 221 + ".nrrd")
    (tmp_path / "mine.nrrd").write_text("something else")
    refused(
        FileExistsError,
        r"path must be a new file or one of save_drilled, .*mine.nrrd is neither",
        "mine.nrrd",
    )
    other = volume.crop_voxels((0, 0, 0), (5, 5, 5))
    refused(
        ValueError, r"bone must be on the voxels of .*: it has shape \(5, 5, 5\)", bone=other.to_bone(MAP)
    )
    refused(ValueError, "map must rise from 0", mapping=OccupancyMap.table((0, 1, 2), (0, 1, 0)))
    below = OccupancyMap.two_point(-100, 180)
    small = Volume(np.full(SHAPE, 200, np.uint8), (0.3, 0.4, 0.5), (0, 0, 0), np.eye(3), "small")
    refused(
        ValueError, "map must have a grey value of empty that small can hold, .*: it holds uint8, got -100",
        bone=small.to_bone(below), like=small, mapping=below,
    )  # fmt: skip
    far, real = (
        OccupancyMap.two_point(-1e300, 1200),
        Volume(greys("f4"), (0.3, 0.4, 0.5), (0, 0, 0), np.eye(3), "real"),
    )
    refused(ValueError, "it holds float32, got -1e", bone=real.to_bone(far), like=real, mapping=far)
    assert (tmp_path / "a.nrrd").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.nrrd", "mine.nrrd"]


@pytest.mark.parametrize("slope", [1.0, -1.0])
def test_what_was_removed_is_empty_after_rounding(tmp_path: Path, slope: float) -> None:
    """A steep map about half a grey value: rounded to the nearest, nothing left would be half full."""
    values = np.full(SHAPE, 30, "i2")
    volume = read_volume(nifti(tmp_path / "a.nii", (values * slope).astype("i2"), slope=slope))
    steep = OccupancyMap.two_point(10.6, 11.2)
    bone = volume.to_bone(steep)
    density = bone.density.copy()
    density[3:5] = 0
    bone.restore(density)
    save_drilled(tmp_path / "b.nii", bone, volume, mapping=steep)
    np.testing.assert_array_equal(steep.levels(read_volume(tmp_path / "b.nii").values), density)
