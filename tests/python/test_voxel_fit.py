"""The voxel engine of the fit: resumes, does not depend on the executor, and owns up to its Monte Carlo error."""

from __future__ import annotations

import io
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from burrlab import materials
from burrlab._core import Burr
from burrlab.bone.specimen import half_space
from burrlab.bone.uneven import BoneField
from burrlab.common.study import Store
from burrlab.fitting.fit import Fit, fit
from burrlab.fitting.voxel import VoxelDescent, VoxelEngine, VoxelSettings
from burrlab.measured.synthetic import synthetic_curve
from burrlab.theory.continuum import penetration_velocity

NAN = float("nan")
BURR, PVC = Burr(3.0), materials["pvc"]
CURVE = synthetic_curve(BURR, PVC, [0.2, 0.35, 0.6], repeats=2, scatter=0.04, seed=1)
OPTIONS = {"voxel": 0.4, "replicates": 2}


def voxel_fit(curve, burr=None, **options):
    return fit(curve, burr, engine=VoxelEngine(**options))


def test_resumes_and_any_executor_gives_the_same(tmp_path):
    store = Store(tmp_path / "descents.jsonl")
    first = voxel_fit(CURVE, **OPTIONS, store=store)
    n = len(store)
    assert n == 3 * 2 * len(first.record)
    with ThreadPoolExecutor(3) as executor:
        again = voxel_fit(CURVE, **OPTIONS, store=store, executor=executor)
        assert len(store) == n
        fresh = voxel_fit(CURVE, **OPTIONS, executor=executor)
    for other in (again, fresh):
        assert {**other.to_dict(), "seconds": 0} == {**first.to_dict(), "seconds": 0}
    voxel_fit(CURVE, **OPTIONS | {"replicates": 3}, store=store)
    assert n < len(store) < 3 * n  # a third replicate, the rest is there


def test_beyond_the_table_the_last_value_holds():
    result = voxel_fit(CURVE, **OPTIONS)
    table, model = result.table, result.likelihood.model
    mean_field = fit(CURVE).likelihood.model
    ratio = model.unit([table.high, 3 * table.high]) / mean_field.unit([table.high, 3 * table.high])
    np.testing.assert_allclose(ratio[1], ratio[0], rtol=1e-12)
    assert np.isnan(model.unit(0.99 * table.low)).all()
    assert table.coefficients.shape == (2, 6, 4)


@pytest.mark.parametrize(
    "options",
    [{"specimen": half_space(BURR, 0.4)}, {"specimen": BoneField(mean=0.8, contrast=0.1)}],
    ids=["specimen", "bone field"],
)
def test_other_bone_runs(options):
    result = voxel_fit(CURVE, **OPTIONS, **options)
    assert result.status != "not-converged"
    assert result.evidence.monte_carlo > 0
    assert result.provenance["specimen"] != "solid bone"
    assert "the Monte Carlo error of the fit widens the limits" in result.report()


@pytest.mark.slow
def test_uneven_bone_and_few_replicates_widen_the_limits():
    curve = synthetic_curve(BURR, materials["bone"], [0.6, 1.0, 1.8], repeats=2, scatter=0.04, seed=1)
    options = {"voxel": 0.4}

    def share(contrast, replicates):
        result = voxel_fit(
            curve, **options, replicates=replicates, specimen=BoneField(mean=0.7, contrast=contrast)
        )
        return result.table.noise, result.evidence.monte_carlo

    even, uneven = share(0.02, 8), share(0.3, 8)
    assert uneven[0] > 5 * even[0]
    # the variance of the velocities of a replicate grows by over a hundred
    assert uneven[1] > 20 * even[1]
    assert share(0.02, 2)[1] > 1.5 * even[1]


@pytest.mark.slow
def test_half_dense_bone_ends_c_e_where_its_descents_are_overloaded():
    """The window of the largest force exists only above a c_e about twice that of solid bone."""
    curve = synthetic_curve(BURR, materials["bone"], [0.6, 1.0, 1.8], repeats=2, scatter=0.04, seed=1)
    result = voxel_fit(curve, voxel=0.4, replicates=2, specimen=BoneField(mean=0.5, contrast=0.0))
    hard = result.bounds["c_e"][0]
    assert 1.6 * hard < result.table.low < 2.2 * hard
    for interval in result.intervals["c_e"].values():
        assert interval.lower >= result.table.low
    assert "would have been no window" in str(result.test(1.5 * hard, result.alpha))


@pytest.mark.slow
def test_through_the_rig():
    result = voxel_fit(CURVE, **OPTIONS, rig=True)
    assert result.provenance["rig"] is True
    assert result.evidence is None or 0.3 < result.c_e < 0.7


def plain(result):
    return {key: value for key, value in result.to_dict().items() if key != "seconds"}


class TestVoxelEngine:
    OPTIONS = {"voxel": 0.4}  # noqa: RUF012
    CURVE = synthetic_curve(BURR, materials["pvc"], [0.2, 0.35, 0.6], repeats=1, scatter=0, seed=1)

    def test_begins_at_the_mean_field_and_ends_near_the_truth(self):
        told = []
        result = voxel_fit(
            self.CURVE, BURR, **self.OPTIONS, progress=lambda done, most: told.append((done, most))
        )
        assert result.engine == "voxel"
        assert result.starts[0].origin == "from mean-field"
        assert result.starts[0].start == pytest.approx((0.462, 0.256), rel=1e-3)
        # R/s = 7.5: within a few per cent of mean-field
        assert result.c_e == pytest.approx(0.462, rel=0.08)
        assert result.residual_norm < 0.05
        assert told[: told[0][1]] == [(i + 1, told[0][1]) for i in range(told[0][1])]
        # the table's points lie along the ridge, over the c_e that were fitted
        assert len(told) == 3 * 4 * len(result.record)
        assert min(c_e for c_e, _ in result.record) < result.c_e < max(c_e for c_e, _ in result.record)
        assert "stochastic" in result.report()
        assert Fit.from_dict(result.to_dict()).to_dict() == result.to_dict()
        with ThreadPoolExecutor(3) as executor:
            other = voxel_fit(self.CURVE, BURR, **self.OPTIONS, executor=executor)
        assert plain(other) == plain(result)

    def test_no_descent_with_a_number_is_said(self):
        result = voxel_fit(self.CURVE, BURR, **self.OPTIONS, dt=50.0)
        assert result.status == "not-converged"
        assert result.reason.startswith("No parameters tried gave every row a velocity")
        stream = io.StringIO()
        result.to_json(stream)
        stream.seek(0)
        assert Fit.from_json(stream).to_dict() == result.to_dict()
        assert result.to_dict()["residual"] is None

    def test_windows_of_the_rows(self):
        curve = replace(self.CURVE, window_start=[0.3, NAN, 0.6], window_end=[0.8, NAN, 1.1])
        velocity = [
            penetration_velocity(BURR, materials["pvc"], 0.2, 0.3, 0.8),
            penetration_velocity(BURR, materials["pvc"], 0.35),
            penetration_velocity(BURR, materials["pvc"], 0.6, 0.6, 1.1),
        ]
        result = voxel_fit(replace(curve, velocity=velocity), BURR, **self.OPTIONS)
        assert result.residual_norm < 0.05
        np.testing.assert_allclose(result.predicted, velocity, rtol=0.1)

    def test_an_interrupt_passes_through(self):
        def stop(done, most):
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            voxel_fit(self.CURVE, BURR, **self.OPTIONS, progress=stop)

    def test_a_descent_is_a_small_picklable_item(self):
        item = VoxelDescent(
            BURR,
            materials["pvc"],
            0.35,
            ((None, None), (0.2, 0.3)),
            VoxelSettings(0.4, 1.0, False, None, 4),
            7,
        )
        assert len(pickle.dumps(item)) < 2000
        assert pickle.loads(pickle.dumps(item)).velocities() == item.velocities()

    def test_an_error_in_a_descent_passes_through(self):
        with pytest.raises(ValueError, match="voxel"):
            voxel_fit(self.CURVE, BURR, voxel=-1.0)

    def test_keywords_of_the_version_before_work_and_warn(self):
        with pytest.warns(
            DeprecationWarning, match=r"voxel, replicates of fit\(\) will go: give engine=VoxelEngine"
        ):
            old = fit(CURVE, engine="voxel", **OPTIONS)
        assert plain(old) == plain(voxel_fit(CURVE, **OPTIONS))
        with pytest.raises(TypeError, match=r"voxel must be given to VoxelEngine alone"):
            fit(CURVE, engine=VoxelEngine(), voxel=0.4)
        with pytest.raises(TypeError, match="unexpected keyword argument 'size'"):
            fit(CURVE, size=0.4)

    def test_bounds_below_every_window_of_the_voxels_are_said(self):
        hard = fit(CURVE).bounds["c_e"][0]
        engine = VoxelEngine(**OPTIONS, specimen=BoneField(mean=0.85, contrast=0.0))
        result = fit(CURVE, engine=engine, bounds={"c_e": (hard, 1.1 * hard)})
        assert result.status == "not-converged"
        assert result.reason == "No c_e within its bounds gave every row a velocity."
