"""Same or different: two intervals, two materials."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

from burrlab.psychophysics.design import Design
from burrlab.psychophysics.designs.design_checks import (
    balanced_trials,
    one_of,
    rendered,
    seconds,
    stimulus_dict,
)
from burrlab.psychophysics.designs.orders import Draws, FixedOrder, fixed_order
from burrlab.psychophysics.trial import MODES, Interval, Mode, Phase, Stimulus, Trial


@dataclass(frozen=True)
class SameDifferent(Design):
    """Two intervals with a or b in each; was it the same material twice, or two? The paper's Tasks 1 and 2.

    AA, AB, BA and BB are equally often, in random order. In each block they are too where its size is a multiple of
    four; else as often as one another within one, with as many pairs that differ as are the same, within one.

    Parameters
    ----------
    a, b : Stimulus
        With a material each, and different names.
    trials : int
        A multiple of 4, and of `blocks`.
    interval : float
        Length of an interval [s].
    mode : {"probing", "drilling"}
        With the burr off, or on.
    practice : int
        Trials before the first block, balanced as far as they go; they do not count.
    blocks : int
        With a break between them.

    Raises
    ------
    ValueError
        If a or b is a real specimen, they have one name, `trials` is no multiple of 4 or of `blocks`, a number is out of
        range or the mode unknown.
    TypeError
        If a or b is no Stimulus, or a number of trials is not whole.

    Examples
    --------
    >>> from burrlab import materials
    >>> bone, pvc = (Stimulus(name, materials[name]) for name in ("bone", "pvc"))
    >>> order = SameDifferent(bone, pvc).order(seed=1, subject="01")
    >>> [trial.trial_type for trial in order.trials]
    ['BA', 'BA', 'AB', 'BB', 'AA', 'AB', 'BA', 'AA', 'BB', 'AA', 'AB', 'BB']
    """

    a: Stimulus
    b: Stimulus
    _: KW_ONLY
    trials: int = 12
    interval: float = 20.0
    mode: Mode = "probing"
    practice: int = 0
    blocks: int = 1

    task = "same-different"
    question = "Was it the same material twice, or two different ones?"
    answers = ("same", "different")

    def __post_init__(self) -> None:
        rendered("a", self.a)
        rendered("b", self.b)
        if self.a.name == self.b.name:
            raise ValueError(f"a and b must have different names, got {self.a.name!r} twice")
        balanced_trials(self.trials, self.blocks, self.practice, multiple=4, types="AA, AB, BA, BB")
        object.__setattr__(self, "interval", seconds("interval", self.interval))
        one_of("mode", self.mode, MODES)

    def order(self, *, seed: int, subject: str) -> FixedOrder:
        draws = Draws(seed, subject, self.to_dict())

        def make(kind: str, number: int, phase: Phase, block: int) -> Trial:
            pair = [self.a if letter == "A" else self.b for letter in kind]
            intervals = tuple(Interval(stimulus, draws.interval_seed(), self.interval) for stimulus in pair)
            return Trial(number, phase, block, kind, intervals, "same" if kind[0] == kind[1] else "different")

        return fixed_order(
            draws, (("AA", "BB"), ("AB", "BA")), make,
            trials=self.trials, blocks=self.blocks, practice=self.practice, answers=self.answers,
        )  # fmt: skip

    def power(self, subjects: int = 1) -> str:
        from burrlab.psychophysics.statistics.power import design_power

        what = f"{self.a.name} or {self.b.name} in two intervals of {self.interval:g} s ({self.mode}), chance 0.5"
        return f"{what}\n{design_power(self.task, trials=self.trials, subjects=subjects)}"

    def to_dict(self) -> dict[str, Any]:
        return {
            "design": "same-different",
            "a": stimulus_dict(self.a),
            "b": stimulus_dict(self.b),
            "trials": self.trials,
            "interval_s": self.interval,
            "mode": self.mode,
            "practice": self.practice,
            "blocks": self.blocks,
        }
