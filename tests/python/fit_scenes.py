"""Data sets that the tests of the fit share, and their fits, each made once."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from burrlab import (
    Burr,
    Fit,
    Indentation,
    VelocityCurve,
    fit,
    materials,
    synthetic_curve,
    synthetic_indentation,
    synthetic_trace,
)

BURR, BONE = Burr(3.0), materials["bone"]
FORCES = np.geomspace(0.3, 2.6, 6)


def curve_of(
    forces: Any = FORCES, *, burr: Burr = BURR, material: Any = BONE, **options: Any
) -> VelocityCurve:
    """A synthetic curve: two repeats, 8 % scatter."""
    return synthetic_curve(burr, material, forces, **{"seed": 3, "scatter": 0.08, "repeats": 2} | options)


def with_sigma(data: Any, part: float = 0.08) -> Any:
    return replace(data, sigma=part * (data.force if isinstance(data, Indentation) else data.velocity))


DATA = {
    "wide": curve_of(), "ridge": curve_of([0.3, 0.4, 0.5, 0.6]), "trace": synthetic_trace(BURR, BONE, 1.0, seed=1),
    "pressed": synthetic_indentation(BURR, BONE, [0.05, 0.1, 0.2, 0.3], scatter=0.06, seed=2),
    "overloaded": curve_of([0.5, 0.8, 1.2, 3.9], seed=2),
}  # fmt: skip
DATA |= {f"{name}, sigma": with_sigma(DATA[name]) for name in ("wide", "pressed")}


@cache
def fitted(*names: str, **options: Any) -> Fit:
    return fit([DATA[name] for name in names], **options)


def plain(result: Fit) -> dict[str, Any]:
    """What two equal fits have in common: all but the time they took."""
    return {key: value for key, value in result.to_dict().items() if key != "seconds"}
