"""A task with a score, same-different or ABX: its subjects, and the group."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.report.subject_result import SubjectResult, holm
from burrlab.psychophysics.report.task_data import Progress, SubjectData, TaskData, left_out_text, told
from burrlab.psychophysics.report.task_result import TaskResult
from burrlab.psychophysics.rules import RuleName, TaskName
from burrlab.psychophysics.statistics.d_prime import DPrime, binomial_test, d_prime, score_interval
from burrlab.psychophysics.statistics.equivalence import Equivalence, equivalence
from burrlab.psychophysics.statistics.group import GroupScore, group_score
from burrlab.psychophysics.statistics.group_d_prime import GroupDPrime, group_d_prime
from burrlab.psychophysics.statistics.pair_checks import PairCheck, pair_checks
from burrlab.psychophysics.statistics.selection import SelectionEffect

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from burrlab.psychophysics.statistics.published_score import PublishedScore

CORRECTION: Literal["log-linear"] = "log-linear"


@dataclass(frozen=True)
class ScoredTask(TaskResult[SubjectResult]):
    """One task: its subjects, and the group with the subject as the unit; beside what every `TaskResult` has:

    Attributes
    ----------
    subjects : tuple of SubjectResult
    task : {"same-different", "abx", "2ifc"}
    rules : tuple of str
        Decision rules that d' is given under.
    delta : float or None
        d' that the equivalence test asks about.
    score : GroupScore or None
        None of a single subject.
    group_d_prime : tuple of GroupDPrime
        One a rule; none of a single subject.
    equivalence : tuple of Equivalence
        One a rule; none without a delta.
    checks : tuple of PairCheck
        Of the types of trials against one another, all subjects together; none where a subject's types were not counted.
    """

    subjects: tuple[SubjectResult, ...]  # again, since a record is read back by the declared types
    task: TaskName
    rules: tuple[RuleName, ...]
    delta: float | None
    score: GroupScore | None
    group_d_prime: tuple[GroupDPrime, ...]
    equivalence: tuple[Equivalence, ...]
    checks: tuple[PairCheck, ...]

    @classmethod
    def of_data(
        cls, data: TaskData, *, rules: Sequence[RuleName], delta: float | None, level: float, incomplete: bool,
        progress: Progress | None = None,
    ) -> ScoredTask:  # fmt: skip
        """All of it; of incomplete runs only on request."""
        used = [one for one in data.subjects if one.counts and (incomplete or one.complete)]
        # Both rules are one with two intervals.
        rules = tuple(rules[:1] if data.task == "2ifc" else rules)
        counts = [one.counts for one in used if one.counts is not None]
        several = len(used) > 1
        return cls(
            name=data.name,
            task=data.task,
            design=data.design,
            level=level,
            rules=rules,
            delta=delta,
            subjects=_results(used, rules, level, told(data.name, progress)),
            left_out=tuple(left_out_text(one) for one in data.subjects if one not in used),
            of=data.of,
            chosen=(data.chosen or len(data.subjects)) if data.of else 0,
            selected_by=data.selected_by,
            score=group_score(counts, level=level) if several else None,
            group_d_prime=tuple(group_d_prime(counts, rule=rule, level=level) for rule in rules if several),
            equivalence=tuple(
                equivalence(counts, rule=rule, delta=delta, level=level)
                for rule in rules
                if counts and delta is not None
            ),
            checks=tuple(pair_checks(counts)) if counts and all(map(_has_types, counts)) else (),
        )

    @property
    def trials(self) -> int | None:
        """Of each subject; None where they differ."""
        numbers = {one.counts.trials for one in self.subjects}
        return numbers.pop() if len(numbers) == 1 else None

    @property
    def selection(self) -> SelectionEffect | None:
        """What selection by this very score does to the mean; None without selection, or where it cannot be said."""
        if not self.subjects or self.trials is None or self.of <= self.chosen:
            return None
        return SelectionEffect(self.chosen, self.of, self.trials, self.chance)

    def plot_scores(self, ax: Axes | None = None, *, published: PublishedScore | None = None) -> Axes:
        """Histogram of the scores, with that expected at chance and mean ± s.e.m. (the paper's Figs. 7 and 8).

        Parameters
        ----------
        ax : matplotlib Axes, optional
        published : PublishedScore, optional
            A mean ± s.e.m. to be marked beside the subjects' own.

        Raises
        ------
        ValueError
            If there is no subject, subjects answered unequally many trials, or the published score is of another number.
        """
        from burrlab.psychophysics.report.plots import plot_scores

        self._some()
        return plot_scores(self, ax, published)

    def plot_intervals(self, ax: Axes | None = None, *, rule: str | None = None) -> Axes:
        """Each subject's proportion correct with its interval, and the chance line.

        Parameters
        ----------
        ax : matplotlib Axes, optional
        rule : {"independent-observations", "differencing"}, optional
            Draws d' under this rule instead; an interval that is open above is an arrow.

        Raises
        ------
        ValueError
            If there is no subject, or the analysis does not have the rule.
        """
        from burrlab.psychophysics.report.plots import plot_intervals

        self._some()
        return plot_intervals(self, ax, rule)

    def plot_d_prime(self, ax: Axes | None = None) -> Axes:
        """Each subject's d' under all rules, side by side, and the group's.

        Parameters
        ----------
        ax : matplotlib Axes, optional

        Raises
        ------
        ValueError
            If there is no subject.
        """
        from burrlab.psychophysics.report.plots import plot_d_prime

        self._some()
        return plot_d_prime(self, ax)

    def _some(self) -> None:
        if not self.subjects:
            raise ValueError(f"task {self.name} must hold a complete run to be drawn, got none")

    def __repr__(self) -> str:
        kind = "simulated subjects" if self.simulated else "subjects"
        mean = (
            "" if self.score is None else f", {self.score.mean:.1f} +- {self.score.sem:.1f} of {self.trials}"
        )
        return f"ScoredTask({self.name!r}, {self.task}, {len(self.subjects)} {kind}{mean})"


def _results(
    used: Sequence[SubjectData], rules: Sequence[RuleName], level: float, tell: Callable[[str], None]
) -> tuple[SubjectResult, ...]:
    p_values = [binomial_test(one.counts) for one in used if one.counts is not None]
    found = []
    for one, p, corrected in zip(used, p_values, holm(p_values), strict=True):
        if one.counts is None:
            continue
        tell(one.subject)
        found.append(
            SubjectResult(
                subject=one.subject,
                counts=one.counts,
                planned=one.planned,
                simulated=one.simulated,
                score_interval=score_interval(one.counts, level),
                p_value=p,
                holm=corrected,
                d_prime=tuple(_d_prime(one.counts, rule, level) for rule in rules),
                checks=tuple(pair_checks(one.counts)) if _has_types(one.counts) else (),
            )
        )
    return tuple(found)


def _d_prime(counts: Counts, rule: RuleName, level: float) -> DPrime:
    bare = counts.task, counts.hits, counts.signals, counts.false_alarms, counts.noises
    return replace(_of_outcome(*bare, rule, level), counts=counts)


@lru_cache(maxsize=4096)  # an exact interval takes 0.1 s, and subjects with equal counts are many
def _of_outcome(
    task: TaskName, hits: int, signals: int, false_alarms: int, noises: int, rule: RuleName, level: float
) -> DPrime:
    counts = Counts(task, hits, signals, false_alarms, noises)
    return d_prime(counts, rule=rule, level=level, correction=CORRECTION)


def _has_types(counts: Counts) -> bool:
    """Whether the types of trials can be compared: a position always can, pairs where all four were counted."""
    return counts.task != "same-different" or set(counts.by_type) >= {"AA", "AB", "BA", "BB"}
