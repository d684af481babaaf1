"""Match to sample: the reference first, the match first as often as second; a reference may be real."""

from __future__ import annotations

import json
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from burrlab import materials
from burrlab.psychophysics.designs import ABX
from burrlab.psychophysics.trial import Stimulus

BONE, PETTIGREW, PVC = (Stimulus(name, materials[name]) for name in ("bone", "pettigrew", "pvc"))
REAL = Stimulus("real Pettigrew")
PAPER = ABX(REAL, foil=PVC, match=PETTIGREW)


@given(
    seed=st.integers(0, 2**64), half=st.integers(1, 20), blocks=st.integers(1, 4), practice=st.integers(0, 5)
)
def test_the_match_is_first_as_often_as_second(seed, half, blocks, practice):
    trials = 2 * half * blocks
    design = ABX(REAL, PVC, match=PETTIGREW, trials=trials, blocks=blocks, practice=practice)
    main = design.order(seed=seed, subject="01").trials[practice:]
    for block in range(1, blocks + 1):
        types = Counter(trial.trial_type for trial in main if trial.block == block)
        assert types == {"AB": half, "BA": half}


def test_the_paper_s_third_task():
    order = PAPER.order(seed=1, subject="01")
    assert order.total == 10
    for trial in order.trials:
        reference, *pair = trial.intervals
        assert (reference.stimulus, reference.duration) == (REAL, None)
        assert [interval.duration for interval in pair] == [10.0, 10.0]
        shown = [interval.stimulus for interval in pair]
        assert shown == [{"A": PETTIGREW, "B": PVC}[letter] for letter in trial.trial_type]
        assert trial.correct == ("first", "second")[shown.index(PETTIGREW)]
    seeds = [interval.seed for trial in order.trials for interval in trial.intervals]
    assert len(set(seeds)) == 30
    assert PAPER.mode == "drilling"


def test_a_rendered_reference_is_its_own_match():
    design = ABX(BONE, PVC, reference_interval=5)
    assert design.matching == BONE
    trial = design.order(seed=1, subject="01").next()
    assert trial.intervals[0].stimulus == BONE
    assert trial.intervals[0].duration == 5.0
    assert BONE in [interval.stimulus for interval in trial.intervals[1:]]


def test_orders_do_not_depend_on_the_answers_and_differ_between_subjects():
    orders = [PAPER.order(seed=1, subject="01") for _ in range(2)]
    for _ in range(10):
        assert orders[0].next() == orders[1].next()
        orders[0].answer("first")
        orders[1].answer("second")
    types = {tuple(t.trial_type for t in PAPER.order(seed=1, subject=str(i)).trials) for i in range(20)}
    assert len(types) > 10


def test_chance_foil_and_reference_are_named():
    written = json.loads(json.dumps(PAPER.to_dict()))
    assert written["chance"] == 0.5
    assert written["reference"] == {"name": "real Pettigrew", "real": True}
    assert written["foil"]["name"] == "pvc"
    assert written["match"]["name"] == "pettigrew"
    assert written["reference_interval_s"] is None
    said = PAPER.power(5)
    assert (
        "reference real Pettigrew, then match pettigrew and foil pvc for 10 s each (drilling), chance 0.5"
        in said
    )
    assert "abx, 10 trials, 5 subjects" in said


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"match": None}, r"match must be given, as the reference 'real Pettigrew' is a real specimen"),
        ({"match": Stimulus("resin")}, r"match must have a material to be rendered, got the real specimen 'resin'"),
        ({"foil": Stimulus("resin")}, r"foil must have a material to be rendered, got the real specimen 'resin'"),
        ({"foil": PETTIGREW}, r"match and foil must have different names, got 'pettigrew' twice"),
        ({"trials": 9}, r"trials must be a multiple of 2 \(AB and BA equally often\), got 9"),
        ({"trials": 0}, r"trials must be at least 2, got 0"),
        ({"blocks": 3}, r"trials must be a multiple of 3, the number of blocks, got 10"),
        ({"blocks": 0}, r"blocks must be at least 1, got 0"),
        ({"practice": -1}, r"practice must be at least 0, got -1"),
        ({"interval": -1.0}, r"interval must be a time above 0 \[s\], got -1.0"),
        ({"reference_interval": 0}, r"reference_interval must be a time above 0 \[s\], got 0"),
        ({"mode": "both"}, r"mode must be one of probing, drilling, got 'both'"),
    ],
)  # fmt: skip
def test_wrong_values_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        ABX(**{"reference": REAL, "foil": PVC, "match": PETTIGREW, **change})


@pytest.mark.parametrize("name", ["reference", "match", "foil"])
def test_wrong_types_are_named(name):
    with pytest.raises(TypeError, match=rf"{name} must be a Stimulus, such as .*, got 'bone'"):
        ABX(**{"reference": REAL, "foil": PVC, "match": PETTIGREW, name: "bone"})
