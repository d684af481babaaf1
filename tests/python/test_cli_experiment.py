"""burrlab experiment without a terminal."""

import json
import os
import pty
import threading
from unittest.mock import Mock

import matplotlib.pyplot
import pytest
from command_line import refusal
from session_scenes import refused

import burrlab.cli.experiment as cli_experiment
import burrlab.cli.options as cli_options
from burrlab.cli import main
from burrlab.psychophysics import DeviceLost, Protocol, SimulatedSeat, read_folder
from burrlab.psychophysics.run import Experimenter

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


THRESHOLDS = """
[tasks.staircase]
design = "staircase"
reference = "bone"
parameter = "c_e"
start = 2.0
trials = 8
interval_s = 1.5
[tasks.adaptive]
design = "adaptive"
reference = "bone"
parameter = "alpha"
mode = "drilling"
trials = 4
interval_s = 0.5
"""


@pytest.fixture
def config(here):
    path = here / "test.toml"
    path.write_text(CONFIG)
    return path


def said(capsys):
    out, err = capsys.readouterr()
    return out, err.replace("\r", "")


def wrong(arguments, capsys):
    err = refusal(capsys, "experiment", *arguments)
    assert err.startswith("burrlab experiment: ")
    return err


def simulated(action, *more, subject="01", task="match"):
    """Runs or resumes with a simulated subject; the exit status."""
    return main(
        ["experiment", action, "test.toml", "--simulated", "--subject", subject, "--task", task, *more]
    )


def cut(path, lines):
    """Keeps the first lines of a file, as a kill does; returns the whole."""
    whole = path.read_bytes()
    path.write_bytes(b"".join(whole.splitlines(keepends=True)[:lines]))
    return whole


def test_simulated_subjects_from_run_to_analysis(config, capsys, monkeypatch):
    shown = []
    for module in (cli_experiment, cli_options):
        monkeypatch.setattr(module, "show_line", shown.append)
    assert main(["experiment", "run", "test.toml", "--simulated", "--all", "--fast", "--weber", "0.2"]) == 0
    assert said(capsys)[0] == "".join(f"simulated subject 0{n}: 6 trials answered\n" for n in (1, 2, 3))
    protocol = Protocol.read(config)
    every = read_folder(protocol.folder)
    assert [(one.subject, one.name, one.simulated) for one in every] == [
        (subject, task, True) for task in ("match", "probing") for subject in ("01", "02", "03")
    ]
    assert {p["simulated"] for p in protocol.data.participants().values()} == {"yes"}
    who = every[0].side_car.simulated
    assert (who["rendered"], who["drilling"]["weber"]) == ("each material once a task", {"sinking": 0.2})
    assert [(row.stimuli[0], row.response_time) for row in every[0].rows] == [("specimen", None)] * 2
    # The analysis says that nobody took part.
    arguments = ["--json", "a.json", "--tsv", "a.tsv", "--plot", "figures"]
    assert main(["experiment", "analyse", "test.toml", *arguments]) == 0
    assert {
        "simulated subject 02, task match: trial 2 of 2, block 1",
        "task probing, subject 03",
        "figure task-match_d_prime",
    } <= {*shown}
    assert (shown[-1], matplotlib.pyplot.get_fignums()) == ("", [])
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
    """A run cut within each task, with one task not begun; intervals felt again leave another trace."""
    config.write_text(CONFIG.replace("seed = 3", "seed = 3\ntrace = true") + THRESHOLDS)
    protocol, run = Protocol.read(config), ["test.toml", "--simulated", "--subject", "02", "--weber", "0.2"]
    files = {task: protocol.data.answers("02", task) for task in protocol.tasks}
    assert main(["experiment", "run", *run]) == 0
    before = {task: cut(file, 3) for task, file in files.items() if task != "match"}
    before["match"] = files["match"].read_bytes()
    for file in (files["match"], files["match"].with_suffix(".json")):
        file.unlink()
    assert main(["experiment", "resume", *run]) == 0
    assert {task: file.read_bytes() for task, file in files.items()} == before
    assert said(capsys)[0] == (
        "simulated subject 02: 18 trials answered\nsimulated subject 02: 12 trials answered\n"
    )
    assert sorted(
        path.name for path in protocol.data.log("02", "match").parent.glob("*_task-match_*.h5")
    ) == sorted(
        f"sub-02_task-match_main-00{trial}_interval-{number}{again}_trace.h5"
        for trial in (1, 2)
        for number in (1, 2, 3)
        for again in ("", "_attempt-2")
    )
    assert main(["experiment", "analyse", "test.toml"]) == 0
    report = said(capsys)[0]
    assert all(f"\n{task}" in report for task in protocol.tasks)


def test_begun_or_not_or_by_another(config, capsys):
    run = ["test.toml", "--simulated", "--subject", "01", "--task", "match"]
    begin = "burrlab experiment run test.toml --subject 01 --task match --simulated begins"
    assert f"subject 01 has begun no task: {begin}" in wrong(["resume", *run], capsys)
    assert simulated("run") == 0
    said(capsys)
    told = "subject 01 has begun task match: burrlab experiment resume test.toml"
    assert told in wrong(["run", *run], capsys)
    assert simulated("resume") == 0
    assert said(capsys)[0] == "simulated subject 01: 0 trials answered\n"
    told = "simulated subject.drilling.weber.sinking was 0.45, is now 0.3"
    assert told in wrong(["resume", *run, "--weber", "0.3"], capsys)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "none.toml", "--subject", "01"], "none.toml"),
        (["run", "test.toml", "--subject", "09"], "there is no subject '09'; there are 01, 02, 03"),
        (["run", "test.toml", "--subject", "01", "--task", "x"],
         "there is no task 'x'; there are probing, match"),
        (["run", "test.toml"], "--subject LABEL or --simulated --all must say who takes part"),
        (["run", "test.toml", "--subject", "01", "--all", "--simulated"],
         "--subject LABEL or --simulated --all"),
        (["run", "test.toml", "--all"], "--all goes with --simulated"),
        (["run", "test.toml", "--subject", "01", "--fast"], "--fast goes with --simulated"),
        (["run", "test.toml", "--subject", "01", "--weber", "1"], "--weber goes with --simulated"),
        (["run", "test.toml", "--subject", "01", "--device", "mouse"],
         "device must be hand, scripted:FILE, igtl:"),
        (["run", "test.toml", "--subject", "01", "--device", "scripted:none.csv"], "none.csv"),
        (["run", "test.toml", "--subject", "01", "--simulated", "--device", "hand"], "--device does not go with"),
        (["analyse", "test.toml"], "there is no file of answers"),
        (["analyse", "test.toml", "--plot", "test.toml"], "--plot: test.toml is no folder"),
        (["analyse", "test.toml", "--json", "/nowhere/a.json"], "--json: /nowhere/a.json cannot be written"),
        (["new", "/nowhere/a.toml"], "folder must exist, got /nowhere"),
        (["new", "test.toml"], "test.toml exists and is not replaced"),
    ],
)  # fmt: skip
def test_wrong_input(config, capsys, arguments, message):
    assert message in wrong(arguments, capsys)
    assert (config.read_text(), (config.parent / "data").exists()) == (CONFIG, False)


@pytest.mark.parametrize(
    ("error", "status", "told"),
    [
        (DeviceLost("the device was lost: X"), 1, "the device was lost: X;"),
        (KeyboardInterrupt(), 130, "interrupted; every answer is kept,"),
    ],
)
def test_ended_early(config, capsys, monkeypatch, error, status, told):
    monkeypatch.setattr(SimulatedSeat, "ask", Mock(side_effect=error))
    assert simulated("run") == status
    resume = "burrlab experiment resume test.toml --subject 01 --task match --simulated goes on"
    assert f"{told} {resume}" in said(capsys)[1]


@pytest.fixture
def fifo(tmp_path):
    path = tmp_path / "fifo"
    os.mkfifo(path)
    return path


def test_experimenter_sees_it_in_a_fifo_which_blocks_nothing(tmp_path, fifo):
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    with Experimenter(tmp_path / "log.txt", fifo) as experimenter:
        experimenter.say("trial 1")
        assert os.read(reader, 100).endswith(b" trial 1\n")
        talker = threading.Thread(
            target=lambda: [experimenter.say(text) for text in ["x" * 50] * 3000], daemon=True
        )
        talker.start()
        talker.join(20.0)
        assert not talker.is_alive(), "the fifo is full"
        os.close(reader)
        experimenter.say("trial 2")  # without a reader the run goes on
    told = [line[9:] for line in (tmp_path / "log.txt").read_text().splitlines()]
    assert told == ["trial 1", *["x" * 50] * 3000, "trial 2"]


def test_views_that_are_refused(tmp_path, monkeypatch, fifo):
    controller, terminal = pty.openpty()
    own, log = "the experimenter's view must not be the subject's terminal", tmp_path / "log.txt"
    with os.fdopen(terminal, "r") as stream:
        monkeypatch.setattr("sys.__stdin__", stream)
        refused(
            (lambda: Experimenter(log, fifo), "the experimenter's view is a fifo that nobody reads"),
            (lambda: Experimenter(log, os.ttyname(terminal)), own),
            (lambda: Experimenter(log, "/dev/tty"), own),
            (lambda: Experimenter(log, tmp_path / "nowhere" / "view.txt"), "nowhere", OSError),
        )
    os.close(controller)


def test_outputs_do_not_go_into_the_files_of_the_experiment(config, capsys):
    assert simulated("run", "--fast") == 0
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
        assert f"{arguments[-2]}: {arguments[-1]} is of the experiment and is not written to" in wrong(
            arguments, capsys
        )
    assert all(path.read_bytes() == content for path, content in before.items())
    assert main(["experiment", "analyse", "data", "--json", "-", "--tsv", "data/mine.tsv"]) == 0
