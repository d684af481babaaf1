"""Velocity-force curves as CSV text, and the rules that their numbers obey."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import IO, TYPE_CHECKING, Any

from burrlab import csv_text

if TYPE_CHECKING:
    from burrlab.curve import VelocityCurve

COLUMNS = {
    "force": "force_N",
    "velocity": "velocity_mm_s",
    "sigma": "sigma_mm_s",
    "window_start": "window_start_mm",
    "window_end": "window_end_mm",
    "status": "status",
}
_UNITS = {"force": "N", "velocity": "mm/s", "sigma": "mm/s", "window_start": "mm", "window_end": "mm"}


def problem_in_row(row: Mapping[str, float]) -> tuple[str, str] | None:
    """The first rule that a row of numbers breaks, as (name, sentence); None where it breaks none.

    NaN stands for "no number", which only the force must not be.
    """
    for name, value in row.items():
        if math.isnan(value) and name != "force":
            continue
        problem = csv_text.positive_problem(value, _UNITS[name], or_zero=name == "window_start")
        if problem:
            return name, problem
    start, end = row.get("window_start", math.nan), row.get("window_end", math.nan)
    if math.isnan(start) != math.isnan(end):
        missing = "window_start" if math.isnan(start) else "window_end"
        return missing, "a window needs both its ends or neither"
    if start >= end:
        return "window_start", f"must be below the window's end of {end!r} mm: got {start!r}"
    return None


_LAYOUT = csv_text.Layout(
    columns=COLUMNS,
    filled={"force": "a force"},
    required=("velocity",),
    pairs=(("window_start", "window_end"),),
    problem=problem_in_row,
)


def read(file: csv_text.Path | IO[str] | IO[bytes]) -> dict[str, Any]:
    """The arguments of a VelocityCurve, from CSV text. See `VelocityCurve.from_csv`."""
    name, comments, columns = csv_text.read(file, _LAYOUT)
    radius = csv_text.number_in_comments(name, comments, "radius_mm")
    return {**columns, "radius": radius, **csv_text.origin(name, comments)}


def write(curve: VelocityCurve, file: csv_text.Path | IO[str]) -> None:
    """Write a curve as CSV text. See `VelocityCurve.to_csv`."""
    comments = csv_text.origin_comments(curve.source, curve.provenance, radius_mm=curve.radius)
    csv_text.write(file, comments, table(curve))


def table(curve: VelocityCurve) -> dict[str, list[float] | list[str]]:
    """The curve's columns by their names in the CSV file, those that it has."""
    columns: dict[str, list[float] | list[str]] = {}
    for name, column in COLUMNS.items():
        values = getattr(curve, name)
        if values is not None:
            columns[column] = list(values) if name == "status" else values.tolist()
    return columns
