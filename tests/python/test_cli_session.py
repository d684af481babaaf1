"""The commands session and replica."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from command_line import call

import burrlab
from burrlab.cli import main

FAST = ["--voxel", "0.4", "--radius", "3", "--seed", "5"]


def test_hand_recorded(tmp_path, capsys):
    path, figure, said = tmp_path / "hand.h5", tmp_path / "time.png", tmp_path / "said.json"
    arguments = ["session", "--device", "hand", "--duration", "1", *FAST, "--record", str(path)]
    assert main([*arguments, "--plot", str(figure), "--json", str(said)]) == 0
    out = capsys.readouterr().out
    assert "1000 ticks" in out
    assert "contact stiffness" in out
    assert "seed 5" in out
    assert figure.stat().st_size > 10_000
    plain = json.loads(said.read_text())
    assert (plain["seed"], plain["ticks"], plain["state"]) == (5, 1000, "all ticks were executed")
    assert set(plain["times_us"]["jitter"]) == {"p50", "p99", "p99.9", "max"}
    assert set(plain["energy"][0]) == {"given_mJ", "most_mJ"}
    assert plain["provenance"]["tools"][0]["radius_mm"] == 3.0
    trace = burrlab.load_trace(path)
    assert trace.bone().spacing == (0.4, 0.4, 0.4)
    assert main(["replay", str(path)]) == 0
    assert capsys.readouterr().out.startswith("equal: 1000 ticks")


def test_script_and_two_burrs(tmp_path, capsys):
    script, path = tmp_path / "way.csv", tmp_path / "two.h5"
    script.write_text("time_s,x_mm,y_mm,z_mm,on\n0,0,6,3.5,1\n0.2,0,6,2.7,1\n0.5,2,6,2.7,0\n")
    assert (
        main(["session", "--device", f"scripted:{script}", "--device", "hand", *FAST, "--record", str(path)])
        == 0
    )
    assert "device 0 has come to its end" in capsys.readouterr().out
    trace = burrlab.load_trace(path)
    np.testing.assert_allclose(trace.array("center_mm", burr=0)[0], (0, 6, 3.5), atol=0.05)
    assert trace.array("removed_levels", burr=0).sum() > 0
    assert burrlab.replay(trace).equal


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--device", "mouse"], "--device must be hand, scripted:FILE or igtl:HOST:PORT, got 'mouse'"),
        (["--device", "igtl:nowhere"], "--device igtl: must be HOST:PORT, got 'nowhere'"),
        (["--device", "scripted:none.csv"], "none.csv"),
        (["--device", "hand", "--map", "0:1"], "--map goes with --volume"),
        (
            ["--device", "hand", "--volume", "x.nrrd"],
            "--device hand with --volume needs --map and --entry and --axis",
        ),
        (["--device", "scripted:w.csv", "--volume", "x.nrrd"], "--volume needs --map"),
        (
            ["--device", "hand", "--volume", "x.nrrd", "--map", "0:1"],
            "--device hand with --volume needs --entry",
        ),
        (
            ["--device", "scripted:w.csv", "--volume", "x.nrrd", "--map", "0:1", "--entry", "0,0,0"],
            "--entry goes with --device hand: other devices say where the burr is",
        ),
        (["--device", "hand", "--radius", "0.3"], "radius must be at least 4 voxels"),
        (["--device", "hand", "--record", "/nowhere/t.h5"], "--record: /nowhere/t.h5 cannot be written"),
        (["--device", "hand", "--voxel", "0.001"], "--voxel makes a block of 9e+12 voxels"),
        (["--device", "hand", "--host", "127.0.0.1"], "--host goes with --publish"),
        ([], "the following arguments are required: --device"),
        (["--device", "hand", "--publish", "70000"], "must be a port, 0 to 65535, got '70000'"),
        # a trace is never replaced, and that is said before any work
        (
            ["--device", "hand", "--volume", "none", "--record", "x.nrrd"],
            "--record must be a new file, x.nrrd exists",
        ),
    ],
)
def test_wrong_input(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.nrrd").write_text("")
    code, _, said = call(capsys, "session", "--duration", "0.1", *arguments)
    assert (code, said.count("\n")) == (2, 1)
    assert message in said
    assert (tmp_path / "x.nrrd").read_text() == ""


def start(*arguments):
    """A command in a process of its own, and the first line that it says."""
    run = subprocess.Popen(
        [sys.executable, "-m", "burrlab", *arguments],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert run.stderr is not None
    return run, run.stderr.readline()


def test_leader_and_replica(tmp_path):
    """Two processes; the replica's is interrupted in the middle and run again, then the leader's."""
    path, bone = str(tmp_path / "leader.h5"), tmp_path / "bone.h5"
    leader, first = start("session", "--device", "hand", *FAST, "--publish", "0", "--record", path)
    assert "published on 127.0.0.1, port" in first
    address = "127.0.0.1:" + first.split("port ")[1].split(";")[0]
    early, first = start("replica", address)
    assert first.startswith("burrlab: following 127.0.0.1, port ")
    time.sleep(0.5)
    early.send_signal(signal.SIGINT)
    told = early.communicate(timeout=60)[0].splitlines()
    assert told[0].startswith("interrupted: tick ")
    assert told[1].endswith(" 0 different; ticks with another result: 0")
    assert told[2].startswith("connections: 1 made, 0 given up; ")
    assert early.returncode == 130
    refused, said = start("replica", address, "--save", path)
    assert "path must be a new file or a burrlab bone" in said
    assert refused.wait(60) == 2
    refused.communicate()
    late, _ = start("replica", address, "--save", str(bone), "--json", "-")
    time.sleep(0.5)
    leader.send_signal(signal.SIGINT)
    out, said = leader.communicate(timeout=60)
    assert leader.returncode == 130, said
    assert out.startswith("interrupted: ")
    status = json.loads(late.communicate(timeout=60)[0])
    trace = burrlab.load_trace(path)
    assert (status["tick"], status["digest"]) == trace.digests[-1]
    assert (status["ended"], status["reason"]) == (True, "interrupted")
    assert burrlab.load_bone(bone)[0].digest() == status["digest"]


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_interrupted_session_is_whole(tmp_path, name):
    path = tmp_path / "cut.h5"
    run = subprocess.Popen(
        [sys.executable, "-m", "burrlab", "session", "--device", "hand", *FAST, "--record", str(path)],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    until = time.monotonic() + 30
    while not path.exists() and time.monotonic() < until:
        time.sleep(0.05)
    time.sleep(1.5)
    run.send_signal(getattr(signal, name))
    out, _ = run.communicate(timeout=30)
    assert run.returncode == 130
    assert out.startswith("interrupted: ")
    trace = burrlab.load_trace(path)
    assert trace.complete
    assert trace.ended == "interrupted"
    assert burrlab.replay(trace).equal


def test_waiting_device_is_said(tmp_path):
    """A network device without a server: the session says that it waits."""
    said = []
    device = burrlab.IgtlDevice("127.0.0.1", 9)
    bone = burrlab.VoxelBone.block((8, 8, 3), 0.4)
    tool = burrlab.Burr(3.0), burrlab.materials["bone"]
    with burrlab.Session(bone, tool, device, seed=1, on_message=said.append) as session:
        done = threading.Event()
        for _ in range(100):
            if said:
                break
            done.wait(0.1)
        assert session.ticks == 0
    assert said[0] == "no tick yet: the devices have not given a first position"


def test_volume_that_is_elsewhere(monkeypatch, capsys):
    def missing(*_, **__):
        raise FileNotFoundError("ct.nrrd: no such file")

    monkeypatch.setattr("burrlab.cli.session.follow", missing)
    for address, said in (
        ("localhost:1", "ct.nrrd: no such file; --volume says where the leader's volume lies here\n"),
        ("here", "argument HOST:PORT: must be HOST:PORT, got 'here'\n"),
    ):
        assert call(capsys, "replica", address)[::2] == (2, f"burrlab replica: {said}")
