"""Rules, exact test and group tests against the slow versions of `tests/reference/psychophysics.py`, which share nothing with them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from burrlab.psychophysics.group import label_test, sign_flip_test
from burrlab.psychophysics.published import SelectionEffect
from burrlab.psychophysics.rules import RULES, rule_of
from burrlab.psychophysics.scored_task import holm
from reference import psychophysics as reference
from reference.enumeration import exact_p_values

INDEPENDENT, DIFFERENCING = RULES
ROOT2 = math.sqrt(2.0)


def closed_differencing(d: float, k: float) -> tuple[float, float]:
    """The integral of `same_different_differencing`, done by hand: the p values need thousands of them."""
    hit = reference.Phi((d - k) / ROOT2) + reference.Phi((-d - k) / ROOT2)
    return hit, 2.0 * reference.Phi(-k / ROOT2)


class TestObservers:
    """Rates integrated over the observations."""

    @pytest.mark.parametrize("d", [0.0, 0.3, 1.0, 2.0, 3.5])
    @pytest.mark.parametrize("k", [0.2, 1.0, 2.5])
    def test_differencing_at_any_criterion(self, d, k):
        expected = reference.same_different_differencing(d, k)
        found = rule_of("same-different", DIFFERENCING).rates(d, k)
        assert [float(x) for x in found] == pytest.approx(expected, abs=1e-10)
        assert closed_differencing(d, k) == pytest.approx(expected, abs=1e-10)

    @pytest.mark.parametrize("d", [0.3, 1.0, 2.0, 3.5])
    @pytest.mark.parametrize(
        ("task", "rule", "observer"),
        [
            ("same-different", INDEPENDENT, reference.same_different_independent),
            ("same-different", INDEPENDENT, lambda d: reference.same_different_likelihood(d, 0.0)),
            ("abx", INDEPENDENT, reference.abx_independent),
            ("abx", DIFFERENCING, reference.abx_differencing),
            ("2ifc", INDEPENDENT, reference.two_intervals),
        ],
    )
    def test_without_bias(self, task, rule, observer, d):
        found = rule_of(task, rule).rates(d)
        assert [float(x) for x in found] == pytest.approx(observer(d), abs=1e-10)

    @pytest.mark.parametrize("d", [0.5, 2.0, 3.5])
    @pytest.mark.parametrize("bias", [-0.7, 0.3, 1.2])
    def test_two_intervals_at_any_bias(self, d, bias):
        found = rule_of("2ifc", INDEPENDENT).invert(*reference.two_intervals(d, bias))[0]
        assert float(found) == pytest.approx(d, abs=1e-8)

    @pytest.mark.parametrize("d", [1.0, 2.0, 3.0])
    def test_what_the_approximation_makes_of_a_bias(self, d):
        """docs/psychophysics.md: d' comes out up to 0.13 too large in same-different, 0.03 off in ABX."""
        same_different, abx = rule_of("same-different", INDEPENDENT), rule_of("abx", DIFFERENCING)
        for bias in (-0.6, 0.6):
            found = float(same_different.invert(*reference.same_different_likelihood(d, bias))[0])
            assert 0.0 < found - d < 0.13
        found = float(abx.invert(*reference.abx_differencing(d, 0.8))[0])
        assert abs(found - d) < 0.035


@pytest.mark.parametrize("d", [0.0, 0.5, 2.0])
def test_exact_p_values_by_listing_all_outcomes(d):
    """4 and 3 trials; the own grid of criteria is the coarser, which costs either at most 0.002."""
    found = exact_p_values(rule_of("same-different", DIFFERENCING), 4, 3, d).reshape(5, 4)
    expected = reference.exact_p_values(closed_differencing, d, 4, 3, np.linspace(0.02, d + 7.0, 200))
    for (hits, alarms), p in expected.items():
        assert float(found[hits, alarms]) == pytest.approx(p, abs=0.002)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8), st.sampled_from([0.05, 0.2]))
def test_holm_rejects_step_by_step(p_values, level):
    assert [p <= level for p in holm(p_values)] == reference.holm_rejected(p_values, level)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(-12, 12), min_size=2, max_size=8), st.integers(1, 7))
def test_exchanging_signs_and_groups(doubled, first):
    values = [v / 2 for v in doubled]
    assert sign_flip_test(values).p_value == pytest.approx(reference.sign_flip_p(values))
    one, two = values[: min(first, len(values) - 1)], values[min(first, len(values) - 1) :]
    assert label_test(one, two).p_value == pytest.approx(reference.label_p(one, two))


@pytest.mark.parametrize(("kept", "of", "trials"), [(1, 3, 4), (2, 4, 3), (3, 3, 4), (2, 5, 2)])
def test_best_of_guessers(kept, of, trials):
    expected = reference.best_of_guessers(kept, of, trials)
    found = SelectionEffect(kept, of, trials).distribution
    assert found == pytest.approx([expected.get(i, 0.0) for i in range(kept * trials + 1)], abs=1e-12)


def test_exact_interval_of_biased_likelihood_observers():
    """By enumeration: subjects who weigh both likelihoods with a bias are no observers of the approximation; docs/psychophysics.md."""
    law, k = rule_of("same-different", INDEPENDENT), np.arange(25)
    for d in (1.0, 2.0, 3.0):
        kept = exact_p_values(law, 24, 24, d) > 0.05
        for bias in (-1.2, 0.6):
            hit, alarm = reference.same_different_likelihood(d, bias)
            assert np.outer(binom.pmf(k, 24, hit), binom.pmf(k, 24, alarm)).ravel() @ kept > 0.945
