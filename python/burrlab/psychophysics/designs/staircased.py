"""What staircases have in common: levels that follow the answers, orders and seeds that do not."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

from burrlab.psychophysics.design import Order
from burrlab.psychophysics.designs.comparison import Comparison
from burrlab.psychophysics.designs.orders import Draws, checked_trial
from burrlab.psychophysics.trial import Phase, Trial

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
