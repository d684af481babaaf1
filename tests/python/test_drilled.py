"""Half-drilled volumes: header, values and exact state of every format, and what happens when the writer dies."""

from __future__ import annotations

import gzip
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from label_scenes import anatomy_bone
from PIL import Image

from burrlab import Burr, VoxelBone, erode, materials, read_volume, save_bone
from burrlab.anatomy import default_tissues
from burrlab.anatomy.known_tissues import VOLUMETRIC_DRILLING
from burrlab.volume import LabelVolume, OccupancyMap, Volume, load_drilled, read_stack, save_drilled
from burrlab.volume.drilled import check_drilled
from burrlab.volume.drilled_values import grey_of_levels

MAP = OccupancyMap.two_point(200, 1200)
SHAPE = (14, 16, 18)


def greys(kind: str = "i2") -> np.ndarray:
    """Bone of random grey values, some above what counts as solid, under a layer of air."""
    values = np.random.default_rng(5).integers(150, 1500, SHAPE)
    values[10:] = -1000 if kind[0] != "u" else 0
    return values.astype(kind)


def drilled(volume: Volume) -> VoxelBone:
    bone = volume.to_bone(MAP)
    labels = LabelVolume(
        (np.arange(volume.values.size) % 3).reshape(volume.shape),
        volume.spacing,
        volume.origin,
        volume.direction,
        "l",
    )
    bone.set_tissues(default_tissues(["air", "bone", "facial nerve"]), labels.labels.astype(np.uint8))
    spacing = np.array(bone.spacing)
    center = np.array(bone.origin) + spacing * (9, 8, 10)
    for tick in range(40):
        erode(bone, Burr(5 * spacing.max()), center, materials["bone"], dt=1.0, seed=1, tick=tick)
    assert bone.removed > 0
    assert np.count_nonzero((bone.density > 0) & (bone.density < bone.pristine)) > 0
    return bone


def nrrd(path: Path, values: np.ndarray, encoding: str = "raw", endian: str = "little") -> Path:
    kinds = {"i2": "short", "u2": "uint16", "f4": "float", "i4": "int"}
    data = values.astype(values.dtype.newbyteorder("<" if endian == "little" else ">")).tobytes()
    head = (
        f"NRRD0005\n# a comment that stays\ntype: {kinds[values.dtype.str[1:]]}\ndimension: 3\nspace: right-anterior-superior\n"
        f"sizes: {' '.join(str(n) for n in values.shape[::-1])}\nspace directions: (0.3,0,0) (0,0.4,0) (0,0,0.5)\n"
        f"kinds: domain domain domain\nendian: {endian}\nencoding: {encoding}\nspace origin: (1.5,-2.25,3)\n"
        "Patient:=phantom 7\nDICOM_note:=kept, with := inside\n\n"
    )
    path.write_bytes(head.encode() + (gzip.compress(data) if encoding == "gzip" else data))
    return path


def nifti(path: Path, values: np.ndarray, slope: float = 0.0, inter: float = 0.0) -> Path:
    """NIfTI-1 by its definition, with an extension, a description and codes that are not usual."""
    code = {"i2": 4, "u2": 512, "f4": 16, "u1": 2, "i4": 8}[values.dtype.str[1:]]
    head = bytearray(352)
    struct.pack_into("<i", head, 0, 348)
    struct.pack_into("<8h", head, 40, 3, *values.shape[::-1], 1, 1, 1, 1)
    struct.pack_into("<2h", head, 70, code, 8 * values.dtype.itemsize)
    struct.pack_into("<8f", head, 76, 1.0, 0.3, 0.4, 0.5, 0, 0, 0, 0)
    struct.pack_into("<3f", head, 108, 352.0 + 16, slope, inter)
    head[123] = 2
    head[148:170] = b"described as it pleases"[:22]
    struct.pack_into("<2h", head, 252, 3, 4)
    struct.pack_into("<3f", head, 268, 1.5, -2.25, 3.0)
    struct.pack_into("<12f", head, 280, 0.3, 0, 0, 1.5, 0, 0.4, 0, -2.25, 0, 0, 0.5, 3.0)
    head[344:348] = b"n+1\0"
    head[348:352] = b"\1\0\0\0"
    content = (
        bytes(head)
        + struct.pack("<2i", 16, 6)
        + b"comment\0"
        + values.astype(values.dtype.newbyteorder("<")).tobytes()
    )
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path


def meta(path: Path, values: np.ndarray, compressed: bool) -> Path:
    data = values.tobytes()
    data = zlib.compress(data) if compressed else data
    size = f"CompressedDataSize = {len(data)}\n" if compressed else ""
    head = (
        f"ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = {compressed}\n{size}"
        "TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 1.5 -2.25 3\nCenterOfRotation = 0 0 0\nAnatomicalOrientation = RAI\n"
        "ElementSpacing = 0.3 0.4 0.5\nDimSize = 18 16 14\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    )
    path.write_bytes(head.encode() + data)
    return path


MAKERS = {
    "raw.nrrd": lambda path: nrrd(path, greys()),
    "big.nrrd": lambda path: nrrd(path, greys(), endian="big"),
    "packed.nrrd": lambda path: nrrd(path, greys("i4"), encoding="gzip"),
    "float.nrrd": lambda path: nrrd(path, greys("f4")),
    "plain.nii": lambda path: nifti(path, greys()),
    "packed.nii.gz": lambda path: nifti(path, greys("f4")),
    "plain.mha": lambda path: meta(path, greys(), False),
    "packed.mha": lambda path: meta(path, greys(), True),
}


@pytest.mark.parametrize("name", MAKERS)
def test_header_values_and_state(tmp_path: Path, name: str) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    original = MAKERS[name](tmp_path / name)
    volume = read_volume(original)
    bone = drilled(volume)
    saved = tmp_path / f"saved{''.join(Path(name).suffixes)}"
    save_drilled(saved, bone, volume, mapping=MAP, tick=40)
    again = read_volume(saved)
    np.testing.assert_array_equal(again.spacing, volume.spacing)
    np.testing.assert_array_equal(again.origin, volume.origin)
    np.testing.assert_array_equal(again.direction, volume.direction)
    assert again.values.dtype == volume.values.dtype
    whole = bone.density == bone.pristine
    np.testing.assert_array_equal(again.values[whole], volume.values[whole])
    assert (again.values <= volume.values).all()
    gone = (bone.density == 0) & ~whole
    assert (again.values[gone] == 200).all()
    # What is left of the others is what the map gives for their new grey value, within the type's rounding.
    assert np.abs(MAP.levels(again.values).astype(int) - bone.density)[~whole].max() <= 1
    loaded = load_drilled(saved)
    assert (loaded.bone.digest(), loaded.tick, loaded.mapping) == (bone.digest(), 40, MAP)
    assert loaded.source == str(original)
    assert loaded.bone.removed_of("facial nerve") == bone.removed_of("facial nerve") > 0
    assert head_of(saved) == head_of(original)


def head_of(path: Path) -> bytes:
    """Everything before the values, but for the size of packed ones."""
    content = path.read_bytes()
    if path.suffix == ".nrrd":
        return content[: content.index(b"\n\n")]
    if path.suffix == ".mha":
        lines = content[: content.index(b"LOCAL\n")].split(b"\n")
        return b"\n".join(line for line in lines if not line.startswith(b"CompressedDataSize"))
    return (gzip.decompress(content) if path.suffix == ".gz" else content)[:368]


def test_independent_readers_see_the_same(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    pynrrd = pytest.importorskip("nrrd", reason="pynrrd, an independent reader, is not installed")
    nibabel = pytest.importorskip("nibabel", reason="nibabel, an independent reader, is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys(), encoding="gzip"))
    bone = drilled(volume)
    save_drilled(tmp_path / "b.nrrd", bone, volume, mapping=MAP)
    values, header = pynrrd.read(str(tmp_path / "b.nrrd"))
    np.testing.assert_array_equal(values.transpose(2, 1, 0), read_volume(tmp_path / "b.nrrd").values)
    assert header["Patient"] == "phantom 7"
    volume = read_volume(nifti(tmp_path / "a.nii.gz", greys()))
    save_drilled(tmp_path / "b.nii.gz", drilled(volume), volume, mapping=MAP)
    image = nibabel.load(tmp_path / "b.nii.gz")
    np.testing.assert_array_equal(
        np.asarray(image.dataobj).transpose(2, 1, 0), read_volume(tmp_path / "b.nii.gz").values
    )
    assert image.header["descrip"].item() == b"described as it please"
    assert (int(image.header["qform_code"]), int(image.header["sform_code"])) == (3, 4)
    assert len(image.header.extensions) == 1


def test_scaled_values_are_written_as_they_are_stored(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    stored = ((greys() + 1024) // 2).astype("u2")
    volume = read_volume(nifti(tmp_path / "a.nii", stored, slope=2.0, inter=-1024.0))
    bone = drilled(volume)
    save_drilled(tmp_path / "b.nii", bone, volume, mapping=MAP)
    raw = np.frombuffer((tmp_path / "b.nii").read_bytes()[368:], "<u2").reshape(SHAPE)
    whole = bone.density == bone.pristine
    np.testing.assert_array_equal(raw[whole], stored[whole])
    assert (raw[(bone.density == 0) & ~whole] == (200 + 1024) / 2).all()


def test_what_has_no_header_of_its_own_gets_one(tmp_path: Path) -> None:
    """Crops, other spacings, other endings (so DICOM too): the geometry is kept, the fields of the header are not."""
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    crop = volume.crop_voxels((2, 2, 2), (13, 15, 17))
    fine = volume.resample(0.25)
    for like, name in ((crop, "b.nrrd"), (fine, "c.nrrd"), (volume, "d.nii.gz"), (volume, "e.mha")):
        bone = drilled(like)
        save_drilled(tmp_path / name, bone, like, mapping=MAP)
        again = read_volume(tmp_path / name)
        assert again.values.dtype == like.values.dtype
        np.testing.assert_allclose(again.corners(), like.corners(), atol=1e-5)
        whole = bone.density == bone.pristine
        np.testing.assert_array_equal(again.values[whole], like.values[whole])
        assert load_drilled(tmp_path / name).bone.digest() == bone.digest()


def test_drilling_goes_on_from_a_saved_volume(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    bone = drilled(volume)
    once, path = bone.copy(), tmp_path / "b.nrrd"
    save_drilled(path, once, volume, mapping=MAP, tick=40)
    loaded = load_drilled(path)
    later = loaded.bone
    erode(later, Burr(2.0), np.array(later.origin) + (4, 4, 4), materials["bone"], dt=1.0, seed=1, tick=40)
    assert later.digest() != once.digest()
    save_drilled(path, later, read_volume(path), mapping=loaded.mapping, tick=41)
    assert (load_drilled(path).bone.digest(), load_drilled(path).tick) == (later.digest(), 41)
    assert len(list(tmp_path.glob("b.nrrd.*.bone.h5"))) == 1
    save_drilled(tmp_path / "c.nrrd", later, volume, mapping=MAP, tick=41)
    assert (tmp_path / "c.nrrd").read_bytes() == path.read_bytes()
    with pytest.raises(
        ValueError, match=r"like must be the original: .*b.nrrd is half-drilled, and \d+ voxels"
    ):
        save_drilled(tmp_path / "d.nrrd", volume.to_bone(MAP), read_volume(path), mapping=MAP)


def test_saved_twice_under_a_relative_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same content has the same exact state: the second save must not take it for an older one."""
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    monkeypatch.chdir(tmp_path)
    volume = read_volume(nrrd(Path("a.nrrd"), greys()))
    bone = drilled(volume)
    for tick in (1, 2):
        save_drilled("b.nrrd", bone, volume, mapping=MAP, tick=tick)
        loaded = load_drilled("b.nrrd")
        assert (loaded.bone.digest(), loaded.tick) == (bone.digest(), tick)


def test_a_changed_or_missing_part_is_found(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    path = tmp_path / "b.nrrd"
    save_drilled(path, drilled(volume), volume, mapping=MAP)
    with pytest.raises(
        ValueError,
        match=r"a.nrrd: the exact state, a.nrrd\.\w+\.bone.h5, must lie beside it, and there is none",
    ):
        load_drilled(tmp_path / "a.nrrd")
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"there is b.nrrd\.\w+\.bone.h5, of another content of it"):
        load_drilled(path)
    content[-1] ^= 1
    path.write_bytes(content)
    [beside] = tmp_path.glob("b.nrrd.*.bone.h5")
    save_drilled(tmp_path / "c.nrrd", volume.to_bone(MAP), volume, mapping=MAP)
    [other] = tmp_path.glob("c.nrrd.*.bone.h5")
    beside.write_bytes(other.read_bytes())
    with pytest.raises(ValueError, match="belongs to another content of it: one of them was changed"):
        load_drilled(path)
    beside.unlink()
    save_bone(beside, volume.to_bone(MAP))
    with pytest.raises(ValueError, match="is a bone, but not one of a drilled volume"):
        load_drilled(path)
    with pytest.raises(FileNotFoundError, match=r"none.nrrd: no such file or folder"):
        load_drilled(tmp_path / "none.nrrd")


class Dies(BaseException):
    """Not caught by anything that handles errors."""


@pytest.mark.parametrize("name", ["b.nrrd", "b"])
def test_killed_in_the_middle_there_is_the_old_pair_or_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """The process ends at each of its calls of fsync, replace, rename and unlink in turn."""
    if name == "b":
        volume = read_stack(stack(tmp_path / "s", greys("u2")), spacing=(0.3, 0.4, 0.5))
        assert isinstance(volume, Volume)
    else:
        pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
        volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    old, new = volume.to_bone(MAP), drilled(volume)
    path, left, calls = tmp_path / name, [0], [0]

    def dying(real: Any) -> Any:
        def call(*arguments: Any, **options: Any) -> Any:
            calls[0] += 1
            left[0] -= 1
            if left[0] == 0:
                raise Dies
            if left[0] < 0:  # what a dead process does not do any more
                return None
            return real(*arguments, **options)

        return call

    def run(at: int) -> None:
        left[0], calls[0] = at, 0
        with monkeypatch.context() as patch:
            for module, what in ((os, "fsync"), (os, "rename"), (os, "replace"), (os, "unlink")):
                patch.setattr(module, what, dying(getattr(module, what)))
            patch.setattr("shutil.rmtree", lambda *a, **k: None if left[0] <= 0 else real_rmtree(*a, **k))
            save_drilled(path, new, volume, mapping=MAP)

    import shutil

    real_rmtree = shutil.rmtree
    run(10**6)
    steps, seen = calls[0], set()
    assert steps >= 3
    for at in range(1, steps + 1):
        for other in tmp_path.glob("*b*"):
            shutil.rmtree(other) if other.is_dir() else other.unlink()
        if name != "b":  # a stack's folder must be new
            save_drilled(path, old, volume, mapping=MAP)
        with pytest.raises(Dies):
            run(at)
        if name == "b" and not path.exists():
            seen.add("nothing")
            continue
        seen.add(load_drilled(path).bone.digest())
        save_drilled(
            tmp_path / "after_b.nrrd" if name != "b" else tmp_path / "after_b", new, volume, mapping=MAP
        )
    assert seen <= {old.digest(), new.digest(), "nothing"}
    assert len(seen) >= (1 if name == "b" else 2)


def test_the_map_turned_round() -> None:
    np.testing.assert_allclose(grey_of_levels(MAP), 200 + 1000 * np.arange(256) / 255)
    table = OccupancyMap.table((-500, 0, 100, 300, 400), (0, 0, 0.5, 0.5, 1))
    found = grey_of_levels(table)
    assert (found[0], found[255]) == (0, 400)
    assert np.all(np.diff(found) > 0)
    inside = [i for i in range(256) if i != 128]  # the plateau
    np.testing.assert_array_equal(table.levels(found)[inside], inside)
    for bad in (((0, 1, 2), (0, 1, 0.5)), ((0, 1), (0.1, 1))):
        with pytest.raises(ValueError, match="map must rise from 0 with the grey value"):
            grey_of_levels(OccupancyMap.table(*bad))


def stack(folder: Path, planes: np.ndarray, mode: str | None = None) -> Path:
    folder.mkdir()
    for k, plane in enumerate(planes):
        image = Image.fromarray(plane)
        (image.convert(mode) if mode else image).save(folder / f"plane00{k}.png")
    return folder


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("kind", ["u1", "u2", "rgba"])
def test_grey_stacks(tmp_path: Path, kind: str, turned: bool) -> None:
    values = np.random.default_rng(6).integers(0, 250, SHAPE).astype("u2" if kind == "u2" else "u1")
    if kind == "rgba":
        planes = np.repeat(values[..., None], 4, axis=-1)
        planes[..., 3] = 255
    else:
        planes = values
    mapping = OccupancyMap.two_point(20, 200)
    volume = read_stack(stack(tmp_path / "a", planes), spacing=(0.3, 0.4, 0.5), transpose=turned)
    assert isinstance(volume, Volume)
    bone = volume.to_bone(mapping)
    density = bone.density.copy()
    density[3:6, 4:8, 5:9] //= 3
    bone.restore(density)
    save_drilled(tmp_path / "b", bone, volume, mapping=mapping, tick=3)
    again = read_stack(tmp_path / "b", spacing=(0.3, 0.4, 0.5), transpose=turned)
    assert isinstance(again, Volume)
    assert again.values.dtype == volume.values.dtype
    whole = bone.density == bone.pristine
    np.testing.assert_array_equal(again.values[whole], volume.values[whole])
    assert np.abs(mapping.levels(again.values).astype(int) - bone.density)[~whole].max() <= 1
    assert load_drilled(tmp_path / "b").bone.digest() == bone.digest()
    with (
        Image.open(tmp_path / "b" / "plane000.png") as new,
        Image.open(tmp_path / "a" / "plane000.png") as old,
    ):
        assert new.mode == old.mode
    with pytest.raises(FileExistsError, match="path must be a new folder"):
        save_drilled(tmp_path / "b", bone, volume, mapping=mapping)
    (tmp_path / "b" / "plane003.png").write_bytes((tmp_path / "b" / "plane004.png").read_bytes())
    with pytest.raises(ValueError, match=r"bone.h5 belongs to another content of it"):
        load_drilled(tmp_path / "b")
    with pytest.raises(ValueError, match="a stack must be whole to be saved as one"):
        save_drilled(tmp_path / "c", volume.crop_voxels((0, 0, 0), (5, 5, 5)).to_bone(mapping),
                     volume.crop_voxels((0, 0, 0), (5, 5, 5)), mapping=mapping)  # fmt: skip


@pytest.mark.parametrize("mode", ["RGBA", "RGB"])
def test_coloured_stacks_and_their_description(tmp_path: Path, mode: str) -> None:
    pytest.importorskip("yaml", reason="extra `medical` is not installed")
    colours = np.array(
        [(0, 0, 0, 0), (*VOLUMETRIC_DRILLING["Bone"], 255), (*VOLUMETRIC_DRILLING["Facial_Nerve"], 255)],
        np.uint8,
    )
    kinds = np.random.default_rng(7).integers(0, 3, SHAPE)
    stack(tmp_path / "slices", colours[kinds], mode)
    (tmp_path / "v.yaml").write_text(
        "VOLUME v:\n  dimensions: {x: 0.018, y: 0.016, z: 0.014}\n  images:\n    path: slices/\n    prefix: plane00\n"
        "    format: png\n    count: 14\n  shaders:\n    path: ./shaders/\n"
    )
    labels = read_stack(tmp_path / "v.yaml")
    assert isinstance(labels, LabelVolume)
    bone = anatomy_bone(None, labels, default_tissues(labels))
    density = bone.density.copy()
    density[2:8, 3:9, 4:10] //= 4
    density[9] = density[9] * 0.75
    bone.restore(density)
    save_drilled(tmp_path / "out", bone, labels, tick=9)
    again = read_stack(tmp_path / "out" / "v.yaml")
    assert isinstance(again, LabelVolume)
    expected = labels.labels.copy()
    expected[2:8, 3:9, 4:10] = 0
    np.testing.assert_array_equal(again.labels, expected)
    np.testing.assert_array_equal(again.spacing, labels.spacing)
    assert "path: ./shaders/" in (tmp_path / "out" / "v.yaml").read_text()
    loaded = load_drilled(tmp_path / "out")
    assert (loaded.bone.digest(), loaded.tick, loaded.mapping) == (bone.digest(), 9, None)
    with pytest.raises(ValueError, match=r"mapping must be given for grey values only, and .* holds labels"):
        save_drilled(tmp_path / "x", bone, labels, mapping=MAP)


def test_slices_in_capitals_belong_to_their_state_too(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    for k, plane in enumerate(greys("u2")):
        Image.fromarray(plane).save(tmp_path / "old" / f"P{k + 1:03d}.PNG")
    volume = read_stack(tmp_path / "old", spacing=(0.3, 0.4, 0.5))
    assert isinstance(volume, Volume)
    save_drilled(tmp_path / "new", drilled(volume), volume, mapping=MAP)
    load_drilled(tmp_path / "new")
    (tmp_path / "new" / "P005.PNG").write_bytes((tmp_path / "old" / "P006.PNG").read_bytes())
    with pytest.raises(ValueError, match="belongs to another content of it: one of them was changed"):
        load_drilled(tmp_path / "new")


@pytest.mark.parametrize(
    "text",
    [
        "VOLUME v: {dimensions: {x: 0.0054, y: 0.0064, z: 0.007}, images: {path: PLACE, prefix: p}}\n",
        "VOLUME v:\n  dimensions: {x: 0.0054, y: 0.0064, z: 0.007}\n  images: {path: PLACE, prefix: p}\n",
        'VOLUME v:\n  dimensions: {x: 0.0054, y: 0.0064, z: 0.007}\n  "images":\n    path: PLACE\n    prefix: p\n',
        'VOLUME v:\n  dimensions: {x: 0.0054, y: 0.0064, z: 0.007}\n  images:\n    "path": PLACE\n    prefix: p\n',
    ],
)
def test_descriptions_in_other_styles_name_the_new_slices(tmp_path: Path, text: str) -> None:
    pytest.importorskip("yaml", reason="extra `medical` is not installed")
    (tmp_path / "old").mkdir()
    for k, plane in enumerate(greys("u2")):
        Image.fromarray(plane).save(tmp_path / "old" / f"p{k:03d}.png")
    (tmp_path / "v.yaml").write_text(text.replace("PLACE", os.fspath(tmp_path / "old")))
    volume = read_stack(tmp_path / "v.yaml")
    assert isinstance(volume, Volume)
    bone = drilled(volume)
    save_drilled(tmp_path / "new", bone, volume, mapping=MAP)
    found = read_stack(tmp_path / "new" / "v.yaml")
    assert isinstance(found, Volume)
    assert np.count_nonzero(found.values != volume.values) > 0
    np.testing.assert_allclose(found.spacing, volume.spacing)


def test_another_volume_under_the_name_of_a_half_drilled_one_is_not_replaced(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    bone = drilled(volume)
    save_drilled(tmp_path / "b.nrrd", bone, volume, mapping=MAP)
    save_drilled(tmp_path / "b.nrrd", bone, volume, mapping=MAP)  # its own it replaces
    other = nrrd(tmp_path / "b.nrrd", greys() + np.int16(1)).read_bytes()
    with pytest.raises(
        FileExistsError, match=r"path must be a new file or one of save_drilled, .*b\.nrrd is neither"
    ):
        save_drilled(tmp_path / "b.nrrd", bone, volume, mapping=MAP)
    assert (tmp_path / "b.nrrd").read_bytes() == other
    (state,) = tmp_path.glob("b.nrrd.*.bone.h5")
    state.rename(tmp_path / state.name.replace("b.nrrd", "a.nrrd"))
    with pytest.raises(ValueError, match="path must be another file than the original"):
        save_drilled(tmp_path / "a.nrrd", bone, volume, mapping=MAP)


def test_bad_saves_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    volume = read_volume(nrrd(tmp_path / "a.nrrd", greys()))
    bone = volume.to_bone(MAP)
    before = (tmp_path / "a.nrrd").read_bytes()

    def refused(kind: type[Exception], match: str, path: str = "b.nrrd", **changes: Any) -> None:
        options = {"bone": bone, "like": volume, "mapping": MAP, **changes}
        with pytest.raises(kind, match=match):
            save_drilled(tmp_path / path, options.pop("bone"), options.pop("like"), **options)

    refused(ValueError, "mapping must be given: that with which the bone was made of", mapping=None)
    refused(ValueError, "tick must be a whole number", tick=-1)
    refused(ValueError, "path must be another file than the original", "a.nrrd")
    refused(ValueError, r"path must end in .nrrd, .nii, .nii.gz or .mha, got .*b.txt", "b.txt")
    refused(FileNotFoundError, "folder must exist", "none/b.nrrd")
    (tmp_path / "mine.nrrd").write_text("something else")
    refused(
        FileExistsError,
        r"path must be a new file or one of save_drilled, .*mine.nrrd is neither",
        "mine.nrrd",
    )
    other = volume.crop_voxels((0, 0, 0), (5, 5, 5))
    refused(
        ValueError, r"bone must be on the voxels of .*: it has shape \(5, 5, 5\)", bone=other.to_bone(MAP)
    )
    refused(ValueError, "map must rise from 0", mapping=OccupancyMap.table((0, 1, 2), (0, 1, 0)))
    below = OccupancyMap.two_point(-100, 180)
    small = Volume(np.full(SHAPE, 200, np.uint8), (0.3, 0.4, 0.5), (0, 0, 0), np.eye(3), "small")
    refused(
        ValueError, "map must have a grey value of empty that small can hold, .*: it holds uint8, got -100",
        bone=small.to_bone(below), like=small, mapping=below,
    )  # fmt: skip
    assert (tmp_path / "a.nrrd").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.nrrd", "mine.nrrd"]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"encoding: raw", b"encoding: hex", "encoding of the NRRD file must be raw or gzip to keep its header, got 'hex'"),
        (b"type: short", b"type: block", "type of the NRRD file must be one of whole or real numbers, got 'block'"),
        (b"kinds:", b"data file: x.raw\nkinds:", "the values must follow the NRRD header in the same file"),
        (b"kinds:", b"byte skip: -1\nkinds:", "the values must follow the NRRD header in the same file"),
        (b"\n\n", b"\n", "the values must follow the NRRD header in the same file"),
    ],
)  # fmt: skip
def test_nrrd_headers_that_cannot_be_kept(tmp_path: Path, old: bytes, new: bytes, match: str) -> None:
    from burrlab.volume.stored import read_stored

    path = nrrd(tmp_path / "a.nrrd", np.zeros(SHAPE, "i2"))
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(ValueError, match=match):
        read_stored(path)


@pytest.mark.parametrize("name", ["a.nrrd", "a.mha"])
def test_a_header_that_cannot_be_kept_is_told_before_there_is_a_bone(tmp_path: Path, name: str) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    text = " ".join(map(str, greys().ravel())).encode() + b"\n"
    path = nrrd(tmp_path / name, greys()) if name == "a.nrrd" else meta(tmp_path / name, greys(), False)
    head = path.read_bytes()[: -greys().nbytes].replace(b"encoding: raw", b"encoding: ascii")
    path.write_bytes(head.replace(b"BinaryData = True", b"BinaryData = False") + text)
    volume = read_volume(path)
    np.testing.assert_array_equal(volume.values, greys())
    match = "encoding of the NRRD file must be raw or gzip|must hold binary numbers right after its header"
    with pytest.raises(ValueError, match=match):
        check_drilled(tmp_path / f"b{path.suffix}", volume, MAP)
    part = volume.crop_voxels((1, 1, 1), SHAPE)  # gets a new header
    for target, like in ((f"b{path.suffix}", part), ("b.nii", volume)):
        assert check_drilled(tmp_path / target, like, MAP) is None


def test_other_headers_that_cannot_be_kept(tmp_path: Path) -> None:
    from burrlab.volume.stored import read_stored

    path = meta(tmp_path / "a.mha", greys(), True)
    content = path.read_bytes()
    for old, new, match in (
        (b"LOCAL", b"a.raw", "the values must follow the MetaImage header in the same file"),
        (b"BinaryData = True", b"BinaryData = False", "must hold binary numbers right after its header"),
        (b"MET_SHORT", b"MET_STRING", "must hold binary numbers right after its header"),
        (content[-40:], b"", "the compressed data is cut short or damaged"),
    ):
        path.write_bytes(content.replace(old, new, 1))
        with pytest.raises(ValueError, match=match):
            read_stored(path)
    path = nifti(tmp_path / "a.nii", greys())
    content = path.read_bytes()
    path.write_bytes(content[:-2])
    with pytest.raises(ValueError, match=f"the file is cut short: {len(content) - 370} bytes of values of"):
        read_stored(path)
    path.write_bytes(content[:344] + b"ni1" + content[347:])
    with pytest.raises(ValueError, match="the values must follow the NIfTI header in the same file"):
        read_stored(path)
