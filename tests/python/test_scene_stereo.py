"""Both eyes, as a picture twice as wide and side by side in one window."""

import numpy as np
import pytest
from session_scenes import small_bone
from view_scenes import carve, differing, open_scene, parcels, small_scene  # noqa: F401

pytestmark = pytest.mark.slow


def test_eyes_differ_but_not_at_the_focus(scene):
    alone = scene.picture()
    left, right = np.split(scene.stereo_picture(), 2, axis=1)
    assert differing(left, right).any()
    np.testing.assert_array_equal(scene.stereo_picture(swap=True), np.concatenate([right, left], axis=1))
    for half in np.split(scene.stereo_picture(0.0), 2, axis=1):
        assert differing(half, alone).mean() < 1e-3  # samples of an edge lie elsewhere
    np.testing.assert_array_equal(scene.picture(), alone)  # the camera is back in the middle


def test_both_eyes_follow_the_scene(scene):
    """After additions, removals and moves the window shows what a new picture of both eyes shows."""
    scene.set_stereo(True)
    before = scene.picture()
    scene.move_burrs([[1.0, -0.5, 1.5]], [True])
    scene.set_parcels(parcels(50))
    scene.update(scene.bone, carve(scene.bone, (-1.0, 0.5, 0.3)))
    both = scene.picture()
    assert both.shape == before.shape == (240, 320, 3)
    assert all(
        differing(*pair).any() for pair in zip(np.split(both, 2, 1), np.split(before, 2, 1), strict=True)
    )
    scene.plotter.window_size = (160, 240)
    assert differing(scene.stereo_picture(), both).mean() < 1e-3
    assert scene.picture().shape == (240, 160, 3)
    scene.set_stereo(False)
    alone = scene.picture()
    scene.set_parcels(None)
    assert differing(scene.picture(), alone).any()


def test_curves_and_legend_are_in_neither_eye_and_the_note_in_both():
    time = np.linspace(0, 1, 20)
    with open_scene(small_bone(), note="LPS assumed") as scene:
        scene.set_stereo(True)
        plain = scene.picture()
        scene.set_curves(time, time**2, time)
        np.testing.assert_array_equal(scene.picture(), plain)
        words = [scale.text.GetInput() for scale in (scene.scale, *scene._eyes.scales)]
    assert [text.split("\n")[0] for text in words] == ["LPS assumed"] * 3
