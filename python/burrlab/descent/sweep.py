"""Many descents: penetration velocity against force."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from burrlab._core import Burr, Material
from burrlab.bone.specimen import Specimen, Vector
from burrlab.common.check import real, refuse, seed_or_new, whole
from burrlab.common.progress import Progress, reporter
from burrlab.common.provenance import provenance
from burrlab.common.study import StorePath, Study, cancel_event, stored_as
from burrlab.descent.descent import DescentSettings, descend
from burrlab.measured.curve import VelocityCurve
from burrlab.theory.tool import law_of, require_tool


@runtime_checkable
class SpecimenSource(Protocol):
    """A source of specimens, one for each descent of a sweep: a small, picklable, frozen dataclass."""

    def specimen(self, burr: Burr, voxel: float | tuple[float, ...], *, depth: float, seed: int) -> Specimen:
        """A specimen for a descent to `depth` [mm] with `voxel` [mm]; it depends on the arguments alone."""
        ...


@stored_as("burrlab.sweep._Given")
@dataclass(frozen=True)
class _Given:
    """One specimen for all descents; a store compares digest, surface and axis."""

    digest: str
    surface: tuple[float, ...]
    axis: tuple[float, ...]
    whole: Specimen = field(compare=False, repr=False)

    def specimen(self, burr: Burr, voxel: float | tuple[float, ...], *, depth: float, seed: int) -> Specimen:
        return self.whole


@stored_as("burrlab.sweep.SweepItem")
@dataclass(frozen=True)
class SweepItem:
    """One descent of a sweep: picklable and self-contained."""

    burr: Burr
    material: Material
    force: float
    seed: int
    voxel: float | tuple[float, ...]
    dt: float
    scheme: str
    ideal: bool
    specimen: SpecimenSource | None
    stop: float | None
    max_duration: float


def item_seed(seed: int, force: float, repeat: int) -> int:
    """Seed of one repeat at one force, from these alone, so that it can be rerun by itself."""
    bits = int(np.float64(force).view(np.uint64))
    sequence = np.random.SeedSequence(seed, spawn_key=(bits & 0xFFFFFFFF, bits >> 32, repeat))
    return int(sequence.generate_state(1, np.uint64)[0])


def specimen_seed(seed: int) -> int:
    """Seed of the specimen of a descent with this seed: independent of its erosion and place."""
    return int(np.random.SeedSequence(seed, spawn_key=(2,)).generate_state(1, np.uint64)[0])


Row = tuple[float, float, float, str, tuple[str, ...]]  # velocity, window, status, warnings
_INTERRUPTED: Row = (np.nan, np.nan, np.nan, "interrupted", ())


@stored_as("burrlab.sweep.run_item")
def run_item(item: SweepItem) -> Row:
    """Velocity [mm/s], window [mm], status and warnings of one descent of a sweep."""
    specimen = None
    if item.specimen is not None:
        depth = item.burr.radius / 3 if item.stop is None else item.stop
        specimen = item.specimen.specimen(item.burr, item.voxel, depth=depth, seed=specimen_seed(item.seed))
    run = descend(
        item.burr, item.material, item.force, voxel=item.voxel, seed=item.seed, ideal=item.ideal, specimen=specimen,
        settings=DescentSettings(dt=item.dt, scheme=item.scheme, stop=item.stop, max_duration=item.max_duration),
        progress=False, cancel=cancel_event(),
    )  # fmt: skip
    if run.status == "interrupted":
        raise KeyboardInterrupt  # no result: a store must not keep it
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
    seed: int | None = None,
    ideal: bool = True,
    specimen: Specimen | SpecimenSource | None = None,
    settings: DescentSettings = DescentSettings(),
    executor: Executor | None = None,
    store: StorePath | None = None,
    progress: Progress | None = None,
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
    voxel, settings
        As for `descend`.
    specimen : Specimen or SpecimenSource, optional
        One specimen, of which every descent burrs a copy; or an object with a method
        ``specimen(burr, voxel, *, depth, seed)``, which makes one for each descent with a seed of its own.
        Default: a half-space of solid bone.
    seed : int, optional
        Seed of the whole sweep; None draws one and records it.
    ideal : bool
        As for `descend`: hold the force exactly; False uses controller and virtual rig.
    executor : concurrent.futures.Executor, optional
        Default: threads over the cores.
    store : Store or path, optional
        Keeps every descent as it ends and does not repeat those it holds; needs a seed.
    progress : callable or True, optional
        Called with the fraction done; True shows a bar. None writes a note to the logger ``burrlab`` where the
        sweep has more than 2 s to go.

    Returns
    -------
    VelocityCurve
        One row per descent, by force and repeat; velocity NaN without a window. Windows are given where they
        are not the default one, max(R/6, static contact) to R/3. The curve does not depend on order or number
        of workers. After Ctrl-C the descents that did not run are marked ``interrupted``.

    Raises
    ------
    TypeError
        If burr, material, specimen or executor has another type.
    ValueError
        If no force is given, a force is not positive, repeats is below 1, a store is given without a seed or
        its file is no store; else as for `descend`.
    StudyInterrupted
        If the executor dies.

    Examples
    --------
    >>> import burrlab
    >>> curve = burrlab.force_sweep(burrlab.Burr(3.0), burrlab.materials["pvc"], [0.3, 0.4], voxel=0.4, seed=1)
    >>> curve.status
    ('ok', 'ok')
    """
    values = _checked_forces(burr, material, forces, repeats, specimen, ideal)
    refuse(
        seed is None and store is not None,
        "seed must be given with a store, which finds results by it, got None",
    )
    seed = seed_or_new(seed)
    spacing = voxel if isinstance(voxel, int | float) else tuple(real(voxel, "voxel").tolist())
    drawn = specimen if not isinstance(specimen, Specimen) else _Given(
        specimen.bone.digest(), tuple(specimen.surface.tolist()), tuple(specimen.axis.tolist()), specimen
    )  # fmt: skip
    items = [
        SweepItem(burr, material, float(f), item_seed(seed, float(f), k), spacing, settings.dt, settings.scheme,
                  ideal, drawn, settings.stop, settings.max_duration)
        for f in values
        for k in range(repeats)
    ]  # fmt: skip
    rows = _descend_all(items, executor, store, progress)
    table = np.array([row[:3] for row in rows])
    # With the force held exactly to R/3 the window is the default one, which a fit predicts from c_e. If it
    # were written out, a fit would take its start as given and lose its information on c_e.
    about = "half-space of solid bone" if specimen is None else repr(specimen)
    volume: dict[str, Any] = {}
    if isinstance(specimen, Specimen):
        about = specimen.source
        if specimen.made:
            volume = {"volume": dict(specimen.made), "digest": specimen.bone.digest()}
    own_window = not ideal or settings.stop is not None or specimen is not None
    return VelocityCurve(
        force=np.array([item.force for item in items]),
        velocity=table[:, 0],
        window_start=table[:, 1] if own_window else None,
        window_end=table[:, 2] if own_window else None,
        radius=burr.radius,
        status=tuple(row[3] for row in rows),
        source=f"simulated voxel descents, {material.name}",
        provenance=provenance(
            seed=seed, voxel_mm=list(specimen.bone.spacing) if isinstance(specimen, Specimen) else spacing,
            specimen=about,
            warnings=sorted({text.split(":")[0] for row in rows for text in row[4]}), dt_ms=settings.dt, scheme=settings.scheme, rig=not ideal, radius_mm=burr.radius, repeats=repeats,
            c_e=material.c_e, alpha=material.alpha, shape=material.shape.name, **law_of(material), **volume,
        ),
    )  # fmt: skip


def _checked_forces(
    burr: Burr, material: Material, forces: Any, repeats: int, specimen: object, ideal: object
) -> np.ndarray:
    """The forces; errors of `force_sweep`."""
    require_tool(burr, material)
    values = real(forces, "forces")
    refuse(values.ndim != 1 or values.size == 0, "forces must be a list of at least one force")
    refuse(
        not (np.isfinite(values) & (values > 0)).all(),
        f"every force must be positive and finite, got {forces!r}",
    )
    refuse(whole("repeats", repeats, 2**31, "2^31") < 1, f"repeats must be at least 1, got {repeats}")
    refuse(
        not isinstance(specimen, Specimen | SpecimenSource | None),
        f"specimen must be a Specimen or have a method specimen(burr, voxel, *, depth, seed), got {specimen!r}",
        TypeError,
    )
    refuse(not isinstance(ideal, bool), f"ideal must be True or False, got {ideal!r}", TypeError)
    return values


def _descend_all(
    items: list[SweepItem], executor: Executor | None, store: StorePath | None, progress: Progress | None
) -> list[Row]:
    """A row an item; of those that did not run after Ctrl-C, as of an interrupted descent."""
    # Slow descents first: low forces take longest.
    order = sorted(range(len(items)), key=lambda i: items[i].force)
    study = Study(run_item, [items[i] for i in order], executor=executor, store=store)
    with suppress(KeyboardInterrupt):
        report = reporter(progress, "sweep" if progress is None else "descents")
        for done, _ in enumerate(study, start=1):
            if progress is not None or done >= (os.cpu_count() or 1):  # the first ones ran side by side
                report(done / len(items))
    rows = {order[place]: row for place, row in study.results.items()}
    return [rows.get(i, _INTERRUPTED) for i in range(len(items))]
