"""The descent experiment: a burr that sinks into bone at constant force."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np

from burrlab._core import Burr, BurrContact, ForceController, Material
from burrlab.arguments import real, require_type
from burrlab.descent_result import Descent, evaluate
from burrlab.descent_run import Progress, Watch, control, free_clearance, hold
from burrlab.provenance import provenance
from burrlab.rig import Rig, VirtualRig
from burrlab.specimen import Specimen, Vector, half_space


def descend(
    burr: Burr,
    material: Material | None,
    force: float,
    *,
    voxel: float | Vector = 0.1,
    dt: float = 1.0,
    seed: int | None = None,
    scheme: str = "layer",
    ideal: bool = False,
    specimen: Specimen | None = None,
    rig: Rig | None = None,
    controller: ForceController | None = None,
    stop: float | None = None,
    max_duration: float = 120.0,
    progress: Progress | None = None,
    cancel: threading.Event | None = None,
) -> Descent:
    """Sinks a burr at constant force and measures its penetration velocity.

    Parameters
    ----------
    burr : Burr
    material : Material or None
        What is burred. None only with a `rig` of your own: gains then follow the first contact.
    force : float
        Set-point of the axial force [N].
    voxel : float or (x, y, z)
        Voxel spacing of the block that is burred [mm]; not used with a specimen or rig.
    dt : float
        Tick [ms]; a rig has its own period.
    seed : int, optional
        Not used with a rig of your own. Of erosion, load cell noise, and the burr's place within a voxel of the block. None draws one and
        records it.
    scheme : {"layer", "cell"}
        See `BurrContact`.
    ideal : bool
        Hold the force exactly, the position solved every tick, without rig and controller.
    specimen : Specimen, optional
        Default: a half-space of solid bone. A copy is burred.
    rig : Rig, optional
        Default: a `VirtualRig` with its default imperfections.
    controller : ForceController, optional
        With fixed gains. Default: gains that follow the stiffness of the contact.
    stop : float, optional
        Immersion at which the run ends [mm]; default R/3.
    max_duration : float
        Time after which a run that has not come to the stop is called stalled [s].
    progress : callable, optional
        Called now and then with the fraction of the way to the stop.
    cancel : threading.Event, optional
        Ends the run with status ``interrupted``, as Ctrl-C does.

    Returns
    -------
    Descent
        With a status; any but ``ok`` comes with its reason and no velocity.

    Raises
    ------
    TypeError
        If burr or material is something else.
    ValueError
        If the force is not positive or above the rig's range, dt, stop or max_duration not positive, max_duration of too many
        ticks, the seed out of range, the burr below 4 voxels, or `material` missing.

    Notes
    -----
    In a specimen with tissues force and erosion are those of the tissues that the burr meets. What is expected
    beforehand (static immersion and the window that it begins, phi, default gains) is computed with the c_e and
    alpha of `material`: where the tissues differ much from it, give a controller, and read velocities with care.

    Examples
    --------
    >>> import burrlab
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> run = burrlab.descend(burr, bone, 2.0, voxel=0.2, seed=1, ideal=True)
    >>> run.status, 2.6 < run.penetration_velocity < 2.9
    ('ok', True)
    """
    require_type("burr", burr, Burr, "Burr(3.0)")
    if specimen is not None:
        require_type("specimen", specimen, Specimen, "half_space(burr, 0.1)")
    if material is not None:
        require_type("material", material, Material, "materials['bone']")
    stop = burr.radius / 3 if stop is None else float(real(stop, "stop"))
    for name, value in {"force": force, "dt": dt, "stop": stop, "max_duration": max_duration}.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive and finite, got {value}")
    period = dt if rig is None or ideal else rig.period
    if not max_duration * 1e3 / period < 2**63:
        raise ValueError(f"max_duration must be below 2^63 ticks of {period:g} ms, got {max_duration:g} s")
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0])
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed must be in 0..2^64 - 1, got {seed}")
    if material is None and (rig is None or ideal):
        raise ValueError("material must be given unless a rig of your own is")
    if ideal and rig is not None:
        raise ValueError("ideal and rig exclude one another: the exact mode has no rig")

    contact: BurrContact | None = None
    if rig is None:
        assert material is not None
        if specimen is None:
            spacing = np.broadcast_to(real(voxel, "voxel"), (3,))
            place = np.random.default_rng([seed & 0xFFFFFFFF, seed >> 32, 1]).uniform(-0.5, 0.5, 3)
            specimen = half_space(burr, voxel, depth=stop, offset=place * spacing)
        specimen = replace(specimen, bone=specimen.bone.copy())
        contact = BurrContact(specimen.bone, burr, material, seed=seed, scheme=scheme)
        if not ideal:
            rig = VirtualRig(contact, specimen, period=dt, clearance=free_clearance(contact, specimen, burr))
    watch = Watch(stop, progress, cancel)
    acted: int | None = seed
    if rig is None:
        assert contact is not None
        assert specimen is not None
        series, ending = hold(contact, specimen, force, stop, dt, max_duration, watch)
    else:
        if force > rig.force_limit:
            raise ValueError(
                f"force must be within the rig's range of {rig.force_limit:g} N, got {force:g} N"
            )
        dt = rig.period
        series, ending = control(rig, burr, material, force, controller, stop, max_duration, watch)
        if contact is None:  # the caller's rig: its seed and bone acted, if it has them
            contact = rig.contact if isinstance(rig, VirtualRig) else None
            specimen = rig.specimen if isinstance(rig, VirtualRig) else None
            acted = None if contact is None else contact.seed
    parameters: dict[str, Any] = {
        "seed": acted,
        "dt_ms": dt,
        "mode": "exact" if ideal else "rig",
        "stop_mm": stop,
    }
    if contact is not None:
        parameters |= {
            "scheme": contact.scheme,
            "spacing_mm": list(contact.bone.spacing),
            "digest": contact.bone.digest(),
        }
    if specimen is not None:
        parameters |= {
            "specimen": specimen.source,
            "surface_mm": specimen.surface.tolist(),
            "axis": specimen.axis.tolist(),
        }
        if specimen.made:
            parameters["volume"] = dict(specimen.made)
    return evaluate(burr, material, force, stop, series, ending, provenance(**parameters))
