"""The descent experiment: a burr sinks into bone at a force held exactly, or by a controller and a rig."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, BurrContact, ForceController, HeldDescent, Material
from burrlab.bone.specimen import Border, Specimen, Vector, checked_spacing, half_space
from burrlab.common.check import check_positive, refuse, require_type, scalar, seed_or_new
from burrlab.common.progress import Progress, doing, reporter
from burrlab.common.provenance import provenance
from burrlab.descent.result import Descent, Series, evaluate
from burrlab.descent.rig import Rig, RigReading, VirtualRig
from burrlab.theory.closed_forms import contact_stiffness
from burrlab.theory.tool import require_tool


@dataclass(frozen=True, kw_only=True)
class DescentSettings:
    """How the ticks of a descent run, and when it ends.

    Parameters
    ----------
    dt : float
        Tick [ms]; a rig has its own period.
    scheme : {"layer", "cell"}
        See `BurrContact`.
    stop : float, optional
        Immersion at which the run ends [mm]; default R/3.
    max_duration : float
        Time after which a run that has not reached the stop is stalled [s].

    Raises
    ------
    ValueError
        If a number is not positive.
    """

    dt: float = 1.0
    scheme: str = "layer"
    stop: float | None = None
    max_duration: float = 120.0

    def __post_init__(self) -> None:
        check_positive("dt", self.dt)
        if self.stop is not None:
            check_positive("stop", scalar(self.stop, "stop"))
        check_positive("max_duration", self.max_duration)


def descend(
    burr: Burr,
    material: Material | None,
    force: float,
    *,
    voxel: float | Vector = 0.1,
    seed: int | None = None,
    ideal: bool = False,
    specimen: Specimen | None = None,
    rig: Rig | None = None,
    controller: ForceController | None = None,
    settings: DescentSettings = DescentSettings(),
    progress: Progress | None = None,
    cancel: threading.Event | None = None,
) -> Descent:
    """Sink a burr at constant force and measure its penetration velocity.

    Parameters
    ----------
    burr : Burr
    material : Material or None
        Material of the bone. None only with a `rig` of your own: gains then follow the first contact.
    force : float
        Set-point of the axial force [N].
    voxel : float or (x, y, z)
        Voxel spacing of the block [mm]; not used with a specimen or rig.
    seed : int, optional
        Seed of erosion, load cell noise and the burr's place within a voxel of the block; not used with a rig
        of your own. None draws one and records it.
    ideal : bool
        Hold the force exactly: every tick solves the position, without rig and controller.
    specimen : Specimen, optional
        Default: a half-space of solid bone. The run burrs a copy.
    rig : Rig, optional
        Default: a `VirtualRig` with its default imperfections.
    controller : ForceController, optional
        With fixed gains. Default: gains that follow the stiffness of the contact.
    settings : DescentSettings
        Tick, scheme and end of the run.
    progress : callable or True, optional
        Called from time to time with the fraction of the way to the stop; True shows a bar. None writes a
        note to the logger ``burrlab`` where the run has more than 2 s to go.
    cancel : threading.Event, optional
        Ends the run with status ``interrupted``, as Ctrl-C does.

    Returns
    -------
    Descent
        With a status; any but ``ok`` comes with its reason and no velocity.

    Raises
    ------
    TypeError
        If burr or material has another type.
    ValueError
        If the force is not positive or above the rig's range; the longest duration has too many ticks; the
        seed is out of range; the burr is below 4 voxels; or `material` is missing.

    Notes
    -----
    In a specimen with tissues, force and erosion are those of the tissues that the burr meets. Static
    immersion and the start of the window, phi and default gains come from the c_e and alpha of `material`:
    where the tissues differ much from it, give a controller, and read velocities with care.

    Examples
    --------
    >>> import burrlab
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> run = burrlab.descend(burr, bone, 2.0, voxel=0.2, seed=1, ideal=True)
    >>> run.status, 2.6 < run.penetration_velocity < 2.9
    ('ok', True)
    """
    require_tool(burr, *([] if material is None else [material]))
    check_positive("force", force)
    _check_arguments(material, settings, specimen, rig, controller, ideal)
    seed, dt, scheme, max_duration = seed_or_new(seed), settings.dt, settings.scheme, settings.max_duration
    stop = burr.radius / 3 if settings.stop is None else float(settings.stop)

    report = reporter(
        progress, f"descent at dt = {dt:g} ms, voxel = {voxel} mm" if progress is None else "descent"
    )

    def interrupted(immersion: float) -> bool:
        report(min(max(immersion / stop, 0.0), 1.0))
        return cancel is not None and cancel.is_set()

    contact: BurrContact | None = None
    if rig is None:
        assert material is not None
        specimen = _own_bone(specimen, burr, voxel, stop, seed)
        contact = BurrContact(specimen.bone, burr, material, seed=seed, scheme=scheme)
        if ideal:
            series, ending = hold(contact, specimen, force, stop, dt, max_duration, interrupted)
        else:
            longest = 2e3 / LOOP_BANDWIDTH if controller is None else np.inf
            refuse(dt > longest, f"dt must be at most {longest:.3g} ms, or the force swings: got {dt:g} ms")
            rig = VirtualRig(contact, specimen, period=dt, clearance=free_clearance(contact, specimen, burr))
    if rig is not None:
        refuse(
            force > rig.force_limit,
            f"force must be within the rig's range of {rig.force_limit:g} N, got {force:g} N",
        )
        dt = rig.period
        series, ending = control(rig, burr, material, force, controller, stop, max_duration, interrupted)
        # a given rig has its own bone and seed, if any
        contact, specimen = (rig.contact, rig.specimen) if isinstance(rig, VirtualRig) else (None, None)
    parameters: dict[str, Any] = {
        "seed": None if contact is None else contact.seed,
        "dt_ms": dt,
        "mode": "exact" if ideal else "rig",
        "stop_mm": stop,
    }
    cut = 0
    if contact is not None and specimen is not None:
        parameters |= {
            "scheme": contact.scheme,
            "spacing_mm": list(contact.bone.spacing),
            "digest": contact.bone.digest(),
            "specimen": specimen.source,
            "surface_mm": specimen.surface.tolist(),
            "axis": specimen.axis.tolist(),
        }
        if specimen.made:
            parameters["volume"] = dict(specimen.made)
        if len(series.immersion):
            way = np.append(0.0, series.immersion)[:, None] * specimen.axis + specimen.center(0.0, burr)
            cut = Border(contact.bone).count_cut(way, burr.radius)
    return evaluate(burr, material, force, stop, series, ending, provenance(**parameters), cut=cut)


def _check_arguments(
    material: Material | None, settings: DescentSettings, specimen: Specimen | None,
    rig: Rig | None, controller: ForceController | None, ideal: bool,
) -> None:  # fmt: skip
    """Errors of `descend`."""
    if specimen is not None:
        require_type("specimen", specimen, Specimen, "half_space(burr, 0.1)")
    if rig is not None:
        require_type("rig", rig, Rig, "VirtualRig(contact, specimen); without a rig, ideal=False makes it")
    period = settings.dt if rig is None or ideal else rig.period
    refuse(
        not settings.max_duration * 1e3 / period < 2**63,
        f"max_duration must be below 2^63 ticks of {period:g} ms, got {settings.max_duration:g} s",
    )
    refuse(material is None and (rig is None or ideal), "material must be given unless a rig of your own is")
    if controller is not None:
        require_type("controller", controller, ForceController, "ForceController(2.0)")
    refuse(not isinstance(ideal, bool), f"ideal must be True or False, got {ideal!r}", TypeError)
    refuse(ideal and rig is not None, "ideal and rig exclude one another: the exact mode has no rig")


def _own_bone(
    specimen: Specimen | None, burr: Burr, voxel: float | Vector, stop: float, seed: int
) -> Specimen:
    """A copy of the specimen; without one a half-space, at a place within a voxel that the seed draws."""
    if specimen is None:
        offset = place_in_voxel(seed) * checked_spacing(voxel, "voxel")
        with doing("the block of bone"):
            specimen = half_space(burr, voxel, depth=stop, offset=offset)
    return replace(specimen, bone=specimen.bone.copy())


def place_in_voxel(seed: int) -> NDArray[np.float64]:
    """The burr's place within a voxel (x, y, z), -0.5 to 0.5 of its edges, which a descent's seed draws."""
    return np.random.default_rng([seed & 0xFFFFFFFF, seed >> 32, 1]).uniform(-0.5, 0.5, 3)


#: Speed of the approach [mm/s] (ours).
APPROACH_SPEED = 1.0
#: Default gains from the stiffness k [N/mm] of the contact: Kp = 60/k [mm/s/N], Ti = 30 ms (ours); unstable above 2/60 s.
LOOP_BANDWIDTH, INTEGRAL_TIME = 60.0, 0.03
#: Longest way without contact of a rig without a known surface, and longest retreat [mm] (ours).
LONGEST_APPROACH, RETREAT = 20.0, 5.0
#: Fraction of the set-point from which the integral of the default gains acts (ours).
ARRIVED = 0.95
_CHUNK = 256  # ticks between looks at progress and interrupts


def reach(specimen: Specimen, burr: Burr, stop: float) -> NDArray[np.float64]:
    """First and last centre of the burr (x, y, z) [mm] in a descent, with retreat and overshoot, shape (2, 3)."""
    return np.array([specimen.center(h, burr) for h in (-4 * burr.radius - RETREAT, 2 * stop)])


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
    interrupted: Callable[[float], bool],
) -> tuple[Series, str]:
    """Series and ending of a run whose every tick acts where the force is the set-point."""
    burr = contact.burr
    start = specimen.center(0.0, burr)
    immersion = -free_clearance(contact, specimen, burr)
    limit = int(np.ceil(max_duration * 1e3 / dt))
    parts: list[HeldDescent] = []
    done, ending = 0, "stalled"
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
            parts.append(part)
            done += len(part.position)
            immersion = float(part.position[-1]) if len(part.position) else immersion
            if part.reached:
                if done:
                    ending = "stop"
                else:
                    touched = any(
                        contact.probe(specimen.center(h, burr)).touching for h in np.linspace(0.0, stop, 50)
                    )
                    ending = "overloaded" if touched else "never-touched"
                break
            if interrupted(immersion):
                ending = "interrupted"
                break
    except KeyboardInterrupt:
        ending = "interrupted"
    return Series(
        time=np.arange(done, dtype=np.float64) * (1e-3 * dt),
        immersion=np.concatenate([np.empty(0), *(part.position for part in parts)]),
        force=np.concatenate([np.empty(0), *(part.force for part in parts)]),
        command=np.full(done, np.nan),
        exact=True,
        ambiguous=sum(part.ambiguous for part in parts),
        faint=sum(part.faint for part in parts),
    ), ending


def control(
    rig: Rig,
    burr: Burr,
    material: Material | None,
    force: float,
    controller: ForceController | None,
    stop: float,
    max_duration: float,
    interrupted: Callable[[float], bool],
) -> tuple[Series, str]:
    """Series and ending of a run: approach, then force control until the stop."""
    loop, ending = _ForceLoop(rig, burr, material, force, controller, stop), "stalled"
    try:
        rig.command(loop.command)
        for tick in range(int(np.ceil(max_duration * 1e3 / rig.period))):
            reading = rig.read()
            refuse(
                not np.isfinite(reading).all(),
                f"the rig's reading must be finite, got {tuple(reading)} at sample {tick}; it was stopped",
            )
            refuse(
                reading.force < -max(0.5 * force, 0.1),
                f"the rig's force must be positive where bone pushes the burr out, got {reading.force:.4g} N at "
                f"sample {tick}; it was stopped",
            )
            reason = loop.answer(reading)
            if reason is None and tick % 64 == 0 and interrupted(max(loop.immersion, 0.0)):
                reason = "interrupted"
            if reason is not None:
                ending = reason
                break
    except KeyboardInterrupt:
        ending = "interrupted"
    finally:
        rig.command(0.0)
    table = np.array(loop.rows, dtype=float).reshape(-1, 3)
    zero = loop.surface if loop.surface is not None else (table[0, 0] if len(table) else 0.0)
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


class _ForceLoop:
    """Answers each reading of a rig with a speed: that of the approach, from the contact on by force control.

    Gains are the controller's, or without one follow the stiffness of the contact.
    """

    def __init__(
        self, rig: Rig, burr: Burr, material: Material | None, force: float, controller: ForceController | None, stop: float
    ) -> None:  # fmt: skip
        self.rig, self.burr, self.force, self.stop = rig, burr, force, stop
        self.scheduled = controller is None
        self.pid = ForceController(0.0) if controller is None else controller
        self.c_e, self.surface = None if material is None else material.c_e, rig.surface
        self.exponent = 1.5 if material is None else material.force_exponent
        self.rows: list[tuple[float, float, float]] = []
        self.command, self.immersion, self.engaged, self.arrived = APPROACH_SPEED, -np.inf, False, False

    def answer(self, reading: RigReading) -> str | None:
        """Commands the rig; returns why the run ends, None while it goes on."""
        self.rows.append((reading.position, reading.force, self.command))
        if reading.force >= self.rig.force_limit:
            return "out-of-range"
        travelled = reading.position - self.rows[0][0]
        if travelled < -RETREAT or (self.surface is None and travelled > LONGEST_APPROACH):
            return "stalled" if self.engaged else "never-touched"
        if not self.engaged:
            self._look_for_contact(reading.force)
        self.immersion = reading.position - (self.surface if self.surface is not None else np.inf)
        if self.engaged:
            self._control(reading.force)
        if self.immersion >= self.stop:
            return "stop" if self.engaged or getattr(self.rig, "touched", False) else "never-touched"
        return None

    def _look_for_contact(self, measured: float) -> None:
        threshold = _contact_threshold(self.force, self.rows)
        if self.c_e is not None and self.surface is not None:
            self.engaged = measured >= threshold
        elif measured >= max(0.3 * self.force, threshold):
            c_e, surface = _first_contact(self.rows, 0.1 * self.force, self.burr.radius, self.exponent)
            self.c_e = c_e if self.c_e is None else self.c_e
            self.surface = surface if self.surface is None else self.surface
            self.engaged = True
        if self.engaged:
            self.pid.reset(integral=APPROACH_SPEED)

    def _control(self, measured: float) -> None:
        assert self.c_e is not None
        if self.scheduled:
            kp = LOOP_BANDWIDTH / contact_stiffness(
                self.c_e, self.burr.radius, self.force, self.immersion, self.exponent
            )
            # The integral keeps its preset until the force arrives: no wind-up in the impact.
            self.arrived = self.arrived or measured >= ARRIVED * self.force
            self.pid.set_gains(kp, kp / INTEGRAL_TIME if self.arrived else 0.0)
        self.command = self.pid.update(self.force, measured, self.rig.period)
        self.rig.command(self.command)


def _contact_threshold(force: float, rows: list[tuple[float, float, float]]) -> float:
    """Measured force that counts as contact [N]: a tenth of the set-point, above the cell's noise."""
    if len(rows) < 20:
        return max(0.1 * force, 0.05)
    recent = np.array([row[1] for row in rows[:200]])
    return max(0.1 * force, 5 * float(np.std(recent[: max(len(recent) // 2, 10)])))


def _first_contact(
    rows: list[tuple[float, float, float]], above: float, radius: float, q: float
) -> tuple[float, float]:
    """c_e [N/mm^2] and surface position [mm] from the approach: F^(1/q) = (c_e R^(2-q))^(1/q) (x - x_0)."""
    table = np.array(rows)
    first = int(np.argmax(table[:, 1] > above))
    pressed = table[first:]
    if np.ptp(pressed[:, 0]) == 0:  # within one encoder step: add the step before
        before = np.flatnonzero(table[:first, 0] < pressed[0, 0])
        refuse(before.size == 0, "the rig's position must change before its force rises; it was stopped")
        pressed = table[before[-1] :]
    slope, intercept = np.polyfit(pressed[:, 0], np.maximum(pressed[:, 1], 0.0) ** (1 / q), 1)
    slope = max(float(slope), 1e-3)
    return slope**q / (np.sqrt(radius) if q == 1.5 else radius ** (2 - q)), float(-intercept / slope)
