"""DICOM series: read in order of position; refused with a sentence if they make no volume."""

import io
import os
import shutil
import sys

import numpy as np
import pytest
from PIL import Image

import burrlab
from burrlab.bone.recipe import _volume_files

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
    names = ["c.dcm", "a.dcm", "f.dcm", "b.dcm", "d", "e.ima"]  # without order, some with unusual endings
    write_series(tmp_path / "ct", VALUES, names=names, rows=ROWS, columns=COLUMNS, step=step)
    volume = burrlab.read_volume(tmp_path / "ct")
    np.testing.assert_array_equal(volume.values, VALUES if step > 0 else VALUES[::-1])
    np.testing.assert_allclose(volume.direction, np.column_stack([ROWS, COLUMNS, (0, 0, 1)]), atol=1e-12)
    np.testing.assert_allclose(volume.origin, (1, 2, min(3.0, 3.0 + 5 * step)), rtol=1e-12)
    again = burrlab.read_volume([tmp_path / "ct" / name for name in sorted(names)])
    np.testing.assert_array_equal(again.values, volume.values)
    assert "6 files in" in again.path


def test_an_orientation_of_four_digits(tmp_path):
    turn = np.linalg.qr(np.random.default_rng(20).normal(size=(3, 3)))[0][:, :2].T
    digits = [f"{number:.4f}" for number in turn.ravel()]
    write_series(tmp_path / "ct", VALUES, rows=turn[0], columns=turn[1], ImageOrientationPatient=digits)
    direction = burrlab.read_volume(tmp_path / "ct").direction
    np.testing.assert_allclose(direction.T @ direction, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(direction, np.column_stack([*turn, np.cross(*turn)]), atol=1e-4)
    digits[0] = f"{float(digits[0]) + 1e-3:.4f}"
    write_series(tmp_path / "off", VALUES, rows=turn[0], columns=turn[1], ImageOrientationPatient=digits)
    refused(tmp_path / "off", r"not orthonormal \(off by .*, at most 0\.0004\)")


def test_files_in_subfolders(tmp_path):
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "DICOMDIR").write_bytes(b"index")
    (tmp_path / "study" / "patient").mkdir()
    ct = [tmp_path / "study" / "patient" / name for name in ("a", "b")]
    for half, place in enumerate(ct):
        write_series(
            place, VALUES[3 * half : 3 * half + 3], first=(1, 2, 3 + 2.25 * half), names=["1", "2", "3"]
        )
    (ct[1] / "notes.txt").write_text("no slice")
    volume = burrlab.read_volume(tmp_path / "study")
    np.testing.assert_array_equal(volume.values, VALUES)
    assert "1 file of the folder left out, as no DICOM: notes.txt" in volume.notes[-1]
    write_series(ct[0] / "other", VALUES[:4], series="9.8.7")
    which = r"series must say which of 2 DICOM series: 1\.2\.3\.4 \(6 files\), 9\.8\.7 \(4 files\)"
    refused(tmp_path / "study", which)
    refused(tmp_path / "study", r"series must be one of .*, got 5\.5", series="5.5")
    write_series(
        ct[0] / "capture", VALUES[:1], series="7.7.7", SamplesPerPixel=3
    )  # of no use, and of another series
    (ct[0] / "other" / "._slice000.dcm").write_bytes(b"of a Mac")
    refused(tmp_path / "study", r"one value a voxel")
    assert burrlab.read_volume(tmp_path / "study", series="9.8.7").shape == (4, 4, 5)
    shutil.rmtree(ct[0] / "capture")
    assert burrlab.read_volume(ct[0]).shape == (3, 4, 5)  # it holds slices itself
    assert {str(ct[1] / "3"), str(ct[0] / "other" / "slice000.dcm")} <= set(
        _volume_files(str(tmp_path / "study"))
    )


def test_slope_and_intercept_of_each_slice(tmp_path):
    for k, slope in enumerate((1.0, 0.5, 2.0)):
        write_series(
            tmp_path / "ct", VALUES[k : k + 1], names=[f"{k}.dcm"], first=(0, 0, k), RescaleSlope=str(slope), RescaleIntercept="-1024"
        )  # fmt: skip
    wanted = VALUES[:3] * np.array([1.0, 0.5, 2.0])[:, None, None] - 1024
    np.testing.assert_array_equal(burrlab.read_volume(tmp_path / "ct").values, wanted)


def lost(*slices):
    return lambda folder: [(folder / f"slice{k:03d}.dcm").unlink() for k in slices]


def refused(path, message, **options):
    with pytest.raises(ValueError, match=message):
        burrlab.read_volume(path, **options)


def slice_of(k, pixels=None, name=None, **changes):
    """Writes one slice of the series in another way."""
    position = changes.pop("position", (1, 2, 3 + 0.75 * k))
    plane = VALUES[k] if pixels is None else pixels
    return lambda folder: write_slice(
        folder / (name or f"slice{k:03d}.dcm"), plane, position, series="1.2.3.4", **changes
    )


def cut(count):
    return lambda folder: os.truncate(
        folder / "slice004.dcm", (folder / "slice004.dcm").stat().st_size - count
    )


def cut_in_big_endian(folder):
    path = folder / "slice004.dcm"
    part = pydicom.dcmread(path)
    part.PixelData = VALUES[4].astype(">i2").tobytes()[:-8]
    part.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRBigEndian
    pydicom.dcmwrite(path, part, implicit_vr=False, little_endian=False)


def tilted(folder):
    for k, pixels in enumerate(VALUES):
        slice_of(k, pixels, position=(1, 2 + 0.1 * k, 3 + k))(folder)


def more_than_there_is(folder):
    """Adds an element for which GDCM allocates 1.5 GB although the file is small."""
    with (folder / "slice000.dcm").open("ab") as file:
        file.write(b"\xe1\x7f\x10\0OB\0\0" + (1 << 30).to_bytes(4, "little") + b"\x05")


CUT = r"slice004\.dcm: (cannot be read as a DICOM image|the pixel data)"
GAP = r"1\.5 mm between slices {} and {} .*0\.75 mm apart"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lost(3), r"1 slice is missing: 1\.5 mm between slices 2 and 3 \(slice002\.dcm at 4\.5 mm, slice004\.dcm at 6 mm\), where "
         r"others are 0\.75 mm apart"),
        (lost(2, 3), r"2 slices are missing: 2\.25 mm between slices 1 and 2"),
        (lost(1, 3), "2 slices are missing: " + GAP.format(0, 1)), (lost(1, 4), "2 slices are missing: " + GAP.format(0, 1)),
        (lost(2, 4), "2 slices are missing: " + GAP.format(1, 2)),
        (lost(2, 4, 5), "1 slice is missing: " + GAP.format(1, 2)),  # three are left
        (slice_of(3, position=(1, 2, 3 + 3 * 0.75 + 0.2)), r"not evenly spaced: 0\.95 mm between slices 2 and 3"),
        (slice_of(1, name="twin.dcm"), r"two slices lie at the same position, 3\.75 mm .*: slice001\.dcm and twin\.dcm"),
        (slice_of(3, np.zeros((4, 6))), r"different sizes: \(5, 4\) in slice000\.dcm, \(6, 4\) in slice003\.dcm"),
        (slice_of(3, spacing=(0.5, 0.3)), r"different pixel spacings: \(0\.25, 0\.5\) in slice000\.dcm, \(0\.3, 0\.5\) in"),
        (slice_of(3, rows=ROWS, columns=COLUMNS), r"different orientations: \(1, 0, 0, 0, 1, 0\) in slice000\.dcm"),
        (tilted, r"sheared, by a gantry tilt of 5\.71 degrees: 0\.5 mm sideways"),
        (slice_of(3, position=(6, 2, 5.25)), r"sheared, .*: 5 mm sideways from slice000\.dcm to slice003\.dcm"),
        (slice_of(3, RescaleSlope="0", RescaleIntercept="0"), r"slice003\.dcm: RescaleSlope must be a number"),
        (slice_of(3, BitsStored=20, HighBit=19), r"slice003\.dcm: grey values by a table .* are not read"),
        (slice_of(3, BitsStored=12, HighBit=15), r"slice003\.dcm: grey values .*, or not in the lowest bits, are not read"),
        (lambda folder: (folder / "slice000.dcm").write_bytes(
            (folder / "slice000.dcm").read_bytes() + 6000 * b"\xfe\xff\x00\xe0\0\0\0\0"),
         "a slice must have at most 5000 items of sequences, got 6000"),
        *[(cut(count), CUT) for count in (1, 2, 25, 40)],
        (slice_of(4, PixelData=VALUES[4].tobytes()[:-8]), r"slice004\.dcm: the pixel data is cut short: 32 bytes of 40"),
        (cut_in_big_endian, r"slice004\.dcm: the pixel data is cut short"),
        (lambda folder: (folder / "slice000.dcm").write_text("no DICOM"), r"slice000\.dcm: cannot be read as a DICOM image"),
        (more_than_there_is, r"slice000\.dcm: cannot be read as a DICOM image: it is cut short"),
        (slice_of(0, ImagePositionPatient=None), "does not say the slice's position and orientation"),
        (slice_of(0, PhotometricInterpretation="MONOCHROME1"),
         "one value a voxel, got a MONOCHROME1 image of 1 values"),
        (slice_of(0, NumberOfFrames=2, PixelData=VALUES[:2].tobytes()), "of several frames are not read"),
        (lost(*range(6)), "the folder holds no DICOM files"),
    ],
)  # fmt: skip
def test_what_makes_no_volume_is_refused(folder, change, message):
    change(folder)
    refused(folder, message)


def test_what_may_be_lost_at_even_distances_is_noted(folder, tmp_path):
    lost(1, 3, 5)(folder)
    slice_of(2, PatientID="another", InstanceNumber="3")(folder)
    (folder / "notes.txt").write_text("no slice")
    (folder / "IM0007").write_text("cut short")
    volume = burrlab.read_volume(folder)
    assert (volume.spacing[2], volume.notes) == (pytest.approx(1.5), (
        "the slices are numbered 1 to 5, of which 2 are absent: slices may be missing",
        "the slices differ in PatientID: they may be of several scans",
        "2 files of the folder left out, as no DICOM: IM0007, notes.txt",
    ))  # fmt: skip
    write_series(tmp_path / "end", VALUES[:4], ImagesInAcquisition="6")
    assert burrlab.read_volume(tmp_path / "end").notes == (
        "the DICOM headers count 6 images in the acquisition, 4 are there: slices may be missing",
    )


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
    apart = {"spacing": (0.25, 0.5, 1.0)}
    near = burrlab.read_volume(tmp_path / "whole.dcm", **apart).values[0].astype(int)
    assert np.abs(near - pixels).max() < 40
    refused(
        tmp_path / "torn.dcm", r"torn.dcm: the pixel data of the slice is damaged \(Corrupt JPEG", **apart
    )
    os.write(2, b"kept")  # the descriptor is in place
    assert capfd.readouterr() == ("", "kept")


@pytest.mark.parametrize(
    ("changes", "alone", "asked", "right", "wrong"),
    [
        ({"PixelSpacing": None}, False, "x, y", (0.4, 0.4, 0.75), r"\(nan, nan, 0\.75\)"),
        (
            {"PixelSpacing": ["-1", "1"]},
            False,
            "y",
            (1, 0.4, 0.75),
            r"\(1, nan, 0\.75\)",
        ),  # negative: none
        ({}, True, "z", (0.25, 0.5, 1), r"\(0\.25, 0\.5, nan\)"),
    ],
)
def test_a_spacing_that_is_not_said_is_asked_for(tmp_path, changes, alone, asked, right, wrong):
    write_series(tmp_path / "ct", VALUES, **changes)
    path = tmp_path / "ct" / "slice000.dcm" if alone else tmp_path / "ct"
    refused(path, f"does not say the voxel spacing along {asked}; it must be given")
    np.testing.assert_allclose(burrlab.read_volume(path, spacing=right).spacing, right)
    refused(path, f"spacing must be that of the file, {wrong} mm", spacing=0.9)


def test_no_files_and_no_library(folder, monkeypatch):
    refused([], "path must name a file, got an empty list")
    with pytest.raises(FileNotFoundError, match="no such file"):
        burrlab.read_volume([folder / "none.dcm"])
    for library in ("pydicom", "SimpleITK"):
        monkeypatch.setitem(sys.modules, library, None)
        with pytest.raises(
            ImportError, match=rf"reading DICOM needs {library}: pip install 'burrlab\[medical\]'"
        ):
            burrlab.read_volume(folder)
