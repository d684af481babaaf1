"""The result of a fit: parameters, every start's end, residuals, data and provenance."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Material, Shape
from burrlab.curve import VelocityCurve
from burrlab.fitting import plain, report
from burrlab.fitting.problem import Bounds, ResidualKind
from burrlab.fitting.search import Start
from burrlab.fitting.verdict import Ridge
from burrlab.master_curve import MasterCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """c_e and alpha fitted to a velocity-force curve. Made by `burrlab.fit`.

    Attributes
    ----------
    c_e : float
        Elastic constant [N/mm^2].
    alpha : float
        Erosion rate [1/ms]: a number for this `shape`, drill, burr type and speed.
    shape : Shape
        Erosion shape function f that alpha belongs to.
    radius : float
        Burr radius R [mm].
    residual_kind : str
        ``"relative"``, ``"absolute"`` or ``"sigma"``.
    residual_norm : float
        RMS residual: 1 for ``"relative"`` (0.08 is 8 %) and ``"sigma"``, [mm/s] for ``"absolute"``.
    residuals, predicted : ndarray, shape (n_points,)
        Residuals, and predicted velocities [mm/s], of the rows used (``curve.ok``), in the curve's order.
    chi2_reduced : float or None
        Chi-square over degrees of freedom; None where the curve has no sigma.
    n_points, n_skipped : int
        Rows used, and rows without a number.
    status : str
        ``"ok"``; ``"ridge"``: only a combination of c_e and alpha is determined; ``"at-bound"``;
        ``"disagreement"``: starts ended equally well at different parameters; ``"not-converged"``.
    reason : str
        One sentence for any status.
    starts : tuple of Start
        Every search: begin, end, objective (sum of squared residuals), nlopt's result, evaluations.
    bounds : dict
        Bounds of ``c_e`` and ``alpha`` in the search.
    ridge : Ridge
        What is determined where c_e and alpha are not.
    engine : str
        ``"mean-field"`` or ``"voxel"``.
    seed : int
        Of the starts and of the voxel engine's descents.
    evaluations : int
        Of the objective, in all searches.
    seconds : float
        Duration of the fit [s].
    record : tuple
        Voxel engine: (c_e, alpha, sum of squared residuals) of every evaluation; empty otherwise.
    curve : VelocityCurve
        The data.
    provenance : dict
        Package version, parameters and platform.
    """

    c_e: float
    alpha: float
    shape: Shape
    radius: float
    residual_kind: ResidualKind
    residual_norm: float
    residuals: Floats
    predicted: Floats
    chi2_reduced: float | None
    n_points: int
    n_skipped: int
    status: str
    reason: str
    starts: tuple[Start, ...]
    bounds: Bounds
    ridge: Ridge
    engine: str
    seed: int
    evaluations: int
    seconds: float
    record: tuple[tuple[float, float, float], ...]
    curve: VelocityCurve
    provenance: Mapping[str, Any]

    @property
    def best(self) -> Start:
        """The search that found the parameters."""
        return min(self.starts, key=lambda start: start.objective)

    def material(self, name: str) -> Material:
        """The fitted material, its source telling where the numbers come from."""
        data = self.curve.source or "a velocity-force curve"
        source = f"fit to {data} ({self.engine}, status {self.status})"
        return Material(name, c_e=self.c_e, alpha=self.alpha, shape=self.shape, source=source)

    def velocity(
        self, force: ArrayLike, start_mm: float | None = None, end_mm: float | None = None
    ) -> np.float64 | Floats:
        """Mean-field penetration velocity at the fitted parameters.

        Parameters
        ----------
        force : array_like
            F [N].
        start_mm, end_mm : float, optional
            Window [mm]; max(R/6, static immersion) .. R/3 by default.

        Returns
        -------
        ndarray of the shape of `force`
            [mm/s]; NaN where the force leaves no window.
        """
        return self._velocity(force, self.alpha, start_mm, end_mm)

    def _velocity(
        self, force: ArrayLike, alpha: float, start_mm: float | None = None, end_mm: float | None = None
    ) -> np.float64 | Floats:
        window = [None if end is None else end / self.radius for end in (start_mm, end_mm)]
        phi = np.asarray(force, dtype=np.float64) / (self.c_e * self.radius**2)
        return 1e3 * alpha * self.radius * MasterCurve(self.shape).velocity_ratio(phi, *window)

    def report(self) -> str:
        """The fit as aligned text blocks."""
        return report.text(self)

    def plot(self, ax: Axes | None = None, *, alpha_lines: float | None = None, log: bool = False) -> Axes:
        """Data as squares and the fitted line, as in Fig. 5 of the paper.

        The line is the mean-field prediction over the default window. Where rows have windows of their own,
        or the engine is voxel, the prediction of each row is drawn as a dot besides.

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
        if alpha_lines is not None and not 0 < alpha_lines < self.alpha:
            raise ValueError(
                f"alpha_lines must be above 0 and below alpha, {self.alpha:g} /ms: got {alpha_lines!r}"
            )
        from burrlab.figures import VELOCITY

        ax = self.curve.plot(ax, log=log)
        used = self.curve.force[self.curve.ok]
        low = 0.85 * used.min() if log else 0.3 * used.min()
        high = min(1.04 * used.max(), 0.999 * self.c_e * self.radius**2 / 27**0.5)
        force = np.geomspace(low, high, 300)
        label = f"fit: $c_e$ = {self.c_e:#.3g} N/mm², $\\alpha$ = {self.alpha:#.3g} /ms"
        ax.plot(force, self.velocity(force), color="black", linewidth=1.2, label=label)
        if alpha_lines is not None:
            for sign, name in ((-1, f"$\\alpha$ ± {alpha_lines:g} /ms"), (1, None)):
                line = self._velocity(force, self.alpha + sign * alpha_lines)
                ax.plot(force, line, "--", color="0.4", linewidth=0.9, label=name)
        if self.engine == "voxel" or self.curve.window_start is not None:
            name = "voxel descents" if self.engine == "voxel" else "fit, over each row's window"
            ax.plot(used, self.predicted, "o", color=VELOCITY, markersize=3, label=name, zorder=4)
        if not log:
            ax.set(xlim=(0, 1.06 * used.max()), ylim=(0, None))
        ax.legend(frameon=False, fontsize="small")
        return ax

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
