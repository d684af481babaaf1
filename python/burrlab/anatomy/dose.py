"""A burr beside a structure: how near, how long, with what force, and what it took away."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from burrlab import _core
from burrlab.figures import new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Distances that time is counted within [mm], and those that force is looked at within [mm].
WITHIN: tuple[float, ...] = tuple(_core.dose_edges)
NEAR: tuple[float, ...] = tuple(_core.dose_near)


@dataclass(frozen=True)
class Dose:
    """One burr beside one structure in one session.

    Attributes
    ----------
    structure : str
    burr : int
    closest : float
        Smallest distance of the burr's surface [mm]; infinite if it never came within the field's reach.
    closest_tick : int or None
        When it was there first.
    closest_center : (float, float, float) or None
        Of the burr then [mm].
    time_within, turning_within : dict
        Distance [mm] -> time that the surface was at most so far [s]; the second with the burr on.
    touching : float
        Time at most `touch` away [s].
    removed : float
        From the structure by this burr [mm^3].
    mean_force, peak_force : dict
        Distance [mm] -> magnitude of the model's force, mean over the time and largest there [N]; NaN and 0 without time.
    """

    structure: str
    burr: int
    closest: float
    closest_tick: int | None
    closest_center: tuple[float, float, float] | None
    time_within: dict[float, float]
    turning_within: dict[float, float]
    touching: float
    removed: float
    mean_force: dict[float, float]
    peak_force: dict[float, float]

    @classmethod
    def of(cls, row: np.void, structure: str, burr: int, period: float, voxel_volume: float) -> Dose:
        """Of a row of a trace's doses; period [ms], volume [mm^3]."""
        seconds, near = period / 1000.0, row["near_periods"].tolist()
        came = math.isfinite(row["closest_mm"])
        within = [
            {d: n * seconds for d, n in zip(WITHIN, itertools.accumulate(row[name].tolist()), strict=False)}
            for name in ("periods", "turning")
        ]
        sums = row["near_force_N"].tolist()
        return cls(
            structure, burr, float(row["closest_mm"]), int(row["closest_tick"]) if came else None,
            tuple(row["closest_center_mm"].tolist()) if came else None, within[0], within[1],
            int(row["touching"]) * seconds, int(row["removed_levels"]) * (voxel_volume / 255.0),
            {d: force / n if n else math.nan for d, force, n in zip(NEAR, sums, near, strict=True)},
            dict(zip(NEAR, row["near_peak_N"].tolist(), strict=True)),
        )  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """For JSON, units in the names; None where there is no number."""
        return {
            "structure": self.structure, "burr": self.burr,
            "closest_mm": self.closest if math.isfinite(self.closest) else None,
            "closest_tick": self.closest_tick, "closest_center_mm": self.closest_center,
            "time_within_s": [{"mm": d, "s": s, "turning_s": self.turning_within[d]} for d, s in self.time_within.items()],
            "touching_s": self.touching, "removed_mm3": self.removed,
            "force_within": [
                {"mm": d, "mean_N": None if math.isnan(mean) else mean, "peak_N": self.peak_force[d]}
                for d, mean in self.mean_force.items()
            ],
        }  # fmt: skip


def dose_table(doses: Sequence[Dose]) -> str:
    """Two lines a burr and structure, as text: what came near with what force, and for how long."""
    width = max([len(d.structure) for d in doses] + [9]) + 2
    shown = WITHIN[1:]
    lines = [
        f"{'burr beside':<{width + 5}}{'closest':>9}{'touching':>9}{'removed':>9}"
        f"{'mean/peak force [N] within':>{14 * len(NEAR)}}",
        f"{'':<{width + 5}}{'[mm]':>9}{'[s]':>9}{'[mm^3]':>9}"
        + "".join(f"{f'{edge:g} mm':>14}" for edge in NEAR),
    ]
    for d in doses:
        closest = f"{d.closest:9.3f}" if math.isfinite(d.closest) else f"{'far':>9}"
        force = "".join(
            f"{'-' if math.isnan(d.mean_force[edge]) else f'{d.mean_force[edge]:.2f}/{d.peak_force[edge]:.2f}':>14}"
            for edge in NEAR
        )
        lines.append(f"{d.burr:<5}{d.structure:<{width}}{closest}{d.touching:9.2f}{d.removed:9.3g}{force}")
    lines.append(f"{'time [s] within':<{width + 5}}" + "".join(f"{f'{edge:g} mm':>9}" for edge in shown))
    for d in doses:
        times = "".join(f"{d.time_within[edge]:9.2f}" for edge in shown)
        lines.append(f"{d.burr:<5}{d.structure:<{width}}{times}")
    return "\n".join(lines)


def dose_figure(
    doses: Sequence[Dose], colours: Mapping[str, tuple[int, int, int]], figure: Figure | None = None
) -> list[Axes]:
    """Time within a distance, a line a structure (dashed: the second burr), and forces near it."""
    figure = new_figure(6.4, 5.6) if figure is None else figure
    top, bottom = figure.subplots(2, 1)
    for d in doses:
        colour = tuple(0.85 * part / 255.0 for part in colours.get(d.structure, (0, 0, 0)))
        name = d.structure if d.burr == 0 else f"{d.structure}, burr {d.burr}"
        top.plot(list(d.time_within), list(d.time_within.values()), color=colour, marker="o", markersize=3,
                 linewidth=1.2, linestyle="--" if d.burr else "-", label=name)  # fmt: skip
    top.set(xlabel="distance of the burr's surface [mm]", ylabel="time within [s]", ylim=(0, None))
    if doses:
        top.legend(fontsize=8, frameon=False)
    rows = np.arange(len(doses))
    for i, edge in enumerate(NEAR):
        at = rows + (i - 0.5 * (len(NEAR) - 1)) * 0.35
        shade = str(0.35 + 0.3 * i)
        bottom.barh(
            at, [d.peak_force[edge] for d in doses], 0.3, color=shade, label=f"peak within {edge:g} mm"
        )
        bottom.plot([d.mean_force[edge] for d in doses], at, "|", color="#D55E00", markersize=8,
                    label="mean" if i == 0 else None)  # fmt: skip
    bottom.set_yticks(rows, [d.structure if d.burr == 0 else f"{d.structure}, burr {d.burr}" for d in doses])
    bottom.invert_yaxis()
    bottom.set(xlabel="force [N]", xlim=(0, None))
    if doses:
        # above the bars, since there may be bars all over
        bottom.legend(fontsize=8, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return [tidy(axes) for axes in (top, bottom)]
