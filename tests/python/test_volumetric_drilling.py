"""The export against the layout that volumetric_drilling documents and records."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import said
from label_scenes import coloured
from PIL import Image
from session_scenes import SEED, FakeReader, make_records, small_bone, tools

import burrlab
from burrlab.bone.recipe import LabelledRecipe
from burrlab.bone.tissues import default_tissues
from burrlab.session.exchange import _NEW

TICKS = 2005
NEW = "physics_data/intermittent_data/voxels_removed/"


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
    burrlab.TraceWriter(
        folder / "session.h5", FakeReader(records), small_bone(), tools(2), seed=SEED, first_tick=10
    ).stop()
    trace = burrlab.load_trace(folder / "session.h5")
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
    pose = file["high_frequency_poses/mastoidectomy_drill/pose"]
    np.testing.assert_allclose(pose[:, :3] * 1000, records["burr"]["center"][:, 0], rtol=1e-14)
    np.testing.assert_array_equal(pose[:, 3:], records["burr"]["orientation"][:, 0, [1, 2, 3, 0]])
    wrench = file["drill_force_feedback/wrench"]
    np.testing.assert_array_equal(wrench[:, :3], records["burr"]["sent"][:, 0])
    assert not wrench[:, 3:].any()
    np.testing.assert_array_equal(file["data/pose_mastoidectomy_drill"], pose[::20])
    since = file["drill_force_feedback/time_stamp"] - trace.provenance["started_unix_s"]
    np.testing.assert_allclose(since, np.cumsum(records["k"]) / 1000, atol=1e-6)
    assert file["burr_change/burr_size"].tolist() == [4]
    assert file["metadata/voxel_volume"] == pytest.approx(0.008)
    np.testing.assert_allclose(file["data/pose_mastoidectomy_volume"][0, :3], [0.0, 0.0, -0.002], atol=1e-9)


def test_the_voxels_are_those_that_lost_half_of_their_bone(made):
    file, trace, _, bone = made
    rows = file["voxels_removed/voxel_removed"].astype(int)
    assert len(np.unique(rows[:, 1:], axis=0)) == len(rows)
    gone, before, at = np.zeros(bone.shape, dtype=bool), trace.bone().density, tuple(rows[:, :0:-1].T)
    gone[at] = True
    np.testing.assert_array_equal(gone, 2 * bone.density.astype(int) < before)
    stamps = file["voxels_removed/voxel_time_stamp"]
    assert (np.diff(stamps) > 0).all()
    assert np.unique(rows[:, 0]).tolist() == list(range(len(stamps)))
    color = file["voxels_removed/voxel_color"]
    np.testing.assert_array_equal(color[:, 0], rows[:, 0])
    np.testing.assert_array_equal(color[:, 1], before[at])
    assert (color[:, 4] == 255).all()


def test_an_interrupted_export_leaves_no_file(made, tmp_path):
    def stop(done: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        burrlab.export_volumetric_drilling(made[1], tmp_path / "export.hdf5", progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_a_session_that_removed_nothing(tmp_path):
    file = tmp_path / "session.h5"
    burrlab.TraceWriter(file, FakeReader(), small_bone(), tools(), seed=1).stop()
    burrlab.export_volumetric_drilling(burrlab.load_trace(file), tmp_path / "export.hdf5", layout="old")
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
    said(capsys, "export", trace.path, "--out", f"{out}.old", "--old")
    with h5py.File(f"{out}.old") as file:
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
    burr, device = burrlab.Burr(1.7), burrlab.ScriptedDevice(at, path)
    with burrlab.Session(
        bone, (burr, burrlab.materials["bone"]), device, seed=1, duration=0.5, wall_clock=False,
        record=tmp_path / "s.h5", source=source,
    ) as session:  # fmt: skip
        session.wait()
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
