"""The commands session and replica; with a page and effects, too."""

import contextlib
import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import refusal, result, said
from replica_scenes import published, soon

import burrlab
import burrlab.cli.session as cli_session
from burrlab.cli import main
from burrlab.effects.companion import Companion

FILES = Path(__file__).parents[1] / "golden/files"
FAST = ["--voxel", "0.4", "--radius", "3", "--seed", "5"]
HAND = ["--device", "hand", *FAST]


def test_hand_recorded(tmp_path, capsys):
    path, figure, file = tmp_path / "hand.h5", tmp_path / "time.png", tmp_path / "said.json"
    told = said(
        capsys, "session", *HAND, "--duration", 1, "--record", path, "--plot", figure, "--json", file
    )  # fmt: skip
    for words in ("1000 ticks", "contact stiffness", "seed 5"):
        assert words in told
    assert figure.stat().st_size > 10_000
    plain = json.loads(file.read_text())
    assert (plain["seed"], plain["ticks"], plain["state"]) == (5, 1000, "all ticks were executed")
    assert set(plain["times_us"]["jitter"]) == {"p50", "p99", "p99.9", "max"}
    assert set(plain["energy"][0]) == {"given_mJ", "most_mJ"}
    assert plain["provenance"]["tools"][0]["radius_mm"] == 3.0
    trace = burrlab.load_trace(path)
    assert (len(trace), trace.bone().spacing, burrlab.replay(trace).equal) == (1000, (0.4, 0.4, 0.4), True)


def test_script_and_two_burrs(tmp_path, capsys):
    script, path = tmp_path / "way.csv", tmp_path / "two.h5"
    script.write_text("time_s,x_mm,y_mm,z_mm,on\n0,0,6,3.5,1\n0.2,0,6,2.7,1\n0.5,2,6,2.7,0\n")
    words = ["session", "--device", f"scripted:{script}", "--device", "hand", *FAST, "--record", path]
    assert "device 0 has come to its end" in said(capsys, *words)
    trace = burrlab.load_trace(path)
    np.testing.assert_allclose(trace.array("center_mm", burr=0)[0], (0, 6, 3.5), atol=0.05)
    assert trace.array("removed_levels", burr=0).sum() > 0
    assert burrlab.replay(trace).equal


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--device", "mouse"],
            "--device must be hand, scripted:FILE, igtl:HOST:PORT, touch[:NAME], omega[:N], haply[:HOST:PORT] or vrpn:NAME@[tcp://]HOST[:PORT], got 'mouse'",
        ),
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
        (["--device", "hand", "--host", "127.0.0.1"], "--host goes with --publish or --vrpn"),
        ([], "the following arguments are required: --device"),
        (["--device", "hand", "--web", "--view"], "argument --view: not allowed with argument --web"),
        (["--device", "hand", "--web", "65536"], "must be a port, 0 to 65535, got '65536'"),
        *(
            (["--device", "hand", f"--{name}"], f"--{name} goes with --view or --web")
            for name in ("effects", "stereo")
        ),
        (["--device", "hand", "--publish", "70000"], "must be a port, 0 to 65535, got '70000'"),
        # a trace is never replaced; the refusal comes before any work
        (
            ["--device", "hand", "--volume", "none", "--record", "x.nrrd"],
            "--record must be a new file, x.nrrd exists",
        ),
    ],
)
def test_wrong_input(arguments, message, capsys, here):
    (here / "x.nrrd").write_text("")
    assert message in refusal(capsys, "session", "--duration", "0.1", *arguments)
    assert (here / "x.nrrd").read_text() == ""


@pytest.fixture
def start():
    """A function that gives (a command in a separate process, its first line); the process ends with the test."""
    with contextlib.ExitStack() as processes:

        def run(*arguments):
            process = processes.enter_context(
                subprocess.Popen(
                    [sys.executable, "-m", "burrlab", *map(str, arguments)],
                    stderr=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                )
            )
            processes.callback(process.kill)
            return process, process.stderr.readline()

        yield run


def test_leader_and_replica(start, tmp_path, capsys):
    """The replica's process is interrupted and run again; then the leader's is interrupted."""
    path, bone = tmp_path / "leader.h5", tmp_path / "bone.h5"
    leader, first = start("session", *HAND, "--publish", "0", "--record", path)
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
    assert "path must be a new file or a burrlab bone" in refusal(capsys, "replica", address, "--save", path)
    late, _ = start("replica", address, "--save", bone, "--json", "-")
    time.sleep(0.5)
    leader.send_signal(signal.SIGINT)
    out, complaint = leader.communicate(timeout=60)
    assert leader.returncode == 130, complaint
    assert out.startswith("interrupted: ")
    status = json.loads(late.communicate(timeout=60)[0])
    trace = burrlab.load_trace(path)
    assert (trace.complete, trace.ended) == (True, "interrupted")
    assert (status["tick"], status["digest"]) == trace.digests[-1]
    assert (status["ended"], status["reason"]) == (True, "interrupted")
    assert burrlab.load_bone(bone)[0].digest() == status["digest"]


@pytest.mark.parametrize(
    ("name", "delay"),
    [
        ("SIGTERM", 0.5),
        ("SIGHUP", 0.01),
        *(pytest.param(*late, marks=pytest.mark.slow) for late in (("SIGHUP", 0.5), ("SIGTERM", 0.0))),
    ],
)
def test_interrupted_session_is_whole(start, tmp_path, name, delay):
    """The trace is as whole as after Ctrl-C, which ends the leader above; also while the session begins."""
    path = tmp_path / "cut.h5"
    run, _ = start("session", *HAND, "--publish", "0", "--record", path)
    time.sleep(delay)
    run.send_signal(getattr(signal, name))
    out, _ = run.communicate(timeout=30)
    assert run.returncode == 130
    trace = burrlab.load_trace(path)
    assert out.startswith(f"{trace.ended}: ")
    assert trace.ended in ("interrupted", "stopped by KeyboardInterrupt")  # the second as it begins
    assert (trace.complete, burrlab.replay(trace).equal) == (True, True)


def test_waiting_device_is_said(tmp_path):
    """With a network device that has no server, the session says that it waits."""
    said, told = [], threading.Event()
    device = burrlab.IgtlDevice("127.0.0.1", 9)
    bone = burrlab.VoxelBone.block((8, 8, 3), 0.4)
    tool = burrlab.Burr(3.0), burrlab.materials["bone"]
    with burrlab.Session(
        bone, tool, device, seed=1, on_message=lambda text: (said.append(text), told.set())
    ) as session:
        assert told.wait(10)
        assert session.ticks == 0
    assert said[0] == (
        "no tick yet: the devices have not given a first position; no server answers at 127.0.0.1:9"
    )


def test_wrong_input_of_a_replica(monkeypatch, capsys):
    missing = Mock(side_effect=FileNotFoundError("ct.nrrd: no such file"))
    monkeypatch.setattr("burrlab.cli.session.follow", missing)
    for sentence, *words in (
        ("ct.nrrd: no such file; --volume says where the leader's volume lies here", "localhost:1"),
        ("argument HOST:PORT: must be HOST:PORT, got 'here'", "here"),
        ("--effects goes with --view or --web", "127.0.0.1:1", "--effects"),
        ("--stereo goes with --view or --web", "127.0.0.1:1", "--stereo"),
    ):
        assert refusal(capsys, "replica", *words) == f"burrlab replica: {sentence}\n"


def test_a_flat_trace_is_used_as_any_other(capsys, tmp_path):
    """It was written by a C++ program (tests/cpp/test_flat_file.cpp)."""
    trace = burrlab.load_trace(file := FILES / "flat.burr")
    assert (trace.first_tick, trace.seed, trace.period, trace.scheme) == (40, 2**64 - 59, 0.5, "cell")
    assert (trace.source, trace.ended, trace.complete) == ("a made up bone", "the last stroke is done", True)
    assert [(burr.radius, material) for burr, material in trace.tools] == [
        (radius, trace.tissues.material) for radius in (0.6, 0.4)
    ]
    assert trace.array("center_mm", burr=1)[-1] == pytest.approx([0.014 * 99 - 0.9, 1.2, 1.6 - 0.008 * 99])
    replayed = result(capsys, "replay", file)
    assert (replayed["equal"], replayed["ticks"], replayed["digests"]) == (True, 60, 1)
    assert replayed["digest"] == trace.digests[-1][1]
    assert result(capsys, "metrics", file)["removed_mm3"] > 0
    said(capsys, "view", file, "--pictures", tmp_path / "slices.png")
    assert (tmp_path / "slices.png").stat().st_size > 10_000


def test_bones_for_cpp_programs(capsys, tmp_path):
    def exported(*words):
        out = tmp_path / f"{len(list(tmp_path.iterdir()))}.burr"
        assert result(capsys, "export", *words, "--out", out)["written"] == str(out)
        bone, tick = burrlab.load_bone(out)
        return bone.digest(), tick

    flat = burrlab.load_trace(FILES / "flat.burr")
    bone, tick = burrlab.load_bone(FILES / "bone.h5")
    volume = burrlab.read_volume(FILES / "grey.nrrd").to_bone(burrlab.OccupancyMap.two_point(90, 180))
    assert exported(FILES / "flat.burr") == (flat.digests[-1][1], 100)
    assert exported(FILES / "flat.burr", "--until", 40) == (flat.initial_digest, 40)
    assert exported(FILES / "bone.h5") == exported(tmp_path / "2.burr") == (bone.digest(), tick)
    assert exported("--volume", FILES / "grey.nrrd", "--map", "90:180") == (volume.digest(), 0)
    for sentence, ending, *words in (
        ("export needs one of FILE and, for .burr, --volume or --labels", "burr"),
        ("--map goes with a volume", "burr", FILES / "bone.h5", "--map", "90:180"),
        ("--until goes with a trace", "burr", FILES / "bone.h5", "--until", 3),
        ("--burr goes with --out FILE.hdf5", "burr", FILES / "flat.burr", "--burr", 1),
        ("--until goes with --out FILE.stl, .ply or .burr", "hdf5", FILES / "flat.burr", "--until", 40),
    ):
        assert sentence in refusal(capsys, "export", *words, "--out", tmp_path / f"new.{ending}")


@pytest.fixture
def shown(monkeypatch):
    """Replaces the page: notes its arguments and waits for the session's end."""
    served = {}

    def serve(source, **options):
        served.update(options, source=source)
        served.get("meanwhile", lambda: None)()
        source.wait(60.0)

    monkeypatch.setattr(cli_session, "pyvista", lambda: None)
    monkeypatch.setattr(cli_session, "check_page", lambda **_: None)
    monkeypatch.setattr(cli_session, "serve", serve)
    return served


def test_effects_of_a_session_are_reported(shown, tmp_path, capsys):
    file = tmp_path / "said.json"
    arguments = ["session", *HAND, "--duration", "1.5", "--no-realtime", "--web", "--effects", "--stereo"]
    text, plain = said(capsys, *arguments, "--json", file), json.loads(file.read_text())
    session, companion, told = shown["source"], shown["effects"], plain["effects"]
    assert shown["stereo"]
    assert not companion.running
    assert companion.seed == told["seed"] == 5
    assert told["frames"] == companion.report().frames > 5
    assert told["budget"] == 0.02
    assert told["balance_mm3"]["dust"]["made"] == pytest.approx(session.snapshot()[0].removed) != 0
    assert told["balance_mm3"]["water"]["made"] > 0
    assert all(account["exact"] for account in told["balance_mm3"].values())
    assert f"effects at assumed rates, seed 5: {told['frames']} frames of at most" in text
    assert "budget 20 ms: " in text
    assert max(len(line) for line in str(companion.report()).splitlines()) <= 80  # a terminal's width
    assert f"dust: made {told['balance_mm3']['dust']['made']:.3f}, present " in text


def test_without_effects_nothing_is_said_of_them(shown, capsys):
    told = result(capsys, "session", *HAND, "--duration", "0.3", "--web")
    assert (shown["effects"], shown["stereo"], "effects" in told) == (None, False, False)


def test_effects_of_a_replica_are_reported(shown, tmp_path, capsys):
    """Effects are also reported if a duration ends the replica while it is shown."""
    file = tmp_path / "said.json"
    with published(60.0) as session:
        assert soon(lambda: session.snapshot()[0].removed > 0)
        where = ["replica", f"127.0.0.1:{session.port}", "--web", "--effects"]
        assert main([*where, "--duration", "1.5"]) == 0
        assert shown["source"].wait(0.0)
        assert not shown["effects"].running
        assert "ended (stopped): tick " in capsys.readouterr().out

        def meanwhile():
            assert soon(lambda: shown["effects"].balance()["dust"].made > 0)
            session.stop()

        shown["meanwhile"] = meanwhile
        assert main([*where, "--json", str(file)]) == 0
    plain = json.loads(file.read_text())
    assert (plain["digest"], plain["effects"]["seed"]) == (session.snapshot()[0].digest(), 11)
    assert plain["effects"]["balance_mm3"]["dust"]["exact"]
    assert 0 < plain["effects"]["balance_mm3"]["dust"]["made"] <= session.snapshot()[0].removed * (1 + 1e-12)
    assert "effects at assumed rates, seed 11: " in capsys.readouterr().out


def test_effects_that_ended_early_are_said(monkeypatch):
    assert cli_session.end_effects(None) == ("", {})
    with published(0.3) as session:
        companion = Companion(session, seed=1).start()
        session.wait()
    monkeypatch.setattr(Companion, "error", "no memory")
    text, plain = cli_session.end_effects(companion)
    assert "\neffects ended early: no memory\n" in text
    assert plain["effects"]["error"] == "no memory"
