"""The first camera on a trace: along the force at the first contact with bone."""

import numpy as np
import pytest
from page_scenes import nerve_trace
from session_scenes import ended, session_of

from burrlab import Burr, HandDevice, ScriptedDevice, VoxelBone, load_trace, materials
from burrlab.session.player import TracePlayer
from burrlab.view.camera import approach_view, surgeon_view, trace_approach


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
