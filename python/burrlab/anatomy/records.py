"""Rows of a trace that say what a watch saw."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from burrlab import _core

#: Kinds of events, by number.
KINDS = ("approach", "touch", "injury", "away")

#: Field of the core and column of the file.
_EVENT = {"distance": "distance_mm", "force": "force_N", "removed": "removed_levels", "center": "center_mm"}
_DOSE = {
    "distance": "distance_mm", "closest": "closest_mm", "closest_center": "closest_center_mm",
    "removed": "removed_levels", "near_force": "near_force_N", "near_peak": "near_peak_N",
}  # fmt: skip


def _renamed(dtype: np.dtype[Any], columns: dict[str, str]) -> np.dtype[Any]:
    assert dtype.names is not None and dtype.fields is not None
    names = [columns.get(name, name) for name in dtype.names]
    formats = [dtype.fields[name][0] for name in dtype.names]
    offsets = [dtype.fields[name][1] for name in dtype.names]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": dtype.itemsize})


#: What happened: tick, kind, structure and burr by number, on, distance_mm, force_N, removed_levels, center_mm.
EVENT_DTYPE = _renamed(_core.watch_event_dtype, _EVENT)
#: One burr beside one structure.
DOSE_DTYPE = _renamed(_core.watch_dose_dtype, _DOSE)


def as_rows(values: NDArray[np.void], dtype: np.dtype[Any]) -> NDArray[np.void]:
    """The core's records as rows of the file, bit for bit; read-only."""
    rows = values.view(dtype)
    rows.flags.writeable = False
    return rows
