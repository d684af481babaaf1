"""A reference and a comparison with one parameter changed, in two intervals: which has more?"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal, TypeAlias

from burrlab._core import Material
from burrlab.psychophysics.design import Design
from burrlab.psychophysics.designs.design_checks import (
    checked_level,
    one_of,
    rendered,
    seconds,
    stimulus_dict,
    whole,
)
from burrlab.psychophysics.designs.orders import Draws
from burrlab.psychophysics.trial import MODES, Interval, Mode, Phase, Stimulus, Trial

Parameter: TypeAlias = Literal["c_e", "alpha"]
Hold: TypeAlias = Literal["other", "sinking speed"]

#: Of a parameter.
UNITS = {"c_e": "N/mm^2", "alpha": "1/ms"}
STIFFER = "In which interval was the material stiffer, the first or the second?"
FASTER = "In which interval did the burr sink faster, the first or the second?"


@dataclass(frozen=True)
class Comparison(Design):
    """What designs have in common that vary c_e or alpha around a reference, in two intervals (2ifc).

    A `level` is the comparison's parameter as its ratio to the reference's. What is asked follows from what is varied:

    * c_e with the burr off: which is stiffer, and c_e alone is felt;
    * c_e drilled, alpha held (`hold="other"`): in which the burr sinks faster, which is that of *less* c_e; the
      stiffness changes as well;
    * c_e drilled, alpha/c_e^p held (`hold="sinking speed"`): which is stiffer. p = 4 (k + 1)/3 for an f with a zero of
      order k: 8/3 for the parabolic. The speed stays at forces below 0.068 c_e R^2: bone with a burr of 3 mm at 1 N within
      1 % for levels of 0.75 to 1.3 (mean-field), at 2 N 10 % faster to 17 % slower;
    * alpha drilled: in which the burr sinks faster, that of more alpha.

    Parameters
    ----------
    reference : Stimulus
        With a material.
    parameter : {"c_e", "alpha"}
        What is varied.
    mode : {"probing", "drilling"}
        With the burr off, or on.
    hold : {"other", "sinking speed"}
        What stays: the other parameter, or the speed at which the burr sinks.
    interval : float
        Length of an interval [s].
    practice : int
        Trials before the first block; they do not count.
    blocks : int
        With a break between them.

    Attributes
    ----------
    question : str
    chance : float
        Proportion correct of a subject who guesses.
    """

    reference: Stimulus
    parameter: Parameter
    _: KW_ONLY
    mode: Mode = "probing"
    hold: Hold = "other"
    interval: float = 20.0
    practice: int = 0
    blocks: int = 1

    task = "2ifc"
    answers = ("first", "second")
    chance = 0.5

    def __post_init__(self) -> None:
        rendered("reference", self.reference)
        one_of("parameter", self.parameter, ("c_e", "alpha"))
        one_of("mode", self.mode, MODES)
        one_of("hold", self.hold, ("other", "sinking speed"))
        if self.parameter == "alpha" and self.mode == "probing":
            raise ValueError(
                "mode must be 'drilling' for parameter 'alpha', got 'probing': alpha alone changes nothing with the burr off"
            )
        if self.hold == "sinking speed" and self.parameter == "alpha":
            raise ValueError(
                "hold must be 'other' for parameter 'alpha', got 'sinking speed': alpha is felt by that speed alone"
            )
        if self.hold == "sinking speed" and self.mode == "probing":
            raise ValueError(
                "hold must be 'other' for mode 'probing', got 'sinking speed': nothing sinks with the burr off"
            )
        for name in ("c_e", "alpha"):
            if getattr(self._material, name) == 0.0:
                raise ValueError(f"reference must have {name} above 0, got 0")
        object.__setattr__(self, "interval", seconds("interval", self.interval))
        whole("practice", self.practice, at_least=0)
        whole("blocks", self.blocks, at_least=1)
        object.__setattr__(self, "question", FASTER if self._asks_speed else STIFFER)

    @property
    def _material(self) -> Material:
        assert self.reference.material is not None
        return self.reference.material

    @property
    def _asks_speed(self) -> bool:
        return self.mode == "drilling" and self.hold == "other"

    @property
    def held(self) -> str:
        """What stays the same between reference and comparison, in words."""
        material = self._material
        if self.parameter == "alpha":
            return f"c_e is held at {material.c_e:g} N/mm^2"
        if self.hold == "sinking speed":
            return f"alpha/c_e^{self._exponent:.3g} is held, and with it the sinking speed at forces below 0.068 c_e R^2"
        held = f"alpha is held at {material.alpha:g} /ms"
        return held if self.mode == "probing" else f"{held}; stiffness and sinking speed both change"

    @property
    def what(self) -> str:
        """What is varied around what and what is held, in words."""
        return f"{self.parameter} around {self.reference.name} ({self.mode}; {self.held}), chance {self.chance:g}"

    @property
    def _exponent(self) -> float:
        """p of v ~ alpha/c_e^p at small forces: 4 (k + 1)/3 for an f with a zero of order k at r = R."""
        return 4.0 * (self._material.shape.order + 1.0) / 3.0

    def comparison(self, level: float) -> Stimulus:
        """The stimulus of a level."""
        level = checked_level("level", level)
        c_e, alpha = self._material.c_e, self._material.alpha
        if self.parameter == "alpha":
            alpha *= level
        else:
            c_e *= level
            if self.hold == "sinking speed":
                alpha *= level**self._exponent
        name = f"{self.reference.name} {self.parameter} x{level:.6g}"
        source = f"{self._material.name} with {self.parameter} times {level:.17g}; {self.held}"
        return Stimulus(name, Material(name, c_e=c_e, alpha=alpha, shape=self._material.shape, source=source))

    def trial(self, kind: str, level: float, number: int, phase: Phase, block: int, draws: Draws) -> Trial:
        """Reference and comparison in the order of `kind`, RC or CR."""
        shown = {"R": self.reference, "C": self.comparison(level)}
        intervals = tuple(Interval(shown[x], draws.interval_seed(), self.interval) for x in kind)
        # A comparison of more c_e sinks more slowly.
        slower = self._asks_speed and self.parameter == "c_e"
        more = "C" if (level > 1.0) != slower else "R"
        return Trial(number, phase, block, kind, intervals, self.answers[kind.index(more)], level)

    def to_dict(self) -> dict[str, Any]:
        return {
            "reference": stimulus_dict(self.reference),
            "parameter": self.parameter,
            "mode": self.mode,
            "hold": self.hold,
            "held": self.held,
            "question": self.question,
            "chance": self.chance,
            "interval_s": self.interval,
            "practice": self.practice,
            "blocks": self.blocks,
        }
