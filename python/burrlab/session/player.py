"""A session at any moment: bone, burrs, force and depth; of a trace, or as another simulator recorded it."""

import bisect
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone, read_bricks, restore_bricks, take_changed_bricks
from burrlab.common.check import refuse
from burrlab.common.progress import Progress, reporter
from burrlab.session.replay import executor_of, inputs
from burrlab.session.trace import Recording, Trace, check_trace

_State = tuple[int, NDArray[np.uint32], NDArray[np.uint8]]  # tick, bricks that changed, their levels


class BrickHistory:
    """States of a bone, each kept as the bricks that changed since the one before.

    If the states exceed `memory`, every second one is dropped, as often as needed. The others still reach
    back to the beginning, in wider steps. Several threads may use it, each with the lock.

    Parameters
    ----------
    initial : VoxelBone
        The bone at tick 0. It is not copied and must not change.
    memory : int
        For levels [bytes].
    """

    def __init__(self, initial: VoxelBone, memory: int) -> None:
        self._initial, self._memory = initial, memory
        self._states: list[_State] = [(0, np.empty(0, np.uint32), np.empty((0, 512), np.uint8))]
        self.thinned = 0  #: how often every second state was dropped
        self.lock = threading.Lock()  # who calls a method holds it, over all calls on one set of states

    def __len__(self) -> int:
        """Number of states, the initial one included."""
        return len(self._states)

    @property
    def bytes(self) -> int:
        """Of the kept levels."""
        return sum(levels.nbytes for _, _, levels in self._states)

    @property
    def last(self) -> int:
        """Tick of the newest state."""
        return self._states[-1][0]

    def at_or_before(self, tick: int) -> int:
        """Tick of the newest state at or before a tick."""
        return self._states[self._behind(tick) - 1][0]

    def after(self, tick: int) -> int | None:
        """Tick of the first state after a tick; None if there is none."""
        return next((state[0] for state in self._states[self._behind(tick) :]), None)

    def add(self, tick: int, bricks: NDArray[np.uint32], bone: VoxelBone) -> None:
        """Keeps the state at a tick after the newest one; `bricks` are all that changed since then."""
        if tick > self.last:
            self._states.append((tick, bricks, read_bricks(bone, bricks)))
        while self.bytes > self._memory and len(self._states) > 2:
            self._thin()

    def changed_between(self, first: int, second: int) -> NDArray[np.uint32]:
        """Sorted bricks that may differ between the bone at two ticks, up to the newest state."""
        low, high = sorted((first, second))
        last = bisect.bisect_left(self._states, high, key=lambda state: state[0]) + 1
        return _union([bricks for _, bricks, _ in self._states[self._behind(low) : last]])

    def levels(self, bricks: NDArray[np.uint32], tick: int) -> NDArray[np.uint8]:
        """Levels of bricks in the state at a tick, shape (n, 512)."""
        levels = read_bricks(self._initial, bricks)
        wanted = np.zeros(math.prod(-(-n // 8) for n in self._initial.shape), bool)
        wanted[bricks] = True
        left = len(bricks)
        states = self._states[self._behind(tick) - 1 : 0 : -1]
        for _, saved, content in states:  # newest first: the first that holds a brick is right
            rows = np.flatnonzero(wanted[saved])
            levels[np.searchsorted(bricks, saved[rows])] = content[rows]
            wanted[saved[rows]] = False
            left -= len(rows)
            if not left:
                break
        return levels

    def _behind(self, tick: int) -> int:
        """Index of the first state after a tick."""
        return bisect.bisect_right(self._states, tick, key=lambda state: state[0])

    def _thin(self) -> None:
        """Drops every second state, but never the newest: later changes refer to it."""
        states = self._states
        self._states = states[:1]
        self.thinned += 1
        for i in range(1 + len(states) % 2, len(states), 2):
            (_, older, left), (tick, bricks, levels) = states[i - 1 : i + 1]
            only = ~np.isin(older, bricks)  # empty for the first state, which holds no brick
            both = np.concatenate([older[only], bricks])
            order = np.argsort(both)
            self._states.append((tick, both[order], np.concatenate([left[only], levels])[order]))


def _union(parts: list[NDArray[np.uint32]]) -> NDArray[np.uint32]:
    """All brick numbers, sorted, each once."""
    return np.unique(np.concatenate([*parts, np.empty(0, np.uint32)]))


_BATCH = 250  # ticks between two checks for Ctrl-C


@dataclass(frozen=True, eq=False)
class Burrs:
    """The burrs at one moment.

    Attributes
    ----------
    centers : ndarray, shape (n, 3)
        Bone frame [mm]; NaN where the trace has no tick, or the recording no place.
    radii : ndarray, shape (n,)
        [mm]; NaN where a recording has none.
    on, touching : ndarray, shape (n,), bool, or None
        Whether the burr turns; whether bone lies in the sphere. None in a recording, which does not say it.
    """

    centers: NDArray[np.float64]
    radii: NDArray[np.float64]
    on: NDArray[np.bool_] | None
    touching: NDArray[np.bool_] | None


def unknown_burrs(radii: Sequence[float] | NDArray[np.float64]) -> Burrs:
    """Burrs of these radii [mm] at unknown places."""
    n = len(radii)
    return Burrs(np.full((n, 3), np.nan), np.array(radii, float), np.zeros(n, bool), np.zeros(n, bool))


@dataclass(frozen=True, eq=False)
class History:
    """Force and depth of the burrs, tick by tick, for charts.

    Attributes
    ----------
    time : ndarray, shape (ticks,)
        At the end of each tick [s].
    force, depth : ndarray, shape (ticks, burrs)
        Magnitude of the model's force [N], penetration h [mm].
    """

    time: NDArray[np.float64]
    force: NDArray[np.float64]
    depth: NDArray[np.float64]


class TracePlayer:
    """Random access to a trace: its bone at any moment, to the bit.

    Ticks are executed as in `replay`. On the way the bone's state is kept at intervals, as the bricks that
    changed. A seek then costs the execution of `every`, and a copy of the bricks that differ.

    Parameters
    ----------
    trace : Trace
    every : float
        Between kept states [s].
    memory : float
        For kept states [MB]. If it does not suffice, they lie further apart.

    Attributes
    ----------
    bone : VoxelBone
        The bone at `time`: always the same object, which `seek` changes.
    duration : float
        Of the trace [s].
    ticks : int
        In the trace.
    history : History
        A row a tick.
    events : tuple
        Of the whole trace, as it recorded them; empty where it has none.

    Raises
    ------
    TypeError
        If `trace` is not a trace.
    ValueError
        If `every` or `memory` is not positive.
    """

    def __init__(self, trace: Trace, *, every: float = 0.25, memory: float = 256.0) -> None:
        check_trace(trace)
        for name, value in (("every", every), ("memory", memory)):
            refuse(not 0 < value < float("inf"), f"{name} must be positive, got {value!r}")
        self.trace = trace
        burr = trace.ticks["burr"]
        self.history = History(trace.time(), np.linalg.norm(burr["force_N"], axis=2), burr["penetration_mm"])
        self._every = max(1, round(every * 1000.0 / trace.period))
        self._kept = BrickHistory(trace._bone, int(memory * 1e6))  # no copy: this bone never changes
        self._walk = _TickCursor(trace, self._kept, self._every)
        self.bone, self.duration, self.ticks, self.events = (
            self._walk.bone,
            trace.duration,
            len(trace),
            tuple(trace.events),
        )

    @property
    def done(self) -> int:
        """Ticks of the trace executed at this moment."""
        return self._walk.done

    @property
    def tick(self) -> int:
        """Index of the next tick, as in `Trace.digests`."""
        return self.trace.first_tick + self.done

    @property
    def time(self) -> float:
        """Time since the trace's start [s]."""
        return float(self.history.time[self.done - 1]) if self.done else 0.0

    @property
    def burrs(self) -> Burrs:
        """The burrs after the last executed tick; before the first tick, at that tick's centres."""
        radii = np.array([burr.radius for burr, _ in self.trace.tools])
        if not self.ticks:
            return unknown_burrs(radii)
        row = self.trace.ticks["burr"][max(self.done - 1, 0)]
        ran = self.done > 0
        return Burrs(row["center_mm"].copy(), radii, ran & (row["on"] > 0), ran & (row["touching"] > 0))

    @property
    def force(self) -> NDArray[np.float64]:
        """The model's force in the last executed tick [N], shape (burrs, 3)."""
        return self._last("force_N")

    @property
    def depth(self) -> NDArray[np.float64]:
        """Penetration h in the last executed tick [mm], shape (burrs,)."""
        return self._last("penetration_mm")

    @property
    def prepared(self) -> float:
        """Part of the trace whose states are kept, 0 to 1. Seeks there are fast."""
        with self._kept.lock:
            step = self._every << self._kept.thinned
            return min(1.0, (self._kept.last + step) / max(self.ticks, 1))

    @property
    def kept(self) -> tuple[int, int]:
        """(states, bytes) kept."""
        return len(self._kept), self._kept.bytes

    def seek(self, seconds: float, *, progress: Progress | None = None) -> NDArray[np.uint32]:
        """Goes to a time: executes all ticks that end by then.

        Parameters
        ----------
        seconds : float
            0 to `duration` [s].
        progress : callable or True, optional
            Called with the fraction done, 0 to 1; True shows a bar.

        Returns
        -------
        ndarray, shape (n,), uint32
            Sorted numbers of the bricks that changed since the last call.

        Raises
        ------
        ValueError
            If the time is not in the trace.
        """
        refuse(
            not 0 <= seconds <= self.duration + 1e-9,
            f"seconds must be from 0 to {self.duration:g}, got {seconds!r}",
        )
        end = seconds + min(0.5e-3 * self.trace.period, 1e-6)  # sums of periods are not exact
        done = int(np.searchsorted(self.history.time, end, side="right"))
        return self._walk.go(done, reporter(progress, "replay"))

    def seek_tick(self, tick: int) -> NDArray[np.uint32]:
        """Goes to the moment before a tick; returns what `seek` returns. The index counts as `tick`,
        `Trace.digests` and `Companion.first_tick` do. ValueError if the trace does not reach it."""
        first = self.trace.first_tick
        refuse(
            not first <= tick <= first + self.ticks,
            f"tick must be from {first} to {first + self.ticks}, got {tick!r}",
        )
        return self._walk.go(tick - first)

    def prepare(self, progress: Progress | None = None, *, cancel: threading.Event | None = None) -> bool:
        """Executes the whole trace once on a bone of its own, so that every later seek is fast.

        It may run in a thread beside seeks. Until it returns, it needs memory for one more bone.

        Parameters
        ----------
        progress : callable or True, optional
            Called with the fraction done, 0 to 1; True shows a bar.
        cancel : threading.Event, optional
            Ends it early once set.

        Returns
        -------
        bool
            Whether it came to the end.
        """
        report = reporter(progress, "replay")
        scout = _TickCursor(self.trace, self._kept, self._every)
        while scout.done < self.ticks:
            if cancel is not None and cancel.is_set():
                return False
            scout.go(min(max(self._kept.last, scout.done) + self._every, self.ticks))
            report(scout.done / self.ticks)
        return True

    def _last(self, name: str) -> NDArray[np.float64]:
        column = self.trace.ticks["burr"][name]
        return np.array(column[self.done - 1] if self.done else np.zeros(column.shape[1:]))

    def __repr__(self) -> str:
        states, size = self.kept
        return f"TracePlayer({self.time:.3f} of {self.duration:.3f} s; {states} states, {size / 1e6:.1f} MB)"


class _TickCursor:
    """One bone that moves to any tick of a trace, and keeps the states that are not kept yet."""

    def __init__(self, trace: Trace, history: BrickHistory, every: int) -> None:
        self._trace, self._kept, self._every = trace, history, every
        self.bone = trace.bone()
        self.done = 0
        self._executor = executor_of(trace, self.bone)
        self._since: list[NDArray[np.uint32]] = []  # changed since a state at or before the newest one
        take_changed_bricks(self.bone)

    def go(
        self, done: int, report_progress: Callable[[float], object] = lambda done: None
    ) -> NDArray[np.uint32]:
        """Moves to the state after `done` ticks; returns the bricks that changed."""
        changed: list[NDArray[np.uint32]] = []
        with self._kept.lock:  # another walk may drop states
            key = self._kept.at_or_before(done)
            if done < self.done or key > self.done:
                bricks = _union([self._kept.changed_between(key, self.done), *self._since])
                restore_bricks(self.bone, bricks, self._kept.levels(bricks, key))
                self.done, self._since = key, []
                self._executor = executor_of(self._trace, self.bone, key)
                changed.append(take_changed_bricks(self.bone))
        first = self.done
        while self.done < done:
            changed.append(self._execute(done))
            report_progress(1 - (done - self.done) / (done - first))
        return _union(changed)

    def _execute(self, done: int) -> NDArray[np.uint32]:
        """Executes ticks up to `done` or the next kept state; returns the bricks that changed."""
        with self._kept.lock:
            step = self._every << self._kept.thinned
            key = self._kept.after(self.done)  # another walk may have kept it by now
            if key is None:
                key = max(self._kept.last, self.done + 1 - step) + step
        end = min(done, key, self.done + _BATCH)
        self._executor.execute(inputs(self._trace.ticks[self.done : end]))
        self.done = end
        changed = take_changed_bricks(self.bone)
        self._since.append(changed)
        if end == key:
            with self._kept.lock:
                self._kept.add(end, _union(self._since), self.bone)
            self._since = []
        return changed


def _held(
    times: NDArray[np.float64] | None, rows: NDArray[np.float64] | None, width: int
) -> Callable[[Any], NDArray[np.float64]]:
    """Rows valid from their times until the next, as a function of time; NaN before, and without any."""
    if times is None or rows is None:
        times, rows = np.zeros(0), np.zeros((0, width))
    table = np.vstack([np.full((1, width), np.nan), rows.reshape(-1, width)])
    return lambda at: table[np.searchsorted(times, at, side="right")]


class RecordingPlayer:
    """Random access to a recording of volumetric_drilling, on the bone that was drilled there.

    The bone at a time is that of `DrillingRecording.drilled`, to the bit. What is not recorded is NaN.

    Parameters
    ----------
    recording : DrillingRecording
    bone : VoxelBone
        Made of the recording's volume; it is copied.
    source : str or mapping
        As in `DrillingRecording.removed_from`.

    Attributes
    ----------
    bone : VoxelBone
        The bone at `time`: always the same object, which `seek` changes.
    time, duration : float
        Since the recording's start, and until its last pose, force or removal [s].
    depth : ndarray, shape (1,)
        NaN: penetration is not recorded.
    history : History
        A row a pose.
    note : str
        What is not recorded.

    Raises
    ------
    TypeError
        If `recording` is not a recording.
    ValueError
        If the bone has voxels of another size, or does not hold all that were removed.
    """

    prepared = 1.0  # every seek is fast

    def __init__(self, recording: Recording, bone: VoxelBone, source: str | Mapping[str, Any] = "") -> None:
        refuse(
            not isinstance(recording, Recording),
            f"recording must be a DrillingRecording, got {recording!r}",
            TypeError,
        )
        self.recording, self.bone, self.time, self._gone = recording, bone.copy(), 0.0, 0
        motion = recording.motion(bone, source)
        time, voxels = motion.time, motion.removed
        _, rows, columns = (-(-n // 8) for n in bone.shape)
        flat = 512 * (voxels // 8 @ (rows * columns, columns, 1)) + voxels % 8 @ (64, 8, 1)  # brick by brick
        once = np.sort(np.unique(flat, return_index=True)[1])  # each voxel when it first went
        self._voxels, self._when = voxels[once], motion.removed_time[once]
        self._brick, self._within = (flat[once] // 512).astype(np.uint32), flat[once] % 512
        bricks, row = np.unique(self._brick, return_inverse=True)
        self._level = read_bricks(bone, bricks)[row, self._within]
        self._center = _held(np.where(np.arange(len(time)), time, -np.inf), motion.center, 3)
        self._force = _held(motion.force_time, motion.force, 3)
        self._radius = _held(motion.radius_time, motion.radius, 1)
        ends = [times[-1:] for times in (time, self._when, motion.force_time) if times is not None]
        self.duration, self.depth = float(np.concatenate(ends).max(initial=0.0)), np.full(1, np.nan)
        force = np.linalg.norm(self._force(time), axis=1, keepdims=True)
        self.history = History(time, force, np.full((len(time), 1), np.nan))
        empty = int(np.count_nonzero(self._level == 0))
        notes = list(motion.notes)
        if 2 * empty > len(self._level):
            notes.insert(1, f"{empty} of {len(self._level)} removed voxels are empty in this bone")
        self.note = "; ".join(notes)
        self.seek(0.0)

    @property
    def burrs(self) -> Burrs:
        """The burr at the last pose; before the first, there."""
        return Burrs(self._center([self.time]), self._radius(self.time), None, None)

    @property
    def force(self) -> NDArray[np.float64]:
        """The last force, in the recording's axes [N], shape (1, 3)."""
        return self._force([self.time])

    def removals(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """When each voxel went [s], its middle [mm], and the way there from the burr's centre [mm]."""
        places = self.bone.origin + self._voxels[:, ::-1] * np.array(self.bone.spacing)
        return self._when, places, places - self._center(self._when)

    def seek(self, seconds: float, *, progress: Progress | None = None) -> NDArray[np.uint32]:
        """Goes to a time [s]; parameters, result and error are those of `TracePlayer.seek`."""
        refuse(
            not 0 <= seconds <= self.duration + 1e-9,
            f"seconds must be from 0 to {self.duration:g}, got {seconds!r}",
        )
        gone = int(np.searchsorted(self._when, seconds, side="right"))
        rows = slice(*sorted((self._gone, gone)))
        bricks, row = np.unique(self._brick[rows], return_inverse=True)
        levels = read_bricks(self.bone, bricks)
        levels[row, self._within[rows]] = 0 if gone > self._gone else self._level[rows]
        restore_bricks(self.bone, bricks, levels)
        self._gone, self.time = gone, float(seconds)
        reporter(progress, "seek")(1.0)
        return bricks

    def __repr__(self) -> str:
        return f"RecordingPlayer({self.time:.3f} of {self.duration:.3f} s; {self._gone} voxels removed)"


Player: TypeAlias = TracePlayer | RecordingPlayer
