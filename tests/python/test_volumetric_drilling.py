"""The export against the layout that volumetric_drilling documents and records."""

import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import h5py
import numpy as np
import pytest
from command_line import said
from label_scenes import coloured
from page_scenes import make_page
from PIL import Image
from scipy.spatial.transform import Rotation
from session_scenes import ended, make_records, recorded, refused, session_of, small_bone

import burrlab
from burrlab.anatomy import LabelledRecipe, default_tissues
from burrlab.effects.effects import Effects
from burrlab.foreign.volumetric_drilling import _NEW
from burrlab.view import RecordingPlayer, TracePlayer
from burrlab.view.camera import trace_approach
from burrlab.view.page_source import page_source
from burrlab.view.surface import brick_numbers

TICKS = 2005
NEW = GONE = "physics_data/intermittent_data/voxels_removed/"
DATA = "vision_data/continuous_data/"


def flat(file):
    """The datasets of a file by their names."""
    found = {}
    file.visititems(
        lambda name, item: found.update({name: item[()]} if isinstance(item, h5py.Dataset) else {})
    )
    return found


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """(datasets of the old layout, trace, records, bone)"""
    folder, bone = tmp_path_factory.mktemp("export"), small_bone()
    records, done = make_records(bone, TICKS, burrs=2, first=10), []
    trace = recorded(folder / "session.h5", records, burrs=2)
    burrlab.export_volumetric_drilling(trace, folder / "export.hdf5", layout="old", progress=done.append)
    assert done[-1] == 1.0
    with h5py.File(folder / "export.hdf5") as file:
        assert file["metadata/voxel_volume"].attrs["units"].startswith("mm^3")
        return flat(file), trace, records, bone


def test_names_and_shapes_are_the_documented_ones(made):
    file = made[0]
    samples, voxels, groups = (
        len(file[name])
        for name in ("data/time", "voxels_removed/voxel_removed", "voxels_removed/voxel_time_stamp")
    )
    assert {name: np.shape(values) for name, values in file.items()} == {
        "metadata/README": (), "metadata/voxel_volume": (),
        "data/time": (samples,), "data/pose_mastoidectomy_drill": (samples, 7),
        "data/pose_mastoidectomy_volume": (samples, 7),
        "voxels_removed/voxel_time_stamp": (groups,), "voxels_removed/voxel_removed": (voxels, 4),
        "voxels_removed/voxel_color": (voxels, 5), "voxels_removed/README": (),
        "burr_change/time_stamp": (1,), "burr_change/burr_size": (1,),
        "drill_force_feedback/time_stamp": (TICKS,), "drill_force_feedback/wrench": (TICKS, 6),
        "high_frequency_poses/mastoidectomy_drill/time_stamp": (TICKS,),
        "high_frequency_poses/mastoidectomy_drill/pose": (TICKS, 7),
    }  # fmt: skip
    assert samples == 101
    assert 0 < groups < voxels


def test_poses_are_metres_and_forces_newtons(made):
    file, trace, records, _ = made
    pose, wrench = file["high_frequency_poses/mastoidectomy_drill/pose"], file["drill_force_feedback/wrench"]
    np.testing.assert_allclose(pose[:, :3] * 1000, records["burr"]["center"][:, 0], rtol=1e-14)
    np.testing.assert_array_equal(wrench[:, :3], records["burr"]["sent"][:, 0])
    assert not wrench[:, 3:].any()
    np.testing.assert_array_equal(file["data/pose_mastoidectomy_drill"], pose[::20])
    since = file["drill_force_feedback/time_stamp"] - trace.provenance["started_unix_s"]
    np.testing.assert_allclose(since, np.cumsum(records["k"]) / 1000, atol=1e-6)
    assert file["burr_change/burr_size"].tolist() == [4]
    assert file["metadata/voxel_volume"] == pytest.approx(0.008)
    np.testing.assert_allclose(file["data/pose_mastoidectomy_volume"][0, :3], [0.0, 0.0, -0.002], atol=1e-9)


def test_groups_and_colours_of_the_voxels(made):
    """Which these are is read back below."""
    file, trace, *_ = made
    rows = file["voxels_removed/voxel_removed"].astype(int)
    before, at = trace.bone().density, tuple(rows[:, :0:-1].T)
    stamps = file["voxels_removed/voxel_time_stamp"]
    assert (np.diff(stamps) > 0).all()
    assert np.unique(rows[:, 0]).tolist() == list(range(len(stamps)))
    color = file["voxels_removed/voxel_color"]
    wanted = np.column_stack([rows[:, 0], before[at], np.full(len(rows), 255)])
    np.testing.assert_array_equal(color[:, [0, 1, 4]], wanted)


def test_an_interrupted_export_leaves_no_file(made, tmp_path):
    stop = Mock(side_effect=KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt):
        burrlab.export_volumetric_drilling(made[1], tmp_path / "export.hdf5", progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_a_session_that_removed_nothing(tmp_path):
    burrlab.export_volumetric_drilling(
        recorded(tmp_path / "session.h5"), tmp_path / "export.hdf5", layout="old"
    )
    with h5py.File(tmp_path / "export.hdf5") as made:
        assert made["voxels_removed/voxel_removed"].shape == (0, 4)
        assert made["high_frequency_poses/mastoidectomy_drill/pose"].shape == (0, 7)


@pytest.mark.parametrize(
    ("change", "error", "told"),
    [
        ({"burr": 2}, ValueError, "burr must be an index below 2, got 2"),
        ({"layout": "newest"}, ValueError, "layout must be 'new' or 'old', got 'newest'"),
        ({"path": "none/export.hdf5"}, FileNotFoundError, "folder must exist, got"),
        ({"trace": "session.h5"}, TypeError, "trace must be a Trace, as load_trace gives it"),
        ({"path": "session.h5"}, ValueError, "path must be another file than the trace"),
    ],
)
def test_what_is_refused(made, tmp_path, monkeypatch, change, error, told):
    trace = made[1]
    monkeypatch.chdir(trace.path.parent)
    with pytest.raises(error, match=told):
        burrlab.export_volumetric_drilling(**{"trace": trace, "path": tmp_path / "export.hdf5", **change})
    assert len(burrlab.load_trace(trace.path)) == TICKS


def test_the_layout_of_today_holds_the_same(made, tmp_path, capsys):
    wanted, trace, *_ = made
    out = str(tmp_path / "new.hdf5")
    assert said(capsys, "export", trace.path, "--out", out) == f"written {out}\n"
    with h5py.File(out) as file:
        assert set(file) == {"metadata_v3", "vision_data", "physics_data"}
        assert list(file["vision_data/intermittent_data"]) == []
        found = flat(file)
    assert len(found) == len(wanted) == 15
    for name, values in wanted.items():
        group, _, last = name.rpartition("/")
        np.testing.assert_array_equal(found[f"{_NEW[group]}/{last}"], values)
    assert found["physics_data/intermittent_data/burr_change/burr_size"].dtype == np.int64
    assert "--out must be a new file" in said(capsys, "export", trace.path, "--out", out, status=2)
    lost = said(capsys, "export", trace.path, "--out", f"{out}.new", "--json", trace.path, status=2)
    assert f"--json: {trace.path} is read, and would be lost" in lost
    said(capsys, "export", trace.path, "--out", f"{out}.old.hdf5", "--old")
    with h5py.File(f"{out}.old.hdf5") as file:
        assert set(flat(file)) == set(wanted)


@pytest.mark.parametrize(
    "how", ["as its converter writes them", "rows along y", "a box of them", "before the key"]
)
def test_indices_and_colours_are_those_of_the_slices(tmp_path: Path, how: str) -> None:
    pytest.importorskip("yaml", reason="extra `medical` is not installed")
    turned = how in ("as its converter writes them", "a box of them")
    box = ((0.9, 0.9, 0.4), (8.1, 7.1, 6.9)) if how == "a box of them" else None
    table = default_tissues({0: "air", 1: "bone", 10: "facial nerve"})
    recipe = LabelledRecipe(str(coloured(tmp_path / "slices")), table, crop=box, transpose=turned)
    source, bone = recipe.plain(), recipe.bone()
    assert source["transpose"] is turned
    if how == "before the key":
        del source["transpose"]
        assert LabelledRecipe.of(source).bone().digest() == bone.digest()
    at = np.arange(600) / 1e3
    path = np.array([2.7, 2.6, 6.2]) + np.outer(at, (4.0, 8.0, -4.0))
    tool, device = (burrlab.Burr(1.7), burrlab.materials["bone"]), burrlab.ScriptedDevice(at, path)
    options = {"seed": 1, "wall_clock": False, "source": source}
    session = ended(session_of(bone, tool, device, duration=0.5, record=tmp_path / "s.h5", **options))
    trace = burrlab.load_trace(tmp_path / "s.h5")
    assert json.loads(trace.source) == source
    burrlab.export_volumetric_drilling(trace, tmp_path / "out.hdf5")
    with h5py.File(tmp_path / "out.hdf5") as file:
        removed, colors = (file[NEW + name][()].astype(int) for name in ("voxel_removed", "voxel_color"))
        stamps = file[NEW + "voxel_time_stamp"][()]
        pose = file["vision_data/continuous_data/pose_mastoidectomy_volume"][0]
    gone = 2 * session.snapshot()[0].density.astype(int) < bone.density
    assert len(removed) == np.count_nonzero(gone) > 500
    planes = (gone.swapaxes(1, 2) if turned else gone)[:, ::-1]  # slice, row from the lowest, column
    if box is None:
        assert set(map(tuple, removed[:, :0:-1])) == set(map(tuple, np.argwhere(planes)))
    # That simulator loads the lowest row first (its library's reader of PNG files).
    stack = np.stack(
        [np.asarray(Image.open(name))[::-1] for name in sorted((tmp_path / "slices").glob("*.png"))]
    )
    x, y, z = removed[:, 1:].T
    np.testing.assert_array_equal(stack[z, y, x], colors[:, 1:])
    assert len(np.unique(colors[:, 1:], axis=0)) == 2  # bone and nerve
    assert pose[3:].tolist() == pytest.approx([0, 0, 0.5**0.5, 0.5**0.5] if turned else [0, 0, 0, 1])
    if turned:  # the volume's pose puts the voxels where the drill is
        there = 0.25 * (removed[:, 1:] - (np.array(stack.shape[2::-1]) - 1) / 2)
        there = 1000 * pose[:3] + there @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]  # that quarter turn
        drill = path[np.rint((stamps[removed[:, 0]] - trace.provenance["started_unix_s"]) * 1e3).astype(int)]
        assert np.linalg.norm(there - drill, axis=1).max() < 2.2
        shown = RecordingPlayer(burrlab.read_volumetric_drilling(tmp_path / "out.hdf5"), bone, trace.source)
        found, wanted = trace_approach(shown), trace_approach(TracePlayer(trace))
        assert found.axis @ wanted.axis > 0.9
        np.testing.assert_allclose(found.entry, wanted.entry, atol=2)
    back = burrlab.read_volumetric_drilling(tmp_path / "out.hdf5", tissues=bone.tissues)
    assert back.structures == tuple(t.name for t in sorted(bone.tissues, key=lambda t: t.colour) if t.label)
    places = back.removed_from(bone, trace.source)
    assert {tuple(one) for one in places} == {tuple(one) for one in np.argwhere(gone)}
    numbers = bone.tissue_numbers[tuple(places.T)]
    assert [back.structures[i] for i in back.structure] == [bone.tissues[i].name for i in numbers]
    assert sum(back.removed_volume.values()) == pytest.approx(len(removed) * trace.voxel_volume)
    ours, found = burrlab.session_metrics(trace), burrlab.session_metrics(back)
    for name in ("duration", "path", "strokes", "mean_speed", "peak_force", "mean_force"):
        assert getattr(found, name) == pytest.approx(getattr(ours, name), rel=1e-4)
    assert found.removed == pytest.approx(ours.removed, rel=0.1)
    turn, shift = Rotation.from_rotvec([0.3, -0.5, 0.7]), np.array([5.0, -40.0, 9.0])
    pose = np.vstack([back.volume_pose, np.hstack([back.position, back.orientation])])
    pose[:, :3] = turn.apply(pose[:, :3]) + shift  # the same in another world
    pose[:, 3:] = np.roll((turn * Rotation.from_quat(np.roll(pose[:, 3:], -1, axis=1))).as_quat(), 1, axis=1)
    moved = replace(back, position=pose[1:, :3], orientation=pose[1:, 3:], volume_pose=pose[0])
    again = ended(
        session_of(bone, tool, moved.device(bone, trace.source), record=tmp_path / "again.h5", **options)
    )
    redone = burrlab.load_trace(tmp_path / "again.h5")
    for name in ("center_mm", "orientation"):
        np.testing.assert_allclose(redone.array(name), trace.array(name), atol=1e-4)
    fell = 2 * again.snapshot()[0].density.astype(int) < bone.density
    assert (fell & gone).sum() > 0.999 * (fell | gone).sum()
    assert bone.removed == 0
    assert ((back.drilled(bone, trace.source).density == 0) == ((bone.density == 0) | gone)).all()
    half = back.drilled(bone, trace.source, until=0.25)
    assert half.removed == pytest.approx((back.removed_time <= 0.25).sum() * trace.voxel_volume)


@pytest.mark.parametrize("layout", ["old", "new"])
def test_an_export_is_read_back(made, tmp_path, layout):
    _, trace, records, bone = made
    burrlab.export_volumetric_drilling(trace, tmp_path / "out.hdf5", layout=layout)
    back, burr = burrlab.read_volumetric_drilling(tmp_path / "out.hdf5"), records["burr"][:, 0]
    assert (back.layout, back.absent, back.started) == (layout, (), trace.provenance["started_unix_s"])
    np.testing.assert_allclose(back.time, trace.time(), atol=1e-6)
    np.testing.assert_allclose(back.position, burr["center"], rtol=1e-14)
    np.testing.assert_array_equal(back.orientation, burr["orientation"])
    np.testing.assert_array_equal(back.force, burr["sent"])
    assert (back.burr_time.tolist(), back.burr_radius.tolist()) == ([0.0], [2.0])
    np.testing.assert_allclose(back.volume_pose, [0, 0, -2, 1, 0, 0, 0], atol=1e-9)
    gone = (trace.bone().density >= 128) & (2 * bone.density.astype(int) < trace.bone().density)
    places = back.removed_from(trace.bone(), trace.source)
    assert sorted(map(tuple, places)) == sorted(map(tuple, np.argwhere(gone)))
    levels = [int(name[1:3], 16) for name in back.structures]  # without tissues: grey of the occupancy
    np.testing.assert_array_equal(np.array(levels)[back.structure], trace.bone().density[tuple(places.T)])
    thin = replace(trace, tools=((burrlab.Burr(1.8), trace.tools[0][1]),) * 2)
    burrlab.export_volumetric_drilling(thin, tmp_path / "thin.hdf5", layout=layout)
    assert burrlab.read_volumetric_drilling(tmp_path / "thin.hdf5").burr_radius == [2.0]  # whole diameters
    with h5py.File(tmp_path / "thin.hdf5", "a") as file:
        file[f"{_NEW['burr_change'] if layout == 'new' else 'burr_change'}/burr_size"][0] = 0
    refused((lambda: burrlab.read_volumetric_drilling(tmp_path / "thin.hdf5"), "burr_size must be above 0"))
    assert back.voxel_volume == pytest.approx(0.008)
    ours, found = burrlab.session_metrics(trace), burrlab.session_metrics(back)
    for name in ("duration", "path", "strokes", "peak_force", "over_threshold", "rms_jerk"):
        assert getattr(found, name) == pytest.approx(getattr(ours, name), rel=1e-3)
    assert found.contact == pytest.approx(ours.contact, abs=0.01)
    assert found.removed == pytest.approx(len(places) * 0.008)
    assert np.isnan([found.cutting, found.removal_rate]).all()
    assert f"{len(places)} voxels" in repr(back)
    assert f"removed of {back.structures[-1]} [mm^3]" in repr(found)
    assert sum(found.to_dict()["removed_mm3_by_structure"].values()) == pytest.approx(found.removed)


def put(file, layout, group, **columns):
    for name, values in columns.items():
        file[f"{_NEW.get(group, group) if layout == 'new' else group}/{name}"] = values


def made_up(path, layout, *, start=1.7e9, poses=100):
    """A file as the documents of the simulator describe it, by default in h5py's own settings."""
    time, pose = start + 0.02 * np.arange(poses), np.tile([0.01, 0.02, 0.03, 0, 0, 0.6, 0.8], (poses, 1))
    with h5py.File(path, "w") as file:
        put(file, layout, "metadata", camera_intrinsic=np.eye(3), voxel_volume=0.125,
            README="All position information is in meters unless specified otherwise. \n")  # fmt: skip
        put(file, layout, "data", time=time, pose_mastoidectomy_drill=pose, l_img=np.zeros((poses, 4, 6, 3), "u1"),
            pose_main_camera=pose, pose_mastoidectomy_volume=np.tile([0, 0, 0, 0, 0, 0, 1.0], (poses, 1)))  # fmt: skip
        if poses > 60:
            put(file, layout, "voxels_removed", voxel_time_stamp=time[[50, 60]],
                voxel_removed=np.array([[0, 4, 5, 6], [0, 5, 5, 6], [1, 5, 6, 6]]),
                voxel_color=np.array([[0, 255, 249.9999, 220, 255], [0, 255, 250, 220, 255], [1, 9, 8, 7, 255]]))  # fmt: skip
    return path


@pytest.mark.parametrize("layout", ["old", "new"])
def test_a_file_as_the_documents_describe_it(tmp_path, layout):
    file = made_up(tmp_path / "20250101_120000.hdf5", layout)
    back = burrlab.read_volumetric_drilling(file)
    assert back.absent == ("force_time", "force", "burr_time", "burr_radius")
    np.testing.assert_allclose(back.time, 0.02 * np.arange(100), atol=1e-6)
    np.testing.assert_allclose(back.position, [[10, 20, 30]] * 100)
    np.testing.assert_array_equal(back.orientation[0], [0.8, 0, 0, 0.6])
    assert (back.structure.tolist(), back.structures) == ([1, 1, 0], ("#090807", "#fffadc"))
    np.testing.assert_allclose(back.removed_time, [1.0, 1.0, 1.2], atol=1e-6)
    assert back.removed_volume == {"#090807": 0.125, "#fffadc": 0.25}
    found = burrlab.session_metrics(back)
    assert np.isnan([found.peak_force, found.contact, found.over_threshold]).all()
    assert (found.removed, found.strokes, found.to_dict()["contact_s"]) == (0.375, 0, None)
    with h5py.File(file, "a") as more:  # the faster poses come first, under the name of the old document
        drill = "drill_pose" if layout == "old" else "mastoidectomy_drill"
        put(
            more,
            layout,
            f"high_frequency_poses/{drill}",
            time_stamp=1.7e9 + np.arange(10) / 2e3,
            pose=np.tile([1, 2, 3, 0, 0, 0, 1.0], (10, 1)),
        )
    assert burrlab.read_volumetric_drilling(file).position.tolist() == [[1000, 2000, 3000]] * 10


def test_the_layouts_that_its_recorder_wrote(tmp_path):
    """Made up as the recorder's history has them; what it made on opening a file stays empty where nothing came."""
    files = [made_up(tmp_path / f"{n}.hdf5", "old", start=1.7e9 + 2 * n) for n in range(5)]
    opened = ("burr_change", "drill_force_feedback", "high_frequency_poses")
    stamps, place = 1.7e9 + np.array([1.0, 1.2]), [[4, 5, 6], [5, 5, 6]]
    removed = {"time_stamp": stamps, "voxel_removed": place, "voxel_color": [[255, 250, 220, 255]] * 2}
    late = {"voxel_time_stamp": stamps + 2, "voxel_removed": [[1, 4, 5, 6], [4, 5, 5, 6]],
            "voxel_color": [[1, 9, 8, 7, 255], [4, 9, 8, 7, 255]]}  # fmt: skip
    for name, columns in zip(files, (removed, late, {}, {}, {}), strict=True):
        with h5py.File(name, "a") as file:
            del file["voxels_removed"]
            for group in ("voxels_removed", *opened):
                file.create_group(group)
            put(
                file, "old", "voxels_removed", **columns
            )  # 2022 to October, a voxel a row; 2024, of groups that hold one
    pose = np.tile([1, 2, 3, 0, 0, 0, 1.0], (2, 1))
    for name, group, column in (
        (files[3], "high_frequency_drill_pose", "drill_pose"),
        (files[4], "high_frequency_poses/mastoidectomy_drill_pose", "pose"),
    ):
        with h5py.File(name, "a") as file:
            put(file, "old", group, time_stamp=file["data/time"][:2], **{column: pose})
    back = burrlab.read_volumetric_drilling(tmp_path)
    np.testing.assert_allclose(back.removed_time, [1.0, 1.2, 3.0, 3.2], atol=1e-6)
    assert (back.removed.tolist(), back.structure.tolist()) == (place * 2, [1, 1, 0, 0])
    assert back.position[-4:].tolist() == [[1000, 2000, 3000]] * 4
    assert back.absent == ("force_time", "force", "burr_time", "burr_radius")
    with h5py.File(files[0], "w") as file:
        for group in ("metadata", "data", "burr_change", "voxels_removed"):
            file.create_group(group)
    assert len(burrlab.read_volumetric_drilling(tmp_path).removed) == 2
    refused(
        (lambda: burrlab.read_volumetric_drilling(files[0]),
         r"0\.hdf5 is an empty recording: no pose, no force, no removed voxel$"),
    )  # fmt: skip


@pytest.mark.parametrize("scale", [0.0492027, 0.008])  # of the default header, of the volume itself
def test_lengths_that_the_recorder_multiplied(tmp_path, capsys, scale):
    """Since June 2023 it takes its world, in metres, for one in units of a header's largest side."""
    bone, right = burrlab.VoxelBone.block((8, 8, 8), 0.5), burrlab.VoxelBone.block((8, 8, 8), 0.5)
    file, good = made_up(tmp_path / "a.hdf5", "new"), made_up(tmp_path / "b.hdf5", "new")
    with h5py.File(file, "a") as wrong:
        wrong["metadata_v3/voxel_volume"][()] *= scale**3
        for name in ("pose_mastoidectomy_drill", "pose_mastoidectomy_volume"):
            wrong[DATA + name][:, :3] *= scale
    back, wanted = burrlab.read_volumetric_drilling(file), burrlab.read_volumetric_drilling(good)
    player, seen = RecordingPlayer(back, bone), RecordingPlayer(wanted, right)
    np.testing.assert_allclose(player.burrs.centers, seen.burrs.centers, rtol=1e-12)
    assert f"; lengths are divided by {scale:g}, by which its recorder multiplied them" in player.note
    assert "divided" not in seen.note
    with pytest.warns(UserWarning, match=f"a.hdf5: lengths are divided by {scale:g}, by which its recorder"):
        found = back.device(bone).path
    np.testing.assert_allclose(found, wanted.device(right).path, rtol=1e-12)
    told = said(capsys, "metrics", file)
    assert "if its recorder multiplied lengths (docs/trace.md), scale=0.0492027 (--scale) divides" in told
    assert said(capsys, "metrics", file, "--scale", scale) == said(capsys, "metrics", good)
    assert "--scale goes with a recording" in said(
        capsys, "view", "--bone", "x.h5", "--scale", scale, status=2
    )
    again = burrlab.read_volumetric_drilling(file, scale=scale)
    np.testing.assert_allclose(again.volume_pose, wanted.volume_pose, rtol=1e-12)
    other = burrlab.VoxelBone.block((8, 8, 8), 0.25)
    fits = f"multiplied lengths, scale={2 * scale:.6g} .--scale. would fit"
    refused(
        (lambda: back.removed_from(other), fits), (lambda: back.device(other), fits),
        (lambda: burrlab.read_volumetric_drilling(file, scale=-1), "scale must be positive and finite, got -1"),
    )  # fmt: skip


def test_a_recording_is_seen_at_any_time(made, tmp_path):
    trace, whole = made[1], made[1].bone()
    burrlab.export_volumetric_drilling(trace, tmp_path / "out.hdf5")
    back = burrlab.read_volumetric_drilling(tmp_path / "out.hdf5")
    late = np.full(50, back.removed_time[-1])  # voxels that are removed once more
    back = replace(
        back, removed=np.vstack([back.removed, back.removed[:50]]), removed_time=np.append(back.removed_time, late),
        burr_time=np.array([0.0, 1.0]), burr_radius=np.array([2.0, 3.0]),
    )  # fmt: skip
    player, ours = RecordingPlayer(back, whole, trace.source), TracePlayer(trace)
    times = (
        1.5005,
        0.2005,
        player.duration,
        back.removed_time[100],
        0.0,
        *np.random.default_rng(1).uniform(0, 2, 20),
    )
    for at in times:
        before = player.bone.density.copy()
        bricks = player.seek(at)
        assert player.bone.digest() == back.drilled(whole, trace.source, until=at).digest()
        found = brick_numbers(np.argwhere(player.bone.density != before) // 8, whole)
        assert bricks.tolist() == np.unique(found).tolist()
        ours.seek(min(at, ours.duration))
        np.testing.assert_allclose(player.burrs.centers[0], ours.burrs.centers[0], atol=1e-9)
        assert player.burrs.radii == (2.0 if at < 1.0 else 3.0)
        if ours.done:
            np.testing.assert_array_equal(player.force[0], trace.array("sent_force_N", 0)[ours.done - 1])
    page = make_page(page_source(player))
    page._advance(1.0)
    assert [row["name"] for row in page.state.numbers] == ["force", "burr", "centre", "bone removed"]
    assert [chart["name"] for chart in page.state.charts] == ["force"]
    refused(
        (lambda: player.seek(3.0), "from 0 to 2.0"), (lambda: RecordingPlayer(trace, whole), "must be a Dril", TypeError),
        (lambda: page_source(player, Effects(whole, seed=1)), "with a recording", (ValueError, TypeError)),
    )  # fmt: skip


def test_what_was_not_recorded_is_not_shown(tmp_path):
    bone = burrlab.VoxelBone.block((8, 8, 8), 0.5)
    back = burrlab.read_volumetric_drilling(made_up(tmp_path / "a.hdf5", "new"))
    page = make_page(page_source(RecordingPlayer(back, bone)))
    page.look("burr")
    assert ([row["name"] for row in page.state.numbers], page.state.charts) == (["centre", "bone removed"], [])  # fmt: skip
    assert (page.scene.move_burrs.call_args.args[1], np.isnan(page.scene.radii).all()) == (None, True)
    assert page.state.source_state.endswith("penetration, whether the burr turned, its radius, force")
    bare = RecordingPlayer(replace(back, volume_pose=None, removed=None, removed_time=None), bone)
    assert "removed voxels, the burr's place, its radius" in bare.note
    assert len(bare.seek(bare.duration)) == 0
    assert (np.isnan(bare.burrs.centers).all(), trace_approach(bare)) == (True, None)
    bone.restore(np.zeros(bone.shape, np.uint8))
    assert RecordingPlayer(back, bone).note.endswith("; 3 of 3 removed voxels are empty in this bone")


def test_the_files_of_one_session(tmp_path, capsys):
    first = made_up(tmp_path / "20250101_120000.hdf5", "new")
    second = made_up(tmp_path / "20250101_120002.hdf5", "new", start=1.7e9 + 2)
    last = made_up(tmp_path / "20250101_120004.hdf5", "new", start=1.7e9 + 4, poses=10)  # removed nothing
    assert "removed [mm^3]                                     0.75" in said(capsys, "metrics", tmp_path)
    assert "--target goes with a trace" in said(capsys, "metrics", first, "--target", last, status=2)
    for given in (tmp_path, [first, second, last]):
        back = burrlab.read_volumetric_drilling(given)
        np.testing.assert_allclose(back.time, 0.02 * np.arange(210), atol=1e-6)
        np.testing.assert_allclose(back.removed_time, [1, 1, 1.2, 3, 3, 3.2], atol=1e-6)
    made_up(tmp_path / "20250101_120004.hdf5", "old")
    read = burrlab.read_volumetric_drilling
    refused(
        (lambda: read([second, first]), "the times of its poses go back"),
        (lambda: read(tmp_path), "path must hold files of one layout, got new, old"),
        (lambda: read([]), "path must hold files"),
    )


@pytest.mark.parametrize(
    ("dataset", "value", "told"),
    [
        (DATA + "time", None, f"it has no dataset {DATA}time"),
        (DATA + "pose_mastoidectomy_drill", None, "holds no pose of mastoidectomy_drill"),
        (DATA + "pose_mastoidectomy_drill", np.ones((100, 6)), "pose_mastoidectomy_drill has the shape \\(100, 6\\)"),
        (DATA + "pose_mastoidectomy_drill", np.ones((100, 7)), "holds a quaternion not of length 1"),
        (DATA + "pose_mastoidectomy_drill", np.eye(7)[[6] * 9], "has 9 rows for 100 times"),
        (DATA + "time", np.full(100, np.nan), "time holds a number that is not finite"),
        (DATA + "time", -np.arange(100.0), "the times of its poses go back"),
        (DATA + "time", np.array([b"noon"] * 100), "time must hold numbers, got"),
        (GONE + "voxel_time_stamp", np.ones(1), "must hold one of 1 groups"),
        (GONE + "voxel_color", np.zeros((2, 5)), "voxel_removed and voxel_color are of other groups"),
        (GONE + "voxel_color", np.full((3, 5), [[0.0], [0], [1]]) - [0, 9, 0, 0, 0], "must lie from 0 to 255"),
        ("metadata_v3/README", "Positions are in millimetres.", "in other units: metadata_v3/README must be in m"),
        ("metadata_v3/voxel_volume", -1.0, "its voxels have a volume of -1.0 mm"),
    ],
)  # fmt: skip
def test_a_recording_that_is_refused(tmp_path, dataset, value, told):
    path = made_up(tmp_path / "bad.hdf5", "new")
    with h5py.File(path, "a") as file:
        del file[dataset]
        if value is not None:
            file[dataset] = value
    refused((lambda: burrlab.read_volumetric_drilling(path), f"bad.hdf5 is .*{told}"))


def test_a_file_or_a_bone_that_is_refused(made, tmp_path):
    path = made_up(tmp_path / "bad.hdf5", "new")
    with h5py.File(path, "a") as file:
        file[DATA + "pose_mastoidectomy_drill"].attrs["units"] = "mm"
    back = burrlab.read_volumetric_drilling(made_up(tmp_path / "good.hdf5", "old"))
    block = burrlab.VoxelBone.block
    refused(
        (lambda: burrlab.read_volumetric_drilling(path), "is in other units: .*drill must be in m, says 'mm'"),
        (lambda: burrlab.read_volumetric_drilling(made[1].path), "is not a recording of .*no group of its layouts"),
        (lambda: burrlab.read_volumetric_drilling(__file__), "is not a recording of .*not an HDF5 file"),
        (lambda: back.removed_from(block((4, 4, 4), 0.4)), "bone must have voxels of 0.125 mm"),
        (lambda: back.removed_from(block((3, 3, 3), 0.5)), "3 of 3 removed voxels lie outside"),
        (lambda: burrlab.session_metrics(back, burr=1), "burr must be an index below 1, got 1"),
    )  # fmt: skip
    path.write_bytes(path.read_bytes()[:-3000])
    refused((lambda: burrlab.read_volumetric_drilling(path), r"bad\.hdf5 is damaged: it was cut short"))
    with h5py.File(tmp_path / "good.hdf5", "a") as file:
        del file["voxels_removed"], file["data/pose_mastoidectomy_volume"], file["metadata/voxel_volume"]
    bare = burrlab.read_volumetric_drilling(tmp_path / "good.hdf5")
    assert bare.removed_volume is None
    assert np.isnan(burrlab.session_metrics(bare).removed)
    refused(
        (lambda: bare.removed_from(block((3, 3, 3), 0.5)), "holds no removed voxels"),
        (lambda: bare.device(block((3, 3, 3), 0.5)), "holds no pose of the volume"),
    )
