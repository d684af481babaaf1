"""Where a subject sits: what a run shows and asks, of a person at a terminal or of a simulated subject."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING

from burrlab.psychophysics.design import Design
from burrlab.psychophysics.trial import Interval, Trial

if TYPE_CHECKING:
    from burrlab.psychophysics.experiment.interval import Rendered


class Seat(ABC):
    """What a run shows and asks. Nothing that it is given tells a material, a pair type or a score.

    Attributes
    ----------
    wall_clock : bool
        Intervals last as long as they say; else they go as fast as they can.
    simulated : bool
        Nobody sits here.
    """

    wall_clock: bool = True
    simulated: bool = False

    def stand_in(self, interval: Interval) -> Interval:
        """What is rendered for an interval: itself, unless nobody is here who could feel a real specimen."""
        return interval

    @abstractmethod
    def progress(self, text: str) -> None:
        """The line that stays on the screen from now on."""

    @abstractmethod
    def ready(self, text: str) -> None:
        """Shows the text until the subject wants to go on."""

    @abstractmethod
    def show(self, text: str) -> None:
        """Shows the text until something else is shown."""

    @abstractmethod
    def begins(self, text: str) -> None:
        """An interval begins."""

    @abstractmethod
    def ends(self, text: str, pause: float) -> None:
        """The interval has ended; for so long nothing happens [s]."""

    @abstractmethod
    def done(self) -> bool:
        """Whether the subject has ended the interval, since it began."""

    @abstractmethod
    def ask(
        self, design: Design, trial: Trial, rendered: Sequence[Rendered | None]
    ) -> tuple[str, float | None]:
        """(one of the design's answers, time from the question to it [s]; None where no key was pressed)."""

    @abstractmethod
    def tell(self, text: str) -> None:
        """A sentence for a moment."""

    @abstractmethod
    def rest(self, text: str, seconds: float) -> None:
        """A break, at least so long [s], and until the subject wants to go on."""

    @abstractmethod
    def close(self, text: str) -> None:
        """The last words; the seat is as it was found."""
