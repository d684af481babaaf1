"""Half-drilled volumes in unusual places: behind links, in folders that are not writable."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from drilled_scenes import MAP, drilled, greys, nrrd

from burrlab.bone.formats import read_volume, write_volume
from burrlab.bone.kept import check_drilled, load_drilled, save_drilled
from burrlab.bone.recipe import DrilledRecipe, VolumeRecipe
from burrlab.volume import write_dicom


def test_links_and_dots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link is followed, on reading and on writing; `..` after one goes where the system takes it."""
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    (tmp_path / "far" / "away").mkdir(parents=True)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    os.symlink("../far/away", "door")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
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
    with pytest.raises(ValueError, match="like must be the original"):
        save_drilled("c.nrrd", whole, read_volume("link.nrrd"), mapping=MAP)
    save_drilled("link.nrrd", bone, read_volume("link.nrrd"), mapping=MAP, tick=3)
    assert load_drilled("link.nrrd").tick == 3
    for file in (tmp_path / "far").glob(
        "b.nrrd*"
    ):  # as programs that keep large files elsewhere do: a link for each
        os.symlink(file, file.name.replace("b.nrrd", "d.nrrd"))
    assert load_drilled("d.nrrd").bone.digest() == bone.digest()
    os.symlink(tmp_path / "a.nrrd", "original.nrrd")
    with pytest.raises(ValueError, match="path must be another file than the original"):
        save_drilled("original.nrrd", bone, volume, mapping=MAP)
    recipe = VolumeRecipe("door/../../a.nrrd", MAP)
    assert recipe.path == os.fspath(tmp_path / "a.nrrd")


def test_a_folder_that_is_not_writable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is left behind, and nothing is changed."""
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    (tmp_path / "shut").mkdir()
    bone = drilled(volume)
    monkeypatch.setattr(os, "access", lambda *_: False)  # the system asks nothing of root
    for write in (
        lambda: check_drilled(tmp_path / "shut" / "b.nrrd", volume, MAP),
        lambda: save_drilled(tmp_path / "shut" / "b.nrrd", bone, volume, mapping=MAP),
        lambda: write_volume(tmp_path / "shut" / "b.nii", volume),
        lambda: write_dicom(tmp_path / "shut" / "b", volume),
    ):
        with pytest.raises(PermissionError, match=r"folder must be writable, got .*shut"):
            write()
    assert os.listdir(tmp_path / "shut") == []


def test_the_longest_name(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    for name in (f"{'ü' * 110}.nrrd", f"{'x' * 218}.nii.gz"):
        save_drilled(tmp_path / name, drilled(volume), volume, mapping=MAP)
        assert load_drilled(tmp_path / name).tick == 0
