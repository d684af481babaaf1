"""Tissues as part of a bone's state: numbers, sums by tissue, digest, copies and files."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from burrlab import materials
from burrlab._core import Material, Tissue, Tissues, VoxelBone
from burrlab.bone.snapshot import load_bone, save_bone

BONE = materials["bone"]


def table(count: int = 3) -> Tissues:
    rows = [Tissue(f"tissue {i}", label=10 * i, c_e=1.0 + i, alpha=0.1 * i) for i in range(count)]
    return Tissues(rows, BONE)


def tissue_bone(shape: tuple[int, int, int] = (19, 21, 18), count: int = 3) -> tuple[VoxelBone, np.ndarray]:
    """Random numbers in one half, a single tissue in the other: mixed bricks and whole ones."""
    random = np.random.default_rng(4)
    numbers = random.integers(0, count, shape).astype(np.uint8)
    numbers[:, :, 8:] = count - 1
    bone = VoxelBone(random.integers(0, 256, shape).astype(np.uint8), 0.2)
    bone.set_tissues(table(count), numbers)
    return bone, numbers


def sums_hold(bone: VoxelBone, numbers: np.ndarray, count: int = 3) -> None:
    dv = np.prod(bone.spacing) / 255.0
    for number in range(count):
        here = numbers == number
        assert bone.mass_of(number) == pytest.approx(bone.density[here].sum() * dv, rel=1e-14)
        lost = bone.pristine[here].astype(int).sum() - bone.density[here].astype(int).sum()
        assert bone.removed_of(number) == pytest.approx(lost * dv, rel=1e-14, abs=1e-12)


def test_numbers_come_back_and_sums_follow_every_change() -> None:
    bone, numbers = tissue_bone()
    np.testing.assert_array_equal(bone.tissue_numbers, numbers)
    sums_hold(bone, numbers)
    bone.write(np.full((5, 9, 11), 77, np.uint8), (2, 3, 4))
    sums_hold(bone, numbers)
    bone.restore((bone.density // 2).astype(np.uint8))
    sums_hold(bone, numbers)
    assert bone.removed_of("tissue 1") > 0
    bone.reset()
    sums_hold(bone, numbers)


def test_copies_pickles_and_files_carry_tissues(tmp_path: Path) -> None:
    bone, numbers = tissue_bone()
    bone.restore((bone.density // 3).astype(np.uint8))
    save_bone(tmp_path / "bone.h5", bone, 12)
    loaded, tick = load_bone(tmp_path / "bone.h5")
    assert tick == 12
    for again in (bone.copy(), copy.deepcopy(bone), pickle.loads(pickle.dumps(bone)), loaded):
        assert again.digest() == bone.digest()
        assert again.tissues == bone.tissues
        sums_hold(again, numbers)
    with h5py.File(tmp_path / "bone.h5", "r+") as file:
        file["tissue"][3, 3, 3] = (file["tissue"][3, 3, 3] + 1) % 3
    with pytest.raises(ValueError, match="is damaged: the bone has digest"):
        load_bone(tmp_path / "bone.h5")


def test_digest_tells_numbers_and_table_apart() -> None:
    bone, numbers = tissue_bone()
    plain, other, rows = VoxelBone(bone.pristine, 0.2), numbers.copy(), list(table())
    other[0, 0, 0] = (other[0, 0, 0] + 1) % 3
    critical = [*rows[:2], Tissue("tissue 2", label=20, c_e=3.0, alpha=0.2, critical=True)]
    linear = Tissues(rows, Material("b", c_e=2.145, alpha=0.087, shape="linear"))
    digests = {plain.digest(), bone.digest()}
    for tissues, kept in ((table(), other), (Tissues(critical, BONE), numbers), (linear, numbers)):
        plain.set_tissues(tissues, kept)
        digests.add(plain.digest())
    assert len(digests) == 5


def test_names_numbers_and_repr() -> None:
    tissues, plain = table(), VoxelBone.block((1, 1, 1), 0.1)
    assert (len(tissues), tissues.number("tissue 2"), tissues[-1].name) == (3, 2, "tissue 2")
    assert [t.label for t in tissues] == [0, 10, 20]
    assert repr(tissues) == "Tissues(tissue 0, tissue 1, tissue 2)"
    assert pickle.loads(pickle.dumps(tissues)) == tissues
    assert (plain.tissues, plain.tissue_numbers) == (None, None)


def tissue(name: str = "a", **changes: Any) -> Tissue:
    return Tissue(name, **{"label": 0, "c_e": 1, "alpha": 0, **changes})


def numbered(numbers: np.ndarray) -> VoxelBone:
    bone = VoxelBone.block((1, 1, 1), 0.1)
    bone.set_tissues(table(), numbers)
    return bone


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Tissues([], BONE), "number of tissues must be 1 to 64, got 0"),
        (lambda: Tissues([tissue("")], BONE), "name of a tissue must not be empty"),
        (lambda: Tissues([tissue(label=i) for i in (0, 1)], BONE), "names of tissues must differ, got 'a' twice"),
        (lambda: Tissues([tissue(n, label=3) for n in "ab"], BONE), "labels of tissues must be different, got 3"),
        (lambda: Tissues([tissue(label=-1)], BONE), "label of 'a' must be zero or positive, got -1"),
        (lambda: Tissues([tissue(c_e=0)], BONE), "c_e of 'a' must be from 1/4096 to 1000"),
        (lambda: Tissues([tissue(c_e=float("nan"))], BONE), "c_e of 'a' must be from"),
        (lambda: Tissues([tissue(alpha=-1)], BONE), "alpha of 'a' must be zero or positive"),
        (lambda: numbered(np.full((10, 10, 10), 3, np.uint8)), "every tissue number must be below 3, got 3"),
        (lambda: numbered(np.zeros((2, 2, 2), np.uint8)), "must be uint8 and have the shape of the bone"),
        (lambda: numbered(np.zeros((10, 10, 10), np.int64)), "must be uint8 and have the shape of the bone"),
        (lambda: VoxelBone.block((1, 1, 1), 0.1).removed_of(0), "bone must have tissues"),
        (lambda: numbered(np.zeros((10, 10, 10), np.uint8)).removed_of("spleen"), "tissue must be a name or number of the bone's table"),
        (lambda: table().number("spleen"), "tissue must be one of tissue 0, tissue 1, tissue 2, got 'spleen'"),
        (lambda: tissue(colour=(256, 0, 0)), "every part of a colour must be 0 to 255, got 256"),
    ],
)  # fmt: skip
def test_refusals(make: Callable[[], object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make()
