"""Half-drilled volumes: files with headers of many kinds, and a bone drilled in them."""

import gzip
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from burrlab import Burr, OccupancyMap, Volume, VoxelBone, erode, materials, read_volume
from burrlab.bone.kept import DrilledVolume, check_drilled, load_drilled, save_drilled
from burrlab.bone.tissues import default_tissues

MAP = OccupancyMap.two_point(200, 1200)
SHAPE = (14, 16, 18)


def greys(kind: str = "i2") -> np.ndarray:
    """Random grey values of bone, some above that of solid, under a layer of air."""
    values = np.random.default_rng(5).integers(150, 1500, SHAPE)
    values[10:] = -1000 if kind[0] != "u" else 0
    return values.astype(kind)


def drilled(volume: Volume) -> VoxelBone:
    bone = volume.to_bone(MAP)
    numbers = (np.arange(volume.values.size) % 3).astype(np.uint8).reshape(volume.shape)
    bone.set_tissues(default_tissues(["air", "bone", "facial nerve"]), numbers)
    center = np.array(bone.origin) + np.array(bone.spacing) * (9, 8, 10)
    for tick in range(40):
        erode(bone, Burr(5 * max(bone.spacing)), center, materials["bone"], dt=1.0, seed=1, tick=tick)
    assert np.count_nonzero((bone.density > 0) & (bone.density < bone.pristine)) > 0
    return bone


def cut(bone: VoxelBone, box: Any, by: int) -> None:
    """Divides the levels in a box, and rounds them down."""
    density = bone.density.copy()
    density[box] //= by
    bone.restore(density)


def kept(path: Path, like: Volume, tick: int = 0) -> tuple[VoxelBone, Volume, DrilledVolume]:
    """A bone drilled in a volume and saved; checks geometry, untouched and empty voxels, and exact state."""
    bone = drilled(like)
    assert check_drilled(path, like, MAP) is None
    save_drilled(path, bone, like, mapping=MAP, tick=tick)
    again, loaded = read_volume(path), load_drilled(path)
    np.testing.assert_allclose(again.corners(), like.corners(), atol=1e-5)
    whole = bone.density == bone.pristine
    untouched = np.rint(like.values) if again.values.dtype.kind == "i" else like.values
    np.testing.assert_array_equal(again.values[whole], untouched[whole])
    gone = again.values[(bone.density == 0) & ~whole]
    assert ((gone > 195) & (gone <= 200)).all()  # within a step of the stored numbers
    assert (loaded.bone.digest(), loaded.tick, loaded.mapping) == (bone.digest(), tick, MAP)
    return bone, again, loaded


def nrrd(path: Path, values: np.ndarray, encoding: str = "raw", endian: str = "little") -> Path:
    kinds = {"i2": "short", "u2": "uint16", "f4": "float", "i4": "int"}
    data = values.astype(values.dtype.newbyteorder("<" if endian == "little" else ">")).tobytes()
    head = (
        f"NRRD0005\n# a comment that stays\ntype: {kinds[values.dtype.str[1:]]}\ndimension: 3\nspace: "
        "right-anterior-superior\nsizes: "
        f"{' '.join(str(n) for n in values.shape[::-1])}\nspace directions: (0.3,0,0) (0,0.4,0) (0,0,0.5)\n"
        f"kinds: domain domain domain\nendian: {endian}\nencoding: {encoding}\nspace origin: (1.5,-2.25,3)\n"
        "Patient:=phantom 7\nPatient Name:=Jörg\nDICOM_note:=kept, with := inside\n\n"
    )
    path.write_bytes(head.encode() + (gzip.compress(data) if encoding == "gzip" else data))
    return path


def nifti(path: Path, values: np.ndarray, slope: float = 0.0, inter: float = 0.0) -> Path:
    """A NIfTI-1 file by its definition, with an extension, a description and unusual codes."""
    code = {"i2": 4, "u2": 512, "f4": 16}[values.dtype.str[1:]]
    head = bytearray(352)
    for place, kind, *fields in (
        (0, "i", 348), (40, "8h", 3, *values.shape[::-1], 1, 1, 1, 1), (70, "2h", code, 8 * values.dtype.itemsize),
        (76, "8f", 1.0, 0.3, 0.4, 0.5, 0, 0, 0, 0), (108, "3f", 352.0 + 16, slope, inter), (123, "B", 2),
        (148, "80s", b"described as it pleases, in so many words that no zero ends it: ".ljust(80, b".")),
        (252, "2h", 3, 4), (268, "3f", 1.5, -2.25, 3.0),
        (280, "12f", 0.3, 0, 0, 1.5, 0, 0.4, 0, -2.25, 0, 0, 0.5, 3.0), (344, "8s", b"n+1\0\1\0\0\0"),
    ):  # fmt: skip
        struct.pack_into(f"<{kind}", head, place, *fields)
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
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = "
        f"{compressed}\n{size}TransformMatrix = 1 0 0 0 1 0 0 0 "
        "1\nOffset = 1.5 -2.25 3\nCenterOfRotation = 0 0 0\nAnatomicalOrientation = RAI\nPatient = phantom "
        "7\nPatient Name = Jörg = Ä\nElementSpacing = 0.3 0.4 0.5\nDimSize = 18 16 "
        "14\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
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
    "scaled.nii": lambda path: nifti(path, ((greys() + 1024) // 2).astype("u2"), slope=2.0, inter=-1024.0),
}


def stack(folder: Path, planes: np.ndarray, mode: str | None = None, name: str = "plane00{}.png") -> Path:
    """A folder of slices of the planes, from number 0."""
    folder.mkdir(exist_ok=True)
    for k, plane in enumerate(planes):
        image = Image.fromarray(np.asarray(plane))
        (image.convert(mode) if mode else image).save(folder / name.format(k))
    return folder
