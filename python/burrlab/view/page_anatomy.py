"""What a page says of critical structures: how near the burrs are, and what happened."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from burrlab._core import VoxelBone
from burrlab.view.player import Burrs, TracePlayer

_KINDS = ("approach to", "touch of", "injury of", "away from")


class StructureDistances:
    """Distance of the nearest burr's surface to each critical structure of a bone; its fields are made in the background.

    Parameters
    ----------
    bone : VoxelBone
        One without critical tissues gives no rows.
    """

    def __init__(self, bone: VoxelBone) -> None:
        tissues = bone.tissues
        self._watch: Any = None
        self._bone: VoxelBone | None = None
        if tissues is not None and any(tissue.critical for tissue in tissues):
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
            self._watch = Watch(self._bone)
        except ValueError:  # no voxel of a critical tissue
            pass
        finally:
            self._bone = None


def event_texts(player: TracePlayer) -> list[tuple[float, str]]:
    """Time [s] and text of each event that a trace holds."""
    trace, events = player.trace, player.events
    if not len(events):
        return []
    names = [row["name"] for row in trace.watch["structures"]]
    texts = []
    for event in events:
        at = int(event["tick"]) - trace.first_tick
        time = float(player.history.time[min(max(at, 0), player.ticks - 1)])
        distance = float(event["distance_mm"])
        text = f"{_KINDS[event['kind']]} {names[event['structure']]}"
        texts.append((time, f"{text}, {distance:.2f} mm" if np.isfinite(distance) else text))
    return texts
