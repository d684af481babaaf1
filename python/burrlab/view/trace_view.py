"""A recorded session seen: a scene at any of its moments, and a film of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab.effects import Effects
from burrlab.session.trace import Trace
from burrlab.view.approach import approach_view, trace_approach
from burrlab.view.page_parcels import ParcelHistory
from burrlab.view.player import TracePlayer
from burrlab.view.scene import Scene
from burrlab.volume.header import assumed

_CURVE_POINTS = 600


class TraceView:
    """A scene that follows a player.

    Parameters
    ----------
    trace : Trace or TracePlayer
    effects : Effects, optional
        Of the trace's initial bone, without a frame yet: dust, blood and water, made here from the trace's beginning to
        its end.
    slices : bool
        Show slices through the first burr's centre.
    **options
        Of the `Scene`, but that burrs are outlined.

    Attributes
    ----------
    player : TracePlayer
    scene : Scene

    Raises
    ------
    TypeError
        If `trace` is neither.
    """

    def __init__(
        self,
        trace: Trace | TracePlayer,
        *,
        effects: Effects | None = None,
        slices: bool = False,
        **options: Any,
    ) -> None:
        self.player = trace if isinstance(trace, TracePlayer) else TracePlayer(trace)
        self._parcels = None if effects is None else ParcelHistory(self.player.trace, effects)
        if self._parcels is not None:
            self._parcels.make()
        self.slices = slices
        radii = self.player.burrs.radii.tolist()
        self.scene = Scene(
            self.player.bone, radii, **{"outline": True, "note": assumed(self.player.trace.notes), **options}
        )
        self.scene.look(approach_view(self.player.bone, trace_approach(self.player)))
        self.go(self.player.time)

    def go(self, seconds: float) -> int:
        """Shows a time of the trace [s]; returns the number of blocks that were made anew. ValueError if it has no such time."""
        player, scene = self.player, self.scene
        blocks = scene.update(player.bone, player.seek(seconds))
        burrs = player.burrs
        scene.move_burrs(burrs.centers, burrs.on.tolist())
        if self.slices and len(burrs.centers) and np.isfinite(burrs.centers[0]).all():
            scene.set_slices(burrs.centers[0])
        history, done = player.history, player.done
        first = int(np.searchsorted(history.time, player.time - 10.0))
        rows = slice(first, done, max((done - first) // _CURVE_POINTS, 1))
        if history.force.shape[1]:
            scene.set_curves(history.time[rows], history.force[rows, 0], history.depth[rows, 0])
        if self._parcels is not None:
            scene.set_parcels(self._parcels.at(player.time))
        return blocks

    def frames(
        self,
        *,
        fps: float = 20.0,
        speed: float = 1.0,
        start: float = 0.0,
        stop: float | None = None,
        stereo: bool = False,
    ) -> Iterator[NDArray[np.uint8]]:
        """Pictures for a film.

        Parameters
        ----------
        fps : float
            [1/s]
        speed : float
            Of the trace's time over the film's.
        start, stop : float
            Part of the trace [s]; default: all.
        stereo : bool
            Both eyes side by side.

        Raises
        ------
        ValueError
            If fps or speed is not positive, or the part does not lie in the trace.
        """
        for name, value in (("fps", fps), ("speed", speed)):
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive and finite, got {value}")
        end = self.player.duration if stop is None else stop
        if not 0 <= start <= end <= self.player.duration + 1e-9:
            raise ValueError(
                f"start and stop must lie from 0 to {self.player.duration:g}, got {start:g} and {end:g}"
            )
        for k in range(int(np.floor((end - start) * fps / speed + 1e-9)) + 1):
            self.go(min(start + k * speed / fps, self.player.duration))
            yield self.scene.stereo_picture() if stereo else self.scene.picture()

    def close(self) -> None:
        """Frees window and memory."""
        self.scene.close()
