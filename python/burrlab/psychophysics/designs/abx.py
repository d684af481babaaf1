"""Match to sample: a reference, then two alternatives, of which one matches it."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar

from burrlab.arguments import require_type
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
class ABX(Design):
    """The reference first, then a match and a foil: which of the two is as the reference? The paper's Task 3.

    The match (A) is first (AB) as often as second (BA), in random order. In each block too where its size is even; else
    within one.

    Parameters
    ----------
    reference : Stimulus
        Rendered, or a real specimen (no material).
    foil : Stimulus
        The alternative that is not to be taken for the reference.
    match : Stimulus, optional
        The alternative that is correct: by default the reference itself. Must be given for a real specimen.
    trials : int
        Even, and a multiple of `blocks`.
    interval : float
        Length of the intervals of the two alternatives [s].
    reference_interval : float, optional
        That of the reference [s]; None: until the subject ends it.
    mode : {"probing", "drilling"}
        With the burr off, or on.
    practice : int
        Trials before the first block, balanced as far as they go; they do not count.
    blocks : int
        With a break between them.

    Attributes
    ----------
    chance : float
        Proportion correct of a subject who guesses.

    Raises
    ------
    ValueError
        If the match of a real reference is not given, match or foil is a real specimen, they have one name, `trials` is
        odd or no multiple of `blocks`, a number is out of range or the mode unknown.
    TypeError
        If a stimulus is no Stimulus, or a number of trials is not whole.

    Examples
    --------
    >>> from burrlab import materials
    >>> pettigrew, pvc = (Stimulus(name, materials[name]) for name in ("pettigrew", "pvc"))
    >>> task = ABX(Stimulus("real Pettigrew"), foil=pvc, match=pettigrew)
    >>> trial = task.order(seed=1, subject="01").next()
    >>> trial.trial_type, [interval.stimulus.name for interval in trial.intervals], trial.correct
    ('BA', ['real Pettigrew', 'pvc', 'pettigrew'], 'second')
    """

    reference: Stimulus
    foil: Stimulus
    _: KW_ONLY
    match: Stimulus | None = None
    trials: int = 10
    interval: float = 10.0
    reference_interval: float | None = None
    mode: Mode = "drilling"
    practice: int = 0
    blocks: int = 1

    task = "abx"
    question = "After the reference came two: which of them felt like the reference?"
    answers = ("first", "second")
    chance: ClassVar[float] = 0.5

    def __post_init__(self) -> None:
        require_type("reference", self.reference, Stimulus, "Stimulus('real Pettigrew')")
        if self.match is None:
            if self.reference.material is None:
                raise ValueError(
                    f"match must be given, as the reference {self.reference.name!r} is a real specimen"
                )
            object.__setattr__(self, "match", self.reference)
        rendered("match", self.matching)
        rendered("foil", self.foil)
        if self.matching.name == self.foil.name:
            raise ValueError(f"match and foil must have different names, got {self.foil.name!r} twice")
        balanced_trials(self.trials, self.blocks, self.practice, multiple=2, types="AB and BA")
        object.__setattr__(self, "interval", seconds("interval", self.interval))
        if self.reference_interval is not None:
            length = seconds("reference_interval", self.reference_interval)
            object.__setattr__(self, "reference_interval", length)
        one_of("mode", self.mode, MODES)

    @property
    def matching(self) -> Stimulus:
        """The alternative that is correct."""
        return self.reference if self.match is None else self.match

    def order(self, *, seed: int, subject: str) -> FixedOrder:
        draws = Draws(seed, subject, self.to_dict())

        def make(kind: str, number: int, phase: Phase, block: int) -> Trial:
            pair = [self.matching if letter == "A" else self.foil for letter in kind]
            intervals = (
                Interval(self.reference, draws.interval_seed(), self.reference_interval),
                *(Interval(stimulus, draws.interval_seed(), self.interval) for stimulus in pair),
            )
            return Trial(number, phase, block, kind, intervals, self.answers[kind.index("A")])

        return fixed_order(
            draws, (("AB",), ("BA",)), make,
            trials=self.trials, blocks=self.blocks, practice=self.practice, answers=self.answers,
        )  # fmt: skip

    def power(self, subjects: int = 1) -> str:
        from burrlab.psychophysics.statistics.power import design_power

        what = (
            f"reference {self.reference.name}, then match {self.matching.name} and foil {self.foil.name} for "
            f"{self.interval:g} s each ({self.mode}), chance {self.chance:g}"
        )
        return f"{what}\n{design_power(self.task, trials=self.trials, subjects=subjects)}"

    def to_dict(self) -> dict[str, Any]:
        return {
            "design": "abx",
            "reference": stimulus_dict(self.reference),
            "match": stimulus_dict(self.matching),
            "foil": stimulus_dict(self.foil),
            "chance": self.chance,
            "trials": self.trials,
            "interval_s": self.interval,
            "reference_interval_s": self.reference_interval,
            "mode": self.mode,
            "practice": self.practice,
            "blocks": self.blocks,
        }
