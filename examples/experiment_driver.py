"""An experiment on a device driven from Python: where the code of a real haptic device goes.

    python examples/experiment_driver.py CONFIG.toml 01

Takes subject 01 through the tasks of a protocol at this terminal; the same command resumes an interrupted
run. The driver's loop runs all the time, in its own thread. In an interval the mailbox holds the force of the
material, between intervals zero.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np

import burrlab
from burrlab.psychophysics.protocol import Protocol
from burrlab.psychophysics.run import DeviceLost, Sitting, TerminalSeat


class Hardware:
    """In place of a device's library: a hand that lowers and lifts the burr of radius R [mm] once in 2 s.

    Its motors yield by 0.2 mm/N.
    """

    def __init__(self, radius: float) -> None:
        self.radius, self.force, self.begin = radius, np.zeros(3), time.perf_counter()

    def position(self) -> np.ndarray:
        """Centre of the burr, the untouched surface at z = 0 [mm]."""
        t = time.perf_counter() - self.begin
        return np.array([0.0, 0.0, self.radius + 0.8 * math.cos(math.pi * t)]) + 0.2 * self.force


@contextlib.contextmanager
def driven(hardware: Hardware, box: burrlab.MailboxDevice, on: bool) -> Iterator[None]:
    """Runs the driver's loop at about 400 Hz. If the loop ends early, the device counts as lost."""
    over = threading.Event()

    def loop() -> None:
        while not over.wait(0.002):
            box.put(hardware.position(), on=on)
            hardware.force = box.force
        hardware.force = np.zeros(3)

    thread = threading.Thread(target=loop, name="driver", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("config", metavar="CONFIG.toml")
    parser.add_argument("subject")
    options = parser.parse_args()
    protocol = Protocol.read(options.config)
    hardware = Hardware(protocol.burr.radius)
    box = burrlab.MailboxDevice(name="driver", lost_after=protocol.lost_after)
    sitting = Sitting(protocol, options.subject, device=box, again="the same command")
    try:
        # Probing erodes nothing, even with the switch on.
        with driven(hardware, box, on=True), TerminalSeat() as seat:
            sitting.run(lambda task: seat)
            seat.close("That was all. Thank you.")
    except (DeviceLost, KeyboardInterrupt) as error:  # the experimenter's log says why
        print("Please wait. Every answer is kept.")
        return 1 if isinstance(error, DeviceLost) else 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
