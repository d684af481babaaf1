"""Experiments on devices that are in a hand: a server of poses, a driver in Python, lifted or not, lost or not."""

from __future__ import annotations

import contextlib
import runpy
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from pseudo_terminal import _ADOPT, PseudoTerminal
from test_experiment_terminal import SUBJECT, TASK, Subject

import burrlab
import burrlab._core as _core
from burrlab.psychophysics.interval import wait_until_lifted
from burrlab.psychophysics.protocol import Protocol
from burrlab.psychophysics.run import Sitting

EXAMPLE = Path(__file__).parents[2] / "examples" / "experiment_driver.py"
BURR = burrlab.Burr(3.0)


class Poses:
    """A server of poses, at 200 Hz, to one client after the other; `z` is the burr's height [mm]. Each gets `most`."""

    def __init__(self):
        self.z, self.most, self.clients = 3.5, 10**9, 0
        self._over = threading.Event()

    def __enter__(self):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.05)
        self.port = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._over.set()
        self._thread.join()
        self._listener.close()

    def _serve(self):
        while not self._over.is_set():
            with contextlib.suppress(OSError):
                peer, _ = self._listener.accept()
                self.clients += 1
                with peer:
                    sent = 0
                    peer.settimeout(0.005)
                    while not self._over.is_set():
                        with contextlib.suppress(TimeoutError):
                            if not peer.recv(1):
                                break
                        if sent < self.most:
                            peer.sendall(_core.encode_transform("burr", (0.0, 0.0, self.z)))
                            sent += 1


class Driver:
    """Puts a height into a mailbox at 1 kHz and keeps the largest force that came back."""

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


def after(seconds, do):
    timer = threading.Timer(seconds, do)
    timer.start()
    return timer


def test_a_lifted_burr_need_not_wait_and_nobody_is_asked():
    asked = []
    with Driver(3.2) as driver:
        begun = time.monotonic()
        lifted, reason = wait_until_lifted(
            driver.box, BURR, on_wait=lambda: asked.append(1), stop=lambda: False
        )
    assert (lifted, reason, asked) == (True, "the burr is lifted", [])
    assert 0.1 <= time.monotonic() - begun < 5.0


def test_no_force_and_no_interval_until_the_burr_is_lifted():
    asked = []
    with Driver(1.0) as driver:  # the bone would push with 8 N, the limit, within 9 ms

        def lift():
            driver.z = 3.5

        lifted, _ = wait_until_lifted(
            driver.box, BURR, on_wait=lambda: asked.append(after(0.2, lift)), stop=lambda: False
        )
        assert driver.z == 3.5
    assert (lifted, len(asked), driver.most) == (True, 1, 0.0)


def test_ctrl_c_in_an_interval_leaves_no_force():
    with Driver(2.5) as driver:

        def interrupt():
            if driver.most > 0.5:
                raise KeyboardInterrupt
            return False

        with pytest.raises(KeyboardInterrupt):
            burrlab.psychophysics.render(
                burrlab.psychophysics.Interval(
                    burrlab.psychophysics.Stimulus("bone", burrlab.materials["bone"]), 1, None
                ), driver.box, burr=BURR, bone=burrlab.psychophysics.Block((16, 16, 4), 0.5), mode="drilling",
                stop=interrupt,
            )  # fmt: skip
        driver.most = 0.0
        assert not driver.box.force.any()


def test_waiting_ends_when_the_device_is_lost_or_someone_says_so():
    box = burrlab.MailboxDevice(lost_after=50.0)
    box.put((0, 0, 1))
    lifted, reason = wait_until_lifted(box, BURR, on_wait=lambda: None, stop=lambda: False)
    assert not lifted
    assert "device 0 was lost" in reason
    lifted, reason = wait_until_lifted(burrlab.MailboxDevice(), BURR, on_wait=lambda: None, stop=lambda: True)
    assert (lifted, reason) == (False, "no more waiting")


def test_poses_over_the_network_lost_then_resumed_and_replayed(tmp_path):
    """Each interval has a connection of its own; the third falls silent and its trial is asked again."""
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
            for word in ("device", "position", "burrlab", "test.toml", "igtl"):
                assert word not in terminal.text
            subject.leave(terminal)
        assert len(subject.rows()) == 1
        poses.most = 10**9
        with subject.sit_down("resume") as terminal:
            subject.take_part(terminal)
            assert terminal.end() == 0
            subject.leave(terminal)
        assert poses.clients >= 2 * 2 * 6 + 1
    assert subject.asked == [1, 2, 3, 4, 5, 6]
    subject.check()
    log = subject.protocol.data.log(SUBJECT, TASK).read_text()
    assert "its last position is 50" in log  # 500 ms and what the loop takes to see it
    assert "burrlab experiment resume test.toml --subject 01 goes on" in log
    assert "no force goes back over the network" in log
    assert "trial 1 waits until the burr is lifted" in log
    for row in subject.rows():
        for number, (seed, stimulus) in enumerate(zip(row.seeds, row.stimuli, strict=True), start=1):
            path = subject.protocol.data.trace(SUBJECT, TASK, row.phase, row.trial, number)
            again = path.with_name(path.name.replace("_trace", "_attempt-2_trace"))
            trace = burrlab.load_trace(again if again.exists() else path)
            assert (trace.seed, trace.tools[0][1].name) == (seed, stimulus)
            assert len(trace) >= 700
            assert burrlab.replay(trace).equal


def test_force_is_published_to_whoever_moves_the_burr(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with Poses() as poses:
        more = f'device = "igtl:127.0.0.1:{poses.port}"\npublish = {port}\nlost_after_ms = 1000'
        subject = Subject(tmp_path, trials=4, interval=1.0, more=more)
        with subject.sit_down() as terminal:
            for interval in (1, 2):  # the port is free again for each
                subject.take_part(terminal, stop=lambda kind, trial: kind == "interval")
                framer, end, forces = _core.MessageFramer(), time.monotonic() + 10.0, []
                while not forces and time.monotonic() < end:
                    poses.z = 2.7
                    with (
                        contextlib.suppress(OSError),
                        socket.create_connection(("127.0.0.1", port), 1) as peer,
                    ):
                        peer.settimeout(1)
                        while not forces and (got := peer.recv(4096)):
                            found = [m for m in framer.feed(got) if m.type == "SENSOR"]
                            forces = [m.value[2] for m in found if m.value[2] > 0]
                assert forces, interval
                poses.z = 3.5
            terminal.press("\x03")
            assert terminal.end() == 130
    assert "no force goes back" not in subject.protocol.data.log(SUBJECT, TASK).read_text()


def test_lost_after_is_the_device_s(tmp_path):
    """A peer that sends what changes only."""
    with Poses() as poses:
        for limit, ending in ((100, "device"), (3000, "time")):
            folder = tmp_path / str(limit)
            folder.mkdir()
            more = f'device = "igtl:127.0.0.1:{poses.port}"\nlost_after_ms = {limit}'
            protocol = Protocol.read(Subject(folder, more=more).config)
            assert protocol.to_dict()["experiment"]["lost_after_ms"] == limit
            device = Sitting(protocol, SUBJECT)._device("probing")
            poses.most = 60
            found = burrlab.psychophysics.render(
                burrlab.psychophysics.Interval(
                    burrlab.psychophysics.Stimulus("bone", burrlab.materials["bone"]), 1, 1.0
                ), device, burr=BURR, bone=protocol.bone, mode="probing",
            )  # fmt: skip
            assert found.ended == ending


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("lost_after_ms = 0", "lost_after_ms must be positive, got 0.0"),
        ("publish = 70000", "publish must be a port, 1 to 65535, got 70000"),
        ("publish = true", "publish must be a port, 1 to 65535, got True"),
    ],
)
def test_refusals(tmp_path, line, sentence):
    with pytest.raises(ValueError, match=rf"\[experiment\].*{sentence}"):
        Subject(tmp_path, more=line)


def test_the_example_runs_an_experiment_on_its_driver(tmp_path):
    subject = Subject(tmp_path, trials=4, interval=0.3, more="lost_after_ms = 5000")
    program = _ADOPT + f"import sys, runpy; runpy.run_path({str(EXAMPLE)!r}, run_name='__main__')"
    for stop, status in ((("interval", 4), 130), (None, 0)):
        arguments = (subject.config.name, SUBJECT)
        with PseudoTerminal(*arguments, program=program, cwd=tmp_path) as terminal:
            subject.take_part(terminal, stop=lambda *now, due=stop: now == due)
            if stop is not None:
                terminal.press("\x03")
            assert terminal.end() == status
            subject.leave(terminal)
    subject.check()
    assert (
        subject.protocol.data.answers(SUBJECT, TASK).with_suffix(".json").read_text().count('"driver"') == 1
    )


def test_the_example_s_driver_feels_a_force_in_an_interval_only():
    example = runpy.run_path(str(EXAMPLE))
    hardware, box = example["Hardware"](3.0), burrlab.MailboxDevice()
    with example["driven"](hardware, box, True):
        time.sleep(0.05)
        assert not hardware.force.any()
        burrlab.psychophysics.render(
            burrlab.psychophysics.Interval(
                burrlab.psychophysics.Stimulus("bone", burrlab.materials["bone"]), 1, None
            ), box, burr=BURR, bone=burrlab.psychophysics.Block((16, 16, 4), 0.5), mode="probing",
            stop=lambda: hardware.force[2] > 0.1,
        )  # fmt: skip
        time.sleep(0.05)
        assert not hardware.force.any()


def test_a_run_goes_on_at_another_port_and_limit_but_not_without_the_force(tmp_path):
    subject = Subject(tmp_path, more="publish = 18945")
    file, _ = subject.protocol.begin(SUBJECT, TASK)
    file.close()
    again = Subject(tmp_path, more="publish = 18946\nlost_after_ms = 200").protocol
    again.resume(SUBJECT, TASK)[0].close()
    with pytest.raises(ValueError, match="force is published was True, is now False"):
        Subject(tmp_path).protocol.resume(SUBJECT, TASK)
