"""The bootstrap: reproducible, resumable, and in agreement with the profile where the data are good."""

from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from fit_scenes import BONE, BURR, DATA, curve_of, fitted, with_sigma

from burrlab.common.study import Store
from burrlab.fitting.fit import fit
from burrlab.measured.synthetic import synthetic_indentation, synthetic_trace

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
    assert found.intervals["c_e"]["95"].upper is None
    assert found.intervals["combination"]["95"].closed
    assert "open" in repr(found)
    result = fit([RIDGE, PRESSED])  # an indentation determines c_e there
    ours, theirs = result.bootstrap(80, seed=1).intervals["c_e"]["68"], result.intervals["c_e"]["68"]
    assert (ours.lower, ours.upper) == pytest.approx((theirs.lower, theirs.upper), rel=0.03)


@pytest.mark.parametrize("kind", ["parametric", "residual"])
def test_every_scatter_is_drawn(kind):
    for data, options in (
        ([CURVE, PRESSED, *TRACES], {}),
        ([DATA["wide, sigma"], with_sigma(PRESSED, 0.03)], {"residuals": "sigma"}),
        ([CURVE], {"residuals": "absolute"}),
    ):
        found = fit(data, **options).bootstrap(12, kind=kind, seed=2)
        assert np.isfinite(found.c_e).all()
        assert found.c_e.std() > 0
        assert found.alpha.std() > 0


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"store": "s.jsonl"}, "a store needs a seed"), ({"n": 1}, "n must be at least 2: got 1"),
        ({"n": "many"}, "n must be a whole number from 0 and below 2.31, got 'many'"),
        ({"kind": "jackknife"}, "kind must be one of parametric, residual: got 'jackknife'"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path, monkeypatch, options, told):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=told):
        fitted("wide").bootstrap(**options)
    assert not list(tmp_path.iterdir())
