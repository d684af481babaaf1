"""The independent check of a fit's minimum, and the predictions of a fit."""

from __future__ import annotations

import numpy as np
import pytest

from burrlab import materials
from burrlab._core import Burr
from burrlab.fitting.likelihood import MeanFieldModel
from burrlab.fitting.observations import Observations
from burrlab.fitting.search import Box, minimise
from burrlab.measured.curve import VelocityCurve
from burrlab.theory.continuum import penetration_velocity

NAN = float("nan")
BURR = Burr(3.0)


class TestSearch:
    BOX = Box((0.1, 0.001), (10.0, 1.0))

    @staticmethod
    def bowl(c_e, alpha):
        return np.log(c_e / 2.0) ** 2 + np.log(alpha / 0.1) ** 2

    @pytest.mark.parametrize("error", [RuntimeError, ValueError, KeyboardInterrupt, ZeroDivisionError])
    def test_an_exception_passes_through(self, error):
        calls = []

        def objective(c_e, alpha):
            calls.append(c_e)
            if len(calls) == 4:
                raise error("in the objective")
            return self.bowl(c_e, alpha)

        with pytest.raises(error, match="in the objective"):
            minimise(objective, self.BOX, (1.0, 0.1), origin="x")
        assert len(calls) == 4

    def test_nan_never_wins(self):
        end = minimise(
            lambda c_e, alpha: NAN if c_e < 1 else self.bowl(c_e, alpha), self.BOX, (5.0, 0.01), origin="x"
        )
        assert end.end == pytest.approx((2.0, 0.1), rel=1e-3)
        assert end.objective < 1e-6

    def test_nothing_but_nan(self):
        end = minimise(lambda c_e, alpha: NAN, self.BOX, (1.0, 0.1), origin="x")
        assert (end.objective, end.end) == (np.inf, (1.0, 0.1))

    def test_the_best_point_is_kept(self):
        seen = []

        def objective(c_e, alpha):
            seen.append((float(self.bowl(c_e, alpha)), c_e, alpha))
            return seen[-1][0]

        end = minimise(objective, self.BOX, (1.0, 0.1), origin="x")
        assert (end.objective, *end.end) == pytest.approx(min(seen))
        assert end.evaluations == len(seen)
        assert end.result in ("SUCCESS", "XTOL_REACHED", "ROUNDOFF_LIMITED")

    def test_points_stay_in_the_box(self):
        def objective(c_e, alpha):
            assert 0.1 * (1 - 1e-12) <= c_e <= 10.0 * (1 + 1e-12)
            assert 0.001 * (1 - 1e-12) <= alpha <= 1.0 * (1 + 1e-12)
            return -np.log(c_e) - np.log(alpha)

        assert minimise(objective, self.BOX, (9.0, 0.9), origin="x").end == pytest.approx(
            (10.0, 1.0), rel=1e-5
        )


class TestModel:
    def test_each_distinct_force_is_predicted_once_and_put_in_place(self):
        curve = VelocityCurve(
            [2.0, 1.0, 2.0, 0.5],
            [1, 1, 1, 1],
            window_start=[NAN, 0.4, NAN, 0.4],
            window_end=[NAN, 0.8, NAN, 0.8],
        )
        model = MeanFieldModel(Observations.of([curve], BURR), materials["bone"].shape)
        bone = materials["bone"]
        expected = [
            penetration_velocity(BURR, bone, 2.0),
            penetration_velocity(BURR, bone, 1.0, 0.4, 0.8),
            penetration_velocity(BURR, bone, 2.0),
            penetration_velocity(BURR, bone, 0.5, 0.4, 0.8),
        ]
        np.testing.assert_allclose(model.predict(bone.c_e, bone.alpha), expected, rtol=1e-9)

    def test_the_bound_of_a_row_with_its_own_window(self):
        curve = VelocityCurve([0.5, 1.0, 2.0], [1, 1, 1], window_start=[0.1] * 3, window_end=[0.75] * 3)
        expected = np.array([0.5, 1.0, 2.0]) / (9 * 0.25**1.5)
        np.testing.assert_allclose(Observations.of([curve], BURR).c_e_bounds(), expected)
