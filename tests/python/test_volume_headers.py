"""NRRD and MetaImage headers: needed arguments, assumptions, refusals."""

import os
from pathlib import Path

import numpy as np
import pytest
from session_scenes import refused

import burrlab
from burrlab.volume import write_dicom

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
from volume_scenes import a_volume, raw

NRRD = "NRRD0004\ntype: int16\nendian: little\nencoding: raw\n"

META = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"
SPACING = "ElementSpacing = 1 1 1\n"


@pytest.mark.parametrize(
    ("name", "head", "given", "found"),
    [
        ("v.nrrd", NRRD + 'spacings: 5e-4 5e-4 1e-3\nunits: "m" "m" "m"\n', None, (0.5, 0.5, 1)),
        ("v.nrrd", NRRD, 0.3, (0.3, 0.3, 0.3)), ("v.mha", META, (1, 2, 3), (1, 2, 3)),
        ("v.mha", META + "ElementSize = 1 1 4\n", None, (1, 1, 4)),
    ],
)  # fmt: skip
def test_the_spacing_of_the_file_or_the_given_one(tmp_path, name, head, given, found):
    sizes = "dimension: 3\nsizes: 5 4 3\n" if name == "v.nrrd" else "DimSize = 5 4 3\n"
    volume = burrlab.read_volume(raw(tmp_path / name, head + sizes), spacing=given)
    np.testing.assert_allclose(volume.spacing, found)
    assert len(volume.notes) == 2  # on orientation and origin


@pytest.mark.parametrize(
    "head",
    [
        "dimension: 4\nsizes: 5 4 3 1\nspace directions: (1,0,0) (0,1,0) (0,0,2) none\nkinds: domain domain "
        "domain list\n",
        "dimension: 4\nsizes: 1 5 4 3\nspace directions: none (1,0,0) (0,1,0) (0,0,2)\nkinds: vector domain "
        "domain domain\n",
        "dimension: 4\nsizes: 5 4 3 1\nspacings: 1 1 2 7\n",
        "dimension: 4\nsizes: 5 4 3 1\nspace directions: (1,0,0) (0,1,0) (0,0,2) none\nkinds: space space "
        "space time\n",
        "dimension: 4\nsizes: 1 5 4 3\nspace directions: none (1,0,0) (0,1,0) (0,0,2)\n",
    ],
)
def test_a_fourth_axis_of_length_one_is_ignored(tmp_path, head):
    if "directions" in head:
        head = "space: left-posterior-superior\n" + head
    volume = burrlab.read_volume(raw(tmp_path / "v.nrrd", NRRD + head))
    np.testing.assert_array_equal(volume.values, a_volume().values)
    np.testing.assert_array_equal(volume.spacing, (1, 1, 2))


GRID, MGRID = "dimension: 3\nsizes: 5 4 3\n", "DimSize = 5 4 3\n"


@pytest.mark.parametrize(
    ("head", "message"),
    [
        (GRID, "does not say the voxel spacing along x, y, z; it must be given"),
        (GRID + "spacings: 0.5 nan 0.5\n", "does not say the voxel spacing along y"),
        (GRID + 'spacings: 1 1 1\nunits: "m" "mm" "ell"\n',
         "units of space in the NRRD header must be one of"),
        ("dimension: 4\nsizes: 5 4 1 3\nkinds: domain domain domain "
         "vector\n", "one value a voxel, got sizes 5 x 4 x 1 x 3"),
        ("dimension: 2\nsizes: 5 12\n", "three dimensions"), ("dimension: 3\n", "the NRRD header has no sizes"),
        (GRID + "spacings: 1 -1 1\n", "spacings of the NRRD header must be positive, got 1 -1 1"),
        ("dimension: 3\nsizes: 5 4 3 1\n", "contradicts its dimension 3"),
        (GRID + "space: LPS\nspace directions: (1,0) (0,1) (1,1)\n", "three vectors of three"),
        (GRID + "space: LPS\nspace directions: (1,0) (0,1,0) (0,0,1)\n", "three vectors of three"),
        (GRID + "space: LPS\nspace directions: (1,0,0) (0.5,1,0) (0,0,1)\n", "not orthonormal"),
        (GRID + "space: LPS\nspace directions: (a,0,0) (0,1,0) (0,0,1)\n", "is no vector"),
        (GRID + "space: LPS\nspace directions: (nan,0,0) (0,1,0) "
                "(0,0,1)\n", "the direction matrix must be of 3 x 3 finite"),
        (GRID + "spacings: 1 1\n", "spacings of the NRRD header are '1 1'"),
        (GRID + "spacings: 1 1 1\nspace origin: (1,2)\n", "space origin of the NRRD header must be"),
        (GRID + "encoding: bzip2\n", "'encoding' must be once in the NRRD header, got it twice"),
        (GRID + "byte skip: x\nspacings: 1 "
                "1 1\n", "byte skip must be a number of bytes or lines, or -1, got 'x'"),
        (MGRID, "does not say the voxel spacing along x, y, z"),
        (MGRID + "ElementSpacing = -1 1 1\n",
         "ElementSpacing of the MetaImage header must be positive, got -1 1 1"),
        (MGRID + "ElementSpacing = 1 1 0\n", "does not say the voxel spacing along z"),
        (MGRID + "ElementSpacing = a b c\n", "ElementSpacing of the MetaImage header is 'a b c'"),
        (MGRID + "ElementSpacing = 1 1\n", "ElementSpacing must hold 3 numbers, got 2"),
        (MGRID + SPACING + "Offset = nan 0 0\n", "origin must be three finite numbers"),
        (MGRID + SPACING + "TransformMatrix = 1 0 0 0.5 1 0 0 0 1\n", "not orthonormal"),
        (MGRID + SPACING + "TransformMatrix = 1 0 0 1\n", "TransformMatrix must hold 9 numbers, got 4"),
        (MGRID + SPACING + "ElementNumberOfChannels = 3\n", "one value a voxel, got 3"),
        (MGRID + SPACING + "DistanceUnits = ell\n", "DistanceUnits must be one of"),
        (SPACING, "the MetaImage header has no DimSize"), ("DimSize = 60\n" + SPACING, "three dimensions"),
        *[(f"DimSize = {n} 4 3\n" + SPACING,
            f"DimSize must hold whole numbers, got {n} 4 3") for n in ("inf", "nan", "5.5")],
    ],
)  # fmt: skip
def test_wrong_headers(tmp_path, head, message):
    name, first = ("v.mha", META) if " = " in head else ("v.nrrd", NRRD)
    path = raw(tmp_path / name, first + head)
    with pytest.raises(ValueError, match=rf"{name}: .*{message}"):
        burrlab.read_volume(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"type: int16", b"type: block",
         "type of the NRRD file must be one of whole or real numbers, got 'block'"),
        (b"endian: little", b"endian: middle", "endian of the NRRD file must be little or big, got 'middle'"),
        (b"encoding: raw", b"encoding: bzip2",
         "encoding of the NRRD file must be raw, gzip, text or hex, got 'bzip2'"),
        (b"encoding: raw", b"encoding: gzip\nbyte skip: -1",
         "byte skip of -1 goes with raw values, got encoding gzip"),
        (b"\n\n" + a_volume().values.tobytes(), b"\n",
         "the values must follow the NRRD header in the same file"),
        (b"= MET_SHORT", b"= MET_STRING",
         "ElementType of the MetaImage header must be one of .*, got 'MET_STRING'"),
        (b"CompressedData = False", b"CompressedData = True\nHeaderSize = -1",
         "HeaderSize of -1 goes with raw values"),
    ],
)  # fmt: skip
def test_values_that_cannot_be_found(tmp_path, old, new, message):
    name, head = (
        ("v.mha", META + MGRID + SPACING) if b"= " in new else ("v.nrrd", NRRD + GRID + "spacings: 1 1 1\n")
    )
    path = raw(tmp_path / name, head)
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(ValueError, match=rf"{name}: {message}"):
        burrlab.read_volume(path)


_SIZES = "DimSize = 5 4 3\nElementSpacing = 1 1 1\nElementType = MET_SHORT\n"
_DIRECTIONS = "dimension: 3\nsizes: 5 4 3\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (1,2,3)\n"


@pytest.mark.parametrize(
    ("name", "head", "notes"),
    [
        ("v.nrrd", NRRD +
         "dimension: 3\nsizes: 5 4 3\nspacings: 1 1 1\n", ["the NRRD header says no orientation"]),
        ("v.nrrd", NRRD + "space dimension: 3\n" + _DIRECTIONS, [
         "space '' of the NRRD header is no anatomical one"]),
        ("v.nrrd", NRRD + "space: scanner-xyz\n" + _DIRECTIONS, [
         "space 'scanner-xyz' of the NRRD header is no anatomical one"]),
        ("v.nrrd", NRRD + "space: RAS\n" + _DIRECTIONS, []),
        ("v.mha", META + _SIZES, ["the MetaImage header says no orientation"]),
        ("v.mha", META + _SIZES + "AnatomicalOrientation = RAI\n", []),
        ("v.mha", META + _SIZES + "TransformMatrix = 1 0 0 0 1 0 0 0 1\n", []),
    ],
)  # fmt: skip
def test_a_missing_orientation_is_noted_once(tmp_path, name, head, notes):
    found = burrlab.read_volume(raw(tmp_path / name, head)).notes
    assert [note.split(": LPS assumed")[0] for note in found if "LPS assumed" in note] == notes


def test_meta_image_with_its_values_in_another_file(tmp_path):
    volume = a_volume()
    (tmp_path / "v.mhd").write_text(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nElementSpacing = 0.1 0.25 0.7\nDimSize = 5 4 3\n"
        "ElementType = MET_SHORT\nElementDataFile = v.raw\n"
    )
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


@pytest.mark.parametrize("told", ["9", "9x", "999999"])
def test_a_wrong_size_of_packed_values(tmp_path, told):
    """SimpleITK unpacks the stated bytes, and leaves the other voxels uninitialised."""
    path = tmp_path / "v.mha"
    burrlab.write_volume(path, a_volume())
    head, _, tail = path.read_bytes().partition(b"CompressedDataSize = ")
    own, _, rest = tail.partition(b"\n")
    path.write_bytes(head + b"CompressedDataSize = " + told.encode() + b"\n" + rest)
    with pytest.raises(
        ValueError, match=rf"CompressedDataSize of the MetaImage header must be {int(own)}, got {told}$"
    ):
        burrlab.read_volume(path)
    path.write_bytes(head + rest)
    with pytest.raises(ValueError, match=rf"must be {int(own)}, got none"):
        burrlab.read_volume(path)
    before, _, packed = rest.partition(b"LOCAL\n")
    (tmp_path / "v.mhd").write_bytes(head + before + b"v.zraw\n")
    (tmp_path / "v.zraw").write_bytes(packed)
    np.testing.assert_array_equal(burrlab.read_volume(tmp_path / "v.mhd").values, a_volume().values)


def test_a_path_that_is_not_utf_8(tmp_path):
    """SimpleITK ends the process at such a path."""
    folder = os.fsdecode(os.fsencode(tmp_path / "ct") + b"\xe9")
    os.mkdir(folder)
    path = raw(Path(folder) / "v.nrrd", NRRD + GRID + "spacings: 1 1 1\n")
    (Path(folder) / "v.dcm").write_bytes(bytes(128) + b"DICM")
    volume = a_volume()
    calls = (
        lambda: burrlab.read_volume(path),
        lambda: burrlab.read_volume(folder),
        lambda: burrlab.write_volume(Path(folder) / "w.nrrd", volume),
        lambda: write_dicom(Path(folder) / "w", volume),
    )
    refused(*((call, r"path must be UTF-8, got '.*ct.udce9") for call in calls))
    assert sorted(os.listdir(folder)) == ["v.dcm", "v.nrrd"]
