"""An analysis against numbers calculated by hand; its warnings, JSON and figures."""

import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.text import Annotation
from scipy import stats
from session_scenes import refused

from burrlab.psychophysics import (
    Analysis,
    AnswerRow,
    Answers,
    Counts,
    PsychometricFit,
    SelectionEffect,
    analyse,
    group_score_from,
)
from burrlab.psychophysics.analysis import group_lines
from burrlab.psychophysics.staircase import StaircaseThreshold
from burrlab.psychophysics.task_results import SubjectThreshold, ThresholdTask

RULES = ("independent-observations", "differencing")


def pairs(ab, ba, aa, bb):
    """Counts of three trials of each type."""
    return Counts(
        "same-different", ab + ba, 6, aa + bb, 6, {"AA": (aa, 3), "AB": (ab, 3), "BA": (ba, 3), "BB": (bb, 3)}
    )


THREE = {"01": pairs(3, 2, 0, 1), "02": pairs(3, 1, 3, 0), "03": pairs(3, 3, 0, 0)}
FOUR = {
    name: Counts("same-different", hits, 6, alarms, 6)
    for name, hits, alarms in (("01", 5, 1), ("02", 4, 3), ("03", 6, 0), ("04", 5, 1))
}
UNEQUAL = {"01": THREE["01"], "02": Counts("same-different", 9, 12, 3, 10)}


def only(counts=THREE, **options):
    """The only task of an analysis."""
    (found,) = analyse(counts, **options).tasks
    return found


@pytest.fixture(scope="module")
def three():
    return analyse({"probing": THREE})


def test_a_subject_by_hand(three):
    one = three["probing"].subject("01")
    assert (one.counts.score, one.p_value) == (10, pytest.approx(79 / 4096))
    assert one.score_interval == pytest.approx(
        (stats.beta.ppf(0.025, 10, 3), stats.beta.ppf(0.975, 11, 2)), abs=1e-9
    )
    # H = 5/6 and F = 1/6 are unbiased: d' = 2 z((1 + sqrt(2 p - 1))/2), p = 5/6
    root = math.sqrt(2 * 5 / 6 - 1)
    d, differencing = (one.of_rule(rule) for rule in RULES)
    assert (d.estimate, d.criterion) == pytest.approx((2 * stats.norm.ppf(0.5 * (1 + root)), 0.0), abs=1e-6)
    # Differencing: F = 2 Phi(-k/sqrt 2)
    assert differencing.criterion == pytest.approx(-math.sqrt(2) * stats.norm.ppf(1 / 12), abs=1e-6)
    assert [found.rule for found in one.d_prime] == list(RULES)


def test_a_perfect_score_is_open_and_corrected(three):
    d = three["probing"].subject("03").of_rule("independent-observations")
    assert (d.estimate, d.interval[1], d.standard_error, d.correction) == (
        math.inf,
        math.inf,
        None,
        "log-linear",
    )
    assert d.interval[0] > 0
    # Half an answer more: H = 6.5/7, F = 0.5/7
    assert d.corrected == pytest.approx(2 * stats.norm.ppf(0.5 * (1 + math.sqrt(2 * 6.5 / 7 - 1))), abs=1e-6)


def test_the_group_by_hand(three):
    task, p = three["probing"], [79 / 4096, 1586 / 4096, 1 / 4096]
    assert [one.p_value for one in task.subjects] == pytest.approx(p)
    assert [one.holm for one in task.subjects] == pytest.approx([2 * p[0], p[1], 3 * p[2]])
    sem = math.sqrt(19 / 3 / 3)
    assert (task.score.mean, task.score.sem) == pytest.approx((29 / 3, sem))
    assert task.score.tests[0].statistic == pytest.approx((29 / 3 - 6) / sem)
    assert [group.rule for group in task.group_d_prime] == list(RULES)
    assert task.equivalence == ()
    assert [check.counts for check in task.checks] == [((3, 9), (1, 9)), ((9, 9), (6, 9))]


def test_one_subject_is_no_group():
    analysis = analyse({"01": THREE["01"]}, delta=1.5)
    task = analysis["same-different"]
    assert (task.score, task.group_d_prime, len(task.equivalence)) == (None, (), 2)
    assert "One subject: nothing is said of a group." in analysis.report()
    assert not any("mean" in label for label in labels(task.plot_scores()))


def test_delta_asks_for_equivalence_and_its_origin_is_said():
    analysis = analyse({"probing": THREE}, delta=1.5)
    tests = analysis["probing"].equivalence
    assert [(test.rule, test.delta) for test in tests] == [(rule, 1.5) for rule in RULES]
    assert all(0 <= test.power <= 1 for test in tests)
    assert (
        "Delta = 1.5, given to the analysis: it counts only if it was set before the answers were seen."
        in analysis.notes
    )


def test_rules_and_checks_of_other_counts():
    task = only(rules=["differencing"], level=0.9)
    assert (task.rules, {one.d_prime[0].level for one in task.subjects}) == (("differencing",), {0.9})
    task = only({"01": Counts("2ifc", 9, 10, 2, 10), "02": Counts("2ifc", 7, 10, 4, 10)})
    assert (task.rules, [check.types for check in task.checks]) == (RULES[:1], [("first", "second")])
    task = only({"01": THREE["01"], "02": Counts("same-different", 4, 6, 3, 6)})
    assert (task.checks, [len(one.checks) for one in task.subjects]) == ((), [2, 0])


def test_unequal_trials():
    analysis = analyse(UNEQUAL, selected_from=5)
    task = analysis["same-different"]
    assert (task.trials, task.selection) == (None, None)
    assert all(text in analysis.report() for text in (
        "trials differ between subjects", "the two kinds of trials are not equally many for 02",
    ))  # fmt: skip


_EFFECT = SelectionEffect(3, 20, 12)


@pytest.mark.parametrize(
    ("options", "of", "told"),
    [
        (
            {"selected_from": 20, "selected_by": "score of task 1"}, 20,
            [
                "SELECTED (score of task 1): 3 of 20 subjects.",
                f"the best 3 of 20 guessing have {_EFFECT.expected:.2f} of 12 on average",
            ],
        ),
        ({"subjects": ["01", "03"]}, 3, ["SELECTED: 2 of 3 subjects."]),
        ({"selected_by": "their teacher"}, 0, [
         "SELECTED (their teacher): 3 subjects, of how many is not known"]),
        ({"subjects": ["03", "02", "01"], "selected_from": 3}, 0, []),
    ],
)  # fmt: skip
def test_selection(options, of, told):
    analysis = analyse({"probing": THREE}, **options)
    task, report = analysis["probing"], analysis.report()
    assert (task.of, task.selected, "SELECTED" in report) == (of, bool(told), bool(told))
    assert all(one in report for one in told)
    assert (f"{len(task.subjects)} selected of {of}" in task.title) is (of > 0)
    assert task.selection == (SelectionEffect(len(task.subjects), of, 12) if of else None)
    if len(task.subjects) == 2:
        assert [one.holm for one in task.subjects] == pytest.approx([79 / 4096, 2 / 4096])


def test_html_is_escaped():
    text = analyse({"a<b": {"01": THREE["01"]}})._repr_html_()
    assert "a&lt;b" in text
    assert "a<b" not in text


@pytest.mark.parametrize("options", [{}, {"delta": 1.5, "selected_from": 20, "simulated": True}])
def test_json_round_trip(options, tmp_path):
    analysis = analyse(
        {"probing": THREE, "match": {"01": Counts("abx", 4, 5, 0, 5, {"AB": (4, 5), "BA": (0, 5)})}},
        **options,
    )
    analysis.to_json(tmp_path / "analysis.json")
    back, text = Analysis.from_json(tmp_path / "analysis.json"), io.StringIO()
    assert (back, back.report()) == (analysis, analysis.report())
    back.to_json(text)
    assert Analysis.from_json(io.StringIO(text.getvalue())) == analysis
    assert json.loads(text.getvalue())["tasks"][0]["subjects"][2]["d_prime"][0]["interval"][1] == "inf"


def test_tsv_of_the_subjects():
    text = io.StringIO()
    analyse({"probing": THREE, "match": {"01": Counts("abx", 4, 5, 0, 5)}}).to_tsv(text)
    head, *rows = (line.split("\t") for line in text.getvalue().splitlines())
    table = [dict(zip(head, row, strict=True)) for row in rows]
    assert [(row["task"], row["subject"], row["score"]) for row in table] == [
        ("probing", "01", "10"), ("probing", "02", "7"), ("probing", "03", "12"), ("match", "01", "9"),
    ]  # fmt: skip
    assert [table[1][name] for name in ("hits", "signals", "false_alarms", "noises")] == ["4", "6", "3", "6"]
    assert table[2]["d_prime_differencing_high"] == "inf"
    assert table[2]["d_prime_differencing_standard_error"] == "n/a"
    assert float(table[0]["p_value"]) == 79 / 4096
    assert float(table[0]["p_holm"]) == pytest.approx(2 * 79 / 4096)
    assert float(table[0]["proportion_low"]) < 10 / 12 < float(table[0]["proportion_high"])


@pytest.mark.parametrize(("width", "parts"), [(60, 3), (80, 3), (100, 2), (130, 1)])
def test_report_as_wide_as_the_screen(three, width, parts):
    text = three.report(width=width)
    assert max(map(len, text.splitlines())) <= width
    # No word or number is lost; each part of the table begins with the subjects.
    assert set(three.report().split()) <= set(text.split())
    assert sum(line.lstrip().startswith("subject ") for line in text.splitlines()) == parts
    assert three.report(width=500) == three.report()
    assert "imulated" not in text


_NONE = r"a\.json: this is not the JSON of a analysis"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        *((content, _NONE) for content in (b"", b"[" * 100_000, b"\xff\xfe", b"[]")),
        *(({"tasks": part}, r"a\.json: ") for part in (5, [{"subjects": None}], None)),
        *(
            (
                {"tasks": [task | {"subjects": [one | {"d_prime": []} for one in task["subjects"]]}]},
                r"a\.json: ",
            )
            for task in analyse({"probing": THREE}).to_dict()["tasks"]
        ),
        ({"burrlab analysis": None}, r"a\.json: .*'burrlab analysis' must be 1, got None"),
    ],
)
def test_json_that_is_none_is_named(three, content, sentence, tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(
        content if isinstance(content, bytes) else json.dumps(three.to_dict() | content).encode()
    )
    refused((lambda: Analysis.from_json(path), sentence))


_LEVELS = Answers("01", "level", "2ifc", (AnswerRow(0.0, 1.0, "RC", "first", False, 1.0, 1, level=1.2),))
_ABX = Counts("abx", 4, 5, 0, 5)


@pytest.mark.parametrize(
    ("kind", "ask", "sentence"),
    [
        *((TypeError, lambda data=data: analyse(data), "data must") for data in (None, 5, b"x", [1], _ABX, [_ABX])),
        # The letters of a string would be taken for subjects.
        (TypeError, lambda: analyse({"1": _ABX, "2": _ABX}, subjects="12"), r"subjects must be a list of labels, such as \['12'\], got '12'"),
        (TypeError, lambda: analyse({"01": 3}), "subject 01 must have Counts or Answers, got int"),
        (ValueError, lambda: analyse(THREE, subjects=["01", "04"]), "subjects must be of 01, 02, 03, got 04"),
        (ValueError, lambda: analyse(THREE, subjects=[]), "subjects must be of 01, 02, 03, got none"),
        (ValueError, lambda: analyse(THREE, selected_from=2),
         "selected_from must be at least the 3 subjects of task same-different, got 2"),
        (ValueError, lambda: analyse({}), "data must hold a subject, got none"),
        (ValueError, lambda: analyse({"probing": {}}), "task probing must hold a subject, got none"),
        (ValueError, lambda: analyse([]), "data must hold answers, got none"),
        (ValueError, lambda: analyse({"probing": {"01": THREE["01"], "02": _ABX}}),
         "task probing must be of one kind, got abx, same-different"),
        (ValueError, lambda: analyse({"level": {"01": _LEVELS, "02": Counts("2ifc", 3, 5, 1, 5)}}),
         "task level has levels, and answers of subject 02 have none"),
        (ValueError, lambda: analyse(THREE, rules=[]), "rules must hold one at least, got none"),
        (ValueError, lambda: analyse(THREE, rules=["x"]),
         "rule must be one of independent-observations, differencing, got 'x'"),
        (ValueError, lambda: analyse(THREE, level=1.0), r"level must be in \[0.5, 1\), got 1.0"),
        (ValueError, lambda: analyse(THREE, delta=-1), "delta must be a d' above 0, got -1"),
        (KeyError, lambda: analyse({"01": _ABX})["x"], "task must be one of abx, got 'x'"),
        (ValueError, lambda: only({"01": _ABX}).subject("x"), "subject must be one of 01, got 'x'"),
        (ValueError, lambda: only({"01": _ABX}, rules=["differencing"]).subjects[0].of_rule("x"),
         "rule must be one of differencing, got 'x'"),
        (ValueError, lambda: only(UNEQUAL).plot_scores(),
         "a histogram of scores needs equally many trials a subject, got 12, 22"),
        (ValueError,
         lambda: only().plot_scores(published=group_score_from(mean=9.4, sem=0.4, n=5, trials=10, task="abx")),
         "published must be of 12 trials, as the task, got 10"),
        (ValueError, lambda: thresholds((None, None)).plot_thresholds(),
         "task level must hold a threshold to be drawn, got none"),
    ],
)  # fmt: skip
def test_refusals(kind, ask, sentence):
    refused((ask, sentence), error=kind)


@pytest.fixture(scope="module")
def task():
    return only({"probing": FOUR}, delta=1.5)


def arrows(axes):
    return [text for text in axes.texts if isinstance(text, Annotation) and text.arrow_patch is not None]


def labels(axes):
    return axes.get_legend_handles_labels()[1]


def names(axes):
    return [text.get_text() for text in axes.get_yticklabels()]


def test_scores(task):
    axes = task.plot_scores(published=group_score_from(mean=9.3, sem=0.4, n=20, trials=12))
    heights = [bar.get_height() for bar in axes.patches if hasattr(bar, "get_height")]
    assert heights[:13] == [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 2, 0, 1]
    (stairs,) = (patch for patch in axes.patches if not hasattr(patch, "get_height"))
    values, edges, _ = stairs.get_data()
    assert values == pytest.approx(4 * stats.binom.pmf(np.arange(13), 12, 0.5))
    assert edges == pytest.approx(np.arange(14) - 0.5)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("score [correct answers of 12]", "subjects")
    assert {
        f"mean ± s.e.m., {task.score.mean:.1f} ± {task.score.sem:.1f}",
        "published, 9.3 ± 0.4, n = 20",
    } <= set(labels(axes))
    marks = {line.get_marker(): list(line.get_xdata()) for line in axes.lines}
    assert (marks["D"], marks["s"]) == ([9.75], [9.3])
    assert not any("published" in label for label in labels(task.plot_scores()))


def test_intervals_of_the_score(task):
    axes = task.plot_intervals()
    assert axes.get_xlabel() == "correct [%], 95 % interval"
    assert (names(axes), arrows(axes)) == (["01", "02", "03", "04"], [])
    assert "chance" in labels(axes)
    (chance,) = (line for line in axes.lines if line.get_linestyle() == "--")
    assert list(chance.get_xdata()) == [50, 50]
    bars = [line for line in axes.collections if isinstance(line, LineCollection)]
    ends = [(path.vertices[0, 0], path.vertices[1, 0]) for line in bars for path in line.get_paths()]
    expected = [tuple(100 * end for end in one.score_interval) for one in task.subjects]
    assert np.array(ends) == pytest.approx(np.array(expected))


def test_d_prime_of_both_rules_and_the_group(task):
    axes = task.plot_d_prime()
    assert (names(axes), axes.get_xlabel()) == (["01", "02", "03", "04", "all"], "d' [sd], 95 % interval")
    assert {*RULES, "chance, d' = 0", "Δ = 1.5"} <= set(labels(axes))
    opened = sum(math.isinf(d.interval[1]) for one in task.subjects for d in one.d_prime)
    assert len(arrows(axes)) == opened + sum(math.isinf(group.interval[1]) for group in task.group_d_prime)
    assert "estimate infinite" in labels(axes)
    finite = [
        x for one in task.subjects for d in one.d_prime for x in (*d.interval, d.estimate) if math.isfinite(x)
    ]
    assert max(finite) < axes.get_xlim()[1]


def test_simulated_subjects_and_selection_stand_in_every_title():
    made = only(FOUR, simulated=True, selected_from=20)
    assert (
        repr(made) == "ScoredTask('same-different', same-different, 4 simulated subjects, 9.8 +- 1.0 of 12)"
    )
    for axes in (made.plot_scores(), made.plot_intervals(), made.plot_d_prime()):
        assert "(simulated subjects; 4 selected of 20)" in axes.get_title().replace("\n", " ")


def thresholds(*found, design=()):
    """A task of subjects with these thresholds and intervals."""
    subjects = tuple(
        SubjectThreshold(f"{place:02}", True, 60, 60, ((1.2, 40, 60),), value, ends, "said", None)
        for place, (value, ends) in enumerate(found, start=1)
    )
    return ThresholdTask("level", dict(design), 0.95, subjects, (), 0, 0, "")


def test_thresholds():
    made = thresholds((1.1, (1.05, 1.2)), (1.3, None), (None, None), design={"parameter": "c_e"})
    axes = made.plot_thresholds()
    assert names(axes) == ["01", "02", "all"]
    assert axes.get_xlabel() == "threshold, c_e over the reference's [1], 95 % interval"
    assert "(simulated subjects)" in axes.get_title()
    assert made.group_threshold[0] == pytest.approx(math.exp(math.sqrt(math.log(1.1) * math.log(1.3))))
    # Thresholds on both sides of 1 have no mean, and equal ones no interval.
    sides = thresholds((1.1, None), (0.9, None))
    assert sides.group_threshold is thresholds((1.1, None), (1.1, None)).group_threshold is None
    assert names(sides.plot_thresholds()) == ["01", "02"]
    limited = StaircaseThreshold(1.3, 0.26, None, 0.75, 8, 60, 5, True)
    open_one = replace(made, subjects=(made.subjects[0], replace(made.subjects[1], estimate=limited)))
    assert group_lines(open_one)[-1].startswith("Some of these thresholds may lie beyond the levels")
    assert group_lines(made)[-1].startswith("The group is without 1 of 3 subjects, who have no threshold")


def test_psychometric_function():
    fit = PsychometricFit(
        threshold=1.2, interval=(1.1, 1.4), slope=1.25, slope_interval=(1.0, 2.0), lapse=0.02,
        lapse_interval=(0.0, 0.1), overdispersion=0.0, level=0.95, guess_rate=0.5, proportion=0.75,
        ratios=(1.05, 1.2, 1.5), correct=(11, 15, 20), trials=(20, 20, 20), side="above", parameter="c_e",
        reference=2.145, at_bounds=(), provenance={},
    )  # fmt: skip
    one = SubjectThreshold("01", True, 60, 60, (), 1.2, (1.1, 1.4), str(fit), fit)
    axes = ThresholdTask("level", {}, 0.95, (one,), (), 0, 0, "").plot_psychometric()
    assert axes.get_title().replace("\n", " ") == "level (simulated subjects), subject 01"
    assert "c_e" in axes.get_xlabel()
