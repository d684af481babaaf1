"""An analysis of an experiment's files: its protocol, incomplete runs, and notes."""

import io
import json
import math
import re
from dataclasses import replace

import pytest
from answer_scenes import protocol as read
from answer_scenes import run
from session_scenes import refused

from burrlab.psychophysics import Analysis, Protocol, ThresholdTask, analyse, read_answers

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


def protocol(folder, tables, *runs, more="", subjects=3):
    """A protocol, and its runs as rows of what `run` takes."""
    made = read(folder, HEAD.format(more=more, subjects=subjects) + tables)
    for row in runs:
        run(made, *row)
    return made


def wrong_in(*numbers):
    """A `right` that is False in practice and in these trials."""
    return lambda trial: trial.phase == "main" and trial.number not in numbers


def test_a_protocol_with_its_settings(tmp_path):
    made = protocol(
        tmp_path, PROBING + MATCH, ("01", "probing", wrong_in(1)), ("02", "probing", wrong_in(2, 5, 7)),
        ("01", "match", wrong_in()),
    )  # fmt: skip
    analysis = analyse(made)
    assert analysis == replace(analyse(made.path), provenance=analysis.provenance)
    assert (analysis.name, [task.name for task in analysis.tasks]) == ("Trying", ["probing", "match"])
    task = analysis["probing"]
    assert [one.counts.score for one in task.subjects] == [11, 9]
    assert (task.rules, task.level, task.delta) == (("differencing",), 0.9, 2.0)
    text = analysis.report()
    assert all(
        part in text
        for part in (
            "Practice trials are left out.",
            "Delta = 2, as the protocol has it.",
            "No run of probing yet: 03.",
            "No run of match yet: 02, 03.",
            "reference specimen, match pettigrew, foil pvc, drilling, 10 trials, chance 5",
            "bone (A) against pvc (B), probing, 12 trials, chance 6",
        )
    )
    assert Analysis.from_dict(json.loads(json.dumps(analysis.to_dict()))) == analysis
    # A file is a protocol, whatever its suffix.
    less = tmp_path / "less.txt"
    less.write_text(re.sub(r"subjects = .*", 'subjects = ["01"]', made.path.read_text().replace(MATCH, "")))
    assert {
        "In the folder and not in the protocol, of probing: 02.",
        "Task match is in the folder and not in the protocol.",
    } <= {*analyse(less).notes}


def test_a_folder_and_single_files(tmp_path):
    made = protocol(tmp_path, PROBING, ("01", "probing", wrong_in(1)))
    folder, answers = analyse(made.folder), read_answers(made.data.answers("01", "probing"))
    assert (folder.name, folder["probing"].rules) == ("data", ("independent-observations", "differencing"))
    assert analyse([answers]).tasks == analyse({"probing": {"01": answers}}).tasks == folder.tasks
    refused(
        (lambda: analyse([answers, answers]), "subject 01 has task probing twice"),
        (
            lambda: analyse([answers, replace(answers, subject="02", side_car=None)]),
            "task probing of subject 02 has another design than that of subject 01",
        ),
    )


def test_incomplete_runs_are_listed(tmp_path):
    made = protocol(tmp_path, PROBING, ("03", "probing", wrong_in(1), 2))
    nobody = analyse(made)
    assert all("no complete run" in text for text in (nobody.report(), nobody._repr_html_()))
    refused((nobody["probing"].plot_d_prime, "task probing must hold a complete run to be drawn, got none"))
    run(made, "01", "probing", wrong_in(1))
    run(made, "02", "probing", wrong_in(1), 4 + 7)
    few = "03 (none of the main trials)"
    for incomplete, subjects, left_out, told in (
        (False, ["01"], ("02 (7 of 12 trials)", few),
         f"left out, as trials are missing: 02 (7 of 12 trials), {few}"),
        (True, ["01", "02"], (few,), "incomplete, and taken in on request: 02 (7 of 12 trials)"),
    ):  # fmt: skip
        analysis = analyse(made, incomplete=incomplete)
        task = analysis["probing"]
        assert ([one.subject for one in task.subjects], task.left_out) == (subjects, left_out)
        assert told in analysis.report()
        assert not task.selected


@pytest.mark.parametrize(
    "more",
    ['selected_by = "score of task 1"\nselected_from = 20', 'selected_by = "Best 12 of 20 by score"'],
)
def test_some_of_the_selected_subjects(tmp_path, more):
    runs = [("01", "probing", wrong_in(1)), ("02", "probing", wrong_in(2)), ("03", "probing", wrong_in(1), 5)]
    made = protocol(tmp_path, PROBING, *runs, subjects=12, more=more)
    analysis = analyse(made)
    task, text = analysis["probing"], analysis.report()
    assert (len(task.subjects), task.chosen, task.of) == (2, 12, 20)
    assert "): 12 of 20 subjects, of whom 2 are here. Others" in text
    # Two of the best twelve are not the best two of twenty.
    assert "the best 12 of 20 guessing have 7.06 of 12 on average, 1.06 above chance\n" in text
    assert "2 of 12 selected of 20" in task.title
    assert (task.selection.kept, task.selection.of) == (12, 20)
    some, given = (analyse(made, **one)["probing"] for one in ({"subjects": ["01"]}, {"selected_from": 4}))
    assert (len(some.subjects), some.chosen, some.of) == (1, 12, 20)
    assert (given.chosen, given.of) == (3, 4)


def test_a_text_about_answers_is_no_number_of_subjects(tmp_path):
    made = protocol(tmp_path, PROBING, ("01", "probing", wrong_in(1)), more='selected_by = "10 of 12 right"')
    assert analyse(made)["probing"].of == 0


def test_thresholds(tmp_path):
    made = protocol(tmp_path, LEVELS)
    for subject, limit in (("01", 1.15), ("02", 1.3)):
        for task in made.tasks:
            run(made, subject, task, lambda trial, at=limit: (trial.level or 0) > at or trial.number % 2 == 0)
    analysis = analyse(made)
    for task in analysis.tasks:
        assert isinstance(task, ThresholdTask)
        assert ([one.complete for one in task.subjects], task.left_out) == ([True, True], ())
        found = [one.threshold for one in task.subjects]
        assert all(1.0 < one < 2.0 for one in found)
        mean = sum(math.log(math.log(one)) for one in found) / 2
        assert math.log(math.log(task.group_threshold[0])) == pytest.approx(mean)
    updown, text = analysis["updown"], io.StringIO()
    assert updown.subjects[0].said in analysis.report()
    assert Analysis.from_dict(json.loads(json.dumps(analysis.to_dict()))) == analysis
    analysis.to_tsv(text)
    assert len(text.getvalue().splitlines()) == 7
    refused(
        (updown.plot_psychometric, "subject must be given, one of 01, 02"),
        (lambda: updown.plot_psychometric(subject="01"), "subject 01 has no psychometric function"),
        (lambda: updown.subject("03"), "subject must be one of 01, 02, got '03'"),
    )


def test_an_unfinished_staircase_is_left_out(tmp_path):
    (task,) = analyse(protocol(tmp_path, LEVELS, ("01", "updown", lambda trial: True, 3))).tasks
    assert task.subjects == ()
    assert task.left_out[0].startswith("01 (3 of ")


def test_without_the_extra_the_counts_are_shown(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "psignifit", None)
    text = analyse(protocol(tmp_path, LEVELS, ("01", "constant", lambda trial: trial.level != 1.05))).report()
    assert "01: no psychometric function: a psychometric function needs psignifit" in text
    assert "01: 0/20 at 1.05, 20/20 at 1.2, 20/20 at 1.5" in text


def test_a_delta_that_was_set_after_the_runs_is_not_called_the_protocol_s(tmp_path):
    made = protocol(tmp_path, PROBING, ("01", "probing", wrong_in(1)))
    made.path.write_text(made.path.read_text().replace("delta = 2", "delta = 3"))
    run(Protocol.read(made.path), "02", "probing", wrong_in(1))
    assert (
        "Delta = 3, as the protocol has it now, and it was 2 when 01 of probing began: it counts only if it "
        "was set before the answers were seen."
    ) in analyse(made.path).notes
