"""A right ear stays a right ear in every format and command; files without orientation get a note."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drilled_scenes import stack
from matplotlib.figure import Figure
from matplotlib.text import Text

from burrlab import LabelVolume, Volume, VoxelBone, load_bone, load_trace, write_volume
from burrlab.bone.tissues import VOLUMETRIC_DRILLING, default_tissues, write_tissues
from burrlab.cli import main
from burrlab.cli.bone import ear_side
from burrlab.session.network import make_bone
from burrlab.view.page_source import page_source
from burrlab.volume import load_drilled, write_dicom

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pytest.importorskip("yaml", reason="extra `medical` is not installed")

NAMES = {1: "Bone", 10: "Facial_Nerve", 15: "TMJ", 16: "EAC"}
SIDE = {"lateral": "-x", "anterior": "-y", "inferior": "-z", "side": "right"}
SPACING = (0.5, 0.5, 0.5)
TURNED = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
LEFT_HANDED = np.diag([-1.0, 1.0, 1.0])


def right_ear(direction: np.ndarray = np.eye(3)) -> LabelVolume:  # noqa: B008
    """22 x 18 x 16 mm in LPS from (0, 0, 0): canal from the side, joint in front, nerve that leaves below."""
    z, y, x = np.moveaxis(np.indices((32, 36, 44)), 0, -1).reshape(-1, 3).T * 0.5
    labels = np.zeros(x.size, np.uint8)
    labels[(x > 20) & (z > 14)] = 1
    labels[(x < 9) & (np.hypot(y - 8, z - 8) < 2.4)] = 16
    labels[(x > 3) & (x < 9) & (y < 4) & (abs(z - 8) < 2)] = 15
    labels[(x > 12) & (x < 20) & (np.hypot(y - 14, z - 12) < 1.5)] = 10  # inwards
    labels[(np.hypot(x - 12, y - 14) < 1.5) & (z < 12)] = 10  # downwards
    axes = np.abs(direction).argmax(axis=0)  # x, y or z along each voxel axis
    turned = labels.reshape(32, 36, 44).transpose([2 - axes[2 - k] for k in range(3)])
    back = direction[axes, range(3)] < 0
    turned = turned[tuple(slice(None, None, -1 if b else 1) for b in back[::-1])]
    origin = np.where(direction.sum(axis=1) < 0, 0.5 * (np.array([44, 36, 32]) - 1), 0)
    return LabelVolume(turned, SPACING, origin, direction, "made", NAMES)


def written(kind: str, folder: Path) -> list[str]:
    """Path of a file of the ear, and the options that its format needs."""
    ear, path = right_ear(), folder / f"ear.{kind}"
    write_tissues(folder / "t.csv", default_tissues(NAMES))
    if kind in ("yaml", "slices"):
        colours = np.zeros((17, 4), np.uint8)
        for label, name in NAMES.items():
            colours[label] = (*VOLUMETRIC_DRILLING[name], 255)
        stack(folder / "slices", colours[ear.labels].swapaxes(1, 2))  # as in the simulator's converter
        path.write_text(
            "VOLUME v:\n  dimensions: {x: 0.022, y: 0.018, z: 0.016}\n  images: {path: slices, prefix: "
            "plane00, format: png}\n"
        )
        return [str(path)] if kind == "yaml" else [str(folder / "slices"), "--spacing", "0.5", "--transpose"]
    if kind == "dicom":
        write_dicom(path, Volume(ear.labels, SPACING, ear.origin, ear.direction, "made"))
    elif kind == "silent.nrrd":
        head = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 44 36 32\nspacings: .5 .5 .5\nencoding: raw\n\n"
        path.write_bytes(head.encode() + ear.labels.tobytes())
    else:
        turns = {"turned.nrrd": TURNED, "left-handed.nii.gz": LEFT_HANDED}
        write_volume(path, right_ear(turns.get(kind, np.eye(3))))
    if kind == "seg.nrrd":
        head, _, values = path.read_bytes().partition(b"\n\n")
        fields = "".join(f"\nSegment{i}_Name:={n}\nSegment{i}_LabelValue:={i}" for i, n in NAMES.items())
        path.write_bytes(head + fields.encode() + b"\n\n" + values)
        return [str(path)]
    return [str(path), "--tissues", str(folder / "t.csv")]


#: Without plain NRRD, which the turned and the silent one include.
KINDS = ("seg.nrrd", "nii.gz", "mha", "dicom", "turned.nrrd", "left-handed.nii.gz", "silent.nrrd", "yaml", "slices")  # fmt: skip


#: Kinds that every command reads; bones of the others are only made, saved and used again.
EVERY_COMMAND = ("dicom", "left-handed.nii.gz", "silent.nrrd", "slices")


@pytest.mark.parametrize("kind", KINDS)
def test_a_right_ear_stays_one(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    drawn: list[str] = []  # words of each figure
    monkeypatch.setattr(
        Figure, "savefig", lambda figure, *_, **__: drawn.append(str(figure.findobj(lambda part: isinstance(part, Text))))
    )  # fmt: skip

    def said(words: str, *more: str) -> Any:
        assert main([*words.split(), *more, "--json", "out.json"]) == 0
        return json.loads(Path("out.json").read_text())

    def stays(bone: VoxelBone) -> None:
        numbers = {t.label: i for i, t in enumerate(bone.tissues or ())}
        for label in NAMES:
            at = np.argwhere(bone.tissue_numbers == numbers[label])[:, ::-1] * bone.spacing + bone.origin
            own = np.argwhere(right_ear().labels == label)[:, ::-1] * SPACING
            np.testing.assert_allclose(sorted((at @ turn.T).tolist()), sorted(own.tolist()), atol=1e-5)

    file, *options = written(kind, tmp_path)
    turn = {"turned.nrrd": TURNED, "left-handed.nii.gz": LEFT_HANDED}.get(kind, np.eye(3))
    found = said("tissues", file, *options)
    assert found["ear"] == SIDE
    text = capsys.readouterr().out
    assert "lateral is -x, anterior -y, inferior -z: a right ear, if the axes are LPS" in text
    if kind in ("yaml", "slices"):  # the mirror image is a left ear
        assert said("tissues", file, *options, "--no-transpose")["ear"]["side"] == "left"

    labels = ["--labels", file, *options]
    # The axis enters along the nerve; a mirror image has no nerve there.
    below = ["--radius", "2", "--seed", "1", "--entry", "12,14,-4", "--axis", "0,0,1"]
    hand = "session --device hand --duration 0.1 --no-realtime"
    kept = "kept" if kind in ("dicom", "yaml", "slices") else f"kept.{kind}"
    first = said(f"{hand} --save {kept} --record s.h5", *labels, *below)
    again = said(f"{hand} --bone {kept} --save alone.h5", *below)
    source = first["provenance"]["source"]
    trace, pair = load_trace("s.h5"), load_drilled(kept)
    results, recipes = [found, first, source, again], [source]
    if kind in EVERY_COMMAND:
        run = said("descend --force 0.3 --ideal --max-duration 0.1 --plot p.png", *labels, *below)
        assert run["status"] == "stalled"
        results += [
            run["provenance"]["volume"],
            said("sweep --forces 0.3 --max-duration 0.1 --out c.csv --plot p.png", *labels, *below),
            said("view --pictures p.png", *labels),
            said("view --pictures p.png", str(trace.path)),
            said("view --bone alone.h5 --pictures p.png"),
        ]
        recipes.append(run["provenance"]["volume"]["recipe"])
        assert len(drawn) >= 5  # descent, curve, slices of the volume, of the trace and of the bone alone
    for bone in (*map(make_bone, recipes), trace.bone(), pair.bone, load_bone("alone.h5")[0]):
        stays(bone)
    assert ear_side(pair.volume(), pair.bone.tissues) == SIDE

    told = {"LPS assumed": kind in ("silent.nrrd", "yaml", "slices"), "mirror image": turn is LEFT_HANDED}
    for words, there in told.items():
        assert [sum(words in note for note in r["notes"]) for r in results] == [there] * len(results)
        assert [words in figure for figure in drawn] == [there] * len(drawn)
        assert (words in page_source(trace).note) == there


def test_no_side_is_claimed_without_three_structures_in_three_directions() -> None:
    ear = right_ear()
    for label in (10, 15, 16):
        assert ear_side(replace(ear, labels=np.where(ear.labels == label, 0, ear.labels))) is None
    assert ear_side(replace(ear, names={**NAMES, 1: "left TMJ"})) is None  # a head has two
    inline = np.where(ear.labels == 15, 0, ear.labels)
    inline[15:18, 15:18, 22:26] = 15  # a joint in the canal's line
    assert ear_side(replace(ear, labels=inline)) == {}
    short = ear.labels.copy()
    short[:, :, 4:18][short[:, :, 4:18] == 16] = 0  # a canal without a long axis
    assert ear_side(replace(ear, labels=short)) == {}
