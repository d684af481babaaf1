"""Tests of the fit's assumptions: they hold their level under the model and reject other data."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from fit_scenes import BONE, BURR, DATA, FORCES, curve_of, fitted, with_sigma
from scipy import stats

from burrlab import (
    DepthTrace,
    Indentation,
    VelocityCurve,
    compare,
    fit,
    synthetic_indentation,
    synthetic_trace,
)
from burrlab.fitting.diagnostics import POOR, fall_with_depth, goodness, indentation_tests, lack_of_fit
from burrlab.fitting.likelihood import Likelihood, MeanFieldModel
from burrlab.fitting.mixed import against_indentation
from burrlab.fitting.observations import Observations, bounds_of
from burrlab.fitting.profile import Domain, lowest

FEW = FORCES[::2]


def weighed(data) -> tuple[Likelihood, tuple[float, float]]:
    """The likelihood of data and its best point, without the intervals of a fit."""
    o = Observations.of(data, None)
    likelihood = Likelihood(o, "relative", MeanFieldModel(o, BONE.shape))
    return likelihood, lowest(likelihood, Domain.of(likelihood, bounds_of(o, None), {})).point


def holds_its_level(p: list[float]) -> bool:
    """Uniform by Kolmogorov and Smirnov, and not too many below 5 %; false-alarm rate 1e-6 each."""
    few = sum(one < 0.05 for one in p) <= stats.binom.isf(1e-6, len(p), 0.05)
    return bool(few and stats.kstest(p, "uniform").pvalue > 1e-6)


class TestLackOfFit:
    @pytest.mark.parametrize("pressed", [False, True])
    def test_holds_its_level(self, pressed):
        depths, found = np.linspace(0.05, 0.3, 6), []
        for seed in range(80):
            data = [curve_of(FEW, repeats=3, seed=seed)]
            if pressed:
                data.append(synthetic_indentation(BURR, BONE, depths, scatter=0.01, seed=seed + 1000))
            found.append(lack_of_fit(*weighed(data)).p_value)
        assert holds_its_level(found)

    def test_of_given_sigma_and_without_repeats(self):
        test = fit(with_sigma(DATA["wide"], 0.01), residuals="sigma").lack_of_fit
        assert test.freedom == (10,)
        assert "contradicts the given sigma" in str(test)
        assert (fit(curve_of(repeats=1)).lack_of_fit, fitted("wide").fall) == (None, None)


class TestIndentation:
    DEPTHS = np.linspace(0.05, 0.6, 24)

    @staticmethod
    def scattered(residuals: str, depths, velocities: int) -> tuple[Likelihood, np.ndarray, np.ndarray]:
        """A likelihood of velocities and presses, and what is expected of them."""
        curve, unit = (
            curve_of(np.geomspace(0.4, 2.4, 8), repeats=velocities, scatter=0),
            np.sqrt(3) * depths**1.5,
        )
        o = Observations.of(
            [with_sigma(curve), with_sigma(Indentation(BONE.c_e * unit, depths, 3.0), 0.05)], None
        )
        return Likelihood(o, residuals, MeanFieldModel(o, BONE.shape)), o.velocity, o.pressed

    @pytest.mark.parametrize(
        ("residuals", "depths", "velocities"),
        [("relative", DEPTHS, 3), ("relative", np.repeat(DEPTHS[::3], 3), 1), ("sigma", DEPTHS, 3)],
    )
    @pytest.mark.parametrize("n", [300, pytest.param(4000, marks=pytest.mark.slow)])
    def test_half_a_percent_of_clean_sets_contradict_in_all(self, residuals, depths, velocities, n):
        likelihood, v, F = self.scattered(residuals, depths, velocities)
        point, random, poor, found = (BONE.c_e, BONE.alpha), np.random.default_rng(1), 0, []
        for _ in range(n):
            errors = 0.08 * random.standard_normal(len(v)), 0.05 * random.standard_normal(len(F))
            noise = [1 + e if residuals == "sigma" else np.exp(e) for e in errors]
            outcomes = {"velocity": v * noise[0], "pressed": F * noise[1]}
            drawn = likelihood.of_rows(replace(likelihood.observations, **outcomes), likelihood.model)
            poor += goodness(drawn, point, lack_of_fit(drawn, point), []).poor
            found.append([test.p_value for test in indentation_tests(drawn)])
        print(f"{residuals}, {len(set(depths))} depths: {poor} of {n} clean sets contradict")
        assert poor <= stats.binom.isf(1e-6, n, POOR)
        assert all(holds_its_level(p) for p in np.transpose(found))

    @pytest.mark.parametrize("residuals", ["relative", "sigma"])
    @pytest.mark.parametrize("power", [1, 1.5, 2])
    def test_another_power_of_the_depth_is_a_poor_fit(self, residuals, power):
        curve = with_sigma(curve_of(np.geomspace(0.4, 2.4, 8), repeats=3))
        noise = np.exp(0.05 * np.random.default_rng(1).standard_normal(24))
        force = 2.145 * 9 * 0.1**1.5 * (self.DEPTHS / 0.3) ** power * noise
        found = fit([curve, with_sigma(Indentation(force, self.DEPTHS, 3.0), 0.05)], residuals=residuals)
        assert found.status == ("ok" if power == 1.5 else "poor-fit")
        assert float(re.search(r"depth\^([\d.]+), by Eq", found.report())[1]) == pytest.approx(power, abs=0.1)
        assert ("Eq. 3" in found.verdict) == (power != 1.5)

    def test_means_beside_their_repeats(self):
        wave = np.where(np.arange(24) // 3 % 2, 1.15, 1 / 1.15)  # no slope
        pressed = synthetic_indentation(BURR, BONE, np.repeat(self.DEPTHS[::3], 3), scatter=0.03, seed=1)
        found = fit([curve_of(repeats=1), replace(pressed, force=pressed.force * wave)])
        assert "Eq. 3 misses its means" in found.verdict
        assert found.status == "poor-fit"

    @pytest.mark.parametrize("residuals", ["relative", "sigma"])
    @pytest.mark.parametrize("n", [12, pytest.param(400, marks=pytest.mark.slow)])
    def test_velocities_and_indentation_against_each_other(self, residuals, n):
        p = {1.0: [], 1.4: []}
        for seed, stiffer in itertools.product(range(n), p):
            curve = with_sigma(curve_of(np.geomspace(0.4, 3.2, 12), repeats=2, scatter=0.05, seed=seed), 0.05)
            pressed = synthetic_indentation(BURR, BONE, self.DEPTHS[::2], scatter=0.05, seed=seed + n)
            pressed = with_sigma(replace(pressed, force=stiffer * pressed.force), 0.05)
            found = fit([curve, pressed], residuals=residuals)
            p[stiffer].append(against_indentation(found.likelihood, (found.c_e, found.alpha))[0].p_value)
            if stiffer > 1:
                assert found.status == "poor-fit", found.verdict
                assert "the indentation" in found.verdict
        rates = [f"{100 * np.mean(np.less(p[1.0], level)):.2g} %" for level in (0.05, 0.005)]
        print(f"{residuals}: clean sets below 5 % and 0.5 %: {', '.join(rates)} of {n}")
        assert holds_its_level(p[1.0])


class TestFall:
    CURVE = curve_of(FEW, repeats=3, scatter=0.02, seed=4)

    @classmethod
    def of(cls, traces):
        likelihood, (c_e, _) = weighed([cls.CURVE, *traces])
        return fall_with_depth(likelihood, likelihood.model.unit(c_e))

    @staticmethod
    def constant(noise: float, seed: int) -> DepthTrace:
        time = np.arange(0, 2, 0.002)
        immersion = 0.45 + 0.6 * time / 2 + noise * np.random.default_rng(seed).standard_normal(len(time))
        return DepthTrace(time, immersion, 1.0, 3.0, start_mm=0.5, end_mm=1.0)

    @pytest.mark.parametrize(("runs", "noise"), [(1, 0.0), (1, 0.002), (3, 0.0), (3, 0.002)])
    def test_a_constant_velocity_is_rejected(self, runs, noise):
        test = self.of([self.constant(noise, k) for k in range(runs)])
        assert test.p_value < 1e-3
        told = r"contradicts the model \(first over last segment (\S+), [23]\.?\d* by the model\)"
        assert float(re.search(told, str(test))[1]) == pytest.approx(1, abs=0.05)

    def test_records_without_noise_agree(self):
        clean = [
            synthetic_trace(BURR, BONE, F, run_scatter=0, noise=0, step=0, seed=1) for F in (0.5, 1.0, 2.0)
        ]
        assert fit([self.CURVE, *clean]).fall.p_value > 0.5
        for traces in (clean[:1], 4 * clean):
            assert self.of(traces).p_value > 0.5

    @pytest.mark.parametrize("runs", [1, 3])
    def test_true_traces_are_rarely_rejected(self, runs):
        """40 sets at one force; more p below 5 % than allowed have a probability of 1e-6.

        The allowed level is 10 %, because standard errors of records are not exact.
        """
        found = [
            self.of([synthetic_trace(BURR, BONE, 0.8, seed=100 * seed + k) for k in range(runs)]).p_value
            for seed in range(40)
        ]
        assert sum(p < 0.05 for p in found) <= stats.binom.isf(1e-6, 40, 0.1)
        assert np.mean(found) > 0.25


def test_sentences_of_given_values():
    inside, outside, excluded = (fitted("wide").test(c_e, 0.087) for c_e in (2.145, 4.0, 1.0))
    assert "lies inside the joint 95 % region" in str(inside)
    assert "lies outside the joint 95 % region" in str(outside)
    assert (inside.freedom, excluded.p_value) == ((2.0, 10.0), 0)
    assert "is excluded: at 2.6 N there would have been no window" in str(excluded)
    assert fitted("wide, sigma", residuals="sigma").test(2.145, 0.087).freedom == (2.0,)
    assert "the overloaded run would have had a window" in str(fitted("overloaded").test(2.4, 0.087))


def test_windows_that_contradict_one_material():
    other = fit(VelocityCurve([1.0, 2.0, 5.0], [0.1, 0.5, 3.0], radius=3.0))
    test = compare(fitted("overloaded"), other).pairs[0].joint
    assert test.p_value == 0
    assert "contradict one another" in str(test)
