"""Recording: a thread writes the loop's records into a trace, as bytes at known places."""

import contextlib
import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Material, RecordReader, VoxelBone, most_watch_events
from burrlab.anatomy.events import EVENT_DTYPE, Watched
from burrlab.common.check import refuse
from burrlab.common.files import kept_elsewhere, new_part
from burrlab.session.trace import (
    DIGEST_DTYPE,
    ENDED_LENGTH,
    create,
    json_text,
    make_compact,
    row_dtype,
    to_rows,
)

DEFAULT_DURATION = 4 * 3600.0  # [s] of ticks there is room for
_INTERVAL = 0.02  # [s] between two looks at the ring
_MOST = 20_000  # records taken at once
_write = os.pwrite  # a name of its own, for tests with a full disk
_BROKEN = _OVERWRITTEN, _CUT = "was overwritten", "was cut short"  # by another program


@dataclass
class _Queue:
    """Rows of a table that wait until their ticks are in the file."""

    waiting: NDArray[np.void]
    room: int  # rows of the table
    recorded: int = 0


class TraceWriter:
    """Records a session into a trace.

    Parameters
    ----------
    path : path-like
        A file that does not exist yet.
    reader : RecordReader
        Made before the loop was started.
    bone : VoxelBone
        The bone before the first tick; it is written at once and not used later.
    tools : sequence of (Burr, Material)
        One a burr, in index order.
    about : mapping
        What the session says of itself, ready for JSON; the trace keeps all of it. As in `Session.provenance`, it
        has seed, rate_Hz, scheme, first_tick, devices, source, and watch for the settings of a watch.
    duration : float
        Room for ticks, at one tick a period [s]. Recording stops when it is used up.
    digest_every : float
        Interval of the digests that there is room for [s].
    on_end : callable, optional
        Called with the reason, from the writer's thread, as soon as recording ends by itself (the ring was
        overrun, the disk is full or fails, no room is left) or the file was deleted, replaced or overwritten.

    Attributes
    ----------
    recorded : int
        Ticks in the file.
    ended : str
        Why recording ended; empty while it goes on.
    complete : bool
        Whether recording ended with the session, and the file holds every tick and is in its place.
    warning : str
        Why the finished file could not be compacted, or what became of it; empty where all is well.
    rescued : str
        Path of the content of a file that was deleted or replaced during recording; else empty.

    Raises
    ------
    ValueError
        If `about` is not JSON.
    FileExistsError
        If the file exists.
    OSError
        If it cannot be written.

    Notes
    -----
    Before the first tick the file is complete except for its rows. Every 20 ms new rows are written at their
    place, and then their count. Whenever the process is killed, all counted rows are whole. `docs/trace.md`
    says what holds and what does not.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        reader: RecordReader,
        bone: VoxelBone,
        tools: Sequence[tuple[Burr, Material]],
        about: Mapping[str, Any],
        *,
        duration: float = DEFAULT_DURATION,
        digest_every: float = 1.0,
        on_end: Callable[[str], object] | None = None,
    ) -> None:
        self.path = Path(path)
        rows = max(1, math.ceil(duration * 1000.0 / (1e3 / about["rate_Hz"])))
        digests = math.ceil(duration / min(digest_every, 1.0)) + 16
        json_text("note", about)  # here, for its own error
        refuse(self.path.exists(), f"path must be a new file, {self.path} exists", FileExistsError)
        with _named_at_end(self.path) as part:
            self._places = create(part, bone, tools, about, capacity=rows, digest_capacity=digests)
        self._reader: RecordReader | None = reader
        self._burrs, self._first, self._on_end = len(tools), about["first_tick"], on_end
        self._row_bytes, self._room, self.recorded = row_dtype(self._burrs).itemsize, rows, 0
        self.ended = self.warning = self.rescued = ""
        self.complete = False
        self._queues = {
            "digests": _Queue(np.zeros(0, DIGEST_DTYPE), digests),
            "events": _Queue(np.zeros(0, EVENT_DTYPE), most_watch_events if "events" in self._places else 0),
        }
        self._watched: Watched | None = None
        self._lock, self._wake = threading.Lock(), threading.Event()
        self._stopping: str | None = None
        self._thread = threading.Thread(target=self._run, name="burrlab trace", daemon=True)
        self._file = os.open(self.path, os.O_RDWR)
        self._head = os.pread(self._file, min(1024, self._places["recorded"]), 0)  # never written again
        self._size = os.fstat(self._file).st_size

    def add_digest(self, tick: int, digest: str) -> None:
        """Keeps the bone's digest after `tick` executed ticks. Any thread may call it."""
        self._queue("digests", np.array([(tick, digest.encode())], DIGEST_DTYPE))

    def add_events(self, events: NDArray[np.void]) -> None:
        """Keeps events of the trace's watch, in order. Any thread may call it."""
        self._queue("events", events)

    def set_watched(self, watched: Watched) -> None:
        """Takes the results of the trace's watch, for `stop` to write."""
        self._watched = watched

    def _queue(self, name: str, rows: NDArray[np.void]) -> None:
        with self._lock:
            self._queues[name].waiting = np.concatenate([self._queues[name].waiting, rows])

    def start(self) -> None:
        """Starts recording. ValueError if it was started or stopped before."""
        refuse(
            self._stopping is not None or self._thread.ident is not None,
            "recording must be started once: it has been started or stopped",
        )
        self._thread.start()

    def stop(self, reason: str = "stopped") -> None:
        """Records the rest of the ring, closes the file and compacts it. Further calls do nothing."""
        if self._stopping is None:
            self._stopping = reason
            self._wake.set()
            (self._run if self._thread.ident is None else self._thread.join)()
            self._finish_file()

    def _run(self) -> None:
        damage = ""
        try:
            while not self.ended:
                if not damage and (damage := self._damage()) and self._on_end is not None:
                    self._on_end(f"{self.path} {damage} while the session is recorded")
                if damage in _BROKEN:  # left alone
                    self.ended = damage
                    break
                last = self._stopping is not None  # read before the ring is emptied
                self._empty_ring(last)
                reached = self._first + self.recorded
                self._write_queue("digests", reached + 1)  # counts ticks done
                self._write_queue("events", reached)
                if last:
                    self._write_sums()
                if last and not self.ended:
                    self._end(self._stopping or "stopped", complete=True)
                elif not self.ended:
                    self._wake.wait(_INTERVAL)
        except Exception as error:  # a thread must not die in silence: the session is told
            self._end(f"recording failed: {error}")
        finally:
            self._reader = None  # a loop on a virtual clock would wait for the reader
        if not self.complete and self._on_end is not None and damage not in _BROKEN:
            self._on_end(self.ended)

    def _empty_ring(self, last: bool) -> None:
        while not self.ended and self._reader is not None:
            records, overrun = self._reader.take(_MOST)
            if len(records):
                self._write_ticks(records)
            if overrun:
                self._end("the ring was overrun: the disk or the processor was too slow")
            if len(records) < (1 if last else _MOST):  # a fast loop always has a few more
                return

    def _write_ticks(self, records: NDArray[np.void]) -> None:
        expected = self._first + self.recorded + np.arange(len(records), dtype=np.uint64)
        whole = int(np.argmin(np.append(records["index"] == expected, False)))
        room = min(whole, self._room - self.recorded)
        rows = to_rows(records[:room], self._burrs).tobytes()
        done, why = self._put(rows, self._places["ticks"] + self.recorded * self._row_bytes)
        if written := done // self._row_bytes:
            failed = self._put_count("recorded", self.recorded + written)
            self.recorded += 0 if failed else written
            why = why or failed
        if why:
            self._end(why)
        elif whole < len(records):
            self._end(f"the record of the next tick is missing, tick {records['index'][whole]} came")
        elif room < whole:
            self._end("the file has no room for more ticks: its duration is over")

    def _put(self, data: bytes, at: int) -> tuple[int, str]:
        """(bytes written, why no more)"""
        done = 0
        try:
            while done < len(data):
                done += _write(self._file, memoryview(data)[done:], at + done)
        except OSError as error:
            return done, f"the file could not be written: {error.strerror or error}"
        return done, ""

    def _put_count(self, name: str, count: int) -> str:
        return self._put(np.uint64(count).tobytes(), self._places[name])[1]

    def _write_queue(self, name: str, until: int) -> None:
        """Writes the rows of ticks before `until`, and then their count; the others wait."""
        queue = self._queues[name]
        with self._lock:
            ready = queue.waiting["tick"] < until
            rows, queue.waiting = queue.waiting[ready], queue.waiting[~ready]
        rows = rows[: queue.room - queue.recorded]
        if self.ended or not len(rows):
            return
        queue.recorded += len(rows)
        _, why = self._put(rows.tobytes(), self._places[name] + (queue.recorded - len(rows)) * rows.itemsize)
        if why := why or self._put_count(f"{name}_recorded", queue.recorded):
            self._end(why)

    def _write_sums(self) -> None:
        """Writes the results of the watch, and then the flag that they are there."""
        if self.ended or (sums := self._watched) is None:
            return
        for name, numbers in {
            "doses": sums.doses, "removed_levels": sums.removed, "counts": sums.counts, "summed": np.uint8(1),
        }.items():  # fmt: skip
            if why := self._put(numbers.tobytes(), self._places[name])[1]:
                return self._end(why)

    def _end(self, reason: str, *, complete: bool = False) -> None:
        self.complete = complete
        text = reason if complete else f"recording ended before tick {self._first + self.recorded}: {reason}"
        # The file has these pages already. If the file system wants room even so, `ended` still tells it.
        with contextlib.suppress(OSError):
            _write(self._file, text.encode()[:ENDED_LENGTH].ljust(ENDED_LENGTH, b"\0"), self._places["ended"])
            _write(self._file, np.uint8(complete).tobytes(), self._places["complete"])
        self.ended = text

    def _damage(self) -> str:
        """Text on what others did to the file; empty if it is in place and whole, with its beginning unchanged."""
        try:
            if not os.path.samestat(os.fstat(self._file), os.stat(self.path)):
                return "was replaced"
        except OSError:
            return "was deleted or moved"
        if os.pread(self._file, len(self._head), 0) != self._head:
            return _OVERWRITTEN
        return _CUT if os.fstat(self._file).st_size < self._size else ""

    def _finish_file(self) -> None:
        """Compacts the file; if another is in its place, the still open content is saved elsewhere."""
        try:
            if damage := self._damage():
                self.complete = False
                if damage not in _BROKEN:
                    self.rescued = kept_elsewhere(os.fspath(self.path), "trace.h5", self._rescue) or ""
                self.ended = self.warning = (
                    f"{self.path} {damage} during the session: what was recorded is "
                    f"{f'kept as {self.rescued}' if self.rescued else 'lost'}"
                )
            else:
                with new_part(self.path) as part:
                    make_compact(self.path, part)
                    part.replace(self.path)
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            why = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else error
            self.warning = f"{self.path} stays as it was recorded, it could not be compacted: {why}"
            if not isinstance(error, OSError) or not error.errno:  # not the disk: what was recorded
                self.complete = False
                self.ended = self.warning = f"{self.path} cannot be read, another program changed it: {why}"
        finally:
            os.close(self._file)

    def _rescue(self, place: str) -> None:
        with _named_at_end(Path(place)) as part, os.fdopen(os.dup(self._file), "rb") as raw:
            make_compact(raw, part)


@contextlib.contextmanager
def _named_at_end(path: Path) -> Iterator[Path]:
    """A file to fill: it gets its name at the end, unless that name is taken. A kill before leaves none of the name.

    OSError that names the path if it cannot be made.
    """
    with new_part(path) as part:
        try:
            yield part
        except (
            RuntimeError,
            ValueError,
            KeyError,
        ) as error:  # by HDF5: a limit is too small, the file is damaged
            raise OSError(f"{path} could not be made: {error}") from None
        except OSError as error:
            if error.filename != os.fspath(part):
                raise
            raise type(error)(error.errno, error.strerror, os.fspath(path)) from None
        try:
            os.link(part, path)
        except FileExistsError:
            raise FileExistsError(f"path must be a new file, {path} exists") from None
        except OSError:  # a file system without hard links
            part.rename(path)
