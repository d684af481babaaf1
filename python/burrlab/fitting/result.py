"""The result of a fit: tests, predictions and figures."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

import burrlab.fitting.report as report
from burrlab._core import Material
from burrlab.bone.materials import MATERIAL_LOOKS
from burrlab.common.check import check_positive, refuse, scalar
from burrlab.common.figures import (
    FORCE,
    POSITION,
    REFERENCE,
    SERIES,
    VELOCITY,
    Axes,
    axes_or_new,
    drawing,
    next_look,
    plot_points,
    styled,
)
from burrlab.common.progress import Progress
from burrlab.common.study import StorePath
from burrlab.common.table import Tabulated
from burrlab.fitting.bootstrap import Bootstrap, bootstrap
from burrlab.fitting.calibration import MixedCalibration
from burrlab.fitting.diagnostics import HypothesisTest, Row, given_values, influence, rows_limit
from burrlab.fitting.linear import OFFSETS
from burrlab.fitting.mixed import MixedLikelihood
from burrlab.fitting.observations import Floats
from burrlab.fitting.profile import ALPHA, C_E, LEVELS, Region, level_name
from burrlab.fitting.record import FitRecord
from burrlab.fitting.repairs import LevelLeftOut, without_levels
from burrlab.fitting.slices import FREEDOM
from burrlab.fitting.verdict import span
from burrlab.measured.curve import VelocityCurve
from burrlab.theory.continuum import WINDOW_START, WINDOW_STOP, Law, MasterCurve, positive


@dataclass(frozen=True, eq=False, repr=False)
class Fit(FitRecord, Tabulated):
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
        Burr radius R [mm]; None where the data have several.
    residual_kind : str
        ``"relative"``, ``"absolute"`` or ``"sigma"``.
    residual_norm : float
        RMS residual: [1] for ``"relative"`` (0.08 is 8 %) and ``"sigma"``, [mm/s] for ``"absolute"``.
    residuals, predicted : ndarray, shape (n_points,)
        Residuals, and predicted velocities [mm/s] or (indentations) forces [N], by row used, in the order of
        the data: usable rows of a curve, the five segments of a trace, pairs of an indentation.
    chi2_reduced : float or None
        Chi-square over degrees of freedom; None where a velocity has no sigma.
    n_points, n_skipped, n_censored : int
        Rows used, rows without a velocity, and censored ones, which bound c_e from above.
    status : str
        ``"ok"``; ``"poor-fit"``: the data contradict the model; ``"implausible"``: no burring gives such
        data; ``"ridge"``: only a combination of c_e and alpha is determined; ``"at-bound"``;
        ``"disagreement"``: searches ended equally well at different parameters; ``"not-converged"``.
    reason : str
        The status in one sentence.
    starts : tuple of Start
        Every search, the walk first: begin, end, objective (sum of squared residuals), nlopt's result,
        evaluations.
    bounds : dict
        Bounds of ``c_e`` and ``alpha`` in the search.
    given_bounds : tuple of str
        Names of given bounds.
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
        Seed of the voxel engine's descents.
    evaluations : int
        Evaluations of the objective, in all searches.
    seconds : float
        Duration of the fit [s].
    record : tuple
        Voxel engine: (c_e, alpha) of every point that descents were made at; empty otherwise.
    data : tuple
        The data sets.
    provenance : dict
        Package version, parameters and platform.
    force_exponent, rate_exponent : float
        Exponents of the law, 3/2 and 0 in the paper's.
    """

    def region(self, level: str | float = "95") -> Region:
        """The joint region of c_e and alpha.

        Parameters
        ----------
        level : {"68", "95", "99.7"} or number

        Raises
        ------
        ValueError
            If the level is unknown, or the fit failed.
        """
        regions, name = self._evidence().profile.regions, level_name(level)
        refuse(name not in regions, f"the fit must have a region of {name} %: it has {', '.join(regions)}")
        return regions[name]

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
            If a value is not positive and finite, or the fit failed.
        """
        evidence = self._evidence()
        check_positive("c_e", c_e)
        check_positive("alpha", alpha)
        return given_values(
            self.likelihood, evidence.calibration, evidence.profile.base, float(c_e), float(alpha)
        )

    def influence(self) -> tuple[Row, ...]:
        """Every row of the curves: leverage, studentised residual, and the fit without it.

        Of more than 1000 rows only the two that lie farthest off are fitted without.
        """
        self._evidence()
        bounds = {name: self.bounds[name] for name in self.given_bounds}
        return influence(self.likelihood, (self.c_e, self.alpha), self.data, bounds)

    def influence_by(self, group: str) -> tuple[LevelLeftOut, ...]:
        """The fit without the velocities of each day or specimen, with the variances estimated again.

        Parameters
        ----------
        group : str
            One with effects, such as "specimen".

        Raises
        ------
        ValueError
            If there is no such group, or the fit is of the voxel engine.
        """
        groups = {x.name: x for x in self.observations.groups if x.name in self._groups}
        refuse(group not in groups, f"group must be one with effects, {sorted(groups)}: got {group!r}")
        refuse(self.table is not None, "the voxel engine's table serves the rows of its own data alone")
        return without_levels(
            self._plain,
            cast("MixedLikelihood", self.likelihood),
            groups[group],
            self._evidence().profile.identified.exponent,
        )

    def bootstrap(
        self,
        n: int = 1000,
        *,
        kind: str = "parametric",
        seed: int | None = None,
        executor: Executor | None = None,
        store: StorePath | None = None,
        progress: Progress | None = None,
    ) -> Bootstrap:
        """Fits to n data sets made from this one; see `burrlab.fitting.bootstrap.bootstrap`."""
        return bootstrap(self, n, kind=kind, seed=seed, executor=executor, store=store, progress=progress)

    def material(self, name: str) -> Material:
        """The fitted material; its source says where the numbers come from."""
        data = (
            "; ".join(data_set.source for data_set in self.data if data_set.source)
            or "a velocity-force curve"
        )
        return self.law.material(
            self.c_e, self.alpha, name, f"fit to {data} ({self.engine}, status {self.status})"
        )

    def levels(self, group: str) -> dict[str, tuple[float, float]]:
        """c_e [N/mm^2] and alpha [1/ms] of each level of a group, by its label; `effects` has their errors.

        Parameters
        ----------
        group : str
            Such as "day" or "specimen"; "data set" where data sets have an alpha each.

        Raises
        ------
        ValueError
            If no such group has effects.
        """
        effects = [x for x in self.effects if x.group == group and x.quantity in ("c_e", "alpha")]
        refuse(not effects, f"group must be one with effects, {sorted(self._groups)}: got {group!r}")
        labels, o = effects[0].levels, self.observations
        if group == "data set":  # an indentation has no alpha
            with_alpha = (
                np.unique(o.sets.velocity) if effects[0].quantity == "alpha" else range(len(o.sets.levels))
            )
            labels = tuple(o.sets.levels[k] for k in with_alpha)
        factors = {
            (x.quantity, label): float(np.exp(logarithm))
            for x in effects
            for label, logarithm in zip(x.levels, x.values, strict=True)
        }
        return {
            label: (
                self.c_e * factors.get(("c_e", label), 1.0),
                self.alpha * factors.get(("alpha", label), 1.0),
            )
            for label in labels
        }

    @property
    def _groups(self) -> dict[str, None]:
        """Groups whose levels have values of their own."""
        return dict.fromkeys(x.group for x in self.effects if x.quantity in ("c_e", "alpha"))

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
            Burr radius [mm], needed where the data have several.

        Returns
        -------
        ndarray of the shape of `force`
            [mm/s]; NaN where the force leaves no window.

        Raises
        ------
        ValueError
            If a force or the radius is not positive and finite, or the data have several radii and none is given.
        """
        R = self.radius if radius is None else radius
        if R is None:
            raise ValueError("radius must be given: the data are of several radii")
        check_positive("radius", R)

        return self.law.velocity(
            positive("force", force),
            self.c_e,
            self.alpha,
            R,
            *[
                None if end is None else scalar(end, name) / R
                for name, end in (("start_mm", start_mm), ("end_mm", end_mm))
            ],
        )

    def velocity_interval(
        self, force: ArrayLike, *, level: str | float = "95", new: str = "", radius: float | None = None
    ) -> tuple[Floats, Floats]:
        """Interval of the velocity in the default window, of the mean or of what would be measured next.

        Parameters
        ----------
        force : array_like
            F [N].
        level : {"68", "95", "99.7"}
        new : str
            Empty: of the mean over runs, and over days and specimens where the fit knows these. A group's name
            (``"day"``, ``"specimen"``): of the mean of a new one. ``"run"``: of a single run, in new ones of all groups.
        radius : float, optional
            Burr radius [mm], needed where the data have several.

        Returns
        -------
        low, high : ndarray of the shape of `force`
            [mm/s]; NaN where the force leaves no window.

        Raises
        ------
        ValueError
            As `velocity`; if the fit gave nothing or knows no such group; for a single run, if residuals are not
            relative.

        Notes
        -----
        ln v is linear in log c_e and log alpha near the fit, and its standard error that of the fit along the gradient
        (-n, 1), n the exponent of v ~ F^n over a standard deviation of ln c_e to either side, as far as there are
        windows; a new group adds its variances. The limit is Student's t.
        """
        evidence, calibration = self._evidence(), self._evidence().calibration
        groups = {effect.group for effect in self.effects if effect.interval is not None}
        refuse(
            new not in {"", "run", *groups},
            f"new must be one of {', '.join(['run', *sorted(groups)])}: got {new!r}",
        )
        refuse(
            new == "run" and self.residual_kind not in ("relative", "student"),
            "the interval of a single run needs relative residuals",
        )
        v, R = np.atleast_1d(self.velocity(force, radius=radius)), self.radius if radius is None else radius
        assert R is not None
        half = np.full(v.shape, np.nan)
        estimated = [x for x in self.effects if x.interval is not None]
        scatters = [x for x in evidence.scatters if not x.known]
        variances = np.square([x.value for x in scatters] + [x.deviation or 0.0 for x in estimated])
        # with more degrees of freedom that of a new run could be narrower than that of a new group, or of the mean
        names = dict.fromkeys(("", *(sorted(groups) if new == "run" else ()), new))
        exponents = self._exponents(np.atleast_1d(np.asarray(force, np.float64)), R, new)
        for i in np.ndindex(v.shape):
            if np.isfinite(v[i]):
                n = float(exponents[i])
                direction = np.array([-n, 1.0])
                variance, nu = calibration.variance(direction)
                for name in names:
                    weights = np.array([
                        *(float(name == "run" and x.name == "velocity") for x in scatters),
                        *((n**2 if x.quantity == "c_e" else 1.0) * (name in ("run", x.group)) for x in estimated),
                    ])  # fmt: skip
                    added = float(weights @ variances)
                    if isinstance(calibration, MixedCalibration):
                        nu = calibration.freedom(direction, weights, added)
                    most = {("run", "student"): FREEDOM}.get((name, self.residual_kind), 1e9)
                    t = -special.stdtrit(min(nu, most), (1 - LEVELS[level_name(level)]) / 2)
                    half[i] = np.fmax(half[i], t * np.sqrt(variance + added))
        low, high = (np.reshape(v * np.exp(sign * half), np.shape(force)) for sign in (-1, 1))
        return low, high

    def _exponents(self, force: Floats, radius: float, new: str) -> Floats:
        """n of v ~ F^n within a standard deviation of ln c_e; at c_e where a force leaves an end no window."""
        groups = [x for x in self.effects if x.interval is not None and new in ("run", x.group)]
        of_c_e = [x.deviation or 0.0 for x in groups if x.quantity == "c_e"]
        variance = self._evidence().calibration.variance(C_E)[0]
        spread = min(float(np.sqrt(variance + np.dot(of_c_e, of_c_e))), 0.5)
        softer, stiffer = (
            self.law.velocity(force, self.c_e * np.exp(sign * spread), self.alpha, radius) for sign in (-1, 1)
        )
        phi = self.law.master_phi(force / (self.c_e * radius**2))
        wide = np.log(softer / stiffer) / (2 * spread)
        return np.where(np.isnan(wide), self.law.stretch * MasterCurve(self.shape).local_slope(phi), wide)

    def _check_whole(self) -> None:
        """An error where the report lacks something; its repairs, which take long, are not asked for."""
        vars(self)["repairs"] = ()
        self.report()
        del vars(self)["repairs"]

    def report(self, verbose: bool = False) -> str:
        """The fit as aligned text blocks.

        Parameters
        ----------
        verbose : bool
            Add the table of searches, with nlopt's return codes.
        """
        return report.text(self, verbose)

    @drawing
    def plot(
        self, ax: Axes | None = None, *, alpha_lines: float | None = None, log: bool = False, **style: Any
    ) -> Axes:
        """Velocities as squares, the fitted line and its 95 % band, as in Fig. 5 of the paper.

        The line is the mean-field prediction over the default window, one per radius. The band is the range
        of the lines with parameters in the joint 95 % region, so it holds for all forces at once. Where rows
        have windows of their own, or the engine is voxel, a dot is the prediction of a row. Where the fit knows
        days or specimens, points and thin lines have a colour for each, and a paler band is for the mean of a new one.

        Parameters
        ----------
        alpha_lines : float, optional
            Draw dashed lines for alpha plus and minus this [1/ms]; the paper uses 0.01. They are no
            confidence interval.
        log : bool
            Make both axes logarithmic.
        **style
            Of line and points; the band fades from the colour. A label stands for both.

        Raises
        ------
        ValueError
            If `alpha_lines` is not between 0 and alpha.
        """
        refuse(
            alpha_lines is not None and not 0 < scalar(alpha_lines, "alpha_lines") < self.alpha,
            f"alpha_lines must be above 0 and below alpha, {self.alpha:g} /ms: got {alpha_lines!r}",
        )
        ax = axes_or_new(ax)
        o = self.observations
        if style.get("label") or ax.lines:
            style = next_look(ax, style, color="black", marker="s", linestyle="-")
        named = style.pop("label", None)
        line = {key: value for key, value in style.items() if not key.startswith("mark")}
        self._plot_points(
            ax,
            log,
            "" if named else min(self._groups, key=lambda x: x != "data set", default=""),
            {"color": "black", "marker": "s", **style, "linestyle": "", "label": named and f"_{named}"},
        )
        default = np.isnan(o.window_start)
        free = " without offsets" * any(x.quantity in OFFSETS for x in self.effects)
        label = f"fit{free}: $c_e$ = {self.c_e:#.3g} N/mm², $\\alpha$ = {self.alpha:#.3g} /ms"
        if ridge := self._on_ridge:
            label = f"ridge: $\\alpha/c_e^{{{ridge.exponent:.3g}}}$ = {span(ridge.interval)} (95 %)"
        several, shade = self.radius is None, {"label": "95 % band", "color": style.get("color", FORCE)}
        for R, colour in zip(sorted(set(o.radius[default].tolist())), itertools.cycle(LINES), strict=False):
            look = {"color": colour, "label": f"fit, R = {R:g} mm"} if several else {"label": label}
            look = styled(
                line, **{"color": "black", "linewidth": 1.2} | look | ({"label": None} if named else {})
            )
            self._plot_radius(ax, R, log, alpha_lines, shade, look)
            shade["label"] = None
        if self.engine == "voxel" or not default.all():
            name = "voxel descents" if self.engine == "voxel" else "fit, over each row's window"
            rows = np.concatenate([np.full(len(rows), kind == "velocity") for kind, rows in o.rows])
            ax.plot(o.force, self.predicted[rows], "o", color=VELOCITY, markersize=3, label=name, zorder=4)
        if named:
            plot_points(ax, [], [], None, {"linestyle": "-", "linewidth": 1.2, **style}, named)
        ax.set(xlabel="force [N]", ylabel="penetration velocity [mm/s]")
        if log:
            ax.autoscale()  # a logarithmic axis cannot begin at zero
        else:
            ax.set(xlim=(0, 1.06 * o.force.max()), ylim=(0, None))
        return ax

    def _plot_points(self, ax: Axes, log: bool, grouped: str, dress: dict[str, Any]) -> None:
        """The velocities, by the levels of a group if one is named."""
        if grouped:
            self._plot_levels(ax, grouped, log)
            return
        for curve in (data_set for data_set in self.data if isinstance(data_set, VelocityCurve)):
            curve.plot(ax, log=log, **dress)
        o, segment = self.observations, self.observations.run >= 0
        if segment.any():
            ax.plot(o.force[segment], o.velocity[segment], "D", color="black", mfc="none", ms=3.5, mew=0.7,
                    label="segments of traces")  # fmt: skip

    def _plot_levels(self, ax: Axes, name: str, log: bool) -> None:
        """The points of each level of a group with its thin line, and the band of a new level's mean."""
        o, levels = self.observations, self.levels(name)
        group = o.by_name[name]
        ax.set(xscale="log" if log else "linear", yscale="log" if log else "linear")
        for k, (label, (c_e, alpha)) in enumerate(levels.items()):
            look = SERIES[k % len(SERIES)]
            rows = group.velocity == group.levels.index(label)
            dress: dict[str, Any] = {"color": look["color"], "linestyle": "", "marker": look["marker"]}
            if k // len(SERIES) % 2:  # the look is that of an earlier one
                dress["mfc"] = "white"
            text = _level_text(name, label) if len(levels) <= _NAMED else "_"
            ax.plot(o.force[rows], o.velocity[rows], label=text, markersize=4, zorder=3, **dress)
            for R in sorted(set(o.radius[rows & np.isnan(o.window_start)].tolist())):
                force = _span_of(o.force[rows & (o.radius == R)], self.law, c_e, R, log)
                ax.plot(force, self.law.velocity(force, c_e, alpha, R), color=look["color"], linewidth=0.6, alpha=0.8)  # fmt: skip
        if self.radius is not None and name != "data set" and np.isnan(o.window_start).any():
            force = _span_of(o.force, self.law, self.c_e, self.radius, log)
            ax.fill_between(
                force, *self.velocity_interval(force, new=name), color=FORCE, alpha=0.1, linewidth=0,
                label=f"95 %, mean of a new {name}",
            )  # fmt: skip

    @drawing
    def plot_effects(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Each level's own c_e and alpha over the population's, in per cent, with standard errors.

        Raises
        ------
        ValueError
            If the fit has no groups.
        """
        effects = [x for x in self.effects if x.quantity in ("c_e", "alpha")]
        refuse(not effects, "effects of groups need a fit with groups: it has none")
        ax, names = axes_or_new(ax), list[str]()
        for look, x in zip(itertools.cycle(SERIES), effects, strict=False):
            value, error = (100 * np.array(column) for column in (x.values, x.errors))
            ax.errorbar(
                value,
                len(names) + np.arange(len(x.levels)),
                xerr=error,
                capsize=2,
                elinewidth=0.9,
                label=f"{x.quantity} by {x.group}",
                **styled(
                    {"linestyle": "", **style}, color=look["color"], marker=look["marker"], markersize=5
                ),
            )
            names += [_level_text(x.group, label) for label in x.levels]
        ax.axvline(0, color=REFERENCE, linewidth=0.8)
        ax.set(
            yticks=range(len(names)),
            yticklabels=names,
            ylim=(len(names) - 0.5, -0.5),
        )
        ax.set_xlabel("100 ln of its value over the population's [%]")
        return ax

    def _plot_radius(
        self, ax: Axes, R: float, log: bool, alpha_lines: float | None, shade: Any, look: Any
    ) -> None:
        """The line and band of one radius over its forces in the default window, and alpha plus and minus."""
        o = self.observations
        force = _span_of(o.force[np.isnan(o.window_start) & (o.radius == R)], self.law, self.c_e, R, log)
        velocity = self.velocity(force, radius=R)
        ax.fill_between(force, *band(self, force, R), zorder=1, linewidth=0, alpha=0.2, **shade)
        ax.plot(force, velocity, **look)
        if alpha_lines is not None:
            for sign, label in ((-1, f"$\\alpha$ ± {alpha_lines:g} /ms"), (1, None)):
                beside = velocity * (1 + sign * alpha_lines / self.alpha)
                ax.plot(force, beside, "--", color="0.4", linewidth=0.9, label=label)

    @drawing
    def plot_profile(self, name: str = "c_e", ax: Axes | None = None, **style: Any) -> Axes:
        """Rise of -2 log L over c_e or alpha, the other at its best, with the limits of the three levels.

        Parameters
        ----------
        name : {"c_e", "alpha"}

        Raises
        ------
        ValueError
            If the name is unknown, or the fit failed.
        """
        refuse(name not in ("c_e", "alpha"), f"name must be 'c_e' or 'alpha': got {name!r}")
        evidence, ax = self._evidence(), axes_or_new(ax)
        profile = evidence.profile
        x, rise = (profile.c_e, profile.c_e_rise) if name == "c_e" else (profile.alpha, profile.alpha_rise)
        limits = evidence.calibration.limits(LEVELS, C_E if name == "c_e" else ALPHA)
        limits = {level: limit for level, limit in limits.items() if limit < 10 * limits["95"]}
        top = 1.6 * max(limits.values())  # with a degree of freedom or two the highest hides all else
        near = np.flatnonzero((rise < top) & (x < 12 * getattr(self, name)))
        drawn = slice(max(near[0] - 1, 0), near[-1] + 2)
        look = next_look(ax, style, color=FORCE, linestyle="-", linewidth=1.4, label="profile")
        ax.plot(x[drawn], rise[drawn], **look)
        for level, limit in limits.items():
            ax.axhline(limit, color=REFERENCE, linewidth=0.8, linestyle="--", label="limits of the levels")
            ax.annotate(f"{level} %", (0.995, limit), xycoords=("axes fraction", "data"), xytext=(0, 2),
                        textcoords="offset points", ha="right", fontsize=8, color=REFERENCE,
                        bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none"})  # fmt: skip
        ax.axvline(getattr(self, name), color="black", linewidth=0.8, label="fit")
        interval = profile.intervals[name]["95"]
        for end in (interval.lower, interval.upper):
            if end is not None and end < 12 * getattr(self, name):
                ax.axvline(end, color=look["color"], linewidth=0.8, linestyle=":", label="95 % interval")
        if interval.upper is None:
            ax.annotate(
                "open above", (0.9, 0.04), xycoords="axes fraction", ha="right", fontsize=8, color=FORCE
            )
        ax.set(xscale="log", xlabel=_UNITS[name], ylabel="rise of $-2 \\log L$", ylim=(0, top))
        ax.set_xlim(0.97 * x[near[0]], 1.03 * x[near[-1]])
        return ax

    @drawing
    def plot_region(
        self,
        ax: Axes | None = None,
        *,
        points: Mapping[str, tuple[float, float]] | None = None,
        combination: bool = False,
        **style: Any,
    ) -> Axes:
        """Joint regions of c_e and alpha at 68, 95 and 99.7 %, logarithmic axes.

        Parameters
        ----------
        points : mapping, optional
            Name -> (c_e, alpha) to mark, such as given values.
        combination : bool
            Draw alpha/c_e^p, the best-determined combination, instead of alpha, so that a long ridge lies
            flat.
        **style
            Of the regions; the colour fades outwards. With a label the legend's levels are grey.

        Raises
        ------
        ValueError
            If the fit failed.
        """
        profile, ax = self._evidence().profile, axes_or_new(ax)
        widest, look = 12 * self.c_e, next_look(ax, style, color=FORCE, label="fit")
        color, named = look.pop("color"), look.pop("label")
        p = profile.identified.exponent if combination else 0.0
        edge = color if named == "fit" else "black"
        # A region lies on the wider ones and so looks like `seen`, in the legend too: once for all fits.
        for level, alpha, seen in (("99.7", 0.2, 0.2), ("95", 0.35, 0.48), ("68", 0.6, 0.79)):
            region = profile.regions[level]
            near = region.c_e <= widest
            c_e = region.c_e[near]
            ax.fill_between(
                c_e,
                region.lower[near] / c_e**p,
                region.upper[near] / c_e**p,
                **{"color": (color, alpha), "edgecolor": color, "linewidth": 0.6, **look},
            )
            ax.fill_between([], [], color=(edge, seen), ec=edge, lw=0.6, label=f"{level} %")
        opened = ", ".join(level for level in LEVELS if profile.regions[level].open_above)
        named += f", {opened} % open above" if opened else ""
        ax.plot(self.c_e, self.alpha / self.c_e**p, "P", color=color, mec="white", mew=0.7, ms=6, label=named)
        for marker, (name, (c_e_there, alpha)) in zip("osD^v*", (points or {}).items(), strict=False):
            ax.plot(c_e_there, alpha / c_e_there**p, marker, color=VELOCITY, mfc="white", mew=1.2, ms=5.5,
                    label=name)  # fmt: skip
        power = f"$\\alpha/c_e^{{{p:.3g}}}$ [(1/ms) (mm²/N)$^{{{p:.3g}}}$]"
        ax.set(
            xscale="log", yscale="log", xlabel=_UNITS["c_e"], ylabel=power if combination else _UNITS["alpha"]
        )
        return ax

    @drawing
    def plot_residuals(self, ax: Axes | None = None, *, over: str = "force", **style: Any) -> Axes:
        """Externally studentised residuals of the curves' rows over force or order, with the limit of `influence`.

        Parameters
        ----------
        over : {"force", "order"}
            What is on the axis: F, or the number of the row in the data.

        A row that stands out has its number, from 1 after the header; of several data sets also the set's.

        Raises
        ------
        ValueError
            If the fit failed, or has no curve.
        """
        refuse(over not in ("force", "order"), f"over must be 'force' or 'order': got {over!r}")
        point = self.c_e, self.alpha
        rows = influence(self.likelihood, point, self.data, {}, refitted=False)
        refuse(not rows, "residuals of rows need a curve: the fit has none")
        ax = axes_or_new(ax)
        force, size = (np.array([getattr(row, name) for row in rows]) for name in ("force", "studentised"))
        x = force if over == "force" else np.arange(1, len(rows) + 1)
        named = np.array([row.named for row in rows])
        look = next_look(
            ax, {"linestyle": "", **style}, color=FORCE, marker="o", markersize=4, zorder=3, label="rows"
        )
        ax.plot(x[~named], size[~named], **look)
        limit = rows_limit(self.likelihood, point, ~named)
        if limit is not None:
            ax.axhspan(-limit, limit, color="0.95", zorder=0)
            for sign, limit_label in ((1, f"limit ±{limit:.2g}: 5 % of clean sets pass it"), (-1, None)):
                ax.axhline(sign * limit, color=REFERENCE, linewidth=0.8, linestyle="--", label=limit_label)
        if named.any():
            ax.plot(x[named], size[named], **(look | {"marker": "D", "mfc": "white", "label": "stands out"}))
        for row, place in zip(rows, x.tolist(), strict=True):
            if row.named:
                number = f"{row.data_set + 1}: {row.row}" if len(self.data) > 1 else f"{row.row}"
                ax.annotate(f"row {number}", (place, row.studentised), xytext=(6, 0), va="center",
                            textcoords="offset points", fontsize=8)  # fmt: skip
        ax.axhline(0, color=REFERENCE, linewidth=0.6)
        ax.margins(x=0.1)
        why = "" if limit else "\n(no limit below 8 rows)"
        place = "force [N]" if over == "force" else "row, in the order of the data [1]"
        ax.set(xlabel=place, ylabel=f"studentised residual [sigma]{why}")
        return ax

    def _table(self) -> dict[str, list[Any]]:
        return report.parameter_columns(self)

    def __repr__(self) -> str:
        parameters = f"c_e={self.c_e:.4g} N/mm^2, alpha={self.alpha:.4g} /ms"
        if ridge := self._on_ridge:
            p = f"{ridge.exponent:.4g}"
            parameters = f"ridge: alpha/c_e^{p} = {span(ridge.interval)} (1/ms)/(N/mm^2)^{p} at 95 %"
        return (
            f"Fit({parameters}, {'shape' if self.law.is_paper else 'law'}={str(self.law)!r}, "
            f"{self.n_points} points, {self.residual_kind} residual {self.residual_norm:.3g}, {self.status})"
        )

    def _repr_html_(self) -> str:
        return report.html(self)


LINES = (FORCE, VELOCITY, POSITION, "black")  # one per radius
_UNITS = {"c_e": "$c_e$ [N/mm²]", "alpha": "$\\alpha$ [1/ms]"}
_NAMED = 8  # levels of a group that a legend names
_BAND = 60  # lines whose envelope is the band
Items: TypeAlias = "Sequence[VelocityCurve | Fit] | Mapping[str, VelocityCurve | Fit]"


@drawing
def plot_curves(items: Items, ax: Axes | None = None, *, log: bool = True, **style: Any) -> Axes:
    """Several materials, burrs or drills in one figure, in looks that differ in colour, grey and shape.

    A shipped material that is named so, such as "bone", looks the same in each figure.

    Data are points, with error bars if sigma is known; a fit adds its line and 95 % band. A bar across a line
    marks the fit's kink at phi = F/(c_e R^2) = 0.068. Below it the default window begins deeper than static
    contact and the data determine only alpha/c_e^p; c_e itself shows above it (docs/model.md, section 5).

    Parameters
    ----------
    items : sequence, or mapping of names, of VelocityCurve and Fit
        Without names, the sources of the data are the labels.
    log : bool
        Make both axes logarithmic.
    **style
        Properties of all points and lines, such as `markersize`.

    Raises
    ------
    ValueError
        If there is no curve or fit.
    TypeError
        If an item is neither.

    Examples
    --------
    >>> import burrlab
    >>> burr, forces = burrlab.Burr(3.0), [0.5, 1.0, 2.0]
    >>> curves = {name: burrlab.synthetic_curve(burr, burrlab.materials[name], forces, seed=1) for name in ("bone", "pvc")}
    >>> plot_curves(curves).get_xlabel()
    'force [N]'
    """
    if not isinstance(items, Mapping):
        items = [items] if isinstance(items, VelocityCurve | Fit) else items
        sources = [getattr(x.data[0] if isinstance(x, Fit) else x, "source", "") for x in items]
        names = [f"{k}: {source}".rstrip(": ") for k, source in enumerate(sources, 1)]
        items = dict(zip(names, items, strict=True))
    refuse(not items, "items must hold a curve or a fit, got none")
    ax = axes_or_new(ax)
    bar: dict[str, Any] = {"marker": (2, 2, 45), "linestyle": "", "mew": 1.2}  # across a line that rises
    kinks: list[float] = []
    shipped = {name: MATERIAL_LOOKS[name] for name in items if name in MATERIAL_LOOKS}
    others = itertools.cycle([look for look in SERIES if look not in shipped.values()])
    for name, material in items.items():
        dress: dict[str, Any] = {"label": name, **(shipped.get(name) or next(others)), **style}
        if isinstance(material, VelocityCurve):
            material.plot(ax, log=log, **dress | {"linestyle": ""})
            continue
        if not isinstance(material, Fit):
            raise TypeError(f"items must be VelocityCurve or Fit, got {type(material).__name__} for {name!r}")
        material.plot(ax, log=log, **dress)
        o = material.observations
        for R in sorted(set(o.radius[np.isnan(o.window_start)].tolist())):
            force, kink = o.force[o.radius == R], material.c_e * R**2 * WINDOW_START**material.force_exponent
            if force.min() < kink < force.max():
                ax.plot(kink, material.velocity(kink, radius=R), color=dress["color"], ms=18, zorder=5, **bar)
                kinks.append(kink)
    if kinks:
        ax.plot([], [], color=REFERENCE, ms=11, label="kink: $c_e$ shows above", **bar)
    return ax


def _level_text(group: str, label: str) -> str:
    """The name of a group's level in a figure."""
    text = label if label.startswith(group) else f"{group} {label}"
    return (text if len(text) < 30 else f"{text[:29]}…").replace("$", r"\$")


def _span_of(force: Floats, law: Law, c_e: float, R: float, log: bool) -> Floats:
    """Forces that a line is drawn over, about those of some rows."""
    return np.geomspace(
        (0.85 if log else 0.3) * force.min(),
        min(1.04 * force.max(), 0.999 * c_e * R**2 * WINDOW_STOP**law.force_exponent),
        300,
    )


def band(fit: Fit, force: Floats, radius: float) -> tuple[Floats, Floats]:
    """Lowest and highest mean-field velocity [mm/s] at each force over the joint 95 % region."""
    if fit.evidence is None:
        return np.full(len(force), np.nan), np.full(len(force), np.nan)
    region = fit.evidence.profile.regions["95"]
    picked = np.unique(np.linspace(0, len(region.c_e) - 1, _BAND).round().astype(int))
    unit = fit.law.velocity(force, region.c_e[picked, None], 1.0, radius)
    with np.errstate(invalid="ignore"):
        low = np.where(np.isnan(unit), np.inf, unit * region.lower[picked, None])
        high = np.where(np.isnan(unit), -np.inf, unit * region.upper[picked, None])
    return np.nanmin(low, axis=0), np.nanmax(high, axis=0)
