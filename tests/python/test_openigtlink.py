"""OpenIGTLink: messages from Python and back, and with Debian's libopenigtlink and pyigtl.

Debian: ``apt-get install libopenigtlink-dev openigtlink-examples``; PyPI: ``pip install pyigtl``.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import burrlab._core as _core
from burrlab import materials
from burrlab._core import Burr, VoxelBone

EXAMPLES = Path("/usr/share/doc/openigtlink-examples/examples")
NEWTON = (0x0B << 54) | (1 << 50)


def soon(condition, seconds=20.0):
    """Whether the condition comes to hold in this time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return condition()


@contextlib.contextmanager
def serve(messages, pause=0.0):
    """A server on the loopback address that sends these to its first client, then closes; gives its port."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(20)

        def run():
            with contextlib.suppress(OSError):
                peer, _ = listener.accept()
                with peer:
                    for message in messages:
                        peer.sendall(message)
                        if pause:
                            time.sleep(pause)
                    peer.shutdown(socket.SHUT_WR)
                    peer.recv(1)

        thread = threading.Thread(target=run)
        thread.start()
        yield listener.getsockname()[1]
    thread.join()


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def random_rotation(random):
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return q.astype(np.float32)


# Messages


def test_checksum_of_the_catalogue():
    assert _core.crc64(b"123456789") == 0x6C40DF5F0B497347


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("piece", [1, 61, 100000])
def test_round_trip(version, piece):
    random = np.random.default_rng(1)
    rotation = random_rotation(random)
    options = {"version": version, "timestamp": 1.7e9 + 0.25}
    if version == 2:
        options |= {"message_id": 7, "metadata": {"unit": "mm", "name": "Bohrer für Knochen", "": ""}}
    array, data = random.normal(size=(3, 4, 5)), random.bytes(70000)
    stream = (
        _core.encode_transform("burr", (1.5, -2.5, 0.1), rotation=rotation, **options)
        + _core.encode_sensor("force", [0.1, np.pi, -3e300], **options)
        + _core.encode_ndarray_float64("tick", array, **options)
        + _core.encode_ndarray_uint8("digest", data, **options)
    )
    framer = _core.MessageFramer()
    got = [m for i in range(0, len(stream), piece) for m in framer.feed(stream[i : i + piece])]
    assert [m.type for m in got] == ["TRANSFORM", "SENSOR", "NDARRAY", "NDARRAY"]
    assert [m.device_name for m in got] == ["burr", "force", "tick", "digest"]
    for message in got:
        assert message.version == version
        assert message.timestamp == options["timestamp"]
        assert message.message_id == options.get("message_id", 0)
        assert message.metadata == options.get("metadata", {})
    transform = np.eye(4, dtype=np.float32)
    transform[:3, :3], transform[:3, 3] = rotation, (1.5, -2.5, 0.1)
    np.testing.assert_array_equal(got[0].value, transform)
    assert got[0].value.dtype == np.float32
    np.testing.assert_array_equal(got[1].value, [0.1, np.pi, -3e300])
    assert (got[0].unit, got[1].unit) == (0, NEWTON)
    np.testing.assert_array_equal(got[2].value, array)
    assert got[3].value == data
    counters = framer.counters
    assert counters.pop("messages") == 4
    assert not any(counters.values())


def test_array_of_many_dimensions_comes_flat():
    body = struct.pack(">BB", 11, 40) + struct.pack(">40H", *[1] * 39, 2) + struct.pack(">2d", 1, 2)
    head = struct.pack(">H12s20sQQQ", 1, b"NDARRAY", b"x", 0, len(body), _core.crc64(body))
    (message,) = _core.MessageFramer().feed(head + body)
    np.testing.assert_array_equal(message.value, [1, 2])


def test_drops_are_counted_and_what_follows_is_read():
    good = _core.encode_transform("burr", (1, 2, 3))
    wrong = bytearray(good)
    wrong[80] ^= 1
    body = struct.pack(">12f", *[0] * 11, np.nan)
    nan = struct.pack(">H12s20sQQQ", 1, b"TRANSFORM", b"\xff\xfe", 0, 48, _core.crc64(body)) + body
    other = struct.pack(">H12s20sQQQ", 1, b"IMAGE", b"x", 0, 100, 0) + bytes(100)
    framer = _core.MessageFramer(200)
    long = _core.encode_sensor("x", [0.0] * 30)
    assert len(framer.feed(bytes(wrong) + nan + other + long + good)) == 1
    counters = {key: value for key, value in framer.counters.items() if value}
    assert counters == {"messages": 1, "bad_crc": 1, "not_finite": 1, "unknown_type": 1, "oversized": 1}
    assert not framer.broken
    assert framer.feed(bytes(58)) == []
    assert framer.broken
    assert framer.feed(good) == []
    framer.restart()
    assert len(framer.feed(good)) == 1
    assert framer.counters["bad_version"] == 1


def test_refusals():
    transform = _core.encode_transform
    with pytest.raises(ValueError, match="version must be 1 or 2, got 3"):
        transform("x", (0, 0, 0), version=3)
    with pytest.raises(ValueError, match="length of device_name must be at most 20, got 21"):
        transform("x" * 21, (0, 0, 0))
    with pytest.raises(ValueError, match="every number of position must be finite, got nan"):
        transform("x", (0, np.nan, 0))
    with pytest.raises(ValueError, match=r"timestamp must be 0 to 2\^32 s, got -1"):
        transform("x", (0, 0, 0), timestamp=-1)
    with pytest.raises(ValueError, match="version must be 2 for a message with metadata, got 1"):
        transform("x", (0, 0, 0), metadata={"a": "b"})
    with pytest.raises(ValueError, match="number of values must be at most 255, got 256"):
        _core.encode_sensor("x", [0.0] * 256)
    with pytest.raises(ValueError, match="every side of values must be at most 65535, got 65536"):
        _core.encode_ndarray_float64("x", np.zeros(65536))
    with pytest.raises(ValueError, match="number of dimensions must be 1 to 255, got 0"):
        _core.encode_ndarray_float64("x", np.float64(1))
    with pytest.raises(ValueError, match="length of device_name must be at most 20, got 21"):
        _core.encode_ndarray_uint8("x" * 21, b"")
    with pytest.raises(ValueError, match="largest_body must be at least 48 bytes, got 47"):
        _core.MessageFramer(47)
    with pytest.raises(ValueError, match="largest_body must be below 4 GiB, got 4294967296"):
        _core.MessageFramer(1 << 32)
    for reader in (_core.TransformReader, _core.IgtlDevice):
        with pytest.raises(ValueError, match="port must be 1 to 65535, got 0"):
            reader("127.0.0.1", 0)
        with pytest.raises(
            ValueError, match="host must be a name or an address that can be looked up, got '256"
        ):
            reader("256.1.1.1.", 1)
        with pytest.raises(ValueError, match="length of device_name must be at most 20 bytes, got 21"):
            reader("127.0.0.1", 1, device_name="x" * 21)
    with pytest.raises(ValueError, match="lost_after must be positive and finite, got 0"):
        _core.IgtlDevice("127.0.0.1", 1, lost_after=0)


# Debian's libopenigtlink


def test_libopenigtlink_decodes_all(build):
    """1000 of 1000 TRANSFORM and 1000 of 1000 SENSOR messages, to the last bit."""
    program = build(Path(__file__).with_name("openigtlink_peer.cpp"))
    random = np.random.default_rng(2)
    poses = random.normal(scale=50, size=(1000, 3)).astype(np.float32)
    rotations = [random_rotation(random) for _ in poses]
    forces = random.normal(size=(1000, 3))
    messages = []
    for i, (pose, rotation, force) in enumerate(zip(poses, rotations, forces, strict=True)):
        messages.append(_core.encode_transform("burr", pose, rotation=rotation, timestamp=1.7e9 + i / 64))
        messages.append(_core.encode_sensor("burr force", force, timestamp=1.7e9 + i / 64))
    with serve(messages) as port:
        out = subprocess.run([program, "127.0.0.1", str(port)], check=True, capture_output=True, timeout=60)
    lines = [line.split() for line in out.stdout.decode().splitlines()]
    transforms = [line for line in lines if line[0] == "TRANSFORM"]
    sensors = [line for line in lines if line[0] == "SENSOR"]
    assert (len(transforms), len(sensors)) == (1000, 1000)
    for i in range(1000):
        matrix = np.array(transforms[i][3:], dtype=np.float32).reshape(3, 4)
        np.testing.assert_array_equal(matrix[:, 3], poses[i])
        np.testing.assert_array_equal(matrix[:, :3], rotations[i])
        assert transforms[i][1] == "burr"
        assert float(transforms[i][2]) == pytest.approx(1.7e9 + i / 64, abs=2e-6)
        assert sensors[i][1:3] == ["burr", "force"]
        assert sensors[i][4:6] == ["0", "11^1"]  # newton
        np.testing.assert_array_equal(np.array(sensors[i][6:], dtype=float), forces[i])


def test_example_client_receives_all(build):
    """Debian's ReceiveClient checks the checksum before it prints a matrix."""
    program = build(EXAMPLES / "Receiver" / "ReceiveClient.cxx")
    messages = [_core.encode_transform("burr", (i, 0.5, -i)) for i in range(1000)]
    messages[500:500] = [_core.encode_sensor("force", [1.0])] * 1000
    with serve(messages) as port:
        out = subprocess.run([program, "127.0.0.1", str(port)], check=True, capture_output=True, timeout=60)
    text = out.stderr.decode()
    assert text.count("Receiving TRANSFORM data type.") == 1000
    assert text.count("Receiving : SENSOR") == 1000
    rows = out.stdout.decode().splitlines()
    assert [row for row in rows if row.startswith("1, 0, 0, ")] == [f"1, 0, 0, {i}" for i in range(1000)]
    assert rows.count("0, 1, 0, 0.5") == 1000


def test_example_server_drives_the_reader(build):
    """Debian's TrackerServer sends 100 poses, then closes: the reader connects anew."""
    port = free_port()
    program = build(EXAMPLES / "Tracker" / "TrackerServer.cxx")
    with subprocess.Popen([program, str(port), "200"], stdout=subprocess.DEVNULL) as server:
        try:
            reader = _core.TransformReader("127.0.0.1", port, device_name="Tracker")
            assert soon(lambda: reader.counters["messages"] >= 100 and reader.counters["connections"] >= 2)
            pose = reader.newest()
            x, y, z = pose.position
            assert x == -z  # it sends (50 cos, 50 sin, 50 cos), RAS
            assert np.hypot(x, y) == pytest.approx(50, abs=1e-4)
            assert pose.on
            assert reader.counters["bad_crc"] == 0
            reader.stop()
        finally:
            server.kill()


# pyigtl


def test_pyigtl_reads_poses(pyigtl):
    messages = [_core.encode_transform("burr", (i, 0.1, -i), timestamp=1.7e9) for i in range(1000)]
    messages.insert(1, _core.encode_transform("second", (7, 8, 9), version=2, metadata={"a": "b"}))
    with serve(messages) as port:
        client = pyigtl.OpenIGTLinkClient("127.0.0.1", port)
        try:
            last = []

            def newest_is_last():
                last.extend(m for m in client.get_latest_messages())
                return any(m.device_name == "burr" and m.matrix[0, 3] == 999 for m in last)

            assert soon(newest_is_last)
            burr = [m for m in last if m.device_name == "burr"][-1]
            np.testing.assert_array_equal(burr.matrix[:3, 3], np.float32([999, 0.1, -999]))
            np.testing.assert_array_equal(burr.matrix[:3, :3], np.eye(3))
            assert burr.timestamp == 1.7e9
            second = next(m for m in last if m.device_name == "second")
            assert second.metadata == {"a": "b"}
        finally:
            client.stop()


@pytest.mark.parametrize("version", [1, 2])
def test_pyigtl_drives_the_burr(pyigtl, version):
    """Its server, header version 1, or 2 with metadata: the ticks use what was sent, rounded once."""
    server = pyigtl.OpenIGTLinkServer(port=free_port(), local_server=True)
    bone = VoxelBone.block((6, 6, 4), 0.1, origin=(-2.95, -2.95, -3.95))
    device = _core.IgtlDevice("127.0.0.1", server.port, device_name="burr", lost_after=5000)
    executor = _core.TickExecutor(bone, [(Burr(1.5), materials["bone"])], seed=1)
    loop = _core.HapticLoop(executor, [device], realtime=False)
    reader = _core.RecordReader(loop)
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
