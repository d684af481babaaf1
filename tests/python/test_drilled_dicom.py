"""Half-drilled DICOM series: a derived series under the data sets of the original's slices."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drilled_scenes import MAP, SHAPE, drilled, greys

import burrlab.common.files as files
from burrlab._core import VoxelBone
from burrlab.bone.formats import read_labels, read_volume
from burrlab.bone.image import OccupancyMap
from burrlab.bone.kept import check_drilled, load_drilled, save_drilled
from burrlab.bone.recipe import DrilledRecipe
from burrlab.cli import main
from burrlab.session.trace import load_trace

sitk = pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pydicom = pytest.importorskip("pydicom", reason="makes the series and is the independent reader, extra `dev`")
from dicom_series import write_series  # noqa: E402
from pydicom.sequence import Sequence  # noqa: E402
from pydicom.uid import (  # noqa: E402
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
    RLELossless,
)

ROWS, COLUMNS = (0.6, 0.8, 0.0), (-0.8, 0.6, 0.0)
OWN = {"ImageType", "SOPInstanceUID", "SeriesInstanceUID", "DerivationDescription", "SourceImageSequence", "PixelData"}  # fmt: skip


def series(folder: Path, values: np.ndarray | None = None, **changes: Any) -> Path:
    """Oblique slices with a scale, a window, a patient, private elements and nested sequences."""
    stored = greys("i2") + np.int16(1024) if values is None else values
    write_series(
        folder, stored, step=0.5, spacing=(0.4, 0.3), rows=ROWS, columns=COLUMNS, **{
            "RescaleSlope": "1", "RescaleIntercept": "-1024", "PatientName": "Phantom^Sept", "WindowCenter": "300",
            "WindowWidth": "1500", "ImageType": ["ORIGINAL", "PRIMARY", "AXIAL"], "StudyDescription": "temporal bone",
            "SpecificCharacterSet": "ISO_IR 100", "SmallestImagePixelValue": 24, **changes,
        }
    )  # fmt: skip
    return folder


def again(folder: Path, change: Callable[[Any], None]) -> None:
    for path in folder.iterdir():
        found = pydicom.dcmread(path)
        change(found)
        uid = found.file_meta.TransferSyntaxUID
        pydicom.dcmwrite(
            path,
            found,
            implicit_vr=uid.is_implicit_VR,
            little_endian=uid.is_little_endian,
            force_encoding=True,
        )


def syntax(uid: str) -> Callable[[Any], None]:
    def change(found: Any) -> None:
        found.file_meta.TransferSyntaxUID = uid
        if uid == ExplicitVRBigEndian:
            found["PixelData"]._value = np.frombuffer(found.PixelData, "<i2").astype(">i2").tobytes()

    return change


def nested(found: Any) -> None:
    inner = pydicom.Dataset()
    inner.CodeValue, inner.CodeMeaning = "T-11", "bone"
    outer = pydicom.Dataset()
    outer.AnatomicRegionSequence = Sequence([inner])
    outer.is_undefined_length_sequence_item = True
    outer["AnatomicRegionSequence"].is_undefined_length = True
    found.ReferencedStudySequence = Sequence([outer, outer])
    found["ReferencedStudySequence"].is_undefined_length = True
    found.add_new((0x0009, 0x0010), "LO", "ACME")
    found.add_new((0x0009, 0x1001), "UN", b"\1\2\3\4")


def check(original: Path, saved: Path, like: Any) -> None:
    """What pydicom and SimpleITK see in the slices that were saved."""
    volume, bone = read_volume(saved), load_drilled(saved).bone
    assert volume.values.dtype == like.values.dtype
    for name in ("spacing", "origin", "direction"):
        np.testing.assert_array_equal(getattr(volume, name), getattr(like, name))
    assert volume.notes == ()
    whole = bone.density == bone.pristine
    seen = sorted((pydicom.dcmread(path) for path in saved.glob("*.dcm")), key=lambda s: s.InstanceNumber)
    sources = sorted(map(pydicom.dcmread, original.iterdir()), key=lambda s: s.InstanceNumber)
    assert len(seen) == len(sources) == SHAPE[0]
    for k, (found, source) in enumerate(zip(seen, sources, strict=True)):
        values = found.pixel_array * float(found.RescaleSlope) + float(found.RescaleIntercept)
        np.testing.assert_array_equal(values, volume.values[k])
        np.testing.assert_array_equal(found.pixel_array[whole[k]], source.pixel_array[whole[k]])
        assert (values[(bone.density[k] == 0) & ~whole[k]] == 200).all()
        kept = {e.tag: e for e in source if e.keyword not in OWN | {"SmallestImagePixelValue"}}
        assert kept == {e.tag: e for e in found if e.keyword not in OWN}
        assert list(found.ImageType) == ["DERIVED", "SECONDARY", "AXIAL"]
        assert "half-drilled" in found.DerivationDescription
        (reference,) = found.SourceImageSequence
        assert reference.ReferencedSOPInstanceUID == source.SOPInstanceUID
        assert reference.ReferencedSOPClassUID == source.SOPClassUID
        assert found.file_meta.MediaStorageSOPInstanceUID == found.SOPInstanceUID
        assert found.SOPInstanceUID.is_valid
    assert len({found.SOPInstanceUID for found in seen} | {s.SOPInstanceUID for s in sources}) == 2 * SHAPE[0]
    (own,) = {found.SeriesInstanceUID for found in seen}
    assert own != sources[0].SeriesInstanceUID
    image = sitk.ReadImage(sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(saved), own))
    np.testing.assert_array_equal(sitk.GetArrayFromImage(image), volume.values)
    np.testing.assert_allclose(image.GetSpacing(), like.spacing, rtol=1e-9)
    np.testing.assert_allclose(image.GetOrigin(), like.origin, rtol=1e-9)
    np.testing.assert_allclose(np.reshape(image.GetDirection(), (3, 3)), like.direction, atol=1e-9)


CHANGES = {
    "explicit": lambda found: None,
    "nested": nested,
    "implicit": lambda found: (nested(found), syntax(ImplicitVRLittleEndian)(found)),
    "big-endian": syntax(ExplicitVRBigEndian),
    "deflated": syntax(DeflatedExplicitVRLittleEndian),
    "packed": lambda found: found.compress(RLELossless, generate_instance_uid=False),
}


@pytest.mark.parametrize("kind", CHANGES)
def test_a_derived_series(tmp_path: Path, kind: str) -> None:
    original, saved = series(tmp_path / "ct [1] ä*"), tmp_path / "kept [2] ü?"  # these are no patterns
    again(original, CHANGES[kind])
    before = {path.name: path.read_bytes() for path in original.iterdir()}
    like = read_volume(original)
    bone = drilled(like)
    assert check_drilled(saved, like, MAP) is None
    save_drilled(saved, bone, like, mapping=MAP, tick=40)
    check(original, saved, like)
    recipe, loaded = DrilledRecipe(str(saved)), load_drilled(saved)
    assert recipe.bone().digest() == loaded.bone.digest() == bone.digest()
    assert (recipe.like().shape, loaded.tick, loaded.mapping) == (SHAPE, 40, MAP)
    np.testing.assert_array_equal(loaded.bone.pristine, like.to_bone(MAP).pristine)
    assert {path.name: path.read_bytes() for path in original.iterdir()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == [original.name, saved.name]


def test_saved_again_and_gone_on_with(tmp_path: Path) -> None:
    like = read_volume(series(tmp_path / "ct"))
    bone = drilled(like)
    for name in ("a", "b"):
        save_drilled(tmp_path / name, bone, like, mapping=MAP)
    for path in (tmp_path / "a").glob("*.dcm"):  # the same bone is the same series
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
    with pytest.raises(FileExistsError, match="path must be a new folder"):
        save_drilled(tmp_path / "a", bone, like, mapping=MAP)
    with pytest.raises(ValueError, match="path must be another file than the original"):
        save_drilled(tmp_path / "ct", bone, like, mapping=MAP)
    recipe = DrilledRecipe(str(tmp_path / "a"))
    later, density = recipe.bone(), bone.density.copy()
    density[:5] //= 2
    later.restore(density)
    save_drilled(tmp_path / "c", later, recipe.like(), mapping=recipe.mapping, tick=50)
    assert load_drilled(tmp_path / "c").bone.digest() == later.digest()
    check(tmp_path / "ct", tmp_path / "a", like)
    uids = {
        pydicom.dcmread(tmp_path / name / "slice0001.dcm").SeriesInstanceUID
        for name in (
            "a",
            "b",
            "c",
        )
    }
    assert len(uids) == 2
    with pytest.raises(ValueError, match=r"like must be the original: .*a is half-drilled"):
        save_drilled(tmp_path / "d", like.to_bone(MAP), read_volume(tmp_path / "a"), mapping=MAP)
    one = tmp_path / "a" / "slice0003.dcm"
    one.write_bytes(one.read_bytes()[:-2] + b"\1\1")
    with pytest.raises(ValueError, match=r"bone\.h5 belongs to another content of it"):
        load_drilled(tmp_path / "a")


def test_a_save_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    like = read_volume(series(tmp_path / "ct"))
    bone = drilled(like)

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    for place in (
        "burrlab.bone.kept.write_synced",
        "burrlab.bone.kept.save_bone",
        "os.rename",
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, full)
            with pytest.raises(OSError, match="No space left"):
                save_drilled(tmp_path / "kept", bone, like, mapping=MAP)
        assert [path.name for path in tmp_path.iterdir()] == ["ct"]
    (tmp_path / ".kept.part").mkdir()  # of one that was killed
    (tmp_path / ".kept.part" / "old.dcm").write_bytes(b"old")
    save_drilled(tmp_path / "kept", bone, like, mapping=MAP)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ct", "kept"]
    assert not (tmp_path / "kept" / "old.dcm").exists()


def test_two_that_save_to_one_folder_do_not_mix(tmp_path: Path) -> None:
    like = read_volume(series(tmp_path / "ct"))
    with files.new_folder(tmp_path / "kept") as part:
        (part / "its.dcm").write_bytes(b"another's")
        with pytest.raises(BlockingIOError, match="kept is being written by another process"):
            save_drilled(tmp_path / "kept", drilled(like), like, mapping=MAP)
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["its.dcm"]


def test_a_folder_that_another_begins_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part, rename, wait = tmp_path / ".kept.part", os.rename, files.lock

    def renamed_and_begun(old: Path, new: Path) -> None:
        rename(old, new)
        part.mkdir()

    def lock_later(descriptor: int, taken: str) -> None:
        wait(descriptor, taken)
        os.rename(part, tmp_path / "its")

    with monkeypatch.context() as patch:
        patch.setattr("os.rename", renamed_and_begun)
        with files.new_folder(tmp_path / "kept"):
            pass
    assert part.is_dir()
    (part / "its.dcm").write_bytes(b"another's")
    monkeypatch.setattr(files, "lock", lock_later)
    with pytest.raises(BlockingIOError, match="is being written by"), files.new_folder(tmp_path / "kept"):
        pass
    assert [path.name for path in (tmp_path / "its").iterdir()] == ["its.dcm"]


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
