"""A page without a server and without a renderer, for quick tests."""

from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from anatomy_scenes import nerve_bone, straight, tool
from session_scenes import ended, session_of

import burrlab
from burrlab.anatomy.watch import Watch
from burrlab.view.page import Page

PATH = [(-3, 0, 1.5), (-3, 0, -0.6), (3, 0, -0.6), (0, 0, -1.2)], [0, 1, 3, 4]  # into the nerve


def nerve_session(path=PATH, **options) -> burrlab.Session:
    """A session with a watch, on the virtual clock, along a path."""
    bone = nerve_bone()
    settings = {"seed": 1, "duration": float(path[1][-1]), "wall_clock": False, **options}
    return session_of(bone, tool(), straight(*path), watch=Watch(bone, approach=0.5), **settings)


def nerve_trace(file: Path) -> Path:
    """Records 4 s of a cut into a nerve."""
    ended(nerve_session(record=file))
    return file


@pytest.fixture(name="trace", scope="module")
def watched_trace(tmp_path_factory):
    return burrlab.load_trace(nerve_trace(tmp_path_factory.mktemp("page") / "session.h5"))


class State(dict):
    """A state like trame's: attributes, and functions called on changes."""

    def __init__(self):
        super().__init__()
        self.__dict__["calls"] = {}

    __getattr__ = dict.__getitem__
    __setattr__ = dict.__setitem__

    def change(self, name):
        return lambda call: self.calls.setdefault(name, call)

    def tell(self, name, value):
        """Changes a value as a browser would."""
        self[name] = value
        self.calls[name](**self)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


class Server:
    def __init__(self):
        self.state, self.triggers = State(), {}

    def trigger(self, name):
        return lambda call: self.triggers.setdefault(name, call)


def make_scene():
    """A scene that notes its calls and draws grey pictures, with a camera at 50 mm."""
    scene = MagicMock()
    scene.picture.return_value = np.full((8, 8, 3), 128, np.uint8)
    scene.plotter.window_size = [1024, 768]
    view = {
        "position": (0.0, 0.0, 50.0),
        "focal_point": (0.0, 0.0, 0.0),
        "up": (0.0, 1.0, 0.0),
        "view_angle": 30.0,
    }
    scene.plotter.camera.configure_mock(**view)
    return scene


def make_page(source):
    return Page(Server(), source, make_scene())


def turn(page, now=0.0, *, shown=True, wanted=None):
    """Does one turn of the page at a time of the clock; returns the number of the picture."""
    if wanted is not None:
        page.state.tell("wanted_s", wanted)
    page._turn(now)
    if shown:
        page.shown()
    return page.state.picture_number
