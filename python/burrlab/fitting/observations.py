"""The rows that a fit compares, from all data sets."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import Burr
from burrlab.common.check import refuse
from burrlab.common.study import LATER
from burrlab.measured.curve import TOO_SLOW, Indentation, VelocityCurve
from burrlab.measured.depth_trace import DepthTrace
from burrlab.theory.continuum import PAPER_FORCE_EXPONENT, WINDOW_START, WINDOW_STOP, Law

Floats: TypeAlias = NDArray[np.float64]
Rows: TypeAlias = NDArray[np.intp]
ResidualKind: TypeAlias = Literal["relative", "absolute", "sigma", "student"]
Bounds: TypeAlias = dict[str, tuple[float, float]]
Data: TypeAlias = VelocityCurve | Indentation | DepthTrace

SEGMENTS = 5  # parts of equal depth that a trace is compared in
C_E_RANGE = 100.0  # upper bound of c_e over its lower one, see `bounds_of`
ALPHA_BOUNDS = (1e-5, 10.0)  # [1/ms], see `bounds_of`
_DIGITS = 12  # of mm, to which moved windows and radii are rounded
_EXTREME = 1e9  # forces, velocities and radii lie between 1/_EXTREME and this, in N, mm/s and mm
_MEASURED = ("force", "velocity", "sigma", "window_start", "window_end")  # columns of a curve
_VELOCITY = (*_MEASURED, "radius", "run", "log_sigma", "number")
_PRESSED = ("pressed", "pressed_sigma", "pressed_depth", "pressed_radius")  # as _VELOCITY, of pressed rows
_MARGIN = 1e-4  # relative distance from the hard bound of c_e, where the window has no length


@dataclass(frozen=True, eq=False)
class Group:
    """What tells rows apart: a day, an operator, a specimen; and the level, from 0, of each row."""

    name: str
    levels: tuple[str, ...]
    velocity: Rows  # of each velocity row
    pressed: Rows  # of each pressed row

    def pairs(self, other: "Group") -> set[tuple[int, int]]:
        """The levels of both that rows have."""
        return {*zip(self.velocity.tolist(), other.velocity.tolist(), strict=True),
                *zip(self.pressed.tolist(), other.pressed.tolist(), strict=True)}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Observations:
    """The rows that a fit uses, in the order of the data, and the exponents of the law that they are compared with.

    A NaN window is the default one.

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
    pressed_depth: Floats  # h [mm]
    pressed_radius: Floats  # R [mm]
    rows: tuple[tuple[str, Rows], ...]  # of each data set: which table, and its rows there
    overloaded: Floats  # F [N], end of window [mm] and R [mm] of runs whose static contact passed that end, shape (3, m)
    n_skipped: int
    n_censored: int  # rows without a velocity that tell something: overloaded and too-slow ones
    eased: float = 1.0  # c_e's lower bound over that of the rows as they are
    raised: float | None = None  # [N/mm^2], c_e's upper bound instead of that of the overloaded rows
    measured_force: Floats | None = field(default=None, compare=False)  # [N], where `force` is another
    sets: Group = field(
        default_factory=lambda: Group("data set", (), *np.empty((2, 0), np.intp)), compare=False
    )
    groups: tuple[Group, ...] = field(default=(), compare=False)
    #: F [N], smallest measurable velocity [mm/s], window [mm] and R [mm] of runs that were too slow, shape (5, k)
    slow: Floats = field(default_factory=lambda: np.empty((5, 0)), compare=False)
    force_exponent: float = field(default=PAPER_FORCE_EXPONENT, metadata=LATER)  # see `Law`, as the next
    rate_exponent: float = field(default=0.0, metadata=LATER)
    #: of each velocity row: its run among all that were made, also those without a velocity
    number: Floats = field(default_factory=lambda: np.empty(0), compare=False)
    #: ln c_e of each velocity row over that of others, by which `force` is less; the rate is that of the whole force
    log_c_e: Floats | float = field(default=0.0, compare=False)
    pressed_log_c_e: Floats | float = field(
        default=0.0, compare=False
    )  # of each pressed row, by which depth is more

    @classmethod
    def of(
        cls,
        data: Sequence[Data],
        burr: Burr | None,
        groups: Sequence[str] | None = (),
        law: Law | None = None,
    ) -> "Observations":
        """The usable rows of data sets, with some of their groups; None is for all, and for the paper's law.

        Raises
        ------
        ValueError
            If a radius is missing or contradicts the burr's, fewer than three distinct forces have a
            velocity, a lone pair of an indentation has no sigma, or runs contradict one another about c_e; or if
            a data set lacks a group, or two groups are one.
        """
        parts: dict[str, list[Floats]] = {name: [np.empty(0)] for name in (*_VELOCITY, *_PRESSED)}
        rows: list[tuple[str, Rows]] = []
        overloaded, slow, n_skipped, n_censored, n_runs = [np.empty((3, 0))], [np.empty((5, 0))], 0, 0, 0
        n_made = 0
        for data_set in data:
            radius = _radius(data_set, burr)
            columns: dict[str, Any] = {"force": data_set.force, "radius": radius, "run": -1}
            if isinstance(data_set, Indentation):
                columns = {"pressed": data_set.force, "pressed_sigma": data_set.sigma,
                           "pressed_depth": data_set.depth, "pressed_radius": radius}  # fmt: skip
            elif isinstance(data_set, DepthTrace):
                segments = data_set.segments(SEGMENTS)
                columns |= {"velocity": segments.velocity, "log_sigma": segments.log_sigma, "run": n_runs}
                columns["number"] = n_made
                columns |= {"window_start": segments.start_mm, "window_end": segments.end_mm}
                n_runs, n_made = n_runs + 1, n_made + 1
            else:
                ok = data_set.ok
                table = {name: getattr(data_set, name) for name in _MEASURED}
                columns |= {name: column[ok] for name, column in table.items() if column is not None}
                columns["number"], n_made = n_made + np.flatnonzero(ok), n_made + len(ok)
                status = np.array(data_set.status or len(data_set) * ("",))
                over, below = status == "overloaded", status == TOO_SLOW
                nan, of_all = np.full(len(data_set), np.nan), np.full(len(data_set), radius)
                limit, start, end = (
                    nan if column is None else column
                    for column in (data_set.limit, data_set.window_start, data_set.window_end)
                )
                overloaded.append(np.stack([data_set.force, end, of_all])[:, over])
                slow.append(np.stack([data_set.force, limit, start, end, of_all])[:, below])
                n_skipped, n_censored = n_skipped + int((~ok).sum()), n_censored + int((over | below).sum())
            kind, names = ("velocity", _VELOCITY) if "velocity" in columns else ("pressed", _PRESSED)
            begin, n = sum(map(len, parts[kind])), len(columns[kind])
            rows.append((kind, np.arange(begin, begin + n)))
            for name in names:  # missing columns are NaN
                parts[name].append(np.broadcast_to(np.asarray(columns.get(name), np.float64), n))
        tables: dict[str, Any] = {name: np.concatenate(pieces) for name, pieces in parts.items()}
        tables["run"] = tables["run"].astype(np.intp)
        sets = Group("data set", tuple(map(str, range(1, len(rows) + 1))), *(
            np.repeat(np.arange(len(rows)), [len(at) * (name == kind) for name, at in rows])
            for kind in ("velocity", "pressed")
        ))  # fmt: skip
        labels, bounding = _groups(data, rows, groups), np.concatenate(overloaded, axis=1)
        if any(group.name == "specimen" and len(group.levels) > 2 for group in labels):
            # each has a c_e of its own, and an overloaded run bounds no other
            n_censored, bounding = n_censored - bounding.shape[1], bounding[:, :0]
        return cls(
            **tables, rows=tuple(rows), overloaded=bounding, slow=np.concatenate(slow, axis=1), n_skipped=n_skipped,
            n_censored=n_censored, sets=sets, groups=labels, **(law.exponents if law else {}),
        )._checked()  # fmt: skip

    def _checked(self) -> "Observations":
        """These rows; ValueError unless a fit can use them."""
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
        refuse(
            self.c_e_floor >= self.ceiling,
            f"the data contradict one another: the window at {self.bounding_force:g} N needs c_e > "
            f"{self.c_e_floor:.4g} N/mm^2, an 'overloaded' run needs c_e < {self.ceiling:.4g} N/mm^2",
        )
        return self

    def __len__(self) -> int:
        return len(self.force) + len(self.pressed)

    @property
    def run_number(self) -> Rows:
        """The run of each velocity row: segments of a trace share one."""
        single = self.run < 0
        return np.where(single, self.run.max(initial=-1) + np.cumsum(single), self.run)

    def order(self, group: str = "") -> Floats:
        """Place of each velocity row's run among all, or among those of its label: -1/2 for the first.

        The last has 1/2: that of the label with the most runs, as a burr wears from run to run.
        """
        of = self.by_name[group].velocity if group in self.by_name else np.zeros(len(self.force), np.intp)
        first = np.full(of.max(initial=0) + 1, np.inf)
        np.minimum.at(first, of, self.number)
        place = self.number - first[of]
        return np.asarray(place / max(place.max(initial=0), 1) - 0.5)

    @property
    def by_name(self) -> dict[str, Group]:
        """The groups, and the data sets as one more."""
        return {group.name: group for group in (self.sets, *self.groups)}

    @property
    def labels(self) -> dict[str, set[str]]:
        """The labels of each group."""
        return {group.name: set(group.levels) for group in self.groups}

    @property
    def has_sigma(self) -> bool:
        return bool(np.isfinite(self.sigma).all())

    @property
    def window(self) -> tuple[Floats, Floats]:
        """Start and end of each velocity row's window [mm]; where it is the default one, R/6 and R/3."""
        start, end, R = self.window_start, self.window_end, self.radius
        return np.where(np.isnan(start), WINDOW_START * R, start), np.where(
            np.isnan(end), WINDOW_STOP * R, end
        )

    @property
    def recorded_force(self) -> Floats:
        """Force of each velocity row as it was measured [N]."""
        return self.force if self.measured_force is None else self.measured_force

    @property
    def pressed_unit(self) -> Floats:
        """R^2 (h/R)^q [mm^2] of pressed rows, the force at c_e = 1 N/mm^2 (Eq. 3: q = 3/2)."""
        R, depth = self.pressed_radius, np.where(self.pressed_depth > 0, self.pressed_depth, np.nan)
        return np.asarray(R**2 * (depth / R) ** self.force_exponent)

    def pressed_residuals(self, c_e: ArrayLike, known: bool, own: Floats | float = 0.0) -> Floats:
        """Residuals of the pressed rows: in log force, or over sigma if that is known; last axis: rows.

        `own` is ln c_e of each row over that of all.
        """
        stiffness = np.asarray(c_e, dtype=np.float64)[..., None] * np.exp(own)
        if known:
            return np.asarray((self.pressed - stiffness * self.pressed_unit) / self.pressed_sigma)
        return np.asarray(
            np.log(self.pressed / self.pressed_unit) - np.log(stiffness)
        )  # log c_e of each (Eq. 3)

    def moved(self, offset: str, velocity: Floats | float, pressed: Floats | float) -> "Observations":
        """The rows corrected for an offset of what was measured.

        Parameters
        ----------
        offset : {"force", "surface", "radius", "c_e"}
        velocity, pressed : float or ndarray
            True less measured force [N], depth or radius [mm], of velocity rows and of pressed rows; or ln of their
            c_e over that of others, as which less force and more depth count. Windows stay
            where they were measured, in mm, and end at R at the latest. There and back they are the same numbers.
        """
        start, end = self.window
        F, stop, R = self.overloaded
        stop, by = np.where(np.isnan(stop), WINDOW_STOP * R, stop), np.mean(velocity)
        moved = replace(self, window_start=start, window_end=end, overloaded=np.stack([
            F + by * (offset == "force"), stop + by * (offset == "surface"), R + by * (offset == "radius"),
        ]))  # fmt: skip
        if offset == "c_e":
            return replace(
                self, force=self.force * np.exp(-velocity), measured_force=self.recorded_force,
                log_c_e=self.log_c_e + velocity, pressed_log_c_e=self.pressed_log_c_e + pressed,
                pressed_depth=self.pressed_depth * np.exp(pressed / self.force_exponent),
            )  # fmt: skip
        if offset == "force":
            return replace(
                moved,
                force=self.force + velocity * np.exp(-self.log_c_e),
                pressed=self.pressed + pressed,
                measured_force=self.recorded_force,
            )
        if offset == "radius":
            R = np.round(self.radius + velocity, _DIGITS)
            return replace(
                moved, radius=R, window_end=np.minimum(end, R), pressed_radius=self.pressed_radius + pressed
            )
        return replace(
            moved, window_start=np.maximum(np.round(start + velocity, _DIGITS), 0.0),
            window_end=np.minimum(np.round(end + velocity, _DIGITS), self.radius),
            pressed_depth=self.pressed_depth + pressed * np.exp(self.pressed_log_c_e / self.force_exponent),
        )  # fmt: skip

    def taken(self, velocity: Rows, pressed: Rows, *, run: Rows, groups: tuple[Group, ...]) -> "Observations":
        """Some rows, which may come more than once, with other runs and groups; `rows` stays."""
        columns: dict[str, Any] = {name: getattr(self, name)[velocity] for name in _VELOCITY}
        columns |= {name: getattr(self, name)[pressed] for name in _PRESSED} | {"run": run}
        return replace(
            self, **columns, groups=groups, measured_force=self.recorded_force[velocity],
            log_c_e=np.broadcast_to(self.log_c_e, self.force.shape)[velocity],
            pressed_log_c_e=np.broadcast_to(self.pressed_log_c_e, self.pressed.shape)[pressed],
            sets=replace(self.sets, velocity=self.sets.velocity[velocity], pressed=self.sets.pressed[pressed]),
        )._checked()  # fmt: skip

    def kept(self, keep: NDArray[np.bool_]) -> "Observations":
        """Those velocity rows only; ValueError if they are too few for a fit. `rows` stays."""
        runs = np.unique(self.run[keep & (self.run >= 0)])
        return self.taken(
            np.flatnonzero(keep),
            np.arange(len(self.pressed)),
            run=np.where(self.run >= 0, np.searchsorted(runs, self.run), -1)[keep],
            groups=tuple(replace(group, velocity=group.velocity[keep]) for group in self.groups),
        )

    def by_window(self) -> dict[tuple[float | None, float | None], Rows]:
        """Velocity rows by window in radii; (None, None) is the default window."""
        windows: dict[tuple[float | None, float | None], list[int]] = {}
        ends = zip(self.window_start / self.radius, self.window_end / self.radius, strict=True)
        for row, (start, end) in enumerate(ends):
            key = (None, None) if np.isnan(start) else (float(start), float(end))
            windows.setdefault(key, []).append(row)
        return {key: np.array(rows, dtype=np.intp) for key, rows in windows.items()}

    def with_runs(self, force: float, velocity: float, radius: float, n: int) -> "Observations":
        """These rows and n runs alike, in the default window; without groups."""
        new = {"force": force, "velocity": velocity, "radius": radius, "run": -1}
        columns: dict[str, Any] = {
            name: np.append(getattr(self, name), [new.get(name, np.nan)] * n) for name in _VELOCITY
        }
        return replace(self, groups=(), measured_force=None, log_c_e=0.0, **columns)

    def c_e_bounds(self) -> Floats:
        """Lower bound of c_e [N/mm^2] that each velocity row's window implies.

        Static contact alone sinks the burr to H = R phi^(2/3). A window needs a deeper end H_end, so
        c_e > F/(R^2 (H_end/R)^q): F/(0.1925 R^2) for q = 3/2 and the default end R/3 (docs/model.md, section 5 iv).
        """
        return self.eased * _static_c_e(self.force, self.window_end, self.radius, self.force_exponent)

    @property
    def c_e_floor(self) -> float:
        """Lower bound of c_e [N/mm^2] that all windows together imply."""
        return float(self.c_e_bounds().max())

    @property
    def bounding_force(self) -> float:
        """Force [N] of the row whose window sets that bound."""
        return float(self.force[np.argmax(self.c_e_bounds())])

    @property
    def ceiling(self) -> float:
        """Upper bound of c_e [N/mm^2] that the overloaded rows imply."""
        F, end, R = self.overloaded
        bounds = _static_c_e(F, end, R, self.force_exponent)
        return float(bounds.min(initial=np.inf)) if self.raised is None else self.raised

    def ridge_entries(self) -> Floats:
        """c_e [N/mm^2] above which each window starts deeper than static contact (default: phi < 0.068).

        There v is a power law of phi and only alpha/c_e^p is determined (docs/model.md, section 5 iii).
        """
        with np.errstate(divide="ignore"):
            return self.force / (self.radius**2 * (self.window[0] / self.radius) ** self.force_exponent)


def _groups(
    data: Sequence[Data], rows: Sequence[tuple[str, Rows]], names: Sequence[str] | None
) -> tuple[Group, ...]:
    """The groups of the rows; ValueError if a data set lacks one, or two of them are one."""
    named = list(dict.fromkeys(name for data_set in data for name in data_set.groups))
    for name in names or ():
        refuse(
            name not in named,
            f"groups may be of {', '.join(named) or 'none, as the data have none'}: got {name!r}",
        )
    groups: list[Group] = []
    for name in named if names is None else names:
        labels: dict[str, list[str]] = {"velocity": [], "pressed": []}
        for i, (data_set, (kind, places)) in enumerate(zip(data, rows, strict=True), start=1):
            refuse(
                name not in data_set.groups,
                f"data set {i} has no {name}, which others have: label all or none",
            )
            column = np.array(data_set.groups[name])
            if isinstance(data_set, VelocityCurve):
                column = column[data_set.ok]
            labels[kind] += np.broadcast_to(column, len(places)).tolist()
        levels = tuple(dict.fromkeys([*labels["velocity"], *labels["pressed"]]))
        group = Group(
            name,
            levels,
            *(np.array([levels.index(x) for x in column], np.intp) for column in labels.values()),
        )
        for other in groups if levels else ():
            pairs = group.pairs(other)
            first, second = min(pairs)
            refuse(
                1 < len(levels) == len(other.levels) == len(pairs),
                f"{name} and {other.name} cannot be told apart: each {name} has one {other.name} ({name} "
                f"{levels[first]} has {other.name} {other.levels[second]}); leave one out by groups=('{name}',)",
            )
        groups.append(group)
    return tuple(groups)


def _static_c_e(force: Floats, end: Floats, radius: Floats | float, force_exponent: float) -> Floats:
    """c_e [N/mm^2] at which static contact alone ends at `end` [mm], NaN for R/3."""
    return np.asarray(
        force / (radius**2 * np.where(np.isnan(end), WINDOW_STOP, end / radius) ** force_exponent)
    )


def _radius(data: Data, burr: Burr | None) -> float:
    if burr is not None and data.radius not in (None, burr.radius):
        raise ValueError(
            f"the {'curve' if isinstance(data, VelocityCurve) else 'data set'} was taken with a burr of radius "
            f"{data.radius:g} mm, the fit is for {burr.radius:g} mm"
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
    hard = observations.c_e_floor * (1 + _MARGIN)
    ceiling = observations.ceiling * (1 - _MARGIN)

    box = {"c_e": (min(hard, ceiling), min(C_E_RANGE * hard, ceiling)), "alpha": ALPHA_BOUNDS}
    for name, pair in (bounds or {}).items():
        low, high = map(float, pair)
        refuse(
            name == "c_e" and high <= hard,
            f"c_e is bounded at {high:g} N/mm^2, but the window at {observations.bounding_force:g} N "
            f"needs c_e > {hard:g} N/mm^2",
        )
        refuse(
            name == "c_e" and low >= ceiling,
            f"bounds of c_e begin at {low:g} N/mm^2, but an 'overloaded' run needs c_e < {ceiling:g} N/mm^2",
        )
        box[name] = (max(low, hard), min(high, ceiling)) if name == "c_e" else (low, high)
    return Box(*zip(box["c_e"], box["alpha"], strict=True))
