"""While the modules of a command load: Ctrl-C ends it at once, with status 130 and no traceback, and a subject
reads that an experiment is being prepared.
"""

import _signal  # type: ignore[import-not-found]  # "signal" itself loads others
import os
import sys


def _is_command() -> bool:
    """Whether `burrlab` or `python -m burrlab` runs, not a program that imports burrlab."""
    arguments: list[str] = getattr(sys, "argv", None) or [""]
    if arguments[0] == "-m":  # Python still looks for the package of -m
        return sys.orig_argv[-len(arguments)].removeprefix("-m") == "burrlab"
    return os.path.splitext(os.path.basename(arguments[0]))[0] == "burrlab"


def _is_for_subject() -> bool:
    """Whether the command is an experiment with a person at this terminal."""
    given = sys.argv[1:]
    person = "--simulated" not in given and any(text.startswith("--subject") for text in given)
    return given[:2] in (["experiment", "run"], ["experiment", "resume"]) and person and os.isatty(1)


def _leave(*_: object) -> None:
    os._exit(130)


def started() -> None:
    """Makes Ctrl-C a KeyboardInterrupt again."""
    if _signal.getsignal(_signal.SIGINT) is _leave:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


if _is_command() and _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, _leave)
if _is_command() and _is_for_subject():
    print("Preparing ...", flush=True)  # until the first page
