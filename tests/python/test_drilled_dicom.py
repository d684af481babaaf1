"""Half-drilled DICOM series: a derived series with the data sets of the original's slices."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from drilled_scenes import MAP, SHAPE, cut, greys, kept
from session_scenes import refused

import burrlab.common.files as files
from burrlab import OccupancyMap, Volume, VoxelBone, read_labels, read_volume
from burrlab.bone.kept import check_drilled, load_drilled, save_drilled
from burrlab.bone.recipe import DrilledRecipe

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
        kind = {"implicit_vr": uid.is_implicit_VR, "little_endian": uid.is_little_endian}
        pydicom.dcmwrite(path, found, force_encoding=True, **kind)


@pytest.fixture
def like(tmp_path: Path) -> Volume:
    return read_volume(series(tmp_path / "ct"))


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
    """Checks the saved slices with pydicom and SimpleITK."""
    volume, bone = read_volume(saved), load_drilled(saved).bone
    assert volume.values.dtype == like.values.dtype
    for name in ("spacing", "origin", "direction"):
        np.testing.assert_array_equal(getattr(volume, name), getattr(like, name))
    assert volume.notes == ()
    whole = bone.density == bone.pristine
    seen, sources = (
        sorted(map(pydicom.dcmread, folder.glob("*.dcm")), key=lambda s: s.InstanceNumber)
        for folder in (saved, original)
    )
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
    assert len({one.SOPInstanceUID for one in (*seen, *sources)}) == 2 * SHAPE[0]
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
    original, saved = series(tmp_path / "ct [1] ä*"), tmp_path / "kept [2] ü?"  # not patterns
    again(original, CHANGES[kind])
    before = {path.name: path.read_bytes() for path in original.iterdir()}
    like = read_volume(original)
    bone, _, loaded = kept(saved, like, tick=40)
    check(original, saved, like)
    recipe = DrilledRecipe(str(saved))
    assert (recipe.bone().digest(), recipe.like().shape) == (bone.digest(), SHAPE)
    np.testing.assert_array_equal(loaded.bone.pristine, like.to_bone(MAP).pristine)
    assert {path.name: path.read_bytes() for path in original.iterdir()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == [original.name, saved.name]


def same_slices(one: Path, other: Path) -> bool:
    return all(path.read_bytes() == (other / path.name).read_bytes() for path in one.glob("*.dcm"))


def test_saved_again_and_gone_on_with(tmp_path: Path, like: Volume) -> None:
    for name in ("a", "b"):
        bone, *_ = kept(tmp_path / name, like)
    assert same_slices(tmp_path / "a", tmp_path / "b")  # the same bone makes the same series
    refused(
        (lambda: save_drilled(tmp_path / "a", bone, like, mapping=MAP), "path must be a new folder", FileExistsError),
        (lambda: save_drilled(tmp_path / "ct", bone, like, mapping=MAP), "path must be another file than the original"),
        (lambda: save_drilled(tmp_path / "d", like.to_bone(MAP), read_volume(tmp_path / "a"), mapping=MAP),
         r"like must be the original: .*a is half-drilled"),
    )  # fmt: skip
    recipe = DrilledRecipe(str(tmp_path / "a"))
    later = recipe.bone()
    cut(later, np.s_[:5], 2)
    save_drilled(tmp_path / "c", later, recipe.like(), mapping=recipe.mapping, tick=50)
    assert load_drilled(tmp_path / "c").bone.digest() == later.digest()
    names = [tmp_path / name / "slice0001.dcm" for name in ("a", "b", "c")]
    assert len({pydicom.dcmread(name).SeriesInstanceUID for name in names}) == 2
    one = tmp_path / "a" / "slice0003.dcm"
    one.write_bytes(one.read_bytes()[:-2] + b"\1\1")
    refused((lambda: load_drilled(tmp_path / "a"), r"bone\.h5 belongs to another content of it"))


def test_a_save_that_fails_leaves_nothing(
    tmp_path: Path, like: Volume, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = Mock(side_effect=OSError(28, "No space left on device"))
    for place in ("burrlab.bone.kept.write_synced", "burrlab.bone.kept.save_bone", "os.rename"):
        with monkeypatch.context() as patch:
            patch.setattr(place, full)
            refused(
                (lambda: save_drilled(tmp_path / "kept", like.to_bone(MAP), like, mapping=MAP), "No space left", OSError),
            )  # fmt: skip
        assert [path.name for path in tmp_path.iterdir()] == ["ct"]


def test_two_that_save_to_one_folder_do_not_mix(tmp_path: Path, like: Volume) -> None:
    late = files.new_folder(tmp_path / "kept")
    (late.__enter__() / "its.dcm").write_bytes(b"another's")
    kept(tmp_path / "kept", like)
    refused((lambda: late.__exit__(None, None, None), "folder must be new", FileExistsError))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ct", "kept"]
    assert not (tmp_path / "kept" / "its.dcm").exists()


def test_one_series_of_a_folder_and_files_in_any_order(tmp_path: Path) -> None:
    folder = series(tmp_path / "ct")
    write_series(folder, greys("i2")[:4], series="9.8", names=[f"o{k}" for k in range(4)])
    kept(tmp_path / "kept", read_volume(folder, series="1.2.3.4"))
    files = sorted(folder.glob("slice*"), reverse=True)
    like = read_volume(files)
    assert like.files == tuple(str(path) for path in files[::-1])
    kept(tmp_path / "other", like)
    assert same_slices(tmp_path / "kept", tmp_path / "other")


@pytest.mark.parametrize(("sign", "low", "held"), [(0, -1000, "0 to 4095"), (1, -2100, "-2048 to 2047")])
def test_fewer_bits_than_there_are(tmp_path: Path, sign: int, low: float, held: str) -> None:
    """12 bits of 16, signed or unsigned, with another scale in each slice."""
    bits = {"BitsStored": 12, "HighBit": 11, "PixelRepresentation": sign, "RescaleIntercept": "0"}
    folder = series(tmp_path / "ct", (greys("i4").clip(0, 2000) - 700 * sign).astype("i2"), **bits)
    for k, path in enumerate(sorted(folder.iterdir())):
        found = pydicom.dcmread(path)
        found.RescaleSlope = str(1 + k / 4)
        if sign == 0:  # an overlay in the unused bits, as in old files
            found.PixelData = (np.frombuffer(found.PixelData, "<u2") | 0x5000).tobytes()
        found.save_as(path)
    like = read_volume(folder)
    kept(tmp_path / "kept", like)
    refused(
        (lambda: check_drilled(tmp_path / "no", like, OccupancyMap.two_point(low, 1200)),
         rf"slice000\.dcm can hold, .*: it holds u?int16, {held}, got"),
    )  # fmt: skip


def test_crops_get_new_headers(tmp_path: Path, like: Volume) -> None:
    crop = like.crop_voxels((1, 2, 3), (13, 15, 17))
    _, again, _ = kept(tmp_path / "crop", crop)
    np.testing.assert_allclose(again.corners(), crop.corners(), atol=1e-9)
    refused(
        (lambda: check_drilled(tmp_path / "fine", replace(crop, values=crop.values.astype(np.float32) + 0.5), MAP),
         "values must be one of uint8, int16, uint16 to be written as DICOM, got float32; the ending of another format"),
    )  # fmt: skip


def test_labels_stay_labels(tmp_path: Path) -> None:
    numbers = (np.arange(np.prod(SHAPE)).reshape(SHAPE) % 3).astype("i2")
    labels = read_labels(series(tmp_path / "segments", numbers, RescaleIntercept="0"))
    solid = VoxelBone(
        np.where(labels.labels > 0, 255, 0).astype(np.uint8),
        spacing=labels.spacing,
        origin=labels.bone_point(labels.origin),
    )
    cut(solid, np.s_[4:8], 3)
    save_drilled(tmp_path / "cut", solid, labels)
    expected = labels.labels.copy()
    expected[4:8] = 0
    loaded = load_drilled(tmp_path / "cut")
    assert loaded.bone.digest() == solid.digest()
    for found in (read_labels(tmp_path / "cut"), loaded.volume()):
        np.testing.assert_array_equal(found.labels, expected)


def test_other_voxels_are_rounded_to_whole_grey_values(tmp_path: Path, like: Volume) -> None:
    """Clinical slices are burred on finer voxels, by `--voxel` with `--save FOLDER`."""
    _, again, loaded = kept(tmp_path / "fine", like.resample(0.2))
    assert again.values.dtype == np.int16
    save_drilled(tmp_path / "later", loaded.bone, loaded.volume(), mapping=loaded.mapping)


def test_what_cannot_be_taken_apart(tmp_path: Path, like: Volume) -> None:
    one = tmp_path / "ct" / "slice004.dcm"
    content = one.read_bytes()

    def neither(like: Volume, match: str, kind: type[Exception] = ValueError, path: str = "kept") -> None:
        refused(
            (lambda: check_drilled(tmp_path / path, like, MAP), match),
            (lambda: save_drilled(tmp_path / path, like.to_bone(MAP), like, mapping=MAP), match),
            error=kind,
        )
        assert sorted(path.name for path in tmp_path.iterdir()) == ["ct"]

    found = pydicom.dcmread(one)
    del found.HighBit, found.BitsStored
    found.save_as(one)
    neither(read_volume(tmp_path / "ct"), "16 bits allocated, -1 stored")
    one.unlink()
    neither(like, r"slice004\.dcm: no such file", FileNotFoundError)
    one.write_bytes(content)
    neither(
        like,
        r"path must be a new folder for a DICOM series, and not one file, got .*kept\.dcm",
        path="kept.dcm",
    )


def test_a_slice_without_file_meta_information_gets_it(tmp_path: Path, like: Volume) -> None:
    one = tmp_path / "ct" / "slice004.dcm"
    one.write_bytes(one.read_bytes()[pydicom.dcmread(one).file_meta.FileMetaInformationGroupLength + 144 :])
    kept(tmp_path / "kept", read_volume(tmp_path / "ct"))
    found = pydicom.dcmread(tmp_path / "kept" / "slice0005.dcm")
    assert found.PatientName == "Phantom^Sept"
    assert found.file_meta.MediaStorageSOPInstanceUID == found.SOPInstanceUID


def test_letters_where_none_may_be_and_what_no_longer_holds(tmp_path: Path) -> None:
    """An image type beyond ASCII keeps its bytes; least and largest pixel and an icon are not copied."""
    icon = pydicom.Dataset()
    icon.Rows = icon.Columns = 1
    folder = series(tmp_path / "ct", SmallestPixelValueInSeries=24, LargestPixelValueInSeries=2524)
    again(folder, lambda found: setattr(found, "IconImageSequence", [icon]))
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes().replace(b"PRIMARY\\AXIAL", b"PRIMARY\\\xc4XIAL"))
    kept(tmp_path / "kept", read_volume(folder))
    for path in (tmp_path / "kept").glob("*.dcm"):
        assert b"DERIVED\\SECONDARY\\\xc4XIAL" in path.read_bytes()
        found = pydicom.dcmread(path)
        for name in ("SmallestPixelValueInSeries", "LargestPixelValueInSeries", "IconImageSequence"):
            assert name not in found
