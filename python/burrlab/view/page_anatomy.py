"""What a page says of critical structures: how near the burrs are, and what happened."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from burrlab._core import VoxelBone
from burrlab.session.watch_rows import KINDS
from burrlab.view.player import Burrs, TracePlayer

_KINDS = {  # what is said of an event, and its colour
    "approach": ("approach to", "#ffb454"),
    "touch": ("touch of", "#ff7b72"),
    "injury": ("injury of", "#ff7b72"),
    "away": ("away from", "#7a8791"),
}


@dataclass(frozen=True)
class PageEvent:
    """Something that happened: when [s], in words, and the colour of its mark."""

    time: float
    text: str
    colour: str


class StructureDistances:
    """Distance of the nearest burr's surface to each critical structure of a bone; its fields are made in the background.

    Parameters
    ----------
    bone : VoxelBone
        One without critical tissues gives no rows.
    settings : mapping, optional
        Of the watch that looked at it; default: one of all critical tissues.
    """

    def __init__(self, bone: VoxelBone, settings: Mapping[str, Any] | None = None) -> None:
        tissues = bone.tissues
        self._watch: Any = None
        self._settings = settings
        self._bone: VoxelBone | None = None
        if tissues is not None and (settings or any(tissue.critical for tissue in tissues)):
            self._bone = bone.copy()  # the other goes on changing
        self._thread = threading.Thread(target=self._make, name="burrlab distances", daemon=True)

    def open(self) -> None:
        """Starts the work."""
        if self._bone is not None:
            self._thread.start()

    def close(self) -> None:
        """Waits for its end."""
        if self._thread.ident is not None:
            self._thread.join()

    @property
    def ready(self) -> bool:
        """All is there that will be."""
        return self._bone is None

    def rows(self, burrs: Burrs) -> list[dict[str, Any]]:
        """name, colour, value [mm] and near (below the approach's limit), a structure each; empty until it is ready."""
        watch = self._watch
        known = np.isfinite(burrs.centers).all(axis=1)
        if watch is None or not known.any():
            return []
        rows = []
        for name, colour, limit in zip(watch.structures, watch.colours, watch.limits, strict=True):
            nearest = min(
                float(watch.distance(center, name, radius=float(radius)))
                for center, radius in zip(burrs.centers[known], burrs.radii[known], strict=True)
            )
            rows.append({
                "name": name, "colour": "rgb({}, {}, {})".format(*colour), "near": nearest <= limit.approach,
                "value": f"{nearest:.2f}" if np.isfinite(nearest) else "far",
            })  # fmt: skip
        return rows

    def _make(self) -> None:
        from burrlab.anatomy.watch import Watch

        assert self._bone is not None
        try:
            self._watch = (
                Watch.of_settings(self._bone, self._settings) if self._settings else Watch(self._bone)
            )
        except ValueError:  # no voxel of a critical tissue
            pass
        finally:
            self._bone = None


def page_event(time: float, row: np.void, structures: Sequence[str]) -> PageEvent:
    """Of a row of a trace's or a watch's events."""
    kind, distance = KINDS[int(row["kind"])], float(row["distance_mm"])
    what, colour = _KINDS[kind]
    text = f"{what} {structures[int(row['structure'])]}"
    told = kind in ("approach", "away") and np.isfinite(distance)
    return PageEvent(time, f"{text}, {distance:.2f} mm" if told else text, colour)


def trace_events(player: TracePlayer) -> list[PageEvent]:
    """Those that a trace holds."""
    trace, events = player.trace, player.events
    if not len(events):
        return []
    names = [row["name"] for row in trace.watch["structures"]]
    at = [min(max(int(event["tick"]) - trace.first_tick, 0), player.ticks - 1) for event in events]
    return [
        page_event(float(player.history.time[i]), event, names) for i, event in zip(at, events, strict=True)
    ]
