"""The walk along c_e: as good as a search of every point of the box, whatever the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import burrlab.fitting.fit as module
from burrlab._core import Burr
from burrlab.bone.materials import materials
from burrlab.fitting.fit import Fit, fit
from burrlab.fitting.profile import _valleys
from burrlab.measured.curve import VelocityCurve
from burrlab.measured.synthetic import synthetic_curve, synthetic_indentation, synthetic_trace

BURR, BONE = Burr(3.0), materials["bone"]
FORCES = {
    "wide": np.geomspace(0.3, 2.6, 6),
    "ridge": np.array([0.3, 0.4, 0.5, 0.6]),
    "high": np.array([2.0, 2.2, 2.4, 2.6]),
    "close": np.array([0.8, 0.85, 0.9]),
    "one": 0.5 * (1 + 1e-3 * np.arange(4)),
    "three": np.array([0.4, 1.1, 2.3]),
}


def data_sets(seeds: range) -> dict[str, tuple[list, dict]]:
    """Data of every kind and residual, and options of their fit."""
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
        made[f"bounds of c_e {seed}"] = [wide], {"bounds": {"c_e": (c_e, 1.2 * c_e)}}
        made[f"bounds of alpha {seed}"] = [wide], {"bounds": {"alpha": (alpha, 1.5 * alpha)}}
        made[f"another shape {seed}"] = (
            [wide],
            {"shape": str(random.choice(["linear", "quartic", "constant"]))},
        )
        made[f"shuffled {seed}"] = [replace(wide, velocity=random.permutation(wide.velocity))], {}
        made[f"falling {seed}"] = [VelocityCurve([0.5, 1, 1.5, 2], np.sort(random.uniform(0.1, 3, 4))[::-1], radius=3)], {}  # fmt: skip
        windows = {"window_start": np.full(6, 0.1), "window_end": random.uniform(0.6, 1.2, 6)}
        made[f"windows {seed}"] = [replace(wide, **windows)], {}
        traces = [synthetic_trace(BURR, BONE, F, seed=seed) for F in (0.4, 0.8, 1.6)]
        made[f"traces {seed}"] = traces, {}
        made[f"traces, curve, pressed {seed}"] = [*traces, wide, press], {}
        small = wide.velocity[:3]
        censored = VelocityCurve([*FORCES["wide"][:3], 4.5], [*small, np.nan], status=["", "", "", "overloaded"], radius=3)  # fmt: skip
        made[f"censored {seed}"] = [censored], {}
    return made


def by_brute_force(result: Fit) -> float:
    """The lowest -2 log L of a grid over the box, made closer about its lowest points; from the residuals alone."""
    likelihood = result.likelihood
    low, high = np.log([result.bounds[name] for name in ("c_e", "alpha")]).T
    c_e = np.linspace(low[0], high[0], 300)
    found = np.inf
    values = _grid(likelihood, c_e, np.linspace(low[1], high[1], 300))
    step = (high - low) / 299
    for _, i, j in sorted((values[i, j], i, j) for i, j in np.argwhere(values <= np.sort(values.ravel())[5])):
        centre, width = np.array([c_e[i], low[1] + j * step[1]]), 2 * step
        for _ in range(12):
            axes = [
                np.clip(np.linspace(m - w, m + w, 21), *ends)
                for m, w, *ends in zip(centre, width, low, high, strict=True)
            ]
            near = _grid(likelihood, *axes)
            a, b = np.unravel_index(int(np.argmin(near)), near.shape)
            centre, width = np.array([axes[0][a], axes[1][b]]), width / 3
        found = min(found, float(near.min()))
    return found


def _grid(likelihood, log_c_e, log_alpha) -> np.ndarray:
    unit = likelihood.model.unit(np.exp(log_c_e))[:, None]
    alpha = np.exp(log_alpha)[:, None]
    if likelihood.kind == "relative":
        r = likelihood.velocity_residuals(unit) - log_alpha[:, None]
    else:
        r = likelihood.velocity_residuals(unit, alpha)
    S = np.sum(r**2, axis=-1)
    total = S if likelihood.known else likelihood.n * np.log(S / likelihood.n + likelihood._floor)
    within = np.sum(likelihood.within_residuals(unit) ** 2, axis=-1)
    pressed = np.sum(likelihood.pressed_residuals(np.exp(log_c_e)) ** 2, axis=-1)[:, None]
    for S, n, known in (
        (within, likelihood.n_within, False),
        (pressed, len(likelihood.observations.pressed), likelihood.pressed_known),
    ):
        if n:
            total = total + (S if known else n * np.log(S / n + 2e-3**2))
    return np.where(np.isfinite(total), total, np.inf)


def check(name: str, data: list, options: dict) -> None:
    data = [replace(one, radius=3.0) if one.radius is None else one for one in data]
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


def test_every_minimum_is_found():
    inf = np.inf
    for heights, places in (
        ([3, 2, 1, 2, 3, 1, 5], [2, 5]),
        ([inf, 2, 1, 1, 1 + 1e-6, 3], [2]),
        ([1, 2, 3], [0]),
        ([3, 2, 1], [2]),
        ([3, 1, inf, inf, 2, 3], [1, 4]),
        ([1, 1 + 9e-6, 1], [0]),
        ([1, 1 + 2e-5, 1], [0, 2]),
    ):
        assert _valleys(np.array(heights, dtype=float)) == places


@pytest.mark.parametrize("seed", [5, 10, 13])
def test_where_the_ridge_is_flat_the_smallest_c_e_counts(seed):
    """Forces within 0.3 %: from some c_e to the end of the search -2 log L differs by less than 1e-5."""
    curve = synthetic_curve(BURR, BONE, FORCES["one"], scatter=0.08, repeats=2, seed=seed)
    curve, bounds = replace(curve, radius=3.0), {"c_e": (2.0, 40.0)}
    result = fit(curve, bounds=bounds)
    assert result.status == "ridge"
    assert result.ridge.on_ridge
    c_e = np.geomspace(2.0, 40.0, 4000)
    slices = result.likelihood.at(c_e)
    inside = slices.best_alpha <= result.bounds["alpha"][1]
    flat = c_e[inside][slices.profile[inside] <= slices.profile[inside].min() + 1e-5]
    assert flat[-1] > 1.05 * flat[0]
    assert result.c_e == pytest.approx(flat[0], rel=2e-3)
    # rounding does not move it
    again = fit(replace(curve, velocity=curve.velocity * (1 + 1e-13)), bounds=bounds)
    assert again.c_e == pytest.approx(result.c_e, rel=1e-6)


def test_a_flat_stretch_of_less_than_5_percent_is_one_place():
    curve = synthetic_curve(BURR, BONE, FORCES["one"], scatter=0.08, repeats=2, seed=8)
    result = fit(replace(curve, radius=3.0), bounds={"c_e": (2.0, 40.0)})
    assert (result.status, result.alpha) == ("ridge", pytest.approx(result.bounds["alpha"][1]))


def test_equal_minima_apart_disagree():
    """The profile has two minima of equal RMS residual, on either side of a kink; an overloaded run ends c_e."""
    small = synthetic_curve(BURR, BONE, FORCES["ridge"], scatter=0.2, repeats=2, seed=22)
    curve = VelocityCurve([*small.force, 4.5], [*small.velocity, np.nan], status=[*[""] * 8, "overloaded"])
    result = fit(curve, BURR)
    assert result.status == "disagreement"
    assert [start.origin for start in result.starts] == ["walk along c_e", "BOBYQA 1", "BOBYQA 2"]
    ends = np.array([start.end for start in result.starts])
    assert (ends.max(axis=0) / ends.min(axis=0)).max() > 1.05
    assert "3 of 3 searches ended equally well" in result.report()


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
    assert result.status == "not-converged"
    assert result.reason.startswith("nlopt's BOBYQA ended where -2 log L is ")
    assert (result.c_e, result.alpha) == pytest.approx((right.c_e, right.alpha), rel=1e-6)
    assert result.best.origin == "BOBYQA 1"
