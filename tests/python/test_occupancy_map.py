"""Maps of grey values to occupancy."""

from __future__ import annotations

import numpy as np
import pytest

import burrlab
from burrlab.bone.image import OccupancyMap, Volume


def test_two_point_map():
    values = np.array([-100, 90, 91, 135, 179, 180, 30000])
    wanted = [0, 0, 3, 128, 252, 255, 255]
    for kind in (np.int16, np.int32, np.float32, np.float64):
        np.testing.assert_array_equal(OccupancyMap.two_point(90, 180).levels(values.astype(kind)), wanted)


def test_table():
    table = OccupancyMap.table([-10, 0, 10, 30], [0.2, 1.0, 0.0, 0.5])
    values = np.array([-50, -10, -5, 0, 5, 10, 20, 30, 99])
    wanted = np.interp(values, table.greys, table.occupancies)
    np.testing.assert_allclose(table.occupancy(values.astype(np.float64)), wanted, atol=1e-7)
    np.testing.assert_allclose(table.occupancy(values.astype(np.int8)), wanted, atol=1e-7)
    assert OccupancyMap.parse(table.text) == table
    assert OccupancyMap.parse("90:180") == OccupancyMap.two_point(90, 180)


def test_map_equals_the_plain_definition_on_random_values():
    values = np.random.default_rng(3).integers(-2000, 3000, 5000).astype(np.int16)
    wanted = np.rint(255 * np.clip((values - 150.0) / (1250.0 - 150.0), 0, 1))
    np.testing.assert_array_equal(OccupancyMap.two_point(150, 1250).levels(values), wanted)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: OccupancyMap.two_point(2, 1), "LO:HI with LO below HI, got 2:1"),
        (lambda: OccupancyMap.two_point(0, np.nan), "LO:HI with LO below HI"),
        (lambda: OccupancyMap.table([1], [0]), "two points or more"),
        (lambda: OccupancyMap.table([1, 2], [0]), "two points or more, .* got 2 and 1"),
        (lambda: OccupancyMap.table([1, 1], [0, 1]), "finite, increasing grey values"),
        (lambda: OccupancyMap.table([1, np.inf], [0, 1]), "finite, increasing grey values"),
        (lambda: OccupancyMap.table([1, 2], [0, 1.5]), "occupancies within 0 to 1"),
        (lambda: OccupancyMap.parse("1:2:3"), "must be LO:HI or GREY:OCCUPANCY"),
        (lambda: OccupancyMap.two_point(0, 1).levels(np.array([0.5, np.nan])), "values must be finite"),
    ],
)
def test_wrong_maps(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_map_that_is_none():
    volume = Volume(np.zeros((3, 4, 5)), (1, 1, 1), (0, 0, 0), np.eye(3), "empty")
    with pytest.raises(TypeError, match="map must be an OccupancyMap or two grey values, got 5 and None"):
        volume.to_bone(5)
    with pytest.raises(TypeError, match="map must be an OccupancyMap or two grey values"):
        volume.to_bone(OccupancyMap.two_point(0, 1), 2)


def test_the_map_is_in_the_result():
    values = np.zeros((40, 50, 50), np.int16)
    values[:20] = 1000
    volume = Volume(values, (0.2, 0.2, 0.2), (0, 0, 0), np.eye(3), "slab").crop((0, 0, 0), (9.0, 9.9, 8))
    table = OccupancyMap.table([0, 500, 1000], [0, 0.2, 1])
    specimen = volume.specimen(table, entry=(4.5, 5, 7), axis=(0, 0, -1), spacing=0.3)
    run = burrlab.descend(
        burrlab.Burr(2.4), burrlab.materials["bone"], 1.0, specimen=specimen, seed=1, ideal=True
    )
    made = run.provenance["volume"]
    assert (made["map"], made["voxel_mm"], made["volume_spacing_mm"]) == (
        "0:0,500:0.2,1000:1",
        [0.3] * 3,
        [0.2] * 3,
    )
    assert "cropped to voxels" in made["notes"][0]
