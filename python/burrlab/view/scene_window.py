"""A scene's window, looked after from here and not by VTK's own loop, which Ctrl-C does not end."""

from __future__ import annotations

import signal
import threading
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from burrlab.view.scene import Scene

_SLOW = 0.04  # of a drawing: then nothing is drawn that is only nicer [s]
_AGAIN = 0.5  # after which it is drawn though nothing is known to have changed, as when another window lay over it [s]


class SceneWindow:
    """Opens the window of a scene, in the main thread; a context manager.

    Within it Ctrl-C is raised by `turn` only: what is raised in a function that VTK calls, and pyvista has some, is printed
    and forgotten.

    Parameters
    ----------
    scene : Scene
        Not off screen.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._seen: tuple[Any, ...] = ()
        self._drawn, self._fast = 0.0, False
        self._interrupted, self._held = False, list[int]()
        scene.plotter.show(interactive_update=True, auto_close=False)
        self._events = scene.plotter.iren
        self._events.interactor.EnableRenderOff()  # else each move of a mouse that waits is drawn by itself

    def __enter__(self) -> SceneWindow:
        if threading.current_thread() is threading.main_thread():
            for name in ("SIGINT", "SIGTERM", "SIGHUP"):
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) is signal.default_int_handler:
                    signal.signal(number, self._hold_back)
                    self._held.append(number)
        return self

    def __exit__(self, *_: object) -> None:
        for number in self._held:
            signal.signal(number, signal.default_int_handler)

    def _hold_back(self, *_: object) -> None:
        self._interrupted = True

    def turn(self, *, draw: bool = False) -> bool:
        """Does what mouse, keys and the window's frame asked for since the last call, and draws if that or the caller needs
        it; whether the window is still open. KeyboardInterrupt after Ctrl-C."""
        self._events.process_events()
        if self._interrupted:
            raise KeyboardInterrupt
        if self._events.interactor.GetDone():  # q, e, or the cross of the window's frame
            return False
        plotter, now = self.scene.plotter, time.monotonic()
        seen = plotter.camera.GetMTime(), *plotter.window_size
        if draw or seen != self._seen or now - self._drawn > _AGAIN:
            self.scene.render()
            self._drawn = time.monotonic()
            self._seen = plotter.camera.GetMTime(), *plotter.window_size  # drawing sets the camera's range
            if not self._fast and self._drawn - now > _SLOW:
                self._fast = True
                self.scene.draw_fast()
        return True
