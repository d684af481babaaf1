"""Real sessions in separate processes, to be killed: python session_process.py SECONDS.

For each folder on standard input the program forks a process, which runs a session there, and prints "go".
On the next line it kills that process and prints "over". The session always shows its number of executed
ticks in the first eight bytes of FOLDER/ticks, and its stage in the ninth (1 loop runs, 2 recording is being
closed, 3 closed).
"""

import mmap
import os
import signal
import struct
import sys
import threading
import time
from pathlib import Path

import h5py  # noqa: F401  (once, not in each session)
import numpy as np

import burrlab


def run(folder: Path, seconds: float) -> None:
    with (folder / "ticks").open("r+b") as file:
        shown = mmap.mmap(file.fileno(), 9)
    bone = burrlab.VoxelBone.block((20, 12, 4), 0.2, origin=(-9.9, -5.9, -3.9))
    tool = burrlab.Burr(2.0), burrlab.materials["bone"]
    device = burrlab.MailboxDevice(name="test", lost_after=5000.0)  # however busy the machine is
    session = burrlab.Session(
        bone, tool, device, seed=5, clock=burrlab.Clock(digest_every=0.1), record=folder / "session.h5"
    )

    def show() -> None:
        while True:
            shown[:8] = struct.pack("<Q", session.ticks)
            time.sleep(0.0005)

    device.put((0.0, 0.0, 3.0))
    session.start()
    threading.Thread(target=show, daemon=True).start()
    shown[8] = 1
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < seconds:
        device.put((6.0 * np.sin(8.0 * now), 0.0, max(1.5, 2.2 - now)))
        time.sleep(0.002)
    shown[8] = 2
    session.stop()
    shown[8] = 3


if __name__ == "__main__":
    while line := sys.stdin.readline():
        child = os.fork()  # nothing but this thread runs here
        if child == 0:
            run(Path(line.strip()), float(sys.argv[1]))
            os._exit(0)
        print("go", flush=True)
        sys.stdin.readline()
        os.kill(child, signal.SIGKILL)  # not waited for yet, so the number is still its own
        os.waitpid(child, 0)
        print("over", flush=True)
