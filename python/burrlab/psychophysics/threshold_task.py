"""Thresholds of each subject and of the group, in a task that varies a parameter around a reference."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
import scipy

from burrlab.common.check import refuse
from burrlab.common.figures import POSITION, REFERENCE, VELOCITY, Axes, drawing, styled
from burrlab.psychophysics.answers import Answers
from burrlab.psychophysics.designs import TaskDesign
from burrlab.psychophysics.psychometric import PosteriorThreshold, PsychometricFit, psychometric_function
from burrlab.psychophysics.scored_task import (
    OneSubject,
    Progress,
    SubjectData,
    TaskData,
    TaskResult,
    level_counts,
    of_subjects,
    room_for,
    shared,
)
from burrlab.psychophysics.staircase import (
    AdaptiveStaircase,
    ConstantStimuli,
    Staircase,
    StaircaseThreshold,
    design_of_dict,
)

_CLIPPED = 0.01  # share of an interval's ticks in contact

Estimate: TypeAlias = StaircaseThreshold | PosteriorThreshold | PsychometricFit


@dataclass(frozen=True)
class SubjectThreshold(OneSubject):
    """`OneSubject` with a threshold.

    Attributes
    ----------
    trials : int
        Answered trials of the main phase.
    levels : tuple of (float, int, int)
        Ratio to the reference's parameter, correct answers, trials.
    threshold : float or None
        Ratio to the reference's parameter.
    interval : (float, float) or None
        None if the method gives no interval.
    said : str
        The estimate in words.
    estimate : StaircaseThreshold, PosteriorThreshold, PsychometricFit or None
        None if nothing could be fitted.
    day : str
        Day on which the run began, UTC; empty if unknown.
    catch : (float, int, int) or None
        Of the catch trials, as in `levels`; None without.
    clipped : tuple of (float, int, int)
        Those of `levels` in whose intervals limits shortened the force in more than 1 % of the ticks.
    pressed : float or None
        Mean force over the intervals of the main phase [N], if the file has forces.
    """

    trials: int
    levels: tuple[tuple[float, int, int], ...]
    threshold: float | None
    interval: tuple[float, float] | None
    said: str
    estimate: Estimate | None
    day: str = ""
    catch: tuple[float, int, int] | None = None
    clipped: tuple[tuple[float, int, int], ...] = ()
    pressed: float | None = None

    @property
    def complete(self) -> bool:
        """Whether all planned trials were answered."""
        return self.planned is None or self.trials >= self.planned

    def rendered(self) -> list[tuple[float, int, int]]:
        """`levels` without what is `clipped`, then the catch trials."""
        out = {level: (right, trials) for level, right, trials in self.clipped}
        left = [(x, right - out.get(x, (0, 0))[0], n - out.get(x, (0, 0))[1]) for x, right, n in self.levels]
        return [row for row in (*left, self.catch) if row is not None and row[2]]


@dataclass(frozen=True)
class ThresholdTask(TaskResult[SubjectThreshold]):
    """The `TaskResult` of constant stimuli or a staircase; its subjects are SubjectThreshold."""

    subjects: tuple[SubjectThreshold, ...]  # declared again: records are read back by the declared types

    task: ClassVar[str] = "2ifc"

    @classmethod
    def of_data(
        cls, data: TaskData, *, level: float, incomplete: bool, progress: Progress | None = None
    ) -> "ThresholdTask":
        """The result of the task; incomplete runs are left out unless `incomplete`."""
        design = design_of_dict(data.design) if data.design else None
        results = []
        for subject in data.subjects:
            if subject.counts:
                if progress is not None:
                    progress(data.name, subject.subject)
                results.append(_threshold(subject, design, level))
        return cls(**shared(data, level, [result for result in results if incomplete or result.complete]))

    @property
    def group_threshold(self) -> tuple[float, float, float] | None:
        """(threshold, lower end, upper end) of the group, with the subject as the unit, or None.

        |ln threshold| is the geometric mean of |ln ratio|, with its t interval. None: fewer than two
        thresholds, thresholds on both sides of 1, or all equal.
        """
        logs = [
            math.log(subject.threshold) for subject in self.subjects if subject.threshold not in (None, 1.0)
        ]
        if len(logs) < 2 or len({x > 0 for x in logs}) > 1 or len(set(logs)) == 1:
            return None
        side, values = math.copysign(1.0, logs[0]), np.log(np.abs(logs))
        mean, error = float(values.mean()), float(scipy.stats.sem(values))
        wide = float(scipy.stats.t.ppf(0.5 + 0.5 * self.level, len(values) - 1)) * error
        with np.errstate(over="ignore"):  # few subjects who differ much have an open interval
            threshold, near, far = np.exp(side * np.exp([mean, mean - wide, mean + wide]))
        return float(threshold), float(near), float(far)

    @drawing
    def plot_psychometric(self, ax: Axes | None = None, *, subject: str | None = None, **style: Any) -> Axes:
        """A subject's proportion correct over the ratio, with the fitted psychometric function.

        `style`: `label`, `color` and other properties of the curve.

        Parameters
        ----------
        subject : str, optional
            By default the only one.

        Raises
        ------
        ValueError
            If the subject is unknown, is left out among several, or has no fitted psychometric function.
        """
        refuse(
            subject is None and len(self.subjects) != 1,
            f"subject must be given, one of {', '.join(chosen.subject for chosen in self.subjects)}",
        )
        chosen = self.subjects[0] if subject is None else self.subject(subject)
        if not isinstance(chosen.estimate, PsychometricFit):
            raise ValueError(f"subject {chosen.subject} has no psychometric function: {chosen.said}")
        axes = chosen.estimate.plot(ax, **style)
        axes.set_title(f"{self.title}, subject {chosen.subject}")
        return axes

    @drawing
    def plot_thresholds(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Each subject's threshold with any interval, and the group's.

        `style`: `label`, `color` and other properties of the subjects' marks.

        Raises
        ------
        ValueError
            If no subject has a threshold.
        """
        thresholds = [
            (subject.subject, subject.threshold, subject.interval)
            for subject in self.subjects
            if subject.threshold
        ]
        refuse(not thresholds, f"task {self.name} must hold a threshold to be drawn, got none")
        ax = room_for(ax, len(self.subjects))
        names, rows = [name for name, *_ in thresholds], np.arange(len(thresholds), dtype=np.float64)
        look = styled(style, color=POSITION, marker="o", markersize=4.5)
        for (_, threshold, interval), at in zip(thresholds, rows, strict=True):
            if interval is not None:
                ax.plot(interval, [at, at], "|-", color=look["color"], linewidth=1.2, markersize=5)
            ax.plot(threshold, at, **look)
            look["label"] = None
        if (group := self.group_threshold) is not None:
            row = len(rows) + 0.4
            names, rows = [*names, "all"], np.append(rows, row)
            ax.axhline(row - 0.7, color="0.8", linewidth=0.8)
            ax.plot(group[1:], [row, row], "|-", color=VELOCITY, linewidth=1.2, markersize=5)
            ax.plot(group[0], row, "D", color=VELOCITY, markersize=5)
        ax.axvline(1.0, color=REFERENCE, linestyle="--", linewidth=1, label="the reference")
        some = any(interval is not None for *_, interval in thresholds) or group is not None
        ending = f", {100 * self.level:g} % interval" if some else ""
        what = self.design.get("parameter", "the parameter")
        ax.set_xlabel(f"threshold, {what} over the reference's [1]{ending}")
        return of_subjects(ax, names, rows, self.title)

    def __repr__(self) -> str:
        kind = "simulated subjects" if self.simulated else "subjects"
        return f"ThresholdTask({self.name!r}, {self.design.get('design', self.task)}, {len(self.subjects)} {kind})"


def _threshold(subject: SubjectData, design: TaskDesign | None, level: float) -> SubjectThreshold:
    rows = [row for row in subject.answers.main if row.level is not None] if subject.answers else []
    levels, correct = [row.level or 1.0 for row in rows], [row.correct for row in rows]
    planned, text, threshold, interval = subject.planned, "", None, None
    estimate: Estimate | None
    if isinstance(design, Staircase):
        estimate = reversals = design.threshold(levels, correct)
        # A staircase may end before its last trial.
        planned, threshold = None if reversals.complete else planned, reversals.level
    elif isinstance(design, AdaptiveStaircase):
        estimate = posterior = design.threshold(levels, correct, level=level)
        threshold, interval = posterior.level, posterior.interval
    else:
        estimate, text = fit, text = _fitted(subject, design, level)
        if fit is not None:
            below = fit.side == "below"
            threshold, low, high = (1.0 / x if below else x for x in (fit.threshold, *fit.interval))
            interval = (low, high)
    return SubjectThreshold(
        subject.subject, planned, subject.simulated, subject.trials, subject.levels, threshold, interval, text or str(estimate),
        estimate, **_beside(subject.answers),
    )  # fmt: skip


def _beside(answers: Answers | None) -> dict[str, Any]:
    """Day, catch trials, clipped trials and pressed force of a run."""
    if answers is None:
        return {}
    catch = level_counts(row for row in answers.rows if row.phase == "catch" and not row.lost)
    clipped = (row for row in answers.main if any((share or 0.0) > _CLIPPED for share in row.clipped))
    forces = [force for row in answers.main for force in row.forces if force is not None]
    return {
        "pressed": sum(forces) / len(forces) if forces else None,
        "day": "" if answers.side_car is None else answers.side_car.started[:10],
        "catch": catch[0] if catch else None,
        "clipped": level_counts(clipped),
    }


def _fitted(
    subject: SubjectData, design: TaskDesign | None, level: float
) -> tuple[PsychometricFit | None, str]:
    """The psychometric function and its text, or None and the reason."""
    known: dict[str, Any] = (
        {"parameter": design.parameter, "reference": getattr(design.reference.material, design.parameter)}
        if isinstance(design, ConstantStimuli)
        else {}
    )
    ratios, correct, trials = zip(*subject.levels, strict=True)
    try:
        fit = psychometric_function(ratios, correct, trials, level=level, **known)
    except (ImportError, ValueError) as error:
        return None, f"no psychometric function: {error}"
    return fit, str(fit)
