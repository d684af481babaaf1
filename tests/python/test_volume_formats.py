"""Formats of volumes: round trips checked with independent readers, files cut short, labels, headers, DICOM."""

import os
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from session_scenes import file_size_limit, refused

from burrlab.volume import (
    LabelVolume,
    OccupancyMap,
    Volume,
    read_labels,
    read_volume,
    same_geometry,
    save_drilled,
    write_dicom,
    write_volume,
)

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
nibabel = pytest.importorskip("nibabel", reason="an independent reader of NIfTI, extra `dev`")
nrrd = pytest.importorskip("nrrd", reason="an independent reader of NRRD, extra `dev`")
pydicom = pytest.importorskip("pydicom", reason="an independent reader of DICOM, extra `dev`")
from volume_scenes import ASKEW, TURNED, a_volume, nifti, raw  # noqa: E402

MIRRORED = TURNED * (1.0, 1.0, -1.0)
RIGHT_HANDED = ASKEW * np.sign(np.linalg.det(ASKEW))

KINDS = ["u1", "i2", "u2", "i4", "f4", "f8"]


def parse_meta_image(path):
    """Values, spacing, offset and axes (rows) of an .mha: its text up to ElementDataFile, then the values."""
    text, _, rest = path.read_bytes().partition(b"ElementDataFile = LOCAL\n")
    fields = dict(line.split(" = ", 1) for line in text.decode().splitlines())
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
    """Values (z, y, x), spacing, origin and direction in LPS, by an independent reader."""
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


def assert_equal(found, volume, close):
    """Asserts that values and their type are equal, and the geometry within `close`."""
    assert found.values.dtype == volume.values.dtype
    np.testing.assert_array_equal(found.values, volume.values)
    np.testing.assert_allclose(found.spacing, volume.spacing, rtol=close)
    np.testing.assert_allclose(found.origin, volume.origin, rtol=close)
    np.testing.assert_allclose(found.direction, volume.direction, atol=close)
    assert same_geometry(volume, found)


@pytest.mark.parametrize(
    ("kind", "direction"), list(zip(KINDS, 2 * [np.eye(3), TURNED, MIRRORED], strict=True))
)
@pytest.mark.parametrize("name", ["v.nrrd", "v.nii", "v.nii.gz", "v.mha"])
def test_round_trip(tmp_path, name, kind, direction):
    volume, path = a_volume(kind, direction), tmp_path / name
    write_volume(path, volume)
    again = read_volume(path)
    close = 3e-7 if "nii" in name else 1e-15  # NIfTI keeps float32
    for found in (again, Volume(*independently(path), "by others")):
        assert_equal(found, volume, close)
    assert ["mirror image" in note for note in again.notes] == [True] * (direction is MIRRORED)
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["v.nrrd", "v.mha"])
def test_files_by_other_programs(tmp_path, name):
    """Units differ, and NRRD is in RAS; test_nifti has files by nibabel."""
    volume, path = a_volume(), tmp_path / name
    if name == "v.nrrd":
        vectors = volume.direction * volume.spacing
        header = {"space": "right-anterior-superior", "space directions": 1e3 * (np.diag([-1, -1, 1]) @ vectors).T,
                  "space origin": 1e3 * volume.origin * (-1, -1, 1), "space units": ["um", "um", "um"]}  # fmt: skip
        nrrd.write(str(path), volume.values.T, header)
    else:
        text = (
            "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = "
            "False\nCompressedData = False\nTransformMatrix = "
            f"{' '.join(map(repr, volume.direction.T.ravel().tolist()))}\nOffset = "
            f"{' '.join(repr(o / 10) for o in volume.origin.tolist())}\nDistanceUnits = cm\nElementSpacing = "
            f"{' '.join(repr(s / 10) for s in volume.spacing.tolist())}\nDimSize = 5 4 3\nElementType = "
            "MET_SHORT\nElementDataFile = LOCAL\n"
        )
        path.write_bytes(text.encode() + volume.values.tobytes())
    again = read_volume(path)
    np.testing.assert_array_equal(again.values, volume.values)
    np.testing.assert_allclose(again.spacing, volume.spacing, rtol=3e-7)
    assert same_geometry(again, volume)


@pytest.mark.parametrize("name", ["v.nrrd", "v.nii", "v.nii.gz", "v.mha"])
@pytest.mark.parametrize("compress", [False, True])
def test_one_byte_less_is_an_error(tmp_path, name, compress):
    path = tmp_path / name
    write_volume(path, a_volume(), compress=compress)
    path.write_bytes(path.read_bytes()[:-1])
    refused(
        (lambda: read_volume(path),
         rf"{name}: (cannot be read|the file is cut|the compressed data is cut)"),
    )  # fmt: skip


def test_other_errors(tmp_path, monkeypatch):
    for name, content in (
        ("a.png", b"\x89PNG"),
        ("text.nrrd", b"nothing of the kind"),
        ("short.nii", b"\x5c\1"),
    ):
        (tmp_path / name).write_bytes(content)
    (tmp_path / "v.dcm").write_bytes(bytes(128) + b"DICM")
    half = Volume(np.zeros((2, 2, 2), np.float16), (1, 1, 1), (0, 0, 0), np.eye(3), "half")
    write_volume(tmp_path / "v.nrrd", a_volume())
    place = r": cannot be read as a volume: it must be a folder of DICOM slices or end in"
    refused(
        (lambda: read_volume(tmp_path / "a.png"), rf"a\.png{place}"),
        (lambda: read_volume(tmp_path / "none.nrrd"), r"none\.nrrd: no such file", FileNotFoundError),
        (
            lambda: read_volume(tmp_path / "text.nrrd"),
            r"text\.nrrd: cannot be read as a volume: no NRRD header",
        ),
        (lambda: read_volume(tmp_path / "short.nii"), "too short for a NIfTI header"),
        (lambda: write_volume(tmp_path / "v.mhd", a_volume()), "path must end in one of"),
        (lambda: write_volume(tmp_path / "none/v.mha", a_volume()), "folder must exist", FileNotFoundError),
        (lambda: write_volume(tmp_path / "v.nrrd", half), r"values of float16 cannot be written as \.nrrd"),
        (lambda: read_volume(tmp_path / "v.nrrd", series="1.2"), "series goes with DICOM"),
    )
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    assert read_volume(tmp_path / "v.nrrd").shape == (3, 4, 5)  # reading NRRD needs no SimpleITK
    needs = r"needs SimpleITK: pip install 'burrlab\[medical\]'"
    refused(
        (lambda: write_volume(tmp_path / "w.nrrd", a_volume()), f"writing volumes {needs}"),
        (lambda: read_volume(tmp_path / "v.dcm"), f"reading DICOM {needs}"),
        error=ImportError,
    )


def test_labels(tmp_path):
    labels = LabelVolume(np.arange(24).reshape(2, 3, 4) % 5, (1, 1, 2), (0, 1, 2), TURNED, "made")
    for name in ("l.nrrd", "l.nii.gz", "l.mha"):
        write_volume(tmp_path / name, labels)
        again = read_labels(tmp_path / name)
        np.testing.assert_array_equal(again.labels, labels.labels)
        assert same_geometry(again, labels)
    nifti(tmp_path / "float.nii", labels.labels.astype(np.float32), affine=np.eye(4))
    assert read_labels(tmp_path / "float.nii").labels.dtype == np.int32
    nifti(tmp_path / "part.nii", labels.labels + np.float32(0.5) * (labels.labels == 3), affine=np.eye(4))
    nifti(tmp_path / "large.nii", labels.labels.astype(np.float64) * 2.0**30, affine=np.eye(4))
    nifti(tmp_path / "wide.nii", labels.labels.astype(np.uint32) * 2**30, affine=np.eye(4))
    whole = r"labels must be whole numbers below 2\^31, got {} at \(z, y, x\) = \(0, 0, {}\)"
    refused(
        (lambda: read_labels(tmp_path / "part.nii"), whole.format(r"3\.5", 3)),
        (lambda: read_labels(tmp_path / "large.nii"), whole.format("2147483648", 2)),
        (lambda: read_labels(tmp_path / "wide.nii"), whole.format("2147483648", 2)),
    )


@pytest.mark.parametrize("ending", ["nrrd", "mha", "nii.gz"])
@pytest.mark.parametrize("axes", ["spacings: .5 .5 .5", "space directions: (-.5,0,0) (0,.5,0) (0,0,.5)"])
def test_written_files_keep_the_note_on_an_assumed_orientation(
    ending: str, axes: str, tmp_path: Path
) -> None:
    """The first file has no orientation; the written headers say LPS. A mirrored one is called so once."""
    silent = tmp_path / "silent.nrrd"
    head = f"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 5 6\n{axes}\nencoding: raw\n\n"
    silent.write_bytes(head.encode() + bytes(range(120)))
    for k in range(3):  # also copies of copies
        write_volume(
            tmp_path / f"{k}.{ending}", read_volume(silent if k == 0 else tmp_path / f"{k - 1}.{ending}")
        )
        notes = read_volume(tmp_path / f"{k}.{ending}").notes
        assert [note for note in notes if "LPS assumed" in note] == [
            f"{tmp_path / f'{k}.{ending}'} was written from a file that says no orientation: LPS assumed"
        ]
        assert sum("left-handed" in note for note in notes) == ("-.5" in axes)


@pytest.mark.parametrize("save", ["write_volume", "save_drilled"])
@pytest.mark.parametrize("name", ["v.nrrd", "v.nii", "v.nii.gz", "v.mha"])
def test_a_full_disk_leaves_the_older_file_and_is_named(
    save: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(1).integers(-999, 999, (60, 60, 60)).astype(np.int16)
    path, mapping = tmp_path / name, OccupancyMap.two_point(0, 500)
    volumes = [Volume(noise[:size], (0.1,) * 3, (0, 0, 0), np.eye(3), "noise") for size in (6, 60)]

    def write(volume: Volume) -> None:
        if save == "write_volume":
            return write_volume(path, volume)
        return save_drilled(path, volume.to_bone(mapping), volume, mapping=mapping)

    write(volumes[0])
    before = {place: place.read_bytes() for place in tmp_path.iterdir()}
    with file_size_limit(100_000), pytest.raises(OSError, match=f"File too large: '{path}'"):
        write(volumes[1])
    assert {place: place.read_bytes() for place in tmp_path.iterdir()} == before


# --- Headers of NRRD and MetaImage: what they lack, assumptions, refusals ---------------------------------


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
    volume = read_volume(raw(tmp_path / name, head + sizes), spacing=given)
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
    volume = read_volume(raw(tmp_path / "v.nrrd", NRRD + head))
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
        (MGRID + SPACING + "Origin = 1 2 3\nOffset = 1 2 4\n", "Offset, Origin of the MetaImage header must agree"),
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
    refused((lambda: read_volume(path), rf"{name}: .*{message}"))


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
        (b"encoding: raw", b"encoding: raw\nline skip: 99999999999",
         "the file is cut short: 0 bytes of values, of 120"),
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
    refused((lambda: read_volume(path), rf"{name}: {message}"))


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
    found = read_volume(raw(tmp_path / name, head)).notes
    assert [note.split(": LPS assumed")[0] for note in found if "LPS assumed" in note] == notes


def test_meta_image_with_its_values_in_another_file(tmp_path):
    volume = a_volume()
    (tmp_path / "v.mhd").write_text(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nElementSpacing = 0.1 0.25 0.7\nDimSize = 5 4 3\n"
        "ElementType = MET_SHORT\nElementDataFile = v.raw\n"
    )
    refused(
        (lambda: read_volume(tmp_path / "v.mhd"),
         r"v\.mhd: the file of its values, v\.raw, is not there"),
    )  # fmt: skip
    (tmp_path / "v.raw").write_bytes(volume.values.tobytes())
    np.testing.assert_array_equal(read_volume(tmp_path / "v.mhd").values, volume.values)
    (tmp_path / "v.raw").write_bytes(volume.values.tobytes()[:-2])
    refused(
        (lambda: read_volume(tmp_path / "v.mhd"),
         r"v\.mhd: the file is cut short: 118 bytes of values, of 120"),
    )  # fmt: skip


@pytest.mark.parametrize("cut", [1, 8, 30])
@pytest.mark.parametrize("name", ["v.mha", "v.nii.gz"])
def test_damaged_packed_values(tmp_path, name, cut):
    path = tmp_path / name
    write_volume(path, a_volume())
    content = bytearray(path.read_bytes())
    content[-cut] ^= 0x55
    path.write_bytes(content)
    refused((lambda: read_volume(path), rf"{name}: the compressed data is cut short or damaged"))


@pytest.mark.parametrize("told", ["9", "9x", "999999"])
def test_a_wrong_size_of_packed_values(tmp_path, told):
    """SimpleITK unpacks the stated bytes, and leaves the other voxels uninitialised."""
    path = tmp_path / "v.mha"
    write_volume(path, a_volume())
    head, _, tail = path.read_bytes().partition(b"CompressedDataSize = ")
    own, _, rest = tail.partition(b"\n")
    path.write_bytes(head + b"CompressedDataSize = " + told.encode() + b"\n" + rest)
    refused(
        (lambda: read_volume(path),
         rf"CompressedDataSize of the MetaImage header must be {int(own)}, got {told}$"),
    )  # fmt: skip
    path.write_bytes(head + rest)
    refused((lambda: read_volume(path), rf"must be {int(own)}, got none"))
    before, _, packed = rest.partition(b"LOCAL\n")
    (tmp_path / "v.mhd").write_bytes(head + before + b"v.zraw\n")
    (tmp_path / "v.zraw").write_bytes(packed)
    np.testing.assert_array_equal(read_volume(tmp_path / "v.mhd").values, a_volume().values)


def test_a_path_that_is_not_utf_8(tmp_path):
    """SimpleITK ends the process at such a path."""
    folder = os.fsdecode(os.fsencode(tmp_path / "ct") + b"\xe9")
    os.mkdir(folder)
    path = raw(Path(folder) / "v.nrrd", NRRD + GRID + "spacings: 1 1 1\n")
    (Path(folder) / "v.dcm").write_bytes(bytes(128) + b"DICM")
    volume = a_volume()
    calls = (
        lambda: read_volume(path),
        lambda: read_volume(folder),
        lambda: write_volume(Path(folder) / "w.nrrd", volume),
        lambda: write_dicom(Path(folder) / "w", volume),
    )
    refused(*((call, r"path must be UTF-8, got '.*ct.udce9") for call in calls))
    assert sorted(os.listdir(folder)) == ["v.dcm", "v.nrrd"]


# --- DICOM ------------------------------------------------------------------------------------------------


def a_series(kind="i2", direction=RIGHT_HANDED):
    """A volume whose place and spacing need all digits."""
    return replace(
        a_volume(kind, direction), spacing=(0.1, 0.25, 1 / 3), origin=(-31.25, 12.123456789, 1024.3)
    )


@pytest.mark.parametrize(
    ("kind", "direction"), [("u1", np.eye(3)), ("i2", RIGHT_HANDED), ("u2", RIGHT_HANDED)], ids=str
)
def test_round_trip_of_dicom(tmp_path, kind, direction):
    volume = a_series(kind, direction)
    write_dicom(tmp_path / "ct", volume)
    again = read_volume(tmp_path / "ct")
    assert_equal(again, volume, 1e-11)
    assert again.notes == ()
    assert [path.name for path in tmp_path.iterdir()] == ["ct"]
    slices = [pydicom.dcmread(path) for path in sorted((tmp_path / "ct").iterdir())]
    for k, (found, values) in enumerate(zip(slices, volume.values, strict=True)):
        np.testing.assert_array_equal(found.pixel_array, values)
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
        write_dicom(tmp_path / name, a_series())
    write_dicom(tmp_path / "c", replace(a_series(), values=a_series().values + 1))
    uids = [pydicom.dcmread(tmp_path / name / "slice0002.dcm").SOPInstanceUID for name in "abc"]
    assert uids[0] == uids[1] != uids[2]


def test_refused_by_dicom(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("something")
    real, mirrored = a_series("f4"), a_series(direction=MIRRORED)
    refused(
        (lambda: write_dicom(tmp_path / "ct", real), "values must be one of uint8, int16, uint16 to be .* got float32"),
        (lambda: write_dicom(tmp_path / "ct", mirrored), "direction must be right-handed to be written as DICOM"),
        (lambda: write_dicom(tmp_path / "none/ct", a_series()), "folder must exist", FileNotFoundError),
        (lambda: write_dicom(tmp_path / "file", a_series()), "folder must be new", FileExistsError),
    )  # fmt: skip
    monkeypatch.setattr("SimpleITK.ImageFileWriter.Execute", Mock(side_effect=RuntimeError("disk full")))
    refused((lambda: write_dicom(tmp_path / "ct", a_series()), "the slices cannot be written", OSError))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
