"""Devices without hardware in a loop: the simulated hand, scripts, recordings and mailboxes."""

import functools
import threading

import numpy as np
import pytest
from label_scenes import volume
from replica_scenes import soon

from burrlab import Burr, VoxelBone, _core, materials, read_script


def begun(device, *, period=1.0, **options):
    """(a running loop, a reader of its records, bone)"""
    bone = VoxelBone.block((8, 8, 3), 0.2, origin=(-3.9, -3.9, -2.9))
    executor = _core.TickExecutor(bone, [(Burr(2.0), materials["bone"])], 1, period=period)
    loop = _core.HapticLoop(executor, [device], realtime=False, **options)
    reader = _core.RecordReader(loop)
    loop.start()
    return loop, reader, bone


def play(device, ticks=0, **options):
    """(records of a loop on its virtual clock, reason of its end, bone)"""
    loop, reader, bone = begun(device, wall_clock=False, ticks=ticks, **options)
    assert loop.wait(60.0)
    return reader.take(10**6)[0], loop.reason, bone


def test_hand_pushes_with_the_asked_force():
    hand = _core.HandDevice(start=(0, 0, 2.3), push=0.8, strokes=0, on=False)
    first = play(hand, 4000)[0]["burr"][:, 0]
    assert (first["touching"][0], first["on"].sum()) == (0, 0)  # it begins out of contact
    assert first["force"][-1] == pytest.approx([0, 0, 0.8], abs=1e-4)
    assert np.abs(first["device_velocity"]).max() < 10
    assert (hand.name, list(hand.force)) == ("simulated hand", [0, 0, 0])  # the session is over


def test_hand_moves_the_same_at_any_rate():
    ends = []
    for period in (1.0, 0.25, 0.1):
        hand = _core.HandDevice(start=(0, 0, 20.0), strokes_after=0.1)
        play(hand, round(500 / period), period=period)
        ends.append(hand.position)
    # One period less is simulated than there are readings.
    assert (ends[1], ends[0]) == (pytest.approx(ends[2], abs=0.02), pytest.approx(ends[2], abs=0.1))


def test_script_is_followed_and_ends_the_session():
    time, z = [0.0, 0.1, 0.3], [2.5, 1.8, 2.5]
    device = _core.ScriptedDevice(time, [(0, 0, zi) for zi in z], [True, False, True])
    assert (len(device), device.duration) == (3, 0.3)
    records, reason, bone = play(device)
    first = records["burr"][:, 0]
    assert "has come to its end" in reason
    assert first["center"][:, 2] == pytest.approx(np.interp(records["time"], time, z), abs=1e-12)
    assert np.array_equal(first["on"] == 1, records["time"] < 0.1)
    assert bone.removed > 0
    assert records["time"][-1] == pytest.approx(0.3, abs=1.1e-3)  # rounding may cost the last tick


def test_replay_carves_the_same_bone():
    records, _, carved = play(_core.HandDevice(start=(0, 0, 2.1), amplitude=1.0), 1500)
    first = records["burr"][:, 0]
    device = _core.ReplayDevice(first["device_position"], first["device_velocity"], first["on"].astype(bool))
    again, reason, bone = play(device)
    assert "has come to its end" in reason
    assert len(device) == 1500
    assert np.array_equal(again["burr"]["force"], records["burr"]["force"])
    assert bone.digest() == carved.digest()


@pytest.mark.parametrize(
    ("device", "arguments", "sentence"),
    [
        *(
            (functools.partial(_core.HandDevice, **setting), (), sentence)
            for setting, sentence in (
                ({"mass": 0}, "mass must be positive and finite, got 0"),
                ({"start": (0, np.nan, 0)}, "start must be finite"),
                ({"into": (0, 0, -2)}, "length of into must be 1, got 2"),
                ({"along": (0, 0, 1)}, "cosine between into and along must be 0, got -1"),
                ({"presses": -1}, "presses must be zero or positive and finite, got -1"),
                ({"push": -1}, "push must be zero or positive and finite, got -1"),
            )
        ),
        (_core.ScriptedDevice, ([], np.zeros((0, 3))), "a script must have at least one row, got none"),
        (_core.ScriptedDevice, ([0.0, 0.0], np.zeros((2, 3))), "time must be increasing: after 0 s, got 0"),
        (_core.ScriptedDevice, ([np.nan], np.zeros((1, 3))), "time must be finite"),
        (_core.ScriptedDevice, ([0.0], [[0, np.inf, 0]]), "position must be finite"),
        (_core.ScriptedDevice, ([0.0, 1.0], np.zeros((3, 3))), r"position must have shape \(n, 3\)"),
        (_core.ScriptedDevice, ([0.0, 1.0], np.zeros((2, 3)), [True]), r"on must have shape \(n,\)"),
        (_core.ScriptedDevice, ([[0.0]], np.zeros((1, 3))), r"time must have shape \(n,\)"),
        (
            _core.ScriptedDevice,
            ([0.0], [[0, 0, 0]], [True], np.ones((1, 3))),
            r"orientation must have shape \(n, 4\)",
        ),
        (_core.ReplayDevice, (np.zeros((0, 3)),), "a recording must have at least one tick, got none"),
        (_core.ReplayDevice, (np.zeros((2, 2)),), r"position must have shape \(n, 3\)"),
        (_core.ReplayDevice, ([[0, np.nan, 0]],), "position must be finite"),
        (_core.ReplayDevice, (np.zeros((1, 3)), [[0, np.nan, 0]]), "velocity must be finite"),
        (_core.ReplayDevice, (np.zeros((1, 3)), None, [True, True]), r"on must have shape \(n,\)"),
        (_core.MailboxDevice().put, ((0.0, 0.0, np.nan),), "position must be finite"),
        (functools.partial(_core.MailboxDevice, lost_after=0.0), (), "lost_after must be positive"),
    ],
)
def test_refusals(device, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        device(*arguments)


def test_mailbox_from_another_thread():
    device = _core.MailboxDevice(lost_after=5000.0, name="rig")
    loop, reader, _ = begun(device)
    writer = threading.Thread(target=device.put, args=((0.0, 0.0, 1.8),), kwargs={"on": False})
    writer.start()
    writer.join()
    assert soon(lambda: device.force[2] > 0)
    force = device.force
    loop.stop()
    assert reader.take()[0]["burr"]["sent"][-1, 0] == pytest.approx(force)
    assert device.name == "rig"


def test_read_script(tmp_path):
    path = tmp_path / "way.csv"
    path.write_text(
        "# source: by hand\ntime_s,x_mm,y_mm,z_mm,on\n0,0,0,2.5,1\n0.05,0,0,1.8,0\n0.1,0,0,1.8,1\n"
    )
    records, _, _ = play(read_script(path))
    first = records["burr"][:, 0]
    assert first["center"][-1] == pytest.approx([0, 0, 1.8])
    assert np.array_equal(first["on"] == 1, (records["time"] < 0.05) | (records["time"] >= 0.1))
    path.write_text("time_s,x_mm,y_mm,z_mm\n0,1,2,3\n1,1,2,3\n")
    assert len(read_script(path)) == 2
    path.write_text("time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,0,0,2.5,1,0,0,0\n0.1,0,0,2.5,0,0,0,-1\n")
    turned = play(read_script(path))[0]["burr"]["orientation"][:, 0]
    half = 0.5**0.5  # the shorter way, by 180 degrees
    assert np.allclose(turned[[49, 99]], [(half, 0, 0, -half), (0, 0, 0, -1)])
    assert np.allclose(np.linalg.norm(turned, axis=1), 1.0, atol=1e-15)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # the bone's x is the volume's y
    there = read_script(path, volume=volume(quarter))
    assert abs(play(there)[0]["burr"]["orientation"][0, 0] @ (half, 0, 0, -half)) > 0.9999
    with pytest.raises(ValueError, match=r"way.csv: no orientation can be given in coordinates that mirror"):
        read_script(path, volume=volume(-quarter))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time_s,x_mm,y_mm\n0,0,0\n", "z_mm"),
        ("time_s,x_mm,y_mm,z_mm\n0,0,0,\n", "line 2, column z_mm: every row needs a position"),
        ("time_s,x_mm,y_mm,z_mm,on\n0,0,0,0,2\n", "line 2, column on: must be 0 or 1: got 2.0"),
        ("time_s,x_mm,y_mm,z_mm,on\n0,0,0,0,\n", "line 2, column on: every row needs 0 or 1"),
        ("time_s,x_mm,y_mm,z_mm\n1,0,0,0\n1,0,0,0\n", "way.csv: time must be increasing: after 1 s, got 1"),
        (
            "time_s,x_mm,y_mm,z_mm,qw\n0,0,0,0,1\n",
            "way.csv: an orientation needs all of the columns qw, qx, qy",
        ),
        (
            "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,0,0,0,1,1,0,0\n",
            "way.csv: length of orientation must be 1, got 1.4",
        ),
    ],
)
def test_read_script_refusals(tmp_path, text, sentence):
    path = tmp_path / "way.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=sentence):
        read_script(path)
