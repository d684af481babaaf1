"""DICOM series: read in order of position, and refused with a sentence where they make no volume."""

from __future__ import annotations

import contextlib
import io
import os

import numpy as np
import pytest
from PIL import Image

import burrlab

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pydicom = pytest.importorskip("pydicom", reason="makes the series and is the independent reader, extra `dev`")
from dicom_series import write_series, write_slice  # noqa: E402
from pydicom.encaps import encapsulate  # noqa: E402

VALUES = (np.arange(6 * 4 * 5).reshape(6, 4, 5) * 7 - 300).astype(np.int16)
ROWS, COLUMNS = (0.6, 0.8, 0.0), (-0.8, 0.6, 0.0)


@pytest.fixture
def folder(tmp_path):
    write_series(tmp_path / "ct", VALUES)
    return tmp_path / "ct"


def test_values_and_geometry(folder):
    volume = burrlab.read_volume(folder)
    np.testing.assert_array_equal(volume.values, VALUES)
    np.testing.assert_allclose(volume.spacing, (0.25, 0.5, 0.75), rtol=1e-12)  # PixelSpacing is rows, columns
    np.testing.assert_array_equal(volume.origin, (1, 2, 3))
    np.testing.assert_array_equal(volume.direction, np.eye(3))
    one = pydicom.dcmread(folder / "slice002.dcm")
    np.testing.assert_array_equal(volume.values[2], one.pixel_array)
    voxel = volume.patient_point(volume.bone_point(volume.origin) + (0, 0, 2 * volume.spacing[2]))
    np.testing.assert_allclose(voxel, [float(p) for p in one.ImagePositionPatient], rtol=1e-12)


@pytest.mark.parametrize("step", [0.75, -0.75])
def test_turned_and_with_names_in_another_order(tmp_path, step):
    names = ["c.dcm", "a.dcm", "f.dcm", "b.dcm", "d", "e.ima"]  # of no order, some without the usual ending
    write_series(tmp_path / "ct", VALUES, names=names, rows=ROWS, columns=COLUMNS, step=step)
    volume = burrlab.read_volume(tmp_path / "ct")
    np.testing.assert_array_equal(volume.values, VALUES if step > 0 else VALUES[::-1])
    np.testing.assert_allclose(volume.direction, np.column_stack([ROWS, COLUMNS, (0, 0, 1)]), atol=1e-12)
    lowest = 3.0 if step > 0 else 3.0 - 5 * 0.75
    np.testing.assert_allclose(volume.origin, (1, 2, lowest), rtol=1e-12)
    files = [tmp_path / "ct" / name for name in sorted(names)]
    np.testing.assert_array_equal(burrlab.read_volume(files).values, volume.values)
    assert "6 files in" in burrlab.read_volume(files).path


def test_slope_and_intercept_of_each_slice(tmp_path):
    for k, slope in enumerate((1.0, 0.5, 2.0)):
        write_series(
            tmp_path / "ct", VALUES[k : k + 1], names=[f"{k}.dcm"], first=(0, 0, k), RescaleSlope=str(slope), RescaleIntercept="-1024"
        )  # fmt: skip
    wanted = VALUES[:3] * np.array([1.0, 0.5, 2.0])[:, None, None] - 1024
    np.testing.assert_array_equal(burrlab.read_volume(tmp_path / "ct").values, wanted)


def test_several_series(folder):
    write_series(folder, VALUES[:4], series="9.8.7", names=[f"o{k}.dcm" for k in range(4)])
    with pytest.raises(
        ValueError,
        match=r"series must say which of 2 DICOM series: 1\.2\.3\.4 \(6 files\), 9\.8\.7 \(4 files\)",
    ):
        burrlab.read_volume(folder)
    assert burrlab.read_volume(folder, series="9.8.7").shape == (4, 4, 5)
    with pytest.raises(ValueError, match=r"series must be one of .*, got 5\.5"):
        burrlab.read_volume(folder, series="5.5")


def test_a_missing_slice_is_named(folder):
    (folder / "slice003.dcm").unlink()
    with pytest.raises(
        ValueError,
        match=r"1 slice is missing: 1\.5 mm between slices 2 and 3 \(slice002\.dcm at 4\.5 mm, slice004\.dcm at 6 mm\), where "
        r"others are 0\.75 mm apart",
    ):
        burrlab.read_volume(folder)
    (folder / "slice002.dcm").unlink()
    with pytest.raises(ValueError, match=r"2 slices are missing: 2\.25 mm between slices 1 and 2"):
        burrlab.read_volume(folder)


@pytest.mark.parametrize("lost", [(1, 3), (1, 4), (2, 4)])
def test_more_than_one_gap(folder, lost):
    for k in lost:
        (folder / f"slice{k:03d}.dcm").unlink()
    with pytest.raises(
        ValueError,
        match=rf"2 slices are missing: 1\.5 mm between slices {lost[0] - 1} and {lost[0]} .*0\.75 mm apart",
    ):
        burrlab.read_volume(folder)


def test_a_gap_among_three(folder):
    some = [folder / f"slice{k:03d}.dcm" for k in (3, 0, 1)]
    with pytest.raises(ValueError, match=r"1 slice is missing: 1\.5 mm between slices 1 and 2"):
        burrlab.read_volume(some)


def test_what_may_be_lost_at_even_distances_is_noted(folder, tmp_path):
    for k in (1, 3, 5):
        (folder / f"slice{k:03d}.dcm").unlink()
    volume = burrlab.read_volume(folder)
    assert volume.spacing[2] == pytest.approx(1.5)
    assert volume.notes == ("the slices are numbered 1 to 5, of which 2 are absent: slices may be missing",)
    write_series(tmp_path / "end", VALUES[:4], ImagesInAcquisition="6")
    assert burrlab.read_volume(tmp_path / "end").notes == (
        "the DICOM headers count 6 images in the acquisition, 4 are there: slices may be missing",
    )


def test_files_that_are_no_dicom_are_noted(folder):
    for name in ("notes.txt", "IM0007"):
        (folder / name).write_text("cut short")
    assert burrlab.read_volume(folder).notes == (
        "2 files of the folder left out, as no DICOM: IM0007, notes.txt",
    )


def test_uneven_slices(folder):
    write_slice(folder / "slice003.dcm", VALUES[3], (1, 2, 3 + 3 * 0.75 + 0.2), series="1.2.3.4")
    with pytest.raises(ValueError, match=r"not evenly spaced: 0\.95 mm between slices 2 and 3"):
        burrlab.read_volume(folder)


def test_two_slices_at_one_place(folder):
    write_slice(folder / "twin.dcm", VALUES[0], (1, 2, 3.75), series="1.2.3.4")
    with pytest.raises(
        ValueError, match=r"two slices lie at the same position, 3\.75 mm .*: slice001\.dcm and twin\.dcm"
    ):
        burrlab.read_volume(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"pixels": np.zeros((4, 6))},
            r"different sizes: \(5, 4\) in slice000\.dcm, \(6, 4\) in slice003\.dcm",
        ),
        (
            {"spacing": (0.5, 0.3)},
            r"different pixel spacings: \(0\.25, 0\.5\) in slice000\.dcm, \(0\.3, 0\.5\) in",
        ),
        (
            {"rows": ROWS, "columns": COLUMNS},
            r"different orientations: \(1, 0, 0, 0, 1, 0\) in slice000\.dcm",
        ),
    ],
)
def test_slices_that_are_not_alike(folder, changes, message):
    changes = dict(changes)
    pixels = changes.pop("pixels", VALUES[3])
    write_slice(folder / "slice003.dcm", pixels, (1, 2, 3 + 3 * 0.75), series="1.2.3.4", **changes)
    with pytest.raises(ValueError, match=message):
        burrlab.read_volume(folder)


def test_a_gantry_tilt_is_refused(tmp_path):
    for k, pixels in enumerate(VALUES):
        (tmp_path / "ct").mkdir(exist_ok=True)
        write_slice(tmp_path / "ct" / f"{k}.dcm", pixels, (0, 0.1 * k, k), series="1.2")
    with pytest.raises(ValueError, match=r"sheared, by a gantry tilt of 5\.71 degrees: 0\.5 mm sideways"):
        burrlab.read_volume(tmp_path / "ct")


@pytest.mark.parametrize("lost", [1, 2, 25, 40])
def test_a_truncated_file(folder, lost):
    path = folder / "slice004.dcm"
    path.write_bytes(path.read_bytes()[:-lost])
    with pytest.raises(ValueError, match=r"slice004\.dcm: (cannot be read as a DICOM image|the pixel data)"):
        burrlab.read_volume(folder)


def test_pixel_data_shorter_than_the_header_says(folder):
    write_slice(
        folder / "slice004.dcm", VALUES[4], (1, 2, 6), series="1.2.3.4", PixelData=VALUES[4].tobytes()[:-8]
    )
    with pytest.raises(ValueError, match=r"slice004\.dcm: (cannot be read as a DICOM image|the pixel data)"):
        burrlab.read_volume(folder)


def test_what_a_codec_prints_is_said_and_nothing_else(tmp_path, capfd):
    image, place = io.BytesIO(), tmp_path / "a.dcm"
    pixels = np.random.default_rng(1).integers(0, 256, (32, 40)).astype(np.uint8)
    Image.fromarray(pixels).save(image, "JPEG", quality=95)
    eight = {"BitsAllocated": 8, "BitsStored": 8, "HighBit": 7, "PixelRepresentation": 0}
    write_slice(place, pixels, (0, 0, 0), series="1.2", **eight)
    packed = image.getvalue()
    for name, data in (("whole", packed), ("torn", packed[:800] + bytes(30) + packed[830:])):
        found = pydicom.dcmread(place)
        found.PixelData = encapsulate([data])
        found["PixelData"].VR, found["PixelData"].is_undefined_length = "OB", True
        found.file_meta.TransferSyntaxUID = pydicom.uid.JPEGBaseline8Bit
        found.save_as(tmp_path / f"{name}.dcm")
    near = burrlab.read_volume(tmp_path / "whole.dcm", spacing=(0.25, 0.5, 1.0)).values[0].astype(int)
    assert np.abs(near - pixels).max() < 40
    with pytest.raises(ValueError, match=r"torn.dcm: the pixel data of the slice is damaged \(Corrupt JPEG"):
        burrlab.read_volume(tmp_path / "torn.dcm", spacing=(0.25, 0.5, 1.0))
    os.write(2, b"kept")  # the descriptor is where it was
    assert capfd.readouterr() == ("", "kept")


@pytest.mark.parametrize(("lost", "match"), [(0, ""), (8, r"slice004\.dcm: the pixel data is cut short")])
def test_big_endian_slices(folder, lost, match):
    path = folder / "slice004.dcm"
    part = pydicom.dcmread(path)
    part.PixelData = VALUES[4].astype(">i2").tobytes()[: VALUES[4].size * 2 - lost]
    part.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRBigEndian
    pydicom.dcmwrite(path, part, implicit_vr=False, little_endian=False)
    with pytest.raises(ValueError, match=match) if lost else contextlib.nullcontext():
        np.testing.assert_array_equal(burrlab.read_volume(folder).values, VALUES)


def test_without_pixel_spacing(tmp_path):
    write_series(tmp_path / "ct", VALUES, PixelSpacing=None)
    with pytest.raises(ValueError, match="does not say the voxel spacing along x, y; it must be given"):
        burrlab.read_volume(tmp_path / "ct")
    np.testing.assert_allclose(
        burrlab.read_volume(tmp_path / "ct", spacing=(0.4, 0.4, 0.75)).spacing, (0.4, 0.4, 0.75)
    )
    with pytest.raises(ValueError, match=r"spacing must be that of the file, \(nan, nan, 0\.75\) mm"):
        burrlab.read_volume(tmp_path / "ct", spacing=0.4)


def test_a_pixel_spacing_that_is_not_positive_is_none(tmp_path):
    write_series(tmp_path / "ct", VALUES, PixelSpacing=["-1", "1"])
    with pytest.raises(ValueError, match="does not say the voxel spacing along y; it must be given"):
        burrlab.read_volume(tmp_path / "ct")


def test_one_slice_has_no_spacing_along_z(folder):
    with pytest.raises(ValueError, match="does not say the voxel spacing along z"):
        burrlab.read_volume(folder / "slice000.dcm")
    assert burrlab.read_volume([folder / "slice000.dcm"], spacing=(0.25, 0.5, 1)).shape == (1, 4, 5)


def test_other_errors(folder, tmp_path, monkeypatch):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="the folder holds no DICOM files"):
        burrlab.read_volume(tmp_path / "empty")
    with pytest.raises(ValueError, match="path must name a file, got an empty list"):
        burrlab.read_volume([])
    with pytest.raises(FileNotFoundError, match="no such file"):
        burrlab.read_volume([folder / "none.dcm"])
    (folder / "slice000.dcm").write_text("no DICOM")
    with pytest.raises(ValueError, match=r"slice000\.dcm: cannot be read as a DICOM image"):
        burrlab.read_volume(folder)
    write_slice(folder / "slice000.dcm", VALUES[0], (1, 2, 3), series="1.2.3.4", ImagePositionPatient=None)
    with pytest.raises(ValueError, match="does not say the slice's position and orientation"):
        burrlab.read_volume(folder)
    write_slice(
        folder / "slice000.dcm",
        VALUES[0],
        (1, 2, 3),
        series="1.2.3.4",
        PhotometricInterpretation="MONOCHROME1",
    )
    with pytest.raises(ValueError, match="one value a voxel, got a MONOCHROME1 image of 1 values"):
        burrlab.read_volume(folder)
    frames = np.tile(VALUES[0], (2, 1, 1))
    write_slice(
        folder / "slice000.dcm",
        VALUES[0],
        (1, 2, 3),
        series="1.2.3.4",
        NumberOfFrames=2,
        PixelData=frames.tobytes(),
    )
    with pytest.raises(ValueError, match="of several frames are not read"):
        burrlab.read_volume(folder)
    monkeypatch.setitem(__import__("sys").modules, "SimpleITK", None)
    with pytest.raises(ImportError, match=r"pip install 'burrlab\[medical\]'"):
        burrlab.read_volume(folder)
