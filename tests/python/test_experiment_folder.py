"""The folder of an experiment."""

from __future__ import annotations

import json
import signal

import pytest
from answer_scenes import begun, protocol

from burrlab.psychophysics.answers import ExperimentFolder
from burrlab.psychophysics.side_car import columns_of


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
