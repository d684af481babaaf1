"""Scripts for a burr's way, as CSV text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import IO

import numpy as np

from burrlab import csv_text
from burrlab._core import ScriptedDevice


def _problem_in_row(row: Mapping[str, float]) -> csv_text.Problem:
    for name, value in row.items():
        if name == "on" and value not in (0.0, 1.0):
            return name, f"must be 0 or 1: got {value!r}"
        if not math.isfinite(value):
            return name, f"must be a finite number: got {value!r}"
    return None


_LAYOUT = csv_text.Layout(
    columns={"time": "time_s", "x": "x_mm", "y": "y_mm", "z": "z_mm", "on": "on"},
    filled={"time": "a time", "x": "a position", "y": "a position", "z": "a position"},
    problem=_problem_in_row,
)


def read_script(file: csv_text.Path | IO[str] | IO[bytes]) -> ScriptedDevice:
    """A device that follows the way in a CSV file.

    Parameters
    ----------
    file : path or file object
        Columns time_s (increasing), x_mm, y_mm, z_mm (centre of the burr, bone frame) and, optional, on (1: the burr
        turns from this row to the next; without the column it always does). Lines that begin with # above the
        column names are comments.

    Returns
    -------
    ScriptedDevice

    Raises
    ------
    ValueError
        If a column is missing, a field is no finite number, `on` is not 0 or 1, or the times do not increase: with
        the file, and the line and column where there is one.
    OSError
        If the file cannot be opened.
    """
    name, _, columns = csv_text.read(file, _LAYOUT)
    position = np.column_stack([columns["x"], columns["y"], columns["z"]])
    on = np.asarray(columns["on"]) > 0 if "on" in columns else None
    try:
        return ScriptedDevice(np.asarray(columns["time"]), position, on)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
