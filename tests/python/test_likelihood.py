"""The likelihood, its information and its limits, against scipy's densities row by row."""

import tracemalloc
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fit_scenes import BONE, BURR, DATA, FORCES, curve_of, with_sigma
from scipy import optimize, stats
from scipy.optimize import brentq
from session_scenes import refused

from burrlab import (
    Burr,
    Fit,
    MasterCurve,
    Material,
    Shape,
    VelocityCurve,
    fit,
    penetration_velocity,
    synthetic_trace,
)
from burrlab.fitting.calibration import Calibration, RowScatter
from burrlab.fitting.likelihood import Likelihood, MeanFieldModel
from burrlab.fitting.observations import Observations, bounds_of
from burrlab.fitting.profile import ALPHA, C_E, Domain
from reference.likelihood import Oracle

CURVE, PRESSED = DATA["wide"], DATA["pressed"]
SIGMA, PRESSED_SIGMA = DATA["wide, sigma"], with_sigma(PRESSED, 0.06)
TRACES = [synthetic_trace(BURR, BONE, F, run_scatter=0.08, seed=i) for i, F in enumerate((0.5, 1.0, 2.0))]
QUARTIC = Material("m", c_e=2.145, alpha=0.087, shape="quartic")


def windows_of_their_own():
    force = np.tile([0.4, 0.8, 1.4, 2.0], 2)
    window = np.repeat([0.3, 0.5], 4), np.repeat([0.9, 1.2], 4)
    mean = [penetration_velocity(BURR, BONE, *row) for row in zip(force, *window, strict=True)]
    velocity = mean * np.exp(0.05 * np.random.default_rng(5).standard_normal(8))
    return VelocityCurve(force, velocity, None, *window, radius=3.0)


CASES = {
    "relative": ([CURVE], {}),
    "absolute": ([CURVE], {"kind": "absolute"}),
    "sigma": ([SIGMA], {"kind": "sigma"}),
    "open": ([DATA["ridge"]], {}),
    "no scatter but the model's": ([curve_of(scatter=1e-3)], {}),
    "windows": ([windows_of_their_own()], {}),
    "two radii": ([CURVE, curve_of(FORCES / 4, burr=Burr(1.5))], {}),
    "indentation": ([curve_of([0.3, 0.4, 0.6]), PRESSED], {}),
    "indentation and absolute": ([curve_of([0.3, 0.4, 1.2]), PRESSED], {"kind": "absolute"}),
    "indentation of unknown sigma": ([SIGMA, PRESSED], {"kind": "sigma"}),
    "all sigma": ([SIGMA, PRESSED_SIGMA], {"kind": "sigma"}),
    "traces": ([CURVE, *TRACES], {}),
    "traces alone": (TRACES, {}),
    "overloaded": ([DATA["overloaded"]], {}),
    "bounds": ([DATA["ridge"]], {"bounds": (1.0, 9.0)}),
    "quartic": ([curve_of(material=QUARTIC)], {"shape": "quartic"}),
}


@cache
def pair(name: str) -> tuple[Fit, Oracle, tuple[float, float, float]]:
    data, options = CASES[name]
    bounds = options.get("bounds")
    found = fit(
        data,
        law=options.get("shape", "parabolic"),
        residuals=options.get("kind", "relative"),
        bounds=None if bounds is None else {"c_e": bounds},
    )
    oracle = Oracle(data, **options)
    return found, oracle, oracle.minimum()


@pytest.mark.parametrize("name", CASES)
class TestAgainstTheOracle:
    def test_height(self, name):
        found, oracle, _ = pair(name)
        points = [(found.c_e, found.alpha), (1.02 * found.c_e, 0.9 * found.alpha)]
        heights = [float(found.likelihood.at(c_e).minus2(alpha)[0]) for c_e, alpha in points]
        assert heights == pytest.approx([oracle.minus2(*point) for point in points], abs=1e-8)

    def test_constants(self, name):
        found, oracle, _ = pair(name)
        expected = oracle.log_likelihood(found.c_e, found.alpha)
        unknown = sum(not known for _, _, known, _ in oracle.residuals(found.c_e, found.alpha))
        n = len(oracle.velocities) + len(oracle.presses)
        assert found.log_likelihood == pytest.approx(expected, abs=1e-8)
        assert found.aic == pytest.approx(2 * (2 + unknown) - 2 * expected, abs=1e-7)
        assert found.bic == pytest.approx(np.log(n) * (2 + unknown) - 2 * expected, abs=1e-7)

    def test_information_and_limits(self, name):
        found, oracle, _ = pair(name)
        point = found.c_e, found.alpha
        shares = oracle.information(*point)
        expected = shares.sum(axis=0)
        scale = np.sqrt(np.outer(*2 * [np.diag(expected)]))
        np.testing.assert_allclose(found.evidence.shares / scale, shares / scale, atol=5e-3)
        correlation = -expected[0, 1] / np.sqrt(expected[0, 0] * expected[1, 1])
        assert found.correlation == pytest.approx(correlation, abs=1e-4)
        for level, direction in ((0.68, None), (0.95, C_E), (0.997, ALPHA)):
            limit = found.evidence.calibration.limit(level, direction)
            assert limit == pytest.approx(oracle.limit(level, point, direction), rel=5e-3)

    def test_fit(self, name):
        found, _, (c_e, alpha, base) = pair(name)
        assert found.evidence.profile.base == pytest.approx(base, abs=2e-5)
        if found.status != "ridge":  # along a ridge any point is as good
            assert (found.c_e, found.alpha) == pytest.approx((c_e, alpha), rel=1e-3)

    def test_interval_of_c_e(self, name):
        found, oracle, (c_e, _, base) = pair(name)
        for level, interval in found.intervals["c_e"].items():
            lower, upper = oracle.interval_of_c_e(found.evidence.profile.limits[level], c_e, base)
            assert interval.lower == (None if lower is None else pytest.approx(lower, rel=3e-4))
            assert interval.upper == (None if upper is None else pytest.approx(upper, rel=3e-4))

    def test_interval_of_alpha(self, name):
        found, oracle, (c_e, alpha, base) = pair(name)
        interval, c_e_interval = found.intervals["alpha"]["95"], found.intervals["c_e"]["95"]
        assert (interval.lower is None) == (c_e_interval.lower is None)
        assert (interval.upper is None) == (c_e_interval.upper is None)
        if interval.closed:
            limit = found.evidence.calibration.limit(0.95, ALPHA)
            expected = oracle.interval_of_alpha(limit, (c_e, alpha), base)
            assert (interval.lower, interval.upper) == pytest.approx(expected, rel=1e-3)

    def test_region(self, name):
        found, oracle, (best, _, base) = pair(name)
        limit = found.evidence.calibration.limit(0.95)
        region = found.region("95")
        inside = 0
        wide = np.log(region.upper / region.lower).max()
        ends = (0.97 * region.c_e[0], min(1.03 * region.c_e[-1], 4 * best))
        for c_e in np.geomspace(*ends, 13):
            unit = oracle.unit(c_e)
            if not oracle.low < c_e < oracle.high or np.isnan(unit).any():
                assert (c_e, found.alpha) not in region
                continue
            middle, _ = oracle.best_alpha(c_e)
            for alpha in middle * np.exp(np.linspace(-wide, wide, 15)):
                rise = oracle.minus2(c_e, alpha, unit) - base
                if abs(rise - limit) > 0.02 * limit:
                    assert ((c_e, alpha) in region) == (rise < limit), (c_e, alpha, rise, limit)
                    inside += rise < limit
        assert inside > 6


def one(n: int, known: bool = False) -> Calibration:
    return Calibration((RowScatter("velocity", n, known, 2.0, 1.0),), np.eye(2), np.eye(2)[None])


def two(*scatters: tuple[str, int, bool, float], shares: list[np.ndarray]) -> Calibration:
    made = tuple(RowScatter(*scatter, 1.0) for scatter in scatters)
    return Calibration(made, np.sum(shares, axis=0), np.array(shares))


class TestCalibration:
    @pytest.mark.parametrize("n", [3, 20])
    @pytest.mark.parametrize("level", [0.5, 0.95])
    def test_one_scatter(self, n, level):
        for q, direction in ((2, None), (1, C_E)):
            expected = n * np.log(1 + q * stats.f.ppf(level, q, n - 2) / (n - 2))
            assert one(n).limit(level, direction) == pytest.approx(expected, rel=1e-12)

    def test_known_sigma_and_many_rows_are_chi_square(self):
        known = two(
            ("velocity", 8, True, 1.5),
            ("force", 5, True, 0.5),
            shares=[np.diag([1.0, 4.0]), np.diag([9.0, 0.0])],
        )
        for made in (one(7, known=True), one(10**6), known):
            assert made.limit(0.95) == pytest.approx(stats.chi2.ppf(0.95, 2), rel=1e-4)
            assert made.limit(0.95, C_E) == pytest.approx(stats.chi2.ppf(0.95, 1), rel=1e-4)
            assert made.probability(5.99) == pytest.approx(stats.chi2.sf(5.99, 2), rel=1e-4)

    def test_two_scatters(self):
        both = two(
            ("velocity", 9, False, 2.0), ("force", 4, False, 0.0), shares=[np.eye(2), np.zeros((2, 2))]
        )
        for direction in (None, C_E, ALPHA):  # the second has no share
            assert both.limit(0.95, direction) == pytest.approx(one(9).limit(0.95, direction), rel=1e-6)
        # c_e from 5 forces alone, alpha from 8 velocities alone: each has its own t
        both = two(
            ("velocity", 8, False, 1.0),
            ("force", 5, False, 1.0),
            shares=[np.diag([0.0, 4.0]), np.diag([9.0, 0.0])],
        )
        for n, direction in ((5, C_E), (8, ALPHA)):
            expected = n * np.log(1 + stats.f.ppf(0.95, 1, n - 1) / (n - 1))
            assert both.limit(0.95, direction) == pytest.approx(expected, rel=1e-6)

    @pytest.mark.parametrize("direction", [None, C_E])
    @pytest.mark.parametrize("name", ["relative", "all sigma", "traces"])
    def test_probability_inverts_the_limit(self, name, direction):
        for monte_carlo, wider in ((0.0, 1.0), (0.25, 1.25)):
            calibration = replace(pair(name)[0].evidence.calibration, monte_carlo=monte_carlo)
            for level in (0.1, 0.95, 0.997):
                rise = calibration.limit(level, direction)
                assert rise == pytest.approx(
                    wider * replace(calibration, monte_carlo=0.0).limit(level, direction)
                )
                assert calibration.probability(rise, direction) == pytest.approx(
                    1 - level, rel=1e-6, abs=1e-12
                )
            assert calibration.probability(0.0, direction) == pytest.approx(1.0)


class TestManyRows:
    @pytest.mark.parametrize("kind", ["relative", "absolute", "sigma"])
    def test_rows_that_share_a_prediction_are_summed_once(self, kind, monkeypatch):
        data = [with_sigma(curve_of(np.repeat(FORCES, 5)), 0.05), windows_of_their_own()]
        data = data[:1] if kind == "sigma" else data
        each, shared = (Observations.of(data, BURR) for _ in range(2))
        each = Likelihood(each, kind, MeanFieldModel(each, Shape("parabolic")))
        monkeypatch.setattr("burrlab.fitting.likelihood._MANY", 10)
        monkeypatch.setattr("burrlab.fitting.likelihood._TABLE", 100)
        shared = Likelihood(shared, kind, MeanFieldModel(shared, Shape("parabolic")))
        c_e = np.geomspace(2.0, 20.0, 31)
        for name in ("A", "B", "m"):
            assert getattr(shared.at(c_e), name) == pytest.approx(getattr(each.at(c_e), name), rel=1e-11)

    def test_different_forces_take_little_memory(self):
        forces = np.geomspace(0.3, 2.4, 20_000)
        o = Observations.of([VelocityCurve(forces, penetration_velocity(BURR, BONE, forces))], BURR)
        many = Likelihood(o, "relative", MeanFieldModel(o, Shape("parabolic")))
        domain = Domain.of(many, bounds_of(o, None), {})
        tracemalloc.start()
        many.at(domain.grid)
        assert tracemalloc.get_traced_memory()[1] < 20e6  # bytes; one table of all points has 39 MB
        tracemalloc.stop()

    @pytest.mark.parametrize("seed", [5, 7])
    def test_c_e_is_where_the_slope_of_the_profile_is_zero(self, seed):
        """Each row has its kink; the slope is that of the sum of squares, row by row."""
        forces = np.exp(np.random.default_rng(seed).uniform(np.log(0.3), np.log(2.6), 5000))
        curve, master = curve_of(forces, seed=seed, repeats=1), MasterCurve("parabolic")

        def slope(log_c_e: float) -> float:
            phi = forces / BURR.radius**2 / np.exp(log_c_e)
            r = np.log(curve.velocity / master.velocity_ratio(phi))
            return float((r - r.mean()) @ master.local_slope(phi))

        log_c_e = np.log(fit(curve, BURR).c_e)
        assert log_c_e == pytest.approx(brentq(slope, log_c_e - 1e-6, log_c_e + 1e-6, xtol=1e-14), abs=1e-9)


class TestRunsThatWereTooSlow:
    """Below what could be measured: their probability counts, as in a Tobit model."""

    LIMIT, FORCE = 0.02, np.repeat(np.geomspace(0.2, 2.2, 10), 3)

    def curve(self, seed=1):
        v = penetration_velocity(BURR, BONE, self.FORCE)
        v = v * np.exp(0.15 * np.random.default_rng(seed).normal(size=len(v)))
        slow = v < self.LIMIT
        status, limit = np.where(slow, "Too slow", "ok").tolist(), np.where(slow, self.LIMIT, np.nan)
        return VelocityCurve(self.FORCE, np.where(slow, np.nan, v), radius=3.0, status=status, limit=limit)

    def test_of_scipy(self):
        """The fit is the maximum of the densities and probabilities, and the profile that of each c_e."""
        curve = self.curve()
        result, ok = fit(curve), curve.ok

        def minus2(logs):
            c_e, alpha, scatter = np.exp(logs)
            u = np.log(penetration_velocity(BURR, Material("m", c_e=c_e, alpha=alpha), self.FORCE))
            density = stats.norm.logpdf(np.log(curve.velocity[ok]), u[ok], scatter).sum()
            return -2 * (density + stats.norm.logcdf(np.log(self.LIMIT), u[~ok], scatter).sum())

        begin = np.log([result.c_e, result.alpha, 0.15])
        best = optimize.minimize(minus2, begin, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9})
        assert (result.c_e, result.alpha) == pytest.approx(np.exp(best.x[:2]), rel=1e-5)
        assert -2 * (result.log_likelihood - result.likelihood.log_jacobian()) == pytest.approx(
            best.fun, abs=0.02
        )
        end = result.intervals["c_e"]["95"].upper
        there = optimize.minimize(lambda x: minus2([np.log(end), *x]), begin[1:], method="Nelder-Mead")
        assert there.fun - best.fun == pytest.approx(result.evidence.profile.limits["95"], rel=0.02)
        slices = result.likelihood.at([result.c_e, end])
        for alpha in slices.alpha_below(slices.profile.max() + 1.0):
            assert slices.minus2(alpha) == pytest.approx(slices.profile.max() + 1.0, abs=1e-6)
        assert (result.n_points, result.n_censored) == (24, 6)

    def test_files_and_what_is_refused(self, tmp_path):
        curve = self.curve()
        curve.to_csv(tmp_path / "curve.csv")
        again = VelocityCurve.from_csv(tmp_path / "curve.csv")
        assert again == curve
        assert "limit_mm_s" in (tmp_path / "curve.csv").read_text("utf-8")
        result = fit(again)
        result.to_json(tmp_path / "fit.json")
        assert Fit.from_json(tmp_path / "fit.json").likelihood.objective(
            2.0, 0.1
        ) == result.likelihood.objective(2.0, 0.1)
        assert "below the limit" in curve.plot().get_legend_handles_labels()[1]
        refused(
            (lambda: VelocityCurve([1.0], [np.nan], status=["too-slow"]),
             "needs the smallest velocity that could be measured"),
            (lambda: fit(curve, residuals="absolute"), "residuals must be 'relative' with runs that were too slow"),
            (lambda: fit(curve, uncertain={"force": 0.1}), "go without groups, offsets and known values"),
            (lambda: fit(curve, engine="voxel"), "need the mean-field engine"),
        )  # fmt: skip

    def test_they_count(self):
        """Below a limit that only lucky runs pass, leaving slow runs out would raise the combination."""
        curve = self.curve(3)
        rest = VelocityCurve(curve.force[curve.ok], curve.velocity[curve.ok], radius=3.0)
        assert fit(curve).identified.value < fit(rest).identified.value
