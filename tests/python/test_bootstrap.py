"""The bootstrap: reproducible, resumable, and of one mind with the profile where that is sure."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from burrlab import materials
from burrlab._core import Burr
from burrlab.common.study import Store
from burrlab.fitting.bootstrap import _runs
from burrlab.fitting.fit import fit
from burrlab.fitting.observations import Observations
from burrlab.measured.synthetic import synthetic_curve, synthetic_indentation, synthetic_trace

BURR, BONE = Burr(3.0), materials["bone"]
WIDE = np.geomspace(0.3, 2.6, 8)
CURVE = synthetic_curve(BURR, BONE, WIDE, repeats=3, scatter=0.08, seed=3)
RIDGE = synthetic_curve(BURR, BONE, [0.2, 0.3, 0.4, 0.5], repeats=3, scatter=0.05, seed=1)
PRESSED = synthetic_indentation(BURR, BONE, [0.05, 0.1, 0.2, 0.3], scatter=0.03, seed=2)


def test_any_executor_gives_the_same(tmp_path):
    result = fit(CURVE)
    expected = result.bootstrap(60, seed=4)
    with ThreadPoolExecutor(3) as threads, ProcessPoolExecutor(2) as processes:
        for executor in (threads, processes):
            found = result.bootstrap(60, seed=4, executor=executor)
            np.testing.assert_array_equal(found.c_e, expected.c_e)
            np.testing.assert_array_equal(found.alpha, expected.alpha)
    assert not np.array_equal(result.bootstrap(60, seed=5).c_e, expected.c_e)
    # replicate k is the same in a longer study, which goes on where a shorter one ended
    store = Store(tmp_path / "study.jsonl")
    result.bootstrap(40, seed=4, store=store)
    assert len(store) == 40
    np.testing.assert_array_equal(result.bootstrap(60, seed=4, store=store).c_e, expected.c_e)
    assert len(store) == 60


@pytest.mark.parametrize("kind", ["parametric", "residual"])
def test_agrees_with_the_profile_on_a_wide_design(kind):
    """22 degrees of freedom: F's 95 % is 8 % wider than the normal's, percentiles of 400 are known to 10 %."""
    result = fit(CURVE)
    found = result.bootstrap(400, kind=kind, seed=1)
    assert found.on_ridge == 0
    for name in ("c_e", "alpha"):
        ours, theirs = found.intervals[name]["95"], result.intervals[name]["95"]
        assert np.log(ours.ratio()) == pytest.approx(np.log(theirs.ratio()), rel=0.4)
        assert np.log(ours.lower) == pytest.approx(np.log(theirs.lower), abs=0.3 * np.log(theirs.ratio()))


def test_open_on_the_ridge():
    found = fit(RIDGE).bootstrap(80, seed=1)
    assert found.on_ridge > 0.2
    assert found.intervals["c_e"]["95"].upper is None
    assert found.intervals["combination"]["95"].closed
    assert "open" in repr(found)
    assert found.to_dict()["intervals"]["c_e"]["95"][1] is None


def test_an_indentation_tells_c_e_on_the_ridge():
    result = fit([RIDGE, PRESSED])
    ours, theirs = result.bootstrap(80, seed=1).intervals["c_e"]["68"], result.intervals["c_e"]["68"]
    assert theirs.closed
    assert (ours.lower, ours.upper) == pytest.approx((theirs.lower, theirs.upper), rel=0.03)


@pytest.mark.parametrize("kind", ["parametric", "residual"])
def test_every_scatter_is_drawn(kind):
    traces = [synthetic_trace(BURR, BONE, F, seed=int(10 * F)) for F in (0.6, 1.1, 2.0)]
    sigma = replace(CURVE, sigma=0.08 * CURVE.velocity)
    for data, options in (
        ([CURVE, PRESSED, *traces], {}),
        ([sigma, replace(PRESSED, sigma=0.03 * PRESSED.force)], {"residuals": "sigma"}),
        ([CURVE], {"residuals": "absolute"}),
    ):
        found = fit(data, **options).bootstrap(30, kind=kind, seed=2)
        assert np.isfinite(found.c_e).all()
        assert found.c_e.std() > 0
        assert found.alpha.std() > 0


def test_segments_have_their_run_s_mean():
    traces = [synthetic_trace(BURR, BONE, F, seed=1) for F in (0.6, 1.1, 2.0)]
    o = Observations.of(traces, None)
    log = _runs(
        o, np.array([0.1, -0.2, 0.3]), np.random.default_rng(1).standard_normal(15), np.array([0.5, 1, 2])
    )
    np.testing.assert_allclose([log[o.run == i].mean() for i in range(3)], [0.1, -0.2, 0.3], atol=1e-12)


def test_a_store_needs_a_seed(tmp_path):
    with pytest.raises(ValueError, match="a store needs a seed"):
        fit(CURVE).bootstrap(2, store=tmp_path / "s.jsonl")
    assert not list(tmp_path.iterdir())


def test_errors():
    result = fit(CURVE)
    with pytest.raises(ValueError, match="n must be at least 2: got 1"):
        result.bootstrap(1)
    with pytest.raises(ValueError, match="kind must be one of parametric, residual: got 'jackknife'"):
        result.bootstrap(10, kind="jackknife")
