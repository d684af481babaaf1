"""An experiment to be simulated: which forces and depths, how often, with which burrs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from burrlab.curve import VelocityCurve
from burrlab.fitting.observations import Data, Observations
from burrlab.indentation import Indentation

Series: TypeAlias = tuple[float, tuple[float, ...], int]  # radius [mm], forces [N] or depths [mm], repeats


@dataclass(frozen=True)
class Experiment:
    """What is measured in one data set: small, picklable, and without outcomes.

    Parameters
    ----------
    velocities : sequence of (radius, forces, repeats)
        Velocity-force curves over the default window: burr radius [mm], forces [N], runs a force.
    static : sequence of (radius, depths, repeats)
        Static indentations: burr radius [mm], depths [mm], readings a depth.

    Raises
    ------
    ValueError
        If a radius, force or depth is not positive and finite, a series is empty, or repeats is below 1.

    Examples
    --------
    >>> Experiment([(2.0, [0.8, 1.0, 1.2], 3), (4.0, [0.8, 1.2], 3)], static=[(3.0, [0.1, 0.2], 1)])
    Experiment(R = 2 mm: 3 forces 0.8..1.2 N x 3; R = 4 mm: 2 forces 0.8..1.2 N x 3; static R = 3 mm: 2 depths 0.1..0.2 mm x 1)
    """

    velocities: tuple[Series, ...]
    static: tuple[Series, ...] = ()

    def __init__(
        self,
        velocities: Sequence[tuple[float, Sequence[float], int]],
        static: Sequence[tuple[float, Sequence[float], int]] = (),
    ) -> None:
        for name, what, table in (("velocities", "forces", velocities), ("static", "depths", static)):
            object.__setattr__(self, name, tuple(_series(name, what, *row) for row in table))

    def __repr__(self) -> str:
        parts = [f"R = {R:g} mm: {_range(F, 'force', 'N')} x {k}" for R, F, k in self.velocities]
        parts += [f"static R = {R:g} mm: {_range(h, 'depth', 'mm')} x {k}" for R, h, k in self.static]
        return f"Experiment({'; '.join(parts)})"

    def observations(self) -> Observations:
        """The rows, every outcome 1 [mm/s] or [N]."""
        sets: list[Data] = [
            VelocityCurve(np.repeat(F, k), np.ones(len(F) * k), radius=R) for R, F, k in self.velocities
        ]
        sets += [Indentation(np.ones(len(h) * k), np.repeat(h, k), R) for R, h, k in self.static]
        return Observations.of(sets, None)


def _series(name: str, what: str, radius: float, values: Sequence[float], repeats: int) -> Series:
    numbers = tuple(float(value) for value in values)
    if not (0 < radius < np.inf):
        raise ValueError(f"radius in {name} must be positive and finite: got {radius!r}")
    if not numbers or not all(0 < number < np.inf for number in numbers):
        raise ValueError(f"{what} in {name} must be positive and finite, at least one: got {values!r}")
    if repeats < 1:
        raise ValueError(f"repeats in {name} must be at least 1: got {repeats!r}")
    return float(radius), numbers, int(repeats)


def _range(values: tuple[float, ...], noun: str, unit: str) -> str:
    return f"{len(values)} {noun}{'s'[: len(values) > 1]} {min(values):g}..{max(values):g} {unit}"
