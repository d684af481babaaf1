"""Traces of the real loop replay to their end: killed sessions, two burrs on one bone, a disk that hangs."""

import contextlib
import os
import struct
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest
from replica_scenes import soon
from session_scenes import ended, make_records, new_writer, session_of, small_bone, writer

import burrlab.session.recorder as trace_writer
from burrlab import Burr, HandDevice, VoxelBone, _core, load_trace, materials, replay

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
    soon((folder / "session.h5").exists, 60.0)
    time.sleep(after)
    tell(nursery, "kill", "over")
    shown = (folder / "ticks").read_bytes()
    return struct.unpack("<Q", shown[:8])[0], shown[8]


def examine(file):
    """The trace, after all its checks."""
    with h5py.File(file, "r") as plain:
        rows = plain["ticks"][: plain["recorded"][()]]
    np.testing.assert_array_equal(rows["index"], np.arange(len(rows)))
    trace = load_trace(file)
    assert trace.ticks.tobytes() == rows.tobytes()
    again = replay(trace)
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


@pytest.mark.slow
@pytest.mark.parametrize("load", [0, 2])
def test_a_hundred_killed_sessions(nursery, tmp_path, capsys, load):
    with contextlib.ExitStack() as others:
        for _ in range(load):
            busy = others.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            others.callback(busy.kill)
        title = f"SIGKILL beside {load} busy processes"
        killed(nursery, tmp_path, 100, np.random.default_rng(2 + load), capsys, title)


def test_a_kill_between_any_two_writes(tmp_path, monkeypatch):
    """Checks the file as a kill would leave it before, in the middle of, and after every single write."""
    records = make_records(small_bone(), 300)
    file, copy = tmp_path / "session.h5", tmp_path / "copy.h5"
    real, counts = trace_writer._write, []

    def look():
        copy.unlink(missing_ok=True)
        subprocess.run(["cp", "--sparse=always", str(file), str(copy)], check=True)
        trace = load_trace(copy)
        assert trace.ticks["burr"]["force_N"][:, 0].tobytes() == (
            records["burr"]["force"][: len(trace), 0].tobytes()
        )
        assert replay(trace).equal
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


def two_hands(folder, seconds, voxel):
    """(trace, digest of the loop's bone) of two simulated hands that cut one block, on the virtual clock."""
    devices = [
        HandDevice(start=(0.0, -1.5, 3.5)),
        HandDevice(start=(0.0, 1.5, 2.5), along=(0.0, 1.0, 0.0), amplitude=4.0, strokes=2.0, push=0.5),
    ]
    bone = VoxelBone.block((30, 30, 10), voxel, origin=(-14.9, -14.9, -9.9))
    tools = [(Burr(radius), materials["bone"]) for radius in (3.0, 2.0)]
    options = {"seed": 3, "wall_clock": False, "duration": seconds, "record": folder / "session.h5"}
    run = ended(session_of(bone, tools, devices, **options))
    trace = load_trace(folder / "session.h5")
    assert trace.complete
    return trace, run._executor.bone.digest()


def assert_replays(trace, digest):
    again = replay(trace)
    assert again.equal, again
    assert (again.digests, again.bone.digest()) == (len(trace.digests), digest)


def test_two_devices_on_one_bone(tmp_path, cpu_path):
    trace, digest = two_hands(tmp_path, 3.0, 0.2)
    assert len(trace) == 3000
    assert min(trace.array("removed_levels", burr).sum() for burr in range(2)) > 1000
    assert len(trace.digests) >= 3
    assert_replays(trace, digest)


@pytest.mark.slow
def test_two_devices_for_half_a_minute_on_every_path_and_in_several_threads(tmp_path, keep_cpu_path):
    trace, digest = two_hands(tmp_path, 30.0, 0.1)
    assert len(trace) == 30_000
    for path in _core.cpu_paths():
        _core.use_cpu_path(path)
        assert_replays(trace, digest)
    with ThreadPoolExecutor(4) as pool:
        for one in [pool.submit(assert_replays, trace, digest) for _ in range(4)]:
            one.result()


def test_a_disk_that_hangs_ends_recording_and_not_the_session(tmp_path, monkeypatch):
    bone = VoxelBone.block((6, 6, 4), 0.2)
    tools = [(Burr(2.0), materials["bone"])]
    device = _core.MailboxDevice(lost_after=60_000.0)
    loop = _core.HapticLoop(
        _core.TickExecutor(bone.copy(), tools, 1), [device], realtime=False, ring=0.2, stall_limit=60_000.0
    )
    real, hangs, told = trace_writer._write, threading.Event(), threading.Event()

    def write(file, data, at):
        if hangs.is_set():
            told.clear()
            while loop.counts.ticks < 600 and loop.running:  # a ring holds 200
                time.sleep(0.01)
            hangs.clear()
        return real(file, data, at)

    monkeypatch.setattr(trace_writer, "_write", write)
    recorder = new_writer(
        tmp_path / "session.h5", _core.RecordReader(loop), bone, tools, seed=1, on_end=lambda _: told.set()
    )
    device.put((3.0, 3.0, 6.0))
    recorder.start()
    loop.start()
    assert soon(lambda: recorder.recorded >= 50)
    hangs.set()
    assert told.wait(30)
    assert loop.running
    loop.stop()
    recorder.stop("stopped")
    trace = load_trace(recorder.path)
    assert trace.ended.startswith(f"recording ended before tick {len(trace)}: the ring was overrun")
    assert 50 <= len(trace) < 600
    assert (trace.complete, replay(trace).equal) == (False, True)
    np.testing.assert_array_equal(trace.array("index"), np.arange(len(trace)))
