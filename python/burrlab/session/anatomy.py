"""Anatomy reports of a session, of a replica, and of a trace that is executed again."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Follower, Material, Replica, VoxelBone, tissue_levels
from burrlab.anatomy.events import DOSE_DTYPE, EVENT_DTYPE, AnatomyEvent, Watched
from burrlab.anatomy.report import AnatomyReport
from burrlab.anatomy.watch import Watch, critical_structures
from burrlab.common.check import refuse
from burrlab.common.progress import Progress, reporter
from burrlab.common.records import UNREADABLE, in_one_line
from burrlab.session.replay import BATCH, executor_of, inputs
from burrlab.session.trace import Trace, check_trace


class SessionAnatomy:
    """Collects what a follower sees of tissues and watched structures. Each event is told once.

    Parameters
    ----------
    bone : VoxelBone
        Before the first tick.
    follower : Follower
        Not yet started.
    tools : sequence of (Burr, Material)
    watch : Watch or None
    period : float
        Loop period [ms].

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
        self._before = tissue_levels(bone)
        self._told = 0
        if watch is not None:
            follower.set_watch(watch.core([burr.radius for burr, _ in tools]))

    def watched(self, known: int = 0) -> Watched:
        """All that was seen so far, without the first `known` events."""
        removed = self._before - np.asarray(self._follower.tissue_levels(), dtype=np.int64)
        return Watched.of(None if self.watch is None else self._follower.watched(known), removed, self._burrs)

    def closest(self, structure: str) -> NDArray[np.float64]:
        """(burrs,) least distance of each burr's surface to a watched structure so far [mm]."""
        assert self.watch is not None
        doses = self._follower.watched(self._told)["doses"].view(DOSE_DTYPE)
        return np.asarray(doses["closest_mm"][:, self.watch.structures.index(structure)])

    def news(self) -> tuple[NDArray[np.void], list[str]]:
        """(events since the last call, sentences about them). An "away" event has no sentence."""
        if self.watch is None:
            return np.zeros(0, EVENT_DTYPE), []
        rows = self.watched(self._told).events
        self._told += len(rows)
        events = [AnatomyEvent.of(row, self.watch.structures, self._voxel_volume) for row in rows]
        return rows, [str(event) for event in events if event.kind != "away"]

    def report(self) -> AnatomyReport | None:
        """The report so far; None without tissues."""
        if self._tissues is None:
            return None
        settings = {} if self.watch is None else self.watch.settings
        return AnatomyReport.of(self.watched(), self._tissues, settings, self._period, self._voxel_volume)


_TOLD = 5  # how many of the last faults and divergences are told


def status_text(status: Mapping[str, Any]) -> str:
    """A replica's status as text: its end, its comparisons, its connections.

    Parameters
    ----------
    status : mapping
        `Replica.status` with the bone's `digest`, and `interrupted` if its user did so.
    """
    how = "failed" if status["failed"] else "ended"
    end = "interrupted" if status.get("interrupted") else f"{how} ({status['reason']})"
    dropped = [f"{count} {reason}" for reason, count in status["dropped"].items() if count]
    return "\n".join([
        f"{end}: tick {status['tick']}, digest {status['digest']}",
        f"the leader's digests: {status['digests_equal']} equal, {status['digests_different']} different; "
        f"ticks with another result: {status['differing_ticks']}",
        f"connections: {status['connections']} made, {status['faults']} given up; went on by missing ticks "
        f"{status['by_ticks']}, by bricks {status['by_bricks']} times",
        *[f"messages dropped: {', '.join(dropped)}"] * bool(dropped),
        *(
            f"  connection given up at tick {tick}: {reason}"
            for tick, _, reason in status["last_faults"][-_TOLD:]
        ),
        *(
            f"  bone not the leader's at tick {bone['tick']}: {bone['what']}, {len(bone['bricks'])} bricks replaced"
            for bone in status["divergences"][-_TOLD:]
        ),
    ])  # fmt: skip


def replica_events(replica: Replica, known: int = 0) -> list[AnatomyEvent]:
    """Events near watched structures, without the first `known`; none without a watch."""
    settings = json.loads(replica.hello).get("watch")
    if not settings:
        return []
    names = [row["name"] for row in settings["structures"]]
    return [
        AnatomyEvent.of(row, names, settings["voxel_volume_mm3"])
        for row in replica.watched(known)["events"].view(EVENT_DTYPE)
    ]


def replica_report(replica: Replica) -> AnatomyReport | None:
    """The anatomy report of a leader's burrs, as a replica saw them.

    Parameters
    ----------
    replica : Replica
        As `follow` returns it.

    Returns
    -------
    AnatomyReport or None
        None if the bone has no tissues. The report equals the leader's if the replica saw every tick and the
        bone was pristine before the first: `removed` counts from the pristine bone, since a replica may join
        late.

    Raises
    ------
    TypeError
        If `replica` is not a Replica.
    """
    refuse(
        not isinstance(replica, Replica),
        f"replica must be a Replica, got {type(replica).__name__}",
        TypeError,
    )
    bone, _ = replica.snapshot()
    if bone.tissues is None:
        return None
    hello = json.loads(replica.hello)
    settings = dict(hello.get("watch") or {})
    voxel_volume = float(np.prod(bone.spacing))
    volumes = np.array([bone.removed_of(number) for number in range(len(bone.tissues))])
    removed = np.rint(volumes * (255.0 / voxel_volume)).astype(np.int64)
    watched = Watched.of(replica.watched() if settings else None, removed, len(hello["tools"]))
    return AnatomyReport.of(watched, bone.tissues, settings, 1e3 / float(hello["rate_Hz"]), voxel_volume)


def anatomy_report(
    trace: Trace, *, watch: Watch | None = None, progress: Progress | None = None
) -> AnatomyReport:
    """The report of a trace that is executed again: to the bit the session's own, or that of another watch.

    Parameters
    ----------
    trace : Trace
        On a bone with tissues.
    watch : Watch, optional
        Watch of `trace.bone()`. Default: the session's own; without one, all critical structures.
    progress : callable or True, optional
        Called with the fraction done, 0 to 1; True shows a bar.

    Returns
    -------
    AnatomyReport

    Raises
    ------
    ValueError
        If the bone has no tissues, the watch is of another bone, or the trace holds values that no session
        executes.
    TypeError
        If `trace` is not a trace.

    Examples
    --------
    >>> import burrlab, numpy as np, tempfile
    >>> from burrlab.anatomy import anatomy_report
    >>> bone, m = burrlab.VoxelBone.block((10, 10, 5), 0.2, origin=(-4.9, -4.9, -4.9)), burrlab.materials["bone"]
    >>> rows = [
    ...     burrlab.Tissue(name, label=label, c_e=m.c_e, alpha=m.alpha, critical=name == "dura")
    ...     for label, name in enumerate(("bone", "dura"), 1)
    ... ]
    >>> bone.set_tissues(burrlab.Tissues(rows, m), (np.indices(bone.shape)[0] < 10).astype(np.uint8))
    >>> folder, clock = tempfile.TemporaryDirectory(), burrlab.Clock(wall_clock=False)
    >>> hand, file = burrlab.HandDevice((0, 0, 3.0)), folder.name + "/session.h5"
    >>> with burrlab.Session(bone, (burrlab.Burr(1.5), m), hand, seed=1, duration=0.5, clock=clock, record=file) as session:
    ...     ended = session.wait()
    >>> anatomy_report(burrlab.load_trace(file)).structures
    ('dura',)
    >>> folder.cleanup()
    """
    report, watch_progress = reporter(progress, "replay"), None if callable(progress) else progress
    check_trace(trace)
    bone = trace.bone()
    if bone.tissues is None:
        raise ValueError("trace must be of a bone with tissues, got one of a single material")
    if watch is None and trace.watch:
        try:
            watch = Watch.of_settings(bone, trace.watch, progress=watch_progress)
        except UNREADABLE as error:
            raise ValueError(
                f"{trace.path} is damaged: its watch cannot be set up ({in_one_line(repr(error))})"
            ) from None
    elif watch is None and critical_structures(bone):
        watch = Watch(bone, progress=watch_progress)
    executor = executor_of(trace, bone)
    core = None if watch is None else watch.core([burr.radius for burr, _ in trace.tools])
    executor.set_watch(core)
    before = tissue_levels(bone)
    for start in range(0, len(trace), BATCH):
        executor.execute(inputs(trace.ticks[start : start + BATCH]))
        report(min(start + BATCH, len(trace)) / len(trace))
    watched = Watched.of(None if core is None else core.seen(), before - tissue_levels(bone), trace.burrs)
    return AnatomyReport.of(
        watched, bone.tissues, {} if watch is None else watch.settings, trace.period, trace.voxel_volume
    )
