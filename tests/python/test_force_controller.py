"""The force controller as a rig uses it: terms, limits, anti-windup, derivative, gains, errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from burrlab._core import ForceController


def test_terms_add_up() -> None:
    pid = ForceController(2.0, 10.0, 0.1, output_limits=(-50, 50), derivative_filter=3.0)
    random = np.random.default_rng(1)
    integral = slope = 0.0
    last = None
    for _ in range(200):
        setpoint, force, dt = random.uniform(0, 1), random.uniform(0, 1), random.uniform(0.5, 2.0)
        if last is not None:
            slope += ((force - last) / (1e-3 * dt) - slope) * dt / (dt + 3.0)
        last = force
        integral += 10.0 * (setpoint - force) * 1e-3 * dt
        output = pid.update(setpoint, force, dt)
        assert pid.proportional_term == pytest.approx(2.0 * (setpoint - force), rel=1e-12, abs=1e-12)
        assert pid.integral_term == pytest.approx(integral, rel=1e-9, abs=1e-12)
        assert pid.derivative_term == pytest.approx(-0.1 * slope, rel=1e-9, abs=1e-12)
        wanted = pid.proportional_term + pid.integral_term + pid.derivative_term
        assert output == pid.output == np.clip(wanted, -50, 50)


def test_defaults_and_readable_settings() -> None:
    pid = ForceController(1.0)
    assert (pid.kp, pid.ki, pid.kd) == (1.0, 0.0, 0.0)
    assert pid.output_limits == (-10.0, 10.0)
    assert pid.derivative_filter == 5.0
    assert pid.output == pid.integral_term == 0.0


def test_output_stays_within_its_limits() -> None:
    pid = ForceController(100.0, 1000.0, 1.0, output_limits=(-2, 3))
    outputs = [pid.update(1.0, force, 1.0) for force in np.random.default_rng(2).uniform(-5, 5, 500)]
    assert min(outputs) == -2.0
    assert max(outputs) == 3.0


@pytest.mark.parametrize("side", [1, -1])
def test_integral_does_not_wind_up(side: int) -> None:
    """After a long time at a limit the output leaves it with the error's sign, as if just arrived."""
    short, long = (ForceController(1.0, 50.0, output_limits=(-3, 3)) for _ in range(2))
    for pid, ticks in ((short, 200), (long, 20000)):
        for _ in range(ticks):
            pid.update(side * 10.0, 0.0, 1.0)
        assert pid.output == side * 3.0
        assert abs(pid.integral_term) <= 3.0
    assert long.update(-side * 0.5, 0.0, 1.0) == short.update(-side * 0.5, 0.0, 1.0)
    assert abs(long.output) < 3.0


def test_derivative_acts_on_the_measurement() -> None:
    pid = ForceController(0.0, 0.0, 1.0, output_limits=(-1e6, 1e6), derivative_filter=0.0)
    assert pid.update(1.0, 2.0, 1.0) == 0.0  # no past
    assert pid.update(100.0, 2.0, 1.0) == 0.0  # a step of the set-point does not kick
    assert pid.update(100.0, 2.5, 2.0) == pytest.approx(-250.0)


def test_derivative_filter_is_a_first_order_lag() -> None:
    pid = ForceController(0.0, 0.0, 1.0, output_limits=(-1e6, 1e6), derivative_filter=9.0)
    outputs = [pid.update(0.0, 0.1 * i, 1.0) for i in range(100)]
    np.testing.assert_allclose(outputs, -100.0 * (1 - 0.9 ** np.arange(100)), rtol=1e-9, atol=1e-9)


def test_gains_change_without_a_jump() -> None:
    pid = ForceController(1.0, 20.0)
    for _ in range(300):
        pid.update(1.0, 0.9, 1.0)
    held = pid.integral_term
    assert held == pytest.approx(0.6)
    for kp, ki in ((5.0, 1.0), (0.5, 300.0), (1.0, 0.0)):
        pid.set_gains(kp, ki)
        assert pid.integral_term == held
        assert pid.update(0.9, 0.9, 1.0) == pytest.approx(held, rel=1e-12)


def test_reset_forgets() -> None:
    used = ForceController(1.0, 20.0, 0.1)
    for force in np.random.default_rng(3).uniform(0, 1, 50):
        used.update(1.0, force, 1.0)
    used.reset(0.25)
    assert used.integral_term == 0.25
    assert used.proportional_term == used.derivative_term == used.output == 0.0
    fresh = ForceController(1.0, 20.0, 0.1)
    fresh.reset(0.25)
    for force in (0.3, 0.7, 0.2):
        assert used.update(1.0, force, 1.0) == fresh.update(1.0, force, 1.0)
    used.reset()
    assert used.integral_term == 0.0
    used.reset(1e9)
    assert used.integral_term == 10.0  # within the limits


def test_it_holds_a_spring() -> None:
    """On a stiff wall (velocity in, force out) the force settles at the set-point."""
    pid, force = ForceController(2.0, 20.0), 0.0
    for _ in range(3000):
        force += 8.0 * pid.update(1.5, force, 1.0) * 1e-3  # 8 N/mm
    assert force == pytest.approx(1.5, abs=1e-3)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"kp": -1.0}, "kp must be zero or positive and finite, got -1"),
        ({"ki": np.nan}, "ki must be zero or positive and finite, got nan"),
        ({"kd": np.inf}, "kd must be zero or positive and finite, got inf"),
        ({"output_limits": (1, 1)}, "lower output limit must be below the upper one, got 1"),
        ({"output_limits": (0, np.nan)}, "lower output limit must be below the upper one, got 0"),
        ({"derivative_filter": -1.0}, "derivative_filter must be zero or positive and finite, got -1"),
    ],
)
def test_bad_settings(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        ForceController(**({"kp": 1.0} | settings))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((np.nan, 0.0, 1.0), "setpoint must be finite, got nan"),
        ((1.0, np.inf, 1.0), "force must be finite, got inf"),
        ((1.0, 0.0, 0.0), "dt must be positive and finite, got 0"),
        ((1.0, 0.0, -1.0), "dt must be positive and finite, got -1"),
    ],
)
def test_refused_updates_leave_no_trace(arguments: tuple[float, float, float], text: str) -> None:
    pid, twin = ForceController(1.0, 20.0, 0.1), ForceController(1.0, 20.0, 0.1)
    pid.update(1.0, 0.5, 1.0)
    twin.update(1.0, 0.5, 1.0)
    with pytest.raises(ValueError, match=text):
        pid.update(*arguments)
    assert pid.update(1.0, 0.6, 1.0) == twin.update(1.0, 0.6, 1.0)


def test_refused_gains_and_reset() -> None:
    pid = ForceController(1.0, 2.0, 3.0)
    with pytest.raises(ValueError, match="kd must be zero or positive and finite, got -1"):
        pid.set_gains(5.0, 6.0, -1.0)
    assert (pid.kp, pid.ki, pid.kd) == (1.0, 2.0, 3.0)
    with pytest.raises(ValueError, match="integral must be finite, got nan"):
        pid.reset(np.nan)
