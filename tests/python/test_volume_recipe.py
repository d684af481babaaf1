"""Recipes of bones from volumes are kept by JSON, results and their files."""

import json

import numpy as np
import pytest

from burrlab import (
    Burr,
    OccupancyMap,
    VelocityCurve,
    Volume,
    VoxelEngine,
    descend,
    force_sweep,
    materials,
    read_volume,
)
from burrlab.session.network import make_bone, volume_recipe
from burrlab.volume import VolumeRecipe, load_drilled, save_drilled, write_dicom

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
from volume_scenes import ASKEW, slab

BONE = materials["bone"]
MAP = OccupancyMap.two_point(0, 1)


def test_recipe_through_json(tmp_path):
    volume, _ = slab(tmp_path / "ct.nrrd")
    crop = (volume.origin.tolist(), (volume.origin + ASKEW @ (9, 9, 9)).tolist())
    table = OccupancyMap.table([-1000, 1000], [0.1, 0.9])
    recipe = volume_recipe(tmp_path / "ct.nrrd", table, crop=crop, voxel=(0.2, 0.2, 0.3), spacing=0.4)
    again = VolumeRecipe.of(json.loads(json.dumps(recipe)))
    assert again.plain() == recipe
    direct = read_volume(tmp_path / "ct.nrrd").crop(*crop).to_bone(table, spacing=(0.2, 0.2, 0.3))
    assert make_bone(json.loads(json.dumps(recipe))).digest() == direct.digest() == again.bone().digest()
    assert again.at(tmp_path / "ct.nrrd") == again


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"voxel": 0}, "voxel must be a positive number or three"),
        ({"crop": ((1, 2), (3, 4, 5))}, "crop must be three finite numbers"),
        ({"mapping": 0}, "map must be an OccupancyMap, such as"),
    ],
)
def test_parameters_that_are_wrong(options, match):
    with pytest.raises((ValueError, TypeError), match=match):
        volume_recipe("v.nrrd", **{"mapping": MAP, **options})


def test_a_picture_among_dicom_slices_is_ignored(tmp_path):
    image = pytest.importorskip("PIL.Image")
    values = np.full((3, 4, 5), 100, np.int16)
    write_dicom(tmp_path / "ct", Volume(values, (0.2, 0.3, 0.4), (0, 0, 0), np.eye(3), "made"))
    image.fromarray(np.zeros((4, 5), np.uint8)).save(tmp_path / "ct" / "preview.png")
    found = VolumeRecipe(tmp_path / "ct", MAP).volume()
    np.testing.assert_array_equal(found.values, values)
    save_drilled(tmp_path / "kept", found.to_bone(MAP), found, mapping=MAP)
    assert read_volume(tmp_path / "kept").shape == (3, 4, 5)
    assert load_drilled(tmp_path / "kept").bone.digest() == found.to_bone(MAP).digest()


def test_results_keep_how_the_bone_was_made(tmp_path):
    """Descent, curve and fit keep map, voxels and crop, also in files."""
    volume, _ = slab(tmp_path / "ct.nrrd")
    crop = (volume.origin.tolist(), (volume.origin + ASKEW @ (19, 19, 11)).tolist())
    recipe = VolumeRecipe(
        tmp_path / "ct.nrrd", OccupancyMap.table([-1000, 1000], [0.1, 0.9]), crop=crop, voxel=0.3
    )
    specimen = recipe.specimen(entry=volume.origin + ASKEW @ (10, 10, 11.5), axis=-ASKEW[:, 2])
    burr = Burr(2.4)
    run = descend(burr, BONE, 1.0, specimen=specimen, seed=1, ideal=True)
    curve = force_sweep(burr, BONE, [0.5, 1.0], specimen=specimen, seed=1)
    curve.to_csv(tmp_path / "curve.csv")
    for kept in (
        run.provenance,
        curve.provenance,
        VelocityCurve.from_csv(tmp_path / "curve.csv").provenance,
        VoxelEngine(voxel=0.3, specimen=specimen)._described(),
    ):
        made = json.loads(json.dumps(kept["volume"]))
        assert made["map"] == recipe.mapping.text
        assert made["volume_spacing_mm"] == pytest.approx([0.4] * 3)
        assert made["voxel_mm"] == [0.3] * 3
        assert any(note.startswith("cropped to voxels") for note in made["notes"])
        assert VolumeRecipe.of(made["recipe"]) == recipe
        assert make_bone(made["recipe"]).digest() == specimen.bone.digest()
