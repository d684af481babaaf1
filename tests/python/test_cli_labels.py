"""Labels, tissues and kept bones from the command line."""

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import call, refusal, result, said
from drilled_scenes import stack
from label_scenes import MAP, SPACING, greys, volume, write_files

from burrlab import (
    HandDevice,
    Material,
    Session,
    StartingBone,
    Tissues,
    load_bone,
    load_trace,
    materials,
    replay,
    save_bone,
)
from burrlab._core import Burr, Replica, VoxelBone
from burrlab.bone import slices
from burrlab.bone.slices import pixels
from burrlab.bone.tissues import read_tissues, write_tissues
from burrlab.session.network import follow
from burrlab.volume import DrilledRecipe, load_drilled

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
BOTH = [*GREY, "--labels", "labels.nii.gz", "--tissues", "t.csv"]


@pytest.fixture
def files(here: Path) -> Path:
    write_files(here)
    return here


@pytest.fixture
def run(files: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    return partial(said, capsys)


def test_a_session_and_the_next_day(files: Path, run: Callable[..., str]) -> None:
    first = [*HAND, *BOTH, *THERE, "--save", "kept.nrrd", "--record", "one.h5", "--json", "one.json"]
    assert "bone saved as kept.nrrd" in run(*first)
    kept = load_drilled("kept.nrrd")
    assert (kept.tick, kept.mapping) == (200, MAP)
    assert kept.bone.removed_of("facial nerve") > 0
    second = [*HAND, "--bone", "kept.nrrd", *THERE, "--record", "two.h5", "--json", "two.json"]
    assert "kept.nrrd has been burred for 200 ticks before" in run(*second, "--save", "kept.nrrd")
    later, trace = load_drilled("kept.nrrd"), load_trace("two.h5")
    assert later.tick == 400
    assert later.bone.removed > kept.bone.removed
    np.testing.assert_array_equal(later.bone.pristine, kept.bone.pristine)
    assert (trace.first_tick, trace.ticks["burr"]["touching"][0, 0], trace.bone().digest()) == (
        200,
        0,
        kept.bone.digest(),
    )
    assert [replay(load_trace(name)).equal for name in ("one.h5", "two.h5")] == [True, True]
    one, two = (
        json.loads(Path(name).read_text())["provenance"]["source"] for name in ("one.json", "two.json")
    )
    assert (one["kind"], two["digest"]) == ("labelled volume", kept.bone.digest())
    assert len(list(files.glob("kept.nrrd*"))) == 2


def test_the_bone_is_kept_when_the_view_fails(
    run: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*words: object) -> None:
        time.sleep(0.2)
        raise ValueError("the window is gone")

    monkeypatch.setattr("burrlab.cli.session.show_live", fails)
    run(*HAND, "--radius", "3", "--voxel", "0.4", "--duration", "60", "--save", "block.h5", status=2)
    assert 0 < load_bone("block.h5")[1] < 60_000


def test_a_block_and_slices_are_kept(run: Callable[..., str]) -> None:
    down = ["--axis", "0,0,-1", "--entry"]
    run(*HAND, "--radius", "3", "--voxel", "0.4", "--save", "block.h5")
    assert load_bone("block.h5")[1] == 200
    run(*HAND, "--bone", "block.h5", *down, "0,0,1", "--radius", "3", "--save", "block.h5")
    assert load_bone("block.h5")[1] == 400
    Path("block.h5").rename("block.hdf5")
    run(*HAND, "--bone", "block.hdf5", *down, "0,0,1", "--radius", "3")
    run(*HAND, "--labels", "v.yaml", *down, "4,4,8", "--save", "kept")
    run(*HAND, "--bone", "kept", *down, "4,4,8", "--save", "later")
    assert (load_drilled("later").tick, len(list(Path("later").glob("*.png")))) == (400, 28)
    finer = "--labels a.seg.nrrd --radius 2 --voxel 0.2 --save finer.seg.nrrd"
    run(*HAND, *finer.split(), *down, "8,10,18")
    assert load_drilled("finer.seg.nrrd").bone.spacing == (0.2, 0.2, 0.2)


def test_grey_and_coloured_slices_of_one_spacing(files: Path, run: Callable[..., str]) -> None:
    stack(files / "greys", np.clip(greys(), 0, None).astype(np.uint16).swapaxes(1, 2), name="g{:03d}.png")
    words = ["--volume", "greys", "--map", "0:1000", "--labels", "slices", "--spacing", "0.25", "--transpose"]
    run(*HAND, *words, "--entry", "4,4,7", "--axis", "0,0,-1", "--save", "kept")
    assert {t.name for t in load_drilled("kept").bone.tissues} >= {"bone", "facial nerve"}


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
        (["--labels", "labels.nii.gz", *THERE],
         "labels.nii.gz: the labels 1 (19008 voxels), 4 (6336 voxels) have no names in the file"),
        (["--labels", "none.nrrd", *THERE], "none.nrrd: no such file"),
        (["--labels", "a.seg.nrrd", "--unit", "1", *THERE],
         "unit (--unit) goes with labels in PNG slices, got a.seg.nrrd"),
        ([*GREY, "--labels", "labels.nii.gz", "--unknown", "nearest", *THERE],
         "unknown (--unknown) goes with labels in PNG slices"),
        (["--labels", "slices", *THERE], "slices: PNG slices do not say how large they are"),
        (["--labels", "slices", "--spacing", "0.25", *THERE],
         "slices: slices in colours of volumetric_drilling must be told their axes"),
        (["--labels", "slices", "--tissues", "t.csv", "--spacing", "0.25", *THERE],
         "slices: slices in colours of volumetric_drilling must be told"),
        (["--labels", "a.seg.nrrd", "--no-transpose", *THERE],
         "--transpose and --no-transpose go with PNG slices"),
        (["--transpose"], "--transpose and --no-transpose go with PNG slices"),
        (["--bone", "ct.nrrd", "--no-transpose", *THERE],
         "--transpose goes without --bone, which has its own"),
        (["--labels", "slices", "--unit", "1", "--spacing", "0.2", *THERE],
         "unit goes with a YAML file: spacing is in mm"),
        ([*GREY, "--labels", "a.seg.nrrd", *THERE],
         "a.seg.nrrd must have the same geometry: spacing (0.25, 0.25, 0.25) against (0.2, 0.3"),
        ([*GREY, "--labels", "labels.nii.gz", "--tissues", "t.csv", "--fill", "spleen:1", *THERE], "fill must be of tissues of the table (bone, facial nerve, unlabelled), got 'spleen'"),
        ([*GREY, "--labels", "labels.nii.gz", "--tissues", "small.csv", *THERE],
         "labels that are not in the table: 4 (6336 voxels); the table has 1 bone"),
        (["--fill", "bone:2", "--labels", "x"], "must be TISSUE:OCCUPANCY, 0 to 1, got 'bone:2'"),
        (["--fill", "bone", "--labels", "x"], "must be TISSUE:OCCUPANCY, 0 to 1, got 'bone'"),
        (["--unit", "1,2,3", "--labels", "x"], "--unit: must be a number, got '1,2,3'"),
        (["--unknown", "any", "--labels", "x"], "must be nearest or a label, got 'any'"),
        (["--bone", "ct.nrrd", *THERE], "must lie beside it, and there is none: was the volume moved"),
        (["--bone", "none.nrrd", *THERE], "none.nrrd: no such file or folder"),
        (["--bone", "ct.nrrd", "--volume", "ct.nrrd", *THERE],
         "--volume goes without --bone, which has its own"),
        (["--bone", "ct.nrrd", "--fill", "bone:1", *THERE], "--fill goes without --bone, which has its own"),
        (["--bone", "ct.nrrd"], "--device hand with --bone needs --entry and --axis"),
        (["--axis", "0,0,1"], "--axis goes with --volume, --labels or --bone"),
        (["--save", "x.nrrd"], "--save: a block has no volume: the file must end in .h5, got x.nrrd"),
        (["--save", "x.h5", "--record", "x.h5"], "--save must be another file than --record, got x.h5"),
        (["--save", "slices"], "--save: a block has no volume"),
        ([*GREY, *THERE, "--save", "x.txt"],
         "--save: path must end in .nrrd, .nii, .nii.gz or .mha, got x.txt"),
        ([*GREY, *THERE, "--save", "ct.nrrd"], "--save: path must be another file than the original"),
        ([*GREY, *THERE, "--save", "labels.nii.gz"],
         "--save: path must be a new file or one of save_drilled, labels.nii.gz is neither"),
        (["--labels", "v.yaml", "--entry", "4,4,8", "--axis", "0,0,-1", "--save", "slices"],
         "--save: path must be a new folder, slices is there"),
        ([*GREY, *THERE, "--save", "ct.h5"], "path must be a new file or a burrlab bone, ct.h5 is neither"),
    ],
)  # fmt: skip
def test_wrong_input(files: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("small.csv").write_text("label,name\n1,bone\n")
    Path("ct.h5").write_text("a text")
    before = {path: path.stat().st_mtime_ns for path in files.rglob("*")}
    assert message in refusal(capsys, *HAND, *words)
    assert {path: path.stat().st_mtime_ns for path in files.rglob("*")} == before


def test_a_descent_into_labels(run: Callable[..., str], capsys: pytest.CaptureFixture[str]) -> None:
    descend = ["descend", "--force", "0.3", "--ideal", "--radius", "1", "--max-duration", "0.3", "--seed", 1]
    words = [*descend, *THERE]
    assert result(capsys, *words, *BOTH)["provenance"]["volume"]["recipe"]["kind"] == "labelled volume"
    assert "labels are the nearest of" in run(*words, *BOTH, "--onto")
    assert "labels must overlap the volume: those of" in run(
        *words, *GREY, "--labels", "a.seg.nrrd", "--onto", status=2
    )
    alone = [*descend, "--radius", "2", "--labels", "a.seg.nrrd", "--entry", "8,10,18", "--axis", "0,0,-1"]
    for options, told in (
        ([], "11 to 17 %"),
        (["--smooth", "0.79"], "3 to 6 %"),
        (["--smooth", "0.6"], "11 to 17 %"),
    ):
        _, out, err = call(capsys, *alone, *options, "--json", "-")
        warnings = "".join(json.loads(out)["warnings"])
        assert f"scatter by {told} at R/voxel = 10 (here 5)" in warnings
        assert ("as measured on made-up surfaces without smoothing" in warnings) == ("0.6" in options)
        assert "occupancy from labels alone" in err
        assert (f"smoothed by {''.join(options[1:])} mm" in err) == bool(options)
        assert ("labels alone, smoothed by" in warnings) == bool(options)
    assert "--smooth goes without --volume" in run(*words, *BOTH, "--smooth", "0.8", status=2)
    assert "--labels needs --entry" in run("descend", "--force", "1", "--labels", "a.seg.nrrd", status=2)


def test_a_script_in_the_coordinates_of_the_volume(run: Callable[..., str]) -> None:
    entry, axis = (np.array(text.split(","), float) for text in (ENTRY, AXIS))
    path = entry + np.outer((-2.0, 1.0), axis)
    session = ["session", "--radius", "1", "--seed", "3", "--virtual-clock", *GREY, "--record"]
    for name, places, options in (
        ("own", path, ["--volume-frame"]), ("bone", VOLUME.bone_point(path.T).T, []), ("wrong", path, []),
    ):  # fmt: skip
        rows = "".join(f"{i},{x},{y},{z}\n" for i, (x, y, z) in enumerate(places.tolist()))
        Path(f"{name}.csv").write_text(f"time_s,x_mm,y_mm,z_mm\n{rows}")
        told = run(*session, f"{name}.h5", "--device", f"scripted:{name}.csv", *options)
        assert ("never met the bone: its script missed it by" in told) == (name == "wrong")
    own, bone = (load_trace(f"{name}.h5") for name in ("own", "bone"))
    np.testing.assert_allclose(own.array("center_mm"), bone.array("center_mm"), atol=1e-12)
    assert own.array("removed_levels").sum() > 0
    told = run("session", "--device", "scripted:own.csv", "--volume-frame", status=2)
    assert "--volume-frame goes with --volume, --labels or a volume's --bone" in told


def test_a_kept_bone_of_another_material(run: Callable[..., str]) -> None:
    run(*HAND, "--material", "pvc", *BOTH, *THERE, "--save", "kept.nrrd")
    run(*HAND, "--bone", "kept.nrrd", *THERE)  # the bone's own material
    refused = run(*HAND, "--material", "pettigrew", "--bone", "kept.nrrd", *THERE, status=2)
    assert "material must be that of the bone's tissues" in refused


def test_a_published_session_on_a_kept_bone_is_followed(tmp_path: Path) -> None:
    save_bone(tmp_path / "b.h5", VoxelBone.block((8, 8, 4), 0.25), 50)
    kept = DrilledRecipe(str(tmp_path / "b.h5"))
    session = Session(
        StartingBone(
            kept.bone(), tick=kept.tick, source=kept.plain() | {"notes": [f"read from {tmp_path / 'b.h5'}"]}
        ),
        (Burr(1.0), materials["bone"]),
        HandDevice((4, 4, 6)),
        seed=1,
        duration=1.5,
        publish=0,
    )
    with session:
        hello = Replica("127.0.0.1", session.port)
        assert hello.fetch_hello()
        source = json.loads(hello.hello)["source"]
        assert (source["path"], source["notes"]) == (
            "b.h5",
            ["read from b.h5"],
        )  # a folder can name a patient
        assert session.provenance["source"]["path"] == str(tmp_path / "b.h5")
        replica = follow("127.0.0.1", session.port, volume=tmp_path / "b.h5")
        assert session.wait(20)
        replica.wait(5)
    found, tick = session.snapshot()
    assert replica.snapshot()[1] == tick == 1550
    assert replica.digest() == found.digest()
    assert found.removed > 0
    replica.stop()


@pytest.mark.parametrize("table", [["--unknown", "nearest"], ["--tissues", "t.csv"]])
def test_a_descent_reads_its_slices_once(
    files: Path, run: Callable[..., str], monkeypatch: pytest.MonkeyPatch, table: list[str]
) -> None:
    read: list[Path] = []
    monkeypatch.setattr(slices, "pixels", lambda path: read.append(path) or pixels(path))
    run("descend", "--force", "0.5", "--radius", "1", "--ideal", "--stop", "0.2", "--seed", "1", "--labels", "v.yaml",
        *table, "--entry", "4,4,6.5", "--axis", "0,0,-1")  # fmt: skip
    assert sorted(read[-28:]) == sorted(set(read))
    assert len(read) <= 29  # without a table, the first shows that they are coloured


def test_the_law_of_a_table(files: Path, run: Callable[..., str], capsys: pytest.CaptureFixture[str]) -> None:
    """Where no material is chosen a burr has the law of the table's comment; a chosen one must have it."""
    own = Material("own", c_e=2, alpha=0.1, force_exponent=2, rate_exponent=1)
    write_tissues("t.csv", Tissues(read_tissues("t.csv"), own))
    run(*HAND, *BOTH, *THERE, "--record", "one.h5")
    trace = load_trace("one.h5")
    assert trace.tools[0][1] == own
    assert replay(trace).equal
    other = refusal(capsys, *HAND, *BOTH, *THERE, "--force-exponent", "1.7")
    assert "t.csv: its constants are of the law of Material('own'" in other
    with h5py.File("one.h5", "r+") as file:
        file["tools/0"].attrs["force_exponent"] = 3.0
    with pytest.raises(
        ValueError, match=r"one\.h5 is damaged: a tool's material is not that of its bone's tissues"
    ):
        load_trace("one.h5")


def test_a_volume_with_too_many_fine_voxels_is_cropped_to_the_descent(
    run: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    descend = ["descend", "--force", "0.03", "--ideal", "--radius", "0.6", "--stop", "0.2", "--seed", "1"]
    fine = [*descend, *THERE, *BOTH, "--voxel", "0.125", "--json"]
    assert "cropped" not in run(*fine, "whole.json")
    monkeypatch.setattr("burrlab.bone.image.MOST_VOXELS", 100_000)
    told = run(*fine, "crop.json")
    assert told.count("too many voxels, so it is cropped to what the descent can reach (--crop=") == 1
    whole, crop = (json.loads(Path(name).read_text()) for name in ("whole.json", "crop.json"))
    low, high = crop["provenance"]["volume"]["recipe"]["grey"]["crop_mm"]
    assert f"--crop={','.join(f'{x:g}' for x in low)}:{','.join(f'{x:g}' for x in high)})" in told
    assert crop["status"] == whole["status"] == "ok"
    assert crop["penetration_velocity_mm_s"] == pytest.approx(whole["penetration_velocity_mm_s"], rel=0.1)
    np.testing.assert_allclose(crop["provenance"]["surface_mm"], whole["provenance"]["surface_mm"], atol=1e-9)
