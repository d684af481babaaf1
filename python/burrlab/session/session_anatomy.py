"""A session's part that looks at tissues: what was removed of each, and what a watch saw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from burrlab import _core
from burrlab._core import Burr, Follower, Material, VoxelBone
from burrlab.session.watch_rows import EVENT_DTYPE, Watched

if TYPE_CHECKING:
    from burrlab.anatomy.report import AnatomyReport
    from burrlab.anatomy.watch import Watch


class SessionAnatomy:
    """Asks a follower what it saw; says each event once.

    Parameters
    ----------
    bone : VoxelBone
        Before the first tick.
    follower : Follower
        Not yet started.
    tools : sequence of (Burr, Material)
    watch : Watch or None
    period : float
        Of the loop [ms].

    Raises
    ------
    ValueError
        If the watch is of another bone.
    """

    def __init__(
        self,
        bone: VoxelBone,
        follower: Follower,
        tools: Sequence[tuple[Burr, Material]],
        watch: Watch | None,
        period: float,
    ) -> None:
        self.watch = watch
        self._follower, self._burrs, self._period = follower, len(tools), period
        self._tissues, self._voxel_volume = bone.tissues, float(np.prod(bone.spacing))
        self._before = _core.tissue_levels(bone)
        self._told = 0
        if watch is not None:
            follower.set_watch(watch.core([burr.radius for burr, _ in tools]))

    def watched(self, known: int = 0) -> Watched:
        """What was seen until now; of the events all but the first `known`."""
        from burrlab.anatomy.report import nothing_watched

        removed = self._before - np.asarray(self._follower.tissue_levels(), dtype=np.int64)
        if self.watch is None:
            return nothing_watched(self._burrs, removed)
        return Watched.of(self._follower.watched(known), removed)

    def news(self) -> tuple[NDArray[np.void], list[str]]:
        """(events since the last call, what to say of them): the end of a nearness is kept, and not said."""
        from burrlab.anatomy.event import AnatomyEvent

        if self.watch is None:
            return np.zeros(0, EVENT_DTYPE), []
        rows = self.watched(self._told).events
        self._told += len(rows)
        events = [AnatomyEvent.of(row, self.watch.structures, self._voxel_volume) for row in rows]
        return rows, [str(event) for event in events if event.kind != "away"]

    def report(self) -> AnatomyReport | None:
        """None without tissues."""
        from burrlab.anatomy.report import AnatomyReport

        if self._tissues is None:
            return None
        settings = {} if self.watch is None else self.watch.settings
        return AnatomyReport.of(self.watched(), self._tissues, settings, self._period, self._voxel_volume)
