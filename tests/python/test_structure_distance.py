"""Distance to structures: search and field agree with the definition, spheres and planes."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from anatomy_scenes import BONE, nerve_bone

from burrlab._core import StructureDistance, StructureSearch, Tissue, Tissues, VoxelBone
from burrlab.anatomy.watch import structure_distances
from reference import anatomy as reference


def labelled(numbers, spacing, origin=(0.0, 0.0, 0.0)):
    bone = VoxelBone(np.full(numbers.shape, 255, np.uint8), spacing, origin)
    rows = [
        Tissue(f"tissue {i}", label=i, c_e=2.0, alpha=0.1, critical=i > 0)
        for i in range(int(numbers.max()) + 1)
    ]
    bone.set_tissues(Tissues(rows, BONE), numbers)
    return bone


@pytest.mark.parametrize("spacing", [(0.2, 0.2, 0.2), (0.1, 0.13, 0.31), (0.5, 0.2, 0.7)])
@pytest.mark.parametrize("share", [0.9995, 0.97, 0.3])
def test_search_finds_the_nearest_voxel(spacing, share) -> None:
    random = np.random.default_rng(3)
    shape, origin = (37, 43, 51), (-3.0, 2.0, 0.7)
    numbers = (random.random(shape) > share).astype(np.uint8)
    numbers[:17, 8:16, 16:24] = 1  # two whole bricks, and part of one
    numbers[32:, 40:, 48:] = 2  # a brick that the volume cuts
    bone = labelled(numbers, spacing, origin)
    size = np.array(spacing) * shape[::-1]
    points = origin + size * random.uniform(-0.6, 1.6, (150, 3))
    for number in (1, 2):
        want = reference.distance(points, numbers, number, spacing, origin)
        np.testing.assert_allclose(StructureSearch(bone, number).distance(points), want, rtol=0, atol=1e-12)


def test_a_search_does_not_depend_on_the_one_before() -> None:
    numbers = (np.random.default_rng(5).random((40, 40, 40)) > 0.999).astype(np.uint8)
    search = StructureSearch(labelled(numbers, 0.2), 1)
    points = np.random.default_rng(6).uniform(-1, 9, (200, 3))
    one_by_one = [float(search.distance(point)) for point in points]
    assert search.distance(points).tolist() == one_by_one
    assert search.distance(points[::-1])[::-1].tolist() == one_by_one


def test_a_sphere_centred_inside_is_at_minus_its_radius() -> None:
    nerve = nerve_field()
    assert nerve.of_sphere((0, 0, -1.5), 1.25) == -1.25
    assert nerve.of_sphere((0.4, 0, -1.5), 0.0) == pytest.approx(0.0, abs=1e-12)  # on its face


@pytest.mark.parametrize("spacing", [(0.2, 0.2, 0.2), (0.1, 0.1, 0.2), (0.15, 0.2, 0.35)])
def test_a_plane_and_a_sphere(spacing) -> None:
    shape = tuple(int(np.ceil(9 / step)) for step in spacing[::-1])
    z, y, x = np.meshgrid(
        *(np.arange(n) * step for n, step in zip(shape, spacing[::-1], strict=True)), indexing="ij"
    )
    numbers = (z < 2).astype(np.uint8)
    numbers[(x - 4.5) ** 2 + (y - 4.5) ** 2 + (z - 6) ** 2 <= 1.5**2] = 2
    top = np.ceil(2 / spacing[2] - 1e-9) * spacing[2] - spacing[2] / 2
    plane, sphere = structure_distances(labelled(numbers, spacing), [1, 2])
    at = np.random.default_rng(1).uniform([2, 2, top], [7, 7, top + 7], (300, 3))
    np.testing.assert_allclose(
        plane.of_sphere(at, 1.0), at[:, 2] - top - 1.0, rtol=0, atol=1e-6
    )  # a field is exact on planes
    far = np.linalg.norm(at - (4.5, 4.5, 6), axis=1)
    off = sphere.of_sphere(at, 0.5) - np.maximum(far - 1.5, 0.0) + 0.5
    # A sphere of voxels differs from a sphere by up to this much.
    assert np.abs(off).max() < np.linalg.norm(spacing) + 0.03


@pytest.mark.parametrize("spacing", [(0.2, 0.2, 0.2), (0.3, 0.3, 0.5)])
def test_the_field_errs_within_its_bounds_and_is_exact_near(spacing) -> None:
    random = np.random.default_rng(2)
    shape = (40, 44, 48)
    numbers = np.zeros(shape, np.uint8)
    for corner in random.integers(
        4, 36, (6, 3)
    ):  # several pieces: ridges between them are the field's worst case
        numbers[tuple(slice(c, c + 4) for c in corner)] = 1
    bone = labelled(numbers, spacing)
    (distance,) = structure_distances(bone, [1])
    points = np.array(spacing) * shape[::-1] * random.uniform(-0.3, 1.3, (20_000, 3))
    exact, field = StructureSearch(bone, 1).distance(points), distance.field(points)
    near = exact < 7.0
    assert near.sum() > 5000
    assert (exact - field)[near].max() < 0.8661 * 0.4
    assert (field - exact)[near & (exact > 1.0)].max() < 0.2
    for radius in (0.0, 1.0, 3.0, 5.0):
        said, want = distance.of_sphere(points, radius), exact - radius
        assert (said[want < 1.0] == want[want < 1.0]).all()
        assert (said[want >= 1.0] >= 1.0 - 0.8661 * 0.4).all()


def test_estimates_beyond_the_searched_nodes_err_by_less_than_stated() -> None:
    points = np.random.default_rng(8).uniform((-19, -19, -15), (19, 19, 12), (20_000, 3))
    exact, field = StructureSearch(nerve_bone(), 1).distance(points), nerve_field().field(points)
    inside = np.isfinite(field)
    assert inside.sum() > 15_000
    assert (exact[~inside] >= 15.0 - 1e-9).all()
    assert np.abs(field - exact)[inside].max() < 0.87


def test_fields_made_side_by_side_are_in_order_and_tell_their_progress() -> None:
    bone, told = nerve_bone(), []
    points = np.random.default_rng(2).uniform((-12, -12, -12), (12, 12, 12), (5_000, 3))
    fields = structure_distances(bone, [2, 1], told.append)
    assert told == [0.5, 1.0]
    for field, tissue in zip(fields, (2, 1), strict=True):
        assert (field.field(points) == structure_distances(bone, [tissue])[0].field(points)).all()


def test_who_asks_first_and_in_which_thread_changes_nothing() -> None:
    shared, alone = nerve_field(), nerve_field()
    points = np.random.default_rng(4).uniform((-12, -12, -12), (12, 12, 12), (20_000, 3))
    with ThreadPoolExecutor(4) as pool:
        several = list(
            pool.map(
                lambda turn: np.roll(shared.field(np.roll(points, turn, 0)), -turn), range(0, 20_000, 2500)
            )
        )
    want = alone.field(points[::-1])[::-1]
    assert all((found == want).all() for found in several)


def nerve_field():
    return structure_distances(nerve_bone(), [1])[0]


def field_of(**changes):
    values = {"estimate": np.zeros((4, 4, 4), np.float32), "spacing": 0.4, "origin": (0, 0, 0), "error": 0.5}
    return StructureDistance(StructureSearch(nerve_bone(), 1), **{**values, **changes})


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda: StructureSearch(VoxelBone.block((2, 2, 2), 0.2), 0),
         "bone must have tissues, got one of a single material"),
        (lambda: StructureSearch(nerve_bone(), 4), "tissue must be below 4, got 4"),
        (lambda: StructureSearch(nerve_bone(), 3), "structure must have voxels, 'unused' has none"),
        (lambda: StructureSearch(nerve_bone(), 1).distance((0.0, np.nan, 0.0)),
         "every point must be finite, got nan"),
        (lambda: StructureSearch(nerve_bone(), 1).distance((0.0, 1.0)), r"points must be \(x, y, z\) along their last axis"),
        (lambda: nerve_field().of_sphere((0, 0, 0), 7.0), "radius must be at most 6 mm, got 7"),
        (lambda: nerve_field().of_sphere((0, 0, 0), -1.0), "radius must be zero or positive"),
        (lambda: field_of(spacing=0.5), "spacing must be at most 0.4 mm, got 0.5"),
        (lambda: field_of(spacing=0.0), "spacing must be positive"),
        (lambda: field_of(error=-1.0), "error must be zero or positive"),
        (lambda: field_of(origin=(0, np.inf, 0)), "origin must be finite"),
        (lambda: field_of(estimate=np.zeros((1, 4, 4), np.float32)),
         "every side of a field must be at least 2, got 1"),
        (lambda: field_of(estimate=np.zeros((4, 4), np.float32)), "estimate must have 3 dimensions"),
    ],
)  # fmt: skip
def test_what_is_refused(ask, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        ask()
