"""The independent check of a fit's minimum, and the predictions of a fit."""

from __future__ import annotations

import numpy as np
import pytest
from fit_scenes import BONE, BURR

from burrlab.fitting.fit import minimise
from burrlab.fitting.likelihood import MeanFieldModel
from burrlab.fitting.observations import Box, Observations
from burrlab.fitting.verdict import Start
from burrlab.measured.curve import VelocityCurve
from burrlab.theory.continuum import penetration_velocity

NAN = float("nan")
BOX = Box((0.1, 0.001), (10.0, 1.0))


def bowl(c_e: float, alpha: float) -> float:
    return float(np.log(c_e / 2.0) ** 2 + np.log(alpha / 0.1) ** 2)


def searched(objective, start=(1.0, 0.1)) -> tuple[Start, list[tuple[float, float, float]]]:
    """The search, and every value and point that it saw; none may be outside the box."""
    seen = []

    def noted(c_e, alpha):
        assert 0.1 * (1 - 1e-12) <= c_e <= 10.0 * (1 + 1e-12)
        assert 0.001 * (1 - 1e-12) <= alpha <= 1.0 * (1 + 1e-12)
        seen.append((objective(c_e, alpha), c_e, alpha))
        return seen[-1][0]

    return minimise(noted, BOX, start, origin="x"), seen


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_exception_passes_through(error):
    calls = []

    def objective(c_e, alpha):
        calls.append(c_e)
        if len(calls) == 4:
            raise error("in the objective")
        return bowl(c_e, alpha)

    with pytest.raises(error, match="in the objective"):
        searched(objective)
    assert len(calls) == 4


def test_the_best_point_is_kept_and_nan_never_is():
    for objective in (bowl, lambda c_e, alpha: NAN if c_e < 1 else bowl(c_e, alpha)):
        end, seen = searched(objective, (5.0, 0.01))
        assert (end.objective, *end.end) == pytest.approx(min(row for row in seen if row[0] == row[0]))
        assert end.end == pytest.approx((2.0, 0.1), rel=1e-3)
        assert end.evaluations == len(seen)
        assert end.result in ("SUCCESS", "XTOL_REACHED", "ROUNDOFF_LIMITED")
    end, _ = searched(lambda c_e, alpha: NAN)
    assert (end.objective, end.end) == (np.inf, (1.0, 0.1))
    end, _ = searched(lambda c_e, alpha: -float(np.log(c_e * alpha)), (9.0, 0.9))
    assert end.end == pytest.approx((10.0, 1.0), rel=1e-5)


def test_each_distinct_force_is_predicted_once_and_put_in_place():
    rows = [(2.0, NAN, NAN), (1.0, 0.4, 0.8), (2.0, NAN, NAN), (0.5, 0.4, 0.8)]
    force, start, end = zip(*rows, strict=True)
    curve = VelocityCurve(force, [1, 1, 1, 1], window_start=start, window_end=end)
    o = Observations.of([curve], BURR)
    windows = [() if np.isnan(start) else (start, end) for _, start, end in rows]
    expected = [penetration_velocity(BURR, BONE, F, *w) for F, w in zip(force, windows, strict=True)]
    found = MeanFieldModel(o, BONE.shape).predict(BONE.c_e, BONE.alpha)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    # a row with a window of its own has a bound of its own
    least = [F / (9 * (0.8 / 3 if w else 1 / 3) ** 1.5) for F, w in zip(force, windows, strict=True)]
    np.testing.assert_allclose(o.c_e_bounds(), least)
