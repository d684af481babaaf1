"""A task with a score, same-different or ABX: its subjects, and the group."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.ticker import FixedLocator, MaxNLocator
from scipy import stats

from burrlab.figures import FORCE, POSITION, REFERENCE, VELOCITY, axes_or_new, tidy
from burrlab.psychophysics.counts import Counts
from burrlab.psychophysics.report.plots import (
    COLOURS,
    MARKERS,
    draw,
    end_of,
    legend_above,
    name_rows,
    room_for,
    say_infinite,
    wrapped,
)
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


def plot_scores(task: ScoredTask, ax: Axes | None, published: PublishedScore | None) -> Axes:
    """See `ScoredTask.plot_scores`."""
    trials = task.trials
    if trials is None:
        raise ValueError(
            "a histogram of scores needs equally many trials a subject, "
            f"got {', '.join(str(one.counts.trials) for one in task.subjects)}"
        )
    if published is not None and published.trials != trials:
        raise ValueError(f"published must be of {trials} trials, as the task, got {published.trials}")
    ax = axes_or_new(ax)
    score = np.arange(trials + 1)
    scores = np.array([one.counts.score for one in task.subjects])
    n = len(scores)
    counts = np.bincount(scores, minlength=trials + 1)
    ax.bar(score, counts, width=0.9, color=FORCE, alpha=0.75, label=f"subjects, n = {n}")
    expected = n * stats.binom.pmf(score, trials, 0.5)
    ax.stairs(expected, np.arange(trials + 2) - 0.5, color=REFERENCE, linewidth=1.2, baseline=None,
              label="expected of chance performers")  # fmt: skip
    top = max(counts.max(), expected.max())
    if task.score is not None:
        mean, sem = task.score.mean, task.score.sem
        ax.errorbar(mean, 1.09 * top, xerr=sem, fmt="D", color=VELOCITY, markersize=5, capsize=3,
                    label=f"mean ± s.e.m., {mean:.1f} ± {sem:.1f}")  # fmt: skip
    if published is not None:
        mean, sem = published.mean, published.sem
        ax.errorbar(mean, 1.2 * top, xerr=sem, fmt="s", color="black", mfc="white", markersize=5, capsize=3,
                    label=f"published, {mean:g} ± {sem:g}, n = {published.n}")  # fmt: skip
    ax.set(xlabel=f"score [correct answers of {trials}]", ylabel="subjects", xlim=(-0.6, trials + 0.6))
    ax.set_ylim(0, (1.5 if published is None else 1.75) * top)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    ax.xaxis.set_major_locator(
        FixedLocator(range(trials + 1)) if trials <= 14 else MaxNLocator(nbins=13, integer=True)
    )
    ax.legend(frameon=False, fontsize=8, loc="upper left")
    ax.set_title(wrapped(task.title), fontsize=10)
    return tidy(ax)


def plot_intervals(task: ScoredTask, ax: Axes | None, rule: str | None) -> Axes:
    """See `ScoredTask.plot_intervals`."""
    ax = room_for(ax, len(task.subjects))
    names = [one.subject for one in task.subjects]
    if rule is None:
        spans = [
            (100 * one.score_interval[0], 100 * one.counts.score / one.counts.trials, 100 * one.score_interval[1])
            for one in task.subjects
        ]  # fmt: skip
        end = 100.0
        draw(ax, spans, np.arange(len(names), dtype=np.float64), end, POSITION, "o", None)
        ax.axvline(50, color=REFERENCE, linestyle="--", linewidth=1, label="chance")
        ax.set(xlim=(0, 102), xlabel=f"correct [%], {100 * task.level:g} % interval")
    else:
        spans = [one.span(rule) for one in task.subjects]
        end = end_of(spans)
        draw(ax, spans, np.arange(len(names), dtype=np.float64), end, COLOURS[rule], MARKERS[rule], None)
        ax.axvline(0, color=REFERENCE, linestyle="--", linewidth=1, label="chance, d' = 0")
        say_infinite(ax, spans)
        ax.set(xlim=(-0.03 * end, end), xlabel=f"d' [sd], {rule}, {100 * task.level:g} % interval")
    name_rows(ax, names, "subject")
    legend_above(ax, task.title)
    return tidy(ax)


def plot_d_prime(task: ScoredTask, ax: Axes | None) -> Axes:
    """See `ScoredTask.plot_d_prime`."""
    ax = room_for(ax, 1.5 * len(task.subjects))
    names = [one.subject for one in task.subjects]
    rows = np.arange(len(names), dtype=np.float64)
    all_spans = {rule: [one.span(rule) for one in task.subjects] for rule in task.rules}
    for group in task.group_d_prime:
        all_spans[group.rule].append((group.interval[0], group.estimate, group.interval[1]))
    if task.group_d_prime:
        names.append("all")
        rows = np.append(rows, len(rows) + 0.4)
        ax.axhline(len(rows) - 1.1, color="0.8", linewidth=0.8)
    end = end_of([span for spans in all_spans.values() for span in spans])
    for i, (rule, spans) in enumerate(all_spans.items()):
        shift = 0.36 * (i - 0.5 * (len(all_spans) - 1))
        draw(ax, spans, rows + shift, end, COLOURS[rule], MARKERS[rule], rule)
    ax.axvline(0, color=REFERENCE, linestyle="--", linewidth=1, label="chance, d' = 0")
    if task.delta is not None:
        ax.axvline(task.delta, color="black", linestyle=":", linewidth=1, label=f"Δ = {task.delta:g}")
    say_infinite(ax, [span for spans in all_spans.values() for span in spans])
    ax.set(xlim=(-0.03 * end, end), xlabel=f"d' [sd], {100 * task.level:g} % interval")
    name_rows(ax, names, "subject", rows)
    legend_above(ax, task.title)
    return tidy(ax)
