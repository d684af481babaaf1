"""NIfTI headers: units, scaling, orientation, contradictions, values that are not finite."""

import struct

import numpy as np
import pytest
from session_scenes import refused

import burrlab
from burrlab.bone.image import same_geometry

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
nibabel = pytest.importorskip("nibabel", reason="an independent reader of NIfTI, extra `dev`")
from volume_scenes import TURNED, a_volume, nifti  # noqa: E402


def written(path, *patches, values=None, **options):
    """A file of whole numbers at 1 mm, with patches of its header: (type, byte, numbers)."""
    values = a_volume().values if values is None else values
    nifti(path, values, **({"affine": np.eye(4)} | options))
    content = bytearray(path.read_bytes())
    for kind, place, *numbers in patches:
        struct.pack_into(f"<{kind}", content, place, *numbers)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("units", "scale"), [("meter", 1e3), ("mm", 1.0), ("micron", 1e-3), ("unknown", 1.0)]
)
def test_nifti_units(tmp_path, units, scale):
    affine = np.diag([0.5, 0.5, 2.0, 1.0]) + np.eye(4, k=3) * 7
    volume = burrlab.read_volume(written(tmp_path / "v.nii", affine=affine, units=units))
    np.testing.assert_allclose(volume.spacing, np.array([0.5, 0.5, 2.0]) * scale, rtol=1e-6)
    np.testing.assert_allclose(volume.origin, np.array([-7.0, 0.0, 0.0]) * scale, rtol=1e-6)
    assert ["millimetres are assumed" in note for note in volume.notes] == [True] * (units == "unknown")


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


NO_CODES = {"affine": None, "qform_code": 0, "sform_code": 0}


def test_nifti_without_orientation_is_noted_and_without_spacing_asked_for(tmp_path):
    path = tmp_path / "v.nii"
    volume = burrlab.read_volume(written(path, pixdim=[1, 0.5, 0.5, 2, 1, 1, 1, 1], **NO_CODES))
    assert "no orientation (qform and sform code 0): LPS assumed" in volume.notes[0]
    np.testing.assert_array_equal(volume.spacing, (0.5, 0.5, 2))
    written(path, pixdim=[1, 0.5, 0.5, 0, 1, 1, 1, 1], **NO_CODES)
    np.testing.assert_array_equal(burrlab.read_volume(path, spacing=(0.5, 0.5, 3)).spacing, (0.5, 0.5, 3))
    refused(
        (lambda: burrlab.read_volume(path, spacing=(0.4, 0.5, 3)),
         r"spacing must be that of the file, \(0\.5, 0\.5, nan\) mm"),
    )  # fmt: skip


SHEARED = np.eye(4)
SHEARED[:2, 1] = np.array([0.02, 1.0]) / np.hypot(0.02, 1.0)
HOLES = a_volume("f4").values.copy()
HOLES[1, 2, 3], HOLES[2, 0, 0] = np.nan, np.inf
BEHIND = "values must begin behind the NIfTI header of 348 bytes, got vox_offset"


@pytest.mark.parametrize(
    ("patches", "options", "message"),
    [
        *[([("f", 108, offset)], {}, BEHIND) for offset in (0.0, 347.0, -5.0, float("nan"))],
        ([("2f", 112, 3e38, 0.0)], {}, "values that are not finite"),  # without a warning
        ([("2f", 112, 2.0, float("nan"))], {}, "scl_inter of the NIfTI header must be finite, got nan"),
        ([("h", 40, 8)], {}, "dim of the NIfTI header must begin with 1 to 7, got 8"),
        ([], {"pixdim": [1, 0.5, 0.5, 0, 1, 1, 1, 1], **NO_CODES},
         "does not say the voxel spacing along z; it must be given: spacing="),
        ([], {"affine": np.diag([0.5, 0.5, 2.0, 1.0]), "pixdim": [1, 0.5, 0.5, 1, 1, 1, 1, 1]},
         r"by sform, \(0\.5, 0\.5, 2\) mm, and by pixdim, \(0\.5, 0\.5, 1\) mm, must agree"),
        ([], {"qform_code": 1, "qoffset_x": 5},
         "qform and sform of the NIfTI header place the volume differently, by up to 5 mm"),
        ([("2h", 252, 1, 0), ("f", 256, 1.2)], {}, "quaternion of the NIfTI header is not of length 1"),
        ([("2h", 252, 0, 1), ("f", 292, np.nan)], {},
         "sform of the NIfTI header holds values that are not finite"),
        ([("2h", 252, 1, 0), ("f", 268, np.inf)], {}, "origin in the NIfTI header is not finite"),
        ([], {"affine": SHEARED}, r"not orthonormal \(off by 0\.02, at most 0\.0001\): sheared volumes are not"),
        ([], {"values": HOLES}, r"not finite: 2 of 60, the first at \(z, y, x\) = \(1, 2, 3\)"),
        ([], {"values": np.zeros((4, 5), np.int16)},
         "three dimensions and one value a voxel, got sizes 5 x 4"),
        ([], {"values": np.zeros((4, 5, 6), np.complex64)}, "got NIfTI datatype 32"),
        ([("3s", 344, b"no ")], {}, "no NIfTI header"),
    ],
)  # fmt: skip
def test_wrong_nifti(tmp_path, patches, options, message):
    refused(
        (lambda: burrlab.read_volume(written(tmp_path / "v.nii", *patches, **options)),
         rf"v\.nii: .*{message}"),
    )  # fmt: skip


def test_a_rounded_matrix_is_made_orthonormal(tmp_path):
    rounded = np.round(TURNED @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]), 5) + 2e-5
    path = written(tmp_path / "v.nii", affine=np.block([[rounded, np.zeros((3, 1))], [0, 0, 0, 1]]))
    found = burrlab.read_volume(path).direction
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.diag([-1, -1, 1]) @ found, rounded, atol=1e-4)
