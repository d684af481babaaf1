"""Simulated hands, the cues of an interval, and simulated subjects with noise and a decision rule.

They serve to rehearse an experiment, not to explain people.
"""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias, cast, get_args

import numpy as np

from burrlab._core import Burr, HandDevice, Material
from burrlab.common.check import refuse
from burrlab.psychophysics.designs import Boundary, Interval, Mode, Stimulus
from burrlab.psychophysics.interval import Block, Rendered, render
from burrlab.psychophysics.rules import ANSWERS, INTERVALS, LAPSE, Floats, RuleName, TaskName, one_of, rule_of

PROBING_PUSH = 1.5  # peak push of a press [N]; ours
PRESSES = 0.5  # presses per second, ten in 20 s; ours
DRILLING_PUSH = 0.3  # [N]; ours: 1 N would drill through the softest material in a second
STROKE = 5.0  # from end to end [mm]; ours
STROKES = 1.4  # full turns per second; ours
CLEARANCE = 0.5  # above the surface at the start [mm]


def probing_hand(
    burr: Burr, *, push: float = PROBING_PUSH, presses: float = PRESSES, clearance: float = CLEARANCE
) -> HandDevice:
    """A hand that presses a still burr into the bone repeatedly at one place.

    Parameters
    ----------
    burr : Burr
    push : float
        Peak push of a press [N].
    presses : float
        Presses per second, from the first contact on.
    clearance : float
        Height of the burr above the surface z = 0 at the start [mm].

    Returns
    -------
    HandDevice

    Raises
    ------
    ValueError
        If a number is out of `HandDevice`'s range.

    Examples
    --------
    >>> import burrlab
    >>> probing_hand(burrlab.Burr(3.0)).position
    array([0. , 0. , 3.5])
    """
    return HandDevice((0.0, 0.0, burr.radius + clearance), push=push, presses=presses, strokes=0.0, on=False)


def drilling_hand(
    burr: Burr,
    *,
    push: float = DRILLING_PUSH,
    stroke: float = STROKE,
    strokes: float = STROKES,
    clearance: float = CLEARANCE,
) -> HandDevice:
    """A hand that moves a turning burr to and fro along x with a steady push.

    Parameters
    ----------
    burr : Burr
    push : float
        [N]
    stroke : float
        Length from end to end [mm].
    strokes : float
        Full turns per second.
    clearance : float
        Height of the burr above the surface z = 0 at the start [mm].

    Returns
    -------
    HandDevice

    Raises
    ------
    ValueError
        If a number is out of `HandDevice`'s range.

    Examples
    --------
    >>> import burrlab
    >>> hand = drilling_hand(burrlab.Burr(1.5), push=0.5)
    >>> hand.name
    'simulated hand'
    """
    return HandDevice((0.0, 0.0, burr.radius + clearance), push=push, amplitude=0.5 * stroke, strokes=strokes)


CueName: TypeAlias = Literal["stiffness", "force", "sinking", "change"]

CUES_OF: dict[Mode, tuple[CueName, ...]] = {
    "probing": ("stiffness", "force"),
    "drilling": ("sinking", "change"),
}

IMMERSION = 0.2  # where the force cue is measured [mm]; ours

# A press begins at or above the first share of the interval's largest force, and ends below the second.
_BEGIN, _END = 0.5, 0.2


@dataclass(frozen=True)
class Cues:
    """Natural logarithms of an interval's cues; NaN for a cue that the interval does not give.

    Attributes
    ----------
    stiffness : float
        Logarithm of force over penetration at the peak of a press, mean over presses [N/mm].
    force : float
        Logarithm of the force at 0.2 mm immersion on the way in, mean over presses [N].
    sinking : float
        Logarithm of the tip's greatest depth below the untouched surface over the time of contact [mm/s].
    presses : int
        Number of presses found; 0 in drilling.
    change : float
        Logarithm of how far the burr sank in the second half of the time of contact over how far in the first.
    reached : bool
        Whether the burr came to the interval's boundary; no cue.
    """

    stiffness: float = math.nan
    force: float = math.nan
    sinking: float = math.nan
    presses: int = 0
    change: float = math.nan
    reached: bool = True


def interval_cues(rendered: Rendered) -> Cues:
    """The cues of a rendered interval.

    Parameters
    ----------
    rendered : Rendered
        By a simulated hand or by a person.

    Returns
    -------
    Cues
        Stiffness and force in probing, sinking speed in drilling.

    Notes
    -----
    Force and penetration are the model's, at the burr, without friction and inertia of the hand. A press
    begins where the force reaches half of the interval's largest and ends where it falls below a fifth.

    Examples
    --------
    >>> import burrlab
    >>> from burrlab.psychophysics import Block, Interval, Stimulus, probing_hand, render
    >>> burr, bone = burrlab.Burr(1.5), Stimulus("bone", burrlab.materials["bone"])
    >>> pressed = render(
    ...     Interval(bone, 1, 0.5), probing_hand(burr), burr=burr, bone=Block((10, 10, 4), 0.2), mode="probing", wall_clock=False
    ... )
    >>> interval_cues(pressed).presses
    1
    """
    depth, force = rendered.immersion, np.linalg.norm(rendered.ticks["force"], axis=1)
    if rendered.mode == "drilling":
        if not (rendered.contact > 0.0 and depth.max() > 0.0):
            return Cues(reached=rendered.reached)
        sunk = np.maximum.accumulate(depth[int(np.argmax(rendered.ticks["touching"])) :])
        first, all_of_it = (float(sunk[i]) for i in (len(sunk) // 2, -1))
        return Cues(
            sinking=math.log(all_of_it / rendered.contact),
            change=math.log(all_of_it / first - 1.0) if 0.0 < first < all_of_it else math.nan,
            reached=rendered.reached,
        )
    stiffness, at_depth, before = [], [], 0
    for start, end in _presses(force):
        peak = start + int(np.argmax(force[start:end]))
        stiffness.append(force[peak] / rendered.ticks["penetration"][peak])
        at_depth.append(_force_on_the_way(depth[before : peak + 1], force[before : peak + 1]))
        before = end
    return Cues(stiffness=_log_mean(stiffness), force=_log_mean(at_depth), presses=len(stiffness))


def closed_form_cues(material: Material, *, burr: Burr) -> Cues:
    """The cues that the equations give without voxels, hands or time.

    Parameters
    ----------
    material : Material
    burr : Burr

    Returns
    -------
    Cues
        Stiffness at `PROBING_PUSH` and force at 0.2 mm on a flat surface, where h = H: F = c_e R^2
        (h/R)^q, with q = 3/2 in Eq. 3. Sinking is ln(alpha (F/1 N)^m R phi^{4/q}), phi = F/(c_e R^2), at
        `DRILLING_PUSH`: the law of small forces and thin layers, up to a factor that all materials share. So only
        differences of sinking have a meaning.

    Examples
    --------
    >>> import burrlab
    >>> a, b = (closed_form_cues(burrlab.materials[name], burr=burrlab.Burr(3.0)) for name in ("bone", "pvc"))
    >>> print(f"{a.stiffness - b.stiffness:.3f} {a.force - b.force:.3f} {b.sinking - a.sinking:.3f}")
    1.024 1.535 5.173
    """
    scale, q = material.c_e * burr.radius**2, material.force_exponent
    penetration = burr.radius * (PROBING_PUSH / scale) ** (1.0 / q)
    rate = material.alpha * DRILLING_PUSH**material.rate_exponent
    return Cues(
        stiffness=math.log(PROBING_PUSH / penetration),
        force=math.log(scale * (IMMERSION / burr.radius) ** q),
        sinking=math.log(rate * burr.radius) + 4.0 / q * math.log(DRILLING_PUSH / scale)
        if material.alpha > 0.0
        else -math.inf,
    )


@functools.lru_cache(maxsize=512)
def rendered_cues(
    material: Material, mode: Mode, *, burr: Burr, bone: Block, duration: float = 20.0, seed: int = 1,
    boundary: Boundary | None = None,
) -> Cues:  # fmt: skip
    """The cues of an interval with the mode's simulated hand on the virtual clock, cached.

    Parameters
    ----------
    material : Material
    mode : {"probing", "drilling"}
    burr : Burr
    bone : Block
    duration : float
        [s]
    seed : int
        Seed of the erosion.
    boundary : Boundary, optional

    Returns
    -------
    Cues

    Raises
    ------
    ValueError
        As for `render`.

    Examples
    --------
    >>> import burrlab
    >>> bone = burrlab.materials["bone"]
    >>> cues = rendered_cues(bone, "probing", burr=burrlab.Burr(1.5), bone=Block((10, 10, 4), 0.2), duration=1.0)
    >>> round(cues.stiffness, 3), cues.presses
    (0.776, 1)
    """
    hand = probing_hand(burr) if mode == "probing" else drilling_hand(burr)
    interval = Interval(Stimulus(material.name, material), seed, duration, boundary)
    return interval_cues(render(interval, hand, burr=burr, bone=bone, mode=mode, wall_clock=False))


def _presses(force: Floats) -> Iterator[tuple[int, int]]:
    """(first tick, tick after the last) of each press."""
    largest = float(force.max(initial=0.0))
    if largest <= 0.0:
        return
    above, below = force >= _BEGIN * largest, force < _END * largest
    at = 0
    while at < len(force) and above[at:].any():
        start = at + int(np.argmax(above[at:]))
        at = start + int(np.argmax(below[start:])) if below[start:].any() else len(force)
        yield start, at


def _force_on_the_way(depth: Floats, force: Floats) -> float:
    """The force where the burr last crosses `IMMERSION` on its way in; NaN if it never does."""
    crossings = np.flatnonzero((depth[:-1] < IMMERSION) & (depth[1:] >= IMMERSION))
    if not len(crossings):
        return math.nan
    i = int(crossings[-1])
    part = (IMMERSION - depth[i]) / (depth[i + 1] - depth[i])
    return float(force[i] + part * (force[i + 1] - force[i]))


def _log_mean(values: list[float]) -> float:
    positive = [value for value in values if value > 0.0]
    return math.log(sum(positive) / len(positive)) if positive else math.nan


Decision: TypeAlias = Literal["differencing", "covert"]


@dataclass(frozen=True)
class SimulatedSubject:
    """A subject who feels logarithms of cues, with Gaussian noise drawn once per interval, and uses a rule.

    Parameters
    ----------
    weber : float or mapping of cue to float
        The Weber fraction (`burrlab.psychophysics.weber`): standard deviation of the noise of a cue's
        logarithm in one interval. Twenty seconds do not average it away. No value is published for the
        sinking speed.
    cues : sequence of {"stiffness", "force", "sinking", "change"}
        The cues that the subject attends to.
    decision : {"differencing", "covert"}
        Compare the intervals with one another, or classify each as one of two known materials and compare
        the classes.
    criterion : float, optional
        For differencing in same-different: the distance of the two observations, in standard deviations of
        one, above which the answer is "different". By default that of an unbiased observer.
    lapse : float
        Share of random answers.
    memory : float
        Standard deviation of additional noise on the first interval's logarithms, from memory.
    known : (Cues, Cues), optional
        Cues of the task's two materials, as `taught` sets them.
    floor : float
        s0 of a cue m whose noise has the variance (w m)^2 + s0^2, in the cue's unit: weak cues are felt worse
        than by Weber's law. The subject decides as if it were 0.

    Raises
    ------
    ValueError
        If a cue or the decision is unknown, a number is out of range, a cue has no Weber fraction, or a
        criterion is given for covert decisions.

    Notes
    -----
    Optimal linear weights combine several cues. Cue i has weight D_i/s_i^2, where D_i is the difference of
    its logarithm between the two known materials and s_i^2 = weber_i^2 + memory^2/2. So d'^2 = sum
    D_i^2/s_i^2. The subject knows the D_i and the unbiased criterion before the first trial.

    In same-different, differencing answers "different" if the observations are further apart than the
    criterion; covert, if they lie on different sides of the middle between the known materials. In ABX,
    differencing chooses the alternative closer to the reference; covert, the one further towards the
    reference's side of the middle. In two intervals both choose the interval with more: stiffer in probing,
    faster sinking in drilling, the greater change in the direction of the boundary. A subject who has not been taught weighs several cues by 1/s_i^2. Without
    memory noise these are the rules of `rule_of`.

    Examples
    --------
    >>> subject = SimulatedSubject(weber=0.36).taught(Cues(stiffness=1.01), Cues(stiffness=-0.01))
    >>> f"{subject.d_prime:.3f}"
    '2.833'
    """

    weber: float | Mapping[CueName, float]
    cues: Sequence[CueName] = ("stiffness",)
    decision: Decision = "differencing"
    criterion: float | None = None
    lapse: float = LAPSE
    memory: float = 0.0
    known: tuple[Cues, Cues] | None = field(default=None, repr=False)
    floor: float = 0.0

    def __post_init__(self) -> None:
        cues = tuple(self.cues)
        refuse(
            not cues or any(cue not in get_args(CueName) for cue in cues) or len(set(cues)) < len(cues),
            f"cues must be some of {', '.join(get_args(CueName))}, each once, got {cues!r}",
        )
        fractions = self.weber if isinstance(self.weber, Mapping) else dict.fromkeys(cues, self.weber)
        for cue in cues:
            refuse(cue not in fractions, f"weber must have a fraction for each cue, {cue} has none")
            refuse(
                not 0.0 < fractions[cue] < math.inf,
                f"weber of {cue} must be positive and finite, got {fractions[cue]!r}",
            )
        one_of("decision", self.decision, get_args(Decision))
        refuse(
            self.criterion is not None and self.decision == "covert",
            f"criterion must be None for covert decisions, got {self.criterion!r}",
        )
        refuse(not 0.0 <= self.lapse <= 1.0, f"lapse must be from 0 to 1, got {self.lapse!r}")
        numbers = {"criterion": self.criterion or 0.0, "memory": self.memory, "floor": self.floor}
        for name, number in numbers.items():
            refuse(
                not 0.0 <= number < math.inf, f"{name} must be zero or positive and finite, got {number!r}"
            )
        vars(self).update(cues=cues, weber={cue: float(fractions[cue]) for cue in cues})

    @property
    def rule(self) -> RuleName:
        """The rule that fits this subject in an analysis."""
        return "differencing" if self.decision == "differencing" else "independent-observations"

    def taught(self, a: Cues, b: Cues) -> "SimulatedSubject":
        """The same subject with knowledge of these two materials.

        Raises
        ------
        ValueError
            If a cue of the subject has no value in `a` or `b`.
        """
        self._values((a, b))
        return replace(self, known=(a, b))

    @property
    def d_prime(self) -> float:
        """Distance of the known materials in standard deviations of one observation, memory noise shared.

        Raises
        ------
        ValueError
            If the subject has not been taught.
        """
        return float(np.sqrt((self._difference() ** 2 / self._variance()).sum()))

    def respond(self, task: TaskName, cues: Sequence[Cues], rng: np.random.Generator) -> str:
        """The subject's answer to a trial.

        Parameters
        ----------
        task : {"same-different", "abx", "2ifc"}
        cues : sequence of Cues
            One per interval, in order.
        rng : numpy.random.Generator
            Each call takes the same number of draws.

        Returns
        -------
        str
            One of the task's answers.

        Raises
        ------
        ValueError
            If the numbers of `cues` and intervals differ, a cue has no value, or the subject has not been
            taught (not needed for two intervals).
        """
        refuse(
            len(cues) != INTERVALS[task], f"cues must be one an interval, {INTERVALS[task]}, got {len(cues)}"
        )
        values = self._values(cues)
        lapse, choice = rng.random(2)
        noise = rng.standard_normal(values.shape) * np.hypot(
            self._weber_array(), self.floor * np.exp(-values)
        )
        noise[0] += self.memory * rng.standard_normal(len(self.cues))
        if lapse < self.lapse:
            return ANSWERS[task][0 if choice < 0.5 else 1]
        return self._decide(task, values + noise)

    def to_dict(self) -> dict[str, Any]:
        """A dict for JSON."""
        return {
            "cues": list(self.cues), "weber": dict(cast(Mapping[CueName, float], self.weber)), "decision": self.decision,
            "criterion_sd": self.criterion, "lapse": self.lapse, "memory": self.memory,
            **({"floor": self.floor} if self.floor else {}),
        }  # fmt: skip

    def _decide(self, task: TaskName, observed: Floats) -> str:
        """The answer to noisy values of the cues, a row an interval."""
        variance = self._variance()
        if task == "2ifc":
            # The interval with more of each cue is the answer, so only the weights must be known.
            size = np.ones(len(self.cues)) if self.known is None else np.abs(self._difference())
            x = observed @ (size / variance)
            return "first" if x[0] > x[1] else "second"
        difference = self._difference()
        middle = self._values(self.known or ()).mean(axis=0)
        # of standard deviation 1, with 0 midway between the known materials
        scale = math.sqrt(float((difference**2 / variance).sum()))
        x = (observed - middle) @ (difference / variance) / scale
        if task == "same-different":
            if self.decision == "covert":
                return "different" if x[0] * x[1] < 0.0 else "same"
            unbiased = rule_of(task, "differencing").unbiased
            k = float(unbiased(self.d_prime)) if self.criterion is None else self.criterion
            return "different" if abs(x[0] - x[1]) > k else "same"
        reference, a, b = x
        if self.decision == "covert":
            return "first" if (a - b) * reference > 0.0 else "second"
        return "first" if abs(a - reference) < abs(b - reference) else "second"

    def _difference(self) -> Floats:
        refuse(self.known is None, "the subject must be taught the two materials first (taught, teach)")
        a, b = self._values(self.known or ())
        refuse(np.array_equal(a, b), "the two known materials must differ in a cue")
        return np.asarray(a - b)

    def _variance(self) -> Floats:
        return np.asarray(self._weber_array() ** 2 + 0.5 * self.memory**2)

    def _weber_array(self) -> Floats:
        return np.array([cast(Mapping[CueName, float], self.weber)[cue] for cue in self.cues])

    def _values(self, cues: Sequence[Cues]) -> Floats:
        values = np.array([[getattr(c, cue) for cue in self.cues] for c in cues], dtype=np.float64)
        for i, cue in enumerate(self.cues):
            refuse(
                not np.isfinite(values[:, i]).all(),
                f"cue {cue} must have a value in every interval: stiffness and force come by probing, "
                "sinking and change by drilling",
            )
        return values
