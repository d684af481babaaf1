"""Small experiments for tests of their files."""

import contextlib
from pathlib import Path
from unittest.mock import Mock

from burrlab.psychophysics import AnswerRow, Protocol

SMALL = """
[experiment]
name = "test"
seed = 7
subjects = 3

[burr]
radius_mm = 3

[bone]
size_mm = [12, 12, 6]
voxel_mm = 0.5

[tasks.probing]
design = "same-different"
a = "bone"
b = "pvc"
trials = 8
practice = 2
blocks = 2

[tasks.match]
design = "abx"
reference = "bone"
foil = "pvc"
trials = 4

[tasks.up]
design = "staircase"
reference = "bone"
parameter = "c_e"
trials = 10
"""

TASKS = ("probing", "match", "up")


def protocol(folder: Path, text: str = SMALL) -> Protocol:
    """A protocol from a file with this text."""
    path = folder / "test.toml"
    path.write_text(text, encoding="utf-8")
    return Protocol.read(path)


def answer(trial, response, onset, response_time=0.75):
    """An answer to a trial with this onset [s]."""
    return AnswerRow.of(
        trial, onset=onset, duration=41.5, response=response, response_time=response_time,
        endings=("time",) * len(trial.intervals),
    )  # fmt: skip


def give(file, order, count=10_000, *, right=None, change=lambda row, place: row):
    """Appends answers to file and order until the count or the run ends; returns the trials.

    Answers are correct where `right(trial)` is True, by default all but every third one.
    """
    trials = []
    while len(trials) < count and (trial := order.next()) is not None:
        place = len(order.answered)
        (other,) = {*order._answers} - {trial.correct}
        correct = place % 3 != 2 if right is None else right(trial)
        # times are kept to the microsecond
        row = change(answer(trial, trial.correct if correct else other, 60.0 * place + 1e-7), place)
        file.append(row)
        order.answer(row.response, lost=row.lost)
        trials.append(trial)
    return trials


@contextlib.contextmanager
def sat(run):
    """File and order of a run that was begun or resumed; the file is closed at the end."""
    with run[0]:
        yield run


def run(protocol, subject, task, right=None, count=10_000):
    """Begins a run and answers it by `give`; returns its path."""
    with sat(protocol.begin(subject, task)) as (file, order):
        give(file, order, count, right=right)
    return file.path


def begun(
    folder: Path, task: str = "probing", count: int = 0, subject: str = "01", text: str = SMALL, right=None
):
    """(protocol, path) of a closed run with `count` answers."""
    one = protocol(folder, text)
    return one, run(one, subject, task, right, count)


def trials_of(one: Protocol, task: str, count: int, *, subject: str = "01"):
    """The first trials of a run, answered by `give`."""
    return give(Mock(), one.order(subject, task), count)
