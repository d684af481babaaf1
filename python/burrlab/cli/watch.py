"""Options of the commands that watch critical structures: which ones, and when nearness to them is told."""

from __future__ import annotations

import argparse
import math
from typing import Any

from burrlab._core import VoxelBone
from burrlab.anatomy.watch import Watch, critical_structures

_LIMITS = ("approach", "touch", "injury")
_NOTHING = "none"


def add_watch_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--watch`, `--approach`, `--touch` and `--injury`."""
    watch = parser.add_argument_group("critical structures, where the bone has tissues (docs/anatomy.md)")
    watch.add_argument(
        "--watch", action="append", metavar="TISSUE",
        help="a structure to watch, as often as needed; default all that are critical; 'none' for no watch",
    )  # fmt: skip
    for name, unit, what in (
        ("approach", "MM", "distance of the burr's surface at which an approach is told [mm], default 2"),
        ("touch", "MM", "and a touch [mm], default 0"),
        ("injury", "MM3", "volume removed from a structure from which on it is told as injured [mm^3], default 0"),
    ):  # fmt: skip
        watch.add_argument(f"--{name}", type=_not_negative, metavar=unit, help=what)


def watch_asked_for(options: argparse.Namespace) -> bool:
    """Whether one of the options was given."""
    return any(getattr(options, name) is not None for name in ("watch", *_LIMITS))


def chosen_watch(options: argparse.Namespace, bone: VoxelBone) -> Watch | None:
    """Of the options; None where there is nothing to watch. ValueError for options that do not fit the bone."""
    limits: dict[str, Any] = {
        name: value for name in _LIMITS if (value := getattr(options, name)) is not None
    }
    if options.watch == [_NOTHING]:
        if limits:
            raise ValueError(f"--{next(iter(limits))} goes with a watch, not with --watch {_NOTHING}")
        return None
    if not watch_asked_for(options) and not critical_structures(bone):
        return None
    if bone.tissues is None:
        given = next(name for name in ("watch", *_LIMITS) if getattr(options, name) is not None)
        raise ValueError(f"--{given} needs a bone with tissues")
    return Watch(bone, structures=options.watch, **limits)


def _not_negative(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"must be zero or positive, got '{text}'")
    return value
