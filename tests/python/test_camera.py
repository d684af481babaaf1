"""Viewpoints: the surgeon's, along a trace's first contact, and two eyes whose pictures can be fused."""

import numpy as np
import pytest
from page_scenes import nerve_trace
from session_scenes import ended, session_of

from burrlab import Burr, HandDevice, ScriptedDevice, VoxelBone, load_trace, materials
from burrlab.session.player import TracePlayer
from burrlab.view.actors import round_value
from burrlab.view.camera import Viewpoint, approach_view, eyes, surgeon_view, trace_approach


def on_screen(view: Viewpoint, point, aspect=4 / 3, shift=0.0):
    """Place of a point in the picture, -1 to 1 from left to right and from bottom to top, by definition."""
    sight = np.subtract(view.focus, view.position) / view.distance
    right = np.cross(sight, view.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, sight)
    away = np.subtract(point, view.position)
    half = np.tan(np.deg2rad(view.angle) / 2) * (away @ sight)
    return np.array([away @ right / (half * aspect) - shift, away @ up / half])


@pytest.fixture
def block():
    return VoxelBone.block((20, 30, 10), 0.5, origin=(1.0, 2.0, 3.0))


@pytest.mark.parametrize("axis", [None, (0, 0, -1), (1, 0, 0), (0, -1, 0), (0.3, -0.5, 0.7)])
def test_the_whole_volume_is_seen(block, axis):
    view = surgeon_view(block, axis=axis)
    corners = (
        np.array(block.origin) - 0.25 + np.array(np.meshgrid([0, 20], [0, 30], [0, 10])).reshape(3, -1).T
    )
    drawn = np.array([on_screen(view, corner, aspect=1.0) for corner in corners])
    assert 0.4 < np.abs(drawn).max() < 1.25  # the volume fills the picture
    into = np.array((0, 0, -1) if axis is None else axis, float)
    sight = np.subtract(view.focus, view.position) / view.distance
    assert [sight @ into / np.linalg.norm(into), sight @ np.array(view.up)] == pytest.approx(
        [np.cos(np.deg2rad(28)), np.sin(np.deg2rad(28))]
    )


def test_the_entry_is_in_the_middle_and_its_width_fills_the_view(block):
    view = surgeon_view(block, (5, 6, 7), (0, 0, -2), width=12.0, tilt=0.0)
    np.testing.assert_allclose(on_screen(view, (5, 6, 7)), 0, atol=1e-12)
    np.testing.assert_allclose(on_screen(view, (5, 12, 7)), (0, 1), atol=1e-12)
    assert view.position[2] > 7


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, -1, 0), (0.6, 0.3, 0.4)])
def test_head_is_up_unless_one_looks_along_it(block, axis):
    view = surgeon_view(block, axis=axis)
    x, y = on_screen(view, np.array(view.focus) + (0, 0, 1))
    assert x == pytest.approx(0, abs=1e-12)
    assert y > 0


def test_eyes_agree_at_the_focus_and_part_behind_it(block):
    view = surgeon_view(block, (5, 6, 7), width=12.0)
    (left, left_shift), (right, right_shift) = eyes(view, 62.0, 4 / 3)
    assert np.linalg.norm(np.subtract(left.position, right.position)) == pytest.approx(
        62.0 * view.distance / 500.0
    )
    sight = np.subtract(view.focus, view.position) / view.distance
    for shift, place in ((0.0, 0.0), (2.0, 1.0), (-2.0, -1.0)):
        point = np.array(view.focus) + shift * sight
        one = on_screen(left, point, shift=left_shift)
        other = on_screen(right, point, shift=right_shift)
        assert np.sign(round(other[0] - one[0], 12)) == place  # behind the focus: uncrossed
        assert one[1] == pytest.approx(other[1], abs=1e-12)  # nothing is skewed: the same height
    (same, shift), _ = eyes(view, 0.0, 4 / 3)
    assert same.position == pytest.approx(view.position)
    assert shift == 0


@pytest.mark.parametrize(
    ("most", "rounded"),
    [(1.0, 1.0), (1.99, 1.0), (0.3, 0.2), (0.5, 0.5), (7.3, 5.0), (73.0, 50.0), (0.1, 0.1)],
)
def test_scale_and_marks_of_curves_are_round(most, rounded):
    assert round_value(most) == pytest.approx(rounded)


@pytest.mark.parametrize(
    ("view", "sentence"),
    [
        ({"axis": (0, 0, 0)}, "axis must be three finite numbers, not all zero"),
        ({"entry": (1, 2)}, "entry must be three finite numbers"),
        ({"entry": (0, 0, np.nan)}, "entry must be three finite numbers"),
        ({"width": 0}, "width must be positive and tilt finite, got 0 and 28"),
    ],
)
def test_refused(block, view, sentence):
    with pytest.raises(ValueError, match=sentence):
        surgeon_view(block, **view)


def played(tmp_path, bone, radius, device, seconds):
    """A player of the trace of a session."""
    record, tool = tmp_path / "trace.h5", (Burr(radius), materials["bone"])
    ended(session_of(bone, tool, device, seed=1, duration=seconds, wall_clock=False, record=record))
    return TracePlayer(load_trace(record))


def player(tmp_path, start, axis):
    """A player of a hand that pushes along an axis, from outside a block."""
    bone = VoxelBone.block((40, 40, 40), 0.2, origin=(-3.9, -3.9, -3.9))
    return played(tmp_path, bone, 1.5, HandDevice(start, into=axis, along=np.roll(axis, 1), push=1.0), 0.5)


@pytest.mark.parametrize("axis", [(0, 0, -1), (1, 0, 0), (0, -1, 0)])
def test_along_the_force_at_what_was_touched(tmp_path, axis):
    shown = player(tmp_path, -5.8 * np.array(axis, float), axis)
    found = trace_approach(shown)
    assert found.axis @ axis > 0.95
    centers = shown.trace.ticks["burr"]["center_mm"][shown.trace.ticks["burr"]["touching"] > 0]
    assert np.abs(centers - found.entry).max() <= found.width / 2
    view = approach_view(shown.bone, found)
    near = approach_view(shown.bone, found, width=found.width / 4)
    assert near.distance == pytest.approx(view.distance / 4)
    for one in (view, near):
        np.testing.assert_allclose(one.focus, found.entry)
        sight = np.subtract(one.focus, one.position) / one.distance
        assert sight @ found.axis == pytest.approx(np.cos(np.deg2rad(28)))


def test_as_bone_was_met_and_not_as_it_was_cut_sideways(tmp_path):
    """The burr goes down into a block, and then long along it."""
    shown = TracePlayer(load_trace(nerve_trace(tmp_path / "trace.h5")))
    forces = shown.trace.ticks["burr"]["force_N"].sum(axis=(0, 1))
    assert abs(forces[0]) > 0.4 * np.linalg.norm(forces)
    assert trace_approach(shown).axis @ (0, 0, -1) > 0.95


def test_from_above_where_no_bone_was_touched(tmp_path):
    shown = player(tmp_path, (0.0, 0.0, 500.0), (0, 0, -1))
    assert (trace_approach(shown), approach_view(shown.bone, None)) == (None, surgeon_view(shown.bone))
    assert approach_view(shown.bone, None, width=3.0) == surgeon_view(shown.bone, width=3.0)


def test_a_burr_larger_than_the_bone(tmp_path):
    """At contact its centre is farther from the bone than the bone is wide."""
    device = ScriptedDevice([0.0, 0.1], [(0.5, 0.5, 6.5), (0.5, 0.5, 6.4)])
    shown = played(tmp_path, VoxelBone.block((1.2, 1.2, 0.6), 0.2), 6.0, device, 0.1)
    found = trace_approach(shown)
    np.testing.assert_allclose(approach_view(shown.bone, found).focus, found.entry)
