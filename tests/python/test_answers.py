"""Answers read back, every mistake by its line, and the folder of an experiment."""

from __future__ import annotations

import json
import signal
import sys

import pytest
from answer_scenes import TASKS, begun, give, protocol
from hypothesis import given, settings
from hypothesis import strategies as st

from burrlab.psychophysics.answers import ExperimentFolder, read_answers, read_folder, read_rows, replay
from burrlab.psychophysics.rules import Counts
from burrlab.psychophysics.side_car import Row, RowReader, as_text, columns_of

HEAD = "onset\tduration\ttrial_type\tresponse\tcorrect\tresponse_time\ttrial"
ROWS = ["0\t41\tAA\tsame\t1\t0.5\t1", "60\t41\tAB\tsame\t0\t0.5\t2", "120\t41\tBB\tsame\t1\tn/a\t3"]


def written(folder, *lines, name="sub-01_task-mine_events.tsv", end="\n"):
    """A file of another program."""
    path = folder / name
    path.write_text("\n".join(lines) + end, encoding="utf-8")
    return path


@pytest.mark.parametrize("task", TASKS)
def test_what_was_written_is_read(tmp_path, task):
    one = protocol(tmp_path)
    file, order = one.begin("02", task)
    with file:
        trials = give(file, order, 4)
    answers = read_answers(file.path)
    assert (answers.subject, answers.name, answers.task) == ("02", task, one.tasks[task].task)
    assert answers.side_car == file.side_car
    assert not answers.notes
    assert not answers.simulated
    assert answers.trials == order.total
    assert [row.trial_type for row in answers.rows] == [trial.trial_type for trial in trials]
    assert [row.seeds for row in answers.rows] == [tuple(i.seed for i in t.intervals) for t in trials]
    assert [row.stimuli for row in answers.rows] == [
        tuple(i.stimulus.name for i in t.intervals) for t in trials
    ]
    assert [row.level for row in answers.rows] == [trial.level for trial in trials]
    assert [row.correct for row in answers.rows] == [True, True, False, True]
    assert [row.onset for row in answers.rows] == [0.0, 60.0, 120.0, 180.0]
    assert answers == read_answers(file.path)


def test_counts_are_of_the_main_phase_and_of_each_type(tmp_path):
    one = protocol(tmp_path)
    file, order = one.begin("01", "probing")
    with file:
        give(file, order, 10, wrong=100)
    counts = read_answers(file.path).counts()
    assert counts == Counts(
        "same-different", hits=4, signals=4, false_alarms=0, noises=4,
        by_type={"AA": (0, 2), "AB": (2, 2), "BA": (2, 2), "BB": (0, 2)},
    )  # fmt: skip


def test_hits_of_abx_and_of_two_intervals_are_of_the_first(tmp_path):
    one = protocol(tmp_path)
    for task in ("match", "up"):
        file, order = one.begin("01", task)
        with file:
            trials = give(file, order, 4, wrong=2)
        counts = read_answers(file.path).counts()
        first = [trial.correct == "first" for trial in trials]
        assert counts.signals == sum(first)
        # Every second answer is wrong.
        assert counts.hits == sum(first[0::2])
        assert counts.false_alarms == sum(not one for one in first[1::2])


def test_practice_alone_cannot_be_counted(tmp_path):
    _, path = begun(tmp_path, count=2)
    answers = read_answers(path)
    assert not answers.main
    assert "0 answers and 2 in practice" in repr(answers)
    with pytest.raises(ValueError, match="there is no answer of the main phase to count"):
        answers.counts()


def test_a_run_that_was_not_answered_yet_is_empty(tmp_path):
    assert read_answers(begun(tmp_path)[1]).rows == ()


def test_to_frame_and_html(tmp_path, monkeypatch):
    answers = read_answers(begun(tmp_path, "match", 3)[1])
    assert "<table>" in answers._repr_html_()
    pytest.importorskip("pandas")
    frame = answers.to_frame()
    assert list(frame.columns) == list(columns_of("abx"))
    assert list(frame["correct"]) == [1, 1, 0]
    assert list(frame["seed_3"]) == [row.seeds[2] for row in answers.rows]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"burrlab\[pandas\]"):
        answers.to_frame()


def test_a_file_of_another_program(tmp_path):
    path = written(tmp_path, HEAD, *ROWS)
    answers = read_answers(path, task="same-different")
    assert (answers.subject, answers.name, answers.side_car) == ("01", "mine", None)
    assert answers.rows[2].response_time is None
    assert answers.trials is None
    assert answers.counts() == Counts(
        "same-different",
        hits=0,
        signals=1,
        false_alarms=0,
        noises=2,
        by_type={"AA": (0, 1), "AB": (0, 1), "BB": (0, 1)},
    )


def test_a_file_of_another_program_in_its_own_words(tmp_path):
    rows = [row.replace("same", "gleich") for row in ROWS]
    path = written(tmp_path, HEAD, *rows, name="x.tsv")
    answers = read_answers(path, task="same-different", answers=("gleich", "verschieden"), subject="7")
    assert [row.response for row in answers.rows] == ["same"] * 3
    assert (answers.subject, answers.name) == ("7", "same-different")


def test_a_spreadsheet_s_marks_do_not_matter(tmp_path):
    path = tmp_path / "sub-01_task-mine_events.tsv"
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join([HEAD, *ROWS]).encode())
    assert len(read_answers(path, task="same-different").rows) == 3


def test_the_subject_of_a_column(tmp_path):
    rows = [f"{row}\tsub-04" for row in ROWS]
    path = written(tmp_path, f"{HEAD}\tparticipant_id", *rows, name="x.tsv")
    assert read_answers(path, task="same-different").subject == "04"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda rows: [HEAD.replace("\tcorrect", "")], "line 1: column correct is missing"),
        (lambda rows: [HEAD + "\tmood"], "line 1: unknown column 'mood'; known are onset, duration"),
        (lambda rows: [HEAD + "\tonset"], "line 1: column onset is there twice"),
        (lambda rows: [HEAD + "\t"], "line 1: a column has no name"),
        (lambda rows: [HEAD.replace("\t", ",")], "line 1: the separator must be a tab, not a comma"),
        (lambda rows: [], "the file is empty"),
        (lambda rows: [HEAD, rows[0], rows[0]], "line 3, column trial: main trial 1 is answered in line 2 already"),
        (lambda rows: [HEAD, *rows, rows[1]], "line 5, column trial: main trial 2 is answered in line 3 already"),
        (lambda rows: [HEAD, rows[0], rows[2]], "line 3, column trial: main trial 2 is due, got 3"),
        (lambda rows: [HEAD, rows[1], rows[0]], "line 2, column trial: main trial 1 is due, got 2"),
        (lambda rows: [HEAD, rows[0].replace("\t1\t0", "\t1\t0", 1)[:-1] + "0"], "line 2, column trial: must be at least 1"),
        (lambda rows: [HEAD, rows[0].replace("same", "alike")], "line 2, column response: must be one of same, different"),
        (lambda rows: [HEAD, rows[0].replace("same", "n/a")], "line 2, column response: must be one of same, different"),
        (lambda rows: [HEAD, rows[0].replace("AA", "XY")], "line 2, column trial_type: must be one of AA, AB, BA, BB"),
        (lambda rows: [HEAD, rows[0].replace("AA", "AB")], "line 2, column correct: after AB the correct answer is 'different'"),
        (lambda rows: [HEAD, rows[0].replace("same\t1", "same\t0")], "line 2, column correct: after AA the correct answer"),
        (lambda rows: [HEAD, rows[0].replace("same\t1", "same\tyes")], "line 2, column correct: must be one of 0, 1, got 'yes'"),
        (lambda rows: [HEAD, "zero" + rows[0][1:]], "line 2, column onset: must be a finite number with a point"),
        (lambda rows: [HEAD, "n/a" + rows[0][1:]], "line 2, column onset: every row needs a number"),
        (lambda rows: [HEAD, "inf" + rows[0][1:]], "line 2, column onset: must be a finite number"),
        (lambda rows: [HEAD, "1_0" + rows[0][1:]], "line 2, column onset: must be a finite number"),
        (lambda rows: [HEAD, rows[0].replace("41", "4,1")], "line 2, column duration: must be a finite number with a point"),
        (lambda rows: [HEAD, rows[0].replace("41", "-41")], "line 2, column duration: must be at least 0"),
        (lambda rows: [HEAD, rows[0].replace("0.5", "-0.5")], "line 2, column response_time: must be at least 0"),
        (lambda rows: [HEAD, rows[0][:-1] + "1.0"], "line 2, column trial: must be a whole number from 0"),
        (lambda rows: [HEAD, rows[0], "-5" + rows[1][2:]], "line 3, column onset: must not be before the last trial's 0.0"),
        (lambda rows: [HEAD, rows[0] + "\t1"], "line 2: 7 fields are due, found 8"),
        (lambda rows: [HEAD, rows[0].replace("same", '"same')], "line 2: not a line of fields between tabs"),
        (lambda rows: [HEAD + "\tlevel", rows[0] + "\t0"], "line 2, column level: must be a ratio above 0"),
        (lambda rows: [HEAD + "\tphase", rows[0] + "\twarm"], "line 2, column phase: must be one of practice, main"),
        (lambda rows: [HEAD + "\tseed_1", rows[0] + f"\t{2**64}"], "line 2, column seed_1: must be a whole number"),
        (lambda rows: [HEAD + "\tended_2", rows[0] + "\tbored"], "line 2, column ended_2: must be one of time, "),
        (lambda rows: [HEAD + "\tended_3", rows[0] + "\ttime"], "line 1: unknown column 'ended_3'"),
        (
            lambda rows: [HEAD + "\tphase", rows[0] + "\tmain", rows[0] + "\tpractice"],
            "line 3, column phase: practice comes before the main phase",
        ),
        (lambda rows: [HEAD + "\tblock", rows[0] + "\t0"], "line 2, column block: must be at least 1 after practice"),
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
    before = path.read_bytes()
    with pytest.raises(ValueError, match=f"events.tsv(, |: ){sentence.replace('(', '[(]')}"):
        read_answers(path, task="same-different")
    assert path.read_bytes() == before


def test_a_correct_flag_of_two_intervals_contradicts_another_row(tmp_path):
    rows = ["0\t9\tRC\tsecond\t1\t1\t1\t1.5", "20\t9\tCR\tfirst\t1\t1\t2\t0.5"]
    path = written(tmp_path, f"{HEAD}\tlevel", *rows)
    with pytest.raises(
        ValueError, match=r"line 3, column correct: the response 'first' .* contradicts line 2"
    ):
        read_answers(path, task="2ifc")
    rows[1] = rows[1].replace("first", "second")
    written(tmp_path, f"{HEAD}\tlevel", *rows)
    assert len(read_answers(path, task="2ifc").rows) == 2


def test_not_text(tmp_path):
    path = tmp_path / "sub-01_task-mine_events.tsv"
    path.write_bytes(HEAD.encode() + b"\n\xff\xfe")
    with pytest.raises(ValueError, match=r"this is not a text file in UTF-8"):
        read_answers(path, task="same-different")
    path.write_bytes(HEAD.encode() + b"\n\0\0")
    with pytest.raises(ValueError, match=r"it holds zero bytes"):
        read_answers(path, task="same-different")


def test_what_nobody_says(tmp_path):
    path = written(tmp_path, HEAD, *ROWS, name="x.tsv")
    with pytest.raises(ValueError, match="what the task is is unknown: give task="):
        read_answers(path)
    with pytest.raises(ValueError, match="task must be one of same-different, abx, 2ifc, got 'odd'"):
        read_answers(path, task="odd")
    with pytest.raises(ValueError, match="the subject is unknown: name the file"):
        read_answers(path, task="same-different")
    with pytest.raises(ValueError, match="answers must be two that differ"):
        read_answers(path, task="same-different", subject="1", answers=("a", "a"))


def test_what_the_file_says_otherwise(tmp_path):
    _, path = begun(tmp_path, count=3)
    with pytest.raises(ValueError, match="task must be 'same-different', as the file says, got 'abx'"):
        read_answers(path, task="abx")
    other = path.with_name("sub-02_task-probing_events.tsv")
    for suffix in (".tsv", ".json"):
        other.with_suffix(suffix).write_bytes(path.with_suffix(suffix).read_bytes())
    with pytest.raises(
        ValueError, match=r"subject is '02' in the file's name and '01' in sub-02_task-probing_events.json"
    ):
        read_answers(other)


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
            "Task and Trials must be 'same-different' and 10, those of the Design, got 'same-different' and 4",
        ),
    ],
)
def test_a_side_car_that_was_changed(tmp_path, change, sentence):
    _, path = begun(tmp_path, count=3)
    file = path.with_suffix(".json")
    car = json.loads(file.read_text())
    change(car)
    file.write_text(json.dumps(car))
    with pytest.raises(ValueError, match=f"events.json: {sentence}"):
        read_answers(path)


def test_a_side_car_that_is_no_json(tmp_path):
    _, path = begun(tmp_path, count=3)
    for text in ("{", "[" * 100_000):
        path.with_suffix(".json").write_text(text)
        with pytest.raises(ValueError, match="this is not JSON in UTF-8"):
            read_answers(path)


def test_read_folder(tmp_path):
    one = protocol(tmp_path)
    for subject in ("02", "01"):
        for task in ("probing", "match"):
            file, order = one.begin(subject, task)
            with file:
                give(file, order, 3)
    found = read_folder(one.folder)
    assert [(a.name, a.subject) for a in found] == [
        ("match", "01"),
        ("match", "02"),
        ("probing", "01"),
        ("probing", "02"),
    ]


def test_a_subject_with_two_files_for_one_task(tmp_path):
    one, path = begun(tmp_path, count=3)
    for suffix in (".tsv", ".json"):
        path.with_name(f"sub-01_task-probing_run-2_events{suffix}").write_bytes(
            path.with_suffix(suffix).read_bytes()
        )
    with pytest.raises(
        ValueError, match=r"subject 01 has another file for task probing, .*sub-01_task-probing_events.tsv"
    ):
        read_folder(one.folder)


def test_a_folder_of_another_subject(tmp_path):
    one, path = begun(tmp_path, count=3)
    path.parents[1].rename(one.folder / "sub-02")
    with pytest.raises(ValueError, match="the answers are of subject 01, the folder is sub-02"):
        read_folder(one.folder)


def test_a_folder_without_answers(tmp_path):
    with pytest.raises(ValueError, match="there is no file of answers"):
        read_folder(tmp_path)


def test_a_simulated_subject_among_others(tmp_path):
    one, path = begun(tmp_path, count=3)
    beh = one.folder / "sub-02" / "beh"
    beh.mkdir(parents=True)
    car = json.loads(path.with_suffix(".json").read_text())
    car |= {"Subject": "02", "Simulated": True, "SimulatedSubject": {"weber": 0.1}}
    (beh / "sub-02_task-probing_events.json").write_text(json.dumps(car))
    (beh / "sub-02_task-probing_events.tsv").write_bytes(path.read_bytes())
    assert read_answers(beh / "sub-02_task-probing_events.tsv").simulated
    with pytest.raises(ValueError, match=r"a simulated subject is among others: .*sub-02"):
        read_folder(one.folder)


def test_a_task_that_was_not_the_same_for_all(tmp_path):
    one, _ = begun(tmp_path, count=3)
    text = one.path.read_text().replace("trials = 8", "trials = 4")
    begun(tmp_path, count=3, subject="02", text=text)
    with pytest.raises(
        ValueError, match=r"was another one in .*sub-01.*: tasks.probing.trials was 8, is now 4"
    ):
        read_folder(one.folder)


def test_a_run_replayed(tmp_path):
    one, path = begun(tmp_path, "up", 5)
    answers = read_answers(path)
    order = one.order("01", "up")
    replay("x", list(enumerate(answers.rows, start=2)), order)
    assert len(order.answered) == 5
    with pytest.raises(
        ValueError, match=r"x, line 2, column (trial_type|seed_1): .* made with another seed or protocol"
    ):
        replay("x", list(enumerate(answers.rows, start=2)), one.order("02", "up"))


def test_more_answers_than_trials(tmp_path):
    one, path = begun(tmp_path, "match", 4)
    rows = read_answers(path).rows
    order = one.order("01", "match")
    replay("x", list(enumerate(rows, start=2)), order)
    assert order.next() is None
    with pytest.raises(ValueError, match="x, line 6: the run has no trial left that this could answer"):
        replay("x", [*enumerate(rows, start=2), (6, rows[-1])], one.order("01", "match"))


NUMBER = st.floats(0, 1e6, allow_nan=False).map(lambda value: round(value, 6))


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_rows_survive_the_file(data):
    task = data.draw(st.sampled_from(["same-different", "abx", "2ifc"]))
    places = 3 if task == "abx" else 2
    count = data.draw(st.integers(1, 6))
    onsets = sorted(data.draw(st.lists(NUMBER, min_size=count, max_size=count)))
    rows = []
    for place in range(count):
        if task == "same-different":
            kind = data.draw(st.sampled_from(["AA", "AB", "BA", "BB"]))
            correct = "same" if kind[0] == kind[1] else "different"
        else:
            kind = data.draw(st.sampled_from(["AB", "BA"] if task == "abx" else ["RC", "CR"]))
            correct = "first" if kind in ("AB", "CR") else "second"
        other = {"same": "different", "different": "same", "first": "second", "second": "first"}[correct]
        right = data.draw(st.booleans())
        rows.append(
            Row(
                onset=onsets[place],
                duration=data.draw(st.none() | NUMBER),
                trial_type=kind,
                response=correct if right else other,
                correct=right,
                response_time=data.draw(st.none() | NUMBER),
                trial=place + 1,
                level=data.draw(st.none() | st.floats(1.0, 100.0, exclude_min=True))
                if task == "2ifc"
                else None,
                stimuli=tuple(data.draw(st.sampled_from(["bone", "bone c_e x1.1"])) for _ in range(places)),
                seeds=tuple(data.draw(st.none() | st.integers(0, 2**64 - 1)) for _ in range(places)),
                endings=tuple(data.draw(st.sampled_from(["time", "wall"])) for _ in range(places)),
            )
        )
    head = ("\t".join(columns_of(task)) + "\n").encode()
    text = b"".join(as_text(row, task) for row in rows)
    assert [row for _, row in read_rows("x", head + text, task)] == rows


@settings(max_examples=300, deadline=None)
@given(content=st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_any_bytes_are_read_or_named(content):
    try:
        read_rows("x", content, "same-different")
    except ValueError as error:
        assert str(error).startswith("x")  # noqa: PT017  (both outcomes are right)


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_any_field_is_read_or_named(data):
    columns = columns_of("abx")
    row = Row(
        0.0, 1.0, "AB", "first", True, 1.0, 1, stimuli=("a", "b", "c"), seeds=(1, 2, 3), endings=("time",) * 3
    )
    good = dict(zip(columns, as_text(row, "abx").decode().split("\t"), strict=True))
    good["ended_3"] = "time"
    column = data.draw(st.sampled_from(columns))
    text = data.draw(st.text(max_size=8))
    try:
        RowReader("abx").parse(good | {column: text})
    except ValueError as error:
        assert str(error).startswith("column ")  # noqa: PT017


@pytest.mark.parametrize(
    ("task", "one", "other", "sentence"),
    [
        ("probing", "AB", "BA", "column stimulus_1: BA has 'pvc' there, got 'bone'"),
        ("match", "AB", "BA", "column stimulus_2: BA has 'pvc' there, got 'bone'"),
    ],
)
def test_a_type_that_contradicts_the_stimuli(tmp_path, task, one, other, sentence):
    """The answers are right or wrong as before, and the pairs would be counted as others."""
    _, path = begun(tmp_path, task, count=4)
    text = path.read_text()
    line = next(n for n, row in enumerate(text.splitlines(), start=1) if f"\t{one}\t" in row)
    rows = text.splitlines()
    rows[line - 1] = rows[line - 1].replace(f"\t{one}\t", f"\t{other}\t")
    if task == "match":
        rows[line - 1] = rows[line - 1].replace("\tfirst\t", "\tX\t").replace("\tsecond\t", "\tfirst\t")
        rows[line - 1] = rows[line - 1].replace("\tX\t", "\tsecond\t")
    path.write_text("\n".join(rows) + "\n")
    with pytest.raises(ValueError, match=f"line {line}, {sentence}"):
        read_answers(path)


@pytest.mark.parametrize("answers", [5, [1, 2], ["same", "same", "different"], "ab", ["a", "a"]])
def test_answers_that_are_not_two_texts(tmp_path, answers):
    path = written(tmp_path, HEAD, *ROWS)
    with pytest.raises(ValueError, match="answers must be two that differ, in the order of their keys"):
        read_answers(path, task="same-different", answers=answers)


def test_the_folder_is_as_bids_has_it(tmp_path):
    one, path = begun(tmp_path, count=3)
    assert path == one.folder / "sub-01" / "beh" / "sub-01_task-probing_events.tsv"
    described = json.loads((one.folder / "dataset_description.json").read_text())
    assert (described["Name"], described["BIDSVersion"], described["DatasetType"]) == (
        "test",
        "1.10.0",
        "raw",
    )
    assert (
        one.folder / "participants.tsv"
    ).read_text() == "participant_id\tsimulated\tselected_by\nsub-01\tno\tn/a\n"
    assert set(json.loads((one.folder / "participants.json").read_text())) == {
        "participant_id",
        "simulated",
        "selected_by",
    }
    head, *rows = path.read_text().splitlines()
    assert head.split("\t")[:2] == ["onset", "duration"]
    assert len(rows) == 3
    car = json.loads(path.with_suffix(".json").read_text())
    for column in columns_of("same-different"):
        assert column in head.split("\t")
        assert car[column]["Description"]
    assert set(car["trial_type"]["Levels"]) == {"AA", "AB", "BA", "BB"}
    assert car["onset"]["Units"] == car["duration"]["Units"] == car["response_time"]["Units"] == "s"
    assert car["Task"] == "same-different"
    assert car["StimulusPresentation"]["SoftwareName"] == "burrlab"
    assert car["ProtocolDigest"] == one.digest
    assert one.data.log("01", "probing").parent == one.data.trace("01", "probing", "main", 1, 2).parent
    assert (
        one.data.trace("01", "probing", "main", 1, 2).name
        == "sub-01_task-probing_main-001_interval-2_trace.h5"
    )


def test_what_is_there_is_not_replaced(tmp_path):
    one = protocol(tmp_path)
    one.folder.mkdir()
    mine = one.folder / "dataset_description.json"
    mine.write_text("{}")
    begun(tmp_path, count=1)
    begun(tmp_path, count=1, subject="02")
    begun(tmp_path, "match", count=1, subject="02")
    assert mine.read_text() == "{}"
    assert list(one.data.participants()) == ["01", "02"]


def test_a_line_of_participants_broken_off_is_written_again(tmp_path):
    one, _ = begun(tmp_path)
    path = one.folder / "participants.tsv"
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        one.data.add("01", simulated=False)
        assert path.read_bytes() == whole


def test_selected_subjects_are_entered_as_such(tmp_path):
    folder = ExperimentFolder(tmp_path / "data", "x")
    assert folder.participants() == {}
    folder.add("01", simulated=False, selected_by="best 12 of 20")
    assert folder.participants()["01"]["selected_by"] == "best 12 of 20"


def test_simulated_subjects_and_people_do_not_mix(tmp_path):
    one, _ = begun(tmp_path)
    before = (one.folder / "participants.tsv").read_bytes()
    with pytest.raises(
        ValueError, match="simulated subjects and people do not go into one folder: sub-01 has simulated no"
    ):
        one.begin("02", "probing", simulated={"weber": 0.1})
    assert (one.folder / "participants.tsv").read_bytes() == before
    assert not (one.folder / "sub-02").exists()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("participant_id\nsub-01\n", "line 1: column simulated is missing"),
        ("participant_id\tsimulated\nsub-01\tno\nsub-01\tno\n", "line 3: subject 01 is there twice"),
        (
            "participant_id\tsimulated\nsub-01\tmaybe\n",
            "line 2, column simulated: must be yes or no, got 'maybe'",
        ),
    ],
)
def test_participants_that_are_not_right(tmp_path, text, sentence):
    (tmp_path / "participants.tsv").write_text(text)
    with pytest.raises(ValueError, match=sentence):
        ExperimentFolder(tmp_path, "x").participants()


def test_a_name_that_would_break_the_file(tmp_path):
    with pytest.raises(
        ValueError, match="a field must be a text without tabs, line breaks and quotation marks"
    ):
        ExperimentFolder(tmp_path, "x").add("01", simulated=False, selected_by="best\tof all")


@pytest.mark.parametrize("end", ["", "\n", "\r\n"])
def test_a_laboratory_s_own_columns_stay_and_rows_keep_to_them(tmp_path, end):
    path = tmp_path / "participants.tsv"
    path.write_bytes(
        f"participant_id\tage\tselected_by\tsimulated\nsub-07\t33\tbest 12 of 20\tno{end}".encode()
    )
    folder = ExperimentFolder(tmp_path, "x")
    folder.add("02", simulated=False, selected_by="chance")
    folder.add("03", simulated=False)
    assert path.read_bytes().endswith(b"\nsub-02\tn/a\tchance\tno\nsub-03\tn/a\tn/a\tno\n")
    assert folder.participants()["07"]["age"] == "33"
    assert list(folder.participants()) == ["07", "02", "03"]


def test_columns_of_participants_without_their_line_s_end(tmp_path):
    path = tmp_path / "participants.tsv"
    path.write_text("participant_id\tsimulated\tage")
    ExperimentFolder(tmp_path, "x").add("01", simulated=False)
    assert path.read_text() == "participant_id\tsimulated\tage\nsub-01\tno\tn/a\n"


def test_a_full_disk_is_named_and_leaves_no_part(tmp_path):
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    folder = ExperimentFolder(tmp_path, "x")
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, before[1]))
        with pytest.raises(OSError, match=r"File too large: .*dataset_description\.json"):
            folder.add("01", simulated=False)
        assert not list(tmp_path.iterdir())
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        folder.prepare()
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, before[1]))
        with pytest.raises(OSError, match=r"participants\.tsv"):
            folder.add("01", simulated=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    folder.add("01", simulated=False)
    assert list(folder.participants()) == ["01"]
