"""How well force, surface and radius must be known in a fit: `python examples/offsets.py [offsets.png]`.

Marked lines: half the width of the 95 % interval of alpha/c_e^p in a fit that is told (`uncertain`). Dashed: how far the
offset moves a fit that is not told. Eight forces of 0.3 to 2.2 N, 3, 10 and 30 runs each, scatter 5 %.
"""

import sys

import numpy as np

import burrlab
from burrlab.common.figures import SERIES, new_figure, tidy

OFFSETS = {
    "force": ("N", (0.002, 0.005, 0.01, 0.02, 0.04)),
    "surface": ("mm", (0.005, 0.01, 0.02, 0.05, 0.08)),
    "radius": ("mm", (0.005, 0.01, 0.02, 0.05, 0.1)),
}


def half_width(fit: burrlab.Fit) -> float:
    """Of the 95 % interval of alpha/c_e^p, in per cent."""
    assert fit.identified is not None
    return 50 * float(np.log(fit.identified.interval.ratio()))


def main(path: str) -> None:
    burr, bone = burrlab.Burr(3.0), burrlab.materials["bone"]
    figure = new_figure(9.6, 3.4)
    panels = figure.subplots(1, 3, sharey=True)
    forces = np.geomspace(0.3, 2.2, 8)
    for look, runs in zip(SERIES, (3, 10, 30), strict=False):
        curve = burrlab.synthetic_curve(burr, bone, forces, repeats=runs, scatter=0.05, seed=1)
        plain = burrlab.fit(curve)
        for ax, (name, (_, sizes)) in zip(panels, OFFSETS.items(), strict=True):
            told = [half_width(burrlab.fit(curve, uncertain={name: size})) for size in sizes]
            style = {**look, "linestyle": "-", "markersize": 4}
            ax.plot((0, *sizes), (half_width(plain), *told), label=f"{runs} runs at each force", **style)
    moved = {x.offset: 100 * abs(x.moved) / x.size for x in plain.sensitivity}
    for ax, (name, (unit, sizes)) in zip(panels, OFFSETS.items(), strict=True):
        ends = np.array([0, sizes[-1]])
        ax.plot(ends, moved[name] * ends, "--", color="0.4", label="how far a fit moves that is not told")
        ax.set(xlabel=f"standard deviation of the {name} [{unit}]", xlim=(0, None), ylim=(0, 16))
        tidy(ax)
    panels[0].set_ylabel(r"error of $\alpha/c_e^p$ [%]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "offsets.png")
