"""Properties of intervals and regions, what bounds do to them, and results that come back from JSON."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fit_scenes import DATA, fitted
from hypothesis import given, settings
from hypothesis import strategies as st

from burrlab.fitting.fit import Fit, fit
from burrlab.measured.curve import VelocityCurve

CURVE, PRESSED, TRACE = (DATA[name] for name in ("wide", "pressed", "trace"))
few = settings(max_examples=5, deadline=None)


def ends(result: Fit, name: str) -> list[float]:
    return [end for i in result.intervals[name].values() for end in (i.lower, i.upper)]


def assert_alike(other: Fit, one: Fit, c_e: float = 1.0, alpha: float = 1.0) -> None:
    """Parameters and intervals, but for the factors."""
    assert (other.c_e / c_e, other.alpha / alpha) == pytest.approx((one.c_e, one.alpha), rel=1e-4)
    assert np.divide(ends(other, "c_e"), c_e) == pytest.approx(ends(one, "c_e"), rel=1e-3)
    assert np.divide(ends(other, "alpha"), alpha) == pytest.approx(ends(one, "alpha"), rel=1e-3)


class TestProperties:
    # alpha leaves the search's bounds of 1e-5 to 10 /ms nowhere
    @few
    @given(k=st.floats(1e-3, 1e2), kind=st.sampled_from(["relative", "absolute", "sigma"]), names=st.sampled_from([(), ("pressed",)]))  # fmt: skip
    def test_faster_by_a_factor(self, k, kind, names):
        curve = DATA["wide, sigma"]
        faster = replace(curve, velocity=k * curve.velocity, sigma=k * curve.sigma)
        other = fit([faster, *(DATA[name] for name in names)], residuals=kind)
        assert_alike(other, fitted("wide, sigma", *names, residuals=kind), alpha=k)

    @few
    @given(k=st.floats(0.1, 10))
    def test_stiffer_by_a_factor(self, k):
        stiffer = [replace(one, force=k * one.force) for one in (CURVE, PRESSED)]
        assert_alike(fit(stiffer), fitted("wide", "pressed"), c_e=k)

    @few
    @given(order=st.permutations(range(12)), swap=st.booleans())
    def test_order_does_not_matter(self, order, swap):
        shuffled = replace(CURVE, force=CURVE.force[order], velocity=CURVE.velocity[order])
        data = [shuffled, PRESSED, TRACE]
        assert_alike(fit(data[::-1] if swap else data), fitted("wide", "pressed", "trace"))

    def test_twice_the_data_narrow(self):
        one, two = fitted("wide"), fitted("wide", "wide")
        for name in ("c_e", "alpha"):
            for level, interval in two.intervals[name].items():
                assert interval.ratio() < one.intervals[name][level].ratio()

    @pytest.mark.parametrize("names", [("wide",), ("ridge",), ("wide", "pressed"), ("wide", "trace")])
    def test_levels_nest_and_hold_the_fit(self, names):
        result = fitted(*names)
        for name in ("c_e", "alpha"):
            levels = list(result.intervals[name].values())
            assert all(getattr(result, name) in interval for interval in levels)
            for inner, outer in pairwise(levels):
                assert outer.lower <= inner.lower
                assert outer.upper is None or outer.upper >= inner.upper
        assert all((result.c_e, result.alpha) in result.region(level) for level in ("68", "95", "99.7"))
        assert result.test(result.c_e, result.alpha).p_value > 0.99


class TestBounds:
    def test_of_alpha(self):
        interval = fit(CURVE, bounds={"alpha": (0.08, 0.085)}).intervals["alpha"]["95"]
        assert (interval.lower, interval.upper) == (None, None), "open at bounds that were given"
        wide = fit(CURVE, bounds={"alpha": (1e-4, 5.0)})
        assert ends(wide, "alpha") == pytest.approx(ends(fitted("wide"), "alpha"), rel=1e-3)

    def test_the_force_that_bounds_c_e_is_named(self):
        window = {"window_start": [0.5, 0.5, 0.5, 0.2], "window_end": [1, 1, 1, 0.3]}
        curve = VelocityCurve([0.5, 1, 2, 0.6], [0.1, 0.4, 1.5, 0.1], **window, radius=3.0)
        assert "at 0.6 N there would have been no window" in str(fit(curve).test(1.0, 0.1))
        with pytest.raises(ValueError, match=r"the window at 0\.6 N needs"):
            fit(curve, bounds={"c_e": (0.5, 1.0)})


class TestResult:
    @pytest.mark.parametrize(
        ("names", "options"),
        [
            (["ridge"], {}), (["wide", "pressed", "trace"], {}), (["wide, sigma", "pressed"], {"residuals": "sigma"}),
            (["wide"], {"residuals": "absolute", "shape": "quartic"}), (["wide"], {"bounds": {"c_e": (1.7, 2.2), "alpha": (0.05, 0.2)}}),
        ],
    )  # fmt: skip
    def test_comes_back_from_json(self, names, options):
        result = fit([DATA[name] for name in names], **options)
        text = json.dumps(result.to_dict(), allow_nan=False)
        for again in (Fit.from_dict(json.loads(text)), pickle.loads(pickle.dumps(result))):
            assert json.dumps(again.to_dict(), allow_nan=False) == text
            assert again.report() == result.report()
            assert again.test(2.1, 0.09) == result.test(2.1, 0.09)
            assert again.intervals == result.intervals

    def test_unknown_sigma_of_an_indentation(self):
        # -2 log L of the forces is far below 0: no search may take the root of it
        result = fitted("wide, sigma", "pressed", residuals="sigma")
        assert result.status == "ok"
        assert all(start.objective >= 0 for start in result.starts)
        assert "nan" not in result.report()

    def test_verdicts(self):
        told = "c_e and alpha are separately identified: these 12 points (0.3 to 2.6 N)"
        assert fitted("wide").verdict.startswith(told)
        assert "no upper end" in fitted("ridge").verdict
        assert not fitted("ridge").separately_identified
        assert "not separately identified" in fit(DATA["ridge"], bounds={"c_e": (0.5, 90.0)}).verdict
