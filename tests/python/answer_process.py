"""A process that answers, to be killed or to hold a lock: python answer_process.py PROTOCOL COUNT [cut].

It prints a line when each answer is on the disk, and then waits. With "cut" only half of the last line is written.
"""

from __future__ import annotations

import os
import sys
import time

from answer_scenes import give

from burrlab.psychophysics.protocol import Protocol


def half_of(write):
    """A write that says that it wrote all of it."""

    def half(target, text):
        write(target, text[: len(text) // 2])
        return len(text)

    return half


def main() -> None:
    file, order = Protocol.read(sys.argv[1]).begin("01", "probing")
    count = int(sys.argv[2])
    for place in range(count):
        if sys.argv[3:] == ["cut"] and place == count - 1:
            os.write = half_of(os.write)
        give(file, order, 1)
        print(place, flush=True)
    time.sleep(600)


main()
