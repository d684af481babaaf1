"""Designs that find a threshold: up-down staircases, a Bayesian staircase and constant stimuli.

Each simulates how well it finds the threshold of a given observer. `design_of_dict` reads any design.
"""

import inspect
import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, TypeAlias, cast

import numpy as np
from scipy.special import ndtr, ndtri

from burrlab.bone.materials import material_of
from burrlab.common.check import amend_error, refuse, shown
from burrlab.psychophysics.designs import (
    ABX,
    ComparisonDesign,
    Draws,
    FixedDesign,
    Order,
    Phase,
    SameDifferent,
    Stimulus,
    TaskDesign,
    Trial,
    checked_answers,
    checked_level,
    key_of,
)
from burrlab.psychophysics.psychometric import (
    PosteriorThreshold,
    ThresholdPosterior,
)
from burrlab.psychophysics.rules import LAPSE, check_level, rule_of, whole

_RUN = 8  # trials over which the orders are balanced


class Staircased(ComparisonDesign):
    """A comparison whose levels follow the answers."""

    trials: int
    catch: int

    @abstractmethod
    def track(self) -> "StaircaseTrack | AdaptiveTrack":
        """A new track, at its start."""

    @abstractmethod
    def easy_level(self) -> float:
        """The level of practice trials."""

    @abstractmethod
    def threshold(
        self, levels: Sequence[float], correct: Sequence[bool], *, level: float = 0.95
    ) -> "Threshold":
        """The threshold from the answers of the main phase, in order, with any interval of probability `level`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("trials", self.trials, at_least=1, multiple=self.blocks, why=", the number of blocks")
        whole("catch", self.catch, at_least=0)
        refuse(self.catch > self.trials, f"catch must be at most the {self.trials} trials, got {self.catch}")

    def order(self, *, seed: int, subject: str) -> Order:
        draws = Draws(seed, subject, self.to_dict())
        total = self.practice + self.trials + self.catch
        return Order(self.answers, total, lambda order: self._each_trial(draws, order))

    def _each_trial(self, draws: Draws, order: Order) -> Iterator[Trial]:
        """The trials; levels follow the answers in the order, the kinds and seeds of intervals do not."""
        practice, main, catch = (
            enumerate(_kinds(draws, number), 1) for number in (self.practice, self.trials, self.catch)
        )
        phases: list[Phase] = ["main"] * self.trials
        for part in reversed(range(self.catch)):  # one in each of equal parts of the main phase
            low, high = (self.trials * end // self.catch for end in (part, part + 1))
            phases.insert(low + draws.below(high - low), "catch")
        for number, kind in practice:
            yield self._trial(draws, (kind, self.easy_level()), number, "practice", 0)
        track, done = self.track(), 0
        for phase in phases:
            if (level := track.level()) is None:
                return
            number, kind = next(main if phase == "main" else catch)
            at = level if phase == "main" else self.easy_level()
            block = 1 + min(done * self.blocks // self.trials, self.blocks - 1)
            trial = self._trial(draws, (kind, at), number, phase, block)
            yield trial
            if phase == "main":
                done += 1
                if len(order.answered) - 1 not in order.lost:
                    track.update(order.answered[-1][1] == trial.correct)

    def _measure(self, answers: "Answers") -> "Threshold":
        """The threshold that a run with an observer finds."""
        track = self.track()
        while (level := track.level()) is not None:
            track.update(answers(abs(math.log(level))))
        return track.threshold()


def _kinds(draws: Draws, trials: int) -> list[str]:
    """RC and CR, equally frequent in every eight trials from the first."""
    runs = max(1, -(-trials // _RUN))
    drawn = draws.balanced((("RC",), ("CR",)), runs * _RUN, runs) if trials else []
    return [kind for run in drawn for kind in run][:trials]


_SMALLEST = 1e-4  # least difference of a level; nobody feels it


@dataclass(frozen=True)
class Staircase(Staircased):
    r"""An n-down 1-up staircase on c_e or alpha.

    The difference of a level is |ln level|. A step down, after n correct answers in a row, divides it by a
    factor. A step up, after each wrong answer, multiplies it by this factor to the power `up_weight`. The
    level never crosses 1. Steps down and up balance at the proportion correct

    .. math::

       p = \left(\frac{w}{1 + w}\right)^{1/n}\quad \text{with } w \text{ the up weight:}

    with equal steps 0.707 for n = 2, 0.794 for 3, 0.841 for 4 (Levitt 1971); with n = 1 and w = 3, 0.75
    (Kaernbach 1991). `ComparisonDesign` explains what is asked, held and felt.

    Parameters
    ----------
    reference : Stimulus
    parameter : {"c_e", "alpha"}
    start : float
        Level of the first trial and of practice, easy to feel: 2, or 0.5 for a staircase below 1.
    down : int
        n, correct answers in a row for a step down.
    up_weight : float
        w, a step up over a step down, in the logarithm of the difference.
    coarse_step, step : float
        Factors of the difference before and after the first `discard` reversals, above 1.
    discard : int
        First reversals, which do not count.
    reversals : int
        Reversals that count, even; the staircase ends after the last.
    trials : int
        Most trials, without practice; a multiple of `blocks`.
    limit : float, optional
        Level farthest from 1; by default the square of `start`.
    catch : int
        Catch trials among the others, at the easy level, for the lapse rate; 5 to 10 % of `trials` will do.
        They do not move the staircase.
    mode, hold, interval, practice, blocks
        As for `ComparisonDesign`.

    Attributes
    ----------
    target : float
        The proportion correct p.

    Raises
    ------
    ValueError
        If `start` is not above 0 or is 1, `limit` is nearer to 1 than `start` or beyond 1, a step, weight or
        number is out of range, `reversals` is odd, the target is not above chance, `trials` is not a multiple
        of `blocks`, or the varied parameter cannot be felt.
    TypeError
        If the reference is not a Stimulus, or a number is not whole.

    Notes
    -----
    The mean of the reversals equals the target's difference only in the limit of small steps. In runs of 60
    reversals of a Gaussian observer with 2 % lapses, the mean lies within 5 % (of the difference) with steps
    of 1.1, and 4 to 15 % below with steps of 1.4. `power` simulates the given staircase.

    References
    ----------
    H. Levitt, Transformed up-down methods in psychoacoustics, J. Acoust. Soc. Am. 49 (1971) 467-477. C.
    Kaernbach, Simple adaptive testing with the weighted up-down method, Perception & Psychophysics 49 (1991)
    227-229.

    Examples
    --------
    >>> from burrlab import materials
    >>> from burrlab.psychophysics.designs import Stimulus
    >>> design = Staircase(Stimulus("bone", materials["bone"]), "c_e", down=3)
    >>> f"{design.target:.3f}"
    '0.794'
    >>> order = design.order(seed=1, subject="01")
    >>> while (trial := order.next()) is not None:
    ...     order.answer(trial.correct if trial.level > 1.2 else "first")
    >>> print(design.threshold(*zip(*[(t.level, t.correct == said) for t, said in order.answered])))
    79.4 % correct at a ratio of 1.23 (8 reversals, 35 trials, pairs of reversals spread by a factor of 1.00)
    """

    _kind, _derived = "staircase", (*ComparisonDesign._derived, "target")

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
    catch: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        start = checked_level("start", self.start)
        limit = checked_level("limit", start * start if self.limit is None else self.limit)
        refuse(
            not math.log(limit) / math.log(start) >= 1.0,
            f"limit must be as far from 1 as start, {start:g}, or farther, got {limit:g}",
        )
        vars(self).update(start=start, limit=limit)
        for name, least, rule in (
            ("coarse_step", 1.0, "a factor above 1"), ("step", 1.0, "a factor above 1"), ("up_weight", 0.0, "above 0"),
        ):  # fmt: skip
            number = float(getattr(self, name))
            refuse(not least < number < math.inf, f"{name} must be {rule}, got {number}")
            object.__setattr__(self, name, number)
        whole("down", self.down, at_least=1)
        whole("discard", self.discard, at_least=0)
        whole("reversals", self.reversals, at_least=2, multiple=2, why=" (peaks and valleys in pairs)")
        refuse(
            self.target <= self.chance,
            f"down and up_weight must aim above chance, 0.5, got {self.down} and {self.up_weight:g}, which aim "
            f"at {self.target:.3g}",
        )

    @property
    def target(self) -> float:
        """Proportion correct at which steps down and up balance."""
        return float((self.up_weight / (1.0 + self.up_weight)) ** (1.0 / self.down))

    def easy_level(self) -> float:
        return self.start

    def extremes(self) -> Sequence[float]:
        return (cast(float, self.limit),)  # set by __post_init__

    def track(self) -> "StaircaseTrack":
        return StaircaseTrack(self)

    def threshold(
        self, levels: Sequence[float], correct: Sequence[bool], *, level: float = 0.95
    ) -> "StaircaseThreshold":
        """The threshold from the answers of the main phase, in order; a mean of reversals has no interval.

        Raises
        ------
        ValueError
            If `levels` and `correct` differ in number, or the staircase gives other levels for these answers.
        """
        track = self.track()
        for number, (ratio, right) in enumerate(zip(*checked_answers(levels, correct), strict=True), 1):
            expected = track.level()
            if expected is None or not math.isclose(ratio, expected, rel_tol=1e-6):
                raise ValueError(
                    f"levels must be those of this staircase, got {ratio:.6g} in trial {number} where it has "
                    f"{'an end' if expected is None else f'{expected:.6g}'}"
                )
            track.update(right)
        return track.threshold()

    def power(self, subjects: int = 1) -> str:
        """Lines on how well a given observer's threshold is found, by about a second of simulation."""
        threshold, where = abs(math.log(self.start)) / 4.0, "a quarter of the start's distance from 1"
        return (
            f"{self.what}; aims at {100 * self.target:.1f} % correct, at most {self.trials} trials\n"
            f"{precision(self._measure, threshold, where, subjects, self.target)}"
        )


class StaircaseTrack:
    """State of a staircase."""

    def __init__(self, design: Staircase) -> None:
        self._design = design
        self._side = math.copysign(1.0, math.log(design.start))
        self._difference, self._limit = (abs(math.log(x)) for x in (design.start, *design.extremes()))
        self._right = self._trials = self._at_limit = self._direction = 0
        self._reversals: list[float] = []

    def level(self) -> float | None:
        design = self._design
        over = self._trials >= design.trials or len(self._reversals) >= design.discard + design.reversals
        return None if over else math.exp(self._side * self._difference)

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
        try:
            grown = self._difference * factor ** (-1.0 if correct else design.up_weight)
        except OverflowError:
            grown = math.inf
        self._difference = max(_SMALLEST, min(grown, self._limit))

    def threshold(self) -> "StaircaseThreshold":
        counted = self._reversals[self._design.discard :]
        pairs = len(counted) // 2
        # Means of a peak and a valley, which are unbiased together
        middles = np.log(counted[: 2 * pairs]).reshape(pairs, 2).mean(axis=1)
        difference = math.exp(float(middles.mean())) if pairs else None
        return StaircaseThreshold(
            None if difference is None else math.exp(self._side * difference),
            difference,
            math.exp(float(middles.std(ddof=1))) if pairs > 1 else None,
            self._design.target, len(counted), self._trials, self._at_limit, self.level() is None,
        )  # fmt: skip


@dataclass(frozen=True)
class StaircaseThreshold:
    """The mean of a staircase's reversals.

    Attributes
    ----------
    level : float or None
        Ratio to the reference's parameter; its difference is the geometric mean of the reversals'
        differences. None with fewer than two reversals that count.
    difference : float or None
        |ln level|
    spread : float or None
        Factor: exp of the standard deviation of ln difference between pairs of reversals. Not a standard
        error, because reversals of one staircase depend on one another.
    target : float
        Proportion correct that the staircase aims at.
    reversals : int
        Reversals that count.
    trials : int
    at_limit : int
        Trials at the limit; if many are, the threshold is too small.
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

    def __str__(self) -> str:
        if self.level is None:
            return (
                f"no threshold: {self.reversals} reversals that count in {self.trials} trials, two are needed"
            )
        spread = f", pairs of reversals spread by a factor of {self.spread:.2f}" if self.spread else ""
        return (
            f"{100 * self.target:.1f} % correct at a ratio of {self.level:.3g} ({self.reversals} reversals, "
            f"{self.trials} trials{spread})"
            + f"; {self.at_limit} trials at the limit, so the threshold may be too small"
            * bool(self.at_limit)
            + "; not complete" * (not self.complete)
        )


@dataclass(frozen=True)
class ConstantStimuli(FixedDesign, ComparisonDesign):
    """Comparisons at given levels of c_e or alpha, all equally frequent, in random order.

    At each level the reference comes first as often as second. The same holds in each block if its size
    allows; otherwise frequencies differ by at most one. `ComparisonDesign` explains what is asked, held and felt.

    Parameters
    ----------
    reference : Stimulus
    parameter : {"c_e", "alpha"}
    levels : sequence of float
        Ratios to the reference's parameter, above 0, below or above 1 or both. 1 has no correct answer.
    repeats : int
        Trials at each level, even; all trials together are a multiple of `blocks`.
    mode, hold, interval, practice, blocks
        As for `ComparisonDesign`.

    Raises
    ------
    ValueError
        If there is no level, two levels are equal, a level is not above 0 or is 1, `repeats` is odd, the
        number of trials is not a multiple of `blocks`, or the varied parameter cannot be felt.
    TypeError
        If the reference is not a Stimulus, or a number is not whole.

    Examples
    --------
    >>> from burrlab import materials
    >>> from burrlab.psychophysics.designs import Stimulus
    >>> design = ConstantStimuli(Stimulus("bone", materials["bone"]), "c_e", [1.1, 1.3, 1.6], repeats=10)
    >>> design.question
    'In which interval was the material stiffer, the first or the second?'
    >>> trial = design.order(seed=1, subject="01").next()
    >>> trial.trial_type, [interval.stimulus.name for interval in trial.intervals], trial.correct
    ('RC', ['bone', 'bone c_e x1.1'], 'second')
    """

    _kind = "constant-stimuli"

    levels: Sequence[float]
    _: KW_ONLY
    repeats: int = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        levels = tuple(checked_level("levels", level) for level in self.levels)
        refuse(not levels, "levels must hold at least one, got none")
        refuse(len(set(levels)) < len(levels), f"levels must differ, got {levels}")
        whole("repeats", self.repeats, at_least=2, multiple=2, why=" (RC and CR equally often)")
        types = [[(kind, level) for level in levels] for kind in ("RC", "CR")]
        vars(self).update(levels=levels, trials=len(levels) * self.repeats, _types=types)
        refuse(self.trials % self.blocks, f"blocks must divide the {self.trials} trials, got {self.blocks}")

    def extremes(self) -> Sequence[float]:
        return self.levels

    def power(self, subjects: int = 1) -> str:
        """Lines on how well a given observer's threshold is found, by about a second of simulation."""
        differences = [abs(math.log(level)) for level in self.levels]
        threshold = math.sqrt(min(differences) * max(differences))

        def estimate(answers: "Answers") -> PosteriorThreshold:
            posterior = ThresholdPosterior(0.5 * min(differences), 2.0 * max(differences))
            for difference in differences:
                right = sum(answers(difference) for _ in range(self.repeats))
                posterior.update(difference, right, self.repeats)
            return posterior.threshold(1.0, self.trials)

        return (
            f"{self.what}; {len(self.levels)} levels of {self.repeats} trials each\n"
            f"{precision(estimate, threshold, 'the middle of the levels', subjects)}"
        )


@dataclass(frozen=True)
class AdaptiveStaircase(Staircased):
    """A Bayesian staircase on c_e or alpha, for threshold, slope and lapse rate.

    Each answer updates the posterior on a grid of threshold, slope and lapse rate. The next level is the one
    whose answer has the least expected entropy of the posterior (Kontsevich and Tyler 1999; with the lapse
    rate as in Watson 2017). Nothing is random: the same answers give the same levels. `ComparisonDesign` explains
    what is asked, held and felt; `ThresholdPosterior`, the prior.

    Parameters
    ----------
    reference : Stimulus
    parameter : {"c_e", "alpha"}
    levels : (float, float)
        Ratios nearest to 1 and farthest from it, on one side of 1. They bound the levels and the threshold.
    trials : int
        Without practice; a multiple of `blocks`.
    catch : int
        As for `Staircase`, at the farthest level.
    mode, hold, interval, practice, blocks
        As for `ComparisonDesign`. Practice is at the farthest level.

    Raises
    ------
    ValueError
        If a level is not above 0 or is 1, the two are not on one side of 1 in this order, a number is out of
        range, `trials` is not a multiple of `blocks`, or the varied parameter cannot be felt.
    TypeError
        If the reference is not a Stimulus, or a number is not whole.

    Notes
    -----
    For 1000 observers drawn from the prior, the 95 % intervals held the threshold of 952, 940 and 947 after
    30, 60 and 120 trials. For a Gaussian observer with 2 % lapses and a threshold of 1.05, 1.1, 1.2 or 1.5
    they held it in 96.5 to 98.4 % of 1000 runs of 60 trials. The difference was found to a factor of 1.26 to
    1.31 (standard deviation), 2 to 8 % too small.

    References
    ----------
    L. L. Kontsevich, C. W. Tyler, Bayesian adaptive estimation of psychometric slope and threshold, Vision
    Research 39 (1999) 2729-2737. A. B. Watson, QUEST+: a general multidimensional Bayesian adaptive
    psychometric method, Journal of Vision 17(3) (2017) 10.

    Examples
    --------
    >>> from burrlab import materials
    >>> from burrlab.psychophysics.designs import Stimulus
    >>> design = AdaptiveStaircase(Stimulus("bone", materials["bone"]), "c_e", trials=30)
    >>> order = design.order(seed=1, subject="01")
    >>> while (trial := order.next()) is not None:
    ...     order.answer(trial.correct if trial.level > 1.2 else "first")
    >>> print(design.threshold(*zip(*[(t.level, t.correct == said) for t, said in order.answered])))
    75 % correct at a ratio of 1.15, with 95 % between 1.05 and 1.25 (30 trials)
    """

    _kind = "adaptive"

    _: KW_ONLY
    levels: tuple[float, float] = (1.02, 2.0)
    trials: int = 60
    catch: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse(len(self.levels) != 2, f"levels must be two, the nearer to 1 first, got {len(self.levels)}")
        near, far = (checked_level("levels", level) for level in self.levels)
        refuse(
            not math.log(far) / math.log(near) > 1.0,
            f"levels must be on one side of 1, the nearer first, got {near:g} and {far:g}",
        )
        object.__setattr__(self, "levels", (near, far))

    def easy_level(self) -> float:
        return self.levels[1]

    def extremes(self) -> Sequence[float]:
        return self.levels

    def track(self) -> "AdaptiveTrack":
        return AdaptiveTrack(self)

    def threshold(
        self, levels: Sequence[float], correct: Sequence[bool], *, level: float = 0.95
    ) -> PosteriorThreshold:
        """The threshold from the answers of the main phase, with a credible interval of probability `level`.

        Raises
        ------
        ValueError
            If `levels` and `correct` differ in number, a level is not between this staircase's two, or
            `level` is not in [0.5, 1).
        """
        near, far = (abs(math.log(end)) for end in self.levels)
        side, posterior = math.copysign(1.0, math.log(self.levels[1])), ThresholdPosterior(near, far)
        check_level(level)
        for ratio, right in zip(*checked_answers(levels, correct), strict=True):
            refuse(
                not near * (1 - 1e-6) <= math.log(ratio) * side <= far * (1 + 1e-6),
                f"levels must be between {self.levels[0]:g} and {self.levels[1]:g}, got {ratio:.6g}",
            )
            posterior.update(abs(math.log(ratio)), right)
        return posterior.threshold(side, len(levels), level)

    def power(self, subjects: int = 1) -> str:
        """Lines on how well a given observer's threshold is found, by about a second of simulation."""
        middle = math.sqrt(math.prod(abs(math.log(level)) for level in self.levels))
        return (
            f"{self.what}; {self.trials} trials\n"
            f"{precision(self._measure, middle, 'the middle of the levels', subjects)}"
        )


class AdaptiveTrack:
    """State of a Bayesian staircase."""

    def __init__(self, design: AdaptiveStaircase) -> None:
        near, far = (math.log(level) for level in design.levels)
        self.posterior = ThresholdPosterior(abs(near), abs(far))
        self._side, self._trials = math.copysign(1.0, far), design.trials
        self._left, self._difference = design.trials, self.posterior.most_informative()

    def level(self) -> float | None:
        return math.exp(self._side * self._difference) if self._left else None

    def update(self, correct: bool) -> None:
        self._left -= 1
        self.posterior.update(self._difference, correct)
        self._difference = self.posterior.most_informative()

    def threshold(self) -> PosteriorThreshold:
        return self.posterior.threshold(self._side, self._trials - self._left)


#: An observer: whether the answer at a difference |ln level| is correct.
Answers: TypeAlias = Callable[[float], bool]
Threshold: TypeAlias = StaircaseThreshold | PosteriorThreshold

_RUNS = 200
_D_PRIME = float(rule_of("2ifc", "independent-observations").invert(0.75, 0.25)[0])  # 0.954 at threshold


def gaussian_correct(difference: float, threshold: float, lapse: float = LAPSE) -> float:
    """Proportion correct with Gaussian noise on the logarithm, and lapses that guess.

    It is Phi(d'/sqrt 2) without lapses, d' = 0.954 at threshold.

    Examples
    --------
    >>> round(gaussian_correct(0.1, 0.1, lapse=0.0), 12)
    0.75
    """
    return float((1.0 - lapse) * ndtr(_D_PRIME * difference / threshold / math.sqrt(2.0)) + 0.5 * lapse)


def gaussian_difference(proportion: float, threshold: float, lapse: float = LAPSE) -> float:
    """The difference at which `gaussian_correct` is this proportion."""
    return threshold * (math.sqrt(2.0) * float(ndtri((proportion - 0.5 * lapse) / (1.0 - lapse)))) / _D_PRIME


def precision(
    estimate: Callable[[Answers], Threshold],
    threshold: float,
    where: str,
    subjects: int,
    target: float | None = None,
) -> str:
    """Lines on simulated runs of an observer, by their estimates; one that is open is none."""
    draws = np.random.default_rng(0)
    runs = [
        estimate(lambda difference: draws.random() < gaussian_correct(difference, threshold))
        for _ in range(_RUNS)
    ]
    sought = threshold if target is None else gaussian_difference(target, threshold)
    logs = [
        math.log(run.difference / sought)
        for run in runs
        if run.difference is not None
        and not (isinstance(run, PosteriorThreshold) and (run.open_below or run.open_above))
    ]
    lines = [
        f"{_RUNS} simulated runs ({np.mean([run.trials for run in runs]):.0f} trials on average) of an "
        "observer with Gaussian noise, "
        f"{100 * LAPSE:g} % lapses and 75 % correct at a ratio of {math.exp(threshold):.3g} ({where}):",
        f"{_RUNS - len(logs)} of them end without a threshold within the levels" * (len(logs) < _RUNS),
    ]
    if len(logs) > 1:
        spread, bias = float(np.std(logs, ddof=1)), float(np.mean(logs))
        lines += [
            f"the threshold's distance from 1 [ln] is found to a factor of {math.exp(spread):.2f} (standard "
            "deviation), "
            f"{100 * abs(math.expm1(bias)):.0f} % too {'large' if bias > 0 else 'small'} in the mean",
            f"that of {subjects} such subjects together to {math.exp(spread / math.sqrt(max(subjects, 1))):.2f}, and "
            "worse where they differ" * (subjects > 1),
        ]
    return "\n".join(filter(None, lines))


#: Designs by their names in files.
DESIGNS: Mapping[str, type[TaskDesign]] = {
    design._kind: design for design in (SameDifferent, ABX, ConstantStimuli, Staircase, AdaptiveStaircase)
}


def design_of_dict(values: Mapping[str, Any]) -> TaskDesign:
    """The design that `TaskDesign.to_dict` described.

    Raises
    ------
    ValueError
        If the design is unknown, or a value is missing or wrong.

    Examples
    --------
    >>> from burrlab import materials
    >>> from burrlab.psychophysics.designs import Stimulus
    >>> design = SameDifferent(*(Stimulus(name, materials[name]) for name in ("bone", "pvc")))
    >>> design_of_dict(design.to_dict()).to_dict() == design.to_dict()
    True
    """
    kind: Any = values.get("design")
    refuse(
        not isinstance(kind, str) or kind not in DESIGNS,
        f"design must be one of {', '.join(DESIGNS)}, got {shown(kind)}",
    )
    parameters = inspect.signature(DESIGNS[kind]).parameters
    present = {name: values[key_of(name)] for name in parameters if key_of(name) in values}
    with amend_error(f"design {kind} has a value that is missing or wrong: ", kinds=(KeyError, TypeError)):
        for name, x in present.items():
            if isinstance(x, Mapping):
                present[name] = Stimulus(x["name"], None if x.get("real") else material_of(x, x["material"]))
        return DESIGNS[kind](**present)
