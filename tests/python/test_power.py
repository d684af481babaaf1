"""Power of a design and equivalence, against enumeration, simulation and the definitions."""

import itertools
import math

import numpy as np
import pytest
from group_scenes import SAME_D_PRIME, answers_of, most_errors, rejections, same
from scipy import stats

from burrlab.psychophysics.group import GroupAnswers, group_d_prime
from burrlab.psychophysics.power import (
    Observer,
    critical_score,
    decision_text,
    design_power,
    equivalence,
)
from burrlab.psychophysics.rules import RULES, Counts, rule_of

TWELVE = {"trials": 12, "subjects": 12}
GUESSING = [same(2, 2), same(1, 2), same(3, 2)] * 4


@pytest.fixture(scope="module")
def sized():
    """Powers of designs by Delta."""
    return {d: design_power("same-different", **TWELVE, d_primes=[1, 2], delta=d) for d in (1.0, 1.5)}


class TestOneSubject:
    def test_score_that_guessing_seldom_reaches(self):
        assert critical_score(12, 0.05) == (10, pytest.approx(79 / 4096))
        assert critical_score(10, 0.05) == (9, pytest.approx(11 / 1024))
        assert critical_score(4, 0.05) == (None, 0.0)
        assert critical_score(4, 1 / 16) == (4, pytest.approx(1 / 16))

    @pytest.mark.parametrize(
        ("task", "rule"), [("same-different", RULES[1]), ("abx", RULES[0]), ("2ifc", RULES[0])]
    )
    def test_by_enumeration(self, task, rule):
        row = design_power(task, trials=12, rules=[rule], d_primes=[2.0], lapse=0.1).rows[0]
        hit, alarm = (0.9 * float(r) + 0.05 for r in rule_of(task, rule).rates(2.0))
        h, f = np.meshgrid(np.arange(7), np.arange(7), indexing="ij")
        p, score = stats.binom.pmf(h, 6, hit) * stats.binom.pmf(f, 6, alarm), h + 6 - f
        assert (row.subject, row.score) == pytest.approx((p[score >= 10].sum(), (p * score).sum()))
        assert row.score_sd == pytest.approx(math.sqrt((p * (score - row.score) ** 2).sum()))
        assert row.group is None

    def test_guessing_is_the_error_rate(self):
        result = design_power("abx", trials=20, d_primes=[0.0])
        assert result.rows[0].subject == pytest.approx(result.error_rate)
        assert result.error_rate <= 0.05


class TestGroup:
    def test_power_by_scipys_t(self):
        """1000 groups of 12, drawn in another way, agree within their errors; false-alarm rate 1e-6."""
        guess, row = design_power(
            "same-different", **TWELVE, rules=["differencing"], d_primes=[0.0, 1.5], lapse=0.0
        ).rows
        rng, decision = np.random.default_rng(12), rule_of("same-different", "differencing")
        alarm = np.full((1000, 12), float(decision.rates(1.5)[1]))
        hits, answers = answers_of("same-different", "differencing", 1.5, alarm, 6, rng)
        p = stats.ttest_1samp(2 * hits - answers, 0.0, axis=1, alternative="greater").pvalue
        found, error = np.mean(p <= 0.05), math.sqrt(row.group * (1 - row.group) * (1 / 1000 + 1 / 4000))
        assert abs(found - row.group) < stats.norm.isf(0.5e-6) * error
        assert guess.group <= stats.binom.isf(1e-6, 4000, 0.05) / 4000

    def test_scores_without_scatter(self):
        observer = Observer(rule_of("abx", RULES[0]), 60.0, 10, 0.0)
        assert [observer.group(n, 0.05) for n in (5, 4)] == [1.0, 0.0]  # 2^-5

    def test_twelve_by_twelve(self, sized):
        """12 x 12 decide Delta = 1.5, not 1: both rules, unbiased, 2 % lapses; repeatable."""
        for delta, found in sized.items():
            for row in found.equivalence:
                assert (row.power >= 0.8) == (delta == 1.5)
                assert 1.2 < row.decidable_delta < 1.5
        one, other = sized.values()
        assert one.rows == other.rows
        assert [x.decidable_delta for x in one.equivalence] == [x.decidable_delta for x in other.equivalence]

    def test_text(self, sized):
        text = str(sized[1.0])
        assert text.startswith(
            "same-different, 12 trials, 12 subjects; unbiased, 2 % lapses; tests at 5 %, one-sided\n"
            "a subject is above chance from 10 of 12 (by guessing 1.9 %)\n"
        )
        assert "score subject group" in text
        said = "equivalence (differencing): 12 subjects x 12 trials cannot be relied on to decide Delta = 1: the power is"
        assert said in text
        assert len({len(line) for line in text.splitlines()[2:6]}) == 1

    def test_of_one_subject_and_few_trials(self):
        found = design_power("abx", trials=4, d_primes=[1], delta=2.0)
        assert found.equivalence[0].decidable_delta == math.inf
        assert "no score of one subject is above chance: too few trials" in str(found)
        assert "1 subject;" in str(found)
        assert "group" not in str(found)


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

    @pytest.mark.parametrize(
        "group", [GUESSING, [same(3, 2)] * 3, [same(4, 1), same(3, 3), same(5, 2)], [same(8, 8, 24)]]
    )
    def test_bound_and_p_value_agree(self, group):
        """The one-sided 95 % bound is an end of the two-sided 90 % interval."""
        bound = group_d_prime(group, rule="differencing", level=0.9).interval[1]
        found = [equivalence(group, rule="differencing", delta=min(bound, 9.0) + x) for x in (-0.01, 0.01)]
        assert [one.upper for one in found] == pytest.approx([bound, bound], abs=1e-5)
        assert [one.equivalent for one in found] == [False, bound < 9.0]

    def test_always_the_same_answer_is_not_equivalence(self):
        result = equivalence([same(0, 0)] * 12, rule="differencing", delta=3.0)
        assert not result.equivalent
        assert result.p_value == 1.0
        assert (result.upper, result.power, result.decidable_delta) == (math.inf, 0.0, math.inf)
        assert "nothing is known of d'" in result.sentence
        assert "no Delta has 80 %" in result.design_sentence

    def test_who_gave_one_answer_is_named(self):
        result = equivalence([*GUESSING, same(0, 0), same(6, 6)], rule="differencing", delta=1.5)
        assert result.equivalent
        assert "2 of 14 subjects gave one answer only: nothing is known of theirs" in result.sentence

    def test_below_chance_is_named(self):
        result = equivalence([same(0, 4), same(1, 5), same(0, 5), same(1, 4)], rule="differencing", delta=1.0)
        assert result.p_below_chance < 0.01
        assert "were answers swapped?" in result.sentence

    def test_one_subject_and_unlike_trials(self):
        result = equivalence([same(3, 3)], rule=RULES[0], delta=1.5)
        assert not result.equivalent
        assert "1 subject x 12 trials cannot be relied on to decide" in result.design_sentence
        many = equivalence([same(40, 40, 100)], rule=RULES[1], delta=1.5)
        assert many.equivalent
        unlike = equivalence([same(2, 2), same(9, 8, 24)], rule="differencing", delta=1.0)
        assert "2 subjects x 12 to 48 trials" in unlike.design_sentence

    def test_power_is_the_share_that_decides(self):
        """Guessing groups with these numbers of answers, each tested."""
        group, rng = [same(2, 2), same(3, 3), same(1, 2), same(2, 4)] * 3, np.random.default_rng(4)
        stated, decided = equivalence(group, rule="differencing", delta=1.5).power, 0
        for _ in range(150):
            hits = [rng.hypergeometric(6, 6, c.hits + c.false_alarms) for c in group]
            again = [same(h, c.hits + c.false_alarms - h) for h, c in zip(hits, group, strict=True)]
            decided += GroupAnswers.of(again, "differencing").tails(1.5)[0] <= 0.05
        assert stats.binomtest(decided, 150, stated).pvalue > 1e-6

    def test_decision_in_words(self):
        assert decision_text("2 subjects", 1.0, 0.8, 0.9) == (
            "2 subjects would decide Delta = 1 with a power of 80 % if d' were 0; 80 % begin at Delta = 0.9."
        )


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "kind", "delta"), list(itertools.product(RULES, SAME_D_PRIME, [1.0, 1.5])))
def test_error_rate(rule, kind, delta):
    """At d' = Delta at most 5 % of experiments are called equivalent; false-alarm rate 1e-6 per check."""
    errors, _ = rejections(
        "same-different", rule, delta, SAME_D_PRIME[kind], **TWELVE, experiments=10_000, seed=7
    )
    assert errors <= most_errors(0.05, 10_000)


@pytest.mark.parametrize(
    ("kind", "ask", "sentence"),
    [
        (ValueError, lambda: design_power("oddity", trials=12), r"task must be one of .*, got 'oddity'"),
        (ValueError, lambda: design_power("abx", trials=12, rules=["none"]), r"rule must be one of .*, got 'none'"),
        (ValueError, lambda: design_power("abx", trials=12, rules=[]), "rules must hold a rule, got none"),
        (ValueError, lambda: design_power("abx", trials=0), "trials must be even and at least 2, got 0"),
        (ValueError, lambda: design_power("abx", trials=12, subjects=0),
         "subjects must be at least 1, got 0"),
        (ValueError, lambda: design_power("abx", trials=12, d_primes=[-1]),
         "d_primes must be at least 0 and finite, got -1"),
        (ValueError, lambda: design_power("abx", trials=12, level=0.0), r"level must be in \(0, 0.5\], got 0"),
        (ValueError, lambda: design_power("abx", trials=12, lapse=1.0), r"lapse must be in \[0, 1\), got 1"),
        (ValueError, lambda: design_power("abx", trials=12, delta=0.0),
         "delta must be a number above 0, got 0"),
        (ValueError, lambda: equivalence([], rule="differencing", delta=1.0),
         "counts must hold a subject, got none"),
        (ValueError, lambda: equivalence([same(1, 1), Counts("abx", 1, 2, 1, 2)], rule="differencing", delta=1.0), "counts must be of one task, got abx and same-different"),
        (ValueError, lambda: equivalence(GUESSING, rule="none", delta=1.0), r"rule must be one of .*, got 'none'"),
        (ValueError, lambda: equivalence(GUESSING, rule="differencing", delta=1.0, level=0.3), r"level must be in \[0.5, 1\), got 0.3"),
        (ValueError, lambda: equivalence(GUESSING, rule="differencing", delta=0.0),
         "delta must be a number above 0, got 0"),
        (ValueError, lambda: equivalence(GUESSING, rule="differencing", delta=math.inf),
         "delta must be a number above 0, got inf"),
    ],
)  # fmt: skip
def test_refusals_by_their_sentence(kind, ask, sentence):
    with pytest.raises(kind, match=sentence):
        ask()
