"""Devices from text and CSV files, and the export of a trace for the simulator volumetric_drilling."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

import burrlab.common.table as csv_text
from burrlab._core import (
    IgtlDevice,
    OmegaDevice,
    ScriptedDevice,
    TouchDevice,
    VoxelBone,
    read_bricks,
    take_changed_bricks,
)
from burrlab.bone.kept import stack_slices
from burrlab.bone.slices import is_stack
from burrlab.common.check import refuse
from burrlab.common.files import new_hdf5
from burrlab.common.progress import Progress, reporter
from burrlab.session.haply import PORT, HaplyDevice, HeldDevice
from burrlab.session.replay import executor_of, inputs
from burrlab.session.trace import Trace, check_trace

if TYPE_CHECKING:
    import h5py


def _finite(value: float, unit: str) -> str | None:
    return csv_text.finite(value, "")


SCRIPT = csv_text.Table(
    (
        csv_text.Column("time", "s", check=_finite, due="a time"),
        *(csv_text.Column(axis, "mm", check=_finite, due="a position") for axis in "xyz"),
        csv_text.Column(
            "on",
            check=lambda value, unit: None if value in (0.0, 1.0) else f"must be 0 or 1: got {value!r}",
            optional=True,
            due="0 or 1",
        ),
        *(csv_text.Column(f"q{axis}", check=_finite, optional=True, due="an orientation") for axis in "wxyz"),
    )
)


def read_script(file: csv_text.Path | IO[str] | IO[bytes]) -> ScriptedDevice:
    """A device that follows the path in a CSV file.

    Parameters
    ----------
    file : path or file object
        Columns time_s (increasing), x_mm, y_mm, z_mm (centre of the burr, bone frame) and optionally on (1:
        the burr turns from this row to the next), and qw, qx, qy, qz (unit quaternion that turns directions
        of the tool into those of the bone). Without `on` it always turns. Lines that begin with # above the
        column names are comments.

    Returns
    -------
    ScriptedDevice

    Raises
    ------
    ValueError
        If a column is missing, a field is not a finite number, `on` is not 0 or 1, the times do not increase, or
        an orientation is not of length 1. The message names the file, and line and column where possible.
    OSError
        If the file cannot be opened.
    """
    name, _, columns = SCRIPT.read(file)
    position = np.column_stack([columns["x"], columns["y"], columns["z"]])
    on = np.asarray(columns["on"]) > 0 if "on" in columns else None
    turns = [columns[one] for one in ("qw", "qx", "qy", "qz") if one in columns]
    refuse(len(turns) not in (0, 4), f"{name}: an orientation needs all of the columns qw, qx, qy, qz")
    try:
        return ScriptedDevice(
            np.asarray(columns["time"]), position, on, np.column_stack(turns) if turns else None
        )
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


DeviceKind = Literal["hand", "scripted", "igtl", "touch", "omega", "haply"]


@dataclass(frozen=True)
class DeviceText:
    """The parts of a device text, as `--device` takes it.

    Attributes
    ----------
    kind : {"hand", "scripted", "igtl", "touch", "omega", "haply"}
    file : str
        Script to follow.
    host : str
    port : int
        OpenIGTLink server, or Haply's Inverse Service.
    name : str
        Of a touch in the vendor's set-up; empty for the default device.
    index : int
        Of an omega.
    """

    kind: DeviceKind
    file: str = ""
    host: str = ""
    port: int = 0
    name: str = ""
    index: int = 0


def parse_device(text: str) -> DeviceText:
    """The parts of a device text.

    Raises
    ------
    ValueError
        If the text has another form.

    Examples
    --------
    >>> parse_device("omega:1").index
    1
    """
    kind, colon, rest = text.partition(":")
    if text == "hand":
        return DeviceText("hand")
    if kind == "scripted" and rest:
        return DeviceText("scripted", file=rest)
    if text == "haply":
        return DeviceText("haply", host="localhost", port=PORT)
    if kind in ("igtl", "haply") and rest:
        try:
            return DeviceText("igtl" if kind == "igtl" else "haply", "", *parse_address(rest))
        except ValueError as error:
            raise ValueError(f"{kind}: {error}") from None
    if kind == "touch" and (rest or not colon):
        return DeviceText("touch", name=rest)
    if kind == "omega" and (rest.isdecimal() or not colon):
        return DeviceText("omega", index=int(rest or 0))
    raise ValueError(
        "must be hand, scripted:FILE, igtl:HOST:PORT, touch[:NAME], omega[:N] or haply[:HOST:PORT], got "
        f"'{text}'"
    )


def open_device(device: DeviceText, lost_after: float) -> IgtlDevice | HeldDevice:
    """Opens a device that moves by itself: igtl, touch, omega or haply.

    Raises
    ------
    ValueError
        If it cannot be opened.
    ImportError
        For haply without the extra.
    """
    if device.kind == "touch":
        return TouchDevice(device.name, lost_after=lost_after)
    if device.kind == "omega":
        return OmegaDevice(device.index, lost_after=lost_after)
    if device.kind == "haply":
        return HaplyDevice(device.host, device.port, lost_after=lost_after)
    return IgtlDevice(device.host, device.port, lost_after=lost_after)


def find_devices(doing: Callable[[str], AbstractContextManager[None]]) -> list[dict[str, str]]:
    """What was looked for: one row for each device that was found, or for a kind of which none was.

    Parameters
    ----------
    doing : callable
        Gives the context in which a device is opened, from a text that says which.

    Returns
    -------
    list of dict
        `device`, as `--device` takes it; `needs`, the vendor's library or service; then `hardware`, its model,
        and `library`, the file that was loaded or the service's address; or `why_not`, a sentence.
    """
    rows: list[dict[str, str]] = []

    def look(text: str, needs: str) -> None:
        row = {"device": text, "needs": needs}
        try:
            with doing(f"looking for {text}, over {needs}"):
                found = open_device(parse_device(text), 100.0)
            assert isinstance(found, HeldDevice)
            rows.append({**row, "hardware": found.hardware, "library": found.library})
        except (ValueError, ImportError) as error:
            rows.append({**row, "why_not": str(error)})

    look("touch", "libHD of OpenHaptics")
    try:
        count = OmegaDevice.count()
    except ValueError:
        count = 0
    for index in range(max(count, 1)):
        look(f"omega:{index}", "libdhd of Force Dimension")
    look("haply", "Haply's Inverse Service")
    return rows


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of a text HOST:PORT.

    Raises
    ------
    ValueError
        If the text is not HOST:PORT with a port of 1 to 65535.
    """
    host, colon, port = text.rpartition(":")
    refuse(
        not (colon and host and port.isdecimal() and 0 < int(port) < 65536),
        f"must be HOST:PORT, got '{text}'",
    )
    return host.strip("[]"), int(port)


_DATA_EVERY = 20  # [ms] between the rows of `data`, the layout's synchronised stream of about 50 Hz
_GROUP = 20  # ticks whose voxels share a time stamp
_NO_TURN = (0.0, 0.0, 0.0, 1.0)  # quaternion (x, y, z, w)
_QUARTER = (0.0, 0.0, 0.5**0.5, 0.5**0.5)  # about z, from x to y
#: Name of each old group in the new layout.
_NEW = {
    "metadata": "metadata_v3", "data": "vision_data/continuous_data",
    "voxels_removed": "physics_data/intermittent_data/voxels_removed",
    "burr_change": "physics_data/intermittent_data/burr_change",
    "drill_force_feedback": "physics_data/intermittent_data/drill_force_feedback",
    "high_frequency_poses/mastoidectomy_drill": "physics_data/continuous_data/high_frequency_poses/mastoidectomy_drill_pose",
}  # fmt: skip

_README = """All positions are in metres unless specified otherwise.
Quaternions are [qx, qy, qz, qw].
Poses are T_world_obj; the world is the bone's own frame (voxel axes, LPS).
Written by burrlab from a trace: no camera and no images. The quaternion of a drill whose device gave none is 0, 0, 0, 1.
"""
_OWN_AXES = "They count along the axes of the bone, which was not made of slices."
_STACK_AXES = "Of the slices that the bone was made of: x is the pixel's column, y its row counted from the lowest, z the slice, all from 0."
_VOXEL_README = """voxel_time_stamp: when a group of voxels was removed [s since epoch].
voxel_removed: (group, x, y, z), indices of the voxels of each group. {axes}
voxel_color: (group, r, g, b, a), 0 to 255; of the voxel's tissue, without tissues grey of its occupancy before the session.
A voxel counts as removed when less than half of its level before the session is left.
"""


def export_volumetric_drilling(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    burr: int = 0,
    layout: Literal["new", "old"] = "new",
    progress: Progress | None = None,
) -> None:
    """Writes a trace as the recorder of volumetric_drilling (`data_record.py`) would have recorded it.

    The trace is executed again to find which voxels went when.

    Parameters
    ----------
    trace : Trace
    path : path-like
        The HDF5 file; an existing file is overwritten.
    burr : int
        Index of the drill. The voxels include bone that another burr removed.
    layout : {"new", "old"}
        New: `metadata_v3`, `vision_data` and `physics_data`, as the recorder writes since 2025. Old: as in
        its earlier recordings.
    progress : callable or True, optional
        Called with the fraction done, 0 to 1; True shows a bar.

    Raises
    ------
    ValueError
        If there is no such burr or layout, or the path is the trace's own.
    TypeError
        If `trace` is not a trace.
    OSError
        If the file cannot be written, or the slices that the bone was cropped from are missing.

    Notes
    -----
    Groups follow the repository LCSR-SICKKIDS/volumetric_drilling ("New Data Structure Format" and "Old Data
    Structure Format"). A voxel has the colour of its tissue; without tissues, the grey of its occupancy.
    For a bone of PNG slices, indices are those of that simulator: column, row counted from the
    lowest, slice. If the slices were read with `transpose`, the volume's pose turns these axes into the
    bone's. Otherwise the two are mirror images, which no pose can express. For any other bone the indices
    are its own (x, y, z). A trace does not hold stereo images, depth, segmentation, camera poses,
    intrinsics, extrinsics, baseline or torques (written as zeros). `burr_size` is the diameter in whole
    millimetres, as there.
    """
    check_trace(trace)
    refuse(layout not in ("new", "old"), f"layout must be 'new' or 'old', got {layout!r}")
    same = Path(path).exists() and Path(path).samefile(trace.path)
    refuse(same, f"path must be another file than the trace, got {path}")
    center = trace.array("center_mm", burr) / 1000.0
    start = float(trace.provenance["started_unix_s"])
    stamps = start + trace.time()
    pose = np.hstack([center, np.roll(trace.array("orientation", burr), -1, axis=1)])  # w last
    grid = _Grid.of(trace)
    opened = False
    try:
        with new_hdf5(path) as file:
            opened = True

            def group(name: str) -> h5py.Group:
                return file.create_group(_NEW[name] if layout == "new" else name)

            if layout == "new":
                file.create_group("vision_data/intermittent_data")  # empty in the simulator's files too
            about = group("metadata")
            volume = about.create_dataset("voxel_volume", data=trace.voxel_volume)
            volume.attrs["units"] = "mm^3, millimeters cubed"
            about.create_dataset("README", data=_README)
            _write_data(group("data"), trace, grid, pose, stamps)
            drill = group("high_frequency_poses/mastoidectomy_drill")
            _put(drill, time_stamp=stamps, pose=pose)
            wrench = np.hstack([trace.array("sent_force_N", burr), np.zeros((len(trace), 3))])
            _put(group("drill_force_feedback"), time_stamp=stamps, wrench=wrench)
            whole = np.int64 if layout == "new" else np.int32
            size = np.array([int(2 * trace.tools[burr][0].radius)], dtype=whole)
            _put(group("burr_change"), time_stamp=np.array([start]), burr_size=size)
            _write_voxels(group("voxels_removed"), trace, grid, stamps, reporter(progress, "export"))
    except BaseException:
        if opened:  # incomplete
            Path(path).unlink(missing_ok=True)
        raise


@dataclass(frozen=True)
class _Grid:
    """The exported voxel grid: that of the slices the bone was made of, or the bone's own."""

    turned: bool | None  # whether the slices were transposed; None without slices
    sizes: NDArray[np.int64]  # of the whole stack (x, y, z), as it was read
    first: NDArray[np.int64]  # index of the bone's first voxel in the stack

    @classmethod
    def of(cls, trace: Trace) -> _Grid:
        bone = trace.bone()
        sizes, first = np.array(bone.shape[::-1]), np.zeros(3, np.int64)
        try:
            told = json.loads(trace.source)
            told = told.get("grey", told)  # the bone has this volume's voxels
            path = str(told.get("path") or told.get("labels") or "")
        except (ValueError, AttributeError, RecursionError):
            return cls(None, sizes, first)
        if "transpose" not in told and not (path and is_stack(path)):
            return cls(None, sizes, first)
        turned = bool(told.get("transpose", False))
        if "crop_mm" in told and "voxel_mm" not in told and (slices := stack_slices(path)) is not None:
            first = np.rint(np.array(bone.origin) / bone.spacing).astype(np.int64)
            sides = (slices.rows, slices.columns) if turned else (slices.columns, slices.rows)
            sizes = np.array([*sides, len(slices.paths)])
        return cls(turned, sizes, first)

    def indices(self, found: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices (x, y, z) in this grid of voxels (z, y, x) of the bone, shape (n, 3)."""
        x, y, z = (found[:, ::-1] + self.first).T
        if self.turned is None:
            return np.column_stack([x, y, z])
        across, down, rows = (y, x, self.sizes[0]) if self.turned else (x, y, self.sizes[1])
        return np.column_stack([across, rows - 1 - down, z])


def _put(group: h5py.Group, **columns: NDArray[np.generic]) -> None:
    for name, values in columns.items():
        group.create_dataset(name, data=values, compression="gzip" if len(values) else None)


def _write_data(
    group: h5py.Group, trace: Trace, grid: _Grid, pose: NDArray[np.float64], stamps: NDArray[np.float64]
) -> None:
    bone = trace.bone()
    extent = (grid.sizes - 1) / 2.0 - grid.first
    middle = (np.array(bone.origin) + extent * np.array(bone.spacing)) / 1000.0
    rows = np.arange(0, len(trace), max(1, round(_DATA_EVERY / trace.period)))
    volume = np.tile([*middle, *(_QUARTER if grid.turned else _NO_TURN)], (len(rows), 1))
    _put(group, time=stamps[rows], pose_mastoidectomy_drill=pose[rows], pose_mastoidectomy_volume=volume)


def _write_voxels(
    out: h5py.Group, trace: Trace, grid: _Grid, stamps: NDArray[np.float64],
    report: Callable[[float], object],
) -> None:  # fmt: skip
    start, bone = trace.bone(), trace.bone()
    before, numbers = bone.density, bone.tissue_numbers
    table = np.array([tissue.colour for tissue in bone.tissues or ()], dtype=float)
    executor = executor_of(trace, bone)
    gone = np.zeros(bone.shape, dtype=bool)
    times: list[float] = []
    voxels: list[NDArray[np.float64]] = []
    colors: list[NDArray[np.float64]] = []
    for first in range(0, len(trace), _GROUP):
        rows = trace.ticks[first : first + _GROUP]
        executor.execute(inputs(rows))
        found = _newly_gone(bone, start, gone)
        if len(found):
            group, opaque = np.full((len(found), 1), float(len(times))), np.full((len(found), 1), 255.0)
            at = tuple(found.T)
            color = np.tile(before[at].astype(float)[:, None], 3) if numbers is None else table[numbers[at]]
            voxels.append(np.hstack([group, grid.indices(found)]))
            colors.append(np.hstack([group, color, opaque]))
            times.append(stamps[first + len(rows) - 1])
        report((first + len(rows)) / len(trace))
    _put(
        out, voxel_time_stamp=np.array(times), voxel_removed=np.vstack([np.zeros((0, 4)), *voxels]),
        voxel_color=np.vstack([np.zeros((0, 5)), *colors]),
    )  # fmt: skip
    axes = _OWN_AXES if grid.turned is None else _STACK_AXES
    out.create_dataset("README", data=_VOXEL_README.format(axes=axes))


def _newly_gone(bone: VoxelBone, start: VoxelBone, gone: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Sorted indices (z, y, x), shape (n, 3), of voxels that fell below half since the last call.

    Marks them in `gone`.
    """
    bricks = take_changed_bricks(bone)
    now, before = (read_bricks(one, bricks).astype(np.int16) for one in (bone, start))
    brick, voxel = np.nonzero(2 * now < before)  # both are 0 outside the bone
    counts = [-(-n // 8) for n in bone.shape]
    corner, within = np.unravel_index(bricks[brick], counts), np.unravel_index(voxel, (8, 8, 8))
    found: NDArray[np.int64] = np.unique(8 * np.column_stack(corner) + np.column_stack(within), axis=0)
    found = found[~gone[tuple(found.T)]]
    gone[tuple(found.T)] = True
    return found
