"""Volumes written as DICOM series, read by burrlab and pydicom."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from session_scenes import refused
from volume_scenes import ASKEW

import burrlab
from burrlab.volume import Volume, same_geometry, write_dicom

sitk = pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pydicom = pytest.importorskip("pydicom", reason="the independent reader, extra `dev`")

TURNED = ASKEW * np.sign(np.linalg.det(ASKEW))


def a_volume(kind="int16", direction=TURNED):
    values = (np.arange(3 * 4 * 5).reshape(3, 4, 5) * 3 - (50 if kind == "int16" else 0)).astype(kind)
    return Volume(values, (0.1, 0.25, 1 / 3), (-31.25, 12.123456789, 1024.3), direction, "made")


@pytest.mark.parametrize(
    ("kind", "direction"), [("uint8", np.eye(3)), ("int16", TURNED), ("uint16", TURNED)], ids=str
)
def test_round_trip(tmp_path, kind, direction):
    volume = a_volume(kind, direction)
    write_dicom(tmp_path / "ct", volume)
    again = burrlab.read_volume(tmp_path / "ct")
    assert again.values.dtype == volume.values.dtype
    np.testing.assert_array_equal(again.values, volume.values)
    for name in ("spacing", "origin", "direction"):
        np.testing.assert_allclose(getattr(again, name), getattr(volume, name), rtol=1e-11, atol=1e-11)
    assert same_geometry(again, volume)
    assert again.notes == ()
    assert [path.name for path in tmp_path.iterdir()] == ["ct"]


def test_what_pydicom_reads(tmp_path):
    volume = a_volume()
    write_dicom(tmp_path / "ct", volume)
    slices = [pydicom.dcmread(path) for path in sorted((tmp_path / "ct").iterdir())]
    assert len(slices) == 3
    for k, found in enumerate(slices):
        np.testing.assert_array_equal(found.pixel_array, volume.values[k])
        position = volume.origin + k * volume.spacing[2] * volume.direction[:, 2]
        np.testing.assert_allclose([float(p) for p in found.ImagePositionPatient], position, rtol=1e-12)
        turn = np.reshape([float(v) for v in found.ImageOrientationPatient], (2, 3)).T
        np.testing.assert_allclose(turn, volume.direction[:, :2], atol=1e-12)
        assert [float(v) for v in found.PixelSpacing] == [0.25, 0.1]  # between rows, between columns
        assert (found.RescaleSlope, found.RescaleIntercept, found.InstanceNumber) == (1, 0, k + 1)
        assert pydicom.uid.UID(found.SOPInstanceUID).is_valid
    assert len({found.SOPInstanceUID for found in slices}) == 3
    assert len({found.SeriesInstanceUID for found in slices}) == 1


def test_the_same_volume_is_the_same_series(tmp_path):
    for name in ("a", "b"):
        write_dicom(tmp_path / name, a_volume())
    write_dicom(tmp_path / "c", replace(a_volume(), values=a_volume().values + 1))
    uids = [pydicom.dcmread(tmp_path / name / "slice0002.dcm").SOPInstanceUID for name in "abc"]
    assert uids[0] == uids[1] != uids[2]


def test_errors(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("something")
    real, mirrored = a_volume("float32"), a_volume(direction=TURNED * (1, 1, -1))
    refused(
        (lambda: write_dicom(tmp_path / "ct", real), "values must be one of uint8, int16, uint16 to be .* got float32"),
        (lambda: write_dicom(tmp_path / "ct", mirrored), "direction must be right-handed to be written as DICOM"),
        (lambda: write_dicom(tmp_path / "none/ct", a_volume()), "folder must exist", FileNotFoundError),
        (lambda: write_dicom(tmp_path / "file", a_volume()), "folder must be new", FileExistsError),
    )  # fmt: skip
    monkeypatch.setattr(sitk.ImageFileWriter, "Execute", Mock(side_effect=RuntimeError("disk full")))
    with pytest.raises(OSError, match="the slices cannot be written"):
        write_dicom(tmp_path / "ct", a_volume())
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
