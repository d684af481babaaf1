"""One interval of a trial: a device drives a burr on fresh bone for some time.

Bone that appears around a burr pushes it out, so a live device's interval waits until the burr is lifted.
"""

import functools
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Device, Material, RecordReader, Tissue, Tissues, VoxelBone
from burrlab.bone.recipe import BlockRecipe, BoneRecipe, LayeredRecipe, VolumeBlockRecipe, VolumeRecipe
from burrlab.common.check import check_positive, refuse
from burrlab.psychophysics.designs import MODES, Boundary, Interval, Mode, rendered
from burrlab.psychophysics.rules import one_of
from burrlab.session.session import Session
from burrlab.session.settings import Clock, Safety, StartingBone
from burrlab.theory.continuum import Law

_LEAST_VOXELS = 4.0  # least radius of a burr, as in the tick


@dataclass(frozen=True)
class Block:
    """A block of solid bone, centred in x and y, with its top at z = 0.

    Parameters
    ----------
    size : (float, float, float)
        Along x, y, z [mm]; whole numbers of voxels. The default is enough for 20 s of drilling by
        `drilling_hand` in the softest of the paper's materials (docs/simulated_subject.md).
    voxel : float
        Edge of a voxel [mm].

    Raises
    ------
    ValueError
        If a length is not positive, or not a whole number of voxels.

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
        vars(self).update(size=size, voxel=float(self.voxel))

    @property
    def origin(self) -> tuple[float, float, float]:
        """Centre of voxel (0, 0, 0) [mm]."""
        x, y, z = self.size
        half = 0.5 * self.voxel
        return round(half - 0.5 * x, 9), round(half - 0.5 * y, 9), round(half - z, 9)

    @property
    def _made(self) -> BoneRecipe:
        return BlockRecipe(self.size, self.voxel, self.origin, 255)

    def fresh(self) -> VoxelBone:
        """The untouched bone."""
        return self._made.bone()

    def recipe(self) -> dict[str, Any]:
        """A recipe of the same bone, for a session's trace."""
        return self._made.plain()

    def start(self, above: Material, boundary: Boundary | None = None) -> StartingBone:
        """The untouched bone, of two tissues with a boundary, for a session."""
        if boundary is None:
            return StartingBone(self.fresh(), source=self.recipe())
        layers = LayeredRecipe(self._made, -boundary.depth, tissues_of(above, boundary.below))
        notes = {key: value for key, value in self.recipe().items() if key == "notes"}
        return StartingBone(layers.of_whole(self.fresh()), source=notes | layers.plain())

    def plain(self) -> dict[str, Any]:
        """The block in a protocol's JSON."""
        return {"size_mm": list(self.size), "voxel_mm": self.voxel}

    def check_burr(self, burr: Burr) -> None:
        """Raises ValueError if the burr is too small for the voxels, or too large for the block."""
        refuse(
            burr.radius < _LEAST_VOXELS * self.voxel,
            f"radius of the burr must be at least {_LEAST_VOXELS:g} voxels of {self.voxel:g} mm, got "
            f"{burr.radius:g}",
        )
        refuse(
            2.0 * burr.radius >= min(self.size[:2]),
            f"diameter of the burr must be less than the block's sides, {min(self.size[:2]):g} mm, got "
            f"{2 * burr.radius:g}",
        )


def tissues_of(above: Material, below: Material) -> Tissues:
    """The tissues of a block with a boundary; ValueError for constants that no tissue has."""
    return Tissues([
        Tissue(name, label=label, c_e=x.c_e, alpha=x.alpha, assumed=False)
        for name, label, x in (("above", 1, above), ("below", 2, below))
    ], above)  # fmt: skip


@dataclass(frozen=True)
class VolumeBlock(Block):
    """A block cut out of a volume along an axis: flat top at z = 0, entry at the centre of x and y.

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
        As for `Block`. Faults of the volume are found when the block is cut.
    """

    volume: VolumeRecipe = field(kw_only=True)
    entry: tuple[float, float, float] = field(kw_only=True)
    axis: tuple[float, float, float] = field(kw_only=True)

    @property
    def _made(self) -> VolumeBlockRecipe:
        return VolumeBlockRecipe(self.volume, self.size, self.voxel, self.entry, self.axis)

    def fresh(self) -> VoxelBone:
        """The untouched bone, cut once. Raises the errors of `burrlab.volume.cut_block`, and OSError."""
        return _cut(self._made).copy()

    def recipe(self) -> dict[str, Any]:
        """A recipe of the same bone, for a session's trace."""
        return {"notes": list(self.volume.notes()), **self._made.plain()}

    def plain(self) -> dict[str, Any]:
        """The block in a protocol's JSON, with the bone's digest and without the volume's folder."""
        # False values are left out, as in earlier versions, so that a protocol keeps its digest.
        volume = {name: value for name, value in self.volume.plain().items() if value is not False}
        volume["path"] = os.path.basename(self.volume.path)
        return {**self._made.plain(), "volume": volume, "digest": _cut(self._made).digest()}


_cut = functools.lru_cache(maxsize=2)(VolumeBlockRecipe.bone)


_AWAY = 1e4  # distance of a block that the burr never meets [mm]
_STEADY = 0.1  # how long the burr must be lifted [s]
_PATIENCE = 0.3  # wait before asking to lift the burr [s]
_LOOK = 0.005  # time between two looks at the records [s]
_MOST = 20_000  # records taken at once


def wait_until_lifted(
    device: Device,
    burr: Burr,
    *,
    on_wait: Callable[[], object],
    stop: Callable[[], bool],
    on_message: Callable[[str], object] | None = None,
) -> tuple[bool, str]:
    """Waits, with zero force, until the burr's tip has been above the plane z = 0 for 0.1 s.

    Parameters
    ----------
    device : Device
        A live device. It is free again afterwards, but an `IgtlDevice` is closed.
    burr : Burr
    on_wait : callable
        Called once if the burr is not lifted soon.
    stop : callable
        Asked every few milliseconds; waiting ends when it returns True.
    on_message : callable, optional
        See `burrlab.Session`.

    Returns
    -------
    lifted : bool
        False if the device ended or was lost, or `stop` returned True.
    reason : str
        The session's reason for the end of waiting.

    Notes
    -----
    Bone that appears around a burr of R = 3 mm at 2 mm depth pushes it with 10.5 N; the session sends its
    limit of 8 N within 9 ms (docs/experiment.md).
    """
    # A session in the air reads the device as usual and gives exactly zero force.
    voxel = burr.radius / 4.0
    session = Session(
        VoxelBone.block((voxel, voxel, voxel), voxel, origin=(0.0, 0.0, -_AWAY)),
        (burr, Material("nothing", c_e=1.0, alpha=0.0)),
        device,
        seed=0,
        on_message=on_message,
        clock=Clock(realtime=False),
        safety=Safety(limits=None),
    )
    reader = RecordReader(session.loop)
    begun = high_since = None
    lifted = notified = False
    with session:
        while not lifted and not stop():
            if session.loop.wait(_LOOK):
                break
            records, _ = reader.take(_MOST)
            for time, z in zip(records["time"], records["burr"]["center"][:, 0, 2], strict=True):
                begun = time if begun is None else begun
                high_since = None if z < burr.radius else time if high_since is None else high_since
                lifted = lifted or (high_since is not None and time - high_since >= _STEADY)
                if not notified and high_since is None and time - begun >= _PATIENCE:
                    notified = True
                    on_wait()
        session.stop("the burr is lifted" if lifted else "no more waiting")
    return lifted, session.reason


Ending: TypeAlias = Literal["time", "break-through", "wall", "subject", "device"]

ENDINGS: tuple[Ending, ...] = ("time", "break-through", "wall", "subject", "device")

#: Record of a tick: `time` since the first tick [s], the `periods` it stands for, whether the burr is
#: `touching` bone, whether it is `on`, `center` [mm], the model's `force` [N], `penetration` [mm], `removed`
#: [levels].
TICK = np.dtype(
    [
        ("time", "f8"), ("periods", "u4"), ("touching", "?"), ("on", "?"), ("center", "f8", 3), ("force", "f8", 3),
        ("penetration", "f8"), ("removed", "i8"),
    ]
)  # fmt: skip

_PERIOD = 1e-3  # the loop's period [s]


@dataclass(frozen=True, eq=False)
class Rendered:
    """Record of one interval.

    Attributes
    ----------
    mode : {"probing", "drilling"}
    ended : {"time", "break-through", "wall", "subject", "device"}
        Cause of the end: the time was over; the burr's tip reached the block's bottom; the burr reached a
        side; `stop` returned True; or the device ended or the session failed.
    duration : float
        Time from the first tick to the end [s].
    contact : float
        Time with bone inside the sphere [s].
    burr : Burr
    ticks : ndarray of TICK
        All ticks until the end, read-only.
    reason : str
        The session's reason for its end.
    failed : bool
        Whether the device was lost, the loop stalled or a value was not finite. Such an interval must not be
        used.
    clipped : float
        Share of the ticks in contact whose force the limits shortened [1].
    reached : bool
        Whether the burr's tip came to the interval's boundary; True without one.
    """

    mode: Mode
    ended: Ending
    duration: float
    contact: float
    burr: Burr
    ticks: NDArray[np.void] = field(repr=False)
    reason: str = ""
    failed: bool = False
    clipped: float = 0.0
    reached: bool = True

    @property
    def immersion(self) -> NDArray[np.float64]:
        """Depth of the burr's tip below the untouched surface at each tick, negative above [mm]."""
        return np.asarray(self.burr.radius - self.ticks["center"][:, 2])

    @property
    def pressed(self) -> float:
        """Mean of the model's force over the time of contact [N]; 0 without contact."""
        force = np.linalg.norm(self.ticks["force"], axis=1) * self.ticks["periods"]
        return float(force[self.ticks["touching"]].sum()) * _PERIOD / self.contact if self.contact else 0.0


def render(
    interval: Interval,
    device: Device,
    *,
    burr: Burr,
    bone: Block,
    mode: Mode,
    wall_clock: bool = True,
    limits: str | None = "device",
    record: str | os.PathLike[str] | None = None,
    publish: int | None = None,
    on_message: Callable[[str], object] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Rendered:
    """Renders one interval: a device drives a burr on fresh bone of the stimulus.

    Parameters
    ----------
    interval : Interval
        Its stimulus needs a material. Its time begins with the first tick.
    device : Device
        A free device, which may serve the next interval afterwards.
    burr : Burr
    bone : Block
    mode : {"probing", "drilling"}
        Probing erodes nothing (alpha = 0), whatever the device's switch says; in drilling the switch
        decides.
    wall_clock : bool
        Whether to keep absolute deadlines; otherwise as fast as possible and deterministic to the tick.
    limits : str, optional
        See `burrlab.Session`; without a ramp, as the interval begins out of contact.
    record : path, optional
        A new file for the session's trace, which also holds the few ticks after the end.
    publish, on_message : optional
        See `burrlab.Session`.
    stop : callable, optional
        Asked every few milliseconds in the calling thread; the interval ends when it returns True. Required
        if the interval has no duration.

    Returns
    -------
    Rendered

    Raises
    ------
    ValueError
        If the stimulus has no material, the mode is unknown, the duration is not positive, duration and
        `stop` are both missing, or the burr does not fit the block.
    FileExistsError
        If the trace exists.

    Notes
    -----
    From the first contact on, the first tick with the tip, z - R, at or below the bottom is a break-through.
    The first tick in which the part of the sphere below the surface reaches a side of the block is a wall.
    Either ends the interval. The session ends some milliseconds later; the ticks in between are cut off.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.psychophysics import Interval, Stimulus, probing_hand
    >>> burr, bone = burrlab.Burr(1.5), Stimulus("bone", burrlab.materials["bone"])
    >>> rendered = render(
    ...     Interval(bone, 1, 0.5), probing_hand(burr), burr=burr, bone=Block((10, 10, 4), 0.2), mode="probing", wall_clock=False
    ... )
    >>> rendered.ended, rendered.duration, rendered.reached
    ('time', 0.5, True)
    """
    one_of("mode", mode, MODES)
    material = rendered("the stimulus", interval.stimulus)
    if mode != "drilling":
        material = Law.of(material).material(material.c_e, 0.0, material.name, material.source)
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
        bone.start(material, interval.boundary), (burr, material), device, seed=interval.seed,
        duration=interval.duration, record=record, on_message=on_message, publish=publish,
        clock=Clock(wall_clock=wall_clock, realtime=wall_clock), safety=Safety(limits=limits, ramp=0.0),
    )  # fmt: skip
    watch = _Watch(RecordReader(session.loop), burr, bone, interval.duration)
    stopped = False
    with session:
        while not (watch.ended or stopped):
            over = session.loop.wait(_LOOK)
            watch.look()
            if over:
                break
            stopped = stop is not None and stop()
        session.stop("the interval is over")
        watch.look()
    ticks, due = watch.ticks(), math.inf if interval.duration is None else round(interval.duration / _PERIOD)
    otherwise: Ending = "time" if session.ticks >= due and not session.failed else "device"
    deepest = burr.radius - float(ticks["center"][:, 2].min(initial=math.inf))
    return Rendered(
        mode=mode,
        ended=watch.ended or ("subject" if stopped else otherwise),
        duration=float(ticks["time"][-1] + _PERIOD) if len(ticks) else 0.0,
        contact=float((_PERIOD * ticks["periods"])[ticks["touching"]].sum()),
        burr=burr,
        ticks=ticks,
        reason=session.reason,
        failed=session.failed,
        clipped=watch.clipped / max(1, int(ticks["touching"].sum())),
        reached=interval.boundary is None or deepest >= interval.boundary.depth,
    )


class _Watch:
    """Takes records while the loop runs, until one of them ends the interval."""

    def __init__(self, reader: RecordReader, burr: Burr, bone: Block, duration: float | None) -> None:
        self._reader: RecordReader | None = reader
        self._radius = burr.radius
        self._half, self._bottom = 0.5 * np.array(bone.size[:2]), -bone.size[2]
        self._duration = math.inf if duration is None else duration
        self._kept = [np.zeros(0, TICK)]
        self._start: float | None = None
        self._touched = False
        self.clipped = 0  # ticks
        self.ended: Ending | None = None

    def look(self) -> None:
        while self._reader is not None:
            records, lost = self._reader.take(_MOST)
            refuse(
                lost,
                "records of the interval were lost: this program was too slow to take them",
                RuntimeError,
            )
            if len(records):
                self._keep(records)
            if self.ended:
                self._reader = None  # otherwise a loop on a virtual clock waits for the reader
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
        # Radius of the sphere's widest section below the surface
        width = np.sqrt(np.maximum(self._radius**2 - np.maximum(z, 0.0) ** 2, 0.0))
        # In the order of ENDINGS, which decides between two endings at one tick.
        late = ticks["time"] >= self._duration - 0.5 * _PERIOD
        through = touched & (z - self._radius <= self._bottom)
        wall = touched & (z < self._radius) & (place + width[:, None] >= self._half).any(axis=1)
        violations = [
            (int(over.argmax()), kind) for kind, over in enumerate((late, through, wall)) if over.any()
        ]
        if violations:
            first, kind = min(violations)
            self.ended = ENDINGS[kind]
            ticks = ticks[: first + (self.ended != "time")]
        sent, wanted = (np.linalg.norm(burr[name][: len(ticks)], axis=1) for name in ("sent", "force"))
        self.clipped += int((sent < (1.0 - 1e-9) * wanted).sum())
        self._kept.append(ticks)

    def ticks(self) -> NDArray[np.void]:
        records: NDArray[Any] = np.concatenate(self._kept)
        records.flags.writeable = False
        return records
