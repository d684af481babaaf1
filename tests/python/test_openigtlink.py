"""The device of an OpenIGTLink stream, with Debian's libopenigtlink and pyigtl.

Debian: ``apt-get install libopenigtlink-dev openigtlink-examples``; PyPI: ``pip install pyigtl``.
"""

import contextlib
import json
import socket
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import wire
from replica_scenes import free_port, soon
from session_scenes import refused

from burrlab import (
    Burr,
    Clock,
    IgtlDevice,
    Safety,
    Session,
    VoxelBone,
    VrpnDevice,
    _core,
    load_trace,
    materials,
)

EXAMPLES = Path("/usr/share/doc/openigtlink-examples/examples")


@contextlib.contextmanager
def serve(messages):
    """Port of a loopback server that sends these messages to its first client, then closes."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(20)

        def run():
            with contextlib.suppress(OSError):
                peer, _ = listener.accept()
                with peer:
                    peer.sendall(b"".join(messages))
                    peer.shutdown(socket.SHUT_WR)
                    peer.recv(1)

        thread = threading.Thread(target=run)
        thread.start()
        yield listener.getsockname()[1]
    thread.join()


def device(host, port, **options):
    return lambda: _core.IgtlDevice(host, port, **options)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (device("127.0.0.1", 0), "port must be 1 to 65535, got 0"),
        (device("256.1.1.1.", 1), "host must be a name or an address that can be looked up, got '256"),
        (device("127.0.0.1", 1, device_name="x" * 21),
         "length of device_name must be at most 20 bytes, got 21"),
        (device("127.0.0.1", 1, lost_after=0), "lost_after must be positive and finite, got 0"),
        (lambda: VrpnDevice("", "127.0.0.1"), "length of name must be 1 to 99 bytes, got 0"),
        (lambda: VrpnDevice("T", "127.0.0.1", 0), "port must be 1 to 65535, got 0"),
        (lambda: VrpnDevice("T", "127.0.0.1", on_button=8), "on_button must be 0 to 7, or None, got 8"),
    ],
)  # fmt: skip
def test_refusals(call, told):
    refused((call, told))


# Debian's libopenigtlink


def test_libopenigtlink_decodes_the_frozen_messages(build):
    """tests/golden/frozen/messages.json, whose bytes are those of the core, to the last bit."""
    frozen = json.loads((Path(__file__).parents[1] / "golden/frozen/messages.json").read_text())
    program = build(Path(__file__).with_name("openigtlink_peer.cpp"))
    with serve([bytes.fromhex(frozen[name]) for name in ("TRANSFORM 1", "SENSOR 1")]) as port:
        out = subprocess.run([program, "127.0.0.1", str(port)], check=True, capture_output=True, timeout=60)
    pose, force = (line.split() for line in out.stdout.decode().splitlines())
    assert (pose[:2], float(pose[2])) == (["TRANSFORM", "burr"], 1.75e9)
    rows = [(0, -1, 0, 1.5), (1, 0, 0, -2.5), (0, 0, 1, 0.1)]
    np.testing.assert_array_equal(np.float32(pose[3:]).reshape(3, 4), np.float32(rows))
    assert (force[:2], force[3:5]) == (["SENSOR", "force"], ["0", "11^1"])  # newton
    assert [float(number) for number in force[5:]] == [0.1, np.pi, -3e300]


def loop_of(device):
    """A loop that this device drives over bone, and a reader of its ticks."""
    bone = VoxelBone.block((6, 6, 4), 0.1, origin=(-2.95, -2.95, -3.95))
    executor = _core.TickExecutor(bone, [(Burr(1.5), materials["bone"])], seed=1)
    loop = _core.HapticLoop(executor, [device], realtime=False)
    return bone, loop, _core.RecordReader(loop)


def test_example_server_drives_the_burr(build):
    """Debian's TrackerServer sends 100 poses, then closes; the device connects again."""
    port = free_port()
    program = build(EXAMPLES / "Tracker" / "TrackerServer.cxx")
    with subprocess.Popen([program, str(port), "200"], stdout=subprocess.DEVNULL) as server:
        tracker = _core.IgtlDevice("127.0.0.1", port, device_name="Tracker", lost_after=5000)
        _, loop, reader = loop_of(tracker)
        try:
            loop.start()
            assert soon(lambda: tracker.counters["messages"] >= 100 and tracker.counters["connections"] >= 2)
            loop.stop()
            x, y, z = reader.take()[0]["burr"]["center"][-1, 0]
            assert x == -z  # the server sends (50 cos, 50 sin, 50 cos), RAS
            assert np.hypot(x, y) == pytest.approx(50, abs=1e-4)
            assert tracker.counters["bad_crc"] == 0
        finally:
            loop.stop()
            tracker.stop()
            server.kill()


# pyigtl


@pytest.mark.parametrize("version", [1, 2])
def test_pyigtl_drives_the_burr(pyigtl, version):
    """pyigtl's server sends header version 1, or 2 with metadata. Ticks use the sent poses, rounded once."""
    server = pyigtl.OpenIGTLinkServer(port=free_port(), local_server=True)
    device = _core.IgtlDevice("127.0.0.1", server.port, device_name="burr", lost_after=5000)
    bone, loop, reader = loop_of(device)
    sent = []
    try:
        loop.start()
        assert soon(server.is_connected)
        for i in range(100):
            matrix = np.eye(4)
            matrix[:3, 3] = 0.01 * i, -0.003 * i, 1.5 - 0.002 * i
            message = pyigtl.TransformMessage(matrix, device_name="burr" if i < 90 else "burr_off")
            message.header_version = version
            if version == 2:
                message.metadata = {"Tool": "burr", "Unit": "mm", "Empty": ""}
            sent.append(np.float32(matrix[:3, 3]).astype(float) * [-1, -1, 1])
            server.send_message(message, wait=True)
            time.sleep(0.003)
        assert soon(lambda: device.counters["messages"] == 100)
        time.sleep(0.05)
        loop.stop()
        assert not loop.failed
        records, lost = reader.take()
        assert not lost
        centers = records["burr"]["center"][:, 0]
        assert np.isin(centers, np.array(sent)).all()
        np.testing.assert_array_equal(centers[-1], sent[-1])
        assert len(np.unique(centers[:, 0])) > 50
        on = records["burr"]["on"][:, 0].astype(bool)
        assert on[0]
        assert not on[-1]
        assert bone.removed > 0
    finally:
        loop.stop()
        device.stop()
        server.stop()


@pytest.mark.parametrize("frame", ["", "ToTracker"])
def test_a_haptic_device_behind_plus(pyigtl, tmp_path, frame):
    """Its tools come as PLUS sends them, names cut at 20 bytes. The force on the hand goes back, at last zero."""
    server = pyigtl.OpenIGTLinkServer(port=free_port(), local_server=True)
    bone = VoxelBone.block((6, 6, 4), 0.1, origin=(-2.95, -2.95, -3.95))
    device = IgtlDevice("127.0.0.1", server.port, lost_after=5000, on_button=0)

    def felt():
        return server.wait_for_message("Force" + frame, 5).matrix[:3, 3]

    sent, answers = [], []
    try:
        with Session(
            bone,
            (Burr(1.5), materials["bone"]),
            device,
            seed=1,
            clock=Clock(realtime=False),
            safety=Safety(slew_limit=0.1, stop_button=1),
            record=tmp_path / "t.h5",
        ) as run:
            assert soon(server.is_connected)
            for i in range(61):
                pose, velocity, buttons = np.eye(4), np.eye(4), np.eye(4)
                pose[:3, 3] = 0.002 * i, -0.001 * i, 1.49 - 0.005 * i
                velocity[:3, 3] = 20.0, -10.0, -5.0
                buttons[:3, 0] = i > 10, i == 60, 0
                tools = {"StylusVelocity": velocity, "Buttons": buttons, "Stylus": pose}
                for name, matrix in list(tools.items())[: 2 if i == 60 else 3]:
                    message = pyigtl.TransformMessage(matrix, device_name=(name + frame)[:20])
                    server.send_message(message, wait=True)
                if i < 60:
                    sent.append(np.float32(pose[:3, 3]).astype(float) * (-1, -1, 1))
                    answers.append(felt())
            assert run.wait(10)
        assert (felt() == 0).all()  # the session has ended
    finally:
        server.stop()
    assert run.reason == "a stop button of device 0 was pressed"
    assert (device.counters["messages"], device.counters["other_device"]) == (60, 0)
    trace = load_trace(tmp_path / "t.h5")
    assert np.isin(trace.array("center_mm"), np.array(sent)).all()
    np.testing.assert_array_equal(trace.array("device_velocity_mm_s")[-1], [-20, 10, -5])
    height, on = trace.array("center_mm")[:, 2], trace.array("on").astype(bool)
    assert on[height < sent[10][2]].all()  # button 0 was pressed
    assert not on[height > sent[10][2]].any()
    forces = (trace.array("sent_force_N") * (-1, -1, 1)).astype(np.float32)
    assert np.isin(np.array(answers, np.float32), np.append(forces, 0.0)).all()
    assert np.abs(answers).max() > 0.1


def test_forces_of_other_peers_are_no_poses():
    """A session's own stream holds forces as TRANSFORM; a device that reads any name passes them over.

    Once a Stylus has come, no other tool is the burr: its force would stay where the last zero does not go.
    """
    names = "burr", "ForceTool", "Force", "Force_1", "ForceToTracker", "Stylus_off", "burr", "StylusToTracker"
    with serve([wire.transform(name, (9, 9, 9)) for name in names]) as port:
        device = _core.IgtlDevice("127.0.0.1", port)
        assert soon(lambda: device.counters["other_device"] == 5)
        device.stop()
    assert device.counters["messages"] == 3


def test_a_server_that_does_not_stop_gets_the_last_force():
    """Nor has it read when the session ends: a connection closed on unread bytes is reset, and the zero is lost."""
    stylus = 20 * wire.transform("Stylus_off", (0, 0, 1))
    over, errors, got = threading.Event(), [], b""

    def stream():  # faster than it is read
        try:
            while not over.is_set():
                peer.sendall(stylus)
        except OSError as error:
            errors.append(error)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        device = _core.IgtlDevice("127.0.0.1", listener.getsockname()[1])
        peer, _ = listener.accept()
    _, loop, _ = loop_of(device)
    framer, sender, stopping = (
        wire.Stream(),
        threading.Thread(target=stream),
        threading.Thread(target=loop.stop),
    )
    with peer:
        peer.settimeout(10)
        loop.start()
        felt = False
        while not felt:
            peer.sendall(stylus)
            felt = any(message.value[:3, 3].any() for message in framer.feed(peer.recv(65536)))
        sender.start()
        time.sleep(0.3)
        stopping.start()
        while some := peer.recv(65536):
            got += some
        over.set()
        sender.join()
    stopping.join()
    assert not errors
    assert not framer.feed(got)[-1].value[:3, 3].any()
