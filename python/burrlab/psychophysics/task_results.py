"""The input of an analysis, and the results of a task: its subjects and the group, with scores or thresholds."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar, cast

import numpy as np
import scipy

from burrlab.common.check import amend_error, refuse
from burrlab.common.figures import FORCE, POSITION, REFERENCE, VELOCITY, Axes, axes_or_new, drawing, styled
from burrlab.common.table import holm
from burrlab.psychophysics.answers import Answers
from burrlab.psychophysics.designs import TaskDesign
from burrlab.psychophysics.group import (
    GroupDPrime,
    GroupScore,
    PublishedScore,
    SelectionEffect,
    group_d_prime,
    group_score,
)
from burrlab.psychophysics.power import Equivalence, equivalence
from burrlab.psychophysics.psychometric import (
    Level,
    PsychometricFit,
    psychometric_function,
    summed,
)
from burrlab.psychophysics.rules import Counts, RuleName, TaskName, one_of
from burrlab.psychophysics.sensitivity import (
    DPrime,
    PairCheck,
    below_chance,
    binomial_test,
    d_prime,
    pair_checks,
    score_interval,
)
from burrlab.psychophysics.side_car import AnswerRow
from burrlab.psychophysics.staircase import (
    ConstantStimuli,
    Staircased,
    StaircaseThreshold,
    Threshold,
    design_of_dict,
)

#: Subject -> counts, or task -> subject -> counts.
CountsBySubject: TypeAlias = Mapping[str, Counts | Answers]
CountsByTask: TypeAlias = Mapping[str, CountsBySubject]

#: Called with task and subject before each analysis.
Progress: TypeAlias = Callable[[str, str], object]


def level_counts(rows: Iterable[AnswerRow]) -> tuple[Level, ...]:
    """(level, correct answers, trials) of the rows that have a level, by level."""
    return tuple(sorted(summed((row.level, row.correct, 1) for row in rows if row.level is not None)))


@dataclass(frozen=True)
class OneSubject:
    """Base of the results of one subject in a task.

    Attributes
    ----------
    subject : str
    planned : int or None
        Main trials of the design; None if unknown, or if the answers end it.
    simulated : bool
    """

    subject: str
    planned: int | None
    simulated: bool

    @property
    def complete(self) -> bool:
        """Whether all planned trials were answered."""
        return self.planned is None or self.trials >= self.planned  # type: ignore[attr-defined]


@dataclass(frozen=True)
class SubjectData(OneSubject):
    """`OneSubject` with the counts of the main trials.

    Attributes
    ----------
    counts : Counts or None
        None before the first answer.
    levels : tuple of (float, int, int)
        (level, correct answers, trials) by level, in tasks that vary a parameter.
    answers : Answers or None
        Source of the counts; None for counts without files.
    """

    counts: Counts | None
    levels: tuple[Level, ...] = ()
    answers: Answers | None = field(default=None, compare=False)

    @classmethod
    def of(cls, answers: Answers) -> "SubjectData":
        """The main trials of a run."""
        beside = sum(int(answers.design.get(x, 0)) for x in ("practice", "catch"))
        beside += sum(row.lost and row.phase == "main" for row in answers.rows)
        return cls(
            answers.subject,
            None if answers.trials is None else answers.trials - beside,
            answers.simulated,
            answers.counts() if answers.main else None,
            level_counts(answers.main if answers.task == "2ifc" else ()),
            answers,
        )

    @property
    def protocol(self) -> Mapping[str, Any]:
        """The protocol of the run, as JSON; empty if unknown."""
        return self.answers.side_car.protocol if self.answers and self.answers.side_car else {}

    @property
    def trials(self) -> int:
        """Answered trials."""
        return 0 if self.counts is None else self.counts.trials


@dataclass(frozen=True)
class TaskData:
    """A task and its subjects.

    Attributes
    ----------
    name : str
    task : {"same-different", "abx", "2ifc"}
    subjects : tuple of SubjectData
    design : mapping
        `TaskDesign.to_dict`; empty for counts without a design.
    of : int
        Number of subjects from whom these were selected; 0 without selection.
    selected_by : str
        Criterion of the selection, if known.
    chosen : int
        Number of selected subjects, if some have not done the task yet; 0 if all are here.
    """

    name: str
    task: TaskName
    subjects: tuple[SubjectData, ...]
    design: Mapping[str, Any] = field(default_factory=dict)
    of: int = 0
    selected_by: str = ""
    chosen: int = 0

    def select(self, subjects: Sequence[str] | None, selected_from: int | None, by: str) -> "TaskData":
        """The task with these subjects only, by default all; `selected_from` becomes `of`, if known."""
        known = [subject.subject for subject in self.subjects]
        refuse(
            isinstance(subjects, str),
            f"subjects must be a list of labels, such as [{subjects!r}], got {subjects!r}",
            TypeError,
        )
        unknown = [name for name in subjects or () if name not in known]
        refuse(
            unknown or subjects == [],
            f"subjects must be of {', '.join(known)}, got {', '.join(unknown) or 'none'}",
        )
        selected = tuple(
            subject for subject in self.subjects if subjects is None or subject.subject in subjects
        )
        refuse(
            selected_from is not None and selected_from < len(selected),
            f"selected_from must be at least the {len(selected)} subjects of task {self.name}, got "
            f"{selected_from}",
        )
        of = selected_from or self.of or (len(known) if len(selected) < len(known) else 0)
        # A part of the selected subjects keeps the number that was selected.
        return replace(
            self,
            subjects=selected,
            of=of if of > len(selected) else 0,
            selected_by=by or self.selected_by,
            chosen=(self.chosen or len(known)) if self.of and not selected_from else 0,
        )


def design_text(design: Mapping[str, Any]) -> str:
    """One line on what a design compares; "" without a design."""
    names = {
        part: value["name"]
        for part, value in design.items()
        if isinstance(value, Mapping) and "name" in value
    }
    kind, text = design.get("design"), ""
    if kind == "same-different":
        text = f"{names['a']} (A) against {names['b']} (B)"
    elif kind == "abx":
        match = "" if names["match"] == names["reference"] else f", match {names['match']}"
        text = f"reference {names['reference']}{match}, foil {names['foil']}"
    elif "parameter" in design and "reference" in design:
        within = "below a boundary " * ("boundary_mm" in design)
        text = f"{design['parameter']} {within}around {names['reference']}"
    return f"{text}, {design['mode']}" if text and "mode" in design else text


Subject = TypeVar("Subject", bound=OneSubject)


@dataclass(frozen=True)
class TaskResult(Generic[Subject]):
    """Base of the results of a task: its subjects and their selection.

    Attributes
    ----------
    name : str
    design : mapping
        `TaskDesign.to_dict`; empty for counts without a design.
    level : float
        Level of all intervals.
    subjects : tuple
    left_out : tuple of str
        Subjects with incomplete runs, and their numbers of trials.
    of : int
        Number of subjects from whom these were selected; 0 without selection, or if unknown.
    chosen : int
        Number of selected subjects, including those still to come; 0 as for `of`.
    selected_by : str
    """

    name: str
    design: Mapping[str, Any]
    level: float
    subjects: tuple[Subject, ...]
    left_out: tuple[str, ...]
    of: int
    chosen: int
    selected_by: str

    #: Proportion correct of a subject who guesses; all tasks have two answers.
    chance: ClassVar[float] = 0.5

    @property
    def simulated(self) -> bool:
        """Whether any subject is simulated."""
        return any(subject.simulated for subject in self.subjects)

    @property
    def selected(self) -> bool:
        """Whether the subjects were selected."""
        return bool(self.of or self.selected_by)

    @property
    def title(self) -> str:
        """Title of figures: name, comparison, and whether subjects are simulated or selected."""
        about = design_text(self.design)
        text = f"{self.name}: {about}" if about else self.name
        n = len(self.subjects)
        part = "" if n == self.chosen else f" of {self.chosen}"
        selection = f"{n}{part} selected of {self.of}" if self.of else "selected subjects"
        remarks = ["simulated subjects"] * self.simulated + [selection] * self.selected
        return f"{text} ({'; '.join(remarks)})" if remarks else text

    def subject(self, name: str) -> Subject:
        """One subject's result.

        Raises
        ------
        ValueError
            If no subject has this name.
        """
        subjects = {subject.subject: subject for subject in self.subjects}
        return subjects[one_of("subject", name, list(subjects))]


def shared(data: TaskData, level: float, used: Sequence[OneSubject]) -> dict[str, Any]:
    """The fields of every `TaskResult`."""
    names = [subject.subject for subject in used]
    left_out = [
        f"{subject.subject} ({f'{subject.trials} of {subject.planned}' if subject.trials else 'none of the main'} trials)"
        for subject in data.subjects
        if subject.subject not in names
    ]
    return {
        "name": data.name, "design": data.design, "level": level, "subjects": tuple(used), "left_out": tuple(left_out),
        "of": data.of, "chosen": (data.chosen or len(data.subjects)) if data.of else 0, "selected_by": data.selected_by,
    }  # fmt: skip


_STYLES = {"independent-observations": (FORCE, "o"), "differencing": (VELOCITY, "s")}
_LOWEST = 4.0  # the least end of a d' axis
_MANY = 2000  # subjects, of whose best the distribution is a matter of memory

#: Lower end, estimate and upper end of each row, of which the last two may be infinite; the look of the marks.
Series: TypeAlias = tuple[Sequence[tuple[float, float, float]], dict[str, Any]]


def plot_rows(
    ax: Axes | None, names: Sequence[str], series: Sequence[Series], end: float, chance: tuple[float, str], *,
    group: bool, **texts: Any,
) -> Axes:  # fmt: skip
    """Axes with a row a subject, and one apart for the group, if the last name is its; series side by side.

    An interval is a line, or an arrow towards the end of the axis if open above; an infinite estimate is hollow.
    """
    axes, height = axes_or_new(ax), len(names) * 0.5 * (1 + len(series))
    if ax is None and height > 13:
        cast(Any, axes.figure).set_figheight(1.2 + 0.19 * height)
    rows = np.arange(float(len(names)))
    if group:
        axes.axhline(rows[-1] - 0.2, color="0.8", linewidth=0.8)
        rows[-1] += 0.4
    for i, (spans, look) in enumerate(series):
        axes.plot([], [], **look)
        marks = look | {"label": None}
        shifted = rows + 0.36 * (i - 0.5 * (len(series) - 1))
        for (low, estimate, high), row in zip(spans, shifted, strict=True):
            if math.isinf(high):
                axes.annotate("", (0.995 * end, row), (low, row), annotation_clip=False,
                              arrowprops={"arrowstyle": "->", "color": look["color"], "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0})  # fmt: skip
                axes.plot([low, low], [row - 0.11, row + 0.11], color=look["color"], linewidth=1.2)
            elif low < high:
                axes.errorbar(0.5 * (low + high), row, xerr=0.5 * (high - low), fmt="none", ecolor=look["color"],
                              elinewidth=1.2, capsize=2.5)  # fmt: skip
            if math.isinf(estimate):
                axes.plot(0.96 * end, row, **(marks | {"mfc": "white"}))
            else:
                axes.plot(estimate, row, **marks, clip_on=False)
    axes.axvline(chance[0], color=REFERENCE, linestyle="--", linewidth=1, label=chance[1])
    axes.set_yticks(rows, names, fontsize=8)
    axes.set(ylim=(rows[-1] + 0.7, -0.7), ylabel="subject", **texts)
    axes.legend()
    return axes


def _marks(style: dict[str, Any], colour: str, marker: str) -> dict[str, Any]:
    """The look of the marks of a figure's rows."""
    return styled({"label": None} | style, color=colour, marker=marker, markersize=4.5, zorder=4)


@dataclass(frozen=True)
class SubjectResult(OneSubject):
    """`OneSubject` with a score, in the order of the report.

    Attributes
    ----------
    counts : Counts
        Counts of the main trials.
    score_interval : tuple of float
        Exact interval of the proportion correct.
    p_value : float
        Exact one-sided binomial test of the score against chance.
    holm : float
        The same with Holm's correction for all subjects of the task.
    d_prime : tuple of DPrime
        One per rule.
    checks : tuple of PairCheck
        Comparisons of the types of trials, if types were counted.
    """

    counts: Counts
    score_interval: tuple[float, float]
    p_value: float
    holm: float
    d_prime: tuple[DPrime, ...]
    checks: tuple[PairCheck, ...]

    @property
    def trials(self) -> int:
        """Answered trials of the main phase."""
        return self.counts.trials

    def of_rule(self, rule: str) -> DPrime:
        """d' under a rule.

        Raises
        ------
        ValueError
            If the analysis lacks the rule.
        """
        d_primes: dict[str, DPrime] = {d.rule: d for d in self.d_prime}
        return d_primes[one_of("rule", rule, list(d_primes))]


@dataclass(frozen=True)
class ScoredTask(TaskResult[SubjectResult]):
    """A `TaskResult` with scores of the subjects, and of the group with the subject as the unit.

    Attributes
    ----------
    subjects : tuple of SubjectResult
    task : {"same-different", "abx", "2ifc"}
    rules : tuple of str
        Decision rules for d'.
    delta : float or None
        Delta of the equivalence test.
    score : GroupScore or None
        None for a single subject.
    group_d_prime : tuple of GroupDPrime
        One per rule; empty for a single subject.
    equivalence : tuple of Equivalence
        One per rule; empty without a delta.
    checks : tuple of PairCheck
        Comparisons of the types of trials, all subjects together; empty if a subject's types were not
        counted.
    """

    subjects: tuple[SubjectResult, ...]  # declared again: records are read back by the declared types
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
        progress: Progress,
    ) -> "ScoredTask":  # fmt: skip
        """The result of the task; incomplete runs are left out unless `incomplete`."""
        used = [subject for subject in data.subjects if subject.counts and (incomplete or subject.complete)]
        # Both rules are the same with two intervals.
        rules = tuple(rules[:1] if data.task == "2ifc" else rules)
        counts = [subject.counts for subject in used if subject.counts is not None]
        p_values = [binomial_test(subject) for subject in counts]
        subject_results = []
        for subject, of_one, p, corrected in zip(used, counts, p_values, holm(p_values), strict=True):
            progress(data.name, subject.subject)
            bare = of_one.task, of_one.hits, of_one.signals, of_one.false_alarms, of_one.noises
            subject_results.append(
                SubjectResult(
                    subject=subject.subject,
                    counts=of_one,
                    planned=subject.planned,
                    simulated=subject.simulated,
                    score_interval=score_interval(of_one, level),
                    p_value=p,
                    holm=corrected,
                    d_prime=tuple(
                        replace(_of_outcome(*bare, rule=rule, level=level), counts=of_one) for rule in rules
                    ),
                    checks=tuple(pair_checks(of_one)) if _has_types(of_one) else (),
                )
            )
        several = len(used) > 1
        return cls(
            **shared(data, level, tuple(subject_results)),
            task=data.task,
            rules=rules,
            delta=delta,
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
        """Trials per subject; None if they differ."""
        numbers = {subject.counts.trials for subject in self.subjects}
        return numbers.pop() if len(numbers) == 1 else None

    @property
    def selection(self) -> SelectionEffect | None:
        """Effect on the mean of selection by this very score; None without selection, if unknown, or of very many."""
        if not self.subjects or self.trials is None or not self.chosen < self.of < _MANY:
            return None
        return SelectionEffect(self.chosen, self.of, self.trials, self.chance)

    @drawing
    def plot_scores(
        self, ax: Axes | None = None, *, published: PublishedScore | None = None, **style: Any
    ) -> Axes:
        """Histogram of scores with the one expected at chance, and mean ± s.e.m. (the paper's Figs. 7 and 8).

        `style`: `label`, `color` and other properties of the bars.

        Parameters
        ----------
        published : PublishedScore, optional
            Another mean ± s.e.m. to mark.

        Raises
        ------
        ValueError
            If there is no subject, or subjects or the published score have different numbers of trials.
        """
        self._some()
        if (trials := self.trials) is None:
            raise ValueError(
                "a histogram of scores needs equally many trials a subject, "
                f"got {', '.join(str(subject.counts.trials) for subject in self.subjects)}"
            )
        if published is not None and published.trials != trials:
            raise ValueError(f"published must be of {trials} trials, as the task, got {published.trials}")
        ax = axes_or_new(ax)
        score = np.arange(trials + 1)
        scores = np.array([subject.counts.score for subject in self.subjects])
        n = len(scores)
        counts = np.bincount(scores, minlength=trials + 1)
        look = {"width": 0.9, "color": FORCE, "alpha": 0.75, "label": f"subjects, n = {n}", **style}
        ax.bar(score, counts, **look)
        expected = n * scipy.stats.binom.pmf(score, trials, 0.5)
        ax.stairs(expected, np.arange(trials + 2) - 0.5, color=REFERENCE, linewidth=1.2, baseline=None,
                  label="expected of chance performers")  # fmt: skip
        top = max(counts.max(), expected.max())
        if self.score is not None:
            ax.errorbar(self.score.mean, 1.09 * top, xerr=self.score.sem, fmt="D", color=VELOCITY, markersize=5,
                        capsize=3, label=f"mean ± s.e.m., {self.score.mean:.1f} ± {self.score.sem:.1f}")  # fmt: skip
        if published is not None:
            ax.errorbar(published.mean, 1.2 * top, xerr=published.sem, fmt="s", color="black", mfc="white",
                        markersize=5, capsize=3,
                        label=f"published, {published.mean:g} ± {published.sem:g}, n = {published.n}")  # fmt: skip
        ax.set(
            xlabel=f"score [correct answers of {trials}]", xlim=(-0.6, trials + 0.6), ylabel="subjects",
            ylim=(0, 1.3 * top), title=self.title,
        )  # fmt: skip
        ax.locator_params(integer=True, nbins=14)
        return ax

    @drawing
    def plot_intervals(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Each subject's proportion correct with its interval, and the chance line.

        `style`: `label`, `color` and other properties of the subjects' marks.

        Raises
        ------
        ValueError
            If there is no subject.
        """
        self._some()
        names = [subject.subject for subject in self.subjects]
        spans = [
            (100 * subject.score_interval[0], 100 * subject.counts.score / subject.counts.trials, 100 * subject.score_interval[1])
            for subject in self.subjects
        ]  # fmt: skip
        return plot_rows(
            ax, names, [(spans, _marks(style, POSITION, "o"))], 100.0, (50.0, "chance"), group=False,
            xlim=(0, 102), xlabel=f"correct [%], {100 * self.level:g} % interval", title=self.title,
        )  # fmt: skip

    @drawing
    def plot_d_prime(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Each subject's d' under all rules, side by side, and the group's.

        `style`: `label`, `color` and other properties of the marks.

        Raises
        ------
        ValueError
            If there is no subject.
        """
        self._some()
        names = [subject.subject for subject in self.subjects] + ["all"] * bool(self.group_d_prime)
        by_rule: dict[RuleName, list[DPrime | GroupDPrime]] = {
            rule: [subject.of_rule(rule) for subject in self.subjects] for rule in self.rules
        }
        for group in self.group_d_prime:
            by_rule[group.rule].append(group)
        series, ends = [], [_LOWEST]
        for rule, d_primes in by_rule.items():
            label = f"{style['label']}, {rule}" if style.get("label") else rule
            spans = [(d.interval[0], d.estimate, d.interval[1]) for d in d_primes]
            series.append((spans, _marks({**style, "label": label}, *_STYLES[rule])))
            ends += [end for span in spans for end in span if math.isfinite(end)]
        end = 1.15 * max(ends)  # beyond all finite values
        ax = plot_rows(
            ax, names, series, end, (0.0, "chance, d' = 0"), group=bool(self.group_d_prime),
            xlim=(-0.03 * end, end), xlabel=f"d' [sd], {100 * self.level:g} % interval", title=self.title,
        )  # fmt: skip
        if self.delta is not None:
            ax.axvline(self.delta, color="black", linestyle=":", linewidth=1, label=f"Δ = {self.delta:g}")
        if any(math.isinf(estimate) for spans, _ in series for _, estimate, _ in spans):
            ax.plot([], [], "o", color=REFERENCE, mfc="white", markersize=5, label="estimate infinite")
        return ax

    def _some(self) -> None:
        refuse(not self.subjects, f"task {self.name} must hold a complete run to be drawn, got none")

    def __repr__(self) -> str:
        mean = (
            "" if self.score is None else f", {self.score.mean:.1f} +- {self.score.sem:.1f} of {self.trials}"
        )
        return f"ScoredTask({self.name!r}, {self.task}, {len(self.subjects)} {'simulated ' * self.simulated}subjects{mean})"


@lru_cache(maxsize=4096)  # an exact interval takes 0.1 s, and many subjects have equal counts
def _of_outcome(*counts: Any, **options: Any) -> DPrime:
    return d_prime(Counts(*counts), **options, correction="log-linear")


def _has_types(counts: Counts) -> bool:
    """Whether types of trials can be compared: positions always, pairs if all four types were counted."""
    return counts.task != "same-different" or set(counts.by_type) >= {"AA", "AB", "BA", "BB"}


_CLIPPED = 0.01  # share of an interval's ticks in contact
_FARTHEST = math.log(1e6)  # of a group's interval, as of a level


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
        Those of `levels` and of the catch trials in whose intervals limits shortened the force in more than 1 % of the
        ticks.
    pressed : float or None
        Mean force over the intervals of the main phase [N], if the file has forces.
    """

    trials: int
    levels: tuple[tuple[float, int, int], ...]
    threshold: float | None
    interval: tuple[float, float] | None
    said: str
    estimate: Threshold | PsychometricFit | None
    day: str = ""
    catch: tuple[float, int, int] | None = None
    clipped: tuple[tuple[float, int, int], ...] = ()
    pressed: float | None = None

    @property
    def open(self) -> bool:
        """Whether the threshold may lie beyond the levels."""
        x = self.estimate
        if isinstance(x, PsychometricFit):
            return not min(x.ratios) <= x.threshold <= max(x.ratios)
        if isinstance(x, StaircaseThreshold):
            return x.at_limit > 0
        return x is not None and (x.open_below or x.open_above)

    def rendered(self) -> list[tuple[float, int, int]]:
        """`levels` and the catch trials, by level, without what is `clipped`."""
        caught = () if self.catch is None else (self.catch,)
        without = ((level, -right, -trials) for level, right, trials in self.clipped)
        return [row for row in summed((*self.levels, *caught, *without)) if row[2]]


@dataclass(frozen=True)
class ThresholdTask(TaskResult[SubjectThreshold]):
    """The `TaskResult` of constant stimuli or a staircase; its subjects are SubjectThreshold."""

    subjects: tuple[SubjectThreshold, ...]  # declared again: records are read back by the declared types

    task: ClassVar[str] = "2ifc"

    @classmethod
    def of_data(
        cls, data: TaskData, *, level: float, incomplete: bool, progress: Progress
    ) -> "ThresholdTask":
        """The result of the task; incomplete runs are left out unless `incomplete`."""
        design = design_of_dict(data.design) if data.design else None
        results = []
        for subject in data.subjects:
            if subject.counts:
                progress(data.name, subject.subject)
                results.append(_threshold(subject, subject.counts, design, level))
        return cls(**shared(data, level, [result for result in results if incomplete or result.complete]))

    @property
    def group_threshold(self) -> tuple[float, float, float] | None:
        """(threshold, lower end, upper end) of the group, with the subject as the unit, or None.

        |ln threshold| is the geometric mean of |ln ratio|, with its t interval. None: fewer than two
        thresholds, thresholds on both sides of 1, or all equal. Thresholds that are `open` count as they are. An end
        beyond a ratio of 1e6 is none: infinite, or 0 below 1.
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
            far = side * math.inf if np.exp(mean + wide) > _FARTHEST else side * np.exp(mean + wide)
            threshold, near, far = np.exp([*(side * np.exp([mean, mean - wide])), far])
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
        spans = {
            subject.subject: (min(ends), subject.threshold, max(ends))
            for subject in self.subjects
            if subject.threshold is not None
            for ends in [subject.interval or (subject.threshold,)]
        }
        refuse(not spans, f"task {self.name} must hold a threshold to be drawn, got none")
        rows, group = list(spans.values()), self.group_threshold
        if group is not None:
            rows.append((min(group[1:]), group[0], max(group[1:])))
        ends = [1.0, *(end for span in rows for end in span if math.isfinite(end))]
        end = max(ends) + 0.05 * (max(ends) - min(ends))
        what = f"threshold, {self.design.get('parameter', 'the parameter')} over the reference's [1]" + (
            f", {100 * self.level:g} % interval" * any(low < high for low, _, high in rows)
        )
        return plot_rows(
            ax, [*spans, *["all"] * (group is not None)], [(rows, _marks(style, POSITION, "o"))], end, (1.0, "the reference"),
            group=group is not None, xlim=(None, end), xlabel=what, title=self.title,
        )  # fmt: skip

    def __repr__(self) -> str:
        return (
            f"ThresholdTask({self.name!r}, {self.design.get('design', self.task)}, {len(self.subjects)} "
            f"{'simulated ' * self.simulated}subjects)"
        )


def _threshold(
    subject: SubjectData, counts: Counts, design: TaskDesign | None, level: float
) -> SubjectThreshold:
    threshold: float | None = None
    interval: tuple[float, float] | None = None
    estimate, text = _estimate(subject, design, level)
    if isinstance(estimate, PsychometricFit):
        ratios = (estimate.threshold, *estimate.interval)
        threshold, near, far = (1.0 / x for x in ratios) if estimate.side == "below" else ratios
        interval = near, far
    elif estimate is not None:
        threshold, interval = estimate.level, getattr(estimate, "interval", None)
    if not isinstance(estimate, PsychometricFit) and (below := below_chance(counts.score, counts.trials)):
        text += f"\n{below}"
    text += "\none answer was always given" * (counts.hits + counts.false_alarms in (0, counts.trials))
    # A staircase may end before its last trial.
    return SubjectThreshold(
        subject.subject, None if isinstance(estimate, StaircaseThreshold) and estimate.complete else subject.planned, subject.simulated, subject.trials, subject.levels, threshold,
        interval, text, estimate, **_beside(subject.answers),
    )  # fmt: skip


def _beside(answers: Answers | None) -> dict[str, Any]:
    """Day, catch trials, clipped trials and pressed force of a run."""
    if answers is None:
        return {}
    catch = level_counts(row for row in answers.rows if row.phase == "catch" and not row.lost)
    felt = (row for row in answers.rows if row.phase != "practice" and not row.lost)
    clipped = (row for row in felt if any((share or 0.0) > _CLIPPED for share in row.clipped))
    forces = [force for row in answers.main for force in row.forces if force is not None]
    return {
        "pressed": sum(forces) / len(forces) if forces else None,
        "day": "" if answers.side_car is None else answers.side_car.started[:10],
        "catch": catch[0] if catch else None,
        "clipped": level_counts(clipped),
    }


def _estimate(
    subject: SubjectData, design: TaskDesign | None, level: float
) -> tuple[Threshold | PsychometricFit | None, str]:
    """The estimate of a subject's threshold and its text, or None and the reason."""
    if isinstance(design, Staircased):
        rows = [row for row in subject.answers.main if row.level is not None] if subject.answers else []
        with amend_error(f"{subject.answers.source if subject.answers else subject.subject}: "):
            estimate = design.threshold(
                [row.level or 1.0 for row in rows], [row.correct for row in rows], level=level
            )
        return estimate, str(estimate)
    known: dict[str, Any] = {
        "parameter": design.parameter, "reference": getattr(design.reference.material, design.parameter),
    } if isinstance(design, ConstantStimuli) else {}  # fmt: skip
    ratios, correct, trials = zip(*subject.levels, strict=True)
    try:
        fit = psychometric_function(ratios, correct, trials, level=level, **known)
    except (ImportError, ValueError) as error:
        return None, f"no psychometric function: {error}"
    return fit, str(fit)
