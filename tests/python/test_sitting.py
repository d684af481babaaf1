"""A subject's tasks in a row, from Python: with a seat and a device of one's own."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace

import pytest
from answer_scenes import protocol

import burrlab.psychophysics.run as sitting
from burrlab.psychophysics.analysis import analyse
from burrlab.psychophysics.answers import read_answers
from burrlab.psychophysics.interval import render
from burrlab.psychophysics.observer import probing_hand
from burrlab.psychophysics.run import Sitting
from burrlab.psychophysics.seat import Seat

TEXT = """
[experiment]
name = "own"
seed = 1
subjects = 1
[burr]
radius_mm = 3.0
[bone]
size_mm = [12.0, 12.0, 4.0]
voxel_mm = 0.5
[tasks.one]
design = "same-different"
a = "bone"
b = "pvc"
trials = 4
interval_s = 0.3
"""


class Same(Seat):
    """Says nothing, and always the same."""

    wall_clock = False

    def progress(self, text): ...
    def show(self, text): ...
    def ready(self, text): ...
    def begins(self, text): ...
    def ends(self, text, pause): ...
    def tell(self, text): ...
    def rest(self, text, seconds): ...
    def close(self, text): ...

    def done(self):
        return False

    def ask(self, design, trial, rendered):
        return design.answers[0], 0.5


def test_a_device_of_ones_own_renders_every_interval_and_is_named(tmp_path):
    made = protocol(tmp_path, TEXT)
    modes = []

    def rig(mode):
        modes.append(mode)
        return probing_hand(made.burr, push=1.0)

    assert Sitting(made, "01", device=rig).run(lambda task: Same()) == 4
    assert modes == ["probing"] * 16  # of each interval one until the burr is lifted, and one that feels
    path = made.data.answers("01", "one")
    assert read_answers(path).counts().trials == 4
    assert json.loads(path.with_suffix(".json").read_text())["Device"] == "driver"


def test_load_and_repeats_are_told_to_the_experimenter(tmp_path, monkeypatch):
    calls = itertools.count()

    def loaded(*given, **options):
        """Late in the trial run, and stalled in the second interval."""
        found, call = render(*given, **options), next(calls)
        ticks = found.ticks.copy()
        ticks["periods"] = 1 + (call == 0)
        return replace(found, ticks=ticks, failed=call == 2, reason="the loop stalled: 101 ms")

    monkeypatch.setattr(sitting, "render", loaded)
    made = protocol(tmp_path, TEXT)
    assert Sitting(made, "01", again="COMMAND").run(lambda task: Same()) == 4
    told = made.data.log("01", "one").read_text()
    assert re.search(
        r"THE MACHINE HAS TOO MUCH TO DO: before the first trial (\d+) of \1 ticks were late", told
    )
    assert "trials repeated as the loop had stalled: 1" in told
    assert [row.repeats for row in read_answers(made.data.answers("01", "one")).rows] == [1, 0, 0, 0]
    assert "Trials that were repeated, as the loop had stalled: 1 of 01 of one." in analyse(made).report()


@pytest.mark.parametrize(
    ("subject", "options", "sentence"),
    [
        ("09", {}, "there is no subject '09'; there are 01"),
        ("01", {"tasks": ["two"]}, "there is no task 'two'; there are one"),
        ("01", {"device": "mouse"}, "^device must be hand, scripted:FILE or igtl:HOST:PORT"),
    ],
)
def test_refusals(tmp_path, subject, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        Sitting(protocol(tmp_path, TEXT), subject, **options)
