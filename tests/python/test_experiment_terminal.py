"""The subject's screen and keys, and whole runs in a terminal by a subject that reads and presses; killed, resumed, read back."""

from __future__ import annotations

import io
import json
import os
import pty
import random
import re
import signal
import sys
import termios
import threading
import time

import pytest
from pseudo_terminal import _ADOPT, PseudoTerminal

from burrlab.cli import main
from burrlab.psychophysics.answers import read_answers
from burrlab.psychophysics.protocol import Protocol
from burrlab.psychophysics.seat import Keyboard, TerminalSeat

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
SPACE = r"Press the space bar (?:to go on|when you are ready)\."
QUESTION, BEGUN, OVER = "2   different", r"(?:First|Second) interval\.", "Thank you"
# What no subject may read: materials, their numbers, pair types, whether an answer was right.
HIDDEN = re.compile(r"bone|pvc|2\.145|0\.462|\b[AB]{2}\b|\bright\b|wrong|correct|score", re.IGNORECASE)


class Subject:
    """Presses what it has decided for each trial before it began, and remembers what it was asked."""

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

    def sit_down(self, action="run", *more):
        arguments = ["experiment", action, self.config.name, "--subject", SUBJECT, *more]
        return PseudoTerminal(*arguments, cwd=self.config.parent)

    def take_part(self, terminal, *, stop=lambda kind, trial: False):
        """To the end, or to where `stop` says so, given what shows ("space", "interval", "question") and the trial."""
        while True:
            found = terminal.wait_for(SPACE, QUESTION, BEGUN, OVER)
            places = re.findall(r"Trial (\d+) of", terminal.text)
            trial = int(places[-1]) if places else 0
            kind = {QUESTION: "question", OVER: "over"}.get(found) or (
                "space" if found.startswith("Press") else "interval"
            )
            if kind == "over":
                return
            if kind == "question":
                self.asked.append(trial)
            if stop(kind, trial):
                return
            if kind == "space":
                terminal.press(" ")
            elif kind == "question":
                terminal.press(KEYS[self.decided[trial - 1]])

    def leave(self, terminal):
        self.screens.append(terminal.text)

    def check(self):
        """The whole run is on disk, in the order it would have had undisturbed, with what was pressed."""
        rows = self.rows()
        assert [row.response for row in rows] == self.decided
        for row, trial in zip(rows, self.trials, strict=True):
            assert (row.phase, row.trial, row.trial_type) == (trial.phase, trial.number, trial.trial_type)
            assert row.stimuli == tuple(i.stimulus.name for i in trial.intervals)
            assert row.seeds == tuple(i.seed for i in trial.intervals)
            assert row.endings == ("time", "time")
            assert row.correct == (row.response == trial.correct)
        onsets = [row.onset for row in rows]
        assert onsets == sorted(onsets)
        for screen in self.screens:
            shown = screen.replace(self.config.name, "")
            assert not HIDDEN.search(shown), HIDDEN.search(shown)
        told = self.protocol.data.log(SUBJECT, TASK).read_text()
        for word in ("bone (c_e 2.145", "pvc (c_e 0.462", "AB", "BA", "AA", "BB", " right"):
            assert word in told


def test_undisturbed(tmp_path):
    subject = Subject(tmp_path)
    with subject.sit_down() as terminal:
        subject.take_part(terminal)
        assert terminal.end() == 0
        assert termios.tcgetattr(terminal.terminal) == terminal.before
        subject.leave(terminal)
    assert subject.asked == list(range(1, 11))
    subject.check()
    with subject.sit_down("resume") as terminal:
        assert terminal.end() == 0
        assert terminal.text == "subject 01 has answered everything"


def test_killed_in_an_interval_and_in_a_question_then_resumed_and_analysed(tmp_path, capsys):
    subject = Subject(tmp_path)
    for action, kind, trial, answered in (("run", "interval", 4, 3), ("resume", "question", 6, 5)):
        with subject.sit_down(action) as terminal:
            subject.take_part(terminal, stop=lambda *now, due=(kind, trial): now == due)
            terminal.kill()
            subject.leave(terminal)
        assert len(subject.rows()) == answered
    with subject.sit_down("resume") as terminal:
        subject.take_part(terminal)
        assert terminal.end() == 0
        assert "You go on where you stopped." in terminal.text
        subject.leave(terminal)
    # The question that the kill left open is put again, no other.
    assert subject.asked == [1, 2, 3, 4, 5, 6, 6, 7, 8, 9, 10]
    subject.check()
    assert main(["experiment", "analyse", str(subject.config), "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    counts = result["tasks"][0]["subjects"][0]["counts"]
    main_phase = list(zip(subject.trials, subject.decided, strict=True))[2:]
    different = [given == "different" for trial, given in main_phase if trial.correct == "different"]
    alarms = [given == "different" for trial, given in main_phase if trial.correct == "same"]
    assert (counts["hits"], counts["signals"]) == (sum(different), 4)
    assert (counts["false_alarms"], counts["noises"]) == (sum(alarms), 4)


def killed_at_random(subject, draw, longest, most):
    """Runs that end after a random time, up to `longest` from the first question [s], until one has come to its end."""
    action, kills = "run", 0
    while True:
        with subject.sit_down(action) as terminal:
            end = None if kills == most else draw.uniform(0.0, longest)
            begun = []

            def stop(kind, trial, end=end, begun=begun):
                begun.append(time.monotonic())
                return end is not None and time.monotonic() - begun[0] > end

            before = len(subject.rows())
            subject.take_part(terminal, stop=stop)
            over = "Thank you" in terminal.text
            if not over:
                time.sleep(draw.uniform(0.0, 0.05))  # between what it reads and what it does
            terminal.kill()
            subject.leave(terminal)
        if over:
            return
        kills += 1
        rows = subject.rows()
        assert len(rows) >= before
        assert [row.response for row in rows] == subject.decided[: len(rows)]
        # Every question but the last has been followed by another screen: its answer is on the disk.
        assert len(rows) >= len(set(subject.asked)) - 1
        subject.asked = list(range(1, len(rows) + 1))  # what may not be asked again
        action = "resume" if subject.file.exists() else "run"


def check_killed(folder, draw, *, most, **run):
    subject = Subject(folder, **run)
    killed_at_random(subject, draw, longest=2.0, most=most)
    assert subject.asked == list(range(1, len(subject.trials) + 1))  # none twice, none left out
    subject.check()


def test_killed_at_a_random_moment(tmp_path):
    check_killed(tmp_path, random.Random(1), trials=4, most=1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_killed_while_its_files_are_made(tmp_path, seed):
    subject, draw = Subject(tmp_path, trials=4), random.Random(seed)
    with subject.sit_down() as terminal:
        end = time.monotonic() + 30.0
        while not subject.protocol.folder.exists():
            assert time.monotonic() < end
        time.sleep(draw.uniform(0.0, 0.02))
        terminal.kill()
    with subject.sit_down("resume" if subject.file.exists() else "run") as terminal:
        subject.take_part(terminal)
        assert terminal.end() == 0
        subject.leave(terminal)
    assert subject.asked == list(range(1, 7))
    subject.check()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_killed_again_and_again(tmp_path, seed):
    check_killed(tmp_path, random.Random(seed), trials=12, interval=0.2, most=3)


def test_interrupted_then_terminal_closed_then_resumed(tmp_path):
    subject = Subject(tmp_path, trials=4)
    with subject.sit_down() as terminal:
        subject.take_part(terminal, stop=lambda *now: now == ("interval", 2))
        terminal.press("\x03")
        assert terminal.end() == 130
        assert termios.tcgetattr(terminal.terminal) == terminal.before
        assert terminal.text.endswith("Please wait. Every answer is kept.")
        subject.leave(terminal)
    assert len(subject.rows()) == 1
    terminal = subject.sit_down("resume")
    subject.take_part(terminal, stop=lambda *now: now == ("interval", 3))
    subject.leave(terminal)
    os.close(terminal.terminal)
    os.close(terminal.controller)
    assert terminal.process.wait(30.0) in (120, 130)  # 120: Python could not flush what it had to say
    assert len(subject.rows()) == 2
    told = subject.protocol.data.log(SUBJECT, TASK).read_text()
    for answered in (1, 2):
        assert (
            f"ended early, KeyboardInterrupt: {answered} trials are answered; burrlab experiment resume "
            in told
        )
    with subject.sit_down("resume") as another:
        subject.take_part(another)
        assert another.end() == 0
        subject.leave(another)
    subject.check()


def test_two_terminals_and_a_view(tmp_path):
    subject = Subject(tmp_path, trials=4)
    view = tmp_path / "view.txt"
    with subject.sit_down("run", "--experimenter", str(view)) as terminal:
        subject.take_part(terminal, stop=lambda kind, trial: trial == 1)
        with subject.sit_down("resume") as other:
            assert other.end() == 2
            assert "another process has this run open" in other.text
        terminal.press("\x03")
        terminal.end()
    assert "trial 1 (practice), " in view.read_text()


def test_without_a_terminal(tmp_path, capsys):
    subject = Subject(tmp_path)
    assert main(["experiment", "run", str(subject.config), "--subject", SUBJECT]) == 2
    assert "answers are read from a terminal" in capsys.readouterr().err
    assert not subject.protocol.folder.exists()


ASK = (
    _ADOPT
    + """
import sys, time
import burrlab
from burrlab.cli.options import ended_by_signals
from burrlab.psychophysics.designs import SameDifferent
from burrlab.psychophysics.seat import TerminalSeat
from burrlab.psychophysics.trial import Stimulus
bone, pvc = (Stimulus(name, burrlab.materials[name]) for name in ("bone", "pvc"))
design = SameDifferent(bone, pvc)
trial = design.order(seed=1, subject="01").next()
with TerminalSeat() as seat, ended_by_signals():
    seat.progress("Trial 1 of 12")
    exec(sys.argv[1])
"""
)


def asked(code: str) -> PseudoTerminal:
    return PseudoTerminal(code, program=ASK)


def test_answer_and_its_time():
    with asked(
        "seat.begins('Now.'); time.sleep(0.6); print('ANSWER', *seat.ask(design, trial, []))"
    ) as terminal:
        terminal.wait_for("Now")
        terminal.press("1")  # before the question
        terminal.wait_for("2   different")
        shown = time.monotonic()
        time.sleep(0.3)
        # F5, Home, other letters, Enter: none is an answer
        for keys in ("\x1b[15~", "\x1b[1~", "x", "\r", "3"):
            terminal.press(keys)
            time.sleep(0.02)
        terminal.press("2")
        taken = time.monotonic() - shown
        terminal.wait_for("ANSWER different ")
        assert terminal.end() == 0
        seconds = float(terminal.text.split()[-1])
        assert 0.3 <= seconds <= taken + 0.5
        assert terminal.text.count("Trial 1 of 12") == 2


def test_settings_come_back_after_each_end():
    for code, status in (("pass", 0), ("raise SystemExit(3)", 3), ("1 / 0", 1)):
        with asked(code) as terminal:
            assert terminal.end() == status
            assert termios.tcgetattr(terminal.terminal) == terminal.before


@pytest.mark.parametrize("how", ["key", "SIGTERM", "SIGHUP"])
def test_interrupted(how):
    with asked("seat.ready('Well?')") as terminal:
        terminal.wait_for("space bar")
        assert not termios.tcgetattr(terminal.terminal)[3] & termios.ECHO
        terminal.press("\x1a\x1c")  # Ctrl-Z and Ctrl-\ do nothing
        time.sleep(0.2)
        assert terminal.process.poll() is None
        if how == "key":
            terminal.press("\x03")
        else:
            terminal.process.send_signal(getattr(signal, how))
        assert terminal.end() != 0
        assert "KeyboardInterrupt" in terminal.text
        assert termios.tcgetattr(terminal.terminal) == terminal.before


def test_nothing_is_echoed():
    with asked("seat.ready('Well?')") as terminal:
        terminal.wait_for("space bar")
        terminal.press("secret")
        terminal.press(" ")
        assert terminal.end() == 0
        assert "secret" not in terminal.text


def test_break_waits_for_its_time_and_a_key():
    with asked(
        "start = time.monotonic(); seat.rest('Take a break.', 1.2); print('AFTER', time.monotonic() - start)"
    ) as terminal:
        terminal.wait_for("It goes on in 0:02")
        terminal.press(" ")  # too early
        terminal.wait_for("when you are ready")
        time.sleep(0.2)
        assert terminal.process.poll() is None
        terminal.press(" ")
        terminal.wait_for("AFTER ")
        assert terminal.end() == 0
        assert float(terminal.text.split()[-1]) >= 1.2


def test_done_counts_since_the_interval_began():
    code = "time.sleep(0.5); seat.begins('Now.'); a = seat.done(); time.sleep(0.5); print('DONE', a, seat.done(), seat.done())"
    with asked(code) as terminal:
        time.sleep(0.2)
        terminal.press(" ")
        terminal.wait_for("Now")
        time.sleep(0.1)
        terminal.press("x ")
        terminal.wait_for("DONE")
        assert terminal.end() == 0
        assert terminal.text.endswith("DONE False True False")


def test_needs_a_terminal(tmp_path):
    file = (tmp_path / "keys").open("w+")
    for stream in (file, io.StringIO()):
        with pytest.raises(ValueError, match="answers are read from a terminal: standard input is a pipe"):
            Keyboard(stream)
    file.close()


def test_needs_a_system_with_terminals(monkeypatch):
    monkeypatch.setitem(sys.modules, "termios", None)
    with pytest.raises(ValueError, match="a terminal, which this system does not have"):
        Keyboard()


def test_needs_a_screen(monkeypatch):
    controller, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as keys:
        monkeypatch.setattr(sys, "stdout", io.StringIO())
        with pytest.raises(ValueError, match="the subject needs a screen: standard output is a pipe"):
            TerminalSeat(Keyboard(keys))
    os.close(controller)


def test_terminal_closed():
    controller, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as keys:
        keyboard = Keyboard(keys)
        os.close(controller)
        with pytest.raises(KeyboardInterrupt, match="the subject's terminal was closed"):
            keyboard.pressed(" ")
        with pytest.raises(KeyboardInterrupt, match="the subject's terminal was closed"):
            keyboard.flush()


@pytest.mark.parametrize(
    "parts", [("\x1b", "[15~"), ("\x1b[1", "5~"), ("\x1b", "[", "1", ";2", "P"), ("\x1bO", "2P")]
)
def test_a_key_whose_sequence_comes_in_parts_is_no_answer(parts):
    controller, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as keys, Keyboard(keys) as keyboard:

        def slowly():
            for part in parts:
                os.write(controller, part.encode())
                time.sleep(0.02)

        line = threading.Thread(target=slowly)
        line.start()
        assert keyboard.pressed("12", 0.5) is None
        line.join()
        # Escape alone does not hold up the answer after it.
        os.write(controller, b"\x1b")
        assert keyboard.pressed("12", 0.3) is None
        os.write(controller, b"2")
        assert keyboard.pressed("12", 0.3) == "2"
    os.close(controller)


def test_plain_screen(monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    controller, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as keys, Keyboard(keys) as keyboard:
        screen = io.StringIO()
        seat = TerminalSeat(keyboard, screen)
        seat.progress("Trial 1 of 2")
        seat.tell("Right.")
        assert screen.getvalue() == "\nTrial 1 of 2\nRight.\n"
    os.close(controller)
