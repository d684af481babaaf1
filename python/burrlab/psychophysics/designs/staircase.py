"""Transformed and weighted up-down staircases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, asdict, dataclass
from typing import Any

import numpy as np

from burrlab.psychophysics.designs.design_checks import checked_answers, checked_level, whole
from burrlab.psychophysics.designs.staircased import Staircased

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
        from burrlab.psychophysics.designs.precision import staircase_precision

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
