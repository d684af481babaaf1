"""Do intervals of d' hold the truth as often as they say? By enumeration of all outcomes, no simulation."""

from __future__ import annotations

import numpy as np
import pytest

from burrlab.psychophysics.rules import RULES, Counts, rule_of
from burrlab.psychophysics.sensitivity import d_prime
from reference.enumeration import (
    D_PRIMES,
    bias_table,
    binomial_error_rate,
    coverage_table,
    enumerate_estimator,
    outcome_probabilities,
)

BOTH = [(task, rule) for task in ("same-different", "abx") for rule in RULES]


def check_rows(rows) -> None:
    for row in rows:
        # the criteria at which p is calculated are 241: that costs at most 0.002
        assert row.exact > 0.948
        assert row.exact >= (0.85 if row.exact_open > 0.5 else 0.90)


class TestCoverage:
    @pytest.mark.parametrize(("task", "rule"), BOTH)
    @pytest.mark.parametrize("shift", [0.0, 0.5, -0.5])
    def test_twelve_trials(self, task, rule, shift):
        check_rows(
            enumerate_estimator(task, rule, trials=12, shift=shift, d_primes=np.linspace(0.0, 4.0, 17))
        )

    @pytest.mark.parametrize(("task", "rule"), BOTH)
    def test_of_the_intervals_themselves(self, task, rule):
        """`d_prime` of every outcome of 12 trials."""
        law = rule_of(task, rule)
        intervals = np.array(
            [d_prime(Counts(task, h, 6, f, 6), rule=rule).interval for h in range(7) for f in range(7)]
        )
        for d, row in zip(D_PRIMES, enumerate_estimator(task, rule, trials=12), strict=True):
            p = outcome_probabilities(law, 12, d, float(law.unbiased(d)))
            assert p.sum() == pytest.approx(1.0)
            covered = float(p @ ((intervals[:, 0] <= d) & (d <= intervals[:, 1])))
            assert row.exact - 1e-9 <= covered <= row.exact + 0.02
            assert float(p @ np.isinf(intervals[:, 1])) == pytest.approx(row.exact_open, abs=1e-9)

    @pytest.mark.slow
    @pytest.mark.parametrize(("task", "rule"), BOTH)
    @pytest.mark.parametrize("trials", [48, 200])
    def test_more_trials(self, task, rule, trials):
        for shift in (0.0, 0.5, -0.5):
            rows = enumerate_estimator(task, rule, trials=trials, shift=shift)
            check_rows(rows)
            assert min(row.profile for row in rows) > 0.85

    def test_profile_is_short_where_all_answers_are_correct(self):
        """Why the default is exact: a perfect score's lower end may have the probability exp(-3.84/2) = 0.147."""
        (row,) = enumerate_estimator("same-different", "differencing", trials=12, d_primes=[3.5])
        assert row.profile < 0.85
        assert row.exact_open > 0.5
        (row,) = enumerate_estimator("abx", "independent-observations", trials=48, d_primes=[3.0])
        assert row.profile < 0.90
        assert row.exact_open < 0.5


class TestWald:
    def test_fails(self):
        """At d' 0.5 and 12 trials."""
        for task, rule in BOTH:
            (row,) = enumerate_estimator(task, rule, trials=12, d_primes=[0.5])
            assert row.wald < 0.42
            # corrected, and infinite standard errors taken as intervals that hold the truth
            assert row.wald_corrected + row.equal == pytest.approx(0.64, abs=0.02)

    def test_works_far_from_the_boundary(self):
        for task, rule in BOTH:
            (row,) = enumerate_estimator(task, rule, trials=200, d_primes=[2.0])
            assert row.wald > 0.94


class TestBias:
    def test_of_few_and_many_trials(self):
        for task, rule in BOTH:
            few, many = (enumerate_estimator(task, rule, trials=n, d_primes=[2.0])[0] for n in (12, 48))
            assert few.infinite > 0.2
            assert few.bias < -0.25
            assert abs(many.bias_log_linear) < 0.04

    def test_at_the_boundary_is_upward(self):
        for task, rule in BOTH:
            (row,) = enumerate_estimator(task, rule, trials=48, d_primes=[0.0])
            assert row.zero > 0.5
            assert row.bias > 0.3


def test_binomial_error_rate_is_at_most_nominal():
    """At any rate of either answer: an observer who cannot tell may prefer one."""
    for trials in (10, 12, 48, 200):
        for nominal in (0.05, 0.01):
            rates = [binomial_error_rate(trials, p, nominal=nominal) for p in np.linspace(0.0, 1.0, 41)]
            assert max(rates) <= nominal


def test_tables():
    lines = coverage_table("same-different", trials=[12]).splitlines()
    assert len(lines) == 4
    assert lines[3].startswith("| differencing | 12 | 96.6 / 96.6 / 25.5 |")
    assert "| -0.30 / -0.15 / -0.01 (23) |" in bias_table("same-different", trials=[12])


def test_bad_input():
    with pytest.raises(ValueError, match="trials must be even and at least 2, got 7"):
        enumerate_estimator("abx", "differencing", trials=7)
    with pytest.raises(ValueError, match="trials must be even and at least 2, got 0"):
        binomial_error_rate(0, 0.5)
    with pytest.raises(ValueError, match="level must be above 0"):
        enumerate_estimator("abx", "differencing", trials=12, level=1.0)
    with pytest.raises(ValueError, match="rule must be one of"):
        enumerate_estimator("abx", "best", trials=12)
