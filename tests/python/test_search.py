"""The searches of a fit, and the predictions that they are led by."""

from __future__ import annotations

import nlopt
import numpy as np
import pytest

from burrlab import materials
from burrlab._core import Burr
from burrlab.fitting.likelihood import MeanFieldModel
from burrlab.fitting.observations import Observations
from burrlab.fitting.search import Box, is_minimum, minimise, search
from burrlab.measured.curve import VelocityCurve
from burrlab.theory.continuum import penetration_velocity

NAN = float("nan")
BURR = Burr(3.0)


class TestSearch:
    BOX = Box((0.1, 0.001), (10.0, 1.0))

    @staticmethod
    def bowl(logarithms):
        return float(np.sum((logarithms - np.log([2.0, 0.1])) ** 2))

    @pytest.mark.parametrize(
        "algorithm", [nlopt.LN_BOBYQA, nlopt.GN_CRS2_LM, nlopt.LN_SBPLX, nlopt.LN_COBYLA]
    )
    @pytest.mark.parametrize("error", [RuntimeError, ValueError, KeyboardInterrupt, ZeroDivisionError])
    def test_an_exception_passes_through(self, algorithm, error):
        calls = []

        def objective(logarithms):
            calls.append(logarithms)
            if len(calls) == 4:
                raise error("in the objective")
            return self.bowl(logarithms)

        with pytest.raises(error, match="in the objective"):
            minimise(objective, self.BOX, np.zeros(2), origin="x", algorithm=algorithm)
        assert len(calls) == 4

    @pytest.mark.parametrize("algorithm", [nlopt.LN_BOBYQA, nlopt.GN_CRS2_LM])
    def test_nan_never_wins(self, algorithm):
        nlopt.srand(1)
        end = minimise(
            lambda x: NAN if x[0] < 0 else self.bowl(x),
            self.BOX,
            np.log([5.0, 0.01]),
            origin="x",
            algorithm=algorithm,
        )
        assert end.end == pytest.approx((2.0, 0.1), rel=1e-3)
        assert end.objective < 1e-6

    def test_nothing_but_nan(self):
        end = minimise(lambda x: NAN, self.BOX, np.zeros(2), origin="x", maxeval=20)
        assert end.objective == np.inf

    def test_the_best_point_is_kept(self):
        seen = []

        def objective(logarithms):
            seen.append((self.bowl(logarithms), *np.exp(logarithms)))
            return seen[-1][0]

        end = minimise(objective, self.BOX, np.zeros(2), origin="x", algorithm=nlopt.GN_CRS2_LM, maxeval=60)
        assert end.result == "MAXEVAL_REACHED"
        assert not end.converged
        assert (end.objective, *end.end) == pytest.approx(min(seen))

    def test_points_stay_in_the_box(self):
        def objective(logarithms):
            assert np.all(logarithms >= np.log(self.BOX.lower))
            assert np.all(logarithms <= np.log(self.BOX.upper))
            return -float(logarithms.sum())

        ends = search(objective, self.BOX, lambda c_e: 0.1 * c_e, starts=3, seed=1)
        assert min(ends, key=lambda end: end.objective).end == pytest.approx((10.0, 1.0), rel=1e-5)

    def test_a_return_code_is_not_a_minimum(self):
        directions = np.eye(2)
        short = minimise(self.bowl, self.BOX, np.zeros(2), origin="x", maxeval=3)
        full = minimise(self.bowl, self.BOX, np.zeros(2), origin="x")
        assert not is_minimum(self.bowl, self.BOX, short, directions)
        assert is_minimum(self.bowl, self.BOX, full, directions)


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
