"""Orders: balanced to the trial, and the same again from seed, subject and design."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from itertools import pairwise, permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from burrlab.psychophysics.designs import Draws, FixedOrder, checked_trial, counterbalanced

FALSE_ALARMS = 1e-6


def test_the_draws_stay_what_they_are():
    """A run that was interrupted must find the same trials in a later version."""
    draws = Draws(1, "01", {"design": "x", "interval_s": 20.0})
    assert draws.shuffled(list(range(10))) == [8, 2, 0, 1, 3, 5, 4, 6, 7, 9]
    assert [draws.interval_seed() for _ in range(2)] == [16671133676022338408, 14445788799221260555]


@pytest.mark.parametrize(
    "other",
    [(2, "01", {"a": 1}), (1, "02", {"a": 1}), (1, "01", {"a": 2}), (1 << 32, "01", {"a": 1})],
    ids=["seed", "subject", "design", "large seed"],
)
def test_another_seed_subject_or_design_is_another_stream(other):
    assert Draws(1, "01", {"a": 1}).interval_seed() != Draws(*other).interval_seed()


def test_the_order_of_a_design_s_keys_does_not_matter():
    assert (
        Draws(1, "01", {"a": 1, "b": 2}).interval_seed() == Draws(1, "01", {"b": 2, "a": 1}).interval_seed()
    )


def test_the_same_in_another_process():
    program = (
        "from burrlab.psychophysics.designs import Draws; print(Draws(7, 'Jürg', {'a': 0.1}).interval_seed())"
    )
    said = {
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
        ).stdout
        for _ in range(2)
    }
    assert said == {f"{Draws(7, 'Jürg', {'a': 0.1}).interval_seed()}\n"}


def test_all_shuffles_are_equally_likely():
    """chi^2 of 24 orders over 24 000 subjects."""
    found = Counter("".join(Draws(3, str(i), {}).shuffled("abcd")) for i in range(24_000))
    statistic = sum((found["".join(order)] - 1000) ** 2 / 1000 for order in permutations("abcd"))
    assert chi2.sf(statistic, 23) > FALSE_ALARMS


def test_numbers_below_are_equally_likely():
    draws = Draws(4, "01", {})
    found = Counter(draws.below(7) for _ in range(70_000))
    assert sorted(found) == list(range(7))
    assert chi2.sf(sum((n - 10_000) ** 2 / 10_000 for n in found.values()), 6) > FALSE_ALARMS


@given(
    seed=st.integers(0, 2**64),
    pairs=st.integers(1, 5),
    groups=st.integers(1, 3),
    size=st.integers(1, 20),
    blocks=st.integers(1, 6),
)
def test_balance(seed, pairs, groups, size, blocks):
    types = [[(group, i) for i in range(pairs)] for group in range(groups)]
    made = Draws(seed, "01", {}).balanced(types, size * blocks, blocks)
    assert [len(block) for block in made] == [size] * blocks
    total = Counter(kind for block in made for kind in block)
    if size * blocks % (pairs * groups) == 0:
        assert set(total.values()) == {size * blocks // (pairs * groups)}
    for block in made:
        counts = Counter(block)
        numbers = [counts[kind] for group in types for kind in group]
        assert max(numbers) - min(numbers) <= (1 if size % (pairs * groups) else 0)
        of_groups = [sum(counts[kind] for kind in group) for group in types]
        assert max(of_groups) - min(of_groups) <= 1


@pytest.mark.parametrize("n", range(1, 8))
def test_williams_orders_balance_places_and_what_follows_what(n):
    names = [chr(ord("a") + i) for i in range(n)]
    orders = [counterbalanced(names, subject) for subject in range(2 * n)]
    for half in (orders[:n], orders[n:]):
        for place in range(n):
            assert sorted(order[place] for order in half) == names
    follows = Counter(pair for order in orders for pair in pairwise(order))
    assert len(follows) == n * (n - 1)
    assert len(set(follows.values())) <= 1
    assert counterbalanced(names, 2 * n) == orders[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([], 0), r"names must hold at least one, got none"),
        ((["a", "b", "a"], 0), r"names must differ, got \['a', 'b', 'a'\]"),
        ((["a"], -1), r"subject_index must be at least 0, got -1"),
    ],
)
def test_counterbalanced_says_what_is_wrong(arguments, message):
    with pytest.raises(ValueError, match=message):
        counterbalanced(*arguments)


def test_draws_say_what_is_wrong():
    with pytest.raises(ValueError, match=r"seed must be at least 0, got -1"):
        Draws(-1, "01", {})
    with pytest.raises(ValueError, match=r"subject must have a name, got ''"):
        Draws(1, "", {})
    with pytest.raises(TypeError, match=r"subject must be a str, such as '01', got 1"):
        Draws(1, 1, {})
    with pytest.raises(TypeError, match="float"):
        Draws(1.5, "01", {})


def test_answers_are_checked():
    with pytest.raises(ValueError, match=r"there is no trial left to answer, got 'same'"):
        FixedOrder([], ("same", "different")).answer("same")
    with pytest.raises(ValueError, match=r"there is no trial left"):
        checked_trial(None, "same", ("same",))
