"""Both eyes, as a pair of pictures and side by side in one window."""

import numpy as np
import pytest
from scene_pictures import SIZE, differing, open_scene, small_scene  # noqa: F401
from session_scenes import small_bone
from view_scenes import carve, parcels

pytestmark = pytest.mark.slow


def test_eyes_differ_but_not_at_the_focus(scene):
    scene.move_burrs([[0.0, 0.0, 3.0]])
    pair = scene.stereo_picture()
    assert pair.shape == (240, 640, 3)
    left, right = pair[:, :320], pair[:, 320:]
    assert differing(left, right).any()
    np.testing.assert_array_equal(scene.stereo_picture(swap=True), np.concatenate([right, left], axis=1))
    one, other = np.split(scene.stereo_picture(0.0), 2, axis=1)
    np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(scene.picture(), one)  # the camera is back in the middle


def test_both_eyes_in_one_window_are_those_of_the_pair(scene):
    """The two agree after additions, removals and moves too. Stereo off gives one picture again."""
    scene.set_stereo(True)
    scene.picture()
    scene.move_burrs([[1.0, -0.5, 1.5]], [True])
    scene.set_parcels(parcels(50))
    scene.update(scene.bone, carve(scene.bone, (-1.0, 0.5, 0.3)))
    pair = scene.picture()
    assert pair.shape == (240, 320, 3)
    assert scene.stereo
    scene.plotter.window_size = (160, 240)
    assert differing(scene.stereo_picture(), pair).mean() < 1e-3  # samples of an edge lie elsewhere
    scene.plotter.window_size = SIZE
    assert differing(scene.picture(), pair).mean() < 1e-3
    scene.set_stereo(True, swap=True)
    left, right = np.split(pair, 2, axis=1)
    assert differing(scene.picture(), np.concatenate([right, left], axis=1)).mean() < 1e-3
    scene.set_stereo(False)
    assert not scene.stereo
    one = scene.picture()
    assert differing(one, pair).any()
    scene.set_parcels(None)
    assert differing(scene.picture(), one).any()


def test_curves_and_legend_are_in_neither_eye():
    time = np.linspace(0, 1, 20)
    with open_scene(small_bone()) as scene:
        plain = scene.stereo_picture()
        scene.set_curves(time, time**2, time)
        np.testing.assert_array_equal(scene.stereo_picture(), plain)
        scene.set_stereo(True)
        shown = scene.picture()
        scene.set_curves(time[:1], time[:1], time[:1])
        np.testing.assert_array_equal(scene.picture(), shown)


def test_a_note_on_the_bone_stands_above_every_scale():
    with open_scene(small_bone(), [], note="LPS assumed") as scene:
        scene.picture()
        scene.stereo_picture()
        words = [scale.text.GetInput() for scale in (scene.scale, *scene._eyes.scales)]
    assert [text.split("\n")[0] for text in words] == ["LPS assumed"] * 3
