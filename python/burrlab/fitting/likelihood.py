"""The likelihood of c_e and alpha under the scaling law v = alpha R Psi(F/(c_e R^2)), and its information.

Three kinds of rows scatter independently of one another:

* "velocity": rows of curves, and the mean of each run of a trace. They depend on c_e and alpha.
* "segments": a run's segments about that mean. They depend on c_e alone, as alpha moves a run as a whole.
* "force": rows of indentations. They depend on c_e alone (Eq. 3).

A scatter is estimated, unless sigma is given: -2 log L is taken at the best scatters.
"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike

from burrlab._core import Shape
from burrlab.common.check import refuse
from burrlab.fitting.calibration import Calibration, RowScatter
from burrlab.fitting.observations import Floats, Observations, ResidualKind, Rows
from burrlab.theory.continuum import PER_SECOND, MasterCurve

LikelihoodKind: TypeAlias = ResidualKind | Literal["log-sigma"]
Beliefs: TypeAlias = tuple[tuple[str, float, float], ...]  # see `Likelihood`


class Model(Protocol):
    """Predicts the velocity rows of an `Observations`; the velocity is proportional to alpha."""

    @property
    def shape(self) -> Shape:
        """The erosion shape."""

    def unit(self, c_e: ArrayLike) -> Floats:
        """Velocity [mm/s] at alpha = 1 /ms, shape of c_e and (n,); NaN where c_e leaves no window."""

    def log_unit(self, c_e: ArrayLike) -> Floats:
        """Logarithm of `unit`."""


class MeanFieldModel:
    """Predictions by the scaling law v = alpha R Psi(phi, window; f) (docs/model.md, section 5).

    Rows are grouped by window, and each distinct F/R^2 and R is looked up once.
    """

    def __init__(self, observations: Observations, shape: Shape) -> None:
        self._curve, self.shape = MasterCurve(shape), shape
        self._arrange(observations)

    def for_rows(self, observations: Observations) -> "MeanFieldModel":
        """The same model of other rows."""
        other = copy.copy(self)
        other._arrange(observations)
        return other

    def _arrange(self, observations: Observations) -> None:
        self._n = len(observations.force)
        self._groups: list[tuple[float | None, float | None, Floats, Floats, Rows, Rows]] = []
        #: the number of each row's prediction, which equal rows share
        self.group: Rows = np.empty(self._n, np.intp)
        n_groups = 0
        both = np.stack([observations.force / observations.radius**2, observations.radius])
        for (start, end), rows in observations.by_window().items():
            (pressure, radius), inverse = np.unique(both[:, rows], axis=1, return_inverse=True)
            self._groups.append((start, end, pressure, radius, rows, inverse))
            self.group[rows] = n_groups + inverse
            n_groups += len(pressure)

    def unit(self, c_e: ArrayLike) -> Floats:
        """See `Model`."""
        return np.ascontiguousarray(self._rows(c_e, np.asarray))

    def log_unit(self, c_e: ArrayLike) -> Floats:
        """See `Model`."""
        return self._rows(c_e, np.log)

    def log_groups(self, c_e: Floats) -> Floats:
        """`log_unit` of each number of `group`, shape (len(c_e), numbers)."""
        tables = []
        for start, end, pressure, radius, _, _ in self._groups:
            log_phi = np.log(pressure) - np.log(c_e)[:, None]
            tables.append(self._curve.log_velocity_ratio(log_phi, start, end))
            tables[-1] += np.log(PER_SECOND * radius)
        return np.concatenate(tables, axis=1) if len(tables) > 1 else tables[0]

    def _rows(self, c_e: ArrayLike, function: Callable[[Floats], Floats]) -> Floats:
        """A function of the velocity of each row, made once for equal rows; row after row in memory."""
        stiffness = np.asarray(c_e, dtype=np.float64)
        velocities = np.empty((self._n, stiffness.size))
        for start, end, pressure, radius, rows, inverse in self._groups:
            ratio = self._curve.velocity_ratio(pressure[:, None] / stiffness.ravel(), start, end)
            velocities[rows] = function(PER_SECOND * radius[:, None] * ratio)[inverse]
        return velocities.T.reshape(*stiffness.shape, self._n)


#: Error of the master curve against single descents, 0.2 % [1]; a smaller scatter cannot be told from it.
MODEL_ERROR = 2e-3
_MANY = 1000  # rows above which those of equal prediction are summed once; the others keep their last bits
_TABLE = 1 << 18  # numbers that one table of c_e and rows holds: 2 MB, so that it stays in the cache
_LARGEST = 500.0  # largest |log alpha|: limits beyond are cut to it, so that they stay finite


@dataclass(frozen=True, eq=False)
class LinearRows:
    """The rows of one scatter near a point: r + J (d log c_e, d log alpha)."""

    name: str
    known: bool
    J: Floats  # shape (rows, 2)
    r: Floats
    n: int  # rows that are free
    at: Rows  # of each: which velocity row, of a run its first, or which pressed row; empty for beliefs
    order: Floats  # derivative by a drift of log v, by 1 from the first run to the last


class Likelihood:
    """-2 log L over c_e and alpha, without constants; alpha enters in closed form.

    Parameters
    ----------
    observations : Observations
    kind : {"relative", "absolute", "sigma", "student"}
        Log-normal scatter of the velocities, normal scatter, normal with the given sigma, or Student's t with
        4 degrees of freedom in log velocity, which bears outliers. With effects sigma is that of log v, sigma/v:
        ``"log-sigma"``.
    model : Model
    beliefs : tuple of (str, float, float)
        What is known of ``"c_e"`` and ``"alpha"`` from elsewhere: name, value and relative standard deviation. They
        are rows of their own, which count where effects do (`MixedLikelihood`).

    Notes
    -----
    v is alpha times the model's velocity at alpha = 1. So at each c_e the velocities are a linear model of one
    parameter, g = log alpha (relative) or alpha (absolute, sigma). Their sum of squares is a parabola,

        S = A + B (g - m)^2,

    which `AlphaSlices` holds for many c_e at once. Then -2 log L = n log(S/n + e^2), plus the same for segments
    and forces; where sigma is known it is S itself. e, the model's own error (0.2 %), keeps -2 log L finite for
    data without scatter. Student's t has no such form: see `StudentSlices`.
    """

    #: ln alpha of each velocity row over that of the first data set, where data sets have one each
    own_alpha: Floats | float = 0.0

    def __init__(
        self,
        observations: Observations,
        kind: LikelihoodKind,
        model: Model,
        beliefs: Beliefs = (),
    ) -> None:
        self.observations, self.kind, self.model, self.beliefs = observations, kind, model, beliefs
        run = observations.run
        self._single = np.flatnonzero(run < 0)
        self._runs = [np.flatnonzero(run == i) for i in range(int(run.max(initial=-1)) + 1)]
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
        level = np.mean(observations.velocity**2) if kind == "absolute" else 1.0
        #: of a squared scatter: the square of the model's own error, in the unit of the residuals
        self.floor = 0.0 if self.known else MODEL_ERROR**2 * float(level)
        #: the model, and weight and mean of the rows that share a prediction, and their squares about the means
        self._slow: tuple[MeanFieldModel, Floats] | None = None
        if observations.slow.size:
            refuse(
                kind != "relative", f"residuals must be 'relative' with runs that were too slow: got {kind!r}"
            )
            if not isinstance(model, MeanFieldModel):
                raise ValueError("runs that were too slow need the mean-field engine")
            slow = observations.slow_rows()
            self._slow = model.for_rows(slow), np.log(slow.velocity)
        self._shared: tuple[MeanFieldModel, Floats, Floats, float] | None = None
        if (
            isinstance(model, MeanFieldModel)
            and self.n > _MANY
            and kind not in ("student", "log-sigma")
            and not self._runs
        ):
            y = np.log(observations.velocity) if self.log else observations.velocity
            weights = observations.sigma**-2 if self.known else np.ones(len(y))
            weight = np.asarray(np.bincount(model.group, weights), np.float64)
            mean = np.bincount(model.group, weights * y) / weight
            self._shared = model, weight, mean, float(np.sum(weights * (y - mean[model.group]) ** 2))

    def about_curves(self, c_e: float, alpha: float) -> tuple[Floats, Floats]:
        """Derivatives, shape (n, 2), and residuals of the curves' rows about the best fit to these alone.

        The model is taken as linear there: so the pull of traces and indentations on the fit is removed.
        """
        _, _, J, r, _ = self._derivatives(c_e, alpha)[0]
        J, r = J[: len(self._single)], r[: len(self._single)]
        return J, np.asarray(r - J @ (np.linalg.pinv(J, rcond=1e-6) @ r))

    def linear_rows(self, c_e: float, alpha: float) -> list[LinearRows]:
        """All rows near a point, by scatter."""
        segments = np.concatenate([np.empty(0, np.intp), *self._runs])
        velocity, tables, run = (
            self.first_rows,
            [],
            np.unique(self.observations.run_number, return_inverse=True)[1],
        )
        rise = run / max(run.max(initial=0), 1) - 0.5
        for name, known, J, r, n in self._derivatives(c_e, alpha):
            at = {"velocity": velocity, "segments": segments, "force": np.arange(len(r))}.get(
                name, velocity[:0]
            )
            order = -rise[at] if name == "velocity" else np.zeros(len(r))
            tables.append(LinearRows(name, known, J, r, n, at, order))
        return tables

    def of_rows(self, observations: Observations, model: Model) -> "Likelihood":
        """The same kind of likelihood of other rows."""
        return Likelihood(observations, self.kind, model, self.beliefs)

    @property
    def kinks(self) -> Floats:
        """c_e [N/mm^2] at which -2 log L has a kink, where a window begins at static contact."""
        return self.observations.ridge_entries()

    def about(self, point: tuple[float, float]) -> "Likelihood":
        """The same likelihood, with rows that have a window at a point."""
        return self

    def calibration(self, c_e: float, alpha: float) -> Any:
        """The limits of the intervals, for a fit at a point."""
        total, scatters, shares = self.information(c_e, alpha)
        return Calibration(scatters, total, shares)

    def velocity_residuals(self, unit: Floats, alpha: float = 1.0) -> Floats:
        """Residuals of the rows that depend on alpha: curves' rows, then the runs' means; last axis (n,)."""
        o = self.observations
        if self.log:
            return self._log_residuals(np.log(unit), alpha)
        sigma = o.sigma if self.known else 1.0
        return (o.velocity - alpha * unit) / sigma

    def _log_residuals(self, log_unit: Floats, alpha: float = 1.0) -> Floats:
        raw = np.log(self.observations.velocity) - log_unit
        if alpha != 1.0:
            raw -= np.log(alpha)
        if self.known:
            raw *= self.observations.velocity / self.observations.sigma
        if not self._runs:
            return np.asfortranarray(raw)  # as below: a sum over rows then adds one after another
        raw = np.ascontiguousarray(raw)
        means = [raw[..., rows].mean(axis=-1, keepdims=True) for rows in self._runs]
        return np.concatenate([raw[..., self._single], *means], axis=-1)

    def within_residuals(self, unit: Floats) -> Floats:
        """Deviations of the segments from their run's mean, over `run_scatter`; independent of alpha."""
        raw = np.log(self.observations.velocity) - np.log(unit)
        parts = [
            (raw[..., rows] - raw[..., rows].mean(axis=-1, keepdims=True)) / scatter
            for rows, scatter in zip(self._runs, self.run_scatter, strict=True)
        ]
        return np.concatenate(parts, axis=-1) if parts else np.empty((*unit.shape[:-1], 0))

    def pressed_residuals(self, c_e: ArrayLike) -> Floats:
        """Residuals of the pressed rows: in log force, or over sigma where sigma is known."""
        stiffness = np.asarray(c_e, dtype=np.float64)[..., None]
        o = self.observations
        if not len(o.pressed):
            return np.empty((*stiffness.shape[:-1], 0))
        if self.pressed_known:
            return (o.pressed - stiffness * o.pressed_unit) / o.pressed_sigma
        return np.log(o.pressed / o.pressed_unit) - np.log(stiffness)  # log c_e of every pair (Eq. 3)

    def residuals(self, c_e: ArrayLike, alpha: float) -> list[tuple[str, bool, Floats, int]]:
        """Name, whether sigma is known, residuals (last axis) and their free number, for each scatter."""
        unit = self.model.unit(c_e)
        tables = [
            ("velocity", self.known, self.velocity_residuals(unit, alpha), self.n),
            ("segments", False, self.within_residuals(unit), self.n_within),
            ("force", self.pressed_known, self.pressed_residuals(c_e), len(self.observations.pressed)),
            ("known", True, self._belief_residuals(c_e, alpha), len(self.beliefs)),
        ]
        return [table for table in tables if table[3]]

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
                    return AlphaSlices(
                        stiffness, A, B, m, self._without_alpha(stiffness), self.n, True, 0.0, True
                    )
                m, B = r.sum(axis=-1) / self.n, np.full(len(stiffness), float(self.n))
                r -= m[:, None]
                A = np.sum(np.square(r, out=r), axis=-1)
            else:
                unit = self.model.unit(stiffness)
                sigma = self.observations.sigma if self.known else 1.0
                u, v = unit / sigma, self.observations.velocity / sigma
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
        total, n_pressed = np.zeros(len(stiffness)), len(self.observations.pressed)
        if self.n_within:
            within = self.within_residuals(self.model.unit(stiffness))
            total += self._minus2(np.sum(within**2, axis=-1), self.n_within)
        if n_pressed:
            S = np.sum(self.pressed_residuals(stiffness) ** 2, axis=-1)
            total += S if self.pressed_known else self._minus2(S, n_pressed)
        return total

    def _of_shared(
        self, stiffness: Floats, model: MeanFieldModel, weight: Floats, mean: Floats, squares: float
    ) -> tuple[Floats, Floats, Floats]:
        """A, B and m from the means of the rows that share a prediction."""
        r = model.log_groups(stiffness)
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

    @staticmethod
    def _minus2(S: Floats, n: int) -> Floats:
        return np.asarray(n * np.log(S / n + MODEL_ERROR**2))

    def objective(self, c_e: float, alpha: float) -> float:
        """The value that a search minimises: not negative, and rising with -2 log L.

        For velocities alone: the sum of squared residuals. With other rows: n exp(-2 log L/n), the geometric
        mean of the sums of squares. With known sigma: the sum of squares, plus n log(1 + S/(n e^2)) of rows
        without sigma. NaN without a window.
        """
        if self.kind == "student":
            r = self._log_residuals(self.model.log_unit(c_e), alpha)
            return float(self.n * np.exp(_best_scale(r, self.floor)[0] / self.n))
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
        if n == self.n:
            return S
        return float(n * np.exp((self.n * np.log(S / self.n + self.floor) + other) / n))

    def information(self, c_e: float, alpha: float) -> tuple[Floats, tuple[RowScatter, ...], Floats]:
        """Fisher information in (log c_e, log alpha) at a point, shape (2, 2), the scatters and their shares.

        The shares, shape (number of scatters, 2, 2), are the information from each scatter.
        """
        tables = self._derivatives(c_e, alpha)
        shares = np.array([J.T @ J / self._variance(name, r, n, known) for name, known, J, r, n in tables])
        if self.kind == "student":
            shares *= _FLATTER
        total = shares.sum(axis=0)
        inverse = np.linalg.inv(total + 1e-10 * np.trace(total) * np.eye(2))
        scatters = []
        for (name, known, _, r, n), share in zip(tables, shares, strict=True):
            p = 2.0 if len(tables) == 1 else float(np.trace(inverse @ share))
            value = 1.0 if known else float(np.sqrt(np.sum(r**2) / max(n - p, 0.5)))
            if self.kind == "student":
                value = float(np.sqrt(self._variance(name, r, n, known) * n / (n - p)))
            scatters.append(RowScatter(name, n, known, p, value))
        return total, tuple(scatters), shares

    def variances(self, c_e: float, alpha: float) -> dict[str, float]:
        """Best estimates of the squared scatters, by name, with the model's error."""
        return {
            name: self._variance(name, r, n, known) for name, known, _, r, n in self._derivatives(c_e, alpha)
        }

    def score(self, c_e: float, alpha: float, variances: Mapping[str, float]) -> Floats:
        """Derivative of log L by (log c_e, log alpha) for given squared scatters, shape (2,)."""
        return np.asarray(
            -sum(J.T @ r / variances[name] for name, _, J, r, _ in self._derivatives(c_e, alpha))
        )

    def _variance(self, name: str, r: Floats, n: int, known: bool) -> float:
        """Best estimate of a squared scatter, with the model's error, in the residuals' unit squared."""
        if self.kind == "student":
            return float(_best_scale(r, self.floor)[1])
        floor = self.floor if name == "velocity" else MODEL_ERROR**2
        return 1.0 if known else float(np.sum(r**2)) / n + floor

    def _derivatives(self, c_e: float, alpha: float) -> list[tuple[str, bool, Floats, Floats, int]]:
        """Name, known, derivatives of the residuals by (log c_e, log alpha), residuals and n, by scatter.

        Central differences over 0.2 % of c_e average the two slopes at the kink of a window.
        """
        steps = np.log(c_e) + np.array([-1e-3, 0.0, 1e-3])
        hard = float(self.observations.c_e_bounds().max()) * (1 + 1e-9)  # of the windows
        stiffness = np.exp(np.maximum(steps, np.log(min(hard, c_e))))
        around = self.residuals(stiffness, alpha)
        if not all(np.isfinite(r[0]).all() for _, _, r, _ in around):  # the edge of a voxel table's window
            stiffness[0] = c_e
            around = self.residuals(stiffness, alpha)
        width = float(np.log(stiffness[2] / stiffness[0]))
        # log v is linear in log alpha, v in alpha: one doubling is the derivative by log alpha
        doubling = np.log(2) if self.log else 1.0
        tables = []
        twice = self.residuals(c_e, 2 * alpha)
        for (name, known, r, n), (_, _, r_twice, _) in zip(around, twice, strict=True):
            J = np.stack([(r[2] - r[0]) / width, (r_twice - r[1]) / doubling], axis=1)
            tables.append((name, known, J, r[1], n))
        return tables

    def log_likelihood(self, c_e: float, alpha: float) -> float:
        """log L with all constants and the best scatters: the log density of the data in their units."""
        tables = self.residuals(c_e, alpha)
        if self._slow is not None:
            n = sum(n for _, _, _, n in tables)
            return self.log_jacobian() - 0.5 * float(
                self.at(c_e).minus2(alpha)[0] + n * (np.log(2 * np.pi) + 1)
            )
        if self.kind == "student":
            s = np.sqrt(_best_scale(tables[0][2], 1e-30)[1])
            total = float(np.sum(scipy.stats.t.logpdf(tables[0][2] / s, FREEDOM) - np.log(s)))
        else:
            total = 0.0
            for _, known, r, n in tables:
                S = float(np.sum(r**2))
                if known:
                    total += -0.5 * (S + n * float(np.log(2 * np.pi)))
                else:
                    total += -0.5 * n * float(np.log(2 * np.pi * (S / n + 1e-30)) + 1)
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


@dataclass(frozen=True, eq=False)
class AlphaSlices:
    """-2 log L over alpha at each of several c_e: a parabola in g for each; arrays of shape (len(c_e),)."""

    c_e: Floats  #: [N/mm^2]
    A: Floats  #: lowest sum of squares of the velocities, over alpha
    B: Floats  #: half the second derivative of that sum by g
    m: Floats  #: g of the lowest: log alpha, or alpha where `log` is False
    other: Floats  #: -2 log L of segments and forces, for any alpha
    n: int  #: velocities
    known: bool  #: their sigma is given
    floor: float  #: added to their squared scatter: the model's own error, squared
    log: bool

    def joined(self, others: "list[AlphaSlices]", places: Rows) -> "AlphaSlices":
        """The slices at some places of these and then of others."""
        columns: dict[str, Any] = {
            name: np.concatenate([column.T, *(getattr(other, name).T for other in others)], axis=-1)[
                ..., places
            ].T
            for name, column in vars(self).items()
            if isinstance(column, np.ndarray)
        }
        return replace(self, **columns)

    @property
    def best_alpha(self) -> Floats:
        """alpha [1/ms] of the lowest -2 log L."""
        return np.exp(self.m) if self.log else np.maximum(self.m, 1e-300)

    @property
    def profile(self) -> Floats:
        """-2 log L at the best alpha; NaN where c_e leaves no window."""
        return self._minus2(self.A)

    def minus2(self, alpha: ArrayLike) -> Floats:
        """-2 log L at alpha [1/ms], one for each c_e."""
        g = np.log(alpha) if self.log else np.asarray(alpha, dtype=np.float64)
        return self._minus2(self.A + self.B * (g - self.m) ** 2)

    def minus2_table(self, alpha: Floats) -> Floats:
        """-2 log L, a row for each alpha and a column for each c_e, or infinity far from a row's lowest."""
        return self.minus2(alpha[:, None])

    def alpha_below(self, target: float) -> tuple[Floats, Floats]:
        """The alphas [1/ms] between which -2 log L is below a target; NaN where there are none."""
        rest = target - self.other
        with np.errstate(invalid="ignore", over="ignore"):
            S = rest if self.known else self.n * (np.exp(rest / self.n) - self.floor)
            half = np.sqrt((S - self.A) / self.B)
            if self.log:
                low, high = (np.clip(self.m + sign * half, -_LARGEST, _LARGEST) for sign in (-1, 1))
                return np.exp(low), np.exp(high)
            return np.maximum(self.m - half, 0.0), np.minimum(self.m + half, np.exp(_LARGEST))

    def _minus2(self, S: Floats) -> Floats:
        return self.other + (S if self.known else self.n * np.log(S / self.n + self.floor))


@dataclass(frozen=True, eq=False)
class CurvedSlices(AlphaSlices):
    """-2 log L over alpha where it is no parabola; a subclass says how high it is."""

    g: Floats  # log alpha of the lowest
    height: Floats  # -2 log L there

    def _over(self, g: Floats, points: Rows | slice = slice(None)) -> tuple[Floats, Floats]:
        """-2 log L at log alpha = g and its slope; the last axis of g is that of c_e, or of some of its points."""
        raise NotImplementedError

    def _beyond(self, target: float, points: Rows) -> Floats:
        """How far from m the target is reached at the latest."""
        raise NotImplementedError

    @property
    def best_alpha(self) -> Floats:
        """See `AlphaSlices`."""
        return np.exp(self.g)

    @property
    def profile(self) -> Floats:
        """See `AlphaSlices`."""
        return self.height

    def minus2(self, alpha: ArrayLike) -> Floats:
        """See `AlphaSlices`."""
        return self._over(np.broadcast_to(np.log(alpha), np.broadcast_shapes(np.shape(alpha), self.g.shape)))[
            0
        ]

    def alpha_below(self, target: float) -> tuple[Floats, Floats]:
        """See `AlphaSlices`; by Newton's method from beyond the end, halving where it leaves the bracket."""
        ends, points = np.full((2, len(self.g)), np.nan), np.flatnonzero(self.height <= target)
        middle, reach = self.m[points], self._beyond(target, points)
        if middle.ndim == 1:
            middle, reach = middle[:, None], reach[:, None]
        for side, end in zip((-1, 1), ends, strict=True):
            near, far = self.g[points], side * np.max(side * middle + reach, axis=1)
            g = far
            for _ in range(_ROUNDS):
                height, slope = self._over(g, points)
                near, far = np.where(height <= target, g, near), np.where(height > target, g, far)
                with np.errstate(divide="ignore", invalid="ignore"):
                    step = g - (height - target) / slope
                last, within = g, side * (step - near) * (far - step) >= 0
                g = np.where(within & (side * (step - near) >= 0), step, (near + far) / 2)
                if np.abs(g - last).max(initial=0.0) < _CLOSE:
                    break
            end[points] = np.exp(np.clip(g, -_LARGEST, _LARGEST))
        return ends[0], ends[1]


@dataclass(frozen=True, eq=False)
class TobitSlices(CurvedSlices):
    """-2 log L of log-normal velocities and of others that lie below limits, with the best scatter at each alpha.

    Over 1/s and g/s it is convex, s the scatter and g = log alpha.

    References
    ----------
    Olsen, Note on the uniqueness of the maximum likelihood estimator for the Tobit model, Econometrica 46 (1978).
    """

    limits: Floats  # log of the limits less log of the model's velocity at alpha = 1, shape (m, k)

    @classmethod
    def of(
        cls, c_e: Floats, A: Floats, mean: Floats, other: Floats, n: int, floor: float, limits: Floats
    ) -> "TobitSlices":
        """By Newton's method in 1/s and g/s."""
        S = A + n * floor
        steep, level = np.sqrt(n / S), np.sqrt(n / S) * mean
        for _ in range(_ROUNDS):
            hazard, bend = _hazard(steep[:, None] * limits - level[:, None])
            off = n * (steep * mean - level)
            slopes = (
                -n / steep + S * steep + mean * off - np.sum(hazard * limits, axis=1),
                np.sum(hazard, axis=1) - off,
            )
            a = n / steep**2 + S + n * mean**2 + np.sum(bend * limits**2, axis=1)
            b, c = -n * mean - np.sum(bend * limits, axis=1), n + np.sum(bend, axis=1)
            step = (c * slopes[0] - b * slopes[1]) / (a * c - b**2)
            last, steep = steep, np.maximum(steep - step, steep / 4)
            level = level - (slopes[1] + b * (steep - last)) / c
            if not np.any(np.abs(steep - last) > 1e-12 * last):
                break
        g = level / steep
        slices = cls(c_e, A, np.full(len(c_e), float(n)), mean, other, n, False, floor, True, g, g, limits)
        return replace(slices, height=slices._over(g)[0])

    def _beyond(self, target: float, points: Rows) -> Floats:
        """See `CurvedSlices`: without the limits."""
        S = self.n * (np.exp((target - self.other[points]) / self.n) - self.floor)
        return np.asarray(np.sqrt((S - self.A[points]) / self.n))

    def _over(self, g: Floats, points: Rows | slice = slice(None)) -> tuple[Floats, Floats]:
        """See `CurvedSlices`."""
        off = g - self.m[points]
        S, d = self.A[points] + self.n * (self.floor + off**2), self.limits[points] - g[..., None]
        steep = np.sqrt(self.n / S)
        for _ in range(_ROUNDS):
            hazard, bend = _hazard(steep[..., None] * d)
            slope = -self.n / steep + S * steep - np.sum(hazard * d, axis=-1)
            stiff = self.n / steep**2 + S + np.sum(bend * d**2, axis=-1)
            last, steep = steep, np.maximum(steep - slope / stiff, steep / 4)
            if not np.any(np.abs(steep - last) > _ENOUGH * last):
                break
        below = np.sum(scipy.special.log_ndtr(steep[..., None] * d), axis=-1)
        height = self.other[points] - 2 * self.n * np.log(steep) + S * steep**2 - self.n - 2 * below
        rise = 2 * steep**2 * self.n * off + 2 * steep * np.sum(hazard, axis=-1)
        return np.asarray(np.where(np.isfinite(height), height, np.inf)), rise


def _hazard(z: Floats) -> tuple[Floats, Floats]:
    """Slope of log Phi(z), and less its curvature."""
    hazard = np.exp(-0.5 * (z**2 + np.log(2 * np.pi)) - scipy.special.log_ndtr(z))
    return hazard, hazard * (z + hazard)


FREEDOM = 4.0  #: degrees of freedom of the robust likelihood (ours)
_FLATTER = (FREEDOM + 1) / (FREEDOM + 3)  # its information, over that of a normal distribution of equal scale
_ROUNDS = 30  # of Newton's method or reweighting, at most; 6 are usual
_CLOSE = 1e-8  # a step of log alpha that ends Newton's method
_ENOUGH = 1e-6  # a relative step of Newton's method after which the error is below 1e-11


def _at_scale(r: Floats, scale2: Floats, floor: float) -> tuple[Floats, Floats, Floats]:
    """-2 log L of Student's t for residuals about 0, over the last axis, its slope, and a better squared scale.

    The value is at the better scale, by the parabola of Newton's method; the slope is by a shift of log alpha.
    """
    whole = FREEDOM * scale2[..., None] + r**2
    weighted = r / whole
    part = weighted * r  # q/(nu + q), q = r^2/s^2, whose mean is 1/(nu + 1) at the best scale
    slope, total = -2 * (FREEDOM + 1) * np.sum(weighted, axis=-1), np.sum(part, axis=-1)
    n, excess = r.shape[-1], (FREEDOM + 1) * total - r.shape[-1]
    curvature = (FREEDOM + 1) * (total - np.sum(np.square(part, out=part), axis=-1))
    better = np.maximum(scale2 * np.exp(np.clip(excess / np.maximum(curvature, 1e-9), -1, 1)), floor)
    step = np.log(better / scale2)
    tails = np.sum(np.log(whole, out=whole), axis=-1) - n * np.log(FREEDOM * scale2)
    minus2 = n * np.log(scale2) + (FREEDOM + 1) * tails - step * (excess - curvature * step / 2)
    return minus2, slope, better


def _best_scale(r: Floats, floor: float, begin: Floats | None = None) -> tuple[Floats, Floats]:
    """-2 log L of Student's t for residuals about 0, over the last axis, and the best squared scale."""
    scale2 = np.maximum(1.5 * np.median(r**2, axis=-1) if begin is None else begin, floor)
    for _ in range(_ROUNDS):
        last = scale2
        minus2, _, scale2 = _at_scale(r, last, floor)
        if not np.any(np.abs(scale2 - last) > _ENOUGH * last):
            break
    return minus2, scale2


@dataclass(frozen=True, eq=False)
class StudentSlices(AlphaSlices):
    """-2 log L of Student's t over alpha at each of several c_e, with the best scale at each alpha.

    References
    ----------
    Lange, Little and Taylor, Robust statistical modeling using the t distribution, J. Am. Stat. Assoc. 84
    (1989), section 3.
    Kent, Tyler and Vardi, A curious likelihood identity for the multivariate t-distribution, Commun. Stat.
    Simul. Comput. 23 (1994).
    """

    r: Floats  # log v less log of the model's velocity at alpha = 1, shape (m, n)
    height: Floats  # -2 log L at m

    @classmethod
    def of(cls, c_e: Floats, r: Floats, floor: float) -> "StudentSlices":
        """By Newton's method in m and log scale, begun at the median; by reweighting where a step is long."""
        m, n = np.median(r, axis=-1), r.shape[-1]
        d = r - m[:, None]
        scale2 = np.maximum(2 * np.median(d**2, axis=-1), floor)
        for _ in range(_ROUNDS):
            weighted = d / (FREEDOM * scale2[:, None] + d**2)
            part = weighted * d  # as in `_at_scale`
            first, total = np.sum(weighted, axis=-1), np.sum(part, axis=-1)
            mixed = first - np.sum(np.multiply(weighted, part, out=weighted), axis=-1)
            squares = np.sum(np.square(part, out=part), axis=-1)
            weight = (n - total) / (FREEDOM * scale2)
            # second derivatives by m and log scale2, over 2 (nu + 1)
            of_m, of_scale = (n - 3 * total + 2 * squares) / (FREEDOM * scale2), (total - squares) / 2
            lack = total / 2 - n / (2 * (FREEDOM + 1))
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                determinant = of_m * of_scale - mixed**2
                shift = (of_scale * first - mixed * lack) / determinant
                scaled = scale2 * np.exp((of_m * lack - mixed * first) / determinant)
                short = (of_m > 0) & (determinant > 0) & (shift**2 < scale2 / 4) & (scaled > floor)
                short &= np.abs(scaled - scale2) < scale2 / 2
            shift, last = np.where(short, shift, first / weight), scale2
            scale2 = np.where(short, scaled, np.maximum(total / weight - shift**2, floor))
            m += shift
            d -= shift[:, None]
            if not np.any(np.abs(shift) + np.abs(scale2 - last) / np.sqrt(last) > 1e-12 * np.sqrt(last)):
                break
        B, other = np.full(len(c_e), float(n)), np.zeros(len(c_e))
        return cls(c_e, scale2 * B, B, m, other, n, False, floor, True, r, _at_scale(d, scale2, floor)[0])

    @property
    def profile(self) -> Floats:
        """See `AlphaSlices`."""
        return self.height

    def minus2(self, alpha: ArrayLike) -> Floats:
        """See `AlphaSlices`."""
        return self._over(np.arange(len(self.m)), np.broadcast_to(np.log(alpha), self.m.shape))

    def minus2_table(self, alpha: Floats) -> Floats:
        """See `AlphaSlices`; each row is followed downhill from the lowest of an approximation."""
        off = np.log(alpha)[:, None] - self.m
        near = (self.height + self.n * np.log1p(_FLATTER * off**2 * self.B / self.A)).argmin(axis=1)
        table, moved = np.full(off.shape, np.inf), np.arange(len(alpha))
        while len(moved):
            points = np.clip(near[moved, None] + np.arange(-2, 3), 0, len(self.m) - 1)
            rows = np.repeat(moved, points.shape[1])
            table[rows, points.ravel()] = self._over(points.ravel(), np.log(alpha)[rows])
            last, near = near, table.argmin(axis=1)
            moved = np.flatnonzero(near != last)
        return table

    def alpha_below(self, target: float) -> tuple[Floats, Floats]:
        """See `AlphaSlices`; by Newton's method for the end and its scale, halving where it leaves the bracket."""
        ends, inside = np.full((2, len(self.m)), np.nan), np.flatnonzero(self.height <= target)
        r, m, spread = self.r.T[:, inside].T, self.m[inside], self.A[inside] / self.B[inside]
        begin = np.sqrt(spread * np.expm1((target - self.height[inside]) / self.n) / _FLATTER)
        for side, end in zip((-1, 1), ends, strict=True):
            near, far, half, scale2 = np.zeros(len(m)), np.full(len(m), np.inf), begin, spread + begin**2
            for _ in range(_ROUNDS):
                rough = scale2
                value, slope, scale2 = _at_scale(r - (m + side * half)[:, None], rough, self.floor)
                sure = np.abs(scale2 - rough) <= 1e-3 * rough
                near = np.where(sure & (value <= target), half, near)
                far = np.where(sure & (value > target), half, far)
                with np.errstate(divide="ignore", invalid="ignore"):
                    step = half + (target - value) / (side * slope)
                    middle = np.where(np.isinf(far), 2 * near, (near + far) / 2)
                last = half
                half = np.minimum(np.where((step >= near) & (step <= far), step, middle), _LARGEST)
                if not np.any(np.abs(half - last) > _ENOUGH * last):
                    break
            end[inside] = np.exp(np.clip(m + side * half, -_LARGEST, _LARGEST))
        return ends[0], ends[1]

    def _over(self, points: Rows, g: Floats) -> Floats:
        """-2 log L at log alpha = g at some points, with the best scale."""
        begin = (self.A / self.B)[points] + (g - self.m[points]) ** 2
        return _best_scale(self.r.T[:, points].T - g[:, None], self.floor, begin)[0]
