"""The result of a fit: what can be asked of it, and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from burrlab._core import Material
from burrlab.fitting import hypotheses, report
from burrlab.fitting.hypotheses import HypothesisTest
from burrlab.fitting.intervals import LEVELS, Region
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.mean_field import MeanFieldModel
from burrlab.fitting.observations import (
    Floats,
    Observations,
    bounds_of,
)
from burrlab.fitting.profile import Domain, best_point
from burrlab.fitting.record import FitRecord
from burrlab.master_curve import MasterCurve
from burrlab.store import StorePath

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from burrlab.fitting.bootstrap import Bootstrap


@dataclass(frozen=True, eq=False, repr=False)
class Fit(FitRecord):
    """c_e and alpha fitted to data, and what the data determine. Made by `burrlab.fit`.

    What it keeps is described in `burrlab.fitting.record.FitRecord`: `c_e` [N/mm^2], `alpha` [1/ms], `status` and
    `reason`, `intervals`, `identified`, `separately_identified`, `verdict`, `predicted` and `residuals`,
    `evidence`, `starts`, `data`, `provenance` and more; so is its JSON, `to_json` and `from_json`.
    """

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
        evidence = self.known_evidence()
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
        evidence = self.known_evidence()
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
        R = self.radius if radius is None else radius
        if R is None:
            raise ValueError("radius must be given: the data are of several radii")
        window = [None if end is None else end / R for end in (start_mm, end_mm)]
        phi = np.asarray(force, dtype=np.float64) / (self.c_e * R**2)
        return 1e3 * self.alpha * R * MasterCurve(self.shape).velocity_ratio(phi, *window)

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

        self.known_evidence()
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

        self.known_evidence()
        return plot_region(self, ax, points, combination)

    def __repr__(self) -> str:
        return (
            f"Fit(c_e={self.c_e:.4g} N/mm^2, alpha={self.alpha:.4g} /ms, shape={self.shape.name!r}, "
            f"{self.n_points} points, {self.residual_kind} residual {self.residual_norm:.3g}, {self.status})"
        )

    def _repr_html_(self) -> str:
        return report.html(self)
