"""A device driven from Python: where the code of a real haptic device, a robot or a mouse goes.

    python examples/session_driver.py [--seconds 4]

The driver's loop reads its hardware, leaves the position in a mailbox and takes the force from it. It may be
slower than the session's loop, and late: the session uses the latest position, and ends when that is 100 ms
old.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

import burrlab


class Hardware:
    """In place of a device's library: it follows a circle, and its motors yield by 0.2 mm/N."""

    def __init__(self) -> None:
        self.begin = time.perf_counter()
        self.force = np.zeros(3)

    def position(self) -> np.ndarray:
        t = time.perf_counter() - self.begin
        drawn = np.array([4 * math.sin(3 * t), 4 * math.cos(3 * t), 2.2 - 0.1 * t])
        return drawn + 0.2 * self.force


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=4.0)
    seconds = parser.parse_args().seconds

    bone = burrlab.VoxelBone.block((16, 16, 6), 0.1, origin=(-7.95, -7.95, -5.95))
    tool = burrlab.Burr(2.0), burrlab.materials["bone"]
    hardware, box = Hardware(), burrlab.MailboxDevice(name="circle")
    with burrlab.Session(
        bone, tool, box, seed=1, safety=burrlab.Safety(coupling=2.0), on_message=print
    ) as session:
        while time.perf_counter() - hardware.begin < seconds and session.running:
            box.put(hardware.position(), on=True)
            hardware.force = box.force
            time.sleep(0.002)  # a driver at about 400 Hz
        session.stop("the driver has done its circle")
    print(session.report())


if __name__ == "__main__":
    main()
