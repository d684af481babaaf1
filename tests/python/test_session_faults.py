"""Faults around a session: callbacks, threads, resources and exits. Waiting for its end always returns."""

import gc
import json
import os
import shutil
import subprocess
import sys
import threading
import time
import weakref
from unittest.mock import Mock

import numpy as np
import pytest
from replica_scenes import free_port
from session_scenes import ended
from test_session import TOOL, block, session

import burrlab.session.recorder as trace_writer
from burrlab import (
    Clock,
    HandDevice,
    IgtlDevice,
    MailboxDevice,
    ReplayDevice,
    ScriptedDevice,
    Session,
    VoxelBone,
    _core,
    load_trace,
    replay,
)


def run_here(program, *arguments, **environment):
    """Runs a program in a separate process, in the folder of these tests."""
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)], cwd=os.path.dirname(__file__), capture_output=True,
        text=True, timeout=60, env={**os.environ, **environment}, check=False,
    )  # fmt: skip


def lost_soon(**options):
    """A session whose device is lost after 100 ms."""
    box = MailboxDevice()
    box.put((0, 0, 2.8))
    return session(box, wall_clock=True, realtime=False, **options)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_fork_ends_no_session_of_its_parent():
    done = run_here(
        "import os, sys\n"
        "from test_session_faults import lost_soon\n"
        "with lost_soon() as run:\n"
        "    child = os.fork()\n"
        "    if child == 0:\n"
        "        sys.exit(7)\n"
        "    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])\n"
        "    print(ended, run.wait(20), run.reason)\n"
    )
    assert done.stdout.startswith("7 True device 0 was lost"), done.stdout + done.stderr


@pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="needs Linux and a C compiler"
)
def test_a_sleep_that_ends_early_is_no_tick(tmp_path):
    """A library that returns early from the clock's sleep leaves no deadline due; k would be 0."""
    (tmp_path / "early.c").write_text(
        "int clock_nanosleep(int c, int f, const void* t, void* r) { return 0; }"
    )
    subprocess.run(["cc", "-shared", "-o", tmp_path / "early.so", tmp_path / "early.c"], check=True)
    program = (
        "from test_session_faults import session\n"
        "with session(wall_clock=True, realtime=False, duration=0.3) as run:\n"
        "    print(run.wait(20), run.reason, run.ticks)\n"
    )
    for _ in range(5):  # beside other work the loop may stand still for 100 ms, which ends it
        done = run_here(program, LD_PRELOAD=str(tmp_path / "early.so"))
        if "the loop stalled" not in done.stdout:
            break
    assert done.stdout == "True all ticks were executed 300\n", (done.returncode, done.stderr)


# --- `on_message` runs in the session's threads -----------------------------------------------------------


@pytest.mark.parametrize("kind", [RuntimeError, SystemExit, KeyboardInterrupt])
def test_a_callback_that_raises_or_wants_to_exit_ends_nothing(tmp_path, kind):
    leave = Mock(side_effect=kind("enough"))
    run = ended(lost_soon(on_message=leave, record=tmp_path / "a.h5"))
    assert run.failed
    assert f"on_message failed: {kind('enough')!r}" in run.messages
    trace = load_trace(tmp_path / "a.h5")
    assert (trace.ended, replay(trace).equal) == (run.reason, True)


def test_a_callback_may_stop_the_session(tmp_path):
    run = lost_soon(on_message=lambda text: run.stop("seen"), record=tmp_path / "a.h5")
    assert not [text for text in ended(run).messages if "on_message failed" in text]
    assert load_trace(tmp_path / "a.h5").complete


def test_a_callback_may_stop_it_from_the_recorder(tmp_path, monkeypatch):
    run = session(wall_clock=True, record=tmp_path / "a.h5", on_message=lambda text: run.stop("no trace"))
    write = trace_writer._write

    def full(file, data, at):
        if run.ticks > 50:
            raise OSError(28, "No space left on device")
        return write(file, data, at)

    monkeypatch.setattr(trace_writer, "_write", full)
    with run:
        assert run.wait(20)
    assert run.reason == "no trace"
    assert any("No space left" in text for text in run.messages)


# --- Ends -------------------------------------------------------------------------------------------------


def test_force_that_falls_on_the_way_in():
    """In a plate thinner than the burr, k = dF/dH is negative. No warning comes; housekeeping goes on."""
    plate = VoxelBone.block((16, 16, 0.4), 0.2, origin=(-7.9, -7.9, -0.1))
    script = ScriptedDevice([0.0, 0.5], [[0, 0, 0.5], [0, 0, -1.0]], on=[False, False])
    run = ended(Session(plate, TOOL, script, seed=1, clock=Clock(realtime=False)))
    assert not [text for text in run.messages if "without warnings" in text]
    executor = _core.TickExecutor(plate, [TOOL], 1)
    still = ScriptedDevice([0.0, 0.05], [[0, 0, 0.2]] * 2, [False] * 2)
    loop = _core.HapticLoop(executor, [still], wall_clock=False)
    follower = _core.Follower(loop, stiffness_every=1e-6)
    follower.start()
    loop.start()
    assert loop.wait(20)
    follower.stop()
    assert follower.stiffness()[1] < 0
    assert follower.stability()["stiffness_N_per_mm"] == 0.0


def test_many_that_stop():
    run = session(wall_clock=True, realtime=False).start()
    stops = [run.stop, run.loop.stop, run.follower.stop] * 6
    threads = [threading.Thread(target=stop, daemon=True) for stop in stops]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert not any(thread.is_alive() for thread in threads)
    assert run.wait(20)


def test_full_disk_on_the_virtual_clock(tmp_path, monkeypatch):
    """The loop waits neither for a recorder that has given up nor for a deleted reader.

    40 s are more than half the ring.
    """
    run = session(duration=40.0, record=tmp_path / "a.h5")
    _core.RecordReader(run.loop)
    monkeypatch.setattr(trace_writer, "_write", Mock(side_effect=OSError(28, "No space left on device")))
    with run:
        assert run.wait(60)
    assert run.ticks == 40_000


def test_interrupted_start(tmp_path, monkeypatch):
    """After Ctrl-C between the loop's start and the follower's, nothing runs on."""
    run = session(wall_clock=True, realtime=False, record=tmp_path / "a.h5", publish=0)
    interrupted = Mock(wraps=run.follower, start=Mock(side_effect=KeyboardInterrupt))
    monkeypatch.setattr(run, "follower", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run.start()
    assert (run.reason, run.running) == ("stopped by KeyboardInterrupt", False)
    assert run.wait(20)
    assert load_trace(tmp_path / "a.h5").ended == "stopped by KeyboardInterrupt"


def test_wait_before_start():
    assert not session().loop.wait(0.01)
    short = session(duration=0.1).start()
    assert short.loop.wait(float("inf"))
    short.stop()


def test_program_that_forgets(tmp_path):
    """If the interpreter ends while a session runs, it does not crash or hang, and the trace is whole."""
    done = run_here(
        "import sys, time; from test_session import session\nrun = session(wall_clock=True, "
        "record=sys.argv[1], publish=0, realtime=False).start(); time.sleep(0.3)",
        tmp_path / "a.h5",
    )
    assert (done.returncode, done.stderr) == (0, "")
    trace = load_trace(tmp_path / "a.h5")
    assert (trace.complete, trace.ended, replay(trace).equal) == (True, "the program ended", True)


def test_follower_forgotten_while_the_loop_runs():
    loop = _core.HapticLoop(_core.TickExecutor(block(), [TOOL], 1), [HandDevice()], realtime=False)
    follower = _core.Follower(loop)
    loop.start()
    follower.start()
    begin = time.monotonic()
    del follower
    assert time.monotonic() - begin < 10
    loop.stop()


# --- Devices ----------------------------------------------------------------------------------------------


def test_one_burr_of_one_session_at_a_time():
    hand = HandDevice()
    two = Session(block(), [TOOL] * 2, [hand] * 2, seed=1, clock=Clock(wall_clock=False))
    with pytest.raises(ValueError, match="device 1 must serve one burr of one session at a time"):
        two.start()
    with (
        session(hand, wall_clock=True, realtime=False),
        pytest.raises(ValueError, match="device 0 must serve one burr of one session at a time"),
    ):
        session(hand).start()
    ended(session(hand, duration=0.1))


def test_second_session_feels_the_bone():
    """A device stopped at the end of a session gives force again in the next, or begins again."""
    for device in (HandDevice(), ReplayDevice(np.tile([0.0, 0.0, 2.8], (100, 1)))):
        ends = [ended(session(device, duration=2.0)).digests[-1] for _ in range(2)]
        assert ends[0] == ends[1]


def test_closed_network_device():
    device = IgtlDevice("127.0.0.1", 9)
    with session(device, wall_clock=True, realtime=False):
        pass
    run = session(device, wall_clock=True, realtime=False)
    with pytest.raises(ValueError, match=r"igtl:.* must be new: its connection was closed"):
        run.start()
    assert run.reason.startswith("the loop could not be started: igtl:127.0.0.1:9 must be new")
    assert run.failed
    assert run.wait(20)


# --- Resources --------------------------------------------------------------------------------------------


def test_port_is_free_after_a_refusal(tmp_path):
    """The port is free even while the exception is kept, as notebooks do."""
    (tmp_path / "old.h5").write_text("mine")
    port = free_port()
    with pytest.raises(FileExistsError) as kept:
        session(publish=port, record=tmp_path / "old.h5")
    session(publish=port).stop()
    assert kept.value


def test_digests_that_come_often(tmp_path):
    run = ended(session(duration=3.0, digest_every=0.01, record=tmp_path / "a.h5"))
    trace = load_trace(tmp_path / "a.h5")
    assert (len(trace.digests), trace.digests[-1]) == (301, run.digests[-1])


def test_numpy_numbers(tmp_path):
    options = {
        "seed": np.uint64(2**64 - 1), "rate": np.float32(500), "tick": np.int64(3), "duration": np.float32(0.1),
        "force_limit": np.float32(4), "slew_limit": np.int64(1), "coupling": np.float32(2), "publish": np.int64(0),
    }  # fmt: skip
    ended(session(**options, record=tmp_path / "a.h5"))
    trace = load_trace(tmp_path / "a.h5")
    assert (trace.seed, trace.first_tick, len(trace)) == (2**64 - 1, 3, 50)
    assert json.loads(json.dumps(trace.note))["seed"] == 2**64 - 1
    assert replay(trace).equal


@pytest.mark.parametrize("record", [False, True])
def test_a_session_that_nobody_holds_is_gone_with_its_bones(tmp_path, record):
    """The session is gone at once, without garbage collection: experiments make one after the other."""
    gc.disable()
    try:
        run = ended(session(record=tmp_path / "a.h5" if record else None, duration=0.5))
        gone = weakref.ref(run)
        del run
        assert gone() is None
    finally:
        gc.enable()
