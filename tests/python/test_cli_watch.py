"""What the commands session, metrics and replica say of critical structures."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest
from anatomy_scenes import nerve_bone, straight, table, tool

import burrlab
from burrlab._core import Tissue, Tissues
from burrlab.anatomy.report import AnatomyReport
from burrlab.anatomy.watch import Watch
from burrlab.bone.tissues import write_tissues
from burrlab.cli import main
from burrlab.cli.options import add_options
from burrlab.cli.session import WATCH, chosen_watch
from burrlab.session.anatomy import replica_events, replica_report
from burrlab.session.network import follow

nrrd = pytest.importorskip("nrrd", reason="needs the extra medical")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Grey volume, labels, their table and a script down into the nerve, as a user has them."""
    folder, bone = tmp_path_factory.mktemp("cli"), nerve_bone()
    header = {
        "space": "left-posterior-superior",
        "space directions": np.diag(bone.spacing),
        "space origin": np.array(bone.origin),
    }
    nrrd.write(str(folder / "grey.nrrd"), bone.density.T, header)
    nrrd.write(str(folder / "labels.nrrd"), bone.tissue_numbers.T, header)
    write_tissues(folder / "tissues.csv", table())
    (folder / "down.csv").write_text("time_s,x_mm,y_mm,z_mm\n0,0,0,3\n0.4,0,0,-0.6\n0.5,0,0,2\n")
    return folder


def command(folder, *options):
    return main([
        "session", "--device", f"scripted:{folder / 'down.csv'}", "--volume", str(folder / "grey.nrrd"), "--map", "0:255",
        "--labels", str(folder / "labels.nrrd"), "--tissues", str(folder / "tissues.csv"), "--radius", "1.5", "--seed", "1",
        "--no-realtime", *options,
    ])  # fmt: skip


def test_a_session_watches_and_metrics_tell(folder, capsys) -> None:
    path, said = folder / "near.h5", folder / "near.json"
    assert (
        command(folder, "--record", str(path), "--json", str(said), "--approach", "1", "--injury", "0.1") == 0
    )
    told = capsys.readouterr()
    assert "burr beside" in told.out
    table = told.out[told.out.index("burr beside") : told.out.index("events:")]
    assert "time [s] within" in table
    assert max(map(len, table.splitlines())) <= 80  # it fits a terminal
    assert "burrlab: burr 0: touches nerve at tick" in told.err
    anatomy = json.loads(said.read_text())["anatomy"]
    assert anatomy["removed_mm3"]["nerve"] > 0.1
    assert [row["name"] for row in anatomy["watch"]["structures"]] == ["nerve", "sinus"]
    assert anatomy["watch"]["structures"][0]["approach_mm"] == 1.0
    assert {event["kind"] for event in anatomy["events"]} >= {"approach", "touch", "injury"}

    again = folder / "again.json"
    assert main(["metrics", str(path), "--json", str(again)]) == 0
    assert json.loads(again.read_text())["anatomy"] == anatomy
    assert "burr beside" in capsys.readouterr().out
    assert main(["metrics", str(path), "--watch", "nerve", "--approach", "1.4", "--json", str(again)]) == 0
    other = json.loads(again.read_text())["anatomy"]
    assert [row["approach_mm"] for row in other["watch"]["structures"]] == [1.4]
    assert other["events"][0]["tick"] < anatomy["events"][0]["tick"]
    assert main(["metrics", str(path), "--watch", "none"]) == 2
    assert "--watch must name structures of the trace's bone, got none" in capsys.readouterr().err


def test_a_bone_without_critical_tissues_says_that_nothing_is_watched(folder, capsys) -> None:
    rows = [Tissue(t.name, label=t.label, c_e=t.c_e, alpha=t.alpha) for t in table()]
    write_tissues(folder / "plain.csv", Tissues(rows, table().material))
    assert command(folder, "--tissues", str(folder / "plain.csv")) == 0
    assert (
        "no tissue is critical, so nothing is watched; --watch TISSUE names a structure"
        in capsys.readouterr().err
    )
    assert command(folder, "--tissues", str(folder / "plain.csv"), "--watch", "none") == 0
    assert "nothing is watched" not in capsys.readouterr().err


def test_a_session_without_a_watch_counts_its_tissues(folder, capsys) -> None:
    assert command(folder, "--watch", "none") == 0
    out = capsys.readouterr().out
    assert "removed [mm^3]: bone " in out
    assert "burr beside" not in out


def test_options_are_checked(capsys) -> None:
    plain = burrlab.VoxelBone.block((2, 2, 2), 0.2)
    assert chosen_watch(options([]), plain) is None
    for given, bone, sentence in (
        (
            ["--watch", "none", "--touch", "1"],
            nerve_bone(),
            "--touch goes with a watch, not with --watch none",
        ),
        (["--watch", "vein"], nerve_bone(), "tissue must be one of bone, nerve, sinus, unused, got 'vein'"),
        (["--approach", "3"], plain, "--approach needs a bone with tissues"),
    ):
        with pytest.raises(ValueError, match=sentence):
            chosen_watch(options(given), bone)
    with pytest.raises(SystemExit):
        options(["--injury", "-1"])
    assert "argument --injury: must be zero or positive, got '-1'" in capsys.readouterr().err


def options(given):
    parser = argparse.ArgumentParser()
    add_options(parser, [WATCH])
    return parser.parse_args(given)


def test_a_replica_reports_as_its_leader(tmp_path) -> None:
    bone, path = nerve_bone(), tmp_path / "led.h5"
    session = burrlab.Session(
        bone, tool(), straight([(0, 0, 1.5), (0, 0, -0.6)], [0, 0.4]), seed=3, record=path, duration=0.4,
        wall_clock=False, publish=0, watch=Watch(bone),
    )  # fmt: skip
    replica = follow("127.0.0.1", session.port, bone=bone)
    with session:
        session.wait()
        assert replica.wait(20.0)
    replica.stop()
    mine, theirs = replica_report(replica), session.anatomy()
    assert mine is not None
    assert mine.removed == theirs.removed
    assert mine.settings == theirs.settings
    if replica.status["by_bricks"] == 0:
        assert mine.equals(theirs)
        assert [str(event) for event in replica_events(replica)] == [str(event) for event in theirs.events]
        assert replica_events(replica, len(theirs.events)) == []
    assert AnatomyReport.recorded(burrlab.load_trace(path)).equals(theirs)
    with pytest.raises(TypeError, match="replica must be a Replica, got VoxelBone"):
        replica_report(bone)


def test_a_replica_of_a_session_without_a_watch() -> None:
    bone = burrlab.VoxelBone.block((8, 8, 4), 0.2, origin=(-4, -4, -4))
    session = burrlab.Session(
        bone,
        tool(),
        straight([(0, 0, 2), (0, 0, 0.8)], [0, 0.1]),
        seed=1,
        duration=0.1,
        wall_clock=False,
        publish=0,
    )
    replica = follow("127.0.0.1", session.port, bone=bone)
    with session:
        session.wait()
    replica.stop()
    assert replica_report(replica) is None
    assert replica_events(replica) == []
