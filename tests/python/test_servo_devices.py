"""A Touch and an Omega in sessions, over stubs of the vendors' libraries (tests/stubs)."""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refusal, result

import burrlab
from burrlab.session.exchange import parse_device

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="the stubs need Linux and a C compiler"
)
SOURCES = Path(__file__).parents[1] / "stubs"
KINDS = {"touch": burrlab.TouchDevice, "omega": burrlab.OmegaDevice}
LIBRARIES = {"touch": "libhd", "omega": "libdhd"}


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """Compiles a stub; with options, another one."""
    folder = tmp_path_factory.mktemp("stubs")

    @functools.cache
    def compiled(name, *options):
        file = folder / f"{name}{len(options)}.so"
        subprocess.run(
            ["cc", "-std=gnu11", "-fPIC", "-shared", *options, SOURCES / f"{name}.c", "-o", file, "-lm", "-pthread"],
            check=True,
        )  # fmt: skip
        return file

    return compiled


class Stub:
    """A stub with a state of its own, in a copy of the file; also what the environment names."""

    def __init__(self, source, folder, monkeypatch):
        self.file = str(shutil.copy(source, folder))
        monkeypatch.setenv("BURRLAB_LIBHD" if "libhd" in source.name else "BURRLAB_LIBDHD", self.file)
        self._library = ctypes.CDLL(self.file)
        self._library.stub_get.restype = ctypes.c_double

    def set(self, device=0, **fields):
        for name, value in fields.items():
            self._library.stub_set(name.encode(), device, ctypes.c_double(value))

    def get(self, name, device=0):
        return self._library.stub_get(name.encode(), device)

    def force(self, device=0):
        return np.array([self.get(name, device) for name in ("fx", "fy", "fz")])


@pytest.fixture
def stubs(compiled, tmp_path, monkeypatch):
    return {kind: Stub(compiled(name), tmp_path, monkeypatch) for kind, name in LIBRARIES.items()}


def wait_for(what):
    end = time.monotonic() + 10.0
    while not what():
        assert time.monotonic() < end
        time.sleep(0.002)


def session(*devices, **options):
    bone = burrlab.VoxelBone.block((30, 30, 10), 0.4, origin=(-14.8, -14.8, -9.8))
    tools = [(burrlab.Burr(3.0), burrlab.materials["bone"])] * len(devices)
    return burrlab.Session(bone, tools, devices, seed=1, realtime=False, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_a_hand_meets_bone_and_the_cable_is_drawn(kind, stubs, tmp_path):
    stub, device, file = stubs[kind], KINDS[kind](on_button=0), tmp_path / "trace.h5"
    assert device.hardware.startswith("Stub")
    assert device.library == stub.file
    with session(device, record=file) as run:
        wait_for(lambda: run.ticks > 50)
        assert not stub.force().any()  # no contact yet
        stub.set(z=2.8, buttons=2)
        wait_for(lambda: stub.get("fz") > 0)
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
        wait_for(lambda: stub.get("fz") > 0)
        stopped = run.snapshot()[0].removed
        stub.set(buttons=1)
        wait_for(lambda: run.snapshot()[0].removed > 0)
    assert stopped == 0
    with pytest.raises(ValueError, match="wall_clock must be True for a device that a hand holds, got False"):
        session(device, wall_clock=False)


def test_commands(stubs, capsys):
    rows = result(capsys, "devices")["devices"]
    assert [(row["device"], row["hardware"]) for row in rows] == [
        ("touch", "Stub Touch"), ("omega:0", "Stub omega.3"), ("omega:1", "Stub omega.6"),
    ]  # fmt: skip
    assert {row["library"] for row in rows} == {stub.file for stub in stubs.values()}
    stubs["omega"].set(1, uncalibrated=1)
    code, out, _ = call(capsys, "devices")
    assert code == 0
    assert "touch: Stub Touch, over " in out
    assert "omega:1: omega:1 must be calibrated" in out
    words = ["session", "--voxel", "0.4", "--duration", "0.1", "--no-realtime"]
    words += ["--device", "omega", "--device", "touch:Left"]
    code, out, err = call(capsys, *words)
    assert code == 0, err
    assert "must be a device of its own" in refusal(capsys, *words, "--device", "touch:Alias")
    stubs["touch"].set(1, size=np.nan)
    code, _, err = call(capsys, *words)
    assert code == 2
    assert "touch:Left gave an orientation that is not a rotation" in err


def test_libraries_that_cannot_be_used(compiled, tmp_path, monkeypatch, capsys):
    def told(file):
        with pytest.raises(ValueError, match="libHD") as refused:
            burrlab.TouchDevice(library=str(file))
        return str(refused.value)

    good, bad = compiled("libhd"), tmp_path / "bad.so"
    assert "libHD (OpenHaptics) must be installed, or BURRLAB_LIBHD must name its file" in told("none.so")
    bad.write_text("text")
    assert "must be installed" in told(bad)
    image = bytearray(good.read_bytes())
    image[18] ^= 0xFF  # of the machine
    bad.write_bytes(image)
    assert f"must be made for this program's kind of processor: {bad} is made for another" in told(bad)
    lacking = compiled("libhd", "-DhdGetErrorString=another")
    assert f"must have the function hdGetErrorString: {lacking} lacks it" in told(lacking)
    monkeypatch.setenv("BURRLAB_LIBHD", "no_libhd.so")
    monkeypatch.setenv("BURRLAB_LIBDHD", "no_libdhd.so")
    rows = result(capsys, "devices")["devices"]
    assert [row["device"] for row in rows] == ["touch", "omega:0"]
    assert all(f"no_{LIBRARIES[row['device'][:5]]}.so" in row["why_not"] for row in rows)


def test_texts():
    assert [parse_device(text).name for text in ("touch", "touch:Left Hand")] == ["", "Left Hand"]
    assert [parse_device(text).index for text in ("omega", "omega:1")] == [0, 1]
    for text in ("touch:", "omega:", "omega:x", "omega:-1"):
        with pytest.raises(ValueError, match=r"must be hand, .* or omega\[:N\], got"):
            parse_device(text)
