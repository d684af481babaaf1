"""The answers of one subject in one task, counted."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from burrlab.psychophysics.rules import TASKS, TaskName


@dataclass(frozen=True)
class Counts:
    """Hits and false alarms; which answer they are of, `Rule` says.

    Parameters
    ----------
    task : {"same-different", "abx", "2ifc"}
    hits, signals : int
        Of the answer where it was correct; trials in which it was.
    false_alarms, noises : int
        Of the answer where it was not; trials in which it was not.
    by_type : mapping of str to (int, int), optional
        trial_type -> (times the answer was given, trials), where the types were counted.

    Raises
    ------
    ValueError
        If the task is unknown, a number is negative or more than its trials, there is no trial, or `by_type` does not sum to the same.
    TypeError
        If a number is not whole.

    Examples
    --------
    >>> counts = Counts("same-different", hits=6, signals=8, false_alarms=2, noises=8)
    >>> counts.score, counts.hit_rate, counts.false_alarm_rate
    (12, 0.75, 0.25)
    """

    task: TaskName
    hits: int
    signals: int
    false_alarms: int
    noises: int
    by_type: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.task not in TASKS:
            raise ValueError(f"task must be one of {', '.join(TASKS)}, got {self.task!r}")
        for name in ("hits", "signals", "false_alarms", "noises"):
            value = operator.index(getattr(self, name))
            object.__setattr__(self, name, value)
            if value < 0:
                raise ValueError(f"{name} must be at least 0, got {value}")
        for name, most in (("hits", "signals"), ("false_alarms", "noises")):
            if getattr(self, name) > getattr(self, most):
                raise ValueError(
                    f"{name} must be at most {most}, {getattr(self, most)}, got {getattr(self, name)}"
                )
        if self.trials == 0:
            raise ValueError("signals and noises must hold a trial, got 0 and 0")
        types = {str(k): (operator.index(n), operator.index(m)) for k, (n, m) in self.by_type.items()}
        if types and (
            sum(n for n, _ in types.values()) != self.hits + self.false_alarms
            or sum(m for _, m in types.values()) != self.trials
        ):
            raise ValueError("by_type must sum to the hits, false alarms and trials")
        object.__setattr__(self, "by_type", MappingProxyType(types))

    @property
    def trials(self) -> int:
        return self.signals + self.noises

    @property
    def score(self) -> int:
        """Correct answers."""
        return self.hits + self.noises - self.false_alarms

    @property
    def hit_rate(self) -> float:
        """NaN without such trials, as the next."""
        return self.hits / self.signals if self.signals else float("nan")

    @property
    def false_alarm_rate(self) -> float:
        return self.false_alarms / self.noises if self.noises else float("nan")
