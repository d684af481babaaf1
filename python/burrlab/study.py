"""Many independent items of work: on threads, processes or a cluster, and resumed from a store."""

from __future__ import annotations

import os
import queue
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from typing import Any, Generic, TypeVar

from burrlab.store import Store, StorePath, key_of

Item = TypeVar("Item")
Result = TypeVar("Result")

_LOOK = 0.2  # time between looks at `cancel` while nothing arrives [s]
_here = threading.local()


class StudyInterrupted(RuntimeError):
    """The executor died before all items were done."""


def cancel_event() -> threading.Event | None:
    """Set once the study is over whose item this thread works on; None in another process.

    A function whose items take long looks at it, and raises KeyboardInterrupt once it is set.

    Examples
    --------
    >>> cancel_event() is None
    True
    """
    return getattr(_here, "event", None)


Work = tuple[list[Any], BaseException | None, str]  # results, the error that ended them, its traceback


def _work(function: Callable[[Any], Any], items: Sequence[Any], event: threading.Event | None) -> Work:
    """Results of a chunk up to the first error, which comes with them: none that is finished is lost."""
    results: list[Any] = []
    _here.event = event
    try:
        for item in items:
            if event is not None and event.is_set():
                break
            results.append(function(item))
    except (Exception, KeyboardInterrupt) as error:
        return results, error, traceback.format_exc()
    finally:
        _here.event = None
    return results, None, ""


def _is_dask(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "distributed"  # without importing it


def _has_died(error: BaseException) -> bool:
    """Whether an error is the executor's end rather than something that could not be sent."""
    return isinstance(error, BrokenExecutor | CancelledError) or _is_dask(
        type(error)
    )  # KilledWorker and others


def cores() -> int:
    """Cores that this process may use: a batch system often gives fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Study(Generic[Item, Result]):
    """The items of a study while it runs: iterate to run it, once; see `run_items` for the parameters.

    Attributes
    ----------
    results : dict
        What is done, by the item's place; complete after iteration, partial after an interrupt.
    """

    def __init__(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        executor: Executor | None = None,
        store: StorePath | None = None,
        chunk: int | None = None,
        cancel: threading.Event | None = None,
    ) -> None:
        if executor is not None and not isinstance(executor, Executor):
            raise TypeError(
                "executor must be a concurrent.futures.Executor, of a dask client its client.get_executor(), "
                f"got {executor!r}"
            )
        if chunk is not None and not (isinstance(chunk, int) and chunk >= 1):
            raise ValueError(f"chunk must be a whole number from 1, got {chunk!r}")
        self.results: dict[int, Result] = {}
        self._function, self._items = function, items
        self._executor, self._chunk, self._cancel = executor, chunk or 1, cancel
        self._store = store if store is None or isinstance(store, Store) else Store(store)
        self._keys = [] if self._store is None else [key_of(function, item) for item in items]
        self._open: dict[Future[Work], list[int]] = {}
        self._finished: queue.SimpleQueue[Future[Work]] = queue.SimpleQueue()

    def __iter__(self) -> Iterator[int]:
        """Yields the place of each item as it is done: first those that the store knows."""
        missing = []
        for i in range(len(self._items)):
            if self._store is not None and self._keys[i] in self._store:
                self.results[i] = self._store.get(self._keys[i])
                yield i
            else:
                missing.append(i)
        if not missing:
            return
        own = ThreadPoolExecutor(min(cores(), len(missing))) if self._executor is None else None
        over = threading.Event()
        ended = False
        try:
            self._submit(self._executor or own, missing, over)
            while self._open:
                yield from self._take(self._next())
            ended = True
        finally:
            for future in self._open:
                future.cancel()
            over.set()
            if own is not None:
                own.shutdown(wait=True)
            if not ended:
                self._keep_finished()

    def _submit(self, executor: Executor | None, missing: list[int], over: threading.Event) -> None:
        assert executor is not None
        # Dask would know a task by its arguments, and answer with a failure that it remembers.
        options: dict[str, Any] = {"pure": False} if _is_dask(type(executor)) else {}
        event = over if isinstance(executor, ThreadPoolExecutor) else None
        for first in range(0, len(missing), self._chunk):
            places = missing[first : first + self._chunk]
            try:
                future = executor.submit(
                    _work, self._function, [self._items[i] for i in places], event, **options
                )
            except Exception as error:
                if not (isinstance(error, RuntimeError) or _has_died(error)):  # broken, or shut down
                    raise
                raise self._interrupted(error) from error
            self._open[future] = places
            future.add_done_callback(self._finished.put)

    def _next(self) -> Future[Work]:
        while True:
            if self._cancel is not None and self._cancel.is_set():
                raise KeyboardInterrupt
            try:
                return self._finished.get(timeout=_LOOK)
            except queue.Empty:
                # What was on its way when a dask client lost its scheduler never arrives.
                client = getattr(self._executor, "_client", None)
                if getattr(client, "status", None) == "closed":
                    raise self._interrupted(ConnectionError("the client is closed")) from None

    def _take(self, future: Future[Work]) -> Iterator[int]:
        error = CancelledError() if future.cancelled() else future.exception()
        if error is not None:
            del self._open[future]
            if not _has_died(error):
                raise error
            raise self._interrupted(error) from error
        results, failure, trace = future.result()
        places = self._open[future][: len(results)]
        for i, result in zip(places, results, strict=True):
            self._keep(i, result)
        del self._open[future]  # not before: Ctrl-C may come in between
        yield from places
        if failure is not None:
            if failure.__traceback__ is None:  # it came from another process
                failure.add_note(trace)
            raise failure

    def _keep(self, i: int, result: Result) -> None:
        self.results[i] = result
        if self._store is not None:
            self._store.add(self._keys[i], result)

    def _keep_finished(self) -> None:
        """What has arrived and was not taken yet, when the study ends early."""
        for future, places in list(self._open.items()):
            if future.done() and not future.cancelled() and future.exception() is None:
                for i, result in zip(places, future.result()[0], strict=False):
                    self._keep(i, result)

    def _interrupted(self, error: BaseException) -> StudyInterrupted:
        self._keep_finished()
        cause = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        if self._store is None:
            rest = "with a store, what is finished is kept, and running again goes on from there"
        else:
            rest = f"what was finished is in {self._store.path}, run again with the same store to go on"
        return StudyInterrupted(
            f"the executor died after {len(self.results)} of {len(self._items)} items ({cause}); {rest}"
        )


def run_items(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    executor: Executor | None = None,
    store: StorePath | None = None,
    progress: Callable[[int, int], object] | None = None,
    chunk: int | None = None,
    cancel: threading.Event | None = None,
) -> list[Result]:
    """function(item) of every item, in the order of the items.

    Results do not depend on the executor, the number of workers or the order of completion, as long as an item
    alone, with the seed in it, determines its result.

    Parameters
    ----------
    function : callable
        Of a module; picklable.
    items : sequence
        Small and picklable, such as frozen dataclasses.
    executor : concurrent.futures.Executor, optional
        Threads, processes, or a dask client's ``client.get_executor()``. Default: threads over the cores, which
        serve where the work is the core's. It is not shut down.
    store : Store or path, optional
        Keeps every result as it arrives. What it knows is not run again.
    progress : callable, optional
        Called with the number of items done, those of the store too, and their total.
    chunk : int, optional
        Items sent at once, for items so cheap that sending them counts; default 1.
    cancel : threading.Event, optional
        Ends the study as Ctrl-C does.

    Returns
    -------
    list

    Raises
    ------
    TypeError
        If the executor is none; with a store, if an item or result holds what a store does not.
    ValueError
        If chunk is below 1, or the store's file is no store.
    StudyInterrupted
        If the executor died.
    KeyboardInterrupt
        After Ctrl-C or `cancel`. Nothing more is begun, threads are told to end, and what is finished is kept
        in the store; as in every other case.

    Examples
    --------
    >>> run_items(abs, [-1, 2, -3])
    [1, 2, 3]
    """
    study = Study(function, items, executor=executor, store=store, chunk=chunk, cancel=cancel)
    for done, _ in enumerate(study, start=1):
        if progress is not None:
            progress(done, len(items))
    return [study.results[i] for i in range(len(items))]
