"""Selection by the outcome, against enumeration and simulation."""

import itertools

import numpy as np
import pytest
from scipy import stats

from burrlab.psychophysics.published import SelectionEffect


def enumerated(kept: int, of: int, trials: int, chance: float) -> np.ndarray:
    p = stats.binom.pmf(np.arange(trials + 1), trials, chance)
    sums = np.zeros(kept * trials + 1)
    for scores in itertools.product(range(trials + 1), repeat=of):
        sums[sum(sorted(scores)[-kept:])] += np.prod(p[list(scores)])
    return sums


@pytest.mark.parametrize(("kept", "of", "trials", "chance"), [(1, 4, 3, 0.5), (2, 5, 3, 0.5), (3, 3, 4, 0.3), (3, 4, 4, 0.8)])  # fmt: skip
def test_distribution_is_that_of_all_outcomes(kept: int, of: int, trials: int, chance: float) -> None:
    effect = SelectionEffect(kept, of, trials, chance)
    expected = enumerated(kept, of, trials, chance)
    assert effect.distribution == pytest.approx(expected, abs=1e-12)
    mean = (expected * np.arange(len(expected))).sum() / kept
    assert effect.expected == pytest.approx(mean, abs=1e-12)
    assert effect.excess == pytest.approx(mean - chance * trials, abs=1e-12)


def test_p_value_is_the_tail() -> None:
    effect = SelectionEffect(2, 5, 3)
    tail = enumerated(2, 5, 3, 0.5)[5:].sum()
    assert effect.p_value(2.5) == pytest.approx(tail, abs=1e-12)
    assert effect.p_value(2.3) == pytest.approx(tail, abs=1e-12)
    assert effect.p_value(0.0) == pytest.approx(1.0, abs=1e-12)
    assert effect.p_value(3.1) == 0.0
    # a mean that was divided and rounded
    assert SelectionEffect(3, 3, 4).p_value(7 / 3) == pytest.approx(enumerated(3, 3, 4, 0.5)[7:].sum())


def test_best_twelve_of_twenty_by_simulation() -> None:
    n = 20_000
    scores = np.random.default_rng(6).binomial(12, 0.5, (n, 20))
    means = np.sort(scores, axis=1)[:, -12:].mean(axis=1)
    effect = SelectionEffect(12, 20, 12)
    # Two normal tests, false-alarm rate 1e-6 together.
    limit = stats.norm.isf(0.25e-6)
    assert abs(means.mean() - effect.expected) < limit * means.std() / np.sqrt(n)
    p = effect.p_value(7.5)
    assert abs((means >= 7.5 - 1e-9).mean() - p) < limit * np.sqrt(p * (1 - p) / n)


def test_without_selection_nothing_is_added() -> None:
    assert SelectionEffect(7, 7, 12).excess == pytest.approx(0.0, abs=1e-12)


def test_refused() -> None:
    with pytest.raises(ValueError, match=r"kept must be in 1..of, 1..5, got 6"):
        SelectionEffect(6, 5, 12)
    with pytest.raises(ValueError, match=r"kept must be in 1..of, 1..5, got 0"):
        SelectionEffect(0, 5, 12)
    with pytest.raises(ValueError, match="trials must be at least 1, got 0"):
        SelectionEffect(1, 5, 0)
    with pytest.raises(ValueError, match=r"chance must be in \(0, 1\), got 1"):
        SelectionEffect(1, 5, 12, 1)
    with pytest.raises(TypeError, match="cannot be interpreted as an integer"):
        SelectionEffect(1.5, 5, 12)  # type: ignore[arg-type]
