"""Designs: balanced trials, orders that depend on seed and subject only, staircases that find thresholds."""

import json
import math
from collections import Counter
from functools import partial
from itertools import pairwise, permutations
from unittest.mock import Mock

import numpy as np
import pytest
from answer_scenes import give
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom, chi2
from session_scenes import refused

from burrlab import Burr, Material, materials, mean_field_descent
from burrlab.psychophysics.designs import ABX, Draws, FixedOrder, SameDifferent, Stimulus, counterbalanced
from burrlab.psychophysics.psychometric import ThresholdPosterior, proportion_correct
from burrlab.psychophysics.staircase import (
    AdaptiveStaircase,
    ConstantStimuli,
    Staircase,
    design_of_dict,
    gaussian_correct,
    gaussian_difference,
)

BONE, PETTIGREW, PVC = (Stimulus(name, materials[name]) for name in ("bone", "pettigrew", "pvc"))
REAL = Stimulus("real Pettigrew")
PAPER = ABX(REAL, foil=PVC, match=PETTIGREW)
PAIRS = ("AA", "AB", "BA", "BB")
FALSE_ALARMS = 1e-6
Z = 4.9  # for a two-sided false-alarm rate of 1e-6


staircase, adaptive = (partial(kind, BONE, "c_e") for kind in (Staircase, AdaptiveStaircase))


def constant(parameter="c_e", levels=(0.7, 1.1, 1.4), **options):
    return ConstantStimuli(BONE, parameter, levels, **options)


def kinds(trials):
    return [trial.trial_type for trial in trials]


def seeds(trials):
    return [interval.seed for trial in trials for interval in trial.intervals]


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**64),
    subject=st.text(min_size=1, max_size=5),
    quarter=st.integers(1, 8),
    practice=st.integers(0, 9),
    blocks=st.integers(1, 6),
)
def test_the_four_pairs_are_equal_to_the_trial(seed, subject, quarter, practice, blocks):
    trials = 4 * quarter * blocks
    order = SameDifferent(BONE, PVC, trials=trials, practice=practice, blocks=blocks).order(
        seed=seed, subject=subject
    )
    assert order.total == trials + practice == len(order.trials)
    first, main = order.trials[:practice], order.trials[practice:]
    for block in range(1, blocks + 1):
        assert Counter(kinds(t for t in main if t.block == block)) == dict.fromkeys(PAIRS, quarter)
    assert {(trial.phase, trial.block) for trial in first} <= {("practice", 0)}
    assert {trial.phase for trial in main} == {"main"}
    numbers = [kinds(first).count(pair) for pair in PAIRS]
    assert max(numbers) - min(numbers) <= 1
    assert [trial.number for trial in order.trials] == [*range(1, practice + 1), *range(1, trials + 1)]


def test_a_trial_is_what_its_type_says():
    order = SameDifferent(BONE, PVC, interval=5.0, trials=40, practice=4).order(seed=3, subject="01")
    for trial in order.trials:
        shown = [interval.stimulus for interval in trial.intervals]
        assert shown == [{"A": BONE, "B": PVC}[letter] for letter in trial.trial_type]
        assert (trial.correct, [interval.duration for interval in trial.intervals], trial.level) == (
            "same" if shown[0] == shown[1] else "different", [5.0, 5.0], None,
        )  # fmt: skip
    assert len(set(seeds(order.trials))) == 88


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
    own = ABX(BONE, PVC, reference_interval=5)
    first = own.order(seed=1, subject="01").next().intervals[0]
    assert (own.matching, first.stimulus, first.duration) == (BONE, BONE, 5.0)


def test_the_draws_stay_what_they_are():
    """An interrupted run must resume with the same trials in a later version and in another process."""
    draws = Draws(1, "01", {"design": "x", "interval_s": 20.0})
    assert draws.shuffled(list(range(10))) == [8, 2, 0, 1, 3, 5, 4, 6, 7, 9]
    assert [draws.interval_seed() for _ in range(2)] == [16671133676022338408, 14445788799221260555]
    assert Draws(7, "Jürg", {"a": 0.1}).interval_seed() == 18115130029876784718
    keys = ({"a": 1, "b": 2}, {"b": 2, "a": 1})  # in any order
    assert len({Draws(1, "01", design).interval_seed() for design in keys}) == 1


@pytest.mark.parametrize(
    "other",
    [(2, "01", {"a": 1}), (1, "02", {"a": 1}), (1, "01", {"a": 2}), (1 << 32, "01", {"a": 1})],
    ids=["seed", "subject", "design", "large seed"],
)
def test_another_seed_subject_or_design_is_another_stream(other):
    assert Draws(1, "01", {"a": 1}).interval_seed() != Draws(*other).interval_seed()


def test_all_shuffles_are_equally_likely():
    """chi^2 of 24 orders over 24 000 subjects."""
    found = Counter("".join(Draws(3, str(i), {}).shuffled("abcd")) for i in range(24_000))
    assert (
        chi2.sf(sum((found["".join(order)] - 1000) ** 2 / 1000 for order in permutations("abcd")), 23)
        > FALSE_ALARMS
    )


@settings(max_examples=60, deadline=None)
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


FIXED = [SameDifferent(BONE, PVC), PAPER, constant()]


@pytest.mark.parametrize("design", FIXED)
def test_orders_do_not_depend_on_the_answers_and_differ_between_subjects(design):
    orders = [design.order(seed=1, subject="01") for _ in range(3)]
    while any(order.next() for order in orders):
        trials = [order.next() for order in orders]
        assert trials[0] == trials[1] == trials[2]
        assert orders[0].next() is trials[0]  # the same until answered
        for order, answer in zip(orders, (*design.answers, trials[0].correct), strict=True):
            order.answer(answer)
    first = orders[2].trials
    assert orders[2].answered == [(trial, trial.correct) for trial in first]
    others = [design.order(seed=seed, subject=str(i)).trials for seed in (1, 2) for i in range(10)]
    assert len({tuple((t.trial_type, t.level) for t in trials) for trials in (first, *others)}) > 10
    assert len({*seeds(first), *(seed for trials in others for seed in seeds(trials))}) == 21 * len(
        seeds(first)
    )


@pytest.mark.parametrize("design", [FIXED[0], staircase(trials=1)])
def test_answers_are_from_the_set(design):
    order, answers = design.order(seed=1, subject="01"), ", ".join(design.answers)
    refused((lambda: order.answer("third"), f"response must be one of {answers}, got 'third'"))
    for _ in range(order.total):
        order.answer(design.answers[0])
    refused(
        (
            lambda: order.answer(design.answers[0]),
            f"there is no trial left to answer, got '{design.answers[0]}'",
        )
    )


MATERIAL = {
    "name": "bone",
    "material": "bone",
    "c_e_N_per_mm2": 2.145,
    "alpha_per_ms": 0.087,
    "shape": "parabolic",
}
SOFT = {"name": "pvc", "material": "pvc", "c_e_N_per_mm2": 0.462, "alpha_per_ms": 0.256, "shape": "parabolic"}


@pytest.mark.parametrize(
    ("design", "written", "power"),
    [
        (
            SameDifferent(BONE, PVC, trials=8, interval=2, mode="drilling", practice=1, blocks=2),
            {"design": "same-different", "a": MATERIAL, "b": SOFT, "trials": 8, "interval_s": 2.0, "mode": "drilling", "practice": 1, "blocks": 2},
            ["bone or pvc in two intervals of 2 s (drilling), chance "
             "0.5\n", "same-different, 8 trials, 5 subjects"],
        ),
        (
            PAPER,
            {"chance": 0.5, "reference": {"name": "real Pettigrew", "real": True}, "foil": SOFT, "reference_interval_s": None, "mode": "drilling"},
            ["reference real Pettigrew, then match pettigrew and foil pvc for 10 s each (drilling), "
             "chance 0.5", "abx, 10 trials, 5 subjects"],
        ),
        (
            constant("alpha", mode="drilling", repeats=4, blocks=2, practice=1),
            {
                "design": "constant-stimuli", "reference": MATERIAL, "held": "c_e is held at 2.145 N/mm^2", "parameter": "alpha", "mode": "drilling",
                "question": "In which interval did the burr sink faster, the first or the second?",
                "hold": "other", "chance": 0.5,
                "interval_s": 20.0, "practice": 1, "blocks": 2, "levels": [0.7, 1.1, 1.4], "repeats": 4,
            },
            ["3 levels of 4 trials each\n"],
        ),
        (
            constant(levels=(1.05, 1.1, 1.2, 1.4)),
            {"held": "alpha is held at 0.087 /ms"},
            ["alpha is held at 0.087 /ms", "75 % correct at a ratio of 1.14 (the middle of the levels)",
             "2 of them end without a threshold within the levels\n", "to a factor of 1.30 (standard deviation), 5 % too small in the mean"],
        ),
        (
            staircase(),
            {"design": "staircase", "start": 2.0, "limit": 4.0, "target": math.sqrt(0.5)},
            ["aims at 70.7 % correct, at most 80 trials",
             "75 % correct at a ratio of 1.19 (a quarter of the start's distance from 1)",
             "1.59 (standard deviation), 2 % too large"],
        ),
        (
            AdaptiveStaircase(BONE, "alpha", mode="drilling", trials=20),
            {"design": "adaptive", "levels": [1.02, 2.0], "trials": 20, "held": "c_e is held at 2.145 N/mm^2"},
            ["; 20 trials\n", "24 of them end without", "of 5 such subjects", "1.38 (standard deviation), 2 % too large"],
        ),
    ],
)  # fmt: skip
def test_a_design_is_written_whole_and_says_its_power(design, written, power):
    found = json.loads(json.dumps(design.to_dict()))
    assert written == {key: found[key] for key in written}
    assert design_of_dict(found).to_dict() == design.to_dict()
    for damaged in ({}, {"name": "bone"}, [1], "x"):  # of the first material
        broken = next({**found, key: damaged} for key, x in found.items() if isinstance(x, dict))
        refused(
            (
                partial(design_of_dict, broken),
                f"design {found['design']} has a value that is missing or wrong",
            )
        )
    said = design.power(5)
    assert all(part in said for part in power)
    assert said == design.power(5)


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
    """The mean-field solver gives the speed: the burr sinks more slowly at more c_e."""
    task = constant(parameter, mode=mode, hold=hold)
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
    one = constant().comparison(1.3).material
    assert (one.c_e, one.alpha) == (pytest.approx(1.3 * bone.c_e), bone.alpha)
    two = constant("alpha", mode="drilling").comparison(1.3).material
    assert (two.c_e, two.alpha) == (bone.c_e, pytest.approx(1.3 * bone.alpha))
    assert "both change" in constant(mode="drilling").held
    law = Material("x", c_e=2.0, alpha=0.1, force_exponent=2.0, rate_exponent=0.5)
    task = ConstantStimuli(Stimulus("x", law), "c_e", [1.3], mode="drilling", hold="sinking speed")
    assert "alpha/c_e^2 is held, and with it the sinking speed at forces below 0.028 c_e R^2" in task.held
    three = task.comparison(1.3).material
    assert (three.force_exponent, three.rate_exponent, three.alpha) == (2.0, 0.5, pytest.approx(0.169))


@pytest.mark.parametrize(("shape", "exponent"), [("parabolic", 8 / 3), ("quartic", 4.0)])
def test_the_sinking_speed_is_held(shape, exponent):
    """Mean-field at 1 N. Without the change of alpha, 1.3 times c_e would halve the speed."""
    reference = Material("x", c_e=2.145, alpha=0.087, shape=shape)
    task = ConstantStimuli(Stimulus("x", reference), "c_e", [1.3], mode="drilling", hold="sinking speed")
    assert f"alpha/c_e^{exponent:.3g} is held" in task.held
    speed = mean_field_descent(Burr(3.0), reference, 1.0).velocity()
    for level in (0.75, 1.3):
        made = task.comparison(level).material
        assert made.alpha / made.c_e**exponent == pytest.approx(reference.alpha / reference.c_e**exponent)
        assert made.shape == reference.shape
        assert mean_field_descent(Burr(3.0), made, 1.0).velocity() == pytest.approx(speed, rel=0.025)


def run(design, answers, seed=1, subject="01"):
    """The trials of a run; `answers` are right or wrong in turn, or a function of the level."""
    order = design.order(seed=seed, subject=subject)
    if callable(answers):
        return give(Mock(), order, right=lambda trial: answers(trial.level))
    in_turn = iter(answers)
    return give(Mock(), order, len(answers), right=lambda trial: next(in_turn))


def levels(trials):
    return [trial.level for trial in trials]


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
    assert staircase(**options).target == pytest.approx(target, rel=1e-12)


def test_two_down_one_up_by_hand():
    design = staircase(start=2.0, discard=1, coarse_step=2.0, step=math.sqrt(2), reversals=2)
    d = math.log(2.0)
    #          level d   d    d/2  d/2   d/4  d/2 (wrong: first reversal, then small steps)
    answers = [True, True, True, True, False, True, True, False, False]
    trials = run(design, answers)
    up = d / 4 * math.sqrt(2)
    assert [math.log(t.level) for t in trials] == pytest.approx([d, d, d / 2, d / 2, d / 4, up, up, d / 4])
    found = design.threshold([t.level for t in trials], answers[: len(trials)])
    # the reversals that count: down at up, up at d/4
    assert (found.complete, found.reversals, found.trials, found.spread, found.difference) == (
        True, 2, 8, None, pytest.approx(math.sqrt(up * d / 4)),
    )  # fmt: skip
    assert found.level == pytest.approx(math.exp(found.difference))


def test_weighted_steps_by_hand():
    trials = run(staircase(down=1, up_weight=3.0, discard=0, step=1.1, start=1.5), [True, False, True])
    d = math.log(1.5)
    assert [math.log(t.level) for t in trials] == pytest.approx([d, d / 1.1, d * 1.1**2])


@pytest.mark.parametrize(
    ("above", "below"),
    [
        (staircase(start=2.0, discard=1), staircase(start=0.5, discard=1)),
        (adaptive(trials=20), adaptive(trials=20, levels=(1 / 1.02, 0.5))),
    ],
)
def test_below_one_mirrors_above(above, below):
    answers = [True, True, True, False, True, False, False, True] * 2
    ratios, inverse = (levels(run(design, answers)) for design in (above, below))
    assert inverse == pytest.approx([1 / level for level in ratios])
    found, mirrored = above.threshold(ratios, answers), below.threshold(inverse, answers)
    assert mirrored.level == pytest.approx(1 / found.level)
    ends = [getattr(one, "interval", ()) for one in (found, mirrored)]
    assert ends[1] == pytest.approx([1 / end for end in ends[0]])


def test_one_reversal_is_no_threshold():
    found = staircase(start=0.5, discard=0).threshold(
        [0.5, 0.5, 0.5 ** (1 / math.sqrt(2))], [True, True, False]
    )
    assert (found.level, found.complete) == (None, False)
    assert "no threshold: 1 reversals that count in 3 trials, two are needed" in str(found)


def test_the_limit_holds_and_is_said():
    design = staircase(start=2.0, limit=3.0, trials=20)
    trials = levels(run(design, [False] * 30))
    assert (len(trials), max(trials)) == (20, pytest.approx(3.0))
    assert design.threshold(trials, [False] * 20).at_limit == 19
    assert staircase(limit=2.0).limit == 2.0  # as far from 1 as the start
    mixed = [False, False, True, True, False, True, True, False, True, True]
    trials = levels(run(design, mixed))
    assert "at the limit, so the threshold may be too small" in str(
        design.threshold(trials, mixed[: len(trials)])
    )
    beyond_all_numbers = staircase(step=1e308, up_weight=2.0, discard=0, limit=8.0)
    assert levels(run(beyond_all_numbers, [False] * 4))[-1] == pytest.approx(8.0)


def test_a_perfect_subject_never_reaches_one():
    trials = levels(run(staircase(down=1, up_weight=3.0, trials=60), [True] * 60))
    assert (len(trials), min(trials)) == (60, pytest.approx(math.exp(1e-4)))


@pytest.mark.parametrize(
    "design",
    [staircase(practice=3, reversals=6, trials=40, blocks=2), adaptive(trials=40, practice=3, blocks=2)],
)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**64), answers=st.lists(st.booleans(), min_size=0, max_size=90))
def test_the_same_answers_give_the_same_trials(design, seed, answers):
    first, second = (run(design, answers, seed=seed) for _ in range(2))
    assert first == second
    assert len(first) <= 43 == design.order(seed=seed, subject="01").total
    assert levels(first[:3]) == [pytest.approx(2.0)] * len(first[:3])
    assert [t.phase for t in first] == (["practice"] * 3 + ["main"] * 40)[: len(first)]
    assert [t.block for t in first] == ([0] * 3 + [1] * 20 + [2] * 20)[: len(first)]


@pytest.mark.parametrize("design", [staircase(reversals=20, trials=40), adaptive(trials=40)])
def test_orders_and_seeds_do_not_depend_on_the_answers(design):
    right, other = run(design, [True] * 40), run(design, lambda level: level > 1.3)
    n = min(len(right), len(other))
    assert levels(right[:n]) != levels(other[:n])
    assert (kinds(right[:n]), seeds(right[:n]), len(set(seeds(right)))) == (
        kinds(other[:n]), seeds(other[:n]), 80,
    )  # fmt: skip
    for start in range(0, 40, 8):
        assert Counter(kinds(right[start : start + 8])) == {"RC": 4, "CR": 4}
    another = run(design, [True] * 40, subject="02")
    assert kinds(another) != kinds(right)
    assert levels(another) == levels(right)  # levels follow the answers only


@pytest.mark.parametrize(
    "options", [{"down": 2}, {"down": 3}, {"down": 1, "up_weight": 3.0}], ids=["2-down", "3-down", "weighted"]
)
def test_staircases_converge_to_their_target(options):
    """The mean of ln difference over 300 long runs is within 0.05, plus error at 1e-6, of the target's."""
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


NEAR, FAR = math.log(1.02), math.log(2.0)


def measure(draws, proportion, trials):
    """The posterior's threshold after an adaptive staircase with an observer."""
    posterior = ThresholdPosterior(NEAR, FAR)
    for _ in range(trials):
        difference = posterior.most_informative()
        posterior.update(difference, draws.random() < proportion(difference))
    return posterior.threshold(1.0, trials)


def test_the_function_by_hand():
    assert proportion_correct(0.1, 0.1, [0.7, 4.0], 0.0) == pytest.approx([0.75, 0.75])
    assert [proportion_correct(d, 0.1, 1.3, 0.1) for d in (0.0, 1e6)] == pytest.approx([0.5, 0.95])
    x = np.geomspace(0.01, 10, 300)
    gaussian = np.array([gaussian_correct(float(d), 1.0, lapse=0.02) for d in x])
    assert np.abs(proportion_correct(x, 1.0, 1.25, 0.02) - gaussian).max() < 0.012


def test_the_level_leaves_the_least_expected_entropy():
    """By definition: the entropy of both posteriors, weighted by the probabilities of the two answers."""
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
                total -= (weights @ np.exp(after._log - posterior._log)) * (
                    new @ np.log(np.where(new > 0, new, 1.0))
                )
            expected.append(total)
        chosen = posterior.most_informative()
        assert min(expected) == pytest.approx(expected[list(posterior.differences).index(chosen)], abs=1e-9)
        posterior.update(chosen, bool(draws.random() < 0.7))


def test_no_answer_and_answers_that_bound_nothing():
    prior = adaptive().threshold([], [])
    assert (prior.trials, prior.open_below, prior.open_above) == (0, True, True)
    assert prior.difference == pytest.approx(math.sqrt(NEAR * FAR))
    low, high = (math.log(end) for end in prior.interval)
    # 2.5 and 97.5 % of a prior that is uniform in the logarithm
    assert math.log(low / NEAR) == pytest.approx(0.025 * math.log(FAR / NEAR), rel=1e-6)
    assert math.log(high / NEAR) == pytest.approx(0.975 * math.log(FAR / NEAR), rel=1e-6)
    perfect = adaptive().threshold(levels(run(adaptive(), lambda _: True)), [True] * 60)
    assert perfect.open_below
    assert not perfect.open_above
    assert "it may lie nearer to 1 than the levels" in str(perfect)


def covered(runs, trials, seed):
    """Number of runs whose interval holds a threshold drawn from the prior, as its slope and lapse rate are."""
    draws, count = np.random.default_rng(seed), 0
    lapses = np.array([0.01, 0.03, 0.05, 0.07, 0.09])
    weights = (1 - lapses) ** 9
    for _ in range(runs):
        truth = (
            math.exp(draws.uniform(math.log(NEAR), math.log(FAR))),
            draws.choice(np.geomspace(0.7, 4.0, 9)),
            draws.choice(lapses, p=weights / weights.sum()),
        )
        low, high = measure(draws, lambda x, t=truth: proportion_correct(x, *t), trials).interval
        count += low <= math.exp(truth[0]) <= high
    return count


def test_intervals_hold_the_threshold_quickly():
    """Coverage of 95 % on average over observers from the prior, with any levels; false-alarm rate 1e-6."""
    assert binom.cdf(covered(100, 20, seed=1), 100, 0.95) > FALSE_ALARMS


@pytest.mark.slow
@pytest.mark.parametrize("trials", [30, 60, 120])
def test_intervals_hold_the_threshold(trials):
    count = covered(1000, trials, seed=2)
    assert binom.cdf(count, 1000, 0.95) > FALSE_ALARMS / 2
    assert binom.sf(count - 1, 1000, 0.95) > FALSE_ALARMS / 2


@pytest.mark.slow
@pytest.mark.parametrize("threshold", [1.05, 1.1, 1.2, 1.5])
def test_intervals_hold_the_threshold_of_a_gaussian_observer(threshold):
    """Without a Weibull function and with a fixed threshold Bayes promises nothing, so the limit is 0.93."""
    draws, truth = np.random.default_rng(3), math.log(threshold)
    found = [measure(draws, lambda x: gaussian_correct(x, truth), 60) for _ in range(1000)]
    count = sum(low <= threshold <= high for low, high in (one.interval for one in found))
    assert binom.cdf(count, 1000, 0.93) > FALSE_ALARMS
    assert abs(np.mean([math.log(one.difference / truth) for one in found])) < 0.1


REFERENCE = {"reference": BONE, "parameter": "c_e"}
RIGHT = {
    SameDifferent: {"a": BONE, "b": PVC}, ABX: {"reference": REAL, "foil": PVC, "match": PETTIGREW},
    ConstantStimuli: {**REFERENCE, "levels": (0.7, 1.1, 1.4)}, Staircase: REFERENCE, AdaptiveStaircase: REFERENCE,
}  # fmt: skip


def wrong(kind, **change):
    return lambda: kind(**{**RIGHT[kind], **change})


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
        (ValueError, lambda: adaptive().threshold([2.001], [True]), r"levels must be between 1.02 and 2, got 2.001"),
        (ValueError, lambda: adaptive().threshold([1.1], [True], level=95), r"level must be in \[0.5, 1\), got 95"),
        (ValueError, lambda: adaptive().threshold([1.1, 0.9], [True, True]), r"levels must be between 1.02 and 2, got 0.9"),
        (ValueError, wrong(SameDifferent, a=Stimulus("real bone")), r"a must have a material to be rendered, got the real specimen 'real bone'"),
        (ValueError, wrong(SameDifferent, b=Stimulus("real bone")), r"b must have a material to be rendered"),
        (ValueError, wrong(SameDifferent, b=BONE), r"a and b must have different names, got 'bone' twice"),
        (ValueError, wrong(SameDifferent, trials=10), r"trials must be a multiple of 4 \(AA, AB, BA, BB equally often\), got 10"),
        (ValueError, wrong(SameDifferent, trials=0), r"trials must be at least 4, got 0"),
        (ValueError, wrong(SameDifferent, blocks=5), r"trials must be a multiple of 5, the number of blocks, got 12"),
        (ValueError, wrong(SameDifferent, blocks=0), r"blocks must be at least 1, got 0"),
        (ValueError, wrong(SameDifferent, practice=-1), r"practice must be at least 0, got -1"),
        (ValueError, wrong(SameDifferent, interval=0.0), r"interval must be a time above 0 \[s\], got 0.0"),
        (ValueError, wrong(SameDifferent, interval=float("nan")), r"interval must be a time above 0 \[s\], got nan"),
        (ValueError, wrong(SameDifferent, mode="burning"), r"mode must be one of probing, drilling, got 'burning'"),
        (TypeError, wrong(SameDifferent, a=materials["bone"]), r"a must be a Stimulus, such as .*, got Material"),
        (TypeError, wrong(SameDifferent, trials=12.5), "float"),
        (ValueError, wrong(ABX, match=None), r"match must be given, as the reference 'real Pettigrew' is a real specimen"),
        (ValueError, wrong(ABX, match=Stimulus("resin")), r"match must have a material to be rendered, got the real specimen 'resin'"),
        (ValueError, wrong(ABX, foil=Stimulus("resin")), r"foil must have a material to be rendered, got the real specimen 'resin'"),
        (ValueError, wrong(ABX, foil=PETTIGREW), r"match and foil must have different names, got 'pettigrew' twice"),
        (ValueError, wrong(ABX, trials=9), r"trials must be a multiple of 2 \(AB and BA equally often\), got 9"),
        (ValueError, wrong(ABX, reference_interval=0), r"reference_interval must be a time above 0 \[s\], got 0"),
        *((TypeError, wrong(ABX, **{name: "bone"}),
            f"{name} must be a Stimulus, such as .*, got 'bone'") for name in RIGHT[ABX]),
        (ValueError, wrong(ConstantStimuli, reference=Stimulus("real")), r"reference must have a material to be rendered, got the real specimen 'real'"),
        (ValueError, wrong(ConstantStimuli, parameter="shape"), r"parameter must be one of c_e, alpha, got 'shape'"),
        (ValueError, wrong(ConstantStimuli, parameter="alpha"), r"mode must be 'drilling' for parameter 'alpha', got 'probing': alpha alone changes nothing with the burr off"),
        (ValueError, wrong(ConstantStimuli, parameter="alpha", mode="drilling", hold="sinking speed"), r"hold must be 'other' for parameter 'alpha'"),
        (ValueError, wrong(ConstantStimuli, hold="sinking speed"), r"hold must be 'other' for mode 'probing', got 'sinking speed': nothing sinks with the burr off"),
        (ValueError, wrong(ConstantStimuli, hold="force"), r"hold must be one of other, sinking speed, got 'force'"),
        (ValueError, wrong(ConstantStimuli, mode="both"), r"mode must be one of probing, drilling, got 'both'"),
        (ValueError, wrong(ConstantStimuli, levels=[]), r"levels must hold at least one, got none"),
        (ValueError, wrong(ConstantStimuli, levels=[1.0]), r"levels must differ from 1, got 1: two alike intervals have no correct answer"),
        (ValueError, wrong(ConstantStimuli, levels=[1.1, 0.0]), r"levels must be a ratio from 1e-6 to 1e6, got 0.0"),
        (ValueError, wrong(ConstantStimuli, levels=[float("nan")]), r"levels must be a ratio from 1e-6 to 1e6, got nan"),
        (ValueError, wrong(ConstantStimuli, levels=[1.1, 1.1]), r"levels must differ, got \(1.1, 1.1\)"),
        (ValueError, wrong(ConstantStimuli, repeats=3), r"repeats must be a multiple of 2 \(RC and CR equally often\), got 3"),
        (ValueError, wrong(ConstantStimuli, blocks=7), r"blocks must divide the 60 trials, got 7"),
        (ValueError, wrong(ConstantStimuli, blocks=0), r"blocks must be at least 1, got 0"),
        (ValueError, wrong(ConstantStimuli, practice=-1), r"practice must be at least 0, got -1"),
        (ValueError, wrong(ConstantStimuli, interval=0.0), r"interval must be a time above 0 \[s\], got 0.0"),
        (ValueError, wrong(ConstantStimuli, reference=Stimulus("x", Material("x", c_e=1.0, alpha=0.0))), r"reference must have alpha above 0, got 0"),
        (TypeError, wrong(ConstantStimuli, repeats=2.0), "float"),
        (ValueError, wrong(Staircase, start=1.0), r"start must differ from 1, got 1"),
        (ValueError, wrong(Staircase, limit=1.5), r"limit must be as far from 1 as start, 2, or farther, got 1.5"),
        (ValueError, wrong(Staircase, limit=0.2), r"limit must be as far from 1 as start, 2, or farther, got 0.2"),
        (ValueError, wrong(Staircase, step=1.0), r"step must be a factor above 1, got 1.0"),
        (ValueError, wrong(Staircase, coarse_step=float("inf")), r"coarse_step must be a factor above 1, got inf"),
        (ValueError, wrong(Staircase, up_weight=0.0), r"up_weight must be above 0, got 0.0"),
        (ValueError, wrong(Staircase, down=0), r"down must be at least 1, got 0"),
        (ValueError, wrong(Staircase, down=1), r"down and up_weight must aim above chance, 0.5, got 1 and 1, which aim at 0.5"),
        (ValueError, wrong(Staircase, discard=-1), r"discard must be at least 0, got -1"),
        (ValueError, wrong(Staircase, reversals=5), r"reversals must be a multiple of 2 \(peaks and valleys in pairs\), got 5"),
        (ValueError, wrong(Staircase, trials=0), r"trials must be at least 1, got 0"),
        (ValueError, wrong(Staircase, blocks=3), r"trials must be a multiple of 3, the number of blocks, got 80"),
        (ValueError, wrong(Staircase, parameter="alpha"), r"alpha alone changes nothing with the burr off"),
        (ValueError, wrong(AdaptiveStaircase, levels=(0.9, 2.0)), r"levels must be on one side of 1, the nearer first, got 0.9 and 2"),
        (ValueError, wrong(AdaptiveStaircase, levels=(2.0, 1.1)), r"levels must be on one side of 1, the nearer first, got 2 and 1.1"),
        (ValueError, wrong(AdaptiveStaircase, trials=0), r"trials must be at least 1, got 0"),
        (ValueError, wrong(AdaptiveStaircase, blocks=7), r"trials must be a multiple of 7, the number of blocks, got 60"),
        (ValueError, wrong(AdaptiveStaircase, parameter="alpha"), r"alpha alone changes nothing with the burr off"),
    ],
)  # fmt: skip
def test_refusals(kind, ask, sentence):
    refused((ask, sentence), error=kind)
