"""Figures of an analysis: what is drawn, with which units, and that nothing is hidden."""

import math
from collections.abc import Iterator

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.text import Annotation
from scipy import stats

from burrlab.common.figures import new_figure
from burrlab.psychophysics.analysis import analyse
from burrlab.psychophysics.plots import wrapped
from burrlab.psychophysics.psychometric import PsychometricFit
from burrlab.psychophysics.published import group_score_from
from burrlab.psychophysics.rules import Counts
from burrlab.psychophysics.scored_task import ScoredTask
from burrlab.psychophysics.threshold_task import SubjectThreshold, ThresholdTask

COUNTS = {
    "01": Counts("same-different", 5, 6, 1, 6),
    "02": Counts("same-different", 4, 6, 3, 6),
    "03": Counts("same-different", 6, 6, 0, 6),
    "04": Counts("same-different", 5, 6, 1, 6),
}


@pytest.fixture(autouse=True)
def agg() -> Iterator[None]:
    before = matplotlib.get_backend()
    matplotlib.use("Agg")
    yield
    from matplotlib import pyplot

    pyplot.close("all")
    matplotlib.use(before)


@pytest.fixture(scope="module")
def task() -> ScoredTask:
    made = analyse({"probing": COUNTS}, delta=1.5)["probing"]
    assert isinstance(made, ScoredTask)
    return made


def arrows(axes: Axes) -> list[Annotation]:
    return [text for text in axes.texts if isinstance(text, Annotation) and text.arrow_patch is not None]


def labels(axes: Axes) -> list[str]:
    return axes.get_legend_handles_labels()[1]


def test_scores(task: ScoredTask) -> None:
    axes = task.plot_scores()
    heights = [bar.get_height() for bar in axes.patches if hasattr(bar, "get_height")]
    assert heights[:13] == [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 2, 0, 1]
    (stairs,) = (patch for patch in axes.patches if not hasattr(patch, "get_height"))
    values, edges, _ = stairs.get_data()  # type: ignore[attr-defined]
    assert values == pytest.approx(4 * stats.binom.pmf(np.arange(13), 12, 0.5))
    assert edges == pytest.approx(np.arange(14) - 0.5)
    assert axes.get_xlabel() == "score [correct answers of 12]"
    assert axes.get_ylabel() == "subjects"
    assert task.score is not None
    assert task.score.sem is not None
    assert f"mean ± s.e.m., {task.score.mean:.1f} ± {task.score.sem:.1f}" in labels(axes)
    (mark,) = (line for line in axes.lines if line.get_marker() == "D")
    assert mark.get_xdata() == pytest.approx([9.75])


def test_a_published_mean_beside_the_scores(task: ScoredTask) -> None:
    paper = group_score_from(mean=9.3, sem=0.4, n=20, trials=12)
    axes = task.plot_scores(published=paper)
    assert "published, 9.3 ± 0.4, n = 20" in labels(axes)
    (mark,) = (line for line in axes.lines if line.get_marker() == "s")
    assert list(mark.get_xdata()) == [9.3]
    with pytest.raises(ValueError, match="published must be of 12 trials, as the task, got 10"):
        task.plot_scores(published=group_score_from(mean=9.4, sem=0.4, n=5, trials=10, task="abx"))


def test_scores_of_one_subject_have_no_mean() -> None:
    made = analyse({"01": COUNTS["01"]})["same-different"]
    assert isinstance(made, ScoredTask)
    assert not any("mean" in label for label in labels(made.plot_scores()))


def test_intervals_of_the_score(task: ScoredTask) -> None:
    axes = task.plot_intervals()
    assert axes.get_xlabel() == "correct [%], 95 % interval"
    assert [text.get_text() for text in axes.get_yticklabels()] == ["01", "02", "03", "04"]
    assert "chance" in labels(axes)
    (chance,) = (line for line in axes.lines if line.get_linestyle() == "--")
    assert list(chance.get_xdata()) == [50, 50]
    bars = [line for line in axes.collections if isinstance(line, LineCollection)]
    ends = [(path.vertices[0, 0], path.vertices[1, 0]) for line in bars for path in line.get_paths()]  # type: ignore[index]
    expected = [tuple(100 * end for end in one.score_interval) for one in task.subjects]
    assert np.array(ends) == pytest.approx(np.array(expected))
    assert arrows(axes) == []


@pytest.mark.parametrize("rule", ["independent-observations", "differencing"])
def test_open_intervals_are_arrows(task: ScoredTask, rule: str) -> None:
    axes = task.plot_intervals(rule=rule)
    assert axes.get_xlabel() == f"d' [sd], {rule}, 95 % interval"
    (arrow,) = arrows(axes)
    assert arrow.get_position()[0] == pytest.approx(task.subject("03").span(rule)[0])
    assert "estimate infinite" in labels(axes)
    right = axes.get_xlim()[1]
    finite = [x for one in task.subjects for x in one.span(rule) if math.isfinite(x)]
    assert max(finite) < right


def test_d_prime_of_both_rules_and_the_group(task: ScoredTask) -> None:
    axes = task.plot_d_prime()
    assert [text.get_text() for text in axes.get_yticklabels()] == ["01", "02", "03", "04", "all"]
    assert {"independent-observations", "differencing", "chance, d' = 0", "Δ = 1.5"} <= set(labels(axes))
    assert axes.get_xlabel() == "d' [sd], 95 % interval"
    opened = sum(math.isinf(d.interval[1]) for one in task.subjects for d in one.d_prime)
    opened += sum(group.open_above for group in task.group_d_prime)
    assert len(arrows(axes)) == opened


def test_given_axes_are_used_and_other_figures_stay(task: ScoredTask) -> None:
    figure = new_figure()
    axes = figure.subplots()
    assert task.plot_scores(axes) is axes
    before = figure.get_figheight()
    many = analyse({f"{i:02d}": COUNTS["01"] for i in range(40)})["same-different"]
    assert isinstance(many, ScoredTask)
    many.plot_d_prime(axes)
    assert figure.get_figheight() == before
    assert many.plot_d_prime().get_figure().get_figheight() > 2 * 3.6  # type: ignore[union-attr]


def test_simulated_subjects_and_selection_stand_in_every_title() -> None:
    made = analyse(COUNTS, simulated=True, selected_from=20)["same-different"]
    assert isinstance(made, ScoredTask)
    for axes in (made.plot_scores(), made.plot_intervals(), made.plot_d_prime()):
        assert "(simulated subjects; 4 selected of 20)" in axes.get_title().replace("\n", " ")


def test_refused(task: ScoredTask) -> None:
    made = analyse(COUNTS, rules=["differencing"])["same-different"]
    assert isinstance(made, ScoredTask)
    with pytest.raises(ValueError, match="rule must be one of differencing, got 'x'"):
        made.plot_intervals(rule="x")


def test_long_titles_are_broken() -> None:
    lines = wrapped("word " * 30).splitlines()
    assert len(lines) > 1
    assert max(map(len, lines)) <= 52


def threshold(name: str, value: float | None, ends: tuple[float, float] | None) -> SubjectThreshold:
    return SubjectThreshold(name, True, 60, 60, ((1.2, 40, 60),), value, ends, "said", None)


def test_thresholds() -> None:
    subjects = (
        threshold("01", 1.1, (1.05, 1.2)),
        threshold("02", 1.3, None),
        threshold("03", None, None),
    )
    made = ThresholdTask("level", {"parameter": "c_e"}, 0.95, subjects, (), 0, 0, "")
    axes = made.plot_thresholds()
    assert [text.get_text() for text in axes.get_yticklabels()] == ["01", "02", "all"]
    assert axes.get_xlabel() == "threshold, ratio of c_e to the reference, 95 % interval"
    assert "(simulated subjects)" in axes.get_title()
    assert made.group_threshold is not None
    assert made.group_threshold[0] == pytest.approx(math.exp(math.sqrt(math.log(1.1) * math.log(1.3))))
    with pytest.raises(ValueError, match="task level must hold a threshold to be drawn, got none"):
        ThresholdTask("level", {}, 0.95, subjects[2:], (), 0, 0, "").plot_thresholds()


def test_thresholds_on_both_sides_have_no_mean() -> None:
    subjects = (threshold("01", 1.1, None), threshold("02", 0.9, None))
    made = ThresholdTask("level", {}, 0.95, subjects, (), 0, 0, "")
    assert made.group_threshold is None
    assert [text.get_text() for text in made.plot_thresholds().get_yticklabels()] == ["01", "02"]


def test_thresholds_without_scatter_have_no_interval() -> None:
    subjects = (threshold("01", 1.1, None), threshold("02", 1.1, None))
    assert ThresholdTask("level", {}, 0.95, subjects, (), 0, 0, "").group_threshold is None


def test_psychometric_function() -> None:
    fit = PsychometricFit(
        threshold=1.2, interval=(1.1, 1.4), slope=1.25, slope_interval=(1.0, 2.0), lapse=0.02,
        lapse_interval=(0.0, 0.1), overdispersion=0.0, level=0.95, guess_rate=0.5, proportion=0.75,
        ratios=(1.05, 1.2, 1.5), correct=(11, 15, 20), trials=(20, 20, 20), side="above", parameter="c_e",
        reference=2.145, at_bounds=(), provenance={},
    )  # fmt: skip
    one = SubjectThreshold("01", True, 60, 60, (), 1.2, (1.1, 1.4), str(fit), fit)
    made = ThresholdTask("level", {}, 0.95, (one,), (), 0, 0, "")
    axes = made.plot_psychometric()
    assert axes.get_title().replace("\n", " ") == "level (simulated subjects), subject 01"
    assert "c_e" in axes.get_xlabel()
