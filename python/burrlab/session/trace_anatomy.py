"""What a trace's burrs did near critical structures: it is executed again and watched."""

from __future__ import annotations

from collections.abc import Callable

from burrlab import _core
from burrlab.anatomy.report import AnatomyReport, nothing_watched
from burrlab.anatomy.watch import Watch, critical_structures
from burrlab.json_text import UNREADABLE, in_one_line
from burrlab.session.replay import inputs
from burrlab.session.trace import Trace, check_trace
from burrlab.session.watch_rows import Watched

_BATCH = 2000  # ticks between two looks at the keyboard


def anatomy_report(
    trace: Trace, *, watch: Watch | None = None, progress: Callable[[float], object] | None = None
) -> AnatomyReport:
    """Executes a trace again and watches: what the session recorded, to the bit, or what another watch would have seen.

    Parameters
    ----------
    trace : Trace
        On a bone with tissues.
    watch : Watch, optional
        Made of `trace.bone()`; default: the session's own, or, without one, all critical structures.
    progress : callable, optional
        Called with the part done, 0 to 1.

    Returns
    -------
    AnatomyReport

    Raises
    ------
    ValueError
        If the bone has no tissues, the watch is of another bone, or the trace holds what no session executes.
    TypeError
        If `trace` is not a trace.
    """
    check_trace(trace)
    bone = trace.bone()
    tissues = bone.tissues
    if tissues is None:
        raise ValueError("trace must be of a bone with tissues, got one of a single material")
    if watch is None and trace.watch:
        try:
            watch = Watch.of_settings(bone, trace.watch)
        except UNREADABLE as error:
            said = in_one_line(repr(error))
            raise ValueError(f"{trace.path} is damaged: its watch cannot be set up ({said})") from None
    elif watch is None and critical_structures(bone):
        watch = Watch(bone)
    executor = _core.TickExecutor(
        bone, list(trace.tools), trace.seed, period=trace.period, scheme=trace.scheme, tick=trace.first_tick
    )
    core = None if watch is None else watch.core([burr.radius for burr, _ in trace.tools])
    executor.set_watch(core)
    before = _core.tissue_levels(bone)
    for start in range(0, len(trace), _BATCH):
        executor.execute(inputs(trace.ticks[start : start + _BATCH]))
        if progress is not None:
            progress(min(start + _BATCH, len(trace)) / len(trace))
    removed = before - _core.tissue_levels(bone)
    watched = nothing_watched(trace.burrs, removed) if core is None else Watched.of(core.seen(), removed)
    settings = {} if watch is None else watch.settings
    return AnatomyReport.of(watched, tissues, settings, trace.period, trace.voxel_volume)
