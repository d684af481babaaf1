"""Grey volumes: geometry, entry, damaged files."""

from __future__ import annotations

import numpy as np
import pytest

import burrlab

sitk = pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")


IDENTITY = np.eye(3)


def grey_slab(direction=IDENTITY, origin=(5.0, -7.0, 11.0)):
    """200 below index 15 along z, 20 above; spacing 0.3 mm."""
    values = np.full((30, 40, 40), 20, np.uint8)
    values[:15] = 200
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((0.3, 0.3, 0.3))
    image.SetOrigin(origin)
    image.SetDirection(np.asarray(direction, dtype=float).ravel())
    return image


@pytest.fixture(params=["v.nrrd", "v.nii", "v.nii.gz", "v.mha"])
def path(request, tmp_path):
    file = tmp_path / request.param
    sitk.WriteImage(grey_slab(), str(file))
    return file


def test_reads_values_and_geometry(path):
    volume = burrlab.read_volume(path)
    assert volume.values.shape == (30, 40, 40)
    np.testing.assert_allclose(volume.spacing, 0.3, rtol=1e-6)
    np.testing.assert_allclose(volume.origin, (5, -7, 11), rtol=1e-6)


def test_entry_counts_from_first_crossing_of_occupancy_128(path):
    volume = burrlab.read_volume(path)
    entry = volume.origin + (6.0, 6.0, 8.0)
    specimen = volume.specimen(60, 160, entry=entry, axis=(0, 0, -1))
    # Occupancy falls from 255 to 0 between the centres of layers 14 and 15.
    assert specimen.surface[2] == pytest.approx(11 + 0.3 * (15 - 128 / 255), abs=1e-3)


def test_a_turned_direction_matrix_gives_the_same_descent(tmp_path):
    turn = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])
    results = []
    for name, matrix in (("a.nrrd", np.eye(3)), ("b.nrrd", turn)):
        sitk.WriteImage(grey_slab(matrix), str(tmp_path / name))
        volume = burrlab.read_volume(tmp_path / name)
        entry = volume.origin + volume.direction @ (6.0, 6.0, 8.0)
        specimen = volume.specimen(60, 160, entry=entry, axis=volume.direction @ (0, 0, -1))
        run = burrlab.descend(
            burrlab.Burr(2.5), burrlab.materials["bone"], 1.0, specimen=specimen, seed=1, ideal=True
        )
        results.append(run.penetration_velocity)
    assert results[0] == pytest.approx(results[1], rel=1e-3)


def test_a_file_cut_in_half_is_an_error(path, capfd):
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(
        ValueError, match=f"{path.name}: (cannot be read|the file is cut|the compressed data is cut)"
    ):
        burrlab.read_volume(path)


def test_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        burrlab.read_volume(tmp_path / "none.nrrd")
    (tmp_path / "text.nrrd").write_text("nothing of the kind")
    with pytest.raises(ValueError, match=r"text\.nrrd: cannot be read as a volume"):
        burrlab.read_volume(tmp_path / "text.nrrd")
    (tmp_path / "short.nii").write_bytes(b"\x5c\x01")
    with pytest.raises(ValueError, match="too short for a NIfTI header"):
        burrlab.read_volume(tmp_path / "short.nii")
    colour = sitk.GetImageFromArray(np.zeros((4, 4, 4, 3), np.uint8), isVector=True)
    sitk.WriteImage(colour, str(tmp_path / "colour.nrrd"))
    with pytest.raises(ValueError, match="one value a voxel"):
        burrlab.read_volume(tmp_path / "colour.nrrd")


def test_specimen_errors(tmp_path):
    sitk.WriteImage(grey_slab(), str(tmp_path / "v.nrrd"))
    volume = burrlab.read_volume(tmp_path / "v.nrrd")
    above = volume.origin + (6.0, 6.0, 8.0)
    with pytest.raises(ValueError, match="meets no occupancy of 128"):
        volume.specimen(60, 160, entry=above, axis=(0, 0, 1))
    with pytest.raises(
        ValueError, match=r"; the volume lies from .* to .* mm, x to the left, y to the back \(LPS\)$"
    ):
        volume.specimen(60, 160, entry=above, axis=(0, 0, 1))
    with pytest.raises(ValueError, match=r"\(LPS\); .* lies in it: RAS, as 3D Slicer shows"):
        volume.specimen(60, 160, entry=(volume.origin + 6.0) * (-1, -1, 1), axis=(0, 0, -1))
    assert volume.specimen(60, 160, entry=above + (0, 0, 10), axis=(0, 0, -1)).surface[2] < above[2]
    with pytest.raises(
        ValueError, match=r"entry: .* lies \d+ mm outside .*v.nrrd, more than it is wide; the volume lies"
    ):
        volume.specimen(60, 160, entry=above + (0, 0, 100), axis=(0, 0, -1))
    with pytest.raises(ValueError, match="lies inside bone"):
        volume.specimen(60, 160, entry=volume.origin + (6.0, 6.0, 1.0), axis=(0, 0, -1))
    with pytest.raises(ValueError, match="LO below HI"):
        volume.specimen(160, 60, entry=above, axis=(0, 0, -1))
    with pytest.raises(ValueError, match="axis must be three finite numbers"):
        volume.specimen(60, 160, entry=above, axis=(0, 0, 0))


def test_without_simpleitk(tmp_path, monkeypatch):
    """It is asked for where it is needed: for DICOM."""
    head = b"NRRD0004\ntype: uint8\nencoding: raw\ndimension: 3\nsizes: 3 2 1\nspacings: 1 1 1\n\n"
    (tmp_path / "v.nrrd").write_bytes(head + bytes(6))
    (tmp_path / "v.dcm").write_bytes(bytes(128) + b"DICM")
    monkeypatch.setitem(__import__("sys").modules, "SimpleITK", None)
    assert burrlab.read_volume(tmp_path / "v.nrrd").shape == (1, 2, 3)
    with pytest.raises(ImportError, match=r"pip install 'burrlab\[medical\]'"):
        burrlab.read_volume(tmp_path / "v.dcm")
