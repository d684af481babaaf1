"""The loop over trials and a subject's tasks in a row: what is shown, kept and told, and what happens when a device is lost."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from answer_scenes import protocol

import burrlab
import burrlab.psychophysics.run as sitting
from burrlab.psychophysics.analysis import analyse
from burrlab.psychophysics.answers import read_answers
from burrlab.psychophysics.designs import ABX, SameDifferent
from burrlab.psychophysics.interval import Block, Clock, render
from burrlab.psychophysics.observer import drilling_hand, probing_hand
from burrlab.psychophysics.run import DeviceLost, LoopStalled, Rig, Runner, Sitting
from burrlab.psychophysics.seat import Experimenter, Seat
from burrlab.psychophysics.trial import Stimulus

BURR = burrlab.Burr(3.0)
BONE, PVC, PETTIGREW = (Stimulus(name, burrlab.materials[name]) for name in ("bone", "pvc", "pettigrew"))
BLOCK = Block((16, 16, 4), 0.5)


class Paper(Seat):
    """Keeps what it is told; answers are given beforehand."""

    wall_clock = False

    def __init__(self, answers=(), patience=3):
        self.seen, self.rests = [], []
        self.answers, self.patience = iter(answers), patience
        self._looks = 0

    def note(self, text, pause=0.0):
        self.seen.append(text)

    progress = ready = show = ends = tell = close = note

    def begins(self, text):
        self._looks = 0
        self.seen.append(text)

    def done(self):
        self._looks += 1
        return self._looks > self.patience

    def ask(self, design, trial, rendered):
        self.seen.append(design.question)
        answer = next(self.answers)
        if isinstance(answer, BaseException):
            raise answer
        return (trial.correct if answer == "right" else answer), 1.25

    def rest(self, text, seconds):
        self.rests.append(seconds)


def hand(mode):
    return probing_hand(BURR) if mode == "probing" else drilling_hand(BURR)


def run(design, seat, tmp_path, *, order=None, kept=None, clock=None, **rig):
    rig = Rig(**{"burr": BURR, "bone": BLOCK, "device": hand, "pause": 0.0, "rest": 60.0, **rig})
    order = design.order(seed=1, subject="01") if order is None else order
    kept = [] if kept is None else kept
    clock = Clock() if clock is None else clock
    with Experimenter(tmp_path / "log.txt") as experimenter:
        return Runner(design, order, kept.append, seat, experimenter, rig, clock=clock).run()


def log(tmp_path):
    return (tmp_path / "log.txt").read_text()


def test_whole_run(tmp_path):
    design = SameDifferent(BONE, PVC, trials=8, interval=0.1, practice=2, blocks=2)
    seat, kept = Paper(itertools.cycle(["same", "different"])), []
    order = design.order(seed=3, subject="01")
    assert run(design, seat, tmp_path, order=order, kept=kept) == 10
    assert order.next() is None
    due = design.order(seed=3, subject="01").trials
    assert [answer.trial for answer in kept] == list(due)
    assert [answer.response for answer in kept] == ["same", "different"] * 5
    assert all(answer.endings == ("time", "time") for answer in kept)
    np.testing.assert_allclose([answer.onset for answer in kept], 0.2 * np.arange(10), atol=1e-6)
    np.testing.assert_allclose([answer.duration for answer in kept], 0.2)
    assert seat.rests == [60.0]  # between the blocks, not after practice
    assert "That was practice. Now it counts." in seat.seen
    shown = [text for text in seat.seen if text.startswith("Trial")]
    assert shown == [f"Trial {i} of 10, practice" for i in (1, 2)] + [
        f"Trial {i + 2} of 10, block {1 + (i > 4)}" for i in range(1, 9)
    ]
    right = sum(answer.correct for answer in kept[2:])
    assert log(tmp_path).rstrip().endswith(f"{right} of 8 right")


def test_subject_sees_no_stimulus_and_the_experimenter_does(tmp_path):
    design = SameDifferent(BONE, PVC, trials=4, interval=0.1, practice=1)
    seat = Paper(["right"] * 5)
    run(design, seat, tmp_path)
    seen, told = " ".join(seat.seen), log(tmp_path)
    for hidden in ("bone", "pvc", "AA", "AB", "BA", "BB", "right", "wrong", "2.145"):
        assert hidden not in seen.replace("the bone", "")
    for kind in ("AA", "AB", "BA", "BB"):
        assert f", {kind}: " in told
    assert "bone (c_e 2.145 N/mm^2, alpha 0.087 /ms), pvc (c_e 0.462 N/mm^2, alpha 0.256 /ms)" in told
    assert "in 1.25 s, right; 1 of 1 right" in told


def test_the_welcome_says_how_long_intervals_are(tmp_path):
    two, three = Paper(["right"] * 4), Paper(["right"] * 2)
    run(SameDifferent(BONE, PVC, trials=4, interval=0.1), two, tmp_path)
    assert "asked whether the material was the same in both. Each lasts 0.1 s; a beep" in two.seen[1]
    run(ABX(BONE, PVC, trials=2, interval=0.1), three, tmp_path)
    assert "They last as long as you like, 0.1 s and 0.1 s; a beep" in three.seen[1]


def test_feedback_in_practice_only(tmp_path):
    design = SameDifferent(BONE, PVC, trials=4, interval=0.1, practice=2)
    for feedback, due in ((True, ["Right.", "Right."]), (False, [])):
        seat = Paper(["right"] * 6)
        run(design, seat, tmp_path, feedback=feedback)
        assert [text for text in seat.seen if text in ("Right.", "Not right.")] == due


def test_each_interval_its_own_seed_bone_and_device(tmp_path):
    made, seeds = [], []

    def device(mode):
        made.append(hand(mode))
        return made[-1]

    def spy(interval, device, **options):
        seeds.append((interval.seed, id(device), options["mode"]))
        return render(interval, device, **options)

    design = SameDifferent(BONE, PVC, trials=4, interval=0.1, mode="drilling")
    run(design, Paper(["same"] * 4), tmp_path, device=device, render=spy)
    assert len({seed for seed, _, _ in seeds}) == len({one for _, one, _ in seeds}) == len(made) == 8
    assert {mode for _, _, mode in seeds} == {"drilling"}


def test_break_through_and_wall_are_kept_and_told(tmp_path):
    way = {
        "break-through": burrlab.ScriptedDevice([0, 0.5], [[0, 0, 3], [0, 0, -4]]),
        "wall": burrlab.ScriptedDevice([0, 0.1, 0.5], [[0, 0, 3], [0, 0, 2.5], [12, 0, 2.5]]),
    }
    design = SameDifferent(PVC, BONE, trials=4, interval=0.4, mode="drilling")
    for ending, device in way.items():
        seat, kept = Paper(["same"] * 4), []
        run(design, seat, tmp_path, kept=kept, device=lambda mode, d=device: d)
        assert {answer.endings for answer in kept} == {(ending, ending)}
        assert all(answer.duration < 0.8 for answer in kept)
        assert f"first interval of trial 1 ended by {ending} after 0." in log(tmp_path)
        assert ending not in " ".join(seat.seen)


def test_lost_device_is_not_asked(tmp_path):
    lost = itertools.count()

    def device(mode):
        if next(lost) < 5:
            return hand(mode)
        silent = burrlab.MailboxDevice(lost_after=50.0)
        silent.put((0, 0, 3.5))
        return silent

    design = SameDifferent(BONE, PVC, trials=4, interval=0.3)
    seat, kept = Paper(["same"] * 4), []
    seat.wall_clock = True
    order = design.order(seed=1, subject="01")
    with pytest.raises(DeviceLost, match=r"the device was lost during an interval: .*lost"):
        run(design, seat, tmp_path, order=order, kept=kept, device=device)
    assert len(kept) == len(order.answered) == 2
    assert "trial 3 was not asked: device lost" in log(tmp_path)
    # and goes on
    again = Paper(["same"] * 2)
    assert run(design, again, tmp_path, order=order, kept=kept) == 2
    assert "You go on where you stopped." in again.seen[1]
    assert [answer.trial for answer in kept] == list(order.trials)


def test_silent_device_is_lost_too(tmp_path):
    seat = Paper()
    seat.wall_clock = True
    design = SameDifferent(BONE, PVC, trials=4, interval=0.3)
    with pytest.raises(DeviceLost, match="it gives no position"):
        run(design, seat, tmp_path, device=lambda mode: burrlab.MailboxDevice())


@pytest.mark.parametrize("stalls", [1, 2])
def test_a_trial_in_which_the_loop_stalls_is_repeated_once(tmp_path, stalls):
    seeds = []

    def stalling(interval, device, **options):
        """In the second interval of the second trial, then maybe in its first."""
        seeds.append(interval.seed)
        failed, reason = 3 < len(seeds) <= 3 + stalls, "the loop stalled: 120 ms without a tick"
        return dataclasses.replace(render(interval, device, **options), failed=failed, reason=reason)

    seat, kept = Paper(["same"] * 4), []
    with pytest.raises(LoopStalled, match="120 ms") if stalls == 2 else contextlib.nullcontext():
        run(SameDifferent(BONE, PVC, trials=4, interval=0.1), seat, tmp_path, kept=kept, render=stalling)
    assert [answer.repeats for answer in kept] == ([0, 1, 0, 0] if stalls == 1 else [0])
    assert seeds[4] == seeds[2], "the same stimulus"
    assert " ".join(seat.seen).count("This one is repeated, from its beginning.") == 1
    assert not re.search("loop|device|burrlab", " ".join(seat.seen))
    assert (
        log(tmp_path).count("trial 2 was broken off during an interval: the loop stalled: 120 ms") == stalls
    )


@pytest.mark.parametrize(
    ("reference", "match", "length", "patience", "ending"),
    [
        (Stimulus("real Pettigrew"), PETTIGREW, None, 5, "subject"),
        (Stimulus("real"), BONE, 0.1, 1000, "time"),
        (PETTIGREW, None, None, 3, "subject"),
    ],
)
def test_a_reference_real_or_rendered_is_felt_to_its_end(
    tmp_path, reference, match, length, patience, ending
):
    task = ABX(
        reference, PVC, match=match, trials=2, interval=0.1, reference_interval=length, mode="drilling"
    )
    seat, kept = Paper(["first", "right"], patience=patience), []
    run(task, seat, tmp_path, kept=kept)
    assert {answer.endings for answer in kept} == {(ending, "time", "time")}
    shown, real = " ".join(seat.seen), reference.material is None
    assert ("Take the real specimen." in shown) is real
    assert ("Press the space bar when you have felt enough." in shown) is (length is None)
    assert (f"{reference.name} (real), " in log(tmp_path)) is real


def test_answer_is_kept_before_it_counts(tmp_path):
    design = SameDifferent(BONE, PVC, trials=4, interval=0.1)
    order = design.order(seed=1, subject="01")

    class Full(list):
        def append(self, answer):
            if len(self) == 1:
                raise OSError("disk full")
            super().append(answer)

    kept = Full()
    with pytest.raises(OSError, match="disk full"):
        run(design, Paper(["same"] * 4), tmp_path, order=order, kept=kept)
    assert len(order.answered) == len(kept) == 1


def test_traces(tmp_path):
    design = SameDifferent(BONE, PVC, trials=4, interval=0.1)
    order = design.order(seed=1, subject="01")
    run(
        design, Paper(["same"] * 4), tmp_path, order=order,
        trace=lambda trial, number: tmp_path / f"trial-{trial.number}_interval-{number}.h5",
    )  # fmt: skip
    assert len(list(tmp_path.glob("*.h5"))) == 8
    trace = burrlab.load_trace(tmp_path / "trial-2_interval-1.h5")
    assert trace.seed == order.trials[1].intervals[0].seed
    assert burrlab.replay(trace).equal


def test_wall_clock_goes_on_where_the_run_was(tmp_path):
    start = iter(100.0 + i for i in range(100))
    design = SameDifferent(BONE, PVC, trials=4, interval=0.1)
    kept = []
    clock = Clock(elapsed=lambda: next(start))
    run(design, Paper(["same"] * 4), tmp_path, kept=kept, clock=clock)
    assert [(a.onset, a.duration) for a in kept][:2] == [(100.0, 3.0), (104.0, 3.0)]


def test_many_late_ticks_are_told(tmp_path):
    late = iter([1, 2] + [0] * 6)

    def slow(interval, device, **options):
        found = render(interval, device, **options)
        ticks = found.ticks.copy()
        ticks["periods"][: next(late)] = 3
        return dataclasses.replace(found, ticks=ticks)

    run(SameDifferent(BONE, PVC, trials=4, interval=0.1), Paper(["same"] * 4), tmp_path, render=slow)
    (told,) = [line for line in log(tmp_path).splitlines() if "late" in line]
    assert told.endswith("interval 2 of trial 1 had 2 late ticks of 100")


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
