"""Replay of a recorded session, compared with its record."""

from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from burrlab._core import TickExecutor, VoxelBone, cpu_path, record_dtype
from burrlab.common.check import refuse
from burrlab.common.progress import Progress, reporter
from burrlab.common.records import Codec
from burrlab.common.table import by_value
from burrlab.session.trace import Trace, check_trace, to_records, to_rows

#: Columns that the model and its tools give. They are compared to the bit.
COMPARED = ("force_N", "penetration_mm", "removed_levels", "touching", "ambiguous", "radius_mm", "material")
BATCH = 2000  # ticks between two checks for Ctrl-C


@by_value
@dataclass(frozen=True)
class Difference:
    """The first value that differs in a replay. For a digest `burr` is None and `tick` counts ticks done."""

    tick: int
    burr: int | None
    field: str
    recorded: Any
    replayed: Any

    def __str__(self) -> str:
        of_burr = f"tick {self.tick}, burr {self.burr}: {self.field}"
        what = f"after {self.tick} ticks the digest" if self.burr is None else of_burr
        return f"{what} is {self.replayed}, recorded {self.recorded}"


@dataclass(frozen=True, repr=False)
class Replay:
    """Outcome of a replay. Made by `replay`.

    Attributes
    ----------
    ticks : int
        Ticks executed and compared.
    digests : int
        Digests compared.
    difference : Difference or None
        The first one; replay ends with its batch.
    bone : VoxelBone
        The bone at the end.
    tick : int
        Tick index of that bone.
    cpu_path : str
        CPU path of this replay.
    """

    ticks: int
    digests: int
    difference: Difference | None
    tick: int
    cpu_path: str
    bone: VoxelBone = field(compare=False)

    @property
    def equal(self) -> bool:
        """Whether all compared values have the recorded bits, and all digests are as recorded."""
        return self.difference is None

    def to_dict(self) -> dict[str, Any]:
        """A dict for JSON. Values that are not finite are spelt "nan" or "inf"."""
        return cast("dict[str, Any]", _CODEC.plain(self))

    def __repr__(self) -> str:
        equal = f"equal, {self.ticks} ticks, {self.digests} digests"
        return f"Replay({equal if self.equal else f'different: {self.difference}'})"


_CODEC = Codec(
    "spelt",
    keys={
        Replay: {
            "equal": lambda outcome: outcome.equal,
            **{name: name for name in ("ticks", "digests", "tick")},
            "digest": lambda outcome: outcome.bone.digest(),
            **{name: name for name in ("cpu_path", "difference")},
        }
    },
)


def replay(trace: Trace, *, progress: Progress | None = None, until: int | None = None) -> Replay:
    """Executes all ticks of a trace on its initial volume and compares the results.

    Device, hand, coupling and network are not run again: the burr's centres are the recorded ones.

    Parameters
    ----------
    trace : Trace
    progress : callable or True, optional
        Called with the fraction done, 0 to 1; True shows a bar.
    until : int, optional
        Tick index before which to stop; default: all.

    Returns
    -------
    Replay

    Raises
    ------
    ValueError
        If `until` is not a tick of the trace, or the trace holds a value that no session executes, such as a
        centre that is not finite.
    TypeError
        If `trace` is not a trace.

    Examples
    --------
    >>> import burrlab, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> file = folder.name + "/session.h5"
    >>> bone = burrlab.VoxelBone.block((20, 20, 5), 0.2, origin=(-9.9, -9.9, -4.9))
    >>> tool, clock = (burrlab.Burr(3.0), burrlab.materials["bone"]), burrlab.Clock(wall_clock=False)
    >>> hand = burrlab.HandDevice((0, 0, 3.0))
    >>> with burrlab.Session(bone, tool, hand, seed=1, duration=0.5, clock=clock, record=file) as session:
    ...     ended = session.wait()
    >>> print(replay(burrlab.load_trace(file)))
    Replay(equal, 500 ticks, 2 digests)
    >>> folder.cleanup()
    """
    report = reporter(progress, "replay")
    check_trace(trace)
    end = len(trace) if until is None else until - trace.first_tick
    refuse(
        not 0 <= end <= len(trace),
        f"until must be from {trace.first_tick} to {trace.first_tick + len(trace)}, got {until}",
    )
    executor, path, first = executor_of(trace), cpu_path(), trace.first_tick
    digests = {tick - first: digest for tick, digest in trace.digests if first <= tick <= first + end}
    done = compared = 0
    difference = None
    for mark in sorted({*digests, *range(0, end, BATCH), end}):
        if mark > done:
            rows = trace.ticks[done:mark]
            difference = _first_difference(rows, to_rows(executor.execute(inputs(rows)), trace.burrs))
            done = mark
        if difference is None and mark in digests:
            compared += 1
            if (digest := executor.bone.digest()) != digests[mark]:
                difference = Difference(executor.tick, None, "digest", digests[mark], digest)
        report(done / max(end, 1))
        if difference is not None:
            break
    return Replay(done, compared, difference, executor.tick, path, executor.bone)


def executor_of(trace: Trace, bone: VoxelBone | None = None, done: int = 0) -> TickExecutor:
    """An executor of a trace's ticks: on a new bone, or on a given one after `done` ticks."""
    return TickExecutor(
        trace.bone() if bone is None else bone, list(trace.tools), trace.seed, period=trace.period,
        scheme=trace.scheme, tick=trace.first_tick + done,
    )  # fmt: skip


def inputs(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Records without the model's results, so that no recorded value can pass for a replayed one."""
    blank = np.zeros_like(rows)
    blank[["index", "k"]] = rows[["index", "k"]]
    blank["burr"][["center_mm", "on"]] = rows["burr"][["center_mm", "on"]]
    return to_records(blank, record_dtype)


def _first_difference(rows: NDArray[np.void], again: NDArray[np.void]) -> Difference | None:
    unequal_places = []
    for order, name in enumerate(COMPARED):
        recorded, executed = (
            np.ascontiguousarray(values).view(np.uint64) if values.dtype.kind == "f" else values
            for values in (rows["burr"][name], again["burr"][name])
        )
        unequal = (recorded != executed).reshape(len(rows), rows["burr"].shape[1], -1).any(axis=2)
        unequal_places += [(*place, order, name) for place in np.argwhere(unequal)[:1].tolist()]
    if not unequal_places:
        return None
    row, burr, _, name = min(unequal_places)
    return Difference(
        int(rows["index"][row]), burr, name, rows["burr"][name][row, burr], again["burr"][name][row, burr]
    )
