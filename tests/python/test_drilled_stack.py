"""Half-drilled stacks of PNG slices, grey and coloured."""

import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
from drilled_scenes import MAP, SHAPE, cut, drilled, greys, stack
from label_scenes import anatomy_bone
from PIL import Image
from session_scenes import refused

from burrlab.bone.slices import stack_slices
from burrlab.bone.tissues import VOLUMETRIC_DRILLING, default_tissues
from burrlab.volume import OccupancyMap, load_drilled, read_stack, save_drilled


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("kind", ["u1", "u2", "rgba"])
def test_grey_stacks(tmp_path: Path, kind: str, turned: bool) -> None:
    values = np.random.default_rng(6).integers(0, 250, SHAPE).astype("u2" if kind == "u2" else "u1")
    planes = values
    if kind == "rgba":
        planes = np.repeat(values[..., None], 4, axis=-1)
        planes[..., 3] = 255
    mapping, place = OccupancyMap.two_point(20, 200), {"spacing": (0.3, 0.4, 0.5), "transpose": turned}
    volume = read_stack(stack(tmp_path / "a", planes), **place)
    bone = volume.to_bone(mapping)
    cut(bone, np.s_[3:6, 4:8, 5:9], 3)
    save_drilled(tmp_path / "b", bone, volume, mapping=mapping, tick=3)
    again = read_stack(tmp_path / "b", **place)
    assert again.values.dtype == volume.values.dtype
    whole = bone.density == bone.pristine
    np.testing.assert_array_equal(again.values[whole], volume.values[whole])
    assert np.abs(mapping.levels(again.values).astype(int) - bone.density)[~whole].max() <= 1
    assert load_drilled(tmp_path / "b").bone.digest() == bone.digest()
    part = read_stack(
        str(tmp_path / "a/plane00[5-9].png"), **place
    )  # its numbers stay, as the folder is whole by itself
    save_drilled(tmp_path / "part", part.to_bone(mapping), part, mapping=mapping, tick=0)
    assert load_drilled(tmp_path / "part").bone.shape == part.shape
    with Image.open(tmp_path / "a/plane000.png") as old, Image.open(tmp_path / "b/plane000.png") as new:
        assert new.mode == old.mode


def test_grey_stacks_that_are_refused(tmp_path: Path) -> None:
    volume = read_stack(stack(tmp_path / "a", greys("u2"), name="P{:03d}.PNG"), spacing=(0.3, 0.4, 0.5))
    bone = drilled(volume)
    save_drilled(tmp_path / "b", bone, volume, mapping=MAP)
    load_drilled(tmp_path / "b")
    (tmp_path / "b" / "P003.PNG").write_bytes((tmp_path / "b" / "P004.PNG").read_bytes())
    crop = volume.crop_voxels((0, 0, 0), (5, 5, 5))
    refused(
        (lambda: save_drilled(tmp_path / "b", bone, volume, mapping=MAP), "path must be a new folder", FileExistsError),
        (lambda: load_drilled(tmp_path / "b"), "bone.h5 belongs to another content of it"),
        (lambda: save_drilled(tmp_path / "c", crop.to_bone(MAP), crop, mapping=MAP), "a stack must be whole to be saved as one"),
    )  # fmt: skip


@pytest.mark.parametrize("mode", ["RGBA", "RGB"])
def test_coloured_stacks_and_their_description(tmp_path: Path, mode: str) -> None:
    pytest.importorskip("yaml", reason="extra `medical` is not installed")
    colours = np.array(
        [(0, 0, 0, 0), (*VOLUMETRIC_DRILLING["Bone"], 255), (*VOLUMETRIC_DRILLING["Facial_Nerve"], 255)],
        np.uint8,
    )
    stack(tmp_path / "slices", colours[np.random.default_rng(7).integers(0, 3, SHAPE)], mode)
    (tmp_path / "v.yaml").write_text(
        "VOLUME v:\n  dimensions: {x: 0.018, y: 0.016, z: 0.014}\n  images:\n    path: slices/\n    prefix: "
        "plane00\n    format: png\n    count: 14\n  shaders:\n    path: ./shaders/\n"
    )
    labels = read_stack(tmp_path / "v.yaml")
    bone = anatomy_bone(None, labels, default_tissues(labels))
    density = bone.density.copy()
    density[2:8, 3:9, 4:10] //= 4
    density[9] = density[9] * 0.75
    bone.restore(density)
    save_drilled(tmp_path / "out", bone, labels, tick=9)
    again = read_stack(tmp_path / "out" / "v.yaml")
    expected = labels.labels.copy()
    expected[2:8, 3:9, 4:10] = 0
    np.testing.assert_array_equal(again.labels, expected)
    np.testing.assert_array_equal(again.spacing, labels.spacing)
    assert "path: ./shaders/" in (tmp_path / "out" / "v.yaml").read_text()
    loaded = load_drilled(tmp_path / "out")
    assert (loaded.bone.digest(), loaded.tick, loaded.mapping, loaded.transpose) == (
        bone.digest(),
        9,
        None,
        True,
    )
    with h5py.File(tmp_path / "out" / "bone.h5", "r+") as file:  # earlier versions wrote no such key
        kept = json.loads(file.attrs["source"])
        del kept["transpose"]
        file.attrs["source"] = json.dumps(kept)
    old = load_drilled(tmp_path / "out")
    assert (old.bone.digest(), old.transpose) == (bone.digest(), False)
    refused(
        (lambda: save_drilled(tmp_path / "x", bone, labels, mapping=MAP),
         "mapping must be given for grey values only, and .* holds labels"),
    )  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "VOLUME v: {dimensions: {x: 0.0054, y: 0.0064, z: 0.007}, images: {path: PLACE, prefix: plane}}\n",
        'VOLUME v:\n  dimensions: {x: 0.0054, y: 0.0064, z: 0.007}\n  "images":\n    "path": PLACE\n    prefix: plane\n',
    ],
)
def test_descriptions_in_other_styles_name_the_new_slices(tmp_path: Path, text: str) -> None:
    pytest.importorskip("yaml", reason="extra `medical` is not installed")
    (tmp_path / "v.yaml").write_text(text.replace("PLACE", os.fspath(stack(tmp_path / "old", greys("u2")))))
    volume = read_stack(tmp_path / "v.yaml")
    save_drilled(tmp_path / "new", drilled(volume), volume, mapping=MAP)
    found = read_stack(tmp_path / "new" / "v.yaml")
    assert np.count_nonzero(found.values != volume.values) > 0
    np.testing.assert_allclose(found.spacing, volume.spacing)


def test_a_volume_whose_name_has_brackets_is_no_pattern_of_slices(tmp_path: Path) -> None:
    (tmp_path / "ct[1].nrrd").touch()
    assert stack_slices(os.fspath(tmp_path / "ct[1].nrrd")) is None
