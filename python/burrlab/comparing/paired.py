"""Two sets that share days, specimens or offsets, in one mixed model: what they share cancels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import scipy
from scipy import special

from burrlab.common.table import probability_text
from burrlab.fitting.calibration import MixedCalibration
from burrlab.fitting.diagnostics import HypothesisTest
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.linear import (
    EDGE,
    OFFSETS,
    Component,
    LinearModel,
    MixedEquations,
    RowProducts,
    reml,
)
from burrlab.fitting.mixed import MixedLikelihood
from burrlab.fitting.observations import C_E_RANGE, Floats, Group, Observations
from burrlab.fitting.profile import ALPHA, ENDLESS
from burrlab.fitting.record import FitRecord

ERROR = 0.05  # of "differ" and of "equivalent", all pairs together
_ROUNDS = 30  # of linearising, at most
_POINTS = 200  # of c_e, among which the best that two sets have in common is sought
_RARE = 1e-3  # chance of a scatter so small that it is not believed
_NEAR = 0.3  # of its logarithm, within which the best is refined


@dataclass(frozen=True, eq=False)
class LinearDifference:
    """The difference of a quantity between two sets that share effects, second less first."""

    value: float
    error: float
    nu: float

    def ends(self, level: float) -> tuple[float, float]:
        """See `_LogRatio`."""
        half = -float(special.stdtrit(self.nu, (1 - level) / 2)) * self.error
        low, high = self.value - half, self.value + half
        return low if low > -ENDLESS else -np.inf, high if high < ENDLESS else np.inf

    def outside(self, bound: float) -> float:
        """See `_LogRatio`."""
        return float(special.stdtr(self.nu, (abs(self.value) - bound) / self.error))


@dataclass(frozen=True, eq=False)
class Paired:
    """Two sets in one mixed model."""

    group: str
    one_c_e: bool  # whether c_e is common to both, as where a set leaves it open
    change: Floats  # of log c_e and log alpha
    calibration: MixedCalibration
    rise: float  # of the rows' squares where c_e and alpha are common to both
    most_freedom: float = np.inf  # of alpha: 1 of two pairs, which tell their variance too badly for any rule
    allows_one_c_e: bool = False  # though each set has a c_e of its own

    @classmethod
    def of(cls, a: FitRecord, b: FitRecord, shared: Sequence[str]) -> "Paired | None":
        """None where the sets share neither levels nor offsets, or have absolute residuals."""
        common = _common_levels([x.observations for x in (a, b)])
        pairing = [name for name, n_levels in common.items() if n_levels > 1]
        if not (pairing or shared) or not {a.residual_kind, b.residual_kind} <= {"relative", "sigma"}:
            return None
        closed = [x.intervals["c_e"]["95"].closed for x in (a, b)]
        most = 1.0 if max(common.values(), default=0) == 2 else np.inf

        def fitted(one_c_e: bool, alike: bool) -> "Paired":
            likelihoods, points = (a.likelihood, b.likelihood), [(x.c_e, x.alpha) for x in (a, b)]
            jointly = _fitted_jointly(likelihoods, points, shared, one_c_e, alike)
            return cls(" and ".join(pairing), one_c_e, *jointly, most)

        pair = fitted(not all(closed), closed[0] is closed[1])
        # a set alone has another c_e, from a second minimum, but both can have one: there it is as if open
        if pair.far_from_linear and pair.joint.p_value > ERROR:
            return replace(fitted(True, False), allows_one_c_e=True)
        return pair

    def along(self, direction: Floats) -> LinearDifference:
        """The difference of a quantity with a gradient over (log c_e, log alpha)."""
        variance, nu = self.calibration.variance(direction)
        nu = min(nu, self.most_freedom) if direction[1] else nu
        return LinearDifference(float(direction @ self.change), variance**0.5, nu)

    @property
    def far_from_linear(self) -> bool:
        """Whether the squares rise by less than half of what the change and its covariance say."""
        if self.one_c_e:
            return False
        foretold = float(self.change @ np.linalg.solve(self.calibration.covariance, self.change))
        return self.rise < 0.5 * foretold

    @property
    def joint(self) -> HypothesisTest:
        """Whether both sets have one c_e and alpha."""
        if self.one_c_e:
            along = self.along(ALPHA)
            F, freedom = (along.value / along.error) ** 2, (1.0, along.nu)
        else:
            F = self.rise / self.calibration.bias / 2
            freedom = (2.0, min(self.calibration.freedom_of_sum, self.most_freedom))
        p, text = float(special.fdtrc(*freedom, F)), ", ".join(f"{number:.3g}" for number in freedom)
        if not self.one_c_e and self.most_freedom == np.inf:  # at other levels than 5 %, for several pairs
            p = self.calibration.probability_of_sum(2 * F)
        units = f", paired by {self.group}" if self.group else ""
        what = "one alpha, if c_e is one" if self.one_c_e else "one c_e and alpha"
        return HypothesisTest("one material", F, freedom, p, (
            f"The two {'differ' if p < ERROR else 'can be of one material'} ({what}{units}): F({text}) = {F:.3g}, "
            f"{probability_text(p)}."
        ))  # fmt: skip


def joint_model(
    likelihoods: Sequence[Likelihood], points: Sequence[tuple[float, float]], shared: Sequence[str],
    one_c_e: bool = False, alike: bool = True,
) -> RowProducts:  # fmt: skip
    """The rows of two likelihoods that share effects, with c_e and alpha of each: [Z, J, J', r]; or with one c_e.

    Parameters
    ----------
    likelihoods : pair of Likelihood
    points : pair of (c_e, alpha)
    shared : sequence of str
        Offsets that both have in common.
    one_c_e : bool
        Whether c_e is common to both: columns c_e, alpha, alpha'.
    alike : bool
        Whether both leave c_e open, or neither does. Otherwise effects of specimens act on the two in unlike ways, and
        a variance of the pairs' difference below 0 would take up what these do.
    """
    plain = [x.plain if isinstance(x, MixedLikelihood) else x for x in likelihoods]
    common = _effects_of_groups([x.observations for x in plain], alike)
    offsets = [_offsets(likelihood) for likelihood in likelihoods]
    common += [(offsets[0][name][0], offsets[1][name][0]) for name in shared]
    models = []  # of each side: the common effects, its own, J and r
    for side, has in enumerate(offsets):
        effects = [pair[side] for pair in common] + [x for name, (x, _) in has.items() if name not in shared]
        shifts = [
            has[x.quantity][1] if x.quantity in has else _moved_specimens(likelihoods[side], x)
            for x in effects
        ]
        models.append(LinearModel(plain[side], effects, points[side], np.concatenate([np.empty(0), *shifts])))
    return RowProducts(
        _embedded(models, sum(len(pair[0].group.levels) for pair in common), one_c_e),
        np.concatenate([model.n for model in models]),
        np.concatenate([model.known for model in models]),
        [*(pair[0] for pair in common), *(x for model in models for x in model.components[len(common) :])],
        n_fixed=3 if one_c_e else 4,
    )


def _embedded(models: Sequence[LinearModel], n_common: int, one_c_e: bool) -> list[Floats]:
    """Products of each side among the columns of both: common effects, own ones of each, J of each, r."""
    n_own = [len(model.products[0]) - 3 - n_common for model in models]
    width, tables = n_common + sum(n_own) + 5, []
    for side, (model, begin) in enumerate(zip(models, (n_common, n_common + n_own[0]), strict=True)):
        its_own, J = begin + np.arange(n_own[side]), width - 5 + 2 * side + np.arange(2)
        at = np.concatenate([np.arange(n_common), its_own, J, [width - 1]])
        for product in model.products:
            G = np.zeros((width, width))
            G[np.ix_(at, at)] = product
            tables.append(G)
    if not one_c_e:
        return tables
    merged = np.eye(width)
    merged[-3, -5] = 1.0  # the second's c_e is the first's
    merged = np.delete(merged, -3, axis=1)
    return [merged.T @ G @ merged for G in tables]


_Both: TypeAlias = tuple[Component, Component]  # one of each side


def _effects_of_groups(sides: Sequence[Observations], alike: bool) -> list[_Both]:
    """Effects of groups that both sides have in common, and of their difference, which varies with one variance.

    Two levels cannot tell how the difference varies: they have none where another group pairs the sides by more.
    """
    common: list[_Both] = []
    n_common = _common_levels(sides)
    names = [{group.name: group for group in side.groups} for side in sides]
    for name in (name for name in names[0] if name in names[1]):
        groups = names[0][name], names[1][name]
        levels = tuple(dict.fromkeys([*groups[0].levels, *groups[1].levels]))
        first, second = (_renamed(group, levels) for group in groups)
        if name == "specimen" and len(levels) > 2:
            common.append((Component(first, "c_e"), Component(second, "c_e")))
        if len(levels) > 1:
            common.append((Component(first, "alpha"), Component(second, "alpha")))
        repeated = all(len(side.force) > len(group.levels) for side, group in zip(sides, groups, strict=True))
        if repeated and (n_common[name] > 2 or n_common[name] == max(n_common.values()) == 2):
            apart = tuple(f"{side} {level}" for side in "AB" for level in levels)
            second = Group(name, apart, second.velocity + len(levels), second.pressed + len(levels))
            common.append((
                Component(replace(first, levels=apart), "alpha", varies=alike), Component(second, "alpha", varies=alike)
            ))  # fmt: skip
    return common


def _common_levels(sides: Sequence[Observations]) -> dict[str, int]:
    """How many levels of each group both sides have."""
    first, second = (side.labels for side in sides)
    return {name: len(first[name] & second.get(name, set())) for name in first}


def _offsets(likelihood: Likelihood) -> dict[str, tuple[Component, Floats]]:
    """Offsets of a likelihood by name, and what its rows are moved by."""
    if not isinstance(likelihood, MixedLikelihood):
        return {}
    return {
        x.quantity: (x, likelihood.shifts[block])
        for x, block in zip(likelihood.components, likelihood.linear.blocks, strict=True)
        if x.quantity in (*OFFSETS, "order")
    }


def _moved_specimens(likelihood: Likelihood, effect: Component) -> Floats:
    """What the rows of a likelihood are moved by, for each level of an effect: 0, but for c_e of its specimens."""
    moved: dict[str, float] = {}
    if effect.random_c_e and isinstance(likelihood, MixedLikelihood):
        for x, block in zip(likelihood.components, likelihood.linear.blocks, strict=True):
            moved |= dict(zip(x.group.levels, likelihood.shifts[block], strict=True)) if x.random_c_e else {}
    return np.array([moved.get(level, 0.0) for level in effect.group.levels])


def _renamed(group: Group, levels: tuple[str, ...]) -> Group:
    """A group whose rows count among other levels."""
    place = np.array([levels.index(level) for level in group.levels], np.intp)
    return Group(group.name, levels, place[group.velocity], place[group.pressed])


def _fitted_jointly(
    likelihoods: Sequence[Likelihood],
    points: Sequence[tuple[float, float]],
    shared: Sequence[str],
    one_c_e: bool,
    alike: bool,
) -> tuple[Floats, MixedCalibration, float]:
    """Of likelihoods that share effects: differences of log c_e and log alpha, second less first; their limits; and the
    rise of the rows' squares where both are 0.
    """  # fmt: skip
    logs = np.log(np.array(points))
    hard = np.array([x.observations.c_e_floor for x in likelihoods])
    # where each row of both has a window
    plain = [x.plain if isinstance(x, MixedLikelihood) else x for x in likelihoods]
    least = max(*hard, *(x.observations.c_e_floor for x in plain))
    c_e = np.geomspace(least, C_E_RANGE * least, _POINTS)[1:]
    common = float(np.log(c_e[int(np.argmin(sum(x.at(c_e).profile for x in likelihoods)))]))

    def model_at(logs: Floats) -> RowProducts:
        both = [(float(c), float(a)) for c, a in np.exp(logs)]
        return joint_model(likelihoods, both, shared, one_c_e, alike)

    if one_c_e:  # linear in log alpha: the first step is the last
        logs[:, 0] = common
        equations = reml(model_at(logs))
        logs[:, 1] -= equations.solution[-2:]
        return logs[1] - logs[0], difference_of(equations), np.nan
    for _ in range(_ROUNDS):
        equations = reml(model_at(logs))
        step = np.clip(-equations.solution[-4:].reshape(2, 2), -0.5, 0.5)
        logs = logs + step
        logs[:, 0] = np.maximum(logs[:, 0], np.log(hard) + EDGE)
        if np.abs(step).max() < 1e-6:
            break
    if alike and _below_scatter(equations):
        return _fitted_jointly(likelihoods, points, shared, one_c_e, False)

    def squares(log_c_e: float) -> float:
        """Of the rows, at one c_e and the best alpha of both."""
        model = model_at(np.column_stack([np.full(2, log_c_e), logs[:, 1]]))
        there = MixedEquations(model, equations.scatter2, equations.effect2)
        # of the step: both of c_e, one of alpha
        held = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1]])
        off = held @ (there.solution[-4:] - [0, logs[0, 1], 0, logs[1, 1]])
        return there.squares + float(off @ np.linalg.solve(held @ there.M[-4:, -4:] @ held.T, off))

    low = max(common - _NEAR, float(np.log(least)) + EDGE)
    best = scipy.optimize.minimize_scalar(squares, bounds=(low, common + _NEAR), method="bounded")
    return logs[1] - logs[0], difference_of(equations), max(float(best.fun) - equations.squares, 0.0)


def _below_scatter(equations: MixedEquations) -> bool:
    """Whether a variance below 0 of the pairs' difference leaves a direction less error than its degrees of freedom allow.

    Beside the error at no such variance, as it may be where pairs have unlike runs.
    """
    if (equations.effect2 >= 0).all():
        return False
    calibration = difference_of(equations)
    without = MixedEquations(equations.model, equations.scatter2, np.maximum(equations.effect2, 0.0))
    shares, directions = scipy.linalg.eigh(calibration.covariance, difference_of(without).covariance)
    nu = calibration.variance(directions[:, 0])[1]
    return bool(shares[0] < special.chdtri(nu, 1 - _RARE) / nu)


def difference_of(equations: MixedEquations) -> MixedCalibration:
    """The limits of the differences of log c_e and log alpha between the two sides of a `joint_model`."""
    fixed = equations.uncertainty()
    L = np.array(
        [[0.0, 0.0, 0.0], [0.0, -1.0, 1.0]]
        if equations.model.n_fixed == 3
        else [[-1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]]
    )
    return MixedCalibration(
        L @ fixed.covariance @ L.T,
        L @ fixed.adjusted @ L.T,
        L @ fixed.changes @ L.T,
        fixed.of_variances,
        variances=fixed.variances,
    )
