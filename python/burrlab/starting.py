"""Ctrl-C while the modules of a command load ends it at once, with status 130 and no traceback."""

import _signal  # type: ignore[import-not-found]  # "signal" itself loads others
import os
import sys


def _is_command() -> bool:
    """Whether `burrlab` or `python -m burrlab` runs, not a program that imports burrlab."""
    arguments: list[str] = getattr(sys, "argv", None) or [""]
    if arguments[0] == "-m":  # Python still looks for the package of -m
        return sys.orig_argv[-len(arguments)].removeprefix("-m") == "burrlab"
    return os.path.splitext(os.path.basename(arguments[0]))[0] == "burrlab"


def _leave(*_: object) -> None:
    os._exit(130)


def started() -> None:
    """Makes Ctrl-C a KeyboardInterrupt again."""
    if _signal.getsignal(_signal.SIGINT) is _leave:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


if _is_command() and _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, _leave)
