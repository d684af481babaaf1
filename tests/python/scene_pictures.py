"""A small scene off screen, and how its pictures differ."""

from __future__ import annotations

import numpy as np
import pytest
from rendering_probe import need_drawing
from session_scenes import small_bone

from burrlab.view.camera import surgeon_view
from burrlab.view.scene import Scene

SIZE = (320, 240)


@pytest.fixture(name="scene")
def small_scene():
    need_drawing()
    made = Scene(small_bone(), [1.0], off_screen=True, size=SIZE, chart=False)
    made.look(surgeon_view(made.bone, (0, 0, 0), width=8.0, tilt=0.0))
    yield made
    made.close()


def differing(one, other):
    return np.abs(one.astype(int) - other.astype(int)).max(axis=2) > 8
