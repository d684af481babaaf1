"""Descents into volumes with voxels that are not cubes, and into rotated volumes."""

import numpy as np
import pytest

import burrlab
from burrlab.bone.image import OccupancyMap, Volume

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")

BURR, BONE = burrlab.Burr(3.0), burrlab.materials["bone"]
PERMUTED = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # left-handed

TURNED = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]


def half_space_volume(voxel, axis, direction):
    """Volume with the bone of `half_space`, and entry and axis in its coordinates."""
    made = burrlab.half_space(BURR, voxel, axis=axis, offset=(0.03, 0.04, 0.02))
    bone = made.bone
    volume = Volume(bone.density, bone.spacing, direction @ bone.origin, direction, "half-space")
    return volume, {"entry": direction @ (made.surface - 5 * made.axis), "axis": direction @ made.axis}


def descent(volume, way, force=1.0, path=None):
    """A descent into a volume, after writing and reading it if a path is given."""
    if path is not None:
        burrlab.write_volume(path, volume)
        volume = burrlab.read_volume(path)
    specimen = volume.specimen(0, 255, **way)
    return burrlab.descend(BURR, BONE, force, specimen=specimen, seed=1, ideal=True)


@pytest.fixture(scope="module")
def straight():
    return descent(*half_space_volume(0.1, (0, 0, -1), np.eye(3)))


@pytest.mark.parametrize(
    ("axis", "force"), [((0, 0, -1), 1.0), ((-1, 0, 0), 2.0), ((1, 1, -1), 2.0), ((1, 2, 3), 1.0)]
)
def test_anisotropic_equals_isotropic(tmp_path, axis, force):
    found = [
        descent(*half_space_volume(voxel, axis, np.eye(3)), force, tmp_path / name).penetration_velocity
        for name, voxel in (("a.nrrd", 0.1), ("b.nii.gz", (0.1, 0.1, 0.2)))
    ]
    assert found[1] == pytest.approx(found[0], rel=0.05)  # measured: at most 1.7 %


@pytest.mark.parametrize("direction", [PERMUTED, np.diag([1.0, 1.0, -1.0])], ids=["permuted", "mirrored"])
def test_permuted_and_mirrored_volumes_give_the_same_bits(tmp_path, straight, direction):
    run = descent(*half_space_volume(0.1, (0, 0, -1), direction), path=tmp_path / "v.nrrd")
    np.testing.assert_array_equal(run.immersion, straight.immersion)
    np.testing.assert_array_equal(run.force, straight.force)


@pytest.mark.parametrize(("name", "direction"), [("v.nrrd", TURNED), ("v.mha", TURNED * (1, 1, -1))])
def test_a_turned_volume_gives_the_same_within_rounding(tmp_path, straight, direction, name):
    run = descent(*half_space_volume(0.1, (0, 0, -1), direction), path=tmp_path / name)
    # Rounding of the entry may change the loss of a voxel by one level; measured: 2e-6 mm.
    np.testing.assert_allclose(run.immersion, straight.immersion, rtol=0, atol=2e-5)
    assert run.penetration_velocity == pytest.approx(straight.penetration_velocity, rel=1e-4)


def test_bone_that_ends_with_the_volume_has_its_surface_at_the_face():
    volume, way = half_space_volume((0.1, 0.1, 0.4), (0, 0, -1), np.eye(3))
    assert volume.specimen(0, 255, **way).surface[2] == pytest.approx(0.0, abs=0.01 * 0.4)


def test_the_map_is_in_the_result():
    values = np.zeros((40, 50, 50), np.int16)
    values[:20] = 1000
    volume = Volume(values, (0.2, 0.2, 0.2), (0, 0, 0), np.eye(3), "slab").crop((0, 0, 0), (9.0, 9.9, 8))
    table = OccupancyMap.table([0, 500, 1000], [0, 0.2, 1])
    specimen = volume.specimen(table, entry=(4.5, 5, 7), axis=(0, 0, -1), spacing=0.3)
    run = burrlab.descend(burrlab.Burr(2.4), BONE, 1.0, specimen=specimen, seed=1, ideal=True)
    made = run.provenance["volume"]
    told = made["map"], made["voxel_mm"], made["volume_spacing_mm"]
    assert told == ("0:0,500:0.2,1000:1", [0.3] * 3, [0.2] * 3)
    assert "cropped to voxels" in made["notes"][0]
