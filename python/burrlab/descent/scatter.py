"""The scatter of penetration velocities in uneven bone."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Burr, Material
from burrlab.bone.uneven import BoneField
from burrlab.common.check import check_positive, refuse, require_type, seed_or_new
from burrlab.common.figures import REFERENCE, VELOCITY, Axes, drawing, new_figure, styled
from burrlab.common.progress import Progress, counter
from burrlab.common.provenance import provenance
from burrlab.common.records import AsDict, Codec
from burrlab.common.study import StorePath, run_items, stored_as
from burrlab.descent.descent import DescentSettings, descend, place_in_voxel
from burrlab.descent.sweep import item_seed
from burrlab.theory.tool import law_of, require_tool

Floats = NDArray[np.float64]

#: Level of all intervals.
CONFIDENCE = 0.95


@stored_as("burrlab.bone_scatter.ScatterItem")
@dataclass(frozen=True)
class ScatterItem:
    """One descent: small, picklable and self-contained."""

    burr: Burr
    material: Material
    force: float
    bone: BoneField
    voxel: float
    dt: float
    seed: int


class ScatterTest(NamedTuple):
    """The outcome of an F test of a measured scatter against a predicted one."""

    p_value: float  #: two-sided
    text: str


@stored_as("burrlab.bone_scatter.run_item")
def run_item(item: ScatterItem) -> tuple[float, str]:
    """ln of the penetration velocity [mm/s], NaN without one, and the status of a descent."""
    specimen = item.bone.specimen(
        item.burr, item.voxel, seed=item.seed, offset=place_in_voxel(item.seed) * item.voxel
    )
    run = descend(
        item.burr,
        item.material,
        item.force,
        settings=DescentSettings(dt=item.dt),
        seed=item.seed,
        specimen=specimen,
        ideal=True,
    )
    return float(np.log(run.penetration_velocity or np.nan)), run.status


@dataclass(frozen=True, eq=False, repr=False)
class Scatter(AsDict):
    """Scatter of ln v at every force, each descent in its own bone; `to_dict` has NaN as it is.

    Intervals are those of a normal distribution of ln v, by chi-square, at 95 %.

    Attributes
    ----------
    force : ndarray, shape (n,)
        [N]
    log_velocity, homogeneous : ndarray, shape (n, repeats)
        ln of v [mm/s], and of v in bone that has the field's mean everywhere, with the same place within a
        voxel and the same erosion seed; NaN without a velocity.
    status : tuple of str
        Status of the descents in uneven bone, by force and repeat.
    bone : BoneField
    burr : Burr
    material : Material
    provenance : dict
    """

    force: Floats
    log_velocity: Floats
    homogeneous: Floats
    status: tuple[str, ...]
    bone: BoneField
    burr: Burr
    material: Material
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def n_dof(self) -> NDArray[np.int64]:
        """Degrees of freedom at each force, shape (n,): descents with a velocity, less one."""
        return np.asarray(np.maximum(np.isfinite(self.log_velocity).sum(axis=1) - 1, 0))

    @property
    def sd(self) -> Floats:
        """Standard deviation of ln v at each force, shape (n,); NaN below two velocities."""
        return _deviation(self.log_velocity)

    @property
    def interval(self) -> Floats:
        """Interval of each `sd`, shape (n, 2)."""
        return np.array([_interval(s, n) for s, n in zip(self.sd, self.n_dof, strict=True)])

    @property
    def pooled(self) -> float:
        """Root of the mean variance of ln v over the forces, by degrees of freedom; NaN without any."""
        return _pooled(self.sd, self.n_dof)

    @property
    def pooled_n_dof(self) -> int:
        """Degrees of freedom of `pooled`."""
        return int(self.n_dof.sum())

    @property
    def pooled_interval(self) -> tuple[float, float]:
        """Interval of `pooled`, if the scatter is the same at every force."""
        return _interval(self.pooled, self.pooled_n_dof)

    @property
    def without_field(self) -> float:
        """Pooled standard deviation of ln v in the homogeneous bone: erosion and place within a voxel."""
        count = np.maximum(np.isfinite(self.homogeneous).sum(axis=1) - 1, 0)
        return _pooled(_deviation(self.homogeneous), count)

    @property
    def shift(self) -> Floats:
        """Mean of ln v less that in homogeneous bone, over pairs with both velocities, shape (n,)."""
        return np.array([d.mean() if d.size else np.nan for d in self._differences()])

    @property
    def shift_error(self) -> Floats:
        """Standard error of each `shift`, shape (n,)."""
        return np.array([d.std(ddof=1) / d.size**0.5 if d.size > 1 else np.nan for d in self._differences()])

    def _differences(self) -> list[Floats]:
        return [row[np.isfinite(row)] for row in self.log_velocity - self.homogeneous]

    def compare(self, sd: float, n_dof: int) -> ScatterTest:
        """Test whether a measured scatter is that of this bone.

        Parameters
        ----------
        sd : float
            Measured standard deviation of ln v; 0.08 is 8 %.
        n_dof : int
            Its degrees of freedom: velocities less the number of forces or parameters fitted.

        Returns
        -------
        ScatterTest
            Two-sided p-value of the F test of both variances, and a sentence with the verdict at 5 %.

        Raises
        ------
        ValueError
            If sd is not positive and finite, n_dof is below 1, or no force has two velocities.

        Notes
        -----
        The test takes ln v as normal, with one scatter at all forces. Both hold roughly: over 480 bones (mean
        0.8, contrast 0.1, correlation length 0.5 mm, R = 3 mm) the scatter is 5.8, 6.1 and 4.4 % at 0.5, 1
        and 2 N, with a skewness of 0.1 to 0.3.
        """
        check_positive("sd", sd)
        refuse(n_dof < 1, f"n_dof must be at least 1, got {n_dof}")
        refuse(self.pooled_n_dof < 1, "compare needs a force with at least two velocities, got none")
        ratio = scipy.stats.f(n_dof, self.pooled_n_dof)
        at = (sd / self.pooled) ** 2
        p = float(min(1.0, 2 * min(ratio.cdf(at), ratio.sf(at))))
        if p >= 1 - CONFIDENCE:
            verdict = "no difference is shown"
        else:
            verdict = "more than the field explains" if sd > self.pooled else "less than the field predicts"
        return ScatterTest(
            p, f"the field predicts {self._pooled_text()}, measured {100 * sd:.1f} %: {verdict} (p = {p:.2g})"
        )

    @drawing
    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """The Axes of the scatter and its intervals against force, the pooled scatter as a line.

        `style`: label, color and other properties of the points.
        """
        ax = new_figure(4.8, 3.6).subplots() if ax is None else ax
        sd, interval = 100 * self.sd, 100 * self.interval
        look = styled(style, marker="o", linestyle="", color=VELOCITY, label="each force, 95 %")
        ax.errorbar(self.force, sd, np.abs(interval.T - sd), capsize=3, **look)
        if self.pooled_n_dof:
            low, high = self.pooled_interval
            ax.axhspan(100 * low, 100 * high, color="0.93", zorder=0)
            for value, line, said in (
                (self.pooled, "-", "all forces, 95 %"), (self.without_field, ":", "homogeneous bone")
            ):  # fmt: skip
                ax.axhline(100 * value, color=REFERENCE, linewidth=1.0, linestyle=line, label=said)
        ax.set(xlabel="force [N]", ylabel="standard deviation of ln v [%]", ylim=(0, None))
        ax.set_title(f"{self.material.name}, R = {self.burr.radius:g} mm\n{_bone_text(self.bone)}")
        return ax

    def _pooled_text(self) -> str:
        low, high = self.pooled_interval
        return f"{100 * self.pooled:.1f} % ({100 * low:.1f}..{100 * high:.1f} %)"

    def __repr__(self) -> str:
        lost = sum(status != "ok" for status in self.status)
        said = f"; {lost} of {len(self.status)} descents without a velocity are left out" if lost else ""
        return (
            f"Scatter({self.material.name}, R = {self.burr.radius:g} mm, {_bone_text(self.bone)}, "
            f"{self.force.min():g}..{self.force.max():g} N: sd of ln v {self._pooled_text()}, "
            f"{100 * self.without_field:.1f} % in homogeneous bone{said})"
        )


Scatter._codec = Codec(
    "kept",
    keys={
        Scatter: {
            "force_N": "force",
            "sd_ln_v": "sd",
            "interval_ln_v": "interval",
            "n_dof": "n_dof",
            "pooled_sd_ln_v": "pooled",
            "pooled_interval_ln_v": "pooled_interval",
            "without_field_sd_ln_v": "without_field",
            "shift_ln_v": "shift",
            "shift_error_ln_v": "shift_error",
            "log_velocity": "log_velocity",
            "homogeneous": "homogeneous",
            "status": "status",
            "provenance": "provenance",
        }
    },
)


def predicted_scatter(
    burr: Burr,
    material: Material,
    forces: ArrayLike,
    field: BoneField,
    *,
    repeats: int = 12,
    voxel: float = 0.2,
    dt: float = 1.0,
    seed: int | None = None,
    executor: Executor | None = None,
    store: StorePath | None = None,
    progress: Progress | None = None,
) -> Scatter:
    """Scatter of the penetration velocity over realisations of a field, force held exactly.

    Parameters
    ----------
    burr : Burr
    material : Material
    forces : array_like, shape (n,)
        [N], no two alike.
    field : BoneField
    repeats : int
        Bones at each force, each with its own descent; as many descents again in homogeneous bone.
    voxel : float
        Spacing [mm].
    dt : float
        Tick [ms].
    seed : int, optional
        Seed of the whole; None draws one and records it. The seed of one bone, its erosion and place within
        a voxel is ``burrlab.descent.sweep.item_seed(seed, force, repeat)``.
    executor : concurrent.futures.Executor, optional
        Default: threads over the cores. The result does not depend on it.
    store : Store or path, optional
        Keeps every descent, so that an interrupted study resumes.
    progress : callable or True, optional
        Called with the fraction done; True shows a bar.

    Returns
    -------
    Scatter

    Raises
    ------
    TypeError
        If burr, material or field has another type.
    ValueError
        If no force is given, a force is not positive or given twice, repeats is below 2, or the seed is out
        of range; else as for `BoneField.specimen` and `descend`.
    StudyInterrupted
        If the executor dies.

    Notes
    -----
    The window of a descent begins at its own static contact where that is deeper than R/6, in uneven bone as
    on a bench. Descents without a velocity are left out and counted. Where there are many, the scatter is too
    small, because it is that of the bones that carry the force.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.bone.uneven import BoneField
    >>> burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    >>> scatter = predicted_scatter(burr, bone, [1.5, 2.0], BoneField(correlation_length=1.0), repeats=3, voxel=0.4, seed=1)
    >>> scatter.pooled_n_dof, scatter.pooled > scatter.without_field
    (4, True)
    """
    require_tool(burr, material)
    require_type("field", field, BoneField, "BoneField()")
    force = np.asarray(forces, dtype=float)
    refuse(force.ndim != 1 or force.size == 0, f"forces must be a list of at least one force, got {forces!r}")
    refuse(
        not np.all(np.isfinite(force) & (force > 0)) or len(set(force)) < force.size,
        f"every force must be positive and finite, and given once, got {forces!r}",
    )
    refuse(repeats < 2, f"repeats must be at least 2, got {repeats}")
    refuse(
        seed is None and store is not None,
        "a store needs a seed, for it finds results by it: got seed None",
    )
    seed = seed_or_new(seed)
    items = [
        ScatterItem(burr, material, float(f), bone, voxel, dt, item_seed(seed, float(f), k))
        for bone in (field, replace(field, contrast=0.0))
        for f in force
        for k in range(repeats)
    ]
    rows = run_items(run_item, items, executor=executor, store=store, progress=counter(progress, "descents"))
    table = np.array([row[0] for row in rows]).reshape(2, force.size, repeats)
    return Scatter(
        force, table[0], table[1], tuple(row[1] for row in rows[: len(rows) // 2]), field, burr, material,
        provenance(
            seed=seed, voxel_mm=voxel, dt_ms=dt, repeats=repeats, radius_mm=burr.radius, mean=field.mean,
            contrast=field.contrast, correlation_length_mm=field.correlation_length, c_e=material.c_e,
            alpha=material.alpha, shape=material.shape.name, **law_of(material),
        ),
    )  # fmt: skip


def _deviation(values: Floats) -> Floats:
    rows = [row[np.isfinite(row)] for row in values]
    return np.array([row.std(ddof=1) if row.size > 1 else np.nan for row in rows])


def _pooled(sd: Floats, n_dof: NDArray[np.int64]) -> float:
    known = n_dof > 0
    return float(np.sqrt(np.average(sd[known] ** 2, weights=n_dof[known]))) if known.any() else float("nan")


def _interval(sd: float, n_dof: int) -> tuple[float, float]:
    if n_dof < 1:
        return float("nan"), float("nan")
    tail = (1 - CONFIDENCE) / 2
    law = scipy.stats.chi2(n_dof)
    return float(sd * np.sqrt(n_dof / law.isf(tail))), float(sd * np.sqrt(n_dof / law.ppf(tail)))


def _bone_text(bone: BoneField) -> str:
    return (
        f"mean {bone.mean:g}, contrast {bone.contrast:g}, correlation length {bone.correlation_length:g} mm"
    )
