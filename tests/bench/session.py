"""Timing of a session: a hand cuts bone at 1 kHz, recorded and published, alone and beside busy processes.

    python tests/bench/session.py [--seconds 120] [--json FILE]

Each case is its own session: with and without real-time priority, alone and beside two busy processes. The
tick is measured on its thread's CPU clock, the period on the wall clock. The results depend on the machine
and on its other users.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import burrlab

_BUSY = "while True: pass"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    results = []
    for busy in (0, 2):
        for realtime in (True, False):
            others = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(busy)]
            try:
                report = run(options.seconds, options.rate, realtime)
            finally:
                for other in others:
                    other.kill()
                    other.wait()
            results.append({"busy": busy, "realtime": realtime, "cpus": os.cpu_count(), **report.to_dict()})
            name = f"{busy} busy processes" if busy else "alone"
            print(
                f"{name}, {'with' if realtime else 'without'} real-time priority, {os.cpu_count()} "
                f"CPUs\n{report}\n",
                flush=True,
            )
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


def run(seconds: float, rate: float, realtime: bool) -> burrlab.SessionReport:
    """The report of a session: R = 3 mm in bone of 30 x 30 x 10 mm at 0.1 mm."""
    bone = burrlab.VoxelBone.block((30, 30, 10), 0.1, origin=(-14.95, -14.95, -9.95))
    tool = burrlab.Burr(3.0), burrlab.materials["bone"]
    with tempfile.TemporaryDirectory() as folder:
        session = burrlab.Session(
            bone, tool, burrlab.HandDevice(), seed=1, rate=rate, duration=seconds, record=Path(folder) / "trace.h5",
            publish=0, realtime=realtime,
        )  # fmt: skip
        with session:
            session.wait()
        return session.report()


if __name__ == "__main__":
    main()
