"""The report of a session: its counts and times, during and after it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from burrlab._core import Follower, HapticLoop, Histogram, Publisher
from burrlab.anatomy.report import AnatomyReport
from burrlab.common.figures import FORCE, REFERENCE, Axes, Panels, drawing, panels
from burrlab.common.records import Codec
from burrlab.common.table import ReportInHtml
from burrlab.session.devices import DeviceLimits
from burrlab.session.recorder import TraceWriter

Floats = np.ndarray[Any, np.dtype[np.float64]]

_QUANTILES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}
_NAMES = {
    "tick_time": "tick, CPU time", "wall_time": "tick, wall time",
    "jitter": "period jitter", "lateness": "after its deadline",
}  # fmt: skip


@dataclass(frozen=True, repr=False, eq=False)
class SessionReport(ReportInHtml):
    """A session's counts and times at one moment; `to_dict` has it for JSON.

    Attributes
    ----------
    state : str
        "running", or why it ended.
    ticks, late, missed, dropped : int
        Ticks executed; those with k > 1; deadlines without a tick of their own; periods that no tick stands
        for.
    times : dict
        For each of `tick_time`, `wall_time`, `jitter`, `lateness`: p50, p99, p99.9, max [us], nan without
        ticks.
    histograms : dict
        Counts of these times, over `edges` [us].
    follower : dict
        tick, behind [ticks], most_behind_s, rebuilds, differing, first_difference.
    stability : list of dict
        One a burr: see `Follower.stability`; with a model of a device also `model` and
        `model_stiffness_N_per_mm`, which it renders stably.
    energy : list of (float, float)
        One a burr: energy given to the hand minus taken from it, and the largest so far [mJ].
    network, recording : dict
        Status of publisher and recording; empty without them.
    notes, messages : tuple of str
        Rights granted by the system or not, assumptions on the bone's file; messages during the session.
    anatomy : AnatomyReport or None
        Volume removed of each tissue, and results of the watch; None without tissues.
    """

    state: str
    ticks: int
    late: int
    missed: int
    dropped: int
    times: dict[str, dict[str, float]]
    histograms: dict[str, np.ndarray[Any, np.dtype[np.uint64]]]
    edges: Floats
    follower: dict[str, Any]
    stability: list[dict[str, Any]]
    energy: list[tuple[float, float]]
    network: dict[str, Any]
    recording: dict[str, Any]
    notes: tuple[str, ...]
    messages: tuple[str, ...]
    anatomy: AnatomyReport | None = None

    @classmethod
    def of(
        cls,
        loop: HapticLoop,
        follower: Follower,
        publisher: Publisher | None,
        writer: TraceWriter | None,
        messages: Sequence[str],
        anatomy: AnatomyReport | None,
        notes: Sequence[str],
        limits: Sequence[DeviceLimits],
    ) -> "SessionReport":
        """The present report of these parts; `limits` are one a burr."""
        counts = loop.counts
        models = [
            {} if x.stiffness is None else {"model": x.model, "model_stiffness_N_per_mm": x.stiffness}
            for x in limits
        ]
        histograms: dict[str, Histogram] = {name: getattr(loop, name) for name in _NAMES}
        recording = {} if writer is None else {
            "file": str(writer.path), "ticks": writer.recorded,
            **{name: getattr(writer, name) for name in ("ended", "complete", "rescued")},
        }  # fmt: skip
        return cls(
            # a signal before the first tick ends the trace, not the loop
            state="running" if loop.running else loop.reason or recording.get("ended") or "not started",
            **{name: getattr(counts, name) for name in ("ticks", "late", "missed", "dropped")},
            times={
                name: {
                    **{key: h.quantile(q) for key, q in _QUANTILES.items()},
                    "max": h.largest if h.count else math.nan,
                }
                for name, h in histograms.items()
            },
            histograms={name: h.counts for name, h in histograms.items()},
            edges=histograms["jitter"].edges,
            follower=follower.status,
            stability=[{**follower.stability(burr), **model} for burr, model in enumerate(models)],
            energy=[loop.energy(burr) for burr in range(len(models))],
            network={} if publisher is None else publisher.status,
            recording=recording,
            notes=(*loop.realtime_notes, *notes),
            messages=tuple(messages),
            anatomy=anatomy,
        )

    def to_dict(self) -> dict[str, Any]:
        """A dict for JSON without the histograms, units in the names; unknown values are None."""
        return cast("dict[str, Any]", Codec().plain({
            "state": self.state, "ticks": self.ticks, "late": self.late, "missed": self.missed, "dropped": self.dropped,
            "times_us": self.times, "follower": self.follower, "stability": self.stability,
            "energy": [{"given_mJ": supplied, "most_mJ": most} for supplied, most in self.energy],
            "network": self.network, "recording": self.recording, "notes": self.notes, "messages": self.messages,
            **({} if self.anatomy is None else {"anatomy": self.anatomy.to_dict()}),
        }))  # fmt: skip

    def __str__(self) -> str:
        f = self.follower
        lines = [
            f"{self.state}: {self.ticks} ticks, {self.late} with k > 1, {self.missed} deadlines missed, "
            f"{self.dropped} periods dropped",
            f"  {'[us]':<20}" + "".join(f"{q:>9}" for q in (*_QUANTILES, "max")),
            *(
                f"  {_NAMES[name]:<20}" + "".join(f"{value:9.1f}" for value in times.values())
                for name, times in self.times.items()
                if not math.isnan(times["max"])
            ),
            f"  follower: tick {f['tick']}, {f['behind']} behind, at most {1e3 * f['most_behind_s']:.0f} ms; "
            f"rebuilt {f['rebuilds']} times",
        ]
        if f["differing"]:
            lines.append(
                f"  follower and loop DIFFER in {f['differing']} ticks, first in {f['first_difference']}"
            )
        for burr, (at, (energy, most)) in enumerate(zip(self.stability, self.energy, strict=True)):
            limit = (
                f"its force comes {at['delay_ms']:.2f} ms late, the device does not say its damping"
                if math.isnan(at["limit_N_per_mm"])
                else f"limit {at['limit_N_per_mm']:.3g}, ratio {at['ratio']:.2f}, exceeded {at['exceeded']} "
                f"{at['force_at_limit_N']:.2g} N"
            )
            lines.append(
                f"  burr {burr}: {at['force_N']:.2f} N, contact stiffness {at['stiffness_N_per_mm']:.3g} "
                f"N/mm; {limit}"
            )
            if "model" in at:
                lines.append(
                    f"  burr {burr}: {at['model']} renders {at['model_stiffness_N_per_mm']:.3g} N/mm stably; "
                    f"the contact is {at['stiffness_N_per_mm'] / at['model_stiffness_N_per_mm']:.2f} of that"
                )
            edge = "; round an edge the force law gives some, without any delay" if most > 0 else ""
            lines.append(
                f"  burr {burr}: energy given to the hand {energy:.3g} mJ, at most {most:.3g} mJ{edge}"
            )
        for name, part in (("network", self.network), ("recording", self.recording)):
            parts = [
                f"{key} {value}"
                for key, value in part.items()
                if value not in (0, "", {}) or key == "complete"
            ]
            lines += [f"  {name}: {', '.join(parts)}"] * bool(parts)
        anatomy = "" if self.anatomy is None else str(self.anatomy)
        lines += [f"  {line}" for line in (*anatomy.splitlines(), *self.notes)]
        return "\n".join([*lines, *(f"  ! {text}" for text in self.messages if text not in self.notes)])

    def __repr__(self) -> str:
        return f"SessionReport({self.state}, {self.ticks} ticks, {self.late} late, {self.dropped} periods dropped)"

    @drawing
    def plot(self, ax: Panels = None, **style: Any) -> list[Axes]:
        """Histograms of tick time and period jitter, logarithmic: two Axes, or a figure.

        `style`: label, color and other properties of the histograms.
        """
        all_axes = panels(ax, (1, 2), (6.4, 3.2))
        for axes, name in zip(all_axes, ("tick_time", "jitter"), strict=True):
            counts, edges = self.histograms[name].astype(float), self.edges
            if counts.any():
                counts, edges = _coarser(counts, edges)
                axes.stairs(counts, edges, **{"color": FORCE, "fill": True, **style})
                axes.set(xscale="log", yscale="log", ylim=(0.5, 4 * counts.max()))
                for key, line in zip(_QUANTILES, ("-", "--", ":"), strict=True):
                    value = self.times[name][key]
                    axes.axvline(value, color=REFERENCE, linestyle=line, label=f"{key}: {value:.3g} µs")
            else:
                axes.text(0.5, 0.5, "not measured", ha="center", transform=axes.transAxes)
            axes.set(xlabel=f"{_NAMES[name]} [µs]", ylabel="ticks")
        return all_axes


def _coarser(counts: Floats, edges: Floats) -> tuple[Floats, Floats]:
    """Wider bins, which the eye can tell apart, from the first to the last that is not empty."""
    width = 4
    counts = counts.reshape(-1, width).sum(axis=1)
    edges = np.append(edges[:-1:width], edges[-1])
    edges[0] = edges[1] ** 2 / edges[2]  # zero has no place on a logarithmic axis
    edges[-1] = edges[-2] ** 2 / edges[-3]
    used = np.flatnonzero(counts)
    return counts[used[0] : used[-1] + 1], edges[used[0] : used[-1] + 2]
