"""An analysis against numbers calculated by hand, what it warns of, JSON and back, its figures."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.text import Annotation
from scipy import stats

from burrlab.common.figures import new_figure
from burrlab.psychophysics.analysis import Analysis, analyse
from burrlab.psychophysics.plots import wrapped
from burrlab.psychophysics.psychometric import PsychometricFit
from burrlab.psychophysics.published import SelectionEffect, group_score_from
from burrlab.psychophysics.rules import Counts
from burrlab.psychophysics.scored_task import ScoredTask
from burrlab.psychophysics.threshold_task import SubjectThreshold, ThresholdTask

RULES = ("independent-observations", "differencing")


def pairs(ab: int, ba: int, aa: int, bb: int) -> Counts:
    """Of three trials of each type."""
    types = {"AA": (aa, 3), "AB": (ab, 3), "BA": (ba, 3), "BB": (bb, 3)}
    return Counts("same-different", ab + ba, 6, aa + bb, 6, types)


THREE = {"01": pairs(3, 2, 0, 1), "02": pairs(3, 1, 3, 0), "03": pairs(3, 3, 0, 0)}


def scored(analysis: Analysis, name: str) -> ScoredTask:
    task = analysis[name]
    assert isinstance(task, ScoredTask)
    return task


def test_a_subject_by_hand() -> None:
    task = scored(analyse({"probing": THREE}), "probing")
    one = task.subject("01")
    assert one.counts.score == 10
    assert one.p_value == pytest.approx(79 / 4096)
    assert one.score_interval == pytest.approx(
        (stats.beta.ppf(0.025, 10, 3), stats.beta.ppf(0.975, 11, 2)), abs=1e-9
    )
    # H = 5/6 and F = 1/6 are unbiased: d' = 2 z((1 + sqrt(2 p - 1))/2), p = 5/6
    root = math.sqrt(2 * 5 / 6 - 1)
    d = one.of_rule("independent-observations")
    assert d.estimate == pytest.approx(2 * stats.norm.ppf(0.5 * (1 + root)), abs=1e-6)
    assert d.criterion == pytest.approx(0.0, abs=1e-6)
    # Differencing: F = 2 Phi(-k/sqrt 2)
    assert one.of_rule("differencing").criterion == pytest.approx(
        -math.sqrt(2) * stats.norm.ppf(1 / 12), abs=1e-6
    )
    assert [d.rule for d in one.d_prime] == list(RULES)


def test_holm_over_the_subjects() -> None:
    task = scored(analyse({"probing": THREE}), "probing")
    p = [79 / 4096, 1586 / 4096, 1 / 4096]
    assert [one.p_value for one in task.subjects] == pytest.approx(p)
    assert [one.holm for one in task.subjects] == pytest.approx([2 * p[0], p[1], 3 * p[2]])


def test_a_perfect_score_is_open_and_corrected() -> None:
    one = scored(analyse({"probing": THREE}), "probing").subject("03")
    d = one.of_rule("independent-observations")
    assert math.isinf(d.estimate)
    assert d.open_above
    assert d.standard_error is None
    assert d.interval[0] > 0
    # Half an answer more: H = 6.5/7, F = 0.5/7
    corrected = 2 * stats.norm.ppf(0.5 * (1 + math.sqrt(2 * 6.5 / 7 - 1)))
    assert d.corrected == pytest.approx(corrected, abs=1e-6)
    assert d.correction == "log-linear"


def test_the_group_by_hand() -> None:
    task = scored(analyse({"probing": THREE}), "probing")
    assert task.score is not None
    assert task.score.mean == pytest.approx(29 / 3)
    sem = math.sqrt(19 / 3 / 3)
    assert task.score.sem == pytest.approx(sem)
    assert task.score.tests[0].statistic == pytest.approx((29 / 3 - 6) / sem)
    assert [group.rule for group in task.group_d_prime] == list(RULES)
    assert task.equivalence == ()
    assert [check.counts for check in task.checks] == [((3, 9), (1, 9)), ((9, 9), (6, 9))]


def test_one_subject_is_no_group() -> None:
    analysis = analyse({"01": THREE["01"]}, delta=1.5)
    task = scored(analysis, "same-different")
    assert task.score is None
    assert task.group_d_prime == ()
    assert len(task.equivalence) == 2
    assert "One subject: nothing is said of a group." in analysis.report()


def test_delta_asks_for_equivalence_and_its_origin_is_said() -> None:
    analysis = analyse({"probing": THREE}, delta=1.5)
    task = scored(analysis, "probing")
    assert [(test.rule, test.delta) for test in task.equivalence] == [(rule, 1.5) for rule in RULES]
    assert all(0 <= test.power <= 1 for test in task.equivalence)
    assert (
        "Delta = 1.5, given to the analysis: it counts only if it was set before the answers were seen."
        in analysis.notes
    )


def test_rules_and_level_as_given() -> None:
    task = scored(analyse(THREE, rules=["differencing"], level=0.9), "same-different")
    assert task.rules == ("differencing",)
    assert {one.d_prime[0].level for one in task.subjects} == {0.9}
    with pytest.raises(ValueError, match=r"rule must be one of differencing, got 'independent-observations'"):
        task.subjects[0].of_rule("independent-observations")


def test_two_intervals_have_one_rule() -> None:
    task = scored(analyse({"01": Counts("2ifc", 9, 10, 2, 10), "02": Counts("2ifc", 7, 10, 4, 10)}), "2ifc")
    assert task.rules == RULES[:1]
    assert [check.types for check in task.checks] == [("first", "second")]


def test_counts_without_types_have_no_pair_checks() -> None:
    task = scored(analyse({"01": THREE["01"], "02": Counts("same-different", 4, 6, 3, 6)}), "same-different")
    assert task.checks == ()
    assert [len(one.checks) for one in task.subjects] == [2, 0]


def test_unequal_trials() -> None:
    task = scored(analyse({"01": THREE["01"], "02": Counts("same-different", 9, 12, 3, 12)}, selected_from=5), "same-different")  # fmt: skip
    assert task.trials is None
    assert task.selection is None
    report = analyse({"01": THREE["01"], "02": Counts("same-different", 9, 12, 3, 12)}).report()
    assert "trials differ between subjects" in report
    with pytest.raises(
        ValueError, match="a histogram of scores needs equally many trials a subject, got 12, 24"
    ):
        task.plot_scores()


class TestSelection:
    def test_of_a_pool(self) -> None:
        analysis = analyse(THREE, selected_from=20, selected_by="score of task 1")
        task = scored(analysis, "same-different")
        assert task.selection == SelectionEffect(3, 20, 12)
        text = analysis.report()
        assert "SELECTED (score of task 1): 3 of 20 subjects." in text
        effect = SelectionEffect(3, 20, 12)
        assert f"the best 3 of 20 guessing have {effect.expected:.2f} of 12 on average" in text
        assert "3 selected of 20" in task.title

    def test_a_subset(self) -> None:
        analysis = analyse({"probing": THREE}, subjects=["01", "03"])
        task = scored(analysis, "probing")
        assert [one.subject for one in task.subjects] == ["01", "03"]
        assert task.of == 3
        assert "SELECTED: 2 of 3 subjects." in analysis.report()
        assert [one.holm for one in task.subjects] == pytest.approx([79 / 4096, 2 / 4096])

    def test_all_of_them_is_none(self) -> None:
        analysis = analyse({"probing": THREE}, subjects=["03", "02", "01"], selected_from=3)
        assert not scored(analysis, "probing").selected
        assert "SELECTED" not in analysis.report()

    def test_by_what_alone(self) -> None:
        analysis = analyse({"probing": THREE}, selected_by="their teacher")
        assert "SELECTED (their teacher): 3 subjects, of how many is not known" in analysis.report()


def test_simulated_subjects_are_said_everywhere() -> None:
    analysis = analyse(THREE, simulated=True)
    assert "SIMULATED SUBJECTS" in analysis.report().splitlines()[0]
    assert "simulated subjects" in repr(analysis)
    assert "simulated subjects" in repr(analysis.tasks[0])
    assert "SIMULATED SUBJECTS" in analysis._repr_html_()
    assert "(simulated subjects)" in analysis.tasks[0].title
    assert "imulated" not in analyse(THREE).report()


def test_report_of_twelve_subjects_is_one_screen() -> None:
    twelve = {f"{i:02d}": one for i, one in enumerate(4 * list(THREE.values()), start=1)}
    lines = analyse(twelve, delta=1.5).report().splitlines()
    assert len(lines) <= 45
    rows = [line for line in lines if line[:8].strip() in ("01", "12")]
    assert len(rows) == 2
    assert rows[0].split()[:6] == ["01", "10/12", "0.019", "0.15", "5/6", "1/6"]
    assert rows[1].count(", inf)") == 2


def test_html_holds_the_table() -> None:
    text = analyse({"a<b": THREE})._repr_html_()
    assert "<td>10/12</td>" in text
    assert "a&lt;b" in text
    assert "a<b" not in text


@pytest.mark.parametrize("options", [{}, {"delta": 1.5, "selected_from": 20, "simulated": True}])
def test_json_round_trip(options: dict[str, object], tmp_path: Path) -> None:
    types = {"AB": (4, 5), "BA": (0, 5)}
    analysis = analyse({"probing": THREE, "match": {"01": Counts("abx", 4, 5, 0, 5, types)}}, **options)  # type: ignore[arg-type]
    analysis.to_json(tmp_path / "analysis.json")
    back = Analysis.from_json(tmp_path / "analysis.json")
    assert back == analysis
    assert back.report() == analysis.report()
    text = io.StringIO()
    back.to_json(text)
    assert Analysis.from_json(io.StringIO(text.getvalue())) == analysis
    assert json.loads(text.getvalue())["tasks"][0]["subjects"][2]["d_prime"][0]["interval"][1] == "inf"


def test_tsv_of_the_subjects() -> None:
    text = io.StringIO()
    analyse({"probing": THREE, "match": {"01": Counts("abx", 4, 5, 0, 5)}}).to_tsv(text)
    rows = [line.split("\t") for line in text.getvalue().splitlines()]
    assert {len(row) for row in rows} == {len(rows[0])}
    table = [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]
    assert [(row["task"], row["subject"], row["score"]) for row in table] == [
        ("probing", "01", "10"), ("probing", "02", "7"), ("probing", "03", "12"), ("match", "01", "9"),
    ]  # fmt: skip
    assert table[2]["d_prime_differencing_high"] == "inf"
    assert table[2]["d_prime_differencing_standard_error"] == "n/a"
    assert float(table[0]["p_value"]) == 79 / 4096


@pytest.mark.parametrize("width", [60, 80, 100, 130])
def test_report_as_wide_as_the_screen(width: int) -> None:
    analysis = analyse({"probing": THREE}, delta=1.5, simulated=True, selected_from=20)
    text = analysis.report(width=width)
    assert max(map(len, text.splitlines())) <= width
    # Every word and number is still there; the subjects stand at the head of each part of the table.
    assert set(analysis.report().split()) - set(text.split()) == set()
    assert sum(line.lstrip().startswith("subject ") for line in text.splitlines()) == (
        1 if width > 124 else 2 if width >= 100 else 3
    )
    assert analysis.report(width=500) == analysis.report()


def test_progress_of_an_analysis() -> None:
    told: list[tuple[str, str]] = []
    analyse({"probing": THREE}, progress=lambda task, subject: told.append((task, subject)))
    assert told == [("probing", subject) for subject in THREE]


@pytest.mark.parametrize("data", [None, 5, b"x", [1], Counts("abx", 1, 2, 1, 2), [Counts("abx", 1, 2, 1, 2)]])
def test_data_of_another_type(data: object) -> None:
    with pytest.raises(TypeError, match="data must"):
        analyse(data)  # type: ignore[arg-type]


def test_subjects_are_no_text() -> None:
    """The letters of one would be taken for subjects."""
    counts = Counts("abx", 1, 2, 1, 2)
    with pytest.raises(TypeError, match=r"subjects must be a list of labels, such as \['12'\], got '12'"):
        analyse({"1": counts, "2": counts, "3": counts}, subjects="12")


@pytest.mark.parametrize("content", [b"", b"{", b"[" * 100_000, b"\xff\xfe", b"[]"])
def test_json_that_is_none_is_named(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(
        ValueError, match=r"a\.json: (this is not JSON in UTF-8|an analysis must be a JSON object)"
    ):
        Analysis.from_json(path)


def test_json_with_a_part_of_another_type_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    values = analyse({"1": Counts("abx", 1, 2, 1, 2)}).to_dict()
    for part in (5, [{"subjects": None}], None):
        path.write_text(json.dumps({**values, "tasks": part}))
        with pytest.raises(ValueError, match=r"a\.json: "):
            Analysis.from_json(path).report()


@pytest.mark.parametrize(
    ("kind", "ask", "sentence"),
    [
        (ValueError, lambda: analyse(THREE, subjects=["01", "04"]), "subjects must be of 01, 02, 03, got 04"),
        (ValueError, lambda: analyse(THREE, subjects=[]), "subjects must be of 01, 02, 03, got none"),
        (ValueError, lambda: analyse(THREE, selected_from=2), "selected_from must be at least the 3 subjects of task same-different, got 2"),
        (ValueError, lambda: Analysis.from_dict({}), r"'burrlab analysis' must be 1, got None"),
        (ValueError, lambda: Analysis.from_json(io.StringIO("[]")), "an analysis must be a JSON object, got list"),
        (ValueError, lambda: analyse({}), "data must hold a subject, got none"),
        (ValueError, lambda: analyse({"probing": {}}), "task probing must hold a subject, got none"),
        (ValueError, lambda: analyse([]), "data must hold answers, got none"),
        (TypeError, lambda: analyse({"01": 3}), "subject 01 must have Counts or Answers, got int"),
        (ValueError, lambda: analyse({"probing": {"01": THREE["01"], "02": Counts("abx", 4, 5, 0, 5)}}), "task probing must be of one kind, got abx, same-different"),
        (ValueError, lambda: analyse(THREE, rules=[]), "rules must hold one at least, got none"),
        (ValueError, lambda: analyse(THREE, rules=["x"]), "rule must be one of independent-observations, differencing, got 'x'"),
        (ValueError, lambda: analyse(THREE, level=1.0), r"level must be in \[0.5, 1\), got 1.0"),
        (ValueError, lambda: analyse(THREE, delta=-1), "delta must be a d' above 0, got -1"),
        (KeyError, lambda: analyse(THREE)["x"], "task must be one of same-different, got 'x'"),
        (ValueError, lambda: scored(analyse(THREE), "same-different").subject("x"), "subject must be one of 01, 02, 03, got 'x'"),
    ],
)  # fmt: skip
def test_refusals_by_their_sentence(kind: type[Exception], ask: Callable[[], object], sentence: str) -> None:
    with pytest.raises(kind, match=sentence):
        ask()


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
