"""A Touch and an Omega in sessions, over stubs of the vendors' libraries (tests/stubs)."""

import functools
import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from command_line import refusal, result, said
from conftest import ROOT
from replica_scenes import soon
from session_scenes import refused, session_of

import burrlab
from burrlab.session.devices import limits_of_hardware
from stubs.stub import Stub, compiled

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="the stubs need Linux and a C compiler"
)
KINDS = {"touch": burrlab.TouchDevice, "omega": burrlab.OmegaDevice}
LIBRARIES = {"touch": "libhd", "omega": "libdhd"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Compiles a stub once; with options, another one."""
    return functools.cache(functools.partial(compiled, folder=tmp_path_factory.mktemp("stubs")))


@pytest.fixture
def stubs(built, tmp_path, monkeypatch):
    """One of each kind, with a state of its own; the environment names them."""
    for name in LIBRARIES.values():
        monkeypatch.setenv(f"BURRLAB_{name.upper()}", str(shutil.copy(built(name), tmp_path)))
    return {kind: Stub(tmp_path / built(name).name) for kind, name in LIBRARIES.items()}


def session(*devices, **options):
    bone = burrlab.VoxelBone.block((30, 30, 10), 0.4, origin=(-14.8, -14.8, -9.8))
    tools = [(burrlab.Burr(3.0), burrlab.materials["bone"])] * len(devices)
    return session_of(bone, tools, devices, seed=1, realtime=False, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_a_hand_meets_bone_and_the_cable_is_drawn(kind, stubs, tmp_path):
    stub, device, file = stubs[kind], KINDS[kind](on_button=0), tmp_path / "trace.h5"
    assert device.hardware.startswith("Stub")
    assert device.library == stub.file
    with session(device, record=file) as run:
        assert soon(lambda: run.ticks > 50)
        assert not stub.force().any()  # no contact yet
        stub.set(z=2.8, buttons=2)
        assert soon(lambda: stub.get("fz") > 0)
        stub.set(error=0x0302 if kind == "touch" else 2)
        assert run.wait(10)
        assert not stub.force().any()
        assert stub.get("force_on") == 0
    assert (run.failed, run.reason) == (True, f"device 0 was lost: {device.fault}")
    assert device.fault.startswith(f"{device.name} failed: ")
    trace = burrlab.load_trace(file)
    assert (trace.complete, burrlab.replay(trace).equal) == (True, True)
    np.testing.assert_allclose(trace.array("device_position_mm")[[0, -1]], [(0, 0, 5), (0, 0, 2.8)])
    stub.set(error=0)
    with session(device, duration=0.1) as again:  # plugged in again
        assert again.wait(10)
    assert (again.failed, device.fault) == (False, "")


def test_a_button_turns_the_burr(stubs):
    stub, device = stubs["touch"], burrlab.TouchDevice(on_button=0)
    stub.set(z=2.5)
    with session(device) as run:
        assert soon(lambda: stub.get("fz") > 0)
        stopped = run.snapshot()[0].removed
        stub.set(buttons=1)
        assert soon(lambda: run.snapshot()[0].removed > 0)
    assert stopped == 0
    with pytest.raises(ValueError, match="wall_clock must be True for a device that a hand holds, got False"):
        session(device, wall_clock=False)


def test_a_clutch_and_a_stop_button(stubs, tmp_path):
    """The burr stays while button 1 is held and then goes on from there; button 0 ends the session."""
    stub, device, file = stubs["omega"], burrlab.OmegaDevice(), tmp_path / "trace.h5"
    frame = burrlab.DeviceFrame(clutch=1)
    with session(device, frames=frame, stop_button=0, limits="omega.3", ramp=0, record=file) as run:
        assert stub.get("gripper") == 1
        stub.set(z=2.8)
        assert soon(lambda: stub.get("fz") > 0)
        stub.set(buttons=2)
        assert soon(lambda: not stub.force().any())
        stub.set(z=9.0)
        moved = run.ticks
        assert soon(lambda: run.ticks > moved + 50)
        stub.set(buttons=0)
        assert soon(lambda: stub.get("fz") > 0)
        stub.set(buttons=1)
        assert run.wait(10)
    assert (run.failed, run.reason) == (False, "a stop button of device 0 was pressed")
    assert not stub.force().any()
    trace = burrlab.load_trace(file)
    held = (trace.array("buttons") & 2) > 0
    assert np.ptp(trace.array("center_mm")[held], axis=0).max() == 0
    assert trace.array("removed_levels")[held].sum() == 0
    assert trace.array("center_mm")[-1, 2] == pytest.approx(2.8)
    assert burrlab.replay(trace).equal


def test_the_limit_knows_the_delay_of_the_servo(stubs):
    """A servo of 1 kHz plays a force one cycle after the position, for a cycle: 1.5 ms, later on a busy machine."""
    stub, device = stubs["touch"], burrlab.TouchDevice()
    assert np.isnan(device.delay)
    stub.set(z=2.8)
    with session(device, limits=burrlab.DeviceLimits("own", damping=5.0)) as run:
        assert soon(lambda: run.ticks > 100 and stub.get("fz") > 0)
    at = run.report().stability[0]
    assert device.delay == at["delay_ms"] > 1.3
    assert at["limit_N_per_mm"] == pytest.approx(5.0 / device.delay)


_SCRIPT = """
import os, signal, sys, burrlab
import burrlab.session.session as module
from stubs.stub import Stub
stub, end = Stub(os.environ["BURRLAB_LIBHD"]), signal.raise_signal
signal.raise_signal = lambda number: (print(stub.force().any(), stub.get("force_on"), flush=True), end(number))
stub.set(z=2.8)
end_exchanges = module.end_exchanges
module.end_exchanges = lambda: (
    print("handled", signal.getsignal(signal.SIGHUP) is not signal.SIG_DFL, flush=True), end_exchanges())
bone = burrlab.VoxelBone.block((30, 30, 10), 0.4, origin=(-14.8, -14.8, -9.8))
tool, device = (burrlab.Burr(3.0), burrlab.materials["bone"]), burrlab.TouchDevice()
with burrlab.Session(bone, tool, device, clock=burrlab.Clock(realtime=False), record=sys.argv[1]) as run:
    while not stub.force().any():
        run.wait(0.01)
    print("pulls", flush=True)
    run.wait()
"""


def test_a_signal_ends_the_force_first(stubs, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", f"{ROOT / 'tests'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    command = [sys.executable, "-c", _SCRIPT, tmp_path / "trace.h5"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "pulls\n"
        child.send_signal(signal.SIGHUP)
        assert child.stdout.read() == "handled True\nFalse 0.0\n"  # a second one, meanwhile, ends nothing
    assert child.returncode == -signal.SIGHUP
    assert burrlab.load_trace(tmp_path / "trace.h5").complete
    with session(burrlab.TouchDevice()):
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_motor_gets_the_limits_of_its_model(stubs, tmp_path):
    stub, file = stubs["touch"], tmp_path / "trace.h5"
    stub.set(z=1.0)
    with session(device := burrlab.TouchDevice(on_button=0), record=file, ramp=0.05) as run:
        assert soon(lambda: stub.get("fz") > 0.8)
    assert np.linalg.norm(burrlab.load_trace(file).array("sent_force_N"), axis=1).max() <= 3.3 + 1e-12
    note = burrlab.load_trace(file).note
    assert (note["limits"][0]["model"], note["limits"][0]["continuous_force_N"], note["ramp_s"]) == (
        "touch",
        0.88,
        0.05,
    )
    assert run.messages[0].endswith("; Safety(limits=None), or --model none, turns the model's limits off")
    with session(device, limits=None) as run:
        assert soon(lambda: stub.get("fz") > 7.0)
    assert not {"limits", "ramp_s"} & {*run.provenance}
    two = session(burrlab.HandDevice(), device, force_limit=2.0)
    assert [one.get("peak_force_N") for one in two.provenance["limits"]] == [None, 3.3]
    assert [rule[:22] for rule in two._limits.sentences] == ["burr 1: touch: force a"]
    assert (two.provenance["ramp_s"], two.provenance["force_limit_N"]) == ([0.0, 1.0], 2.0)


@pytest.mark.parametrize(
    ("hardware", "model", "peak", "lasting"),
    [
        ("Touch X", "touch_x", 7.9, 1.75), ("PHANTOM Omni", "phantom_omni", 3.3, 0.88), ("omega.7", "omega.7", 12, 12),
        ("inverse3 049D, verse_grip 7", "inverse3", 10, None), ("Desktop", "unknown model 'Desktop'", 3.3, 0.88),
    ],
)  # fmt: skip
def test_models_by_what_a_driver_names(hardware, model, peak, lasting):
    limits = limits_of_hardware(hardware)
    assert (limits.model, limits.peak_force, limits.continuous_force) == (model, peak, lasting)


def test_commands(stubs, capsys):
    rows = result(capsys, "devices")["devices"][:-1]  # the last is a haply
    assert [(row["device"], row["hardware"]) for row in rows] == [
        ("touch", "Stub Touch"), ("omega:0", "Stub omega.3"), ("omega:1", "Stub omega.6"),
    ]  # fmt: skip
    assert {row["library"] for row in rows} == {stub.file for stub in stubs.values()}
    stubs["omega"].set(1, uncalibrated=1)
    told = said(capsys, "devices")
    assert ("touch: Stub Touch, over " in told, "omega:1: omega:1 must be calibrated" in told) == (True, True)
    words = ["session", "--voxel", "0.4", "--duration", "0.1", "--no-realtime"]
    words += ["--device", "omega", "--device", "touch:Left"]
    said(capsys, *words)
    assert "must be a device of its own" in refusal(capsys, *words, "--device", "touch:Alias")
    stubs["touch"].set(1, size=np.nan)
    assert "touch:Left gave an orientation that is not a rotation" in said(capsys, *words, status=2)


def test_libraries_that_cannot_be_used(built, tmp_path, monkeypatch, capsys):
    text, other = tmp_path / "text.so", tmp_path / "other.so"
    text.write_text("text")
    image = bytearray(built("libhd").read_bytes())
    image[18] ^= 0xFF  # of the machine
    other.write_bytes(image)
    lacking = built("libhd", options=("-DhdGetErrorString=another",))
    refused(
        *(
            (
                functools.partial(burrlab.TouchDevice, library=str(file)),
                rf"libHD \(OpenHaptics\) must {words}",
            )
            for file, words in (
                ("none.so", "be installed, or BURRLAB_LIBHD must name its file"),
                (text, "be installed"),
                (other, f"be made for this program's kind of processor: {other} is made for another"),
                (lacking, f"have the function hdGetErrorString: {lacking} lacks it"),
            )
        )
    )
    monkeypatch.setenv("BURRLAB_LIBHD", "no_libhd.so")
    monkeypatch.setenv("BURRLAB_LIBDHD", "no_libdhd.so")
    rows = result(capsys, "devices")["devices"][:-1]
    assert [row["device"] for row in rows] == ["touch", "omega:0"]
    assert all(f"no_{LIBRARIES[row['device'][:5]]}.so" in row["why_not"] for row in rows)
