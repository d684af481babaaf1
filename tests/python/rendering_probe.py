"""Whether this machine draws without a screen, tried in a separate process, as a failing VTK ends it."""

import functools
import subprocess
import sys

import pytest

_TRY = """
import numpy as np, burrlab
from burrlab.view import Scene
scene = Scene(burrlab.VoxelBone.block((0.8, 0.8, 0.8), 0.1), [], off_screen=True, size=(32, 32))
assert np.ptp(scene.picture()) > 20
"""


@functools.cache
def why_not() -> str | None:
    """Why the machine cannot draw; None if it can."""
    done = subprocess.run([sys.executable, "-c", _TRY], capture_output=True, text=True, timeout=240)
    if done.returncode == 0:
        return None
    said = done.stderr.strip().splitlines()
    return f"cannot draw without a screen: {said[-1] if said else f'status {done.returncode}'}"


def need_drawing() -> None:
    """Skips a test, with the reason, if drawing does not work."""
    reason = why_not()
    if reason is not None:
        pytest.skip(reason)
