"""A small scene off screen, and a comparison of its pictures."""

import contextlib

import numpy as np
import pytest
from rendering_probe import need_drawing
from session_scenes import small_bone

from burrlab.view import Scene, surgeon_view

SIZE = (320, 240)


@contextlib.contextmanager
def open_scene(bone, radii=(1.0,), *, chart=True, **options):
    """A scene off screen, closed afterwards."""
    need_drawing()
    made = Scene(bone, radii, **{"off_screen": True, "size": SIZE, "chart": chart, **options})
    yield made
    made.close()


@pytest.fixture(name="scene")
def small_scene():
    with open_scene(small_bone(), chart=False) as made:
        made.look(surgeon_view(made.bone, (0, 0, 0), width=8.0, tilt=0.0))
        yield made


def differing(one, other):
    return np.abs(one.astype(int) - other.astype(int)).max(axis=2) > 8
