"""Decision rules of same-different, ABX and two-interval tasks, which convert d' to rates and back; counts.

d' is the distance between the two stimuli in standard deviations of one observation. The formulas are those
of Macmillan and Creelman, *Detection Theory: A User's Guide*, chapter 9 (same-different, ABX) and 7 (two
intervals).
"""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf, erfc, erfcinv, erfinv, log_ndtr, ndtr, ndtri

from burrlab.common.check import refuse

Floats: TypeAlias = NDArray[np.float64]
TaskName: TypeAlias = Literal["same-different", "abx", "2ifc"]
RuleName: TypeAlias = Literal["independent-observations", "differencing"]
Chosen = TypeVar("Chosen", bound=str)

TASKS: tuple[TaskName, ...] = ("same-different", "abx", "2ifc")
RULES: tuple[RuleName, ...] = ("independent-observations", "differencing")
#: Keys of the answers, unless a protocol has others.
KEYS = "12"
#: Share of random answers of an observer, where nothing else is said (ours).
LAPSE = 0.02
#: p value at chance, below which scores are said to be below it: were answers swapped? (ours)
BELOW_CHANCE = 0.01
#: Answers in the order of their keys.
ANSWERS: Mapping[TaskName, tuple[str, str]] = {
    "same-different": ("same", "different"), "abx": ("first", "second"), "2ifc": ("first", "second"),
}  # fmt: skip
#: Intervals of a trial.
INTERVALS: Mapping[TaskName, int] = {"same-different": 2, "abx": 3, "2ifc": 2}
#: The answer that hits and false alarms count, see `Rule`.
COUNTED: Mapping[TaskName, str] = {"same-different": "different", "abx": "first", "2ifc": "first"}

_ROOT2, _ROOT3 = math.sqrt(2.0), math.sqrt(3.0)
_LARGEST = 75.0  # largest d' whose rates differ from 0 and 1 in double precision
_HALVINGS = 100  # halvings of [0, _LARGEST] down to the last bit
_FAR = 20.0  # distance of a criterion beyond both means at which one answer is always given [sd]


def one_of(name: str, value: str, choices: Sequence[Chosen]) -> Chosen:
    """The value; ValueError unless it is one of the choices."""
    refuse(value not in choices, f"{name} must be one of {', '.join(choices)}, got {value!r}")
    return choices[choices.index(value)]


def whole(name: str, value: int, *, at_least: int, multiple: int = 1, why: str = "") -> int:
    """The number as an int; ValueError if it is out of range."""
    number = operator.index(value)
    refuse(number < at_least, f"{name} must be at least {at_least}, got {number}")
    refuse(number % multiple, f"{name} must be a multiple of {multiple}{why}, got {number}")
    return number


def check_level(level: float) -> None:
    """ValueError unless it is the level of an interval."""
    refuse(not 0.5 <= level < 1.0, f"level must be in [0.5, 1), got {level}")


def halving(
    holds: Callable[[Any], Any], inside: Floats | float, outside: Floats | float, times: int
) -> tuple[Any, Any]:
    """(inside, outside) after halvings between `inside`, where `holds`, and `outside`, where not."""
    for _ in range(times):
        middle = 0.5 * (inside + outside)
        held = holds(middle)
        inside, outside = np.where(held, middle, inside), np.where(held, outside, middle)
    return inside, outside


class Rule:
    """A decision rule of an observer.

    The two rates are those of one answer, on trials where it is correct (hit) and where it is not (false
    alarm):

    * same-different: "different", on pairs AB and BA (hit) and AA and BB (false alarm);
    * ABX: "first", where the first (hit) or the second alternative (false alarm) matches the reference;
    * two intervals: "first", where the first (hit) or the second (false alarm) is the correct one.

    All methods take numbers or arrays that broadcast, and return arrays.

    Attributes
    ----------
    task : {"same-different", "abx", "2ifc"}
    name : {"independent-observations", "differencing"}

    Notes
    -----
    z(hit), z(false alarm) = +-z/2 - c, where erf(z/(2 sqrt 2)) = erf(d'/a) erf(d'/b). This is exact without
    bias. With bias it is Macmillan and Creelman's approximation, a receiver operating characteristic of unit
    slope. Differencing in same-different has formulas of its own.
    """

    def __init__(self, task: TaskName, name: RuleName, a: float = 1.0, b: float = 1.0) -> None:
        self.task, self.name, self._scales = task, name, (a, b)

    def _z(self, d_prime: ArrayLike) -> Floats:
        """z(hit) - z(false alarm)."""
        a, b = (np.asarray(d_prime, dtype=np.float64) / scale for scale in self._scales)
        low, far_a, far_b = erf(a) * erf(b), erfc(a), erfc(b)
        high = far_a + far_b - far_a * far_b  # 1 - low without its rounding
        return np.asarray(2.0 * _ROOT2 * np.where(low < 0.5, erfinv(np.minimum(low, 0.9)), erfcinv(high)))

    def rates(self, d_prime: ArrayLike, criterion: ArrayLike | None = None) -> tuple[Floats, Floats]:
        """(hit rate, false-alarm rate) at d' >= 0 and a criterion, by default the unbiased criterion."""
        c = np.float64(0.0) if criterion is None else np.asarray(criterion, dtype=np.float64)
        half = 0.5 * self._z(d_prime)
        return np.asarray(ndtr(half - c)), np.asarray(ndtr(-half - c))

    def log_rates(self, d_prime: ArrayLike, criterion: ArrayLike) -> tuple[Floats, Floats, Floats, Floats]:
        """Logarithms of hit, miss, false-alarm and correct-rejection rates, precise even for tiny rates.

        All four are concave in the criterion, so a likelihood has one best criterion at any d'.
        """
        half, c = 0.5 * self._z(d_prime), np.asarray(criterion, dtype=np.float64)
        return log_ndtr(half - c), log_ndtr(c - half), log_ndtr(-half - c), log_ndtr(half + c)

    def _slope(self, d_prime: ArrayLike) -> Floats:
        """dz/dd'."""
        d, (a, b) = np.asarray(d_prime, dtype=np.float64), self._scales
        grown = self._z(d) ** 2 / 8.0
        parts = [np.exp(grown - (d / s) ** 2) / s * erf(d / other) for s, other in ((a, b), (b, a))]
        return np.asarray(2.0 * _ROOT2 * (parts[0] + parts[1]))

    def slopes(self, d_prime: ArrayLike, criterion: ArrayLike) -> tuple[Floats, Floats, Floats, Floats]:
        """Derivatives of hit rate and false-alarm rate: dH/dd', dH/dc, dF/dd', dF/dc."""
        half, c = 0.5 * self._z(d_prime), np.asarray(criterion, dtype=np.float64)
        hit, alarm, slope = _density(half - c), _density(half + c), 0.5 * self._slope(d_prime)
        return hit * slope, -hit, -alarm * slope, -alarm

    def criterion_range(
        self, d_prime: ArrayLike, hit: ArrayLike, false_alarm: ArrayLike
    ) -> tuple[Floats, Floats]:
        """Two criteria that enclose the likeliest criterion for these rates, at any d'."""
        half = 0.5 * self._z(d_prime)
        of_hit = half - ndtri(np.asarray(hit, dtype=np.float64))
        of_alarm = -half - ndtri(np.asarray(false_alarm, dtype=np.float64))
        low, high, most = np.minimum(of_hit, of_alarm), np.maximum(of_hit, of_alarm), half + _FAR
        return np.clip(low, -most, most), np.clip(high, -most, most)

    def criterion_of(self, d_prime: ArrayLike, false_alarm: ArrayLike) -> Floats:
        """The criterion that gives an observer of this d' this false-alarm rate."""
        return np.asarray(-0.5 * self._z(d_prime) - ndtri(np.asarray(false_alarm, dtype=np.float64)))

    def unbiased(self, d_prime: ArrayLike) -> Floats:
        """The criterion with the most correct answers when both kinds of trial are equally frequent."""
        return np.zeros_like(np.asarray(d_prime, dtype=np.float64))

    def invert(self, hit: ArrayLike, false_alarm: ArrayLike) -> tuple[Floats, Floats]:
        """(d', criterion) of two rates; d' is 0 if hit <= false alarm, inf if hit is 1 or false alarm 0."""
        h, f = np.broadcast_arrays(
            np.asarray(hit, dtype=np.float64), np.asarray(false_alarm, dtype=np.float64)
        )
        with np.errstate(invalid="ignore"):
            z, c = ndtri(h) - ndtri(f), -0.5 * (ndtri(h) + ndtri(f))
        some = np.where(np.isfinite(z), z, 1.0)
        return _root(lambda x: self._z(x) - some, h, f), np.asarray(c)

    def proportion_correct(
        self, d_prime: ArrayLike, criterion: ArrayLike | None = None, *, lapse: float = 0.0
    ) -> Floats:
        """Proportion correct if both kinds of trial are equally frequent; a lapse is a random answer."""
        hit, false_alarm = self.rates(d_prime, criterion)
        return np.asarray((1.0 - lapse) * 0.5 * (1.0 + hit - false_alarm) + 0.5 * lapse)


class _Differencing(Rule):
    """Same-different: "different" if the two observations are further apart than the criterion k [sd]."""

    def rates(self, d_prime: ArrayLike, criterion: ArrayLike | None = None) -> tuple[Floats, Floats]:
        d = np.asarray(d_prime, dtype=np.float64)
        k = self.unbiased(d) if criterion is None else np.asarray(criterion, dtype=np.float64)
        hit = ndtr((d - k) / _ROOT2) + ndtr((-d - k) / _ROOT2)
        return np.asarray(hit), np.asarray(2.0 * ndtr(-k / _ROOT2) + 0.0 * d)

    def log_rates(self, d_prime: ArrayLike, criterion: ArrayLike) -> tuple[Floats, Floats, Floats, Floats]:
        d, k = np.asarray(d_prime, dtype=np.float64), np.asarray(criterion, dtype=np.float64)
        upper, lower = log_ndtr((d - k) / _ROOT2), log_ndtr((-d - k) / _ROOT2)
        with np.errstate(divide="ignore"):
            miss = log_ndtr((k - d) / _ROOT2) + np.log1p(-np.exp(lower - log_ndtr((k - d) / _ROOT2)))
            rejection = np.log(erf(0.5 * k)) + 0.0 * d
        alarm = math.log(2.0) + log_ndtr(-k / _ROOT2) + 0.0 * d
        return np.logaddexp(upper, lower), np.asarray(miss), np.asarray(alarm), np.asarray(rejection)

    def slopes(self, d_prime: ArrayLike, criterion: ArrayLike) -> tuple[Floats, Floats, Floats, Floats]:
        d, k = np.asarray(d_prime, dtype=np.float64), np.asarray(criterion, dtype=np.float64)
        upper, lower = _density((d - k) / _ROOT2) / _ROOT2, _density((d + k) / _ROOT2) / _ROOT2
        none = np.zeros(np.broadcast_shapes(d.shape, k.shape))
        return upper - lower, -upper - lower, none, none - _ROOT2 * _density(k / _ROOT2)

    def criterion_range(
        self, d_prime: ArrayLike, hit: ArrayLike, false_alarm: ArrayLike
    ) -> tuple[Floats, Floats]:
        d, h = np.asarray(d_prime, dtype=np.float64), np.asarray(hit, dtype=np.float64)
        # Phi((d' - k)/sqrt 2) <= H <= 2 Phi((d' - k)/sqrt 2)
        nearest, farthest = d - _ROOT2 * ndtri(h), d - _ROOT2 * ndtri(0.5 * h)
        of_alarm, most = self.criterion_of(d, false_alarm), d + _FAR
        low, high = np.minimum(nearest, of_alarm), np.maximum(farthest, of_alarm)
        return np.clip(low, 0.0, most), np.clip(high, 0.0, most)

    def criterion_of(self, d_prime: ArrayLike, false_alarm: ArrayLike) -> Floats:
        return np.asarray(-_ROOT2 * ndtri(0.5 * np.asarray(false_alarm, dtype=np.float64)))

    def unbiased(self, d_prime: ArrayLike) -> Floats:
        # exp(d^2/4) = cosh(d k/2), solved in logarithms so that large d' do not overflow
        d = np.asarray(d_prime, dtype=np.float64)
        square = 0.25 * d * d
        with np.errstate(divide="ignore", invalid="ignore"):
            arcosh = square + np.log1p(np.sqrt(-np.expm1(-2.0 * square)))
            return np.where(d < 1e-5, _ROOT2, 2.0 * arcosh / d)

    def invert(self, hit: ArrayLike, false_alarm: ArrayLike) -> tuple[Floats, Floats]:
        h, f = np.broadcast_arrays(
            np.asarray(hit, dtype=np.float64), np.asarray(false_alarm, dtype=np.float64)
        )
        k = self.criterion_of(0.0, f)
        # At an infinite criterion any d' gives these rates.
        some = np.where(np.isfinite(k), k, 0.0)
        return _root(lambda x: self.rates(x, some)[0] - h, h, f), k


class _TwoIntervals(Rule):
    """Choice of the larger observation: z(hit) - z(false alarm) = sqrt(2) d', under both names of a rule."""

    def _slope(self, d_prime: ArrayLike) -> Floats:
        return np.full(np.shape(d_prime), _ROOT2)

    def _z(self, d_prime: ArrayLike) -> Floats:
        return np.asarray(_ROOT2 * np.asarray(d_prime, dtype=np.float64))


def _density(x: Floats) -> Floats:
    return np.asarray(np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi))


def _root(function: Callable[[Floats], Floats], h: Floats, f: Floats) -> Floats:
    """d' of rates h and f: the zeros of increasing functions of d' in [0, _LARGEST], or a bound of d'."""
    high, low = halving(lambda d: function(d) > 0.0, np.full(h.shape, _LARGEST), np.zeros(h.shape), _HALVINGS)
    return np.where(h <= f, 0.0, np.where((h >= 1.0) | (f <= 0.0), np.inf, 0.5 * (low + high)))


_ALL: dict[tuple[str, str], Rule] = {
    (rule.task, rule.name): rule
    for rule in (
        # Pc = Phi(d'/2)^2 + Phi(-d'/2)^2
        Rule("same-different", "independent-observations", 2.0 * _ROOT2, 2.0 * _ROOT2),
        _Differencing("same-different", "differencing"),
        # Pc = Phi(d'/sqrt 2) Phi(d'/2) + Phi(-d'/sqrt 2) Phi(-d'/2)
        Rule("abx", "independent-observations", 2.0, 2.0 * _ROOT2),
        # Pc = Phi(d'/sqrt 2) Phi(d'/sqrt 6) + Phi(-d'/sqrt 2) Phi(-d'/sqrt 6)
        Rule("abx", "differencing", 2.0, 2.0 * _ROOT3),
        _TwoIntervals("2ifc", "independent-observations"),
        _TwoIntervals("2ifc", "differencing"),
    )
}


def rule_of(task: str, name: str) -> Rule:
    """The rule of a task by its name.

    Raises
    ------
    ValueError
        If the task or the rule is unknown.

    Examples
    --------
    >>> rule = rule_of("same-different", "differencing")
    >>> d, criterion = rule.invert(0.7, 0.2)
    >>> print(f"{d:.5f} {criterion:.5f}")
    2.54986 1.81239
    """
    one_of("task", task, TASKS)
    one_of("rule", name, RULES)
    return _ALL[task, name]


@dataclass(frozen=True)
class Counts:
    """Hits and false alarms of the answer that `Rule` names.

    Parameters
    ----------
    task : {"same-different", "abx", "2ifc"}
    hits, signals : int
        Times this answer was given where correct; trials where it was correct.
    false_alarms, noises : int
        Times it was given where wrong; trials where it was wrong.
    by_type : mapping of str to (int, int), optional
        trial_type -> (times the answer was given, trials), if types were counted.

    Raises
    ------
    ValueError
        If the task is unknown, a number is negative or more than its trials, there is no trial, or `by_type`
        does not sum to the same.
    TypeError
        If a number is not whole.

    Examples
    --------
    >>> counts = Counts("same-different", hits=6, signals=8, false_alarms=2, noises=8)
    >>> counts.score, counts.trials
    (12, 16)
    """

    task: TaskName
    hits: int
    signals: int
    false_alarms: int
    noises: int
    by_type: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        one_of("task", self.task, TASKS)
        vars(self).update({
            name: whole(name, getattr(self, name), at_least=0)
            for name in ("hits", "signals", "false_alarms", "noises")
        })  # fmt: skip
        for name, most in (("hits", "signals"), ("false_alarms", "noises")):
            refuse(
                getattr(self, name) > getattr(self, most),
                f"{name} must be at most {most}, {getattr(self, most)}, got {getattr(self, name)}",
            )
        refuse(self.trials == 0, "signals and noises must hold a trial, got 0 and 0")
        types = {str(k): (operator.index(n), operator.index(m)) for k, (n, m) in self.by_type.items()}
        sums = tuple(map(sum, zip(*types.values(), strict=True)))
        refuse(
            types and sums != (self.hits + self.false_alarms, self.trials),
            "by_type must sum to the hits, false alarms and trials",
        )
        object.__setattr__(self, "by_type", MappingProxyType(types))

    @property
    def trials(self) -> int:
        return self.signals + self.noises

    @property
    def score(self) -> int:
        """Correct answers."""
        return self.hits + self.noises - self.false_alarms


def counts_of(task: TaskName, answered: Sequence[tuple[str, str, str]]) -> Counts:
    """The counts of (trial type, response, correct answer), one per trial."""
    counted, by_type = COUNTED[task], dict.fromkeys(sorted({kind for kind, *_ in answered}), (0, 0))
    for kind, response, _ in answered:
        by_type[kind] = by_type[kind][0] + (response == counted), by_type[kind][1] + 1
    signals, noises = (
        [response == counted for _, response, correct in answered if (correct == counted) is signal]
        for signal in (True, False)
    )
    return Counts(task, sum(signals), len(signals), sum(noises), len(noises), by_type)
