"""The bootstrap: reproducible, resumable, and in agreement with the profile where the data are good."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from fit_scenes import BONE, BURR, DATA, curve_of, fitted, with_sigma
from session_scenes import refused

from burrlab import (
    Material,
    Store,
    VelocityCurve,
    fit,
    penetration_velocity,
    synthetic_indentation,
    synthetic_trace,
)

CURVE = curve_of(np.geomspace(0.3, 2.6, 8), repeats=3)
RIDGE = curve_of([0.2, 0.3, 0.4, 0.5], repeats=3, scatter=0.05, seed=1)
PRESSED = synthetic_indentation(BURR, BONE, [0.05, 0.1, 0.2, 0.3], scatter=0.03, seed=2)
TRACES = [synthetic_trace(BURR, BONE, F, seed=int(10 * F)) for F in (0.6, 1.1, 2.0)]


def test_any_executor_gives_the_same(tmp_path):
    result = fitted("wide")
    expected = result.bootstrap(30, seed=4)
    with ProcessPoolExecutor(2) as executor:
        assert result.bootstrap(30, seed=4, executor=executor) == expected
    assert not np.array_equal(result.bootstrap(30, seed=5).c_e, expected.c_e)
    # replicate k is the same in a longer study, which resumes a shorter one
    store = Store(tmp_path / "study.jsonl")
    result.bootstrap(20, seed=4, store=store)
    assert len(store) == 20
    assert result.bootstrap(30, seed=4, store=store) == expected
    assert len(store) == 30


@pytest.mark.parametrize("kind", ["parametric", "residual"])
def test_agrees_with_the_profile_on_a_wide_design(kind):
    """22 degrees of freedom: F's 95 % is 8 % wider than the normal's; percentiles of 200 have 14 % error."""
    result = fit(CURVE)
    found = result.bootstrap(200, kind=kind, seed=1)
    assert found.on_ridge == 0
    for name in ("c_e", "alpha"):
        ours, theirs = found.intervals[name]["95"], result.intervals[name]["95"]
        assert np.log(ours.ratio()) == pytest.approx(np.log(theirs.ratio()), rel=0.4)
        assert np.log(ours.lower) == pytest.approx(np.log(theirs.lower), abs=0.3 * np.log(theirs.ratio()))


def test_on_the_ridge():
    found = fit(RIDGE).bootstrap(40, seed=1)
    assert found.on_ridge > 0.2
    assert (found.intervals["c_e"]["95"].upper, found.intervals["combination"]["95"].closed) == (None, True)
    assert "open" in repr(found)
    result = fit([RIDGE, PRESSED])  # an indentation determines c_e there
    ours, theirs = result.bootstrap(80, seed=1).intervals["c_e"]["68"], result.intervals["c_e"]["68"]
    assert (ours.lower, ours.upper) == pytest.approx((theirs.lower, theirs.upper), rel=0.03)


SCATTERED = (
    ([CURVE, PRESSED, *TRACES], {}),
    ([DATA["wide, sigma"], with_sigma(PRESSED, 0.03)], {"residuals": "sigma"}),
    ([CURVE], {"residuals": "absolute"}),
)


@pytest.mark.parametrize(
    ("kind", "data", "options"),
    [*((kind, *each) for kind in ("parametric", "residual") for each in SCATTERED),
     ("groups", lambda: TestEffects().curve(of_c_e=0.1), {"plausible": None})],
)  # fmt: skip
def test_every_scatter_is_drawn(kind, data, options):
    found = fit(data() if callable(data) else data, **options).bootstrap(12, kind=kind, seed=2)
    assert 0 < np.min([found.c_e.std(), found.alpha.std()]) < np.inf  # which none that is not finite leaves


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"store": "s.jsonl"}, "a store needs a seed"), ({"n": 1}, "n must be at least 2: got 1"),
        ({"n": "many"}, "n must be a whole number from 0 and below 2.31, got 'many'"),
        ({"kind": "jackknife"}, "kind must be one of parametric, residual, groups: got 'jackknife'"),
    ],
)  # fmt: skip
def test_what_is_refused(here, options, told):
    refused((lambda: fitted("wide").bootstrap(**options), told))
    assert not list(here.iterdir())


class TestEffects:
    """Days, specimens and offsets are drawn anew; of six or more, the levels themselves can be."""

    FORCE, LEVEL = np.tile(np.geomspace(0.3, 2.2, 8), 8), np.repeat(np.arange(8), 8)

    def curve(self, *, of_c_e=0.0, within=0.05):
        random = np.random.default_rng(4)
        logs = np.array([of_c_e, 0.1])[:, None] * random.normal(size=(2, 8))
        logs -= logs.mean(axis=1, keepdims=True)
        materials = [
            Material("level", c_e=BONE.c_e * np.exp(c), alpha=BONE.alpha * np.exp(a)) for c, a in logs.T
        ]
        v = np.array(
            [penetration_velocity(BURR, materials[k], F) for k, F in zip(self.LEVEL, self.FORCE, strict=True)]
        )
        v *= np.exp(within * random.normal(size=len(v)))
        return VelocityCurve(self.FORCE, v, radius=3.0, specimen=self.LEVEL)

    @pytest.mark.slow
    @pytest.mark.parametrize("kind", ["parametric", "groups"])
    @pytest.mark.parametrize("of_c_e", [0.0, 0.1])
    def test_agrees_with_the_profile(self, kind, of_c_e):
        """Percentiles of 100 have 20 % error; t of 7 degrees of freedom is 18 % wider than the normal's."""
        result = fit(self.curve(of_c_e=of_c_e), plausible=None)
        found = result.bootstrap(100, kind=kind, seed=1)
        for name, levels in {**result.intervals, "combination": result.identified.intervals}.items():
            ours, theirs = found.intervals[name]["95"], levels["95"]
            assert np.log(ours.ratio()) == pytest.approx(np.log(theirs.ratio()), rel=0.5)
            assert np.log(ours.lower) == pytest.approx(
                np.log(theirs.lower), abs=0.35 * np.log(theirs.ratio())
            )

    def test_of_offsets_runs_and_a_store(self, tmp_path):
        """The combination of a fit with an uncertain force varies as its interval says, not as the scatter alone does."""
        curve = replace(self.curve(), groups={})
        result, plain = fit(curve, uncertain={"force": 0.03}), fit(curve)
        found = result.bootstrap(60, seed=2, store=Store(tmp_path / "store.jsonl"))
        assert result.bootstrap(60, seed=2, store=Store(tmp_path / "store.jsonl")) == found
        width = np.log(found.intervals["combination"]["95"].ratio())
        assert width == pytest.approx(np.log(result.identified.interval.ratio()), rel=0.4)
        assert width > 1.5 * np.log(plain.identified.interval.ratio())
        traces = [
            replace(trace, groups={"day": f"day {k}"}) for k, trace in enumerate([*TRACES[:2], *TRACES])
        ]
        two = fit([*traces[:2], *(replace(x, groups={"day": "day 0"}) for x in TRACES), PRESSED], groups=())
        assert np.isfinite(
            fit(traces[:2] + [replace(x, groups={"day": "day 1"}) for x in TRACES]).bootstrap(3, seed=1).c_e
        ).all()
        assert np.isfinite(two.bootstrap(3, seed=1).c_e).all()

    def test_of_known_values_draws_their_errors(self):
        result = fit(RIDGE, known={"c_e": (2.145, 0.1)})
        drawn = result.bootstrap(100, seed=1).intervals["c_e"]["68"].ratio()
        assert drawn == pytest.approx(result.intervals["c_e"]["68"].ratio(), rel=0.05)  # about 1.10

    def test_what_is_refused(self):
        few = fit(replace(self.curve(), groups={"day": self.LEVEL // 2}))
        needed = "kind 'groups' needs a fit with 6 days or specimens or more: got "
        refused(
            (lambda: few.bootstrap(3, kind="groups"), needed + "4"),
            (lambda: few.bootstrap(3, kind="residual"), "a bootstrap is 'parametric' or of 'groups'"),
            (lambda: fitted("wide").bootstrap(3, kind="groups"), needed + "0"),
        )


def test_c_e_beyond_the_ridges_beginning_is_no_ridge():
    """Traces tell c_e there: v is a power law but for some per cent, and the profile closes its interval."""
    result = fit([synthetic_trace(BURR, BONE, F, seed=k) for k, F in enumerate((0.4, 0.8, 1.6, 2.0) * 2)])
    ours, theirs = result.bootstrap(60, seed=1).intervals["c_e"]["95"], result.intervals["c_e"]["95"]
    assert (ours.lower, ours.upper) == pytest.approx((theirs.lower, theirs.upper), rel=0.02)
