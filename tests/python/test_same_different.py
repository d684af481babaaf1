"""Same-different: the four pairs equal to the trial, the order a function of seed and subject alone."""

from __future__ import annotations

import json
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from burrlab import materials
from burrlab.psychophysics.designs import SameDifferent
from burrlab.psychophysics.trial import Stimulus

BONE, PVC = (Stimulus(name, materials[name]) for name in ("bone", "pvc"))
PAIRS = {"AA", "AB", "BA", "BB"}


def kinds(trials):
    return [trial.trial_type for trial in trials]


@given(
    seed=st.integers(0, 2**64),
    subject=st.text(min_size=1, max_size=5),
    quarter=st.integers(1, 8),
    practice=st.integers(0, 9),
    blocks=st.integers(1, 6),
)
def test_the_four_pairs_are_equal_to_the_trial(seed, subject, quarter, practice, blocks):
    trials = 4 * quarter * blocks
    design = SameDifferent(BONE, PVC, trials=trials, practice=practice, blocks=blocks)
    order = design.order(seed=seed, subject=subject)
    assert order.total == trials + practice == len(order.trials)
    main = [trial for trial in order.trials if trial.phase == "main"]
    assert Counter(kinds(main)) == dict.fromkeys(PAIRS, trials // 4)
    for block in range(1, blocks + 1):
        assert set(Counter(kinds(t for t in main if t.block == block)).values()) == {quarter}
    first = order.trials[:practice]
    assert all(trial.phase == "practice" and trial.block == 0 for trial in first)
    numbers = [Counter(kinds(first))[pair] for pair in PAIRS]
    assert max(numbers) - min(numbers) <= 1
    assert [trial.number for trial in order.trials] == [*range(1, practice + 1), *range(1, trials + 1)]


def test_blocks_that_four_does_not_divide():
    order = SameDifferent(BONE, PVC, blocks=2).order(seed=1, subject="01")
    assert Counter(kinds(order.trials)) == dict.fromkeys(PAIRS, 3)
    for block in (1, 2):
        numbers = Counter(kinds(trial for trial in order.trials if trial.block == block))
        assert set(numbers.values()) <= {1, 2}
        assert numbers["AA"] + numbers["BB"] == 3


def test_a_trial_is_what_its_type_says():
    order = SameDifferent(BONE, PVC, interval=5.0, trials=40, practice=4).order(seed=3, subject="01")
    for trial in order.trials:
        shown = [interval.stimulus for interval in trial.intervals]
        assert shown == [{"A": BONE, "B": PVC}[letter] for letter in trial.trial_type]
        assert trial.correct == ("same" if shown[0] == shown[1] else "different")
        assert [interval.duration for interval in trial.intervals] == [5.0, 5.0]
        assert trial.level is None
    seeds = [interval.seed for trial in order.trials for interval in trial.intervals]
    assert len(set(seeds)) == 88
    assert all(0 <= seed < 2**64 for seed in seeds)


def test_the_same_again_and_another_subject_another_order():
    design = SameDifferent(BONE, PVC)
    first = design.order(seed=1, subject="01").trials
    assert design.order(seed=1, subject="01").trials == first
    assert SameDifferent(BONE, PVC).order(seed=1, subject="01").trials == first
    others = [
        design.order(seed=2, subject="01").trials,
        design.order(seed=1, subject="02").trials,
        SameDifferent(BONE, PVC, mode="drilling").order(seed=1, subject="01").trials,
    ]
    for trials in others:
        assert kinds(trials) != kinds(first)
        assert trials[0].intervals[0].seed != first[0].intervals[0].seed


def test_orders_do_not_depend_on_the_answers():
    design = SameDifferent(BONE, PVC)
    orders = [design.order(seed=1, subject="01") for _ in range(3)]
    while any(order.next() for order in orders):
        trials = [order.next() for order in orders]
        assert trials[0] == trials[1] == trials[2]
        assert orders[0].next() is trials[0]  # until it is answered
        right = trials[0].correct
        for order, answer in zip(orders, ("same", "different", right), strict=True):
            order.answer(answer)
    assert [trial for trial, _ in orders[2].answered] == list(orders[2].trials)
    assert all(trial.correct == answer for trial, answer in orders[2].answered)


def test_answers_are_from_the_set():
    order = SameDifferent(BONE, PVC).order(seed=1, subject="01")
    with pytest.raises(ValueError, match=r"response must be one of same, different, got 'first'"):
        order.answer("first")
    for _ in range(12):
        order.answer("same")
    assert order.next() is None
    with pytest.raises(ValueError, match=r"there is no trial left to answer, got 'same'"):
        order.answer("same")


def test_pairs_of_neighbours_are_as_random_as_a_shuffle():
    """P(the second trial's type is the first's) = 2/11 with three of each: 20 000 subjects, false-alarm rate 1e-6."""
    design = SameDifferent(BONE, PVC)
    n = 20_000
    again = sum(
        kinds(design.order(seed=5, subject=str(i)).trials[:2]) in ([pair] * 2 for pair in PAIRS)
        for i in range(n)
    )
    p = 2 / 11
    assert abs(again - n * p) < 4.9 * (n * p * (1 - p)) ** 0.5


def test_a_design_is_written_whole():
    design = SameDifferent(BONE, PVC, trials=8, interval=2, mode="drilling", practice=1, blocks=2)
    assert json.loads(json.dumps(design.to_dict())) == {
        "design": "same-different",
        "a": {
            "name": "bone",
            "material": "bone",
            "c_e_N_per_mm2": 2.145,
            "alpha_per_ms": 0.087,
            "shape": "parabolic",
        },
        "b": {
            "name": "pvc",
            "material": "pvc",
            "c_e_N_per_mm2": 0.462,
            "alpha_per_ms": 0.256,
            "shape": "parabolic",
        },
        "trials": 8,
        "interval_s": 2.0,
        "mode": "drilling",
        "practice": 1,
        "blocks": 2,
    }
    said = SameDifferent(BONE, PVC).power(20)
    assert said.startswith("bone or pvc in two intervals of 20 s (probing), chance 0.5")
    assert "same-different, 12 trials, 20 subjects" in said
    assert (design.task, design.answers) == ("same-different", ("same", "different"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"a": Stimulus("real bone")}, r"a must have a material to be rendered, got the real specimen 'real bone'"),
        ({"b": Stimulus("real bone")}, r"b must have a material to be rendered"),
        ({"b": BONE}, r"a and b must have different names, got 'bone' twice"),
        ({"trials": 10}, r"trials must be a multiple of 4 \(AA, AB, BA, BB equally often\), got 10"),
        ({"trials": 0}, r"trials must be at least 4, got 0"),
        ({"blocks": 5}, r"trials must be a multiple of 5, the number of blocks, got 12"),
        ({"blocks": 0}, r"blocks must be at least 1, got 0"),
        ({"practice": -1}, r"practice must be at least 0, got -1"),
        ({"interval": 0.0}, r"interval must be a time above 0 \[s\], got 0.0"),
        ({"interval": float("nan")}, r"interval must be a time above 0 \[s\], got nan"),
        ({"mode": "burning"}, r"mode must be one of probing, drilling, got 'burning'"),
    ],
)  # fmt: skip
def test_wrong_values_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        SameDifferent(**{"a": BONE, "b": PVC, **change})


def test_wrong_types_are_named():
    with pytest.raises(TypeError, match=r"a must be a Stimulus, such as .*, got Material"):
        SameDifferent(materials["bone"], PVC)
    with pytest.raises(TypeError, match="float"):
        SameDifferent(BONE, PVC, trials=12.5)
