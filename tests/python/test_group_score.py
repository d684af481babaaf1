"""Scores of groups: their tests, and published means."""

from __future__ import annotations

import json
import math
from itertools import combinations, product

import numpy as np
import pytest
from group_scenes import (
    SAME_D_PRIME,
    most_errors,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from burrlab.psychophysics.group import (
    compare_conditions,
    compare_groups,
    group_score,
    label_test,
    sign_flip_test,
    t_test,
    welch_test,
)
from burrlab.psychophysics.published import group_score_from
from burrlab.psychophysics.rules import RULES, Counts, rule_of

DECISIONS = [(task, rule) for task in ("same-different", "abx") for rule in RULES] + [("2ifc", RULES[0])]


def same(hits: int, false_alarms: int, half: int = 6) -> Counts:
    return Counts("same-different", hits, half, false_alarms, half)


class TestSubjectTests:
    @settings(max_examples=40, deadline=None)
    @given(st.lists(st.integers(-12, 12), min_size=1, max_size=8), st.sampled_from(["greater", "two-sided"]))
    def test_signs_by_listing_all(self, doubled, side):
        values = np.array(doubled) / 2
        sums = np.array([np.dot(signs, values) for signs in product((-1, 1), repeat=len(values))])
        seen = np.sum(values)
        share = np.mean(sums >= seen - 1e-9) if side == "greater" else np.mean(abs(sums) >= abs(seen) - 1e-9)
        assert sign_flip_test(values, side=side).p_value == pytest.approx(share)

    @settings(max_examples=40, deadline=None)
    @given(
        st.lists(st.integers(0, 12), min_size=1, max_size=5),
        st.lists(st.integers(0, 12), min_size=1, max_size=5),
    )
    def test_divisions_by_listing_all(self, first, second):
        everyone = np.array(first + second, dtype=float)
        gaps = []
        for chosen in combinations(range(len(everyone)), len(first)):
            rest = np.delete(everyone, chosen)
            gaps.append(abs(np.mean(everyone[list(chosen)]) - np.mean(rest)))
        share = np.mean(np.array(gaps) >= abs(np.mean(first) - np.mean(second)) - 1e-9)
        assert label_test(first, second).p_value == pytest.approx(share)

    def test_t_is_scipys(self):
        x, y = [1.0, 2.5, -0.5, 3.0], [0.0, 0.5, 1.0]
        assert t_test(x).p_value == pytest.approx(stats.ttest_1samp(x, 0, alternative="greater").pvalue)
        assert t_test(x, side="two-sided").p_value == pytest.approx(stats.ttest_1samp(x, 0).pvalue)
        welch = stats.ttest_ind(x, y, equal_var=False)
        assert (welch_test(x, y).statistic, welch_test(x, y).p_value) == pytest.approx(
            (welch.statistic, welch.pvalue)
        )

    def test_no_scatter_is_no_t(self):
        for test in (
            t_test([1.0]),
            t_test([2.0, 2.0]),
            welch_test([1.0, 1.0], [2.0, 2.0]),
            welch_test([1.0], [2.0, 3.0]),
        ):
            assert test.p_value is None
            assert "not possible" in str(test)
        assert sign_flip_test([3.0] * 10).p_value == pytest.approx(2.0**-10)

    def test_many_subjects_are_still_exact(self):
        rng = np.random.default_rng(2)
        scores = rng.integers(3, 10, 60) - 6
        z = np.sum(scores) / math.sqrt(np.sum(scores**2))
        assert sign_flip_test(scores).p_value == pytest.approx(stats.norm.sf(z), abs=0.03)

    def test_refuses(self):
        with pytest.raises(
            ValueError, match=r"values must be one row with at least one value, got shape \(0,\)"
        ):
            t_test([])
        with pytest.raises(ValueError, match="values must be finite, got nan or infinity"):
            sign_flip_test([1.0, math.nan])
        with pytest.raises(ValueError, match="values must have at most 262144 different sums, got more"):
            sign_flip_test(np.sqrt(np.arange(2.0, 26.0)))
        with pytest.raises(ValueError, match="groups must have at most 262144 different sums, got more"):
            label_test(np.sqrt(np.arange(2.0, 14.0)), np.sqrt(np.arange(14.0, 27.0)))


class TestGroupScore:
    def test_by_hand(self):
        scores = [9, 10, 8, 12, 11]
        result = group_score([same(s // 2, 6 - (s - s // 2)) for s in scores])
        assert (result.mean, result.trials, result.chance, result.n) == (10.0, 12, 6.0, 5)
        assert result.sem == pytest.approx(math.sqrt(2.5 / 5))
        wide = 2.7764451 * result.sem
        assert result.interval == pytest.approx((10 - wide, 10 + wide))
        t, flip = result.tests
        assert t.p_value == pytest.approx(stats.ttest_1samp(scores, 6, alternative="greater").pvalue)
        assert flip.p_value == pytest.approx(1 / 32)
        assert str(result).startswith(
            "10.0 +- 0.7 of 12, 5 subjects; t test: t(4) = 5.66, p = 0.0024; sign-flip test: p = 0.031"
        )
        assert json.loads(json.dumps(result.to_dict()))["tests"][1]["statistic"] is None

    def test_unlike_trials_are_proportions(self):
        result = group_score([same(5, 1), Counts("same-different", 4, 4, 0, 4), same(6, 2)])
        assert result.trials is None
        assert result.mean == pytest.approx((10 / 12 + 1.0 + 10 / 12) / 3)
        assert result.chance == 0.5
        assert "0.889 +- 0.056 correct" in str(result)

    def test_one_subject(self):
        result = group_score([same(5, 1)])
        assert result.sem is None
        assert result.interval is None
        assert str(result).startswith("10.0 of 12, 1 subject; t test: not possible")

    def test_conditions_of_the_same_subjects(self):
        first, second = [same(5, 1), same(6, 2), same(6, 0)], [same(4, 2), same(4, 2), same(5, 2)]
        result = compare_conditions(first, second)
        gaps = np.array([2, 2, 3]) / 12
        assert result.difference == pytest.approx(np.mean(gaps))
        expected = stats.ttest_1samp(gaps, 0)
        assert result.tests[0].p_value == pytest.approx(expected.pvalue)
        assert result.interval == pytest.approx(tuple(expected.confidence_interval(0.95)))
        assert result.tests[1].p_value == pytest.approx(0.25)
        assert "3 subjects in both" in str(result)
        assert json.dumps(result.to_dict())

    def test_groups(self):
        first, second = [same(5, 1), same(6, 2), same(6, 0)], [same(4, 2), same(4, 3)]
        result = compare_groups(first, second)
        expected = stats.ttest_ind([10 / 12, 10 / 12, 1.0], [8 / 12, 7 / 12], equal_var=False)
        assert result.tests[0].p_value == pytest.approx(expected.pvalue)
        assert result.interval == pytest.approx(tuple(expected.confidence_interval(0.95)))
        assert result.tests[1].p_value == pytest.approx(0.1)
        assert "3 and 2 subjects" in str(result)

    def test_refuses(self):
        with pytest.raises(ValueError, match="counts must hold a subject, got none"):
            group_score([])
        with pytest.raises(ValueError, match="counts must be of one task, got abx and same-different"):
            group_score([same(1, 1), Counts("abx", 1, 2, 1, 2)])
        with pytest.raises(ValueError, match=r"level must be in \[0.5, 1\), got 0.2"):
            group_score([same(1, 1)], level=0.2)
        with pytest.raises(ValueError, match="both conditions must have the same subjects, got 1 and 2"):
            compare_conditions([same(1, 1)], [same(1, 1)] * 2)
        with pytest.raises(ValueError, match="counts must hold a subject, got none"):
            compare_groups([same(1, 1)], [])

    @pytest.mark.slow
    @pytest.mark.parametrize("kind", SAME_D_PRIME)
    def test_error_rate_at_chance(self, kind):
        """Guessing with any criterion: 10 000 experiments, both tests; false alarm 1e-6."""
        rng, rejected = np.random.default_rng(8), np.zeros(2)
        rates = SAME_D_PRIME[kind](rng, (10_000, 12))
        hits, alarms = rng.binomial(6, rates), rng.binomial(6, rates)
        for h, f in zip(hits, alarms, strict=True):
            above = h - f  # score less half of the trials
            t = t_test(above).p_value
            rejected += [t is not None and t <= 0.05, sign_flip_test(above).p_value <= 0.05]
        assert rejected[1] <= most_errors(0.05, 10_000)
        assert rejected[0] <= most_errors(0.05 if kind != "biased" else 0.06, 10_000)


class TestPublishedScore:
    def test_the_papers_first_task(self):
        paper = group_score_from(mean=9.3, sem=0.4, n=20, trials=12)
        assert paper.t == pytest.approx(8.25)
        assert paper.p_value == pytest.approx(stats.t.sf(8.25, 19))
        assert paper.spread == pytest.approx(0.4 * math.sqrt(20))
        assert paper.binomial_spread == pytest.approx(math.sqrt(12 * 0.775 * 0.225))
        assert paper.interval == pytest.approx((9.3 - 2.0930241 * 0.4, 9.3 + 2.0930241 * 0.4))
        low, high = paper.spread_p_range
        assert low < 0.01 < paper.spread_p_value < 0.1 < high  # 0.4 may be 0.35 or 0.45
        assert "depends on the rounding" in str(paper)

    def test_spread_beyond_chance(self):
        assert "subjects differ, in d' or in bias" in str(
            group_score_from(mean=9.6, sem=0.5, n=20, trials=12)
        )
        assert "may be alike" in str(group_score_from(mean=9.4, sem=0.4, n=5, trials=10, task="abx"))

    @pytest.mark.parametrize(("mean", "sem", "trials"), [(9.3, 0.4, 12), (9.6, 0.5, 12), (5.02, 0.4, 10)])
    def test_spread_over_all_that_is_printed_so(self, mean, sem, trials):
        """The mean is rounded as well, and chance's variance with it."""
        ends = []
        for m in np.linspace(mean - 0.05, mean + 0.05, 101):
            for s in (sem - 0.05, sem + 0.05):
                ends.append(stats.chi2.sf(19 * 20 * s**2 / (m * (1 - m / trials)), 19))
        found = group_score_from(mean=mean, sem=sem, n=20, trials=trials).spread_p_range
        assert found == pytest.approx((min(ends), max(ends)), rel=1e-3)

    def test_a_mean_that_may_be_perfect_has_no_chance(self):
        assert group_score_from(mean=9.98, sem=0.1, n=5, trials=10).spread_p_range[0] == 0.0

    def test_unlike_criteria_alone_give_such_a_spread(self):
        """Why the sentence does not say that d' differs: at one d' of 5 a third hardly ever says "different", and 9.6 +- 0.5 comes out."""
        rule = rule_of("same-different", "differencing")
        hit, alarm = rule.rates(5.0, rule.criterion_of(5.0, [1e-6, 0.1]))
        mean, variance = 6 * (hit + 1 - alarm), 6 * (hit * (1 - hit) + alarm * (1 - alarm))
        share = np.array([1 / 3, 2 / 3])
        spread = math.sqrt(share @ (variance + mean**2) - (share @ mean) ** 2)
        assert share @ mean == pytest.approx(9.6, abs=0.1)
        assert spread / math.sqrt(20) == pytest.approx(0.5, abs=0.05)

    @pytest.mark.parametrize("rule", RULES)
    def test_d_prime_of_the_mean(self, rule):
        estimate, low, high = group_score_from(mean=9.3, sem=0.4, n=20, trials=12).d_prime[rule]
        decision = rule_of("same-different", rule)
        assert float(decision.proportion_correct(estimate)) == pytest.approx(0.775)
        assert low < estimate < high

    def test_guessers_give_mean_and_spread(self):
        paper = group_score_from(mean=9.6, sem=0.5, n=20, trials=12)
        w = paper.guessers
        p = 0.5 + (0.8 - 0.5) / (1 - w)
        mean = 12 * (w * 0.5 + (1 - w) * p)
        between = 144 * (w * 0.25 + (1 - w) * p**2) - mean**2
        within = 12 * (w * 0.25 + (1 - w) * p * (1 - p))
        assert (mean, math.sqrt(between + within)) == pytest.approx((9.6, paper.spread))

    def test_ends_of_the_scale(self):
        paper = group_score_from(mean=9.9, sem=0.1, n=5, trials=10, task="abx")
        assert paper.interval[1] == 10
        assert paper.d_prime["differencing"][2] == math.inf
        assert json.loads(json.dumps(paper.to_dict(), allow_nan=False))["d_prime"]["differencing"][2] is None
        at_chance = group_score_from(mean=5.0, sem=0.3, n=5, trials=10)
        assert at_chance.d_prime["differencing"][0] == 0.0

    def test_refuses(self):
        good = {"mean": 9.3, "sem": 0.4, "n": 20, "trials": 12}
        with pytest.raises(ValueError, match="n and trials must be at least 2, got 1 and 12"):
            group_score_from(**good | {"n": 1})
        with pytest.raises(ValueError, match="mean must be between 0 and 12, got 13"):
            group_score_from(**good | {"mean": 13.0})
        with pytest.raises(
            ValueError, match=r"sem must be above rounding, which is at least 0, got 0.05 and 0.05"
        ):
            group_score_from(**good | {"sem": 0.05})
        with pytest.raises(ValueError, match="sem must be above rounding"):
            group_score_from(**good, rounding=-0.1)
        with pytest.raises(ValueError, match="task must be one of"):
            group_score_from(**good, task="oddity")
        with pytest.raises(ValueError, match=r"level must be in \[0.5, 1\), got 2"):
            group_score_from(**good, level=2)
