"""The environment variable and the function that choose the CPU path, and what they refuse."""

import json
import os
import subprocess
import sys

import pytest

import burrlab._core as _core

PATHS = tuple(_core.cpu_paths())

pytestmark = pytest.mark.usefixtures("keep_cpu_path")

SCRIPT = """
import json
import burrlab
from burrlab import _core
from burrlab.common.provenance import provenance
run = burrlab.descend(burrlab.Burr(3.0), burrlab.materials["bone"], 2.0, voxel=0.4, seed=1, ideal=True)
print(json.dumps([_core.cpu_path(), provenance()["cpu_path"], run.provenance["cpu_path"], run.provenance["digest"],
                  run.penetration_velocity]))
"""


def import_with(name: str | None, script: str = SCRIPT) -> subprocess.CompletedProcess[str]:
    chosen = {} if name is None else {"BURRLAB_CPU_PATH": name}
    environment = {key: value for key, value in os.environ.items() if key != "BURRLAB_CPU_PATH"} | chosen
    return subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)


def test_environment_variable_chooses_the_path() -> None:
    """An unset or empty variable chooses the fastest path; a descent has the same digest on all."""
    results = set()
    for name, path in [(None, PATHS[-1]), ("", PATHS[-1]), *zip(PATHS, PATHS, strict=True)]:
        process = import_with(name)
        assert process.returncode == 0, process.stderr
        *named, digest, velocity = json.loads(process.stdout)
        assert named == [path] * 3
        results.add((digest, velocity))
    assert len(results) == 1


MUST_BE = f"must be one that this CPU runs, {', '.join(PATHS)}; got "


def test_a_wrong_environment_variable_ends_the_import_of_the_core() -> None:
    """The error names the paths that this CPU runs."""
    process = import_with("AVX2", "import burrlab; burrlab.Burr")
    assert process.returncode == 1
    assert process.stderr.splitlines()[-1] == f"ImportError: BURRLAB_CPU_PATH {MUST_BE}'AVX2'"


@pytest.mark.parametrize("name", ["x", "", "AVX2", "scalar "])
def test_use_of_an_unknown_path(name: str) -> None:
    before = _core.cpu_path()
    with pytest.raises(ValueError, match=f"cpu_path {MUST_BE}'{name}'$"):
        _core.use_cpu_path(name)
    assert _core.cpu_path() == before


def test_paths_are_named_plainest_first() -> None:
    assert [name for name in ("scalar", "portable", "avx2", "avx512") if name in PATHS] == list(PATHS)
    assert "portable" in PATHS
    for name in PATHS:
        _core.use_cpu_path(name)
        assert _core.cpu_path() == name
