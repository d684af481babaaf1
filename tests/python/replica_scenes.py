"""A published session on the loopback address, its replicas, and proxies between them."""

import contextlib
import json
import os
import socket
import socketserver
import struct
import subprocess
import sys
import threading
import time
from dataclasses import fields

import wire

from burrlab import Burr, Clock, HandDevice, Publish, Session, StartingBone, _core, materials
from burrlab.session.network import block_recipe, make_bone, open_publisher

VOXEL = 0.2
BLOCK = block_recipe((24, 16, 6), VOXEL, origin=(VOXEL / 2 - 12, VOXEL / 2 - 8, VOXEL / 2 - 6))
TOOL = {
    "radius_mm": 3.0, "material": "bone", "c_e_N_per_mm2": 2.145, "alpha_per_ms": 0.087, "shape": "parabolic",
}  # fmt: skip


def soon(condition, seconds=20.0):
    """Whether the condition becomes true within `seconds`."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return bool(condition())


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def published(seconds):
    """A session on a small block that a hand cuts, on a free port."""
    source = block_recipe((8, 8, 4), 0.2, origin=(-3.9, -3.9, -3.9))
    return Session(
        StartingBone(make_bone(source), source=source), (Burr(2.0), materials["bone"]),
        HandDevice((0.0, 0.0, 2.2), strokes_after=0.0), seed=11, duration=seconds, publish=0, clock=Clock(realtime=False),
    )  # fmt: skip


class Leader:
    """One or two hands that cut a block at 1 kHz, published on a free port."""

    def __init__(
        self, *, burrs=1, digest_every=100, source=BLOCK, seed=7, wall_clock=True, ticks=0, **options
    ):
        self.hello = {
            "seed": seed,
            "rate_Hz": 1000.0,
            "scheme": "layer",
            "tools": [TOOL] * burrs,
            "source": source,
        }
        self.tools = [(Burr(3.0), materials["bone"])] * burrs
        self.executor = _core.TickExecutor(make_bone(BLOCK), self.tools, seed)
        devices = [HandDevice(start=(0.0, 2.5 * i, 3.3), strokes_after=0.0) for i in range(burrs)]
        # On a busy machine threads may wait for seconds, in a frozen one for more. The tests check content, not times.
        self.loop = _core.HapticLoop(
            self.executor, devices, wall_clock=wall_clock, ticks=ticks, stall_limit=60_000.0
        )
        self.follower = _core.Follower(self.loop, digest_every=digest_every, rebuild_after=60.0)
        names = {field.name for field in fields(Publish)} & options.keys()
        publish = Publish(**{"port": 0} | {name: options.pop(name) for name in names})
        self.publisher = open_publisher(self.follower, self.hello, publish, **options)

    @property
    def port(self):
        return self.publisher.port

    @property
    def tick(self):
        return self.follower.status["tick"]

    def __enter__(self):
        self.loop.start()
        self.follower.start()
        return self

    def end(self, reason="done", linger=20.0):
        self.loop.stop()
        self.follower.stop()
        self.publisher.finish(reason, linger=linger)

    def __exit__(self, *_):
        self.loop.stop()
        self.follower.stop()
        self.publisher.stop()

    def run_to(self, tick):
        assert soon(lambda: self.tick >= tick, 60.0), f"the session does not reach tick {tick}"

    @property
    def digest(self):
        return self.follower.digest()


class Proxy(socketserver.ThreadingTCPServer):
    """Passes bytes between replicas and a leader; `pump(source, sink)` passes the leader's."""

    def __init__(self, port, pump, *, receive_buffer=None):
        super().__init__(("127.0.0.1", 0), None)
        self.port_behind, self.pump, self.receive_buffer = port, pump, receive_buffer
        self.port, self.sockets = self.server_address[1], []

    def __enter__(self):
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_):
        self.shutdown()
        end_both(self.sockets)
        self.server_close()

    def finish_request(self, replica, _):
        with socket.socket() as leader, contextlib.suppress(OSError):
            self.sockets += [replica, leader]
            for end in (replica, leader):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if self.receive_buffer:
                leader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self.receive_buffer)
            leader.connect(("127.0.0.1", self.port_behind))
            back = threading.Thread(target=pass_on, args=(pass_all, replica, leader), daemon=True)
            back.start()
            pass_on(self.pump, leader, replica)
            back.join()


def end_both(sockets):
    for end in sockets:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


def pass_on(pump, source, sink):
    """Passes bytes on until either end closes, then closes both."""
    with contextlib.suppress(OSError):
        pump(source, sink)
    end_both([source, sink])


def pass_all(source, sink):
    while data := source.recv(65536):
        sink.sendall(data)


def receive_exactly(source, size):
    data = source.recv(size, socket.MSG_WAITALL)
    if len(data) < size:
        raise ConnectionError("ended")
    return data


def messages_of(source):
    """Yields the whole messages of a stream."""
    while True:
        header = receive_exactly(source, 58)
        yield header + receive_exactly(source, struct.unpack_from(">Q", header, 42)[0])


def name_of(message):
    return message[14:34].rstrip(b"\0").decode()


def dropper(source, sink, *, probability, random):
    """Drops whole messages, each with the same probability."""
    for message in messages_of(source):
        if random.random() >= probability:
            sink.sendall(message)


class TickEditor:
    """Changes the numbers of the first tick that `change` returns True for (docs/wire.md)."""

    def __init__(self, change):
        self.change = change

    def __call__(self, source, sink):
        for message in messages_of(source):
            if self.change and name_of(message) == "burrlab_tick":
                numbers = wire.decoded(message).value.copy()
                if self.change(numbers):
                    self.change, message = None, wire.numbers("burrlab_tick", numbers)
            sink.sendall(message)


def cutter(source, sink):
    """Cuts the stream in the middle of a message after a second."""
    end = time.monotonic() + 1.0
    for message in messages_of(source):
        if time.monotonic() >= end:
            sink.sendall(message[: len(message) // 2])
            return
        sink.sendall(message)


def mangler(source, sink):
    """Drops some bytes of every 200 000, so that the framing is lost."""
    passed = 0
    while data := source.recv(4096):
        passed += len(data)
        if passed > 200_000:
            passed -= 200_000
            data = data[: len(data) // 2] + data[len(data) // 2 + 100 :]
        sink.sendall(data)


class Slower:
    """Passes `rate` bytes a second."""

    def __init__(self, rate):
        self.rate = rate

    def __call__(self, source, sink):
        while data := source.recv(2048):
            sink.sendall(data)
            time.sleep(len(data) / self.rate)


_REPLICA = """
import json, sys, time
from burrlab.session.network import follow
replica = follow("127.0.0.1", int(sys.argv[1]))
while not replica.status["connected"]:
    time.sleep(0.002)
print("following", flush=True)
ended = replica.wait(float(sys.argv[2]))
replica.stop()
print(json.dumps({"waited": ended, "digest": replica.digest(), **replica.status}))
"""


class ReplicaProcess:
    """A replica in a separate process."""

    def __init__(self, port, seconds=90.0, cpu_path=None):
        environment = dict(os.environ) if cpu_path is None else {**os.environ, "BURRLAB_CPU_PATH": cpu_path}
        self.process = subprocess.Popen(
            [sys.executable, "-c", _REPLICA, str(port), str(seconds)],
            stdout=subprocess.PIPE, text=True, env=environment,
        )  # fmt: skip
        assert self.process.stdout.readline() == "following\n"

    def kill(self):
        self.process.kill()
        self.process.communicate()

    def result(self):
        # Longer than the replica's own timeout, which gives a reason.
        return json.loads(self.process.communicate(timeout=120)[0])
