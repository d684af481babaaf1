"""Stability of the loop with a simulated hand, below and above the passivity limit."""

import numpy as np
import pytest
from stability_cases import GRID, HOLE, high_pass, run, still

from burrlab import Material

RIPPLE = 0.05  # above 20 Hz, peak to peak [N]


def check_still(material, hole, push, on):
    result, ripple, ratio = still(material, hole, push, on)
    before = result.force[1900:2000, 2]
    if ratio < 0.8:
        assert ripple < RIPPLE
        assert result.energy[2000:].max() < result.energy[2000] + 1e-3  # nothing given after the approach
        assert np.allclose(before, push, rtol=0.015)  # the push has settled, but for the rest after 2 s
    return ratio


@pytest.mark.parametrize("on", [False, True])
@pytest.mark.parametrize(
    ("material", "hole", "push"), [("bone", 0.0, 0.3), ("pettigrew", HOLE, 0.3), ("pvc", HOLE, 0.1)]
)
def test_a_still_push_below_the_limit_is_quiet(material, hole, push, on):
    assert check_still(material, hole, push, on) < 0.8


def law(c_e, q, m=0.0):
    return Material("law", c_e=c_e, alpha=0.087, force_exponent=q, rate_exponent=m)


def test_a_force_in_proportion_to_depth_is_stiff_at_first_touch():
    """q = 1: k is c_e R on flat bone at any push; 12 N/mm shakes the hand at 0.3 N, where q = 3/2 is quiet."""
    for push in (0.3, 1.0):
        assert check_still(law(2.145, 1.0), 0.0, push, False) == pytest.approx(0.64, abs=0.01)
    assert check_still(law(4.0, 1.5), 0.0, 0.3, False) < 0.8
    _, ripple, ratio = still(law(4.0, 1.0), 0.0, 0.3, False)
    assert ratio == pytest.approx(1.2, abs=0.02)
    assert ripple > 0.5


@pytest.mark.parametrize("q", [1.0, 1.5, 2.0])
def test_a_rate_that_grows_with_the_force_calms_the_burr(q):
    """At 1 N, where the rates are equal, the force of a cutting burr ripples less with m = 1 than with m = 0."""
    (_, without, _), (_, growing, _) = (still(law(2.145, q, m), 0.0, 1.0, True) for m in (0.0, 1.0))
    assert growing < 0.85 * without


@pytest.mark.slow
def test_every_still_push_below_the_limit_is_quiet():
    ratios = [check_still(*case, on) for case in GRID for on in (False, True)]
    assert sum(ratio < 0.8 for ratio in ratios) == 23


def test_beyond_the_limit_the_hand_is_shaken():
    # Bone, hole of R/3, 0.3 N: k is 12 N/mm, the limit 10.
    result, ripple, ratio = still("bone", HOLE, 0.3, False)
    assert ratio > 1.1
    assert ripple > 0.5
    assert result.energy.max() > 0.5


@pytest.mark.parametrize("on", [False, True])
def test_little_damping_cycles_at_1_khz_and_not_at_10(on):
    slow = run("bone", HOLE, 1.0, damping=2.0, on=on)
    fast = run("bone", HOLE, 1.0, period=0.1, damping=2.0, on=on)
    figures = [(r.ripple(r.window(2.0)), r.energy.max(), r.energy[-1]) for r in (slow, fast)]
    (ripple, most, _), (at_10_khz, least, last) = figures
    assert ripple > 0.5
    assert most > 10.0  # the loop feeds the hand
    assert at_10_khz < 0.005
    assert least < 0.01
    assert last < 0  # the loop takes from the hand


@pytest.mark.parametrize(("push", "damping"), [(0.3, 5.0), (1.0, 2.0)])
def test_a_coupling_below_the_limit_ends_a_cycle(push, damping):
    alone = run("bone", HOLE, push, damping=damping, on=False)
    coupled = run("bone", HOLE, push, damping=damping, on=False, coupling=0.99 * alone.limit)
    assert alone.ripple(alone.window(2.0)) > 0.5
    assert coupled.ripple(coupled.window(2.0)) < 0.005
    assert coupled.energy.max() < 0.01
    assert coupled.force[-1, 2] == pytest.approx(push, abs=0.005)


@pytest.mark.parametrize(
    ("hole", "push", "friction"), [(HOLE, 1.0, 0.04), (HOLE, 2.0, 0.04), (0.0, 1.0, 0.0), (0.0, 1.0, 0.04)]
)
def test_an_encoder_flickers_by_one_step_times_k(hole, push, friction):
    step = 0.03
    result = run("bone", hole, push, on=False, encoder_step=step, friction=friction)
    flicker, k = np.ptp(result.force[3000:, 2]), result.stiffness(3000)
    held = hole == 0 and friction > 0  # on flat, softer bone friction holds it still
    assert held or k > 2 * friction / step  # the encoder's limit
    assert flicker == (0.0 if held else pytest.approx(step * k, rel=0.05))


def test_strokes_over_flat_bone_are_quiet():
    result = run("bone", 0.0, 1.0, strokes=1.4, on=False)
    assert np.ptp(result.position[2000:, 0]) > 15.0
    assert result.ripple(result.window(2.0)) < RIPPLE


def test_slow_strokes_that_cut_are_quiet_and_fast_ones_are_shaken_by_the_groove():
    # At 1.4 strokes a second the burr leaves the pits that it digs at its turning points, as a mass on a
    # spring would. It does the same at 10 kHz, without energy from the loop.
    slow = run("bone", 0.0, 1.0, strokes=0.35, on=True)
    assert slow.ripple(slow.window(2.0)) < RIPPLE
    khz, khz10 = (run("bone", 0.0, 1.0, strokes=1.4, on=True, period=period) for period in (1.0, 0.1))
    assert khz.energy.max() < 1e-6
    ripples = [r.ripple(r.window(2.0)) for r in (khz, khz10)]
    assert 0.7 * ripples[0] < ripples[1] < ripples[0]


@pytest.mark.slow
@pytest.mark.parametrize("on", [False, True])
@pytest.mark.parametrize(("material", "hole", "push"), GRID)
def test_what_shakes_a_stroke_is_not_the_sampling(material, hole, push, on):
    khz, khz10 = (run(material, hole, push, strokes=1.4, on=on, period=period) for period in (1.0, 0.1))
    slow, fast = (r.ripple(r.window(2.0)) for r in (khz, khz10))
    assert slow < 1.3 * fast + 0.002


def test_the_filter_keeps_40_hz_and_drops_5():
    t = np.arange(0, 2, 1e-3)
    for frequency, kept in ((5.0, 1e-4), (20.0, 0.5), (40.0, 1.0)):
        wave = np.sin(2 * np.pi * frequency * t)[:, None]
        assert np.ptp(high_pass(wave, 1.0)[500:-500]) == pytest.approx(2 * kept, abs=0.02)
