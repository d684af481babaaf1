"""What would move a fit that does not know of it, and what would repair one that the data contradict."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from burrlab._core import shape_names
from burrlab.common.progress import doing
from burrlab.fitting.diagnostics import Point
from burrlab.fitting.likelihood import Likelihood, MeanFieldModel
from burrlab.fitting.linear import OFFSETS, Component, LinearModel, MixedEquations, blocks_of, components_of
from burrlab.fitting.mixed import MixedLikelihood, fitted_again
from burrlab.fitting.observations import Group
from burrlab.fitting.profile import Combination, ConfidenceInterval, Domain, c_e_interval, minima
from burrlab.theory.continuum import Law

_ALONE = 4.0  # of AIC: an explanation is named alone if the others lie farther
_NAMED = 6.0  # of AIC, by which an explanation must be better to be named: 1 % of clean sets have such a one (ours)
_AMOUNTS = {"force": "1 % of the largest ({})", "radius": "1 % ({})"}
_TEXTS = {"force": "a tare or a friction, an offset of the force"}
_RADII = {"half the radius, as if the diameter had been given": 0.5, "twice the radius": 2.0}


@dataclass(frozen=True)
class Sensitivity:
    """How far an offset that the fit does not know of moves alpha/c_e^p."""

    offset: str  #: "surface", "force" or "radius"
    size: float  #: of the offset, true less measured [mm], [N]
    moved: float  #: fitted less true ln(alpha/c_e^p): 0.1 is about 10 %
    widths: float  #: its size over half the width of the 95 % interval; 0 where that has an open end


def sensitivity_sentence(moves: Sequence[Sensitivity], exponent: float) -> list[str]:
    """How far the combination is off, in plain words; none without moves."""
    texts: list[str] = []
    for x in moves:
        amount = _AMOUNTS.get(x.offset, "{}").format(f"{x.size:.2g} {OFFSETS[x.offset]}")
        text = f"a {x.offset}{' misjudged' * (not texts)} by {amount}"
        text += f"{'' if texts else f' moves alpha/c_e^{exponent:.3g}'} by {100 * abs(x.moved):.2g} %"
        widths = f" ({x.widths:.2g} times{'' if texts else ' half the width of its 95 % interval'})"
        texts.append(text + (widths if x.widths else ""))
    return [f"A{', '.join(texts)[1:]}."] if texts else []


def sensitivities(
    likelihood: Likelihood, point: tuple[float, float], identified: Combination
) -> tuple[Sensitivity, ...]:
    """What a surface misjudged by 0.05 mm would change, a force by 1 % of the largest, and a radius by 1 %."""
    mixed = likelihood if isinstance(likelihood, MixedLikelihood) else None
    plain, present = (mixed.plain, mixed.components) if mixed else (likelihood, ())
    o = plain.observations
    sizes = {
        "surface": 0.05,
        "force": 0.01 * float(o.recorded_force.max()),
        "radius": 0.01 * float(o.radius.max()),
    }
    sizes = {name: size for name, size in sizes.items() if name not in [x.quantity for x in present]}
    components = (*components_of(o, estimate=tuple(sizes))[-len(sizes) :], *present) if sizes else present
    model = LinearModel(
        plain, components, point, np.zeros(blocks_of(components)[-1].stop if components else 0)
    )
    scatter2, effect2 = (
        (mixed.equations.scatter2, mixed.equations.effect2)
        if mixed
        else (np.array(list(plain.variances(*point).values())), np.empty(0))
    )
    equations = MixedEquations(model, scatter2, np.append(model.effect2[: len(sizes)], effect2))
    known = np.arange(len(sizes), len(equations.c))
    steps = equations.inverse(known)[0][-2:] @ equations.C[np.ix_(known, np.arange(len(sizes)))]
    ratio = identified.interval.ratio()
    half = np.log(ratio) / 2 if 1 < ratio < np.inf else np.inf
    direction = np.array([-identified.exponent, 1.0])
    moves = [float(direction @ steps[:, k]) * size for k, size in enumerate(sizes.values())]
    return tuple(
        Sensitivity(name, size, moved, float(abs(moved) / half))
        for (name, size), moved in zip(sizes.items(), moves, strict=True)
    )


@dataclass(frozen=True)
class LevelLeftOut:
    """A fit without the velocities of one day or specimen."""

    label: str
    n: int  #: velocities that were left out; a trace has five
    c_e: float  #: without them [N/mm^2]; NaN where nothing could be fitted, as the next two
    alpha: float  #: [1/ms]
    combination: float  #: alpha/c_e^p, with the fit's p
    c_e_interval: ConfidenceInterval  #: at 95 %


def without_levels(
    plain: Likelihood, fitted: MixedLikelihood, group: Group, exponent: float
) -> tuple[LevelLeftOut, ...]:
    """The fits without each level of a group; variances are estimated again."""
    results = []
    for k, label in enumerate(group.levels):
        keep, c_e, alpha, interval = group.velocity != k, np.nan, np.nan, ConfidenceInterval(None, None)
        with suppress(ValueError, IndexError):  # too few forces are left, or no window
            o = plain.observations.kept(keep)
            mixed, domain, _ = fitted_again(
                plain.of_rows(o), [x.of_rows(o) for x in fitted.components], fitted.point
            )
            c_e, alpha = minima(mixed, domain)[0].point
            interval = c_e_interval(mixed, domain, (c_e, alpha))
        results.append(LevelLeftOut(label, int((~keep).sum()), c_e, alpha, alpha / c_e**exponent, interval))
    return tuple(results)


@dataclass(frozen=True)
class Repair:
    """Another explanation of the data than the one that the fit assumes."""

    what: str  #: such as "a tare or a friction, an offset of the force of 0.03 N"
    gain: float  #: AIC of the fit less that with it


@doing("what would repair the fit")
def repairs(
    plain: Likelihood, fitted: Likelihood, point: Point, aic: float, n_parameters: int
) -> tuple[Repair, ...]:
    """Offsets, another radius and other shapes of erosion, by falling gain.

    Parameters
    ----------
    plain : Likelihood
        The rows as they were measured, in the mean field.
    fitted : Likelihood
        That of the fit; its groups and offsets are kept.
    point : (c_e, alpha)
        The fit [N/mm^2], [1/ms].
    aic, n_parameters
        Those of the fit.
    """
    present = fitted.components if isinstance(fitted, MixedLikelihood) else ()
    o, gains = plain.observations, []

    def weigh(what: str, other: Likelihood, offset: Sequence[Component] = ()) -> None:
        """Add the best fit of another likelihood, with one more offset."""
        components = (*present, *offset)
        if other.observations.c_e_floor >= other.observations.ceiling:
            return
        end: Point | None = point
        if components:
            try:
                mixed, _, end = fitted_again(other, components, point)
            except (ValueError, np.linalg.LinAlgError):  # it leaves a row without a window: no explanation
                return
            u = -float(mixed.equations.solution[mixed.linear.blocks[-1]][0])
            what += f" of {u:.2g} {OFFSETS[offset[0].quantity]}" if offset else ""
            other = mixed if present else mixed.plain
        if not present:
            end = next((x.point for x in minima(other, Domain.of(other))), None)
        if end is not None:
            other_aic = 2 * (n_parameters + len(offset)) - 2 * other.log_likelihood(*end)
            gains.append(Repair(what, aic - other_aic))

    for name in OFFSETS:
        if plain.kind != "student" and name not in {x.quantity for x in present}:
            weigh(_TEXTS.get(name, f"a {name} offset"), plain, components_of(o, estimate=(name,))[-1:])
    for text, factor in _RADII.items():  # windows that go with R leave a factor of R to c_e and alpha
        there = o.moved("radius", (factor - 1) * o.radius, (factor - 1) * o.pressed_radius)
        if np.isfinite(o.window_end).all() and (there.window_start < there.window_end).all():
            weigh(text, plain.of_rows(there))
    for text, law in _other_laws(plain.model.law):
        there = replace(o, force_exponent=law.force_exponent, rate_exponent=law.rate_exponent)
        weigh(text, plain.of_rows(there, MeanFieldModel(there, law.shape)))
    return tuple(sorted(gains, key=lambda repair: -repair.gain))


def _other_laws(present: Law) -> list[tuple[str, Law]]:
    """Other shapes of a law, and other exponents."""
    shapes = (Law(name, present.force_exponent, present.rate_exponent) for name in shape_names)
    others = (Law(present.shape, 2.0), Law(present.shape, rate_exponent=1.0), Law("constant", 2.0))
    laws = {law: f"the law {law}" for law in others} | {law: f"f = {law.shape.label}" for law in shapes}
    return [(text, law) for law, text in laws.items() if law != present]


def repair_sentence(ranked: Sequence[Repair]) -> list[str]:
    """The best explanations, all that lie within 4 of the best, in plain words; none that gain little."""
    best = [f"{x.what} ({x.gain:.3g})" for x in ranked if x.gain > max(_NAMED, ranked[0].gain - _ALONE)]

    return [
        f"The data would fit better with {'one of these' if len(best) > 1 else 'this'} (AIC lower by): "
        f"{', or '.join(best)}."
    ] if best else []  # fmt: skip
