"""The force controller of a rig: terms, defaults, anti-windup, change of gains, errors."""

from collections.abc import Callable

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
        assert pid.update(setpoint, force, dt) == pytest.approx(
            np.clip(2.0 * (setpoint - force) + integral - 0.1 * slope, -50, 50), rel=1e-9, abs=1e-12
        )


def test_a_change_of_gains_keeps_the_integral() -> None:
    pid, fixed = ForceController(1.0, 20.0, 0.1), ForceController(1.0, 20.0, 0.1)
    for _ in range(100):
        pid.update(1.0, 0.9, 1.0)
        last = fixed.update(1.0, 0.9, 1.0)
    pid.set_gains(2.0, 3.0, 4.0)
    assert pid.update(0.9, 0.9, 1.0) == pytest.approx(last - 1.0 * 0.1)  # all but the proportional term


@pytest.mark.parametrize("side", [1, -1])
def test_integral_does_not_wind_up(side: int) -> None:
    """After any time at a limit the output leaves it as soon as the error changes sign."""
    short, long = (ForceController(1.0, 50.0, output_limits=(-3, 3)) for _ in range(2))
    for pid, ticks in ((short, 200), (long, 20000)):
        for _ in range(ticks):
            assert pid.update(side * 10.0, 0.0, 1.0) == side * 3.0
    output = long.update(-side * 0.5, 0.0, 1.0)
    assert output == short.update(-side * 0.5, 0.0, 1.0)
    assert abs(output) < 3.0


def test_reset_forgets() -> None:
    used, fresh = ForceController(1.0, 20.0, 0.1), ForceController(1.0, 20.0, 0.1)
    for force in np.random.default_rng(3).uniform(0, 1, 50):
        used.update(1.0, force, 1.0)
    for pid in (used, fresh):
        pid.reset(0.25)
    for force in (0.3, 0.7, 0.2):
        assert used.update(1.0, force, 1.0) == fresh.update(1.0, force, 1.0)
    for integral, output in ((0.25, 0.25), (0.0, 0.0), (1e3, 10.0)):  # within the limits
        used.reset(integral)
        assert used.update(0.0, 0.0, 1.0) == output


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda _: ForceController(-1.0), "kp must be zero or positive and finite, got -1"),
        (lambda _: ForceController(1.0, np.nan), "ki must be zero or positive and finite, got nan"),
        (lambda _: ForceController(1.0, kd=np.inf), "kd must be zero or positive and finite, got inf"),
        (lambda _: ForceController(1.0, output_limits=(1, 1)),
         "lower output limit must be below the upper one, got 1"),
        (lambda _: ForceController(1.0, output_limits=(0, np.nan)),
         "lower output limit must be below the upper one, got 0"),
        (lambda _: ForceController(1.0, derivative_filter=-1.0),
         "derivative_filter must be zero or positive and finite, got -1"),
        (lambda pid: pid.update(np.nan, 0.0, 1.0), "setpoint must be finite, got nan"),
        (lambda pid: pid.update(1.0, np.inf, 1.0), "force must be finite, got inf"),
        (lambda pid: pid.update(1.0, 0.0, 0.0), "dt must be positive and finite, got 0"),
        (lambda pid: pid.update(1.0, 0.0, -1.0), "dt must be positive and finite, got -1"),
        (lambda pid: pid.set_gains(5.0, 6.0, -1.0), "kd must be zero or positive and finite, got -1"),
        (lambda pid: pid.reset(np.nan), "integral must be finite, got nan"),
    ],
)  # fmt: skip
def test_refused_without_a_trace(call: Callable[[ForceController], object], text: str) -> None:
    pid, twin = ForceController(1.0, 20.0, 0.1), ForceController(1.0, 20.0, 0.1)
    assert pid.update(1.0, 0.5, 1.0) == twin.update(1.0, 0.5, 1.0)
    with pytest.raises(ValueError, match=text):
        call(pid)
    assert pid.update(1.0, 0.6, 1.0) == twin.update(1.0, 0.6, 1.0)
