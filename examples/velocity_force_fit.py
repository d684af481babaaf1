"""c_e and alpha from a CSV of force and penetration velocity.

    python examples/velocity_force_fit.py [DATA.csv RADIUS_MM [OUT.png]]

Without a file it makes synthetic data: the mean-field curve of bone with a scatter of 8 %.
"""

from __future__ import annotations

import sys

import numpy as np

import burrlab


def main(data: str = "", radius: str = "3.0", figure: str = "fit.png") -> None:
    burr = burrlab.Burr(float(radius))
    if not data:
        data = "synthetic.csv"
        made_with = burrlab.materials["bone"]
        forces = np.linspace(0.4, 2.6, 10)
        burrlab.synthetic_curve(burr, made_with, forces, repeats=3, scatter=0.08, seed=1).to_csv(data)
    curve = burrlab.VelocityCurve.from_csv(data)
    fit = burrlab.fit(curve, burr)
    print(fit.report())
    fit.plot(alpha_lines=0.01).get_figure().savefig(figure, dpi=200)


if __name__ == "__main__":
    main(*sys.argv[1:4])
