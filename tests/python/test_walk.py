"""The walk along c_e: as good as a search of the whole box for all kinds of data; and its check by BOBYQA."""

from dataclasses import replace

import numpy as np
import pytest
from fit_scenes import BONE, BURR

import burrlab.fitting.fit as module
from burrlab import VelocityCurve, synthetic_curve, synthetic_indentation, synthetic_trace
from burrlab.fitting.fit import Fit, fit, minimise
from burrlab.fitting.observations import Box
from burrlab.fitting.profile import _valleys
from burrlab.fitting.verdict import Start

FORCES = {
    "wide": np.geomspace(0.3, 2.6, 6),
    "ridge": np.array([0.3, 0.4, 0.5, 0.6]),
    "high": np.array([2.0, 2.2, 2.4, 2.6]),
    "close": np.array([0.8, 0.85, 0.9]),
    "one": 0.5 * (1 + 1e-3 * np.arange(4)),
    "three": np.array([0.4, 1.1, 2.3]),
}


def data_sets(seeds: range) -> dict[str, tuple[list, dict]]:
    """Data of every kind, with every residual, and options of their fit."""
    made = {}
    for seed in seeds:
        random = np.random.default_rng(seed)
        scatter = float(random.choice([0.0, 0.03, 0.08, 0.3]))
        press = synthetic_indentation(BURR, BONE, [0.05, 0.1, 0.2], scatter=0.1, seed=seed)
        press = replace(press, force=press.force * float(random.choice([0.4, 1.0, 2.5])))
        for name, force in FORCES.items():
            curve = synthetic_curve(BURR, BONE, force, scatter=scatter, repeats=2, seed=seed)
            curve = replace(curve, sigma=0.05 * curve.velocity)
            for kind in ("relative", "absolute", "sigma"):
                made[f"{name} {kind} {seed}"] = [curve], {"residuals": kind}
            made[f"{name} pressed {seed}"] = [curve, press], {}
            made[f"{name} pressed, sigma {seed}"] = [curve, press], {"residuals": "sigma"}
        wide = synthetic_curve(BURR, BONE, FORCES["wide"], scatter=scatter, repeats=1, seed=seed)
        c_e, alpha = 2.145 * random.uniform(0.8, 1.5), 0.087 * random.uniform(0.5, 2)
        shape = str(random.choice(["linear", "quartic", "constant"]))
        shuffled = random.permutation(wide.velocity)
        falling = np.sort(random.uniform(0.1, 3, 4))[::-1]
        windows = {"window_start": np.full(6, 0.1), "window_end": random.uniform(0.6, 1.2, 6)}
        traces = [synthetic_trace(BURR, BONE, F, seed=seed) for F in (0.4, 0.8, 1.6)]
        ends = {"status": ["", "", "", "overloaded"], "radius": 3}
        made |= {
            f"bounds of c_e {seed}": ([wide], {"bounds": {"c_e": (c_e, 1.2 * c_e)}}),
            f"bounds of alpha {seed}": ([wide], {"bounds": {"alpha": (alpha, 1.5 * alpha)}}),
            f"another shape {seed}": ([wide], {"law": shape}),
            f"shuffled {seed}": ([replace(wide, velocity=shuffled)], {}),
            f"falling {seed}": ([VelocityCurve([0.5, 1, 1.5, 2], falling, radius=3)], {}),
            f"windows {seed}": ([replace(wide, **windows)], {}),
            f"traces {seed}": (traces, {}),
            f"traces, curve, pressed {seed}": ([*traces, wide, press], {}),
            f"censored {seed}": (
                [VelocityCurve([*FORCES["wide"][:3], 4.5], [*wide.velocity[:3], np.nan], **ends)],
                {},
            ),
        }
    return made


def by_brute_force(result: Fit) -> float:
    """The lowest -2 log L of a grid over the box, refined about its lowest points.

    test_likelihood compares -2 log L itself with an oracle.
    """

    def heights(log_c_e: np.ndarray, log_alpha: np.ndarray) -> np.ndarray:
        slices = result.likelihood.at(np.exp(log_c_e))
        values = np.stack([slices.minus2(alpha) for alpha in np.exp(log_alpha)], axis=1)
        return np.where(np.isfinite(values), values, np.inf)

    low, high = np.log([result.bounds[name] for name in ("c_e", "alpha")]).T
    c_e, found = np.linspace(low[0], high[0], 300), np.inf
    values = heights(c_e, np.linspace(low[1], high[1], 300))
    step = (high - low) / 299
    for _, i, j in sorted((values[i, j], i, j) for i, j in np.argwhere(values <= np.sort(values.ravel())[5])):
        centre, width = np.array([c_e[i], low[1] + j * step[1]]), 2 * step
        for _ in range(12):
            axes = [
                np.clip(np.linspace(m - w, m + w, 21), *ends)
                for m, w, *ends in zip(centre, width, low, high, strict=True)
            ]
            near = heights(*axes)
            a, b = np.unravel_index(int(np.argmin(near)), near.shape)
            centre, width = np.array([axes[0][a], axes[1][b]]), width / 3
        found = min(found, float(near.min()))
    return found


def check(name: str, data: list, options: dict) -> None:
    result = fit(data, **options)
    here = float(result.likelihood.at(result.c_e).minus2(result.alpha)[0])
    assert here <= by_brute_force(result) + 1.1e-5, name
    assert result.status != "not-converged", name
    walk, *checks = result.starts
    assert checks, name
    for one in checks:
        assert float(result.likelihood.at(one.end[0]).minus2(one.end[1])[0]) >= here - 2e-5, name
    assert walk.end == (result.c_e, result.alpha)


@pytest.mark.parametrize("part", range(2))
def test_no_point_of_the_box_is_better(part):
    sets = data_sets(range(1))
    for name in list(sets)[part::2]:
        check(name, *sets[name])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 17))
def test_no_point_of_the_box_is_better_than_hundreds_of_fits(seed):
    for name, (data, options) in data_sets(range(seed, seed + 1)).items():
        check(name, data, options)


@pytest.mark.parametrize(
    ("heights", "places"),
    [
        ([3, 2, 1, 2, 3, 1, 5], [2, 5]), ([np.inf, 2, 1, 1, 1 + 1e-6, 3], [2]), ([1, 2, 3], [0]), ([3, 2, 1], [2]),
        ([3, 1, np.inf, np.inf, 2, 3], [1, 4]), ([1, 1 + 9e-6, 1], [0]), ([1, 1 + 2e-5, 1], [0, 2]),
    ],
)  # fmt: skip
def test_every_minimum_is_found(heights, places):
    assert _valleys(np.array(heights, dtype=float)) == places


@pytest.mark.parametrize("seed", [5, 13])
def test_where_the_ridge_is_flat_the_smallest_c_e_counts(seed):
    """Forces within 0.3 %: from some c_e to the end of the search, -2 log L varies by less than 1e-5."""
    curve = synthetic_curve(BURR, BONE, FORCES["one"], scatter=0.08, repeats=2, seed=seed)
    bounds = {"c_e": (2.0, 40.0)}
    result = fit(curve, bounds=bounds)
    assert result.status == "ridge"
    assert result.ridge.on_ridge
    c_e = np.geomspace(2.0, 40.0, 4000)
    slices = result.likelihood.at(c_e)
    inside = slices.best_alpha <= result.bounds["alpha"][1]
    flat = c_e[inside][slices.profile[inside] <= slices.profile[inside].min() + 1e-5]
    assert flat[-1] > 1.05 * flat[0]
    assert result.c_e == pytest.approx(flat[0], rel=2e-3)
    # rounding does not move the fit
    again = fit(replace(curve, velocity=curve.velocity * (1 + 1e-13)), bounds=bounds)
    assert again.c_e == pytest.approx(result.c_e, rel=1e-6)


@pytest.mark.parametrize("shape", ["parabolic", "quartic"])
def test_rounding_does_not_move_the_exponent(shape):
    """quartic: c_e ends at its hard bound, where the width is flat over a range of exponents."""
    curve = synthetic_curve(BURR, BONE, np.linspace(0.4, 2.6, 10), scatter=0.08, repeats=3, seed=2004)
    data = [synthetic_indentation(BURR, BONE, [0.05, 0.1, 0.15], seed=1)] if shape == "parabolic" else []
    exponents = [fit([curve, *data], law=shape).identified.exponent]
    for seed in range(5):
        noise = 1 + 1e-13 * np.random.default_rng(seed).standard_normal(len(curve))
        again = fit([replace(curve, velocity=curve.velocity * noise), *data], law=shape)
        exponents.append(again.identified.exponent)
    assert exponents == pytest.approx([exponents[0]] * 6, rel=1e-7)


def test_a_flat_stretch_of_less_than_5_percent_is_one_place():
    curve = synthetic_curve(BURR, BONE, FORCES["one"], scatter=0.08, repeats=2, seed=8)
    result = fit(curve, bounds={"c_e": (2.0, 40.0)})
    assert (result.status, result.alpha) == ("ridge", pytest.approx(result.bounds["alpha"][1]))


def test_equal_minima_apart_disagree():
    """The profile has equal minima (by RMS residual) on both sides of a kink; an overloaded run ends c_e."""
    small = synthetic_curve(BURR, BONE, FORCES["ridge"], scatter=0.2, repeats=2, seed=22)
    curve = VelocityCurve([*small.force, 4.5], [*small.velocity, np.nan], status=[*[""] * 8, "overloaded"])
    result = fit(curve, BURR)
    assert result.status == "disagreement"
    assert [start.origin for start in result.starts] == ["walk along c_e", "BOBYQA 1", "BOBYQA 2"]
    ends = np.array([start.end for start in result.starts])
    assert (ends.max(axis=0) / ends.min(axis=0)).max() > 1.05
    assert "3 of 3 searches ended equally well" in result.report()
    assert ["BOBYQA 2" in result.report(verbose=told) for told in (False, True)] == [False, True]


def test_a_minimum_that_the_walk_misses_is_reported(monkeypatch):
    curve = synthetic_curve(BURR, BONE, FORCES["wide"], scatter=0.08, seed=1)
    right = fit(curve, BURR)

    def beside(likelihood, domain):
        at = likelihood.at(1.01 * right.c_e)
        return [replace(module_minima(likelihood, domain)[0], c_e=1.01 * right.c_e,
                        alpha=float(at.best_alpha[0]), minus2=float(at.profile[0]))]  # fmt: skip

    module_minima = module.minima
    monkeypatch.setattr(module, "minima", beside)
    result = fit(curve, BURR)
    assert (result.status, result.best.origin) == ("not-converged", "BOBYQA 1")
    assert result.reason.startswith("nlopt's BOBYQA ended where -2 log L is ")
    assert (result.c_e, result.alpha) == pytest.approx((right.c_e, right.alpha), rel=1e-6)


# ---- the check ----

NAN = float("nan")
BOX = Box((0.1, 0.001), (10.0, 1.0))


def bowl(c_e: float, alpha: float) -> float:
    return float(np.log(c_e / 2.0) ** 2 + np.log(alpha / 0.1) ** 2)


def searched(objective, start=(1.0, 0.1)) -> tuple[Start, list[tuple[float, float, float]]]:
    """The search, and every value and point that it evaluated; no point may be outside the box."""
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
        assert (end.end, end.evaluations) == (pytest.approx((2.0, 0.1), rel=1e-3), len(seen))
        assert end.result in ("SUCCESS", "XTOL_REACHED", "ROUNDOFF_LIMITED")
    end, _ = searched(lambda c_e, alpha: NAN)
    assert (end.objective, end.end) == (np.inf, (1.0, 0.1))
    end, _ = searched(lambda c_e, alpha: -float(np.log(c_e * alpha)), (9.0, 0.9))
    assert end.end == pytest.approx((10.0, 1.0), rel=1e-5)
