"""Traces of the real loop: two burrs on one bone, and a writer that is too slow."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from session_scenes import ended

import burrlab.session.recorder as trace_writer
from burrlab import (
    Burr,
    Clock,
    HandDevice,
    Session,
    TraceHeader,
    TraceWriter,
    VoxelBone,
    _core,
    load_trace,
    materials,
    replay,
)


def two_hands(folder, seconds, voxel):
    """(trace, digest of the loop's bone) of two simulated hands that cut one block, on the virtual clock."""
    devices = [
        HandDevice(start=(0.0, -1.5, 3.5)),
        HandDevice(start=(0.0, 1.5, 2.5), along=(0.0, 1.0, 0.0), amplitude=4.0, strokes=2.0, push=0.5),
    ]
    run = ended(
        Session(
            VoxelBone.block((30, 30, 10), voxel, origin=(-14.9, -14.9, -9.9)),
            [(Burr(3.0), materials["bone"]), (Burr(2.0), materials["bone"])],
            devices,
            seed=3,
            clock=Clock(wall_clock=False),
            duration=seconds,
            record=folder / "session.h5",
        )
    )
    trace = load_trace(folder / "session.h5")
    assert trace.complete
    return trace, run.loop.executor.bone.digest()


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
    writer = TraceWriter(
        tmp_path / "session.h5",
        _core.RecordReader(loop),
        bone,
        TraceHeader(tools, seed=1),
        on_end=lambda _: told.set(),
    )
    device.put((3.0, 3.0, 6.0))
    writer.start()
    loop.start()
    while writer.recorded < 50:
        time.sleep(0.005)
    hangs.set()
    assert told.wait(30)
    assert loop.running
    loop.stop()
    writer.stop("stopped")
    trace = load_trace(writer.path)
    assert trace.ended.startswith(f"recording ended before tick {len(trace)}: the ring was overrun")
    assert 50 <= len(trace) < 600
    assert (trace.complete, replay(trace).equal) == (False, True)
    np.testing.assert_array_equal(trace.array("index"), np.arange(len(trace)))
