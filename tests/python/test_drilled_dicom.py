"""Half-drilled DICOM series: a derived series under the headers of the original's slices."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drilled_scenes import MAP, SHAPE, drilled, greys

import burrlab.common.files as files
from burrlab.bone.formats import read_volume
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
    original = series(tmp_path / "ct")
    again(original, CHANGES[kind])
    before = {path.name: path.read_bytes() for path in original.iterdir()}
    like = read_volume(original)
    bone = drilled(like)
    assert check_drilled(tmp_path / "kept", like, MAP) is None
    save_drilled(tmp_path / "kept", bone, like, mapping=MAP, tick=40)
    check(original, tmp_path / "kept", like)
    loaded = load_drilled(tmp_path / "kept")
    assert (loaded.bone.digest(), loaded.tick, loaded.mapping) == (bone.digest(), 40, MAP)
    np.testing.assert_array_equal(loaded.bone.density, bone.density)
    np.testing.assert_array_equal(loaded.bone.pristine, like.to_bone(MAP).pristine)
    assert {path.name: path.read_bytes() for path in original.iterdir()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ct", "kept"]


def test_names_that_look_like_patterns(tmp_path: Path) -> None:
    like = read_volume(series(tmp_path / "ct [1] ä*"))
    bone = drilled(like)
    save_drilled(tmp_path / "kept [2] ü?", bone, like, mapping=MAP)
    again = DrilledRecipe(str(tmp_path / "kept [2] ü?"))
    assert again.bone().digest() == bone.digest()
    assert again.like().shape == SHAPE


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
