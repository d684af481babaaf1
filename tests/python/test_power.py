"""What a design can show, and equivalence: against enumeration, simulation and the definitions."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from group_scenes import SAME_D_PRIME, answers_of, most_errors, rejections
from scipy import stats

from burrlab.psychophysics.group import group_d_prime
from burrlab.psychophysics.power import (
    Observer,
    critical_score,
    decision_text,
    design_power,
    equivalence,
    subjects_needed,
    trials_needed,
)
from burrlab.psychophysics.published import _power, tost
from burrlab.psychophysics.rules import RULES, Counts, rule_of


class TestOneSubject:
    def test_score_that_guessing_seldom_reaches(self):
        assert critical_score(12, 0.05) == (10, pytest.approx(79 / 4096))
        assert critical_score(10, 0.05) == (9, pytest.approx(11 / 1024))
        assert critical_score(4, 0.05) == (None, 0.0)
        assert critical_score(4, 1 / 16) == (4, pytest.approx(1 / 16))

    @pytest.mark.parametrize("task", ["same-different", "abx", "2ifc"])
    @pytest.mark.parametrize("rule", RULES)
    def test_by_enumeration(self, task, rule):
        row = design_power(task, trials=12, rules=[rule], d_primes=[2.0], lapse=0.1).rows[0]
        hit, alarm = (0.9 * float(r) + 0.05 for r in rule_of(task, rule).rates(2.0))
        power = mean = 0.0
        for h in range(7):
            for f in range(7):
                p = stats.binom.pmf(h, 6, hit) * stats.binom.pmf(f, 6, alarm)
                power += p * (h + 6 - f >= 10)
                mean += p * (h + 6 - f)
        assert (row.subject, row.score) == pytest.approx((power, mean))
        assert row.group is None

    def test_guessing_is_the_error_rate(self):
        result = design_power("abx", trials=20, d_primes=[0.0])
        assert result.rows[0].subject == pytest.approx(result.error_rate)
        assert result.error_rate <= 0.05

    def test_always_lapsing_is_guessing(self):
        near = design_power("abx", trials=20, d_primes=[3.0], lapse=0.999999).rows[0]
        assert near.score == pytest.approx(10.0, abs=1e-4)


class TestGroup:
    def test_power_by_scipys_t(self):
        """1000 groups of 12, answers drawn by another path; false alarm 1e-6 of twice the standard error of both."""
        row = design_power(
            "same-different", trials=12, subjects=12, rules=["differencing"], d_primes=[1.5], lapse=0.0
        ).rows[0]
        rng, decision = np.random.default_rng(12), rule_of("same-different", "differencing")
        alarm = np.full((1000, 12), float(decision.rates(1.5)[1]))
        hits, answers = answers_of("same-different", "differencing", 1.5, alarm, 6, rng)
        p = stats.ttest_1samp(2 * hits - answers, 0.0, axis=1, alternative="greater").pvalue
        found, error = np.mean(p <= 0.05), math.sqrt(row.group * (1 - row.group) * (1 / 1000 + 1 / 4000))
        assert abs(found - row.group) < stats.norm.isf(0.5e-6) * error

    def test_guessing_groups_are_found_above_chance_as_stated(self):
        """The t test's error rate with scores of 12: at most 5 %, false alarm 1e-6."""
        row = design_power(
            "same-different", trials=12, subjects=12, rules=["differencing"], d_primes=[0.0], lapse=0.0
        ).rows[0]
        assert row.group <= (stats.binom.isf(1e-6, 4000, 0.05)) / 4000

    def test_scores_without_scatter(self):
        assert Observer(rule_of("abx", RULES[0]), 60.0, 10, 0.0).group(5, 0.05) == 1.0  # 2^-5
        assert Observer(rule_of("abx", RULES[0]), 60.0, 10, 0.0).group(4, 0.05) == 0.0

    def test_same_every_time(self):
        first, second = (design_power("abx", trials=10, subjects=5, delta=2.0) for _ in range(2))
        assert first == second

    def test_twelve_by_twelve(self):
        """Decides Delta = 1.5 and not 1: both rules, unbiased, 2 % lapses."""
        for delta, enough in ((1.5, True), (1.0, False)):
            for row in design_power(
                "same-different", trials=12, subjects=12, d_primes=[], delta=delta
            ).equivalence:
                assert (row.power >= 0.8) == enough
                assert 1.2 < row.decidable_delta < 1.5


class TestText:
    def test_group(self):
        text = str(design_power("same-different", trials=12, subjects=12, d_primes=[1, 2], delta=1.0))
        assert text.startswith(
            "same-different, 12 trials, 12 subjects; unbiased, 2 % lapses; tests at 5 %, one-sided\n"
            "a subject is above chance from 10 of 12 (by guessing 1.9 %)\n"
        )
        assert "score subject group" in text
        assert (
            "equivalence (differencing): 12 subjects x 12 trials cannot be relied on to decide Delta = 1: the power is"
            in text
        )
        assert len({len(line) for line in text.splitlines()[2:6]}) == 1

    def test_subject(self):
        text = str(design_power("abx", trials=10, d_primes=[1]))
        assert "1 subject;" in text
        assert "group" not in text

    def test_too_few_trials(self):
        assert "no score of one subject is above chance: too few trials" in str(design_power("abx", trials=4))

    def test_json(self):
        out = design_power("abx", trials=4, d_primes=[1], delta=2.0).to_dict()
        assert json.loads(json.dumps(out, allow_nan=False))["equivalence"][0]["decidable_delta"] is None


class TestSize:
    def test_subjects_for_a_d_prime(self):
        n = subjects_needed("same-different", rule="differencing", trials=12, d_prime=1.5)
        powers = [
            design_power("same-different", trials=12, subjects=k, rules=["differencing"], d_primes=[1.5])
            .rows[0]
            .group
            for k in (n - 1, n)
        ]
        assert powers[0] < 0.8 <= powers[1]

    def test_subjects_for_equivalence(self):
        n = subjects_needed("same-different", rule="differencing", trials=12, delta=1.5)
        powers = [
            design_power(
                "same-different", trials=12, subjects=k, rules=["differencing"], d_primes=[], delta=1.5
            )
            .equivalence[0]
            .power
            for k in (n - 1, n)
        ]
        assert powers[0] < 0.8 <= powers[1]
        assert n <= 12

    def test_trials_of_one_subject(self):
        """The power of all larger numbers is enough too."""
        n = trials_needed("same-different", rule="independent-observations", d_prime=2.0)
        assert n % 4 == 0
        decision = rule_of("same-different", "independent-observations")

        def power(trials: int) -> float:
            return Observer(decision, 2.0, trials, 0.02).from_score(critical_score(trials, 0.05)[0])

        assert power(n - 4) < 0.8
        assert all(power(k) >= 0.8 for k in range(n, n + 80, 4))

    def test_trials_of_a_group(self):
        n = trials_needed("abx", rule="differencing", subjects=12, d_prime=1.0)
        assert n % 2 == 0
        powers = [
            design_power("abx", trials=k, subjects=12, rules=["differencing"], d_primes=[1.0]).rows[0].group
            for k in (n - 2, n)
        ]
        assert powers[0] < 0.8 <= powers[1]
        assert trials_needed("same-different", rule="differencing", subjects=12, delta=1.0) % 4 == 0

    def test_not_even_so_many(self):
        assert subjects_needed("abx", rule="differencing", trials=4, d_prime=0.2, most=40) is None
        assert trials_needed("abx", rule="differencing", d_prime=0.1, most=200) is None
        assert trials_needed("abx", rule="differencing", subjects=2, delta=0.3, most=100) is None


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
        for delta in (0.0, math.nan, math.inf):
            with pytest.raises(ValueError, match=f"delta must be a number above 0, got {delta}"):
                equivalence(GUESSING, rule="differencing", delta=delta)

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


@pytest.mark.parametrize(
    ("kind", "ask", "sentence"),
    [
        (ValueError, lambda: subjects_needed("abx", rule="differencing", trials=10), "d_prime or delta must be given, not both, got None and None"),
        (ValueError, lambda: trials_needed("abx", rule="differencing", d_prime=1.0, delta=2.0), r"d_prime or delta must be given, not both, got 1\.0 and 2\.0"),
        (ValueError, lambda: subjects_needed("abx", rule="differencing", trials=10, d_prime=1.0, power=1.0), r"power must be in \(0, 1\), got 1"),
        (ValueError, lambda: subjects_needed("abx", rule="differencing", trials=9, d_prime=1.0), "trials must be even and at least 2, got 9"),
        (ValueError, lambda: trials_needed("abx", rule="differencing", subjects=0, d_prime=1.0), "subjects must be at least 1, got 0"),
        (ValueError, lambda: design_power("oddity", trials=12), r"task must be one of .*, got 'oddity'"),
        (ValueError, lambda: design_power("abx", trials=12, rules=["none"]), r"rule must be one of .*, got 'none'"),
        (ValueError, lambda: design_power("abx", trials=12, rules=[]), "rules must hold a rule, got none"),
        (ValueError, lambda: design_power("abx", trials=0), "trials must be even and at least 2, got 0"),
        (ValueError, lambda: design_power("abx", trials=12, subjects=0), "subjects must be at least 1, got 0"),
        (ValueError, lambda: design_power("abx", trials=12, d_primes=[-1]), "d_primes must be at least 0 and finite, got -1"),
        (ValueError, lambda: design_power("abx", trials=12, level=0.0), r"level must be in \(0, 0.5\], got 0"),
        (ValueError, lambda: design_power("abx", trials=12, lapse=1.0), r"lapse must be in \[0, 1\), got 1"),
        (ValueError, lambda: design_power("abx", trials=12, delta=0.0), "delta must be a number above 0, got 0"),
        (ValueError, lambda: equivalence([], rule="differencing", delta=1.0), "counts must hold a subject, got none"),
        (ValueError, lambda: equivalence([same(1, 1), Counts("abx", 1, 2, 1, 2)], rule="differencing", delta=1.0), "counts must be of one task, got abx and same-different"),
        (ValueError, lambda: equivalence(GUESSING, rule="none", delta=1.0), r"rule must be one of .*, got 'none'"),
        (ValueError, lambda: equivalence(GUESSING, rule="differencing", delta=1.0, level=0.3), r"level must be in \[0.5, 1\), got 0.3"),
        (ValueError, lambda: tost([1.0], delta=1.0), "values must hold at least 2, got 1"),
        (ValueError, lambda: tost([1.0, math.inf], delta=1.0), "values must be finite, got nan or infinity"),
        (ValueError, lambda: tost([1.0, 1.0], delta=2.0), "values must differ, got the same one for all"),
        (ValueError, lambda: tost([1.0, 2.0], delta=-1.0), "delta must be a number above 0, got -1"),
        (ValueError, lambda: tost([1.0, 2.0], delta=1.0, level=1.0), r"level must be in \[0.5, 1\), got 1"),
    ],
)  # fmt: skip
def test_refusals_by_their_sentence(kind, ask, sentence):
    with pytest.raises(kind, match=sentence):
        ask()
