"""Many descents: penetration velocity against force."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from burrlab._core import Burr, Material
from burrlab.arguments import require_type
from burrlab.curve import VelocityCurve
from burrlab.descent import descend
from burrlab.provenance import provenance
from burrlab.specimen import Specimen, Vector


@dataclass(frozen=True)
class SweepItem:
    """One descent of a sweep: small, picklable, and a function of its own parameters and seed alone."""

    burr: Burr
    material: Material
    force: float
    seed: int
    voxel: float | tuple[float, ...]
    dt: float
    scheme: str
    ideal: bool
    stop: float | None
    max_duration: float


def item_seed(seed: int, force: float, repeat: int) -> int:
    """Seed of one repeat at one force: a function of these alone, so that it can be rerun by itself."""
    bits = int(np.float64(force).view(np.uint64))
    sequence = np.random.SeedSequence(seed, spawn_key=(bits & 0xFFFFFFFF, bits >> 32, repeat))
    return int(sequence.generate_state(1, np.uint64)[0])


Row = tuple[float, float, float, str, tuple[str, ...]]  # velocity, window, status, warnings


def _run(item: SweepItem, specimen: Specimen | None, cancel: threading.Event | None) -> Row:
    run = descend(
        item.burr, item.material, item.force, voxel=item.voxel, dt=item.dt, seed=item.seed, scheme=item.scheme,
        ideal=item.ideal, specimen=specimen, stop=item.stop, max_duration=item.max_duration, cancel=cancel,
    )  # fmt: skip
    if run.penetration_velocity is None or run.window is None:
        return np.nan, np.nan, np.nan, run.status, run.warnings
    return run.penetration_velocity, *run.window, run.status, run.warnings


def force_sweep(
    burr: Burr,
    material: Material,
    forces: Sequence[float] | np.ndarray,
    *,
    repeats: int = 1,
    voxel: float | Vector = 0.1,
    dt: float = 1.0,
    seed: int | None = None,
    scheme: str = "layer",
    rig: bool = False,
    specimen: Specimen | None = None,
    stop: float | None = None,
    max_duration: float = 120.0,
    executor: Executor | None = None,
    progress: bool = False,
) -> VelocityCurve:
    """Penetration velocity at every force, `repeats` times each, in parallel.

    Parameters
    ----------
    burr : Burr
    material : Material
    forces : array_like, shape (n,)
        Set-points [N].
    repeats : int
        Descents at each force; each has its own seed and place within the voxel grid.
    voxel, dt, scheme, specimen, stop, max_duration
        As for `descend`.
    seed : int, optional
        Of the whole sweep; None draws one and records it.
    rig : bool
        Through controller and virtual rig; else the force is held exactly.
    executor : concurrent.futures.Executor, optional
        Default: threads over the cores.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    VelocityCurve
        One row a descent, by force and repeat; velocity NaN without a window. Windows are given where they
        are not the default one, max(R/6, static contact) to R/3. It does not depend on order or
        number of workers. After Ctrl-C it holds what was done, the rest marked ``interrupted``.

    Raises
    ------
    ValueError
        If no force is given, one is not positive, or repeats is below 1; else as `descend`.

    Examples
    --------
    >>> import burrlab
    >>> curve = burrlab.force_sweep(burrlab.Burr(3.0), burrlab.materials["pvc"], [0.3, 0.4], voxel=0.4, seed=1)
    >>> curve.status
    ('ok', 'ok')
    """
    require_type("burr", burr, Burr, "Burr(3.0)")
    require_type("material", material, Material, "materials['bone']")
    values = np.asarray(forces, dtype=float)
    if values.ndim != 1 or values.size == 0:
        raise ValueError("forces must be a list of at least one force")
    if not np.all(np.isfinite(values) & (values > 0)):
        raise ValueError(f"every force must be positive and finite, got {forces!r}")
    if repeats < 1:
        raise ValueError(f"repeats must be at least 1, got {repeats}")
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1, np.uint64)[0])
    spacing = voxel if isinstance(voxel, int | float) else tuple(float(v) for v in voxel)
    items = [
        SweepItem(
            burr,
            material,
            float(f),
            item_seed(seed, float(f), k),
            spacing,
            dt,
            scheme,
            not rig,
            stop,
            max_duration,
        )
        for f in values
        for k in range(repeats)
    ]
    own = ThreadPoolExecutor(os.cpu_count()) if executor is None else None
    cancel = threading.Event() if own is not None else None
    rows: list[Row] = [(np.nan, np.nan, np.nan, "interrupted", ())] * len(items)
    pool = executor if executor is not None else own
    assert pool is not None
    futures: dict[Future[Row], int] = {}
    try:
        # Slow descents first: low forces sink for long.
        for i in sorted(range(len(items)), key=lambda i: items[i].force):
            futures[pool.submit(_run, items[i], specimen, cancel)] = i
        for future in tqdm(as_completed(futures), total=len(items), desc="descents", disable=not progress):
            rows[futures[future]] = future.result()
    except KeyboardInterrupt:
        if cancel is not None:
            cancel.set()
    finally:
        for future in futures:
            future.cancel()
        if own is not None:
            if cancel is not None and any(not f.done() for f in futures):
                cancel.set()
            own.shutdown(wait=True)
    for future, i in futures.items():  # what was done when Ctrl-C came
        if future.done() and not future.cancelled() and future.exception() is None:
            rows[i] = future.result()
    table = np.array([row[:3] for row in rows])
    # With the force held exactly to R/3 the window is the default one, which a fit predicts from c_e; written
    # out, its start would be taken as given and its information on c_e lost.
    own_window = rig or stop is not None or specimen is not None
    return VelocityCurve(
        force=np.array([item.force for item in items]),
        velocity=table[:, 0],
        window_start=table[:, 1] if own_window else None,
        window_end=table[:, 2] if own_window else None,
        radius=burr.radius,
        status=tuple(row[3] for row in rows),
        source=f"simulated voxel descents, {material.name}",
        provenance=provenance(
            seed=seed, voxel_mm=list(specimen.bone.spacing) if specimen is not None else spacing,
            specimen=specimen.source if specimen is not None else "half-space of solid bone",
            warnings=sorted({text.split(":")[0] for row in rows for text in row[4]}), dt_ms=dt, scheme=scheme, rig=rig, radius_mm=burr.radius, repeats=repeats,
            c_e=material.c_e, alpha=material.alpha, shape=material.shape.name,
        ),
    )  # fmt: skip
