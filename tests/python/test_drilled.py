"""Half-drilled volumes: values, fields and exact state of every format, refusals, and a killed writer."""

import os
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drilled_scenes import MAKERS, MAP, SHAPE, drilled, greys, kept, nifti, nrrd, stack
from session_scenes import refused

from burrlab import Burr, OccupancyMap, Volume, erode, materials, save_bone
from burrlab.bone.formats import header_reader, read_volume, write_volume
from burrlab.bone.kept import check_drilled, grey_of_levels, load_drilled, save_drilled
from burrlab.volume import DrilledRecipe, VolumeRecipe, read_stack, write_dicom

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
pynrrd = pytest.importorskip("nrrd", reason="an independent reader, extra `dev`")
nibabel = pytest.importorskip("nibabel", reason="an independent reader, extra `dev`")
from test_volume_formats import independently  # noqa: E402


@pytest.fixture
def volume(tmp_path: Path) -> Volume:
    return read_volume(nrrd(tmp_path / "a.nrrd", greys()))


@pytest.mark.parametrize("name", MAKERS)
def test_header_values_and_state(tmp_path: Path, name: str) -> None:
    original = MAKERS[name](tmp_path / name)
    volume = read_volume(original)
    saved = tmp_path / f"saved{''.join(Path(name).suffixes)}"
    bone, again, loaded = kept(saved, volume, tick=40)
    for one in ("spacing", "origin", "direction"):
        np.testing.assert_array_equal(getattr(again, one), getattr(volume, one))
    assert again.values.dtype == volume.values.dtype
    assert (again.values <= volume.values).all()
    assert (again.values[(bone.density == 0) & (bone.pristine > 0)] == 200).all()
    # By the map, the new grey values of the other voxels give what is left of them, within rounding.
    assert (
        np.abs(MAP.levels(again.values).astype(int) - bone.density)[bone.density < bone.pristine].max() <= 1
    )
    assert loaded.source == str(original)
    assert loaded.bone.removed_of("facial nerve") == bone.removed_of("facial nerve") > 0
    fields, told = (header_reader(path.name)(str(path))[0].fields for path in (saved, original))
    assert fields == told
    assert "nii" in name or told["Patient"] == "phantom 7"
    np.testing.assert_array_equal(independently(saved)[0], again.values)
    if "nrrd" in name:
        assert pynrrd.read_header(str(saved))["Patient"] == "phantom 7"
    if "nii" in name:
        assert nibabel.load(saved).header["descrip"].item().startswith(b"described as it please")


def test_what_has_no_header_of_its_own_gets_one(tmp_path: Path, volume: Volume) -> None:
    """Crops, other spacings and other endings (so DICOM too) keep the geometry, not the header's fields."""
    for like, name in (
        (volume.crop_voxels((2, 2, 2), (13, 15, 17)), "b.nrrd"),
        (volume.resample(0.25), "c.nrrd"),
        (volume, "d.nii.gz"),
        (volume, "e.mha"),
    ):
        _, again, _ = kept(tmp_path / name, like)
        assert again.values.dtype == like.values.dtype


def test_drilling_goes_on_from_a_saved_volume(tmp_path: Path, volume: Volume) -> None:
    path = tmp_path / "b.nrrd"
    once, _, loaded = kept(path, volume, tick=40)
    later = loaded.bone
    erode(later, Burr(2.0), np.array(later.origin) + (4, 4, 4), materials["bone"], dt=1.0, seed=1, tick=40)
    assert later.digest() != once.digest()
    save_drilled(path, later, read_volume(path), mapping=loaded.mapping, tick=41)
    assert (load_drilled(path).bone.digest(), load_drilled(path).tick) == (later.digest(), 41)
    assert len(list(tmp_path.glob("b.nrrd.*.bone.h5"))) == 1
    save_drilled(tmp_path / "c.nrrd", later, volume, mapping=MAP, tick=41)
    assert (tmp_path / "c.nrrd").read_bytes() == path.read_bytes()
    refused(
        (lambda: save_drilled(tmp_path / "d.nrrd", volume.to_bone(MAP), read_volume(path), mapping=MAP),
         r"like must be the original: .*b.nrrd is half-drilled, and \d+ voxels"),
    )  # fmt: skip


def test_a_changed_or_missing_part_is_found(tmp_path: Path, volume: Volume) -> None:
    path = tmp_path / "b.nrrd"
    kept(path, volume)
    refused(
        (lambda: load_drilled(tmp_path / "a.nrrd"),
         r"a.nrrd: the exact state, a.nrrd\.\w+\.bone.h5, must lie beside it, and there is none"),
        (lambda: load_drilled(tmp_path / "none.nrrd"), r"none.nrrd: no such file or folder", FileNotFoundError),
    )  # fmt: skip
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    refused((lambda: load_drilled(path), r"there is b.nrrd\.\w+\.bone.h5, of another content of it"))
    path.write_bytes(content)
    [beside] = tmp_path.glob("b.nrrd.*.bone.h5")
    save_drilled(tmp_path / "c.nrrd", volume.to_bone(MAP), volume, mapping=MAP)
    [other] = tmp_path.glob("c.nrrd.*.bone.h5")
    beside.write_bytes(other.read_bytes())
    refused((lambda: load_drilled(path), "belongs to another content of it: one of them was changed"))
    beside.unlink()
    save_bone(beside, volume.to_bone(MAP))
    refused((lambda: load_drilled(path), "is a bone, but not one of a drilled volume"))


class Dies(BaseException):
    """Error that no handler of errors catches."""


@pytest.mark.parametrize("name", ["b.nrrd", "b"])
def test_killed_in_the_middle_there_is_the_old_pair_or_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, volume: Volume
) -> None:
    """The process ends at each of its calls of fsync, replace, rename and unlink in turn."""
    if name == "b":
        volume = read_stack(stack(tmp_path / "s", greys("u2")), spacing=(0.3, 0.4, 0.5))
    old, new = volume.to_bone(MAP), drilled(volume)
    path, last, calls = tmp_path / name, [0], [0]

    def dying(real: Any) -> Any:
        def call(*arguments: Any, **options: Any) -> Any:
            calls[0] += 1
            if calls[0] == last[0]:
                raise Dies
            return real(*arguments, **options) if calls[0] < last[0] else None  # a dead process does nothing

        return call

    def run(at: int) -> None:
        last[0], calls[0] = at, 0
        with monkeypatch.context() as patch:
            for module, what in ((os, "fsync"), (os, "rename"), (os, "replace"), (os, "unlink")):
                patch.setattr(module, what, dying(getattr(module, what)))
            patch.setattr(
                "shutil.rmtree", lambda *a, **k: None if calls[0] >= last[0] else real_rmtree(*a, **k)
            )
            save_drilled(path, new, volume, mapping=MAP)

    real_rmtree = shutil.rmtree
    run(10**6)
    steps, seen = calls[0], set()
    assert steps >= 3
    for at in range(1, steps + 1):
        for other in tmp_path.glob("*b*"):
            shutil.rmtree(other) if other.is_dir() else other.unlink()
        if name != "b":  # the folder of a stack must be new
            save_drilled(path, old, volume, mapping=MAP)
        with pytest.raises(Dies):
            run(at)
        if name == "b" and not path.exists():
            seen.add("nothing")
            continue
        seen.add(load_drilled(path).bone.digest())
        save_drilled(tmp_path / f"after_{name}", new, volume, mapping=MAP)
    assert seen <= {old.digest(), new.digest(), "nothing"}
    assert len(seen) >= (1 if name == "b" else 2)


def test_the_map_turned_round() -> None:
    np.testing.assert_allclose(grey_of_levels(MAP), 200 + 1000 * np.arange(256) / 255)
    table = OccupancyMap.table((-500, 0, 100, 300, 400), (0, 0, 0.5, 0.5, 1))
    found = grey_of_levels(table)
    assert (found[0], found[255]) == (0, 400)
    assert np.all(np.diff(found) > 0)
    inside = [i for i in range(256) if i != 128]  # 128 is the plateau
    np.testing.assert_array_equal(table.levels(found)[inside], inside)
    rule = "map must rise from 0 with the grey value"
    refused(
        (lambda: grey_of_levels(OccupancyMap.table((0, 1, 2), (0, 1, 0.5))), rule),
        (lambda: grey_of_levels(OccupancyMap.table((0, 1), (0.1, 1))), rule),
    )


def test_another_volume_under_the_name_of_a_half_drilled_one_is_not_replaced(
    tmp_path: Path, volume: Volume, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A half-drilled volume is, also one of the same content, whose exact state stays."""
    monkeypatch.chdir(tmp_path)
    for tick in (1, 2):
        bone, *_ = kept(Path("b.nrrd"), volume, tick)
    other = nrrd(tmp_path / "b.nrrd", greys() + np.int16(1)).read_bytes()
    refused(
        (lambda: save_drilled(tmp_path / "b.nrrd", bone, volume, mapping=MAP),
         r"path must be a new file or one of save_drilled, .*b\.nrrd is neither", FileExistsError),
    )  # fmt: skip
    assert (tmp_path / "b.nrrd").read_bytes() == other
    (state,) = tmp_path.glob("b.nrrd.*.bone.h5")
    state.rename(tmp_path / state.name.replace("b.nrrd", "a.nrrd"))
    refused(
        (lambda: save_drilled(tmp_path / "a.nrrd", bone, volume, mapping=MAP),
         "path must be another file than the original"),
    )  # fmt: skip


def test_bad_saves_are_refused(tmp_path: Path, volume: Volume) -> None:
    before = (tmp_path / "a.nrrd").read_bytes()
    (tmp_path / "mine.nrrd").write_text("something else")
    grid = (0.3, 0.4, 0.5), (0, 0, 0), np.eye(3)
    small, real = Volume(np.full(SHAPE, 200, np.uint8), *grid, "small"), Volume(greys("f4"), *grid, "real")
    below, far = OccupancyMap.two_point(-100, 180), OccupancyMap.two_point(-1e300, 1200)
    other = volume.crop_voxels((0, 0, 0), (5, 5, 5)).to_bone(MAP)
    for kind, match, path, changed in (
        (ValueError,
         "mapping must be given: that with which the bone was made of", "b.nrrd", {"mapping": None}),
        (ValueError, "tick must be a whole number", "b.nrrd", {"tick": -1}),
        (ValueError, "path must be another file than the original", "a.nrrd", {}),
        (ValueError, r"path must end in .nrrd, .nii, .nii.gz or .mha, got .*b.txt", "b.txt", {}),
        (FileNotFoundError, "folder must exist", "none/b.nrrd", {}),
        (ValueError, "name of at most 225 bytes, .*, got 226", "x" * 221 + ".nrrd", {}),
        (FileExistsError, r"path must be a new file or one of save_drilled, .*mine.nrrd is neither", "mine.nrrd", {}),
        (ValueError, "the bone and .* must have the same geometry: 5 x 5 x 5 voxels against", "b.nrrd", {"bone": other}),
        (ValueError, "map must rise from 0", "b.nrrd", {"mapping": OccupancyMap.table((0, 1, 2), (0, 1, 0))}),
        (ValueError,
         "map must have a grey value of empty that small can hold, .*: it holds uint8, got -100", "b.nrrd",
         {"bone": small.to_bone(below), "like": small, "mapping": below}),
        (ValueError, "it holds float32, got -1e", "b.nrrd", {"bone": real.to_bone(far), "like": real, "mapping": far}),
    ):  # fmt: skip
        options: dict[str, Any] = {"bone": volume.to_bone(MAP), "like": volume, "mapping": MAP, **changed}
        refused((partial(save_drilled, tmp_path / path, **options), match, kind))
    assert (tmp_path / "a.nrrd").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.nrrd", "mine.nrrd"]


@pytest.mark.parametrize("slope", [1.0, -1.0])
def test_what_was_removed_is_empty_after_rounding(tmp_path: Path, slope: float) -> None:
    """With this steep map, an empty voxel whose grey value is rounded to nearest would be half full."""
    volume = read_volume(
        nifti(tmp_path / "a.nii", (np.full(SHAPE, 30, "i2") * slope).astype("i2"), slope=slope)
    )
    steep = OccupancyMap.two_point(10.6, 11.2)
    bone = volume.to_bone(steep)
    density = bone.density.copy()
    density[3:5] = 0
    bone.restore(density)
    save_drilled(tmp_path / "b.nii", bone, volume, mapping=steep)
    np.testing.assert_array_equal(steep.levels(read_volume(tmp_path / "b.nii").values), density)


def test_links_and_dots(tmp_path: Path, volume: Volume, monkeypatch: pytest.MonkeyPatch) -> None:
    """Links are followed in reading and writing; `..` after a link is resolved as by the system."""
    (tmp_path / "far" / "away").mkdir(parents=True)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    os.symlink("../far/away", "door")
    bone, whole = drilled(volume), volume.to_bone(MAP)
    os.symlink("door/../b.nrrd", "link.nrrd")  # far/b.nrrd
    for state in (whole, bone):
        save_drilled("link.nrrd", state, volume, mapping=MAP)
        assert Path("link.nrrd").is_symlink()
        assert len(list((tmp_path / "far").glob("b.nrrd.*.bone.h5"))) == 1
        for path in ("link.nrrd", "door/../b.nrrd", tmp_path / "far" / "b.nrrd"):
            assert load_drilled(path).bone.digest() == state.digest()
            assert DrilledRecipe(os.fspath(path)).bone().digest() == state.digest()
    assert sorted(os.listdir()) == ["door", "link.nrrd"]
    half = read_volume("link.nrrd")
    refused((lambda: save_drilled("c.nrrd", whole, half, mapping=MAP), "like must be the original"))
    save_drilled("link.nrrd", bone, half, mapping=MAP, tick=3)
    assert load_drilled("link.nrrd").tick == 3
    for file in (tmp_path / "far").glob("b.nrrd*"):  # as programs do that link each large file
        os.symlink(file, file.name.replace("b.nrrd", "d.nrrd"))
    assert load_drilled("d.nrrd").bone.digest() == bone.digest()
    os.symlink(tmp_path / "a.nrrd", "original.nrrd")
    refused(
        (lambda: save_drilled("original.nrrd", bone, volume, mapping=MAP),
         "path must be another file than the original"),
    )  # fmt: skip
    assert VolumeRecipe("door/../../a.nrrd", MAP).path == os.fspath(tmp_path / "a.nrrd")


def test_a_folder_that_is_not_writable(
    tmp_path: Path, volume: Volume, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No file is left or changed."""
    (tmp_path / "shut").mkdir()
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    rule = r"folder must be writable, got .*shut"
    refused(
        (lambda: check_drilled(tmp_path / "shut" / "b.nrrd", volume, MAP), rule),
        (lambda: save_drilled(tmp_path / "shut" / "b.nrrd", volume.to_bone(MAP), volume, mapping=MAP), rule),
        (lambda: write_volume(tmp_path / "shut" / "b.nii", volume), rule),
        (lambda: write_dicom(tmp_path / "shut" / "b", volume), rule),
        error=PermissionError,
    )
    assert os.listdir(tmp_path / "shut") == []


def test_the_longest_name(tmp_path: Path, volume: Volume) -> None:
    for name in (f"{'ü' * 110}.nrrd", f"{'x' * 218}.nii.gz"):
        kept(tmp_path / name, volume)
