"""An analysis against numbers calculated by hand, what it warns of; JSON and back."""

import io
import json
import math
from pathlib import Path

import pytest
from scipy import stats

from burrlab.psychophysics.analysis import Analysis, analyse
from burrlab.psychophysics.published import SelectionEffect
from burrlab.psychophysics.rules import Counts
from burrlab.psychophysics.scored_task import ScoredTask, of_counts

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

    def test_refused(self) -> None:
        with pytest.raises(ValueError, match="subjects must be of 01, 02, 03, got 04"):
            analyse(THREE, subjects=["01", "04"])
        with pytest.raises(ValueError, match="subjects must be of 01, 02, 03, got none"):
            analyse(THREE, subjects=[])
        with pytest.raises(
            ValueError,
            match="selected_from must be at least the 3 subjects of task same-different, got 2",
        ):
            analyse(THREE, selected_from=2)


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


def test_json_of_something_else() -> None:
    with pytest.raises(ValueError, match=r"'burrlab analysis' must be 1, got None"):
        Analysis.from_dict({})
    with pytest.raises(ValueError, match="an analysis must be a JSON object, got list"):
        Analysis.from_json(io.StringIO("[]"))


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


def test_refused() -> None:
    with pytest.raises(ValueError, match="data must hold a subject, got none"):
        analyse({})
    with pytest.raises(ValueError, match="task probing must hold a subject, got none"):
        analyse({"probing": {}})
    with pytest.raises(ValueError, match="data must hold answers, got none"):
        analyse([])
    with pytest.raises(TypeError, match="subject 01 must have Counts or Answers, got int"):
        analyse({"01": 3})  # type: ignore[dict-item]
    with pytest.raises(ValueError, match="task probing must be of one kind, got abx, same-different"):
        analyse({"probing": {"01": THREE["01"], "02": Counts("abx", 4, 5, 0, 5)}})
    with pytest.raises(ValueError, match="rules must hold one at least, got none"):
        analyse(THREE, rules=[])
    with pytest.raises(
        ValueError, match="rule must be one of independent-observations, differencing, got 'x'"
    ):
        analyse(THREE, rules=["x"])
    with pytest.raises(ValueError, match=r"level must be in \[0.5, 1\), got 1.0"):
        analyse(THREE, level=1.0)
    with pytest.raises(ValueError, match="delta must be a d' above 0, got -1"):
        analyse(THREE, delta=-1)
    with pytest.raises(KeyError, match="task must be one of same-different, got 'x'"):
        analyse(THREE)["x"]
    with pytest.raises(ValueError, match="subject must be one of 01, 02, 03, got 'x'"):
        scored(analyse(THREE), "same-different").subject("x")


# --- from files ---


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


def test_of_counts_keeps_names() -> None:
    (task,) = of_counts(THREE)
    assert (task.name, task.task) == ("same-different", "same-different")


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
