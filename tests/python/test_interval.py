"""One interval: its rendering and its end."""

import threading

import numpy as np
import pytest
from session_scenes import FakeReader, refused

from burrlab import Burr, MailboxDevice, Material, ScriptedDevice, _core, load_trace, materials, replay
from burrlab.psychophysics import Interval, Stimulus, drilling_hand, probing_hand
from burrlab.psychophysics.interval import TICK, Block, _Watch, render

BURR = Burr(2.0)
BONE = Block((14, 14, 4), 0.2)


def interval(name="bone", *, seed=1, duration: float | None = 0.5):
    return Interval(Stimulus(name, materials[name]), seed, duration)


def play(device=None, what=None, *, bone=BONE, mode="drilling", wall_clock=False, **options):
    device = device or drilling_hand(BURR)
    return render(
        what or interval(), device, burr=BURR, bone=bone, mode=mode, wall_clock=wall_clock, **options
    )


def script(*rows, on=True):
    """A device that is at (x, y, z) [mm] at a time [s]."""
    time, x, y, z = np.array(rows, dtype=float).T
    return ScriptedDevice(time, np.column_stack([x, y, z]), np.full(len(time), on))


def removed(rendered):
    return int(rendered.ticks["removed"].sum())


def test_it_ends_when_its_time_is_over():
    found = play(drilling_hand(BURR, push=1.0, clearance=0.1))
    assert (found.ended, found.duration, len(found.ticks), found.failed) == ("time", 0.5, 500, False)
    assert found.reason == "all ticks were executed"
    assert found.ticks["time"] == pytest.approx(0.001 * np.arange(500), abs=1e-9)
    assert found.contact == pytest.approx(0.001 * found.ticks["touching"].sum())
    assert 0.4 < found.contact < 0.5
    assert removed(found) > 0
    assert found.immersion == pytest.approx(2.0 - found.ticks["center"][:, 2])
    assert not found.ticks.flags.writeable
    assert "ticks=" not in repr(found)


def test_only_a_burr_that_turns_in_drilling_erodes(tmp_path):
    found = play(drilling_hand(BURR, push=1.0), mode="probing")
    assert (found.ticks["on"].all(), found.ticks["touching"].any()) == (True, True)
    assert removed(found) == removed(play(probing_hand(BURR))) == 0
    law = Material("x", c_e=2.0, alpha=0.1, force_exponent=2.0)
    play(probing_hand(BURR), Interval(Stimulus("x", law), 1, 0.1), mode="probing", record=tmp_path / "a.h5")
    ((_, probed),) = load_trace(tmp_path / "a.h5").tools
    assert (probed.alpha, probed.force_exponent) == (0.0, 2.0)


def test_the_seed_alone_decides_what_is_eroded():
    a, again, other = (play(drilling_hand(BURR, push=1.0), interval(seed=seed)) for seed in (1, 1, 2))
    assert np.array_equal(a.ticks, again.ticks)
    assert not np.array_equal(a.ticks["removed"], other.ticks["removed"])


THIN = Block((14, 14, 0.6), 0.2)
THROUGH = {
    "device": drilling_hand(BURR, push=1.0, strokes=0),
    "what": interval("pvc", duration=20.0),
    "bone": THIN,
}


def test_break_through_ends_it_at_that_very_tick():
    found = play(**THROUGH)
    tip = found.ticks["center"][:, 2] - BURR.radius
    assert (found.ended, found.duration) == ("break-through", pytest.approx(0.001 * len(found.ticks)))
    assert tip[-1] <= -0.6 < tip[-2]


@pytest.mark.parametrize(("axis", "side"), [(0, 1.0), (1, -1.0)])
def test_a_wall_ends_it_where_the_sphere_below_the_surface_reaches_it(axis, side):
    end = np.zeros(3)
    end[axis] = side * 10.0
    found = play(script((0, 0, 0, 1.5), (1, *end[:2], 1.5)), interval(duration=2.0), mode="probing")
    reach, way = 7.0 - np.sqrt(2.0**2 - 1.5**2), side * found.ticks["center"][:, axis]
    assert found.ended == "wall"
    assert way[-2] < reach <= way[-1] == pytest.approx(reach, abs=0.011)


def test_a_device_s_end_ends_it_and_beside_the_block_is_no_wall_before_a_contact():
    outside = script(
        (0, 20, 0, 1), (0.1, 20, 0, 5), (0.2, 0, 0, 5), (0.3, 0, 0, 1.8), (0.4, 0, 0, 5), (0.5, 30, 0, 2.1)
    )
    found = play(outside, interval(duration=1.0), mode="probing")
    assert (found.ended, found.failed) == ("device", False)
    assert "has come to its end" in found.reason
    assert found.ticks["touching"].any()


def test_the_subject_ends_it_with_or_without_a_length():
    asked, event = iter([False] * 40 + [True]), threading.Event()
    event.set()
    for duration, stop in ((None, lambda: next(asked)), (60.0, event.is_set)):
        found = play(drilling_hand(BURR, push=0.1), interval(duration=duration), wall_clock=True, stop=stop)
        assert (found.ended, found.failed) == ("subject", False)
    assert next(asked, None) is None


def test_a_lost_device_is_a_failure():
    mailbox = MailboxDevice(lost_after=50.0)
    mailbox.put((0, 0, 2.5))
    said = []
    found = play(mailbox, interval(duration=5.0), wall_clock=True, on_message=said.append)
    assert (found.ended, found.failed) == ("device", True)
    assert found.reason in said


def test_the_trace_holds_the_interval(tmp_path):
    file = tmp_path / "interval.h5"
    found = play(**THROUGH, record=file)
    trace = load_trace(file)
    assert np.array_equal(trace.array("center_mm")[: len(found.ticks)], found.ticks["center"])
    assert (trace.complete, trace.bone().digest(), replay(trace).equal) == (True, THIN.fresh().digest(), True)
    refused((lambda: play(drilling_hand(BURR), record=file), "path must be a new file", FileExistsError))


@pytest.mark.parametrize("size", [1, 7])
def test_the_end_does_not_depend_on_how_the_records_come(size):
    executor = _core.TickExecutor(BONE.fresh(), [(BURR, materials["pvc"])], 1)
    device = script((0, 0, 0, 2.5), (0.3, 0, 0, 1.5), (1, 10, 0, 1.5))
    loop = _core.HapticLoop(executor, [device], wall_clock=False, realtime=False)
    reader = _core.RecordReader(loop)
    loop.start()
    assert loop.wait(30.0)
    records, _ = reader.take(10**6)
    whole, parts = (
        _Watch(FakeReader(*batches), BURR, BONE, None)
        for batches in ([records], [records[i : i + size] for i in range(0, len(records), size)])
    )
    whole.look()
    while not parts.ended:
        parts.look()
    assert parts.ended == whole.ended == "wall"
    assert np.array_equal(parts.ticks(), whole.ticks())
    assert whole.ticks().dtype == TICK


def test_lost_records_are_not_passed_over():
    watch = _Watch(FakeReader(lost_at_end=True), BURR, BONE, 1.0)
    refused((lambda: watch.look(), "records of the interval were lost", RuntimeError))


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda: play(mode="looking"), "mode must be one of probing, drilling, got 'looking'"),
        (
            lambda: play(what=Interval(Stimulus("real"), 1, 1.0)),
            "must have a material to be rendered, got the real specimen 'real'",
        ),
        (lambda: play(what=interval(duration=None)), "stop must be given where the interval has no duration"),
        (lambda: play(what=interval(duration=0.0)), "duration of the interval must be positive, got 0.0"),
        (
            lambda: play(bone=Block((14, 14, 4), 1.0)),
            "radius of the burr must be at least 4 voxels of 1 mm, got 2",
        ),
        (
            lambda: play(bone=Block((4, 14, 4), 0.2)),
            "diameter of the burr must be less than the block's sides, 4 mm",
        ),
        (lambda: Block((1, 2), 0.1), "size must have three lengths, got 2"),
        (lambda: Block((1, 2, 3), 0.0), "voxel must be positive and finite, got 0.0"),
        (lambda: Block((1, 2, np.inf), 0.1), "size must be positive and finite, got inf"),
        (lambda: Block((1, 2, 1.05), 0.1), "size must be a whole number of voxels of 0.1 mm, got 1.05"),
    ],
)
def test_refusals(ask, sentence):
    refused((ask, sentence))
