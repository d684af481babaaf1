"""Saves a bone's exact state in an HDF5 or a flat file: present and pristine levels, tissues and tick.

Damaged files are read safely.
"""

import contextlib
import json
import math
import operator
import os
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import Tissue, Tissues, VoxelBone, __version__, read_flat_bone, write_flat_bone
from burrlab.bone.materials import constants_of, material_of
from burrlab.common.check import DEFLATE, check_memory, check_packed, refuse, require_type, shown, whole
from burrlab.common.files import (
    attributes,
    check_heap,
    check_walk,
    link_elsewhere,
    new_file,
    new_hdf5,
    put_attributes,
)
from burrlab.common.progress import doing
from burrlab.common.records import UNREADABLE, in_one_line
from burrlab.theory.tool import law_of

if TYPE_CHECKING:
    import h5py


# 2: with tissues; 3: of a law that is not the paper's. A bone without is written as 1 or 2.
FORMAT, FORMAT_VERSION = "burrlab bone", 3
#: First bytes of a flat file of any format and of format 1, and the ending for which `save_bone` writes one.
FLAT, FLAT_1, FLAT_ENDING = b"burrlab flat file ", b"1 ", ".burr"


def holds_bone(path: str | os.PathLike[str]) -> bool:
    """Whether a file of this name holds a bone alone, as `save_bone` writes it, and no volume."""
    return Path(path).suffix.lower() in (".h5", ".hdf5", FLAT_ENDING)


@doing("writing a bone")
def save_bone(path: str | os.PathLike[str], bone: VoxelBone, tick: int = 0, *, source: str = "") -> None:
    """Writes a bone and its tick index to an HDF5 file, or to a flat file that a C++ program reads without HDF5.

    An older bone of the same name is replaced when the new file is complete.

    Parameters
    ----------
    path : path-like
        A flat file ends in .burr.
    bone : VoxelBone
    tick : int
        Ticks executed on the bone so far. They belong to its state: the next random numbers depend on them.
    source : str
        Source of the bone's volume; it is kept in the file.

    Raises
    ------
    ValueError
        If the tick is negative or not below 2^64.
    TypeError
        If the tick is not a whole number.
    FileExistsError
        If another file has that name and holds no bone, for example a trace.
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
    require_type("bone", bone, VoxelBone, "VoxelBone.block((10, 10, 5), 0.1)")
    refuse(
        not isinstance(path, str | os.PathLike),
        f"path must be the name of a file, got {shown(path)}",
        TypeError,
    )
    check_tick(tick)
    check_bone_file(path)
    if Path(path).suffix.lower() == FLAT_ENDING:
        with new_file(path) as part:
            part.unlink()
            write_flat_bone(os.fsencode(part), bone, tick, source)
        return
    with new_file(Path(path)) as part, new_hdf5(part) as file:
        version = 1 if bone.tissues is None else 3 if law_of(bone.tissues.material) else 2
        put_attributes(file, {"format": FORMAT, "format_version": version, "burrlab": __version__})
        write_bone(file, bone, tick, source=source)


@doing("reading a bone")
def load_bone(path: str | os.PathLike[str]) -> tuple[VoxelBone, int]:
    """The bone of a file and its tick index.

    Returns
    -------
    bone : VoxelBone
    tick : int
        Ticks executed on the bone so far.

    Raises
    ------
    ValueError
        If the file holds no bone, a bone of a newer format, or a bone whose digest differs from the saved
        one; or if it has links that could lead to other files.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import burrlab, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> block = burrlab.VoxelBone.block((2, 2, 2), 0.1)
    >>> burrlab.save_bone(folder.name + "/bone.h5", block)
    >>> bone, tick = load_bone(folder.name + "/bone.h5")
    >>> bone.digest() == block.digest(), tick
    (True, 0)
    >>> folder.cleanup()
    """
    if (flat := read_flat(path)) is not None:
        return flat[:2]
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file:
        return read_bone(file)


def read_flat(path: str | os.PathLike[str]) -> tuple[VoxelBone, int, str, list[str], int] | None:
    """Bone, its tick and source, the header's words on a session, and the place of its ticks in a flat file; None
    for another file. ValueError if it is damaged or newer."""
    with Path(path).open("rb") as file, told_as_damage(path):
        if file.read(len(FLAT)) != FLAT:
            return None
        known, line = file.read(len(FLAT_1)) == FLAT_1, file.readline(64)
        # The core refuses other formats, and checks the header.
        left = os.fstat(file.fileno()).st_size
        words = _words(file.read(min(int(line.split()[0]), left)).decode()) if known else []
        check_memory(2.04 * math.prod(map(int, words[:3])), "its bone")
        bone, tick, source = read_flat_bone(os.fsencode(path))
        session = words[16 + 10 * int(words[15]) + 7 * (words[15] != "0") :]
        return bone, tick, source, session, file.tell() + sum(map(int, words[12:15]))


def _words(text: str) -> list[str]:
    """Words, and texts in quotation marks, of a flat file's header."""
    return [
        word or re.sub(r"\\(.)", r"\1", quoted, flags=re.DOTALL)
        for quoted, word in re.findall(r'"([^"\\]*(?:\\.[^"\\]*)*)"|(\S+)', text, re.DOTALL)
    ]


def bone_source(path: str | os.PathLike[str]) -> str:
    """Source of a bone's volume, as given to `save_bone`; errors as `load_bone`."""
    if (flat := read_flat(path)) is not None:
        return flat[2]
    with open_hdf5(path, FORMAT, FORMAT_VERSION) as file:
        return str(attributes(file).get("source", ""))


@contextlib.contextmanager
def told_as_damage(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turns every error from a damaged file's content into a ValueError that names the file."""
    try:
        yield
    except (OSError, RuntimeError, zlib.error, *UNREADABLE) as error:
        if isinstance(error, ValueError) and str(error).startswith(f"{path} is "):
            raise
        raise ValueError(f"{path} is damaged: {in_one_line(error)}") from None


def check_bone_file(path: str | os.PathLike[str]) -> None:
    """FileExistsError if `save_bone` would replace a file that holds no bone."""
    if not Path(path).exists():
        return
    try:
        if (flat := read_flat(path)) is None:
            with open_hdf5(path, FORMAT, FORMAT_VERSION):
                pass
        refuse(flat is not None and flat[3], "a session is not replaced")
    except (ValueError, OSError):
        raise FileExistsError(f"path must be a new file or a {FORMAT}, {path} is neither") from None


@contextlib.contextmanager
def open_any_hdf5(path: str | os.PathLike[str], kind: str) -> "Iterator[h5py.File]":
    """The open file, whose errors are told as damage; ValueError, which names the kind, unless it is HDF5."""
    import h5py

    with Path(path).open("rb") as raw:  # a missing or forbidden file raises the system's error
        start = raw.read(9)
    refuse(start[:8] != b"\x89HDF\r\n\x1a\n", f"{path} is not {kind}: not an HDF5 file")
    if start[8:] < b"\x03":  # superblocks before HDF5 1.10 have no checksums
        check_walk(path)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if "truncated" in str(error):
            raise ValueError(f"{path} is damaged: it was cut short") from None
        raise ValueError(f"{path} is not {kind}: not an HDF5 file") from None
    with file, told_as_damage(path):
        name = link_elsewhere(file)
        refuse(name is not None, f"{path} is refused: its {name} is a link, and could lead to another file")
        yield file


@contextlib.contextmanager
def open_hdf5(path: str | os.PathLike[str], kind: str, newest: int) -> "Iterator[h5py.File]":
    """The open file, as from `open_any_hdf5`; ValueError unless it is of this kind and of a known version."""
    with open_any_hdf5(path, f"a {kind}") as file:
        header = attributes(file)
        version = int(header.get("format_version", 0))
        refuse(header.get("format") != kind, f"{path} is not a {kind}")
        refuse(
            not 1 <= version <= newest,
            f"{path} is a {kind} of format {version}, and this version reads up to {newest}",
        )
        yield file


def read_dataset(group: "h5py.Group", name: str, rows: int | None = None) -> Any:
    """A dataset, or its first rows, unpacked within the limits of its shape, the file and the memory.

    libhdf5 fills in missing chunks, and unpacks a chunk whatever its stream holds: both are errors here.

    Raises
    ------
    ValueError
        If the dataset is incomplete, has another number of rows, or needs more memory than the machine has. One
        that is not in chunks may have room for more.
    """
    dataset = group[name]
    where = f"its dataset {name}"
    refuse(
        dataset.is_virtual or dataset.external or (dataset.dtype.hasobject and dataset.shape),
        f"{where} lies elsewhere",
    )
    if not dataset.shape:
        check_heap(dataset, dataset.dtype)
        return dataset[()]
    room = len(dataset)
    refuse(
        rows is not None and (rows > room or (rows < room and dataset.chunks)),
        f"{where} has room for {room} rows, and {rows} are counted",
    )
    shape = (room if rows is None else rows, *dataset.shape[1:])
    size, stored = math.prod(shape) * dataset.dtype.itemsize, os.stat(group.file.filename).st_size
    stored = min(stored, dataset.id.get_storage_size())
    check_packed(size, stored if dataset.chunks else stored / DEFLATE, where)
    check_memory(size, where)
    values = np.empty(shape, dataset.dtype)
    if dataset.chunks is None:
        if size:
            dataset.read_direct(values, np.s_[: shape[0]])
        return values
    plan, whole, chunks = dataset.id.get_create_plist(), 0, list[Any]()
    filters = [plan.get_filter(k)[0] for k in range(plan.get_nfilters())]
    dataset.id.chunk_iter(chunks.append)
    plain_rows = values.view(f"V{dataset.dtype.itemsize}")  # NumPy copies a compound field by field
    with open(group.file.filename, "rb") as file:
        for place, at in {chunk.chunk_offset: chunk for chunk in chunks}.items():
            part = plain_rows[tuple(slice(k, k + n) for k, n in zip(place, dataset.chunks, strict=True))]
            if not part.size:
                continue
            file.seek(at.byte_offset)
            applied = [filter_id for k, filter_id in enumerate(filters) if not at.filter_mask >> k & 1]
            content = _unfiltered(file.read(min(at.size, stored)), applied, dataset, where)
            part[...] = content[tuple(map(slice, part.shape))]
            whole += part.size
    refuse(whole != values.size, f"{where} is not whole")
    return values


def _unfiltered(content: bytes, filters: list[int], dataset: "h5py.Dataset", where: str) -> NDArray[Any]:
    """Content of a chunk after its filters, gzip and shuffle, are undone."""
    import h5py

    size, width = math.prod(dataset.chunks) * dataset.dtype.itemsize, dataset.dtype.itemsize
    chunk: NDArray[Any] = np.frombuffer(content, np.uint8)
    for filter_id in reversed(filters):
        if filter_id == h5py.h5z.FILTER_DEFLATE:
            check_packed(size, len(chunk), where)
            chunk = np.frombuffer(zlib.decompressobj().decompress(chunk.data, size + 1), np.uint8)
        elif filter_id != h5py.h5z.FILTER_SHUFFLE:
            raise ValueError(f"{where} must be packed by gzip and shuffle, got filter {filter_id}")
        elif len(chunk) == size:  # the first bytes of all numbers come first
            shuffled, chunk = chunk.reshape(width, -1), np.empty(size, np.uint8)
            for k in range(width):  # three times as fast as a transposed copy
                chunk[k::width] = shuffled[k]
    refuse(len(chunk) != size, f"{where} must have chunks of {size} bytes, got {len(chunk)} or more")
    return np.asarray(chunk.view(f"V{width}").reshape(dataset.chunks))


def write_bone(group: "h5py.Group", bone: VoxelBone, tick: int, *, source: str = "") -> None:
    """Writes a bone into a group: `density`, and `pristine` and `tissue` if needed, (z, y, x) uint8."""
    levels = {"density": False} | ({"pristine": True} if bone.removed > 0 else {})
    chunks = tuple(min(64, side) for side in bone.shape)
    packed: dict[str, Any] = {"chunks": chunks, "compression": "gzip", "compression_opts": 1}
    datasets = {name: group.create_dataset(name, bone.shape, np.uint8, **packed) for name in levels}
    for place in np.ndindex(*(-(-side // step) for side, step in zip(bone.shape, chunks, strict=True))):
        start = np.multiply(place, chunks)
        sides, known = np.minimum(chunks, bone.shape - start), dict[bytes, bytes]()
        for name, pristine in levels.items():  # most chunks lost nothing: the same bytes twice
            chunk = np.zeros(chunks, np.uint8)
            chunk[tuple(map(slice, sides))] = bone.read(start.tolist(), sides.tolist(), pristine=pristine)
            content = chunk.tobytes()
            known[content] = known.get(content) or _runs(content)
            datasets[name].id.write_direct_chunk(tuple(start.tolist()), known[content])
    if bone.tissues is not None and (numbers := bone.tissue_numbers) is not None:
        group.create_dataset("tissue", bone.shape, np.uint8, **packed)
        for k in range(0, len(numbers), 64):  # chunk by chunk: Ctrl-C does not wait for all
            group["tissue"][k : k + 64] = numbers[k : k + 64]
        put_attributes(group, {"tissues": tissues_to_json(bone.tissues)})
    put_attributes(group, {
        "spacing_mm": bone.spacing, "origin_mm": bone.origin, "digest": bone.digest(), "tick": np.uint64(tick),
        "source": source,
    })  # fmt: skip


def _runs(content: bytes) -> bytes:
    """Deflate of runs alone, in half the time of gzip's fastest level, and no larger."""
    packer = zlib.compressobj(1, memLevel=9, strategy=zlib.Z_RLE)
    return packer.compress(content) + packer.flush()


def read_bone(group: "h5py.Group") -> tuple[VoxelBone, int]:
    """The bone of a group and its tick; ValueError if its digest differs from the saved one."""
    header = attributes(group)
    density = read_dataset(group, "density")
    pristine = read_dataset(group, "pristine") if "pristine" in group else density
    bone = VoxelBone(pristine, header["spacing_mm"], header["origin_mm"])
    if pristine is not density:
        bone.restore(density)
    if "tissue" in group:
        bone.set_tissues(tissues_from_json(header["tissues"]), read_dataset(group, "tissue"))
    refuse(
        bone.digest() != header["digest"],
        f"{group.file.filename} is damaged: the bone has digest {bone.digest()}, and was written with "
        + in_one_line(header["digest"]),
    )
    return bone, whole("tick", header["tick"], 2**64, "2^64")


def tissues_to_json(tissues: Tissues) -> str:
    """A table of tissues as text that `tissues_from_json` reads."""
    m = tissues.material
    material = {"name": m.name, **constants_of(m), "source": m.source}
    return json.dumps({"material": material, "tissues": [
        {"name": t.name, "label": t.label, "c_e_N_per_mm2": t.c_e, "alpha_per_ms": t.alpha, "colour": list(t.colour),
         "critical": t.critical, "bleeds": t.bleeds, "assumed": t.assumed}
        for t in tissues
    ]})  # fmt: skip


def tissues_from_json(text: str) -> Tissues:
    """A table of tissues from text; ValueError, KeyError or TypeError if the text holds none."""
    content = json.loads(text)
    material = content["material"]
    return Tissues(
        [
            Tissue(t["name"], label=t["label"], c_e=t["c_e_N_per_mm2"], alpha=t["alpha_per_ms"], colour=t["colour"],
                   critical=t["critical"], bleeds=t["bleeds"], assumed=t["assumed"])
            for t in content["tissues"]
        ],
        material_of(material, material["name"], material["source"]),
    )  # fmt: skip


def check_tick(tick: int) -> None:
    refuse(
        not 0 <= operator.index(tick) < 2**64,
        f"tick must be a whole number from 0 and below 2^64, got {tick}",
    )
