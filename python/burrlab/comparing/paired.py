"""Two sets that share days, specimens or offsets, in one mixed model: what they share cancels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy import special

from burrlab.fitting.calibration import MixedCalibration
from burrlab.fitting.diagnostics import HypothesisTest, p_text
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.linear import (
    EDGE,
    OFFSETS,
    Component,
    LinearModel,
    RowProducts,
    blocks_of,
    reml,
)
from burrlab.fitting.mixed import MixedLikelihood
from burrlab.fitting.observations import Floats, Group, Observations
from burrlab.fitting.record import FitRecord

ERROR = 0.05  # of "differ" and of "equivalent", all pairs together
_ROUNDS = 30  # of linearising, at most


@dataclass(frozen=True, eq=False)
class LinearDifference:
    """The difference of a quantity between two sets that share effects, second less first."""

    value: float
    error: float
    nu: float

    def ends(self, level: float) -> tuple[float, float]:
        """See `_LogRatio`."""
        half = -float(special.stdtrit(self.nu, (1 - level) / 2)) * self.error
        return self.value - half, self.value + half

    def outside(self, bound: float) -> float:
        """See `_LogRatio`."""
        return float(special.stdtr(self.nu, (abs(self.value) - bound) / self.error))


@dataclass(frozen=True, eq=False)
class Paired:
    """Two sets in one mixed model."""

    group: str
    change: Floats  # of log c_e and log alpha
    calibration: MixedCalibration

    @classmethod
    def of(cls, a: FitRecord, b: FitRecord, shared: Sequence[str]) -> "Paired | None":
        """None where the sets share neither levels nor offsets, or a linear model does not describe them."""
        levels = [{group.name: set(group.levels) for group in x.observations.groups} for x in (a, b)]
        pairing = [name for name in levels[0] if len(levels[0][name] & levels[1].get(name, set())) > 1]
        closed = all(x.intervals["c_e"]["95"].closed for x in (a, b))
        if not closed or not (pairing or shared) or {a.residual_kind, b.residual_kind} != {"relative"}:
            return None
        points = [(x.c_e, x.alpha) for x in (a, b)]
        return cls(" and ".join(pairing), *_fitted_jointly((a.likelihood, b.likelihood), points, shared))

    def along(self, direction: Floats) -> LinearDifference:
        """The difference of a quantity with a gradient over (log c_e, log alpha)."""
        error = float(np.sqrt(direction @ self.calibration.adjusted @ direction))
        return LinearDifference(float(direction @ self.change), error, self.calibration.freedom(direction))

    @property
    def joint(self) -> HypothesisTest:
        """Whether both sets have one c_e and alpha."""
        rise = float(self.change @ np.linalg.solve(self.calibration.covariance, self.change))
        p, freedom = self.calibration.probability(rise), self.calibration.joint_freedom
        F, text = rise / 2, ", ".join(f"{number:.3g}" for number in freedom)
        differ = "differ" if p < ERROR else "can be of one material"
        units = f", paired by {self.group}" if self.group else ""
        sentence = f"The two {differ} (one c_e and alpha{units}): F({text}) = {F:.3g}, {p_text(p)}."
        return HypothesisTest("one material", F, freedom, p, sentence)


class _JointModel(RowProducts):
    """The rows of two likelihoods that share effects, with c_e and alpha of each: [Z, J, J', r].

    Parameters
    ----------
    likelihoods : pair of Likelihood
    points : pair of (c_e, alpha)
    shared : sequence of str
        Offsets that both have in common.
    varies : bool
        Whether the difference varies from pair to pair.
    """

    n_fixed = 4

    def __init__(
        self, likelihoods: Sequence[Likelihood], points: Sequence[tuple[float, float]], shared: Sequence[str],
        varies: bool,
    ) -> None:  # fmt: skip
        plain = [x.plain if isinstance(x, MixedLikelihood) else x for x in likelihoods]
        common, own = _effects_of_groups([x.observations for x in plain], varies)
        offsets = [_offsets(likelihood) for likelihood in likelihoods]
        common += [(offsets[0][name][0], offsets[1][name][0]) for name in shared]
        models = []  # of each side: the common effects, its own, J and r
        for side, has in enumerate(offsets):
            effects = [pair[side] for pair in (*common, *own)]
            effects += [x for name, (x, _) in has.items() if name not in shared]
            shifts = [
                has[x.quantity][1] if x.quantity in has else np.zeros(len(x.group.levels)) for x in effects
            ]
            shift = np.concatenate([np.empty(0), *shifts])
            models.append(LinearModel(plain[side], effects, points[side], shift))
        self.products = _embedded(models, sum(len(pair[0].group.levels) for pair in common))
        self.components = [pair[0] for pair in common]
        self.components += [x for model in models for x in model.components[len(common) :]]
        self.blocks = blocks_of(self.components)
        self.known = np.concatenate([model.known for model in models])
        self.n = np.concatenate([model.n for model in models])
        self.estimated = [k for k, x in enumerate(self.components) if x.deviation is None]
        self.effect2 = np.array([np.square(x.deviation or 0.0) for x in self.components])


def _embedded(models: Sequence[LinearModel], n_common: int) -> list[Floats]:
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
    return tables


_Both: TypeAlias = tuple[Component, Component]  # one of each side


def _effects_of_groups(sides: Sequence[Observations], varies: bool) -> tuple[list[_Both], list[_Both]]:
    """Effects of groups that both sides have in common, and those that each has: the difference varies too."""
    common: list[_Both] = []
    own: list[_Both] = []
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
        if varies and repeated and len({*groups[0].levels} & {*groups[1].levels}) > 1:
            own.append(
                (Component(groups[0], "alpha", varies=True), Component(groups[1], "alpha", varies=True))
            )
    return common, own


def _offsets(likelihood: Likelihood) -> dict[str, tuple[Component, Floats]]:
    """Offsets of a likelihood by name, and what its rows are moved by."""
    if not isinstance(likelihood, MixedLikelihood):
        return {}
    pairs = zip(likelihood.components, likelihood.linear.blocks, strict=True)
    return {
        x.quantity: (x, likelihood.shifts[block]) for x, block in pairs if x.quantity in (*OFFSETS, "order")
    }


def _renamed(group: Group, levels: tuple[str, ...]) -> Group:
    """A group whose rows count among other levels."""
    place = np.array([levels.index(level) for level in group.levels], np.intp)
    return Group(group.name, levels, place[group.velocity], place[group.pressed])


def _fitted_jointly(
    likelihoods: Sequence[Likelihood], points: Sequence[tuple[float, float]], shared: Sequence[str]
) -> tuple[Floats, MixedCalibration]:
    """Differences of log c_e and log alpha, second less first, of likelihoods that share effects; and their limits."""
    logs, varies = np.log(np.array(points)), True
    for _ in range(_ROUNDS):
        model = _JointModel(likelihoods, [(float(c), float(a)) for c, a in np.exp(logs)], shared, varies)
        equations = reml(model)
        step = np.clip(-equations.solution[-4:].reshape(2, 2), -0.5, 0.5)
        logs = logs + step
        hard = [float(x.observations.c_e_bounds().max()) for x in likelihoods]
        logs[:, 0] = np.maximum(logs[:, 0], np.log(hard) + EDGE)
        if np.abs(step).max() < 1e-6:
            own = [k for k, x in enumerate(model.components) if x.varies]
            if not varies or equations.effect2[own].any():
                break
            varies = False  # the difference is one for all pairs
    all_four = equations.uncertainty()
    L = np.array([[-1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]])
    calibration = MixedCalibration(
        L @ all_four.covariance @ L.T,
        L @ all_four.adjusted @ L.T,
        L @ all_four.changes @ L.T,
        all_four.of_variances,
    )
    return logs[1] - logs[0], calibration
