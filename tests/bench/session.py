"""Timing of a session: a hand cuts bone at 1 kHz, recorded and published, alone and beside busy processes.

    python tests/bench/session.py [--seconds 120] [--rate 1000] [--stub libhd|libdhd|haply]

Each case is its own session: with and without real-time priority, alone and beside two busy processes. The
tick is measured on its thread's CPU clock, the period on the wall clock. The results depend on the machine
and on its other users. --stub adds a burr of a device over a stub of the vendor's library, whose servo runs at
the rate of the loop, or over a mock of Haply's service in another process, and prints the age of its positions.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from options import options

import burrlab

sys.path.insert(0, str(Path(__file__).parents[1]))
from stubs.stub import Stub, compiled


def main() -> None:
    chosen = options(__doc__, seconds=120.0, rate=1000.0, stub={"choices": ("libhd", "libdhd", "haply")})
    for busy in (0, 2):
        for realtime in (True, False):
            with contextlib.ExitStack() as others:
                for _ in range(busy):
                    others.callback(subprocess.Popen([sys.executable, "-c", "while True: pass"]).kill)
                report = run(chosen.seconds, chosen.rate, realtime, chosen.stub)
            name = f"{busy} busy processes" if busy else "alone"
            print(
                f"{name}, {'with' if realtime else 'without'} real-time priority, {os.cpu_count()} "
                f"CPUs\n{report}\n",
                flush=True,
            )


def run(seconds: float, rate: float, realtime: bool, stub: str | None) -> burrlab.SessionReport:
    """The report of a session: R = 3 mm in bone of 30 x 30 x 10 mm at 0.1 mm."""
    bone = burrlab.VoxelBone.block((30, 30, 10), 0.1, origin=(-14.95, -14.95, -9.95))
    tool = burrlab.Burr(3.0), burrlab.materials["bone"]
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        devices: list[burrlab.Device] = [burrlab.HandDevice()]
        if stub == "haply":
            service = subprocess.Popen(
                [sys.executable, Path(__file__).parents[1] / "haply_service.py"],
                stdout=subprocess.PIPE,
                text=True,
            )
            stack.callback(service.wait)
            stack.callback(service.kill)
            assert service.stdout
            devices.append(burrlab.HaplyDevice("127.0.0.1", int(service.stdout.readline())))
        elif stub:
            library = Stub(compiled(stub, Path(folder)))
            library.set(rate=rate, x=10.0, z=3.0)
            devices.append(
                {"libhd": burrlab.TouchDevice, "libdhd": burrlab.OmegaDevice}[stub](library=library.file)
            )
        record = Path(folder) / "trace.h5"
        session = burrlab.Session(
            bone,
            [tool] * len(devices),
            devices,
            seed=1,
            clock=burrlab.Clock(rate=rate, realtime=realtime),
            duration=seconds,
            record=record,
            publish=0,
        )
        with session:
            session.wait()
        for burr, device in enumerate(devices):
            age = burrlab.load_trace(record).array("age_ms", burr)
            told = ", ".join(f"{np.quantile(age, q):.3f}" for q in (0.5, 0.99, 0.999, 1.0))
            print(f"{device.name}: age of the position, median, 99 %, 99.9 %, most: {told} ms")
        return session.report()


if __name__ == "__main__":
    main()
