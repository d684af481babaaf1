"""Up-down staircases: rules, targets, ends, and the same trials from the same answers."""

from __future__ import annotations

import json
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from burrlab import materials
from burrlab.psychophysics.staircase import Staircase, gaussian_correct, gaussian_difference
from burrlab.psychophysics.trial import Stimulus

BONE = Stimulus("bone", materials["bone"])
Z = 4.9  # of a two-sided false-alarm rate of 1e-6


def staircase(parameter="c_e", **options):
    return Staircase(BONE, parameter, **options)


def run(order, answers):
    """Answers (right or wrong) in turn; the trials."""
    trials = []
    for right in answers:
        trial = order.next()
        if trial is None:
            break
        trials.append(trial)
        order.answer(trial.correct if right else next(a for a in ("first", "second") if a != trial.correct))
    return trials


@pytest.mark.parametrize(
    ("options", "target"),
    [
        ({"down": 2}, math.sqrt(0.5)),
        ({"down": 3}, 0.5 ** (1 / 3)),
        ({"down": 4}, 0.5**0.25),
        ({"down": 1, "up_weight": 3.0}, 0.75),
        ({"down": 2, "up_weight": 2.0}, math.sqrt(2 / 3)),
    ],
)
def test_targets(options, target):
    """Levitt 1971, table I: 0.707, 0.794, 0.841; Kaernbach 1991: step up over step down = p/(1 - p)."""
    design = staircase(**options)
    assert design.target == pytest.approx(target, rel=1e-12)
    # no drift at the target: the chance of a step down times its size is that of a step up times its
    right = design.target**design.down
    assert right * 1.0 == pytest.approx((1 - right) * design.up_weight)


def test_two_down_one_up_by_hand():
    design = staircase(start=2.0, discard=1, coarse_step=2.0, step=math.sqrt(2), reversals=2)
    d = math.log(2.0)
    #          level d   d    d/2  d/2   d/4  d/2 (wrong: first reversal, step small from now on)
    answers = [True, True, True, True, False, True, True, False, False]
    trials = run(design.order(seed=1, subject="01"), answers)
    up = d / 4 * math.sqrt(2)
    expected = [d, d, d / 2, d / 2, d / 4, up, up, d / 4]
    assert [math.log(t.level) for t in trials] == pytest.approx(expected)
    found = design.threshold([t.level for t in trials], answers[: len(trials)])
    # the reversals that count: down at up, up at d/4
    assert found.complete
    assert (found.reversals, found.trials, found.spread) == (2, 8, None)
    assert found.difference == pytest.approx(math.sqrt(up * d / 4))
    assert found.level == pytest.approx(math.exp(found.difference))


def test_weighted_steps_by_hand():
    design = staircase(down=1, up_weight=3.0, discard=0, step=1.1, start=1.5)
    trials = run(design.order(seed=1, subject="01"), [True, False, True])
    d = math.log(1.5)
    assert [math.log(t.level) for t in trials] == pytest.approx([d, d / 1.1, d * 1.1**2])


def test_below_one_mirrors_above():
    answers = [True, True, True, False, True, False, False, True]
    above = run(staircase(start=2.0).order(seed=1, subject="01"), answers)
    below = run(staircase(start=0.5).order(seed=1, subject="01"), answers)
    assert [t.level for t in below] == pytest.approx([1 / t.level for t in above])
    found = staircase(start=0.5, discard=0).threshold(
        [0.5, 0.5, 0.5 ** (1 / math.sqrt(2))], [True, True, False]
    )
    assert found.level is None
    assert "no threshold: 1 reversals that count in 3 trials, two are needed" in str(found)
    assert not found.complete


def test_the_limit_holds_and_is_said():
    design = staircase(start=2.0, limit=3.0, trials=20)
    trials = run(design.order(seed=1, subject="01"), [False] * 30)
    assert len(trials) == 20
    assert max(t.level for t in trials) == pytest.approx(3.0)
    assert design.threshold([t.level for t in trials], [False] * 20).at_limit == 19
    mixed = [False, False, True, True, False, True, True, False, True, True]
    levels = [t.level for t in run(design.order(seed=1, subject="01"), mixed)]
    assert "at the limit, so the threshold is too small" in str(
        design.threshold(levels, mixed[: len(levels)])
    )


def test_a_perfect_subject_never_reaches_one():
    trials = run(staircase(down=1, up_weight=3.0, trials=60).order(seed=1, subject="01"), [True] * 60)
    assert len(trials) == 60
    assert min(t.level for t in trials) == pytest.approx(math.exp(1e-4))


@given(seed=st.integers(0, 2**64), answers=st.lists(st.booleans(), min_size=0, max_size=90))
def test_the_same_answers_give_the_same_trials(seed, answers):
    design = staircase(practice=3, reversals=6, trials=40, blocks=2)
    first, second = (run(design.order(seed=seed, subject="01"), answers) for _ in range(2))
    assert first == second
    assert len(first) <= 43 == design.order(seed=seed, subject="01").total
    assert [t.level for t in first[:3]] == [2.0] * len(first[:3])
    assert [t.block for t in first[3:]] == [1 + i // 20 for i in range(len(first[3:]))]


@given(seed=st.integers(0, 2**64))
def test_orders_and_seeds_do_not_depend_on_the_answers(seed):
    design = staircase(reversals=20, trials=40)
    right = run(design.order(seed=seed, subject="01"), [True] * 40)
    mixed = run(design.order(seed=seed, subject="01"), [True, False, False] * 14)
    n = min(len(right), len(mixed))
    assert [t.trial_type for t in right[:n]] == [t.trial_type for t in mixed[:n]]
    assert [[i.seed for i in t.intervals] for t in right[:n]] == [
        [i.seed for i in t.intervals] for t in mixed[:n]
    ]
    for start in range(0, 40, 8):
        assert Counter(t.trial_type for t in right[start : start + 8]) == {"RC": 4, "CR": 4}
    seeds = [i.seed for t in right for i in t.intervals]
    assert len(set(seeds)) == len(seeds)


def test_more_c_e_sinks_more_slowly():
    for trial in run(staircase(mode="drilling").order(seed=1, subject="01"), [True] * 20):
        assert trial.correct == ("first" if trial.trial_type == "RC" else "second")
    for trial in run(staircase("alpha", mode="drilling").order(seed=1, subject="01"), [True] * 20):
        assert trial.correct == ("second" if trial.trial_type == "RC" else "first")


@pytest.mark.parametrize(
    "options", [{"down": 2}, {"down": 3}, {"down": 1, "up_weight": 3.0}], ids=["2-down", "3-down", "weighted"]
)
def test_steps_balance_as_the_target_says(options):
    """Steps down are w/(1 + w) of all steps in the long run, however large: the track is bounded.

    Over n steps the count differs from it by at most the range of the track over the sizes of the steps: no chance in it.
    """
    design = staircase(**options, coarse_step=1.2, step=1.2, discard=0, reversals=100_000, trials=60_000)
    draws, track = np.random.default_rng(1), design.track()
    down = steps = 0
    before = math.log(track.level())
    while (level := track.level()) is not None:
        difference = math.log(level)
        if difference != before:
            steps += 1
            down += difference < before
        before = difference
        track.update(draws.random() < gaussian_correct(difference, 0.15))
    weight = design.up_weight
    assert track.threshold().at_limit == 0
    reach = math.log(10_000) / math.log(1.2)
    assert abs(down - steps * weight / (1 + weight)) < reach


@pytest.mark.parametrize(
    "options", [{"down": 2}, {"down": 3}, {"down": 1, "up_weight": 3.0}], ids=["2-down", "3-down", "weighted"]
)
def test_staircases_converge_to_their_target(options):
    """The mean of ln difference over 300 long runs is within 0.05 of the target's, beside its error at 1e-6."""
    design = staircase(**options, start=1.3, coarse_step=1.5, step=1.1, discard=30, reversals=60, trials=3000)
    draws = np.random.default_rng(2)
    sought = gaussian_difference(design.target, 0.15)
    found = []
    for _ in range(300):
        track = design.track()
        while (level := track.level()) is not None:
            track.update(draws.random() < gaussian_correct(math.log(level), 0.15))
        found.append(math.log(track.threshold().difference / sought))
    error = np.std(found, ddof=1) / math.sqrt(len(found))
    assert error < 0.02
    assert abs(np.mean(found)) < 0.05 + Z * error


def test_answers_of_another_staircase_are_refused():
    with pytest.raises(
        ValueError, match=r"levels must be those of this staircase, got 1.5 in trial 2 where it has 2$"
    ):
        staircase().threshold([2.0, 1.5], [True, True])
    with pytest.raises(ValueError, match=r"got 2 in trial 3 where it has an end"):
        staircase(trials=2).threshold([2.0, 2.0, 2.0], [True, False, True])
    with pytest.raises(ValueError, match=r"levels and correct must be equally many, got 2 and 1"):
        staircase().threshold([2.0, 2.0], [True])


def test_answers_are_from_the_set():
    order = staircase(trials=1).order(seed=1, subject="01")
    with pytest.raises(ValueError, match=r"response must be one of first, second, got 'same'"):
        order.answer("same")
    order.answer("first")
    assert order.next() is None
    with pytest.raises(ValueError, match=r"there is no trial left"):
        order.answer("first")


def test_written_and_said():
    design = staircase()
    written = json.loads(json.dumps(design.to_dict()))
    assert written["design"] == "staircase"
    assert (written["start"], written["limit"], written["target"]) == (2.0, 4.0, math.sqrt(0.5))
    answers = [True, True, True, True, False, True, True, False] * 10
    trials = run(design.order(seed=1, subject="01"), answers)
    found = design.threshold([t.level for t in trials], answers[: len(trials)])
    assert str(found).startswith("70.7 % correct at a ratio of ")
    assert json.loads(json.dumps(found.to_dict()))["reversals"] == 8
    assert "aims at 70.7 % correct, at most 80 trials" in design.power(2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": 1.0}, r"start must differ from 1, got 1"),
        ({"start": -2.0}, r"start must be a ratio above 0, got -2.0"),
        ({"limit": 1.5}, r"limit must be as far from 1 as start, 2, or farther, got 1.5"),
        ({"limit": 0.2}, r"limit must be as far from 1 as start, 2, or farther, got 0.2"),
        ({"step": 1.0}, r"step must be a factor above 1, got 1.0"),
        ({"coarse_step": float("inf")}, r"coarse_step must be a factor above 1, got inf"),
        ({"up_weight": 0.0}, r"up_weight must be above 0, got 0.0"),
        ({"down": 0}, r"down must be at least 1, got 0"),
        ({"down": 1}, r"down and up_weight must aim above chance, 0.5, got 1 and 1, which aim at 0.5"),
        ({"discard": -1}, r"discard must be at least 0, got -1"),
        ({"reversals": 5}, r"reversals must be a multiple of 2 \(peaks and valleys in pairs\), got 5"),
        ({"trials": 0}, r"trials must be at least 1, got 0"),
        ({"blocks": 3}, r"trials must be a multiple of 3, the number of blocks, got 80"),
        ({"parameter": "alpha"}, r"alpha alone changes nothing with the burr off"),
    ],
)  # fmt: skip
def test_wrong_values_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        Staircase(**{"reference": BONE, "parameter": "c_e", **change})


def test_wrong_types_are_named():
    with pytest.raises(TypeError, match=r"reference must be a Stimulus"):
        Staircase(materials["bone"], "c_e")
    with pytest.raises(TypeError, match="float"):
        staircase(trials=20.5)


def test_a_step_beyond_all_numbers_goes_to_the_limit() -> None:
    design = Staircase(
        Stimulus("bone", materials["bone"]), "c_e", step=1e308, up_weight=2.0, discard=0, limit=8.0
    )
    order = design.order(seed=1, subject="01")
    for _ in range(3):
        trial = order.next()
        assert trial is not None
        order.answer(next(answer for answer in design.answers if answer != trial.correct))
    trial = order.next()
    assert trial is not None
    assert trial.level == pytest.approx(8.0)
