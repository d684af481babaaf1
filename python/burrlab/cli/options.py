"""What the commands share: types of their options, and options that several of them have."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence

import burrlab
from burrlab._core import Material, Shape

Options = argparse.Namespace
#: Adds a command: its name, what runs it, its help.
AddCommand = Callable[[str, Callable[[Options], int], str], argparse.ArgumentParser]


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got '{text}'") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"must be finite, got '{text}'")
    return value


def positive(text: str) -> float:
    """A number above 0."""
    value = number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"must be positive, got '{text}'")
    return value


def count(text: str) -> int:
    """A whole number from 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1, got '{text}'")
    return int(text)


def seed(text: str) -> int:
    """A whole number below 2^64."""
    if not text.isdecimal() or int(text) >= 2**64:
        raise argparse.ArgumentTypeError(f"must be a whole number below 2^64, got '{text}'")
    return int(text)


def shape(text: str) -> Shape:
    """An erosion shape by its name."""
    try:
        return Shape(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def whole(text: str) -> int:
    """A whole number from 0."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a whole number from 0, got '{text}'")
    return int(text)


def port(text: str) -> int:
    """A port; 0 is any free one."""
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"must be a port, 0 to 65535, got '{text}'")
    return int(text)


def add_output_options(parser: argparse.ArgumentParser, plot: bool = True) -> None:
    """Adds `--json` and `--plot`."""
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON; - for standard output")
    if plot:
        parser.add_argument("--plot", metavar="FILE", help="write a figure (PNG, PDF, SVG by its ending)")


def add_material_options(parser: argparse.ArgumentParser) -> None:
    """Adds the material and the burr."""
    parser.add_argument("--material", choices=sorted(burrlab.materials), default="bone", help="default: bone")
    parser.add_argument("--c-e", type=positive, help="elastic constant instead of the material's [N/mm^2]")
    parser.add_argument("--alpha", type=positive, help="erosion rate instead of the material's [1/ms]")
    parser.add_argument(
        "--shape", type=shape, help="erosion shape f: parabolic, linear, quartic, constant, power(k)"
    )
    parser.add_argument("--radius", type=positive, default=3.0, help="burr radius R [mm], default 3")


def chosen_material(options: Options) -> Material:
    """Of the options: a named one, or that with changes."""
    named = burrlab.materials[options.material]
    if options.c_e is None and options.alpha is None and options.shape is None:
        return named
    return Material(
        f"{named.name}, modified",
        c_e=named.c_e if options.c_e is None else options.c_e,
        alpha=named.alpha if options.alpha is None else options.alpha,
        shape=named.shape if options.shape is None else options.shape,
        source="command line",
    )


def refuse_options(options: Options, names: Sequence[str], why: str) -> None:
    """ValueError for the first of these that was given: --NAME why."""
    for name in names:
        value = getattr(options, name)
        # --no-transpose is given as much as --transpose; a flag without a "no" is False where it is not
        if value is not None and (value is not False or name == "transpose") and value != []:
            raise ValueError(f"--{name} {why}")


def require_options(options: Options, names: Sequence[str], what: str) -> None:
    """ValueError that names all of these that are missing: what needs --NAME and --NAME."""
    missing = [f"--{name}" for name in names if getattr(options, name) is None]
    if missing:
        raise ValueError(f"{what} needs {' and '.join(missing)}")
