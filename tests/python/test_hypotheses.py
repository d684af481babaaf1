"""Tests of the fit's premises: they hold their level under the model, and reject what is not the model."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from burrlab import materials
from burrlab._core import Burr, Material
from burrlab.fitting.fit import fit
from burrlab.measured.curve import VelocityCurve
from burrlab.measured.depth_trace import DepthTrace
from burrlab.measured.synthetic import synthetic_curve, synthetic_indentation, synthetic_trace

BURR, BONE = Burr(3.0), materials["bone"]
FORCES = np.geomspace(0.3, 2.6, 4)


def is_uniform(p: list[float], false_alarm: float) -> bool:
    """By Kolmogorov and Smirnov."""
    return bool(stats.kstest(p, "uniform").pvalue > false_alarm)


class TestLackOfFit:
    @pytest.mark.parametrize("pressed", [False, True])
    def test_holds_its_level(self, pressed):
        """80 sets of 12 velocities; false-alarm rate 1e-6 of either check."""
        found = []
        for seed in range(80):
            data = [synthetic_curve(BURR, BONE, FORCES, repeats=3, scatter=0.08, seed=seed)]
            if pressed:
                data.append(
                    synthetic_indentation(
                        BURR, BONE, np.linspace(0.05, 0.3, 6), scatter=0.01, seed=seed + 1000
                    )
                )
            found.append(fit(data).lack_of_fit.p_value)
        assert is_uniform(found, 1e-6)
        assert sum(p < 0.05 for p in found) <= stats.binom.isf(1e-6, 80, 0.05)

    def test_rejects_another_shape(self):
        quartic = Material("m", c_e=2.145, alpha=0.087, shape="quartic")
        curve = synthetic_curve(BURR, quartic, np.geomspace(0.3, 2.6, 8), repeats=3, scatter=0.03, seed=1)
        assert fit(curve).lack_of_fit.p_value < 1e-6
        assert "the model misses the means" in fit(curve).report()

    def test_of_given_sigma(self):
        curve = synthetic_curve(BURR, BONE, FORCES, repeats=3, scatter=0.08, seed=2)
        test = fit(replace(curve, sigma=0.01 * curve.velocity), residuals="sigma").lack_of_fit
        assert test.freedom == (10,)
        assert "contradicts the given sigma" in str(test)

    def test_without_repeats_there_is_none(self):
        assert fit(synthetic_curve(BURR, BONE, FORCES, repeats=1, seed=1)).lack_of_fit is None


class TestFall:
    CURVE = synthetic_curve(BURR, BONE, FORCES, repeats=3, scatter=0.02, seed=4)

    @staticmethod
    def constant(force: float, noise: float, seed: int) -> DepthTrace:
        time = np.arange(0, 2, 0.002)
        random = np.random.default_rng(seed)
        immersion = 0.45 + 0.6 * time / 2 + noise * random.standard_normal(len(time))
        return DepthTrace(time, immersion, force, 3.0, start_mm=0.5, end_mm=1.0)

    @pytest.mark.parametrize("runs", [1, 3])
    @pytest.mark.parametrize("noise", [0.0, 0.002])
    def test_a_constant_velocity_is_rejected(self, runs, noise):
        test = fit([self.CURVE, *(self.constant(1.0, noise, k) for k in range(runs))]).fall
        assert test.p_value < 1e-3
        found = re.search(
            r"contradicts the model \(first over last segment (\S+), [23]\.?\d* by the model\)", str(test)
        )
        assert float(found[1]) == pytest.approx(1, abs=0.05)

    def test_records_without_noise_agree(self):
        clean = [
            synthetic_trace(BURR, BONE, F, run_scatter=0, noise=0, step=0, seed=1) for F in (0.5, 1.0, 2.0)
        ]
        for traces in (clean[:1], clean, 4 * clean):
            assert fit([self.CURVE, *traces]).fall.p_value > 0.5

    @pytest.mark.parametrize("runs", [1, 3])
    def test_true_traces_are_rarely_rejected(self, runs):
        """40 sets at one force; as many p below 5 % as found have a probability below 1e-6.

        A level of 10 % is granted: standard errors of records are not exact.
        """
        found = []
        for seed in range(40):
            traces = [synthetic_trace(BURR, BONE, 0.8, seed=100 * seed + k) for k in range(runs)]
            found.append(fit([self.CURVE, *traces]).fall.p_value)
        assert sum(p < 0.05 for p in found) <= stats.binom.isf(1e-6, 40, 0.1)
        assert np.mean(found) > 0.25

    def test_without_traces_there_is_none(self):
        assert fit(self.CURVE).fall is None


class TestGivenValues:
    def test_agrees_with_the_region(self):
        result = fit(synthetic_curve(BURR, BONE, FORCES, repeats=3, scatter=0.08, seed=2))
        region = result.region("95")
        rows = np.linspace(3, len(region.c_e) - 4, 12).astype(int)
        for i in rows:
            middle = np.sqrt(region.lower[i] * region.upper[i])
            for edge in (region.lower[i], region.upper[i]):
                inward, outward = edge * (middle / edge) ** 0.02, edge * (edge / middle) ** 0.02
                assert result.test(region.c_e[i], inward).p_value > 0.05
                assert result.test(region.c_e[i], outward).p_value < 0.05

    def test_sentences(self):
        curve = synthetic_curve(BURR, BONE, FORCES, repeats=3, scatter=0.08, seed=2)
        result = fit(curve)
        inside, outside = result.test(2.145, 0.087), result.test(4.0, 0.087)
        assert "lies inside the joint 95 % region" in str(inside)
        assert "lies outside the joint 95 % region" in str(outside)
        assert inside.freedom == (2.0, 10.0)
        excluded = result.test(1.0, 0.087)
        assert excluded.p_value == 0
        assert "is excluded: at 2.6 N there would have been no window" in str(excluded)
        known = fit(replace(curve, sigma=0.1 * curve.velocity), residuals="sigma")
        assert known.test(2.145, 0.087).freedom == (2.0,)

    def test_an_overloaded_run_excludes(self):
        curve = synthetic_curve(BURR, BONE, [0.5, 0.8, 1.2, 3.9], repeats=2, scatter=0.08, seed=2)
        assert "the overloaded run would have had a window" in str(fit(curve).test(2.4, 0.087))


class TestOneMaterial:
    def test_holds_its_level(self):
        """80 pairs of 8 velocities; false-alarm rate 1e-6."""
        found = []
        for seed in range(80):
            a, b = (
                fit(synthetic_curve(BURR, BONE, FORCES, repeats=2, scatter=0.08, seed=2 * seed + k))
                for k in range(2)
            )
            found.append(a.differs_from(b).p_value)
        assert is_uniform(found, 1e-6)

    def test_bone_is_not_pvc(self):
        a, b = (
            fit(synthetic_curve(BURR, materials[m], f * FORCES, scatter=0.08, seed=1))
            for m, f in (("bone", 1.0), ("pvc", 0.2))
        )
        test = a.differs_from(b)
        assert test.p_value < 1e-6
        assert str(test).startswith("The two differ")
        assert b.differs_from(a).p_value == pytest.approx(test.p_value, rel=1e-3, abs=1e-12)

    def test_curves_without_scatter(self):
        a, b = (
            fit(synthetic_curve(BURR, BONE, f * FORCES, repeats=1, scatter=0, seed=1)) for f in (1.0, 0.93)
        )
        assert a.differs_from(b).p_value > 0.5

    def test_known_sigma_is_chi_square(self):
        curve = synthetic_curve(BURR, BONE, FORCES, scatter=0.05, seed=1)
        one = fit(replace(curve, sigma=0.05 * curve.velocity), residuals="sigma")
        assert one.differs_from(one).freedom == (2.0,)
        assert one.differs_from(one).p_value == pytest.approx(1.0, abs=1e-3)

    def test_windows_that_contradict(self):
        a = fit(synthetic_curve(BURR, BONE, [0.5, 0.8, 1.2, 3.9], scatter=0.08, seed=2))
        b = fit(VelocityCurve([1.0, 2.0, 5.0], [0.1, 0.5, 3.0], radius=3.0))
        test = a.differs_from(b)
        assert test.p_value == 0
        assert "contradict one another" in str(test)

    def test_errors(self):
        curve = synthetic_curve(BURR, BONE, FORCES, seed=1)
        with pytest.raises(
            ValueError, match="both fits must be mean-field ones with the same shape and kind"
        ):
            fit(curve).differs_from(fit(curve, shape="linear"))
