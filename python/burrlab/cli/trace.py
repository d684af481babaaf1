"""What is done with a trace: burrlab replay | metrics | export."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from burrlab.cli.options import AddCommand, Options, add_output_options, positive, whole
from burrlab.cli.output import deliver, save_figure
from burrlab.cli.watch import add_watch_options, chosen_watch, watch_asked_for

if TYPE_CHECKING:
    from burrlab.anatomy.target import TargetComparison
    from burrlab.session.trace import Trace
    from burrlab.volume import LabelVolume


def add_trace_commands(command: AddCommand) -> None:
    """Adds the commands on traces to the parser of `burrlab`."""
    replay = command(
        "replay", _replay, "Execute a trace again and compare: exit status 0 equal, 1 different."
    )
    replay.add_argument("file", metavar="FILE", help="a trace")
    replay.add_argument(
        "--until", type=whole, metavar="TICK", help="tick before which to stop, default the end"
    )
    add_output_options(replay, plot=False)

    metrics = command("metrics", _metrics, "How the burr was handled: time, motion, force, bone removed.")
    metrics.add_argument("file", metavar="FILE", help="a trace")
    metrics.add_argument("--burr", type=whole, default=0, metavar="INDEX", help="default 0")
    metrics.add_argument("--threshold", type=positive, metavar="N", help="of the force [N], default 2")
    metrics.add_argument("--hysteresis", type=positive, metavar="MM", help="least stroke [mm], default 1")
    metrics.add_argument(
        "--target", metavar="VOLUME", help="labels on the bone's grid, not 0 where bone was to be removed"
    )
    metrics.add_argument(
        "--onto",
        action="store_true",
        help="a target on other voxels than the bone: bring the nearest on its own",
    )
    add_watch_options(metrics)
    add_output_options(metrics)

    export = command(
        "export", _export, "Write a trace as the simulator volumetric_drilling records a session."
    )
    export.add_argument("file", metavar="FILE", help="a trace")
    export.add_argument("--out", required=True, metavar="FILE.hdf5", help="a new file")
    export.add_argument("--burr", type=whole, default=0, metavar="INDEX", help="that is the drill, default 0")
    export.add_argument("--old", action="store_true", help="in the layout of its recordings before 2025")
    add_output_options(export, plot=False)


def _replay(options: Options) -> int:
    from burrlab.session.replay import replay
    from burrlab.session.trace import load_trace

    trace = load_trace(options.file)
    with _bar() as progress:
        again = replay(trace, until=options.until, progress=progress)
    where = f"{again.ticks} ticks from {trace.first_tick}, {again.digests} digests compared"
    said = f"equal: {where}" if again.equal else f"different: {again.difference}"
    ended = trace.ended or "recording did not end: the session was killed, or goes on"
    result: dict[str, Any] = {
        "file": str(options.file), **again.to_dict(), "ended": trace.ended, "complete": trace.complete,
        "recorded_with": {name: trace.provenance[name] for name in ("burrlab", "cpu_path", "machine")},
    }  # fmt: skip
    deliver(options, result, f"{said}\n{ended}")
    return 0 if again.equal else 1


def _metrics(options: Options) -> int:
    from burrlab.session.metrics import HYSTERESIS, THRESHOLD, session_metrics
    from burrlab.session.trace import load_trace
    from burrlab.session.trace_anatomy import anatomy_report

    if options.onto and options.target is None:
        raise ValueError("--onto goes with --target")
    trace, target = load_trace(options.file), None
    if options.target is not None:
        from burrlab.anatomy.target import compare_with_target
        from burrlab.volume import read_labels

        target = read_labels(options.target)
        compare_with_target(
            trace.bone(), target, onto=options.onto
        )  # what is wrong with it is said before the work
    metrics = session_metrics(
        trace, burr=options.burr, threshold=options.threshold or THRESHOLD,
        hysteresis=options.hysteresis or HYSTERESIS,
    )  # fmt: skip
    asked = watch_asked_for(options)
    # Not recorded, the session was killed, or another watch is wanted.
    if asked or (metrics.anatomy is None and trace.tissues is not None):
        watch = chosen_watch(options, trace.bone()) if asked else None
        if asked and watch is None:
            raise ValueError("--watch must name structures of the trace's bone, got none")
        with _bar() as progress:
            anatomy = anatomy_report(trace, watch=watch, progress=progress)
        metrics = replace(metrics, anatomy=anatomy)
    result, text = metrics.to_dict(), repr(metrics)
    if target is not None:
        removed = _against(trace, target, options.onto)
        before = trace.bone().removed
        result["target"] = {"file": options.target, **removed.to_dict(), "removed_before_mm3": before}
        text += f"\n\nagainst {options.target}\n{removed.table()}"
        if before > 0:
            text += f"\n{before:.2f} mm^3 of that were removed before this session"
    if options.plot is not None:
        save_figure(metrics.plot()[0], options.plot)
    deliver(options, result, text)
    return 0


def _against(trace: Trace, target: LabelVolume, onto: bool) -> TargetComparison:
    from burrlab.anatomy.target import compare_with_target
    from burrlab.session.replay import replay

    with _bar() as progress:
        again = replay(trace, progress=progress)
    if again.difference is not None:
        raise ValueError(f"--target: the trace replays otherwise than recorded: {again.difference}")
    return compare_with_target(again.bone, target, onto=onto)


def _export(options: Options) -> int:
    from burrlab.session.trace import load_trace
    from burrlab.session.volumetric_drilling import export_volumetric_drilling

    if os.path.exists(options.out):
        raise ValueError(f"--out must be a new file, {options.out} exists")
    with _bar() as progress:
        export_volumetric_drilling(
            load_trace(options.file), options.out, burr=options.burr, layout="old" if options.old else "new",
            progress=progress,
        )  # fmt: skip
    deliver(options, {"file": options.file, "written": options.out}, f"written {options.out}")
    return 0


@contextmanager
def _bar() -> Iterator[Callable[[float], object]]:
    """What takes the part done, 0 to 1, and shows it."""
    from tqdm import tqdm

    with tqdm(total=100, desc="replay", unit="%", disable=not sys.stderr.isatty(), leave=False) as bar:
        yield lambda done: bar.update(int(100 * done) - bar.n)
