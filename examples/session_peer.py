"""A standard OpenIGTLink program beside a session: reads the burr's pose.

    python examples/session_peer.py [--port 18944]

Uses pyigtl (pip install pyigtl), which keeps only the newest message of a device and does not know SENSOR,
the message of the force. Without --port it starts a session of its own.
"""

from __future__ import annotations

import argparse
import contextlib
import sys

import burrlab


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--port", type=int)
    parser.add_argument("--count", type=int, default=20)
    options = parser.parse_args()
    try:
        import pyigtl
    except ImportError:
        sys.exit("this example needs pyigtl: pip install pyigtl")

    with contextlib.ExitStack() as stack:
        port = options.port
        if port is None:
            bone = burrlab.VoxelBone.block((30, 16, 6), 0.1, origin=(-14.95, -7.95, -5.95))
            tool = burrlab.Burr(3.0), burrlab.materials["bone"]
            own = burrlab.Session(bone, tool, burrlab.HandDevice(), seed=1, duration=30.0, publish=0)
            port = stack.enter_context(own).port
        client = pyigtl.OpenIGTLinkClient("127.0.0.1", port)
        stack.callback(client.stop)
        for _ in range(options.count):
            pose = client.wait_for_message("burrlab_burr_0", timeout=5)
            if pose is None:
                sys.exit(f"nothing came from port {port} within 5 s")
            x, y, z = pose.matrix[:3, 3]
            print(f"burr at R {x:7.3f}, A {y:7.3f}, S {z:7.3f} mm")


if __name__ == "__main__":
    main()
