"""The live commands: burrlab session | replica."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

import burrlab
from burrlab._core import Burr, Device, Replica
from burrlab.cli import (
    Options,
    _deliver,
    _material,
    _material_options,
    _output_options,
    _positive,
    _save,
    _seed,
)  # fmt: skip
from burrlab.cli_bone import Start, add_bone_options, chosen_start
from burrlab.cli_live import add_live_options, check_live, show_live
from burrlab.cli_volume import add_label_options, add_volume_options
from burrlab.cli_watch import add_watch_options, chosen_watch, watch_asked_for
from burrlab.session.device_text import parse_address, parse_device
from burrlab.session.network import follow
from burrlab.session.replica_report import replica_events, replica_report
from burrlab.session.snapshot import check_bone_file

#: Adds a command: its name, what runs it, its help.
AddCommand = Callable[[str, Callable[[Options], int], str], argparse.ArgumentParser]


def add_session_commands(command: AddCommand) -> None:
    """Adds the live commands to the parser of `burrlab`."""
    session = command("session", _session, "Burr in real time, with a device or a simulated hand.")
    session.add_argument(
        "--device", action="append", required=True, metavar="hand|scripted:FILE|igtl:HOST:PORT",
        help="what moves the burr: a simulated hand, a CSV of time_s,x_mm,y_mm,z_mm[,on], or a server's OpenIGTLink TRANSFORM "
        "stream; given twice, two burrs",
    )  # fmt: skip
    session.add_argument(
        "--lost-after", type=_positive, default=100.0, metavar="MS",
        help="age at which a position over the network counts as lost, and the session stops [ms], default 100; a peer that sends "
        "only what changes (3D Slicer) needs more",
    )  # fmt: skip
    session.add_argument("--record", metavar="FILE", help="write the complete trace (HDF5), a new file")
    session.add_argument(
        "--publish", type=_port, metavar="PORT",
        help="publish poses, forces and ticks over OpenIGTLink on this port (0: any free one); there is no authentication: "
        "whoever reaches the port can read the session",
    )  # fmt: skip
    session.add_argument("--host", help="address to publish on, default 127.0.0.1: this machine only")
    session.add_argument(
        "--header-version", type=int, choices=[1, 2], default=1, help="of the OpenIGTLink messages, default 1"
    )
    session.add_argument("--duration", type=_positive, metavar="S", help="[s], default until Ctrl-C")
    add_live_options(session, _port)
    session.add_argument("--rate", type=_positive, default=1000.0, help="of the loop [Hz], default 1000")
    _material_options(session)
    session.add_argument("--push", type=_positive, default=1.0, help="of a simulated hand [N], default 1")
    session.add_argument(
        "--voxel", type=_positive, help="of the block of 30 x 30 x 10 mm [mm], default 0.1, or a volume's own"
    )
    add_volume_options(session)
    add_label_options(session)
    add_bone_options(session)
    add_watch_options(session)
    session.add_argument("--seed", type=_seed, help="default: drawn and recorded")
    session.add_argument(
        "--force-limit", type=_positive, default=8.0, help="of the force sent [N], default 8"
    )
    session.add_argument("--slew-limit", type=_positive, default=1.0, help="of its change [N/ms], default 1")
    session.add_argument(
        "--coupling", type=_positive, help="spring between device and burr [N/mm], default none"
    )
    session.add_argument(
        "--no-realtime", action="store_true", help="do not ask for real-time priority and locked memory"
    )
    _output_options(session)

    replica = command("replica", _replica, "Hold a bit-identical copy of a published session's bone.")
    replica.add_argument("address", type=_address, metavar="HOST:PORT", help="of a session with --publish")
    replica.add_argument("--volume", metavar="FILE", help="the leader's volume, where it lies elsewhere here")
    replica.add_argument(
        "--duration", type=_positive, metavar="S", help="[s], default until the session ends"
    )
    add_live_options(replica, _port)
    replica.add_argument("--save", metavar="FILE", help="write the bone at the end (HDF5)")
    _output_options(replica, plot=False)


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"must be a port, 0 to 65535, got '{text}'")
    return int(text)


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
    start = chosen_start(options, burr, _material(options))
    watch = chosen_watch(options, start.bone)
    if watch is None and start.bone.tissues is not None and not watch_asked_for(options):
        _say("no tissue is critical, so nothing is watched; --watch TISSUE names a structure")
    devices = [_device(text, options, burr, start.place, i) for i, text in enumerate(options.device)]
    session = burrlab.Session(
        start.bone, [(burr, start.material)] * len(devices), devices, seed=options.seed, rate=options.rate, tick=start.tick,
        duration=options.duration, force_limit=options.force_limit, slew_limit=options.slew_limit,
        coupling=options.coupling, record=options.record, publish=options.publish, host=host,
        header_version=options.header_version, source=start.source, realtime=not options.no_realtime,
        watch=watch, on_message=_say,
    )  # fmt: skip
    interrupted = False
    if session.port is not None:
        _say(f"published on {host}, port {session.port}; there is no authentication")
    with _kept(options, start, session), _ended_by_signals(), session:
        try:
            show_live(options, session, _say)
            while not session.wait(1.0):
                _show(_line(session))
        except KeyboardInterrupt:
            interrupted = True
            session.stop("interrupted")
    _show("")
    report = session.report()
    if options.plot is not None:
        _save(report.plot()[0], options.plot)
    _deliver(
        options,
        {
            "seed": session.seed,
            "interrupted": interrupted,
            **report.to_dict(),
            "provenance": session.provenance,
        },
        f"{report}\nseed {session.seed}",
    )
    if interrupted:
        return 130
    return 1 if session.failed else 0


@contextlib.contextmanager
def _kept(options: Options, start: Start, session: burrlab.Session) -> Iterator[None]:
    """Keeps the bone once the session has ended, and if it ended on an error too."""
    try:
        yield
    finally:
        if options.save is not None:
            _show("")
            start.save(options.save, *session.snapshot())
            _say(f"bone saved as {options.save}")


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
    try:
        replica = follow(host, port, volume=options.volume)
    except FileNotFoundError as error:
        raise ValueError(f"{error}; --volume says where the leader's volume lies here") from None
    _say(f"following {host}, port {port}")
    interrupted, left = False, float("inf") if options.duration is None else options.duration
    told = 0
    try:
        with _ended_by_signals():
            show_live(options, replica, _say)
            while left > 0 and not replica.wait(min(1.0, left)):
                left -= 1.0
                told = _tell_events(replica, told)
                status = replica.status
                _show(f"tick {status['tick']}, {'connected' if status['connected'] else 'not connected'}")
    except KeyboardInterrupt:
        interrupted = True
    replica.stop()
    _tell_events(replica, told)
    _show("")
    anatomy = replica_report(replica)
    if options.save is not None:
        burrlab.save_bone(options.save, *replica.snapshot())
    status = {"interrupted": interrupted, "digest": replica.digest(), **replica.status}
    said = [f"{name}: {value}" for name, value in status.items()]
    if anatomy is not None:
        said.append(str(anatomy))
        status["anatomy"] = anatomy.to_dict()
    _deliver(options, status, "\n".join(said))
    if interrupted:
        return 130
    return 1 if status["divergences"] or status["failed"] else 0


def _tell_events(replica: Replica, known: int) -> int:
    """Says what happened near watched structures but for the first events; how many there are."""
    events = replica_events(replica, known)
    for event in events:
        if event.kind != "away":
            _say(str(event))
    return known + len(events)


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """SIGTERM and a closed terminal end what runs as Ctrl-C does: the force zero, the trace whole."""
    names = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        names = []  # only the main thread may
    before = {name: signal.signal(name, signal.default_int_handler) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)


def _say(text: str) -> None:
    _show("")
    print(f"burrlab: {text}", file=sys.stderr, flush=True)


def _show(line: str) -> None:
    """A line that the next one replaces, on a terminal."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)
