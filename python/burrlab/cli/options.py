"""Shared by the commands: options and their types, refusals, output and the end by a signal.

A mistyped option is named at once: no module that makes bones is imported here.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar

import burrlab
from burrlab._core import Material, Shape, shape_names
from burrlab.common.check import amend_error, refuse
from burrlab.common.figures import Axes
from burrlab.common.files import kept_elsewhere, new_file, write_text
from burrlab.common.progress import Progress, doing
from burrlab.common.table import Column, Problem, Table, not_negative
from burrlab.theory.tool import PAPER_LAW

Options = argparse.Namespace
Numbers = tuple[float, float, float]
Made = TypeVar("Made")


class Option(NamedTuple):
    """An option of a command, as `argparse` takes it."""

    name: str
    settings: dict[str, Any]


class OptionGroup(NamedTuple):
    """Options under their own title in the help; without a title, options that exclude one another."""

    title: str
    options: tuple[Option, ...]


def option(name: str, help: str | None = None, **settings: Any) -> Option:
    """An option with a value, or with the action that the settings name."""
    return Option(name, {"help": help, **settings})


def flag(name: str, help: str, default: bool | None = False) -> Option:
    """An option without a value; None as default shows that it was not given."""
    return Option(name, {"help": help, "action": "store_true", "default": default})


def add_options(parser: Any, options: Sequence[Option | OptionGroup]) -> None:
    """Adds options and groups of options to a parser."""
    for option in options:
        if isinstance(option, Option):
            parser.add_argument(option.name, **option.settings)
        else:
            title, exclusive = option.title, parser.add_mutually_exclusive_group
            add_options(parser.add_argument_group(title) if title else exclusive(), option.options)


def parsed_by(parse: Callable[[str], Made]) -> Callable[[str], Made]:
    """The type of an option; it refuses with the message of the ValueError or OSError of `parse`."""

    def parsed(text: str) -> Made:
        try:
            return parse(text)
        except (ValueError, OSError) as error:
            raise argparse.ArgumentTypeError(sentence(error)) from None

    return parsed


@parsed_by
def number(text: str) -> float:
    """A finite number."""
    (value,) = floats(text, 1, "a number", text)
    refuse(not math.isfinite(value), f"must be finite, got '{text}'")
    return value


@parsed_by
def positive(text: str) -> float:
    """A number above 0."""
    value = number(text)
    refuse(value <= 0, f"must be positive, got '{text}'")
    return value


def whole_number(rule: str, least: int = 0, most: float = math.inf) -> Callable[[str], int]:
    """The type of an option that takes a whole number; `rule` completes "must be"."""

    def parse(text: str) -> int:
        refuse(not (text.isdecimal() and least <= int(text) <= most), f"must be {rule}, got '{text}'")
        return int(text)

    return parsed_by(parse)


count = whole_number("a whole number from 1", 1)
whole = whole_number("a whole number from 0")
seed = whole_number("a whole number below 2^64", most=2**64 - 1)
port = whole_number("a port, 0 to 65535", most=65535)


@parsed_by
def shape(text: str) -> Shape:
    """An erosion shape f by its name, or of a CSV file with columns x and f."""
    if not text.lower().endswith(".csv"):
        return Shape(text)
    above: list[tuple[float, float]] = []

    def rule(row: Mapping[str, float]) -> Problem:
        x, f = (row.get(name, math.nan) for name in "xf")  # a column may be missing
        above.append((x, f))
        if len(above) > 1 and x <= above[-2][0]:
            return "x", f"must be above the {above[-2][0]:g} of the row before: got {x:g}"
        return ("f", f"must be at most f(0) = {above[0][1]:g}: got {f:g}") if f > above[0][1] else None

    table = Table(tuple(Column(name, check=not_negative, due="a number") for name in "xf"), rule=rule)
    name, _, columns = table.read(text)
    with amend_error(f"{name}: "):
        return Shape.from_table(columns["x"], columns["f"])


JSON = option("--json", "write the result as JSON; - for standard output", metavar="FILE")
OUTPUT = (JSON, option("--plot", "write a figure (PNG, PDF, SVG by its ending)", metavar="FILE"))
EXPONENTS = (
    option(
        "--force-exponent",
        "q of the force c_e R^2 (h/R)^q, from 1, without unit; default the material's, 1.5",
        type=number,
    ),
    option(
        "--rate-exponent",
        "m of the rate alpha (F/1 N)^m, from 0, without unit; default the material's, 0; alpha is the rate at 1 N",
        type=number,
    ),
)
MATERIAL = (
    option("--material", "default: bone", choices=sorted(burrlab.materials), default="bone"),
    option("--c-e", "elastic constant instead of the material's [N/mm^2]", type=positive),
    option("--alpha", "erosion rate instead of the material's [1/ms]", type=positive),
    option(
        "--shape",
        f"erosion shape f: {', '.join(shape_names)}, power(k), or a FILE.csv of x and f",
        type=shape,
    ),
    *EXPONENTS,
    option("--radius", "burr radius R [mm], default 3", type=positive, default=3.0),
)


def chosen_material(options: Options) -> Material:
    """The material of the options: a named one, possibly with changes."""
    named = burrlab.materials[options.material]
    constants = {key: getattr(options, key) for key in ("c_e", "alpha", "shape", *PAPER_LAW)}
    if set(constants.values()) == {None}:
        return named
    chosen = {key: getattr(named, key) if value is None else value for key, value in constants.items()}
    with warnings_said():
        return Material(f"{named.name}, modified", **chosen, source="command line")


def chosen_law(options: Options) -> burrlab.Law:
    """The law of the options."""
    exponents = {name: getattr(options, name) for name in PAPER_LAW if getattr(options, name) is not None}
    return burrlab.Law(options.shape, **exponents)


def refuse_options(options: Options, names: Sequence[str], why: str, applies: bool = True) -> None:
    """ValueError "--NAME why" for the first of these options that was given, where the rule applies."""
    for name in names if applies else ():
        value = getattr(options, name)
        # --no-transpose counts as given and is False; other flags are False where they are not given
        is_set = value is not None and (value is not False or name == "transpose") and value != []
        refuse(is_set, f"--{name} {why}")


def require_options(options: Options, names: Sequence[str], what: str) -> None:
    """ValueError "what needs --NAME and --NAME" for those of these options that are missing."""
    missing = [f"--{name}" for name in names if getattr(options, name) is None]
    refuse(missing, f"{what} needs {' and '.join(missing)}")


_FIGURES = ("plot", "region", "profile", "pictures")
_FILES = ("json", *_FIGURES, "out", "record", "save", "template", "trials", "tsv", "png", "video")


def save_figure(axes: Axes, path: str) -> None:
    """Writes the figure of some axes."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    _write(path, f"figure{Path(path).suffix}", lambda place: figure.savefig(place, dpi=200), "the figure")


def plot(path: str | None, draw: Callable[[], Axes] | None) -> None:
    """Draws and writes a figure if a path is given."""
    if path is not None and draw is not None:
        save_figure(draw(), path)


class NotKept(OSError):
    """The work is done, but its result could not be written where the user wanted it."""


@contextlib.contextmanager
def elsewhere_after(
    path: str, name: str, write: Callable[[str], object], what: str, *errors: type[Exception]
) -> Iterator[None]:
    """Keeps a result elsewhere after one of these errors, as on a full disk; the NotKept says where."""
    try:
        yield
    except errors as error:
        number, why = (error.errno, error.strerror) if isinstance(error, OSError) else (None, None)
        place = kept_elsewhere(path, name, write)
        raise NotKept(
            number, f"{why or error}{f'; {what} is kept as {place}' if place else ''}", path
        ) from error


def _write(path: str, name: str, write: Callable[[str], object], what: str) -> None:
    with elsewhere_after(path, name, write, what, OSError), new_file(path, Path(path).suffix) as part:
        write(os.fspath(part))


def check_outputs(options: Options, arguments: Sequence[str]) -> None:
    """ValueError before any work if a result could not be written, or would replace a file of `given`."""
    texts = [text.partition("=")[2] if text.startswith("--") else text for text in arguments]
    # an experiment checks its own files
    files = [
        Path(text).resolve()
        for text in texts
        if os.path.isfile(text) and text != getattr(options, "config", None)
    ]
    outputs: dict[Path, str] = {}
    paths = [
        (name, path)
        for name in _FILES
        if (path := getattr(options, name, None)) is not None
        and (path != "-" or name in _FIGURES)  # "-" is standard output, for text
    ]
    for name, path in paths:
        place, folder = Path(path).resolve(), Path(path).resolve().parent
        writable = folder.is_dir() and os.access(folder, os.W_OK)
        # slices are saved as a folder
        refuse(not writable or (place.is_dir() and name != "save"), f"--{name}: {path} cannot be written")
        # No command replaces a trace, no export a file.
        new = name == "record" or (name, options.command) == ("out", "export")
        refuse(new and place.exists(), f"--{name} must be a new file, {path} exists")
        other = outputs.setdefault(place, name)
        refuse(other != name, f"--{name} must be another file than --{other}, got {path}")
        # a bone may be saved in its place
        refuse(name != "save" and files.count(place) > 1, f"--{name}: {path} is read, and would be lost")
        if name in _FIGURES:
            from matplotlib.figure import Figure

            kinds = Figure().canvas.get_supported_filetypes()
            refuse(
                Path(path).suffix[1:].lower() not in kinds,
                f"--{name}: {path} must end in one of {', '.join(sorted(kinds))}",
            )


def deliver(
    options: Options, result: dict[str, Any], text: str, draw: Callable[[], Axes] | None = None
) -> None:
    """Prints a result as text, writes it as JSON if --json is given, and draws it if --plot is given."""
    print(json.dumps(result, allow_nan=False) if options.json == "-" else text)
    with contextlib.ExitStack() as also:  # a result that cannot be written loses no figure
        also.callback(plot, getattr(options, "plot", None), draw)
        if options.json not in ("-", None):
            text = json.dumps(result, allow_nan=False, indent=1) + "\n"
            _write(options.json, "result.json", lambda place: write_text(place, text), "the result")


def sentence(error: Exception) -> str:
    """The message of an error in one line."""
    if isinstance(error, OSError) and error.strerror is not None:  # without errno
        return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def say(text: str) -> None:
    """Prints a message to standard error."""
    show_line("")
    print(f"burrlab: {text}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def warnings_said() -> Iterator[None]:
    """Prints warnings as messages to standard error."""
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        yield
    for doubt in doubts:
        say(str(doubt.message))


def show_line(line: str) -> None:
    """Shows a line on a terminal, until the next one replaces it."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)


@contextlib.contextmanager
def working(text: str) -> Iterator[None]:
    """Shows on a terminal what is done; elsewhere it is logged if it takes long."""
    show_line(text)
    try:
        with contextlib.nullcontext() if sys.stderr.isatty() else doing(text):
            yield
    finally:
        show_line("")


def on_terminal() -> Progress | None:
    """The `progress` of a command: a bar on a terminal, else a note in the log if it takes long."""
    return True if sys.stderr.isatty() else None


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Lets SIGTERM and a closed terminal act like Ctrl-C: with force zero and a whole trace."""
    # only the main thread may set handlers
    names = ("SIGTERM", "SIGHUP") if threading.current_thread() is threading.main_thread() else ()
    terminals = [stream for stream in (sys.stdout, sys.stderr) if stream is not None and stream.isatty()]

    def end(*_: object) -> NoReturn:
        for stream in terminals:
            if not stream.isatty():  # it is closed: text that goes there would be an error
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        raise KeyboardInterrupt

    with contextlib.ExitStack() as after:
        for number in [getattr(signal, name) for name in names if hasattr(signal, name)]:
            after.callback(signal.signal, number, signal.signal(number, end))
        yield


@parsed_by
def filling(text: str) -> tuple[str, float]:
    """TISSUE:OCCUPANCY."""
    name, _, part = text.rpartition(":")
    (occupancy,) = floats(part, 1, "TISSUE:OCCUPANCY, 0 to 1", text)
    refuse(not name or not 0.0 <= occupancy <= 1.0, f"must be TISSUE:OCCUPANCY, 0 to 1, got '{text}'")
    return name, occupancy


@parsed_by
def label_or_word(text: str) -> str | int:
    """A label, "nearest", or "nearest:" with names of structures."""
    if text in ("nearest", "refuse") or text.startswith("nearest:"):
        return text
    refuse(not (text.isascii() and text.isdecimal()), f"must be nearest or a label, got '{text}'")
    return int(text)


@parsed_by
def vector(text: str) -> Numbers:
    """X,Y,Z."""
    return _three(text, "X,Y,Z", text)


@parsed_by
def spacing(text: str) -> Numbers:
    """X,Y,Z, or one number for all."""
    lengths = _three(text if "," in text else f"{text},{text},{text}", "positive X,Y,Z", text)
    refuse(min(lengths) <= 0, f"must be positive X,Y,Z, got '{text}'")
    return lengths


@parsed_by
def box(text: str) -> tuple[Numbers, Numbers]:
    """X,Y,Z:X,Y,Z."""
    low, _, high = text.partition(":")
    return _three(low, "X,Y,Z:X,Y,Z", text), _three(high, "X,Y,Z:X,Y,Z", text)


def _three(text: str, form: str, whole: str) -> Numbers:
    x, y, z = floats(text, 3, form, whole)
    refuse(not all(map(math.isfinite, (x, y, z))), f"must be {form} of finite numbers, got '{whole}'")
    return x, y, z


def floats(text: str, count: int, form: str, whole: str) -> tuple[float, ...]:
    """So many numbers between commas; ValueError "must be FORM" for anything else in the `whole` text."""
    numbers: tuple[float, ...] = ()
    with contextlib.suppress(ValueError):
        numbers = tuple(map(float, text.split(",")))
    refuse(len(numbers) != count, f"must be {form}, got '{whole}'")
    return numbers


#: Options of a volume, without --voxel, which a block has too.
VOLUME = OptionGroup(
    "a grey volume instead of a block (NRRD, NIfTI, MetaImage, a folder of DICOM or PNG slices; extra "
    "medical)",
    (
        option("--volume", "the grey volume, a file or folder; --voxel resamples it", metavar="FILE"),
        option(
            "--map", "grey values of empty and solid; or a table GREY:OCCUPANCY,GREY:OCCUPANCY,..., 0 to 1",
            type=parsed_by(lambda text: burrlab.OccupancyMap.parse(text)), metavar="LO:HI",
        ),
        option(
            "--entry",
            "where the axis begins, volume's own coordinates, LPS [mm]", type=vector, metavar="X,Y,Z"
        ),
        option("--axis",
            "direction of the descent (a block too; default 0,0,-1)", type=vector, metavar="X,Y,Z"),
        option(
            "--spacing", "of the volume's voxels, where its file has none, and of labels in slices [mm]",
            type=spacing, metavar="X,Y,Z",
        ),
        option("--series", "SeriesInstanceUID in a folder with several", metavar="UID"),
        option(
            "--crop", "two corners of the part that is kept, volume's own coordinates [mm]",
            type=box, metavar="X,Y,Z:X,Y,Z",
        ),
    ),
)  # fmt: skip
#: Option of a recording of volumetric_drilling.
RECORDED = option(
    "--scale", "what the recorder of volumetric_drilling multiplied lengths by, since June 2023 0.0492027 unless it "
    "was given a header; default 1, or as the bone's voxels tell", type=positive, metavar="S",
)  # fmt: skip
#: Options of coloured slices.
STACK = (
    option(
        "--unknown",
        "what colours in no table are, default refused: this label, or the nearest; critical structures only "
        "by name",
        type=label_or_word, metavar="LABEL|nearest[:NAME,NAME]",
    ),
    option(
        "--transpose",
        "the number of a pixel's row in PNG slices, grey ones too, counts along x, and not along y; default "
        "yes with a YAML file",
        action=argparse.BooleanOptionalAction,
    ),
    option("--unit", "of the dimensions in a YAML file [mm], default a metre", type=positive, metavar="MM"),
)  # fmt: skip
LABELS = OptionGroup(
    "labels of tissues: with --volume on its voxels, or alone, then what is labelled is solid",
    (
        option(
            "--labels",
            "NRRD (.seg.nrrd), NIfTI, MetaImage; coloured PNG slices or their YAML file", metavar="FILE"
        ),
        option(
            "--tissues", "what the labels are (`burrlab tissues`); default by their names", metavar="FILE.csv"
        ),
        option(
            "--fill",
            "the least occupancy of a tissue, 0 to 1, where the map takes it as empty; as often as needed",
            type=filling, action="append", default=[], metavar="TISSUE:OCCUPANCY",
        ),
        flag("--onto", "labels on other voxels than the volume: bring the nearest on its own"),
        option(
            "--smooth",
            "of labels alone: standard deviation of a Gaussian over the border of solid and empty [mm]",
            type=positive, metavar="MM",
        ),
        *STACK,
    ),
)  # fmt: skip
