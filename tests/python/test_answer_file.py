"""Files of answers are written before the next trial, never overwritten, and resumed after any end."""

import contextlib
import errno
import json
import os
from dataclasses import replace
from unittest.mock import Mock

import pytest
from answer_scenes import SMALL, answer, begun, give, protocol, sat, trials_of
from session_scenes import refused

from burrlab.psychophysics import AnswerFile, Sitting, read_answers
from burrlab.psychophysics.interval import ENDINGS
from burrlab.psychophysics.side_car import digest


@pytest.mark.parametrize(("task", "count"), [("probing", 0), ("match", 1), ("up", 4), ("match", 4)])
def test_a_run_goes_on_at_its_next_trial(tmp_path, task, count):
    one, path = begun(tmp_path, task, count)
    before, over = path.read_bytes(), (task, count) == ("match", 4)
    undisturbed = trials_of(one, task, count + (not over))
    with sat(one.resume("01", task)) as (file, order):
        assert (len(order.answered), file.notes) == (count, ())
        assert order.next() == (None if over else undisturbed[-1])
        give(file, order, not over)
    assert path.read_bytes().startswith(before)
    assert [row.trial_type for row in read_answers(path).rows] == [trial.trial_type for trial in undisturbed]


def test_nothing_is_overwritten(tmp_path):
    one, path = begun(tmp_path, count=3)
    before, car = path.read_bytes(), path.with_suffix(".json").read_bytes()
    refused((lambda: one.begin("01", "probing"), r"path must be a new file, .*json exists", FileExistsError))
    assert path.read_bytes() == before
    path.unlink()
    refused(
        (
            lambda: one.begin("01", "probing"),
            r"path must be a new file, .*events.json exists",
            FileExistsError,
        )
    )
    assert (path.with_suffix(".json").read_bytes(), path.exists()) == (car, False)


@pytest.mark.parametrize(
    ("kind", "ask", "sentence"),
    [
        (OSError, lambda one, at: AnswerFile.create(at / "file" / "beh" / "x.tsv", one.side_car("01", "probing")), "file"),
        (OSError, lambda one, at: AnswerFile.open(at / "file" / "x.tsv", one.order("01", "up"), one.side_car("01", "up")), "file"),
        (ValueError, lambda one, at: AnswerFile.create(at / "a.csv", one.side_car("01", "up")), r"path must end in .tsv, got .*a.csv"),
        (FileNotFoundError, lambda one, at: one.resume("01", "up"), "there is no such run to resume"),
    ],
)  # fmt: skip
def test_paths_that_are_refused(tmp_path, kind, ask, sentence):
    one = protocol(tmp_path)
    (tmp_path / "file").write_text("")
    refused((lambda: ask(one, tmp_path), sentence), error=kind)


def test_a_last_line_broken_off_at_any_byte_is_cut_and_asked_again(tmp_path):
    one, path = begun(tmp_path, "match", 3)
    whole = path.read_bytes()
    kept, due = whole[: whole[:-1].rfind(b"\n") + 1], trials_of(one, "match", 3)[-1]
    for length in range(len(kept) + 1, len(whole) - 1):
        path.write_bytes(whole[:length])
        answers = read_answers(path)
        assert len(answers.rows) == 2
        assert "was broken off and is left out" in answers.notes[0]
        assert "was broken off" in repr(answers)
        with sat(one.resume("01", "match")) as (file, order):
            assert f"broken off after {length - len(kept)} bytes and is cut" in file.notes[0]
            assert (order.next(), path.read_bytes()) == (due, kept)
    path.write_bytes(kept + b"\0\0\0\xff")  # as after a power cut on some file systems
    assert len(read_answers(path).rows) == 2
    one.resume("01", "match")[0].close()
    assert path.read_bytes() == kept


@pytest.mark.parametrize("task", ["probing", "up"])
def test_a_last_line_that_lacks_its_end_alone_is_an_answer(tmp_path, task):
    one, path = begun(tmp_path, task, 3)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    answers = read_answers(path)
    assert (len(answers.rows), answers.notes) == (3, ())
    with sat(one.resume("01", task)) as (file, order):
        assert (file.notes, path.read_bytes()) == ((), whole)
        give(file, order, 1)
    assert path.read_bytes().startswith(whole)
    assert len(read_answers(path).rows) == 4


def test_no_ending_begins_another():
    """No ending is a prefix of another, so a line without its end can be known to be complete."""
    assert not any(one != other and other.startswith(one) for one in ENDINGS for other in ENDINGS)


def test_a_start_broken_off_at_any_byte_begins_again(tmp_path):
    one, path = begun(tmp_path)
    head, due = path.read_bytes(), trials_of(one, "probing", 1)[0]
    for length in (*range(0, len(head), 3), len(head)):
        path.write_bytes(head[:length])
        path.with_suffix(".json").unlink()
        refused((lambda: one.begin("01", "probing"), "resume the run", FileExistsError))
        with sat(one.resume("01", "probing")) as (file, order):
            assert (path.read_bytes(), read_answers(path).side_car) == (head, file.side_car)
            assert order.next() == due


def test_one_at_a_time_until_it_closes(tmp_path):
    one = protocol(tmp_path)
    file, order = one.begin("01", "probing")
    give(file, order, 1)
    refused(
        (lambda: one.resume("01", "probing"), r"events.tsv: another process has this run open"),
        error=BlockingIOError,
    )
    assert len(read_answers(file.path).rows) == 1
    file.close()
    file.close()
    assert "closed" in repr(file)
    one.resume("01", "probing")[0].close()


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    full = Mock(side_effect=OSError(errno.ENOSPC, "No space left on device"))
    file, order = protocol(tmp_path).begin("01", "probing")
    write = os.write
    with file:
        give(file, order, 2)
        before = file.path.read_bytes()
        for name, wrong, sentence in (
            (
                "write",
                lambda target, text: write(target, text[:20]),
                r"took 20 of \d+ bytes: is the disk full",
            ),
            ("fsync", full, "No space left"),
        ):
            with monkeypatch.context() as patch:
                patch.setattr(os, name, wrong)
                refused((lambda: give(file, order, 1), sentence), error=OSError)
            assert file.path.read_bytes() == before
        give(file, order, 1)
    assert len(read_answers(file.path).rows) == 3


def test_what_could_not_be_read_back_is_not_written(tmp_path):
    file, order = protocol(tmp_path).begin("01", "probing")
    trial = order.next()
    with file:
        refused(
            (lambda: file.append(answer(trial, "first", 0.0)),
             "answer: column response: must be one of same, different, got 'first'"),
            (lambda: file.append(answer(trial, "same", -1.0, -1.0)),
             "answer: column response_time: must be at least 0"),
            (lambda: file.append(answer(trial, "same", float("nan"))), "a number must be finite, got nan"),
        )  # fmt: skip
        give(file, order, 1)
        twice = "answer: column trial: practice trial 1 is answered in line 2 already"
        refused((lambda: file.append(answer(trial, "same", 100.0)), twice))
    assert len(read_answers(file.path).rows) == 1
    refused((lambda: file.append(answer(order.next(), "same", 200.0)), r"events.tsv is closed"))


_ABROAD = 'seed = 7\ndevice = "igtl:x:1"\npublish = 18945'


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("seed = 7", "seed = 8", "experiment.seed was 7, is now 8"),
        ("trials = 8", "trials = 12", "tasks.probing.trials was 8, is now 12"),
        (
            'b = "pvc"\ntrials = 8', 'b = "pettigrew"\ntrials = 8',
            "tasks.probing.b.name was 'pvc', is now 'pettigrew'",
        ),
        ("radius_mm = 3", "radius_mm = 2.5", "burr.radius_mm was 3.0, is now 2.5"),
        ("[12, 12, 6]", "[12, 12, 8]", r"bone.size_mm was \[12.0, 12.0, 6.0\], is now \[12.0, 12.0, 8.0\]"),
        ("seed = 7", "seed = 7\nfeedback = true", "experiment.feedback was False, is now True"),
        ("seed = 7", 'seed = 7\nkeys = "fj"', "experiment.keys was '12', is now 'fj'"),
        ("seed = 7", 'seed = 7\ndevice = "igtl:x:1"', "device was 'hand', is now 'igtl'"),
        ("seed = 7", "seed = 7\npublish = 18945", "force is published was False, is now True"),
        # changes that do not concern the run
        ("subjects = 3", "subjects = 30", None),
        ("seed = 7", "seed = 7\ntrace = true\nlost_after_ms = 200", None),
        ("trials = 4", "trials = 6", None),
        ("[burr]", "[analysis]\ndelta = 1\n[burr]", None),
    ],
)  # fmt: skip
def test_a_protocol_that_was_changed_is_refused_with_what_matters(tmp_path, old, new, sentence):
    _, path = begun(tmp_path, count=3)
    before, changed = path.read_bytes(), protocol(tmp_path, SMALL.replace(old, new))
    told = f"the protocol was changed since the run began: {sentence}"
    with pytest.raises(ValueError, match=told) if sentence else contextlib.nullcontext():
        changed.resume("01", "probing")[0].close()
    assert path.read_bytes() == before


def test_a_run_of_a_version_without_keys_goes_on(tmp_path):
    one, path = begun(tmp_path, count=3)
    car = json.loads(path.with_suffix(".json").read_text())
    del car["Protocol"]["experiment"]["keys"]
    car["ProtocolDigest"] = digest(car["Protocol"])
    path.with_suffix(".json").write_text(json.dumps(car))
    one.resume("01", "probing")[0].close()


def test_a_run_goes_on_at_another_port_and_address(tmp_path):
    begun(tmp_path, text=SMALL.replace("seed = 7", _ABROAD))
    elsewhere = _ABROAD.replace("x:1", "y:2").replace("18945", "18946")
    protocol(tmp_path, SMALL.replace("seed = 7", elsewhere)).resume("01", "probing")[0].close()


def _each_line(change):
    """A function that changes the fields of each line of a file by `change(number from 0, fields)`."""

    def changed(path):
        lines = enumerate(path.read_text().splitlines())
        path.write_text("".join("\t".join(change(number, line.split("\t"))) + "\n" for number, line in lines))

    return changed


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (
            lambda path: path.with_suffix(".json").unlink(),
            r"this is no run of this program, its side-car .*json is missing",
        ),
        # a row changed by hand
        (
            _each_line(lambda number, fields: [*fields[:12], "5", *fields[13:]] if number == 2 else fields),
            r"line 3, column seed_1: 5 where practice trial 2 has \d{6,}: made with",
        ),
        # Rows are appended by position: with other columns they would be other answers.
        (
            _each_line(lambda number, fields: [*fields[1:], fields[0]]),
            "line 1: .* column 1 was 'onset', is now 'duration'",
        ),
        (_each_line(lambda number, fields: fields[:-5]), "line 1: .* column 15 was 'ended_1', is now none"),
        (
            _each_line(lambda number, fields: [*fields, "sub-01" if number else "participant_id"]),
            "line 1: .* column 20 was none, is now 'participant_id'",
        ),
    ],
)
def test_files_that_are_not_gone_on_with(tmp_path, damage, sentence):
    one, path = begun(tmp_path, count=3)
    damage(path)
    before = path.read_bytes()
    refused((lambda: one.resume("01", "probing"), sentence))
    assert path.read_bytes() == before


def test_onsets_go_on_across_a_resumption_and_never_back(tmp_path):
    one, path = begun(tmp_path, count=3)
    # The last answer ended at 120 + 41.5 + 0.75 s, later than the wall clock says.
    with one.resume("01", "probing")[0] as file:
        assert file.end == 162.25
        assert 162.25 <= file.elapsed() < 172.25
    text = path.with_suffix(".json").read_text()
    path.with_suffix(".json").write_text(
        text.replace(json.loads(text)["Started"], "2020-01-01T00:00:00+00:00")
    )
    with one.resume("01", "probing")[0] as file:
        assert file.elapsed() > 1e8


def test_a_simulated_subject_needs_no_response_time_and_goes_on_as_itself(tmp_path):
    one = protocol(tmp_path)
    with sat(one.begin("01", "match", simulated={"weber": 0.1})) as (file, order):
        file.append(answer(order.next(), "first", 0.0, None))
    answers = read_answers(file.path)
    assert (answers.simulated, answers.side_car.simulated) == (True, {"weber": 0.1})
    assert answers.rows[0].response_time is None
    assert "a simulated subject 01" in repr(answers)
    refused((lambda: one.resume("01", "match"), r"simulated subject was \{'weber': 0.1\}, is now None"))


NO_LIMITS = (
    "a version without force limits began this run; now those of a Touch, an Omega or a Haply hold, and no column "
    "tells what they clip"
)


@pytest.mark.parametrize(
    ("device", "columns", "repeats"), [("hand", 16, [None] * 4), ("touch", 16, [None] * 4), ("touch", 17, [0, 0, 0, 1])]
)  # fmt: skip
def test_a_run_of_an_earlier_version_goes_on_with_its_columns(tmp_path, device, columns, repeats):
    """Without repeats, or what limits clipped."""
    one, path = begun(tmp_path, count=3, text=SMALL.replace("seed = 7", f'seed = 7\ndevice = "{device}"'))
    rows = [line.split("\t") for line in path.read_text().splitlines()]
    assert len(rows[0]) == (19 if device == "hand" else 21)
    with one.resume("01", "probing")[0] as file:
        assert file.notes == ()
    path.write_text("".join("\t".join([*row[:16], row[-1]][:columns]) + "\n" for row in rows))
    with sat(one.resume("01", "probing")) as (file, order):
        assert [note.partition(": ")[2] for note in file.notes] == [NO_LIMITS] * (device == "touch")
        file.append(replace(answer(order.next(), "same", 1e3), repeats=1))
    assert [row.repeats for row in read_answers(path).rows] == repeats
    assert {line.count("\t") for line in path.read_text().splitlines()} == {columns - 1}


def test_what_was_begun_comes_first_when_the_order_of_tasks_has_moved(tmp_path):
    one, _ = begun(tmp_path, "up", count=2, subject="02")
    other = protocol(tmp_path, SMALL.replace("subjects = 3", 'subjects = ["02", "01"]'))
    assert other.tasks_of("02")[0] != "up"
    assert Sitting(other, "02").tasks == ("up", *(task for task in other.tasks_of("02") if task != "up"))
    assert Sitting(one, "01").tasks == one.tasks_of("01")
