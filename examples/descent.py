"""One descent with the virtual rig, and the same with the force held exactly.

python examples/descent.py [OUT.png]
"""

from __future__ import annotations

import sys

import burrlab


def main(figure: str) -> None:
    burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    run = burrlab.descend(burr, bone, 0.8, voxel=0.1, seed=1)
    print("controller and rig: ", run)
    exact = burrlab.descend(burr, bone, 0.8, voxel=0.1, seed=1, ideal=True)
    print("force held exactly: ", exact)
    print(
        f"continuum:           {burrlab.penetration_velocity(burr, bone, 0.8):.4g} mm/s in the default window"
    )
    run.plot()[0].get_figure().savefig(figure, dpi=200)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "descent.png")
