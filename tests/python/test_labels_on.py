"""Labels brought on the voxels of another volume."""

from pathlib import Path

import numpy as np
import pytest
from label_scenes import MAP, TABLE, labels, volume

from burrlab import LabelVolume, Volume, write_volume
from burrlab.anatomy import labelled_bone
from burrlab.bone.recipe import LabelledRecipe, VolumeRecipe
from burrlab.session.network import make_bone

TURN = np.array([[0.36, -0.48, 0.8], [0.8, 0.6, 0.0], [-0.48, 0.64, 0.6]])  # orthonormal


def random(spacing: tuple[float, float, float], direction: np.ndarray | None = None) -> LabelVolume:
    values = np.random.default_rng(4).integers(0, 9, (9, 10, 11)).astype(np.uint16)
    return LabelVolume(
        values, spacing, (4.0, -5.0, 6.0), np.eye(3) if direction is None else direction, "random", {3: "x"}
    )


def grid_of(labels: LabelVolume, **changes: object) -> Volume:
    place = {"spacing": labels.spacing, "origin": labels.origin, "direction": labels.direction, **changes}
    return Volume(np.zeros(place.pop("shape", labels.shape)), path="grid", **place)  # type: ignore[arg-type]


@pytest.mark.parametrize("direction", [np.eye(3), TURN])
@pytest.mark.parametrize("spacing", [0.5, (0.3, 0.625, 0.4), 0.2])
def test_another_spacing_from_the_same_corner_is_resampling(spacing, direction) -> None:
    source = random((0.4, 0.5, 0.6), direction)
    expected = source.resample(spacing)
    found = source.on(expected)
    np.testing.assert_array_equal(found.labels, expected.labels)
    assert (found.labels.dtype, found.names) == (np.uint16, {3: "x"})
    assert found.notes == ("labels are the nearest of random on the voxels of random",)


def test_turned_voxels_are_found_by_their_place() -> None:
    """Each voxel's label equals that at its centre, looked up in patient coordinates."""
    source = random((0.4, 0.5, 0.6), TURN)
    other = np.array([[0.0, 1, 0], [0, 0, -1], [1, 0, 0]])
    place = {"spacing": np.array((0.45, 0.35, 0.3)), "origin": source.origin + (0.3, -0.2, 0.1)}
    grid = grid_of(source, direction=other, shape=(6, 7, 8), **place)
    found, known = source.on(grid).labels, 0
    for k, j, i in np.ndindex(6, 7, 8):
        point = grid.origin + grid.direction @ (np.array((i, j, k)) * grid.spacing)
        x, y, z = np.rint(source.direction.T @ (point - source.origin) / source.spacing).astype(int)
        inside = 0 <= x < 11 and 0 <= y < 10 and 0 <= z < 9
        assert found[k, j, i] == (source.labels[z, y, x] if inside else 0)
        known += inside
    assert 0 < known < found.size


def test_the_same_grid_and_one_elsewhere() -> None:
    turned, straight = random((0.4, 0.5, 0.6), TURN), random((0.4, 0.5, 0.6))
    np.testing.assert_array_equal(turned.on(grid_of(turned)).labels, turned.labels)
    half = straight.on(grid_of(straight, origin=(4, -5, 9.0)))
    assert (
        half.notes[-1] == "labels are the nearest of random on the voxels of grid, of which they cover 44.4 %"
    )
    np.testing.assert_array_equal(half.labels[:4], straight.labels[5:])
    assert not half.labels[4:].any()
    corner = straight.on(grid_of(straight, origin=(8, -0.5, 10.8)))
    assert corner.notes[-1].endswith("of which they cover less than 1 %")
    assert np.count_nonzero(corner.labels) <= 1


def test_finer_labels_of_a_volume(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    grey = volume()
    own = LabelVolume(labels(), grey.spacing, grey.origin, grey.direction, "own", {1: "Bone"})
    finer = own.resample(0.125)
    with pytest.raises(
        ValueError,
        match=r"must have the same geometry: .*; labels\.on\(volume\) \(--onto\) takes the nearest label",
    ):
        labelled_bone(grey, finer, TABLE, mapping=MAP)
    expected = labelled_bone(grey, own, TABLE, mapping=MAP).bone
    assert labelled_bone(grey, finer.on(grey), TABLE, mapping=MAP).bone.digest() == expected.digest()
    write_volume(tmp_path / "ct.nrrd", grey)
    write_volume(tmp_path / "finer.nrrd", finer)
    recipe = LabelledRecipe(
        str(tmp_path / "finer.nrrd"), TABLE, VolumeRecipe(str(tmp_path / "ct.nrrd"), MAP), onto=True
    )
    assert recipe.bone().digest() == expected.digest()
    assert any("labels are the nearest of" in note for note in recipe.notes())
    assert LabelledRecipe.of(recipe.plain()) == recipe
    assert make_bone(recipe.plain()).digest() == expected.digest()
