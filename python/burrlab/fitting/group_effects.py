"""The effects of days, specimens and offsets in a fit: their values, their deviations, and what they tell in words."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy import special

from burrlab.common.study import stored_as
from burrlab.common.table import by_value, probability_text
from burrlab.fitting.calibration import AnyCalibration, MixedCalibration
from burrlab.fitting.diagnostics import orthonormal, restarting
from burrlab.fitting.likelihood import Likelihood
from burrlab.fitting.linear import EACH, OFFSETS, LinearModel, MixedEquations, components_of, moved_by
from burrlab.fitting.mixed import MILLION, MixedLikelihood
from burrlab.fitting.observations import Floats, Observations
from burrlab.fitting.profile import ALPHA, Combination, ConfidenceInterval, Domain, c_e_interval

_WIDEST = 1e3  # standard deviation of a logarithm beyond which an interval is open
_PER_CENT = 0.5  # standard deviation of a logarithm above which it is said as a factor
_WEIGHTS = 64  # nodes over the distribution of the scatter, in the interval of a standard deviation


@stored_as("burrlab.fitting.mixed.MixedEffect")
@dataclass(frozen=True)
class MixedEffect:
    """What differs between the levels of a group, or an offset.

    Attributes
    ----------
    group, quantity : str
        Such as "day" and "alpha", "data set" and "force".
    levels : tuple of str
    deviation : float or None
        Standard deviation between levels: of ln c_e or ln alpha (0.1 is about 10 %), or of the offset [N], [mm].
        None of an offset that the data tell.
    interval : ConfidenceInterval or None
        The deviation's 95 % interval; the lower end is 0 where the data allow no difference. None where the
        deviation was given.
    values, errors : tuple of float
        Of each level, and its standard error: ln of its quantity over the population's, drawn towards 0; true less
        measured force [N], depth or radius [mm]; of the order, ln of the last run's velocity over the first's.
    freedom : float
        Degrees of freedom of the errors.
    """

    group: str
    quantity: str
    levels: tuple[str, ...]
    deviation: float | None
    interval: ConfidenceInterval | None
    values: tuple[float, ...]
    errors: tuple[float, ...]
    freedom: float = np.inf

    def level(self, k: int) -> "MixedEffect":
        """The effect of one level alone."""
        return replace(
            self, levels=self.levels[k : k + 1], values=self.values[k : k + 1], errors=self.errors[k : k + 1]
        )

    @property
    def p_value(self) -> float:
        """Of the first level's value, if it were 0."""
        t = abs(self.values[0]) / max(self.errors[0], 1e-300)
        return 2 * float(special.ndtr(-t) if np.isinf(self.freedom) else special.stdtr(self.freedom, -t))

    @property
    def ends(self) -> tuple[float, float]:
        """95 % interval of the first level's value."""
        t = -float(special.ndtri(0.025) if np.isinf(self.freedom) else special.stdtrit(self.freedom, 0.025))
        return self.values[0] - t * self.errors[0], self.values[0] + t * self.errors[0]


@stored_as("burrlab.fitting.mixed.MixedEvidence")
@by_value
@dataclass(frozen=True)
class MixedEvidence:
    """The effects in a fit, and the uncertainty of c_e and alpha that they leave."""

    effects: tuple[MixedEffect, ...]
    scatter2: Floats  #: variance of each scatter
    shifts: Floats  #: offsets that the rows were moved by, a number for each level
    calibration: MixedCalibration

    @classmethod
    def of(cls, likelihood: MixedLikelihood, best: tuple[float, float]) -> "MixedEvidence":
        """At the variances of a likelihood; the effects with rows that are linear about its best point."""
        equations, near = likelihood.equations, likelihood.centred(best)
        model = LinearModel(near.plain, near.components, best, near.shifts)
        at_best = MixedEquations(model, equations.scatter2, equations.effect2)
        # on a ridge c_e has no error in a linear model: within a factor of e it is one
        variance = np.append(at_best.variance[:-2], [1.0, np.inf])
        M = at_best.inverse(np.arange(len(variance)), at_best.C, variance)[0]
        values, errors = -M @ at_best.c, np.sqrt(np.maximum(np.diag(M), 0.0))
        if near is not likelihood:  # at kinks of windows the linear model's best c_e is another
            values = near.own_values(best)
        estimated = model.n[equations.free]
        freedom = float(estimated.sum()) - 2 - sum(len(x.group.levels) for x in model.components if x.sought)
        freedoms = dict.fromkeys(range(len(model.blocks)), max(freedom, 1.0) if len(estimated) else np.inf)
        for k, block in enumerate(model.blocks):
            if model.components[k].sought and model.estimated:  # such as of two drills on days of their own
                told = at_best.uncertainty(block)
                each = [told.variance(axis) for axis in np.eye(len(told.covariance))]
                errors[block], freedoms[k] = np.sqrt([x for x, _ in each]), min(nu for _, nu in each)
        effects = tuple(
            MixedEffect(
                component.group.name, component.quantity, component.group.levels,
                None if component.sought else float(np.sqrt(effect2)),
                _deviation_interval(likelihood.linear, equations, block, float(np.sqrt(effect2))) if component.deviation is None else None,
                tuple(values[block].tolist()), tuple(errors[block].tolist()),
                freedoms[k],
            )
            for k, (component, block, effect2) in enumerate(
                zip(model.components, model.blocks, equations.effect2, strict=True)
            )
        )  # fmt: skip
        return cls(effects, equations.scatter2, likelihood.shifts, equations.uncertainty())

    def likelihood(self, plain: Likelihood, point: tuple[float, float]) -> MixedLikelihood:
        """The likelihood of a fit at a point."""
        uncertain = {
            x.quantity: (x.deviation, x.group) for x in self.effects if x.deviation and x.interval is None
        }
        components = components_of(
            plain.observations, uncertain, [
                f"{x.quantity}:{x.group.removeprefix(EACH)}" if x.group.startswith(EACH) else x.quantity
                for x in self.effects if x.deviation is None
            ]
        )  # fmt: skip
        deviations = [
            c.deviation if x.deviation is None else x.deviation
            for c, x in zip(components, self.effects, strict=True)
        ]
        return MixedLikelihood(
            moved_by(plain, components, self.shifts), components, point, self.shifts, self.scatter2,
            np.square(np.array(deviations, np.float64)),
        )  # fmt: skip


def effect_sentences(
    likelihood: Likelihood,
    effects: Sequence[MixedEffect],
    calibration: AnyCalibration,
    identified: Combination,
) -> list[str]:
    """What the groups and offsets tell, in plain words."""
    sentences: list[str] = []
    for group in likelihood.observations.groups:
        n_levels, name = len(group.levels), group.name
        differs = [
            f"{x.quantity} differs by {deviation_text(x.deviation)} ({_span(x.interval)})"
            for x in effects if x.group == name and x.deviation is not None and x.interval is not None
        ]  # fmt: skip
        if differs:
            sentences.append(f"Between the {n_levels} {name}s {' and '.join(differs)}.")
        if name == "specimen" and n_levels == 2:
            sentences.append(
                "Whether c_e differs between specimens cannot be known from fewer than three: its interval is for these two."
            )
    if isinstance(likelihood, MixedLikelihood):
        sentences += _offset_sentences(likelihood, effects, identified)
    if isinstance(calibration, MixedCalibration) and any(x.interval for x in effects):
        of_alpha, best = (calibration.freedom(d) for d in (ALPHA, np.array([-identified.exponent, 1.0])))
        alpha_rests, best_rests = (f"{nu:.2g}" if nu < 100 else "over 100" for nu in (of_alpha, best))
        sentences.append(
            f"The interval of alpha rests on {alpha_rests} degree{'s' * (alpha_rests != '1')} of freedom, that of "
            f"alpha/c_e^{identified.exponent:.3g} on {best_rests}."
        )
    return sentences


def of_groups_alone(effects: Sequence[MixedEffect]) -> bool:
    """Whether none is an offset, or belongs to a data set."""
    return all(x.interval is not None for x in effects)


def silent_groups(o: Observations, effects: Sequence[MixedEffect]) -> list[str]:
    """Groups that a fit does not take into account, as they tell nothing, in plain words."""
    return [
        f"All runs are of one {x.name}: nothing here tells the {x.name} from the bone."
        if len(x.levels) == 1
        else f"Each run has a {x.name} of its own, and counts for itself: nothing tells the {x.name}s from the scatter."
        for x in o.groups
        if x.name not in [effect.group for effect in effects]
    ]


def _offset_sentences(
    likelihood: MixedLikelihood, effects: Sequence[MixedEffect], identified: Combination
) -> list[str]:
    sentences = []
    for k, (component, x) in enumerate(zip(likelihood.components, effects, strict=True)):
        unit = f" {OFFSETS[x.quantity]}" if x.quantity in OFFSETS else ""
        if x.deviation is None and x.quantity in ("c_e", "alpha"):
            for level in map(x.level, range(len(x.levels))):
                low, ratio, high = np.exp([level.ends[0], level.values[0], level.ends[1]])
                sentences.append(
                    f"{x.quantity} of data set {level.levels[0]} is {ratio:.3g} times that of the first ({low:.3g} to {high:.3g}, "
                    f"{probability_text(level.p_value)})."
                )
        elif x.deviation is None:
            last = f"of {x.group} to the last of the longest" if component.restarts else "to the last"
            what = f"The {x.quantity} is off by" if unit else f"From the first run {last} ln v changes by"
            low, high = x.ends
            sentences.append(
                f"{what} {x.values[0]:.3g}{unit} ({low:.3g} to {high:.3g}, {probability_text(x.p_value)})."
            )
            name = restarting(likelihood.observations)
            if name and x.quantity == "order" and not component.restarts:
                sentences.append(f"If it begins anew with each {name}: estimate=('order:{name}',).")
            weak = component.deviation or 0.0
            if x.errors[0] > weak / 2:
                sentences.append(
                    f"The data hardly tell it: it is taken within {weak:.2g}{unit} (standard deviation, ours)."
                )
        elif x.interval is None:
            wider = _widening(likelihood.equations, k, np.array([-identified.exponent, 1.0]))
            of_what = f"the interval of alpha/c_e^{identified.exponent:.3g}"
            does = (
                f"makes {of_what} {wider:.2g} times as wide" if wider >= 1.05 else f"hardly widens {of_what}"
            )
            sentences.append(f"That the {x.quantity} may be off by {x.deviation:.3g}{unit} {does}.")
    return sentences


def what_opens(likelihood: Likelihood, domain: Domain, point: tuple[float, float], ridge: float) -> str:
    """Which offsets leave c_e without an upper end, for a fit where it has none, in a sentence; or nothing."""
    if not isinstance(likelihood, MixedLikelihood):
        return ""
    opening = [
        x.quantity
        for x in likelihood.components
        if x.quantity in (*OFFSETS, "order")
        and c_e_interval(likelihood.without(x), domain, point, ridge).upper is not None
    ]
    return f"Were the {' or the '.join(opening)} known, c_e would have an upper end." if opening else ""


def _widening(equations: MixedEquations, k: int, direction: Floats) -> float:
    """Standard error along a direction with a component, over that without it."""
    others = np.delete(np.arange(len(equations.c)), equations.model.blocks[k])
    variances = [direction @ M[-2:, -2:] @ direction for M in (equations.M, equations.inverse(others)[0])]
    return float(np.sqrt(variances[0] / variances[1]))


def deviation_text(deviation: float) -> str:
    """A standard deviation of a logarithm."""
    if deviation >= _PER_CENT:
        return f"a factor of {np.exp(deviation):.2g}" if deviation < MILLION else "a factor of over a million"
    return f"{100 * deviation:.2g} %"


def _span(interval: ConfidenceInterval) -> str:
    assert interval.lower is not None
    if interval.upper is None or interval.upper >= MILLION:
        return f"{deviation_text(interval.lower)} up"
    low = f"{100 * interval.lower:.2g}" if interval.upper < _PER_CENT else deviation_text(interval.lower)
    return f"{low} to {deviation_text(interval.upper)}"


def _deviation_interval(
    model: LinearModel, equations: MixedEquations, block: slice, estimate: float
) -> ConfidenceInterval:
    """95 % interval of a standard deviation between levels, by a generalised pivot.

    Beside all other effects as parameters, the level's part of the rows is u ~ N(0, sigma^2 + tau^2 lambda_i), and
    the rest S ~ sigma^2 chi^2_f. The pivot solves sum u_i^2/(sigma^2 + tau^2 lambda_i) = chi^2_k, with sigma^2 =
    S/chi^2_f. Where the levels differ by less than their scatter, so that 97.5 % of its distribution are at 0, the
    upper end is that of the part above 0 (ours). The interval takes in the estimate, which weighs the rows otherwise.

    References
    ----------
    Weerahandi, Generalized confidence intervals, J. Am. Stat. Assoc. 88 (1993).
    """
    columns = np.concatenate(
        [c / np.sqrt(s2) for c, s2 in zip(model.columns, equations.scatter2, strict=True)]
    )
    Z, r = columns[:, block], columns[:, -1]
    others = np.delete(columns[:, :-1], np.arange(columns.shape[1] - 1)[block], axis=1)
    basis = orthonormal(others)
    Z, r = Z - basis @ (basis.T @ Z), r - basis @ (basis.T @ r)
    U, s, _ = np.linalg.svd(Z, full_matrices=False)
    used = s > 1e-6 * max(s[0], 1e-12)
    u2, size = (U[:, used].T @ r) ** 2, s[used] ** 2
    freedom = int(model.n.sum()) - basis.shape[1] - int(used.sum())
    S = max(float(r @ r - u2.sum()), 1e-12)  # rows without scatter are on the curve to rounding
    if not len(u2) or freedom < 1:
        return ConfidenceInterval(0.0, None)
    chi2 = special.chdtri(freedom, (np.arange(_WEIGHTS) + 0.5) / _WEIGHTS)
    u2 = np.maximum(u2, 1e-6 * S / freedom)  # levels that are all alike

    def above(deviation: float) -> float:
        """Probability that the pivot lies above."""
        shares = u2 / (S / chi2[:, None] + deviation**2 * size)
        return float(np.mean(special.chdtr(len(u2), shares.sum(axis=1))))

    def end(p: float) -> float:
        if above(0.0) <= p:
            return 0.0
        high = 1.0
        while above(high) > p:
            if high > _WIDEST:
                return np.inf
            high *= 2
        return float(scipy.optimize.brentq(lambda x: above(x) - p, 0.0, high))

    upper = max(end(0.025 * (above(0.0) if above(0.0) <= 0.025 else 1.0)), estimate)
    return ConfidenceInterval(min(end(0.975), estimate), None if upper == np.inf else upper)
