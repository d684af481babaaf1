"""The subject's screen and keys."""

from __future__ import annotations

import io
import os
import pty
import signal
import sys
import termios
import threading
import time

import pytest
from pseudo_terminal import _ADOPT, PseudoTerminal

from burrlab.psychophysics.seat import Keyboard, TerminalSeat

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
