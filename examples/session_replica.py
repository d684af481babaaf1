"""A replica: another process or machine that holds the bone of a published session, bit for bit.

    python examples/session_replica.py [HOST] [--port 18944]

Without HOST it starts a leader of its own.
"""

from __future__ import annotations

import argparse
import contextlib

import burrlab
from burrlab.session.network import block_recipe, follow, make_bone


def leader() -> burrlab.Session:
    """A short session to follow, on any free port."""
    recipe = block_recipe((30, 16, 6), 0.1, origin=(-14.95, -7.95, -5.95))
    tool = burrlab.Burr(3.0), burrlab.materials["bone"]
    return burrlab.Session(
        burrlab.StartingBone(make_bone(recipe), source=recipe),
        tool,
        burrlab.HandDevice(),
        seed=1,
        duration=4.0,
        publish=0,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("host", nargs="?")
    parser.add_argument("--port", type=int, default=18944)
    options = parser.parse_args()

    with contextlib.ExitStack() as stack:
        host, port = options.host, options.port
        if host is None:
            own = stack.enter_context(leader())
            assert own.port is not None
            host, port = "127.0.0.1", own.port
            print("no leader given: following a session of this process")
        replica = follow(host, port)
        while not replica.wait(1.0):
            changed = replica.take()  # for a display: changes since the last call
            status = replica.status
            print(
                f"tick {changed['tick']}, {len(changed['bricks'])} bricks changed, "
                f"{status['digests_equal']} digests equal, {status['digests_different']} different"
            )
        status = replica.status
        print(f"ended: {status['reason']}; tick {status['tick']}, digest {replica.digest()}")
        bone, _ = replica.snapshot()
        print(f"{bone.removed:.2f} mm^3 removed")
        replica.stop()


if __name__ == "__main__":
    main()
