"""A session on a labelled bone: saved in each format, read by other programs, and continued."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dicom_series import write_series
from label_scenes import MAP, TABLE, coloured, greys, label_file, labels, volume
from PIL import Image
from session_scenes import ended, refused, session_of
from test_segments import FIELDS, seg_nrrd
from test_volume_formats import independently

from burrlab import (
    Burr,
    LabelVolume,
    ScriptedDevice,
    VoxelBone,
    materials,
    save_bone,
)
from burrlab.bone.formats import header_reader, read_labels, read_volume, write_volume
from burrlab.bone.kept import DrilledVolume, load_drilled, save_drilled
from burrlab.bone.recipe import DrilledRecipe, LabelledRecipe, VolumeRecipe, make_bone
from burrlab.bone.tissues import VOLUMETRIC_DRILLING, default_tissues

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pytest.importorskip("yaml", reason="extra `medical` is not installed")
pydicom = pytest.importorskip("pydicom", reason="an independent reader, extra `medical`")


def recipe(kind: str, folder: Path) -> tuple[LabelledRecipe | VolumeRecipe, str]:
    """Recipe of the bone, and the name under which it is saved."""
    if kind == "coloured slices":
        table = default_tissues({0: "air", 1: "bone", 10: "facial nerve"})
        return LabelledRecipe(str(coloured(folder / "slices")), table), "kept"
    if kind == "segmentation":
        return LabelledRecipe(str(seg_nrrd(folder / "a.seg.nrrd", labels(), FIELDS)), TABLE), "kept.seg.nrrd"
    if kind == "labels.nii.gz":
        return LabelledRecipe(str(label_file(folder / "a.nii.gz", volume())), TABLE), "kept.nii.gz"
    if kind.startswith("DICOM"):
        write_series(folder / "series", greys(), step=0.25, spacing=(0.25, 0.25))
        grey = read_volume(folder / "series")
        name = "kept.nrrd" if kind == "DICOM as NRRD" else "kept"
        source = folder / "series"
    else:
        source, name, grey = folder / f"ct{kind}", f"kept{kind}", volume()
        write_volume(source, grey)
    return LabelledRecipe(
        str(label_file(folder / "labels.nrrd", grey)), TABLE, VolumeRecipe(str(source), MAP)
    ), name


def device(bone: VoxelBone, since: int, ticks: int) -> ScriptedDevice:
    """Part of one path through bone and nerve, for one session; a tick takes 1 ms."""
    at = np.arange(since, since + ticks + 9) / 1e3  # longer than the session
    start = np.array(bone.origin) + np.array(bone.spacing) * (10, 8, 24)
    return ScriptedDevice(at - at[0], start + np.outer(at, (6.0, 10.0, -4.0)))


def drill(bone: VoxelBone, tick: int, ticks: int) -> tuple[VoxelBone, int]:
    tool, way = (Burr(1.7), materials["bone"]), device(bone, tick, ticks)
    return ended(
        session_of(bone, tool, way, tick=tick, seed=7, duration=ticks / 1e3, wall_clock=False)
    ).snapshot()


KINDS = (
    ".nrrd",
    ".nii.gz",
    ".mha",
    "DICOM",
    "DICOM as NRRD",
    "coloured slices",
    "segmentation",
    "labels.nii.gz",
)


@pytest.mark.parametrize("kind", KINDS)
def test_kept_seen_and_gone_on_with(kind: str, tmp_path: Path) -> None:
    made, name = recipe(kind, tmp_path)
    bone, tick = drill(made.bone(), 0, 500)
    assert tick == 500
    assert min(bone.removed_of(tissue) for tissue in ("bone", "facial nerve")) > 0
    path, like, first = tmp_path / name, made.like(), made.bone()
    original = like.labels if isinstance(like, LabelVolume) else like.values

    def seen(bone: VoxelBone, tick: int) -> DrilledVolume:
        """Checks the saved volume with independent readers, and its exact state."""
        values, vectors, origin = independent(path)
        whole = bone.density == bone.pristine
        np.testing.assert_array_equal(values[whole], original[whole])
        gone = (bone.density == 0) & ~whole
        assert np.count_nonzero(gone) > 10
        assert (values[gone] == 0).all()
        if vectors is not None:  # the original's axes and origin
            np.testing.assert_allclose(vectors, like.direction * like.spacing, atol=1e-6)
            np.testing.assert_allclose(origin, like.origin, atol=1e-5)
        kept = load_drilled(path)
        assert (kept.bone.digest(), kept.tick, kept.mapping) == (bone.digest(), tick, made.mapping)
        np.testing.assert_array_equal(kept.bone.pristine, first.pristine)
        assert kept.bone.tissues == first.tissues
        np.testing.assert_array_equal(kept.bone.tissue_numbers, first.tissue_numbers)
        return kept

    save_drilled(path, bone, like, mapping=made.mapping, tick=tick)
    kept = seen(bone, 500)
    later, tick = drill(kept.bone, kept.tick, 400)  # a second session
    assert later.digest() == drill(made.bone(), 0, 900)[0].digest()  # the same as in one session
    path = tmp_path / "second" if path.is_dir() else path
    save_drilled(path, later, kept.volume(), mapping=kept.mapping, tick=tick)
    seen(later, 900)
    if kind == "segmentation":
        assert header_reader(name)(str(path))[0].fields == FIELDS


def independent(path: Path) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Values (z, y, x), voxel vectors along x, y, z, and origin, in LPS, by independent readers."""
    if any(path.glob("*.dcm")):
        slices = sorted(
            map(pydicom.dcmread, path.glob("*.dcm")), key=lambda s: float(s.ImagePositionPatient[2])
        )
        places = np.array([s.ImagePositionPatient for s in slices], float)
        turn = np.reshape(slices[0].ImageOrientationPatient, (2, 3)).astype(float).T
        sides = turn * np.array(slices[0].PixelSpacing, float)[::-1]
        values = np.stack([s.pixel_array * s.RescaleSlope + s.RescaleIntercept for s in slices])
        return values, np.column_stack([sides, places[1] - places[0]]), places[0]
    if path.is_dir():
        colours = np.stack([np.asarray(Image.open(file)) for file in sorted(path.glob("*.png"))]).astype(int)
        code = np.zeros(colours.shape[:3], int)
        for label, name in ((1, "Bone"), (10, "Facial_Nerve")):
            code[(colours == (*VOLUMETRIC_DRILLING[name], 255)).all(axis=-1)] = label
        assert ((code > 0) == (colours[..., 3] > 0)).all()
        return code.swapaxes(1, 2), None, None  # rows lie along x
    values, spacing, origin, turn = independently(path)
    return values, turn * spacing, origin


def test_layers_of_a_segmentation_become_labels(tmp_path: Path) -> None:
    two = np.stack([labels() == 1, labels() == 4], axis=-1)
    layered = read_labels(
        seg_nrrd(tmp_path / "b.seg.nrrd", two, {**FIELDS, "Segment1_LabelValue": "1", "Segment1_Layer": "1"})
    )
    bone, _ = drill(
        LabelledRecipe(layered.path, default_tissues({1: "bone", 2: "facial nerve"})).bone(), 0, 300
    )
    save_drilled(tmp_path / "c.seg.nrrd", bone, layered)
    expected = np.where(2 * bone.density.astype(int) < bone.pristine, 0, layered.labels)
    np.testing.assert_array_equal(read_labels(tmp_path / "c.seg.nrrd").labels, expected)
    assert load_drilled(tmp_path / "c.seg.nrrd").bone.digest() == bone.digest()


def test_a_recipe_of_a_kept_bone(tmp_path: Path) -> None:
    made, name = recipe(".nrrd", tmp_path)
    bone, tick = drill(made.bone(), 0, 300)
    save_drilled(tmp_path / name, bone, made.like(), mapping=MAP, tick=tick)
    kept = DrilledRecipe(str(tmp_path / name))
    assert (kept.tick, kept.mapping, kept.bone().digest()) == (300, MAP, bone.digest())
    plain: dict[str, Any] = kept.plain()
    assert plain == {"kind": "drilled volume", "path": str(tmp_path / name), "digest": bone.digest()}
    assert make_bone(plain).digest() == bone.digest()
    where = volume().patient_point(np.array(bone.origin) + np.array(bone.spacing) * (5, 4, 27))
    way = {"entry": where, "axis": volume().patient_point((0, 0, -1.0))}
    np.testing.assert_allclose(kept.specimen(**way).surface, made.specimen(**way).surface)
    save_bone(tmp_path / "alone.h5", bone, tick)
    alone = DrilledRecipe(str(tmp_path / "alone.h5"))
    assert (alone.tick, alone.mapping, alone.bone().digest()) == (300, None, bone.digest())
    np.testing.assert_allclose(
        alone.specimen(entry=np.array(bone.origin) + (1, 1, 6.8), axis=(0, 0, -1)).axis, (0, 0, -1)
    )
    later, tick = drill(bone, tick, 100)
    save_drilled(tmp_path / name, later, made.like(), mapping=MAP, tick=tick)
    refused(
        (
            lambda: kept.check_burr(Burr(0.5)),
            r"radius of the burr must be at least 4 voxels of 0.25 mm, got 0.5",
        ),
        (alone.like, r"alone\.h5 is a bone alone, without a volume: save it as .h5 again"),
        (lambda: make_bone(plain), r"kept.nrrd: the bone has digest \w+ by now, and \w+ is asked for"),
    )
