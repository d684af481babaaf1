"""Limits of devices, the ramp, and rules that stop a session."""

import dataclasses
import functools
import itertools
import json
import math
import os
import re
import signal
import threading

import numpy as np
import pytest
import test_session
from anatomy_scenes import nerve_bone, straight, tool
from command_line import refusal, result
from conftest import ROOT
from pseudo_terminal import PseudoTerminal
from session_scenes import ended, refused, session_of

from burrlab import (
    Burr,
    Clock,
    DeviceFrame,
    DeviceLimits,
    HandDevice,
    Material,
    ReplayDevice,
    Safety,
    ScriptedDevice,
    Session,
    VoxelBone,
    _core,
    device_limits,
    load_trace,
    replay,
)
from burrlab.anatomy.watch import Watch


def session(device=None, **options):
    """Of a hand that presses as hard as bone lets it."""
    return test_session.session(device or HandDevice((0, 0, 3.1), push=4.0), **options)


def recorded(path, **options):
    """The session at its end, and its trace."""
    return ended(session(record=path, **options)), load_trace(path)


def mean_squares(force, decay):
    """The running mean of the squared force, from 0 on."""
    return [
        *itertools.accumulate(force**2, lambda mean, square: square + (mean - square) * decay, initial=0.0)
    ]


def test_every_number_has_a_source_and_the_page_has_the_table():
    for model, limits in device_limits.items():
        known = {name for name in limits.sources if getattr(limits, name) is not None}
        assert {f.name for f in dataclasses.fields(limits) if getattr(limits, f.name) is not None} == {
            *known, "model", "window", "sources",
        }, model  # fmt: skip
        assert limits.peak_force >= (limits.continuous_force or 0) > -1
        assert limits.damping is limits.friction is None  # found in no public source
    assert "omega.7" in device_limits
    assert "omega.9" not in device_limits
    assert str(device_limits) in (ROOT / "docs" / "stability.md").read_text()


def test_limits_that_bind_nothing_change_no_bit(tmp_path):
    _, plain = recorded(tmp_path / "a.h5", duration=2.0)
    _, wide = recorded(tmp_path / "b.h5", duration=2.0, limits=DeviceLimits("wide", 99, 99), ramp=0)
    for name in ("sent_force_N", "device_position_mm", "removed_levels"):
        np.testing.assert_array_equal(plain.array(name), wide.array(name))
    assert plain.digests == wide.digests
    assert "limits" not in plain.note


def test_a_session_keeps_the_limits_of_its_model(tmp_path, monkeypatch):
    # with its own limit of a stall
    monkeypatch.setattr("burrlab.session.session.HapticLoop", _core.HapticLoop)
    still = ScriptedDevice([0.0, 8.0], [[0, 0, 2.0]] * 2, on=[False, False])
    run, trace = recorded(tmp_path / "touch.h5", device=still, limits="touch", ramp=0.05)
    sent, wanted = (np.linalg.norm(trace.array(f"{name}force_N"), axis=1) for name in ("sent_", ""))
    steps = np.linalg.norm(np.diff(trace.array("sent_force_N"), axis=0, prepend=0), axis=1)
    assert wanted.max() > 3.3
    assert 3.0 < sent.max() <= 3.3 + 1e-12
    assert steps.max() <= 1 + 1e-12
    assert (sent <= 3.3 / 50 * np.arange(len(sent)) + 1e-12).all()  # 50 ms from the first tick on
    assert 0.99 * 0.88**2 < max(mean_squares(sent, math.exp(-1e-4))) <= 0.88**2 + 1e-12
    assert 0.88 < sent[1000:].min() < 0.8801  # it falls towards the continuous force, not to zero
    assert run.messages[0] == (
        "burr 0: touch: force at most 3.3 N, its change 1 N/ms, RMS over 10 s 0.88 N, ramp 0.05 s"
    )
    assert trace.note["limits"] == [{"model": "touch", **{k: list(v) if isinstance(v, tuple) else v for k, v in
                                     device_limits["touch"].numbers().items()}}]  # fmt: skip
    assert (trace.note["ramp_s"], replay(trace).equal) == (0.05, True)
    assert re.search(
        r"burr 0: touch renders 0\.4 N/mm stably; the contact is \d+\.\d\d of that", str(run.report())
    )


@pytest.mark.filterwarnings("ignore:c_e = ")
@pytest.mark.parametrize("numbers", [range(60), pytest.param(range(60, 10_000), marks=pytest.mark.slow)])
def test_no_force_sent_exceeds_the_limits(numbers, monkeypatch):
    """Random sessions: models, ramps, rates, slews, frames with a clutch, jumps in and out of bone."""
    # The guard reckons with a stall: the shorter it is, the nearer it lets the force come to its limit.
    monkeypatch.setattr(
        "burrlab.session.session.HapticLoop", functools.partial(_core.HapticLoop, stall_limit=1000.0)
    )
    bone = VoxelBone.block((12, 12, 5), 0.5, origin=(-5.75, -5.75, -4.75))
    reached = np.zeros(3)  # peak, continuous, ramp
    for number in numbers:
        random = np.random.default_rng(number)
        model = device_limits[random.choice(list(device_limits))]
        model = dataclasses.replace(model, window=random.uniform(3, 10))
        if number % 4:  # a session as short as these meets only a low one
            model = dataclasses.replace(model, continuous_force=model.peak_force * random.uniform(0.05, 0.3))
        ramp, rate, slew = (
            random.choice([0, 0.02, 0.2]),
            random.choice([500, 1000, 4000]),
            random.uniform(0.1, 8),
        )
        n = random.integers(50, 600)
        way = np.cumsum(random.normal(0, random.choice([0.003, 0.05, 2]), (n, 3)), axis=0) + (0, 0, 2.1)
        device = ReplayDevice(
            way % 6 - (3, 3, 1), on=random.random(n) < 0.5, buttons=random.integers(0, 2, n)
        )
        frame = DeviceFrame(random.uniform(0.5, 2), clutch=0 if number % 3 else None)
        run = Session(
            bone,
            (Burr(2.0), Material("random", c_e=random.uniform(0.2, 30), alpha=0.05)),
            (device, frame) if number % 2 else device,
            seed=number,
            clock=Clock(rate=rate, wall_clock=False),
            safety=Safety(limits=model, ramp=ramp, slew_limit=slew, force_limit=99),
        )
        reader = _core.RecordReader(run.loop)
        ended(run)
        ticks = reader.take(n)[0]["burr"]
        sent, force = ticks["sent"][:, 0], np.linalg.norm(ticks["sent"][:, 0], axis=1)
        wanted, time = np.linalg.norm(ticks["force"][:, 0], axis=1), np.arange(1, n + 1) / rate
        steps = np.linalg.norm(np.diff(sent, axis=0, prepend=0), axis=1)
        assert force.max() <= model.peak_force * (1 + 1e-12), number
        assert steps.max() <= slew * 1e3 / rate + 1e-12 * model.peak_force, number
        if ramp:
            since = time - time[np.argmax(wanted > 0)] + 1 / rate
            assert (force <= model.peak_force * np.maximum(since, 0) / ramp + 1e-9).all(), number
        mean = mean_squares(force, np.exp(-1 / (rate * model.window)))
        assert max(mean) <= ((model.continuous_force or np.inf) * (1 + 1e-9)) ** 2, number
        part = np.array(
            [force.max() / model.peak_force, math.sqrt(max(mean)) / (model.continuous_force or np.inf)]
        )
        reached = np.maximum(reached, [*part, (force < 0.9 * np.minimum(wanted, model.peak_force)).mean()])
    assert reached[0] > 0.999
    assert reached[1] > 0.7  # a stall is reckoned with
    assert reached[2] > 0.5


def test_the_stability_report_knows_the_model():
    own = dataclasses.replace(device_limits["touch"], damping=5.0, friction=0.055, rate=500.0)
    path = np.array([[0, 0, 3.1], [0, 0, 2.9]], float)
    run = ended(session(ScriptedDevice([0.0, 0.2], path, on=[False, False]), limits=own))
    # 2 x 0.055 N/0.055 mm, below 10 of the damping
    assert run.report().stability[0]["limit_N_per_mm"] == pytest.approx(2.0)
    assert run.messages[0].endswith("; the loop's 1000 Hz are more than its 500")
    run = ended(session(limits=own, duration=0.1))  # the hand states its own, and has no encoder's step
    assert run.report().stability[0]["limit_N_per_mm"] == pytest.approx(10.0)


def test_two_burrs_have_their_own_limits():
    still = [ScriptedDevice([0, 1.5], [[x, 0, 2.2]] * 2, on=[False] * 2) for x in (-5, 5)]
    run = ended(
        session_of(
            test_session.block(),
            [test_session.TOOL] * 2,
            still,
            wall_clock=False,
            limits=["touch", None],
            ramp=0.2,
        )
    )
    sent = np.linalg.norm(run.follower.take(run.follower.view())["newest"]["burr"]["sent"], axis=1)
    assert sent[0] < 1.2 < 1.5 < sent[1]
    assert run.messages[1].startswith("burr 1: no model: force at most 8 N, its change 1 N/ms, no continuous")


def test_a_force_stops_the_session_in_its_tick(tmp_path):
    run, trace = recorded(tmp_path / "stop.h5", duration=5.0, stop_at_force=1.5)
    wanted, sent = (np.linalg.norm(trace.array(f"{name}force_N"), axis=1) for name in ("", "sent_"))
    assert (run.reason, run.failed) == ("the force of burr 0 reached 1.5 N", False)
    assert wanted[-1] >= 1.5 > wanted[:-1].max()
    assert sent[-1] == 0 < sent[-2]
    assert (replay(trace).equal, trace.note["stop_at_force_N"]) == (True, 1.5)


def test_nearness_stops_the_session(tmp_path):
    """The burr comes down on the nerve at 5 mm/s, with z = -1 at its top; it is seen within 40 ms here."""
    bone = nerve_bone()
    watch = Watch(bone, structures=["nerve"])
    device = straight([(0, 0, 1.2), (0, 0, -0.8)], [0.0, 0.4], on=[True, True])
    stop, path = {"nerve": 0.5}, tmp_path / "near.h5"
    run = ended(session_of(bone, tool(), device, watch=watch, stop_within=stop, record=path, realtime=False))
    assert re.fullmatch(r"burr 0 came within 0\.5 mm of nerve: 0\.\d\d mm", run.reason)
    assert not run.failed
    assert "the session stops within 0.5 mm of nerve" in run.messages
    trace = load_trace(path)
    distance = watch.distance(trace.array("center_mm"), "nerve", radius=1.0)
    late = len(distance) - 1 - np.flatnonzero(distance <= 0.5)[0]
    assert 0 <= late < 150  # ticks of 1 ms, on a loaded machine
    assert trace.note["stop_within_mm"] == {"nerve": 0.5}


def test_ctrl_c_stops_a_session_at_once():
    said = []

    def interrupt():
        said.append(run.ticks)
        os.kill(os.getpid(), signal.SIGINT)

    run, timer = session(wall_clock=True, realtime=False), threading.Timer(0.5, interrupt)
    timer.start()
    with pytest.raises(KeyboardInterrupt), run:
        run.wait(60)
    assert run.reason == "stopped by KeyboardInterrupt"
    assert run.ticks - said[0] < 100  # 1 or 2 on an idle machine


def test_enter_stops_the_command(tmp_path):
    """In its own terminal; typed text does not reach the shell."""
    file = str(tmp_path / "trace.h5")
    with PseudoTerminal(
        "session", "--device", "hand", "--voxel", "0.5", "--no-realtime", "--record", file
    ) as at:
        at.wait_for("Enter or Ctrl-C stops the session", r"\d+ ticks")
        os.write(at.controller, b"stop\n")
        at.wait_for("Enter was pressed")
        assert at.process.wait(30) == 0
    assert load_trace(file).complete


def test_a_closed_terminal_leaves_trace_and_result(tmp_path):
    file, told = tmp_path / "trace.h5", tmp_path / "told.json"
    words = ("session", "--device", "hand", "--voxel", "0.5", "--no-realtime", "--record", str(file))
    at = PseudoTerminal(*words, "--json", str(told))
    at.wait_for("Enter or Ctrl-C stops the session", r"\d+ ticks")
    os.close(at.terminal)
    os.close(at.controller)
    assert at.process.wait(30) == 130
    assert load_trace(file).complete
    assert json.loads(told.read_text())["interrupted"]


def test_options_of_the_command(capsys):
    hand = ("session", "--device", "hand", "--voxel", "0.5", "--virtual-clock", "--duration", "2")
    told = result(capsys, *hand, "--model", "touch_x", "--ramp", "0.5", "--stop-at-force", "0.3")
    assert told["state"] == "the force of burr 0 reached 0.3 N"
    assert told["provenance"]["limits"][0]["continuous_force_N"] == 1.75
    assert told["provenance"]["ramp_s"] == 0.5
    assert told["stability"][0]["model"] == "touch_x"
    assert "limits" not in result(capsys, *hand, "--model", "none")["provenance"]
    assert "did you mean 'touch_x'?" in refusal(capsys, *hand, "--model", "touchx")
    assert "must be TISSUE:MM, got 'nerve'" in refusal(capsys, *hand, "--stop-within", "nerve")
    assert "must be used with a watch" in refusal(capsys, *hand, "--stop-within", "nerve:1")


def near(**distances):
    bone = nerve_bone()
    session_of(bone, tool(), HandDevice(), watch=Watch(bone, structures=["nerve"]), stop_within=distances)


@pytest.mark.parametrize(
    ("make", "error", "told"),
    [
        *((lambda options=options: session(**options), error, told) for options, error, told in [
            ({"limits": "tuch"}, ValueError, "model must be one of touch, .*, got 'tuch'; did you mean 'touch'"),
            ({"limits": ["touch"] * 2}, ValueError, "limits must be one a burr, 1, got 2"),
            ({"limits": 3.3}, TypeError, "limits must be a DeviceLimits, such as"),
            ({"ramp": -1.0}, ValueError, "ramp must be from 0 and below 1e6 s, got -1"),
            ({"ramp": math.nan}, ValueError, "ramp must be from 0 and below 1e6 s, got nan"),
            ({"stop_at_force": 0.0}, ValueError, r"stop_at_force must be positive and finite, got 0\.0"),
            ({"stop_button": 8}, ValueError, "stop_button must be a whole number from 0 and below 8"),
            ({"stop_button": 1, "frames": DeviceFrame(clutch=1)}, ValueError, "another button than the clutch, got 1"),
            ({"stop_within": 1.0}, TypeError, "stop_within must be a Mapping"),
            ({"limits": DeviceLimits("slow", 3, 1, window=0.05)}, ValueError, "window must be at least a stall"),
        ]),
        *((lambda numbers=numbers: DeviceLimits("own", **numbers), ValueError, told) for numbers, told in [
            ({"window": -1.0}, r"window must be positive and finite, or None, got -1\.0"),
            ({"peak_force": math.nan}, "peak_force must be positive and finite, or None, got nan"),
            ({"workspace": (1.0, "2")}, "workspace must be positive and finite, or None, got '2'"),
        ]),
        (lambda: near(sinus=1.0), ValueError, "structure must be one of nerve, got 'sinus'"),
        (lambda: near(nerve=-1.0), ValueError, r"stop_within of nerve must be from 0 to 15 mm, got -1\.0"),
        *((lambda place=place: DeviceFrame(**place), ValueError, told) for place, told in [
            ({"scale": 0.0}, "scale must be positive"),
            ({"rotation": (0, 0, 0, 0)}, "rotation must be a quaternion of length 1, got 0"),
            ({"rotation": (1.0009, 0, 0, 0)}, r"rotation must be a quaternion of length 1, got 1\.0009"),
            ({"rotation": (math.nan, 0, 0, 0)}, "rotation must be a quaternion of length 1, got nan"),
            ({"rotation": (1, 0, 0)}, r"rotation must be 4 numbers, got \(1, 0, 0\)"),
            ({"offset": (0, 0, math.inf)}, "offset must be finite"),
            ({"clutch": 8}, "clutch must be a whole number from 0 and below 8, got 8"),
        ]),
    ],
)  # fmt: skip
def test_refusals(make, error, told):
    refused((make, told, error))


# --- Where a device stands ----------------------------------------------------------------------------------


def test_a_frame_moves_the_burr_and_is_recorded(tmp_path):
    path = np.column_stack([np.zeros(400), np.linspace(0.0, 1.0, 400), np.full(400, 1.45)])
    half, nearly = 0.5**0.5, 1.0004  # lengths that are just let through do not add up
    velocity, turned = np.tile([0.0, 2.0, 0.0], (400, 1)), np.tile([nearly, 0, 0, 0], (400, 1))
    device = ReplayDevice(path, velocity=velocity, orientation=turned)
    frame = DeviceFrame(2.0, rotation=(nearly * half, 0, 0, -nearly * half), offset=(1, 0, 0))
    run, trace = recorded(tmp_path / "a.h5", device=device, frames=frame)
    there = np.column_stack([1 + 2 * path[:, 1], 0 * path[:, 0], 2 * path[:, 2]])
    np.testing.assert_allclose(trace.array("center_mm"), there, atol=1e-12)
    np.testing.assert_allclose(
        trace.array("device_velocity_mm_s"), np.tile([4.0, 0, 0], (400, 1)), atol=1e-12
    )
    assert trace.array("sent_force_N")[:, 2].max() > 0.1
    assert trace.note["frames"] == json.loads(json.dumps(run.provenance["frames"]))
    assert trace.note["frames"][0]["scale"] == 2.0
    np.testing.assert_allclose(np.linalg.norm(trace.array("orientation"), axis=1), nearly)
    device = ReplayDevice(path)
    run, _ = recorded(tmp_path / "b.h5", device=device, frames=DeviceFrame(1e308, offset=(0, 0, 1e308)))
    assert run.reason == "device 0 gave a position or velocity that is not finite"


def test_a_frame_from_the_command_line(tmp_path, capsys):
    script = tmp_path / "down.csv"
    script.write_text("time_s,x_mm,y_mm,z_mm\n0,0,0,3.5\n0.2,0,0,3\n")
    asked = ["session", "--device", f"scripted:{script}", "--virtual-clock", "--seed", "1"]
    moved = result(
        capsys, *asked, "--scale", "1", "--rotation", "1,0,0,0", "--offset", "-1,0,0.5", "--clutch", "0"
    )
    plain = result(capsys, *asked, "--duration", "0.1")
    assert "frames" not in plain["provenance"]
    assert (plain["ticks"], plain["provenance"]["wall_clock"]) == (100, False)
    assert moved["provenance"]["frames"][0]["offset"] == [-1.0, 0.0, 0.5]
    for wrong in ("1,0,0", "1,0,0,a"):
        assert f"must be W,X,Y,Z, got '{wrong}'" in refusal(capsys, *asked, "--rotation", wrong)
