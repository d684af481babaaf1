"""Small experiments for tests of their files."""

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


def give(file, order, count, *, wrong=3):
    """Appends answers to file and order, every `wrong`-th one wrong; returns the trials."""
    trials = []
    for _ in range(count):
        trial = order.next()
        place = len(order.answered)
        answers = ("same", "different") if trial.correct in ("same", "different") else ("first", "second")
        other = next(one for one in answers if one != trial.correct)
        response = other if place % wrong == wrong - 1 else trial.correct
        file.append(answer(trial, response, 60.0 * place + 1e-7))  # times are kept to the microsecond
        order.answer(response)
        trials.append(trial)
    return trials


def begun(
    folder: Path, task: str = "probing", count: int = 0, subject: str = "01", text: str = SMALL, wrong=3
):
    """(protocol, path) of a closed run with `count` answers."""
    one = protocol(folder, text)
    file, order = one.begin(subject, task)
    with file:
        give(file, order, count, wrong=wrong)
    return one, file.path


def trials_of(one: Protocol, task: str, count: int, *, subject: str = "01", wrong=3):
    """The first trials of a run, answered by `give`."""
    return give(Mock(), one.order(subject, task), count, wrong=wrong)


def run(protocol, subject, task, right, stop=10_000):
    """Answers a run, correctly where `right` is True."""
    file, order = protocol.begin(subject, task)
    with file:
        while len(order.answered) < stop and (trial := order.next()) is not None:
            (other,) = {*protocol.tasks[task].answers} - {trial.correct}
            response = trial.correct if right(trial) else other
            file.append(answer(trial, response, 45.0 * len(order.answered)))
            order.answer(response)
