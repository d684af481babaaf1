"""A task that varies a parameter around a reference: each subject's threshold, and the group's."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy import stats

from burrlab.psychophysics.comparison import Staircased
from burrlab.psychophysics.records import plain
from burrlab.psychophysics.task_data import SubjectData, TaskData, design_text, left_out_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from burrlab.psychophysics.design import Design
    from burrlab.psychophysics.psychometric import PsychometricFit

WITHOUT_EXTRA = (
    "without the extra 'psychometric' no psychometric function is fitted: pip install 'burrlab[psychometric]'"
)


@dataclass(frozen=True)
class SubjectThreshold:
    """One subject.

    Attributes
    ----------
    subject : str
    simulated : bool
    trials : int
        Answered in the main phase.
    planned : int or None
        Main trials of the design; None where the answers end it, or it is not known.
    levels : tuple of (float, int, int)
        Ratio to the reference's parameter, correct answers, trials.
    threshold : float or None
        Ratio to the reference's parameter.
    interval : (float, float) or None
        Of the threshold, where the method has one.
    said : str
        The estimate in words.
    estimate : mapping
        All of it, as its `to_dict` has it.
    """

    subject: str
    simulated: bool
    trials: int
    planned: int | None
    levels: tuple[tuple[float, int, int], ...]
    threshold: float | None
    interval: tuple[float, float] | None
    said: str
    estimate: Mapping[str, Any]

    @property
    def complete(self) -> bool:
        """Whether all planned trials were answered."""
        return self.planned is None or self.trials >= self.planned


@dataclass(frozen=True)
class ThresholdTask:
    """Constant stimuli or a staircase.

    Attributes
    ----------
    name : str
    design : mapping
        As `Design.to_dict` has it.
    level : float
        Of all intervals.
    subjects : tuple of SubjectThreshold
    left_out : tuple of str
        Subjects whose run is incomplete, with how far they came.
    of : int
        Subjects that those here were selected from; 0 without selection, or where it is not known.
    selected_by : str
    """

    name: str
    design: Mapping[str, Any]
    level: float
    subjects: tuple[SubjectThreshold, ...]
    left_out: tuple[str, ...]
    of: int
    selected_by: str

    task: ClassVar[str] = "2ifc"
    chance: ClassVar[float] = 0.5

    @classmethod
    def of_data(
        cls, data: TaskData, design: Design | None, *, level: float, incomplete: bool
    ) -> ThresholdTask:
        """All of it; of incomplete runs only on request."""
        results = [_threshold(one, design, level) for one in data.subjects if one.counts]
        used = tuple(one for one in results if incomplete or one.complete)
        names = [one.subject for one in used]
        return cls(
            name=data.name,
            design=data.design,
            level=level,
            subjects=used,
            left_out=tuple(left_out_text(one) for one in data.subjects if one.subject not in names),
            of=data.of,
            selected_by=data.selected_by,
        )

    @property
    def simulated(self) -> bool:
        """Whether any subject was."""
        return any(one.simulated for one in self.subjects)

    @property
    def selected(self) -> bool:
        return bool(self.of or self.selected_by)

    @property
    def title(self) -> str:
        """Of figures: name, what is varied, and whether the subjects were simulated."""
        about = design_text(self.design)
        said = f"{self.name}: {about}" if about else self.name
        return f"{said} (simulated subjects)" if self.simulated else said

    @property
    def group_threshold(self) -> tuple[float, float, float] | None:
        """Threshold of the group with the ends of its interval, the subject as the unit; None of fewer than two.

        The geometric mean of the differences |ln ratio|, by t; None also where thresholds lie on both sides of 1.
        """
        logs = [math.log(one.threshold) for one in self.subjects if one.threshold not in (None, 1.0)]
        if len(logs) < 2 or len({x > 0 for x in logs}) > 1:
            return None
        side, values = math.copysign(1.0, logs[0]), np.log(np.abs(logs))
        mean, error = float(values.mean()), float(stats.sem(values))
        wide = float(stats.t.ppf(0.5 + 0.5 * self.level, len(values) - 1)) * error
        found = [math.exp(side * math.exp(x)) for x in (mean, mean - wide, mean + wide)]
        return found[0], found[1], found[2]

    def subject(self, name: str) -> SubjectThreshold:
        """One subject's result.

        Raises
        ------
        ValueError
            If there is none of that name.
        """
        for one in self.subjects:
            if one.subject == name:
                return one
        raise ValueError(
            f"subject must be one of {', '.join(one.subject for one in self.subjects)}, got {name!r}"
        )
