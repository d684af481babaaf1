"""The likelihood of c_e and alpha under the scaling law v = alpha R Psi(F/(c_e R^2)), and its information.

Three kinds of rows scatter independently of one another:

* "velocity": rows of curves, and the mean of each run of a trace. They depend on c_e and alpha.
* "segments": a run's segments about that mean. They depend on c_e alone, as alpha moves a run as a whole.
* "force": rows of indentations. They depend on c_e alone (Eq. 3).

A scatter is estimated, unless sigma is given: -2 log L is taken at the best scatters.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Shape
from burrlab.common.check import refuse
from burrlab.fitting.calibration import Calibration, RowScatter, covariance_of
from burrlab.fitting.observations import Floats, Observations, ResidualKind, Rows
from burrlab.fitting.slices import FLATTER, FREEDOM, AlphaSlices, StudentSlices, TobitSlices, best_scale
from burrlab.theory.continuum import PER_SECOND, Law, MasterCurve, rate_factor

LikelihoodKind: TypeAlias = ResidualKind | Literal["log-sigma"]
Beliefs: TypeAlias = tuple[tuple[str, float, float], ...]  # see `Likelihood`


class MeanFieldModel:
    """Predictions by the scaling law v = alpha (F/1 N)^m R Psi(phi, window; f) (docs/model.md, section 5).

    The observations hold the exponents of the law. Rows are grouped by window, and each distinct F/R^2 and R is
    looked up once.
    """

    of_voxels = False  #: whether descents on voxels correct it; they do in few rows and near their own c_e

    def __init__(self, observations: Observations, shape: Shape) -> None:
        self._curve, self.shape = MasterCurve(shape), shape
        self._n = len(observations.force)
        self.law = Law(self.shape, observations.force_exponent, observations.rate_exponent)
        self._groups: list[tuple[float | None, float | None, Floats, Floats, Rows, Rows]] = []
        #: index of each row's prediction in `log_predictions`; equal rows share one
        self.prediction: Rows = np.empty(self._n, np.intp)
        n_groups = 0
        # (F/1 N)^m, by which the rate grows with the force; F/R^2, and v over Psi at alpha = 1
        factor = rate_factor(observations.force * np.exp(observations.log_c_e), observations.rate_exponent)
        both = np.stack([
            observations.force / observations.radius**2, PER_SECOND * observations.radius * factor
        ])  # fmt: skip
        for (start, end), rows in observations.by_window().items():
            (pressure, scales), inverse = np.unique(both[:, rows], axis=1, return_inverse=True)
            self._groups.append((start, end, pressure, scales, rows, inverse))
            self.prediction[rows] = n_groups + inverse
            n_groups += len(pressure)

    def kept(self, observations: Observations, keep: NDArray[np.bool_]) -> "MeanFieldModel":
        """The model of some of its rows, which the observations hold."""
        return MeanFieldModel(observations, self.shape)

    def unit(self, c_e: ArrayLike, own: Floats | None = None) -> Floats:
        """Velocity [mm/s] at alpha = 1 /ms, shape (*c_e.shape, n); NaN where static contact passes the window.

        `own` is ln c_e of each row over that of all, shape (len(c_e), rows).
        """
        if own is None:
            return np.ascontiguousarray(self._rows(c_e, np.asarray))
        velocities = np.empty(own.shape)
        for start, end, pressure, scales, rows, inverse in self._groups:
            phi = self.law.master_phi(pressure[inverse] / (np.asarray(c_e)[:, None] * np.exp(own[:, rows])))
            velocities[:, rows] = scales[inverse] * self._curve.velocity_ratio(phi, start, end)
        return velocities

    def log_unit(self, c_e: ArrayLike) -> Floats:
        """Logarithm of `unit`."""
        return self._rows(c_e, np.log)

    def log_predictions(self, c_e: Floats) -> Floats:
        """`log_unit` of each distinct prediction, shape (len(c_e), predictions)."""
        tables = []
        for start, end, pressure, scales, _, _ in self._groups:
            log_phi = (np.log(pressure) - np.log(c_e)[:, None]) * self.law.stretch
            tables.append(self._curve.log_velocity_ratio(log_phi, start, end))
            tables[-1] += np.log(scales)
        return np.concatenate(tables, axis=1) if len(tables) > 1 else tables[0]

    def _rows(self, c_e: ArrayLike, function: Callable[[Floats], Floats]) -> Floats:
        """A function of the velocity of each row, made once for equal rows; row after row in memory."""
        stiffness = np.asarray(c_e, dtype=np.float64)
        velocities = np.empty((self._n, stiffness.size))
        for start, end, pressure, scales, rows, inverse in self._groups:
            phi = self.law.master_phi(pressure[:, None] / stiffness.ravel())
            ratio = self._curve.velocity_ratio(phi, start, end)
            velocities[rows] = function(scales[:, None] * ratio)[inverse]
        return velocities.T.reshape(*stiffness.shape, self._n)


#: Relative error of the master curve against single descents, 0.2 %; a smaller scatter cannot be told from it.
MODEL_ERROR = 2e-3
_MANY = 1000  # above so many rows, those of equal prediction are summed once; fewer keep their old rounding
_TABLE = 1 << 18  # numbers that one table of c_e and rows holds: 2 MB, so that it stays in the cache


@dataclass(frozen=True, eq=False)
class LinearRows:
    """The rows of one scatter near a point: r + J (d log c_e, d log alpha)."""

    name: str
    known: bool
    J: Floats  # shape (rows, 2)
    r: Floats
    n: int  # independent rows: K - 1 of a run of K segments
    at: Rows  # the velocity row (of a run its first) or pressed row that each comes from; empty for beliefs


def minus2_of(S: ArrayLike, n: int, known: bool) -> Floats:
    """-2 log L of n rows with a sum of squares S, at the best scatter unless sigma is known."""
    return np.asarray(S if known else n * np.log(np.divide(S, n) + MODEL_ERROR**2))


def runs_of(o: Observations) -> tuple[Rows, list[Rows]]:
    """The curves' rows, and the rows of each run of a trace."""
    runs = range(int(o.run.max(initial=-1)) + 1)
    return np.flatnonzero(o.run < 0), [np.flatnonzero(o.run == k) for k in runs]


def means_of_runs(rows: Floats, single: Rows, runs: Sequence[Rows]) -> Floats:
    """The curves' rows, then the mean of each run; last axis."""
    means = [rows[..., at].mean(axis=-1, keepdims=True) for at in runs]
    return np.concatenate([rows[..., single], *means], axis=-1)


class Likelihood:
    """-2 log L over c_e and alpha, without constants; alpha enters in closed form.

    Parameters
    ----------
    observations : Observations
    kind : {"relative", "absolute", "sigma", "student"}
        Log-normal scatter of the velocities, normal scatter, normal with the given sigma, or Student's t with
        4 degrees of freedom in log velocity, which bears outliers. With effects sigma is that of log v, sigma/v:
        ``"log-sigma"``.
    model : MeanFieldModel
    beliefs : tuple of (str, float, float)
        What is known of ``"c_e"`` and ``"alpha"`` from elsewhere: name, value and relative standard deviation. They
        are rows of their own, whose -2 log L `MixedLikelihood` alone counts.

    Notes
    -----
    v is alpha times the model's velocity at alpha = 1. So at each c_e the velocities are a linear model of one
    parameter, g = log alpha (relative) or alpha (absolute, sigma). Their sum of squares is a parabola,

        S = A + B (g - m)^2,

    which `AlphaSlices` holds for many c_e at once. Then -2 log L = n log(S/n + e^2), plus the same for segments
    and forces; where sigma is known it is S itself. e, the model's own error (0.2 %), keeps -2 log L finite for
    data without scatter. Student's t has no such form: see `StudentSlices`.
    """

    n_points = 240  #: of c_e, in the first walk
    uneven: bool = False  #: whether it has shallow minima that mean nothing
    #: ln alpha of each velocity row over that of the first data set, where data sets have one each
    own_alpha: Floats | float = 0.0

    def __init__(
        self,
        observations: Observations,
        kind: LikelihoodKind,
        model: MeanFieldModel,
        beliefs: Beliefs = (),
    ) -> None:
        self.observations, self.kind, self.model, self.beliefs = observations, kind, model, beliefs
        self._single, self._runs = runs_of(observations)
        refuse(
            self._runs and kind != "relative", f"residuals must be 'relative' with depth traces: got {kind!r}"
        )
        refuse(
            kind == "student" and len(observations.pressed),
            "residuals 'student' are for velocity curves alone, and the data hold an indentation",
        )
        #: of each residual of the velocities its row, or the first of its run
        self.first_rows = np.append(self._single, [rows[0] for rows in self._runs]).astype(np.intp)
        self.log = kind in ("relative", "student", "log-sigma")
        self.n = len(self._single) + len(self._runs)
        self.n_within = sum(len(rows) - 1 for rows in self._runs)
        scatters_of_runs = [
            np.sqrt(np.mean(observations.log_sigma[rows] ** 2) + MODEL_ERROR**2) for rows in self._runs
        ]
        #: scatter of each run's segments, from its record, over the geometric mean of all runs
        self.run_scatter: Floats = (
            np.array(scatters_of_runs) / np.exp(np.mean(np.log(scatters_of_runs)))
            if scatters_of_runs
            else np.empty(0)
        )
        self.known = kind in ("sigma", "log-sigma")
        self.pressed_known = self.known and bool(np.isfinite(observations.pressed_sigma).all())
        level = float(np.mean(observations.velocity**2)) if kind == "absolute" else 1.0
        #: of a squared scatter: the square of the model's own error, in the unit of the residuals
        self.floor = 0.0 if self.known else MODEL_ERROR**2 * level
        self._slow: tuple[MeanFieldModel, Floats] | None = None
        if observations.slow.size:
            refuse(
                kind != "relative", f"residuals must be 'relative' with runs that were too slow: got {kind!r}"
            )
            force, limit, start, end, radius = observations.slow
            slow = replace(observations, force=force, window_start=start, window_end=end, radius=radius)
            self._slow = MeanFieldModel(slow, model.shape), np.log(limit)
        #: the model, and weight and mean of the rows that share a prediction, and their squares about the means
        self._shared: tuple[MeanFieldModel, Floats, Floats, float] | None = None
        if self.n > _MANY and not (model.of_voxels or self._runs) and kind not in ("student", "log-sigma"):
            y = np.log(observations.velocity) if self.log else observations.velocity
            weights = observations.sigma**-2 if self.known else np.ones(len(y))
            weight = np.asarray(np.bincount(model.prediction, weights), np.float64)
            mean = np.bincount(model.prediction, weights * y) / weight
            self._shared = model, weight, mean, float(np.sum(weights * (y - mean[model.prediction]) ** 2))

    def about_curves(self, c_e: float, alpha: float) -> tuple[Floats, Floats]:
        """Derivatives, shape (n, 2), and residuals of the curves' rows about the best fit to these alone.

        The model is taken as linear there: so the pull of traces and indentations on the fit is removed.
        """
        rows, n = self.linear_rows(c_e, alpha)[0], len(self._single)
        J, r = rows.J[:n], rows.r[:n]
        return J, np.asarray(r - J @ (np.linalg.pinv(J, rcond=1e-6) @ r))

    def linear_rows(self, c_e: float, alpha: float) -> list[LinearRows]:
        """All rows near a point, by scatter.

        Central differences over 0.2 % of c_e average the two slopes at the kink of a window.
        """
        steps = np.log(c_e) + np.array([-1e-3, 0.0, 1e-3])
        hard = self.observations.c_e_floor * (1 + 1e-9)  # of the windows
        stiffness = np.exp(np.maximum(steps, np.log(min(hard, c_e))))
        around = self.residuals(stiffness, alpha)
        if not all(np.isfinite(r[0]).all() for _, _, r, _ in around):  # the edge of a voxel table's window
            stiffness[0] = c_e
            around = self.residuals(stiffness, alpha)
        width = float(np.log(stiffness[2] / stiffness[0]))
        # log v is linear in log alpha, v in alpha: one doubling is the derivative by log alpha
        doubling = np.log(2) if self.log else 1.0
        nowhere = np.empty(0, np.intp)
        places = {
            "velocity": self.first_rows, "segments": np.concatenate([nowhere, *self._runs]),
            "force": np.arange(len(self.observations.pressed)), "known": nowhere,
        }  # fmt: skip
        return [
            LinearRows(
                name, known, np.stack([(r[2] - r[0]) / width, (r_twice - r[1]) / doubling], axis=1), r[1], n,
                places[name],
            )
            for (name, known, r, n), (_, _, r_twice, _) in zip(around, self.residuals(c_e, 2 * alpha), strict=True)
        ]  # fmt: skip

    def of_rows(self, observations: Observations, model: MeanFieldModel | None = None) -> "Likelihood":
        """The same kind of likelihood of other rows, in the mean field unless with a model."""
        model = model or MeanFieldModel(observations, self.model.shape)
        return Likelihood(observations, self.kind, model, self.beliefs)

    @property
    def kinks(self) -> Floats:
        """c_e [N/mm^2] at which -2 log L has a kink, where a window begins at static contact."""
        return self.observations.ridge_entries()

    def about(self, point: tuple[float, float]) -> "Likelihood":
        """The same likelihood, with rows that have a window at a point."""
        return self

    @property
    def corrected(self) -> Observations:
        """The rows with the best offsets."""
        return self.observations

    def belief_rises(self) -> list[tuple[float, float]]:
        """How far -2 log L of the rows alone rises to meet each belief, and the degrees of freedom of its scatter."""
        return []

    def calibration(self, c_e: float, alpha: float) -> Any:
        """The limits of the intervals, for a fit at a point."""
        total, scatters, shares = self.information(c_e, alpha)
        return Calibration(scatters, total, shares)

    def off_curve(self, c_e: float, alpha: float) -> Floats:
        """Logarithm of each row's velocity over its prediction; of rows that share effects, with these."""
        return np.asarray(np.log(self.observations.velocity / (alpha * self.model.unit(c_e))))

    def velocity_residuals(self, unit: Floats, alpha: float = 1.0) -> Floats:
        """Residuals of the rows that depend on alpha: curves' rows, then the runs' means; last axis (n,)."""
        o = self.observations
        if self.log:
            return self._log_residuals(np.log(unit), alpha)
        return (o.velocity - alpha * unit) / (o.sigma if self.known else 1.0)

    def _log_residuals(self, log_unit: Floats, alpha: float = 1.0) -> Floats:
        raw = np.log(self.observations.velocity) - log_unit
        if alpha != 1.0:
            raw -= np.log(alpha)
        if self.known:
            raw *= self.observations.velocity / self.observations.sigma
        if not self._runs:
            return np.asfortranarray(raw)  # as below: a sum over rows then adds one after another
        return means_of_runs(np.ascontiguousarray(raw), self._single, self._runs)

    def within_residuals(self, unit: Floats) -> Floats:
        """Deviations of the segments from their run's mean, over `run_scatter`; independent of alpha."""
        raw = np.log(self.observations.velocity) - np.log(unit)
        parts = [
            (raw[..., rows] - raw[..., rows].mean(axis=-1, keepdims=True)) / scatter
            for rows, scatter in zip(self._runs, self.run_scatter, strict=True)
        ]
        return np.concatenate(parts, axis=-1) if parts else np.empty((*unit.shape[:-1], 0))

    def residuals(
        self, c_e: ArrayLike, alpha: float, own: tuple[Floats, Floats] | None = None
    ) -> list[tuple[str, bool, Floats, int]]:
        """Name, whether sigma is known, residuals (last axis) and their free number, for each scatter.

        `own` is ln c_e of velocity rows and pressed rows over c_e, each of shape (len(c_e), rows).
        """
        unit, o = self.model.unit(c_e, *(own or ())[:1]), self.observations
        tables: list[tuple[str, bool, int, Callable[[], Floats]]] = [
            ("velocity", self.known, self.n, lambda: self.velocity_residuals(unit, alpha)),
            ("segments", False, self.n_within, lambda: self.within_residuals(unit)),
            ("force", self.pressed_known, len(o.pressed),
             lambda: o.pressed_residuals(c_e, self.pressed_known, *(own or ())[1:])),
            ("known", True, len(self.beliefs), lambda: self._belief_residuals(c_e, alpha)),
        ]  # fmt: skip
        return [(name, known, residuals(), n) for name, known, n, residuals in tables if n]

    def _belief_residuals(self, c_e: ArrayLike, alpha: float) -> Floats:
        stiffness = np.asarray(c_e, dtype=np.float64)
        values = {"c_e": stiffness, "alpha": np.full(stiffness.shape, alpha)}
        columns = [np.log(values[name] / value) / deviation for name, value, deviation in self.beliefs]
        return np.stack(columns, axis=-1) if columns else np.empty((*stiffness.shape, 0))

    def at(self, c_e: ArrayLike) -> "AlphaSlices":
        """The likelihood as a function of alpha, at each c_e [N/mm^2]."""
        stiffness = np.atleast_1d(np.asarray(c_e, dtype=np.float64))
        width = len(self._shared[1]) if self._shared else self.n
        n_parts = min(len(stiffness) * width // _TABLE, len(stiffness) // 2)  # parts of two or more
        if n_parts < 2:
            return self._at(stiffness)
        first, *others = (self._at(part) for part in np.array_split(stiffness, n_parts))
        return first.joined(others, np.arange(len(stiffness)))

    def _at(self, stiffness: Floats) -> "AlphaSlices":
        with np.errstate(invalid="ignore"):
            if self._shared is not None:
                A, B, m = self._of_shared(stiffness, *self._shared)
            elif self.log:
                r = self._log_residuals(self.model.log_unit(stiffness))
                if self.kind == "student":
                    return StudentSlices.of(stiffness, r, self.floor)
                if self.known:
                    weight = self.observations.velocity / self.observations.sigma
                    B = np.full(len(stiffness), float(weight @ weight))
                    m = r @ weight / B
                    A = np.sum((r - m[:, None] * weight) ** 2, axis=-1)
                else:
                    m, B = r.sum(axis=-1) / self.n, np.full(len(stiffness), float(self.n))
                    r -= m[:, None]
                    A = np.sum(np.square(r, out=r), axis=-1)
            else:
                sigma = self.observations.sigma if self.known else 1.0
                u, v = self.model.unit(stiffness) / sigma, self.observations.velocity / sigma
                B = np.sum(u**2, axis=-1)
                m = np.sum(u * v, axis=-1) / B
                A = np.sum((v - m[:, None] * u) ** 2, axis=-1)
            other = self._without_alpha(stiffness)
            if self._slow is not None:
                limits = self._slow[1] - self._slow[0].log_unit(stiffness)
                return TobitSlices.of(stiffness, A, m, other, self.n, self.floor, limits)
        return AlphaSlices(stiffness, A, B, m, other, self.n, self.known, self.floor, self.log)

    def _without_alpha(self, stiffness: Floats) -> Floats:
        """-2 log L of the rows that depend on c_e alone: segments and forces."""
        total = np.zeros(len(stiffness))
        if self.n_within:
            within = self.within_residuals(self.model.unit(stiffness))
            total += minus2_of(np.sum(within**2, axis=-1), self.n_within, False)
        if len(self.observations.pressed):
            r = self.observations.pressed_residuals(stiffness, self.pressed_known)
            total += minus2_of(np.sum(r**2, axis=-1), r.shape[-1], self.pressed_known)
        return total

    def _of_shared(
        self, stiffness: Floats, model: MeanFieldModel, weight: Floats, mean: Floats, squares: float
    ) -> tuple[Floats, Floats, Floats]:
        """A, B and m from the means of the rows that share a prediction."""
        r = model.log_predictions(stiffness)
        if self.log:
            np.subtract(mean, r, out=r)
            m, B = np.einsum("ij,j->i", r, weight) / self.n, np.full(len(stiffness), float(self.n))
            r -= m[:, None]
        else:
            np.exp(r, out=r)
            B = np.einsum("ij,ij,j->i", r, r, weight)
            m = np.einsum("ij,j->i", r, weight * mean) / B
            r = mean - m[:, None] * r
        return squares + np.einsum("ij,ij,j->i", r, r, weight), B, m

    def objective(self, c_e: float, alpha: float) -> float:
        """The value that a search minimises: not negative, and rising with -2 log L.

        For velocities alone: the sum of squared residuals. With other rows: n exp(-2 log L/n), the geometric
        mean of the sums of squares. With known sigma: the sum of squares, plus n log(1 + S/(n e^2)) of rows
        without sigma. NaN without a window.
        """
        if self.kind == "student":
            r = self._log_residuals(self.model.log_unit(c_e), alpha)
            return float(self.n * np.exp(best_scale(r, self.floor)[0] / self.n))
        slices = self.at(c_e)
        if self._slow is not None:
            return float(self.n * np.exp(slices.minus2(alpha)[0] / self.n))
        g = np.log(alpha) if slices.log else alpha
        S = float(slices.A[0] + slices.B[0] * (g - slices.m[0]) ** 2)
        other = float(slices.other[0])
        if self.known:
            scattered = 0 if self.pressed_known else len(self.observations.pressed)
            return S + other - scattered * float(np.log(MODEL_ERROR**2))
        n = self.n + self.n_within + len(self.observations.pressed)
        return S if n == self.n else float(n * np.exp((self.n * np.log(S / self.n + self.floor) + other) / n))

    def information(self, c_e: float, alpha: float) -> tuple[Floats, tuple[RowScatter, ...], Floats]:
        """Fisher information in (log c_e, log alpha) at a point, shape (2, 2), the scatters and their shares.

        The shares, shape (number of scatters, 2, 2), are the information from each scatter.
        """
        tables = self.linear_rows(c_e, alpha)
        shares = np.array([rows.J.T @ rows.J / self._variance(rows) for rows in tables])
        if self.kind == "student":
            shares *= FLATTER
        total = shares.sum(axis=0)
        inverse = covariance_of(total)
        scatters = []
        for rows, share in zip(tables, shares, strict=True):
            p = 2.0 if len(tables) == 1 else float(np.trace(inverse @ share))
            value = 1.0 if rows.known else float(np.sqrt(np.sum(rows.r**2) / max(rows.n - p, 0.5)))
            if self.kind == "student":
                value = float(np.sqrt(self._variance(rows) * rows.n / (rows.n - p)))
            scatters.append(RowScatter(rows.name, rows.n, rows.known, p, value))
        return total, tuple(scatters), shares

    def variances(self, c_e: float, alpha: float) -> dict[str, float]:
        """Best estimates of the squared scatters, by name, with the model's error."""
        return {rows.name: self._variance(rows) for rows in self.linear_rows(c_e, alpha)}

    def score(self, c_e: float, alpha: float, variances: Mapping[str, float]) -> Floats:
        """Derivative of log L by (log c_e, log alpha) for given squared scatters, shape (2,)."""
        return np.asarray(
            -sum(rows.J.T @ rows.r / variances[rows.name] for rows in self.linear_rows(c_e, alpha))
        )

    def _variance(self, rows: LinearRows) -> float:
        """Best estimate of a squared scatter, with the model's error, in the residuals' unit squared."""
        if self.kind == "student":
            return float(best_scale(rows.r, self.floor)[1])
        floor = self.floor if rows.name == "velocity" else MODEL_ERROR**2
        return 1.0 if rows.known else float(np.sum(rows.r**2)) / rows.n + floor

    def log_likelihood(self, c_e: float, alpha: float) -> float:
        """log L with all constants and the best scatters: the log density of the data in their units."""
        tables = self.residuals(c_e, alpha)
        if self._slow is not None:
            n = sum(n for _, _, _, n in tables)
            return self.log_jacobian() - 0.5 * float(
                self.at(c_e).minus2(alpha)[0] + n * (np.log(2 * np.pi) + 1)
            )
        if self.kind == "student":
            s = np.sqrt(best_scale(tables[0][2], 1e-30)[1])
            total = float(np.sum(scipy.stats.t.logpdf(tables[0][2] / s, FREEDOM) - np.log(s)))
        else:
            total = 0.0
            for _, known, r, n in tables:
                S = float(np.sum(r**2))
                total += (
                    -0.5 * (S + n * float(np.log(2 * np.pi)))
                    if known
                    else -0.5 * n * float(np.log(2 * np.pi * (S / n + 1e-30)) + 1)
                )
        return total + self.log_jacobian()

    def log_jacobian(self) -> float:
        """log of the density of the data in their units over that of the residuals."""
        o, total = self.observations, 0.0
        if self.known:
            total -= float(np.sum(np.log(o.sigma)))
        elif self.log:  # the density is of v, not of log v
            total -= float(np.sum(np.log(o.velocity)))
        # a rotation turns the K rows of a run into sqrt(K) times their mean and K - 1 contrasts;
        # the contrasts are over run_scatter
        for rows, scatter in zip(self._runs, self.run_scatter, strict=True):
            total -= 0.5 * float(np.log(len(rows))) + (len(rows) - 1) * float(np.log(scatter))
        if len(o.pressed):
            total -= float(np.sum(np.log(o.pressed_sigma if self.pressed_known else o.pressed)))
        return total
