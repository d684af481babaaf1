"""Days and specimens: what differs between groups of rows, and how little is then known of the material.

Near a fit the residuals r of all rows are linear in the step d = (d log c_e, d log alpha) and in the effects u of
the groups,

    r = - J d - Z u + e,   u ~ N(0, tau^2),   e ~ N(0, sigma^2),

where J are the derivatives of the residuals. A day shifts log alpha of its rows, a specimen log c_e and log alpha:
the columns of Z are those of J in the group's rows and 0 elsewhere. The variances are estimated by REML.

References
----------
Patterson and Thompson, Recovery of inter-block information when block sizes are unequal, Biometrika 58 (1971).
Lindstrom and Bates, Nonlinear mixed effects models for repeated measures data, Biometrics 46 (1990).
Kenward and Roger, Small sample inference for fixed effects from restricted maximum likelihood, Biometrics 53 (1997).
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy import special

from burrlab.common.table import by_value
from burrlab.fitting.calibration import GroupCalibration, RowScatter
from burrlab.fitting.likelihood import MODEL_ERROR, AlphaSlices, Likelihood, Model
from burrlab.fitting.observations import Floats, Group, Observations, Rows
from burrlab.fitting.profile import ALPHA, Combination, Interval

_ROUNDS = 30  # of linearising and REML, at most; 4 are usual
_CLOSE = 1e-8  # step in log c_e and log alpha that ends them
_RIDGE = 1e-10  # of the information's trace, added to it: along a ridge it has one direction alone
_WIDEST = 1e3  # standard deviation of a logarithm beyond which an interval is open
_WEIGHTS = 64  # nodes over the distribution of the scatter, in the interval of a standard deviation


@dataclass(frozen=True)
class Component:
    """One quantity that differs between the levels of a group: a column of J, by level."""

    group: Group
    column: int  # of J: 0 log c_e, 1 log alpha

    @property
    def name(self) -> str:
        return f"{self.group.name}, {('c_e', 'alpha')[self.column]}"


def components_of(observations: Observations) -> tuple[Component, ...]:
    """What differs between the groups: alpha by day; c_e, from three specimens on, and alpha by specimen.

    A group of one level tells nothing, as does one with a level for every run.
    """
    components = []
    for group in observations.groups:
        n_levels, n_rows = (
            len(group.levels),
            len(set(zip(group.velocity.tolist(), observations.run_number, strict=True))),
        )
        if group.name == "specimen" and n_levels > 2:
            components.append(Component(group, 0))
        if 1 < n_levels < n_rows:
            components.append(Component(group, 1))
    return tuple(components)


class _LinearModel:
    """The rows of a likelihood near a point, as cross products of [Z, J, r] for each scatter."""

    def __init__(
        self, likelihood: "Likelihood", components: Sequence[Component], point: tuple[float, float]
    ) -> None:
        self.rows = likelihood.linear_rows(*point)
        self.names = [rows.name for rows in self.rows]
        self.known = np.array([rows.known for rows in self.rows])
        self.n = np.array([float(rows.n) for rows in self.rows])
        self.columns = [
            np.column_stack([_effects(rows.J, rows.place, components), rows.J, rows.r]) for rows in self.rows
        ]
        self.products = [columns.T @ columns for columns in self.columns]
        sizes = [len(component.group.levels) for component in components]
        ends = np.cumsum([0, *sizes]).tolist()
        self.blocks = [slice(begin, end) for begin, end in itertools.pairwise(ends)]
        self.n_random = ends[-1]


def _effects(J: Floats, place: Mapping[str, Rows], components: Sequence[Component]) -> Floats:
    """Z: a column for each level of each component."""
    columns = [
        J[:, [component.column]]
        * (place[component.group.name][:, None] == np.arange(len(component.group.levels)))
        for component in components
    ]
    return np.concatenate([np.empty((len(J), 0)), *columns], axis=1)


class _Equations:
    """The mixed model's equations at given variances (Henderson's).

    With S the rows' scatter, W = [Z, J] and D the effects' variances, M = (W' S^-1 W + D^-1)^-1 and
    P = S^-1 - S^-1 W M W' S^-1. All products are of the size of W' W, however many rows there are.
    """

    def __init__(self, model: _LinearModel, scatter2: Floats, effect2: Floats) -> None:
        self.model, self.scatter2, self.effect2 = model, scatter2, effect2
        size, q = len(model.products[0]) - 1, model.n_random
        self.by_scatter = [G[:-1, :-1] / s2**2 for G, s2 in zip(model.products, scatter2, strict=True)]
        self.C = np.asarray(sum(G * s2 for G, s2 in zip(self.by_scatter, scatter2, strict=True)))
        self.c = np.asarray(sum(G[:-1, -1] / s2 for G, s2 in zip(model.products, scatter2, strict=True)))
        scale = np.ones(size)
        for block, variance in zip(model.blocks, effect2, strict=True):
            scale[block] = np.sqrt(variance)
        H = scale[:, None] * self.C * scale
        H[np.arange(q), np.arange(q)] += 1.0
        fixed = np.arange(q, size)
        H[fixed, fixed] += _RIDGE * np.trace(H[q:, q:])
        self.log_determinant = float(np.linalg.slogdet(H)[1])  # |V| |J' V^-1 J| over that of S
        self.log_determinant_random = float(np.linalg.slogdet(H[:q, :q])[1])  # |V| over that of S
        self.M = scale[:, None] * np.linalg.inv(H) * scale
        self.solution = self.M @ self.c  # minus the effects, then minus the step
        total = sum(G[-1, -1] / s2 for G, s2 in zip(model.products, scatter2, strict=True))
        self.squares = float(total - self.c @ self.solution)  # r' P r

    def criterion(self, restricted: bool = True) -> float:
        """-2 log of the restricted likelihood, or of the likelihood, without constants."""
        determinant = self.log_determinant if restricted else self.log_determinant_random
        return float(self.model.n @ np.log(self.scatter2)) + determinant + self.squares

    @cached_property
    def WPW(self) -> Floats:
        return np.asarray(self.C - self.C @ self.M @ self.C)

    @cached_property
    def free(self) -> list[int]:
        """Scatters whose size is estimated."""
        return np.flatnonzero(~self.model.known).tolist()

    def score(self) -> Floats:
        """Derivative of the criterion by each estimated variance: the scatters', then the effects'."""
        b, q = self.solution, self.c - self.C @ self.solution
        slopes = []
        for k in self.free:
            G, s2 = self.model.products[k], self.scatter2[k]
            residual = G[-1, -1] - 2 * G[:-1, -1] @ b + b @ G[:-1, :-1] @ b
            slopes.append(self.model.n[k] / s2 - np.sum(self.M * self.by_scatter[k]) - residual / s2**2)
        slopes += [np.trace(self.WPW[block, block]) - q[block] @ q[block] for block in self.model.blocks]
        return np.array(slopes)

    def uncertainty(self) -> "GroupCalibration":
        """The covariance of the step, and how it varies with the variances, by Kenward and Roger."""
        M, G, blocks = self.M, self.by_scatter, self.model.blocks
        m, rest = M[:, self.model.n_random :], np.eye(len(M)) - M @ self.C  # V^-1 J Phi = S^-1 W m
        weights = [(self.C @ m)[block] for block in blocks]
        changes = [m.T @ G[k] @ m for k in self.free] + [a.T @ a for a in weights]  # of Phi by each variance
        size = len(changes)
        information, bias = np.zeros((size, size)), np.zeros((size, size, 2, 2))
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
        Phi = M[self.model.n_random :, self.model.n_random :]
        adjusted = Phi + 2 * np.einsum("ij,ijkl->kl", covariance, bias)
        return GroupCalibration(Phi, (adjusted + adjusted.T) / 2, np.array(changes), covariance)


def _reml(model: _LinearModel) -> _Equations:
    """The equations at the variances of the highest restricted likelihood.

    It is sought from all scatter within groups, and from as much between them as the rows show.
    """
    free, n_effects = np.flatnonzero(~model.known), len(model.blocks)
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
    unit = within[0]  # of the effects' variances, which lie between 0 and many times it

    def equations(x: Floats) -> _Equations:
        scatter2 = np.ones(len(whole))
        scatter2[free] = np.exp(x[: len(free)])
        return _Equations(model, scatter2, unit * x[len(free) :])

    def height(x: Floats) -> tuple[float, Floats]:
        at = equations(x)
        return at.criterion(), at.score() * np.append(at.scatter2[free], np.full(n_effects, unit))

    bounds = [(2 * np.log(MODEL_ERROR), np.log(whole[k]) + 5) for k in free] + [(0.0, 1e6)] * n_effects
    ends = [
        scipy.optimize.minimize(
            height, np.append(np.log(scatter2[free]), np.full(n_effects, between / unit)), jac=True, bounds=bounds,
            method="L-BFGS-B", options={"ftol": 1e-13, "gtol": 1e-7},
        )
        for scatter2, between in ((whole, 0.5 * unit), (within, max(whole.max() - within.max(), 0.1 * unit)))
    ]  # fmt: skip
    return equations(min(ends, key=lambda end: float(end.fun)).x)


def at_best_variances(
    likelihood: Likelihood,
    components: Sequence[Component],
    point: tuple[float, float],
    c_e: tuple[float, float],
) -> tuple["GroupLikelihood", tuple[float, float]]:
    """The likelihood at the best variances, and its best point (c_e, alpha) near a point; `c_e` bounds it."""
    for _ in range(_ROUNDS):
        equations = _reml(_LinearModel(likelihood, components, point))
        step = np.clip(-equations.solution[equations.model.n_random :], -0.5, 0.5)
        last, point = (
            point,
            (float(np.clip(point[0] * np.exp(step[0]), *c_e)), float(point[1] * np.exp(step[1]))),
        )
        if np.abs(np.log(np.divide(point, last))).max() < _CLOSE:
            break
    return GroupLikelihood(likelihood, components, point, equations.scatter2, equations.effect2), point


class GroupLikelihood(Likelihood):
    """-2 log L of rows that share the effects of their groups, at given variances; see `Likelihood`.

    Parameters
    ----------
    plain : Likelihood
        Of the same rows.
    components : sequence of Component
    point : (c_e, alpha)
        Where the effects' columns are taken [N/mm^2], [1/ms].
    scatter2, effect2 : ndarray
        The variances: of each scatter, of each component.
    """

    def __init__(
        self, plain: Likelihood, components: Sequence[Component], point: tuple[float, float],
        scatter2: Floats, effect2: Floats,
    ) -> None:  # fmt: skip
        super().__init__(plain.observations, plain.kind, plain.model)
        self.components, self.point = tuple(components), point
        self.equations = _Equations(_LinearModel(plain, components, point), scatter2, effect2)
        model, q = self.equations.model, self.equations.model.n_random
        root = np.concatenate([np.full(block.stop - block.start, np.sqrt(variance))
                               for block, variance in zip(model.blocks, effect2, strict=True)])  # fmt: skip
        inner = root[:, None] * self.equations.C[:q, :q] * root + np.eye(q)
        self._inner = root[:, None] * np.linalg.inv(inner) * root
        self._Z = [columns[:, :q] / s2 for columns, s2 in zip(model.columns, scatter2, strict=True)]

    def at(self, c_e: ArrayLike) -> AlphaSlices:
        """See `Likelihood`; a parabola over log alpha at each c_e."""
        stiffness = np.atleast_1d(np.asarray(c_e, dtype=np.float64))
        of_r, of_both, of_alpha, r_random, alpha_random = 0.0, 0.0, 0.0, 0.0, 0.0
        tables = zip(self.residuals(stiffness, 1.0), self.equations.model.rows, self._Z, self.equations.scatter2,
                     strict=True)  # fmt: skip
        for (_, _, r, _), rows, Z, s2 in tables:
            slope = rows.J[:, 1]
            of_r = of_r + np.sum(r**2, axis=-1) / s2
            of_both = of_both + r @ slope / s2
            of_alpha += slope @ slope / s2
            r_random = r_random + r @ Z
            alpha_random = alpha_random + slope @ Z
        of_r = of_r - np.einsum("ij,jk,ik->i", r_random, self._inner, r_random)
        of_both = of_both - r_random @ self._inner @ alpha_random
        of_alpha = of_alpha - alpha_random @ self._inner @ alpha_random
        B = np.full(len(stiffness), of_alpha)
        m = -of_both / B
        return AlphaSlices(stiffness, of_r - B * m**2, B, m, np.zeros(len(B)), self.n, True, 0.0, True)

    def objective(self, c_e: float, alpha: float) -> float:
        """See `Likelihood`: the weighted sum of squares."""
        return float(self.at(c_e).minus2(alpha)[0])

    def of_rows(self, observations: Observations, model: Model) -> Likelihood:
        """See `Likelihood`; at the same variances."""
        plain = super().of_rows(observations, model)
        groups = {group.name: group for group in observations.groups}
        components = [Component(groups[x.group.name], x.column) for x in self.components]
        return GroupLikelihood(plain, components, self.point, self.equations.scatter2, self.equations.effect2)

    def calibration(self, c_e: float, alpha: float) -> GroupCalibration:
        """See `Likelihood`."""
        return self.equations.uncertainty()

    def about_curves(self, c_e: float, alpha: float) -> tuple[Floats, Floats]:
        """See `Likelihood`; the effects count as parameters."""
        rows = self.equations.model.columns[0][: len(self._single)]
        J, r = rows[:, :-1], rows[:, -1]
        return J, np.asarray(r - J @ (np.linalg.pinv(J, rcond=1e-6) @ r))

    def information(self, c_e: float, alpha: float) -> tuple[Floats, tuple[RowScatter, ...], Floats]:
        """See `Likelihood`."""
        equations, model = self.equations, self.equations.model
        total = np.asarray(np.linalg.pinv(equations.M[model.n_random :, model.n_random :]), np.float64)
        scatters = [
            RowScatter(rows.name, rows.n, rows.known, 0.0, 1.0 if rows.known else float(np.sqrt(s2)))
            for rows, s2 in zip(model.rows, equations.scatter2, strict=True)
        ]
        return total, tuple(scatters), total[None]

    def log_likelihood(self, c_e: float, alpha: float) -> float:
        """See `Likelihood`: at the variances of the highest likelihood, not the restricted one."""
        model = self.equations.model
        free = np.flatnonzero(~model.known)

        def height(x: Floats) -> float:
            scatter2 = self.equations.scatter2.copy()
            scatter2[free] = np.exp(x[: len(free)])
            return _Equations(model, scatter2, np.square(x[len(free) :])).criterion(restricted=False)

        begin = np.append(np.log(self.equations.scatter2[free]), np.sqrt(self.equations.effect2))
        best = scipy.optimize.minimize(
            height, begin, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-8}
        )
        constants = super().log_likelihood(c_e, alpha)
        for rows in model.rows:  # of the plain likelihood, without its scatter
            S, n = float(rows.r @ rows.r), rows.n
            constants += 0.5 * (S if rows.known else n * float(np.log(S / n + 1e-30) + 1))
        return constants - 0.5 * float(best.fun)


@dataclass(frozen=True)
class GroupEffect:
    """What differs between the levels of a group.

    Attributes
    ----------
    group, quantity : str
        Such as "day" and "alpha".
    levels : tuple of str
    deviation : float
        Standard deviation of ln of the quantity between levels: 0.1 is about 10 %.
    interval : Interval
        Its 95 % interval; the lower end is 0 where the data allow no difference.
    values, errors : tuple of float
        Of each level: ln of its quantity over the population's, drawn towards 0, and its standard error.
    """

    group: str
    quantity: str
    levels: tuple[str, ...]
    deviation: float
    interval: Interval
    values: tuple[float, ...]
    errors: tuple[float, ...]


@by_value
@dataclass(frozen=True)
class GroupEvidence:
    """The effects of groups in a fit, and the uncertainty of c_e and alpha that they leave."""

    effects: tuple[GroupEffect, ...]
    scatter2: Floats  #: variance of each scatter
    calibration: GroupCalibration

    @classmethod
    def of(cls, likelihood: GroupLikelihood) -> "GroupEvidence":
        """At the variances of a likelihood."""
        equations, effects = likelihood.equations, []
        values, M = -equations.solution, equations.M
        for component, block, variance in zip(
            likelihood.components, equations.model.blocks, equations.effect2, strict=True
        ):
            effects.append(GroupEffect(
                component.group.name, ("c_e", "alpha")[component.column], component.group.levels, float(np.sqrt(variance)),
                _deviation_interval(equations, block), tuple(values[block].tolist()),
                tuple(np.sqrt(np.diag(M)[block]).tolist()),
            ))  # fmt: skip
        return cls(tuple(effects), equations.scatter2, equations.uncertainty())

    def likelihood(self, plain: Likelihood, point: tuple[float, float]) -> GroupLikelihood:
        """The likelihood of a fit at a point."""
        groups = {group.name: group for group in plain.observations.groups}
        components = [Component(groups[x.group], ("c_e", "alpha").index(x.quantity)) for x in self.effects]
        effect2 = np.array([x.deviation**2 for x in self.effects])
        return GroupLikelihood(plain, components, point, self.scatter2, effect2)


def group_sentences(o: Observations, grouped: GroupEvidence | None, identified: Combination) -> list[str]:
    """What the groups tell, in plain words, and what they cannot tell."""
    sentences, effects = [], grouped.effects if grouped else ()
    for group in o.groups:
        n_levels, differs = len(group.levels), [x for x in effects if x.group == group.name]
        if differs:
            texts = [
                f"{x.quantity} differs by {100 * x.deviation:.2g} % ({_span(x.interval)})" for x in differs
            ]
            sentences.append(f"Between the {n_levels} {group.name}s {' and '.join(texts)}.")
        elif n_levels == 1:
            sentences.append(
                f"All runs are of one {group.name}: nothing here tells the {group.name} from the bone."
            )
        else:
            sentences.append(
                f"Each run has a {group.name} of its own: nothing tells the {group.name}s from the scatter."
            )
        if group.name == "specimen" and n_levels == 2:
            sentences.append("Whether c_e differs between specimens cannot be known from fewer than three.")
    if grouped:
        direction = np.array([-identified.exponent, 1.0])
        of_alpha, best = (grouped.calibration.freedom(d) for d in (ALPHA, direction))
        sentences.append(
            f"The interval of alpha rests on {of_alpha:.2g} degrees of freedom, that of alpha/c_e^{identified.exponent:.3g} "
            f"on {best:.2g}."
        )
    return sentences


def _span(interval: Interval) -> str:
    assert interval.lower is not None
    low = f"{100 * interval.lower:.2g}"
    return f"{low} % up" if interval.upper is None else f"{low} to {100 * interval.upper:.2g} %"


def _deviation_interval(equations: _Equations, block: slice) -> Interval:
    """95 % interval of a standard deviation between levels, by a generalised pivot.

    Beside all other effects as parameters, the level's part of the rows is u ~ N(0, sigma^2 + tau^2 lambda_i), and
    the rest S ~ sigma^2 chi^2_f. The pivot solves sum u_i^2/(sigma^2 + tau^2 lambda_i) = chi^2_k, with sigma^2 =
    S/chi^2_f.

    References
    ----------
    Weerahandi, Generalized confidence intervals, J. Am. Stat. Assoc. 88 (1993).
    """
    columns = np.concatenate(
        [c / np.sqrt(s2) for c, s2 in zip(equations.model.columns, equations.scatter2, strict=True)]
    )
    Z, r = columns[:, block], columns[:, -1]
    others = np.delete(columns[:, :-1], np.arange(columns.shape[1] - 1)[block], axis=1)
    U, s, _ = np.linalg.svd(others, full_matrices=False)
    basis = U[:, s > 1e-6 * s[0]]
    Z, r = Z - basis @ (basis.T @ Z), r - basis @ (basis.T @ r)
    U, s, _ = np.linalg.svd(Z, full_matrices=False)
    used = s > 1e-6 * max(s[0], 1e-12)
    u2, size = (U[:, used].T @ r) ** 2, s[used] ** 2
    S = float(r @ r - u2.sum())
    freedom = int(equations.model.n.sum()) - basis.shape[1] - int(used.sum())
    if not len(u2) or freedom < 1:
        return Interval(0.0, None)
    chi2 = special.chdtri(freedom, (np.arange(_WEIGHTS) + 0.5) / _WEIGHTS)

    def below(deviation: float) -> float:
        """Probability that the pivot lies below."""
        shares = u2 / (S / chi2[:, None] + deviation**2 * size)
        return float(np.mean(special.chdtrc(len(u2), shares.sum(axis=1))))

    def end(p: float) -> float | None:
        if below(0.0) >= p:
            return 0.0
        high = 1.0
        while below(high) < p:
            if high > _WIDEST:
                return None
            high *= 2
        return float(scipy.optimize.brentq(lambda x: below(x) - p, 0.0, high))

    return Interval(end(0.025), end(0.975))
