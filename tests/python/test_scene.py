"""The drawn scene shows its content, to both eyes too, and follows sessions and traces."""

import shutil
import signal
import subprocess

import numpy as np
import pytest
from session_scenes import refused, small_bone, tools
from view_scenes import (  # noqa: F401
    SIZE,
    carve,
    differing,
    need_drawing,
    open_scene,
    parcels,
    small_scene,
    write_trace,
)

import burrlab
from burrlab.view import LiveView, Scene, TraceView, surgeon_view, write_video
from burrlab.view.actors import parcel_colours
from burrlab.view.surface import BONE, surface_blocks

pytestmark = pytest.mark.slow


def test_a_burr_is_drawn_where_it_is_and_as_large(scene):
    before = scene.picture()
    assert before.shape == (240, 320, 3)
    scene.move_burrs([[1.0, -0.5, 1.5]], [True])
    rows, columns = np.nonzero(differing(scene.picture(), before))
    pixel = 8.0 / 240  # [mm] at the height of the focus; the burr is 1.5 mm nearer
    distance = scene.viewpoint.distance
    nearer = distance / (distance - 1.5)
    assert (columns.mean() - 159.5) * pixel == pytest.approx(1.0 * nearer, abs=0.1)
    assert (119.5 - rows.mean()) * pixel == pytest.approx(-0.5 * nearer, abs=0.1)
    assert np.ptp(columns) * pixel == pytest.approx(2.0 * nearer, rel=0.08)
    scene.radii = (0.5,)
    scene.move_burrs([[1.0, -0.5, 1.5]], [True])
    columns = np.nonzero(differing(scene.picture(), before))[1]
    assert np.ptp(columns) * pixel == pytest.approx(1.0 * nearer, rel=0.08)
    scene.move_burrs([[np.nan] * 3])
    assert not differing(scene.picture(), before).any()


def test_a_burr_inside_the_bone_is_outlined_where_that_is_asked_for(scene):
    """Only its rim is drawn, a circle of its radius about its centre."""
    hidden = [[0.5, 0.0, -1.2]]
    before = scene.picture()
    scene.move_burrs(hidden, [True])
    assert not differing(scene.picture(), before).any()
    with open_scene(scene.bone, chart=False, outline=True) as outlined:
        outlined.look(scene.viewpoint)
        assert not differing(outlined.picture(), before).any()  # no place is known yet
        outlined.move_burrs(hidden, [True])
        rows, columns = np.nonzero(differing(outlined.picture(), before))
        outlined.radii = (np.nan,)  # not known: a cross
        outlined.move_burrs(hidden)
        cross = np.nonzero(differing(outlined.picture(), before))
        assert 2 * np.ptp(cross[1]) < np.ptp(columns)
        assert abs(cross[1].mean() - columns.mean()) < 1.5
        outlined.move_burrs([[np.nan] * 3])
        assert not differing(outlined.picture(), before).any()
    distance = scene.viewpoint.distance
    pixel = 8.0 / 240 * (distance + 1.2) / distance
    x, y = (columns - 159.5) * pixel, (119.5 - rows) * pixel
    np.testing.assert_allclose(np.hypot(x - 0.5, y), 1.0, atol=0.12)
    assert len(np.unique(np.arctan2(y, x - 0.5).round(1))) > 40  # all around


def test_an_update_draws_what_a_new_scene_draws(scene):
    bone, seen = scene.bone, scene.picture()
    assert 0 < scene.update(bone, carve(bone, (-1.0, 0.5, 0.3))) < len(scene.surface.blocks) + 1
    updated = scene.picture()
    assert differing(updated, seen).any()
    with open_scene(bone, chart=False) as anew:
        anew.look(scene.viewpoint)
        np.testing.assert_array_equal(anew.picture(), updated)


def test_what_is_hidden_is_not_drawn_and_not_missed(monkeypatch):
    """Of a bone of many triangles, here of any. Cutting and turning shows what was hidden before."""
    bone = burrlab.VoxelBone.block((9.6, 9.6, 9.6), 0.1, origin=(0, 0, 0))
    with open_scene(bone, chart=False) as scene, open_scene(bone, chart=False) as whole:
        for turn, at in enumerate(((4.75, 4.75, 9.55), (4.75, 9.55, 4.75))):
            changed = carve(bone, (4.0, 5.0, 9.0)) if turn else []
            pictures = []
            for one, least in ((scene, 0), (whole, 1e9)):
                monkeypatch.setattr("burrlab.view.scene._MANY", least)
                one.update(bone, changed)
                one.look(surgeon_view(bone, at, np.subtract((4.75, 4.75, 4.75), at), width=14.0))
                pictures.append(one.picture())
            shown = [actor.GetVisibility() for actor in scene.actors.actors.values()]
            assert 0 < sum(shown) < 0.8 * len(scene.surface.blocks)
            assert differing(*pictures).sum() < 10


def test_ctrl_c_while_a_picture_is_drawn_is_raised_after_it(scene):
    """VTK calls functions of pyvista while it draws, and forgets what they raise."""
    scene.plotter.renderer.AddObserver("StartEvent", lambda *_: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        scene.picture()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_particles_slices_and_curves_are_seen(scene):
    plain = scene.picture()
    scene.set_parcels(parcels(50))
    assert differing(scene.picture(), plain).sum() > 50
    scene.set_parcels(None)
    assert not differing(scene.picture(), plain).any()
    scene.set_slices((0.0, 0.0, -1.0))
    assert differing(scene.picture(), plain)[:, 250:].mean() > 0.5
    scene.set_slices(None)
    assert not differing(scene.picture(), plain).any()


@pytest.mark.parametrize("shape", [(30, 30, 1), (1, 30, 30), (30, 1, 30), (1, 1, 1)])
def test_slices_of_one_row_are_seen(shape):
    bone = burrlab.VoxelBone(np.full(shape, 255, np.uint8), 0.2)
    with open_scene(bone, [], size=(640, 480), chart=False) as scene:
        scene.set_slices((0.0, 0.0, 0.0))
        panels = scene.picture()[:, 475:].reshape(3, 160, -1, 3).astype(int)
    assert ((np.abs(panels - BONE).max(axis=3) < 12).sum(axis=(1, 2)) > 50).all()


def test_a_chart_appears_with_its_values():
    time = np.linspace(0, 1, 20)
    with open_scene(small_bone()) as scene:
        plain = scene.picture()
        scene.set_curves(time[:1], time[:1], time[:1])
        assert not differing(scene.picture(), plain).any()
        scene.set_curves(time, time**2, time)
        changed = differing(scene.picture(), plain)
    assert changed[160:, :100].any()
    assert not changed[:120].any()


def test_refused_by_the_scene(scene):
    bone = scene.bone
    few = np.zeros(0, [("position", "f8", 3), ("radius", "f8"), ("dust", "i8")])
    refused(
        (lambda: Scene(bone, [0.0], off_screen=True), "radii must be positive and finite, got 0"),
        (
            lambda: Scene(bone, [], off_screen=True, size=(8, 100)),
            "size must be at least 16 pixels each way, got 8 x 100",
        ),
        (lambda: Scene(bone, [], off_screen=True, level=0), "level must be from 1 to 255, got 0"),
        (lambda: scene.move_burrs(np.zeros((2, 3))), r"centers must have the shape \(1, 3\), got \(2, 3\)"),
        (lambda: scene.set_parcels(few), "blood, water is missing"),
        (lambda: scene.set_slices((0, 0, np.nan)), "point must be three finite numbers"),
        (lambda: scene.stereo_picture(-1), "separation must be zero or positive and finite, got -1"),
        (
            lambda: scene.update(burrlab.VoxelBone.block((1, 1, 1), 0.1)),
            "bone must have the shape of the surface",
        ),
    )


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


def holds(scene, bone):
    """Whether the scene draws the surface of this bone."""
    drawn, fresh = scene.surface.blocks, surface_blocks(bone)
    return fresh.keys() == drawn.keys() and all(
        np.array_equal(drawn[block].points, made.points) for block, made in fresh.items()
    )


def test_a_view_of_a_trace_holds_its_bone(tmp_path):
    need_drawing()
    digest = write_trace(tmp_path / "session.h5")
    trace = burrlab.load_trace(tmp_path / "session.h5")
    view = TraceView(trace, off_screen=True, size=SIZE, slices=True)
    assert view.go(trace.duration) > 0
    assert view.player.bone.digest() == digest
    assert holds(view.scene, view.player.bone)
    assert view.scene._burrs.balls[0].GetPosition() == pytest.approx(trace.ticks["burr"]["center_mm"][-1, 0])
    frames = list(view.frames(fps=5.0, start=0.0, stop=0.4, stereo=True))
    assert (len(frames), frames[0].shape) == (3, (240, 640, 3))
    assert differing(frames[0], frames[-1]).any()
    refused(
        (lambda: next(view.frames(fps=0)), "fps must be positive and finite, got 0"),
        (lambda: next(view.frames(stop=99.0)), "start and stop must lie from 0 to"),
        (lambda: view.go(99.0), "seconds must be from 0 to"),
        (lambda: TraceView(small_bone(), off_screen=True), None, TypeError),
    )
    view.close()


def test_a_live_view_ends_with_the_bone_of_the_session():
    need_drawing()
    device = burrlab.HandDevice(start=(0.0, 0.0, 2.2), strokes_after=0.0)
    session = burrlab.Session(small_bone(), tools(1)[0], device, seed=1, duration=2.0)
    view = LiveView(session, off_screen=True, size=SIZE, slices=True)
    first = view.scene.picture()
    with session:
        while not session.wait(0.3):
            view.step()
    view.step()
    assert differing(first, view.scene.picture()).any()
    bone, tick = session.snapshot()
    assert (view.bone.digest(), view.tick) == (bone.digest(), tick)
    assert bone.removed > 0
    assert holds(view.scene, bone)
    assert view.scene._burrs.balls[0].GetVisibility()
    refused(
        (lambda: view.run(rate=0), "rate must be positive and finite, got 0"),
        (lambda: LiveView(small_bone(), off_screen=True), "source must be a Session or a Replica, got VoxelBone", TypeError),
    )  # fmt: skip
    view.close()


def test_blood_outweighs_and_nothing_is_grey():
    some = parcels(4)
    some["dust"], some["blood"], some["water"] = (100, 0, 0, 100), (0, 100, 0, 100), (0, 0, 100, 0)
    colours = parcel_colours(some).astype(int)
    assert (colours[1].argmax(), colours[2].argmax()) == (0, 2)
    assert np.abs(colours[3] - colours[1]).sum() < np.abs(colours[3] - colours[0]).sum()
    some["dust"] = some["blood"] = some["water"] = 0
    assert (parcel_colours(some) == parcel_colours(some)[0]).all()


def test_an_mp4_is_read_by_ffmpeg(tmp_path):
    if shutil.which("ffmpeg") is None or shutil.which("ffprobe") is None:
        pytest.skip("ffmpeg is not installed")
    frames = [np.full((64, 81, 3), 20 * i, np.uint8) for i in range(10)]
    assert write_video(tmp_path / "a.mp4", frames, fps=25.0) == 10
    said = subprocess.run(
        ["ffprobe", "-v", "error", "-count_frames", "-show_entries", "stream=width,height,nb_read_frames,r_frame_rate",
         "-of", "csv=p=0", str(tmp_path / "a.mp4")], capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert said.strip() == "80,64,25/1,10"
