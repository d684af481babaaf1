"""Half-drilled volumes as stacks of PNG slices."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.volume.adf import read_description
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.png_files import Slices, find_slices, pixels
from burrlab.volume.stack import ROWS_ALONG_X
from burrlab.volume.volume import Volume

Greys = tuple[NDArray[np.bool_], NDArray[np.float64]]


def stack_slices(like: Volume | LabelVolume) -> Slices | None:
    """The slices that a volume was read of; None where it was not one of PNG slices."""
    path = like.path
    if Path(path).suffix.lower() in (".yaml", ".yml") and Path(path).is_file():
        described = read_description(path, unit=1.0)
        return find_slices(described.folder, prefix=described.prefix)
    if any(sign in path for sign in "*?[") or (
        Path(path).is_dir() and any(Path(path).glob("*.[pP][nN][gG]"))
    ):
        return find_slices(path)
    return None


def write_stack(
    target: Path,
    slices: Slices,
    like: Volume | LabelVolume,
    bone: VoxelBone,
    greys: Greys | None,
    beside: Callable[[Path, str], None],
) -> None:
    """Writes a folder of slices of the same names, sizes and kind, which appears when it is whole.

    Parameters
    ----------
    target : Path
        A folder that is not yet there.
    slices : Slices
        Of the original.
    like : Volume or LabelVolume
        Read of them.
    bone : VoxelBone
    greys : (ndarray, ndarray) or None
        Which voxels lost something, and their new grey values; None for coloured slices, in which a voxel of which less than half
        is left becomes transparent (black, without transparency).
    beside : callable
        Called with the folder before it appears and the digest of its slices.

    Raises
    ------
    ValueError
        If `like` is not the whole stack.
    """
    turned = ROWS_ALONG_X in like.notes
    shape = (
        (len(slices.paths), slices.columns, slices.rows)
        if turned
        else (len(slices.paths), slices.rows, slices.columns)
    )
    if shape != like.shape:
        raise ValueError(
            f"{like.path}: a stack must be whole to be saved as one, {shape} voxels, got {like.shape}"
        )
    density, pristine = bone.density, bone.pristine
    gone = 2 * density.astype(np.int64) < pristine
    new = None
    if greys is not None:
        assert isinstance(like, Volume)
        new = like.values.copy()
        new[greys[0]] = np.rint(greys[1])
    part = target.with_name(f".{target.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    try:
        digest = hashlib.sha256()
        order = []
        for k, path in enumerate(slices.paths):
            lost, plane = gone[k], None if new is None else new[k]
            if turned:
                lost, plane = lost.T, None if plane is None else plane.T
            copy = part / path.name
            _write_slice(path, copy, slices.kind, lost, plane)
            order.append((path.name, copy))
        for name, copy in sorted(order):
            digest.update(name.encode() + b"\0" + hashlib.sha256(copy.read_bytes()).digest())
        if Path(like.path).is_file():
            _write_description(Path(like.path), part)
        beside(part, digest.hexdigest())
        os.rename(part, target)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _write_slice(
    path: Path, copy: Path, kind: str, gone: NDArray[np.bool_], plane: NDArray[Any] | None
) -> None:
    from PIL import Image

    image = pixels(path).copy()
    if plane is None:
        image[gone] = 0
    elif image.ndim == 2:
        image[...] = plane
    else:
        image[..., :3] = plane[..., None]
    if kind == "RGB":
        image = image[..., :3]
    with copy.open("wb") as file:
        Image.fromarray(image).save(file, format="PNG")
        file.flush()
        os.fsync(file.fileno())


def _write_description(path: Path, folder: Path) -> None:
    """The YAML file of the original, with the slices beside it."""
    text = path.read_text(encoding="utf-8")
    block = re.search(r"^(\s*)images:[^\n]*\n(?:\1\s+[^\n]*\n?|\s*\n)*", text, flags=re.MULTILINE)
    if block is None:
        return
    own = re.sub(r"^(\s*path:)[^\n]*", r"\g<1> ./", block[0], count=1, flags=re.MULTILINE)
    (folder / path.name).write_text(text[: block.start()] + own + text[block.end() :], encoding="utf-8")
