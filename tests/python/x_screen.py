"""A virtual screen, its picture, and mouse and keys: Xvfb, its framebuffer, and xdotool."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest


def need_screen() -> None:
    """Skips a test, with the reason, without a virtual screen."""
    pytest.importorskip("pyvista", reason="needs the extra viz3d")
    for program in ("Xvfb", "xdotool"):
        if shutil.which(program) is None:
            pytest.skip(f"needs {program}: apt-get install xvfb xdotool")


class Screen:
    """A virtual screen; a context manager.

    Parameters
    ----------
    folder : path
        For the framebuffer.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        read, write = os.pipe()
        self.process = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", "1700x900x24", "-fbdir", str(folder), "-nolisten", "tcp",
             "-noreset"],  # else it restarts after its last client, and refuses others meanwhile
            pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(write)
        with os.fdopen(read) as said:
            self.name = f":{said.readline().strip()}"
        # An earlier test may have set VTK to draw without a screen.
        kept = os.environ.keys() - {"WAYLAND_DISPLAY", "VTK_DEFAULT_OPENGL_WINDOW"}
        self.environment = {**{name: os.environ[name] for name in kept}, "DISPLAY": self.name}

    def __enter__(self) -> Screen:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.wait(20)

    def picture(self) -> np.ndarray:
        """The present picture, (height, width, 3), from Xvfb's file in xwd format."""
        data = (self.folder / "Xvfb_screen0").read_bytes()
        header = np.frombuffer(data, ">u4", 25)
        width, height, line = int(header[4]), int(header[5]), int(header[12])
        begin = int(header[0]) + 12 * int(header[19])
        rows = np.frombuffer(data, np.uint8, height * line, begin).reshape(height, line)
        return rows[:, : 4 * width].reshape(height, width, 4)[:, :, 2::-1].copy()

    def do(self, *arguments: object) -> str:
        """Runs xdotool; returns its output."""
        done = subprocess.run(
            ["xdotool", *map(str, arguments)],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=30,
        )
        return done.stdout.strip()

    def drag(self, start: tuple[int, int], way: tuple[int, int]) -> None:
        """Drags with the left button in ten steps."""
        self.do("mousemove", *start, "mousedown", 1)
        for _ in range(10):
            self.do("mousemove_relative", "--", way[0] // 10, way[1] // 10)
            time.sleep(0.03)
        self.do("mouseup", 1)

    def window(self, seconds: float = 60.0) -> int:
        """Number of the window, once one is shown."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found := self.do("search", "--onlyvisible", "--name", "burrlab"):
                return int(found.split()[-1])
            time.sleep(0.2)
        raise AssertionError("no window")

    def close_window(self, window: int) -> None:
        """Asks a window to close, as a click on the cross of its frame does."""
        library = ctypes.CDLL(ctypes.util.find_library("X11"))
        library.XOpenDisplay.restype = ctypes.c_void_p
        library.XInternAtom.restype = ctypes.c_ulong
        display = ctypes.c_void_p(library.XOpenDisplay(self.name.encode()))
        event = (ctypes.c_long * 24)()
        protocols, delete = (
            library.XInternAtom(display, word, 0) for word in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW")
        )
        # XClientMessageEvent: type 33, serial, send_event, display, window, message_type, format 32, data
        event[0], event[4], event[5], event[6], event[7] = 33, window, protocols, 32, delete
        library.XSendEvent(display, ctypes.c_ulong(window), 0, ctypes.c_long(0), ctypes.byref(event))
        library.XCloseDisplay(display)
