"""The method of constant stimuli: given levels, each equally often."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

from burrlab.psychophysics.designs.comparison import Comparison
from burrlab.psychophysics.designs.design_checks import checked_level, whole
from burrlab.psychophysics.designs.orders import Draws, FixedOrder, fixed_order
from burrlab.psychophysics.trial import Phase, Trial


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
        from burrlab.psychophysics.designs.precision import constant_stimuli_precision

        first = f"{self.what}; {len(self.levels)} levels of {self.repeats} trials each"
        return f"{first}\n{constant_stimuli_precision(self, subjects)}"

    def to_dict(self) -> dict[str, Any]:
        return {
            "design": "constant-stimuli",
            **super().to_dict(),
            "levels": list(self.levels),
            "repeats": self.repeats,
        }
