"""Studies: independent items of work on threads, processes or a cluster, with a store of results on disk."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import math
import os
import pickle
import platform
import queue
import reprlib
import threading
import time
import traceback
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from burrlab.common.check import content_of, refuse
from burrlab.common.records import UNREADABLE, is_of_core, parsed

#: A store, or the path of its file.
StorePath: TypeAlias = "Store | str | os.PathLike[str]"

Item = TypeVar("Item")
Result = TypeVar("Result")
Thing = TypeVar("Thing")

#: Version of keys and lines; a store of another format is refused.
FORMAT = 1
#: The version of burrlab whose numbers are still those of today: results of stores since then are taken up.
SAME_NUMBERS_SINCE = "0.1.0"
#: Metadata of a dataclass's field that came later: at its default it enters no key, so stores from before are taken up.
LATER = {"later": True}
_NAME = "burrlab store, format"
_STORED_AS = "_stored_as"
_HEADER = json.dumps({_NAME: FORMAT}).encode()
_SYNC = 1.0  # shortest time between two syncs to disk [s] (ours)
_NUMBERS = "biufc"  # kinds of NumPy numbers that their bytes determine


def stored_as(name: str) -> Callable[[Thing], Thing]:
    """Decorator: name of a function or dataclass in stores; keys stay valid if it moves to another module."""

    def named(thing: Thing) -> Thing:
        setattr(thing, _STORED_AS, name)
        return thing

    return named


def _name(thing: Any) -> str:
    return str(getattr(thing, "__dict__", {}).get(_STORED_AS, f"{thing.__module__}.{thing.__qualname__}"))


def _identity(value: Any) -> Any:
    """Identity of `value` as JSON values: floats to the bit, types by name."""
    if type(value) in (type(None), bool, int, str):
        return value
    if type(value) in (float, np.float64):
        return ["float", float(value).hex()]
    if (type(value) is np.ndarray or isinstance(value, np.generic)) and value.dtype.kind in _NUMBERS:
        return ["array", value.dtype.str, list(value.shape), hashlib.sha256(value.tobytes()).hexdigest()]
    if type(value) in (tuple, list):
        return ["sequence", [_identity(part) for part in value]]
    if type(value) is dict and all(type(key) is str for key in value):
        return ["dict", [[key, _identity(value[key])] for key in sorted(value)]]
    if is_of_core(type(value)) and (identity := _identity_in_core(value)) is not None:
        return identity
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [(f, getattr(value, f.name)) for f in dataclasses.fields(value) if f.compare]
        counted = [(f.name, part) for f, part in fields if "later" not in f.metadata or part != f.default]
        return [_name(type(value)), [[name, _identity(part)] for name, part in counted]]
    raise TypeError(
        "item must be made of None, bool, int, float, str, tuples, lists, dicts with str keys, NumPy numbers "
        f"and arrays, burrs, materials, shapes, bones and dataclasses of these, got {value!r}"
    )


def _identity_in_core(value: Any) -> list[Any] | None:
    """A bone's digest, or the state that `pickle` keeps of an object; None without one."""
    if hasattr(value, "digest"):
        return ["bone", value.digest()]
    if not hasattr(value, "__setstate__"):
        return None
    state = value.__getstate__()
    return [type(value).__name__, [_identity(part) for part in (state if type(state) is tuple else (state,))]]


def key_of(function: Callable[..., Any], item: Any) -> str:
    """Key of a result: sha256 of the function's name, the item, `SAME_NUMBERS_SINCE` and the format of stores.

    Parameters
    ----------
    function : callable
        A function of a module. Only its name counts: after a change it needs another name or store.
    item : object
        Floats count to the bit, dataclasses by the fields that they compare, bones by their digest.

    Raises
    ------
    TypeError
        If the function is not one of a module, or the item holds a type that a store does not know.

    Examples
    --------
    >>> key_of(round, 0.1) == key_of(round, 0.1), key_of(round, 0.1) == key_of(round, 0.1 + 2e-17)
    (True, False)
    """
    refuse(
        "<" in getattr(function, "__qualname__", "<"),  # <lambda>, <locals>, functools.partial
        f"function must be one of a module, which a store knows by its name, got {function!r}",
        TypeError,
    )
    parts = [FORMAT, SAME_NUMBERS_SINCE, _name(function), _identity(item)]
    return hashlib.sha256(json.dumps(parts, separators=(",", ":")).encode()).hexdigest()


def _encode(value: Any) -> Any:
    if value is None or type(value) in (bool, int, str):
        return value
    if type(value) is float:
        return value if math.isfinite(value) else {"float": repr(value)}
    if type(value) is list:
        return [_encode(part) for part in value]
    if type(value) is tuple:
        return {"tuple": [_encode(part) for part in value]}
    if type(value) is dict and all(type(key) is str for key in value):
        return {"dict": {key: _encode(part) for key, part in value.items()}}
    if (type(value) is np.ndarray or isinstance(value, np.generic)) and value.dtype.kind in _NUMBERS:
        content = base64.b64encode(value.tobytes()).decode()
        kind = "array" if type(value) is np.ndarray else "number"
        return {kind: [value.dtype.str, list(value.shape), content]}
    raise TypeError(
        "a result that is stored must be made of None, bool, int, float, str, tuples, lists, dicts with str "
        f"keys, NumPy numbers and arrays of numbers, got {value!r}"
    )


def _decode(value: Any) -> Any:
    if isinstance(value, list):
        return [_decode(part) for part in value]
    if not isinstance(value, dict):
        return value
    ((kind, content),) = value.items()
    match kind:
        case "float":
            return float(content)
        case "tuple":
            return tuple(map(_decode, content))
        case "dict":
            return {key: _decode(part) for key, part in content.items()}
    dtype, shape, data = content
    refuse(
        kind not in ("array", "number") or np.dtype(dtype).kind not in _NUMBERS,
        f"a result holds no {kind!r} of {dtype!r}",
    )
    array = np.frombuffer(base64.b64decode(data), dtype).reshape(shape).copy()
    return array if kind == "array" else array[()]


class Store:
    """Results of a study in a file, one line of JSON each; lines are only appended.

    Each line is written in one call: a kill loses at most one result, and processes of one machine may write
    into the same file. A process sees the results that the file held when it opened the store, and its own.

    Parameters
    ----------
    path : path-like
        Made if it does not exist.

    Raises
    ------
    ValueError
        If the file is no store, or a store of another format.
    OSError
        If the file cannot be read and written.

    Notes
    -----
    A result may hold None, bool, int, float, str, tuples, lists, dicts with str keys, NumPy numbers and
    arrays of numbers; it is restored to the bit and type. A written result survives the process. It is forced
    to the disk at most once a second, so a power cut may lose the last second. Lines torn by a kill are left
    out; `repr` counts them.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> store = Store(folder.name + "/study.jsonl")
    >>> store.add(key_of(round, 1.5), (0.1, float("nan")))
    >>> key_of(round, 1.5) in Store(store.path), Store(store.path).get(key_of(round, 1.5))
    (True, (0.1, nan))
    >>> folder.cleanup()
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._results: dict[str, str] = {}  # as JSON: callers may change what they get
        self._torn = 0
        self._synced = -math.inf
        self.path.open("ab").close()  # tests early that it can be written
        if not self._load(content_of(self.path)):
            self._append((b"\n" if self._torn else b"") + _HEADER + b"\n")

    def _load(self, data: bytes) -> bool:
        """Reads the lines; False if the file is new, or holds nothing but a torn header."""
        lines = [line for line in data.split(b"\n") if line]
        while lines and lines[0] != _HEADER and _HEADER.startswith(lines[0]):
            self._torn += 1
            del lines[0]
        if not lines:
            return False
        try:
            file_format = json.loads(lines[0])[_NAME]
        except UNREADABLE:
            raise ValueError(
                f"store must be a file of burrlab results or a new one, got {self.path}"
            ) from None
        refuse(
            file_format != FORMAT,
            f"store must be of format {FORMAT}, got {self.path} of format {reprlib.repr(file_format)}",
        )
        # There is a second header where two processes made the file at once.
        for line in (line for line in lines[1:] if line != _HEADER):
            try:
                entry = json.loads(line)
                self._results[entry["key"]] = json.dumps(entry["result"])
            except UNREADABLE:
                self._torn += 1
        return True

    def _append(self, text: bytes) -> None:
        # Opened for each line: on a network file system, closing sends the text to the server.
        with self.path.open("ab") as stream:
            file = stream.fileno()
            try:
                written = os.write(file, text)
            except OSError as error:
                raise OSError(error.errno, error.strerror, os.fspath(self.path)) from None
            refuse(
                written < len(text),
                f"store: {self.path} took {written} of {len(text)} bytes: is the disk full?",
                OSError,
            )
            if time.monotonic() - self._synced > _SYNC:
                os.fsync(file)
                self._synced = time.monotonic()

    def add(self, key: str, result: Any) -> None:
        """Appends a result; a result that the store has under this key is kept.

        Raises
        ------
        TypeError
            If the result holds a type that a store does not know.
        OSError
            If the file cannot be written.
        """
        if key in self._results:
            return
        text = json.dumps(_encode(result), allow_nan=False)
        # The newline comes first: a line torn by another process stays separate.
        self._append(f'\n{{"key": {json.dumps(key)}, "result": {text}}}'.encode())
        self._results[key] = text

    def get(self, key: str) -> Any:
        """The result under a key.

        Raises
        ------
        KeyError
            If there is none.
        ValueError
            If the file holds no valid result under this key.
        """
        return parsed(str(self.path), self._results[key], "a store's result", _decode, finite=False)

    def __contains__(self, key: object) -> bool:
        return key in self._results

    def __len__(self) -> int:
        return len(self._results)

    def __repr__(self) -> str:
        torn = f", {self._torn} torn lines left out" if self._torn else ""
        return f"Store({str(self.path)!r}, {len(self)} results{torn})"


_LOOK = 0.2  # time between looks at a dask client while nothing arrives [s]
_AHEAD = 2048  # messages under way, or two a worker: more would only fill the memory of the scheduler
# Shortest message [s], and for each worker among many: a dask scheduler needs 2 to 2.5 ms of CPU time for one
# (docs/cluster.md).
_MESSAGE, _MESSAGE_PER_WORKER = 0.05, 0.004
_here = threading.local()


class StudyInterrupted(RuntimeError):
    """The executor died before all items were done."""


def cancel_event() -> threading.Event | None:
    """Event that is set when the study of this thread's item is over; None in another process.

    A function with long items checks the event, and raises KeyboardInterrupt when it is set.

    Examples
    --------
    >>> cancel_event() is None
    True
    """
    return getattr(_here, "event", None)


#: Results, the error that ended them, its traceback; worker and seconds.
Work = tuple[list[Any], BaseException | None, str, tuple[str, int, int], float]


def _work(function: Callable[[Any], Any], items: Sequence[Any], event: threading.Event | None) -> Work:
    """Results of a chunk up to the first error, and this error: no finished result is lost."""
    results: list[Any] = []
    failure, trace, start = None, "", time.perf_counter()
    _here.event = event
    try:
        for item in items:
            if event is not None and event.is_set():
                break
            results.append(function(item))
    except (Exception, KeyboardInterrupt) as error:
        failure, trace = error, traceback.format_exc()
    finally:
        _here.event = None
    if event is None:  # in another process: dask would wait for ever for what it cannot send
        try:
            pickle.dumps(results)
        except Exception as error:
            results, failure = [], TypeError(f"results from another process must be picklable: {error}")
    worker = platform.node(), os.getpid(), threading.get_ident()
    return results, failure, trace, worker, time.perf_counter() - start


def _is_dask(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "distributed"  # without importing it


def _has_died(error: BaseException) -> bool:
    """Whether an error is the end of the executor, not a failure to send an item."""
    return isinstance(error, BrokenExecutor | CancelledError) or _is_dask(
        type(error)
    )  # KilledWorker and others


def cores() -> int:
    """Number of cores that this process may use; a batch system often gives fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Study(Generic[Item, Result]):
    """A study that one iteration runs; see `run_items` for the parameters.

    Attributes
    ----------
    items : sequence
    results : dict
        Results by the item's index: all after the iteration, some after an interrupt.
    """

    def __init__(
        self,
        function: Callable[[Item], Result],
        items: Iterable[Item],
        *,
        executor: Executor | None = None,
        store: StorePath | None = None,
        chunk: int | None = None,
    ) -> None:
        refuse(
            executor is not None and not isinstance(executor, Executor),
            "executor must be a concurrent.futures.Executor, of a dask client its client.get_executor(), "
            f"got {executor!r}",
            TypeError,
        )
        refuse(
            chunk is not None and not (isinstance(chunk, int | np.integer) and chunk >= 1),
            f"chunk must be a whole number from 1, got {chunk!r}",
        )
        self.results: dict[int, Result] = {}
        self._function, self.items = function, items if isinstance(items, Sequence) else list(items)
        self._executor, self._chunk = executor, chunk
        self._store = store if store is None or isinstance(store, Store) else Store(store)
        self._keys = [] if self._store is None else [key_of(function, item) for item in self.items]
        self._open: dict[Future[Work], list[int]] = {}
        self._finished: queue.SimpleQueue[Future[Work]] = queue.SimpleQueue()
        self._name = f"burrlab-{uuid.uuid4().hex}"
        self._workers: set[tuple[str, int, int]] = set()  # those that have answered
        self._done, self._seconds = 0, 0.0  # items done by them, and the time that these took

    def __iter__(self) -> Iterator[int]:
        """Yields the index of each finished item, first of those in the store."""
        missing: deque[int] = deque()
        for i in range(len(self.items)):
            if self._store is not None and self._keys[i] in self._store:
                self.results[i] = self._store.get(self._keys[i])
                yield i
            else:
                missing.append(i)
        if not missing:
            return
        executor = self._executor or ThreadPoolExecutor(min(cores(), len(missing)))
        most = len(missing)
        over = threading.Event()
        try:
            while missing or self._open:
                wait = not missing or len(self._open) >= max(_AHEAD, 2 * len(self._workers))
                if not wait:
                    size = min(self._size(executor, most), len(missing))
                    self._submit(executor, [missing.popleft() for _ in range(size)], over)
                try:
                    future = self._finished.get(timeout=_LOOK if wait else 0)
                except queue.Empty:
                    # Results under way when a dask client loses its scheduler never arrive.
                    if getattr(getattr(executor, "_client", None), "status", None) == "closed":
                        raise self._interrupted(ConnectionError("the client is closed")) from None
                else:
                    yield from self._take(future)
        finally:
            self._withdraw(executor)
            over.set()
            if executor is not self._executor:
                executor.shutdown(wait=True)
            self._keep_finished()

    def _size(self, executor: Executor, most: int) -> int:
        """Items of the next message: so many that handing it out takes a small part of its time."""
        if self._chunk is not None or isinstance(executor, ThreadPoolExecutor) or not self._done:
            return self._chunk or 1
        workers = len(self._workers)
        seconds = max(_MESSAGE, _MESSAGE_PER_WORKER * workers)
        # At least four messages a worker: the last ones end at about the same time.
        return max(1, min(int(seconds * self._done / max(self._seconds, 1e-9)), most // (4 * workers)))

    def _submit(self, executor: Executor, places: list[int], over: threading.Event) -> None:
        # A key of its own: dask would find a task by its arguments and repeat a remembered failure.
        options = {"key": f"{self._name}-{places[0]}"} if _is_dask(type(executor)) else {}
        event = over if isinstance(executor, ThreadPoolExecutor) else None
        try:
            future = executor.submit(_work, self._function, [self.items[i] for i in places], event, **options)
        except Exception as error:
            if not (isinstance(error, RuntimeError) or _has_died(error)):  # broken, or shut down
                raise
            raise self._interrupted(error) from error
        self._open[future] = places
        future.add_done_callback(self._finished.put)

    def _withdraw(self, executor: Executor) -> None:
        """Cancels what has not begun."""
        if not _is_dask(type(executor)):
            for future in self._open:
                future.cancel()
        elif self._open:  # all at once: one by one, each waits for the client
            from distributed import Future as Task

            client = executor._client  # type: ignore[attr-defined]
            with suppress(Exception):  # the client may have ended
                client.cancel([Task(f"{self._name}-{places[0]}", client) for places in self._open.values()])

    def _take(self, future: Future[Work]) -> Iterator[int]:
        error = CancelledError() if future.cancelled() else future.exception()
        if error is not None:
            del self._open[future]
            if not _has_died(error):
                raise error
            raise self._interrupted(error) from error
        results, failure, trace, worker, seconds = future.result()
        self._workers.add(worker)
        self._done, self._seconds = self._done + len(results), self._seconds + seconds
        places = self._open[future][: len(results)]
        for i, result in zip(places, results, strict=True):
            self._keep(i, result)
        del self._open[future]  # after `_keep`: Ctrl-C may come in between
        yield from places
        if failure is not None:
            if failure.__traceback__ is None:  # from another process
                failure.add_note(trace)
            raise failure

    def _keep(self, i: int, result: Result) -> None:
        self.results[i] = result
        if self._store is not None:
            self._store.add(self._keys[i], result)

    def _keep_finished(self) -> None:
        """Keeps results that have arrived but are not yet taken, when the study ends early."""
        for future, places in list(self._open.items()):
            if future.done() and not future.cancelled() and future.exception() is None:
                for i, result in zip(places, future.result()[0], strict=False):
                    self._keep(i, result)

    def _interrupted(self, error: BaseException) -> StudyInterrupted:
        self._keep_finished()
        cause = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        rest = (
            "with a store, what is finished is kept, and running again goes on from there"
            if self._store is None
            else f"what was finished is in {self._store.path}, run again with the same store to go on"
        )
        return StudyInterrupted(
            f"the executor died after {len(self.results)} of {len(self.items)} items ({cause}); {rest}"
        )


def run_items(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    executor: Executor | None = None,
    store: StorePath | None = None,
    progress: Callable[[int, int], object] | None = None,
    chunk: int | None = None,
) -> list[Result]:
    """function(item) of every item, in the order of the items.

    Results do not depend on the executor, the number of workers or the order of completion, if an item,
    including its seed, determines its result.

    Parameters
    ----------
    function : callable
        A picklable function of a module.
    items : iterable
        Small and picklable items, such as frozen dataclasses.
    executor : concurrent.futures.Executor, optional
        Threads, processes, or a dask client's ``client.get_executor()``. It is not shut down. Default: one
        thread per core, which suits work in the C++ core.
    store : Store or path, optional
        Keeps every result as it arrives. Items with a result in the store are not run again.
    progress : callable, optional
        Called with the number of finished items, including those of the store, and their total.
    chunk : int, optional
        Items sent at once. Default: one with threads; else what takes 50 ms, or 4 ms for each worker if that
        is longer, by the time that the first ones took, but at most a quarter of a worker's share.

    Returns
    -------
    list

    Raises
    ------
    TypeError
        If the executor is no Executor; if a result of another process cannot be pickled; with a store, if an item or
        result holds a type that a store does not know.
    ValueError
        If chunk is below 1, or the store's file is no store.
    StudyInterrupted
        If the executor died.
    KeyboardInterrupt
        After Ctrl-C. No further item starts, and threads are told to end. Finished results are in
        the store, as after every error.

    Examples
    --------
    >>> run_items(abs, [-1, 2, -3])
    [1, 2, 3]
    """
    study = Study(function, items, executor=executor, store=store, chunk=chunk)
    for done, _ in enumerate(study, start=1):
        if progress is not None:
            progress(done, len(study.items))
    return [study.results[i] for i in range(len(study.items))]
