"""Live sessions and the use of their traces: session | devices | replica | replay | metrics | export."""

import contextlib
import csv
import json
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import burrlab
from burrlab._core import Burr, Device, Nozzle, Replica, VoxelBone
from burrlab.anatomy.target import compare_with_target
from burrlab.anatomy.watch import Watch, critical_structures
from burrlab.bone.recipe import DrilledRecipe
from burrlab.bone.snapshot import FLAT_ENDING, check_bone_file, holds_bone, save_bone
from burrlab.cli.bone import (
    OF_LABELS,
    PLACE,
    BoneStart,
    chosen_recipe,
    chosen_start,
    rescued,
    say_notes,
)
from burrlab.cli.commands import LIMITS
from burrlab.cli.options import (
    Options,
    chosen_material,
    deliver,
    ended_by_signals,
    on_terminal,
    plot,
    refuse_options,
    say,
    show_line,
    warnings_said,
    working,
)
from burrlab.common.check import amend_error, refuse
from burrlab.common.files import kept_elsewhere, new_file
from burrlab.effects.companion import Companion
from burrlab.foreign.volumetric_drilling import (
    export_volumetric_drilling,
    is_recording,
    read_volumetric_drilling,
)
from burrlab.session.anatomy import anatomy_report, replica_events, replica_report, status_text
from burrlab.session.exchange import (
    find_devices,
    open_device,
    parse_device,
)
from burrlab.session.haply import HeldDevice
from burrlab.session.metrics import HYSTERESIS, THRESHOLD, session_metrics
from burrlab.session.network import follow
from burrlab.view.film import LiveView
from burrlab.view.scene import SIZE, check_screen, pyvista
from burrlab.view.surface import closed_surface, enclosed_volume, write_surface
from burrlab.view.web import check_page, serve, warning


def check_live(options: Options) -> None:
    """ValueError for an option that would have no effect, ImportError without an extra, OSError without a
    screen or if the port is taken; for use before anything starts."""
    if options.view:
        pyvista()
        check_screen()
    elif options.web is not None:
        pyvista()
        check_page(port=options.web)
    else:
        refuse_options(options, ("effects", "stereo"), "goes with --view or --web")


def start_effects(options: Options, source: burrlab.Session | Replica) -> Companion | None:
    """The effects that the options ask for, started with the session's seed; None without them."""
    if not options.effects:
        return None
    seed = source.seed if isinstance(source, burrlab.Session) else int(json.loads(source.hello)["seed"])
    return Companion(source, seed=seed, nozzle=Nozzle()).start()


def end_effects(effects: Companion | None) -> tuple[str, dict[str, Any]]:
    """Ends the effects; returns their report as text and for JSON, both empty without effects."""
    if effects is None:
        return "", {}
    effects.wait(2.0)  # for the last frame
    effects.stop()
    report, balance = effects.report(), effects.balance()
    ended = f"\neffects ended early: {effects.error}" if effects.error else ""
    lines = [f"\neffects at assumed rates, seed {effects.seed}: {report}{ended}"]
    lines += [f"{name}: {account}" for name, account in balance.items()]
    accounts = {name: {**account.volumes(), "exact": account.exact} for name, account in balance.items()}
    return "\n".join(lines), {
        "effects": {
            "seed": effects.seed, "error": effects.error, **report.to_dict(), "balance_mm3": accounts,
        }
    }  # fmt: skip


def show_live(options: Options, source: burrlab.Session | Replica, effects: Companion | None = None) -> None:
    """Shows a window until it is closed or the session ends, or a page until Ctrl-C; KeyboardInterrupt if a
    page ends before the session."""
    if options.view:
        both_eyes: dict[str, Any] = {"stereo": True, "size": SIZE} if options.stereo else {}
        with contextlib.closing(LiveView(source, effects=effects, **both_eyes)) as view:
            view.run()
        if not source.wait(0.0):
            say("the window is closed, what it showed goes on; Ctrl-C ends that")
    elif options.web is not None:
        serve(
            source, effects=effects, port=options.web, stereo=bool(options.stereo),
            on_ready=lambda address: say(warning(address)),
        )  # fmt: skip
        if not source.wait(0.0):
            raise KeyboardInterrupt


def _placed(
    devices: Sequence[Device], options: Options, place: Mapping[str, Any]
) -> list[Device | tuple[Device, burrlab.DeviceFrame]]:
    """The devices, each with its frame if the options say one or a device has axes of its own."""
    frame_options = (options.scale, options.rotation, options.offset, options.clutch)
    if not any(isinstance(device, HeldDevice) for device in devices) and frame_options == (None,) * 4:
        return list(devices)
    scale, rotation = options.scale or 1.0, options.rotation or (1.0, 0.0, 0.0, 0.0)
    origin = (0.0, 0.0, 0.0)
    start = tuple(place.get("start", origin))  # of a simulated hand, and of a device with axes of its own
    offsets = [options.offset or (start if isinstance(device, HeldDevice) else origin) for device in devices]
    return [
        (device, burrlab.DeviceFrame(scale, rotation, offset, options.clutch))
        for device, offset in zip(devices, offsets, strict=True)
    ]


def watch_asked_for(options: Options) -> bool:
    """Whether an option of the watch was given."""
    return any(getattr(options, name) is not None for name in ("watch", *LIMITS))


def chosen_watch(
    options: Options, bone: VoxelBone, recorded: Mapping[str, Any] | None = None
) -> Watch | None:
    """The watch that the options describe, the rest as recorded, None without anything to watch; ValueError if
    they do not fit the bone."""
    limits: dict[str, Any] = {name: value for name in LIMITS if (value := getattr(options, name)) is not None}
    if options.watch == ["none"]:
        refuse_options(options, tuple(LIMITS), "goes with a watch, not with --watch none")
        return None
    if not watch_asked_for(options) and not critical_structures(bone):
        return None
    refuse_options(options, ("watch", *LIMITS), "needs a bone with tissues", bone.tissues is None)
    chosen = limits | ({"structures": options.watch} if options.watch else {}) | {"progress": on_terminal()}
    return Watch.of_settings(bone, recorded, **chosen) if recorded else Watch(bone, **chosen)


def do_session(options: Options) -> int:
    check_live(options)
    published = options.publish is not None or options.vrpn is not None
    refuse_options(options, ("host",), "goes with --publish or --vrpn", not published)
    host, burr = options.host or "127.0.0.1", Burr(options.radius)
    start = chosen_start(options, burr, chosen_material(options))
    watch = chosen_watch(options, start.bone)
    if watch is None and start.bone.tissues is not None and not watch_asked_for(options):
        say("no tissue is critical, so nothing is watched; --watch TISSUE names a structure")
    refuse(
        options.volume_frame and start.grid is None,
        "--volume-frame goes with --volume, --labels or a volume's --bone",
    )
    devices = [_device(text, options, burr, start, i) for i, text in enumerate(options.device)]
    publish = burrlab.Publish(
        port=options.publish, vrpn=options.vrpn, host=host, header_version=options.header_version, sensor=not options.no_sensor
    ) if published else None  # fmt: skip
    session = burrlab.Session(
        burrlab.StartingBone(start.bone, start.tick, start.source), [(burr, start.material)] * len(devices),
        _placed(devices, options, start.place), seed=options.seed, duration=options.duration, record=options.record,
        watch=watch, on_message=say, publish=publish,
        clock=burrlab.Clock(rate=options.rate, wall_clock=not options.virtual_clock, realtime=not options.no_realtime),
        safety=burrlab.Safety(
            force_limit=options.force_limit, slew_limit=options.slew_limit, limits=_limits(options.model), ramp=options.ramp,
            coupling=options.coupling, stop_at_force=options.stop_at_force, stop_within=dict(options.stop_within or ()),
            stop_button=options.stop_button,
        ),
    )  # fmt: skip
    interrupted = False
    effects = start_effects(options, session)
    with _kept(options, start, session):
        try:
            with ended_by_signals():
                for where, port in (("on", session.port), ("over VRPN on", session.vrpn_port)):
                    if port is not None:
                        say(f"published {where} {host}, port {port}; there is no authentication")
                with session:
                    try:
                        _stop_at_enter(session)
                        show_live(options, session, effects)
                        while not session.wait(1.0):
                            show_line(_line(session))
                    except KeyboardInterrupt:
                        session.stop("interrupted")
                        raise
        except KeyboardInterrupt:
            interrupted = True
            session.stop("interrupted")  # it may not have begun
        show_line("")
        report = session.report()
        effects_text, effects_plain = end_effects(effects)
        deliver(
            options,
            {
                "seed": session.seed, "interrupted": interrupted, **report.to_dict(), **effects_plain,
                "provenance": session.provenance,
            },
            f"{report}\nseed {session.seed}{effects_text}",
        )  # fmt: skip
        plot(options.plot, lambda: report.plot()[0])
    if options.record is not None and not report.recording["complete"]:
        return 3
    return 130 if interrupted else int(session.failed)


def _limits(models: list[str] | None) -> str | list[str | None] | None:
    """For `Session`, of what --model names."""
    if models is None:
        return "device"
    named = [None if model == "none" else model for model in models]
    return named[0] if len(named) == 1 else named


def _stop_at_enter(session: burrlab.Session) -> None:
    """Enter stops the session at once, if its input is a terminal."""
    if sys.stdin is None or not sys.stdin.isatty():
        return
    if hasattr(signal, "SIGTTIN"):  # in the background a read of the terminal is an error, not a pause
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)

    def wait(file: int = sys.stdin.fileno()) -> None:
        with contextlib.suppress(OSError):
            if os.read(file, 4096):
                session.stop("Enter was pressed")

    threading.Thread(target=wait, name="burrlab Enter", daemon=True).start()
    say("Enter or Ctrl-C stops the session")


@contextlib.contextmanager
def _kept(options: Options, start: BoneStart, session: burrlab.Session) -> Iterator[None]:
    """Saves the bone after the session, also after an error."""
    try:
        yield
    finally:
        recording = session.report().recording
        if options.save is not None:
            start.save(options.save, *session.snapshot())
            say(f"bone saved as {options.save}")
        elif recording and not recording["complete"] and not recording["rescued"]:
            place = kept_elsewhere(
                options.record, "bone.h5", lambda at: burrlab.save_bone(at, *session.snapshot())
            )
            say(f"the bone's exact state is {f'kept as {place}' if place else 'not kept either'}")


def _device(text: str, options: Options, burr: Burr, start: BoneStart, number: int) -> Device:
    place = start.place
    with amend_error("--device "):
        device = parse_device(text)
    if device.kind == "hand":
        if number > 0 and place:
            beside = np.cross(place.get("into", (0.0, 0.0, -1.0)), place.get("along", (1.0, 0.0, 0.0)))
            place = {**place, "start": np.asarray(place["start"]) + 3 * burr.radius * beside}
        return burrlab.HandDevice(push=options.push, **place)
    if device.kind == "scripted":
        return burrlab.read_script(device.file, volume=start.grid if options.volume_frame else None)
    with _opening(f"opening {text}"):
        return open_device(device, options.lost_after)


@contextlib.contextmanager
def _opening(text: str) -> Iterator[None]:
    """Says what is done. Ctrl-C ends the program at once, as a vendor's library may hang."""
    here = threading.current_thread() is threading.main_thread()
    with contextlib.ExitStack() as after:
        if here and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            after.callback(signal.signal, signal.SIGINT, signal.signal(signal.SIGINT, signal.SIG_DFL))
        after.enter_context(working(text))
        yield


def do_devices(options: Options) -> None:
    rows = find_devices(_opening)
    lines = [
        f"{row['device']}: {row['hardware']}, over {row['library']}"
        if "hardware" in row
        else f"{row['device']}: {row['why_not']}"
        for row in rows
    ]
    lines.append("hand, scripted:FILE, igtl:HOST:PORT and vrpn:NAME@HOST need no library")
    deliver(options, {"devices": rows}, "\n".join(lines))


def _line(session: burrlab.Session) -> str:
    """A session in one line."""
    counts, status, at = session.loop.counts, session.follower.status, session.follower.stability(0)
    stiff = f"{at['stiffness_N_per_mm']:.1f} N/mm"
    if np.isfinite(at["ratio"]):
        stiff += f" of {at['limit_N_per_mm']:.1f} ({at['ratio']:.2f}, exceeded {at['exceeded']} {at['force_at_limit_N']:.2f} N)"
    return (
        f"{counts.ticks} ticks, {counts.late} late, {counts.dropped} dropped; lag {status['behind']} ticks; "
        f"{at['force_N']:.2f} N, stiffness {stiff}"
    )


def do_replica(options: Options) -> int:
    check_live(options)
    if options.save is not None:
        check_bone_file(options.save)
    host, port = options.address
    with (
        working(f"making the bone of the session at {host}, port {port}, and what it watches"),
        amend_error(after="; --volume says where the leader's volume lies here", kinds=(FileNotFoundError,)),
    ):
        replica = follow(host, port, volume=options.volume)
    say(f"following {host}, port {port}")
    interrupted, events_printed = False, 0
    effects = start_effects(options, replica)
    try:
        with ended_by_signals(), contextlib.ExitStack() as stack:
            if options.duration is not None:  # also ends a window or a page
                timer = threading.Timer(min(options.duration, threading.TIMEOUT_MAX), replica.stop)
                timer.daemon = True
                timer.start()
                stack.callback(timer.cancel)
            show_live(options, replica, effects)
            while not replica.wait(1.0):
                events_printed = _tell_events(replica, events_printed)
                status = replica.status
                show_line(f"tick {status['tick']}, {'connected' if status['connected'] else 'not connected'}")
    except KeyboardInterrupt:
        interrupted = True
    replica.stop()
    effects_text, effects_plain = end_effects(effects)
    _tell_events(replica, events_printed)
    show_line("")
    anatomy = replica_report(replica)
    status = {"interrupted": interrupted, "digest": replica.digest(), **replica.status}
    text = status_text(status)
    if anatomy is not None:
        text += f"\n{anatomy}"
        status["anatomy"] = anatomy.to_dict()
    try:
        deliver(options, {**status, **effects_plain}, text + effects_text)
    finally:  # an error does not keep the bone from being saved
        if options.save is not None:
            bone, tick = replica.snapshot()
            with rescued(options.save, bone, tick):
                burrlab.save_bone(options.save, bone, tick)
    return 130 if interrupted else int(bool(status["divergences"] or status["failed"]))


def _tell_events(replica: Replica, known: int) -> int:
    """Prints new events near watched structures; returns the number of all events."""
    events = replica_events(replica, known)
    for event in events:
        if event.kind != "away":
            say(str(event))
    return known + len(events)


def do_replay(options: Options) -> int:
    trace = burrlab.load_trace(options.file)
    again = burrlab.replay(trace, until=options.until, progress=on_terminal())
    where = f"{again.ticks} ticks from {trace.first_tick}, {again.digests} digests compared"
    verdict = f"equal: {where}" if again.equal else f"different: {again.difference}"
    ended = trace.ended or "recording did not end: the session was killed, or goes on"
    deliver(
        options,
        {
            "file": str(options.file), **again.to_dict(), "ended": trace.ended, "complete": trace.complete,
            "recorded_with": {name: trace.provenance[name] for name in ("burrlab", "cpu_path", "machine")},
        },
        f"{verdict}\n{ended}",
    )  # fmt: skip
    return 0 if again.equal else 1


def do_metrics(options: Options) -> None:
    refuse_options(options, ("onto",), "goes with --target", options.target is None)
    wanted = {"threshold": options.threshold or THRESHOLD, "hysteresis": options.hysteresis or HYSTERESIS}
    target = None
    if is_recording(options.file):
        refuse_options(options, ("target", "watch", *LIMITS), "goes with a trace")
        recording = read_volumetric_drilling(options.file, scale=options.scale or 1.0)
        with warnings_said():
            metrics = session_metrics(recording, burr=options.burr, **wanted)
    else:
        refuse_options(options, ("scale",), "goes with a recording of volumetric_drilling")
        trace = burrlab.load_trace(options.file)
        if options.target is not None:
            target = burrlab.read_labels(options.target)
            # A wrong target is refused before the work.
            compare_with_target(trace.bone(), target, onto=options.onto)
        metrics = session_metrics(trace, burr=options.burr, **wanted)
        watch_chosen = watch_asked_for(options)
        # The report was not recorded, the session was killed, or another watch is wanted.
        if watch_chosen or (metrics.anatomy is None and trace.tissues is not None):
            watch = chosen_watch(options, trace.bone(), trace.watch) if watch_chosen else None
            refuse(
                watch_chosen and watch is None, "--watch must name structures of the trace's bone, got none"
            )
            metrics = replace(metrics, anatomy=anatomy_report(trace, watch=watch, progress=on_terminal()))
    result, text = metrics.to_dict(), repr(metrics)
    if target is not None:
        again = burrlab.replay(trace, progress=on_terminal())
        refuse(not again.equal, f"--target: the trace replays otherwise than recorded: {again.difference}")
        removed = compare_with_target(again.bone, target, onto=options.onto)
        before = trace.bone().removed
        result["target"] = {"file": options.target, **removed.to_dict(), "removed_before_mm3": before}
        text += f"\n\nagainst {options.target}\n{removed.table()}"
        if before > 0:
            text += f"\n{before:.2f} mm^3 of that were removed before this session"
    deliver(options, result, text, lambda: metrics.plot()[0])


def do_export(options: Options) -> None:
    ending = Path(options.out).suffix.lower()
    refuse(ending not in _EXPORTS, f"--out must end in {', '.join(_EXPORTS)}, got {options.out}")
    of_volume = options.volume is not None or options.labels is not None
    for applies, names, why in (
        (ending != ".hdf5", ("burr", "old"), "goes with --out FILE.hdf5"),
        (ending in (".hdf5", ".csv"), ("until",), "goes with --out FILE.stl, .ply or .burr"),
        (ending not in (".stl", ".ply"), ("left", "level"), "goes with --out FILE.stl and FILE.ply"),
        (ending != ".burr", ("volume", "labels"), "goes with --out FILE.burr"),
        (not of_volume, ("map", "spacing", "series", "crop", "voxel", "transpose", *OF_LABELS), "goes with a volume"),
        (True, PLACE, "is of a descent"),
    ):  # fmt: skip
        refuse_options(options, names, why, applies)
    refuse(
        (options.file is not None) + of_volume != 1,
        "export needs one of FILE and, for .burr, --volume or --labels",
    )
    written, text = _EXPORTS[ending](options)
    source = options.file or options.volume or options.labels
    deliver(options, {"file": source, "written": options.out, **written}, f"written {options.out}{text}")


def _export_recording(options: Options) -> tuple[dict[str, Any], str]:
    export_volumetric_drilling(
        burrlab.load_trace(options.file), options.out, burr=options.burr or 0,
        layout="old" if options.old else "new", progress=on_terminal(),
    )  # fmt: skip
    return {}, ""


def _export_ticks(options: Options) -> tuple[dict[str, Any], str]:
    trace = burrlab.load_trace(options.file)
    tables = [trace.columns(burr) for burr in range(trace.burrs)]
    with new_file(options.out, ".csv") as part, open(part, "w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["burr", *tables[0]])
        for begin in range(0, len(trace), 4096):
            parts = [
                zip(*(column[begin : begin + 4096].tolist() for column in table.values()), strict=True)
                for table in tables
            ]
            for rows in zip(*parts, strict=True):
                writer.writerows([burr, *row] for burr, row in enumerate(rows))
    return {"rows": len(trace) * trace.burrs}, f": {len(trace)} ticks, burrs: {trace.burrs}"


def _bone_to_export(options: Options) -> tuple[VoxelBone, int, str, NDArray[np.float64]]:
    """The bone of a file, of a trace after some of its ticks, or of a volume; its ticks, source and axes."""
    try:
        trace = None if options.file is None else burrlab.load_trace(options.file)
    except (ValueError, IsADirectoryError) as error:
        if isinstance(error, ValueError) and "is not a burrlab trace" not in str(error):
            raise
        trace = None
    if trace is not None:
        again = burrlab.replay(trace, until=options.until, progress=on_terminal())
        refuse(not again.equal, f"{options.file} replays otherwise than recorded: {again.difference}")
        return again.bone, again.tick, trace.source, np.eye(3)
    refuse_options(options, ("until",), "goes with a trace")
    kept = None if options.file is None else DrilledRecipe(options.file)
    recipe = kept or chosen_recipe(options, burrlab.materials["bone"])
    assert recipe is not None
    if kept is None:
        say_notes(recipe)
    source = json.dumps({**recipe.plain(), "notes": list(recipe.notes())})
    axes = kept.grid().direction if kept and not holds_bone(options.file) else np.eye(3)
    return recipe.bone(), getattr(recipe, "tick", 0), source, axes


def _export_bone(options: Options) -> tuple[dict[str, Any], str]:
    bone, tick, source, _ = _bone_to_export(options)
    save_bone(options.out, bone, tick, source=source)
    return {}, ""


def _export_surface(options: Options) -> tuple[dict[str, Any], str]:
    bone, _, _, axes = _bone_to_export(options)
    whole, verb = (bone.mass, "hold") if options.left else (bone.removed, "lost")
    vertices, faces = closed_surface(bone, left=options.left, level=options.level)
    inside = enclosed_volume(vertices - vertices[0], faces)
    # of a mirror image the triangles turn the other way
    write_surface(options.out, vertices @ axes.T, faces[:, :: int(np.linalg.det(axes).round())])
    return {"triangles": len(faces), "volume_mm3": inside, "voxels_mm3": whole}, (
        f": {len(faces)} triangles around {inside:.6g} mm^3; the voxels {verb} {whole:.6g} mm^3 ({inside / whole - 1:+.1%})"
    )


#: What an export writes, by the ending of --out.
_EXPORTS = {
    ".hdf5": _export_recording,
    ".stl": _export_surface,
    ".ply": _export_surface,
    FLAT_ENDING: _export_bone,
    ".csv": _export_ticks,
}
