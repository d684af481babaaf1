"""Reports of secondary effects: accounts of substances, and what was given up for time."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class SubstanceBalance:
    """One substance's account in quanta of one level of one voxel, dV/255.

    Attributes
    ----------
    made : int
        Made by the burr, a wound or the nozzle.
    present : int
        In parcels; summed up anew.
    sucked : int
        Taken up by the sucker.
    drained : int
        Left the box around the volume.
    quantum : float
        [mm^3]
    """

    made: int
    present: int
    sucked: int
    drained: int
    quantum: float

    @property
    def exact(self) -> bool:
        """Whether made = present + sucked + drained."""
        return self.made == self.present + self.sucked + self.drained

    def volumes(self) -> dict[str, float]:
        """The account in mm^3."""
        return {name: getattr(self, name) * self.quantum for name in ("made", "present", "sucked", "drained")}

    def __str__(self) -> str:
        told = ", ".join(f"{name} {volume:.3f}" for name, volume in self.volumes().items())
        return f"{told} mm^3{'' if self.exact else ', NOT BALANCED'}"


@dataclass(frozen=True, repr=False)
class EffectsReport:
    """Frames, their time, and what was given up.

    Attributes
    ----------
    frames : int
        Frames made so far.
    budget : float or None
        Time limit of a frame [s].
    over_budget : int
        Frames that took longer, on the wall clock.
    coarse, cut : int
        Frames planned with fewer sub-steps than asked for; frames whose last sub-steps became one.
    skipped : int
        Frames that late ones stand for.
    crowded, merged : int
        Frames that merged parcels to save time; parcels merged into others, to save time or at the limit.
    sub_steps_least, sub_steps_most : int
    sub_steps_mean : float
        Sub-steps of a frame.
    parcels_most : int
        Most parcels at the end of a frame.
    wall_ms, cpu_ms : dict
        p50, p90, p99, p999 and max of a frame's time [ms]: on the wall clock, and its thread's CPU time.
    """

    frames: int
    budget: float | None
    over_budget: int
    coarse: int
    cut: int
    crowded: int
    skipped: int
    merged: int
    sub_steps_least: int
    sub_steps_most: int
    sub_steps_mean: float
    parcels_most: int
    wall_ms: dict[str, float]
    cpu_ms: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """The report for JSON."""
        return asdict(self)

    def __repr__(self) -> str:
        return f"EffectsReport({self.frames} frames, {self.over_budget} over budget)"

    def __str__(self) -> str:
        if not self.frames:
            return "no frame yet"
        lines = [
            f"{self.frames} frames of at most {self.parcels_most} parcels",
            f"a frame took: p50 {self.wall_ms['p50']:.2f} ms, p99 {self.wall_ms['p99']:.2f} ms, at most "
            f"{self.wall_ms['max']:.2f} ms (CPU time p99 {self.cpu_ms['p99']:.2f} ms)",
            f"sub-steps {self.sub_steps_least} to {self.sub_steps_most}, {self.sub_steps_mean:.2f} in "
            "the mean",
            f"{self.merged} parcels merged, {self.skipped} frames left out",
        ]
        if self.budget is not None:
            lines += [
                f"budget {1e3 * self.budget:g} ms: {self.over_budget} frames over it",
                f"given up: {self.coarse} frames with fewer sub-steps, {self.cut} cut, {self.crowded} with "
                "parcels merged",
            ]
        return "\n".join(lines)


def to_balance(raw: dict[str, tuple[int, int, int, int]], quantum: float) -> dict[str, SubstanceBalance]:
    return {name: SubstanceBalance(*account, quantum) for name, account in raw.items()}
