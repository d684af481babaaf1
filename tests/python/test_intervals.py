"""Properties of intervals and regions, what bounds do to them, and results that come back from JSON."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from burrlab import materials
from burrlab._core import Burr
from burrlab.fitting.fit import Fit, fit
from burrlab.measured.curve import VelocityCurve
from burrlab.measured.synthetic import synthetic_curve, synthetic_indentation, synthetic_trace

BURR, BONE = Burr(3.0), materials["bone"]
WIDE = np.geomspace(0.3, 2.6, 6)
CURVE = synthetic_curve(BURR, BONE, WIDE, repeats=2, scatter=0.08, seed=3)
RIDGE = synthetic_curve(BURR, BONE, [0.3, 0.4, 0.5, 0.6], repeats=2, scatter=0.08, seed=3)
PRESSED = synthetic_indentation(BURR, BONE, [0.05, 0.1, 0.2, 0.3], scatter=0.06, seed=2)
TRACE = synthetic_trace(BURR, BONE, 1.0, seed=1)


def ends(result: Fit, name: str) -> list[float]:
    return [end for i in result.intervals[name].values() for end in (i.lower, i.upper)]


class TestProperties:
    @settings(max_examples=8, deadline=None)
    @given(
        k=st.floats(1e-3, 1e2), kind=st.sampled_from(["relative", "absolute", "sigma"]), pressed=st.booleans()
    )
    def test_faster_by_a_factor(self, k, kind, pressed):
        curve = replace(CURVE, sigma=0.08 * CURVE.velocity)
        faster = replace(curve, velocity=k * curve.velocity, sigma=k * curve.sigma)
        data = [PRESSED] if pressed else []
        options = {"residuals": kind}
        # alpha leaves the search's bounds of 1e-5 to 10 /ms nowhere
        one, other = fit([curve, *data], **options), fit([faster, *data], **options)
        assert (other.c_e, other.alpha / k) == pytest.approx((one.c_e, one.alpha), rel=1e-4)
        assert ends(other, "c_e") == pytest.approx(ends(one, "c_e"), rel=1e-4)
        assert np.divide(ends(other, "alpha"), k) == pytest.approx(ends(one, "alpha"), rel=1e-3)

    @settings(max_examples=8, deadline=None)
    @given(k=st.floats(0.1, 10))
    def test_stiffer_by_a_factor(self, k):
        one = fit([CURVE, PRESSED])
        pressed = replace(PRESSED, force=k * PRESSED.force)
        other = fit([replace(CURVE, force=k * CURVE.force), pressed])
        assert (other.c_e / k, other.alpha) == pytest.approx((one.c_e, one.alpha), rel=1e-4)
        assert np.divide(ends(other, "c_e"), k) == pytest.approx(ends(one, "c_e"), rel=1e-4)
        assert ends(other, "alpha") == pytest.approx(ends(one, "alpha"), rel=1e-3)

    @settings(max_examples=8, deadline=None)
    @given(order=st.permutations(range(12)), swap=st.booleans())
    def test_order_does_not_matter(self, order, swap):
        shuffled = replace(CURVE, force=CURVE.force[order], velocity=CURVE.velocity[order])
        data = [shuffled, PRESSED, TRACE]
        one, other = (fit(d) for d in ([CURVE, PRESSED, TRACE], data[::-1] if swap else data))
        assert (other.c_e, other.alpha) == pytest.approx((one.c_e, one.alpha), rel=1e-4)
        for name in ("c_e", "alpha"):
            assert ends(other, name) == pytest.approx(ends(one, name), rel=1e-3)

    def test_twice_the_data_narrow(self):
        one, two = fit(CURVE), fit([CURVE, CURVE])
        for name in ("c_e", "alpha"):
            for level, interval in two.intervals[name].items():
                assert interval.ratio() < one.intervals[name][level].ratio()

    @pytest.mark.parametrize("data", [[CURVE], [RIDGE], [CURVE, PRESSED], [CURVE, TRACE]])
    def test_levels_nest_and_hold_the_fit(self, data):
        result = fit(data)
        for name in ("c_e", "alpha"):
            before = None
            for interval in result.intervals[name].values():
                assert getattr(result, name) in interval
                if before is not None:
                    assert before.lower is not None
                    assert interval.lower <= before.lower
                    assert interval.upper is None or interval.upper >= before.upper
                before = interval
        for level in ("68", "95", "99.7"):
            assert (result.c_e, result.alpha) in result.region(level)
        assert result.test(result.c_e, result.alpha).p_value > 0.99


class TestBounds:
    def test_alpha_is_open_at_bounds_that_were_given(self):
        interval = fit(CURVE, bounds={"alpha": (0.08, 0.085)}).intervals["alpha"]["95"]
        assert (interval.lower, interval.upper) == (None, None)

    def test_wide_bounds_of_alpha_change_nothing(self):
        free, wide = fit(CURVE), fit(CURVE, bounds={"alpha": (1e-4, 5.0)})
        assert ends(wide, "alpha") == pytest.approx(ends(free, "alpha"), rel=1e-3)

    def test_the_force_that_bounds_c_e_is_named(self):
        window = {"window_start": [0.5, 0.5, 0.5, 0.2], "window_end": [1, 1, 1, 0.3]}
        curve = VelocityCurve([0.5, 1, 2, 0.6], [0.1, 0.4, 1.5, 0.1], **window, radius=3.0)
        assert "at 0.6 N there would have been no window" in str(fit(curve).test(1.0, 0.1))
        with pytest.raises(ValueError, match=r"the window at 0\.6 N needs"):
            fit(curve, bounds={"c_e": (0.5, 1.0)})


class TestResult:
    KINDS = (
        (CURVE, {}),
        ([RIDGE], {}),
        ([CURVE, PRESSED, TRACE], {}),
        ([replace(CURVE, sigma=0.1 * CURVE.velocity), PRESSED], {"residuals": "sigma"}),
        ([CURVE], {"residuals": "absolute", "shape": "quartic"}),
        ([CURVE], {"bounds": {"c_e": (1.7, 2.2), "alpha": (0.05, 0.2)}}),
    )

    @pytest.mark.parametrize(("data", "options"), KINDS)
    def test_comes_back_from_json(self, data, options):
        result = fit(data, **options)
        text = json.dumps(result.to_dict(), allow_nan=False)
        for again in (Fit.from_dict(json.loads(text)), pickle.loads(pickle.dumps(result))):
            assert json.dumps(again.to_dict(), allow_nan=False) == text
            assert again.report() == result.report()
            assert again.test(2.1, 0.09) == result.test(2.1, 0.09)
            assert again.intervals == result.intervals

    def test_unknown_sigma_of_an_indentation(self):
        # -2 log L of the forces is far below 0: no search may take the root of it
        data = [replace(CURVE, sigma=0.1 * CURVE.velocity), PRESSED]
        result = fit(data, residuals="sigma")
        assert result.status == "ok"
        assert all(start.objective >= 0 for start in result.starts)
        assert "nan" not in result.report()

    def test_verdicts(self):
        assert fit(CURVE).verdict.startswith(
            "c_e and alpha are separately identified: these 12 points (0.3 to 2.6 N)"
        )
        open_above = fit(RIDGE)
        assert "no upper end" in open_above.verdict
        assert not open_above.separately_identified
        wide = fit(RIDGE, bounds={"c_e": (0.5, 90.0)})
        assert "not separately identified" in wide.verdict

    def test_errors(self):
        result = fit(CURVE)
        with pytest.raises(ValueError, match=r"level must be one of 68, 95, 99\.7: got '90'"):
            result.region("90")
        for values in ((0.0, 0.1), (2.0, float("nan"))):
            with pytest.raises(ValueError, match="must be positive and finite: got"):
                result.test(*values)
        with pytest.raises(ValueError, match="name must be 'c_e' or 'alpha': got 'R'"):
            result.plot_profile("R")
        with pytest.raises(ValueError, match="hold no velocity curve"):
            fit([synthetic_trace(BURR, BONE, F, seed=1) for F in (0.5, 1, 2)]).curve  # noqa: B018
        with pytest.raises(TypeError, match="data must be a VelocityCurve, Indentation or DepthTrace"):
            fit([1.0])
        with pytest.raises(ValueError, match="data must hold at least one data set: got none"):
            fit([])
        with pytest.raises(ValueError, match="residuals must be 'relative' with depth traces"):
            fit([CURVE, TRACE], residuals="absolute")
