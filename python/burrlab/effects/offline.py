"""The secondary effects of a recorded session."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from burrlab._core import read_bricks
from burrlab.effects.effects import Effects

if TYPE_CHECKING:
    from burrlab.view.player import TracePlayer


def effects_of(player: TracePlayer, effects: Effects, *, rate: float = 20.0) -> Iterator[float]:
    """Goes through a trace frame by frame, and lets effects see each.

    Parameters
    ----------
    player : TracePlayer
        Goes on from where it is; its bone now must be the one that `effects` was made with.
    effects : Effects
        Without a budget the same trace gives the same parcels.
    rate : float
        Frames a second of the trace [Hz].

    Yields
    ------
    float
        Time of the frame just made [s].

    Raises
    ------
    ValueError
        If the rate is not positive.

    Examples
    --------
    ::

        player = burrlab.view.TracePlayer(trace)
        effects = Effects(player.bone, seed=1)
        for time in effects_of(player, effects):
            scene.set_parcels(effects.parcels)
    """
    if not 0 < rate < float("inf"):
        raise ValueError(f"rate must be positive, got {rate!r}")
    return _frames(player, effects, rate)


def _frames(player: TracePlayer, effects: Effects, rate: float) -> Iterator[float]:
    frame, begin = 0, player.time
    while player.done < player.ticks:
        frame += 1
        bricks = player.seek(min(begin + frame / rate, player.duration))
        burrs = list(zip(player.burrs.centers, player.burrs.radii, strict=True)) if player.done else []
        effects.step(1 / rate, {"bricks": bricks, "density": read_bricks(player.bone, bricks)}, burrs)
        yield player.time
