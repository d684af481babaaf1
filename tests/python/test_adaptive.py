"""The Bayesian staircase: least expected entropy, deterministic, and intervals that hold the threshold."""

from __future__ import annotations

import json
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from burrlab import materials
from burrlab.psychophysics.psychometric import ThresholdPosterior, posterior_threshold, proportion_correct
from burrlab.psychophysics.staircase import AdaptiveStaircase, gaussian_correct
from burrlab.psychophysics.trial import Stimulus

BONE = Stimulus("bone", materials["bone"])
FALSE_ALARMS = 1e-6
NEAR, FAR = math.log(1.02), math.log(2.0)


def adaptive(parameter="c_e", **options):
    return AdaptiveStaircase(BONE, parameter, **options)


def run(order, right):
    """Answers by `right(level)`; the trials."""
    trials = []
    while (trial := order.next()) is not None:
        trials.append(trial)
        wrong = next(a for a in ("first", "second") if a != trial.correct)
        order.answer(trial.correct if right(trial.level) else wrong)
    return trials


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
def test_the_same_answers_give_the_same_trials(seed, answers):
    design = adaptive(trials=10, practice=2, blocks=2)
    made = []
    for _ in range(2):
        given_answers = iter(answers)
        made.append(run(design.order(seed=seed, subject="01"), lambda _, a=given_answers: next(a)))
    assert made[0] == made[1]
    assert [t.phase for t in made[0]] == ["practice"] * 2 + ["main"] * 10
    assert [t.level for t in made[0][:2]] == [pytest.approx(2.0)] * 2
    assert [t.block for t in made[0]] == [0] * 2 + [1] * 5 + [2] * 5


def test_orders_and_seeds_do_not_depend_on_the_answers():
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


def test_below_one_mirrors_above():
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


def test_written_and_said():
    design = adaptive("alpha", mode="drilling", trials=20)
    written = json.loads(json.dumps(design.to_dict()))
    assert (written["design"], written["levels"], written["trials"]) == ("adaptive", [1.02, 2.0], 20)
    assert "1/ms" not in written["held"]
    found = adaptive().threshold([1.5, 1.2], [True, False])
    assert json.loads(json.dumps(found.to_dict()))["trials"] == 2
    assert "75 % correct at a ratio of" in str(found)
    assert "20 trials" in design.power(5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"levels": (1.0, 2.0)}, r"levels must differ from 1, got 1"),
        ({"levels": (0.0, 2.0)}, r"levels must be a ratio above 0, got 0.0"),
        ({"levels": (0.9, 2.0)}, r"levels must be on one side of 1, the nearer first, got 0.9 and 2"),
        ({"levels": (2.0, 1.1)}, r"levels must be on one side of 1, the nearer first, got 2 and 1.1"),
        ({"trials": 0}, r"trials must be at least 1, got 0"),
        ({"blocks": 7}, r"trials must be a multiple of 7, the number of blocks, got 60"),
        ({"parameter": "alpha"}, r"alpha alone changes nothing with the burr off"),
    ],
)  # fmt: skip
def test_wrong_values_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        AdaptiveStaircase(**{"reference": BONE, "parameter": "c_e", **change})


def test_wrong_types_are_named():
    with pytest.raises(TypeError, match=r"reference must be a Stimulus"):
        AdaptiveStaircase(materials["bone"], "c_e")
    with pytest.raises(TypeError, match="float"):
        adaptive(trials=20.5)


def test_wrong_answers_are_named():
    with pytest.raises(ValueError, match=r"levels must be between 1.02 and 2, got 0.9"):
        adaptive().threshold([0.9], [True])
    with pytest.raises(ValueError, match=r"levels and correct must be equally many, got 1 and 0"):
        adaptive().threshold([1.1], [])
    with pytest.raises(ValueError, match=r"level must be between 0 and 1, got 95"):
        adaptive().threshold([1.1], [True], level=95)
    with pytest.raises(ValueError, match=r"levels must be on one side of 1, got some below and some above"):
        posterior_threshold(0.01, 1.0, [1.1, 0.9], [True, True])
