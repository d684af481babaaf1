"""Runs of the simulated hand on bone, for the stability tests and docs/stability.md.

`python tests/python/stability_cases.py` prints all cases that docs/stability.md sums up.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from burrlab import Burr, Material, VoxelBone, _core, materials

RADIUS = 3.0
SPACING = 0.1
SIZE = (26.0, 12.0, 9.0)  # [mm]
SWITCH = 2.0  # when a still burr begins to turn, after the push has settled [s]
HOLE = RADIUS / 3
GRID = [
    (material, hole, push)
    for material, pushes in (("bone", (0.3, 1.0, 2.0)), ("pettigrew", (0.3, 1.0, 2.0)), ("pvc", (0.1, 0.3)))
    for hole in (0.0, HOLE)
    for push in pushes
]


def block(hole: float) -> VoxelBone:
    """Solid bone, top at z = 0, with a spherical hole of this depth at the origin, as cut by a burr."""
    origin = (-SIZE[0] / 2 + SPACING / 2, -SIZE[1] / 2 + SPACING / 2, -SIZE[2] + SPACING / 2)
    bone = VoxelBone.block(SIZE, SPACING, origin=origin)
    if hole == 0:
        return bone
    z, y, x = np.meshgrid(
        *(o + SPACING * np.arange(n) for o, n in zip(origin[::-1], bone.shape, strict=True)),
        indexing="ij",
        sparse=True,
    )
    distance = np.sqrt(x**2 + y**2 + (z - (RADIUS - hole)) ** 2)
    share = np.clip((distance - RADIUS) / SPACING + 0.5, 0, 1)
    cut = _core.VoxelBone.__new__(_core.VoxelBone)
    cut.__setstate__((bone.pristine, np.rint(255 * share).astype(np.uint8), bone.spacing, bone.origin))
    return cut


def executor(material: str | Material, hole: float, period: float) -> _core.TickExecutor:
    known = materials[material] if isinstance(material, str) else material
    return _core.TickExecutor(block(hole), [(Burr(RADIUS), known)], 1, period=period)


def high_pass(force: np.ndarray, period: float) -> np.ndarray:
    """Force above 20 Hz: Butterworth, fourth order, forwards and backwards."""
    return sosfiltfilt(butter(4, 20.0, "highpass", fs=1e3 / period, output="sos"), force, axis=0)


@dataclass
class Run:
    """A run on the virtual clock; arrays of one row a tick."""

    material: str | Material
    hole: float
    push: float
    period: float
    damping: float
    position: np.ndarray  #: of the burr [mm]
    force: np.ndarray  #: sent to the hand [N]
    energy: np.ndarray  #: given to the hand [mJ]
    records: np.ndarray

    def window(self, start: float) -> slice:
        """Ticks from a time [s] until the burr is a radius deep, or to the end."""
        deep = np.flatnonzero(RADIUS - self.position[:, 2] > RADIUS)
        return slice(int(start * 1e3 / self.period), deep[0] if len(deep) else len(self.force))

    def ripple(self, window: slice) -> float:
        """Force above 20 Hz, peak to peak, of its largest component [N].

        The filter also sees the half second before the window. The last 50 ms are left out.
        """
        rate = 1e3 / self.period
        before = int(min(window.start, 0.5 * rate))
        passed = high_pass(self.force[window.start - before : window.stop], self.period)
        return float(np.ptp(passed[before : -int(0.05 * rate)], axis=0).max())

    def stiffness(self, tick: int) -> float:
        """Largest contact stiffness in any direction, where the bone of a tick carries the push [N/mm]."""
        again = executor(self.material, self.hole, self.period)
        again.execute(self.records[:tick])
        x, y, z = self.position[tick - 1]
        low, high = z + 0.6, z - 0.6
        for _ in range(50):
            middle = 0.5 * (low + high)
            pushed = again.probe(0, (x, y, middle)).force[2]
            low, high = (middle, high) if pushed < self.push else (low, middle)
        contact = again.probe(0, (x, y, low))
        normal = contact.normal / np.linalg.norm(contact.normal)
        inner, outer = (
            np.array([again.probe(0, (x, y, low) + shift * way).force for way in (*np.eye(3), normal)])
            for shift in (-0.02, 0.02)
        )
        slopes = (inner - outer) / 0.04
        return max(np.linalg.eigvalsh(0.5 * (slopes[:3] + slopes[:3].T))[-1], slopes[3] @ normal)

    @property
    def limit(self) -> float:
        """Stiffness below which the sampled spring is passive, b/(T/2) [N/mm]."""
        return 2 * self.damping / self.period


def run(
    material: str | Material,
    hole: float,
    push: float,
    seconds: float = 4.0,
    *,
    period: float = 1.0,
    coupling: float | None = None,
    **hand: object,
) -> Run:
    """A run of the hand on a block, on the virtual clock."""
    ticks = round(seconds * 1e3 / period)
    device = _core.HandDevice(start=(0, 0, RADIUS - hole + 0.3), push=push, **({"strokes": 0.0} | hand))
    ring = 2.2e-3 * period * ticks + 1  # the loop waits for a reader half a ring behind
    loop = _core.HapticLoop(
        executor(material, hole, period),
        [device],
        wall_clock=False,
        realtime=False,
        ticks=ticks,
        ring=ring,
        coupling=coupling,
    )
    reader = _core.RecordReader(loop)
    loop.start()
    assert loop.wait(120.0)
    records, lost = reader.take(ticks)
    assert not lost, loop.reason
    assert len(records) == ticks, loop.reason
    first = records["burr"][:, 0]
    work = (first["sent"][:-1] * np.diff(first["device_position"], axis=0)).sum(axis=1)  # each force is held
    energy = np.concatenate([[0.0], np.cumsum(work)])
    return Run(material, hole, push, period, device.damping, first["center"], first["sent"], energy, records)


def still(
    material: str | Material, hole: float, push: float, on: bool, **hand: object
) -> tuple[Run, float, float]:
    """A still push: (run, ripple [N], k over the limit, the larger at the two ends of the window)."""
    result = run(material, hole, push, 3.5, on=on, on_after=SWITCH, **hand)
    window = result.window(SWITCH + 0.1)
    ratio = max(result.stiffness(t) for t in (window.start, window.stop)) / result.limit
    return result, result.ripple(window), ratio


def main() -> None:
    print(
        "| material | hole | push | burr | still: k/limit | ripple | energy | strokes: ripple | at 10 kHz | "
        "energy |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for material, hole, push in GRID:
        for on in (False, True):
            rest, ripple, ratio = still(material, hole, push, on)
            moved = [run(material, hole, push, strokes=1.4, on=on, period=period) for period in (1.0, 0.1)]
            slow, fast = (m.ripple(m.window(2.0)) for m in moved)
            print(
                f"| {material} | {hole:g} mm | {push:g} N | {'on' if on else 'off'} | {ratio:.2f} | "
                f"{ripple:.4f} N | {rest.energy.max():.3f} mJ | {slow:.3f} N | {fast:.3f} N | "
                f"{moved[0].energy.max():.3f} mJ |",
                flush=True,
            )


if __name__ == "__main__":
    main()
