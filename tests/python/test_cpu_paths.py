"""Every CPU path of the tick gives the bits of the reference and, in long runs, of the others; its choice."""

import json
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import tick_scenes
from tick_scenes import SCHEMES, Scene, check_scene, make_pair, on_every_path, scene_of, step_both, tissues_of

from burrlab import Burr, BurrContact, VoxelBone, _core, materials
from reference.tick import draw_lanes

PATHS = tuple(_core.cpu_paths())
KINDS = (
    "parabolic",
    "quartic",
    "power(7.3)",
    "power(0.5)",
    "linear",
    "constant",
    *tick_scenes.ALL_SHAPES[-3:],
)  # of shapes
LARGE = 2**64 - 1
COLUMNS = ("force", "normal", "m1", "m0", "penetration", "removed", "faint", "ambiguous")

pytestmark = pytest.mark.usefixtures("keep_cpu_path")


# --- Against the reference ----------------------------------------------------------------------------------


@pytest.mark.parametrize("fill", ["solid", "faint", "sparse", "half"])
@pytest.mark.parametrize("product", [1e-4, 0.087, 2.0, 40.0])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_rates_and_fills(scheme: str, product: float, fill: str) -> None:
    """alpha dt runs from a rate that nearly always keeps a level to one that leaves nothing."""
    scene = scene_of(scheme, "power(1.5)", alpha=product, fill=fill, tick=2**64 - 9, size=(17, 25, 31))
    assert check_scene(scene) > 0.0


@pytest.mark.parametrize(
    "size", [(1, 1, 1), (7, 9, 15), (8, 8, 8), (9, 17, 5), (3, 40, 2), (5, 6, 300), (300, 6, 5), (6, 150, 7)]
)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_clipped_volumes(scheme: str, size: tuple[int, int, int]) -> None:
    """Sides are no multiples of a brick, shorter than a brick, or longer than four blocks (128 voxels)."""
    for snap in (0.0, 1.0):
        places = [(i / 7, 0.3, 0.9) for i in range(8)]
        steps = tuple((share[k:] + share[:k], True) for share in places for k in range(3))
        scene = scene_of(scheme, "quartic", size=size, steps=steps, snap=snap, ratio=5.0, alpha=0.5)
        assert check_scene(scene) > 0.0
        assert check_scene(scene, tissues_of("random" if snap else "bricks", size, 16, (0.5, 0.2))) > 0.0


@pytest.mark.parametrize("shape", KINDS)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_sphere_of_many_bricks(scheme: str, shape: str) -> None:
    """Bricks and rows lie wholly inside; some were written, some are faint."""
    steps = tuple(((0.5 + 0.02 * i, 0.5, 0.5 - 0.03 * i), i != 1) for i in range(4))
    scene = scene_of(
        scheme, shape, size=(61, 62, 67), spacing=(0.1, 0.1, 0.1), ratio=28.0, steps=steps, fill="solid", alpha=0.9
    )  # fmt: skip
    cores, reference = on_every_path(scene)
    random = np.random.default_rng(3)
    for start, low, high in (((20, 20, 20), 0, 256), ((33, 17, 30), 1, 40), ((40, 40, 8), 100, 101)):
        values = random.integers(low, high, (13, 11, 17)).astype(np.uint8)
        box = tuple(slice(a, a + n) for a, n in zip(start, values.shape, strict=True))
        for core in cores:
            core.bone.write(values, start=start)
        reference.p[box] = reference.q[box] = values
    for center, (_, burr_on) in zip(scene.centers(), steps, strict=True):
        step_both(cores, reference, center, burr_on=burr_on)


@pytest.mark.parametrize("level", [31, 32])
@pytest.mark.parametrize("made_of", ["one level", "levels", "a block"])
@pytest.mark.parametrize("height", [6.4, 0.0])
def test_faint_levels_end_at_32(cpu_path: str, height: float, made_of: str, level: int) -> None:
    """The burr's centre is above the block or in it; bricks have one level or several."""
    levels = np.full((64, 64, 64), level, dtype=np.uint8)
    if made_of == "levels":  # every brick holds a voxel on the other side of the limit
        levels[::8, ::8, ::8] = 1 if level == 32 else 255
    origin = (-3.15, -3.15, -3.15)
    bone = VoxelBone(levels, spacing=0.1, origin=origin)
    if made_of == "a block":
        bone = VoxelBone.block((6.4, 6.4, 6.4), 0.1, origin=origin, level=level)
    contact = BurrContact(bone, Burr(4.0), materials["bone"], seed=1)
    for felt in (contact.probe((0.0, 0.0, height)), contact.step((0.0, 0.0, height), 1.0)):
        assert (felt.touching, felt.faint) == (True, level < 32)


@pytest.mark.parametrize("size", [(3, 21, 5), (2, 8, 16), (1, 1, 1)], ids=str)
@pytest.mark.parametrize("draw", [0, 1])
@pytest.mark.parametrize(
    "key", [(0x9E3779B97F4A7C15, 0x243F6A8885A308D3, 0x13198A2E), (LARGE, LARGE, 2**31 - 1)], ids=str
)
def test_draws(cpu_path: str, key: tuple[int, int, int], draw: int, size: tuple[int, int, int]) -> None:
    """Keys have different words or the largest ones; a volume may end within a block of numbers."""
    np.testing.assert_array_equal(_core.draws(size, *key, draw), draw_lanes(size, *key, draw))


# --- Against one another ------------------------------------------------------------------------------------


def long_run(path: str, scene: Scene, ticks: int) -> tuple[str, list[Any]]:
    """Digest and contacts of a winding path through the scene's bone."""
    _core.use_cpu_path(path)
    contact, _ = make_pair(scene)
    bone = contact.bone
    t = np.linspace(0.0, 1.0, ticks)[:, None]
    share = 0.5 + np.hstack([0.4 * np.cos(9 * t), 0.3 * np.sin(7 * t), 0.5 - 0.7 * t])
    felt = contact.run(bone.origin + share * (np.array(bone.shape[::-1]) - 1.0) * bone.spacing, scene.dt)
    assert felt.removed.sum() > 0.0
    assert contact.tick == scene.tick + ticks
    return bone.digest(), [getattr(felt, name).tolist() for name in COLUMNS]


@pytest.mark.skipif(len(PATHS) < 2, reason="this CPU has one path only")
@pytest.mark.parametrize(
    "fill", ["random", *(pytest.param(fill, marks=pytest.mark.slow) for fill in ("solid", "sparse"))]
)
@pytest.mark.parametrize("spacing", [(0.1, 0.1, 0.1), (0.1, 0.13, 0.08)], ids=["equal", "skew"])
@pytest.mark.parametrize(
    ("scheme", "shape", "alpha"),
    [("layer", "parabolic", 0.087), ("layer", "power(7.3)", 2.0), ("layer", "constant", 0.02), ("layer", "linear", 0.3),
     ("cell", "parabolic", 0.087), ("cell", "power(0.5)", 0.02), ("cell", "linear", 2.0), ("layer", tick_scenes.ALL_SHAPES[-3], 0.3), ("cell", tick_scenes.ALL_SHAPES[-1], 0.3)],
)  # fmt: skip
def test_two_hundred_ticks(
    scheme: str, shape: str, alpha: float, spacing: tuple[float, float, float], fill: str
) -> None:
    """Digests and all numbers of all contacts are equal to the last bit."""
    scene = scene_of(
        scheme, shape, size=(45, 52, 59), spacing=spacing, ratio=11.3, fill=fill, alpha=alpha, seed=7, tick=2**32 - 100
    )  # fmt: skip
    plainest = long_run(PATHS[0], scene, 200)
    for path in PATHS[1:]:
        assert long_run(path, scene, 200) == plainest, path


# --- Which one is used -------------------------------------------------------------------------------------

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
