"""The check that all implementations equal tests/reference/tick.py, bit for bit, before they are timed."""

from typing import Any

import numpy as np
from native import Burring, Core, Levels, Native, Numbers
from numpy.typing import NDArray

from reference import tick as reference

TICKS = 3
FIRST_TICK = 2**32 - 2  # so that both words of the tick number matter


class Case:
    """A bone of random levels and a burr's path in it, partly outside the volume."""

    def __init__(self, scheme: str, alpha: float, resolution: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        side = int(2 * resolution) + 5
        self.shape = (side, side + 3, side - 2)
        self.p = rng.integers(0, 256, self.shape, dtype=np.uint8)
        self.p[rng.random(self.shape) < 0.5] = 255
        self.p[: side // 4] = 0
        eroded = rng.integers(0, self.p, self.shape, endpoint=True, dtype=np.uint8)
        self.q = np.where(rng.random(self.shape) < 0.5, self.p, eroded)
        self.burring = Burring(
            3.0 / resolution, 3.0, scheme, alpha=alpha, seed=2**40 + seed, origin=(-1.0, 2.0, 0.5)
        )
        middle = np.array(self.burring.origin) + self.burring.spacing * np.array(self.shape[::-1]) / 2
        self.centers = middle + rng.normal(0.0, 0.3, (TICKS, 3))


def index_sums(case: Case, q: Levels, center: Numbers) -> NDArray[np.int64]:
    """Mass and first moments about the voxel nearest to the centre, from the definition."""
    b = case.burring
    at = reference.geometry(center, b.radius, case.shape, (b.spacing,) * 3, b.origin)
    mass = reference.mass(q, case.p, at.coverage, b.scheme)
    index = np.indices(case.shape)[::-1]
    first = [int((mass * (index[axis] - int(at.base[axis]))).sum()) for axis in range(3)]
    return np.array([int(mass.sum()), *first])


def expected(case: Case, table: NDArray[np.float32]) -> tuple[NDArray[np.int64], Numbers, Levels]:
    """Sums (n, 5), moments (n, 4) and final levels of the reference."""
    b, q = case.burring, case.q.copy()
    contact = reference.ReferenceContact(
        q, case.p, b.spacing, b.origin, b.radius, b.c_e, b.alpha, "parabolic", b.seed, 0, b.scheme, table
    )
    contact.tick = FIRST_TICK
    sums, moments = [], []
    for center in case.centers:
        row, before = index_sums(case, q, center), int(q.sum())
        felt = contact.step(center, b.dt)
        sums.append([*row, before - int(q.sum())])
        moments.append([felt["m0"], *felt["m1"]])
    return np.array(sums), np.array(moments), q


def check_all(native: Native) -> int:
    """Number of comparisons; RuntimeError at the first that fails."""
    table, done = native.depth_table, 0
    for scheme in ("layer", "cell"):
        for alpha, resolution in ((0.087, 12.5), (0.6, 9.3), (0.087, 24.0)):
            case = Case(scheme, alpha, resolution, seed=done)
            sums, moments, levels = expected(case, table)
            found: dict[str, tuple[Any, ...]] = {}
            q = case.q.copy()
            found["plain"] = native.plain_run(q, case.p, case.burring, FIRST_TICK, case.centers)[1], sums, q
            for path in native.cpu_paths:
                core = Core.of(native, case.p, case.burring, path, q=case.q, tick=FIRST_TICK)
                own = np.empty((TICKS, 4))
                core.run(case.centers, moments=own)
                found[f"the core, {path}"] = own, moments, core.density()
            for name, (own, wanted, own_levels) in found.items():
                what = f"{name}, {scheme}, R/voxel {resolution:g}: {{}} not equal to tests/reference/tick.py"
                if not np.array_equal(own, wanted):
                    raise RuntimeError(what.format("sums are"))
                if not np.array_equal(own_levels, levels):
                    raise RuntimeError(what.format("levels are"))
            done += len(found)
    return done
