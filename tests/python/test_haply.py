"""A Haply Inverse3 in sessions, over a mock of its service (tests/haply_service.py)."""

import contextlib
import ctypes
import itertools
import math
import re
import select
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from command_line import refusal, result, said
from replica_scenes import soon
from session_scenes import refused
from test_servo_devices import session

from burrlab import HaplyDevice, _core, load_trace, replay
from haply_service import HaplyService

DEEP = 0.0028  # in contact [m]


@pytest.fixture
def service():
    with contextlib.closing(HaplyService()) as service:
        yield service


def opened(service, lost_after=5000.0, **options):  # however busy the machine is
    return HaplyDevice("127.0.0.1", service.port, lost_after=lost_after, **options)


def edited(kind, **fields):
    """A change of the service's messages: of the state of a device of this kind."""

    def change(message):
        message[kind][0]["state"].update(fields)
        return message

    return change


def test_a_hand_meets_bone_and_the_connection_drops(service, tmp_path):
    device, file = opened(service, on_button=1), tmp_path / "trace.h5"
    assert device.hardware == "inverse3 049D, wireless_verse_grip 61548"
    assert device.library == f"ws://127.0.0.1:{service.port}"
    half = math.sqrt(0.5)
    with session(device, record=file) as run:
        assert soon(lambda: run.ticks > 50)
        assert not np.any(service.forces)  # no contact yet
        ticks, sway = run.ticks, itertools.cycle((0.0, 1e-4))
        service.change = lambda message: edited(
            "inverse3", cursor_position={"x": next(sway), "y": 0.0, "z": 0.005}
        )(message)
        assert soon(lambda: run.ticks > ticks + 100)
        service.change = lambda message: message
        service.position, service.orientation, service.buttons = (0, 0, DEEP), (half, 0, half, 0), {"b": True}
        assert soon(lambda: service.forces[-1][2] > 0)
        service.buttons = {"a": True, "b": True, "c": True}
        ticks = run.ticks
        assert soon(lambda: run.ticks > ticks + 50)
        service.drop()
        assert run.wait(10)
    assert (run.failed, run.reason) == (True, f"device 0 was lost: {device.fault}")
    assert device.fault.startswith(f"{device.name} failed: the connection ended (")
    assert not device.force.any()
    trace = load_trace(file)
    assert (trace.complete, replay(trace).equal) == (True, True)
    assert {*service.forces} <= {(0.0, 0.0, 0.0), *map(tuple, trace.array("sent_force_N"))}
    position, orientation = trace.array("device_position_mm"), trace.array("orientation")
    np.testing.assert_allclose(position[[0, -1]], [(0, 0, 5), (0, 0, 2.8)])
    np.testing.assert_allclose(orientation[[0, -1]], [(1, 0, 0, 0), (half, 0, half, 0)])
    assert list(dict.fromkeys(trace.array("buttons"))) == [0, 2, 7]
    assert list(dict.fromkeys(trace.array("on"))) == [False, True]
    assert (
        trace.array("device_velocity_mm_s")[:, 0].min() < 0 < trace.array("device_velocity_mm_s")[:, 0].max()
    )
    refused(
        (lambda: session(device, duration=0.1).start(),
         r"must be opened anew: haply:.* failed: the connection ended"),
    )  # fmt: skip
    device, seen = opened(service), len(service.forces)
    with session(device) as again:
        assert soon(lambda: np.any(service.forces[seen:]))
    assert not again.failed
    assert soon(lambda: not any(service.forces[-1]))


_SCRIPT = """
import ctypes, sys, burrlab
device = burrlab.HaplyDevice("127.0.0.1", int(sys.argv[1]))
bone = burrlab.VoxelBone.block((30, 30, 10), 0.4, origin=(-14.8, -14.8, -9.8))
with burrlab.Session(bone, (burrlab.Burr(3.0), burrlab.materials["bone"]), device, clock=burrlab.Clock(realtime=False)) as run:
    sys.stdin.readline()
    ctypes.PyDLL(None).usleep(5_000_000 if sys.argv[2] == "hold" else 0)
    print("Python goes on", flush=True)
    run.wait()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGTERM does not end a program gently there")
@pytest.mark.parametrize("case", ["hold", "SIGTERM"])
def test_a_force_ends_with_its_program(service, case):
    """While other code holds Python's interpreter, and when a signal ends the program."""
    service.position = (0, 0, DEEP)
    child = subprocess.Popen(
        [sys.executable, "-c", _SCRIPT, str(service.port), case],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert soon(lambda: service.forces and service.forces[-1][2] > 0.05)
        child.stdin.write("\n")
        child.stdin.flush()
        if case == "hold":
            assert soon(lambda: not any(service.forces[-1]))
            assert not select.select([child.stdout], [], [], 0)[0]  # it is still held
        else:
            child.stdout.readline()
            assert soon(lambda: any(service.forces[-1]))
            child.send_signal(signal.SIGTERM)
            assert child.wait(10) == -signal.SIGTERM
            assert soon(lambda: not any(service.forces[-1]))
    finally:
        child.kill()
        child.communicate()


@pytest.mark.skipif(sys.platform == "win32", reason="its library has no usleep")
def test_only_a_force_that_stood_is_called_zero(service):
    def hold_up():
        seen = len(service.forces)
        ctypes.PyDLL(None).usleep(800_000)
        assert soon(lambda: len(service.forces) > seen + 20)

    device = opened(service, lost_after=2000.0)
    hold_up()
    with session(device) as run:
        hold_up()
        assert device.note == ""
        service.position = (0, 0, DEEP)
        assert soon(lambda: service.forces[-1][2] > 0.05)
        hold_up()
        assert soon(lambda: device.note in run.messages)
    assert (note := device.note).endswith(
        "its force was zero for a time, as this program's Python was held up"
    )
    with session(device, duration=0.2) as run:
        assert run.wait(10)
    assert note not in run.messages


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda message: "{", "the service must send JSON objects, got '{'"),
        (lambda message: b"\xff\xfe\xfd", "the service must send JSON objects"),
        (lambda message: "[" * 200_000, "the service must send JSON objects"),
        (lambda message: [message], "the service must send JSON objects"),
        (lambda message: "7" * (2 << 20), "the connection ended .*too big"),
        (lambda message: {}, "the service must send the state of inverse3 049D, got {}"),
        (lambda message: {"inverse3": [7]}, "inverse3 must be devices with an id each, got \\[7\\]"),
        (lambda message: {**message, "wireless_verse_grip": []}, "the state of wireless_verse_grip 61548"),
        (edited("inverse3", cursor_position=None), "cursor_position must be numbers x, y, z, got None"),
        (edited("inverse3", cursor_position={"x": 0, "y": 0}), "cursor_position must be numbers x, y, z"),
        (edited("inverse3", cursor_position={"x": 0, "y": 0, "z": math.nan}), "must be numbers x, y, z"),
        (edited("inverse3", cursor_position={"x": 0, "y": 0, "z": 10**400}), "must be numbers x, y, z"),
        (edited("inverse3", cursor_position={"x": 0, "y": 0, "z": "1"}), "must be numbers x, y, z"),
        (edited("wireless_verse_grip", orientation=dict.fromkeys("wxyz", 0)), "length of orientation must be 1, got 0"),
        (edited("wireless_verse_grip", orientation=dict.fromkeys("wxyz", math.inf)), "orientation must be numbers w"),
        (edited("wireless_verse_grip", buttons=[True]), "buttons must be true or false, got \\[True\\]"),
    ],
)  # fmt: skip
def test_wrong_answers_end_the_session_with_force_zero(service, change, sentence):
    service.position = (0, 0, DEEP)
    device = opened(service)
    with session(device) as run:
        assert soon(lambda: service.forces and service.forces[-1][2] > 0)
        service.change = change
        assert run.wait(10)
    assert run.failed
    with pytest.raises(AssertionError, match=f"device 0 was lost: haply:.* failed: .*{sentence}"):
        raise AssertionError(run.reason)
    assert not device.force.any()
    if "too big" not in sentence:  # there the connection has ended
        assert soon(lambda: not any(service.forces[-1]))


def test_late_answers(service):
    device = opened(service, lost_after=1000.0)
    service.position = (0, 0, DEEP)
    with session(device) as run:
        assert soon(lambda: service.forces and service.forces[-1][2] > 0)
        service.delay, ticks = 0.05, run.ticks
        assert soon(lambda: run.ticks > ticks + 200)
        assert run.loop.running
        service.delay = 1.5
        assert run.wait(10)
    assert re.fullmatch(r"device 0 was lost: its last position is [1-9]\d\d\d ms old", run.reason)
    assert not device.force.any()
    assert soon(lambda: not any(service.forces[-1]))
    service.delay, seen = 0.0, len(service.forces)
    assert soon(lambda: len(service.forces) > seen + 3)
    with session(device, duration=0.1) as run:
        assert run.wait(10)
    assert not run.failed
    service.delay = 60.0
    assert soon(lambda: device.fault)
    assert device.fault == f"{device.name} failed: the service did not answer in time"


def test_messages_that_were_not_asked_for_make_no_position_old(service):
    device, service.answers = opened(service), 2
    with session(device):
        assert soon(lambda: len(service.forces) > 500)
        service.position, seen = (0, 0, DEEP), len(service.forces)
        assert soon(lambda: service.forces[-1][2] > 0)
        assert len(service.forces) < seen + 250


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda message: {}, "exactly one Inverse3 and at most one VerseGrip, got none"),
        (
            lambda message: {"inverse3": [{"device_id": "A"}, {"device_id": "B"}]},
            "at most one VerseGrip, got A, B",
        ),
        (
            lambda message: {**message, "verse_grip": [{"device_id": "7"}]},
            "at most one VerseGrip, got 049D, 7, 61548",
        ),
        (
            lambda message: {"inverse3": [{**message["inverse3"][0], "status": {"calibrated": False}}]},
            "the Inverse3 049D must be calibrated",
        ),
        (lambda message: "hello", "the service must send JSON objects, got 'hello'"),
        (lambda message: {"inverse3": [{"device_id": "\ud800"}]}, "must be devices with an id each"),
        (lambda message: {"inverse3": message["inverse3"] * 2}, "must be devices with an id each"),
    ],
)
def test_services_that_cannot_be_used(service, change, sentence):
    service.change = change
    refused((lambda: opened(service), f"haply:.* cannot be used: .*{sentence}"))


def test_a_device_of_its_own_and_no_grip(service):
    service.change = lambda message: {"inverse3": message["inverse3"]}
    device = opened(service)
    assert device.hardware == "inverse3 049D"
    refused(
        (lambda: opened(service), "the Inverse3 049D is open already"),
        (
            lambda: session(device, wall_clock=False),
            "wall_clock must be True for a device that a hand holds, got False",
        ),
    )
    service.delay, seen = 0.3, len(service.forces)
    assert soon(lambda: len(service.forces) > seen)
    time.sleep(0.05)
    service.delay = 0.0
    del device  # while its thread waits for an answer
    device, seen = opened(service), len(service.forces)
    assert soon(lambda: len(service.forces) > seen)
    assert not device.fault


def test_two_writers_do_not_mix():
    """The watchdog is due while half a message waits for its reader."""
    ours, theirs = socket.socketpair()
    watchdog, message = _core.ForceWatchdog(ours.fileno(), b"rest", 20.0), b"m" * (1 << 20)
    ours.close()  # it has a descriptor of its own
    with ThreadPoolExecutor() as pool, theirs:
        sent = pool.submit(watchdog.send, message)
        time.sleep(0.1)
        got = b""
        while len(got) < len(message) + 4:
            got += theirs.recv(1 << 16)
        assert (sent.result(), got) == (True, message + b"rest")
    assert [watchdog.beat(), watchdog.beat(), watchdog.send(b"x")] == [True, False, False]


def test_commands(service, capsys, monkeypatch):
    words = ["session", "--voxel", 0.4, "--duration", 0.1, "--lost-after", 5000, "--no-realtime", "--device"]
    said(capsys, *words, f"haply:127.0.0.1:{service.port}")
    monkeypatch.setattr("burrlab.session.exchange.PORT", service.port)
    row = result(capsys, "devices")["devices"][-1]
    assert (row["device"], row["hardware"]) == ("haply", "inverse3 049D, wireless_verse_grip 61548")
    with socket.create_server(("127.0.0.1", 0)) as silent:  # it listens, and says nothing
        monkeypatch.setattr("burrlab.session.exchange.PORT", port := silent.getsockname()[1])
        why = result(capsys, "devices")["devices"][-1]["why_not"]
    assert (
        why == f"haply:localhost:{port} must be a running Inverse Service: the service did not answer in time"
    )
    assert "must be a running Inverse Service: " in refusal(capsys, *words, f"haply:127.0.0.1:{port}")
    monkeypatch.setitem(sys.modules, "websockets.sync.client", None)
    assert "a Haply device needs websockets: pip install 'burrlab[haply]'" in refusal(capsys, *words, "haply")


@pytest.mark.parametrize("host", ["", "a/b", "a b"])
def test_hosts_that_are_refused(host):
    refused((lambda: HaplyDevice(host), "host must be a name or an address, got"))
