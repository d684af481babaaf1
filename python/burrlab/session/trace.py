"""The trace of a session, made and read: an HDF5 file whose structure is complete before the first tick."""

import json
import os
import re
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Material, Tissues, VoxelBone, most_watch_events, record_dtype
from burrlab.anatomy.events import EVENT_DTYPE, GROUP, Watched, create_watch, read_only, read_watch
from burrlab.bone.header import told_notes
from burrlab.bone.materials import constants_of, material_of
from burrlab.bone.snapshot import (
    open_hdf5,
    read_bone,
    read_dataset,
    read_flat,
    told_as_damage,
    write_bone,
)
from burrlab.common.check import amend_error, check_memory, refuse
from burrlab.common.files import attributes, new_hdf5, put_attributes
from burrlab.common.progress import doing
from burrlab.common.provenance import provenance
from burrlab.common.records import in_one_line
from burrlab.common.table import dataframe, html_pairs

if TYPE_CHECKING:
    import h5py
    import pandas


FORMAT, FORMAT_VERSION = "burrlab trace", 4  # 2: tissues; 3: orientation and buttons; 4: columns of scalars
ENDED_LENGTH = 400  # bytes of the sentence that says why recording ended

#: Name and type of a column of the file, and field of a record.
_TICK = [("index", "<u8", "index"), ("k", "<u4", "k"), ("time_s", "<f8", "time"), ("cpu_time_us", "<f8", "cpu_time")]  # fmt: skip
_BURR = [
    ("center_mm", "<f8", (3,), "center"), ("radius_mm", "<f8", (), "radius"), ("material", "<u4", (), "material"),
    ("on", "u1", (), "on"), ("touching", "u1", (), "touching"), ("ambiguous", "u1", (), "ambiguous"),
    ("force_N", "<f8", (3,), "force"), ("penetration_mm", "<f8", (), "penetration"),
    ("removed_levels", "<i8", (), "removed"), ("sent_force_N", "<f8", (3,), "sent"),
    ("device_position_mm", "<f8", (3,), "device_position"),
    ("device_velocity_mm_s", "<f8", (3,), "device_velocity"), ("age_ms", "<f8", (), "age"),
    ("orientation", "<f8", (4,), "orientation"), ("buttons", "u1", (), "buttons"),
]  # fmt: skip
BURR_COLUMNS = tuple(name for name, *_ in _BURR)
TICK_COLUMNS = tuple(name for name, *_ in _TICK)
_BURR_FIELDS, _TICK_FIELDS = [field for *_, field in _BURR], [field for *_, field in _TICK]
BURR_DTYPE = np.dtype([(name, kind, shape) for name, kind, shape, _ in _BURR])
_BEFORE_3 = np.dtype([column[:3] for column in _BURR[:-2]])
DIGEST_DTYPE = np.dtype([("tick", "<u8"), ("digest", "S32")])


def row_dtype(burrs: int, burr: np.dtype[Any] = BURR_DTYPE) -> np.dtype[Any]:
    """Type of a row of `Trace.ticks`, and of files before format 4: a tick, and a compound for each of its burrs."""
    return np.dtype([(name, kind) for name, kind, _ in _TICK] + [("burr", burr, (burrs,))])


def file_dtype(burrs: int) -> np.dtype[Any]:
    """Type of a row of the file: the bytes of `row_dtype` as scalars. Columns of burr 1 begin with burr1_."""
    columns = [
        (f"{prefix}{column}", kind)
        for prefix in ("", "burr1_")[:burrs]
        for name, kind, shape, _ in _BURR
        for column in _components(name, shape)
    ]
    return np.dtype([(name, kind) for name, kind, _ in _TICK] + columns)


def _components(name: str, shape: tuple[int, ...]) -> list[str]:
    """Names of a column's scalars: _x, _y, _z before the unit, _w before these in the orientation."""
    stem, unit = re.fullmatch("(.*?)(_mm|_mm_s|_N|)", name).groups()  # type: ignore[union-attr]
    return [f"{stem}_{part}{unit}" for count in shape for part in "wxyz"[-count:]] or [name]


def to_rows(records: NDArray[np.void], burrs: int) -> NDArray[np.void]:
    """Tick records as rows of a trace, bit for bit."""
    rows = np.zeros(len(records), row_dtype(burrs))
    rows[list(TICK_COLUMNS)] = records[_TICK_FIELDS]
    rows["burr"][list(BURR_COLUMNS)] = records["burr"][_BURR_FIELDS][:, :burrs]
    return rows


def to_records(rows: NDArray[np.void], dtype: np.dtype[Any]) -> NDArray[np.void]:
    """Rows of a trace as tick records, bit for bit."""
    burrs = rows.dtype["burr"].shape[0]
    records = np.zeros(len(rows), dtype)
    records["burrs"] = burrs
    records["burr"]["orientation"][..., 0] = 1.0
    records[_TICK_FIELDS] = rows[list(TICK_COLUMNS)]
    fields = _BURR_FIELDS[: len(rows["burr"].dtype.names or ())]  # none of the last two before format 3
    records["burr"][fields][:, :burrs] = rows["burr"]
    return records


def json_text(name: str, value: Mapping[str, Any] | None, **options: Any) -> str:
    """A mapping as JSON; ValueError if JSON cannot hold it."""
    with amend_error(f"{name} must be what JSON holds: ", kinds=(TypeError, ValueError)):
        return json.dumps(dict(value or {}), allow_nan=False, **options)


def create(
    path: Path,
    bone: VoxelBone,
    tools: Sequence[tuple[Burr, Material]],
    about: Mapping[str, Any],
    *,
    capacity: int,
    digest_capacity: int,
) -> dict[str, int]:
    """Fills an empty file, without ticks; returns byte offsets of its datasets, those of a watch among them.

    `tools` and `about` are those of a `TraceWriter`.

    The tables are allocated at once and never filled. On file systems with sparse files they take room only
    as they are written. Each dataset begins at a multiple of 64 bytes, so that no count crosses a memory
    page.
    """
    note, watch, period = json_text("note", about), about.get("watch"), 1e3 / about["rate_Hz"]
    row = file_dtype(len(tools))
    size = capacity * row.itemsize + digest_capacity * DIGEST_DTYPE.itemsize
    os.truncate(path, min(size, 2**63 - 1))  # fails if too long for a file; libhdf5 would crash
    with new_hdf5(path, alignment_threshold=1, alignment_interval=64) as file:
        now = time.time()
        put_attributes(file, {
            "format": FORMAT, "format_version": FORMAT_VERSION, **provenance(),
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(now)), "started_unix_s": now,
            "seed": np.uint64(about["seed"]), "scheme": about["scheme"], "period_ms": period, "loop_rate_Hz": 1000.0 / period,
            "first_tick": np.uint64(about["first_tick"]), "burrs": len(tools), "initial_digest": bone.digest(),
        })  # fmt: skip
        write_bone(file.create_group("volume"), bone, about["first_tick"], source=json.dumps(about["source"]))
        for i, (burr, material) in enumerate(tools):
            put_attributes(file.create_group(f"tools/{i}"), {
                "radius_mm": burr.radius, "material": material.name, **constants_of(material), "source": material.source,
                "device": about["devices"][i],
            })  # fmt: skip
        file.create_dataset("note", data=np.bytes_(note.encode()))
        parts = {  # before the tables, so that a limit of the file's length cannot stop `ended`
            "recorded": file.create_dataset("recorded", data=np.uint64(0)),
            "digests_recorded": file.create_dataset("digests_recorded", data=np.uint64(0)),
            "ended": file.create_dataset("ended", data=np.bytes_(b""), dtype=f"S{ENDED_LENGTH}"),
            "complete": file.create_dataset("complete", data=np.uint8(0)),
        }
        if watch:
            parts |= create_watch(file, json_text("watch", watch), len(tools), len(bone.tissues or ()))
            parts["events"] = _table(file, f"{GROUP}/events", EVENT_DTYPE, most_watch_events)
        parts |= {
            "digests": _table(file, "digests", DIGEST_DTYPE, digest_capacity),
            "ticks": _table(file, "ticks", row, capacity),
        }
        file.flush()
        return {name: dataset.id.get_offset() for name, dataset in parts.items()}


def _table(file: "h5py.File", name: str, dtype: np.dtype[Any], length: int) -> "h5py.Dataset":
    import h5py

    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.CONTIGUOUS)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    return h5py.Dataset(h5py.h5d.create(
        file.id, name.encode(), h5py.h5t.py_create(dtype, logical=True), h5py.h5s.create_simple((length,)), properties
    ))  # fmt: skip


def make_compact(recorded: Path | BinaryIO, part: Path) -> None:
    """Writes the recorded rows, compressed, and the rest of the file to `part`."""
    import h5py

    with h5py.File(recorded, "r") as raw, new_hdf5(part) as file:
        put_attributes(file, attributes(raw))
        for name in ("volume", "tools", "note", "recorded", "digests_recorded", "ended", "complete"):
            raw.copy(name, file)
        for name, count in (("ticks", "recorded"), ("digests", "digests_recorded")):
            _copy_table(raw[name], file, int(raw[count][()]), int(raw.attrs["first_tick"]))
        if GROUP in raw:
            watch, compact = raw[GROUP], file.create_group(GROUP)
            for name in [part for part in watch if part != "events"]:
                watch.copy(name, compact)
            _copy_table(watch["events"], compact, int(watch["events_recorded"][()]))


def _copy_table(
    source: "h5py.Dataset", file: "h5py.Group", rows: int, first: int = 0, chunk: int = 4096
) -> None:  # fmt: skip
    name = source.name.rsplit("/")[-1]
    table = file.create_dataset(
        name, (rows,), source.dtype, chunks=(min(chunk, max(rows, 1)),) if rows else None,
        compression="gzip" if rows else None, compression_opts=1 if rows else None, shuffle=rows > 0,
    )  # fmt: skip
    step = 16 * chunk
    for start in range(0, rows, step):
        part = source[start : min(start + step, rows)]
        if name == "ticks":
            _check_rows(part, first + start)
        table[start : start + step] = part


class Handling(NamedTuple):
    """What `session_metrics` reads of one burr in a session, a row a tick or sample."""

    time: NDArray[np.float64]  # [s]
    step: NDArray[np.float64]  # time that each row stands for [s]
    period: float  # [ms]
    duration: float  # [s]
    center: NDArray[np.float64]  # [mm]
    force: NDArray[np.float64]  # [N]
    touching: NDArray[np.bool_]
    cutting: NDArray[np.bool_]
    removed: NDArray[np.float64]  # so far [mm^3]
    structures: dict[str, float] | None = None  # removed of each [mm^3]
    absent: tuple[str, ...] = ()  # metrics that follow from nothing recorded


class Motion(NamedTuple):
    """What a `RecordingPlayer` shows, in the frame of a bone. What was not recorded is None, or empty."""

    time: NDArray[np.float64]  # of the poses [s]
    center: NDArray[np.float64] | None  # [mm], a row a pose
    force_time: NDArray[np.float64] | None  # [s]
    force: NDArray[np.float64] | None  # valid until the next [N]
    radius_time: NDArray[np.float64] | None  # [s]
    radius: NDArray[np.float64] | None  # from then on [mm]
    removed_time: NDArray[np.float64]  # [s]
    removed: NDArray[np.int64]  # indices (z, y, x) of the voxels
    notes: tuple[str, ...]  # what is not recorded, then by what lengths are divided


@runtime_checkable
class Recording(Protocol):
    """A session that another simulator recorded."""

    @property
    def path(self) -> Path: ...

    def handling(self, burr: int) -> Handling: ...

    def motion(self, bone: VoxelBone, source: str | Mapping[str, Any] = "") -> Motion: ...


_LONGEST = 1000  # characters of a name
_LONGEST_PERIOD = 1e6  # [ms]


@dataclass(frozen=True, repr=False, eq=False)
class Trace:
    """A recorded session: all inputs to run it again bit for bit, and its results. Made by `load_trace`.

    Attributes
    ----------
    path : Path
    ticks : ndarray, shape (n,)
        A row a tick, with one compound `burr` a burr; read-only. `Trace.array` names their columns; those of
        the file, in `docs/trace_format.md`, hold the same bytes as scalars.
    tools : tuple of (Burr, Material)
        One a burr, in index order.
    devices : tuple of str
        Device names, one a burr.
    seed : int
    period : float
        Loop period [ms].
    scheme : {"layer", "cell"}
    first_tick : int
        Ticks executed earlier on the bone.
    digests : tuple of (int, str)
        (ticks executed, digest of the bone then).
    ended : str
        Why recording ended; empty if the session was killed, or goes on.
    complete : bool
        Whether recording ended with the session.
    source : str
        Where the volume comes from.
    note : dict
        Further data of the session, such as safety parameters.
    provenance : dict
        Versions, machine, CPU path and start of the recording.
    watch : dict
        Settings of the watch; empty without one.
    events : ndarray, shape (n,)
        Events of the watch, a row each; read-only. `docs/trace_format.md` lists the columns.
    watched : Watched or None
        All results of the watch; None without a watch, or if the session was killed.
    """

    path: Path
    ticks: NDArray[np.void]
    tools: tuple[tuple[Burr, Material], ...]
    devices: tuple[str, ...]
    seed: int
    period: float
    scheme: str
    first_tick: int
    digests: tuple[tuple[int, str], ...]
    ended: str
    complete: bool
    source: str
    note: dict[str, Any]
    provenance: dict[str, Any]
    watch: dict[str, Any]
    events: NDArray[np.void]
    watched: Watched | None
    _bone: VoxelBone = field(repr=False)

    def __len__(self) -> int:
        """Number of ticks."""
        return len(self.ticks)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences in `source` on assumptions about the bone."""
        return told_notes(self.source)

    @property
    def burrs(self) -> int:
        """Number of burrs."""
        return len(self.tools)

    @cached_property  # a sum over all ticks, asked for in loops
    def duration(self) -> float:
        """Time that the ticks stand for, the sum of their k periods [s]."""
        return float(self.ticks["k"].sum()) * self.period / 1000.0

    @cached_property
    def initial_digest(self) -> str:
        """Digest of the bone before the first tick, present and pristine levels."""
        return self._bone.digest()

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel of the bone [mm^3]."""
        return float(np.prod(self._bone.spacing))

    @property
    def tissues(self) -> Tissues | None:
        """Tissues of the bone; None for a single material."""
        return self._bone.tissues

    def bone(self) -> VoxelBone:
        """A new bone as it was before the first tick."""
        return self._bone.copy()

    def time(self) -> NDArray[np.float64]:
        """Session time at the end of each tick, the sum of the periods so far [s], shape (n,)."""
        return np.cumsum(self.ticks["k"], dtype=np.float64) * (self.period / 1000.0)

    def array(self, name: str, burr: int = 0) -> NDArray[Any]:
        """A column, read-only.

        Parameters
        ----------
        name : str
            Column of a tick or of a burr.
        burr : int
            Index of the burr.

        Returns
        -------
        ndarray, shape (n,), (n, 3) or, of the orientation, (n, 4)

        Raises
        ------
        ValueError
            If there is no such column or burr.
        """
        refuse(not 0 <= burr < self.burrs, f"burr must be an index below {self.burrs}, got {burr}")
        if name in TICK_COLUMNS:
            return self.ticks[name]
        if name in (self.ticks["burr"].dtype.names or ()):
            return self.ticks["burr"][name][:, burr]
        known = TICK_COLUMNS + BURR_COLUMNS
        refuse(name not in known, f"name must be one of {', '.join(known)}, got '{name}'")
        missing = np.zeros(len(self), BURR_DTYPE[name])  # recorded before there were orientation and buttons
        missing[..., :1] = name == "orientation"
        return read_only(missing)

    def handling(self, burr: int) -> Handling:
        """What `session_metrics` reads of a burr."""
        levels = self.array("removed_levels", burr)
        return Handling(
            self.time(), self.ticks["k"] * (self.period / 1000.0), self.period, self.duration,
            self.array("center_mm", burr), np.linalg.norm(self.array("sent_force_N", burr), axis=1),
            self.array("touching", burr) == 1, levels > 0, np.cumsum(levels) * (self.voxel_volume / 255.0),
        )  # fmt: skip

    def columns(self, burr: int = 0) -> dict[str, NDArray[Any]]:
        """One burr's ticks by scalar columns, each of shape (n,).

        Vectors have _x, _y, _z before the unit, the orientation has _w, _x, _y, _z.

        Raises
        ------
        ValueError
            If there is no such burr.
        """
        columns = {name: self.array(name, burr) for name in TICK_COLUMNS}
        for name in BURR_COLUMNS:
            scalars = np.atleast_2d(self.array(name, burr).T)
            columns |= zip(_components(name, BURR_DTYPE[name].shape), scalars, strict=True)
        return columns

    def to_dataframe(self, burr: int = 0) -> "pandas.DataFrame":
        """One burr's `columns` as a pandas DataFrame, indexed by tick.

        Raises
        ------
        ValueError
            If there is no such burr.
        ImportError
            If pandas is not installed.
        """
        return dataframe(self.columns(burr)).set_index("index")

    def __repr__(self) -> str:
        tools = ", ".join(f"R = {burr.radius:g} mm in {material.name}" for burr, material in self.tools)
        return (
            f"Trace({len(self)} ticks from {self.first_tick}, {self.duration:.3f} s; {tools}; seed {self.seed}; "
            f"{self.ended or 'not ended: killed, or still recorded'})"
        )

    def _repr_html_(self) -> str:
        return html_pairs({
            "file": self.path.name, "ticks": len(self), "first tick": self.first_tick,
            "duration [s]": f"{self.duration:.3f}", "period [ms]": f"{self.period:g}", "seed": self.seed,
            "tools": ", ".join(f"R = {b.radius:g} mm in {m.name}" for b, m in self.tools),
            "devices": ", ".join(self.devices), "digests": len(self.digests),
            "initial digest": self.initial_digest, "ended": self.ended, "complete": self.complete,
            **self.provenance,
        })  # fmt: skip


def check_trace(trace: Trace) -> None:
    """TypeError unless `trace` is a `Trace`; a file's name is an easy mistake."""
    if not isinstance(trace, Trace):
        raise TypeError(f"trace must be a Trace, as load_trace gives it, got {trace!r}")


@doing("reading a trace")
def load_trace(path: str | os.PathLike[str]) -> Trace:
    """The trace in an HDF5 or a flat file: of a session that ended, was killed, or still runs.

    All rows are read into memory, about 230 bytes a tick and burr.

    Raises
    ------
    ValueError
        If the file is not a trace, has a newer format, or is damaged.
    OSError
        If it cannot be read.

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
    >>> trace = load_trace(file)
    >>> trace.duration, len(trace.ticks)
    (0.5, 500)
    >>> folder.cleanup()
    """
    if (flat := read_flat(path)) is not None:
        return _read_flat(Path(path), *flat)
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file:
        return _read(file, Path(path))


def _read_flat(path: Path, bone: VoxelBone, first: int, source: str, words: list[str], begin: int) -> Trace:
    """The trace in a flat file: its bone is read, and its ticks begin there."""
    refuse(not words, f"{path} is not a {FORMAT}: it holds a bone alone")
    with path.open("rb") as file, told_as_damage(path):
        check_memory(2.0 * path.stat().st_size, "its ticks")
        file.seek(begin)
        rows = memoryview(file.read())
        seed, period, scheme, started, cpu_path, version, burrs = words[:7]
        tools = tuple(
            (Burr(float(radius)), Material(name, c_e=float(c_e), alpha=float(alpha), shape=shape, source=origin,
                                           force_exponent=float(force), rate_exponent=float(rate)))
            for radius, name, origin, shape, c_e, alpha, force, rate in zip(*[iter(words[7:])] * 8, strict=True)
        )  # fmt: skip
        refuse(str(len(tools)) != burrs, f"it has {burrs} burrs and {len(tools)} tools")
        row = np.dtype([*record_dtype.descr[:-1], ("burr", record_dtype["burr"].base, (len(tools),))])
        digest, ended, end = "-", "", rows[-200:].tobytes()
        if end.startswith(b"\nend "):
            rows = rows[:-200]
            checksum = zlib.adler32(end[16:], zlib.adler32(rows))
            refuse(end[5:16] != b"%10d " % checksum, "its ticks were changed")
            digest, _, ended = in_one_line(end[16:].decode(errors="replace")).partition(" ")
        else:  # the program was killed
            rows = rows[: len(rows) // row.itemsize * row.itemsize]
        ticks = read_only(to_rows(np.frombuffer(rows, row), len(tools)))
        _check_rows(ticks, first)
        _check_setup(bone, tools, (), int(seed), scheme, float(period))
        made_by = dict.fromkeys(("python", "numpy", "machine"), "") | {
            "burrlab": f"{version}, C++", "cpu_path": cpu_path, "started_unix_s": float(started),
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(float(started))),
        }  # fmt: skip
        return Trace(
            path, ticks, tools, ("",) * len(tools), int(seed), float(period), scheme, first,
            ((first + len(ticks), digest),) * (digest != "-"), ended, digest != "-", source, {}, made_by, {},
            read_only(np.zeros(0, EVENT_DTYPE)), None, bone,
        )  # fmt: skip


def tool_of(row: Mapping[str, Any], name: str, source: str) -> tuple[Burr, Material]:
    """The tool that a trace or a hello describes; name and source are of the material."""
    return Burr(float(row["radius_mm"])), material_of(row, name, source)


def _read(file: "h5py.File", path: Path) -> Trace:
    about, volume = attributes(file), attributes(file["volume"])
    rows = [attributes(file[f"tools/{i}"]) for i in range(int(about["burrs"]))]
    tools = tuple(tool_of(row, row["material"], row["source"]) for row in rows)
    devices = tuple(row["device"] for row in rows)
    first, seed, scheme = int(about["first_tick"]), int(about["seed"]), about["scheme"]
    # Digests and events are read first, as they are written after their ticks.
    watch, watched, events = read_watch(file, len(tools))
    digests = read_dataset(file, "digests", int(read_dataset(file, "digests_recorded")))
    ended = in_one_line(
        bytes(read_dataset(file, "ended")).rstrip(b"\0").decode(errors="replace"), ENDED_LENGTH
    )
    complete = bool(read_dataset(file, "complete"))
    ticks = _ticks(file, path, first, len(tools))
    refuse(
        len({*digests["tick"].tolist()}) < len({*digests.tolist()}),
        f"{path} is damaged: it has two digests of one tick",
    )
    refuse(
        complete and any(digests["tick"] > first + len(ticks)),
        f"{path} is damaged: it has digests of later ticks than its {len(ticks)}",
    )
    bone, tick = read_bone(file["volume"])
    refuse(
        tick != first or bone.digest() != about["initial_digest"],
        f"{path} is damaged: its volume is not the one that the session began with",
    )
    _check_setup(bone, tools, devices, seed, scheme, float(about["period_ms"]))
    watched_names = {row["name"] for row in watch.get("structures", ())}
    refuse(
        watched_names - {tissue.name for tissue in bone.tissues or ()}, "its bone lacks a watched structure"
    )
    refuse(not 0 <= float(about["started_unix_s"]) < np.inf, "its start is no time")
    made_by = {
        name: getattr(about[name], "tolist", lambda attribute=about[name]: attribute)()
        for name in ("burrlab", "python", "numpy", "machine", "cpu_path", "started", "started_unix_s")
    }
    return Trace(
        path, ticks, tools, devices, seed, float(about["period_ms"]), scheme,
        first, tuple((int(d["tick"]), d["digest"].decode("ascii")) for d in digests), ended, complete,
        str(volume["source"]), json.loads(read_dataset(file, "note")),
        made_by, watch, events, watched, bone,
    )  # fmt: skip


def _check_setup(
    bone: VoxelBone, tools: Sequence[tuple[Burr, Material]], devices: Sequence[Any], seed: int, scheme: str,
    period: float,
) -> None:  # fmt: skip
    """ValueError unless a session could have had this setup on this bone."""
    names = (*devices, *(material.name for _, material in tools))
    texts = all(isinstance(name, str) and len(name) <= _LONGEST for name in names)
    refuse(
        not (texts and 0 <= seed < 2**64 and scheme in {"layer", "cell"}),
        f"its devices and materials must be texts of at most {_LONGEST} characters, its seed a number of 64 "
        "bits and its scheme layer or cell",
    )
    refuse(
        not 0 < period <= _LONGEST_PERIOD,
        f"its period must be above 0 and at most {_LONGEST_PERIOD:g} ms, got {period:g}",
    )
    refuse(
        bone.tissues is not None and any(material != bone.tissues.material for _, material in tools),
        "a tool's material is not that of its bone's tissues",
    )


def _ticks(file: "h5py.File", path: Path, first: int, burrs: int) -> NDArray[np.void]:
    table, recorded = file["ticks"], int(read_dataset(file, "recorded"))
    row = row_dtype(burrs)
    refuse(
        table.dtype not in (file_dtype(burrs), row, row_dtype(burrs, _BEFORE_3)),
        f"{path} is damaged: its ticks have other columns than format {FORMAT_VERSION} has",
    )
    ticks: NDArray[np.void] = read_dataset(file, "ticks", recorded)
    _check_rows(ticks, first)
    rows = ticks.view(row) if table.dtype == file_dtype(burrs) else ticks
    burr = rows["burr"]
    right = (
        np.isfinite(burr["center_mm"]).all(axis=-1)
        & np.isfinite(burr["sent_force_N"]).all(axis=-1)
        & (np.maximum(burr["touching"], burr["on"]) <= 1)
        & (burr["removed_levels"] >= 0)
    )
    wrong = first + np.flatnonzero(~right.all(axis=1))
    refuse(len(wrong), f"the row of tick {wrong[:1].sum()} holds what no burr can do")
    return read_only(rows)


def _check_rows(ticks: NDArray[np.void], first: int) -> None:
    right = ticks["index"] == first + np.arange(len(ticks), dtype=np.uint64)
    right &= (ticks["k"] >= 1) & (ticks["k"] <= 8)
    refuse(
        not right.all(),
        f"the row of tick {first + int(np.argmin(np.append(right, False)))} holds something else",
    )
