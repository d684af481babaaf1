"""The command tissues."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from label_scenes import labels as label_numbers
from label_scenes import write_files
from test_segments import FIELDS, seg_nrrd

from burrlab.bone.formats import write_volume
from burrlab.bone.image import LabelVolume
from burrlab.bone.tissues import read_tissues
from burrlab.cli import main

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pytest.importorskip("yaml", reason="extra `medical` is not installed")


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_files(tmp_path)
    return tmp_path


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
    assert "written new.csv: name what its labels are, then --tissues new.csv" in said(
        "labels.nii.gz", "--template", "new.csv"
    )
    refused = "new.csv, line 4 ('structure 1'), line 5 ('structure 4'), column name: every row needs a name"
    assert refused in said("labels.nii.gz", "--tissues", "new.csv", status=2)
    named = Path("new.csv").read_text().replace("structure 4", "facial nerve").replace("structure 1", "bone")
    Path("new.csv").write_text(named)
    _, bone, nerve = read_tissues("new.csv")  # what stayed empty follows from the names
    assert (bone.assumed, nerve.assumed, nerve.critical, nerve.colour) == (False, True, True, (244, 214, 49))
    assert "--template: new.csv is there already" in said("labels.nii.gz", "--template", "new.csv", status=2)
    said("a.seg.nrrd", "--template", "seg.csv")
    table = read_tissues("seg.csv")
    assert [(t.label, t.name, t.critical, t.assumed) for t in table] == [
        (0, "unlabelled", False, True), (1, "Bone", False, False), (4, "Facial_Nerve", True, True),
    ]  # fmt: skip
    assert table[2].colour == (51, 102, 153)
    seg_nrrd(files / "cn.seg.nrrd", label_numbers(), {**FIELDS, "Segment1_Name": "CN7"})
    said("cn.seg.nrrd", "--template", "cn.csv")
    assert "cn.csv, line 5 ('CN7 (name?)'), column name" in said("cn.csv", status=2)
    twice = {**FIELDS, "Segment0_Name": "Facial_Nerve"}
    seg_nrrd(files / "twice.seg.nrrd", label_numbers(), twice)
    said("twice.seg.nrrd", "--template", "twice.csv")
    assert [t.critical for t in read_tissues("twice.csv")] == [False, True, True]
    assert "Facial_Nerve" in said("seg.csv")
    assert "ct.nrrd: labels must be zero or positive, got -1000: is this a grey volume?" in said(
        "ct.nrrd", status=2
    )
    for option in ("unknown", "unit", "spacing", "tissues", "template"):
        word = "nearest" if option == "unknown" else "1"
        for table in ([], ["t.csv"]):
            assert f"--{option} goes with a file of labels" in said(*table, f"--{option}", word, status=2)
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
    assert main(["tissues", "v.yaml", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["unknown_colours"] == [
        {"colour": [254, 240, 200], "pixels": 3, "slice": "plane00003.png", "row": 4, "column": 5, "nearest": "EAC", "distance": 20.5}
    ]  # fmt: skip
    assert main(["tissues", "v.yaml"]) == 0
    assert "colours in no table are refused where a bone is made" in capsys.readouterr().out
    descent = ["descend", "--force", "1", "--labels", "v.yaml", "--entry", "4,4,8", "--axis", "0,0,-1"]
    assert main(descent) == 2
    said = capsys.readouterr().err
    assert (
        "3 pixels of 1 colour that are in no table: (254, 240, 200) in plane00003.png, row 4, column 5"
        in said
    )
    assert main(["tissues", "v.yaml", "--unknown", "nearest"]) == 0
    said = capsys.readouterr().out
    assert "! 3 pixels of 1 colour that are in no table were taken as the nearest colour" in said
    assert "were taken as Bone (EAC 3)" in said
    assert main(["tissues", "v.yaml", "--unknown", "nearest:EAC", "--json", "-"]) == 0
    assert [row["voxels"] for row in json.loads(capsys.readouterr().out)["labels"]][-1] == 3
    assert main(["tissues", "v.yaml", "--unknown", "10", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["labels"][2]["voxels"] == 6339


def test_known_structures_fit_a_terminal(capsys):
    assert main(["tissues"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert any("vestibulocochlear" in line for line in lines)
