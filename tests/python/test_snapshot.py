"""A bone and its tick index in a file."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from session_scenes import make_records, small_bone, tools

import burrlab
import burrlab._core as _core
import burrlab.common.files as files


def test_levels_geometry_and_tick_come_back(tmp_path):
    bone = small_bone()
    burrlab.save_bone(tmp_path / "bone.h5", bone, 2**63 + 5, source="a block")
    again, tick = burrlab.load_bone(tmp_path / "bone.h5")
    assert tick == 2**63 + 5
    assert again.digest() == bone.digest()
    np.testing.assert_array_equal(again.density, bone.density)
    np.testing.assert_array_equal(again.pristine, bone.pristine)
    assert (again.spacing, again.origin) == (bone.spacing, bone.origin)
    assert (again.density < again.pristine).any()
    assert [p.name for p in tmp_path.iterdir()] == ["bone.h5"]


def test_pristine_levels_are_kept_only_where_they_differ(tmp_path):
    bone = burrlab.VoxelBone.block((2, 2, 2), 0.1)
    burrlab.save_bone(tmp_path / "bone.h5", bone)
    with h5py.File(tmp_path / "bone.h5") as file:
        assert "pristine" not in file
    assert burrlab.load_bone(tmp_path / "bone.h5")[0].digest() == bone.digest()


def test_a_session_goes_on_from_a_snapshot(tmp_path):
    whole = small_bone()
    records = make_records(whole, 400)
    half = small_bone()
    executor = _core.TickExecutor(half, tools(), 7)
    executor.execute(records[:200])
    burrlab.save_bone(tmp_path / "bone.h5", half, executor.tick)
    bone, tick = burrlab.load_bone(tmp_path / "bone.h5")
    rest = _core.TickExecutor(bone, tools(), 7, tick=tick).execute(records[200:])
    np.testing.assert_array_equal(rest["burr"]["force"], records["burr"]["force"][200:])
    assert bone.digest() == whole.digest()


def test_a_failed_save_leaves_the_older_file(tmp_path, monkeypatch):
    bone = small_bone()
    burrlab.save_bone(tmp_path / "bone.h5", bone, 1)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("burrlab.bone.snapshot.os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        burrlab.save_bone(tmp_path / "bone.h5", bone, 2)
    assert burrlab.load_bone(tmp_path / "bone.h5")[1] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["bone.h5"]


@pytest.mark.parametrize("tick", [-1, 2**64])
def test_tick_out_of_range(tmp_path, tick):
    with pytest.raises(ValueError, match="tick must be a whole number from 0 and below 2\\^64"):
        burrlab.save_bone(tmp_path / "bone.h5", small_bone(), tick)


def test_what_is_no_bone(tmp_path):
    file = tmp_path / "bone.h5"
    with pytest.raises(FileNotFoundError):
        burrlab.load_bone(file)
    file.write_text("no HDF5")
    with pytest.raises(ValueError, match="is not a burrlab bone: not an HDF5 file"):
        burrlab.load_bone(file)
    with h5py.File(file, "w") as made:
        made.attrs["format"] = "something"
    with pytest.raises(ValueError, match=r"is not a burrlab bone$"):
        burrlab.load_bone(file)


def test_a_newer_format(tmp_path):
    burrlab.save_bone(tmp_path / "bone.h5", small_bone())
    with h5py.File(tmp_path / "bone.h5", "a") as file:
        file.attrs["format_version"] = 3
    with pytest.raises(ValueError, match="of format 3, and this version reads up to 2"):
        burrlab.load_bone(tmp_path / "bone.h5")


def change_a_voxel(file):
    file["density"][0, 0, 0] -= 1


def raise_a_voxel(file):
    file["pristine"][0, 0, 0] = 0


def lose_a_table(file):
    del file["density"]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (change_a_voxel, "is damaged: the bone has digest"), (lose_a_table, "is damaged"),
        (raise_a_voxel, "density must be at most the pristine level"),
    ],
)  # fmt: skip
def test_damage_is_found(tmp_path, damage, said):
    burrlab.save_bone(tmp_path / "bone.h5", small_bone())
    with h5py.File(tmp_path / "bone.h5", "a") as file:
        damage(file)
    with pytest.raises(ValueError, match=said):
        burrlab.load_bone(tmp_path / "bone.h5")


def test_a_file_cut_short(tmp_path):
    file = tmp_path / "bone.h5"
    burrlab.save_bone(file, small_bone())
    file.write_bytes(file.read_bytes()[:-1000])
    with pytest.raises(ValueError, match="is damaged: it was cut short"):
        burrlab.load_bone(file)


def test_restore_sets_present_levels_only():
    bone, worn = small_bone(), small_bone()
    bone.reset()
    bone.restore(worn.density)
    assert bone.digest() == worn.digest()
    with pytest.raises(ValueError, match="density must have the shape of the bone"):
        bone.restore(worn.density[1:])
    with pytest.raises(ValueError, match="density must be at most the pristine level, got 255 over 254"):
        burrlab.VoxelBone.block((1, 1, 1), 0.1, level=254).restore(np.full((10, 10, 10), 255, np.uint8))


def test_only_a_bone_is_replaced(tmp_path):
    """The name of a trace, given by mistake, does not cost the trace."""
    file = tmp_path / "bone.h5"
    for tick in (1, 2):
        burrlab.save_bone(file, small_bone(), tick)
    assert burrlab.load_bone(file)[1] == 2
    trace = tmp_path / "session.h5"
    with h5py.File(trace, "w") as made:
        made.attrs["format"] = "burrlab trace"
    with pytest.raises(FileExistsError, match="path must be a new file or a burrlab bone"):
        burrlab.save_bone(trace, small_bone())
    with h5py.File(trace) as kept:
        assert kept.attrs["format"] == "burrlab trace"


def test_a_tick_is_a_whole_number(tmp_path):
    with pytest.raises(TypeError, match="integer"):
        burrlab.save_bone(tmp_path / "bone.h5", small_bone(), 1.5)
    with pytest.raises(FileNotFoundError, match=r"folder must exist, got .*nowhere"):
        burrlab.save_bone(tmp_path / "nowhere" / "bone.h5", small_bone())
    burrlab.save_bone(tmp_path / "bone.h5", small_bone(), np.int64(7))
    assert burrlab.load_bone(tmp_path / "bone.h5")[1] == 7


def test_no_link_is_followed_and_two_writers_share_nothing(tmp_path):
    """Under the names that parts of files had, and that a folder's part has."""
    victim, folder = tmp_path / "victim", tmp_path / "folder"
    folder.mkdir()
    for file in (victim, folder / "its"):
        file.write_text("mine")
    for name, target in (("a.h5.part", victim), (".b.nrrd.part", victim), (".kept.part", folder)):
        (tmp_path / name).symlink_to(target)
    burrlab.save_bone(tmp_path / "a.h5", burrlab.VoxelBone.block((1, 1, 1), 0.1))
    with files.new_part(tmp_path / "b.nrrd") as part:
        part.replace(tmp_path / "b.nrrd")
    with pytest.raises(OSError, match="symbolic links"), files.new_folder(tmp_path / "kept"):
        pass
    assert victim.read_text() == (folder / "its").read_text() == "mine"
    with files.new_part(tmp_path / "a.h5") as one, files.new_part(tmp_path / "a.h5") as other:
        assert one != other
    assert len([path for path in tmp_path.iterdir() if path.name.endswith(".part")]) == 3, "nothing is left"
