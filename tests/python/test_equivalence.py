"""Equivalence of d' and of signed quantities: decisions, error rates at the boundary, power."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from group_scenes import SAME_D_PRIME, most_errors, rejections
from scipy import stats

from burrlab.psychophysics.group import group_d_prime
from burrlab.psychophysics.power import decision_text, equivalence
from burrlab.psychophysics.published import _power, tost
from burrlab.psychophysics.rules import RULES, Counts


def same(hits: int, false_alarms: int, half: int = 6) -> Counts:
    return Counts("same-different", hits, half, false_alarms, half)


GUESSING = [same(2, 2), same(1, 2), same(3, 2)] * 4


class TestDecision:
    @pytest.mark.parametrize("rule", RULES)
    def test_twelve_by_twelve_decide_one_and_a_half_but_not_one(self, rule):
        yes, no = (equivalence(GUESSING, rule=rule, delta=d) for d in (1.5, 1.0))
        assert yes.equivalent
        assert yes.power > 0.8
        assert "would decide Delta = 1.5" in str(yes)
        assert str(yes).startswith(f"Equivalent: below 1.5 in d' ({rule}), upper bound")
        assert not no.equivalent
        assert no.power < 0.45
        assert "12 subjects x 12 trials cannot be relied on to decide Delta = 1: the power is" in str(no)
        assert "That does not show a difference" in no.sentence
        assert 1.0 < no.decidable_delta < 1.5
        assert no.decidable_delta == yes.decidable_delta

    def test_bound_and_p_value_agree(self):
        for group in (GUESSING, [same(3, 2)] * 3, [same(4, 1), same(3, 3), same(5, 2)], [same(8, 8, 24)]):
            bound = equivalence(group, rule="differencing", delta=1.0).upper
            if math.isinf(bound):
                continue
            assert not equivalence(group, rule="differencing", delta=bound - 0.01).equivalent
            assert equivalence(group, rule="differencing", delta=bound + 0.01).equivalent

    def test_bound_is_that_of_the_groups_interval(self):
        """One-sided 97.5 % is an end of the two-sided 95 %."""
        one_sided = equivalence(GUESSING, rule="differencing", delta=1.0, level=0.975)
        assert one_sided.upper == pytest.approx(
            group_d_prime(GUESSING, rule="differencing").interval[1], abs=1e-5
        )

    def test_always_the_same_answer_is_not_equivalence(self):
        result = equivalence([same(0, 0)] * 12, rule="differencing", delta=3.0)
        assert not result.equivalent
        assert result.p_value == 1.0
        assert (result.upper, result.power, result.decidable_delta) == (math.inf, 0.0, math.inf)
        assert "nothing is known of d'" in result.sentence
        assert "no Delta has 80 %" in result.design_sentence
        assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["upper"] is None

    def test_who_gave_one_answer_is_named(self):
        result = equivalence([*GUESSING, same(0, 0), same(6, 6)], rule="differencing", delta=1.5)
        assert result.equivalent
        assert "2 of 14 subjects gave one answer only: nothing is known of theirs" in result.sentence

    def test_below_chance_is_named(self):
        result = equivalence([same(0, 4), same(1, 5), same(0, 5), same(1, 4)], rule="differencing", delta=1.0)
        assert result.p_below_chance < 0.01
        assert "were answers swapped?" in result.sentence

    def test_bias_widens_the_bound(self):
        """The same score, 6 of 12, tells less when nearly all answers are alike."""
        bounds = [
            equivalence([same(h, h)] * 8, rule="independent-observations", delta=1.0).upper for h in (3, 1)
        ]
        assert bounds[0] < bounds[1]

    @pytest.mark.parametrize("rule", RULES)
    def test_one_subject(self, rule):
        result = equivalence([same(3, 3)], rule=rule, delta=1.5)
        assert not result.equivalent
        assert "1 subject x 12 trials cannot be relied on to decide" in result.design_sentence
        many = equivalence([same(40, 40, 100)], rule=rule, delta=1.5)
        assert many.equivalent

    def test_unlike_trials(self):
        result = equivalence([same(2, 2), same(9, 8, 24)], rule="differencing", delta=1.0)
        assert "2 subjects x 12 to 48 trials" in result.design_sentence

    def test_power_is_the_share_that_decides(self):
        """Groups that guess and give these numbers of answers, each tested anew."""
        group, rng = [same(2, 2), same(3, 3), same(1, 2), same(2, 4)] * 3, np.random.default_rng(4)
        stated = equivalence(group, rule="differencing", delta=1.5).power
        decided = 0
        for _ in range(150):
            hits = [rng.hypergeometric(6, 6, c.hits + c.false_alarms) for c in group]
            again = [same(h, c.hits + c.false_alarms - h) for h, c in zip(hits, group, strict=True)]
            decided += group_d_prime(again, rule="differencing", level=0.9).interval[1] < 1.5
        assert stats.binomtest(decided, 150, stated).pvalue > 1e-6

    def test_refuses(self):
        with pytest.raises(ValueError, match="counts must hold a subject, got none"):
            equivalence([], rule="differencing", delta=1.0)
        with pytest.raises(ValueError, match="counts must be of one task, got abx and same-different"):
            equivalence([same(1, 1), Counts("abx", 1, 2, 1, 2)], rule="differencing", delta=1.0)
        with pytest.raises(ValueError, match=r"rule must be one of .*, got 'none'"):
            equivalence(GUESSING, rule="none", delta=1.0)
        for delta in (0.0, math.nan, math.inf):
            with pytest.raises(ValueError, match=f"delta must be a number above 0, got {delta}"):
                equivalence(GUESSING, rule="differencing", delta=delta)
        with pytest.raises(ValueError, match=r"level must be in \[0.5, 1\), got 0.3"):
            equivalence(GUESSING, rule="differencing", delta=1.0, level=0.3)

    def test_decision_in_words(self):
        assert decision_text("2 subjects", 1.0, 0.8, 0.9) == (
            "2 subjects would decide Delta = 1 with a power of 80 % if d' were 0; 80 % begin at Delta = 0.9."
        )


class TestErrorRate:
    """d' is Delta: called equivalent in at most 5 % of experiments; false alarm of each check 1e-6."""

    @pytest.mark.parametrize("rule", RULES)
    def test_quick(self, rule):
        errors, _ = rejections(
            "same-different",
            rule,
            1.0,
            SAME_D_PRIME["each his own"],
            subjects=12,
            trials=12,
            experiments=2000,
        )
        assert errors <= most_errors(0.05, 2000)

    @pytest.mark.slow
    @pytest.mark.parametrize("rule", RULES)
    @pytest.mark.parametrize("kind", SAME_D_PRIME)
    @pytest.mark.parametrize("delta", [1.0, 1.5])
    def test_twelve_by_twelve(self, rule, kind, delta):
        errors, _ = rejections(
            "same-different",
            rule,
            delta,
            SAME_D_PRIME[kind],
            subjects=12,
            trials=12,
            experiments=10_000,
            seed=7,
        )
        assert errors <= most_errors(0.05, 10_000)


class TestSigned:
    def test_by_hand(self):
        values = np.array([0.1, -0.2, 0.05, 0.0, 0.15, -0.1])
        result = tost(values, delta=0.2)
        low = stats.ttest_1samp(values, -0.2, alternative="greater").pvalue
        high = stats.ttest_1samp(values, 0.2, alternative="less").pvalue
        assert result.p_value == pytest.approx(max(low, high))
        ends = stats.ttest_1samp(values, 0).confidence_interval(0.9)
        assert result.interval == pytest.approx(tuple(ends))
        assert result.equivalent
        assert "6 subjects would decide Delta = 0.2" in str(result)
        assert "if the mean were 0" in str(result)
        assert json.dumps(result.to_dict(), allow_nan=False)

    def test_decides_as_its_interval(self):
        rng = np.random.default_rng(3)
        for _ in range(200):
            result = tost(rng.normal(0.3, 0.5, 8), delta=0.5)
            low, high = result.interval
            assert result.equivalent == (low > -0.5 and high < 0.5)
            assert ("Not shown" in result.sentence) != result.equivalent

    def test_power_by_simulation(self):
        """10 000 experiments; false alarm 1e-6."""
        rng = np.random.default_rng(9)
        x = rng.standard_normal((10_000, 8))
        mean, error = np.mean(x, axis=1), np.std(x, axis=1, ddof=1) / math.sqrt(8)
        for delta in (1.0, 2.5, 4.0):
            decided = np.abs(mean) + stats.t.ppf(0.95, 7) * error < delta / math.sqrt(8)
            assert stats.binomtest(int(np.sum(decided)), 10_000, _power(delta, 8, 0.95)).pvalue > 1e-6

    def test_decidable_delta_has_the_power(self):
        result = tost([0.1, -0.2, 0.05, 0.0, 0.15, -0.1], delta=0.1)
        assert _power(result.decidable_delta / result.sem, 6, 0.95) == pytest.approx(0.8, abs=1e-3)
        assert result.power < 0.8
        assert "cannot be relied on to decide Delta = 0.1" in result.design_sentence

    def test_error_rate_at_the_boundary(self):
        """10 000 experiments with a mean of delta; false alarm 1e-6."""
        rng = np.random.default_rng(10)
        x = rng.normal(1.0, 0.7, (10_000, 12))
        mean, error = np.mean(x, axis=1), np.std(x, axis=1, ddof=1) / math.sqrt(12)
        decided = np.abs(mean) + stats.t.ppf(0.95, 11) * error < 1.0
        assert tost(x[0], delta=1.0).equivalent == decided[0]
        assert np.sum(decided) <= most_errors(0.05, 10_000)

    def test_refuses(self):
        with pytest.raises(ValueError, match="values must hold at least 2, got 1"):
            tost([1.0], delta=1.0)
        with pytest.raises(ValueError, match="values must be finite, got nan or infinity"):
            tost([1.0, math.inf], delta=1.0)
        with pytest.raises(ValueError, match="values must differ, got the same one for all"):
            tost([1.0, 1.0], delta=2.0)
        with pytest.raises(ValueError, match="delta must be a number above 0, got -1"):
            tost([1.0, 2.0], delta=-1.0)
        with pytest.raises(ValueError, match=r"level must be in \[0.5, 1\), got 1"):
            tost([1.0, 2.0], delta=1.0, level=1.0)
