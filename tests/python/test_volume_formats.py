"""Round trips through the formats, checked with readers of others; what is assumed and what is asked for."""

from __future__ import annotations

import gzip
import struct
import zlib

import numpy as np
import pytest

import burrlab
from burrlab.volume import LabelVolume, Volume, same_geometry

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
nibabel = pytest.importorskip("nibabel", reason="an independent reader of NIfTI, extra `dev`")
nrrd = pytest.importorskip("nrrd", reason="an independent reader of NRRD, extra `dev`")

TURNED = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])
MIRRORED = TURNED * (1.0, 1.0, -1.0)
KINDS = ["u1", "i2", "u2", "i4", "f4", "f8"]


def a_volume(kind="i2", direction=TURNED):
    values = (np.arange(3 * 4 * 5).reshape(3, 4, 5) * 3 - (50 if kind[0] != "u" else 0)).astype(kind)
    return Volume(values, (0.1, 0.25, 0.7), (-31.25, 12.5, 1024.0), direction, "made")


def parse_meta_image(path):
    """Values, spacing, offset and axes (rows) of an .mha: its text up to ElementDataFile, then the values."""
    content = path.read_bytes()
    text, _, rest = content.partition(b"ElementDataFile = LOCAL\n")
    fields = dict(line.split(" = ") for line in text.decode().splitlines())
    data = zlib.decompress(rest) if fields["CompressedData"] == "True" else rest
    kind = {
        "MET_UCHAR": "u1",
        "MET_SHORT": "<i2",
        "MET_USHORT": "<u2",
        "MET_INT": "<i4",
        "MET_FLOAT": "<f4",
        "MET_DOUBLE": "<f8",
    }
    sizes = [int(n) for n in fields["DimSize"].split()]
    numbers = {
        key: np.array([float(v) for v in fields[key].split()])
        for key in ("ElementSpacing", "Offset", "TransformMatrix")
    }
    values = np.frombuffer(data, kind[fields["ElementType"]]).reshape(sizes[::-1])
    return values, numbers["ElementSpacing"], numbers["Offset"], numbers["TransformMatrix"].reshape(3, 3).T


def independently(path):
    """Values (z, y, x), spacing, origin and direction in LPS, by a reader that is not ours."""
    if path.suffix == ".mha":
        return parse_meta_image(path)
    if path.suffix == ".nrrd":
        values, header = nrrd.read(str(path))
        assert header["space"] == "left-posterior-superior"
        vectors = np.asarray(header["space directions"]).T
        origin = header["space origin"]
    else:
        image = nibabel.load(path)
        values = np.asarray(image.dataobj)
        affine = np.diag([-1.0, -1.0, 1.0, 1.0]) @ image.affine
        vectors, origin = affine[:3, :3], affine[:3, 3]
        assert image.header.get_xyzt_units()[0] == "mm"
    spacing = np.linalg.norm(vectors, axis=0)
    return values.T, spacing, origin, vectors / spacing


@pytest.mark.parametrize(
    "direction", [np.eye(3), TURNED, MIRRORED], ids=["straight", "turned", "left-handed"]
)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["v.nrrd", "v.nii", "v.nii.gz", "v.mha"])
def test_round_trip(tmp_path, name, kind, direction):
    volume, path = a_volume(kind, direction), tmp_path / name
    burrlab.write_volume(path, volume)
    again = burrlab.read_volume(path)
    close = 3e-7 if "nii" in name else 1e-15  # NIfTI keeps float32
    for found in (again, Volume(*independently(path), "by others")):
        assert found.values.dtype == volume.values.dtype
        np.testing.assert_array_equal(found.values, volume.values)
        np.testing.assert_allclose(found.spacing, volume.spacing, rtol=close)
        np.testing.assert_allclose(found.origin, volume.origin, rtol=close)
        np.testing.assert_allclose(found.direction, volume.direction, atol=close)
        assert same_geometry(volume, found)
    assert again.notes == ()
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["v.nrrd", "v.nii.gz", "v.mha"])
def test_what_others_wrote(tmp_path, name):
    volume, path = a_volume(), tmp_path / name
    vectors = volume.direction * volume.spacing
    if name == "v.nrrd":  # in RAS and micrometres
        header = {"space": "right-anterior-superior", "space directions": 1e3 * (np.diag([-1, -1, 1]) @ vectors).T,
                  "space origin": 1e3 * volume.origin * (-1, -1, 1), "space units": ["um", "um", "um"]}  # fmt: skip
        nrrd.write(str(path), volume.values.T, header)
    elif name == "v.nii.gz":
        affine = np.eye(4)
        affine[:3, :3], affine[:3, 3] = vectors, volume.origin
        nibabel.save(nibabel.Nifti1Image(volume.values.T, np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine), path)
    else:
        text = (
            "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"
            f"TransformMatrix = {' '.join(map(repr, volume.direction.T.ravel().tolist()))}\n"
            f"Offset = {' '.join(repr(o / 10) for o in volume.origin.tolist())}\nDistanceUnits = cm\n"
            f"ElementSpacing = {' '.join(repr(s / 10) for s in volume.spacing.tolist())}\nDimSize = 5 4 3\n"
            "ElementType = MET_SHORT\nElementDataFile = LOCAL\n"
        )
        path.write_bytes(text.encode() + volume.values.tobytes())
    again = burrlab.read_volume(path)
    np.testing.assert_array_equal(again.values, volume.values)
    np.testing.assert_allclose(again.spacing, volume.spacing, rtol=3e-7)
    assert same_geometry(again, volume)


def nifti(path, values, *, affine=None, units="mm", **header):
    """A NIfTI-1 by nibabel; its codes 0 without an affine."""
    image = nibabel.Nifti1Image(values.T, affine)
    image.header.set_xyzt_units(units)
    for key, value in header.items():
        image.header[key] = value
    nibabel.save(image, path)


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
    assert "no orientation" in volume.notes[0]
    np.testing.assert_array_equal(volume.spacing, (0.5, 0.5, 2))
    nifti(path, a_volume().values, pixdim=[1, 0.5, 0.5, 0, 1, 1, 1, 1], qform_code=0, sform_code=0)
    with pytest.raises(
        ValueError, match=r"does not say the voxel spacing along z; it must be given: spacing="
    ):
        burrlab.read_volume(path)
    np.testing.assert_array_equal(burrlab.read_volume(path, spacing=(0.5, 0.5, 3)).spacing, (0.5, 0.5, 3))
    with pytest.raises(ValueError, match=r"spacing must be that of the file, \(0\.5, 0\.5, nan\) mm"):
        burrlab.read_volume(path, spacing=(0.4, 0.5, 3))


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


NRRD = "NRRD0004\ntype: int16\nendian: little\nencoding: raw\n"
META = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"


def raw(path, head, values=None):
    values = a_volume().values if values is None else values
    end = "\n" if path.suffix == ".nrrd" else "ElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    path.write_bytes((head + end).encode() + values.tobytes())
    return path


def test_nrrd_without_spacing_is_asked_for(tmp_path):
    path = raw(tmp_path / "v.nrrd", NRRD + "dimension: 3\nsizes: 5 4 3\nspacings: 0.5 nan 0.5\n")
    with pytest.raises(ValueError, match=r"v\.nrrd: the file does not say the voxel spacing along y"):
        burrlab.read_volume(path)
    path = raw(tmp_path / "v.nrrd", NRRD + "dimension: 3\nsizes: 5 4 3\n")
    with pytest.raises(ValueError, match="does not say the voxel spacing along x, y, z"):
        burrlab.read_volume(path)
    volume = burrlab.read_volume(path, spacing=0.3)
    np.testing.assert_array_equal(volume.spacing, 0.3)
    assert len(volume.notes) == 2  # neither orientation nor origin


def test_nrrd_spacings_in_metres(tmp_path):
    path = raw(
        tmp_path / "v.nrrd",
        NRRD + 'dimension: 3\nsizes: 5 4 3\nspacings: 5e-4 5e-4 1e-3\nunits: "m" "m" "m"\n',
    )
    np.testing.assert_allclose(burrlab.read_volume(path).spacing, (0.5, 0.5, 1.0))
    path = raw(
        tmp_path / "v.nrrd", NRRD + 'dimension: 3\nsizes: 5 4 3\nspacings: 1 1 1\nunits: "m" "mm" "ell"\n'
    )
    with pytest.raises(ValueError, match="units of space in the NRRD header must be one of"):
        burrlab.read_volume(path)


@pytest.mark.parametrize(
    "head",
    [
        "dimension: 4\nsizes: 5 4 3 1\nspace directions: (1,0,0) (0,1,0) (0,0,2) none\nkinds: domain domain domain list\n",
        "dimension: 4\nsizes: 1 5 4 3\nspace directions: none (1,0,0) (0,1,0) (0,0,2)\nkinds: vector domain domain domain\n",
        "dimension: 4\nsizes: 5 4 3 1\nspacings: 1 1 2 7\n",
    ],
)
def test_a_fourth_axis_of_one_is_no_axis(tmp_path, head):
    if "directions" in head:
        head = "space: left-posterior-superior\n" + head
    volume = burrlab.read_volume(raw(tmp_path / "v.nrrd", NRRD + head))
    np.testing.assert_array_equal(volume.values, a_volume().values)
    np.testing.assert_array_equal(volume.spacing, (1, 1, 2))


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("dimension: 4\nsizes: 5 4 1 3\nkinds: domain domain domain vector\n", "one value a voxel, got sizes 5 x 4 x 1 x 3"),
        ("dimension: 2\nsizes: 5 12\n", "three dimensions"),
        ("dimension: 3\n", "the NRRD header has no sizes"),
        ("dimension: 3\nsizes: 5 4 3 1\n", "contradicts its dimension 3"),
        ("dimension: 3\nsizes: 5 4 3\nspace: LPS\nspace directions: (1,0) (0,1) (1,1)\n", "three vectors of three"),
        ("dimension: 3\nsizes: 5 4 3\nspace: LPS\nspace directions: (1,0,0) (0.5,1,0) (0,0,1)\n", "not orthonormal"),
        ("dimension: 3\nsizes: 5 4 3\nspace: LPS\nspace directions: (a,0,0) (0,1,0) (0,0,1)\n", "is no vector"),
        ("dimension: 3\nsizes: 5 4 3\nspacings: 1 1\n", "spacings of the NRRD header are '1 1'"),
        ("dimension: 3\nsizes: 5 4 3\nspacings: 1 1 1\nspace origin: (1,2)\n", "space origin of the NRRD header must be"),
    ],
)  # fmt: skip
def test_wrong_nrrd(tmp_path, head, message):
    with pytest.raises(ValueError, match=message):
        burrlab.read_volume(raw(tmp_path / "v.nrrd", NRRD + head))


def test_nrrd_space_that_is_not_anatomical_is_noted(tmp_path):
    head = "dimension: 3\nsizes: 5 4 3\nspace: scanner-xyz\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (1,2,3)\n"
    assert burrlab.read_volume(raw(tmp_path / "v.nrrd", NRRD + head)).notes == (
        "space 'scanner-xyz' of the NRRD header is no anatomical one: its axes are taken as L, P, S",
    )


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("DimSize = 5 4 3\n", "does not say the voxel spacing along x, y, z"),
        ("DimSize = 5 4 3\nElementSpacing = 1 1 0\n", "does not say the voxel spacing along z"),
        (
            "DimSize = 5 4 3\nElementSpacing = 1 1 1\nTransformMatrix = 1 0 0 0.5 1 0 0 0 1\n",
            "not orthonormal",
        ),
        (
            "DimSize = 5 4 3\nElementSpacing = 1 1 1\nTransformMatrix = 1 0 0 1\n",
            "must hold 9 numbers, got 4",
        ),
        (
            "DimSize = 5 4 3\nElementSpacing = 1 1 1\nElementNumberOfChannels = 3\n",
            "one value a voxel, got 3",
        ),
        ("DimSize = 5 4 3\nElementSpacing = a b c\n", "ElementSpacing of the MetaImage header is 'a b c'"),
        ("DimSize = 60\nElementSpacing = 1 1 1\n", "three dimensions"),
        ("DimSize = 5 4 3\nElementSpacing = 1 1 1\nDistanceUnits = ell\n", "DistanceUnits must be one of"),
        ("ElementSpacing = 1 1 1\n", "the MetaImage header has no DimSize"),
    ],
)
def test_wrong_meta_image(tmp_path, head, message):
    with pytest.raises(ValueError, match=message):
        burrlab.read_volume(raw(tmp_path / "v.mha", META + head))


def test_meta_image_without_spacing_takes_the_given_or_the_size_of_elements(tmp_path):
    path = raw(tmp_path / "v.mha", META + "DimSize = 5 4 3\n")
    np.testing.assert_array_equal(burrlab.read_volume(path, spacing=(1, 2, 3)).spacing, (1, 2, 3))
    path = raw(tmp_path / "v.mha", META + "DimSize = 5 4 3\nElementSize = 1 1 4\n")
    np.testing.assert_array_equal(burrlab.read_volume(path).spacing, (1, 1, 4))


def test_meta_image_with_its_values_in_another_file(tmp_path):
    volume = a_volume()
    head = (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nElementSpacing = 0.1 0.25 0.7\nDimSize = 5 4 3\n"
        "ElementType = MET_SHORT\nElementDataFile = v.raw\n"
    )
    (tmp_path / "v.mhd").write_text(head)
    with pytest.raises(ValueError, match=r"v\.mhd: the file of its values, v\.raw, is not there"):
        burrlab.read_volume(tmp_path / "v.mhd")
    (tmp_path / "v.raw").write_bytes(volume.values.tobytes())
    np.testing.assert_array_equal(burrlab.read_volume(tmp_path / "v.mhd").values, volume.values)
    (tmp_path / "v.raw").write_bytes(volume.values.tobytes()[:-2])
    with pytest.raises(ValueError, match=r"v\.mhd: the file is cut short: 118 bytes of values, of 120"):
        burrlab.read_volume(tmp_path / "v.mhd")


@pytest.mark.parametrize("cut", [1, 8, 30])
def test_a_damaged_meta_image(tmp_path, cut):
    path = tmp_path / "v.mha"
    burrlab.write_volume(path, a_volume())
    content = bytearray(path.read_bytes())
    content[-cut] ^= 0x55
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"v\.mha: the compressed data is cut short or damaged"):
        burrlab.read_volume(path)


@pytest.mark.parametrize("name", ["v.nrrd", "v.nii", "v.nii.gz", "v.mha"])
@pytest.mark.parametrize("compress", [False, True])
def test_one_byte_less_is_an_error(tmp_path, name, compress):
    path = tmp_path / name
    burrlab.write_volume(path, a_volume(), compress=compress)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(
        ValueError, match=rf"{name}: (cannot be read|the file is cut|the compressed data is cut)"
    ):
        burrlab.read_volume(path)


def test_a_damaged_gzip_is_an_error(tmp_path):
    path = tmp_path / "v.nii.gz"
    burrlab.write_volume(path, a_volume())
    content = bytearray(gzip.decompress(path.read_bytes()))
    packed = bytearray(gzip.compress(content))
    packed[len(packed) // 2] ^= 0xFF
    path.write_bytes(packed)
    with pytest.raises(ValueError, match="cut short or damaged"):
        burrlab.read_volume(path)


def test_other_errors(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_bytes(b"\x89PNG")
    with pytest.raises(
        ValueError, match=r"a\.png: cannot be read as a volume: it must be a folder of DICOM slices or end in"
    ):
        burrlab.read_volume(tmp_path / "a.png")
    with pytest.raises(ValueError, match="path must end in one of"):
        burrlab.write_volume(tmp_path / "v.mhd", a_volume())
    with pytest.raises(FileNotFoundError, match="folder must exist"):
        burrlab.write_volume(tmp_path / "none" / "v.mha", a_volume())
    half = Volume(np.zeros((2, 2, 2), np.float16), (1, 1, 1), (0, 0, 0), np.eye(3), "half")
    with pytest.raises(ValueError, match=r"values of float16 cannot be written as \.nrrd"):
        burrlab.write_volume(tmp_path / "v.nrrd", half)
    burrlab.write_volume(tmp_path / "v.nrrd", a_volume())
    with pytest.raises(ValueError, match="series goes with DICOM"):
        burrlab.read_volume(tmp_path / "v.nrrd", series="1.2")
    (tmp_path / "bad.nii").write_bytes(b"\x5c\x01\0\0" + bytes(400))
    with pytest.raises(ValueError, match="no NIfTI header"):
        burrlab.read_volume(tmp_path / "bad.nii")
    nifti(tmp_path / "two.nii", np.zeros((4, 5), np.int16), affine=np.eye(4))
    with pytest.raises(ValueError, match="three dimensions and one value a voxel, got sizes 5 x 4"):
        burrlab.read_volume(tmp_path / "two.nii")
    nifti(tmp_path / "complex.nii", np.zeros((4, 5, 6), np.complex64), affine=np.eye(4))
    with pytest.raises(ValueError, match="got NIfTI datatype 32"):
        burrlab.read_volume(tmp_path / "complex.nii")
    monkeypatch.setitem(__import__("sys").modules, "SimpleITK", None)
    with pytest.raises(
        ImportError, match=r"writing volumes needs SimpleITK: pip install 'burrlab\[medical\]'"
    ):
        burrlab.write_volume(tmp_path / "w.nrrd", a_volume())


def test_labels(tmp_path):
    labels = LabelVolume(np.arange(24).reshape(2, 3, 4) % 5, (1, 1, 2), (0, 1, 2), TURNED, "made")
    for name in ("l.nrrd", "l.nii.gz", "l.mha"):
        burrlab.write_volume(tmp_path / name, labels)
        again = burrlab.read_labels(tmp_path / name)
        np.testing.assert_array_equal(again.labels, labels.labels)
        assert same_geometry(again, labels)
    nifti(tmp_path / "float.nii", labels.labels.astype(np.float32), affine=np.eye(4))
    assert burrlab.read_labels(tmp_path / "float.nii").labels.dtype == np.int32
    nifti(tmp_path / "float.nii", labels.labels + np.float32(0.5) * (labels.labels == 3), affine=np.eye(4))
    with pytest.raises(
        ValueError, match=r"labels must be whole numbers, got 3\.5 at \(z, y, x\) = \(0, 0, 3\)"
    ):
        burrlab.read_labels(tmp_path / "float.nii")


def test_names_and_colours_of_a_segmentation(tmp_path):
    head = (
        "dimension: 3\nsizes: 5 4 3\nspace: left-posterior-superior\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\n"
        "Segment0_LabelValue:=7\nSegment0_Name:=facial nerve\nSegment0_Color:=1 0.8 0\nSegment1_LabelValue:=2\n"
    )
    labels = burrlab.read_labels(raw(tmp_path / "l.seg.nrrd", NRRD + head))
    assert labels.names == {7: "facial nerve"}
    assert labels.colours == {7: (255, 204, 0)}
