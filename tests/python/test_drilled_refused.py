"""What cannot be saved half-drilled, and what is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drilled_scenes import MAP, SHAPE, greys, meta, nifti, nrrd

from burrlab.bone.formats import read_labels, read_volume
from burrlab.bone.image import OccupancyMap, Volume
from burrlab.bone.kept import check_drilled, save_drilled


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
    assert (tmp_path / "a.nrrd").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.nrrd", "mine.nrrd"]


def test_an_empty_that_a_scaled_file_cannot_store(tmp_path: Path) -> None:
    """Its values are real numbers once they are read: the type that they have then holds any."""
    stored = ((greys("i4") + 1024) // 2).clip(0).astype("u2")
    volume = read_volume(nifti(tmp_path / "a.nii", stored, slope=2.0, inter=-100.0))
    below = OccupancyMap.two_point(-300, 1200)
    match = r"empty that .*a\.nii can hold, .*: it holds uint16, -100 to 130970, got -300"
    for call in (
        lambda: check_drilled(tmp_path / "b.nii", volume, below),
        lambda: save_drilled(tmp_path / "b.nii", volume.to_bone(below), volume, mapping=below),
    ):
        with pytest.raises(ValueError, match=match):
            call()
    assert [path.name for path in tmp_path.iterdir()] == ["a.nii"]
    assert check_drilled(tmp_path / "b.mha", volume, below) is None  # has no slope
    labels = read_labels(nifti(tmp_path / "l.nii", np.ones(SHAPE, "u1"), slope=1.0, inter=5.0))
    with pytest.raises(
        ValueError, match=r"labels must have a 0 that .*l\.nii can hold, .* uint8, 5 to 260, got 0"
    ):
        check_drilled(tmp_path / "b.nii", labels)
    volume = read_volume(nifti(tmp_path / "c.nii", greys("f4")))
    far = OccupancyMap.two_point(-1e300, 1200)
    with pytest.raises(ValueError, match="it holds float32, got -1e"):
        check_drilled(tmp_path / "b.nii", volume, far)


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


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"encoding: raw", b"encoding: hex", "encoding of the NRRD file must be raw or gzip to keep its header, got 'hex'"),
        (b"type: short", b"type: block", "type of the NRRD file must be one of whole or real numbers, got 'block'"),
        (b"kinds:", b"data file: x.raw\nkinds:", "the values must follow the NRRD header in the same file"),
        (b"kinds:", b"byte skip: -1\nkinds:", "the values must follow the NRRD header in the same file"),
        (b"\n\n", b"\n", "the values must follow the NRRD header in the same file"),
    ],
)  # fmt: skip
def test_nrrd_headers_that_cannot_be_kept(tmp_path: Path, old: bytes, new: bytes, match: str) -> None:
    from burrlab.bone.formats import read_stored

    path = nrrd(tmp_path / "a.nrrd", np.zeros(SHAPE, "i2"))
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(ValueError, match=match):
        read_stored(path)


@pytest.mark.parametrize("name", ["a.nrrd", "a.mha"])
def test_a_header_that_cannot_be_kept_is_told_before_there_is_a_bone(tmp_path: Path, name: str) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    text = " ".join(map(str, greys().ravel())).encode() + b"\n"
    path = nrrd(tmp_path / name, greys()) if name == "a.nrrd" else meta(tmp_path / name, greys(), False)
    head = path.read_bytes()[: -greys().nbytes].replace(b"encoding: raw", b"encoding: ascii")
    path.write_bytes(head.replace(b"BinaryData = True", b"BinaryData = False") + text)
    volume = read_volume(path)
    np.testing.assert_array_equal(volume.values, greys())
    match = "encoding of the NRRD file must be raw or gzip|must hold binary numbers right after its header"
    with pytest.raises(ValueError, match=match):
        check_drilled(tmp_path / f"b{path.suffix}", volume, MAP)
    part = volume.crop_voxels((1, 1, 1), SHAPE)  # gets a new header
    for target, like in ((f"b{path.suffix}", part), ("b.nii", volume)):
        assert check_drilled(tmp_path / target, like, MAP) is None


def test_other_headers_that_cannot_be_kept(tmp_path: Path) -> None:
    from burrlab.bone.formats import read_stored

    path = meta(tmp_path / "a.mha", greys(), True)
    content = path.read_bytes()
    for old, new, match in (
        (b"LOCAL", b"a.raw", "the values must follow the MetaImage header in the same file"),
        (b"BinaryData = True", b"BinaryData = False", "must hold binary numbers right after its header"),
        (
            b"MET_SHORT",
            b"MET_STRING",
            "ElementType of the MetaImage header must be one of .*, got 'MET_STRING'",
        ),
        (content[-40:], b"", "the compressed data is cut short or damaged"),
    ):
        path.write_bytes(content.replace(old, new, 1))
        with pytest.raises(ValueError, match=match):
            read_stored(path)
    path = nifti(tmp_path / "a.nii", greys())
    content = path.read_bytes()
    path.write_bytes(content[:-2])
    with pytest.raises(ValueError, match=f"the file is cut short: {len(content) - 370} bytes of values of"):
        read_stored(path)
    path.write_bytes(content[:344] + b"ni1" + content[347:])
    with pytest.raises(ValueError, match="the values must follow the NIfTI header in the same file"):
        read_stored(path)
