"""The voxel engine of a fit: descents at the forces of the data, tabulated over c_e."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Burr, Material, Shape
from burrlab.bone.specimen import Specimen
from burrlab.bone.uneven import BoneField
from burrlab.common.check import refuse
from burrlab.common.progress import Progress, counter
from burrlab.common.study import StorePath, run_items, stored_as
from burrlab.descent.descent import DescentSettings, descend
from burrlab.descent.result import Descent
from burrlab.descent.sweep import item_seed
from burrlab.fitting.calibration import covariance_of
from burrlab.fitting.likelihood import Likelihood, MeanFieldModel
from burrlab.fitting.observations import Box, Floats, Observations, Rows
from burrlab.theory.closed_forms import FEWEST_TICKS, samples_between
from burrlab.theory.continuum import WINDOW_START, WINDOW_STOP, Law

Window: TypeAlias = tuple[float | None, float | None]  # in radii; None is the default end

_LONGEST = 3600.0  # a descent that takes longer than this is stalled [s of simulated time]


@stored_as("burrlab.fitting.voxel_descent.VoxelSettings")
@dataclass(frozen=True, kw_only=True)
class VoxelEngine:
    """Options of the voxel engine of `burrlab.fit`.

    Parameters
    ----------
    voxel : float
        Voxel size [mm].
    dt : float
        Tick [ms].
    rig : bool
        Descents through controller and virtual rig; else the force is held exactly.
    specimen : Specimen or BoneField, optional
        The bone; a BoneField gives every replicate its own realisation. Default: solid bone.
    replicates : int
        Descents at each force and point, at least 2; their differences give the Monte Carlo error.
    executor : concurrent.futures.Executor, optional
        Runs the descents; threads over the cores by default.
    store : Store or path, optional
        Keeps every descent, so that an interrupted fit resumes.
    progress : callable or True, optional
        Called with the fraction done; True shows a bar.
    seed : int, optional
        Of the erosion; without it each fit draws one, which its result records.

    Raises
    ------
    TypeError
        If `replicates` or `specimen` has another type.
    ValueError
        If `replicates` is below 2, or a store has no seed.

    Examples
    --------
    >>> import burrlab
    >>> engine = burrlab.VoxelEngine(voxel=0.2, replicates=8)
    >>> engine.dt
    1.0
    """

    voxel: float = 0.1
    dt: float = 1.0
    rig: bool = False
    specimen: Specimen | BoneField | None = None
    replicates: int = 4
    executor: Executor | None = field(default=None, compare=False)
    store: StorePath | None = field(default=None, compare=False)
    progress: Progress | None = field(default=None, compare=False)
    seed: int | None = field(default=None, compare=False)  # an item of a store has its own

    def __post_init__(self) -> None:
        refuse(
            self.seed is None and self.store is not None,
            "seed must be given with a store, which finds results by it, got None",
        )
        refuse(
            not isinstance(self.replicates, (int, np.integer)),
            f"replicates must be a whole number, got {self.replicates!r}",
            TypeError,
        )
        refuse(
            self.replicates < 2,
            f"replicates must be at least 2, to show their scatter: got {self.replicates!r}",
        )
        if not isinstance(self.specimen, (Specimen, BoneField, type(None))):
            raise TypeError(f"specimen must be a Specimen or a BoneField, got {self.specimen!r}")

    @property
    def settings(self) -> VoxelEngine:
        """The options without executor, store, progress and seed."""
        return replace(self, executor=None, store=None, progress=None, seed=None)

    def _described(self) -> dict[str, Any]:
        """The options as the provenance keeps them."""
        specimen = self.specimen
        known: dict[str, Any] = {
            "voxel_mm": self.voxel,
            "dt_ms": self.dt,
            "rig": self.rig,
            "specimen": "solid bone" if specimen is None else repr(specimen),
            "replicates": self.replicates,
        }
        if isinstance(specimen, Specimen):
            known["specimen"] = f"{specimen.source}, digest {specimen.bone.digest()}"
            known |= {"volume": dict(specimen.made)} if specimen.made else {}
        return known


@stored_as("burrlab.fitting.voxel_descent.VoxelDescent")
@dataclass(frozen=True)
class VoxelDescent:
    """One descent and the windows to read from it: small, picklable and self-contained."""

    burr: Burr
    material: Material
    force: float  # [N]
    windows: tuple[Window, ...]
    settings: VoxelEngine
    seed: int


@stored_as("burrlab.fitting.voxel_descent.sink")
def sink(descent: VoxelDescent) -> list[float]:
    """Penetration velocity [mm/s] over each window; NaN without a number, infinite without a window."""
    R, settings = descent.burr.radius, descent.settings
    windows = [
        (R * (WINDOW_START if start is None else start), R * (WINDOW_STOP if end is None else end))
        for start, end in descent.windows
    ]
    stop = max(end for _, end in windows)
    specimen = settings.specimen
    if isinstance(specimen, BoneField):
        specimen = specimen.specimen(descent.burr, settings.voxel, depth=stop, seed=descent.seed)
    run = descend(
        descent.burr,
        descent.material,
        descent.force,
        voxel=settings.voxel,
        settings=DescentSettings(dt=settings.dt, stop=stop, max_duration=_LONGEST),
        seed=descent.seed,
        ideal=not settings.rig,
        specimen=specimen,
    )
    if run.status == "overloaded":
        return [np.inf] * len(windows)
    if run.status not in ("ok", "window-too-short", "never-settled"):
        return [np.nan] * len(windows)
    return [
        (run.penetration_velocity or np.nan)
        if settings.rig and window == (None, None)
        else _velocity(run, start, end)
        for window, (start, end) in zip(descent.windows, windows, strict=True)
    ]


def _velocity(run: Descent, start: float, end: float) -> float:
    start = max(start, float(run.immersion[0]))  # a window never starts before static contact
    rows = samples_between(run.immersion, start, end)
    velocity = run.velocity_over(start, end) if rows.stop - rows.start >= FEWEST_TICKS else None
    return np.nan if velocity is None or velocity <= 0 else velocity


_NODES, _DEGREE = 10, 3  # points in log c_e, and the polynomial through the deviations from mean-field there
_FEWEST = 3  # points at which every force must have a number; fewer than five lower the degree
_CLOSE = (1.002, 1.05, 1.12)  # points above the bound of c_e, where windows get short
_HALVINGS = 5  # of the gap below the lowest c_e at which every force has a window
_ROUNDS = 6  # most tables, while the best alpha or c_e moves away from the last table's or is too fast
_SLOWER = 3.0  # a first table divides alpha by this where windows have too few ticks
_MOVED = 0.2  # in log alpha: beyond, the velocity is not proportional to alpha within the scatter
_RIDGE_PART = 2.0  # the table ends at twice the c_e at which the ridge begins: further on nothing changes
_LARGEST_STEP = 1.0  # largest alpha dt: beyond, one tick removes most of the bone it reaches


@dataclass(frozen=True, eq=False)
class VoxelTable:
    """log of the velocity in voxels over the mean-field one, as a polynomial in log c_e.

    Attributes
    ----------
    low, high : float
        Range of the descents' c_e [N/mm^2]. Below it some force has no window; above, the last value holds.
    coefficients : ndarray, shape (replicates, rows, 4)
        Coefficients by rising power of log(c_e/low).
    error : float
        RMS deviation of the descents, averaged over replicates, from the polynomials.
    noise : float
        RMS deviation of one replicate from their mean.
    """

    low: float
    high: float
    coefficients: Floats
    error: float
    noise: float


class VoxelModel(MeanFieldModel):
    """Mean-field velocity of the rows times the table's deviation."""

    of_voxels = True

    def __init__(self, observations: Observations, shape: Shape, table: VoxelTable) -> None:
        super().__init__(observations, shape)
        self._table, self._coefficients = table, table.coefficients.mean(axis=0).T

    def kept(self, observations: Observations, keep: NDArray[np.bool_]) -> VoxelModel:
        """See `MeanFieldModel`."""
        return VoxelModel(
            observations, self.shape, replace(self._table, coefficients=self._table.coefficients[:, keep])
        )

    def unit(self, c_e: ArrayLike, own: Floats | None = None) -> Floats:
        """See `MeanFieldModel`."""
        stiffness = np.asarray(c_e, dtype=np.float64)
        x = np.log(np.minimum(stiffness, self._table.high) / self._table.low)[..., None]
        deviation = np.zeros((*stiffness.shape, self._coefficients.shape[1]))
        for coefficient in self._coefficients[::-1]:
            deviation = deviation * x + coefficient
        return np.where(
            (x >= -1e-9) & np.isfinite(deviation),
            super().unit(stiffness, own) * np.exp(deviation),
            np.nan,
        )

    def log_unit(self, c_e: ArrayLike) -> Floats:
        """See `MeanFieldModel`."""
        return np.log(self.unit(c_e))


def model_of(observations: Observations, shape: Shape, table: VoxelTable | None) -> MeanFieldModel:
    """The voxel engine's model where there is a table of its descents, else the mean-field one."""
    return MeanFieldModel(observations, shape) if table is None else VoxelModel(observations, shape, table)


class Descents:
    """Descents at the forces of an `Observations`, at several c_e.

    Every point uses the same seeds, so the erosion draws the same random numbers, and predictions at
    neighbouring points differ by little more than the effect of the parameters.
    """

    def __init__(self, observations: Observations, shape: Shape, engine: VoxelEngine, seed: int) -> None:
        self._observations, self._shape, self._engine, self._seed = observations, shape, engine, seed
        self._settings = engine.settings
        self._rows: dict[tuple[float, float], dict[Window, Rows]] = {}
        for window, rows in observations.by_window().items():
            pairs = np.stack([observations.radius[rows], observations.force[rows]], axis=1)
            for radius, force in np.unique(pairs, axis=0).tolist():
                self._rows.setdefault((radius, force), {})[window] = rows[
                    (pairs == (radius, force)).all(axis=1)
                ]

    def velocities(self, points: Floats) -> Floats:
        """Velocity [mm/s] of every row at each (c_e, alpha): shape (points, replicates, rows).

        NaN where a descent gave no number, infinite where static contact passed the window's end.
        """
        law = Law(self._shape, self._observations.force_exponent, self._observations.rate_exponent)
        work = [
            (
                VoxelDescent(
                    Burr(radius), law.material(c_e, alpha, "trial"), force, tuple(windows), self._settings,
                    item_seed(self._seed, force, k),
                ),
                i, k, list(windows.values()),
            )
            for i, (c_e, alpha) in enumerate(points.tolist())
            for (radius, force), windows in self._rows.items()
            for k in range(self._settings.replicates)
        ]  # fmt: skip
        work.sort(key=lambda part: part[0].force)  # small forces take longest: they come first
        velocities_of_items = run_items(
            sink,
            [descent for descent, *_ in work],
            executor=self._engine.executor,
            store=self._engine.store,
            progress=counter(self._engine.progress, "descents"),
        )
        velocity = np.full((len(points), self._settings.replicates, len(self._observations.force)), np.nan)
        for (_, i, k, tables), values in zip(work, velocities_of_items, strict=True):
            for rows, value in zip(tables, values, strict=True):
                velocity[i, k, rows] = value
        return velocity

    def tabulate(
        self, mean_field: Likelihood, box: Box, start: tuple[float, float]
    ) -> tuple[VoxelTable, tuple[tuple[float, float], ...]] | str:
        """The table and the points it was made from; or a sentence, where too few points have a velocity."""
        o, likelihood = self._observations, mean_field
        seen: list[tuple[float, float]] = []
        entry = float(o.ridge_entries().max())
        top = _RIDGE_PART * entry if np.isfinite(entry) else 4 * start[0]
        low = box.lower[0]
        tried = np.geomspace(low, top, 200)
        slow = tried[mean_field.at(tried).best_alpha * self._settings.dt <= _LARGEST_STEP]
        top = min(top, float(slow.max(initial=low)))
        top = min(max(top, 1.3 * start[0]), box.upper[0])
        table, slower = None, 1.0
        failure = (
            "No parameters tried gave every row a velocity: a window needs ten ticks, here of "
            f"{self._settings.dt:g} "
            f"ms{', and a force that settles on the rig' if self._settings.rig else ''}."
        )
        for _ in range(_ROUNDS):
            close = [low * factor for factor in _CLOSE if low * factor < top]
            nodes = np.unique([*close, *np.geomspace(1.2 * low, max(top, 1.3 * low), _NODES)])
            alphas = np.clip(likelihood.at(nodes).best_alpha, box.lower[1], box.upper[1])
            points = np.stack([nodes, alphas / slower], axis=1)
            velocity = self.velocities(points)
            points, velocity = self._down_to_the_bound(points, velocity)
            seen += [(float(c_e), float(alpha)) for c_e, alpha in points]
            loaded = np.isinf(velocity).any(axis=(1, 2))
            points, velocity = points[~loaded], velocity[~loaded]
            if (np.isfinite(velocity).all(axis=1).sum(axis=0) < _FEWEST).any():
                if table is not None:  # the best alphas of a slower table failed
                    return failure
                slower *= _SLOWER
                continue
            slower = 1.0
            c_e, alpha = points.T
            mean_field_velocity = alpha[:, None] * mean_field.model.unit(c_e)
            table = _table(c_e, np.log(velocity) - np.log(mean_field_velocity)[:, None, :])
            likelihood = Likelihood(o, mean_field.kind, VoxelModel(o, self._shape, table))
            low = table.low / _CLOSE[0]
            at_c_e = likelihood.at(c_e)
            moved = float(np.max(np.abs(np.log(at_c_e.best_alpha / alpha))))
            if np.nanargmin(at_c_e.profile) == len(c_e) - 1 and top < min(entry, box.upper[0]):
                top *= 2
            elif moved < _MOVED:
                break
        return failure if table is None else (table, tuple(seen))

    def _down_to_the_bound(self, points: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Points and velocities, with points added in the gap above the highest c_e without a window."""
        for _ in range(_HALVINGS):
            loaded = np.flatnonzero(np.isinf(velocity).any(axis=(1, 2)))
            if not len(loaded) or loaded[-1] + 1 == len(points):
                break
            i = int(loaded[-1])
            middle = np.sqrt(points[i] * points[i + 1])
            points = np.insert(points, i + 1, middle, axis=0)
            velocity = np.insert(velocity, i + 1, self.velocities(middle[None])[0], axis=0)
        return points, velocity


def _table(c_e: Floats, deviation: Floats) -> VoxelTable:
    """Least-squares polynomials through deviations of shape (points, replicates, rows), NaN where missing.

    A force whose window is too short at some points, close to its bound, is extrapolated from the others.
    """
    V = np.vander(np.log(c_e / c_e[0]), _DEGREE + 1, increasing=True)
    _, k, rows = deviation.shape
    coefficients = np.empty((k, rows, _DEGREE + 1))
    errors, noises = [], []
    for row in range(rows):
        part = deviation[:, :, row]
        known = np.isfinite(part).all(axis=1)
        terms = min(_DEGREE + 1, int(known.sum()) - 1)
        fitted = np.zeros((_DEGREE + 1, k))
        fitted[:terms] = np.linalg.lstsq(V[known, :terms], part[known], rcond=None)[0]
        coefficients[:, row] = fitted.T
        mean = part[known].mean(axis=1)
        errors.append(np.sum((mean - V[known] @ fitted.mean(axis=1)) ** 2) / (known.sum() - terms))
        noises.append(np.mean((part[known] - mean[:, None]) ** 2) * k / (k - 1))
    return VoxelTable(
        float(c_e[0]),
        float(c_e[-1]),
        coefficients,
        float(np.sqrt(np.mean(errors))),
        float(np.sqrt(np.mean(noises))),
    )


def monte_carlo_share(
    likelihood: Likelihood, table: VoxelTable, best: tuple[float, float], c_e_open: bool
) -> float:
    """SE_mc^2/SE_stat^2, the larger of c_e's and the best-determined combination's.

    Each replicate is a table of its own; its best point is one Newton step from the fit. The covariance of
    these points over their number is the Monte Carlo error, the inverse of the information the statistical
    one. Where c_e is open, only the combination counts.

    References
    ----------
    Ionides et al., J. R. Soc. Interface 14 (2017) 20170126: the cutoff of the profile grows by a SE_mc^2,
    with a its curvature, 1/(2 a) = SE_stat^2.
    """
    total, _, _ = likelihood.information(*best)
    inverse = covariance_of(total)
    o, shape = likelihood.observations, likelihood.model.shape
    variances = likelihood.variances(*best)  # of the fit: variances about one replicate include its own error
    models = (VoxelModel(o, shape, replace(table, coefficients=part[None])) for part in table.coefficients)
    scores = [Likelihood(o, likelihood.kind, model).score(*best, variances) for model in models]
    spread = inverse @ np.cov(np.array(scores).T) @ inverse / len(scores)
    combination = np.array([total[0, 1] / total[1, 1], 1.0])  # alpha/c_e^p, uncorrelated with c_e
    directions = [combination] if c_e_open else [combination, np.array([1.0, 0.0])]
    return float(max((d @ spread @ d) / (d @ inverse @ d) for d in directions))
