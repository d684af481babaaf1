"""The run of trials and tasks: texts, kept answers, messages to the experimenter, and lost devices."""

import contextlib
import itertools
import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import DEFAULT, Mock, call

import numpy as np
import pytest
from answer_scenes import protocol
from session_scenes import refused

import burrlab
from burrlab.psychophysics import (
    ABX,
    Protocol,
    SameDifferent,
    Stimulus,
    analyse,
    drilling_hand,
    probing_hand,
    read_answers,
    render,
)
from burrlab.psychophysics.run import DeviceLost, Experimenter, LoopStalled, Runner, Seat, Sitting

BURR = burrlab.Burr(3.0)
BONE, PVC, PETTIGREW = (Stimulus(name, burrlab.materials[name]) for name in ("bone", "pvc", "pettigrew"))
TEXT = """
[experiment]
name = "own"
seed = 1
subjects = 1
pause_s = 0.0
[burr]
radius_mm = 3.0
[bone]
size_mm = [16.0, 16.0, 4.0]
voxel_mm = 0.5
[tasks.one]
design = "same-different"
a = "bone"
b = "pvc"
trials = 4
interval_s = 0.1
"""


def paper(answers=(), patience=3, seconds=1.25, wall_clock=False):
    """A seat that records its calls and gives these answers; "right" stands for the correct one."""
    left = iter(answers)

    def ask(design, trial, rendered):
        answer = next(left)
        return (trial.correct if answer == "right" else answer), seconds

    done = itertools.cycle([False] * patience + [True])
    return Mock(
        spec=Seat, wall_clock=wall_clock, simulated=False, stand_in=partial(Seat.stand_in, None), ask=ask,
        done=lambda: next(done),
    )  # fmt: skip


def seen(seat):
    """All shown texts, in order."""
    return [one.args[0] for one in seat.method_calls]


def hand(mode):
    return probing_hand(BURR) if mode == "probing" else drilling_hand(BURR)


class Kept(list):
    """Stands for a file of answers."""

    end, path = 0.0, Path("one.tsv")

    def elapsed(self):
        return 0.0


def assert_whole(rows, order):
    """Asserts that rows of answers are those of all trials of a run."""
    trials = [(t.phase, t.number, tuple(interval.seed for interval in t.intervals)) for t in order.trials]
    assert [(row.phase, row.trial, row.seeds) for row in rows] == trials


class Scene:
    """Runs of the protocol with other designs, with the kept answers and the experimenter's log."""

    def __init__(self, folder, one: Protocol):
        self.folder, self.protocol, self.kept = folder, one, Kept()

    def run(self, design, seat, *, order=None, device=hand, feedback=False, **options):
        one = replace(self.protocol, tasks={"one": design}, feedback=feedback)
        order = design.order(seed=1, subject="01") if order is None else order
        with Experimenter(self.folder / "log.txt") as experimenter:
            return Runner(
                one, "one", order, self.kept, seat, experimenter, device, **options
            ).run()  # fmt: skip

    @property
    def log(self):
        return (self.folder / "log.txt").read_text()


@pytest.fixture
def scene(tmp_path):
    return Scene(tmp_path, protocol(tmp_path, TEXT))


FOUR = SameDifferent(BONE, PVC, trials=4, interval=0.1)


def test_whole_run(scene):
    design = SameDifferent(BONE, PVC, trials=8, interval=0.1, practice=2, blocks=2)
    seat, order = paper(itertools.cycle(["same", "different"])), design.order(seed=3, subject="01")
    assert scene.run(design, seat, order=order) == 10
    assert_whole(scene.kept, order)
    assert [answer.response for answer in scene.kept] == ["same", "different"] * 5
    assert {answer.endings for answer in scene.kept} == {("time", "time")}
    np.testing.assert_allclose([a.onset for a in scene.kept], 0.2 * np.arange(10), atol=1e-6)
    np.testing.assert_allclose([answer.duration for answer in scene.kept], 0.2)
    assert [one.args[1] for one in seat.rest.mock_calls] == [60.0]  # between the blocks, not after practice
    assert "That was practice. Now it counts." in seen(seat)
    assert [text for text in seen(seat) if text.startswith("Trial")] == [
        *(f"Trial {i} of 2, practice" for i in (1, 2)),
        *(f"Trial {i} of 8, block {1 + (i > 4)}" for i in range(1, 9)),
    ]
    right = sum(answer.correct for answer in scene.kept[2:])
    assert scene.log.rstrip().endswith(f"{right} of 8 right")


@pytest.mark.parametrize("feedback", [True, False])
def test_subject_sees_no_stimulus_and_the_experimenter_does(scene, feedback):
    seat = paper(["right"] * 6)
    scene.run(SameDifferent(BONE, PVC, trials=4, interval=0.1, practice=2), seat, feedback=feedback)
    feedbacks = [text for text in seen(seat) if text in ("Right.", "Not right.")]
    assert feedbacks == ["Right."] * 2 * feedback  # in practice only
    shown = " ".join(text for text in seen(seat) if text not in feedbacks)
    assert not re.search(r"\bbone|pvc|\b[AB]{2}\b|right|wrong|2\.145", shown.replace("the bone", ""))
    assert all(f", {kind}: " in scene.log for kind in ("AA", "AB", "BA", "BB"))
    assert "bone (c_e 2.145 N/mm^2, alpha 0.087 /ms), pvc (c_e 0.462 N/mm^2, alpha 0.256 /ms)" in scene.log
    assert "in 1.25 s, right; 1 of 1 right" in scene.log


@pytest.mark.parametrize(
    ("design", "told"),
    [
        (
            FOUR,
            "has two intervals. Each lasts 0.1 s; a beep tells its start and its end. Then you are asked: Was it the same",
        ),
        (ABX(BONE, PVC, trials=2, interval=0.1), "They last as long as you like, 0.1 s and 0.1 s; a beep"),
    ],
)
def test_the_welcome_says_how_long_intervals_are(scene, design, told):
    seat = paper(["right"] * 4)
    scene.run(design, seat)
    assert told in seen(seat)[1]


def test_the_protocol_sets_the_keys(scene):
    scene.protocol, seat = replace(scene.protocol, keys="fj"), paper(["same"] * 4)
    scene.run(FOUR, seat)
    assert (seat.keys, "keys: f for same or j for different." in " ".join(seen(seat))) == ("fj", True)
    levels = scene.protocol.side_car("01", "one").to_dict()["response"]["Levels"]
    assert levels == {"same": "key f", "different": "key j"}


def test_each_interval_its_own_seed_bone_and_device(scene):
    device, spy = Mock(side_effect=hand), Mock(side_effect=render)
    design = SameDifferent(BONE, PVC, trials=4, interval=0.1, mode="drilling")
    scene.run(design, paper(["same"] * 4), device=device, render=spy)
    felt = [(*one.args, one.kwargs["mode"]) for one in spy.call_args_list]
    assert len({interval.seed for interval, *_ in felt}) == len({id(device) for _, device, _ in felt}) == 8
    assert ({mode for *_, mode in felt}, device.call_count) == ({"drilling"}, 8)


@pytest.mark.parametrize(
    ("ending", "way"),
    [
        ("break-through", ([0, 0.5], [[0, 0, 3], [0, 0, -4]])),
        ("wall", ([0, 0.1, 0.5], [[0, 0, 3], [0, 0, 2.5], [12, 0, 2.5]])),
    ],
)
def test_break_through_and_wall_are_kept_and_told(scene, ending, way):
    design = SameDifferent(PVC, BONE, trials=4, interval=0.4, mode="drilling")
    seat, device = paper(["same"] * 4), burrlab.ScriptedDevice(*way)
    scene.run(design, seat, device=lambda mode: device)
    assert {answer.endings for answer in scene.kept} == {(ending, ending)}
    assert all(answer.duration < 0.8 for answer in scene.kept)
    assert f"first interval of trial 1 ended by {ending} after 0." in scene.log
    assert ending not in " ".join(seen(seat))


def test_lost_device_is_not_asked(scene):
    lost = itertools.count()

    def device(mode):
        if next(lost) < 5:
            return hand(mode)
        silent = burrlab.MailboxDevice(lost_after=50.0)
        silent.put((0, 0, 3.5))
        return silent

    seat, again = paper(["same"] * 4, wall_clock=True), paper(["same"] * 2)
    order = FOUR.order(seed=1, subject="01")
    refused(
        (
            lambda: scene.run(FOUR, seat, order=order, device=device),
            r"the device was lost during an interval: .*lost",
        ),
        (
            lambda: scene.run(FOUR, paper(wall_clock=True), device=lambda mode: burrlab.MailboxDevice()),
            "it gives no position",
        ),
        error=DeviceLost,
    )
    assert len(scene.kept) == len(order.answered) == 2
    assert "trial 3 was not asked: device lost" in scene.log
    assert scene.run(FOUR, again, order=order) == 2
    assert "You go on where you stopped." in seen(again)[1]
    assert_whole(scene.kept, order)


@pytest.mark.parametrize("stalls", [1, 2])
def test_a_trial_in_which_the_loop_stalls_is_repeated_once(scene, stalls):
    seeds = []

    def stalling(interval, device, **options):
        """Stalls in the second interval of the second trial, then perhaps in the repeat's first."""
        seeds.append(interval.seed)
        failed, reason = 3 < len(seeds) <= 3 + stalls, "the loop stalled: 120 ms without a tick"
        return replace(render(interval, device, **options), failed=failed, reason=reason)

    seat = paper(["same"] * 4)
    with pytest.raises(LoopStalled, match="120 ms") if stalls == 2 else contextlib.nullcontext():
        scene.run(FOUR, seat, render=stalling)
    assert [answer.repeats for answer in scene.kept] == ([0, 1, 0, 0] if stalls == 1 else [0])
    assert seeds[4] == seeds[2], "the same stimulus"
    shown = " ".join(seen(seat))
    assert shown.count("This one is repeated, from its beginning.") == 1
    assert not re.search("loop|device|burrlab", shown)
    assert scene.log.count("trial 2 was broken off during an interval: the loop stalled: 120 ms") == stalls


@pytest.mark.parametrize(
    ("reference", "match", "length", "patience", "ending"),
    [
        (Stimulus("real Pettigrew"), PETTIGREW, None, 5, "subject"),
        (Stimulus("real"), BONE, 0.1, 1000, "time"),
        (PETTIGREW, None, None, 3, "subject"),
    ],
)
def test_a_reference_real_or_rendered_is_felt_to_its_end(scene, reference, match, length, patience, ending):
    task = ABX(
        reference, PVC, match=match, trials=2, interval=0.1, reference_interval=length, mode="drilling"
    )
    seat, real = paper(["first", "right"], patience=patience), reference.material is None
    scene.run(task, seat)
    assert {answer.endings for answer in scene.kept} == {(ending, "time", "time")}
    shown = " ".join(seen(seat))
    assert ("Take the real specimen." in shown, f"{reference.name} (real), " in scene.log) == (real, real)
    assert ("Press the space bar when you have felt enough." in shown) is (length is None)


def test_answer_is_kept_before_it_counts(scene):
    order, kept = FOUR.order(seed=1, subject="01"), scene.kept
    kept.append = Mock(wraps=kept.append, side_effect=[DEFAULT, OSError("disk full")])
    refused((lambda: scene.run(FOUR, paper(["same"] * 4), order=order), "disk full"), error=OSError)
    assert len(order.answered) == len(scene.kept) == 1


def test_wall_clock_goes_on_where_the_run_was_and_many_late_ticks_are_told(scene):
    late, start = iter([1, 2] + [0] * 6), iter(100.0 + i for i in range(100))

    def slow(interval, device, **options):
        found = render(interval, device, **options | {"wall_clock": False})
        ticks = found.ticks.copy()
        ticks["periods"][: next(late)] = 3
        return replace(found, ticks=ticks)

    scene.kept.elapsed = lambda: next(start)
    scene.run(FOUR, paper(["same"] * 4, wall_clock=True), render=slow)
    assert [(a.onset, a.duration) for a in scene.kept][:2] == [(100.0, 3.0), (104.0, 3.0)]
    (told,) = [line for line in scene.log.splitlines() if "late" in line]
    assert told.endswith("interval 2 of trial 1 had 2 late ticks of 100")


def test_a_device_of_ones_own_renders_every_interval_and_is_named(scene):
    made = scene.protocol
    rig = Mock(side_effect=lambda mode: burrlab.ScriptedDevice([0, 1], [[0, 0, 2.5]] * 2))
    assert Sitting(made, "01", device=rig).run(lambda task: paper(["same"] * 4)) == 4
    assert (
        rig.mock_calls == [call("probing")] * 16
    )  # two per interval: one until the burr is lifted, one for the interval
    path = made.data.answers("01", "one")
    assert read_answers(path).counts().trials == 4
    assert json.loads(path.with_suffix(".json").read_text())["Device"] == "driver"
    told = r"interval 2 of trial 4 began in contact, at \d\.\d\d N"
    assert re.search(told, made.data.log("01", "one").read_text())


def test_what_limits_clip_is_a_column(scene, tmp_path):
    """A still burr, 1 mm deep in bone and PVC: the model's force in bone is above 3.3 N."""
    (tmp_path / "limits.toml").write_text(
        TEXT.replace("seed = 1", 'seed = 1\nlimits = "touch"\nfolder = "limited"')
    )
    made = Protocol.read(tmp_path / "limits.toml")
    still = burrlab.ScriptedDevice([0, 1], [[0, 0, 2.0]] * 2)
    Sitting(made, "01", device=lambda mode: still).run(lambda task: paper(["same"] * 4))
    rows = read_answers(made.data.answers("01", "one")).rows
    shares = {name: share for row in rows for name, share in zip(row.stimuli, row.clipped, strict=True)}
    assert 0.9 < shares["bone"] <= 1 > shares["pvc"]
    assert made.to_dict()["experiment"]["limits"] == "touch"
    assert "limits" not in scene.protocol.to_dict()["experiment"]
    assert "clipped_1" in json.loads(made.data.answers("01", "one").with_suffix(".json").read_text())


def test_load_and_repeats_are_told_to_the_experimenter(scene, monkeypatch):
    made, calls = scene.protocol, itertools.count()

    def loaded(*given, **options):
        """Late ticks in the trial run, and a stall in the second interval."""
        found, call = render(*given, **options), next(calls)
        ticks = found.ticks.copy()
        ticks["periods"] = 1 + (call == 0)
        return replace(found, ticks=ticks, failed=call == 2, reason="the loop stalled: 101 ms")

    monkeypatch.setattr("burrlab.psychophysics.run.render", loaded)
    assert Sitting(made, "01", again="COMMAND").run(lambda task: paper(["same"] * 4)) == 4
    told = made.data.log("01", "one").read_text()
    load = r"THE MACHINE HAS TOO MUCH TO DO: before the first trial (\d+) of \1 ticks were late"
    assert re.search(load, told)
    assert "trials repeated as the loop had stalled: 1" in told
    assert [row.repeats for row in read_answers(made.data.answers("01", "one")).rows] == [1, 0, 0, 0]
    assert "Trials that were repeated, as the loop had stalled: 1 of 01 of one." in analyse(made).report()


@pytest.mark.parametrize(("seconds", "said"), [(0.05, True), (0.6, False)])
def test_answers_that_come_too_fast_are_flagged(scene, seconds, said):
    scene.run(FOUR, paper(itertools.cycle(["same"]), seconds=seconds))
    assert ("too fast to have judged" in scene.log) is said
