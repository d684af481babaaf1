"""Dust, blood, water and a sucker, frame by frame, beside a bone or a recorded session."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import burrlab._core as _core
from burrlab._core import Camera, EffectParameters, Nozzle, Sucker, VoxelBone, read_bricks
from burrlab.common.check import real, refuse, require_type, scalar, seed_or_new
from burrlab.session.player import TracePlayer

#: (merge_to, sub_steps, done): the clock's decision in a frame.
Decision = tuple[int, int, int]
#: (seconds, tick, decision): inputs of a companion's frame.
FrameRecord = tuple[float, int, Decision]
BurrAt = tuple[ArrayLike, float]


@dataclass(frozen=True)
class SubstanceBalance:
    """One substance's account in quanta of one level of one voxel, dV/255.

    Attributes
    ----------
    made : int
        Made by the burr, a wound or the nozzle.
    present : int
        In parcels; summed up anew.
    sucked : int
        Taken up by the sucker.
    drained : int
        Left the box around the volume.
    quantum : float
        [mm^3]
    """

    made: int
    present: int
    sucked: int
    drained: int
    quantum: float

    @classmethod
    def of(
        cls, accounts: Mapping[str, tuple[int, int, int, int]], quantum: float
    ) -> "dict[str, SubstanceBalance]":
        """The accounts of the core, by substance."""
        return {name: cls(*account, quantum) for name, account in accounts.items()}

    @property
    def exact(self) -> bool:
        """Whether made = present + sucked + drained."""
        return self.made == self.present + self.sucked + self.drained

    def volumes(self) -> dict[str, float]:
        """The account in mm^3."""
        return {name: getattr(self, name) * self.quantum for name in ("made", "present", "sucked", "drained")}

    def __str__(self) -> str:
        volumes = ", ".join(f"{name} {volume:.3f}" for name, volume in self.volumes().items())
        return f"{volumes} mm^3{'' if self.exact else ', NOT BALANCED'}"


@dataclass(frozen=True, repr=False)
class EffectsReport:
    """Frames, their time, and what was given up.

    Attributes
    ----------
    frames : int
        Frames made so far.
    budget : float or None
        Time limit of a frame [s].
    over_budget : int
        Frames that took longer, on the wall clock.
    coarse, cut : int
        Frames planned with fewer sub-steps than asked for; frames whose last sub-steps became one.
    skipped : int
        Frames that late ones stand for.
    crowded, merged : int
        Frames that merged parcels to save time; parcels merged into others, to save time or at the limit.
    sub_steps_least, sub_steps_most : int
    sub_steps_mean : float
        Sub-steps of a frame.
    parcels_most : int
        Most parcels at the end of a frame.
    wall_ms, cpu_ms : dict
        p50, p90, p99, p999 and max of a frame's time [ms]: on the wall clock, and its thread's CPU time.
    """

    frames: int
    budget: float | None
    over_budget: int
    coarse: int
    cut: int
    crowded: int
    skipped: int
    merged: int
    sub_steps_least: int
    sub_steps_most: int
    sub_steps_mean: float
    parcels_most: int
    wall_ms: dict[str, float]
    cpu_ms: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """The report for JSON."""
        return asdict(self)

    def __repr__(self) -> str:
        return f"EffectsReport({self.frames} frames, {self.over_budget} over budget)"

    def __str__(self) -> str:
        if not self.frames:
            return "no frame yet"
        lines = [
            f"{self.frames} frames of at most {self.parcels_most} parcels",
            f"a frame took: p50 {self.wall_ms['p50']:.2f} ms, p99 {self.wall_ms['p99']:.2f} ms, at most "
            f"{self.wall_ms['max']:.2f} ms (CPU time p99 {self.cpu_ms['p99']:.2f} ms)",
            f"sub-steps {self.sub_steps_least} to {self.sub_steps_most}, {self.sub_steps_mean:.2f} in "
            "the mean",
            f"{self.merged} parcels merged, {self.skipped} frames left out",
        ]
        if self.budget is not None:
            lines += [
                f"budget {1e3 * self.budget:g} ms: {self.over_budget} frames over it",
                f"given up: {self.coarse} frames with fewer sub-steps, {self.cut} cut, {self.crowded} with "
                "parcels merged",
            ]
        return "\n".join(lines)


class Effects(_core.Effects):
    """Dust, blood, water and paste in the field of view.

    Parcels carry integer quanta of mass; a quantum is one level of one voxel. For each substance, after
    every frame, made = present + sucked + drained exactly.

    Parameters
    ----------
    bone : VoxelBone
        Its levels are copied. Bone that is gone by then makes no dust. Blood needs tissues that bleed.
    parameters : EffectParameters, optional
        The default values are assumed.
    seed : int, optional
        Default: a random one; the attribute `seed` holds it.
    down, spin : (x, y, z)
        Direction of gravity; axis that the burrs turn about, right-handed. Both are assumed.
    camera : Camera, optional
        For `hidden`. Also an attribute, read at each frame.
    nozzle : Nozzle, optional
    sucker : Sucker, optional
    budget : float, optional
        Time limit of a frame [s]. Without it nothing depends on the clock: the same frames give the same
        parcels.

    Raises
    ------
    ValueError
        If a direction is zero, the budget is not positive, the seed is out of range, or voxels are too small,
        too large or too far from 0 to be counted.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.effects import Effects, Nozzle
    >>> bone = burrlab.VoxelBone.block((10, 10, 5), 0.25, origin=(-4.9, -4.9, -4.9))
    >>> effects = Effects(bone, seed=1, nozzle=Nozzle((0, 0, 5), (0, 0, -1), rate=100, burr=None))
    >>> for _ in range(20):
    ...     decision = effects.step(0.05)
    >>> water = effects.balance()["water"]
    >>> water.exact, round(water.volumes()["made"])
    (True, 100)
    """

    def __init__(
        self,
        bone: VoxelBone,
        *,
        parameters: EffectParameters | None = None,
        seed: int | None = None,
        down: ArrayLike = (0.0, 0.0, -1.0),
        spin: ArrayLike = (0.0, 0.0, 1.0),
        camera: Camera | None = None,
        nozzle: Nozzle | None = None,
        sucker: Sucker | None = None,
        budget: float | None = None,
    ) -> None:
        for name, part, kind, example in (
            ("camera", camera, Camera, "Camera((0, -40, 60), (0, 0, 0))"),
            ("nozzle", nozzle, Nozzle, "Nozzle()"),
            ("sucker", sucker, Sucker, "Sucker()"),
        ):
            if part is not None:
                require_type(name, part, kind, example)
        self.parameters = EffectParameters() if parameters is None else parameters
        self.seed = seed_or_new(seed)
        self.budget = budget
        self._bricks = tuple(-(-int(side) // 8) for side in bone.shape)
        super().__init__(
            bone, parameters=self.parameters, seed=self.seed, down=real(down, "down"),
            spin=real(spin, "spin"), budget=budget,
        )  # fmt: skip
        self.nozzle, self.sucker, self.camera = nozzle, sucker, camera
        self._hidden = float("nan")

    def step(
        self,
        dt_s: float,
        update: Mapping[str, Any] | None = None,
        burrs: Sequence[BurrAt] = (),
        *,
        decision: Decision | None = None,
    ) -> Decision:
        """Makes one frame.

        Parameters
        ----------
        dt_s : float
            Time that the frame stands for [s], at most 10.
        update : mapping, optional
            Changes of the bone since the last frame, as `Follower.take` returns them: `bricks` (n, 3) (z, y,
            x), or their numbers (n,), and `density`, 512 levels each.
        burrs : list of (center, radius)
            Places and radii of the burrs [mm].
        decision : (merge_to, sub_steps, done), optional
            Decision of the same frame in another run, in place of the clock's.

        Returns
        -------
        (int, int, int)
            The decision: most parcels before they move, sub-steps planned, sub-steps after which the rest
            was made in one.

        Raises
        ------
        ValueError
            If the time is out of range, a brick is not in the volume, a burr or a decision is wrong.
        """
        bricks, density = np.empty(0, np.uint32), np.empty(0, np.uint8)
        if update is not None:
            bricks = self._numbers(np.asarray(update["bricks"]))
            density = np.ascontiguousarray(update["density"], np.uint8)
        places = [np.ravel(real(center, "center of a burr")) for center, _ in burrs]
        centers = np.array(places) if places else np.empty((0, 3))
        radii = np.array([scalar(radius, "radius") for _, radius in burrs])
        done = self.make_frame(scalar(dt_s, "dt_s"), bricks, density, centers, radii, decision)
        self._hidden = float("nan")
        if (
            self.camera is not None
            and len(radii)
            and np.linalg.norm(np.asarray(self.camera.position, float) - centers[0]) > radii[0]
        ):
            self._hidden = self.hidden_fraction(self.camera, burrs[0])
        return done

    @property
    def hidden(self) -> float:
        """Hidden part of burr 0 in the newest frame; nan without a camera or a burr."""
        return self._hidden

    def _numbers(self, bricks: NDArray[Any]) -> NDArray[np.uint32]:
        if bricks.ndim == 2 and bricks.shape[1] == 3:
            refuse(
                not ((bricks >= 0) & (bricks < self._bricks)).all(),
                f"bricks must lie inside the {self._bricks} bricks of the volume",
            )
            bricks = np.ravel_multi_index(tuple(bricks.T.astype(np.intp)), self._bricks)
        return np.ascontiguousarray(bricks, np.uint32)

    def balance(self) -> dict[str, SubstanceBalance]:
        """Accounts of dust, blood and water."""
        return SubstanceBalance.of(self.quanta(), self.quantum)

    def hidden_fraction(self, camera: Camera, burr: BurrAt) -> float:
        """Part of a burr's projected disc that parcels in front of it hide, 0 to 1.

        Parameters
        ----------
        camera : Camera
        burr : (center, radius)
            [mm]

        Returns
        -------
        float
            Sampled at 64 x 64 points of the disc's frame, with the parcels' opacity. nan if the burr is not
            in the picture.

        Raises
        ------
        ValueError
            If the camera lies in the burr, or the burr is not finite.
        """
        center, radius = burr
        return self.hidden_part(camera, real(center, "center of a burr"), scalar(radius, "radius"))

    def report(self) -> EffectsReport:
        """Frames, their time, and what was given up."""
        return EffectsReport(budget=self.budget, **self.counts())

    def __repr__(self) -> str:
        return f"Effects({self.report().frames} frames, seed={self.seed})"


def effects_of(
    player: TracePlayer,
    effects: Effects,
    *,
    rate: float = 20.0,
    frames: Sequence[FrameRecord] | None = None,
) -> Iterator[float]:
    """Goes through a trace frame by frame and steps the effects with each.

    Parameters
    ----------
    player : TracePlayer
        Begins at its present time, where its bone must be the one that `effects` was made with.
    effects : Effects
        Without a budget the same trace gives the same parcels.
    rate : float
        Frames a second of the trace [Hz]. The last frame is shorter if the trace ends within it.
    frames : list of (seconds, tick, decision), optional
        `Companion.frames` of the recorded session, in place of the rate. With the companion's seed,
        parameters, nozzle and sucker they give its parcels again, to the bit. Changes made during the session
        must be made here too, between the same frames.

    Yields
    ------
    float
        Time of the trace after the frame just made [s].

    Raises
    ------
    TypeError
        If `player` is none, but a trace, for example.
    ValueError
        If the rate is not positive, or a frame saw a tick that the trace does not hold.

    Examples
    --------
    >>> player = burrlab.view.TracePlayer(trace)  # doctest: +SKIP
    >>> effects = Effects(player.bone, seed=1)  # doctest: +SKIP
    >>> for time in effects_of(player, effects):  # doctest: +SKIP
    ...     scene.set_parcels(effects.parcels)
    """
    require_type("player", player, TracePlayer, "TracePlayer(load_trace('session.h5'))")
    refuse(not 0 < rate < float("inf"), f"rate must be positive, got {rate!r}")
    if frames is None:
        return _stepped(player, effects, _at_rate(player, rate))
    first = player.trace.first_tick
    ticks = [tick for _, tick, _ in frames]
    if ticks and not first <= min(ticks) <= max(ticks) <= first + player.ticks:
        raise ValueError(
            f"ticks of the frames must be from {first} to {first + player.ticks}, got {min(ticks)} to "
            f"{max(ticks)}"
        )
    return _stepped(
        player, effects, ((player.seek_tick(tick), seconds, decision) for seconds, tick, decision in frames)
    )


#: Bricks that changed, seconds that a frame stands for, the clock's decision.
_Move = tuple[NDArray[np.uint32], float, Decision | None]


def _at_rate(player: TracePlayer, rate: float) -> Iterator[_Move]:
    begin = player.time
    for frame in itertools.count(1):
        if player.done == player.ticks:
            return
        end = begin + frame / rate
        over = end - player.duration
        yield player.seek(min(end, player.duration)), 1 / rate - (over if over > 1e-6 else 0.0), None


def _stepped(player: TracePlayer, effects: Effects, moves: Iterable[_Move]) -> Iterator[float]:
    for bricks, seconds, decision in moves:
        burrs = list(zip(player.burrs.centers, player.burrs.radii, strict=True)) if player.done else []
        update = {"bricks": bricks, "density": read_bricks(player.bone, bricks)}
        effects.step(seconds, update, burrs, decision=decision)
        yield player.time
