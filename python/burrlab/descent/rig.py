"""The rig of the descent experiment: it moves a burr along an axis and measures the force."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from burrlab._core import BurrContact
from burrlab.bone.specimen import Specimen
from burrlab.common.check import check_positive, refuse, require_type


class RigReading(NamedTuple):
    """One sample of a rig."""

    position: float  #: along the axis, growing into the bone [mm]
    force: float  #: axial, positive where bone pushes the burr out [N]


@runtime_checkable
class Rig(Protocol):
    """The interface of a rig, real or virtual, for `descend`.

    `period` is the time between samples [ms], `force_limit` the largest force that the load cell measures
    [N], `surface` the position at which the tip touches the untouched surface [mm]; None takes it from the
    first contact.
    """

    period: float
    force_limit: float
    surface: float | None

    def read(self) -> RigReading:
        """Waits for the next sample, one period after the last."""

    def command(self, velocity: float) -> None:
        """Sets the velocity along the axis until the next command [mm/s]; positive is into the bone."""


class VirtualRig:
    """A rig over a voxel bone, with the imperfections of a real one.

    Parameters
    ----------
    contact : BurrContact
        The burr on the bone, which the rig erodes.
    specimen : Specimen
        Surface point and axis.
    period : float
        Tick and sample time [ms].
    velocity_limit : float
        [mm/s]
    lag : float
        Time constant of the velocity [ms]; 0 switches it off.
    encoder_step : float
        Step of the position readings [mm]; 0 switches it off. The motion itself has no steps.
    noise : float
        Standard deviation of the load cell [N]; 0 switches it off.
    force_filter : float
        Time constant of the load cell's filter [ms]; 0 switches it off.
    force_limit : float
        Range of the load cell [N] (ours).
    clearance : float
        Distance of the tip from the surface at the start [mm].

    Raises
    ------
    ValueError
        If a value is negative or not finite, or a period or limit is not positive.

    Notes
    -----
    The paper gives positions to 10 um; limits, lag, noise and filter are our decisions.
    """

    surface: float | None = 0.0

    def __init__(
        self,
        contact: BurrContact,
        specimen: Specimen,
        *,
        period: float = 1.0,
        velocity_limit: float = 10.0,
        lag: float = 5.0,
        encoder_step: float = 0.01,
        noise: float = 0.005,
        force_filter: float = 2.0,
        force_limit: float = 20.0,
        clearance: float = 0.2,
    ) -> None:
        require_type("contact", contact, BurrContact, "BurrContact(bone, burr, material, seed=1)")
        require_type("specimen", specimen, Specimen, "half_space(burr, 0.1)")
        for name, value in (
            ("lag", lag), ("encoder_step", encoder_step), ("noise", noise), ("force_filter", force_filter)
        ):  # fmt: skip
            refuse(not 0 <= value < np.inf, f"{name} must be zero or positive and finite, got {value}")
        for name, value in (
            ("period", period), ("velocity_limit", velocity_limit), ("force_limit", force_limit)
        ):  # fmt: skip
            check_positive(name, value)
        refuse(not np.isfinite(clearance), f"clearance must be finite, got {clearance}")
        self.contact, self.specimen = contact, specimen
        self.period, self.velocity_limit, self.force_limit = period, velocity_limit, force_limit
        self.lag, self.encoder_step, self.noise, self.force_filter = lag, encoder_step, noise, force_filter
        self.immersion = -clearance  #: true position of the tip [mm]
        self.velocity = 0.0  #: true velocity [mm/s]
        self.touched = False  #: whether the burr met bone
        self.ambiguous = self.faint = 0  #: ticks flagged so (see `Contact`)
        self._command = self._filtered = 0.0
        self._random = np.random.default_rng([contact.seed & 0xFFFFFFFF, contact.seed >> 32, contact.index])

    def command(self, velocity: float) -> None:
        """Sets the velocity, clipped to the limit [mm/s]; ValueError unless finite."""
        refuse(not np.isfinite(velocity), f"velocity must be finite, got {velocity}")
        self._command = float(np.clip(velocity, -self.velocity_limit, self.velocity_limit))

    def read(self) -> RigReading:
        """The next sample: moves by one period, burrs and measures."""
        dt = self.period
        follow = 1.0 - np.exp(-dt / self.lag) if self.lag > 0 else 1.0
        self.velocity += follow * (self._command - self.velocity)
        self.immersion += self.velocity * 1e-3 * dt
        felt = self.contact.step(self.specimen.center(self.immersion, self.contact.burr), dt)
        self.touched = self.touched or felt.touching
        self.ambiguous += felt.ambiguous
        self.faint += felt.faint
        force = -float(felt.force @ self.specimen.axis)
        if self.noise > 0:
            force += self.noise * self._random.standard_normal()
        settle = 1.0 - np.exp(-dt / self.force_filter) if self.force_filter > 0 else 1.0
        self._filtered += settle * (force - self._filtered)
        step = self.encoder_step
        position = round(self.immersion / step) * step if step > 0 else self.immersion
        return RigReading(float(position), float(self._filtered))
