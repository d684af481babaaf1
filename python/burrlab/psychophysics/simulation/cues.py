"""What an interval tells of its material: stiffness and force by probing, sinking speed by drilling."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Material
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.experiment.interval import Rendered, render
from burrlab.psychophysics.simulation.hands import DRILLING_PUSH, PROBING_PUSH, drilling_hand, probing_hand
from burrlab.psychophysics.trial import Interval, Mode, Stimulus

CueName: TypeAlias = Literal["stiffness", "force", "sinking"]

CUES: tuple[CueName, ...] = ("stiffness", "force", "sinking")
CUES_OF: dict[Mode, tuple[CueName, ...]] = {"probing": ("stiffness", "force"), "drilling": ("sinking",)}

IMMERSION = 0.2  # [mm] at which the force is felt; ours

# A press begins above the one part of the interval's largest force, and ends below the other.
_BEGIN, _END = 0.5, 0.2


@dataclass(frozen=True)
class Cues:
    """Natural logarithms of an interval's cues; NaN where the mode, or what happened, does not have it.

    Attributes
    ----------
    stiffness : float
        Of the force at a press's height over the penetration there, mean over presses [N/mm].
    force : float
        Of the force at 0.2 mm immersion on the way in, mean over presses [N].
    sinking : float
        Of the depth of the tip below the untouched surface, at its deepest, a second of contact [mm/s].
    presses : int
        That were found; 0 by drilling.
    """

    stiffness: float = math.nan
    force: float = math.nan
    sinking: float = math.nan
    presses: int = 0

    def to_dict(self) -> dict[str, float | int | None]:
        """For JSON; None where there is no value."""
        return {k: None if math.isnan(v) else v for k, v in asdict(self).items()}


def interval_cues(rendered: Rendered) -> Cues:
    """The cues of what was rendered.

    Parameters
    ----------
    rendered : Rendered
        By a simulated hand or by a person.

    Returns
    -------
    Cues
        By probing stiffness and force, by drilling sinking speed.

    Notes
    -----
    Force and penetration are the model's, at the burr; friction and inertia of the hand are not in them. A press is a
    time in which the force exceeds half of the interval's largest and has not yet fallen below a fifth of it.
    """
    depth, force = rendered.immersion, np.linalg.norm(rendered.ticks["force"], axis=1)
    if rendered.mode == "drilling":
        if rendered.contact <= 0.0 or not depth.max() > 0.0:
            return Cues()
        return Cues(sinking=math.log(float(depth.max()) / rendered.contact))
    stiffness, at_depth = [], []
    before = 0
    for start, end in _presses(force):
        peak = start + int(np.argmax(force[start:end]))
        stiffness.append(force[peak] / rendered.ticks["penetration"][peak])
        at_depth.append(_force_on_the_way(depth[before : peak + 1], force[before : peak + 1]))
        before = end
    return Cues(stiffness=_log_mean(stiffness), force=_log_mean(at_depth), presses=len(stiffness))


def closed_form_cues(material: Material, *, burr: Burr) -> Cues:
    """The cues that the equations give without voxels, hands or time.

    Parameters
    ----------
    material : Material
    burr : Burr

    Returns
    -------
    Cues
        Stiffness at `PROBING_PUSH` and force at 0.2 mm on a flat surface, where h = H:
        F = c_e R^2 (h/R)^{3/2} (Eq. 3). Sinking is ln(alpha R phi^{8/3}), phi = F/(c_e R^2), at `DRILLING_PUSH`: the law
        of small forces and thin layers, up to a factor that all materials share. Only differences of it mean something.

    Examples
    --------
    >>> import burrlab
    >>> a, b = (closed_form_cues(burrlab.materials[name], burr=burrlab.Burr(3.0)) for name in ("bone", "pvc"))
    >>> print(f"{a.stiffness - b.stiffness:.3f} {a.force - b.force:.3f} {b.sinking - a.sinking:.3f}")
    1.024 1.535 5.173
    """
    scale = material.c_e * burr.radius**2
    penetration = burr.radius * (PROBING_PUSH / scale) ** (2.0 / 3.0)
    return Cues(
        stiffness=math.log(PROBING_PUSH / penetration),
        force=math.log(scale * (IMMERSION / burr.radius) ** 1.5),
        sinking=math.log(material.alpha * burr.radius) + 8.0 / 3.0 * math.log(DRILLING_PUSH / scale)
        if material.alpha > 0.0
        else -math.inf,
    )


@functools.lru_cache(maxsize=512)
def rendered_cues(
    material: Material, mode: Mode, *, burr: Burr, bone: Block, duration: float = 20.0, seed: int = 1
) -> Cues:
    """The cues of an interval that the simulated hand of this mode felt on the virtual clock; kept for the next call.

    Parameters
    ----------
    material : Material
    mode : {"probing", "drilling"}
    burr : Burr
    bone : Block
    duration : float
        [s]
    seed : int
        Of the erosion.

    Returns
    -------
    Cues

    Raises
    ------
    ValueError
        As `render`.
    """
    hand = probing_hand(burr) if mode == "probing" else drilling_hand(burr)
    interval = Interval(Stimulus(material.name, material), seed, duration)
    return interval_cues(render(interval, hand, burr=burr, bone=bone, mode=mode, wall_clock=False))


def _presses(force: NDArray[np.float64]) -> Iterator[tuple[int, int]]:
    """(first tick, tick after the last) of each press."""
    largest = float(force.max(initial=0.0))
    if largest <= 0.0:
        return
    above, below = force >= _BEGIN * largest, force < _END * largest
    at = 0
    while at < len(force) and above[at:].any():
        start = at + int(np.argmax(above[at:]))
        at = start + int(np.argmax(below[start:])) if below[start:].any() else len(force)
        yield start, at


def _force_on_the_way(depth: NDArray[np.float64], force: NDArray[np.float64]) -> float:
    """Where the burr last came past the immersion on its way in; NaN where it was deeper all the time."""
    crossings = np.flatnonzero((depth[:-1] < IMMERSION) & (depth[1:] >= IMMERSION))
    if not len(crossings):
        return math.nan
    i = int(crossings[-1])
    part = (IMMERSION - depth[i]) / (depth[i + 1] - depth[i])
    return float(force[i] + part * (force[i + 1] - force[i]))


def _log_mean(values: list[float]) -> float:
    there = [value for value in values if value > 0.0]
    return math.log(sum(there) / len(there)) if there else math.nan
