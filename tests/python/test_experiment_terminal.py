"""The subject's screen and keys, and whole runs by a scripted subject: killed, resumed and read back."""

import contextlib
import io
import math
import os
import pty
import random
import re
import select
import signal
import sys
import termios
import threading
import time
import types

import pytest
from pseudo_terminal import BURRLAB, PseudoTerminal
from session_scenes import refused

import burrlab
from burrlab.cli import main
from burrlab.psychophysics import Protocol, SameDifferent, Stimulus, read_answers
from burrlab.psychophysics.run import TerminalSeat

SUBJECT, TASK = "01", "one"
CONFIG = """
[experiment]
name = "Test"
seed = 11
subjects = 4
pause_s = 0.0
break_s = 0.0
{more}
[burr]
radius_mm = 3.0
[bone]
size_mm = [16.0, 16.0, 4.0]
voxel_mm = 0.5
[tasks.one]
design = "same-different"
a = "bone"
b = "pvc"
trials = {trials}
practice = 2
blocks = 2
interval_s = {interval}
[analysis]
rules = ["differencing"]
"""
KEYS = {"same": "1", "different": "2"}
#: Texts that a subject waits for.
SHOWN = {
    "space": r"Press the space bar (?:to go on|when you are ready)\.",
    "question": "2   different",
    "interval": r"(?:First|Second) interval\.",
    "over": "Thank you",
}
# Texts that no subject may read: materials, their numbers, pair types, whether an answer was right.
HIDDEN = re.compile(r"bone|pvc|2\.145|0\.462|\b[AB]{2}\b|\bright\b|wrong|correct|score", re.IGNORECASE)


class Subject:
    """A scripted subject, who decides all answers beforehand and remembers the questions."""

    def __init__(self, folder, *, trials=8, interval=0.1, more=""):
        self.config = folder / "test.toml"
        self.config.write_text(CONFIG.format(trials=trials, interval=interval, more=more))
        self.protocol = Protocol.read(self.config)
        self.trials = list(self.protocol.order(SUBJECT, TASK).trials)
        draw = random.Random(5)
        self.decided = [draw.choice(list(KEYS)) for _ in self.trials]
        self.asked = []  # trials in the order of their questions, from 1
        self.screens = []

    @property
    def file(self):
        return self.protocol.data.answers(SUBJECT, TASK)

    def rows(self):
        return read_answers(self.file).rows if self.file.exists() else ()

    @contextlib.contextmanager
    def sit_down(self, action="run", *more):
        arguments = ["experiment", action, self.config.name, "--subject", SUBJECT, *more]
        with PseudoTerminal(*arguments, cwd=self.config.parent) as terminal:
            yield terminal
            self.screens.append(terminal.text)

    def take_part(self, terminal, *, stop=lambda kind, trial: False):
        """Takes part until the end or until `stop("space", "interval" or "question", trial)` is True."""
        kind = ""
        while kind != "over":
            found = terminal.wait_for(*SHOWN.values())
            kind = next(kind for kind, pattern in SHOWN.items() if re.fullmatch(pattern, found))
            number, place = [("0", ""), *re.findall(r"Trial (\d+) of \d+, (\w+)", terminal.text)][-1]
            trial = int(number) + 2 * (place == "block")  # two of practice
            if kind == "question":
                self.asked.append(trial)
            if kind != "over" and stop(kind, trial):
                return
            terminal.press({"space": " ", "question": KEYS[self.decided[trial - 1]]}.get(kind, ""))

    def check(self):
        """Checks that all pressed answers are on disk, in the order of an undisturbed run."""
        rows = self.rows()
        assert [
            (r.phase, r.trial, r.trial_type, r.stimuli, r.seeds, r.endings, r.response, r.correct) for r in rows
        ] == [
            (
                trial.phase, trial.number, trial.trial_type, tuple(i.stimulus.name for i in trial.intervals),
                tuple(i.seed for i in trial.intervals), ("time", "time"), given, given == trial.correct,
            )
            for trial, given in zip(self.trials, self.decided, strict=True)
        ]  # fmt: skip
        assert [row.onset for row in rows] == sorted(row.onset for row in rows)
        for screen in self.screens:
            assert not HIDDEN.search(screen.replace(self.config.name, ""))
        told = self.protocol.data.log(SUBJECT, TASK).read_text()
        assert all(
            word in told for word in ("bone (c_e 2.145", "pvc (c_e 0.462", "AB", "BA", "AA", "BB", " right")
        )


def test_undisturbed_alone_and_seen_by_the_experimenter(tmp_path):
    subject, view = Subject(tmp_path), tmp_path / "view.txt"
    with subject.sit_down("run", "--experimenter", str(view)) as terminal:
        subject.take_part(terminal, stop=lambda *now: now == ("question", 1))
        with subject.sit_down("resume") as other:
            assert other.end() == 2
            assert "another process has this run open" in other.text
        terminal.press(KEYS[subject.decided[0]])
        subject.take_part(terminal)
        assert (terminal.end(), termios.tcgetattr(terminal.terminal)) == (0, terminal.before)
    assert subject.asked == list(range(1, 11))
    subject.check()
    assert "trial 1 (practice), " in view.read_text()
    with subject.sit_down("resume") as terminal:
        assert (terminal.end(), terminal.text) == (0, "subject 01 has answered everything")


def test_the_screen_is_not_empty_while_modules_load(tmp_path):
    subject, program = (
        Subject(tmp_path),
        BURRLAB.replace("import sys;", "import sys; sys.argv[0] = 'burrlab';"),
    )
    program = program.replace(
        "from burrlab.cli", "import burrlab; print('scipy' in sys.modules); from burrlab.cli"
    )
    arguments = ("experiment", "run", subject.config.name, "--subject", SUBJECT)
    with PseudoTerminal(*arguments, program=program, cwd=tmp_path) as terminal:
        subject.take_part(terminal, stop=lambda kind, trial: True)
        assert terminal.text.startswith("Preparing ... False Each trial has")
    with PseudoTerminal(*arguments, "--simulated", program=program, cwd=tmp_path) as terminal:
        terminal.end()
        assert "Preparing" not in terminal.text


def test_killed_in_an_interval_and_in_a_question_then_resumed(tmp_path):
    subject = Subject(tmp_path)
    for action, kind, trial, answered in (("run", "interval", 4, 3), ("resume", "question", 6, 5)):
        with subject.sit_down(action) as terminal:
            subject.take_part(terminal, stop=lambda *now, due=(kind, trial): now == due)
            terminal.kill()
        assert len(subject.rows()) == answered
    with subject.sit_down("resume") as terminal:
        subject.take_part(terminal)
        assert terminal.end() == 0
        assert "You go on where you stopped." in terminal.text
    # Only the question that the kill left open is asked again.
    assert subject.asked == [1, 2, 3, 4, 5, 6, 6, 7, 8, 9, 10]
    subject.check()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_killed_again_and_again(tmp_path, seed):
    """Three kills, each within 2 s of the first text; then the run may end."""
    subject, draw = Subject(tmp_path, trials=12, interval=0.2), random.Random(seed)
    for kill in range(4):
        before, end = len(subject.rows()), math.inf if kill == 3 else draw.uniform(0.0, 2.0)
        with subject.sit_down("resume" if subject.file.exists() else "run") as terminal:
            begun = []

            def stop(kind, trial, end=end, begun=begun):
                begun.append(time.monotonic())
                return time.monotonic() - begun[0] > end

            subject.take_part(terminal, stop=stop)
            over = "Thank you" in terminal.text
            time.sleep(0.0 if over else draw.uniform(0.0, 0.05))  # between reading and acting
            terminal.kill()
        if over:
            break
        rows = subject.rows()
        assert before <= len(rows)
        # Another screen followed every question but the last, so the answers are on disk.
        assert len(rows) >= len(set(subject.asked)) - 1
        subject.asked = list(range(1, len(rows) + 1))  # these may not be asked again
    assert subject.asked == list(range(1, len(subject.trials) + 1))  # none twice, none left out
    subject.check()


def test_interrupted_then_terminal_closed(tmp_path):
    subject = Subject(tmp_path, trials=4)
    with subject.sit_down() as terminal:
        subject.take_part(terminal, stop=lambda *now: now == ("question", 2))
        terminal.press("\x1a\x1c")  # Ctrl-Z and Ctrl-\ do nothing
        time.sleep(0.2)
        assert terminal.process.poll() is None
        terminal.press("\x03")
        assert (terminal.end(), termios.tcgetattr(terminal.terminal)) == (130, terminal.before)
        assert terminal.text.endswith("Please wait. Every answer is kept.")
    assert len(subject.rows()) == 1
    terminal = PseudoTerminal("experiment", "resume", "test.toml", "--subject", SUBJECT, cwd=tmp_path)
    subject.take_part(terminal, stop=lambda *now: now == ("interval", 3))
    os.close(terminal.terminal)
    os.close(terminal.controller)
    # 120: Python could not flush its output; SIGHUP may also come after everything is done.
    assert terminal.process.wait(30.0) in (120, 130, -signal.SIGHUP)
    assert [row.response for row in subject.rows()] == subject.decided[:2]
    told = subject.protocol.data.log(SUBJECT, TASK).read_text()
    for answered in (1, 2):
        assert (
            f"ended early, KeyboardInterrupt: {answered} trials are answered; burrlab experiment resume "
            in told
        )


def test_without_a_terminal(tmp_path, capsys):
    subject = Subject(tmp_path)
    assert main(["experiment", "run", str(subject.config), "--subject", SUBJECT]) == 2
    assert "answers are read from a terminal" in capsys.readouterr().err
    assert not subject.protocol.folder.exists()


class Desk:
    """A seat at a terminal in this process."""

    def __init__(self):
        self.controller, self.terminal = pty.openpty()
        self.before, self.screen = termios.tcgetattr(self.terminal), io.StringIO()
        self.stream = types.SimpleNamespace(fileno=lambda: self.terminal)
        self.seat = TerminalSeat(self.stream, self.screen)

    def press(self, *keys):
        for key in keys:
            os.write(self.controller, key.encode())
            time.sleep(0.02)

    def pressed_once_shown(self, text, *keys, after=0.0):
        """Starts a thread that presses keys this long after a text appears [s]."""

        def wait():
            while text not in self.screen.getvalue():
                time.sleep(0.005)
            time.sleep(after)
            self.press(*keys)

        threading.Thread(target=wait).start()


@pytest.fixture
def left(monkeypatch):
    """A desk whose terminal must be left as it was."""
    for name, value in (("TERM", "xterm"), ("COLUMNS", "80"), ("LINES", "24")):
        monkeypatch.setenv(name, value)
    found = Desk()
    yield found
    assert termios.tcgetattr(found.terminal) == found.before
    os.close(found.controller)
    os.close(found.terminal)


@pytest.fixture
def desk(left):
    with left.seat:
        yield left


@pytest.mark.parametrize("answers", ["12", "Fj"])
def test_answer_and_its_time(desk, answers):
    bone, pvc = (Stimulus(name, burrlab.materials[name]) for name in ("bone", "pvc"))
    design = SameDifferent(bone, pvc)
    desk.seat.progress("Trial 1 of 12")
    desk.seat.keys = answers
    desk.press(answers[0])  # before the question
    # F5, Home, End, other letters and Enter are no answers
    desk.pressed_once_shown(
        f"{answers[1]}   different", "\x1b[15~", "\x1b[1~", "\x1b[F", "x", "\r", "3", answers[1], after=0.3
    )
    begun = time.monotonic()
    answer, taken = desk.seat.ask(design, design.order(seed=1, subject="01").next(), [])
    assert answer == "different"
    assert 0.3 <= taken <= time.monotonic() - begun
    assert desk.screen.getvalue().count("Trial 1 of 12") == 1


def test_break_waits_for_its_time_and_a_key(desk):
    desk.pressed_once_shown("It goes on in 0:02", " ")  # too early
    desk.pressed_once_shown("when you are ready", " ", after=0.3)
    begun = time.monotonic()
    desk.seat.rest("Take a break.", 1.2)
    assert time.monotonic() - begun >= 1.5


def test_done_counts_since_the_interval_began_and_nothing_is_echoed(desk):
    desk.press(" ")
    desk.seat.begins("Now.")
    page = (
        "\x1b[2J\x1b[H\n" + 9 * "\n" + 38 * " " + "\x1b[1mNow.\x1b[0m\n\a"
    )  # in the middle, bold, with a beep
    assert desk.screen.getvalue() == page
    assert not desk.seat.done()
    desk.press("secret ")
    assert (desk.seat.done(), desk.seat.done()) == (True, False)
    assert not select.select([desk.controller], [], [], 0.1)[0]


def test_needs_a_terminal_and_a_screen(tmp_path, monkeypatch, left):
    with (tmp_path / "keys").open("w+") as file:
        rule = "answers are read from a terminal: standard input is a p"
        refused((lambda: TerminalSeat(file), rule), (lambda: TerminalSeat(io.StringIO()), rule))
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    refused((lambda: TerminalSeat(left.stream), "the subject needs a screen: standard output is a pipe"))
    monkeypatch.setitem(sys.modules, "termios", None)
    refused((TerminalSeat, "a terminal, which this system does not have"))


def test_terminal_closed():
    found = Desk()
    os.close(found.controller)
    rule = "the subject's terminal was closed"
    refused((lambda: found.seat.pressed(" "), rule), (found.seat.flush, rule), error=KeyboardInterrupt)
    os.close(found.terminal)


@pytest.mark.parametrize(
    "parts", [("\x1b", "[15~"), ("\x1b[1", "5~"), ("\x1b", "[", "1", ";2", "P"), ("\x1bO", "2P")]
)
def test_a_key_whose_sequence_comes_in_parts_is_no_answer(desk, parts):
    line = threading.Thread(target=desk.press, args=parts)
    line.start()
    assert desk.seat.pressed("12", 0.5) is None
    line.join()
    desk.press("\x1b")  # Escape alone does not delay the next answer
    assert desk.seat.pressed("12", 0.3) is None
    desk.press("2")
    assert desk.seat.pressed("12", 0.3) == "2"


def test_plain_screen(left, monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    seat = TerminalSeat(left.stream, left.screen)
    seat.progress("Trial 1 of 2")
    seat.tell("Right.")
    assert left.screen.getvalue() == "\nTrial 1 of 2\nRight.\n"
