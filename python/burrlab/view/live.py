"""A scene that follows a running session or a replica, at no cost for the loop."""

import time
from typing import Any

from burrlab._core import Replica
from burrlab.common.check import check_positive
from burrlab.effects.companion import Companion
from burrlab.session.session import Session
from burrlab.view.page_source import LiveSource
from burrlab.view.scene import Scene, SceneWindow


class LiveView:
    """A scene that follows a session or a replica.

    The loop is never asked. The follower's copy of the bone tells which bricks changed, and the scene's own
    copy takes them over.

    Parameters
    ----------
    source : Session or Replica
        A replica must have been started, and nothing else may take its changes.
    effects : Companion, optional
        Dust, blood and water, drawn as they are at each step.
    slices : bool
        Show slices through the first burr's centre.
    **options
        Options of the `Scene`.

    Attributes
    ----------
    scene : Scene
    bone : VoxelBone
        The scene's copy.
    tick : int
        Ticks shown.

    Raises
    ------
    TypeError
        If the source is neither.
    """

    def __init__(
        self,
        source: Session | Replica,
        *,
        effects: Companion | None = None,
        slices: bool = False,
        **options: Any,
    ) -> None:
        self._live, self._source, self.slices = LiveSource(source, effects), source, slices
        self.bone, self.tick = self._live.bone, self._live.tick
        self.scene = Scene(self.bone, self._live.radii, **{"note": self._live.note, **options})

    def step(self) -> int:
        """Takes over the changes since the last step; returns the number of blocks made anew."""
        bricks = self._live.go(0.0)
        self.tick = self._live.tick
        return self._live.show_in(self.scene, bricks, slices=self.slices, curves=True)

    def run(self, *, rate: float = 20.0) -> None:
        """Shows the scene in its window, in the main thread, until the session ends or the window is closed.

        Parameters
        ----------
        rate : float
            Rate of the steps [1/s].

        Raises
        ------
        ValueError
            If the rate is not positive.
        """
        check_positive("rate", rate)
        next_at, ended = time.monotonic(), False
        with SceneWindow(self.scene) as window:
            while not ended:
                ended = self._source.wait(max(next_at - time.monotonic(), 0.0))
                next_at = max(next_at + 1 / rate, time.monotonic())
                self.step()
                if not window.turn(draw=True):
                    return

    def close(self) -> None:
        """Frees window and memory; the session goes on."""
        self.scene.close()
