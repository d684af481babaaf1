"""Voxel bone from Python: input of every type, copies, writing, mass and digest."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import burrlab
from burrlab._core import VoxelBone

INTEGERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
FLOATS = ("float16", "float32", "float64", "longdouble")
SOLID = np.full((4, 5, 6), 255, dtype=np.uint8)


def some_levels(shape: tuple[int, int, int] = (9, 10, 11)) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)


# --- Input ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [*INTEGERS, *FLOATS])
def test_levels_of_every_type(dtype: str) -> None:
    """Values lo..hi become 0..255, linear between, to nearest."""
    values = np.arange(120).reshape(4, 5, 6).astype(dtype)
    bone = VoxelBone(values, 0.1, range=(0, 119))
    np.testing.assert_array_equal(bone.density, np.rint(np.arange(120) / 119 * 255).reshape(4, 5, 6))
    np.testing.assert_array_equal(bone.pristine, bone.density)


@pytest.mark.parametrize("dtype", ["int16", "int64", "float32"])
def test_a_range_need_not_begin_at_zero(dtype: str) -> None:
    values = np.array([-100, 0, 50, 100], dtype=dtype).reshape(1, 1, 4)
    assert VoxelBone(values, 1.0, range=(-100, 100)).density.ravel().tolist() == [0, 128, 191, 255]


def test_default_ranges() -> None:
    levels = some_levels()
    np.testing.assert_array_equal(VoxelBone(levels, 0.1).density, levels)
    np.testing.assert_array_equal(VoxelBone(levels > 99, 0.1).density, np.where(levels > 99, 255, 0))
    np.testing.assert_array_equal(
        VoxelBone(levels.clip(0, 51), 0.1, range=(0, 51)).density, 5 * levels.clip(0, 51)
    )


@pytest.mark.parametrize("dtype", ["int8", "uint16", "int64", "float32", "float64"])
def test_other_types_must_state_their_range(dtype: str) -> None:
    with pytest.raises(
        ValueError, match=f"range must be given for densities of type {dtype}: the values of empty"
    ):
        VoxelBone(np.ones((2, 2, 2), dtype=dtype), 0.1)


@pytest.mark.parametrize("order", ["strided", "fortran", "reversed", "big-endian"])
@pytest.mark.parametrize("dtype", ["uint8", "int16", "float64"])
def test_any_memory_layout(dtype: str, order: str) -> None:
    values = some_levels((8, 9, 10)).astype(dtype)
    laid_out = {
        "strided": np.repeat(values, 2, axis=2)[:, :, ::2],
        "fortran": np.asfortranarray(values),
        "reversed": np.ascontiguousarray(values[::-1])[::-1],
        "big-endian": values.astype(values.dtype.newbyteorder(">")),
    }[order]
    np.testing.assert_array_equal(VoxelBone(laid_out, 0.1, range=(0, 255)).density, values)


def test_input_is_copied() -> None:
    levels = some_levels()
    bone = VoxelBone(levels, 0.1)
    before = bone.digest()
    levels[:] = 0
    assert bone.digest() == before


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("dtype", FLOATS)
def test_values_that_are_not_finite(dtype: str, value: float) -> None:
    values = np.ones((2, 3, 4), dtype=dtype)
    values[1, 2, 3] = value
    with pytest.raises(ValueError, match=f"every density must be finite, got {value}"):
        VoxelBone(values, 0.1, range=(0, 1))


@pytest.mark.parametrize(
    ("dtype", "value"), [("int16", -1), ("uint64", 101), ("float32", 100.5), ("uint8", 101)]
)
def test_values_out_of_range(dtype: str, value: float) -> None:
    values = np.zeros((2, 3, 4), dtype=dtype)
    values[0, 0, 0] = value
    with pytest.raises(
        ValueError, match=rf"every density must be within the range 0.* to 100.*, got {value}"
    ):
        VoxelBone(values, 0.1, range=(0, 100))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        *(({"density": np.ones(shape, np.uint8)}, rf"dimensions of density must be 3 \(z, y, x\), got {len(shape)}")
          for shape in ((8,), (2, 4), (2, 2, 2, 1))),
        *(({"density": np.ones(shape, np.uint8)}, "every side of the volume must be at least one voxel, got 0")
          for shape in ((0, 2, 2), (2, 0, 2), (2, 2, 0))),
        *(({"range": bounds}, "range must be two finite values, empty below solid")
          for bounds in ((1, 0), (1, 1), (np.nan, 1), (0, np.inf))),
        *(({"density": np.zeros((2, 2, 2), kind), "range": (0, 1)}, "density must be an array of integers or floats, got ")
          for kind in ("complex128", "<U1", "datetime64[s]")),
        *(({"spacing": spacing}, f"spacing must be positive and finite, got {got}$")
          for spacing, got in ((0.0, "0"), (-0.1, "-0.1"), (np.nan, "nan"), (np.inf, "inf"), ((0.1, 0.0, 0.1), "0"),
                               ((0.1, 0.1, -2), "-2"))),
        ({"origin": (0, np.nan, 0)}, "origin must be finite, got nan"),
    ],
)  # fmt: skip
def test_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        VoxelBone(**({"density": SOLID, "spacing": 0.1} | given))


def test_geometry() -> None:
    bone = VoxelBone(SOLID, (0.1, 0.2, 0.4), origin=(1, -2, 3))
    assert bone.shape == (4, 5, 6)
    assert bone.spacing == (0.1, 0.2, 0.4)
    assert bone.origin == (1.0, -2.0, 3.0)
    assert VoxelBone(SOLID, 1).spacing == (1.0, 1.0, 1.0)
    assert VoxelBone(SOLID, np.array([1, 2, 3])).spacing == (1.0, 2.0, 3.0)
    assert repr(bone) == "VoxelBone(shape=(4, 5, 6), spacing=(0.1, 0.2, 0.4) mm, mass=0.96 mm^3)"


def test_block() -> None:
    bone = VoxelBone.block((1.0, 0.95, 0.3), (0.1, 0.1, 0.2), origin=(1, 2, 3), level=100)
    assert bone.shape == (2, 10, 10)  # rounded up to whole voxels
    assert bone.origin == (1.0, 2.0, 3.0)
    assert np.all(bone.density == 100)
    with pytest.raises(ValueError, match="size must be positive and finite, got 0"):
        VoxelBone.block((1, 0, 1), 0.1)
    with pytest.raises(ValueError, match=r"spacing must be positive and finite, got -2$"):
        VoxelBone.block((1, 1, 1), (0.1, 0.1, -2))
    with pytest.raises(ValueError, match="level must be 0 to 255, got 256"):
        VoxelBone.block((1, 1, 1), 0.1, level=256)
    with pytest.raises(ValueError, match="voxels along a side must be below 1000000"):
        VoxelBone.block((1, 1, 1), 1e-7)


# --- Copies -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "duplicate",
    [VoxelBone.copy, copy.copy, copy.deepcopy, lambda bone: pickle.loads(pickle.dumps(bone))],
    ids=["copy", "copy.copy", "deepcopy", "pickle"],
)
def test_copies_are_equal_and_independent(duplicate: Any, eroded_bone: VoxelBone) -> None:
    bone = eroded_bone
    digest, removed = bone.digest(), bone.removed
    other = duplicate(bone)
    assert other is not bone
    assert other.digest() == digest
    assert (other.shape, other.spacing, other.origin) == (bone.shape, bone.spacing, bone.origin)
    assert (other.mass, other.removed) == (bone.mass, bone.removed)
    np.testing.assert_array_equal(other.density, bone.density)
    np.testing.assert_array_equal(other.pristine, bone.pristine)

    other.write(np.zeros((2, 2, 2), dtype=np.uint8), start=(3, 4, 5))
    assert (bone.digest(), bone.removed) == (digest, removed)
    other = duplicate(bone)
    bone.reset()
    assert other.digest() == digest
    assert bone.digest() != digest


# --- Writing, mass ----------------------------------------------------------------------------------------


def test_write_sets_present_and_pristine_levels(eroded_bone: VoxelBone) -> None:
    bone = eroded_bone
    present, pristine = bone.density.copy(), bone.pristine.copy()
    values = some_levels((3, 4, 5)).astype(np.int32)
    bone.write(values, start=(16, 14, 13), range=(0, 255))
    box = np.s_[16:19, 14:18, 13:18]
    present[box] = pristine[box] = values
    np.testing.assert_array_equal(bone.density, present)
    np.testing.assert_array_equal(bone.pristine, pristine)
    assert bone.mass == pytest.approx(present.sum(dtype=np.int64) / 255 * 0.001, rel=1e-12)
    lost = pristine.sum(dtype=np.int64) - present.sum(dtype=np.int64)
    assert bone.removed == pytest.approx(lost / 255 * 0.001, rel=1e-12)


@pytest.mark.parametrize(
    ("start", "text"),
    [
        ((3, 0, 0), r"along axis 0 \(z, y, x\) 2 voxels from 3 of 4"),
        ((0, 4, 0), r"along axis 1 \(z, y, x\) 2 voxels from 4 of 5"),
        ((0, 0, -1), r"along axis 2 \(z, y, x\) 2 voxels from -1 of 6"),
    ],
)
def test_write_outside(start: tuple[int, int, int], text: str) -> None:
    bone = VoxelBone(SOLID, 0.1)
    digest = bone.digest()
    with pytest.raises(ValueError, match=f"values must lie inside the volume: {text}"):
        bone.write(np.zeros((2, 2, 2), dtype=np.uint8), start=start)
    assert bone.digest() == digest


def test_write_of_bad_values() -> None:
    bone = VoxelBone(SOLID, 0.1)
    digest = bone.digest()
    with pytest.raises(ValueError, match="range must be given for densities of type float64"):
        bone.write(np.zeros((2, 2, 2)))
    with pytest.raises(ValueError, match="every density must be finite, got nan"):
        bone.write(np.full((2, 2, 2), np.nan), range=(0, 1))
    with pytest.raises(ValueError, match="dimensions of density must be 3"):
        bone.write(np.zeros((2, 2), dtype=np.uint8))
    assert bone.digest() == digest


def test_mass_removed_and_reset() -> None:
    bone = VoxelBone.block((3, 3, 2), 0.1)
    whole, fresh = bone.mass, bone.digest()
    assert whole == pytest.approx(18.0, rel=1e-12)
    assert bone.removed == 0.0
    contact = burrlab.BurrContact(bone, burrlab.Burr(1.0), burrlab.materials["bone"], seed=1)
    removed = sum(contact.step((1.5, 1.5, 2.4), 1.0).removed for _ in range(20))
    assert removed > 0
    assert bone.removed == pytest.approx(removed, rel=1e-12)
    assert bone.mass == pytest.approx(whole - removed, rel=1e-12)
    assert bone.mass == pytest.approx(bone.density.sum(dtype=np.int64) / 255 * 0.001, rel=1e-12)
    bone.reset()
    assert (bone.mass, bone.removed, bone.digest()) == (whole, 0.0, fresh)


# --- Digest -----------------------------------------------------------------------------------------------


def test_digest_is_a_function_of_content_and_geometry() -> None:
    levels = some_levels()
    digest = VoxelBone(levels, 0.1).digest()
    assert len(digest) == 32
    int(digest, 16)
    assert VoxelBone(levels.astype(np.float32), (0.1, 0.1, 0.1), (0, 0, 0), range=(0, 255)).digest() == digest
    changed = levels.copy()
    changed[8, 9, 10] ^= 1
    others = {
        VoxelBone(changed, 0.1).digest(),
        VoxelBone(levels, 0.2).digest(),
        VoxelBone(levels, (0.1, 0.1, 0.2)).digest(),
        VoxelBone(levels, 0.1, origin=(0, 0, 1)).digest(),
        VoxelBone(levels.reshape(10, 9, 11), 0.1).digest(),
        VoxelBone(levels[::-1], 0.1).digest(),
    }
    assert len(others | {digest}) == 7


def test_digest_holds_both_levels(eroded_bone: VoxelBone) -> None:
    """The same present levels with other pristine ones are another bone: `layer` erodes them otherwise."""
    bone = eroded_bone
    assert VoxelBone(bone.density, bone.spacing, bone.origin).digest() != bone.digest()
    again = VoxelBone(bone.pristine, bone.spacing, bone.origin)
    assert again.digest() != bone.digest()
    bone.reset()
    assert again.digest() == bone.digest()


def test_digest_knows_where_a_level_is() -> None:
    """One voxel at each place of two neighbouring bricks."""
    digests = set()
    for i in range(2 * 8**3):
        levels = np.zeros((8, 8, 16), dtype=np.uint8)
        levels.ravel()[i] = 1
        digests.add(VoxelBone(levels, 0.1).digest())
    assert len(digests) == 2 * 8**3


def test_a_write_far_outside_is_refused():
    bone = burrlab.VoxelBone.block((1, 1, 1), 0.25)
    for start in ((2**63 - 1, 0, 0), (0, -(2**63), 0), (0, 0, 4)):
        with pytest.raises(ValueError, match="values must lie inside the volume"):
            bone.write(np.zeros((1, 1, 1), np.uint8), start=start)


def test_single_precision_limits_and_a_tiny_range():
    bone = burrlab.VoxelBone(np.full((1, 1, 1), 0.1, np.float32), spacing=1, range=(0, 0.1))
    assert bone.density[0, 0, 0] == 255
    with pytest.raises(ValueError, match=r"within the range 0 to 1e-09, got 0\.5"):
        burrlab.VoxelBone(np.full((1, 1, 1), 0.5), spacing=1, range=(0, 1e-9))
    with pytest.raises(ValueError, match=r"empty below solid, got \(nan, 1\.0\)"):
        burrlab.VoxelBone(np.zeros((1, 1, 1)), spacing=1, range=(float("nan"), 1))


def test_a_block_too_large_is_refused_before_it_is_made():
    with pytest.raises(ValueError, match=r"7\.29e\+17 voxels needs 7\.58e\+08 GB of memory"):
        burrlab.VoxelBone.block((9e5, 9e5, 9e5), 1.0)
