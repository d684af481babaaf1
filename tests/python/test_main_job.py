"""From a measured curve to fitted constants to voxel descents on the data."""

import runpy
import sys

import numpy as np
import pytest
from conftest import ROOT

import burrlab


@pytest.mark.parametrize("name", ["specimen_a.csv", "specimen_b.csv"])
def test_voxel_descents_at_the_fitted_values_lie_on_the_data(shared_data, burr, name):
    """The mean of three repeats with 8 % scatter has an error of 4.6 %; the fit's own adds to it."""
    curve = burrlab.VelocityCurve.from_csv(shared_data / "measurements" / name)
    fit = burrlab.fit(curve, burr)
    forces = np.unique(curve.force)[2::3]
    descents = burrlab.force_sweep(burr, fit.material("fitted"), forces, voxel=0.1, seed=1)
    assert set(descents.status) == {"ok"}
    means = np.array([np.exp(np.mean(np.log(curve.velocity[curve.force == f]))) for f in forces])
    # Five standard errors of a mean: one false alarm in a million.
    np.testing.assert_allclose(np.log(descents.velocity / means), 0.0, atol=5 * 0.08 / np.sqrt(3))
    # On average they lie on the line.
    assert abs(np.mean(np.log(descents.velocity / fit.velocity(forces)))) < 0.03


_RUN_ELSEWHERE = {"experiment_driver.py", "demo.py"}  # by test_experiment_live.py and by `make demo`
_ARGUMENTS = {
    "grid_independence.py": ["grid.png", "--fast"],
    "session_leader.py": ["trace.h5", "--seconds", "2", "--port", "0"],
    "session_driver.py": ["--seconds", "2"],
}


@pytest.mark.parametrize(
    "script", sorted({p.name for p in (ROOT / "examples").glob("*.py")} - _RUN_ELSEWHERE)
)
def test_examples_run(script, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [script, *_ARGUMENTS.get(script, [])])
    runpy.run_path(str(ROOT / "examples" / script), run_name="__main__")
    figures = list(tmp_path.rglob("*.png"))
    assert figures or script.startswith("session_")
    assert all(figure.stat().st_size > 10_000 for figure in figures)
