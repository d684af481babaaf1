"""Real windows on a virtual screen are seen, turned by a mouse, and closed in every way."""

import signal
import subprocess
import sys
import time

import pytest
from view_scenes import differing, recorded_trace  # noqa: F401
from x_screen import Screen, need_screen

pytestmark = pytest.mark.slow
SESSION = ("session", "--device", "hand", "--voxel", "0.4", "--radius", "3", "--seed", "5", "--view")


@pytest.fixture(scope="module")
def screen(tmp_path_factory):
    need_screen()
    with Screen(tmp_path_factory.mktemp("screen")) as made:
        yield made


class Shown:
    """A command with its window."""

    def __init__(self, screen, *arguments):
        self.screen = screen
        self.process = subprocess.Popen(
            [sys.executable, "-m", "burrlab", *map(str, arguments)], env=screen.environment,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        try:
            self.window = screen.window()
            self.wait_for(lambda picture: picture.std() > 10)
        except BaseException as error:
            self.process.kill()
            error.add_note(f"the command said: {self.process.communicate()[0]}")
            raise

    def wait_for(self, condition, seconds=30.0):
        """The first picture of the screen that meets a condition."""
        end = time.monotonic() + seconds
        while not condition(picture := self.screen.picture()):
            assert time.monotonic() < end, "the window does not come to show it"
            time.sleep(0.2)
        return picture

    def close(self, how):
        if how in ("q", "e"):
            self.screen.do("mousemove", 500, 400, "key", how)
        elif how == "cross":
            self.screen.close_window(self.window)
        else:
            self.process.send_signal(getattr(signal, how))

    def end(self, seconds=60):
        """(exit status, output)"""
        try:
            said, _ = self.process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            said, _ = self.process.communicate()
            pytest.fail(f"does not end: {said}")
        return self.process.returncode, said


@pytest.mark.parametrize("how", ["q", "e", "cross", "SIGINT"])
def test_a_view_ends_however_it_is_closed(screen, trace, how):
    shown = Shown(screen, "view", trace)
    shown.close(how)
    assert shown.end() == ((130, "burrlab view: interrupted\n") if how == "SIGINT" else (0, "closed\n"))


@pytest.mark.parametrize("options", [(), ("--stereo",)])
def test_the_mouse_turns_the_bone(screen, trace, options):
    shown = Shown(screen, "view", trace, *options)
    time.sleep(1.0)
    before = screen.picture()
    screen.drag((1000 if options else 500, 400), (150, 60))  # in stereo, over the right eye's picture
    turned = shown.wait_for(lambda picture: differing(picture, before).mean() > 0.02)
    if options:
        half = 768
        left, right = turned[:768, :half], turned[:768, half : 2 * half]
        assert 0.001 < differing(left, right).mean() < 0.5
        assert differing(right, before[:768, half : 2 * half]).mean() > 0.02  # both turned
    shown.close("q")
    assert shown.end() == (0, "closed\n")


@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM"])
def test_a_session_is_reported_when_interrupted(screen, how):
    shown = Shown(screen, *SESSION, "--effects", "--stereo")
    time.sleep(1.0)
    shown.close(how)
    status, said = shown.end()
    assert status == 130
    for words in ("interrupted: ", "effects at assumed rates, seed 5: ", "dust: made "):
        assert words in said


@pytest.mark.parametrize("how", ["q", "cross", None])
def test_a_session_goes_on_without_its_window(screen, how):
    """The session runs to its end, at which an open window closes."""
    shown = Shown(screen, *SESSION, "--effects", "--duration", "8")
    if how is not None:
        shown.close(how)
    status, said = shown.end()
    assert status == 0, said
    assert ("the window is closed, what it showed goes on; Ctrl-C ends that" in said) == (how is not None)
    assert "all ticks were executed: 8000 ticks" in said
    assert "NOT BALANCED" not in said
