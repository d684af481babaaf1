"""Fisher's test of types of pairs, for one subject and for several."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import binom, fisher_exact

from burrlab.psychophysics.pairs import pair_checks
from burrlab.psychophysics.rules import Counts


def same_different(aa: int, bb: int, ab: int, ba: int, n: int = 12) -> Counts:
    types = {"AA": (aa, n), "BB": (bb, n), "AB": (ab, n), "BA": (ba, n)}
    return Counts("same-different", ab + ba, 2 * n, aa + bb, 2 * n, by_type=types)


class TestOneSubject:
    @pytest.mark.parametrize("numbers", [(0, 7, 9, 8), (3, 3, 12, 2), (1, 5, 6, 11), (0, 0, 12, 12)])
    def test_is_fishers(self, numbers):
        noise, order = pair_checks(same_different(*numbers))
        for check, (n, m) in ((noise, numbers[:2]), (order, numbers[2:])):
            assert check.counts == ((n, 12), (m, 12))
            assert check.p_value == pytest.approx(fisher_exact([[n, 12 - n], [m, 12 - m]]).pvalue)

    def test_position(self):
        (check,) = pair_checks(Counts("abx", 10, 12, 8, 14))
        assert check.counts == ((10, 12), (6, 14))
        assert check.p_value == pytest.approx(fisher_exact([[10, 2], [6, 8]]).pvalue)

    def test_twelve_trials_cannot_show_anything(self):
        noise, _ = pair_checks(same_different(0, 3, 3, 3, n=3))
        assert noise.p_value == pytest.approx(0.1)
        assert "cannot show a difference (p is at least 0.1)" in str(noise)

    def test_a_run_that_was_not_finished(self):
        counts = Counts("same-different", 0, 0, 1, 2, by_type={"AA": (1, 2)})
        assert [check.p_value for check in pair_checks(counts)] == [1.0, 1.0]

    def test_sentences(self):
        noise, order = pair_checks(same_different(0, 7, 9, 8))
        assert "felt with more noise" in str(noise)
        assert "no difference shown" in str(order)


class TestSeveralSubjects:
    def test_is_given_each_total(self):
        """By all tables of two subjects that have the same totals."""
        subjects = [same_different(0, 2, 3, 3, n=3), same_different(1, 3, 3, 3, n=3)]

        def weight(n: int, total: int) -> float:
            return float(binom.pmf(n, 3, 0.5) * binom.pmf(total - n, 3, 0.5))

        sums = np.zeros(7)
        for one, two in itertools.product(range(4), range(4)):
            sums[one + two] += weight(one, 2) * weight(two, 4)
        sums /= sums.sum()
        expected = sums[sums <= sums[1] * (1 + 1e-9)].sum()
        assert pair_checks(subjects)[0].p_value == pytest.approx(expected)

    def test_subjects_that_differ_are_no_difference_of_types(self):
        subjects = [same_different(11, 11, 11, 11), same_different(1, 1, 11, 11)]
        assert pair_checks(subjects)[0].p_value == pytest.approx(1.0)

    def test_error_rate_is_at_most_nominal(self):
        """Two subjects of 6 trials a type who answer at their own rates, by enumeration."""
        p = {
            (a, b, c, d): pair_checks([same_different(a, b, 3, 3, n=6), same_different(c, d, 3, 3, n=6)])[
                0
            ].p_value
            for a, b, c, d in itertools.product(range(7), repeat=4)
        }
        for one, two in ((0.1, 0.5), (0.3, 0.3), (0.5, 0.9)):
            first, second = binom.pmf(range(7), 6, one), binom.pmf(range(7), 6, two)
            rate = sum(
                first[a] * first[b] * second[c] * second[d] for (a, b, c, d), x in p.items() if x <= 0.05
            )
            assert rate <= 0.05


def test_bad_input():
    with pytest.raises(ValueError, match="counts must be of a subject at least, got none"):
        pair_checks([])
    with pytest.raises(ValueError, match="counts must be of one task, got abx, same-different"):
        pair_checks([same_different(1, 1, 1, 1), Counts("abx", 1, 2, 1, 2)])
    with pytest.raises(ValueError, match="counts must have the types of pairs, by_type, got none"):
        pair_checks(Counts("same-different", 1, 2, 1, 2))


def test_subjects_who_answered_alike_throughout_leave_nothing_to_compare():
    types = {"AA": (0, 3), "BB": (0, 3), "AB": (3, 3), "BA": (3, 3)}
    for check in pair_checks(Counts("same-different", 6, 6, 0, 6, by_type=types)):
        assert check.smallest == 1.0
        assert str(check).endswith("p = 1; alike in every subject as far as can be")
