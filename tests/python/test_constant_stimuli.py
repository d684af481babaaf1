"""Constant stimuli: what is varied, held and asked, balanced at each level."""

from __future__ import annotations

import json
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from burrlab import materials
from burrlab._core import Burr, Material
from burrlab.psychophysics.staircase import ConstantStimuli
from burrlab.psychophysics.trial import Stimulus
from burrlab.theory.continuum import mean_field_descent

BONE = Stimulus("bone", materials["bone"])
LEVELS = (0.7, 1.1, 1.4)


def design(parameter="c_e", levels=LEVELS, **options):
    return ConstantStimuli(BONE, parameter, levels, **options)


@given(
    seed=st.integers(0, 2**64),
    levels=st.lists(st.sampled_from([0.5, 0.8, 0.9, 1.1, 1.2, 2.0]), min_size=1, max_size=6, unique=True),
    half=st.integers(1, 6),
    practice=st.integers(0, 7),
)
def test_levels_and_orders_are_equal_to_the_trial(seed, levels, half, practice):
    order = design(levels=levels, repeats=2 * half, practice=practice).order(seed=seed, subject="01")
    main = order.trials[practice:]
    assert Counter((t.level, t.trial_type) for t in main) == {
        (level, kind): half for level in levels for kind in ("RC", "CR")
    }
    first = Counter((t.level, t.trial_type) for t in order.trials[:practice])
    assert max(first.values(), default=0) <= -(-practice // (2 * len(levels)))


def test_blocks_are_balanced_where_they_can_be():
    order = design(repeats=8, blocks=4).order(seed=1, subject="01")
    for block in range(1, 5):
        types = Counter((t.level, t.trial_type) for t in order.trials if t.block == block)
        assert set(types.values()) == {1}
        assert len(types) == 6


@pytest.mark.parametrize(
    ("parameter", "mode", "hold", "question", "more"),
    [
        ("c_e", "probing", "other", "stiffer", "c_e"),
        ("c_e", "drilling", "other", "sink faster", "speed"),
        ("c_e", "drilling", "sinking speed", "stiffer", "c_e"),
        ("alpha", "drilling", "other", "sink faster", "speed"),
    ],
)
def test_the_correct_answer_is_the_interval_with_more_of_what_is_asked(parameter, mode, hold, question, more):
    """The speed is that of the mean-field solver: more c_e sinks more slowly."""
    task = design(parameter, mode=mode, hold=hold)
    assert question in task.question
    burr = Burr(3.0)
    for trial in task.order(seed=1, subject="01").trials:
        shown = [interval.stimulus.material for interval in trial.intervals]
        if more == "c_e":
            values = [material.c_e for material in shown]
        else:
            values = [mean_field_descent(burr, material, 0.5).velocity() for material in shown]
        assert trial.correct == ("first" if values[0] > values[1] else "second")
        reference, comparison = shown if trial.trial_type == "RC" else shown[::-1]
        assert reference == BONE.material
        assert getattr(comparison, parameter) / getattr(reference, parameter) == pytest.approx(trial.level)


def test_what_is_held():
    bone = BONE.material
    one = design().comparison(1.3).material
    assert (one.c_e, one.alpha) == (pytest.approx(1.3 * bone.c_e), bone.alpha)
    two = design("alpha", mode="drilling").comparison(1.3).material
    assert (two.c_e, two.alpha) == (bone.c_e, pytest.approx(1.3 * bone.alpha))
    assert "alpha is held at 0.087 /ms" in design().held
    assert "both change" in design(mode="drilling").held
    assert "c_e is held at 2.145 N/mm^2" in design("alpha", mode="drilling").held


@pytest.mark.parametrize(("shape", "exponent"), [("parabolic", 8 / 3), ("quartic", 4.0)])
def test_the_sinking_speed_is_held(shape, exponent):
    """Mean-field at 1 N: without alpha's change a c_e of 1.3 times halves the speed."""
    reference = Material("x", c_e=2.145, alpha=0.087, shape=shape)
    task = ConstantStimuli(Stimulus("x", reference), "c_e", [1.3], mode="drilling", hold="sinking speed")
    assert f"alpha/c_e^{exponent:.3g} is held" in task.held
    speed = mean_field_descent(Burr(3.0), reference, 1.0).velocity()
    for level in (0.75, 1.3):
        made = task.comparison(level).material
        assert made.alpha / made.c_e**exponent == pytest.approx(reference.alpha / reference.c_e**exponent)
        assert made.shape == reference.shape
        assert mean_field_descent(Burr(3.0), made, 1.0).velocity() == pytest.approx(speed, rel=0.025)


def test_orders_do_not_depend_on_the_answers_and_differ_between_subjects():
    orders = [design().order(seed=1, subject="01") for _ in range(2)]
    while orders[0].next() is not None:
        assert orders[0].next() == orders[1].next()
        orders[0].answer("first")
        orders[1].answer("second")
    assert orders[1].next() is None
    levels = {tuple(t.level for t in design().order(seed=1, subject=str(i)).trials) for i in range(9)}
    assert len(levels) == 9


def test_seeds_are_the_intervals_own():
    trials = design(practice=3).order(seed=1, subject="01").trials
    seeds = [interval.seed for trial in trials for interval in trial.intervals]
    assert len(set(seeds)) == len(seeds) == 2 * 63


def test_a_design_is_written_whole():
    written = json.loads(
        json.dumps(design("alpha", mode="drilling", repeats=4, blocks=2, practice=1).to_dict())
    )
    assert written["design"] == "constant-stimuli"
    assert written["reference"]["alpha_per_ms"] == 0.087
    assert written["held"] == "c_e is held at 2.145 N/mm^2"
    assert written["question"].startswith("In which interval did the burr sink faster")
    names = ("parameter", "mode", "hold", "chance", "interval_s", "practice", "blocks", "levels", "repeats")
    assert [written[name] for name in names] == [
        "alpha",
        "drilling",
        "other",
        0.5,
        20.0,
        1,
        2,
        [0.7, 1.1, 1.4],
        4,
    ]


def test_power_says_how_well_a_stated_observer_is_measured():
    said = design(levels=(1.05, 1.1, 1.2, 1.4)).power(12)
    assert said == design(levels=(1.05, 1.1, 1.2, 1.4)).power(12)
    assert "alpha is held at 0.087 /ms" in said
    assert "75 % correct at a ratio of 1.14 (the middle of the levels)" in said
    assert "of 12 such subjects" in said


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reference": Stimulus("real")}, r"reference must have a material to be rendered, got the real specimen 'real'"),
        ({"parameter": "shape"}, r"parameter must be one of c_e, alpha, got 'shape'"),
        ({"parameter": "alpha"}, r"mode must be 'drilling' for parameter 'alpha', got 'probing': alpha alone changes nothing with the burr off"),
        ({"parameter": "alpha", "mode": "drilling", "hold": "sinking speed"}, r"hold must be 'other' for parameter 'alpha'"),
        ({"hold": "sinking speed"}, r"hold must be 'other' for mode 'probing', got 'sinking speed': nothing sinks with the burr off"),
        ({"hold": "force"}, r"hold must be one of other, sinking speed, got 'force'"),
        ({"mode": "both"}, r"mode must be one of probing, drilling, got 'both'"),
        ({"levels": []}, r"levels must hold at least one, got none"),
        ({"levels": [1.0]}, r"levels must differ from 1, got 1: two alike intervals have no correct answer"),
        ({"levels": [1.1, -1.0]}, r"levels must be a ratio above 0, got -1.0"),
        ({"levels": [float("nan")]}, r"levels must be a ratio above 0, got nan"),
        ({"levels": [1.1, 1.1]}, r"levels must differ, got \(1.1, 1.1\)"),
        ({"repeats": 3}, r"repeats must be a multiple of 2 \(RC and CR equally often\), got 3"),
        ({"blocks": 7}, r"blocks must divide the 60 trials, got 7"),
        ({"blocks": 0}, r"blocks must be at least 1, got 0"),
        ({"practice": -1}, r"practice must be at least 0, got -1"),
        ({"interval": 0.0}, r"interval must be a time above 0 \[s\], got 0.0"),
        ({"reference": Stimulus("x", Material("x", c_e=1.0, alpha=0.0))}, r"reference must have alpha above 0, got 0"),
    ],
)  # fmt: skip
def test_wrong_values_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        ConstantStimuli(**{"reference": BONE, "parameter": "c_e", "levels": LEVELS, **change})


def test_wrong_types_are_named():
    with pytest.raises(TypeError, match=r"reference must be a Stimulus"):
        ConstantStimuli("bone", "c_e", LEVELS)
    with pytest.raises(TypeError, match="float"):
        design(repeats=2.0)
