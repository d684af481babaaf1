"""A simulated subject in the place of a person."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from burrlab._core import Burr
from burrlab.psychophysics.design import Design
from burrlab.psychophysics.designs.abx import ABX
from burrlab.psychophysics.designs.orders import Draws
from burrlab.psychophysics.experiment.block import Block
from burrlab.psychophysics.experiment.interval import Rendered
from burrlab.psychophysics.experiment.seat import Seat
from burrlab.psychophysics.simulation.cues import CUES_OF, Cues, interval_cues
from burrlab.psychophysics.simulation.rehearsal import SELF_PACED, check_rehearsable, teach
from burrlab.psychophysics.simulation.simulated_subject import Decision, SimulatedSubject
from burrlab.psychophysics.simulation.weber import COMPLIANCE_WITHOUT_SURFACE
from burrlab.psychophysics.trial import Interval, Mode, Trial


def default_subject(
    mode: Mode, *, weber: float = COMPLIANCE_WITHOUT_SURFACE, decision: Decision = "differencing"
) -> SimulatedSubject:
    """Feels stiffness by probing, sinking speed by drilling; a Weber fraction for the speed is not published."""
    return SimulatedSubject(weber=weber, cues=CUES_OF[mode][:1], decision=decision)


class SimulatedSeat(Seat):
    """Feels each rendered interval's cues, and answers by a rule.

    Parameters
    ----------
    subject : SimulatedSubject
        Is taught the two materials of a same-different or ABX task first.
    design : Design
    burr : Burr
    bone : Block
    seed : int
        Of the experiment.
    name : str
        Of the subject; with seed, design and trial it determines the answer.
    on_progress : callable, optional
        Called with the progress line of each trial, for whoever waits.

    Notes
    -----
    The alternative that matches stands for a real specimen.
    """

    wall_clock = False
    simulated = True

    def __init__(
        self, subject: SimulatedSubject, design: Design, *, burr: Burr, bone: Block, seed: int, name: str,
        on_progress: Callable[[str], object] | None = None,
    ) -> None:  # fmt: skip
        self._on_progress = on_progress
        check_rehearsable(design)
        self._seed, self._name, self._design = seed, name, design
        self._subject = teach(subject, design, burr=burr, bone=bone)

    def stand_in(self, interval: Interval) -> Interval:
        stimulus = interval.stimulus
        if stimulus.material is None and isinstance(self._design, ABX):
            stimulus = self._design.matching
        duration = SELF_PACED if interval.duration is None else interval.duration
        return replace(interval, stimulus=stimulus, duration=duration)

    def ask(
        self, design: Design, trial: Trial, rendered: Sequence[Rendered | None]
    ) -> tuple[str, float | None]:
        cues = [Cues() if one is None else interval_cues(one) for one in rendered]
        what: dict[str, Any] = {**design.to_dict(), "phase": trial.phase, "trial": trial.number}
        draws = Draws(self._seed, self._name, {"simulated": what})
        return self._subject.respond(trial, cues, np.random.default_rng(draws.interval_seed())), None

    def progress(self, text: str) -> None:
        """Only who waits reads it."""
        if self._on_progress is not None:
            self._on_progress(text)

    def ready(self, text: str) -> None:
        """Nobody reads it, here and below."""

    def show(self, text: str) -> None: ...

    def begins(self, text: str) -> None: ...

    def ends(self, text: str, pause: float) -> None: ...

    def done(self) -> bool:
        return False

    def tell(self, text: str) -> None: ...

    def rest(self, text: str, seconds: float) -> None: ...

    def close(self, text: str) -> None: ...
