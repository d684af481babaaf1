"""Half-drilled DICOM series of unusual kinds: chosen files, spare bits, crops, labels, broken headers; the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drilled_scenes import MAP, SHAPE, drilled, greys

from burrlab._core import VoxelBone
from burrlab.bone.formats import read_labels, read_volume
from burrlab.bone.image import OccupancyMap
from burrlab.bone.kept import check_drilled, load_drilled, save_drilled
from burrlab.cli import main
from burrlab.session.trace import load_trace

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pydicom = pytest.importorskip("pydicom", reason="makes the series and is the independent reader, extra `dev`")
from dicom_series import write_series  # noqa: E402
from test_drilled_dicom import check, series  # noqa: E402


def test_one_series_of_a_folder_and_files_in_any_order(tmp_path: Path) -> None:
    folder = series(tmp_path / "ct")
    write_series(folder, greys("i2")[:4], series="9.8", names=[f"o{k}" for k in range(4)])
    like = read_volume(folder, series="1.2.3.4")
    bone = drilled(like)
    save_drilled(tmp_path / "kept", bone, like, mapping=MAP)
    assert load_drilled(tmp_path / "kept").bone.digest() == bone.digest()
    files = sorted(folder.glob("slice*"), reverse=True)
    like = read_volume(files)
    assert like.files == tuple(str(path) for path in files[::-1])
    save_drilled(tmp_path / "other", bone, like, mapping=MAP)
    for path in (tmp_path / "kept").glob("*.dcm"):
        assert path.read_bytes() == (tmp_path / "other" / path.name).read_bytes()


def test_fewer_bits_than_there_are(tmp_path: Path) -> None:
    """12 bits of 16, signed and not, and a scale of its own in each slice."""
    for sign in (0, 1):
        values = (greys("i4").clip(0, 2000) - 700 * sign).astype("i2")
        folder = series(
            tmp_path / f"ct{sign}",
            values,
            BitsStored=12,
            HighBit=11,
            PixelRepresentation=sign,
            RescaleIntercept="0",
        )
        for k, path in enumerate(sorted(folder.iterdir())):
            found = pydicom.dcmread(path)
            found.RescaleSlope = str(1 + k / 4)
            if sign == 0:  # an overlay, as old files have it, in the bits that are spare
                found.PixelData = (np.frombuffer(found.PixelData, "<u2") | 0x5000).tobytes()
            found.save_as(path)
        like = read_volume(folder)
        bone = drilled(like)
        save_drilled(tmp_path / f"kept{sign}", bone, like, mapping=MAP)
        kept = read_volume(tmp_path / f"kept{sign}")
        whole = bone.density == bone.pristine
        np.testing.assert_array_equal(kept.values[whole], like.values[whole])
        assert (MAP.levels(kept.values)[(bone.density == 0) & ~whole] == 0).all()
        assert load_drilled(tmp_path / f"kept{sign}").bone.digest() == bone.digest()
        low = OccupancyMap.two_point(-1000 if sign == 0 else -2100, 1200)
        with pytest.raises(
            ValueError, match=r"slice000\.dcm can hold, .*: it holds u?int16, (0|-2048) to (4095|2047), got"
        ):
            check_drilled(tmp_path / "no", like, low)


def test_crops_get_new_headers_and_labels_stay_labels(tmp_path: Path) -> None:
    folder = series(tmp_path / "ct")
    crop = read_volume(folder).crop_voxels((1, 2, 3), (13, 15, 17))
    bone = drilled(crop)
    save_drilled(tmp_path / "crop", bone, crop, mapping=MAP)
    np.testing.assert_allclose(read_volume(tmp_path / "crop").corners(), crop.corners(), atol=1e-9)
    assert load_drilled(tmp_path / "crop").bone.digest() == bone.digest()
    with pytest.raises(
        ValueError,
        match="values must be one of uint8, int16, uint16 to be written as DICOM, got float32; the ending of another format",
    ):
        check_drilled(tmp_path / "fine", replace(crop, values=crop.values.astype(np.float32) + 0.5), MAP)
    series(
        tmp_path / "segments",
        (np.arange(np.prod(SHAPE)).reshape(SHAPE) % 3).astype("i2"),
        RescaleIntercept="0",
    )
    labels = read_labels(tmp_path / "segments")
    solid = VoxelBone(
        np.where(labels.labels > 0, 255, 0).astype(np.uint8),
        spacing=labels.spacing,
        origin=labels.bone_point(labels.origin),
    )
    density = solid.density.copy()
    density[4:8] //= 3
    solid.restore(density)
    save_drilled(tmp_path / "cut", solid, labels)
    expected = labels.labels.copy()
    expected[4:8] = 0
    np.testing.assert_array_equal(read_labels(tmp_path / "cut").labels, expected)
    assert load_drilled(tmp_path / "cut").bone.digest() == solid.digest()
    np.testing.assert_array_equal(load_drilled(tmp_path / "cut").volume().labels, expected)


def test_other_voxels_are_rounded_to_whole_grey_values(tmp_path: Path) -> None:
    """Clinical slices are burred on finer voxels: `--voxel` with `--save FOLDER`."""
    like = read_volume(series(tmp_path / "ct")).resample(0.2)
    bone = drilled(like)
    save_drilled(tmp_path / "fine", bone, like, mapping=MAP)
    kept = read_volume(tmp_path / "fine")
    assert kept.values.dtype == np.int16
    np.testing.assert_allclose(kept.corners(), like.corners(), atol=1e-9)
    whole = bone.density == bone.pristine
    np.testing.assert_array_equal(kept.values[whole], np.rint(like.values[whole]))
    assert (MAP.levels(kept.values)[(bone.density == 0) & ~whole] == 0).all()
    again = load_drilled(tmp_path / "fine")
    assert again.bone.digest() == bone.digest()
    save_drilled(tmp_path / "later", again.bone, again.volume(), mapping=again.mapping)


def test_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    series(Path("ct"))
    hand = [
        "session",
        "--device",
        "hand",
        "--radius",
        "2.5",
        "--duration",
        "0.2",
        "--seed",
        "3",
        "--no-realtime",
    ]
    like = read_volume("ct")
    entry = ",".join(f"{x:.3f}" for x in like.origin + like.patient_point(like.spacing * (9, 8, 12)))
    there = ["--entry", entry, "--axis", "0,0,-1"]
    assert main([*hand, "--volume", "ct", "--map", "200:1200", *there, "--save", "kept"]) == 0
    assert "bone saved as kept" in capsys.readouterr().err
    kept = load_drilled("kept")
    assert kept.tick == 200
    assert kept.bone.removed > 0
    check(Path("ct"), Path("kept"), like)
    assert main([*hand, "--bone", "kept", *there, "--save", "later", "--record", "later.h5"]) == 0
    later = load_drilled("later")
    assert (later.tick, load_trace("later.h5").bone().digest()) == (400, kept.bone.digest())
    np.testing.assert_array_equal(later.bone.pristine, kept.bone.pristine)
    capsys.readouterr()
    assert main([*hand, "--bone", "later", *there, "--save", "kept"]) == 2
    assert "--save: path must be a new folder, kept is there" in capsys.readouterr().err


def test_what_cannot_be_taken_apart(tmp_path: Path) -> None:
    folder = series(tmp_path / "ct")
    like = read_volume(folder)
    one = folder / "slice004.dcm"
    content = one.read_bytes()

    def refused(match: str, kind: type[Exception] = ValueError, path: str = "kept") -> None:
        with pytest.raises(kind, match=match):
            check_drilled(tmp_path / path, like, MAP)
        with pytest.raises(kind, match=match):
            save_drilled(tmp_path / path, like.to_bone(MAP), like, mapping=MAP)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["ct"]

    found = pydicom.dcmread(one)
    found.HighBit, found.BitsStored = 13, 12
    found.save_as(one)
    like = read_volume(folder)
    refused("16 bits allocated, 12 stored, the highest at 13")
    one.unlink()
    refused(r"slice004\.dcm: no such file", FileNotFoundError)
    one.write_bytes(content)
    like = read_volume(folder)
    refused(
        r"path must be a new folder for a DICOM series, and not one file, got .*kept\.dcm", path="kept.dcm"
    )


def test_a_slice_without_file_meta_information_gets_it(tmp_path: Path) -> None:
    folder = series(tmp_path / "ct")
    one = folder / "slice004.dcm"
    one.write_bytes(one.read_bytes()[pydicom.dcmread(one).file_meta.FileMetaInformationGroupLength + 144 :])
    like = read_volume(folder)
    bone = drilled(like)
    save_drilled(tmp_path / "kept", bone, like, mapping=MAP)
    whole, again = bone.density == bone.pristine, read_volume(tmp_path / "kept")
    np.testing.assert_array_equal(again.values[whole], like.values[whole])
    found = pydicom.dcmread(tmp_path / "kept" / "slice0005.dcm")
    assert (found.PatientName, found.file_meta.MediaStorageSOPInstanceUID) == (
        "Phantom^Sept",
        found.SOPInstanceUID,
    )


def test_letters_where_none_may_be_and_what_no_longer_holds(tmp_path: Path) -> None:
    """An image type beyond ASCII stays byte by byte; the least pixel of the series and an icon are of the original alone."""
    icon = pydicom.Dataset()
    icon.Rows = icon.Columns = 1
    folder = series(tmp_path / "ct", SmallestPixelValueInSeries=24, LargestPixelValueInSeries=2524)
    for path in folder.iterdir():
        found = pydicom.dcmread(path)
        found.IconImageSequence = [icon]
        found.save_as(path)
        path.write_bytes(path.read_bytes().replace(b"PRIMARY\\AXIAL", b"PRIMARY\\\xc4XIAL"))
    like = read_volume(folder)
    save_drilled(tmp_path / "kept", drilled(like), like, mapping=MAP)
    for path in (tmp_path / "kept").glob("*.dcm"):
        assert b"DERIVED\\SECONDARY\\\xc4XIAL" in path.read_bytes()
        found = pydicom.dcmread(path)
        for name in ("SmallestPixelValueInSeries", "LargestPixelValueInSeries", "IconImageSequence"):
            assert name not in found
