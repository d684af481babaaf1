"""Designs: trials balanced, orders a function of seed and subject alone, staircases that end and find the threshold."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections import Counter
from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, chi2

from burrlab import materials
from burrlab._core import Burr, Material
from burrlab.psychophysics.designs import (
    ABX,
    Draws,
    FixedOrder,
    SameDifferent,
    counterbalanced,
)
from burrlab.psychophysics.psychometric import ThresholdPosterior, posterior_threshold, proportion_correct
from burrlab.psychophysics.staircase import (
    AdaptiveStaircase,
    ConstantStimuli,
    Staircase,
    gaussian_correct,
    gaussian_difference,
)
from burrlab.psychophysics.trial import Stimulus
from burrlab.theory.continuum import mean_field_descent

BONE, PETTIGREW, PVC = (Stimulus(name, materials[name]) for name in ("bone", "pettigrew", "pvc"))
PAIRS = {"AA", "AB", "BA", "BB"}


def kinds(trials):
    return [trial.trial_type for trial in trials]


@given(
    seed=st.integers(0, 2**64),
    subject=st.text(min_size=1, max_size=5),
    quarter=st.integers(1, 8),
    practice=st.integers(0, 9),
    blocks=st.integers(1, 6),
)
def test_the_four_pairs_are_equal_to_the_trial(seed, subject, quarter, practice, blocks):
    trials = 4 * quarter * blocks
    design = SameDifferent(BONE, PVC, trials=trials, practice=practice, blocks=blocks)
    order = design.order(seed=seed, subject=subject)
    assert order.total == trials + practice == len(order.trials)
    main = [trial for trial in order.trials if trial.phase == "main"]
    assert Counter(kinds(main)) == dict.fromkeys(PAIRS, trials // 4)
    for block in range(1, blocks + 1):
        assert set(Counter(kinds(t for t in main if t.block == block)).values()) == {quarter}
    first = order.trials[:practice]
    assert all(trial.phase == "practice" and trial.block == 0 for trial in first)
    numbers = [Counter(kinds(first))[pair] for pair in PAIRS]
    assert max(numbers) - min(numbers) <= 1
    assert [trial.number for trial in order.trials] == [*range(1, practice + 1), *range(1, trials + 1)]


def test_blocks_that_four_does_not_divide():
    order = SameDifferent(BONE, PVC, blocks=2).order(seed=1, subject="01")
    assert Counter(kinds(order.trials)) == dict.fromkeys(PAIRS, 3)
    for block in (1, 2):
        numbers = Counter(kinds(trial for trial in order.trials if trial.block == block))
        assert set(numbers.values()) <= {1, 2}
        assert numbers["AA"] + numbers["BB"] == 3


def test_a_trial_is_what_its_type_says():
    order = SameDifferent(BONE, PVC, interval=5.0, trials=40, practice=4).order(seed=3, subject="01")
    for trial in order.trials:
        shown = [interval.stimulus for interval in trial.intervals]
        assert shown == [{"A": BONE, "B": PVC}[letter] for letter in trial.trial_type]
        assert trial.correct == ("same" if shown[0] == shown[1] else "different")
        assert [interval.duration for interval in trial.intervals] == [5.0, 5.0]
        assert trial.level is None
    seeds = [interval.seed for trial in order.trials for interval in trial.intervals]
    assert len(set(seeds)) == 88
    assert all(0 <= seed < 2**64 for seed in seeds)


def test_the_same_again_and_another_subject_another_order():
    design = SameDifferent(BONE, PVC)
    first = design.order(seed=1, subject="01").trials
    assert design.order(seed=1, subject="01").trials == first
    assert SameDifferent(BONE, PVC).order(seed=1, subject="01").trials == first
    others = [
        design.order(seed=2, subject="01").trials,
        design.order(seed=1, subject="02").trials,
        SameDifferent(BONE, PVC, mode="drilling").order(seed=1, subject="01").trials,
    ]
    for trials in others:
        assert kinds(trials) != kinds(first)
        assert trials[0].intervals[0].seed != first[0].intervals[0].seed


def test_pairs_of_neighbours_are_as_random_as_a_shuffle():
    """P(the second trial's type is the first's) = 2/11 with three of each: 20 000 subjects, false-alarm rate 1e-6."""
    design = SameDifferent(BONE, PVC)
    n = 20_000
    again = sum(
        kinds(design.order(seed=5, subject=str(i)).trials[:2]) in ([pair] * 2 for pair in PAIRS)
        for i in range(n)
    )
    p = 2 / 11
    assert abs(again - n * p) < 4.9 * (n * p * (1 - p)) ** 0.5


def test_a_design_is_written_whole():
    design = SameDifferent(BONE, PVC, trials=8, interval=2, mode="drilling", practice=1, blocks=2)
    assert json.loads(json.dumps(design.to_dict())) == {
        "design": "same-different",
        "a": {
            "name": "bone",
            "material": "bone",
            "c_e_N_per_mm2": 2.145,
            "alpha_per_ms": 0.087,
            "shape": "parabolic",
        },
        "b": {
            "name": "pvc",
            "material": "pvc",
            "c_e_N_per_mm2": 0.462,
            "alpha_per_ms": 0.256,
            "shape": "parabolic",
        },
        "trials": 8,
        "interval_s": 2.0,
        "mode": "drilling",
        "practice": 1,
        "blocks": 2,
    }
    said = SameDifferent(BONE, PVC).power(20)
    assert said.startswith("bone or pvc in two intervals of 20 s (probing), chance 0.5")
    assert "same-different, 12 trials, 20 subjects" in said
    assert (design.task, design.answers) == ("same-different", ("same", "different"))


REAL = Stimulus("real Pettigrew")
PAPER = ABX(REAL, foil=PVC, match=PETTIGREW)


@given(
    seed=st.integers(0, 2**64), half=st.integers(1, 20), blocks=st.integers(1, 4), practice=st.integers(0, 5)
)
def test_the_match_is_first_as_often_as_second(seed, half, blocks, practice):
    trials = 2 * half * blocks
    design = ABX(REAL, PVC, match=PETTIGREW, trials=trials, blocks=blocks, practice=practice)
    main = design.order(seed=seed, subject="01").trials[practice:]
    for block in range(1, blocks + 1):
        types = Counter(trial.trial_type for trial in main if trial.block == block)
        assert types == {"AB": half, "BA": half}


def test_the_paper_s_third_task():
    order = PAPER.order(seed=1, subject="01")
    assert order.total == 10
    for trial in order.trials:
        reference, *pair = trial.intervals
        assert (reference.stimulus, reference.duration) == (REAL, None)
        assert [interval.duration for interval in pair] == [10.0, 10.0]
        shown = [interval.stimulus for interval in pair]
        assert shown == [{"A": PETTIGREW, "B": PVC}[letter] for letter in trial.trial_type]
        assert trial.correct == ("first", "second")[shown.index(PETTIGREW)]
    seeds = [interval.seed for trial in order.trials for interval in trial.intervals]
    assert len(set(seeds)) == 30
    assert PAPER.mode == "drilling"


def test_a_rendered_reference_is_its_own_match():
    design = ABX(BONE, PVC, reference_interval=5)
    assert design.matching == BONE
    trial = design.order(seed=1, subject="01").next()
    assert trial.intervals[0].stimulus == BONE
    assert trial.intervals[0].duration == 5.0
    assert BONE in [interval.stimulus for interval in trial.intervals[1:]]


def test_chance_foil_and_reference_are_named():
    written = json.loads(json.dumps(PAPER.to_dict()))
    assert written["chance"] == 0.5
    assert written["reference"] == {"name": "real Pettigrew", "real": True}
    assert written["foil"]["name"] == "pvc"
    assert written["match"]["name"] == "pettigrew"
    assert written["reference_interval_s"] is None
    said = PAPER.power(5)
    assert (
        "reference real Pettigrew, then match pettigrew and foil pvc for 10 s each (drilling), chance 0.5"
        in said
    )
    assert "abx, 10 trials, 5 subjects" in said


FALSE_ALARMS = 1e-6


def test_the_draws_stay_what_they_are():
    """A run that was interrupted must find the same trials in a later version."""
    draws = Draws(1, "01", {"design": "x", "interval_s": 20.0})
    assert draws.shuffled(list(range(10))) == [8, 2, 0, 1, 3, 5, 4, 6, 7, 9]
    assert [draws.interval_seed() for _ in range(2)] == [16671133676022338408, 14445788799221260555]


@pytest.mark.parametrize(
    "other",
    [(2, "01", {"a": 1}), (1, "02", {"a": 1}), (1, "01", {"a": 2}), (1 << 32, "01", {"a": 1})],
    ids=["seed", "subject", "design", "large seed"],
)
def test_another_seed_subject_or_design_is_another_stream(other):
    assert Draws(1, "01", {"a": 1}).interval_seed() != Draws(*other).interval_seed()


def test_the_order_of_a_design_s_keys_does_not_matter():
    assert (
        Draws(1, "01", {"a": 1, "b": 2}).interval_seed() == Draws(1, "01", {"b": 2, "a": 1}).interval_seed()
    )


def test_the_same_in_another_process():
    program = (
        "from burrlab.psychophysics.designs import Draws; print(Draws(7, 'Jürg', {'a': 0.1}).interval_seed())"
    )
    said = {
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
        ).stdout
        for _ in range(2)
    }
    assert said == {f"{Draws(7, 'Jürg', {'a': 0.1}).interval_seed()}\n"}


def test_all_shuffles_are_equally_likely():
    """chi^2 of 24 orders over 24 000 subjects."""
    found = Counter("".join(Draws(3, str(i), {}).shuffled("abcd")) for i in range(24_000))
    statistic = sum((found["".join(order)] - 1000) ** 2 / 1000 for order in permutations("abcd"))
    assert chi2.sf(statistic, 23) > FALSE_ALARMS


def test_numbers_below_are_equally_likely():
    draws = Draws(4, "01", {})
    found = Counter(draws.below(7) for _ in range(70_000))
    assert sorted(found) == list(range(7))
    assert chi2.sf(sum((n - 10_000) ** 2 / 10_000 for n in found.values()), 6) > FALSE_ALARMS


@given(
    seed=st.integers(0, 2**64),
    pairs=st.integers(1, 5),
    groups=st.integers(1, 3),
    size=st.integers(1, 20),
    blocks=st.integers(1, 6),
)
def test_balance(seed, pairs, groups, size, blocks):
    types = [[(group, i) for i in range(pairs)] for group in range(groups)]
    made = Draws(seed, "01", {}).balanced(types, size * blocks, blocks)
    assert [len(block) for block in made] == [size] * blocks
    total = Counter(kind for block in made for kind in block)
    if size * blocks % (pairs * groups) == 0:
        assert set(total.values()) == {size * blocks // (pairs * groups)}
    for block in made:
        counts = Counter(block)
        numbers = [counts[kind] for group in types for kind in group]
        assert max(numbers) - min(numbers) <= (1 if size % (pairs * groups) else 0)
        of_groups = [sum(counts[kind] for kind in group) for group in types]
        assert max(of_groups) - min(of_groups) <= 1


@pytest.mark.parametrize("n", range(1, 8))
def test_williams_orders_balance_places_and_what_follows_what(n):
    names = [chr(ord("a") + i) for i in range(n)]
    orders = [counterbalanced(names, subject) for subject in range(2 * n)]
    for half in (orders[:n], orders[n:]):
        for place in range(n):
            assert sorted(order[place] for order in half) == names
    follows = Counter(pair for order in orders for pair in pairwise(order))
    assert len(follows) == n * (n - 1)
    assert len(set(follows.values())) <= 1
    assert counterbalanced(names, 2 * n) == orders[0]


FIXED = [SameDifferent(BONE, PVC), PAPER, ConstantStimuli(BONE, "c_e", (0.7, 1.1, 1.4))]


@pytest.mark.parametrize("design", FIXED)
def test_orders_do_not_depend_on_the_answers_and_differ_between_subjects(design):
    orders = [design.order(seed=1, subject="01") for _ in range(3)]
    while any(order.next() for order in orders):
        trials = [order.next() for order in orders]
        assert trials[0] == trials[1] == trials[2]
        assert orders[0].next() is trials[0]  # until it is answered
        for order, answer in zip(orders, (*design.answers, trials[0].correct), strict=True):
            order.answer(answer)
    assert [trial for trial, _ in orders[2].answered] == list(orders[2].trials)
    assert all(trial.correct == answer for trial, answer in orders[2].answered)
    others = [design.order(seed=1, subject=str(i)).trials for i in range(20)]
    assert len({tuple((t.trial_type, t.level) for t in trials) for trials in others}) > 10
    seeds = [interval.seed for trial in orders[0].trials for interval in trial.intervals]
    assert len(set(seeds)) == len(seeds)


@pytest.mark.parametrize("design", [FIXED[0], Staircase(BONE, "c_e", trials=1)])
def test_answers_are_from_the_set(design):
    order, answers = design.order(seed=1, subject="01"), ", ".join(design.answers)
    with pytest.raises(ValueError, match=f"response must be one of {answers}, got 'third'"):
        order.answer("third")
    for _ in range(order.total):
        order.answer(design.answers[0])
    assert order.next() is None
    with pytest.raises(ValueError, match=f"there is no trial left to answer, got '{design.answers[0]}'"):
        order.answer(design.answers[0])


LEVELS = (0.7, 1.1, 1.4)


def design(parameter="c_e", levels=LEVELS, **options):
    return ConstantStimuli(BONE, parameter, levels, **options)


@given(
    seed=st.integers(0, 2**64),
    levels=st.lists(st.sampled_from([0.5, 0.8, 0.9, 1.1, 1.2, 2.0]), min_size=1, max_size=6, unique=True),
    half=st.integers(1, 6),
    practice=st.integers(0, 7),
)
def test_levels_and_orders_are_equal_to_the_trial(seed, levels, half, practice):
    order = design(levels=levels, repeats=2 * half, practice=practice).order(seed=seed, subject="01")
    main = order.trials[practice:]
    assert Counter((t.level, t.trial_type) for t in main) == {
        (level, kind): half for level in levels for kind in ("RC", "CR")
    }
    first = Counter((t.level, t.trial_type) for t in order.trials[:practice])
    assert max(first.values(), default=0) <= -(-practice // (2 * len(levels)))


def test_blocks_are_balanced_where_they_can_be():
    order = design(repeats=8, blocks=4).order(seed=1, subject="01")
    for block in range(1, 5):
        types = Counter((t.level, t.trial_type) for t in order.trials if t.block == block)
        assert set(types.values()) == {1}
        assert len(types) == 6


@pytest.mark.parametrize(
    ("parameter", "mode", "hold", "question", "more"),
    [
        ("c_e", "probing", "other", "stiffer", "c_e"),
        ("c_e", "drilling", "other", "sink faster", "speed"),
        ("c_e", "drilling", "sinking speed", "stiffer", "c_e"),
        ("alpha", "drilling", "other", "sink faster", "speed"),
    ],
)
def test_the_correct_answer_is_the_interval_with_more_of_what_is_asked(parameter, mode, hold, question, more):
    """The speed is that of the mean-field solver: more c_e sinks more slowly."""
    task = design(parameter, mode=mode, hold=hold)
    assert question in task.question
    burr = Burr(3.0)
    for trial in task.order(seed=1, subject="01").trials:
        shown = [interval.stimulus.material for interval in trial.intervals]
        if more == "c_e":
            values = [material.c_e for material in shown]
        else:
            values = [mean_field_descent(burr, material, 0.5).velocity() for material in shown]
        assert trial.correct == ("first" if values[0] > values[1] else "second")
        reference, comparison = shown if trial.trial_type == "RC" else shown[::-1]
        assert reference == BONE.material
        assert getattr(comparison, parameter) / getattr(reference, parameter) == pytest.approx(trial.level)


def test_what_is_held():
    bone = BONE.material
    one = design().comparison(1.3).material
    assert (one.c_e, one.alpha) == (pytest.approx(1.3 * bone.c_e), bone.alpha)
    two = design("alpha", mode="drilling").comparison(1.3).material
    assert (two.c_e, two.alpha) == (bone.c_e, pytest.approx(1.3 * bone.alpha))
    assert "alpha is held at 0.087 /ms" in design().held
    assert "both change" in design(mode="drilling").held
    assert "c_e is held at 2.145 N/mm^2" in design("alpha", mode="drilling").held


@pytest.mark.parametrize(("shape", "exponent"), [("parabolic", 8 / 3), ("quartic", 4.0)])
def test_the_sinking_speed_is_held(shape, exponent):
    """Mean-field at 1 N: without alpha's change a c_e of 1.3 times halves the speed."""
    reference = Material("x", c_e=2.145, alpha=0.087, shape=shape)
    task = ConstantStimuli(Stimulus("x", reference), "c_e", [1.3], mode="drilling", hold="sinking speed")
    assert f"alpha/c_e^{exponent:.3g} is held" in task.held
    speed = mean_field_descent(Burr(3.0), reference, 1.0).velocity()
    for level in (0.75, 1.3):
        made = task.comparison(level).material
        assert made.alpha / made.c_e**exponent == pytest.approx(reference.alpha / reference.c_e**exponent)
        assert made.shape == reference.shape
        assert mean_field_descent(Burr(3.0), made, 1.0).velocity() == pytest.approx(speed, rel=0.025)


def test_a_design_is_written_whole_of_constant_stimuli():
    written = json.loads(
        json.dumps(design("alpha", mode="drilling", repeats=4, blocks=2, practice=1).to_dict())
    )
    assert written["design"] == "constant-stimuli"
    assert written["reference"]["alpha_per_ms"] == 0.087
    assert written["held"] == "c_e is held at 2.145 N/mm^2"
    assert written["question"].startswith("In which interval did the burr sink faster")
    names = ("parameter", "mode", "hold", "chance", "interval_s", "practice", "blocks", "levels", "repeats")
    assert [written[name] for name in names] == [
        "alpha",
        "drilling",
        "other",
        0.5,
        20.0,
        1,
        2,
        [0.7, 1.1, 1.4],
        4,
    ]


def test_power_says_how_well_a_stated_observer_is_measured():
    said = design(levels=(1.05, 1.1, 1.2, 1.4)).power(12)
    assert said == design(levels=(1.05, 1.1, 1.2, 1.4)).power(12)
    for part in (
        "alpha is held at 0.087 /ms",
        "75 % correct at a ratio of 1.14 (the middle of the levels)",
        "of 12 such subjects",
    ):
        assert part in said


Z = 4.9  # of a two-sided false-alarm rate of 1e-6


def staircase(parameter="c_e", **options):
    return Staircase(BONE, parameter, **options)


def run(order, answers):
    """Answers in turn, right or wrong, or those of a level; the trials."""
    trials, said = [], None if callable(answers) else iter(answers)
    while (trial := order.next()) is not None:
        right = answers(trial.level) if said is None else next(said, None)
        if right is None:
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


def test_a_step_beyond_all_numbers_goes_to_the_limit():
    order = staircase(step=1e308, up_weight=2.0, discard=0, limit=8.0).order(seed=1, subject="01")
    assert run(order, [False] * 4)[-1].level == pytest.approx(8.0)


NEAR, FAR = math.log(1.02), math.log(2.0)


def adaptive(parameter="c_e", **options):
    return AdaptiveStaircase(BONE, parameter, **options)


def measure(draws, proportion, trials):
    """A staircase on an observer; the posterior's summary."""
    posterior = ThresholdPosterior(NEAR, FAR)
    for _ in range(trials):
        difference = posterior.most_informative()
        posterior.update(difference, draws.random() < proportion(difference))
    return posterior.summary()


def from_the_prior(draws):
    """Threshold, slope and lapse rate as the prior has them; the slope and lapse rate from its grid, written out here."""
    lapses = np.array([0.01, 0.03, 0.05, 0.07, 0.09])
    weights = (1 - lapses) ** 9
    return (
        math.exp(draws.uniform(math.log(NEAR), math.log(FAR))),
        draws.choice(np.geomspace(0.7, 4.0, 9)),
        draws.choice(lapses, p=weights / weights.sum()),
    )


def test_the_function_by_hand():
    assert proportion_correct(0.1, 0.1, [0.7, 4.0], 0.0) == pytest.approx([0.75, 0.75])
    assert proportion_correct(0.0, 0.1, 1.3, 0.1) == pytest.approx(0.5)
    assert proportion_correct(1e6, 0.1, 1.3, 0.1) == pytest.approx(0.95)
    x = np.geomspace(0.01, 10, 300)
    gaussian = np.array([gaussian_correct(float(d), 1.0, lapse=0.02) for d in x])
    assert np.abs(proportion_correct(x, 1.0, 1.25, 0.02) - gaussian).max() < 0.012


def test_the_level_leaves_the_least_expected_entropy():
    """Against the definition: the entropy of both posteriors, weighted with the chances of the two answers."""
    posterior = ThresholdPosterior(NEAR, FAR)
    draws = np.random.default_rng(1)
    for _ in range(6):
        expected = []
        weights = posterior.weights()
        for difference in posterior.differences:
            total = 0.0
            for correct in (True, False):
                after = ThresholdPosterior(NEAR, FAR)
                after._log = posterior._log.copy()
                after.update(difference, correct)
                new = after.weights()
                likelihood = np.exp(after._log - posterior._log)
                total -= (weights @ likelihood) * (new @ np.log(np.where(new > 0, new, 1.0)))
            expected.append(total)
        chosen = posterior.most_informative()
        assert min(expected) == pytest.approx(expected[list(posterior.differences).index(chosen)], abs=1e-9)
        posterior.update(chosen, bool(draws.random() < 0.7))


@given(seed=st.integers(0, 2**64), answers=st.lists(st.booleans(), min_size=12, max_size=12))
def test_the_same_answers_give_the_same_trials_of_adaptive(seed, answers):
    design = adaptive(trials=10, practice=2, blocks=2)
    first, second = (run(design.order(seed=seed, subject="01"), answers) for _ in range(2))
    assert first == second
    assert [t.phase for t in first] == ["practice"] * 2 + ["main"] * 10
    assert [t.level for t in first[:2]] == [pytest.approx(2.0)] * 2
    assert [t.block for t in first] == [0] * 2 + [1] * 5 + [2] * 5


def test_orders_and_seeds_do_not_depend_on_the_answers_of_adaptive():
    design = adaptive(trials=32)
    right = run(design.order(seed=1, subject="01"), lambda _: True)
    other = run(design.order(seed=1, subject="01"), lambda level: level > 1.3)
    assert [t.level for t in right] != [t.level for t in other]
    assert [t.trial_type for t in right] == [t.trial_type for t in other]
    assert [[i.seed for i in t.intervals] for t in right] == [[i.seed for i in t.intervals] for t in other]
    for start in range(0, 32, 8):
        assert Counter(t.trial_type for t in right[start : start + 8]) == {"RC": 4, "CR": 4}
    another = run(design.order(seed=1, subject="02"), lambda _: True)
    assert [t.trial_type for t in another] != [t.trial_type for t in right]
    assert [t.level for t in another] == [t.level for t in right]  # they follow the answers alone


def test_below_one_mirrors_above_of_adaptive():
    above = run(adaptive(trials=20).order(seed=1, subject="01"), lambda level: level > 1.2)
    design = adaptive(trials=20, levels=(1 / 1.02, 0.5))
    below = run(design.order(seed=1, subject="01"), lambda level: level < 1 / 1.2)
    assert [t.level for t in below] == pytest.approx([1 / t.level for t in above])
    found = design.threshold([t.level for t in below], [t.level < 1 / 1.2 for t in below])
    assert found.level < 1
    assert found.interval[0] > found.level > found.interval[1]


def test_it_goes_where_the_threshold_is():
    trials = run(adaptive(trials=60).order(seed=1, subject="01"), lambda level: level > 1.25)
    levels = [t.level for t in trials]
    found = adaptive().threshold(levels, [level > 1.25 for level in levels])
    assert found.interval[0] < 1.25 < found.interval[1]
    assert not found.open_below
    assert not found.open_above
    assert np.median([abs(math.log(level / 1.25)) for level in levels[30:]]) < 0.1


def test_no_answer_and_answers_that_bound_nothing():
    prior = adaptive().threshold([], [])
    assert (prior.trials, prior.open_below, prior.open_above) == (0, True, True)
    assert prior.difference == pytest.approx(math.sqrt(NEAR * FAR))
    low, high = (math.log(end) for end in prior.interval)
    # 2.5 and 97.5 % of a prior that is even in the logarithm
    assert math.log(low / NEAR) == pytest.approx(0.025 * math.log(FAR / NEAR), rel=1e-6)
    assert math.log(high / NEAR) == pytest.approx(0.975 * math.log(FAR / NEAR), rel=1e-6)
    levels = [t.level for t in run(adaptive().order(seed=1, subject="01"), lambda _: True)]
    perfect = adaptive().threshold(levels, [True] * 60)
    assert perfect.open_below
    assert not perfect.open_above
    assert "it may lie nearer to 1 than the levels" in str(perfect)


def covered(runs, trials, seed, level=0.95):
    draws = np.random.default_rng(seed)
    count = 0
    for _ in range(runs):
        truth = from_the_prior(draws)
        found = measure(draws, lambda difference, t=truth: proportion_correct(difference, *t), trials)
        low, high = found["interval"]
        count += low <= truth[0] <= high
    assert level == 0.95
    return count


def test_intervals_hold_the_threshold_quickly():
    """Of observers as the prior has them 95 % in the mean, whatever the levels chosen: false-alarm rate 1e-6."""
    count = covered(100, 20, seed=1)
    assert binom.cdf(count, 100, 0.95) > FALSE_ALARMS


@pytest.mark.slow
@pytest.mark.parametrize("trials", [30, 60, 120])
def test_intervals_hold_the_threshold(trials):
    count = covered(1000, trials, seed=2)
    assert binom.cdf(count, 1000, 0.95) > FALSE_ALARMS / 2
    assert binom.sf(count - 1, 1000, 0.95) > FALSE_ALARMS / 2


@pytest.mark.slow
@pytest.mark.parametrize("threshold", [1.05, 1.1, 1.2, 1.5])
def test_intervals_hold_the_threshold_of_a_gaussian_observer(threshold):
    """No Weibull function, and a threshold that is given: no promise of Bayes', so at least 0.93 only."""
    draws, truth = np.random.default_rng(3), math.log(threshold)
    found = [measure(draws, lambda x: gaussian_correct(x, truth), 60) for _ in range(1000)]
    count = sum(low <= truth <= high for low, high in (one["interval"] for one in found))
    assert binom.cdf(count, 1000, 0.93) > FALSE_ALARMS
    bias = np.mean([math.log(one["threshold"] / truth) for one in found])
    assert abs(bias) < 0.1


def test_written_and_said_of_adaptive():
    design = adaptive("alpha", mode="drilling", trials=20)
    written = json.loads(json.dumps(design.to_dict()))
    assert (written["design"], written["levels"], written["trials"]) == ("adaptive", [1.02, 2.0], 20)
    assert "1/ms" not in written["held"]
    found = adaptive().threshold([1.5, 1.2], [True, False])
    assert json.loads(json.dumps(found.to_dict()))["trials"] == 2
    assert "75 % correct at a ratio of" in str(found)
    assert "20 trials" in design.power(5)


@pytest.mark.parametrize(
    ("kind", "ask", "sentence"),
    [
        (ValueError, lambda: counterbalanced([], 0), "names must hold at least one, got none"),
        (ValueError, lambda: counterbalanced(["a", "b", "a"], 0), r"names must differ, got \['a', 'b', 'a'\]"),
        (ValueError, lambda: counterbalanced(["a"], -1), "subject_index must be at least 0, got -1"),
        (ValueError, lambda: Draws(-1, "01", {}), r"seed must be at least 0, got -1"),
        (ValueError, lambda: Draws(1, "", {}), r"subject must have a name, got ''"),
        (TypeError, lambda: Draws(1, 1, {}), r"subject must be a str, such as '01', got 1"),
        (TypeError, lambda: Draws(1.5, "01", {}), "float"),
        (ValueError, lambda: FixedOrder([], ("same", "different")).answer("same"), r"there is no trial left to answer, got 'same'"),
        (ValueError, lambda: staircase().threshold([2.0, 1.5], [True, True]), r"levels must be those of this staircase, got 1.5 in trial 2 where it has 2$"),
        (ValueError, lambda: staircase(trials=2).threshold([2.0, 2.0, 2.0], [True, False, True]), r"got 2 in trial 3 where it has an end"),
        (ValueError, lambda: staircase().threshold([2.0, 2.0], [True]), r"levels and correct must be equally many, got 2 and 1"),
        (TypeError, lambda: Staircase(materials["bone"], "c_e"), r"reference must be a Stimulus"),
        (TypeError, lambda: staircase(trials=20.5), "float"),
        (TypeError, lambda: AdaptiveStaircase(materials["bone"], "c_e"), r"reference must be a Stimulus"),
        (TypeError, lambda: adaptive(trials=20.5), "float"),
        (ValueError, lambda: adaptive().threshold([0.9], [True]), r"levels must be between 1.02 and 2, got 0.9"),
        (ValueError, lambda: adaptive().threshold([1.1], []), r"levels and correct must be equally many, got 1 and 0"),
        (ValueError, lambda: adaptive().threshold([1.1], [True], level=95), r"level must be between 0 and 1, got 95"),
        (ValueError, lambda: posterior_threshold(0.01, 1.0, [1.1, 0.9], [True, True]), r"levels must be on one side of 1, got some below and some above"),
    ],
)  # fmt: skip
def test_refusals_by_their_sentence(kind, ask, sentence):
    with pytest.raises(kind, match=sentence):
        ask()


REFERENCE = {"reference": BONE, "parameter": "c_e"}
RIGHT = {
    SameDifferent: {"a": BONE, "b": PVC}, ABX: {"reference": REAL, "foil": PVC, "match": PETTIGREW},
    ConstantStimuli: {**REFERENCE, "levels": LEVELS}, Staircase: REFERENCE, AdaptiveStaircase: REFERENCE,
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (SameDifferent, {"a": Stimulus("real bone")}, r"a must have a material to be rendered, got the real specimen 'real bone'"),
        (SameDifferent, {"b": Stimulus("real bone")}, r"b must have a material to be rendered"),
        (SameDifferent, {"b": BONE}, r"a and b must have different names, got 'bone' twice"),
        (SameDifferent, {"trials": 10}, r"trials must be a multiple of 4 \(AA, AB, BA, BB equally often\), got 10"),
        (SameDifferent, {"trials": 0}, r"trials must be at least 4, got 0"),
        (SameDifferent, {"blocks": 5}, r"trials must be a multiple of 5, the number of blocks, got 12"),
        (SameDifferent, {"blocks": 0}, r"blocks must be at least 1, got 0"),
        (SameDifferent, {"practice": -1}, r"practice must be at least 0, got -1"),
        (SameDifferent, {"interval": 0.0}, r"interval must be a time above 0 \[s\], got 0.0"),
        (SameDifferent, {"interval": float("nan")}, r"interval must be a time above 0 \[s\], got nan"),
        (SameDifferent, {"mode": "burning"}, r"mode must be one of probing, drilling, got 'burning'"),
        (ABX, {"match": None}, r"match must be given, as the reference 'real Pettigrew' is a real specimen"),
        (ABX, {"match": Stimulus("resin")}, r"match must have a material to be rendered, got the real specimen 'resin'"),
        (ABX, {"foil": Stimulus("resin")}, r"foil must have a material to be rendered, got the real specimen 'resin'"),
        (ABX, {"foil": PETTIGREW}, r"match and foil must have different names, got 'pettigrew' twice"),
        (ABX, {"trials": 9}, r"trials must be a multiple of 2 \(AB and BA equally often\), got 9"),
        (ABX, {"trials": 0}, r"trials must be at least 2, got 0"),
        (ABX, {"blocks": 3}, r"trials must be a multiple of 3, the number of blocks, got 10"),
        (ABX, {"blocks": 0}, r"blocks must be at least 1, got 0"),
        (ABX, {"practice": -1}, r"practice must be at least 0, got -1"),
        (ABX, {"interval": -1.0}, r"interval must be a time above 0 \[s\], got -1.0"),
        (ABX, {"reference_interval": 0}, r"reference_interval must be a time above 0 \[s\], got 0"),
        (ABX, {"mode": "both"}, r"mode must be one of probing, drilling, got 'both'"),
        (ConstantStimuli, {"reference": Stimulus("real")}, r"reference must have a material to be rendered, got the real specimen 'real'"),
        (ConstantStimuli, {"parameter": "shape"}, r"parameter must be one of c_e, alpha, got 'shape'"),
        (ConstantStimuli, {"parameter": "alpha"}, r"mode must be 'drilling' for parameter 'alpha', got 'probing': alpha alone changes nothing with the burr off"),
        (ConstantStimuli, {"parameter": "alpha", "mode": "drilling", "hold": "sinking speed"}, r"hold must be 'other' for parameter 'alpha'"),
        (ConstantStimuli, {"hold": "sinking speed"}, r"hold must be 'other' for mode 'probing', got 'sinking speed': nothing sinks with the burr off"),
        (ConstantStimuli, {"hold": "force"}, r"hold must be one of other, sinking speed, got 'force'"),
        (ConstantStimuli, {"mode": "both"}, r"mode must be one of probing, drilling, got 'both'"),
        (ConstantStimuli, {"levels": []}, r"levels must hold at least one, got none"),
        (ConstantStimuli, {"levels": [1.0]}, r"levels must differ from 1, got 1: two alike intervals have no correct answer"),
        (ConstantStimuli, {"levels": [1.1, -1.0]}, r"levels must be a ratio above 0, got -1.0"),
        (ConstantStimuli, {"levels": [float("nan")]}, r"levels must be a ratio above 0, got nan"),
        (ConstantStimuli, {"levels": [1.1, 1.1]}, r"levels must differ, got \(1.1, 1.1\)"),
        (ConstantStimuli, {"repeats": 3}, r"repeats must be a multiple of 2 \(RC and CR equally often\), got 3"),
        (ConstantStimuli, {"blocks": 7}, r"blocks must divide the 60 trials, got 7"),
        (ConstantStimuli, {"blocks": 0}, r"blocks must be at least 1, got 0"),
        (ConstantStimuli, {"practice": -1}, r"practice must be at least 0, got -1"),
        (ConstantStimuli, {"interval": 0.0}, r"interval must be a time above 0 \[s\], got 0.0"),
        (ConstantStimuli, {"reference": Stimulus("x", Material("x", c_e=1.0, alpha=0.0))}, r"reference must have alpha above 0, got 0"),
        (Staircase, {"start": 1.0}, r"start must differ from 1, got 1"),
        (Staircase, {"start": -2.0}, r"start must be a ratio above 0, got -2.0"),
        (Staircase, {"limit": 1.5}, r"limit must be as far from 1 as start, 2, or farther, got 1.5"),
        (Staircase, {"limit": 0.2}, r"limit must be as far from 1 as start, 2, or farther, got 0.2"),
        (Staircase, {"step": 1.0}, r"step must be a factor above 1, got 1.0"),
        (Staircase, {"coarse_step": float("inf")}, r"coarse_step must be a factor above 1, got inf"),
        (Staircase, {"up_weight": 0.0}, r"up_weight must be above 0, got 0.0"),
        (Staircase, {"down": 0}, r"down must be at least 1, got 0"),
        (Staircase, {"down": 1}, r"down and up_weight must aim above chance, 0.5, got 1 and 1, which aim at 0.5"),
        (Staircase, {"discard": -1}, r"discard must be at least 0, got -1"),
        (Staircase, {"reversals": 5}, r"reversals must be a multiple of 2 \(peaks and valleys in pairs\), got 5"),
        (Staircase, {"trials": 0}, r"trials must be at least 1, got 0"),
        (Staircase, {"blocks": 3}, r"trials must be a multiple of 3, the number of blocks, got 80"),
        (Staircase, {"parameter": "alpha"}, r"alpha alone changes nothing with the burr off"),
        (AdaptiveStaircase, {"levels": (1.0, 2.0)}, r"levels must differ from 1, got 1"),
        (AdaptiveStaircase, {"levels": (0.0, 2.0)}, r"levels must be a ratio above 0, got 0.0"),
        (AdaptiveStaircase, {"levels": (0.9, 2.0)}, r"levels must be on one side of 1, the nearer first, got 0.9 and 2"),
        (AdaptiveStaircase, {"levels": (2.0, 1.1)}, r"levels must be on one side of 1, the nearer first, got 2 and 1.1"),
        (AdaptiveStaircase, {"trials": 0}, r"trials must be at least 1, got 0"),
        (AdaptiveStaircase, {"blocks": 7}, r"trials must be a multiple of 7, the number of blocks, got 60"),
        (AdaptiveStaircase, {"parameter": "alpha"}, r"alpha alone changes nothing with the burr off"),
    ],
)  # fmt: skip
def test_wrong_values_are_named(kind, change, message):
    with pytest.raises(ValueError, match=message):
        kind(**{**RIGHT[kind], **change})


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (SameDifferent, {"a": materials["bone"]}, r"a must be a Stimulus, such as .*, got Material"),
        (SameDifferent, {"trials": 12.5}, "float"),
        *((ABX, {name: "bone"}, f"{name} must be a Stimulus, such as .*, got 'bone'") for name in RIGHT[ABX]),
        (ConstantStimuli, {"reference": "bone"}, "reference must be a Stimulus"),
        (ConstantStimuli, {"repeats": 2.0}, "float"),
    ],
)  # fmt: skip
def test_wrong_types_are_named(kind, change, message):
    with pytest.raises(TypeError, match=message):
        kind(**{**RIGHT[kind], **change})
