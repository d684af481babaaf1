"""Grey volumes of files: values and geometry, damaged files."""

from __future__ import annotations

import numpy as np
import pytest

import burrlab

sitk = pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")


def image(*shape):
    made = sitk.GetImageFromArray(np.zeros(shape, np.uint8), isVector=len(shape) == 4)
    made.SetSpacing((0.3, 0.3, 0.3))
    made.SetOrigin((5.0, -7.0, 11.0))
    return made


@pytest.fixture(params=["v.nrrd", "v.nii", "v.nii.gz", "v.mha"])
def path(request, tmp_path):
    file = tmp_path / request.param
    sitk.WriteImage(image(30, 40, 40), str(file))
    return file


def test_reads_values_and_geometry(path):
    volume = burrlab.read_volume(path)
    assert volume.values.shape == (30, 40, 40)
    np.testing.assert_allclose(volume.spacing, 0.3, rtol=1e-6)
    np.testing.assert_allclose(volume.origin, (5, -7, 11), rtol=1e-6)


def test_a_file_cut_in_half_is_an_error(path, capfd):
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(
        ValueError, match=f"{path.name}: (cannot be read|the file is cut|the compressed data is cut)"
    ):
        burrlab.read_volume(path)


@pytest.mark.parametrize(
    ("name", "content", "kind", "match"),
    [
        ("none.nrrd", None, FileNotFoundError, "no such file"),
        ("text.nrrd", b"nothing of the kind", ValueError, r"text\.nrrd: cannot be read as a volume"),
        ("short.nii", b"\x5c\x01", ValueError, "too short for a NIfTI header"),
        ("colour.nrrd", (4, 4, 4, 3), ValueError, "one value a voxel"),
    ],
)
def test_errors(tmp_path, name, content, kind, match):
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    elif content is not None:
        sitk.WriteImage(image(*content), str(tmp_path / name))
    with pytest.raises(kind, match=match):
        burrlab.read_volume(tmp_path / name)


def test_without_simpleitk(tmp_path, monkeypatch):
    """It is asked for where it is needed: for DICOM."""
    head = b"NRRD0004\ntype: uint8\nencoding: raw\ndimension: 3\nsizes: 3 2 1\nspacings: 1 1 1\n\n"
    (tmp_path / "v.nrrd").write_bytes(head + bytes(6))
    (tmp_path / "v.dcm").write_bytes(bytes(128) + b"DICM")
    monkeypatch.setitem(__import__("sys").modules, "SimpleITK", None)
    assert burrlab.read_volume(tmp_path / "v.nrrd").shape == (1, 2, 3)
    with pytest.raises(ImportError, match=r"pip install 'burrlab\[medical\]'"):
        burrlab.read_volume(tmp_path / "v.dcm")
