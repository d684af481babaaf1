"""What drawing needs beside burrlab: the extra `viz3d`, and a place to draw to where there is no screen."""

from __future__ import annotations

import ctypes.util
import os
import sys
from typing import Any

#: Debian packages, one line of which is enough where there is no screen.
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri, or libosmesa6"


def pyvista() -> Any:
    """The module pyvista.

    Raises
    ------
    ImportError
        If it is not installed; the sentence says how to get it.
    """
    try:
        import pyvista as module
    except ImportError:
        raise ImportError("the view needs pyvista: pip install 'burrlab[viz3d]'") from None
    return module


def prepare_off_screen() -> None:
    """Chooses how VTK draws without a screen; on other systems than Linux it does by itself.

    Raises
    ------
    OSError
        If there is neither a screen nor a library that draws without one; VTK itself would end the process.
    """
    if not sys.platform.startswith("linux") or os.environ.get("VTK_DEFAULT_OPENGL_WINDOW"):
        return
    if os.environ.get("DISPLAY"):
        return
    if ctypes.util.find_library("EGL"):
        os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkEGLRenderWindow"
    elif ctypes.util.find_library("OSMesa"):
        os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkOSOpenGLRenderWindow"
    else:
        raise OSError(f"drawing without a screen needs the Debian packages {PACKAGES}")


def check_screen() -> None:
    """OSError if a window would have no screen to open on."""
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise OSError(
            "a window needs a screen and there is none: draw to a file (--png, --video) or a page (--web)"
        )
