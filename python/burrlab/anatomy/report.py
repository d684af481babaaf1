"""Reports on burrs near critical structures: distance, time and force, and the tissues removed."""

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from burrlab._core import Tissues, dose_edges, dose_near
from burrlab.anatomy.events import EVENT_KEYS, AnatomyEvent, Watched
from burrlab.anatomy.watch import check_structure
from burrlab.common.check import refuse
from burrlab.common.figures import VELOCITY, Axes, Panels, drawing, panels, styled
from burrlab.common.records import AsDict, Codec
from burrlab.common.table import ReportInHtml

#: Distances within which time is counted [mm], and within which force is looked at [mm].
WITHIN: tuple[float, ...] = tuple(dose_edges)
NEAR: tuple[float, ...] = tuple(dose_near)


@dataclass(frozen=True)
class Dose(AsDict):
    """One burr beside one structure in one session.

    Attributes
    ----------
    structure : str
    burr : int
    closest : float
        Smallest distance of the burr's surface [mm]; infinite if it never came within the field's reach.
    closest_tick : int or None
        First tick at this distance.
    closest_center : (float, float, float) or None
        Burr centre then [mm].
    time_within, turning_within : dict
        Distance [mm] -> time that the surface was at most so far [s]; the second with the burr on.
    touching : float
        Time at most `touch` away [s].
    removed : float
        Removed from the structure by this burr [mm^3].
    mean_force, peak_force : dict
        Distance [mm] -> mean over time and largest magnitude of the model's force within it [N]; NaN and 0
        without time.
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
    def of(cls, row: np.void, structure: str, burr: int, period: float, voxel_volume: float) -> "Dose":
        """The dose in a row of a trace's doses; period [ms], volume [mm^3]."""
        seconds, near = period / 1000.0, row["near_periods"].tolist()
        came = math.isfinite(row["closest_mm"])
        within = [
            {d: n * seconds for d, n in zip(WITHIN, itertools.accumulate(row[name].tolist()), strict=False)}
            for name in ("periods", "turning")
        ]
        return cls(
            structure, burr, float(row["closest_mm"]), int(row["closest_tick"]) if came else None,
            tuple(row["closest_center_mm"].tolist()) if came else None, within[0], within[1],
            int(row["touching"]) * seconds, int(row["removed_levels"]) * (voxel_volume / 255.0),
            {
                d: force / n if n else math.nan
                for d, force, n in zip(NEAR, row["near_force_N"].tolist(), near, strict=True)
            },
            dict(zip(NEAR, row["near_peak_N"].tolist(), strict=True)),
        )  # fmt: skip


def dose_table(doses: Sequence[Dose]) -> str:
    """Text with two lines for each burr and structure: distance and force, then times."""
    width = max([len(d.structure) for d in doses] + [9]) + 2
    edges = WITHIN[1:]
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
    return "\n".join([
        *lines,
        f"{'time [s] within':<{width + 5}}" + "".join(f"{f'{edge:g} mm':>9}" for edge in edges),
        *(
            f"{d.burr:<5}{d.structure:<{width}}" + "".join(f"{d.time_within[edge]:9.2f}" for edge in edges)
            for d in doses
        ),
    ])  # fmt: skip


#: Least time that the report calls a touch [s], and least volume for an injury [mm^3]; ours. A hand does not
#: answer to a shorter contact. A segmentation knows its surface to half a voxel: at 0.2 mm a dent of that
#: depth h, by a burr of R = 3 mm, holds pi h^2 (R - h/3) = 0.093 mm^3.
TOUCH_TIME, INJURY_VOLUME = 0.1, 0.1
#: The report and its plot show as many structures.
SHOWN = 5


@dataclass(frozen=True, repr=False, eq=False)
class AnatomyReport(ReportInHtml, AsDict):
    """Report on burrs near critical structures, and on the tissues removed. Made by `anatomy_report`.

    Attributes
    ----------
    structures : tuple of str
        Watched structures; none without a watch.
    settings : dict
        Settings of the watch.
    tissues : tuple of str
    watched : Watched
        The numbers behind the report, as a trace keeps them.
    period : float
        Loop period [ms].
    voxel_volume : float
        [mm^3]
    """

    structures: tuple[str, ...]
    settings: dict[str, Any]
    tissues: tuple[str, ...]
    watched: Watched
    period: float
    voxel_volume: float
    colours: dict[str, tuple[int, int, int]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        watched: Watched,
        tissues: Tissues,
        settings: Mapping[str, Any],
        period: float,
        voxel_volume: float,
    ) -> "AnatomyReport":
        """The report of a watch with these settings in a bone of these tissues. Empty settings: no watch."""
        return cls(
            tuple(row["name"] for row in settings.get("structures", ())), dict(settings), tuple(t.name for t in tissues),
            watched, period, voxel_volume, {t.name: t.colour for t in tissues},
        )  # fmt: skip

    @classmethod
    def recorded(cls, trace: Any) -> "AnatomyReport | None":
        """The report of the session itself; None if it had no watch or did not come to its end."""
        if not hasattr(trace, "watched"):
            raise TypeError(f"trace must be a Trace, as load_trace gives it, got {trace!r}")
        if trace.watched is None or trace.tissues is None:
            return None
        return cls.of(trace.watched, trace.tissues, trace.watch, trace.period, trace.voxel_volume)

    @property
    def burrs(self) -> int:
        """Number of burrs."""
        return len(self.watched.doses)

    @property
    def events(self) -> tuple[AnatomyEvent, ...]:
        """The events in their order."""
        return tuple(AnatomyEvent.of(row, self.structures, self.voxel_volume) for row in self.watched.events)

    @property
    def closest(self) -> dict[str, float]:
        """Smallest distance of a burr's surface to each structure [mm]; infinite if none came near."""
        return dict(zip(self.structures, self.watched.doses["closest_mm"].min(axis=0).tolist(), strict=True))

    @property
    def removed(self) -> dict[str, float]:
        """Volume removed of each tissue in the session [mm^3]."""
        volumes = self.watched.removed * (self.voxel_volume / 255.0)
        return dict(zip(self.tissues, volumes.tolist(), strict=True))

    @property
    def touched(self) -> dict[str, float]:
        """Time that burrs were within `touch` of structures, by name, if at least 0.1 s [s].

        Events and doses have every touch, to the tick.
        """
        times = (self.watched.doses["touching"].sum(axis=0) * (self.period / 1000.0)).tolist()
        return {name: time for name, time in zip(self.structures, times, strict=True) if time >= TOUCH_TIME}

    @property
    def injured(self) -> dict[str, float]:
        """Volume removed from watched structures, by name, if at least the watch's limit, or 0.1 if that is 0 [mm^3].

        Events and doses have every injury, to the level.
        """
        removed = self.removed
        return {name: removed[name] for name, least in self._injury_volumes.items() if removed[name] >= least}

    @property
    def _injury_volumes(self) -> dict[str, float]:
        return {
            row["name"]: float(row["injury_mm3"]) or INJURY_VOLUME
            for row in self.settings.get("structures", ())
        }

    def dose(self, structure: str, burr: int = 0) -> Dose:
        """The dose of a burr beside a structure.

        Raises
        ------
        ValueError
            If the structure was not watched, or there is no such burr.
        """
        check_structure(structure, self.structures)
        refuse(not 0 <= burr < self.burrs, f"burr must be an index below {self.burrs}, got {burr}")
        row = self.watched.doses[burr, self.structures.index(structure)]
        return Dose.of(row, structure, burr, self.period, self.voxel_volume)

    @property
    def doses(self) -> list[Dose]:
        """The dose of each burr beside each structure."""
        return [self.dose(name, burr) for burr in range(self.burrs) for name in self.structures]

    @property
    def _shown(self) -> tuple[list[Dose], str]:
        """Doses beside the structures that burrs came nearest to, and a sentence on the others."""
        nearest = sorted(self.structures, key=self.closest.__getitem__)
        left_out = len(nearest[SHOWN:])
        doses = [dose for dose in self.doses if dose.structure in nearest[:SHOWN]]
        return doses, f"{left_out} structures farther away are left out" if left_out else ""

    def equals(self, other: "AnatomyReport") -> bool:
        """Whether settings, events, doses and removed levels are the same to the bit."""
        numbers = [
            [part.tobytes() for part in (watched.events, watched.doses, watched.removed, watched.counts)]
            for watched in (self.watched, other.watched)
        ]
        return self.settings == other.settings and numbers[0] == numbers[1]

    def table(self) -> str:
        """Doses beside all structures, as text."""
        return dose_table(self.doses)

    def __str__(self) -> str:
        removed = ", ".join(f"{name} {volume:.4g}" for name, volume in self.removed.items() if volume)
        lines = [f"removed [mm^3]: {removed or 'nothing'}"]
        if self.structures:
            least = " or ".join(f"{volume:g}" for volume in dict.fromkeys(self._injury_volumes.values()))
            doses, others = self._shown
            kinds = Counter(event.kind for event in self.events)
            counts = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
            lines += [
                f"touched for {TOUCH_TIME:g} s or more [s]: {_listed(self.touched)}",
                f"injured by {least} mm^3 or more [mm^3]: {_listed(self.injured)}",
                dose_table(doses),
                *[others] * bool(others),
                f"events: {counts or 'none'}" + ", each to the tick, however small" * bool(counts),
                *[f"  {event}" for event in self.events if event.kind in ("touch", "injury")][:20],
            ]
        w = self.watched
        if w.events_lost:
            lines.append(f"  ! {w.events_lost} further events were counted, not kept")
        if w.gaps:
            lines.append(
                f"  ! {w.ticks_passed_over} ticks were passed over in {w.gaps} gaps: what was removed is "
                "whole, a closer approach may have been missed"
            )
        return "\n".join(lines)

    def __repr__(self) -> str:
        near = ", ".join(f"{name} {d:.3g} mm" for name, d in self.closest.items())
        return f"AnatomyReport({near or 'nothing watched'}; {len(self.watched.events)} events)"

    @drawing
    def plot(self, ax: Panels = None, *, label: str | None = None, **style: Any) -> list[Axes]:
        """Charts of the time within a distance of structures, and of the force there.

        Drawn are the five structures that burrs came nearest to; the title says how many are left out. A second
        burr's lines are dashed. `ax` is a figure or two Axes, `label` is said before each structure.
        """
        doses, others = self._shown
        top, bottom = panels(ax, (2, 1), (6.4, 5.6))
        names = [d.structure if d.burr == 0 else f"{d.structure}, burr {d.burr}" for d in doses]
        for name, d in zip(names, doses, strict=True):
            colour = tuple(0.85 * part / 255.0 for part in self.colours.get(d.structure, (0, 0, 0)))
            top.plot(
                list(d.time_within),
                list(d.time_within.values()),
                label=f"{label}, {name}" if label else name,
                **styled(style, color=colour, marker="o", ms=3, lw=1.2, linestyle="--" if d.burr else "-"),
            )
        top.set(
            xlabel="distance of the burr's surface [mm]",
            ylabel="time within [s]",
            ylim=(0, None),
            title=others,
        )
        if doses:
            top.legend()
        rows = np.arange(len(doses))
        for i, edge in enumerate(NEAR):
            at = rows + (i - 0.5 * (len(NEAR) - 1)) * 0.35
            bottom.barh(
                at, [d.peak_force[edge] for d in doses], 0.3, color=str(0.35 + 0.3 * i),
                label=f"peak within {edge:g} mm",
            )  # fmt: skip
            bottom.plot([d.mean_force[edge] for d in doses], at, "|", color=VELOCITY, markersize=8,
                        label="mean" if i == 0 else None)  # fmt: skip
        bottom.set_yticks(rows, names)
        bottom.invert_yaxis()
        bottom.set(xlabel="force [N]", xlim=(0, None))
        return [top, bottom]


def _listed(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items()) or "nothing"


Dose._codec = AnatomyReport._codec = Codec(
    keys={
        Dose: {
            "structure": "structure", "burr": "burr", "closest_mm": "closest", "closest_tick": "closest_tick",
            "closest_center_mm": "closest_center",
            "time_within_s": lambda dose: [
                {"mm": d, "s": s, "turning_s": dose.turning_within[d]} for d, s in dose.time_within.items()
            ],
            "touching_s": "touching", "removed_mm3": "removed",
            "force_within": lambda dose: [
                {"mm": d, "mean_N": mean, "peak_N": dose.peak_force[d]} for d, mean in dose.mean_force.items()
            ],
        },
        AnatomyReport: {
            "removed_mm3": "removed", "watch": "settings", "touched_s": "touched",
            "touched_from_s": lambda report: TOUCH_TIME, "injured_mm3": "injured",
            "injured_from_mm3": "_injury_volumes", "closest_mm": "closest", "doses": "doses", "events": "events",
            "gaps": lambda report: report.watched.gaps,
            "ticks_passed_over": lambda report: report.watched.ticks_passed_over,
            "events_lost": lambda report: report.watched.events_lost,
        },
        **EVENT_KEYS,
    }
)  # fmt: skip
