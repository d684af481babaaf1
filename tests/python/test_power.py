"""What a design can show: exact for one subject, simulated for groups."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from group_scenes import answers_of
from scipy import stats

from burrlab.psychophysics.power import Observer, critical_score, design_power, subjects_needed, trials_needed
from burrlab.psychophysics.rules import RULES, rule_of


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
        assert Observer(rule_of("abx", RULES[0]), 60.0, 10, 0.0).group(1, 0.05) == 0.0

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

    def test_refuses(self):
        with pytest.raises(ValueError, match="d_prime or delta must be given, not both, got None and None"):
            subjects_needed("abx", rule="differencing", trials=10)
        with pytest.raises(ValueError, match=r"d_prime or delta must be given, not both, got 1\.0 and 2\.0"):
            trials_needed("abx", rule="differencing", d_prime=1.0, delta=2.0)
        with pytest.raises(ValueError, match=r"power must be in \(0, 1\), got 1"):
            subjects_needed("abx", rule="differencing", trials=10, d_prime=1.0, power=1.0)
        with pytest.raises(ValueError, match="trials must be even and at least 2, got 9"):
            subjects_needed("abx", rule="differencing", trials=9, d_prime=1.0)
        with pytest.raises(ValueError, match="subjects must be at least 1, got 0"):
            trials_needed("abx", rule="differencing", subjects=0, d_prime=1.0)


class TestRefuses:
    def test_design(self):
        with pytest.raises(ValueError, match=r"task must be one of .*, got 'oddity'"):
            design_power("oddity", trials=12)
        with pytest.raises(ValueError, match=r"rule must be one of .*, got 'none'"):
            design_power("abx", trials=12, rules=["none"])
        with pytest.raises(ValueError, match="rules must hold a rule, got none"):
            design_power("abx", trials=12, rules=[])
        with pytest.raises(ValueError, match="trials must be even and at least 2, got 0"):
            design_power("abx", trials=0)
        with pytest.raises(ValueError, match="subjects must be at least 1, got 0"):
            design_power("abx", trials=12, subjects=0)
        with pytest.raises(ValueError, match="d_primes must be at least 0 and finite, got -1"):
            design_power("abx", trials=12, d_primes=[-1])
        with pytest.raises(ValueError, match=r"level must be in \(0, 0.5\], got 0"):
            design_power("abx", trials=12, level=0.0)
        with pytest.raises(ValueError, match=r"lapse must be in \[0, 1\), got 1"):
            design_power("abx", trials=12, lapse=1.0)
        with pytest.raises(ValueError, match="delta must be a number above 0, got 0"):
            design_power("abx", trials=12, delta=0.0)
