"""The command tissues."""

import itertools
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command_line import result, said
from label_scenes import labels as label_numbers
from label_scenes import write_files
from PIL import Image
from test_segments import FIELDS, seg_nrrd

from burrlab import LabelVolume, Material, Tissues, write_volume
from burrlab.bone.tissues import read_tissues, write_tissues

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pytest.importorskip("yaml", reason="extra `medical` is not installed")


@pytest.fixture
def run(here: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    write_files(here)
    return partial(said, capsys, "tissues")


def test_what_the_labels_of_a_file_are(run: Callable[..., str]) -> None:
    known = run()
    assert "facial nerve" in known
    assert "facial, cn vii" in known
    assert [line.split()[:3] for line in run("a.seg.nrrd").splitlines()[1:]] == [
        ["0", "6912", "165.89"], ["1", "19008", "456.19"], ["4", "6336", "152.06"],
    ]  # fmt: skip
    rows = json.loads(run("a.seg.nrrd", "--json", "-"))["labels"]
    assert rows[2] == {"label": 4, "voxels": 6336, "volume_mm3": pytest.approx(152.064), "name": "Facial_Nerve", "tissue": "facial nerve"}  # fmt: skip
    assert "2 of 3 labels are no known tissue: they need a table (--template, --tissues)" in run(
        "labels.nii.gz"
    )
    assert "facial nerve" in run("labels.nii.gz", "--tissues", "t.csv")


def test_the_law_of_a_table_where_it_is_not_the_papers(run: Callable[..., str]) -> None:
    paper = read_tissues("t.csv")
    write_tissues("q.csv", Tissues(list(paper), Material("own", c_e=2.0, alpha=0.1, force_exponent=2)))
    for file in (["q.csv"], ["labels.nii.gz", "--tissues", "q.csv"]):
        assert "law: parabolic, F ~ h^2" in run(*file).splitlines()
    assert json.loads(run("q.csv", "--json", "-"))["force_exponent"] == 2
    assert "law" not in run("t.csv")
    assert "exponent" not in run("t.csv", "--json", "-")


def test_a_template_is_completed_by_hand(run: Callable[..., str]) -> None:
    assert "written new.csv: name what its labels are, then --tissues new.csv" in run(
        "labels.nii.gz", "--template", "new.csv"
    )
    refused = "new.csv, line 4 ('structure 1'), line 5 ('structure 4'), column name: every row needs a name"
    assert refused in run("labels.nii.gz", "--tissues", "new.csv", status=2)
    named = Path("new.csv").read_text().replace("structure 4", "facial nerve").replace("structure 1", "bone")
    Path("new.csv").write_text(named)
    _, bone, nerve = read_tissues("new.csv")  # empty cells follow from the names
    assert (bone.assumed, nerve.assumed, nerve.critical, nerve.colour) == (False, True, True, (244, 214, 49))
    assert "--template: new.csv is there already" in run("labels.nii.gz", "--template", "new.csv", status=2)


def test_templates_of_files_with_names(run: Callable[..., str]) -> None:
    run("a.seg.nrrd", "--template", "seg.csv")
    table = read_tissues("seg.csv")
    assert [(t.label, t.name, t.critical, t.assumed) for t in table] == [
        (0, "unlabelled", False, True), (1, "Bone", False, False), (4, "Facial_Nerve", True, True),
    ]  # fmt: skip
    assert table[2].colour == (51, 102, 153)
    assert "Facial_Nerve" in run("seg.csv")
    for name, fields in (("cn", {"Segment1_Name": "CN7"}), ("twice", {"Segment0_Name": "Facial_Nerve"})):
        seg_nrrd(Path(f"{name}.seg.nrrd"), label_numbers(), {**FIELDS, **fields})
        run(f"{name}.seg.nrrd", "--template", f"{name}.csv")
    assert "cn.csv, line 5 ('CN7 (name?)'), column name" in run("cn.csv", status=2)
    assert [t.critical for t in read_tissues("twice.csv")] == [False, True, True]


def test_refusals(run: Callable[..., str]) -> None:
    assert "ct.nrrd: labels must be zero or positive, got -1000: is this a grey volume?" in run(
        "ct.nrrd", status=2
    )
    for option, table in itertools.product(
        ("unknown", "unit", "spacing", "tissues", "template"), ([], ["t.csv"])
    ):
        word = "nearest" if option == "unknown" else "1"
        assert f"--{option} goes with a file of labels" in run(*table, f"--{option}", word, status=2)
    write_volume("many.nrrd", LabelVolume(np.arange(125).reshape(5, 5, 5), 0.2, (0, 0, 0), np.eye(3), "m"))
    told = "many.nrrd: a bone has at most 64 tissues, and there are 125 labels"
    assert told in run("many.nrrd", "--template", "m.csv", status=2)
    assert not Path("m.csv").exists()


def test_colours_in_no_table_are_told(run: Callable[..., str], capsys: pytest.CaptureFixture[str]) -> None:
    with Image.open("slices/plane00003.png") as image:
        pixels = np.asarray(image).copy()
    pixels[4, 5:8, :3] = (254, 240, 200)
    Image.fromarray(pixels).save("slices/plane00003.png")

    told_of = partial(result, capsys, "tissues", "v.yaml")
    assert told_of()["unknown_colours"] == [
        {"colour": [254, 240, 200], "pixels": 3, "slice": "plane00003.png", "row": 4, "column": 5, "nearest": "EAC", "distance": 20.5}
    ]  # fmt: skip
    assert "colours in no table are refused where a bone is made" in run("v.yaml")
    descent = ["descend", "--force", "1", "--labels", "v.yaml", "--entry", "4,4,8", "--axis", "0,0,-1"]
    told = "3 pixels of 1 colour that are in no table: (254, 240, 200) in plane00003.png, row 4, column 5"
    assert told in said(capsys, *descent, status=2)
    text = run("v.yaml", "--unknown", "nearest")
    assert "! 3 pixels of 1 colour that are in no table were taken as the nearest colour" in text
    assert "were taken as Bone (EAC 3)" in text
    assert told_of("--unknown", "nearest:EAC")["labels"][-1]["voxels"] == 3
    assert told_of("--unknown", "10")["labels"][2]["voxels"] == 6339
