"""How a bone with tissues is made of files, kept as JSON, and made again elsewhere."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from label_scenes import MAP, SPACING, TABLE, anatomy_bone, labels, volume, write_files

from burrlab import materials
from burrlab._core import Burr, ScriptedDevice
from burrlab.anatomy.watch import Watch
from burrlab.bone.formats import read_labels, read_volume
from burrlab.bone.kept import save_drilled
from burrlab.bone.recipe import LabelledRecipe, VolumeRecipe
from burrlab.bone.tissues import default_tissues
from burrlab.session.network import make_bone
from burrlab.session.session import Session

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pytest.importorskip("yaml", reason="extra `medical` is not installed")

VOLUME = volume()


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_files(tmp_path)
    return tmp_path


def test_a_recipe_comes_back_and_makes_the_same_bone(files: Path) -> None:
    low = VOLUME.patient_point((-1, -1, -1.0))
    grey = VolumeRecipe("ct.nrrd", MAP)
    box = (tuple(VOLUME.origin + low), tuple(VOLUME.origin + VOLUME.patient_point((5, 5, 6.0))))
    of_grey = LabelledRecipe("labels.nii.gz", TABLE, grey, {"facial nerve": 0.5})
    cropped = LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP, crop=box))
    finer = LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP, voxel=0.2))
    alone = LabelledRecipe("a.seg.nrrd", TABLE, voxel=(0.2, 0.2, 0.2), smooth=0.5)
    colours = default_tissues({1: "bone", 10: "facial nerve"})
    slices = LabelledRecipe("slices", colours, spacing=SPACING, unknown="nearest", transpose=True)
    described = LabelledRecipe("v.yaml", colours, unit=500.0)
    for recipe in (of_grey, cropped, finer, alone, slices, described):
        plain = json.loads(json.dumps(recipe.plain()))
        assert LabelledRecipe.of(plain) == recipe
        assert make_bone(plain).digest() == recipe.bone().digest()
        assert recipe.bone().removed == 0
        like = recipe.like()
        assert like.shape == recipe.bone().shape
        np.testing.assert_allclose(like.bone_point(like.origin), recipe.bone().origin, atol=1e-9)
    whole = anatomy_bone(read_volume("ct.nrrd"), read_labels("labels.nii.gz"), TABLE, mapping=MAP)
    np.testing.assert_array_equal(
        of_grey.bone().density, np.maximum(whole.density, np.where(labels() == 4, 128, 0))
    )
    part = cropped.bone()
    assert np.prod(part.shape) < np.prod(whole.shape)
    start = np.rint((np.array(part.origin) - whole.origin) / SPACING).astype(int)
    cut = tuple(slice(a, a + n) for a, n in zip(start[::-1], part.shape, strict=True))
    np.testing.assert_array_equal(part.density, whole.density[cut])
    np.testing.assert_array_equal(part.tissue_numbers, whole.tissue_numbers[cut])
    assert described.bone().spacing == (0.125, 0.125, 0.125)
    np.testing.assert_array_equal(slices.bone().tissue_numbers > 0, labels() != 1)


@pytest.mark.parametrize(
    ("source", "voxel", "bone"),
    [("a.seg.nrrd", None, "Bone"), ("a.seg.nrrd", 0.2, "Bone"), ("labels.nii.gz", None, "bone"), ("v.yaml", None, "bone")],
)  # fmt: skip
def test_a_half_drilled_segmentation_keeps_names_and_colours(
    files: Path, source: str, voxel: float | None, bone: str
) -> None:
    recipe = LabelledRecipe(source, TABLE, voxel=voxel and (voxel,) * 3)
    save_drilled("kept.seg.nrrd", recipe.bone(), recipe.like())
    kept, nerve = read_labels("kept.seg.nrrd"), "Facial_Nerve" if bone == "Bone" else "facial nerve"
    assert kept.names == {1: bone, 4: nerve}
    assert kept.colours == (recipe.like().colours or {1: (255, 249, 219), 4: (244, 214, 49)})
    if bone == "Bone" and voxel is None:
        np.testing.assert_array_equal(kept.labels, recipe.like().labels)


def test_a_session_touches_what_is_there(tmp_path: Path) -> None:
    from test_stack import save, wrapped

    planes = np.zeros((24, 20, 20, 4), np.uint8)
    planes[:18] = wrapped("Bone")
    planes[14:16, 9:11] = wrapped("Bone", "Chorda_Tympani")
    planes[:3] = wrapped("Sinus_+_Dura")
    folder = save(tmp_path / "s", planes, "plane{:03d}.png")
    table = default_tissues({1: "bone", 11: "chorda tympani", 13: "sinus and dura"})
    plain = LabelledRecipe(str(folder), table, spacing=SPACING, unknown="nearest", transpose=False).plain()
    touched = []
    for kept in (plain, {key: value for key, value in plain.items() if key != "ranking"}):
        recipe = LabelledRecipe.of(json.loads(json.dumps(kept)))
        assert recipe.plain() == kept
        device = ScriptedDevice([0, 0.5], [(2.5, 2.4, 6), (2.5, 2.4, 4.6)])
        bone = recipe.bone()
        watch = Watch(bone)
        with Session(
            bone, (Burr(1.0), materials["bone"]), device, seed=1, duration=0.5, wall_clock=False, watch=watch
        ) as session:
            session.wait()
        touched.append({event.structure for event in session.anatomy().events if event.kind == "touch"})
    assert touched == [
        {"chorda tympani"},
        {"sinus and dura"},
    ]  # the dura lies 3 mm below, and was seen in the sums


def of_grey(**options: object) -> LabelledRecipe:
    return LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: of_grey(voxel=(0.1, 0.1, 0.1)), "crop and voxel must be those of the grey volume"),
        (lambda: of_grey(smooth=0.3), "smooth goes with labels alone"),
        (lambda: LabelledRecipe("x.nrrd", TABLE, onto=True), "onto goes with a grey volume"),
        (lambda: LabelledRecipe("a.seg.nrrd", TABLE).check_burr(Burr(1)), r"radius of the burr must be at least 4 voxels of 0\.4 mm, got 1 mm"),
        (lambda: of_grey().check_burr(Burr(0.9)), r"radius of the burr must be at least 4 voxels of 0\.25 mm"),
        (lambda: make_bone({"kind": "labelled volume", "labels": "x"}), "recipe must be that of block_recipe"),
        (lambda: make_bone({"kind": "labelled volume", "labels": "x", "tissues": "{}"}), "recipe must be that of block_recipe"),
        (lambda: make_bone({"kind": "labelled volume", "labels": 3, "tissues": "[]"}), "recipe must be that of block_recipe"),
        (lambda: make_bone({"kind": "drilled volume", "path": "x.nrrd"}), "recipe must be that of block_recipe"),
    ],
)  # fmt: skip
def test_wrong_recipes(files: Path, make: Callable[[], object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make()


def test_a_recipe_of_files_that_lie_elsewhere(files: Path) -> None:
    recipe = LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP))
    plain, digest = recipe.plain(), recipe.bone().digest()
    (files / "there").mkdir()
    (files / "ct.nrrd").rename(files / "there" / "other.nrrd")
    assert make_bone(plain, volume="there/other.nrrd").digest() == digest
    (files / "labels.nii.gz").rename(files / "there" / "labels.nii.gz")
    assert make_bone(plain, volume="there/other.nrrd").digest() == digest
    with pytest.raises(FileNotFoundError, match=r"labels\.nii\.gz: no such file"):
        make_bone(plain)
