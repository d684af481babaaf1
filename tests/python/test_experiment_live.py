"""Experiments with live devices, by a server of poses or a driver in Python: lifted or not, lost or not."""

import contextlib
import re
import socket
import socketserver
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import wire
from pseudo_terminal import _ADOPT, PseudoTerminal
from replica_scenes import free_port
from test_experiment_terminal import SUBJECT, TASK, Subject

import burrlab
from burrlab.psychophysics import Interval, Sitting, Stimulus
from burrlab.psychophysics.interval import Block, render, wait_until_lifted

EXAMPLE = Path(__file__).parents[2] / "examples" / "experiment_driver.py"
BURR, BLOCK = burrlab.Burr(3.0), Block((16, 16, 4), 0.5)
FELT = Interval(Stimulus("bone", burrlab.materials["bone"]), 1, None)


class Poses(socketserver.TCPServer):
    """A server of poses at 200 Hz, at most `most` per client, one client at a time; `z` is height [mm]."""

    z, most, clients, over = 3.5, 10**9, 0, False

    def __init__(self):
        super().__init__(("127.0.0.1", 0), None)
        self.port = self.server_address[1]
        threading.Thread(target=self.serve_forever, args=(0.05,)).start()

    def finish_request(self, peer, address):
        self.clients += 1
        peer.settimeout(0.005)
        sent = 0
        while not self.over:
            with contextlib.suppress(TimeoutError):
                if not peer.recv(1):
                    return
            if sent < self.most:
                peer.sendall(wire.transform("burr", (0.0, 0.0, self.z)))
                sent += 1

    def handle_error(self, peer, address):
        """Ignores clients that disconnect."""

    def __exit__(self, *error):
        self.over = True
        self.shutdown()
        super().__exit__(*error)


class Driver:
    """Puts a height into a mailbox at 1 kHz, and keeps the largest force that comes back."""

    def __init__(self, z):
        self.z, self.most, self.box = z, 0.0, burrlab.MailboxDevice()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._loop)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._over.set()
        self._thread.join()

    def _loop(self):
        while not self._over.wait(0.001):
            self.box.put((0, 0, self.z))
            self.most = max(self.most, float(np.abs(self.box.force).max()))


def test_a_lifted_burr_need_not_wait_and_nobody_is_asked():
    asked, begun = [], time.monotonic()
    with Driver(3.2) as driver:
        found = wait_until_lifted(driver.box, BURR, on_wait=lambda: asked.append(1), stop=lambda: False)
    assert (*found, asked) == (True, "the burr is lifted", [])
    assert 0.1 <= time.monotonic() - begun < 5.0


def test_no_force_and_no_interval_until_the_burr_is_lifted():
    asked = []
    with Driver(1.0) as driver:  # the bone would push with 8 N, the limit, within 9 ms

        def lift():
            asked.append(driver.z)
            threading.Timer(0.2, setattr, (driver, "z", 3.5)).start()

        lifted, _ = wait_until_lifted(driver.box, BURR, on_wait=lift, stop=lambda: False)
        assert driver.z == 3.5
    assert (lifted, asked, driver.most) == (True, [1.0], 0.0)


def test_ctrl_c_in_an_interval_leaves_no_force():
    with Driver(2.5) as driver:

        def interrupt():
            if driver.most > 0.5:
                raise KeyboardInterrupt
            return False

        with pytest.raises(KeyboardInterrupt):
            render(FELT, driver.box, burr=BURR, bone=BLOCK, mode="drilling", stop=interrupt)
        assert not driver.box.force.any()


def test_waiting_ends_when_the_device_is_lost_or_someone_says_so():
    box = burrlab.MailboxDevice(lost_after=50.0)
    box.put((0, 0, 1))
    for device, over, told in (
        (box, False, "device 0 was lost"),
        (burrlab.MailboxDevice(), True, "no more waiting"),
    ):
        lifted, reason = wait_until_lifted(device, BURR, on_wait=lambda: None, stop=lambda over=over: over)
        assert (lifted, told in reason) == (False, True)


def test_poses_over_the_network_lost_then_resumed_and_replayed(tmp_path):
    """Each interval has its own connection; one falls silent, and its trial is asked again."""
    with Poses() as poses:
        more = f'device = "igtl:127.0.0.1:{poses.port}"\ntrace = true\nlost_after_ms = 500'
        subject = Subject(tmp_path, trials=4, interval=0.8, more=more)
        with subject.sit_down() as terminal:
            poses.z = 2.0
            subject.take_part(terminal, stop=lambda kind, trial: kind == "space" and trial == 1)
            terminal.press(" ")
            terminal.wait_for("The interval begins by itself then")
            poses.z = 3.5
            subject.take_part(terminal, stop=lambda *now: now == ("interval", 2))
            poses.most = 20  # and then silence
            assert terminal.end() == 1
            assert terminal.text.endswith("Please wait. Every answer is kept.")
            assert not re.search("device|position|burrlab|test.toml|igtl", terminal.text)
        assert len(subject.rows()) == 1
        poses.most = 10**9
        with subject.sit_down("resume") as terminal:
            subject.take_part(terminal)
            assert terminal.end() == 0
        assert poses.clients >= 2 * 2 * 6 + 1
    assert subject.asked == [1, 2, 3, 4, 5, 6]
    subject.check()
    log = subject.protocol.data.log(SUBJECT, TASK).read_text()
    told = (
        "its last position is 50",  # 500 ms and the loop's delay
        "burrlab experiment resume test.toml --subject 01 goes on",
        "no force goes back over the network",
        "trial 1 waits until the burr is lifted",
    )
    assert [one for one in told if one not in log] == []
    for row in subject.rows():
        for number, felt in enumerate(zip(row.seeds, row.stimuli, strict=True), start=1):
            path = subject.protocol.data.trace(SUBJECT, TASK, row.phase, row.trial, number)
            again = path.with_name(path.name.replace("_trace", "_attempt-2_trace"))
            trace = burrlab.load_trace(again if again.exists() else path)
            assert (trace.seed, trace.tools[0][1].name) == felt
            # a busy machine loses ticks, so their count says nothing of the interval's end
            assert trace.ended in ("all ticks were executed", "the interval is over")
            assert burrlab.replay(trace).equal


def published(port, seconds=10.0):
    """The first force above 0 along z from a port [N]; None after this time [s]."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1) as peer:
            stream = wire.Stream()
            while data := peer.recv(4096):
                for message in stream.feed(data):
                    if message.type == "SENSOR" and message.value[2] > 0:
                        return message.value[2]
    return None


def test_force_is_published_to_whoever_moves_the_burr(tmp_path):
    port = free_port()
    with Poses() as poses:
        more = f'device = "igtl:127.0.0.1:{poses.port}"\npublish = {port}\nlost_after_ms = 1000'
        subject = Subject(tmp_path, trials=4, interval=1.0, more=more)
        with subject.sit_down() as terminal:
            for _ in range(2):  # the port is free again for each interval
                subject.take_part(terminal, stop=lambda kind, trial: kind == "interval")
                poses.z = 2.7
                assert published(port)
                poses.z = 3.5
            terminal.press("\x03")
            assert terminal.end() == 130
    assert "no force goes back" not in subject.protocol.data.log(SUBJECT, TASK).read_text()


@pytest.mark.parametrize(("limit", "ending"), [(100, "device"), (3000, "time")])
def test_lost_after_is_the_device_s(tmp_path, limit, ending):
    """The peer sends only changes."""
    with Poses() as poses:
        protocol = Subject(
            tmp_path, more=f'device = "igtl:127.0.0.1:{poses.port}"\nlost_after_ms = {limit}'
        ).protocol
        assert protocol.to_dict()["experiment"]["lost_after_ms"] == limit
        poses.most = 60
        device, one = Sitting(protocol, SUBJECT)._device("probing"), replace(FELT, duration=1.0)
        assert render(one, device, burr=BURR, bone=protocol.bone, mode="probing").ended == ending


def test_the_example_runs_an_experiment_on_its_driver(tmp_path):
    subject = Subject(tmp_path, trials=4, interval=0.3, more="lost_after_ms = 5000")
    program = _ADOPT + f"import sys, runpy; runpy.run_path({str(EXAMPLE)!r}, run_name='__main__')"
    for stop, status in ((("interval", 4), 130), (None, 0)):
        with PseudoTerminal(subject.config.name, SUBJECT, program=program, cwd=tmp_path) as terminal:
            subject.take_part(terminal, stop=lambda *now, due=stop: now == due)
            if stop is not None:
                terminal.press("\x03")
            assert terminal.end() == status
            subject.screens.append(terminal.text)
    subject.check()
    assert subject.file.with_suffix(".json").read_text().count('"driver"') == 1
