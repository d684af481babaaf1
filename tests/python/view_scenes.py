"""Bones, traces, scenes and pictures for tests of the view, and whether this machine draws without a screen."""

import contextlib
import functools
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from session_scenes import make_records, record, small_bone

import burrlab
from burrlab.view import Scene, surgeon_view

SIZE = (320, 240)


def carve(bone, *centers, radius=1.0, ticks=100, seed=1):
    """Bricks (z, y, x) changed by a burr that stands at each of `centers` [mm] for `ticks`."""
    before = bone.density.copy()
    contact = burrlab.BurrContact(bone, burrlab.Burr(radius), burrlab.materials["bone"], seed)
    contact.run(np.repeat(np.array(centers, float), ticks, axis=0), 1.0)
    return np.unique(np.argwhere(bone.density != before) // 8, axis=0)


def cortex_and_nerve(bone, is_nerve):
    """The bone with two tissues, (200, 190, 150) and (240, 220, 20)."""
    table = [
        burrlab.Tissue("cortex", label=1, c_e=2.1, alpha=0.1, colour=(200, 190, 150)),
        burrlab.Tissue("nerve", label=2, c_e=2.1, alpha=0.1, colour=(240, 220, 20), critical=True),
    ]
    bone.set_tissues(burrlab.Tissues(table, burrlab.materials["bone"]), is_nerve.astype(np.uint8))
    return bone


def parcels(count, seed=1):
    """Parcels as the effects give them, around the origin."""
    rng = np.random.default_rng(seed)
    made = np.zeros(
        count, [("position", "f8", 3), ("radius", "f8"), ("dust", "i8"), ("blood", "i8"), ("water", "i8")]
    )
    made["position"], made["radius"] = rng.normal(0, 1, (count, 3)), 0.1
    made["dust"] = 100
    return made


def write_trace(file, ticks=400):
    """Writes a trace; returns the bone's digest at its end."""
    bone = small_bone()
    record(file, make_records(bone, ticks))
    return bone.digest()


@pytest.fixture(name="trace", scope="module")
def recorded_trace(tmp_path_factory):
    """The file of a trace."""
    file = tmp_path_factory.mktemp("trace") / "session.h5"
    write_trace(file)
    return file


def read(path):
    """Pixels of a picture file, (height, width, 3)."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def frames_in(path):
    """Number of pictures in a GIF."""
    with Image.open(path) as film:
        return film.n_frames


_TRY = """
import numpy as np, burrlab
from burrlab.view import Scene
scene = Scene(burrlab.VoxelBone.block((0.8, 0.8, 0.8), 0.1), [], off_screen=True, size=(32, 32))
assert np.ptp(scene.picture()) > 20
"""


@functools.cache
def why_not() -> str | None:
    """Why the machine cannot draw, tried in a separate process, as a failing VTK ends it; None if it can."""
    done = subprocess.run([sys.executable, "-c", _TRY], capture_output=True, text=True, timeout=240)
    if done.returncode == 0:
        return None
    said = done.stderr.strip().splitlines()
    return f"cannot draw without a screen: {said[-1] if said else f'status {done.returncode}'}"


def need_drawing() -> None:
    """Skips a test, with the reason, if drawing does not work."""
    if reason := why_not():
        pytest.skip(reason)


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
