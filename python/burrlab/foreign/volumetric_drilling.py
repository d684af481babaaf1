"""Sessions in the layouts of the simulator volumetric_drilling: the export of a trace, and its recordings read."""

import json
import os
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from burrlab._core import ScriptedDevice, Tissues, VoxelBone, read_bricks, take_changed_bricks
from burrlab.bone.slices import is_stack, stack_slices
from burrlab.bone.snapshot import open_any_hdf5, read_dataset
from burrlab.common.check import check_positive, refuse
from burrlab.common.files import attributes, new_file, new_hdf5
from burrlab.common.progress import Progress, doing, reporter
from burrlab.session.replay import executor_of, inputs
from burrlab.session.trace import Handling, Motion, Trace, check_trace

if TYPE_CHECKING:
    import h5py

Array = NDArray[np.float64]

_DATA_EVERY = 20  # [ms] between the rows of `data`, the layout's synchronised stream of about 50 Hz
_GROUP = 20  # ticks whose voxels share a time stamp
_BONE = 128  # level from which a voxel counts as bone
_NO_TURN = (0.0, 0.0, 0.0, 1.0)  # quaternion (x, y, z, w)
_QUARTER = (0.0, 0.0, 0.5**0.5, 0.5**0.5)  # about z, from x to y
#: By this the recorder multiplies lengths since June 2023, unless it is given another header: |direction| x size / 1000.
_SCALE = 0.0492027
_RESAMPLED = 0.01  # least volume of a recording's voxel over that of a bone which was resampled
_LEAST_VOXEL = 0.05**3  # [mm^3]; smaller ones make one doubt the lengths
#: Name of each old group in the new layout.
_NEW = {
    "metadata": "metadata_v3", "data": "vision_data/continuous_data",
    "voxels_removed": "physics_data/intermittent_data/voxels_removed",
    "burr_change": "physics_data/intermittent_data/burr_change",
    "drill_force_feedback": "physics_data/intermittent_data/drill_force_feedback",
    "high_frequency_poses/mastoidectomy_drill": "physics_data/continuous_data/high_frequency_poses/mastoidectomy_drill_pose",
}  # fmt: skip

_ABSENT = {
    "removed": "removed voxels", "volume_pose": "the burr's place", "burr_radius": "its radius", "force": "force",
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
A voxel counts as removed when less than half of its level before the session, at least 128 of 255, is left.
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
        The HDF5 file; an existing file is replaced when the new one is complete.
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
    intrinsics, extrinsics, baseline or torques (written as zeros). `burr_size` is the diameter, rounded to
    whole millimetres, as there.

    Examples
    --------
    >>> import burrlab, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> file, clock = folder.name + "/session.h5", burrlab.Clock(wall_clock=False)
    >>> bone = burrlab.VoxelBone.block((20, 20, 5), 0.2, origin=(-9.9, -9.9, -4.9))
    >>> tool, hand = (burrlab.Burr(3.0), burrlab.materials["bone"]), burrlab.HandDevice((0, 0, 3.0))
    >>> with burrlab.Session(bone, tool, hand, seed=1, duration=0.5, clock=clock, record=file) as session:
    ...     ended = session.wait()
    >>> recording = folder.name + "/recording.hdf5"
    >>> export_volumetric_drilling(burrlab.load_trace(file), recording)
    >>> read_volumetric_drilling(recording)
    DrillingRecording(new layout; 500 poses, 121 voxels removed from 1 structures; absent: -)
    >>> folder.cleanup()
    """
    check_trace(trace)
    refuse(layout not in ("new", "old"), f"layout must be 'new' or 'old', got {layout!r}")
    refuse(
        Path(path).exists() and Path(path).samefile(trace.path),
        f"path must be another file than the trace, got {path}",
    )
    start = float(trace.provenance["started_unix_s"])
    stamps = start + trace.time()
    turn = np.roll(trace.array("orientation", burr), -1, axis=1)  # w last
    pose = np.hstack([trace.array("center_mm", burr) / 1000.0, turn])
    with new_file(path) as part:
        grid = _SliceGrid(trace._bone, trace.source)
        with new_hdf5(part) as file:

            def group(name: str) -> "h5py.Group":
                return file.create_group(_NEW[name] if layout == "new" else name)

            if layout == "new":
                file.create_group("vision_data/intermittent_data")  # empty in the simulator's files too
            about = group("metadata")
            about["voxel_volume"] = trace.voxel_volume
            about["voxel_volume"].attrs["units"] = "mm^3, millimeters cubed"
            about.create_dataset("README", data=_README)
            rows = np.arange(0, len(trace), max(1, round(_DATA_EVERY / trace.period)))
            _put(
                group("data"),
                time=stamps[rows],
                pose_mastoidectomy_drill=pose[rows],
                pose_mastoidectomy_volume=np.tile(grid.pose(trace._bone), (len(rows), 1)),
            )
            _put(group("high_frequency_poses/mastoidectomy_drill"), time_stamp=stamps, pose=pose)
            wrench = np.hstack([trace.array("sent_force_N", burr), np.zeros((len(trace), 3))])
            _put(group("drill_force_feedback"), time_stamp=stamps, wrench=wrench)
            size = max(1, round(2 * trace.tools[burr][0].radius))
            sizes = np.array([size], np.int64 if layout == "new" else np.int32)
            _put(group("burr_change"), time_stamp=np.array([start]), burr_size=sizes)
            _write_voxels(group("voxels_removed"), trace, grid, stamps, reporter(progress, "export"))


class _SliceGrid:
    """The exported voxel grid: that of the slices the bone was made of, or the bone's own."""

    def __init__(self, bone: VoxelBone, source: str | Mapping[str, Any]) -> None:
        self.turned: bool | None = None  # whether the slices were transposed; None without slices
        self.sizes = np.array(bone.shape[::-1])  # of the whole stack (x, y, z), as it was read
        self.first = np.zeros(3, np.int64)  # index of the bone's first voxel in the stack
        try:
            described = json.loads(source) if isinstance(source, str) else source
            described = described.get("grey", described)  # the bone has this volume's voxels
            path = str(described.get("path") or described.get("labels") or "")
        except (ValueError, AttributeError, RecursionError):
            return
        if "transpose" not in described and not (path and is_stack(path)):
            return
        self.turned = bool(described.get("transpose", False))
        if (
            "crop_mm" in described
            and "voxel_mm" not in described
            and (slices := stack_slices(path)) is not None
        ):
            self.first = np.rint(np.array(bone.origin) / bone.spacing).astype(np.int64)
            sides = (slices.rows, slices.columns) if self.turned else (slices.columns, slices.rows)
            self.sizes = np.array([*sides, len(slices.paths)])

    def indices(self, voxels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices (x, y, z) in this grid of voxels (z, y, x) of the bone, shape (n, 3)."""
        x, y, z = (voxels[:, ::-1] + self.first).T
        if self.turned is None:
            return np.column_stack([x, y, z])
        across, down, rows = (y, x, self.sizes[0]) if self.turned else (x, y, self.sizes[1])
        return np.column_stack([across, rows - 1 - down, z])

    def places(self, indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Voxels (z, y, x) of the bone with these indices (x, y, z) in this grid; they may lie outside."""
        x, y, z = indices.T
        if self.turned is not None:
            x, y = (self.sizes[0] - 1 - y, x) if self.turned else (x, self.sizes[1] - 1 - y)
        return (np.column_stack([x, y, z]) - self.first)[:, ::-1]

    def pose(self, bone: VoxelBone) -> Array:
        """Pose of the volume in the bone's frame: middle [m], quaternion (x, y, z, w)."""
        extent = (self.sizes - 1) / 2.0 - self.first
        middle = (np.array(bone.origin) + extent * np.array(bone.spacing)) / 1000.0
        return np.array([*middle, *(_QUARTER if self.turned else _NO_TURN)])


def _put(group: "h5py.Group", **columns: NDArray[np.generic]) -> None:
    for name, values in columns.items():
        group.create_dataset(name, data=values, compression="gzip" if len(values) else None)


def _write_voxels(
    out: "h5py.Group", trace: Trace, grid: _SliceGrid, stamps: NDArray[np.float64],
    report: Callable[[float], object],
) -> None:  # fmt: skip
    start, bone = trace.bone(), trace.bone()
    before, numbers = bone.density, bone.tissue_numbers
    table = np.array([tissue.colour for tissue in bone.tissues or ()], dtype=float)
    executor = executor_of(trace, bone)
    gone = np.zeros(bone.shape, dtype=bool)
    times: list[float] = []
    groups = [np.zeros((0, 4), np.int64)]  # rows of a group's number and a voxel's (z, y, x)
    for first in range(0, len(trace), _GROUP):
        rows = trace.ticks[first : first + _GROUP]
        executor.execute(inputs(rows))
        if len(removed := _newly_gone(bone, start, gone)):
            groups.append(np.insert(removed, 0, len(times), axis=1))
            times.append(stamps[first + len(rows) - 1])
        report((first + len(rows)) / len(trace))
    group, voxels = np.hsplit(np.concatenate(groups), [1])
    at = tuple(voxels.T)
    color = np.tile(before[at][:, None], 3) if numbers is None else table[numbers[at]]
    _put(
        out, voxel_time_stamp=np.array(times), voxel_removed=np.hstack([group, grid.indices(voxels)]).astype(float),
        voxel_color=np.hstack([group, color, np.full_like(group, 255)]).astype(float),
    )  # fmt: skip
    out.create_dataset(
        "README", data=_VOXEL_README.format(axes=_OWN_AXES if grid.turned is None else _STACK_AXES)
    )


def _newly_gone(bone: VoxelBone, start: VoxelBone, gone: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Sorted indices (z, y, x), shape (n, 3), of voxels of bone that fell below half since the last call.

    Marks them in `gone`.
    """
    bricks = take_changed_bricks(bone)
    now, before = (read_bricks(each_bone, bricks).astype(np.int16) for each_bone in (bone, start))
    brick, voxel = np.nonzero((before >= _BONE) & (2 * now < before))  # both are 0 outside the bone
    corner = np.column_stack(np.unravel_index(bricks[brick], [-(-n // 8) for n in bone.shape]))
    within = np.column_stack(np.unravel_index(voxel, (8, 8, 8)))
    voxels: NDArray[np.int64] = np.unique(8 * corner + within, axis=0)
    voxels = voxels[~gone[tuple(voxels.T)]]
    gone[tuple(voxels.T)] = True
    return voxels


@dataclass(frozen=True, repr=False, eq=False)
class DrillingRecording:
    """A session as volumetric_drilling recorded it. Made by `read_volumetric_drilling`; what the file lacks is None.

    Times are since the file's first time stamp of any kind [s]. Whether the drill turned, and when it met bone, is
    not recorded.

    Attributes
    ----------
    path : Path
        The file, or the first of several.
    layout : {"new", "old"}
    started : float
        The first time stamp [s since epoch].
    time : ndarray, shape (n,)
        Of the drill's poses [s].
    position : ndarray, shape (n, 3)
        Of the drill, there the centre of its burr, in the recording's world [mm].
    orientation : ndarray, shape (n, 4)
        Unit quaternions (w, x, y, z) that turn directions of the drill into those of the world.
    force_time, force : ndarray, shape (m,) and (m, 3), or None
        Force feedback: times [s] and forces [N], each valid until the next.
    burr_time, burr_radius : ndarray, shape (k,), or None
        Changes of the burr: times [s] and radii from then on [mm].
    removed_time : ndarray, shape (v,), or None
        When each voxel was removed [s].
    removed : ndarray, shape (v, 3), or None
        Indices (x, y, z) of the removed voxels, in the simulator's volume.
    structure : ndarray, shape (v,), or None
        Index in `structures` of each removed voxel.
    structures : tuple of str
        Colours of the removed voxels, as "#rrggbb", or their names in the table of tissues that was given.
    voxel_volume : float or None
        [mm^3]
    volume_pose : ndarray, shape (7,), or None
        Of the volume's middle in the world: x, y, z [mm], quaternion (w, x, y, z).
    """

    path: Path
    layout: Literal["new", "old"]
    started: float
    time: Array
    position: Array
    orientation: Array
    force_time: Array | None
    force: Array | None
    burr_time: Array | None
    burr_radius: Array | None
    removed_time: Array | None
    removed: NDArray[np.int64] | None
    structure: NDArray[np.int64] | None
    structures: tuple[str, ...]
    voxel_volume: float | None
    volume_pose: Array | None

    @property
    def absent(self) -> tuple[str, ...]:
        """Names of the attributes that are None."""
        return tuple(name for name, value in vars(self).items() if value is None)

    @property
    def removed_volume(self) -> dict[str, float] | None:
        """Volume of the voxels removed from each structure [mm^3]; None if voxels or their size are not recorded."""
        if self.structure is None or self.voxel_volume is None:
            return None
        counts = np.bincount(self.structure, minlength=len(self.structures)) * self.voxel_volume
        return dict(zip(self.structures, counts.tolist(), strict=True))

    def removed_from(self, bone: VoxelBone, source: str | Mapping[str, Any] = "") -> NDArray[np.int64]:
        """The removed voxels as indices (z, y, x) of a bone.

        Parameters
        ----------
        bone : VoxelBone
            Made of the recording's volume.
        source : str or mapping
            Source of the bone, as `Trace.source`. It tells of slices, whose rows the simulator counts from the
            lowest; without it the indices are taken for the bone's own (x, y, z).

        Returns
        -------
        ndarray, shape (v, 3)
            In the order of `removed`.

        Raises
        ------
        ValueError
            If no voxels were recorded, or the bone has voxels of another size or does not hold them all.
        """
        if self.removed is None:
            raise ValueError(f"{self.path} holds no removed voxels")
        self._scale_on(bone, source)
        places = _SliceGrid(bone, source).places(self.removed)
        outside = int(((places < 0) | (places >= bone.shape)).any(axis=1).sum())
        refuse(
            outside,
            f"bone must be that of the recording, with its source: {outside} of {len(places)} removed voxels lie "
            "outside",
        )
        return places

    def drilled(
        self, bone: VoxelBone, source: str | Mapping[str, Any] = "", *, until: float = np.inf
    ) -> VoxelBone:
        """A copy of a bone without the voxels removed up to a time [s], for the view and for comparisons.

        Other parameters and errors are those of `removed_from`.
        """
        places, drilled, levels = self.removed_from(bone, source), bone.copy(), np.array(bone.density)
        assert self.removed_time is not None
        levels[tuple(places[self.removed_time <= until].T)] = 0
        drilled.restore(levels)
        return drilled

    def device(self, bone: VoxelBone | None = None, source: str | Mapping[str, Any] = "") -> ScriptedDevice:
        """A device that repeats the recorded path at its times, and always turns.

        Parameters
        ----------
        bone : VoxelBone, optional
            Made of the recording's volume, whose recorded pose then turns the path into the bone's frame. The
            slices must have been read with `transpose`, or this is a mirror image of what was drilled. Without a
            bone, the world is the bone's frame, as in our own exports.
            The sizes of the voxels tell whether the recorder multiplied lengths: then they are divided.
        source : str or mapping
            As in `removed_from`.

        Raises
        ------
        ValueError
            If the recording has no pose, or with a bone no pose of the volume, or its voxels are less than 1 % of
            the bone's for no known reason.

        Warns
        -----
        UserWarning
            If lengths are divided.
        """
        turn = scipy.spatial.transform.Rotation.from_quat(np.roll(self.orientation, -1, axis=1))
        position = self.position
        if bone is not None:
            to_bone, position, note = self._in_frame_of(bone, source)
            if note:
                warnings.warn(f"{self.path}: {note}", stacklevel=2)
            turn = to_bone * turn
        new = np.diff(self.time, append=np.inf) > 0  # the last of poses with one time stamp
        return ScriptedDevice(self.time[new], position[new], None, np.roll(turn.as_quat(), 1, axis=1)[new])

    def _in_frame_of(self, bone: VoxelBone, source: str | Mapping[str, Any]) -> tuple[Any, Array, str]:
        """The rotation from the world to the bone's frame, the drill's positions in the latter [mm], and a note if
        lengths are divided, else empty."""
        if self.volume_pose is None:
            raise ValueError(f"{self.path} holds no pose of the volume, which places the path in a bone")
        of_quaternion = scipy.spatial.transform.Rotation.from_quat
        bone_pose, theirs = _SliceGrid(bone, source).pose(bone), np.roll(self.volume_pose[3:], -1)
        to_bone = of_quaternion(bone_pose[3:]) * of_quaternion(theirs).inv()
        scale = self._scale_on(bone, source, least=_RESAMPLED)
        position = to_bone.apply((self.position - self.volume_pose[:3]) / scale) + 1000.0 * bone_pose[:3]
        note = f"lengths are divided by {scale:g}, by which its recorder multiplied them"
        return to_bone, position, note * (scale != 1.0)

    def _scale_on(
        self, bone: VoxelBone, source: str | Mapping[str, Any], *, least: float = np.inf
    ) -> float:  # fmt: skip
        """By what the recorder multiplied lengths, as the sizes of the voxels tell. Where nothing known fits, 1 for
        voxels of at least this share of the bone's, else ValueError."""
        sizes, bone_voxel = _SliceGrid(bone, source).sizes, float(np.prod(bone.spacing))
        side = float(sizes.max() * bone.spacing[sizes.argmax()]) / 1000.0  # the volume's own header
        ratio = 1.0 if self.voxel_volume is None else self.voxel_volume / bone_voxel
        for scale in (1.0, _SCALE, side):
            if abs(ratio / scale**3 - 1.0) <= 1e-3:
                return scale
        refuse(
            ratio < least,
            f"bone must have voxels of {ratio * bone_voxel:.6g} mm^3, as the recording's volume, got {bone_voxel:.6g} mm^3; if "
            f"its recorder multiplied lengths, scale={ratio ** (1 / 3):.6g} (--scale) would fit",
        )
        return 1.0

    def motion(self, bone: VoxelBone, source: str | Mapping[str, Any] = "") -> Motion:
        """What `RecordingPlayer` shows on the bone; errors and `source` are those of `removed_from`."""
        centers, removed, divided = None, (np.zeros(0), np.zeros((0, 3), np.int64)), ""
        if self.removed_time is not None:
            removed = self.removed_time, self.removed_from(bone, source)
        if self.volume_pose is not None:
            _, centers, divided = self._in_frame_of(bone, source)
        absent = [absence for name, absence in _ABSENT.items() if name in self.absent]
        notes = ["not recorded: " + ", ".join(["penetration", "whether the burr turned", *absent]), divided]
        return Motion(
            self.time, centers, self.force_time, self.force, self.burr_time, self.burr_radius, *removed,
            tuple(filter(None, notes)),
        )  # fmt: skip

    def handling(self, burr: int) -> Handling:
        """What `session_metrics` reads; its only burr is 0."""
        refuse(burr != 0, f"burr must be an index below 1, got {burr}")
        if self.voxel_volume is not None and self.voxel_volume < _LEAST_VOXEL:
            warnings.warn(
                f"{self.path}: voxels of {self.voxel_volume:.3g} mm^3 are small for a bone: if its recorder multiplied "
                f"lengths (docs/trace.md), scale={_SCALE:g} (--scale) divides by its default", stacklevel=4,
            )  # fmt: skip
        time, n = self.time, len(self.time)
        missing = ["cutting", "removal_rate"]
        force, volume = np.full((2, n), np.nan)
        if self.force is None or self.force_time is None:
            missing += ["contact", "mean_force", "rms_force", "peak_force", "over_threshold"]
        else:
            last = np.searchsorted(self.force_time, time, side="right")  # none before the first
            force = np.append(0.0, np.linalg.norm(self.force, axis=1))[last]
        if self.removed_time is None or self.voxel_volume is None:
            missing += ["removed"]
        else:
            volume = self.voxel_volume * np.searchsorted(self.removed_time, time, side="right")
            volume[-1:] = self.voxel_volume * len(self.removed_time)  # also those after the last pose
        step = np.diff(time, prepend=0.0)
        return Handling(
            time, step, float(np.median(step)) * 1000.0 if n else 1.0, float(step.sum()), self.position, force,
            force > 0, np.zeros(n, bool), volume, self.removed_volume, tuple(missing),
        )  # fmt: skip

    def __repr__(self) -> str:
        voxels = "no" if self.removed is None else len(self.removed)
        return (
            f"DrillingRecording({self.layout} layout; {len(self.time)} poses, {voxels} voxels removed from "
            f"{len(self.structures)} structures; absent: {', '.join(self.absent) or '-'})"
        )


_KIND = "a recording of volumetric_drilling"
_UNITS = {
    "m": ("m", "meter", "meters", "metre", "metres"), "s": ("s", "sec", "second", "seconds"),
    "N": ("n", "newton", "newtons"), "mm": ("mm", "millimeters", "millimetres"), "mm^3": ("mm^3",),
}  # fmt: skip
#: Where the recorder kept the fast poses, and the column's name; the third is that of its document.
_DRILLS = (
    ("high_frequency_poses/mastoidectomy_drill", "pose"), ("high_frequency_poses/mastoidectomy_drill_pose", "pose"),
    ("high_frequency_poses/drill_pose", "pose"), ("high_frequency_drill_pose", "drill_pose"),
)  # fmt: skip


@doing("reading a recording")
def read_volumetric_drilling(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    tissues: Tissues | None = None,
    scale: float = 1.0,
) -> DrillingRecording:
    """Reads a recording of the simulator volumetric_drilling, in either of its layouts.

    Parameters
    ----------
    path : path-like or sequence of path-like
        An HDF5 file; or the files of one session in their order, or a folder of them, because the recorder begins
        a new file, named by its time, every 500 samples.
    tissues : Tissues, optional
        Names the structures by their colours.
    scale : float
        What the recorder multiplied lengths by: they are divided by it, the volume of a voxel by its cube.

    Returns
    -------
    DrillingRecording

    Raises
    ------
    ValueError
        If a file is damaged or none of these, states other units than metres, seconds, newtons, mm and mm^3, lacks
        a dataset, or holds one of another shape or type, numbers that are not finite, or times that go back.
    OSError
        If a file cannot be read.

    Notes
    -----
    Read are the groups of "New Data Structure Format" and "Old Data Structure Format" of the repository
    LCSR-SICKKIDS/volumetric_drilling; cameras, images and other objects are not. Poses are those of
    `high_frequency_poses`, else of the stream of about 50 Hz.

    Examples
    --------
    >>> import burrlab
    >>> recording = burrlab.read_volumetric_drilling("20250312_1530.hdf5")  # doctest: +SKIP
    >>> player = burrlab.view.RecordingPlayer(recording, bone)  # doctest: +SKIP
    """
    check_positive("scale", scale)
    single = isinstance(path, str | os.PathLike)
    files = [Path(path)] if single else [Path(each) for each in path]  # type: ignore[arg-type, union-attr]
    if single and files[0].is_dir():
        files = sorted(files[0].glob("*.hdf5"))
    refuse(not files, f"path must hold files *.hdf5, got {path}")
    parts = []
    for file in files:
        with open_any_hdf5(file, _KIND) as opened:
            parts.append(_Part(opened, file, scale))
    layouts = sorted({part.layout for part in parts})
    refuse(len(layouts) > 1, f"path must hold files of one layout, got {', '.join(layouts)}")

    def joined(name: str) -> list[Any]:
        """The columns of a table of all files; None where no file has it."""
        tables = [table for part in parts if (table := part.tables[name])]
        return [np.concatenate(columns) for columns in zip(*tables, strict=True)] if tables else [None] * 3

    tables = {name: joined(name) for name in parts[0].tables}
    times = {name: table[0] for name, table in tables.items() if table[0] is not None}
    refuse(not times, f"{files[0]} is an empty recording: no pose, no force, no removed voxel")
    refuse("poses" not in times, f"{files[0]} is not {_KIND}: it holds no pose of mastoidectomy_drill")
    started = float(min((time[0] for time in times.values() if len(time)), default=0.0))
    for name, time in times.items():
        refuse((np.diff(time) < 0).any(), f"{files[0]} is damaged: the times of its {name} go back")
        tables[name][0] = time - started
    removed_time, removed, colours = tables["voxels"]
    fields: tuple[Any, ...] = (
        files[0], parts[0].layout, started, *tables["poses"], *tables["forces"][:2], *tables["burrs"][:2],
        removed_time, removed, *_structures(colours, tissues),
        next((part.voxel_volume for part in parts if part.voxel_volume is not None), None),
        next((part.volume_pose for part in parts if part.volume_pose is not None), None),
    )  # fmt: skip
    return DrillingRecording(*fields)


def _structures(colours: Any, tissues: Tissues | None) -> tuple[Any, tuple[str, ...]]:
    """(index of each voxel's structure, names of the structures)"""
    if colours is None:
        return None, ()
    colours, structure = np.unique(colours, axis=0, return_inverse=True)
    return structure.ravel(), tuple(
        " or ".join(tissue.name for tissue in tissues or () if tissue.colour == colour)
        or "#{:02x}{:02x}{:02x}".format(*colour)
        for colour in map(tuple, colours.tolist())
    )


def is_recording(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a folder of recordings, or a file with a group of the layouts."""
    try:
        with open_any_hdf5(path, _KIND) as file:
            return _has_groups(file)
    except (OSError, ValueError):  # told by who reads it
        return any(Path(path).glob("*.hdf5"))


def _has_groups(file: "h5py.File", names: Iterable[str] = (*_NEW, *_NEW.values())) -> bool:
    return any(name.split("/")[0] in file for name in names)


def _split(pose: Array, scale: float) -> list[Array]:
    """Positions [mm] and quaternions (w, x, y, z) of poses of the file."""
    return [1000.0 * pose[:, :3] / scale, np.roll(pose[:, 3:], 1, axis=1)]


class _Part:
    """One file, whose ValueErrors `told_as_damage` completes. Its tables are lists of columns, the times first; None
    where it has none."""

    def __init__(self, file: "h5py.File", path: Path, scale: float) -> None:
        self._file, self._path = file, path
        refuse(not _has_groups(file), f"{path} is not {_KIND}: it has no group of its layouts")
        self.layout: Literal["new", "old"] = "new" if _has_groups(file, _NEW.values()) else "old"
        text = read_dataset(file, place) if (place := self._place("metadata", "README")) in file else b""
        text = text.decode(errors="replace") if isinstance(text, bytes) else ""
        if unit := re.search(r"\bpositions?\b[^.\n]*? in (\w+)", text, re.IGNORECASE):
            self._check_unit(place, unit[1], "m")
        size = self._column("metadata", "voxel_volume", "mm^3", None, optional=True)
        self.voxel_volume = float(size) / scale**3 or None if size is not None else None  # its 0: not known
        refuse((self.voxel_volume or 1.0) < 0, f"its voxels have a volume of {size} mm^3")
        volume = self._column("data", "pose_mastoidectomy_volume", "m", 7, optional=True)
        self.volume_pose = (
            None if volume is None or not len(volume) else np.hstack(_split(volume[:1], scale))[0]
        )
        forces = self._table("drill_force_feedback", "time_stamp", ("wrench", "N", 6))
        burrs = self._table("burr_change", "time_stamp", ("burr_size", "mm", 0))
        refuse(burrs and (burrs[1] <= 0).any(), "its burr_size must be above 0")
        poses = [self._table(drill, "time_stamp", (column, "m", 7)) for drill, column in _DRILLS]
        if self._column("data", "pose_mastoidectomy_drill", "m", 7, optional=True) is not None:
            poses.append(self._table("data", "time", ("pose_mastoidectomy_drill", "m", 7)))
        self.tables: dict[str, list[NDArray[Any]] | None] = {
            "poses": next(([time, *_split(pose, scale)] for time, pose in filter(None, poses)), None),
            "forces": forces and [forces[0], forces[1][:, :3]],
            "burrs": burrs and [burrs[0], burrs[1] / 2.0],
            "voxels": self._voxels(),
        }

    def _voxels(self) -> list[NDArray[Any]] | None:
        alone = self._place("voxels_removed", "time_stamp") in self._file  # until October 2022: no groups
        stamps = self._column("voxels_removed", "time_stamp" if alone else "voxel_time_stamp", "s", 0)
        removed = self._column("voxels_removed", "voxel_removed", None, 4 - alone)
        colours = self._column("voxels_removed", "voxel_color", None, 5 - alone)
        if stamps is None or removed is None or colours is None:
            return None
        if alone:
            removed, colours = (
                np.insert(rows, 0, np.arange(len(rows)), axis=1) for rows in (removed, colours)
            )
        group, rgb = removed[:, 0], np.rint(colours[:, 1:4])
        refuse(
            len(colours) != len(removed) or (colours[:, 0] != group).any(),
            "its voxel_removed and voxel_color are of other groups",
        )
        filled, rank = np.unique(group, return_inverse=True)
        if len(filled) == len(stamps):  # in 2024, groups without voxels have no time
            group = rank
        whole = (removed == np.rint(removed)).all() and (removed >= 0).all() and (group < len(stamps)).all()
        refuse(not whole, f"its voxel_removed must hold one of {len(stamps)} groups and indices from 0")
        refuse(((rgb < 0) | (rgb > 255)).any(), "its voxel_color must lie from 0 to 255")
        return [stamps[group.astype(np.int64)], removed[:, 1:].astype(np.int64), rgb.astype(np.int64)]

    def _table(self, group: str, time: str, column: tuple[str, str, int]) -> list[Array] | None:
        stamps, values = self._column(group, time, "s", 0), self._column(group, *column)
        if stamps is None or values is None:
            return None
        refuse(
            len(values) != len(stamps),
            f"its {self._place(group, column[0])} has {len(values)} rows for {len(stamps)} times",
        )
        return [stamps, values]

    def _column(
        self, group: str, name: str, unit: str | None, width: int | None, *, optional: bool = False
    ) -> Any:
        """A dataset as floats: rows of `width` numbers, 0: of one, None: a single number. None without its group, or
        where nothing came into it."""
        place = self._place(group, name)
        folder = place.rpartition("/")[0]
        if folder not in self._file or not len(self._file[folder]) or (optional and place not in self._file):
            return None
        refuse(place not in self._file, f"it has no dataset {place}")
        if unit is not None:
            self._check_unit(place, str(attributes(self._file[place]).get("units", unit)), unit)
        values, dataset = np.asarray(read_dataset(self._file, place)), f"its dataset {place}"
        refuse(values.dtype.kind not in "iuf", f"{dataset} must hold numbers, got {values.dtype}")
        shape = () if width is None else (len(values), width)[: 1 + bool(width)] if values.ndim else None
        refuse(values.shape != shape, f"{dataset} has the shape {values.shape}")
        values = values.astype(float)
        refuse(not (abs(values) < 1e12).all(), f"{dataset} holds a number that is not finite, or above 1e12")
        turns = np.linalg.norm(values[:, 3:], axis=1) if width == 7 else np.ones(1)
        refuse((abs(turns - 1.0) > 1e-3).any(), f"{dataset} holds a quaternion not of length 1")
        return values

    def _place(self, group: str, name: str) -> str:
        return f"{_NEW.get(group, group) if self.layout == 'new' else group}/{name}"

    def _check_unit(self, place: str, unit_text: str, unit: str) -> None:
        refuse(
            re.split(r"[\s,;]", unit_text.strip().lower())[0] not in _UNITS[unit],
            f"{self._path} is in other units: {place} must be in {unit}, says {unit_text!r}",
        )
