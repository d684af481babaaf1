"""What a half-drilled volume's voxels hold, and the bytes of its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from burrlab._core import VoxelBone
from burrlab.volume.coding import Coding
from burrlab.volume.geometry import same_geometry
from burrlab.volume.label_volume import LabelVolume
from burrlab.volume.nrrd import segment_layers
from burrlab.volume.occupancy_map import OccupancyMap
from burrlab.volume.read import read_labels, read_volume
from burrlab.volume.stored import ENDINGS, can_keep_header, check_stored, read_stored
from burrlab.volume.volume import Volume
from burrlab.volume.write import write_volume


class Changes(NamedTuple):
    """Which voxels get another value, these values, and of grey ones that of empty."""

    where: NDArray[np.bool_]
    values: NDArray[np.float64]
    empty: float | None = None


def grey_of_levels(mapping: OccupancyMap) -> NDArray[np.float64]:
    """Grey value of each level 0 to 255, by the map turned round; of empty, the highest that is empty.

    Raises
    ------
    ValueError
        If occupancy falls somewhere with the grey value, or no grey value is empty.
    """
    greys, occupancies = np.array(mapping.greys), np.array(mapping.occupancies)
    if np.any(np.diff(occupancies) < 0) or occupancies[0] > 0 or occupancies[-1] == 0:
        raise ValueError(
            f"map must rise from 0 with the grey value, for what was removed to have one, got {mapping.text}"
        )
    levels = np.arange(256) / 255.0
    last = np.clip(np.searchsorted(occupancies, levels), int(np.argmax(occupancies > 0)), len(greys) - 1)
    low, high = occupancies[last - 1], occupancies[last]
    found = greys[last - 1] + np.minimum((levels - low) / (high - low), 1.0) * (greys[last] - greys[last - 1])
    found[0] = greys[np.flatnonzero(occupancies == 0)[-1]]
    return np.asarray(found)


def changes(bone: VoxelBone, like: Volume | LabelVolume, mapping: OccupancyMap | None) -> Changes:
    """Grey values of what lost something, by the map turned round; label 0 where less than half is left."""
    density, pristine = bone.density, bone.pristine
    lost = density < pristine
    if isinstance(like, LabelVolume):
        lost[lost] = 2 * density[lost].astype(np.int64) < pristine[lost]
        return Changes(lost, np.zeros(np.count_nonzero(lost)))
    assert mapping is not None
    was, greys = like.values[lost].astype(np.float64), grey_of_levels(mapping)
    return Changes(lost, np.minimum(greys[density[lost]], was), float(greys[0]))


def file_ending(target: Path) -> str:
    """The ending that says the format; ValueError for none of them."""
    ending = next((e for e in ENDINGS if target.name.lower().endswith(e)), None)
    if ending is None:
        raise ValueError(f"path must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}, got {target}")
    return ending


def check_header(target: Path, like: Volume | LabelVolume, mapping: OccupancyMap | None) -> None:
    """ValueError where the header of the original should be kept under other values, and cannot be, or does not hold empty."""
    if _keeps_ending(target, like):
        try:
            coding = check_stored(like.path)
            coding.check(None if mapping is None else float(grey_of_levels(mapping)[0]), like.path)
        except ValueError:
            if is_whole(like):
                raise


def changed_file(target: Path, like: Volume | LabelVolume, changed: Changes) -> bytes:
    """The bytes of the volume's file with other values, under the header of the original where that can be kept."""
    ending = file_ending(target)
    if _keeps_ending(target, like) and is_whole(like):
        stored = read_stored(like.path)
        new = stored.values.copy()
        new[changed.where] = stored.coding.stored(changed.values, like.path, changed.empty)
        return stored.content(new)
    part = target.with_name(f".{target.name}.values{ending}")
    try:
        write_volume(part, with_changes(like, changed))
        return part.read_bytes()
    finally:
        part.unlink(missing_ok=True)


def changed_values(like: Volume | LabelVolume, changed: Changes) -> NDArray[Any]:
    """The voxels' values, of their type, after the changes."""
    new = _voxels(like).copy()
    new[changed.where] = Coding(new.dtype).stored(changed.values, like.path, changed.empty)
    return new


def with_changes(like: Volume | LabelVolume, changed: Changes) -> Volume | LabelVolume:
    """The volume with these values."""
    new = changed_values(like, changed)
    return replace(like, labels=new) if isinstance(like, LabelVolume) else replace(like, values=new)


def _keeps_ending(target: Path, like: Volume | LabelVolume) -> bool:
    return can_keep_header(like.path) and like.path.lower().endswith(file_ending(target))


def is_whole(like: Volume | LabelVolume) -> bool:
    """Whether the volume is what its file holds, in one layer, not cropped, resampled or changed."""
    if like.path.lower().endswith(".nrrd") and segment_layers(like.path)[0] > 1:
        return False
    read = read_volume if isinstance(like, Volume) else read_labels
    try:
        whole = read(like.files or like.path, spacing=like.spacing)
    except ValueError:  # another spacing than the file's
        return False
    return same_geometry(whole, like) and np.array_equal(_voxels(whole), _voxels(like))


def _voxels(like: Volume | LabelVolume) -> NDArray[Any]:
    return like.labels if isinstance(like, LabelVolume) else like.values
