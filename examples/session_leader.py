"""A session that is recorded and published: the leader of two machines.

    python examples/session_leader.py [TRACE.h5] [--seconds 20] [--port 18944]

A simulated hand burrs a block of bone. Start examples/session_replica.py beside it with the same port, and
examples/session_peer.py to see what a standard OpenIGTLink program receives.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import burrlab
from burrlab.session.network import block_recipe, make_bone


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("trace", nargs="?", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--port", type=int, default=18944)
    options = parser.parse_args()
    path = options.trace or Path(tempfile.mkdtemp()) / "session.h5"

    recipe = block_recipe((30, 30, 10), 0.1, origin=(-14.95, -14.95, -9.95))  # top at z = 0
    tool = burrlab.Burr(3.0), burrlab.materials["bone"]
    session = burrlab.Session(
        burrlab.StartingBone(make_bone(recipe), source=recipe),
        tool,
        burrlab.HandDevice(push=1.0),
        seed=1,
        duration=options.seconds,
        record=path,
        publish=options.port,
        on_message=print,
    )
    print(f"published on port {session.port}, recorded in {path}")
    with session:
        while not session.wait(1.0):
            at = session.follower.stability(0)
            print(f"{session.ticks} ticks, {at['force_N']:.2f} N, {at['stiffness_N_per_mm']:.1f} N/mm")
    print(session.report())
    print(burrlab.replay(burrlab.load_trace(path)))


if __name__ == "__main__":
    main()
