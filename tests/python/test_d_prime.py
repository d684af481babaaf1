"""One subject's d': estimate, intervals, standard error, corrections; slow versions written from the definitions."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest
from scipy.special import xlogy
from scipy.stats import binom

from burrlab.psychophysics.rules import RULES, TASKS, Counts, rule_of
from burrlab.psychophysics.sensitivity import (
    Outcomes,
    binomial_test,
    d_prime,
    exact_p_value,
    score_interval,
)
from reference.enumeration import exact_p_values

ALL = [(task, rule) for task in TASKS for rule in RULES]
SOME = [(5, 6, 1, 6), (6, 6, 2, 6), (3, 6, 3, 6), (1, 6, 4, 6), (9, 12, 4, 10), (20, 24, 5, 24)]


def at_best_criterion(law, counts: Counts, d: float, n: int = 20_001) -> float:
    """The log-likelihood, at the best of many criteria."""
    low = 0.0 if (law.task, law.name) == ("same-different", "differencing") else -d - 5.0
    h, f = law.rates(d, np.linspace(low, d + 5.0, n))
    value = xlogy(counts.hits, h) + xlogy(counts.signals - counts.hits, 1.0 - h)
    value = value + xlogy(counts.false_alarms, f) + xlogy(counts.noises - counts.false_alarms, 1.0 - f)
    return float(value.max())


class TestLikelihood:
    @pytest.mark.parametrize(("task", "rule"), ALL)
    @pytest.mark.parametrize("numbers", SOME)
    def test_deviance_is_the_definition(self, task, rule, numbers):
        counts, law = Counts(task, *numbers), rule_of(task, rule)
        ds = [0.0, 0.4, 1.3, 3.0]
        best = [at_best_criterion(law, counts, d) for d in ds]
        greatest = max(at_best_criterion(law, counts, d, 2001) for d in np.linspace(0.0, 9.0, 91))
        found = Outcomes.of(counts).deviance(law, ds)
        np.testing.assert_allclose(found[1:] - found[0], -2.0 * (np.array(best[1:]) - best[0]), atol=1e-6)
        assert found == pytest.approx(2.0 * (greatest - np.array(best)), abs=0.02)

    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_deviance_rises_on_both_sides(self, task, rule):
        law, outcomes = rule_of(task, rule), Outcomes.all(6, 6)
        d = np.linspace(0.0, 10.0, 101)
        deviance = np.array([outcomes.deviance(law, x) for x in d])
        estimate = outcomes.estimate(law)[0]
        step = np.diff(deviance, axis=0)
        assert np.all(step[d[1:, None] <= estimate] <= 1e-8)
        assert np.all(step[d[:-1, None] >= estimate] >= -1e-8)

    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_estimate_has_no_deviance(self, task, rule):
        law, outcomes = rule_of(task, rule), Outcomes.all(7, 5)
        estimate = np.minimum(outcomes.estimate(law)[0], 40.0)
        assert outcomes.deviance(law, estimate).max() < 1e-8


class TestEstimate:
    @pytest.mark.parametrize("rule", RULES)
    def test_is_the_rates_own_d_prime(self, rule):
        result = d_prime(Counts("same-different", 20, 24, 6, 24), rule=rule, method="profile")
        d, criterion = rule_of("same-different", rule).invert(20 / 24, 6 / 24)
        assert (result.estimate, result.criterion) == (float(d), float(criterion))

    @pytest.mark.parametrize("method", ["exact", "profile"])
    def test_no_more_hits_than_false_alarms(self, method):
        result = d_prime(Counts("same-different", 2, 6, 3, 6), rule="differencing", method=method)
        assert result.estimate == 0.0
        assert result.interval[0] == 0.0
        assert 0.0 < result.interval[1] < math.inf
        assert result.standard_error is None
        assert not result.excludes_zero

    @pytest.mark.parametrize("method", ["exact", "profile", "proportion"])
    def test_perfect_score(self, method):
        result = d_prime(Counts("abx", 5, 5, 0, 5), rule="differencing", method=method)
        assert result.estimate == math.inf
        assert result.open_above
        assert result.excludes_zero
        assert result.standard_error is None
        assert "open)" in str(result)

    @pytest.mark.parametrize("method", ["exact", "profile"])
    @pytest.mark.parametrize("numbers", [(6, 6, 6, 6), (0, 6, 0, 6), (4, 6, 0, 0), (0, 0, 2, 6)])
    def test_nothing_learnt(self, method, numbers):
        result = d_prime(Counts("same-different", *numbers), rule="differencing", method=method)
        assert result.undetermined
        assert result.interval == (0.0, math.inf)
        assert "say nothing of d'" in str(result)

    def test_json(self):
        result = d_prime(Counts("abx", 5, 5, 0, 5, by_type={"AB": (5, 5), "BA": (0, 5)}), rule="differencing")
        data = json.loads(json.dumps(result.to_dict(), allow_nan=False))
        assert data["estimate"] is None
        assert data["infinite"]
        assert data["interval"][1] is None
        assert data["counts"]["by_type"]["AB"] == [5, 5]


class TestStandardError:
    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_is_the_scatter_of_many_trials(self, task, rule):
        """2000 subjects of 20 000 trials; the variance's relative error is 3.2 %, 4.9 of it the false-alarm rate 1e-6."""
        law, rng = rule_of(task, rule), np.random.default_rng(7)
        hit, false_alarm = (float(x) for x in law.rates(1.5, law.unbiased(1.5) + 0.2))
        n = 10_000
        estimates, _ = law.invert(rng.binomial(n, hit, 2000) / n, rng.binomial(n, false_alarm, 2000) / n)
        counts = Counts(task, round(n * hit), n, round(n * false_alarm), n)
        error = d_prime(counts, rule=rule, method="profile").standard_error
        assert error is not None
        assert np.var(estimates) == pytest.approx(error**2, rel=4.9 * math.sqrt(2.0 / 2000))

    @pytest.mark.parametrize("rule", RULES)
    def test_only_where_zero_is_excluded(self, rule):
        assert d_prime(Counts("same-different", 4, 6, 2, 6), rule=rule).standard_error is None
        assert d_prime(Counts("same-different", 20, 24, 6, 24), rule=rule).standard_error is not None


class TestExact:
    @pytest.mark.parametrize(("task", "rule"), ALL)
    @pytest.mark.parametrize("d", [0.0, 0.8, 2.5])
    def test_p_is_the_definition(self, task, rule, d):
        """For each outcome the sum over all that are no likelier, at 400 criteria."""
        law, m, n = rule_of(task, rule), 5, 4
        deviance = Outcomes.all(m, n).deviance(law, d).reshape(m + 1, n + 1)
        hit, false_alarm = law.rates(d, np.linspace(*law.criterion_range(d, 1e-6, 1.0 - 1e-6), 400))
        found = exact_p_values(law, m, n, d).reshape(m + 1, n + 1)
        for h, f in np.ndindex(m + 1, n + 1):
            terms = [
                binom.pmf(i, m, hit) * binom.pmf(j, n, false_alarm)
                for i, j in np.argwhere(deviance >= deviance[h, f] - 1e-7)
            ]
            assert found[h, f] == pytest.approx(np.sum(terms, axis=0).max(), abs=5e-4)
            assert exact_p_value(Counts(task, h, m, f, n), law, d) == pytest.approx(found[h, f], abs=1e-12)

    def test_interval_is_the_kept_d_prime(self):
        counts, law = Counts("same-different", 9, 12, 3, 12), rule_of("same-different", "differencing")
        low, high = d_prime(counts, rule="differencing").interval
        assert exact_p_value(counts, law, low + 2e-3) > 0.05
        assert exact_p_value(counts, law, high - 2e-3) > 0.05
        beyond = [*np.linspace(0.0, low - 1e-3, 40), *np.linspace(high + 1e-3, high + 6.0, 60)]
        assert max(exact_p_value(counts, law, d) for d in beyond) <= 0.05

    def test_higher_level_is_wider(self):
        counts = Counts("abx", 9, 12, 3, 12)
        (a, b), (c, d) = (d_prime(counts, rule="differencing", level=x).interval for x in (0.8, 0.99))
        assert c <= a < b <= d

    def test_proportion_is_clopper_and_pearson(self):
        counts = Counts("abx", 9, 12, 3, 12)
        law = rule_of("abx", "independent-observations")
        interval = d_prime(counts, rule=law.name, method="proportion").interval
        assert law.proportion_correct(interval) == pytest.approx(score_interval(counts), abs=1e-12)


class TestCorrections:
    def test_log_linear(self):
        """Hautus 1995: (h + 0.5)/(n + 1), whether or not a rate is 0 or 1."""
        for numbers, rates in (((6, 6, 0, 6), (6.5 / 7, 0.5 / 7)), ((4, 6, 2, 6), (4.5 / 7, 2.5 / 7))):
            result = d_prime(Counts("abx", *numbers), rule="differencing", correction="log-linear")
            assert result.corrected == float(rule_of("abx", "differencing").invert(*rates)[0])
            assert result.correction == "log-linear"

    def test_half(self):
        """Macmillan and Kaplan 1985: 1 - 1/(2n) and 1/(2n), in place of 1 and 0 alone."""
        law = rule_of("abx", "differencing")
        for numbers, rates in (((6, 6, 0, 4), (11 / 12, 1 / 8)), ((4, 6, 2, 6), (4 / 6, 2 / 6))):
            result = d_prime(Counts("abx", *numbers), rule="differencing", correction="half")
            assert result.corrected == pytest.approx(float(law.invert(*rates)[0]), abs=1e-12)

    @pytest.mark.parametrize("correction", ["log-linear", "half"])
    def test_interval_takes_none(self, correction):
        counts = Counts("abx", 6, 6, 0, 6)
        corrected = d_prime(counts, rule="differencing", correction=correction)
        assert corrected.interval == d_prime(counts, rule="differencing").interval
        assert "corrected d'" in str(corrected)

    def test_without(self):
        result = d_prime(Counts("abx", 4, 6, 2, 6), rule="differencing")
        assert result.corrected == result.estimate


class TestScore:
    def test_interval(self):
        counts = Counts("abx", 5, 5, 1, 5)
        low, high = score_interval(counts, 0.9)
        assert binom.sf(8, 10, low) == pytest.approx(0.05)
        assert binom.cdf(9, 10, high) == pytest.approx(0.05)

    def test_binomial(self):
        assert binomial_test(Counts("abx", 5, 5, 1, 5)) == pytest.approx(11 / 1024)


class TestBadInput:
    counts = Counts("same-different", 5, 6, 1, 6)

    def test_names(self):
        with pytest.raises(ValueError, match="rule must be one of"):
            d_prime(self.counts, rule="best")
        with pytest.raises(
            ValueError, match=re.escape("method must be one of exact, profile, proportion, got 'wald'")
        ):
            d_prime(self.counts, rule="differencing", method="wald")
        with pytest.raises(ValueError, match="correction must be one of none, log-linear, half, got 'some'"):
            d_prime(self.counts, rule="differencing", correction="some")
        with pytest.raises(
            ValueError, match="method must be exact or profile for same-different, got 'proportion'"
        ):
            d_prime(self.counts, rule="differencing", method="proportion")

    @pytest.mark.parametrize("level", [0.0, 1.0, 95.0, math.nan])
    def test_level(self, level):
        with pytest.raises(ValueError, match=f"level must be above 0 and below 1, got {level}"):
            d_prime(self.counts, rule="differencing", level=level)
        with pytest.raises(ValueError, match="level must be above 0 and below 1"):
            score_interval(self.counts, level)


def test_an_exact_interval_of_too_many_outcomes_is_refused():
    many = Counts("same-different", hits=1500, signals=2000, false_alarms=900, noises=2000)
    with pytest.raises(ValueError, match="at most 4000000 possible outcomes for method 'exact', got 4004001"):
        d_prime(many, rule="differencing")
    low, high = d_prime(many, rule="differencing", method="profile").interval
    assert 1.0 < low < high < 3.0
