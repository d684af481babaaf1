"""Files of a bone and its tick index."""

from unittest.mock import Mock

import h5py
import numpy as np
import pytest
from session_scenes import refused, small_bone

import burrlab
import burrlab.common.files as files
from burrlab.bone.snapshot import bone_source


@pytest.mark.parametrize("name", ["bone.h5", "bone.burr"])
def test_levels_geometry_and_tick_come_back(tmp_path, name):
    bone = small_bone()
    for tick in (4, np.uint64(2**63 + 5)):  # the second replaces the first
        burrlab.save_bone(tmp_path / name, bone, tick, source='a "block" of wax\n')
    again, tick = burrlab.load_bone(tmp_path / name)
    assert bone_source(tmp_path / name) == 'a "block" of wax\n'
    assert (tick, again.digest()) == (2**63 + 5, bone.digest())
    np.testing.assert_array_equal((again.density, again.pristine), (bone.density, bone.pristine))
    assert (again.spacing, again.origin) == (bone.spacing, bone.origin)
    assert (again.density < again.pristine).any()
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_pristine_levels_are_kept_only_where_they_differ(tmp_path):
    bone = burrlab.VoxelBone.block((2, 2, 2), 0.1)
    burrlab.save_bone(tmp_path / "bone.h5", bone)
    with h5py.File(tmp_path / "bone.h5") as file:
        assert "pristine" not in file
    assert burrlab.load_bone(tmp_path / "bone.h5")[0].digest() == bone.digest()


@pytest.mark.parametrize(("law", "version"), [({}, 2), ({"rate_exponent": 0.5}, 3)])
def test_the_law_of_tissues_comes_back(tmp_path, law, version):
    """Versions before the exponents read format 2, the paper's law, and refuse another law."""
    wax, path = burrlab.Material("wax", c_e=2.0, alpha=0.1, **law), tmp_path / "bone.h5"
    bone = small_bone()
    bone.set_tissues(
        burrlab.Tissues([burrlab.Tissue("bone", label=1, c_e=2.0, alpha=0.1)], wax),
        np.zeros(bone.shape, np.uint8),
    )
    burrlab.save_bone(path, bone)
    assert burrlab.load_bone(path)[0].tissues.material == wax
    with h5py.File(path, "a") as file:
        text = file.attrs["tissues"].decode()
        assert (file.attrs["format_version"], "exponent" in text) == (version, version == 3)
        file.attrs["tissues"] = text.replace('"shape"', '"force_exponent": 0.5, "shape"')
    refused((lambda: burrlab.load_bone(path), rf"^{path} is damaged: force_exponent must be 1 to 8, got 0.5"))


def test_a_failed_save_leaves_the_older_file(tmp_path, monkeypatch):
    bone = small_bone()
    burrlab.save_bone(tmp_path / "bone.h5", bone, 1)
    full = Mock(side_effect=OSError(28, "No space left on device"))
    monkeypatch.setattr("burrlab.bone.snapshot.os.fsync", full)
    refused((lambda: burrlab.save_bone(tmp_path / "bone.h5", bone, 2), "No space left", OSError))
    assert burrlab.load_bone(tmp_path / "bone.h5")[1] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["bone.h5"]


def test_what_cannot_be_saved_or_restored(tmp_path):
    """A trace whose name is given by mistake is kept."""
    trace, bone = tmp_path / "session.h5", small_bone()
    thin = burrlab.VoxelBone.block((1, 1, 1), 0.1, level=254)
    with h5py.File(trace, "w") as made:
        made.attrs["format"] = "burrlab trace"
    save = burrlab.save_bone
    refused(
        (lambda: save(tmp_path / "bone.h5", bone, -1), r"tick must be a whole number from 0 and below 2\^64"),
        (lambda: save(tmp_path / "bone.h5", bone, 2**64), r"tick must be a whole number from 0 and below 2\^64"),
        (lambda: save(tmp_path / "bone.h5", bone, 1.5), "integer", TypeError),
        (lambda: save(tmp_path / "nowhere/bone.h5", bone, 1), "folder must exist, got .*nowhere", FileNotFoundError),
        (lambda: save(trace, bone, 1), "path must be a new file or a burrlab bone", FileExistsError),
        (lambda: save(bone, "bone.h5"), "bone must be a VoxelBone, such as", TypeError),
        (lambda: save(3.5, bone), "path must be the name of a file, got 3.5", TypeError),
        (lambda: bone.restore(bone.density[1:]), "density must have the shape of the bone"),
        (lambda: thin.restore(np.full((10, 10, 10), 255, np.uint8)),
         "density must be at most the pristine level, got 255 over 254"),
    )  # fmt: skip
    with h5py.File(trace) as kept:
        assert kept.attrs["format"] == "burrlab trace"


def attribute(name, value):
    return changed(lambda file: file.attrs.__setitem__(name, value))


def changed(change):
    """Damage that changes an open file."""

    def damage(path):
        with h5py.File(path, "a") as file:
            change(file)

    return damage


def voxel(table, level):
    """Damage that changes the first voxel's level."""

    def change(file):
        file[table][0, 0, 0] = level(int(file[table][0, 0, 0]))

    return changed(change)


def elsewhere(path):
    """Puts the levels into another file, whole; a pipe in its place would hang."""
    path.with_name("other.h5").write_bytes(path.read_bytes())
    with h5py.File(path, "a") as file:
        del file["density"]
        file["density"] = h5py.ExternalLink("other.h5", "density")


def nested(file):
    for _ in range(100):
        file = file.create_group("a")


@pytest.mark.parametrize(
    ("damage", "error", "said"),
    [
        (changed(nested), ValueError, "is damaged: its groups are nested too deeply"),
        (lambda path: path.unlink(), FileNotFoundError, "No such file"),
        (lambda path: path.write_text("no HDF5"), ValueError, "is not a burrlab bone: not an HDF5 file"),
        (lambda path: path.write_bytes(path.read_bytes()[:-1000]), ValueError, "is damaged: it was cut short"),
        (changed(lambda file: file.__delitem__("density")), ValueError, "is damaged"),
        (attribute("format", "something"), ValueError, r"is not a burrlab bone$"),
        (attribute("format_version", 4), ValueError, "of format 4, and this version reads up to 3"),
        (voxel("density", lambda level: level - 1), ValueError, "is damaged: the bone has digest"),
        (attribute("tick", -1), ValueError, "tick must be a whole number"), (attribute("tick", 1.5), ValueError, "tick must be a whole number"),
        (changed(lambda file: file.__setitem__("more", h5py.SoftLink("/density"))), ValueError, "its more is a link"),
        (elsewhere, ValueError, "its density is a link, and could lead to another file"),
        (voxel("pristine", lambda level: 0), ValueError, "density must be at most the pristine level"),
    ],
)  # fmt: skip
def test_what_is_no_bone(tmp_path, damage, error, said):
    burrlab.save_bone(tmp_path / "bone.h5", small_bone())
    damage(tmp_path / "bone.h5")
    refused((lambda: burrlab.load_bone(tmp_path / "bone.h5"), said, error))


def test_no_link_is_followed_and_two_writers_share_nothing(tmp_path):
    """Links have former names of parts of files."""
    (victim := tmp_path / "victim").write_text("mine")
    for name in ("a.h5.part", ".b.nrrd.part"):
        (tmp_path / name).symlink_to(victim)
    burrlab.save_bone(tmp_path / "a.h5", burrlab.VoxelBone.block((1, 1, 1), 0.1))
    with files.new_part(tmp_path / "b.nrrd") as part:
        part.replace(tmp_path / "b.nrrd")
    assert victim.read_text() == "mine"
    with files.new_part(tmp_path / "a.h5") as one, files.new_part(tmp_path / "a.h5") as other:
        assert one != other
    assert len([path for path in tmp_path.iterdir() if path.name.endswith(".part")]) == 2, "nothing is left"
