"""From d' to rates and back: against psyphy, against observers that decide, and round."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from burrlab.psychophysics.rules import RULES, TASKS, rule_of

GOLDEN = Path(__file__).parents[1] / "golden" / "psyphy" / "d_prime.csv"
ALL = [(task, rule) for task in TASKS for rule in RULES]
LIMIT = norm.isf(0.5e-6)  # of a two-sided test with false-alarm rate 1e-6


def golden(task: str, rule: str) -> np.ndarray:
    with GOLDEN.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if (row["task"], row["rule"]) == (task, rule)]
    return np.array([[float(row[name]) for name in ("hit", "false_alarm", "d_prime")] for row in rows]).T


class TestGolden:
    @pytest.mark.parametrize(("task", "rule"), [x for x in ALL if x[0] != "2ifc"])
    def test_is_psyphy(self, task, rule):
        """psyphy's root finder has a tolerance of 1.2e-4; same-different under independent observations needs none."""
        hit, false_alarm, expected = golden(task, rule)
        assert len(hit) == 78
        closed = (task, rule) == ("same-different", "independent-observations")
        d, _ = rule_of(task, rule).invert(hit, false_alarm)
        assert d == pytest.approx(expected, abs=1e-9 if closed else 2e-4)


def observed(rng, d: float, *stimuli: str) -> list[np.ndarray]:
    return [rng.standard_normal(200_000) + (d if name == "B" else 0.0) for name in stimuli]


def matches(share: float, expected: float, n: int) -> bool:
    return abs(share - expected) < LIMIT * math.sqrt(expected * (1.0 - expected) / n)


class TestObservers:
    """Simulated decisions, 200 000 a rate, false-alarm rate 1e-6 each."""

    @pytest.mark.parametrize("d", [0.5, 2.0])
    def test_same_different_by_difference(self, d):
        rng = np.random.default_rng(1)
        hit, false_alarm = rule_of("same-different", "differencing").rates(d, 1.3)
        for pair, expected in (("AB", hit), ("BA", hit), ("AA", false_alarm), ("BB", false_alarm)):
            one, two = observed(rng, d, *pair)
            assert matches(np.mean(np.abs(one - two) > 1.3), float(expected), len(one))

    @pytest.mark.parametrize("d", [0.5, 2.0])
    def test_same_different_by_category(self, d):
        rng = np.random.default_rng(2)
        hit, false_alarm = rule_of("same-different", "independent-observations").rates(d)
        for pair, expected in (("AB", hit), ("BA", hit), ("AA", false_alarm), ("BB", false_alarm)):
            one, two = observed(rng, d, *pair)
            assert matches(np.mean((one > d / 2) != (two > d / 2)), float(expected), len(one))

    @pytest.mark.parametrize("d", [0.5, 2.0])
    @pytest.mark.parametrize("rule", RULES)
    def test_abx(self, d, rule):
        rng = np.random.default_rng(3)
        hit, false_alarm = rule_of("abx", rule).rates(d)
        for stimuli, expected in (("AAB", hit), ("BBA", hit), ("ABA", false_alarm), ("BAB", false_alarm)):
            reference, first, second = observed(rng, d, *stimuli)
            middle = 0.5 * (first + second) if rule == "differencing" else d / 2
            share = np.mean((reference < middle) == (first < second))
            assert matches(share, float(expected), len(first))

    @pytest.mark.parametrize("d", [0.5, 2.0])
    def test_two_intervals(self, d):
        rng = np.random.default_rng(4)
        for rule in RULES:
            hit, false_alarm = rule_of("2ifc", rule).rates(d, 0.2)
            for pair, expected in (("BA", hit), ("AB", false_alarm)):
                one, two = observed(rng, d, *pair)
                assert matches(np.mean((one - two) / math.sqrt(2.0) > 0.2), float(expected), len(one))


class TestRoundTrip:
    @pytest.mark.parametrize(("task", "rule"), ALL)
    @given(d=st.floats(0.05, 6.0), shift=st.floats(-1.0, 1.0))
    def test_returns_d_prime(self, task, rule, d, shift):
        """d' 0.05 to 6, criterion up to 1 sd from the unbiased one, to 1e-9 of d' where a double holds the rates.

        A rate next to 1 has lost its last digits, so d' is known no better than the change of d' with that rate.
        """
        law = rule_of(task, rule)
        criterion = law.unbiased(d) + shift
        hit, false_alarm = law.rates(d, criterion)
        back, again = law.invert(hit, false_alarm)
        hit_d, hit_c, alarm_d, alarm_c = law.slopes(d, criterion)
        change = (abs(alarm_c) * hit + abs(hit_c) * false_alarm) / abs(hit_d * alarm_c - hit_c * alarm_d)
        assert float(back) == pytest.approx(d, abs=max(1e-9, float(8e-16 * change)))
        assert float(again) == pytest.approx(float(criterion), abs=1e-9)

    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_is_1e_9_in_the_range_of_experiments(self, task, rule):
        law = rule_of(task, rule)
        d, shift = np.meshgrid(np.linspace(0.05, 5.0, 100), np.linspace(-0.5, 0.5, 11))
        back, _ = law.invert(*law.rates(d, law.unbiased(d) + shift))
        assert np.abs(back - d).max() < 1e-9

    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_ends(self, task, rule):
        law = rule_of(task, rule)
        d, _ = law.invert([0.3, 0.3, 0.0, 1.0, 1.0, 0.5, 1.0], [0.3, 0.6, 0.0, 1.0, 0.0, 0.0, 0.5])
        assert d.tolist() == [0.0, 0.0, 0.0, 0.0, np.inf, np.inf, np.inf]


class TestShape:
    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_unbiased_is_best(self, task, rule):
        law, d = rule_of(task, rule), np.array([0.3, 1.0, 2.5, 4.0])
        best = law.proportion_correct(d)
        for shift in (-0.05, 0.05):
            assert np.all(law.proportion_correct(d, law.unbiased(d) + shift) < best)

    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_slopes_are_derivatives(self, task, rule):
        law, h = rule_of(task, rule), 1e-6
        d, c = np.meshgrid([0.2, 1.0, 3.0], [0.3, 0.9, 2.0])
        by_d = [(a - b) / (2 * h) for a, b in zip(law.rates(d + h, c), law.rates(d - h, c), strict=True)]
        by_c = [(a - b) / (2 * h) for a, b in zip(law.rates(d, c + h), law.rates(d, c - h), strict=True)]
        expected = (by_d[0], by_c[0], by_d[1], by_c[1])
        for found, wanted in zip(law.slopes(d, c), expected, strict=True):
            np.testing.assert_allclose(found, wanted, atol=1e-8)

    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_logarithms_are_of_the_rates(self, task, rule):
        law = rule_of(task, rule)
        d, c = np.meshgrid([0.0, 0.7, 3.0], [0.1, 1.0, 2.5])
        hit, false_alarm = law.rates(d, c)
        rates = (hit, 1.0 - hit, false_alarm, 1.0 - false_alarm)
        for found, wanted in zip(law.log_rates(d, c), rates, strict=True):
            np.testing.assert_allclose(np.exp(found), wanted, atol=1e-14)

    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_logarithms_are_concave_in_the_criterion(self, task, rule):
        law = rule_of(task, rule)
        d, c = np.linspace(0.0, 8.0, 17)[:, None], np.linspace(0.05, 12.0, 500)
        for value in law.log_rates(d, c):
            assert np.diff(value, n=2, axis=1).max() < 1e-9

    @pytest.mark.parametrize(("task", "rule"), ALL)
    def test_a_lapse_answers_at_random(self, task, rule):
        law = rule_of(task, rule)
        assert float(law.proportion_correct(40.0, lapse=0.1)) == pytest.approx(0.95)
        assert float(law.proportion_correct(0.0, lapse=0.1)) == pytest.approx(0.5)


def test_unknown_names():
    with pytest.raises(
        ValueError, match=re.escape("task must be one of same-different, abx, 2ifc, got 'triangle'")
    ):
        rule_of("triangle", "differencing")
    with pytest.raises(
        ValueError, match="rule must be one of independent-observations, differencing, got 'best'"
    ):
        rule_of("abx", "best")
