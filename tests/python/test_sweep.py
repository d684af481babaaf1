"""Force sweeps: seeds, executors, interrupts."""

import json
import multiprocessing
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from burrlab import Burr, Store, VoxelBone, descend, force_sweep, half_space, materials
from burrlab.common.study import Study
from burrlab.descent.sweep import SweepItem, item_seed, run_item, specimen_seed

BURR, BONE = Burr(3.0), materials["bone"]


def sweep(forces=(1.0, 1.5, 2.0), **options):
    return force_sweep(BURR, BONE, forces, **{"repeats": 2, "voxel": 0.4, "seed": 7, **options})


@pytest.fixture(scope="module")
def alone():
    return sweep()


def test_rows_do_not_depend_on_workers_or_order(alone):
    with ThreadPoolExecutor(1) as one, ProcessPoolExecutor(2) as many:
        for executor in (one, many):
            assert np.array_equal(sweep(executor=executor).velocity, alone.velocity)
    assert np.array_equal(np.sort(sweep(forces=(2.0, 1.5, 1.0)).velocity), np.sort(alone.velocity))
    assert len(set(alone.velocity)) == 6, "repeats differ"
    run = descend(BURR, BONE, 1.5, voxel=0.4, seed=item_seed(7, 1.5, 1), ideal=True)
    assert run.penetration_velocity == alone.velocity[3], "one can be rerun by itself"


def test_a_seed_keeps_its_meaning():
    """Other values would give other data for the seeds in recorded results."""
    assert (item_seed(7, 1.5, 1), specimen_seed(7)) == (8615454696755746968, 17559002276220262541)


def test_rig_sweep_and_specimen():
    specimen = half_space(BURR, 0.4)
    before = specimen.bone.digest()
    assert sweep(forces=(0.8,), repeats=1, ideal=False, specimen=specimen).status == ("ok",)
    assert specimen.bone.digest() == before, "descents work on copies"


# Descents of a few ticks, each on its copy of a bone of 24 MB.
PEAKS = """
import json
from concurrent.futures import ThreadPoolExecutor
import numpy as np
import burrlab

def peak():
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))

bone = burrlab.VoxelBone.block((32, 32, 24), 0.1, origin=(-16, -16, -24))
specimen = burrlab.Specimen(bone, np.zeros(3), np.array([0.0, 0.0, -1.0]), "a block")

def sweep(descents, workers):
    with ThreadPoolExecutor(workers) as pool:
        curve = burrlab.force_sweep(burrlab.Burr(3.0), burrlab.materials["bone"], [1.0], repeats=descents, seed=1,
                                    specimen=specimen, settings=burrlab.DescentSettings(max_duration=0.02), executor=pool)
    assert len(curve.status) == descents
    return peak()

print(json.dumps([peak(), sweep(1, 1), sweep(24, 1), sweep(24, 3)]))
"""


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="the peak of memory is read from Linux's /proc"
)
def test_memory_grows_with_workers_not_with_descents():
    """Peak memory of a separate process (ru_maxrss would begin at its parent's).

    If bones were kept, it would grow by 23 copies, then by 24 more. The allocator may keep one per thread.
    """
    process = subprocess.run([sys.executable, "-c", PEAKS], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    before, one, many, threefold = json.loads(process.stdout)  # [MB]
    a_copy = 240 * 320 * 320 / 2**20
    assert one - before > 0.5 * a_copy  # the measure sees a copy
    assert many - one < 4 * a_copy
    assert threefold - one < 8 * a_copy


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"forces": []}, ValueError, "at least one force"),
        ({"forces": [1.0, -1.0]}, ValueError, "every force must be positive"),
        ({"repeats": 0}, ValueError, "repeats must be at least 1"),
        ({"seed": None, "store": "none/s.jsonl"}, ValueError,
         "seed must be given with a store, which finds results by it, got None"),
        ({"specimen": "bone"}, TypeError, r"specimen must be a Specimen or have a method specimen\(burr, voxel"),
    ],
)  # fmt: skip
def test_bad_input(change, error, message):
    with pytest.raises(error, match=message):
        sweep(**change)


@dataclass(frozen=True)
class Fuller:
    """A source of specimens: half-spaces of a level drawn from the seed, with a note of each."""

    lowest: int
    notes: str

    def specimen(self, burr, voxel, *, depth, seed):
        with open(self.notes, "a") as file:
            file.write(f"{seed} {depth} {voxel}\n")
        specimen = half_space(burr, voxel, depth=depth)
        level = np.uint8(np.random.default_rng(seed).integers(self.lowest, 255))
        solid = specimen.bone.density > 0
        return replace(specimen, bone=VoxelBone(solid * level, specimen.bone.spacing, specimen.bone.origin))


def test_each_descent_draws_a_specimen_of_its_own(tmp_path):
    source = Fuller(120, str(tmp_path / "here"))
    curve = sweep(repeats=3, specimen=source)
    assert set(curve.status) == {"ok"}
    drawn = [line.split() for line in (tmp_path / "here").read_text().splitlines()]
    assert (len({seed for seed, _, _ in drawn}), {tuple(rest) for _, *rest in drawn}) == (9, {("1.0", "0.4")})
    assert "Fuller(lowest=120" in curve.provenance["specimen"]
    one = SweepItem(BURR, BONE, 1.5, item_seed(7, 1.5, 2), 0.4, 1.0, "layer", True, source, None, 120.0)
    assert run_item(one)[0] == curve.velocity[5], "one can be rerun by itself"
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert np.array_equal(sweep(repeats=3, specimen=source, executor=pool).velocity, curve.velocity)


def test_an_interrupted_sweep_goes_on_from_its_store(tmp_path, monkeypatch):
    path, notes = tmp_path / "s.jsonl", tmp_path / "notes"
    options = {"repeats": 8, "specimen": Fuller(120, str(notes)), "store": path}
    finished, keep = [], Study._keep

    def stop_after_two(study, i, row):
        keep(study, i, row)
        finished.append(i)
        if len(finished) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(Study, "_keep", stop_after_two)
    done = 24 - sweep(**options).status.count("interrupted")
    assert 2 <= done == len(Store(path)) < 24
    monkeypatch.undo()
    notes.unlink()
    curve = sweep(**options)
    assert len(notes.read_text().splitlines()) == 24 - done, "only what is missing"
    assert "interrupted" not in curve.status
    whole = sweep(repeats=8, specimen=options["specimen"])
    assert np.array_equal(whole.velocity, curve.velocity, equal_nan=True)
    assert whole.status == curve.status


def test_a_store_tells_specimens_apart(tmp_path):
    store = Store(tmp_path / "s.jsonl")
    given = half_space(BURR, 0.4)
    bone = given.bone.copy()
    bone.write(np.full(bone.shape, 200, np.uint8))
    moved = replace(given, surface=given.surface + [0.1, 0, 0])
    for i, specimen in enumerate([None, given, replace(given, bone=bone), moved], start=1):
        for _ in range(2):
            sweep(forces=(1.0,), repeats=1, specimen=specimen, store=store)
            assert len(store) == i
