"""The rows that a fit compares, from all data sets, and how far -2 log L may rise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special

from burrlab._core import Burr
from burrlab.common.check import refuse
from burrlab.measured.curve import Indentation, VelocityCurve
from burrlab.measured.depth_trace import DepthTrace
from burrlab.theory.continuum import WINDOW_START, WINDOW_STOP

Floats: TypeAlias = NDArray[np.float64]
Rows: TypeAlias = NDArray[np.intp]
ResidualKind: TypeAlias = Literal["relative", "absolute", "sigma", "student"]
Bounds: TypeAlias = dict[str, tuple[float, float]]
Data: TypeAlias = VelocityCurve | Indentation | DepthTrace

SEGMENTS = 5  # parts of equal depth that a trace is compared in
C_E_RANGE = 100.0  # upper bound of c_e over its lower one, see `bounds_of`
ALPHA_BOUNDS = (1e-5, 10.0)  # [1/ms], see `bounds_of`
_EXTREME = 1e9  # forces, velocities and radii lie between 1/_EXTREME and this, in N, mm/s and mm
_VELOCITY = ("force", "velocity", "sigma", "window_start", "window_end", "radius", "run", "log_sigma")
_PRESSED = ("pressed", "pressed_sigma", "pressed_unit")  # columns of velocity rows, and of pressed ones
_MARGIN = 1e-4  # relative distance from the hard bound of c_e, where the window has no length


@dataclass(frozen=True, eq=False)
class Observations:
    """The rows that a fit uses, in the order of the data; a NaN window is the default one.

    A velocity row is a row of a curve or one segment of a trace; `run` numbers the traces and is -1 for a
    curve's row. A pressed row is a pair of a static indentation.
    """

    force: Floats  # [N], of velocity rows, as the next seven
    velocity: Floats  # [mm/s]
    sigma: Floats  # [mm/s], NaN where unknown
    window_start: Floats  # [mm]
    window_end: Floats  # [mm]
    radius: Floats  # [mm]
    run: Rows
    log_sigma: Floats  # of log velocity [1], from the record of a trace's segment; NaN for a curve's row
    pressed: Floats  # [N], of pressed rows, as the next two
    pressed_sigma: Floats  # [N], NaN where unknown
    pressed_unit: Floats  # R^2 (h/R)^(3/2) [mm^2], the force at c_e = 1 N/mm^2 (Eq. 3)
    rows: tuple[tuple[str, Rows], ...]  # of each data set: which table, and its rows there
    ceiling: float  # [N/mm^2]: a run whose static contact passed its window's end needs c_e below this
    n_skipped: int
    n_censored: int

    @classmethod
    def of(cls, data: Sequence[Data], burr: Burr | None) -> "Observations":
        """The usable rows of data sets.

        Raises
        ------
        ValueError
            If a radius is missing or contradicts the burr's, fewer than three distinct forces have a
            velocity, a lone pair of an indentation has no sigma, or runs contradict one another about c_e.
        """
        parts: dict[str, list[Floats]] = {name: [np.empty(0)] for name in (*_VELOCITY, *_PRESSED)}
        rows: list[tuple[str, Rows]] = []
        ceiling, n_skipped, n_censored, n_runs = np.inf, 0, 0, 0
        for data_set in data:
            radius = _radius(data_set, burr)
            columns: dict[str, Any] = {"force": data_set.force, "radius": radius, "run": -1}
            if isinstance(data_set, Indentation):
                unit = radius**2 * (data_set.depth / radius) ** 1.5
                columns = {"pressed": data_set.force, "pressed_sigma": data_set.sigma, "pressed_unit": unit}
            elif isinstance(data_set, DepthTrace):
                segments = data_set.segments(SEGMENTS)
                columns |= {"velocity": segments.velocity, "log_sigma": segments.log_sigma, "run": n_runs}
                columns |= {"window_start": segments.start_mm, "window_end": segments.end_mm}
                n_runs += 1
            else:
                ok = data_set.ok
                for name in ("force", "velocity", "sigma", "window_start", "window_end"):
                    column = getattr(data_set, name)
                    columns[name] = None if column is None else column[ok]
                over = np.array([s == "overloaded" for s in data_set.status or len(data_set) * ("",)])
                end = np.full(len(data_set), np.nan) if data_set.window_end is None else data_set.window_end
                ceiling = float(_static_c_e(data_set.force[over], end[over], radius).min(initial=ceiling))
                n_skipped, n_censored = n_skipped + int((~ok).sum()), n_censored + int(over.sum())
            kind, names = ("velocity", _VELOCITY) if "velocity" in columns else ("pressed", _PRESSED)
            begin, n = sum(map(len, parts[kind])), len(columns[kind])
            rows.append((kind, np.arange(begin, begin + n)))
            for name in names:  # missing columns are NaN
                parts[name].append(np.broadcast_to(np.asarray(columns.get(name), np.float64), n))
        tables: dict[str, Any] = {name: np.concatenate(pieces) for name, pieces in parts.items()}
        tables["run"] = tables["run"].astype(np.intp)
        observations = cls(
            **tables, rows=tuple(rows), ceiling=ceiling, n_skipped=n_skipped, n_censored=n_censored
        )
        observations._check()
        return observations

    def _check(self) -> None:
        for name, unit, values in (
            ("force", "N", self.force),
            ("velocity", "mm/s", self.velocity),
            ("radius", "mm", self.radius),
            ("force of an indentation", "N", self.pressed),
        ):
            beyond = values[(values < 1 / _EXTREME) | (values > _EXTREME)]
            if len(beyond):
                raise ValueError(
                    f"{name} must lie between {1 / _EXTREME:g} and {_EXTREME:g} {unit} in a fit: got "
                    f"{beyond[0]:g}"
                )
        distinct = len(set(zip(self.force.tolist(), self.radius.tolist(), strict=True)))
        refuse(
            distinct < 3,
            f"a fit needs velocities at three or more distinct forces: got {distinct} in "
            f"{len(self.force)} usable of {len(self.force) + self.n_skipped} rows",
        )
        refuse(
            len(self.pressed) == 1 and np.isnan(self.pressed_sigma[0]),
            "an indentation without sigma needs two pairs or more, to show its scatter: got one in all",
        )
        floors = self.c_e_bounds()
        row = int(np.argmax(floors))
        refuse(
            floors[row] >= self.ceiling,
            f"the data contradict one another: the window at {self.force[row]:g} N needs c_e > "
            f"{floors[row]:.4g} N/mm^2, an 'overloaded' run needs c_e < {self.ceiling:.4g} N/mm^2",
        )

    def __len__(self) -> int:
        return len(self.force) + len(self.pressed)

    @property
    def has_sigma(self) -> bool:
        return bool(np.isfinite(self.sigma).all())

    def with_outcomes(self, velocity: Floats, pressed: Floats) -> "Observations":
        """The same experiment with other outcomes."""
        return replace(self, velocity=velocity, pressed=pressed)

    def kept(self, keep: NDArray[np.bool_]) -> "Observations":
        """Those velocity rows only; ValueError if they are too few for a fit. `rows` stays."""
        remaining = replace(self, **{name: getattr(self, name)[keep] for name in _VELOCITY})
        remaining._check()
        return remaining

    def by_window(self) -> dict[tuple[float | None, float | None], Rows]:
        """Velocity rows by window in radii; (None, None) is the default window."""
        windows: dict[tuple[float | None, float | None], list[int]] = {}
        ends = zip(self.window_start / self.radius, self.window_end / self.radius, strict=True)
        for row, (start, end) in enumerate(ends):
            key = (None, None) if np.isnan(start) else (float(start), float(end))
            windows.setdefault(key, []).append(row)
        return {key: np.array(rows, dtype=np.intp) for key, rows in windows.items()}

    def phi(self, c_e: float) -> Floats:
        """F/(c_e R^2) of every velocity row."""
        return self.force / (c_e * self.radius**2)

    def c_e_bounds(self) -> Floats:
        """Lower bound of c_e [N/mm^2] that each velocity row's window implies.

        Static contact alone sinks the burr to H = R phi^(2/3). A window needs a deeper end H_end, so
        c_e > F/(R^2 (H_end/R)^(3/2)): F/(0.1925 R^2) for the default end R/3 (docs/model.md, section 5 iv).
        """
        return _static_c_e(self.force, self.window_end, self.radius)

    def ridge_entries(self) -> Floats:
        """c_e [N/mm^2] above which each window starts deeper than static contact (default: phi < 0.068).

        There v is a power law of phi and only alpha/c_e^p is determined (docs/model.md, section 5 iii).
        """
        start = np.where(np.isnan(self.window_start), WINDOW_START * self.radius, self.window_start)
        with np.errstate(divide="ignore"):
            return self.force / (self.radius**2 * (start / self.radius) ** 1.5)


def _static_c_e(force: Floats, end: Floats, radius: Floats | float) -> Floats:
    """c_e [N/mm^2] at which static contact alone ends at `end` [mm], NaN for R/3."""
    relative = np.where(np.isnan(end), WINDOW_STOP, end / radius)
    return np.asarray(force / (radius**2 * relative**1.5))


def _radius(data: Data, burr: Burr | None) -> float:
    if burr is not None and data.radius not in (None, burr.radius):
        name = "curve" if isinstance(data, VelocityCurve) else "data set"
        raise ValueError(
            f"the {name} was taken with a burr of radius {data.radius:g} mm, the fit is for "
            f"{burr.radius:g} mm"
        )
    if data.radius is not None:
        return data.radius
    if burr is None:
        raise ValueError(f"a burr must be given for data without a radius: got none for {data!r}")
    return burr.radius


@dataclass(frozen=True)
class Box:
    """Bounds of the two parameters: (c_e [N/mm^2], alpha [1/ms])."""

    lower: tuple[float, float]
    upper: tuple[float, float]


def bounds_of(observations: Observations, bounds: Bounds | None) -> Box:
    """The box of the search.

    c_e runs from the hard bound of `Observations.c_e_bounds` to 100 times that, or to the limit of an
    overloaded run. At 100 times the bound the largest phi is 0.0019, and even alpha = 10 /ms cuts slower than
    10 um/s at R = 3 mm: data beyond lie on the ridge, which goes on unchanged. alpha runs from 1e-5 /ms (a
    time constant of 100 s: nothing erodes in an experiment) to 10 /ms (solid bone is gone in a tenth of a
    tick, no layer is left).

    Raises
    ------
    ValueError
        If a bound leaves no room.
    """
    hard = float(observations.c_e_bounds().max()) * (1 + _MARGIN)
    ceiling = observations.ceiling * (1 - _MARGIN)
    deepest = float(observations.force[np.argmax(observations.c_e_bounds())])
    box = {"c_e": (min(hard, ceiling), min(C_E_RANGE * hard, ceiling)), "alpha": ALPHA_BOUNDS}
    for name, pair in (bounds or {}).items():
        low, high = (float(end) for end in pair)
        refuse(
            name == "c_e" and high <= hard,
            f"bounds of c_e end at {high:g} N/mm^2, but the window at {deepest:g} N "
            f"needs c_e > {hard:g} N/mm^2",
        )
        refuse(
            name == "c_e" and low >= ceiling,
            f"bounds of c_e begin at {low:g} N/mm^2, but an 'overloaded' run needs c_e < {ceiling:g} N/mm^2",
        )
        box[name] = (max(low, hard), min(high, ceiling)) if name == "c_e" else (low, high)
    return Box((box["c_e"][0], box["alpha"][0]), (box["c_e"][1], box["alpha"][1]))


@dataclass(frozen=True)
class RowScatter:
    """Rows that share one scatter."""

    name: str  #: "velocity", "segments" or "force"
    n: int
    known: bool  #: sigma was given
    parameters: float  #: how many of the two parameters these rows determine; the scatters' sum is 2
    value: float  #: standard deviation about the fit [1], or [mm/s] for absolute residuals; 1 if known


@dataclass(frozen=True)
class Threshold:
    """How a rise of -2 log L along one quantity is judged: rise = inflation nu log(1 + F/nu).

    F has 1 and nu degrees of freedom. With known sigma nu is infinite, and F is a chi-square.
    """

    inflation: float
    nu: float

    def statistic(self, rise: float) -> float:
        """F, or chi-square where sigma is known; 0 for a fall."""
        rise = max(rise, 0.0) / self.inflation
        return rise if np.isinf(self.nu) else float(self.nu * np.expm1(min(rise / self.nu, 700.0)))

    def probability(self, rise: float) -> float:
        """p-value of a rise."""
        F = self.statistic(rise)
        return float(special.chdtrc(1, F) if np.isinf(self.nu) else special.fdtrc(1, self.nu, F))

    def limit(self, level: float) -> float:
        """Largest rise inside `level`, 0.95 for 95 %."""
        # from special, because the checks of stats.f take a hundred times as long
        if np.isinf(self.nu):
            return self.inflation * float(special.chdtri(1, 1 - level))
        return self.inflation * self.nu * float(np.log1p(special.fdtri(1, self.nu, level) / self.nu))


@dataclass(frozen=True, eq=False)
class Calibration:
    """How far -2 log L may rise above its minimum, from the F distribution.

    For one estimated scatter and a model that is linear near the fit, S/S_min - 1 of q parameters is
    q/nu F(q, nu) with nu = n - 2. So the limit is n log(1 + q F/nu): wider than chi-square in small samples.
    Where sigma is known, the limit is chi-square's. Several scatters count by their share of the information
    in the direction asked for, nu by the rule of Welch and Satterthwaite. For both parameters (q = 2) the
    limit of one scatter is chi-square's times n/nu, the ratio of their means. Several scatters add their
    means: n (psi(n/2) - psi((n - p)/2)) for rows that determine p of the parameters (Bartlett's correction).

    References
    ----------
    Seber and Wild, Nonlinear Regression, Wiley 1989, section 5.3 (regions by the sum of squares).
    Bartlett, Properties of sufficiency and statistical tests, Proc. R. Soc. A 160 (1937).
    Satterthwaite, An approximate distribution of estimates of variance components, Biometrics 2 (1946).
    """

    scatters: tuple[RowScatter, ...]
    total: Floats  # information, shape (2, 2), or (3, 3) with another parameter
    shares: Floats  # by scatter
    monte_carlo: float = 0.0  # variance of the fit by the stochastic engine, over that by the data
    inflation: float = 1.0  # chi-square over degrees of freedom, where the data contradict their sigma

    def limit(self, level: float, direction: Floats | None = None) -> float:
        """Largest rise of -2 log L inside `level`.

        Parameters
        ----------
        level : float
            0.95 for 95 %.
        direction : ndarray, shape (2,), optional
            Gradient of one quantity over (log c_e, log alpha); None is for both parameters jointly.
        """
        return self.limits({"": level}, direction)[""]

    def limits(self, levels: Mapping[str, float], direction: Floats | None = None) -> dict[str, float]:
        """The limit of each level; see `limit`."""
        wider = (1 + self.monte_carlo) * self.inflation
        if direction is None:
            joint = self._joint_inflation()
            return {name: float(-2 * np.log1p(-level) * joint * wider) for name, level in levels.items()}
        threshold = self.threshold(direction)
        return {name: threshold.limit(level) * wider for name, level in levels.items()}

    def probability(self, rise: float, direction: Floats | None = None) -> float:
        """p-value of a rise of -2 log L: the inverse of `limit`."""
        rise /= (1 + self.monte_carlo) * self.inflation
        if direction is None:
            return float(np.exp(-rise / 2 / self._joint_inflation()))
        return self.threshold(direction).probability(rise)

    def threshold(self, direction: Floats | None, times: float = 1.0) -> Threshold:
        """The threshold of one quantity, or the parameters' mean; the rows determine `times` as many."""
        freedom = np.array(
            [np.inf if s.known else max(s.n - times * s.parameters, 0.5) for s in self.scatters]
        )
        weights = self._weights(direction)
        rows = np.array([s.n for s in self.scatters])
        known = np.isinf(freedom)
        inflation = float(np.sum(weights * np.where(known, 1.0, rows / freedom)))
        nu = 1 / max(float(np.sum(weights**2 / freedom)), 1e-12)
        return Threshold(inflation, nu if nu < 1e9 else np.inf)

    def _joint_inflation(self) -> float:
        """Mean rise of both parameters over chi-square's 2: n/(n - 2) for one scatter, as in the F limit."""
        mean = 0.0
        for s in self.scatters:
            freedom = max(s.n - s.parameters, 0.5)
            mean += (
                s.parameters if s.known else s.n * float(np.diff(special.digamma([freedom / 2, s.n / 2]))[0])
            )
        return mean / 2

    def _weights(self, direction: Floats | None) -> Floats:
        if len(self.scatters) == 1:
            return np.ones(1)
        q = len(self.total)
        inverse = np.linalg.inv(self.total + 1e-10 * np.trace(self.total) * np.eye(q))
        if direction is None:
            return np.array([np.trace(inverse @ share) / q for share in self.shares])
        column = inverse @ direction
        weights = np.array([column @ share @ column for share in self.shares])
        return np.asarray(weights / weights.sum())
