"""One interval of a trial: a burr on fresh bone, driven by a device, for a time.

Bone that appears around a burr would throw it out: a live device is waited for until the burr is lifted.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Device, Material, RecordReader, VoxelBone
from burrlab.bone.recipe import VolumeBlockRecipe, VolumeRecipe, block_recipe
from burrlab.common.check import check_positive, refuse
from burrlab.psychophysics.trial import MODES, Interval, Mode
from burrlab.session.session import Session

_LEAST_VOXELS = 4.0  # of a burr's radius, as the tick has it


@dataclass(frozen=True)
class Block:
    """A block of solid bone, its top at z = 0, in the middle of x and y.

    Parameters
    ----------
    size : (float, float, float)
        Along x, y, z [mm]; whole numbers of voxels. The default holds 20 s of drilling in the softest of the
        paper's materials with the `drilling_hand` (docs/simulated_subject.md).
    voxel : float
        Edge of a voxel [mm].

    Raises
    ------
    ValueError
        If a length is not positive, or the size is not a whole number of voxels.

    Examples
    --------
    >>> bone = Block((20, 20, 10), 0.2).fresh()
    >>> bone.shape, bone.origin
    ((50, 100, 100), (-9.9, -9.9, -9.9))
    """

    size: tuple[float, float, float] = (30.0, 30.0, 20.0)
    voxel: float = 0.1

    def __post_init__(self) -> None:
        size = tuple(float(length) for length in self.size)
        refuse(len(size) != 3, f"size must have three lengths, got {len(size)}")
        check_positive("voxel", self.voxel)
        for length in size:
            check_positive("size", length)
            refuse(
                abs(length / self.voxel - round(length / self.voxel)) > 1e-6,
                f"size must be a whole number of voxels of {self.voxel:g} mm, got {length:g}",
            )
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "voxel", float(self.voxel))

    @property
    def origin(self) -> tuple[float, float, float]:
        """Centre of voxel (0, 0, 0) [mm]."""
        x, y, z = self.size
        half = 0.5 * self.voxel
        return round(half - 0.5 * x, 9), round(half - 0.5 * y, 9), round(half - z, 9)

    def fresh(self) -> VoxelBone:
        """The untouched bone."""
        return VoxelBone.block(self.size, self.voxel, origin=self.origin)

    def recipe(self) -> dict[str, Any]:
        """How others make the same bone, for a session's trace."""
        return block_recipe(self.size, self.voxel, origin=self.origin)

    def plain(self) -> dict[str, Any]:
        """What a protocol's JSON has."""
        return {"size_mm": list(self.size), "voxel_mm": self.voxel}

    def check_burr(self, burr: Burr) -> None:
        """Raises ValueError if the burr is too small for the voxels or too large for the block."""
        refuse(
            burr.radius < _LEAST_VOXELS * self.voxel,
            f"radius of the burr must be at least {_LEAST_VOXELS:g} voxels of {self.voxel:g} mm, got {burr.radius:g}",
        )
        refuse(
            2.0 * burr.radius >= min(self.size[:2]),
            f"diameter of the burr must be less than the block's sides, {min(self.size[:2]):g} mm, got {2 * burr.radius:g}",
        )


@dataclass(frozen=True)
class VolumeBlock(Block):
    """A block cut out of a volume along an axis; its top is flat at z = 0, the entry in the middle of x and y.

    Parameters
    ----------
    size, voxel
        As for `Block`.
    volume : VolumeRecipe
    entry, axis : (float, float, float)
        In the volume's own coordinates; see `burrlab.volume.cut_block`.

    Raises
    ------
    ValueError
        As `Block`. What is wrong with the volume shows when it is cut.
    """

    volume: VolumeRecipe = field(kw_only=True)
    entry: tuple[float, float, float] = field(kw_only=True)
    axis: tuple[float, float, float] = field(kw_only=True)

    @property
    def _made(self) -> VolumeBlockRecipe:
        return VolumeBlockRecipe(self.volume, self.size, self.voxel, self.entry, self.axis)

    def fresh(self) -> VoxelBone:
        """The untouched bone, which is cut once. Errors as of `burrlab.volume.cut_block`, and OSError."""
        return _cut(self._made).copy()

    def recipe(self) -> dict[str, Any]:
        """How others make the same bone, for a session's trace."""
        return {"notes": list(self.volume.notes()), **self._made.plain()}

    def plain(self) -> dict[str, Any]:
        """What a protocol's JSON has: the bone's digest, and not where the volume lies."""
        # without what earlier versions did not write, so that a protocol keeps its digest
        volume = {name: value for name, value in self.volume.plain().items() if value is not False}
        volume["path"] = os.path.basename(self.volume.path)
        return {**self._made.plain(), "volume": volume, "digest": _cut(self._made).digest()}


_cut = functools.lru_cache(maxsize=2)(VolumeBlockRecipe.bone)


_AWAY = 1e4  # [mm] from the surface to a block that nothing meets
_STEADY = 0.1  # that the burr must be lifted [s]
_PATIENCE = 0.3  # before the hand is asked to lift it [s]
_LOOK = 0.005  # [s] between two looks at the records
_MOST = 20_000  # records taken at once


def wait_until_lifted(
    device: Device,
    burr: Burr,
    *,
    on_wait: Callable[[], object],
    stop: Callable[[], bool],
    on_message: Callable[[str], object] | None = None,
) -> tuple[bool, str]:
    """Waits until the burr's tip has been above the plane z = 0 for 0.1 s. The force is zero meanwhile.

    Parameters
    ----------
    device : Device
        Live. Free again afterwards, but an `IgtlDevice` is closed.
    burr : Burr
    on_wait : callable
        Called once if the burr is not lifted by itself.
    stop : callable
        The waiting ends when this returns True; asked every few milliseconds.
    on_message : callable, optional
        See `burrlab.Session`.

    Returns
    -------
    lifted : bool
        False if the device came to its end or was lost, or `stop` said so.
    reason : str
        Why the waiting ended, in the session's words.

    Notes
    -----
    Bone that is there from one millisecond to the next pushes a burr of R = 3 mm that is 2 mm deep in it with
    10.5 N: the session sends its limit of 8 N within 9 ms (docs/experiment.md).
    """
    # A session in the air: it reads the device as any other does, and its force is exactly zero.
    voxel = burr.radius / 4.0
    nothing = VoxelBone.block((voxel, voxel, voxel), voxel, origin=(0.0, 0.0, -_AWAY))
    still = Material("nothing", c_e=1.0, alpha=0.0)
    session = Session(nothing, (burr, still), device, seed=0, realtime=False, on_message=on_message)
    reader = RecordReader(session.loop)
    begun = high_since = None
    lifted = asked = False
    with session:
        while not lifted and not stop():
            if session.loop.wait(_LOOK):
                break
            records, _ = reader.take(_MOST)
            for time, z in zip(records["time"], records["burr"]["center"][:, 0, 2], strict=True):
                begun = time if begun is None else begun
                high_since = None if z < burr.radius else time if high_since is None else high_since
                lifted = lifted or (high_since is not None and time - high_since >= _STEADY)
                if not asked and high_since is None and time - begun >= _PATIENCE:
                    asked = True
                    on_wait()
        session.stop("the burr is lifted" if lifted else "no more waiting")
    return lifted, session.reason


Ending: TypeAlias = Literal["time", "break-through", "wall", "subject", "device"]

ENDINGS: tuple[Ending, ...] = ("time", "break-through", "wall", "subject", "device")

#: What is kept of a tick: `time` since the first one [s], the `periods` it stands for, `center` [mm], `force`
#: [N] of the model, `penetration` [mm], `removed` [levels], whether the burr touches bone, and whether it
#: turns.
TICK = np.dtype(
    [
        ("time", "f8"), ("periods", "u4"), ("touching", "?"), ("on", "?"), ("center", "f8", 3), ("force", "f8", 3),
        ("penetration", "f8"), ("removed", "i8"),
    ]
)  # fmt: skip

_PERIOD = 1e-3  # of the loop [s]


@dataclass(frozen=True, eq=False)
class Rendered:
    """What happened in an interval.

    Attributes
    ----------
    mode : {"probing", "drilling"}
    ended : {"time", "break-through", "wall", "subject", "device"}
        The time was over; the burr's tip came to the block's bottom; the burr came to its side; `stop` said
        so; the device came to its end, or the session failed.
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
        By probing nothing is eroded (alpha = 0), whatever the device's switch says; by drilling the switch
        decides.
    wall_clock : bool
        Keep absolute deadlines. Else as fast as it goes, and deterministic to the tick.
    record : path, optional
        A new file for the session's trace. It holds the few ticks after the end too.
    publish, on_message : optional
        See `burrlab.Session`.
    stop : callable, optional
        The interval ends when it returns True; asked every few milliseconds, from the calling thread. Needed
        where the interval has no duration.

    Returns
    -------
    Rendered

    Raises
    ------
    ValueError
        If the stimulus has no material, the mode is unknown, the duration is not positive, there is neither
        duration nor stop, or the burr does not fit the block.
    FileExistsError
        If the trace exists.

    Notes
    -----
    Break-through and wall are judged by the ticks from the first contact on: the first in which the tip, z -
    R, is at the bottom or below, or in which the part of the sphere below the surface reaches a side of the
    block, ends the interval. The session is ended some milliseconds later, and what comes after that tick is
    cut off.
    """
    material = _material(interval, mode)
    refuse(
        interval.duration is None and stop is None,
        "stop must be given where the interval has no duration, got None",
    )
    refuse(
        interval.duration is not None and not 0.0 < interval.duration < 1e9,
        f"duration of the interval must be positive, got {interval.duration!r}",
    )
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
    in_time = interval.duration is not None and session.ticks >= round(interval.duration / _PERIOD)
    otherwise: Ending = "time" if in_time and not session.failed else "device"
    ended: Ending = watch.ended or ("subject" if asked else otherwise)
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
    refuse(mode not in MODES, f"mode must be one of {', '.join(MODES)}, got {mode!r}")
    material = interval.stimulus.material
    if material is None:
        raise ValueError(
            f"the stimulus must have a material to be rendered, {interval.stimulus.name!r} is a real specimen"
        )
    if mode == "drilling":
        return material
    return Material(material.name, c_e=material.c_e, alpha=0.0, shape=material.shape, source=material.source)


class _Watch:
    """Takes the records while the loop runs, until one of them ends the interval."""

    def __init__(self, reader: RecordReader, burr: Burr, bone: Block, duration: float | None) -> None:
        self._reader: RecordReader | None = reader
        self._radius = burr.radius
        self._half, self._bottom = 0.5 * np.array(bone.size[:2]), -bone.size[2]
        self._duration = math.inf if duration is None else duration
        self._kept = [np.zeros(0, TICK)]
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
        if self._start is None:
            self._start = float(records["time"][0])
        burr, ticks = records["burr"][:, 0], np.zeros(len(records), TICK)
        ticks["time"], ticks["periods"] = records["time"] - self._start, records["k"]
        for name in ("touching", "on", "center", "force", "penetration", "removed"):
            ticks[name] = burr[name]
        touched = self._touched | np.logical_or.accumulate(ticks["touching"])
        self._touched = bool(touched[-1])
        place, z = np.abs(ticks["center"][:, :2]), ticks["center"][:, 2]
        # Radius of the sphere's widest section below the surface.
        width = np.sqrt(np.maximum(self._radius**2 - np.maximum(z, 0.0) ** 2, 0.0))
        # In the order of ENDINGS, which decides where two come at one tick.
        late = ticks["time"] >= self._duration - 0.5 * _PERIOD
        through = touched & (z - self._radius <= self._bottom)
        wall = touched & (z < self._radius) & (place + width[:, None] >= self._half).any(axis=1)
        found = [(int(over.argmax()), kind) for kind, over in enumerate((late, through, wall)) if over.any()]
        if found:
            first, kind = min(found)
            self.ended = ENDINGS[kind]
            ticks = ticks[: first + (self.ended != "time")]
        self._kept.append(ticks)

    def ticks(self) -> NDArray[np.void]:
        kept: NDArray[Any] = np.concatenate(self._kept)
        kept.flags.writeable = False
        return kept
