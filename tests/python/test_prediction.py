"""Predictions of an experiment with a simulated subject: d', score and size follow from cues and rule."""

from __future__ import annotations

import json
import math

import pytest
from scipy.stats import binom, norm

import burrlab
from burrlab.psychophysics.interval import Block
from burrlab.psychophysics.observer import SimulatedSubject
from burrlab.psychophysics.rehearsal import predicted_d_prime

BONE, PETTIGREW, PVC = (burrlab.materials[name] for name in ("bone", "pettigrew", "pvc"))
COARSE = Block(voxel=0.2)


def test_closed_form_of_stiffness():
    found = predicted_d_prime(
        BONE, PVC, "probing", SimulatedSubject(0.36, lapse=0.0, decision="covert"), closed_form=True
    )
    d_prime = 2 / 3 * math.log(BONE.c_e / PVC.c_e) / 0.36
    assert found.d_prime == pytest.approx(d_prime)
    assert found.by_cue == {"stiffness": pytest.approx(d_prime)}
    p = norm.cdf(d_prime / 2) ** 2 + norm.cdf(-d_prime / 2) ** 2
    assert found.score == pytest.approx(12 * p)
    assert found.rule == "independent-observations"
    # 10 of 12 are needed at 5 %, and half the trials of each kind have the same proportion without bias.
    assert found.power.rows[0].subject == pytest.approx(binom.sf(9, 12, p))
    assert found.trials_needed is not None
    assert found.trials_needed > 12


def test_cues_add_in_squares_and_rendered_ones_are_those_of_the_equations():
    subject = SimulatedSubject({"stiffness": 0.3, "force": 0.2}, ("stiffness", "force"))
    found = predicted_d_prime(BONE, PETTIGREW, "probing", subject, bone=COARSE)
    exact = predicted_d_prime(BONE, PETTIGREW, "probing", subject, closed_form=True)
    assert found.d_prime == pytest.approx(math.hypot(*found.by_cue.values()))
    assert found.d_prime == pytest.approx(exact.d_prime, rel=0.01)


def test_more_subjects_need_fewer_trials():
    subject = SimulatedSubject(0.45)
    one = predicted_d_prime(BONE, PVC, "probing", subject, closed_form=True)
    many = predicted_d_prime(BONE, PVC, "probing", subject, closed_form=True, subjects=20)
    assert one.power.rows[0].group is None
    assert many.power.rows[0].group is not None
    assert many.power.rows[0].group > one.power.rows[0].subject
    assert one.subjects_needed is not None
    assert one.trials_needed is not None
    assert 1 < one.subjects_needed < one.trials_needed


def test_alike_materials_are_never_told_apart():
    other = burrlab.Material("other", c_e=BONE.c_e, alpha=0.2)
    with pytest.raises(ValueError, match="the two known materials must differ in a cue"):
        predicted_d_prime(BONE, other, "probing", SimulatedSubject(0.3), closed_form=True)
    # A cue that does not differ says nothing, and the other one what it says alone.
    held = burrlab.Material("held", c_e=BONE.c_e, alpha=2 * BONE.alpha)
    found = predicted_d_prime(BONE, held, "drilling", SimulatedSubject(0.3, ("sinking",)), closed_form=True)
    assert found.d_prime == pytest.approx(math.log(2) / 0.3)


def test_it_prints_and_is_for_json():
    found = predicted_d_prime(
        BONE, PVC, "drilling", SimulatedSubject(0.9, ("sinking",)), bone=COARSE, duration=5.0
    )
    assert str(found).startswith("same-different by drilling, differencing: d' ")
    assert "trials of one subject" in str(found)
    assert json.loads(json.dumps(found.to_dict()))["mode"] == "drilling"


@pytest.mark.parametrize(
    ("mode", "subject", "sentence"),
    [
        ("looking", SimulatedSubject(0.3), "mode must be one of probing, drilling, got 'looking'"),
        (
            "drilling",
            SimulatedSubject(0.3),
            "cues must be of the mode, drilling has sinking, got 'stiffness'",
        ),
        (
            "probing",
            SimulatedSubject(0.3, criterion=1.0),
            r"criterion must be None for a prediction, got 1\.0",
        ),
    ],
)
def test_refusals(mode, subject, sentence):
    with pytest.raises(ValueError, match=sentence):
        predicted_d_prime(BONE, PVC, mode, subject)
