"""Whole sessions: ends, clocks, followers, and results."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from session_scenes import ended, refused, session_of

from burrlab import (
    Burr,
    BurrContact,
    Clock,
    DeviceFrame,
    HandDevice,
    MailboxDevice,
    Material,
    ReplayDevice,
    ScriptedDevice,
    Session,
    StartingBone,
    VoxelBone,
    _core,
    load_bone,
    load_trace,
    materials,
    replay,
    save_bone,
)

TOOL = Burr(3.0), materials["bone"]


def block(voxel=0.2):
    o = voxel / 2
    return VoxelBone.block((24, 16, 5), voxel, origin=(o - 12, o - 8, o - 5))


def session(device=None, **options):
    options = {"seed": 1, "wall_clock": False, **options}
    return session_of(block(), TOOL, device or HandDevice(), **options)


# --- The virtual clock: the same result on every machine --------------------------------------------------


def test_a_session_repeats_to_the_bit_and_does_not_change_the_bone_given():
    bone = block()
    runs = [
        ended(Session(bone, TOOL, HandDevice(), seed=1, duration=3.0, clock=Clock(wall_clock=False))) for _ in range(2)
    ]  # fmt: skip
    digests = runs[0].digests
    assert (digests, [tick for tick, _ in digests], len({d for _, d in digests})) == (
        runs[1].digests, [0, 1000, 2000, 3000], 4,
    )  # fmt: skip
    cut, tick = runs[0].snapshot()
    assert (bone.digest(), (tick, cut.digest())) == (digests[0][1], digests[-1])
    assert cut.removed > 0.1


def test_a_coarse_burr_is_told():
    """As README says, a result tells of a radius below 7.5 voxels."""
    for spacing, told in ((0.5, ["coarse: the radius of burr 0 is 6 voxels, below 7.5"]), (0.4, [])):
        bone = VoxelBone.block((16, 16, 4), spacing)
        device = ScriptedDevice([0, 0.01], [(8, 8, 9)] * 2)
        run = ended(Session(bone, TOOL, device, seed=1, clock=Clock(wall_clock=False)))
        assert [text for text in run.report().messages if "coarse" in text] == told


def test_goes_on_from_a_saved_bone(tmp_path):
    """Two halves with a continued tick index give the bone of one run."""
    time_, position = np.arange(0, 2.001, 0.5), np.array([[x, 0, 2.7] for x in (0, 3, 0, -3, 0)])
    whole = ended(session(ScriptedDevice(time_, position), record=tmp_path / "whole.h5"))
    bone, tick = block(), 0
    for part in np.array_split(load_trace(tmp_path / "whole.h5").array("device_position_mm"), 2):
        half = ended(
            Session(
                StartingBone(bone, tick=tick),
                TOOL,
                ReplayDevice(part),
                seed=1,
                clock=Clock(wall_clock=False),
            )
        )
        save_bone(tmp_path / "bone.h5", *half.snapshot())
        bone, tick = load_bone(tmp_path / "bone.h5")
    assert (tick, bone.digest()) == (whole.ticks, whole.digests[-1][1])


def test_two_burrs(tmp_path):
    sucker = Burr(2.0), Material("sucker", c_e=2.145, alpha=0.0)
    devices = [HandDevice(), HandDevice(start=(6, 0, 2.5), strokes=0)]
    path = tmp_path / "two.h5"
    ended(session_of(block(), [TOOL, sucker], devices, seed=3, wall_clock=False, duration=2.0, record=path))
    trace = load_trace(path)
    assert replay(trace).equal
    assert trace.array("removed_levels", burr=0).sum() > 0
    assert trace.array("removed_levels", burr=1).sum() == 0
    assert np.abs(trace.array("force_N", burr=1)).max() > 0.5


# --- The wall clock ---------------------------------------------------------------------------------------


def test_a_session_records_what_replays(tmp_path):
    path = tmp_path / "session.h5"
    run = ended(session(wall_clock=True, duration=1.5, record=path))
    trace = load_trace(path)
    assert len(trace.ticks) == run.ticks == 1500
    assert (replay(trace).equal, trace.digests[-1]) == (True, run.digests[-1])
    report = run.report()
    assert (report.follower["differing"], report.follower["tick"], report.recording["complete"]) == (
        0, 1500, True,
    )  # fmt: skip
    assert repr(report).startswith("SessionReport(all ticks were executed, 1500 ticks, ")
    pushed, by_edge = replace(report, energy=[(0, 0.05)]), "round an edge the force law gives some"
    assert (by_edge in str(pushed), by_edge in str(replace(report, energy=[(0, 0)]))) == (True, False)
    assert 0 < report.times["tick_time"]["p50"] <= report.times["tick_time"]["max"]
    assert sum(report.histograms["jitter"]) == 1499


def test_periods_before_the_first_position_are_in_no_histogram():
    box = MailboxDevice(lost_after=60_000.0)
    with session(box, wall_clock=True, duration=0.05) as run:
        time.sleep(0.2)
        box.put((0, 0, 2.8))
        assert run.wait(60)
    assert {name: int(sum(counts)) for name, counts in run.report().histograms.items()} == {
        "tick_time": 50, "wall_time": 50, "jitter": 49, "lateness": 50,
    }  # fmt: skip


def test_python_does_not_delay_the_loop():
    """A call that holds the interpreter stops no tick."""
    box = MailboxDevice(lost_after=60_000.0)
    box.put((0, 0, 2.8))
    with session(box, wall_clock=True) as run:
        before, start = run.ticks, time.perf_counter()
        while time.perf_counter() - start < 0.4:
            pow(7, 200_000)  # one long call that keeps the interpreter to itself
        assert run.ticks - before > 50  # of 400, on any machine


def test_a_mailbox():
    box = MailboxDevice()
    with session(box, wall_clock=True) as run:
        assert not run.wait(0.2)  # the session waits for a first position
        assert run.ticks == 0
        for _ in range(100):
            box.put((0, 0, 2.8), on=False)
            time.sleep(0.002)
        assert box.force[2] > 0.1
        assert run.running
        assert run.wait(10)  # no further positions come
    assert run.failed
    assert run.reason.startswith("device 0 was lost: its last position is 1")
    assert run.messages[-1] == run.reason
    np.testing.assert_array_equal(box.force, 0)


# --- Safety -----------------------------------------------------------------------------------------------


def pressed(depth, **options):
    """The burr's last record, after it stood still at a depth in the bone [mm]."""
    script = ScriptedDevice([0.0, 0.5], [[0, 0, 3.0 - depth]] * 2, on=[False, False])
    run = ended(session(script, **options))
    return run.follower.take(run.follower.view())["newest"]["burr"][0]


def test_force_limit():
    """Pressed deep, the force sent stays at the limit; the model's exceeds it."""
    record = pressed(1.0, force_limit=2.0)
    assert np.linalg.norm(record["sent"]) == pytest.approx(2.0)
    assert np.linalg.norm(record["force"]) > 2.0


def test_coupling_softens():
    """For a still burr, spring and bone forces balance, and burr and device are apart."""
    burr = pressed(0.5, coupling=1.0)
    offset = burr["center"] - burr["device_position"]
    np.testing.assert_allclose(burr["sent"], 1.0 * offset, atol=1e-9)
    np.testing.assert_allclose(burr["sent"], burr["force"], atol=2e-4)
    assert offset[2] > 0.1


def test_stability_is_told():
    said = []
    run = ended(session(HandDevice(damping=2.0), duration=3.0, wall_clock=True, on_message=said.append))
    assert any(
        re.search(r"N/mm, at its stiffest \d+\.\d\d of the device's limit; below", text) for text in said
    )
    at = run.report().stability[0]
    assert at["limit_N_per_mm"] == pytest.approx(4.0)
    assert at["ratio"] == pytest.approx(at["stiffness_N_per_mm"] / 4.0, rel=0.05)  # of the stiffest direction


def test_another_law():
    """The follower, which only gets positions, carves the same bone; from q = 2 on the limit is exceeded above."""
    law = Material("law", c_e=2.145, alpha=0.087, force_exponent=2.0, rate_exponent=1.0)
    tools, hands = (
        [(BURR, law), (Burr(2.0), law)],
        (HandDevice(push=0.8), HandDevice(push=0.5, start=(5, 0, 3.3))),
    )
    run = ended(session_of(block(), tools, hands, seed=1, duration=2.0, wall_clock=False))
    report = run.report()
    assert (report.follower["differing"], len({digest for _, digest in run.digests})) == (0, 3)
    assert report.stability[0]["exceeded"] == "above"
    assert "exceeded above" in str(report)


BURR, BONE = TOOL
HANDS = [HandDevice() for _ in range(3)]
NO_TOOLS = r"tools must be \(Burr, Material\) or a list of such pairs, got"


def executor(**options):
    return _core.TickExecutor(block(), [TOOL], 1, **options)


@pytest.mark.parametrize(
    ("make", "error", "told"),
    [
        *((lambda options=options: session(**options), ValueError, told) for options, told in [
            ({"rate": 0.0}, "rate must be positive, got 0"),
            ({"rate": 20_000.0}, "rate must be at most 10000 Hz, got 20000"),
            ({"duration": -1.0}, r"duration must be positive and below 1e9 s, got -1\.0"),
            ({"duration": 1e9}, "duration must be positive and below 1e9 s"),
            ({"digest_every": 0.0}, r"digest_every must be positive, got 0\.0"),
            ({"force_limit": 0.0}, "limit must be positive"),
            ({"coupling": -1.0}, "coupling must be positive and finite, got -1"),
            ({"scheme": "box"}, "scheme must be layer or cell, got 'box'"),
            ({"source": {"a": {1}}}, "source must be what JSON holds: "),
            ({"source": {"x": float("nan")}}, "source must be what JSON holds"),
            *(({"seed": seed}, r"seed must be a whole number from 0 and below 2\^64, got ") for seed in (-1, 2**64, 1.5)),
            ({"tick": 2**53}, r"tick must be a whole number from 0 and below 2\^53, got 9007199254740992"),
            ({"cpu": -2}, r"cpu must be a whole number from 0 and below 2\^31, got -2"),
            ({"rate": 5.0, "wall_clock": True}, r"rate must be at least 20 Hz on the wall clock, got 5\.0"),
            ({"digest_every": float("inf")}, "digest_every must be positive, got inf"),
        ]),
        (lambda: session(HANDS[:2]), ValueError, "number of devices must be one a burr, 1, got 2"),
        (lambda: Session(block(), [TOOL] * 3, HANDS), ValueError,
         "number of burrs must be 1 or 2, got 3"),
        *((lambda tools=tools: Session(block(), tools, HANDS[0]), TypeError, NO_TOOLS)
          for tools in (BURR, [BURR, BONE], (BONE, BURR), [TOOL, None])),
        *((lambda devices=devices: Session(block(), TOOL, devices), TypeError,
            "devices must be a Device or a list of them, .*got")
          for devices in (3, ["hand"], None)),
        (lambda: ended(session(duration=0.1)).start(), ValueError, "session must be started once: it has been started or stopped"),
        *((make, ValueError, told) for make, told in [
            (lambda: session().follower.take(session().follower.view()),
             "view must be one of this follower"),
            (lambda: _core.HapticLoop(None, []), "executor must be a TickExecutor, got None"),
            (lambda: _core.HapticLoop(executor(), HANDS[:1], cpu=-2),
             "cpu must be -1 or the number of a CPU, got -2"),
            (lambda: _core.Follower(None), "loop must be a HapticLoop, got None"),
            (lambda: _core.RecordReader(None), "loop must be a HapticLoop, got None"),
            (lambda: _core.Publisher(None), "follower must be a Follower, got None"),
            (lambda: executor(tick=2**53), r"tick must be below 2\^53"),
        ]),
    ],
)  # fmt: skip
def test_what_is_refused(make, error, told):
    refused((make, told, error))


def test_never_started(tmp_path):
    run = session()
    run.stop()
    assert repr(run) == "Session(not started, 0 ticks, 0 late, 0 periods dropped)"
    assert run.wait()
    refused((run.start, "session must be started once: it has been started or stopped"))
    run = session(record=tmp_path / "a.h5")  # a signal in `start`, before the first tick
    run.stop("stopped by KeyboardInterrupt")
    assert run.report().state == load_trace(tmp_path / "a.h5").ended == "stopped by KeyboardInterrupt"


@pytest.mark.parametrize(("height", "missed"), [(9.0, ["6.10"]), (2.0, [])])
def test_a_script_that_misses_the_bone(height, missed):
    """From corner to corner above it; the burr's radius is 3 mm, and the highest voxels lie 0.1 mm below z = 0."""
    path = [(-30.0, -20.0, 40.0), (0.0, 0.0, height), (30.0, 20.0, 40.0)]
    frame = DeviceFrame(scale=0.5, rotation=(0.0, 0.0, 0.0, 1.0))
    run = ended(session(ScriptedDevice([0.0, 1.0, 2.0], 2 * np.array(path)), frames=frame))
    told = [
        f"burr 0 never met the bone: its script missed it by {by} mm; the bone's box, in the bone frame: x -12.0 to "
        "12.0, y -8.0 to 8.0, z -5.0 to 0.0 mm" for by in missed
    ]  # fmt: skip
    assert [text for text in run.messages if "met" in text] == told


def test_waiting_for_a_session_that_was_not_started(tmp_path):
    with pytest.raises(ValueError, match="session must be started before `wait`: write `with Session"):
        session(record=tmp_path / "new.h5").wait()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("index", "k", "x", "told"),
    [
        (0, 1, 0.0, "index of a tick must be the next one, 1, got 0"),
        (1, 9, 0.0, "k of a tick must be 1 to 8, got 9"),
        (1, 8, np.nan, "center of a tick must be finite, got nan"),
    ],
)
def test_an_executor_refuses_all_records_for_a_wrong_one(index, k, x, told):
    carried_out = executor()
    records = np.zeros(2, _core.record_dtype)
    records["index"], records["k"], records["burrs"] = (0, index), (1, k), 1
    records["burr"]["center"][1, 0, 0] = x
    shape = r"records must be an array of shape \(n,\) and type record_dtype"
    refused((lambda: carried_out.execute(records), told), (lambda: carried_out.execute(np.zeros(2)), shape))
    assert carried_out.tick == 0


def test_executor_is_steps():
    """An executed record is `BurrContact.step` with dt = k periods."""
    bone, other = block(), block()
    executor = _core.TickExecutor(bone, [TOOL], 7, period=0.5, tick=5)
    contact = BurrContact(other, *TOOL, seed=7)
    contact.tick = 5
    records = np.zeros(40, _core.record_dtype)
    records["index"], records["burrs"] = 5 + np.arange(40), 1
    records["k"] = 1 + np.arange(40) % 8
    records["burr"]["on"] = (np.arange(40) % 5 > 0)[:, None]
    records["burr"]["center"][:, 0] = np.column_stack(
        [np.linspace(0, 2, 40), np.zeros(40), np.linspace(2.9, 2.4, 40)]
    )
    for row in executor.execute(records):
        felt = contact.step(
            row["burr"]["center"][0], dt=0.5 * int(row["k"]), burr_on=bool(row["burr"]["on"][0])
        )
        np.testing.assert_array_equal(row["burr"]["force"][0], felt.force)
        assert row["burr"]["penetration"][0] == felt.penetration
        assert row["burr"]["removed"][0] * (0.2**3 / 255) == pytest.approx(felt.removed, rel=1e-12)
    assert bone.digest() == other.digest()
    assert executor.tick == contact.tick == 45
