"""Critical structures in the output of the commands session, metrics and replica."""

import argparse
import json
from functools import partial

import numpy as np
import pytest
from anatomy_scenes import nerve_bone, straight, table, tool
from command_line import refusal, said
from session_scenes import refused, session_of

from burrlab import Tissue, Tissues, VoxelBone, load_trace
from burrlab.anatomy import AnatomyReport, Watch, write_tissues
from burrlab.cli.commands import WATCH
from burrlab.cli.options import add_options
from burrlab.cli.session import chosen_watch
from burrlab.session.anatomy import replica_events, replica_report
from burrlab.session.network import follow

nrrd = pytest.importorskip("nrrd", reason="makes the files, extra `dev`")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A user's files: grey volume, labels, their table and a script down into the nerve."""
    folder, bone = tmp_path_factory.mktemp("cli"), nerve_bone()
    header = {
        "space": "left-posterior-superior", "space directions": np.diag(bone.spacing), "space origin": np.array(bone.origin),
    }  # fmt: skip
    nrrd.write(str(folder / "grey.nrrd"), bone.density.T, header)
    nrrd.write(str(folder / "labels.nrrd"), bone.tissue_numbers.T, header)
    write_tissues(folder / "tissues.csv", table())
    (folder / "down.csv").write_text("time_s,x_mm,y_mm,z_mm\n0,0,0,3\n0.4,0,0,-0.6\n0.5,0,0,2\n")
    return folder


@pytest.fixture
def session(folder, capsys):
    """Output of the command session."""
    words = [
        "session", "--device", f"scripted:{folder / 'down.csv'}", "--volume", folder / "grey.nrrd", "--map", "0:255",
        "--labels", folder / "labels.nrrd", "--tissues", folder / "tissues.csv", "--radius", "1.5", "--seed", "1",
        "--no-realtime",
    ]  # fmt: skip
    return partial(said, capsys, *words)


def test_a_session_watches_and_metrics_tell(folder, session, capsys) -> None:
    path, kept = folder / "near.h5", folder / "near.json"
    told = session("--record", path, "--json", kept, "--approach", "1", "--injury", "0.1")
    table = told[told.index("burr beside") : told.index("events:")]
    assert "time [s] within" in table
    assert max(map(len, table.splitlines())) <= 80  # it fits a terminal
    assert "burrlab: burr 0: touches nerve at tick" in told
    anatomy = json.loads(kept.read_text())["anatomy"]
    assert anatomy["removed_mm3"]["nerve"] > 0.1
    assert [(row["name"], row["approach_mm"]) for row in anatomy["watch"]["structures"]] == [
        ("nerve", 1.0),
        ("sinus", 1.0),
    ]
    assert {event["kind"] for event in anatomy["events"]} >= {"approach", "touch", "injury"}

    metrics = partial(said, capsys, "metrics", path)
    assert "burr beside" in metrics("--json", kept)
    assert json.loads(kept.read_text())["anatomy"] == anatomy
    metrics("--watch", "nerve", "--approach", "1.4", "--json", kept)
    other = json.loads(kept.read_text())["anatomy"]
    assert [(row["approach_mm"], row["injury_mm3"]) for row in other["watch"]["structures"]] == [(1.4, 0.1)]
    assert other["events"][0]["tick"] < anatomy["events"][0]["tick"]
    assert "--watch must name structures of the trace's bone, got none" in metrics(
        "--watch", "none", status=2
    )


def test_a_bone_without_critical_tissues_says_that_nothing_is_watched(folder, session) -> None:
    rows = [Tissue(t.name, label=t.label, c_e=t.c_e, alpha=t.alpha) for t in table()]
    write_tissues(folder / "plain.csv", Tissues(rows, table().material))
    told = "no tissue is critical, so nothing is watched; --watch TISSUE names a structure"
    assert told in session("--tissues", folder / "plain.csv")
    assert "nothing is watched" not in session("--tissues", folder / "plain.csv", "--watch", "none")


def test_options_are_checked(capsys) -> None:
    plain = VoxelBone.block((2, 2, 2), 0.2)
    assert chosen_watch(options([]), plain) is None
    refused(
        (lambda: chosen_watch(options(["--watch", "none", "--touch", "1"]), nerve_bone()),
         "--touch goes with a watch, not with --watch none"),
        (lambda: chosen_watch(options(["--watch", "vein"]), nerve_bone()),
         "tissue must be one of bone, nerve, sinus, unused, got 'vein'"),
        (lambda: chosen_watch(options(["--approach", "3"]), plain), "--approach needs a bone with tissues"),
    )  # fmt: skip
    error = refusal(capsys, "session", "--device", "hand", "--injury", "-1")
    assert "argument --injury: must be zero or positive, got '-1'" in error


def options(given):
    parser = argparse.ArgumentParser()
    add_options(parser, [WATCH])
    return parser.parse_args(given)


def followed(bone, depth, **options):
    """An ended session that went down to a depth, and its replica."""
    device = straight([(0, 0, 1.5), (0, 0, depth)], [0, 0.4])
    session = session_of(bone, tool(), device, seed=3, duration=0.4, wall_clock=False, publish=0, **options)
    replica = follow("127.0.0.1", session.port, bone=bone)
    with session:
        session.wait()
        assert replica.wait(20.0)
    replica.stop()
    return session, replica


def test_a_replica_reports_as_its_leader(tmp_path) -> None:
    bone, path = nerve_bone(), tmp_path / "led.h5"
    session, replica = followed(bone, -0.6, record=path, watch=Watch(bone))
    mine, theirs = replica_report(replica), session.anatomy()
    assert (mine.removed, mine.settings) == (theirs.removed, theirs.settings)
    np.testing.assert_array_equal(
        replica.watched()["removed"], theirs.watched.doses["removed_levels"].sum(axis=0)
    )
    if replica.status["by_bricks"] == 0:
        assert mine.equals(theirs)
        assert [str(event) for event in replica_events(replica)] == [str(event) for event in theirs.events]
        assert replica_events(replica, len(theirs.events)) == []
    assert AnatomyReport.recorded(load_trace(path)).equals(theirs)
    refused((lambda: replica_report(bone), "replica must be a Replica, got VoxelBone", TypeError))


def test_a_replica_of_a_session_without_a_watch() -> None:
    _, replica = followed(VoxelBone.block((8, 8, 4), 0.2, origin=(-4, -4, -4)), 0.8)
    assert (replica_report(replica), replica_events(replica)) == (None, [])
