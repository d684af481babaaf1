"""The page in a real headless Chromium without WebGL, served as by a user."""

import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from chromium import Chromium, chromium_path
from page_scenes import nerve_trace
from view_scenes import need_drawing

import burrlab
from burrlab.session.player import TracePlayer

pytestmark = pytest.mark.slow

_IMAGE = "document.querySelector('.burrlab-view img')"
_SWITCHES = "[...document.querySelectorAll('.v-switch input')].map(input => input.checked)"
_NO_WEBGL = ("--disable-gpu", "--disable-3d-apis")


@pytest.fixture(scope="module", autouse=True)
def needs():
    for name in ("pyvista", "trame"):
        pytest.importorskip(name, reason="needs the extra viz3d")
    if chromium_path() is None:
        pytest.skip("needs a browser: apt-get install chromium")
    need_drawing()


@pytest.fixture(scope="module")
def trace(tmp_path_factory):
    return nerve_trace(tmp_path_factory.mktemp("web") / "session.h5")


class Served:
    """`burrlab ... --web` beside the test, and its address."""

    def __init__(self, *arguments):
        self.process = subprocess.Popen(
            [sys.executable, "-W", "error", "-m", "burrlab", *map(str, arguments), "--web"],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self.said = []
        for line in self.process.stdout:
            self.said.append(line)
            if found := re.search(r"http://127\.0\.0\.1:\d+/\S+/", line):
                self.address = found[0]
                return
        raise AssertionError("".join(self.said))

    def end(self, number=signal.SIGINT):
        """(exit code, output after a signal)"""
        self.process.send_signal(number)
        rest, _ = self.process.communicate(timeout=60)
        return self.process.returncode, rest

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()


@pytest.fixture(scope="module")
def served(trace):
    with Served("view", trace) as server:
        yield server


@pytest.fixture(scope="module")
def page(served, tmp_path_factory):
    with Chromium(tmp_path_factory.mktemp("profile"), *_NO_WEBGL) as browser:
        opened(browser, served.address)
        yield browser


def settled(page):
    """Number of the newest picture, once none has come for a second."""
    last, since = None, time.monotonic()
    while time.monotonic() - since < 1.0:
        now = page.value(f"{_IMAGE}.dataset.number")
        if now != last:
            last, since = now, time.monotonic()
        time.sleep(0.05)
    return int(last)


def opened(page, address):
    page.load(address)
    page.wait(f"{_IMAGE}?.naturalWidth > 0")
    settled(page)


def bone_part(page):
    """The present picture of the bone."""
    x, y, width, height = map(round, page.box(".burrlab-view"))
    return page.screenshot()[y : y + height, x : x + width]


def middle(page):
    x, y, width, height = page.box(".burrlab-view")
    return x + width / 2, y + height / 2


def to_time(page, part):
    """Clicks at a part of the time line; returns the clock's time [s]."""
    x, y, width, height = page.box(".v-slider__container")
    before = page.value("document.querySelector('.burrlab-clock').innerText")
    page.click(x + part * width, y + height / 2)
    page.wait(f"document.querySelector('.burrlab-clock').innerText !== {before!r}")
    settled(page)
    return clock(page)


def press(page, words):
    """Clicks the button with these words."""
    page.value(f"[...document.querySelectorAll('.v-btn')].find(b => b.innerText === {words!r}).click()")


def clock(page):
    return float(page.value("document.querySelector('.burrlab-clock').innerText").split("/")[0])


def numbers(page):
    rows = page.value(
        "[...document.querySelectorAll('.burrlab-side tr')].map(row => [...row.cells].map(cell => "
        "cell.innerText))"
    )
    return {row[0].strip(): row[1] for row in reversed(rows)}  # of a structure, how near it is


def nothing_amiss(page):
    assert [entry for entry in page.console if entry[0] in ("error", "warning", "assert")] == []


def test_orbit_scrub_and_play(page, trace):
    assert not page.value("!!document.createElement('canvas').getContext('webgl')")
    first = bone_part(page)
    assert first.std() > 10
    x, y = middle(page)
    page.drag((x, y), (x + 150, y - 60))
    settled(page)
    assert np.abs(bone_part(page) - first).mean() > 3

    press(page, "SURGEON")
    settled(page)
    player, seen = TracePlayer(burrlab.load_trace(trace)), []
    for part in (0.3, 0.9, 0.3):
        at = to_time(page, part)
        assert at == pytest.approx(part * 4.0, abs=0.05)
        player.seek(at)
        rows = numbers(page)
        assert rows["bone removed"] == f"{player.bone.removed:.2f}"
        assert rows["penetration"] == f"{player.depth[0]:.3f}"
        seen.append(bone_part(page))
    assert np.abs(seen[1] - seen[0]).mean() > 0.3
    assert np.abs(seen[2] - seen[0]).mean() < 0.5

    to_time(page, 0.9)
    page.value("document.querySelector('[aria-label=play]').click()")
    page.wait("document.querySelector('[aria-label=pause]')")
    page.wait("document.querySelector('[aria-label=play]')", 120)  # at the end it stops
    settled(page)
    assert clock(page) == pytest.approx(player.duration, abs=1e-3)
    nothing_amiss(page)


def test_events_slices_wheel_and_presets(page, trace):
    shown = page.value("[...document.querySelectorAll('.burrlab-event')].map(row => row.innerText)")
    assert len(shown) == len(burrlab.load_trace(trace).events) >= 3
    assert "approach to nerve, 0.50 mm" in shown[0]
    page.wait("document.querySelector('.burrlab-side').innerText.includes(\"burr's surface to structure\")")
    page.value("document.querySelector('.burrlab-event').click()")
    settled(page)
    assert clock(page) == pytest.approx(float(re.match(r"[\d.]+", shown[0])[0]), abs=0.02)
    assert float(numbers(page)["nerve"]) == pytest.approx(0.5, abs=0.02)

    last = bone_part(page)
    x, y = middle(page)
    actions = {
        "wheel": lambda: page.mouse("Wheel", x, y, buttons=0, deltaX=0, deltaY=-240),
        "preset": lambda: press(page, "BURR"),
        "slices": lambda: page.value("document.querySelector('.v-switch input').click()"),
    }  # fmt: skip
    for name, action in actions.items():
        number = page.value(f"{_IMAGE}.dataset.number")
        action()
        page.wait(f"{_IMAGE}.dataset.number > {number}")
        settled(page)
        now = bone_part(page)
        assert np.abs(now - last).mean() > 2, name
        last = now
    nothing_amiss(page)


def test_two_browsers_and_a_server_that_ends(page, served, tmp_path):
    with Chromium(tmp_path / "two", *_NO_WEBGL) as other:
        opened(other, served.address)
        at = to_time(other, 0.5)
        assert clock(page) == at  # one page for all browsers
    assert to_time(page, 0.8) > at
    nothing_amiss(page)
    assert served.end(signal.SIGTERM) == (0, "")  # while a browser still shows the page
    assert shutil.which("ps") is None or not children(served.process.pid)


def test_beside_a_session_and_a_replica(tmp_path):
    """Two live pages with effects, one in stereo; Ctrl-C ends each with its page, and the trace is whole."""
    file = tmp_path / "session.h5"
    with Served("session", "--device", "hand", "--effects", "--record", file, "--publish", 0) as session:
        port = re.search(r"published on 127\.0\.0\.1, port (\d+)", "".join(session.said))[1]
        with Served("replica", f"127.0.0.1:{port}", "--effects", "--stereo") as replica:
            with Chromium(tmp_path / "profile", *_NO_WEBGL) as page:
                for server in (session, replica):
                    page.load(server.address)
                    page.wait(f"{_IMAGE}?.naturalWidth > 0")
                    number = int(page.value(f"{_IMAGE}.dataset.number"))
                    page.wait(f"{_IMAGE}.dataset.number > {number + 3}")
                    page.wait("document.querySelectorAll('.burrlab-chart polyline').length === 2")
                    page.wait("!document.querySelector('.burrlab-side').innerText.includes('not known')")
                    assert page.value(_SWITCHES) == [
                        False,
                        server is replica,
                        True,
                    ]  # slices, stereo, effects
                    seen = bone_part(page)
                    assert seen.std() > 10
                    half = seen.shape[1] // 2
                    apart = np.abs(seen[:, :half].astype(int) - seen[:, -half:]).mean()
                    assert (apart < 40) == (server is replica)
                    nothing_amiss(page)
            for server in (replica, session):
                code, rest = server.end()
                assert code == 130, rest
                assert "effects at assumed rates, seed " in rest
            assert not children(session.process.pid) + children(replica.process.pid)
            assert burrlab.load_trace(file).complete


def children(process):
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process)], capture_output=True, text=True)
    return listed.stdout.split()
