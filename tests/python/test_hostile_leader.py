"""A replica of a leader with forbidden messages gives the connection up, says why, and keeps its bone."""

import contextlib
import json
import socket
import struct
import threading
import time

import numpy as np
import pytest
import wire
from replica_scenes import BLOCK, TOOL, soon

from burrlab import Burr, _core, materials
from burrlab.session.network import follow, make_bone

BONE = make_bone(BLOCK)
DIGEST = BONE.digest().encode()
COUNT = 8 * 10 * 15  # bricks; of 30 x 80 x 120 voxels 4 x 10 x 15


def say(kind, data):
    return wire.byte_string(f"burrlab_{kind}", data)


def hello(version=2, session=5, digest=DIGEST):
    return say("hello", struct.pack(">IQQ32s", version, session, 0, digest) + b"{}")


def tick(index=0, k=1, burrs=1, x=0.0, radius=TOOL["radius_mm"], material=0, on=1, removed=0, last=0):
    values = [index, k, burrs, 0.0, last, x, 0.0, 9.0, radius, material, on, 0.0, 0.0, 0.0, 0.0, removed]
    values += [1.0, 0.0, 0.0, 0.0, 0]  # orientation, buttons
    return wire.numbers("burrlab_tick", np.array(values, dtype=float))


def brick(number, q, p):
    return struct.pack(">I", number) + bytes([q]) * 512 + bytes([p]) * 512


def bricks(total, first, *these, tick=0):
    return say("bricks", struct.pack(">Q32sII", tick, DIGEST, total, first) + b"".join(these))


class FakeLeader:
    """Sends the same to everyone who connects, but only a hello to the first; then waits."""

    def __init__(self, *messages, pause=0.0, first=None):
        self.first = hello() if first is None else first
        self.messages, self.pause, self.sockets = messages, pause, []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.thread = threading.Thread(target=self.run)

    def run(self):
        with contextlib.suppress(OSError):
            while True:
                peer, _ = self.listener.accept()
                self.sockets.append(peer)
                peer.recv(4096)
                for message in self.messages if len(self.sockets) > 1 else [self.first]:
                    peer.sendall(message)
                    time.sleep(self.pause)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.listener.shutdown(socket.SHUT_RDWR)
        self.thread.join()
        for end in (self.listener, *self.sockets):
            end.close()


@contextlib.contextmanager
def following(*messages, pause=0.0):
    with FakeLeader(*messages, pause=pause) as leader:
        replica = _core.Replica("127.0.0.1", leader.port)
        assert replica.fetch_hello(5.0)
        replica.start(make_bone(BLOCK), [(Burr(3.0), materials["bone"])], 1)
        yield replica
        replica.stop()


def test_a_leader_that_behaves():
    with following(hello(), tick(), tick(1), say("digest", struct.pack(">Q32s", 2, DIGEST))) as replica:
        assert soon(lambda: replica.status["digests_equal"] == 1)
        assert (replica.status["tick"], replica.status["faults"]) == (2, 0)


@pytest.mark.parametrize(
    ("messages", "reason"),
    [
        ([tick()], "the hello was lost"),
        ([hello(digest=b"0" * 32)], "the hello is not that of this session"),
        ([hello(version=1)], "the hello is not that of this session"),
        ([hello(), tick(1)], "ticks were lost"),
        ([hello(), tick(), tick()], "ticks were lost"),
        ([hello(), tick(k=9)], "a message could not be read"),
        ([hello(), tick(x=np.nan)], "a message could not be read"),
        ([hello(), tick(x=0.5, index=0.5)], "a message could not be read"),
        ([hello(), tick(burrs=2)], "a message could not be read"),
        ([hello(), tick(radius=2.0)], "a tick is not of these burrs"),
        ([hello(), tick(material=1)], "a tick is not of these burrs"),
        ([hello(), tick(removed=1)], "the bone is not the leader's: another removed of burr 0"),
        ([hello(), tick(), tick(1, last=1)], "a digest was lost"),
        ([hello(), say("digest", struct.pack(">Q32s", 0, b"f" * 32))],
         "the bone is not the leader's: another digest"),
        ([hello(), say("digest", struct.pack(">Q32s", 9, DIGEST))], "ticks were lost"),
        ([hello(), say("digest", b"")], "a message could not be read"),
        ([hello(), say("idle", struct.pack(">Q", 4))], "ticks were lost"),
        ([hello(), say("idle", b"")], "a message could not be read"),
        ([hello(), say("end", struct.pack(">Q32sI", 3, DIGEST, 0))], "ticks were lost"),
        ([hello(), say("end", struct.pack(">Q32sI", 0, DIGEST, 7))], "a message could not be read"),
        ([hello(), say("replica", b"")], "a message came that only replicas send"),
        ([hello(), bricks(2**32 - 1, 0, brick(0, 0, 0))], "bricks were lost"),
        ([hello(), bricks(2, 1, brick(0, 0, 0))], "bricks were lost"),
        ([hello(), bricks(2, 0, brick(0, 0, 0)), tick()], "bricks were lost"),
        ([hello(), bricks(2, 0, brick(3, 0, 0)), bricks(2, 1, brick(3, 0, 0))], "a message could not be read"),
        ([hello(), bricks(1, 0, brick(COUNT, 0, 0))], "a message could not be read"),
        ([hello(), bricks(1, 0, brick(0, 2, 1))], "a message could not be read"),  # q above p
        ([hello(), bricks(2, 0, brick(0, 0, 0)), say("idle", struct.pack(">Q", 0))], "ticks were lost"),
        ([hello(), tick()[:-1] + b"\7"], "a message had to be dropped"),
        ([hello(), b"\xff" * 58], "the framing was lost"),
        ([wire.transform("burr", (1, 2, 3))], "the connection ended, or nothing came for 1 s"),
        ([hello(), tick()], "the connection ended, or nothing came for 1 s"),
        ([wire.transform("burr", (1, 2, 3))] * 200, "no hello came"),
    ],
)  # fmt: skip
def test_reason(messages, reason):
    with following(*messages, pause=0.01) as replica:
        assert soon(lambda: replica.status["faults"] >= 1)
        assert replica.status["last_faults"][0][2] == reason
    assert replica.digest() == DIGEST.decode()


@pytest.mark.parametrize(
    ("message", "state", "reason"),
    [
        (say("bricks", struct.pack(">Q32sII", 0, b"f" * 32, 0, 0)), "failed", "the bone cannot be made equal to the leader's"),
        # text that is no UTF-8: the reason and the other status are still told
        (say("end", struct.pack(">Q32sI", 0, DIGEST, 1) + b"bad \xff end"), "ended", "bad \ufffd end"),
    ],
)  # fmt: skip
def test_what_ends_it(message, state, reason):
    with following(hello(), message) as replica:
        assert replica.wait(10)
        assert (replica.status[state], replica.status["reason"]) == (True, reason)


HELLO = {
    "seed": 1, "rate_Hz": 1000.0, "scheme": "layer", "tools": [TOOL], "source": BLOCK,
}  # fmt: skip
UNREADABLE = "hello of the leader at .* cannot be read"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"[" * 500_000, UNREADABLE),
        (b"\xff\xfe{}", UNREADABLE),
        (b"not JSON", UNREADABLE),
        (b"[]", UNREADABLE),
        *(({**HELLO, "seed": seed}, UNREADABLE) for seed in (2**64, 1.5, None, np.inf, -1)),
        *(({**HELLO, "rate_Hz": rate}, UNREADABLE) for rate in (10**400, 0)),
        ({**HELLO, "tools": "ab"}, UNREADABLE),
        ({**HELLO, "source": [1]}, UNREADABLE),
        ({**HELLO, "source": {**BLOCK, "origin_mm": [0, 0]}}, "recipe must be that of block_recipe"),
        (
            {**HELLO, "source": {**BLOCK, "size_mm": [1e300, 1e-300, 1]}},
            "recipe must have at most 2e\\+08 voxels",
        ),
    ],
)
def test_hello_that_no_leader_says(text, message):
    """Every such hello is refused in one sentence."""
    text = text if isinstance(text, bytes) else json.dumps(text).encode()
    said = say("hello", struct.pack(">IQQ32s", 1, 5, 0, DIGEST) + text)
    with FakeLeader(first=said) as leader, pytest.raises(ValueError, match=message):
        follow("127.0.0.1", leader.port, timeout=5.0)


def test_digest_that_is_none():
    """The digest is refused, as a message would quote it."""
    with FakeLeader(first=hello(digest=b"\xff" * 32)) as leader:
        assert not _core.Replica("127.0.0.1", leader.port).fetch_hello(0.3)
