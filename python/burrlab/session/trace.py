"""A recorded session, read back."""

from __future__ import annotations

import html
import json
import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Burr, Material, Tissues, VoxelBone
from burrlab.dataset import frame
from burrlab.session.new_hdf5 import attributes
from burrlab.session.snapshot import open_hdf5, read_bone, read_dataset, told_as_damage
from burrlab.session.trace_file import BURR_COLUMNS, FORMAT, FORMAT_VERSION, TICK_COLUMNS, row_dtype
from burrlab.session.watch_rows import Watched, read_watch
from burrlab.volume.header import told_notes

if TYPE_CHECKING:
    import h5py
    import pandas

_LONGEST = 1000  # characters of a name
_AXES = "xyz"


@dataclass(frozen=True, repr=False, eq=False)
class Trace:
    """All that is needed to run a session again bit for bit, and what it gave.

    Attributes
    ----------
    path : Path
    ticks : ndarray, shape (n,)
        A row a tick, with a compound `burr` a burr; read-only. `docs/trace.md` lists the columns.
    tools : tuple of (Burr, Material)
        One a burr, in index order.
    devices : tuple of str
        Their devices' names.
    seed : int
    period : float
        Of the loop [ms].
    scheme : {"layer", "cell"}
    first_tick : int
        Ticks executed on the bone before.
    digests : tuple of (int, str)
        (ticks executed, digest of the bone then).
    ended : str
        Why recording ended; empty if the session was killed, or goes on.
    complete : bool
        Recording ended with the session.
    source : str
        Where the volume comes from.
    note : dict
        What the session added, as safety parameters.
    provenance : dict
        Versions, machine, CPU path and start of the recording.
    watch : dict
        Settings of the watch; empty without one.
    events : ndarray, shape (n,)
        What the watch told of, a row each; read-only. `docs/trace.md` lists the columns.
    watched : Watched or None
        What the watch saw in all; None without one, or if the session was killed.
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
        """What was assumed on the way to its bone, as `source` says."""
        return told_notes(self.source)

    @property
    def burrs(self) -> int:
        """Number of burrs."""
        return len(self.tools)

    @cached_property  # a sum over all ticks, asked for in loops
    def duration(self) -> float:
        """What the ticks stand for, the sum of their k periods [s]."""
        return float(self.ticks["k"].sum()) * self.period / 1000.0

    @cached_property
    def initial_digest(self) -> str:
        """Digest of the bone before the first tick, present and pristine levels."""
        return self._bone.digest()

    @property
    def voxel_volume(self) -> float:
        """Of the bone's grid [mm^3]."""
        return float(np.prod(self._bone.spacing))

    @property
    def tissues(self) -> Tissues | None:
        """Of its bone; None for a single material."""
        return self._bone.tissues

    def bone(self) -> VoxelBone:
        """A new bone as it was before the first tick."""
        return self._bone.copy()

    def time(self) -> NDArray[np.float64]:
        """Session time at the end of each tick: the sum of the periods they stand for [s], shape (n,)."""
        return np.cumsum(self.ticks["k"], dtype=np.float64) * (self.period / 1000.0)

    def array(self, name: str, burr: int = 0) -> NDArray[Any]:
        """A column, read-only.

        Parameters
        ----------
        name : str
            Of a tick's column, or of a burr's.
        burr : int
            Index of the burr.

        Returns
        -------
        ndarray, shape (n,) or (n, 3)

        Raises
        ------
        ValueError
            If there is no such column or burr.
        """
        self._check_burr(burr)
        if name in TICK_COLUMNS:
            return self.ticks[name]
        if name in BURR_COLUMNS:
            return self.ticks["burr"][name][:, burr]
        names = ", ".join(TICK_COLUMNS + BURR_COLUMNS)
        raise ValueError(f"name must be one of {names}, got '{name}'")

    def frame(self, burr: int = 0) -> pandas.DataFrame:
        """One burr's ticks as a pandas DataFrame, the tick's index as its index; vectors as _x, _y, _z before the unit.

        Raises
        ------
        ValueError
            If there is no such burr.
        ImportError
            If pandas is not installed.
        """
        self._check_burr(burr)
        columns: dict[str, Any] = {name: self.ticks[name] for name in TICK_COLUMNS}
        for name in BURR_COLUMNS:
            values = self.array(name, burr)
            if values.ndim == 1:
                columns[name] = values
                continue
            stem, unit = _split_unit(name)
            columns.update({f"{stem}_{_AXES[i]}_{unit}": values[:, i] for i in range(3)})
        table = frame(columns, "a frame")
        return table.set_index("index")

    def _check_burr(self, burr: int) -> None:
        if not 0 <= burr < self.burrs:
            raise ValueError(f"burr must be an index below {self.burrs}, got {burr}")

    def __repr__(self) -> str:
        tools = ", ".join(f"R = {burr.radius:g} mm in {material.name}" for burr, material in self.tools)
        end = self.ended or "not ended: killed, or still recorded"
        return f"Trace({len(self)} ticks from {self.first_tick}, {self.duration:.3f} s; {tools}; seed {self.seed}; {end})"

    def _repr_html_(self) -> str:
        rows = {
            "file": self.path.name, "ticks": len(self), "first tick": self.first_tick,
            "duration [s]": f"{self.duration:.3f}", "period [ms]": f"{self.period:g}", "seed": self.seed,
            "tools": ", ".join(f"R = {b.radius:g} mm in {m.name}" for b, m in self.tools),
            "devices": ", ".join(self.devices), "digests": len(self.digests),
            "initial digest": self.initial_digest, "ended": self.ended, "complete": self.complete,
            **self.provenance,
        }  # fmt: skip
        body = "".join(
            f"<tr><th>{key}</th><td>{html.escape(str(value))}</td></tr>" for key, value in rows.items()
        )
        return f"<table>{body}</table>"


def check_trace(trace: Trace) -> None:
    """TypeError unless it is a trace: the file's name is given too easily."""
    if not isinstance(trace, Trace):
        raise TypeError(f"trace must be a Trace, as load_trace gives it, got {trace!r}")


def load_trace(path: str | os.PathLike[str]) -> Trace:
    """Reads a trace: finished, of a session that was killed, or of one that still runs.

    All rows are read into memory, about 200 bytes a tick and burr.

    Raises
    ------
    ValueError
        If the file is no trace, one of a newer format, or damaged.
    OSError
        If it cannot be read.
    """
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file, told_as_damage(path):
        return _read(file, Path(path))


def _read(file: h5py.File, path: Path) -> Trace:
    about, volume = attributes(file), attributes(file["volume"])
    tools, devices = [], []
    for i in range(int(about["burrs"])):
        tool = attributes(file[f"tools/{i}"])
        material = Material(
            tool["material"], c_e=float(tool["c_e_N_per_mm2"]), alpha=float(tool["alpha_per_ms"]),
            shape=tool["shape"], source=tool["source"],
        )  # fmt: skip
        tools.append((Burr(float(tool["radius_mm"])), material))
        devices.append(tool["device"])
    first, seed, scheme = int(about["first_tick"]), int(about["seed"]), about["scheme"]
    if not (
        all(
            isinstance(name, str) and len(name) <= _LONGEST
            for name in (*devices, *(m.name for _, m in tools))
        )
        and 0 <= seed < 2**64
        and scheme in {"layer", "cell"}
    ):
        raise ValueError(
            f"its devices and materials must be texts of at most {_LONGEST} characters, its seed a number of 64 bits "
            "and its scheme layer or cell"
        )
    # Digests and events come first: they are written after the ticks they speak of.
    watch, watched, events = read_watch(file, len(tools))
    digests = read_dataset(file, "digests", int(read_dataset(file, "digests_recorded")))
    ended = bytes(read_dataset(file, "ended")).rstrip(b"\0").decode(errors="replace")
    complete = bool(read_dataset(file, "complete"))
    ticks = _ticks(file, path, first, len(tools))
    bone, tick = read_bone(file["volume"])
    if tick != first or bone.digest() != about["initial_digest"]:
        raise ValueError(f"{path} is damaged: its volume is not the one that the session began with")
    names = ("burrlab", "python", "numpy", "machine", "cpu_path", "started", "started_unix_s")
    return Trace(
        path, ticks, tuple(tools), tuple(devices), seed, float(about["period_ms"]), scheme,
        first, tuple((int(d["tick"]), d["digest"].decode("ascii")) for d in digests), ended, complete,
        str(volume["source"]), json.loads(read_dataset(file, "note")),
        {name: _plain(about[name]) for name in names}, watch, events, watched, bone,
    )  # fmt: skip


def _ticks(file: h5py.File, path: Path, first: int, burrs: int) -> NDArray[np.void]:
    table, recorded = file["ticks"], int(read_dataset(file, "recorded"))
    if recorded > len(table):
        raise ValueError(
            f"{path} is damaged: {recorded} ticks are counted, and there is room for {len(table)}"
        )
    if table.dtype != row_dtype(burrs):
        raise ValueError(f"{path} is damaged: its ticks have other columns than format {FORMAT_VERSION} has")
    ticks: NDArray[np.void] = read_dataset(file, "ticks", recorded)
    right = ticks["index"] == first + np.arange(recorded, dtype=np.uint64)
    right &= (ticks["k"] >= 1) & (ticks["k"] <= 8)
    if not right.all():
        raise ValueError(
            f"{path} is damaged: the row of tick {first + int(np.argmin(right))} holds something else"
        )
    ticks.flags.writeable = False
    return ticks


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _split_unit(name: str) -> tuple[str, str]:
    """("center", "mm") of "center_mm"."""
    unit = "mm_s" if name.endswith("_mm_s") else name.rsplit("_", 1)[1]
    return name[: -len(unit) - 1], unit
