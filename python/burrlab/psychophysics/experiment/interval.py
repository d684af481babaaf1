"""One interval of a trial: a burr on fresh bone, driven by a device, for a time."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Device, Material, RecordReader
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.trial import MODES, Interval, Mode
from burrlab.session.session import Session

Ending: TypeAlias = Literal["time", "break-through", "wall", "subject", "device"]

ENDINGS: tuple[Ending, ...] = ("time", "break-through", "wall", "subject", "device")

#: What is kept of a tick: `time` since the first one [s], the `periods` it stands for, `center` [mm], `force` [N] of the
#: model, `penetration` [mm], `removed` [levels], whether the burr touches bone, and whether it turns.
TICK = np.dtype(
    [
        ("time", "f8"), ("periods", "u4"), ("touching", "?"), ("on", "?"), ("center", "f8", 3), ("force", "f8", 3),
        ("penetration", "f8"), ("removed", "i8"),
    ]
)  # fmt: skip

_PERIOD = 1e-3  # of the loop [s]
_LOOK = 0.005  # [s] between two looks at the records
_MOST = 20_000  # records taken at once


@dataclass(frozen=True, eq=False)
class Rendered:
    """What happened in an interval.

    Attributes
    ----------
    mode : {"probing", "drilling"}
    ended : {"time", "break-through", "wall", "subject", "device"}
        The time was over; the burr's tip came to the block's bottom; the burr came to its side; `stop` said so; the
        device came to its end, or the session failed.
    duration : float
        From the first tick to the end [s].
    contact : float
        Of it with bone inside the sphere [s].
    seed : int
        Of the erosion.
    burr : Burr
    ticks : ndarray of TICK
        Until the end, read-only.
    reason : str
        Why the session ended, in its own words.
    failed : bool
        The device was lost, the loop stalled or a value was not finite: the interval says nothing.
    """

    mode: Mode
    ended: Ending
    duration: float
    contact: float
    seed: int
    burr: Burr
    ticks: NDArray[np.void] = field(repr=False)
    reason: str = ""
    failed: bool = False

    @property
    def immersion(self) -> NDArray[np.float64]:
        """Depth of the burr's tip below the untouched surface at each tick, negative above it [mm]."""
        return np.asarray(self.burr.radius - self.ticks["center"][:, 2])


def render(
    interval: Interval,
    device: Device,
    *,
    burr: Burr,
    bone: Block,
    mode: Mode,
    wall_clock: bool = True,
    record: str | os.PathLike[str] | None = None,
    publish: int | None = None,
    on_message: Callable[[str], object] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Rendered:
    """Lets a device feel a stimulus on fresh bone.

    Parameters
    ----------
    interval : Interval
        The stimulus needs a material. Its time begins with the first tick.
    device : Device
        Free; it may serve the next interval after it.
    burr : Burr
    bone : Block
    mode : {"probing", "drilling"}
        By probing nothing is eroded (alpha = 0), whatever the device's switch says; by drilling the switch decides.
    wall_clock : bool
        Keep absolute deadlines. Else as fast as it goes, and deterministic to the tick.
    record : path, optional
        A new file for the session's trace. It holds the few ticks after the end too.
    publish, on_message : optional
        See `burrlab.Session`.
    stop : callable, optional
        The interval ends when it returns True; asked every few milliseconds, from the calling thread. Needed where the
        interval has no duration.

    Returns
    -------
    Rendered

    Raises
    ------
    ValueError
        If the stimulus has no material, the mode is unknown, the duration is not positive, there is neither duration
        nor stop, or the burr does not fit the block.
    FileExistsError
        If the trace exists.

    Notes
    -----
    Break-through and wall are judged by the ticks from the first contact on: the first in which the tip, z - R, is at
    the bottom or below, or in which the part of the sphere below the surface reaches a side of the block, ends the
    interval. The session is ended some milliseconds later, and what comes after that tick is cut off.
    """
    material = _material(interval, mode)
    if interval.duration is None and stop is None:
        raise ValueError("stop must be given where the interval has no duration, got None")
    if interval.duration is not None and not 0.0 < interval.duration < 1e9:
        raise ValueError(f"duration of the interval must be positive, got {interval.duration!r}")
    bone.check_burr(burr)
    session = Session(
        bone.fresh(), (burr, material), device, seed=interval.seed, duration=interval.duration, record=record,
        source=bone.recipe(), wall_clock=wall_clock, realtime=wall_clock, publish=publish, on_message=on_message,
    )  # fmt: skip
    watch = _Watch(RecordReader(session.loop), burr, bone, interval.duration)
    asked = False
    with session:
        while not (watch.ended or asked):
            over = session.loop.wait(_LOOK)
            watch.look()
            if over:
                break
            asked = stop is not None and stop()
        session.stop("the interval is over")
        watch.look()
    ended: Ending = watch.ended or ("subject" if asked else _of_session(session, interval.duration))
    ticks = watch.ticks()
    spans = _PERIOD * ticks["periods"]
    return Rendered(
        mode=mode,
        ended=ended,
        duration=float(ticks["time"][-1] + _PERIOD) if len(ticks) else 0.0,
        contact=float(spans[ticks["touching"]].sum()),
        seed=interval.seed,
        burr=burr,
        ticks=ticks,
        reason=session.reason,
        failed=session.failed,
    )


def _material(interval: Interval, mode: Mode) -> Material:
    if mode not in MODES:
        raise ValueError(f"mode must be one of {', '.join(MODES)}, got {mode!r}")
    material = interval.stimulus.material
    if material is None:
        raise ValueError(
            f"the stimulus must have a material to be rendered, {interval.stimulus.name!r} is a real specimen"
        )
    if mode == "drilling":
        return material
    return Material(material.name, c_e=material.c_e, alpha=0.0, shape=material.shape, source=material.source)


def _of_session(session: Session, duration: float | None) -> Ending:
    if not session.failed and duration is not None and session.ticks >= round(duration / _PERIOD):
        return "time"
    return "device"


class _Watch:
    """Takes the records while the loop runs, until one of them ends the interval."""

    def __init__(self, reader: RecordReader, burr: Burr, bone: Block, duration: float | None) -> None:
        self._reader: RecordReader | None = reader
        self._radius = burr.radius
        self._half, self._bottom = 0.5 * np.array(bone.size[:2]), -bone.size[2]
        self._duration = math.inf if duration is None else duration
        self._kept: list[NDArray[np.void]] = []
        self._start: float | None = None
        self._touched = False
        self.ended: Ending | None = None

    def look(self) -> None:
        while self._reader is not None:
            records, lost = self._reader.take(_MOST)
            if lost:
                raise RuntimeError(
                    "records of the interval were lost: this program was too slow to take them"
                )
            if len(records):
                self._keep(records)
            if self.ended:
                self._reader = None  # a loop on a virtual clock would wait for it
            elif len(records) < _MOST:
                return

    def _keep(self, records: NDArray[np.void]) -> None:
        burr = records["burr"][:, 0]
        ticks = np.zeros(len(records), TICK)
        if self._start is None:
            self._start = float(records["time"][0])
        ticks["time"], ticks["periods"] = records["time"] - self._start, records["k"]
        for name in ("touching", "on", "center", "force", "penetration", "removed"):
            ticks[name] = burr[name]
        over = np.flatnonzero(ticks["time"] >= self._duration - 0.5 * _PERIOD)
        in_time = ticks[: over[0]] if len(over) else ticks
        if len(over):
            self.ended = "time"
        found = self._first_ending(in_time)
        if found is not None:
            index, self.ended = found
            in_time = in_time[: index + 1]
        self._kept.append(in_time)

    def _first_ending(self, ticks: NDArray[np.void]) -> tuple[int, Ending] | None:
        touched = self._touched | np.logical_or.accumulate(ticks["touching"])
        if len(ticks):
            self._touched = bool(touched[-1])
        place, z = np.abs(ticks["center"][:, :2]), ticks["center"][:, 2]
        # Radius of the sphere's widest section below the surface.
        width = np.sqrt(np.maximum(self._radius**2 - np.maximum(z, 0.0) ** 2, 0.0))
        wall = touched & (z < self._radius) & (place + width[:, None] >= self._half).any(axis=1)
        through = touched & (z - self._radius <= self._bottom)
        ending = np.flatnonzero(wall | through)
        if not len(ending):
            return None
        first = int(ending[0])
        return first, "break-through" if through[first] else "wall"

    def ticks(self) -> NDArray[np.void]:
        kept: NDArray[Any] = np.concatenate(self._kept) if self._kept else np.zeros(0, TICK)
        kept.flags.writeable = False
        return kept
