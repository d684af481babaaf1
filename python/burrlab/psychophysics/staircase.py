"""What staircases have in common: levels that follow the answers, orders and seeds that do not.

Transformed and weighted up-down staircases.

The method of constant stimuli: given levels, each equally often.

A Bayesian staircase: each level is the one that will tell most.

How well a design finds the threshold of a stated observer, by simulation.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, asdict, dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from scipy.special import ndtr, ndtri

from burrlab.psychophysics.designs import (
    Comparison,
    Draws,
    FixedOrder,
    checked_answers,
    checked_level,
    checked_trial,
    fixed_order,
    whole,
)
from burrlab.psychophysics.psychometric import (
    PosteriorThreshold,
    ThresholdPosterior,
    posterior_threshold,
    threshold_of,
)
from burrlab.psychophysics.rules import rule_of
from burrlab.psychophysics.trial import Order, Phase, Trial

_RUN = 8  # trials over which the orders are balanced


class Track(Protocol):
    """Where a staircase stands; it is told of each answer."""

    def level(self) -> float | None:
        """Of the next trial; None at the end."""

    def update(self, correct: bool) -> None: ...


class Staircased(Comparison):
    """A comparison whose levels follow the answers."""

    trials: int

    @abstractmethod
    def track(self) -> Track:
        """A new one, at its start."""

    @abstractmethod
    def easy_level(self) -> float:
        """Of the practice."""

    def order(self, *, seed: int, subject: str) -> StaircaseOrder:
        return StaircaseOrder(self, Draws(seed, subject, self.to_dict()))


class StaircaseOrder(Order):
    """Trials whose levels follow the answers; orders of the intervals and seeds do not.

    RC and CR are equally often in every eight trials, from the first on. The same answers give the same trials again.

    Attributes
    ----------
    track : Track
    """

    def __init__(self, design: Staircased, draws: Draws) -> None:
        self.answered = []
        self.track = design.track()
        self._design, self._draws = design, draws
        self._kinds = self._drawn(design.practice) + self._drawn(design.trials)
        self._next: Trial | None = None

    def _drawn(self, trials: int) -> list[str]:
        runs = -(-trials // _RUN)
        if runs == 0:
            return []
        drawn = self._draws.balanced((("RC",), ("CR",)), runs * _RUN, runs)
        return [kind for run in drawn for kind in run][:trials]

    @property
    def total(self) -> int:
        return len(self._kinds)

    def next(self) -> Trial | None:
        done, design = len(self.answered), self._design
        if self._next is None and done < self.total:
            number = done - design.practice
            level = design.easy_level() if number < 0 else self.track.level()
            if level is not None:
                phase: Phase = "practice" if number < 0 else "main"
                block = 0 if number < 0 else 1 + number * design.blocks // design.trials
                self._next = design.trial(
                    self._kinds[done], level, (done if number < 0 else number) + 1, phase, block, self._draws
                )
        return self._next

    def answer(self, response: str) -> None:
        trial = checked_trial(self.next(), response, self._design.answers)
        self.answered.append((trial, response))
        if trial.phase == "main":
            self.track.update(response == trial.correct)
        self._next = None


_SMALLEST = 1e-4  # difference, that no step goes below: nobody feels it


@dataclass(frozen=True)
class Staircase(Staircased):
    """An n-down 1-up staircase on c_e or alpha: more alike after n correct answers in a row, less after each wrong one.

    The difference of a level is |ln level|. A step down divides it by a factor, a step up multiplies it by that factor to
    the power `up_weight`; it never crosses 1. Where steps down and up are in balance the proportion correct is

        p = (w/(1 + w))^(1/n),    w = up_weight:

    with equal steps 0.707 for n = 2, 0.794 for 3, 0.841 for 4 (Levitt 1971), with n = 1 and w = 3 0.75 (Kaernbach 1991).
    `Comparison` says what is asked, held and felt.

    Parameters
    ----------
    reference : Stimulus
    parameter : {"c_e", "alpha"}
    start : float
        Level of the first trial and of the practice, well felt: 2, or 0.5 for a staircase below 1.
    down : int
        n, correct answers in a row that make a step down.
    up_weight : float
        w, of a step up over one down, in the logarithm of the difference.
    coarse_step, step : float
        Factors of the difference before and after the first `discard` reversals, above 1.
    discard : int
        Reversals that do not count.
    reversals : int
        That count, even; the staircase ends after the last.
    trials : int
        At most, without practice; a multiple of `blocks`.
    limit : float, optional
        Level that is not passed; by default the square of `start`.
    mode, hold, interval, practice, blocks
        As `Comparison` has them.

    Attributes
    ----------
    target : float
        p.

    Raises
    ------
    ValueError
        If `start` is no ratio or 1, `limit` is not beyond it, a step or weight or number is out of range, `reversals`
        is odd, the target is at chance, `trials` is no multiple of `blocks`, or what is varied cannot be felt.
    TypeError
        If the reference is no Stimulus, or a number is not whole.

    Notes
    -----
    The mean of the reversals is the target's in the limit of small steps only. In runs of 60 reversals of a Gaussian
    observer with 2 % lapses it lies within 5 % (of the difference) with steps of 1.1, 4 to 15 % below with steps of 1.4. `power` simulates the staircase at hand.

    References
    ----------
    H. Levitt, Transformed up-down methods in psychoacoustics, J. Acoust. Soc. Am. 49 (1971) 467-477.
    C. Kaernbach, Simple adaptive testing with the weighted up-down method, Perception & Psychophysics 49 (1991) 227-229.

    Examples
    --------
    >>> from burrlab import materials
    >>> from burrlab.psychophysics.trial import Stimulus
    >>> design = Staircase(Stimulus("bone", materials["bone"]), "c_e", down=3)
    >>> f"{design.target:.3f}"
    '0.794'
    >>> order = design.order(seed=1, subject="01")
    >>> while (trial := order.next()) is not None:
    ...     order.answer(trial.correct if trial.level > 1.2 else "first")
    >>> print(design.threshold(*zip(*[(t.level, t.correct == said) for t, said in order.answered])))
    79.4 % correct at a ratio of 1.23 (8 reversals, 35 trials, pairs of reversals spread by a factor of 1.00)
    """

    _: KW_ONLY
    start: float = 2.0
    down: int = 2
    up_weight: float = 1.0
    coarse_step: float = 2.0
    step: float = math.sqrt(2.0)
    discard: int = 2
    reversals: int = 8
    trials: int = 80
    limit: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        start = checked_level("start", self.start)
        limit = start * start if self.limit is None else checked_level("limit", self.limit)
        if not math.log(limit) / math.log(start) >= 1.0:
            raise ValueError(f"limit must be as far from 1 as start, {start:g}, or farther, got {limit:g}")
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "limit", limit)
        for name in ("coarse_step", "step"):
            value = float(getattr(self, name))
            if not (math.isfinite(value) and value > 1.0):
                raise ValueError(f"{name} must be a factor above 1, got {value}")
            object.__setattr__(self, name, value)
        weight = float(self.up_weight)
        if not (math.isfinite(weight) and weight > 0.0):
            raise ValueError(f"up_weight must be above 0, got {weight}")
        object.__setattr__(self, "up_weight", weight)
        whole("down", self.down, at_least=1)
        whole("discard", self.discard, at_least=0)
        whole("reversals", self.reversals, at_least=2, multiple=2, why=" (peaks and valleys in pairs)")
        whole("trials", self.trials, at_least=1)
        whole("trials", self.trials, at_least=1, multiple=self.blocks, why=", the number of blocks")
        if self.target <= self.chance:
            raise ValueError(
                f"down and up_weight must aim above chance, 0.5, got {self.down} and {weight:g}, which aim at {self.target:.3g}"
            )

    @property
    def target(self) -> float:
        """Proportion correct at which steps down and up are in balance."""
        return float((self.up_weight / (1.0 + self.up_weight)) ** (1.0 / self.down))

    def easy_level(self) -> float:
        return self.start

    def track(self) -> StaircaseTrack:
        return StaircaseTrack(self)

    def threshold(self, levels: Sequence[float], correct: Sequence[bool]) -> StaircaseThreshold:
        """From the answers of the main phase, in order.

        Raises
        ------
        ValueError
            If `levels` and `correct` differ in number, or the levels are not those that this staircase gives after these
            answers.
        """
        track = self.track()
        for number, (level, right) in enumerate(zip(*checked_answers(levels, correct), strict=True), 1):
            expected = track.level()
            if expected is None or not math.isclose(level, expected, rel_tol=1e-6):
                given = "an end" if expected is None else f"{expected:.6g}"
                raise ValueError(
                    f"levels must be those of this staircase, got {level:.6g} in trial {number} where it has {given}"
                )
            track.update(right)
        return track.threshold()

    def power(self, subjects: int = 1) -> str:
        """How well the threshold of a stated observer is found; a second or so of simulation."""
        first = f"{self.what}; aims at {100 * self.target:.1f} % correct, at most {self.trials} trials"
        return f"{first}\n{staircase_precision(self, subjects)}"

    def to_dict(self) -> dict[str, Any]:
        names = (
            "start", "limit", "down", "up_weight", "coarse_step", "step", "discard", "reversals", "trials",
        )  # fmt: skip
        own = {name: getattr(self, name) for name in names}
        return {"design": "staircase", **super().to_dict(), **own, "target": self.target}


class StaircaseTrack:
    """Where a staircase stands."""

    def __init__(self, design: Staircase) -> None:
        assert design.limit is not None
        self._design = design
        self._side = math.copysign(1.0, math.log(design.start))
        self._difference, self._limit = abs(math.log(design.start)), abs(math.log(design.limit))
        self._right = self._trials = self._at_limit = self._direction = 0
        self._reversals: list[float] = []

    def level(self) -> float | None:
        design = self._design
        if self._trials >= design.trials or len(self._reversals) >= design.discard + design.reversals:
            return None
        return math.exp(self._side * self._difference)

    def update(self, correct: bool) -> None:
        design = self._design
        self._trials += 1
        self._at_limit += self._difference >= self._limit
        self._right = self._right + 1 if correct else 0
        if correct and self._right < design.down:
            return
        self._right = 0
        direction = -1 if correct else 1
        if direction == -self._direction:
            self._reversals.append(self._difference)
        self._direction = direction
        factor = design.step if len(self._reversals) >= design.discard else design.coarse_step
        exponent = -1.0 if correct else design.up_weight
        try:
            grown = self._difference * factor**exponent
        except OverflowError:
            grown = math.inf
        self._difference = max(_SMALLEST, min(grown, self._limit))

    def threshold(self) -> StaircaseThreshold:
        counted = self._reversals[self._design.discard :]
        pairs = len(counted) // 2
        # Means of a peak and a valley: the two together have no bias to either side.
        middles = np.log(counted[: 2 * pairs]).reshape(pairs, 2).mean(axis=1)
        complete = self.level() is None
        if pairs == 0:
            return StaircaseThreshold(
                None, None, None, self._design.target, len(counted), self._trials, self._at_limit, complete
            )
        mean = float(middles.mean())
        return StaircaseThreshold(
            math.exp(self._side * math.exp(mean)), math.exp(mean),
            math.exp(float(middles.std(ddof=1))) if pairs > 1 else None,
            self._design.target, len(counted), self._trials, self._at_limit, complete,
        )  # fmt: skip


@dataclass(frozen=True)
class StaircaseThreshold:
    """The mean of a staircase's reversals.

    Attributes
    ----------
    level : float or None
        Ratio to the reference's parameter, where the difference is the geometric mean of the reversals'; None with
        fewer than two reversals that count.
    difference : float or None
        |ln level|
    spread : float or None
        exp of the standard deviation of ln difference between pairs of reversals: a factor. No standard error, as
        reversals of one staircase depend on one another.
    target : float
        Proportion correct that the staircase aims at.
    reversals : int
        That count.
    trials : int
    at_limit : int
        Trials at the level that is not passed; where there are any the threshold is too small.
    complete : bool
        Whether the staircase came to its end.
    """

    level: float | None
    difference: float | None
    spread: float | None
    target: float
    reversals: int
    trials: int
    at_limit: int
    complete: bool

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    def __str__(self) -> str:
        if self.level is None:
            return (
                f"no threshold: {self.reversals} reversals that count in {self.trials} trials, two are needed"
            )
        spread = (
            "" if self.spread is None else f", pairs of reversals spread by a factor of {self.spread:.2f}"
        )
        limit = (
            f"; {self.at_limit} trials at the limit, so the threshold is too small" if self.at_limit else ""
        )
        end = "" if self.complete else "; not complete"
        return (
            f"{100 * self.target:.1f} % correct at a ratio of {self.level:.3g} ({self.reversals} reversals, "
            f"{self.trials} trials{spread}){limit}{end}"
        )


@dataclass(frozen=True)
class ConstantStimuli(Comparison):
    """Comparisons at given levels of c_e or alpha, each equally often, in random order.

    At each level the reference is first as often as second. In each block too where its size allows; else within one.
    `Comparison` says what is asked, held and felt.

    Parameters
    ----------
    reference : Stimulus
    parameter : {"c_e", "alpha"}
    levels : sequence of float
        Ratios to the reference's parameter, above 0, below or above 1 or both. 1 itself has no correct answer.
    repeats : int
        Trials at each level, even; all trials together are a multiple of `blocks`.
    mode, hold, interval, practice, blocks
        As `Comparison` has them.

    Raises
    ------
    ValueError
        If there is no level, one is there twice, is no ratio or 1, `repeats` is odd, the trials are no multiple of
        `blocks`, or what is varied cannot be felt.
    TypeError
        If the reference is no Stimulus, or a number is not whole.

    Examples
    --------
    >>> from burrlab import materials
    >>> from burrlab.psychophysics.trial import Stimulus
    >>> design = ConstantStimuli(Stimulus("bone", materials["bone"]), "c_e", [1.1, 1.3, 1.6], repeats=10)
    >>> design.question
    'In which interval was the material stiffer, the first or the second?'
    >>> trial = design.order(seed=1, subject="01").next()
    >>> trial.trial_type, [interval.stimulus.name for interval in trial.intervals], trial.correct
    ('RC', ['bone', 'bone c_e x1.1'], 'second')
    """

    levels: Sequence[float]
    _: KW_ONLY
    repeats: int = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        levels = tuple(checked_level("levels", level) for level in self.levels)
        if not levels:
            raise ValueError("levels must hold at least one, got none")
        if len(set(levels)) < len(levels):
            raise ValueError(f"levels must differ, got {levels}")
        object.__setattr__(self, "levels", levels)
        whole("repeats", self.repeats, at_least=2, multiple=2, why=" (RC and CR equally often)")
        if self.trials % self.blocks:
            raise ValueError(f"blocks must divide the {self.trials} trials, got {self.blocks}")

    @property
    def trials(self) -> int:
        """In all, without practice."""
        return len(self.levels) * self.repeats

    def order(self, *, seed: int, subject: str) -> FixedOrder:
        draws = Draws(seed, subject, self.to_dict())

        def make(kind: tuple[str, float], number: int, phase: Phase, block: int) -> Trial:
            return self.trial(*kind, number, phase, block, draws)

        return fixed_order(
            draws, [[(kind, level) for level in self.levels] for kind in ("RC", "CR")], make,
            trials=self.trials, blocks=self.blocks, practice=self.practice, answers=self.answers,
        )  # fmt: skip

    def power(self, subjects: int = 1) -> str:
        """How well the threshold of a stated observer is found; a second or so of simulation."""
        first = f"{self.what}; {len(self.levels)} levels of {self.repeats} trials each"
        return f"{first}\n{constant_stimuli_precision(self, subjects)}"

    def to_dict(self) -> dict[str, Any]:
        return {
            "design": "constant-stimuli",
            **super().to_dict(),
            "levels": list(self.levels),
            "repeats": self.repeats,
        }


@dataclass(frozen=True)
class AdaptiveStaircase(Staircased):
    """Levels of c_e or alpha that leave the least expected entropy of threshold, slope and lapse rate.

    After each answer the posterior on a grid of threshold, slope and lapse rate is updated, and the next level is the one
    whose answer is expected to leave the least entropy (Kontsevich and Tyler 1999; with the lapse rate as in Watson
    2017). No draw is in it: the same answers give the same levels. `Comparison` says what is asked, held and felt;
    `posterior.ThresholdPosterior` the prior.

    Parameters
    ----------
    reference : Stimulus
    parameter : {"c_e", "alpha"}
    levels : (float, float)
        Ratios nearest to 1 and farthest from it, on one side of 1, between which levels are chosen and the threshold is
        sought.
    trials : int
        Without practice; a multiple of `blocks`.
    mode, hold, interval, practice, blocks
        As `Comparison` has them. The practice is at the farthest level.

    Raises
    ------
    ValueError
        If a level is no ratio or 1, the two are not on one side of 1 in this order, a number is out of range, `trials` is
        no multiple of `blocks`, or what is varied cannot be felt.
    TypeError
        If the reference is no Stimulus, or a number is not whole.

    Notes
    -----
    Of 1000 observers drawn from the prior the 95 % intervals held the threshold of 952, 940 and 947 after 30, 60 and 120
    trials. Of a Gaussian observer with 2 % lapses and a threshold of 1.05, 1.1, 1.2 or 1.5 they held it in 96.5 to 98.4 %
    of 1000 runs of 60 trials; the difference was found to a factor of 1.26 to 1.31 (standard deviation), 2 to 8 % too small.

    References
    ----------
    L. L. Kontsevich, C. W. Tyler, Bayesian adaptive estimation of psychometric slope and threshold, Vision Research 39
    (1999) 2729-2737.
    A. B. Watson, QUEST+: a general multidimensional Bayesian adaptive psychometric method, Journal of Vision 17(3) (2017)
    10.

    Examples
    --------
    >>> from burrlab import materials
    >>> from burrlab.psychophysics.trial import Stimulus
    >>> design = AdaptiveStaircase(Stimulus("bone", materials["bone"]), "c_e", trials=30)
    >>> order = design.order(seed=1, subject="01")
    >>> while (trial := order.next()) is not None:
    ...     order.answer(trial.correct if trial.level > 1.2 else "first")
    >>> print(design.threshold(*zip(*[(t.level, t.correct == said) for t, said in order.answered])))
    75 % correct at a ratio of 1.15, with 95 % between 1.05 and 1.25 (30 trials)
    """

    _: KW_ONLY
    levels: tuple[float, float] = (1.02, 2.0)
    trials: int = 60

    def __post_init__(self) -> None:
        super().__post_init__()
        near, far = (checked_level("levels", level) for level in self.levels)
        if not math.log(far) / math.log(near) > 1.0:
            raise ValueError(f"levels must be on one side of 1, the nearer first, got {near:g} and {far:g}")
        object.__setattr__(self, "levels", (near, far))
        whole("trials", self.trials, at_least=1)
        whole("trials", self.trials, at_least=1, multiple=self.blocks, why=", the number of blocks")

    def easy_level(self) -> float:
        return self.levels[1]

    @property
    def _ends(self) -> tuple[float, float]:
        near, far = self.levels
        return abs(math.log(near)), abs(math.log(far))

    def track(self) -> AdaptiveTrack:
        return AdaptiveTrack(self)

    def threshold(
        self, levels: Sequence[float], correct: Sequence[bool], *, level: float = 0.95
    ) -> PosteriorThreshold:
        """From the answers of the main phase; of the credible interval, `level` is the probability.

        Raises
        ------
        ValueError
            If `levels` and `correct` differ in number, a level is not between this staircase's two, or `level` is not
            between 0 and 1.
        """
        near, far = self._ends
        side = math.log(self.levels[1])
        for ratio in checked_answers(levels, correct)[0]:
            if not near * (1 - 1e-6) <= math.log(ratio) * math.copysign(1.0, side) <= far * (1 + 1e-6):
                raise ValueError(
                    f"levels must be between {self.levels[0]:g} and {self.levels[1]:g}, got {ratio:.6g}"
                )
        if not levels:
            return threshold_of(ThresholdPosterior(near, far), math.copysign(1.0, side), 0, level)
        return posterior_threshold(near, far, levels, correct, level=level)

    def power(self, subjects: int = 1) -> str:
        """How well the threshold of a stated observer is found; a second or so of simulation."""
        first = f"{self.what}; {self.trials} trials"
        return f"{first}\n{adaptive_precision(self, subjects)}"

    def to_dict(self) -> dict[str, Any]:
        return {
            "design": "adaptive",
            **super().to_dict(),
            "levels": list(self.levels),
            "trials": self.trials,
        }


class AdaptiveTrack:
    """Where a Bayesian staircase stands."""

    def __init__(self, design: AdaptiveStaircase) -> None:
        near, far = design.levels
        self.posterior = ThresholdPosterior(abs(math.log(near)), abs(math.log(far)))
        self._side = math.copysign(1.0, math.log(far))
        self._left = design.trials
        self._difference = self.posterior.most_informative()

    def level(self) -> float | None:
        return math.exp(self._side * self._difference) if self._left else None

    def update(self, correct: bool) -> None:
        self._left -= 1
        self.posterior.update(self._difference, correct)
        self._difference = self.posterior.most_informative()


#: Answers of an observer: whether right, at a difference |ln level|.
Answers: TypeAlias = Callable[[float], bool]

LAPSE = 0.02
_RUNS = 200
_D_PRIME = float(rule_of("2ifc", "independent-observations").invert(0.75, 0.25)[0])  # 0.954 at threshold


def gaussian_correct(difference: float, threshold: float, lapse: float = LAPSE) -> float:
    """Proportion correct of Gaussian noise on the logarithm, Phi(d'/sqrt 2) with d' = 0.954 at threshold; lapses guess.

    Examples
    --------
    >>> round(gaussian_correct(0.1, 0.1, lapse=0.0), 12)
    0.75
    """
    seen = ndtr(_D_PRIME * difference / threshold / math.sqrt(2.0))
    return float((1.0 - lapse) * seen + 0.5 * lapse)


def gaussian_difference(proportion: float, threshold: float, lapse: float = LAPSE) -> float:
    """Where `gaussian_correct` has a proportion."""
    d_prime = math.sqrt(2.0) * float(ndtri((proportion - 0.5 * lapse) / (1.0 - lapse)))
    return threshold * d_prime / _D_PRIME


def constant_stimuli_precision(design: ConstantStimuli, subjects: int) -> str:
    differences = [abs(math.log(level)) for level in design.levels]
    threshold = math.sqrt(min(differences) * max(differences))

    def estimate(answers: Answers) -> tuple[float | None, int]:
        posterior = ThresholdPosterior(0.5 * min(differences), 2.0 * max(differences))
        for difference in differences:
            right = sum(answers(difference) for _ in range(design.repeats))
            posterior.update_counts(difference, right, design.repeats)
        return posterior.summary()["threshold"], design.trials

    return _text(estimate, threshold, "the middle of the levels", subjects)


def staircase_precision(design: Staircase, subjects: int) -> str:
    start = abs(math.log(design.start))

    def estimate(answers: Answers) -> tuple[float | None, int]:
        track = design.track()
        while (level := track.level()) is not None:
            track.update(answers(abs(math.log(level))))
        found = track.threshold()
        return found.difference, found.trials

    return _text(estimate, start / 4.0, "a quarter of the start's distance from 1", subjects, design.target)


def adaptive_precision(design: AdaptiveStaircase, subjects: int) -> str:
    near, far = (abs(math.log(level)) for level in design.levels)

    def estimate(answers: Answers) -> tuple[float | None, int]:
        track = design.track()
        while (level := track.level()) is not None:
            track.update(answers(abs(math.log(level))))
        return track.posterior.summary()["threshold"], design.trials

    return _text(estimate, math.sqrt(near * far), "the middle of the levels", subjects)


def _text(
    estimate: Callable[[Answers], tuple[float | None, int]],
    threshold: float,
    where: str,
    subjects: int,
    target: float | None = None,
) -> str:
    draws = np.random.default_rng(0)
    runs = [
        estimate(lambda difference: draws.random() < gaussian_correct(difference, threshold))
        for _ in range(_RUNS)
    ]
    sought = threshold if target is None else gaussian_difference(target, threshold)
    logs = [math.log(found / sought) for found, _ in runs if found is not None]
    trials = np.mean([number for _, number in runs])
    lines = [
        f"{_RUNS} simulated runs ({trials:.0f} trials on average) of an observer with Gaussian noise, {100 * LAPSE:g} % lapses "
        f"and 75 % correct at a ratio of {math.exp(threshold):.3g} ({where}):"
    ]
    if len(logs) < _RUNS:
        lines.append(f"{_RUNS - len(logs)} of them end without a threshold")
    if len(logs) > 1:
        spread, bias = float(np.std(logs, ddof=1)), float(np.mean(logs))
        lines.append(
            f"the threshold's distance from 1 [ln] is found to a factor of {math.exp(spread):.2f} (standard deviation), "
            f"{100 * abs(math.expm1(bias)):.0f} % too {'large' if bias > 0 else 'small'} in the mean"
        )
        if subjects > 1:
            lines.append(
                f"that of {subjects} such subjects together to {math.exp(spread / math.sqrt(subjects)):.2f}, and worse where they differ"
            )
    return "\n".join(lines)
