"""Figures of an analysis: scores, intervals, d' by rule."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator
from scipy import stats

from burrlab.figures import FORCE, POSITION, REFERENCE, VELOCITY, axes_or_new, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from burrlab.psychophysics.report.scored_task import ScoredTask
    from burrlab.psychophysics.report.threshold_task import ThresholdTask
    from burrlab.psychophysics.statistics.published_score import PublishedScore

#: Of an estimate: lower end, estimate, upper end; the last two may be infinite.
Span: TypeAlias = tuple[float, float, float]

COLOURS = {"independent-observations": FORCE, "differencing": VELOCITY}
_MARKERS = {"independent-observations": "o", "differencing": "s"}
_LOWEST = 4.0  # end of a d' axis at least, where all that is drawn ends below


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
    ax = _room_for(ax, len(task.subjects))
    names = [one.subject for one in task.subjects]
    if rule is None:
        spans = [
            (100 * one.score_interval[0], 100 * one.counts.score / one.counts.trials, 100 * one.score_interval[1])
            for one in task.subjects
        ]  # fmt: skip
        end = 100.0
        _draw(ax, spans, np.arange(len(names), dtype=np.float64), end, POSITION, "o", None)
        ax.axvline(50, color=REFERENCE, linestyle="--", linewidth=1, label="chance")
        ax.set(xlim=(0, 102), xlabel=f"correct [%], {100 * task.level:g} % interval")
    else:
        spans = [one.span(rule) for one in task.subjects]
        end = _end(spans)
        _draw(ax, spans, np.arange(len(names), dtype=np.float64), end, COLOURS[rule], _MARKERS[rule], None)
        ax.axvline(0, color=REFERENCE, linestyle="--", linewidth=1, label="chance, d' = 0")
        _say_infinite(ax, spans)
        ax.set(xlim=(-0.03 * end, end), xlabel=f"d' [sd], {rule}, {100 * task.level:g} % interval")
    _name_rows(ax, names, "subject")
    _legend_above(ax, task.title)
    return tidy(ax)


def plot_d_prime(task: ScoredTask, ax: Axes | None) -> Axes:
    """See `ScoredTask.plot_d_prime`."""
    ax = _room_for(ax, 1.5 * len(task.subjects))
    names = [one.subject for one in task.subjects]
    rows = np.arange(len(names), dtype=np.float64)
    all_spans = {rule: [one.span(rule) for one in task.subjects] for rule in task.rules}
    for group in task.group_d_prime:
        all_spans[group.rule].append((group.interval[0], group.estimate, group.interval[1]))
    if task.group_d_prime:
        names.append("all")
        rows = np.append(rows, len(rows) + 0.4)
        ax.axhline(len(rows) - 1.1, color="0.8", linewidth=0.8)
    end = _end([span for spans in all_spans.values() for span in spans])
    for i, (rule, spans) in enumerate(all_spans.items()):
        shift = 0.36 * (i - 0.5 * (len(all_spans) - 1))
        _draw(ax, spans, rows + shift, end, COLOURS[rule], _MARKERS[rule], rule)
    ax.axvline(0, color=REFERENCE, linestyle="--", linewidth=1, label="chance, d' = 0")
    if task.delta is not None:
        ax.axvline(task.delta, color="black", linestyle=":", linewidth=1, label=f"Δ = {task.delta:g}")
    _say_infinite(ax, [span for spans in all_spans.values() for span in spans])
    ax.set(xlim=(-0.03 * end, end), xlabel=f"d' [sd], {100 * task.level:g} % interval")
    _name_rows(ax, names, "subject", rows)
    _legend_above(ax, task.title)
    return tidy(ax)


def plot_thresholds(task: ThresholdTask, ax: Axes | None) -> Axes:
    """See `ThresholdTask.plot_thresholds`."""
    ax = _room_for(ax, len(task.subjects))
    found = [(one.subject, one.threshold, one.interval) for one in task.subjects if one.threshold is not None]
    names, rows = [name for name, *_ in found], np.arange(len(found), dtype=np.float64)
    for (_, threshold, interval), at in zip(found, rows, strict=True):
        if interval is not None:
            ax.plot(interval, [at, at], "|-", color=POSITION, linewidth=1.2, markersize=5)
        ax.plot(threshold, at, "o", color=POSITION, markersize=4.5)
    if (group := task.group_threshold) is not None:
        row = len(rows) + 0.4
        names, rows = [*names, "all"], np.append(rows, row)
        ax.axhline(row - 0.7, color="0.8", linewidth=0.8)
        ax.plot(group[1:], [row, row], "|-", color=VELOCITY, linewidth=1.2, markersize=5)
        ax.plot(group[0], row, "D", color=VELOCITY, markersize=5)
    ax.axvline(1.0, color=REFERENCE, linestyle="--", linewidth=1, label="the reference")
    some = any(interval is not None for *_, interval in found) or group is not None
    said = f", {100 * task.level:g} % interval" if some else ""
    ax.set_xlabel(
        f"threshold, ratio of {task.design.get('parameter', 'the parameter')} to the reference{said}"
    )
    _name_rows(ax, names, "subject", rows)
    _legend_above(ax, task.title)
    return tidy(ax)


def wrapped(title: str) -> str:
    """In lines that fit over a figure of one column."""
    return textwrap.fill(title, 52)


def _room_for(ax: Axes | None, rows: float) -> Axes:
    """The given axes, or those of a new figure as tall as the rows need."""
    ax, new = axes_or_new(ax), ax is None
    if new and rows > 13 and isinstance(ax.figure, Figure):
        ax.figure.set_figheight(1.2 + 0.19 * rows)
    return ax


def _end(spans: Sequence[Span]) -> float:
    """Of the d' axis: all that is finite lies inside."""
    finite = [value for span in spans for value in span if math.isfinite(value)]
    return 1.15 * max(_LOWEST, *finite, 0.0)


def _draw(
    ax: Axes, spans: Sequence[Span], rows: np.ndarray[tuple[int], np.dtype[np.float64]], end: float,
    colour: str, marker: str, label: str | None,
) -> None:  # fmt: skip
    """Intervals as lines, those open above as arrows; an infinite estimate as a hollow mark at the axis' end."""
    for (low, estimate, high), row in zip(spans, rows, strict=True):
        if math.isinf(high):
            ax.annotate("", (0.995 * end, row), (low, row), annotation_clip=False,
                        arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0})  # fmt: skip
            ax.plot([low, low], [row - 0.11, row + 0.11], color=colour, linewidth=1.2)
        else:
            ax.errorbar(0.5 * (low + high), row, xerr=0.5 * (high - low), fmt="none", ecolor=colour,
                        elinewidth=1.2, capsize=2.5)  # fmt: skip
        if math.isinf(estimate):
            ax.plot(0.96 * end, row, marker, color=colour, mfc="white", markersize=5, zorder=4)
        else:
            ax.plot(estimate, row, marker, color=colour, markersize=4.5, zorder=4, clip_on=False)
    if label is not None:
        ax.plot([], [], marker, linestyle="-", color=colour, markersize=4.5, linewidth=1.2, label=label)


def _say_infinite(ax: Axes, spans: Sequence[Span]) -> None:
    if any(math.isinf(estimate) for _, estimate, _ in spans):
        ax.plot([], [], "o", color=REFERENCE, mfc="white", markersize=5, label="estimate infinite")


def _name_rows(
    ax: Axes,
    names: Sequence[str],
    what: str,
    rows: np.ndarray[tuple[int], np.dtype[np.float64]] | None = None,
) -> None:
    at = np.arange(len(names)) if rows is None else rows
    ax.set_yticks(at, names, fontsize=8 if len(names) < 25 else 6)
    ax.set_ylim(at[-1] + 0.7, -0.7)
    ax.set_ylabel(what)


def _legend_above(ax: Axes, title: str) -> None:
    """Between title and frame: intervals fill the frame."""
    handles, labels = ax.get_legend_handles_labels()
    ax.legend(handles, labels, frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0),
              ncols=min(3, len(labels)), columnspacing=1.2, handletextpad=0.5)  # fmt: skip
    ax.set_title(wrapped(title), fontsize=10, pad=22 if len(labels) <= 3 else 36)
