"""A bone in the middle of its life, kept in a file: present and pristine levels, and how many ticks it has seen."""

from __future__ import annotations

import contextlib
import json
import operator
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from burrlab import __version__
from burrlab._core import Material, Tissue, Tissues, VoxelBone
from burrlab.files import new_part
from burrlab.session.new_hdf5 import new_hdf5

if TYPE_CHECKING:
    import h5py

FORMAT, FORMAT_VERSION = "burrlab bone", 2  # 2: with tissues; a bone without them is written as 1


def save_bone(path: str | os.PathLike[str], bone: VoxelBone, tick: int = 0, *, source: str = "") -> None:
    """Writes a bone and its tick index to an HDF5 file; an older bone of that name is replaced when it is whole.

    Parameters
    ----------
    path : path-like
    bone : VoxelBone
    tick : int
        Ticks executed on it so far: part of its state, because the next tick's random numbers follow from it.
    source : str
        Where the volume comes from, kept with it.

    Raises
    ------
    ValueError
        If the tick is negative or not below 2^64.
    TypeError
        If it is no whole number.
    FileExistsError
        If there is a file of that name that holds no bone, as a trace.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import burrlab, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> bone = burrlab.VoxelBone.block((1, 1, 1), 0.1)
    >>> save_bone(folder.name + "/bone.h5", bone, 1000)
    >>> again, tick = load_bone(folder.name + "/bone.h5")
    >>> again.digest() == bone.digest(), tick
    (True, 1000)
    >>> folder.cleanup()
    """
    path = Path(path)
    check_tick(tick)
    check_bone_file(path)
    with new_part(path) as part:
        with new_hdf5(part) as file:
            file.attrs["format"] = FORMAT
            file.attrs["format_version"] = 1 if bone.tissues is None else FORMAT_VERSION
            file.attrs["burrlab"] = __version__
            write_bone(file, bone, tick, source=source)
        part.replace(path)


def load_bone(path: str | os.PathLike[str]) -> tuple[VoxelBone, int]:
    """The bone of a file and its tick index.

    Returns
    -------
    bone : VoxelBone
    tick : int
        Ticks executed on it so far.

    Raises
    ------
    ValueError
        If the file holds no bone, one of a newer format, or one whose digest is not the one it was saved with.
    OSError
        If the file cannot be read.
    """
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file, told_as_damage(path):
        return read_bone(file)


def bone_source(path: str | os.PathLike[str]) -> str:
    """Where the volume of a bone comes from, as `save_bone` was told; errors as `load_bone`."""
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file, told_as_damage(path):
        return str(file.attrs.get("source", ""))


@contextlib.contextmanager
def told_as_damage(path: str | os.PathLike[str]) -> Iterator[None]:
    """Whatever the content of a broken file leads to, a ValueError that names the file."""
    try:
        yield
    except (
        LookupError,
        OSError,
        TypeError,
        ValueError,
        ArithmeticError,
        AttributeError,
        RuntimeError,
    ) as error:
        if isinstance(error, ValueError) and str(error).startswith(f"{path} is "):
            raise
        raise ValueError(f"{path} is damaged: {error}") from None


def check_bone_file(path: str | os.PathLike[str]) -> None:
    """FileExistsError if `save_bone` would replace a file that holds no bone."""
    if not Path(path).exists():
        return
    try:
        open_hdf5(path, FORMAT, FORMAT_VERSION).close()
    except (ValueError, OSError):
        raise FileExistsError(f"path must be a new file or a {FORMAT}, {path} is neither") from None


def open_hdf5(path: str | os.PathLike[str], kind: str, newest: int) -> h5py.File:
    """The open file; ValueError unless it is of this kind and of a version that is known."""
    import h5py

    with Path(path).open("rb"):  # what is missing or forbidden says so in the system's words
        pass
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if "truncated" in str(error):
            raise ValueError(f"{path} is damaged: it was cut short") from None
        raise ValueError(f"{path} is not a {kind}: not an HDF5 file") from None
    try:
        with told_as_damage(path):
            found, version = file.attrs.get("format"), int(file.attrs.get("format_version", 0))
    except ValueError:
        file.close()
        raise
    if found == kind and 1 <= version <= newest:
        return file
    file.close()
    if found != kind:
        raise ValueError(f"{path} is not a {kind}")
    raise ValueError(f"{path} is a {kind} of format {version}, and this version reads up to {newest}")


def write_bone(group: h5py.Group, bone: VoxelBone, tick: int, *, source: str = "") -> None:
    """Puts a bone into a group: `density`, and `pristine` and `tissue` where there are any, (z, y, x) uint8."""
    density, pristine = bone.density, bone.pristine
    packed: dict[str, Any] = {"chunks": _chunk(bone.shape), "compression": "gzip", "compression_opts": 1}
    group.create_dataset("density", data=density, **packed)
    if not np.array_equal(density, pristine):
        group.create_dataset("pristine", data=pristine, **packed)
    if bone.tissues is not None:
        group.create_dataset("tissue", data=bone.tissue_numbers, **packed)
        group.attrs["tissues"] = tissues_to_json(bone.tissues)
    group.attrs["spacing_mm"] = bone.spacing
    group.attrs["origin_mm"] = bone.origin
    group.attrs["digest"] = bone.digest()
    group.attrs["tick"] = np.uint64(tick)
    group.attrs["source"] = source


def read_bone(group: h5py.Group) -> tuple[VoxelBone, int]:
    """The bone of a group and its tick; ValueError if its digest is another than the one written with it."""
    density = group["density"][()]
    pristine = group["pristine"][()] if "pristine" in group else density
    bone = VoxelBone(pristine, group.attrs["spacing_mm"], group.attrs["origin_mm"])
    if pristine is not density:
        bone.restore(density)
    if "tissue" in group:
        bone.set_tissues(tissues_from_json(group.attrs["tissues"]), group["tissue"][()])
    if bone.digest() != group.attrs["digest"]:
        raise ValueError(
            f"{group.file.filename} is damaged: the bone has digest {bone.digest()}, and was written with {group.attrs['digest']}"
        )
    return bone, int(group.attrs["tick"])


def tissues_to_json(tissues: Tissues) -> str:
    """A table of tissues as text, from which `tissues_from_json` makes an equal one."""
    m = tissues.material
    rows = [
        {"name": t.name, "label": t.label, "c_e_N_per_mm2": t.c_e, "alpha_per_ms": t.alpha, "colour": list(t.colour),
         "critical": t.critical, "bleeds": t.bleeds, "assumed": t.assumed}
        for t in tissues
    ]  # fmt: skip
    material = {"name": m.name, "c_e_N_per_mm2": m.c_e, "alpha_per_ms": m.alpha, "shape": m.shape.name, "source": m.source}  # fmt: skip
    return json.dumps({"material": material, "tissues": rows})


def tissues_from_json(text: str) -> Tissues:
    """The table; ValueError, KeyError or TypeError where the text is none."""
    content = json.loads(text)
    m = content["material"]
    material = Material(
        m["name"], c_e=m["c_e_N_per_mm2"], alpha=m["alpha_per_ms"], shape=m["shape"], source=m["source"]
    )
    return Tissues(
        [
            Tissue(t["name"], label=t["label"], c_e=t["c_e_N_per_mm2"], alpha=t["alpha_per_ms"], colour=t["colour"],
                   critical=t["critical"], bleeds=t["bleeds"], assumed=t["assumed"])
            for t in content["tissues"]
        ],
        material,
    )  # fmt: skip


def check_tick(tick: int) -> None:
    if not 0 <= operator.index(tick) < 2**64:
        raise ValueError(f"tick must be a whole number from 0 and below 2^64, got {tick}")


def _chunk(shape: tuple[int, int, int]) -> tuple[int, ...]:
    return tuple(min(64, side) for side in shape)
