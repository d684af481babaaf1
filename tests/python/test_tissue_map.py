"""Tissues as part of a bone's state: numbers, sums by tissue, digest, copies, files."""

import copy
import pickle
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from session_scenes import refused
from tick_scenes import assert_same_sums

from burrlab import Burr, BurrContact, Material, Tissue, Tissues, VoxelBone, _core, materials

BONE = materials["bone"]


def table(count: int = 3) -> Tissues:
    rows = [Tissue(f"tissue {i}", label=10 * i, c_e=1.0 + i, alpha=0.1 * i) for i in range(count)]
    return Tissues(rows, BONE)


def tissue_bone(shape: tuple[int, int, int] = (19, 21, 18), count: int = 3) -> tuple[VoxelBone, np.ndarray]:
    """Bone with random tissues in one half, one tissue in the other: mixed and uniform bricks."""
    random = np.random.default_rng(4)
    numbers = random.integers(0, count, shape).astype(np.uint8)
    numbers[:, :, 8:] = count - 1
    bone = VoxelBone(random.integers(0, 256, shape).astype(np.uint8), 0.2)
    bone.set_tissues(table(count), numbers)
    return bone, numbers


def test_numbers_come_back_and_sums_follow_every_change() -> None:
    bone, numbers = tissue_bone()
    np.testing.assert_array_equal(bone.tissue_numbers, numbers)
    for change in (
        lambda: None,
        lambda: bone.write(np.full((5, 9, 11), 77, np.uint8), (2, 3, 4)),
        lambda: bone.restore((bone.density // 2).astype(np.uint8)),
    ):
        change()
        assert_same_sums(bone, numbers)
    assert bone.removed_of("tissue 1") > 0
    bone.reset()
    assert_same_sums(bone, numbers)


def test_copies_and_pickles_carry_tissues() -> None:
    bone, numbers = tissue_bone()
    bone.restore((bone.density // 3).astype(np.uint8))
    for again in (bone.copy(), copy.deepcopy(bone), pickle.loads(pickle.dumps(bone))):
        assert (again.digest(), again.tissues) == (bone.digest(), bone.tissues)
        assert_same_sums(again, numbers)


def test_digest_tells_numbers_and_table_apart() -> None:
    bone, numbers = tissue_bone()
    plain, other, rows = VoxelBone(bone.pristine, 0.2), numbers.copy(), list(table())
    other[0, 0, 0] = (other[0, 0, 0] + 1) % 3
    critical = Tissue("tissue 2", label=20, c_e=3.0, alpha=0.2, critical=True)
    digests = {plain.digest(), bone.digest()}
    for tissues, given in (
        (table(), other),
        (Tissues([*rows[:2], critical], BONE), numbers),
        (Tissues(rows, Material("b", c_e=2.145, alpha=0.087, shape="linear")), numbers),
        (Tissues(rows, Material("b", c_e=2.145, alpha=0.087, force_exponent=2.0)), numbers),
        (Tissues(rows, Material("b", c_e=2.145, alpha=0.087, rate_exponent=1.0)), numbers),
    ):
        plain.set_tissues(tissues, given)
        digests.add(plain.digest())
    assert len(digests) == 7


def row(name: str = "a", label: int = 0, c_e: float = 1, alpha: float = 0) -> Tissue:
    return Tissue(name, label=label, c_e=c_e, alpha=alpha)


def numbered(numbers: np.ndarray) -> VoxelBone:
    bone = VoxelBone.block((1, 1, 1), 0.1)
    bone.set_tissues(table(), numbers)
    return bone


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Tissues([], BONE), "number of tissues must be 1 to 64, got 0"),
        (lambda: Tissues([row("")], BONE), "name of a tissue must not be empty"),
        (lambda: Tissues([row(), row(label=1)], BONE), "names of tissues must differ, got 'a' twice"),
        (lambda: Tissues([row(), row("b")], BONE), "labels of tissues must be different, got 0"),
        (lambda: Tissues([row(label=-1)], BONE), "label of 'a' must be zero or positive, got -1"),
        (lambda: Tissues([row(c_e=0)], BONE), "c_e of 'a' must be from 1/4096 to 1000"),
        (lambda: Tissues([row(c_e=float("nan"))], BONE), "c_e of 'a' must be from"),
        (lambda: Tissues([row(alpha=-1)], BONE), "alpha of 'a' must be zero or positive"),
        (lambda: Tissue("a", label=0, c_e=1, alpha=0, colour=(256, 0, 0)),
         "every part of a colour must be 0 to 255, got 256"),
        (lambda: numbered(np.full((10, 10, 10), 3, np.uint8)), "every tissue number must be below 3, got 3"),
        (lambda: numbered(np.zeros((2, 2, 2), np.uint8)), "must be uint8 and have the shape of the bone"),
        (lambda: numbered(np.zeros((10, 10, 10), np.int64)), "must be uint8 and have the shape of the bone"),
        (lambda: VoxelBone.block((1, 1, 1), 0.1).removed_of(0), "bone must have tissues"),
        (lambda: numbered(np.zeros((10, 10, 10), np.uint8)).removed_of("spleen"),
         "tissue must be a name or number of the bone's table"),
        (lambda: table().number("spleen"),
         "tissue must be one of tissue 0, tissue 1, tissue 2, got 'spleen'"),
    ],
)  # fmt: skip
def test_refused(make: Callable[[], object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make()


def test_a_packed_bone_is_the_same() -> None:
    bone, given = tissue_bone()
    faint = bone.read((0, 0, 0), bone.shape).copy()
    faint[:8, :, 8:], faint[8:, :, 8:] = 7, 0  # uniform bricks
    bone.write(faint)
    for one in (bone, VoxelBone(faint, (0.1, 0.2, 0.3), (1, 2, 3))):
        levels, numbers = _core.pack_bone(one)
        again = _core.unpack_bone(one.shape, one.spacing, one.origin, levels, one.tissues, numbers)
        center = np.array(one.origin) + 0.5 * np.array(one.spacing) * one.shape[::-1]
        for burred in (one, again):
            assert burred.removed == 0
            BurrContact(burred, Burr(1.2), BONE, seed=1).step(center, dt=1.0)
        if one.tissues is not None:
            assert_same_sums(again, given)
        assert (again.digest(), again.mass, again.removed > 0) == (one.digest(), one.mass, True)
    levels, numbers = _core.pack_bone(bone)
    strange = numbers.copy()
    strange[-1] = 3
    unpacked = partial(_core.unpack_bone, bone.shape, bone.spacing, bone.origin, levels, bone.tissues)
    refused(
        (lambda: unpacked(numbers[:-1]), "packed bricks must fill the shape"),
        (lambda: unpacked(numbers[:3]), "packed bricks must fill the shape"),
        (lambda: unpacked(strange), "every tissue number must be below 3"),
    )
