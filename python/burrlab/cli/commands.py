"""The commands, their help and their options.

No room is imported here: help and the name of a mistyped option come at once.
"""

import importlib
import re
from typing import Any, NamedTuple

import numpy as np

import burrlab
from burrlab.cli.options import (
    EXPONENTS,
    JSON,
    LABELS,
    MATERIAL,
    OUTPUT,
    RECORDED,
    STACK,
    VOLUME,
    Option,
    OptionGroup,
    count,
    flag,
    floats,
    number,
    option,
    parsed_by,
    port,
    positive,
    seed,
    shape,
    spacing,
    vector,
    whole,
    whole_number,
)
from burrlab.common.check import refuse

FPS = 20.0  # of a film [1/s]


class Command(NamedTuple):
    """A command: the module that runs it, its help, its options in the order of the help."""

    module: str
    text: str
    options: tuple[Option | OptionGroup, ...]


@parsed_by
def _not_negative(text: str) -> float:
    (value,) = floats(text, 1, "zero or positive", text)
    refuse(not 0 <= value < np.inf, f"must be zero or positive, got '{text}'")
    return value


@parsed_by
def _nearness(text: str) -> tuple[str, float]:
    name, _, distance = text.rpartition(":")
    refuse(not name, f"must be TISSUE:MM, got '{text}'")
    return name, _not_negative(distance)


@parsed_by
def _numbers(text: str) -> list[float]:
    if ":" not in text:
        return [positive(part) for part in text.split(",")]
    parts = text.split(":")
    refuse(len(parts) != 3, f"must be FIRST:LAST:COUNT or F,F,..., got '{text}'")
    return [float(f) for f in np.linspace(positive(parts[0]), positive(parts[1]), count(parts[2]))]


@parsed_by
def _counts(text: str) -> list[int]:
    """FIRST:LAST, or N,N,..."""
    first, colon, last = text.partition(":")
    if not colon:
        return [count(part) for part in text.split(",")]
    refuse(count(last) < count(first), f"must be FIRST:LAST, the smaller number first, got '{text}'")
    return list(range(count(first), count(last) + 1))


KINDS = {"file": "VelocityCurve", "indentation": "Indentation", "trace": "DepthTrace"}


def data_kind(name: str) -> Any:
    """The class of the data in the files of an option."""
    return getattr(burrlab, KINDS[name])


def _named(text: str) -> list[tuple[str, str]]:
    """NAME=TEXT,NAME=TEXT, in which a text may hold commas, or stand in quotation marks."""
    names = dict.fromkeys(name for kind in KINDS for name in data_kind(kind)._TABLE.named)
    parts = re.split(rf"(?:^|,)({'|'.join(names)})=", text)
    refuse(parts[0] or len(parts) < 2, f"must begin with NAME=, a NAME of {', '.join(names)}, got '{text}'")
    return [
        (name, re.sub(r"""^(["'])(.*)\1$""", r"\2", part))
        for name, part in zip(parts[1::2], parts[2::2], strict=True)
    ]


@parsed_by
def _groups(text: str) -> dict[str, str]:
    """NAME=HEADING,NAME=HEADING, or none."""
    parts = re.split(r"(?:^|,)(\w+(?: \w+)*)=", text)
    refuse(text != "none" and (parts[0] or len(parts) < 2), f"must be NAME=HEADING,... or none, got '{text}'")
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@parsed_by
def _sizes(text: str) -> dict[str, Any]:
    """NAME=NUMBER,NAME=NUMBER:NUMBER,NAME=NUMBER:TEXT."""
    sizes: dict[str, Any] = {}
    for part in text.split(","):
        name, _, size = part.partition("=")
        refuse(not name or not size, f"must be NAME=NUMBER,..., got '{text}'")
        number, *others = size.split(":", 1)
        beside = [other if other[:1].isalpha() else positive(other) for other in others]
        sizes[name] = (positive(number), *beside) if beside else positive(number)
    return sizes


@parsed_by
def _pair(text: str) -> tuple[float, float]:
    values = [positive(part) for part in text.split(",")]
    refuse(len(values) != 2, f"must be C_E,ALPHA, got '{text}'")
    return values[0], values[1]


@parsed_by
def _size(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    fine = len(parts) == 2 and all(part.isdecimal() and 16 <= int(part) <= 16384 for part in parts)
    refuse(not fine, f"must be WIDTHxHEIGHT of 16 to 16384 pixels, got '{text}'")
    return int(parts[0]), int(parts[1])


LIMITS = {
    "approach": ("MM", "distance of the burr's surface at which an approach is told [mm], default 2"),
    "touch": ("MM", "and a touch [mm], default 0"),
    "injury": (
        "MM3",
        "volume removed from a structure from which on it is told as injured [mm^3], default 0",
    ),
}
WATCH = OptionGroup(
    "critical structures, where the bone has tissues; metrics: by default as recorded (docs/anatomy.md)",
    (
        option(
            "--watch",
            "a structure to watch, as often as needed; default all that are critical; 'none' for no watch",
            action="append", metavar="TISSUE",
        ),
        *(option(f"--{name}", text, type=_not_negative, metavar=unit) for name, (unit, text) in LIMITS.items()),
    ),
)  # fmt: skip


#: Options for files of other programs.
LAYOUT = OptionGroup("files of another program, all of the same layout", (
    option(
        "--columns", "headings of force, velocity and so on; repeatable, also for one NAME with repeats in several columns",
        type=parsed_by(_named), action="extend", default=[], metavar="NAME=HEADING,...",
    ),
    option(
        "--unit", "of all columns that can have it, such as um/s, or of single ones",
        type=parsed_by(lambda text: dict(_named(text)) if "=" in text else text), metavar="UNIT|NAME=UNIT,...",
    ),
    option("--sep", "separator, or tab; default: the one between the headings"),
    option("--decimal", "mark of decimals, default a point", choices=[".", ","], metavar="MARK"),
    option("--encoding", "such as cp1252, latin-1 or utf-16; default UTF-8"),
    option(
        "--groups", "headings of the labels of days, operators or drills: runs of a group share an effect; 'none' "
        "leaves the labels of a file out", type=_groups, metavar="NAME=HEADING,...",
    ),
    option("--specimen", "heading of the labels of specimens"),
))  # fmt: skip
_UNCERTAIN = option(
    "--uncertain", "standard deviations of offsets of force [N], surface and radius [mm], one offset a data set, or one "
    "a label of a group: surface=0.05,force=0.02:day", type=_sizes, metavar="NAME=SIZE[:GROUP],...",
)  # fmt: skip
_OFFSETS = OptionGroup("what is not quite known (docs/fit.md)", (
    _UNCERTAIN,
    option(
        "--estimate", "offsets that the data shall tell: force, radius, and order (a drift from run to run), or "
        "order:day (which begins anew each day)",
        type=lambda text: text.split(","), default=[], metavar="NAME,...",
    ),
    option(
        "--known", "c_e [N/mm^2] or alpha [1/ms] from elsewhere, and their standard deviations: c_e=2.145:0.1",
        type=_sizes, metavar="NAME=VALUE[:SD],...",
    ),
))  # fmt: skip
_EXPERIMENT = (
    *MATERIAL,
    option("--voxel", "voxel spacing [mm], default 0.1, or a volume's own", type=positive),
    option("--dt", "tick [ms], default 1", type=positive, default=1.0),
    option("--seed", "default: drawn and recorded", type=seed),
    option("--scheme", "default: layer", choices=["layer", "cell"], default="layer"),
    option("--stop", "immersion at which a run ends [mm], default R/3", type=positive),
    option("--max-duration", "[s] of the experiment, default 120", type=positive, default=120.0),
    VOLUME,
    LABELS,
    *OUTPUT,
)
_RADIUS = option("--radius", "burr radius R of files that do not say it [mm]", type=positive)
_SHAPE = option(
    "--shape", "erosion shape f, or a FILE.csv of x and f; default parabolic", type=shape, default="parabolic"
)
_RESIDUALS: dict[str, Any] = {
    "choices": ["relative", "absolute", "sigma", "student"], "default": "relative",
}  # fmt: skip


#: Options of what is shown live.
_LIVE = (
    OptionGroup("", (
        flag("--view", "show it in a window (extra viz3d)"),
        option(
            "--web", "show it in a web page on this machine, until Ctrl-C (extra viz3d); default any free "
                     "port; whoever has the "
            "address that is printed can work it", type=port, nargs="?", const=0, metavar="PORT",
        ),
    )),
    flag(
        "--effects", "dust, blood and, from a nozzle beside the burr, water, at assumed rates; with --view "
                     "or --web", None
    ),
    flag("--stereo", "both eyes side by side; with --view or --web, whose page has a switch for it", None),
)  # fmt: skip
_TRACE = option("file", "a trace", metavar="FILE")
_UNTIL = option("--until", "tick before which to stop, default the end", type=whole, metavar="TICK")
_PROTOCOL = option("config", "the protocol", metavar="CONFIG.toml")
_RUN = (
    _PROTOCOL,
    option("--subject", "as the protocol has it", metavar="LABEL"),
    option("--task", "one task; default: all, in the subject's own order", metavar="NAME"),
    option("--device", "instead of the protocol's", metavar="hand|scripted:FILE|igtl:HOST:PORT"),
    option(
        "--experimenter", "a file, a fifo or another terminal that shows what the subject does not see; a log is kept "
        "anyway", metavar="FILE",
    ),
    flag("--simulated", "a simulated subject instead of a person"),
    OptionGroup("simulated subjects", (
        flag("--all", "all subjects of the protocol"),
        option("--weber", "sd of the noise of a cue's logarithm an interval, default 0.45", type=positive, metavar="W"),
        option("--decision", "default: differencing", choices=["differencing", "covert"]),
        flag("--fast", "render each material once a task instead of every interval"),
    )),
)  # fmt: skip
#: What `burrlab experiment` can do.
ACTIONS = {
    "new": Command(
        "experiment", "Write a protocol to begin with, and print what its designs can show.", (_PROTOCOL,)
    ),
    "power": Command(
        "experiment", "Print what the designs of a protocol can show, before anybody has taken part.", (_PROTOCOL,)
    ),
    "run": Command("experiment", "Take a subject through the tasks, at this terminal.", _RUN),
    "resume": Command("experiment", "Go on with a run that was ended early, at the next trial.", _RUN),
    "analyse": Command("experiment", "Scores, d' and intervals of each subject and of the group.", (
        _PROTOCOL,
        JSON,
        option("--tsv", "write a row a subject and task", metavar="FILE"),
        option("--trials", "write a row a trial", metavar="FILE"),
        option("--plot", "write all figures there, as PNG", metavar="FOLDER", dest="figures"),
        flag("--incomplete", "with runs that did not come to their end"),
    )),
}  # fmt: skip
_OTHER_DATA = (
    option(
        "--indentation", "static indentation, repeatable", metavar="FILE.csv", action="append", default=[]
    ),
    option("--trace", "depth-time record, repeatable", metavar="FILE.csv", action="append", default=[]),
)
COMMANDS = {
    "descend": Command("descent", "Sink a burr at constant force and measure its penetration velocity.", (
        option("--force", "set-point [N]", type=positive, required=True),
        flag("--ideal", "hold the force exactly, without rig and controller"),
        *_EXPERIMENT,
    )),
    "sweep": Command("descent", "Penetration velocity against force, written as CSV.", (
        option("--forces", "[N]; or F,F,...", type=_numbers, required=True, metavar="FIRST:LAST:COUNT"),
        option("--repeats", "descents at each force, default 1", type=count, default=1),
        option("--out", required=True, metavar="FILE.csv"),
        flag("--rig", "through controller and virtual rig; else the force is exact"),
        option(
            "--store",
            "keep every descent as it ends (JSON lines), and take from there what an earlier sweep of "
            "the same parameters and seed has done: an interrupted one goes on; needs --seed", metavar="FILE",
        ),
        *_EXPERIMENT,
    )),
    "materials": Command("descent", "The paper's materials and their source.", (JSON,)),
    "fit": Command("descent", "Fit c_e and alpha, and say what the data determine.", (
        option("file", "velocity-force curves", metavar="FILE.csv", nargs="*"),
        _RADIUS,
        *_OTHER_DATA,
        _SHAPE,
        *EXPONENTS,
        option("--engine", choices=["mean-field", "voxel"], default="mean-field"),
        option("--residuals", **_RESIDUALS),
        option("--voxel", "voxel engine: spacing [mm], default 0.1", type=positive),
        option("--seed", "voxel engine: default drawn and recorded", type=seed),
        option("--alpha-lines", "also draw alpha +- D [1/ms], as the paper does", type=positive, metavar="D"),
        flag("--log", "logarithmic axes in the figure"),
        flag("--verbose", "also print the table of searches, with nlopt's return codes"),
        option("--region", "write a figure of the joint region of c_e and alpha", metavar="FILE"),
        option("--profile", "write a figure of c_e's profile likelihood", metavar="FILE"),
        option("--test", "are these in the joint region?", type=_pair, metavar="C_E,ALPHA"),
        option("--store", "voxel engine: keeps descents, the same command goes on", metavar="FILE"),
        option(
            "--share", "what several data sets have in common, default c_e,alpha; with c_e each has its own alpha, with alpha its own c_e",
            default=("c_e", "alpha"), type=lambda text: text.split(","), metavar="NAME,...",
        ),
        LAYOUT,
        _OFFSETS,
        *OUTPUT,
    )),
    "compare": Command("descent", "Are velocity-force curves of one material? Each data set is fitted by itself.", (
        option("file", "velocity-force curves, one a data set", metavar="FILE.csv", nargs="+"),
        option("--by", "take one file apart by a group, such as drill, into the data sets", metavar="NAME"),
        option(
            "--margin", "difference of velocity that counts as equivalent, set beforehand: 0.2 is 20 %%",
            type=positive,
        ),
        _RADIUS,
        _SHAPE,
        *EXPONENTS,
        option("--residuals", "sigma: of files that have one; the others stay relative", **_RESIDUALS),
        option(
            "--shared", "uncertain offsets that the files have in common, such as force: they cancel",
            type=lambda text: text.split(","), default=[], metavar="NAME,...",
        ),
        LAYOUT,
        _OFFSETS,
        *OUTPUT,
    )),
    "laws": Command("descent", "Which law do the data follow: how do force and erosion grow?", (
        option("file", "velocity-force curves", metavar="FILE.csv", nargs="*"),
        *_OTHER_DATA,
        _RADIUS,
        option(
            "--laws", "some of paper, linear, quartic, constant, kobra, preston-bone, preston; default all",
            type=lambda text: text.split(","), metavar="NAME,...",
        ),
        option("--level", "at which a law is contradicted, default 0.95", type=positive, default=0.95),
        _UNCERTAIN,
        option("--residuals", "default relative", choices=["relative", "sigma"], default="relative"),
        LAYOUT,
        *OUTPUT,
    )),
    "design": Command("descent", "Which measurement next? Rank candidates by how they shrink the joint region.", (
        option("fit", "of the data so far, as `burrlab fit --json` writes it", metavar="FIT.json"),
        option(
            "--forces", "of new velocities [N]; or F,F,...", type=_numbers, default=[],
            metavar="FIRST:LAST:COUNT",
        ),
        option("--radii", "of new velocities [mm], default that of the data", type=_numbers, metavar="R,R,..."),
        option("--static", "depths of new static pairs [mm]", type=_numbers, metavar="H,H,..."),
        option("--static-radius", "burr radius of static pairs [mm], default that of the data", type=positive),
        option("--repeats", "of each candidate, default 3", type=count, default=3),
        option("--scatter", "of new velocities: 0.08 is 8 %%; default that of the data", type=positive),
        option("--static-scatter", "of new static forces; default that of the data, or 0.1", type=positive),
        option("--against", "a fit of the same data by another law: runs that tell the two apart come first", metavar="FIT.json"),
        option("--truths", "values of c_e and alpha that the mean is taken over, default 100", type=count, default=100),
        option("--seed", "default: drawn and recorded", type=seed),
        OptionGroup("how large a comparison of two drills must be, instead", (
            option("--compare", "alpha of the second drill over that of the first, to be seen: 0.9", type=positive, metavar="RATIO"),
            option("--specimens", "how many, default 3:12", type=_counts, default=range(3, 13), metavar="FIRST:LAST"),
            option(
                "--runs", "of each drill in each specimen, default 6:24", type=_counts, default=range(6, 25),
                metavar="FIRST:LAST",
            ),
            option(
                "--between", "standard deviations between specimens, of ln c_e and ln alpha, and of the drills' "
                "difference: alpha=0.1,difference=0.05; default those of the fit, 0 for the difference",
                type=_sizes, metavar="NAME=SIZE,...",
            ),
            option("--power", "that is wanted, default 0.8", type=positive, default=0.8),
            option("--sheet", "write the runs of the smallest such comparison, in random order", metavar="FILE.csv"),
        )),
        *OUTPUT,
    )),
    "session": Command("session", "Burr in real time, with a device or a simulated hand.", (
        option(
            "--device", "what moves the burr: a simulated hand, a CSV of time_s,x_mm,y_mm,z_mm[,on], a "
                        "server's OpenIGTLink TRANSFORM stream, a Touch by its name in the vendor's set-up, "
                        "an Omega by its number from 0, a Haply Inverse3 (extra haply) by the address of its "
                        "service, default localhost:10001, or a VRPN server's Tracker, default port 3883, with tcp:// "
                        "without UDP; given twice, two burrs",
            action="append", required=True,
            metavar="hand|scripted:FILE|igtl:HOST:PORT|touch[:NAME]|omega[:N]|haply[:HOST:PORT]|vrpn:NAME@[tcp://]HOST[:PORT]",
        ),
        option(
            "--lost-after", "age at which a position of a device or over the network counts as lost, and the session stops "
                            "[ms], default 100; a "
            "peer that sends only what changes (3D Slicer) "
            "needs more", type=positive, default=100.0, metavar="MS",
        ),
        option("--record", "write the complete trace (HDF5), a new file", metavar="FILE"),
        option(
            "--publish",
            "publish poses, forces and ticks over OpenIGTLink on this port (0: any free one); there is no "
            "authentication: whoever reaches the port can read the session", type=port, metavar="PORT",
        ),
        option(
            "--vrpn",
            "publish each burr over VRPN on this port (0: any free one; VRPN's own is 3883), as the Tracker and "
            "ForceDevice burrlab_burr_0, burrlab_burr_1; as open as --publish", type=port, metavar="PORT",
        ),
        option("--host", "address to publish on, default 127.0.0.1: this machine only"),
        option("--header-version",
            "of the OpenIGTLink messages, default 1", type=int, choices=[1, 2], default=1),
        flag("--no-sensor", "publish the force without SENSOR messages, which 3D Slicer does not know"),
        option("--duration", "[s], default until Ctrl-C", type=positive, metavar="S"),
        *_LIVE,
        option("--rate", "of the loop [Hz], default 1000", type=positive, default=1000.0),
        *MATERIAL,
        option("--push", "of a simulated hand [N], default 1", type=positive, default=1.0),
        flag("--volume-frame", "scripts are in the volume's own coordinates, as --entry is, not in the bone frame"),
        option("--voxel",
            "of the block of 30 x 30 x 10 mm [mm], default 0.1, or a volume's own", type=positive),
        VOLUME,
        LABELS,
        OptionGroup("a bone that is kept, half-drilled", (
            option(
                "--save",
                "keep the bone at the end: in the volume's format and with its header (.nrrd, .nii, .nii.gz, "
                ".mha; a new folder for PNG "
                "slices or DICOM), with the exact state beside it; or .h5, the exact state alone", metavar="FILE",
            ),
            option("--bone", "go on with a bone that --save has kept", metavar="FILE"),
        )),
        WATCH,
        option("--seed", "default: drawn and recorded", type=seed),
        option("--force-limit", "of the force sent [N], default 8", type=positive, default=8.0),
        option("--slew-limit", "of its change [N/ms], default 1", type=positive, default=1.0),
        option(
            "--model", "of the device, whose force limits hold too; given twice, one a device; default what a touch, "
                       "omega or haply says that it is, 'none' for no such limits; see docs/stability.md",
            action="append", metavar="MODEL",
        ),
        option(
            "--ramp", "time over which the allowed force grows at the first contact [s], default 1 with a model's "
                      "limits", type=_not_negative, metavar="S",
        ),
        option("--stop-at-force", "end the session when a force reaches this [N]", type=positive, metavar="N"),
        option(
            "--stop-within", "end it when a burr comes so near to a watched structure [mm], as often as "
                             "needed", action="append", type=_nearness, metavar="TISSUE:MM",
        ),
        option("--stop-button", "end it at this button of a device, 0 the first", type=whole, metavar="INDEX"),
        option("--scale", "motion of the burr over that of the device, default 1", type=positive, metavar="S"),
        option(
            "--rotation", "unit quaternion that turns the device's axes into the bone's",
            type=parsed_by(lambda text: floats(text, 4, "W,X,Y,Z", text)), metavar="W,X,Y,Z",
        ),
        option(
            "--offset", "place of the device's origin [mm]; default 0,0,0, of a touch, omega or haply the place where a "
                        "simulated hand starts", type=vector, metavar="X,Y,Z",
        ),
        option(
            "--clutch", "button, 0 the first, that while held leaves the burr where it is", type=whole,
            metavar="INDEX",
        ),
        option("--coupling", "spring between device and burr [N/mm], default none", type=positive),
        flag("--virtual-clock", "ticks as fast as possible, for devices that need no clock (scripted, hand)"),
        flag("--no-realtime", "do not ask for real-time priority and locked memory"),
        *OUTPUT,
    )),
    "devices": Command("session", "Haptic devices: what was looked for, what was found, and why not.", (JSON,)),
    "replica": Command("session", "Hold a bit-identical copy of a published session's bone.", (
        option("address", "of a session with --publish", type=parsed_by(lambda text: importlib.import_module("burrlab.session.exchange").parse_address(text)), metavar="HOST:PORT"),
        option("--volume", "the leader's volume, where it lies elsewhere here", metavar="FILE"),
        option("--duration", "[s], default until the session ends", type=positive, metavar="S"),
        *_LIVE,
        option("--save", "write the bone at the end (HDF5)", metavar="FILE"),
        JSON,
    )),
    "replay": Command("session", "Execute a trace again and compare: exit status 0 equal, 1 different.", (
        _TRACE,
        _UNTIL,
        JSON,
    )),
    "metrics": Command("session", "How the burr was handled: time, motion, force, bone removed.", (
        _TRACE,
        option("--burr", "default 0", type=whole, default=0, metavar="INDEX"),
        option("--threshold", "of the force [N], default 2", type=positive, metavar="N"),
        option("--hysteresis", "least stroke [mm], default 1", type=positive, metavar="MM"),
        option("--target", "labels on the bone's grid, not 0 where bone was to be removed", metavar="VOLUME"),
        flag("--onto", "a target on other voxels than the bone: bring the nearest on its own"),
        RECORDED,
        WATCH,
        *OUTPUT,
    )),
    "export": Command("session", "Write a trace for volumetric_drilling (.hdf5) or as a table (.csv), a cavity as a closed "
            "surface (.stl, .ply), or a bone for C++ programs (.burr).", (
        option("file", "a trace; for a surface or .burr also a bone that was kept (.h5, .burr, or a half-drilled volume); "
            "for .burr instead of --volume and --labels", metavar="FILE", nargs="?"),
        option("--out", "a new file, whose ending says what is written: .hdf5 as volumetric_drilling records a session, "
                        ".csv a row a tick and burr, .stl or .ply the surface of what was removed [mm], .burr a flat file",
               required=True, metavar="FILE"),
        option("--burr", "that is the drill in .hdf5, default 0", type=whole, metavar="INDEX"),
        flag("--old", ".hdf5 in the layout of recordings before 2025"),
        flag("--left", "the surface of what is left"),
        option(
            "--level", "of 255 that a voxel at the surface lost, or has left; default where the volume is the voxels', "
                       "about 128", type=whole_number("from 1 to 255", 1, 255), metavar="LEVEL",
        ),
        _UNTIL,
        option("--voxel", "of a volume's bone [mm], default its own", type=positive),
        VOLUME,
        LABELS,
        JSON,
    )),
    "view": Command("view", "Show a recorded session, a bone or a volume: window, PNG, film or web page.", (
        option("file", "a trace; its --entry and --axis are in the bone frame. Or a recording of volumetric_drilling, "
            "with --bone, --volume or --labels", metavar="TRACE", nargs="?"),
        option("--bone",
            "a bone that was kept (.h5, or a volume with its state) instead of a trace", metavar="FILE"),
        option("--at", "time of the trace [s], default its end", type=number, metavar="S"),
        option("--png", "write a picture; no window opens", metavar="FILE"),
        option("--pictures",
            "write slices and, if bone was removed, FILE-depth, by matplotlib alone", metavar="FILE"),
        option("--video", "write a film of the trace, .mp4 or .gif; no window opens", metavar="FILE"),
        option("--fps", f"of the film [1/s], default {FPS:g}", type=positive),
        option("--speed", "of the trace in the film, default 1", type=positive),
        flag("--stereo", "both eyes side by side", None),
        flag("--slices", "slices through the burr, the entry or the middle", None),
        option("--size", "[pixel], default 1024x768", type=_size, metavar="WxH"),
        option("--width", "that the view holds, top to bottom [mm]", type=positive, metavar="MM"),
        flag("--web", "serve a page for a browser instead of a window"),
        option("--port", "of the page, default any free one", type=port),
        flag("--effects",
            "dust, blood and, from a nozzle beside the burr, water of a trace, at assumed rates", None),
        option("--voxel", "of a volume's bone [mm], default its own", type=positive),
        RECORDED,
        VOLUME,
        LABELS,
        JSON,
    )),
    "experiment": Command("experiment", "Can it be felt? Psychophysical experiments, designed, run and analysed.", ()),
    "tissues": Command("bone", "The labels of a segmentation, with voxels, and what they are.", (
        option(
            "file", "labels (NRRD, NIfTI, MetaImage, coloured PNG slices or their YAML file), or a table (.csv); "
                    "without it, the "
            "structures that are known by name", metavar="FILE", nargs="?",
        ),
        option("--tissues", "a table to look the labels up in", metavar="FILE.csv"),
        option("--template", "write a table of the file's labels, to be completed", metavar="FILE.csv"),
        option("--spacing", "of the voxels, where the file has none [mm]", type=spacing, metavar="X,Y,Z"),
        *STACK,
        JSON,
    )),
    "version": Command("descent", "Version and what it runs on.", (JSON,)),
}  # fmt: skip
