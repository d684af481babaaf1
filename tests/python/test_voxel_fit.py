"""The voxel engine of the fit: resumption, independence of the executor, and Monte Carlo error."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from fit_scenes import BURR, curve_of, plain
from session_scenes import refused

from burrlab import BoneField, Fit, Store, fit, half_space, materials, penetration_velocity
from burrlab.fitting.voxel import VoxelDescent, VoxelEngine, sink

NAN = float("nan")
PVC = materials["pvc"]
CURVE, EXACT = (
    curve_of([0.2, 0.35, 0.6], material=PVC, scatter=scatter, repeats=repeats, seed=1)
    for scatter, repeats in ((0.04, 2), (0.0, 1))
)
SPARSE = {"voxel": 0.4, "replicates": 2}


def voxel_fit(curve, **options):
    return fit(curve, engine=VoxelEngine(**SPARSE | options, seed=0))


@pytest.fixture(scope="module")
def sparse():
    return voxel_fit(CURVE)


def test_resumes_and_any_executor_gives_the_same(sparse, tmp_path):
    store = Store(tmp_path / "descents.jsonl")
    assert plain(voxel_fit(CURVE, store=store)) == plain(sparse)
    n = len(store)
    assert n == 3 * 2 * len(sparse.record)
    with ThreadPoolExecutor(3) as executor:
        assert (plain(voxel_fit(CURVE, store=store, executor=executor)), len(store)) == (plain(sparse), n)
    voxel_fit(CURVE, replicates=3, store=store)
    assert n < len(store) < 3 * n  # only a third replicate is new


def test_knows_days_and_an_uncertain_force():
    """The columns of both are the mean field's, so the effects are those of the mean-field fit."""
    days = np.repeat(["Monday", "Tuesday"], 3)
    velocity = CURVE.velocity * np.where(np.tile([0, 1], 3), 1.3, 1.0)
    curve = replace(CURVE, velocity=velocity, groups={"day": np.tile(days[[0, 3]], 3)})
    options = {"uncertain": {"force": 0.005}, "known": {"c_e": (PVC.c_e, 0.1)}}
    found, expected = fit(curve, engine=VoxelEngine(**SPARSE, seed=0), **options), fit(curve, **options)
    assert [(x.group, x.quantity) for x in found.effects] == [("day", "alpha"), ("data set", "force")]
    assert found.effects[0].values == pytest.approx(expected.effects[0].values, abs=0.05)
    assert found.effects[1].errors == pytest.approx(expected.effects[1].errors, rel=0.3)
    assert "Between the 2 days alpha differs by" in found.verdict
    sunk = {"engine": VoxelEngine(**SPARSE, seed=0), "uncertain": {"surface": 0.01}}
    refused(
        (lambda: fit(curve, **sunk), "the voxel engine takes offsets of force alone: got surface"),
        (lambda: found.influence_by("day"), "the voxel engine's table serves the rows of its own data alone"),
    )


def test_the_best_point_may_lie_at_the_edge_of_the_window():
    """There a difference over c_e has a velocity on one side only."""
    found = voxel_fit(curve_of([1.4, 2.6, 3.55], scatter=0.05, repeats=2, seed=3))
    assert np.isfinite(found.evidence.information).all()
    assert found.evidence.monte_carlo > 0


def test_beyond_the_table_the_last_value_holds(sparse):
    table, model = sparse.table, sparse.likelihood.model
    c_e = [table.high, 3 * table.high]
    ratio = model.unit(c_e) / fit(CURVE).likelihood.model.unit(c_e)
    np.testing.assert_allclose(ratio[1], ratio[0], rtol=1e-12)
    assert np.isnan(model.unit(0.99 * table.low)).all()
    assert table.coefficients.shape == (2, 6, 4)


@pytest.mark.parametrize("specimen", [half_space(BURR, 0.4), BoneField(mean=0.8, contrast=0.1)])
def test_other_bone_runs(specimen):
    result = voxel_fit(CURVE, specimen=specimen)
    assert result.status != "not-converged"
    assert result.evidence.monte_carlo > 0
    assert result.provenance["specimen"] != "solid bone"
    assert "the Monte Carlo error of the fit widens the limits" in result.report()


@pytest.mark.slow
def test_uneven_bone_and_few_replicates_widen_the_limits():
    curve = curve_of([0.6, 1.0, 1.8], scatter=0.04, seed=1)

    def share(contrast, replicates):
        result = voxel_fit(curve, replicates=replicates, specimen=BoneField(mean=0.7, contrast=contrast))
        return result.table.noise, result.evidence.monte_carlo

    even, uneven = share(0.02, 8), share(0.3, 8)
    assert uneven[0] > 5 * even[0]
    # the variance of a replicate's velocities grows over a hundredfold
    assert uneven[1] > 20 * even[1]
    assert share(0.02, 2)[1] > 1.5 * even[1]


@pytest.mark.slow
def test_half_dense_bone_ends_c_e_where_its_descents_are_overloaded():
    """The window of the largest force exists only above a c_e about twice that of solid bone."""
    curve = curve_of([0.6, 1.0, 1.8], scatter=0.04, seed=1)
    result = voxel_fit(curve, specimen=BoneField(mean=0.5, contrast=0.0))
    hard = result.bounds["c_e"][0]
    assert 1.6 * hard < result.table.low < 2.2 * hard
    for interval in result.intervals["c_e"].values():
        assert interval.lower >= result.table.low
    assert "would have been no window" in str(result.test(1.5 * hard, result.alpha))


@pytest.mark.slow
def test_through_the_rig():
    result = voxel_fit(CURVE, rig=True)
    assert result.provenance["rig"] is True
    assert result.evidence is None or 0.3 < result.c_e < 0.7


def test_begins_at_the_mean_field_and_ends_near_the_truth():
    told = []
    result = voxel_fit(EXACT, replicates=4, progress=told.append)
    assert (result.engine, result.starts[0].origin, result.starts[0].start) == (
        "voxel", "from mean-field", pytest.approx((0.462, 0.256), rel=1e-3),
    )  # fmt: skip
    # R/s = 7.5: within a few per cent of mean-field
    assert result.c_e == pytest.approx(0.462, rel=0.08)
    assert result.residual_norm < 0.05
    first = told[: round(1 / told[0])]
    assert first == [(i + 1) / len(first) for i in range(len(first))]
    # the table's points lie along the ridge, over the c_e that were fitted
    assert len(told) == 3 * 4 * len(result.record)
    assert min(c_e for c_e, _ in result.record) < result.c_e < max(c_e for c_e, _ in result.record)
    assert "stochastic" in result.report()
    assert Fit.from_dict(result.to_dict()).to_dict() == result.to_dict()


def test_no_descent_with_a_number_is_said(tmp_path):
    result = voxel_fit(EXACT, dt=50.0)
    assert result.status == "not-converged"
    assert result.reason.startswith("No parameters tried gave every row a velocity")
    result.to_json(tmp_path / "fit.json")
    assert Fit.from_json(tmp_path / "fit.json").to_dict() == result.to_dict()
    assert result.to_dict()["residual"] is None
    assert "log-likelihood" not in result.report()


def test_windows_of_the_rows():
    windows = [(0.2, 0.3, 0.8), (0.35, None, None), (0.6, 0.6, 1.1)]
    velocity = [penetration_velocity(BURR, PVC, *window) for window in windows]
    start, end = [0.3, NAN, 0.6], [0.8, NAN, 1.1]
    result = voxel_fit(replace(EXACT, velocity=velocity, window_start=start, window_end=end))
    assert result.residual_norm < 0.05
    np.testing.assert_allclose(result.predicted, velocity, rtol=0.1)


def test_what_happens_in_a_descent_passes_through():
    stop = Mock(side_effect=KeyboardInterrupt)
    refused(
        (lambda: voxel_fit(EXACT, progress=stop), None, KeyboardInterrupt),
        (lambda: voxel_fit(EXACT, voxel=-1.0), "voxel"),
    )


def test_a_descent_is_a_small_picklable_item():
    item = VoxelDescent(BURR, PVC, 0.35, ((None, None), (0.2, 0.3)), VoxelEngine(voxel=0.4), 7)
    assert len(pickle.dumps(item)) < 2000
    assert sink(pickle.loads(pickle.dumps(item))) == sink(item)


def test_bounds_below_every_window_of_the_voxels_are_said():
    hard = fit(CURVE).bounds["c_e"][0]
    engine = VoxelEngine(**SPARSE, specimen=BoneField(mean=0.85, contrast=0.0))
    result = fit(CURVE, engine=engine, bounds={"c_e": (hard, 1.1 * hard)})
    assert result.status == "not-converged"
    assert result.reason == "No c_e within its bounds gave every row a velocity."
