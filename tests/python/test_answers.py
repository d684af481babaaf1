"""Answers read back, errors that name the line, and the folder of an experiment."""

import json

import pytest
from answer_scenes import SMALL, TASKS, begun, protocol, trials_of
from hypothesis import given, settings
from hypothesis import strategies as st
from session_scenes import file_size_limit, refused

from burrlab.psychophysics.answers import ExperimentFolder, read_answers, read_folder, read_rows, replay
from burrlab.psychophysics.rules import Counts
from burrlab.psychophysics.side_car import AnswerRow, as_text, columns_of

HEAD = "onset\tduration\ttrial_type\tresponse\tcorrect\tresponse_time\ttrial"
ROWS = ["0\t41\tAA\tsame\t1\t0.5\t1", "60\t41\tAB\tsame\t0\t0.5\t2", "120\t41\tBB\tsame\t1\tn/a\t3"]
MINE = "sub-01_task-mine_events.tsv"


def written(folder, *lines, name=MINE):
    """A file of another program."""
    path = folder / name
    path.write_text("".join(f"{line}\n" for line in lines), errors="surrogateescape")
    return path


def copied(path, target, **said):
    """A copy of a run with a changed side-car."""
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(path.read_bytes())
    target.with_suffix(".json").write_text(
        json.dumps(json.loads(path.with_suffix(".json").read_text()) | said)
    )
    return target


@pytest.mark.parametrize("task", TASKS)
def test_what_was_written_is_read(tmp_path, task):
    one, path = begun(tmp_path, task, 4, "02")
    found, trials = read_answers(path), trials_of(one, task, 4, subject="02")
    assert (found.subject, found.name, found.task) == ("02", task, one.tasks[task].task)
    assert (found.notes, found.simulated, found.trials) == ((), False, one.order("02", task).total)
    assert [(r.trial_type, r.level, r.onset, r.correct, r.stimuli, r.seeds) for r in found.rows] == [
        (
            t.trial_type, t.level, 60.0 * place, place != 2, tuple(i.stimulus.name for i in t.intervals),
            tuple(i.seed for i in t.intervals),
        )
        for place, t in enumerate(trials)
    ]  # fmt: skip
    assert found == read_answers(path)


def test_counts_are_of_the_main_phase_and_of_each_type(tmp_path):
    assert read_answers(begun(tmp_path, count=10, right=lambda trial: True)[1]).counts() == Counts(
        "same-different", hits=4, signals=4, false_alarms=0, noises=4,
        by_type={"AA": (0, 2), "AB": (2, 2), "BA": (2, 2), "BB": (0, 2)},
    )  # fmt: skip


def test_practice_alone_cannot_be_counted(tmp_path):
    answers = read_answers(begun(tmp_path, count=2)[1])
    assert not answers.main
    assert "0 answers and 2 in practice" in repr(answers)
    refused((lambda: answers.counts(), "there is no answer of the main phase to count"))


@pytest.mark.parametrize(
    ("name", "change", "options", "labels"),
    [
        (MINE, lambda line: line, {}, ("01", "mine")),
        (
            "x.tsv", lambda line: line.replace("same", "gleich"),
            {"answers": ("gleich", "verschieden"), "subject": "7"}, ("7", "same-different"),
        ),
        (MINE, lambda line: "\ufeff" * (line == HEAD) + f"{line}\r", {}, ("01", "mine")),
        (
            "x.tsv", lambda line: line + ("\tparticipant_id" if line == HEAD else "\tsub-04"), {},
            ("04", "same-different"),
        ),
    ],
)  # fmt: skip
def test_a_file_of_another_program(tmp_path, name, change, options, labels):
    """With other words for answers, a spreadsheet's marks, and the subject in a column."""
    answers = read_answers(
        written(tmp_path, *map(change, [HEAD, *ROWS]), name=name), task="same-different", **options
    )
    assert (answers.subject, answers.name, answers.side_car, answers.trials) == (*labels, None, None)
    assert [row.response for row in answers.rows] == ["same"] * 3
    pytest.importorskip("pandas", reason="extra `pandas` is not installed")
    table = answers.to_dataframe()
    assert list(table)[:6] == [
        "onset_s",
        "duration_s",
        "trial_type",
        "response",
        "correct",
        "response_time_s",
    ]
    assert table.onset_s.tolist() == [row.onset for row in answers.rows]
    assert answers.rows[2].response_time is None
    assert answers.counts() == Counts(
        "same-different", 0, 1, 0, 2, {"AA": (0, 1), "AB": (0, 1), "BB": (0, 1)}
    )


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda rows: [HEAD.replace("\tcorrect", "")], "line 1: column correct is missing"),
        (lambda rows: [HEAD + "\tmood"], "line 1: unknown column 'mood'; known are onset, duration"),
        (lambda rows: [HEAD + "\tonset"], "line 1: column onset is there twice"),
        (lambda rows: [HEAD + "\t"], "line 1: a column has no name"),
        (lambda rows: [HEAD.replace("\t", ",")], "line 1: the separator must be a tab, not a comma"),
        (lambda rows: [], "the file is empty"),
        (lambda rows: [HEAD, "\udcff"], "this is not a text file in UTF-8"),
        (lambda rows: [HEAD, "\0"], "this is not a text file, it holds zero bytes"),
        (lambda rows: [HEAD, "\a"], "this is not a text file, it holds the control character"),
        (lambda rows: [HEAD, *rows, rows[1]],
         "line 5, column trial: main trial 2 is answered in line 3 already"),
        (lambda rows: [HEAD, rows[0], rows[2]], "line 3, column trial: main trial 2 is due, got 3"),
        (lambda rows: [HEAD, rows[1], rows[0]], "line 2, column trial: main trial 1 is due, got 2"),
        (lambda rows: [HEAD, rows[0][:-1] + "0"], "line 2, column trial: must be at least 1"),
        (lambda rows: [HEAD, rows[0].replace("same", "alike")],
         "line 2, column response: must be one of same, different"),
        (lambda rows: [HEAD, rows[0].replace("same", "n/a")],
         "line 2, column response: must be one of same, different"),
        (lambda rows: [HEAD, rows[0].replace("AA", "XY")],
         "line 2, column trial_type: must be one of AA, AB, BA, BB"),
        (lambda rows: [HEAD, rows[0].replace("AA", "AB")],
         "line 2, column correct: after AB the correct answer is 'different'"),
        (lambda rows: [HEAD, rows[0].replace("same\t1", "same\t0")],
         "line 2, column correct: after AA the correct answer"),
        (lambda rows: [HEAD, rows[0].replace("same\t1", "same\tyes")],
         "line 2, column correct: must be one of 0, 1, got 'yes'"),
        (lambda rows: [HEAD, "n/a" + rows[0][1:]], "line 2, column onset: every row needs a number"),
        (lambda rows: [HEAD, "inf" + rows[0][1:]], "line 2, column onset: must be a finite number"),
        (lambda rows: [HEAD, "1_0" + rows[0][1:]], "line 2, column onset: must be a finite number"),
        (lambda rows: [HEAD, rows[0].replace("41", "4,1")],
         "line 2, column duration: must be a finite number with a point"),
        (lambda rows: [HEAD, rows[0].replace("41", "-41")], "line 2, column duration: must be at least 0"),
        (lambda rows: [HEAD, rows[0].replace("0.5", "-0.5")],
         "line 2, column response_time: must be at least 0"),
        (lambda rows: [HEAD, rows[0][:-1] + "1.0"], "line 2, column trial: must be a whole number from 0"),
        (lambda rows: [HEAD, rows[0][:-1] + "n/a"], "line 2, column trial: every row needs a number"),
        (lambda rows: [HEAD, rows[0], "-5" + rows[1][2:]],
         "line 3, column onset: must not be before the last trial's 0.0"),
        (lambda rows: [HEAD, rows[0] + "\t1"], "line 2: 7 fields are due, found 8"),
        (lambda rows: [HEAD, rows[0].replace("same", '"same')], "line 2: not a line of fields between tabs"),
        (lambda rows: [HEAD + "\tlevel", rows[0] + "\t0"], "line 2, column level: must be a ratio above 0"),
        (lambda rows: [HEAD + "\tphase", rows[0] + "\twarm"],
         "line 2, column phase: must be one of practice, main"),
        (lambda rows: [HEAD + "\tseed_1", rows[0] + f"\t{2**64}"],
         "line 2, column seed_1: must be a whole number"),
        (lambda rows: [HEAD + "\trepeats", rows[0] + "\t10"],
         "line 2, column repeats: must be a whole number"),
        (lambda rows: [HEAD + "\tended_2", rows[0] + "\tbored"],
         "line 2, column ended_2: must be one of time, "),
        (lambda rows: [HEAD + "\tended_3", rows[0] + "\ttime"], "line 1: unknown column 'ended_3'"),
        (
            lambda rows: [HEAD + "\tphase", rows[0] + "\tmain", rows[0] + "\tpractice"],
            "line 3, column phase: practice comes before the main phase",
        ),
        (lambda rows: [HEAD + "\tblock", rows[0] + "\t0"],
         "line 2, column block: must be at least 1 after practice"),
        (
            lambda rows: [HEAD + "\tblock", rows[0] + "\t2", rows[1] + "\t1"],
            "line 3, column block: must not be before the last trial's 2",
        ),
        (
            lambda rows: [HEAD + "\tparticipant_id", rows[0] + "\tsub-01", rows[1] + "\tsub-02"],
            "line 3, column participant_id: '02' in a file of subject '01'",
        ),
    ],
)  # fmt: skip
def test_every_mistake_is_named_by_its_line(tmp_path, change, sentence):
    path = written(tmp_path, *change(ROWS))
    refused(
        (
            lambda: read_answers(path, task="same-different"),
            f"events.tsv(, |: ){sentence.replace('(', '[(]')}",
        )
    )


def test_a_correct_flag_of_two_intervals_contradicts_another_row(tmp_path):
    rows = [f"{HEAD}\tlevel", "0\t9\tRC\tsecond\t1\t1\t1\t1.5", "20\t9\tCR\tsecond\t1\t1\t2\t0.5"]
    assert len(read_answers(written(tmp_path, *rows), task="2ifc").rows) == 2
    rows[2] = rows[2].replace("second", "first")
    refused(
        (
            lambda: read_answers(written(tmp_path, *rows), task="2ifc"),
            r"line 3, column correct: the response 'first' .* contradicts line 2",
        )
    )


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({}, "is not beside it, which tells the task; or give task="),
        ({"task": "odd"}, "task must be one of same-different, abx, 2ifc, got 'odd'"),
        ({"task": "same-different"}, "the subject is unknown: name the file"),
        *(
            ({"task": "same-different", "answers": answers},
             "answers must be two that differ, in the order of their keys")
            for answers in (5, [1, 2], ["same", "same", "different"], "ab", ["a", "a"])
        ),
    ],
)  # fmt: skip
def test_what_must_be_given(tmp_path, options, sentence):
    refused((lambda: read_answers(written(tmp_path, HEAD, *ROWS, name="x.tsv"), **options), sentence))


def test_what_the_file_says_otherwise(tmp_path):
    _, path = begun(tmp_path, count=3)
    other = copied(path, path.with_name("sub-02_task-probing_events.tsv"))
    refused(
        (lambda: read_answers(path, task="abx"),
         "task must be 'same-different', as the file says, got 'abx'"),
        (lambda: read_answers(other),
         "subject is '02' in the file's name and '01' in sub-02_task-probing_events.json"),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda car: car.pop("Seed"), "Seed is missing"),
        (lambda car: car.update(Seed="7"), "Seed must be a whole number, got '7'"),
        (lambda car: car.update(BurrlabRun=2), "BurrlabRun must be 1, got 2"),
        (lambda car: car.update(Task="odd"), "Task must be one of same-different"),
        (lambda car: car.update(Started="today"), "Started must be a time with its zone, got 'today'"),
        (
            lambda car: car["Protocol"]["experiment"].update(seed=8),
            "ProtocolDigest does not belong to the Protocol",
        ),
        (lambda car: car.update(Seed=8), "Seed is not that of the Protocol beside it"),
        (lambda car: car["Design"].update(trials=4), "Design is not that of the Protocol beside it"),
        (
            lambda car: car.update(Trials=4),
            "Task and Trials must be 'same-different' and 10, those of the Design, got 'same-different' "
            "and 4",
        ),
        (lambda car: "{", "this is not JSON in UTF-8"),
        (lambda car: "[" * 100_000, "this is not JSON in UTF-8"),
    ],
)
def test_a_side_car_that_was_changed(tmp_path, change, sentence):
    """It stops those who read its answers; another subject begins, and the experimenter learns of it."""
    one, path = begun(tmp_path, count=3)
    car = json.loads(path.with_suffix(".json").read_text())
    path.with_suffix(".json").write_text(text if isinstance(text := change(car), str) else json.dumps(car))
    refused((lambda: read_answers(path), f"events.json: {sentence}"))
    with one.begin("02", "probing")[0] as file:
        assert f"sub-01_task-probing_events.json: {sentence}" in file.notes[0]


def _beside(name, **said):
    """A function that copies a run beside it, or into another subject's folder."""
    return lambda path: copied(path, path.parents[2] / name, **said)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            _beside("sub-01/beh/sub-01_task-probing_run-2_events.tsv"),
            r"subject 01 has another file for task probing, .*sub-01_task-probing_events.tsv",
        ),
        (
            lambda path: path.parents[1].rename(path.parents[2] / "sub-02"),
            "the answers are of subject 01, the folder is sub-02",
        ),
        (
            _beside("sub-02/beh/sub-02_task-probing_events.tsv", Subject="02", Simulated=True, SimulatedSubject={"weber": 0.1}),
            "a simulated subject is among others: .*sub-02",
        ),
        (
            lambda path: begun(
                path.parents[3], count=3, subject="02",
                text=SMALL.replace("trials = 8", "trials = 4").replace("seed = 7", 'seed = 7\nfolder = "other"'),
            )[1].parents[1].rename(path.parents[2] / "sub-02"),
            r"was another one in .*sub-01.*: tasks.probing.trials was 8, is now 4",
        ),
        (lambda path: path.unlink(), "there is no file of answers"),
    ],
)  # fmt: skip
def test_a_folder_that_does_not_hold_together(tmp_path, change, sentence):
    one, path = begun(tmp_path, count=3)
    change(path)
    refused((lambda: read_folder(one.folder), sentence))


def test_a_run_replayed(tmp_path):
    one, path = begun(tmp_path, "match", 4)
    rows, order = list(enumerate(read_answers(path).rows, start=2)), one.order("01", "match")
    replay("x", rows, order)
    assert (len(order.answered), order.next()) == (4, None)
    refused(
        (lambda: replay("x", rows, one.order("02", "match")),
         r"x, line 2, column (trial_type|seed_1): .* made with another seed or protocol"),
        (lambda: replay("x", [*rows, (6, rows[-1][1])], one.order("01", "match")),
         "x, line 6: the run has no trial left that this could answer"),
        (lambda: begun(tmp_path, "match", 1, "02", SMALL.replace("seed = 7", "seed = 8")),
         "test.toml: others had another task match: experiment.seed was 7, is now 8"),
    )  # fmt: skip


NUMBER = st.floats(0, 1e6, allow_nan=False).map(lambda value: round(value, 6))
#: Types of trials and their correct answers.
CORRECT = {
    "same-different": {"AA": "same", "BB": "same", "AB": "different", "BA": "different"},
    "abx": {"AB": "first", "BA": "second"},
    "2ifc": {"CR": "first", "RC": "second"},
}


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_rows_survive_the_file(data):
    task = data.draw(st.sampled_from(list(CORRECT)))
    answers, places, rows = sorted({*CORRECT[task].values()}), range(3 if task == "abx" else 2), []
    for place, onset in enumerate(sorted(data.draw(st.lists(NUMBER, min_size=1, max_size=6))), start=1):
        kind, right = data.draw(st.sampled_from(list(CORRECT[task]))), data.draw(st.booleans())
        correct = CORRECT[task][kind]
        row = AnswerRow(
            onset=onset,
            duration=data.draw(st.none() | NUMBER),
            trial_type=kind,
            response=correct if right else answers[answers[0] == correct],
            correct=right,
            response_time=data.draw(st.none() | NUMBER),
            trial=place,
            level=data.draw(
                st.none() | st.floats(1.0, 100.0, exclude_min=True) if task == "2ifc" else st.none()
            ),
            stimuli=tuple(data.draw(st.sampled_from(["bone", "bone c_e x1.1"])) for _ in places),
            seeds=tuple(data.draw(st.none() | st.integers(0, 2**64 - 1)) for _ in places),
            endings=tuple(data.draw(st.sampled_from(["time", "wall"])) for _ in places),
            repeats=data.draw(st.none() | st.integers(0, 9)),
            clipped=tuple(data.draw(st.none() | st.floats(0.0, 1.0)) for _ in places),
            boundary=data.draw(st.none() | st.floats(0.0, 100.0, exclude_min=True)),
            reached=data.draw(st.none() | st.booleans()),
            forces=tuple(data.draw(st.none() | NUMBER) for _ in places),
        )
        rows.append(row)
    head = ("\t".join(columns_of(task)) + "\n").encode()
    found = read_rows("x", head + b"".join(as_text(row, columns_of(task)) for row in rows), task)
    assert [row for _, row in found.rows] == rows


@pytest.mark.parametrize(
    ("task", "place", "kinds", "sentence"),
    [
        ("probing", 1, ("AB", "BA"), "BA has 'pvc' there, got 'bone'"),
        ("match", 2, ("AB", "BA"), "BA has 'pvc' there, got 'bone'"),
        ("up", 1, ("RC", "CR"), "CR has 'bone c_e x1.41421' there, got 'bone'"),
    ],
)
def test_a_type_that_contradicts_the_stimuli(tmp_path, task, place, kinds, sentence):
    """The answers stay right or wrong, but would be counted for other pairs."""
    _, path = begun(tmp_path, task, count=4)
    rows = path.read_text().splitlines()
    was, now = (f"\t{kind}\t" for kind in kinds)
    line = next(number for number, row in enumerate(rows) if was in row)
    other = rows[line].replace(was, now)
    if task != "probing":
        other = "\t".join(
            {"first": "second", "second": "first"}.get(field, field) for field in other.split("\t")
        )
    path.write_text("\n".join([*rows[:line], other, *rows[line + 1 :], ""]))
    refused((lambda: read_answers(path), f"line {line + 1}, column stimulus_{place}: {sentence}"))


@pytest.mark.parametrize("level", ["1.0", "n/a", "1.3"])
def test_a_level_that_the_design_cannot_have(tmp_path, level):
    _, path = begun(tmp_path, "up", count=3)
    rows = [row.split("\t") for row in path.read_text().splitlines()]
    rows[2][rows[0].index("level")] = level
    path.write_text("".join("\t".join(row) + "\n" for row in rows))
    refused(
        (
            lambda: read_answers(path),
            "line 3, column (level: must be one of the design's|stimulus_[12]: .* has 'bone c_e x1.3' there)",
        )
    )


def test_a_run_killed_while_its_files_were_made_stops_no_analysis(tmp_path):
    _, path = begun(tmp_path, "probing", count=4)
    other = path.parents[2] / "sub-02/beh/sub-02_task-probing_events.tsv"
    other.parent.mkdir(parents=True)
    other.write_text(path.read_text().splitlines()[0] + "\n")
    assert [run.subject for run in read_folder(path.parents[2])] == ["01"]


def test_more_answers_than_trials(tmp_path):
    _, path = begun(tmp_path, "match", count=4)
    *_, last = path.read_text().splitlines()
    path.write_text(path.read_text() + last.replace("\t4\tmain", "\t5\tmain") + "\n")
    refused((lambda: read_answers(path), "the run has at most 4 trials, got 5 answers"))


def test_the_folder_is_as_bids_has_it(tmp_path):
    one, path = begun(tmp_path, count=3)
    assert path == one.folder / "sub-01" / "beh" / "sub-01_task-probing_events.tsv"
    described = json.loads((one.folder / "dataset_description.json").read_text())
    assert [described[key] for key in ("Name", "BIDSVersion", "DatasetType")] == ["test", "1.10.0", "raw"]
    own = ("participant_id", "simulated", "selected_by")
    assert (one.folder / "participants.tsv").read_text() == "\t".join(own) + "\nsub-01\tno\tn/a\n"
    assert tuple(json.loads((one.folder / "participants.json").read_text())) == own
    head, *rows = path.read_text().splitlines()
    assert (tuple(head.split("\t")), len(rows)) == (
        columns_of("same-different", without=("boundary", "reached", "clipped")),
        3,
    )
    car = json.loads(path.with_suffix(".json").read_text())
    assert (car["Task"], car["ProtocolDigest"]) == ("same-different", one.digest)
    assert one.data.trace("01", "probing", "main", 1, 2) == one.data.log("01", "probing").with_name(
        "sub-01_task-probing_main-001_interval-2_trace.h5"
    )


def test_what_is_there_is_not_replaced(tmp_path):
    mine = protocol(tmp_path).folder / "dataset_description.json"
    mine.parent.mkdir()
    mine.write_text("{}")
    for task, subject in (("probing", "01"), ("probing", "02"), ("match", "02")):
        one, _ = begun(tmp_path, task, count=1, subject=subject)
    assert mine.read_text() == "{}"
    assert list(one.data.participants()) == ["01", "02"]
    assert [(a.name, a.subject) for a in read_folder(one.folder)] == [
        ("match", "02"), ("probing", "01"), ("probing", "02"),
    ]  # fmt: skip


def test_a_line_of_participants_broken_off_is_written_again(tmp_path):
    one, _ = begun(tmp_path)
    path = one.folder / "participants.tsv"
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        one.data.add("01", simulated=False)
        assert path.read_bytes() == whole


def test_simulated_subjects_and_people_do_not_mix(tmp_path):
    one, _ = begun(tmp_path)
    before = (one.folder / "participants.tsv").read_bytes()
    refused(
        (
            lambda: one.begin("02", "probing", simulated={"weber": 0.1}),
            "simulated subjects and people do not go into one folder: sub-01 has simulated no",
        )
    )
    assert (one.folder / "participants.tsv").read_bytes() == before
    assert not (one.folder / "sub-02").exists()


@pytest.mark.parametrize(
    ("text", "selected_by", "sentence"),
    [
        ("participant_id\nsub-01\n", None, "line 1: column simulated is missing"),
        ("participant_id\tsimulated\nsub-01\tno\nsub-01\tno\n", None, "line 3: subject 01 is there twice"),
        (
            "participant_id\tsimulated\nsub-01\tmaybe\n", None,
            "line 2, column simulated: must be yes or no, got 'maybe'",
        ),
        ("", "best\tof all", "a field must be a text without tabs, line breaks and quotation marks"),
    ],
)  # fmt: skip
def test_participants_that_are_not_right(tmp_path, text, selected_by, sentence):
    (tmp_path / "participants.tsv").write_text(text)
    refused(
        (
            lambda: ExperimentFolder(tmp_path, "x").add("02", simulated=False, selected_by=selected_by),
            sentence,
        )
    )


_OWN = "participant_id\tage\tselected_by\tsimulated\nsub-07\t33\tbest 12 of 20\tno"


@pytest.mark.parametrize(
    ("text", "due"),
    [
        *((_OWN + end, "sub-02\tn/a\tchance\tno\nsub-03\tn/a\tn/a\tno\n") for end in ("", "\n", "\r\n")),
        ("participant_id\tsimulated\tage", "age\nsub-02\tno\tn/a\nsub-03\tno\tn/a\n"),
    ],
)
def test_a_laboratory_s_own_columns_stay_and_rows_keep_to_them(tmp_path, text, due):
    path, folder = tmp_path / "participants.tsv", ExperimentFolder(tmp_path, "x")
    assert folder.participants() == {}
    path.write_bytes(text.encode())
    folder.add("02", simulated=False, selected_by="chance")
    folder.add("03", simulated=False)
    assert path.read_text().replace("\r\n", "\n").endswith(due)
    assert path.read_bytes().startswith(text.encode())
    assert list(folder.participants())[-2:] == ["02", "03"]


def test_a_full_disk_is_named_and_leaves_no_part(tmp_path):
    folder = ExperimentFolder(tmp_path, "x")
    with file_size_limit(20), pytest.raises(OSError, match=r"File too large: .*dataset_description\.json"):
        folder.add("01", simulated=False)
    assert not list(tmp_path.iterdir())
    folder.prepare()
    with file_size_limit(20), pytest.raises(OSError, match=r"participants\.tsv"):
        folder.add("01", simulated=False)
    folder.add("01", simulated=False)
    assert list(folder.participants()) == ["01"]
