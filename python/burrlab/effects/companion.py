"""Secondary effects beside a running session, or on a replica of one."""

import os
import weakref
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import (
    Camera,
    EffectParameters,
    EffectsCompanion,
    Follower,
    HapticLoop,
    Nozzle,
    Replica,
    Sucker,
)
from burrlab.common.check import real, scalar, seed_or_new
from burrlab.effects.effects import EffectsReport, SubstanceBalance
from burrlab.session.session import Session

DEFAULT_BUDGET = 0.020  # [s]


class Companion(EffectsCompanion):
    """Runs effects in their own thread, fed by the session's follower or a replica; the loop is untouched.

    Parameters
    ----------
    session : Session or Replica
        A session, started or not, or a started replica. Bone that is gone already makes no dust. For all
        dust, make the companion before the session starts.
    rate : float
        Frames a second, 1 to 200 [Hz], on the wall clock.
    budget : float, optional
        Time limit of a frame [s]; None: no limit.
    realtime : bool
        Asks for a priority above ordinary threads and below the loop's, so that other programs do not delay
        frames. Only with a budget of at most half a period. `realtime_notes` says what was granted.
    camera : Camera, optional
        For `hidden_fraction`.
    nozzle, sucker, parameters, seed, down, spin
        As for `Effects`. A nozzle that moves with a burr gives no water before the first tick.

    Raises
    ------
    ValueError
        If rate or budget is out of range, the replica was not started, or the companion is started twice.

    Notes
    -----
    A companion ends by itself one frame after the session, when all removed bone has become dust. It also
    ends when a session that was never started is gone. It keeps the wall clock even if the session has a
    virtual clock.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.effects import Companion
    >>> bone = burrlab.VoxelBone.block((12, 12, 4), 0.2, origin=(-5.9, -5.9, -3.9))
    >>> tool = burrlab.Burr(2.0), burrlab.materials["bone"]
    >>> hand = burrlab.HandDevice((0, 0, 2.1))
    >>> session = burrlab.Session(bone, tool, hand, seed=1, duration=0.3, clock=burrlab.Clock(wall_clock=False))
    >>> with Companion(session, seed=1) as companion, session:
    ...     ended = session.wait() and companion.wait(5)
    >>> dust = companion.balance()["dust"]
    >>> ended, dust.exact, dust.made * dust.quantum == session.snapshot()[0].removed
    (True, True, True)
    """

    def __init__(
        self,
        session: Session | Replica,
        *,
        rate: float = 20.0,
        budget: float | None = DEFAULT_BUDGET,
        realtime: bool = True,
        camera: Camera | None = None,
        nozzle: Nozzle | None = None,
        sucker: Sucker | None = None,
        parameters: EffectParameters | None = None,
        seed: int | None = None,
        down: ArrayLike = (0.0, 0.0, -1.0),
        spin: ArrayLike = (0.0, 0.0, 1.0),
    ) -> None:
        self.parameters = EffectParameters() if parameters is None else parameters
        self.seed = seed_or_new(seed)
        self.rate = scalar(rate, "rate")
        self.budget = budget
        self._process = os.getpid()
        setup: dict[str, Any] = {
            "parameters": self.parameters, "seed": self.seed, "down": real(down, "down"),
            "spin": real(spin, "spin"), "budget": budget, "rate": self.rate, "realtime": bool(realtime),
        }  # fmt: skip
        if isinstance(session, Replica):
            super().__init__(session, **setup)
        else:
            super().__init__(session.loop, session.follower, **setup)
            weakref.finalize(session, _nobody_starts, session.loop, session.follower).atexit = False
        self.set_camera(camera)
        self.set_nozzle(nozzle)
        self.set_sucker(sucker)

    def stop(self) -> None:
        """Ends the thread after the current frame. Further calls, and calls in a fork, do nothing."""
        if self._process == os.getpid():
            super().stop()

    def wait(self, seconds: float | None = None) -> bool:
        """Waits at most `seconds` [s] for the thread's end; returns whether it came. Can be interrupted."""
        left = float("inf") if seconds is None else seconds
        while left > 0 and not super().wait(min(left, 0.1)):
            left -= 0.1
        return not self.running

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def newest(self) -> dict[str, Any]:
        """Values of the newest frame: frame (made so far), tick, parcels, balance, removed (levels by tissue
        number), bleeding [mm^3/s], hidden (of burr 0; nan without camera or burr)."""
        raw = super().newest()
        del raw["report"]
        return raw | {"balance": SubstanceBalance.of(raw["balance"], self.quantum)}

    @property
    def parcels(self) -> NDArray[np.void]:
        """A copy of the newest frame's parcels, as `Effects.parcels`."""
        return cast("NDArray[np.void]", self.newest()["parcels"])

    @property
    def hidden(self) -> float:
        """Hidden part of burr 0 in the newest frame; nan without a camera or before the first tick."""
        return float(self.newest()["hidden"])

    def balance(self) -> dict[str, SubstanceBalance]:
        """Accounts of dust, blood and water after the newest frame."""
        return cast("dict[str, SubstanceBalance]", self.newest()["balance"])

    def report(self) -> EffectsReport:
        """Frames, their whole time (asking the follower, moving, copying out), and what was given up."""
        return EffectsReport(budget=self.budget, **super().newest()["report"])

    def __repr__(self) -> str:
        return f"Companion({'' if self.running else 'not '}running, {self.report().frames} frames)"


def _nobody_starts(loop: HapticLoop, follower: Follower) -> None:
    """Ends the wait for the start of a session that is gone."""
    if not loop.started:
        follower.stop()
