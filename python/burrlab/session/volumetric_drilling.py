"""A trace in the layout that the open temporal-bone simulator volumetric_drilling records."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from burrlab._core import TickExecutor, VoxelBone
from burrlab.session.new_hdf5 import new_hdf5
from burrlab.session.replay import inputs
from burrlab.session.trace import Trace, check_trace

if TYPE_CHECKING:
    import h5py

_DATA_EVERY = 20  # [ms] between the rows of `data`, the layout's synchronised stream of about 50 Hz
_GROUP = 20  # ticks whose voxels share a time stamp
_NO_TURN = (0.0, 0.0, 0.0, 1.0)  # quaternion (x, y, z, w)

_README = """All positions are in metres unless specified otherwise.
Quaternions are [qx, qy, qz, qw].
Poses are T_world_obj; the world is the bone's own frame (voxel axes, LPS).
Written by burrlab from a trace: no camera, no images, no orientation of the drill (its quaternion is 0, 0, 0, 1).
"""
_VOXEL_README = """voxel_time_stamp: when a group of voxels was removed [s since epoch].
voxel_removed: (group, x, y, z), indices of the voxels of each group.
voxel_color: (group, r, g, b, a), 0 to 255; grey of the voxel's occupancy before the session.
A voxel counts as removed when less than half of its level before the session is left.
"""


def export_volumetric_drilling(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    burr: int = 0,
    progress: Callable[[float], object] | None = None,
) -> None:
    """Writes a trace as volumetric_drilling's `data_record_v3.py` would have recorded it.

    The trace is executed again to find which voxels went when.

    Parameters
    ----------
    trace : Trace
    path : path-like
        The HDF5 file; one of that name is overwritten.
    burr : int
        The burr that is the drill; bone removed by another is in the voxels too.
    progress : callable, optional
        Called with the part done, 0 to 1.

    Raises
    ------
    ValueError
        If there is no such burr, or the path is the trace's own.
    TypeError
        If `trace` is not a trace.
    OSError
        If the file cannot be written.

    Notes
    -----
    Groups `metadata`, `data`, `voxels_removed`, `burr_change`, `drill_force_feedback` and `high_frequency_poses`, after the
    repository LCSR-SICKKIDS/volumetric_drilling ("Old Data Structure Format", which its released recordings follow).
    Without a counterpart, and left out: stereo images, depth, segmentation, camera poses, intrinsics, extrinsics and
    baseline, torques (zeros), the drill's orientation. `burr_size` is the diameter in whole millimetres, as there.
    """
    check_trace(trace)
    if Path(path).exists() and Path(path).samefile(trace.path):
        raise ValueError(f"path must be another file than the trace, got {path}")
    center = trace.array("center_mm", burr) / 1000.0
    start = float(trace.provenance["started_unix_s"])
    stamps = start + trace.time()
    pose = np.hstack([center, np.tile(_NO_TURN, (len(trace), 1))])
    with new_hdf5(path) as file:
        _write_metadata(file, trace)
        _write_data(file, trace, pose, stamps)
        drill = file.create_group("high_frequency_poses/mastoidectomy_drill")
        _put(drill, "time_stamp", stamps)
        _put(drill, "pose", pose)
        force = file.create_group("drill_force_feedback")
        wrench = np.zeros((len(trace), 6))
        wrench[:, :3] = trace.array("sent_force_N", burr)
        _put(force, "time_stamp", stamps)
        _put(force, "wrench", wrench)
        size = file.create_group("burr_change")
        _put(size, "time_stamp", np.array([start]))
        _put(size, "burr_size", np.array([int(2 * trace.tools[burr][0].radius)], dtype=np.int32))
        _write_voxels(file, trace, stamps, progress)


def _put(group: h5py.Group, name: str, values: NDArray[np.generic]) -> None:
    group.create_dataset(name, data=values, compression="gzip" if len(values) else None)


def _write_metadata(file: h5py.File, trace: Trace) -> None:
    group = file.create_group("metadata")
    volume = group.create_dataset("voxel_volume", data=trace.voxel_volume)
    volume.attrs["units"] = "mm^3, millimeters cubed"
    group.create_dataset("README", data=_README)


def _write_data(
    file: h5py.File, trace: Trace, pose: NDArray[np.float64], stamps: NDArray[np.float64]
) -> None:
    bone = trace.bone()
    extent = np.array(bone.shape[::-1]) - 1
    middle = (np.array(bone.origin) + extent * np.array(bone.spacing) / 2.0) / 1000.0
    rows = np.arange(0, len(trace), max(1, round(_DATA_EVERY / trace.period)))
    group = file.create_group("data")
    _put(group, "time", stamps[rows])
    _put(group, "pose_mastoidectomy_drill", pose[rows])
    _put(group, "pose_mastoidectomy_volume", np.tile([*middle, *_NO_TURN], (len(rows), 1)))


def _write_voxels(
    file: h5py.File, trace: Trace, stamps: NDArray[np.float64], progress: Callable[[float], object] | None
) -> None:
    bone = trace.bone()
    before = bone.density
    executor = TickExecutor(
        bone, list(trace.tools), trace.seed, period=trace.period, scheme=trace.scheme, tick=trace.first_tick
    )
    gone = np.zeros(bone.shape, dtype=bool)
    times: list[float] = []
    voxels: list[NDArray[np.float64]] = []
    colors: list[NDArray[np.float64]] = []
    for first in range(0, len(trace), _GROUP):
        rows = trace.ticks[first : first + _GROUP]
        executor.execute(inputs(rows))
        found = _newly_gone(bone, before, gone, trace, rows)
        if len(found):
            group = np.full((len(found), 1), float(len(times)))
            grey = before[tuple(found.T)].astype(float)[:, None]
            voxels.append(np.hstack([group, found[:, ::-1]]))
            colors.append(np.hstack([group, grey, grey, grey, np.full_like(grey, 255.0)]))
            times.append(stamps[first + len(rows) - 1])
        if progress is not None:
            progress((first + len(rows)) / len(trace))
    out = file.create_group("voxels_removed")
    _put(out, "voxel_time_stamp", np.array(times))
    _put(out, "voxel_removed", np.vstack(voxels) if voxels else np.zeros((0, 4)))
    _put(out, "voxel_color", np.vstack(colors) if colors else np.zeros((0, 5)))
    out.create_dataset("README", data=_VOXEL_README)


def _newly_gone(
    bone: VoxelBone, before: NDArray[np.uint8], gone: NDArray[np.bool_], trace: Trace, rows: NDArray[np.void]
) -> NDArray[np.int64]:
    """(n, 3) indices (z, y, x) of voxels that fell below half within these ticks; marks them in `gone`."""
    spacing, origin = np.array(bone.spacing), np.array(bone.origin)
    found = []
    for burr, (tool, _) in enumerate(trace.tools):
        if not rows["burr"]["removed_levels"][:, burr].any():
            continue
        center = rows["burr"]["center_mm"][:, burr]
        reach = tool.radius + spacing
        low = np.floor((center.min(axis=0) - reach - origin) / spacing).astype(int)[::-1]
        high = np.ceil((center.max(axis=0) + reach - origin) / spacing).astype(int)[::-1] + 1
        low, high = np.clip(low, 0, bone.shape), np.clip(high, 0, bone.shape)
        if (high <= low).any():
            continue
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        now = bone.read(tuple(int(a) for a in low), tuple(int(n) for n in high - low))
        new = (2 * now.astype(np.int16) < before[box]) & ~gone[box]
        gone[box] |= new
        found.append(np.argwhere(new) + low)
    return np.vstack(found) if found else np.zeros((0, 3), dtype=np.int64)
