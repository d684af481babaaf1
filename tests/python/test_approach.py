"""The first camera on a trace: along the force at the first contact with bone."""

import numpy as np
import pytest
from page_scenes import nerve_trace

import burrlab
from burrlab.session.player import TracePlayer
from burrlab.view.camera import approach_view, surgeon_view, trace_approach


def player(tmp_path, start, axis):
    """A player of a hand that pushes along an axis, from outside a block."""
    bone = burrlab.VoxelBone.block((40, 40, 40), 0.2, origin=(-3.9, -3.9, -3.9))
    hand = burrlab.HandDevice(start, into=axis, along=np.roll(axis, 1), push=1.0)
    tool, record = (burrlab.Burr(1.5), burrlab.materials["bone"]), tmp_path / "trace.h5"
    with burrlab.Session(
        bone, tool, hand, seed=1, duration=0.5, clock=burrlab.Clock(wall_clock=False), record=record
    ) as session:
        session.wait()
    return TracePlayer(burrlab.load_trace(record))


@pytest.mark.parametrize("axis", [(0, 0, -1), (1, 0, 0), (0, -1, 0)])
def test_along_the_force_at_what_was_touched(tmp_path, axis):
    shown = player(tmp_path, -5.8 * np.array(axis, float), axis)
    found = trace_approach(shown)
    assert found.axis @ axis > 0.95
    touched = shown.trace.ticks["burr"]["touching"] > 0
    centers = shown.trace.ticks["burr"]["center_mm"][touched]
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
    shown = TracePlayer(burrlab.load_trace(nerve_trace(tmp_path / "trace.h5")))
    forces = shown.trace.ticks["burr"]["force_N"].sum(axis=(0, 1))
    assert abs(forces[0]) > 0.4 * np.linalg.norm(forces)
    assert trace_approach(shown).axis @ (0, 0, -1) > 0.95


def test_from_above_where_no_bone_was_touched(tmp_path):
    shown = player(tmp_path, (0.0, 0.0, 500.0), (0, 0, -1))
    assert trace_approach(shown) is None
    assert approach_view(shown.bone, None) == surgeon_view(shown.bone)
    assert approach_view(shown.bone, None, width=3.0) == surgeon_view(shown.bone, width=3.0)


def test_a_burr_larger_than_the_bone(tmp_path):
    """At contact its centre is farther from the bone than the bone is wide."""
    bone = burrlab.VoxelBone.block((1.2, 1.2, 0.6), 0.2)
    device = burrlab.ScriptedDevice([0.0, 0.1], [(0.5, 0.5, 6.5), (0.5, 0.5, 6.4)])
    tool, record = (burrlab.Burr(6.0), burrlab.materials["bone"]), tmp_path / "trace.h5"
    with burrlab.Session(
        bone, tool, device, seed=1, duration=0.1, clock=burrlab.Clock(wall_clock=False), record=record
    ) as session:
        session.wait()
    shown = TracePlayer(burrlab.load_trace(record))
    found = trace_approach(shown)
    np.testing.assert_allclose(approach_view(shown.bone, found).focus, found.entry)
