"""What a replica did, and what it saw near critical structures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from burrlab._core import Replica
from burrlab.session.watch_rows import EVENT_DTYPE, Watched

if TYPE_CHECKING:
    from burrlab.anatomy.event import AnatomyEvent
    from burrlab.anatomy.report import AnatomyReport


_TOLD = 5  # faults and divergences told, the last ones


def status_text(status: Mapping[str, Any], *, interrupted: bool = False) -> str:
    """What a replica did, for a reader: where it ended, what it compared, how it was connected.

    Parameters
    ----------
    status : mapping
        `Replica.status` with the bone's `digest`.
    interrupted : bool
        By its user.
    """
    how = "interrupted" if interrupted else "failed" if status["failed"] else "ended"
    why = "" if interrupted else f" ({status['reason']})"
    lines = [
        f"{how}{why}: tick {status['tick']}, digest {status['digest']}",
        f"the leader's digests: {status['digests_equal']} equal, {status['digests_different']} different; "
        f"ticks with another result: {status['differing_ticks']}",
        f"connections: {status['connections']} made, {status['faults']} given up; went on by missing ticks "
        f"{status['by_ticks']}, by bricks {status['by_bricks']} times",
    ]
    if dropped := {reason: count for reason, count in status["dropped"].items() if count}:
        lines.append(
            f"messages dropped: {', '.join(f'{count} {reason}' for reason, count in dropped.items())}"
        )
    for tick, _, reason in status["last_faults"][-_TOLD:]:
        lines.append(f"  connection given up at tick {tick}: {reason}")
    for one in status["divergences"][-_TOLD:]:
        lines.append(
            f"  bone not the leader's at tick {one['tick']}: {one['what']}, {len(one['bricks'])} bricks replaced"
        )
    return "\n".join(lines)


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
