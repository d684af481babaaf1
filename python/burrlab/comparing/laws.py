"""Which law the data follow: exponents of force and rate, and the erosion shape, tested against one another."""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
import scipy
from scipy import special

from burrlab._core import Burr, Shape, shape_names
from burrlab.common.check import nearest, refuse, scalar, shown
from burrlab.common.progress import Progress, counter, doing
from burrlab.common.provenance import provenance
from burrlab.common.table import probability_text
from burrlab.comparing.law_comparison import (
    CLOSE,
    HARDER,
    Exponent,
    LawComparison,
    LawRow,
    Parting,
    WithOffset,
)
from burrlab.fitting.diagnostics import POOR, HypothesisTest, against_repeats, concluded
from burrlab.fitting.fit import fit
from burrlab.fitting.likelihood import MODEL_ERROR, means_of_runs, minus2_of, runs_of
from burrlab.fitting.linear import OFFSETS, Uncertain, moved_rows
from burrlab.fitting.mixed import MixedLikelihood
from burrlab.fitting.observations import Data, Floats, Observations
from burrlab.fitting.profile import LEVELS, ConfidenceInterval
from burrlab.fitting.result import Fit
from burrlab.measured.curve import Indentation
from burrlab.theory.continuum import PAPER_FORCE_EXPONENT, PER_SECOND, Law, MasterCurve

NODES = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  #: k of the master curves that others are interpolated from
_NEAR_PRESTON = Law("constant", 2.0)
PRESTON = "preston"  #: v = K F, without constants of the bone
LAWS: Mapping[str, Law | None] = {
    "paper": Law(), **{name: Law(Shape(name)) for name in shape_names if name != "parabolic"},
    "kobra": Law("parabolic", 2.0, 1.0), "preston-bone": _NEAR_PRESTON, PRESTON: None,
}  # fmt: skip
_K = np.linspace(0.0, 3.0, 25)  # k of the family that is walked over
_Q = (*np.linspace(1.0, 2.5, 13).tolist(), 3.0)  # q, where no indentation tells it
_COARSE, _FINE, _REACH = 48, 80, 6.0  # points of c_e, and ln of the largest over the bound that a window sets
_NO_ROOM = 2e-4  # of ln c_e between the bounds of windows and of overloaded runs
_NEAR = 12.0  # rise of -2 log L over the best up to which points of c_e are close
_VAGUE = 0.5  # standard error of q by an indentation from which on it tells nothing
_HIGHEST = 500.0  # logarithm of a ratio of likelihoods, over n, from where it is no matter
_STEPS, _SIDE = 161, 4.0  # points of an exponent's profile, and standard errors to either side
_LEAST = {"s": -np.inf, "q": 0.3, "m": -np.inf}  # where a profile begins at the latest
_CLOSER = (0.03, 0.008)  # steps of q about the best
_RUNS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # numbers of further runs that are tried
_REASONABLE = (0.5, 2.0)  # forces of a further measurement, over the smallest and largest of the data


def member(k: float) -> Shape:
    """(1 - x^2)^k; k = 0 is `constant`."""
    return Shape("constant" if k == 0 else f"power({k:.17g})")


@lru_cache(maxsize=8)
def _weights(k: tuple[float, ...]) -> Floats:
    """Weights of the nodes' log Psi for each k: the polynomial through them, within 0.02 % of a curve of that k."""
    nodes, others = np.array(NODES), ~np.eye(len(NODES), dtype=bool)
    return np.array(
        [
            [np.prod((x - nodes[o]) / (node - nodes[o])) for node, o in zip(nodes, others, strict=True)]
            for x in k
        ]
    )


@dataclass(frozen=True, eq=False)
class Scan:
    """-2 log L over shapes and c_e at one q, with the best alpha and, at it or at a given m, scatter."""

    q: float
    orders: Floats  # of each shape
    c_e: Floats  # [N/mm^2]
    squares: Floats  # of the velocities' residuals at the best m, shape (shapes, c_e)
    m: Floats  # the best
    pressed: Floats  # -2 log L of the indentation's rows, shape (c_e,)
    n: int
    lever: float  # by which (m - best m)^2 adds to the squares
    known: bool

    def heights(self, m: float | Floats | None = None) -> Floats:
        """-2 log L, shape (shapes, c_e)."""
        squares = self.squares if m is None else self.squares + self.lever * (m - self.m) ** 2
        return self.pressed + minus2_of(squares, self.n, self.known)

    @property
    def slopes(self) -> Floats:
        """s = 2 (k + 1)/q + m at the best m, shape (shapes, c_e)."""
        return 2 * (self.orders[:, None] + 1) / self.q + self.m


def _lowest_over(scans: Sequence[Scan], best: Sequence[Floats]) -> Callable[[float], float]:
    """-2 log L of the best law among scans where m or s is given; `best` are each scan's values of it at its best m.

    n log(S/n + e^2) + p, p of the indentation, is lowest where (S/n + e^2) exp(p/n) is: one logarithm serves all laws.
    """
    n, lever, known = scans[0].n, scans[0].lever, scans[0].known
    squares = np.concatenate([scan.squares.ravel() for scan in scans])
    pressed = np.concatenate([np.broadcast_to(scan.pressed, scan.squares.shape).ravel() for scan in scans])
    places, least = np.concatenate([table.ravel() for table in best]), float(pressed.min())
    weight = np.ones(len(pressed)) if known else np.exp(np.minimum((pressed - least) / n, _HIGHEST)) / n
    level, rise = squares + pressed if known else (squares + n * MODEL_ERROR**2) * weight, lever * weight

    def height(given: float) -> float:
        lowest = float((level + rise * (given - places) ** 2).min())
        return lowest if known else float(n * np.log(lowest)) + least

    return height


def _at_offsets(o: Observations, mixed: MixedLikelihood) -> Observations:
    """The rows about which effects are linear: corrected for a fit's offsets, and moved back along these lines."""
    shifts = mixed.shifts.copy()
    for x, block in zip(mixed.components, mixed.linear.blocks, strict=True):
        shifts[block] *= x.quantity in OFFSETS
    o = moved_rows(o, mixed.components, shifts)
    log_ratio, pressed = np.zeros(len(o.force)), o.pressed
    for rows, columns in zip(mixed.linear.rows, mixed.linear.columns, strict=True):
        back = -columns[:, :-3] @ shifts
        if rows.name == "velocity":
            log_ratio[rows.at] = back * np.where(rows.known, o.sigma / o.velocity, 1.0)[rows.at]
        if rows.name == "force":
            pressed = pressed + o.pressed_sigma * back if rows.known else pressed * np.exp(back)
    for run in runs_of(o)[1]:  # its first row has that of all
        log_ratio[run] = log_ratio[run[0]]
    return replace(o, velocity=o.velocity * np.exp(log_ratio), pressed=pressed)


def _whitener(columns: Floats) -> Callable[[Floats], Floats]:
    """What makes rows that share effects independent, of the scatter that is each row's own. Last axis: rows.

    The effects are normal, with standard deviations that are those of the columns over that scatter.
    """
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    shrink = 1 - 1 / np.sqrt(1 + sizes**2)
    return lambda rows: np.asarray(rows - (rows @ basis * shrink) @ basis.T)


@dataclass(frozen=True, eq=False)
class BestPoint:
    """The best constants of a law, and how each row likes them."""

    height: float  # -2 log L, without constants
    n_parameters: int
    c_e: float  # [N/mm^2]; NaN of v = K F
    alpha: float  # [1/ms]; K [mm/(s N)] of v = K F
    rows: Floats  # 2 log L of each row

    @property
    def aic(self) -> float:
        """Without constants that all laws share."""
        return self.height + 2 * self.n_parameters


class LawLikelihood:
    """-2 log L of data over q, m, f and c_e, where ln alpha and m are linear and so in closed form.

    Rows of a trace count by their run's mean. With groups, rows are whitened by the effects' variances of a fit.
    """

    def __init__(
        self, observations: Observations, known: bool = False, effects: MixedLikelihood | None = None
    ) -> None:
        o, self.known, self._scans = observations, known, dict[tuple[float, str], Scan]()
        self._effects = effects
        self.observations, self._windows, (self._single, self._runs) = o, o.by_window(), runs_of(o)
        self.n = len(self._single) + len(self._runs)
        self._weight = (
            means_of_runs(o.velocity / o.sigma, self._single, self._runs) if known else np.ones(self.n)
        )
        columns = {"velocity": np.empty((self.n, 0)), "force": np.empty((len(o.pressed), 0))}
        if effects is not None:  # their part of the rows' covariance, over that of the scatter
            for x, Z, scatter2 in zip(
                effects.linear.rows, effects.linear.columns, effects.equations.scatter2, strict=True
            ):
                columns[x.name] = Z[:, :-3] * np.sqrt(effects.equations.variance[:-2] / scatter2)
        self._whiten = _whitener(columns["velocity"][: self.n])
        self._whiten_pressed = _whitener(columns["force"])
        self.log_velocity = self.whitened(np.log(o.velocity))
        self.ones, self.log_force = self.whitened(np.ones(len(o.force))), self.whitened(np.log(o.force))
        self._level = self.ones / np.linalg.norm(self.ones)
        slope = self.log_force - self._level * (self._level @ self.log_force)
        self._lever = float(slope @ slope)
        refuse(
            len(np.unique(o.force)) < 3 or self.n < 4,
            "laws need four or more velocities at three or more forces, whatever the burrs: got fewer",
        )
        self._slope = slope / self._lever
        #: of ln alpha, c_e and m; s has one less, as k and q are free beside it
        estimated = [x.group for x in (effects.components if effects else ()) if x.deviation is None]
        levels = {group.name: len(group.levels) - 1 for group in estimated}
        self.freedom = max(self.n - 3 - sum(levels.values()), 1)
        self.pressed_known = known and bool(np.isfinite(o.pressed_sigma).all())

    def whitened(self, rows: Floats) -> Floats:
        """The runs' means, made independent and of one scatter. Last axis: rows, then runs."""
        return self._whiten(means_of_runs(rows, self._single, self._runs) * self._weight)

    def _whitened_presses(self, *rows: Floats) -> Floats:
        """The same of the indentation's rows of ln F."""
        o = self.observations
        weight = o.pressed / o.pressed_sigma if self.pressed_known else 1.0
        return self._whiten_pressed(np.stack(rows) * weight)

    def unexplained(self, log_unit: Floats, m: float | Floats | None = None) -> tuple[Floats, Floats]:
        """Residuals after the best ln alpha and m, or a given m; and the best m. Last axis: rows."""
        r = self.log_velocity - self.whitened(log_unit)
        r = r - (r @ self._level)[..., None] * self._level
        best = r @ self._slope
        return r - np.asarray(best if m is None else m)[..., None] * (self._slope * self._lever), best

    def log_unit(self, shapes: Sequence[Shape], q: float, c_e: Floats) -> Floats:
        """ln velocity at alpha = 1 /ms and m = 0, shape (shapes, c_e, rows)."""
        o = self.observations
        logs = np.empty((len(shapes), len(c_e), len(o.force)))
        log_phi = (np.log(o.force / o.radius**2) - np.log(c_e)[:, None]) * (PAPER_FORCE_EXPONENT / q)
        for (start, end), rows in self._windows.items():
            for k, shape in enumerate(shapes):
                logs[k][:, rows] = MasterCurve(shape).log_velocity_ratio(log_phi[:, rows], start, end)
        return logs + np.log(PER_SECOND * o.radius)

    def scan(self, q: float, shape: Shape | None = None) -> Scan:
        """Over c_e, for a shape or for the family (1 - x^2)^k; closer points where the likelihood is high."""
        key = q, "" if shape is None else shape.name
        if key not in self._scans:
            self._scans[key] = self._walk(q, shape)
        return self._scans[key]

    def _walk(self, q: float, shape: Shape | None) -> Scan:
        o = replace(self.observations, force_exponent=q)
        low, high = np.log(o.c_e_floor), np.log(o.ceiling)
        orders = _K if shape is None else np.array([shape.order])
        if high - low < _NO_ROOM:  # an overloaded run leaves the windows no c_e
            nothing = np.full((len(orders), 1), np.inf)
            c_e, m = np.exp([low + _NO_ROOM]), np.zeros_like(nothing)
            return Scan(q, orders, c_e, nothing, m, np.zeros(1), self.n, self._lever, self.known)
        coarse = np.geomspace(_NO_ROOM / 2, min(_REACH, 0.999 * (high - low)), _COARSE)
        first = self._scan(q, shape, np.exp(low + coarse))
        near = np.flatnonzero((first.heights() < first.heights().min() + _NEAR).any(axis=0))
        ends = coarse[max(near[0] - 1, 0)], coarse[min(near[-1] + 1, _COARSE - 1)]
        points = np.unique(np.concatenate([coarse, np.geomspace(*ends, _FINE)]))
        return self._scan(q, shape, np.exp(low + points))

    def _scan(self, q: float, shape: Shape | None, c_e: Floats, k: Floats = _K) -> Scan:
        log_unit = self.log_unit([member(node) for node in NODES] if shape is None else [shape], q, c_e)
        if shape is None:
            log_unit = np.tensordot(_weights(tuple(k.tolist())), log_unit, axes=1)
        orders = k if shape is None else np.array([shape.order])
        r, m = self.unexplained(log_unit)
        squares = np.einsum("...i,...i->...", r, r)
        return Scan(q, orders, c_e, squares, m, self._pressed(q, c_e), self.n, self._lever, self.known)

    def over_k(self, scans: Sequence[Scan], m: float, reach: float) -> tuple[Floats, Floats]:
        """k, close where -2 log L at an m rises by less than `reach`, and the lowest -2 log L of scans there."""
        coarse = np.min([scan.heights(m).min(axis=1) for scan in scans], axis=0)
        near = np.flatnonzero(coarse < coarse.min() + reach)
        k = np.linspace(_K[max(near[0] - 1, 0)], _K[min(near[-1] + 1, len(_K) - 1)], 2 * len(_K) - 1)
        usable = [scan for scan in scans if np.isfinite(scan.squares).any()]  # that leave c_e some room
        closer = [self._scan(scan.q, None, scan.c_e, k).heights(m).min(axis=1) for scan in usable]
        return k, np.min(closer, axis=0)

    def _pressed(self, q: float, c_e: Floats) -> Floats:
        n = len(self.observations.pressed)
        if not n:
            return np.zeros(len(c_e))
        r = replace(self.observations, force_exponent=q).pressed_residuals(c_e, self.pressed_known)
        return minus2_of(np.sum(self._whiten_pressed(r) ** 2, axis=1), n, self.pressed_known)

    def pressed_exponent(self) -> tuple[float, float]:
        """q by the indentation alone, and its standard error."""
        o = self.observations
        x, y = np.log(o.pressed_depth / o.pressed_radius), np.log(o.pressed / o.pressed_radius**2)
        ones, x, y = self._whitened_presses(np.ones(len(x)), x, y)
        x, y = (z - ones * (ones @ z) / (ones @ ones) for z in (x, y))
        q = float(x @ y / (x @ x))
        scatter = np.sqrt(np.sum((y - q * x) ** 2) / max(len(y) - 2, 1))
        return q, float(max(scatter, MODEL_ERROR) / np.sqrt(x @ x))

    def p_of_q(self, law: Law) -> float:
        """Of a law's q, by the indentation alone; 1 where none tells it."""
        if not self.tells_q:
            return 1.0
        q, error = self.pressed_exponent()
        return 2 * float(special.stdtr(self.pressed_freedom, -abs(law.force_exponent - q) / error))

    def limit(self, level: float, freedom: float | None = None) -> float:
        """Rise of -2 log L that bounds an exponent's interval."""
        if self.known if freedom is None else self.pressed_known:
            return float(special.chdtri(1, 1 - level))
        nu, n = (max(self.freedom - 1, 1), self.n) if freedom is None else (freedom, freedom + 2)
        return float(n * np.log1p(special.fdtri(1, nu, level) / nu))

    def test(self, name: str, rise: float, sentence: str, freedom: float | None = None) -> HypothesisTest:
        """Test of one more exponent by the rise without it."""
        if self.known if freedom is None else self.pressed_known:
            return concluded(name, max(rise, 0.0), (1,), sentence, "does not fit better", "fits better")
        nu, n = (self.freedom, self.n) if freedom is None else (freedom, freedom + 2)
        F = nu * float(np.expm1(max(rise, 0.0) / n))
        return concluded(name, F, (1, nu), sentence, "does not fit better", "fits better")

    def best(self, law: Law | None) -> "BestPoint":
        """The best point of a law, or of v = K F."""
        o, m, log_unit = self.observations, 1.0, np.zeros(len(self.observations.force))
        q, c_e = PAPER_FORCE_EXPONENT, np.nan
        if law is not None:
            q, m = law.force_exponent, law.rate_exponent
            scan = self.scan(q, law.shape)
            at = int(np.argmin(scan.heights(m)))
            low, high = np.log(scan.c_e[[max(at - 1, 0), min(at + 1, len(scan.c_e) - 1)]]).tolist()
            optimum = scipy.optimize.minimize_scalar(
                lambda x: self._scan(q, law.shape, np.exp([x])).heights(m).min(),
                bounds=(low, high),
                method="bounded",
            )
            c_e = float(np.exp(optimum.x))
            log_unit = self.log_unit([law.shape], q, np.array([c_e]))[0, 0]
        r, _ = self.unexplained(log_unit, m)
        rest = self.log_velocity - self.whitened(log_unit) - m * self.log_force
        errors, n_parameters = [(r, self.known)], 1 if law is None else 2
        if len(o.pressed):
            predicted, own = self._predicted_presses(law, c_e)
            n_parameters += own
            of_press = (
                (o.pressed - predicted) / o.pressed_sigma
                if self.pressed_known
                else np.log(o.pressed / predicted)
            )
            errors.append((self._whiten_pressed(of_press), self.pressed_known))
        rows, height = [], 0.0
        for residuals, is_known in errors:
            variance = 1.0 if is_known else float(np.mean(residuals**2)) + MODEL_ERROR**2
            rows.append(-(residuals**2) / variance - np.log(variance))
            height += float(residuals @ residuals) if is_known else len(residuals) * float(np.log(variance))
        n_parameters += sum(not is_known for _, is_known in errors)
        alpha = float(np.exp(rest @ self._level / (self.ones @ self._level)))
        return BestPoint(height, n_parameters, c_e, alpha, np.concatenate(rows))

    def _predicted_presses(self, law: Law | None, c_e: float) -> tuple[Floats, int]:
        """The indentation's forces, and how many parameters they have of their own.

        v = K F says nothing of them: they have a c_e of their own, and a q where they tell it.
        """
        o = self.observations
        if law is not None:
            return c_e * replace(o, force_exponent=law.force_exponent).pressed_unit, 0
        q = self.pressed_exponent()[0] if self.tells_q else PAPER_FORCE_EXPONENT
        unit = replace(o, force_exponent=q).pressed_unit
        ones, logs = self._whitened_presses(np.ones(len(unit)), np.log(o.pressed / unit))
        return unit * np.exp(ones @ logs / (ones @ ones)), 1 + self.tells_q

    def height(self, r: Floats) -> float:
        """-2 log L of the velocities' residuals."""
        return float(minus2_of(r @ r, self.n, self.known))

    @cached_property
    def tells_q(self) -> bool:
        """Whether an indentation tells q: four presses or more, at three relative depths that differ enough."""
        o = self.observations
        depths = len(np.unique(o.pressed_depth / o.pressed_radius))
        return len(o.pressed) > 3 and depths > 2 and self.pressed_exponent()[1] < _VAGUE

    def lack_of(self, scans: Sequence[Scan]) -> HypothesisTest | None:
        """Whether the best of all laws lies off the data, by given sigma or repeats; else None, and with groups or traces.

        Only three parameters are taken from the degrees of freedom, though k and q may take up more.
        """
        o, S = self.observations, min(float(np.nanmin(scan.squares)) for scan in scans)
        if self._runs or self._effects is not None:
            return None
        text = (
            "No law with F ~ h^q, a rate ~ F^m and f = (1 - x^2)^k fits the velocities, {outcome}: exponents have no interval. "
            "Is there a tare or a friction, a surface not quite known, a rig that saturates?"
        )
        if self.known:
            return concluded("any law", S, (max(self.n - 3, 1),), text)
        F, freedom = against_repeats(
            S, np.log(o.velocity), np.stack([o.force, o.radius, *o.window], axis=1), 3
        )
        return concluded("any law", F, freedom, text) if freedom else None

    @cached_property
    def velocities_alone(self) -> "LawLikelihood":
        """The same without the indentation."""
        o, rows = self.observations, np.arange(len(self.observations.force))
        groups = tuple(replace(group, pressed=group.pressed[:0]) for group in o.groups)
        o = o.taken(rows, rows[:0], run=o.run, groups=groups)
        return LawLikelihood(o, self.known, self._effects)

    @property
    def pressed_freedom(self) -> int:
        """Degrees of freedom of q."""
        return max(len(self.observations.pressed) - 2, 1)


def _exponent(name: str, grid: Floats, rise: Floats, limits: Mapping[str, float]) -> Exponent:
    """The best exponent and its intervals, from the rise of -2 log L over a grid.

    An end at the grid's end is open, but that of k at 0, below which there is none.
    """
    best, least = int(np.argmin(rise)), 0.0 if name == "k" and grid[0] == 0 else None
    value = float(grid[best])
    if 0 < best < len(grid) - 1:  # the parabola through three points
        a, b, c = rise[best - 1 : best + 2]
        value += float(0.5 * (a - c) / max(a - 2 * b + c, 1e-300) * (grid[best + 1] - grid[best]))
    intervals = {}
    for level, limit in limits.items():
        inside = np.flatnonzero(rise - rise[best] <= limit)
        ends: list[float | None] = []
        for at, beyond in ((inside[0], inside[0] - 1), (inside[-1], inside[-1] + 1)):
            if 0 <= beyond < len(grid):
                part = (limit - (rise[at] - rise[best])) / (rise[beyond] - rise[at])
                ends.append(float(grid[at] + part * (grid[beyond] - grid[at])))
            else:
                ends.append(least if beyond < 0 else None)
        intervals[level] = ConfidenceInterval(*ends)
    return Exponent(name, value, intervals, grid, rise - rise[best], dict(limits))


def _profiled(
    name: str,
    about: tuple[float, float],
    height: Callable[[float], float],
    limits: Mapping[str, float],
    steps: int = _STEPS,
) -> Exponent:
    """An exponent over a grid about a value and its rough error, made wider until it holds the widest limit."""
    value, half = about
    for _ in range(8):
        grid = np.linspace(max(value - half, _LEAST[name]), value + half, steps)
        rise = np.array([height(float(x)) for x in grid])
        inside = rise - rise.min() < max(limits.values())
        if not inside[-1] and not (inside[0] and grid[0] > _LEAST[name]):
            break
        half *= 2
    held = grid[inside]
    if np.ptp(held) < 0.3 * np.ptp(grid):  # too coarse: once more, closer
        margin = 0.2 * float(np.ptp(held)) + 2 * float(grid[1] - grid[0])
        grid = np.linspace(max(held[0] - margin, _LEAST[name]), held[-1] + margin, steps)
        rise = np.array([height(float(x)) for x in grid])
    return _exponent(name, grid, rise, limits)


def exponents(likelihood: LawLikelihood, law: Law) -> tuple[dict[str, Exponent], HypothesisTest | None]:
    """s of the velocities, for k of 0 to 3 and q of 1 to 3; and with an indentation q, and m and k for a law.

    They have no intervals where no law fits; the second value is the test of that, see `LawLikelihood.lack_of`.
    """
    shape = law.shape
    limits = {name: likelihood.limit(level) for name, level in LEVELS.items()}
    of_pressed = {name: likelihood.limit(level, likelihood.pressed_freedom) for name, level in LEVELS.items()}
    found: dict[str, Exponent] = {}
    apart: HypothesisTest | None = None
    if likelihood.tells_q:
        q, error = likelihood.pressed_exponent()
        found["q"] = _profiled(
            "q", (q, 5 * error), lambda q: float(likelihood.scan(q, shape).heights().min()), of_pressed, 65
        )
        apart = _apart(likelihood, found["q"].value)
        held = found["q"].grid[found["q"].rise < max(of_pressed.values())]
        qs = np.linspace(held[0], held[-1], 17).tolist()
        by_q = [likelihood.scan(q, shape) for q in found["q"].grid.tolist()]
    of_shapes = _of_shapes(likelihood, shape, qs if likelihood.tells_q else None)
    scans = [scan for of_f in of_shapes for scan in of_f]
    best_scan = min(scans, key=lambda scan: scan.heights().min())
    k, c = np.unravel_index(np.argmin(best_scan.heights()), best_scan.squares.shape)
    slope = float(best_scan.slopes[k, c])
    error = float(max(np.sqrt(best_scan.squares[k, c] / likelihood.freedom / best_scan.lever), MODEL_ERROR))
    about_s = _profiled(
        "s", (slope, _SIDE * error), _lowest_over(scans, [scan.slopes for scan in scans]), limits
    )
    low, high = (
        np.nan if x is None else x for x in (about_s.intervals["95"].lower, about_s.intervals["95"].upper)
    )
    mean = _mean_slope(of_shapes, float(best_scan.heights().min()))
    found["s"] = replace(about_s, value=float(np.fmin(np.fmax(mean, low), high)))
    if likelihood.tells_q:
        m = slope - 2 * (shape.order + 1) / found["q"].value
        widest = {name: max(limits[name], of_pressed[name]) for name in LEVELS}
        found["m"] = _profiled(
            "m", (m, 4 * _SIDE * error), _lowest_over(by_q, [scan.m for scan in by_q]), widest
        )
        family = [likelihood.scan(q) for q in qs]
        found["k"] = _exponent(
            "k", *likelihood.over_k(family, law.rate_exponent, max(widest.values())), widest
        )
        of_m, of_k = (
            [replace(x, pressed=likelihood._pressed(x.q, x.c_e / HARDER)) for x in scans]
            for scans in (by_q, family)
        )
        lowest = min(of_m, key=lambda scan: scan.heights().min())
        found["m"] = replace(found["m"], if_harder=float(lowest.m.flat[np.argmin(lowest.heights())]))
        rise = np.min([scan.heights(law.rate_exponent).min(axis=1) for scan in of_k], axis=0)
        found["k"] = replace(found["k"], if_harder=_exponent("k", _K, rise, {}).value)
    return _spared(found, likelihood.lack_of(scans), apart)


def _of_shapes(likelihood: LawLikelihood, shape: Shape, qs: Sequence[float] | None) -> list[list[Scan]]:
    """Scans of (1 - x^2)^k, of the shipped shape that is none and of a law's own, each over q; of all q, or of some."""
    of_shapes = []
    for f in (None, *(f for f in dict.fromkeys([Shape("linear"), shape]) if f != member(f.order))):
        of_f = [likelihood.scan(q, f) for q in qs or _Q]
        for step in () if qs else _CLOSER:  # about the best q, which several radii tell
            best = min(of_f, key=lambda scan: scan.heights().min()).q
            of_f += [likelihood.scan(q, f) for q in (best + step * np.arange(-4, 5)).tolist() if q >= 1]
        of_shapes.append(sorted(of_f, key=lambda scan: scan.q))
    return of_shapes


def _mean_slope(of_shapes: Sequence[Sequence[Scan]], least: float) -> float:
    """s = 2 (k + 1)/q + m over laws, each by its likelihood, flat in k, q and the depth at the largest force.

    The likeliest law alone takes scatter for a bend, which lowers the slope: where there is none its s lies high.
    """
    total = weighted = 0.0
    for scans in of_shapes:
        for scan, step in zip(scans, np.gradient([scan.q for scan in scans]), strict=True):
            depth = np.append((scan.c_e / scan.c_e[0]) ** (-1 / scan.q), 0.0)
            weight = np.exp(-(scan.heights() - least) / 2) * step * -np.gradient(depth)[:-1]
            total += float(weight.sum())
            weighted += float((weight * scan.slopes).sum())
    return weighted / total


def _apart(likelihood: LawLikelihood, pooled: float) -> HypothesisTest:
    """Whether an indentation alone tells another q than with the velocities."""
    q, error = likelihood.pressed_exponent()
    F, freedom = ((pooled - q) / error) ** 2, (1, len(likelihood.observations.pressed) - 2)
    p = float(special.fdtrc(*freedom, F))
    return HypothesisTest("q", F, freedom, p, (
        f"The indentation alone tells q = {q:.3g}, with the velocities it would be {pooled:.3g}: the two need a c_e each, "
        f"{probability_text(p)}."
    ))  # fmt: skip


def _spared(
    found: Mapping[str, Exponent], lack: HypothesisTest | None, apart: HypothesisTest | None
) -> tuple[dict[str, Exponent], HypothesisTest | None]:
    """Exponents, and a test that takes intervals from some.

    Where no law fits the velocities, only q keeps its own, which they do not tell. Where an indentation needs another
    c_e than these, only s does.
    """
    exponents = {name: found[name] for name in ("s", "q", "m", "k") if name in found}
    poor = {
        name: test for name, test in (("q", lack), ("s", apart)) if test is not None and test.p_value < POOR
    }
    for spared in poor:
        for name in exponents.keys() - {spared}:
            exponents[name] = replace(
                exponents[name], intervals=dict.fromkeys(LEVELS, ConfidenceInterval(None, None))
            )
    return exponents, next(iter(poor.values()), lack)


def _with_offsets(
    first: Fit,
    burr: Burr | None,
    likelihood: LawLikelihood,
    best: Law | None,
    named: Mapping[str, Law | None],
    options: Mapping[str, Any],
) -> dict[str, WithOffset]:
    """Each law with an offset of the force, by velocities alone; none where offsets are `uncertain`.

    Nor of a law whose q an indentation contradicts, or of an offset that leaves the least force below 0.
    """
    velocities = [x for x in first.data if not isinstance(x, Indentation)]
    alone = likelihood.velocities_alone if len(first.observations.pressed) else likelihood
    with_offsets = {}
    for name, law in named.items():
        if law is None or options["uncertain"] or likelihood.p_of_q(law) < POOR:
            continue
        with contextlib.suppress(ValueError):  # an overloaded run leaves the windows no c_e
            plain, moved = (
                fit(velocities, burr, law=law, **options, estimate=names) for names in ((), ("force",))
            )
            gain, offset = plain.aic - moved.aic, moved.effects[-1].values[0]
            if np.isfinite(gain) and offset > -alone.observations.force.min():
                delta = alone.best(law).aic - alone.best(best).aic
                with_offsets[name] = WithOffset(offset, gain, delta - gain)
    return with_offsets


def _why_not(
    likelihood: LawLikelihood, law: Law | None, tests: Sequence[HypothesisTest], level: float
) -> str:
    """Why a law is contradicted, and whether an indentation of other forces by a factor would leave it; else empty."""
    worst = min(tests, key=lambda test: test.p_value)
    if worst.p_value * len(tests) >= 1 - level:
        return ""
    if law is None or not likelihood.tells_q:
        return worst.sentence
    alone = likelihood.velocities_alone
    best = alone.best(law)
    p_values = [*(test.p_value for test in _tests(alone, law, best.height)), likelihood.p_of_q(law)]
    if min(p_values) * len(p_values) < 1 - level:
        return worst.sentence
    predicted, _ = likelihood._predicted_presses(law, best.c_e)
    factor = float(np.exp(np.mean(np.log(likelihood.observations.pressed / predicted))))
    return (
        f"{worst.sentence} The velocities alone do not: beside them the indentation's forces are {factor:.2f} times those of "
        "this law."
    )


def _tests(likelihood: LawLikelihood, law: Law | None, height: float) -> tuple[HypothesisTest, ...]:
    """A law against those with one more free exponent: m, k of (1 - x^2)^k, and q where an indentation tells it."""
    if law is None:
        return _tests_of_preston(likelihood)
    least = float(likelihood.scan(law.force_exponent, law.shape).heights().min())
    tests = [likelihood.test("m free", height - least, "Another m {so}: {outcome}.")]
    if law.shape == member(law.shape.order):
        heights = likelihood.scan(law.force_exponent).heights(law.rate_exponent).min(axis=1)
        text = f"Another k ({_K[int(np.argmin(heights))]:.3g}) {{so}}: {{outcome}}."
        tests.append(likelihood.test("k free", height - float(heights.min()), text))
    if likelihood.tells_q:
        q, error = likelihood.pressed_exponent()
        grid = np.unique(
            np.maximum(np.append(q + 5 * error * np.linspace(-1, 1, 33), law.force_exponent), 1.0)
        )
        heights = np.array(
            [likelihood.scan(x, law.shape).heights(law.rate_exponent).min() for x in grid.tolist()]
        )
        text = f"Another q ({grid[int(np.argmin(heights))]:.3g}) {{so}}: {{outcome}}."
        tests.append(
            likelihood.test("q free", height - float(heights.min()), text, likelihood.pressed_freedom)
        )
    return tuple(tests)


def _tests_of_preston(likelihood: LawLikelihood) -> tuple[HypothesisTest, ...]:
    """v = K F against another slope, a bend, and a power of the radius."""
    o = likelihood.observations
    r, _ = likelihood.unexplained(np.zeros(len(o.force)), 1.0)
    x, ones = likelihood.log_force, likelihood.ones
    columns = {
        "s free": ("v ~ F^s", [ones, x]),
        "bend": ("A bend of ln v over ln F", [ones, x, likelihood.whitened(np.log(o.force) ** 2)]),
    }
    if len(np.unique(o.radius)) > 1:
        columns["radius"] = ("A power of the radius", [ones, likelihood.whitened(np.log(o.radius))])
    tests = []
    for name, (what, freed) in columns.items():
        basis = np.linalg.qr(np.column_stack(freed))[0]
        rise = likelihood.height(r) - likelihood.height(r - basis @ (basis.T @ r))
        tests.append(likelihood.test(name, rise, f"{what} {{so}} than v ~ F: {{outcome}}."))
    return tuple(tests)


@doing("laws")
def compare_laws(
    data: Data | Sequence[Data],
    burr: Burr | None = None,
    *,
    laws: Iterable[Law | str] = tuple(LAWS),
    level: float = 0.95,
    residuals: Literal["relative", "sigma"] = "relative",
    groups: Sequence[str] | None = None,
    uncertain: Uncertain | None = None,
    progress: Progress | None = None,
) -> LawComparison:
    """Which law of force and rate the data follow: F ~ h^q, a rate ~ F^m, and f = (1 - x^2)^k or another shape.

    Each law is tested against those with one exponent more: m, k, and q where an indentation of the stopped burr
    tells it. A law that is contradicted at `level`, by Holm, or whose lack of fit is clear, gets no constants. The
    rest are compared by AIC.

    Parameters
    ----------
    data : VelocityCurve, Indentation, DepthTrace or a sequence of them
        As for `fit`. Runs that were too slow are left out; overloaded ones bound c_e.
    burr : Burr, optional
        The burr of data sets without a radius.
    laws : sequence of Law or str
        ``"paper"``, its other shapes ``"linear"``, ``"quartic"``, ``"constant"``; ``"kobra"``, q = 2 and m = 1, as in
        the open simulator forsslund/kobra; ``"preston"``, v = K F without constants of the bone; ``"preston-bone"``,
        the law with these that is nearest to it, constant f and q = 2; or your own.
    level : float
        Level at which a law is contradicted.
    residuals : {"relative", "sigma"}
        Log-normal velocities of one scatter, or of scatter sigma/v.
    groups : sequence of str, optional
        As for `fit`; their variances are those of the best law's fit.
    uncertain : dict, optional
        Standard deviations of offsets, as for `fit`: rows are linear in them about the best law's fit. One that sets
        share, by a group, goes with velocities alone, as curve and indentation are judged apart.
    progress : callable or True, optional
        Called with the fraction done, 0 to 1; True shows a bar on standard error.

    Returns
    -------
    LawComparison

    Raises
    ------
    TypeError
        If data or burr has another type.
    ValueError
        If laws is empty or names one twice or an unknown one, level is not between 0 and 1, sigma is missing, an
        offset of a group is given with an indentation, or `fit` refuses the data.

    Notes
    -----
    Velocities tell s = 2 (k + 1)/q + m, with v ~ F^s at small forces, and hardly more: s is profiled over k, q and
    c_e, and its value is the mean over these, weighted by the likelihood. An indentation tells q, and with it m for one f (docs/model.md, "Other laws").

    References
    ----------
    Vuong, Likelihood ratio tests for model selection and non-nested hypotheses, Econometrica 57 (1989): the standard
    error of a difference in AIC. Holm, Scand. J. Statistics 6 (1979).

    Examples
    --------
    >>> import burrlab
    >>> forces = [0.5, 0.7, 1.0, 1.4, 2.0, 2.8]
    >>> curve = burrlab.VelocityCurve(forces, [0.26, 0.34, 0.51, 0.69, 1.03, 1.38], radius=3.0)
    >>> compared = burrlab.compare_laws(curve)
    >>> compared.best.name, round(compared.exponents["s"].value, 1)
    ('preston', 1.0)
    """
    named = _named(laws)
    refuse(not 0 < scalar(level, "level") < 1, f"level must be between 0 and 1: got {level!r}")
    refuse(
        residuals not in ("relative", "sigma"), f"residuals must be 'relative' or 'sigma': got {residuals!r}"
    )
    report_progress, steps = counter(progress, "laws"), 3 * len(named) - 1
    options: dict[str, Any] = {"residuals": residuals, "groups": groups, "uncertain": uncertain}
    of_bone = {name: law for name, law in named.items() if law} or {"preston-bone": _NEAR_PRESTON}
    first = _first_fit(data, burr, of_bone.values(), options)
    refuse(
        len(first.observations.pressed) > 0 and any(isinstance(x, tuple) for x in (uncertain or {}).values()),
        "an uncertain offset of a group goes with velocities alone: leave out the indentation, or give each data set one",
    )
    fits: dict[str, Fit] = {}
    observations = replace(first.observations, force_exponent=PAPER_FORCE_EXPONENT, rate_exponent=0.0)
    effects = None
    if isinstance(first.likelihood, MixedLikelihood):
        fits = {name: fit(data, burr, law=law, **options) for name, law in of_bone.items()}
        best = min(fits.values(), key=lambda x: x.aic).likelihood  # the best law's
        if isinstance(best, MixedLikelihood):
            effects, observations = best, _at_offsets(observations, best)
    likelihood = LawLikelihood(observations, residuals == "sigma", effects)
    report_progress(0, steps)
    points, tests = {}, {}
    for name, law in named.items():
        points[name] = likelihood.best(law)
        tests[name] = _tests(likelihood, law, points[name].height)
        # the first law's tests scan for all
        report_progress(len(named) - 1 + len(points), steps)
    contradicted = {}
    for name, law in named.items():
        contradicted[name] = _why_not(likelihood, law, tests[name], level)
        if law is not None and not contradicted[name]:
            fits[name] = fits.get(name) or fit(data, burr, law=law, **options)
            lack = _lack_of_fit(fits[name])
            if lack is not None:
                tests[name] = (*tests[name], lack)
                contradicted[name] = lack.sentence
        report_progress(2 * len(named) - 1 + len(contradicted), steps)
    least = min(points, key=lambda name: (bool(contradicted[name]), points[name].aic))
    with_offsets = _with_offsets(first, burr, likelihood, named[least], named, options)
    rows = []
    for name, law in named.items():
        apart = points[name].rows - points[least].rows
        p = min(min(test.p_value for test in tests[name]) * len(tests[name]), 1.0)
        rows.append(LawRow(
            name, law, points[name].c_e, points[name].alpha, points[name].aic - points[least].aic,
            float(np.sqrt(len(apart)) * np.std(apart)), tests[name], p, contradicted[name],
            None if contradicted[name] else fits.get(name), with_offsets.get(name),
        ))  # fmt: skip
    rows.sort(key=lambda row: (row.contradicted, row.delta_aic))
    law = next((row.law for row in rows if row.law), Law())
    return LawComparison(
        tuple(rows), *exponents(likelihood, law), law, level, residuals, first.observations,
        _partings(rows, likelihood),
        provenance(laws={name: str(law) for name, law in named.items()}, level=level, residuals=residuals),
    )  # fmt: skip


def _lack_of_fit(of_law: Fit) -> HypothesisTest | None:
    """The test that calls a fit poor; None if none does."""
    goodness = of_law.evidence and of_law.evidence.goodness
    return goodness.test if goodness and goodness.poor else None


def _first_fit(
    data: Data | Sequence[Data],
    burr: Burr | None,
    laws: Iterable[Law],
    options: Mapping[str, Any],
) -> Fit:
    """A fit by the first law whose bounds of c_e the data leave some room; the error of the last if none do."""
    *others, last = laws
    for law in others:
        with contextlib.suppress(ValueError):
            return fit(data, burr, law=law, **options)
    return fit(data, burr, law=last, **options)


def _named(laws: Iterable[Law | str]) -> dict[str, Law | None]:
    """The laws by their names; ValueError unless each is known and there once."""
    refuse(
        not isinstance(laws, Iterable | Law),
        f"laws must be several of Law, or names: got {shown(laws)}",
        TypeError,
    )
    named: dict[str, Law | None] = {}
    for law in [laws] if isinstance(laws, str | Law) else laws:
        law = law if isinstance(law, str) else Law.of(law)
        name = law if isinstance(law, str) else str(law)
        refuse(
            isinstance(law, str) and name not in LAWS,
            f"laws must be of {', '.join(LAWS)} or a Law: got {name!r}{nearest(name, LAWS)}",
        )
        named_law = LAWS[law] if isinstance(law, str) else law
        refuse(named_law in named.values(), f"laws must be given once each: got {name!r} twice")
        named[name] = named_law
    refuse(not named, "laws must hold one law or more: got none")
    return named


def rise_of(
    o: Observations,
    laws: tuple[Law | None, Law | None],
    run: tuple[float, float, float],
    n: int,
) -> float:
    """How far n runs, with the velocity of the first law, raise -2 log L of the second over that of the first.

    A run is (F [N], v [mm/s], R [mm]). Both laws are fitted again with the runs, each with its own scatter.
    """
    likelihoods = LawLikelihood(replace(o, groups=())), LawLikelihood(o.with_runs(*run, n))
    heights = [[likelihood.best(law).height for law in laws] for likelihood in likelihoods]
    return (heights[1][1] - heights[1][0]) - (heights[0][1] - heights[0][0])


def _partings(rows: Sequence[LawRow], likelihood: LawLikelihood) -> tuple[Parting, ...]:
    """Where the best law and each other that lies close part most, and how many more runs there would tell."""
    o, partings = likelihood.observations, []
    radii, counts = np.unique(o.radius[np.isnan(o.window_start)], return_counts=True)
    R = float(radii[np.argmax(counts)]) if len(radii) else np.nan  # that of most runs in the default window
    force = np.geomspace(_REASONABLE[0] * o.force.min(), _REASONABLE[1] * o.force.max(), 60)
    for row in rows[1:]:
        if row.contradicted or row.delta_aic >= CLOSE or np.isnan(R):
            continue
        with np.errstate(invalid="ignore"):
            first, second = (x.velocity(force, R) for x in (rows[0], row))
        if np.isnan(first * second).all():
            continue
        at = int(np.nanargmax(np.abs(np.log(second / first))))
        run = float(force[at]), float(first[at]), R
        for n in _RUNS:
            if rise_of(o, (rows[0].law, row.law), run, n) > CLOSE:
                partings.append(Parting(row.name, run[0], R, float(second[at] / first[at]), n))
                break
    return tuple(partings)
