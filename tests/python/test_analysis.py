"""An analysis against numbers calculated by hand, from counts and from files; what it warns of; JSON and back."""

import io
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from scipy import stats

from burrlab.psychophysics import (
    Analysis,
    Answer,
    Counts,
    Protocol,
    ScoredTask,
    SelectionEffect,
    ThresholdTask,
    Trial,
    analyse,
    read_answers,
)
from burrlab.psychophysics.report.task_data import of_counts

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

HEAD = """
[experiment]
name = "Trying"
seed = 3
subjects = {subjects}
{more}
[burr]
radius_mm = 3.0
[bone]
size_mm = [30.0, 30.0, 20.0]
voxel_mm = 0.2
[analysis]
delta = 2.0
rules = ["differencing"]
level = 0.9
"""
PROBING = """
[tasks.probing]
design = "same-different"
a = "bone"
b = "pvc"
mode = "probing"
trials = 12
practice = 4
"""
MATCH = """
[materials.specimen]
real = true
[tasks.match]
design = "abx"
reference = "specimen"
match = "pettigrew"
foil = "pvc"
trials = 10
"""
LEVELS = """
[tasks.constant]
design = "constant-stimuli"
reference = "bone"
parameter = "c_e"
levels = [1.05, 1.2, 1.5]
repeats = 20
[tasks.updown]
design = "staircase"
reference = "bone"
parameter = "c_e"
reversals = 4
[tasks.bayes]
design = "adaptive"
reference = "bone"
parameter = "c_e"
trials = 30
"""


def protocol(folder: Path, tables: str, more: str = "", subjects: int = 3) -> Protocol:
    path = folder / "experiment.toml"
    path.write_text(HEAD.format(more=more, subjects=subjects) + tables)
    return Protocol.read(path)


def run(
    protocol: Protocol,
    subject: str,
    task: str,
    answers: Callable[[Trial], bool],
    *,
    stop: int | None = None,
    simulated: bool = False,
) -> None:
    """Answers a run, right where `answers` says so."""
    file, order = protocol.begin(subject, task, simulated={"weber": 0.1} if simulated else None)
    onset, done = 0.0, 0
    try:
        while (trial := order.next()) is not None and (stop is None or done < stop):
            others = [one for one in protocol.tasks[task].answers if one != trial.correct]
            response = trial.correct if answers(trial) else others[0]
            ends = tuple("time" for _ in trial.intervals)
            file.append(Answer(trial, onset, 41.0, response, 0.5, ends))
            order.answer(response)
            onset, done = onset + 45.0, done + 1
    finally:
        file.close()


def wrong_in(numbers: Sequence[int]) -> Callable[[Trial], bool]:
    return lambda trial: trial.phase == "main" and trial.number not in numbers


def test_a_protocol_with_its_settings(tmp_path: Path) -> None:
    made = protocol(tmp_path, PROBING + MATCH)
    for subject, wrong in (("01", [1]), ("02", [2, 5, 7])):
        run(made, subject, "probing", wrong_in(wrong))
    run(made, "01", "match", wrong_in([]))
    analysis = analyse(made)
    assert analysis == replace(analyse(tmp_path / "experiment.toml"), provenance=analysis.provenance)
    assert analysis.name == "Trying"
    assert [task.name for task in analysis.tasks] == ["probing", "match"]
    task = scored(analysis, "probing")
    # All practice was answered wrongly.
    assert [one.counts.score for one in task.subjects] == [11, 9]
    assert (task.rules, task.level, task.delta) == (("differencing",), 0.9, 2.0)
    text = analysis.report()
    assert "Practice trials are left out." in text
    assert "Delta = 2, as the protocol has it." in text
    assert "No run of probing yet: 03." in text
    assert "No run of match yet: 02, 03." in text
    assert "reference specimen, match pettigrew, foil pvc, drilling, 10 trials, chance 5" in text
    assert "bone (A) against pvc (B), probing, 12 trials, chance 6" in text
    assert Analysis.from_dict(json.loads(json.dumps(analysis.to_dict()))) == analysis


def test_a_folder_and_single_files(tmp_path: Path) -> None:
    made = protocol(tmp_path, PROBING)
    run(made, "01", "probing", wrong_in([1]))
    folder = analyse(made.folder)
    assert folder.name == "data"
    assert scored(folder, "probing").rules == RULES
    answers = read_answers(made.data.answers("01", "probing"))
    assert analyse([answers]).tasks == folder.tasks
    assert analyse({"probing": {"01": answers}}).tasks == folder.tasks
    with pytest.raises(ValueError, match="subject 01 has task probing twice"):
        analyse([answers, answers])
    other = replace(answers, subject="02", side_car=None)
    with pytest.raises(
        ValueError, match="task probing of subject 02 has another design than that of subject 01"
    ):
        analyse([answers, other])


def test_incomplete_runs_are_listed(tmp_path: Path) -> None:
    made = protocol(tmp_path, PROBING)
    run(made, "01", "probing", wrong_in([1]))
    run(made, "02", "probing", wrong_in([1]), stop=4 + 7)
    run(made, "03", "probing", wrong_in([1]), stop=2)
    analysis = analyse(made)
    task = scored(analysis, "probing")
    assert [one.subject for one in task.subjects] == ["01"]
    assert task.left_out == ("02 (7 of 12 trials)", "03 (none of the main trials)")
    assert "left out, as their runs are incomplete: 02 (7 of 12 trials), 03" in analysis.report()
    assert not task.selected
    asked = analyse(made, incomplete=True)
    task = scored(asked, "probing")
    assert [one.subject for one in task.subjects] == ["01", "02"]
    assert task.left_out == ("03 (none of the main trials)",)
    assert "incomplete, and taken in on request: 02 (7 of 12 trials)" in asked.report()


def test_no_complete_run(tmp_path: Path) -> None:
    made = protocol(tmp_path, PROBING)
    run(made, "01", "probing", wrong_in([1]), stop=5)
    analysis = analyse(made)
    assert "no complete run" in analysis.report()
    assert "no complete run" in analysis._repr_html_()
    with pytest.raises(ValueError, match="task probing must hold a complete run to be drawn, got none"):
        scored(analysis, "probing").plot_d_prime()


def test_simulated_and_selected_in_the_files(tmp_path: Path) -> None:
    made = protocol(tmp_path, PROBING, more='selected_by = "best 2 of 20 in an earlier experiment"')
    for subject in ("01", "02"):
        run(made, subject, "probing", wrong_in([1]), simulated=True)
    analysis = analyse(made)
    task = scored(analysis, "probing")
    assert task.simulated
    assert (task.of, task.selected_by) == (20, "best 2 of 20 in an earlier experiment")
    assert "SELECTED (best 2 of 20 in an earlier experiment): 2 of 20 subjects." in analysis.report()
    assert "(simulated subjects; 2 selected of 20)" in task.title


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


@pytest.mark.parametrize(
    "more",
    ['selected_by = "score of task 1"\nselected_from = 20', 'selected_by = "Best 12 of 20 by score"'],
)
def test_some_of_the_selected_subjects(tmp_path: Path, more: str) -> None:
    made = protocol(tmp_path, PROBING, subjects=12, more=more)
    run(made, "01", "probing", wrong_in([1]))
    run(made, "02", "probing", wrong_in([2]))
    run(made, "03", "probing", wrong_in([1]), stop=5)
    task = scored(analyse(made), "probing")
    assert (len(task.subjects), task.chosen, task.of) == (2, 12, 20)
    text = analyse(made).report()
    assert "): 12 of 20 subjects, of whom 2 are here. Others" in text
    # Two of the best twelve are not the best two.
    assert "the best 12 of 20 guessing have 7.06 of 12 on average, 1.06 above chance\n" in text
    assert "2 of 12 selected of 20" in task.title
    assert task.selection is not None
    assert (task.selection.kept, task.selection.of) == (12, 20)
    some = scored(analyse(made, subjects=["01"]), "probing")
    assert (len(some.subjects), some.chosen, some.of) == (1, 12, 20)
    given = scored(analyse(made, selected_from=4), "probing")
    assert (given.chosen, given.of) == (3, 4)


def test_a_text_about_answers_is_no_number_of_subjects(tmp_path: Path) -> None:
    made = protocol(tmp_path, PROBING, more='selected_by = "10 of 12 right"')
    run(made, "01", "probing", wrong_in([1]))
    assert scored(analyse(made), "probing").of == 0


def test_thresholds(tmp_path: Path) -> None:
    made = protocol(tmp_path, LEVELS)
    for subject, limit in (("01", 1.15), ("02", 1.3)):
        for task in made.tasks:
            run(made, subject, task, lambda trial, at=limit: (trial.level or 0) > at or trial.number % 2 == 0)
    analysis = analyse(made)
    for task in analysis.tasks:
        assert isinstance(task, ThresholdTask)
        assert [one.complete for one in task.subjects] == [True, True]
        assert task.left_out == ()
        thresholds = [one.threshold for one in task.subjects]
        assert all(found is not None and 1.0 < found < 2.0 for found in thresholds)
        logs = [math.log(math.log(found)) for found in thresholds if found]
        assert task.group_threshold is not None
        assert math.log(math.log(task.group_threshold[0])) == pytest.approx(sum(logs) / 2)
    updown = analysis["updown"]
    assert isinstance(updown, ThresholdTask)
    assert updown.subjects[0].said in analysis.report()
    assert Analysis.from_dict(json.loads(json.dumps(analysis.to_dict()))) == analysis
    text = io.StringIO()
    analysis.to_tsv(text)
    assert len(text.getvalue().splitlines()) == 7
    with pytest.raises(ValueError, match="subject must be given, one of 01, 02"):
        updown.plot_psychometric()
    with pytest.raises(ValueError, match="subject 01 has no psychometric function"):
        updown.plot_psychometric(subject="01")
    with pytest.raises(ValueError, match="subject must be one of 01, 02, got '03'"):
        updown.subject("03")


def test_an_unfinished_staircase_is_left_out(tmp_path: Path) -> None:
    made = protocol(tmp_path, LEVELS)
    run(made, "01", "updown", lambda trial: True, stop=3)
    task = analyse(made).tasks[0]
    assert task.subjects == ()
    assert task.left_out[0].startswith("01 (3 of ")


def test_without_the_extra_the_counts_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "psignifit", None)
    made = protocol(tmp_path, LEVELS)
    run(made, "01", "constant", lambda trial: trial.level != 1.05)
    text = analyse(made).report()
    assert "01: no psychometric function: a psychometric function needs psignifit" in text
    assert "01: 0/20 at 1.05, 20/20 at 1.2, 20/20 at 1.5" in text


def test_of_counts_keeps_names() -> None:
    (task,) = of_counts(THREE)
    assert (task.name, task.task) == ("same-different", "same-different")


def test_a_delta_that_was_set_after_the_runs_is_not_called_the_protocol_s(tmp_path: Path) -> None:
    made = protocol(tmp_path, PROBING)
    run(made, "01", "probing", wrong_in([1]))
    changed = tmp_path / "experiment.toml"
    changed.write_text(changed.read_text().replace("delta = 2", "delta = 3"))
    run(Protocol.read(changed), "02", "probing", wrong_in([1]))
    notes = analyse(changed).notes
    assert (
        "Delta = 3, as the protocol has it now, and it was 2 when 01 of probing began: it counts only if it was set before "
        "the answers were seen."
    ) in notes


def test_what_the_protocol_does_not_name_is_said(tmp_path: Path) -> None:
    made = protocol(tmp_path, PROBING + MATCH)
    for subject, task in (("01", "probing"), ("02", "probing"), ("01", "match")):
        run(made, subject, task, wrong_in([1]))
    # Whatever its name ends in, a file is a protocol.
    less = tmp_path / "less.txt"
    text = (tmp_path / "experiment.toml").read_text().replace(MATCH, "")
    less.write_text(re.sub(r"subjects = .*", 'subjects = ["01"]', text))
    notes = analyse(less).notes
    assert "In the folder and not in the protocol, of probing: 02." in notes
    assert "Task match is in the folder and not in the protocol." in notes


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
