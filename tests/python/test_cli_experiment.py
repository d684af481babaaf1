"""burrlab experiment, where no terminal is needed."""

from __future__ import annotations

import json
import os
import pty
import threading

import matplotlib.pyplot
import pytest

import burrlab.cli.experiment as cli_experiment
from burrlab.cli import main
from burrlab.psychophysics.answers import read_folder
from burrlab.psychophysics.protocol import Protocol
from burrlab.psychophysics.seat import Experimenter

CONFIG = """
[experiment]
name = "Rehearsal"
seed = 3
subjects = 3
pause_s = 0.0
break_s = 0.0
[burr]
radius_mm = 3.0
[bone]
size_mm = [16.0, 16.0, 8.0]
voxel_mm = 0.5
[materials.specimen]
real = true
[tasks.probing]
design = "same-different"
a = "bone"
b = "pvc"
trials = 4
interval_s = 2.5
[tasks.match]
design = "abx"
reference = "specimen"
match = "pettigrew"
foil = "pvc"
mode = "drilling"
trials = 2
interval_s = 1.0
"""


@pytest.fixture
def config(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "test.toml"
    path.write_text(CONFIG)
    return path


def said(capsys):
    out, err = capsys.readouterr()
    return out, err.replace("\r", "")


def wrong(arguments, capsys):
    assert main(["experiment", *arguments]) == 2
    _, err = said(capsys)
    assert err.count("\n") == 1
    assert err.startswith("burrlab experiment: ")
    return err


def test_new_writes_once_and_prints_the_power(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["experiment", "new", "mine.toml"]) == 0
    out, _ = said(capsys)
    assert "mine.toml is written" in out
    assert "experiment run mine.toml --simulated --all --fast\n" in out
    protocol = Protocol.read("mine.toml")
    for task in protocol.tasks:
        assert f"task {task}\n" in out
    before = (tmp_path / "mine.toml").read_bytes()
    assert "mine.toml exists and is not replaced" in wrong(["new", "mine.toml"], capsys)
    assert (tmp_path / "mine.toml").read_bytes() == before
    assert main(["experiment", "power", "mine.toml"]) == 0
    assert said(capsys)[0].strip() == out[out.index("task ") :].strip()


def test_simulated_subjects_from_run_to_analysis(config, capsys, monkeypatch):
    shown = []
    monkeypatch.setattr(cli_experiment, "show_line", shown.append)
    assert main(["experiment", "run", "test.toml", "--simulated", "--all", "--fast", "--weber", "0.2"]) == 0
    out, _ = said(capsys)
    assert out == "".join(f"simulated subject 0{n}: 6 trials answered\n" for n in (1, 2, 3))
    protocol = Protocol.read(config)
    every = read_folder(protocol.folder)
    assert [(one.subject, one.name) for one in every] == [
        (subject, task) for task in ("match", "probing") for subject in ("01", "02", "03")
    ]
    assert all(one.simulated for one in every)
    assert {p["simulated"] for p in protocol.data.participants().values()} == {"yes"}
    assert every[0].side_car.simulated["rendered"] == "each material once a task"
    assert every[0].side_car.simulated["drilling"]["weber"] == {"sinking": 0.2}
    assert [row.stimuli[0] for row in every[0].rows] == ["specimen"] * 2
    assert [row.response_time for row in every[0].rows] == [None] * 2
    # The analysis says that nobody took part.
    arguments = ["--json", "a.json", "--tsv", "a.tsv", "--plot", "figures"]
    assert main(["experiment", "analyse", "test.toml", *arguments]) == 0
    for part in (
        "simulated subject 02, task match: trial 2 of 2, block 1",
        "task probing, subject 03",
        "figure d_prime of task match",
    ):
        assert part in shown
    assert shown[-1] == ""
    assert not matplotlib.pyplot.get_fignums()
    out, _ = said(capsys)
    assert "SIMULATED SUBJECTS" in out
    assert out.endswith("6 figures are in figures: task-NAME_FIGURE.png\n")
    assert json.loads((config.parent / "a.json").read_text())["name"] == "Rehearsal"
    assert len((config.parent / "a.tsv").read_text().splitlines()) == 7
    assert {path.name for path in (config.parent / "figures").iterdir()} == {
        f"task-{task}_{figure}.png"
        for task in ("probing", "match")
        for figure in ("scores", "intervals", "d_prime")
    }


def test_simulated_run_is_a_function_of_its_seed(config, capsys):
    protocol = Protocol.read(config)
    run = ["test.toml", "--simulated", "--subject", "02"]
    assert main(["experiment", "run", *run]) == 0
    first = protocol.data.answers("02", "probing").read_bytes()
    protocol.folder.rename(config.parent / "kept")
    # As if killed after the second trial, and with the second task not begun.
    assert main(["experiment", "run", *run]) == 0
    path = protocol.data.answers("02", "probing")
    path.write_bytes(b"".join(first.splitlines(keepends=True)[:3]))
    for file in path.parent.glob("*match*"):
        file.unlink()
    assert main(["experiment", "resume", *run]) == 0
    assert path.read_bytes() == first
    match = protocol.data.answers("02", "match")
    assert match.read_bytes() == (config.parent / "kept" / match.relative_to(protocol.folder)).read_bytes()
    assert "simulated subject 02: 4 trials answered" in said(capsys)[0]


def test_begun_or_not(config, capsys):
    run = ["test.toml", "--simulated", "--subject", "01", "--task", "match"]
    message = wrong(["resume", *run], capsys)
    assert (
        "subject 01 has begun no task: burrlab experiment run test.toml --subject 01 --task match --simulated"
        in message
    )
    assert main(["experiment", "run", *run]) == 0
    said(capsys)
    assert "subject 01 has begun task match: burrlab experiment resume test.toml" in wrong(
        ["run", *run], capsys
    )
    assert main(["experiment", "resume", *run]) == 0
    assert said(capsys)[0] == "simulated subject 01: 0 trials answered\n"


def test_changed_protocol_is_named(config, capsys):
    run = ["test.toml", "--simulated", "--subject", "01", "--task", "match"]
    assert main(["experiment", "run", *run]) == 0
    config.write_text(CONFIG.replace("seed = 3", "seed = 4"))
    said(capsys)
    assert "the protocol was changed since the run began: experiment.seed was 3, is now 4" in wrong(
        ["resume", *run], capsys
    )
    config.write_text(CONFIG)
    assert "simulated subject.drilling.weber.sinking was 0.45, is now 0.3" in wrong(
        ["resume", *run, "--weber", "0.3"], capsys
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "none.toml", "--subject", "01"], "none.toml"),
        (["run", "test.toml", "--subject", "09"], "there is no subject '09'; there are 01, 02, 03"),
        (["run", "test.toml", "--subject", "01", "--task", "x"], "there is no task 'x'; there are probing, match"),
        (["run", "test.toml"], "--subject LABEL or --simulated --all must say who takes part"),
        (["run", "test.toml", "--subject", "01", "--all", "--simulated"], "--subject LABEL or --simulated --all"),
        (["run", "test.toml", "--all"], "--all goes with --simulated"),
        (["run", "test.toml", "--subject", "01", "--fast"], "--fast goes with --simulated"),
        (["run", "test.toml", "--subject", "01", "--weber", "1"], "--weber goes with --simulated"),
        (["run", "test.toml", "--subject", "01", "--device", "mouse"], "device must be hand, scripted:FILE or igtl:"),
        (["run", "test.toml", "--subject", "01", "--device", "scripted:none.csv"], "none.csv"),
        (["run", "test.toml", "--subject", "01", "--simulated", "--device", "hand"], "--device does not go with"),
        (["analyse", "test.toml"], "there is no file of answers"),
        (["analyse", "test.toml", "--plot", "test.toml"], "--plot: test.toml is no folder"),
        (["analyse", "test.toml", "--json", "/nowhere/a.json"], "--json: /nowhere/a.json cannot be written"),
        (["new", "/nowhere/a.toml"], "/nowhere/a.toml"),
    ],
)  # fmt: skip
def test_wrong_input(config, capsys, arguments, message):
    assert message in wrong(arguments, capsys)
    assert not (config.parent / "data").exists()


def test_unknown_action(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["experiment", "dance"])
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_lost_device_ends_with_1(config, capsys, monkeypatch):
    """A simulated subject whose hand is lost in the third interval."""
    import itertools

    import burrlab.psychophysics.run as sitting
    from burrlab.psychophysics.interval import render

    count = itertools.count(1)

    def lost(interval, device, **options):
        from dataclasses import replace

        seen = render(interval, device, **options)
        return replace(seen, failed=True, reason="device 0 was lost") if next(count) == 3 else seen

    monkeypatch.setattr(sitting, "render", lost)
    run = ["test.toml", "--simulated", "--subject", "01", "--task", "probing"]
    assert main(["experiment", "run", *run]) == 1
    _, err = said(capsys)
    assert "the device was lost during an interval: device 0 was lost; burrlab experiment resume" in err
    protocol = Protocol.read(config)
    assert len(read_folder(protocol.folder)[0].rows) == 1
    assert "trial 2 was not asked" in protocol.data.log("01", "probing").read_text()
    assert main(["experiment", "resume", *run]) == 0
    assert len(read_folder(protocol.folder)[0].rows) == 4


def test_interrupted_ends_with_130(config, capsys, monkeypatch):
    from burrlab.psychophysics.rehearsal import SimulatedSeat

    def interrupted(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(SimulatedSeat, "ask", interrupted)
    assert main(["experiment", "run", "test.toml", "--simulated", "--subject", "01"]) == 130
    assert (
        "every answer is kept, burrlab experiment resume test.toml --subject 01 --simulated goes on"
        in said(capsys)[1]
    )


def test_traces_of_attempts(config, capsys):
    config.write_text(CONFIG.replace("seed = 3", "seed = 3\ntrace = true"))
    run = ["test.toml", "--simulated", "--subject", "01", "--task", "match"]
    assert main(["experiment", "run", *run]) == 0
    protocol = Protocol.read(config)
    folder = protocol.data.log("01", "match").parent
    names = {f"sub-01_task-match_main-00{t}_interval-{i}_trace.h5" for t in (1, 2) for i in (1, 2, 3)}
    assert {path.name for path in folder.glob("*.h5")} == names
    path = protocol.data.answers("01", "match")
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:2]))
    assert main(["experiment", "resume", *run]) == 0
    again = {f"sub-01_task-match_main-002_interval-{i}_attempt-2_trace.h5" for i in (1, 2, 3)}
    assert {path.name for path in folder.glob("*.h5")} == names | again


def test_experimenter_sees_it_in_a_fifo(tmp_path):
    fifo, got = tmp_path / "fifo", []
    os.mkfifo(fifo)
    with pytest.raises(ValueError, match="the experimenter's view is a fifo that nobody reads"):
        Experimenter(tmp_path / "log.txt", fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    with Experimenter(tmp_path / "log.txt", fifo) as experimenter:
        experimenter.say("trial 1")
        got.append(os.read(reader, 100).decode())
        os.close(reader)
        experimenter.say("trial 2")  # nobody reads any more, and the run goes on
    assert got[0].endswith(" trial 1\n")
    assert [line[9:] for line in (tmp_path / "log.txt").read_text().splitlines()] == ["trial 1", "trial 2"]


def test_full_fifo_does_not_block(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    with Experimenter(tmp_path / "log.txt", fifo) as experimenter:

        def talk():
            for _ in range(3000):
                experimenter.say("x" * 50)

        talker = threading.Thread(target=talk)
        talker.start()
        talker.join(20.0)
        assert not talker.is_alive()
    os.close(reader)


def test_subjects_terminal_is_no_view(tmp_path, monkeypatch):
    controller, terminal = pty.openpty()
    name = os.ttyname(terminal)
    with os.fdopen(terminal, "r") as stream:
        monkeypatch.setattr("sys.__stdin__", stream)
        for path in (name, "/dev/tty"):
            with pytest.raises(
                ValueError, match="the experimenter's view must not be the subject's terminal"
            ):
                Experimenter(tmp_path / "log.txt", path)
    os.close(controller)


def test_view_must_be_writable(tmp_path):
    with pytest.raises(OSError, match="nowhere"):
        Experimenter(tmp_path / "log.txt", tmp_path / "nowhere" / "view.txt")


THRESHOLDS = """
[tasks.staircase]
design = "staircase"
reference = "bone"
parameter = "c_e"
start = 2.0
trials = 12
interval_s = 2.5
[tasks.adaptive]
design = "adaptive"
reference = "bone"
parameter = "alpha"
mode = "drilling"
trials = 6
interval_s = 0.5
[tasks.levels]
design = "constant-stimuli"
reference = "bone"
parameter = "c_e"
levels = [1.1, 2.0]
repeats = 2
interval_s = 2.5
"""


@pytest.mark.parametrize("task", ["staircase", "adaptive", "levels"])
def test_thresholds_resume_where_they_were(config, capsys, task):
    config.write_text(CONFIG.partition("[tasks.probing]")[0] + THRESHOLDS)
    run = ["test.toml", "--simulated", "--subject", "01", "--task", task, "--weber", "0.2"]
    assert main(["experiment", "run", *run]) == 0
    path = Protocol.read(config).data.answers("01", task)
    first = path.read_bytes()
    path.write_bytes(b"".join(first.splitlines(keepends=True)[:4]))
    assert main(["experiment", "resume", *run]) == 0
    assert path.read_bytes() == first
    said(capsys)
    assert main(["experiment", "analyse", "test.toml"]) == 0
    assert f"\n{task}" in said(capsys)[0]


def test_outputs_do_not_go_into_the_files_of_the_experiment(config, capsys):
    assert main(["experiment", "run", "test.toml", "--simulated", "--subject", "01", "--fast"]) == 0
    said(capsys)
    answers = "data/sub-01/beh/sub-01_task-match_events.tsv"
    before = {path: path.read_bytes() for path in config.parent.rglob("*") if path.is_file()}
    (config.parent / "link.tsv").symlink_to(answers)
    for arguments in (
        ["analyse", "test.toml", "--tsv", answers],
        ["analyse", "test.toml", "--tsv", "link.tsv"],
        ["analyse", "data", "--tsv", "data/participants.tsv"],
        ["analyse", "test.toml", "--json", "test.toml"],
        ["analyse", "test.toml", "--json", "data/sourcedata/sub-01/beh/sub-01_task-match_log.txt"],
        ["resume", "test.toml", "--simulated", "--subject", "01", "--fast", "--experimenter", answers],
    ):
        path = arguments[-1]
        expected = f"{arguments[-2]}: {path} is of the experiment and is not written to"
        assert expected in wrong(arguments, capsys)
    assert all(path.read_bytes() == content for path, content in before.items())
    assert main(["experiment", "analyse", "data", "--json", "-", "--tsv", "data/mine.tsv"]) == 0
