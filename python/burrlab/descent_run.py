"""The two ways to run a descent: force held exactly, and controller with rig."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from burrlab._core import Burr, BurrContact, ForceController, Material
from burrlab.descent_result import Series
from burrlab.regime import contact_stiffness
from burrlab.rig import Rig, RigReading
from burrlab.specimen import Specimen

#: Speed of the approach [mm/s] (ours).
APPROACH_SPEED = 1.0
#: Default gains from the stiffness k [N/mm] of the contact: Kp = 60/k [mm/s/N], Ti = 30 ms (ours).
LOOP_BANDWIDTH, INTEGRAL_TIME = 60.0, 0.03
#: Longest way without contact of a rig that does not know the surface, and longest retreat [mm] (ours).
LONGEST_APPROACH, RETREAT = 20.0, 5.0
#: Part of the set-point from which the integral of the default gains acts (ours).
ARRIVED = 0.95
_CHUNK = 256  # ticks between looks at progress and interrupts

Progress = Callable[[float], object]


class Watch:
    """Progress and interrupts of one run."""

    def __init__(self, stop: float, progress: Progress | None, cancel: threading.Event | None) -> None:
        self.stop, self.progress, self.cancel = stop, progress, cancel

    def interrupted(self, immersion: float) -> bool:
        if self.progress is not None:
            self.progress(min(max(immersion / self.stop, 0.0), 1.0))
        return self.cancel is not None and self.cancel.is_set()


def free_clearance(contact: BurrContact, specimen: Specimen, burr: Burr) -> float:
    """Distance of the tip from the surface at which a run begins out of contact [mm]."""
    for clearance in np.arange(0.2, 4 * burr.radius, 0.2):
        if not contact.probe(specimen.center(-clearance, burr)).touching:
            return float(clearance)
    raise ValueError("the burr touches bone all along its approach: choose another entry or axis")


def hold(
    contact: BurrContact,
    specimen: Specimen,
    force: float,
    stop: float,
    dt: float,
    max_duration: float,
    watch: Watch,
) -> tuple[Series, str]:
    """The exact mode: every tick acts where the force is as asked."""
    burr = contact.burr
    start = specimen.center(0.0, burr)
    immersion = -free_clearance(contact, specimen, burr)
    limit = int(np.ceil(max_duration * 1e3 / dt))
    positions, forces, removed = [], [], []
    done, ending, ambiguous, faint = 0, "stalled", 0, 0
    try:
        while done < limit:
            part = contact.hold(
                force,
                start,
                specimen.axis,
                from_=immersion,
                travel=stop,
                dt=dt,
                ticks=min(_CHUNK, limit - done),
            )
            positions.append(part.position)
            forces.append(part.force)
            removed.append(part.removed)
            done += len(part.position)
            ambiguous += part.ambiguous
            faint += part.faint
            immersion = float(part.position[-1]) if len(part.position) else immersion
            if part.reached:
                ending = "stop" if done else _without_hold(contact, specimen, stop)
                break
            if watch.interrupted(immersion):
                ending = "interrupted"
                break
    except KeyboardInterrupt:
        ending = "interrupted"
    return Series(
        time=np.arange(done, dtype=np.float64) * (1e-3 * dt),
        immersion=np.concatenate(positions) if positions else np.empty(0),
        force=np.concatenate(forces) if forces else np.empty(0),
        command=np.full(done, np.nan),
        exact=True,
        ambiguous=ambiguous,
        faint=faint,
    ), ending


def _without_hold(contact: BurrContact, specimen: Specimen, stop: float) -> str:
    depths = np.linspace(0.0, stop, 50)
    touched = any(contact.probe(specimen.center(h, contact.burr)).touching for h in depths)
    return "overloaded" if touched else "never-touched"


def control(
    rig: Rig,
    burr: Burr,
    material: Material | None,
    force: float,
    controller: ForceController | None,
    stop: float,
    max_duration: float,
    watch: Watch,
) -> tuple[Series, str]:
    """Approach, then force control, until the stop."""
    scheduled = controller is None
    pid = controller if controller is not None else ForceController(0.0)
    c_e = None if material is None else material.c_e
    surface = rig.surface
    rows: list[tuple[float, float, float]] = []
    command, engaged, arrived, ending = APPROACH_SPEED, False, False, "stalled"
    limit = int(np.ceil(max_duration * 1e3 / rig.period))
    first: float | None = None
    try:
        rig.command(command)
        for tick in range(limit):
            reading = rig.read()
            _check_reading(reading, tick, force)
            rows.append((reading.position, reading.force, command))
            first = reading.position if first is None else first
            if reading.force >= rig.force_limit:
                ending = "overloaded"
                break
            travelled = reading.position - first
            if travelled < -RETREAT or (surface is None and travelled > LONGEST_APPROACH):
                ending = "stalled" if engaged else "never-touched"
                break
            if not engaged:
                threshold = _contact_threshold(force, rows)
                if c_e is not None and surface is not None:
                    engaged = reading.force >= threshold
                elif reading.force >= max(0.3 * force, threshold):
                    found_c_e, found_surface = _first_contact(rows, 0.1 * force, burr.radius)
                    c_e = found_c_e if c_e is None else c_e
                    surface = found_surface if surface is None else surface
                    engaged = True
                if engaged:
                    pid.reset(integral=APPROACH_SPEED)
            immersion = reading.position - (surface if surface is not None else np.inf)
            if engaged:
                assert c_e is not None
                if scheduled:
                    kp = LOOP_BANDWIDTH / contact_stiffness(c_e, burr.radius, force, immersion)
                    # The integral keeps its preset until the force arrives: else it winds up in the impact.
                    arrived = arrived or reading.force >= ARRIVED * force
                    pid.set_gains(kp, kp / INTEGRAL_TIME if arrived else 0.0)
                command = pid.update(force, reading.force, rig.period)
                rig.command(command)
            if immersion >= stop:
                ending = "stop" if engaged or getattr(rig, "touched", False) else "never-touched"
                break
            if tick % 64 == 0 and watch.interrupted(max(immersion, 0.0)):
                ending = "interrupted"
                break
    except KeyboardInterrupt:
        ending = "interrupted"
    finally:
        rig.command(0.0)
    table = np.array(rows, dtype=float).reshape(-1, 3)
    zero = surface if surface is not None else (first or 0.0)
    return Series(
        time=np.arange(len(table), dtype=np.float64) * (1e-3 * rig.period),
        immersion=table[:, 0] - zero,
        force=table[:, 1],
        command=table[:, 2],
        exact=False,
        noise=float(getattr(rig, "noise", 0.0)),
        ambiguous=int(getattr(rig, "ambiguous", 0)),
        faint=int(getattr(rig, "faint", 0)),
    ), ending


def _check_reading(reading: RigReading, tick: int, setpoint: float) -> None:
    """ValueError on a reading that no command may follow; the rig is stopped then."""
    if not (np.isfinite(reading.position) and np.isfinite(reading.force)):
        raise ValueError(
            f"the rig's reading must be finite, got {tuple(reading)} at sample {tick}; it was stopped"
        )
    if reading.force < -max(0.5 * setpoint, 0.1):
        raise ValueError(
            f"the rig's force must be positive where bone pushes the burr out, got {reading.force:.4g} N at sample "
            f"{tick}; it was stopped"
        )


def _contact_threshold(force: float, rows: list[tuple[float, float, float]]) -> float:
    """Measured force that counts as contact [N]: a tenth of the set-point, and out of the cell's noise."""
    if len(rows) < 20:
        return max(0.1 * force, 0.05)
    recent = np.array([row[1] for row in rows[:200]])
    return max(0.1 * force, 5 * float(np.std(recent[: max(len(recent) // 2, 10)])))


def _first_contact(
    rows: list[tuple[float, float, float]], above: float, radius: float
) -> tuple[float, float]:
    """c_e [N/mm^2] and surface position [mm] from the approach: F^(2/3) = (c_e sqrt(R))^(2/3) (x - x_0)."""
    table = np.array(rows)
    first = int(np.argmax(table[:, 1] > above))
    pressed = table[first:]
    if np.ptp(pressed[:, 0]) == 0:  # within one step of the encoder: from the step before it
        before = np.flatnonzero(table[:first, 0] < pressed[0, 0])
        if before.size == 0:
            raise ValueError("the rig's position must change before its force rises; it was stopped")
        pressed = table[before[-1] :]
    slope, intercept = np.polyfit(pressed[:, 0], np.maximum(pressed[:, 1], 0.0) ** (2 / 3), 1)
    slope = max(float(slope), 1e-3)
    return slope**1.5 / np.sqrt(radius), float(-intercept / slope)
