"""The result of a fit: parameters, intervals, every start's end, residuals, data and provenance."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from burrlab._core import Burr, Material, Shape
from burrlab.curve import VelocityCurve
from burrlab.fitting import hypotheses, plain, report
from burrlab.fitting.evidence import Evidence
from burrlab.fitting.hypotheses import HypothesisTest
from burrlab.fitting.intervals import LEVELS, Combination, Interval, Region
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.mean_field import MeanFieldModel
from burrlab.fitting.observations import (
    Bounds,
    Data,
    Floats,
    Observations,
    ResidualKind,
    bounds_of,
)
from burrlab.fitting.profile import Domain, best_point
from burrlab.fitting.search import Start
from burrlab.fitting.verdict import Ridge, separately_identified
from burrlab.fitting.voxel import VoxelModel, VoxelTable
from burrlab.master_curve import MasterCurve
from burrlab.store import StorePath

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from burrlab.fitting.bootstrap import Bootstrap

_OPEN = Interval(None, None)


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """c_e and alpha fitted to data, and what the data determine. Made by `burrlab.fit`.

    Attributes
    ----------
    c_e : float
        Elastic constant [N/mm^2].
    alpha : float
        Erosion rate [1/ms]: a number for this `shape`, drill, burr type and speed.
    shape : Shape
        Erosion shape function f that alpha belongs to.
    radius : float or None
        Burr radius R [mm]; None where the data are of several.
    residual_kind : str
        ``"relative"``, ``"absolute"`` or ``"sigma"``.
    residual_norm : float
        RMS residual: 1 for ``"relative"`` (0.08 is 8 %) and ``"sigma"``, [mm/s] for ``"absolute"``.
    residuals, predicted : ndarray, shape (n_points,)
        Residuals, and predicted velocities [mm/s] or, of an indentation, forces [N], of the rows used, in the
        order of the data: usable rows of a curve, the five segments of a trace, pairs of an indentation.
    chi2_reduced : float or None
        Chi-square over degrees of freedom; None where a velocity has no sigma.
    n_points, n_skipped, n_censored : int
        Rows used, rows without a number, and those of them that bound c_e from above.
    status : str
        ``"ok"``; ``"ridge"``: only a combination of c_e and alpha is determined; ``"at-bound"``;
        ``"disagreement"``: starts ended equally well at different parameters; ``"not-converged"``.
    reason : str
        One sentence for any status.
    starts : tuple of Start
        Every search: begin, end, objective (sum of squared residuals), nlopt's result, evaluations.
    bounds : dict
        Bounds of ``c_e`` and ``alpha`` in the search.
    given_bounds : tuple of str
        Those of them that were asked for.
    evidence : Evidence or None
        Profiles, regions, information, scatters; None where nothing could be fitted.
    lack_of_fit : HypothesisTest or None
        Whether the model misses the means of repeats; None without repeats.
    fall : HypothesisTest or None
        Whether velocity falls with depth as the model says; None without traces.
    engine : str
        ``"mean-field"`` or ``"voxel"``.
    table : VoxelTable or None
        Voxel engine: its predictions over c_e.
    seed : int
        Of the starts and of the voxel engine's descents.
    evaluations : int
        Of the objective, in all searches.
    seconds : float
        Duration of the fit [s].
    record : tuple
        Voxel engine: (c_e, alpha) of every point that descents were made at; empty otherwise.
    data : tuple
        The data sets.
    provenance : dict
        Package version, parameters and platform.
    """

    c_e: float
    alpha: float
    shape: Shape
    radius: float | None
    residual_kind: ResidualKind
    residual_norm: float
    residuals: Floats
    predicted: Floats
    chi2_reduced: float | None
    n_points: int
    n_skipped: int
    n_censored: int
    status: str
    reason: str
    starts: tuple[Start, ...]
    bounds: Bounds
    given_bounds: tuple[str, ...]
    evidence: Evidence | None
    lack_of_fit: HypothesisTest | None
    fall: HypothesisTest | None
    engine: str
    table: VoxelTable | None
    seed: int
    evaluations: int
    seconds: float
    record: tuple[tuple[float, float], ...]
    data: tuple[Data, ...]
    provenance: Mapping[str, Any]

    @property
    def curve(self) -> VelocityCurve:
        """The first velocity curve of the data; ValueError without one."""
        for one in self.data:
            if isinstance(one, VelocityCurve):
                return one
        raise ValueError("the data of this fit hold no velocity curve")

    @property
    def intervals(self) -> Mapping[str, Mapping[str, Interval]]:
        """``c_e``, ``alpha`` -> ``68``, ``95``, ``99.7`` -> Interval, by profile likelihood; None is open."""
        if self.evidence is None:
            return {name: dict.fromkeys(LEVELS, _OPEN) for name in ("c_e", "alpha")}
        return self.evidence.profile.intervals

    @property
    def identified(self) -> Combination | None:
        """alpha/c_e^p, the combination that the data determine best."""
        return None if self.evidence is None else self.evidence.profile.identified

    @property
    def separately_identified(self) -> bool:
        """Whether c_e's 95 % interval has two ends within a factor of 2 of one another."""
        return separately_identified(self.intervals["c_e"]["95"])

    @property
    def verdict(self) -> str:
        """What the data determine, in plain words, at 95 %."""
        return self.reason if self.evidence is None else self.evidence.verdict

    @property
    def ridge(self) -> Ridge | None:
        """Where the data stand to the ridge."""
        return None if self.evidence is None else self.evidence.ridge

    @property
    def correlation(self) -> float:
        """Of the estimates of log c_e and log alpha, from the Fisher information at the fit."""
        if self.evidence is None:
            return np.nan
        information = self.evidence.information
        return float(-information[0, 1] / np.sqrt(information[0, 0] * information[1, 1]))

    @property
    def condition(self) -> float:
        """Condition number of the Fisher information in (log c_e, log alpha): large along a ridge."""
        return np.nan if self.evidence is None else float(np.linalg.cond(self.evidence.information))

    @property
    def n_parameters(self) -> int:
        """c_e, alpha and the scatters that were estimated."""
        return 2 if self.evidence is None else 2 + sum(not s.known for s in self.evidence.scatters)

    @property
    def log_likelihood(self) -> float:
        """At the fit, all constants in."""
        return np.nan if self.evidence is None else self.evidence.log_likelihood

    @property
    def aic(self) -> float:
        """2 k - 2 log L, k the number of parameters."""
        return 2 * self.n_parameters - 2 * self.log_likelihood

    @property
    def bic(self) -> float:
        """k log n - 2 log L."""
        return self.n_parameters * float(np.log(self.n_points)) - 2 * self.log_likelihood

    def region(self, level: str = "95") -> Region:
        """The joint region of c_e and alpha.

        Parameters
        ----------
        level : {"68", "95", "99.7"}

        Raises
        ------
        ValueError
            If the level is another, or the fit gave nothing.
        """
        evidence = self._evidence()
        if level not in LEVELS:
            raise ValueError(f"level must be one of {', '.join(LEVELS)}: got {level!r}")
        return evidence.profile.regions[level]

    def test(self, c_e: float, alpha: float) -> HypothesisTest:
        """Whether given values lie in the joint region: the rise of -2 log L, judged as the regions are.

        Parameters
        ----------
        c_e : float
            [N/mm^2]
        alpha : float
            [1/ms], for this fit's `shape`.

        Raises
        ------
        ValueError
            If a value is not positive and finite, or the fit gave nothing.
        """
        evidence = self._evidence()
        for name, value in (("c_e", c_e), ("alpha", alpha)):
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive and finite: got {value!r}")
        return hypotheses.given_values(
            self.likelihood, evidence.calibration, evidence.profile.base, float(c_e), float(alpha)
        )

    def differs_from(self, other: Fit) -> HypothesisTest:
        """Whether the data of two fits can be of one material: one c_e and alpha.

        Parameters
        ----------
        other : Fit
            Of the same shape and kind of residuals, both of the mean-field engine.

        Returns
        -------
        HypothesisTest
            Its hypothesis is that they are of one: a small p-value says that they differ.

        Raises
        ------
        ValueError
            If the fits differ in shape, kind of residuals or engine.

        Notes
        -----
        The experiments are taken to scatter alike. Where overloaded runs of one contradict the windows of the
        other, no common c_e exists and p is 0.
        """
        mine = (self.shape, self.residual_kind, self.engine)
        if mine != (other.shape, other.residual_kind, other.engine) or self.engine != "mean-field":
            raise ValueError("both fits must be mean-field ones with the same shape and kind of residuals")
        own = [
            replace(one, radius=fit.radius) if one.radius is None else one
            for fit in (self, other)
            for one in fit.data
        ]
        try:
            observations = Observations.of(own, None)
        except ValueError as error:
            return HypothesisTest("one material", np.inf, (), 0.0, f"The two differ: {error}.")
        both = Likelihood(observations, self.residual_kind, MeanFieldModel(observations, self.shape))
        common = best_point(both, Domain.of(both, bounds_of(observations, None), {}))
        points = [(self.c_e, self.alpha), (other.c_e, other.alpha), common]
        return hypotheses.one_material(self.likelihood, other.likelihood, both, points)

    def bootstrap(
        self,
        n: int = 1000,
        *,
        kind: str = "parametric",
        seed: int | None = None,
        executor: Executor | None = None,
        store: StorePath | None = None,
    ) -> Bootstrap:
        """Fits to n data sets made from this one; see `burrlab.fitting.bootstrap.bootstrap`."""
        from burrlab.fitting.bootstrap import bootstrap

        return bootstrap(self, n, kind=kind, seed=seed, executor=executor, store=store)

    def _evidence(self) -> Evidence:
        if self.evidence is None:
            raise ValueError(f"this fit gave nothing to judge by: {self.reason}")
        return self.evidence

    @cached_property
    def observations(self) -> Observations:
        """The rows of the data, as they were compared."""
        burr = Burr(self.radius) if any(one.radius is None for one in self.data) and self.radius else None
        return Observations.of(self.data, burr)

    @cached_property
    def likelihood(self) -> Likelihood:
        """-2 log L of the data, with the model that was fitted."""
        return Likelihood(self.observations, self.residual_kind, self.model_of(self.observations))

    def model_of(self, observations: Observations) -> MeanFieldModel | VoxelModel:
        """The engine of this fit; for the voxels' only with the rows of its own data."""
        if self.table is not None:
            return VoxelModel(observations, self.shape, self.table)
        return MeanFieldModel(observations, self.shape)

    @property
    def best(self) -> Start:
        """The search that found the parameters."""
        return min(self.starts, key=lambda start: start.objective)

    def material(self, name: str) -> Material:
        """The fitted material, its source telling where the numbers come from."""
        data = "; ".join(one.source for one in self.data if one.source) or "a velocity-force curve"
        source = f"fit to {data} ({self.engine}, status {self.status})"
        return Material(name, c_e=self.c_e, alpha=self.alpha, shape=self.shape, source=source)

    def velocity(
        self,
        force: ArrayLike,
        start_mm: float | None = None,
        end_mm: float | None = None,
        *,
        radius: float | None = None,
    ) -> np.float64 | Floats:
        """Mean-field penetration velocity at the fitted parameters.

        Parameters
        ----------
        force : array_like
            F [N].
        start_mm, end_mm : float, optional
            Window [mm]; max(R/6, static immersion) .. R/3 by default.
        radius : float, optional
            Burr radius [mm], needed where the data are of several.

        Returns
        -------
        ndarray of the shape of `force`
            [mm/s]; NaN where the force leaves no window.

        Raises
        ------
        ValueError
            If the data are of several radii and none is given.
        """
        return self._velocity(force, self.alpha, start_mm, end_mm, radius)

    def _velocity(
        self,
        force: ArrayLike,
        alpha: float,
        start_mm: float | None = None,
        end_mm: float | None = None,
        radius: float | None = None,
    ) -> np.float64 | Floats:
        R = self.radius if radius is None else radius
        if R is None:
            raise ValueError("radius must be given: the data are of several radii")
        window = [None if end is None else end / R for end in (start_mm, end_mm)]
        phi = np.asarray(force, dtype=np.float64) / (self.c_e * R**2)
        return 1e3 * alpha * R * MasterCurve(self.shape).velocity_ratio(phi, *window)

    def report(self) -> str:
        """The fit as aligned text blocks."""
        return report.text(self)

    def plot(self, ax: Axes | None = None, *, alpha_lines: float | None = None, log: bool = False) -> Axes:
        """Velocities as squares, the fitted line and its 95 % band, as in Fig. 5 of the paper.

        The line is the mean-field prediction over the default window, one each radius; the band is the range
        of the lines with parameters in the joint 95 % region, so it holds for all forces at once. Where rows have windows of their own, or
        the engine is voxel, the prediction of each row is drawn as a dot besides.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw; a new figure by default.
        alpha_lines : float, optional
            Draw dashed lines for alpha plus and minus this [1/ms]; the paper uses 0.01. They are no
            confidence interval.
        log : bool
            Both axes logarithmic.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ValueError
            If `alpha_lines` is not between 0 and alpha.
        """
        from burrlab.fitting.plots import plot_fit

        if alpha_lines is not None and not 0 < alpha_lines < self.alpha:
            raise ValueError(
                f"alpha_lines must be above 0 and below alpha, {self.alpha:g} /ms: got {alpha_lines!r}"
            )
        return plot_fit(self, ax, alpha_lines, log)

    def plot_profile(self, name: str = "c_e", ax: Axes | None = None) -> Axes:
        """Rise of -2 log L over c_e or alpha, the other at its best, with the limits of the three levels.

        Parameters
        ----------
        name : {"c_e", "alpha"}
        ax : matplotlib Axes, optional

        Raises
        ------
        ValueError
            If the name is another, or the fit gave nothing.
        """
        from burrlab.fitting.plots import plot_profile

        self._evidence()
        if name not in ("c_e", "alpha"):
            raise ValueError(f"name must be 'c_e' or 'alpha': got {name!r}")
        return plot_profile(self, name, ax)

    def plot_region(
        self,
        ax: Axes | None = None,
        *,
        points: Mapping[str, tuple[float, float]] | None = None,
        combination: bool = False,
    ) -> Axes:
        """Joint regions of c_e and alpha at 68, 95 and 99.7 %, logarithmic axes.

        Parameters
        ----------
        ax : matplotlib Axes, optional
        points : mapping, optional
            Name -> (c_e, alpha) to mark, such as given values.
        combination : bool
            alpha/c_e^p, the combination that is determined best, instead of alpha: a long ridge lies flat then.

        Raises
        ------
        ValueError
            If the fit gave nothing.
        """
        from burrlab.fitting.plots import plot_region

        self._evidence()
        return plot_region(self, ax, points, combination)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain Python objects, ready for JSON; what is not finite is None."""
        return plain.to_dict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Fit:
        """The fit that `to_dict` described."""
        return cls(**plain.from_dict(values))

    def to_json(self, file: str | os.PathLike[str] | IO[str]) -> None:
        """Write the fit, data included, as JSON that `from_json` reads back without loss."""
        if isinstance(file, (str, os.PathLike)):
            with open(file, "w", encoding="utf-8") as stream:
                self.to_json(stream)
        else:
            json.dump(self.to_dict(), file, indent=1, allow_nan=False)
            file.write("\n")

    @classmethod
    def from_json(cls, file: str | os.PathLike[str] | IO[str]) -> Fit:
        """Read a fit from JSON.

        Raises
        ------
        ValueError
            If the file is not the JSON of a fit.
        """
        if isinstance(file, (str, os.PathLike)):
            with open(file, encoding="utf-8") as stream:
                return cls.from_json(stream)
        name = getattr(file, "name", "JSON text")
        try:
            return cls.from_dict(json.load(file))
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError(f"{name}: this is not the JSON of a fit ({error})") from None

    def __repr__(self) -> str:
        return (
            f"Fit(c_e={self.c_e:.4g} N/mm^2, alpha={self.alpha:.4g} /ms, shape={self.shape.name!r}, "
            f"{self.n_points} points, {self.residual_kind} residual {self.residual_norm:.3g}, {self.status})"
        )

    def _repr_html_(self) -> str:
        return report.html(self)
