"""Simulated hands that probe and drill: what they do to the paper's materials."""

from __future__ import annotations

import numpy as np
import pytest

import burrlab
from burrlab.psychophysics.interval import Block, render
from burrlab.psychophysics.observer import drilling_hand, interval_cues, probing_hand
from burrlab.psychophysics.trial import Interval, Stimulus

BURR = burrlab.Burr(3.0)
NAMES = ["bone", "pettigrew", "pvc"]


def felt(name, hand, mode, *, bone, seconds=20.0):
    interval = Interval(Stimulus(name, burrlab.materials[name]), 1, seconds)
    return render(interval, hand, burr=BURR, bone=bone, mode=mode, wall_clock=False)


@pytest.mark.parametrize("name", NAMES)
def test_probing_is_ten_presses_of_one_and_a_half_newton(name):
    found = felt(name, probing_hand(BURR), "probing", bone=Block((30, 30, 6), 0.2))
    force = np.linalg.norm(found.ticks["force"], axis=1)
    assert found.ended == "time"
    assert interval_cues(found).presses == 10
    first = int(np.argmax(found.ticks["touching"]))
    peaks = [force[first + 2000 * i : first + 2000 * i + 1500].max() for i in range(10)]
    assert peaks == pytest.approx([1.5] * 10, rel=0.015)
    rests = [force[first + 2000 * i + 1600 : first + 2000 * i + 2000].min() for i in range(9)]
    assert max(rests) < 0.04 * 1.5
    assert not found.ticks["on"].any()


@pytest.mark.parametrize("name", NAMES)
def test_twenty_seconds_of_drilling_stay_within_the_default_block(name):
    found = felt(name, drilling_hand(BURR), "drilling", bone=Block(voxel=0.2))
    force, x = found.ticks["force"][:, 2], found.ticks["center"][:, 0]
    assert found.ended == "time"
    # A burr that sinks at v is pushed with grip v follow and damping v less.
    speed = np.ptp(found.immersion[[5000, -1]]) / (0.001 * (len(force) - 5001))
    assert force[5000:].mean() == pytest.approx(0.3 - (0.4 * 0.2 + 0.005) * speed, rel=0.02)
    crossings = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0) & (np.arange(len(x) - 1) > 2000))
    assert 1000 / np.diff(crossings).mean() == pytest.approx(1.4, rel=0.01)
    assert 3.5 < np.ptp(x[2000:]) < 5.0  # the hole's walls take a part of the stroke of 5 mm
    assert found.ticks["on"].all()


def test_a_block_of_ten_millimetres_would_be_drilled_through():
    found = felt("pvc", drilling_hand(BURR), "drilling", bone=Block((30, 30, 10), 0.2))
    assert found.ended == "break-through"
    assert 15 < found.duration < 20


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: probing_hand(BURR, push=-1), "push must be zero or positive"),
        (lambda: probing_hand(BURR, presses=-1), "presses must be zero or positive"),
        (lambda: drilling_hand(BURR, push=-1), "push must be zero or positive"),
        (lambda: drilling_hand(BURR, stroke=-1), "amplitude must be zero or positive"),
        (lambda: drilling_hand(BURR, strokes=-1), "strokes must be zero or positive"),
    ],
)
def test_refusals(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()
