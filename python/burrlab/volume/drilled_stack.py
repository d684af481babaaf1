"""Half-drilled volumes as stacks of PNG slices."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from burrlab.files import new_folder
from burrlab.volume.adf import read_description
from burrlab.volume.drilled_pair import content_digest
from burrlab.volume.drilled_values import Changes, changed_values
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.png_files import Slices, find_slices, pixels
from burrlab.volume.stack import ROWS_ALONG_X, is_stack
from burrlab.volume.volume import Volume

if TYPE_CHECKING:
    from PIL import Image


def stack_slices(path: str) -> Slices | None:
    """The slices that a volume was read of; None where it was not one of PNG slices."""
    if Path(path).suffix.lower() in (".yaml", ".yml") and Path(path).is_file():
        described = read_description(path, unit=1.0)
        return find_slices(described.folder, prefix=described.prefix)
    if any(sign in path for sign in "*?[") or (Path(path).is_dir() and is_stack(path)):
        return find_slices(path)
    return None


def check_whole_stack(slices: Slices, like: Volume | LabelVolume) -> None:
    """ValueError unless a volume has the voxels of the stack."""
    turned = ROWS_ALONG_X in like.notes
    sides = (slices.columns, slices.rows) if turned else (slices.rows, slices.columns)
    if (len(slices.paths), *sides) != like.shape:
        raise ValueError(
            f"{like.path}: a stack must be whole to be saved as one, {(len(slices.paths), *sides)} voxels, got {like.shape}"
        )


def write_stack(
    target: Path,
    slices: Slices,
    like: Volume | LabelVolume,
    changed: Changes,
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
    changed : Changes
        Of coloured slices they become transparent (black, without transparency).
    beside : callable
        Called with the folder before it appears and the digest of its slices.
    """
    new = changed_values(like, changed) if isinstance(like, Volume) else None
    with new_folder(target) as part:
        for k, path in enumerate(slices.paths):
            here, plane = changed.where[k], None if new is None else new[k]
            if ROWS_ALONG_X in like.notes:
                here, plane = here.T, None if plane is None else plane.T
            _write_slice(path, part / path.name, slices, here, plane)
        if Path(like.path).is_file():
            _write_description(Path(like.path), part)
        beside(part, content_digest(part))


def _write_slice(
    path: Path, copy: Path, slices: Slices, where: NDArray[np.bool_], plane: NDArray[Any] | None
) -> None:
    with copy.open("wb") as file:
        if not where.any() and slices.kind != "palette" and slices.bits >= 8:  # others change their kind
            file.write(path.read_bytes())
        else:
            _draw(path, slices.kind, where, plane).save(file, format="PNG", compress_level=3)
        file.flush()
        os.fsync(file.fileno())


def _draw(path: Path, kind: str, where: NDArray[np.bool_], plane: NDArray[Any] | None) -> Image.Image:
    from PIL import Image

    image = pixels(path).copy()
    if plane is None:
        image[where] = 0
        image[image[..., 3] == 0] = 0  # without transparency nothing else says that they are empty
    elif image.ndim == 2:
        image[...] = plane
    else:
        image[..., :3] = plane[..., None]
    return Image.fromarray(image[..., :3] if kind == "RGB" else image)


def _write_description(path: Path, folder: Path) -> None:
    """The YAML file of the original, with the slices beside it; comments go where its style is not that of the simulator's."""
    import yaml

    text, copy = path.read_text(encoding="utf-8"), folder / path.name
    block = re.search(r"^(\s*)images:[^\n]*\n(?:\1\s+[^\n]*\n?|\s*\n)*", text, flags=re.MULTILINE)
    if block is not None:
        own = re.sub(r"^(\s*path:)[^\n]*", r"\g<1> ./", block[0], count=1, flags=re.MULTILINE)
        copy.write_text(text[: block.start()] + own + text[block.end() :], encoding="utf-8")
        if read_description(copy, unit=1.0).folder.resolve() == folder.resolve():
            return
    content = yaml.safe_load(text)
    (named,) = (name for name in content if str(name).startswith("VOLUME "))  # as read_description has it
    content[named]["images"]["path"] = "./"
    copy.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), encoding="utf-8")
