"""Progress of long work: a function of the user, a bar on standard error, or a note in the log; and Ctrl-C."""

import contextlib
import logging
import math
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import TypeAlias, TypeVar

#: A function of the fraction done, 0 to 1; or True for a bar on standard error.
Progress: TypeAlias = Callable[[float], object] | bool

LOG = logging.getLogger("burrlab")
LONG, EACH = 2.0, 10.0  # work that is worth a note, and the time between two notes [s] (ours)
Made = TypeVar("Made")


def reporter(progress: Progress | None, what: str) -> Callable[[float], object]:
    """A function that takes the fraction done; TypeError unless `progress` is callable, True, False or None.

    None: long work says in the log how long it takes; False: it says nothing.
    """
    if progress is None:
        return foretold(what)
    if progress is False:
        return lambda done: None
    if progress is True:
        from tqdm import tqdm  # costs time at every start of a command

        bar = tqdm(total=100, desc=what, leave=False, bar_format="{l_bar}{bar}| {elapsed}<{remaining}")
        return lambda done: bar.update(int(100 * done) - bar.n)
    if not callable(progress):
        raise TypeError(
            f"progress must be a function of the fraction done, or True for a bar, got {progress!r}"
        )
    return progress


def counter(progress: Progress | None, what: str) -> Callable[[int, int], object]:
    """As `reporter`, of (done, in all)."""
    report = reporter(progress, what)
    return lambda done, total: report(done / max(total, 1))


def duration(seconds: float) -> str:
    """In s, min or h."""
    size, unit = (3600, "h") if seconds >= 7200 else (60, "min") if seconds >= 120 else (1, "s")
    return f"{seconds / size:.0f} {unit}"


def foretold(what: str) -> Callable[[float], None]:
    """A function that takes the fraction done, and after a second logs once how long the rest takes, if long."""
    begun, first, logged = 0.0, math.nan, False

    def follow(done: float) -> None:
        nonlocal begun, first, logged
        now = time.monotonic()
        if math.isnan(first):
            begun, first = now, done
        elif not logged and now - begun > 1.0 and done > first:
            left, logged = (now - begun) * (1.0 - done) / (done - first), True
            if now - begun + left > LONG:
                LOG.warning("%s: about %s more; Ctrl-C ends it", what, duration(left))

    return follow


_doing: list[str] = []


@contextlib.contextmanager
def doing(what: str) -> Iterator[None]:
    """Logs what is done if it takes long, for work that cannot say which part is done; also as a decorator.

    Within another one, its text stands instead of the other's. Threads log nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    begun, ended = time.monotonic(), threading.Event()

    def tell() -> None:
        wait = LONG
        while not ended.wait(wait):
            for now in _doing[-1:]:  # none at the very end
                LOG.warning("%s: %s so far; Ctrl-C ends it", now, duration(time.monotonic() - begun))
            wait = EACH

    _doing.append(what)
    if len(_doing) == 1:
        threading.Thread(target=tell, daemon=True).start()
    try:
        yield
    finally:
        ended.set()
        _doing.pop()


def stoppable(work: Callable[[], Made]) -> Made:
    """Result of a call that does not look at signals. It runs in a thread, so that Ctrl-C does not wait for it."""
    future: Future[Made] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future.result()
