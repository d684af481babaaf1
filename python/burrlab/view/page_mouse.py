"""The mouse on a picture that the server draws: turning, moving and zooming of a camera."""

from __future__ import annotations

from typing import Any

import numpy as np

_TURN = 200.0  # across the picture [degree]
_ZOOM = 1.15  # a step of the wheel


def turn(camera: Any, right: float, up: float) -> None:
    """Around the focus, as if the bone were dragged.

    Parameters
    ----------
    camera : pyvista.Camera
    right, up : float
        Way of the mouse, in parts of the picture's height.
    """
    camera.Azimuth(-_TURN * right)
    camera.Elevation(-_TURN * up)
    camera.OrthogonalizeViewUp()


def move(camera: Any, right: float, up: float) -> None:
    """Across the line of sight; what is at the focus follows the mouse. Parameters as for `turn`."""
    position, focus = np.array(camera.position), np.array(camera.focal_point)
    sight = focus - position
    distance = float(np.linalg.norm(sight))
    upwards = np.array(camera.up) / np.linalg.norm(camera.up)
    rightwards = np.cross(sight / distance, upwards)
    height = 2.0 * distance * np.tan(np.deg2rad(camera.view_angle) / 2)
    by = -height * (right * rightwards + up * upwards)
    camera.position, camera.focal_point = tuple(position + by), tuple(focus + by)


def zoom(camera: Any, steps: float) -> None:
    """Nearer by so many steps of a wheel, or farther."""
    camera.Dolly(_ZOOM ** float(np.clip(steps, -20.0, 20.0)))
