"""The mean-field descent and the master curve: values, closed forms, a slow independent descent, errors."""

import math

import numpy as np
import pytest

from burrlab import (
    Burr,
    MasterCurve,
    Material,
    Shape,
    _core,
    mean_field_descent,
    penetration_velocity,
    thin_layer_velocity,
)

BURR = Burr(3.0)
BONE = Material("bone", c_e=2.145, alpha=0.087)
UNIT = BONE.c_e * BURR.radius**2  # force at phi = 1 [N]
KINK = (1 / 6) ** 1.5
SHAPES = ["parabolic", "linear", "quartic", "constant", "power(0.5)", "power(3)", "power(8)"]


def direct(
    shape: str, phi: float, start: float = 1 / 6, stop: float = 1 / 3, resolution: float = 1.0
) -> float:
    """Psi of one descent."""
    time, immersion = _core.mean_field_descent(Shape(shape), phi, stop, resolution)
    return _core.window_velocity(time, immersion, max(start, immersion[0]), stop)


def slow_descent(shape: str, phi: float, stop: float, dt: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """A descent by the definition: rings of bone on a fixed (g, z) grid, equal steps in time.

    g is the height of the burr's front above its tip, z is depth. In each step the bone inside erodes, then
    the burr sinks until it holds the mass of Eq. 2.
    """
    f = Shape(shape)
    edge = np.linspace(0, stop, n + 1)
    g, z, d = (edge[:-1] + edge[1:])[:, None] / 2, (edge[:-1] + edge[1:])[None, :] / 2, stop / n
    volume = 2 * (1 - g) * d * d * np.ones_like(z)  # / pi
    density = np.ones_like(volume)
    H = phi ** (2 / 3)
    target = H**2 * (1 - H / 3)

    def covered(H: float) -> np.ndarray:
        return np.clip((H - g - z) / d + 0.5, 0, 1)

    times, immersions = [0.0], [H]
    while immersions[-1] < stop:
        x = np.sqrt(2 * g - g**2 + (1 - H + z) ** 2)
        density *= 1 - covered(H) * (1 - np.exp(-dt * np.asarray(f(x))))
        for _ in range(3):
            H += (target - float(np.sum(volume * density * covered(H)))) / (2 * H - H**2)
        times.append(times[-1] + dt)
        immersions.append(H)
    return np.array(times), np.array(immersions)


@pytest.mark.parametrize(("phi", "ratio"), [(0.025, 2.74e-4), (0.05, 1.736e-3), (0.1, 9.96e-3)])
def test_published_values(phi: float, ratio: float) -> None:
    assert direct("parabolic", phi) == pytest.approx(ratio, rel=0.01)
    assert MasterCurve("parabolic").velocity_ratio(phi) == pytest.approx(ratio, rel=0.01)


@pytest.mark.parametrize("shape", ["parabolic", "linear", "constant"])
def test_against_rings_and_time_steps(shape: str) -> None:
    expected = direct(shape, 0.1)
    duration = (1 / 3 - 0.1 ** (2 / 3)) / expected
    time, immersion = slow_descent(shape, 0.1, 1 / 3, duration / 400, 80)
    assert _core.window_velocity(time, immersion, 0.1 ** (2 / 3), 1 / 3) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("shape", "phi"), [*((shape, 0.1) for shape in SHAPES), ("parabolic", 0.04), ("parabolic", 0.18)]
)
def test_order_of_convergence(shape: str, phi: float) -> None:
    one, two, four = (direct(shape, phi, resolution=r) for r in (1, 2, 4))
    limit = four + (four - two) / 3
    assert one == pytest.approx(limit, rel=1e-3)
    # order 2; where the error nearly changes sign, the difference is small
    assert abs(four - limit) < max(abs(one - limit) / 8, 1e-5 * limit)
    if abs(one / limit - 1) > 2e-4:
        assert math.log2((one - two) / (two - four)) == pytest.approx(2, abs=0.4)


def test_constant_shape_is_exact() -> None:
    """For f = 1 the mass erodes at its own rate, so dH/dt = m/(2 H - H^2) for any phi."""
    material = Material("m", c_e=1.0, alpha=0.1, shape="constant")
    descent = mean_field_descent(BURR, material, 0.5, resolution=4)
    H, u = descent.immersion / 3, (0.5 / 9) ** (2 / 3)
    mass = u**2 * (1 - u / 3)
    np.testing.assert_allclose(descent.time[1:] * 100, (H**2 * (1 - H / 3) / mass - 1)[1:], rtol=2e-3)
    law = thin_layer_velocity(BURR, material, 0.5, 0.75)
    assert law == pytest.approx(100 * 3 * mass / (2 * 0.25 - 0.25**2), rel=1e-12)


def thin_window(shape: str, phi: float) -> float:
    """Slope of the thin-layer law over the default window."""
    H = np.linspace(1 / 6, 1 / 3, 2001)
    slowness = 1 / _core.thin_layer_velocity(Shape(shape), phi, H)
    time = np.append(0, np.cumsum((slowness[1:] + slowness[:-1]) / 2 * np.diff(H)))
    return _core.window_velocity(time, H, H[0], H[-1])


def test_thin_layer_law() -> None:
    assert direct("parabolic", 0.005) == pytest.approx(direct("parabolic", 0.005, resolution=2), rel=1e-4)
    assert direct("parabolic", 0.025) / thin_window("parabolic", 0.025) == pytest.approx(1.020, abs=0.002)
    for shape in SHAPES:
        assert direct(shape, 0.005) == pytest.approx(thin_window(shape, 0.005), rel=0.015)
    u, H = (0.1 / UNIT) ** (2 / 3), 0.7 / 3  # model.md, section 5, kappa = 2
    law = 2 / (2 * math.pi) * (3 * u**2 * (1 - u / 3) / (2 * (1 - (1 - H) ** 1.5))) ** 2
    assert thin_layer_velocity(BURR, BONE, 0.1, 0.7) == pytest.approx(87 * 3 * law, rel=1e-12)
    assert thin_layer_velocity(BURR, BONE, [[0.1], [0.2]], [0.5, 0.7, 0.9]).shape == (2, 3)


@pytest.mark.parametrize("shape", SHAPES)
def test_exponent_tells_the_order_of_the_zero(shape: str) -> None:
    assert MasterCurve(shape).local_slope(1e-5) == pytest.approx(4 * (Shape(shape).order + 1) / 3, rel=1e-3)


def test_exponents_of_the_parabolic_curve() -> None:
    curve = MasterCurve("parabolic")
    slope = curve.local_slope(np.array([1e-4, 0.01, KINK * 0.999, KINK * 1.001, 0.16]))
    np.testing.assert_allclose(slope, [8 / 3, 2.66, 2.73, 2.45, 1.71], atol=0.015)
    left, right = curve.velocity_ratio([KINK * (1 - 1e-9), KINK * (1 + 1e-9)])
    assert left == pytest.approx(right, rel=1e-7)
    assert isinstance(MasterCurve(Shape("parabolic")).velocity_ratio(0.1), float)
    assert curve.velocity_ratio(np.full((2, 3), 0.1)).shape == (2, 3)
    assert repr(curve) == "MasterCurve('parabolic')"


@pytest.mark.parametrize(
    ("shape", "window"),
    [*((shape, (None, None)) for shape in SHAPES), ("parabolic", (0.2, None)), ("linear", (0.1, 0.3)), ("quartic", (0.25, 0.5))],
)  # fmt: skip
def test_master_curve_against_single_descents(shape: str, window: tuple[float | None, float | None]) -> None:
    start, stop = window[0] or 1 / 6, window[1] or 1 / 3
    kink, end = start**1.5, stop**1.5
    phi = np.array([0.25 * kink, 0.6 * kink, 0.97 * kink, kink, 1.03 * kink, 0.9 * end, 0.995 * end])
    expected = [direct(shape, value, start, stop) for value in phi.tolist()]
    np.testing.assert_allclose(MasterCurve(shape).velocity_ratio(phi, *window), expected, rtol=2e-3)


@pytest.mark.parametrize("shape", ["parabolic", "linear", "quartic"])
def test_continuation_below_the_knots(shape: str) -> None:
    assert MasterCurve(shape).velocity_ratio(0.0015) == pytest.approx(direct(shape, 0.0015), rel=5e-4)
    low, high = MasterCurve(shape).velocity_ratio(np.array([1e-12, 1e-11]))
    assert math.log10(high / low) == pytest.approx(4 * (Shape(shape).order + 1) / 3, rel=1e-3)


def test_windows_from_the_very_start_and_very_short() -> None:
    curve = MasterCurve("parabolic")
    assert curve.velocity_ratio(0.02, 0.0) == pytest.approx(direct("parabolic", 0.02, 0.0), rel=2e-3)
    assert np.isfinite(curve.velocity_ratio([0.01, 0.1924], 0.3332)).all()


def test_velocity_of_straight_and_of_bent_records() -> None:
    assert _core.window_velocity([0, 1, 4], [0, 2, 8], 1, 7) == pytest.approx(2.0, rel=1e-15)
    # H = t on 0..1, 3 t - 2 on 1..2: 12 int (t - 1) H dt / 2^3 = 2
    assert _core.window_velocity([0, 1, 2], [0, 1, 4], 0, 4) == pytest.approx(2.0, rel=1e-15)


def test_no_window() -> None:
    ratio = MasterCurve("parabolic").velocity_ratio([0.19, 0.1925, 0.5])
    assert np.isnan(ratio).tolist() == [False, True, True]
    assert np.isnan([MasterCurve("parabolic").local_slope(0.2), penetration_velocity(BURR, BONE, 4.0)]).all()
    deep = mean_field_descent(BURR, BONE, 4.0, stop=2.0)
    assert np.isnan(deep.velocity())
    assert deep.velocity(0.5, 2.0) > 0


def test_descent_units_and_window() -> None:
    descent = mean_field_descent(BURR, BONE, 1.0)
    assert (descent.time[0], descent.immersion[0], descent.immersion[-1], descent.window()) == (
        0, pytest.approx(3 * (1 / UNIT) ** (2 / 3)), pytest.approx(1.0), (0.5, 1.0),
    )  # fmt: skip
    assert descent.window(0.1)[0] == descent.immersion[0]
    assert descent.velocity() == pytest.approx(0.50, abs=0.005)  # bone at 1 N sinks at 0.50 mm/s
    assert (descent.velocity(), descent.velocity(0.8) / descent.velocity()) == (
        pytest.approx(penetration_velocity(BURR, BONE, 1.0), rel=2e-3), pytest.approx(0.77, abs=0.01),
    )  # fmt: skip
    expected = penetration_velocity(BURR, BONE, [1.0], 0.6, 0.9)
    assert descent.velocity(0.6, 0.9) == pytest.approx(expected[0], rel=2e-3)
    with pytest.raises(ValueError, match="read-only"):
        descent.immersion[0] = 0


def test_scaling() -> None:
    """alpha stretches the velocity axis, c_e the force axis, R both."""
    force = np.array([0.2, 0.7, 1.9])
    base = penetration_velocity(BURR, BONE, force)
    other = Material("other", c_e=3 * 2.145, alpha=2 * 0.087)
    np.testing.assert_allclose(penetration_velocity(BURR, other, 3 * force), 2 * base, rtol=1e-12)
    np.testing.assert_allclose(penetration_velocity(Burr(1.5), BONE, force / 4), base / 2, rtol=1e-12)


DESCENT = mean_field_descent(BURR, BONE, 1.0)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        *((lambda f=f: mean_field_descent(BURR, BONE, f),
            "force must be positive and finite") for f in (0.0, -1.0, math.nan, math.inf)),
        (lambda: mean_field_descent(BURR, BONE, 4.0), r"force must be below c_e R\^2 \(stop/R\)\^1.5 = 3.715 N"),
        *((lambda s=s: mean_field_descent(BURR, BONE, 1.0, stop=s),
            "stop must be above 0 and at most R = 3 mm")
          for s in (0.0, 3.1, math.nan)),
        (lambda: mean_field_descent(BURR, BONE, 1.0, resolution=0), "resolution must be positive"),
        (lambda: mean_field_descent(BURR, BONE, 1.0, resolution=65), "resolution must be at most 64, got 65"),
        (lambda: mean_field_descent(BURR, Material("ivory", c_e=1.0, alpha=0.0), 1.0),
         "alpha of the material must be positive"),
        (lambda: mean_field_descent(BURR, BONE, 1e-5), "at most 200000"),
        *((lambda a=a: _core.mean_field_descent(Shape("linear"), *a), told)
          for a, told in (((0.3, 1 / 3), "phi must be below"), ((0.0, 1 / 3), "phi must be positive"),
                          ((math.nan, 1 / 3), "phi must be positive"), ((0.1, 1.1), r"stop must be in \(0, 1\]"),
                          ((0.1, math.nan), r"stop must be in \(0, 1\]"))),
        (lambda: _core.thin_layer_velocity(Shape("linear"), -1.0, 0.2), "phi must be positive"),
        (lambda: _core.thin_layer_velocity(Shape("linear"), 0.1, 0.0), r"immersion must be in \(0, 1\]"),
        (lambda: DESCENT.velocity(stop_mm=1.2), r"stop_mm must not lie beyond the descent's end, 1 mm, got 1\.2"),
        (lambda: DESCENT.velocity(0.9, 0.8), "0 <= start < stop"),
        *((lambda w=w: MasterCurve("parabolic").velocity_ratio(0.1, *w), "0 <= start < stop")
          for w in ((0.3, 0.2), (-0.1, 0.2), (0.1, 1.5), (math.nan, 0.3), (None, 0.1))),
        *((lambda p=p: MasterCurve("parabolic").velocity_ratio([0.1, p]), "phi must be positive") for p in (0.0, -1.0, math.nan)),
        (lambda: penetration_velocity(BURR, BONE, [1.0, 0.0]), "force must be positive"),
        (lambda: thin_layer_velocity(BURR, BONE, -1.0, 0.5), "force must be positive"),
        (lambda: thin_layer_velocity(BURR, BONE, 1.0, [0.5, 3.5]),
         "immersion must be above 0 and at most R = 3 mm"),
        *((lambda a=a: _core.window_velocity(*a), told)
          for a, told in (
            (([[0, 1]], [0, 1], 0, 1), "dimensions of time must be 1"), (([0], [0], 0, 1), "two points or more"),
            (([0, 1], [0, math.nan], 0, 1), "every immersion must be finite"),
            (([0, 0], [0, 1], 0, 1), "time must be rising"), (([0, 1], [1, 0], 0, 1), "immersion must be rising"),
            (([0, 1], [0, 1], -0.1, 1), "start must be within"), (([0, 1], [0, 1], 0, 1.1), "stop must be within"),
            (([0, 1], [0, 1], 0.5, 0.5), "start must be below stop"))),
    ],
)  # fmt: skip
def test_what_is_refused(call, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        call()
