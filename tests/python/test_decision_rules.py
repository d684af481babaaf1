"""d' to rates and back, against psyphy and as round trips. Simulated observers are in test_d_prime.py."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from burrlab.psychophysics.rules import RULES, TASKS, rule_of

GOLDEN = Path(__file__).parents[1] / "golden" / "psyphy" / "d_prime.csv"


@pytest.fixture(params=[(task, rule) for task in TASKS for rule in RULES], ids=" ".join)
def law(request):
    return rule_of(*request.param)


@pytest.mark.parametrize(
    ("task", "rule"), [(task, rule) for task in ("same-different", "abx") for rule in RULES]
)
def test_is_psyphy(task, rule):
    """psyphy's root finder has a tolerance of 1.2e-4; same-different by independent observations has none."""
    with GOLDEN.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if (row["task"], row["rule"]) == (task, rule)]
    hit, false_alarm, expected = (
        np.array([float(row[x]) for row in rows]) for x in ("hit", "false_alarm", "d_prime")
    )
    assert len(hit) == 78
    closed = (task, rule) == ("same-different", "independent-observations")
    assert rule_of(task, rule).invert(hit, false_alarm)[0] == pytest.approx(
        expected, abs=1e-9 if closed else 2e-4
    )


def test_rates_give_d_prime_and_criterion_back(law):
    """d' of 0.05 to 6, criteria within 1 sd of the unbiased one: to 1e-9 of d' if a double holds the rates.

    A rate near 1 loses its last digits, which limits the precision of d'.
    """
    d, shift = np.meshgrid(np.linspace(0.05, 6.0, 120), np.linspace(-1.0, 1.0, 21))
    criterion = law.unbiased(d) + shift
    hit, false_alarm = law.rates(d, criterion)
    back, again = law.invert(hit, false_alarm)
    hit_d, hit_c, alarm_d, alarm_c = law.slopes(d, criterion)
    change = (abs(alarm_c) * hit + abs(hit_c) * false_alarm) / abs(hit_d * alarm_c - hit_c * alarm_d)
    assert np.all(np.abs(back - d) <= np.maximum(1e-9, 8e-16 * change))
    assert np.abs(back - d)[(d <= 5.0) & (np.abs(shift) <= 0.501)].max() < 1e-9
    assert again == pytest.approx(criterion, abs=1e-9)


def test_ends(law):
    d, _ = law.invert([0.3, 0.3, 0.0, 1.0, 1.0, 0.5, 1.0], [0.3, 0.6, 0.0, 1.0, 0.0, 0.0, 0.5])
    assert d.tolist() == [0.0, 0.0, 0.0, 0.0, np.inf, np.inf, np.inf]


def test_unbiased_is_best(law):
    d = np.array([0.3, 1.0, 2.5, 4.0])
    best = law.proportion_correct(d)
    for shift in (-0.05, 0.05):
        assert np.all(law.proportion_correct(d, law.unbiased(d) + shift) < best)


def test_slopes_are_derivatives(law):
    h = 1e-6
    d, c = np.meshgrid([0.2, 1.0, 3.0], [0.3, 0.9, 2.0])
    by_d = [(a - b) / (2 * h) for a, b in zip(law.rates(d + h, c), law.rates(d - h, c), strict=True)]
    by_c = [(a - b) / (2 * h) for a, b in zip(law.rates(d, c + h), law.rates(d, c - h), strict=True)]
    np.testing.assert_allclose(law.slopes(d, c), (by_d[0], by_c[0], by_d[1], by_c[1]), atol=1e-8)


def test_logarithms_are_of_the_rates_and_concave_in_the_criterion(law):
    d, c = np.meshgrid([0.0, 0.7, 3.0], [0.1, 1.0, 2.5])
    hit, false_alarm = law.rates(d, c)
    np.testing.assert_allclose(
        np.exp(law.log_rates(d, c)), (hit, 1.0 - hit, false_alarm, 1.0 - false_alarm), atol=1e-14
    )
    values = law.log_rates(np.linspace(0.0, 8.0, 17)[:, None], np.linspace(0.05, 12.0, 500))
    assert np.diff(values, n=2, axis=2).max() < 1e-9


def test_a_lapse_answers_at_random(law):
    assert law.proportion_correct([40.0, 0.0], lapse=0.1) == pytest.approx([0.95, 0.5])


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (("triangle", "differencing"), "task must be one of same-different, abx, 2ifc, got 'triangle'"),
        (("abx", "best"), "rule must be one of independent-observations, differencing, got 'best'"),
    ],
)
def test_unknown_names(names, sentence):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        rule_of(*names)
