"""A boundary between two bones: which interval has it, what renders it, and trials that never came to it."""

import itertools
import json
import math
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest
from answer_scenes import SMALL, give, protocol, sat
from session_scenes import refused

from burrlab import Burr, load_trace, materials, replay
from burrlab.psychophysics import (
    AdaptiveStaircase,
    Block,
    ConstantStimuli,
    SimulatedSubject,
    Staircase,
    Stimulus,
    analyse,
    drilling_hand,
    read_answers,
    read_folder,
    rehearse,
    rehearsed_order,
    render,
    trial_rows,
)
from burrlab.psychophysics.staircase import design_of_dict
from burrlab.session.network import make_bone

BURR, BONE = Burr(3.0), Block((20, 20, 8), 0.2)
REFERENCE = Stimulus("bone", materials["bone"])
TEXT = (
    SMALL.partition("[tasks")[0]
    + """
[tasks.harder]
design = "staircase"
reference = "bone"
parameter = "c_e"
mode = "drilling"
trials = 12
catch = 2
boundary_mm = [0.2, 0.6]
"""
)


def design(kind=ConstantStimuli, *args, boundary=(0.3, 0.6), **options):
    return kind(REFERENCE, "c_e", *args, mode="drilling", boundary=boundary, **options)


def trials(one):
    """Those of a run that is answered right."""
    return give(Mock(), one.order(seed=1, subject="01"), right=lambda trial: True)


def test_the_comparison_has_it_at_a_depth_of_its_own():
    found = trials(design(ConstantStimuli, [0.5, 2.0], repeats=40))
    by_place = [{x: i for x, i in zip(trial.trial_type, trial.intervals, strict=True)} for trial in found]
    assert all(trial.correct == ("first", "second")[trial.trial_type.index("C")] for trial in found)
    assert all(places["R"].boundary is None for places in by_place)
    depths = [places["C"].boundary.depth for places in by_place]
    assert len(set(depths)) > 70
    assert (0.3 <= min(depths) < 0.32, 0.58 < max(depths) <= 0.6) == (True, True)
    assert all(places["C"].stimulus.material == REFERENCE.material for places in by_place)
    below = {t.level: places["C"].boundary.below.c_e for t, places in zip(found, by_place, strict=True)}
    assert below == pytest.approx({0.5: 1.0725, 2.0: 4.29})
    for level in (0.5, 2.0):  # the foil is either side's bone, at random
        foils = [p["R"].stimulus.name for p, t in zip(by_place, found, strict=True) if t.level == level]
        assert 10 < foils.count("bone") < 30
        assert set(foils) == {"bone", f"bone c_e x{level:g}"}
    # A stored order: later versions must resume a run of this one.
    assert [(t.trial_type, t.level, x["C"].boundary.depth, x["C"].seed) for t, x in zip(found[:2], by_place[:2], strict=True)] == STORED  # fmt: skip


STORED = [("CR", 0.5, 0.4893, 11221597902570653599), ("CR", 2.0, 0.4797, 3373659820945970682)]


@pytest.mark.parametrize("parameter", ["c_e", "alpha"])
def test_the_bone_between_takes_the_mean_time(parameter):
    one = replace(design(ConstantStimuli, [1.5], foil="middle"), parameter=parameter)
    (middle,) = {t.intervals[t.trial_type.index("R")].stimulus.material for t in trials(one)}
    sides = [materials["bone"], one.comparison(1.5).material]
    assert middle.c_e == pytest.approx(math.sqrt(sides[0].c_e * sides[1].c_e))
    slowness = [side.c_e ** (8 / 3) / side.alpha for side in (*sides, middle)]
    assert slowness[2] == pytest.approx(0.5 * (slowness[0] + slowness[1]))


@pytest.mark.parametrize("kind", [ConstantStimuli, Staircase, AdaptiveStaircase])
def test_designs_come_back_and_those_without_are_what_they_were(kind):
    args = ([1.5],) * (kind is ConstantStimuli)
    for one in (design(kind, *args), design(kind, *args, foil="middle")):
        assert design_of_dict(json.loads(json.dumps(one.to_dict()))).to_dict() == one.to_dict()
        assert one.question == "In which interval did the bone change on the way, the first or the second?"
    assert not {"boundary_mm", "foil"} & design(kind, *args, boundary=None).to_dict().keys()


def test_refusals(tmp_path):
    def in_file(old, new):
        return lambda: protocol(tmp_path, TEXT.replace(old, new))

    refused(
        (lambda: design(Staircase, boundary=(0.6, 0.3)), "boundary must be two depths above 0"),
        (lambda: design(Staircase, boundary=(0.0, 0.3)), "boundary must be two depths above 0"),
        (lambda: design(Staircase, boundary=None, foil="middle"), "foil goes with boundary"),
        (lambda: design(Staircase, foil="none"), "foil must be one of either, middle, got 'none'"),
        (
            lambda: replace(design(Staircase), mode="probing"),
            "boundary goes with mode 'drilling', got 'probing'",
        ),
        (in_file("[0.2, 0.6]", "[0.2]"), r"\[tasks.harder\]: boundary_mm must be two depths above 0"),
        (in_file("0.6]", "6]"), "boundary_mm of task harder must lie in the bone, 6 mm deep"),
    )


def felt(interval, **options):
    hand = drilling_hand(BURR)
    return render(interval, hand, burr=BURR, bone=BONE, mode="drilling", wall_clock=False, **options)


def test_it_is_rendered_recorded_and_replayed(tmp_path):
    """Below the reach of the burr, or of the same bone, a boundary changes nothing; else only what is below it."""
    (trial,) = trials(design(Staircase, trials=1, interval=5.0, boundary=(0.3, 0.3)))
    interval = trial.intervals[trial.trial_type.index("C")]
    plain = felt(replace(interval, boundary=None))
    assert plain.reached
    for other in (
        replace(interval.boundary, depth=7.0),
        replace(interval.boundary, below=REFERENCE.material),
    ):
        same = felt(replace(interval, boundary=other))
        assert same.immersion == pytest.approx(plain.immersion, abs=1e-4)  # tables of tissues round
        assert same.reached == (other.depth < plain.immersion.max())
    hard = felt(interval, record=tmp_path / "x.h5")
    first = int(np.argmax(np.abs(hard.immersion - plain.immersion) > 1e-3))
    assert 0.0 < hard.immersion[first] - interval.boundary.depth < 0.2  # a voxel
    assert hard.immersion.max() < plain.immersion.max()
    assert hard.pressed == pytest.approx(plain.pressed, rel=0.02)
    trace = load_trace(tmp_path / "x.h5")
    assert replay(trace).equal
    assert make_bone(json.loads(trace.source)).digest() == trace.bone().digest()


def test_trials_that_never_came_to_it_are_lost_and_counted(tmp_path):
    """They move no staircase, neither in the run nor when it is resumed; they are out of the analysis."""
    made = protocol(tmp_path, TEXT)

    answered = partial(
        give, right=lambda trial: True,
        change=lambda row, place: replace(row, reached=place % 3 != 1, forces=(0.2, 0.4)),
    )  # fmt: skip
    with sat(made.begin("01", "harder")) as (file, order):
        answered(file, order, 5)
    levels = [trial.level for trial, _ in order.answered if trial.phase == "main"]
    lines = [line.split("\t") for line in file.path.read_text().splitlines()]
    place, whole = lines[0].index("reached"), file.path.read_text()
    file.path.write_text("".join("\t".join(line[:place] + line[place + 1 :]) + "\n" for line in lines))
    refused((lambda: made.resume("01", "harder"), f"column {place + 1} was 'reached'"))
    file.path.write_text(whole)
    with sat(made.resume("01", "harder")) as (file, order):
        assert [trial.level for trial, _ in order.answered if trial.phase == "main"] == levels
        answered(file, order)
    rows = read_answers(file.path).rows
    assert (len(rows), sum(row.lost for row in rows)) == (14, 5)
    analysis = analyse(made)
    (subject,) = analysis["harder"].subjects
    kept = [row for row in rows if row.phase == "main" and not row.lost]
    assert (subject.trials, subject.complete, subject.pressed) == (len(kept), True, pytest.approx(0.3))
    assert sum(n for *_, n in subject.levels) == len(kept)
    assert "Trials left out, as the burr did not come to the boundary: 5 of 01 of harder." in analysis.notes
    table = trial_rows(read_folder(made.folder))
    assert [row["reached"] for row in table] == [int(not row.lost) for row in rows]
    assert {row["reference"] for row in table} == {materials["bone"].c_e}
    assert (table[0]["subject"], table[0]["boundary_mm"], table[0]["force_2_N"]) == (
        "01",
        rows[0].boundary,
        0.4,
    )


def test_a_subject_who_feels_change_finds_it():
    one = design(ConstantStimuli, [0.5], repeats=12, boundary=(0.2, 0.4), interval=10.0)
    sure = SimulatedSubject(weber=0.02, cues=["change"], lapse=0.0)
    (counts,) = rehearse(one, sure, subjects=1, seed=1, burr=BURR, bone=BONE)
    assert counts.score >= 0.9 * counts.trials
    deep = replace(one, boundary=(5.0, 6.0), levels=[0.5])
    order = rehearsed_order(deep, sure, seed=1, burr=BURR, bone=BONE)
    assert (len(order.lost), order.counted()) == (12, [])


@pytest.mark.slow
def test_what_is_left_to_judge_by():
    """How often a subject without noise is right by the change of speed, and by the depth reached alone."""
    for foil, level in itertools.product(("either", "middle"), (0.5, 0.8, 1.25, 2.0)):
        one = design(ConstantStimuli, [level], repeats=40, boundary=(0.2, 0.4), interval=10.0, foil=foil)
        right = {}
        for cue in ("change", "sinking"):
            sure = SimulatedSubject(weber=1e-9, cues=[cue], lapse=0.0)
            order = rehearsed_order(one, sure, seed=1, burr=BURR, bone=BONE)
            share = sum(response == trial.correct for trial, response in order.counted()) / len(
                order.counted()
            )
            right[cue] = share if cue == "change" else max(share, 1.0 - share)
        print(
            f"foil {foil}, level {level:g}: right by change {right['change']:.0%}, by depth {right['sinking']:.0%}"
        )
        assert right["change"] > 0.9
        assert foil == "middle" or right["sinking"] < 0.75
