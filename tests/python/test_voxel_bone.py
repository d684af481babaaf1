"""Voxel bone from Python: input of every type, copies, writing, mass and digest."""

import copy
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from session_scenes import refused

from burrlab import Burr, BurrContact, VoxelBone, materials

INTEGERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
FLOATS = ("float16", "float32", "float64", "longdouble")
SOLID = np.full((4, 5, 6), 255, dtype=np.uint8)


def some_levels(shape: tuple[int, int, int] = (9, 10, 11)) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)


# --- Input ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [*INTEGERS, *FLOATS])
def test_levels_of_every_type(dtype: str) -> None:
    """Values lo to hi become 0 to 255: linear, rounded to nearest."""
    bone = VoxelBone(np.arange(120).reshape(4, 5, 6).astype(dtype), 0.1, range=(0, 119))
    np.testing.assert_array_equal(bone.density, np.rint(np.arange(120) / 119 * 255).reshape(4, 5, 6))
    np.testing.assert_array_equal(bone.pristine, bone.density)
    assert VoxelBone(bone.density, (0.1, 0.1, 0.1), (0, 0, 0)).digest() == bone.digest()


LEVELS = some_levels()


@pytest.mark.parametrize(
    ("values", "options", "levels"),
    [
        (LEVELS, {}, LEVELS), (LEVELS > 99, {}, np.where(LEVELS > 99, 255, 0)),
        (LEVELS.clip(0, 51), {"range": (0, 51)}, 5 * LEVELS.clip(0, 51)),
        *((np.array([[[-100, 0, 50, 100]]], kind), {"range": (-100, 100)}, [[[0, 128, 191, 255]]])
          for kind in ("int16", "int64", "float32")),
        (np.array([[[0.1]]], np.float32), {"range": (0, 0.1)}, [[[255]]]),  # a limit in single precision
    ],
)  # fmt: skip
def test_ranges(values: np.ndarray, options: dict[str, tuple[float, float]], levels: np.ndarray) -> None:
    np.testing.assert_array_equal(VoxelBone(values, 0.1, **options).density, levels)


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


def of_type(kind: str, value: float = 1) -> np.ndarray:
    return np.full((2, 2, 2), value, dtype=kind)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        *((partial(VoxelBone, of_type(kind), 0.1),
            f"range must be given for densities of type {kind}: the values of empty")
          for kind in ("int8", "uint16", "int64", "float32", "float64")),
        *((partial(VoxelBone, of_type(kind, value), 0.1, range=(0, 1)),
            f"every density must be finite, got {value}")
          for kind in FLOATS for value in (np.nan, np.inf, -np.inf)),
        *((partial(VoxelBone, of_type(kind, value), 0.1, range=(0, 100)), rf"every density must be within the range 0.* to 100.*, got {value}")
          for kind, value in (("int16", -1), ("uint64", 101), ("float32", 100.5), ("uint8", 101))),
        (partial(VoxelBone, of_type("float64", 0.5), 1, range=(0, 1e-9)), r"within the range 0 to 1e-09, got 0\.5"),
        *((partial(VoxelBone, np.ones(shape, np.uint8), 0.1), rf"dimensions of density must be 3 \(z, y, x\), got {len(shape)}")
          for shape in ((8,), (2, 4), (2, 2, 2, 1))),
        *((partial(VoxelBone, np.ones(shape, np.uint8), 0.1),
            "every side of the volume must be at least one voxel, got 0")
          for shape in ((0, 2, 2), (2, 0, 2), (2, 2, 0))),
        *((partial(VoxelBone, SOLID, 0.1, range=bounds), "range must be two finite values, empty below solid")
          for bounds in ((1, 0), (1, 1), (0, np.inf))),
        (partial(VoxelBone, SOLID, 0.1, range=(np.nan, 1)), r"empty below solid, got \(nan, 1\.0\)"),
        *((partial(VoxelBone, np.zeros((2, 2, 2), kind), 0.1, range=(0, 1)),
            "density must be an array of integers or floats, got ")
          for kind in ("complex128", "<U1", "datetime64[s]")),
        *((partial(VoxelBone, SOLID, spacing), f"spacing must be positive and finite, got {got}$")
          for spacing, got in ((0.0, "0"), (-0.1, "-0.1"), (np.nan, "nan"), (np.inf, "inf"), ((0.1, 0.0, 0.1), "0"),
                               ((0.1, 0.1, -2), "-2"))),
        (partial(VoxelBone, SOLID, 0.1, (0, np.nan, 0)), "origin must be finite, got nan"),
        (partial(VoxelBone, SOLID, 1e300), r"spacing must be 1e-6 to 1e6 mm, got 1e\+300"),
        (partial(VoxelBone, SOLID, 0.1, (0, 1e12, 0)), r"origin must be within 1e9 mm, got 1e\+12"),
        (partial(VoxelBone.block, (1, 0, 1), 0.1), "size must be positive and finite, got 0"),
        (partial(VoxelBone.block, (1, 1, 1), (0.1, 0.1, -2)), r"spacing must be positive and finite, got -2$"),
        (partial(VoxelBone.block, (1, 1, 1), 0.1, level=256), "level must be 0 to 255, got 256"),
        (partial(VoxelBone.block, (1, 1, 1), 1e-7), "voxels along a side must be below 1000000"),
        (partial(VoxelBone.block, (9e5, 9e5, 9e5), 1.0), r"7\.29e\+17 voxels needs 7\.58e\+08 GB of memory"),
        *((partial(VoxelBone.__setstate__, VoxelBone.__new__(VoxelBone), (*state, (1.0,) * 3, (0.0,) * 3)), said) for state, said in (
            ((of_type("uint8", 100), of_type("uint8", 101)),
             "density must be at most the pristine level, got 101 over 100"),
            ((of_type("uint8"), SOLID), "density and pristine of a pickled bone must have one shape"))),
    ],
)  # fmt: skip
def test_refused(call: Callable[[], object], text: str) -> None:
    refused((call, text))


BOX, OUTSIDE = (
    of_type("uint8", 0),
    r"values must lie inside the volume: along axis {} \(z, y, x\) {} voxels from {} of {}$",
)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        *((lambda bone, start=start: bone.write(BOX, start=start), OUTSIDE.format(*said)) for start, said in (
            ((3, 0, 0), (0, 2, 3, 4)), ((0, 4, 0), (1, 2, 4, 5)), ((0, 0, -1), (2, 2, -1, 6)),
            ((2**63 - 1, 0, 0), (0, 2, 2**63 - 1, 4)), ((0, -(2**63), 0), (1, 2, -(2**63), 5)), ((0, 0, 6), (2, 2, 6, 6)))),
        (lambda bone: bone.write(BOX.astype(float)), "range must be given for densities of type float64"),
        (lambda bone: bone.write(BOX * np.nan, range=(0, 1)), "every density must be finite, got nan"),
        (lambda bone: bone.write(BOX[0]), "dimensions of density must be 3"),
        *((lambda bone, start=start, size=size, now=now: bone.read(start, size, pristine=now), OUTSIDE.format(*said))
          for now in (False, True) for start, size, said in (
            ((3, 0, 0), (2, 1, 1), (0, 2, 3, 4)), ((0, 6, 0), (1, 0, 1), (1, 0, 6, 5)), ((0, 0, -1), (1, 1, 2), (2, 2, -1, 6)),
            ((0, 0, 0), (1, -1, 1), (1, -1, 0, 5)), ((2**63 - 1, 0, 0), (2, 1, 1), (0, 2, 2**63 - 1, 4)),
            ((0, 1, 0), (1, 2**63 - 1, 1), (1, 2**63 - 1, 1, 5)))),
    ],
)  # fmt: skip
def test_refused_boxes_leave_no_trace(call: Callable[[VoxelBone], object], text: str) -> None:
    bone = VoxelBone(SOLID, 0.1)
    digest = bone.digest()
    refused((lambda: call(bone), text))
    assert bone.digest() == digest


def test_geometry() -> None:
    bone = VoxelBone(SOLID, (0.1, 0.2, 0.4), origin=(1, -2, 3))
    assert (bone.shape, bone.spacing, bone.origin) == ((4, 5, 6), (0.1, 0.2, 0.4), (1.0, -2.0, 3.0))
    assert VoxelBone(SOLID, 1).spacing == (1.0, 1.0, 1.0)
    assert VoxelBone(SOLID, np.array([1, 2, 3])).spacing == (1.0, 2.0, 3.0)
    assert repr(bone) == "VoxelBone(shape=(4, 5, 6), spacing=(0.1, 0.2, 0.4) mm, mass=0.96 mm^3)"


def test_block() -> None:
    bone = VoxelBone.block((1.0, 0.95, 0.3), (0.1, 0.1, 0.2), origin=(1, 2, 3), level=100)
    assert (bone.shape, bone.origin) == ((2, 10, 10), (1.0, 2.0, 3.0))  # rounded up to whole voxels
    assert np.all(bone.density == 100)


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
    for name in ("shape", "spacing", "origin", "mass", "removed", "density", "pristine"):
        np.testing.assert_array_equal(getattr(other, name), getattr(bone, name), err_msg=name)

    other.write(np.zeros((2, 2, 2), dtype=np.uint8), start=(3, 4, 5))
    assert (bone.digest(), bone.removed) == (digest, removed)
    other = duplicate(bone)
    bone.reset()
    assert other.digest() == digest
    assert bone.digest() != digest


# --- Writing, mass ----------------------------------------------------------------------------------------


def test_write_takes_every_type_and_sets_both_levels(eroded_bone: VoxelBone) -> None:
    values = some_levels((3, 4, 5))
    eroded_bone.write(values.astype(np.int32), start=(16, 14, 13), range=(0, 255))
    for pristine in (False, True):
        np.testing.assert_array_equal(eroded_bone.read((16, 14, 13), (3, 4, 5), pristine=pristine), values)


def test_mass_removed_and_reset() -> None:
    bone = VoxelBone.block((3, 3, 2), 0.1)
    whole, fresh = bone.mass, bone.digest()
    assert whole == pytest.approx(18.0, rel=1e-12)
    assert bone.removed == 0.0
    contact = BurrContact(bone, Burr(1.0), materials["bone"], seed=1)
    removed = sum(contact.step((1.5, 1.5, 2.4), 1.0).removed for _ in range(20))
    assert removed > 0
    assert (bone.removed, bone.mass) == pytest.approx((removed, whole - removed), rel=1e-12)
    assert bone.mass == pytest.approx(bone.density.sum(dtype=np.int64) / 255 * 0.001, rel=1e-12)
    bone.reset()
    assert (bone.mass, bone.removed, bone.digest()) == (whole, 0.0, fresh)


# --- Digest -----------------------------------------------------------------------------------------------


def test_digest_depends_on_the_place_of_a_level() -> None:
    """Each place in two neighbouring bricks gives another digest."""
    each_place = np.eye(2 * 8**3, dtype=np.uint8).reshape(-1, 8, 8, 16)
    assert len({VoxelBone(levels, 0.1).digest() for levels in each_place}) == 2 * 8**3
