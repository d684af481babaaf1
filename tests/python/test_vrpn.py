"""VRPN: bytes of the real library, and sessions with scripted peers; bad input. tests/golden/vrpn says what."""

import contextlib
import math
import re
import socket
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import wire
from replica_scenes import BLOCK, Leader, soon
from session_scenes import refused

from burrlab import (
    Burr,
    Clock,
    DeviceFrame,
    Publish,
    ReplayDevice,
    ScriptedDevice,
    Session,
    VrpnDevice,
    _core,
    materials,
    read_vrpn_log,
)
from burrlab.session.network import make_bone

GOLDEN = Path(__file__).parents[1] / "golden/vrpn"
COOKIE = wire.VRPN_COOKIE
TOOL = Burr(3.0), materials["bone"]
POSE, VELOCITY, FORCE = "vrpn_Tracker Pos_Quat", "vrpn_Tracker Velocity", "vrpn_ForceDevice Force"


def message(sender, kind, payload=b"", *, sequence=0, at=(5, 250_000), length=None):
    head = struct.pack(
        ">IIIiiI", 24 + len(payload) if length is None else length, *at, sender, kind, sequence
    )
    return head + payload + bytes(-len(payload) % 8)


def named(number, what, name):
    return message(number, what, struct.pack(">I", len(name) + 1) + name.encode() + b"\0")


def pose(x, y, z, q=(0.0, 0.0, 0.0, 1.0), sensor=0, **options):
    return message(3, 7, struct.pack(">2i7d", sensor, 0, x, y, z, *q), **options)


HELLO_3 = b"".join(
    [
        COOKIE, named(3, -1, "Tracker0"), named(0, -1, "VRPN Control"), named(7, -2, "vrpn_Tracker Pos_Quat"),
        named(8, -2, "vrpn_Tracker Velocity"), named(9, -2, "vrpn_Button Change"),
    ]
)  # fmt: skip


@contextlib.contextmanager
def device(*stream, keep=True, **options):
    """A device whose server says this over TCP; keeps the connection open."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(20)
        one = VrpnDevice(
            "Tracker0", "127.0.0.1", listener.getsockname()[1], tcp=True, lost_after=1e4, **options
        )
        peer, _ = listener.accept()
        with peer:
            peer.sendall(b"".join(stream))
            if not keep:
                peer.shutdown(socket.SHUT_WR)
            yield one, peer
        one.stop()


def test_log_of_the_real_library():
    """Its tables; the messages of a server that was started again have new numbers."""
    log = read_vrpn_log(GOLDEN / "client_in.vrpn")
    told = (
        "6 poses of Tracker0, 6 velocities of Tracker0, 3 forces of Force0, 7 buttons of Tracker0, 9 others"
    )
    assert repr(log) == f"VrpnLog({told})"
    assert log.other == {"vrpn_Analog Channel": 3, "vrpn_Base pong_message": 6}
    assert log.started == 1795454089.817998
    poses, x = log.poses["Tracker0"], 1e3 * (0.001 * np.repeat([0, 1, 2], 2))
    for rows, columns in (
        (poses, {"sensor": [0, 1] * 3, "position": np.column_stack([x, [-2.5, 997.5] * 3, [3.0] * 6]),
                 "orientation": [(0.9, 0.1, -0.3, 0.3)] * 6, "time": np.repeat([0.200259, 0.252723, 0.300708], 2)}),
        (log.velocities["Tracker0"],
         {"velocity": [(10.0, 20.0, -30.0)] * 6, "turn": [(0.8, 0, 0, 0.6)] * 6, "step": [0.001] * 6}),
        (log.forces["Force0"], {"force": [(1.25, -2.5, 0.75 * i) for i in range(3)]}),
        (log.buttons["Tracker0"], {"button": [0, 1, 0, 1, 0, 1, 1], "pressed": [False] * 6 + [True]}),
    ):  # fmt: skip
        for name, column in columns.items():
            np.testing.assert_array_equal(rows[name], column, err_msg=name)
    path = poses[poses["sensor"] == 0]
    device = ScriptedDevice(path["time"], path["position"], None, path["orientation"])
    assert device.duration == pytest.approx(0.300708)


def logged(number, kind, payload=b"", *, at=(5, 250_000), length=None):
    return struct.pack(">2i3Ii", kind, number, *at, len(payload) if length is None else length, 0) + payload


def called(kind, number, name, more=0):
    return logged(number, kind, struct.pack(">I", len(name) + 1 + more) + name.encode() + b"\0")


LOG = (
    COOKIE + called(-1, 3, "T") + called(-2, 7, "vrpn_Tracker Pos_Quat") + called(-2, 9, "vrpn_Button States")
)
LOGGED = struct.pack(">2i7d", 0, 0, 0.001, 0, 0, 0, 0, 0, 1)


def test_a_log_over_two_connections(tmp_path):
    """Numbers are those of the last description; times go back; what has no name is counted or has its number."""
    file = tmp_path / "in.vrpn"
    file.write_bytes(
        LOG + logged(3, 7, LOGGED) + logged(0, -5) + called(-1, 3, "U") + logged(3, 7, LOGGED, at=(4, 999_999))
        + called(-2, 7, "mine") + logged(3, 7, LOGGED) + logged(4, 8) + logged(4, 9, struct.pack(">3i", 2, 0, 1))
    )  # fmt: skip
    log = read_vrpn_log(file)
    assert {name: rows["time"].tolist() for name, rows in log.poses.items()} == {"T": [0.250001], "U": [0.0]}
    assert log.buttons["sender 4"].tolist() == [(0.250001, 0, False), (0.250001, 1, True)]
    assert (log.other, log.started) == ({"mine": 1, "type 8": 1}, 4.999999)
    file.write_bytes(COOKIE.replace(b"38", b"35"))
    with pytest.warns(
        UserWarning, match=r"is read as a log of VRPN 07.38, it begins with b'vrpn: ver. 07.35  0'"
    ):
        assert repr(read_vrpn_log(file)) == "VrpnLog(0 others)"


NOT_WHOLE = " is truncated or damaged: at byte {} stands no whole message"


@pytest.mark.parametrize(
    ("stream", "sentence"),
    [
        (b"", " must be a log of VRPN 07, it holds only b''"),
        (COOKIE[:18], " must be a log of VRPN 07, it holds only b'vrpn: ver. 07.38  '"),
        (COOKIE.replace(b"07", b"06"), " must be a log of VRPN 07, it begins with b'vrpn: ver. 06.38  0'"),
        (b"time_s,x_mm,y_mm,z_mm\n0,0,0,0\n", " must be a log of VRPN 07, it begins with b'time_s,x_mm,y_mm,z_mm\\n0,'"),
        (LOG + bytes(23), NOT_WHOLE),
        (LOG + logged(3, 7, LOGGED)[:-1], NOT_WHOLE),
        (LOG + logged(3, 7, LOGGED, length=2**32 - 1), NOT_WHOLE),
        (LOG + logged(3, 7, LOGGED[:56]), NOT_WHOLE),
        (LOG + logged(3, 9, struct.pack(">2i", 2**29, 1)), NOT_WHOLE),
        (LOG + called(-1, 4, "T", more=1), NOT_WHOLE),
        (LOG + logged(3, 2000), NOT_WHOLE),
        (LOG + logged(3, 7, LOGGED[:56] + struct.pack(">d", math.nan)), ": a message of 'T' is not finite"),
    ],
)  # fmt: skip
def test_logs_that_are_refused(tmp_path, stream, sentence):
    file = tmp_path / "in.vrpn"
    file.write_bytes(stream)
    with pytest.raises(ValueError, match=f"^{re.escape(f'{file}{sentence.format(len(LOG))}')}$"):
        read_vrpn_log(file)


def test_a_session_follows_a_tracker():
    """Position, orientation, velocity, buttons; frames turn them as those of every device."""
    turned = (0.0, 0.0, math.sin(0.3), math.cos(0.3))
    velocity = message(3, 8, struct.pack(">2i8d", 0, 0, 0.01, 0.0, -0.02, 0, 0, 0, 1, 0.001))
    pressed = message(3, 9, struct.pack(">2i", 2, 1))
    far = pose(1.0, 1.0, 1.0, sensor=1)
    old = HELLO_3.replace(b"38", b"35", 1)
    with device(old, velocity, pressed, far, pose(0.001, -0.002, 0.0029, turned), on_button=2) as (
        one,
        peer,
    ):
        server = one.name.removeprefix("vrpn:Tracker0@tcp://")
        note = f"{server} says 'vrpn: ver. 07.35  0', its minor version is not 38"
        with Session(
            make_bone(BLOCK),
            TOOL,
            (one, DeviceFrame(rotation=(math.sqrt(0.5), 0, 0, math.sqrt(0.5)))),
            seed=1,
            clock=Clock(realtime=False),
        ) as session:
            assert soon(lambda: session.ticks > 20)
            newest = session.follower.take(session.follower.view())["newest"]["burr"][0]
            np.testing.assert_allclose(newest["center"], (2.0, 1.0, 2.9), atol=1e-12)
            np.testing.assert_allclose(newest["device_velocity"], (0.0, 10.0, -20.0), atol=1e-12)
            half = math.pi / 4 + 0.3
            np.testing.assert_allclose(
                newest["orientation"], (math.cos(half), 0, 0, math.sin(half)), atol=1e-12
            )
            assert (newest["on"], newest["buttons"]) == (1, 4)
            peer.sendall(message(3, 9, struct.pack(">2i", 2, 0)))
            assert soon(
                lambda: session.follower.take(session.follower.view())["newest"]["burr"][0]["on"] == 0
            )
            assert soon(lambda: note in session.messages)
            assert session.messages.count(note) == 1
        assert one.counters["messages"] == 1


def test_default_handshake_and_udp():
    """The server calls back; a stranger is not heard; poses over UDP, with their losses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        asked.bind(("127.0.0.1", 0))
        asked.settimeout(20)
        one = VrpnDevice("Tracker0", "127.0.0.1", asked.getsockname()[1], lost_after=1e4)
        host, port = asked.recv(200).rstrip(b"\0").decode().split()
        with contextlib.suppress(OSError), socket.socket() as stranger:
            stranger.bind(("127.0.0.2", 0))
            stranger.connect((host, int(port)))
        with socket.create_connection((host, int(port))) as peer:
            hello = peer.recv(64, socket.MSG_WAITALL)
            assert hello[:24] == COOKIE
            udp = struct.unpack_from(">i", hello, 36)[0]
            assert (hello[40:44], hello[48:58]) == (struct.pack(">i", -3), b"127.0.0.1\0")
            peer.sendall(HELLO_3)
            assert soon(lambda: one.connected)
            time.sleep(0.1)
            for number in (10, 11, 14, 13):
                asked.sendto(pose(0.001 * number, 0, 0, sequence=number, at=(5, 1000 * number)), (host, udp))
            assert soon(lambda: one.counters["datagrams"] == 4)
            counters = one.counters
            assert (counters["messages"], counters["lost"]) == (3, 2)
        one.stop()


WRONG = COOKIE.replace(b"07.38", b"06.01")
NOT_FINITE = "a message of 'Tracker0' is not finite"


@pytest.mark.parametrize(
    ("stream", "keep", "sentence", "count"),
    [
        ([WRONG], True, "must be a VRPN server of version 07, it says 'vrpn: ver. 06.01  0'", "bad_version"),
        ([b"HTTP/1.1 400 Bad Request\r\n\r\n"], True, "version 07, it says 'HTTP/1.1 400 Bad Re", "bad_version"),
        ([COOKIE, named(0, -1, "Stylus"), named(1, -1, "Tracker1")], True, "has no sender 'Tracker0', it has Stylus, Tracker1", None),
        ([HELLO_3, pose(0, 0, 0)[:50]], False, " ended within a message", "truncated"),
        ([HELLO_3, message(3, 7, length=12)], True, "sent a message whose length cannot be", "implausible_size"),
        ([HELLO_3, message(3, 7, length=2**31)], True, "sent a message whose length cannot be", "implausible_size"),
        ([HELLO_3, pose(math.nan, 0, 0)], True, NOT_FINITE, "not_finite"),
        ([HELLO_3, pose(0, 0, 0, (0, math.inf, 0, 0))], True, NOT_FINITE, "not_finite"),
        ([HELLO_3, message(3, 7, bytes(56))], True, "", "bad_length"),
        ([HELLO_3, pose(1e6, 0, 0)], True, "", "out_of_range"),
        ([HELLO_3, pose(0, 0, 0), message(3, 8, struct.pack(">2i8d", 0, 0, 1e306, *[0] * 7))], True, "", "out_of_range"),
        ([COOKIE.replace(b"38", b"35"), HELLO_3[24:], message(3, 5), pose(0, 0, 0)], True, "", "messages"),
    ],
)  # fmt: skip
def test_bad_input(stream, keep, sentence, count):
    with device(*stream, keep=keep) as (one, _):
        assert soon(lambda: sentence in one.fault and (count is None or one.counters[count] >= 1))
        assert bool(one.fault) == bool(sentence)


def test_without_a_server():
    one = VrpnDevice("T", "127.0.0.1", 9, tcp=True)
    assert soon(lambda: one.fault == "no server answers at 127.0.0.1:9")
    one.stop()
    session = Session(make_bone(BLOCK), TOOL, one, seed=1, clock=Clock(realtime=False))
    with pytest.raises(ValueError, match=r"vrpn:.* must be new: its connection was closed"):
        session.start()


# The server


CLIENT = b"".join([COOKIE, named(0, -1, "burrlab_burr_0"), named(4, -2, "vrpn_Base ping_message")])


def received(peer, stream, count):
    """Messages until `count` forces have come."""
    messages = []
    while sum(kind == FORCE for kind, _, _ in messages) < count:
        data = peer.recv(4096)
        assert data, "the server closed the connection"
        messages += stream.feed(data)
    return messages


def test_every_tick_over_tcp():
    with Leader(port=None, vrpn=0, burrs=2) as leader:
        publisher = leader.publisher
        with socket.create_connection(("127.0.0.1", publisher.vrpn_port), timeout=10) as peer:
            peer.sendall(CLIENT.replace(b"38", b"37", 1) + message(0, 4))
            messages = received(peer, wire.VrpnStream(), 1000)
        leader.loop.stop()
        every = _core.RecordReader(leader.loop).take()[0]
    assert (publisher.port, publisher.status["dropped"], publisher.status["vrpn_others"]) == (0, {}, 1)
    assert messages[0] == ("cookie", "", COOKIE)
    senders = [name for kind, name, _ in messages if kind == "sender"]
    assert senders == ["burrlab_burr_0", "burrlab_burr_1"]
    assert [name for kind, name, _ in messages if kind == "vrpn_Base pong_message"] == senders[:1]
    records = every["burr"]
    for i, burr in enumerate(senders):
        poses, velocities, forces = (
            np.array([np.frombuffer(payload, ">f8") for kind, sender, payload in messages if (kind, sender) == (wanted, burr)])
            for wanted in (POSE, VELOCITY, FORCE)
        )  # fmt: skip
        first = int(np.flatnonzero((1e-3 * records["center"][:, i] == poses[0, 1:4]).all(1))[0])
        those, poses, velocities = (
            rows[begin : begin + len(forces)]
            for rows, begin in ((records[:, i], first), (poses, 0), (velocities, 0))
        )
        for came, sent in (
            (poses[:, 0], 0.0),  # the sensor's number, and padding
            (poses[:, 1:4], 1e-3 * those["center"]),
            (poses[:, [7, 4, 5, 6]], those["orientation"]),
            (velocities[:, 1:4], 1e-3 * those["device_velocity"]),
            (forces, those["force"]),
        ):
            np.testing.assert_array_equal(came, sent)
        np.testing.assert_allclose(velocities[:, 8], 1e-3 * every["k"][first : first + len(forces)])
        assert np.abs(forces).max() > 0.1


def test_a_client_of_the_real_library_is_called_back():
    """It asks by UDP from one address, whatever address it names, gets poses there, and its pings answered."""
    with (
        Leader(port=None, vrpn=0) as leader,
        socket.create_server(("127.0.0.1", 0)) as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as poses,
    ):
        server = ("127.0.0.1", leader.publisher.vrpn_port)
        poses.bind(("127.0.0.1", 0))
        poses.settimeout(10)
        listener.settimeout(10)
        requests = [b"", b"127.0.0.1", b"127.0.0.1 80\0", b"x" * 300]
        for request in (*requests, b"192.0.2.7 %d\0" % listener.getsockname()[1]):
            poses.sendto(request, server)
        peer, _ = listener.accept()
        with peer:
            peer.settimeout(10)
            request = bytearray((GOLDEN / "client_tcp.bin").read_bytes())
            request[36:40] = struct.pack(">i", poses.getsockname()[1])
            peer.sendall(request)
            stream = wire.VrpnStream()
            kinds = {kind for kind, _, _ in received(peer, stream, 200)}
            packets = [poses.recv(4096) for _ in range(200)]
        assert kinds == {"cookie", "sender", "type", FORCE, "vrpn_Base pong_message"}
        for first, packet in zip(range(0, 400, 2), packets, strict=True):
            assert [kind for kind, _, _ in stream.feed(packet, cookie=False)] == [POSE, VELOCITY]
            assert [struct.unpack_from(">I", packet, at + 20)[0] for at in (0, 88)] == [first, first + 1]
        status = leader.publisher.status
        assert [status[name] for name in ("vrpn_calls", "refused", "dropped", "vrpn_others")] == [1, 4, {}, 0]
        assert status["datagrams"] >= 200


def test_hostile_clients_end_alone():
    with Leader(port=None, vrpn=0, most_peers=8) as leader:
        port = leader.publisher.vrpn_port
        nothing_after = {
            "bad_version": b"GET / HTTP/1.1\r\nHost: me\r\n\r\n",
            "implausible_size": COOKIE + message(0, 0, length=5000),
            "bad_length": COOKIE + named(0, -1, "x" * 150) * 16,
            "out_of_range": COOKIE + message(70000, -3) * 16,
        }
        for reason, words in nothing_after.items():
            with socket.create_connection(("127.0.0.1", port), timeout=10) as peer:
                peer.sendall(words)
                with contextlib.suppress(ConnectionResetError):
                    while peer.recv(65536):
                        pass
            assert soon(lambda reason=reason: leader.publisher.status["dropped"].get(reason, 0) >= 1), reason
        with contextlib.ExitStack() as peers, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
            listener = peers.enter_context(socket.create_server(("127.0.0.1", 0), backlog=100))
            for _ in range(200):  # asks as often as it can
                asker.sendto(b"127.0.0.1 %d\0" % listener.getsockname()[1], ("127.0.0.1", port))
            time.sleep(0.3)  # most of them are never read
            status = leader.publisher.status
            assert status["standard_peers"] <= 8
            assert 1 <= status["vrpn_calls"] <= status["vrpn_calls"] + status["refused"] <= 32
        before = leader.tick
        assert soon(lambda: leader.tick > before + 100)


def test_the_server_never_calls_itself():
    """Sixteen requests that name its own ports, from any address of this machine, take no place."""
    with Leader(vrpn=0) as leader:
        ports = leader.publisher.vrpn_port, leader.port
        for host in ("127.0.0.1", "127.0.0.2"):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
                asker.bind((host, 0))
                for i in range(8):
                    asker.sendto(b"127.0.0.1 %d\0" % ports[i % 2], ("127.0.0.1", ports[0]))
        assert soon(lambda: leader.publisher.status["refused"] == 16)
        assert leader.publisher.status["accepted"] == 0


@pytest.mark.slow
def test_who_does_not_greet_goes():
    """Forty silent connections hold all places for 5 s; one that greeted stays."""
    with Leader(port=None, vrpn=0) as leader, contextlib.ExitStack() as peers:
        client, *_ = [
            peers.enter_context(
                socket.create_connection(("127.0.0.1", leader.publisher.vrpn_port), timeout=20)
            )
            for _ in range(41)
        ]
        client.sendall(CLIENT)
        stream = wire.VrpnStream()
        while leader.publisher.status["stalled"] < 31:
            received(client, stream, 10)
        status = leader.publisher.status
        assert (status["vrpn_peers"], status["refused"]) == (1, 9)
        assert soon(lambda: leader.publisher.status["standard_peers"] == 1)


def test_session_over_vrpn():
    """A session's Tracker drives another session."""
    place = np.tile([0.001, 0.002, 2.9], (4000, 1))
    with Session(
        make_bone(BLOCK),
        TOOL,
        ReplayDevice(place),
        seed=1,
        publish=Publish(vrpn=0),
        clock=Clock(realtime=False),
    ) as session:
        assert session.port is None
        onward = VrpnDevice("burrlab_burr_0", "127.0.0.1", session.vrpn_port, lost_after=1e4)
        with Session(make_bone(BLOCK), TOOL, onward, seed=1, clock=Clock(realtime=False)) as second:
            assert soon(lambda: second.ticks > 100)
            newest = second.follower.take(second.follower.view())["newest"]["burr"][0]
        np.testing.assert_allclose(newest["center"], place[0], rtol=1e-15)
        assert (onward.counters["lost"], onward.note) == (0, "")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        publish = Publish(vrpn=taken.getsockname()[1])
        refused(
            (lambda: Publish(vrpn=70000), r"vrpn must be a whole number from 0 and below 2\^16"),
            (lambda: Session(make_bone(BLOCK), TOOL, ReplayDevice(place), publish=publish), "host and port must be free"),
        )  # fmt: skip
