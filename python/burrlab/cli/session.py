"""The live commands: burrlab session | replica."""

from __future__ import annotations

import argparse
import contextlib
import threading
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

import burrlab
from burrlab._core import Burr, Device, Replica
from burrlab.cli.bone import Start, add_bone_options, chosen_start, rescued
from burrlab.cli.live import add_live_options, check_live, end_effects, show_live, start_effects
from burrlab.cli.options import (
    AddCommand,
    Options,
    add_material_options,
    add_output_options,
    chosen_material,
    port,
    positive,
    seed,
)
from burrlab.cli.output import deliver, ended_by_signals, save_figure, say, show_line
from burrlab.cli.volume import add_label_options, add_volume_options
from burrlab.cli.watch import add_watch_options, chosen_watch, watch_asked_for
from burrlab.files import kept_elsewhere
from burrlab.session.device_text import parse_address, parse_device
from burrlab.session.network import follow
from burrlab.session.replica_report import replica_events, replica_report, status_text
from burrlab.session.snapshot import check_bone_file

if TYPE_CHECKING:
    from burrlab.effects import Companion


def add_session_commands(command: AddCommand) -> None:
    """Adds the live commands to the parser of `burrlab`."""
    session = command("session", _session, "Burr in real time, with a device or a simulated hand.")
    session.add_argument(
        "--device", action="append", required=True, metavar="hand|scripted:FILE|igtl:HOST:PORT",
        help="what moves the burr: a simulated hand, a CSV of time_s,x_mm,y_mm,z_mm[,on], or a server's OpenIGTLink TRANSFORM "
        "stream; given twice, two burrs",
    )  # fmt: skip
    session.add_argument(
        "--lost-after", type=positive, default=100.0, metavar="MS",
        help="age at which a position over the network counts as lost, and the session stops [ms], default 100; a peer that sends "
        "only what changes (3D Slicer) needs more",
    )  # fmt: skip
    session.add_argument("--record", metavar="FILE", help="write the complete trace (HDF5), a new file")
    session.add_argument(
        "--publish", type=port, metavar="PORT",
        help="publish poses, forces and ticks over OpenIGTLink on this port (0: any free one); there is no authentication: "
        "whoever reaches the port can read the session",
    )  # fmt: skip
    session.add_argument("--host", help="address to publish on, default 127.0.0.1: this machine only")
    session.add_argument(
        "--header-version", type=int, choices=[1, 2], default=1, help="of the OpenIGTLink messages, default 1"
    )
    session.add_argument("--duration", type=positive, metavar="S", help="[s], default until Ctrl-C")
    add_live_options(session)
    session.add_argument("--rate", type=positive, default=1000.0, help="of the loop [Hz], default 1000")
    add_material_options(session)
    session.add_argument("--push", type=positive, default=1.0, help="of a simulated hand [N], default 1")
    session.add_argument(
        "--voxel", type=positive, help="of the block of 30 x 30 x 10 mm [mm], default 0.1, or a volume's own"
    )
    add_volume_options(session)
    add_label_options(session)
    add_bone_options(session)
    add_watch_options(session)
    session.add_argument("--seed", type=seed, help="default: drawn and recorded")
    session.add_argument("--force-limit", type=positive, default=8.0, help="of the force sent [N], default 8")
    session.add_argument("--slew-limit", type=positive, default=1.0, help="of its change [N/ms], default 1")
    session.add_argument(
        "--coupling", type=positive, help="spring between device and burr [N/mm], default none"
    )
    session.add_argument(
        "--no-realtime", action="store_true", help="do not ask for real-time priority and locked memory"
    )
    add_output_options(session)

    replica = command("replica", _replica, "Hold a bit-identical copy of a published session's bone.")
    replica.add_argument("address", type=_address, metavar="HOST:PORT", help="of a session with --publish")
    replica.add_argument("--volume", metavar="FILE", help="the leader's volume, where it lies elsewhere here")
    replica.add_argument("--duration", type=positive, metavar="S", help="[s], default until the session ends")
    add_live_options(replica)
    replica.add_argument("--save", metavar="FILE", help="write the bone at the end (HDF5)")
    add_output_options(replica, plot=False)


def _address(text: str) -> tuple[str, int]:
    try:
        return parse_address(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _session(options: Options) -> int:
    check_live(options)
    if options.host is not None and options.publish is None:
        raise ValueError("--host goes with --publish")
    host = options.host or "127.0.0.1"
    burr = Burr(options.radius)
    start = chosen_start(options, burr, chosen_material(options))
    watch = chosen_watch(options, start.bone)
    if watch is None and start.bone.tissues is not None and not watch_asked_for(options):
        say("no tissue is critical, so nothing is watched; --watch TISSUE names a structure")
    devices = [_device(text, options, burr, start.place, i) for i, text in enumerate(options.device)]
    session = burrlab.Session(
        start.bone, [(burr, start.material)] * len(devices), devices, seed=options.seed, rate=options.rate, tick=start.tick,
        duration=options.duration, force_limit=options.force_limit, slew_limit=options.slew_limit,
        coupling=options.coupling, record=options.record, publish=options.publish, host=host,
        header_version=options.header_version, source=start.source, realtime=not options.no_realtime,
        watch=watch, on_message=say,
    )  # fmt: skip
    interrupted = False
    effects = start_effects(options, session)
    if session.port is not None:
        say(f"published on {host}, port {session.port}; there is no authentication")
    with _kept(options, start, session):
        with ended_by_signals(), session:
            try:
                show_live(options, session, say, effects)
                while not session.wait(1.0):
                    show_line(_line(session))
            except KeyboardInterrupt:
                interrupted = True
                session.stop("interrupted")
        show_line("")
        return _told(options, session, effects, interrupted)


def _told(options: Options, session: burrlab.Session, effects: Companion | None, interrupted: bool) -> int:
    report = session.report()
    effects_text, effects_plain = end_effects(effects)
    deliver(
        options,
        {
            "seed": session.seed,
            "interrupted": interrupted,
            **report.to_dict(),
            **effects_plain,
            "provenance": session.provenance,
        },
        f"{report}\nseed {session.seed}{effects_text}",
    )
    if options.plot is not None:
        save_figure(report.plot()[0], options.plot)
    if options.record is not None and not report.recording["complete"]:
        return 3
    if interrupted:
        return 130
    return 1 if session.failed else 0


@contextlib.contextmanager
def _kept(options: Options, start: Start, session: burrlab.Session) -> Iterator[None]:
    """Keeps the bone once the session has ended, and if it ended on an error too."""
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


def _device(text: str, options: Options, burr: Burr, place: Mapping[str, Any], number: int) -> Device:
    try:
        device = parse_device(text)
    except ValueError as error:
        raise ValueError(f"--device {error}") from None
    if device.kind == "hand":
        if number == 0 or not place:
            return burrlab.HandDevice(push=options.push, **place)
        along = np.asarray(place.get("along", (1.0, 0.0, 0.0)))
        into = np.asarray(place.get("into", (0.0, 0.0, -1.0)))
        beside = np.asarray(place["start"]) + 3 * burr.radius * np.cross(into, along)
        return burrlab.HandDevice(push=options.push, **{**place, "start": beside})
    if device.kind == "scripted":
        return burrlab.read_script(device.file)
    return burrlab.IgtlDevice(device.host, device.port, lost_after=options.lost_after)


def _line(session: burrlab.Session) -> str:
    """A session in one line."""
    counts, status, at = session.loop.counts, session.follower.status, session.follower.stability(0)
    stiff = f"{at['stiffness_N_per_mm']:.1f} N/mm"
    if np.isfinite(at["ratio"]):
        stiff += f" of {at['limit_N_per_mm']:.1f} ({at['ratio']:.2f}, exceeded below {at['force_at_limit_N']:.2f} N)"
    return (
        f"{counts.ticks} ticks, {counts.late} late, {counts.dropped} dropped; lag {status['behind']} ticks; "
        f"{at['force_N']:.2f} N, stiffness {stiff}"
    )


def _replica(options: Options) -> int:
    check_live(options)
    if options.save is not None:
        check_bone_file(options.save)
    host, port = options.address
    show_line(f"making the bone of the session at {host}, port {port}, and what it watches")
    try:
        replica = follow(host, port, volume=options.volume)
    except FileNotFoundError as error:
        raise ValueError(f"{error}; --volume says where the leader's volume lies here") from None
    finally:
        show_line("")
    say(f"following {host}, port {port}")
    interrupted, told = False, 0
    effects = start_effects(options, replica)
    try:
        with ended_by_signals(), _stopped_after(replica, options.duration):
            show_live(options, replica, say, effects)
            while not replica.wait(1.0):
                told = _tell_events(replica, told)
                status = replica.status
                show_line(f"tick {status['tick']}, {'connected' if status['connected'] else 'not connected'}")
    except KeyboardInterrupt:
        interrupted = True
    replica.stop()
    effects_text, effects_plain = end_effects(effects)
    _tell_events(replica, told)
    show_line("")
    anatomy = replica_report(replica)
    status = {"interrupted": interrupted, "digest": replica.digest(), **replica.status}
    said = [status_text(status, interrupted=interrupted)]
    if anatomy is not None:
        said.append(str(anatomy))
        status["anatomy"] = anatomy.to_dict()
    with _copy_kept(options, replica):
        deliver(options, {**status, **effects_plain}, "\n".join(said) + effects_text)
    if interrupted:
        return 130
    return 1 if status["divergences"] or status["failed"] else 0


@contextlib.contextmanager
def _stopped_after(replica: Replica, seconds: float | None) -> Iterator[None]:
    """Also while a window or a page is shown, which then stands still."""
    if seconds is None:
        yield
        return
    timer = threading.Timer(min(seconds, threading.TIMEOUT_MAX), replica.stop)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def _copy_kept(options: Options, replica: Replica) -> Iterator[None]:
    """Keeps the bone once all is said, and if that ended on an error too."""
    try:
        yield
    finally:
        if options.save is not None:
            bone, tick = replica.snapshot()
            with rescued(options.save, bone, tick):
                burrlab.save_bone(options.save, bone, tick)


def _tell_events(replica: Replica, known: int) -> int:
    """Says what happened near watched structures but for the first events; how many there are."""
    events = replica_events(replica, known)
    for event in events:
        if event.kind != "away":
            say(str(event))
    return known + len(events)
