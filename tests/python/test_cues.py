"""Cues of intervals: against closed forms, and of presses made by hand."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

import burrlab
from burrlab.psychophysics.interval import TICK, Block, Rendered, render
from burrlab.psychophysics.observer import Cues, closed_form_cues, drilling_hand, interval_cues, rendered_cues
from burrlab.psychophysics.trial import Interval, Stimulus

BURR = burrlab.Burr(3.0)
COARSE = Block(voxel=0.2)
NAMES = ["bone", "pettigrew", "pvc"]


def made(force, depth, *, mode="probing"):
    """An interval with this force [N] and immersion [mm] at each tick; the penetration is half the immersion."""
    ticks = np.zeros(len(force), TICK)
    ticks["time"], ticks["periods"] = 0.001 * np.arange(len(force)), 1
    ticks["center"][:, 2], ticks["force"][:, 2] = BURR.radius - np.asarray(depth), force
    ticks["penetration"], ticks["touching"] = 0.5 * np.maximum(depth, 0), np.asarray(depth) > 0
    contact = 0.001 * float(ticks["touching"].sum())
    return Rendered(mode, "time", 0.001 * len(ticks), contact, 1, BURR, ticks)


def press(peak, deepest, n=200):
    part = np.sin(np.pi * np.arange(n) / n)
    return peak * part, deepest * part


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("voxel", [0.1, 0.2])
def test_probing_gives_what_the_equations_say(name, voxel):
    found = rendered_cues(burrlab.materials[name], "probing", burr=BURR, bone=Block(voxel=voxel))
    expected = closed_form_cues(burrlab.materials[name], burr=BURR)
    assert found.presses == 10
    assert found.stiffness == pytest.approx(
        expected.stiffness, abs=0.004
    )  # the peak is up to 1 % below 1.5 N
    assert found.force == pytest.approx(expected.force, abs=0.01)
    assert math.isnan(found.sinking)


@pytest.mark.parametrize(("a", "b"), list(combinations(NAMES, 2)))
def test_differences_of_probing_are_logarithms_of_c_e(a, b):
    found = [rendered_cues(burrlab.materials[n], "probing", burr=BURR, bone=COARSE) for n in (a, b)]
    ratio = math.log(burrlab.materials[a].c_e / burrlab.materials[b].c_e)
    assert found[0].stiffness - found[1].stiffness == pytest.approx(2 / 3 * ratio, abs=0.003)
    assert found[0].force - found[1].force == pytest.approx(ratio, abs=0.003)


def test_closed_forms_of_the_paper():
    bone, pettigrew, pvc = (closed_form_cues(burrlab.materials[name], burr=BURR) for name in NAMES)
    assert bone.stiffness - pvc.stiffness == pytest.approx(1.02, abs=0.005)
    assert bone.stiffness - pettigrew.stiffness == pytest.approx(0.24, abs=0.005)
    assert pvc.sinking - bone.sinking == pytest.approx(5.2, abs=0.05)
    assert pettigrew.sinking - bone.sinking == pytest.approx(1.23, abs=0.01)
    still = burrlab.Material("still", c_e=1.0, alpha=0.0)
    assert closed_form_cues(still, burr=BURR).sinking == -math.inf


def test_depth_after_a_time_tells_less_than_speed_at_a_depth():
    # The thin-layer law's speed goes as 1/H^2 at small H, so that H goes as the cube root of the speed's factor.
    bone, pvc = (
        rendered_cues(burrlab.materials[n], "drilling", burr=BURR, bone=COARSE) for n in ("bone", "pvc")
    )
    assert math.isnan(bone.stiffness)
    assert math.isnan(bone.force)
    assert 5.17 / 3 < pvc.sinking - bone.sinking < 5.17 / 1.8


def test_speed_at_a_depth_is_the_closed_form():
    speeds = []
    for name in ("bone", "pettigrew"):
        hand = drilling_hand(BURR, strokes=0)
        interval = Interval(Stimulus(name, burrlab.materials[name]), 1, 20.0)
        found = render(interval, hand, burr=BURR, bone=COARSE, mode="drilling", wall_clock=False)
        first, last = np.searchsorted(np.maximum.accumulate(found.immersion), [0.65, 0.75])
        speeds.append(0.1 / (found.ticks["time"][last] - found.ticks["time"][first]))
    assert math.log(speeds[1] / speeds[0]) == pytest.approx(1.234, abs=0.08)


def test_the_erosion_scatters_little():
    found = [
        rendered_cues(burrlab.materials["bone"], "drilling", burr=BURR, bone=COARSE, seed=seed).sinking
        for seed in range(1, 5)
    ]
    assert 0.0 < np.std(found, ddof=1) < 0.005


def test_rendered_cues_are_kept():
    first = rendered_cues(burrlab.materials["bone"], "probing", burr=BURR, bone=COARSE)
    assert rendered_cues(burrlab.materials["bone"], "probing", burr=burrlab.Burr(3.0), bone=COARSE) is first


def test_each_press_counts_once_and_the_mean_comes_before_the_logarithm():
    parts = [press(1.0, 0.5), press(2.0, 0.5), press(0.3, 0.5)]
    found = interval_cues(made(*(np.concatenate(column) for column in zip(*parts, strict=True))))
    assert found.presses == 2  # the third does not come to half of the largest
    assert found.stiffness == pytest.approx(math.log((1.0 / 0.25 + 2.0 / 0.25) / 2), abs=1e-9)
    # Linear between ticks: the sine's force at 0.2 of 0.5 mm is 0.4 of the peak.
    assert found.force == pytest.approx(math.log((0.4 + 0.8) / 2), abs=1e-4)


def test_a_tremble_does_not_make_two_presses_of_one():
    force, depth = press(1.0, 0.5, 400)
    force = force - 0.3 * (np.arange(400) == 200)
    assert interval_cues(made(force, depth)).presses == 1


def test_no_force_at_the_depth_where_the_burr_was_deeper_all_the_time():
    force, depth = press(1.0, 0.5)
    assert math.isnan(interval_cues(made(force, depth + 0.3)).force)


def test_nothing_felt_is_nothing_known():
    zero = np.zeros(10)
    for mode in ("probing", "drilling"):
        found = interval_cues(made(zero, zero - 1.0, mode=mode))
        assert (found.presses, *map(math.isnan, (found.stiffness, found.force, found.sinking))) == (
            0,
            True,
            True,
            True,
        )
    for mode in ("probing", "drilling"):
        assert interval_cues(made(zero[:0], zero[:0], mode=mode)).presses == 0


def test_sinking_is_depth_over_contact():
    depth = np.concatenate(
        [np.full(100, -1.0), np.linspace(0.01, 2.0, 400), np.full(100, 1.0), np.full(50, -1.0)]
    )
    found = interval_cues(made(np.where(depth > 0, 0.3, 0.0), depth, mode="drilling"))
    assert found.sinking == pytest.approx(math.log(2.0 / 0.5))


def test_cues_for_json():
    assert Cues(stiffness=1.0).to_dict() == {"stiffness": 1.0, "force": None, "sinking": None, "presses": 0}
