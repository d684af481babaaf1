"""Stability of the loop with a simulated hand, below and above the passivity limit."""

import numpy as np
import pytest
from stability_cases import GRID, HOLE, RADIUS, high_pass, run, still

import burrlab
import burrlab._core as _core

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
    assert held or k > _core.encoder_limit(friction, step)
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


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("virtual", [0.0, 0.7, -0.7])
def test_the_limit_follows_from_the_general_condition(delay, virtual):
    # Colgate and Schenkel: b > T/2/(1 - cos wT) Re{(1 - e^-jwT) H(e^jwT)} at every w up to the Nyquist
    # frequency. For H = (K + B (1 - z^-1)/T) z^-delay this is exactly our limit with a delay or a virtual
    # damping, and below it with both.
    period, k = 1e-3, 3000.0
    w = np.linspace(1e-3, np.pi, 200001)
    z = np.exp(1j * w)
    h = (k + virtual * (1 - 1 / z) / period) * z**-delay
    needed = (period / 2 / (1 - np.cos(w)) * ((1 - 1 / z) * h).real).max()
    b = k * (period / 2 + delay * period) + abs(virtual)
    limit = 1e3 * _core.passivity_limit(b, 1e3 * period, delay * 1e3 * period, virtual)  # [N/m]
    assert limit == pytest.approx(k)
    assert needed <= b * (1 + 1e-9)
    if delay == 0 or virtual <= 0:
        assert needed == pytest.approx(b, rel=1e-4)


def test_report():
    burr, bone = burrlab.Burr(RADIUS), burrlab.materials["bone"]
    area = _core.hole_contact_area(RADIUS, 1.1)
    k = _core.contact_stiffness(1.0, area, radius=RADIUS, c_e=bone.c_e)
    assert _core.contact_area(1.0, k, radius=RADIUS, c_e=bone.c_e) == pytest.approx(area)
    report = _core.stability_report(
        1.0, k, burr, bone, period=1.0, damping=5.0, encoder_step=0.0, friction=0.0
    )
    assert (report.limit, report.sampling_limit) == (10.0, 10.0)
    assert np.isinf(report.quantisation_limit)
    assert report.ratio == pytest.approx(k / 10)
    assert report.warning
    again = _core.contact_stiffness(report.force_at_limit, area, radius=RADIUS, c_e=bone.c_e)
    assert again == pytest.approx(10.0)
    assert "ratio=0.83" in repr(report)
    unknown = _core.stability_report(1.0, k, burr, bone, period=1.0)
    assert np.isnan(unknown.ratio)
    assert not unknown.warning


GIVEN = {"force": 1.0, "stiffness": 8.0, "period": 1.0, "damping": 5.0, "friction": 0.1, "encoder_step": 0.01}


def report(**change):
    given = GIVEN | change
    bone = burrlab.materials["bone"]
    _core.stability_report(given.pop("force"), given.pop("stiffness"), burrlab.Burr(3.0), bone, **given)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: _core.flat_contact_area(3.0, -0.1), "penetration must be 0 to 2 radii, got -0.1"),
        (lambda: _core.hole_contact_area(3.0, 6.1), "depth must be 0 to 2 radii, got 6.1"),
        (lambda: _core.contact_stiffness(-1.0, 1.0, radius=3.0, c_e=2.0), "force must be zero or positive"),
        (lambda: _core.contact_area(1.0, -1.0, radius=3.0, c_e=2.0), "stiffness must be zero or positive"),
        (lambda: _core.passivity_limit(-1.0, 1.0), "damping must be zero or positive"),
        (lambda: _core.encoder_limit(-1.0, 1.0), "friction must be zero or positive"),
        (lambda: _core.passivity_energy(np.zeros((3, 3)), np.zeros((2, 3))), r"must have one shape \(n, 3\)"),
        *((lambda n=name: report(**{n: -1.0}), f"{name} must be zero or positive")
          for name in ("force", "stiffness", "damping", "friction", "encoder_step")),
        (lambda: report(period=0.0), "period must be positive"), (lambda: report(coupling=0.0),
         "coupling must be positive, got 0"),
    ],
)  # fmt: skip
def test_refusals(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()
