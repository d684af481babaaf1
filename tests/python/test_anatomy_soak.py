"""Everything at once for minutes: use of the machine does not grow, results repeat to the bit, all ends well.

The session is watched, recorded and published, with effects and, if the machine can draw, a view. Its
replicas are separate processes, which are stopped and killed on the way.
"""

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from replica_scenes import soon
from soak_process import as_text, effects_like, keep_scene, read_scene
from view_scenes import why_not

import burrlab
from burrlab.effects.effects import Effects, effects_of
from burrlab.session.anatomy import anatomy_report
from burrlab.session.player import TracePlayer

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="what a process uses is read from /proc"),
]
SECONDS = 80.0
SETTLED = 0.3  # part of the run after which nothing may grow


class Process:
    """A process of soak_process.py, with all its output."""

    def __init__(self, *arguments, errors=None):
        program = Path(__file__).with_name("soak_process.py")
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, str(program), *map(str, arguments)], env=environment, stderr=errors,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.said = [json.loads(self.process.stdout.readline())]
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        for line in self.process.stdout:
            if line.endswith("\n"):  # a killed process may not finish its line
                self.said.append(json.loads(line))

    def begin(self):
        self.process.stdin.write("go\n")
        self.process.stdin.flush()

    def column(self, name):
        return np.array([line[name] for line in list(self.said) if name in line])

    def last(self, name):
        values = self.column(name)
        return int(values[-1]) if len(values) else 0

    def status(self, seconds=120.0):
        self.process.wait(seconds)
        self.reader.join(10)
        return self.process.returncode

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.kill()
        self.process.wait()
        self.reader.join(10)
        self.process.stdin.close()
        self.process.stdout.close()


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A file that all processes read."""
    file = tmp_path_factory.mktemp("scene") / "scene"
    keep_scene(file)
    return file


@pytest.fixture(scope="module")
def soak(scene, tmp_path_factory):
    """(folder, leader, replica, killed replica), after a whole session."""
    folder = tmp_path_factory.mktemp("soak")
    with Process("lead", scene, folder, SECONDS, *([] if why_not() else ["draw"])) as leader:
        port = leader.said[0]["port"]
        with Process("follow", scene, port) as replica, Process("follow", scene, port) as victim:
            leader.begin()
            assert soon(lambda: leader.last("ticks") > 10_000, 60)
            replica.process.send_signal(signal.SIGSTOP)
            time.sleep(6)
            replica.process.send_signal(signal.SIGCONT)
            assert soon(lambda: replica.last("tick") > leader.last("ticks") - 2_000, 30), replica.said[-1]
            victim.process.kill()
            assert victim.status() == -signal.SIGKILL
            assert leader.status(SECONDS + 120) == 0, leader.said[-1]
            assert replica.status() == 0
            yield folder, leader, replica, victim


def slope(values):
    """Growth over the settled part: median of its last third minus that of its first."""
    settled = values[int(SETTLED * len(values)) :]
    third = len(settled) // 3
    return float(np.median(settled[-third:]) - np.median(settled[:third]))


def test_nothing_grows(soak, capsys):
    _, leader, replica, victim = soak
    assert len(leader.column("rss")) > SECONDS / 2
    for process in (leader, replica):
        grown = {name: slope(process.column(name)) for name in ("rss", "files", "threads")}
        with capsys.disabled():
            print(
                f"\ngrown in {SECONDS:g} s: {grown}, of {process.last('rss')} MB, {process.last('threads')} "
                "threads"
            )
        assert grown["rss"] < 10.0, grown  # [MB]; the ticks alone are 16 MB in the trace
        assert grown["threads"] <= 0, grown
        assert grown["files"] <= 0, grown
    assert leader.last("ticks") - victim.last("tick") > 10_000, "the victim was killed at the end only"


def test_all_accounts_are_exact_at_the_end(soak):
    _, leader, replica, _ = soak
    end, copy = leader.said[-1], replica.said[-1]
    assert (end["ended"], end["reason"], end["error"]) == ("whole", "all ticks were executed", "")
    assert end["ticks"] == end["seen"] == SECONDS * 1000
    assert end["exact"]
    assert end["dust"] == end["removed"] > 100_000
    assert end["follower"]["differing"] == 0
    assert copy["digest"] == end["digest"]
    assert (copy["digests_different"], copy["differing_ticks"], copy["divergences"]) == (0, 0, [])
    assert copy["ended"]
    assert not copy["failed"]
    if not (end["follower"]["rebuilds"] or copy["by_bricks"]):  # else ticks were passed over
        assert copy["events"] == end["events"]


def test_the_trace_gives_all_of_it_again(scene, soak):
    folder, leader, _, _ = soak
    end = leader.said[-1]
    trace = burrlab.load_trace(folder / "trace.h5")
    assert trace.complete
    again = burrlab.replay(trace)
    assert again.equal, again
    assert again.digests == len(trace.digests) >= SECONDS
    assert again.bone.digest() == end["digest"] == trace.digests[-1][1]
    report = anatomy_report(trace)
    if not end["follower"]["rebuilds"]:
        assert as_text(report.events) == end["events"]
    assert len(report.events) > 10
    made = pickle.loads((folder / "frames").read_bytes())
    player = TracePlayer(trace)
    player.seek_tick(made["first"])
    effects = Effects(player.bone, **effects_like(read_scene(scene)[1]))
    list(effects_of(player, effects, frames=made["frames"]))
    assert (effects.parcels.tobytes(), effects.balance()["dust"].made) == (made["parcels"], end["dust"])


def test_the_view_has_taken_all_of_it(soak):
    """Skipped if nothing can be drawn; the other tests then ran without a view."""
    end = soak[1].said[-1]
    if end["drawn"] is None:
        pytest.skip(why_not())
    assert end["drawn"] == end["digest"]
