"""Rows that share effects, linear near a point: their cross products, the mixed model's equations, and REML.

Near a fit the residuals r of all rows are linear in the step d = (d log c_e, d log alpha) and in effects u,

    r = - J d - Z u + e,   u ~ N(0, tau^2),   e ~ N(0, sigma^2),

where J are the derivatives of the residuals. A day shifts log alpha of its rows, a specimen log c_e and log alpha:
the columns of Z are those of J in the rows of a level and 0 elsewhere. An offset is the true less the measured
force, depth (the surface) or radius: its columns are the derivatives of the residuals by it. tau
is estimated by REML, or given; it is large for an offset that the fit estimates as a parameter.

References
----------
Patterson and Thompson, Recovery of inter-block information when block sizes are unequal, Biometrika 58 (1971).
Kenward and Roger, Small sample inference for fixed effects from restricted maximum likelihood, Biometrics 53 (1997).
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab.common.check import nearest, real, refuse, shown
from burrlab.fitting.calibration import MixedCalibration
from burrlab.fitting.likelihood import MODEL_ERROR, Likelihood, LinearRows
from burrlab.fitting.observations import Floats, Group, Observations, Rows

#: Standard deviation of an offset, and its group
Uncertain: TypeAlias = Mapping[str, float | tuple[float, str]]
#: Offsets, and their units
OFFSETS = {"force": "N", "surface": "mm", "radius": "mm"}
OWN = 3.0  # standard deviation of ln c_e or ln alpha of data sets that have one each: a factor of 20 (ours)
_DIAGONAL = 1e-10  # of the information's trace, added to its diagonal: on a ridge it is singular
EDGE = 1e-4  # relative distance of c_e from the bound that a window sets
EACH = "each "  # before the name of a group, of a drift that begins anew with each of its labels
STEP = 0.005  # in radii or least forces: rows are moved by multiples of it, so that equal windows recur
_REACH = 3.6  # standard deviations of an offset, over which it is differenced and taken in parts
_SCORINGS = 30  # of variances, at most
_LARGEST = 10.0  # standard deviation of a logarithm, at most: what differs more is not of one law
_CLOSE, _SHORT = 0.05, 1e-8  # relative steps that are judged by the slope, and that end the scoring
_LEAST = 1e-3  # mean square of pairs over that of rows
_APART = 1e-6  # information on what the rows tell worst over that on what they tell best, at least
_PART, _WIDE = 1e-3, 0.3  # of each force and pressed depth: least and largest step of their differences


@dataclass(frozen=True, eq=False)
class Component:
    """One quantity that differs between the levels of a group, and their standard deviation where it is given.

    `sought`: the fit estimates it as a parameter: an offset of one level, or c_e or alpha of data sets.
    """

    group: Group
    quantity: str  # "c_e", "alpha", "order" or an offset
    deviation: float | None = None
    sought: bool = False
    varies: bool = False  # of a pair: how the difference of two sets varies; its variance may be below 0

    @property
    def moves(self) -> bool:
        """Whether rows are moved by it, as its effect is not linear; of alpha and days it is."""
        return self.quantity in OFFSETS or self.quantity == "c_e"

    @property
    def restarts(self) -> str:
        """Of a drift that begins anew with each label of a group, the group's name."""
        return self.group.name.removeprefix(EACH) if self.group.name.startswith(EACH) else ""

    @property
    def random_c_e(self) -> bool:
        """Whether each level draws a c_e: a specimen."""
        return self.quantity == "c_e" and not self.sought

    def of_rows(self, o: Observations) -> "Component":
        """The same of other rows."""
        name = self.group.name
        return replace(self, group=_levels_of(o, self.quantity, name) if self.sought else o.by_name[name])


def components_of(
    observations: Observations, uncertain: Uncertain | None = None, estimate: Sequence[str] = ()
) -> tuple[Component, ...]:
    """What differs between the groups, and the offsets.

    alpha differs by day; c_e, from three specimens on, and alpha by specimen. A group of one level tells nothing, as
    does one with a level for every run. "c_e" or "alpha" in `estimate` gives each data set one of its own.
    """
    components = []
    for group in observations.groups:
        n_levels, runs = len(group.levels), observations.run_number.tolist()
        n_rows = len(set(zip(group.velocity.tolist(), runs, strict=True)))
        if group.name == "specimen" and n_levels > 2:
            components.append(Component(group, "c_e"))
        if 1 < n_levels < n_rows:
            components.append(Component(group, "alpha"))
    by_name = observations.by_name
    end = observations.window[1]
    above = float((observations.radius - end).min())
    rooms = {"surface": min(above, float(end.min())) / _REACH, "radius": above / _REACH}
    for name, size in (uncertain or {}).items():
        deviation, by = size if isinstance(size, tuple) else (size, "data set")
        refuse(by not in by_name, f"uncertain of {name}: the data have no group {by!r}{nearest(by, by_name)}")
        components.append(Component(by_name[by], name, float(deviation)))
        room = rooms.get(name, np.inf)
        refuse(
            deviation >= room,
            f"uncertain of {name} must be below {room:.3g} mm, so that windows stay between 0 and R: got {deviation:g}",
        )
    sought = []
    for name, colon, by in (name.partition(":") for name in estimate):
        refuse(
            bool(colon) and by not in by_name,
            f"estimate of {name}: the data have no group {by!r}{nearest(by, by_name)}",
        )
        refuse(
            bool(by) and observations.order(by).max() < 0,
            f"estimate of order: no {by} has two runs, from one to the other of which it could change",
        )
        sought.append((name, EACH + by if by else "data"))
    lengths, force = float(observations.radius.max()) / 10, float(np.median(observations.force)) / 2
    weak = {"force": force, "surface": lengths, "radius": lengths, "order": 1.0, "c_e": OWN, "alpha": OWN}
    return (
        *components,
        *(Component(_levels_of(observations, name, of), name, weak[name], True) for name, of in sought),
    )


def _levels_of(o: Observations, quantity: str, name: str) -> Group:
    """The levels of a parameter: of c_e and alpha the data sets after the first, else one level for all rows."""
    if quantity in ("c_e", "alpha"):  # an indentation has no alpha
        sets = np.unique(o.sets.velocity) if quantity == "alpha" else np.arange(len(o.sets.levels))
        place = np.full(len(o.sets.levels), -1)
        place[sets] = np.arange(len(sets)) - 1
        return Group(
            o.sets.name,
            tuple(o.sets.levels[k] for k in sets[1:]),
            place[o.sets.velocity],
            place[o.sets.pressed],
        )
    return Group(name, ("all",), np.zeros(len(o.force), np.intp), np.zeros(len(o.pressed), np.intp))


def check_names(option: str, names: Sequence[str], example: str) -> None:
    """TypeError unless an option is a sequence of names, and no text."""
    refuse(
        isinstance(names, str) or not isinstance(names, Sequence),
        f"{option} must be a sequence such as ('{example}',), got {shown(names)}",
        TypeError,
    )


def check_offsets(uncertain: Uncertain | None, estimate: Sequence[str]) -> None:
    """Refuse `uncertain` and `estimate` unless they name offsets, each once, with positive sizes."""
    if not isinstance(uncertain, (dict, type(None))):
        raise TypeError(f"uncertain must be a dict such as {{'surface': 0.05}}, got {shown(uncertain)}")
    check_names("estimate", estimate, "force")
    for name, size in (uncertain or {}).items():
        refuse(
            name not in OFFSETS,
            f"uncertain may hold {', '.join(OFFSETS)}: got {name!r}{nearest(name, OFFSETS)}",
        )
        pair = isinstance(size, tuple) and len(size) == 2 and isinstance(size[1], str)
        deviation = real(size[0] if pair else size, f"uncertain of {name}")
        refuse(
            deviation.shape != () or not 0 < deviation < np.inf,
            f"uncertain of {name} must be a standard deviation above 0 [{OFFSETS[name]}], or such a one and the name of "
            f"a group: got {shown(size)}",
        )
    names = ["force", "radius", "order"]
    sought = [name.partition(":")[0] if name.startswith("order:") else name for name in map(str, estimate)]
    for name in sought:
        refuse(
            name == "surface",
            "data cannot tell a surface: say how far it may be off, uncertain={'surface': 0.1}",
        )
        refuse(name not in names, f"estimate may hold {', '.join(names)}: got {name!r}{nearest(name, names)}")
        refuse(
            name in (uncertain or {}) or sought.count(name) > 1,
            f"an offset is uncertain or estimated, and once: got {name!r} twice",
        )


def moved_rows(o: Observations, components: Sequence[Component], shifts: Floats) -> Observations:
    """The rows as they would be with some offsets; `shifts` has a number for each level."""
    for component, block in zip(components, blocks_of(components), strict=True):
        u = np.append(shifts[block], 0.0)  # a level of -1 has none
        if component.moves and u.any():
            o = o.moved(component.quantity, u[component.group.velocity], u[component.group.pressed])
    return o


def moved_by(likelihood: Likelihood, components: Sequence[Component], shifts: Floats) -> Likelihood:
    """The likelihood of the rows that `moved_rows` gives."""
    o = moved_rows(likelihood.observations, components, shifts)
    return likelihood if o is likelihood.observations else likelihood.of_rows(o)


def blocks_of(components: Sequence[Component]) -> list[slice]:
    """Which columns of Z are those of each component."""
    ends = np.cumsum([0, *(len(component.group.levels) for component in components)]).tolist()
    return [slice(begin, end) for begin, end in itertools.pairwise(ends)]


@dataclass(eq=False)
class RowProducts:
    """Cross products of [Z, J, r] for each scatter, and whose columns they are."""

    products: list[Floats]
    n: Floats  # rows of each scatter
    known: NDArray[np.bool_]  # whether its size is
    components: Sequence[Component]
    n_fixed: int = 2  # columns of J

    @cached_property
    def blocks(self) -> list[slice]:
        """Columns of each component."""
        return blocks_of(self.components)

    @cached_property
    def estimated(self) -> list[int]:
        """Components whose standard deviation is estimated."""
        return [k for k, component in enumerate(self.components) if component.deviation is None]

    @cached_property
    def effect2(self) -> Floats:
        """Variance of the others."""
        return np.array([np.square(component.deviation or 0.0) for component in self.components])


class LinearModel(RowProducts):
    """The rows of a likelihood near a point, as cross products of [Z, J, r] for each scatter.

    The rows are as they would be with the offsets of `shifts`; r is extrapolated from there to no offset.
    """

    def __init__(
        self,
        likelihood: Likelihood,
        components: Sequence[Component],
        point: tuple[float, float],
        shifts: Floats,
    ) -> None:
        self.rows = likelihood.linear_rows(*point)
        residuals = [rows.r for rows in self.rows]
        self.slopes = {
            x.quantity: Slopes(likelihood, x.quantity, self.rows, 0.0 if x.sought else x.deviation or 0.0)
            for x in components
            if x.quantity in OFFSETS
        }
        columns = {name: slopes.at(point[0], residuals) for name, slopes in self.slopes.items()}
        columns |= {name: [rows.J[:, k] for rows in self.rows] for k, name in enumerate(("c_e", "alpha"))}
        # of a drift, ln v rises from the first run to the last
        for x in (x for x in components if x.quantity == "order"):
            order = likelihood.observations.order(x.restarts)
            columns["order"] = [
                -order[rows.at] if rows.name == "velocity" else np.zeros(len(rows.r)) for rows in self.rows
            ]
        self.columns = []
        #: which level each row of each scatter has, shape (rows, levels), by component
        self.places = [[_places(x.group, rows) for rows in self.rows] for x in components]
        for k, rows in enumerate(self.rows):
            parts = [
                columns[x.quantity][k][:, None] * at[k] for x, at in zip(components, self.places, strict=True)
            ]
            Z = np.concatenate([np.empty((len(rows.r), 0)), *parts], axis=1)
            self.columns.append(np.column_stack([Z, rows.J, rows.r - Z @ shifts]))
        super().__init__(
            [columns.T @ columns for columns in self.columns],
            np.array([float(rows.n) for rows in self.rows]),
            np.array([rows.known for rows in self.rows]),
            components,
        )


def _places(group: Group, rows: LinearRows) -> Floats:
    """1 where a row has a level, else 0; shape (rows, levels). A level of -1 is none."""
    table = np.zeros((len(rows.r), len(group.levels)))
    place = (group.pressed if rows.name == "force" else group.velocity)[rows.at]
    table[np.flatnonzero(place >= 0), place[place >= 0]] = 1.0
    return table


def slope_of(middle: Floats, up: Floats, down: Floats, step: Floats | float) -> Floats:
    """The central difference over a step to either side; from one side where a window ends on the other."""
    lost = ~np.isfinite(up) | ~np.isfinite(down)
    change = np.where(np.isfinite(up), up, middle) - np.where(np.isfinite(down), down, middle)
    return np.asarray(change / (step * np.where(lost, 1.0, 2.0)))


class Slopes:
    """Derivatives of the residuals by an offset at any c_e, for each scatter, by central differences."""

    def __init__(
        self, likelihood: Likelihood, offset: str, tables: Sequence[LinearRows], deviation: float
    ) -> None:
        o = likelihood.observations
        # over one standard deviation, so that a kink counts as much as the offset meets it
        unit = STEP * o.radius.max()
        windows = unit * max(1.0, float(np.round(deviation / unit)))
        # as measured, not over c_e of their own
        force, depth = (
            o.force * np.exp(o.log_c_e),
            o.pressed_depth * np.exp(-o.pressed_log_c_e / o.force_exponent),
        )
        steps: dict[str, tuple[Floats, Floats]] = {
            "force": (
                np.clip(deviation, _PART * force, _WIDE * force),
                np.clip(deviation, _PART * o.pressed, _WIDE * o.pressed),
            ),
            "surface": (
                np.full(len(o.force), windows),
                np.clip(deviation, _PART * depth, _WIDE * depth),
            ),
            "radius": (np.full(len(o.force), windows), np.full(len(o.pressed), windows)),
        }
        v_steps, p_steps = steps[offset]
        #: with more of it, then with less
        self.beside = [
            likelihood.of_rows(o.moved(offset, sign * v_steps, sign * p_steps)) for sign in (1, -1)
        ]
        self._steps = [
            (p_steps if rows.name == "force" else v_steps)[rows.at] if len(rows.at) else np.ones(len(rows.r))
            for rows in tables
        ]

    def at(
        self, c_e: ArrayLike, residuals: Sequence[Floats], own: tuple[Floats, Floats] | None = None
    ) -> list[Floats]:
        """Of each scatter, shape of c_e and (rows,); `residuals` are those at c_e and alpha = 1."""
        above, below = (beside.residuals(c_e, 1.0, own) for beside in self.beside)
        return [
            slope_of(r, up, down, step)
            for r, step, (_, _, up, _), (_, _, down, _) in zip(
                residuals, self._steps, above, below, strict=True
            )
        ]


class MixedEquations:
    """The mixed model's equations at given variances (Henderson's).

    With S the rows' scatter, W = [Z, J], D the effects' variances, C = W' S^-1 W and c = W' S^-1 r: M = (C + D^-1)^-1,
    P = S^-1 - S^-1 W M W' S^-1. All products are of the size of W' W, however many rows there are.
    """

    def __init__(self, model: RowProducts, scatter2: Floats, effect2: Floats) -> None:
        self.model, self.scatter2, self.effect2 = model, scatter2, effect2
        total = np.asarray(sum(G / s2 for G, s2 in zip(model.products, scatter2, strict=True)))
        self.C, self.c = total[:-1, :-1].copy(), total[:-1, -1].copy()
        self.variance = np.full(len(self.c), np.inf)  # of each column; infinite for c_e and alpha
        for block, variance in zip(model.blocks, effect2, strict=True):
            self.variance[block] = variance
        scale, self._H = self.scaled(self.C, self.variance)
        self.M = scale[:, None] * np.linalg.inv(self._H) * scale
        self.solution = self.M @ self.c  # minus the effects, then minus the step
        self.squares = float(total[-1, -1] - self.c @ self.solution)  # r' P r

    def inverse(
        self, columns: Rows, C: Floats | None = None, variance: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """M of some columns of W, and the matrix that is inverted for it; of other products and variances, if given."""
        scale, H = self.scaled(
            self.C[np.ix_(columns, columns)] if C is None else C,
            self.variance[columns] if variance is None else variance,
        )
        return scale[:, None] * np.linalg.inv(H) * scale, H

    @staticmethod
    def scaled(C: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Standard deviations, 1 of columns without one, and C + D^-1 in their units."""
        random = np.isfinite(variance)
        scale = np.where(random, np.sqrt(np.abs(variance)), 1.0)
        H = scale[:, None] * C * scale
        diagonal = np.einsum("...ii->...i", H)  # a view
        diagonal += np.where(
            random,
            np.where(variance < 0, -1.0, 1.0),
            _DIAGONAL * diagonal[..., ~random].sum(axis=-1, keepdims=True),
        )
        return scale, H

    @property
    def definite(self) -> bool:
        """Whether V is positive definite, and far from singular: H of Z has as many negative eigenvalues as variances.

        In balanced rows the nearest to 0 is the pairs' mean square over that of the rows.
        """
        try:
            eigenvalues = np.linalg.eigvalsh(self.inverse(np.arange(len(self.c) - self.model.n_fixed))[1])
        except np.linalg.LinAlgError:  # a set beside itself: the pairs do not differ at all
            return False
        return bool((eigenvalues < -_LEAST).sum() == (eigenvalues < 0).sum() == (self.variance < 0).sum())

    def criterion(self, restricted: bool = True) -> float:
        """-2 log of the restricted likelihood, or of the likelihood, without constants."""
        H = self._H
        if not restricted:  # |V| over that of S, not |V| |J' V^-1 J|
            random = np.isfinite(self.variance)
            for x, block in zip(self.model.components, self.model.blocks, strict=True):
                random[block] = not x.sought
            H = H[np.ix_(random, random)]
        return float(self.model.n @ np.log(self.scatter2) + np.linalg.slogdet(H)[1]) + self.squares

    @cached_property
    def by_scatter(self) -> list[Floats]:
        """Minus the derivative of C by each squared scatter."""
        return [G[:-1, :-1] / s2**2 for G, s2 in zip(self.model.products, self.scatter2, strict=True)]

    @cached_property
    def WPW(self) -> Floats:
        return np.asarray(self.C - self.C @ self.M @ self.C)

    @cached_property
    def free(self) -> list[int]:
        """Scatters whose size is estimated."""
        return np.flatnonzero(~self.model.known).tolist()

    @cached_property
    def estimated_blocks(self) -> list[slice]:
        """Columns of the effects whose size is estimated."""
        return [self.model.blocks[k] for k in self.model.estimated]

    def residual2(self, k: int) -> float:
        """Squares of the residuals of one scatter, with the effects."""
        G, b = self.model.products[k], np.append(-self.solution, 1.0)
        return float(b @ G @ b)

    def score(self) -> Floats:
        """Derivative of the criterion by each estimated variance: the scatters', then the effects'."""
        q, slopes = self.c - self.C @ self.solution, []
        for k in self.free:
            n, s2 = self.model.n[k], self.scatter2[k]
            slopes.append(n / s2 - np.sum(self.M * self.by_scatter[k]) - self.residual2(k) / s2**2)
        slopes += [np.trace(self.WPW[block, block]) - q[block] @ q[block] for block in self.estimated_blocks]
        return np.array(slopes)

    def squared_moves(self) -> Floats:
        """r' P V_i P V_j P r of the estimated variances, V_i the derivative of the rows' covariance by each.

        Its mean is twice the information, as of the variances' likelihood; less this it is what the rows show of it.
        """
        b, q = self.solution, self.c - self.C @ self.solution
        n_free, size = len(self.free), len(self.free) + len(self.estimated_blocks)
        places, products, inner = np.zeros((size, len(b))), np.zeros((size, len(b))), np.zeros((size, size))
        for i, k in enumerate(self.free):
            G, s2 = self.model.products[k], self.scatter2[k]
            products[i] = (G[:-1, -1] - G[:-1, :-1] @ b) / s2**2
            inner[i, i] = self.residual2(k) / s2**3
        for i, block in enumerate(self.estimated_blocks, start=n_free):
            places[i, block] = q[block]
            products[i] = self.C @ places[i]
        inner[n_free:] = places[n_free:] @ products.T
        inner[:n_free, n_free:] = inner[n_free:, :n_free].T
        return np.asarray(inner - products @ self.M @ products.T)

    def uncertainty(self, columns: Rows | slice | None = None) -> MixedCalibration:
        """The covariance of the step, or of some columns, and how it varies with the variances, by Kenward and Roger."""
        M, G, blocks = self.M, self.by_scatter, self.estimated_blocks
        if columns is None:
            columns = slice(len(M) - self.model.n_fixed, None)
        m, rest = M[:, columns], np.eye(len(M)) - M @ self.C  # V^-1 J Phi = S^-1 W m
        weights = [(self.C @ m)[block] for block in blocks]
        changes = [m.T @ G[k] @ m for k in self.free] + [a.T @ a for a in weights]  # of Phi by each variance
        size = len(changes)
        information, bias = np.zeros((size, size)), np.zeros((size, size, m.shape[1], m.shape[1]))
        for i, k in enumerate(self.free):
            for j, other in enumerate(self.free):
                cross = M @ G[other]
                information[i, j] = np.sum((M @ G[k]) * cross.T)
                bias[i, j] = -m.T @ G[k] @ cross @ m
            own = 1 / self.scatter2[k]
            information[i, i] += own**2 * self.model.n[k] - 2 * own * np.sum(M * G[k])
            bias[i, i] += own * m.T @ G[k] @ m
            for j, block in enumerate(blocks, start=len(self.free)):
                R = rest[:, block]
                information[i, j] = information[j, i] = np.sum(R * (G[k] @ R))
                bias[i, j] = m.T @ G[k] @ R @ weights[j - len(self.free)]
                bias[j, i] = bias[i, j].T
        for i, (first, a) in enumerate(zip(blocks, weights, strict=True), start=len(self.free)):
            for j, (second, b) in enumerate(zip(blocks, weights, strict=True), start=len(self.free)):
                information[i, j] = np.sum(self.WPW[first, second] ** 2)
                bias[i, j] = a.T @ self.WPW[first, second] @ b
        covariance = np.asarray(
            np.linalg.pinv(information / 2, rcond=1e-12, hermitian=True), np.float64
        )  # of the variances
        Phi = m[columns]
        adjusted = Phi + 2 * np.einsum("ij,ijkl->kl", covariance, bias)
        estimated = np.append(self.scatter2[self.free], self.effect2[self.model.estimated])
        # few rows cannot tell days from the scatter
        told_apart = bool((np.linalg.eigvalsh(covariance) > 0).all())
        return MixedCalibration(
            Phi, (adjusted + adjusted.T) / 2, np.reshape(changes, (size, *Phi.shape)), covariance,
            variances=estimated if len(blocks) == 1 and told_apart else None,
        )  # fmt: skip


def reml(model: RowProducts, near: MixedEquations | None = None) -> MixedEquations:
    """The equations at the variances of the highest restricted likelihood.

    The search begins at variances `near` it, or twice: at all scatter within groups, and at the split between and within
    that the rows show.
    """
    if not all(np.isfinite(G).all() for G in model.products):
        raise np.linalg.LinAlgError("a row has no window near this point")
    free, n_effects = np.flatnonzero(~model.known), len(model.estimated)
    if near is not None and len(free) + n_effects:
        return _scored(MixedEquations(model, near.scatter2, near.effect2))
    whole, within = np.ones((2, len(model.n)))
    for k in free:
        G = model.products[k]
        fixed = np.linalg.pinv(G[:-1, :-1], rcond=1e-9, hermitian=True)
        rest = float(G[-1, -1] - G[:-1, -1] @ fixed @ G[:-1, -1])
        freedom = model.n[k] - np.linalg.matrix_rank(
            G[:-1, :-1], tol=1e-9 * np.trace(G[:-1, :-1]), hermitian=True
        )
        whole[k] = max(G[-1, -1] / model.n[k], MODEL_ERROR**2)
        within[k] = max(rest / freedom, MODEL_ERROR**2) if freedom > 0 else whole[k] / 4
    if not len(free) + n_effects:
        return MixedEquations(model, within, model.effect2)
    between = max(whole.max() - within.max(), 0.1 * within[0])
    ends = []
    for scatter2, variance in [(whole, 0.5 * within[0]), (within, between)][0 if n_effects else 1 :]:
        effect2 = model.effect2.copy()
        effect2[model.estimated] = variance
        ends.append(_scored(MixedEquations(model, scatter2, effect2)))
    best = min(ends, key=lambda end: end.criterion())
    below = [x.varies and not best.effect2[k] for k, x in enumerate(model.components)]
    return _scored(best, np.array(below)) if any(below) else best


def _scored(equations: MixedEquations, below: NDArray[np.bool_] | None = None) -> MixedEquations:
    """The equations at the best variances near others; some that are estimated as 0 may be `below` it.

    By Fisher's scoring, and by Newton's steps when close: the information on few groups is not what their rows show.

    The rows' covariance V stays positive definite. Were the variance of the pairs' differences kept at 0, the test of
    their mean would have the rows' degrees of freedom, and find too much; so, in balanced rows, it is the paired t test.
    """
    free, estimated = equations.free, equations.model.estimated
    at_least = np.zeros(len(equations.effect2)) if below is None else np.where(below, -np.inf, 0.0)
    close = False
    for _ in range(_SCORINGS):
        score, at_0 = equations.score(), equations.effect2[estimated] <= at_least[estimated]
        moves = np.append(np.ones(len(free), np.bool_), ~(at_0 & (score[len(free) :] >= 0)))
        last, sizes = equations, np.append(equations.scatter2[free], equations.effect2[estimated])
        step = np.zeros(len(score))
        information = np.linalg.pinv(equations.uncertainty().of_variances, rcond=1e-12)
        if close:
            observed = equations.squared_moves() - information
            if (np.linalg.eigvalsh(observed[np.ix_(moves, moves)]) > 0).all():
                information = observed
        # what the rows cannot tell apart, as c_e and alpha of specimens on a ridge, moves together
        unit = 1 / np.sqrt(np.maximum(np.diag(information)[moves], 1e-300))
        scaled = unit[:, None] * information[np.ix_(moves, moves)] * unit
        step[moves] = (
            -unit * (np.linalg.pinv(scaled, rcond=_APART, hermitian=True) @ (unit * score[moves])) / 2
        )
        # on a ridge rounding shakes the criterion by 1e-2: there the slope along the step tells whether it is too long
        close = bool((np.abs(step) <= _CLOSE * sizes).all())
        parts, shortest = 0.5 ** np.arange(20), _SHORT * sizes[moves].max(initial=0.0)
        for part in parts[parts * np.abs(step).max() > shortest]:
            scatter2, effect2 = last.scatter2.copy(), last.effect2.copy()
            scatter2[free] = np.maximum(scatter2[free] + part * step[: len(free)], MODEL_ERROR**2)
            effect2[estimated] += part * step[len(free) :]
            effect2[estimated] = np.clip(effect2[estimated], at_least[estimated], _LARGEST**2)
            trial = MixedEquations(last.model, scatter2, effect2)
            if close:
                nearer = bool(abs(step @ trial.score()) < abs(step @ score))
            else:
                nearer = trial.criterion() < last.criterion()
            if nearer and (below is None or trial.definite):
                equations = trial
                break
        if equations is last:
            break
    return equations
