"""The secondary effects of a recorded session."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from burrlab._core import read_bricks
from burrlab.effects.effects import Decision, Effects, FrameRecord

if TYPE_CHECKING:
    from burrlab.view.player import TracePlayer


def effects_of(
    player: TracePlayer,
    effects: Effects,
    *,
    rate: float = 20.0,
    frames: Sequence[FrameRecord] | None = None,
) -> Iterator[float]:
    """Goes through a trace frame by frame, and lets effects see each.

    Parameters
    ----------
    player : TracePlayer
        Goes on from where it is; its bone now must be the one that `effects` was made with.
    effects : Effects
        Without a budget the same trace gives the same parcels.
    rate : float
        Frames a second of the trace [Hz].
    frames : list of (seconds, tick, decision), optional
        `Companion.frames` of the session that was recorded, in place of the rate: with the companion's seed, parameters,
        nozzle and sucker its parcels come out again, to the bit. What was changed while it ran must be changed here too,
        between two frames.

    Yields
    ------
    float
        Time of the trace after the frame just made [s].

    Raises
    ------
    ValueError
        If the rate is not positive, or a frame saw a tick that the trace does not hold.

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
    if frames is None:
        return _at_rate(player, effects, rate)
    first = player.trace.first_tick
    ticks = [tick for _, tick, _ in frames]
    if ticks and not first <= min(ticks) <= max(ticks) <= first + player.ticks:
        raise ValueError(
            f"ticks of the frames must be from {first} to {first + player.ticks}, got {min(ticks)} to {max(ticks)}"
        )
    return _again(player, effects, frames)


def _at_rate(player: TracePlayer, effects: Effects, rate: float) -> Iterator[float]:
    frame, begin = 0, player.time
    while player.done < player.ticks:
        frame += 1
        _step(player, effects, player.seek(min(begin + frame / rate, player.duration)), 1 / rate)
        yield player.time


def _again(player: TracePlayer, effects: Effects, frames: Sequence[FrameRecord]) -> Iterator[float]:
    for seconds, tick, decision in frames:
        _step(player, effects, player.seek_tick(tick), seconds, decision)
        yield player.time


def _step(
    player: TracePlayer,
    effects: Effects,
    bricks: NDArray[np.uint32],
    seconds: float,
    decision: Decision | None = None,
) -> None:
    burrs = list(zip(player.burrs.centers, player.burrs.radii, strict=True)) if player.done else []
    update = {"bricks": bricks, "density": read_bricks(player.bone, bricks)}
    effects.step(seconds, update, burrs, decision=decision)
