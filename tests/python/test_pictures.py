"""Pictures by matplotlib alone: their content is at its place in mm."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image, ImageSequence
from session_scenes import refused
from view_scenes import carve, cortex_and_nerve

import burrlab
from burrlab.view.film import write_video
from burrlab.view.pictures import (
    REMOVED,
    depth_map,
    plot_depth_map,
    plot_slices,
    removed_thickness,
    slice_image,
)

SPACING, ORIGIN = (0.1, 0.2, 0.4), (-1.0, 2.0, 5.0)


@pytest.fixture
def bone():
    """A full bone of two tissues, 30 x 20 x 10 voxels."""
    is_nerve = np.zeros((10, 20, 30), bool)
    is_nerve[4:6, 8:12] = True  # along x
    return cortex_and_nerve(
        burrlab.VoxelBone(np.full((10, 20, 30), 255, np.uint8), SPACING, ORIGIN), is_nerve
    )


@pytest.fixture(scope="module")
def crater():
    """A block of 6 x 6 x 3 mm, top at z = 0, with the crater of a burr of 2 mm radius."""
    made = burrlab.VoxelBone.block((6, 6, 3), 0.1, origin=(-2.95, -2.95, -2.95))
    carve(made, *((0.0, 0.0, z) for z in np.linspace(2.2, 0.8, 29)), radius=2.0, ticks=60)
    return made


def test_a_slice_is_the_plane_of_voxels_with_its_outer_faces(bone):
    image = slice_image(bone, (0.0, 4.1, 7.1), "yz")
    assert image.levels.shape == (10, 20)
    assert image.extent == pytest.approx((2.0 - 0.1, 2.0 + 19.5 * 0.2, 5.0 - 0.2, 5.0 + 9.5 * 0.4))
    assert image.position == pytest.approx(0.0)
    np.testing.assert_array_equal(image.pixels[5, 10], (240, 220, 20))  # rows are z, upwards
    np.testing.assert_array_equal(image.pixels[6, 10], (200, 190, 150))
    assert slice_image(bone, (99, 0, 0), "xz").position == pytest.approx(2.0)  # the outermost plane
    assert image.burr_radius((0.3, 0, 0), 0.5) == pytest.approx(0.4)
    assert image.burr_radius((0.6, 0, 0), 0.5) == 0


def test_planes_agree_where_they_meet(bone):
    carve(bone, (0.5, 4.0, 8.0), radius=1.7, ticks=50)
    point, index = (0.5, 4.0, 7.0), (15, 10, 5)
    images = {plane: slice_image(bone, point, plane) for plane in ("xy", "xz", "yz")}
    np.testing.assert_array_equal(images["xy"].pixels[index[1], :], images["xz"].pixels[index[2], :])
    np.testing.assert_array_equal(images["xy"].pixels[:, index[0]], images["yz"].pixels[index[2], :])
    np.testing.assert_array_equal(images["xz"].levels[:, index[0]], bone.density[:, index[1], index[0]])


def test_what_was_removed_has_a_colour_of_its_own(crater):
    pixels = slice_image(crater, (0, 0, -0.5), "xz").pixels
    assert [(pixels[row, 30] == REMOVED).all() for row in (-2, 2)] == [True, False]


def test_slices_have_units_outlines_and_a_legend(bone):
    axes = plot_slices(bone, (0.5, 4.0, 7.0), radii=[0.7])
    assert [a.get_xlabel() for a in axes] == ["x [mm]", "x [mm]", "y [mm]"]
    assert [a.get_ylabel() for a in axes] == ["y [mm]", "z [mm]", "z [mm]"]
    assert [a.get_title() for a in axes] == ["z = 7.00 mm", "y = 4.00 mm", "x = 0.50 mm"]
    for one in axes:
        (circle,) = [patch for patch in one.patches if isinstance(patch, Circle)]
        assert circle.radius == pytest.approx(0.7)
        assert one.get_aspect() == 1.0
    assert [text.get_text() for text in axes[0].figure.legends[0].get_texts()] == ["cortex", "nerve", "burr"]
    mine = Figure()
    drawn = plot_slices(bone, (0, 0, 0), radii=[0.5], centers=[(9, 9, 90)], ax=mine)
    assert drawn[0].figure is mine
    assert not any(axes.patches for axes in drawn), "a burr that meets no plane"


def test_depth_of_a_crater(crater):
    depth = depth_map(crater)
    assert depth.shape == (60, 60)
    y, x = np.indices(depth.shape) * 0.1 - 2.95
    cap = np.maximum(np.sqrt(np.maximum(4.0 - x**2 - y**2, 0)) - 0.8, 0)  # sphere at z = 0.8
    assert np.abs(depth - cap).max() < 0.25
    assert np.abs(depth - cap).mean() < 0.05  # half a voxel: the rim erodes slowly
    thickness = removed_thickness(crater)
    assert thickness.sum() * 0.1**2 == pytest.approx(crater.removed)
    np.testing.assert_allclose(thickness, removed_thickness(crater, axis="z"))


def test_depth_is_of_what_one_sees(bone):
    """A view through a hole ends at the far face; the view from behind has another depth."""
    levels = np.full((10, 10, 10), 255, np.uint8)
    levels[:, 3, 3] = 0
    assert depth_map(burrlab.VoxelBone(levels, 0.1)).max() == 0  # as it was
    hole = burrlab.VoxelBone.block((3, 3, 1), 0.1, origin=(0, 0, 0))
    carve(hole, (1.5, 1.5, 1.1), radius=0.5, ticks=2000)
    front, back = depth_map(hole), depth_map(hole, axis="z")
    assert front[15, 15] > 0.3
    assert back.max() == 0
    np.testing.assert_allclose(removed_thickness(hole, axis="x").sum(), hole.removed / 0.01, rtol=1e-9)
    assert depth_map(hole, axis="-y").shape == (10, 30)


def test_the_map_says_what_it_shows(crater):
    axes = plot_depth_map(crater)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "y [mm]")
    removed = f"{crater.removed:.1f} mm$^3$ removed"
    assert axes.get_title() == f"{removed}, {depth_map(crater).max():.2f} mm at most"
    untouched = plot_depth_map(burrlab.VoxelBone.block((2, 2, 2), 0.1))
    assert untouched.get_title() == "0.0 mm$^3$ removed, 0.00 mm at most"
    assert axes.get_xlim() == pytest.approx((-2.4, 2.4), abs=0.6)
    assert axes.child_axes[0].get_ylabel() == "depth along z [mm]"
    whole = plot_depth_map(crater, axis="x", thickness=True, crop=False, contours=0)
    assert whole.get_xlim() == pytest.approx((3.0, -3.0))  # along x, z upwards: y to the left
    assert whole.child_axes[0].get_ylabel() == "bone removed along x [mm]"


@pytest.mark.parametrize("axis", ["x", "-x", "y", "-y", "z", "-z"])
def test_depth_maps_are_not_mirror_images(crater, axis):
    """The right of a viewer along the axis, with the map's vertical up, is the right of the map."""
    across = "xyz".index(axis[-1])
    right, up = (k for k in range(3) if k != across)
    towards = np.cross(np.eye(3)[across] * (-1 if axis[0] == "-" else 1), np.eye(3)[up])
    assert plot_depth_map(crater, axis=axis).xaxis_inverted() == (towards[right] < 0)


def test_a_gif_keeps_the_colour_of_what_is_small(tmp_path):
    shades = np.linspace(0, 255, 640).astype(np.uint8)
    frame = np.tile((shades[:, None] * [1.0, 0.96, 0.85]).astype(np.uint8), (480, 1, 1))  # like shaded bone
    colours = [(244, 214, 49), (70, 90, 200), (91, 123, 91), (200, 120, 255)]
    for i, colour in enumerate(colours):
        frame[10 : 10 + 18, 20 * i : 20 * i + 18] = colour  # like a swatch of the legend
    assert write_video(tmp_path / "a.gif", [frame], fps=10) == 1
    with Image.open(tmp_path / "a.gif") as film:
        seen = np.asarray(film.convert("RGB")).astype(int)
    for i, colour in enumerate(colours):
        assert np.abs(seen[18, 20 * i + 9] - colour).max() < 12
    assert np.abs(seen - frame).mean() < 4


@pytest.mark.parametrize("fps", [1.0, 29.97, 35.0, 50.0])
def test_a_gif_lasts_as_long_as_its_frames(tmp_path, fps):
    """Each frame lasts whole hundredths of a second, none less than browsers show it."""
    frames = [np.full((16, 16, 3), 50 * (i % 4), np.uint8) for i in range(60)]
    assert write_video(tmp_path / "a.gif", frames, fps=fps) == 60
    with Image.open(tmp_path / "a.gif") as film:
        shown = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
    assert sum(shown) == pytest.approx(60 * 1000 / fps, abs=5)
    assert min(shown) >= 20
    assert max(shown) - min(shown) <= 10


def test_refused(bone):
    origin, axis = (0, 0, 0), "axis must be one of x, -x, y, -y, z, -z, got 'up'"
    refused(
        (lambda: slice_image(bone, origin, "zy"), "plane must be one of xy, xz, yz, got 'zy'"),
        (lambda: plot_slices(bone, (0, np.inf, 0)), "point must be three finite numbers"),
        (lambda: plot_slices(bone, origin, radii=[1, 2]), "centers must be one for each of 2 radii, got 0"),
        *(
            (lambda draw=draw: draw(bone, axis="up"), axis)
            for draw in (depth_map, removed_thickness, plot_depth_map)
        ),
        (lambda: depth_map(bone, level=0), "level must be from 1 to 255, got 0"),
        (lambda: plot_depth_map(bone, contours=-1), "contours must be zero or positive, got -1"),
    )
