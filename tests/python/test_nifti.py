"""NIfTI headers: units, scaling, orientation, and those that contradict themselves; what is not finite."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest

import burrlab
from burrlab.bone.image import same_geometry

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
nibabel = pytest.importorskip("nibabel", reason="an independent reader of NIfTI, extra `dev`")
from volume_scenes import TURNED, a_volume, nifti  # noqa: E402


@pytest.mark.parametrize(("units", "scale"), [("meter", 1e3), ("mm", 1.0), ("micron", 1e-3)])
def test_nifti_units(tmp_path, units, scale):
    values = a_volume().values
    nifti(tmp_path / "v.nii", values, affine=np.diag([0.5, 0.5, 2.0, 1.0]) + np.eye(4, k=3) * 7, units=units)
    volume = burrlab.read_volume(tmp_path / "v.nii")
    np.testing.assert_allclose(volume.spacing, np.array([0.5, 0.5, 2.0]) * scale, rtol=1e-6)
    np.testing.assert_allclose(volume.origin, np.array([-7.0, 0.0, 0.0]) * scale, rtol=1e-6)


def test_nifti_without_unit_says_what_is_assumed(tmp_path):
    nifti(tmp_path / "v.nii", a_volume().values, affine=np.eye(4), units="unknown")
    assert "millimetres are assumed" in burrlab.read_volume(tmp_path / "v.nii").notes[0]


def test_nifti_slope_and_intercept(tmp_path):
    values = a_volume().values
    nifti(tmp_path / "v.nii", values, affine=np.eye(4))
    content = bytearray((tmp_path / "v.nii").read_bytes())
    struct.pack_into("<2f", content, 112, 0.5, -1024.0)
    (tmp_path / "v.nii").write_bytes(content)
    volume = burrlab.read_volume(tmp_path / "v.nii")
    np.testing.assert_array_equal(volume.values, 0.5 * values - 1024)
    np.testing.assert_array_equal(volume.values, nibabel.load(tmp_path / "v.nii").get_fdata().T)
    struct.pack_into("<2f", content, 112, 3e38, 0.0)
    (tmp_path / "v.nii").write_bytes(content)
    with pytest.raises(ValueError, match="values that are not finite"):  # and no warning before it
        burrlab.read_volume(tmp_path / "v.nii")


def test_nifti_2_and_pairs_and_big_endian(tmp_path):
    volume = a_volume()
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = volume.direction * volume.spacing, volume.origin
    affine = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine
    nibabel.save(nibabel.Nifti2Image(volume.values.T, affine), tmp_path / "two.nii")
    nibabel.save(nibabel.Nifti1Pair(volume.values.T, affine), tmp_path / "pair.img")
    header = nibabel.Nifti1Header(endianness=">")
    nibabel.save(nibabel.Nifti1Image(volume.values.T.astype(">i2"), affine, header), tmp_path / "big.nii")
    for name in ("two.nii", "pair.hdr", "pair.img", "big.nii"):
        again = burrlab.read_volume(tmp_path / name)
        np.testing.assert_array_equal(again.values, volume.values)
        assert same_geometry(again, volume)


def test_nifti_without_orientation_is_noted_and_without_spacing_asked_for(tmp_path):
    path = tmp_path / "v.nii"
    nifti(path, a_volume().values, pixdim=[1, 0.5, 0.5, 2, 1, 1, 1, 1], qform_code=0, sform_code=0)
    volume = burrlab.read_volume(path)
    assert "no orientation (qform and sform code 0): LPS assumed" in volume.notes[0]
    np.testing.assert_array_equal(volume.spacing, (0.5, 0.5, 2))
    nifti(path, a_volume().values, pixdim=[1, 0.5, 0.5, 0, 1, 1, 1, 1], qform_code=0, sform_code=0)
    with pytest.raises(
        ValueError, match=r"does not say the voxel spacing along z; it must be given: spacing="
    ):
        burrlab.read_volume(path)
    np.testing.assert_array_equal(burrlab.read_volume(path, spacing=(0.5, 0.5, 3)).spacing, (0.5, 0.5, 3))
    with pytest.raises(ValueError, match=r"spacing must be that of the file, \(0\.5, 0\.5, nan\) mm"):
        burrlab.read_volume(path, spacing=(0.4, 0.5, 3))


@pytest.mark.parametrize("offset", [0.0, 347.0, -5.0, float("nan")])
def test_values_do_not_begin_in_the_header(tmp_path, offset):
    nifti(tmp_path / "v.nii", a_volume().values, affine=np.diag([1.0, 1, 1, 1]))
    content = bytearray((tmp_path / "v.nii").read_bytes())
    struct.pack_into("<f", content, 108, offset)
    (tmp_path / "v.nii").write_bytes(content)
    with pytest.raises(
        ValueError, match="values must begin behind the NIfTI header of 348 bytes, got vox_offset"
    ):
        burrlab.read_volume(tmp_path / "v.nii")


def test_nifti_headers_that_contradict_themselves(tmp_path):
    path, values = tmp_path / "v.nii", a_volume().values
    nifti(path, values, affine=np.diag([0.5, 0.5, 2.0, 1.0]), pixdim=[1, 0.5, 0.5, 1, 1, 1, 1, 1])
    with pytest.raises(
        ValueError, match=r"by sform, \(0\.5, 0\.5, 2\) mm, and by pixdim, \(0\.5, 0\.5, 1\) mm, must agree"
    ):
        burrlab.read_volume(path)
    nifti(path, values, affine=np.eye(4), qform_code=1, qoffset_x=5)
    with pytest.raises(
        ValueError, match="qform and sform of the NIfTI header place the volume differently, by up to 5 mm"
    ):
        burrlab.read_volume(path)
    for codes, place, number, message in (
        ((1, 0), 256, 1.2, "quaternion of the NIfTI header is not of length 1"),
        ((0, 1), 292, np.nan, "sform of the NIfTI header holds values that are not finite"),
        ((1, 0), 268, np.inf, "origin in the NIfTI header is not finite"),
    ):
        nifti(path, values, affine=np.eye(4))
        content = bytearray(path.read_bytes())
        struct.pack_into("<2h", content, 252, *codes)
        struct.pack_into("<f", content, place, number)
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            burrlab.read_volume(path)


def test_sheared_is_refused_and_rounded_is_not(tmp_path):
    values = a_volume().values
    sheared = np.eye(4)
    sheared[0, 1] = 0.02
    sheared[:, 1] /= np.linalg.norm(sheared[:, 1])
    nifti(tmp_path / "v.nii", values, affine=sheared)
    with pytest.raises(
        ValueError, match=r"not orthonormal \(off by 0\.02, at most 0\.0001\): sheared volumes are not"
    ):
        burrlab.read_volume(tmp_path / "v.nii")
    rounded = np.round(TURNED @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]), 5) + 2e-5
    nifti(tmp_path / "v.nii", values, affine=np.block([[rounded, np.zeros((3, 1))], [0, 0, 0, 1]]))
    found = burrlab.read_volume(tmp_path / "v.nii").direction
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.diag([-1, -1, 1]) @ found, rounded, atol=1e-4)


def test_values_that_are_not_finite(tmp_path):
    values = a_volume("f4").values.copy()
    values[1, 2, 3] = np.nan
    values[2, 0, 0] = np.inf
    nifti(tmp_path / "v.nii", values, affine=np.eye(4))
    with pytest.raises(ValueError, match=r"not finite: 2 of 60, the first at \(z, y, x\) = \(1, 2, 3\)"):
        burrlab.read_volume(tmp_path / "v.nii")


def test_a_damaged_gzip_is_an_error(tmp_path):
    path = tmp_path / "v.nii.gz"
    burrlab.write_volume(path, a_volume())
    content = bytearray(gzip.decompress(path.read_bytes()))
    packed = bytearray(gzip.compress(content))
    packed[len(packed) // 2] ^= 0xFF
    path.write_bytes(packed)
    with pytest.raises(ValueError, match="cut short or damaged"):
        burrlab.read_volume(path)
