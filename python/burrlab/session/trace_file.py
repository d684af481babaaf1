"""The layout of a trace: HDF5 whose structure is finished before the first tick, so that recording is only bytes."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Material, VoxelBone, most_watch_events
from burrlab.files import check_folder
from burrlab.provenance import provenance
from burrlab.session.new_hdf5 import attributes, new_hdf5, put_attributes
from burrlab.session.snapshot import write_bone
from burrlab.session.watch_rows import EVENT_DTYPE, GROUP, WatchPlaces, create_watch

if TYPE_CHECKING:
    import h5py

FORMAT, FORMAT_VERSION = "burrlab trace", 2  # 2: with tissues; a trace without them is written as 1
ENDED_LENGTH = 400  # bytes of the sentence that says why recording ended

#: Column of the file and field of a record, (name, type, field).
_TICK = [("index", "<u8", "index"), ("k", "<u4", "k"), ("time_s", "<f8", "time"), ("cpu_time_us", "<f8", "cpu_time")]  # fmt: skip
_BURR = [
    ("center_mm", "<f8", (3,), "center"), ("radius_mm", "<f8", (), "radius"), ("material", "<u4", (), "material"),
    ("on", "u1", (), "on"), ("touching", "u1", (), "touching"), ("ambiguous", "u1", (), "ambiguous"),
    ("force_N", "<f8", (3,), "force"), ("penetration_mm", "<f8", (), "penetration"),
    ("removed_levels", "<i8", (), "removed"), ("sent_force_N", "<f8", (3,), "sent"),
    ("device_position_mm", "<f8", (3,), "device_position"),
    ("device_velocity_mm_s", "<f8", (3,), "device_velocity"), ("age_ms", "<f8", (), "age"),
]  # fmt: skip
BURR_COLUMNS = tuple(name for name, *_ in _BURR)
TICK_COLUMNS = tuple(name for name, *_ in _TICK)
BURR_DTYPE = np.dtype([(name, kind, shape) for name, kind, shape, _ in _BURR])
DIGEST_DTYPE = np.dtype([("tick", "<u8"), ("digest", "S32")])


def row_dtype(burrs: int) -> np.dtype[Any]:
    """Type of a row of `ticks`: a tick, and a compound for each of its burrs."""
    return np.dtype([(name, kind) for name, kind, _ in _TICK] + [("burr", BURR_DTYPE, (burrs,))])


def to_rows(records: NDArray[np.void], burrs: int) -> NDArray[np.void]:
    """Tick records as rows of the file, bit for bit."""
    rows = np.zeros(len(records), row_dtype(burrs))
    for name, _, field in _TICK:
        rows[name] = records[field]
    for name, _, _, field in _BURR:
        rows["burr"][name] = records["burr"][field][:, :burrs]
    return rows


def to_records(rows: NDArray[np.void], dtype: np.dtype[Any]) -> NDArray[np.void]:
    """Rows of the file as tick records, bit for bit."""
    burrs = rows.dtype["burr"].shape[0]
    records = np.zeros(len(rows), dtype)
    records["burrs"] = burrs
    for name, _, field in _TICK:
        records[field] = rows[name]
    for name, _, _, field in _BURR:
        records["burr"][field][:, :burrs] = rows["burr"][name]
    return records


@dataclass(frozen=True)
class Header:
    """What a trace says before its first tick."""

    tools: Sequence[tuple[Burr, Material]]
    seed: int
    period: float  # [ms]
    scheme: str = "layer"
    first_tick: int = 0
    devices: Sequence[str] = ()
    source: str = ""
    note: str = "{}"  # JSON
    watch: str = ""  # JSON; empty: none


@dataclass(frozen=True)
class Places:
    """Where in the file the bytes of a recording go [bytes], and how many rows there is room for."""

    ticks: int
    recorded: int
    digests: int
    digests_recorded: int
    ended: int
    complete: int
    capacity: int
    digest_capacity: int
    watch: WatchPlaces | None = None


def create(path: Path, header: Header, bone: VoxelBone, *, capacity: int, digest_capacity: int) -> Places:
    """Makes the file with all of its structure; no tick yet.

    The tables are allocated at once and never filled: on file systems with sparse files they take room only as they
    are written. Everything begins at a multiple of 64 bytes, so that no count lies across a page of memory.
    """
    size = capacity * row_dtype(len(header.tools)).itemsize + digest_capacity * DIGEST_DTYPE.itemsize
    check_folder(path)
    path.touch()
    os.truncate(path, min(size, 2**63 - 1))  # too long for a file: libhdf5 does not survive it
    with new_hdf5(path, alignment_threshold=1, alignment_interval=64) as file:
        _write_header(file, header, bone)
        names = {  # what says how recording ended lies before the tables, where the file is never too long for it
            "recorded": file.create_dataset("recorded", data=np.uint64(0)),
            "digests_recorded": file.create_dataset("digests_recorded", data=np.uint64(0)),
            "ended": file.create_dataset("ended", data=np.bytes_(b""), dtype=f"S{ENDED_LENGTH}"),
            "complete": file.create_dataset("complete", data=np.uint8(0)),
        }
        watch = {}
        if header.watch:
            tissues = 0 if bone.tissues is None else len(bone.tissues)
            watch = create_watch(file, header.watch, len(header.tools), tissues)
            watch["events"] = _table(file, f"{GROUP}/events", EVENT_DTYPE, most_watch_events)
        names |= {
            "digests": _table(file, "digests", DIGEST_DTYPE, digest_capacity),
            "ticks": _table(file, "ticks", row_dtype(len(header.tools)), capacity),
        }
        file.flush()
        offsets = {name: dataset.id.get_offset() for name, dataset in names.items()}
        places = {name: dataset.id.get_offset() for name, dataset in watch.items()}
    return Places(
        capacity=capacity,
        digest_capacity=digest_capacity,
        watch=WatchPlaces(**places) if places else None,
        **offsets,
    )


def _table(file: h5py.File, name: str, dtype: np.dtype[Any], length: int) -> h5py.Dataset:
    import h5py

    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.CONTIGUOUS)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    kind = h5py.h5t.py_create(dtype, logical=True)
    space = h5py.h5s.create_simple((length,))
    return h5py.Dataset(h5py.h5d.create(file.id, name.encode(), kind, space, properties))


def _write_header(file: h5py.File, header: Header, bone: VoxelBone) -> None:
    now = time.time()
    put_attributes(file, {
        "format": FORMAT, "format_version": 1 if bone.tissues is None else FORMAT_VERSION, **provenance(),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(now)), "started_unix_s": now,
        "seed": np.uint64(header.seed), "scheme": header.scheme, "period_ms": header.period,
        "loop_rate_Hz": 1000.0 / header.period, "first_tick": np.uint64(header.first_tick),
        "burrs": len(header.tools), "initial_digest": bone.digest(),
    })  # fmt: skip
    write_bone(file.create_group("volume"), bone, header.first_tick, source=header.source)
    for i, (burr, material) in enumerate(header.tools):
        put_attributes(file.create_group(f"tools/{i}"), {
            "radius_mm": burr.radius, "material": material.name, "c_e_N_per_mm2": material.c_e,
            "alpha_per_ms": material.alpha, "shape": material.shape.name, "source": material.source,
            "device": header.devices[i] if i < len(header.devices) else "",
        })  # fmt: skip
    file.create_dataset("note", data=np.bytes_(header.note.encode()))


def make_compact(path: Path, part: Path) -> None:
    """Writes the rows there are to `part`, compressed, with all else of the file, and lets it take the file's place."""
    import h5py

    with h5py.File(path, "r") as raw, new_hdf5(part) as file:
        put_attributes(file, attributes(raw))
        for name in ("volume", "tools", "note", "recorded", "digests_recorded", "ended", "complete"):
            raw.copy(name, file)
        for name, count in (("ticks", "recorded"), ("digests", "digests_recorded")):
            _copy_table(raw[name], file, int(raw[count][()]))
        if GROUP in raw:
            watch, kept = raw[GROUP], file.create_group(GROUP)
            for name in watch:
                if name != "events":
                    watch.copy(name, kept)
            _copy_table(watch["events"], kept, int(watch["events_recorded"][()]))
    part.replace(path)


def _copy_table(source: h5py.Dataset, file: h5py.Group, rows: int, chunk: int = 4096) -> None:
    name = source.name.rsplit("/")[-1]
    table = file.create_dataset(
        name, (rows,), source.dtype, chunks=(min(chunk, max(rows, 1)),) if rows else None,
        compression="gzip" if rows else None, compression_opts=1 if rows else None, shuffle=rows > 0,
    )  # fmt: skip
    step = 16 * chunk
    for start in range(0, rows, step):
        table[start : start + step] = source[start : min(start + step, rows)]
