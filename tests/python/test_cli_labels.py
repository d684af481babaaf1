"""Labels, tissues and kept bones from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_drilled_session import MAP, SPACING, TABLE, coloured, label_file, labels, volume
from test_segments import FIELDS, seg_nrrd

from burrlab import Burr, VoxelBone, load_bone, load_trace, replay
from burrlab.anatomy import LabelledRecipe, anatomy_bone, default_tissues, read_tissues, write_tissues
from burrlab.cli import main
from burrlab.session.network import follow, make_bone
from burrlab.volume import (
    DrilledRecipe,
    LabelVolume,
    VolumeRecipe,
    load_drilled,
    read_labels,
    read_volume,
    write_volume,
)

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pytest.importorskip("yaml", reason="extra `medical` is not installed")

VOLUME = volume()
ENTRY = ",".join(
    f"{x:.3f}"
    for x in VOLUME.patient_point(
        np.array(VOLUME.bone_point(VOLUME.origin)) + np.array(SPACING) * (16, 16, 27)
    )
)
AXIS = ",".join(f"{x:g}" for x in VOLUME.patient_point((0, 0, -1.0)))
HAND = ["session", "--device", "hand", "--radius", "1", "--duration", "0.2", "--seed", "3", "--no-realtime"]
THERE = ["--entry", ENTRY, "--axis", AXIS]
GREY = ["--volume", "ct.nrrd", "--map", "0:1000"]


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_volume("ct.nrrd", VOLUME)
    label_file(Path("labels.nii.gz"), VOLUME)
    seg_nrrd(Path("a.seg.nrrd"), labels(), FIELDS)
    coloured(tmp_path / "slices")
    write_tissues("t.csv", TABLE)
    return tmp_path


def test_a_recipe_comes_back_and_makes_the_same_bone(files: Path) -> None:
    low = VOLUME.patient_point((-1, -1, -1.0))
    grey = VolumeRecipe("ct.nrrd", MAP)
    box = (tuple(VOLUME.origin + low), tuple(VOLUME.origin + VOLUME.patient_point((5, 5, 6.0))))
    of_grey = LabelledRecipe("labels.nii.gz", TABLE, grey, {"facial nerve": 0.5})
    cropped = LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP, crop=box))
    finer = LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP, voxel=0.2))
    alone = LabelledRecipe("a.seg.nrrd", TABLE, voxel=(0.2, 0.2, 0.2))
    colours = default_tissues({1: "bone", 10: "facial nerve"})
    slices = LabelledRecipe("slices", colours, spacing=SPACING, unknown="nearest")
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


def test_wrong_recipes(files: Path) -> None:
    with pytest.raises(ValueError, match="crop and voxel must be those of the grey volume"):
        LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP), voxel=(0.1, 0.1, 0.1))
    with pytest.raises(
        ValueError, match=r"radius of the burr must be at least 4 voxels of 0\.4 mm, got 1 mm"
    ):
        LabelledRecipe("a.seg.nrrd", TABLE).check_burr(Burr(1))
    with pytest.raises(ValueError, match=r"radius of the burr must be at least 4 voxels of 0\.25 mm"):
        LabelledRecipe("labels.nii.gz", TABLE, VolumeRecipe("ct.nrrd", MAP)).check_burr(Burr(0.9))
    for plain in ({"labels": "x"}, {"labels": "x", "tissues": "{}"}, {"labels": 3, "tissues": "[]"}):
        with pytest.raises(ValueError, match="recipe must be that of block_recipe"):
            make_bone({"kind": "labelled volume", **plain})


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


def test_a_session_and_the_next_day(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = [*HAND, *GREY, "--labels", "labels.nii.gz", "--tissues", "t.csv", *THERE]
    assert main([*first, "--save", "kept.nrrd", "--record", "one.h5", "--json", "one.json"]) == 0
    said = capsys.readouterr().err
    assert "bone saved as kept.nrrd" in said
    kept = load_drilled("kept.nrrd")
    assert (kept.tick, kept.mapping) == (200, MAP)
    assert kept.bone.removed_of("facial nerve") > 0
    assert replay(load_trace("one.h5")).equal
    source = json.loads(Path("one.json").read_text())["provenance"]["source"]
    assert source["kind"] == "labelled volume"
    second = [*HAND, "--bone", "kept.nrrd", *THERE, "--record", "two.h5", "--json", "two.json"]
    assert main([*second, "--save", "kept.nrrd"]) == 0
    assert "kept.nrrd has been burred for 200 ticks before" in capsys.readouterr().err
    later = load_drilled("kept.nrrd")
    assert later.tick == 400
    assert later.bone.removed > kept.bone.removed
    np.testing.assert_array_equal(later.bone.pristine, kept.bone.pristine)
    trace = load_trace("two.h5")
    assert (trace.first_tick, trace.bone().digest()) == (200, kept.bone.digest())
    assert replay(trace).equal
    assert json.loads(Path("two.json").read_text())["provenance"]["source"]["digest"] == kept.bone.digest()
    assert len(list(files.glob("kept.nrrd*"))) == 2


def test_a_block_and_slices_are_kept(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*HAND, "--radius", "3", "--voxel", "0.4", "--save", "block.h5"]) == 0
    assert load_bone("block.h5")[1] == 200
    on = ["--bone", "block.h5", "--entry", "0,0,1", "--axis", "0,0,-1", "--radius", "3"]
    assert main([*HAND, *on, "--save", "block.h5"]) == 0
    assert load_bone("block.h5")[1] == 400
    down = ["--entry", "4,4,8", "--axis", "0,0,-1"]
    assert main([*HAND, "--labels", "v.yaml", *down, "--save", "kept"]) == 0
    assert main([*HAND, "--bone", "kept", *down, "--save", "later"]) == 0
    assert (load_drilled("later").tick, len(list(Path("later").glob("*.png")))) == (400, 28)
    assert main([*HAND, "--labels", "a.seg.nrrd", "--radius", "2", "--voxel", "0.2", "--entry", "8,10,18",
                 "--axis", "0,0,-1", "--save", "finer.seg.nrrd"]) == 0  # fmt: skip
    assert load_drilled("finer.seg.nrrd").bone.spacing == (0.2, 0.2, 0.2)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--tissues", "t.csv"], "--tissues goes with --labels"),
        (["--unit", "1"], "--unit goes with --labels"),
        (["--fill", "bone:1"], "--fill goes with --labels"),
        (["--unknown", "nearest"], "--unknown goes with --labels"),
        (["--onto"], "--onto goes with --labels"),
        (["--labels", "a.seg.nrrd", "--onto"], "--onto goes with --volume"),
        (["--bone", "ct.nrrd", "--onto", *THERE], "--onto goes without --bone, which has its own"),
        (["--labels", "a.seg.nrrd", "--map", "0:1"], "--map goes with --volume"),
        (["--labels", "a.seg.nrrd", "--series", "1"], "--series goes with --volume"),
        (["--labels", "a.seg.nrrd"], "--device hand with --labels needs --entry"),
        (["--labels", "labels.nii.gz", *THERE], "labels.nii.gz: the labels 1 (19008 voxels), 4 (6336 voxels) have no names in the file"),
        (["--labels", "none.nrrd", *THERE], "none.nrrd: no such file"),
        (["--labels", "slices", *THERE], "slices: PNG slices do not say how large they are"),
        (["--labels", "slices", "--unit", "1", "--spacing", "0.2", *THERE], "unit goes with a YAML file: spacing is in mm"),
        ([*GREY, "--labels", "a.seg.nrrd", *THERE], "a.seg.nrrd must have the same geometry: spacing (0.25, 0.25, 0.25) against (0.2, 0.3"),
        ([*GREY, "--labels", "labels.nii.gz", "--tissues", "t.csv", "--fill", "spleen:1", *THERE], "fill must be of tissues of the table (bone, facial nerve, unlabelled), got 'spleen'"),
        ([*GREY, "--labels", "labels.nii.gz", "--tissues", "small.csv", *THERE], "labels that are not in the table: 4 (6336 voxels); the table has 1 bone"),
        (["--fill", "bone:2", "--labels", "x"], "must be TISSUE:OCCUPANCY, 0 to 1, got 'bone:2'"),
        (["--fill", "bone", "--labels", "x"], "must be TISSUE:OCCUPANCY, 0 to 1, got 'bone'"),
        (["--unknown", "any", "--labels", "x"], "must be nearest or a label, got 'any'"),
        (["--bone", "ct.nrrd", *THERE], "must lie beside it, and there is none: was the volume moved"),
        (["--bone", "none.nrrd", *THERE], "none.nrrd: no such file or folder"),
        (["--bone", "ct.nrrd", "--volume", "ct.nrrd", *THERE], "--volume goes without --bone, which has its own"),
        (["--bone", "ct.nrrd", "--fill", "bone:1", *THERE], "--fill goes without --bone, which has its own"),
        (["--bone", "ct.nrrd"], "--device hand with --bone needs --entry"),
        (["--axis", "0,0,1"], "--axis goes with --volume, --labels or --bone"),
        (["--save", "x.nrrd"], "--save: a block has no volume: the file must end in .h5, got x.nrrd"),
        (["--save", "slices"], "--save: a block has no volume"),
        ([*GREY, *THERE, "--save", "x.txt"], "--save: path must end in .nrrd, .nii, .nii.gz or .mha, got x.txt"),
        ([*GREY, *THERE, "--save", "ct.nrrd"], "--save: path must be another file than the original"),
        ([*GREY, *THERE, "--save", "labels.nii.gz"], "--save: path must be a new file or one of save_drilled, labels.nii.gz is neither"),
        (["--labels", "v.yaml", "--entry", "4,4,8", "--axis", "0,0,-1", "--save", "slices"], "--save: path must be a new folder, slices is there"),
        ([*GREY, *THERE, "--save", "ct.h5"], "path must be a new file or a burrlab bone, ct.h5 is neither"),
    ],
)  # fmt: skip
def test_wrong_input(files: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("small.csv").write_text("label,name\n1,bone\n")
    Path("ct.h5").write_text("a text")
    before = {path: path.stat().st_mtime_ns for path in files.rglob("*")}
    assert main_status([*HAND, *words]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert {path: path.stat().st_mtime_ns for path in files.rglob("*")} == before


def main_status(words: list[str]) -> int:
    """Of argparse too."""
    try:
        return main(words)
    except SystemExit as ended:
        return int(ended.code or 0)


def test_a_descent_into_labels(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "descend",
        "--force",
        "0.3",
        "--ideal",
        "--radius",
        "1",
        "--max-duration",
        "0.3",
        "--seed",
        "1",
        *THERE,
    ]
    both = [*GREY, "--labels", "labels.nii.gz", "--tissues", "t.csv"]
    assert main([*words, *both, "--json", "-"]) == 0
    made = json.loads(capsys.readouterr().out)["provenance"]["volume"]
    assert made["recipe"]["kind"] == "labelled volume"
    onto = ["--labels", "a.seg.nrrd", "--onto"]  # elsewhere: no label meets the volume
    assert main([*words, *GREY, *onto, "--json", "-"]) == 0
    assert "labels are the nearest of" in capsys.readouterr().err
    assert main(["descend", "--force", "1", "--labels", "a.seg.nrrd"]) == 2
    assert "--labels needs --entry" in capsys.readouterr().err


def test_what_the_labels_of_a_file_are(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def said(*words: str, status: int = 0) -> str:
        assert main(["tissues", *words]) == status
        out = capsys.readouterr()
        return out.out if status == 0 else out.err

    assert "facial nerve" in said()
    assert "facial, cn vii" in said()
    assert [line.split()[:3] for line in said("a.seg.nrrd").splitlines()[1:]] == [
        ["0", "6912", "165.89"], ["1", "19008", "456.19"], ["4", "6336", "152.06"],
    ]  # fmt: skip
    rows = json.loads(said("a.seg.nrrd", "--json", "-"))["labels"]
    assert rows[2] == {"label": 4, "voxels": 6336, "volume_mm3": pytest.approx(152.064), "name": "Facial_Nerve", "tissue": "facial nerve"}  # fmt: skip
    text = said("labels.nii.gz")
    assert "2 of 3 labels are no known tissue: they need a table (--template, --tissues)" in text
    assert "facial nerve" in said("labels.nii.gz", "--tissues", "t.csv")
    assert "written new.csv" in said("labels.nii.gz", "--template", "new.csv")
    assert [t.name for t in read_tissues("new.csv")] == ["unlabelled", "structure 1", "structure 4"]
    assert "--template: new.csv is there already" in said("labels.nii.gz", "--template", "new.csv", status=2)
    said("a.seg.nrrd", "--template", "seg.csv")
    table = read_tissues("seg.csv")
    assert [(t.label, t.name, t.critical, t.assumed) for t in table] == [
        (0, "unlabelled", False, True), (1, "Bone", False, False), (4, "Facial_Nerve", True, True),
    ]  # fmt: skip
    assert table[2].colour == (51, 102, 153)
    assert "Facial_Nerve" in said("seg.csv")
    assert "ct.nrrd: labels must be zero or positive, got -1000: is this a grey volume?" in said(
        "ct.nrrd", status=2
    )
    assert "--template goes with a file of labels" in said("--template", "x.csv", status=2)
    many = LabelVolume(np.arange(125).reshape(5, 5, 5), 0.2, (0, 0, 0), np.eye(3), "m")
    write_volume("many.nrrd", many)
    assert "many.nrrd: a bone has at most 64 tissues, and there are 125 labels" in said(
        "many.nrrd", "--template", "m.csv", status=2
    )
    assert not Path("m.csv").exists()


def test_colours_in_no_table_are_told(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from PIL import Image

    with Image.open("slices/plane00003.png") as image:
        pixels = np.asarray(image).copy()
    pixels[4, 5:8, :3] = (254, 240, 200)
    Image.fromarray(pixels).save("slices/plane00003.png")
    assert main(["tissues", "v.yaml"]) == 2
    said = capsys.readouterr().err
    assert (
        "3 pixels of 1 colour that are in no table: (254, 240, 200) in plane00003.png, row 4, column 5"
        in said
    )
    assert "unknown='nearest' (--unknown nearest) takes the nearest colour" in said
    assert said.startswith("burrlab tissues: v.yaml: 3 pixels")
    assert main(["tissues", "v.yaml", "--unknown", "nearest"]) == 0
    assert (
        "! 3 pixels of 1 colour that are in no table were taken as the nearest colour"
        in capsys.readouterr().out
    )
    assert main(["tissues", "v.yaml", "--unknown", "10", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["labels"][2]["voxels"] == 6339


def test_a_kept_bone_of_another_material(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = [*HAND, "--material", "pvc", *GREY, "--labels", "labels.nii.gz", "--tissues", "t.csv", *THERE]
    assert main([*first, "--save", "kept.nrrd"]) == 0
    capsys.readouterr()
    assert main([*HAND, "--bone", "kept.nrrd", *THERE]) == 0  # its own, not the default
    assert main([*HAND, "--material", "pettigrew", "--bone", "kept.nrrd", *THERE]) == 2
    assert "material must be that of the bone's tissues" in capsys.readouterr().err


def test_a_published_session_on_a_kept_bone_is_followed(files: Path) -> None:
    import burrlab

    bone = VoxelBone.block((8, 8, 4), 0.25)
    burrlab.save_bone("b.h5", bone, 50)
    kept = DrilledRecipe("b.h5")
    device = burrlab.HandDevice((4, 4, 6))
    session = burrlab.Session(
        kept.bone(), (Burr(1.0), burrlab.materials["bone"]), device, seed=1, tick=kept.tick, duration=1.5,
        publish=0, source=kept.plain(),
    )  # fmt: skip
    assert session.port is not None
    with session:
        replica = follow("127.0.0.1", session.port)
        assert session.wait(20)
        replica.wait(5)
    found, tick = session.snapshot()
    assert replica.snapshot()[1] == tick == 1550
    assert replica.digest() == found.digest()
    assert found.removed > 0
    replica.stop()
