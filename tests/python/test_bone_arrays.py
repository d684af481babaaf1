"""Arrays of a voxel bone: read-only copies of the whole, and copies of a box."""

import gc

import numpy as np
import pytest

from burrlab import Burr, BurrContact, VoxelBone, materials

SOLID = np.full((4, 5, 6), 255, dtype=np.uint8)


@pytest.mark.parametrize("name", ["density", "pristine"])
def test_arrays_are_read_only_copies_that_outlive_their_bone(name: str) -> None:
    levels = np.random.default_rng(1).integers(0, 256, (40, 41, 42)).astype(np.uint8)
    bone = VoxelBone(levels, 0.1)
    array = getattr(bone, name)
    assert (array.dtype, array.flags.c_contiguous, array.flags.writeable) == (np.uint8, True, False)
    with pytest.raises(ValueError, match="read-only"):
        array[0, 0, 0] = 1
    assert not np.shares_memory(array, getattr(bone, name))
    del bone
    gc.collect()
    _ = [np.full(levels.shape, 7, dtype=np.uint8) for _ in range(20)]  # would reuse freed memory
    np.testing.assert_array_equal(array, levels)


@pytest.mark.parametrize(
    ("start", "size"),
    [((0, 0, 0), (20, 30, 30)), ((7, 8, 9), (2, 1, 8)), ((19, 29, 29), (1, 1, 1)), ((3, 0, 5), (17, 16, 3))],
)
def test_read_is_a_part_of_the_dense_arrays(start: tuple[int, int, int], size: tuple[int, int, int]) -> None:
    """Each box has the centre of a dent in it."""
    levels = np.random.default_rng(1).integers(0, 256, (20, 30, 30)).astype(np.uint8)
    bone = VoxelBone(levels, 0.1)
    center = [0.1 * (a + n / 2) for a, n in zip(start[::-1], size[::-1], strict=True)]
    BurrContact(bone, Burr(1.0), materials["bone"], seed=1).erode(center, 10.0)
    np.testing.assert_array_equal(bone.pristine, levels)
    box = tuple(slice(a, a + n) for a, n in zip(start, size, strict=True))
    for pristine, whole in ((False, bone.density), (True, bone.pristine)):
        part = bone.read(start, size, pristine=pristine)
        assert part.dtype == np.uint8
        np.testing.assert_array_equal(part, whole[box])
    assert np.any(bone.read(start, size) < levels[box])


def test_read_of_an_empty_box() -> None:
    assert VoxelBone(SOLID, 0.1).read((4, 5, 6), (0, 0, 0)).shape == (0, 0, 0)
    assert VoxelBone(SOLID, 0.1).read((1, 1, 1), (3, 0, 2)).shape == (3, 0, 2)
