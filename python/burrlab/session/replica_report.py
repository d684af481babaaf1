"""What a replica saw near critical structures."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from burrlab._core import Replica
from burrlab.session.watch_rows import EVENT_DTYPE, Watched

if TYPE_CHECKING:
    from burrlab.anatomy.event import AnatomyEvent
    from burrlab.anatomy.report import AnatomyReport


def replica_events(replica: Replica, known: int = 0) -> list[AnatomyEvent]:
    """What happened near watched structures but for the first `known` events; none without a watch."""
    from burrlab.anatomy.event import AnatomyEvent

    settings = json.loads(replica.hello).get("watch")
    if not settings:
        return []
    names = [row["name"] for row in settings["structures"]]
    rows = replica.watched(known)["events"].view(EVENT_DTYPE)
    return [AnatomyEvent.of(row, names, settings["voxel_volume_mm3"]) for row in rows]


def replica_report(replica: Replica) -> AnatomyReport | None:
    """What the burrs of a leader did near its watched structures, as a replica saw it.

    Parameters
    ----------
    replica : Replica
        That `follow` gave.

    Returns
    -------
    AnatomyReport or None
        None where the bone has no tissues. It equals the leader's where the replica saw every tick and the bone was
        whole before the first: `removed` counts from the bone's pristine state, for a replica may come later.

    Raises
    ------
    TypeError
        If `replica` is none.
    """
    from burrlab.anatomy.report import AnatomyReport, nothing_watched

    if not isinstance(replica, Replica):
        raise TypeError(f"replica must be a Replica, got {type(replica).__name__}")
    bone, _ = replica.snapshot()
    if bone.tissues is None:
        return None
    hello = json.loads(replica.hello)
    settings = dict(hello.get("watch") or {})
    voxel_volume = float(np.prod(bone.spacing))
    volumes = np.array([bone.removed_of(number) for number in range(len(bone.tissues))])
    removed = np.rint(volumes * (255.0 / voxel_volume)).astype(np.int64)
    if settings:
        watched = Watched.of(replica.watched(), removed)
    else:
        watched = nothing_watched(len(hello["tools"]), removed)
    return AnatomyReport.of(watched, bone.tissues, settings, 1e3 / float(hello["rate_Hz"]), voxel_volume)
