"""An analysis of an experiment's files: its protocol, what is left out, what is said."""

import io
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from burrlab.psychophysics.analysis import Analysis, analyse
from burrlab.psychophysics.answers import read_answers
from burrlab.psychophysics.protocol import Protocol
from burrlab.psychophysics.scored_task import ScoredTask
from burrlab.psychophysics.side_car import Answer
from burrlab.psychophysics.threshold_task import ThresholdTask
from burrlab.psychophysics.trial import Trial

RULES = ("independent-observations", "differencing")


def scored(analysis: Analysis, name: str) -> ScoredTask:
    task = analysis[name]
    assert isinstance(task, ScoredTask)
    return task


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
    for part in (
        "Practice trials are left out.",
        "Delta = 2, as the protocol has it.",
        "No run of probing yet: 03.",
        "No run of match yet: 02, 03.",
        "reference specimen, match pettigrew, foil pvc, drilling, 10 trials, chance 5",
        "bone (A) against pvc (B), probing, 12 trials, chance 6",
    ):
        assert part in text
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
