"""Ctrl-C while a command's modules load ends it at once: status 130, and not a word of what was being loaded."""

import _signal  # type: ignore[import-not-found]  # "signal" itself loads others
import os
import sys


def _is_command() -> bool:
    """Whether what runs is `burrlab` or `python -m burrlab`; not a program that imports it."""
    arguments: list[str] = getattr(sys, "argv", None) or [""]
    if arguments[0] == "-m":  # while the package of -m is looked for
        return sys.orig_argv[-len(arguments)].removeprefix("-m") == "burrlab"
    return os.path.splitext(os.path.basename(arguments[0]))[0] == "burrlab"


def _leave(*_: object) -> None:
    os._exit(130)


def started() -> None:
    """From here on Ctrl-C is a KeyboardInterrupt again."""
    if _signal.getsignal(_signal.SIGINT) is _leave:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


if _is_command() and _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, _leave)
