"""Killed sessions: every trace opens with plain h5py and replays bit for bit to its end."""

import multiprocessing
import os
import struct
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from session_scenes import make_records, small_bone, writer

import burrlab
import burrlab.session.recorder as trace_writer

SECONDS = 0.6  # of a session


@pytest.fixture
def nursery():
    """A process that starts sessions."""
    command = [sys.executable, str(Path(__file__).with_name("session_process.py")), str(SECONDS)]
    path = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        command, env=path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process


def tell(nursery, word, answer):
    nursery.stdin.write(f"{word}\n")
    nursery.stdin.flush()
    assert nursery.stdout.readline() == f"{answer}\n"


def kill(nursery, folder, after):
    """Starts a session and kills it `after` seconds after its trace exists; (ticks executed, stage)."""
    (folder / "ticks").write_bytes(bytes(9))
    tell(nursery, str(folder), "go")
    end = time.monotonic() + 60
    while not (folder / "session.h5").exists() and time.monotonic() < end:
        time.sleep(0.001)
    time.sleep(after)
    tell(nursery, "kill", "over")
    shown = (folder / "ticks").read_bytes()
    return struct.unpack("<Q", shown[:8])[0], shown[8]


def examine(file):
    """The trace, after all its checks."""
    with h5py.File(file, "r") as plain:
        rows = plain["ticks"][: plain["recorded"][()]]
    np.testing.assert_array_equal(rows["index"], np.arange(len(rows)))
    trace = burrlab.load_trace(file)
    assert trace.ticks.tobytes() == rows.tobytes()
    again = burrlab.replay(trace)
    assert again.equal, again
    assert again.digests == len(trace.digests)
    return trace


def killed(nursery, folder, times, random, capsys, title):
    """Kills sessions and prints the number of lost ticks, which other processes decide: it is not tested."""
    lost, stages = [], [0, 0, 0, 0]
    for i in range(times):
        here = folder / str(i)
        here.mkdir()
        executed, stage = kill(nursery, here, random.uniform(0.0, SECONDS + 0.2))
        trace = examine(here / "session.h5")
        stages[stage] += 1
        if stage == 1:
            assert not trace.complete
            lost.append(max(0, executed - len(trace)))
        elif stage == 3:
            assert trace.complete
        (here / "session.h5").unlink()
    assert lost, stages
    parts = np.percentile(lost, [0, 50, 90, 99, 100]).astype(int).tolist()
    with capsys.disabled():
        print(
            f"\n{title}: {stages} killed before, while and after ticks ran and when all was closed; {parts} "
            "ticks lost"
        )


def test_killed_sessions_replay_to_their_end(nursery, tmp_path, capsys):
    killed(nursery, tmp_path, 6, np.random.default_rng(1), capsys, "SIGKILL")


def busy():
    while True:
        pass


@pytest.mark.slow
@pytest.mark.parametrize("load", [0, 2])
def test_a_hundred_killed_sessions(nursery, tmp_path, capsys, load):
    context = multiprocessing.get_context("spawn")
    others = [context.Process(target=busy, daemon=True) for _ in range(load)]
    try:
        for other in others:
            other.start()
        killed(
            nursery,
            tmp_path,
            100,
            np.random.default_rng(2 + load),
            capsys,
            f"SIGKILL beside {load} busy processes",
        )
    finally:
        for other in others:
            other.kill()
            other.join()


def test_a_kill_between_any_two_writes(tmp_path, monkeypatch):
    """Checks the file as a kill would leave it before, in the middle of, and after every single write."""
    records = make_records(small_bone(), 300)
    file, copy = tmp_path / "session.h5", tmp_path / "copy.h5"
    real, counts = trace_writer._write, []

    def look():
        copy.unlink(missing_ok=True)
        subprocess.run(["cp", "--sparse=always", str(file), str(copy)], check=True)
        trace = burrlab.load_trace(copy)
        assert trace.ticks["burr"]["force_N"][:, 0].tobytes() == (
            records["burr"]["force"][: len(trace), 0].tobytes()
        )
        assert burrlab.replay(trace).equal
        counts.append(len(trace))

    def write(descriptor, data, at):
        look()
        if len(data) > 8:
            real(descriptor, data[: len(data) // 2 + 3], at)
            look()
        done = real(descriptor, data, at)
        look()
        return done

    monkeypatch.setattr(trace_writer, "_write", write)
    made = writer(file, *[records[i : i + 60] for i in range(0, 300, 60)], duration=0.5)
    made.add_digest(0, small_bone().digest())
    made.stop()
    assert made.complete
    assert (sorted(set(counts)), counts) == ([0, 60, 120, 180, 240, 300], sorted(counts))
