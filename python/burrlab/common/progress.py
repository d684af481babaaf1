"""Progress of long work: a function of the user, a bar on standard error, or a note in the log."""

from __future__ import annotations

import inspect
import logging
import time
import warnings
from collections.abc import Callable
from typing import TypeAlias

from tqdm import tqdm

#: A function of the fraction done, 0 to 1; or True for a bar on standard error.
Progress: TypeAlias = Callable[[float], object] | bool

LOG = logging.getLogger("burrlab")
LONG = 10.0  # time left that is worth a note [s] (ours)


def reporter(progress: Progress | None, what: str) -> Callable[[float], object]:
    """A function that takes the fraction done; TypeError unless `progress` is callable, True, False or None."""
    if progress is None or progress is False:
        return lambda done: None
    if progress is True:
        bar = tqdm(total=100, desc=what, leave=False, bar_format="{l_bar}{bar}| {elapsed}<{remaining}")
        return lambda done: bar.update(int(100 * done) - bar.n)
    if not callable(progress):
        raise TypeError(
            f"progress must be a function of the fraction done, or True for a bar, got {progress!r}"
        )
    return progress


def counter(progress: Progress | None, what: str) -> Callable[[int, int], object]:
    """As `reporter`, of (done, in all). A function of these two is deprecated."""
    told = reporter(progress, what)
    try:
        inspect.signature(told).bind(0.0)
    except TypeError:
        warnings.warn(
            "progress takes one number, the fraction done; with (done, in all) it is deprecated",
            DeprecationWarning,
            stacklevel=3,
        )
        return told  # type: ignore[return-value]
    except ValueError:  # compiled, without a signature
        pass
    return lambda done, total: told(done / max(total, 1))


def duration(seconds: float) -> str:
    """In s, min or h."""
    size, unit = (3600, "h") if seconds >= 7200 else (60, "min") if seconds >= 120 else (1, "s")
    return f"{seconds / size:.0f} {unit}"


def foretold(what: str) -> Callable[[float], None]:
    """A function that takes the fraction done, and after a second logs once how long the rest takes, if long."""
    first: list[tuple[float, float]] = []

    def follow(done: float) -> None:
        now = time.monotonic()
        if len(first) == 1 and now - first[0][0] > 1.0 and done > first[0][1]:
            begun, before = first[0]
            left = (now - begun) * (1.0 - done) / (done - before)
            first.append((now, done))  # once
            if left > LONG:
                LOG.warning(
                    "%s: about %s more; progress=True shows a bar, Ctrl-C ends it", what, duration(left)
                )
        elif not first:
            first.append((now, done))

    return follow
