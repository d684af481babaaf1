"""Beside a running session, or on a replica: what is there now, twenty times a second, at no cost for the loop."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Follower, Replica, VoxelBone, restore_bricks
from burrlab.bone.header import assumed, told_notes
from burrlab.session.session import Session
from burrlab.view.scene import Scene, SceneWindow
from burrlab.view.surface import brick_numbers

_KEPT = 400  # points of the curves


class _Parcels(Protocol):
    @property
    def parcels(self) -> NDArray[np.void]: ...


class LiveView:
    """A scene that follows a session or a replica.

    The loop is never asked: the follower's copy of the bone says which bricks changed, and the scene's own copy of the
    bone takes them over.

    Parameters
    ----------
    source : Session or Replica
        A replica must have been started, and nothing else may take what changed of it.
    effects : optional
        Whatever has `parcels`: dust, blood and water, drawn as they are at each step.
    slices : bool
        Show slices through the first burr's centre.
    **options
        Of the `Scene`.

    Attributes
    ----------
    scene : Scene
    bone : VoxelBone
        The scene's copy.
    tick : int
        Ticks that are shown.

    Raises
    ------
    TypeError
        If the source is neither.
    """

    def __init__(
        self,
        source: Session | Replica,
        *,
        effects: _Parcels | None = None,
        slices: bool = False,
        **options: Any,
    ) -> None:
        self._take = _taker(source)
        self._source, self.effects, self.slices = source, effects, slices
        bone, self.tick = source.snapshot()  # after the view was made: nothing is missed
        self.bone: VoxelBone = bone
        self.scene = Scene(bone, _radii(source), **{"note": picture_note(source), **options})
        self._curve: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)

    def step(self) -> int:
        """Takes over what changed since the last step; returns the number of blocks that were made anew."""
        update = self._take()
        self.tick = update["tick"]
        blocks = 0
        if len(update["bricks"]):
            numbers = brick_numbers(update["bricks"], self.bone)
            restore_bricks(self.bone, numbers, update["density"].reshape(-1, 512))
            blocks = self.scene.update(self.bone, update["bricks"])
        newest = update["newest"]
        if newest is not None:
            self._place(newest)
        if self.effects is not None:
            self.scene.set_parcels(self.effects.parcels)
        return blocks

    def _place(self, newest: np.void) -> None:
        burrs = newest["burr"][: len(self.scene.radii)]
        self.scene.move_burrs(burrs["center"], (burrs["on"] > 0).tolist())
        if self.slices and len(burrs):
            self.scene.set_slices(burrs["center"][0])
        if len(burrs):
            force = float(np.linalg.norm(burrs["force"][0]))
            self._curve.append((float(newest["time"]), force, float(burrs["penetration"][0])))
            self.scene.set_curves(*np.array(self._curve).T)

    def frames(self, seconds: float, *, fps: float = 20.0) -> Iterator[NDArray[np.uint8]]:
        """Pictures at the wall clock's pace, for a film; ends early with the session.

        Parameters
        ----------
        seconds : float
            [s]
        fps : float
            [1/s]; a frame that comes late is followed at once by the next, none is made twice.

        Raises
        ------
        ValueError
            If fps or seconds are not positive.
        """
        if not (seconds > 0 and fps > 0):
            raise ValueError(f"seconds and fps must be positive, got {seconds} and {fps}")
        begin = time.monotonic()
        for k in range(max(int(seconds * fps), 1)):
            time.sleep(max(begin + k / fps - time.monotonic(), 0.0))
            self.step()
            yield self.scene.picture()
            if self._source.wait(0.0):
                return

    def run(self, *, rate: float = 20.0) -> None:
        """Shows it in the window until the session ends or the window is closed; in the main thread.

        Parameters
        ----------
        rate : float
            Of the steps [1/s].

        Raises
        ------
        ValueError
            If the rate is not positive.
        """
        if not (np.isfinite(rate) and rate > 0):
            raise ValueError(f"rate must be positive and finite, got {rate}")
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


def picture_note(source: Any) -> str:
    """What a picture says of the bone of a trace, its player, a session or a replica; nothing of a bone alone."""
    if isinstance(source, Session):
        return assumed(told_notes(source.provenance["source"]))
    if isinstance(source, Replica):
        return assumed(told_notes(json.loads(source.hello).get("source")))
    return assumed(getattr(getattr(source, "trace", source), "notes", ()))


def _radii(source: Session | Replica) -> list[float]:
    if isinstance(source, Session):
        return [burr.radius for burr, _ in source.tools]
    return [float(tool["radius_mm"]) for tool in json.loads(source.hello)["tools"]]


def _taker(source: Session | Replica) -> Any:
    if isinstance(source, Session):
        follower: Follower = source.follower
        view = follower.view()
        return lambda: follower.take(view)
    if isinstance(source, Replica):
        return source.take
    raise TypeError(f"source must be a Session or a Replica, got {type(source).__name__}")
